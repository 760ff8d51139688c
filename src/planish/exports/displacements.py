"""A registration as other programs take it: an affine map, and what is left of it as a field on a grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.core.grid import Grid
from planish.core.transform import Affine

Array = NDArray[np.float64]

_AROUND = 0.1  # of the layer's longer side: the field reaches so far beyond it
_COARSEST = 64  # pixels of the layer between nodes of a field
_WRONG = 1 / 400  # of a pixel: what a field may err by in the middle between nodes
_MOST = 2_000_000  # nodes
_CORNERS = [(rows, cols) for rows in (slice(None, -1), slice(1, None)) for cols in (slice(None, -1), slice(1, None))]


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectedTransform:
    """A transformation from one layer to another.

    Attributes
    ----------
    source, target : str
        Names of the layers.
    function : callable
        Takes points (..., 2), (x, y) in um, of the source to the target; NaN where it has none.
    grid : Grid
        Pixels of the source.
    affine : Affine
        The affine map that is closest at the middle of the marks.
    exact : bool
        Whether the affine map is all of it.
    """

    source: str
    target: str
    function: Callable[[Array], Array]
    grid: Grid
    affine: Affine
    exact: bool

    @property
    def name(self) -> str:
        """Name of its files: ``sheet_to_image``."""
        return f"{self.source}_to_{self.target}"


@dataclass(frozen=True, slots=True, kw_only=True)
class TransformPair:
    """A registration in both directions, and its model."""

    forward: DirectedTransform
    back: DirectedTransform
    model: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DisplacementField:
    """Displacements on a regular grid, between whose nodes they are linear.

    Attributes
    ----------
    vectors : (rows, cols, 2)
        Displacement along x and y in um.
    origin_um, pitch_um : (float, float)
        Place of the first node and distance of nodes, (x, y).
    error_um : float
        Largest error in the middle of a cell, over the source layer.
    filled : int
        Nodes at which the transformation has no value, so that the affine map stands there.
    """

    vectors: Array
    origin_um: tuple[float, float]
    pitch_um: tuple[float, float]
    error_um: float
    filled: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of nodes."""
        return self.vectors.shape[0], self.vectors.shape[1]

    def facts(self) -> dict[str, float]:
        """Errors of the field, for the history."""
        return {"largest_error_um": float(f"{self.error_um:.3g}"), "nodes_by_affine_map": self.filled}

    @property
    def y_um(self) -> Array:
        """Rows."""
        return self.origin_um[1] + self.pitch_um[1] * np.arange(self.shape[0], dtype=np.float64)

    @property
    def x_um(self) -> Array:
        """Columns."""
        return self.origin_um[0] + self.pitch_um[0] * np.arange(self.shape[1], dtype=np.float64)


def displacement(transform: DirectedTransform) -> DisplacementField:
    """Sample what has to be added to a point of the source to get its image, over the source and a tenth around it."""
    return _sampled(transform, lambda points: points, np.eye(2))


def before_affine(transform: DirectedTransform) -> DisplacementField:
    """Sample what has to be added to a point of the source before the affine map is applied.

    Beside the field, where programs take 0, the affine map holds alone.
    """
    return _sampled(transform, transform.affine, transform.affine.inverse.matrix())


def _sampled(transform: DirectedTransform, near: Callable[[Array], Array], factor: Array) -> DisplacementField:
    """Sample ``factor @ (function - near)`` as coarsely as it may be."""
    grid = transform.grid
    down, across = grid.pixel_um
    (x0, y0), (rows, cols) = grid.origin_um, grid.shape
    size = np.array([cols * across, rows * down])
    around = _AROUND * float(size.max())
    low = np.array([x0, y0]) - 0.5 * np.array([across, down]) - around
    length = size + 2 * around
    pitch = _COARSEST * float(np.sqrt(down * across))

    def nodes(shift: float, counts: NDArray[np.intp]) -> Array:
        axes = [low[k] + pitch * (np.arange(counts[k] - (shift > 0)) + shift) for k in (0, 1)]
        return np.stack(np.meshgrid(*axes), axis=-1)

    def offsets(points: Array) -> tuple[Array, NDArray[np.bool_]]:
        images = transform.function(points)
        has_image = np.asarray(np.isfinite(images).all(axis=-1))
        images[~has_image] = transform.affine(points[~has_image])
        return images - near(points), has_image

    while True:
        counts = np.ceil(length / pitch).astype(np.intp) + 1
        middles = nodes(0.5, counts)
        vectors, has_image = offsets(nodes(0.0, counts))
        exact, counted = offsets(middles)
        interpolated = np.zeros_like(exact)
        for corner in _CORNERS:
            interpolated += 0.25 * vectors[corner]
            counted &= has_image[corner]
        counted &= ((middles >= low + around) & (middles <= low + length - around)).all(axis=-1)
        errors = np.linalg.norm(interpolated - exact, axis=-1)[counted]
        error = float(errors.max()) if errors.size else 0.0
        # A map that is affine needs no finer grid, however large its pixels are.
        if error <= _WRONG * min(down, across) or 2 * vectors.size > _MOST:
            break
        pitch /= 2
    return DisplacementField(
        vectors=vectors @ factor.T, origin_um=(float(low[0]), float(low[1])), pitch_um=(pitch, pitch), error_um=error,
        filled=int(np.count_nonzero(~has_image)),
    )  # fmt: skip
