"""The compiled search and sums against loops over triangles, Delaunay's triangulation, and formulas."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from folders import refused
from naive import resample_delaunay, resample_quads
from planish.core.errors import SurfaceError
from planish.core.grid import Grid
from planish.core.threads import limit_threads
from planish.resample import covering_grid, find_places, resample, support


def located(uv, *, shape, pixel_um, origin_um=(0.0, 0.0), **more):
    return find_places(uv, Grid.regular(shape, pixel_um, origin_um), **more)


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


def grid(uv, pixel):
    """A grid over the mesh and its points (rows, cols, 2), at odd numbers, so that no pixel lies on an edge."""
    covering = covering_grid(uv, pixel)
    shape, origin = covering.shape, covering.origin_um
    origin = origin[0] + 0.123 * pixel, origin[1] + 0.217 * pixel
    v, u = np.meshgrid(*(origin[1 - k] + pixel * np.arange(shape[k]) for k in range(2)), indexing="ij")
    return {"shape": shape, "pixel_um": (pixel, pixel), "origin_um": origin}, np.stack([u, v], axis=-1)


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
    at, points = grid(uv, pixel)
    uv = with_holes(uv, rng)
    field = rng.normal(size=size)
    field[rng.random(size) < 0.05] = np.nan
    places = located(uv, **at)
    value, _, quads = resample_quads(uv, field, points)
    # Both are exact to rounding: coordinates of 1e2 um, triangles of some um.
    np.testing.assert_allclose(resample(field, places), value, atol=1e-10)
    assert places.overlaps == np.count_nonzero(quads > 1)
    np.testing.assert_array_equal(places.triangle >= 0, quads > 0)


def test_a_mesh_without_quads_covers_nothing():
    for shape in ((7, 1), (0, 5)):
        places = located(np.zeros((*shape, 2)), shape=(4, 5), pixel_um=(1.0, 1.0))
        assert np.isnan(resample(np.zeros(shape), places)).all()


def test_folds_of_cells_are_counted():
    uv = bent(9, 9)
    uv[4, 4] += (7.0, 5.0)
    field = np.random.default_rng(5).normal(size=(9, 9))
    at, points = grid(uv, 0.31)
    value, _, quads = resample_quads(uv, field, points)
    assert quads.max() > 2
    places = located(uv, **at)
    assert places.overlaps == np.count_nonzero(quads > 1)
    np.testing.assert_allclose(resample(field, places), value, atol=1e-10)


def test_large_pixels_have_the_mean_over_their_area():
    y, x = np.mgrid[0:40, 0:40].astype(float)
    field = np.random.default_rng(1).normal(size=(40, 40))
    uv = np.stack([x, y], axis=-1)
    places = located(uv, shape=(9, 9), pixel_um=(4.0, 4.0), origin_um=(1.5, 1.5), least_um=1.0)
    assert places.fine == 4
    np.testing.assert_allclose(resample(field, places)[2, 3], field[8:12, 12:16].mean(), atol=1e-12)


@pytest.mark.parametrize("pitch", [1.0, 0.7, 1 / 3])
def test_a_regular_mesh_gives_its_own_values_and_the_border_of_the_mesh_is_on_the_mesh(pitch):
    """Whole multiples of a pitch that binary numbers do not hold: rounding must not lose a border pixel."""
    y, x = np.mgrid[0:40, 0:31] * pitch + 1e3
    field = np.random.default_rng(0).normal(size=y.shape)
    places = located(np.stack([x, y], axis=-1), shape=y.shape, pixel_um=(pitch, pitch), origin_um=(1e3, 1e3))
    # Positions of 1e3 um in steps of 0.3 um are known to 1e3 / 0.3 / 2^53 = 4e-13 of a step.
    np.testing.assert_allclose(resample(field, places), field, atol=1e-11)
    assert places.overlaps == 0


@pytest.mark.parametrize(("method", "least_um"), [("quads", 1.0), ("delaunay", None), ("delaunay", 1.0)])
def test_what_is_affine_in_the_plane_stays_so(method, least_um):
    """Exact on any mesh: sub-pixels of a pixel lie about its centre."""
    uv = turned(bent(40, 40), 30)
    at, points = grid(uv, 1.7)
    affine = (3.0, -0.7, 120.0)
    places = located(uv, **at, least_um=least_um, method=method)
    out = resample(uv @ affine[:2] + affine[2], places)
    whole = support(np.ones((40, 40), dtype=bool), places) == 1
    truth = points @ affine[:2] + affine[2]
    assert whole.mean() > 0.4
    # 1e-9 of the values is what is asked for; rounding leaves some 1e-15.
    np.testing.assert_allclose(out[whole], truth[whole], rtol=1e-9, atol=1e-9 * np.abs(truth).max())


def test_delaunay_equals_scipy_and_agrees_where_the_field_is_smooth():
    uv = bent(30, 30)
    uv[8:11, 9:14] = np.nan
    at, points = grid(uv, 1.3)
    field = np.random.default_rng(2).normal(size=(30, 30))
    places = located(uv, **at, method="delaunay")
    np.testing.assert_allclose(resample(field, places), resample_delaunay(uv, field, points), atol=1e-10)
    quads = located(uv, **at)
    assert (places.triangle >= 0).sum() > (quads.triangle >= 0).sum()  # it bridges the hole
    # On a smooth field both are right to second order of the mesh.
    field = np.sin(uv[..., 0] / 30) + np.cos(uv[..., 1] / 25)
    both = support(np.isfinite(field), quads) == 1
    off = resample(field, places) - resample(field, quads)
    assert np.abs(off)[both].max() < 3.0**2 / 2 / 25**2 * 2


def test_gaps_are_not_bridged_and_support_is_where_a_field_has_a_value():
    uv = bent()
    uv[5:9, 6:9] = np.nan
    field = np.ones(uv.shape[:2])
    field[2, 2] = np.nan
    places = located(uv, shape=(45, 60), pixel_um=(1.0, 1.0))
    out = resample(field, places)
    centre = round(3.0 * 6.5 + 2 * np.sin(21 / 9)), (21 + 2)
    assert np.isnan(out[centre])
    assert np.isnan(out[int(6 + 2 * np.sin(6 / 9)), 6])
    rng = np.random.default_rng(11)
    uv = turned(bent(30, 30), 30)
    field = np.where(rng.random((30, 30)) < 0.2, np.nan, 1.0)
    at, _ = grid(uv, 4.0)
    places = located(uv, **at, least_um=1.0)
    np.testing.assert_array_equal(support(np.isfinite(field), places) >= 0.5, np.isfinite(resample(field, places)))


def test_the_mean_is_that_of_the_twin_over_the_known_sub_pixels():
    rng = np.random.default_rng(7)
    uv = with_holes(turned(bent(20, 20), 30), rng)
    field = rng.normal(size=(20, 20))
    field[rng.random((20, 20)) < 0.1] = np.nan
    rows, cols, pixel = 9, 7, 7.5
    places = located(uv, shape=(rows, cols), pixel_um=(pixel, pixel), origin_um=(3.1, 2.2), least_um=3.0)
    assert places.fine == 3  # 7.5 um in steps of no more than 3
    step = pixel / 3
    v, u = np.meshgrid(
        2.2 + step * np.arange(-1, 3 * rows - 1), 3.1 + step * np.arange(-1, 3 * cols - 1), indexing="ij"
    )
    value, _, _ = resample_quads(uv, field, np.stack([u, v], axis=-1))
    cells = value.reshape(rows, 3, cols, 3).swapaxes(1, 2).reshape(rows, cols, 9)
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
    at, _ = grid(uv, 1.1)
    found = []
    for threads in (1, 2, 5):
        with limit_threads(threads):
            places = located(uv, **at, least_um=0.8)
            found.append((places, resample(field, places)))
    (one, values), *more = found
    assert one.overlaps > 0
    here = one.triangle >= 0
    for other, sampled in more:
        assert other.triangle.tobytes() == one.triangle.tobytes()
        assert other.weight[:, here].tobytes() == one.weight[:, here].tobytes()
        assert (other.overlaps, sampled.tobytes()) == (one.overlaps, values.tobytes())


def test_impossible_grids_and_meshes_are_refused():
    refused(SurfaceError, "pixel size", located, bent(), shape=(0, 5), pixel_um=(1.0, 1.0))
    refused(SurfaceError, "No node", covering_grid, np.full((3, 4, 2), np.nan), 1.0)
    refused(SurfaceError, r"\(rows, cols, 2\)", located, np.zeros((4, 5)), shape=(4, 5), pixel_um=(1.0, 1.0))
    places = located(bent(), shape=(4, 5), pixel_um=(1.0, 1.0))
    refused(SurfaceError, "mesh", resample, np.zeros((5, 5)), places)
    uv = np.full((3, 3, 2), np.nan)
    uv[0, :2] = [[0, 0], [1, 1]]
    refused(SurfaceError, "at least 3", located, uv, shape=(4, 5), pixel_um=(1.0, 1.0), method="delaunay")
