"""One picture of a session: its levels, and the codes by which its tiles hold its values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from planish.core.grid import Grid
from planish.core.typing import Floats
from planish.io.map_store import CHUNK

Plane = Literal["moving", "fixed"]
PLANES: tuple[Plane, Plane] = ("moving", "fixed")

TILE = 256
"""Pixels along the edge of a tile."""

LAST_CODE = 65535

_WINDOW = 256  # pixels along the edge of the parts of a picture that show which values it has
_FEW, _MANY = 2, 4  # such parts along each side, with and without a coarse level
_WIDENED = 2.0  # spans by which their range is widened


class Answer(BaseModel):
    """Anything that the page is sent as JSON, which has no NaN."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


def finite_or_none(value: Any) -> float | None:
    """Give a number as JSON can hold it: None where it is not finite."""
    number = float(value)
    return number if math.isfinite(number) else None


class PictureFacts(Answer):
    """What a page has to know of a picture; see :class:`Picture`."""

    id: str
    plane: Plane
    layer: str
    name: str
    title: str
    units: str
    shape: tuple[int, int]
    pixel_um: tuple[float, float]
    origin_um: tuple[float, float]
    levels: int
    tile: int
    scale: float
    offset: float
    range: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Codes:
    """Values as whole numbers of 16 bits: 0 is missing, k from 1 on is ``offset + scale * (k - 1)``.

    The first and the last code also stand for all values beyond them.
    """

    offset: float
    scale: float

    @classmethod
    def between(cls, low: float, high: float) -> Codes:
        """Codes of all values from ``low`` to ``high``."""
        return cls(low, (high - low) / (LAST_CODE - 1) or 1.0)

    def of(self, values: NDArray[Any]) -> NDArray[np.uint16]:
        """Code each value."""
        if values.dtype == np.bool_:
            return values.astype(np.uint16) + np.uint16(1)
        is_valid = np.isfinite(values)
        codes = np.rint((np.where(is_valid, values.astype(np.float64), self.offset) - self.offset) / self.scale) + 1
        return np.where(is_valid, np.clip(codes, 1, LAST_CODE), 0).astype(np.uint16)

    def values(self, codes: NDArray[np.uint16]) -> Floats:
        """The values that codes stand for; NaN where they are missing."""
        return np.where(codes == 0, np.nan, self.offset + self.scale * (codes.astype(np.float64) - 1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A map or an image on one of the two planes of a session.

    Attributes
    ----------
    id : str
        By which the page asks for it.
    plane : {"moving", "fixed"}
    layer : str
        Layer that it belongs to.
    name : str
        Variable in the store; with the layer before it where several layers have their own.
    title, units : str
    levels : sequence of DataArray (rows, cols)
        Full resolution first, each next one with pixels twice as wide; values are read where they are asked for.
    around_zero : bool
        Whether 0 is in the middle of its colours.
    """

    id: str
    plane: Plane
    layer: str
    name: str
    title: str
    units: str
    levels: Sequence[xr.DataArray]
    around_zero: bool = False

    @property
    def full(self) -> xr.DataArray:
        """Full resolution."""
        return self.levels[0]

    @cached_property
    def grid(self) -> Grid:
        """Pixels of full resolution."""
        return Grid.of(self.full)

    @property
    def is_mask(self) -> bool:
        """Whether it holds truth values."""
        return self.full.dtype == np.bool_

    def level_within(self, pixels: int) -> int:
        """The finest level of at most so many pixels."""
        fitting = (k for k, data in enumerate(self.levels) if data.size <= pixels)
        return next(fitting, len(self.levels) - 1)

    @cached_property
    def codes(self) -> Codes:
        """How tiles hold its values: room for single pixels, which vary more than the parts that were looked at."""
        values = np.concatenate([self._coarse, self._sample])
        if self.is_mask or values.size == 0:
            return Codes(0.0, 1.0)
        low, high = float(values.min()), float(values.max())
        span = max(high - low, 1e-6 * max(abs(low), abs(high)), 1e-30)
        more = 0.0 if len(self.levels) == 1 else _WIDENED * span
        return Codes.between(low - more, low + span + more)

    @cached_property
    def range(self) -> tuple[float, float]:
        """2nd to 98th percentile."""
        values = self._coarse if self._coarse.size else self._sample
        if self.is_mask or values.size == 0:
            return 0.0, 1.0
        low, high = (float(v) for v in np.percentile(values, [2, 98]))
        if self.around_zero:
            high = max(abs(low), abs(high))
            low = -high
        return (low, high) if high > low else (low - 0.5, high + 0.5)

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
        each = _FEW if self._coarse.size else _MANY
        tops, lefts = (
            (np.linspace(0.5, n - 0.5, 2 * each + 1).astype(int)[1::2] // CHUNK * CHUNK).tolist()
            for n in self.full.shape
        )
        return _finite_values([self.full[r : r + _WINDOW, c : c + _WINDOW].values for r in tops for c in lefts])

    @property
    def facts(self) -> PictureFacts:
        """What a page has to know."""
        rows, cols = self.grid.shape
        return PictureFacts(
            id=self.id, plane=self.plane, layer=self.layer, name=self.name, title=self.title, units=self.units,
            shape=(rows, cols), pixel_um=self.grid.pixel_um, origin_um=self.grid.origin_um, levels=len(self.levels),
            tile=TILE, scale=self.codes.scale, offset=self.codes.offset, range=self.range,
        )  # fmt: skip


def _finite_values(parts: Sequence[NDArray[Any]]) -> Floats:
    values = np.concatenate([np.empty(0), *(part.ravel() for part in parts)]).astype(np.float64)
    return values[np.isfinite(values)]


class Stored(tuple[xr.DataArray, ...]):
    """Levels that lie in a store."""
