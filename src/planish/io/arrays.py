"""Arrays in memory, of dask, zarr and xarray, or mapped from a file, as the volume or image that a file would give."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.arrays import IMAGE_AXES, VOLUME_AXES, check_values, described, step_um
from planish.core.errors import InputError, VolumeError, check_choice
from planish.core.facts import SIDES, Side
from planish.core.frame import Axis, End, Frame
from planish.core.lazy import LazyArray, Where, held, labelled
from planish.io.formats import full_scale
from planish.io.lazy import settle, supported_type
from planish.io.sizes import PIXEL, VOXEL, Asked, Stated, agreed_size

Size = float | tuple[float, ...]


def volume(
    array: Any, *, voxel_um: Size | None = None, through: Axis = "z", top: End = "high", override_size: bool = False,
    unusual_size: bool = False,
) -> xr.DataArray:  # fmt: skip
    """Make a volume of an array: what :func:`planish.read_volume` gives of the same values in a file.

    Parameters
    ----------
    array : array, shape (z, y, x)
        Of NumPy, xarray, dask, zarr or h5py. Nothing is copied or read: what lies in a file, or is computed part by
        part, stays so.
    voxel_um : float or (z, y, x)
        Voxel size in um; an xarray object with coordinates in um needs none.
    through : {"z", "y", "x"}
        Axis that runs through the sheet.
    top : {"high", "low"}
        End of that axis at which the sheet's top side lies.
    override_size : bool
        Whether `voxel_um` is taken although coordinates state another size.
    unusual_size : bool
        Whether a size is taken that paper does not have, from 0.1 nm to 1 mm.

    Returns
    -------
    DataArray, dims (z, y, x)
        Coordinates in um; float16 as float32. Attributes as those of :func:`planish.read_volume`, and ``through`` and
        ``top_side``, which :func:`planish.find_surfaces` follows.

    Raises
    ------
    VolumeError
        If it has not three axes, or no grey values.
    SizeError
        If the voxel size is missing, contradictory or impossible; if coordinates descend or are not regular.
    InputError
        If it is no array, or an axis or side has another name.

    Examples
    --------
    >>> import planish as pl
    >>> sheet = pl.volume(np.zeros((40, 50, 60), np.uint8), voxel_um=1.5, through="y")
    >>> float(sheet.x[-1]), sheet.attrs["through"]
    (88.5, 'y')
    """
    frame = Frame(through=through, top=top)
    given = _array(array, "volume", VOLUME_AXES)
    if min(given.shape) < 2:
        raise VolumeError(
            f"A volume has more than one slice along each axis, and {described(array)} was given. Give the whole stack."
        )
    values = _values(given)
    size, source, coords = _places(given, voxel_um, VOXEL, override=override_size, unusual=unusual_size)
    attrs = {"full_scale": full_scale(given.dtype, 64)} | _origin(given) | given.attrs
    attrs |= {"units": "1", "voxel_um": list(size), "voxel_um_source": source, **frame.lies()}
    attrs.setdefault("long_name", "Grey value")
    encoding = {"whole_slices": False, "chunks": values.chunks} if isinstance(values, HeldArray) else {}
    made = labelled(values, VOLUME_AXES, size, name="volume", attrs=attrs, encoding=encoding)
    return made.assign_coords(coords)


def image(
    array: Any, *, pixel_um: Size | None = None, side: Side | None = None, channel: str = "luminance",
    override_size: bool = False, unusual_size: bool = False,
) -> xr.DataArray:  # fmt: skip
    """Make an image of an array: what :func:`planish.read_image` gives of the same values in a file.

    Parameters
    ----------
    array : array, shape (y, x) or (y, x, 3) or (y, x, 4)
        Grey values, or red, green, blue and what is ignored, of NumPy, xarray, dask, zarr or h5py.
    pixel_um : float or (y, x)
        Pixel size in um; an xarray object with coordinates in um needs none.
    side : {"top", "bottom"}, optional
        Side of the sheet that it shows; top is assumed where not given.
    channel : str
        As for :func:`planish.read_image`.
    override_size, unusual_size : bool
        As for :func:`planish.volume`.

    Returns
    -------
    DataArray, dims (y, x), float32
        With attributes as those of :func:`planish.read_image`; and ``side``, which :func:`planish.find_holes` follows.

    Raises
    ------
    VolumeError
        If it has other axes or values.
    SizeError, InputError
        As for :func:`planish.volume`.
    """
    from planish.io.image import pick_channel
    from planish.io.picture import Picture

    if side is not None:
        check_choice("side", side, SIDES)
    given = _array(array, "image", IMAGE_AXES)
    if given.ndim == 3 and given.shape[2] not in (3, 4):
        raise VolumeError(
            f"An image is grey (y, x) or in colour (y, x, 3), and {described(array)} was given. Give one plane of it: "
            "array[k]."
        )
    size, source, coords = _places(given, pixel_um, PIXEL, override=override_size, unusual=unusual_size)
    stored = given.values
    colour = "rgb" if stored.ndim == 3 else "grey"
    picture = Picture(values=stored, colour=colour, bits=64, stated=(), orientation=1)
    values, long_name = pick_channel(picture, channel, file_name="The array")
    attrs = {
        "full_scale": picture.full_scale, "channel": channel, "stored_dtype": str(stored.dtype), "orientation": 1,
        "long_name": long_name, **_origin(given), **given.attrs,
        "units": "1", "pixel_um": list(size), "pixel_um_source": source,
    } | ({} if side is None else {"side": side})  # fmt: skip
    return labelled(values, IMAGE_AXES, size, name="image", attrs=attrs).assign_coords(coords)


class HeldArray(LazyArray):
    """An array of another library, of which parts are read as they are asked for."""

    def __init__(self, inner: Any, dtype: np.dtype[Any]) -> None:
        self.inner, self.dtype, self.shape = inner, dtype, tuple(int(n) for n in inner.shape)
        # Those of dask hold the size of each chunk.
        chunks: Any = getattr(inner, "chunks", None) or getattr(inner, "encoding", {}).get("chunks") or ()
        sizes = tuple(max(chunk) if isinstance(chunk, tuple) else chunk for chunk in chunks)
        self.chunks: tuple[int, ...] | None = sizes if len(sizes) == len(self.shape) else None

    def read(self, where: Where) -> NDArray[Any]:
        """Read a part."""
        return np.asarray(self.inner[where], self.dtype)


def _array(array: Any, what: str, axes: tuple[str, ...]) -> xr.DataArray:
    """An array with names for its axes, not read; an image may have one more, its colours."""
    size = "voxel_um" if what == "volume" else "pixel_um"
    dtype = getattr(array, "dtype", None)
    if not isinstance(dtype, np.dtype) or isinstance(array, np.ma.MaskedArray):
        instead = f"pl.{what}(np.asarray(array), {size}=...)"
        if isinstance(array, str | Path):
            instead = f"pl.read_{what}({str(array)!r})"
        elif isinstance(array, xr.Dataset):
            instead = f'pl.{what}(dataset["NAME"], {size}=...)'
        elif isinstance(array, np.ma.MaskedArray):
            instead = f"pl.{what}(array.astype(float).filled(np.nan), {size}=...): missing values are NaN"
        raise InputError(f"pl.{what} takes an array, and {described(array)} was given. Write {instead}.")
    count = len(array.shape)
    if count != len(axes) and not (what == "image" and count == len(axes) + 1):
        other = "pl.image" if what == "volume" and count == 2 else "pl.volume" if count == 3 else None
        cure = f"Write {other}(array, ...)" if other else f"Choose {len(axes)} of its axes"
        raise VolumeError(f"{'A volume' if what == 'volume' else 'An image'} has the axes ({', '.join(axes)}), and "
                          f"{described(array)} was given. {cure}.")  # fmt: skip
    check_values(dtype, what)
    if 0 in array.shape:
        raise VolumeError(f"The {what} is empty: {described(array)} was given. Give the whole array.")
    if not isinstance(array, xr.DataArray):
        inner = array if isinstance(array, np.ndarray) else HeldArray(array, dtype.newbyteorder("="))
        named = xr.DataArray(xr.Variable((*axes, "colour")[:count], held(inner)))
        named.encoding |= {"chunks": inner.chunks} if isinstance(inner, HeldArray) else {}
        return named
    names = [str(name) for name in array.dims]
    if set(axes) <= set(names):
        return array.transpose(*axes, ...)
    if not all(name.startswith("dim_") for name in names):  # xarray's own names stand for none
        raise VolumeError(
            f"The {what} has the dims ({', '.join(names)}); needed are ({', '.join(axes)}). Rename them: "
            f'array.rename({names[0]}="{axes[0]}", ...).'
        )
    return array.rename(dict(zip(array.dims, (*axes, "colour"), strict=False)))


def _values(given: xr.DataArray) -> NDArray[Any] | LazyArray:
    """The values in a type that the kernels compute in; those that lie in a file stay there."""
    dtype = supported_type(given.dtype).newbyteorder("=")
    inner = given.variable._data  # pyright: ignore
    if not isinstance(inner, np.ndarray) or (isinstance(inner, np.memmap) and inner.dtype != dtype):
        return HeldArray(given.variable, dtype)
    values: NDArray[Any] = inner
    return settle(values, memory_bytes=None) if values.dtype == dtype else values.astype(dtype)


def _places(
    given: xr.DataArray, size_um: Size | None, asked: Asked, *, override: bool, unusual: bool
) -> tuple[tuple[float, ...], str, dict[str, Any]]:
    """The size, where it comes from, and coordinates that are to stay because they begin elsewhere than at 0."""
    name = f"The {'volume' if asked is VOXEL else 'image'}"
    steps = tuple(None if override else step_um(given, axis) for axis in asked.axes)
    units = ["units" in given[axis].attrs if axis in given.coords else False for axis in asked.axes]
    noted: Any = given.attrs.get("voxel_um" if asked is VOXEL else "pixel_um")
    stated = Stated(source="its coordinate grid", um=steps)
    if size_um is None:
        known = tuple(step if unit else None for step, unit in zip(steps, units, strict=True))
        note = "coordinates without a unit" if known != steps else ""
        stated = Stated(source="its coordinate grid", um=known, note=note)
        if not any(known) and noted is not None:
            stated = Stated(source=f"its attribute {asked.option[2:].replace('-', '_')}", um=tuple(noted))
    size, source = agreed_size([stated], size_um, file_name=name, asked=asked, override=override, unusual=unusual)
    coords = {
        axis: (axis, given[axis].values.astype(np.float64), {"units": "um"})
        for axis, step in zip(asked.axes, steps, strict=True)
        if step is not None and given[axis].values[0] != 0
    }
    return size, source, coords


def _origin(given: xr.DataArray) -> dict[str, Any]:
    """Name and size of what it was made from."""
    path = getattr(given.variable._data, "filename", None)  # pyright: ignore
    name = Path(path).name if path else str(given.name or "array")
    return {"file_name": name, "file_bytes": given.size * given.dtype.itemsize}
