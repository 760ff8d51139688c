"""The step of a run: the six properties of the faces (Hirn et al. 2009, section 2.2), and all further maps."""

from __future__ import annotations

import numpy as np
import xarray as xr

from planish.core.errors import CannotMeasure, InputError
from planish.core.status import Status, status_flags
from planish.core.tiles import Engine
from planish.measure.along_rays import measure_along_rays
from planish.measure.greys import Greys
from planish.measure.params import MeasureParams
from planish.measure.ray_frame import meet
from planish.measure.registry import PROPERTIES, chosen


def measure_properties(
    surfaces: xr.Dataset,
    *,
    volume: xr.DataArray | None = None,
    params: MeasureParams | None = None,
    engine: Engine | None = None,
) -> xr.Dataset:
    """Measure the properties of a sheet along the normals of its centre surface.

    Parameters
    ----------
    surfaces : Dataset, dims (y, x), heights in um
        ``top``, ``bottom``, ``interface_top``, ``interface_bottom``, ``centre`` and ``status``, as
        :func:`planish.surface.find_surfaces` returns them.
    volume : DataArray, dims (z, y, x), coordinates in um
        Where they were found. Without it the six properties of the faces are measured, with it all further maps too:
        those that cost nothing, those whose numbers are given in ``params``, and those that ``params.maps`` names.
    params : MeasureParams
    engine : Engine
        Threads and memory; no result depends on it.

    Returns
    -------
    Dataset, dims (y, x)
        The surfaces and beside them, in um: ``coating_top``, ``coating_bottom``: outer face to interface; NaN on a
        side without a coating. ``base_thickness``: interface to interface (a face where that side has no coating).
        ``thickness``: face to face. ``topography_top``, ``topography_bottom``: from the centre surface to the face,
        positive outwards. ``status``: that of the surfaces, and 4 where a normal does not meet both faces. All six are
        NaN where it is not 0. Further maps are as in :func:`measure_along_rays`.

    Raises
    ------
    SurfaceError
        If a surface is missing or the top lies below the bottom.
    CannotMeasure
        If no normal meets both faces, a map is unknown, or a map needs a number that is not given.
    InputError
        If further maps of labels are asked for.

    Notes
    -----
    On a face tilted by ``a`` a vertical thickness is too large by 1 / cos a; a normal within the slice only, as the
    paper's, is too large by 1 / cos of the tilt across the slices.
    """
    params = params or MeasureParams()
    found = surfaces.drop_vars("status", errors="ignore").merge(_measure_faces(surfaces), combine_attrs="override")
    if "from_labels" in surfaces.attrs:
        if params.maps:
            raise InputError(
                "Further maps are measured in grey values; a volume of labels has none. Leave --property out."
            )
        return found
    if volume is None:
        return found
    names = [name for name in chosen(params, Greys.of(surfaces)) if name not in PROPERTIES]
    if not names:
        return found
    further = measure_along_rays(volume, found, names=names, params=params, engine=engine)
    return found.merge(further.drop_vars("status"), compat="override", combine_attrs="override")


def further_maps(measured: xr.Dataset) -> list[str]:
    """Names of the maps in a dataset beside the six of the faces, and of their standard errors where there are any."""
    maps = [str(name) for name, data in measured.data_vars.items() if "support_um" in data.attrs]
    errors = [f"{name}_se" for name in maps if f"{name}_se" in measured]
    return maps + [name for name in errors if np.isfinite(measured[name].values).any()]


def _measure_faces(surfaces: xr.Dataset) -> xr.Dataset:
    """Thicknesses and topographies along the true 3D normals of the centre surface."""
    met = meet(surfaces, "normal")
    place = met.faces
    values = {
        "coating_top": place["top"] - place["interface_top"],
        "coating_bottom": place["interface_bottom"] - place["bottom"],
        "base_thickness": place["interface_top"] - place["interface_bottom"],
        "thickness": place["top"] - place["bottom"],
        "topography_top": place["top"],
        "topography_bottom": -place["bottom"],
    }
    status = surfaces["status"].values.copy()
    # A column counts as measured when everything that the sheet has was measured there.
    whole = np.isfinite(values["thickness"])
    for side, coated in met.coated.items():
        if not coated:
            values[f"coating_{side}"] = np.full(whole.shape, np.nan)
        elif np.isfinite(values[f"coating_{side}"]).any():
            whole &= np.isfinite(values[f"coating_{side}"])
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
