"""A hash that tells whether two files, or two folders of slices, hold the same bytes."""

from __future__ import annotations

import hashlib
from pathlib import Path

from planish.io.guard import reading, size_of_file
from planish.io.slices import list_slices


def fingerprint(path: str | Path) -> str:
    """SHA-256 of an input, computed when asked for because it reads every byte.

    Parameters
    ----------
    path : path
        A file, or a folder of slices.

    Returns
    -------
    str
        64 hexadecimal digits. For a folder: the hash over name and hash of each slice, sorted by name; other files in
        the folder do not count, nor does the name of the folder.

    Raises
    ------
    FileError
        If the file or folder cannot be read.
    VolumeError
        If the folder is not one series of slices.
    """
    path = Path(path)
    if not path.is_dir():
        return hash_of_file(path)
    total = hashlib.sha256()
    for name, file in sorted((file.name, file) for file in list_slices(path)):
        total.update(f"{hash_of_file(file)}  {name}\n".encode())
    return total.hexdigest()


def hash_of_file(path: Path) -> str:
    """SHA-256 of one file."""
    size_of_file(path)
    with reading(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
