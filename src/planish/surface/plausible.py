"""Whether what was found can be the sheet: its thickness, the share of columns that show it, the axis of the search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from planish.core.errors import VolumeError
from planish.core.frame import Frame, likely_through
from planish.core.tiles import Engine
from planish.surface.columns import Columns
from planish.surface.params import SurfaceParams
from planish.surface.survey import Survey, take_survey

_THICKNESS_UM = (2.0, 5000.0)  # from a thin tissue to a thick board, with room on both sides
_UNUSUAL_UM = (0.05, 50_000.0)  # where the user says that it is no paper
_LEAST_SHARE = 0.15  # of the columns with more than air: with less there is no map
_LEAVES = 0.2  # of the columns: where the sheet leaves the volume in fewer, its axis is not questioned
_THINNER = 1 / 6  # of the run along an axis: what a sheet that is seen edge on measures along its normal, or less


def check_sheet(surfaces: xr.Dataset, *, unusual_size: bool) -> None:
    """Raise VolumeError where a sheet is not as thick as sheets are, or too few of its columns are measured."""
    thickness, (low, high) = float(surfaces.attrs["thickness_um"]), _UNUSUAL_UM if unusual_size else _THICKNESS_UM
    if not low <= thickness <= high:
        voxel = ", ".join(f"{v:g}" for v in surfaces.attrs["voxel_um"])
        raise VolumeError(
            f"The sheet would be {thickness:.3g} um thick; sheets of {low:g} to {high:g} um are mapped. The voxel size "
            f"of {voxel} um (z, y, x) is probably in another unit. Give the right one with --voxel-um and "
            "--override-size, or add --unusual-size if it is no paper."
        )
    measured = float((surfaces["status"].values == 0).mean())
    measured /= max(1.0 - float(surfaces.attrs.get("empty_share", 0.0)), measured)
    if measured < _LEAST_SHARE:
        raise VolumeError(
            f"Both faces of the sheet were found in {100 * measured:.1f} % of the columns only that are not all air; "
            f"{100 * _LEAST_SHARE:.0f} % are needed for a map. Check --through and --sheet-grey, and that the sheet "
            "does not leave the volume."
        )


def check_axis(columns: Columns, survey: Survey, params: SurfaceParams, engine: Engine) -> None:
    """Raise VolumeError, before every column is searched, where the sheet is seen edge on along the axis of the search.

    Only a sheet that leaves the volume in many columns is looked at along the axis of its likely normal, too. There it
    has to stay inside, and to be a sixth as thick or less: its normal is more than 80 degrees off the axis given.
    """
    coarse = survey.coarse
    if coarse.leaves.mean() < _LEAVES:
        return
    axis = likely_through(columns.volume.variable)
    if axis is None or axis == columns.frame.through:
        return
    try:
        other = take_survey(replace(columns, frame=Frame(through=axis), padding=None), params, engine)
    except VolumeError:
        return
    runs = [float(np.nanmedian((s.high - s.low) * p)) for s, p in (
        (coarse, columns.pitch[2]), (other.coarse, replace(columns, frame=Frame(through=axis)).pitch[2])
    )]  # fmt: skip
    if other.coarse.leaves.mean() < _LEAVES and runs[1] < _THINNER * runs[0]:
        raise VolumeError(
            f"The sheet is seen edge on: along {columns.frame.through} it leaves the volume in "
            f"{100 * coarse.leaves.mean():.0f} % of the columns, and is {runs[0]:.0f} um thick in the others."
        )
