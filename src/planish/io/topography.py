"""Height maps of optical and stylus instruments, in the formats that SurfaceTopography reads."""

import gc
import math
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from planish.core.errors import FileError, SizeError
from planish.core.labelled import labelled
from planish.core.typing import Pair
from planish.core.units import unit_um
from planish.io.formats import extra
from planish.io.guard import check_memory, quiet, reading, size_of_file
from planish.io.sizes import PIXEL, Stated, agreed_size, size_attrs
from planish.io.tiff import size_words


def _unit_length(unit: Any, path: Path) -> float:
    """Length in um of the unit of heights, which has to be stated."""
    unit_length = unit_um(str(unit or ""))
    if unit_length is None:
        fault_text = f"in {unit!r}, which is no unit of length" if unit else "without a unit"
        raise SizeError(
            f"{path.name} has heights {fault_text}. Export it in a format that states one: X3P or"
            " SUR."
        )
    return unit_length


def read_topography(
    path: str | Path,
    *,
    pixel_um: float | Pair | None = None,
    override_size: bool = False,
    unusual_size: bool = False,
    memory_bytes: int | None = None,
) -> xr.DataArray:
    """Read a map of heights.

    Parameters
    ----------
    path : path; SUR, X3P, SDF, GWY, OPD, PLUx and the like
    pixel_um : float or (y, x), optional; pixel size in um; not needed where the file states it
    override_size, unusual_size, memory_bytes
        As for :func:`planish.read_image`.

    Returns
    -------
    DataArray, dims (y, x), float64
        Heights in um, NaN where they are missing; rows in the order of the file. Coordinates in um,
        pixel i has its centre at i × size. Attributes: ``units``, ``long_name``, ``pixel_um`` (y,
        x), ``pixel_um_source``, ``file_format``, ``file_name``, ``file_bytes``.

    Raises
    ------
    FileError
        If the file is damaged or of another format, holds no map, or SurfaceTopography is not
        installed.
    SizeError
        If the unit of the heights or the pixel size is missing, contradictory or impossible.
    ResourceError
        If it does not fit into the memory.
    """
    path = Path(path)
    file_bytes = size_of_file(path)
    library: Any = extra("SurfaceTopography", path)
    with quiet, ExitStack() as stack:
        with reading(path):
            reader: Any = library.open_topography(str(path))
            if hasattr(reader, "__exit__"):
                stack.enter_context(reader)
            channel: Any = reader.default_channel
            grid_shape = tuple(map(int, channel.nb_grid_pts))
        if len(grid_shape) != 2:
            raise FileError(
                f"{path.name} holds a profile of {size_words(grid_shape)} points, not a map. Give a"
                " map of heights."
            )
        needed_bytes = 3 * 8 * math.prod(grid_shape)  # the library's heights, and two copies
        check_memory(path, needed_bytes=needed_bytes, limit_bytes=memory_bytes)
        unit_length = _unit_length(channel.unit, path)
        # Sides of the map along x and y, in the unit of its heights.
        physical_sizes: Any = channel.physical_sizes or (None, None)
        stated: list[Stated] = []
        if None not in physical_sizes:
            sides = zip(physical_sizes, grid_shape, strict=True)
            x, y = (float(side) / n * unit_length for side, n in sides)
            stated = [Stated("the topography file", (y, x))]
        size, source = agreed_size(
            stated,
            pixel_um,
            file_name=path.name,
            asked=PIXEL,
            override=override_size,
            unusual=unusual_size,
        )
        y, x = size
        physical_sizes = (x * grid_shape[0] / unit_length, y * grid_shape[1] / unit_length)
        size_arguments: Any = {} if stated else {"physical_sizes": physical_sizes}
        with reading(path):
            stored_heights = reader.topography(**size_arguments).heights()
            heights = np.ma.asarray(stored_heights).astype(np.float64)
            file_format = ""
            if callable(getattr(reader, "format", None)):
                file_format = str(reader.format())
    with quiet:
        # Some readers map the file and complain when they are thrown away, which would be at any
        # time later.
        del reader, channel
        gc.collect()
    # The library has x first, as the sheet of a drawing; images have rows first.
    values = np.ascontiguousarray(np.ma.filled(heights, np.nan).T) * unit_length
    values[~np.isfinite(values)] = np.nan
    if not np.isfinite(values).any():
        raise FileError(f"{path.name} has no height in it, all are missing. Export it again.")
    attrs = {
        "units": "um",
        "long_name": "Height",
        **size_attrs(PIXEL, size, source, stated),
        "file_format": file_format,
        "file_name": path.name,
        "file_bytes": file_bytes,
    }
    return labelled(values, PIXEL.axes, size, name="topography", attrs=attrs)
