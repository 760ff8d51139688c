"""Volumes in HDF5 files, and in the NeXus files of reconstruction programs (NXtomoproc)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, VolumeError
from planish.core.lazy import Where
from planish.io.chunks import check_chunks
from planish.io.formats import Place
from planish.io.guard import reading, size_of_file
from planish.io.hdf5_links import check_storage, find_dataset, listed, opened, volumes_in
from planish.io.lazy import FileArray, turned
from planish.io.loaded import ADVICE, LoadedVolume, loaded
from planish.io.nexus import axis_order, default_dataset, stated_by_nexus
from planish.io.sizes import Stated, unit_um
from planish.io.stored import check_shape
from planish.io.tiff import size_words

SIZE_NAMES = ("voxel_size", "element_size", "pixel_size", "spacing", "resolution")
"""Attributes in which programs write the voxel size, with ``_um`` or another unit at the end, or the unit beside."""


def load(place: Place, *, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read the data set that was chosen, that NeXus names, or the only one with three axes."""
    del channel
    path = place.path
    file_path, name = find_dataset(path, place.part) if place.part.strip("/") else choose(path)
    with opened(file_path) as file:
        dataset: Any = file[name]
        if not isinstance(dataset, h5py.Dataset):
            raise VolumeError(f"{path.name}: {place.part!r} is a group. {listed(path)}")
        check_storage(dataset, file_path)
        shape = tuple(int(n) for n in dataset.shape or ())
        long = [axis for axis, n in enumerate(shape) if n > 1]
        if len(long) != 3:
            raise VolumeError(f"{path.name}: {name} is no volume but {size_words(shape) or 'one value'}. {ADVICE}")
        check_shape(shape, path)
        with reading(path):
            notes = check_values(dataset, path)
            array = Hdf5Array(file_path, name, shape, dataset.dtype, chunk_bytes(dataset))
            order = axis_order(dataset, long)
            stated = [*stated_by_nexus(dataset, order), *stated_by_attributes(dataset)]
    return loaded(
        turned(array, order),
        path,
        stated=stated,
        file_bytes=size_of_file(path) + (0 if file_path == path else size_of_file(file_path)),
        memory_bytes=memory_bytes,
        attrs={"dataset": name},
        notes=notes,
    )


def files(place: Place) -> list[Path]:
    """The file, and the one that a link leads to."""
    found = find_dataset(place.path, place.part)[0] if place.part.strip("/") else choose(place.path)[0]
    return [place.path] if found == place.path else [place.path, found]


def choose(path: Path) -> tuple[Path, str]:
    """Data set that NeXus names as the default one, or the only volume there is."""
    with opened(path) as file, reading(path):
        default = default_dataset(file, path)
    if default is not None:
        return find_dataset(path, default)
    found = volumes_in(path)
    if len(found) != 1:
        many = f"{len(found)} volumes" if found else "no volume"
        raise VolumeError(f"{path.name} holds {many}. {listed(path)}")
    return path, found[0][0]


def check_values(dataset: Any, path: Path) -> tuple[str, ...]:
    """Refuse a data set without values; report where some are missing."""
    if dataset.is_virtual:
        return ()
    if dataset.id.get_storage_size() == 0:
        raise FileError(f"{path.name}: {dataset.name} has no values stored. It is cut off: copy or export it again.")
    if dataset.chunks is None:
        return ()
    grid = math.prod(-(-n // c) for n, c in zip(dataset.shape, dataset.chunks, strict=True))
    if dataset.id.get_num_chunks() == grid:
        return ()
    present: list[tuple[int, ...]] = []

    def note(info: Any) -> None:
        present.append(tuple(o // c for o, c in zip(info.chunk_offset, dataset.chunks, strict=True)))

    dataset.id.chunk_iter(note)
    return check_chunks(present, dataset.shape, dataset.chunks, name=f"{path.name}: {dataset.name}")


def chunk_bytes(dataset: Any) -> int:
    """Size of what is decoded at least."""
    return 0 if dataset.chunks is None else math.prod(dataset.chunks) * dataset.dtype.itemsize


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


def stated_by_attributes(dataset: Any) -> list[Stated]:
    """Voxel size in the attributes of a data set or its group, one number or z, y, x, where a unit is given."""
    stated: list[Stated] = []
    for owner in (dataset, dataset.parent):
        keys = {str(key).casefold(): key for key in owner.attrs}
        for folded, key in keys.items():
            base = next((b for b in SIZE_NAMES if folded == b or folded.startswith(b + "_")), None)
            if folded == "voxel_um":
                base, unit = "voxel", "um"
            elif base is None or "unit" in folded:
                continue
            elif folded != base:
                unit = folded[len(base) + 1 :]
            else:
                beside = next((u for u in (f"{base}_units", f"{base}_unit", "units", "unit") if u in keys), None)
                unit = "" if beside is None else word(owner.attrs[keys[beside]])
            values = np.atleast_1d(np.asarray(owner.attrs[key])).ravel()
            length = unit_um(unit)
            source = f"the attribute {key}"
            if values.dtype.kind not in "uif" or values.size not in (1, 3):
                continue
            if length is None:
                what = f"{unit!r} is no unit of length" if unit else "it has no unit"
                stated.append(Stated(source=source, um=(None, None, None), note=what))
                continue
            sizes = [float(v) * length for v in np.broadcast_to(values, 3)]
            if all(math.isfinite(v) and v > 0 for v in sizes):
                stated.append(Stated(source=source, um=tuple(sizes)))
    return stated


def word(value: Any) -> str:
    """Read an attribute that holds text."""
    one = np.asarray(value).ravel()[:1]
    text: Any = one[0] if one.size else ""
    return text.decode("utf-8", errors="replace") if isinstance(text, bytes) else str(text)
