"""How right the flattening is on developable sheets, time and memory by size, and other solvers on
the same sheets.

``python -m benchmarks flattening [all | exact | peers | sizes] [largest]``
"""

from __future__ import annotations

import subprocess
import sys
import time
from functools import partial

import numpy as np

from benchmarks import surfaces
from benchmarks.shared import forget_peak, memory
from planish.flatten import RelaxationParams, relax_grid

SIZES = {"M": (96, 128), "L": (384, 512)}


def timed(call, repeats=5):
    """Median seconds of ``repeats`` calls after one that is not counted, and the last answer."""
    answer = call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        answer = call()
        times.append(time.perf_counter() - began)
    return float(np.median(times)), answer


def sizes(largest, repeats=5):
    """Nanoseconds a node and bytes a node from 128 x 96 to 8192 x 6144, each in a process of its
    own."""
    print(
        "\nsizes: rough sheets, arcs\n cols x rows      nodes  ns/node  bytes/node beyond the input"
    )
    for cols in (128, 256, 512, 1024, 2048, 4096, 8192):
        if cols <= largest:
            code = f"from benchmarks.flattening import _size; _size({cols}, {repeats})"
            sys.stdout.flush()
            subprocess.run([sys.executable, "-c", code], check=True)
    return 0


def _size(cols, repeats):
    rows = cols * 3 // 4
    relax_grid(surfaces.rough(96, 128))
    points = surfaces.rough(rows, cols)
    before = forget_peak()
    found = relax_grid(points)
    grown = memory(peak=True) - before
    seconds = timed(lambda: relax_grid(points), repeats if cols < 4000 else max(1, repeats - 3))[0]
    nodes = rows * cols
    print(
        f"{cols:>5} x {rows:<5}{nodes:>10}{1e9 * seconds / nodes:>9.0f}{grown / nodes:>9.0f}   "
        f"{seconds:.3f} s, {found.steps} steps, {found.outcome.name}"
    )


def exact():
    """Error against analytic truth on developable sheets with slopes to 45 degrees."""
    print("\nexact: rms error of place, pitches\nrulings        size    chord      arc    limit")
    missed = 0
    for name, limit in (("M", 3e-4), ("L", 5e-5)):
        for label, angle in (
            ("along columns", 0.0),
            ("along rows", np.pi / 2),
            ("30 degrees", np.pi / 6),
        ):
            points, truth = surfaces.developable(*SIZES[name], angle=angle)
            errors = [
                surfaces.misplaced(relax_grid(points, rest=r).uv, truth) for r in ("chord", "arc")
            ]
            print(f"{label:<15}{name:>4}{errors[0]:>9.1e}{errors[1]:>9.1e}{limit:>9.0e}")
            missed += errors[1] > limit
    return missed


def _inverted(uv):
    a, b, c, d = uv[:-1, :-1], uv[:-1, 1:], uv[1:, 1:], uv[1:, :-1]
    p, q, s = b - a, c - a, d - a
    first, second = (
        p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0],
        q[..., 0] * s[..., 1] - q[..., 1] * s[..., 0],
    )
    return int(np.count_nonzero((first <= 0) | (second <= 0)))


def springs(rows, cols):
    """Numbers of the nodes at both ends of each spring of a grid."""
    number = np.arange(rows * cols).reshape(rows, cols)
    pairs = [
        (number[:, :-1], number[:, 1:]),
        (number[:-1], number[1:]),
        (number[:-1, :-1], number[1:, 1:]),
        (number[:-1, 1:], number[1:, :-1]),
    ]
    return (np.concatenate([pair[k].ravel() for pair in pairs]) for k in (0, 1))


def lengths(points, i, j):
    """Distances of nodes, which are the last axis but one."""
    flat = points.reshape(-1, points.shape[-1])
    return np.linalg.norm(flat[j] - flat[i], axis=1)


