"""The step of a run: the properties of the faces, and all further maps along rays.

What was taken from Hirn et al. (2009, section 2.2): coatings, base and topography along normals.

Further maps are worked out on row tiles on threads: the same bytes however they are cut.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import TypeVar

import numpy as np
import xarray as xr

from planish.core.arrays import check_dataset, check_volume
from planish.core.errors import CannotMeasure, InputError, ResourceError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.options import params_of
from planish.core.plugins import faults_named
from planish.core.status import FIRST_OWN, Status, status_flags
from planish.core.threads import count_threads, map_threads
from planish.core.tiles import Engine
from planish.core.typing import Bools, Codes, Floats, NamedFields, Shape
from planish.measure.form import F_OPERATOR, above_form
from planish.measure.greys import FWHM, Greys
from planish.measure.params import MeasureParams
from planish.measure.rays import CUTOFF_UM, RayFrame, Rays, meet, secant, slopes_of
from planish.measure.registry import (
    HEIGHTS,
    LENGTHS,
    OF_FACES,
    PROPERTIES,
    SIDES,
    Measured,
    Property,
    Sheet,
    Side,
    check_maps,
    chosen,
    face_length,
    find_property,
    in_order,
    length_of,
)
from planish.measure.uncertainty import SharedNoise, common_errors, ray_noise, thickness_errors

T = TypeVar("T")
#: Standard error of each thickness (rows, cols) and what averaging does not lessen of it, um, and
#: the area that one independent value stands for, um2.
Errors = tuple[NamedFields, dict[str, float], float]
_SEEN_THROUGH = 2.5  # widths of the blur: a thicker layer shows its own grey in its middle


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
        Where they were found. Without it the properties of the faces are measured, and
        ``half_thickness_*`` where ``params.maps`` names it; with it all further maps too: those
        that cost nothing, those whose numbers are given in ``params``, and those that
        ``params.maps`` names.
    params : MeasureParams
    engine : Engine
        Threads and memory; no result depends on it.

    Returns
    -------
    Dataset, dims (y, x)
        The surfaces and beside them, in um: ``coating_top``, ``coating_bottom``: outer face to
        interface; NaN on a side without a coating. ``base_thickness``: interface to interface (a
        face where that side has no coating). ``thickness``: face to face. ``topography_top``,
        ``topography_bottom``: outward height of the face above its own form, along the normal;
        ``form_um`` in their attributes is the nesting index of the form. ``base_surface_top``,
        ``base_surface_bottom``: the same of the interface; NaN on a side without a coating.
        ``status``: that of the surfaces, and 4 where a normal does not meet both faces. All of them
        are NaN where it is not 0. Further maps are as in :func:`measure_along_rays`.

    Raises
    ------
    SurfaceError
        If a surface is missing or the top lies below the bottom.
    CannotMeasure
        If no normal meets both faces, a map is unknown, or a map needs a number that is not given.
    InputError
        If further maps in grey values are asked for of labels, or without the volume; if the volume
        or the surfaces are something else.

    Notes
    -----
    On a face tilted by ``a`` a vertical thickness is too large by 1 / cos a; a normal within the
    slice only, as the paper's, is too large by 1 / cos of the tilt across the slices.
    """
    params = params_of(MeasureParams, params, "pl.measure_properties")
    check_dataset(
        surfaces,
        expected="surfaces",
        source="pl.find_surfaces(volume)",
        call_format="pl.measure_properties({})",
    )
    names_in_volume = [name for name in params.maps if name not in OF_FACES]
    if volume is not None:
        check_volume(volume, "pl.measure_properties(surfaces, volume={})")
    elif names_in_volume:
        raise InputError(
            f"`property={', '.join(names_in_volume)}`: measured in the volume, which is not given."
            " Give it with `volume`, or leave them out."
        )
    is_labels = "from_labels" in surfaces.attrs
    if is_labels:
        check_maps(params, labels=True)
    bare_surfaces = surfaces_of(surfaces)  # those of a run hold its maps
    if volume is None or is_labels:
        return _with_errors(_measure_faces(bare_surfaces, params, params.maps))
    measured = _measure_faces(bare_surfaces, params, ())
    names = [name for name in chosen(params, Greys.of(measured)) if name not in PROPERTIES]
    further = measure_along_rays(volume, measured, names=names, params=params, engine=engine)
    measured = measured.assign(further.drop_vars("status").data_vars)
    return _with_errors(measured, float(further.attrs["ray_noise_um"]))


