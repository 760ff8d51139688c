"""The table of registration models, from few to many parameters, and the default.

The default is what the marks make likely.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from planish.core.errors import MarkError
from planish.core.typing import Floats, pair_of
from planish.register.base_model import Model
from planish.register.bent import Bent, Kernel
from planish.register.field import DeviationField, covariance, covariance_slope
from planish.register.pairs import Pairs
from planish.register.similarity import AffineModel, ProjectiveModel, RigidModel, SimilarityModel
from planish.register.spline import SplineModel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Averaged(Bent):
    """An affine map and smooth local changes that end beside the marks.

    Each kernel has coefficients of its own.

    ``U`` is ``exp(-r**2 / 2 l**2)`` for the lengths ``gauss`` and ``(1 + s) exp(-s)``, ``s =
    sqrt(3) r / l``, for ``matern``, in this order.
    """

    everywhere: ClassVar[bool] = True

    bend: Floats  # (gauss + matern, m, 2), in um: coefficients of the kernels
    gauss: Floats  # lengths, scaled
    matern: Floats

    def bends(self) -> Iterator[tuple[Kernel, Kernel, Floats]]:
        """Gaussian and Matern kernels."""
        kernels = [("gauss", length) for length in self.gauss.tolist()]
        kernels += [("matern", length) for length in self.matern.tolist()]
        for kernel, bend in zip(kernels, self.bend, strict=True):
            yield partial(covariance, kernel), partial(covariance_slope, kernel), bend


class AveragedModel(Model):
    """A similarity with smooth deviations, averaged over their sizes and lengths."""

    name, words = "averaged", "similarity with smooth deviations"
    transform = Averaged
    least = 3

    def fit(self, pairs: Pairs, mirrored: bool, /) -> Averaged:
        """The mean of the field of the pairs."""
        return self.of(DeviationField(pairs, mirrored))

    def of(self, field: DeviationField) -> Averaged:
        """The mean of a field."""
        affine, kernels, bend = field.mean()
        # Lengths of either kind; the coefficients are in the same order, Gaussian ones first.
        lengths: dict[str, list[float]] = {"gauss": [], "matern": []}
        for name, length in kernels:
            lengths[name].append(length)
        return Averaged(
            source=pair_of(field.middle),
            size=field.size,
            nodes=field.nodes,
            affine=affine + 0.0,  # no negative zero
            bend=bend + 0.0,
            gauss=np.array(lengths["gauss"]),
            matern=np.array(lengths["matern"]),
        )

    def refit(self, pairs: Pairs, _transform: Averaged, field: DeviationField, /) -> Averaged:
        """The mean with the same probabilities of all sizes and lengths."""
        return self.of(DeviationField(pairs, field.mirrored, field.mixture))

    def left_out(self, _pairs: Pairs, _transform: Averaged, field: DeviationField, /) -> Floats:
        """Errors at the same probabilities."""
        return field.left_out()[0]


_MODELS = (
    RigidModel(),
    SimilarityModel(),
    AffineModel(),
    ProjectiveModel(),
    SplineModel(),
    AveragedModel(),
)
MODELS: dict[str, Model] = {model.name: model for model in _MODELS}


def model_named(name: str) -> Model:
    """Return a model by its name; MarkError if there is none of that name."""
    if name not in MODELS:
        raise MarkError(f"The model is {name!r}; it has to be one of {', '.join(MODELS)} or auto.")
    return MODELS[name]
