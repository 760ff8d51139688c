"""Checks of what a function is given.

One check for each kind of object, called once where a public function begins.

``call_format`` is the call to write instead, with ``{}`` where the object stands:
``pl.find_surfaces({})``.
"""

from collections.abc import Sequence
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from planish.core.errors import InputError, SizeError, VolumeError
from planish.core.numbers import TOLERANCE, agree
from planish.core.typing import Array, Pair, Texts
from planish.core.units import unit_um

_CURES = {
    "b": "Give the grey values that it was made from.",
    "c": "Give their magnitude: abs(array).",
}
MISSING_KEYS = ("_FillValue", "missing_value", "nodata")  # of netCDF and of rasters
_GRID_AXES = ("y", "x", "v", "u")  # along which columns and pixels stand in um
_POSITIONS = ("x", "y", "u", "v", "centre")  # variables that are lengths
_PICTURE_MODES = ("L", "I", "I;16", "F", "RGB", "RGBA")  # of Pillow, whose numbers are the values


class ArrayKind(NamedTuple):
    """A volume or an image: its name, its axes, and the attribute that holds its size."""

    name: str
    axes: Texts
    size_attribute: str

    @property
    def with_article(self) -> str:
        """Its name with an article."""
        return f"{'an' if self.name[0] in 'aeiou' else 'a'} {self.name}"


VOLUME = ArrayKind("volume", ("z", "y", "x"), "voxel_um")
IMAGE = ArrayKind("image", ("y", "x"), "pixel_um")


def check_volume(volume: object, call_format: str) -> tuple[float, ...]:
    """Return the voxel size (z, y, x) in um of a volume with coordinates.

    InputError if it is something else, VolumeError where it has other axes or values, SizeError
    where it has no size, contradicts itself, or its coordinates are not in um, not regular, or
    descend.
    """
    return _checked_size(volume, VOLUME, call_format)


def check_image(image: object, call_format: str) -> tuple[float, ...]:
    """Return the pixel size (y, x) in um of an image; errors as those of :func:`check_volume`."""
    return _checked_size(image, IMAGE, call_format)


def check_dataset(
    data: object, *variables: str, expected: str, source: str, call_format: str
) -> None:
    """Refuse what is no Dataset with the variables that are needed, as numbers on a grid in um.

    ``source`` is the call that gives one.
    """
    if not isinstance(data, xr.Dataset) or any(name not in data for name in variables):
        raise not_taken(data, expected, call_format.format(source), call_format)
    for name in variables or map(str, data.data_vars):
        check_numbers(data[name], f"{name} of the {expected}", kinds="uifb")
        unit = _unit_of(data[name])
        if name in _POSITIONS and not _is_um(unit):
            raise SizeError(
                f"{name} of the {expected} is in {unit}; needed is um. Give it in um, with"
                ' attrs["units"] = "um".'
            )
    for axis in _GRID_AXES:
        if axis in data.dims:
            _check_coordinates(data, axis, expected, source)


def _check_coordinates(data: xr.Dataset, axis: str, expected: str, source: str) -> None:
    if axis not in data.coords:
        raise SizeError(
            f"The {expected} have no coordinates along {axis}, so their size is unknown. Take"
            f" them as {source} gives them, or write data.assign_coords({axis}=...), in um."
        )
    step_um(data, axis)


def check_path(path: object, expected: str, call_format: str, fix: str) -> Path:
    """Return a path; ``fix`` is what to write for an object in memory."""
    if not isinstance(path, str | Path):
        raise not_taken(path, expected, fix, call_format)
    return Path(path)


def check_values(array: Any, kind: ArrayKind, dims: Sequence[str]) -> None:
    """Refuse axes and values that are none of a volume or an image."""
    if tuple(dims) != kind.axes:
        dims_kind = {2: IMAGE, 3: VOLUME}.get(len(dims), kind)
        fix = conversion_call(array, dims_kind)
        if dims_kind is kind:
            fix = f"array.rename({dims[0]}={kind.axes[0]!r}, ...)"
        if sorted(dims) == sorted(kind.axes):
            fix = f"array.transpose({', '.join(map(repr, kind.axes))})"
        raise VolumeError(
            f"{kind.with_article.capitalize()} has the axes ({', '.join(kind.axes)}), and an array"
            f" of {' x '.join(map(str, array.shape))} with ({', '.join(dims)}) was given. Write"
            f" {fix}."
        )
    check_numbers(array, f"The {kind.name}")


