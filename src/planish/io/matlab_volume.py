"""MATLAB files: a volume ``V(row, column, slice)`` becomes (z, y, x) with z its slices, y its rows, x its columns.

Files up to version 7 are read at once; of those of version 7.3, which are HDF5 files, parts can be read.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core import matlab
from planish.core.errors import FileError, VolumeError
from planish.io.formats import Place
from planish.io.guard import check_blown_up, check_memory, reading, size_of_file
from planish.io.lazy import FileArray, turned
from planish.io.loaded import LoadedVolume, loaded
from planish.io.sizes import Stated
from planish.io.stored import check_shape
from planish.io.tiff import size_words

SIZE_VARIABLE = "voxel_um"
"""Variable with the voxel size, one number or z, y, x."""


def load(place: Place, *, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read the variable that was chosen, or the only one with three axes."""
    del channel
    path = place.path
    size_of_file(path)
    with reading(path), path.open("rb") as file:
        head = file.read(520)
        new = matlab.is_new(head)
        if not new and not matlab.is_version_5(head):
            raise FileError(
                f"{path.name} is no MATLAB file of version 5 or later; version 4 holds no volumes. Save it with '-v7'."
            )
        try:
            variables = matlab.variables(file)
            chosen = _choose(variables, place)
            if chosen.kind not in matlab.NUMBERS:
                raise VolumeError(
                    f"{path.name}: {chosen.name} holds values of the class {chosen.kind}. Save it with real numbers."
                )
            check_shape(chosen.shape, path)
            long = [axis for axis, n in enumerate(chosen.shape) if n > 1]
            order = [long[2], long[0], long[1]]  # slices, rows, columns
            notes: tuple[str, ...] = ()
            if new:
                array, notes = _in_parts(path, chosen, order)
            else:
                needed = math.prod(chosen.shape) * matlab.NUMBERS[chosen.kind].itemsize
                check_blown_up(path, decoded_bytes=needed, stored_bytes=size_of_file(path))
                check_memory(path, needed_bytes=needed, limit_bytes=memory_bytes)
                array = np.squeeze(matlab.values(file, chosen)).transpose(2, 0, 1)
            small = next((v for v in variables if v.name == SIZE_VARIABLE and v.stored and v.count in (1, 3)), None)
            sizes = None if small is None else matlab.values(file, small)
        except matlab.Damaged as error:
            raise FileError(f"{path.name} is damaged: {error}. Save it again, or copy it once more.") from error
    return loaded(
        array, path, stated=[_stated(sizes)], file_bytes=size_of_file(path), memory_bytes=memory_bytes,
        attrs={"variable": chosen.name}, notes=notes,
    )  # fmt: skip


def _choose(variables: list[matlab.Variable], place: Place) -> matlab.Variable:
    """Variable with the name that was given, or the only volume."""
    name, wanted = place.path.name, place.part.strip("/")
    volumes = [v for v in variables if sum(n > 1 for n in v.shape) == 3]
    there = ", ".join(f"{v.name} ({size_words(v.shape)} {v.kind})" for v in volumes[:8])
    there = there or "no variable with three axes"
    if wanted:
        found = [v for v in volumes if v.name == wanted]
        if not found:
            raise VolumeError(f"{name} has no volume {wanted!r}. It holds {there}.")
        return found[0]
    if not volumes:
        what = ", ".join(f"{v.name} ({size_words(v.shape)})" for v in variables[:8]) or "nothing"
        raise VolumeError(f"{name} holds no volume, but {what}. Save the volume as one variable with three axes.")
    if len(volumes) > 1:
        raise VolumeError(f"{name} holds {len(volumes)} volumes: {there}. Choose one as {name}:{volumes[0].name}.")
    return volumes[0]


def _in_parts(path: Path, chosen: matlab.Variable, order: list[int]) -> tuple[FileArray, tuple[str, ...]]:
    """Values of a variable in a file of version 7.3, to be read in parts."""
    from planish.io.hdf5_links import check_storage, opened
    from planish.io.hdf5_volume import Hdf5Array, check_values, chunk_bytes

    with opened(path) as file, reading(path):
        dataset: Any = file[chosen.name]
        check_storage(dataset, path)
        notes = check_values(dataset, path)
        shape = tuple(int(n) for n in dataset.shape)
        array = Hdf5Array(path, chosen.name, shape, dataset.dtype, chunk_bytes(dataset))
    return turned(array, [len(shape) - 1 - axis for axis in order]), notes


def _stated(values: NDArray[Any] | None) -> Stated:
    """Voxel size in the variable ``voxel_um``, which is no habit of MATLAB but can be saved beside the volume."""
    source = f"the variable {SIZE_VARIABLE}"
    sizes = [] if values is None else [float(v) for v in np.broadcast_to(np.ravel(values), 3)]
    if not sizes or not all(math.isfinite(v) and v > 0 for v in sizes):
        return Stated(source=source, um=(None, None, None), note="it is not there, or not one number or three")
    return Stated(source=source, um=tuple(sizes))
