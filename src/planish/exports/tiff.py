"""Write TIFF for ImageJ and OME-TIFF.

The file is laid out first, then its values are written band by band.
"""

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

from planish.core.errors import ResourceError
from planish.core.memory import STACK_BYTES
from planish.core.typing import Array, DType, Entries, Shape, Shape2D
from planish.exports.content import ExportHistory, Maps, exact, exact_pitch, volume_facts
from planish.exports.formats import ExportParams

MOST = 2**32 - 2**20
"""Bytes of the values of a TIFF for ImageJ."""


def write_imagej(
    content: Maps | xr.DataArray, path: Path, history: ExportHistory, _params: ExportParams
) -> None:
    """Write maps (channels), or a volume (z, y, x), in one file for ImageJ.

    ImageJ reads the unit from the description and the pixel size from the resolution, which is a
    fraction: sizes with up to six digits come back exactly. Positions count from the middle of the
    first pixel there; where that lies in the sheet stands in the history. ResourceError where the
    values take more than it holds: places are counted in 32 bits.
    """
    stack = _Stack.of(content)
    stack_bytes = 4 * math.prod(stack.shape)
    if stack_bytes > MOST:
        remedy_text = "or `to=ome-zarr`"
        if len(stack.labels) > 1:
            remedy_text = "or a folder for a file each"
        raise ResourceError(
            f"These values take {stack_bytes / 1e9:.1f} GB, and a TIFF for ImageJ holds 4 GB. Give "
            f"`to=ome-tiff`, {remedy_text}."
        )
    info = history.json(**stack.facts)
    metadata: Entries = {"axes": stack.axes, "unit": "um", "Info": info}
    if isinstance(content, Maps):
        metadata |= _limits(content)
        metadata["Labels"] = stack.labels
        if len(stack.labels) > 1:
            metadata["mode"] = "grayscale"
    else:
        metadata["spacing"] = stack.pixel_um[0]
    # Along x and y, in pixels per um: a fraction of two whole numbers.
    resolution: list[Shape2D] = []
    for pitch_um in stack.pixel_um[:-3:-1]:
        pixel = Fraction(pitch_um).limit_denominator(10**6)
        resolution.append((pixel.denominator, pixel.numerator))
    stack.write(path, history, imagej=True, ome=False, resolution=resolution, metadata=metadata)


def _limits(maps: Maps) -> Entries:
    """Limits between which ImageJ shows maps at first, by its own keywords.

    Empty where the limits of a map are not known.
    """
    if not maps.scales.keys() >= {*maps.names}:
        return {}
    limits: list[float] = []
    for name in maps.names:
        scale = maps.scales[name]
        limits += [float(scale.low), float(scale.high)]
    metadata: Entries = {"min": limits[0], "max": limits[1]}
    # ImageJ takes the ranges of up to seven channels; of more, one for all.
    if len(maps.names) > 1:
        metadata["Ranges"] = limits
    return metadata