def surfaces_of(measured: xr.Dataset) -> xr.Dataset:
    """The surfaces that :func:`measure_properties` was given, of what it gave."""
    maps = {*PROPERTIES, *OF_FACES, *further_maps(measured)}
    names = [name for name in measured.data_vars if re.sub("_(se|status)$", "", str(name)) in maps]
    status = measured["status"]
    left_sheet = status.values == Status.NORMAL_LEAVES_SHEET
    status_before = np.where(left_sheet, 0, status.values).astype(status.dtype)
    return measured.drop_vars(names).assign(status=status.copy(data=status_before))


def further_maps(measured: xr.Dataset) -> list[str]:
    """Return the names of the maps in a dataset beside those of the faces.

    Also returns the names of their standard errors, where there are any.
    """
    maps = [
        str(name) for name, variable in measured.data_vars.items() if "support_um" in variable.attrs
    ]
    errors = [f"{name}_se" for name in maps if f"{name}_se" in measured]
    return maps + [name for name in errors if measured[name].notnull().any()]


def _with_errors(measured: xr.Dataset, noise_um: float = np.nan) -> xr.Dataset:
    """Add the standard error of each thickness where it is known how the faces were found.

    As maps ``<name>_se`` in um, NaN where the thickness is, left out where no value has one.
    ``noise_um``: variance of the grey's integral over one um of single rays; NaN for white noise.
    """
    attrs = measured.attrs
    if "voxel_um" not in attrs or not ("from_labels" in attrs or "grey_noise" in attrs):
        return measured
    if "from_labels" in attrs:
        errors, common, patch_um2 = _errors_of_labels(measured)
    else:
        errors, common, patch_um2 = _errors_of_greys(measured, noise_um)
    _add_open_errors(measured, errors, common)
    variables: dict[str, xr.Variable] = {}
    for name in ("coating_top", "coating_bottom", "base_thickness", "thickness"):
        is_measured = measured[name].notnull().values
        se_um = np.where(is_measured, errors[name], np.nan)
        if np.isfinite(se_um).any():
            se = se_um.astype(np.float32)
            se_attrs = {"units": "um", "long_name": _se_name(PROPERTIES[name])}
            se_attrs |= {"common_um": common[name], "patch_um2": patch_um2}
            variables[f"{name}_se"] = xr.Variable(("y", "x"), se, se_attrs)
    return measured.assign(variables)


def _add_open_errors(measured: xr.Dataset, errors: NamedFields, common: dict[str, float]) -> None:
    """Add what corrections and greys leave open to ``errors`` and ``common``, both in um.

    The surfaces state, by side, how far off corrections may be in each column, and how far a wrong
    grey of the walls moves each column and, as ``common_um``, all columns alike. The grey of a
    coating moves all of its columns alike.
    """
    level_um = 0.0
    for side in SIDES:
        coating = f"coating_{side}"
        for source in (f"correction_{side}_error", f"level_{side}_error"):
            if source in measured:
                source_um = np.nan_to_num(measured[source].values.astype(float))
                for name in (coating, "base_thickness", "thickness"):
                    errors[name] = np.hypot(errors[name], source_um)
                level_um += float(measured[source].attrs.get("common_um", 0.0))
        common[coating] = math.hypot(common[coating], _grey_error_um(measured, side))
    for name in ("base_thickness", "thickness"):
        common[name] = math.hypot(common[name], level_um)


def _voxel_um(measured: xr.Dataset) -> dict[str, float]:
    """Size of the voxels that the faces were found in, by axis of the volume."""
    return dict(zip("zyx", map(float, measured.attrs["voxel_um"]), strict=True))


def _errors_of_labels(measured: xr.Dataset) -> Errors:
    """Errors of faces between voxels of labels."""
    through_um = _voxel_um(measured)[Frame.of(measured).through]
    common = common_errors(through_um)
    # A face lies anywhere within a voxel: the difference of two has the variance of two uniform
    # distributions.
    place_se_um = through_um / np.sqrt(6)
    errors = {name: np.hypot(place_se_um, se_um) for name, se_um in common.items()}
    return errors, common, float(np.prod(pitch(measured)))


