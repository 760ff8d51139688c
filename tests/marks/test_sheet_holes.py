"""Holes followed through the sheet, in maps and in a volume whose holes are formulas."""

import numpy as np
import pytest
import xarray as xr

from folders import refused
from planish.checks import check_holes
from planish.core.errors import MarkError, SizeError
from planish.core.frame import Frame
from planish.core.tiles import Engine
from planish.marks import HoleParams, find_holes, find_sheet_holes, hole_tilt
from planish.surface import assemble
from planish.surface.columns import Columns
from surface.sheets import volume

PIXEL = 4.0
SHAPE = (280, 320)
CENTRES = np.array(
    [
        (250.0, 220.0),
        (700.0, 230.0),
        (1050.0, 300.0),
        (240.0, 640.0),
        (660.0, 800.0),
        (1060.0, 860.0),
    ]
)
# From the middle of the top's layer to that of the bottom's, in shares of the thickness.
APART = 0.52


def layer_map(name, leans, *, diameter=170.0, taper=0.15, depth=None, centres=CENTRES):
    """Share of material in a layer; a hole moves by its lean, and loses ``taper`` of its diameter,
    from face to face.

    ``depth``: how deep each hole was burnt, from the top face, in shares of the thickness.
    """
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] * PIXEL
    out = 1.0 + np.random.default_rng(0).normal(0, 0.03, SHAPE)
    t = np.linspace(*assemble.LAYERS[name], 21)[:, None]
    depth = np.ones(len(centres)) if depth is None else depth
    for (u, v), (a, b), deep in zip(
        centres, np.broadcast_to(leans, centres.shape), depth, strict=True
    ):
        near = np.hypot(x - u, y - v) < diameter + np.hypot(a, b)
        r = np.hypot(x[near] - u + t * a, y[near] - v + t * b)
        hollow = np.clip(0.5 - (r - 0.5 * diameter * (1 + taper * t)) / PIXEL, 0, 1)
        out[near] -= np.mean(hollow * (0.5 - t < deep), axis=0)
    return out


def layer_maps(leans, **more):
    return [layer_map(name, leans, **more) for name in assemble.LAYERS]


def dataset(*layers, pixel=(PIXEL, PIXEL), origin=(0.0, 0.0), **attrs):
    """Maps of the layers that are there, top, centre, bottom."""
    (rows, cols), names = layers[0].shape, list(assemble.LAYERS)
    data = {
        name: (("v", "u"), layer)
        for name, layer in zip(names, layers, strict=False)
        if layer is not None
    }
    coords = {
        "v": origin[0] + np.arange(rows) * pixel[0],
        "u": origin[1] + np.arange(cols) * pixel[1],
    }
    return xr.Dataset(data, coords=coords, attrs=attrs)


def xy(holes, suffix=""):
    return np.stack([holes[f"x{suffix}"].values, holes[f"y{suffix}"].values], axis=1)


def followed(holes):
    """How many run through, end within the sheet, and are unclear."""
    return holes.attrs["through"], holes.attrs["closed"], holes.attrs["unclear"]


ORDERED = CENTRES[np.lexsort(CENTRES.T)]


def test_an_oblique_laser_is_measured():
    lean = np.array([14.0, -9.0])
    maps = layer_maps(lean)
    found = find_sheet_holes(dataset(*maps, layers_apart_um=APART * 100.0))
    assert found.sizes == {"mark": 6}
    for name, share in (("_top", 0.26), ("_centre", 0.0), ("_bottom", -0.26), ("", 0.26)):
        error = xy(found, name) - (ORDERED - share * lean)
        assert np.abs(error).max() < 0.5
    np.testing.assert_allclose(found.attrs["offset_um"], APART * lean, atol=0.2)
    np.testing.assert_allclose(
        found.attrs["tilt_deg"], np.degrees(np.arctan(lean / 100.0)), atol=0.3
    )
    assert np.max(found.attrs["offset_spread_um"]) < 0.5
    # Over 0.52 of the thickness 15 % of the diameter from face to face: 13 um.
    narrower = found["diameter_top"].values - found["diameter_bottom"].values
    np.testing.assert_allclose(narrower, 0.15 * APART * 170.0, atol=1.5)
    assert (found["cov_xx_bottom"].values > 0).all()
    assert followed(found) == (6, 0, 0)
    assert (found["other_side"].values == 0).all()


