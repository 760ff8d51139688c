"""Places between the flat map, the volume and its pixels."""

from __future__ import annotations

import numpy as np
import xarray as xr

from planish.core.errors import MarkError
from planish.core.frame import Frame
from planish.core.grid import values_at
from planish.pipeline.run import Array


def in_flat(given: xr.Dataset, flat: xr.Dataset, surfaces: xr.Dataset) -> Array:
    """Given marks (n, 2) in the flat map: as they are, or from the volume by the column they lie in."""
    if "moving_x" in given:
        return np.stack([given["moving_x"].values, given["moving_y"].values], axis=1)
    frame = Frame.of(surfaces)
    columns = np.stack([given[f"volume_{axis}"].values for axis in (frame.cols, frame.rows)], axis=1)
    moving = values_at(flat, ("u", "v"), columns)
    lost = [str(n) for n, p in zip(given["label"].values, moving, strict=True) if not np.isfinite(p).all()]
    if lost:
        raise MarkError(
            f"The marks {', '.join(lost)} do not lie on the sheet. Check the axes and the unit (um) of the table."
        )
    return moving


def at_flat(maps: xr.Dataset, names: tuple[str, str], points: Array) -> Array:
    """Values of two maps at points (n, 2) of the flat sheet."""
    found = values_at(maps, names, points)
    if not np.isfinite(found).all():
        raise MarkError("A mark lies outside the flattened sheet. Remove it from the table of marks.")
    return found
