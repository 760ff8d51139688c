"""Surfaces with corrections, and the surfaces as they were found before them."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import InputError
from planish.core.facts import SIDES, Side
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.status import Status
from planish.core.tiles import Engine
from planish.core.typing import Floats
from planish.surface.assemble import centre_surface
from planish.surface.draw import RING_UM, Drawing, columns_of
from planish.surface.params import Corrections, Stretch, SurfaceParams

_UNCHANGED = 255  # of ``found_status``
_HEIGHTS = ("top", "bottom", "interface_top", "interface_bottom")


def correct_surfaces(
    surfaces: xr.Dataset, volume: xr.DataArray, corrections: Corrections, *, params: SurfaceParams | None = None,
    engine: Engine | None = None,
) -> xr.Dataset:  # fmt: skip
    """Draw the faces of surfaces to the points of corrections.

    Parameters
    ----------
    surfaces : Dataset, dims (y, x)
        Of :func:`planish.surface.find_surfaces`, with corrections of their own or without: theirs are taken off first.
    volume : DataArray, dims (z, y, x)
        Where they were found. Only the tiles that the corrections touch are read.
    corrections : Corrections
    params : SurfaceParams, optional
        Those of the search.
    engine : Engine, optional

    Returns
    -------
    Dataset, dims (y, x)
        The surfaces. Columns beyond the reach of every stretch keep their faces and their status to the last bit. The
        centre surface follows as far as its smoothing reaches; the presence of material stays that along the centre
        surface that was found. ``correction_top``, ``correction_bottom``: 0 as found, 1 found again in the image, 2
        interpolated; ``correction_top_error``, ``correction_bottom_error``: standard error in um that this adds.
        ``found_top``, ``found_interface_top`` ...: heights before, and ``found_status``, in columns that changed.

    Raises
    ------
    InputError
        If a point lies outside the volume, or the surfaces were found in labels or slice by slice.

    Notes
    -----
    A correction makes no sheet where a hole was seen, and takes no rim off.
    """
    params, engine = params or SurfaceParams(), engine or Engine()
    before = uncorrected(surfaces)
    if not corrections.stretches:
        return before
    if "from_labels" in before.attrs or "grey_noise" not in before.attrs or params.method != "profile":
        raise InputError(
            "Faces are corrected in grey values, with --surface-method profile. Correct labels in the program that "
            "made them, or leave --corrections out."
        )
    drawn = Drawing(before, volume, corrections, engine)
    corrected = _with_drawn(before, drawn, params)
    return corrected.assign_attrs(corrections=corrections.to_json(), corrected_tiles=len(drawn.tiles))


def uncorrected(surfaces: xr.Dataset) -> xr.Dataset:
    """Give the surfaces as they were before corrections, to the last bit."""
    if "corrections" not in surfaces.attrs:
        return surfaces
    names = [str(name) for name in surfaces.data_vars if str(name).startswith(("found_", "correction_"))]
    before = surfaces.drop_vars(names)
    changed = surfaces["found_status"].values != _UNCHANGED
    moved = np.isfinite(surfaces["found_centre"].values)
    for name in (*_HEIGHTS, "status", "centre"):
        where = moved if name == "centre" else changed
        before[name] = before[name].copy(data=np.where(where, surfaces[f"found_{name}"].values, before[name].values))
    for name in ("corrections", "corrected_tiles"):
        before.attrs.pop(name, None)
    return before


def preview_faces(
    surfaces: xr.Dataset, volume: xr.DataArray, corrections: Corrections, part: tuple[slice, slice]
) -> tuple[tuple[slice, slice], dict[Side, Floats]] | None:
    """Draw the faces in a part of the columns as corrections would; only what is near it is read.

    Parameters
    ----------
    surfaces : Dataset, dims (y, x)
        May be left in its file.
    volume : DataArray, dims (z, y, x), coordinates in um
    corrections : Corrections
    part : two slices
        Rows and columns that are to be seen.

    Returns
    -------
    (rows, columns) and heights by face, or None
        Window of the columns that was drawn, which holds all that changes in ``part``; None where nothing does.
    """
    boxes = [(stretch, _box(stretch, surfaces)) for stretch in corrections.stretches]
    near_part = [
        (stretch, box) for stretch, box in boxes
        if all(side.start < asked.stop and side.stop > asked.start for side, asked in zip(box, part, strict=True))
    ]  # fmt: skip
    if not near_part:
        return None
    rows, cols = (
        slice(min(box[k].start for _, box in near_part), max(box[k].stop for _, box in near_part)) for k in (0, 1)
    )
    frame, step = Frame.of(surfaces), columns_of(surfaces, volume).step
    near = uncorrected(surfaces.isel(y=rows, x=cols).load())
    voxels = {axis: slice(k.start * step, k.stop * step) for axis, k in ((frame.rows, rows), (frame.cols, cols))}
    chosen = corrections.model_copy(update={"stretches": tuple(stretch for stretch, _ in near_part)})
    heights = Drawing(near, volume.isel(voxels), chosen, Engine(threads=1)).heights
    crossed = frame.sign * (heights["top"] - heights["bottom"]) <= 0
    return (rows, cols), {face: np.where(crossed, near[face].values, heights[face]) for face in SIDES}


def _box(stretch: Stretch, surfaces: xr.Dataset) -> list[slice]:
    """Columns that the drawing of a stretch may look at."""
    frame, margin = Frame.of(surfaces), 1.5 * stretch.reach_um + 2 * RING_UM
    sides: list[slice] = []
    for dim, axis, step in zip("yx", (frame.rows, frame.cols), pitch(surfaces), strict=True):
        points_um = [float(getattr(point, axis)) for point in stretch.points]
        places = surfaces[dim].values
        first = max(int((min(points_um) - margin - float(places[0])) // step), 0)
        last = int((max(points_um) + margin - float(places[0])) // step) + 2
        sides.append(slice(first, max(min(last, places.size), first + 1)))
    return sides


def _with_drawn(surfaces: xr.Dataset, drawn: Drawing, params: SurfaceParams) -> xr.Dataset:
    """Put the faces of corrections in, the status and centre surface that follow from them, and what was before."""
    top, bottom = (drawn.heights[face] for face in SIDES)
    changed = np.any([drawn.how[face] > 0 for face in SIDES], axis=0)
    # Where the two faces would change places nothing is drawn.
    changed &= ~(Frame.of(surfaces).sign * (top - bottom) <= 0)
    new: dict[str, NDArray[Any]] = {
        name: np.where(changed, drawn.heights[name], surfaces[name].values) for name in _HEIGHTS
    }
    status = surfaces["status"].values
    repaired = np.isin(status, (Status.FACE_NOT_FOUND, Status.PARTICLE, Status.TOUCHING))
    repaired &= changed & np.isfinite(new["top"]) & np.isfinite(new["bottom"])
    new["status"] = np.where(repaired, np.uint8(Status.MEASURED), status)
    new["centre"] = _moved_centre(surfaces, new, params)
    variables: dict[str, Any] = {}
    for name, field in new.items():
        variables[name] = surfaces[name].copy(data=field)
        old = surfaces[name].values
        attrs = {"long_name": f"{surfaces[name].attrs['long_name']}, before corrections"}
        if name == "status":
            before = np.where(changed, old, _UNCHANGED).astype(np.uint8)
        else:
            attrs["units"] = "um"
            before = np.where(field != old if name == "centre" else changed, old, np.nan)
        variables[f"found_{name}"] = (("y", "x"), before, attrs)
    for face in SIDES:
        how = np.where(changed, drawn.how[face], 0).astype(np.uint8)
        flags = {"flag_values": [0, 1, 2], "flag_meanings": "found image interpolated"}
        attrs = {"long_name": f"How the {face} face was corrected", **flags}
        variables[f"correction_{face}"] = (("y", "x"), how, attrs)
        error = np.where(how > 0, drawn.error_um[face], np.nan).astype(np.float32)
        attrs = {"units": "um", "long_name": f"Standard error that the correction adds to the {face} face"}
        variables[f"correction_{face}_error"] = (("y", "x"), error, attrs)
    return surfaces.assign(variables)


def _moved_centre(surfaces: xr.Dataset, new: dict[str, NDArray[Any]], params: SurfaceParams) -> Floats:
    """The centre surface, moved by what the smoothing of the new faces differs from that of the old ones."""
    old = {name: surfaces[name].values for name in (*SIDES, "status")}
    middles = [
        np.where(faces["status"] == Status.MEASURED, 0.5 * (faces["top"] + faces["bottom"]), np.nan)
        for faces in (old, new)
    ]
    centre, steps = surfaces["centre"].values, pitch(surfaces)
    differs = ~((middles[0] == middles[1]) | (np.isnan(middles[0]) & np.isnan(middles[1])))
    if not differs.any():
        return centre
    window: list[slice] = []
    for axis, step in enumerate(steps):
        # The smoothing reaches three cut-offs.
        lines, reach = np.flatnonzero(differs.any(axis=1 - axis)), int(np.ceil(3.0 * params.cutoff_um / step))
        window.append(slice(max(int(lines[0]) - reach, 0), int(lines[-1]) + reach + 1))
    part = window[0], window[1]
    outline = np.isfinite(centre[part])
    before, after = (centre_surface(middle[part], outline, steps, params)[0] for middle in middles)
    moved = centre.copy()
    # Where a correction moves it by less than a nanometre it stays.
    moved[part] += np.where(np.abs(after - before) >= 0.001, after - before, 0.0)
    return moved
