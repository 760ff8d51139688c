"""Smaller copies of a picture that has none: coarse ones kept in the user's cache, the others made when asked for.

A level that is at most eight times as coarse as the picture is averaged from the window that is shown. All coarser ones
come from one pass over the picture, tile by tile, and stay in the cache for the next session.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
import sys
import tempfile
import threading
import weakref
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.area import count_of, halved_values
from planish.core.lazy import LazyArray, Where
from planish.io.map_store import map_tiles

CACHE_BYTES = 8 * 2**30
"""Above this the copies that were not used for the longest time are removed."""

_LAST_ON_DEMAND = 3  # levels up to this one are made of the window that is asked for


def user_cache() -> Path:
    """Folder for what can be made again: that of ``PLANISH_CACHE``, or of the platform."""
    if folder := os.environ.get("PLANISH_CACHE"):
        return Path(folder)
    home = Path.home()
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local") / "planish" / "cache"
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "planish"
    return Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache") / "planish"


def cache_place(file: Path, *parts: str) -> Path:
    """Give the folder for the copies of a picture of a file: another one once the file has changed."""
    path = file.resolve()
    stat = path.stat()
    text = "\n".join([str(path), str(stat.st_size), str(stat.st_mtime_ns), *parts])
    return user_cache() / "levels" / hashlib.sha256(text.encode()).hexdigest()[:32]


class ComputedLevels:
    """All levels of a picture, full resolution first.

    Parameters
    ----------
    values : array (rows, cols)
        Of floating point or truth values.
    place : Path
        Of :func:`cache_place`.
    keep_all : bool
        Whether the values themselves are kept there as well: those of a file of which no window can be read.
    """

    def __init__(self, values: NDArray[Any] | xr.DataArray | LazyArray, place: Path, *, keep_all: bool = False) -> None:
        self._values, self._place = values, place
        rows, cols = values.shape
        self._shapes = [(-(-rows >> k), -(-cols >> k)) for k in range(count_of((rows, cols)) + 1)]
        self._cached = {k for k in range(len(self._shapes)) if k > _LAST_ON_DEMAND or (k == 0 and keep_all)}
        self._lock = threading.Lock()
        self._arrays: dict[int, NDArray[Any]] = {}

    def levels(self) -> list[LazyArray]:
        """One array a level; reading the first coarse one waits until all of them are made."""
        return [_Level(self, k, shape) for k, shape in enumerate(self._shapes)]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values of all levels."""
        return np.dtype(self._values.dtype)

    def read(self, k: int, where: Where) -> NDArray[Any]:
        """A window of a level."""
        if k in self._cached:
            return np.array(self._cached_arrays()[k][where])
        window = tuple(
            slice(part.start << k, min(part.stop << k, n)) for part, n in zip(where, self._shapes[0], strict=True)
        )
        pixels = np.asarray((self._cached_arrays()[0] if 0 in self._cached else self._values)[window])
        for _ in range(k):
            pixels = halved_values(pixels)
        return pixels[:: where[0].step or 1, :: where[1].step or 1]

    def _cached_arrays(self) -> dict[int, NDArray[Any]]:
        with self._lock:
            if not self._arrays:
                folder = self._place if self._place.is_dir() else self._make()
                with suppress(OSError):
                    os.utime(folder)
                self._arrays = {k: np.load(folder / f"{k}.npy", mmap_mode="r") for k in sorted(self._cached)}
                self._values = self._arrays.get(0, self._values)  # a decoded file need not stay in memory
        return self._arrays

    def _make(self) -> Path:
        """Make what is kept in one pass; in a folder that goes with the session where the cache takes nothing."""
        root = self._place.parent
        partial = root / f".{self._place.name}.{secrets.token_hex(4)}"
        is_cached = True
        try:
            partial.mkdir(parents=True)
        except OSError:
            partial = Path(tempfile.mkdtemp(prefix="planish-"))
            weakref.finalize(self, shutil.rmtree, partial, ignore_errors=True)
            is_cached = False
        try:
            self._write(partial)
            if is_cached:
                with suppress(OSError):  # another process was as fast
                    partial.rename(self._place)
        except BaseException:
            shutil.rmtree(partial, ignore_errors=True)
            raise
        if is_cached and self._place.is_dir():
            trim(root, keep=self._place)
            return self._place
        return partial

    def _write(self, folder: Path) -> None:
        rows, cols = self._shapes[0]
        targets = {
            k: np.lib.format.open_memmap(folder / f"{k}.npy", mode="w+", dtype=self.dtype, shape=self._shapes[k])
            for k in self._cached
        }
        for tile in map_tiles((rows, cols)):
            part = np.asarray(self._values[tile.rows, tile.cols])
            for k in range(len(self._shapes)):
                part = halved_values(part) if k else part
                if k in targets:
                    r, c = tile.r0 >> k, tile.c0 >> k
                    targets[k][r : r + part.shape[0], c : c + part.shape[1]] = part
        for target in targets.values():
            target.flush()


class _Level(LazyArray):
    def __init__(self, of: ComputedLevels, k: int, shape: tuple[int, int]) -> None:
        self._of, self._k = of, k
        self.shape, self.dtype = shape, of.dtype

    def read(self, where: Where) -> NDArray[Any]:
        """Read a window."""
        return self._of.read(self._k, where)


def trim(root: Path, *, keep: Path, most_bytes: int = CACHE_BYTES) -> None:
    """Remove copies that were not used for the longest time until the others take no more than ``most_bytes``."""
    with suppress(OSError):
        folders = sorted(
            (folder for folder in root.iterdir() if folder != keep), key=lambda folder: folder.stat().st_mtime
        )
        sizes = {folder: sum(file.stat().st_size for file in folder.iterdir()) for folder in [*folders, keep]}
        for folder in folders:
            if sum(sizes.values()) <= most_bytes:
                return
            shutil.rmtree(folder, ignore_errors=True)
            del sizes[folder]
