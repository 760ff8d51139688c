"""Faces drawn to points: what they mend, what they leave alone, and how sure they are."""

from functools import cache

import numpy as np
import pytest
from scipy import ndimage

from folders import refused
from planish.checks import CHECKS, MeasuredSheet
from planish.core.errors import FileError, InputError
from planish.core.facts import SIDES
from planish.core.frame import Frame
from planish.core.tiles import Engine
from planish.measure import measure_properties, surfaces_of
from planish.surface import (
    Corrections,
    Stretch,
    SurfaceParams,
    correct_surfaces,
    draw,
    find_surfaces,
    read_corrections,
    uncorrected,
)
from surface.sheets import VOXEL, slab, volume
from surface.test_tiles import lazy

pytestmark = pytest.mark.ci

SHAPE, RADIUS, AIR = (84, 120, 126), 36.0, 40.0
MIDDLE = tuple(n // 2 * VOXEL for n in SHAPE[1:])


@cache
def spoilt(grey=AIR, through="z", top="high"):
    """A rough coated sheet with an inclusion of ``grey`` in its top face; volume, true height of
    the top, frame."""
    rng = np.random.default_rng(0)
    rough = ndimage.gaussian_filter(rng.normal(size=SHAPE[1:]), 4.0)
    values, middle, half = slab(SHAPE, height=125.0 + rough * 2.0 / rough.std(), noise=0.0)
    truth = middle[0] + half
    z, y, x = np.meshgrid(*(np.arange(n) * VOXEL for n in SHAPE), indexing="ij")
    apart = (
        (z - truth[SHAPE[1] // 2, SHAPE[2] // 2]) ** 2 * 3
        + (y - MIDDLE[0]) ** 2
        + (x - MIDDLE[1]) ** 2
    )
    share = ndimage.gaussian_filter((apart < RADIUS**2).astype(float), 0.8)
    values = values * (1 - share) + np.minimum(values, grey) * share + rng.normal(0, 4.0, SHAPE)
    whole = volume(values)
    # the same sheet with its normal along another axis, or its top at the low end
    frame = Frame(through=through, top=top)
    names = dict(zip("zyx", (through, frame.rows, frame.cols), strict=True))
    if top == "low":
        last = float(whole.z[-1])
        whole, truth = (
            whole.isel(z=slice(None, None, -1)).assign_coords(z=whole.z.values),
            last - truth,
        )
    return whole.rename(names).transpose("z", "y", "x"), truth, frame


def clicks(truth, frame, *, error_um=0.0, reach_um=60.0):
    """Six points on the true top, along one slice through the inclusion."""
    rng = np.random.default_rng(1)
    points = []
    for along in MIDDLE[1] + np.linspace(-RADIUS, RADIUS, 6):
        at = truth[round(MIDDLE[0] / VOXEL), round(along / VOXEL)] + rng.normal(0, error_um)
        place = {frame.through: at, frame.rows: MIDDLE[0], frame.cols: along}
        points.append({k: float(place[k]) for k in "zyx"} | {"face": "top"})
    return Corrections(
        stretches=(Stretch.model_validate({"id": "c1", "points": points, "reach_um": reach_um}),)
    )


@cache
def found(grey=AIR, through="z", top="high"):
    whole, _, frame = spoilt(grey, through, top)
    return find_surfaces(whole, frame=frame)


def places():
    y, x = (np.arange(n) * VOXEL for n in SHAPE[1:])
    return np.stack(np.meshgrid(y, x, indexing="ij"), axis=-1)


def near(point, reach_um):
    return np.hypot(*np.moveaxis(places() - point, -1, 0)) < reach_um


def rms(surfaces, truth, where):
    return float(np.sqrt(np.mean((surfaces["top"].values - truth)[where] ** 2))) / VOXEL


@pytest.mark.parametrize("grey", [AIR, 65.0])
def test_six_clicks_bring_a_face_behind_a_dark_inclusion_back_to_within_a_voxel(grey):
    whole, truth, frame = spoilt(grey)
    patch = near(MIDDLE, RADIUS)
    measured = np.isfinite(found(grey)["top"].values)
    # It had followed the floor of the inclusion.
    assert rms(found(grey), truth, patch & measured) > 2
    # Clicks are off by a third of a voxel: a screen pixel.
    corrected = correct_surfaces(found(grey), whole, clicks(truth, frame, error_um=1.0))
    assert np.isfinite(corrected["top"].values[patch]).all()
    assert rms(corrected, truth, patch) <= 1
    assert (corrected["status"].values[patch] == 0).all()


@pytest.mark.parametrize(("through", "top"), [("y", "high"), ("x", "low")])
def test_a_correction_is_the_same_in_every_pose(through, top):
    whole, truth, frame = spoilt(AIR, through, top)
    corrected = correct_surfaces(found(AIR, through, top), whole, clicks(truth, frame))
    patch = near(MIDDLE, RADIUS)
    assert rms(corrected, truth, patch) <= 1


def test_columns_beyond_the_reach_keep_their_bytes_and_what_was_found_comes_back():
    whole, truth, frame = spoilt()
    asked = clicks(truth, frame)
    corrected = correct_surfaces(found(), whole, asked)
    line = np.array([[point.y, point.x] for point in asked.stretches[0].points])
    beyond = draw.distance_to_line(places(), line) > asked.stretches[0].reach_um
    for name in (*SIDES, "interface_top", "interface_bottom", "status"):
        assert corrected[name].values[beyond].tobytes() == found()[name].values[beyond].tobytes(), (
            name
        )
    assert corrected["interface_bottom"].equals(found()["interface_bottom"])
    back = uncorrected(corrected)
    assert back.identical(found())
    assert correct_surfaces(corrected, whole, Corrections()).identical(found())
    # One correction after the other, or a new one in place of the old one: the same.
    again = correct_surfaces(
        correct_surfaces(found(), whole, clicks(truth, frame, error_um=3.0)), whole, asked
    )
    assert again.identical(corrected)


def test_only_the_tiles_that_a_correction_touches_are_read():
    whole, truth, frame = spoilt()
    part, asked = lazy(whole.values)
    small = Engine(threads=1, memory_bytes=4_000_000)
    corrected = correct_surfaces(found(), part, clicks(truth, frame), engine=small)
    assert corrected.attrs["corrected_tiles"] >= 1
    # Twice: for the face, and for the interface below it.
    assert 0 < sum(asked.sizes) < 2 * 0.4 * whole.size
    whole = correct_surfaces(found(), whole, clicks(truth, frame))
    assert corrected.drop_attrs().identical(whole.drop_attrs())


def test_where_the_image_shows_no_edge_the_standard_error_is_that_of_the_interpolation():
    whole, truth, frame = spoilt()
    corrected = correct_surfaces(found(), whole, clicks(truth, frame))
    how, error = corrected["correction_top"].values, corrected["correction_top_error"].values
    assert np.isnan(error[how == 0]).all()
    assert (error[how > 0] > 0).all()
    off = np.abs(corrected["top"].values - truth)
    assert np.median(error[how == 2]) > np.median(error[how == 1])
    assert np.mean(off[how > 0] < 2 * error[how > 0]) > 0.85  # two standard errors
    se = [measure_properties(one)["thickness_se"].values for one in (found(), corrected)]
    # The coating that is found there has an error of its own.
    assert (se[1][how > 0] >= 0.999 * error[how > 0]).all()
    assert (se[1] > 1.2 * se[0])[how == 2].mean() > 0.9
    # The centre surface turned a little.
    np.testing.assert_allclose(se[1][how == 0], se[0][how == 0], rtol=0.02)
    light = next(light for light in CHECKS if light.name == "corrections")
    check = light(MeasuredSheet(None, corrected))
    assert check is not None
    assert f"{np.count_nonzero(how)} columns" in check.sentence
    assert light(MeasuredSheet(None, found())) is None


def test_corrections_of_a_search_are_read_from_a_file(tmp_path):
    whole, truth, frame = spoilt()
    path = tmp_path / "surface.json"
    path.write_text(clicks(truth, frame).to_json(), encoding="utf-8")
    assert read_corrections(path) == clicks(truth, frame)
    params = SurfaceParams(corrections=str(path))
    at_once = find_surfaces(whole, frame=frame, params=params)
    assert at_once.identical(correct_surfaces(found(), whole, clicks(truth, frame)))
    assert surfaces_of(measure_properties(at_once))["top"].equals(at_once["top"])


def test_a_point_on_the_right_face_changes_next_to_nothing_and_one_outside_is_refused():
    whole, truth, _ = spoilt()
    place = {"z": float(found()["top"].values[20, 20]), "y": 60.0, "x": 60.0, "face": "top"}
    asked = Corrections.model_validate({"stretches": [{"id": "c1", "points": [place]}]})
    corrected = correct_surfaces(found(), whole, asked)
    beside = near([60, 60], 60.001)
    drawn = corrected["correction_top"].values > 0
    assert not drawn[~beside].any()
    assert np.count_nonzero(drawn) < 0.02 * np.count_nonzero(beside)
    assert np.abs(corrected["top"].values - truth)[beside].max() < VOXEL
    place = {"z": 100, "y": 1e4, "x": 10, "face": "top"}
    asked = Corrections.model_validate({"stretches": [{"id": "c1", "points": [place]}]})
    refused(InputError, "its y goes from 0 to 357 um", correct_surfaces, found(), whole, asked)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "Invalid JSON"),
        ("[1]", "holds no corrections"),
        ('{"stretches": [{"id": "a", "points": []}]}', "points"),
        (
            '{"stretches": [{"id": "a", "points": [{"z": NaN, "y": 1, "x": 1, "face": "top"}]}]}',
            "finite",
        ),
        (
            '{"stretches": [{"id": "a", "points": [{"z": 1, "y": 1, "x": 1, "face": "side"}]}]}',
            "face",
        ),
        ('{"units": "mm", "stretches": []}', "units"),
    ],
)
def test_a_file_that_holds_no_corrections_is_refused(tmp_path, text, words):
    path = tmp_path / "surface.json"
    path.write_text(text, encoding="utf-8")
    refused(FileError, words, read_corrections, path)


