"""A model of a run: declared in its study, asked for afterwards, on the page, over a series."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

import planish as pl
from planish.analyze import ExplainParams
from planish.analyze.explain_sheets import explained_over_sheets
from planish.app import explore
from planish.app.pictures import Pictures
from planish.core.errors import InputError
from planish.report import explain_page, tables_of
from planish.report.sentences.explain import say_answer
from planish.run.explain import with_declared_model
from planish.series.explain import declared_model

MODEL = {"response": "image", "of": ["coating_top"], "cell_um": 50.0}


def drawn_maps(seed, weight=0.6):
    rng = np.random.default_rng(seed)
    a, b, rest = (ndimage.gaussian_filter(rng.normal(size=(60, 60)), 1.5) for _ in range(3))
    coords = {"v": np.arange(60) * 20.0, "u": np.arange(60) * 20.0}
    arrays = {"y": weight * a - 0.2 * b + rest, "a": a, "b": b}
    return xr.Dataset({k: (("v", "u"), m / m.std()) for k, m in arrays.items()}, coords=coords)


def models(weights):
    return {
        f"field {k}": pl.explain(drawn_maps(k, w), response="y", of=["a", "b"], cell_um=20.0)
        for k, w in enumerate(weights)
    }


# --- pages and sheets of drawn maps ---------------------------------------------------------------


def test_sheets_count_once_and_their_spread_makes_the_interval():
    fields = models([0.5, 0.7, 0.9, 0.6])
    sheets = {"field 0": "1", "field 1": "1", "field 2": "2", "field 3": "3"}
    pooled = explained_over_sheets(fields, sheets, {"field 4": "refused"})
    a = [m.coefficients["a"].standardised for m in fields.values()]
    of_sheets = np.array([(a[0] + a[1]) / 2, a[2], a[3]])
    found = pooled.coefficients["a"]
    assert found.standardised == pytest.approx(of_sheets.mean(), rel=1e-12)
    half = 4.302653 * of_sheets.std(ddof=1) / np.sqrt(3)  # Student's t with 2 degrees of freedom
    np.testing.assert_allclose(
        found.interval, (found.standardised - half, found.standardised + half), rtol=1e-6
    )
    assert (pooled.sheets, pooled.fields) == (3, 4)
    assert pooled.n == sum(m.n for m in fields.values())
    page, _ = explain_page(pooled, source="series", version="1")
    assert "3 sheets" in page
    assert "field 4 (refused)" in page


def test_two_sheets_have_no_interval():
    fields = models([0.5, 0.7])
    pooled = explained_over_sheets(fields, dict.fromkeys(fields, ""), {})
    assert pooled.sheets == 2
    assert np.isnan(pooled.coefficients["a"].interval).all()
    assert "2 of at least 3 sheets" in pooled.coefficients["a"].reason
    assert "is not known. Means of 2 fields over 2 sheets" in say_answer(pooled)


def test_the_page_answers_and_its_tables_hold_the_numbers():
    (model,) = models([0.8]).values()
    page, pictures = explain_page(model, source="run", version="1")
    assert "explain" in page
    for words in ("matters most", "independent ones", "What would make it more certain"):
        assert words in page
    assert len(pictures) == 6  # coefficients, sizes, two partial plots, residuals, correlogram
    # A map has one colour: dots of its coefficient, of its curve over sizes, of its partial plot.
    dots = [re.findall(r'h0" fill="none" stroke="(#\w+)"', picture.svg) for picture in pictures]
    assert dots[0] == dots[1] == [*dots[2], *dots[3]]
    assert len(set(dots[0])) == 2
    tables = tables_of(model)
    assert tables["coefficients"]["map"] == ["a", "b"]
    assert tables["coefficients"]["low"][0] == model.coefficients["a"].interval[0]
    assert len(tables["cells"]["residual"]) == model.n
    # What is left has mean 0, and the table of cells gives it again.
    cells = {name: np.array(column) for name, column in tables["cells"].items()}
    fitted = model.intercept + sum(model.coefficients[k].plain * cells[k] for k in ("a", "b"))
    np.testing.assert_allclose(cells["y"] - fitted, cells["residual"], atol=1e-9)


# --- runs -----------------------------------------------------------------------------------------


@pytest.mark.ci
def test_one_map_of_a_run_says_what_its_r_says(kinds):
    run = pl.open_run(kinds("upright"))
    model = pl.explain(run, **MODEL)
    rows = pl.correlate_maps(run.linked, params={"point_um": 50.0})
    row = next(r for r in rows if r.a_map == "coating_top" and r.point_um == 50.0)
    assert model.n == row.n
    assert model.coefficients["coating_top"].standardised == pytest.approx(row.r, rel=1e-6)
    assert model.declared is None
    with pytest.raises(InputError, match=r"There are .*coating_top"):
        pl.explain(run, response="image", of=["coating"])


@pytest.mark.ci
def test_a_declared_model_stands_in_run_page_and_layers(kinds, tmp_path, passes):
    run = kinds("upright")
    out = tmp_path / "declared"
    passes(
        "run",
        run / "run.toml",
        "--set",
        "explain.of=coating_top",
        "--set",
        "explain.cell_um=50",
        "--out",
        out,
    )
    declared = pl.open_run(out)
    model = declared.results.explained
    assert model.declared is True
    assert model.coefficients == pl.explain(run, **MODEL).coefficients
    residual = declared.groups["explained"]["residual"]
    assert residual.shape == declared.linked["image"].shape
    assert np.nanstd(residual) > 0
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "What explains it" in page
    explore(out, tmp_path / "page.html")
    assert "What the model leaves of image" in (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "residual" in [picture.name for picture in Pictures.of(out)]
    printed = json.loads(passes("explain", out, "--json")[0])
    assert printed["declared"] is True
    other = json.loads(
        passes("explain", out, "--of", "coating_top", "--cell-um", "100", "--json")[0]
    )
    assert other["declared"] is False
    passes("compare", out, kinds("laid"), "--out", tmp_path / "series")
    assert declared_model(tmp_path / "series") == declared.study.explain


@pytest.mark.ci
def test_a_declared_model_that_cannot_be_had_leaves_the_run(kinds):
    run = pl.open_run(kinds("upright"))
    params = ExplainParams(of=("coating_top", "no_such_map"))
    asked = with_declared_model(
        replace(run, study=run.study.model_copy(update={"explain": params}))
    )
    assert asked.results.explained is None
    assert "no map 'no_such_map'" in asked.results.explain_reason
    assert "explained" not in asked.groups


@pytest.mark.ci
def test_a_series_is_pooled(kinds, tmp_path, passes):
    runs = [kinds("upright"), kinds("laid")]
    passes("compare", *runs, "--out", tmp_path / "series")
    pooled = pl.explain(tmp_path / "series", **MODEL)
    assert pooled.sheets == 2
    assert len(pooled.specimens) + len(pooled.left_out) == 2
    passes(
        "explain",
        tmp_path / "series",
        "--of",
        "coating_top",
        "--cell-um",
        "50",
        "--out",
        tmp_path / "out",
    )
    assert {p.name for p in (tmp_path / "out").iterdir()} >= {
        "explain.html",
        "explain.json",
        "coefficients.csv",
    }
