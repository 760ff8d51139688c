"""Write the run folder beside its place and move it there when it is whole.

Thus a failed run leaves no results.
"""

import json
import os
import secrets
import shutil
import time
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from planish.core.errors import FileError
from planish.core.files import (
    DiskFull,
    check_length,
    check_name,
    delete,
    disk_full,
    move,
    write_text,
    writing,
)
from planish.io.formats import find_place

# File that marks a folder as one that planish made and may remove.
WORK_MARKER = "planish-work-folder"
_METADATA = "zarr.json"
_WORK_TEXT = (
    "Results of single tiles of a run that planish is working on. It removes this folder at the"
    " end.\n"
)
_IN_THE_WAY = (
    "planish needs that name for a folder of its own while it writes {}. Nothing was changed. Move"
    " it away, or give another name with `out`."
)


@contextmanager
def new_folder(
    path: Path, *, inside: Path | None = None, needed: int | None = None
) -> Generator[Path]:
    """Give a hidden folder to write into.

    It becomes ``path`` when the block ends well, and vanishes when not.

    Parameters
    ----------
    path : Path
    inside : Path, optional
        Existing folder beside ``path`` where it may stand meanwhile, such as that of
        :func:`work_folder`, which sweeps up what a killed process has left.
    needed : int, optional; about how many bytes it takes

    Raises
    ------
    FileError
        If ``path`` exists or cannot be written.
    ResourceError
        If the disk is full.
    """
    refuse_existing(path)
    check_length(path.absolute())
    with writing(path, needed=needed):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = (inside or path.parent) / f".{path.name}.{secrets.token_hex(4)}.partial"
        partial.mkdir()  # by the user's umask, and never one that is there
        try:
            yield partial
            refuse_existing(path)
            move(partial, path)
        except DiskFull as error:
            raise disk_full(path, needed) from error
        finally:
            remove(partial)


def _fault_of_work(work: Path) -> str:
    """Why a hidden folder is not planish's own; empty where everything in it is."""
    names = {entry.name for entry in work.iterdir()}
    foreign_names = sorted(
        name for name in names if is_link(work / name) or not _is_work_name(name)
    )
    if foreign_names:
        return f"holds {', '.join(foreign_names[:3])}"
    # Versions before the marker wrote a key of 64 digits and a lock.
    is_marked = {"key", "lock"} <= names
    if WORK_MARKER in names:
        is_marked = _has_text(work / WORK_MARKER, _WORK_TEXT)
    return "" if is_marked else f"has no file {WORK_MARKER}"


@contextmanager
def work_folder(path: Path, key: str) -> Generator[Path]:
    """Give a hidden folder for what a run would not like to work out twice.

    It vanishes when the block ends, well or not. Only a process that was killed leaves it behind.

    Parameters
    ----------
    path : Path; of the run
    key : str
        The next run to ``path`` with the same key finds what was in it, and with another key an
        empty one.

    Raises
    ------
    FileError
        If another process is writing to ``path`` at this moment, the folder cannot be made, or
        something that is not planish's has its name: a link, a file, or a folder without the
        marker. Nothing is touched then.
    """
    check_length(path.absolute())
    work = path.with_name(f".{path.name}.work")
    marker = work / WORK_MARKER
    key_file = work / "key"
    with writing(path):
        claim_folder(work, WORK_MARKER, _WORK_TEXT, for_what=path)
        fault_text = _fault_of_work(work)
        if fault_text:
            raise FileError(
                f"{work} was not made by planish (it {fault_text}). {_IN_THE_WAY.format(path.name)}"
            )
        lock = acquire_lock(work / "lock", path)
        try:
            write_text(marker, _WORK_TEXT)
            if not _has_text(key_file, key):
                shutil.rmtree(work / "tiles", ignore_errors=True)
                write_text(key_file, key)
            for partial_folder in work.glob(".*.partial"):
                shutil.rmtree(partial_folder, ignore_errors=True)
            yield work
        finally:
            lock.release()
            _remove_work_folder(work)


def _has_text(file: Path, expected_text: str) -> bool:
    return file.is_file() and file.read_text(encoding="utf-8") == expected_text


