"""Fields nested in sheets: what holds for the paper, where sheets, not fields, are the sample.

Fields of one sheet resemble each other: twelve of four sheets say what four sheets say. All is over
means of sheets.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from planish.analyze.distributions import around, t_95
from planish.core.errors import InputError
from planish.core.facts import NULL, DescribedModel, Interval, Unsaved, UnsavedInterval, Value
from planish.core.typing import Floats, Texts, pair_of

LEAST_SHEETS = 3
"""Sheets below which there is no interval."""

_SAME = 1e-12  # of the largest value: what rounding leaves of a spread


@dataclass(frozen=True, slots=True)
class Fields:
    """One figure of every field: a property, or r.

    Parameters
    ----------
    values : sequence of float; one of each field; NaN is missing
    sheets : sequence of str
        The sheet of each field. Sheets of two papers need no names of their own.
    names : sequence of str
        The name of each field, unlike all others of its sheet: by it a field before pairs with the
        field after.

    Raises
    ------
    InputError
        If the sequences are not of one length, a value is infinite, or a sheet has a name twice.
    """

    values: Sequence[float] | Floats
    sheets: Sequence[str]
    names: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Check the lengths, the values and the names."""
        n = len(self.values)
        if len(self.sheets) != n or len(self.names) not in (0, n):
            raise InputError(
                f"There are {n} values of fields, {len(self.sheets)} sheets and {len(self.names)}"
                " names. Give one sheet for each value, and a name for each or for none."
            )
        if any(math.isinf(v) for v in self.values):
            raise InputError(
                "The value of a field is infinite. Give numbers, or NaN where one is missing."
            )
        field_keys = list(zip(self.sheets, self.names, strict=False))
        if len(set(field_keys)) < len(field_keys):
            twice = next(pair for pair in field_keys if field_keys.count(pair) > 1)
            raise InputError(
                f"Sheet {twice[0]} has the field {twice[1]} twice. Give each field a name of its"
                " own."
            )

    @property
    def by_sheet(self) -> dict[str, Floats]:
        """The known values of each sheet that has any, sheets in the order in which they come."""
        values_by_sheet: dict[str, list[float]] = {}
        for sheet, value in zip(self.sheets, self.values, strict=True):
            if not math.isnan(value):
                values_by_sheet.setdefault(sheet, []).append(value)
        return {sheet: np.array(values) for sheet, values in values_by_sheet.items()}

    @property
    def means(self) -> Floats:
        """The mean of each sheet."""
        return np.array([v.mean() for v in self.by_sheet.values()])


class RandomEffects(DescribedModel):
    """Mean of effects that differ, each known with a variance of its own.

    Of r the effects are Fisher's z.
    """

    effects: int
    """Sheets, or fields."""
    sd_between: Value
    """Standard deviation of the true z; 0 where their own scatter explains all."""
    i2: Value
    """Share of the variance of z that is between them."""
    q: Value
    """Cochran's Q."""
    p: Value
    """Of the test that all are the same."""
    mean: Unsaved = NULL
    """With weights of 1 over the sum of both variances."""
    standard_error: Unsaved = NULL
    """Of the mean, from the weights."""
    between: Unsaved = NULL
    """Variance of the true effects."""
    interval: UnsavedInterval = NULL
    """95 % interval of the mean; none with fewer than 3 effects."""


class SheetVariances(DescribedModel):
    """How much of the variance is between sheets."""

    sd_between: Value = NULL
    """Standard deviation of sheets, beyond what fields add."""
    sd_within: Value = NULL
    """Standard deviation of the fields of one sheet."""
    share: Value = NULL
    """Share of the variance that is between sheets."""
    share_interval: Interval = NULL
    """95 % interval of the share."""
    p: Value = NULL
    """Of the test that all sheets are alike."""
    reason: str = ""
    """Why a number is missing."""


class SheetMean(DescribedModel):
    """Mean of a property, or of r, over sheets."""

    sheets: int
    """Sheets that count."""
    fields: int
    """Specimens that count; each is a field of a sheet."""
    left_out: Texts = ()
    """Specimens of the group that do not count."""
    mean: Value = NULL
    """Over the means of sheets; of r by Fisher's z."""
    sd: Value = NULL
    """Standard deviation of the means of sheets; none of r."""
    interval: Interval = NULL
    """95 % interval of the mean of such sheets."""
    reason: str = ""
    """Why there is no interval."""
    variances: SheetVariances | None = None
    """Of a property."""
    between_sheets: RandomEffects | None = None
    """Of r, over sheets."""
    between_fields: RandomEffects | None = None
    """Of r, over all fields as if each were of a sheet of its own."""
    standard_error: Unsaved = NULL
    """Of the mean of a property."""


