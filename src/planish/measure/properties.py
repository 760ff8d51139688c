"""The step of a run: the six properties of the faces, all further maps, and the numbers that are no maps."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import xarray as xr

from planish.core.errors import CannotMeasure, InputError
from planish.core.grid import pitch
from planish.core.results import ProfileFacts, RoughnessFacts, SheetNumbers, ThinFacts, TwoSidesFacts
from planish.core.tiles import Engine
from planish.measure.along_rays import measure_along_rays
from planish.measure.coverage import thin_fraction
from planish.measure.faces import PROPERTIES, measure_faces
from planish.measure.greys import Greys
from planish.measure.params import MeasureParams
from planish.measure.profiles import depth_profiles
from planish.measure.registry import SIDES, Side, chosen
from planish.measure.topography import roughness_numbers, scale_limited
from planish.measure.two_sides import two_sidedness


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
    found = surfaces.drop_vars("status", errors="ignore").merge(measure_faces(surfaces), combine_attrs="override")
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


def sheet_numbers(
    measured: xr.Dataset,
    *,
    volume: xr.DataArray | None = None,
    params: MeasureParams | None = None,
    engine: Engine | None = None,
) -> SheetNumbers:
    """Describe a sheet in numbers: thin and bare shares, roughness, two-sidedness, and profiles in depth.

    Parameters
    ----------
    measured : Dataset
        From :func:`measure_properties`.
    volume : DataArray
        Needed for the profiles of porosity and filler, which are made where their maps were measured.
    params, engine
    """
    params = params or MeasureParams()
    profiled = [name for name in ("porosity", "filler") if name in measured]
    profiles = None
    if profiled and volume is not None:
        found = depth_profiles(volume, measured, names=profiled, params=params, engine=engine)
        values: dict[str, tuple[float | None, ...]] = {
            name: tuple(float(v) for v in found[name].values) for name in profiled
        }
        profiles = ProfileFacts(depth=tuple(float(v) for v in found["depth"].values), values=values)
    thin: dict[Side, ThinFacts] = {}
    for side in SIDES:
        if (facts := _thin(measured, side)) is not None:
            thin[side] = facts
    return SheetNumbers(
        thin=thin,
        roughness={side: _roughness(measured, params, side) for side in SIDES},
        two_sides=TwoSidesFacts.model_validate(two_sidedness(measured)),
        profiles=profiles,
    )


def _thin(measured: xr.Dataset, side: Side) -> ThinFacts | None:
    """Shares of thin coating; None on a side without one."""
    coating = measured[f"coating_{side}"]
    if not np.isfinite(coating.values).any():
        return None
    support = float(np.sqrt(np.prod(pitch(measured))))
    found = thin_fraction(coating.assign_attrs(support_um=support))
    return ThinFacts(
        thinner_than_um=tuple(float(v) for v in found["marked"].values),
        share=tuple(float(v) for v in found["marked_share"].values),
        support_um=support,
        warning=found.attrs.get("warning"),
    )


def _roughness(measured: xr.Dataset, params: MeasureParams, side: Side) -> RoughnessFacts:
    """Roughness numbers; a field smaller than the filters has none, which is reported and is no fault of the run."""
    filters = {"s_filter_um": params.s_filter_um, "l_filter_um": params.l_filter_um}
    try:
        limited = scale_limited(measured[f"topography_{side}"].values, pitch(measured), **filters)
        return RoughnessFacts(**asdict(roughness_numbers(limited, pitch(measured), **filters)))
    except CannotMeasure as reason:
        return RoughnessFacts(reason=str(reason))
