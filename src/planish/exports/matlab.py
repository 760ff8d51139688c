"""Write MATLAB files of version 5 by scipy and of version 7.3 by h5py.

Version 7.3 is an HDF5 file with MATLAB's classes and its order of axes.
"""

import math
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy import io

from planish.core.errors import ResourceError
from planish.core.memory import WHOLE_BYTES
from planish.core.threads import thread_pool
from planish.core.typing import Array, Entries, Shape2D
from planish.exports.content import ExportHistory, Maps
from planish.exports.formats import ExportParams

MOST_5 = 2**31 - 2**20
"""Bytes that the maps of a file of version 5 may take together."""

_CHUNK = 512  # pixels along the edge of a chunk: as high as a band, so that each is written once
_HEAD = 512  # bytes before an HDF5 file of MATLAB
_TEXT = 116  # bytes of free text in front of both versions; without the usual date


def write(maps: Maps, path: Path, history: ExportHistory, params: ExportParams) -> None:
    """Write a variable for each map, and what it needs to be read.

    ``x_um`` and ``y_um`` (rows; ``u_um`` and ``v_um`` of flat maps) are the middles of the pixels,
    ``pixel_um`` their size (y, x), ``units`` and ``titles`` structures with the maps' names,
    ``history`` a text. Maps are (rows, columns); truth values are logical. ResourceError where
    version 5 was asked for, and the maps take 2 GB or more.
    """
    rows_um, cols_um = maps.at_um
    metadata: Entries = {
        f"{maps.dims[0]}_um": rows_um[None],
        f"{maps.dims[1]}_um": cols_um[None],
        "pixel_um": np.array([maps.pixel_um]),
        "units": maps.units,
        "titles": maps.titles,
        "history": history.json(**maps.facts()),
    }
    version = chosen_version(maps, params)
    if version == "5":
        pixels = {name: maps.whole(name, maps.data[name].dtype) for name in maps.names}
        io.savemat(
            str(path),
            pixels | metadata,
            appendmat=False,
            format="5",
            oned_as="row",
            long_field_names=True,
        )
        version = "5.0"
        header_end = b""
    else:
        with h5py.File(path, "w", userblock_size=_HEAD, libver="earliest") as file:
            for name in maps.names:
                _put_map(file, maps, name)
            for name, variable in metadata.items():
                _put(file, name, variable)
        header_end = (b"\0" * 8 + b"\x00\x02IM").ljust(_HEAD - _TEXT, b"\0")
    title = f"MATLAB {version} MAT-file, written by {history.program}"
    header_start = title.encode("ascii").ljust(_TEXT)[:_TEXT]
    with path.open("rb+") as file:
        file.write(header_start + header_end)


def chosen_version(maps: Maps, params: ExportParams) -> str:
    """Choose the version in which maps are written.

    ResourceError where the one that was asked for cannot hold them.
    """
    pixel_bytes = sum(maps.dtype_of(name).itemsize for name in maps.names)  # of all maps together
    maps_bytes = pixel_bytes * math.prod(maps.shape)
    if params.mat_version == "5" and maps_bytes > MOST_5:
        raise ResourceError(
            f"The maps take {maps_bytes / 1e9:.1f} GB, and a MATLAB file of version 5 holds 2 GB."
            " Leave out `mat_version`, choose fewer maps with `map`, or give a folder for a file"
            " each."
        )
    usual_version = "5"
    if maps_bytes > WHOLE_BYTES:
        usual_version = "7.3"
    return params.mat_version or usual_version


def _put_map(file: h5py.File, maps: Maps, name: str) -> None:
    """Write a map chunk by chunk, turned: MATLAB's first index runs fastest."""
    dtype = maps.dtype_of(name)
    rows, cols = maps.shape
    # As many columns in each chunk: what reaches beyond the map is written, too.
    n_chunks = math.ceil(cols / _CHUNK)
    chunk = (math.ceil(cols / n_chunks), min(_CHUNK, rows))  # columns, rows
    dataset = file.create_dataset(
        name, shape=(cols, rows), dtype=dtype, chunks=chunk, fill_time="never"
    )
    first_cols = range(0, cols, chunk[0])
    with thread_pool() as pool:
        for rows_of_band, band in maps.bands(name):
            # The chunks of a band are cut out on several threads and written in their order.
            blocks = pool.map(partial(_turned, band, chunk), first_cols)
            for first_col, block in zip(first_cols, blocks, strict=True):
                dataset.id.write_direct_chunk((first_col, rows_of_band.start), block.data)
    if maps.data[name].dtype.kind == "b":
        _set_class(dataset, "logical", int_decode=1)
    else:
        matlab_names = {"float32": "single", "float64": "double"}
        _set_class(dataset, matlab_names.get(dtype.name, dtype.name))


def _turned(band: Array, chunk: Shape2D, first_col: int) -> Array:
    """A chunk of a band (rows, cols) as (cols, rows), with zeros beyond the map."""
    columns = band[:, first_col : first_col + chunk[0]].T
    chunk_values = np.zeros(chunk, band.dtype)
    chunk_values[: columns.shape[0], : columns.shape[1]] = columns
    return chunk_values


def _put(group: h5py.Group, name: str, variable: Any) -> None:
    """Write what is no map: a dict as structure, a text, or numbers, turned as maps are."""
    if isinstance(variable, dict):
        struct = group.create_group(name)
        struct.attrs["MATLAB_class"] = np.bytes_("struct")
        for field, text in variable.items():
            _put(struct, field, text)
    elif isinstance(variable, str):
        utf16 = np.frombuffer(variable.encode("utf-16-le"), dtype="<u2")
        characters = group.create_dataset(name, data=utf16[:, None])
        _set_class(characters, "char", int_decode=2)
    else:
        numbers = np.asarray(variable, dtype=np.float64).T
        _set_class(group.create_dataset(name, data=numbers), "double")


def _set_class(dataset: h5py.Dataset, name: str, *, int_decode: int | None = None) -> None:
    dataset.attrs["MATLAB_class"] = np.bytes_(name)
    if int_decode is not None:
        dataset.attrs["MATLAB_int_decode"] = np.int32(int_decode)
