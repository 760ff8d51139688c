"""The local strain of a transformation from place to place, and its folds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planish.core.errors import CannotRegister
from planish.core.transform import Affine, Similarity, Transform
from planish.core.typing import Floats

# Local strain from which on a fit warns.
NOTABLE = 0.01
_GRID = 65


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalStrain:
    """Local strain between the marks, after the overall scale is taken off."""

    area: tuple[float, float]  # least and largest ratio of local areas to their mean
    # Least and largest principal strain: 0.01 where a length is 1 % longer than the overall scale makes it.
    stretch: tuple[float, float]
    at_um: tuple[float, float]  # where in the moving map the strain is largest, as (x, y) in um

    @property
    def largest(self) -> float:
        """Largest strain without its sign."""
        return max(abs(self.stretch[0]), abs(self.stretch[1]))


def strain_of(transform: Transform, marks: Floats, mirrored: bool) -> LocalStrain:
    """Strain inside the hull of the marks, looked at on a grid of 65 x 65 over their extent and at the marks.

    Raises
    ------
    CannotRegister
        Where the map folds, or changes its handedness against what was declared.
    """
    middle = marks.mean(axis=0)
    middle_um = (float(middle[0]), float(middle[1]))
    if isinstance(transform, Similarity):
        return LocalStrain(area=(1.0, 1.0), stretch=(0.0, 0.0), at_um=middle_um)
    points = marks[:1] if isinstance(transform, Affine) else inside(marks)
    derivatives = transform.jacobian(points)
    sign = -1.0 if mirrored else 1.0
    areas = sign * (
        derivatives[:, 0, 0] * derivatives[:, 1, 1] - derivatives[:, 0, 1] * derivatives[:, 1, 0]
    )  # fmt: skip
    worst = int(np.argmin(np.where(np.isfinite(areas), areas, -np.inf)))
    if not areas[worst] > 0:
        if isinstance(transform, Affine):
            raise CannotRegister(
                "The fitted affine transformation reverses the handedness against what was declared: many pairs are "
                "probably wrong. Check that every row pairs the same hole on both sides."
            )
        x, y = points[worst]
        raise CannotRegister(
            f"The fitted transformation folds the map near ({x:.5g}, {y:.5g}) um of the moving map, between the marks. "
            "Check the pairs around that place; if they are right, fit a model with fewer parameters."
        )
    mean = float(np.mean(areas))
    stretches = np.linalg.svd(derivatives, compute_uv=False) / np.sqrt(mean) - 1.0
    where = points[int(np.argmax(np.abs(stretches).max(axis=1)))] if len(points) > 1 else middle
    return LocalStrain(
        area=(float(areas.min() / mean), float(areas.max() / mean)),
        stretch=(float(stretches.min()), float(stretches.max())),
        at_um=(float(where[0]), float(where[1])),
    )


def inside(marks: Floats, steps: int = _GRID) -> Floats:
    """The marks, and points of a grid of ``steps x steps`` over their extent that lie in their hull: (k, 2) in um."""
    from scipy.spatial import Delaunay, QhullError

    axes = [np.linspace(a, b, steps) for a, b in zip(marks.min(axis=0), marks.max(axis=0), strict=True)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    middle = marks.mean(axis=0)
    try:
        hull = Delaunay(marks - middle)
    except QhullError:  # all on a line, or fewer than three
        return marks
    return np.concatenate([marks, grid[hull.find_simplex(grid - middle) >= 0]])
