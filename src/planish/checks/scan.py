"""Checks of a scan: all those of a volume and of the sheet that was found in it."""

from __future__ import annotations

import numpy as np
import xarray as xr

from planish.checks.blur import blur_check
from planish.checks.dust import dust_check
from planish.checks.greys import Greys, clipping_check, steadiness_check
from planish.checks.shading import shading_check
from planish.checks.sheets import core_places, layers_check, voxels_check
from planish.checks.slice_checks import slice_checks
from planish.checks.windows import read_windows
from planish.core.checks import Check
from planish.core.frame import Axis, Frame


def check_scan(
    volume: xr.DataArray, measured: xr.Dataset, *, sections: bool = False, labels: bool = False,
    threads: int | None = None,
) -> tuple[Check, ...]:  # fmt: skip
    """Check a volume and the sheet that was measured in it.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um
        Parts of it are read, in one pass.
    measured : Dataset, dims (y, x)
        Surfaces and properties, heights in um.
    sections : bool
        Whether planish joined serial sections to the volume: what it bridged itself is no fault.
    labels : bool
        Whether voxels are labels, which have no grey scale.
    threads : int, optional
        No result depends on it.
    """
    frame = Frame.of(measured)
    every: tuple[Axis, ...] = ("z", "y", "x")
    assembled = every if labels else every[:1] if sections else ()
    air = 0.0 if labels else float(measured.attrs["grey_air"])
    core = None if labels else core_places(volume, measured)
    reading = read_windows(
        volume, through=frame.through, sheet=_reach(volume, measured, frame),
        points=None if core is None else core.points, missing=air, threads=threads,
    )  # fmt: skip
    voxels = voxels_check(volume, measured)
    checks: list[Check | None] = [*slice_checks(reading.windows, through=frame.through, assembled=assembled)]
    if core is not None:
        greys = Greys.of(measured)
        checks += [
            clipping_check(reading.sample, greys),
            steadiness_check([w for w in reading.windows if w.axis not in (*assembled, frame.through)], greys),
            shading_check(core, reading.grey, greys, through=frame.through),
            layers_check(core, reading.grey, greys, resolved=voxels.state == "pass"),
            blur_check(volume, measured),
        ]
    checks += [voxels, *(dust_check(measured, side) for side in ("top", "bottom"))]
    return tuple(check for check in checks if check is not None)


def _reach(volume: xr.DataArray, measured: xr.Dataset, frame: Frame) -> tuple[int, int]:
    """First and last slice along the axis through the sheet that hold it."""
    heights = np.asarray(volume.coords[frame.through].values, dtype=np.float64)
    faces = np.stack([measured["top"].values, measured["bottom"].values])
    low, high = np.nanmin(faces), np.nanmax(faces)
    last = heights.size - 1
    return tuple(int(np.clip(np.searchsorted(heights, height), 0, last)) for height in (low, high))  # pyright: ignore[reportReturnType]
