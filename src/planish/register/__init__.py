"""Marks of two maps -> which belong together, the transformation between them, and how far it may be off."""

from planish.register.chain import Chain
from planish.register.fit import Model, fit_transform
from planish.register.match import Matched, match_marks
from planish.register.match_design import MatchedByDesign, MatchedToDesign, match_by_design, match_to_design
from planish.register.refine import Refined, refine
from planish.register.result import FittedSimilarity, FittedTransform
from planish.register.strain import Transform

__all__ = [
    "Chain",
    "FittedSimilarity",
    "FittedTransform",
    "Matched",
    "MatchedByDesign",
    "MatchedToDesign",
    "Model",
    "Refined",
    "Transform",
    "fit_transform",
    "match_by_design",
    "match_marks",
    "match_to_design",
    "refine",
]
