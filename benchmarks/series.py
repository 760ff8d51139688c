"""What is said of series of specimens, on simulated studies whose truth is known.

``python -m benchmarks series [STUDIES] [MAPS]``

``STUDIES`` (4000) are drawn of each kind, a tenth of it with random maps in place of random z;
``MAPS`` (2000) pairs of maps of two instruments. Exit code 1 where a share is outside of what is
promised.
"""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
from scipy import stats

from benchmarks.evidence import field, related
from benchmarks.shared import in_parts
from planish.analyze import (
    Fields,
    bland_altman,
    correlate,
    difference_of_pooled_r,
    equivalence,
    over_sheets,
    paired_over_sheets,
    pooled_r,
    two_groups,
    variances_of,
)

MEAN_Z, N_EFF, EACH = 0.55, 70.0, 3
_OWN = 1 / (N_EFF - 3)


def names_of(counts):
    """The sheet of every field."""
    return [f"S{k}" for k, n in enumerate(counts) for _ in range(n)]


def students(values):
    """Interval of the mean of values that are taken for independent."""
    wide = (
        float(stats.t.ppf(0.975, values.size - 1))
        * float(values.std(ddof=1))
        / math.sqrt(values.size)
    )
    return float(values.mean()) - wide, float(values.mean()) + wide


def holds(interval, truth):
    """Whether an interval holds the truth; NaN where there is none."""
    return math.nan if math.isnan(interval[0]) else float(interval[0] <= truth <= interval[1])


# --- r and properties over sheets -----------------------------------------------------------------


def ways(z, n_eff, names):
    """What is pooled of fields, and the intervals of z by the fields and by their numbers of points
    alone."""
    found = pooled_r(Fields(np.tanh(z).tolist(), names), n_eff.tolist())
    wide = 1.96 / math.sqrt(float(np.sum(n_eff - 3)))
    middle = float(np.average(z, weights=n_eff - 3))
    return found, students(z), (middle - wide, middle + wide)


def pooled(sheets, between, uneven, seed, count):
    """Whether the interval of r holds it: by sheets, by weights (Hartung-Knapp), by fields, by
    n_eff alone."""
    rng, out, truth = np.random.default_rng((seed, sheets)), [], math.tanh(MEAN_Z)
    sheet = np.repeat(np.arange(sheets), EACH)
    for _ in range(count):
        n_eff = np.full(sheet.size, N_EFF)
        if uneven:  # one sheet has much larger fields
            n_eff = np.where(sheet == 0, 1000.0, 40.0)
        z = (
            MEAN_Z
            + between * rng.normal(size=sheets)[sheet]
            + rng.normal(size=sheet.size) / np.sqrt(n_eff - 3)
        )
        found, by_fields, alone = ways(z, n_eff, [f"S{k}" for k in sheet])
        out.append(
            (
                holds(found.interval, truth),
                holds(found.between_sheets.interval, MEAN_Z),
                holds(by_fields, MEAN_Z),
                holds(alone, MEAN_Z),
                found.interval[1] - found.interval[0],
            )
        )
    return np.array(out)


def properties(counts, between, seed, count):
    """Whether the intervals hold the mean, and the share of variance between sheets; and the mean
    by fields."""
    rng, out = np.random.default_rng((seed, len(counts))), []
    sheets, share = names_of(counts), between**2 / (between**2 + 1)
    for _ in range(count):
        values = np.repeat(between * rng.normal(size=len(counts)), counts) + rng.normal(
            size=len(sheets)
        )
        given = Fields(values.tolist(), sheets)
        fields = students(values)
        out.append(
            (
                holds(over_sheets(given).interval, 0.0),
                holds(variances_of(given).share_interval, share),
                holds(fields, 0.0),
            )
        )
    return np.array(out)


