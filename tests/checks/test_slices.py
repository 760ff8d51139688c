"""Slices that are exchanged, repeated, filled, missing, foreign: seen, counted, named; none in
right volumes."""

from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
import xarray as xr
from scipy import ndimage

from checks.made_windows import window_of
from planish.checks import CHECKS
from planish.checks.windows import read_windows


def body(shape=(80, 60, 65), *, seed=0, size=2.5, noise=0.3):
    """A continuous random body, grey 100 ± 20, with noise of its own in every voxel."""
    rng = np.random.default_rng(seed)
    smooth = ndimage.gaussian_filter(rng.normal(size=shape), size)
    return 100 + 20 * smooth / smooth.std() + rng.normal(0, 20 * noise, shape)


def sheet(shape=(60, 70, 75), *, seed=0, slope=0.15, noise=6.0):
    """A waved sheet with a rough, coated top between air, through z."""
    rng = np.random.default_rng(seed)
    z, y, x = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    rough, coat = (ndimage.gaussian_filter(rng.normal(size=shape[1:]), s) for s in (2, 4))
    middle = shape[0] / 2 + slope * (x - x.mean()) + 3 * np.sin(y / 12) + 2 * rough / rough.std()
    s = z - middle
    grey = np.where(abs(s) < 10, 90, 40) + np.where((s < 10) & (s > 5 + coat / coat.std()), 110, 0)
    return ndimage.gaussian_filter(grey.astype(float), 1.0) + rng.normal(0, noise, shape)


def judged_window(window, through="z"):
    rule = next(rule for rule in CHECKS if rule.name == "slices along z")
    return rule(SimpleNamespace(windows={"z": window}, through=through, assembled_axes=()))


def judged(values, through="z"):
    return judged_window(window_of(np.clip(values, 0, 255).astype(np.uint8)), through)


def at(k, n):
    return [*range(k, k + n)]


@pytest.mark.parametrize("make", [body, sheet])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_right_slices_pass(make, axis):
    for seed in range(2):
        check = judged(np.moveaxis(make(seed=seed), axis, 0))
        assert check.state == "pass", check.sentence
        assert check.value == 0


@pytest.mark.parametrize("axis", [1, 2])
def test_gains_of_sections_across_the_sheet_are_no_fault(axis):
    values = np.moveaxis(sheet(), axis, 0)
    gain = 1 + 0.03 * np.random.default_rng(0).standard_normal((len(values), 1, 1))
    check = judged(values * gain, through="y")
    assert check.state == "pass", check.sentence


def test_order_is_seen_whatever_the_gain_of_each_slice():
    values = body() * (1 + 0.03 * np.random.default_rng(0).standard_normal((80, 1, 1)))
    assert judged(values[[*at(0, 30), 31, 30, *at(32, 48)]], through="y").sentence.startswith(
        "Slices 30 and 31 along z are exchanged."
    )
    copied = judged(values[[*at(0, 43), *at(38, 42)]], through="y").sentence
    assert copied.startswith("Slices 43-47 along z are copies of 38-42.")


def test_long_waves_of_a_knife_are_no_disorder():
    """Each slice has waves of its own, far wider than what the specimen shows."""
    rng = np.random.default_rng(2)
    slices, edge = 50, 200
    waves = ndimage.gaussian_filter(rng.normal(size=(slices, 36, 36)), (0, 6, 6))
    waves = ndimage.zoom(waves, (1, 10, 10), order=1)[:, 80 : 80 + edge, 80 : 80 + edge]
    values = body((slices, edge, edge))
    values[:20] = 100 + rng.normal(0, 5, (20, edge, edge))  # resin alone
    values += 5 * waves / waves.std()
    check = judged(values)
    assert check.state == "pass", check.sentence
    exchanged = judged(values[[*at(0, 30), 31, 30, *at(32, 18)]])
    assert exchanged.sentence.startswith("Slices 30 and 31 along z are exchanged.")


N = at(0, 80)
CASES = {
    "exchanged": ([*N[:40], 41, 40, *N[42:]], "fail", "Slices 40 and 41 along z are exchanged."),
    "pair after pair": ([k ^ 1 for k in N], "fail", "exchanged"),
    "blocks": ([*N[:20], *at(35, 15), *at(20, 15), *N[50:]], "fail", "slice 20 does not follow 19"),
    "turned block": ([*N[:20], *at(20, 15)[::-1], *N[35:]], "fail", "not in order"),
    "names without zeros": (sorted(N, key=str), "fail", "not in order"),
    "five twice": (
        [*N[:43], *at(38, 5), *N[43:]],
        "look",
        "Slices 43-47 along z are copies of 38-42.",
    ),
    "three missing": ([*N[:40], *N[43:]], "look", "Between slices 39 and 40 along z"),
}


@pytest.mark.parametrize("case", CASES)
def test_order_of_slices(case):
    order, state, words = CASES[case]
    check = judged(body()[order])
    assert check.state == state
    assert words in check.sentence
    assert check.advice


