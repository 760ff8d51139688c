"""Find where there is sheet, the rims of its holes, its filled outline, and half-closed holes."""

import numpy as np
from scipy import ndimage, spatial

from planish.core.typing import Bools, Floats, Pair
from planish.surface.coarse import MERGED, CoarseSheet, flags_to_columns
from planish.surface.columns import Guide

_HOLE_UM = 600.0  # a gap wider than this is missing sheet, not a hole


def regions(
    is_sheet: Bools, runs_out: Bools, pitch: Pair, rim_um: float
) -> tuple[Bools, Bools, Bools]:
    """Return where the sheet is, the rims of its holes and edges, and its outline, holes filled.

    All (rows, cols). ``is_sheet``: columns in which a sheet was seen; ``pitch``: of rows and of
    columns, um.
    A hole is a gap no wider than 600 um; ``rim_um`` around it is burnt. Other gaps are the end of
    the sheet or of the field of view. A gap of columns that run out of the volume (``runs_out``) is
    neither: the sheet goes on there.
    """
    pitch_um = float(np.sqrt(pitch[0] * pitch[1]))
    # Single columns without a face are gaps of the measurement; only larger ones are gaps of the
    # sheet.
    is_wide = min(is_sheet.shape) * pitch_um > 100
    radius_px = max(1, round(12.0 / pitch_um)) if is_wide else 1
    padded = np.pad(is_sheet, 2 * radius_px, mode="edge")
    inner = (slice(2 * radius_px, -2 * radius_px),) * 2
    is_closed = ndimage.binary_closing(padded, _disc(radius_px))
    is_open = ndimage.binary_opening(is_closed, _disc(radius_px))
    in_sheet = (is_open | ndimage.binary_erosion(is_closed, _disc(1)))[inner]
    labels, gap_count = ndimage.label(~in_sheet)
    flat_labels = labels.ravel()
    column_count = np.bincount(flat_labels, minlength=gap_count + 1)
    # Half of a hole at the border lies beyond it.
    max_area_um2 = np.full(gap_count + 1, np.pi / 4 * _HOLE_UM**2)
    for ends in (labels[[0, -1]], labels[:, [0, -1]]):
        max_area_um2[ends] = np.pi / 8 * _HOLE_UM**2
    leaving_count = np.bincount(flat_labels, runs_out.ravel(), gap_count + 1)
    is_continued = leaving_count > 0.5 * np.maximum(column_count, 1)
    is_hole = (column_count * pitch[0] * pitch[1] <= max_area_um2) & ~is_continued
    in_hole = is_hole[labels] & ~in_sheet
    # The sheet's edge, which nothing has burnt, is kept clear of 20 um.
    is_beyond_edge = ~in_sheet & ~in_hole & ~is_continued[labels]
    in_rim = _near(in_hole, pitch, rim_um) | _near(is_beyond_edge, pitch, min(rim_um, 20.0))
    return in_sheet, in_rim & in_sheet, in_sheet | in_hole


def doubtful(
    guide: Guide, coarse_sheet: CoarseSheet, width: float, depth: int
) -> tuple[Bools, Bools]:
    """Columns where the sheet touches another or itself, and where it may run out of the volume.

    Both (rows, cols). ``width`` of the blur and ``depth`` of the columns in voxels.
    """
    extent = (guide.high - guide.low) * guide.cos_tilt
    is_finite = np.isfinite(extent)
    is_touching = np.zeros(extent.shape, bool)
    if is_finite.any():
        typical_extent = float(np.median(extent[is_finite]))
        is_touching = extent > MERGED * typical_extent + 2.0 * width
    is_touching |= flags_to_columns(coarse_sheet.is_touching, coarse_sheet.block, extent.shape)
    if is_touching.any():
        # The columns beside whose faces it disturbs.
        is_touching = ndimage.binary_dilation(is_touching, _disc(2))
    # Two widths of the blur and the block's own inaccuracy are needed outside a face.
    margin_px = 2.0 * width / guide.cos_tilt + 2.0
    may_run_out = (guide.low < margin_px) | (guide.high > depth - 1 - margin_px)
    may_run_out |= flags_to_columns(coarse_sheet.is_leaving, coarse_sheet.block, extent.shape)
    return is_touching, may_run_out


