"""One picture of a session.

Its levels, stored or computed, and the codes by which its tiles hold its values.
"""

from __future__ import annotations

import hashlib
import math
import os
import secrets
import shutil
import tempfile
import threading
import weakref
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numba.misc.appdirs import AppDirs
from numpy.typing import NDArray

from planish.core.area import halved_values, overview_count
from planish.core.grid import Grid
from planish.core.lazy import LazyArray, Where
from planish.core.typing import Array, Entries, Floats, Pair
from planish.io.map_store import CHUNK, map_tiles
from planish.run.run import is_run

Plane = Literal["moving", "fixed"]
PLANES: tuple[Plane, Plane] = ("moving", "fixed")
WHERE: dict[Plane, str] = {"moving": "on the volume side", "fixed": "in the image"}
TILE = 256
"""Pixels along the edge of a tile."""

LAST_CODE = 65535
_WINDOW = 256  # pixels along the edge of the parts that are sampled
# Such parts along each side, with and without a coarse level.
_FEW = 2
_MANY = 4


def finite_or_none(number: Any) -> float | None:
    """Give a number as JSON can hold it: None where it is missing or not finite."""
    if number is not None and math.isfinite(number):
        return float(number)
    return None


def layer_run(run: Path, layer: str) -> Path:
    """Give the folder of the run that holds the maps of a layer.

    It is one within a run of several, or the run itself.
    """
    layer_folder = run / "layers" / layer
    return layer_folder if is_run(layer_folder) else run


