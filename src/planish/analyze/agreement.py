"""Whether two measurements of one quantity give the same value: bias, scatter and limits of agreement."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planish.analyze.chance import student_quantile
from planish.analyze.correlation import LEAST_CLAIMED, PairSums, on_one_grid
from planish.analyze.covariance import Lags, PairCovariances, covariance_of
from planish.core.errors import CannotMeasure
from planish.core.facts import NULL, Facts, Interval, Unsaved, Value

_CHANCE = 0.95
_LEAST = 3
_LIMIT = 1.96  # standard deviations, as Bland and Altman write it
# How well the variance of a mean is known from one map, as degrees of freedom: it scatters by two thirds of itself
# however large the field (8 to 30 lengths across; measured), as lags are summed to a zero that scatters.
_MOST_FREE, _POINTS_A_FREE = 9.0, 6.0
_UNKNOWN = (math.nan, math.nan)


class Agreement(Facts):
    """Two measurements a and b of one quantity, pixel by pixel; differences are b less a.

    The line of a perfect relation lies between ``slope`` (b on a) and that of a on b.
    """

    n: int | None = Field(default=None, description="Points of which bias and scatter are.")
    bias: Value = Field(default=NULL, description="Mean of b - a at the larger points.")
    bias_interval: Interval = Field(default=NULL, description="In which it lies with 95 %.")
    sd: Value = Field(default=NULL, description="Standard deviation of b - a.")
    sd_interval: Interval = Field(
        default=NULL, description="In which the standard deviation of the difference lies with 95 %."
    )
    limits: Interval = Field(default=NULL, description="Between them lie 95 % of normal differences.")
    limit_intervals: tuple[Interval, Interval] = Field(
        default=(NULL, NULL), description="In which the lower and the upper limit lie with 95 %."
    )
    n_eff: Unsaved = Field(default=NULL, exclude=True, description="Independent points of the mean difference.")
    n_eff_sd: Unsaved = Field(default=NULL, exclude=True, description="Independent points of its standard deviation.")
    slope: Unsaved = Field(default=NULL, exclude=True, description="Least squares of b on a.")
    slope_x_on_y: Unsaved = Field(default=NULL, exclude=True, description="Least squares of a on b: a per b.")


def bland_altman(
    a: NDArray[Any], b: NDArray[Any], *, mask: NDArray[np.bool_] | None = None, pixel_um: float | tuple[float, float]
) -> Agreement:
    """Compare two measurements of one quantity.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
        In one unit, on one grid; NaN is missing.
    mask : ndarray of bool, shape (rows, cols), optional
    pixel_um : float or (float, float)
        Along y and x.

    Returns
    -------
    Agreement

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If fewer than 3 pixels are valid in both.

    Notes
    -----
    The variance of the mean is the sum of the covariances of the difference map over all pairs of pixels; that of the
    variance, for Gaussian differences, the sum of their squares (as of :func:`planish.correlate`). Bias and scatter of
    Gaussian differences are independent of each other. A limit holds for single pixels of this size: means over
    larger points agree better. Bias, standard deviation and limits are those of a textbook; on a small field the
    standard deviation comes out too small, by a share of 1 / (2 n_eff), which the intervals about it put back. Their
    quantile is of Student's t with 9 degrees of freedom at most, as the variances are told from the same map
    (docs/series.md has how often they hold).

    References
    ----------
    Bland and Altman (1986), Lancet 327, 307, doi:10.1016/S0140-6736(86)90837-8.
    """
    pixel = on_one_grid(a, b, mask, pixel_um)
    known = np.isfinite(a) & np.isfinite(b)
    if mask is not None:
        known &= mask
    n = int(np.count_nonzero(known))
    if n < _LEAST:
        raise CannotMeasure(f"{n} pixels are valid in both maps, {_LEAST} are needed. Look at the masks.")
    x, y = (np.where(known, m, 0.0).astype(np.float64) for m in (a, b))
    sums = PairSums()
    sums.add(x[known], y[known])
    slope, _, other = sums.lines
    off = y - x
    bias = float(off[known].mean())
    if float(np.ptp(off[known])) <= 1e-12 * max(float(np.abs(x[known]).max()), float(np.abs(y[known]).max())):
        same = (bias, bias)
        return Agreement(
            n=n, bias=bias, sd=0.0, limits=same, bias_interval=same, sd_interval=(0.0, 0.0), n_eff=float(n),
            n_eff_sd=float(n), limit_intervals=(same, same), slope=slope, slope_x_on_y=other,
        )  # fmt: skip
    lags = Lags(known, pixel)
    covariance, of_mean = covariance_of(off, lags)
    square = float(covariance[0, 0])  # with what the removal of the mean took put back
    sd = sums.difference[1]
    n_eff = min(square / of_mean, float(n)) if of_mean > 0 else math.nan
    # Of maps with these covariances; the number for the mean is smaller, as long waves weigh more in it.
    ratio = PairCovariances(off, off, lags).variance_of_r()
    n_eff_sd = min(1 + 1 / ratio, float(n)) if ratio > 0 else math.nan
    limits = (bias - _LIMIT * sd, bias + _LIMIT * sd)
    of_bias = of_sd = of_low = of_high = _UNKNOWN
    if min(n_eff, n_eff_sd) >= LEAST_CLAIMED:
        free = min(n_eff / _POINTS_A_FREE, _MOST_FREE)
        quantile = student_quantile((1 + _CHANCE) / 2, free)
        spread = quantile * math.sqrt(square / n_eff)
        of_bias = (bias - spread, bias + spread)
        # sd of Gaussian values scatters by sd / sqrt(2 df).
        share = quantile / math.sqrt(2 * (n_eff_sd - 1))
        whole = math.sqrt(square)
        of_sd = (whole * math.exp(-share), whole * math.exp(share))
        wide = quantile * math.sqrt(square / n_eff + square * _LIMIT**2 / (2 * (n_eff_sd - 1)))
        of_low, of_high = ((bias + s * _LIMIT * whole - wide, bias + s * _LIMIT * whole + wide) for s in (-1, 1))
    return Agreement(
        n=n, bias=bias, sd=sd, limits=limits, bias_interval=of_bias, sd_interval=of_sd, n_eff=n_eff, n_eff_sd=n_eff_sd,
        limit_intervals=(of_low, of_high), slope=slope, slope_x_on_y=other,
    )  # fmt: skip
