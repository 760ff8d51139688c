"""A hash by which two volumes or images, in one file or many, can be compared byte by byte."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

from planish.io.checksums import store_fingerprint
from planish.io.formats import SLICES, TIFF, Place, find_place, format_of, loader
from planish.io.guard import reading, size_of_file
from planish.io.sections import COUNTER, is_section_folder
from planish.io.slice_volume import slice_files
from planish.io.slices import is_slice_name, read_scan


def fingerprint(path: str | Path) -> str:
    """SHA-256 of an input, computed when asked for because it reads every byte.

    Parameters
    ----------
    path : path
        A file, a folder of slices, or a store of many files; ``file.h5:/entry/data`` is another volume than
        ``file.h5:/entry/other``.

    Returns
    -------
    str
        64 hexadecimal digits. For a folder, and for a header with its data: the hash over name and hash of each file,
        sorted by name; the counter of sections counts, other files in a folder of slices do not, nor does the name of
        the folder.

    Raises
    ------
    FileError
        If the file or folder cannot be read.
    VolumeError
        If the folder is not one series of slices.
    """
    place = find_place(path)
    path = place.path
    total = hashlib.sha256(f"{place.part}\n".encode() if place.part else b"")
    # A store that planish wrote has the hashes of its shards already.
    if format_of(place).members and (stored := store_fingerprint(path)):
        total.update(stored.encode())
        return total.hexdigest() if place.part else stored
    files = files_of(place)
    if files == [path] and not place.part:
        return hash_of_file(path)
    base = path if path.is_dir() else path.parent
    for name, file in sorted((file.relative_to(base).as_posix(), file) for file in files):
        total.update(f"{hash_of_file(file)}  {name}\n".encode())
    return total.hexdigest()


def files_of(place: Place) -> list[Path]:
    """List the files that an input is made of, reading its headers alone; errors as of :func:`fingerprint`."""
    path, kind = place.path, format_of(place)
    # Sections have gaps that are none: their counter says where each one lies, and is part of what was measured.
    if is_section_folder(path):
        return [file for file in path.iterdir() if is_slice_name(file.name) or file.name == COUNTER]
    if kind is SLICES:
        return slice_files(path, read_scan(path))
    if path.is_dir():
        return [file for file in path.rglob("*") if file.is_file()]
    return [path] if kind is TIFF else list(dict.fromkeys(loader(kind)(place, None, sys.maxsize).files))


_hashes_read: dict[tuple[Path, int, int, int], str] = {}
"""Hashes of files read before by this process, by path, size, time of change and inode."""


def hash_of_file(path: Path) -> str:
    """SHA-256 of one file; a file that has not changed since is not read again."""
    size_of_file(path)
    with reading(path), path.open("rb") as file:
        status = os.fstat(file.fileno())
        key = (path.absolute(), status.st_size, status.st_mtime_ns, status.st_ino)
        if key not in _hashes_read:
            _hashes_read[key] = hashlib.file_digest(file, "sha256").hexdigest()
        return _hashes_read[key]
