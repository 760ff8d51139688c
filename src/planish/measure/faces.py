"""The six properties of the faces along the true 3D normals of the centre surface (Hirn et al. 2009, section 2.2)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotMeasure, SurfaceError
from planish.core.status import Status, status_flags

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

PROPERTIES = {
    "coating_top": "Coating thickness, top side",
    "coating_bottom": "Coating thickness, bottom side",
    "base_thickness": "Base thickness",
    "thickness": "Sheet thickness",
    "topography_top": "Topography, top side",
    "topography_bottom": "Topography, bottom side",
}


def measure_faces(surfaces: xr.Dataset) -> xr.Dataset:
    """Measure thicknesses and topographies; see :func:`planish.measure.measure_properties`.

    Raises
    ------
    SurfaceError
        If a surface is missing or the top lies below the bottom.
    CannotMeasure
        If no normal meets both faces.
    """
    import xarray as xr

    from planish.core.frame import Frame
    from planish.core.grid import pitch
    from planish.measure._kernels import along_normals

    needed = ("top", "bottom", "interface_top", "interface_bottom", "centre", "status")
    missing = [name for name in needed if name not in surfaces]
    if missing:
        raise SurfaceError(f"The surfaces lack {', '.join(missing)}. Make them with 'planish surface'.")
    up = Frame.of(surfaces).sign
    below = int(np.count_nonzero(up * (surfaces["top"].values - surfaces["bottom"].values) < 0))
    if below:
        raise SurfaceError(f"The top lies below the bottom at {below} points. Check --top.")
    heights = {name: up * surfaces[name].values for name in needed[:-1]}
    step = pitch(surfaces)
    normals = unit_normals(heights["centre"], step)
    distance = {
        name: along_normals(heights[name], heights["centre"], *normals, *step, 0)
        if np.isfinite(heights[name]).any()
        else np.full(heights["centre"].shape, np.nan)
        for name in needed[:-2]
    }
    inner_top = distance["interface_top"] if np.isfinite(heights["interface_top"]).any() else distance["top"]
    inner_bottom = (
        distance["interface_bottom"] if np.isfinite(heights["interface_bottom"]).any() else distance["bottom"]
    )
    values = {
        "coating_top": distance["top"] - distance["interface_top"],
        "coating_bottom": distance["interface_bottom"] - distance["bottom"],
        "base_thickness": inner_top - inner_bottom,
        "thickness": distance["top"] - distance["bottom"],
        "topography_top": distance["top"],
        "topography_bottom": -distance["bottom"],
    }
    status = surfaces["status"].values.copy()
    # A column counts as measured when everything that the sheet has was measured there.
    whole = np.isfinite(values["thickness"])
    for name in ("coating_top", "coating_bottom"):
        if np.isfinite(values[name]).any():
            whole &= np.isfinite(values[name])
    status[(status == 0) & ~whole] = Status.NORMAL_LEAVES_SHEET
    valid = status == 0
    if not valid.any():
        raise CannotMeasure(
            "No normal of the centre surface meets both faces. Look at the surfaces with 'planish surface'."
        )
    data = {
        name: (
            ("y", "x"),
            np.where(valid, v, np.nan),
            {"units": "um", "long_name": PROPERTIES[name], "role": "property"},
        )
        for name, v in values.items()
    }
    return xr.Dataset(
        {**data, "status": (("y", "x"), status, status_flags())}, coords=surfaces.coords, attrs=dict(surfaces.attrs)
    )


def unit_normals(height: Array, pitch: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Return unit normals (rows, cols, height) of a height field, pointing up; NaN beside missing nodes."""
    along_rows, along_cols = (np.gradient(height, p, axis=i) for i, p in enumerate(pitch))
    length = np.sqrt(1 + along_rows**2 + along_cols**2)
    return -along_rows / length, -along_cols / length, 1 / length
