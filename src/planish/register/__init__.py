"""Marks of two maps -> which belong together, the transformation between them, and how far it may be off."""

from planish.register.fit import FittedTransform, Model, fit_transform
from planish.register.match import Matched, match_marks

__all__ = ["FittedTransform", "Matched", "Model", "fit_transform", "match_marks"]
