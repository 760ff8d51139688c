"""How much of a map is no noise, from two measurements of it, and what that means for r and for a slope."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from planish.analyze.chance import student_quantile
from planish.analyze.correlation import LEAST_CLAIMED, correlate
from planish.core.errors import CannotMeasure, InputError
from planish.core.facts import NULL, Facts, Interval, Value

_CHANCE = 0.95
_LEAST = 3


class Reliability(Facts):
    """Share of the variance of a map that a second measurement would show again, at one size of points."""

    point_um: float = Field(description="Edge of a point.")
    n: int | None = Field(default=None, description="Points that are known in both halves.")
    halves_r: Value = Field(default=NULL, description="Correlation of both halves.")
    value: Value = Field(
        default=NULL, description="Share of the variance of the map that both halves show: an upper bound."
    )
    interval: Interval = Field(default=NULL, description="In which it lies with 95 %.")
    n_eff: Value = Field(default=NULL, description="Independent points.")
    shared_errors: SkipJsonSchema[bool] = Field(
        default=True, exclude=True, description="Whether both measurements may share errors."
    )

    @property
    def sentence(self) -> str:
        """What may be said."""
        low, high = self.interval
        known = "no interval" if math.isnan(low) else f"95 %: {low:.2f} to {high:.2f}"
        bound = "; an upper bound, as both measurements share errors" if self.shared_errors else ""
        return f"The reliability is {self.value:.2f} at points of {self.point_um:g} um ({known}){bound}."


def split_reliability(
    first: NDArray[Any], second: NDArray[Any], *, mask: NDArray[np.bool_] | None = None,
    pixel_um: float | tuple[float, float], point_um: float | None = None, shared_errors: bool = True,
) -> Reliability:  # fmt: skip
    """Tell the reliability of a map from two halves of its measurement.

    Parameters
    ----------
    first, second : ndarray, shape (rows, cols)
        The map of the odd and of the even slices, or of two half scans, on one grid; NaN is missing.
    mask, pixel_um, point_um
        As of :func:`planish.correlate`.
    shared_errors : bool
        Whether both may share errors, as neighbouring slices of one scan do: the reliability is an upper bound then.
        False for two scans between which the sheet was taken out and put back.

    Returns
    -------
    Reliability

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If fewer than 3 points are valid in both, or one is constant.

    References
    ----------
    Spearman (1910), Brit. J. Psychol. 3, 271, doi:10.1111/j.2044-8295.1910.tb00206.x.
    Brown (1910), Brit. J. Psychol. 3, 296, doi:10.1111/j.2044-8295.1910.tb00207.x.
    """
    found = correlate(first, second, mask=mask, pixel_um=pixel_um, point_um=point_um)
    if math.isnan(found.r):
        raise CannotMeasure(f"The halves have no correlation. {' '.join(found.warnings)} Give two maps that vary.")
    low, high = (_of_both(v) for v in found.interval)
    return Reliability(
        point_um=found.support_um, n=found.n, halves_r=found.r, value=_of_both(found.r), interval=(low, high),
        n_eff=found.n_eff, shared_errors=shared_errors,
    )  # fmt: skip


def _of_both(r: float) -> float:
    """Reliability of the mean of two measurements that correlate with r; a share of variance is not below 0."""
    return r if math.isnan(r) else 2 * r / (1 + r) if r > 0 else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Deming:
    """Line through two measured quantities that both have errors: ``y = slope x + intercept``.

    Attributes
    ----------
    slope, intercept : float
    interval : (float, float)
        In which the slope lies with 95 %; (NaN, NaN) where n_eff is below 10 or any direction fits.
    error_ratio : float
        Variance of the errors of y over that of x, as given.
    """

    slope: float
    intercept: float
    interval: tuple[float, float]
    error_ratio: float


def deming(x: NDArray[Any], y: NDArray[Any], *, error_ratio: float | None, n_eff: float | None) -> Deming:
    """Fit a line where both quantities have errors.

    Parameters
    ----------
    x, y : ndarray, any one shape
        NaN is missing.
    error_ratio : float
        Variance of the errors of y over that of x, in the units of both. It cannot be told from x and y.
    n_eff : float
        Independent points, as :func:`planish.analyze.independent_points` counts them; the number of all where they are
        independent.

    Raises
    ------
    InputError
        If the ratio or n_eff is missing or not above 0, or x and y are not of one shape.
    CannotMeasure
        If fewer than 3 points are known, or x and y do not vary together: any slope fits.

    Notes
    -----
    In units in which both errors are alike, this is the main axis of the cloud. The interval of its direction is
    Creasy's (1956), with n_eff in place of n; the errors then count as independent where n_eff says so.

    References
    ----------
    Deming (1943), Statistical Adjustment of Data, Wiley, New York.
    Creasy (1956), J. R. Statist. Soc. B 18, 65.
    """
    if error_ratio is None or not 0 < error_ratio < math.inf:
        raise InputError(
            f"The ratio of the error variances, y over x, is {error_ratio}. Give a number above 0, from repeated "
            "measurements of both: without it there is no slope between two quantities with errors."
        )
    if n_eff is None or not 0 < n_eff < math.inf:
        raise InputError(
            f"n_eff is {n_eff}. Give the number of independent points (planish.analyze.independent_points)."
        )
    if np.shape(x) != np.shape(y):
        raise InputError(f"x has the shape {np.shape(x)}, y {np.shape(y)}. Bring both onto one grid first.")
    known = np.isfinite(x) & np.isfinite(y)
    n = int(np.count_nonzero(known))
    if n < _LEAST:
        raise CannotMeasure(f"{n} points are known in x and y. Give {_LEAST} or more.")
    scale = math.sqrt(error_ratio)
    a, b = np.asarray(x)[known].astype(np.float64), np.asarray(y)[known].astype(np.float64) / scale
    xx, xy, yy = float(np.var(a)), float(np.mean((a - a.mean()) * (b - b.mean()))), float(np.var(b))
    apart = math.hypot(yy - xx, 2 * xy)
    if xy == 0 or not min(xx, yy) > 0 or apart < 1e-12 * (xx + yy):
        raise CannotMeasure("x and y do not vary together: any slope fits. Look at the maps.")
    turn = math.atan2(2 * xy, xx - yy) / 2
    slope = math.tan(turn) * scale
    return Deming(
        slope=slope, intercept=float(b.mean()) * scale - slope * float(a.mean()), error_ratio=error_ratio,
        interval=_directions(turn, xx * yy - xy * xy, apart, min(n_eff, n), scale),
    )  # fmt: skip


def _directions(turn: float, area: float, apart: float, n_eff: float, scale: float) -> tuple[float, float]:
    if n_eff < LEAST_CLAIMED:
        return math.nan, math.nan
    quantile = student_quantile((1 + _CHANCE) / 2, n_eff - 2)
    sine = 2 * quantile * math.sqrt(max(area, 0.0) / (n_eff - 2)) / apart
    width = math.asin(sine) / 2 if sine < 1 else math.inf
    low, high = turn - width, turn + width
    # Beyond upright, the interval would go through infinity.
    if not -math.pi / 2 < low <= high < math.pi / 2:
        return math.nan, math.nan
    return math.tan(low) * scale, math.tan(high) * scale
