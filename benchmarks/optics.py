"""Curves of brightness over coat weight: how often their intervals hold the truth.

``python -m benchmarks optics [fields [seed]]``

Fields of 60 x 80 points of 100 um. The coating weighs 17 +- 4.5 g/m2 and has a 1/e correlation
length; the rest of the brightness has one of its own, and the line carries a quarter of the
variance. Independent points are those of ``independent_points``; in the second table those of
``correlate`` for the coating and the brightness, one number for slope, bend and level, which is the
simple way.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.evidence import field
from planish.analyze import correlate, fit_kubelka_munk, independent_points, straight_or_curved
from planish.core.reflectance import layer_over

_SHAPE, _POINT_UM = (60, 80), 100.0
_WEIGHT, _SPREAD = 17.0, 4.5  # g/m2
# S in m2/g, K/S, of a line per g/m2, of the rest.
_S, _RATIO, _SLOPE, _NOISE = 0.15, 0.002, 0.00225, 0.0175
_COVERS = (0.90, 0.985)
_LENGTHS_UM = ((150.0, 150.0), (200.0, 200.0), (300.0, 300.0), (150.0, 600.0), (300.0, 100.0))


BASE = 1 + 1.2 / 45.0 - math.sqrt((1.2 / 45.0) ** 2 + 2 * 1.2 / 45.0)
"""Reflectance of a pile of uncoated base."""


def cover(fields, seed, lengths_um, *, of_rest=True):
    """Shares of fields whose interval holds S, the base, and the slope and straightness of a line;
    and a row."""
    rng, held, n_effs = np.random.default_rng(seed), [], []
    for _ in range(fields):
        x = np.maximum(_WEIGHT + _SPREAD * _field(rng, lengths_um[0]), 0.0)
        noise = _NOISE * _field(rng, lengths_um[1])
        bent = layer_over(BASE, _S, _S * _RATIO, x) + noise
        line = 0.82 + _SLOPE * x + noise
        if of_rest:
            points = independent_points(x, line, pixel_um=_POINT_UM)
            n_eff, squares, level = points.n_eff, points.n_eff_square, points.n_eff_level
        else:
            n_eff, squares, level = correlate(x, line, pixel_um=_POINT_UM).n_eff, None, None
        fit = fit_kubelka_munk(
            x, bent, n_eff=n_eff, n_eff_level=level, absorption_over_scattering=_RATIO
        )
        straight = straight_or_curved(x, line, n_eff=n_eff, n_eff_square=squares)
        truths = {
            _S: fit.scattering_interval,
            BASE: fit.backing_interval,
            _SLOPE: straight.slope_interval,
        }
        truths[0.0] = straight.interval
        held.append([low <= truth <= high for truth, (low, high) in truths.items()])
        n_effs.append(n_eff)
    shares = np.mean(held, axis=0).tolist()
    down, across = lengths_um
    return shares, f"{down:5.0f} {across:5.0f}{np.median(n_effs):8.0f}" + "".join(
        f"{v:9.3f}" for v in shares
    )


def _field(rng, length_um):
    return field(rng, _SHAPE, length_um / _POINT_UM, "exp")[0]


def main(fields=200, seed=0):
    """Print the tables; the number of limits that were missed."""
    missed = 0
    for of_rest in (True, False):
        print(
            f"{fields} fields, {'independent_points' if of_rest else 'n_eff of correlate for all'}"
        )
        print(
            f"{'':24s}-- holds the truth of --\n  map  rest   n_eff        S     base    slope"
            " straight"
        )
        for lengths in _LENGTHS_UM if of_rest else _LENGTHS_UM[1::2]:
            shares, row = cover(fields, seed, lengths, of_rest=of_rest)
            missed += of_rest and not all(_COVERS[0] <= v <= _COVERS[1] for v in shares)
            print(row, flush=True)
    return missed
