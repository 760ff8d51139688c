"""Time of the flattening in units of one spring-force evaluation, its accuracy, and other solvers on the same sheets.

``python -m benchmarks flattening [all | speed | sizes | exact | masks | slopes | peers | threads | sheet]``
"""

from __future__ import annotations

import subprocess
import sys
import time
from functools import partial

import numpy as np
from scipy import ndimage

from benchmarks import surfaces
from benchmarks._unit import Unit
from benchmarks.shared import forget_peak, memory
from planish.core.threads import available, limit_threads
from planish.flatten import RelaxationParams, relax_grid

SIZES = {"S": (24, 32), "M": (96, 128), "L": (384, 512), "XL": (1536, 2048)}


def timed(call, repeats=5):
    """Median seconds of ``repeats`` calls after one that is not counted, and the last answer."""
    answer = call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        answer = call()
        times.append(time.perf_counter() - began)
    return float(np.median(times)), answer


def speed(repeats=7):
    """Whole call of ``relax_grid`` (chords and arcs), and excess of its energy over a run to 1e-11."""
    print(
        "\nspeed: whole call, two threads above M\nsheet        nodes   rest      ms   units  excess   steps  outcome"
    )
    for name in ("M", "L", "XL"):
        rows, cols = SIZES[name]
        threads = 1 if rows * cols < 100_000 else available()
        unit = Unit(rows, cols, threads)
        for kind in ("smooth", "rough"):
            points = getattr(surfaces, kind)(rows, cols)
            for rest in ("chord", "arc"):
                best = relax_grid(points, rest=rest, tolerance=1e-11).energy
                one = timed(unit, repeats)[0]
                seconds, found = timed(lambda p=points, r=rest: relax_grid(p, rest=r), repeats)
                one = 0.5 * (one + timed(unit, repeats)[0])
                print(f"{kind:<8}{name:>3}{rows * cols:>9} {rest:>6}{1e3 * seconds:>9.1f}{seconds / one:>7.1f}"
                      f"{found.energy / best - 1:>9.0e}{found.steps:>6}   {found.outcome.name}")  # fmt: skip


def sizes(repeats=5, largest=8192):
    """Nanoseconds a node and bytes a node from 128 x 96 to 8192 x 6144, each in a process of its own."""
    print("\nsizes: rough sheets, arcs\n cols x rows      nodes  ns/node  bytes/node beyond the input")
    for cols in (128, 256, 512, 1024, 2048, 4096, 8192):
        if cols <= largest:
            _alone("_size", cols, repeats)


def _alone(name, *args):
    code = f"from benchmarks import flattening; flattening.{name}(*{args!r})"
    sys.stdout.flush()
    subprocess.run([sys.executable, "-c", code], check=True)


def _size(cols, repeats):
    rows = cols * 3 // 4
    relax_grid(surfaces.rough(96, 128))
    points = surfaces.rough(rows, cols)
    before = forget_peak()
    found = relax_grid(points)
    grown = memory(peak=True) - before
    seconds = timed(lambda: relax_grid(points), repeats if cols < 4000 else max(1, repeats - 3))[0]
    nodes = rows * cols
    print(f"{cols:>5} x {rows:<5}{nodes:>10}{1e9 * seconds / nodes:>9.0f}{grown / nodes:>9.0f}   "
          f"{seconds:.3f} s, {found.steps} steps, {found.outcome.name}")  # fmt: skip


def exact():
    """Error against analytic truth on developable sheets with slopes to 45 degrees."""
    print("\nexact: rms error of place, pitches\nrulings        size    chord      arc    limit")
    for name, limit in (("M", 3e-4), ("L", 5e-5)):
        for label, angle in (("along columns", 0.0), ("along rows", np.pi / 2), ("30 degrees", np.pi / 6)):
            points, truth = surfaces.developable(*SIZES[name], angle=angle)
            errors = [surfaces.misplaced(relax_grid(points, rest=r).uv, truth) for r in ("chord", "arc")]
            print(f"{label:<15}{name:>4}{errors[0]:>9.1e}{errors[1]:>9.1e}{limit:>9.0e}")


