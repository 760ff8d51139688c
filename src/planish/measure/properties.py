"""The step of a run: the six properties of the faces (Hirn et al. 2009, section 2.2), and all further maps."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.arrays import check_dataset, check_volume
from planish.core.errors import CannotMeasure, InputError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.options import params_of
from planish.core.status import Status, status_flags
from planish.core.tiles import Engine
from planish.core.typing import Floats
from planish.measure.along_rays import measure_along_rays
from planish.measure.greys import Greys
from planish.measure.params import MeasureParams
from planish.measure.ray_frame import meet
from planish.measure.registry import PROPERTIES, SIDES, Side, chosen
from planish.measure.uncertainty import Shared, common_errors, thickness_errors

THICKNESSES = ("coating_top", "coating_bottom", "base_thickness", "thickness")
_OF_BOTH = ("base_thickness", "thickness")


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
        If further maps of labels are asked for, or further maps without the volume; if the volume or the surfaces are
        something else.

    Notes
    -----
    On a face tilted by ``a`` a vertical thickness is too large by 1 / cos a; a normal within the slice only, as the
    paper's, is too large by 1 / cos of the tilt across the slices.
    """
    params = params_of(MeasureParams, params, "pl.measure_properties")
    check_dataset(surfaces, what="surfaces", maker="pl.find_surfaces(volume)", call="pl.measure_properties({})")
    if volume is not None:
        check_volume(volume, "pl.measure_properties(surfaces, volume={})")
    elif params.maps:
        raise InputError(
            f"--property {', '.join(params.maps)}: measured in the volume, which is not given. Give it with --volume, "
            "or leave them out."
        )
    faces = _measure_faces(surfaces)
    measured = surfaces.drop_vars("status", errors="ignore").merge(faces, combine_attrs="override")
    if "from_labels" in surfaces.attrs:
        if params.maps:
            raise InputError(
                "Further maps are measured in grey values; a volume of labels has none. Leave --property out."
            )
        return _with_errors(measured)
    if volume is None:
        return _with_errors(measured)
    names = [name for name in chosen(params, Greys.of(surfaces)) if name not in PROPERTIES]
    if not names:
        return _with_errors(measured)
    further = measure_along_rays(volume, measured, names=names, params=params, engine=engine)
    measured = measured.merge(further.drop_vars("status"), compat="override", combine_attrs="override")
    return _with_errors(measured, float(further.attrs["ray_noise_um"]))


def surfaces_of(measured: xr.Dataset) -> xr.Dataset:
    """The surfaces that :func:`measure_properties` was given, of what it gave."""
    names = {*PROPERTIES, *further_maps(measured)}
    names |= {name for name in measured.data_vars if str(name).removesuffix("_se") in names}
    surfaces = measured.drop_vars(names)
    status = surfaces["status"]
    status_before = np.where(status.values == Status.NORMAL_LEAVES_SHEET, 0, status.values).astype(status.dtype)
    return surfaces.assign(status=status.copy(data=status_before))


def further_maps(measured: xr.Dataset) -> list[str]:
    """Names of the maps in a dataset beside the six of the faces, and of their standard errors where there are any."""
    maps = [str(name) for name, variable in measured.data_vars.items() if "support_um" in variable.attrs]
    errors = [f"{name}_se" for name in maps if f"{name}_se" in measured]
    return maps + [name for name in errors if np.isfinite(measured[name].values).any()]


