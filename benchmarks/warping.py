"""A large image warped by a similarity and by a thin-plate spline: pixels a second, processor time and peak memory.

``python -m benchmarks warping [rows] [columns] [runs]``

Every case is a process of its own, which holds the source and the result in memory. The spline is fitted to 20 marks
and used backwards, which is the dear way. Pixels are counted twice: those of the source under the target, which is the
larger number where it is reduced, and those of the target.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from multiprocessing import get_context
from resource import RUSAGE_SELF, getrusage
from statistics import median

import numpy as np
from numpy.typing import NDArray

from planish.core.grid import Grid
from planish.core.threads import limit_threads
from planish.core.transform import Similarity
from planish.register import fit_transform
from planish.resample import warp_image

Floats = NDArray[np.float64]

_PIXEL_UM = 0.5
_BUDGET = 2_000_000_000
_LEAST_RATE = 50e6  # of the larger of the two counts, a second
_CASES = [(transformation, reduction) for reduction in (1, 2, 3) for transformation in ("similarity", "tps")]


def picture(rows: int, cols: int) -> NDArray[np.float32]:
    """Waves and noise, made row by row so that the making takes no more memory than the image."""
    rng = np.random.default_rng(0)
    top = 250.0
    across = np.sin(np.arange(cols) / 40)
    noise = rng.uniform(0, 0.3, cols + 997)
    out = np.empty((rows, cols), dtype=np.float32)
    for r in range(rows):
        shift = r * 37 % 997
        out[r] = top * (0.35 + 0.3 * np.sin(r / 55) * across + noise[shift : shift + cols])
    return out


def backwards(name: str, rows: int, cols: int) -> Callable[[Floats], Floats]:
    """From the target to the source: turned by 3 degrees about the middle, or bent by up to some 20 pixels."""
    middle = 0.5 * _PIXEL_UM * np.array([cols - 1, rows - 1])
    plain = Similarity(rotation_rad=np.deg2rad(3.0))
    shift = middle - plain(middle)
    turn = Similarity(rotation_rad=plain.rotation_rad, shift_um=(float(shift[0]), float(shift[1])))
    if name == "similarity":
        return turn.inverse
    size = _PIXEL_UM * np.array([cols, rows])
    marks = np.random.default_rng(1).uniform((0, 0), size, (20, 2))
    bent = turn(marks) + 20 * _PIXEL_UM * np.sin(2.5 * np.pi * marks[:, ::-1] / size)
    return fit_transform(marks, bent, model="tps").transform.inverse


def measure(
    transformation: str, reduction: int, rows: int, cols: int, runs: int, threads: int | None = None
) -> dict[str, float]:
    """Seconds, processor seconds (medians) and peak memory of one case, the process's own included."""
    source = picture(rows, cols)
    to_source = backwards(transformation, rows, cols)
    shape = rows // reduction, cols // reduction
    pixel = _PIXEL_UM * reduction
    corner = 0.5 * (pixel - _PIXEL_UM)
    grid = Grid.regular(shape, pixel, (corner, corner))
    free = _BUDGET - getrusage(RUSAGE_SELF).ru_maxrss * 1024  # which holds the source

    def once() -> tuple[float, float, float]:
        begun, used = time.perf_counter(), time.process_time()
        with limit_threads(threads):
            warped = warp_image(source, grid, to_source, pixel_um=(_PIXEL_UM, _PIXEL_UM), memory_bytes=free)
        seconds, cpu = time.perf_counter() - begun, time.process_time() - used
        return seconds, cpu, float(np.isfinite(warped).mean())

    once()  # compiled, or from the cache
    found = [once() for _ in range(runs)]
    return {
        "seconds": median(f[0] for f in found), "cpu": median(f[1] for f in found), "valid": found[0][2],
        "peak": getrusage(RUSAGE_SELF).ru_maxrss * 1024,
    }  # fmt: skip


def main(rows: int = 10944, cols: int = 14592, runs: int = 5) -> int:
    """Print the table; the number of cases that are too slow or take too much memory."""
    print(f"{rows} x {cols} pixels, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}; medians of {runs} runs")
    print("Mpixel/s by the clock, and by the processor time shared out evenly; of the source | of the target")
    missed = 0
    for transformation, reduction in _CASES:
        with get_context("spawn").Pool(1) as pool:
            found = pool.apply(measure, (transformation, reduction, rows, cols, runs))
        target = (rows // reduction) * (cols // reduction)
        under = target * reduction**2
        evenly = found["cpu"] / (os.cpu_count() or 1)
        missed += under / found["seconds"] < _LEAST_RATE or found["peak"] > _BUDGET
        print(
            f"{transformation:10s} {'bilinear' if reduction == 1 else f'area {reduction}x':9s}"
            f"{found['seconds']:7.2f} s {found['cpu']:7.2f} s cpu"
            f"{under / found['seconds'] / 1e6:8.0f} {under / evenly / 1e6:6.0f} |"
            f"{target / found['seconds'] / 1e6:6.0f} {target / evenly / 1e6:6.0f}"
            f"{found['peak'] / 1e6:8.0f} MB, valid {found['valid']:.3f}",
            flush=True,
        )
    return missed
