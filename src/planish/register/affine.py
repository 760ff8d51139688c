"""Affine transformation: rotation, shift, and another scale in every direction."""

from __future__ import annotations

from typing import Any

import numpy as np

from planish.core.transform import Affine
from planish.register.model import Floats, Frame, ParametricModel, refuse_line, solved
from planish.register.pairs import Pairs


class AffineModel(ParametricModel):
    """Rotation, shift, and another scale in every direction: humidity, embedding, a camera's pixel aspect."""

    name, words = "affine", "affine"
    purpose = "other strain in machine and cross direction (humidity, embedding: 0.1-0.5 %), pixel aspect"
    transform = Affine
    parameters, least, tried_from, linear = 6, 3, 5, True

    def fit(self, pairs: Pairs, _mirrored: bool, _start: Any = None, /) -> Affine:
        """Linear least squares."""
        middle, size = pairs.frame()
        refuse_line(pairs, self.name)
        target = pairs.weights @ pairs.fixed / np.sum(pairs.weights)
        design = _affine_columns((pairs.moving - middle) / size)
        x, y, xx, xy, yx, yy = solved(pairs.whitening(), design, pairs.fixed - target, self.name)
        return Affine(
            linear=((float(xx / size), float(xy / size)), (float(yx / size), float(yy / size))),
            source=(float(middle[0]), float(middle[1])),
            target=(float(target[0] + x), float(target[1] + y)),
        )

    def design(self, _transform: Affine, frame: Frame, points: Floats, /) -> Floats:
        """Shift in x and y, then the linear part row by row."""
        return _affine_columns((points - frame[0]) / frame[1])


def _affine_columns(at: Floats) -> Floats:
    design = np.zeros((*at.shape[:-1], 2, 6))
    design[..., 0, 0] = design[..., 1, 1] = 1.0
    design[..., 0, 2:4] = design[..., 1, 4:6] = at
    return design
