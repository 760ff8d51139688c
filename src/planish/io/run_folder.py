"""The run folder: written beside its place and moved there when it is whole, so that a failed run leaves no results."""

import json
import os
import secrets
import shutil
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import xarray as xr
import zarr
from filelock import FileLock, Timeout
from zarr.errors import ZarrUserWarning

from planish.core.errors import FileError
from planish.core.files import DiskFull, check_exists, check_length, check_name, delete, disk_full, move, writing
from planish.core.lazy import ReadOnDemand
from planish.io.formats import find_place
from planish.io.map_store import CHUNK, CODECS, COMPLETE, OVERVIEWS, is_large, overviews_of, readable, stored_group

WORK_MARKER = "planish-work-folder"  # file that marks a folder as one that planish made and may remove
_METADATA = "zarr.json"
_WORK_TEXT = "Results of single tiles of a run that planish is working on. It removes this folder at the end.\n"
_IN_THE_WAY = (
    "planish needs that name for a folder of its own while it writes {}. Nothing was changed. Move it away, or give "
    "another name with --out."
)


@contextmanager
def new_folder(path: Path, *, inside: Path | None = None, needed: int | None = None) -> Generator[Path]:
    """Give a hidden folder to write into; it becomes ``path`` when the block ends well, and vanishes when not.

    ``inside`` is an existing folder beside ``path`` where it may stand meanwhile, such as that of :func:`work_folder`,
    which sweeps up what a killed process has left. ``needed`` is about how many bytes it takes. FileError if ``path``
    exists or cannot be written, ResourceError if the disk is full.
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


@contextmanager
def work_folder(path: Path, key: str) -> Generator[Path]:
    """Give a hidden folder for what a run would not like to work out twice.

    It vanishes when the block ends, well or not. Only a process that was killed leaves it behind; the next run to
    ``path`` with the same ``key`` then finds what was in it, and with another key an empty one. FileError if another
    process is writing to ``path`` at this moment, the folder cannot be made, or something that is not planish's has its
    name: a link, a file, or a folder without the marker. Nothing is touched then.
    """
    check_length(path.absolute())
    work = path.with_name(f".{path.name}.work")
    marker, key_file = work / WORK_MARKER, work / "key"
    with writing(path):
        claim_folder(work, WORK_MARKER, _WORK_TEXT, for_what=path)
        names = {entry.name for entry in work.iterdir()}  # Everything in it has to be planish's own.
        foreign_names = sorted(name for name in names if is_link(work / name) or not _is_work_name(name))
        # Versions before the marker wrote a key of 64 digits and a lock.
        is_marked = _has_text(marker, _WORK_TEXT) if marker.name in names else {"key", "lock"} <= names
        if foreign_names or not is_marked:
            fault_text = f"holds {', '.join(foreign_names[:3])}" if foreign_names else f"has no file {WORK_MARKER}"
            raise FileError(f"{work} was not made by planish (it {fault_text}). {_IN_THE_WAY.format(path.name)}")
        lock = acquire_lock(work / "lock", path)
        try:
            marker.write_text(_WORK_TEXT, encoding="utf-8", newline="\n")
            if not _has_text(key_file, key):
                shutil.rmtree(work / "tiles", ignore_errors=True)
                key_file.write_text(key, encoding="utf-8", newline="\n")
            for partial_folder in work.glob(".*.partial"):
                shutil.rmtree(partial_folder, ignore_errors=True)
            yield work
        finally:
            lock.release()
            _remove_work_folder(work)


def _has_text(file: Path, expected_text: str) -> bool:
    return file.is_file() and file.read_text(encoding="utf-8") == expected_text


def acquire_lock(lock_file: Path, path: Path) -> FileLock:
    """Take the lock of a folder in which ``path`` is made; FileError where another process has it."""
    lock = FileLock(lock_file)
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise FileError(f"Another planish is writing {path} now. Wait for it, or give another name.") from error
    return lock


def claim_folder(folder: Path, marker_name: str, marker_text: str, *, for_what: Path) -> None:
    """Make a folder with a marker from its first moment, or leave the one there; FileError at a link or a file."""
    if is_link(folder) or folder.is_file():
        kind = "a link" if is_link(folder) else "a file"
        raise FileError(f"{folder} is {kind}. {_IN_THE_WAY.format(for_what.name)}")
    if folder.exists():
        return
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary_folder = folder.with_name(f"{folder.name}.{secrets.token_hex(4)}")
    temporary_folder.mkdir()
    try:
        (temporary_folder / marker_name).write_text(marker_text, encoding="utf-8", newline="\n")
        move(temporary_folder, folder)
    except (OSError, FileError):
        shutil.rmtree(temporary_folder, ignore_errors=True)
        if not folder.is_dir():  # otherwise another process was faster
            raise


def is_link(path: Path) -> bool:
    """True if a path is a symbolic link or, on Windows, a junction."""
    isjunction: Callable[[Path], bool] = getattr(os.path, "isjunction", lambda _path: False)  # from Python 3.12 on
    return path.is_symlink() or isjunction(path)


def sweep(path: Path) -> None:
    """Remove the work folder that a process left which was killed when ``path`` was whole already."""
    work = path.with_name(f".{path.name}.work")
    if (work / WORK_MARKER).is_file():
        _remove_work_folder(work)


def _is_work_name(name: str) -> bool:
    return name in (WORK_MARKER, "key", "lock", "tiles") or (name.startswith(".") and name.endswith(".partial"))


def _remove_work_folder(work: Path) -> None:
    """Remove what :func:`work_folder` has written, the marker last, and the folder if nothing else is in it."""
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

    zarr writes chunks from threads of its own. When one of them fails, the others still finish theirs and make
    folders anew for them, so the folder is removed again until it stays away.
    """
    deadline = time.monotonic() + 10.0
    while folder.exists() and time.monotonic() < deadline:
        shutil.rmtree(folder, ignore_errors=True)
        time.sleep(0.2)


