"""Correlation of two maps against the size of points, with a band that holds the whole curve."""

import math
from collections.abc import Sequence

import numpy as np
from scipy import special

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import Correlation, PointsCorrelation, correlate, on_one_grid
from planish.analyze.distributions import widened
from planish.core.area import common_means, square_px
from planish.core.errors import SizeError
from planish.core.facts import NULL, Interval
from planish.core.grid import shorter_side_um
from planish.core.typing import Array, Entries, Floats, Pixel
from planish.texture.textures import influence_on_r, standard


class SizeRow(PointsCorrelation):
    """Correlation over points of one size, as one of many."""

    band: Interval = NULL
    """Joint 95 % band of r over all sizes."""


def size_curve(
    a: Array,
    b: Array,
    *,
    pixel_um: Pixel,
    sizes_um: Sequence[float] | None = None,
) -> tuple[SizeRow, ...]:
    """Correlate two maps over points of several sizes.

    Parameters
    ----------
    a, b, pixel_um
        As of :func:`planish.correlate`.
    sizes_um : sequence of float
        Edges of the points; from the pixel to an eighth of the shorter side where not given.

    Returns
    -------
    tuple of SizeRow
        From the smallest points to the largest; its band is (NaN, NaN) where nothing is claimed.

    Raises
    ------
    SizeError
        If a size is smaller than a pixel.

    Notes
    -----
    The correlations of neighbouring sizes scatter together. How much is told from what tiles of the
    field add to each of them; the limits are those of the largest of so many correlated normal
    deviates. The best of 8 sizes taken by itself would be "significant" in 9 % of unrelated maps.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> a = np.repeat(np.repeat(rng.normal(size=(30, 40)), 4, axis=0), 4, axis=1)
    >>> b = a + 2.0 * rng.normal(size=a.shape)
    >>> rows = size_curve(a, b, pixel_um=10.0, sizes_um=(10.0, 40.0))
    >>> [(row.point_um, round(row.r, 2)) for row in rows]
    [(10.0, 0.44), (40.0, 0.9)]
    """
    pixel = on_one_grid(a, b, pixel_um)
    if sizes_um is None:  # up by factors of the square root of 2
        largest_um = shorter_side_um(a.shape, pixel) / 8
        n_sizes = math.floor(2 * math.log2(max(largest_um / max(pixel), 1.0)) + 1e-9) + 1
        sizes_um = [max(pixel) * 2 ** (k / 2) for k in range(n_sizes)]
    if min(sizes_um, default=0) < max(pixel) * (1 - 1e-9):
        raise SizeError(
            f"A point of {min(sizes_um, default=0):g} um is smaller than a pixel of"
            f" {max(pixel):g} um."
        )
    rows: list[Correlation] = []
    tile_sums: list[Floats] = []
    for size in map(float, sorted(sizes_um)):
        x, y = common_means((a, b), square_px(size, pixel))
        rows.append(correlate(x, y, pixel_um=size))
        if _is_claimed(rows[-1]):
            tile_sums.append(_by_tiles(x, y, rows[-1].r))
    widening = _wider(tile_sums)
    curve: list[SizeRow] = []
    for row in rows:
        band = widened(row.r, row.interval, widening) if _is_claimed(row) else None
        curve.append(SizeRow.of(row, band=band))
    return tuple(curve)


def _is_claimed(row: Correlation) -> bool:
    """Whether r has an interval that is not of one number."""
    return not math.isnan(row.interval[0]) and abs(row.r) < 1


def _by_tiles(x: Floats, y: Floats, r: float) -> Floats:
    """Sum what the points of each tile of the field, six along its shorter side, add to r."""
    is_valid = np.isfinite(x) & np.isfinite(y)
    x, y = (standard(m, is_valid) for m in (x, y))
    contributions = influence_on_r(x, y, r)
    tile_px = min(is_valid.shape) / 6
    for axis, n in enumerate(is_valid.shape):
        n_tiles = max(round(n / tile_px), 1)
        starts = [round(k * n / n_tiles) for k in range(n_tiles)]
        contributions = np.add.reduceat(contributions, starts, axis=axis)
    return contributions.ravel()


def _wider(tile_sums: list[Floats]) -> float:
    """By what factor intervals of each size are widened to hold all sizes together."""
    if len(tile_sums) < 2:
        return 1.0
    n_tiles = min(sums.size for sums in tile_sums)
    correlations = np.corrcoef(np.stack([sums[:n_tiles] for sums in tile_sums]))
    power, vectors = np.linalg.eigh(np.nan_to_num(correlations))
    drawn = np.random.default_rng(20090502).normal(size=(20_000, len(tile_sums)))
    drawn = drawn @ (vectors * np.sqrt(np.maximum(power, 0.0))).T
    largest = np.abs(drawn).max(axis=1)
    return float(np.quantile(largest, 0.95) / special.ndtri(0.975))


def answer_sizes(pair: ComparedMaps) -> Entries:
    """R over points of growing size."""
    return {"sizes": size_curve(pair.x, pair.y, pixel_um=pair.cell_um)}
