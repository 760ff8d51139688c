"""Tiles of a session's pictures as raw 16-bit values, and the blocks of values that they are cut from.

Stored maps have chunks of 512 x 512 pixels. A chunk that was read stays for a while: four tiles, the cursor and a
profile all need the same ones.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from concurrent.futures import Future
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.app.picture import TILE, Picture
from planish.app.pictures import Pictures
from planish.core.errors import InputError
from planish.io.map_store import CHUNK

BLOCKS_BYTES = 96 * 2**20
"""Bytes of blocks that are held."""

Key = tuple[str, int, int, int]


class Tiles:
    """Windows of pictures, block by block.

    Attributes
    ----------
    read_bytes : int
        Of all blocks that were read so far.
    """

    def __init__(self, pictures: Pictures, *, most_bytes: int = BLOCKS_BYTES) -> None:
        self.pictures, self._most_bytes = pictures, most_bytes
        self._lock, self._blocks, self._held = threading.Lock(), OrderedDict[Key, Future[NDArray[Any]]](), 0
        self.read_bytes = 0

    def tile(self, id: str, level: int, row: int, col: int) -> bytes:
        """Codes of one tile: TILE x TILE little-endian 16-bit values, row by row; 0 where there is no picture.

        Raises
        ------
        InputError
            If there is no such picture, level or tile.
        FileError
            If the picture is damaged.
        """
        picture = self.pictures[id]
        if not 0 <= level < len(picture.levels):
            raise InputError(f"{picture.name} has {len(picture.levels)} levels; there is no level {level}.")
        rows, cols = picture.levels[level].shape
        if not (0 <= row * TILE < rows and 0 <= col * TILE < cols):
            raise InputError(f"Level {level} of {picture.name} has no tile {row}, {col}.")
        window = slice(row * TILE, min((row + 1) * TILE, rows)), slice(col * TILE, min((col + 1) * TILE, cols))
        codes = np.zeros((TILE, TILE), "<u2")
        part = picture.codes.of(self.window(picture, level, *window))
        codes[: part.shape[0], : part.shape[1]] = part
        return codes.tobytes()

    def window(self, picture: Picture, level: int, rows: slice, cols: slice) -> NDArray[Any]:
        """Values of a window of a level."""
        pixels = np.empty((rows.stop - rows.start, cols.stop - cols.start), picture.levels[level].dtype)
        for i in range(rows.start // CHUNK, -(-rows.stop // CHUNK)):
            for j in range(cols.start // CHUNK, -(-cols.stop // CHUNK)):
                block = self.block(picture, level, i, j)
                (of_r, in_r), (of_c, in_c) = _shared(rows, i, block.shape[0]), _shared(cols, j, block.shape[1])
                pixels[of_r, of_c] = block[in_r, in_c]
        return pixels

    def values_at(self, picture: Picture, level: int, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> NDArray[Any]:
        """Values of single pixels (n,) of a level."""
        pixels = np.empty(rows.size, picture.levels[level].dtype)
        i, j = rows // CHUNK, cols // CHUNK
        for a, b in {*zip(i.tolist(), j.tolist(), strict=True)}:
            here = (i == a) & (j == b)
            pixels[here] = self.block(picture, level, a, b)[rows[here] - a * CHUNK, cols[here] - b * CHUNK]
        return pixels

    def block(self, picture: Picture, level: int, i: int, j: int) -> NDArray[Any]:
        """The i-th block down and j-th across; whoever asks for it while it is read waits for the same one."""
        key = (picture.id, level, i, j)
        with self._lock:
            mine = Future[NDArray[Any]]()
            future = self._blocks.setdefault(key, mine)
            self._blocks.move_to_end(key)
        if future is not mine:
            return future.result()
        try:
            data = picture.levels[level]
            block = data[i * CHUNK : (i + 1) * CHUNK, j * CHUNK : (j + 1) * CHUNK].values
        except BaseException as error:
            with self._lock:
                self._blocks.pop(key, None)
            mine.set_exception(error)
            raise
        mine.set_result(block)
        with self._lock:
            self.read_bytes += block.nbytes
            self._held += block.nbytes
            while self._held > self._most_bytes and (old := next(iter(self._blocks))) != key:
                if not self._blocks[old].done():
                    self._blocks.move_to_end(old)
                    continue
                self._held -= self._blocks.pop(old).result().nbytes
        return block


def _shared(of: slice, k: int, length: int) -> tuple[slice, slice]:
    """Give the place of the k-th block in a window, and of the window in the block."""
    start, stop = max(of.start, k * CHUNK), min(of.stop, k * CHUNK + length)
    return slice(start - of.start, stop - of.start), slice(start - k * CHUNK, stop - k * CHUNK)
