"""Smaller copies of maps against means worked out pixel by pixel."""

import numpy as np
import xarray as xr
import zarr

from planish.core.area import overviews
from planish.io import read_tree, write_tree


def maps(rows, cols):
    rng = np.random.default_rng(0)
    value = rng.normal(10, 2, (rows, cols)).astype(np.float32)
    value[rng.random(value.shape) < 0.3] = np.nan
    value[:4, :4] = np.nan
    data = {
        "thickness": (("y", "x"), value, {"units": "um"}),
        "valid": (("y", "x"), rng.random(value.shape) < 0.5),
        "status": (("y", "x"), np.ones(value.shape, np.uint8)),
    }
    return xr.Dataset(data, coords={"y": 3.0 + 2.0 * np.arange(rows), "x": 5.0 * np.arange(cols)})


def test_overviews_are_means_of_known_pixels_and_small_maps_need_none():
    full = maps(13, 10)
    first, second = list(overviews(full, most_px=4))
    assert (dict(first.sizes), dict(second.sizes)) == ({"y": 7, "x": 5}, {"y": 4, "x": 3})
    assert "status" not in first
    for i in range(7):
        for j in range(5):
            part = full["thickness"].values[2 * i : 2 * i + 2, 2 * j : 2 * j + 2]
            known = part[np.isfinite(part)]
            mean = known.astype(float).mean() if known.size else np.nan
            np.testing.assert_allclose(first["thickness"].values[i, j], mean, rtol=1e-6)
            true = full["valid"].values[2 * i : 2 * i + 2, 2 * j : 2 * j + 2]
            assert first["valid"].values[i, j] == (true.mean() >= 0.5)
    np.testing.assert_array_equal(first["y"], 4.0 + 4.0 * np.arange(7))
    np.testing.assert_array_equal(second["x"], 7.5 + 20.0 * np.arange(3))
    assert (first["thickness"].attrs, first["thickness"].dtype) == ({"units": "um"}, np.float32)
    assert not list(overviews(maps(512, 400)))


def test_a_store_has_square_chunks_and_gives_its_maps_without_the_overviews(tmp_path):
    full = maps(1100, 700)
    groups = {"maps": full} | {f"overviews/maps/{k}": d for k, d in enumerate(overviews(full), 1)}
    assert list(groups) == ["maps", "overviews/maps/1", "overviews/maps/2"]
    write_tree(tmp_path / "m.zarr", groups)
    stored = zarr.open_group(tmp_path / "m.zarr", mode="r")
    assert stored["maps/thickness"].chunks == (512, 512)
    assert stored["overviews/maps/2/thickness"].shape == (275, 175)
    read = read_tree(tmp_path / "m.zarr")
    assert list(read) == ["maps"]
    xr.testing.assert_identical(read["maps"].drop_attrs(), full.drop_attrs())