def check_numbers(array: Any, name: str, *, kinds: str = "uif") -> None:
    """Refuse values that are masked, or of another kind than numbers (or what ``kinds`` says).

    ``kinds``: the letters of NumPy's ``dtype.kind`` that are taken. Only the type is looked at:
    NaN and infinity pass.

    Every array that a function takes comes through here: a mask would be lost in silence.
    """
    if is_masked(array):
        fix = 'array.astype("float32").filled(np.nan)'
        if not isinstance(array, np.ma.MaskedArray):
            fix = 'dask.array.ma.filled(array.astype("float32"), np.nan)'
        raise VolumeError(
            f"{name} has masked values, whose mask would be lost. Write {fix}: what is NaN is"
            " missing."
        )
    if array.dtype.kind not in kinds or array.dtype.itemsize > 8:
        fix = _CURES.get(array.dtype.kind, 'Convert them: astype("float32").')
        wanted = "integers or real numbers"
        if kinds == "b":
            wanted = "true or false"
            fix = "Compare them with a limit: array > 0."
        raise VolumeError(f"{name} has {array.dtype} values; needed are {wanted}. {fix}")


def check_missing(array: Any, name: str) -> None:
    """Refuse a map that holds the number its attributes call missing: it would be a value here."""
    for key in MISSING_KEYS:
        number = getattr(array, "attrs", {}).get(key)
        n_missing = 0
        if isinstance(number, Real):
            n_missing = int(np.sum(array.values == number))
        if n_missing:
            raise VolumeError(
                f"{name} holds {number:g} {n_missing} times, which its attribute {key} calls"
                f" missing. Write array.where(array != {number:g}): what is NaN is missing. If it"
                f" is a value, take the attribute out."
            )


def values_of(values: Any, name: str) -> Array:
    """Give the numbers of an array or of lists, as :func:`check_numbers` takes them."""
    array = values if hasattr(values, "dtype") else np.asarray(values)
    check_numbers(array, name, kinds="uifb")
    return np.asarray(array)


def is_masked(array: Any) -> bool:
    """Return True for a masked array of NumPy, or of dask; xarray makes NaN of what is masked."""
    return isinstance(getattr(array, "_meta", array), np.ma.MaskedArray)


def map_pixel_um(name: str, values: Any, pixel_um: Sequence[float] | None) -> Pair | None:
    """Give the pixel of a map by its coordinates, or by its attribute ``pixel_um`` without any.

    The pixel is (rows, cols) in um; None where the map states none in um. SizeError where
    ``pixel_um``, as a call gives it, is another. ``name`` is that of the map in messages.
    """
    if not isinstance(values, xr.DataArray):
        return None
    axes = [str(axis) for axis in values.dims]
    row_um, col_um = (step_um(values, axis) for axis in axes)
    source = "coordinates"
    fix = f"{name}.drop_vars({axes})"
    is_in_um = all(_unit_of(values[axis]) for axis in axes)
    attribute = IMAGE.size_attribute
    if row_um is None and col_um is None and attribute in values.attrs:
        row_um, col_um = map(float, values.attrs[attribute])
        source = f"attribute {attribute}"
        fix = f"{name}.values"
        is_in_um = True
    if pixel_um is not None and not _are_alike((row_um, col_um), pixel_um):
        raise SizeError(
            f"`pixel_um` gives {_sizes_text(pixel_um, ' x ')} um, but the {source} of {name}"
            f" say {_sizes_text((row_um, col_um), ' x ')} um ({', '.join(axes)}). Leave `pixel_um`"
            f" out, or write {fix} if they are wrong."
        )
    if row_um is None or col_um is None or not is_in_um:
        return None
    return row_um, col_um


def _are_alike(steps: Sequence[float | None], sizes: Sequence[float]) -> bool:
    """True where no step is another than the size."""
    pairs = zip(steps, sizes, strict=True)
    return all(agree(step, size) for step, size in pairs if step and size)


def _sizes_text(sizes: Sequence[float | None], separator: str) -> str:
    return separator.join(f"{size:.6g}" for size in sizes if size is not None)


def _unit_of(values: xr.DataArray) -> object:
    """The unit that the attributes state, as CF or as other programs name it; None for none."""
    return values.attrs.get("units") or values.attrs.get("unit")


def _is_um(unit: object) -> bool:
    """Return whether lengths are in um: where no unit is stated, they are."""
    return unit is None or unit_um(str(unit)) == 1.0


