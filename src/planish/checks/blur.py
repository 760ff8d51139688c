"""Sharpness of a scan against its coating: the width of its edges, and of its noise."""

from __future__ import annotations

import numpy as np
import xarray as xr

from planish.core.checks import POSITION, PROPERTIES, Check
from planish.core.frame import Frame
from planish.core.typing import Floats

_FWHM = 2.3548  # of a Gaussian, in standard deviations
_EDGE = 32  # voxels along the edge of a block of air
_DEPTH = 8  # voxels of a block along the axis through the sheet
_GAP = 6  # voxels between the sheet and a block
_PLACES = 4  # blocks along either axis of the sheet, on either side
_QUIET = 0.5  # steps of the grey scale: noise that is less is that of rounding
_LAGS = 12  # voxels


def blur_check(volume: xr.DataArray, measured: xr.Dataset) -> Check | None:
    """Judge whether a coating is thicker than the blur of the scan is wide; None where none is seen.

    What is flattened lies between the faces: where they are moved, so are its places.

    A filter that keeps edges, as a median, takes thin layers away all the same. The noise of the air shows it.
    """
    names = [k for k in ("coating_top", "coating_bottom") if k in measured and np.isfinite(measured[k].values).any()]
    if not names:
        return None
    thin = min(float(np.nanmedian(measured[k].values)) for k in names)
    edge, noise = _FWHM * float(measured.attrs["blur_um"]), noise_width(volume, measured)
    width = max(edge, noise) if np.isfinite(noise) else edge
    cause = "An edge is blurred" if width == edge else "The noise is smoothed"
    return Check.at_most(
        "blur of the scan", width / max(thin, 1e-9), look=1.0, units="of the coating", figures=(PROPERTIES, POSITION),
        sentence=f"{cause} over {width:.3g} um, full width at half maximum; the coating is {thin:.3g} um thick.",
        advice="Thickness and grey level of a layer that is thinner than the blur cannot be distinguished. Scan with "
        "smaller voxels, and leave out filters that smooth.",
    )  # fmt: skip


def noise_width(volume: xr.DataArray, measured: xr.Dataset) -> float:
    """Full width at half maximum of a Gaussian filter that smooths white noise to that of the air, um; NaN without air.

    It is that of the noise's autocorrelation over the root of two.
    """
    frame = Frame.of(measured)
    coordinates = {k: np.asarray(volume.coords[k].values, dtype=np.float64) for k in ("z", "y", "x")}
    heights = coordinates[frame.through]
    faces = np.stack([measured["top"].values, measured["bottom"].values]).astype(np.float64)
    lags = np.zeros(_LAGS)
    for row, col in _blocks(frame, coordinates):
        inside = [
            (measured[dim].values >= ends[0]) & (measured[dim].values <= ends[1])
            for dim, ends in (("y", coordinates[frame.rows][[row.start, row.stop - 1]]),
                             ("x", coordinates[frame.cols][[col.start, col.stop - 1]]))
        ]  # fmt: skip
        faces_here = faces[:, inside[0]][:, :, inside[1]]
        if not np.isfinite(faces_here).any():
            continue
        low, high = (np.searchsorted(heights, f(faces_here)) for f in (np.nanmin, np.nanmax))
        for start, stop in ((high + _GAP, high + _GAP + _DEPTH), (low - _GAP - _DEPTH, low - _GAP)):
            if start < 0 or stop > heights.size:
                continue
            part = volume.isel({frame.through: slice(start, stop), frame.rows: row, frame.cols: col})
            grey = np.asarray(part.transpose(frame.rows, frame.cols, frame.through).values, dtype=np.float64)
            grey -= grey.mean()
            variance = float(np.mean(grey**2))
            if np.isfinite(variance) and variance > _QUIET**2 * (volume.dtype.kind != "f"):
                lags += _products(grey)
    if not lags[0] > lags[-1]:
        return float("nan")
    # What goes on farther is no noise but streaks and shading.
    share = (lags - lags[-1]) / (lags[0] - lags[-1])
    k = int(np.argmax(share < 0.5))
    half = k - (0.5 - share[k]) / (share[k - 1] - share[k])
    return np.sqrt(2.0) * half * float(np.cbrt(np.prod([float(v) for v in volume.attrs["voxel_um"]])))


def _products(grey: Floats) -> Floats:
    """Mean product with the neighbour at 0, 1, 2 ... voxels along the two axes of the sheet."""
    sides = grey, grey.swapaxes(0, 1)
    means = [[float(np.mean(v[k:] * v[: len(v) - k])) for v in sides] for k in range(_LAGS)]
    return np.array(means, dtype=np.float64).mean(axis=1)


def _blocks(frame: Frame, coordinates: dict[str, Floats]) -> list[tuple[slice, slice]]:
    """Rows and columns (voxels) of places spread over the sheet."""
    sides: list[list[slice]] = []
    for n in (coordinates[axis].size for axis in (frame.rows, frame.cols)):
        starts = np.unique(np.linspace(0, n - _EDGE, _PLACES + 2)[1:-1].astype(int)) if n >= _EDGE else []
        sides.append([slice(int(k), int(k) + _EDGE) for k in starts])
    return [(row, col) for row in sides[0] for col in sides[1]]
