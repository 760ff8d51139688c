"""From a volume to the faces, interfaces and centre of its sheet, as heights above the volume's own columns."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.core.tiles import Engine
from planish.surface.centre import gaussian_regression
from planish.surface.columns import Columns, voxel_pitch
from planish.surface.faces import find_faces
from planish.surface.learn import learn
from planish.surface.levels import GreyLevels
from planish.surface.oriented import make_guide
from planish.surface.params import SurfaceParams
from planish.surface.presence import find_presence
from planish.surface.regions import regions
from planish.surface.survey import Survey, take_survey

Array = NDArray[np.float64]


def find_surfaces(
    volume: xr.DataArray,
    *,
    frame: Frame | None = None,
    params: SurfaceParams | None = None,
    engine: Engine | None = None,
) -> xr.Dataset:
    """Find top, bottom, interfaces and centre surface of the sheet in a volume.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um
        Grey values; NaN is missing.
    frame : Frame
        Axis through the sheet and side of its top; z and its high end where not given.
    params : SurfaceParams
    engine : Engine
        How the tiles are worked on; local threads where not given. The result does not depend on it.

    Returns
    -------
    Dataset, dims (y, x) = rows and columns of the frame
        ``top``, ``bottom``, ``interface_top``, ``interface_bottom``, ``centre``: heights in um, coordinates along the
        axis through the sheet. NaN where there is no sheet; the interface of a side without a coating is all NaN.
        ``centre`` runs on across holes. ``presence``: share of material along the normal below the top face, 0 to 1.
        ``status``: 0 measured, 1 no sheet, 2 rim of a hole or gap, 3 face not found.
        Attributes hold the grey levels and what was seen.

    Raises
    ------
    VolumeError
        If the volume holds no sheet, several, or one that fills it from end to end.

    Notes
    -----
    Every column is fitted with a blurred staircase air-coating-base. Levels differ from place to place within a
    spread that is learnt from the same volume, which keeps thin layers from taking the width of the blur.
    """
    frame = frame or Frame()
    params = params or SurfaceParams()
    engine = engine or Engine(threads=params.threads)
    columns = Columns(volume=volume, frame=frame, step=params.step)
    pitch = columns.pitch
    survey = take_survey(columns, params, engine)
    columns = columns.padded(survey.padding)
    guide = make_guide(survey.coarse, columns)
    learnt = learn(columns, guide, survey, params)
    levels = learnt.levels(pitch[2])
    faces = find_faces(columns, guide, learnt, engine)
    top, inner_top = faces.high, faces.interface_high
    bottom, inner_bottom = faces.low, faces.interface_low
    if frame.top == "low":
        (top, inner_top), (bottom, inner_bottom) = (bottom, inner_bottom), (top, inner_top)
        levels = _swapped(levels)
    up = frame.sign
    seen = np.isfinite(top) & np.isfinite(bottom) & (up * (top - bottom) > 0)
    top, bottom, inner_top, inner_bottom = (np.where(seen, f, np.nan) for f in (top, bottom, inner_top, inner_bottom))
    thickness = float(np.nanmedian(up * (top - bottom))) if seen.any() else float("nan")
    if not np.isfinite(thickness):
        raise VolumeError(
            "There is no sheet in the volume: no column shows two faces. Check --through and --sheet-grey."
        )
    sheet, rim, outline = regions(seen, pitch[:2], params.rim_um)
    middle = np.where(sheet & ~rim, 0.5 * (top + bottom), np.nan)
    if not np.isfinite(middle).any():
        raise VolumeError(
            f"The sheet is {thickness:.3g} um thick and consists of holes and their rims of {params.rim_um:g} um only; "
            "nothing is left to measure. Is the voxel size in um? Check --voxel-um, --rim-um and --sheet-grey."
        )
    centre = gaussian_regression(middle, pitch[:2], cutoff_um=params.cutoff_um)
    # A hole with its rim may be wider than a short cut-off reaches: it is bridged with a longer one.
    for wider in (2.0, 4.0):
        if np.isnan(centre[outline]).any():
            bridge = gaussian_regression(middle, pitch[:2], cutoff_um=wider * params.cutoff_um)
            centre = np.where(np.isnan(centre), bridge, centre)
    centre = np.where(outline, centre, np.nan)
    status = np.where(~np.isfinite(centre) | ~sheet, 1, np.where(rim, 2, np.where(seen, 0, 3))).astype(np.uint8)
    present = find_presence(columns, centre, thickness, up, learnt, engine)
    heights = {
        "top": (top, "Top face"),
        "bottom": (bottom, "Bottom face"),
        "interface_top": (inner_top, "Interface between top coating and base"),
        "interface_bottom": (inner_bottom, "Interface between bottom coating and base"),
        "centre": (centre, "Centre surface"),
    }
    data: dict[str, tuple[tuple[str, str], NDArray[np.generic], dict[str, object]]] = {
        name: (("y", "x"), values, {"units": "um", "long_name": title}) for name, (values, title) in heights.items()
    }
    data["presence"] = (("y", "x"), present, {"units": "1", "long_name": "Material below the top face"})
    meanings = "measured no_sheet rim face_not_found"
    data["status"] = (
        ("y", "x"), status, {"long_name": "Status", "flag_values": [0, 1, 2, 3], "flag_meanings": meanings},
    )  # fmt: skip
    attrs: dict[str, object] = {
        **frame.attrs(),
        "thickness_um": thickness,
        "cutoff_um": params.cutoff_um,
        "rim_um": params.rim_um,
    }
    attrs |= {f"grey_{k}" if k in ("air", "base", "coating_top", "coating_bottom", "noise") else k: v
              for k, v in asdict(levels).items()}  # fmt: skip
    attrs |= {"voxel_um": [voxel_pitch(volume, axis) for axis in ("z", "y", "x")]}
    attrs["saturated_share"] = _saturated(survey, columns.depth_um, top, bottom)
    attrs["missing_share"] = survey.missing_share
    if survey.padding is not None:
        attrs["padding"] = survey.padding
    coords = dict(zip(("y", "x"), columns.lateral_um(), strict=True))
    return xr.Dataset(data, coords={k: ((k,), v, {"units": "um"}) for k, v in coords.items()}, attrs=attrs)


def _swapped(levels: GreyLevels) -> GreyLevels:
    return replace(levels, coating_top=levels.coating_bottom, coating_bottom=levels.coating_top)


def _saturated(survey: Survey, depth_um: Array, top: Array, bottom: Array) -> float:
    """Share of the sheet's voxels at the largest value of their type (or at its smallest for a dark sheet)."""
    part, n = survey.sample, survey.stride
    if not np.issubdtype(part.dtype, np.integer):
        return 0.0
    limits = np.iinfo(part.dtype)
    limit = limits.max if survey.polarity > 0 else limits.min
    lower, upper = np.fmin(top, bottom)[::n, ::n, None], np.fmax(top, bottom)[::n, ::n, None]
    inside = (depth_um >= lower) & (depth_um <= upper)
    return float(np.mean(part[inside] == limit)) if inside.any() else 0.0
