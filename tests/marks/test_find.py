import numpy as np
import pytest
import xarray as xr
from benchmarks.hole_scenes import make_presence, make_scene

from folders import refused
from marks.holes import make_hole, scene
from planish.core.errors import MarkError, SizeError
from planish.marks import find_holes, hole_criteria, rims

NAMES = {
    "x",
    "y",
    "cov_xx",
    "cov_yy",
    "cov_xy",
    "diameter",
    "axis_ratio",
    "arc_coverage",
    "contrast",
}


def positions(holes):
    return np.stack([holes.x.values, holes.y.values], axis=1)


def compare(holes, truth):
    """Found, false, missed and the errors of the centres found, in um."""
    found = positions(holes)
    away = np.linalg.norm(found[:, None] - truth[None], axis=2).reshape(len(found), len(truth))
    hit = np.flatnonzero(away.min(axis=1, initial=np.inf) < 30)
    partner = away[hit].argmin(axis=1) if len(truth) else np.empty(0, int)
    assert len(set(partner)) == len(hit), "one hole found twice"
    return len(hit), len(found) - len(hit), len(truth) - len(hit), found[hit] - truth[partner]


def some_holes(rng, diameter=175.0):
    """Eight holes on 2500 x 2000 um."""
    places = np.mgrid[350:2000:500, 450:2000:1000].reshape(2, -1).T + rng.uniform(-100, 100, (8, 2))
    return [make_hole(rng, *place, diameter) for place in places]


@pytest.mark.parametrize("length_um", [30, 200])
def test_a_sheet_without_holes_gives_an_empty_dataset(length_um):
    for seed, mottle in enumerate((0.05, 0.15, 0.3)):
        rng = np.random.default_rng(seed)
        sheet = scene(rng, (300, 400), 5.0, [], mottle=mottle, length_um=length_um)
        found = find_holes(sheet.image, pixel_um=5.0)
        assert (found.sizes, set(found.data_vars)) == ({"mark": 0}, NAMES)


