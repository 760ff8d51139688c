"""What a function is given: one check for each kind of object, called once where a public function begins.

``call`` is the call to write instead, with ``{}`` where the object stands: ``pl.find_surfaces({})``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from planish.core.errors import InputError, SizeError, VolumeError

TOLERANCE = 0.01  # sizes that differ by more than this share are different sizes; less is rounding
_UM = ("um", "µm", "μm", "micrometer", "micrometre", "micron")
_CURES = {"b": "Give the grey values that it was made from.", "c": "Give their magnitude: abs(array)."}


class Kind(NamedTuple):
    """A volume or an image: its name, its axes, and the attribute that holds its size."""

    name: str
    axes: tuple[str, ...]
    size: str

    @property
    def words(self) -> str:
        """Its name with an article."""
        return f"{'an' if self.name[0] in 'aeiou' else 'a'} {self.name}"


VOLUME = Kind("volume", ("z", "y", "x"), "voxel_um")
IMAGE = Kind("image", ("y", "x"), "pixel_um")


def check_volume(volume: object, call: str) -> tuple[float, ...]:
    """Return the voxel size (z, y, x) in um of a volume with coordinates.

    Raises
    ------
    InputError
        If it is something else; a VolumeError where it has other axes or values, a SizeError where it has no size,
        contradicts itself, or its coordinates are not in um, not regular, or descend.
    """
    return _checked(volume, VOLUME, call)


def check_image(image: object, call: str) -> tuple[float, ...]:
    """Return the pixel size (y, x) in um of an image; errors as those of :func:`check_volume`."""
    return _checked(image, IMAGE, call)


def check_dataset(data: object, *needed: str, what: str, maker: str, call: str) -> None:
    """Refuse what is no Dataset with the variables that are needed; ``maker`` is the call that gives one."""
    if not isinstance(data, xr.Dataset) or any(name not in data for name in needed):
        raise not_taken(data, what, call.format(maker), call)


def check_path(path: object, needed: str, call: str, instead: str) -> Path:
    """Return a path; ``instead`` is what to write for an object in memory."""
    if not isinstance(path, str | Path):
        raise not_taken(path, needed, instead, call)
    return Path(path)


def check_values(array: Any, kind: Kind, dims: Sequence[str]) -> None:
    """Refuse axes and values that are none of a volume or an image."""
    if tuple(dims) != kind.axes:
        other = {2: IMAGE, 3: VOLUME}.get(len(dims), kind)
        cure = f"array.rename({dims[0]}={kind.axes[0]!r}, ...)" if other is kind else instead_of(array, other)
        if sorted(dims) == sorted(kind.axes):
            cure = f"array.transpose({', '.join(map(repr, kind.axes))})"
        raise VolumeError(
            f"{kind.words.capitalize()} has the axes ({', '.join(kind.axes)}), and an array of "
            f"{' x '.join(map(str, array.shape))} with ({', '.join(dims)}) was given. Write {cure}."
        )
    if array.dtype.kind not in "uif" or array.dtype.itemsize > 8:
        cure = _CURES.get(array.dtype.kind, 'Convert them: astype("float32").')
        raise VolumeError(f"The {kind.name} has {array.dtype} values; needed are integers or real numbers. {cure}")


def step_um(array: xr.DataArray, axis: str) -> float | None:
    """Distance of voxels or pixels by their coordinates; None without any, SizeError where they are of no use."""
    if axis not in array.coords or array.sizes[axis] < 2:
        return None
    unit, values = array[axis].attrs.get("units", "um"), array[axis].values
    fault, cure = "", f"array.assign_coords({axis}=...)"
    if unit not in _UM or values.dtype.kind not in "uif":
        fault = f"are {f'in {unit}' if unit not in _UM else f'{values.dtype} values'}; needed are lengths in um"
    else:
        steps = np.diff(values.astype(np.float64))
        if steps.max() < 0:
            fault, cure = "descend; needed are ascending ones", f"array.isel({axis}=slice(None, None, -1))"
        elif not np.abs(steps - steps.mean()).max() <= TOLERANCE * steps.mean():
            fault = f"are not regular: their steps are {steps.min():.4g} to {steps.max():.4g} um; needed is one size"
    if fault:
        raise SizeError(f"The coordinates along {axis} {fault}. Write {cure}, or drop them: array.drop_vars({axis!r}).")
    return float(np.diff(values.astype(np.float64)).mean())


def agree(first: float, second: float) -> bool:
    """Return True if two sizes are the same within :data:`TOLERANCE`."""
    return abs(first - second) <= TOLERANCE * min(first, second)


def instead_of(value: object, kind: Kind) -> str:
    """Give the call to write for an object that is no volume, or no image."""
    if isinstance(value, str | Path):
        return f"pl.read_{kind.name}({str(value)!r})"
    array = 'dataset["NAME"]' if isinstance(value, xr.Dataset) else "array"
    return f"pl.{kind.name}({array}, {kind.size}=...)"


def described(value: object) -> str:
    """Name an object as a message does: ``a path ('v.tif')``, ``an array (ndarray) of 40 x 50 values``."""
    kind = type(value).__name__
    if isinstance(value, str | Path):
        return f"a path ({str(value)!r})"
    if isinstance(value, xr.Dataset):
        return f"a Dataset with {', '.join(map(str, value.data_vars))[:60] or 'nothing'}"
    if isinstance(value, xr.DataArray):
        return f"a DataArray with the dims ({', '.join(map(str, value.dims))})"
    if isinstance(shape := getattr(value, "shape", None), tuple):
        return f"an array ({kind}) of {' x '.join(map(str, shape)) or 'no'} values"
    return "None" if value is None else f"{'an' if kind[0] in 'AEIOUaeiou' else 'a'} {kind}"


def not_taken(value: object, needed: str, instead: str, call: str) -> InputError:
    """The error for an object that a function does not take."""
    return InputError(f"{call.partition('(')[0]} takes {needed}, and {described(value)} was given. Write {instead}.")


def _checked(array: object, kind: Kind, call: str) -> tuple[float, ...]:
    """Size along each axis, by the coordinates or the attribute."""
    if not isinstance(array, xr.DataArray):
        raise not_taken(array, kind.words, call.format(instead_of(array, kind)), call)
    check_values(array, kind, [str(name) for name in array.dims])
    stated: Sequence[float] | None = array.attrs.get(kind.size)
    steps = [step_um(array, axis) for axis in kind.axes]
    # An image may be known by its size alone; faces are heights along the coordinates of a volume.
    if (stated is None and None in steps) or (kind is VOLUME and any(axis not in array.coords for axis in kind.axes)):
        raise SizeError(f"The {kind.name} has no size along its axes. Write {call.format(instead_of(array, kind))}.")
    size = tuple(float(step or at_axis) for step, at_axis in zip(steps, stated or (1.0,) * len(steps), strict=True))
    if stated is not None and not all(map(agree, size, stated)):
        spacing, attribute = (", ".join(f"{value:.6g}" for value in values) for values in (size, stated))
        raise SizeError(
            f"The {kind.name} contradicts itself: its coordinates have steps of {spacing} um ({', '.join(kind.axes)}), "
            f"its attribute {kind.size} says {attribute}. If the coordinates are right, write "
            f"pl.{kind.name}({kind.name}, {kind.size}=({spacing}))."
        )
    return size if stated is None else tuple(map(float, stated))
