"""Volumes in HDF5 files, and in the NeXus files of reconstruction programs (NXtomoproc).

NeXus names the volume that is meant, the order of its axes, and their steps; other programs write the voxel size into
attributes. HDF5 opens other files without asking: through external links, external storage and virtual data sets. Every
link is therefore followed here, by hand, and a file outside the folder is refused, as is one that is not there, which
HDF5 would read as zeros.
"""

from __future__ import annotations

import math
import os
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import h5py  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, VolumeError
from planish.core.lazy import Where
from planish.io.formats import ADVICE, LoadedVolume, Place, check_chunks, referenced_file
from planish.io.guard import reading, size_of_file
from planish.io.lazy import FileArray, transposed
from planish.io.sizes import Stated, stated_in
from planish.io.tiff import size_words

MOST_LINKS = 32  # links that one path may pass; more is a circle


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
        return True if next(visits) > 20_000 else None

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


# Attributes in which programs write the voxel size, with ``_um`` or another unit at the end, or the unit beside.
SIZE_NAMES = ("voxel_size", "element_size", "pixel_size", "spacing", "resolution", "voxel_um")


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Read the data set that was chosen, that NeXus names, or the only one with three axes."""
    path = place.path
    file_path, name = find_dataset(path, place.part) if place.part.strip("/") else _choose(path)
    with opened(file_path) as file:
        dataset: Any = file[name]
        if not isinstance(dataset, h5py.Dataset):
            raise VolumeError(f"{path.name}: {place.part!r} is a group. {describe_volumes(path)}")
        long = [axis for axis, n in enumerate(dataset.shape or ()) if n > 1]
        if len(long) != 3:
            extent = size_words(dataset.shape or ()) or "one value"
            raise VolumeError(f"{path.name}: {name} is no volume but {extent}. {ADVICE}")
        array, notes = lazy_dataset(dataset, file_path)
        axes: list[str] = []  # names of the axes that the group or the data set gives; none where they do not fit
        for owner in (dataset.parent, dataset):
            names = [_word(v) for v in np.ravel(owner.attrs.get("axes", ()))]
            if len(names) == 1:
                names = names[0].strip("[]").replace(",", ":").split(":")
            if not axes and len(names) == len(dataset.shape):
                axes = [axis_name.strip() for axis_name in names]
        # As NeXus names them, otherwise as they stand.
        letters = [axes[axis][:1].casefold() if axes else "" for axis in long]
        order = [long[letters.index(a)] for a in "zyx"] if sorted(letters) == ["x", "y", "z"] else long
        stated = [*_stated_by_nexus(dataset, axes, order), *_stated_by_attributes(dataset)]
    return LoadedVolume(
        values=transposed(array, order), stated=stated, files=[path, file_path], attrs={"dataset": name}, notes=notes
    )


def lazy_dataset(dataset: Any, path: Path) -> tuple[FileArray, tuple[str, ...]]:
    """Return an array that reads a data set in parts, and what looks wrong; refuse one without values."""
    check_storage(dataset, path)
    shape, chunks, name = tuple(int(n) for n in dataset.shape), dataset.chunks, f"{path.name}: {dataset.name}"
    chunk_bytes = 0 if chunks is None else math.prod(chunks) * dataset.dtype.itemsize
    array = Hdf5Array(path, dataset.name, shape, dataset.dtype, chunk_bytes)
    if not dataset.is_virtual and dataset.id.get_storage_size() == 0:
        raise FileError(f"{name} has no values stored. It is cut off: copy or export it again.")
    if dataset.is_virtual or chunks is None:
        return array, ()
    if dataset.id.get_num_chunks() == math.prod(-(-n // c) for n, c in zip(shape, chunks, strict=True)):
        return array, ()
    present: list[tuple[int, ...]] = []

    def note(chunk: Any) -> None:
        present.append(tuple(o // c for o, c in zip(chunk.chunk_offset, chunks, strict=True)))

    dataset.id.chunk_iter(note)
    return array, check_chunks(present, shape, chunks, name=name)


class Hdf5Array(FileArray):
    """A data set, whose file is open only while it is read."""

    def __init__(self, path: Path, name: str, shape: tuple[int, ...], dtype: np.dtype[Any], piece_bytes: int) -> None:
        self.path, self.name, self.shape = path, name, shape
        self.dtype, self.piece_bytes = dtype.newbyteorder("="), piece_bytes

    def read(self, where: Where) -> NDArray[Any]:
        """Read a part."""
        with opened(self.path) as file:
            # Parts of a virtual data set are looked for beside the file first, wherever planish was started.
            access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
            access.set_virtual_prefix(b"${ORIGIN}")
            dataset: Any = h5py.Dataset(h5py.h5d.open(file.id, self.name.encode(), access))
            if tuple(dataset.shape) != self.shape:
                raise FileError(f"{self.path.name} was changed while planish read it. Start again.")
            return np.asarray(dataset[where], self.dtype)


def _choose(path: Path) -> tuple[Path, str]:
    """Data set that NeXus names as the default one, or the only volume there is."""
    with opened(path) as file:
        default = _default_dataset(file, path)
    if default is not None:
        return find_dataset(path, default)
    volumes = volumes_in(path)
    if len(volumes) != 1:
        many = f"{len(volumes)} volumes" if volumes else "no volume"
        raise VolumeError(f"{path.name} holds {many}. {describe_volumes(path)}")
    return path, volumes[0][0]


def _default_dataset(file: h5py.File, path: Path) -> str | None:
    """Follow ``default`` and ``signal`` from the root; None where the file is no NeXus file."""
    entry = _default_group(file, "NXentry")
    if entry is None:
        return None
    definition = _child(entry, "definition")
    if isinstance(definition, h5py.Dataset) and _word(definition[()]) == "NXtomo":
        raise VolumeError(
            f"{path.name} holds raw projections (NXtomo). Give the reconstructed volume, a file with NXtomoproc."
        )
    data = _default_group(entry, "NXdata")
    if data is None:
        return None
    signal = _attribute(data, "signal")
    if not signal:
        sets = [key for key in data if isinstance(_child(data, key), h5py.Dataset)]
        signal = next((key for key in sets if "signal" in data[key].attrs), "data")
    return None if link_of(data, signal) is None else f"{data.name}/{signal}"


def _default_group(group: Any, kind: str) -> Any:
    """Group of a NeXus class that ``default`` names, or the only one there is."""
    default = _child(group, _attribute(group, "default"))
    for members in ([default], [_child(group, key) for key in group]):
        of_class = [m for m in members if isinstance(m, h5py.Group) and _attribute(m, "NX_class") == kind]
        if len(of_class) == 1:
            return of_class[0]
    return None


def _child(group: Any, name: str) -> Any:
    """Member of a group that is no link; None where there is none."""
    link = link_of(group, name)
    return group[name] if link is not None and link.hard else None


def _stated_by_nexus(dataset: Any, names: Sequence[str], order: Sequence[int]) -> list[Stated]:
    """Voxel size from the values along the axes, which have to be evenly spaced."""
    steps: list[float | None] = [None] * len(dataset.shape)
    units = [""] * len(dataset.shape)
    notes: list[str] = []
    for axis in order if names else ():
        values: Any = _child(dataset.parent, names[axis])
        n = dataset.shape[axis]
        if not isinstance(values, h5py.Dataset) or values.shape != (n,) or n > 10_000_000:
            continue
        if values.dtype.kind not in "uif" or values.is_virtual or values.external:
            continue
        differences = np.abs(np.diff(np.asarray(values[()], np.float64)))
        step = float(np.median(differences))
        # The steps of an axis may differ by 1 %.
        if not np.isfinite(differences).all() or step <= 0 or np.any(np.abs(differences - step) > 0.01 * step):
            notes.append(f"{names[axis]} is not evenly spaced")
        else:
            steps[axis], units[axis] = step, _attribute(values, "units")
    if not notes and steps == [None] * len(steps):
        return []
    stated = stated_in("the NeXus axes", steps, units, order)
    return [Stated(source=stated.source, um=stated.um, note=", ".join([*notes, stated.note] if stated.note else notes))]


def _stated_by_attributes(dataset: Any) -> list[Stated]:
    """Voxel size in the attributes of a data set or its group, one number or z, y, x, where a unit is given."""
    stated: list[Stated] = []
    for owner in (dataset, dataset.parent):
        keys = {str(key).casefold(): str(key) for key in owner.attrs}
        for folded, key in keys.items():
            base = next((b for b in SIZE_NAMES if folded == b or folded.startswith(b + "_")), None)
            values = np.ravel(owner.attrs[key])
            if base is None or "unit" in folded or values.dtype.kind not in "uif" or values.size not in (1, 3):
                continue
            unit = "um" if folded == "voxel_um" else folded[len(base) + 1 :]
            if not unit:
                unit_key = next((u for u in (f"{base}_units", f"{base}_unit", "units", "unit") if u in keys), "")
                unit = _attribute(owner, keys.get(unit_key, ""))
            sizes = [float(v) for v in np.broadcast_to(values, 3)]
            stated.append(stated_in(f"the attribute {key}", sizes, [unit] * 3))
    return stated


def _attribute(owner: Any, name: str) -> str:
    return _word(owner.attrs[name]) if name in owner.attrs else ""


def _word(stored: Any) -> str:
    """Read a word that may be stored as bytes, or as an array of one."""
    entries = np.asarray(stored).ravel()[:1]
    word: Any = entries[0] if entries.size else ""
    return word.decode("utf-8", errors="replace") if isinstance(word, bytes) else str(word)
