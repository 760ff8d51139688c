"""What the tab Maps says: values at the cursor and along a line, densities, and selections of all
pixels."""

import base64
import math
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from folders import refused
from planish.app import pictures, selection
from planish.app.selection import (
    Brush,
    Rectangle,
    Stopped,
    cursor,
    density,
    histogram,
    nearest,
    profile,
    select,
)
from planish.core.area import halved, overviews
from planish.core.errors import InputError
from planish.io import write_tree
from planish.report import colours
from planish.run import open_run

SHAPE, PIXEL, ORIGIN = (700, 1100), (2.0, 2.5), (-30.0, 10.0)


@pytest.fixture(scope="module")
def maps():
    rng = np.random.default_rng(7)
    shared = rng.normal(size=(SHAPE[0] // 10, SHAPE[1] // 10)).repeat(10, 0).repeat(10, 1)
    a = (80 + 3 * shared + rng.normal(0, 2, SHAPE)).astype(np.float32)
    b = (100 + 9 * shared + rng.normal(0, 9, SHAPE)).astype(np.float32)
    a[100:140, 300:420] = np.nan
    valid = np.isfinite(a) & (rng.random(SHAPE) > 0.02)
    grid = {
        "y": ORIGIN[1] + PIXEL[0] * np.arange(SHAPE[0]),
        "x": ORIGIN[0] + PIXEL[1] * np.arange(SHAPE[1]),
    }
    um = {"units": "um", "role": "property", "long_name": "Coating"}
    y, x = np.meshgrid(grid["y"], grid["x"], indexing="ij")
    places = {
        f"volume_{n}": (("y", "x"), v, {"units": "um"})
        for n, v in (("x", x + 5), ("y", y * 2), ("z", y - x))
    }
    found = {
        "coating": (("y", "x"), a, um),
        "image": (("y", "x"), b, {"units": "1"}),
        "valid": (("y", "x"), valid),
    }
    return xr.Dataset(found | places, coords=grid)


@pytest.fixture(scope="module")
def tiles(maps, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    smaller = {f"overviews/linked/{k}": one for k, one in enumerate(overviews(maps), 1)}
    write_tree(folder / "maps.zarr", {"linked": maps} | smaller)
    return pictures.Tiles(
        pictures.Pictures(pictures.group_pictures(folder, "linked", plane="fixed", layer="image"))
    )


@pytest.fixture(scope="module")
def pair(tiles):
    by = {p.name: p for p in tiles.pictures}
    return by["coating"], by["image"]


def known(maps, x0, y0, x1, y1):
    """Values of both maps in a region where they count: by their coordinates, not by rows and
    columns."""
    part = maps.where(maps.valid).sel(y=slice(y0, y1), x=slice(x0, x1))
    both = np.isfinite(part.coating.values) & np.isfinite(part.image.values)
    return part.coating.values[both].astype(float), part.image.values[both].astype(float)


# --- cursor and profile ---------------------------------------------------------------------------
@pytest.mark.parametrize(("row", "col"), [(0, 0), (120, 350), (511, 512), (699, 1099)])
def test_the_cursor_has_the_values_of_the_pixel_around_it(maps, tiles, pair, row, col):
    # Anywhere within the pixel, up to its border.
    x, y = ORIGIN[0] + PIXEL[1] * (col + 0.49), ORIGIN[1] + PIXEL[0] * (row - 0.49)
    found = cursor(tiles, pair[0], x, y)
    assert (found["row"], found["col"]) == (row, col)
    values = {one["name"]: one["value"] for one in found["values"]}
    assert set(values) == set(maps.data_vars)
    for name, value in values.items():
        expected = float(maps[name].values[row, col])
        assert (value is None) if math.isnan(expected) else (value == expected)
    assert [found["volume"][axis] for axis in "xyz"] == [
        float(maps[f"volume_{axis}"].values[row, col]) for axis in "xyz"
    ]


def test_the_cursor_beside_the_picture_has_no_values_and_corners_may_stand_in_any_order(
    tiles, pair
):
    found = cursor(tiles, pair[0], ORIGIN[0] - PIXEL[1], ORIGIN[1])
    assert (found["row"], found["volume"], {one["value"] for one in found["values"]}) == (
        None,
        None,
        {None},
    )
    one, other = (
        select(tiles, *pair, region=Rectangle(*at))
        for at in ((200, 100, 900, 400), (900, 400, 200, 100))
    )
    assert one == other


def test_a_profile_has_the_pixels_that_a_line_crosses(maps, tiles, pair):
    row = 120
    y = ORIGIN[1] + PIXEL[0] * row
    found = profile(tiles, [*pair], (ORIGIN[0] + PIXEL[1] * 250, y, ORIGIN[0] + PIXEL[1] * 450, y))
    assert (found["pixel_um"], found["at_um"][-1]) == (2.0, pytest.approx(200 * PIXEL[1]))
    cols = np.floor(250 + np.array(found["at_um"]) / PIXEL[1] + 0.5).astype(int)
    for line in found["lines"]:
        expected = np.where(
            maps.valid.values[row, cols], maps[line["name"]].values[row, cols], np.nan
        )
        np.testing.assert_array_equal(np.array(line["values"], float), expected)
    assert None in found["lines"][0]["values"]


def test_a_long_profile_comes_from_a_coarser_level(maps, tiles, pair, monkeypatch):
    monkeypatch.setattr("planish.app.selection.MOST_SAMPLES", 300)
    y = ORIGIN[1] + PIXEL[0] * 20.5  # the middle of row 10 of the first overview
    found = profile(tiles, [pair[1]], (ORIGIN[0], y, ORIGIN[0] + PIXEL[1] * 400, y))
    assert found["pixel_um"] == 4.0
    small, cols = halved(maps), np.floor(np.array(found["at_um"]) / PIXEL[1] + 0.5).astype(int) // 2
    coarse = np.where(small.valid.values[10, cols], small.image.values[10, cols], np.nan)
    np.testing.assert_array_equal(np.array(found["lines"][0]["values"], float), coarse)


@pytest.mark.parametrize("kind", ["upright", "laid"])
def test_both_ends_of_a_mark_show_one_place_of_the_volume(kinds, kind):
    run = open_run(kinds(kind))
    tiles = pictures.Tiles(pictures.Pictures.of(run.folder))
    by = {(p.plane, p.name): p for p in tiles.pictures}
    pairs = run.marks[["moving_x", "moving_y", "fixed_x", "fixed_y"]].to_dataframe().dropna()
    assert len(pairs) >= 4
    for _, one in pairs.iterrows():
        on_sheet = cursor(tiles, by["moving", "thickness"], one.moving_x, one.moving_y)["volume"]
        on_image = cursor(tiles, by["fixed", "thickness"], one.fixed_x, one.fixed_y)["volume"]
        # A pixel of 4 um of either plane, and the residual of a mark of a few um.
        for axis in "xyz":
            assert on_sheet[axis] == pytest.approx(on_image[axis], abs=12)


# --- what is selected -----------------------------------------------------------------------------
@pytest.mark.parametrize(
    "region", [(200.0, 100.0, 1500.0, 900.0), (ORIGIN[0], ORIGIN[1], 1000.0, 500.0)]
)
def test_n_and_r_of_a_region_are_those_of_its_pixels(maps, tiles, pair, region):
    a, b = known(maps, *region)
    found = select(tiles, *pair, region=Rectangle(*region))
    assert (found["n"], found["r"]) == (a.size, pytest.approx(np.corrcoef(a, b)[0, 1], abs=1e-6))
    assert found["interval"][0] < found["r"] < found["interval"][1]
    # Ten pixels a side vary together: about 1 of 100 is independent, not all, and not only a few.
    assert a.size / 400 < found["n_eff"] < a.size / 10


def test_the_pose_is_called_a_negative_control(tiles, pair):
    a, b = pair
    assert not any("negative control" in text for text in select(tiles, a, b)["warnings"])
    warp = replace(a, name="warp", title="Warp")
    assert select(tiles, warp, b)["warnings"][0] == (
        "Warp is the pose of the sheet in the scanner: a negative control, no property."
    )


def test_brushed_pixels_are_counted_and_nothing_is_said_of_r(maps, tiles, pair):
    a, b = known(maps, -1e9, -1e9, 1e9, 1e9)
    brushes = [Brush(pair[0], 78.0, 82.5), Brush(pair[1], 95.0, 120.0)]
    found = select(tiles, *pair, brushes=brushes)
    assert found["n"] == np.count_nonzero((a >= 78) & (a <= 82.5) & (b >= 95) & (b <= 120))
    assert (found["r"], found["interval"]) == (None, None)
    a, _ = known(maps, 200, 100, 900, 400)
    assert select(tiles, *pair, brushes=brushes[:1], region=Rectangle(200, 100, 900, 400))[
        "n"
    ] == np.count_nonzero((a >= 78) & (a <= 82.5))


def test_a_region_beside_the_map_and_a_line_without_length_are_refused(tiles, pair):
    refused(InputError, "No pixel", select, tiles, *pair, region=Rectangle(1e6, 1e6, 2e6, 2e6))
    refused(InputError, "no length", profile, tiles, [pair[0]], (5.0, 5.0, 5.0, 5.0))


def test_a_selection_that_is_not_wanted_any_more_ends(tiles, pair):
    stop = threading.Event()
    stop.set()
    for brushes in ([], [Brush(pair[0], 0, 100)]):
        with pytest.raises(Stopped):
            select(tiles, *pair, brushes=brushes, stop=stop)


# --- densities ------------------------------------------------------------------------------------
def counts_of(found):
    return np.frombuffer(base64.b64decode(found["counts"]), "<u4").reshape(
        found["bins"], found["bins"]
    )


def test_the_density_counts_every_point(maps, tiles, pair):
    a, b = known(maps, -1e9, -1e9, 1e9, 1e9)
    found = density(tiles, *pair)
    counts = counts_of(found)
    assert (found["n"], found["pixel_um"], counts.sum()) == (
        a.size,
        PIXEL,
        a.size - found["beyond"],
    )
    assert found["beyond"] < 0.01 * a.size
    edges = [
        np.linspace(found[f"{which}_low"], found[f"{which}_high"], 129) for which in ("b", "a")
    ]
    expected, _, _ = np.histogram2d(b, a, bins=edges)
    # A value on the border of two bins may be rounded into either.
    assert np.abs(counts - expected).sum() < 1e-4 * a.size


def test_a_large_map_is_drawn_from_an_overview_which_is_said(maps, tiles, pair, monkeypatch):
    monkeypatch.setattr(selection, "BASE_PIXELS", 200_000)
    found = density(tiles, *pair)
    smaller = halved(maps)
    both = (
        smaller.valid.values
        & np.isfinite(smaller.coating.values)
        & np.isfinite(smaller.image.values)
    )
    assert (found["n"], found["pixel_um"]) == (np.count_nonzero(both), (4.0, 5.0))


def test_points_of_a_region_and_histograms_count_valid_values(maps, tiles, pair):
    region = (200.0, 100.0, 900.0, 400.0)
    a, _ = known(maps, *region)
    whole, part = density(tiles, *pair), density(tiles, *pair, Rectangle(*region))
    assert part["n"] == a.size
    for limit in ("a_low", "a_high", "b_low", "b_high"):
        assert part[limit] == whole[limit]
    assert (counts_of(part) <= counts_of(whole)).all()
    a = maps.coating.values[maps.valid.values].astype(float)
    found = histogram(tiles, pair[0])
    assert (found["n"], sum(found["counts"])) == (a.size, a.size - found["beyond"])
    np.testing.assert_allclose(
        [found["mean"], found["sd"], found["median"]], [a.mean(), a.std(ddof=1), np.median(a)]
    )
    np.testing.assert_allclose(found["range"], np.percentile(a, [2, 98]))


def test_a_histogram_of_an_axis_has_its_mean_and_a_selection_no_r(maps, tmp_path):
    rng = np.random.default_rng(0)
    wrapped = ((85 + rng.normal(0, 12, SHAPE) + 90) % 180 - 90).astype(np.float32)
    attrs = {"units": "deg", "support_um": 2.0, "period_deg": 180.0, "long_name": "Axis"}
    axis = maps[["image"]].assign(axis=(("y", "x"), wrapped, attrs))
    smaller = {f"overviews/linked/{k}": one for k, one in enumerate(overviews(axis), 1)}
    write_tree(tmp_path / "maps.zarr", {"linked": axis} | smaller)
    tiles = pictures.Tiles(
        pictures.Pictures(pictures.group_pictures(tmp_path, "linked", plane="fixed", layer="image"))
    )
    by_name = {p.name: p for p in tiles.pictures}
    found = histogram(tiles, by_name["axis"])
    assert found["mean"] == pytest.approx(85, abs=0.2)
    assert found["sd"] == pytest.approx(12, abs=0.2)
    assert found["median"] == pytest.approx(85, abs=0.2)
    chosen = select(tiles, by_name["image"], by_name["axis"])
    assert (chosen["n"], chosen["r"], chosen["interval"]) == (wrapped.size, None, None)


def test_a_picture_without_a_mask_is_counted_without_its_holes(maps, tmp_path):
    x, y = (float(maps[axis].values.mean()) for axis in "xy")
    away = np.hypot(maps.y - y, maps.x - x)
    image = maps[["image"]].where(away > 250, -1e4)
    write_tree(tmp_path / "maps.zarr", {"linked": image, "overviews/linked/1": halved(image)})
    tiles = pictures.Tiles(
        pictures.Pictures(pictures.group_pictures(tmp_path, "linked", plane="fixed", layer="image"))
    )
    [picture] = tiles.pictures
    holes = xr.Dataset({"x": ("mark", [x]), "y": ("mark", [y]), "diameter": ("mark", [500.0])})
    assert histogram(tiles, picture)["range"][0] < -9e3
    found = histogram(tiles, picture, holes=holes)
    outside = maps.image.values[away.values >= 375]
    np.testing.assert_allclose(found["range"], np.percentile(outside, [2, 98]), rtol=1e-3)


def test_the_pixel_next_to_a_place_in_the_volume(maps, tiles, pair):
    at = {"y": float(maps.volume_y[300, 500]) + 0.3, "x": float(maps.volume_x[300, 500]) - 0.2}
    x, y = nearest(tiles, pair[0], "image", at)
    assert (x, y) == (float(maps.x[500]), float(maps.y[300]))
    assert nearest(tiles, pair[0], "image", {"w": 1.0}) is None


def test_the_page_has_the_colour_scales_of_the_report():
    text = (Path(selection.__file__).parent / "static" / "colour.js").read_text(encoding="utf-8")
    assert len(colours._ANCHORS) > 4
    for name, anchors in colours._ANCHORS.items():
        assert f'{name}:\n    "{anchors}"' in text or f'{name}: "{anchors}"' in text
