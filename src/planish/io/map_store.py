"""Hold maps of one grid while they are made, tile by tile.

They are in memory, or in a store from which parts are read back.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr

from planish.core.area import halved, middles, overview_count
from planish.core.errors import FileError, PlanishError
from planish.core.files import writing
from planish.core.grid import Grid
from planish.core.labelled import variable_data
from planish.core.lazy import LazyArray, Where
from planish.core.memory import LARGE_BYTES
from planish.core.older_names import FORMAT, todays_names
from planish.core.threads import map_threads
from planish.core.tiles import Tile, tiles_of
from planish.core.typing import Array, Entries, Shape, Shape2D
from planish.io.guard import reason_of
from planish.io.map_chunks import CODECS, StoredArray, is_ours, read_chunks, write_chunks

CHUNK = 512  # pixels along the edge of a chunk of a map
# Attribute of a store: one that is not there is a damage, not a missing value.
COMPLETE = "every_chunk_is_written"
ROOT: Entries = {COMPLETE: True, "format": FORMAT}  # no format: of planish 0.2.0, or 3
# Group of a store with smaller copies of its maps, which are read where they are shown.
OVERVIEWS = "overviews"

_TILE = (1024, 2048)  # whole chunks, also of the first overview


def map_tiles(shape: Shape2D) -> list[Tile]:
    """The tiles in which maps of a grid are made and written."""
    return tiles_of(shape, _TILE)


class StoredMaps:
    """Groups of maps (y, x) on one grid, of which tiles are added.

    They are in memory, or in a store with overviews.

    Small groups stay in memory, and all where there is no ``path``. Of what is read back from the
    store, the first ``keep_bytes`` stay in memory: most maps are read several times.

    Raises
    ------
    FileError
        If the store cannot be written or read.
    ResourceError
        If the disk is full.
    """

    def __init__(self, path: Path | None = None, *, keep_bytes: int = 0) -> None:
        self.path = path
        self.stored: list[str] = []  # names of the groups in the store, overviews among them
        self._arrays: dict[str, Entries] = {}
        self._groups: dict[str, xr.Dataset] = {}
        self._cache = PartCache(keep_bytes)

    def add(self, name: str, grid: Grid, tile: Tile, maps: xr.Dataset) -> None:
        """Add a tile of all maps of a group, and of its overviews.

        The first one says which maps there are; a later one may replace some of them.
        """
        self._cache.forget()
        if self.path is None:
            self._add(name, grid, tile, maps)
            return
        with writing(self.path):
            self._add(name, grid, tile, maps)
            n_overviews = overview_count(grid.shape) if name in self.stored else 0
            for k in range(1, n_overviews + 1):
                # Tiles begin at multiples of more pixels than there are in one of the last
                # overview.
                maps = halved(maps)
                r0 = tile.r0 >> k
                c0 = tile.c0 >> k
                overview_tile = Tile(r0, r0 + maps.sizes["y"], c0, c0 + maps.sizes["x"])
                grid = Grid(y_um=middles(grid.y_um), x_um=middles(grid.x_um))
                self._add(f"{OVERVIEWS}/{name}/{k}", grid, overview_tile, maps)

    def _add(self, name: str, grid: Grid, tile: Tile, maps: xr.Dataset) -> None:
        """Add a tile of one group or overview, which is made with the first one."""
        if name not in self._arrays:
            self._arrays[name] = self._create_arrays(name, grid, maps)

        def write(map_name: str) -> None:
            array = self._arrays[name][map_name]
            where = (tile.rows, tile.cols)
            values = maps[map_name].values
            if self.path is not None and name in self.stored:
                write_chunks(self.path / array.path, array, where, values)
            else:
                array[where] = values

        map_threads(write, map(str, maps.data_vars))

    def _create_arrays(self, name: str, grid: Grid, maps: xr.Dataset) -> Entries:
        """Arrays of a new group by the names of its maps, in memory or in the store."""
        pixel_bytes = sum(data.dtype.itemsize for data in maps.data_vars.values())
        is_small = pixel_bytes * math.prod(grid.shape) < LARGE_BYTES
        axes = {"y": grid.y_um, "x": grid.x_um}
        arrays: Entries = {}
        if self.path is None or (is_small and not name.startswith(f"{OVERVIEWS}/")):
            group = xr.Dataset(attrs=maps.attrs)
            for axis, axis_um in axes.items():
                group.coords[axis] = (axis, axis_um, dict(maps[axis].attrs))
            for key, data in maps.data_vars.items():
                arrays[str(key)] = np.empty(grid.shape, data.dtype)
                group[key] = (data.dims, arrays[str(key)], data.attrs)
            self._groups[name] = group
            return arrays
        group = open_group(self.path, name, maps)
        for axis, axis_um in axes.items():
            create_array(group, axis, maps[axis].variable, axis_um.shape)[:] = axis_um
        for key, data in maps.data_vars.items():
            map_name = str(key)
            arrays[map_name] = create_array(group, map_name, data.variable, grid.shape)
        self.stored.append(name)
        return arrays

    def group(self, name: str) -> xr.Dataset:
        """A group of which all tiles were added."""
        if self.path is None or name not in self.stored:
            return self._groups[name]
        return stored_group(self.path, name, self._cache)

    def overviews(self) -> dict[str, xr.Dataset]:
        """Smaller copies of the groups in the store."""
        names = [name for name in self.stored if name.startswith(f"{OVERVIEWS}/")]
        return {name: self.group(name) for name in names}


def open_group(path: Path, name: str, data: xr.Dataset) -> zarr.Group:
    """Open or make a group of a store, with the attributes of a dataset."""
    group = zarr.open_group(path, mode="a", attributes=ROOT).require_group(name)
    group.attrs.update(json_attrs(data.attrs))
    return group


def create_array(group: zarr.Group, key: str, like: xr.Variable, shape: Shape) -> StoredArray:
    """Make an array of a group, of the type, dimensions and attributes of a variable.

    Its chunks are those of maps, or zarr's own where it has one axis only.
    """
    dtype: Any = like.dtype
    fill_value: Any = np.nan if dtype.kind == "f" else 0
    if dtype.kind in "OU":
        dtype = str
        fill_value = ""
    chunks = "auto"
    if len(shape) > 1:
        chunks = tuple(min(n, CHUNK) for n in shape)
    return group.create_array(
        key,
        shape=shape,
        dtype=dtype,
        fill_value=fill_value,
        compressors=CODECS,
        config={"write_empty_chunks": True},
        chunks=chunks,
        dimension_names=[str(dim) for dim in like.dims],
        attributes=json_attrs(like.attrs),
    )


def stored_group(path: Path, name: str, cache: PartCache | None = None) -> xr.Dataset:
    """Give a group of a store whose maps stay there: each part is read when it is asked for.

    Parameters
    ----------
    path : Path; the store
    name : str; of the group
    cache : PartCache, optional; keeps parts in memory as far as it has room for them

    Returns
    -------
    Dataset

    Raises
    ------
    FileError
        If it is not there, or damaged; the latter also when a part is read.
    """
    cache = cache or PartCache(0)
    with readable(path):
        group = zarr.open_group(path, path=name, mode="r")
        coords: Entries = {}
        variables: Entries = {}
        other_coords: set[str] = set()  # coordinates that are no axis, as xarray notes them
        arrays: Any = sorted(group.arrays())
        for key, array in arrays:
            dims = tuple(map(str, array.metadata.dimension_names or ()))
            attrs = dict(array.attrs)
            attrs.pop("_FillValue", None)
            other_coords |= {*str(attrs.pop("coordinates", "")).split()}
            if array.ndim == 2:
                read_part = partial(_read_part, path, array, cache)
                values = variable_data(LazyArray(array.shape, np.dtype(array.dtype), read_part))
            else:
                values = array[...]
            variable = xr.Variable(dims, values, attrs)
            (coords if dims == (key,) else variables)[key] = variable
        coords |= {key: variables.pop(key) for key in other_coords & variables.keys()}
        maps = xr.Dataset(variables, coords=coords, attrs=dict(group.attrs))
        return _with_todays_names(maps) if _is_older(path) else maps


def _with_todays_names(maps: xr.Dataset) -> xr.Dataset:
    for variable in maps.variables.values():
        variable.attrs = todays_names(variable.attrs)
    maps.attrs = todays_names(maps.attrs)
    return maps.rename({name: todays_names(name) for name in maps.data_vars})


def _is_older(store: Path) -> bool:
    return zarr.open_group(store, mode="r").attrs.get("format") != FORMAT


def map_folder(store: Path, group: str, name: str) -> Path | None:
    """Folder of a map in a store, where it may have an older name; None where it is not."""
    is_older = _is_older(store)
    folders = (store / group).glob("*")
    names = {todays_names(path.name) if is_older else path.name: path for path in folders}
    return names.get(name)


def is_large(arrays: Iterable[Any]) -> bool:
    """True if the maps among the arrays of a group stay in their store."""
    return sum(array.nbytes for array in arrays if array.ndim == 2) >= LARGE_BYTES


def overviews_of(path: Path, group: str, name: str = "") -> list[str]:
    """List the names of a group's smaller copies in a store, or those of its map ``name``.

    The finest comes first.
    """
    copies: list[str] = []
    for k in count(1):
        copy = f"{OVERVIEWS}/{group}/{k}"
        is_there = map_folder(path, copy, name) if name else (path / copy).is_dir()
        if not is_there:
            break
        copies.append(copy)
    return copies


class PartCache:
    """Parts of arrays of a store that were read, as long as there is room for them."""

    def __init__(self, room_bytes: int) -> None:
        self._room = room_bytes
        self._parts = dict[Any, Array]()

    def forget(self) -> None:
        """Read all parts anew, as what they are read from is written."""
        self._room += sum(values.nbytes for values in self._parts.values())
        self._parts.clear()

    def part(self, path: Path, array: Any, where: Where) -> Array:
        """A part of an array of the store at ``path``, which the caller may write to."""
        spans = [(span.start, span.stop, span.step) for span in where]
        key = (array.path, *spans)
        if key in self._parts:
            return self._parts[key].copy()
        if is_ours(array) and all(span.step == 1 for span in where):
            values = read_chunks(path / array.path, array, where)
        else:
            values = np.asarray(array[where])
        if values.nbytes <= self._room:
            self._room -= values.nbytes
            self._parts[key] = values.copy()
        return values


def _read_part(path: Path, array: Any, cache: PartCache, where: Where) -> Array:
    with readable(path):
        return cache.part(path, array, where)


@contextmanager
def readable(path: Path) -> Generator[None]:
    """Turn what a damaged store raises into the error that says so."""
    try:
        yield
    except (PlanishError, MemoryError):
        raise
    except Exception as error:  # damaged metadata make zarr raise almost every type there is
        raise FileError(
            f"{path} cannot be read: {reason_of(error)}. It may be damaged; repeat the run."
        ) from error


def json_attrs(attrs: Mapping[Any, Any]) -> Entries:
    """Attributes as a store holds them."""
    plain: Entries = {}
    for key, value in attrs.items():
        is_array = isinstance(value, np.ndarray | np.generic)
        plain[str(key)] = value.tolist() if is_array else value
    return plain
