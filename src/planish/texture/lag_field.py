"""Lags of tiles show where the registration of two maps is off.

They also show whether one map is stretched against the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from planish.core.errors import SizeError
from planish.core.typing import Bools, Floats, Pair, Shape2D
from planish.texture.ncc import (
    MARGIN,
    MaskedNcc,
    Peak,
    covariance_of,
    find_peak,
    lost_between_pixels,
    within,
)

_TILE = np.dtype(
    [("centre", "2f8"), ("lag", "2f8"), ("covariance", "(2,2)f8"), ("r", "f8"), ("share", "f8")]
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LagField:
    """Lags of tiles, one row each; tiles of which less than half is known are left out."""

    at_um: Floats  # middle of the tiles, (n, 2): `(x, y)` from the middle of the first pixel
    lag_um: Floats  # (n, 2): `(x, y)`; NaN where the peak is not distinct
    covariance_um2: Floats  # of the lags, (n, 2, 2)
    r: Floats  # correlation at the peak of each tile, a searched one
    distinct: Bools  # whether the peak is a summit above what 99 % of tiles of unrelated maps reach
    tile_um: float  # side of a tile

    def scaled(self, factor: float) -> LagField:
        """The same with lengths that are larger by a factor."""
        return replace(
            self,
            at_um=factor * self.at_um,
            lag_um=factor * self.lag_um,
            covariance_um2=factor**2 * self.covariance_um2,
            tile_um=factor * self.tile_um,
        )

    def linear(self) -> tuple[Floats, Floats, Floats] | None:
        """Lag at the middle of the map, its change with place, and standard errors of the change.

        Returns
        -------
        tuple of ndarray or None
            Lag at the mean place of the distinct tiles ``(2,)`` in um; derivatives ``(2, 2)``, a
            row for the lag along x and y, a column for the place: 0.001 is a stretch by 0.1 %;
            their standard errors ``(2, 2)``, from the scatter of the tiles about the plane. None
            with fewer than 6 distinct tiles or all in one line.

        Notes
        -----
        Neighbouring tiles share half of their pixels, so the standard errors count a quarter of the
        tiles.
        """
        use = self.distinct
        if int(use.sum()) < 6:
            return None
        centres = self.at_um[use]
        variances = np.trace(self.covariance_um2[use], axis1=1, axis2=2)
        weight = 1.0 / np.sqrt(variances)[:, None]
        lag = self.lag_um[use] * weight
        from_middle = centres - centres.mean(axis=0)
        design = weight * np.column_stack([np.ones(len(centres)), from_middle])
        if np.linalg.matrix_rank(design) < 3:
            return None
        coefficients = np.linalg.lstsq(design, lag, rcond=None)[0]
        residuals = lag - design @ coefficients
        variance = (residuals**2).sum(axis=0) / (len(centres) - 3)
        spread = np.diag(np.linalg.inv(design.T @ design))[1:]
        return coefficients[0], coefficients[1:].T, np.sqrt(4.0 * np.outer(variance, spread))


def _place_of(
    peak: Peak | None, a: Floats, b: Floats, a_valid: Bools, b_valid: Bools
) -> tuple[Floats, Floats]:
    """Lag and its covariance in pixels, along x and y; NaN where there is no summit."""
    if peak is None or not peak.inner:
        return np.full(2, np.nan), np.full((2, 2), np.nan)
    covariance = covariance_of(peak, a, b, a_valid, b_valid) + lost_between_pixels(peak)
    return peak.summit_px[::-1], covariance[::-1, ::-1]


def _z(r: ArrayLike, share: ArrayLike) -> Floats:
    """Fisher's z of tiles, each put to that of one which is known throughout."""
    return np.arctanh(np.minimum(r, 0.999999)) * np.sqrt(share)


def lag_field(
    a: Floats,
    b: Floats,
    is_valid: Bools,
    pixel_um: Pair,
    *,
    reach: Shape2D,
    tile_um: float,
    unrelated: list[Floats],
    overlapping: bool = True,
) -> LagField:
    """Find the lag of every tile of a within b, by positive correlation.

    Tiles overlap by half, or not at all.

    The maps are without trend, 0 where not valid. The null are the peaks of the unrelated maps, of
    b's texture, in all tiles, each put to the tile's size. Tiles no larger than twice the reach, or
    larger than the map, are refused.
    """
    side_px = [round(tile_um / p) for p in pixel_um]
    allowed = within(reach)
    wide = (reach[0] + MARGIN, reach[1] + MARGIN)
    rows, cols = side_px
    is_small = np.less_equal(side_px, np.multiply(2, wide)).any()
    if is_small or np.greater(side_px, a.shape).any():
        raise SizeError(
            f"Tiles of {tile_um:g} um are too small for the reach, or larger than the map. Take"
            f" sides above {2 * max(wide[0] * pixel_um[0], wide[1] * pixel_um[1]):.3g} um, or a"
            " shorter reach."
        )
    step = np.array([pixel_um[1], pixel_um[0]])
    tiles: list[tuple[Floats, Floats, Floats, float, float]] = []
    null_z: list[float] = []
    starts = (
        range(0, n - side + 1, max(side // (1 + overlapping), 1))
        for n, side in zip(a.shape, side_px, strict=True)
    )
    for row, col in product(*starts):
        # The tile of a, and b around it as far as the search goes: every lag keeps its pairs.
        around_rows = slice(max(row - wide[0], 0), row + rows + wide[0])
        around_cols = slice(max(col - wide[1], 0), col + cols + wide[1])
        around = (around_rows, around_cols)
        tile = np.s_[row : row + rows, col : col + cols]
        is_in_tile = np.zeros(a.shape, dtype=bool)
        is_in_tile[tile] = is_valid[tile]
        share = is_valid[tile].mean()
        if share < 0.5:
            continue
        masks = (is_in_tile[around], is_valid[around])
        correlate = MaskedNcc(a[around], a_valid=masks[0], b_valid=masks[1], reach=wide)
        peak = find_peak(correlate(b[around]), allowed)
        for values in unrelated:
            r = np.nanmax(correlate(values[around])[allowed], initial=0.0)
            null_z.append(float(_z(r, share)))
        centre_um = np.array([col + (cols - 1) / 2, row + (rows - 1) / 2]) * step
        lag, covariance = _place_of(peak, a[around], b[around], *masks)
        covariance_um2 = covariance * np.outer(step, step)
        r = np.nan if peak is None else peak.r
        tiles.append((centre_um, lag * step, covariance_um2, r, share))
    table = np.array(tiles, dtype=_TILE)
    limit = np.quantile(null_z, 0.99, method="higher") if null_z else np.inf
    height = _z(np.abs(table["r"]), table["share"])
    distinct = np.isfinite(table["lag"][:, 0]) & (height > limit)
    return LagField(
        at_um=table["centre"],
        lag_um=np.where(distinct[:, None], table["lag"], np.nan),
        r=table["r"],
        distinct=distinct,
        tile_um=tile_um,
        covariance_um2=np.where(distinct[:, None, None], table["covariance"], np.nan),
    )
