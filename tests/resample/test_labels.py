import numpy as np
import pytest
import xarray as xr

from naive import resample_quads
from planish.core.errors import SurfaceError
from planish.core.grid import Grid
from planish.resample import find_places, resample_dataset, resample_labels


def located(uv, *, shape, pixel_um, origin_um=(0.0, 0.0), **more):
    return find_places(uv, Grid.regular(shape, pixel_um, origin_um), **more)


def mesh(rows=12, cols=15, seed=0, degrees=30.0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:rows, 0:cols] * 3.0
    a = np.deg2rad(degrees)
    u, v = x + rng.uniform(-0.6, 0.6, x.shape), y + 2 * np.sin(x / 9)
    uv = np.stack([np.cos(a) * u - np.sin(a) * v, np.sin(a) * u + np.cos(a) * v], axis=-1)
    uv[4, 6] = np.nan
    return uv, rng.integers(0, 6, size=(rows, cols))


def twin(uv, labels, points):
    """Labels of the nearest nodes; -1 off the mesh."""
    _, node, _ = resample_quads(uv, labels.astype(float), points)
    return np.where(node >= 0, labels.reshape(-1)[node], -1)


def points(shape, pixel, origin, fine=1):
    step = pixel / fine
    v, u = (
        origin[1 - k] - 0.5 * (pixel - step) + step * np.arange(shape[k] * fine) for k in range(2)
    )  # fmt: skip
    return np.stack(np.broadcast_arrays(u[None, :], v[:, None]), axis=-1)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0])
def test_equals_the_twin(degrees):
    uv, labels = mesh(degrees=degrees)
    origin = -20.03, 0.07
    places = located(uv, shape=(60, 70), pixel_um=(1.0, 1.0), origin_um=origin)
    out = resample_labels(labels, places, fill=-1)
    np.testing.assert_array_equal(out, twin(uv, labels, points((60, 70), 1.0, origin)))
    assert 0.15 < (out >= 0).mean() < 0.9


def test_large_pixels_take_the_most_frequent_label():
    uv, labels = mesh()
    labels %= 3
    shape, pixel, origin = (9, 10), 6.0, (-20.03, 0.07)
    places = located(uv, shape=shape, pixel_um=(pixel, pixel), origin_um=origin, least_um=1.2)
    assert places.fine == 5
    fine = twin(uv, labels, points(shape, pixel, origin, 5))
    out = resample_labels(labels, places, fill=9)
    for (r, c), label in np.ndenumerate(out):
        cell = fine[5 * r : 5 * r + 5, 5 * c : 5 * c + 5]
        counts = np.bincount(cell[cell >= 0], minlength=3)
        if counts.sum() < 12.5:  # half of 25
            assert label == 9
        else:
            assert counts[label] == counts.max()
    assert set(np.unique(out)) == {0, 1, 2, 9}


def test_of_equally_frequent_labels_the_first_met_stays():
    y, x = np.mgrid[0:4, 0:4].astype(float)
    places = located(np.stack([x, y], axis=-1), shape=(1, 1), pixel_um=(2.0, 2.0), origin_um=(1.5, 1.5), least_um=1)
    labels = np.array([[0, 0, 0, 0], [0, 8, 3, 0], [0, 3, 8, 0], [0, 0, 0, 0]], dtype=np.uint8)
    assert resample_labels(labels, places)[0, 0] == 8


def test_a_node_holds_half_a_step_to_all_sides():
    y, x = np.mgrid[0:3, 0:3].astype(float)
    places = located(np.stack([x, y], axis=-1), shape=(11, 11), pixel_um=(0.2, 0.2))
    labels = np.arange(9).reshape(3, 3)
    cell = np.array([0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2])  # 0.2 x 2 = 0.4 is below half a step, 0.6 above
    np.testing.assert_array_equal(resample_labels(labels, places), 3 * cell[:, None] + cell[None, :])


@pytest.mark.parametrize("dtype", [np.bool_, np.uint8, np.int8, np.int32, np.int64, np.uint64])
def test_the_type_is_kept_and_every_value_of_it_passes(dtype):
    y, x = np.mgrid[0:3, 0:4].astype(float)
    places = located(np.stack([x, y], axis=-1), shape=(3, 5), pixel_um=(1.0, 1.0))
    low, high = (0, 1) if dtype is np.bool_ else (np.iinfo(dtype).min, np.iinfo(dtype).max)
    labels = np.array([[low, high, low, high]] * 3, dtype=dtype)
    out = resample_labels(labels, places, fill=high)
    assert out.dtype == dtype
    np.testing.assert_array_equal(out[:, :4], labels)
    assert (out[:, 4] == np.array(high, dtype=dtype)).all()


def test_delaunay_takes_the_corner_of_greatest_weight():
    uv, labels = mesh()
    places = located(uv, shape=(30, 30), pixel_um=(2.0, 2.0), origin_um=(-20.0, 0.0), method="delaunay")
    out = resample_labels(labels, places, fill=-1)
    for (r, c), number in np.ndenumerate(places.triangle):
        if number < 0:
            assert out[r, c] == -1
        else:
            second, third = places.weight[:, r, c]
            corner = np.argmax([1 - second - third, second, third])
            assert out[r, c] == labels.reshape(-1)[places.corners[number, corner]]


def test_fractions_and_a_fill_that_does_not_fit_are_refused():
    places = located(mesh()[0], shape=(3, 4), pixel_um=(1.0, 1.0))
    with pytest.raises(SurfaceError, match="whole numbers"):
        resample_labels(np.zeros((12, 15)), places)  # pyright: ignore[reportArgumentType]
    with pytest.raises(SurfaceError, match="fill"):
        resample_labels(np.zeros((12, 15), dtype=np.uint8), places, fill=-1)


def test_a_dataset_takes_along_its_numbers_only():
    uv, labels = mesh()
    about = {"units": "um", "long_name": "Height"}
    data = xr.Dataset({"height": (("y", "x"), uv[..., 0], about | {"other": 1}), "status": (("y", "x"), labels)})
    places = located(uv, shape=(6, 5), pixel_um=(4.0, 4.0), origin_um=(-10.0, 5.0))
    coords = {"v": 4.0 * np.arange(6), "u": 4.0 * np.arange(5)}
    out = resample_dataset(data, places, dims=("v", "u"), coords=coords)
    assert set(out.data_vars) == {"height"}
    assert out["height"].attrs == about