def step_um(array: xr.DataArray | xr.Dataset, axis: str) -> float | None:
    """Distance of voxels or pixels by their coordinates along an axis, in um.

    None without any, SizeError where they are of no use.
    """
    if axis not in array.coords or array.sizes[axis] < 2:
        return None
    unit = _unit_of(array[axis])
    values = array[axis].values
    fault_text = ""
    fix = f"array.assign_coords({axis}=...)"
    if not _is_um(unit):
        fault_text = f"are in {unit}; needed are lengths in um"
    elif values.dtype.kind not in "uif":
        fault_text = f"are {values.dtype} values; needed are lengths in um"
    else:
        steps = np.diff(values.astype(np.float64))
        if steps.max() < 0:
            fault_text = "descend; needed are ascending ones"
            fix = f"array.isel({axis}=slice(None, None, -1))"
        elif not np.abs(steps - steps.mean()).max() <= TOLERANCE * steps.mean():
            fault_text = (
                f"are not regular: their steps are {steps.min():.4g} to {steps.max():.4g} um;"
                " needed is one size"
            )
    if fault_text:
        # Without them a dataset says nothing of its size, and no call gives it one.
        drop_text = f", or drop them: array.drop_vars({axis!r})"
        if isinstance(array, xr.Dataset):
            drop_text = ""
        raise SizeError(f"The coordinates along {axis} {fault_text}. Write {fix}{drop_text}.")
    return float(np.diff(values.astype(np.float64)).mean())


def conversion_call(value: object, kind: ArrayKind) -> str:
    """Give the call to write for an object that is no volume, or no image."""
    if isinstance(value, str | Path):
        return f"pl.read_{kind.name}({str(value)!r})"
    array_code = "array"
    if isinstance(value, xr.Dataset):
        array_code = 'dataset["NAME"]'
    elif not isinstance(getattr(value, "dtype", None), np.dtype):
        array_code = "np.asarray(array)"
        # Of a picture of Pillow in a palette, the numbers are places in it.
        if hasattr(value, "getbands") and getattr(value, "mode", None) not in _PICTURE_MODES:
            array_code = 'np.asarray(array.convert("RGB"))'
    return f"pl.{kind.name}({array_code}, {kind.size_attribute}=...)"


def described(value: object) -> str:
    """Name an object as a message does.

    For example ``a path ('v.tif')``, ``an array (ndarray) of 40 x 50 values``.
    """
    type_name = type(value).__name__
    if isinstance(value, str | Path):
        return f"a path ({str(value)!r})"
    if isinstance(value, xr.Dataset):
        return f"a Dataset with {', '.join(map(str, value.data_vars))[:60] or 'nothing'}"
    if isinstance(value, xr.DataArray):
        return f"a DataArray with the dims ({', '.join(map(str, value.dims))})"
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple):
        return f"an array ({type_name}) of {' x '.join(map(str, shape)) or 'no'} values"
    if value is None:
        return "None"
    return f"{'an' if type_name[0] in 'AEIOUaeiou' else 'a'} {type_name}"


def not_taken(value: object, expected: str, fix: str, call_format: str) -> InputError:
    """The error for an object that a function does not take."""
    name = call_format.partition("(")[0]
    return InputError(f"{name} takes {expected}, and {described(value)} was given. Write {fix}.")


def _checked_size(array: object, kind: ArrayKind, call_format: str) -> tuple[float, ...]:
    """Size of the voxels or pixels in um, by coordinates and the attribute, which have to agree."""
    fix = call_format.format(conversion_call(array, kind))
    if not isinstance(array, xr.DataArray):
        raise not_taken(array, kind.with_article, fix, call_format)
    check_values(array, kind, [*map(str, array.dims)])
    stated_um: Sequence[float] | None = array.attrs.get(kind.size_attribute)
    steps = [step_um(array, axis) for axis in kind.axes]
    # An image may be known by its size alone; faces are heights along a volume's coordinates.
    has_coords = kind is IMAGE or array.coords.keys() >= {*kind.axes}
    if not has_coords or (stated_um is None and None in steps):
        raise SizeError(f"The {kind.name} has no size along its axes. Write {fix}.")
    sizes = [1.0] * len(steps) if stated_um is None else stated_um
    size_um = tuple(float(step or size) for step, size in zip(steps, sizes, strict=True))
    if stated_um is None:
        return size_um
    if not all(map(agree, size_um, stated_um)):
        step_text = _sizes_text(size_um, ", ")
        raise SizeError(
            f"The {kind.name} contradicts itself: its coordinates have steps of {step_text} um"
            f" ({', '.join(kind.axes)}), its attribute {kind.size_attribute} says"
            f" {_sizes_text(stated_um, ', ')}. If the coordinates are right, write"
            f" pl.{kind.name}({kind.name}, {kind.size_attribute}=({step_text}))."
        )
    return tuple(map(float, stated_um))
