"""A field on a warped mesh to as many pixels: planish beside scipy's LinearNDInterpolator, in one run on the same data.

``python -m benchmarks resampling [rows] [columns]``
"""

from __future__ import annotations

import os
import time
import tracemalloc
from resource import RUSAGE_SELF, getrusage
from statistics import median
from typing import TypeVar

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from planish.core.grid import Grid
from planish.core.threads import limit_threads
from planish.core.typing import Floats
from planish.resample import find_places, resample

Result = TypeVar("Result")

_PITCH_UM = 4.0
_TIMES = 9
_LEAST_RATIO = 50.0
_MOST_ERROR = 1e-9  # of the values, on a field that is affine in the plane


def mesh(rows: int, cols: int, *, seed: int = 0) -> Floats:
    """A mesh with long waves of two pitches and a roughness of a fifth of a pitch to each side; nowhere folded."""
    y, x = np.mgrid[0:rows, 0:cols].astype(np.float64)
    rough = np.random.default_rng(seed).uniform(-0.2, 0.2, (rows, cols, 2))
    smooth = np.stack([2.0 * np.sin(y / 90), 1.5 * np.cos(x / 70)], axis=-1)
    return _PITCH_UM * (np.stack([x, y], axis=-1) + smooth + rough)


def turned(uv: Floats, degrees: float) -> Floats:
    """The mesh turned about its middle."""
    a = np.deg2rad(degrees)
    middle = uv.mean(axis=(0, 1))
    return (uv - middle) @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) + middle


def main(rows: int = 2048, cols: int = 1536) -> int:
    """Print the table; return 1 when planish is not 50 times as fast or not exact to 1e-9."""
    uv = mesh(rows, cols)
    affine = 0.3 * uv[..., 0] - 0.2 * uv[..., 1] + 5000.0
    v, u = (_PITCH_UM * np.arange(n) for n in (rows, cols))
    truth = 0.3 * u[None, :] - 0.2 * v[:, None] + 5000.0

    def find(threads=None, mesh=uv):
        with limit_threads(threads):
            return find_places(mesh, Grid.regular((rows, cols), _PITCH_UM))

    def values(threads=None):
        with limit_threads(threads):
            return resample(affine, places)

    processors = os.cpu_count() or 1
    print(f"{rows} x {cols} nodes to as many pixels, {processors} processors, load {os.getloadavg()[0]:.2f}; seconds")
    print(f"medians of {_TIMES} runs of planish, one run of scipy")
    begun = time.perf_counter()
    places = find()
    ours = resample(affine, places)
    print(f"{'first call, compiled or from the cache':44s} {time.perf_counter() - begun:9.3f}")
    both = []
    for threads in sorted({1, processors}):
        finding, _ = _timed(lambda threads=threads: find(threads))
        sampling, _ = _timed(lambda threads=threads: values(threads))
        both.append(finding + sampling)
        _row(f"planish, threads {threads}: places + values", finding, sampling)
    for degrees in (30.0, 90.0):
        other = turned(uv, degrees)
        seconds, _ = _timed(lambda other=other: find(None, other))
        print(f"{f'places, mesh turned by {degrees:.0f} degrees':44s} {seconds:9.3f}")
    peak = _peak(lambda: resample(affine, find()))

    before = getrusage(RUSAGE_SELF).ru_maxrss
    begun = time.perf_counter()
    # What the interpolator does with bare points; apart, so that the two parts can be timed.
    triangles = Delaunay(uv.reshape(-1, 2))
    triangulated = time.perf_counter()
    theirs = LinearNDInterpolator(triangles, affine.reshape(-1))(u[None, :], v[:, None])
    done = time.perf_counter()
    _row("scipy: triangulation + values", triangulated - begun, done - triangulated)
    grown = (getrusage(RUSAGE_SELF).ru_maxrss - before) / 1024
    ratio = (done - begun) / both[-1]
    print(f"{'times as fast':44s} {'':9s} {'':9s} {ratio:9.0f}")
    known = np.isfinite(ours)
    common = known & np.isfinite(theirs)
    scale = float(np.abs(truth).max())
    errors = [float(np.abs(a - b)[k].max()) / scale for a, b, k in ((ours, truth, known), (ours, theirs, common))]
    print(f"largest error of planish {errors[0]:.1e}, difference from scipy {errors[1]:.1e} of the largest value")
    print(
        f"pixels known: planish {known.mean():.4f}, scipy {np.isfinite(theirs).mean():.4f}; overlaps {places.overlaps}"
    )
    print(f"memory: planish {peak:.0f} MiB at most, scipy {grown:.0f} MiB on top of what the process had before")
    return int(ratio < _LEAST_RATIO or max(errors) > _MOST_ERROR)


def _timed(work):
    """Median of the seconds that the work takes, and what it gives."""
    seconds = []
    for _ in range(_TIMES - 1):
        begun = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begun)
    begun = time.perf_counter()
    result = work()
    return median([*seconds, time.perf_counter() - begun]), result


def _peak(work):
    """Most MiB that arrays took during the work, its result included and what it was given not."""
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 2**20


def _row(name, first, second):
    print(f"{name:44s} {first:9.3f} {second:9.3f} {first + second:9.3f}", flush=True)
