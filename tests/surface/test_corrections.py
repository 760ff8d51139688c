"""Faces drawn to points: what they mend, what they leave alone, and how sure they are."""

from functools import cache

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage, special

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
)  # fmt: skip

VOXEL, SHAPE, RADIUS = 3.0, (84, 120, 126), 36.0
AIR, BASE, COAT = 40.0, 90.0, 200.0
MIDDLE = tuple(n // 2 * VOXEL for n in SHAPE[1:])


@cache
def spoilt(grey=AIR, seed=0, through="z", top="high"):
    """A rough coated sheet with an inclusion of ``grey`` in its top face; volume, true height of the top, frame."""
    rng = np.random.default_rng(seed)
    rough = ndimage.gaussian_filter(rng.normal(size=SHAPE[1:]), 4.0)
    rough *= 2.0 / rough.std()
    z, y, x = np.meshgrid(*(np.arange(n) * VOXEL for n in SHAPE), indexing="ij")
    height, half = 125.0 + rough, 44.5
    s, blur = z - height, 2.6
    outer = special.ndtr((half - s) / blur) * special.ndtr((half + s) / blur)
    inner = special.ndtr((half - 17 - s) / blur) * special.ndtr((half - 17 + s) / blur)
    values = AIR + (COAT - AIR) * outer + (BASE - COAT) * inner
    truth = height + half
    apart = (z - truth[SHAPE[1] // 2, SHAPE[2] // 2]) ** 2 * 3 + (y - MIDDLE[0]) ** 2 + (x - MIDDLE[1]) ** 2
    share = ndimage.gaussian_filter((apart < RADIUS**2).astype(float), 0.8)
    values = values * (1 - share) + np.minimum(values, grey) * share + rng.normal(0, 4.0, SHAPE)
    coords = {k: np.arange(n) * VOXEL for k, n in zip("zyx", SHAPE, strict=True)}
    volume = xr.DataArray(values, dims=("z", "y", "x"), coords=coords)
    # the same sheet with its normal along another axis, or its top at the low end
    frame = Frame(through=through, top=top)
    names = dict(zip("zyx", (through, frame.rows, frame.cols), strict=True))
    if top == "low":
        last = float(volume.z[-1])
        volume, truth = volume.isel(z=slice(None, None, -1)).assign_coords(z=volume.z.values), last - truth
    return volume.rename(names).transpose("z", "y", "x"), truth, frame


def clicks(truth, frame, *, error_um=0.0, reach_um=60.0):
    """Six points on the true top, along one slice through the inclusion."""
    rng = np.random.default_rng(1)
    points = []
    for along in MIDDLE[1] + np.linspace(-RADIUS, RADIUS, 6):
        at = truth[round(MIDDLE[0] / VOXEL), round(along / VOXEL)] + rng.normal(0, error_um)
        place = {frame.through: at, frame.rows: MIDDLE[0], frame.cols: along}
        points.append({k: float(place[k]) for k in "zyx"} | {"face": "top"})
    return Corrections(stretches=(Stretch.model_validate({"id": "c1", "points": points, "reach_um": reach_um}),))


@cache
def found(grey=AIR, through="z", top="high"):
    volume, _, frame = spoilt(grey, 0, through, top)
    return find_surfaces(volume, frame=frame)


def places():
    y, x = (np.arange(n) * VOXEL for n in SHAPE[1:])
    return np.stack(np.meshgrid(y, x, indexing="ij"), axis=-1)


def rms(surfaces, truth, where):
    return float(np.sqrt(np.mean((surfaces["top"].values - truth)[where] ** 2))) / VOXEL


@pytest.mark.parametrize("grey", [AIR, 55.0, 65.0])
def test_six_clicks_bring_a_face_behind_a_dark_inclusion_back_to_within_a_voxel(grey):
    volume, truth, frame = spoilt(grey)
    patch = np.hypot(*np.moveaxis(places() - MIDDLE, -1, 0)) < RADIUS
    measured = np.isfinite(found(grey)["top"].values)
    assert rms(found(grey), truth, patch & measured) > 2  # it had followed the floor of the inclusion
    # Clicks are off by a third of a voxel: a screen pixel.
    corrected = correct_surfaces(found(grey), volume, clicks(truth, frame, error_um=1.0))
    assert np.isfinite(corrected["top"].values[patch]).all()
    assert rms(corrected, truth, patch) <= 1
    assert (corrected["status"].values[patch] == 0).all()


@pytest.mark.parametrize(("through", "top"), [("y", "high"), ("x", "low"), ("z", "low")])
def test_a_correction_is_the_same_in_every_pose(through, top):
    volume, truth, frame = spoilt(AIR, 0, through, top)
    corrected = correct_surfaces(found(AIR, through, top), volume, clicks(truth, frame))
    patch = np.hypot(*np.moveaxis(places() - MIDDLE, -1, 0)) < RADIUS
    assert rms(corrected, truth, patch) <= 1


def test_columns_beyond_the_reach_keep_their_bytes_and_what_was_found_comes_back():
    volume, truth, frame = spoilt()
    asked = clicks(truth, frame)
    corrected = correct_surfaces(found(), volume, asked)
    line = np.array([[point.y, point.x] for point in asked.stretches[0].points])
    beyond = draw.distance_to_line(places(), line) > asked.stretches[0].reach_um
    for name in (*SIDES, "interface_top", "interface_bottom", "status"):
        assert corrected[name].values[beyond].tobytes() == found()[name].values[beyond].tobytes(), name
    assert corrected["interface_bottom"].equals(found()["interface_bottom"])
    back = uncorrected(corrected)
    assert back.identical(found())
    assert correct_surfaces(corrected, volume, Corrections()).identical(found())
    # One correction after the other, or a new one in place of the old one: the same.
    again = correct_surfaces(correct_surfaces(found(), volume, clicks(truth, frame, error_um=3.0)), volume, asked)
    assert again.identical(corrected)


class Counted:
    """A volume that counts the voxels that are read of it."""

    def __init__(self, volume):
        self.read = 0
        self.volume = volume

    def isel(self, *args, **kwargs):
        part = self.volume.isel(*args, **kwargs)
        self.read += part.size
        return part

    def __getattr__(self, name):
        return getattr(self.volume, name)


def test_only_the_tiles_that_a_correction_touches_are_read():
    volume, truth, frame = spoilt()
    small = Engine(threads=1, memory_bytes=4_000_000)
    counted = Counted(volume)
    corrected = correct_surfaces(found(), counted, clicks(truth, frame), engine=small)  # type: ignore[arg-type]
    assert corrected.attrs["corrected_tiles"] >= 1
    # Twice: for the face, and for the interface below it.
    assert 0 < counted.read < 2 * 0.4 * volume.size
    whole = correct_surfaces(found(), volume, clicks(truth, frame))
    assert corrected.drop_attrs().identical(whole.drop_attrs())


def test_where_the_image_shows_no_edge_the_standard_error_is_that_of_the_interpolation():
    volume, truth, frame = spoilt()
    corrected = correct_surfaces(found(), volume, clicks(truth, frame))
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
    np.testing.assert_allclose(se[1][how == 0], se[0][how == 0], rtol=0.02)  # the centre surface turned a little
    light = next(light for light in CHECKS if light.name == "corrections")
    check = light(MeasuredSheet(None, corrected))
    assert check is not None
    assert f"{np.count_nonzero(how)} columns" in check.sentence
    assert light(MeasuredSheet(None, found())) is None


def test_corrections_of_a_search_are_read_from_a_file(tmp_path):
    volume, truth, frame = spoilt()
    path = tmp_path / "surface.json"
    path.write_text(clicks(truth, frame).to_json(), encoding="utf-8")
    assert read_corrections(path) == clicks(truth, frame)
    params = SurfaceParams(corrections=str(path))
    at_once = find_surfaces(volume, frame=frame, params=params)
    assert at_once.identical(correct_surfaces(found(), volume, clicks(truth, frame)))
    assert surfaces_of(measure_properties(at_once))["top"].equals(at_once["top"])


def test_a_point_on_the_right_face_changes_next_to_nothing_and_one_outside_is_refused():
    volume, truth, _ = spoilt()
    place = {"z": float(found()["top"].values[20, 20]), "y": 60.0, "x": 60.0, "face": "top"}
    asked = Corrections(stretches=(Stretch.model_validate({"id": "c1", "points": [place]}),))
    corrected = correct_surfaces(found(), volume, asked)
    near = np.hypot(*np.moveaxis(places() - [60, 60], -1, 0)) <= 60
    drawn = corrected["correction_top"].values > 0
    assert not drawn[~near].any()
    assert np.count_nonzero(drawn) < 0.02 * np.count_nonzero(near)
    assert np.abs(corrected["top"].values - truth)[near].max() < VOXEL
    volume, _, _ = spoilt()
    place = {"z": 100, "y": 1e4, "x": 10, "face": "top"}
    asked = Corrections.model_validate({"stretches": [{"id": "c1", "points": [place]}]})
    refused(InputError, "its y goes from 0 to 357 um", correct_surfaces, found(), volume, asked)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "Invalid JSON"),
        ("[1]", "holds no corrections"),
        ('{"stretches": [{"id": "a", "points": []}]}', "points"),
        ('{"stretches": [{"id": "a", "points": [{"z": NaN, "y": 1, "x": 1, "face": "top"}]}]}', "finite"),
        ('{"stretches": [{"id": "a", "points": [{"z": 1, "y": 1, "x": 1, "face": "side"}]}]}', "face"),
        ('{"units": "mm", "stretches": []}', "units"),
    ],
)
def test_a_file_that_holds_no_corrections_is_refused(tmp_path, text, words):
    path = tmp_path / "surface.json"
    path.write_text(text, encoding="utf-8")
    refused(FileError, words, read_corrections, path)


def test_kriging_meets_its_points_and_is_as_wrong_as_it_says():
    # Brownian motion along a line has the variogram slope * r.
    rng = np.random.default_rng(3)
    walks = np.cumsum(rng.normal(0, np.sqrt(2 * 0.5), (4000, 41)), axis=1)
    at = np.column_stack([np.zeros(41), np.arange(41.0)])
    known = [0, 40]
    between = [10, 20]
    off, errors = [], None
    for walk in walks:
        kriging = {"places": at[known], "heights": walk[known], "variances": np.zeros(2), "slope": 0.5}
        height, errors = draw.krige(at[between], **kriging)
        off.append(height - walk[between])
        if len(off) == 1:
            np.testing.assert_allclose(draw.krige(at[known], **kriging)[0], walk[known], atol=1e-9)
    # A bridge of length 40 has the variance t (40 - t) / 40.
    np.testing.assert_allclose(errors, np.sqrt([10 * 30 / 40, 20 * 20 / 40]), rtol=1e-9)
    np.testing.assert_allclose(np.std(off, axis=0), errors, rtol=0.04)  # three standard errors of 4000 draws
    slope = draw.variogram_slope(walks, (1.0, 1.0), 4.0, least=0.0)
    assert slope > 0