def differences(sheets, seed, count):
    """Whether intervals of differences hold the truth: a property and r before and after, r², and
    of two papers.

    And how often a difference as large as the margin is called equivalent.
    """
    rng, out, names = np.random.default_rng((seed, sheets)), [], names_of([EACH] * sheets)
    after = MEAN_Z + 0.1
    r = math.tanh(after) - math.tanh(MEAN_Z)
    r2 = math.tanh(after) ** 2 - math.tanh(MEAN_Z) ** 2

    def drawn(sheet, mean):
        z = mean + np.repeat(sheet, EACH) + math.sqrt(_OWN) * rng.normal(size=len(names))
        return Fields(z.tolist(), names)

    def in_r(fields):
        return Fields(np.tanh(fields.values).tolist(), names)

    for _ in range(count):
        sheet = 0.15 * rng.normal(size=sheets)
        one, two = drawn(sheet, MEAN_Z), drawn(sheet + 0.05 * rng.normal(size=sheets), after)
        other = drawn(0.3 * rng.normal(size=sheets), after)
        paired = paired_over_sheets(one, two)
        groups = two_groups(one, other)
        out.append(
            (
                holds(paired.interval, 0.1),
                holds(difference_of_pooled_r(in_r(one), in_r(two), paired=True).interval, r),
                holds(
                    difference_of_pooled_r(
                        in_r(one), in_r(two), paired=True, squared=True
                    ).interval,
                    r2,
                ),
                holds(groups.interval, 0.1),
                holds(
                    difference_of_pooled_r(
                        in_r(one), in_r(other), paired=False, squared=True
                    ).interval,
                    r2,
                ),
                equivalence(paired, margin=0.1).verdict == "equivalent",
            )
        )
    return np.array(out, dtype=float)


# --- with random maps -----------------------------------------------------------------------------

SHAPE, LENGTH = (60, 80), 4.0


def with_maps(sheets, between, seed, count):
    """The same with maps that correlate: r pooled, by fields, by n_eff alone; r and r² before and
    after."""
    rng, out, names = np.random.default_rng((seed, sheets, 1)), [], names_of([EACH] * sheets)
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    before = float(
        np.sum(weights * np.arctanh(0.8 * np.tanh(MEAN_Z + between * nodes))) / weights.sum()
    )
    r = [math.tanh(MEAN_Z), math.tanh(before)]
    for _ in range(count):
        true = np.tanh(MEAN_Z + between * rng.normal(size=sheets))
        found = []
        for value in np.repeat(true, EACH):
            a, b = related(rng, float(value), LENGTH, shape=SHAPE)
            worse = 0.8 * a + 0.6 * field(rng, SHAPE, LENGTH, "exp")[0]
            found.append([correlate(m, b, pixel_um=1.0) for m in (a, worse)])
        after, earlier = (Fields([row[k].r for row in found], names) for k in (0, 1))
        n_eff = np.array([row[0].n_eff_interval for row in found])
        pool, by_fields, alone = ways(np.arctanh(after.values), n_eff, names)
        change = [
            difference_of_pooled_r(earlier, after, paired=True, squared=s).interval
            for s in (False, True)
        ]
        out.append(
            (
                holds(pool.interval, r[0]),
                holds(by_fields, MEAN_Z),
                holds(alone, MEAN_Z),
                holds(change[0], r[0] - r[1]),
                holds(change[1], r[0] ** 2 - r[1] ** 2),
                float(np.median(n_eff)),
            )
        )
    return np.array(out)


# --- two instruments ------------------------------------------------------------------------------

FIELD = (90, 120)


def waves(length, kind, shape, rng):
    return field(rng, shape, length, kind)[0]


def mixed(rng):
    """Noise of single pixels over waves."""
    return 0.6 * field(rng, FIELD, 8.0, "exp")[0] + 0.8 * rng.normal(size=FIELD)


def pierced():
    """A field with six holes."""
    rows, cols = np.mgrid[: FIELD[0], : FIELD[1]]
    known = np.ones(FIELD, bool)
    for y in (20, 60):
        for x in (20, 60, 100):
            known[np.hypot(rows - y, cols - x) < 12] = False
    return known


INSTRUMENTS = {
    "independent points": (lambda rng: rng.normal(size=FIELD), False),
    **{
        f"side/{90 / k:.0f}": (partial(waves, k, "exp", FIELD), False)
        for k in (1.0, 3.0, 6.0, 8.0, 10.0)
    },
    "Gaussian, side/15": (partial(waves, 6.0, "gauss", FIELD), False),
    "Gaussian, side/8": (partial(waves, 12.0, "gauss", FIELD), False),
    "4:1, 3 x 12 pixels": (partial(waves, (3.0, 12.0), "exp", FIELD), False),
    "64 % noise of pixels over side/11": (mixed, False),
    "side/11, six holes": (partial(waves, 8.0, "exp", FIELD), True),
    "40 x 240 pixels, 4 pixels": (partial(waves, 4.0, "exp", (40, 240)), False),
}


