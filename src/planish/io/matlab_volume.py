"""MATLAB files: a volume ``V(row, column, slice)`` becomes (z, y, x) with z its slices, y its rows, x its columns.

Files up to version 7 are read at once; of those of version 7.3, which are HDF5 files, parts can be read.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core import matlab
from planish.core.errors import FileError, VolumeError
from planish.io.formats import LoadedVolume, Place
from planish.io.guard import check_blown_up, reading, size_of_file
from planish.io.lazy import FileArray, WholeArray, transposed
from planish.io.sizes import stated_in
from planish.io.tiff import size_words

# Variable with the voxel size, one number or z, y, x: no habit of MATLAB, but it can be saved beside the volume.
SIZE_VARIABLE = "voxel_um"


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Read the variable that was chosen, or the only one with three axes."""
    path = place.path
    size_of_file(path)
    with reading(path), path.open("rb") as file:
        head = file.read(520)
        if not matlab.is_new(head) and not matlab.is_version_5(head):
            raise FileError(
                f"{path.name} is no MATLAB file of version 5 or later; version 4 holds no volumes. Save it with '-v7'."
            )
        try:
            variables = matlab.variables(file)
            chosen = _choose(variables, place)
            small = next((v for v in variables if v.name == SIZE_VARIABLE and v.real and v.count in (1, 3)), None)
            sizes = [] if small is None else np.broadcast_to(np.ravel(matlab.values(file, small)), 3).tolist()
        except matlab.Damaged as error:
            raise _damaged(path, error) from error
    if chosen.kind not in matlab.NUMBERS:
        raise VolumeError(
            f"{path.name}: {chosen.name} holds values of the class {chosen.kind}. Save it with real numbers."
        )
    values, notes = _values(path, chosen, new=matlab.is_new(head))
    stated = stated_in(f"the variable {SIZE_VARIABLE}", sizes, ["um"] * 3)
    return LoadedVolume(values=values, stated=[stated], files=[path], attrs={"variable": chosen.name}, notes=notes)


def _values(path: Path, chosen: matlab.Variable, *, new: bool) -> tuple[FileArray, tuple[str, ...]]:
    """Slices, rows, columns of a variable, and what looks wrong in them."""
    rows, columns, slices = (axis for axis, n in enumerate(chosen.shape) if n > 1)
    order = (slices, rows, columns)
    if new:
        from planish.io.hdf5_volume import lazy_dataset, opened

        with opened(path) as file:
            array, notes = lazy_dataset(file[chosen.name], path)
        return transposed(array, [len(chosen.shape) - 1 - axis for axis in order]), notes
    dtype = matlab.NUMBERS[chosen.kind]
    check_blown_up(path, decoded_bytes=chosen.count * dtype.itemsize, stored_bytes=size_of_file(path))
    shape = tuple(chosen.shape[axis] for axis in order)
    return WholeArray(path, shape, dtype, partial(_decoded, path, chosen)), ()


def _decoded(path: Path, chosen: matlab.Variable) -> NDArray[Any]:
    try:
        with path.open("rb") as file:
            return np.squeeze(matlab.values(file, chosen)).transpose(2, 0, 1)
    except matlab.Damaged as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: matlab.Damaged) -> FileError:
    return FileError(f"{path.name} is damaged: {error}. Save it again, or copy it once more.")


def _choose(variables: list[matlab.Variable], place: Place) -> matlab.Variable:
    name, wanted = place.path.name, place.part.strip("/")
    volumes = [v for v in variables if sum(n > 1 for n in v.shape) == 3]
    listing = ", ".join(f"{v.name} ({size_words(v.shape)} {v.kind})" for v in volumes[:8])
    listing = listing or "no variable with three axes"
    if wanted:
        matches = [v for v in volumes if v.name == wanted]
        if not matches:
            raise VolumeError(f"{name} has no volume {wanted!r}. It holds {listing}.")
        return matches[0]
    if not volumes:
        content = ", ".join(f"{v.name} ({size_words(v.shape)})" for v in variables[:8]) or "nothing"
        raise VolumeError(f"{name} holds no volume, but {content}. Save the volume as one variable with three axes.")
    if len(volumes) > 1:
        raise VolumeError(f"{name} holds {len(volumes)} volumes: {listing}. Choose one as {name}:{volumes[0].name}.")
    return volumes[0]
