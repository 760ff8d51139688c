"""Quantiles, tails and ranks as ``scipy.stats`` has them.

The import of ``scipy.stats`` takes as long as all r of a small run.
"""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, special

from planish.core.typing import Floats, Pair, pair_of

_MOST_R = 1.0 - 1e-15  # of which Fisher's z is a number


def around(middle: float, half_width: float) -> Pair:
    """Both ends of an interval."""
    return middle - half_width, middle + half_width


def sign_of(interval: Pair) -> int:
    """1 or -1 where an interval excludes 0, else 0."""
    low, high = interval
    return int(low > 0) - int(high < 0)


def is_distinguishable(interval: Pair) -> bool | None:
    """Whether an interval excludes 0; None where there is none."""
    if math.isnan(interval[0]):
        return None
    return sign_of(interval) != 0


def fisher_z(r: ArrayLike) -> Floats:
    """Fisher's z of correlations; of 1 and -1 that of the nearest ones with a z."""
    return np.arctanh(np.clip(r, -_MOST_R, _MOST_R))


def widened(r: float, interval: Pair, ratios: float | Floats) -> Pair:
    """The interval of r with ends so many times as far from r in Fisher's z."""
    z = fisher_z(r)
    return pair_of(np.tanh(z + ratios * (fisher_z(interval) - z)))


def variance_interval(variance: float, degrees: float) -> Pair:
    """95 % interval of a variance that is known with so many degrees of freedom."""
    if not variance > 0 or math.isinf(degrees):
        return variance, variance
    quantiles = 2.0 * special.gammaincinv(degrees / 2, [0.975, 0.025])
    return pair_of(variance * degrees / quantiles)


def normal_tail(value: float) -> float:
    """The share of the standard normal distribution above a value."""
    return float(special.ndtr(-value))


def t_95(df: float) -> float:
    """Standard errors that hold 95 % of Student's distribution with ``df`` degrees of freedom."""
    return float(special.stdtrit(df, 0.975))


def student_tail(value: float, df: float) -> float:
    """The share of Student's distribution with ``df`` degrees of freedom above a value."""
    return float(special.stdtr(df, -value))


def p_of(errors: float, df: float) -> float:
    """Probability of so many standard errors or more, to either side, by Student's distribution."""
    return 2 * student_tail(abs(errors), df)


def largest_tail(maxima: Floats, value: float) -> float:
    """The share of further maxima above a value, by Gumbel's distribution.

    The distribution is fitted to ``maxima`` (n,) by maximum likelihood: its scale is the root of an
    equation, looked for from a hundredth to a hundred times their standard deviation, and its
    location follows. Where all maxima are the same, the share is 0 or 1.
    """
    excesses = maxima - maxima.min()

    def excess(scale: float) -> float:
        """Scale less the one that this one implies: 0 at maximum likelihood."""
        weight = np.exp(-excesses / scale)
        weighted_mean = (excesses * weight).sum() / weight.sum()
        return scale - float(excesses.mean() - weighted_mean)

    spread = float(excesses.std())
    if spread == 0:
        return float(value <= maxima[0])
    scale = float(optimize.brentq(excess, spread / 100, spread * 100))
    mean_weight = float(np.exp(-excesses / scale).mean())
    location = float(maxima.min()) - scale * math.log(mean_weight)
    return -math.expm1(-math.exp((location - value) / scale))


def ranks(values: Floats) -> Floats:
    """Ranks from 1 on of an array without missing values, flat.

    Equal values have their mean rank.
    """
    _, which, count = np.unique(values.ravel(), return_inverse=True, return_counts=True)
    last = np.cumsum(count)
    return (last - (count - 1) / 2)[which]
