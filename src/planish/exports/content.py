"""Contents of an export.

Maps on one grid, read band by band, and the history that travels with them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike

from planish.core.bands import read_bands
from planish.core.errors import SizeError
from planish.core.typing import Array, DType, Entries, Fields, Floats, Pair, Shape2D, Singles
from planish.report.colours import Scale
from planish.report.text import title_of

_ENDS = (slice(None, -1), slice(1, None))
# Corners of the cells between the nodes of a grid: row by row, all nodes that are one.
CORNERS = [(rows, cols) for rows in _ENDS for cols in _ENDS]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportHistory:
    """Origin of an export, which travels with every file as one line of JSON."""

    planish: str  #: version that made the run
    exported_by: str  #: version that exports it
    study_sha256: str  #: of ``run.toml``
    #: of each layer its name, the name of its file, and the file's SHA-256.
    inputs: tuple[Fields, ...]

    def json(self, **more: Any) -> str:
        """Return it as JSON, with what else is to be known of a file.

        One line of ASCII, always the same.
        """
        return json.dumps(asdict(self) | more, allow_nan=False)

    @property
    def program(self) -> str:
        """Program and version, for fields that name the software."""
        return f"planish {self.exported_by}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Maps:
    """Maps (rows, cols) on one regular grid, which may stay in their store.

    ``data`` has the dims (y, x) or (v, u), coordinates in um, variables with ``units`` and
    ``long_name``; NaN: missing.
    """

    data: xr.Dataset
    group: str  #: its name in the run
    #: By name, where they are chosen: limits and colours with which maps are shown.
    scales: Mapping[str, Scale] = field(default_factory=dict[str, Scale])
    #: By name, where they are there: folders in a zarr store of a map's array and its overviews,
    #: the finest first.
    levels: Mapping[str, Sequence[Path]] = field(default_factory=dict[str, Sequence[Path]])
    #: Pixels that count in means, whether or not they are written as a map; None: all.
    valid: xr.DataArray | None = None

    @property
    def names(self) -> list[str]:
        """Names of the maps."""
        return [str(name) for name in self.data.data_vars]

    @property
    def dims(self) -> tuple[str, str]:
        """Names of rows and columns: (y, x), or (v, u) of the flat sheet."""
        if "v" in self.data.dims:
            return "v", "u"
        return "y", "x"

    @property
    def at_um(self) -> tuple[Floats, Floats]:
        """Places of the middles of rows and of columns."""
        rows, cols = self.dims
        return self.data[rows].values, self.data[cols].values

    @property
    def shape(self) -> Shape2D:
        """Rows and columns."""
        y, x = self.at_um
        return y.size, x.size

    @property
    def pixel_um(self) -> Pair:
        """Pitch of rows and columns, without the rounding of their coordinates.

        SizeError where there is none.
        """
        if min(self.shape) < 2:
            raise SizeError(
                f"The maps have {self.shape[0]} x {self.shape[1]} pixels; 2 x 2 are needed for a"
                " size."
            )
        y, x = self.at_um
        return exact_pitch(y), exact_pitch(x)

    @property
    def origin_um(self) -> Pair:
        """Middle of the first pixel: (y, x)."""
        y, x = self.at_um
        return exact(y[0]), exact(x[0])

    def facts(self) -> Entries:
        """Group, pixel size and place, for the history."""
        return {
            "group": self.group,
            "axes": "".join(self.dims),
            "pixel_um": list(self.pixel_um),
            "first_pixel_um": list(self.origin_um),
            "missing": "NaN",
        }

    @property
    def titles(self) -> dict[str, str]:
        """Titles of the maps, by name."""
        return {name: title_of(self.data[name]) for name in self.names}

    @property
    def units(self) -> dict[str, str]:
        """Units of the maps, by name."""
        return {name: units_of(self.data[name]) for name in self.names}

    def only(self, name: str) -> Maps:
        """Take a single map."""
        return replace(self, data=self.data[[name]])

    def dtype_of(self, name: str) -> DType:
        """Type in which a map is written: its own, truth values as bytes of 0 and 1."""
        return plain_type(self.data[name].dtype)

    def whole(self, name: str, dtype: DTypeLike) -> Array:
        """All of a map at once (rows, cols), as ``dtype``."""
        return np.concatenate([band for _, band in self.bands(name, dtype)])

    def bands(self, name: str, dtype: DTypeLike | None = None) -> Iterator[tuple[slice, Array]]:
        """Give a map band by band, reading ahead: its rows, and their values (rows, cols).

        They are of ``dtype``, or as :meth:`dtype_of` says where it is not given.
        """
        target = self.dtype_of(name)
        if dtype is not None:
            target = np.dtype(dtype)
        for rows, (band,) in read_bands(self.data[name]):
            yield rows, np.ascontiguousarray(band, dtype=target)


def volume_facts(volume: xr.DataArray) -> Entries:
    """Attributes of a volume for the history, where its voxel size stands by itself."""
    facts = dict(volume.attrs)
    facts.pop("voxel_um", None)
    return facts


def percentile_limits(pixels: Singles) -> Pair:
    """1st and 99th percentile of a map, between which it is shown first.

    0 to 1 where it has no value.
    """
    finite = pixels[np.isfinite(pixels)].astype(np.float64)
    if not finite.size:
        return 0.0, 1.0
    low, high = np.percentile(finite, (1.0, 99.0)).tolist()
    if not high > low:  # of a constant map
        high = low + 1.0
    return low, high


def plain_type(dtype: DType) -> DType:
    """Type in which values are written: truth values become bytes of 0 and 1."""
    if dtype.kind == "b":
        return np.dtype(np.uint8)
    return dtype


def units_of(variable: xr.DataArray) -> str:
    """Unit of a map; 1 where it has none."""
    return str(variable.attrs.get("units", "1"))


def column_of(name: str, units: str) -> str:
    """Name of a column or property with its unit: ``coating_top_um``; no unit for plain numbers."""
    word = units.replace("/", "_per_").replace("%", "percent")
    if units in ("", "1") or name.endswith(f"_{word}"):
        return name
    return f"{name}_{word}"


def exact_pitch(places_um: Floats) -> float:
    """Pitch of evenly spaced places, without the rounding of each; 0 of a single one."""
    n_steps = max(places_um.size - 1, 1)
    return exact((places_um[-1] - places_um[0]) / n_steps)


def exact(length_um: float) -> float:
    """Give a length as it was meant.

    Sums of multiples of a pixel size have no more than twelve digits.
    """
    return float(f"{length_um:.12g}")
