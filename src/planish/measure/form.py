"""The form of a face, and the face's height above it: the S-F surface of ISO 25178-2.

The F-operator is the Gaussian regression of second order that the centre surface is made with
(ISO 16610-31 without its robust weights, applied twice; its nesting index passes by half), over
lengths in the sheet. Its paraboloids run up to the border and across holes.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import interpolate

from planish.core.grid import filled
from planish.core.threads import map_threads
from planish.core.typing import Bools, Floats, Ints, Pair
from planish.measure import _form_kernels
from planish.measure.rays import slopes_of
from planish.measure.registry import HEIGHTS

F_OPERATOR = "Gaussian regression of second order, applied twice"
_NODES = 16  # along the nesting index, or a field that is shorter


def above_form(
    faces: Mapping[str, Floats],
    centre_um: Floats,
    is_valid: Bools,
    pitch_um: Pair,
    *,
    names: Sequence[str],
    nesting_um: float,
) -> dict[str, Floats]:
    """Topographies and base surfaces: outward heights of faces above their own forms, um.

    ``faces``, ``centre_um``: (rows, cols) as :func:`planish.measure.rays.meet` gives them.
    ``is_valid``: where heights are wanted. ``nesting_um``: wavelength along the sheet of which the
    form has half.
    """
    shape = centre_um.shape
    slopes = slopes_of(centre_um, pitch_um)
    has_normal = np.isfinite(slopes).all(axis=-1) & np.isfinite(centre_um)
    is_known = is_valid & has_normal
    for name in names:
        is_known &= np.isfinite(faces[HEIGHTS[name]])
    if not is_known.any():
        return {name: np.full(shape, np.nan) for name in names}
    # As wide as that of the centre surface, see planish.surface.centre.
    width_um = 0.887 * nesting_um
    starts: list[Ints] = []
    reach: list[int] = []
    for n, p in zip(shape, pitch_um, strict=True):
        block = max(1, min(int(nesting_um / p), n) // _NODES)
        starts.append(np.arange(0, n, block))
        reach.append(int(np.ceil(1.5 * width_um / (block * p))))

    def sums(field: Floats, mask: Bools) -> Floats:
        by_rows = np.add.reduceat(np.where(mask, field, 0.0), starts[0], axis=0)
        return np.add.reduceat(by_rows, starts[1], axis=1)

    def means(fields: Sequence[Floats], mask: Bools) -> Floats:
        """Of the masked columns of each block; after them their number."""
        count = sums(np.ones(1), mask)
        n_known = np.maximum(count, 1)
        return np.stack([*(sums(field, mask) / n_known for field in fields), count], axis=-1)

    y_um, x_um = (np.arange(n) * p for n, p in zip(shape, pitch_um, strict=True))
    fields = [y_um[:, None], x_um, centre_um, *np.moveaxis(-slopes, -1, 0)]
    sheet = means(fields, has_normal)
    # A block outside the sheet has no place.
    place = np.where(sheet[..., -1:] > 0, sheet[..., :3], np.nan)
    normal = sheet[..., 3:]
    normal[..., 2] = 1.0
    stretch = np.linalg.norm(normal, axis=-1)
    normal /= stretch[..., None]
    distance = means([faces[HEIGHTS[name]] for name in names], is_known)
    weight = distance[..., -1] * stretch
    distance = np.ascontiguousarray(distance[..., :-1])

    def regressed(height_um: Floats, shape: float) -> Floats:
        def row(i: int) -> Floats:
            matrix, right = _form_kernels.normal_equations(
                i, place, normal, weight, height_um, tuple(reach), width_um, shape
            )
            full = matrix[:, :1, :1]
            ridge = 1e-9 * full + (full == 0)
            terms = np.linalg.solve(matrix + ridge * np.eye(6), right)
            return np.where(full[:, 0] > 0, terms[:, 0], np.nan)

        return np.stack(map_threads(row, range(len(place))))

    form = regressed(distance, 1.0)
    form += regressed(distance - form, 0.0)
    above: dict[str, Floats] = {}
    for k, name in enumerate(names):
        outwards = 1.0 if name.endswith("top") else -1.0
        form_um = _of_columns(filled(form[..., k]), starts, shape)
        height_um = outwards * (faces[HEIGHTS[name]] - form_um)
        above[name] = np.where(is_valid, height_um, np.nan)
    return above


def _of_columns(nodes: Floats, starts: Sequence[Ints], shape: tuple[int, ...]) -> Floats:
    """Give the columns of blocks, which begin at ``starts``, values by those of their middles."""
    for axis, first in enumerate(starts):
        n = shape[axis]
        middles = 0.5 * (first + np.append(first[1:], n) - 1)
        degree = min(3, first.size - 1)
        spline = interpolate.make_interp_spline(middles, nodes, k=degree, axis=axis)
        nodes = spline(np.arange(n))
    return nodes
