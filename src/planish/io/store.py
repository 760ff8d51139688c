"""The working store: a volume as sharded, multiscale, checksummed OME-Zarr, written block by block.

A block is a multiple of a shard in every direction, on every level that it fills, and one thread writes it: two writers
of one shard would lose values without an error. What is finished is noted in a list of checksums, so an import that
was killed goes on after the last whole block, and a shard that gets lost later does not read as zeros.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
import zarr
from numpy.typing import NDArray
from zarr.codecs import ZstdCodec

from planish.core.errors import InputError, ResourceError
from planish.core.files import writing
from planish.core.threads import count_threads, limit_threads, thread_pool
from planish.io.run_folder import claim_folder, is_link, locked, refuse_existing, remove

CHUNK = (64, 96, 96)
"""Voxels that are decompressed together; divisible by the widths of columns that are measured, 1 to 4 voxels."""

SHARD = (64, 384, 384)  # voxels that lie in one file
CHECKSUMS = "checksums.sha256"
"""List of the shards of a level with their SHA-256, in the folder of the level, as ``sha256sum -c`` reads it."""

_SOURCE = "source.json"
_LOCK = "lock"
_SMALLEST = 256  # voxels along the longest axis of the last level
_LEAST_DEPTH = 16
_AT_WORK = 2  # blocks: one is read while the other is compressed

Progress = Callable[[str, int, int], None]
Where = tuple[slice, slice, slice]


Array = zarr.Array[Any]


def write_store(
    volume: xr.DataArray,
    path: Path,
    *,
    memory_bytes: int = 2**31,
    threads: int | None = None,
    ome: Literal["0.5", "0.4"] = "0.5",
    progress: Progress | None = None,
) -> None:
    """Write a volume into a new working store, part by part.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um
        Read in blocks; it need not fit into memory.
    path : Path
        Folder to make. While it is written it stands beside its place under a hidden name, where a second call with
        the same volume finds it and goes on if the first one was killed.
    memory_bytes : int
        What the blocks in memory may take.
    threads : int, optional
        Blocks are compressed on so many threads; the bytes do not depend on it.
    ome : {"0.5", "0.4"}
        Version of OME-Zarr. 0.4 has no shards, and so many more files.
    progress : callable, optional
        Called with what is done, the number of blocks done, and their number.

    Raises
    ------
    FileError
        If ``path`` exists or cannot be written, or another process is writing it.
    InputError
        If an import of another volume stopped half-way under this name.
    ResourceError
        If the memory does not hold one block, or the disk is full.
    """
    refuse_existing(path)
    partial = path.with_name(f".{path.name}.partial")
    source = _identity(volume)
    with writing(path, needed=int(1.2 * volume.nbytes)):
        claim_folder(partial, _SOURCE, json.dumps(source), for_what=path)
        _same_source(partial, source)
        lock = locked(partial / _LOCK, path)
        try:
            levels = _make_levels(partial, volume, ome)
            done = Journal(partial, ome)
            with limit_threads(threads):
                _first_two(volume, levels, done, memory_bytes=memory_bytes, progress=progress)
                for fine, coarse in pairwise(levels[1:]):
                    _coarser(fine, coarse, done)
            done.settle()
        except Exception:  # only an import that was killed or interrupted is gone on with
            lock.release()
            remove(partial)
            raise
        finally:
            lock.release()
        for note in (_LOCK, _SOURCE):
            (partial / note).unlink(missing_ok=True)
        partial.rename(path)


def missing_shards(path: Path) -> list[str]:
    """Return the shards that the lists of checksums name and that are not there; empty where there is no list."""
    return [name for name in _listed(path) if not (path / name).is_file()]


def store_fingerprint(path: Path) -> str:
    """SHA-256 over the checksums of all shards, for which no shard is read; empty where there are no checksums."""
    listed = sorted(_listed(path).items())
    if not listed:
        return ""
    # The shards hold the voxels, the metadata their size.
    meta = sorted(p for p in path.rglob("*") if p.name in ("zarr.json", ".zattrs", ".zarray"))
    listed += [(p.relative_to(path).as_posix(), _sha256(p)) for p in meta]
    return hashlib.sha256("".join(f"{sha}  {name}\n" for name, sha in listed).encode()).hexdigest()


class Journal:
    """The lists of shards that are whole."""

    def __init__(self, folder: Path, ome: str) -> None:
        self.folder, self.prefix = folder, "c/" if ome == "0.5" else ""
        self.listed = set(_listed(folder))
        self.lock = threading.Lock()

    def names(self, level: Array, where: Where) -> list[str]:
        """Files of the shards of a block."""
        edge = level.shards or level.chunks
        z, y, x = (range(w.start // s, -(-w.stop // s)) for w, s in zip(where, edge, strict=True))
        return [f"{level.basename}/{self.prefix}{a}/{b}/{c}" for a in z for b in y for c in x]

    def has(self, level: Array, where: Where) -> bool:
        """Whether all shards of a block are listed."""
        return self.listed.issuperset(self.names(level, where))

    def add(self, level: Array, where: Where) -> None:
        """List the shards of a block that was written: only after their bytes are on the disk."""
        names = self.names(level, where)
        lines: list[str] = []
        for name in names:
            with (self.folder / name).open("rb+") as file:
                os.fsync(file.fileno())
                lines.append(f"{hashlib.file_digest(file, 'sha256').hexdigest()}  {name.partition('/')[2]}\n")
        listing = self.folder / str(level.basename) / CHECKSUMS
        with self.lock, listing.open("a", encoding="utf-8", newline="\n") as file:
            file.write("".join(lines))
            file.flush()
            os.fsync(file.fileno())
            self.listed.update(names)

    def settle(self) -> None:
        """Sort the lists: they do not depend on the order in which blocks were written."""
        for path in self.folder.glob(f"*/{CHECKSUMS}"):
            lines = sorted(set(path.read_text(encoding="utf-8").splitlines(keepends=True)), key=lambda line: line[64:])
            part = path.with_suffix(".part")
            part.write_text("".join(lines), encoding="utf-8", newline="\n")
            part.replace(path)


def _first_two(
    volume: xr.DataArray, levels: list[Array], done: Journal, *, memory_bytes: int, progress: Progress | None
) -> None:
    """Write the volume and its half in one pass over the input."""
    shape, size = levels[0].shape, volume.dtype.itemsize
    edge = levels[0].shards or levels[0].chunks
    units = [min(2 * s, -(-n // s) * s) for s, n in zip(edge, shape, strict=True)]
    # A block and its means, and what is compressed of it, for every one at work.
    least = _AT_WORK * 1.6 * size * math.prod(units)
    room = memory_bytes / least
    if room < 1:
        raise ResourceError(
            f"The import needs {least / 1e6:.0f} MB for its blocks of shards, {memory_bytes / 1e6:.0f} MB are "
            f"allowed for them. Allow more: --memory {math.ceil((3 * least + 3e8) / 1e8) / 10:.1f}GB will do."
        )
    wide = min(int(room), -(-shape[2] // units[2]))
    high = min(max(int(room / wide), 1), -(-shape[1] // units[1]))
    wheres = list(_blocks(shape, (units[0], high * units[1], wide * units[2])))

    def block(where: Where) -> None:
        if all(done.has(level, _halved(where, k)) for k, level in enumerate(levels[:2])):
            return
        values = np.ascontiguousarray(volume.isel(dict(zip("zyx", where, strict=True))).values)
        _write(levels[0], where, values, done)
        if len(levels) > 1:
            _write(levels[1], _halved(where, 1), halve(values), done)

    with thread_pool(min(_AT_WORK, count_threads())) as pool:
        try:
            for n, _ in enumerate(pool.map(block, wheres)):
                if progress is not None:
                    progress("import", n + 1, len(wheres))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _coarser(fine: Array, coarse: Array, done: Journal) -> None:
    for where in _blocks(coarse.shape, coarse.shards or coarse.chunks):
        if not done.has(coarse, where):
            source = tuple(slice(2 * w.start, min(2 * w.stop, n)) for w, n in zip(where, fine.shape, strict=True))
            _write(coarse, where, halve(np.asarray(fine[source])), done)


def _write(level: Array, where: Where, values: NDArray[Any], done: Journal) -> None:
    level[where] = values
    done.add(level, where)


def halve(values: NDArray[Any]) -> NDArray[Any]:
    """Means of 2 x 2 x 2 voxels; what is left over at an end is the mean of fewer. Integers are rounded."""
    from planish.io import _kernels

    out = np.empty(tuple(-(-n // 2) for n in values.shape), dtype=values.dtype)
    _kernels.halve(values, out, values.dtype.kind in "ui")
    return out


def _blocks(shape: tuple[int, ...], block: tuple[int, ...]) -> Iterator[Where]:
    z, y, x = ([slice(start, min(start + b, n)) for start in range(0, n, b)] for n, b in zip(shape, block, strict=True))
    yield from ((a, b, c) for a in z for b in y for c in x)


def _halved(where: Where, times: int) -> Where:
    """Return the same block on a coarser level; its starts are whole shards there."""
    z, y, x = (slice(w.start >> times, -(-w.stop // 2**times)) for w in where)
    return z, y, x


def _make_levels(folder: Path, volume: xr.DataArray, ome: str) -> list[Array]:
    """Make or open the arrays of all levels, and write what is known of the volume."""
    shapes = [tuple(volume.shape)]
    while max(shapes[-1]) > _SMALLEST and min(shapes[-1]) >= 2 * _LEAST_DEPTH:
        shapes.append(tuple(-(-n // 2) for n in shapes[-1]))
    voxel = [float(v) for v in volume.attrs["voxel_um"]]
    datasets = [
        {
            "path": str(k),
            "coordinateTransformations": [
                {"type": "scale", "scale": [v * 2**k for v in voxel]},
                {"type": "translation", "translation": [v * (2**k - 1) / 2 for v in voxel]},
            ],
        }
        for k in range(len(shapes))
    ]
    axes = [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "zyx"]
    name = str(volume.attrs.get("file_name", "volume"))
    scales = [{"name": name, "axes": axes, "datasets": datasets, "type": "mean of 2 x 2 x 2"}]
    attributes: dict[str, Any] = {"ome": {"version": ome, "multiscales": scales}}
    if ome == "0.4":
        attributes = {"multiscales": [{"version": ome, **scales[0]}]}
    kept = ("full_scale", "voxel_um_source", "stored_dtype", "channel", "sections", "corrections")
    attributes["planish"] = {"source": name} | {k: volume.attrs[k] for k in kept if volume.attrs.get(k) is not None}
    group = zarr.open_group(folder, mode="a", zarr_format=3 if ome == "0.5" else 2)
    group.attrs.update(attributes)
    levels: list[Array] = []
    for k, size in enumerate(shapes):
        if str(k) in group:
            levels.append(group[str(k)])  # type: ignore[arg-type]
            continue
        shard = tuple(min(s, -(-n // c) * c) for s, n, c in zip(SHARD, size, CHUNK, strict=True))
        how: dict[str, Any] = {"chunk_key_encoding": {"name": "v2", "separator": "/"}}
        if ome == "0.5":
            codec = ZstdCodec(level=1, checksum=True)
            how = {"shards": shard, "compressors": [codec], "dimension_names": list("zyx")}
        array = group.create_array(
            str(k), shape=size, dtype=volume.dtype, chunks=CHUNK, fill_value=0, config={"write_empty_chunks": True},
            **how,
        )  # fmt: skip
        levels.append(array)
    return levels


def _identity(volume: xr.DataArray) -> dict[str, Any]:
    """What identifies an input without reading it whole."""
    keys = ("file_name", "file_bytes", "voxel_um")
    found = {"shape": list(volume.shape), "dtype": str(volume.dtype), **{k: volume.attrs.get(k) for k in keys}}
    corrections = volume.attrs.get("corrections")
    return found if corrections is None else found | {"corrections": corrections}  # other options, other voxels


def _same_source(folder: Path, source: dict[str, Any]) -> None:
    """Compare what is imported with what an import that stopped has noted."""
    note = folder / _SOURCE
    try:
        noted = None if is_link(note) else json.loads(note.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        noted = None
    if not isinstance(noted, dict) or not source.keys() - {"corrections"} <= noted.keys():
        raise InputError(
            f"{folder} is in the way and no import that stopped. Nothing was changed. Move that folder away, or give "
            "another name with --out."
        )
    if noted != json.loads(json.dumps(source)):
        raise InputError(
            f"An import of another volume stopped half-way at {folder}. Remove that folder, or give another name with "
            "--out."
        )


def _listed(folder: Path) -> dict[str, str]:
    """Shards of all levels and their checksums; a last line that was cut off does not count."""
    found: dict[str, str] = {}
    for path in sorted(folder.glob(f"*/{CHECKSUMS}")):
        for line in path.read_text(encoding="utf-8").splitlines(keepends=True):
            if line.endswith("\n") and line[64:66] == "  ":
                found[f"{path.parent.name}/{line[66:-1]}"] = line[:64]
    return found


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
