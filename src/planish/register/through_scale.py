"""The scale of the heights of a sheet that the marks ask for.

Flattened anew at several scales, the sheet has to fit the marks.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.interpolate import make_interp_spline
from scipy.linalg import block_diag

from planish.core.robust import rms_length
from planish.core.typing import Floats
from planish.register.pairs import (
    Pairs,
    as_complex,
    inverse_of,
    on_both_axes,
    solved,
    squared_distances,
)
from planish.register.similarity import affine_columns, similarity_columns

CHANCE = 0.0027  # that right marks exclude a scale of 1: three errors
_LEAST = 4  # marks
_MOST = 80  # marks: evenly spaced ones of more; the scale is certain long before
_STEPS = 181


@dataclass(frozen=True, slots=True, kw_only=True)
class ThroughScale:
    """A scale of heights that marks ask for."""

    scale: float  # the factor on the heights; infinite where the marks exclude no scale
    # Standard error of the factor; infinite where the marks exclude no scale. With few marks it is
    # larger as their own error is not known well: three errors have the same meaning with any
    # number of them.
    error: float
    evidence: float  # by how many variances scale 1 fits worse
    limit: float  # what right marks exceed three times in a thousand
    without_any: float  # `evidence` with the mark that speaks most for the scale left out
    # By how much the linear map that fits best at scale 1 stretches one direction against the
    # other.
    stretch: float
    stretch_deg: float  # that direction in the moving plane, from u towards v
    # By how many variances the stretch fits worse than the scale, with a logarithm of their number
    # for the parameter that it has more (Schwarz 1978, doi:10.1214/aos/1176344136); below zero
    # where it fits better.
    over_stretch: float
    marks: int  # those that were used

    @property
    def excludes_one(self) -> bool:
        """True where the marks exclude a scale of 1."""
        return self.evidence > self.limit


def find_through_scale(
    scales: Floats, places: Floats, pairs: Pairs, *, mirrored: bool
) -> ThroughScale | None:
    """Estimate the scale of heights at which a similarity best brings moving to fixed marks.

    Parameters
    ----------
    scales : (k,)
        Factors on the heights, rising; at least 4, 1 among them.
    places : (k, n, 2), in um
        Moving marks at each of them; NaN where a mark has no place.
    pairs : Pairs
        Fixed marks and the information on each pair; its moving marks are not used.
    mirrored : bool
        Whether the registration changes the handedness.

    Returns
    -------
    ThroughScale or None
        None with fewer than 4 marks, fewer than 4 scales, or marks on one line.

    Notes
    -----
    Generalised least squares. Beside the errors of the marks, two things may look like a scale: a
    stretch of the paper, with the standard deviation that paper has, and smooth displacements,
    whose variance is found by restricted maximum likelihood (Rasmussen and Williams 2006, section
    2.7); what is not certain about variances is averaged over.
    """
    is_placed = np.isfinite(places).all(axis=(0, 2))
    rows = np.flatnonzero(is_placed & (pairs.weights > 0))
    if rows.size > _MOST:
        chosen = np.linspace(0, rows.size - 1, _MOST).round()
        rows = rows[chosen.astype(np.intp)]
    if rows.size < _LEAST or scales.size < 4:
        return None
    used_pairs = pairs.take(rows)
    target = used_pairs.fixed - used_pairs.fixed.mean(axis=0)
    length_um, width_um = np.linalg.svd(target, compute_uv=False)
    # Marks nearer to a line than 1 % of their spread say nothing.
    if not width_um > 0.01 * length_um:
        return None
    spread = rms_length(target)
    # Lengths go with the square of the slope.
    spline = make_interp_spline(scales**2, places[:, rows], k=3)
    fine_scales = np.union1d(np.geomspace(scales[0], scales[-1], _STEPS), 1.0)
    designs = _centred(spline(fine_scales**2), mirrored) / spread
    marks_precision, precision = _precisions(designs, target, used_pairs, spread)
    _, misfit = _solved(designs, target, precision)
    best = int(np.argmin(misfit))
    around = fine_scales[max(best - 2, 0) : best + 3]
    finer_scales = np.linspace(around[0], around[-1], _STEPS)
    fine_scales = np.union1d(fine_scales, finer_scales)
    designs = _centred(spline(fine_scales**2), mirrored) / spread
    _, misfit = _solved(designs, target, precision)
    best = int(np.argmin(misfit))
    one_index = int(np.searchsorted(fine_scales, 1.0))
    limit = float(special.fdtri(1, 2 * rows.size - 5, 1 - CHANCE))
    t_factor = float(np.sqrt(limit) / special.ndtri(1 - CHANCE / 2))
    source = spline(1.0)
    # In place of the scale, a stretch of the sheet as the marks show it at scale 1.
    affine_design = affine_columns((source - source.mean(axis=0)) / spread)
    (affine_parameters,), (affine_misfit,) = _solved(affine_design[None], target, marks_precision)
    linear = affine_parameters[2:].reshape(2, 2)
    _, (most_stretch, least_stretch), right_vectors = np.linalg.svd(linear)
    (direction_x, direction_y), _ = right_vectors
    over_stretch = affine_misfit + np.log(2 * rows.size) - misfit[best]
    direction_deg = float(np.degrees(np.arctan2(direction_y, direction_x)))
    return ThroughScale(
        scale=float(fine_scales[best]),
        error=t_factor * _toward_one(fine_scales, misfit, best, one_index),
        limit=limit,
        evidence=float(misfit[one_index] - misfit[best]),
        without_any=_without_any(designs, target, precision, one_index),
        stretch=float(most_stretch / least_stretch - 1),
        stretch_deg=direction_deg % 180,
        over_stretch=float(over_stretch),
        marks=int(rows.size),
    )


def _without_any(designs: Floats, target: Floats, precision: Floats, one_index: int) -> float:
    """Evidence against a scale of 1, in variances, the mark left out that speaks most for it.

    ``designs`` (scales, n, 2, 4) are those of `_solved`, ``target`` (n, 2) the fixed marks,
    ``precision`` (2n, 2n) their inverse covariance; scale 1 is ``one_index``. Of four marks none
    can be spared.
    """
    if len(target) <= _LEAST:
        return 0.0
    evidences: list[float] = []
    for k in range(len(target)):
        mark_rows = np.delete(np.arange(len(target)), k)
        left_out = np.array([2 * k, 2 * k + 1])
        equations = np.delete(np.arange(2 * len(target)), left_out)
        # Inverse of the covariance of the others, from the precision of all. Two inversions of
        # the whole matrix would lose more digits than marks without any error leave it.
        shared = precision[np.ix_(equations, left_out)]
        own_precision = precision[np.ix_(left_out, left_out)]
        others_precision = precision[np.ix_(equations, equations)]
        reduced_precision = others_precision - shared @ np.linalg.solve(own_precision, shared.T)
        _, misfit = _solved(designs[:, mark_rows], target[mark_rows], reduced_precision)
        evidences.append(float(misfit[one_index] - misfit.min()))
    return min(evidences)


def _centred(places: Floats, mirrored: bool) -> Floats:
    """Derivatives of a similarity of points (m, n, 2) by shift, stretch and turn: (m, n, 2, 4).

    The points count from their middle.
    """
    centred = places - places.mean(axis=1, keepdims=True)
    return similarity_columns(as_complex(centred, mirrored))


def _solved(
    design: Floats, target: Floats, precision: NDArray[np.floating]
) -> tuple[Floats, Floats]:
    """Solve generalised least squares for each design (m, n, 2, p) of a target (n, 2).

    Gives parameters (m, p) and rest in variances (m,). ``precision`` (2n, 2n) is the inverse
    covariance of the target.
    """
    m, n, _, p = design.shape
    by_equation = np.moveaxis(design.reshape(m, 2 * n, p), 0, 1)
    # All designs side by side, and the target: whitened at once.
    flat_designs = by_equation.reshape(2 * n, m * p)
    rows = np.column_stack([flat_designs, target.ravel()])
    whitened = np.linalg.cholesky(precision).T @ rows
    white_designs = whitened[:, :-1].reshape(2 * n, m, p)
    columns = np.moveaxis(white_designs, 1, 0)
    white_target = whitened[:, -1]
    projections = white_target @ columns
    normal = columns.transpose(0, 2, 1) @ columns
    parameters = solved(normal, projections)
    # The rest itself, not the difference of two sums of squares, of which marks without any error
    # leave rounding alone.
    rest = white_target - (columns @ parameters[..., None])[..., 0]
    return parameters, np.sum(rest**2, axis=1)


def _precisions(
    designs: Floats, target: Floats, pairs: Pairs, spread: float
) -> tuple[Floats, Floats]:
    """Mean inverse covariance (2n, 2n) of the marks by restricted likelihood.

    Without and with the strain of the paper: (2, 2n, 2n).

    A scale is one of the parameters that are free, so that what it explains is no variance.
    ``designs`` are those of all scales, ``target`` the fixed marks about their middle, and
    ``spread`` is their rms distance from it, in um.
    """
    n = len(pairs)
    information = pairs.information / np.mean(pairs.weights)
    noise = block_diag(*inverse_of(information))
    precision = block_diag(*information)
    free, misfit = _free_columns(designs, target, precision)
    # Standard deviation of either part of a shear of the paper: a stretch of 0.14 %, rms.
    stretched = target * [1, -1]
    exchanged = target[:, ::-1]
    shears = np.stack([stretched, exchanged], axis=-1)
    strains = shears.reshape(2 * n, 2) * 0.0005
    squares = squared_distances(target, target) / spread**2
    # Smooth displacements: their reach over the spread of the marks, and their variance over that
    # of a mark.
    field_covariances: list[Floats] = []
    for length, ratio in product((0.5, 1.0), (1.0, 10.0, 100.0, 1000.0)):
        field_covariances.append(ratio * np.exp(-squares / (2 * length**2)))
    mean_variance = max(misfit / (2 * n - 5), 1e-6)
    variances = mean_variance * np.geomspace(1e-3, 10, 16)
    rows = free.reshape(2 * n, -1)
    log_weights: list[float] = []
    precision_pairs: list[Floats] = []
    for field_covariance, variance in product([0.0 * squares, *field_covariances], variances):
        marks_covariance = variance * (noise + on_both_axes(field_covariance))
        marks_precision = np.linalg.inv(marks_covariance)
        # Inverse with the strain, by Woodbury's identity: where marks have hardly an error, the
        # strain is so much larger that an inversion of the sum is not positive definite.
        strained = marks_precision @ strains
        inner = np.eye(2) + strains.T @ strained
        strain_precision = marks_precision - strained @ np.linalg.solve(inner, strained.T)
        precisions = np.stack([marks_precision, strain_precision])
        _, (misfit_left,) = _solved(free[None], target, precisions[1])
        log_determinants = np.linalg.slogdet(rows.T @ precisions[1] @ rows)[1]
        log_determinants -= np.linalg.slogdet(precisions[1])[1]
        weight = 1 / len(field_covariances) if field_covariance.any() else 1.0
        log_weights.append(np.log(weight) - 0.5 * float(misfit_left + log_determinants))
        precision_pairs.append(precisions)
    probabilities = special.softmax(log_weights)
    return np.einsum("k,kaij->aij", probabilities, np.array(precision_pairs))


def _free_columns(designs: Floats, target: Floats, precision: Floats) -> tuple[Floats, float]:
    """Columns (n, 2, p) of the best similarity and of a change of the scale, where it is one.

    And the misfit left. A change of the scale that a similarity makes as well is none: p is 4 then,
    and 5 otherwise. ``designs`` (scales, n, 2, 4) are those of all scales.
    """
    parameters, misfit = _solved(designs, target, precision)
    best = int(np.argmin(misfit))
    around = designs[max(best - 1, 0) : best + 2]
    slope = (around[-1] - around[0]) @ parameters[best]
    (explained,), _ = _solved(designs[[best]], slope, precision)
    slope = slope - designs[best] @ explained
    length = float(np.linalg.norm(slope))
    columns = [designs[best]]
    if length > 1e-6:
        columns.append(slope[..., None] / length)
    return np.concatenate(columns, axis=-1), float(misfit[best])


def _toward_one(fine_scales: Floats, misfit: Floats, best: int, one_index: int) -> float:
    """Distance from the best scale towards 1 at which marks fit worse by one variance.

    Infinite where nowhere; where the best scale is 1, the longer one of both ways. ``misfit`` is
    that of each of the ``fine_scales``; ``best`` and ``one_index`` are indices in them.
    """
    steps = [1, -1]
    if best != one_index:
        steps = [1 if best < one_index else -1]
    distances: list[float] = []
    for step in steps:
        scales = fine_scales[best::step]
        excess = misfit[best::step] - misfit[best] - 1.0
        crossing = np.argmax(excess > 0)
        if not crossing:
            return np.inf
        bracket = slice(crossing - 1, crossing + 1)
        scale = np.interp(0.0, excess[bracket], scales[bracket])
        distances.append(float(abs(scale - scales[0])))
    return max(distances)
