"""Surfaces with corrections, and the surfaces as they were found before them."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from planish.core.errors import InputError
from planish.core.facts import SIDES, Side
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.status import Status
from planish.core.tiles import Engine
from planish.core.typing import Array, Entries, Floats, Window
from planish.surface.assemble import centre_surface
from planish.surface.draw import RING_UM, Drawing, columns_of
from planish.surface.params import Corrections, Stretch, SurfaceParams

_UNCHANGED = 255  # of ``found_status``
_HEIGHTS = ("top", "bottom", "interface_top", "interface_bottom")


def correct_surfaces(
    surfaces: xr.Dataset,
    volume: xr.DataArray,
    corrections: Corrections,
    *,
    params: SurfaceParams | None = None,
    engine: Engine | None = None,
) -> xr.Dataset:
    """Draw the faces of surfaces to the points of corrections.

    Parameters
    ----------
    surfaces : Dataset, dims (y, x)
        Of :func:`planish.surface.find_surfaces`, with corrections of their own or without: theirs
        are taken off first.
    volume : DataArray, dims (z, y, x)
        Where they were found. Only the tiles that the corrections touch are read.
    corrections : Corrections
    params : SurfaceParams, optional
        Those of the search.
    engine : Engine, optional

    Returns
    -------
    Dataset, dims (y, x)
        The surfaces. Columns beyond the reach of every stretch keep their faces and their status to
        the last bit. The centre surface follows as far as its smoothing reaches; the presence of
        material stays that along the centre surface that was found. ``correction_top``,
        ``correction_bottom``: 0 as found, 1 found again in the image, 2 interpolated;
        ``correction_top_error``, ``correction_bottom_error``: standard error in um that this adds.
        ``found_top``, ``found_interface_top`` ...: heights before, and ``found_status``, in columns
        that changed.

    Raises
    ------
    InputError
        If a point lies outside the volume, or the surfaces were found in labels or slice by slice.

    Notes
    -----
    A correction makes no sheet where a hole was seen, and takes no rim off.
    """
    params = params or SurfaceParams()
    original = uncorrected(surfaces)
    if not corrections.stretches:
        return original
    is_in_greys = "grey_noise" in original.attrs and "from_labels" not in original.attrs
    if not is_in_greys or params.method != "profile":
        raise InputError(
            "Faces are corrected in grey values, with `surface_method=profile`. Correct labels in"
            " the program that made them, or leave `corrections` out."
        )
    drawn = Drawing(original, volume, corrections, engine or Engine())
    corrected = _with_drawn(original, drawn, params)
    return corrected.assign_attrs(
        corrections=corrections.to_json(), corrected_tiles=len(drawn.tiles)
    )


def uncorrected(surfaces: xr.Dataset) -> xr.Dataset:
    """Give the surfaces as they were before corrections, to the last bit."""
    if "corrections" not in surfaces.attrs:
        return surfaces
    names = [name for name in surfaces if str(name).startswith(("found_", "correction_"))]
    original = surfaces.drop_vars(names)
    is_changed = surfaces["found_status"].values != _UNCHANGED
    # The centre surface moved in more columns than the faces did.
    is_centre_moved = surfaces["found_centre"].notnull().values
    for name in (*_HEIGHTS, "status", "centre"):
        is_restored = is_centre_moved if name == "centre" else is_changed
        before = surfaces[f"found_{name}"].values
        field = np.where(is_restored, before, surfaces[name].values)
        original[name] = original[name].copy(data=field)
    for name in ("corrections", "corrected_tiles"):
        original.attrs.pop(name, None)
    return original


def preview_faces(
    surfaces: xr.Dataset, volume: xr.DataArray, corrections: Corrections, part: Window
) -> tuple[Window, dict[Side, Floats]] | None:
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
        Window of the columns that was drawn, which holds all that changes in ``part``; None where
        nothing does.
    """
    near_stretches: list[Stretch] = []
    near_boxes: list[list[slice]] = []
    for stretch in corrections.stretches:
        box = _box(stretch, surfaces)
        if _overlap(box, part):
            near_stretches.append(stretch)
            near_boxes.append(box)
    if not near_stretches:
        return None
    rows, cols = map(_hull, zip(*near_boxes, strict=True))
    frame = Frame.of(surfaces)
    step = columns_of(surfaces, volume).step
    near_surfaces = uncorrected(surfaces.isel(y=rows, x=cols).load())
    voxel_rows = slice(rows.start * step, rows.stop * step)
    voxel_cols = slice(cols.start * step, cols.stop * step)
    near_volume = volume.isel({frame.rows: voxel_rows, frame.cols: voxel_cols})
    near_corrections = corrections.model_copy(update={"stretches": tuple(near_stretches)})
    heights = Drawing(near_surfaces, near_volume, near_corrections, Engine(threads=1)).heights
    is_crossed = frame.sign * (heights["top"] - heights["bottom"]) <= 0
    faces: dict[Side, Floats] = {}
    for face in SIDES:
        faces[face] = np.where(is_crossed, near_surfaces[face].values, heights[face])
    return (rows, cols), faces