def spring_energy(points, uv):
    """Sum of (l - L)^2 with chords, for any map of the grid."""
    i, j = springs(*points.shape[:2])
    return float(np.nansum((lengths(uv, i, j) - lengths(points, i, j)) ** 2))


def peers(name="M"):
    """Other solvers on the same sheet: the paper's relaxation, scipy's least squares, and libigl
    where installed."""
    rows, cols = SIZES[name]
    print(
        f"\npeers ({name}, chords)\nsheet    solver                     seconds   ratio  energy /"
        " lowest  inverted"
    )
    for kind in ("smooth", "rough"):
        points = getattr(surfaces, kind)(rows, cols)
        rests = {
            "planish multigrid": partial(_relaxed, points),
            "planish relaxation": partial(
                _relaxed, points, method=RelaxationParams(stop="residual")
            ),
            "scipy least_squares": partial(_least_squares, points),
            "libigl ARAP": partial(_igl, points, "ARAP"),
            "libigl SLIM": partial(_igl, points, "SLIM"),
        }
        rows_out = []
        for solver, call in rests.items():
            try:
                seconds, uv = timed(call, 5 if solver.startswith("planish") else 1)
            except ImportError as error:
                print(f"{kind:<9}{solver:<25} not installed ({error.name})")
                continue
            rows_out.append((solver, seconds, spring_energy(points, uv), _inverted(uv)))
        lowest = min(row[2] for row in rows_out)
        for solver, seconds, energy, inverted in rows_out:
            print(
                f"{kind:<9}{solver:<25}{seconds:>9.4f}{seconds / rows_out[0][1]:>8.0f}"
                f"{energy / lowest:>14.6f}{inverted:>9}"
            )
    return 0


def _relaxed(points, **options):
    return relax_grid(points, rest="chord", **options).uv


def _least_squares(points):
    from scipy import sparse
    from scipy.optimize import least_squares

    i, j = springs(*points.shape[:2])
    rest = lengths(points, i, j)

    def residuals(x):
        return lengths(x.reshape(-1, 2), i, j) - rest

    def jacobian(x):
        uv = x.reshape(-1, 2)
        d = uv[j] - uv[i]
        d /= np.linalg.norm(d, axis=1)[:, None]
        line = np.repeat(np.arange(i.size), 4)
        column = np.stack([2 * i, 2 * i + 1, 2 * j, 2 * j + 1], axis=1).ravel()
        return sparse.csr_array(
            (np.hstack([-d, d]).ravel(), (line, column)), shape=(i.size, x.size)
        )

    start = points[..., :2].ravel()
    found = least_squares(residuals, start, jac=jacobian, tr_solver="lsmr", ftol=1e-7).x
    return found.reshape(*points.shape[:2], 2)


def _igl(points, kind):
    import igl

    rows, cols = points.shape[:2]
    number = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = (
        k.ravel() for k in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1])
    )
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    v = np.ascontiguousarray(points.reshape(-1, 3))
    start = np.ascontiguousarray(v[:, :2])
    if kind == "ARAP":
        middle = np.array([rows * cols // 2], dtype=np.int32)
        data = igl.ARAPData()
        data.max_iter = 100
        igl.arap_precomputation(v, faces, 2, middle, data)
        uv = igl.arap_solve(start[middle], data, start)
    else:
        columns = [np.asfortranarray(k) for k in (v, faces.astype(np.int32), start)]
        none, nowhere = np.zeros(0, dtype=np.int32), np.zeros((0, 2), order="F")
        data = igl.slim_precompute(
            *columns, igl.MappingEnergyType.SYMMETRIC_DIRICHLET, none, nowhere, 0.0
        )
        uv = igl.slim_solve(data, 20)
    return np.asarray(uv)[:, :2].reshape(rows, cols, 2)


def main(part="all", largest=8192):
    """Print the tables; the number of limits that were missed."""
    parts = {k.__name__: k for k in (exact, peers, sizes)}
    missed = 0
    for name in parts if part == "all" else [part]:
        missed += parts[name](int(largest)) if name == "sizes" else parts[name]()
    return missed
