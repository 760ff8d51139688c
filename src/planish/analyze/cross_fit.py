"""Correlation of maps whose registration was tuned on the maps themselves: what may be reported of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import ndimage

from planish.analyze.chance import largest_tail
from planish.analyze.correlation import correlate, pearson
from planish.analyze.differences import paired_difference
from planish.analyze.ncc import MaskedNcc
from planish.analyze.peak import find_peak, within
from planish.analyze.surrogates import Unrelated, correlation_length_um, without_plane
from planish.core.errors import CannotMeasure
from planish.core.facts import NULL, Facts, Interval, Value

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Tune = Callable[[Array, Mask], Array]
"""From map a and the pixels that may be looked at to map b on a's grid, placed so that it fits best there.

It must look at a at these pixels only; NaN is missing in what it returns.
"""

_SEED = 20090502
_LEAST_TILES = 4  # of either colour that are reported on
_LEAST_PIXELS = 100
_COUNTED = 199  # unrelated maps, from which on a chance is counted


class Registration(StrEnum):
    """How the maps of a correlation were registered; stands beside every r."""

    MARKS = "marks only"
    CROSS_FITTED = "refined (cross-fitted)"
    SEARCHED_NULL = "refined (searched null)"

    @property
    def sentence(self) -> str:
        """The words for a report."""
        return f"registration: {self.value}"


class RefinementR(Facts):
    """r after a refinement that it was not maximised by, or beside what the search reaches by chance."""

    r: Value = Field(description="Pearson's correlation.")
    interval: Interval = Field(default=NULL, description="In which r lies with 95 %.")
    n_eff: Value = Field(default=NULL, description="Independent points.")
    r_of_marks: Value = Field(default=NULL, description="By the marks alone, over the same pixels.")
    gain_interval: Interval = Field(default=NULL, description="In which r - r_of_marks lies with 95 %.")
    registration: str = Field(description="What r rests on: cross-fitted, or beside a searched null.")
    sentence: str = Field(description="The same in words.")
    n: int | None = Field(default=None, description="Pixels that are reported on.")
    tile_um: Value = Field(default=NULL, description="Side of the tiles of the checkerboard.")
    guard_um: Value = Field(default=NULL, description="Distance kept from the pixels that were tuned on.")
    null_95: Value = Field(default=NULL, description="|r| that the search reaches on 95 % of unrelated maps.")
    p: Value = Field(default=NULL, description="Share of unrelated maps that reach this r.")
    surrogates: int | None = Field(default=None, description="Unrelated maps that were searched.")


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossFitted:
    """Correlation of tiles that the registration was not tuned on.

    Attributes
    ----------
    r : float
        Both halves together: sums of products over both, each half about its own means.
    interval : (float, float)
        In which r lies with 95 %; (NaN, NaN) where nothing is claimed.
    n_eff : float
        Independent points.
    r_of_halves : (float, float)
        Of either colour of the checkerboard, registered on the other.
    r_of_marks : float
        By the marks alone, over the same pixels.
    gain_interval : (float, float)
        In which ``r - r_of_marks`` lies with 95 %.
    n : int
        Pixels that are reported on.
    share : float
        That number over all pixels known in both.
    tile_um, guard_um : float
        Side of the tiles; distance kept from the pixels that the registration was tuned on.
    length_um : float
        Correlation length of the coarser map.
    """

    r: float
    interval: tuple[float, float]
    n_eff: float
    r_of_halves: tuple[float, float]
    r_of_marks: float
    gain_interval: tuple[float, float]
    n: int
    share: float
    tile_um: float
    guard_um: float
    length_um: float
    registration: Registration = Registration.CROSS_FITTED

    @property
    def sentence(self) -> str:
        """The correlation, what the refinement changed, and how the maps were registered."""
        limits = "" if math.isnan(self.interval[0]) else f" (95 %: {self.interval[0]:.2f} to {self.interval[1]:.2f})"
        low, high = self.gain_interval
        change = "" if math.isnan(low) else (
            ", which is not distinguishable from it" if low <= 0 <= high
            else f", from which it differs by {low:.3f} to {high:.3f}"
        )  # fmt: skip
        marks = f"; the marks alone give {self.r_of_marks:.2f} there{change}"
        return f"r = {self.r:.2f}{limits}{marks}; {self.registration.sentence}"

    @property
    def saved(self) -> RefinementR:
        """What stands in the results of a run."""
        return RefinementR(
            r=self.r, interval=self.interval, n_eff=self.n_eff, r_of_marks=self.r_of_marks,
            gain_interval=self.gain_interval, registration=self.registration.value, sentence=self.sentence, n=self.n,
            tile_um=self.tile_um, guard_um=self.guard_um,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchedNull:
    """A correlation after a search, beside what the same search finds in unrelated maps.

    Attributes
    ----------
    r : float
        After the search: too large, and only to be read beside ``null_95``.
    null_95 : float
        ``|r|`` that the same search reaches on 95 of 100 unrelated maps.
    p : float
        Chance that it reaches ``|r|`` on an unrelated map: counted, r itself included, of 199 maps and more; of fewer,
        from a Gumbel distribution fitted to what it reaches on them, and never below half of one over their number
        squared.
    surrogates : int
        Number of unrelated maps.
    """

    r: float
    null_95: float
    p: float
    surrogates: int
    registration: Registration = Registration.SEARCHED_NULL

    @property
    def sentence(self) -> str:
        """The correlation, what unrelated maps reach, and how the maps were registered."""
        return (
            f"r = {self.r:.2f} after the search, which reaches {self.null_95:.2f} on unrelated maps (95 %; "
            f"p = {self.p:.2g}); {self.registration.sentence}"
        )

    @property
    def saved(self) -> RefinementR:
        """What stands in the results of a run."""
        return RefinementR(
            r=self.r, registration=self.registration.value, sentence=self.sentence, null_95=self.null_95, p=self.p,
            surrogates=self.surrogates,
        )  # fmt: skip


def cross_fitted(
    a: Array,
    b: Array,
    tune: Tune,
    *,
    valid: Mask | None = None,
    pixel_um: tuple[float, float],
    tile_um: float | None = None,
    guard_um: float | None = None,
) -> CrossFitted:
    """Tune the registration on every other tile, correlate on the rest, and vice versa.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
        Map a, and map b as the marks alone place it. NaN is missing.
    tune : callable
        ``tune(a, look)`` returns map b placed as it fits a best at the pixels ``look``.
    valid : ndarray of bool, shape (rows, cols), or None
        Pixels that may be looked at.
    pixel_um : (float, float)
        Along y and x.
    tile_um : float or None
        Side of the tiles; None takes 6 guards, or 4 where that gives too few tiles.
    guard_um : float or None
        What is reported keeps this distance from what was tuned on; None takes 2 correlation lengths.

    Returns
    -------
    CrossFitted

    Raises
    ------
    CannotMeasure
        If the guard is shorter than the correlation length of the coarser map (1/e), or fewer than 4 tiles of either
        colour are left to report on.
    """
    known = np.isfinite(a) & np.isfinite(b) & (True if valid is None else valid)
    length = max(correlation_length_um(without_plane(m, known), known, pixel_um) for m in (a, b))
    guard = 2 * length if guard_um is None else guard_um
    if not guard >= length or not math.isfinite(guard):
        raise CannotMeasure(
            f"The guard between tiles is {guard:.0f} um, but the maps are correlated over {length:.0f} um: tiles would "
            "not be independent. Take a guard of at least that length, or take the slow variations off the maps first."
        )
    sides = [6 * guard, 4 * guard] if tile_um is None else [tile_um]
    for side in sides:
        tile = _tile_numbers(a.shape, pixel_um, side)
        looks = [known & ((tile[0] + tile[1]) % 2 == k) for k in (0, 1)]
        reported = [
            looks[1 - k] & (ndimage.distance_transform_edt(~looks[k], sampling=pixel_um) > guard) for k in (0, 1)
        ]
        tiles = [np.unique(np.broadcast_to(tile[0] * a.shape[1] + tile[1], a.shape)[m]).size for m in reported]
        if min(tiles) >= _LEAST_TILES and min(map(np.sum, reported)) >= _LEAST_PIXELS:
            break
    else:
        raise CannotMeasure(
            f"Tiles of {sides[-1]:.0f} um with a guard of {guard:.0f} um leave fewer than {_LEAST_TILES} of either "
            "colour to report on: the map is too small for its texture. Report the marks-only correlation, or the "
            "refined one with a searched null."
        )
    first, refined, marked = (np.full(a.shape, np.nan) for _ in range(3))
    halves: list[float] = []
    for look, report in zip(looks, reported, strict=True):
        placed = tune(np.where(look, a, np.nan), look)
        use = report & np.isfinite(placed)
        for values, out in ((a, first), (placed, refined), (b, marked)):
            out[use] = values[use] - values[use].mean()
        halves.append(pearson(a[use], placed[use]))
    found = correlate(first, refined, pixel_um=pixel_um)
    gain = paired_difference((first, marked), (first, refined), pixel_um=pixel_um)
    return CrossFitted(
        r=found.r,
        interval=found.interval,
        n_eff=found.n_eff,
        r_of_halves=(halves[0], halves[1]),
        r_of_marks=gain.r[0],
        gain_interval=gain.interval,
        n=found.n,
        share=found.n / max(int(known.sum()), 1),
        tile_um=side,
        guard_um=guard,
        length_um=length,
    )


def searched_null(a: Array, tune: Tune, *, valid: Mask | None = None, surrogates: int = 99) -> SearchedNull:
    """Tune the registration on all of the map, and on maps with its texture that are related to nothing.

    Parameters
    ----------
    a : ndarray, shape (rows, cols)
        NaN is missing.
    tune : callable
        ``tune(a, look)`` returns map b placed as it fits a best at the pixels ``look``.
    valid : ndarray of bool, shape (rows, cols), or None
    surrogates : int
        Unrelated maps; 19 or more.

    Returns
    -------
    SearchedNull

    Raises
    ------
    CannotMeasure
        If fewer than 19 surrogates are asked for.
    """
    if surrogates < 19:
        raise CannotMeasure(f"{surrogates} unrelated maps give no 95 % band; 19 are needed, 99 are better.")
    known = np.isfinite(a) & (True if valid is None else valid)
    flat = without_plane(a, known)
    rng = np.random.default_rng(_SEED)

    def searched(given: Array) -> float:
        placed = tune(np.where(known, given, np.nan), known)
        return pearson(np.where(known, given, np.nan), placed)

    r = searched(flat)
    unrelated = Unrelated(flat, known)
    null = [abs(searched(unrelated.draw(rng))) for _ in range(surrogates)]
    counted = (1 + sum(v >= abs(r) for v in null)) / (1 + surrogates)
    return SearchedNull(
        r=r,
        null_95=float(np.quantile(null, 0.95, method="higher")),
        p=counted if surrogates >= _COUNTED else _by_tail(null, abs(r)),
        surrogates=surrogates,
    )


def _by_tail(null: list[float], r: float) -> float:
    """Chance of a larger maximum, from the distribution that maxima have."""
    found = largest_tail(np.arctanh(np.minimum(null, 1 - 1e-12)), math.atanh(min(r, 1 - 1e-12)))
    return max(found, 0.5 / len(null) ** 2)  # a tail is not known further than that from so few


def by_shift(b: Array, *, pixel_um: tuple[float, float], reach_um: float, sign: int = 0) -> Tune:
    """Tune by moving map b by whole pixels to the largest correlation.

    Parameters
    ----------
    b : ndarray, shape (rows, cols)
        NaN is missing.
    pixel_um : (float, float)
        Along y and x.
    reach_um : float
        Largest shift.
    sign : {-1, 0, 1}
        Sign of the correlation; 0 takes either.
    """
    reach = max(int(reach_um / pixel_um[0] + 1e-9), 1), max(int(reach_um / pixel_um[1] + 1e-9), 1)
    known = np.isfinite(b)
    values = np.where(known, b, 0.0)

    def tune(a: Array, look: Mask) -> Array:
        use = look & np.isfinite(a)
        r = MaskedNcc(np.where(use, a, 0.0), a_valid=use, b_valid=known, reach=reach)(values)
        peak = find_peak(r, within(reach, 0), sign)
        down, across = (0, 0) if peak is None else peak.pixel
        return ndimage.shift(b, (-down, -across), order=0, cval=np.nan)

    return tune


def _tile_numbers(
    shape: tuple[int, ...], pixel_um: tuple[float, float], side_um: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number of the tile of every row (rows, 1) and column (cols,); a rest at the border goes half to either side."""
    numbers: list[NDArray[np.int64]] = []
    for n, pixel in zip(shape, pixel_um, strict=True):
        first = 0.5 * (n * pixel - max(int(n * pixel / side_um), 1) * side_um)
        numbers.append(np.floor(((np.arange(n) + 0.5) * pixel - first) / side_um).astype(np.int64))
    return numbers[0][:, None], numbers[1]
