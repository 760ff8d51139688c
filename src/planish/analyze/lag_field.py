"""Lags of tiles: where the registration of two maps is off, and whether one is stretched against the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.analyze.ncc import MaskedNcc
from planish.analyze.peak import MARGIN, covariance_of, find_peak, within
from planish.core.errors import SizeError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LEAST_SHARE = 0.5  # of a tile that has to be known
_LEVEL = 0.99  # of the null: a field has many tiles


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapPair:
    """Two maps (rows, cols) on one grid, where either is known, and the pixel (y, x) in um; 0 where they are not."""

    a: Array
    b: Array
    known_a: Mask
    known_b: Mask
    pixel_um: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LagField:
    """Lags of tiles, one row each; tiles of which less than half is known are left out.

    Attributes
    ----------
    at_um : ndarray, shape (n, 2)
        Middle of the tiles, ``(x, y)`` from the middle of the first pixel.
    lag_um : ndarray, shape (n, 2)
        ``(x, y)``; NaN where the peak is not distinct.
    covariance_um2 : ndarray, shape (n, 2, 2)
    r : ndarray, shape (n,)
        Correlation at the peak of each tile, a searched one.
    distinct : ndarray of bool, shape (n,)
        Whether the peak is a summit above what 99 % of tiles of unrelated maps reach.
    tile_um : float
        Side of a tile.
    """

    at_um: Array
    lag_um: Array
    covariance_um2: Array
    r: Array
    distinct: Mask
    tile_um: float

    def linear(self) -> tuple[Array, Array, Array] | None:
        """Lag at the middle of the map and its change with place, and the standard errors of the latter.

        Returns
        -------
        tuple of ndarray or None
            Lag at the mean place of the distinct tiles ``(2,)`` in um; derivatives ``(2, 2)``, a row for the lag
            along x and y, a column for the place: 0.001 is a stretch by 0.1 %; their standard errors ``(2, 2)``, from
            the scatter of the tiles about the plane. None with fewer than 6 distinct tiles or all in one line.

        Notes
        -----
        Neighbouring tiles share half of their pixels, so the standard errors count a quarter of the tiles.
        """
        use = self.distinct
        if int(use.sum()) < 6:
            return None
        at, lag = self.at_um[use], self.lag_um[use]
        weight = 1.0 / np.sqrt(np.trace(self.covariance_um2[use], axis1=1, axis2=2))
        design = np.concatenate([np.ones((len(at), 1)), at - at.mean(axis=0)], axis=1) * weight[:, None]
        if np.linalg.matrix_rank(design) < 3:
            return None
        found, *_ = np.linalg.lstsq(design, lag * weight[:, None], rcond=None)
        left = lag * weight[:, None] - design @ found
        variance = (left**2).sum(axis=0) / (len(at) - 3)
        spread = np.diag(np.linalg.inv(design.T @ design))[1:]
        return found[0], found[1:].T, np.sqrt(4.0 * np.outer(variance, spread))


def lag_field(
    maps: MapPair, *, reach: tuple[int, int], tile_um: float, sign: int, unrelated: list[Array]
) -> LagField:  # fmt: skip
    """Find the lag of every tile of a within b; tiles overlap by half, the maps are without trend.

    ``sign`` is that of the correlation looked for; 0 takes either. The peaks of the unrelated maps, of the texture of
    b, in all tiles together are the null, each put to the tile's size. Tiles that are no larger than twice the reach,
    or larger than the map, are refused.
    """
    a, b, a_valid, b_valid, pixel_um = maps.a, maps.b, maps.known_a, maps.known_b, maps.pixel_um
    side = [round(tile_um / p) for p in pixel_um]
    if any(s <= 2 * (k + MARGIN) for s, k in zip(side, reach, strict=True)) or side[0] > a.shape[0] or (
        side[1] > a.shape[1]
    ):  # fmt: skip
        least = 2 * max((k + MARGIN) * p for k, p in zip(reach, pixel_um, strict=True))
        raise SizeError(
            f"Tiles of {tile_um:g} um are too small for the reach, or larger than the map. Take sides above "
            f"{least:.0f} um, or a shorter reach."
        )
    wide = (reach[0] + MARGIN, reach[1] + MARGIN)
    allowed = within(reach)
    step = np.array([pixel_um[1], pixel_um[0]])
    starts = [np.arange(0, n - s + 1, max(s // 2, 1)) for n, s in zip(a.shape, side, strict=True)]
    found: list[tuple[Array, Array, Array, float, float]] = []
    null: list[float] = []
    for top in starts[0].tolist():
        for left in starts[1].tolist():
            # The tile of a, and b around it as far as the search goes: every lag keeps its pairs.
            rows = slice(max(top - wide[0], 0), top + side[0] + wide[0])
            cols = slice(max(left - wide[1], 0), left + side[1] + wide[1])
            inside = np.zeros(a.shape, dtype=bool)
            inside[top : top + side[0], left : left + side[1]] = True
            mask_a, mask_b = (a_valid & inside)[rows, cols], b_valid[rows, cols]
            share = float((mask_a & mask_b).sum()) / (side[0] * side[1])
            if share < _LEAST_SHARE:
                continue
            piece_a, piece_b = a[rows, cols], b[rows, cols]
            correlate = MaskedNcc(piece_a, a_valid=mask_a, b_valid=mask_b, reach=wide)
            peak = find_peak(correlate(piece_b), allowed, sign)
            for other in unrelated:
                r = correlate(other[rows, cols])[allowed]
                top_r = float(np.nanmax(np.abs(r) if sign == 0 else sign * r, initial=0.0))
                null.append(float(np.arctanh(min(top_r, 0.999999)) * np.sqrt(share)))
            spread, lag = np.full((2, 2), np.nan), np.full(2, np.nan)
            if peak is not None and peak.inner:
                lag = peak.at[::-1] * step
                spread = covariance_of(peak, piece_a, piece_b, mask_a, mask_b)[::-1, ::-1] * np.outer(step, step)
            middle = (np.array([left, top]) + (np.array([side[1], side[0]]) - 1) / 2) * step
            found.append((middle, lag, spread, np.nan if peak is None else peak.r, share))
    at, lags, spreads, r, shares = (
        np.array([row[k] for row in found]).reshape(len(found), *size)
        for k, size in enumerate(((2,), (2,), (2, 2), (), ()))
    )
    limit = float(np.quantile(null, _LEVEL, method="higher")) if null else np.inf
    height = np.arctanh(np.minimum(np.abs(r), 0.999999)) * np.sqrt(shares)
    distinct = np.isfinite(lags[:, 0]) & (height > limit)
    return LagField(
        at_um=at, lag_um=np.where(distinct[:, None], lags, np.nan), r=r, distinct=distinct, tile_um=tile_um,
        covariance_um2=np.where(distinct[:, None, None], spreads, np.nan),
    )  # fmt: skip
