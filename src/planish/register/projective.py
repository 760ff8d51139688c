"""Projective transformation: the oblique view of a flat sheet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planish.core.errors import CannotRegister
from planish.core.transform import Projective
from planish.core.typing import Floats
from planish.register.model import Frame, ParametricModel, least_squares, refuse_line
from planish.register.pairs import Pairs

_STEPS = 100


class ProjectiveModel(ParametricModel):
    """The oblique view of a flat sheet."""

    name, words = "projective", "projective"
    purpose = "camera oblique to the sheet"
    transform = Projective
    parameters, least = 8, 4

    def fit(self, pairs: Pairs, _mirrored: bool, /) -> Projective:
        """Normalised direct linear transformation, then Gauss-Newton on the distances in the fixed map."""
        middle, size = pairs.frame()
        refuse_line(pairs, self.name)
        share = pairs.weights / np.sum(pairs.weights)
        target = share @ pairs.fixed
        target_size = float(np.sqrt(share @ np.sum((pairs.fixed - target) ** 2, axis=1)))

        def build(h: Floats) -> Projective:
            rows = (h / h[2, 2]).tolist()
            return Projective(
                homography=(tuple(rows[0]), tuple(rows[1]), tuple(rows[2])),
                source=(float(middle[0]), float(middle[1])), target=(float(target[0]), float(target[1])),
                source_size=size, target_size=target_size,
            )  # fmt: skip

        scaled = (pairs.moving - middle) / size
        transform = build(_direct_linear(scaled, (pairs.fixed - target) / target_size, np.sqrt(share)))
        whitening = pairs.whitening()
        last = np.inf
        for _ in range(_STEPS):
            error = pairs.fixed - transform(pairs.moving)
            if not np.isfinite(error).all():
                raise CannotRegister(
                    "The projective transformation puts some marks behind the camera: the pairs do not show one flat "
                    "sheet. Check the pairs, or fit an affine transformation."
                )
            step = least_squares(whitening, self.design(transform, (middle, size), pairs.moving), error, self.name)
            transform = _take_step(transform, step, pairs, whitening, build)
            length = float(np.abs(step).max())
            # The last digits do not settle: steps of rounding are as long as the one before.
            if length < 1e-15 or (length < 1e-9 and length >= 0.5 * last):
                break
            last = length
        return transform

    def design(self, transform: Projective, _frame: Frame, points: Floats, /) -> Floats:
        """The first eight numbers of the 3 x 3 matrix, whose last one is 1."""
        h = np.array(transform.homography)
        scaled = (points - transform.source) / transform.source_size
        below = (scaled @ h[2, :2] + h[2, 2])[..., None]
        image = (scaled @ h[:2, :2].T + h[:2, 2]) / below
        rows = np.concatenate([scaled, np.ones_like(below)], axis=-1) / below
        design = np.zeros((*points.shape[:-1], 2, 8))
        design[..., 0, 0:3] = rows
        design[..., 1, 3:6] = rows
        design[..., :, 6:8] = -image[..., :, None] * (scaled / below)[..., None, :]
        return transform.target_size * design


def _direct_linear(moving: Floats, fixed: Floats, root: Floats) -> Floats:
    """Homography (3, 3) with the least algebraic error, from points scaled to size 1."""
    homogeneous = np.concatenate([moving, np.ones((len(moving), 1))], axis=1)
    rows = np.zeros((len(moving), 2, 9))
    rows[:, 0, 0:3] = rows[:, 1, 3:6] = homogeneous
    rows[:, :, 6:9] = -fixed[:, :, None] * homogeneous[:, None, :]
    _, sizes, right = np.linalg.svd((root[:, None, None] * rows).reshape(-1, 9), full_matrices=len(moving) < 5)
    h = right[-1].reshape(3, 3)
    below = homogeneous @ h[2]
    if sizes[7] < 1e-7 * sizes[0] or abs(h[2, 2]) < 1e-6 or not (np.all(below > 0) or np.all(below < 0)):
        raise CannotRegister(
            "The marks do not fix one projective transformation: too many lie on one line, or the pairs do not show "
            "one flat sheet. Check the pairs, add marks away from that line, or fit an affine transformation."
        )
    return h


def _take_step(
    transform: Projective, step: Floats, pairs: Pairs, whitening: Floats, build: Callable[[Floats], Projective]
) -> Projective:
    """Take a Gauss-Newton step, shortened until the error does not rise."""

    def cost(trial: Projective) -> float:
        error = whitening @ (pairs.fixed - trial(pairs.moving))[..., None]
        return float(np.sum(error**2))

    before = cost(transform)
    h = np.array(transform.homography)
    for halvings in range(12):
        trial = build(h + np.append(step / 2**halvings, 0.0).reshape(3, 3))
        after = cost(trial)
        if np.isfinite(after) and after <= before * (1 + 1e-9) + 1e-300:
            return trial
    return transform
