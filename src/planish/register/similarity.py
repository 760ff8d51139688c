"""Transformations of few parameters: rotation, shift, no scale, one, or one in each direction.

Projective.
"""

from dataclasses import replace

import numpy as np

from planish.core.errors import CannotRegister, MarkError
from planish.core.transform import Affine, Projective, Similarity, Transform
from planish.core.typing import Complexes, Floats, pair_of
from planish.register.base_model import Frame, ParametricModel, least_squares, refuse_line
from planish.register.pairs import COINCIDENT, Pairs, as_complex

_STEPS = 100


class RigidModel(ParametricModel):
    """Rotation and shift."""

    name, words = "rigid", "rigid"
    transform = Similarity
    least = 2

    def fit(self, pairs: Pairs, mirrored: bool, /) -> Similarity:
        """Closed form for equal weights of both axes.

        Gauss-Newton on the angle from there for covariances.
        """
        # The map is ``w = middle + turn (z - z_mean)`` in complex numbers.
        z_mean, middle, product, square = _sums(pairs, mirrored)
        turn = product / abs(product)
        if not pairs.isotropic:
            z = as_complex(pairs.moving, mirrored)
            w = as_complex(pairs.fixed, False)
            whitening = pairs.whitening()
            size = float(np.sqrt(square))
            last_length = np.inf
            for _ in range(_STEPS):
                turned = turn * (z - z_mean)
                error = w - middle - turned
                design = similarity_columns(turned / size, only_turn=True)
                error_xy = np.stack([error.real, error.imag], axis=-1)
                step = least_squares(whitening, design, error_xy, self.name)
                step_x, step_y, step_turn = step
                middle += complex(step_x, step_y)
                turn *= np.exp(1j * step_turn / size)
                step_length = float(np.abs(step).max())
                # The last digits do not settle: then a step is no shorter than the one before.
                if step_length < 1e-15 * size or step_length >= last_length:
                    break
                last_length = step_length
        shift = middle - turn * z_mean
        angle = float(np.angle(turn))
        shift_um = (shift.real, shift.imag)
        return Similarity(rotation_rad=angle, shift_um=shift_um, mirrored=mirrored)

    def design(self, transform: Transform, frame: Frame, points: Floats, /) -> Floats:
        """Shift in x, shift in y, turn."""
        middle, size = frame
        scaled_offsets = (transform(points) - transform(middle)) / size
        return similarity_columns(as_complex(scaled_offsets, False), only_turn=True)


class SimilarityModel(ParametricModel):
    """Rotation, shift and one scale."""

    name, words = "similarity", "similarity"
    transform = Similarity
    least, linear = 2, True

    def fit(self, pairs: Pairs, mirrored: bool, /) -> Similarity:
        """Linear least squares; closed form in complex numbers for equal weights of both axes."""
        if pairs.isotropic:
            z_mean, w_mean, product, square = _sums(pairs, mirrored)
            alpha = product / square
            beta = w_mean - alpha * z_mean
            angle = float(np.angle(alpha))
            turn = Similarity(scale=abs(alpha), rotation_rad=angle, mirrored=mirrored)
            return replace(turn, shift_um=(beta.real, beta.imag))
        # About the middles, and scaled: ``target + beta + (a + ib) z``.
        middle, size = pairs.frame()
        design = similarity_columns(as_complex(pairs.moving - middle, mirrored) / size)
        target = pairs.share @ pairs.fixed
        error = pairs.fixed - target
        parameters = least_squares(pairs.whitening(), design, error, self.name)
        beta_um, (a, b) = parameters.reshape(2, 2)
        _refuse_no_rotation(complex(a, b) / size, 1.0)
        scale = float(np.hypot(a, b)) / size
        angle = float(np.arctan2(b, a))
        turn = Similarity(scale=scale, rotation_rad=angle, mirrored=mirrored)
        shift_um = target + beta_um - turn(middle)
        return replace(turn, shift_um=pair_of(shift_um))

    def design(self, transform: Transform, frame: Frame, points: Floats, /) -> Floats:
        """Shift in x, shift in y, stretch, turn."""
        middle, size = frame
        return similarity_columns(as_complex(points - middle, transform.mirrored) / size)


