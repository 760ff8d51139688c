"""Surfaces with corrections, and the surfaces as they were found before them."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import InputError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.status import Status
from planish.core.tiles import Engine
from planish.core.typing import Floats
from planish.surface.assemble import centre_surface
from planish.surface.columns import Columns
from planish.surface.draw import RING_UM, Drawing, draw_faces
from planish.surface.params import FACES, Corrections, Face, Stretch, SurfaceParams

_REPAIRED = (Status.FACE_NOT_FOUND, Status.PARTICLE, Status.TOUCHING)
_SEEN_UM = 0.001  # the centre surface moves where a correction moves it by more
_SUPPORT = 3.0  # cut-offs: how far the smoothing of the centre surface reaches
_HOW = "found image interpolated"
_UNCHANGED = 255  # of ``found_status``
_TILES = "corrected_tiles"
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
    columns = Columns(
        volume=volume, frame=Frame.of(before), step=columns_step(before), padding=before.attrs.get("padding")
    )
    drawn = draw_faces(before, columns, corrections, engine)
    return _with_drawn(before, drawn, params).assign_attrs(
        {"corrections": corrections.to_json(), _TILES: len(drawn.tiles)}
    )


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
    before.attrs = {name: value for name, value in surfaces.attrs.items() if name not in ("corrections", _TILES)}
    return before


def preview_faces(
    surfaces: xr.Dataset, volume: xr.DataArray, corrections: Corrections, part: tuple[slice, slice]
) -> tuple[tuple[slice, slice], dict[Face, Floats]] | None:
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
    frame, steps = Frame.of(surfaces), pitch(surfaces)
    boxes = [(stretch, _box(stretch, surfaces, frame, steps)) for stretch in corrections.stretches]
    near_part = [
        (stretch, box) for stretch, box in boxes
        if all(side.start < asked.stop and side.stop > asked.start for side, asked in zip(box, part, strict=True))
    ]  # fmt: skip
    if not near_part:
        return None
    rows, cols = (
        slice(min(box[k].start for _, box in near_part), max(box[k].stop for _, box in near_part)) for k in (0, 1)
    )
    step = columns_step(surfaces)
    near = uncorrected(surfaces.isel(y=rows, x=cols).load())
    sides = (frame.rows, rows), (frame.cols, cols)
    voxels = {axis: slice(side.start * step, side.stop * step) for axis, side in sides}
    columns = Columns(volume=volume.isel(voxels), frame=frame, step=step, padding=near.attrs.get("padding"))
    chosen = corrections.model_copy(update={"stretches": tuple(stretch for stretch, _ in near_part)})
    drawn = draw_faces(near, columns, chosen, Engine(threads=1))
    faces: dict[Face, Floats] = {face: drawn.heights[face] for face in FACES}
    crossed = frame.sign * (faces["top"] - faces["bottom"]) <= 0
    return (rows, cols), {face: np.where(crossed, near[face].values, faces[face]) for face in FACES}


def _box(stretch: Stretch, surfaces: xr.Dataset, frame: Frame, steps: tuple[float, float]) -> tuple[slice, slice]:
    """Columns that the drawing of a stretch may look at."""
    margin = 1.5 * stretch.reach_um + 2 * RING_UM
    sides: list[slice] = []
    for dim, axis, step in (("y", frame.rows, steps[0]), ("x", frame.cols, steps[1])):
        points_um = [float(getattr(point, axis)) for point in stretch.points]
        places = surfaces[dim].values
        first = int((min(points_um) - margin - float(places[0])) // step)
        last = int((max(points_um) + margin - float(places[0])) // step) + 2
        sides.append(slice(max(first, 0), max(min(last, places.size), max(first, 0) + 1)))
    return sides[0], sides[1]


def columns_step(surfaces: xr.Dataset) -> int:
    """Voxels along the edge of a column."""
    frame, steps = Frame.of(surfaces), pitch(surfaces)
    voxel = dict(zip("zyx", map(float, surfaces.attrs["voxel_um"]), strict=True))
    return max(1, round(float(np.sqrt(steps[0] * steps[1] / (voxel[frame.rows] * voxel[frame.cols])))))


def _with_drawn(surfaces: xr.Dataset, drawn: Drawing, params: SurfaceParams) -> xr.Dataset:
    """Put the faces of corrections in, the status and centre surface that follow from them, and what was before."""
    before = {name: surfaces[name].values for name in (*_HEIGHTS, "status")}
    changed = np.any([drawn.how[face] > 0 for face in FACES], axis=0)
    up = Frame.of(surfaces).sign
    top, bottom = (drawn.heights[face] for face in FACES)
    # Where the two faces would change places nothing is drawn.
    changed &= ~(up * (top - bottom) <= 0)
    heights = {name: np.where(changed, drawn.heights[name], before[name]) for name in _HEIGHTS}
    is_complete = changed & np.isfinite(heights["top"]) & np.isfinite(heights["bottom"])
    repaired = is_complete & np.isin(before["status"], _REPAIRED)
    status = np.where(repaired, np.uint8(Status.MEASURED), before["status"])
    centre = _moved_centre(surfaces, heights, status, params)
    variables: dict[str, Any] = {}
    for name, values in (heights | {"status": status, "centre": centre}).items():
        variables[name] = surfaces[name].copy(data=values)
        old = surfaces[name].values
        about = {"long_name": f"{surfaces[name].attrs['long_name']}, before corrections"}
        if name == "status":
            variables[f"found_{name}"] = (("y", "x"), np.where(changed, old, _UNCHANGED).astype(np.uint8), about)
        else:
            where = changed if name != "centre" else centre != old
            variables[f"found_{name}"] = (("y", "x"), np.where(where, old, np.nan), about | {"units": "um"})
    for face in FACES:
        how = {"long_name": f"How the {face} face was corrected", "flag_values": [0, 1, 2], "flag_meanings": _HOW}
        variables[f"correction_{face}"] = (("y", "x"), np.where(changed, drawn.how[face], 0).astype(np.uint8), how)
        error = np.where(changed & (drawn.how[face] > 0), drawn.error_um[face], np.nan).astype(np.float32)
        about = {"units": "um", "long_name": f"Standard error that the correction adds to the {face} face"}
        variables[f"correction_{face}_error"] = (("y", "x"), error, about)
    return surfaces.assign(variables)


def _moved_centre(
    surfaces: xr.Dataset, heights: dict[str, Floats], status: NDArray[Any], params: SurfaceParams
) -> Floats:
    """The centre surface, moved by what the smoothing of the new faces differs from that of the old ones."""
    middles = [
        np.where(of == Status.MEASURED, 0.5 * (faces["top"] + faces["bottom"]), np.nan)
        for of, faces in ((surfaces["status"].values, {k: surfaces[k].values for k in FACES}), (status, heights))
    ]
    centre = surfaces["centre"].values
    differs = ~((middles[0] == middles[1]) | (np.isnan(middles[0]) & np.isnan(middles[1])))
    if not differs.any():
        return centre
    steps = pitch(surfaces)
    window: list[slice] = []
    for axis, step in enumerate(steps):
        lines, reach = np.flatnonzero(differs.any(axis=1 - axis)), int(np.ceil(_SUPPORT * params.cutoff_um / step))
        window.append(slice(max(int(lines[0]) - reach, 0), int(lines[-1]) + reach + 1))
    part = window[0], window[1]
    outline = np.isfinite(centre[part])
    old, new = (centre_surface(middle[part], outline, steps, params)[0] for middle in middles)
    move = np.where(np.abs(new - old) >= _SEEN_UM, new - old, 0.0)
    moved = centre.copy()
    moved[part] += np.where(np.isfinite(move), move, 0.0)
    return moved