def _errors_of_greys(measured: xr.Dataset, noise_um: float) -> Errors:
    """Errors of faces found in grey values.

    ``noise_um``: variance of the grey's integral over one um of a single ray; NaN: it is taken for
    white. Columns may be several voxels wide.
    """
    greys = Greys.of(measured)
    frame = Frame.of(measured)
    pitch_um = pitch(measured)
    voxel_um = _voxel_um(measured)
    through_um = voxel_um[frame.through]
    voxel_um2 = voxel_um[frame.rows] * voxel_um[frame.cols]
    # Voxels along the edge of a column.
    column_px = math.sqrt(pitch_um[0] * pitch_um[1] / voxel_um2)
    shared_noise = SharedNoise.of(
        greys, voxel_um=through_um, pitch_um=pitch_um, column_px=column_px, noise_um=noise_um
    )
    coatings_um: dict[Side, Floats] = {side: measured[f"coating_{side}"].values for side in SIDES}
    cos_tilt = 1 / secant(slopes_of(measured["centre"].values, pitch_um))
    errors = thickness_errors(coatings_um, greys, shared_noise, cosine=cos_tilt)
    if measured.attrs.get("method") == "paper":
        # A crossing of half the step uses one place of the edge, a fit all of it.
        blur_px = greys.blur_um / through_um
        crossing_factor = math.sqrt(max(1.0, math.sqrt(math.pi) * blur_px))
        errors = {name: se * crossing_factor for name, se in errors.items()}
    return errors, dict(shared_noise.common_um), shared_noise.patch_um2


def _grey_error_um(measured: xr.Dataset, side: Side) -> float:
    """Return how far the mean of a coating is off where its grey is off by its standard error.

    Blur keeps thickness times contrast to the base, as long as it reaches through the layer.
    """
    error = float(measured.attrs.get(f"grey_coating_{side}_error", 0.0))
    if not error:
        return 0.0
    greys = Greys.of(measured)
    seen_through_um = np.fmin(measured[f"coating_{side}"].values, _SEEN_THROUGH * greys.blur_um)
    contrast = abs(greys.coating(side) - greys.base)
    return error / contrast * float(np.nanmean(seen_through_um))


def _se_name(long_name: str) -> str:
    return f"Standard error of {long_name[0].lower()}{long_name[1:]}"


def _measure_faces(
    surfaces: xr.Dataset, params: MeasureParams, further_names: Sequence[str]
) -> xr.Dataset:
    """Add to the surfaces what the faces alone give, and further maps that they give as well.

    ``further_names``: those of ``OF_FACES`` that are wanted. All maps are in um; a column whose
    normal does not meet all that the sheet has gets a status of its own and NaN.
    """
    titles = PROPERTIES | {name: find_property(name).long_name for name in further_names}
    heights, faces = meet(surfaces, "normal")
    lengths_um = {name: face_length(faces, name) for name in LENGTHS}
    lengths_um["half_thickness_difference"] = faces["top"] + faces["bottom"]
    status = surfaces["status"].values.copy()
    status[(status == 0) & ~_is_whole(lengths_um)] = Status.NORMAL_LEAVES_SHEET
    is_valid = status == 0
    if not is_valid.any():
        raise CannotMeasure(
            "No normal of the centre surface meets both faces. Look at the surfaces with 'planish"
            " surface'."
        )
    for side in SIDES:
        # Of a side without a coating the interface is the face.
        if faces[f"interface_{side}"] is faces[side]:
            nothing = np.full(status.shape, np.nan)
            lengths_um |= {f"coating_{side}": nothing, f"base_surface_{side}": nothing}
    cutoff_um = float(surfaces.attrs.get("cutoff_um", CUTOFF_UM))
    nesting_um = params.nesting_um(cutoff_um)
    names = [name for name in HEIGHTS if name not in lengths_um]
    sheet = (faces, heights["centre"], is_valid)
    lengths_um |= above_form(*sheet, pitch(surfaces), names=names, nesting_um=nesting_um)
    variables: dict[str, xr.Variable] = {}
    for name, long_name in titles.items():
        attrs = {"units": "um", "long_name": long_name, "role": "property"}
        if name in HEIGHTS:
            attrs |= {"form_um": nesting_um, "f_operator": F_OPERATOR}
        length_um = np.where(is_valid, lengths_um[name], np.nan)
        variables[name] = xr.Variable(("y", "x"), length_um, attrs)
    variables["status"] = xr.Variable(("y", "x"), status, status_flags())
    return surfaces.drop_vars("status").assign(variables)


def _is_whole(lengths_um: Mapping[str, Floats]) -> Bools:
    """Mark the columns where everything that the sheet has was measured."""
    is_whole = np.isfinite(lengths_um["thickness"])
    for side in SIDES:
        has_coating = np.isfinite(lengths_um[f"coating_{side}"])
        if has_coating.any():
            is_whole &= has_coating
    return is_whole