class AffineModel(ParametricModel):
    """Rotation, shift, and another scale in every direction.

    For humidity, embedding, and a camera's pixel aspect.
    """

    name, words = "affine", "affine"
    transform = Affine
    least, linear = 3, True

    def fit(self, pairs: Pairs, _mirrored: bool, /) -> Affine:
        """Linear least squares.

        About the weighted middles of both sides, in units of the size of the moving marks.
        CannotRegister where the marks lie on one line.
        """
        middle, size = pairs.frame()
        refuse_line(pairs, self.name)
        target = pairs.weights @ pairs.fixed / np.sum(pairs.weights)
        design = affine_columns((pairs.moving - middle) / size)
        error = pairs.fixed - target
        parameters = least_squares(pairs.whitening(), design, error, self.name)
        x_row, y_row = map(pair_of, parameters[2:].reshape(2, 2) / size)
        target_um = pair_of(target + parameters[:2])
        return Affine(linear=(x_row, y_row), source=pair_of(middle), target=target_um)

    def design(self, _transform: Affine, frame: Frame, points: Floats, /) -> Floats:
        """Shift in x and y, then the linear part row by row."""
        middle, size = frame
        return affine_columns((points - middle) / size)


def _sums(pairs: Pairs, mirrored: bool) -> tuple[complex, complex, complex, float]:
    """Weighted means of both sides, and means of ``conj(z) w`` and ``|z|**2`` around them.

    The moving side ``z`` and the fixed side ``w`` are taken as complex numbers, in um. MarkError
    where the means fix no rotation.
    """
    share = pairs.share
    z = as_complex(pairs.moving, mirrored)
    w = as_complex(pairs.fixed, False)
    z_mean = share @ z
    w_mean = share @ w
    zc = z - z_mean
    wc = w - w_mean
    product = np.sum(share * zc.conj() * wc)
    square = np.sum(share * (zc.real**2 + zc.imag**2))
    _refuse_no_rotation(product, square)
    return complex(z_mean), complex(w_mean), complex(product), float(square)


def _refuse_no_rotation(product: complex, square: float) -> None:
    if square <= 0.0 or abs(product) <= COINCIDENT * square:
        raise MarkError(
            "The marks fix no rotation: the directions between them disagree on the two sides."
            " Check that every row pairs the same hole on both sides."
        )


def similarity_columns(z: Complexes, *, only_turn: bool = False) -> Floats:
    """Derivatives of ``beta + alpha z`` by the parts of beta and alpha: (..., 2, 4 or 3).

    The turn alone may take the place of alpha.
    """
    shifts = [np.ones(z.shape), np.full(z.shape, 1j)]
    by_alpha = [1j * z] if only_turn else [z, 1j * z]
    design = np.stack([*shifts, *by_alpha], axis=-1)
    return np.stack([design.real, design.imag], axis=-2)


def affine_columns(scaled_points: Floats) -> Floats:
    """Derivatives of an affine map of points (..., 2) by shift and linear part: (..., 2, 6).

    The linear part goes row by row.
    """
    design = np.zeros((*scaled_points.shape[:-1], 2, 6))
    design[..., :2] = np.eye(2)
    design[..., 0, 2:4] = scaled_points
    design[..., 1, 4:] = scaled_points
    return design