def masks():
    """The same with holes, a torn outline, single missing nodes, and heights that are grossly wrong but doubted."""
    print("\nmasks: rms error of place, pitches\nsheet       size   whole   holes    torn  salt     doubted  limit")
    for name, limit in (("M", 6e-4), ("L", 1e-4)):
        rows, cols = SIZES[name]
        for label, angle in (("along columns", 0.0), ("30 degrees", np.pi / 6)):
            points, truth = surfaces.developable(rows, cols, angle=angle)
            errors = [surfaces.misplaced(relax_grid(points).uv, truth)]
            salt = np.random.default_rng(3).random((rows, cols)) < 0.1
            gaps = (holes(rows, cols, 7.0), torn(rows, cols), salt)
            errors += [surfaces.misplaced(relax_grid(_without(points, gone)).uv, truth) for gone in gaps]
            rng = np.random.default_rng(1)
            wrong = rng.random((rows, cols)) < 1 / 7
            bad = points.copy()
            bad[wrong, 2] += rng.normal(scale=20.0, size=np.count_nonzero(wrong))
            errors.append(surfaces.misplaced(relax_grid(bad, weights=np.where(wrong, 1e-3, 1.0)).uv, truth))
            print(f"{label:<14}{name:>2}" + "".join(f"{e:>8.0e}" for e in errors) + f"{limit:>8.0e}")


def holes(rows, cols, radius, share=0.1, seed=0):
    """Round holes that take ``share`` of the nodes; 170 um across at a pitch of 12 um is a radius of 7."""
    rng = np.random.default_rng(seed)
    gone = np.zeros((rows, cols), dtype=bool)
    y, x = np.mgrid[:rows, :cols]
    while gone.mean() < share:
        gone |= (y - rng.uniform(0, rows)) ** 2 + (x - rng.uniform(0, cols)) ** 2 < radius**2
    return gone


def torn(rows, cols, seed=0):
    """Outside of four random walks, a sixth of the sheet deep."""
    rng = np.random.default_rng(seed)

    def edge(count, depth):
        walk = np.cumsum(rng.normal(size=count))
        walk -= np.linspace(walk[0], walk[-1], count)
        return depth * (walk - walk.min()) / np.ptp(walk)

    y, x = np.mgrid[:rows, :cols]
    inside = (x >= edge(rows, cols / 6)[:, None]) & (x <= cols - 1 - edge(rows, cols / 6)[:, None])
    return ~(inside & (y >= edge(cols, rows / 6)) & (y <= rows - 1 - edge(cols, rows / 6)))


def _without(points, gone):
    labels = ndimage.label(~gone, structure=np.ones((3, 3)))[0]
    keep = labels == 1 + np.argmax(np.bincount(labels.ravel())[1:])
    return np.where(keep[..., None], points, np.nan)


def slopes():
    """Energy and folds on ever rougher sheets, and growth of the map by roughness."""
    print("\nslopes (L, chords)\nRMS slope  energy/spring  growth %  steps  inverted  marked  outcome")
    rows, cols = SIZES["L"]
    size = _spread(relax_grid(surfaces.smooth(rows, cols), rest="chord").uv)
    for slope in (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0):
        found = relax_grid(surfaces.rough(rows, cols, slope=slope), rest="chord")
        growth = 100 * (_spread(found.uv) / size - 1)
        print(f"{slope:>8}{found.energy / found.springs:>14.3e}{growth:>11.2f}{found.steps:>7}{_inverted(found.uv):>9}"
              f"{int(found.folded.sum()):>8}   {found.outcome.name}")  # fmt: skip


def _spread(uv):
    return np.sqrt(np.nanmean(np.sum((uv - np.nanmean(uv, axis=(0, 1))) ** 2, axis=-1)))


def _inverted(uv):
    a, b, c, d = uv[:-1, :-1], uv[:-1, 1:], uv[1:, 1:], uv[1:, :-1]
    p, q, s = b - a, c - a, d - a
    first, second = p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0], q[..., 0] * s[..., 1] - q[..., 1] * s[..., 0]
    return int(np.count_nonzero((first <= 0) | (second <= 0)))


