"""The transformations between two maps that a few numbers describe.

They are similarity, affine and projective.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.typing import Bools, Floats, Pair, pair_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Similarity:
    """A map ``p -> scale * R(rotation) * M * p + shift`` of points ``(x, y)`` in um."""

    scale: float = 1.0  # ratio of lengths, target over source; positive
    # Turns the x axis towards the y axis (clockwise on screen, where y runs down).
    rotation_rad: float = 0.0
    shift_um: Pair = (0.0, 0.0)  # ``(x, y)`` of the image of the origin
    mirrored: bool = False  # whether the source's x axis is reversed first (``M = diag(-1, 1)``)

    @property
    def similarity(self) -> Similarity:
        """The transformation itself."""
        return self

    def matrix(self) -> Floats:
        """Return the 2 x 2 linear part."""
        cos = np.cos(self.rotation_rad)
        sin = np.sin(self.rotation_rad)
        flip = -1.0 if self.mirrored else 1.0
        return self.scale * np.array([[cos * flip, -sin], [sin * flip, cos]])

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points of shape ``(..., 2)``, ``(x, y)`` in um; NaN stays NaN."""
        return np.asarray(points, np.float64) @ self.matrix().T + self.shift_um

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)``.

        Shape ``(..., 2, 2)``, a row for x and y of the image.
        """
        return _everywhere(self.matrix(), points)

    @property
    def inverse(self) -> Similarity:
        """The transformation back."""
        linear = np.linalg.inv(self.matrix())
        # The inverse is a similarity of the same handedness; its rotation is that of the y column,
        # which M keeps.
        rotation = float(np.arctan2(-linear[0, 1], linear[1, 1]))
        shift_um = pair_of(-linear @ np.asarray(self.shift_um))
        return replace(self, scale=1.0 / self.scale, rotation_rad=rotation, shift_um=shift_um)


def nearest_similarity(linear: Floats, source: Floats, target: Floats) -> Similarity:
    """Return the similarity that changes areas and turns as a linear map (2, 2) does.

    It takes source to target.
    """
    det = float(np.linalg.det(linear))
    plain = linear
    if det < 0:
        plain = linear @ np.diag([-1.0, 1.0])
    rotation = float(np.arctan2(plain[1, 0] - plain[0, 1], plain[0, 0] + plain[1, 1]))
    turn = Similarity(scale=float(np.sqrt(abs(det))), rotation_rad=rotation, mirrored=det < 0)
    return replace(turn, shift_um=pair_of(target - turn(source)))


class NearSimilarity(ABC):
    """A transformation near a similarity at ``source``, the marks' middle.

    Its scale, rotation, shift and hand are those of the similarity.
    """

    __slots__ = ()
    source: Pair

    @abstractmethod
    def __call__(self, points: ArrayLike, /) -> Floats:
        """Transform points of shape ``(..., 2)``, in um."""

    @abstractmethod
    def jacobian(self, points: ArrayLike, /) -> Floats:
        """Derivatives of the image at points ``(..., 2)``.

        Shape ``(..., 2, 2)``, a row for x and y of the image.
        """

    @property
    @abstractmethod
    def inverse(self) -> Callable[[ArrayLike], Floats]:
        """The transformation back."""

    def matrix(self) -> Floats:
        """Return the 2 x 2 derivatives at the middle of the marks."""
        return self.jacobian(self.source)

    @property
    def similarity(self) -> Similarity:
        """The similarity that is closest at the middle of the marks."""
        middle = np.array(self.source)
        return nearest_similarity(self.matrix(), middle, self(middle))

    @property
    def scale(self) -> float:
        """Ratio of lengths at the middle of the marks: root of the ratio of areas."""
        return self.similarity.scale

    @property
    def rotation_rad(self) -> float:
        """Mean rotation at the middle of the marks, in rad."""
        return self.similarity.rotation_rad

    @property
    def shift_um(self) -> Pair:
        """Image of the origin under the closest similarity, in um."""
        return self.similarity.shift_um

    @property
    def mirrored(self) -> bool:
        """True if the transformation changes handedness."""
        return self.similarity.mirrored


@dataclass(frozen=True, slots=True, kw_only=True)
class Affine(NearSimilarity):
    """A map ``p -> linear @ (p - source) + target`` of points ``(x, y)`` in um."""

    linear: tuple[Pair, Pair]  # the 2 x 2 linear part, row by row
    source: Pair = (0.0, 0.0)  # a point, by custom the middle of the marks
    target: Pair = (0.0, 0.0)  # and its image

    def matrix(self) -> Floats:
        """Return the 2 x 2 linear part."""
        return np.array(self.linear)

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points of shape ``(..., 2)``, in um; NaN stays NaN."""
        offsets = np.asarray(points, np.float64) - self.source
        return offsets @ self.matrix().T + self.target

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)``: ``(..., 2, 2)``."""
        return _everywhere(self.matrix(), points)

    @property
    def inverse(self) -> Affine:
        """The transformation back."""
        (a, b), (c, d) = np.linalg.inv(self.matrix()).tolist()
        return Affine(linear=((a, b), (c, d)), source=self.target, target=self.source)


@dataclass(frozen=True, slots=True, kw_only=True)
class Projective(NearSimilarity):
    """A map that keeps straight lines straight, as the oblique view of a flat sheet does.

    ``(a, b, c) = homography @ (x', y', 1)`` and the image is ``target + target_size * (a / c, b /
    c)``, with ``(x', y') = (p - source) / source_size``. Points from which ``c`` is not positive
    lie behind the camera: NaN. ``homography`` is the 3 x 3 matrix in scaled coordinates, row by
    row; ``source`` and ``target`` are the middle of the marks on either side, in um, and the sizes
    their rms distances from it.
    """

    homography: tuple[
        tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]
    ]
    source: Pair
    target: Pair
    source_size: float
    target_size: float

    def _projected(self, points: ArrayLike) -> tuple[Floats, Floats]:
        """Numerators (..., 2) and denominator (...)."""
        h = np.array(self.homography)
        scaled = (np.asarray(points, np.float64) - self.source) / self.source_size
        denominators = scaled @ h[2, :2] + h[2, 2]
        numerators = scaled @ h[:2, :2].T + h[:2, 2]
        return numerators, np.where(denominators > 0, denominators, np.nan)

    def __call__(self, points: ArrayLike) -> Floats:
        """Transform points of shape ``(..., 2)``, in um.

        NaN stays NaN, and is the image of what lies behind.
        """
        numerators, denominators = self._projected(points)
        return numerators / denominators[..., None] * self.target_size + self.target

    def jacobian(self, points: ArrayLike) -> Floats:
        """Derivatives of the image at points ``(..., 2)``: ``(..., 2, 2)``.

        By the rule for a quotient: of numerator over denominator, less the image's share in the
        denominator's.
        """
        h = np.array(self.homography)
        numerators, denominators = self._projected(points)
        image = numerators / denominators[..., None]
        ratio = self.target_size / self.source_size
        numerator_change = h[:2, :2] - image[..., :, None] * h[2, :2]
        return ratio * numerator_change / denominators[..., None, None]

    @property
    def inverse(self) -> Projective:
        """The transformation back."""
        inverse_matrix = np.linalg.inv(np.array(self.homography))
        # The sign is free; the denominator has to be positive where the marks are.
        a, b, c = np.array(self.homography)[:, 2]
        inverse_matrix *= np.sign(inverse_matrix[2] @ (a / c, b / c, 1.0))
        first, second, third = map(tuple, inverse_matrix.tolist())
        return Projective(
            homography=(first, second, third),
            source=self.target,
            target=self.source,
            source_size=self.target_size,
            target_size=self.source_size,
        )


Transform = Similarity | NearSimilarity  # what every fitted transformation is


def grid_points(x: Floats, y: Floats) -> Floats:
    """``x, y`` (rows, cols, 2) of the points of a grid."""
    return np.stack(np.meshgrid(x, y), axis=-1)


def are_known(points: NDArray[np.floating]) -> Bools:
    """Return which points (..., k) have all of their coordinates."""
    return np.asarray(np.isfinite(points).all(axis=-1))


def _everywhere(matrix: Floats, points: ArrayLike) -> Floats:
    shape = np.shape(np.asarray(points))[:-1]
    return np.broadcast_to(matrix, (*shape, 2, 2)).copy()
