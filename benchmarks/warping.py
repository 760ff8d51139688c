"""A large image warped by a similarity and by a thin-plate spline: pixels a second, processor time and peak memory.

``python -m benchmarks warping [rows] [columns] [runs]``

Each is a process of its own, which holds the source and the result in memory. The spline is fitted to 20 marks and used
backwards, which is the dear way.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from multiprocessing import get_context
from statistics import median

import numpy as np

from benchmarks.shared import memory
from planish.core.grid import Grid
from planish.core.threads import available
from planish.core.transform import Similarity, nearest_similarity
from planish.core.typing import Floats
from planish.register import fit_transform
from planish.resample import warp_image

_PIXEL_UM = 0.5
_BUDGET = 2_000_000_000
_LEAST_RATE = 50e6  # pixels a second


def picture(rows: int, cols: int) -> Floats:
    """Waves and noise, made row by row so that the making takes no more memory than the image."""
    across = np.sin(np.arange(cols) / 40)
    noise = np.random.default_rng(0).uniform(0, 0.3, cols + 997)
    out = np.empty((rows, cols), dtype=np.float32)
    for r in range(rows):
        shift = r * 37 % 997
        out[r] = 250.0 * (0.35 + 0.3 * np.sin(r / 55) * across + noise[shift : shift + cols])
    return out


def backwards(name: str, rows: int, cols: int) -> Callable[[Floats], Floats]:
    """From the target to the source: turned by 3 degrees about the middle, or bent by up to some 20 pixels."""
    size = _PIXEL_UM * np.array([cols, rows])
    middle = 0.5 * (size - _PIXEL_UM)
    turn = nearest_similarity(Similarity(rotation_rad=np.deg2rad(3.0)).matrix(), middle, middle)
    if name == "similarity":
        return turn.inverse
    marks = np.random.default_rng(1).uniform((0, 0), size, (20, 2))
    bent = turn(marks) + 20 * _PIXEL_UM * np.sin(2.5 * np.pi * marks[:, ::-1] / size)
    return fit_transform(marks, bent, model="tps").transform.inverse


def measure(name: str, rows: int, cols: int, runs: int) -> tuple[float, float, float]:
    """Seconds, processor seconds (medians) and peak memory of one case, the process's own included."""
    source, to_source = picture(rows, cols), backwards(name, rows, cols)
    grid = Grid.regular((rows, cols), _PIXEL_UM)
    free = int(_BUDGET - memory())  # which holds the source
    seconds, cpu = list[float](), list[float]()
    for _ in range(1 + runs):  # the first compiles, or takes from the cache
        begun, used = time.perf_counter(), time.process_time()
        warp_image(source, grid, to_source, pixel_um=(_PIXEL_UM, _PIXEL_UM), memory_bytes=free)
        seconds.append(time.perf_counter() - begun)
        cpu.append(time.process_time() - used)
    return median(seconds[1:]), median(cpu[1:]), memory(peak=True)


def main(rows: int = 10944, cols: int = 14592, runs: int = 5) -> int:
    """Print the table; the number of cases that are too slow or take too much memory."""
    print(f"{rows} x {cols} pixels, {available()} threads, load {os.getloadavg()[0]:.1f}; medians of {runs} runs")
    print("Mpixel/s by the clock, and by the processor time shared out evenly")
    missed = 0
    for name in ("similarity", "tps"):
        with get_context("spawn").Pool(1) as pool:
            seconds, cpu, peak = pool.apply(measure, (name, rows, cols, runs))
        missed += rows * cols / seconds < _LEAST_RATE or peak > _BUDGET
        rates = [rows * cols / taken / 1e6 for taken in (seconds, cpu / available())]
        print(
            f"{name:10s}{seconds:7.2f} s {cpu:7.2f} s cpu{rates[0]:8.0f} {rates[1]:6.0f}{peak / 1e6:8.0f} MB",
            flush=True,
        )
    return missed