def instruments(name, seed, count):
    """Whether the intervals of bias, scatter and both limits hold the truth; and what the limits
    are off by."""
    make, holes = INSTRUMENTS[name]
    rng, out, mask = np.random.default_rng((seed, *name.encode())), [], pierced() if holes else None
    for _ in range(count):
        a = make(rng)
        off = 2 + 0.5 * make(rng)
        b = a + off
        found = bland_altman(a, b if mask is None else np.where(mask, b, np.nan), pixel_um=1.0)
        known = (b - a) if mask is None else (b - a)[mask]
        direct = known.mean() + 1.96 * known.std(ddof=1) * np.array([-1, 1])
        out.append(
            (
                holds(found.bias_interval, 2.0),
                holds(found.sd_interval, 0.5),
                holds(found.limit_intervals[0], 2 - 0.98),
                holds(found.limit_intervals[1], 2 + 0.98),
                float(np.abs(direct - found.limits).max()),
                found.n_eff,
            )
        )
    return np.array(out)


# --- all of them ----------------------------------------------------------------------------------


def _missed(low, high, *shares):
    return sum(not low <= share <= high for share in shares)


def main(studies=4000, maps=2000):
    count, missed = int(studies), 0
    with ProcessPoolExecutor(2) as pool:

        def parts(work, *given, count):
            return in_parts(pool, partial(work, *given), count)

        for line, shares, wrong in (
            *_over_sheets(parts, count),
            *_differences(parts, count),
            *_with_maps(parts, count // 10),
            *_instruments(parts, int(maps)),
        ):
            words = ", ".join(f"{name} {share:.3f}" for name, share in shares.items())
            print(f"{line}: {words}{' MISSED' if wrong else ''}", flush=True)
            missed += wrong
    print(f"{missed} shares are outside of what is promised.")
    return int(missed > 0)


def _named(names, shares):
    return dict(zip(names.split(", "), shares.tolist(), strict=True))


def _over_sheets(parts, count):
    for between, sheets, uneven in itertools.product((0.0, 0.15), (3, 5, 12), (False, True)):
        found = parts(pooled, sheets, between, uneven, count=count)
        share = found[:, :4].mean(axis=0)
        line = (
            f"r, {sheets} sheets, z varies by"
            f" {between:g}{', one of large fields' if uneven else ''}"
        )
        # With one sheet of large fields, means of sheets scatter unlike: then it may hold more
        # often.
        most = 0.995 if uneven and between == 0 else 0.97
        shares = _named("by sheets, weighted (HK), fields as independent, n_eff alone", share)
        yield line, shares | {"width": float(np.median(found[:, 4]))}, _missed(0.93, most, share[0])
    for counts, between in itertools.product(
        ((3,) * 3, (3,) * 5, (3,) * 12, (1, 2, 3, 6, 2), (1, 1, 8)), (0.0, 1.0)
    ):
        share = parts(properties, counts, between, count=count).mean(axis=0)
        line = f"a property, fields {counts}, share between {between / (between + 1):g}"
        yield line, _named("mean, share, mean by fields", share), _missed(0.93, 0.985, *share[:2])


def _differences(parts, count):
    names = (
        "before and after, of r, of r², two papers, of their r², called equivalent at the margin"
    )
    for sheets in (3, 5, 12):
        share = parts(differences, sheets, count=count).mean(axis=0)
        wrong = _missed(0.92, 0.98, *share[:5]) + _missed(0.0, 0.06, share[5])
        yield f"differences, {sheets} sheets", _named(names, share), wrong


def _with_maps(parts, count):
    names = "r, fields as independent, n_eff alone, before and after: r, r²"
    for between, sheets in itertools.product((0.0, 0.15), (3, 5, 12)):
        found = parts(with_maps, sheets, between, count=count)
        share = found[:, :5].mean(axis=0)
        line = (
            f"with maps, {sheets} sheets, z varies by {between:g}, n_eff"
            f" {np.median(found[:, 5]):.0f}"
        )
        # 400 studies scatter by .011.
        yield line, _named(names, share), _missed(0.92, 0.98, *share[[0, 3, 4]])


def _instruments(parts, count):
    for name in INSTRUMENTS:
        found = parts(instruments, name, count=count)
        share = np.nanmean(found[:, :4], axis=0)
        off = float(found[:, 4].max())
        line = (
            f"two instruments, {name}, n_eff {np.median(found[:, 5]):.0f}, limits off by {off:.0e}"
        )
        shares = _named("bias, sd, lower limit, upper limit", share)
        shares |= {"nothing claimed": float(np.isnan(found[:, 0]).mean())}
        yield line, shares, _missed(0.92, 0.98, *share) + _missed(0.0, 1e-9, off)
