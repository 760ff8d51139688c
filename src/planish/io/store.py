"""The working store: a volume as sharded, multiscale, checksummed OME-Zarr, written block by block.

A block is whole shards on every level that it fills and one writer's own: two writers of one shard
would lose values without an error. A list of checksums says what is finished, so that an import
that was killed goes on there.
"""

import hashlib
import json
import math
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ALL_COMPLETED, FIRST_COMPLETED, Executor, Future, wait
from contextlib import nullcontext, suppress
from itertools import pairwise, product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
import zarr
from numpy.typing import NDArray
from zarr.codecs import ZstdCodec

from planish.core.errors import InputError, ResourceError
from planish.core.files import delete, move, writing
from planish.core.memory import BLOCKS_AT_WORK, PROGRAM_BYTES, bytes_to_hold, enough_gb
from planish.core.threads import count_threads, limit_threads, thread_pool
from planish.core.typing import Entries, Shape
from planish.io.hashes import Checksums, ShardLists, Where
from planish.io.run_folder import acquire_lock, claim_folder, is_link, refuse_existing, remove

# Voxels that are decompressed together; divisible by the widths of columns that are measured, 1 to
# 4 voxels.
CHUNK = (64, 96, 96)
SHARD = (64, 384, 384)  # voxels that lie in one file
# Attributes of a volume that its store keeps.
_NOTED = (
    "full_scale",
    "voxel_um_source",
    "size_doubt",
    "stored_dtype",
    "channel",
    "sections",
    "corrections",
    "history",
    "hand",
    "turned",
    "notes",
)
_SOURCE = "source.json"
_LOCK = "lock"
# Voxels along the longest and the shortest axis of the last level.
_SMALLEST = 256
_LEAST_DEPTH = 16
Array = zarr.Array[Any]
_OPENING = threading.Lock()  # what zarr is set to holds for all threads
Progress = Callable[[str, int, int], None]


def write_store(
    volume: xr.DataArray,
    path: Path,
    *,
    memory_bytes: int = 2**31,
    threads: int | None = None,
    executor: Executor | None = None,
    workers: int = BLOCKS_AT_WORK,
    ome: Literal["0.5", "0.4"] = "0.5",
    progress: Progress | None = None,
) -> None:
    """Write a volume into a new working store, part by part.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um, read in blocks
        It need not fit into memory.
    path : Path
        Folder to make. While it is written it stands beside its place under a hidden name, where a
        second call with the same volume finds it and goes on if the first one was killed.
    memory_bytes, threads : int
        What the blocks in memory may take, and how many threads compress them; the bytes do not
        depend on either.
    executor, workers
        Other processes, such as those of a cluster, which see the same folders, and how many blocks
        they work on at the same time, as far as the memory holds them; ``volume`` is sent there.
        Local threads where not given.
    ome : {"0.5", "0.4"}
        Version of OME-Zarr. 0.4 has no shards, and so many more files.
    progress : callable, optional
        Called with what is done, the number of blocks done, and their number.

    Raises
    ------
    FileError, InputError, ResourceError
        If ``path`` exists, cannot be written, or another process is writing it; an import of
        another volume stopped half-way under this name; the memory does not hold one block, or the
        disk is full.
    """
    refuse_existing(path)
    partial = path.with_name(f".{path.name}.partial")
    source = _identity(volume)
    with writing(path, needed=int(1.2 * volume.nbytes)):
        claim_folder(partial, _SOURCE, json.dumps(source), for_what=path)
        source_file = partial / _SOURCE  # of what an import that stopped has read
        noted_source = None
        with suppress(OSError, ValueError):
            if not is_link(source_file):
                noted_source = json.loads(source_file.read_text(encoding="utf-8"))
        needed_keys = source.keys() - {"corrections"}
        if not isinstance(noted_source, dict) or not needed_keys <= noted_source.keys():
            raise InputError(
                f"{partial} is in the way and no import that stopped. Move that folder away, or"
                " give another name with `out`."
            )
        if noted_source != json.loads(json.dumps(source)):
            raise InputError(
                f"An import of another volume stopped half-way at {partial}. Remove that folder, or"
                " give another name with `out`."
            )
        lock = acquire_lock(partial / _LOCK, path)
        try:
            levels = _make_levels(partial, volume, ome)
            shard_lists = ShardLists(partial, ome)
            with limit_threads(threads):
                _write_finest_levels(
                    volume, levels, shard_lists, memory_bytes, executor, workers, progress
                )
                for fine, coarse in pairwise(levels[1:]):
                    _write_coarser_level(fine, coarse, shard_lists)
            shard_lists.settle()
        except Exception:  # only an import that was killed or interrupted is gone on with
            lock.release()
            remove(partial)
            raise
        finally:
            lock.release()
        delete(partial / _LOCK)
        delete(source_file)
        move(partial, path)


