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
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import tifffile
import zarr
from zarr.codecs import ZstdCodec

from benchmarks.shared import planish, succeeded
from benchmarks.size import DEPTH, VOXEL_UM, boxes, decode_slices, sixteen_bits, write_slices
from planish.io.store import CHUNK, SHARD

# Compression of slices, None for one plain stack, and the least share of reading and writing alone.
_KINDS = {"stack": (None, 0.4), "plain": (None, 0.4), "lzw": ("lzw", 0.8), "deflate": ("zlib", 0.8)}


def _decode(path):
    if path.is_dir():
        decode_slices(path)
        return
    with tifffile.TiffFile(path) as file:
        pages = file.series[0]
        offset, plane = pages.dataoffset, int(np.prod(pages.shape[1:]))
    with ThreadPoolExecutor(2) as pool:
        list(
            pool.map(lambda k: np.fromfile(path, np.uint16, plane, offset=offset + 2 * k * plane).nbytes, range(DEPTH))
        )


def _encode(values, path):
    array = zarr.create_array(
        path, shape=values.shape, dtype=values.dtype, chunks=CHUNK, shards=SHARD, fill_value=0,
        compressors=ZstdCodec(level=1, checksum=True),
    )  # fmt: skip

    def write(box):
        array[box] = values[box]

    with ThreadPoolExecutor(2) as pool, zarr.config.set({"threading.max_workers": 1, "async.concurrency": 1}):
        list(pool.map(write, boxes(values.shape, SHARD)))


def _seconds(work, times, out=None):
    taken = []
    for _ in range(times):
        if out is not None:
            shutil.rmtree(out, ignore_errors=True)
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)


def main(mvoxel: int = 300, times: int = 5) -> int:
    """Print the times and ratios; 1 where one is missed."""
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        values = sixteen_bits(round(np.sqrt(mvoxel * 1e6 / DEPTH)))
        out = folder / "store.zarr"
        encoding = _seconds(lambda: _encode(values, out), times, out)
        start = _seconds(lambda: succeeded(planish("import", "--help")), times)
        print(f"{values.nbytes / 1e9:.2f} GB of 16 bits; encoding {encoding:.2f} s; start of the program {start:.2f} s")
        for kind, (compression, least) in _KINDS.items():
            path = folder / kind
            if kind == "stack":
                path = path.with_suffix(".tif")
                tifffile.imwrite(path, values, photometric="minisblack")
            else:
                write_slices(values, path, compression)
            command = planish("import", path, "--voxel-um", VOXEL_UM, "-o", out)
            _seconds(lambda command=command: succeeded(command), 1, out)  # from the disk into the page cache
            decoding = _seconds(lambda path=path: _decode(path), times)
            took = _seconds(lambda command=command: succeeded(command), times, out) - start
            alone = max(decoding, encoding) if least < 0.5 else decoding + encoding
            print(
                f"{kind:8} decoding {decoding:.2f} s, import {took:.2f} s: {alone / took:.2f} of it ({least})",
                flush=True,
            )
            failed |= alone / took < least
    return int(failed)
