"""The page of several layers: what it shows of each layer and each pair, and that names stay text."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from planish.analyze import PairAtSizes, correlate
from planish.core.numbers import to_spread
from planish.report import largest, relation, summary, write_report
from planish.results import CorrelationRow, Results
from report.pages import Page
from report.runs import lag_of, page_of, registration_of

UM = {"units": "um"}
MICRO = "\u202fµm"
OFFSET, SPREAD = 2.5, 0.8  # um: what map b of the coating has more than map a, and how much that varies

Given = dict[str, Any]


def sheet(coating: np.ndarray, x: np.ndarray, y: np.ndarray, *, joined: bool) -> xr.Dataset:
    """Return a layer with a coating and a thickness."""
    titles = {"coating_top": "Coating thickness, top side", "thickness": "Sheet thickness"}
    values = {"coating_top": coating, "thickness": 90 + 0.2 * coating}
    data = xr.Dataset(
        {k: (("y", "x"), v.astype(np.float32), UM | {"long_name": titles[k]}) for k, v in values.items()},
        {"y": y, "x": x},
    )
    return finish(data, "coating_top", joined=joined)


def finish(data: xr.Dataset, name: str, *, joined: bool) -> xr.Dataset:
    """Add what every layer has beside its maps."""
    y, x = np.meshgrid(data["y"].values, data["x"].values, indexing="ij")
    data["valid"] = (("y", "x"), np.isfinite(data[name].values) & (np.hypot(y - 300, x - 500) > 90))
    if joined:
        error = np.where(np.isfinite(data[name].values), 1 + 0.002 * np.hypot(y - 300, x - 300), np.nan)
        data["expected_error"] = (("y", "x"), error.astype(np.float32), UM)
    return data


def marks_of(seed: int) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    fixed = np.array([[150.0, 120.0], [700.0, 140.0], [430.0, 500.0], [300.0, 330.0]])
    residual = rng.normal(0, 0.8, fixed.shape)
    parts = {"moving": fixed + 3, "fixed": fixed, "residual": residual}
    values = {f"{k}_{axis}": v[:, i] for k, v in parts.items() for i, axis in enumerate("xy")}
    table = xr.Dataset({k: ("mark", v) for k, v in values.items()})
    return table.assign(residual=("mark", np.hypot(*residual.T)), label=("mark", np.array(list("abcd"), dtype=object)))


def rows_of(maps: dict[str, xr.Dataset], a: str, a_map: str, b: str, b_map: str) -> list[Given]:
    """Return the rows of a pair as the program makes them."""
    valid = maps[a]["valid"].values & maps[b]["valid"].values
    p, q = (np.where(valid, maps[n][m].values.astype(float), np.nan) for n, m in ((a, a_map), (b, b_map)))
    pair = PairAtSizes((p.shape[0], p.shape[1]), pixel_um=(6.0, 6.0), point_um=60.0)
    pair.add(0, p, q)
    rows: list[Given] = []
    for row, (u, v) in ((correlate(p, q, pixel_um=6.0), (p, q)), (pair.at_points(), pair.points())):
        found = dict(row)
        rows.append({"a": a, "a_map": a_map, "b": b, "b_map": b_map, **found, "same_quantity": a_map == b_map})
        off = (v - u)[np.isfinite(u) & np.isfinite(v)]
        if a_map == b_map and off.size > 1:
            mean, sd = float(off.mean()), float(off.std(ddof=1))
            limits = [mean - 1.96 * sd, mean + 1.96 * sd]
            rows[-1] |= {"difference_mean": mean, "difference_sd": sd, "limits": limits, "units": "um"}
    return rows


def layers(*, chain: bool = False, blank: bool = False) -> Given:
    """Return a sheet before and after calendering and a photograph, on the pixels of the sheet after it."""
    rng = np.random.default_rng(3)
    y, x = 6.0 * np.arange(100), 6.0 * np.arange(140)
    after = 18 + 4 * np.sin(y / 41)[:, None] * np.cos(x / 55)[None, :]
    before = after - OFFSET + rng.normal(0, SPREAD, after.shape)
    before[:, :20] = np.nan
    photo = 1000 + 30 * (after - 18) + rng.normal(0, 30, after.shape)
    if blank:
        before[:], photo[:] = np.nan, np.nan
    image = xr.Dataset(
        {"image": (("y", "x"), photo.astype(np.float32), {"long_name": "Relative grey, luminance", "units": "1"})},
        {"y": y, "x": x},
    )
    maps = {
        "before": sheet(before, x, y, joined=True),
        "photo": finish(image, "image", joined=True),
        "after": sheet(after, x, y, joined=False),
    }
    marks = {"before": marks_of(1), "photo": marks_of(2)}
    paths = {"before": ("before", "photo", "after") if chain else ("before", "after"), "photo": ("photo", "after")}
    listed: list[Given] = []
    for name in maps:
        layer: Given = {
            "name": name, "kind": "image" if name == "photo" else "sheet",
            "source": {"name": f"{name}.tif", "shape": [100, 140], "dtype": "uint8", "bytes": 14_000,
                       "sha256": "ab" * 32, "size_um": [6.0, 6.0], "size_source": "given"},
            "headline": "image" if name == "photo" else "coating_top", "share_of_reference": 0.86,
        }  # fmt: skip
        if name in paths:
            to = paths[name][1]
            layer["registration"] = registration_of(name, to, path=paths[name])
            layer["registration"]["orientation"] = layer["registration"]["orientation"] | {
                "md_deg_fixed_from_moving": 30.0, "sentence": f"The machine direction lies at 30 deg in {to}."
            }  # fmt: skip
        listed.append(layer)
    listed[0]["registration"]["lag"] = lag_of()
    compared = (
        ("before", "coating_top", "after", "coating_top"),
        ("before", "thickness", "after", "thickness"),
        ("photo", "image", "after", "coating_top"),
    )
    results: Given = {
        "planish": "0.2.0", "versions": {"numpy": "2.4.6"}, "chain": chain, "layers": listed,
        "correlations": [row for which in compared for row in rows_of(maps, *which)],
        "checks": [{"name": "marks", "layers": ["before", "after"], "value": 1.5, "limit": 20.0, "state": "pass",
                   "sentence": "4 marks agree to 1.5 um."}],
        "parameters": {"chain": chain, "layers": [{"name": "before", "volume": {"voxel_um": [3.0, 3.0, 3.0]}}],
                       "holes": {"hole_um": [120.0, 320.0]}},
    }  # fmt: skip
    groups = {f"layers/{name}": data for name, data in maps.items()}
    return {"groups": groups, "marks": marks, "results": results}


@pytest.fixture(scope="module")
def page() -> str:
    return page_of(layers())


@pytest.fixture(scope="module")
def chain_page() -> str:
    return page_of(layers(chain=True))


def captions_of(page: str) -> list[str]:
    return re.findall(r"<figcaption>(.*?)</figcaption>", page, flags=re.DOTALL)


def test_page_shows_every_layer_and_pair(page: str) -> None:
    read = Page(page)
    text = read.text()
    assert read.sections == ["relation", "linked", "registration", "inputs", "checks", "record"]
    assert read.text("title") == "3 layers on the pixels of after"
    for expected in ("before.tif", "photo.tif", "after.tif", "86\u202f%", "1.4; 2.6", "before → after",
                     f"3 marks of before agree to 0.9{MICRO}.", "at 30° in after", "The check passed.",
                     "3 matched, of 5 holes in before and 6 in after", f"Points of 60{MICRO}",
                     f"The expected error is 1.4{MICRO} (rms, median over the worst layer), at most 2.6"):  # fmt: skip
        assert expected in text
    # The first page; residuals and expected error of either layer, the lags of one, two maps side by side, and a figure
    # for each pair.
    captions = captions_of(page)
    assert read.drawings == len(captions) == 3 + 2 * 2 + 1 + 2 + 3
    assert [int(v) for v in re.findall(r"<b>Figure (\d+)\.", page)] == [*range(1, len(captions) + 1)]
    for caption in captions:
        assert re.search(r"\bn\b", caption)
        assert "mask" in caption.lower()


def test_the_page_states_registrations_and_differences_of_the_same_quantity(page: str) -> None:
    # The weakest correlation in a tile and in the scatter of the first page, a caption for each pair, and the table.
    assert len(re.findall("registration: marks only", Page(page).text(), flags=re.IGNORECASE)) == 1 + 1 + 3 + 1
    rows = [largest(group) for group in summary.by_pair(Results.model_validate(layers()["results"]))]
    assert [row.point_um for row in rows] == [60.0] * 3
    assert rows[0].difference_mean == pytest.approx(OFFSET, abs=0.05)
    found = to_spread(rows[0].difference_mean, rows[0].difference_sd)
    assert f"coating thickness (top side) of after minus that of before is {found} µm on average" in Page(page).text()
    drawn = ["the difference (map on the vertical axis minus map on" in c for c in captions_of(page)[3:6]]
    assert drawn == [True, True, False]


def test_difference_and_drawing_have_one_sign_and_a_pair_without_correlation_is_drawn() -> None:
    given = layers()
    a, b = (given["groups"][f"layers/{name}"]["coating_top"] for name in ("before", "after"))
    first, second = relation.block_means(a, b, point_um=60.0)
    row = largest(summary.by_pair(Results.model_validate(given["results"]))[0])
    assert float((second - first).mean()) == pytest.approx(row.difference_mean, abs=0.1)
    a = layers(blank=True)["groups"]["layers/before"]["coating_top"]
    row = CorrelationRow(a="a", a_map="m", b="b", b_map="m", point_um=60.0, n=0, r=None, r2=None, slope=None,
                         intercept=None, same_quantity=True, units="um")  # fmt: skip
    drawn = relation.draw_pair(relation.MapPair(a, a, [row]), names=("a", "b"))
    assert "no correlation" in drawn.svg
    assert "nan" not in drawn.svg


def test_two_instruments_of_one_sheet_are_compared_by_their_difference() -> None:
    given = layers()
    results = given["results"]
    results["layers"] = [results["layers"][0], results["layers"][2]]
    results["correlations"] = [row for row in results["correlations"] if row["a"] == "before"]
    read = Page(page_of(given))
    text = read.text()
    assert read.text("title") == "before.tif linked to after.tif"
    assert "minus that of before is" in text
    assert (
        "Coating thickness (top side) of after is larger where coating thickness (top side) of before is larger" in text
    )
    assert "on the pixels of after" in read.text("figcaption")


def test_two_images_are_called_by_their_names_and_nothing_is_said_of_a_volume() -> None:
    given = layers()
    white, results = given["groups"]["layers/photo"], given["results"]
    uv = white.drop_vars("expected_error").assign(image=-white["image"])
    photo = results["layers"][1]
    maps, registration = {"white": white, "uv": uv}, registration_of("white", "uv")
    rows = [row | {"same_quantity": False} for row in rows_of(maps, "white", "image", "uv", "image")]
    results |= {
        "layers": [
            photo | {"name": "white", "registration": registration},
            photo | {"name": "uv", "registration": None},
        ],
        "correlations": rows,
    }
    given |= {"groups": {f"layers/{name}": data for name, data in maps.items()}, "marks": {"white": marks_of(1)}}
    read = Page(page_of(given))
    assert "Uv is darker (relative grey, luminance) where white is brighter: r = −1.00" in read.text("p")
    assert "A pixel is one of uv." in read.text("p")
    assert "volume" not in read.text("p")
    axes = [f"Relative grey, luminance, {name}" for name in ("white", "uv")]
    assert [read.text("svg").count(axis) for axis in axes] == [3, 3]  # on the first page, and of pixels and of points
    rows[0]["trust"] = rows[1]["trust"] = "doubtful"
    assert "The correlation of white and uv is doubtful" in Page(page_of(given)).text("p")


def test_marks_of_a_chain_are_drawn_in_the_layer_that_they_join(page: str, chain_page: str) -> None:
    text = Page(chain_page).text()
    assert "before → photo → after" in text
    assert "Places are in the coordinates of photo" in text
    assert "Places are in the coordinates of" not in Page(page).text()


def test_layers_without_a_common_point_still_have_a_page() -> None:
    given = layers(blank=True)
    text = Page(page_of(given)).text()
    assert not re.search(r"\b(nan|None|inf)\b", text)
    given["results"]["correlations"] = []
    for layer in given["results"]["layers"][:2]:
        layer["registration"] |= {"expected_error": None, "lag": None, "leave_one_out_rms_um": None}
    given["marks"] = {}
    text = Page(page_of(given)).text()
    assert "No two layers have points in common" in text
    assert not re.search(r"\b(nan|None|inf)\b", text)


def test_names_stay_text() -> None:
    hostile = "<script>alert('x')</script>\"><img src=x onerror=alert(1)> $\\frac$ {{ 7*7 }}"
    given = layers()
    swap = {"before": hostile}
    given["groups"] = {k.replace("before", hostile): v for k, v in given["groups"].items()}
    given["marks"] = {swap.get(k, k): v for k, v in given["marks"].items()}
    for row in given["results"]["correlations"]:
        row["a"] = swap.get(row["a"], row["a"])
    first = given["results"]["layers"][0]
    first["name"] = first["source"]["name"] = hostile
    first["registration"]["path"] = [hostile, "after"]
    given["groups"]["layers/after"]["coating_top"].attrs |= {"long_name": hostile, "units": hostile}
    read = Page(page_of(given))
    assert not read.tags & {"script", "img"}
    assert read.handlers == []
    for tag in ("h1", "figcaption", "svg"):
        assert hostile in read.text(tag)
    assert {a.split(":")[0] for a in read.addresses if not a.startswith("#")} == {"data"}


def test_same_input_gives_the_same_bytes(tmp_path: Path, page: str) -> None:
    given = layers()
    given["results"] = Results.model_validate(given["results"])
    write_report(tmp_path / "report.html", **given)
    assert (tmp_path / "report.html").read_bytes() == page.encode("utf-8")