def measure_along_rays(
    volume: xr.DataArray,
    surfaces: xr.Dataset,
    *,
    names: Sequence[str | Property],
    params: MeasureParams | None = None,
    rows_per_tile: int | None = None,
    engine: Engine | None = None,
) -> xr.Dataset:
    """Measure properties along the normals of the centre surface, or along vertical rays.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um
        May be lazily indexed; it is read in boxes of some rows.
    surfaces : Dataset, dims (y, x), heights in um
        As :func:`planish.surface.find_surfaces` returns them for this volume.
    names : sequence of str or Property
        What :func:`planish.measure.registered` lists, or what the decorators return.
    params : MeasureParams
    rows_per_tile : int
        Rows worked on together; what fits into half of the engine's memory where not given.
    engine : Engine
        Threads and memory; no result depends on it.

    Returns
    -------
    Dataset, dims (y, x), float32
        Each property with ``units``, ``long_name`` and ``support_um`` (the width that one value
        speaks for), and ``<name>_se``, its standard error in the same unit: NaN where none can be
        stated. ``status``: 0 measured, and the reasons in ``flag_meanings``. A property with
        reasons of its own has ``<name>_status`` beside it. Attributes hold the densities that were
        used.

    Raises
    ------
    CannotMeasure
        If a property is unknown, or a density or grey level that it needs was not given.
    SurfaceError, SizeError, ResourceError
    """
    params = params or MeasureParams()
    properties = in_order(names, params, Greys.of(surfaces))
    if not properties:
        raise CannotMeasure("No property was named. Name one or more.")
    frame = ray_frame(volume, surfaces, params)
    status = frame.status.copy()
    maps: dict[str, Measured] = {}
    by_halo: dict[int, list[Property]] = {}
    # Maps along rays, and the status, are filled in tile by tile.
    for prop in properties:
        if prop.kind == "rays":
            by_halo.setdefault(_halo(prop, frame), []).append(prop)
            values, se = np.full((2, *status.shape), np.nan, np.float32)
            reason = np.zeros(status.shape, np.uint8)
            maps[prop.name] = Measured(values=values, se=se, reason=reason)  # type: ignore[arg-type]
    if by_halo:
        measure_tile = partial(_measure_tile, by_halo, maps, status)
        each_tile(volume, frame, measure_tile, halo=max(by_halo), rows=rows_per_tile, engine=engine)
    sheet = Sheet(frame=replace(frame, status=status), maps=maps)
    requested = [*map(find_property, names)]
    variables: dict[str, xr.Variable] = {}
    for prop in properties:
        if prop.kind == "sheet":
            maps[prop.name] = _measured(prop, sheet, status.shape)
        if prop in requested:
            variables |= _variables(prop, maps[prop.name], sheet.frame)
    flags = status_flags(last=Status.RAY_LEAVES_VOLUME)
    variables["status"] = xr.Variable(("y", "x"), status, flags)
    attrs = surfaces.attrs | {"rays": params.rays}
    attrs |= {"ray_step_um": frame.step_um, "ray_noise_um": frame.noise_um}
    return xr.Dataset(variables, coords=surfaces.coords, attrs=attrs | params.known())


def _measure_tile(
    by_halo: Mapping[int, Sequence[Property]],
    maps: Mapping[str, Measured],
    status: Codes,
    tile: Rays,
    inner_rows: slice,
    sheet_rows: slice,
) -> None:
    """Measure some rows of the sheet, each property with as many rows around them as it needs.

    ``by_halo``: properties by the rows that they need on either side. ``maps`` and ``status``, of
    the whole sheet, are filled in. ``tile``: the rays of the rows and around them, in which the
    rows are ``inner_rows``; in the sheet they are ``sheet_rows``.
    """
    status[sheet_rows] = tile.status[inner_rows]
    for halo, properties in by_halo.items():
        start = max(inner_rows.start - halo, 0)
        halo_rays = tile.rows(slice(start, inner_rows.stop + halo))
        rows = slice(inner_rows.start - start, inner_rows.stop - start)
        for prop in properties:
            answer = _measured(prop, halo_rays, halo_rays.status.shape)
            for part in fields(Measured):
                sheet_map = getattr(maps[prop.name], part.name)
                sheet_map[sheet_rows] = getattr(answer, part.name)[rows]


def ray_frame(volume: xr.DataArray, surfaces: xr.Dataset, params: MeasureParams | None) -> RayFrame:
    """Find where the rays lie and how much noise their integrals have."""
    frame = RayFrame.of(volume, surfaces, params or MeasureParams())
    return replace(frame, noise_um=ray_noise(volume, frame))


