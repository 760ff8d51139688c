"""A volume larger than memory through surfaces and six maps: peak memory, and time against one
plain pass of reading.

    python -m benchmarks size [--gvoxel 0.5,8] [--times 5] [--folder DIR] [--column-um 4.11]
    [--memory 2GB]
                              [--slices]

With ``--slices`` the same greys in 16 bits, from a store and from folders of plain and of deflated
slices. Each may take 1.3 times as long as from the store, and what decoding alone takes. Medians of
``--times``.

The sheet is a formula: a warped mid-surface, coatings of varying thickness, laser holes, a blur and
noise. It is written into a working store block by block, then mapped by the command line in a
process of its own.
"""

from __future__ import annotations

import itertools
import json
import shutil
import statistics
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import tifffile
import xarray as xr
import zarr
from numba import njit
from xarray.backends import BackendArray
from xarray.core.indexing import IndexingSupport, LazilyIndexedArray, explicit_indexing_adapter

from benchmarks.shared import folder_for, options, planish, size_of, succeeded
from planish.io.store import write_store

VOXEL_UM = 1.37
DEPTH = 320
BASE_UM, COAT_UM, BLUR_UM = 90.0, 14.0, 1.7
AIR, PAPER, COATING, NOISE = 60.0, 100.0, 200.0, 7.0
HOLES_UM, HOLE_UM = 1500.0, 170.0


@njit(cache=True, nogil=True)
def smooth_step(x):
    """The normal distribution, to 0.02."""
    return 1.0 / (1.0 + np.exp(-1.702 * x))


