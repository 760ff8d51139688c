"""Give a hash by which two inputs can be compared, and the lists of checksums in a store.

An input may be in one file or many.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planish.core.files import delete, write_whole
from planish.core.lazy import chunk_parts
from planish.io.formats import SLICES, TIFF, Place, find_place, format_of, loader, pictures_in
from planish.io.guard import open_bytes
from planish.io.sections import COUNTER, is_section_folder
from planish.io.slice_volume import slice_files

if TYPE_CHECKING:
    import zarr

    Array = zarr.Array[Any]

# List of the shards of a level with their SHA-256, in the folder of the level, as ``sha256sum -c``
# reads it.
CHECKSUMS = "checksums.sha256"
Where = tuple[slice, slice, slice]
Checksums = dict[str, str]  # of shards, by their names


def missing_shards(path: Path) -> list[str]:
    """Return the shards that the lists of checksums name and that are not there.

    Empty where there is no list.
    """
    return [name for name in _read_checksums(path) if not (path / name).is_file()]


def store_fingerprint(path: Path) -> str:
    """SHA-256 over the checksums of all shards, for which no shard is read.

    Empty where there are no checksums.
    """
    shard_hashes = sorted(_read_checksums(path).items())
    if not shard_hashes:  # The shards hold the voxels, the metadata their size.
        return ""
    hashes = shard_hashes
    for file in sorted(path.rglob("*")):
        if file.name in ("zarr.json", ".zattrs", ".zarray"):
            digest = hashlib.sha256(file.read_bytes()).hexdigest()
            hashes.append((file.relative_to(path).as_posix(), digest))
    return _hash_of_hashes(hashes)


def _hash_of_hashes(hashes: Iterable[tuple[str, str]], part: str = "") -> str:
    prefix = f"{part}\n" if part else ""
    lines = "".join(f"{sha}  {name}\n" for name, sha in hashes)
    return hashlib.sha256((prefix + lines).encode()).hexdigest()


class ShardLists:
    """The lists of shards that are whole."""

    def __init__(self, folder: Path, ome: str) -> None:
        self.folder = folder.absolute()
        self.prefix = "c/" if ome == "0.5" else ""
        self.listed = set(_read_checksums(folder))

    def names(self, level: Array, where: Where) -> list[str]:
        """Files of the shards of a block, in the folder of their level."""
        parts = chunk_parts(where, level.shards or level.chunks)
        return [self.prefix + "/".join(map(str, part.position)) for part in parts]

    def has(self, level: Array, where: Where) -> bool:
        """True if all shards of a block are listed."""
        return self.listed.issuperset(
            f"{level.basename}/{name}" for name in self.names(level, where)
        )

    def add(self, level: Array, checksums: Checksums) -> None:
        """List the shards of a block that was written: only after their bytes are on the disk."""
        list_file = self.folder / level.basename / CHECKSUMS
        with list_file.open("a", encoding="utf-8", newline="\n") as file:
            file.write("".join(f"{checksum}  {name}\n" for name, checksum in checksums.items()))
            file.flush()
            os.fsync(file.fileno())
        self.listed.update(f"{level.basename}/{name}" for name in checksums)

    def settle(self) -> None:
        """Sort the lists: they do not depend on the order in which blocks were written."""
        for path in self.folder.glob(f"*/{CHECKSUMS}"):
            lines = {*path.read_text(encoding="utf-8").splitlines(keepends=True)}
            by_name = sorted(lines, key=lambda line: line[64:])
            write_whole(path, "".join(by_name).encode(), over=True)
        for half in self.folder.rglob("*.partial"):  # of a writer that was killed
            delete(half)


def _read_checksums(folder: Path) -> Checksums:
    """Shards of all levels and their checksums; a last line that was cut off does not count."""
    checksums: Checksums = {}
    for path in sorted(folder.glob(f"*/{CHECKSUMS}")):
        for line in path.read_text(encoding="utf-8").splitlines(keepends=True):
            if line.endswith("\n") and line[64:66] == "  ":
                checksums[f"{path.parent.name}/{line[66:-1]}"] = line[:64]
    return checksums


def fingerprint(path: str | Path) -> str:
    """SHA-256 of an input, computed when asked for because it reads every byte.

    Parameters
    ----------
    path : path
        A file, a folder of slices, or a store of many files; of ``file.h5:/entry/data``, that one
        volume.

    Returns
    -------
    str
        64 hexadecimal digits. For a folder, and for a header with its data: the hash over name and
        hash of each file, sorted by name; the counter of sections counts, other files in a folder
        of slices do not, nor its name.

    Raises
    ------
    FileError
        If the file or folder cannot be read.
    VolumeError
        If the folder is not one series of slices.
    """
    place = find_place(path)
    path = place.path
    # A store that planish wrote has the hashes of its shards already.
    stored_hash = store_fingerprint(path) if format_of(place).marker_files else ""
    if stored_hash and place.part:
        return hashlib.sha256(f"{place.part}\n{stored_hash}".encode()).hexdigest()
    if stored_hash:
        return stored_hash
    files = files_of(place)
    if files == [path] and not place.part:
        return hash_of_file(path)
    base_folder = path if path.is_dir() else path.parent
    named_files = sorted((file.relative_to(base_folder).as_posix(), file) for file in files)
    return _hash_of_hashes(((name, hash_of_file(file)) for name, file in named_files), place.part)


def files_of(place: Place) -> list[Path]:
    """List the files that an input is made of, reading its headers alone.

    Errors as of :func:`fingerprint`.
    """
    path = place.path
    file_format = format_of(place)
    # Sections have gaps that are none: their counter says where each one lies, and is part of what
    # was measured.
    if is_section_folder(path):
        return [*pictures_in(path), path / COUNTER]
    if file_format is SLICES:
        return slice_files(path)
    if path.is_dir():
        return [*filter(Path.is_file, path.rglob("*"))]
    if file_format is TIFF:
        return [path]
    loaded = loader(file_format)(place, None, sys.maxsize)
    return list(dict.fromkeys(loaded.files))


# Hashes of files read before by this process, by path, size, time of change and inode.
_hashes_read: dict[tuple[Path, int, int, int], str] = {}


def hash_of_file(path: Path) -> str:
    """SHA-256 of one file; a file that has not changed since is not read again."""
    with open_bytes(path) as file:
        status = os.fstat(file.fileno())
        key = (path.absolute(), status.st_size, status.st_mtime_ns, status.st_ino)
        if key not in _hashes_read:
            _hashes_read[key] = hashlib.file_digest(file, "sha256").hexdigest()
        return _hashes_read[key]
