"""A map of 160 million pixels as files of other programs: peak memory, and speed against writing its bytes.

    python -m benchmarks exporting [--mpixel 160] [--folder DIR] [--times 3]

The map is noise with holes, in a store as a link makes it. Each format is written by a process of its own, which reads
the store and counts the time from the call of ``planish.export`` to its end. Before and after it, another process that
holds the same array writes it raw and waits until it is on the disk (fsync): the speed is that of the two together.
Importing the libraries, some 2 s at the first call of a process, is not counted. Linux only.
"""

from __future__ import annotations

import json
import math
import shutil
import statistics
import subprocess
import sys
from pathlib import Path

import numpy as np
import xarray as xr

from benchmarks.shared import folder_for, options, size_of
from planish.core.grid import Grid
from planish.io.map_groups import write_tree
from planish.io.map_store import StoredMaps, map_tiles
from planish.register.params import RegistrationParams
from planish.run import link
from planish.synthetic import BurnParams, CameraParams, ScannerParams, SpecimenParams, make_specimen, write_instruments

FORMATS = {"tiff": ".tif", "ome-tiff": ".ome.tif", "ome-zarr": ".ome.zarr", "netcdf": ".nc", "mat": ".mat"}
MEMORY, SPEED = 2**30, 0.5
PIXEL_UM = 1.37

_EXPORT = """
import json, shutil, sys, time
from pathlib import Path
import planish as pl
run, small, out, to, options = sys.argv[1:6]
options = json.loads(options)
first = Path(out).with_name("first" + "".join(Path(out).suffixes))
pl.export(small, first, to=to, maps=["coating_top"], **options)  # what is imported once does not count
shutil.rmtree(first) if first.is_dir() else first.unlink()
begun = time.perf_counter()
pl.export(run, out, to=to, maps=["coating_top"], **options)
took = time.perf_counter() - begun
# Not ru_maxrss, which begins with what the process that started this one held.
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps([took, int(peak.split()[1]) * 1024]))
"""
_RAW = """
import json, os, sys, time
import numpy as np, zarr
values = zarr.open_array(sys.argv[1], mode="r")[...]
for word in sys.stdin:
    begun = time.perf_counter()
    with open(sys.argv[2], "wb") as file:
        file.write(values.data)
        file.flush()
        os.fsync(file.fileno())
    print(time.perf_counter() - begun, flush=True)
    os.unlink(sys.argv[2])
"""


def main(*arguments: str | int) -> int:
    asked = options("exporting", arguments, mpixel=160.0, folder=None, times=3)
    failed = 0
    with folder_for(asked.folder) as place:
        folder = Path(place)
        run = large_run(folder, asked.mpixel)
        stored = run / "maps.zarr" / "linked" / "coating_top"
        rows, cols = json.loads((stored / "zarr.json").read_text(encoding="utf-8"))["shape"]
        print(f"{rows} x {cols} pixels, {4 * rows * cols / 1e6:.0f} MB")
        raw = subprocess.Popen(
            [sys.executable, "-c", _RAW, str(stored), str(folder / "raw")],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            for to, suffix in FORMATS.items():
                failed += measure(raw, run, folder / f"out{suffix}", to, 4 * rows * cols, asked.times)
        finally:
            raw.communicate()
    return failed


def measure(raw: subprocess.Popen[str], run: Path, path: Path, to: str, size: int, times: int) -> int:
    """Write a format some times, and print the middle of what that took; 1 where a limit was missed."""
    options = json.dumps({"mat_version": "7.3"} if to == "mat" else {})
    command = [sys.executable, "-c", _EXPORT, str(run), str(small_run(run.parent)), str(path), to, options]
    ratios, speeds, peak, disk = list[float](), list[float](), 0, 0
    for _ in range(times):
        before = written(raw)
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        took, memory = json.loads(done.stdout.splitlines()[-1])
        ratios.append((before + written(raw)) / 2 / took)
        speeds.append(size / took / 1e6)
        peak, disk = max(peak, memory), size_of(path)
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    ratio = statistics.median(ratios)
    missed = ratio < SPEED or peak > MEMORY
    print(
        f"  {to:9} {statistics.median(speeds):5.0f} MB/s, {ratio:.2f} of raw with fsync (from {min(ratios):.2f} to "
        f"{max(ratios):.2f}), peak memory {peak / 2**20:.0f} MiB, file {disk / 1e6:.0f} MB{'  MISSED' * missed}",
        flush=True,
    )
    return int(missed)


def written(raw: subprocess.Popen[str]) -> float:
    """Seconds in which the array is written raw, and is on the disk."""
    assert raw.stdin is not None
    assert raw.stdout is not None
    raw.stdin.write("again\n")
    raw.stdin.flush()
    return float(raw.stdout.readline())


def small_run(folder: Path, name: str = "small", holes: int = 5, **sections: RegistrationParams) -> Path:
    """A run of a small specimen, made once."""
    run = folder / name
    if not run.exists():
        made = make_specimen(
            SpecimenParams(
                size_um=(1300.0, 1000.0), holes=BurnParams(pattern="irregular", count=holes), seed=5,
                scanner=ScannerParams(voxel_um=4.0), camera=CameraParams(pixel_um=5.0),
            )
        )  # fmt: skip
        files = write_instruments(made, folder / f"{name}-specimen")
        assert files.image is not None
        link(files.volume, files.image, out=run, **sections)
    return run


def large_run(folder: Path, mpixel: float) -> Path:
    """A run whose linked maps have so many pixels: of a small one, with another store."""
    run = folder / f"run-{mpixel:g}"
    if run.exists():
        return run
    small = small_run(folder)
    making = folder / f"run-{mpixel:g}.partial"
    shutil.rmtree(making, ignore_errors=True)
    shutil.copytree(small, making, ignore=shutil.ignore_patterns("maps.zarr"))
    rows = round(math.sqrt(mpixel * 1e6 * 3 / 4))
    grid = Grid.regular((rows, rows * 4 // 3), PIXEL_UM)
    rng = np.random.default_rng(0)
    sink = StoredMaps(making / "maps.zarr")
    about = {"units": "um", "long_name": "Coating thickness, top side", "role": "property"}
    for tile in map_tiles(grid.shape):
        values = rng.normal(17.0, 4.0, tile.shape).astype(np.float32)
        values[rng.random(tile.shape) < 0.1] = np.nan
        part = grid.part(tile.rows, tile.cols)
        sink.add("linked", grid, tile, xr.Dataset({"coating_top": (("y", "x"), values, about)}, coords=part.coords))
    if not sink.stored:  # small enough to have stayed in memory
        write_tree(making / "maps.zarr", {"linked": sink.group("linked")})
    making.rename(run)
    return run
