"""Uncovered and thin coating: the share of the area below a thickness, as a curve."""

from __future__ import annotations

import numpy as np
import xarray as xr

from planish.core.errors import CannotMeasure
from planish.measure.rays import Array

MARKED_UM = (0.0, 2.0, 5.0)  # uncovered, all but, and the outline of Fig. 6 in Hirn et al. (2009)


def thin_fraction(
    thickness: xr.DataArray, *, se: xr.DataArray | Array | None = None, marked_um: tuple[float, ...] = MARKED_UM,
    step_um: float = 0.25,
) -> xr.Dataset:  # fmt: skip
    """Share F(x) of the area whose coating is thinner than x (P-03).

    Parameters
    ----------
    thickness : DataArray, in um
        NaN is left out. ``support_um`` in its attributes is passed on.
    se : array like it
        Standard error of each value, um.
    marked_um : tuple of float
        Thicknesses for which the share is told apart; at 0 it is the share of no coating at all.
    step_um : float
        Of the curve.

    Returns
    -------
    Dataset
        ``share`` along ``thickness`` (um), and for every marked thickness ``marked_share`` along ``marked``,
        ``marked_se`` (sampling of n values that were independent, sqrt(F (1 - F) / n): a lower bound, because
        neighbours are alike) and ``biased``: 1 where x lies below twice the median SE of the values around it, so that
        noise alone puts ever more values below it. ``n`` and ``support_um`` in the attributes, and ``warning`` where
        a marked share is biased: F depends on support and noise and must not be compared without them.

    Raises
    ------
    CannotMeasure
        If no value is known.
    """
    known = np.isfinite(thickness.values)
    values = np.sort(thickness.values[known].astype(np.float64))
    if values.size == 0:
        raise CannotMeasure("There is no coating thickness to count: all values are missing. Look at 'status'.")
    x = np.arange(0.0, float(values[-1]) + step_um, step_um)
    marks = np.array(marked_um, dtype=np.float64)
    # At 0 the values that are 0 count: nothing is thinner than no coating.
    shares = np.where(
        marks > 0, np.searchsorted(values, marks, side="left"), np.searchsorted(values, marks, side="right")
    ) / values.size  # fmt: skip
    errors = np.zeros(marks.size)
    if se is not None:
        every = np.asarray(se)[known].astype(np.float64)
        at = thickness.values[known]
        for k, mark in enumerate(marks):
            near = every[np.abs(at - mark) <= max(2.0, 0.5 * mark)]
            near = near[np.isfinite(near)]
            errors[k] = float(np.median(near)) if near.size else 0.0
    biased = (marks < 2 * errors).astype(np.uint8)
    attrs: dict[str, object] = {"n": int(values.size), "mean_um": float(values.mean())}
    if "support_um" in thickness.attrs:
        attrs["support_um"] = float(thickness.attrs["support_um"])
    if biased.any():
        listed = ", ".join(f"{m:g}" for m in marks[biased > 0])
        attrs["warning"] = (
            f"The standard error of one value is {errors[biased > 0].max():.2g} um: the shares below {listed} um are "
            "too large by what noise puts there. Average the map first, or compare larger thicknesses."
        )
    counts = np.searchsorted(values, x, side="left") / values.size
    data = {
        "share": ("thickness", counts, {"units": "1", "long_name": "Share of the area with a thinner coating"}),
        "marked_share": ("marked", shares, {"units": "1", "long_name": "Share of the area with a thinner coating"}),
        "marked_se": ("marked", np.sqrt(shares * (1 - shares) / values.size), {"units": "1"}),
        "value_se": ("marked", errors, {"units": "um", "long_name": "Standard error of one value"}),
        "biased": ("marked", biased, {"long_name": "Thickness below two standard errors of one value"}),
    }
    um = {"units": "um"}
    return xr.Dataset(data, coords={"thickness": ("thickness", x, um), "marked": ("marked", marks, um)}, attrs=attrs)
