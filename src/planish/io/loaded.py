"""What every reader of volumes gives back, and the checks that all of them share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import FileError, VolumeError
from planish.io.lazy import FileArray, as_supported, settle
from planish.io.sizes import Stated
from planish.io.tiff import size_words

ADVICE = "Save one grey volume alone, as a stack of slices."


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedVolume:
    """Values of a volume and what its files say about them.

    Attributes
    ----------
    values : ndarray, memmap or FileArray, dims (z, y, x)
    stated : tuple of Stated
        Voxel size along z, y, x in the metadata.
    full_scale : int or None
        Largest value the file can store; None for floating point.
    file_bytes : int
    attrs : mapping
        Further plain values for the attributes of the volume.
    notes : tuple of str
        Sentences about what looks wrong in the files.
    """

    values: NDArray[Any] | FileArray
    stated: tuple[Stated, ...]
    full_scale: int | None
    file_bytes: int
    attrs: Mapping[str, Any] = field(default_factory=dict[str, Any])
    notes: tuple[str, ...] = ()


def loaded(
    array: FileArray | NDArray[Any],
    path: Path,
    *,
    stated: Sequence[Stated],
    file_bytes: int,
    memory_bytes: int | None,
    attrs: Mapping[str, Any] | None = None,
    notes: Sequence[str] = (),
) -> LoadedVolume:
    """Check shape and type, read what is small, and put everything together."""
    if 0 in array.shape:
        raise FileError(f"{path.name} holds a volume of {size_words(array.shape)} voxels. Export it again.")
    if len(array.shape) != 3 or min(array.shape) == 1:
        raise VolumeError(f"{path.name} is no volume but {size_words(array.shape)} voxels (z, y, x). {ADVICE}")
    check_type(array.dtype, path)
    values = settle(as_supported(array, path), path, memory_bytes=memory_bytes)
    return LoadedVolume(
        values=values,
        stated=tuple(stated),
        full_scale=None if values.dtype.kind == "f" else int(np.iinfo(values.dtype).max),
        file_bytes=file_bytes,
        attrs=attrs or {},
        notes=tuple(notes),
    )


def check_type(dtype: np.dtype[Any], path: Path) -> None:
    """Refuse values that are no grey values."""
    if dtype.kind == "b":
        raise VolumeError(f"{path.name} has black and white only (1 bit). Give the grey values it was made from.")
    if dtype.kind not in "uif" or dtype.itemsize > 8:
        raise VolumeError(f"{path.name} has {dtype} values. Needed are integers or real numbers up to 64 bits.")


def supported_type(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Widen float16, in which the kernels cannot compute, to float32."""
    return np.dtype(np.float32) if dtype == np.float16 else dtype


def inside(folder: Path, name: str, path: Path, *, base: Path | None = None) -> Path:
    """Path of a file that another file names, which has to lie in the same folder or below."""
    target = (base or folder) / name
    try:
        within = "\0" not in name and target.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):
        within = False
    if not within:
        raise FileError(
            f"{path.name} takes data from {name!r}, outside its folder, which planish does not open. "
            "Put the files into one folder and name them without a path."
        )
    if not target.is_file():
        raise FileError(f"{path.name} takes data from {name!r}, which does not exist. Put it beside {path.name}.")
    return target
