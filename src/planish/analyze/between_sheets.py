"""Whether two sets of sheets differ, or differ by less than a margin.

The sets are sheets before and after, or of two papers.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy import optimize, special

from planish.analyze.differences import holm
from planish.analyze.distributions import around, is_distinguishable, p_of, student_tail, t_95
from planish.analyze.sheets import Fields, all_alike, spread_of, too_few
from planish.core.errors import InputError
from planish.core.facts import NULL, DescribedModel, Interval, Unsaved, Value
from planish.core.typing import Pair, Texts

_POWER = 0.8  # how often a study sees the smallest difference that it is said to see


class Equivalence(DescribedModel):
    """Whether a difference is smaller than a margin that was declared.

    A difference may be distinguishable from 0 and yet equivalent.
    """

    margin: float
    """Largest difference that does not matter."""
    interval: Interval = NULL
    """90 % interval of the difference."""
    p: Value = NULL
    """Of the test that it is as large as the margin or larger."""
    verdict: Literal["equivalent", "larger", "undecided", "unknown"]
    """Whether that interval lies within the margin, beyond it, or across it."""


class SetDifference(DescribedModel):
    """Difference of two sets of sheets, the second minus the first."""

    kind: Literal["paired", "two groups"]
    """Of the same sheets, or of different ones."""
    sheets: tuple[int, int]
    """Sheets that count."""
    means: tuple[Value, Value] = (NULL, NULL)
    """Over these sheets."""
    difference: Value = NULL
    """Of the means."""
    interval: Interval = NULL
    """Its 95 % interval."""
    p: Value = NULL
    """Of the test that there is none."""
    p_of_table: Value = NULL
    """The same after Holm, for all differences of the series."""


class SheetDifference(SetDifference):
    """Difference of a property between two sets of sheets, and how sure it is.

    The difference is the second set minus the first.
    """

    sd: Unsaved = NULL
    """Of the differences of single sheets where they pair."""
    standard_error: Unsaved = NULL
    """Of the difference."""
    free: Unsaved = NULL
    """Degrees of freedom of its interval."""
    unpaired: Texts = ()
    """Sheets without a partner, where sheets pair."""
    reason: str = ""
    """Why there is no interval."""

    @property
    def distinguishable(self) -> bool | None:
        """Whether the interval excludes 0; None where there is none."""
        return is_distinguishable(self.interval)

    def smallest_seen(self) -> float:
        """How large a difference has to be for such a study to see it in 80 %, at a level of 5 %.

        NaN without interval.
        """
        if math.isnan(self.free):
            return math.nan
        return _shift_seen(self.free) * self.standard_error


def paired_over_sheets(before: Fields, after: Fields) -> SheetDifference:
    """Compare the same sheets before and after, by Student's t over differences of single sheets.

    Parameters
    ----------
    before, after : Fields
        Sheets pair by their names. Where both name their fields, so do fields, and those without a
        partner do not count; else the means of all fields of a sheet pair.

    Returns
    -------
    SheetDifference

    Examples
    --------
    >>> before = Fields([10.0, 11.0, 12.0, 13.0], ["A", "B", "C", "D"])
    >>> after = Fields([10.4, 11.6, 12.5, 13.5], ["A", "B", "C", "D"])
    >>> change = paired_over_sheets(before, after)
    >>> round(change.difference, 2), [round(limit, 2) for limit in change.interval]
    (0.5, [0.37, 0.63])
    """
    means = _means_of_pairs(before, after)
    sheets = dict.fromkeys([*before.sheets, *after.sheets])
    unpaired = tuple(sheet for sheet in sheets if sheet not in means)
    k = len(means)
    if k == 0:
        return SheetDifference(
            kind="paired", sheets=(0, 0), unpaired=unpaired, reason="no sheet has a partner"
        )
    means_before, means_after = np.array([*means.values()]).T
    changes = means_after - means_before
    sd = spread_of(changes)
    if sd <= 1e-12 * np.abs([means_before, means_after]).max():
        sd = 0.0
    reason = too_few(k)
    if not (reason or sd > 0):
        reason = "all sheets have the same difference"
    difference = SheetDifference(
        kind="paired",
        sheets=(k, k),
        means=(means_before.mean(), means_after.mean()),
        difference=changes.mean(),
        sd=sd,
        standard_error=sd / math.sqrt(k),
        unpaired=unpaired,
        reason=reason,
    )
    if difference.reason:
        return difference
    return _with_interval(difference, k - 1.0)


def _means_of_pairs(before: Fields, after: Fields) -> dict[str, Pair]:
    """Means of sheets that are in both, before and after, by the name of the sheet.

    They are over the fields that both have where all fields have names, else over all fields.
    """
    if before.names and after.names:
        new_keys = zip(after.sheets, after.names, strict=True)
        new_values = dict(zip(new_keys, after.values, strict=True))
        old_keys = zip(before.sheets, before.names, strict=True)
        new = np.array([new_values.get(key, math.nan) for key in old_keys])
        is_missing = np.isnan(new) | np.isnan(before.values)
        before = Fields(np.where(is_missing, math.nan, before.values), before.sheets)
        after = Fields(np.where(is_missing, math.nan, new), before.sheets)
    new_sheets = after.by_sheet
    means: dict[str, Pair] = {}
    for sheet, values in before.by_sheet.items():
        if sheet in new_sheets:
            means[sheet] = (values.mean(), new_sheets[sheet].mean())
    return means


def two_groups(first: Fields, second: Fields) -> SheetDifference:
    """Compare sheets of two papers, or of two treatments, that share no sheet, after Welch.

    Parameters
    ----------
    first, second : Fields
        A property, or r, of each field; NaN is missing.

    Returns
    -------
    SheetDifference

    References
    ----------
    Welch (1947), Biometrika 34, 28, doi:10.1093/biomet/34.1-2.28.

    Examples
    --------
    >>> coated = Fields([10.0, 11.0, 12.0], ["A", "B", "C"])
    >>> calendered = Fields([8.0, 9.0, 8.5], ["D", "E", "F"])
    >>> difference = two_groups(coated, calendered)
    >>> difference.difference, round(difference.p, 3)
    (-2.5, 0.032)
    """
    groups = (first.means, second.means)
    k = (groups[0].size, groups[1].size)
    if min(k) == 0:
        return SheetDifference(
            kind="two groups", sheets=k, reason="one of the two has no field with a value"
        )
    means = (groups[0].mean(), groups[1].mean())
    mean_variances = [spread_of(group) ** 2 / group.size for group in groups]
    error = math.sqrt(sum(mean_variances))
    difference = SheetDifference(
        kind="two groups",
        sheets=k,
        means=means,
        difference=means[1] - means[0],
        standard_error=error,
        reason=too_few(*k) or all_alike(error),
    )
    if difference.reason:
        return difference
    # Degrees of freedom of a sum of variances of means, each over so many values (Welch 1947).
    parts = [v * v / (n - 1) for v, n in zip(mean_variances, k, strict=True)]
    free = sum(mean_variances) ** 2 / sum(parts)
    return _with_interval(difference, free)


def _with_interval(change: SheetDifference, free: float) -> SheetDifference:
    """The same with interval and p, for so many degrees of freedom."""
    interval = around(change.difference, t_95(free) * change.standard_error)
    p = p_of(change.difference / change.standard_error, free)
    return change.model_copy(update={"free": free, "interval": interval, "p": p})


def p_of_tables(differences: Sequence[SheetDifference]) -> tuple[SheetDifference, ...]:
    """Correct p for the number of differences that are looked at (Holm 1979).

    These are the differences of all properties and pairs of papers.

    Examples
    --------
    >>> a = Fields([10.0, 11.0, 12.0], ["A", "B", "C"])
    >>> b = Fields([8.0, 9.0, 8.5], ["D", "E", "F"])
    >>> [round(row.p_of_table, 3) for row in p_of_tables([two_groups(a, b), two_groups(b, a)])]
    [0.063, 0.063]
    """
    adjusted_p = holm([d.p for d in differences])
    pairs = zip(differences, adjusted_p, strict=True)
    return tuple(difference.model_copy(update={"p_of_table": p}) for difference, p in pairs)


def equivalence(shift: SheetDifference, *, margin: float) -> Equivalence:
    """Test whether a difference is smaller than a margin, by two one-sided tests at 5 %.

    Parameters
    ----------
    shift : SheetDifference
    margin : float, in the unit of the property; chosen for what matters, before the values are
    looked at

    Returns
    -------
    Equivalence

    Raises
    ------
    InputError
        If the margin is not above 0.

    References
    ----------
    Schuirmann (1987), J. Pharmacokinet. Biopharm. 15, 657, doi:10.1007/BF01068419.

    Examples
    --------
    >>> a = Fields([10.0, 11.0, 12.0], ["A", "B", "C"])
    >>> b = Fields([10.5, 11.1, 11.6], ["D", "E", "F"])
    >>> equivalence(two_groups(a, b), margin=3.0).verdict
    'equivalent'
    """
    if not 0 < margin < math.inf:
        raise InputError(
            f"The margin is {margin}. Give the largest difference that does not matter, above 0."
        )
    if shift.reason:
        return Equivalence(margin=margin, verdict="unknown")
    width = float(special.stdtrit(shift.free, 0.95)) * shift.standard_error
    low, high = around(shift.difference, width)
    room = margin - abs(shift.difference)
    p = student_tail(room / shift.standard_error, shift.free)
    verdict = "undecided"
    if -margin < low and high < margin:
        verdict = "equivalent"
    elif low > margin or high < -margin:
        verdict = "larger"
    return Equivalence(margin=margin, interval=(low, high), p=p, verdict=verdict)


def _shift_seen(free: float) -> float:
    """How many standard errors a difference must have to be seen in 80 %, two-sided at 5 %."""
    high = 4.0  # not at once a large one: far out, the distribution's numbers are not defined
    while _power_of_shift(high, free) < _POWER:
        high *= 2
    shift = optimize.brentq(lambda t: _power_of_shift(t, free) - _POWER, 0.0, high, xtol=1e-10)
    return float(shift)


def _power_of_shift(shift: float, free: float) -> float:
    """How often a difference of so many standard errors is seen, two-sided at 5 %."""
    unseen = special.nctdtr(free, [shift, -shift], t_95(free))
    return float(np.sum(1.0 - unseen))
