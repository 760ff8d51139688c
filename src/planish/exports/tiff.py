"""TIFF for ImageJ and OME-TIFF: the file is laid out first, then its values are written band by band."""

from __future__ import annotations

import hashlib
import math
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import ResourceError
from planish.core.memory import STACK_BYTES
from planish.exports.content import ExportHistory, Maps, exact
from planish.exports.formats import ExportParams

MOST = 2**32 - 2**20
"""Bytes of the values of a TIFF for ImageJ."""


def write_imagej(content: Maps | xr.DataArray, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Write maps (channels), or a volume (z, y, x), in one file for ImageJ.

    Notes
    -----
    ImageJ reads the unit from the description and the pixel size from the resolution, which is a fraction: sizes with
    up to six digits come back exactly. Positions count from the middle of the first pixel there; where that lies in the
    sheet stands in the history.

    Raises
    ------
    ResourceError
        If the values take more than a TIFF of ImageJ holds: places in it are counted in 32 bits.
    """
    stack = _Stack.of(content)
    size = 4 * math.prod(stack.shape)
    if size > MOST:
        remedy = "or a folder for a file each" if len(stack.labels) > 1 else "or --to ome-zarr"
        raise ResourceError(
            f"These values take {size / 1e9:.1f} GB, and a TIFF for ImageJ holds 4 GB. Give --to ome-tiff, {remedy}."
        )
    metadata: dict[str, Any] = {"axes": stack.axes, "unit": "um", "Info": history.json(**stack.facts)}
    if isinstance(content, Maps):
        if all(name in content.scales for name in content.names):  # limits between which maps are shown at first
            limits = [limit for n in content.names for limit in (content.scales[n].low, content.scales[n].high)]
            metadata |= {"min": limits[0], "max": limits[1]}
            if len(content.names) > 1:  # ImageJ takes the ranges of up to seven channels; of more, one for all
                metadata["Ranges"] = limits
        metadata["Labels"] = stack.labels
        if len(stack.labels) > 1:
            metadata["mode"] = "grayscale"
    else:
        metadata["spacing"] = stack.pixel_um[0]
    pixels = [Fraction(pitch).limit_denominator(10**6) for pitch in stack.pixel_um[:-3:-1]]
    resolution = tuple((pixel.denominator, pixel.numerator) for pixel in pixels)
    stack.write(path, history, imagej=True, ome=False, resolution=resolution, metadata=metadata)


def write_ome(content: Maps | xr.DataArray, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Write maps (channels), or a volume (z, y, x), in one OME-TIFF; its identifier is a hash of what it says."""
    stack = _Stack.of(content)
    note = history.json(**stack.facts)
    metadata: dict[str, Any] = {
        "axes": stack.axes,
        "Creator": history.program,
        "Description": note,
        "UUID": f"urn:uuid:{uuid.UUID(bytes=hashlib.sha256(note.encode()).digest()[:16], version=5)}",
    }
    for axis, pitch in zip("XYZ", stack.pixel_um[::-1], strict=False):
        metadata |= {f"PhysicalSize{axis}": pitch, f"PhysicalSize{axis}Unit": "µm"}
    first, planes = stack.first_um, stack.shape[0] if len(stack.shape) > 2 else 1
    positions = {"PositionX": [first[-1]] * planes, "PositionY": [first[-2]] * planes}
    if isinstance(content, Maps):
        metadata["Channel"] = {"Name": stack.labels}
    else:
        positions["PositionZ"] = [first[0] + k * stack.pixel_um[0] for k in range(planes)]
    metadata["Plane"] = positions | {f"{key}Unit": ["µm"] * planes for key in positions}
    stack.write(path, history, ome=True, metadata=metadata)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stack:
    """Planes of a file: maps or a volume, float32; one map of codes or truth values alone keeps its bytes.

    ``pixel_um`` and ``first_um`` are pitch and first place of (y, x), or (z, y, x) of a volume; ``facts`` are for the
    history.
    """

    content: Maps | xr.DataArray
    axes: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    pixel_um: tuple[float, ...]
    first_um: tuple[float, ...]
    labels: list[str]
    facts: dict[str, Any]

    @classmethod
    def of(cls, content: Maps | xr.DataArray) -> _Stack:
        """Lay out the planes of maps or of a volume."""
        dtype = np.dtype(np.float32)
        if isinstance(content, Maps):
            names, several = content.names, len(content.names) > 1
            if not several and content.data[names[0]].dtype.kind in "bu":
                dtype = np.dtype(np.uint8)
            return cls(
                content=content,
                axes="CYX" if several else "YX",
                dtype=dtype,
                shape=(len(names), *content.shape) if several else content.shape,
                pixel_um=content.pixel_um,
                first_um=content.origin_um,
                labels=[f"{name} ({content.units[name]})".removesuffix(" (1)") for name in names],
                facts=content.facts() | {"maps": content.titles},
            )
        axes = [content[dim].values for dim in content.dims]
        first = tuple(exact(um[0]) for um in axes)
        pixel = tuple(exact((um[-1] - um[0]) / max(um.size - 1, 1)) for um in axes)
        facts = {str(key): fact for key, fact in content.attrs.items() if key != "voxel_um"}
        facts |= {"axes": "".join(map(str, content.dims)), "voxel_um": list(pixel), "first_voxel_um": list(first)}
        return cls(
            content=content, axes="ZYX", dtype=dtype, shape=tuple(content.shape), pixel_um=pixel, first_um=first,
            labels=[], facts=facts | {"missing": "NaN"},
        )  # fmt: skip

    def parts(self) -> Iterator[tuple[int, int, NDArray[Any]]]:
        """Give plane, first row, and values (rows, cols) of each part."""
        if isinstance(self.content, Maps):
            for k, name in enumerate(self.content.names):
                for rows, band in self.content.bands(name, self.dtype):
                    yield k, rows.start, band
            return
        deep, high, wide = self.content.shape
        step = max(1, STACK_BYTES // (4 * deep * wide))
        for begin in range(0, high, step):
            block = np.asarray(self.content[:, begin : begin + step, :].values, dtype=self.dtype)
            for k in range(deep):
                yield k, begin, block[k]

    def write(self, path: Path, history: ExportHistory, **how: Any) -> None:
        """Lay out a file of uncompressed planes, one behind the other, and put the values into it."""
        tifffile.imwrite(
            path, shape=self.shape, dtype=self.dtype, byteorder="<", photometric="minisblack",
            software=history.program, **how,
        )  # fmt: skip
        with tifffile.TiffFile(path) as file:
            begin = file.series[0].dataoffset
        if begin is None:
            raise AssertionError("the planes of the file are not contiguous")
        width = self.shape[-1] * self.dtype.itemsize
        with path.open("rb+") as file:
            for plane, row, part in self.parts():
                file.seek(begin + (plane * self.shape[-2] + row) * width)
                file.write(np.ascontiguousarray(part, self.dtype.newbyteorder("<")).data)
