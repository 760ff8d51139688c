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
from planish.core.typing import Bools, Floats, Ints, NamedFields, Pair, Shape
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
) -> NamedFields:
    """Topographies and base surfaces: outward heights of faces above their own forms, um.

    By name, (rows, cols); NaN where not wanted. ``faces``, ``centre_um``: (rows, cols) as
    :func:`planish.measure.rays.meet` gives them. ``is_valid`` (rows, cols): where heights are
    wanted. ``pitch_um``: of rows and of columns. ``names``: of ``HEIGHTS``; their forms are made
    from the columns in which all of them are known. ``nesting_um``: wavelength along the sheet of
    which the form has half.
    """
    # The form is made at nodes, each the mean of a block of columns.
    shape = centre_um.shape
    slopes = slopes_of(centre_um, pitch_um)
    rise_y, rise_x = np.moveaxis(slopes, -1, 0)
    has_normal = np.isfinite(rise_y + rise_x + centre_um)
    is_known = is_valid & has_normal
    for name in names:
        is_known &= np.isfinite(faces[HEIGHTS[name]])
    if not is_known.any():
        return {name: np.full(shape, np.nan) for name in names}
    # As wide as that of the centre surface, see planish.surface.centre.
    width_um = 0.887 * nesting_um
    starts: list[Ints] = []  # first row, and first column, of each block
    reach: list[int] = []  # of the regression, in nodes along rows and along columns
    for n, p in zip(shape, pitch_um, strict=True):
        block = max(1, min(int(nesting_um / p), n) // _NODES)
        starts.append(np.arange(0, n, block))
        # Beyond that the kernel gives no weight.
        reach.append(int(np.ceil(1.5 * width_um / (block * p))))

    def sums(field: Floats, mask: Bools) -> Floats:
        masked = np.where(mask, field, 0.0)
        by_rows = np.add.reduceat(masked, starts[0], axis=0)
        return np.add.reduceat(by_rows, starts[1], axis=1)

    def means(fields: Sequence[Floats], mask: Bools) -> Floats:
        """Of the masked columns of each block; after them their number."""
        count = sums(np.ones(1), mask)
        n_known = np.maximum(count, 1)
        block_means = [sums(field, mask) / n_known for field in fields]
        return np.stack([*block_means, count], axis=-1)

    y_um = np.arange(shape[0])[:, None] * pitch_um[0]
    x_um = np.arange(shape[1]) * pitch_um[1]
    sheet = means([y_um, x_um, centre_um, -rise_y, -rise_x], has_normal)
    place = sheet[..., :3].copy()
    # A block outside the sheet has no place.
    place[sheet[..., -1] == 0] = np.nan
    # The normal of a surface of height z is (-dz/dy, -dz/dx, 1) over its length.
    normal = sheet[..., 3:]
    normal[..., 2] = 1.0
    stretch = np.linalg.norm(normal, axis=-1)
    normal /= stretch[..., None]
    distance = means([faces[HEIGHTS[name]] for name in names], is_known)
    # By the area in the sheet that a block's columns stand for.
    weight = distance[..., -1] * stretch
    distance = np.ascontiguousarray(distance[..., :-1])

    def regressed(height_um: Floats, shape: float) -> Floats:
        """Heights of the paraboloids at the nodes, (rows, cols, names); see the kernel."""

        def row(i: int) -> Floats:
            matrix, right = _form_kernels.normal_equations(
                i, place, normal, weight, height_um, tuple(reach), width_um, shape
            )
            full_weight = matrix[:, :1, :1]
            # A node without neighbours has an empty system: one that can be solved takes its place.
            ridge = 1e-9 * full_weight + (full_weight == 0)
            terms = np.linalg.solve(matrix + ridge * np.eye(6), right)
            return np.where(full_weight[:, 0] > 0, terms[:, 0], np.nan)

        return np.stack(map_threads(row, range(len(place))))

    form = regressed(distance, 1.0)
    # A second time, over what the first left behind.
    form += regressed(distance - form, 0.0)
    above: NamedFields = {}
    for k, name in enumerate(names):
        outwards = 1.0 if name.endswith("top") else -1.0
        form_um = _of_columns(filled(form[..., k]), starts, shape)
        height_um = outwards * (faces[HEIGHTS[name]] - form_um)
        above[name] = np.where(is_valid, height_um, np.nan)
    return above


def _of_columns(nodes: Floats, starts: Sequence[Ints], shape: Shape) -> Floats:
    """Give the columns of blocks, which begin at ``starts``, values by those of their middles."""
    for axis, first in enumerate(starts):
        n = shape[axis]
        middles = 0.5 * (first + np.append(first[1:], n) - 1)
        degree = min(3, first.size - 1)
        spline = interpolate.make_interp_spline(middles, nodes, k=degree, axis=axis)
        nodes = spline(np.arange(n))
    return nodes