def _box(stretch: Stretch, surfaces: xr.Dataset) -> list[slice]:
    """Rows and columns that a stretch may change, and those that its faces are expected from.

    One column at least. A stretch reaches ``reach_um`` from its points, and what its faces are
    expected from half of that farther, or the width of the ring.
    """
    frame = Frame.of(surfaces)
    margin_um = 1.5 * stretch.reach_um + 2 * RING_UM
    box: list[slice] = []
    axes = frame.rows, frame.cols
    for dim, axis, step_um in zip("yx", axes, pitch(surfaces), strict=True):
        points_um = [float(getattr(point, axis)) for point in stretch.points]
        columns_um = surfaces[dim].values
        first_um = float(columns_um[0])
        first = max(int((min(points_um) - margin_um - first_um) // step_um), 0)
        last = int((max(points_um) + margin_um - first_um) // step_um) + 2
        box.append(slice(first, max(min(last, columns_um.size), first + 1)))
    return box


def _hull(slices: Sequence[slice]) -> slice:
    return slice(min(s.start for s in slices), max(s.stop for s in slices))


def _overlap(first: Sequence[slice], second: Sequence[slice]) -> bool:
    pairs = zip(first, second, strict=True)
    return all(a.start < b.stop and b.start < a.stop for a, b in pairs)


def _with_drawn(surfaces: xr.Dataset, drawn: Drawing, params: SurfaceParams) -> xr.Dataset:
    """Put the faces of corrections in, and the status and centre surface that follow from them.

    What was before is put in too, as ``found_*``, in columns that changed: elsewhere NaN, and
    ``_UNCHANGED`` in the status.
    """
    is_changed = (drawn.how["top"] > 0) | (drawn.how["bottom"] > 0)
    thickness = drawn.heights["top"] - drawn.heights["bottom"]
    # Where the two faces would change places nothing is drawn.
    is_changed &= ~(Frame.of(surfaces).sign * thickness <= 0)
    corrected: dict[str, Array] = {}
    for name in _HEIGHTS:
        corrected[name] = np.where(is_changed, drawn.heights[name], surfaces[name].values)
    status = surfaces["status"].values
    is_repaired = np.isin(status, (Status.FACE_NOT_FOUND, Status.PARTICLE, Status.TOUCHING))
    is_repaired &= is_changed & np.isfinite(corrected["top"] - corrected["bottom"])
    corrected["status"] = np.where(is_repaired, np.uint8(Status.MEASURED), status)
    corrected["centre"] = _moved_centre(surfaces, corrected, params)
    variables: Entries = {}
    for name, field in corrected.items():
        variables[name] = surfaces[name].copy(data=field)
        original = surfaces[name].values
        attrs = {"long_name": f"{surfaces[name].attrs['long_name']}, before corrections"}
        is_other = field != original if name == "centre" else is_changed
        if name == "status":
            found_field = np.where(is_other, original, _UNCHANGED).astype(np.uint8)
        else:
            attrs["units"] = "um"
            found_field = np.where(is_other, original, np.nan)
        variables[f"found_{name}"] = (("y", "x"), found_field, attrs)
    for face in SIDES:
        how = drawn.how[face] * is_changed
        attrs = {
            "long_name": f"How the {face} face was corrected",
            "flag_values": [0, 1, 2],
            "flag_meanings": "found image interpolated",
        }
        variables[f"correction_{face}"] = (("y", "x"), how, attrs)
        error_um = np.where(how > 0, drawn.error_um[face], np.nan)
        title = f"Standard error that the correction adds to the {face} face"
        attrs = {"units": "um", "long_name": title}
        error = error_um.astype(np.float32)
        variables[f"correction_{face}_error"] = (("y", "x"), error, attrs)
    return surfaces.assign(variables)


def _moved_centre(
    surfaces: xr.Dataset, corrected: dict[str, Array], params: SurfaceParams
) -> Floats:
    """Centre surface, moved as far as the smoothing of corrected faces reaches.

    By the difference of two smoothings there, of the faces before and after. ``corrected``: heights
    and status by name, (rows, cols).
    """
    original = {name: surfaces[name].values for name in (*SIDES, "status")}
    face_means: list[Floats] = []
    for faces in (original, corrected):
        middle = 0.5 * (faces["top"] + faces["bottom"])
        face_means.append(np.where(faces["status"] == Status.MEASURED, middle, np.nan))
    centre = surfaces["centre"].values
    steps_um = pitch(surfaces)
    before, after = face_means
    is_missing = np.isnan(before) & np.isnan(after)
    is_different = (before != after) & ~is_missing
    if not is_different.any():
        return centre
    slices: list[slice] = []
    for axis, step_um in enumerate(steps_um):
        # The smoothing reaches three cut-offs.
        changed_lines = np.flatnonzero(is_different.any(axis=1 - axis))
        reach = int(np.ceil(3.0 * params.cutoff_um / step_um))
        first = max(int(changed_lines[0]) - reach, 0)
        slices.append(slice(first, int(changed_lines[-1]) + reach + 1))
    window = slices[0], slices[1]
    outline = np.isfinite(centre[window])
    centre_before, _ = centre_surface(before[window], outline, steps_um, params)
    centre_after, _ = centre_surface(after[window], outline, steps_um, params)
    shift_um = centre_after - centre_before
    moved_centre = centre.copy()
    # Where a correction moves it by less than a nanometre it stays.
    moved_centre[window] += np.where(np.abs(shift_um) >= 0.001, shift_um, 0.0)
    return moved_centre
