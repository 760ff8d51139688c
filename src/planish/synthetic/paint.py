"""The bare sheet in a box of voxels, and the filters that every instrument shares."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planish.core.typing import Floats
from planish.synthetic import _kernels
from planish.synthetic.fields import PITCH_UM
from planish.synthetic.sheet import Sheet
from planish.synthetic.warp import Warp

Slab = NDArray[np.float32]
_BLOCK = 192  # columns painted together: the sheet then fills much of the box around it


def painted(
    sheet: Sheet, warp: Warp, ys_um: Floats, *, shape: tuple[int, int], step_um: float,
    grey: tuple[float, float, float], halo: int, moved: Floats,
) -> list[tuple[int, int, Slab]]:  # fmt: skip
    """Paint the planes at ``ys_um``, of ``shape`` (x, z) voxels of ``step_um``, in blocks as deep as the sheet is.

    Painted is what the sheet adds to the ``grey`` of air (before those of base and coating), so that air stays an exact
    0 under any filter. Each plane is ``moved`` (3, rows) along x, along z, and turned about its middle. Gives (first
    column, first depth, block); blocks are (rows, cols + 2 halo, depth + 2 halo), column and depth those of the block's
    first voxel inside the halo. Around them there is only air.
    """
    middle_um = 0.5 * (shape[0] - 1) * step_um, 0.5 * (shape[1] - 1) * step_um
    shift_x, shift_z, turn = moved
    w, curve = warp.packed()
    thick = sheet.reach_um + 2 * step_um
    half = 1.05 * thick * float(np.hypot(1.0, warp.steepest))
    done: list[tuple[int, int, Slab]] = []
    for start in range(0, shape[0], _BLOCK):
        stop = min(start + _BLOCK, shape[0])
        xs = np.arange(start - halo, stop + halo) * step_um
        under = np.concatenate(
            [_kernels.columns(w, curve, ys_um[i : i + 1], xs + shift_x[i]) for i in range(ys_um.size)]
        )
        middle = under[..., 2] - shift_z[:, None] - turn[:, None] * (xs - middle_um[0])
        first = max(int(np.floor((middle.min() - half) / step_um)) - halo, 0)
        last = min(int(np.ceil((middle.max() + half) / step_um)) + halo, shape[1] - 1)
        if last < first:
            continue
        block = np.zeros((ys_um.size, xs.size, last - first + 1 + 2 * halo), dtype=np.float32)
        _kernels.paint(
            block, w, curve, ys_um, xs, first - halo, step_um, shift_x, shift_z, turn, np.array(middle_um), under,
            half, sheet.packed, np.array(sheet.origin), PITCH_UM, np.array([grey[1] - grey[0], grey[2] - grey[0]]),
        )  # fmt: skip
        done.append((start, first, block))
    return done


def gaussian_taps(sigma: float) -> NDArray[np.float32]:
    """Symmetric taps [centre, 1, 2, ...] of a Gaussian of ``sigma`` voxels, cut at four sigma; [1] for 0."""
    reach = int(np.ceil(4 * sigma)) if sigma > 0 else 0
    taps = np.exp(-0.5 * (np.arange(reach + 1) / max(sigma, 1e-9)) ** 2)
    return (taps / (taps[0] + 2 * taps[1:].sum())).astype(np.float32)


def smooth(slab: Slab, taps: NDArray[np.float32], axes: tuple[int, ...]) -> Slab:
    """Filter along the axes; the result is shorter by the taps' reach at each end of them."""
    reach = taps.size - 1
    for axis in axes if reach else ():
        shape = list(slab.shape)
        shape[axis] -= 2 * reach
        done = np.empty(shape, dtype=np.float32)
        # Plane by plane, so that a plane stays in the processor's cache.
        for plane, out in zip(np.moveaxis(slab, axis, 1), np.moveaxis(done, axis, 1), strict=True):
            parts = [plane[k : k + len(out)] for k in range(2 * reach + 1)]
            np.multiply(parts[reach], taps[0], out=out)
            for k in range(1, reach + 1):
                out += taps[k] * (parts[reach - k] + parts[reach + k])
        slab = done
    return slab


def trimmed(slab: Slab, cut: int, axes: tuple[int, ...]) -> Slab:
    """Cut voxels off both ends of the axes."""
    if cut == 0:
        return slab
    return slab[tuple(slice(cut, -cut) if axis in axes else slice(None) for axis in range(slab.ndim))]
