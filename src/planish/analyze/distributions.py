"""Quantiles, tails and ranks as ``scipy.stats`` has them.

The import of ``scipy.stats`` takes as long as all r of a small run.
"""

import math

import numpy as np
from scipy import optimize, special

from planish.core.typing import Floats


def normal_tail(value: float) -> float:
    """The share of the standard normal distribution above a value."""
    return float(special.ndtr(-value))


def t_95(df: float) -> float:
    """Standard errors that hold 95 % of Student's distribution with ``df`` degrees of freedom."""
    return float(special.stdtrit(df, 0.975))


def student_tail(value: float, df: float) -> float:
    """The share of Student's distribution with ``df`` degrees of freedom above a value."""
    return float(special.stdtr(df, -value))


def largest_tail(maxima: Floats, value: float) -> float:
    """The share of further maxima above a value, by Gumbel's distribution.

    The distribution is fitted by maximum likelihood.
    """
    excesses = maxima - maxima.min()

    def excess(scale: float) -> float:
        weight = np.exp(-excesses / scale)
        return scale - float(excesses.mean() - (excesses * weight).sum() / weight.sum())

    spread = float(excesses.std())
    if spread == 0:
        return float(value <= maxima[0])
    scale = float(optimize.brentq(excess, spread / 100, spread * 100))
    location = float(maxima.min()) - scale * math.log(float(np.exp(-excesses / scale).mean()))
    return -math.expm1(-math.exp((location - value) / scale))


def ranks(values: Floats) -> Floats:
    """Ranks from 1 on of an array without missing values, flat.

    Equal values have their mean rank.
    """
    _, which, count = np.unique(values.ravel(), return_inverse=True, return_counts=True)
    last = np.cumsum(count)
    return (last - (count - 1) / 2)[which]
