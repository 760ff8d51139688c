"""Which marks do not belong to the others, and how much of them is kept.

A fit that holds the majority (least sum of distances) gives a core of marks that agree. The core grows as long as the
nearest mark outside is no further off than chance puts the furthest of all marks once in a hundred sets of marks.
What is still outside at the end is weighted down: a flat-topped biweight, 1 up to the limit, 0 beyond twice it. Sets
without such a mark, 99 of 100 where errors are normal, keep weights of exactly 1, so that nothing is lost on them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotRegister, MarkError
from planish.register.models import Model, Parametric
from planish.register.pairs import COINCIDENT, Pairs, inverse_of
from planish.register.smoothing import LEAST, Smoothing
from planish.register.solve import standardised

Floats = NDArray[np.float64]

CHANCE = 0.01
_ROUNDS = 40


def limit_squared(count: int, freedom: float, chance: float = CHANCE) -> float:
    """Squared length, in variances of a coordinate, that the largest of ``count`` errors exceeds by ``chance``.

    The variance is known from ``freedom`` degrees of freedom. Half the square follows F with 2 and ``freedom`` degrees,
    whose tail is ``(1 + square / freedom) ** (-freedom / 2)``.
    """
    return freedom * ((chance / count) ** (-2.0 / freedom) - 1.0)


def flat_biweight(squares: Floats, limit: float) -> Floats:
    """Weight of errors whose squared length is given: 1 up to the limit, 0 from twice the limit on."""
    beyond = np.clip(np.sqrt(squares / limit) - 1.0, 0.0, 1.0)
    return (1.0 - beyond**2) ** 2


def robust_weights(pairs: Pairs, model: Model, mirrored: bool) -> Floats:
    """Weights between 0 and 1 for pairs that all count, shape (n,).

    With fewer than 4 degrees of freedom nobody can say which mark is wrong: all 1.
    """
    n = len(pairs)
    if 2 * n - model.parameters < 4:
        return np.ones(n)
    _, size = pairs.frame()
    floor = float(np.median(pairs.weights)) * (COINCIDENT * size) ** 2
    transform = _majority(pairs, model, mirrored)
    errors = _squares(pairs, transform)
    least = max(model.least + 1, (n + model.least + 1) // 2)
    core = np.zeros(n, dtype=np.bool_)
    core[np.argsort(errors, kind="stable")[:least]] = True
    limit, squares = np.inf, errors
    for _ in range(_ROUNDS):
        try:
            transform = model.fit(pairs.take(core), mirrored, transform)
        except (CannotRegister, MarkError):
            return np.ones(n)
        held = int(np.count_nonzero(core))
        freedom = 2.0 * held - model.parameters
        variance = float(np.sum(_squares(pairs.take(core), transform))) / freedom
        variance = max(variance / _kept(held / n), floor)
        squares = standardised(pairs, transform, model, core)
        limit = variance * limit_squared(n, freedom)
        grown = core | (squares <= limit)
        if np.array_equal(grown, core):
            break
        core = grown
    return flat_biweight(np.where(core, 0.0, squares), limit)


def _kept(share: float) -> float:
    """Mean square of the smallest ``share`` of errors in a plane, over that of all."""
    if share >= 1.0:
        return 1.0
    return 1.0 + (1.0 - share) * float(np.log(1.0 - share)) / share


def _squares(pairs: Pairs, transform: Parametric) -> Floats:
    error = pairs.whitening() @ (pairs.fixed - transform(pairs.moving))[..., None]
    return np.sum(error[..., 0] ** 2, axis=1)


def _majority(pairs: Pairs, model: Model, mirrored: bool) -> Parametric:
    """The fit with the least sum of distances, nearly: least squares with weights of one over the distance."""
    transform = model.fit(pairs, mirrored)
    _, size = pairs.frame()
    floor = COINCIDENT * size * float(np.sqrt(np.median(pairs.weights)))
    last = np.full(len(pairs), np.inf)
    for _ in range(_ROUNDS):
        away = np.sqrt(_squares(pairs, transform))
        if np.abs(away - last).max() < 0.02 * float(np.median(away)) + floor:
            break
        last = away
        away = np.maximum(away, 1e-3 * float(np.median(away)) + floor)
        try:
            transform = model.fit(pairs.times(float(np.median(away)) / away), mirrored, transform)
        except (CannotRegister, MarkError):
            break
    return transform


def robust_spline_weights(pairs: Pairs) -> Floats:
    """Weights 0 or 1 for the marks of a thin-plate spline, shape (n,): at most a quarter is left out.

    The mark that the spline of the others misses most, over what it is expected to miss it, is left out as long as that
    exceeds the limit; smoothing is chosen anew each time. A lone mark on a sharp local bend looks like a wrong one.
    """
    n = len(pairs)
    keep = np.ones(n, dtype=np.bool_)
    floor = float(np.median(pairs.weights)) * (COINCIDENT * pairs.frame()[1]) ** 2
    while np.count_nonzero(keep) > max(LEAST + 1, (3 * n + 3) // 4):
        system = Smoothing(pairs.take(keep))
        smoothing = system.choose()
        share = system.left_over(smoothing)
        errors, covariance = system.missed(smoothing)
        squares = np.nan_to_num(np.sum(errors[..., None] * (inverse_of(covariance) @ errors[..., None]), axis=(1, 2)))
        total, freedom = float(np.sum(share * system.z**2)), system.freedom - 2
        worst = int(np.argmax(squares))
        others = max((total - squares[worst]) / freedom, floor)
        if squares[worst] <= others * limit_squared(n, freedom):
            break
        keep[np.flatnonzero(keep)[worst]] = False
    return keep.astype(np.float64)