def _write_finest_levels(
    volume: xr.DataArray,
    levels: list[Array],
    shard_lists: ShardLists,
    memory_bytes: int,
    executor: Executor | None,
    workers: int,
    progress: Progress | None,
) -> None:
    """Write the two finest levels, several blocks at once; those that are listed are done.

    ``memory_bytes`` to ``progress`` as for :func:`write_store`.
    """
    max_blocks = min(BLOCKS_AT_WORK, count_threads()) if executor is None else workers
    block_shape, n_parallel = _plan_blocks(levels[0], memory_bytes, max_blocks)
    blocks = list(_blocks(levels[0].shape, block_shape))

    def is_written(where: Where) -> bool:
        return all(shard_lists.has(*part) for part in _parts(levels, where))

    pending_blocks = [where for where in blocks if not is_written(where)]
    futures: set[Future[list[Checksums]]] = set()

    def finish(when: str) -> None:
        """Wait for blocks, and list what they wrote, whether another failed or not."""
        failed_future: Future[Any] | None = None
        for future in wait(futures, return_when=when).done:
            futures.remove(future)
            if future.exception() is not None:
                failed_future = future
                continue
            for level, checksums in zip(levels, future.result(), strict=False):
                shard_lists.add(level, checksums)
        if failed_future is not None:
            failed_future.result()
        if progress is not None:
            n_left = len(pending_blocks) + len(futures)
            progress("import", len(blocks) - n_left, len(blocks))

    with thread_pool(n_parallel) if executor is None else nullcontext(executor) as pool:
        try:
            while pending_blocks:
                where = pending_blocks.pop(0)
                names = [shard_lists.names(*part) for part in _parts(levels, where)]
                futures.add(pool.submit(_write_block, volume, where, shard_lists.folder, names))
                if len(futures) == n_parallel:
                    finish(FIRST_COMPLETED)
        finally:
            finish(ALL_COMPLETED)