@dataclass(frozen=True, slots=True)
class Codes:
    """Values in 16 bits: 0 is missing, k from 1 on ``offset + scale * (k - 1)``.

    The ends stand for all beyond, too.
    """

    offset: float
    scale: float

    @classmethod
    def between(cls, low: float, high: float) -> Codes:
        """Codes of all values from ``low`` to ``high``."""
        return cls(low, (high - low) / (LAST_CODE - 1) or 1.0)

    def of(self, values: Array) -> NDArray[np.uint16]:
        """Code each value."""
        if values.dtype == np.bool_:
            return values.astype(np.uint16) + np.uint16(1)
        offsets = values.astype(np.float64) - self.offset
        steps = np.rint(offsets / self.scale)
        codes = np.clip(steps + 1, 1, LAST_CODE)
        codes = np.where(np.isfinite(values), codes, 0)
        return codes.astype(np.uint16)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanePicture:
    """A map or an image on one of the two planes of a session."""

    plane: Plane
    layer: str  # that it belongs to
    name: str  # variable in the store; with the layer before it where several layers have their own
    title: str
    units: str
    # Full resolution first, each next half as fine; read when asked for.
    levels: Sequence[xr.DataArray]
    around_zero: bool = False  # whether 0 is in the middle of its colours
    id: str = ""  # by which the page asks for it

    @property
    def variable(self) -> str:
        """Its name in the store, whatever the layer."""
        return self.name.rpartition("/")[2]

    @property
    def full(self) -> xr.DataArray:
        """Full resolution."""
        return self.levels[0]

    @cached_property
    def grid(self) -> Grid:
        """Pixels of full resolution."""
        return Grid.of(self.full)

    @cached_property
    def codes(self) -> Codes:
        """How tiles hold its values, with room for single pixels.

        Single pixels vary more than the parts that were looked at.
        """
        values = np.concatenate([self._coarse, self._sample])
        if self.full.dtype == np.bool_ or values.size == 0:
            return Codes(0.0, 1.0)
        low = float(values.min())
        high = float(values.max())
        span = max(high - low, 1e-6 * max(abs(low), abs(high)), 1e-30)
        margin = 0.0 if len(self.levels) == 1 else 2.0 * span
        return Codes.between(low - margin, low + span + margin)

    @cached_property
    def range(self) -> Pair:
        """2nd to 98th percentile."""
        values = self._coarse if self._coarse.size else self._sample
        if self.full.dtype == np.bool_ or values.size == 0:
            return 0.0, 1.0
        low, high = map(float, np.percentile(values, [2, 98]))
        if self.around_zero:
            high = max(abs(low), abs(high))
            low = -high
        if high > low:
            return low, high
        return low - 0.5, high + 0.5

    @cached_property
    def _coarse(self) -> Floats:
        """Known values of the coarsest level, where it is there already."""
        has_coarse = isinstance(self.levels, Stored) or len(self.levels) == 1
        return _finite_values([self.levels[-1].values] if has_coarse else [])

    @cached_property
    def _sample(self) -> Floats:
        """Known values of windows all over the picture, each within one chunk."""
        if len(self.levels) == 1:
            return _finite_values([])
        n_windows = _FEW if self._coarse.size else _MANY
        starts: list[list[int]] = []  # of the chunks that hold evenly spread places
        for n in self.full.shape:
            middles = np.linspace(0.5, n - 0.5, 2 * n_windows + 1).astype(int)[1::2]
            starts.append((middles // CHUNK * CHUNK).tolist())
        windows = [self.full[r : r + _WINDOW, c : c + _WINDOW] for r, c in product(*starts)]
        return _finite_values([window.values for window in windows])

    def described(self) -> Entries:
        """Give what a page has to know."""
        names = ("id", "plane", "layer", "name", "title", "units", "range")
        return {name: getattr(self, name) for name in names} | {
            "shape": self.grid.shape,
            "pixel_um": self.grid.pixel_um,
            "origin_um": self.grid.origin_um,
            "levels": len(self.levels),
            "tile": TILE,
            "scale": self.codes.scale,
            "offset": self.codes.offset,
        }


def _finite_values(arrays: Sequence[Array]) -> Floats:
    """Finite values of all arrays, in one row; empty of no array."""
    values = np.concatenate([np.empty(0), *map(np.ravel, arrays)]).astype(np.float64)
    return values[np.isfinite(values)]


class Stored(tuple[xr.DataArray, ...]):
    """Levels that lie in a store."""


CACHE_BYTES = 8 * 2**30
"""Above this the copies that were not used for the longest time are removed."""

_LAST_ON_DEMAND = 3  # levels up to this one are made of the window that is asked for


def user_cache() -> Path:
    """Folder for what can be made again: that of ``PLANISH_CACHE``, or of the platform."""
    given_folder = os.environ.get("PLANISH_CACHE")
    return Path(given_folder or AppDirs("planish", appauthor=False).user_cache_dir)


def cache_folder(file: Path, *keys: str) -> Path:
    """Give the folder for the copies of a file's picture: another once the file has changed."""
    path = file.resolve()
    stat = path.stat()
    key = "\n".join([f"{path}", f"{stat.st_size}", f"{stat.st_mtime_ns}", *keys])
    digest = hashlib.sha256(key.encode()).hexdigest()
    return user_cache() / "levels" / digest[:32]


class ComputedLevels:
    """All levels of a picture of ``values`` (rows, cols), floats or truth values.

    Full resolution first.

    ``folder`` is that of :func:`cache_folder`; with ``keep_all`` it keeps the values of a file
    without windows, too.
    """

    def __init__(
        self, values: xr.DataArray | LazyArray, folder: Path, *, keep_all: bool = False
    ) -> None:
        self._values = values
        self._folder = folder
        self.dtype = np.dtype(values.dtype)
        rows, cols = values.shape
        levels = range(overview_count((rows, cols)) + 1)
        self._shapes = [(-(-rows >> k), -(-cols >> k)) for k in levels]
        self._cached_levels = {k for k in levels if k > _LAST_ON_DEMAND or (k == 0 and keep_all)}
        self._lock = threading.Lock()
        self._arrays: dict[int, Array] = {}

    def levels(self) -> list[LazyArray]:
        """One array a level; reading the first coarse one waits until all of them are made."""
        return [
            LazyArray(shape, self.dtype, partial(self.read, k))
            for k, shape in enumerate(self._shapes)
        ]

    def read(self, k: int, where: Where) -> Array:
        """A window of level k, which has pixels 2^k times as wide as full resolution."""
        if k in self._cached_levels:
            return np.array(self._level_arrays()[k][where])
        full = self._values
        if 0 in self._cached_levels:
            full = self._level_arrays()[0]
        rows, cols = where
        # Slices take what lies behind the end for the end.
        pixels = np.asarray(
            full[rows.start << k : rows.stop << k, cols.start << k : cols.stop << k]
        )
        for _ in range(k):
            pixels = halved_values(pixels)
        return pixels[:: rows.step or 1, :: cols.step or 1]

    def _level_arrays(self) -> dict[int, Array]:
        """The levels that are kept, mapped from their files, which are made where they are not."""
        with self._lock:
            if not self._arrays:
                folder = self._folder if self._folder.is_dir() else self._make()
                with suppress(OSError):  # the time of the last use, which `trim` goes by
                    os.utime(folder)
                for k in sorted(self._cached_levels):
                    self._arrays[k] = np.load(folder / f"{k}.npy", mmap_mode="r")
                # A decoded file need not stay in memory.
                self._values = self._arrays.get(0, self._values)
        return self._arrays

    def _make(self) -> Path:
        """Make what is kept in one pass, and give its folder.

        One that goes with the session where the cache takes nothing.
        """
        cache_root = self._folder.parent
        temporary = cache_root / f".{self._folder.name}.{secrets.token_hex(4)}"
        is_cached = True
        try:
            temporary.mkdir(parents=True)
        except OSError:
            temporary = Path(tempfile.mkdtemp(prefix="planish-"))
            weakref.finalize(self, shutil.rmtree, temporary, ignore_errors=True)
            is_cached = False
        try:
            self._write(temporary)
            if is_cached:
                with suppress(OSError):  # another process was as fast
                    temporary.rename(self._folder)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise
        if is_cached and self._folder.is_dir():
            trim(cache_root, keep=self._folder)
            return self._folder
        return temporary

    def _write(self, folder: Path) -> None:
        """Write the levels that are kept, tile by tile of the full resolution."""
        level_files: dict[int, np.memmap[Any, Any]] = {}
        for k in self._cached_levels:
            path = folder / f"{k}.npy"
            level_files[k] = np.lib.format.open_memmap(path, "w+", self.dtype, self._shapes[k])
        for tile in map_tiles(self._shapes[0]):
            level_pixels = np.asarray(self._values[tile.rows, tile.cols])
            for k in range(len(self._shapes)):
                level_pixels = halved_values(level_pixels) if k else level_pixels
                if k in level_files:
                    rows, cols = level_pixels.shape
                    from_tile = level_files[k][tile.r0 >> k :, tile.c0 >> k :]
                    from_tile[:rows, :cols] = level_pixels
        for level_file in level_files.values():
            level_file.flush()


def trim(root: Path, *, keep: Path, most_bytes: int = CACHE_BYTES) -> None:
    """Remove copies unused for the longest time until the others take at most ``most_bytes``."""
    with suppress(OSError):
        removable = {*root.iterdir()} - {keep}
        folders = sorted(removable, key=lambda folder: folder.stat().st_mtime)
        sizes: dict[Path, int] = {}
        for folder in [*folders, keep]:
            sizes[folder] = sum(file.stat().st_size for file in folder.iterdir())
        for folder in folders:
            if sum(sizes.values()) <= most_bytes:
                return
            shutil.rmtree(folder, ignore_errors=True)
            del sizes[folder]
