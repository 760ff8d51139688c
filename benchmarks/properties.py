"""Columns a second of every property along the rays, on a tilted and wavy sheet, and the memory of one run.

``python -m benchmarks properties [rows] [columns] [threads]``
"""

from __future__ import annotations

import os
import time
import tracemalloc

import numpy as np
import xarray as xr

from planish.core.tiles import Engine
from planish.measure import MeasureParams, measure_along_rays, registered
from planish.measure.properties import each_tile, ray_frame

VOXEL_UM = 3.0
DEPTH = 80
AIR, BASE, COAT = 40.0, 90.0, 200.0
_LEAST = 0.03  # Mcolumn/s of the slowest on one thread: ten million columns then take six minutes


def sheet(rows: int, cols: int) -> tuple[xr.DataArray, xr.Dataset]:
    """A noisy sheet of 85 um in voxels of 3 um, bent by waves, with its surfaces."""
    y, x, z = (VOXEL_UM * np.arange(n) for n in (rows, cols, DEPTH))
    centre = 120 + 20 * np.sin(x / 700)[None, :] + 15 * np.sin(y / 500)[:, None]
    offsets = {"top": 42.5, "interface_top": 27.5, "interface_bottom": -27.5, "bottom": -42.5, "centre": 0.0}
    values = np.empty((DEPTH, rows, cols), np.uint8)
    rng = np.random.default_rng(0)
    for k in range(DEPTH):
        away = np.abs(z[k] - centre)
        grey = np.where(away < 27.5, BASE, np.where(away < 42.5, COAT, AIR))
        values[k] = np.clip(grey + 12 * rng.standard_normal(grey.shape, dtype=np.float32), 0, 255)
    coords = {"z": z, "y": y, "x": x}
    data = {name: (("y", "x"), centre + offset) for name, offset in offsets.items()}
    data["status"] = (("y", "x"), np.zeros((rows, cols), np.uint8))
    attrs = {
        "through": "z", "top_side": "high", "grey_air": AIR, "grey_base": BASE, "grey_coating_top": COAT,
        "grey_coating_bottom": COAT, "grey_noise": 12.0, "polarity": 1.0, "blur_um": 1.5,
    }  # fmt: skip
    surfaces = xr.Dataset(data, coords={"y": y, "x": x}, attrs=attrs)
    return xr.DataArray(values, dims=("z", "y", "x"), coords=coords), surfaces


def main(rows: int = 600, cols: int = 1000, threads: int = 0) -> int:
    """Print the table; return 1 when a property would take more than six minutes for ten million columns."""
    threads = threads or min(os.cpu_count() or 1, 8)
    options = MeasureParams(coating_g_cm3=1.6, base_g_cm3=0.75, filler_g_cm3=2.7, ink_grey=(150.0, 256.0))
    small = sheet(40, 60)
    names = [name for name, one in registered().items() if one.function.__module__.startswith("planish.")]
    loose = MeasureParams(
        coating_g_cm3=1.6, base_g_cm3=0.75, filler_g_cm3=2.7, ink_grey=(150.0, 256.0), l_filter_um=50.0,
        pore_limit_um=10.0, orientation_rho_um=5.0,
    )  # fmt: skip
    measure_along_rays(*small, names=names, params=loose)  # compiles
    volume, surfaces = sheet(rows, cols)
    million = rows * cols / 1e6
    print(f"{rows} x {cols} columns of {DEPTH} voxels, load {os.getloadavg()[0]:.2f}")
    print(f"{'Mcolumn/s on so many threads':28s} {1:8d} {threads:8d}")
    begun = time.perf_counter()
    frame = ray_frame(volume, surfaces, options)
    print(f"{'where the rays meet the faces':28s} {million / (time.perf_counter() - begun):8.2f}")
    rates = [
        _rate(lambda n=n: each_tile(volume, frame, lambda *_: None, engine=Engine(threads=n)), million)
        for n in (1, threads)
    ]
    print(f"{'straightened':28s} {rates[0]:8.2f} {rates[1]:8.2f}   {frame.samples * rates[0]:.0f} Mvoxel/s on 1 thread")
    slowest = np.inf
    for name in names:

        def measure(count: int, name: str = name) -> None:
            measure_along_rays(volume, surfaces, names=[name], params=options, engine=Engine(threads=count))

        rates = [_rate(lambda n=n, one=measure: one(n), million) for n in (1, threads)]
        slowest = min(slowest, rates[0])
        print(f"{name:28s} {rates[0]:8.2f} {rates[1]:8.2f}", flush=True)
    tracemalloc.start()
    measure_along_rays(
        volume, surfaces, names=["porosity", "absorption"], params=options, engine=Engine(memory_bytes=1 << 29)
    )
    print(f"porosity and absorption in tiles of 256 MiB: {tracemalloc.get_traced_memory()[1] / 2**20:.0f} MiB at most")
    tracemalloc.stop()
    return int(slowest < _LEAST)


def _rate(work, million: float) -> float:
    begun = time.perf_counter()
    work()
    return million / (time.perf_counter() - begun)
