"""Contents of an export: maps on one grid, read band by band, and the history that travels with them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import google_crc32c
import imagecodecs
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.bands import BAND, band_of, bands
from planish.core.errors import SizeError
from planish.core.threads import thread_pool
from planish.report.colours import Scale

_SUM = 4  # bytes at the end of a chunk
_DECODED = {"_FillValue", "scale_factor", "add_offset", "dtype"}  # attributes with which values are not as they stand


@dataclass(frozen=True, slots=True)
class Chunks:
    """Chunks of an array (rows, cols) in a zarr store: of so many columns, as high as a band, packed as maps are."""

    folder: Path
    shape: tuple[int, int]
    wide: int
    dtype: np.dtype[Any]

    @classmethod
    def of(cls, folder: Path, shape: tuple[int, int], dtype: np.dtype[Any]) -> Chunks | None:
        """Chunks of a map with this shape and type; None where they have another form."""
        about = json.loads((folder / "zarr.json").read_text(encoding="utf-8"))
        codecs = [codec["name"] for codec in about["codecs"]]
        order = about["codecs"][0].get("configuration", {}).get("endian", "little")
        keys = about["chunk_key_encoding"]
        plain = (
            codecs == ["bytes", "blosc", "crc32c"]
            and order == "little"
            and about["chunk_grid"]["name"] == "regular"
            and (keys["name"], keys.get("configuration", {}).get("separator", "/")) == ("default", "/")
            and (about["data_type"], tuple(about["shape"])) == (dtype.name, shape)
            and not _DECODED & set(about["attributes"])
        )
        if not plain:
            return None
        high, wide = about["chunk_grid"]["configuration"]["chunk_shape"]
        return cls(folder, shape, wide, dtype) if high == BAND else None

    def start(self, rows: slice, target: np.dtype[Any], pool: Executor) -> Callable[[], NDArray[Any]]:
        """Begin to read a band; what is returned waits for it.

        It raises OSError, RuntimeError or ValueError where a chunk is damaged or not there.
        """
        band = np.empty((rows.stop - rows.start, self.shape[1]), target)
        jobs = [
            pool.submit(self._read, rows.start // BAND, k, band[:, k * self.wide : (k + 1) * self.wide])
            for k in range(-(-self.shape[1] // self.wide))
        ]

        def done() -> NDArray[Any]:
            for job in jobs:
                job.result()
            return band

        return done

    def _read(self, row: int, col: int, into: NDArray[Any]) -> None:
        block = np.empty((BAND, self.wide), self.dtype)
        packed = (self.folder / "c" / str(row) / str(col)).read_bytes()
        if google_crc32c.value(packed[:-_SUM]) != int.from_bytes(packed[-_SUM:], "little"):
            raise ValueError(f"a chunk of {len(packed)} bytes does not have the sum that was written with it")
        decoded = imagecodecs.blosc_decode(packed[:-_SUM], numthreads=1, out=block.reshape(-1).view(np.uint8).data)
        if len(decoded) != block.nbytes:
            raise ValueError(f"{len(decoded)} bytes in a chunk of {block.nbytes}")
        into[...] = block[: into.shape[0], : into.shape[1]]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportHistory:
    """Origin of an export, which travels with every file as one line of JSON.

    Attributes
    ----------
    planish : str
        Version that made the run.
    exported_by : str
        Version that exports it.
    study_sha256 : str
        SHA-256 of ``run.toml``.
    inputs : tuple of dict
        Of each layer its name, the name of its file, and the file's SHA-256.
    """

    planish: str
    exported_by: str
    study_sha256: str
    inputs: tuple[Mapping[str, Any], ...]

    def json(self, **more: Any) -> str:
        """Return it as JSON, with what else is to be known of a file: one line of ASCII, always the same."""
        history = {
            "planish": self.planish, "exported_by": self.exported_by, "study_sha256": self.study_sha256,
            "inputs": [dict(layer) for layer in self.inputs], **more,
        }  # fmt: skip
        return json.dumps(history, allow_nan=False)

    @property
    def program(self) -> str:
        """Program and version, for fields that name the software."""
        return f"planish {self.exported_by}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Maps:
    """Maps (rows, cols) on one regular grid, which may stay in their store.

    Attributes
    ----------
    data : Dataset, dims (y, x) or (v, u)
        Variables with ``units`` and ``long_name``; coordinates in um. NaN is missing.
    group : str
        Name of the group in the run.
    scales : dict of Scale
        Limits and colours with which maps are shown, by name, where they are chosen.
    levels : dict of sequences of Path
        Folders of the arrays in a zarr store that hold a map and its overviews, the finest first, by name, where they
        are there.
    """

    data: xr.Dataset
    group: str
    scales: Mapping[str, Scale] = field(default_factory=dict[str, Scale])
    levels: Mapping[str, Sequence[Path]] = field(default_factory=dict[str, Sequence[Path]])

    @property
    def names(self) -> list[str]:
        """Names of the maps."""
        return [str(name) for name in self.data.data_vars]

    @property
    def dims(self) -> tuple[str, str]:
        """Names of rows and columns: (y, x), or (v, u) of the flat sheet."""
        return ("v", "u") if "v" in self.data.dims else ("y", "x")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, cols = self.dims
        return self.data.sizes[rows], self.data.sizes[cols]

    @property
    def at_um(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places of the middles of rows and of columns."""
        rows, cols = self.dims
        return self.data[rows].values, self.data[cols].values

    @property
    def pixel_um(self) -> tuple[float, float]:
        """Pitch of rows and columns, without the rounding of their coordinates; SizeError where there is none."""
        if min(self.shape) < 2:
            raise SizeError(f"The maps have {self.shape[0]} x {self.shape[1]} pixels; 2 x 2 are needed for a size.")
        return tuple(_exact((um[-1] - um[0]) / (um.size - 1)) for um in self.at_um)  # type: ignore[return-value]

    @property
    def origin_um(self) -> tuple[float, float]:
        """Middle of the first pixel: (y, x)."""
        return tuple(_exact(um[0]) for um in self.at_um)  # type: ignore[return-value]

    def facts(self) -> dict[str, Any]:
        """Group, pixel size and place, for the history."""
        return {
            "group": self.group, "axes": "".join(self.dims), "pixel_um": list(self.pixel_um),
            "first_pixel_um": list(self.origin_um), "missing": "NaN",
        }  # fmt: skip

    @property
    def titles(self) -> dict[str, str]:
        """Titles of the maps, by name."""
        return {name: str(self.data[name].attrs.get("long_name", name)) for name in self.names}

    @property
    def units(self) -> dict[str, str]:
        """Units of the maps, by name."""
        return {name: units_of(self.data[name]) for name in self.names}

    def only(self, name: str) -> Maps:
        """Take a single map."""
        return replace(self, data=self.data[[name]])

    def bands(
        self, name: str, dtype: np.dtype[Any] | type[np.generic] | None = None
    ) -> Iterator[tuple[slice, NDArray[Any]]]:
        """Give a map band by band; one is read while the other is worked on.

        ``dtype``: type of the values; the map's own where not given, truth values as bytes.
        """
        variable, levels = self.data[name], self.levels.get(name)
        target = plain_type(variable.dtype) if dtype is None else np.dtype(dtype)
        chunks = Chunks.of(levels[0], self.shape, variable.dtype) if levels else None

        def read(rows: slice) -> NDArray[Any]:
            return np.ascontiguousarray(band_of(variable, rows), dtype=target)

        def start(rows: slice) -> Callable[[], NDArray[Any]]:
            if chunks is None:
                return pool.submit(read, rows).result
            of_chunks = chunks.start(rows, target, pool)

            def wait() -> NDArray[Any]:
                try:
                    return of_chunks()
                except (OSError, RuntimeError, ValueError):
                    return read(rows)  # says what is wrong with the store

            return wait

        parts = list(bands(self.shape[0]))
        with thread_pool() as pool:
            wait = None
            for rows, following in zip(parts, [*parts[1:], None], strict=True):
                band = (wait or start(rows))()
                wait = None if following is None else start(following)
                yield rows, band


def percentile_limits(pixels: NDArray[np.float32]) -> tuple[float, float]:
    """1st and 99th percentile of a map, between which it is shown first; 0 to 1 where it has no value."""
    measured = pixels[np.isfinite(pixels)].astype(np.float64)
    low, high = (float(v) for v in np.percentile(measured, (1.0, 99.0))) if measured.size else (0.0, 1.0)
    return low, high if high > low else low + 1.0


def plain_type(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Type in which values are written: truth values become bytes of 0 and 1."""
    return np.dtype(np.uint8) if dtype.kind == "b" else dtype


def units_of(variable: xr.DataArray) -> str:
    """Unit of a map; 1 where it has none."""
    return str(variable.attrs.get("units", "1"))


def column_of(name: str, units: str) -> str:
    """Name of a column or property with its unit: ``coating_top_um``; no unit for plain numbers."""
    word = units.replace("/", "_per_").replace("%", "percent")
    return name if units in ("", "1") or name.endswith(f"_{word}") else f"{name}_{word}"


def _exact(length_um: float) -> float:
    return float(f"{length_um:.12g}")  # sums of multiples of a pixel size have no more digits
