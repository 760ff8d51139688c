"""Properties of the sheet along the true 3D normals of its centre surface (Hirn et al. 2009, section 2.2)."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import CannotMeasure, SurfaceError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.measure._kernels import along_normals

Array = NDArray[np.float64]

STATUS = (
    "measured", "no_sheet", "rim", "face_not_found", "normal_leaves_sheet", "touching", "leaves_volume", "particle",
)  # fmt: skip
"""Why a column has no value, by the number in ``status``."""

PROPERTIES = {
    "coating_top": "Coating thickness, top side",
    "coating_bottom": "Coating thickness, bottom side",
    "base_thickness": "Base thickness",
    "thickness": "Sheet thickness",
    "topography_top": "Topography, top side",
    "topography_bottom": "Topography, bottom side",
}


def measure_properties(surfaces: xr.Dataset) -> xr.Dataset:
    """Measure thicknesses and topographies along the normals of the centre surface.

    Parameters
    ----------
    surfaces : Dataset, dims (y, x), heights in um
        ``top``, ``bottom``, ``interface_top``, ``interface_bottom``, ``centre`` and ``status``, as
        :func:`planish.surface.find_surfaces` returns them.

    Returns
    -------
    Dataset, dims (y, x), in um
        ``coating_top``, ``coating_bottom``: outer face to interface; NaN on a side without a coating.
        ``base_thickness``: interface to interface (a face where that side has no coating). ``thickness``: face to
        face. ``topography_top``, ``topography_bottom``: from the centre surface to the face, positive outwards.
        ``status``: that of the surfaces, and 4 where a normal leaves the sheet. All are NaN where it is not 0.

    Raises
    ------
    SurfaceError
        If a surface is missing or the top lies below the bottom.
    CannotMeasure
        If no normal meets both faces.

    Notes
    -----
    On a face tilted by ``a`` a vertical thickness is too large by 1 / cos a; a normal within the slice only, as the
    paper's, is too large by 1 / cos of the tilt across the slices.
    """
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
    status[(status == 0) & ~whole] = 4
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
    flags = {"long_name": "Status", "flag_values": [*range(len(STATUS))], "flag_meanings": " ".join(STATUS)}
    return xr.Dataset(
        {**data, "status": (("y", "x"), status, flags)}, coords=surfaces.coords, attrs=dict(surfaces.attrs)
    )


def unit_normals(height: Array, pitch: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Return unit normals (rows, cols, height) of a height field, pointing up; NaN beside missing nodes."""
    along_rows, along_cols = (np.gradient(height, p, axis=i) for i, p in enumerate(pitch))
    length = np.sqrt(1 + along_rows**2 + along_cols**2)
    return -along_rows / length, -along_cols / length, 1 / length
