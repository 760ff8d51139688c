"""Maps as text for a page: values in 8 or 16 bits, their differences deflated, and in base64.

A value is ``low + step * (code - 2)``. Code 0 is missing, 1 lies below the range and the largest code above it.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.typing import Floats

Codes = NDArray[np.unsignedinteger[Any]]

_TYPES = {8: np.uint8, 16: np.uint16}
_BEYOND = 0.05  # per cent of the values that may lie beyond either end, where single ones would take the digits
_LEVEL = 6  # a higher one takes five times as long and saves 2 %
_MUCH = 1.5  # times the range of the others: what single values may add to it


@dataclass(frozen=True, slots=True, kw_only=True)
class Packed:
    """A packed map.

    Attributes
    ----------
    text : str
        The differences of the codes, deflated, in base64.
    shape : (rows, cols)
    bits : {8, 16}
    order : {1, 2}
        Differences along the rows, or along the rows and then down the columns.
    low, step : float
        Value of code 2, and from one code to the next.
    beyond : int
        Values outside of the range.
    exact : bool
        Whether every value is that of its code, as with the whole numbers of a camera.
    """

    text: str
    shape: tuple[int, int]
    bits: int
    order: int
    low: float
    step: float
    beyond: int
    exact: bool

    @property
    def error(self) -> float:
        """Largest difference of a value from that of its code."""
        return 0.0 if self.exact else self.step / 2

    def spec(self) -> dict[str, Any]:
        """Give what the script needs to unpack it."""
        return {
            "rows": self.shape[0], "cols": self.shape[1], "bits": self.bits, "order": self.order, "low": self.low,
            "step": self.step,
        }  # fmt: skip


def packed(values: NDArray[Any], *, bits: int = 8) -> Packed:
    """Pack a map (rows, cols); NaN is missing.

    Eight bits leave 252 steps over the range of the values, sixteen 65 532. Where the outermost 0.05 % at an end would
    take a third of them, these are only known to lie beyond. Where all values lie a whole number of steps apart and
    there are codes enough, nothing is lost.
    """
    data = np.asarray(values, dtype=np.float64)
    finite = data[np.isfinite(data)]
    low, high = _range(finite)
    most = 2**bits - 1
    spacing = _spacing(finite, most - 3)
    step = spacing or (high - low) / (most - 3)
    low = float(finite.min()) if spacing else low
    codes = np.zeros(data.shape, _TYPES[bits])
    step_counts = np.rint((np.where(np.isfinite(data), data, low) - low) / step)
    shown = np.clip(step_counts, -1, most - 2) + 2
    codes[:] = np.where(np.isfinite(data), shown, 0)
    order, text = min(((k, _deflated(codes, k)) for k in (1, 2)), key=lambda candidate: len(candidate[1]))
    return Packed(
        text=base64.b64encode(text).decode("ascii"), shape=(data.shape[0], data.shape[1]), bits=bits, order=order,
        low=low, step=step, beyond=int(np.count_nonzero((codes == 1) | (codes == most))), exact=spacing is not None,
    )  # fmt: skip


def _range(finite: Floats) -> tuple[float, float]:
    if not finite.size:
        return 0.0, 1.0
    least, most = float(finite.min()), float(finite.max())
    low, high = (float(v) for v in np.percentile(finite, [_BEYOND, 100 - _BEYOND]))
    if high > low and most - least > _MUCH * (high - low):
        least, most = low, high
    tiny = 1e-9 * max(abs(least), abs(most), 1e-300)
    return (least, most) if most - least > tiny else (least - 0.5, least + 0.5)


def _spacing(finite: Floats, most: int) -> float | None:
    """The step that all values lie a whole number of apart, where so few of them span the range; else None."""
    values = np.unique(finite)
    if values.size < 2:
        return None
    steps = np.diff(values)
    step = float(steps.min())
    if (values[-1] - values[0]) / step > most:
        return None
    whole = steps / step
    return step if np.abs(whole - np.rint(whole)).max() < 1e-6 else None


def _deflated(codes: Codes, order: int) -> bytes:
    """Deflate differences along the rows and, of second order, of those down the columns."""
    along = codes.copy()
    along[:, 1:] -= codes[:, :-1]
    differences = along.copy()
    if order == 2:
        differences[1:] -= along[:-1]
    if differences.dtype == np.uint8:
        return zlib.compress(differences.tobytes(), _LEVEL)
    # Small differences of either sign have a high byte of 0, and all high bytes stand together.
    signed = differences.view(np.int16)
    folded = ((signed << 1) ^ (signed >> 15)).view(np.uint16)
    return zlib.compress((folded & 255).astype(np.uint8).tobytes() + (folded >> 8).astype(np.uint8).tobytes(), _LEVEL)
