"""Two instruments on one field: what one shows less the other, where they agree, and down to which waves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.analyze.agreement import Agreement, bland_altman
from planish.analyze.correlation import Correlation, correlate, on_one_grid
from planish.analyze.independent import independent_points
from planish.analyze.reliability import Deming, deming
from planish.analyze.rings import RingCorrelation, ring_correlation
from planish.core.area import area_mean
from planish.core.errors import CannotMeasure


@dataclass(frozen=True, slots=True, kw_only=True)
class Instruments:
    """Measurements a and b of one quantity on one field.

    Attributes
    ----------
    point_um : float
        Edge of the points that bias, limits and lines are of.
    agreement : Agreement
        Bias, limits of agreement and both lines of least squares, with intervals; b less a.
    correlation : Correlation
        Of both, over the same points.
    rings : RingCorrelation or None
        Of waves, at the pixel; None where ``notes`` says why.
    shared_um : float or None
        Both show the same in waves of this length and longer; None where the rings do not tell (``rings.sentence``).
    line : Deming or None
        Between two measurements that both have errors; None without ``error_ratio``, or where ``notes`` says why.
    difference : ndarray, shape (rows, cols)
        b less a at every pixel, NaN where one is missing.
    notes : tuple of str
        What could not be told, and why.
    """

    point_um: float
    agreement: Agreement
    correlation: Correlation
    rings: RingCorrelation | None
    shared_um: float | None
    line: Deming | None
    difference: NDArray[np.float64]
    notes: tuple[str, ...] = ()


def compare_instruments(
    a: NDArray[Any], b: NDArray[Any], *, mask: NDArray[np.bool_] | None = None, pixel_um: float | tuple[float, float],
    point_um: float | None = None, error_ratio: float | None = None,
) -> Instruments:  # fmt: skip
    """Compare what two instruments measured of one quantity.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
        In one unit, on one grid; NaN is missing.
    mask : ndarray of bool, shape (rows, cols), optional
        Pixels that count.
    pixel_um : float or (float, float)
        Along y and x.
    point_um : float, optional
        Bias, limits and lines are of means over squares of this edge; of single pixels where not given. Means over
        larger points agree better.
    error_ratio : float, optional
        Variance of the errors of b over that of a, from repeated measurements of both; gives ``line``.

    Returns
    -------
    Instruments

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If fewer than 3 points are valid in both.

    See Also
    --------
    planish.analyze.bland_altman, planish.analyze.ring_correlation, planish.analyze.deming
    """
    pixel = on_one_grid(a, b, mask, pixel_um)
    known = np.isfinite(a) & np.isfinite(b)
    if mask is not None:
        known &= mask
    x, y = (np.where(known, m, np.nan).astype(np.float64) for m in (a, b))
    difference = y - x
    correlation = correlate(x, y, pixel_um=pixel, point_um=point_um)
    points, size = (x, y), pixel
    if point_um is not None:
        factor = (point_um / pixel[0], point_um / pixel[1])
        points, size = (area_mean(x, factor), area_mean(y, factor)), (point_um, point_um)
    agreement = bland_altman(*points, pixel_um=size)
    notes: list[str] = []
    rings: RingCorrelation | None = None
    try:
        rings = ring_correlation(x, y, pixel_um=pixel)
    except CannotMeasure as error:
        notes.append(error.text)
    line: Deming | None = None
    if error_ratio is not None:
        try:
            n_eff = independent_points(*points, pixel_um=size).n_eff
            if math.isnan(n_eff):
                notes.append("How many points of the line are independent cannot be told.")
            else:
                line = deming(*points, error_ratio=error_ratio, n_eff=n_eff)
        except CannotMeasure as error:
            notes.append(error.text)
    return Instruments(
        point_um=correlation.support_um, agreement=agreement, correlation=correlation, rings=rings,
        shared_um=rings.resolution_um if rings else None, line=line, difference=difference, notes=tuple(notes),
    )  # fmt: skip
