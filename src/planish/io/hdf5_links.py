"""Finding data sets in an HDF5 file without leaving its folder.

HDF5 opens other files without asking: through external links, external storage and virtual data sets. Every link is
therefore followed here, by hand, and a file outside the folder is refused, as is one that is not there, which HDF5
would read as zeros.
"""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import h5py  # pyright: ignore[reportMissingTypeStubs]

from planish.core.errors import FileError, VolumeError
from planish.io.formats import referenced_file
from planish.io.guard import reading, size_of_file
from planish.io.tiff import size_words

MOST_LINKS = 32  # links that one path may pass; more is a circle
MOST_OBJECTS = 20_000


@contextmanager
def opened(path: Path) -> Generator[h5py.File]:
    """Open a file for reading, whether or not the folder can be written and others have it open."""
    size_of_file(path)
    with reading(path), h5py.File(path, "r", locking=False) as file:
        yield file


class Hdf5Link(NamedTuple):
    """A member of a group: the thing itself, or the name of another place, perhaps in another file."""

    hard: bool
    target: str = ""
    file: str = ""


def link_of(group: Any, name: str) -> Hdf5Link | None:
    """Look at a member of a group without following it; None where there is none."""
    # To ask h5py whether the group holds it would open the file that an external link names.
    if not isinstance(group, h5py.Group):
        return None
    links: Any = group.id.links
    key = name.encode()
    if not key or "/" in name or not links.exists(key):
        return None
    kind = links.get_info(key).type
    if kind == h5py.h5l.TYPE_HARD:  # pyright: ignore[reportAttributeAccessIssue]
        return Hdf5Link(hard=True)
    value: Any = links.get_val(key)
    if kind == h5py.h5l.TYPE_SOFT:  # pyright: ignore[reportAttributeAccessIssue]
        return Hdf5Link(hard=False, target=os.fsdecode(value))
    return Hdf5Link(hard=False, target=os.fsdecode(value[1]), file=os.fsdecode(value[0]))


def find_dataset(path: Path, name: str) -> tuple[Path, str]:
    """Follow a path through groups and links."""
    folder, here, where = path.parent, path, ""
    remaining = [part for part in name.split("/") if part not in ("", ".")]
    for _ in range(MOST_LINKS):
        with opened(here) as file:
            while remaining:
                part = remaining[0]
                link = link_of(file[where or "/"], part)
                if link is None:
                    raise VolumeError(f"{path.name} has no {name!r}: {part!r} is not there. {describe_volumes(path)}")
                if link.hard:
                    where, remaining = f"{where}/{part}", remaining[1:]
                    continue
                target = [p for p in link.target.split("/") if p not in ("", ".")]
                relative = not link.file and not link.target.startswith("/")
                remaining = ([p for p in where.split("/") if p] if relative else []) + target + remaining[1:]
                where = ""
                if link.file:
                    here = referenced_file(folder, link.file, path, base=here.parent)
                break
            else:
                return here, where
    raise FileError(
        f"{path.name}: {name!r} leads through more than {MOST_LINKS} links. Copy the data set into one file."
    )


def check_storage(dataset: h5py.Dataset, path: Path, *, depth: int = 0) -> None:
    """Refuse a data set whose values lie outside the folder, or in files that are not there."""
    if dataset.external:
        raise FileError(
            f"{path.name}: {dataset.name} keeps its values in another file ({dataset.external[0][0]!r}), which planish "
            "does not open. Copy it into one file, for example with h5repack."
        )
    if not dataset.is_virtual:
        return
    if depth > 4:
        raise FileError(f"{path.name}: {dataset.name} is virtual over virtual data sets. Copy it into one file.")
    for source, name in sorted({(s.file_name, s.dset_name) for s in dataset.virtual_sources()}):
        if "%" in source or "%" in name:
            raise FileError(
                f"{path.name}: {dataset.name} takes its parts from a pattern of files. Copy it into one file."
            )
        file = path if source == "." else referenced_file(path.parent, source, path)
        target, target_name = find_dataset(file, name)
        if target.resolve() != file.resolve() or target_name.strip("/") != name.strip("/"):
            raise FileError(f"{path.name}: {dataset.name} reaches its parts through links. Copy it into one file.")
        with opened(file) as source_file:
            part: Any = source_file[name]
            check_storage(part, file, depth=depth + 1)


def volumes_in(path: Path) -> list[tuple[str, tuple[int, ...], str]]:
    """Names, shapes and types of all data sets with three axes longer than 1, links left aside."""
    volumes: list[tuple[str, tuple[int, ...], str]] = []
    visits = count()

    def note(name: str, member: Any) -> bool | None:
        if isinstance(member, h5py.Dataset) and member.dtype.kind in "buif":
            shape = tuple(int(n) for n in member.shape or ())
            if sum(n > 1 for n in shape) == 3:
                volumes.append((f"/{name}", shape, str(member.dtype)))
        return True if next(visits) > MOST_OBJECTS else None

    with opened(path) as file:
        file.visititems(note)
    return volumes


def describe_volumes(path: Path) -> str:
    """Name the volumes of a file, and how to choose one."""
    volumes = volumes_in(path)
    if not volumes:
        return "It holds no data set with three axes."
    names = ", ".join(f"{name} ({size_words(shape)} {dtype})" for name, shape, dtype in volumes[:8])
    more = f" and {len(volumes) - 8} more" if len(volumes) > 8 else ""
    return f"Its volumes are {names}{more}: choose one as {path.name}:{volumes[0][0]}."
