"""The folder of a series: a page that needs nothing else, tidy tables, and the same as arrays; the
same bytes again."""

import csv
import re
import shutil

import numpy as np
import pytest
import xarray as xr

import planish as pl
from folders import bytes_of
from planish.core.errors import FileError
from planish.io import write_tree
from planish.report import series_page, small_map
from planish.report.series import natural
from planish.series import Declared, gather, pages, write_series
from planish.series_results import Member, SeriesResults
from report.pages import Page
from series.runs import results_of, series, two_volumes

FILES = ["report.html", "results.json", "specimens.csv", "values.csv"]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Two papers of three sheets, one specimen doubtful, one refused, one with a map; written
    once."""
    home = tmp_path_factory.mktemp("Blätter und mehr")
    rows = [
        (
            {"paper": p, "sheet": str(s)},
            results_of(mean=18.0 + s + (p == "B") * 4, sd=2 + s / 10, r=0.4 + s / 20),
        )
        for p in "AB"
        for s in range(1, 5)
    ]
    rows[3] = ({"paper": "A", "sheet": "4"}, results_of(mean=60.0, trust="doubtful", state="look"))
    members = series(home, *rows)
    odd = 'über "10" <b>'
    members.append(
        Member(
            name=odd,
            factors={"paper": "B"},
            state="refused",
            message="No sheet & no way. Give another.",
        )
    )
    y, x = np.arange(40) * 5.0, np.arange(60) * 5.0
    coating = (
        20 + np.sin(y / 20)[:, None] + 0 * x,
        {"units": "um", "long_name": "Coating thickness, top side"},
    )
    maps = xr.Dataset({"coating_top": (("v", "u"), *coating)}, {"v": y, "u": x})
    shutil.rmtree(home / "run-1" / "maps.zarr")
    write_tree(home / "run-1" / "maps.zarr", {"maps": maps})
    out = home / "out"
    out.mkdir()
    return (
        write_series(members, home, Declared(margin={"coating_top": 1.0}), out),
        members,
        home,
        out,
    )


def files_of(out):
    return {name: data for name, data in bytes_of(out).items() if not name.endswith(".parquet")}


def written_of(members, home):
    """The folder of a series that declares nothing."""
    (home / "out").mkdir()
    write_series(members, home, Declared(), home / "out")
    return home / "out"


def test_the_page_needs_nothing_else_and_no_script(written):
    results, members, _, out = written
    page = Page((out / "report.html").read_text(encoding="utf-8"))
    assert page.sections == ["specimens", "maps", "groups", "differences", "record"]
    assert not {"script", "iframe", "form"} & page.tags
    assert (page.handlers, page.loose) == ([], [])
    outside = [a for a in page.addresses if not a.startswith(("data:", "#", "../run-"))]
    assert outside == []
    assert any("default-src 'none'" in m.get("content", "") for m in page.metas)
    text = page.text()
    for member in members:
        assert member.name in text
    assert "No sheet & no way. Give another." in text
    assert "<b>" not in text.replace('über "10" <b>', "")
    assert results.differences[0].verdict == "differ"
    assert "A and B differ in mean coating thickness (top side): B − A = " in text
    assert "larger than the declared margin of 1" in text


def test_links_lead_to_the_runs_from_the_folder_of_the_page(written):
    _, _, home, out = written
    page = Page((out / "report.html").read_text(encoding="utf-8"))
    links = {a for a in page.addresses if a.endswith("report.html")}
    assert links == {f"../run-{k}/report.html" for k in range(1, 9)}
    again = SeriesResults.read(out / "results.json")
    assert [(out / m.run).resolve() for m in again.members if m.run] == [
        home / f"run-{k}" for k in range(1, 9)
    ]


def test_a_page_that_is_handed_on_has_no_folders_of_the_machine(tmp_path):
    members = series(tmp_path, ({"paper": "A"}, results_of(mean=18.0, sd=2.0)))
    message = "/home/anna/scans/b.tif does not exist. Check the name and the folder."
    members.append(Member(name="b", factors={}, state="refused", message=message))
    out = written_of(members, tmp_path)
    for name in FILES:
        text = (out / name).read_text(encoding="utf-8")
        assert "anna" not in text, name
    assert "b.tif does not exist. Check the name" in (out / "report.html").read_text("utf-8")


def test_a_single_order_is_no_choice(tmp_path):
    members = series(tmp_path, ({"paper": "A"}, results_of(mean=18.0, sd=2.0)))
    text = (written_of(members, tmp_path) / "report.html").read_text(encoding="utf-8")
    assert '<div class="order order-1">' in text
    assert '<input type="radio" checked hidden id="order-1">' in text
    assert ("as listed</label>" in text, "<legend>Order" in text) == (False, False)


def test_the_table_is_written_in_every_order_and_the_style_shows_the_chosen_one(written):
    _, members, _, out = written
    text = (out / "report.html").read_text(encoding="utf-8")
    names = re.findall(
        r'<input type="radio" name="order" id="order-\d"(?: checked)?><label for="order-\d">(.+?)<',
        text,
    )
    bodies = re.findall(r'<div class="order order-(\d)">.*?<tbody>(.*?)</tbody>', text, re.S)
    assert (names, len(bodies)) == (
        ["as listed", "state", "sheet", "mean", "standard deviation"],
        len(names),
    )
    orders = [
        tuple(re.findall(r'<th scope="row" class="name">(?:<a[^>]*>)?(.*?)<', body))
        for _, body in bodies
    ]
    assert all(
        sorted(order) == sorted(orders[0]) and len(order) == len(members) for order in orders
    )
    assert len(set(orders)) == len(orders)
    for number, _ in bodies:
        assert f"#order-{number}:checked ~ .orders > .order-{number}" in text
    by_mean = orders[[o[0] for o in bodies].index("4")]
    assert (by_mean[0], text.count(" checked")) == ("run-1", 1)
    assert sorted(["run-10", "run-2", "Run-1"], key=natural) == ["Run-1", "run-2", "run-10"]


def test_the_same_runs_give_the_same_bytes_also_when_moved(written, tmp_path):
    _, members, home, out = written
    moved = tmp_path / "elsewhere"
    shutil.copytree(home, moved)
    before = files_of(moved / "out")
    slow = [m.model_copy(update={"seconds": 12.5}) for m in members]
    # Over the older ones.
    write_series(slow, moved, Declared(margin={"coating_top": 1.0}), moved / "out")
    assert files_of(moved / "out") == before == files_of(out)
    assert sorted(before) == FILES


def test_tables_hold_every_figure_and_every_specimen(written):
    results, members, _, out = written
    with (out / "specimens.csv").open(encoding="utf-8", newline="") as file:
        specimens = list(csv.DictReader(file))
    assert [row["specimen"] for row in specimens] == [m.name for m in members]
    assert float(specimens[1]["coating_top_mean_um"]) == 20.0
    assert (specimens[3]["coating_top_mean_um_trust"], specimens[3]["checks_look"]) == (
        "doubtful",
        "coverage",
    )
    assert specimens[8]["state"] == "refused"
    with (out / "values.csv").open(encoding="utf-8", newline="") as file:
        values = list(csv.DictReader(file))
    assert {
        "specimen",
        "paper",
        "sheet",
        "quantity",
        "value",
        "unit",
        "low",
        "high",
        "trust",
    } <= values[0].keys()
    [r] = [
        v
        for v in values
        if (v["specimen"], v["quantity"], v["map"], v["at_um"])
        == ("run-1", "r", "coating_top", "100.0")
    ]
    assert (float(r["value"]), float(r["low"]), float(r["high"]), r["paper"]) == (
        0.45,
        0.63,
        0.9,
        "A",
    )
    assert results.quantities[3].what == "r"


def test_a_series_comes_back_as_arrays(written):
    _, members, _, out = written
    study = pl.open_study(out)
    assert study.sizes["specimen"] == len(members)
    coating = study["mean"].sel(map="coating_top")
    assert coating.sel(specimen="run-2").item() == 20.0
    assert np.isnan(coating.values[-1])
    assert coating.attrs["units"] == "um"
    assert study.r.sel(pair="coating_top/image", point_um=100, specimen="run-1").item() == 0.45
    assert study.r_low.sel(pair="coating_top/image", point_um=100, specimen="run-1").item() == 0.63
    assert study.thin_share.sel(map="coating_top", limit_um=5.0).values[0] == 0.02
    assert study.trust.sel(map="coating_top").values.tolist() == [0, 0, 0, 1, 0, 0, 0, 0, -1]
    assert (study.paper.values.tolist(), study.state.values[-1]) == (
        ["A"] * 4 + ["B"] * 5,
        "refused",
    )
    assert study.marks_used.sel(registration="volume/image").values[0] == 3
    assert coating.groupby("paper").mean().sel(paper="B").item() == pytest.approx(24.5)


def test_two_volumes_keep_their_layers_in_arrays_and_have_a_section(tmp_path):
    out = written_of(series(tmp_path, ({}, two_volumes()), ({}, two_volumes(bias=0.7))), tmp_path)
    study = pl.open_study(out)
    assert study.bias.sel(
        pair="ct.coating_top/sections.coating_top", point_um=100
    ).values.tolist() == [0.5, 0.7]
    assert study.bias_low.values.ravel().tolist() == pytest.approx([0.4, 0.6])
    text = Page((out / "report.html").read_text(encoding="utf-8")).text()
    assert "Two instruments" in text
    assert "−1.80 to −1.20" in text  # of the lower limit
    assert "Both show the same down to waves" in text


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("values.csv", None, "holds no values.csv"),
        ("results.json", lambda _: "{", "no results file of a series"),
        ("values.csv", lambda t: t.replace("run-1,", "run-77,"), "run-77"),
        ("values.csv", lambda t: t.replace("20.0", "2x", 1), "is no number"),
        ("values.csv", lambda t: t[:-20], "columns"),
    ],
)
def test_a_damaged_series_is_an_error(written, tmp_path, name, change, words):
    shutil.copytree(written[3], tmp_path / "out")
    path = tmp_path / "out" / name
    if change is None:
        path.unlink()
    else:
        path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(FileError, match=words):
        pl.open_study(tmp_path / "out")


def test_one_specimen_and_none_that_can_be_read_have_a_page_as_well(tmp_path):
    members = series(tmp_path, ({}, results_of()))
    for k, some in enumerate((members, [Member(name="x", state="refused", message="No.")])):
        (tmp_path / f"out{k}").mkdir()
        write_series(some, tmp_path, Declared(), tmp_path / f"out{k}")
    one, none = (
        Page((tmp_path / f"out{k}" / "report.html").read_text(encoding="utf-8")).text()
        for k in (0, 1)
    )
    assert "1 of at least 3 sheets" in one
    assert "No specimen has a run that can be read" in none
    assert pl.open_study(tmp_path / "out1").sizes == {"specimen": 1}


def test_a_factor_with_the_name_of_a_column_keeps_apart(tmp_path):
    study = pl.open_study(
        written_of(series(tmp_path, ({"map": "M", "state": "wet"}, results_of())), tmp_path)
    )
    assert (study.factor_map.values.tolist(), study.state.values.tolist()) == (["M"], ["whole"])
    assert study.factor_state.values.tolist() == ["wet"]


def test_parquet_holds_what_the_table_holds(written):
    pq = pytest.importorskip("pyarrow.parquet")
    import io

    _, members, home, _ = written
    rows = gather(members, home).rows
    table = pq.read_table(
        io.BytesIO(pages.parquet_bytes(*pages.figures_table(rows, ["paper", "sheet"])))
    )
    assert (table.num_rows, table.column("value").to_pylist()) == (
        len(rows),
        [row.value for row in rows],
    )
    assert table.column("paper").to_pylist() == [row.factors["paper"] for row in rows]


def test_two_hundred_specimens_take_less_than_ten_megabytes(written):
    """Fifty kilobytes each, with a map of noise, which packs worst."""
    results, members, _, _ = written
    grey = np.random.default_rng(1).normal(20, 4, (330, 450))
    coords = {"v": np.arange(330) * 4.0, "u": np.arange(450) * 4.0}
    noise = xr.DataArray(grey, coords, ("v", "u"), attrs={"units": "um"})
    maps = [small_map(member.name, noise, pixels=150) for member in members]
    assert len(series_page(results, maps).encode()) < 50_000 * len(members)