def springs(rows, cols):
    """Numbers of the nodes at both ends of each spring of a grid."""
    number = np.arange(rows * cols).reshape(rows, cols)
    pairs = [
        (number[:, :-1], number[:, 1:]), (number[:-1], number[1:]), (number[:-1, :-1], number[1:, 1:]),
        (number[:-1, 1:], number[1:, :-1]),
    ]  # fmt: skip
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
    """Other solvers on the same sheet: the paper's relaxation, scipy's least squares, and libigl where installed."""
    rows, cols = SIZES[name]
    print(f"\npeers ({name}, chords)\nsheet    solver                     seconds   ratio  energy / lowest  inverted")
    for kind in ("smooth", "rough"):
        points = getattr(surfaces, kind)(rows, cols)
        rests = {
            "planish multigrid": partial(_relaxed, points),
            "planish relaxation": partial(_relaxed, points, method=RelaxationParams(stop="residual")),
            "scipy least_squares": partial(_least_squares, points),
            "libigl ARAP": partial(_igl, points, "ARAP"), "libigl SLIM": partial(_igl, points, "SLIM"),
        }  # fmt: skip
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
            print(f"{kind:<9}{solver:<25}{seconds:>9.4f}{seconds / rows_out[0][1]:>8.0f}{energy / lowest:>14.6f}"
                  f"{inverted:>9}")  # fmt: skip


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
        return sparse.csr_array((np.hstack([-d, d]).ravel(), (line, column)), shape=(i.size, x.size))

    start = points[..., :2].ravel()
    found = least_squares(residuals, start, jac=jacobian, tr_solver="lsmr", ftol=1e-7).x
    return found.reshape(*points.shape[:2], 2)


def _igl(points, kind):
    import igl

    rows, cols = points.shape[:2]
    number = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = (k.ravel() for k in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
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
        data = igl.slim_precompute(*columns, igl.MappingEnergyType.SYMMETRIC_DIRICHLET, none, nowhere, 0.0)
        uv = igl.slim_solve(data, 20)
    return np.asarray(uv)[:, :2].reshape(rows, cols, 2)


def threads():
    """Same bytes for any number of threads; relative change with the unit of length."""
    points = surfaces.rough(*SIZES["L"])
    found = []
    for number in (1, 2, 3, 7):
        with limit_threads(number):
            found.append(relax_grid(points))
    one, *others = found
    same = all(np.array_equal(other.uv, one.uv) for other in others)
    print(f"\nthreads: same bytes with 1, 2, 3 and 7 threads: {same}")
    for unit in (1e-6, 1e6):
        other = relax_grid(points * unit)
        print(f"unit x {unit:g}: largest relative difference "
              f"{np.abs(other.uv / unit - one.uv).max() / np.abs(one.uv).max():.1e}")  # fmt: skip


def sheet(cols=14_142, rows=10_607):
    """A whole sheet, A4 at some 20 um: 150 M nodes."""
    print("\nsheet: 150 M nodes, float64 points")
    _alone("_sheet", rows, cols)


def _sheet(rows, cols):
    relax_grid(surfaces.rough(96, 128))
    points = np.empty((rows, cols, 3))
    points[..., 0], points[..., 1] = np.arange(cols), np.arange(rows)[:, None]
    tile = surfaces.roughness(1024, 1024)
    for i in range(0, rows, 1024):
        n = min(1024, rows - i)
        across, down = 4 * np.pi * np.arange(cols) / cols, 2 * np.pi * np.arange(i, i + n) / rows
        wave = 300 * np.sin(across) * np.cos(down)[:, None]
        points[i : i + n, :, 2] = wave + np.tile(tile, (1, -(-cols // 1024)))[:n, :cols]
    forget_peak()
    began = time.perf_counter()
    found = relax_grid(points)
    seconds, peak = time.perf_counter() - began, memory(peak=True) / 1e9
    print(f"{rows} x {cols} = {rows * cols / 1e6:.0f} M nodes: {seconds:.1f} s, peak of the process {peak:.1f} GB, "
          f"{found.steps} steps, {found.outcome.name}")  # fmt: skip


def main(part="all"):
    parts = {k.__name__: k for k in (exact, masks, slopes, threads, speed, peers, sizes, sheet)}
    for name in parts if part == "all" else [part]:
        parts[name]()
    return 0
