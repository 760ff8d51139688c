"""Mean, root mean square and percentiles of errors, and None where there is nothing to take them of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Values = dict[str, float | None]


def rms(errors: Array) -> float | None:
    """Root mean square of what is finite."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def percentile(errors: Array, percent: float) -> float | None:
    """Percentile of the absolute value of what is finite."""
    known = np.abs(errors[np.isfinite(errors)])
    return float(np.percentile(known, percent)) if known.size else None


def three(stem: str, errors: Array) -> Values:
    """``stem_bias``, ``stem_rmse`` and ``stem_p95`` of what is finite."""
    known = errors[np.isfinite(errors)]
    bias = float(known.mean()) if known.size else None
    return {f"{stem}_bias": bias, f"{stem}_rmse": rms(errors), f"{stem}_p95": percentile(errors, 95)}
