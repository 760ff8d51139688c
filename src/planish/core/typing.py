"""Short names for the types that most modules use, and a pair out of an array."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]
Singles = NDArray[np.float32]  # of single precision
Pair = tuple[float, float]
TwoFields = tuple[Floats, Floats]  # such as both faces of a sheet, or rows and columns
ThreeFields = tuple[Floats, Floats, Floats]
NamedFields = dict[str, Floats]
Codes = NDArray[np.uint8]  # such as status
Pixel = float | Pair  # edge of a pixel in um, or its edges along y and x
Array = NDArray[Any]
Window = tuple[slice, slice]  # rows and columns of a part
Complexes = NDArray[np.complex128]
DType = np.dtype[Any]
Shape = tuple[int, ...]
Shape2D = tuple[int, int]  # rows and columns, or a lag along both
Texts = tuple[str, ...]  # names, words or sentences
Entries = dict[str, Any]  # values by name: attributes, facts, what a file holds
Fields = Mapping[str, Any]  # the same, only read


def pair_of(values: Array) -> Pair:
    """Two numbers of an array, such as x and y, as Python's own."""
    first, second = values.tolist()
    return first, second
