"""What a function is given: one check for each kind of object, called once where a public function begins.

A message says what was given, what is needed, and the call to write instead. ``call`` is that call, with ``{}`` where
the object stands: ``pl.find_surfaces({})``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from planish.core.errors import InputError, SizeError, VolumeError

VOLUME_AXES = ("z", "y", "x")
IMAGE_AXES = ("y", "x")
TOLERANCE = 0.01  # sizes that differ by more than this share are different sizes; less is rounding
UM = ("um", "µm", "μm", "micrometer", "micrometre", "micron")

_MOST_NAMES = 6


def check_volume(volume: object, call: str) -> tuple[float, ...]:
    """Return the voxel size (z, y, x) in um of a volume with coordinates.

    Raises
    ------
    InputError
        If it is something else.
    VolumeError
        If it has other axes or values than a volume has.
    SizeError
        If it has no size, contradicts itself, or its coordinates are not in um, not regular, or descend.
    """
    array = _grey(volume, "volume", call)
    if missing := [axis for axis in VOLUME_AXES if axis not in array.coords]:
        raise SizeError(
            f"The volume has no voxel size: nothing along {', '.join(missing)} says where its voxels lie. Write "
            f"{call.format('pl.volume(array, voxel_um=...)')}."
        )
    return _size(array, "volume")


def check_image(image: object, call: str) -> tuple[float, ...]:
    """Return the pixel size (y, x) in um of an image; errors as those of :func:`check_volume`."""
    array = _grey(image, "image", call)
    size = _size(array, "image")
    if not size:
        raise SizeError(
            f"The image has no pixel size. Write {call.format('pl.image(array, pixel_um=...)')}, with the size in um."
        )
    return size


def check_dataset(data: object, *needed: str, what: str, maker: str, call: str) -> None:
    """Refuse what is no Dataset with the variables that are needed; ``maker`` is the call that gives one."""
    if not isinstance(data, xr.Dataset) or any(name not in data for name in needed):
        raise _other(data, what, call.format(maker), call)


def check_path(path: object, what: str, call: str, instead: str) -> Path:
    """Return a path; ``instead`` is what to write for an object in memory."""
    if not isinstance(path, str | Path):
        raise _other(path, what, instead, call)
    return Path(path)


def check_values(dtype: np.dtype[Any], what: str) -> None:
    """Refuse values that are no grey values."""
    if dtype.kind in "uif" and dtype.itemsize <= 8:
        return
    cures = {"b": "Give the grey values that it was made from.", "c": f"Give their magnitude: abs({what})."}
    cure = cures.get(dtype.kind, 'Convert them: astype("float32").')
    raise VolumeError(f"The {what} has {dtype} values; needed are integers or real numbers of up to 64 bits. {cure}")


def step_um(array: xr.DataArray, axis: str) -> float | None:
    """Distance of the voxels or pixels along an axis by its coordinates; None where it has none, or a single one.

    Raises
    ------
    SizeError
        If the coordinates are not in um, not regular, or descend.
    """
    if axis not in array.coords:
        return None
    unit, values = array[axis].attrs.get("units", "um"), array[axis].values
    if unit not in UM or values.dtype.kind not in "uif":
        what = f"in {unit}" if unit not in UM else f"{values.dtype} values"
        raise SizeError(
            f"The coordinates along {axis} are {what}; needed are lengths in um. Assign them: "
            f"array.assign_coords({axis}=...)."
        )
    steps = np.diff(values.astype(np.float64))
    if not steps.size:
        return None
    mean = float(steps.mean())
    if steps.max() < 0:
        raise SizeError(
            f"The coordinates along {axis} descend; needed are ascending ones. Turn the axis round: "
            f"array.isel({axis}=slice(None, None, -1))."
        )
    if not np.abs(steps - mean).max() <= TOLERANCE * mean:
        raise SizeError(
            f"The coordinates along {axis} are not regular: their steps are {steps.min():.4g} to {steps.max():.4g} um. "
            f"Needed is one size. Bring the values to equal steps first, or drop the coordinates: "
            f'array.drop_vars("{axis}").'
        )
    return mean


def described(value: object) -> str:
    """Name an object as a message does: ``a path ('v.tif')``, ``an array (ndarray) of 40 x 50 values``."""
    kind = type(value).__name__
    if isinstance(value, str | Path):
        return f"a path ({str(value)!r})"
    if isinstance(value, xr.Dataset):
        names = [str(name) for name in value.data_vars]
        more = " ..." if len(names) > _MOST_NAMES else ""
        return f"a Dataset with {', '.join(names[:_MOST_NAMES]) or 'nothing'}{more}"
    if isinstance(value, xr.DataArray):
        return f"a DataArray with the dims ({', '.join(map(str, value.dims))})"
    if isinstance(shape := getattr(value, "shape", None), tuple):
        return f"an array ({kind}) of {' x '.join(map(str, shape)) or 'no'} values"
    if value is None:
        return "None"
    return f"{'an' if kind[0] in 'AEIOUaeiou' else 'a'} {kind}"


def _grey(array: object, what: str, call: str) -> xr.DataArray:
    """A DataArray with the axes and values of a volume or an image."""
    axes, size = (VOLUME_AXES, "voxel_um") if what == "volume" else (IMAGE_AXES, "pixel_um")
    if not isinstance(array, xr.DataArray):
        instead = f"pl.{what}(array, {size}=...)"
        if isinstance(array, str | Path):
            instead = f"pl.read_{what}({str(array)!r})"
        elif isinstance(array, xr.Dataset):
            instead = f'pl.{what}(dataset["NAME"], {size}=...)'
        raise _other(array, f"{'an' if what == 'image' else 'a'} {what}", call.format(instead), call)
    if array.dims != axes:
        cure = f"Write pl.{what}(array, {size}=...) for an array of {len(axes)} axes."
        if sorted(map(str, array.dims)) == sorted(axes):
            cure = f"Write {what}.transpose({', '.join(f'{axis!r}' for axis in axes)})."
        raise VolumeError(
            f"The {what} has the dims ({', '.join(map(str, array.dims))}); needed are ({', '.join(axes)}). {cure}"
        )
    check_values(array.dtype, what)
    return array


def _size(array: xr.DataArray, what: str) -> tuple[float, ...]:
    """Size along each axis, by the coordinates or the attribute; nothing where neither says it."""
    axes, name = (VOLUME_AXES, "voxel_um") if what == "volume" else (IMAGE_AXES, "pixel_um")
    stated: Sequence[float] | None = array.attrs.get(name)
    steps = [step_um(array, axis) for axis in axes]
    if stated is None:
        return () if steps == [None] * len(axes) else tuple(step or 1.0 for step in steps)
    if any(step is not None and not agree(step, s) for step, s in zip(steps, stated, strict=True)):
        size = tuple(float(f"{step or s:.6g}") for step, s in zip(steps, stated, strict=True))
        raise SizeError(
            f"The {what} contradicts itself: its coordinates have steps of {_listed(size)} um ({', '.join(axes)}), its "
            f"attribute {name} says {_listed(stated)}. If the coordinates are right, write pl.{what}({what}, "
            f"{name}={size})."
        )
    return tuple(float(s) for s in stated)


def agree(first: float, second: float) -> bool:
    """Whether two sizes are the same within :data:`TOLERANCE`."""
    return abs(first - second) <= TOLERANCE * min(first, second)


def _listed(size: Sequence[float]) -> str:
    return ", ".join(f"{value:.6g}" for value in size)


def _other(value: object, what: str, instead: str, call: str) -> InputError:
    return InputError(f"{call.partition('(')[0]} takes {what}, and {described(value)} was given. Write {instead}.")
