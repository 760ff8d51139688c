"""Two things that the shape of many profiles shows: a phase-contrast fringe, and the grey of a coating nowhere thick.

A staircase that is only blurred is nowhere darker than the air; a fringe makes the air beside the face darker than the
air farther away. Where that is not seen none is taken: an edge steeper than a Gaussian's may have other reasons.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import optimize

from planish.core.typing import Floats
from planish.surface.priors import FRINGE_PX, Edge, Side
from planish.surface.sample import Sample, Sampler, most_cost

_NEAR = ((1.0, 2.0), (2.0, 3.2), (3.2, 4.8))  # from the face, in widths of the blur: where an undershoot may be seen
_BETWEEN = (4.8, 8.0)  # a fringe is over here; a streak along the sheet is not
_FAR = (8.0, 14.0)  # the air that it is compared with
_OVER = 0.4  # of the undershoot that may be left between
_SIGMAS = 4.5  # that tell the undershoot from chance
_LEAST = 0.0015  # of the contrast: what else may be wrong with the air
_FEW, _ROWS = 8, 5  # columns of a row, and rows, that must show the air
_SMALLEST = 0.005  # fringe
_WINDOW = 1.3  # widths of the blur: the blur that is found may be wider than the one without a fringe
_LOOSE = 0.35  # logarithm of the fringe's width over the usual: where it shows little it is the usual
_TRIALS, _THIN_TRIALS = 90, 80  # of the searches
_SHARES = (0.0, 0.2, 0.45)  # logarithm of a thin coating's grey over the brightest that was seen
_THIN_SHARES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75)  # the same where there is no fringe


def undershoots(sampler: Sampler, samples: dict[bool, Sample], sides: dict[bool, Side], edge: Edge) -> bool:
    """Tell if the air beside the faces is darker than the air farther away.

    The blur with which the faces are found need not be more than roughly right.
    """
    if sampler.embedded_level:
        return False  # what lies beside is no air
    depths = [_undershoot_depth(sampler, samples[high], sides[high], edge) for high in samples]
    means, errors = (np.stack(a) for a in zip(*map(_mean_error, depths), strict=True))
    # Sides whose contrast differs are weighted by what their rows' scatter tells.
    weight = np.where(np.isfinite(means) & (errors > 0), 1.0 / np.maximum(errors, 1e-12) ** 2, 0.0)
    total = weight.sum(axis=0)
    if not total.all():
        return False
    mean = np.sum(np.where(weight > 0, weight * means, 0.0), axis=0) / total
    near, between = mean[:-1], mean[-1]
    dark = (near < -_LEAST) & (near < -_SIGMAS / np.sqrt(total[:-1])) & (between > _OVER * near)
    return bool(dark.any())


def _mean_error(depth: Floats) -> tuple[Floats, Floats]:
    """Mean over the rows and its standard error; NaN where too few rows are known."""
    count = np.isfinite(depth).sum(axis=1)
    reliable = np.where(count[:, None] >= _ROWS, depth, 0.0)
    mean, sd = np.nanmean(reliable, axis=1), np.nanstd(reliable, axis=1)
    return np.where(count >= _ROWS, mean, np.nan), sd / np.sqrt(np.maximum(count - 1, 1))


def _undershoot_depth(sampler: Sampler, sample: Sample, side: Side, edge: Edge) -> Floats:
    """Mean grey of the air near the faces above that farther away, as a share of the contrast, (distances, rows)."""
    face = sampler.fit(sample, side, edge)[0, 0]
    unit = max(edge.width, 1.0)
    contrast = side.level[2] if side.coated else side.level[3]
    first = np.where(np.isfinite(face), face - unit * _FAR[1] / sample.tilt[0], 0.0).astype(int)
    most = int(np.ceil(unit * _FAR[1] / float(sample.tilt.min()))) + 2
    depth = first[:, None] + np.arange(most)
    inside = (depth >= 0) & (depth < sample.grey.shape[2])
    grey = np.take_along_axis(sample.grey[0], np.where(inside, depth, 0), axis=1)
    away = (face[:, None] - depth) * sample.tilt[0][:, None] / unit
    # What floats in the air is left out.
    air = inside & (np.abs(grey) < 5.0 * sampler.scatter)
    rows = int(sample.row.max()) + 1
    row = np.broadcast_to(sample.row[0][:, None], grey.shape)

    def mean(first: float, last: float) -> Floats:
        use = air & (away >= first) & (away < last)
        count = np.bincount(row[use], minlength=rows)
        total = np.bincount(row[use], weights=grey[use], minlength=rows)
        return np.where(count >= _FEW, total / np.maximum(count, 1), np.nan)

    far = mean(*_FAR)
    return np.stack([mean(*reach) - far for reach in (*_NEAR, _BETWEEN)]) / contrast


def with_fringe(
    sampler: Sampler, samples: dict[bool, Sample], sides: dict[bool, Side], edge: Edge, thin: list[bool]
) -> tuple[Edge, dict[bool, Side]]:
    """Blur and fringe, and greys of coatings that are nowhere thick, with which the staircase fits the sample best.

    The edge is returned as it came where the best has no fringe.
    """
    subset = {high: sample.thinned(3 if thin else 4) for high, sample in samples.items()}
    misfit = _misfit(sampler, subset, sides, edge, _WINDOW * max(edge.width, 1.0))

    def trial_of(vector: Floats) -> tuple[Edge, dict[bool, Side]]:
        edge_of_trial = Edge(
            width=edge.width * float(np.exp(vector[0])), fringe=max(float(vector[1]), 0.0),
            fringe_width=FRINGE_PX * float(np.exp(vector[2])),
        )  # fmt: skip
        return edge_of_trial, _brighter(sides, thin, vector[3:])

    def cost(vector: Floats) -> float:
        loose = (float(vector[2]) / _LOOSE) ** 2 + float(np.sum(vector[3:] ** 2))
        return misfit(*trial_of(vector)) + 1e-4 * loose + max(-float(vector[1]), 0.0)

    steps = np.diag([0.1, 0.08, 0.25] + [0.1] * len(thin))
    starts = [np.array([0.1, 0.1, 0.0] + [share] * len(thin)) for share in (_SHARES if thin else (0.0,))]
    best = min((_simplex(cost, start, steps, _TRIALS) for start in starts), key=lambda optimum: optimum[0])[1]
    fitted, brighter = trial_of(best)
    return (fitted, brighter) if fitted.fringe > _SMALLEST else (edge, sides)


def thin_levels(
    sampler: Sampler, samples: dict[bool, Sample], sides: dict[bool, Side], edge: Edge, thin: list[bool]
) -> tuple[Edge, dict[bool, Side]]:
    """Blur, and greys of coatings that are nowhere thick, with which the staircase fits the sample best.

    Grey and thickness of one thin layer can hardly be separated; the shape of many profiles helps a little.
    """
    subset = {high: sample.thinned(3) for high, sample in samples.items()}
    misfit = _misfit(sampler, subset, sides, edge, _WINDOW * edge.width)

    def trial_of(vector: Floats) -> tuple[Edge, dict[bool, Side]]:
        return replace(edge, width=edge.width * float(np.exp(vector[0]))), _brighter(sides, thin, vector[1:])

    def cost(vector: Floats) -> float:
        # A layer's grey is seldom far from the brightest that was seen of it.
        return misfit(*trial_of(vector)) + 1e-4 * float(np.sum(vector**2))

    def with_width(share: float) -> tuple[float, Floats]:
        """Best width for coatings that are so much brighter."""

        def cost_of_width(log_width: float) -> float:
            return cost(np.array([log_width, *[share] * len(thin)]))

        best = optimize.minimize_scalar(cost_of_width, bounds=(-0.2, 0.6), method="bounded", options={"xatol": 0.01})
        return float(best.fun), np.array([float(best.x), *[share] * len(thin)])

    # Brighter layers with a wider blur look nearly the same: the search goes along that valley first.
    _, start = min((with_width(share) for share in _THIN_SHARES), key=lambda optimum: optimum[0])
    along = np.array([0.03, *[0.08] * len(thin)])
    steps = np.vstack([along, np.diag(np.where(np.arange(along.size) > 0, 0.08, 0.03))[1:]])
    return trial_of(_simplex(cost, start, steps, _THIN_TRIALS)[1])


def _misfit(
    sampler: Sampler, subset: dict[bool, Sample], sides: dict[bool, Side], edge: Edge, window: float
) -> Callable[[Edge, dict[bool, Side]], float]:
    """Return the cost of a column, in the mean of both sides, as a function of the edge and the sides."""
    size = max(sum(s.outer.size for s in subset.values()), 1)
    most = {high: most_cost(sampler.fit(sample, sides[high], edge, window)[4]) for high, sample in subset.items()}

    def misfit(edge_of_trial: Edge, sides_of_trial: dict[bool, Side]) -> float:
        total = 0.0
        for high, sample in subset.items():
            cost = sampler.fit(sample, sides_of_trial[high], edge_of_trial, window)[4]
            total += float(np.sum(np.where(np.isfinite(cost), np.minimum(cost, most[high]), most[high])))
        return total / size

    return misfit


def _brighter(sides: dict[bool, Side], thin: list[bool], shares: Floats) -> dict[bool, Side]:
    """Return the sides with the greys of thin coatings multiplied by exp(share)."""
    brighter = dict(sides)
    for high, share in zip(thin, shares, strict=True):
        brighter[high] = sides[high].brighter(float(np.exp(share)))
    return brighter


def _simplex(cost: Callable[[Floats], float], start: Floats, steps: Floats, trials: int) -> tuple[float, Floats]:
    """Lowest cost that Nelder and Mead's method finds, and where."""
    optimum = optimize.minimize(
        cost, start, method="Nelder-Mead",
        options={"initial_simplex": np.vstack([start, start + steps]), "xatol": 2e-3, "fatol": 1e-7, "maxfev": trials},
    )  # fmt: skip
    return float(optimum.fun), np.asarray(optimum.x, dtype=np.float64)
