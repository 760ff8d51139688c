"""Whether a sheet of another size than paper's is found by its texture as paper is.

``python -m benchmarks no_holes_scales [PAIRS [FIRST]]``

The pairs are those of ``no_holes`` whose texture r is at least .3: maps with pixels of 4 um, but
images with pixels of 2 to 30 um. Each is linked as it is, and with all lengths at 1/100 and at 100
times. Printed are, by pair, the rms distance to the truth over the map in pixels of the coarser
layer. At the end, for pairs whose coarser pixel is 4 to 8.6 um, which have paper's numbers at every
scale, and for the others: how many are linked at each scale, the distance of those that are linked
at all of them against paper's, and true over stated error.
"""

from __future__ import annotations

import numpy as np

from benchmarks.no_holes import SHEETS, draw_pair
from benchmarks.shared import rms
from planish.core.errors import CannotRegister
from planish.run import register_texture

_LEAST_R, _MOST_R = 0.3, 0.8
_PIXELS_UM, _PROPORTIONAL_UM = (2.0, 3.2, 5.0, 8.0, 12.0, 20.0, 30.0), 8.6
_SCALES = (1.0, 0.01, 100.0)
_MOST_APART, _STATED = 0.1, (0.7, 1.4)


def main(pairs=10, first=0):
    """Print residuals and errors by scale; 1 where a limit is missed."""
    rows, pixels_um = [], []
    for number in sorted(range(first, first + 4 * pairs), key=lambda k: k % SHEETS):
        pixel_um = _PIXELS_UM[number % len(_PIXELS_UM)]
        pair = draw_pair(number, pixel_um=pixel_um)
        if not _LEAST_R <= pair.r <= _MOST_R:
            continue
        rows.append([_off(pair, scale) for scale in _SCALES])
        pixels_um.append(pixel_um)
        off = ", ".join(f"{true:.3f} ({true / stated:.2f})" for true, stated in rows[-1])
        print(
            f"pair {number}, image of {pixel_um:g} um, texture r {pair.r:.2f}: off by {off} pixels"
            " (of what is stated) at 1, 1/100, 100",
            flush=True,
        )
        if len(rows) == pairs:
            break
    is_proportional = np.array(pixels_um) <= _PROPORTIONAL_UM
    errors, is_missed = np.array(rows), False
    for which, title in ((is_proportional, "up to 8 um"), (~is_proportional, "of 12 um and more")):
        if which.any():
            is_missed |= _is_missed(errors[which], f"pixels {title}")
    return int(is_missed)


def _is_missed(errors, title):
    """Print a line by scale; whether a scale is worse than paper's, or what is stated is wrong."""
    is_linked = np.isfinite(errors[..., 0])
    true, stated = errors[is_linked.all(axis=1)].transpose(2, 1, 0)
    is_missed = False
    for k, scale in enumerate(_SCALES):
        ratio, share = rms(true[k] / stated[k]), rms(true[k]) / rms(true[0])
        print(
            f"{title}, at {scale:g}: {is_linked[:, k].sum()} of {len(errors)} linked; of"
            f" {true.shape[1]}, off by {rms(true[k]):.3f} pixels (rms), {share:.3f} of paper's;"
            f" true over stated error {ratio:.2f}"
        )
        is_missed |= is_linked[:, k].sum() < is_linked[:, 0].sum()
        is_missed |= abs(share - 1.0) > _MOST_APART or not _STATED[0] <= ratio <= _STATED[1]
    return bool(is_missed)


def _off(pair, scale):
    """Rms distance to the truth over the map, and the stated one, in pixels of the coarser layer;
    infinite where the pair was refused."""
    maps, image = (
        data.assign_coords({dim: scale * data[dim].values for dim in data.dims})
        for data in (pair.maps, pair.image)
    )
    image.attrs["pixel_um"] = [scale * float(pair.image[dim][1]) for dim in ("y", "x")]
    pixel_um = max(float(maps.v[1] - maps.v[0]), *image.attrs["pixel_um"])
    try:
        found = register_texture(maps, image)
    except CannotRegister:
        return np.inf, np.inf
    points = np.stack(np.meshgrid(pair.maps.u[::10], pair.maps.v[::10]), axis=-1).reshape(-1, 2)
    errors_um = np.linalg.norm(found(scale * points) - scale * pair.pose(points), axis=1)
    return rms(errors_um) / pixel_um, rms(found.fit.expected_error_um(scale * points)) / pixel_um
