"""How many sheets and fields a study needs to see a difference of r²."""

import math
from functools import partial

import numpy as np
from pydantic import Field
from scipy import fft

from planish.analyze.between_sheets import check_power, power_of_shift, welch_free
from planish.analyze.correlation import LEAST_CLAIMED
from planish.analyze.sheets import LEAST_SHEETS
from planish.core.errors import InputError, SizeError
from planish.core.facts import ResultModel
from planish.core.typing import Floats, Pair, Pixel

_PARTS = 8  # of the edge of a point, over which its mean is taken
_MOST_POINTS = 2_000_000


class StudyDesign(ResultModel):
    """What a study of so many sheets and fields can see."""

    sheets: int = Field(description="Of each paper where two are compared.")
    fields: int = Field(description="Of each sheet.")
    n_eff: float = Field(description="Independent points of a field.")
    r2: Pair = Field(description="The two that are to be told apart.")
    paired: bool = Field(description="Whether both are of the same sheets.")
    standard_error: float = Field(description="Of the difference of r.")
    power: float = Field(description="How often such a study distinguishes them at 5 %.")


def power_of_study(
    r2: Pair,
    *,
    sheets: int,
    fields: int,
    n_eff: float,
    between_sheets: float,
    paired: bool,
    change_between_sheets: float = 0.0,
    shared: float = 0.0,
) -> StudyDesign:
    """Say how often a study will distinguish two r².

    Parameters
    ----------
    r2 : (float, float); the two, from 0 to below 1, of positive r
    sheets, fields : int; sheets (of each paper where two are compared), at least 3, and fields of
    each sheet
    n_eff : float; independent points of a field: of a field measured before, or
    :func:`planish.analyze.expected_n_eff`
    between_sheets : float
        Standard deviation of Fisher's z between sheets, from earlier ones: ``sd_between`` of
        :func:`planish.analyze.random_effects`.
    paired : bool; whether the same sheets are measured before and after
    change_between_sheets : float; where paired: standard deviation, between sheets, of what the
    treatment changes z by
    shared : float
        Where paired: how far the scatter of z of a field before and after is the same, from 0
        (other fields) to 1.

    Returns
    -------
    StudyDesign

    Raises
    ------
    InputError
        If a number means nothing, or both r² are the same.

    Notes
    -----
    The test is that of :func:`planish.analyze.difference_of_pooled_r`: Student's t of r over sheets
    (r² near 0 has no such test, and above 0 they say the same). The variance of z of a field is 1 /
    (n_eff - 3); the power follows from the noncentral t distribution. Simulated studies agree
    (docs/series.md).
    """
    if not all(0 <= v < 1 for v in r2) or r2[0] == r2[1]:
        raise InputError(f"r² is {r2[0]} and {r2[1]}. Give two different ones, from 0 to below 1.")
    if sheets < LEAST_SHEETS or fields < 1:
        raise InputError(
            f"The study is of {sheets} sheets with {fields} fields each. Give {LEAST_SHEETS} sheets"
            " or more, and 1 field or more."
        )
    if not LEAST_CLAIMED <= n_eff < math.inf:
        raise InputError(
            f"n_eff is {n_eff}. Give the independent points of a field, {LEAST_CLAIMED:.0f} or"
            " more."
        )
    if not (
        0 <= between_sheets < math.inf
        and 0 <= change_between_sheets < math.inf
        and 0 <= shared <= 1
    ):
        raise InputError(
            f"z varies by {between_sheets} between sheets and its change by"
            f" {change_between_sheets}, and {shared} of the scatter is shared. Give numbers from 0"
            " on, and a share from 0 to 1."
        )
    slopes = [1 - v for v in r2]  # of r over z
    field_variance = 1 / (n_eff - 3) / fields
    if paired:
        s0, s1 = slopes
        fields_variance = (s0 * s0 + s1 * s1 - 2 * shared * s0 * s1) * field_variance
        variance = (
            ((s1 - s0) * between_sheets) ** 2 + (s1 * change_between_sheets) ** 2 + fields_variance
        )
        error, free = math.sqrt(variance / sheets), sheets - 1.0
    else:
        variances = [s * s * (between_sheets**2 + field_variance) / sheets for s in slopes]
        error, free = math.sqrt(sum(variances)), welch_free(variances, (sheets, sheets))
    return StudyDesign(
        sheets=sheets,
        fields=fields,
        n_eff=n_eff,
        r2=(float(r2[0]), float(r2[1])),
        paired=paired,
        standard_error=error,
        power=power_of_shift(abs(math.sqrt(r2[1]) - math.sqrt(r2[0])) / error, free),
    )


