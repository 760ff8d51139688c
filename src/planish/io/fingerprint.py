"""A hash that tells whether two files, or two folders of slices, hold the same bytes."""

from __future__ import annotations

import hashlib
from pathlib import Path

from planish.io.guard import reading, size_of_file
from planish.io.sections import COUNTER, is_section_folder
from planish.io.slices import is_slice_name, list_slices


def fingerprint(path: str | Path) -> str:
    """SHA-256 of an input, computed when asked for because it reads every byte.

    Parameters
    ----------
    path : path
        A file, or a folder of slices.

    Returns
    -------
    str
        64 hexadecimal digits. For a folder: the hash over name and hash of each slice, sorted by name; the counter
        of sections counts, other files in the folder do not, nor does the name of the folder.

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
    # Sections have gaps that are none: their counter says where each one lies, and is part of what was measured.
    files = (
        [file for file in path.iterdir() if is_slice_name(file.name) or file.name == COUNTER]
        if is_section_folder(path)
        else list_slices(path)
    )
    for name, file in sorted((file.name, file) for file in files):
        total.update(f"{hash_of_file(file)}  {name}\n".encode())
    return total.hexdigest()


def hash_of_file(path: Path) -> str:
    """SHA-256 of one file."""
    size_of_file(path)
    with reading(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
