"""Whether a sheet of another size than paper's is found by its texture as paper is.

``python -m benchmarks no_holes_scales [PAIRS [FIRST]]``

The pairs are those of ``no_holes`` whose texture r is at least .3: maps with pixels of 4 um, images
with pixels of 2.6 to 8 um. Each is linked as it is, and with all lengths at 1/100 and at 100 times.
Printed are, by pair, the rms distance to the truth over the map in pixels of the coarser layer, and
at the end that of all pairs against paper's, and true over stated error.
"""

from __future__ import annotations

import numpy as np

from benchmarks.no_holes import SHEETS, draw_pair
from benchmarks.shared import rms
from planish.core.errors import CannotRegister
from planish.run import register_texture

_LEAST_R, _MOST_R = 0.3, 0.8
_SCALES = (1.0, 0.01, 100.0)
_MOST_APART, _STATED = 0.1, (0.7, 1.4)


def main(pairs=10, first=0):
    """Print residuals and errors by scale; 1 where a limit is missed."""
    rows = []
    for number in sorted(range(first, first + 4 * pairs), key=lambda k: k % SHEETS):
        pair = draw_pair(number)
        if not _LEAST_R <= pair.r <= _MOST_R:
            continue
        rows.append([_off(pair, scale) for scale in _SCALES])
        off = ", ".join(f"{true:.3f} ({true / stated:.2f})" for true, stated in rows[-1])
        pixel_um = float(pair.image.x[1])
        print(
            f"pair {number}, image of {pixel_um:g} um, texture r {pair.r:.2f}: off by {off} pixels"
            " (of what is stated) at 1, 1/100, 100",
            flush=True,
        )
        if len(rows) == pairs:
            break
    true, stated = np.array(rows).transpose(2, 1, 0)
    ratios = [rms(one) for one in true / stated]
    against_paper = [rms(one) / rms(true[0]) for one in true]
    for scale, one, share, ratio in zip(_SCALES, true, against_paper, ratios, strict=True):
        print(
            f"at {scale:g}: {len(rows)} pairs, off by {rms(one):.3f} pixels (rms), {share:.3f} of"
            f" paper's; true over stated error {ratio:.2f}"
        )
    apart = max(abs(share - 1.0) for share in against_paper)
    is_honest = all(_STATED[0] <= ratio <= _STATED[1] for ratio in ratios)
    return int(not (apart <= _MOST_APART and is_honest))


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
