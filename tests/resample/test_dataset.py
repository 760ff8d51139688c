"""Which variables of a dataset come along to the grid."""

import numpy as np
import xarray as xr

from flatten.meshes import grid
from planish.core.grid import Grid
from planish.resample import find_places, resample, resample_dataset


def test_a_dataset_takes_along_its_numbers_only():
    uv, labels = grid(12, 15, 3.0), np.arange(12 * 15).reshape(12, 15)
    about = {"units": "um", "long_name": "Height", "form_um": 1000.0}
    of_columns = {"common_um": 0.1, "patch_um2": 9.0}
    data = xr.Dataset(
        {"height": (("y", "x"), uv[..., 0], about | of_columns), "status": (("y", "x"), labels)}
    )
    places = find_places(uv, Grid.regular((6, 5), (4.0, 4.0), (1.0, 5.0)))
    coords = {"v": 4.0 * np.arange(6), "u": 4.0 * np.arange(5)}
    out = resample_dataset(data, places, dims=("v", "u"), coords=coords)
    assert (set(out.data_vars), out["height"].attrs) == ({"height"}, about)


def test_properties_and_presence_are_cubic_and_errors_linear():
    uv = grid(12, 15, 3.0)
    waves = np.sin(uv[..., 0])
    mesh = ("y", "x")
    fields = {
        "thickness": (mesh, waves, {"role": "property"}),
        "presence_faces": (mesh, waves),
        "thickness_se": (mesh, waves),
    }
    target = Grid.regular((6, 5), (4.0, 4.0), (4.0, 5.0))
    places = find_places(uv, target)
    coords = {"v": target.y_um, "u": target.x_um}
    out = resample_dataset(xr.Dataset(fields), places, dims=("v", "u"), coords=coords)
    cubic = resample(waves, places)
    linear = resample(waves, places, between="linear")
    assert np.abs(cubic - linear).max() > 0.01
    np.testing.assert_array_equal(out["thickness"], cubic)
    np.testing.assert_array_equal(out["presence_faces"], cubic)
    np.testing.assert_array_equal(out["thickness_se"], linear)