def sheets_needed(
    r2: Pair,
    *,
    fields: int,
    n_eff: float,
    between_sheets: float,
    paired: bool,
    power: float = 0.8,
    change_between_sheets: float = 0.0,
    shared: float = 0.0,
) -> StudyDesign:
    """Find the fewest sheets with which a study distinguishes two r² with a power.

    Parameters
    ----------
    r2, fields, n_eff, between_sheets, paired, change_between_sheets, shared
        As of :func:`planish.analyze.power_of_study`.
    power : float; how often the study is to see the difference, between 0.05 and 1

    Returns
    -------
    StudyDesign

    Raises
    ------
    InputError
        As :func:`planish.analyze.power_of_study`; if the power is not between 0.05 and 1, or 100
        000 sheets do not reach it.
    """
    check_power(power)
    design_of = partial(
        power_of_study,
        r2,
        fields=fields,
        n_eff=n_eff,
        between_sheets=between_sheets,
        paired=paired,
        change_between_sheets=change_between_sheets,
        shared=shared,
    )
    low, high = LEAST_SHEETS - 1, LEAST_SHEETS
    while design_of(sheets=high).power < power:
        low, high = high, 2 * high
        if high > 100_000:
            raise InputError(
                f"100000 sheets do not see a difference of {abs(r2[1] - r2[0]):g} in r². Give a"
                " larger one."
            )
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if design_of(sheets=middle).power >= power else (middle, high)
    return design_of(sheets=high)


def expected_n_eff(field_um: Pair, *, length_um: Pixel, point_um: float) -> float:
    """Count the independent points of a field that is yet to be measured.

    Parameters
    ----------
    field_um : (float, float); height and width
    length_um : float or (float, float), over which the correlation of both maps, or of a and of b,
    falls to 1/e
    point_um : float; edge of the points that are compared

    Returns
    -------
    float
        Dutilleul's number (1993) for maps whose correlation falls exponentially, averaged over
        points.

    Raises
    ------
    SizeError
        If a size is not above 0, or the field holds fewer than 3 points or more than two million.
    """
    lengths = (length_um, length_um) if isinstance(length_um, (int, float)) else length_um
    if not all(0 < v < math.inf for v in (*field_um, *lengths, point_um)):
        raise SizeError(
            f"The field is {field_um} um, a length {length_um} um, a point {point_um} um. Give"
            " sizes above 0."
        )
    shape = [int(v / point_um + 1e-9) for v in field_um]
    n = math.prod(shape)
    if not 3 <= n <= _MOST_POINTS:
        raise SizeError(
            f"The field holds {n} points of {point_um:g} um. Give one with 3 to {_MOST_POINTS}."
        )
    covariances = [_of_means(shape, length / point_um) for length in lengths]
    size = [2 * k - 1 for k in shape]
    lags = [np.abs(fft.fftfreq(k, 1 / k)).astype(np.intp) for k in size]
    x, y = (m[np.ix_(*lags)] for m in covariances)
    pairs = np.outer(*(k - a for k, a in zip(shape, lags, strict=True))).astype(np.float64)
    ones = np.asarray(fft.rfft2(np.ones(shape), size))
    row_sums = [
        np.asarray(fft.irfft2(fft.rfft2(m) * ones, size))[: shape[0], : shape[1]] for m in (x, y)
    ]
    totals = [float(m.sum()) for m in row_sums]
    product = math.prod(n * float(m[0, 0]) - s / n for m, s in zip((x, y), totals, strict=True))
    trace = (
        float(np.sum(pairs * x * y))
        - 2 / n * float(np.sum(row_sums[0] * row_sums[1]))
        + math.prod(totals) / n**2
    )
    return min(1 + product / trace, float(n))


def _of_means(shape: list[int], length: float) -> Floats:
    """Covariance of means over points, by lag from 0 on; the length is in points."""
    off = np.arange(1 - _PARTS, _PARTS)
    weight = (_PARTS - np.abs(off)) / _PARTS**2
    distance_y, distance_x = (np.abs(np.add.outer(np.arange(k), off / _PARTS)) for k in shape)
    covariance = np.zeros(shape)
    for i, w in enumerate(weight):
        for j, v in enumerate(weight):
            covariance += (
                w * v * np.exp(-np.hypot(distance_y[:, i, None], distance_x[None, :, j]) / length)
            )
    return covariance