def test_copies_with_noise_of_their_own():
    order = [*N[:43], *at(38, 5), *N[43:]]
    noisy = body()[order] + np.random.default_rng(1).normal(0, 1.0, (85, 60, 65))
    assert "Slices 43-47 along z are copies of 38-42." in judged(noisy).sentence
    one = body()[[*N[:43], 42, *N[43:]]] + np.random.default_rng(1).normal(0, 1.0, (81, 60, 65))
    assert "Slice 43 along z is a copy of 42." in judged(one).sentence


@pytest.mark.parametrize("run", [1, 3])
def test_filled_slices(run):
    values = body()
    for k in range(run):
        values[40 + k] = (values[39] * (run - k) + values[40 + run] * (k + 1)) / (run + 1)
    check = judged(values)
    assert (check.state, check.value) == ("look", run)
    assert check.sentence.startswith(
        "Slice 40 along z is" if run == 1 else "Slices 40-42 along z are"
    )


def test_foreign_empty_and_faulty_slices_are_named_with_what_they_concern():
    values = body()
    values[30] = body(seed=5)[30]
    values[50] = 0
    check = judged(values)
    assert check.state == "look"
    assert "Slice 30 along z does not fit between its neighbours." in check.sentence
    assert "Slice 50 along z shows nothing" in check.sentence
    order = [*N[:40], *N[43:]]
    window = window_of(body()[order])
    through, across = (judged_window(window, axis) for axis in ("z", "y"))
    assert set(through.figures) == {"properties", "position", "correlation"}
    assert set(across.figures) == {"position", "correlation"}


@pytest.mark.parametrize("offset", [25.0, -25.0])
def test_a_line_of_one_slice_is_no_foreign_slice(offset):
    values = body()
    values[30:33] += offset * np.array([0.2, 1.0, 0.2])[:, None, None]
    assert judged(values, through="y").state == "pass"
    values[50] = body(seed=5)[50] + offset
    assert judged(values, through="y").sentence.startswith(
        "Slice 50 along z does not fit between its neighbours."
    )


@pytest.mark.parametrize("axis", [0, 1])
def test_an_edge_along_the_slices_is_no_fault(axis):
    """A flat sheet, sharp to a voxel, right along the slices: what jumps is its grey."""
    values = body(size=1.5) * 0.1
    values[30:] += 80
    assert judged(np.moveaxis(values, 0, axis)).state == "pass"


def test_windows_are_the_same_however_a_volume_is_read():
    """Against plain sums over the same voxels; in pieces, on threads, with chunks."""
    values = np.random.default_rng(0).integers(0, 255, (70, 41, 52)).astype(np.uint8)
    volume = xr.DataArray(values, dims=("z", "y", "x"))
    whole = read_windows(volume, through="z", sheet_slices=(4, 65), threads=1).windows
    chunked = volume.copy()
    chunked.encoding["chunks"] = (16, 16, 16)
    for asked in (volume, chunked):
        other = read_windows(asked, through="z", sheet_slices=(4, 65), threads=3).windows
        for a, b in zip(whole, other, strict=True):
            np.testing.assert_allclose(a.square, b.square, rtol=1e-5)
            np.testing.assert_allclose(a.product, b.product, rtol=1e-4)
            np.testing.assert_array_equal(a.blocks, b.blocks)
    z, y, x = whole
    part = values.astype(float)[:, :40, 1:51]  # blocks of 5 around the middle
    u = np.diff(part, axis=0)
    np.testing.assert_allclose(z.square, (u**2).mean(axis=(1, 2)), rtol=1e-5)
    np.testing.assert_allclose(z.product, (u[1:] * u[:-1]).mean(axis=(1, 2)), rtol=1e-4)
    assert (y.axis, x.axis) == ("y", "x")
    u = np.diff(values.astype(float)[:, :, 1:51], axis=1)
    np.testing.assert_allclose(y.square, (u**2).mean(axis=(0, 2)), rtol=1e-5)
    u = np.diff(values.astype(float)[:, :40], axis=2)
    np.testing.assert_allclose(x.product, (u[..., 1:] * u[..., :-1]).mean(axis=(0, 1)), rtol=1e-4)
    assert x.blocks.shape == (52, 14, 8)
    np.testing.assert_allclose(x.blocks[3, 1, 1], values[5:10, 5:10, 3].mean(), rtol=1e-6)


def test_measured_volumes_pass(shared_data):
    volumes = [tifffile.imread(shared_data("letterpacket_ct") / "volume_zyx_uint8.tif")]
    volumes.append(
        np.stack(
            [tifffile.imread(p) for p in sorted(shared_data("battery_sector_right").glob("z*.tif"))]
        )
    )
    cells = tifffile.imread(
        shared_data("tissue_sheet_mesh") / "Neural_tube_organoid_DAPI_betaCat-small.tif"
    )
    for values in [*volumes, cells[:, 1]]:
        for axis in range(3):
            check = judged_window(window_of(np.moveaxis(values, axis, 0)))
            assert check.state == "pass", check.sentence
