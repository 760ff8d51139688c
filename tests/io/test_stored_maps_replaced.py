"""A map of a store that is written again is read as it was written last."""

import numpy as np
import pytest
import xarray as xr

from planish.core.grid import Grid
from planish.io import map_store
from planish.io.map_store import StoredMaps, map_tiles


@pytest.mark.parametrize("least_bytes", [0, 10**12])
def test_what_was_read_before_is_not_kept(tmp_path, monkeypatch, least_bytes):
    monkeypatch.setattr(map_store, "LARGE_BYTES", least_bytes)
    grid = Grid.regular((40, 30), 2.0)
    (tile,) = map_tiles(grid.shape)
    values = np.random.default_rng(0).normal(size=grid.shape).astype(np.float32)
    maps = {"image": (("y", "x"), values), "other": (("y", "x"), 2 * values)}
    store = StoredMaps(tmp_path / "maps.zarr", keep_bytes=10**6)
    store.add("linked", grid, tile, xr.Dataset(maps, grid.coords))
    linked = store.group("linked")
    np.testing.assert_array_equal(linked["image"].values, values)
    changed = xr.Dataset({"image": (("y", "x"), values - 1)}, grid.coords)
    store.add("linked", grid, tile, changed)
    for group in (linked, store.group("linked")):
        part = group["image"].isel(y=slice(3, 20), x=slice(5, 9)).values
        np.testing.assert_array_equal(part, values[3:20, 5:9] - 1)
        np.testing.assert_array_equal(group["other"].values, 2 * values)