@pytest.mark.ci
def test_the_side_that_the_image_shows():
    lean = np.array([10.0, 6.0])
    maps = layer_maps(lean)
    top, bottom = (find_sheet_holes(dataset(*maps), side=side) for side in ("top", "bottom"))
    plain = find_holes(maps[0], pixel_um=PIXEL, polarity="dark")
    for name in plain.data_vars:
        np.testing.assert_array_equal(top[name], plain[name])
    np.testing.assert_array_equal(xy(bottom), xy(bottom, "_bottom"))
    np.testing.assert_allclose(xy(bottom), xy(top, "_bottom"), atol=0.3)
    np.testing.assert_allclose(bottom.attrs["offset_um"], top.attrs["offset_um"], atol=0.3)
    moved = find_sheet_holes(dataset(*maps, origin=(-30.0, 70.0)))
    for name in ("", "_bottom"):
        np.testing.assert_allclose(
            xy(moved, name), xy(top, name) + np.array([70.0, -30.0]), atol=1e-9
        )
    assert moved["x"].attrs["units"] == "um"


@pytest.mark.ci
def test_holes_that_are_half_through_are_counted():
    depth = np.array([1.0, 0.5, 1.0, 0.5, 1.0, 1.0])
    maps = layer_maps(np.array([8.0, 0.0]), depth=depth)
    found = find_sheet_holes(dataset(*maps))
    closed = depth[np.lexsort(CENTRES.T)] < 1
    assert found.sizes == {"mark": 6}
    np.testing.assert_array_equal(found["other_side"].values == 1, closed)
    for name in ("x_bottom", "diameter_bottom", "cov_xy_bottom", "offset_y"):
        np.testing.assert_array_equal(np.isnan(found[name].values), closed)
    assert np.isfinite(found["x_top"].values).all()
    assert followed(found) == (4, 2, 0)
    assert found.attrs["offset_count"] == 4
    # Seen from below, the two are not there.
    below = find_sheet_holes(dataset(*maps), side="bottom")
    assert (below.sizes, below.attrs["other_side_only"]) == ({"mark": 4}, 2)


def test_holes_that_are_not_round_or_not_known_on_the_other_side_are_unclear():
    maps = layer_maps(np.zeros(2))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] * PIXEL
    maps[2][(np.hypot(x - 250, y - 220) < 100) & (x > 265)] = 1.0
    maps[2][np.hypot(x - 700, y - 230) < 60] = np.nan
    found = find_sheet_holes(dataset(*maps))
    assert found["other_side"].values.tolist() == [2, 2, 0, 0, 0, 0]
    assert followed(found) == (4, 0, 2)


def test_noise_of_a_sheet_that_is_hardly_lighter_than_its_holes_hides_none():
    """As in resin: its noise is a third of the contrast, and alone makes the floors of the holes
    uneven."""
    rng = np.random.default_rng(5)
    maps = [
        np.clip(0.25 + 0.6 * m + rng.normal(0, 0.2, m.shape), 0, 1) for m in layer_maps([0.0, 0.0])
    ]
    found = find_sheet_holes(dataset(*maps))
    assert (found.sizes["mark"], found.attrs["through"], found.attrs["openings"]) == (6, 6, 0)
    assert np.abs(xy(found) - CENTRES).max() < 2.0


