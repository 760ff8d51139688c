"""Lags of tiles show where the registration of two maps is off.

They also show whether one map is stretched against the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

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
        if use.sum() < 6:
            return None
        centres = self.at_um[use]
        variances = np.trace(self.covariance_um2[use], axis1=1, axis2=2)
        weight = 1.0 / np.sqrt(variances)[:, None]
        lag = self.lag_um[use] * weight
        from_middle = centres - centres.mean(axis=0)
        # A constant and a slope with either place, for both lags.
        terms = np.column_stack([np.ones(len(centres)), from_middle])
        design = weight * terms
        if np.linalg.matrix_rank(design) < 3:
            return None
        coefficients = np.linalg.lstsq(design, lag, rcond=None)[0]
        residuals = lag - design @ coefficients
        variance = np.square(residuals).sum(axis=0) / (len(centres) - 3)
        spread = np.linalg.inv(design.T @ design).diagonal()[1:]
        errors = np.sqrt(4.0 * np.outer(variance, spread))
        return coefficients[0], coefficients[1:].T, errors


def _place_of(
    peak: Peak | None, a: Floats, b: Floats, a_valid: Bools, b_valid: Bools
) -> tuple[Floats, Floats]:
    """Lag and its covariance in pixels, along x and y; NaN where there is no summit."""
    if peak is None or not peak.inner:
        return np.full(2, np.nan), np.full((2, 2), np.nan)
    covariance = covariance_of(peak, a, b, a_valid, b_valid)
    covariance += lost_between_pixels(peak)
    # From rows and columns to x and y.
    return np.flip(peak.summit_px), np.flip(covariance)


def _z(r: ArrayLike, share: ArrayLike) -> Any:
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

    The maps (rows, cols) are without trend, 0 where not valid; ``reach`` is in pixels along rows
    and columns. A lag is the place in b less that in a. The null are the peaks of the unrelated
    maps, of b's texture, in all tiles, each put to the tile's size. Tiles no larger than twice the
    reach, or larger than the map, are refused.
    """
    rows, cols = side_px = [round(tile_um / p) for p in pixel_um]
    wide_rows, wide_cols = wide = (reach[0] + MARGIN, reach[1] + MARGIN)
    is_small = np.less_equal(side_px, np.multiply(2, wide)).any()
    if is_small or np.greater(side_px, a.shape).any():
        least_um = 2 * np.multiply(wide, pixel_um).max()
        raise SizeError(
            f"Tiles of {tile_um:g} um are too small for the reach, or larger than the map. Take"
            f" sides above {least_um:.3g} um, or a shorter reach."
        )
    allowed = within(reach)
    pixel_xy_um = np.flip(pixel_um)
    tiles: list[tuple[Floats, Floats, Floats, float, float]] = []
    null_z: list[float] = []
    step_rows, step_cols = (max(side // (1 + overlapping), 1) for side in side_px)
    first_rows = range(0, a.shape[0] - rows + 1, step_rows)
    first_cols = range(0, a.shape[1] - cols + 1, step_cols)
    for row, col in product(first_rows, first_cols):
        tile = np.s_[row : row + rows, col : col + cols]
        share = is_valid[tile].mean()
        if share < 0.5:
            continue
        # The tile of a, and b around it as far as the search goes: every lag keeps its pairs.
        first_row = max(row - wide_rows, 0)
        first_col = max(col - wide_cols, 0)
        around = np.s_[first_row : row + rows + wide_rows, first_col : col + cols + wide_cols]
        is_in_tile = np.zeros_like(is_valid)
        is_in_tile[tile] = is_valid[tile]
        a_valid, b_valid = is_in_tile[around], is_valid[around]
        correlate = MaskedNcc(a[around], a_valid=a_valid, b_valid=b_valid, reach=wide)
        peak = find_peak(correlate(b[around]), allowed)
        for values in unrelated:
            null_r = correlate(values[around])[allowed]
            null_z.append(_z(np.nanmax(null_r, initial=0.0), share))
        centre_px = np.array([col + (cols - 1) / 2, row + (rows - 1) / 2])
        lag_px, covariance_px2 = _place_of(peak, a[around], b[around], a_valid, b_valid)
        covariance_um2 = covariance_px2 * np.outer(pixel_xy_um, pixel_xy_um)
        r = np.nan if peak is None else peak.r
        tiles.append((centre_px * pixel_xy_um, lag_px * pixel_xy_um, covariance_um2, r, share))
    table = np.array(tiles, dtype=_TILE)
    limit = np.quantile(null_z, 0.99, method="higher") if null_z else np.inf
    height = _z(np.abs(table["r"]), table["share"])
    distinct = np.isfinite(table["lag"][:, 0]) & (height > limit)
    table["lag"][~distinct] = np.nan
    table["covariance"][~distinct] = np.nan
    return LagField(
        at_um=table["centre"],
        lag_um=table["lag"],
        covariance_um2=table["covariance"],
        r=table["r"],
        distinct=distinct,
        tile_um=tile_um,
    )
