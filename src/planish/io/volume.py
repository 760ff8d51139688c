"""The 3D image of the sheet in any format, its axes in um."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from planish.core.errors import FileError, VolumeError
from planish.core.frame import Axis, End, Frame
from planish.io.formats import (
    ADVICE,
    HEAD_BYTES,
    LoadedVolume,
    Place,
    begins,
    check_channel,
    check_type,
    find_place,
    format_by_bytes,
    format_of,
    full_scale,
    loader,
)
from planish.io.guard import head_of
from planish.io.lazy import decode_if_small
from planish.io.orientation import orientation_attrs, orientation_notes
from planish.io.sizes import VOXEL, agreed_size, size_attrs
from planish.io.tiff import damaged, size_words

if TYPE_CHECKING:
    import xarray as xr


def read_volume(
    path: str | Path,
    *,
    voxel_um: float | tuple[float, float, float] | None = None,
    channel: str | None = None,
    override_size: bool = False,
    unusual_size: bool = False,
    memory_bytes: int | None = None,
    through: Axis | None = None,
    top: End | None = None,
) -> xr.DataArray:
    """Read the 3D image of a sheet.

    Parameters
    ----------
    path : path
        A TIFF stack (classic, BigTIFF, ImageJ, OME), a folder of numbered slices (TIFF, PNG, BMP,
        JPEG; with the log of NRecon or without), OME-Zarr, NRRD, MetaImage, HDF5 or NeXus, NIfTI,
        MRC, MATLAB, or raw values with a TOML header. Where a file holds several volumes,
        ``file.h5:/entry/data`` chooses one.
    voxel_um : float or (z, y, x), optional
        Voxel size in um; not needed where the metadata state it.
    channel : {"luminance", "red", "green", "blue"}, optional
        What is taken from TIFF stacks and slices in colour; luminance where not given.
    override_size : bool
        Whether `voxel_um` is taken although the metadata state another size.
    unusual_size : bool
        Whether a size is taken that paper does not have, from 0.1 nm to 1 mm.
    memory_bytes : int, optional
        Largest decoded size; default: three quarters of the memory available. An uncompressed stack
        in one piece is mapped from its file and needs none; what is larger than the limit stays in
        its file.
    through : {"z", "y", "x"}, optional
        Axis that runs through the sheet, which :func:`planish.find_surfaces` then follows; z where
        not given.
    top : {"high", "low"}, optional
        End of that axis at which the sheet's top side lies; the high one where not given.

    Returns
    -------
    DataArray, dims (z, y, x)
        In the type of the file, float16 as float32. Coordinates in um, voxel i has its centre at i
        × size. Attributes: ``units``, ``long_name``, ``voxel_um`` (z, y, x), ``voxel_um_source``,
        ``full_scale``, ``file_name``, ``file_bytes``, and ``through``, ``top_side`` where one of
        them is given; for some formats more. Large volumes are indexed lazily:
        ``volume.isel(z=slice(a, b)).values`` reads that part only, and several threads may do so at
        the same time. Their ``encoding`` says ``chunks`` (z, y, x), what is decoded together, or
        None, and ``whole_slices``, whether a few rows cost as much as a slice.

    Raises
    ------
    FileError
        If a file is damaged, cut off, or of another format.
    VolumeError
        If it is not one grey volume: one picture, several channels or times, slices that differ or
        are missing.
    SizeError
        If the voxel size is missing, contradictory or impossible.
    InputError
        If there is no such channel, axis or end, or `path` is no path.
    ResourceError
        If not even a slice of it fits into the memory.
    """
    from planish.core.arrays import check_path  # here, so that a look at a file waits for no xarray
    from planish.core.labelled import labelled

    frame_attrs: Mapping[str, str] = {}
    if through or top:
        frame_attrs = Frame(through=through or "z", top=top or "high").lies()
    path = check_path(
        path, "the path of a file", "pl.read_volume", "pl.volume(array, voxel_um=...)"
    )
    place = find_place(path)
    loaded = load_volume(place, channel=channel, memory_bytes=memory_bytes)
    name = place.path.name
    size, source = agreed_size(
        loaded.stated,
        voxel_um,
        file_name=name,
        asked=VOXEL,
        override=override_size,
        unusual=unusual_size,
    )
    attrs = {
        "units": "1",
        "long_name": "Grey value",
        **size_attrs(VOXEL, size, source, loaded.stated),
        "full_scale": full_scale(loaded.values.dtype, loaded.bits),
        "file_name": name,
        "file_bytes": loaded.file_bytes,
        **loaded.attrs,
        **frame_attrs,
    }
    return labelled(loaded.values, VOXEL.axes, size, name="volume", attrs=attrs)


def open_volume(
    place: Place, *, channel: str | None = None, memory_bytes: int | None = None
) -> LoadedVolume:
    """Open a volume, with what its file says about its hand and what was assumed as attributes."""
    _check_contents(place)
    loaded = loader(format_of(place))(place, check_channel(channel), memory_bytes)
    attrs = {**loaded.attrs, **orientation_attrs(loaded.orientations)}
    if loaded.doubts:
        attrs["doubts"] = [*loaded.doubts]
    notes = [*loaded.notes, *orientation_notes(loaded.orientations)]
    if notes:
        attrs["notes"] = notes
    return loaded._replace(attrs=attrs)


def _check_contents(place: Place) -> None:
    """Refuse a file that is of another kind than its name says, before it is called damaged.

    Pictures and TIFF files are known by their first bytes alone, and raw values may begin with any.
    """
    path = place.path
    file_format = format_of(place)
    if not file_format.starts:
        return
    head = head_of(path, HEAD_BYTES)
    if path.suffix.lower() in (".gz", ".bz2"):
        unpacked = format_by_bytes(head)
        if unpacked is not None:
            raise FileError(
                f"{path.name} is no packed file but {unpacked.name}. Rename it to {path.stem}."
            )
        return
    if begins(head, file_format.starts):
        return
    from planish.io.other_files import check_kind  # here, so that a good file waits for no table

    check_kind(path, takes_text=file_format.name == "MetaImage")


def load_volume(
    place: Place, *, channel: str | None = None, memory_bytes: int | None = None
) -> LoadedVolume:
    """Read the values of a volume, whatever its voxel size.

    Errors as those of :func:`read_volume`.
    """
    path = place.path
    loaded = open_volume(place, channel=channel, memory_bytes=memory_bytes)
    shape = loaded.values.shape
    if 0 in shape or math.prod(shape) > 2**50:  # No scan has more; a larger number is damage.
        raise damaged(path, f"it declares {size_words(shape)} voxels, which no volume has")
    if len(shape) != 3 or min(shape) == 1:
        raise VolumeError(
            f"{path.name} is no volume but {size_words(shape)} voxels (z, y, x). {ADVICE}"
        )
    check_type(loaded.values.dtype, path)
    return loaded._replace(values=decode_if_small(loaded.values, memory_bytes=memory_bytes))