def acquire_lock(lock_file: Path, path: Path) -> FileLock:
    """Take the lock of a folder in which ``path`` is made.

    FileError where another process has it.
    """
    lock = FileLock(lock_file)
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise FileError(
            f"Another planish is writing {path} now. Wait for it, or give another name."
        ) from error
    return lock


def claim_folder(folder: Path, marker_name: str, marker_text: str, *, for_what: Path) -> None:
    """Make a folder with a marker from its first moment, or leave the one there.

    FileError at a link or a file.
    """
    if is_link(folder) or folder.is_file():
        kind = "a link" if is_link(folder) else "a file"
        raise FileError(f"{folder} is {kind}. {_IN_THE_WAY.format(for_what.name)}")
    if folder.exists():
        return
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary_folder = folder.with_name(f"{folder.name}.{secrets.token_hex(4)}")
    temporary_folder.mkdir()
    try:
        write_text(temporary_folder / marker_name, marker_text)
        move(temporary_folder, folder)
    except (OSError, FileError):
        shutil.rmtree(temporary_folder, ignore_errors=True)
        if not folder.is_dir():  # otherwise another process was faster
            raise


def is_link(path: Path) -> bool:
    """True if a path is a symbolic link or, on Windows, a junction."""
    # From Python 3.12 on.
    isjunction: Callable[[Path], bool] = getattr(os.path, "isjunction", lambda _path: False)
    return path.is_symlink() or isjunction(path)


def sweep(path: Path) -> None:
    """Remove the work folder of a process that was killed when ``path`` was whole already."""
    work = path.with_name(f".{path.name}.work")
    if (work / WORK_MARKER).is_file():
        _remove_work_folder(work)


def _is_work_name(name: str) -> bool:
    is_partial = name.startswith(".") and name.endswith(".partial")
    return is_partial or name in (WORK_MARKER, "key", "lock", "tiles")


def _remove_work_folder(work: Path) -> None:
    """Remove what :func:`work_folder` has written, and the folder if nothing else is in it.

    Of what was written, the marker goes last.
    """
    if is_link(work) or not work.is_dir():
        return
    entries = [entry for entry in work.iterdir() if _is_work_name(entry.name)]
    for entry in sorted(entries, key=lambda entry: entry.name == WORK_MARKER):
        if entry.is_dir() and not is_link(entry):
            remove(entry)
        else:
            delete(entry)
    with suppress(OSError):
        work.rmdir()


def remove(folder: Path) -> None:
    """Remove a folder for good.

    zarr writes chunks from threads of its own. When one of them fails, the others still finish
    theirs and make folders anew for them, so the folder is removed again until it stays away.
    """
    deadline = time.monotonic() + 10.0
    while folder.exists() and time.monotonic() < deadline:
        shutil.rmtree(folder, ignore_errors=True)
        time.sleep(0.2)


def refuse_inside(path: Path, inputs: Iterable[str | Path]) -> None:
    """Refuse to write into a folder that is read.

    Parameters
    ----------
    path : Path; what is to be written
    inputs : iterable of str or Path; what is read

    Raises
    ------
    FileError
        If ``path`` lies in one of the inputs.
    """
    place = path.absolute().resolve()
    for source in (find_place(name).path for name in inputs):
        if source.is_dir() and source.resolve() in (place, *place.parents):
            raise FileError(
                f"{path} lies in {source}, which is read; nothing is written there. Give another"
                " name with `out`."
            )


def refuse_existing(*paths: Path) -> None:
    """Raise FileError if something stands at one of the paths, or nothing can have that name."""
    for path in paths:
        check_name(path)
        if path.exists() or path.is_symlink():
            raise FileError(
                f"{path} exists already. Results are never written over: give another name with"
                " `out`, or remove it first."
            )


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a file of JSON, keys in their order, indented by two spaces.

    Parameters
    ----------
    path : Path
    data : mapping; NaN in it is an error: use None
    """
    write_text(path, json.dumps(data, indent=2, allow_nan=False) + "\n")