def _plan_blocks(
    level: Array, memory_bytes: int, max_blocks: int
) -> tuple[tuple[int, int, int], int]:
    """Size the blocks (z, y, x) as the memory allows, and say how many are worked on at once.

    Blocks are whole shards on two levels, ``level`` and the one half as fine: two shards or more
    along each axis, or all there are. ``memory_bytes`` is what all of them together may take.
    """
    shape = level.shape
    shard_shape = level.shards or level.chunks
    shards = zip(shard_shape, shape, strict=True)
    unit_shape = [min(2 * s, -(-n // s) * s) for s, n in shards]
    # A block and its means, and what is compressed of it.
    n_voxels = math.prod(map(min, unit_shape, shape))
    block_bytes = 1.6 * level.dtype.itemsize * n_voxels
    n_parallel = max(min(int(memory_bytes / block_bytes), max_blocks), 1)
    block_ratio = memory_bytes / (n_parallel * block_bytes)
    if block_ratio < 1:
        needed_gb = enough_gb(bytes_to_hold(block_bytes) + PROGRAM_BYTES)
        raise ResourceError(
            f"The import needs {block_bytes / 1e6:.0f} MB for a block of shards,"
            f" {memory_bytes / 1e6:.0f} MB are allowed for it. Allow more: `memory={needed_gb}GB`"
            " will do."
        )
    # What memory is left makes the blocks larger, along the columns first.
    _, rows, cols = shape
    depth, unit_rows, unit_cols = unit_shape
    n_across = min(int(block_ratio), -(-cols // unit_cols))
    n_fitting = max(int(block_ratio / n_across), 1)
    n_down = min(n_fitting, -(-rows // unit_rows))
    return (depth, n_down * unit_rows, n_across * unit_cols), n_parallel


def _parts(levels: list[Array], where: Where) -> list[tuple[Array, Where]]:
    """Give the two levels that a block is written to, and where it lies on each."""
    return [(level, _halved(where, k)) for k, level in enumerate(levels[:2])]


def _write_block(
    volume: xr.DataArray, where: Where, folder: Path, names: list[list[str]]
) -> list[Checksums]:
    """Write a block of the volume and its means into the store in ``folder``.

    ``names`` are the files of its shards on each level; their checksums are returned alike.
    """
    block = volume.isel(dict(zip("zyx", where, strict=True)))
    values = np.ascontiguousarray(block.values)
    checksums: list[Checksums] = []
    for k, shard_names in enumerate(names):
        if k > 0:
            values = halve(values)
        level = _level(folder, k)
        checksums.append(_write_shards(level, _halved(where, k), values, folder, shard_names))
    return checksums


def _write_coarser_level(fine: Array, coarse: Array, shards: ShardLists) -> None:
    for where in _blocks(coarse.shape, coarse.shards or coarse.chunks):
        if not shards.has(coarse, where):
            fine_where = tuple(slice(2 * w.start, 2 * w.stop) for w in where)
            values = halve(np.asarray(fine[fine_where]))
            names = shards.names(coarse, where)
            shards.add(coarse, _write_shards(coarse, where, values, shards.folder, names))


def _write_shards(
    level: Array, where: Where, values: NDArray[Any], folder: Path, names: list[str]
) -> Checksums:
    """Write a part of a level into a store, and give the checksums of its shards."""
    level[where] = values
    checksums: Checksums = {}
    for name in names:
        with (folder / level.basename / name).open("rb+") as file:
            os.fsync(file.fileno())
            checksums[name] = hashlib.file_digest(file, "sha256").hexdigest()
    return checksums


def halve(values: NDArray[Any]) -> NDArray[Any]:
    """Means of 2 x 2 x 2 voxels; what is left over at an end is the mean of fewer.

    Integers are rounded.
    """
    from planish.core._overview_kernels import halve_voxels

    half_shape = tuple(-(-n // 2) for n in values.shape)
    out = np.empty(half_shape, values.dtype)
    halve_voxels(values, out, values.dtype.kind in "ui")
    return out


def _blocks(shape: Shape, block: Shape) -> Iterator[Where]:
    """Blocks of a volume in the order of its voxels; the last ones are smaller."""
    for starts in product(*map(range, (0, 0, 0), shape, block)):
        edges = zip(starts, block, shape, strict=True)
        z, y, x = (slice(start, min(start + size, n)) for start, size, n in edges)
        yield z, y, x


def _halved(where: Where, times: int) -> Where:
    """Return the same block on a coarser level; its starts are whole shards there."""
    scale = 2**times
    z, y, x = (slice(w.start // scale, -(-w.stop // scale)) for w in where)
    return z, y, x


def _level_shapes(shape: Shape) -> list[Shape]:
    """Shapes of all levels, each half as long along each axis as the one before."""
    shapes = [shape]
    while max(shape) > _SMALLEST and min(shape) >= 2 * _LEAST_DEPTH:
        shape = tuple(-(-n // 2) for n in shape)
        shapes.append(shape)
    return shapes


def _make_levels(folder: Path, volume: xr.DataArray, ome: str) -> list[Array]:
    """Make the arrays of all levels with their metadata, or open those that are there."""
    shapes = _level_shapes(volume.shape)
    voxel_um = list(map(float, volume.attrs["voxel_um"]))
    first_um = [float(volume[axis].values[0]) for axis in "zyx"]
    source_name = str(volume.attrs.get("file_name", "volume"))
    scales = multiscale(
        source_name, "zyx", voxel_um, first_um, len(shapes), kind="mean of 2 x 2 x 2"
    )
    is_sharded = ome == "0.5"
    attributes: Entries = {"ome": {"version": ome, "multiscales": [scales]}}
    options: Entries = {
        "compressors": ZstdCodec(level=1, checksum=True),
        "dimension_names": list("zyx"),
    }
    if not is_sharded:
        attributes = {"multiscales": [{"version": ome, **scales}]}
        options = {"chunk_key_encoding": {"name": "v2", "separator": "/"}}
    noted_attrs: Entries = {"source": source_name}
    for key in _NOTED:
        if volume.attrs.get(key) is not None:
            noted_attrs[key] = volume.attrs[key]
    group = zarr.open_group(folder, mode="a", zarr_format=3 if is_sharded else 2)
    group.attrs.update(attributes | {"planish": noted_attrs})
    for k, shape in enumerate(shapes):
        if is_sharded:
            whole_chunks = -(-np.array(shape) // CHUNK) * CHUNK
            options["shards"] = tuple(np.minimum(SHARD, whole_chunks).tolist())
        if str(k) not in group:
            group.create_array(
                str(k), shape=shape, dtype=volume.dtype, chunks=CHUNK, fill_value=0, **options
            )
    return [_level(folder, k) for k in range(len(shapes))]


def multiscale(
    name: str,
    axes: str,
    pitch_um: Sequence[float],
    first_um: Sequence[float],
    n_levels: int,
    *,
    kind: str,
) -> Entries:
    """Describe an image of several levels, each half as fine, as OME-Zarr does.

    ``axes``: letters, such as zyx; an axis c lies before those of space. ``pitch_um`` and
    ``first_um`` are size and place of the first voxel along the axes of space; ``kind`` says how a
    level is made of the one before.
    """
    n_channels = axes.count("c")
    datasets: list[Entries] = []
    for k in range(n_levels):
        factor = 2**k
        scales = [1.0] * n_channels
        origins = [0.0] * n_channels
        for um, edge_um in zip(first_um, pitch_um, strict=True):
            scales.append(edge_um * factor)
            # The first voxel of a level has its middle between those it is made of.
            origins.append(um + edge_um * (factor - 1) / 2)
        scale = {"type": "scale", "scale": scales}
        translation = {"type": "translation", "translation": origins}
        datasets.append({"path": str(k), "coordinateTransformations": [scale, translation]})
    axis_entries = [{"name": "c", "type": "channel"}] * n_channels
    axis_entries += [
        {"name": axis, "type": "space", "unit": "micrometer"} for axis in axes if axis != "c"
    ]
    return {"name": name, "axes": axis_entries, "datasets": datasets, "type": kind}


def _level(folder: Path, k: int) -> Array:
    """Open a level for writing, its empty chunks included.

    A shard that is missing counts as lost.
    """
    with _OPENING, zarr.config.set({"array.write_empty_chunks": True}):
        return zarr.open_array(folder, path=str(k), mode="r+")


def _identity(volume: xr.DataArray) -> Entries:
    """What says that an import is of the same volume, with the same corrections."""
    identity: Entries = {"shape": list(volume.shape), "dtype": str(volume.dtype)}
    for key in ("file_name", "file_bytes", "voxel_um"):
        identity[key] = volume.attrs.get(key)
    corrections = volume.attrs.get("corrections")
    # Other options, other voxels.
    if corrections is None:
        return identity
    return identity | {"corrections": corrections}
