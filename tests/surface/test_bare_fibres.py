"""Faces of a bare base of walls and pores: laid ribbons of another maker against the definition of
its face."""

import numpy as np
import pytest
from scipy import ndimage

from planish.measure import measure_properties
from planish.surface import find_surfaces
from planish.surface.faces import _loose_fibres, outermost_crossing
from planish.surface.learn import _shows_voids
from surface.sheets import volume as voxels

WALL, AIR = 100.0, 40.0
LATERAL, VOXEL, FWHM = 2, 3, 4.0  # um: cells of the structure are 2 x 2 x 1


def laid(seed, ribbons, thickness):
    """Occupancy (y, x, z) of stiff ribbons, each laid on the highest place below it."""
    rng = np.random.default_rng(seed)
    side, room = 210, 160
    solid, top = np.zeros((side, side, room), np.float32), np.full((side, side), 30)
    for _ in range(ribbons):
        length, width = rng.integers(30, 80), rng.integers(8, 15)
        rows, cols = (length, width) if rng.random() < 0.5 else (width, length)
        r, c = rng.integers(-rows, side, 2)[0], rng.integers(-cols, side)
        place = slice(max(r, 0), r + rows), slice(max(c, 0), c + cols)
        if r + rows <= 0 or c + cols <= 0:
            continue
        base = int(np.percentile(top[place], 60))  # it gives way to the highest places
        if base + thickness > room - 30:
            continue
        solid[(*place, slice(base, base + thickness))] = 1.0
        top[place] = np.maximum(top[place], base + thickness)
    return solid


def scanned(solid, noise, seed, fringe=0.0):
    """The volume of a structure, and the true thickness at each of its columns."""
    sigma = FWHM / np.sqrt(8 * np.log(2))
    blurred = ndimage.gaussian_filter(solid, (sigma / LATERAL, sigma / LATERAL, sigma))
    counts = [
        int(n * size / VOXEL) for n, size in zip(solid.shape, (LATERAL, LATERAL, 1), strict=True)
    ]
    rows, cols, cells = (
        (np.arange(n) + 0.5) * VOXEL / size - 0.5
        for n, size in zip(counts, (LATERAL, LATERAL, 1), strict=True)
    )
    at = np.meshgrid(rows, cols, np.arange(solid.shape[2]), indexing="ij")
    fine = ndimage.map_coordinates(blurred, at, order=1, mode="nearest")
    passes = fine >= 0.5
    true = np.where(
        passes.any(axis=2),
        passes.shape[2] - passes[..., ::-1].argmax(axis=2) - passes.argmax(axis=2) - 1.0,
        np.nan,
    )
    at = np.meshgrid(rows, cols, cells, indexing="ij")
    grey = AIR + (WALL - AIR) * ndimage.map_coordinates(blurred, at, order=1, mode="nearest")
    grey -= fringe * ndimage.laplace(ndimage.gaussian_filter(grey, 0.8))
    grey += noise * np.random.default_rng(seed).standard_normal(grey.shape)
    values = np.rint(np.moveaxis(grey, 2, 0)).clip(0, 255).astype(np.uint8)
    return voxels(values, float(VOXEL)).assign_attrs(voxel_um=[float(VOXEL)] * 3), true


@pytest.mark.ci
def test_faces_of_laid_ribbons_are_those_of_half_a_wall():
    volume, true = scanned(laid(3, 700, 7), 6.0, 4)
    found = measure_properties(find_surfaces(volume), volume=volume)
    values, stated = found["thickness"].values, found["thickness_se"].values
    inside = np.isfinite(true)
    inside[:8], inside[-8:], inside[:, :8], inside[:, -8:] = False, False, False, False
    assert np.isfinite(values[inside]).mean() > 0.97
    error = (values - true)[inside & np.isfinite(values)]
    spread = error.std() / np.sqrt(np.mean(stated[inside & np.isfinite(values)] ** 2))
    assert abs(error.mean()) < 1.5
    assert 0.5 < spread < 1.5
    assert float(found["level_top_error"].attrs["common_um"]) > 0
    assert np.isnan(found.attrs["blur_um"])
    assert found.attrs["fringe"] == 0.0


@pytest.mark.ci
def test_strong_fringes_make_no_coating_of_walls():
    volume, true = scanned(laid(3, 700, 7), 3.0, 4, fringe=2.0)
    found = measure_properties(find_surfaces(volume), volume=volume)
    assert np.isnan(found["interface_top"]).all()
    assert np.isnan(found["interface_bottom"]).all()
    assert found.attrs["fringe"] > 0.2
    error = (found["thickness"].values - true)[10:-10, 10:-10]
    assert abs(np.nanmedian(error)) < 1.5


def test_a_fibre_that_stands_out_of_a_rough_face_is_loose():
    rng = np.random.default_rng(2)
    rough = ndimage.gaussian_filter(rng.standard_normal((160, 170)), 2.0)
    face = 40.0 - 1.5 * rough / rough.std()  # voxels of 3 um, read from outside
    usual = _loose_fibres(face, (3.0, 3.0, 3.0))
    assert usual.mean() < 0.01
    rows, cols = np.indices(face.shape)
    fibre = (np.abs(rows - 60 - 0.5 * (cols - 80)) < 4) & (np.abs(cols - 80) < 40)
    found = _loose_fibres(np.where(fibre, face - 8.0, face), (3.0, 3.0, 3.0))
    assert found[fibre].mean() > 0.95
    assert found[~fibre].mean() < 0.01


@pytest.mark.ci
def test_thickness_does_not_count_a_loose_fibre():
    solid = laid(3, 700, 7)
    heights = solid.shape[2] - solid[..., ::-1].argmax(axis=2)
    over = np.zeros(solid.shape[:2], dtype=bool)
    over[100:108, 60:150] = True
    lifted = int(heights[over].max()) + 10
    loose = solid.copy()
    loose[100:108, 60:150, lifted : lifted + 6] = 1.0
    _, true = scanned(solid, 6.0, 4)
    volume, _ = scanned(loose, 6.0, 4)
    found = measure_properties(find_surfaces(volume), volume=volume)
    middle = (slice(68, 71), slice(45, 95))
    error = found["thickness"].values[middle] - true[middle]
    assert np.isfinite(error).mean() > 0.9
    assert abs(np.nanmedian(error)) < 4.0


def test_a_base_shows_voids_where_it_has_more_dark_places_than_light_ones():
    rng = np.random.default_rng(1)
    even = rng.normal(60.0, 12.0, 20_000)
    assert not _shows_voids(even)
    assert _shows_voids(np.where(rng.random(even.size) < 0.03, rng.normal(15.0, 5.0), even))


def test_the_outermost_crossing_is_that_of_a_plain_loop():
    rng = np.random.default_rng(0)
    grey = ndimage.gaussian_filter1d(rng.standard_normal((300, 40)), 1.5, axis=1)
    start, stop = rng.uniform(-3, 12, 300), rng.uniform(15, 45, 300)
    start[::37] = np.nan
    found = outermost_crossing(grey, start, stop, 0.2)
    for column, depth, first, last in zip(grey, found, start, stop, strict=True):
        true = np.nan
        for k in range(max(int(np.floor(first)), 1), 40) if np.isfinite(first) else ():
            if column[k] > 0.2:
                a, b = column[k - 1], column[k]
                true = (
                    k - 1 + min(max((0.2 - a) / (b - a), 0.0), 1.0)
                    if k <= min(last, 39)
                    else np.nan
                )
                break
        np.testing.assert_allclose(depth, true, atol=1e-12)
