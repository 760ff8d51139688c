import numpy as np
import pytest
import xarray as xr

from folders import refused
from marks.holes import make_hole, place, scene
from planish.core.errors import MarkError, SizeError
from planish.marks import find_holes, hole_criteria, rims

NAMES = {"x", "y", "cov_xx", "cov_yy", "cov_xy", "diameter", "axis_ratio", "arc_coverage", "contrast"}


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


def counted(sheets):
    """Holes found, false and missed over sheets of a kind and pixel size, and the errors of centres."""
    counts = []
    for kind, pixel, sheet in sheets:
        holes = find_holes(sheet.image, pixel_um=pixel)
        assert holes.attrs["polarity"] == ("bright" if kind == "transmitted" else "dark")
        counts.append(compare(holes, sheet.centres))
    hits, false, missed, errors = zip(*counts, strict=True)
    return sum(hits), sum(false), sum(missed), np.concatenate(errors)


def specimen(seed, kind, pixel, *, across=1100, apart=None, **more):
    """A field of about ``across`` pixels with up to twelve holes of one laser."""
    rng = np.random.default_rng(seed)
    size = float(np.clip(across * pixel, 1400, 6000))
    shape = (int(0.8 * size / pixel), int(size / pixel))
    diameter = rng.uniform(170 if pixel >= 20 else 120, 260)
    # Holes may be 1.5 diameters apart, where their char touches; with pixels of 20 um, three.
    apart = (1.5 if seed % 2 and pixel < 20 else 3.0) if apart is None else apart
    places = place(rng, 12, (shape[0] * pixel, shape[1] * pixel), diameter / 2 + 60, apart * diameter)
    holes = [make_hole(rng, *p, float(np.clip(rng.normal(diameter, 8), 105, 290))) for p in places]
    looks = {
        "mottle": rng.choice([0.03, 0.08, 0.15]), "length_um": rng.choice([30, 60, 120, 200]),
        "light": rng.choice([0.0, 0.15, 0.3]), "blur_um": rng.choice([1.5, 3, 5]),
        "noise": rng.choice([0.005, 0.02, 0.05]),
    }  # fmt: skip
    return scene(rng, shape=shape, pixel=pixel, holes=holes, kind=kind, **(looks | more))


@pytest.mark.parametrize("kind", ["reflected", "transmitted", "presence"])
@pytest.mark.parametrize(
    "pixel", [*(pytest.param(size, marks=pytest.mark.nightly) for size in (0.8, 2.6, 5.0)), 10.0, 20.0]
)
def test_holes_are_found_and_centred(kind, pixel):
    """Centre error 0.1 pixel + 1 um rms an axis, recall 0.95, nothing else found."""
    seeds = range(1 if pixel < 2 else 4)
    hits, false, missed, errors = counted((kind, pixel, specimen(seed, kind, pixel)) for seed in seeds)
    rms = np.sqrt(np.mean(errors**2))
    print(f"{kind}, pixel {pixel} um: {hits} found, {missed} missed, {false} false, centre error {rms:.2f} um rms")
    assert false == 0
    assert hits >= 0.95 * (hits + missed)
    assert rms <= 0.1 * pixel + 1.0


@pytest.mark.nightly
def test_precision_over_many_textures():
    """Thirty-six sheets of every look: nothing but holes is found."""
    sheets = []
    for seed in range(36):
        kind, pixel = ("reflected", "transmitted", "presence")[seed % 3], (2.6, 4.0, 6.5, 10.0)[seed % 4]
        sheets.append((kind, pixel, specimen(100 + seed, kind, pixel, across=700)))
    hits, false, missed, _ = counted(sheets)
    print(f"{hits} found, {missed} missed, {false} false")
    assert false == 0
    assert hits >= 0.97 * (hits + missed)


@pytest.mark.parametrize("kind", ["reflected", pytest.param("transmitted", marks=pytest.mark.nightly)])
def test_dirt_and_fibres_are_left_out(kind):
    """Spots to 250 um across and dark fibres, six of each a sheet, beside the holes."""
    looks = {"across": 700, "apart": 2.5, "blemishes": 6}
    hits, false, missed, _ = counted((kind, 5.0, specimen(200 + seed, kind, 5.0, **looks)) for seed in range(4))
    print(f"{kind}: {hits} found, {missed} missed, {false} false among 48 blemishes")
    assert false == 0
    assert hits >= 0.9 * (hits + missed)


@pytest.mark.parametrize("length_um", [30, 60, 120, 200])
def test_a_sheet_without_holes_gives_an_empty_dataset(length_um):
    for seed, mottle in enumerate((0.05, 0.15, 0.3)):
        rng = np.random.default_rng(seed)
        sheet = scene(rng, shape=(500, 600), pixel=5.0, holes=[], mottle=mottle, length_um=length_um)
        found = find_holes(sheet.image, pixel_um=5.0)
        assert (found.sizes, set(found.data_vars)) == ({"mark": 0}, NAMES)


