"""Arrays that are read or computed part by part.

Shape and type are known, values only where they are asked for.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from itertools import product
from typing import Any, NamedTuple, TypeVar

import numpy as np

from planish.core.typing import Array, DType, Shape

T = TypeVar("T")
Where = tuple[slice, ...]  # one slice an axis: start, stop just behind the last place, step above 0


class ChunkPart(NamedTuple):
    """What a part of an array takes from one of its chunks."""

    position: Shape  # of the chunk among all
    within: Where  # of the chunk
    target: Where  # of the part


def chunk_parts(where: Where, chunk: Sequence[int]) -> Iterator[ChunkPart]:
    """Chunks in which a part of an array lies, by the lengths of a chunk; steps are passed over."""
    edges = zip(where, chunk, strict=True)
    numbers = [range(w.start // c, -(-w.stop // c)) for w, c in edges]
    for position in product(*numbers):
        within: list[slice] = []
        target: list[slice] = []
        for w, k, c in zip(where, position, chunk, strict=True):
            start = max(w.start, k * c)
            stop = min(w.stop, (k + 1) * c)
            within.append(slice(start - k * c, stop - k * c))
            target.append(slice(start - w.start, stop - w.start))
        yield ChunkPart(position, tuple(within), tuple(target))


class LazyArray:
    """An array read in parts, by integers and slices, from any thread.

    ``read`` gives one as native ``dtype``.
    """

    chunks: Shape | None = None  # what is decoded together, where the file is chunked
    whole_slices: bool = False  # whether a few rows of a slice cost as much as all of them

    def __init__(self, shape: Shape, dtype: DType, read: Callable[[Where], Array]) -> None:
        self.shape = shape
        self.dtype = dtype
        self._read = read

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def nbytes(self) -> int:
        """Size of the whole array."""
        return math.prod(self.shape) * self.dtype.itemsize

    def read(self, where: Where) -> Array:
        """Read a part, in the array's own type."""
        return self._read(where)

    def guarded(self) -> AbstractContextManager[None]:
        """Context in which parts are read, which may turn errors into others."""
        return nullcontext()

    def __getitem__(self, key: Any) -> Array:
        """Read what integers and slices select."""
        keys = key if isinstance(key, tuple) else (key,)
        if Ellipsis not in keys:
            keys = (*keys, Ellipsis)
        k = keys.index(Ellipsis)
        whole_axes = (slice(None),) * (self.ndim - len(keys) + 1)
        keys = keys[:k] + whole_axes + keys[k + 1 :]
        where, part_keys = zip(*map(_selected, keys, self.shape), strict=True)
        shape = lengths(where)
        with self.guarded():
            part = self.read(where) if all(shape) else np.empty(shape, self.dtype)
            chosen = part[part_keys]
            # A view would keep the whole file mapped, or the slice that it was cut from.
            is_whole = chosen.base is part and part.base is None and chosen.size == part.size
            if chosen.base is None or is_whole:
                return np.ascontiguousarray(chosen, self.dtype)
            return np.array(chosen, self.dtype)


def _selected(key: Any, length: int) -> tuple[slice, slice | int]:
    """The part of an axis with what a key selects, its step above 0, and the key within it."""
    if not isinstance(key, slice):
        index = range(length)[int(key)]
        return slice(index, index + 1, 1), 0
    indices = range(length)[key]
    direction = 1 if indices.step > 0 else -1
    ordered = indices[::direction]
    stop = ordered[-1] + 1 if ordered else ordered.start
    return slice(ordered.start, stop, ordered.step), slice(None, None, direction)


def lengths(where: Where) -> list[int]:
    """Places along each axis of a part."""
    return [len(range(s.start, s.stop, s.step)) for s in where]


class ReadOnDemand(Mapping[str, T]):
    """Values by name, each read when it is first asked for, and their names as well."""

    def __init__(self, names: Callable[[], Iterable[str]], read: Callable[[str], T]) -> None:
        self._names = cache(lambda: tuple(names()))
        self._read = cache(read)

    def __getitem__(self, name: str) -> T:
        """Read a value, or give it once more; KeyError where there is none of that name."""
        if name not in self._names():
            raise KeyError(name)
        return self._read(name)

    def __contains__(self, name: object) -> bool:
        """Whether there is a value of that name; it is not read."""
        return name in self._names()

    def __iter__(self) -> Iterator[str]:
        """Give the names."""
        return iter(self._names())

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._names())
