"""Correlation of two maps against the size of the points, with a band that holds the whole curve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planish.analyze.correlation import Correlation, correlate, on_one_grid, valid_in_both
from planish.core.area import AreaMeans
from planish.core.errors import SizeError
from planish.core.facts import NULL, Interval, Pair, ResultModel, Value
from planish.core.typing import Bools, Floats

if TYPE_CHECKING:
    from planish.analyze.diagnostics import ComparedMaps


_LEAST_POINTS = 8  # along the shorter side
_SEED = 20090502
_DRAWS = 20_000
_CHANCE = 0.95
_TILES = 6  # along the shorter side, of which what the sizes share is told


class SizeRow(ResultModel):
    """Correlation over points of one size, as one of many."""

    point_um: float = Field(description="Edge of the points.")
    n: int = Field(description="Points that are valid in both.")
    r: Value = Field(description="Pearson's correlation.")
    n_eff: Value = Field(description="Independent points.")
    interval: Interval = Field(description="In which this r lies with 95 %.")
    band: Interval = Field(default=NULL, description="In which the r of all sizes lie together with 95 %.")

    @classmethod
    def of(cls, row: Correlation, band: Pair = (math.nan, math.nan)) -> SizeRow:
        """Take what a curve shows of a correlation."""
        return cls(point_um=row.point_um, n=row.n, r=row.r, n_eff=row.n_eff, interval=row.interval, band=band)


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeCurve:
    """Correlations over points of growing size.

    Attributes
    ----------
    rows : tuple of Correlation
        Each with the interval of its own.
    band : tuple of (float, float)
        In which the r of all sizes lie together with 95 %; (NaN, NaN) where nothing is claimed.
    """

    rows: tuple[Correlation, ...]
    band: tuple[tuple[float, float], ...]


def usual_sizes(shape: tuple[int, int], pixel_um: tuple[float, float]) -> list[float]:
    """Sizes from the pixel up by factors of the square root of 2, as far as the field holds 8 points across."""
    least, most = max(pixel_um), min(n * p for n, p in zip(shape, pixel_um, strict=True)) / _LEAST_POINTS
    count = math.floor(2 * math.log2(max(most / least, 1.0)) + 1e-9) + 1
    return [least * 2 ** (k / 2) for k in range(count)]


def size_curve(
    a: NDArray[Any], b: NDArray[Any], *, mask: Bools | None = None,
    pixel_um: float | tuple[float, float], sizes_um: Sequence[float] | None = None,
) -> SizeCurve:  # fmt: skip
    """Correlate two maps over points of several sizes.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
        On one grid; NaN is missing.
    mask : ndarray of bool, shape (rows, cols), optional
    pixel_um : float or (float, float)
        Along y and x.
    sizes_um : sequence of float, optional
        Edges of the points; from the pixel to an eighth of the shorter side where not given.

    Returns
    -------
    SizeCurve

    Raises
    ------
    SizeError
        If a size is smaller than a pixel.

    Notes
    -----
    The correlations of neighbouring sizes scatter together. How much is told from what tiles of the field add to each
    of them; the limits are those of the largest of so many correlated normal deviates. The best of 8 sizes taken by
    itself would be "significant" in 9 % of unrelated maps.
    """
    pixel = on_one_grid(a, b, mask, pixel_um)
    sizes = sorted(usual_sizes((a.shape[0], a.shape[1]), pixel) if sizes_um is None else map(float, sizes_um))
    if not sizes or sizes[0] < max(pixel) * (1 - 1e-9):
        raise SizeError(f"A point of {min(sizes, default=0):g} um is smaller than a pixel of {max(pixel):g} um.")
    is_valid = valid_in_both(a, b, mask)
    x, y = (np.where(is_valid, m, np.nan) for m in (a, b))
    rows, parts = list[Correlation](), list[Floats]()
    for size in sizes:
        means = AreaMeans((is_valid.shape[0], is_valid.shape[1]), (size / pixel[0], size / pixel[1]))
        means.add(0, is_valid, x, y)
        points = means.means()
        rows.append(correlate(points[0], points[1], pixel_um=size))
        parts.append(_by_tiles(points, rows[-1].r))
    claimed = [k for k, row in enumerate(rows) if not math.isnan(row.interval[0]) and abs(row.r) < 1]
    wider = _wider([parts[k] for k in claimed])
    band = [(math.nan, math.nan)] * len(rows)
    for k in claimed:
        z, (low, high) = math.atanh(rows[k].r), (math.atanh(v) for v in rows[k].interval)
        band[k] = math.tanh(z + wider * (low - z)), math.tanh(z + wider * (high - z))
    return SizeCurve(rows=tuple(rows), band=tuple(band))


def _by_tiles(points: list[Floats], r: float) -> Floats:
    """Sum what the points of each tile of the field add to r."""
    is_valid = np.isfinite(points[0]) & np.isfinite(points[1])
    if np.count_nonzero(is_valid) < 3 or math.isnan(r):
        return np.zeros(0)
    x, y = ((m - m[is_valid].mean()) / max(float(m[is_valid].std()), 1e-300) for m in points)
    added = np.where(is_valid, x * y - r / 2 * (x * x + y * y), 0.0)
    side = min(is_valid.shape) / _TILES
    for axis, n in enumerate(is_valid.shape):
        count = max(round(n / side), 1)
        added = np.add.reduceat(added, [round(k * n / count) for k in range(count)], axis=axis)
    return added.ravel()


def _wider(parts: list[Floats]) -> float:
    """By what factor intervals of each size are widened to hold all sizes together."""
    if len(parts) < 2:
        return 1.0
    count = min(p.size for p in parts)
    together = np.corrcoef(np.stack([p[:count] for p in parts]))
    rng = np.random.default_rng(_SEED)
    power, vectors = np.linalg.eigh(np.nan_to_num(together))
    drawn = rng.normal(size=(_DRAWS, len(parts))) @ (vectors * np.sqrt(np.maximum(power, 0.0))).T
    most = np.quantile(np.abs(drawn).max(axis=1), _CHANCE)
    return float(most / 1.959963984540054)


def answer_sizes(pair: ComparedMaps) -> dict[str, Any]:
    """R over points of growing size."""
    curve = size_curve(pair.x, pair.y, pixel_um=pair.cell_um)
    return {"sizes": tuple(SizeRow.of(row, band) for row, band in zip(curve.rows, curve.band, strict=True))}
