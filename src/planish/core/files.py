"""Files that are written whole or not at all, with names that every system takes.

A run is handed on.
"""

from __future__ import annotations

import ctypes
import errno
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from itertools import chain, count
from pathlib import Path, PurePath
from typing import Any

from planish.core.errors import FileError, PlanishError, ResourceError
from planish.core.source_hash import report_to

_DEVICES = {
    *("con", "prn", "aux", "nul", "conin$", "conout$"),
    *(f"{device}{k}" for device in ("com", "lpt") for k in "123456789¹²³"),
}
_NOT_ON_WINDOWS = '<>:"|?*'
# Characters that the longest path inside of a run folder takes while it is written, of a layer with
# a short name.
DEEPEST_PATH_LENGTH = 120


def fault_of_name(name: str, *, windows: bool = os.name == "nt") -> str | None:
    """Say why a file or folder cannot have a name, one part of a path; None where it can.

    Names that no copy on Windows could have are refused everywhere, others for ``windows`` alone.
    """
    if name.split(".")[0].rstrip(" ").casefold() in _DEVICES:
        return "Windows keeps that name for a device"
    if name != name.rstrip(". "):
        return "Windows drops a dot or a blank at the end of a name"
    forbidden = [c for c in name if c in _NOT_ON_WINDOWS or ord(c) < 32]
    if windows and forbidden:
        return f"Windows takes no {' '.join(map(repr, forbidden))} in a name"
    return None


def check_exists(path: Path) -> None:
    """Raise FileError, with the whole path, if nothing is there.

    Most often a letter or a folder is wrong.
    """
    if not path.exists():
        raise FileError(f"{path.absolute()} does not exist. Check the name and the folder.")


def check_name(path: Path) -> None:
    """Raise FileError if something to be written has a name that cannot be.

    The same if it lies in a folder to be made whose name cannot be.
    """
    missing = [path.absolute()]
    for parent in path.absolute().parents:
        if parent.is_dir():
            break
        missing.append(parent)
    refuse_name(path, [absent.name for absent in missing])


def refuse_name(path: PurePath, names: list[str], *, windows: bool = os.name == "nt") -> None:
    """Raise FileError for the first of the names that cannot be."""
    for name in names:
        fault = fault_of_name(name, windows=windows)
        if name and fault:
            raise FileError(
                f"{path} cannot be written: {fault}. Choose another name than {name!r}."
            )


def check_length(folder: PurePath, *, longest: int | None = None) -> None:
    """Raise FileError if files in a run folder (absolute) would have paths that are too long.

    Longer than the system takes, or than ``longest``.
    """
    longest = longest_path() if longest is None else longest
    # While it is written it stands in a hidden folder of twice its name.
    path_length = len(f"{folder.parent}{2 * folder.name}/..work/..01234567.partial/")
    needed = path_length + DEEPEST_PATH_LENGTH
    if longest is not None and needed > longest:
        raise FileError(
            f"{folder} is too deep: its files would have paths of up to {needed} characters, and"
            f" Windows takes {longest}. Write to a shorter path such as C:\\data\\{folder.name}, or"
            " let Windows take long paths (docs/how-to/windows.md)."
        )


def longest_path() -> int | None:
    """Characters that a path may have; None where there is no limit that matters."""
    if os.name != "nt":
        return None
    library: Any = getattr(ctypes, "windll").ntdll  # noqa: B009  # not known to checkers elsewhere
    return None if library.RtlAreLongPathsEnabled() else 259


_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
# Numpy's words where the system gives no reason.
_CUT_SHORT = re.compile(r"\d+ requested and \d+ written")