def _with_errors(measured: xr.Dataset, noise_um: float = float("nan")) -> xr.Dataset:
    """Add the standard error of each thickness; nothing where the surfaces do not say how they were found.

    ``noise_um``: as from :func:`planish.measure.uncertainty.ray_noise`; NaN for white noise.
    """
    attrs, frame, steps = measured.attrs, Frame.of(measured), pitch(measured)
    if "voxel_um" not in attrs:
        return measured
    voxel = dict(zip("zyx", map(float, attrs["voxel_um"]), strict=True))
    through = voxel[frame.through]
    if "from_labels" in attrs:
        # A face lies anywhere within a voxel: the difference of two has the variance of two uniform distributions.
        common, patch = common_errors(through), steps[0] * steps[1]
        errors: dict[str, Floats] = {
            name: np.full(measured[name].shape, np.hypot(through / np.sqrt(6), common[name])) for name in THICKNESSES
        }
    elif "grey_noise" in attrs:
        greys = Greys.of(measured)
        wide = float(np.sqrt(steps[0] * steps[1] / (voxel[frame.rows] * voxel[frame.cols])))
        shared = Shared.of(greys, voxel_um=through, pitch_um=steps, wide=wide, noise_um=noise_um)
        slopes = np.gradient(measured["centre"].values, *steps)
        layers: dict[Side, Floats] = {side: measured[f"coating_{side}"].values for side in SIDES}
        errors = thickness_errors(layers, greys, shared, cosine=1 / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2))
        if attrs.get("method") == "paper":
            # A crossing of half the step uses one place of the edge, a fit all of it.
            crossing = np.sqrt(max(1.0, np.sqrt(np.pi) * greys.blur_um / through))
            errors = {name: se * crossing for name, se in errors.items()}
        common, patch = dict(shared.common_um), shared.patch_um2
    else:
        return measured
    for side in SIDES:
        if (drawn := measured.get(f"correction_{side}_error")) is not None:
            more_um = np.nan_to_num(drawn.values.astype(np.float64))
            errors |= {name: np.hypot(errors[name], more_um) for name in (f"coating_{side}", *_OF_BOTH)}
    more: dict[str, tuple[tuple[str, str], NDArray[np.float32], dict[str, object]]] = {}
    for name in THICKNESSES:
        title = f"Standard error of {PROPERTIES[name][0].lower()}{PROPERTIES[name][1:]}"
        about: dict[str, object] = {"units": "um", "long_name": title, "common_um": common[name], "patch_um2": patch}
        se = np.where(np.isfinite(measured[name].values), errors[name], np.nan).astype(np.float32)
        if np.isfinite(se).any():
            more[f"{name}_se"] = (("y", "x"), se, about)
    return measured.assign(more)


def _measure_faces(surfaces: xr.Dataset) -> xr.Dataset:
    """Thicknesses and topographies along the true 3D normals of the centre surface."""
    met = meet(surfaces, "normal")
    place = met.faces
    lengths = {
        "coating_top": place["top"] - place["interface_top"],
        "coating_bottom": place["interface_bottom"] - place["bottom"],
        "base_thickness": place["interface_top"] - place["interface_bottom"],
        "thickness": place["top"] - place["bottom"],
        "topography_top": place["top"],
        "topography_bottom": -place["bottom"],
    }
    status = surfaces["status"].values.copy()
    # A column counts as measured when everything that the sheet has was measured there.
    whole = np.isfinite(lengths["thickness"])
    for side, coated in met.coated.items():
        if not coated:
            lengths[f"coating_{side}"] = np.full(whole.shape, np.nan)
        elif np.isfinite(lengths[f"coating_{side}"]).any():
            whole &= np.isfinite(lengths[f"coating_{side}"])
    status[(status == 0) & ~whole] = Status.NORMAL_LEAVES_SHEET
    valid = status == 0
    if not valid.any():
        raise CannotMeasure(
            "No normal of the centre surface meets both faces. Look at the surfaces with 'planish surface'."
        )
    dims = ("y", "x")
    variables: dict[str, tuple[tuple[str, str], Floats, dict[str, object]]] = {
        name: (dims, np.where(valid, um, np.nan), {"units": "um", "long_name": PROPERTIES[name], "role": "property"})
        for name, um in lengths.items()
    }
    measured = xr.Dataset(variables, coords=surfaces.coords, attrs=dict(surfaces.attrs))
    return measured.assign(status=(dims, status, status_flags()))
