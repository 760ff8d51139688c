"""The registration models, from few to many parameters: a new one is a module of its own and an entry here."""

from __future__ import annotations

from planish.core.errors import MarkError
from planish.register.averaged import AveragedModel
from planish.register.model import Model
from planish.register.projective import ProjectiveModel
from planish.register.similarity import AffineModel, RigidModel, SimilarityModel
from planish.register.spline import SplineModel

MODELS: dict[str, Model] = {
    m.name: m
    for m in (RigidModel(), SimilarityModel(), AffineModel(), ProjectiveModel(), SplineModel(), AveragedModel())
}


def model_named(name: str) -> Model:
    """Return a model by its name.

    Raises
    ------
    MarkError
        If there is none of that name.
    """
    if name not in MODELS:
        raise MarkError(f"The model is {name!r}; it has to be one of {', '.join(MODELS)} or auto.")
    return MODELS[name]