def _near(region: Bools, pitch: Pair, distance_um: float) -> Bools:
    if not region.any():
        return np.zeros_like(region)
    return np.asarray(ndimage.distance_transform_edt(~region, sampling=pitch)) <= distance_um


def _disc(radius: int) -> Bools:
    y, x = np.ogrid[-radius : radius + 1, -radius : radius + 1]
    return x * x + y * y <= radius * radius + 0.5


def half_closed(is_sheet: Bools, runs_out: Bools, pitch: Pair) -> Floats:
    """Middles (n, 2), in columns, of the holes of which less than 70 % is open.

    A hole is compared with its own ellipse, and where there are three or more, with the usual
    ellipse of all: what has half closed with a straight edge is a smaller ellipse of its own.
    ``is_sheet``: columns with a sheet; ``runs_out``: columns in which it goes on beyond the volume.
    """
    holes = all_holes(is_sheet | runs_out, pitch)
    open_um2 = holes[:, 2]
    ellipse_um2 = holes[:, 3]
    typical_um2 = float(np.median(ellipse_um2)) if len(holes) >= 3 else 0.0
    is_half_closed = open_um2 < 0.7 * np.maximum(ellipse_um2, typical_um2)
    return holes[is_half_closed, :2]


def all_holes(in_sheet: Bools, pitch: Pair) -> Floats:
    """Gaps of the sheet between 40 and 600 um wide that do not reach the border of the map, (n, 4).

    Row and column of the middle; area without sheet, and of the ellipse with the second moments of
    the convex outline, in um2.
    """
    pitch_um = float(np.sqrt(pitch[0] * pitch[1]))
    radius_px = max(1, round(3.0 / pitch_um))
    # Fibres and flaps across a hole belong to its outline, single columns without a face do not.
    in_gap = ndimage.binary_opening(~in_sheet, np.ones((2, 2), bool))
    gap_labels, _ = ndimage.label(ndimage.binary_dilation(in_gap, iterations=radius_px))
    holes: list[tuple[float, ...]] = []
    border_labels = {*gap_labels[[0, -1]].flat, *gap_labels[:, [0, -1]].flat}
    for k, (rows, cols) in enumerate(ndimage.find_objects(gap_labels), start=1):
        if k in border_labels:
            continue
        in_hole = in_gap[rows, cols] & (gap_labels[rows, cols] == k)
        points = np.argwhere(in_hole)
        points_um = points.astype(float) * np.array(pitch)
        # Fewer than eight columns, or columns in one line, show no outline.
        if len(points) < 8 or np.ptp(points_um, axis=0).min() <= 0:
            continue
        ellipse_um2 = _ellipse(points_um)
        if np.pi / 4 * 40.0**2 <= ellipse_um2 <= np.pi / 4 * _HOLE_UM**2:
            row, col = points_um.mean(axis=0) / pitch
            open_um2 = len(points) * pitch[0] * pitch[1]
            holes.append((rows.start + row, cols.start + col, open_um2, ellipse_um2))
    return np.array(holes).reshape(-1, 4)


def _ellipse(points: Floats) -> float:
    """Area of the ellipse with the second moments of the convex hull of ``points`` (n, 2).

    Area, middle and moments of a polygon are sums over its edges, from (x, y) to (x1, y1). 0 where
    the points have no hull.
    """
    try:
        hull = points[spatial.ConvexHull(points).vertices]
    except spatial.QhullError:
        return 0.0
    x, y = (hull - hull.mean(axis=0)).T
    x1, y1 = np.roll((x, y), -1, axis=1)
    cross = x * y1 - x1 * y
    area = 0.5 * cross.sum()
    middle_x = ((x + x1) * cross).sum() / (6 * area)
    middle_y = ((y + y1) * cross).sum() / (6 * area)
    xx = ((x * x + x * x1 + x1 * x1) * cross).sum() / (12 * area) - middle_x**2
    yy = ((y * y + y * y1 + y1 * y1) * cross).sum() / (12 * area) - middle_y**2
    xy = ((x * y1 + 2 * x * y + 2 * x1 * y1 + x1 * y) * cross).sum() / (24 * area)
    xy -= middle_x * middle_y
    return float(4 * np.pi * np.sqrt(max(xx * yy - xy * xy, 0.0)))