def write_whole(path: Path, data: bytes, *, over: bool = False) -> None:
    """Write a file as :func:`new_file` does; its name is one that every system takes."""
    check_name(path)
    with new_file(path, needed=len(data), over=over) as partial:
        partial.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a text with the same bytes on every system: in UTF-8, lines end with a line feed."""
    path.write_text(text, encoding="utf-8", newline="\n")


@contextmanager
def new_file(
    path: Path, *, needed: int | None = None, over: bool = False, with_parents: bool = False
) -> Generator[Path]:
    """Give a hidden path to write a file to.

    It becomes ``path`` when the block ends well, else nothing is left.

    ``needed`` is about how many bytes it takes; ``over``, whether an older file of planish's own is
    written over; ``with_parents``, whether its folder is made where it is not there. FileError if
    the file is there already or cannot be written, ResourceError if the disk is full.
    """
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    with writing(path, needed=needed):
        if with_parents:
            path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield partial
            with partial.open("rb+") as file:
                os.fsync(file.fileno())
            if not over and (path.exists() or path.is_symlink()):
                raise FileError(
                    f"{path} is already there; nothing is overwritten. Choose another name."
                )
            move(partial, path, over=over)
        finally:
            with suppress(OSError):  # held open; the error that matters is the first
                partial.unlink(missing_ok=True)


def free_path(path: Path) -> Path:
    """Give the first of path, path-2, path-3 ... that does not exist."""
    numbered = (path.with_name(f"{path.name}-{k}") for k in count(2))
    return next(candidate for candidate in chain([path], numbered) if not candidate.exists())


@contextmanager
def writing(path: Path, *, needed: int | None = None) -> Generator[None]:
    """Turn a failed write into the error that says what to do about it.

    ``needed``: bytes, where known.
    """
    try:
        yield
    except OSError as error:
        raise write_failure(error, path, needed=needed) from error
    except ValueError as error:  # of a name that no system allows
        if "null" not in str(error):
            raise
        raise FileError(f"{path!r} cannot be written: {error}. Choose another name.") from error


def write_failure(error: OSError, path: Path, *, needed: int | None = None) -> FileError | DiskFull:
    """The error that says what to do about a failed write."""
    if error.errno in _FULL or (error.errno is None and _CUT_SHORT.search(str(error))):
        return disk_full(path, needed)
    return FileError(
        f"{path} cannot be written: {os.strerror(error.errno) if error.errno else error}."
    )


def as_sentence(error: Exception, written_path: str, remedy: str) -> PlanishError:
    """Any error as one with a sentence; ``remedy`` says what to do where the memory is used up."""
    if isinstance(error, PlanishError):
        return error
    if isinstance(error, MemoryError):
        return ResourceError(f"The memory is used up. {remedy}")
    if isinstance(error, OSError):
        return write_failure(error, Path(error.filename or written_path))
    return PlanishError(
        f"A fault in planish: {type(error).__name__}: {error}. Nothing was written. Please"
        f" report it {report_to()}."
    )


def move(source: Path, target: Path, *, over: bool = False) -> None:
    """Rename a file or folder; over a file that is there only with ``over``.

    Windows refuses it while another program has the file, or one in the folder, open: virus
    scanners, indexers and programs that keep folders in step with a server do so for moments after
    a file was written. FileError if it is still refused after some three seconds; OSError whatever
    else keeps it from being renamed.
    """
    _retry(lambda: (source.replace if over else source.rename)(target), target)


def delete(path: Path) -> None:
    """Remove a file, which need not be there; as :func:`move` where another program has it open."""
    _retry(lambda: path.unlink(missing_ok=True), path)


def _retry(action: Callable[[], object], path: Path) -> None:
    """Do something with a file, again for some seconds while it is refused."""
    # Seconds, for what another program holds open.
    for wait in (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, None):
        try:
            action()
        except PermissionError as error:
            if wait is None:
                raise FileError(
                    f"{path} cannot be written: another program has it or its folder open, or you"
                    " may not write there. Close programs that show this folder, pause virus"
                    " scanner or synchronisation for it, or choose a folder of your own; then give"
                    " the same command again."
                ) from error
            time.sleep(wait)
        else:
            return


class DiskFull(ResourceError):
    """The disk is full."""


def disk_full(path: Path, needed: int | None = None) -> DiskFull:
    """The error that says how much is free, and needed."""
    folder = next((parent for parent in path.absolute().parents if parent.is_dir()), Path.cwd())
    free_text = f"{shutil.disk_usage(folder).free / 1e6:.0f} MB are free in {folder}"
    needed_text = "" if needed is None else f"; it takes about {max(needed / 1e6, 1):.0f} MB"
    return DiskFull(
        f"The disk is full while writing {path}: {free_text}{needed_text}. Nothing was kept of it."
        " Free some space, or give `out` on another disk."
    )
