"""Intervals of r where the maps vary alike everywhere, and where they do not: as stated, and as the
Conley interval.

``python -m benchmarks uneven [fields [seed]]``

Fields of 100 x 133 pixels with an exponential correlation, r .5. Uneven ones are multiplied, the
part that both maps share as well as the rest or the rest alone, by the exponential of a Gaussian
map (standard deviation .5, as long as a quarter of the side), so that the spread varies by x/÷
1.65; the r that counts is that of these maps.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.evidence import field
from planish.analyze import conley_interval, correlate

_SHAPE, _R = (100, 133), 0.5
_LEAST = 0.89
_CASES = (
    ("even", 30.0, ""),
    ("even", 12.0, ""),
    ("even", 5.0, ""),
    ("rest uneven", 30.0, "rest"),
    ("both uneven", 60.0, "both"),
    ("both uneven", 30.0, "both"),
    ("both uneven", 12.0, "both"),
)


def cover(fields, seed, share, what):
    """Shares of fields whose r lies in the interval as stated and in the Conley interval; warned;
    ratio of widths."""
    rng, side = np.random.default_rng(seed), _SHAPE[0]
    found = np.zeros(4)
    for _ in range(fields):
        a, rest = field(rng, _SHAPE, side / share, "exp")
        level = np.exp(0.5 * field(rng, _SHAPE, side / 4, "gauss")[0]) if what else np.ones(_SHAPE)
        own = level if what == "both" else 1.0
        b = (_R * a * own + math.sqrt(1 - _R**2) * rest * level) * np.ones(_SHAPE)
        square = float(np.mean(level**2))
        true = _R if what != "rest" else _R / math.sqrt(_R**2 + (1 - _R**2) * square)
        first, second = (
            correlate(a * own, b, pixel_um=1.0),
            conley_interval(a * own, b, pixel_um=1.0),
        )
        wide = [high - low for low, high in (first.interval, second.interval)]
        found += [
            first.interval[0] <= true <= first.interval[1],
            second.interval[0] <= true <= second.interval[1],
            second.ratio > 1.4,
            wide[1] / wide[0],
        ]
    return list(found / fields)


def main(fields=200, seed=0):
    """Print the table; the number of cases in which the interval as stated covers less than it
    promises."""
    print("maps, length          as stated Conley interval  warned  second over first, width")
    failed = 0
    for name, share, what in _CASES:
        numbers = cover(int(fields), int(seed), share, what)
        failed += numbers[0] < _LEAST
        print(f"{name:12} side/{share:<4.0f} {'':4}" + "  ".join(f"{v:9.3f}" for v in numbers))
    return failed