@pytest.mark.parametrize("length_um", [80, 150])
def test_mottle_as_strong_as_the_holes_are_deep_hides_none(length_um):
    """The holes are less than three standard deviations of the sheet deep; nothing of it is as
    black and as flat."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        sheet = scene(
            rng, (400, 500), 5.0, some_holes(rng), mottle=0.3, length_um=length_um, noise=0.01
        )
        hits, false, missed, errors = compare(find_holes(sheet.image, pixel_um=5.0), sheet.centres)
        assert (hits, false, missed) == (8, 0, 0)
        assert np.sqrt(np.mean(errors**2)) <= 0.1 * 5.0 + 1.0


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((50, 60)),
        np.full((40, 40), np.nan),
        np.ones((3, 400)),
        np.empty((0, 0)),
        np.full((300, 300), 255, np.uint8),
    ],
)
def test_images_with_nothing_in_them(image):
    assert find_holes(image, pixel_um=5.0).sizes == {"mark": 0}


def test_the_centre_is_that_of_the_hole_and_not_of_the_char():
    """A char ring that lies 25 um off centre does not pull."""
    rng = np.random.default_rng(0)
    hole = make_hole(rng, 500.0, 400.0, 180.0, rough=0.0, ratio=1.0)
    angle = np.arange(len(hole.char)) * 2 * np.pi / len(hole.char)
    hole.char = 42.0 + 25.0 * np.cos(angle)
    sheet = scene(rng, (300, 400), 2.6, [hole], mottle=0.05)
    found = find_holes(sheet.image, pixel_um=2.6)
    np.testing.assert_allclose(positions(found), [[500.0, 400.0]], atol=1.0)
    # The rim at half level of hole and char; 3 um of blur and the taper of the wall move it by a
    # few um at most.
    assert found.diameter.values == pytest.approx(180, abs=5)
    # Without roughness the stated error is a tenth of a pixel at most.
    assert np.sqrt(found.cov_xx.values) < 0.26


@pytest.mark.ci
def test_grey_scale_does_not_matter():
    rng = np.random.default_rng(1)
    grey = scene(rng, (500, 625), 4.0, some_holes(rng), noise=0.01).image
    reference = positions(find_holes(grey, pixel_um=4.0))
    assert len(reference) == 8
    for image in (
        (grey * 120).clip(0, 255).astype(np.uint8),
        (grey * 30000).clip(0, 65535).astype(np.uint16),
        grey.astype(np.float32) * 1e-6,
        grey * 3.0 + 1e6,
        255 - (grey * 120).clip(0, 255).astype(np.uint8),
        xr.DataArray(grey, dims=("y", "x")),
    ):
        found = find_holes(image, pixel_um=4.0)
        # 8 bit rounding is 0.2 % of the paper's brightness
        np.testing.assert_allclose(positions(found), reference, atol=0.2)


@pytest.mark.ci
def test_turn_and_swap_move_the_marks_along():
    sheet = make_scene(2, "mottle", 12)
    image, size = sheet.image, sheet.pixel
    reference = positions(find_holes(image, pixel_um=size))
    rows, columns = image.shape

    def ordered(points):
        return points[np.lexsort((points[:, 0], points[:, 1]))]

    # Where two edges on a ray are alike, rounding decides; one ray in 96 moves a centre by a tenth
    # of a pixel at most.
    turned = positions(find_holes(image[::-1, ::-1], pixel_um=size))
    flipped = [(columns - 1) * size, (rows - 1) * size] - reference
    swapped = positions(find_holes(image.T, pixel_um=size))
    for found, expected in ((turned, flipped), (swapped, reference[:, ::-1])):
        difference = found - ordered(expected)
        assert np.sqrt(np.mean(difference**2)) < 0.05 * size
        assert np.abs(difference).max() < 0.2 * size


def test_pixels_that_are_not_square():
    rng = np.random.default_rng(5)
    sheet = scene(rng, (500, 833), (4.0, 3.0), some_holes(rng))
    hits, false, missed, errors = compare(
        find_holes(sheet.image, pixel_um=(4.0, 3.0)), sheet.centres
    )
    assert (hits, false, missed) == (8, 0, 0)
    assert np.sqrt(np.mean(errors**2)) < 1.4


def test_holes_cut_by_the_border_or_by_missing_data_are_dropped():
    rng = np.random.default_rng(6)
    whole, cut, at_nan = (
        make_hole(rng, *p) for p in ((700.0, 700.0), (60.0, 700.0), (700.0, 1180.0))
    )
    sheet = scene(rng, (300, 300), 5.0, [whole, cut, at_nan])
    image = sheet.image
    image[236:] = np.nan
    image[:, 250:] = np.nan
    found = find_holes(image, pixel_um=5.0)
    np.testing.assert_allclose(positions(found), sheet.centres[:1], atol=2.0)


def test_a_ragged_border_of_missing_data_makes_no_holes():
    sheet, centres = make_presence(8, 35, 0.0)
    rng = np.random.default_rng(0)
    image = sheet.image.copy()
    rows, columns = np.indices(image.shape)
    edge = 20 + 10 * np.sin(rows / 9.0) + rng.integers(0, 4, image.shape)
    image[(columns < edge) | (columns > image.shape[1] - edge)] = np.nan
    hits, false, missed, _ = compare(find_holes(image, pixel_um=sheet.pixel), centres)
    assert false == 0
    assert hits >= hits + missed - 2


def test_half_closed_holes_are_left_out():
    rng = np.random.default_rng(3)
    holes = [make_hole(rng, 300.0 + 450 * k, 350.0) for k in range(6)]
    sheet = scene(rng, (280, 1000), 2.6, holes)
    y, x = np.indices(sheet.image.shape) * 2.6
    for hole, share in zip(holes[1:], (0.35, 0.5, 0.6, 0.7, 0.8), strict=True):
        closed = (np.hypot(x - hole.x, y - hole.y) < 100) & (x - hole.x > 90 * (1 - 2 * share))
        sheet.image[closed] = 0.9
    found = find_holes(sheet.image, pixel_um=2.6)
    np.testing.assert_allclose(positions(found), sheet.centres[:1], atol=2.0)


@pytest.mark.ci
def test_results_carry_units_and_repeat_to_the_same_bytes():
    sheet = make_scene(5, "mottle", 12)
    found = find_holes(sheet.image, pixel_um=sheet.pixel)
    assert {name: found[name].attrs["units"] for name in NAMES} == {
        "x": "um",
        "y": "um",
        "cov_xx": "um2",
        "cov_yy": "um2",
        "cov_xy": "um2",
        "diameter": "um",
        "axis_ratio": "1",
        "arc_coverage": "1",
        "contrast": "1",
    }
    assert np.all(found.contrast < 0)
    assert np.all((found.arc_coverage >= 0.7) & (found.arc_coverage <= 1.0))
    assert np.all((found.axis_ratio >= 1.0) & (found.axis_ratio < 1.3))
    xr.testing.assert_identical(find_holes(sheet.image, pixel_um=sheet.pixel), found)


@pytest.mark.parametrize("size", [-1.0, np.nan, np.inf, (1.0, 0.0), (1.0, 2.0, 3.0)])
def test_impossible_pixel_sizes(size):
    refused(SizeError, "pixel size", find_holes, np.ones((50, 50)), pixel_um=size)


def test_impossible_requests():
    refused(MarkError, "one grey channel", find_holes, np.ones((50, 50, 3)), pixel_um=1.0)
    refused(MarkError, "real grey", find_holes, np.ones((50, 50), complex), pixel_um=1.0)
    refused(
        MarkError,
        "diameters",
        find_holes,
        np.ones((50, 50)),
        pixel_um=1.0,
        diameter_um=(300.0, 100.0),
    )
    refused(MarkError, "polarity", find_holes, np.ones((50, 50)), pixel_um=1.0, polarity="light")


def test_a_circle_that_a_border_cuts_is_not_whole():
    size, shape, radius = (2.0, 3.0), (101, 201), 40.0  # 200 um high, 600 um wide
    rows = rims.blank_marks(6)
    rows.half_difference = 0.0
    rows.radius = radius
    places = [(300, 100), (39, 100), (561, 100), (300, 39), (300, 161), (559, 159)]
    rows.centre = places
    assert hole_criteria.is_whole(rows, shape, size).tolist() == [
        True,
        False,
        False,
        False,
        False,
        True,
    ]
