"""One r from many fields: pooled over sheets, and how much sheets differ (meta-analysis)."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from planish.analyze.between_sheets import SheetDifference, paired_over_sheets, two_groups
from planish.analyze.distributions import around, t_95
from planish.analyze.sheets import Fields, RandomEffects, SheetMean, over_sheets
from planish.core.arrays import values_of
from planish.core.errors import InputError
from planish.core.typing import Floats, Pair, pair_of


def random_effects(
    effects: Sequence[float] | Floats, variances: Sequence[float] | Floats
) -> RandomEffects:
    """Pool effects that differ from each other.

    Parameters
    ----------
    effects, variances : sequence of float
        Of each field or sheet, all known; the variance is that of the effect as it was measured.

    Returns
    -------
    RandomEffects
        The variance between them after Paule and Mandel (1982), the interval after Hartung and
        Knapp (2001), which holds in as few as .87 where one of three effects is much better known
        than the others (docs/series.md); I² after Higgins and Thompson (2002).

    Raises
    ------
    InputError
        If there are fewer than 2 effects, not as many variances, or one that is not above 0.

    References
    ----------
    Paule and Mandel (1982), J. Res. Natl. Bur. Stand. 87, 377, doi:10.6028/jres.087.022.
    Hartung and Knapp (2001), Statist. Med. 20, 3875, doi:10.1002/sim.1009.
    Higgins and Thompson (2002), Statist. Med. 21, 1539, doi:10.1002/sim.1186.

    Examples
    --------
    >>> pooled = random_effects([0.3, 0.5, 0.4], [0.01, 0.01, 0.01])
    >>> round(pooled.mean, 2), round(pooled.standard_error, 3), pooled.sd_between
    (0.4, 0.058, 0.0)
    """
    y = values_of(effects, "effects").astype(np.float64)
    v = values_of(variances, "variances").astype(np.float64)
    are_pairs = y.ndim == 1 and y.shape == v.shape
    are_numbers = np.isfinite(y).all() and (v > 0).all()
    if y.size < 2 or not (are_pairs and are_numbers):
        raise InputError(
            f"There are {y.size} effects and {v.size} variances. Give two effects or more, each a"
            " number with a variance above 0."
        )
    if not np.isfinite(v).all():
        raise InputError("The variance of an effect is infinite. Leave that effect out.")
    k = y.size
    q = _excess(0.0, y, v)[0]
    i2 = 0.0
    if q > 0:
        i2 = max(1 - (k - 1) / q, 0.0)
    between = _between(y, v)
    weight = 1 / (v + between)
    total = weight.sum()
    mean = np.sum(weight * y) / total
    width = math.nan
    if k > 2:
        squares = np.sum(weight * (y - mean) ** 2)
        width = t_95(k - 1) * math.sqrt(squares / total / (k - 1))
    return RandomEffects(
        effects=k,
        mean=mean,
        standard_error=1 / math.sqrt(total),
        between=between,
        sd_between=math.sqrt(between),
        q=q,
        p=float(special.chdtrc(k - 1, q)),
        interval=around(mean, width),
        i2=i2,
    )


def effects_of_sheets(effects: Fields, variances: Fields) -> RandomEffects | None:
    """How much the means of sheets differ; None of one sheet.

    ``variances`` are those of the effects of the fields.
    """
    if len(effects.by_sheet) < 2:
        return None
    of_sheets = [v.sum() / v.size**2 for v in variances.by_sheet.values()]
    return random_effects(effects.means, of_sheets)


def _excess(between: float, y: Floats, v: Floats) -> Pair:
    """Weighted sum of squares about the weighted mean, and its fall with the variance between."""
    weight = 1 / (v + between)
    mean = np.sum(weight * y) / weight.sum()
    square = (y - mean) ** 2
    return np.sum(weight * square), np.sum(weight * weight * square)


def _between(y: Floats, v: Floats) -> float:
    """Variance where the weighted sum of squares is its expectation, by Newton's steps from 0.

    ``y`` are the effects, ``v`` their own variances. The sum is falling and convex, so steps from 0
    never go too far; where it is below its expectation at 0, the effects do not differ: 0.
    """
    between = 0.0
    for _ in range(200):
        total, slope = _excess(between, y, v)
        if not slope > 0:
            break
        step = (total - (y.size - 1)) / slope
        if step <= 1e-15 * between:
            break
        between += step
    return between


def pooled_r(r: Fields, n_eff: Sequence[float]) -> SheetMean:
    """Pool the correlations of fields over sheets.

    Parameters
    ----------
    r : Fields; correlation of every field, all over points of one size; NaN is missing
    n_eff : sequence of float
        ``n_eff_interval`` of every :class:`planish.analyze.Correlation`. A field where it is NaN or
        at most 4 does not count, nor does one whose r is 1 or -1, as of a map with itself.

    Returns
    -------
    SheetMean

    Raises
    ------
    InputError
        If there are not as many n_eff as fields, or a correlation is beyond 1.

    Notes
    -----
    The z of a sheet is the mean of those of its fields. Weights by n_eff would narrow the interval
    a little where fields differ in size, but with few sheets it would hold in less than 95 %, as
    the weights take the variance between sheets for known (docs/series.md).

    Examples
    --------
    >>> r = Fields([0.3, 0.5, 0.4], ["A", "B", "C"])
    >>> mean = pooled_r(r, n_eff=[103.0, 103.0, 103.0])
    >>> round(mean.mean, 2), [round(limit, 2) for limit in mean.interval]
    (0.4, [0.13, 0.62])
    """
    z, variance = _fisher_z(r, n_eff)
    mean = over_sheets(z)
    each_alone = [str(k) for k in range(len(z.values))]
    between_fields = effects_of_sheets(
        replace(z, sheets=each_alone), replace(variance, sheets=each_alone)
    )
    return SheetMean(
        sheets=mean.sheets,
        fields=mean.fields,
        mean=math.tanh(mean.mean),
        reason=mean.reason,
        interval=pair_of(np.tanh(mean.interval)),
        between_sheets=effects_of_sheets(z, variance),
        between_fields=between_fields,
    )


def difference_of_pooled_r(
    first: Fields, second: Fields, *, paired: bool, squared: bool = False
) -> SheetDifference:
    """Compare the r, or r², of two sets of sheets.

    Parameters
    ----------
    first, second : Fields; correlations of fields, all over points of one size; NaN is missing
    paired : bool
        Whether both are of the same sheets (:func:`planish.analyze.paired_over_sheets`), else
        :func:`planish.analyze.two_groups`.
    squared : bool; compare r²

    Returns
    -------
    SheetDifference
        In r, or r²: ``means`` are those of the means of z.

    Raises
    ------
    InputError
        If a correlation is beyond 1.

    Notes
    -----
    Means are taken of Fisher's z, in which r of few independent points has no bias, and each sheet
    adds to the difference of r what it adds to z, times the slope of r over z there (delta method).

    Examples
    --------
    >>> matt = Fields([0.3, 0.35, 0.4], ["A", "B", "C"])
    >>> gloss = Fields([0.5, 0.55, 0.6], ["D", "E", "F"])
    >>> round(difference_of_pooled_r(matt, gloss, paired=False).difference, 2)
    0.2
    """
    z = [_fisher_z(m, None)[0] for m in (first, second)]
    compare = paired_over_sheets if paired else two_groups
    means = compare(*z).means
    linearised: list[Fields] = []  # values of r, or r², that are linear in z and right at its mean
    for fields, mean_z in zip(z, means, strict=True):
        figure = math.tanh(mean_z)
        slope = 1 - figure**2
        if squared:
            slope *= 2 * figure
            figure **= 2
        values = [figure + slope * (k - mean_z) for k in fields.values]
        linearised.append(replace(fields, values=values))
    return compare(*linearised)


def _fisher_z(r: Fields, n_eff: Sequence[float] | None) -> tuple[Fields, Fields]:
    """Fisher's z of fields and its variances, both NaN where a field does not count.

    Without ``n_eff`` every field counts whose r is a number below 1, with a variance of 0.
    """
    if n_eff is not None and len(n_eff) != len(r.values):
        raise InputError(
            f"There are {len(r.values)} correlations and {len(n_eff)} n_eff. Give one for each."
        )
    if any(abs(v) > 1 for v in r.values):
        raise InputError("A correlation is beyond 1. Give r of every field, from -1 to 1, or NaN.")
    n_of_fields = [math.inf] * len(r.values) if n_eff is None else n_eff
    z: list[float] = []
    variance: list[float] = []
    for v, n in zip(r.values, n_of_fields, strict=True):
        is_used = abs(v) < 1 and n > 4
        z.append(math.atanh(v) if is_used else math.nan)
        variance.append(1 / (n - 3) if is_used else math.nan)
    return replace(r, values=z), replace(r, values=variance)
