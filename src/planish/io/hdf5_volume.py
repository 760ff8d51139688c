"""Volumes in HDF5 files, and in the NeXus files of reconstruction programs (NXtomoproc).

NeXus names the volume that is meant, the order of its axes, and their steps; other programs write the voxel size into
attributes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, VolumeError
from planish.core.lazy import Where
from planish.io.formats import ADVICE, LoadedVolume, Place, check_chunks
from planish.io.hdf5_links import check_storage, describe_volumes, find_dataset, link_of, opened, volumes_in
from planish.io.lazy import FileArray, transposed
from planish.io.sizes import Stated, stated_in
from planish.io.tiff import size_words

SIZE_NAMES = ("voxel_size", "element_size", "pixel_size", "spacing", "resolution", "voxel_um")
"""Attributes in which programs write the voxel size, with ``_um`` or another unit at the end, or the unit beside."""

LONGEST_AXIS = 10_000_000
EVEN = 0.01  # share by which the steps of an axis may differ


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
        axes = _axis_names(dataset)
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


def _axis_names(dataset: Any) -> list[str]:
    """Names of the axes that the group or the data set gives, one for each; none where they do not fit."""
    for owner in (dataset.parent, dataset):
        if "axes" in owner.attrs:
            names = [_word(v) for v in np.ravel(owner.attrs["axes"])]
            if len(names) == 1:
                names = names[0].strip("[]").replace(",", ":").split(":")
            if len(names) == len(dataset.shape):
                return [name.strip() for name in names]
    return []


def _stated_by_nexus(dataset: Any, names: Sequence[str], order: Sequence[int]) -> list[Stated]:
    """Voxel size from the values along the axes, which have to be evenly spaced."""
    steps: list[float | None] = [None] * len(dataset.shape)
    units = [""] * len(dataset.shape)
    notes: list[str] = []
    for axis in order if names else ():
        values: Any = _child(dataset.parent, names[axis])
        n = dataset.shape[axis]
        if not isinstance(values, h5py.Dataset) or values.shape != (n,) or n > LONGEST_AXIS:
            continue
        if values.dtype.kind not in "uif" or values.is_virtual or values.external:
            continue
        differences = np.abs(np.diff(np.asarray(values[()], np.float64)))
        step = float(np.median(differences))
        if not np.isfinite(differences).all() or step <= 0 or np.any(np.abs(differences - step) > EVEN * step):
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
