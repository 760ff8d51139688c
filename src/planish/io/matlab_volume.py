"""MATLAB files: a volume ``V(row, column, slice)`` becomes (z, y, x) with z its slices, y its rows, x its columns.

Files up to version 7 are read by scipy, at once. Files of version 7.3 are HDF5 files in which MATLAB stores the axes in
reverse, so that parts can be read; pymatreader, which reads them whole, gives the same values.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numpy.typing import NDArray
from scipy import io as scipy_io

from planish.core.errors import FileError, VolumeError
from planish.io.formats import Place
from planish.io.guard import check_blown_up, check_memory, reading, size_of_file
from planish.io.hdf5_links import check_storage, is_hard, opened, volumes_in
from planish.io.hdf5_volume import Hdf5Array, check_values, chunk_bytes, word
from planish.io.lazy import FileArray, turned
from planish.io.loaded import LoadedVolume, loaded
from planish.io.matlab_headers import check_headings
from planish.io.sizes import Stated
from planish.io.stored import check_shape
from planish.io.tiff import size_words

SIZE_VARIABLE = "voxel_um"
"""Variable with the voxel size, one number or z, y, x."""

TYPES = {
    "double": "float64", "single": "float32",
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}  # fmt: skip

Variable = tuple[str, tuple[int, ...], str]


def load(place: Place, *, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read the variable that was chosen, or the only one with three axes.

    Parameters
    ----------
    place : Place
    channel : str or None
        Passed over: there is no colour.
    memory_bytes : int or None

    Returns
    -------
    LoadedVolume

    Raises
    ------
    FileError, VolumeError, ResourceError
        As :func:`planish.io.read_volume`.
    """
    del channel
    path = place.path
    size_of_file(path)
    with reading(path):
        new = h5py.is_hdf5(path)
    if not new:
        check_headings(path)
    variables = variables_in_new(path) if new else variables_in_old(path)
    name, shape, kind = choose(variables, place)
    if kind not in TYPES:
        raise VolumeError(f"{path.name}: {name} holds values of the class {kind}. Save it with numbers.")
    check_shape(shape, path)
    order = [axis for axis, n in enumerate(shape) if n > 1]
    order = [order[2], order[0], order[1]]  # slices, rows, columns
    if new:
        array, notes = new_values(path, name, order)
    else:
        array = old_values(path, name, shape, np.dtype(TYPES[kind]), memory_bytes=memory_bytes)
        array, notes = np.squeeze(array).transpose(2, 0, 1), ()
    return loaded(
        array,
        path,
        stated=[stated_by_variable(path, new=new)],
        file_bytes=size_of_file(path),
        memory_bytes=memory_bytes,
        attrs={"variable": name},
        notes=notes,
    )


def choose(variables: list[Variable], place: Place) -> Variable:
    """Variable with the name that was given, or the only volume.

    Raises
    ------
    VolumeError
        If there is none, or several.
    """
    name, wanted = place.path.name, place.part.strip("/")
    volumes = [v for v in variables if sum(n > 1 for n in v[1]) == 3]
    there = ", ".join(f"{v[0]} ({size_words(v[1])} {v[2]})" for v in volumes[:8]) or "no variable with three axes"
    if wanted:
        found = [v for v in volumes if v[0] == wanted]
        if not found:
            raise VolumeError(f"{name} has no volume {wanted!r}. It holds {there}.")
        return found[0]
    if not volumes:
        what = ", ".join(f"{v[0]} ({size_words(v[1])})" for v in variables[:8]) or "nothing"
        raise VolumeError(f"{name} holds no volume, but {what}. Save the volume as one variable with three axes.")
    if len(volumes) > 1:
        raise VolumeError(f"{name} holds {len(volumes)} volumes: {there}. Choose one as {name}:{volumes[0][0]}.")
    return volumes[0]


def variables_in_old(path: Path) -> list[Variable]:
    """Names, shapes and classes of the variables, without their values."""
    with reading(path):
        return [(str(n), tuple(int(k) for k in shape), str(kind)) for n, shape, kind in scipy_io.whosmat(str(path))]


def variables_in_new(path: Path) -> list[Variable]:
    """Names, shapes in the order of MATLAB, and classes of the variables."""
    found: list[Variable] = []
    volumes = volumes_in(path)
    with opened(path) as file:
        for name, shape, dtype in volumes:
            if name.count("/") > 1:
                continue  # inside a structure or a cell
            kind = word(file[name].attrs.get("MATLAB_class", dtype))
            found.append((name.strip("/"), shape[::-1], {"float64": "double", "float32": "single"}.get(kind, kind)))
    return found


def new_values(path: Path, name: str, order: list[int]) -> tuple[FileArray, tuple[str, ...]]:
    """Values of a variable in a file of version 7.3, to be read in parts."""
    with opened(path) as file, reading(path):
        dataset: Any = file[name]
        check_storage(dataset, path)
        notes = check_values(dataset, path)
        shape = tuple(int(n) for n in dataset.shape)
        array = Hdf5Array(path, name, shape, dataset.dtype, chunk_bytes(dataset))
    return turned(array, [len(shape) - 1 - axis for axis in order]), notes


def old_values(
    path: Path, name: str, shape: tuple[int, ...], dtype: np.dtype[Any], *, memory_bytes: int | None
) -> NDArray[Any]:
    """Values of a variable in a file up to version 7."""
    needed = math.prod(shape) * dtype.itemsize
    check_blown_up(path, decoded_bytes=needed, stored_bytes=size_of_file(path))
    check_memory(path, needed_bytes=needed, limit_bytes=memory_bytes)
    with reading(path):
        values = scipy_io.loadmat(str(path), variable_names=[name]).get(name)
    if not isinstance(values, np.ndarray) or values.shape != shape or values.dtype.kind not in "uif":
        raise FileError(f"{path.name}: {name} is declared as {size_words(shape)} and decodes otherwise. Save it again.")
    return values


def stated_by_variable(path: Path, *, new: bool) -> Stated:
    """Voxel size in the variable ``voxel_um``, which is no habit of MATLAB but can be saved beside the volume."""
    source = f"the variable {SIZE_VARIABLE}"
    none = Stated(source=source, um=(None, None, None), note="it is not there, or not one number or three")
    values: Any = None
    if new:
        with opened(path) as file, reading(path):
            item = file[SIZE_VARIABLE] if is_hard(file, SIZE_VARIABLE) else None
            if isinstance(item, h5py.Dataset) and item.size in (1, 3) and not item.external and not item.is_virtual:
                values = item[()]
    else:
        small = [v for v in variables_in_old(path) if v[0] == SIZE_VARIABLE and math.prod(v[1]) in (1, 3)]
        if small:
            with reading(path):
                values = scipy_io.loadmat(str(path), variable_names=[SIZE_VARIABLE]).get(SIZE_VARIABLE)
    if values is None or np.asarray(values).dtype.kind not in "uif":
        return none
    sizes = [float(v) for v in np.broadcast_to(np.ravel(values), 3)]
    return Stated(source=source, um=tuple(sizes)) if all(math.isfinite(v) and v > 0 for v in sizes) else none
