"""Which scale of the heights of a sheet the marks ask for: flattened anew at several scales, it has to fit them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.interpolate import make_interp_spline

from planish.register.pairs import Pairs, inverse_of

Floats = NDArray[np.float64]

CHANCE = 0.0027  # that right marks exclude a scale of 1: three errors
_LEAST = 4  # marks
_MOST = 80  # marks: evenly spaced ones of more; the scale is certain long before
_STRAIN = 0.0005  # standard deviation of either part of a shear of the paper: a stretch of 0.14 %, rms
_FIELD_REACH = (0.5, 1.0)  # of smooth displacements, over the spread of the marks
_FIELD_SHARE = (1.0, 10.0, 100.0, 1000.0)  # their variance over that of a mark
_LINE = 0.01  # of their spread: marks nearer to a line than that say nothing
_NOTHING_UM = 1e-6
_STEPS, _VARIANCES = 181, 16


@dataclass(frozen=True, slots=True, kw_only=True)
class ThroughScale:
    """A scale of heights that marks ask for.

    Attributes
    ----------
    scale, error : float
        The factor on the heights and its standard error; infinite where the marks exclude no scale. With few marks it
        is larger as their own error is not known well: three errors have the same meaning with any number of them.
    evidence, limit : float
        By how many variances scale 1 fits worse; what right marks exceed three times in a thousand.
    without_any : float
        The same, the mark that speaks most for the scale left out.
    stretch : float
        By how much the linear map that fits best at scale 1 stretches one direction against the other.
    stretch_deg : float
        That direction in the moving plane, from u towards v.
    over_stretch : float
        By how many variances the stretch fits worse than the scale, with a logarithm of their number for the parameter
        that it has more (Schwarz 1978, doi:10.1214/aos/1176344136); below zero where it fits better.
    marks : int
        Those that were used.
    """

    scale: float
    error: float
    evidence: float
    limit: float
    without_any: float
    stretch: float
    stretch_deg: float
    over_stretch: float
    marks: int

    @property
    def excludes_one(self) -> bool:
        """Whether the marks exclude a scale of 1."""
        return self.evidence > self.limit


def find_through_scale(scales: Floats, places: Floats, pairs: Pairs, *, mirrored: bool) -> ThroughScale | None:
    """Estimate the scale of heights at which a similarity brings the moving to the fixed marks best.

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
    Generalised least squares. Beside the errors of the marks, two things may look like a scale: a stretch of the paper,
    with the standard deviation that paper has, and smooth displacements, whose variance is found by restricted maximum
    likelihood (Rasmussen and Williams 2006, section 2.7); what is not certain about variances is averaged over.
    """
    which = np.flatnonzero((pairs.weights > 0) & np.isfinite(places).all(axis=(0, 2)))
    if which.size > _MOST:
        which = which[np.linspace(0, which.size - 1, _MOST).round().astype(np.intp)]
    if which.size < _LEAST or scales.size < 4:
        return None
    some = pairs.take(which)
    target = some.fixed - some.fixed.mean(axis=0)
    long, across = np.linalg.svd(target, compute_uv=False)
    if not across > _LINE * long:
        return None
    spread = float(np.sqrt(np.mean(np.sum(target**2, axis=1))))
    # Lengths go with the square of the slope.
    moved = make_interp_spline(scales**2, places[:, which], k=3)
    fine = np.unique(np.append(np.geomspace(scales[0], scales[-1], _STEPS), 1.0))
    bare, strained = _precisions(_centred(moved(fine**2), mirrored) / spread, target, some, spread)
    best = int(np.argmin(_solved(_centred(moved(fine**2), mirrored) / spread, target, strained)[1]))
    near = np.linspace(fine[max(best - 2, 0)], fine[min(best + 2, fine.size - 1)], _STEPS)
    fine = np.unique(np.concatenate([fine, near]))
    away = _centred(moved(fine**2), mirrored) / spread
    rest = _solved(away, target, strained)[1]
    best, one = int(np.argmin(rest)), int(np.searchsorted(fine, 1.0))
    limit = float(special.fdtri(1, 2 * which.size - 5, 1 - CHANCE))
    wider = float(np.sqrt(limit) / special.ndtri(1 - CHANCE / 2))
    source = moved(1.0) - moved(1.0).mean(axis=0)
    affine, missed = _solved(_affine_columns(source / spread)[None], target, bare)
    _, (most, least), turned = np.linalg.svd(affine[0, 2:].reshape(2, 2))
    return ThroughScale(
        scale=float(fine[best]), error=wider * _toward_one(fine, rest, best, one),
        evidence=float(rest[one] - rest[best]), limit=limit, without_any=_without_any(away, target, strained, one),
        stretch=float(most / least - 1), stretch_deg=float(np.degrees(np.arctan2(turned[0, 1], turned[0, 0]))) % 180,
        over_stretch=float(missed[0] + np.log(2 * which.size) - rest[best]), marks=int(which.size),
    )  # fmt: skip


def _without_any(away: Floats, target: Floats, precision: Floats, one: int) -> float:
    """Evidence against a scale of 1, the mark left out that speaks most for it; of four marks none can be spared."""
    covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    found: list[float] = []
    for k in range(len(target)) if len(target) > _LEAST else ():
        others = np.arange(len(target)) != k
        both = np.repeat(others, 2)
        without = np.asarray(np.linalg.inv(covariance[np.ix_(both, both)]), dtype=np.float64)
        rest = _solved(away[:, others], target[others], without)[1]
        found.append(float(rest[one] - rest.min()))
    return min(found, default=0.0)


def _centred(at: Floats, mirrored: bool) -> Floats:
    """Derivatives of a similarity of points (m, n, 2), from their middle, by shift, stretch, turn: (m, n, 2, 4)."""
    at = at - at.mean(axis=1, keepdims=True)
    x, y = -at[..., 0] if mirrored else at[..., 0], at[..., 1]
    one, none = np.ones(x.shape), np.zeros(x.shape)
    rows = [np.stack(row, axis=-1) for row in ([one, none, x, -y], [none, one, y, x])]
    return np.stack(rows, axis=-2)


def _affine_columns(at: Floats) -> Floats:
    """Derivatives of an affine map of points (n, 2) by shift and linear part, row by row: (n, 2, 6)."""
    design = np.zeros((len(at), 2, 6))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, 0, 2:4] = design[:, 1, 4:6] = at
    return design


def _solved(design: Floats, target: Floats, precision: Floats) -> tuple[Floats, Floats]:
    """Generalised least squares for each design (m, n, 2, p): parameters (m, p) and rest in variances (m,)."""
    m, n, _, p = design.shape
    rows = np.moveaxis(design.reshape(m, 2 * n, p), 0, 1).reshape(2 * n, m * p)
    white = np.linalg.cholesky(precision).T @ np.concatenate([rows, target.reshape(-1, 1)], axis=1)
    columns, wanted = np.moveaxis(white[:, :-1].reshape(2 * n, m, p), 1, 0), white[:, -1]
    toward = wanted @ columns
    normal = columns.transpose(0, 2, 1) @ columns
    found = np.asarray(np.linalg.solve(normal, toward[..., None])[..., 0], dtype=np.float64)
    rest: Floats = np.maximum(wanted @ wanted - np.sum(toward * found, axis=1), 0.0)
    return found, rest


def _precisions(away: Floats, target: Floats, pairs: Pairs, spread: float) -> tuple[Floats, Floats]:
    """Mean inverse covariance (2n, 2n) of the marks by restricted likelihood, without and with the strain of the paper.

    A scale is one of the parameters that are free, so that what it explains is no variance.
    """
    n = len(pairs)
    noise, known = (np.zeros((n, 2, n, 2)) for _ in range(2))
    information = pairs.information / np.mean(pairs.weights)
    each = np.arange(n)
    noise[each, :, each, :], known[each, :, each, :] = inverse_of(information), information
    noise, known = (k.reshape(2 * n, 2 * n) for k in (noise, known))
    parts, rest = _solved(away, target, known)
    best = int(np.argmin(rest))
    change = (away[min(best + 1, len(away) - 1)] - away[max(best - 1, 0)]) @ parts[best]
    change = change - away[best] @ _solved(away[[best]], change, known)[0][0]
    length = float(np.linalg.norm(change))
    free = away[best]
    if length > _NOTHING_UM:
        free = np.concatenate([free, change[..., None] / length], axis=-1)
    shears = np.stack([target * [1, -1], target[:, ::-1]], axis=-1).reshape(2 * n, 2) * _STRAIN
    apart = np.sum((target[:, None] - target) ** 2, axis=-1) / spread**2
    fields = [(1.0, 0.0 * apart)]
    for reach, share in product(_FIELD_REACH, _FIELD_SHARE):
        fields.append((1 / (len(_FIELD_REACH) * len(_FIELD_SHARE)), share * np.exp(-apart / (2 * reach**2))))
    size = max(float(rest[best]) / (2 * n - 5), 1e-6)
    likely: list[float] = []
    found: list[Floats] = []
    for (weight, field), square in product(fields, size * np.geomspace(1e-3, 10, _VARIANCES)):
        bare = square * (noise + np.kron(field, np.eye(2)))
        precisions = np.linalg.inv(np.stack([bare, bare + shears @ shears.T]))
        (missed,) = _solved(free[None], target, precisions[1])[1]
        rows = free.reshape(2 * n, -1)
        determinants = np.linalg.slogdet(rows.T @ precisions[1] @ rows)[1] - np.linalg.slogdet(precisions[1])[1]
        likely.append(np.log(weight) - 0.5 * float(missed + determinants))
        found.append(precisions)
    share = np.exp(np.array(likely) - max(likely))
    return np.einsum("k,kaij->aij", share / share.sum(), np.array(found))


def _toward_one(fine: Floats, rest: Floats, best: int, one: int) -> float:
    """How far from the best scale towards 1 the marks fit worse by one variance; infinite where they nowhere do."""
    ends = [np.inf, np.inf]
    for k, side in enumerate((slice(best, None), slice(best, None, -1))):
        s, above = fine[side], rest[side] - rest[best] - 1.0
        if (above > 0).any():
            at = int(np.argmax(above > 0))
            ends[k] = float(abs(np.interp(0.0, above[at - 1 : at + 1], s[at - 1 : at + 1]) - fine[best]))
    return ends[0] if best < one else ends[1] if best > one else max(ends)
