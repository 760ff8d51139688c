"""The form of a face, and the face's height above it: the S-F surface of ISO 25178-2.

The F-operator is the Gaussian regression of second order that the centre surface is made with
(ISO 16610-31 without its robust weights, applied twice; its nesting index passes by half), over
lengths in the sheet. Its paraboloids run up to the border and across holes.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import interpolate

from planish.core.grid import filled
from planish.core.threads import count_threads, map_threads
from planish.core.typing import Bools, Floats, Pair
from planish.measure import _form_kernels
from planish.measure.rays import slopes_of

F_OPERATOR = "Gaussian regression of second order, applied twice"
_NODES = 16  # along the nesting index
_SURFACES = {"topography": "{}", "base_surface": "interface_{}"}


def above_form(
    distance_um: Mapping[str, Floats],
    centre_um: Floats,
    is_valid: Bools,
    pitch_um: Pair,
    *,
    nesting_um: float,
) -> dict[str, Floats]:
    """Heights of surfaces above their own forms along the normals of a centre surface, um.

    Parameters
    ----------
    distance_um : mapping of (rows, cols)
        From the centre surface to each surface, along the normals.
    centre_um : (rows, cols)
        Height of the centre surface.
    is_valid : (rows, cols)
        Where all distances are known.
    pitch_um : (float, float)
    nesting_um : float
        Wavelength, along the sheet, of which the form has half.
    """
    blocks = [
        max(1, min(int(nesting_um / _NODES / p), n // 4))
        for p, n in zip(pitch_um, centre_um.shape, strict=True)
    ]
    starts = [np.arange(0, n, b) for n, b in zip(centre_um.shape, blocks, strict=True)]

    def total(field: Floats, mask: Bools) -> Floats:
        masked = np.where(mask, field, 0.0)
        return np.add.reduceat(np.add.reduceat(masked, starts[0], 0), starts[1], 1)

    slopes = slopes_of(centre_um, pitch_um)
    has_normal = np.isfinite(slopes).all(axis=-1) & np.isfinite(centre_um)
    is_known = is_valid & has_normal
    for field in distance_um.values():
        is_known &= np.isfinite(field)
    lengths = [np.arange(n) * p for n, p in zip(centre_um.shape, pitch_um, strict=True)]
    lines = np.meshgrid(*lengths, indexing="ij")
    ones: Floats = np.ones(centre_um.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        columns = total(ones, has_normal)
        place = np.stack([total(f, has_normal) / columns for f in (*lines, centre_um)], axis=-1)
        uphill = [total(slopes[..., k], has_normal) / columns for k in (0, 1)]
    normal = np.stack([-uphill[0], -uphill[1], np.ones(columns.shape)], axis=-1)
    stretch = np.linalg.norm(normal, axis=-1)
    normal /= stretch[..., None]
    known = total(ones, is_known)
    weight = np.nan_to_num(known * stretch)
    sums = [total(field, is_known) for field in distance_um.values()]
    distance = np.stack(sums, axis=-1) / np.maximum(known, 1.0)[..., None]
    # As wide as that of the centre surface, see planish.surface.centre.
    width_um = 0.887 * nesting_um
    reach = tuple(
        int(np.ceil(1.5 * width_um / b / p)) for b, p in zip(blocks, pitch_um, strict=True)
    )

    def regressed(height_um: Floats, shape: float) -> Floats:
        def some_rows(rows: slice) -> Floats:
            lower, right = _form_kernels.normal_equations(
                place, normal, weight, height_um, rows.start, rows.stop, reach, width_um, shape
            )
            matrix = lower + np.swapaxes(np.tril(lower, -1), -1, -2)
            full = matrix[..., :1, :1]
            terms = np.linalg.solve(matrix + (1e-9 * full + (full == 0)) * np.eye(6), right)
            return np.where(full[..., 0] > 0, terms[..., 0, :], np.nan)

        step = max(1, -(-len(weight) // (4 * count_threads())))
        parts = [slice(k, min(k + step, len(weight))) for k in range(0, len(weight), step)]
        return np.concatenate(map_threads(some_rows, parts))

    form = regressed(distance, 1.0)
    form += regressed(distance - form, 0.0)
    above: dict[str, Floats] = {}
    for k, (name, surface_um) in enumerate(distance_um.items()):
        form_um = filled(form[..., k])
        for axis, first in enumerate(starts):
            ends = np.append(first[1:], centre_um.shape[axis])
            spline = interpolate.make_interp_spline(
                0.5 * (first + ends - 1), form_um, k=min(3, first.size - 1), axis=axis
            )
            form_um = spline(np.arange(centre_um.shape[axis]))
        above[name] = surface_um - form_um
    return above


def outward_heights(
    faces: Mapping[str, Floats],
    centre_um: Floats,
    is_valid: Bools,
    pitch_um: Pair,
    *,
    names: Sequence[str],
    nesting_um: float,
) -> dict[str, Floats]:
    """Topographies and base surfaces: outward heights of faces above their own forms, um.

    ``faces``, ``centre_um``: as :func:`planish.measure.rays.meet` gives them. NaN for the base
    surface of a side without a coating, whose interface is its face.
    """
    distance_um: dict[str, Floats] = {}
    for name in names:
        kind, side = name.rsplit("_", 1)
        surface = _SURFACES[kind].format(side)
        if kind == "topography" or faces[surface] is not faces[side]:
            distance_um[name] = faces[surface]
    above = above_form(distance_um, centre_um, is_valid, pitch_um, nesting_um=nesting_um)
    heights_um: dict[str, Floats] = {}
    for name in names:
        outwards = 1.0 if name.endswith("top") else -1.0
        heights_um[name] = outwards * above.get(name, np.full(centre_um.shape, np.nan))
    return heights_um
