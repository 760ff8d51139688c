"""Columns made ready for the fit: the air at 0, the sheet above it, the outer side first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.tiles import Tile
from planish.surface.centre import gaussian_regression
from planish.surface.coarse import CoarseSheet, to_columns
from planish.surface.columns import Columns

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Guide:
    """Where the coarse search saw the sheet, for every column of a grid.

    Attributes
    ----------
    low, high : (rows, cols)
        First and last depth index of the sheet; NaN where there is none.
    slope_r, slope_c : (rows, cols)
        Rise of the sheet, in voxels of depth from one voxel row, or voxel column, to the next.
    tilt : (rows, cols)
        Cosine of the sheet's tilt.
    """

    low: Array
    high: Array
    slope_r: Array
    slope_c: Array
    tilt: Array

    def part(self, tile: Tile) -> Guide:
        """Return the guide of a tile."""
        at = tile.rows, tile.cols
        return Guide(
            low=self.low[at], high=self.high[at], slope_r=self.slope_r[at], slope_c=self.slope_c[at], tilt=self.tilt[at]
        )

    def faces(self, depth: int, *, high: bool) -> tuple[Array, Array]:
        """Depth of the outer and of the opposite face, counted from the end that is read from."""
        outer, other = (self.high, self.low) if high else (self.low, self.high)
        return (depth - 1 - outer, depth - 1 - other) if high else (outer, other)


def make_guide(coarse: CoarseSheet, columns: Columns) -> Guide:
    """Bring the coarse sheet to single columns."""
    shape, pitch = columns.shape[:2], columns.pitch
    low, high = (to_columns(field, coarse.block, shape) for field in (coarse.low, coarse.high))
    smooth = gaussian_regression(
        0.5 * (low + high) * pitch[2], pitch[:2],
        cutoff_um=max(8 * coarse.block * max(pitch[:2]), 2 * float(np.nanmedian(high - low)) * pitch[2]),
    )  # fmt: skip
    slope_r, slope_c = (np.gradient(smooth, p, axis=i) for i, p in enumerate(pitch[:2]))
    cosine = 1 / np.sqrt(1 + slope_r**2 + slope_c**2)
    voxels = (slope * p / columns.step / pitch[2] for slope, p in zip((slope_r, slope_c), pitch[:2], strict=True))
    along_r, along_c = (np.where(np.isfinite(v), v, 0.0) for v in voxels)
    return Guide(low=low, high=high, slope_r=along_r, slope_c=along_c, tilt=np.where(np.isfinite(cosine), cosine, 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """How grey is turned into what the fit sees.

    Attributes
    ----------
    air : float
        Its level becomes 0.
    polarity : float
        -1 where the sheet is darker than the air.
    blend : float
        Standard deviation of the Gaussian over neighbouring columns, in columns.
    """

    air: float
    polarity: float
    blend: float = 0.0

    @property
    def halo(self) -> int:
        """Columns around a tile that are read with it."""
        return int(np.ceil(3 * self.blend)) if self.blend else 0

    def grown(self, tile: Tile, shape: tuple[int, int]) -> Tile:
        """Return the tile with its halo, as far as the grid reaches."""
        return tile.grown(self.halo, self.halo, shape)


def oriented(columns: Columns, tile: Tile, guide: Guide, scale: Scale) -> NDArray[np.float32]:
    """Grey above the air of the columns of a tile, (rows, cols, depth); ``guide`` is that of the grown tile."""
    outside = scale.grown(tile, columns.shape[:2])
    part = columns.grey(outside, (guide.slope_r, guide.slope_c))
    part -= np.float32(scale.air)
    if scale.polarity < 0:
        part *= np.float32(-1)
    if not scale.halo:
        return part
    part = ndimage.gaussian_filter(part, (scale.blend, scale.blend, 0), mode="nearest", truncate=3.0)
    inner = tile.within(outside)
    return np.ascontiguousarray(part[inner.rows, inner.cols])