def write_ome(
    content: Maps | xr.DataArray, path: Path, history: ExportHistory, _params: ExportParams
) -> None:
    """Write maps (channels), or a volume (z, y, x), in one OME-TIFF.

    Its identifier is a hash of what it says.
    """
    stack = _Stack.of(content)
    description = history.json(**stack.facts)
    digest = hashlib.sha256(description.encode()).digest()
    metadata: Entries = {
        "axes": stack.axes,
        "Creator": history.program,
        "Description": description,
        "UUID": f"urn:uuid:{uuid.UUID(bytes=digest[:16], version=5)}",
    }
    for axis, pitch_um in zip("XYZ", stack.pixel_um[::-1], strict=False):
        metadata[f"PhysicalSize{axis}"] = pitch_um
        metadata[f"PhysicalSize{axis}Unit"] = "µm"
    n_planes = math.prod(stack.shape[:-2])
    # Each plane states the place of its first pixel.
    *first_slice_um, first_row_um, first_col_um = stack.origin_um
    positions = {"PositionX": [first_col_um] * n_planes, "PositionY": [first_row_um] * n_planes}
    if isinstance(content, Maps):
        metadata["Channel"] = {"Name": stack.labels}
    else:
        slices_um = first_slice_um[0] + stack.pixel_um[0] * np.arange(n_planes)
        positions["PositionZ"] = slices_um.tolist()
    metadata["Plane"] = positions | {f"{axis_key}Unit": ["µm"] * n_planes for axis_key in positions}
    stack.write(path, history, ome=True, metadata=metadata)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stack:
    """Planes of a file: maps or a volume, float32.

    One map of codes or truth values alone keeps its bytes.

    ``pixel_um`` and ``origin_um`` are pitch and first place of (y, x), or (z, y, x); ``facts`` are
    for the history.
    """

    content: Maps | xr.DataArray
    axes: str
    shape: Shape
    dtype: DType
    pixel_um: tuple[float, ...]
    origin_um: tuple[float, ...]
    labels: list[str]
    facts: Entries

    @classmethod
    def of(cls, content: Maps | xr.DataArray) -> _Stack:
        """Lay out the planes of maps or of a volume."""
        if isinstance(content, Maps):
            return cls._of_maps(content)
        return cls._of_volume(content)

    @classmethod
    def _of_maps(cls, maps: Maps) -> _Stack:
        """Lay out maps: several as channels, one alone as a plane."""
        names = maps.names
        # A map without a unit has the unit 1.
        labels = [f"{name} ({maps.units[name]})".removesuffix(" (1)") for name in names]
        axes = "YX"
        shape: Shape = maps.shape
        dtype = np.dtype(np.float32)
        if len(names) > 1:
            axes = "CYX"
            shape = (len(names), *maps.shape)
        elif maps.data[names[0]].dtype.kind in "bu":  # truth values or codes
            dtype = np.dtype(np.uint8)
        return cls(
            content=maps,
            axes=axes,
            dtype=dtype,
            shape=shape,
            pixel_um=maps.pixel_um,
            origin_um=maps.origin_um,
            labels=labels,
            facts=maps.facts() | {"maps": maps.titles},
        )

    @classmethod
    def _of_volume(cls, volume: xr.DataArray) -> _Stack:
        coords_um = [volume[dim].values for dim in volume.dims]
        first_um = tuple(exact(axis_um[0]) for axis_um in coords_um)
        pixel_um = tuple(map(exact_pitch, coords_um))
        facts = volume_facts(volume) | {
            "axes": "".join(map(str, volume.dims)),
            "voxel_um": list(pixel_um),
            "first_voxel_um": list(first_um),
            "missing": "NaN",
        }
        return cls(
            content=volume,
            axes="ZYX",
            dtype=np.dtype(np.float32),
            shape=volume.shape,
            pixel_um=pixel_um,
            origin_um=first_um,
            labels=[],
            facts=facts,
        )

    def parts(self) -> Iterator[tuple[int, int, Array]]:
        """Give the number of the plane, the first row there, and values (rows, cols) of each part.

        A volume is read in slabs of rows through all its slices, as it is stored.
        """
        if isinstance(self.content, Maps):
            for k, name in enumerate(self.content.names):
                for rows, band in self.content.bands(name, self.dtype):
                    yield k, rows.start, band
            return
        n_slices, n_rows, n_cols = self.content.shape
        rows_at_once = max(1, STACK_BYTES // (4 * n_slices * n_cols))
        for first_row in range(0, n_rows, rows_at_once):
            slab = self.content[:, first_row : first_row + rows_at_once, :]
            for k, band in enumerate(slab.values.astype(self.dtype)):
                yield k, first_row, band

    def write(self, path: Path, history: ExportHistory, **options: Any) -> None:
        """Lay out a file of uncompressed planes, one after another, and put the values into it.

        ``options`` are those of tifffile. The values are written where the laid out planes lie in
        the file, part by part, so that no more than a part is in memory.
        """
        tifffile.imwrite(
            path,
            shape=self.shape,
            dtype=self.dtype,
            byteorder="<",
            photometric="minisblack",
            software=history.program,
            **options,
        )
        with tifffile.TiffFile(path) as file:
            data_offset = file.series[0].dataoffset
        assert data_offset is not None  # the planes are contiguous
        *_, rows, cols = self.shape
        row_bytes = cols * self.dtype.itemsize
        with path.open("rb+") as file:
            for plane, first_row, band in self.parts():
                n_rows_before = plane * rows + first_row
                file.seek(data_offset + n_rows_before * row_bytes)
                values = np.ascontiguousarray(band, self.dtype.newbyteorder("<"))
                file.write(values.data)
