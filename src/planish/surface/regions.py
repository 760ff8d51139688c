"""Where there is sheet, where the rims of its holes are, and its outline with the holes filled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.surface.coarse import CoarseSheet, flags_to_columns
from planish.surface.oriented import Guide

_MERGED = 1.6  # times the usual thickness: two sheets that touch, or one that folds back
_BESIDE = 2  # columns beside such a place whose faces it disturbs
_HOLE_UM = 600.0  # a gap wider than this is missing sheet, not a hole
_EDGE_UM = 20.0  # kept clear of the sheet's edge, which nothing has burnt


def regions(
    seen: NDArray[np.bool_], runs_out: NDArray[np.bool_], pitch: tuple[float, float], rim_um: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where the sheet is, the rims of its holes and edges, and its outline with the holes filled.

    A hole is a gap no wider than 600 um; ``rim_um`` around it is burnt. Other gaps are the end of the sheet or of the
    field of view. A gap of columns that run out of the volume (``runs_out``) is neither: the sheet goes on there.
    """
    step = float(np.sqrt(pitch[0] * pitch[1]))
    # Single columns without a face are gaps of the measurement; only larger ones are gaps of the sheet.
    reach = max(1, round(12.0 / step)) if min(seen.shape) * step > 100 else 1
    padded = np.pad(seen, 2 * reach, mode="edge")
    inner = (slice(2 * reach, -2 * reach),) * 2
    sheet = ndimage.binary_closing(padded, _disc(reach))
    sheet = ndimage.binary_opening(sheet, _disc(reach))[inner] | ndimage.binary_erosion(sheet, _disc(1))[inner]
    labels, count = ndimage.label(~sheet)
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    area = np.bincount(labels.ravel(), minlength=count + 1) * pitch[0] * pitch[1]
    hole = area <= np.pi / 4 * _HOLE_UM**2
    hole[border] &= area[border] <= np.pi / 8 * _HOLE_UM**2  # half of it lies beyond the border
    hole[0] = False
    columns = np.maximum(np.bincount(labels.ravel(), minlength=count + 1), 1)
    goes_on = np.bincount(labels.ravel(), weights=runs_out.ravel(), minlength=count + 1) > 0.5 * columns
    goes_on[0] = False
    hole &= ~goes_on
    holes = hole[labels]
    rim = _near(holes, pitch, rim_um) | _near(~sheet & ~holes & ~goes_on[labels], pitch, min(rim_um, _EDGE_UM))
    return sheet, rim & sheet, sheet | holes


def doubtful(
    guide: Guide, coarse: CoarseSheet, width: float, depth: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Columns in which the sheet touches another or itself, and those in which it may run out of the volume."""
    extent = (guide.high - guide.low) * guide.tilt
    known = np.isfinite(extent)
    usual = float(np.median(extent[known])) if known.any() else np.inf
    touching = known & (np.where(known, extent, 0.0) > _MERGED * usual + 2.0 * width)
    touching |= flags_to_columns(coarse.touching, coarse.block, extent.shape)
    if touching.any():
        touching = ndimage.binary_dilation(touching, _disc(_BESIDE))
    # Two widths of the blur and the block's own inaccuracy are needed outside a face.
    margin = 2.0 * width / guide.tilt + 2.0
    near = (guide.low < margin) | (guide.high > depth - 1 - margin)
    return touching, flags_to_columns(coarse.leaves, coarse.block, extent.shape) | near


def _near(region: NDArray[np.bool_], pitch: tuple[float, float], distance_um: float) -> NDArray[np.bool_]:
    """Columns within a distance of a region."""
    if not region.any():
        return np.zeros_like(region)
    return np.asarray(ndimage.distance_transform_edt(~region, sampling=pitch)) <= distance_um


def _disc(radius: int) -> NDArray[np.bool_]:
    y, x = np.ogrid[-radius : radius + 1, -radius : radius + 1]
    return x * x + y * y <= radius * radius + 0.5