def test_leans_that_differ_are_a_spread():
    leans = np.array(
        [(0.0, 4.0), (20.0, -4.0), (-20.0, 2.0), (10.0, 0.0), (-10.0, -2.0), (2.0, 0.0)]
    )
    found = find_sheet_holes(dataset(*layer_maps(leans)))
    true = APART * leans[np.lexsort(CENTRES.T)]
    np.testing.assert_allclose(
        np.stack([found["offset_x"], found["offset_y"]], axis=1), true, atol=0.6
    )
    median = np.median(true, axis=0)
    np.testing.assert_allclose(found.attrs["offset_um"], median, atol=0.4)
    spread = 1.4826 * np.median(np.abs(true - median), axis=0)
    np.testing.assert_allclose(found.attrs["offset_spread_um"], spread, rtol=0.2)
    np.testing.assert_allclose(
        found.attrs["offset_error_um"], 1.2533 * spread / np.sqrt(6), rtol=0.2
    )


@pytest.mark.ci
def test_far_offsets_are_followed_as_long_as_the_holes_are_round():
    """Up to 0.4 diameters; holes that lean more are smeared in the maps, and none is made up."""
    lean = np.array([0.0, 140.0])
    depth = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.5])
    found = find_sheet_holes(dataset(*layer_maps(lean, taper=0.0, depth=depth)))
    assert (found.attrs["through"], found.attrs["closed"]) == (5, 1)
    np.testing.assert_allclose(found.attrs["offset_um"], APART * lean, atol=1.0)
    found = find_sheet_holes(dataset(*layer_maps(2 * lean, taper=0.0)))
    assert found.attrs["through"] == 0


def test_a_run_that_has_the_top_only():
    top = layer_map("presence", np.zeros(2))
    found = find_sheet_holes(dataset(top))
    assert found.sizes == {"mark": 6}
    np.testing.assert_array_equal(xy(found), xy(found, "_top"))
    for name in ("x_centre", "y_bottom", "offset_x"):
        assert np.isnan(found[name].values).all()
    assert found.attrs["layers"] == ["top"]
    assert followed(found) == (0, 0, 6)
    assert np.isnan(found.attrs["offset_um"]).all()
    assert "No hole was found on both sides" in hole_tilt(found).sentence
    # Maps that hold the top's layer only give its holes for either side, and say so.
    below = find_sheet_holes(dataset(top), side="bottom")
    assert below.attrs["side"] == "top"
    np.testing.assert_array_equal(xy(below), xy(found))


@pytest.mark.ci
def test_a_common_offset_is_followed_to_the_face():
    """The layer's middle lies .24 of the thickness below its face, .52 above the other's."""
    lean = np.array([14.0, -9.0])
    maps = dataset(*layer_maps(lean), layers_apart_um=52.0, layer_to_face=0.24 / 0.52)
    for side, share in (("top", 0.5), ("bottom", -0.5)):
        found = find_sheet_holes(maps, side=side)
        assert np.abs(xy(found) - (ORDERED - share * lean)).max() < 0.6
        to_face = np.broadcast_to(found.attrs["to_face_um"], (6, 2))
        np.testing.assert_allclose(xy(found) - xy(found, f"_{side}"), to_face, atol=1e-9)
        assert hole_tilt(found).sentence.startswith("6 holes run through the sheet, shifted by 8.")
    few = find_sheet_holes(
        dataset(*layer_maps(lean, centres=CENTRES[:3]), layer_to_face=0.24 / 0.52)
    )
    assert few.attrs["to_face_um"] == [0.0, 0.0]
    assert hole_tilt(find_holes(maps["presence"].values, pixel_um=PIXEL)) is None


def test_sheets_without_holes_are_followed_and_impossible_requests_refused():
    plain = [np.ones(SHAPE)] * 3
    maps = dataset(*plain)
    found = find_sheet_holes(maps)
    assert found.sizes == {"mark": 0}
    assert {"x", "x_bottom", "offset_y", "other_side"} <= set(found.data_vars)
    assert np.isnan(found.attrs["offset_um"]).all()
    one = find_sheet_holes(dataset(*layer_maps(np.zeros(2), centres=CENTRES[:1])))
    assert one.attrs["offset_count"] == 1
    assert np.isfinite(one.attrs["offset_um"]).all()
    assert np.isnan(one.attrs["offset_spread_um"]).all()
    refused(MarkError, "'top' or the 'bottom'", find_sheet_holes, maps, side="left")
    refused(
        MarkError,
        "no layer.*presence or presence_bottom",
        find_sheet_holes,
        maps[["presence_centre"]],
    )
    refused(
        MarkError, "diameters", find_sheet_holes, maps, params=HoleParams(hole_um=(300.0, 100.0))
    )
    refused(SizeError, "2 x 2", find_sheet_holes, maps.isel(u=slice(1)))