@njit(cache=True, nogil=True)
def mixed(number):
    """64 bits without a pattern (splitmix64): slices whose noise repeats would be what the checks
    look for."""
    number = number * np.uint64(0x9E3779B97F4A7C15)
    number = (number ^ (number >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    number = (number ^ (number >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return number ^ (number >> np.uint64(31))


@njit(cache=True, nogil=True)
def fill(out, z0, y0, x0, depth):
    """Grey of the voxels of a block that begins at z0, y0, x0."""
    nz, ny, nx = out.shape
    for j in range(ny):
        y = (y0 + j) * VOXEL_UM
        for i in range(nx):
            x = (x0 + i) * VOXEL_UM
            a, b = 2 * np.pi * x / 3100.0, 2 * np.pi * y / 2300.0
            middle = depth * VOXEL_UM / 2 + 60.0 * np.sin(a) + 20.0 * np.sin(b)
            slope = np.hypot(
                60.0 * 2 * np.pi / 3100.0 * np.cos(a), 20.0 * 2 * np.pi / 2300.0 * np.cos(b)
            )
            tilt = 1.0 / np.sqrt(1.0 + slope * slope)
            coat = (
                COAT_UM
                + 3.0 * np.sin(2 * np.pi * (x + 0.3 * y) / 90.0)
                + 3.0 * np.sin(2 * np.pi * (y - x) / 400.0)
            )
            rough = 1.0 * np.sin(2 * np.pi * x / 57.0) * np.sin(2 * np.pi * y / 61.0)
            fx, fy = (
                (x + 0.5 * HOLES_UM) % HOLES_UM - 0.5 * HOLES_UM,
                (y + 0.5 * HOLES_UM) % HOLES_UM - 0.5 * HOLES_UM,
            )
            there = smooth_step((np.hypot(fx, fy) - 0.5 * HOLE_UM) / BLUR_UM)
            column = np.uint64(((y0 + j) << 40) + ((x0 + i) << 20))
            for k in range(nz):
                s = ((z0 + k) * VOXEL_UM - middle) * tilt
                outer = smooth_step((0.5 * BASE_UM + coat + rough - s) / BLUR_UM)
                outer *= smooth_step((s + 0.5 * BASE_UM + COAT_UM) / BLUR_UM)
                inner = smooth_step((0.5 * BASE_UM + rough - s) / BLUR_UM) * smooth_step(
                    (s + 0.5 * BASE_UM) / BLUR_UM
                )
                bits, noise = mixed(column + np.uint64(z0 + k)), 0.0
                for part in range(3):
                    noise += (
                        np.float64((bits >> np.uint64(21 * part)) & np.uint64(0x1FFFFF)) / 2097152.0
                        - 0.5
                    )
                grey = (
                    AIR
                    + there * ((COATING - AIR) * outer + (PAPER - COATING) * inner)
                    + 2.0 * NOISE * noise
                )
                out[k, j, i] = np.uint8(min(max(grey, 0.0), 255.0) + 0.5)


class Formula(BackendArray):
    """The volume, worked out where it is asked for."""

    dtype = np.dtype(np.uint8)

    def __init__(self, shape):
        self.shape = shape

    def __getitem__(self, key):
        return explicit_indexing_adapter(key, self.shape, IndexingSupport.BASIC, self.read)

    def read(self, key):
        z, y, x = (range(n)[k] for n, k in zip(self.shape, key, strict=True))
        out = np.empty((len(z), len(y), len(x)), np.uint8)
        half = len(y) // 2
        parts = ((out[:, :half], y.start), (out[:, half:], y.start + half))
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lambda p: fill(p[0], z.start, p[1], x.start, self.shape[0]), parts))
        return out


def main(*arguments):
    asked = options(
        "size",
        arguments,
        gvoxel="0.5,8",
        times=1,
        slices=False,
        folder=None,
        column_um="4.11",
        memory="2GB",
    )
    with folder_for(asked.folder) as folder:
        for gvoxel in map(float, asked.gvoxel.split(",")):
            (compare_slices if asked.slices else measure)(gvoxel, Path(folder), asked)
    return 0


def measure(gvoxel, folder, asked):
    edge = round(np.sqrt(gvoxel * 1e9 / DEPTH))
    shape = (DEPTH, edge, edge)
    voxels = float(np.prod(shape))
    store, out = folder / f"sheet-{gvoxel:g}.zarr", folder / "run"
    print(f"{gvoxel:g} Gvoxel: {DEPTH} x {edge} x {edge} voxels of {VOXEL_UM} um")
    if not store.exists():
        write_store(volume(shape), store, memory_bytes=2**30)
    read = statistics.median(plain_pass(store) for _ in range(asked.times))
    print(
        f"  plain pass of reading {read:.1f} s, {voxels / read / 1e6:.0f} Mvoxel/s, "
        f"{size_of(store / '0') / 1e9:.2f} GB on disk"
    )
    runs = [mapped(store, out, asked) for _ in range(asked.times)]
    took = statistics.median(run.seconds for run in runs)
    each = ", ".join(f"{run.seconds:.1f}" for run in runs)
    print(
        f"  surfaces and six maps {took:.1f} s ({each}), {voxels / took / 1e6:.0f} Mvoxel/s, "
        f"{took / read:.1f} plain passes"
    )
    last = runs[-1]
    print("  " + ", ".join(f"{name} {seconds:.1f} s" for name, seconds in last.stages.items()))
    print(f"  the checks take {100 * last.stages.get('check', 0.0) / last.seconds:.0f} % of it")
    print(f"  peak memory {last.peak / 1e9:.2f} GB")
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    sheet = results["layers"][0]["sheet"]
    mean = sheet["properties"]["coating_top"]["mean"]
    found = "withheld" if mean is None else f"{mean:.3f} um"
    print(
        f"  coating {found} (true {COAT_UM:g}), measured "
        f"{sheet['surfaces']['shares']['measured']:.3f}"
    )
    for check in results["checks"]:
        if check["state"] in ("look", "fail"):
            print(f"  {check['state']}: {check['name']}: {check['sentence']}")


def mapped(volume, out, asked):
    """Map a volume by the command line."""
    shutil.rmtree(out, ignore_errors=True)
    voxel = () if volume.suffix == ".zarr" else ("--voxel-um", VOXEL_UM)
    command = planish(
        "map",
        volume,
        "--out",
        out,
        "--column-um",
        asked.column_um,
        "--memory",
        asked.memory,
        *voxel,
    )
    return succeeded(command)


def sixteen_bits(edge):
    """The greys of a sheet in 16 bits, whose last digits are noise."""
    values = volume((DEPTH, edge, edge)).values.astype(np.uint16) * 97
    values += np.random.default_rng(1).integers(0, 97, values.shape, dtype=np.uint16)
    return values


def write_slices(values, folder, compression):
    """Write a folder of slices."""
    folder.mkdir(exist_ok=True)
    for k, plane in enumerate(values):
        file = folder / f"slice{k:04d}.tif"
        tifffile.imwrite(file, plane, photometric="minisblack", compression=compression)


def decode_slices(folder):
    """Read and decode every slice, on two threads."""
    with ThreadPoolExecutor(2) as pool:
        list(
            pool.map(
                lambda file: tifffile.imread(file, maxworkers=1).nbytes, sorted(folder.iterdir())
            )
        )


def compare_slices(gvoxel, folder, asked):
    edge = round(np.sqrt(gvoxel * 1e9 / DEPTH))
    values = sixteen_bits(edge)
    inputs = {"store": folder / "sheet-16.zarr", "plain": folder / "plain", "zlib": folder / "zlib"}
    if not inputs["store"].exists():
        write_store(
            volume((DEPTH, edge, edge)).copy(data=values), inputs["store"], memory_bytes=2**30
        )
    write_slices(values, inputs["plain"], None)
    write_slices(values, inputs["zlib"], "zlib")
    took = {kind: [] for kind in inputs}
    decoding = {"plain": [], "zlib": []}
    for _ in range(asked.times):
        for kind, path in inputs.items():
            took[kind].append(mapped(path, folder / "run", asked).seconds)
        for kind, seconds in decoding.items():
            begun = time.perf_counter()
            decode_slices(inputs[kind])
            seconds.append(time.perf_counter() - begun)
    store = statistics.median(took["store"])
    print(f"{gvoxel:g} Gvoxel of 16 bits, from a store {store:.1f} s")
    for kind, seconds in decoding.items():
        alone, whole = statistics.median(seconds), statistics.median(took[kind])
        print(
            f"  {kind} slices {whole:.1f} s, decoding alone {alone:.1f} s:"
            f" {(whole - alone) / store:.2f} of the store (1.3)"
        )


def volume(shape):
    coords = {k: np.arange(n) * VOXEL_UM for k, n in zip("zyx", shape, strict=True)}
    attrs = {"voxel_um": [VOXEL_UM] * 3, "file_name": "formula", "file_bytes": 0, "full_scale": 255}
    return xr.DataArray(
        xr.Variable(("z", "y", "x"), LazilyIndexedArray(Formula(shape))), coords=coords, attrs=attrs
    )


def plain_pass(store):
    """Seconds to read and decompress every chunk, on two threads."""
    array = zarr.open_group(store, mode="r")["0"]
    start = time.perf_counter()
    with ThreadPoolExecutor(2) as pool:
        for _ in pool.map(
            lambda where: array[where][0, 0, 0], boxes(array.shape, array.shards or array.chunks)
        ):
            pass
    return time.perf_counter() - start


def boxes(shape, edges):
    """Parts of an array, one after the other."""
    for corner in itertools.product(
        *(range(0, n, edge) for n, edge in zip(shape, edges, strict=True))
    ):
        yield tuple(slice(at, at + edge) for at, edge in zip(corner, edges, strict=True))
