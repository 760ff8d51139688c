"""Take arrays as the volume or image that a file would give.

The arrays are in memory, of dask, zarr and xarray, or mapped from a file.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from planish.core.arrays import (
    IMAGE,
    VOLUME,
    ArrayKind,
    check_missing,
    check_numbers,
    check_values,
    conversion_call,
    described,
    not_taken,
    step_um,
)
from planish.core.errors import VolumeError, check_choice
from planish.core.facts import SIDES, Side
from planish.core.frame import Axis, End, Frame
from planish.core.labelled import labelled, variable_data
from planish.core.lazy import LazyArray, Where
from planish.core.typing import Array, DType, Entries
from planish.io.formats import full_scale
from planish.io.lazy import decode_if_small, supported_type
from planish.io.sizes import PIXEL, VOXEL, Stated, agreed_size, size_attrs

Size = float | tuple[float, ...]


def volume(
    array: Any,
    *,
    voxel_um: Size | None = None,
    through: Axis = "z",
    top: End = "high",
    override_size: bool = False,
    unusual_size: bool = False,
) -> xr.DataArray:
    """Make a volume of an array.

    It is what :func:`planish.read_volume` gives of the same values in a file.

    Parameters
    ----------
    array : array, shape (z, y, x)
        Of NumPy, xarray, dask, zarr or h5py. What lies in a file, or is computed part by part,
        stays so; a mapped file stays mapped, or is read in parts where it is larger than the memory
        allows.
    voxel_um : float or (z, y, x)
        Voxel size in um; an xarray object with coordinates in um needs none.
    through, top, override_size, unusual_size
        As for :func:`planish.read_volume`: ``through`` is the axis that runs through the sheet,
        ``top`` the end of that axis at which the sheet's top side lies. A size is overridden that
        coordinates state.

    Returns
    -------
    DataArray, dims (z, y, x)
        As :func:`planish.read_volume` gives it, with ``through`` and ``top_side``; ``full_scale``
        is None for floats.

    Raises
    ------
    InputError
        If it is no array, or an axis or end has another name; a VolumeError where it has not three
        axes or no grey values, a SizeError where its size is missing, contradictory or impossible.

    Examples
    --------
    >>> import planish as pl
    >>> sheet = pl.volume(np.zeros((40, 50, 60), np.uint8), voxel_um=1.5, through="y")
    >>> float(sheet.x[-1]), sheet.attrs["through"]
    (88.5, 'y')
    """
    frame = Frame(through=through, top=top)
    raster = _array(array, VOLUME)
    stored_data: Any = raster.variable._data  # pyright: ignore  `values` would read them
    dtype = supported_type(raster.dtype).newbyteorder("=")
    values: Array | LazyArray
    if isinstance(stored_data, np.ndarray) and stored_data.dtype == dtype:
        values = decode_if_small(stored_data, memory_bytes=None)
    elif isinstance(stored_data, np.ndarray) and not isinstance(stored_data, np.memmap):
        values = stored_data.astype(dtype)
    else:
        values = _lazy(raster.variable, dtype)
    # 64 bits: an array uses all that its type has.
    attrs: Entries = {"full_scale": full_scale(raster.dtype, 64), "long_name": "Grey value"}
    attrs |= raster.attrs | frame.lies()
    return _labelled(
        values, raster, VOLUME, voxel_um, attrs, override=override_size, unusual=unusual_size
    )


def image(
    array: Any,
    *,
    pixel_um: Size | None = None,
    side: Side | None = None,
    channel: str = "luminance",
    override_size: bool = False,
    unusual_size: bool = False,
) -> xr.DataArray:
    """Make an image of an array.

    It is what :func:`planish.read_image` gives of the same values in a file.

    Parameters
    ----------
    array : array, shape (y, x), or in colour (y, x, 3) or (y, x, 4)
        Of NumPy, xarray, dask, zarr or h5py.
    pixel_um : float or (y, x)
        Pixel size in um; an xarray object with coordinates in um needs none.
    side, channel, override_size, unusual_size
        As for :func:`planish.read_image`; a size is overridden that coordinates state.

    Returns
    -------
    DataArray, dims (y, x), float32

    Raises
    ------
    InputError
        As for :func:`planish.volume`.
    """
    from planish.io.image import pick_channel
    from planish.io.picture import DecodedPicture

    if side is not None:
        check_choice("side", side, SIDES)
    raster = _array(array, IMAGE)
    check_missing(raster, "The image")
    stored_values = raster.values
    colour = "rgb" if stored_values.ndim == 3 else "grey"
    picture = DecodedPicture(values=stored_values, colour=colour, bits=64, stated=(), orientation=1)
    values, long_name = pick_channel(picture, channel, file_name="The array")
    attrs = {
        "full_scale": full_scale(stored_values.dtype, 64),
        "channel": channel,
        "stored_dtype": str(stored_values.dtype),
        "orientation": 1,
        "long_name": long_name,
        **raster.attrs,
    }
    if side is not None:
        attrs["side"] = side
    return _labelled(
        values, raster, IMAGE, pixel_um, attrs, override=override_size, unusual=unusual_size
    )


def _lazy(source: Any, dtype: DType) -> LazyArray:
    """An array of another library, of which parts are read as they are asked for."""
    shape = tuple(map(int, source.shape))
    array = LazyArray(shape, dtype, partial(_read_part, source, dtype))
    # Edges of a chunk along each axis; dask has a tuple instead, with the edge of every chunk.
    encoding = getattr(source, "encoding", {})
    chunks: Any = getattr(source, "chunks", None) or encoding.get("chunks") or ()
    edges = (max(edge) if isinstance(edge, tuple) else edge for edge in chunks)
    array.chunks = tuple(edges) or None
    return array


def _raster(array: Any) -> xr.DataArray:
    """An array as one of xarray, not read; the axes of other libraries have no names."""
    if isinstance(array, xr.DataArray):
        return array
    data = array
    if not isinstance(array, np.ndarray):
        data = _lazy(array, array.dtype.newbyteorder("="))
    dims = [f"dim_{k}" for k in range(len(array.shape))]
    raster = xr.DataArray(xr.Variable(dims, variable_data(data)))
    if data is not array:
        raster.encoding["chunks"] = data.chunks
    return raster


def _read_part(source: Any, dtype: DType, where: Where) -> Array:
    return np.asarray(source[where], dtype)


def _array(array: Any, kind: ArrayKind) -> xr.DataArray:
    """An array with the axes (z, y, x) or (y, x) of its kind in this order, not read.

    An image may have one more, its colours.
    """
    if not isinstance(getattr(array, "dtype", None), np.dtype):
        raise not_taken(array, "an array", conversion_call(array, kind), f"pl.{kind.name}(")
    check_numbers(array, f"The {kind.name}")
    raster = _raster(array)
    dims = [*map(str, raster.dims)]
    has_colour = kind is IMAGE and raster.shape[2:] in ((3,), (4,))
    # What xarray, and `_raster`, call axes without a name.
    is_unnamed = all(name.startswith("dim_") for name in dims)
    if set(kind.axes) <= set(dims):
        raster = raster.transpose(*kind.axes, ...)
    elif is_unnamed and len(dims) == len(kind.axes) + has_colour:
        raster = raster.rename(dict(zip(dims, (*kind.axes, "colour"), strict=False)))
    dims = [*map(str, raster.dims)]
    check_values(raster, kind, dims[:2] if has_colour else dims)
    if min(raster.shape) < (2 if kind is VOLUME else 1):
        raise VolumeError(
            f"The {kind.name} is cut off: {described(array)} was given. Give the whole stack."
        )
    return raster


def _stated(
    raster: xr.DataArray, kind: ArrayKind, steps: dict[str, float | None], *, is_given: bool
) -> list[Stated]:
    """Sizes by the steps of the coordinates of an array, and by its attribute.

    ``steps`` are in um along each axis, None where it has no coordinates. Of a size that is given
    (``is_given``), that of the attribute is the one it replaces: the array was cut out.
    """
    stated_um = dict(steps)
    note = ""
    for axis, step in steps.items():
        # Without a unit they may count voxels: they have to fit a size that is given, and are none
        # by themselves.
        if step is not None and "units" not in raster[axis].attrs:
            note = "coordinates without a unit"
            if not is_given:
                stated_um[axis] = None
    stated = [Stated("its coordinate grid", tuple(stated_um.values()), note)]
    if not is_given and kind.size_attribute in raster.attrs:
        attribute_um = tuple(raster.attrs[kind.size_attribute])
        stated.append(Stated(f"its attribute {kind.size_attribute}", attribute_um))
    return stated


def _labelled(
    values: Array | LazyArray,
    raster: xr.DataArray,
    kind: ArrayKind,
    size_um: Size | None,
    attrs: Entries,
    *,
    override: bool,
    unusual: bool,
) -> xr.DataArray:
    """Give the values with the size that coordinates, attribute and call agree on.

    ``raster`` is the array as it was given, with its coordinates and attributes; ``size_um`` and
    the flags are what the call says. Coordinates that do not begin at 0 are kept as they are.
    """
    steps = {axis: None if override else step_um(raster, axis) for axis in kind.axes}
    stated = _stated(raster, kind, steps, is_given=size_um is not None)
    size_kind = VOXEL if kind is VOLUME else PIXEL
    name = f"The {kind.name}"
    size, source = agreed_size(
        stated, size_um, file_name=name, asked=size_kind, override=override, unusual=unusual
    )
    path = getattr(raster.variable._data, "filename", None)  # pyright: ignore  of a memory map
    file_name = Path(path).name if path else str(raster.name or "array")
    attrs = {"file_name": file_name, "file_bytes": raster.nbytes, **attrs, "units": "1"}
    attrs |= size_attrs(size_kind, size, source, stated)
    sized = labelled(values, kind.axes, size, name=kind.name, attrs=attrs)
    for axis, step in steps.items():
        if step is not None and raster[axis].values[0] != 0:
            axis_um = raster[axis].values.astype(np.float64)
            sized = sized.assign_coords({axis: (axis, axis_um, {"units": "um"})})
    return sized
