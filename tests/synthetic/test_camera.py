"""The camera: what brightness says about the coating, the print's own figures, and that nuisances
keep apart."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import fft, ndimage

from folders import refused
from planish.core.area import area_mean
from planish.core.transform import Similarity
from planish.synthetic import (
    CameraParams,
    CameraPose,
    DrawnSheet,
    PaperParams,
    PrintParams,
    draw_pose,
    image_material,
    photograph,
)
from planish.synthetic.sheet import PITCH_UM, noise

pytestmark = pytest.mark.ci

SIZE = (2400.0, 1800.0)  # um that the images show
SEED = np.random.SeedSequence(11)
CLEAN = CameraParams(
    nuisance_sd=0.0, shading=0.0, vignetting=0.0, lens_um=0.0, noise=0.0, bits=16, radial=0.0
)
STRAIGHT = CameraPose(similarity=Similarity())
HOLES = np.array([[600.0, 500.0], [1500.0, 1200.0]])
STEP = 1 / 65535  # of 16 bits


def sheet_of(coating_um, *, holes=HOLES, rough_um=1.0, closed=False):
    """A sheet around SIZE with a given top coating (rows, cols) or a number, 175 um holes and a
    rough top face."""
    rng = np.random.default_rng(5)
    shape = tuple(int((s + 300.0) / PITCH_UM) + 2 for s in SIZE[::-1])
    y, x = (-150.0 + PITCH_UM * i for i in np.indices(shape))
    coating = np.broadcast_to(coating_um, shape)
    top = 45.0 + rough_um * noise(shape, 100.0, rng)
    rim = np.full(shape, 1e4)
    for u, v in holes:
        rim = np.minimum(rim, np.hypot(x - u, y - v) - 87.5)
    floor = np.full(shape, 1e4) if closed else rim + 13.0
    maps = {
        "faces": np.stack([top, top - coating, np.full(shape, -27.0), np.full(shape, -44.4)]),
        "rim_um": np.stack([rim, floor]),
        "char": 1 - 0.5 * np.exp(-np.maximum(rim, 0) / 20.0),
        "holes": holes,
    }
    maps |= {
        "coating_density": np.ones(shape),
        "base_mass": np.ones(shape),
        "crack_um": np.zeros(shape),
    }
    maps = {name: values.astype(np.float32) for name, values in maps.items()}
    return DrawnSheet(params=PaperParams(), seed=0, origin=(-150.0, -150.0), **maps)


@pytest.fixture(scope="module")
def sheet():
    rng = np.random.default_rng(2)
    shape = tuple(int((s + 300.0) / PITCH_UM) + 2 for s in SIZE[::-1])
    return sheet_of(17.4 + 4.0 * noise(shape, 100.0, rng) + 1.5 * noise(shape, 30.0, rng))


def shape_of(camera):
    return int(SIZE[1] / camera.pixel_um), int(SIZE[0] / camera.pixel_um)


def seen(sheet, camera=CLEAN, *, seed=SEED, printed=False):
    return photograph(sheet, STRAIGHT, camera, shape=shape_of(camera), seed=seed, printed=printed)


def truth(sheet, camera=CLEAN):
    u, v = image_material(STRAIGHT, shape_of(camera), camera.pixel_um)
    return sheet.at(sheet.faces[0] - sheet.faces[1], u, v), sheet.at(sheet.rim_um[0], u, v)


def r2_at_100_um(sheet, image, camera=CLEAN):
    coating, rim = truth(sheet, camera)
    side = (100.0 / camera.pixel_um,) * 2
    away = rim > 100.0
    x, y = (
        area_mean(np.where(away, m, np.nan), side, least_share=1.0)
        for m in (coating, image.astype(float))
    )
    known = np.isfinite(x)
    return np.corrcoef(x[known], y[known])[0, 1] ** 2


def test_brightness_rises_with_the_coating():
    camera = replace(CLEAN, backing="black", pixel_um=16.0)
    means = [seen(sheet_of(t, holes=HOLES[:0]), camera).mean() for t in (2.0, 14.0, 26.0)]
    assert (np.diff(means) > 0.004).all()
    assert 0.6 < means[0] < means[-1] < 0.95


def test_an_image_lies_where_its_pose_says_and_its_seed_repeats_it(sheet):
    camera = replace(CLEAN, pixel_um=5.0)
    shape, pose = draw_pose(
        CameraParams(pixel_um=5.0, turn_deg=155.0, mirrored=True),
        (0, 0, *SIZE),
        np.random.default_rng(1),
    )
    image = photograph(sheet, pose, camera, shape=shape, seed=SEED)
    u, v = image_material(pose, shape, 5.0)
    y, x = np.indices(shape) * 5.0
    np.testing.assert_allclose(
        pose(np.stack([u, v], axis=-1)), np.stack([x, y], axis=-1), atol=1e-9
    )
    labels, count = ndimage.label(image < 0.3)
    assert count == len(HOLES)
    found = (
        np.array(ndimage.center_of_mass(image < 0.3, labels, range(1, count + 1)))[:, ::-1] * 5.0
    )
    off = np.linalg.norm(found[:, None] - pose(HOLES)[None], axis=-1).min(axis=0)
    assert (off < 1.0).all()  # um: a disc of 35 pixels across, counted pixel by pixel
    camera = CameraParams()
    seed = np.random.SeedSequence(3)
    first = seen(sheet, camera, seed=seed)
    assert first.dtype == np.float32
    np.testing.assert_array_equal(first, seen(sheet, camera, seed=seed))
    assert (seen(sheet, camera, seed=np.random.SeedSequence(4)) != first).mean() > 0.9


def test_holes_are_dark_and_charred_at_their_rims():
    open_, closed = seen(sheet_of(17.4)), seen(sheet_of(17.4, closed=True))
    middle = (int(500 / 4), int(600 / 4))
    assert open_[middle] == pytest.approx(0.04, abs=STEP)
    assert 0.04 < closed[middle] < 0.3
    row = open_[middle[0]]
    at_rim, away = row[int((600 + 87.5 + 6) / 4)], row[int(1100 / 4)]
    # The middle of the pixel at 692 um lies 4.5 um from the rim: 1 - 0.4 exp(-4.5 / 20).
    assert at_rim / away == pytest.approx(1 - 0.4 * np.exp(-4.5 / 20.0), abs=0.01)
    dark = np.sum(open_[middle[0] - 40 : middle[0] + 40, 100:200] < 0.3) * 16.0
    assert np.sqrt(4 * dark / np.pi) == pytest.approx(175.0, abs=2.0)  # half a pixel


@pytest.mark.parametrize("target", [0.2, 0.6])
def test_the_oracle_is_reached(sheet, target):
    image = seen(sheet, replace(CLEAN, oracle_r2=target))
    assert r2_at_100_um(sheet, image) == pytest.approx(target, abs=0.002)


def test_an_oracle_out_of_reach_is_an_error_that_says_so(sheet):
    free = r2_at_100_um(sheet, seen(sheet))
    assert free > 0.8
    words = r"out of reach: without any nuisance, r2 .* is 0\.\d\d\d"
    refused(ValueError, words, seen, sheet, replace(CLEAN, oracle_r2=0.5 * (1 + free)))
    low = replace(CLEAN, oracle_r2=0.2)
    refused(ValueError, "out of reach", seen, sheet_of(0.0), low)  # no coating to follow
    refused(
        ValueError,
        "take a larger image",
        photograph,
        sheet,
        STRAIGHT,
        low,
        shape=(90, 90),
        seed=SEED,
    )


def test_the_screen_has_its_frequency_and_angle_and_mean_tone():
    flat = sheet_of(17.4, holes=HOLES[:0], rough_um=0.0)
    camera = replace(CLEAN, screen=PrintParams())
    plain, printed = (
        seen(flat, camera).astype(float),
        seen(flat, camera, printed=True).astype(float),
    )
    assert np.mean((plain - printed) / (plain - 0.08)) == pytest.approx(0.40, abs=0.01)
    n = 4096
    window = np.outer(*(np.hanning(s) for s in printed.shape))
    power = np.abs(fft.rfft2((printed - printed.mean()) * window, (n, n)))
    i, j = np.unravel_index(np.argmax(power), power.shape)
    fy, fx = fft.fftfreq(n, 4.0)[i], fft.rfftfreq(n, 4.0)[j]
    # 4096 pixels of 4 um make bins of 0.61 / cm: half of one along both axes.
    assert 1e4 * np.hypot(fx, fy) == pytest.approx(60.0, abs=0.45)
    assert np.rad2deg(np.arctan2(abs(fy), fx)) == pytest.approx(45.0, abs=1.0)


def test_a_nuisance_that_is_off_leaves_the_others_as_they_are(sheet):
    usual = CameraParams(bits=16)
    whole = seen(sheet, usual).astype(float)
    grain = whole - seen(sheet, replace(usual, noise=0.0))
    free = np.abs(whole - 0.5) < 0.45  # noise is cut where it leaves 0 to 1
    for off in ("nuisance_sd", "shading", "vignetting", "lens_um"):
        less = seen(sheet, replace(usual, **{off: 0.0})).astype(float)
        assert np.abs(less - whole).max() > 1e-3
        same = less - seen(sheet, replace(usual, **{off: 0.0, "noise": 0.0}))
        inside = free & (np.abs(less - 0.5) < 0.45)
        # Two roundings on each side.
        np.testing.assert_allclose(same[inside], grain[inside], atol=2.1 * STEP)
    assert grain[free].std() == pytest.approx(0.005, rel=0.01)


def test_vignetting_is_a_factor_and_shading_follows_the_slope(sheet):
    plain = seen(sheet).astype(float)
    factor = seen(sheet, replace(CLEAN, vignetting=0.04)) / plain
    assert (factor[0, 0], factor[225, 300]) == (
        pytest.approx(0.96, abs=1e-3),
        pytest.approx(1.0, abs=1e-3),
    )
    lit = seen(sheet, replace(CLEAN, shading=0.02)) / plain
    u, v = image_material(STRAIGHT, plain.shape, 4.0)
    slope = np.gradient(sheet.at(sheet.faces[0], u, v), 4.0, axis=1)
    away = truth(sheet)[1] > 10.0
    np.testing.assert_allclose(lit[away], 1 + 0.2 * slope[away], atol=5 * STEP)


def test_nuisance_has_its_size(sheet):
    away = truth(sheet)[1] > 200.0
    extra = seen(sheet, replace(CLEAN, nuisance_sd=0.012)).astype(float) - seen(sheet)
    # The field is scaled over the sheet, of which the image shows most.
    assert extra[away].std() == pytest.approx(0.012, rel=0.15)
