"""The run folder: written beside its place first and moved there when it is whole.

A run that fails half way leaves nothing behind that could be taken for a result.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import tempfile
import time
import warnings
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import xarray as xr
from filelock import FileLock, Timeout
from zarr.errors import ZarrUserWarning

from planish.core.errors import FileError, ResourceError

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


@contextmanager
def new_folder(path: Path, *, inside: Path | None = None) -> Generator[Path]:
    """Give a hidden folder to write into; it becomes ``path`` when the block ends well, and vanishes when not.

    ``inside`` is an existing folder beside ``path`` where it may stand meanwhile, such as that of :func:`work_folder`,
    which sweeps up what a killed process has left.

    Raises
    ------
    FileError
        If ``path`` exists or cannot be written.
    ResourceError
        If the disk is full.
    """
    refuse_existing(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".partial", dir=inside or path.parent))
    except OSError as error:
        raise as_planish(error, path) from error
    try:
        yield partial
        refuse_existing(path)
        partial.chmod(0o755)
        partial.rename(path)
    except OSError as error:
        raise as_planish(error, path) from error
    finally:
        _remove(partial)


@contextmanager
def work_folder(path: Path, key: str) -> Generator[Path]:
    """Give a hidden folder for what a run would not like to work out twice.

    It vanishes when the block ends, well or not. Only a process that was killed leaves it behind; the next run to
    ``path`` with the same ``key`` then finds what was in it, and with another key an empty one.

    Raises
    ------
    FileError
        If another process is writing to ``path`` at this moment, or the folder cannot be made.
    """
    work = path.with_name(f".{path.name}.work")
    try:
        work.mkdir(parents=True, exist_ok=True)
        lock = FileLock(work / "lock")
        lock.acquire(timeout=0)
    except Timeout as error:
        raise FileError(
            f"Another planish is writing {path} at this moment. Wait for it, or give another name."
        ) from error
    except OSError as error:
        raise as_planish(error, path) from error
    try:
        note = work / "key"
        if not (note.is_file() and note.read_text(encoding="utf-8") == key):
            for stale in work.iterdir():
                if stale.is_dir():
                    shutil.rmtree(stale, ignore_errors=True)
            note.write_text(key, encoding="utf-8")
        for half in work.glob(".*.partial"):
            shutil.rmtree(half, ignore_errors=True)
        yield work
    except OSError as error:
        raise as_planish(error, path) from error
    finally:
        lock.release()
        _remove(work)


def _remove(folder: Path, *, patience_s: float = 10.0) -> None:
    """Remove a folder for good.

    zarr writes chunks from threads of its own. When one of them fails, the others still finish theirs and make
    folders anew for them, so the folder is removed again until it stays away.
    """
    end = time.monotonic() + patience_s
    while folder.exists() and time.monotonic() < end:
        shutil.rmtree(folder, ignore_errors=True)
        time.sleep(0.2)


def refuse_existing(path: Path) -> None:
    """Raise FileError if something stands at ``path`` already."""
    if path.exists() or path.is_symlink():
        raise FileError(
            f"{path} exists already. Results are never written over: give another name with --out, or remove it first."
        )


def write_tree(path: Path, groups: Mapping[str, xr.Dataset]) -> None:
    """Write datasets as groups of one zarr store that ``xarray.open_datatree(path, engine="zarr")`` opens."""
    tree = xr.DataTree.from_dict({f"/{name}": data for name, data in groups.items()})
    with warnings.catch_warnings():
        # zarr 3 warns that consolidated metadata are no part of its specification yet; without them every open warns.
        warnings.simplefilter("ignore", ZarrUserWarning)
        tree.to_zarr(path, zarr_format=3, consolidated=True, write_inherited_coords=False)


def read_tree(path: Path) -> dict[str, xr.Dataset]:
    """Read all groups of a store into memory.

    Raises
    ------
    FileError
        If there is no store, or it is damaged.
    """
    if not (path / "zarr.json").is_file():
        raise FileError(f"{path} is no zarr store. Give the maps.zarr of a run, or what a stage's command wrote.")
    try:
        with xr.open_datatree(path, engine="zarr") as tree:
            return {
                node.path.strip("/"): node.to_dataset(inherit=False).load() for node in tree.subtree if node.data_vars
            }
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise FileError(f"{path} cannot be read: {error}. It may be damaged; repeat the run.") from error


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write JSON with sorted keys off, two spaces, and no NaN (they are errors: use None)."""
    path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8", newline="\n")


def as_planish(error: OSError, path: Path) -> FileError | ResourceError:
    """Turn a failed write into the error that says what to do about it."""
    if error.errno in _FULL:
        free = shutil.disk_usage(path.parent if path.parent.exists() else Path.cwd()).free
        return ResourceError(
            f"The disk is full while writing {path} ({free / 1e6:.0f} MB are free). Nothing was kept of it. "
            "Free some space or give --out on another disk."
        )
    return FileError(f"{path} cannot be written: {os.strerror(error.errno) if error.errno else error}.")
