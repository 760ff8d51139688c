"""The compiled search and sums against loops over triangles, Delaunay's triangulation, and
formulas."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatten.meshes import grid, middles
from folders import refused
from naive import resample_delaunay, resample_quads
from planish.core.errors import SurfaceError
from planish.core.grid import Grid
from planish.core.threads import limit_threads
from planish.resample import covering_grid, find_places, resample, support

PIXELS = Grid.regular((4, 5), 1.0)


def bent(rows=14, cols=17, seed=0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:rows, 0:cols] * 3.0
    return np.stack([x + 0.1 * y + rng.uniform(-0.6, 0.6, x.shape), y + 2 * np.sin(x / 9)], axis=-1)


def turned(uv, degrees):
    """A mesh turned about its middle."""
    a = np.deg2rad(degrees)
    middle = np.nanmean(uv, axis=(0, 1))
    return (uv - middle) @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) + middle


def with_holes(uv, rng, share=0.05):
    uv = uv.copy()
    uv[rng.random(uv.shape[:2]) < share] = np.nan
    uv[rng.random(uv.shape[:2]) < share / 5, 0] = np.inf
    return uv


def covered(uv, pixel):
    """Pixels over the mesh and their middles, at odd numbers, so that none lies on an edge."""
    around = covering_grid(uv, pixel)
    x, y = around.origin_um
    pixels = Grid.regular(around.shape, pixel, (x + 0.123 * pixel, y + 0.217 * pixel))
    return pixels, middles(pixels)


@settings(max_examples=20)
@given(
    seed=st.integers(0, 1000),
    size=st.tuples(st.integers(2, 9), st.integers(2, 9)),
    degrees=st.sampled_from([0, 30, 90, 180, 217]),
    mirror=st.booleans(),
    pixel=st.sampled_from([0.7, 1.7, 5.0]),
)
def test_equals_the_twin_on_warped_meshes_with_holes(seed, size, degrees, mirror, pixel):
    rng = np.random.default_rng(seed)
    uv = bent(*size, seed=seed)
    uv = turned(uv[:, ::-1] if mirror else uv, degrees)
    at, points = covered(uv, pixel)
    uv = with_holes(uv, rng)
    field = rng.normal(size=size)
    field[rng.random(size) < 0.05] = np.nan
    places = find_places(uv, at)
    value, _, quads = resample_quads(uv, field, points)
    # Both are exact to rounding: coordinates of 1e2 um, triangles of some um.
    np.testing.assert_allclose(resample(field, places), value, atol=1e-10)
    assert places.overlaps == np.count_nonzero(quads > 1)
    np.testing.assert_array_equal(places.triangle >= 0, quads > 0)


def test_a_mesh_without_quads_covers_nothing():
    for shape in ((7, 1), (0, 5)):
        places = find_places(np.zeros((*shape, 2)), PIXELS)
        assert np.isnan(resample(np.zeros(shape), places)).all()


def test_folds_of_cells_are_counted():
    uv = bent(9, 9)
    uv[4, 4] += (7.0, 5.0)
    field = np.random.default_rng(5).normal(size=(9, 9))
    at, points = covered(uv, 0.31)
    value, _, quads = resample_quads(uv, field, points)
    assert quads.max() > 2
    places = find_places(uv, at)
    assert places.overlaps == np.count_nonzero(quads > 1)
    np.testing.assert_allclose(resample(field, places), value, atol=1e-10)


@pytest.mark.parametrize("pitch", [1.0, 0.7, 1 / 3])
def test_a_regular_mesh_gives_its_own_values_and_the_border_of_the_mesh_is_on_the_mesh(pitch):
    """Whole multiples of a pitch that binary numbers do not hold: rounding must not lose a border
    pixel."""
    field = np.random.default_rng(0).normal(size=(40, 31))
    places = find_places(grid(40, 31, pitch) + 1e3, Grid.regular((40, 31), pitch, (1e3, 1e3)))
    # Positions of 1e3 um in steps of 0.3 um are known to 1e3 / 0.3 / 2^53 = 4e-13 of a step.
    np.testing.assert_allclose(resample(field, places), field, atol=1e-11)
    assert places.overlaps == 0


@pytest.mark.parametrize(
    ("method", "least_um"), [("quads", 1.0), ("delaunay", None), ("delaunay", 1.0)]
)
def test_what_is_affine_in_the_plane_stays_so(method, least_um):
    """Exact on any mesh: sub-pixels of a pixel lie about its centre."""
    uv = turned(bent(40, 40), 30)
    at, points = covered(uv, 1.7)
    affine = (3.0, -0.7, 120.0)
    places = find_places(uv, at, least_um=least_um, method=method)
    out = resample(uv @ affine[:2] + affine[2], places)
    whole = support(np.ones((40, 40), dtype=bool), places) == 1
    truth = points @ affine[:2] + affine[2]
    assert whole.mean() > 0.4
    # 1e-9 of the values is what is asked for; rounding leaves some 1e-15.
    np.testing.assert_allclose(out[whole], truth[whole], rtol=1e-9, atol=1e-9 * np.abs(truth).max())


def test_a_wave_of_four_columns_keeps_its_height_and_a_parabola_is_exact():
    """By Keys's weights such a wave keeps 94 % on average over all places between two nodes; by
    straight lines 81 %."""
    uv = grid(60, 60, 3.0)
    places = find_places(uv, Grid.regular((230, 230), 0.7, (4.0, 5.0)))
    x = 4.0 + 0.7 * np.arange(230)
    waves = np.sin(2 * np.pi * uv[..., 0] / 12.0)
    slope = np.polyfit(np.sin(2 * np.pi * x / 12.0), resample(waves, places).mean(axis=0), 1)[0]
    assert slope == pytest.approx(0.939, abs=0.005)
    parabola = 0.02 * uv[..., 0] ** 2
    np.testing.assert_allclose(
        resample(parabola, places), np.tile(0.02 * x**2, (230, 1)), rtol=1e-9
    )


def test_beside_a_bare_spot_a_coating_is_not_thinner_than_nothing_and_sums_stay_sums():
    rng = np.random.default_rng(3)
    coating = np.zeros((20, 20))
    coating[:, 10:] = 12.0
    base = 50.0 + rng.normal(size=(20, 20))
    places = find_places(grid(20, 20, 3.0), Grid.regular((50, 50), 0.9, (5.0, 5.0)))
    out = resample(coating, places)
    assert out.min() == 0.0
    total = resample(base + 3.0, places)
    np.testing.assert_allclose(resample(base, places) + 3.0, total, atol=1e-12)
    halves = resample(0.3 * base - 1.0, places) + resample(0.7 * base + 1.0, places)
    np.testing.assert_allclose(halves, resample(base, places), atol=1e-12)


def test_delaunay_equals_scipy_and_agrees_where_the_field_is_smooth():
    uv = bent(30, 30)
    uv[8:11, 9:14] = np.nan
    at, points = covered(uv, 1.3)
    field = np.random.default_rng(2).normal(size=(30, 30))
    places = find_places(uv, at, method="delaunay")
    np.testing.assert_allclose(
        resample(field, places), resample_delaunay(uv, field, points), atol=1e-10
    )
    quads = find_places(uv, at)
    assert (places.triangle >= 0).sum() > (quads.triangle >= 0).sum()  # it bridges the hole
    # On a smooth field both are right to second order of the mesh.
    field = np.sin(uv[..., 0] / 30) + np.cos(uv[..., 1] / 25)
    both = support(np.isfinite(field), quads) == 1
    off = resample(field, places) - resample(field, quads)
    assert np.abs(off)[both].max() < 3.0**2 / 2 / 25**2 * 2


def test_the_mean_is_that_of_the_twin_over_the_known_sub_pixels():
    rng = np.random.default_rng(7)
    uv = with_holes(turned(bent(20, 20), 30), rng)
    field = rng.normal(size=(20, 20))
    field[rng.random((20, 20)) < 0.1] = np.nan
    places = find_places(uv, Grid.regular((9, 7), 7.5, (3.1, 2.2)), least_um=3.0)
    assert places.fine == 3  # 7.5 um in steps of no more than 3
    value, _, _ = resample_quads(uv, field, middles(Grid.regular((27, 21), 2.5, (0.6, -0.3))))
    cells = value.reshape(9, 3, 7, 3).swapaxes(1, 2).reshape(9, 7, 9)
    share = np.isfinite(cells).mean(axis=-1)
    mean = np.nansum(cells, axis=-1) / np.maximum(9 * share, 1)
    out = resample(field, places)
    np.testing.assert_allclose(out, np.where(share >= 0.5, mean, np.nan), atol=1e-10)
    assert 0.1 < np.isfinite(out).mean() < 1
    np.testing.assert_allclose(support(np.isfinite(field), places), share)


def test_same_bytes_on_any_number_of_threads():
    rng = np.random.default_rng(4)
    uv = with_holes(turned(bent(150, 130), 30), rng, 0.01)
    uv[70:80, 60:70] += 20.0  # folded over its neighbours
    field = rng.normal(size=(150, 130))
    at, _ = covered(uv, 1.1)
    found = []
    for threads in (1, 2, 5):
        with limit_threads(threads):
            places = find_places(uv, at, least_um=0.8)
            found.append((places, resample(field, places)))
    (one, values), *more = found
    assert one.overlaps > 0
    here = one.triangle >= 0
    for other, sampled in more:
        assert other.triangle.tobytes() == one.triangle.tobytes()
        assert other.weight[:, here].tobytes() == one.weight[:, here].tobytes()
        assert (other.overlaps, sampled.tobytes()) == (one.overlaps, values.tobytes())


def test_impossible_grids_and_meshes_are_refused():
    uv = np.full((3, 3, 2), np.nan)
    refused(SurfaceError, "No node", covering_grid, uv, 1.0)
    uv[0, :2] = [[0, 0], [1, 1]]
    refused(SurfaceError, "at least 3", find_places, uv, PIXELS, method="delaunay")
    refused(SurfaceError, "pixel size", find_places, bent(), Grid.regular((0, 5), 1.0))
    refused(SurfaceError, r"\(rows, cols, 2\)", find_places, np.zeros((4, 5)), PIXELS)
    refused(SurfaceError, "mesh", resample, np.zeros((5, 5)), find_places(bent(), PIXELS))
