"""TIFF for ImageJ and OME-TIFF: the file is laid out first, then its values are written band by band."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import ResourceError
from planish.writers.content import History, Maps
from planish.writers.params import ExportParams

_FINEST = 10**6  # of a pixel size as a fraction
MOST = 2**32 - 2**20
"""Bytes of the values of a TIFF for ImageJ."""

_VOLUME_BYTES = 2**26  # of a volume that are in memory at a time


def check(content: Maps | xr.DataArray, params: ExportParams) -> None:
    """Raise ResourceError for more than a TIFF of ImageJ holds: places in it are counted in 32 bits."""
    planes = len(content.names) if isinstance(content, Maps) else content.shape[0]
    size = 4 * planes * content.shape[-2] * content.shape[-1]
    if params.to == "tiff" and size > MOST:
        remedy = "or a folder for a file each" if planes > 1 and isinstance(content, Maps) else "or --to ome-zarr"
        raise ResourceError(
            f"These values take {size / 1e9:.1f} GB, and a TIFF for ImageJ holds 4 GB. Give --to ome-tiff, {remedy}."
        )


def write(content: Maps | xr.DataArray, path: Path, history: History, params: ExportParams) -> None:
    """Write maps (channels), or a volume (z, y, x), in one file.

    The values are float32; one map of codes or truth values alone keeps its bytes.

    Notes
    -----
    ImageJ reads the unit from the description and the pixel size from the resolution, which is a fraction: sizes with
    up to six digits come back exactly. Positions count from the middle of the first pixel there; where that lies in the
    sheet stands in the history.
    """
    ome = params.to == "ome-tiff"
    if isinstance(content, Maps):
        names = content.names
        kinds = {content.data[name].dtype.kind for name in names}
        dtype = np.dtype(np.uint8) if kinds <= set("bu") and len(names) == 1 else np.dtype(np.float32)
        labels = [f"{name} ({content.units(name)})" if content.units(name) != "1" else name for name in names]
        shape, axes = ((len(names), *content.shape), "CYX") if len(names) > 1 else (content.shape, "YX")
        facts = content.facts() | {"maps": {name: content.title(name) for name in names}}
        pixel, origin, depth, first = content.pixel_um, content.origin_um, None, None
        about = _imagej_limits(content) if not ome else {}
    else:
        shape, axes, labels, dtype = tuple(content.shape), "ZYX", [], np.dtype(np.float32)
        steps, starts = zip(*[_axis(content, dim) for dim in content.dims], strict=True)
        (depth, *rest), (first, *begin) = steps, starts
        pixel, origin = (rest[0], rest[1]), (begin[0], begin[1])
        facts = {key: value for key, value in content.attrs.items() if key != "voxel_um"}
        facts |= {"axes": "".join(map(str, content.dims)), "voxel_um": list(steps), "first_voxel_um": list(starts)}
        facts["missing"] = "NaN"
        about = {}
    note = history.json(**facts)
    how: dict[str, Any] = {
        "shape": shape, "dtype": dtype, "byteorder": "<", "photometric": "minisblack", "software": history.program,
    }  # fmt: skip
    if ome:
        heights = None if depth is None or first is None else (depth, [first + k * depth for k in range(shape[0])])
        metadata = _ome(axes, labels, pixel, origin, heights, note, history)
        tifffile.imwrite(path, **how, ome=True, metadata=metadata)
    else:
        metadata = {"axes": axes, "unit": "um", "Info": note, **about}
        if labels and axes == "CYX":
            metadata |= {"Labels": labels, "mode": "grayscale"}
        elif labels:
            metadata["Labels"] = labels
        if depth is not None:
            metadata["spacing"] = depth
        across, down = ((f.denominator, f.numerator) for f in (_fraction(pixel[1]), _fraction(pixel[0])))
        tifffile.imwrite(path, **how, imagej=True, ome=False, resolution=(across, down), metadata=metadata)
    _fill(path, _parts(content, dtype), shape, dtype)


def _parts(content: Maps | xr.DataArray, dtype: np.dtype[Any]) -> Iterator[tuple[int, int, NDArray[Any]]]:
    """Give plane, first row, and values (rows, cols) of each part, or (planes, rows, cols) from a plane on."""
    if isinstance(content, Maps):
        for k, name in enumerate(content.names):
            for rows, values in content.bands(name, dtype):
                yield k, rows.start, values
        return
    deep, high, wide = content.shape
    step = max(1, _VOLUME_BYTES // (4 * deep * wide))
    for begin in range(0, high, step):
        part = np.asarray(content[:, begin : begin + step, :].values, dtype=dtype)
        for k in range(deep):
            yield k, begin, part[k]


def _fill(
    path: Path, parts: Iterator[tuple[int, int, NDArray[Any]]], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> None:
    """Put the values into a file that is laid out: uncompressed planes, one behind the other."""
    with tifffile.TiffFile(path) as laid:
        begin = laid.series[0].dataoffset
    if begin is None:
        raise AssertionError("the planes of the file are not contiguous")
    width = shape[-1] * dtype.itemsize
    with path.open("rb+") as file:
        for plane, row, values in parts:
            file.seek(begin + (plane * shape[-2] + row) * width)
            file.write(np.ascontiguousarray(values, dtype.newbyteorder("<")).data)


def _imagej_limits(maps: Maps) -> dict[str, Any]:
    """Limits between which ImageJ shows maps at first, where they are known of all of them."""
    found = [maps.display[name] for name in maps.names if name in maps.display]
    if len(found) < len(maps.names):
        return {}
    limits = [float(v) for one in found for v in (one.low, one.high)]
    # ImageJ takes the ranges of up to seven channels; of more, one range for all.
    return {"min": limits[0], "max": limits[1]} | ({"Ranges": limits} if len(found) > 1 else {})


def _ome(
    axes: str, labels: list[str], pixel: tuple[float, float], origin: tuple[float, float],
    heights: tuple[float, list[float]] | None, note: str, history: History,
) -> dict[str, Any]:  # fmt: skip
    """Metadata of an OME-TIFF; its identifier is a hash of what it says.

    ``heights``: of a volume the pitch and the places of its planes.
    """
    found: dict[str, Any] = {
        "axes": axes, "Creator": history.program, "Description": note,
        "UUID": f"urn:uuid:{uuid.UUID(bytes=hashlib.sha256(note.encode()).digest()[:16], version=5)}",
        "PhysicalSizeX": pixel[1], "PhysicalSizeXUnit": "µm", "PhysicalSizeY": pixel[0], "PhysicalSizeYUnit": "µm",
    }  # fmt: skip
    planes = 1 if axes == "YX" else len(labels) or len(heights[1] if heights else ())
    if labels:
        found["Channel"] = {"Name": labels}
    places = {"PositionX": [origin[1]] * planes, "PositionY": [origin[0]] * planes}
    if heights is not None:
        found |= {"PhysicalSizeZ": heights[0], "PhysicalSizeZUnit": "µm"}
        places["PositionZ"] = heights[1]
    found["Plane"] = places | {f"{key}Unit": ["µm"] * planes for key in places}
    return found


def _axis(volume: xr.DataArray, dim: Any) -> tuple[float, float]:
    """Pitch and first place along an axis of a volume."""
    at = volume[dim].values
    return float(f"{(at[-1] - at[0]) / max(at.size - 1, 1):.12g}"), float(f"{at[0]:.12g}")


def _fraction(pixel_um: float) -> Fraction:
    return Fraction(pixel_um).limit_denominator(_FINEST)