def test_kriging_meets_its_points_and_is_as_wrong_as_a_brownian_bridge():
    """Brownian motion along a line has the variogram slope * r."""
    rng = np.random.default_rng(3)
    walks = np.cumsum(rng.normal(0, np.sqrt(2 * 0.5), (4000, 41)), axis=1)
    at = np.column_stack([np.zeros(41), np.arange(41.0)])
    ends = {
        "places": at[[0, 40]],
        "heights": np.array([2.0, 10.0]),
        "variances": np.zeros(2),
        "slope": 0.5,
    }
    height, errors = draw.krige(at[[0, 10, 20, 40]], **ends)
    np.testing.assert_allclose(height, [2, 4, 6, 10], atol=1e-9)
    # A bridge of length 40 has the variance t (40 - t) / 40.
    np.testing.assert_allclose(errors[1:3], np.sqrt([10 * 30 / 40, 20 * 20 / 40]), rtol=1e-9)
    off = walks[:, [10, 20]] - walks[:, :1] * [0.75, 0.5] - walks[:, 40:] * [0.25, 0.5]
    # Three standard errors of 4000 draws.
    np.testing.assert_allclose(np.std(off, axis=0), errors[1:3], rtol=0.04)
    assert draw.variogram_slope(walks, (1.0, 1.0), 4.0, least=0.0) > 0
