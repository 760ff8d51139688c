"""MATLAB files: a volume ``V(row, column, slice)`` becomes (z, y, x).

Of version 7.3 (HDF5), parts are read.
"""

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np

from planish.core import matlab
from planish.core.errors import FileError, VolumeError
from planish.core.typing import Array, Texts
from planish.io.axes import extended_axes
from planish.io.formats import LoadedVolume, Place, describe_volumes, only_volume
from planish.io.guard import check_blown_up, open_bytes, size_of_file
from planish.io.lazy import reordered, whole_array
from planish.io.sizes import stated_in


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Read the variable that was chosen, or the only one with three axes."""
    path = place.path
    with open_bytes(path) as file:
        first_bytes = file.read(520)
        if not matlab.is_new(first_bytes) and not matlab.is_version_5(first_bytes):
            raise FileError(
                f"{path.name} is no MATLAB file of version 5 or later; version 4 holds no volumes."
                " Save it with '-v7'."
            )
        with _damage(path):
            variables = {v.name: v for v in matlab.variables(file)}
            variable = variables[_name_of_volume(variables, place)]
            sizes = _voxel_um(variables.get("voxel_um"), file)
    if variable.kind not in matlab.NUMBERS:
        raise VolumeError(
            f"{path.name}: {variable.name} holds values of the class {variable.kind}. Save it with"
            " real numbers."
        )
    row_axis, column_axis, slice_axis = extended_axes(variable.shape)
    axis_order = (slice_axis, row_axis, column_axis)
    doubts: Texts = ()
    if matlab.is_new(first_bytes):
        from planish.io.hdf5_volume import lazy_dataset, opened

        with opened(path) as file:
            array, doubts = lazy_dataset(file[variable.name], path)
        # HDF5 has the axes of MATLAB the other way round.
        last_axis = len(variable.shape) - 1
        values = reordered(array, [last_axis - axis for axis in axis_order])
    else:
        dtype = matlab.NUMBERS[variable.kind]
        decoded_bytes = variable.count * dtype.itemsize
        check_blown_up(path, decoded_bytes=decoded_bytes, stored_bytes=size_of_file(path))
        shape = tuple(variable.shape[axis] for axis in axis_order)
        values = whole_array(path, shape, dtype, partial(_decoded, path, variable))
    stated = stated_in("the variable voxel_um", sizes, ["um"] * 3)
    return LoadedVolume(
        values=values,
        stated=[stated],
        files=[path],
        attrs={"variable": variable.name},
        doubts=doubts,
    )


def _voxel_um(size: matlab.Variable | None, file: BinaryIO) -> list[float]:
    """Voxel size z, y, x beside the volume: no habit of MATLAB, but it can be saved there."""
    if size is None or not size.real or size.count not in (1, 3):
        return []
    numbers = np.ravel(matlab.values(file, size))
    return np.broadcast_to(numbers, 3).tolist()


def _name_of_volume(variables: Mapping[str, matlab.Variable], place: Place) -> str:
    """Name of the variable with three axes that was chosen, or of the only one."""
    wanted = place.part.strip("/")
    deep = [v for v in variables.values() if len(extended_axes(v.shape)) == 3]
    volumes = [(v.name, v.shape, v.kind) for v in deep]
    if not wanted:
        return only_volume(volumes, place.path.name)
    if wanted not in {name for name, *_ in volumes}:
        volumes_text = describe_volumes(volumes, place.path.name)
        raise VolumeError(f"{place.path.name} has no volume {wanted!r}. {volumes_text}")
    return wanted


def _decoded(path: Path, variable: matlab.Variable) -> Array:
    with _damage(path), path.open("rb") as file:
        values = np.squeeze(matlab.values(file, variable))
    return values.transpose(2, 0, 1)


@contextmanager
def _damage(path: Path) -> Generator[None]:
    try:
        yield
    except matlab.Damaged as error:
        raise FileError(
            f"{path.name} is damaged: {error}. Save it again, or copy it once more."
        ) from error
