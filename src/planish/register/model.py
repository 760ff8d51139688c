"""What a registration model is: how it is fitted to marks, which marks it doubts, and what errors it expects.

Models of a fixed number of parameters share everything but the fit itself and the derivatives by the parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotRegister, MarkError
from planish.core.transform import Transform
from planish.register.pairs import COINCIDENT, Pairs, inverse_of

Floats = NDArray[np.float64]
Frame = tuple[Floats, float]

# Marks whose spread across a line is below this share of that along it fix nothing across it.
_LINE = 0.01
# Condition number of the scaled equations beyond which marks do not fix the parameters.
_RANK = 1e-8
# The furthest of n right marks is taken for a wrong one in this share of sets of marks.
_CHANCE = 0.01
_ROUNDS = 40


class Model(ABC):
    """A kind of transformation. A new one is a subclass and an entry in :mod:`planish.register.models`.

    Attributes
    ----------
    name : str
        In options and files.
    words : str
        In tables and on the page.
    purpose : str
        When to take it.
    transform : type
        Dataclass of the transformation: its fields are what is written to JSON.
    parameters : int
        Free ones.
    least : int
        Pairs that fix it.
    tried_from : int
        Pairs from which on ``auto`` tries it.
    """

    name: ClassVar[str]
    words: ClassVar[str]
    purpose: ClassVar[str]
    transform: ClassVar[type[Any]]
    parameters: ClassVar[int]
    least: ClassVar[int]
    tried_from: ClassVar[int]
    settles_weights: ClassVar[bool] = True
    """Whether ``auto`` may settle the weights of all marks under it."""

    @abstractmethod
    def fit(self, pairs: Pairs, mirrored: bool, /) -> Any:
        """Weighted least squares."""

    def refit(self, pairs: Pairs, transform: Any, _errors: Any, /) -> Any:
        """Fit pairs that were moved, with all that was found from the first fit: its transformation and its errors."""
        return self.fit(pairs, transform.mirrored)

    @abstractmethod
    def errors(self, pairs: Pairs, transform: Any, robust: Floats, /) -> Any:
        """Errors of a fit, with the methods and attributes of :class:`ParametricErrors`.

        ``robust`` (n,) is the part of the weights that does not reflect a mark's variance.
        """

    @abstractmethod
    def robust_weights(self, pairs: Pairs, mirrored: bool, /) -> Floats:
        """Weights between 0 and 1 for pairs that all count, shape (n,): below 1 for marks that are in doubt."""


class ParametricModel(Model):
    """A transformation with a fixed number of parameters."""

    linear: ClassVar[bool] = False
    """Whether the image is linear in the parameters: leave-one-out errors then follow from the leverages."""

    @abstractmethod
    def design(self, transform: Any, frame: Frame, points: Floats, /) -> Floats:
        """Derivatives of the image of points (..., 2) by the parameters, which the frame scales: (..., 2, p)."""

    def errors(self, pairs: Pairs, transform: Transform, robust: Floats, /) -> ParametricErrors:
        """Errors that follow from residuals and derivatives."""
        return ParametricErrors(self, pairs, transform, robust)

    def robust_weights(self, pairs: Pairs, mirrored: bool, /) -> Floats:
        """A core of marks that agree grows as long as chance explains the nearest mark outside.

        The core begins with a fit that holds the majority (least sum of distances). What is outside at the end is
        weighted down by a flat-topped biweight: 1 up to the limit, 0 beyond twice it. 99 of 100 sets of right marks
        keep weights of exactly 1. With fewer than 4 degrees of freedom a wrong mark cannot be identified: all 1.
        """
        n = len(pairs)
        if 2 * n - self.parameters < 4:
            return np.ones(n)
        _, size = pairs.frame()
        floor = float(np.median(pairs.weights)) * (COINCIDENT * size) ** 2
        transform = self._majority(pairs, mirrored)
        errors = _squares(pairs, transform)
        least = max(self.least + 1, (n + self.least + 1) // 2)
        core = np.zeros(n, dtype=np.bool_)
        core[np.argsort(errors, kind="stable")[:least]] = True
        limit, squares = np.inf, errors
        for _ in range(_ROUNDS):
            try:
                transform = self.fit(pairs.take(core), mirrored)
            except (CannotRegister, MarkError):
                return np.ones(n)
            held = int(np.count_nonzero(core))
            freedom = 2.0 * held - self.parameters
            variance = float(np.sum(_squares(pairs.take(core), transform))) / freedom
            variance = max(variance / _kept(held / n), floor)
            squares = self._standardised(pairs, transform, core)
            limit = variance * limit_squared(n, freedom)
            grown = core | (squares <= limit)
            if np.array_equal(grown, core):
                break
            core = grown
        beyond = np.clip(np.sqrt(np.where(core, 0.0, squares) / limit) - 1.0, 0.0, 1.0)
        return (1.0 - beyond**2) ** 2

    def _majority(self, pairs: Pairs, mirrored: bool) -> Transform:
        """The fit with nearly the least sum of distances: least squares with weights of one over the distance."""
        transform = self.fit(pairs, mirrored)
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
                transform = self.fit(pairs.times(float(np.median(away)) / away), mirrored)
            except (CannotRegister, MarkError):
                break
        return transform

    def _standardised(self, pairs: Pairs, transform: Transform, core: NDArray[np.bool_]) -> Floats:
        """Squared length of each mark's error over its expectation for variance 1: 2 on average; shape (n,).

        Errors of marks in the core, to which the transformation was fitted, are too small by ``1 - H``, those of the
        others too large by ``1 + H``.
        """
        whitening = pairs.whitening()
        rows = whitening @ self.design(transform, pairs.take(core).frame(), pairs.moving)
        _, r = np.linalg.qr(rows[core].reshape(-1, self.parameters))
        blocks = np.linalg.solve(r.T, rows.reshape(-1, self.parameters).T).T.reshape(len(pairs), 2, -1)
        hat = blocks @ blocks.swapaxes(1, 2)
        spread = np.eye(2) + np.where(core, -1.0, 1.0)[:, None, None] * hat
        error = whitening @ (pairs.fixed - transform(pairs.moving))[..., None]
        bound = np.linalg.eigvalsh(spread)[:, 0] < 1e-9
        spread[bound] = np.eye(2)
        # A mark that the fit goes through whatever its error is no evidence.
        return np.where(bound, 0.0, (error.swapaxes(1, 2) @ inverse_of(spread) @ error)[:, 0, 0])


class ParametricErrors:
    """Errors of a model with a fixed number of parameters.

    Attributes
    ----------
    mark_variance : float
        Variance of one coordinate of a pair with information 1, in um**2; NaN where no residual is left.

    Notes
    -----
    A mark in doubt was weighted down without being less precise: the covariance of the parameters is ``A**-1 B A**-1``
    with ``A = sum(r D' W D)`` and ``B = sum(r**2 D' W D)``; without doubt ``A**-1``. Degrees of freedom:
    ``2 sum(r) - p``.
    """

    def __init__(self, model: ParametricModel, pairs: Pairs, transform: Transform, robust: Floats) -> None:
        used = pairs.weights > 0
        some, share = pairs.take(used), robust[used]
        self._model, self._pairs, self._transform, self._used = model, pairs, transform, used
        self._frame = some.frame()
        whitening = some.whitening()
        q, r = factored(whitening, model.design(transform, self._frame, some.moving), model.name)
        self._squares = float(np.sum((whitening @ (some.fixed - transform(some.moving))[..., None]) ** 2))
        self._freedom = 2.0 * float(np.sum(share)) - model.parameters
        enough = self._freedom > 1e-9 and np.count_nonzero(used) > 2
        self.mark_variance = self._squares / self._freedom if enough else float("nan")
        half = np.linalg.solve(r, (np.sqrt(np.repeat(share, 2))[:, None] * q).T)
        self._covariance = self.mark_variance * (half @ half.T)

    def residual_freedom(self) -> tuple[float, float]:
        """Sum of squares of the whitened residuals, and its degrees of freedom."""
        return self._squares, self._freedom

    def left_out(self) -> Floats:
        """Vector by which the fit to all other marks misses each mark, (n, 2) in um; NaN where they fix nothing.

        ``(I - H)**-1 e`` with the mark's 2 x 2 block of the hat matrix for linear models; refits otherwise. Weights
        stay as they are.
        """
        pairs, used = self._pairs, self._used
        missed = pairs.fixed - self._transform(pairs.moving)
        if np.count_nonzero(used) <= self._model.least:
            missed[used] = np.nan
        else:
            missed[used] = (self._by_leverage if self._model.linear else self._by_refit)(pairs.take(used))
        return missed

    def expected_square(self, points: Floats) -> Floats:
        """Mean square distance between fitted and true image of points (k, 2), in um**2.

        ``trace(J C J')`` with the derivatives J of the image by the parameters and their covariance C.
        """
        design = self._model.design(self._transform, self._frame, points)
        return np.einsum("kap,pq,kaq->k", design, self._covariance, design, optimize=True)

    def _by_leverage(self, pairs: Pairs) -> Floats:
        whitening = pairs.whitening()
        q, _ = factored(whitening, self._model.design(self._transform, pairs.frame(), pairs.moving), self._model.name)
        blocks = q.reshape(len(pairs), 2, -1)
        left = np.eye(2) - blocks @ blocks.swapaxes(1, 2)
        # Leverage 1: without this mark the others leave a parameter free.
        lonely = np.linalg.eigvalsh(left)[:, 0] < COINCIDENT
        left[lonely] = np.nan
        error = whitening @ (pairs.fixed - self._transform(pairs.moving))[..., None]
        return np.asarray(np.linalg.solve(whitening, inverse_of(left) @ error)[..., 0], dtype=np.float64)

    def _by_refit(self, pairs: Pairs) -> Floats:
        missed = np.full((len(pairs), 2), np.nan)
        everyone = np.arange(len(pairs))
        for k in everyone:
            try:
                without = self._model.fit(pairs.take(everyone != k), self._transform.mirrored)
            except (CannotRegister, MarkError):
                continue
            missed[k] = pairs.fixed[k] - without(pairs.moving[k])
        return missed


def limit_squared(count: int, freedom: float) -> float:
    """Squared length, in variances of a coordinate, that the largest of ``count`` errors exceeds once in a hundred.

    The variance is known from ``freedom`` degrees of freedom. Half the square follows F with 2 and ``freedom`` degrees,
    whose tail is ``(1 + square / freedom) ** (-freedom / 2)``.
    """
    return freedom * ((_CHANCE / count) ** (-2.0 / freedom) - 1.0)


def solved(whitening: Floats, design: Floats, target: Floats, name: str) -> Floats:
    """Weighted least squares by QR: parameters (p,) from design (n, 2, p) and target (n, 2).

    Raises
    ------
    CannotRegister
        If the marks leave a parameter free.
    """
    q, r = factored(whitening, design, name)
    found = np.linalg.solve(r, q.T @ (whitening @ target[..., None]).reshape(-1))
    return np.asarray(found, dtype=np.float64)


def factored(whitening: Floats, design: Floats, name: str) -> tuple[Floats, Floats]:
    """Return the QR factors of the whitened design, (2n, p) and (p, p); refuse equations that leave something free."""
    rows = (whitening @ design).reshape(-1, design.shape[-1])
    q, r = np.linalg.qr(rows)
    sizes = np.linalg.svd(r / np.maximum(np.linalg.norm(r, axis=0), 1e-300), compute_uv=False)
    if len(rows) < design.shape[-1] or not sizes[-1] > _RANK * sizes[0]:
        raise CannotRegister(
            f"The marks do not fix one {name} transformation: their arrangement leaves at least one parameter free. "
            "Add marks away from the lines that the others lie on, or choose a model with fewer parameters."
        )
    return q, r


def refuse_line(pairs: Pairs, name: str) -> None:
    """Refuse marks that lie on one line."""
    share = pairs.weights / np.sum(pairs.weights)
    for side, points in (("moving", pairs.moving), ("fixed", pairs.fixed)):
        away = np.sqrt(share)[:, None] * (points - share @ points)
        long, across = np.linalg.svd(away, compute_uv=False)[:2]
        if across < _LINE * long:
            raise CannotRegister(
                f"The {side} marks lie on one line (they spread {long:.4g} um rms along it and {across:.2g} um across "
                f"it); a model of type {name} needs marks away from it. Add some, or fit a similarity."
            )


def _squares(pairs: Pairs, transform: Transform) -> Floats:
    error = pairs.whitening() @ (pairs.fixed - transform(pairs.moving))[..., None]
    return np.sum(error[..., 0] ** 2, axis=1)


def _kept(share: float) -> float:
    """Mean square of the smallest ``share`` of errors in a plane, over that of all."""
    return 1.0 if share >= 1.0 else 1.0 + (1.0 - share) * float(np.log(1.0 - share)) / share