def refuse_inside(path: Path, inputs: Iterable[str | Path]) -> None:
    """Raise FileError if ``path`` lies in a folder that is an input."""
    place = path.absolute().resolve()
    for source in (find_place(name).path for name in inputs):
        if source.is_dir() and source.resolve() in (place, *place.parents):
            raise FileError(
                f"{path} lies in {source}, which is read; nothing is written there. Give another name with --out."
            )


def refuse_existing(*paths: Path) -> None:
    """Raise FileError if something stands at one of the paths already, or nothing can have that name."""
    for path in paths:
        check_name(path)
        if path.exists() or path.is_symlink():
            raise FileError(
                f"{path} exists already. Results are never written over: give another name with --out, or remove it "
                "first."
            )


def write_tree(path: Path, groups: Mapping[str, xr.Dataset]) -> None:
    """Write datasets as groups of a zarr store for ``xarray.open_datatree(path, engine="zarr")``; others in it stay."""
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs={COMPLETE: True}), **groups})
    encoding: dict[str, dict[str, dict[str, Any]]] = {}
    for name, group in groups.items():
        encoding[f"/{name}"] = {str(key): {"compressors": CODECS} for key in group.variables}
        for key, maps in group.variables.items():
            if maps.ndim > 1:
                encoding[f"/{name}"][str(key)]["chunks"] = tuple(min(n, CHUNK) for n in maps.shape)
    with warnings.catch_warnings(), zarr.config.set({"array.write_empty_chunks": True}):
        # zarr 3 warns that consolidated metadata are no part of its specification yet; without them every open warns.
        warnings.simplefilter("ignore", ZarrUserWarning)
        tree.to_zarr(path, mode="a", zarr_format=3, consolidated=True, write_inherited_coords=False, encoding=encoding)


def take_group(path: Path, source: Path, name: str) -> None:
    """Put a group of one store into another with its smaller copies; chunks as links where the disk has these."""
    overviews = f"{OVERVIEWS}/{name}"
    for group in (name, overviews) if (source / overviews).is_dir() else (name,):
        shutil.copytree(source / group, path / group, copy_function=_link_or_copy)
    if (path / OVERVIEWS).is_dir():
        shutil.copy2(source / OVERVIEWS / _METADATA, path / OVERVIEWS)


def _link_or_copy(source: str, target: str) -> None:
    if Path(source).name != _METADATA:
        with suppress(OSError):  # another disk, or one without links
            os.link(source, target)
            return
    shutil.copy2(source, target)


def open_tree(path: Path, among: Iterable[str] | None = None) -> Mapping[str, xr.Dataset]:
    """Groups of a store by name, of ``among`` only, read when asked for; large ones come with their smaller copies."""
    return ReadOnDemand(partial(_group_names, path, among), partial(read_group, path))


def read_tree(path: Path) -> dict[str, xr.Dataset]:
    """Read all groups of a store, as :func:`open_tree` gives them, into memory as far as they are not large.

    Raises
    ------
    FileError
        If there is no store, or it is damaged.
    """
    return dict(open_tree(path))


def _group_names(path: Path, among: Iterable[str] | None) -> list[str]:
    """Names of the groups of a store that hold arrays, checked to be whole; FileError as `read_tree`."""
    check_exists(path)
    if not (path / _METADATA).is_file():
        raise FileError(f"{path} is no zarr store. Give the maps.zarr of a run, or what a stage's command wrote.")
    with readable(path):
        root = zarr.open_group(path, mode="r")
        if among is not None:
            present = [name for name in among if name in root]
            _check_chunks(path, present)
            return present
        _check_chunks(path)
        members = sorted(root.members(max_depth=None))
        groups = {name: [*node.array_values()] for name, node in members if isinstance(node, zarr.Group)}
        names = [name for name, arrays in groups.items() if arrays and not name.startswith(f"{OVERVIEWS}/")]
        return names + [copy for name in names if is_large(groups[name]) for copy in overviews_of(path, name)]


def read_group(path: Path, name: str, variables: Iterable[str] | None = None) -> xr.Dataset:
    """Read one group of a store, or some of its variables; of half a gigabyte and more, part by part when asked for.

    Raises
    ------
    FileError
        If it is damaged.
    """
    with readable(path):
        group = stored_group(path, name)
        selection = group if variables is None else group[list(variables)]
        return selection if is_large(group.data_vars.values()) else selection.load()


def _check_chunks(path: Path, groups: Iterable[str] = ("",)) -> None:
    """Raise FileError where a chunk was lost: zarr takes it for missing values."""
    root = zarr.open_group(path, mode="r")
    if not root.attrs.get(COMPLETE):
        return
    for group in (zarr.open_group(path, path=name, mode="r") for name in groups):
        for name, node in group.members(max_depth=None):
            if isinstance(node, zarr.Array) and node.nchunks_initialized < node.nchunks:
                raise FileError(
                    f"{path} is damaged: {node.nchunks - node.nchunks_initialized} of {node.nchunks} chunks of {name} "
                    "are not there. Copy it once more, or repeat the run."
                )


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write JSON with sorted keys off, two spaces, and no NaN (they are errors: use None)."""
    path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8", newline="\n")