def test_oblique_holes_in_a_volume():
    """Voxels of a tilted sheet; its holes lean by 8 and -5 degrees against the sheet's normal."""
    voxel, thickness, radius, slope = 3.0, 90.0, 70.0, 0.2
    z, y, x = np.meshgrid(*(np.arange(n) * voxel for n in (66, 150, 200)), indexing="ij")
    long = np.hypot(1.0, slope)
    height = 100.0 + slope * (x - x.mean())
    s = (z - height) / long
    foot = x + s * slope / long
    lean = np.tan(np.radians([8.0, -5.0]))
    solid = np.abs(s) < 0.5 * thickness
    holes = [(160.0, 140.0), (430.0, 130.0), (300.0, 310.0)]
    for u, v in holes:
        # The place in the sheet, from the hole's own middle, along the slope and across it.
        along, across = (foot - u) * long - s * lean[0], y - v - s * lean[1]
        solid &= np.hypot(along, across) > radius * (1 + 0.2 * s / thickness)
    grey = np.where(solid, 180, 20).astype(np.uint8)
    columns = Columns(volume=volume(grey, voxel), frame=Frame())
    present = assemble.find_presence(
        columns, height[0], thickness, 1.0, (20.0, 180.0), Engine(threads=1)
    )
    pixel = (voxel, voxel * long)
    found = find_sheet_holes(
        dataset(*present.values(), pixel=pixel, layers_apart_um=APART * thickness)
    )
    assert found.sizes == {"mark": 3}
    expected = APART * thickness * -lean
    np.testing.assert_allclose(found.attrs["offset_um"], expected, atol=0.3 * voxel)
    np.testing.assert_allclose(
        xy(found, "_centre"),
        sorted(((u * long, v) for u, v in holes), key=lambda p: p[1]),
        atol=0.3 * voxel,
    )


def test_stretched_openings_are_counted_and_many_are_a_look():
    """Half of the sheet is squeezed to a half along x, as where every second slice is missing."""
    maps = layer_maps(np.zeros(2))
    right = find_sheet_holes(dataset(*maps))
    assert (right.attrs["openings"], check_holes(right).state) == (0, "pass")
    column = np.arange(SHAPE[1])
    keep = np.flatnonzero((column < 140) | (column % 2 == 0))
    found = find_sheet_holes(dataset(*(layer[:, keep] for layer in maps)))
    assert found.attrs["openings"] == 6 - found.sizes["mark"] >= 3
    check = check_holes(found)
    assert check.state == "look"
    assert "openings as large as holes are not round enough" in check.sentence
    assert {"position", "properties", "correlation"} == set(check.figures)


def test_faces_show_holes_whose_rims_are_blurred_in_the_base():
    """As in resin with charred walls, which are as dark as the resin: the base shows ragged rims,
    the coatings round ones."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] * PIXEL
    maps, faces = layer_maps([0.0, 0.0]), np.ones(SHAPE)
    for u, v in CENTRES:
        away, angle = np.hypot(x - u, y - v), np.arctan2(y - v, x - u)
        faces[away < 85.0] = 0.0
        for layer in maps:
            layer[away < 105.0 + 30.0 * np.sin(3 * angle)] = 0.1
    maps = [np.clip(m + rng.normal(0, 0.1, SHAPE), 0, 1) for m in maps]
    assert find_sheet_holes(dataset(*maps)).sizes["mark"] < 6
    shown = dataset(*maps).assign(presence_faces=(("v", "u"), faces))
    found = find_sheet_holes(shown)
    assert (found.sizes["mark"], followed(found)) == (6, (6, 0, 0))
    assert np.abs(xy(found) - ORDERED).max() < 1.0
    assert found.attrs["offset_count"] == 0
