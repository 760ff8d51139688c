"""Names of files and folders that every system takes: a run is handed on, also to Windows."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path, PurePath
from typing import Any

from planish.core.errors import FileError

_DEVICES = {
    *("con", "prn", "aux", "nul", "conin$", "conout$"),
    *(f"{device}{k}" for device in ("com", "lpt") for k in "123456789¹²³"),
}
_NOT_ON_WINDOWS = '<>:"|?*'
_LONGEST = 259  # characters of a path, where Windows is not set to take longer ones
INSIDE = 120
"""Characters that the longest path inside of a run folder takes while it is written, of a layer with a short name."""


def fault_of_name(name: str, *, windows: bool = os.name == "nt") -> str | None:
    """Say why a file or folder cannot have a name; None where it can.

    Parameters
    ----------
    name : str
        One part of a path.
    windows : bool
        Whether it is for Windows alone; names that no copy on Windows could have are refused everywhere.
    """
    if name.split(".")[0].rstrip(" ").casefold() in _DEVICES:
        return "Windows keeps that name for a device"
    if name != name.rstrip(". "):
        return "Windows drops a dot or a blank at the end of a name"
    if windows and (forbidden := [sign for sign in name if sign in _NOT_ON_WINDOWS or ord(sign) < 32]):
        return f"Windows takes no {' '.join(map(repr, forbidden))} in a name"
    return None


def check_name(path: Path) -> None:
    """Raise FileError if something to be written has a name, or lies in a folder to be made, that cannot be."""
    missing = [path.absolute()]
    for parent in path.absolute().parents:
        if parent.is_dir():
            break
        missing.append(parent)
    refuse_name(path, [place.name for place in missing])


def refuse_name(path: PurePath, names: list[str], *, windows: bool = os.name == "nt") -> None:
    """Raise FileError for the first of the names that cannot be."""
    for name in names:
        if name and (fault := fault_of_name(name, windows=windows)):
            raise FileError(f"{path} cannot be written: {fault}. Choose another name than {name!r}.")


def check_length(folder: PurePath, *, longest: int | None = None) -> None:
    """Raise FileError if the files in a run folder would have longer paths than the system takes.

    Parameters
    ----------
    folder : absolute path
    longest : int, optional
        Characters that a path may have; what this system takes where not given.
    """
    longest = longest_path() if longest is None else longest
    # While it is written it stands in a hidden folder of twice its name.
    needed = len(str(folder.parent)) + 2 * len(folder.name) + len("/..work/..01234567.partial/") + INSIDE
    if longest is not None and needed > longest:
        raise FileError(
            f"{folder} is too deep: its files would have paths of up to {needed} characters, and Windows takes "
            f"{longest}. Write to a shorter path such as C:\\data\\{folder.name}, or let Windows take long paths "
            "(docs/how-to/windows.md)."
        )


def longest_path() -> int | None:
    """Characters that a path may have; None where there is no limit that matters."""
    if os.name != "nt":
        return None
    library: Any = getattr(ctypes, "windll").ntdll  # noqa: B009  # not known to checkers elsewhere
    return None if library.RtlAreLongPathsEnabled() else _LONGEST
