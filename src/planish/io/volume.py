"""The 3D image of the sheet: a TIFF stack in one file or a folder of slices, and its voxel size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from tifffile import TiffPageSeries

from planish.core.errors import SizeError, VolumeError
from planish.io.guard import check_memory, size_of_file
from planish.io.nrecon import stated_by_log
from planish.io.picture import Picture, kind_of, load_picture, long_axes
from planish.io.sizes import VOXEL, Stated, agree, agreed_size
from planish.io.slices import list_slices
from planish.io.tiff import PALETTE, check_data, map_or_decode, only_series, open_tiff, shape_words, size_words
from planish.io.tiff_sizes import stated_by_tiff

SLICE_AXES = "ZIQ"
"""Letters for an axis of slices: declared as such, or pages without a declared meaning."""

MANY_CHANNELS = 16
MEANINGS = {"C": "channels", "T": "time points", "S": "colour samples"}

ADVICE = "Save one grey volume alone, as a stack of slices."


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedVolume:
    """Values of a volume and what its files say about them.

    Attributes
    ----------
    values : ndarray or memmap, dims (z, y, x)
    stated : tuple of Stated
        Voxel size along z, y, x in the metadata.
    full_scale : int or None
        Largest value the file can store; None for floating point.
    file_bytes : int
    """

    values: NDArray[Any]
    stated: tuple[Stated, ...]
    full_scale: int | None
    file_bytes: int


def read_volume(
    path: str | Path,
    *,
    voxel_um: float | tuple[float, float, float] | None = None,
    override_size: bool = False,
    memory_limit_bytes: int | None = None,
) -> xr.DataArray:
    """Read the 3D image of a sheet.

    Parameters
    ----------
    path : path
        A TIFF stack (classic, BigTIFF, ImageJ, OME) or a folder of numbered slices (TIFF, PNG, BMP, JPEG).
    voxel_um : float or (z, y, x), optional
        Voxel size in um; not needed where the metadata state it.
    override_size : bool
        Whether `voxel_um` is taken although the metadata state another size.
    memory_limit_bytes : int, optional
        Largest decoded size; default: three quarters of the memory available. An uncompressed stack in one
        piece is mapped from its file and needs none.

    Returns
    -------
    DataArray, dims (z, y, x)
        In the type of the file, float16 as float32. Coordinates in um, voxel i has its centre at i × size.
        Attributes: ``units``, ``long_name``, ``voxel_um`` (z, y, x), ``voxel_um_source``, ``full_scale``,
        ``file_name``, ``file_bytes``.

    Raises
    ------
    FileError
        If a file is damaged, cut off, or of another format.
    VolumeError
        If it is not one grey volume: a single picture, several channels or time points, colour, slices that
        differ or are missing.
    SizeError
        If the voxel size is missing, contradictory or impossible.
    ResourceError
        If it does not fit into the memory.
    """
    path = Path(path)
    loaded = load_volume(path, memory_limit_bytes=memory_limit_bytes)
    size, source = agreed_size(loaded.stated, voxel_um, file_name=path.name, asked=VOXEL, override=override_size)
    return xr.DataArray(
        loaded.values,
        dims=VOXEL.axes,
        coords={
            axis: (axis, np.arange(n) * um, {"units": "um"})
            for axis, n, um in zip(VOXEL.axes, loaded.values.shape, size, strict=True)
        },
        name="volume",
        attrs={
            "units": "1",
            "long_name": "Grey value",
            "voxel_um": list(size),
            "voxel_um_source": source,
            "full_scale": loaded.full_scale,
            "file_name": path.name,
            "file_bytes": loaded.file_bytes,
        },
    )


def load_volume(path: Path, *, memory_limit_bytes: int | None = None) -> LoadedVolume:
    """Read the values of a volume, whatever its voxel size.

    Parameters
    ----------
    path : Path
    memory_limit_bytes : int, optional

    Returns
    -------
    LoadedVolume

    Raises
    ------
    FileError, VolumeError, ResourceError
        As :func:`read_volume`.
    """
    if path.is_dir():
        return load_folder(path, memory_limit_bytes=memory_limit_bytes)
    kind = kind_of(path)
    if kind != "tiff":
        raise VolumeError(
            f"{path.name} is one {kind.upper()} picture, not a volume. Give a TIFF stack or a folder of slices."
        )
    return load_stack(path, memory_limit_bytes=memory_limit_bytes)


def load_stack(path: Path, *, memory_limit_bytes: int | None) -> LoadedVolume:
    """Read a TIFF stack in one file."""
    with open_tiff(path) as tif:
        series = only_series(tif, path, error=VolumeError, advice=ADVICE)
        check_data(series, path)
        axes = volume_axes(series, path)
        page = series.keyframe
        check_type(series.dtype, path)
        if page.photometric == PALETTE and not tif.is_imagej and not is_grey_ramp(page.colormap):
            raise VolumeError(f"{path.name} has a colour palette. {ADVICE}")
        stated = stated_by_tiff(tif, page, path)
        values = map_or_decode(series, path, memory_limit_bytes=memory_limit_bytes)
        bits = int(page.bitspersample)
    shape = [n for n, axis in zip(series.shape, series.axes, strict=True) if axis in axes]
    values = values.reshape(shape).astype(supported_type(values.dtype), copy=False)
    return LoadedVolume(
        values=values,
        stated=stated,
        full_scale=None if values.dtype.kind == "f" else min(2**bits - 1, int(np.iinfo(values.dtype).max)),
        file_bytes=size_of_file(path),
    )


def volume_axes(series: TiffPageSeries, path: Path) -> str:
    """Return the axes of a stack that are longer than 1: slices, y and x.

    Raises
    ------
    VolumeError
        If it is a single picture, or has further axes.
    """
    axes = long_axes(series)
    if len(axes) == 3 and axes[0] in SLICE_AXES and axes[1:] == "YX":
        return axes
    # ImageJ and tifffile file a stack of unnamed pages as channels; nothing has so many channels, so these are slices.
    if len(axes) == 3 and axes[0] == "C" and axes[1:] == "YX" and series.shape[series.axes.index("C")] >= MANY_CHANNELS:
        return axes
    further = {a: n for a, n in zip(series.axes, series.shape, strict=True) if n > 1 and a in MEANINGS}
    if further:
        found = " and ".join(f"{n} {MEANINGS[a]}" for a, n in further.items())
        hint = (
            ADVICE
            if any(a in SLICE_AXES for a in axes) or "S" in further
            else f"If these are the slices, say so in the file (ImageJ: Image > Properties). Otherwise: {ADVICE}"
        )
        raise VolumeError(f"{path.name} has {found}: {shape_words(series)}. {hint}")
    if axes == "YX":
        raise VolumeError(
            f"{path.name} has one page, not a stack: {shape_words(series)}. Give all slices, in one file or one folder."
        )
    raise VolumeError(f"{path.name} is not a volume with the axes z, y, x: {shape_words(series)}. {ADVICE}")


def load_folder(path: Path, *, memory_limit_bytes: int | None) -> LoadedVolume:
    """Read a folder of slices into one array, slice by slice."""
    files = list_slices(path)
    log = stated_by_log(path, len(files))
    first = load_slice(files[0], memory_limit_bytes=memory_limit_bytes)
    height, width = first.values.shape
    check_memory(path, needed_bytes=len(files) * first.values.nbytes, limit_bytes=memory_limit_bytes)
    values = np.empty((len(files), height, width), supported_type(first.values.dtype))
    total = 0
    for i, file in enumerate(files):
        picture = first if i == 0 else load_slice(file, memory_limit_bytes=memory_limit_bytes)
        check_same(picture, first, file=file, first_file=files[0])
        values[i] = picture.values
        total += size_of_file(file)
    stated = first.stated if log is None else (log, *first.stated)
    return LoadedVolume(values=values, stated=stated, full_scale=first.full_scale, file_bytes=total)


def load_slice(file: Path, *, memory_limit_bytes: int | None) -> Picture:
    """Decode one slice of a folder and refuse colour."""
    picture = load_picture(file, memory_limit_bytes=memory_limit_bytes)
    if picture.values.ndim != 2:
        raise VolumeError(
            f"{file.name} is not grey: {size_words(picture.values.shape[:2])} pixels with "
            f"{picture.values.shape[2]} colour samples. Export all slices in grey."
        )
    check_type(picture.values.dtype, file)
    return picture


def check_same(picture: Picture, first: Picture, *, file: Path, first_file: Path) -> None:
    """Refuse a slice that differs from the first in size, type or pixel size.

    Raises
    ------
    VolumeError
        If size or type differ.
    SizeError
        If the metadata state another pixel size.
    """
    if picture.values.shape != first.values.shape:
        raise VolumeError(
            f"{file.name} is {size_words(picture.values.shape)} pixels, {first_file.name} is "
            f"{size_words(first.values.shape)}. All slices need the same size: export them again or remove the odd one."
        )
    if picture.values.dtype != first.values.dtype:
        raise VolumeError(
            f"{file.name} has {picture.values.dtype} values, {first_file.name} has {first.values.dtype}. "
            "All slices need the same type: export them again or remove the odd one."
        )
    for one, other in zip(picture.stated, first.stated, strict=False):
        for a, b in zip(one.um, other.um, strict=True):
            if a is not None and b is not None and not agree(a, b):
                raise SizeError(
                    f"{file.name} states a pixel size of {a:g} um, {first_file.name} one of {b:g} um. "
                    "All slices need the same: remove the wrong slices or their resolution tags."
                )


def check_type(dtype: np.dtype[Any], path: Path) -> None:
    """Refuse values that are no grey values.

    Raises
    ------
    VolumeError
    """
    if dtype.kind == "b":
        raise VolumeError(f"{path.name} has black and white only (1 bit). Give the grey values it was made from.")
    if dtype.kind not in "uif" or dtype.itemsize > 8:
        raise VolumeError(f"{path.name} has {dtype} values. Needed are integers or real numbers up to 64 bits.")


def is_grey_ramp(colormap: NDArray[Any] | None) -> bool:
    """Whether a palette only spreads grey values over the range, in order."""
    if colormap is None:
        return False
    red, green, blue = np.asarray(colormap).astype(np.int64)
    return bool(np.array_equal(red, green) and np.array_equal(red, blue) and np.all(np.diff(red) > 0))


def supported_type(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Widen float16, in which the kernels cannot compute, to float32."""
    return np.dtype(np.float32) if dtype == np.float16 else dtype
