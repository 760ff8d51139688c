"""Which axis of a volume runs through its sheet, as far as the grey tells."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.frame import AXES, Axis
from planish.core.lazy import LazyArray

_PLANES = 24  # of the slices, which are read whole
_PLACES = 200  # along either other axis
_CLEAR = 0.3  # of the variance along the first axis: what the second may have


def likely_through(values: NDArray[Any] | LazyArray | xr.Variable) -> Axis | None:
    """Name the axis along which the mean grey changes most; None where two do, as with a round field of view.

    A sheet fills some of the planes across its normal and none of the others; the planes along it are all alike.

    Parameters
    ----------
    values : array (z, y, x)
        Some slices of it are read.
    """
    numbers = np.unique(np.linspace(0, values.shape[0] - 1, _PLANES).astype(int))
    steps = [max(1, n // _PLACES) for n in values.shape[1:]]
    planes = [np.asarray(values[int(k)])[:: steps[0], :: steps[1]] for k in numbers]
    sample: NDArray[np.float64] = np.stack(planes).astype(np.float64)
    sample[~np.isfinite(sample)] = np.nanmean(sample[np.isfinite(sample)]) if np.isfinite(sample).any() else 0.0
    spread = [float(sample.mean(axis=tuple({0, 1, 2} - {k})).var()) for k in range(3)]
    order = np.argsort(spread)[::-1]
    if not spread[order[0]] > 0 or spread[order[1]] > _CLEAR * spread[order[0]]:
        return None
    return AXES[order[0]]


def other_axis(volume: xr.DataArray, through: str) -> str:
    """Name the axis that looks like the sheet's normal, where another one was given."""
    axis = likely_through(volume.variable)
    return "" if axis in (None, through) else f"The grey changes most along {axis}: try --through {axis}."
