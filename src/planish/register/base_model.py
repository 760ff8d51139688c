"""The base of all registration models: the fit to marks, and the error at marks that are left out.

Models of a fixed number of parameters share everything but the fit itself and the derivatives by
the parameters.
"""

from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Any, ClassVar

import numpy as np

from planish.core.errors import CannotRegister, MarkError
from planish.core.transform import Transform
from planish.core.typing import Floats
from planish.register.field import DeviationField
from planish.register.pairs import COINCIDENT, Pairs, inverse_of, solved

Frame = tuple[Floats, float]  # of `Pairs.frame`: middle (2,) and size of the moving marks, in um


class Model(ABC):
    """A kind of transformation.

    A new one is a subclass and an entry in :mod:`planish.register.models`.
    """

    name: ClassVar[str]  # in options and files
    words: ClassVar[str]  # in tables and on the page
    # Dataclass of the transformation: its fields are what is written to JSON.
    transform: ClassVar[type[Any]]
    least: ClassVar[int]  # pairs that fix it

    @abstractmethod
    def fit(self, pairs: Pairs, mirrored: bool, /) -> Any:
        """Weighted least squares."""

    def refit(self, pairs: Pairs, transform: Any, _field: DeviationField, /) -> Any:
        """Fit moved pairs with the first fit's transformation and field."""
        return self.fit(pairs, transform.mirrored)

    @abstractmethod
    def left_out(self, pairs: Pairs, transform: Any, field: DeviationField, /) -> Floats:
        """Vector by which the fit to all other marks misses each mark, (n, 2) in um.

        NaN where they fix nothing.

        Weights and smoothing stay as they are.
        """


class ParametricModel(Model):
    """A transformation with a fixed number of parameters."""

    # True where the image is linear in the parameters: leave-one-out errors then follow from the
    # leverages.
    linear: ClassVar[bool] = False

    @abstractmethod
    def design(self, transform: Any, frame: Frame, points: Floats, /) -> Floats:
        """Derivatives of the image of points (..., 2) by the parameters: (..., 2, p).

        The frame scales the parameters.
        """

    def left_out(self, pairs: Pairs, transform: Transform, _field: DeviationField, /) -> Floats:
        """``(I - H)**-1 e`` with the mark's 2 x 2 block of the hat matrix for linear models.

        Refits otherwise.
        """
        if len(pairs) <= self.least:
            return np.full((len(pairs), 2), np.nan)
        if not self.linear:
            errors = np.full((len(pairs), 2), np.nan)
            rows = np.arange(len(pairs))
            for k in rows:
                with suppress(CannotRegister, MarkError):
                    reduced_fit = self.fit(pairs.take(rows != k), transform.mirrored)
                    errors[k] = pairs.fixed[k] - reduced_fit(pairs.moving[k])
            return errors
        whitening = pairs.whitening()
        design = self.design(transform, pairs.frame(), pairs.moving)
        q, _ = whitened_qr(whitening, design, self.name)
        blocks = q.reshape(len(pairs), 2, -1)
        residual_blocks = np.eye(2) - blocks @ blocks.swapaxes(1, 2)
        # Leverage 1: without this mark the others leave a parameter free.
        least_eigenvalues, _ = np.linalg.eigvalsh(residual_blocks).T
        residual_blocks[least_eigenvalues < COINCIDENT] = np.nan
        residuals = pairs.fixed - transform(pairs.moving)
        whitened_residuals = whitening @ residuals[..., None]
        whitened_errors = inverse_of(residual_blocks) @ whitened_residuals
        return solved(whitening, whitened_errors[..., 0])


def least_squares(whitening: Floats, design: Floats, target: Floats, name: str) -> Floats:
    """Parameters (p,) by weighted QR from design (n, 2, p), target (n, 2).

    ``whitening`` (n, 2, 2) is that of the pairs, ``name`` that of the model, for messages.
    CannotRegister if marks leave one free.
    """
    q, r = whitened_qr(whitening, design, name)
    whitened_target = whitening @ target[..., None]
    return solved(r, q.T @ whitened_target.ravel())


def whitened_qr(whitening: Floats, design: Floats, name: str) -> tuple[Floats, Floats]:
    """Return the QR factors of the whitened design, (2n, p) and (p, p).

    Refuse equations that leave something free.
    """
    parameter_count = design.shape[-1]
    equations = (whitening @ design).reshape(-1, parameter_count)
    q, r = np.linalg.qr(equations)
    lengths = np.linalg.norm(r, axis=0)
    scaled_r = r / np.maximum(lengths, 1e-300)
    largest, *_, least = np.linalg.svd(scaled_r, compute_uv=False)
    # Condition number of the scaled equations beyond which marks do not fix the parameters.
    if len(equations) < parameter_count or not least > 1e-8 * largest:
        raise CannotRegister(
            f"The marks do not fix one {name} transformation: at least one parameter stays free."
            " Add marks away from the lines that the others lie on, or choose a model with fewer"
            " parameters."
        )
    return q, r


def refuse_line(pairs: Pairs, name: str) -> None:
    """Refuse marks that lie on one line, on either side."""
    share = pairs.share
    sides = {"moving": pairs.moving, "fixed": pairs.fixed}
    for side, points in sides.items():
        offsets = np.sqrt(share)[:, None] * (points - share @ points)
        long_um, across_um = np.linalg.svd(offsets, compute_uv=False)[:2]
        # Marks whose spread across a line is below this share of that along it fix nothing across
        # it.
        if across_um < 0.01 * long_um:
            raise CannotRegister(
                f"The {side} marks lie on one line (spread {long_um:.4g} um rms along it,"
                f" {across_um:.2g} um across); a model of type {name} needs marks away from it. Add"
                " some, or fit a similarity."
            )