@pytest.mark.parametrize("length_um", [80, 150])
def test_mottle_as_strong_as_the_holes_are_deep_hides_none(length_um):
    """The holes are less than three standard deviations of the sheet deep; nothing of it is as black and as flat."""
    counts = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        holes = [make_hole(rng, *p, 175.0) for p in place(rng, 8, (2000.0, 2500.0), 200.0, 500.0)]
        sheet = scene(rng, shape=(400, 500), pixel=5.0, holes=holes, mottle=0.3, length_um=length_um, noise=0.01)
        counts.append(compare(find_holes(sheet.image, pixel_um=5.0), sheet.centres))
    hits, false, missed, errors = zip(*counts, strict=True)
    assert sum(false) == 0
    assert sum(hits) >= 0.95 * (sum(hits) + sum(missed))
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) <= 0.1 * 5.0 + 1.0


@pytest.mark.parametrize("image", [
    np.zeros((50, 60)), np.full((40, 40), np.nan), np.ones((3, 400)), np.empty((0, 0)), np.ones((1, 1), bool),
    np.full((300, 300), 255, np.uint8),
])  # fmt: skip
def test_images_with_nothing_in_them(image):
    assert find_holes(image, pixel_um=5.0).sizes == {"mark": 0}


def test_the_centre_is_that_of_the_hole_and_not_of_the_char():
    """A char ring that lies 25 um off centre does not pull."""
    rng = np.random.default_rng(0)
    hole = make_hole(rng, 500.0, 400.0, 180.0, rough=0.0, ratio=1.0)
    angle = np.arange(len(hole.char)) * 2 * np.pi / len(hole.char)
    hole.char = 42.0 + 25.0 * np.cos(angle)
    sheet = scene(rng, shape=(300, 400), pixel=2.6, holes=[hole], mottle=0.05)
    found = find_holes(sheet.image, pixel_um=2.6)
    np.testing.assert_allclose(positions(found), [[500.0, 400.0]], atol=1.0)
    # The rim at half level of hole and char; 3 um of blur and the taper of the wall move it by a few um at most.
    assert found.diameter.values == pytest.approx(180, abs=5)


def test_grey_scale_does_not_matter():
    sheet = specimen(3, "reflected", 4.0, across=500, mottle=0.08, noise=0.01)
    reference = positions(find_holes(sheet.image, pixel_um=4.0))
    assert len(reference) > 4
    grey = sheet.image
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


def test_shift_turn_and_swap_move_the_marks_along():
    sheet = specimen(2, "reflected", 4.0, across=500, mottle=0.08, noise=0.01)
    image, size = sheet.image, 4.0
    reference = positions(find_holes(image, pixel_um=size))
    rows, columns = image.shape

    def ordered(points):
        return points[np.lexsort((points[:, 0], points[:, 1]))]

    # Where two edges on a ray are alike, rounding decides; one ray in 96 moves a centre by a tenth of a pixel at most.
    turned = positions(find_holes(image[::-1, ::-1], pixel_um=size))
    flipped = [(columns - 1) * size, (rows - 1) * size] - reference
    swapped = positions(find_holes(image.T, pixel_um=size))
    for found, expected in ((turned, flipped), (swapped, reference[:, ::-1])):
        difference = found - ordered(expected)
        assert np.sqrt(np.mean(difference**2)) < 0.05 * size
        assert np.abs(difference).max() < 0.2 * size


def test_pixels_that_are_not_square():
    rng = np.random.default_rng(5)
    holes = [make_hole(rng, *p, 180.0) for p in place(rng, 8, (2000, 2400), 200, 500)]
    sheet = scene(rng, shape=(500, 800), pixel=(4.0, 3.0), holes=holes, mottle=0.08)
    hits, false, missed, errors = compare(find_holes(sheet.image, pixel_um=(4.0, 3.0)), sheet.centres)
    assert (hits, false, missed) == (len(holes), 0, 0)
    assert np.sqrt(np.mean(errors**2)) < 1.4


def test_holes_cut_by_the_border_or_by_missing_data_are_dropped():
    rng = np.random.default_rng(6)
    whole, cut, at_nan = (make_hole(rng, *p, 180.0) for p in ((700.0, 700.0), (60.0, 700.0), (700.0, 1180.0)))
    sheet = scene(rng, shape=(300, 300), pixel=5.0, holes=[whole, cut, at_nan], kind="presence", mottle=0.1)
    image = sheet.image
    image[236:] = np.nan
    image[:, 250:] = np.nan
    found = find_holes(image, pixel_um=5.0)
    np.testing.assert_allclose(positions(found), sheet.centres[:1], atol=2.0)


def test_a_ragged_border_of_missing_data_makes_no_holes():
    sheet = specimen(8, "presence", 5.0, across=500, mottle=0.1)
    rng = np.random.default_rng(0)
    image = sheet.image
    rows, columns = np.indices(image.shape)
    edge = 20 + 10 * np.sin(rows / 9.0) + rng.integers(0, 4, image.shape)
    image[(columns < edge) | (columns > image.shape[1] - edge)] = np.nan
    hits, false, missed, _ = compare(find_holes(image, pixel_um=5.0), sheet.centres)
    assert false == 0
    assert hits >= hits + missed - 2


