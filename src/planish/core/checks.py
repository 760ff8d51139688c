"""Checks of what a stage is given: what was found, what is needed, what to do next."""

from __future__ import annotations

import numpy as np
import xarray as xr

from planish.core.errors import SurfaceError


def check_same_grid(first: xr.Dataset, second: xr.Dataset) -> None:
    """Raise SurfaceError unless both datasets stand on the same columns of the same volume."""
    for axis in ("y", "x"):
        a, b = first[axis].values, second[axis].values
        if a.shape != b.shape or not np.allclose(a, b, rtol=0, atol=1e-6):
            raise SurfaceError(
                f"The two stores stand on different columns: {a.size} and {b.size} along {axis}. Make both from the "
                "same surfaces."
            )


def is_property(data: xr.DataArray) -> bool:
    """Whether a map is a measured property; standard errors, places and masks are none."""
    attrs = data.attrs
    return attrs.get("role") == "property" or ("support_um" in attrs and not str(data.name).endswith("_se"))