class ProjectiveModel(ParametricModel):
    """The oblique view of a flat sheet."""

    name, words = "projective", "projective"
    transform = Projective
    least = 4

    def fit(self, pairs: Pairs, _mirrored: bool, /) -> Projective:
        """Fit by a normalised direct linear transformation, then by Gauss-Newton.

        Gauss-Newton acts on the distances in the fixed map.
        """
        middle, size = pairs.frame()
        refuse_line(pairs, self.name)
        share = pairs.share
        target = share @ pairs.fixed
        squares = np.sum((pairs.fixed - target) ** 2, axis=1)
        target_size = float(np.sqrt(share @ squares))

        def build(h: Floats) -> Projective:
            row_1, row_2, row_3 = map(tuple, (h / h[2, 2]).tolist())
            return Projective(
                homography=(row_1, row_2, row_3),
                source=pair_of(middle),
                target=pair_of(target),
                source_size=size,
                target_size=target_size,
            )

        def cost(trial: Projective) -> float:
            error = pairs.fixed - trial(pairs.moving)
            return float(np.sum((whitening @ error[..., None]) ** 2))

        scaled_moving = (pairs.moving - middle) / size
        scaled_fixed = (pairs.fixed - target) / target_size
        first_h = _direct_linear(scaled_moving, scaled_fixed, np.sqrt(share))
        transform = build(first_h)
        whitening = pairs.whitening()
        last_length = np.inf
        for _ in range(_STEPS):
            error = pairs.fixed - transform(pairs.moving)
            if not np.isfinite(error).all():
                raise CannotRegister(
                    "The projective transformation puts marks behind the camera: the pairs do not"
                    " show one flat sheet. Check the pairs, or fit an affine transformation."
                )
            design = self.design(transform, (middle, size), pairs.moving)
            step = least_squares(whitening, design, error, self.name)
            # Shortened until the error does not rise; without a step where it always does. A cost
            # that is not finite lies below no limit.
            cost_limit = cost(transform) * (1 + 1e-9) + 1e-300
            h = np.array(transform.homography)
            full_step = np.append(step, 0.0).reshape(3, 3)
            trials = (build(h + full_step / 2**k) for k in range(12))
            transform = next((t for t in trials if cost(t) <= cost_limit), transform)
            step_length = float(np.abs(step).max())
            # The last digits do not settle: steps of rounding are as long as the one before.
            if step_length < 1e-15 or (step_length < 1e-9 and step_length >= 0.5 * last_length):
                break
            last_length = step_length
        return transform

    def design(self, transform: Projective, _frame: Frame, points: Floats, /) -> Floats:
        """The first eight numbers of the 3 x 3 matrix, whose last one is 1."""
        h = np.array(transform.homography)
        linear = h[:, :2]
        shift = h[:, 2]
        scaled_points = (points - transform.source) / transform.source_size
        denominators = (scaled_points @ linear[2] + shift[2])[..., None]
        image = (scaled_points @ linear[:2].T + shift[:2]) / denominators
        ones = np.ones_like(denominators)
        rows = np.concatenate([scaled_points, ones], axis=-1) / denominators
        design = np.zeros((*points.shape[:-1], 2, 8))
        design[..., 0, :3] = rows
        design[..., 1, 3:6] = rows
        design[..., 6:] = -image[..., None] * rows[..., None, :2]
        return transform.target_size * design


def _direct_linear(moving: Floats, fixed: Floats, weight_roots: Floats) -> Floats:
    """Homography (3, 3) with the least algebraic error, from points (n, 2) scaled to size 1.

    CannotRegister where they fix none, or show the sheet from both sides at once.
    """
    homogeneous = np.column_stack([moving, np.ones(len(moving))])
    # Two equations a pair for the nine numbers of the matrix, row by row.
    equations = np.zeros((len(moving), 2, 9))
    equations[:, 0, :3] = homogeneous
    equations[:, 1, 3:6] = homogeneous
    equations[:, :, 6:] = -fixed[:, :, None] * homogeneous[:, None]
    equations *= weight_roots[:, None, None]
    # Four pairs make eight equations: the ninth vector stands in the full matrix alone.
    _, singular, right_vectors = np.linalg.svd(equations.reshape(-1, 9), len(moving) < 5)
    h = right_vectors[-1].reshape(3, 3)
    denominators = homogeneous @ h[2]
    has_one_sign = np.all(denominators > 0) or np.all(denominators < 0)
    is_free = singular[7] < 1e-7 * singular[0] or abs(h[2, 2]) < 1e-6
    if is_free or not has_one_sign:
        raise CannotRegister(
            "The marks do not fix one projective transformation: too many lie on one line, or the"
            " pairs do not show one flat sheet. Check the pairs, add marks beside that line, or fit"
            " an affine transformation."
        )
    return h
