"""From maps on one grid to point-wise correlation, and to what the maps say of their registration."""

from planish.analyze.correlate import Correlation, correlate, correlate_at
from planish.analyze.cross_fit import (
    CrossFitted,
    Registration,
    SearchedNull,
    Tune,
    by_shift,
    cross_fitted,
    searched_null,
)
from planish.analyze.lag import Lag, masked_lag
from planish.analyze.lag_field import LagField
from planish.analyze.surrogates import in_band

__all__ = [
    "Correlation",
    "CrossFitted",
    "Lag",
    "LagField",
    "Registration",
    "SearchedNull",
    "Tune",
    "by_shift",
    "correlate",
    "correlate_at",
    "cross_fitted",
    "in_band",
    "masked_lag",
    "searched_null",
]
