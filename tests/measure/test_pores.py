"""Chords and inscribed spheres beside slow twins, and on pores of known size."""

import numpy as np
import pytest
from scipy import ndimage

from planish.measure import structure
from planish.measure._pore_kernels import inscribed

STEP = (3.0, 2.0, 1.0)


def blobs(seed=0, shape=(18, 20, 22)):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.7)
    return (noise > 0.02).astype(np.uint8)


def test_distances_and_inscribed_balls_equal_their_slow_twins():
    void = blobs()
    exact = ndimage.distance_transform_edt(void, sampling=STEP)
    np.testing.assert_allclose(
        structure.distances(void, STEP, 6.0), np.minimum(exact, 6.0), rtol=1e-6
    )
    assert (structure.distances(np.ones_like(void), STEP, 6.0) == 6.0).all()
    # Every sample takes the largest sphere around any centre that holds it.
    void = blobs(1, (12, 13, 14))
    radius = structure.distances(void, STEP, 8.0)
    places = np.stack(
        np.meshgrid(
            *(np.arange(n) * p for n, p in zip(void.shape, STEP, strict=True)), indexing="ij"
        ),
        -1,
    )
    centres, radii = places[radius > 0], radius[radius > 0]
    found = inscribed(radius, STEP)
    for at in np.argwhere(void > 0):
        away = np.linalg.norm(centres - places[tuple(at)], axis=1)
        # a sample on a sphere's very surface may count or not
        least, most = (radii[away < radii + slack].max() for slack in (-1e-4, 1e-4))
        assert least - 1e-4 <= found[tuple(at)] <= most + 1e-4
    assert (found[void == 0] == 0).all()


def test_chords_equal_their_slow_twin():
    void = blobs(2, (9, 11, 6))
    first, second = structure.chords(void, 0, 4), structure.chords(void, 1, 3)

    def run(line, at, most):
        total = 1
        for way in (-1, 1):
            k = at + way
            n = 1
            while 0 <= k < line.size and line[k] and n < most:
                total, n, k = total + 1, n + 1, k + way
        return total

    slow = np.zeros((2, 9, 11))
    for i, j, k in np.argwhere(void):
        slow[0, i, j] += run(void[:, j, k], i, 4)
        slow[1, i, j] += run(void[i, :, k], j, 3)
    np.testing.assert_array_equal(first, slow[0])
    np.testing.assert_array_equal(second, slow[1])


@pytest.fixture(scope="module")
def holed(made):
    """Square channels through the base, 12 um wide, and spherical pores of 16 um."""

    def paint(s, u, v):
        values = np.where(np.abs(s) <= 25.0, 90.0, 40.0)
        channel = (
            (np.abs((u + 100) % 40 - 20) < 6)
            & (np.abs((v + 100) % 40 - 20) < 6)
            & (v < 0)
            & (np.abs(s) < 18)
        )
        sphere = (((u + 100) % 40 - 20) ** 2 + ((v + 100) % 40 - 20) ** 2 + s**2 < 64) & (v >= 0)
        return np.where((channel | sphere) & (np.abs(s) <= 25), 40.0, values)

    return made(
        paint, top=0.0, bottom=0.0, voxel=1.0, size_um=(140.0, 140.0), blur=0.3, air_um=10.0
    )


@pytest.mark.ci
def test_sizes_of_known_pores(holed):
    found = holed.measured("pore_chord", "pore_diameter", edge_um=2.0, pore_limit_um=25.0)
    lower, upper = found.isel(y=slice(30, 65)), found.isel(y=slice(75, 110))
    # squares of 12 voxels: the half-way level lies between samples
    assert float(lower["pore_chord"].median()) == pytest.approx(12.0, abs=1.0)
    # the largest sphere in a square channel is as wide as the channel; corners hold smaller ones
    assert float(lower["pore_diameter"].max()) == pytest.approx(12.0, abs=1.0)
    # the poles of a sphere hold smaller ones, and the half-way level rounds it off
    assert float(upper["pore_diameter"].max()) == pytest.approx(15.0, abs=1.5)
    assert np.isnan(found["pore_diameter"].values[10, 10])
    # beyond the limit a pore is no larger
    small = holed.measured("pore_diameter", edge_um=2.0, pore_limit_um=8.0)
    assert float(small["pore_diameter"].max()) <= 8.0 + 1e-3
