"""The base of all registration models: the fit to marks, and the error at marks that are left out.

Models of a fixed number of parameters share everything but the fit itself and the derivatives by the parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Any, ClassVar

import numpy as np

from planish.core.errors import CannotRegister, MarkError
from planish.core.transform import Transform
from planish.core.typing import Floats
from planish.register.field import DeviationField
from planish.register.pairs import COINCIDENT, Pairs, inverse_of

Frame = tuple[Floats, float]


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
    """

    name: ClassVar[str]
    words: ClassVar[str]
    purpose: ClassVar[str]
    transform: ClassVar[type[Any]]
    parameters: ClassVar[int]
    least: ClassVar[int]

    @abstractmethod
    def fit(self, pairs: Pairs, mirrored: bool, /) -> Any:
        """Weighted least squares."""

    def refit(self, pairs: Pairs, transform: Any, _field: DeviationField, /) -> Any:
        """Fit pairs that were moved, with all else that the first fit found: its transformation and its field."""
        return self.fit(pairs, transform.mirrored)

    @abstractmethod
    def left_out(self, pairs: Pairs, transform: Any, field: DeviationField, /) -> Floats:
        """Vector by which the fit to all other marks misses each mark, (n, 2) in um; NaN where they fix nothing.

        Weights and smoothing stay as they are.
        """


class ParametricModel(Model):
    """A transformation with a fixed number of parameters."""

    # True where the image is linear in the parameters: leave-one-out errors then follow from the leverages.
    linear: ClassVar[bool] = False

    @abstractmethod
    def design(self, transform: Any, frame: Frame, points: Floats, /) -> Floats:
        """Derivatives of the image of points (..., 2) by the parameters, which the frame scales: (..., 2, p)."""

    def left_out(self, pairs: Pairs, transform: Transform, _field: DeviationField, /) -> Floats:
        """``(I - H)**-1 e`` with the mark's 2 x 2 block of the hat matrix for linear models; refits otherwise."""
        if len(pairs) <= self.least:
            return np.full((len(pairs), 2), np.nan)
        if not self.linear:
            missed, numbers = np.full((len(pairs), 2), np.nan), np.arange(len(pairs))
            for k in numbers:
                with suppress(CannotRegister, MarkError):
                    without = self.fit(pairs.take(numbers != k), transform.mirrored)
                    missed[k] = pairs.fixed[k] - without(pairs.moving[k])
            return missed
        whitening = pairs.whitening()
        q, _ = whitened_qr(whitening, self.design(transform, pairs.frame(), pairs.moving), self.name)
        blocks = q.reshape(len(pairs), 2, -1)
        residual_blocks = np.eye(2) - blocks @ blocks.swapaxes(1, 2)
        # Leverage 1: without this mark the others leave a parameter free.
        lonely = np.linalg.eigvalsh(residual_blocks)[:, 0] < COINCIDENT
        residual_blocks[lonely] = np.nan
        error = whitening @ (pairs.fixed - transform(pairs.moving))[..., None]
        return np.asarray(np.linalg.solve(whitening, inverse_of(residual_blocks) @ error)[..., 0], dtype=np.float64)


def least_squares(whitening: Floats, design: Floats, target: Floats, name: str) -> Floats:
    """Weighted least squares by QR: parameters (p,) from design (n, 2, p) and target (n, 2).

    Raises
    ------
    CannotRegister
        If the marks leave a parameter free.
    """
    q, r = whitened_qr(whitening, design, name)
    return np.asarray(np.linalg.solve(r, q.T @ (whitening @ target[..., None]).reshape(-1)), dtype=np.float64)


def whitened_qr(whitening: Floats, design: Floats, name: str) -> tuple[Floats, Floats]:
    """Return the QR factors of the whitened design, (2n, p) and (p, p); refuse equations that leave something free."""
    rows = (whitening @ design).reshape(-1, design.shape[-1])
    q, r = np.linalg.qr(rows)
    sizes = np.linalg.svd(r / np.maximum(np.linalg.norm(r, axis=0), 1e-300), compute_uv=False)
    # Condition number of the scaled equations beyond which marks do not fix the parameters.
    if len(rows) < design.shape[-1] or not sizes[-1] > 1e-8 * sizes[0]:
        raise CannotRegister(
            f"The marks do not fix one {name} transformation: at least one parameter stays free. Add marks away from "
            "the lines that the others lie on, or choose a model with fewer parameters."
        )
    return q, r


def refuse_line(pairs: Pairs, name: str) -> None:
    """Refuse marks that lie on one line."""
    share = pairs.share
    for side, points in (("moving", pairs.moving), ("fixed", pairs.fixed)):
        away = np.sqrt(share)[:, None] * (points - share @ points)
        long, across = np.linalg.svd(away, compute_uv=False)[:2]
        # Marks whose spread across a line is below this share of that along it fix nothing across it.
        if across < 0.01 * long:
            raise CannotRegister(
                f"The {side} marks lie on one line (spread {long:.4g} um rms along it, {across:.2g} um across); a "
                f"model of type {name} needs marks away from it. Add some, or fit a similarity."
            )
