"""Which pairs of marks stand out from the others: for the person who set them, before any model is chosen."""

from __future__ import annotations

from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from planish.core.typing import Bools, Floats

Complexes = NDArray[np.complex128]

LEAST = 5
"""Of fewer marks none can be told from the others."""
_CHANCE = 0.01  # of right marks alone, in one set of a hundred one is named
_MOST_PAIRS = 1500  # of which a similarity is tried
_CLEAR = 4.0  # standard deviations of one coordinate


def find_outliers(moving: Floats, fixed: Floats, mirrored: bool, *, tolerance_um: float) -> Bools:
    """Pairs that the others do not expect, shape (n,).

    Parameters
    ----------
    moving, fixed : ndarray, shape (n, 2), in um
    mirrored : bool
        Whether the moving x axis runs in the opposite direction.
    tolerance_um : float
        Two marks farther apart do not match, however few there are to tell.

    Notes
    -----
    A least trimmed squares fit of a similarity: of those through two of the pairs, the one that the best two thirds of
    all marks follow most closely, improved by refits to these. So wrong marks that agree with each other do not hide,
    unless they are more than a third. Of the rest are named those that are off by more than the tolerance and four
    standard deviations, and those that lie farther off than chance puts one of so many that were chosen from.

    References
    ----------
    Rousseeuw and Van Driessen (2006), Data Min. Knowl. Discov. 12, 29, doi:10.1007/s10618-005-0024-4.
    """
    n = len(moving)
    is_outlier = np.zeros(n, dtype=np.bool_)
    if n < LEAST:
        return is_outlier
    z = (-moving[:, 0] if mirrored else moving[:, 0]) + 1j * moving[:, 1]
    w = fixed[:, 0] + 1j * fixed[:, 1]
    inliers = _best_inliers(z, w, n - n // 3)
    for _ in range(n):
        # How far each mark lies off a fit to the inliers, over its own error in units of theirs; their variance.
        off = np.abs(_residuals(z, w, inliers))
        away = np.abs(z - z[inliers].mean()) ** 2
        lever = 1 / inliers.size + away / max(float(np.sum(away[inliers])), 1e-300)
        spread = float(np.sum(off[inliers] ** 2)) / max(2 * inliers.size - 4, 1)
        off = off / np.sqrt(1 + lever)
        # The inliers were chosen for being close: the chance counts how many choices there were.
        limit = _CHANCE / comb(n, n - inliers.size) / max(n - inliers.size, 1)
        free = 2 * inliers.size - 4
        chance = stats.f.sf(off**2 / (2 * spread), 2, free) if spread > 0 else (off == 0).astype(np.float64)
        outside = np.setdiff1d(np.arange(n), inliers)
        if not outside.size:
            break
        nearest = outside[np.argmax(chance[outside])]
        if chance[nearest] < limit or off[nearest] > max(tolerance_um, _CLEAR * np.sqrt(spread)):
            is_outlier[outside] = True
            break
        inliers = np.append(inliers, nearest)
    return is_outlier


def _best_inliers(z: Complexes, w: Complexes, count: int) -> NDArray[np.intp]:
    """The marks that one similarity fits best."""
    if len(z) < 56:
        i, j = np.array(list(combinations(range(len(z)), 2))).T
    else:
        tries = np.tile(np.arange(len(z)), (_MOST_PAIRS, 1))
        i, j = np.random.default_rng(0).permuted(tries, axis=1)[:, :2].T
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = (w[j] - w[i]) / (z[j] - z[i])
    good = np.isfinite(turn)
    turn, i = turn[good], i[good]
    if not turn.size:
        return np.arange(len(z))
    off = np.abs(w - w[i][:, None] - turn[:, None] * (z - z[i][:, None])) ** 2
    best = np.argsort(np.sum(np.partition(off, count - 1, axis=1)[:, :count], axis=1), kind="stable")[:10]
    candidates: list[tuple[float, NDArray[np.intp]]] = []
    for k in best:
        inliers = np.argsort(off[k], kind="stable")[:count]
        for _ in range(5):
            inliers = np.argsort(np.abs(_residuals(z, w, inliers)), kind="stable")[:count]
        candidates.append((float(np.sum(np.abs(_residuals(z, w, inliers)[inliers]) ** 2)), np.sort(inliers)))
    return min(candidates, key=lambda candidate: candidate[0])[1]


def _residuals(z: Complexes, w: Complexes, inliers: NDArray[np.intp]) -> Complexes:
    """Give the residuals of all marks from the similarity that fits the inliers best."""
    source, target = z[inliers].mean(), w[inliers].mean()
    away = z[inliers] - source
    turn = np.sum(away.conj() * (w[inliers] - target)) / max(float(np.sum(np.abs(away) ** 2)), 1e-300)
    return w - (target + turn * (z - source))
