"""Where there is sheet, where the rims of its holes are, and its outline with the holes filled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_HOLE_UM = 600.0  # a gap wider than this is missing sheet, not a hole


def regions(
    seen: NDArray[np.bool_], pitch: tuple[float, float], rim_um: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where the sheet is, the rims of its holes, and its outline with the holes filled."""
    step = float(np.sqrt(pitch[0] * pitch[1]))
    # Single columns without a face are gaps of the measurement; only larger ones are gaps of the sheet.
    reach = max(1, round(12.0 / step)) if min(seen.shape) * step > 100 else 1
    padded = np.pad(seen, 2 * reach, mode="edge")
    inner = (slice(2 * reach, -2 * reach),) * 2
    sheet = ndimage.binary_closing(padded, _disc(reach))
    sheet = ndimage.binary_opening(sheet, _disc(reach))[inner] | ndimage.binary_erosion(sheet, _disc(1))[inner]
    gap = ~sheet
    rim = np.zeros_like(sheet)
    if gap.any():
        rim = (ndimage.distance_transform_edt(sheet, sampling=pitch) <= rim_um) & sheet
        if not rim.all() and (rim | gap).mean() > 0.98:
            rim = np.zeros_like(sheet)
    labels, count = ndimage.label(gap)
    outline = sheet.copy()
    if count:
        border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
        area = np.bincount(labels.ravel(), minlength=count + 1) * pitch[0] * pitch[1]
        fill = area <= np.pi / 4 * _HOLE_UM**2
        small_cut = area <= np.pi / 4 * (0.5 * _HOLE_UM) ** 2
        fill[border] &= small_cut[border]
        fill[0] = False
        outline |= fill[labels]
    return sheet, rim, outline


def _disc(radius: int) -> NDArray[np.bool_]:
    y, x = np.ogrid[-radius : radius + 1, -radius : radius + 1]
    return x * x + y * y <= radius * radius + 0.5
