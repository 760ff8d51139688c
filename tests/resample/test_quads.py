import numpy as np
import pytest

from naive import resample_delaunay
from planish.core.errors import SurfaceError
from planish.resample import covering_grid, find_places, resample


def bent(rows=14, cols=17, seed=0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:rows, 0:cols] * 3.0
    return np.stack([x + 0.1 * y + rng.uniform(-0.6, 0.6, x.shape), y + 2 * np.sin(x / 9)], axis=-1)


def test_a_regular_mesh_gives_its_own_values():
    y, x = np.mgrid[0:6, 0:9].astype(float)
    field = np.random.default_rng(0).normal(size=(6, 9))
    places = find_places(np.stack([x, y], axis=-1), shape=(6, 9), pixel_um=(1.0, 1.0))
    np.testing.assert_allclose(resample(field, places), field, atol=1e-12)
    assert places.overlaps == 0


def test_a_linear_field_is_exact_on_any_mesh():
    uv = bent()
    shape, origin = covering_grid(uv, 1.7)
    places = find_places(uv, shape=shape, pixel_um=(1.7, 1.7), origin_um=origin)
    v, u = np.meshgrid(origin[1] + 1.7 * np.arange(shape[0]), origin[0] + 1.7 * np.arange(shape[1]), indexing="ij")
    # Places are linear in each triangle, values bilinear in each quad: equal for what is linear in the mesh's indices.
    row, col = (resample(f.astype(float), places) for f in np.mgrid[0:14, 0:17])
    known = np.isfinite(row)
    assert known.mean() > 0.7
    back = resample_delaunay(uv, uv[..., 0], np.stack([u, v], axis=-1))
    inside = known & np.isfinite(back)
    np.testing.assert_allclose(back[inside], u[inside], atol=1e-9)
    assert np.nanmax(row) <= 13
    assert np.nanmax(col) <= 16


def test_agrees_with_delaunay_where_the_field_is_smooth():
    """The twin triangulates anew; on a smooth field both are right to second order of the mesh."""
    uv = bent(40, 40)
    field = np.sin(uv[..., 0] / 30) + np.cos(uv[..., 1] / 25)
    shape, origin = covering_grid(uv, 2.0)
    places = find_places(uv, shape=shape, pixel_um=(2.0, 2.0), origin_um=origin)
    ours = resample(field, places)
    v, u = np.meshgrid(origin[1] + 2.0 * np.arange(shape[0]), origin[0] + 2.0 * np.arange(shape[1]), indexing="ij")
    theirs = resample_delaunay(uv, field, np.stack([u, v], axis=-1))
    both = np.isfinite(ours) & np.isfinite(theirs)
    assert np.abs(ours - theirs)[both].max() < 3.0**2 / 2 / 25**2 * 2


def test_no_bridge_over_a_gap_and_missing_stays_missing():
    uv = bent()
    uv[5:9, 6:9] = np.nan
    field = np.ones(uv.shape[:2])
    field[2, 2] = np.nan
    places = find_places(uv, shape=(45, 60), pixel_um=(1.0, 1.0))
    out = resample(field, places)
    centre = round(3.0 * 6.5 + 2 * np.sin(21 / 9)), (21 + 2)
    assert np.isnan(out[centre])
    assert np.isnan(out[int(6 + 2 * np.sin(6 / 9)), 6])


def test_large_pixels_take_the_mean_over_their_area():
    y, x = np.mgrid[0:40, 0:40].astype(float)
    field = np.random.default_rng(1).normal(size=(40, 40))
    uv = np.stack([x, y], axis=-1)
    places = find_places(uv, shape=(9, 9), pixel_um=(4.0, 4.0), origin_um=(1.5, 1.5), least_um=1.0)
    assert places.fine == 4
    np.testing.assert_allclose(resample(field, places)[2, 3], field[8:12, 12:16].mean(), atol=1e-12)


def test_folds_are_counted():
    y, x = np.mgrid[0:5, 0:9].astype(float)
    x[:, 5:] = 8 - x[:, 5:] + 1.3
    assert find_places(np.stack([x * 3, y * 3], axis=-1), shape=(13, 25), pixel_um=(1.0, 1.0)).overlaps > 0


def test_an_impossible_grid_is_refused():
    with pytest.raises(SurfaceError, match="pixel size"):
        find_places(bent(), shape=(0, 5), pixel_um=(1.0, 1.0))
