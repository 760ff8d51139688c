"""Maps of one grid while they are made, tile by tile: in memory, or in a store from which parts are read back."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec

from planish.core.area import count_of, halved, middles
from planish.core.errors import FileError, PlanishError
from planish.core.files import writing
from planish.core.grid import Grid
from planish.core.lazy import LazyArray, Where, held
from planish.core.tiles import Tile, tiles_of
from planish.core.typing import Floats

CHUNK = 512  # pixels along the edge of a chunk of a map
COMPLETE = "every_chunk_is_written"  # attribute of a store: one that is not there is a damage, not a missing value
OVERVIEWS = "overviews"  # group of a store with smaller copies of its maps, which are read where they are shown
LARGE = 2**29  # bytes of a group of maps from which on it stays in its store and is read part by part

# Maps hold noise: with their bytes sorted by weight they take a fifth less room than by zstd, in a fifth of the time.
# The sum tells a damaged chunk.
CODECS = (BloscCodec(cname="lz4", clevel=1, shuffle="shuffle"), Crc32cCodec())
_TILE = (1024, 2048)  # whole chunks, also of the first overview


def map_tiles(shape: tuple[int, int]) -> list[Tile]:
    """The tiles in which maps of a grid are made and written."""
    return tiles_of(shape, _TILE)


class HeldMaps:
    """Groups of maps (y, x) on one grid, of which tiles are added; in memory."""

    def __init__(self) -> None:
        self._arrays: dict[str, dict[str, Any]] = {}
        self._groups: dict[str, xr.Dataset] = {}

    def add(self, name: str, grid: Grid, tile: Tile, maps: xr.Dataset) -> None:
        """Add a tile of all maps of a group; the first one says which there are."""
        if name not in self._arrays:
            self._arrays[name] = self._create_arrays(name, grid, maps)
        for key, data in maps.data_vars.items():
            self._arrays[name][str(key)][tile.rows, tile.cols] = data.values

    def _create_arrays(self, name: str, grid: Grid, maps: xr.Dataset) -> dict[str, Any]:
        """Make the arrays of a group for maps like these."""
        variables = {k: (data.dims, np.empty(grid.shape, data.dtype), data.attrs) for k, data in maps.data_vars.items()}
        self._groups[name] = group = xr.Dataset(variables, coords=_coords(grid, maps), attrs=maps.attrs)
        return {str(k): data.values for k, data in group.data_vars.items()}

    def group(self, name: str) -> xr.Dataset:
        """Give a group of which all tiles were added."""
        return self._groups[name]

    def overviews(self) -> dict[str, xr.Dataset]:
        """Smaller copies of groups that are too large to be drawn as they are, ``overviews/GROUP/1`` and so on."""
        return {}


class StoredMaps(HeldMaps):
    """Maps in memory, and larger groups in a store at ``path``, with overviews.

    Of what is read back, the first ``keep_bytes`` stay in memory: most maps are read several times.

    Raises
    ------
    FileError
        If the store cannot be written or read.
    ResourceError
        If the disk is full.
    """

    def __init__(self, path: Path, *, keep_bytes: int = 0) -> None:
        super().__init__()
        self.path = path
        self.stored: list[str] = []  # names of the groups in the store, overviews among them
        self._cache = PartCache(keep_bytes)

    def add(self, name: str, grid: Grid, tile: Tile, maps: xr.Dataset) -> None:
        """Add a tile of all maps of a group, and of its overviews."""
        with writing(self.path):
            super().add(name, grid, tile, maps)
            if name not in self.stored:
                return
            coarser = grid
            for k in range(1, count_of(grid.shape) + 1):
                # Tiles begin at multiples of more pixels than there are in one of the last overview.
                maps = halved(maps)
                part = Tile(tile.r0 >> k, (tile.r0 >> k) + maps.sizes["y"], tile.c0 >> k, 0)
                part = part._replace(c1=part.c0 + maps.sizes["x"])
                coarser = Grid(y_um=middles(coarser.y_um), x_um=middles(coarser.x_um))
                super().add(f"{OVERVIEWS}/{name}/{k}", coarser, part, maps)

    def _create_arrays(self, name: str, grid: Grid, maps: xr.Dataset) -> dict[str, Any]:
        size = sum(data.dtype.itemsize for data in maps.data_vars.values()) * grid.shape[0] * grid.shape[1]
        if size < LARGE and not name.startswith(f"{OVERVIEWS}/"):
            return super()._create_arrays(name, grid, maps)
        group = zarr.open_group(self.path, mode="a", attributes={COMPLETE: True}).require_group(name)
        group.attrs.update(_json_attrs(maps.attrs))

        def create(key: str, dims: tuple[str, ...], attrs: Mapping[Any, Any], **more: Any) -> Any:
            more |= {"dimension_names": dims, "compressors": CODECS, "attributes": _json_attrs(attrs)}
            return group.create_array(key, **more)

        for axis, places, attrs in _coords(grid, maps).values():
            create(axis, (axis,), attrs, shape=places.shape, dtype=places.dtype)[:] = places
        arrays: dict[str, Any] = {}
        for key, data in maps.data_vars.items():
            fill = np.nan if data.dtype.kind == "f" else 0
            chunks, how = tuple(min(n, CHUNK) for n in grid.shape), {"write_empty_chunks": True}
            arrays[str(key)] = create(
                str(key),
                tuple(map(str, data.dims)),
                data.attrs,
                shape=grid.shape,
                dtype=data.dtype,
                chunks=chunks,
                fill_value=fill,
                config=how,
            )
        self.stored.append(name)
        return arrays

    def group(self, name: str) -> xr.Dataset:
        """A group of which all tiles were added."""
        return stored_group(self.path, name, self._cache) if name in self.stored else super().group(name)

    def overviews(self) -> dict[str, xr.Dataset]:
        """Smaller copies of the groups in the store."""
        return {name: self.group(name) for name in self.stored if name.startswith(f"{OVERVIEWS}/")}


def stored_group(path: Path, name: str, cache: PartCache | None = None) -> xr.Dataset:
    """Give a group of a store whose maps stay there: each part is read when it is asked for.

    Parts that were read stay in memory as far as ``cache`` has room for them.

    Raises
    ------
    FileError
        If it is not there, or damaged; the latter also when a part is read.
    """
    cache = cache or PartCache(0)
    with readable(path):
        group = zarr.open_group(path, path=name, mode="r")
        coords: dict[str, Any] = {}
        variables: dict[str, Any] = {}
        other_coords: set[str] = set()  # coordinates that are no axis, as xarray notes them
        for key, array in sorted(_arrays(group)):
            dims = tuple(map(str, array.metadata.dimension_names or ()))
            attrs = {k: v for k, v in array.attrs.items() if k not in ("_FillValue", "coordinates")}
            other_coords |= {*str(array.attrs.get("coordinates", "")).split()}
            (coords if dims == (key,) else variables)[key] = xr.Variable(
                dims, held(_StoredArray(path, array, cache)) if array.ndim == 2 else array[...], attrs
            )
        coords |= {key: variables.pop(key) for key in other_coords & variables.keys()}
        return xr.Dataset(variables, coords=coords, attrs=dict(group.attrs))


def is_large(group: xr.Dataset) -> bool:
    """True if the maps of a group stay in their store."""
    return sum(data.nbytes for data in group.data_vars.values() if data.ndim == 2) >= LARGE


def large_groups(path: Path) -> Iterator[str]:
    """Names of the groups of a store whose maps should stay there, and of their overviews."""
    with readable(path):
        members = zarr.open_group(path, mode="r").members(max_depth=None)
        groups = [(name, node) for name, node in members if isinstance(node, zarr.Group)]
        sizes = {name: sum(array.nbytes for _, array in _arrays(node) if array.ndim == 2) for name, node in groups}
        for name, size in sizes.items():
            # An overview, ``overviews/GROUP/LEVEL``, is as large as its group.
            if size and name.startswith(f"{OVERVIEWS}/"):
                size = max(size, sizes[name.split("/", 1)[1].rpartition("/")[0]])
            if size >= LARGE:
                yield name


def _arrays(group: zarr.Group) -> list[tuple[str, Any]]:
    return [*group.arrays()]


class PartCache:
    """Parts of arrays of a store that were read, as long as there is room for them."""

    def __init__(self, room_bytes: int) -> None:
        self._room, self._parts = room_bytes, dict[Any, NDArray[Any]]()

    def part(self, array: Any, where: Where) -> NDArray[Any]:
        """A part of an array, which the caller may write to."""
        key = (array.path, *((s.start, s.stop, s.step) for s in where))
        if key in self._parts:
            return self._parts[key].copy()
        part = np.asarray(array[where])
        if part.nbytes <= self._room:
            self._room -= part.nbytes
            self._parts[key] = part.copy()
        return part


class _StoredArray(LazyArray):
    """An array of a store, of which parts are read."""

    def __init__(self, path: Path, array: Any, cache: PartCache) -> None:
        self._path, self._array, self._cache = path, array, cache
        self.shape, self.dtype = array.shape, np.dtype(array.dtype)

    def read(self, where: Where) -> NDArray[Any]:
        """Read a part."""
        with readable(self._path):
            return self._cache.part(self._array, where)


@contextmanager
def readable(path: Path) -> Generator[None]:
    """Turn what a damaged store raises into the error that says so."""
    try:
        yield
    except (PlanishError, MemoryError):
        raise
    except Exception as error:  # damaged metadata make zarr raise almost every type there is
        # Some reasons hold the whole file.
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise FileError(f"{path} cannot be read: {reason}. It may be damaged; repeat the run.") from error


def _coords(grid: Grid, maps: xr.Dataset) -> dict[str, tuple[str, Floats, dict[str, Any]]]:
    """Coordinates of all of a grid, with the attributes of those of some maps on it."""
    axes = zip(("y", "x"), (grid.y_um, grid.x_um), strict=True)
    return {axis: (axis, values, dict(maps[axis].attrs)) for axis, values in axes}


def _json_attrs(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """Attributes as JSON has them."""
    return {str(k): v.tolist() if isinstance(v, np.ndarray | np.generic) else v for k, v in attrs.items()}
