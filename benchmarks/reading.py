"""An import against reading and writing alone: stacks of slices as scanners write them, from the page cache.

``python -m benchmarks reading [MVOXEL [TIMES]]``

A drawn sheet of 16 bits as one plain TIFF stack, and as folders of plain, LZW and deflated slices. *Decoding* reads and
decodes every slice with tifffile, *encoding* writes the values into a store of the same chunks and codec, without
levels and checksums; both on two threads. A plain stack has to be imported at .4 of the slower of the two or more,
deflated slices at .8 of both together. Medians.
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import tifffile
import zarr
from numpy.typing import NDArray
from zarr.codecs import ZstdCodec

from benchmarks.size import DEPTH, VOXEL_UM, volume
from planish.io.store import CHUNK, SHARD

_KINDS = {"stack": None, "plain": None, "lzw": "lzw", "deflate": "zlib"}
_LEAST = {"stack": 0.4, "plain": 0.4, "lzw": 0.8, "deflate": 0.8}


def _write(values: NDArray[np.uint16], path: Path, kind: str) -> None:
    if kind == "stack":
        tifffile.imwrite(path.with_suffix(".tif"), values, photometric="minisblack")
        return
    path.mkdir()
    for k, plane in enumerate(values):
        tifffile.imwrite(path / f"slice{k:04d}.tif", plane, photometric="minisblack", compression=_KINDS[kind])


def _decode(path: Path) -> None:
    with ThreadPoolExecutor(2) as pool:
        if path.is_dir():
            list(pool.map(lambda file: tifffile.imread(file, maxworkers=1).nbytes, sorted(path.iterdir())))
            return
        with tifffile.TiffFile(path) as file:
            pages = file.series[0]
            offset, plane = pages.dataoffset, int(np.prod(pages.shape[1:]))
        list(
            pool.map(lambda k: np.fromfile(path, np.uint16, plane, offset=offset + 2 * k * plane).nbytes, range(DEPTH))
        )


def _encode(values: NDArray[np.uint16], path: Path) -> None:
    array = zarr.create_array(
        path, shape=values.shape, dtype=values.dtype, chunks=CHUNK, shards=SHARD, fill_value=0,
        compressors=ZstdCodec(level=1, checksum=True),
    )  # fmt: skip

    def write(corner: tuple[int, int, int]) -> None:
        box = tuple(slice(at, at + n) for at, n in zip(corner, SHARD, strict=True))
        array[box] = values[box]

    corners = np.argwhere(np.ones([-(-n // s) for n, s in zip(values.shape, SHARD, strict=True)])) * SHARD
    with ThreadPoolExecutor(2) as pool, zarr.config.set({"threading.max_workers": 1, "async.concurrency": 1}):
        list(pool.map(write, map(tuple, corners.tolist())))


def _seconds(work: Callable[[], object], times: int, out: Path | None = None) -> float:
    taken: list[float] = []
    for _ in range(times):
        if out is not None:
            shutil.rmtree(out, ignore_errors=True)
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)


def main(mvoxel: int = 300, times: int = 5) -> int:
    """Print the times and ratios; 1 where one is missed."""
    edge = round(np.sqrt(mvoxel * 1e6 / DEPTH))
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        values = volume((DEPTH, edge, edge)).values.astype(np.uint16) * 97
        values += np.random.default_rng(1).integers(0, 97, values.shape, dtype=np.uint16)
        out = folder / "store.zarr"
        encoding = _seconds(lambda: _encode(values, out), times, out)
        start = _seconds(lambda: subprocess.run([sys.executable, "-m", "planish", "import", "--help"],
                                                stdout=subprocess.DEVNULL, check=True), times)  # fmt: skip
        print(f"{values.nbytes / 1e9:.2f} GB of 16 bits; encoding {encoding:.2f} s; start of the program {start:.2f} s")
        for kind, least in _LEAST.items():
            path = folder / kind
            _write(values, path, kind)
            path = path if path.is_dir() else path.with_suffix(".tif")
            given = [str(path), "--voxel-um", str(VOXEL_UM), "-o", str(out)]

            def imported(given: list[str] = given) -> None:
                command = [sys.executable, "-m", "planish", "import", *given]
                subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)

            shutil.rmtree(out, ignore_errors=True)
            imported()
            decoding = _seconds(lambda path=path: _decode(path), times)
            took = _seconds(imported, times, out) - start
            alone = max(decoding, encoding) if least < 0.5 else decoding + encoding
            print(
                f"{kind:8} decoding {decoding:.2f} s, import {took:.2f} s: {alone / took:.2f} of it ({least})",
                flush=True,
            )
            failed |= alone / took < least
            shutil.rmtree(out)
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    return int(failed)
