"""Maps that are made tile by tile: a store against memory, and what is said of a damaged one."""

import numpy as np
import pytest
import xarray as xr

from planish.core.area import overviews
from planish.core.errors import FileError
from planish.core.grid import Grid
from planish.core.tiles import tiles_of
from planish.io import StoredMaps, map_store, read_tree, stored_group, write_tree


@pytest.fixture
def stored(tmp_path, monkeypatch):
    """A group of maps that is "large", added in tiles; as it should be, and its store."""
    monkeypatch.setattr(map_store, "LARGE_BYTES", 1)
    grid = Grid.regular((1100, 700), (2.0, 3.0), (5.0, 7.0))
    rng = np.random.default_rng(1)
    thickness = rng.normal(80, 5, grid.shape).astype(np.float32)
    thickness[rng.random(grid.shape) < 0.2] = np.nan
    whole = xr.Dataset(
        {
            "thickness": (("y", "x"), thickness, {"units": "um", "support_um": np.float64(3.0)}),
            "u": (("y", "x"), rng.normal(size=grid.shape)),
            "valid": (("y", "x"), np.isfinite(thickness)),
        },
        coords=grid.coords,
    )
    sink = StoredMaps(tmp_path / "maps.zarr")
    for tile in tiles_of(grid.shape, (1024, 512)):
        sink.add("linked", grid, tile, whole.isel(y=tile.rows, x=tile.cols))
    return whole, sink


@pytest.mark.ci
def test_a_store_gives_the_maps_and_their_overviews_part_by_part(stored):
    whole, sink = stored
    found = sink.group("linked")
    assert set(found.data_vars) == set(whole.data_vars)
    assert found["thickness"].attrs == {"units": "um", "support_um": 3.0}
    xr.testing.assert_identical(found.load().drop_attrs(), whole.drop_attrs())
    np.testing.assert_array_equal(
        sink.group("linked")["u"][1000:1100, 500:].values, whole["u"][1000:1100, 500:]
    )
    smaller = [*overviews(whole)]
    assert [f"overviews/linked/{k + 1}" for k in range(len(smaller))] == sorted(sink.overviews())
    for name, expected in zip(sorted(sink.overviews()), smaller, strict=True):
        xr.testing.assert_allclose(
            sink.group(name).load().drop_attrs(), expected.drop_attrs(), rtol=1e-12
        )


def test_what_is_read_again_comes_from_memory_as_long_as_there_is_room(stored):
    whole, sink = stored
    again = StoredMaps(sink.path, keep_bytes=whole["u"].nbytes)
    again.stored = sink.stored
    first = again.group("linked")["u"].values
    first[:] = 0.0  # the caller's own
    (sink.path / "linked" / "u" / "c" / "0" / "0").write_bytes(b"damaged")
    np.testing.assert_array_equal(again.group("linked")["u"].values, whole["u"])


@pytest.mark.parametrize("has_path", [True, False])
def test_small_groups_stay_in_memory_whatever_the_tiles(tmp_path, has_path):
    grid = Grid.regular((60, 50), 2.0)
    values = np.arange(3000.0).reshape(60, 50)
    whole = xr.Dataset({"a": (("y", "x"), values, {"units": "um"})}, coords=grid.coords)
    sink = StoredMaps(tmp_path / "maps.zarr") if has_path else StoredMaps()
    for tile in tiles_of(grid.shape, (16, 32)):
        sink.add("one", grid, tile, whole.isel(y=tile.rows, x=tile.cols))
    xr.testing.assert_identical(sink.group("one"), whole)
    assert (sink.stored, sink.overviews()) == ([], {})
    assert not (tmp_path / "maps.zarr").exists()


def test_a_large_group_of_a_store_stays_there_and_a_damage_is_said(stored):
    whole, sink = stored
    write_tree(sink.path, {"flat": whole[["u"]].isel(y=slice(9), x=slice(9))})
    groups = read_tree(sink.path)
    assert {"linked", "overviews/linked/1"} <= groups.keys()
    xr.testing.assert_identical(groups["linked"].load().drop_attrs(), whole.drop_attrs())
    assert "overviews/linked/2" in groups
    chunk = sink.path / "linked" / "thickness" / "c" / "1" / "1"
    chunk.write_bytes(chunk.read_bytes()[:100])
    lost = stored_group(sink.path, "linked")["thickness"]
    np.testing.assert_array_equal(lost[:512].values, whole["thickness"][:512])
    with pytest.raises(FileError, match="damaged"):
        _ = lost.values
    with pytest.raises(FileError, match="cannot be read"):
        stored_group(sink.path, "none")