def each_tile(
    volume: xr.DataArray,
    frame: RayFrame,
    work: Callable[[Rays, slice, slice], T],
    *,
    halo: int = 0,
    rows: int | None = None,
    engine: Engine | None,
) -> list[T]:
    """Straighten the sheet tile by tile and call ``work`` on threads.

    Return what it gave, in the order of the rows.

    ``work`` is called with the rays of a tile and of ``halo`` rows on both sides, the tile's rows
    within them, and its rows in the sheet. ResourceError if a single row with its halo does not fit
    into the memory.
    """
    engine = engine or Engine()
    row_count = frame.status.shape[0]
    threads = count_threads(engine.threads)
    # A sample takes 24 bytes at most while a tile is worked on.
    row_bytes = frame.status.shape[1] * frame.samples * 24
    if rows is None:
        rows = int(engine.memory_bytes / 2 / threads / row_bytes) - 2 * halo
        if rows < 1:
            raise ResourceError(
                "A row of rays with its neighbourhood takes"
                f" {(2 * halo + 1) * row_bytes * threads / 2**20:.0f} MiB on {threads} threads,"
                f" {engine.memory_bytes / 2**21:.0f} MiB were allowed. Allow more, or fewer"
                " threads."
            )
        # Tiles of even size, several for each thread; a halo costs less the larger they are.
        even_rows = -(-row_count // (4 * threads))
        rows = max(min(rows, max(even_rows, 2 * halo)), 1)
    tiles = [slice(start, min(start + rows, row_count)) for start in range(0, row_count, rows)]

    def run_tile(tile: slice) -> T:
        start = max(tile.start - halo, 0)
        rays = frame.tile(volume, slice(start, tile.stop + halo))
        inner_rows = slice(tile.start - start, tile.stop - start)
        return work(rays, inner_rows, tile)

    return map_threads(run_tile, tiles, number=threads)


def _halo(prop: Property, frame: RayFrame) -> int:
    halo_um = length_of(prop.halo_um, frame.params)
    if halo_um > 0:
        return int(np.ceil(halo_um / frame.pitch_um[0])) + 1
    return 0


def _measured(prop: Property, rays_or_sheet: Rays | Sheet, shape: Shape) -> Measured:
    with faults_named(f"The property {prop.name!r}", prop.function.__module__):
        answer = prop.function(rays_or_sheet)
    if not isinstance(answer, Measured):
        answer = Measured(values=np.asarray(answer))
    if answer.values.shape != shape:
        raise CannotMeasure(
            f"The property '{prop.name}' returned the shape {answer.values.shape} for {shape[0]} x"
            f" {shape[1]} rays. Return one value for each ray: (rows, cols)."
        )
    se = np.broadcast_to(answer.se, shape)
    reason = np.broadcast_to(answer.reason, shape)
    return Measured(values=answer.values, se=se, reason=reason)


def _variables(prop: Property, answer: Measured, frame: RayFrame) -> dict[str, xr.Variable]:
    """Give a property and its standard error as they are stored: NaN where the status is not 0.

    Also gives its status where it has reasons of its own, which are numbered from ``FIRST_OWN``.
    """
    dims = ("y", "x")
    title = prop.long_name
    status = frame.status
    # One value speaks for a ray at least, and for what the blur mixes into it.
    ray_width_um = max(*frame.pitch_um, FWHM * frame.greys.blur_um)
    support_um = max(length_of(prop.support_um, frame.params), ray_width_um)
    measured = np.where(status == 0, answer.values, np.nan)
    values = measured.astype(np.float32)
    measured_se = np.where(np.isfinite(values), answer.se, np.nan)
    se = measured_se.astype(np.float32)
    attrs = {"units": prop.units, "long_name": title, "support_um": round(support_um, 3)}
    attrs |= prop.attrs
    attrs |= frame.params.model_dump(include={*prop.stated}, exclude_none=True)
    se_attrs = {"units": prop.units, "long_name": _se_name(title)}
    variables = {prop.name: xr.Variable(dims, values, attrs)}
    variables[f"{prop.name}_se"] = xr.Variable(dims, se, se_attrs)
    if prop.reasons:
        has_reason = (status == 0) & (answer.reason > 0)
        own_codes = answer.reason + np.uint8(FIRST_OWN - 1)
        own_status = np.where(has_reason, own_codes, status)
        last = Status.RAY_LEAVES_VOLUME
        flags = status_flags(f"Status of {title}", last=last, reasons=prop.reasons)
        variables[f"{prop.name}_status"] = xr.Variable(dims, own_status, flags)
    return variables
