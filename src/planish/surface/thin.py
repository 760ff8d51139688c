"""The grey of a coating that is nowhere thicker than the blur."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from planish.surface.learnt import Edge, Side
from planish.surface.sample import Sample, Sampler, most_cost

Array = NDArray[np.float64]

_WINDOW = 1.3  # widths of the blur: the blur that is found may be wider than the one at first
_TRIALS = 80  # of the search for the grey of coatings that are nowhere thick
_SHARES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75)  # logarithm of their grey over the brightest that was seen


def thin_levels(
    sampler: Sampler, samples: dict[bool, Sample], sides: dict[bool, Side], edge: Edge, thin: list[bool]
) -> tuple[Edge, dict[bool, Side]]:
    """Blur, and greys of coatings that are nowhere thick, with which the staircase fits the sample best.

    Grey and thickness of one thin layer can hardly be told apart; the shape of many profiles tells a little.
    """
    few = {high: sample.thinned(3) for high, sample in samples.items()}
    size = max(sum(s.outer.size for s in few.values()), 1)
    window = _WINDOW * edge.width
    most = {high: most_cost(sampler.fit(sample, sides[high], edge, window)[4]) for high, sample in few.items()}

    def put(at: Array) -> tuple[Edge, dict[bool, Side]]:
        put_to = dict(sides)
        for high, share in zip(thin, at[1:], strict=True):
            put_to[high] = sides[high].brighter(float(np.exp(share)))
        return replace(edge, width=edge.width * float(np.exp(at[0]))), put_to

    def cost(at: Array) -> float:
        tried, put_to = put(at)
        total = 0.0
        for high, sample in few.items():
            found = sampler.fit(sample, put_to[high], tried, window)[4]
            total += float(np.sum(np.where(np.isfinite(found), np.minimum(found, most[high]), most[high])))
        # A layer's grey is seldom far from the brightest that was seen of it.
        return total / size + 1e-4 * float(np.sum(at**2))

    def with_width(share: float) -> tuple[float, Array]:
        """Best width for coatings that are so much brighter."""

        def of(log_width: float) -> float:
            return cost(np.array([log_width, *[share] * len(thin)]))

        best = optimize.minimize_scalar(of, bounds=(-0.2, 0.6), method="bounded", options={"xatol": 0.01})
        return float(best.fun), np.array([float(best.x), *[share] * len(thin)])

    # Brighter layers with a wider blur look nearly the same: the search goes along that valley first.
    _, at = min((with_width(share) for share in _SHARES), key=lambda found: found[0])
    along = np.array([0.03, *[0.08] * len(thin)])
    steps = np.vstack([along, np.diag(np.where(np.arange(along.size) > 0, 0.08, 0.03))[1:]])
    best = optimize.minimize(
        cost, at, method="Nelder-Mead",
        options={"initial_simplex": np.vstack([at, at + steps]), "xatol": 2e-3, "fatol": 1e-7, "maxfev": _TRIALS},
    )  # fmt: skip
    at = np.asarray(best.x, dtype=np.float64)
    return put(at)