def test_half_closed_holes_are_left_out():
    rng = np.random.default_rng(3)
    holes = [make_hole(rng, 300.0 + 450 * k, 350.0, 180.0) for k in range(6)]
    sheet = scene(rng, shape=(280, 1000), pixel=2.6, holes=holes, mottle=0.08)
    y, x = np.indices(sheet.image.shape) * 2.6
    for hole, share in zip(holes[1:], (0.35, 0.5, 0.6, 0.7, 0.8), strict=True):
        closed = (np.hypot(x - hole.x, y - hole.y) < 100) & (x - hole.x > 90 * (1 - 2 * share))
        sheet.image[closed] = 0.9
    found = find_holes(sheet.image, pixel_um=2.6)
    np.testing.assert_allclose(positions(found), sheet.centres[:1], atol=2.0)


@pytest.mark.nightly
def test_the_covariance_is_of_the_right_size():
    """The rim's own roughness is in it: against the designed place, where roughness is an error, it has to fit."""
    away, stated = [], []
    for seed in range(6):
        sheet = specimen(300 + seed, "reflected", 3.0, across=500)
        found = find_holes(sheet.image, pixel_um=3.0)
        designed = np.array([(hole.x, hole.y) for hole in sheet.holes])
        _, _, _, errors = compare(found, designed)
        away.append(np.sum(errors**2, axis=1))
        stated.append(found.cov_xx.values + found.cov_yy.values)
    ratio = np.sqrt(np.mean(np.concatenate(away)) / np.mean(np.concatenate(stated)))
    print(f"error against the designed place over the stated one: {ratio:.2f}")
    assert 0.5 < ratio < 1.5


def test_results_carry_units_and_repeat_to_the_same_bytes():
    sheet = specimen(0, "reflected", 5.0, across=400)
    found = find_holes(sheet.image, pixel_um=5.0)
    assert {name: found[name].attrs["units"] for name in NAMES} == {
        "x": "um", "y": "um", "cov_xx": "um2", "cov_yy": "um2", "cov_xy": "um2", "diameter": "um", "axis_ratio": "1",
        "arc_coverage": "1", "contrast": "1",
    }  # fmt: skip
    assert np.all(found.contrast < 0)
    assert np.all((found.arc_coverage >= 0.7) & (found.arc_coverage <= 1.0))
    assert np.all((found.axis_ratio >= 1.0) & (found.axis_ratio < 1.3))
    sheet = specimen(1, "reflected", 5.0, across=400)
    xr.testing.assert_identical(find_holes(sheet.image, pixel_um=5.0), find_holes(sheet.image, pixel_um=5.0))


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan, np.inf, (1.0, 0.0), (1.0, 2.0, 3.0)])
def test_impossible_pixel_sizes(size):
    refused(SizeError, "pixel size", find_holes, np.ones((50, 50)), pixel_um=size)


def test_impossible_requests():
    refused(MarkError, "one grey channel", find_holes, np.ones((50, 50, 3)), pixel_um=1.0)
    refused(MarkError, "real grey", find_holes, np.ones((50, 50), complex), pixel_um=1.0)
    refused(MarkError, "diameters", find_holes, np.ones((50, 50)), pixel_um=1.0, diameter_um=(300.0, 100.0))
    refused(MarkError, "polarity", find_holes, np.ones((50, 50)), pixel_um=1.0, polarity="light")


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "pixel", "count"), [("02", 10.0, 1324), pytest.param("05", 20.0, 4414, marks=pytest.mark.nightly)]
)
def test_dots_of_real_calibration_targets(shared_data, name, pixel, count):
    """Photographs of dot targets, dots 16 and 7 pixels across, all of them found.

    ``count`` is that of connected regions darker than 0.72 of the bright background around, between half and twice the
    median area, that do not touch the border.
    """
    pillow = pytest.importorskip("PIL.Image")
    image = np.asarray(pillow.open(shared_data("dot_patterns") / f"dot_pattern_{name}.jpg").convert("L"))
    found = find_holes(image, pixel_um=pixel)
    spread = np.ptp(np.percentile(found.diameter.values, [5, 95])) / pixel
    print(f"{found.sizes['mark']} dots, {count} counted, diameters within {spread:.2f} pixels")
    assert found.sizes["mark"] == pytest.approx(count, rel=0.01)
    assert spread < 1.0


def test_a_circle_that_a_border_cuts_is_not_whole():
    size, shape, radius = (2.0, 3.0), (101, 201), 40.0  # 200 um high, 600 um wide
    rows = np.zeros((6, rims.COLUMNS))
    rows[:, rims.RADIUS] = radius
    places = [(300, 100), (39, 100), (561, 100), (300, 39), (300, 161), (559, 159)]
    rows[:, [rims.X, rims.Y]] = places
    assert hole_criteria.is_whole(rows, shape, size).tolist() == [True, False, False, False, False, True]