def over_sheets(fields: Fields) -> SheetMean:
    """Take the mean over sheets, with its interval by Student's t.

    Parameters
    ----------
    fields : Fields
        A property of each field; NaN is missing.

    Returns
    -------
    SheetMean

    Notes
    -----
    Every sheet counts alike, however many fields it has. Means of sheets are taken for normal;
    where sheets have different numbers of fields, their means scatter differently, which the
    interval withstands (docs/series.md).

    Examples
    --------
    >>> fields = Fields([10.0, 12.0, 13.0, 15.0, 14.0], ["A", "A", "B", "C", "C"])
    >>> mean = over_sheets(fields)
    >>> mean.sheets, mean.fields, round(mean.mean, 2)
    (3, 5, 12.83)
    """
    means = fields.means
    k = means.size
    n_fields = sum(not math.isnan(value) for value in fields.values)
    if k == 0:
        return SheetMean(sheets=k, fields=n_fields, reason=too_few(k))
    mean = means.mean()
    spread = spread_of(means)
    error = spread / math.sqrt(k)
    reason = too_few(k) or all_alike(spread)
    width = math.nan if reason else t_95(k - 1) * error
    return SheetMean(
        sheets=k,
        fields=n_fields,
        mean=mean,
        sd=spread,
        standard_error=error,
        interval=around(mean, width),
        reason=reason,
    )


def spread_of(values: Floats) -> float:
    """Standard deviation of a sample.

    Exactly 0 where only rounding sets values apart, NaN of one value.
    """
    if values.size < 2:
        return math.nan
    if np.ptp(values) <= _SAME * np.abs(values).max():
        return 0.0
    return values.std(ddof=1)


def too_few(*sheets: int) -> str:
    """Why there is no interval where sheets are too few; empty where there are enough."""
    return "" if min(sheets) >= LEAST_SHEETS else f"{min(sheets)} of at least {LEAST_SHEETS} sheets"


def all_alike(spread: float) -> str:
    """Why there is no interval where sheets do not differ at all; empty where they do."""
    return "" if spread > 0 else "all sheets have the same value"


def variances_of(fields: Fields) -> SheetVariances:
    """Split the variance of a property into that between sheets and that within them.

    Parameters
    ----------
    fields : Fields
        A property of each field; NaN is missing.

    Returns
    -------
    SheetVariances

    Notes
    -----
    Analysis of variance with unweighted means: the variance within is pooled over sheets; the
    variance of the means of sheets, less the variance within over the harmonic mean of the numbers
    of fields, is that between, without bias as long as it is above 0. With as many fields in every
    sheet these are the textbook's estimates, and the interval of the share is exact for normal
    values; else it is that of Thomas and Hultquist (1978). ``p`` is of the F test.

    References
    ----------
    Thomas and Hultquist (1978), Ann. Statist. 6, 582, doi:10.1214/aos/1176344202.

    Examples
    --------
    >>> fields = Fields([10.0, 11.0, 20.0, 21.0, 30.0, 31.0], ["A", "A", "B", "B", "C", "C"])
    >>> variances = variances_of(fields)
    >>> round(variances.sd_within, 2), round(variances.share, 3)
    (0.71, 0.995)
    """
    sheets = [*fields.by_sheet.values()]
    counts = np.array([v.size for v in sheets])
    k = len(sheets)
    n = int(counts.sum())
    if k < 2:
        sd_within = sheets[0].std(ddof=1) if n > 1 else math.nan
        return SheetVariances(sd_within=sd_within, reason=f"{k} of at least 2 sheets")
    if n == k:
        return SheetVariances(reason="no sheet has two fields")
    means = fields.means
    squares_within = sum(v.var() * v.size for v in sheets)
    within = squares_within / (n - k)
    spread = spread_of(means) ** 2  # variance of the means of sheets
    rounding = _SAME * np.abs(means).max()
    if not within > rounding**2:
        share = 1.0 if spread > 0 else math.nan
        return SheetVariances(
            sd_between=math.sqrt(spread),
            sd_within=0.0,
            share=share,
            reason="all fields of a sheet have the same value",
        )
    fields_per_sheet = k / np.sum(1 / counts)  # harmonic mean
    between = max(spread - within / fields_per_sheet, 0.0)
    grand_mean = counts @ means / n
    squares_between = np.sum(counts * (means - grand_mean) ** 2)
    ratio = squares_between / (k - 1) / within
    interval = np.full(2, math.nan)
    if not too_few(k):
        # Quantiles of the ratio of both variances where sheets are alike.
        f = special.fdtri(k - 1, n - k, [0.975, 0.025])
        ratio_of_means = fields_per_sheet * spread / within
        excess = np.maximum(ratio_of_means / f - 1, 0.0)
        interval = excess / (fields_per_sheet + excess)
    return SheetVariances(
        sd_between=math.sqrt(between),
        sd_within=math.sqrt(within),
        share=between / (between + within),
        share_interval=pair_of(interval),
        p=special.fdtrc(k - 1, n - k, ratio),
        reason=too_few(k),
    )
