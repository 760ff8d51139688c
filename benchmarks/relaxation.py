"""The relaxation of Hirn et al.

(2009), section 2.3: accuracy on its Fig. 5, and steps and seconds.

``python -m benchmarks relaxation``
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass

import numpy as np

from planish.core.status import Outcome
from planish.flatten.relaxation import RelaxationParams, relax_dynamically
from planish.validate.mesh import (
    cylinder,
    deformed,
    grid,
    node_error,
    rest_lengths,
    size_errors,
    unrolled,
)

_READINGS = {
    "first": RelaxationParams(stop="first"),
    "sustained": RelaxationParams(),
    "sustained, speed 1e-4": RelaxationParams(mean_speed=1e-4),
}
# The paper's promises, as shares: "always below 0.1 %", and the "below 0.01 %" of its Fig. 5.
_LIMITS = {"sustained": 1e-3, "sustained, speed 1e-4": 1e-4}
_REPEATS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A start and the flat mesh that it came from, in pitches."""

    name: str
    start: np.ndarray
    flat: np.ndarray
    rest: np.ndarray


def main():
    """Print the tables; return how many limits were missed."""
    relax_dynamically(*deformed(0, 4, 5), params=RelaxationParams(most_steps=1))  # compiles
    return _print_accuracy() + _print_speed()


def _print_accuracy():
    print("Fig. 5: 32 x 24 nodes, ten random deformations; errors of width, height, aspect in %")
    print(
        f"{'stop':24s} {'steps':>7s} {'ms':>7s} | mean: width height aspect | largest: width height"
        " aspect | inverted"
    )
    missed = 0
    for name, params in _READINGS.items():
        found, errors, seconds = [], [], []
        for seed in range(10):
            start, rest = deformed(seed)
            begin = time.perf_counter()
            found.append(relax_dynamically(start, rest, params=params))
            seconds.append(time.perf_counter() - begin)
            errors.append(np.abs(size_errors(found[-1].uv, grid(24, 32))))
        mean, largest = np.mean(errors, axis=0), np.max(errors, axis=0)
        print(
            f"{name:24s} {np.mean([f.steps for f in found]):7.0f}"
            f" {1e3 * statistics.median(seconds):7.1f} | {100 * mean[0]:11.4f} {100 * mean[1]:6.4f}"
            f" {100 * mean[2]:6.4f} | {100 * largest[0]:14.4f} {100 * largest[1]:6.4f}"
            f" {100 * largest[2]:6.4f} | {sum(f.inverted for f in found):8d}",
            flush=True,
        )
        missed += any(
            f.outcome is not Outcome.RESTED for f in found
        ) or largest.max() > _LIMITS.get(name, np.inf)
    return missed


def _print_speed():
    print(
        f"{'case':28s} {'steps':>8s} {'seconds':>8s} {'ms/step':>8s}  largest node error in pitches"
    )
    missed = 0
    for case in (_cylinder(), _fig5(24, 32), _fig5(96, 128)):
        seconds = []
        for _ in range(_REPEATS):
            begin = time.perf_counter()
            found = relax_dynamically(case.start, case.rest)
            seconds.append(time.perf_counter() - begin)
        took = statistics.median(seconds)
        print(
            f"{case.name:28s} {found.steps:8d} {took:8.2f} {1e3 * took / found.steps:8.3f} "
            f" {node_error(found.uv, case.flat):.4f}"
            + ("" if found.outcome is Outcome.RESTED else f" {found.outcome}"),
            flush=True,
        )
        missed += found.outcome is not Outcome.RESTED
    return missed


def _fig5(rows, cols):
    start, rest = deformed(0, rows, cols)
    return Case(
        name=f"Fig. 5, {cols} x {rows}",
        start=start,
        flat=grid(rows, cols),
        rest=rest,
    )


def _cylinder():
    """Nodes equally spaced in x on an arc that is longer than its chord by 2.6 pitches."""
    flat, points = cylinder()
    return Case(
        name="cylinder, 128 x 96",
        start=flat,
        flat=unrolled(flat),
        rest=rest_lengths(points),
    )
