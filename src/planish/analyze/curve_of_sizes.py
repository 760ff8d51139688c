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
    pixel_edge_um = max(pixel)
    if sizes_um is None:  # up by factors of the square root of 2
        largest_px = shorter_side_um(a.shape, pixel) / 8 / pixel_edge_um
        n_factors = 2 * math.log2(max(largest_px, 1.0))
        n_sizes = math.floor(n_factors + 1e-9) + 1
        sizes_um = [pixel_edge_um * 2 ** (k / 2) for k in range(n_sizes)]
    least_um = min(sizes_um, default=0)
    if least_um < pixel_edge_um * (1 - 1e-9):
        raise SizeError(
            f"A point of {least_um:g} um is smaller than a pixel of {pixel_edge_um:g} um."
        )
    rows: list[Correlation] = []
    tile_sums: list[Floats] = []
    for size in map(float, sorted(sizes_um)):
        x, y = common_means((a, b), square_px(size, pixel))
        row = correlate(x, y, pixel_um=size)
        rows.append(row)
        if _is_claimed(row):
            tile_sums.append(_by_tiles(x, y, row.r))
    widening = _wider(tile_sums)
    curve: list[SizeRow] = []
    for row in rows:
        band = None
        if _is_claimed(row):
            band = widened(row.r, row.interval, widening)
        curve.append(SizeRow.of(row, band=band))
    return tuple(curve)


def _is_claimed(row: Correlation) -> bool:
    """Whether r has an interval that is not of one number."""
    return not math.isnan(row.interval[0]) and abs(row.r) < 1


def _by_tiles(x: Floats, y: Floats, r: float) -> Floats:
    """Sum what the points of each tile of the field, six along its shorter side, add to r.

    ``x`` and ``y`` (rows, cols) are both maps over points of one size. A tile is a point at least.
    """
    is_valid = np.isfinite(x) & np.isfinite(y)
    x, y = (standard(m, is_valid) for m in (x, y))
    contributions = influence_on_r(x, y, r)
    tile_px = min(is_valid.shape) / 6
    for axis, n in enumerate(is_valid.shape):
        n_tiles = min(max(round(n / tile_px), 1), n)
        starts = [round(k * n / n_tiles) for k in range(n_tiles)]
        contributions = np.add.reduceat(contributions, starts, axis=axis)
    return contributions.ravel()


def _wider(tile_sums: list[Floats]) -> float:
    """By what factor intervals of each size are widened to hold all sizes together.

    ``tile_sums`` are, for each size, what each tile of the field adds to r. Sizes scatter together
    as these do; 20 000 draws of as many correlated normal deviates say how large the largest of
    them gets in 95 %.
    """
    if len(tile_sums) < 2:
        return 1.0
    # Sizes that leave a rest at the border may have other numbers of tiles.
    n_tiles = min(sums.size for sums in tile_sums)
    in_common = np.stack([sums[:n_tiles] for sums in tile_sums])
    correlations = np.corrcoef(in_common)
    power, vectors = np.linalg.eigh(np.nan_to_num(correlations))
    deviates = np.random.default_rng(20090502).normal(size=(20_000, len(tile_sums)))
    factors = vectors * np.sqrt(np.maximum(power, 0.0))
    largest = np.abs(deviates @ factors.T).max(axis=1)
    return float(np.quantile(largest, 0.95) / special.ndtri(0.975))


def answer_sizes(pair: ComparedMaps) -> Entries:
    """R over points of growing size."""
    return {"sizes": size_curve(pair.x, pair.y, pixel_um=pair.cell_um)}
