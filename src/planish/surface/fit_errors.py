"""How far the fit of a coating is off: the sheet is made again as it was found, and fitted again.

In patches of the sheet a coating with the faces that were found is blurred on a base with the walls
and pores of the sheet's own core, beside the sheet's own air. What the fit makes of it is compared
with these faces.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from planish.core.grid import filled
from planish.core.threads import map_threads
from planish.core.tiles import Tile
from planish.core.typing import Floats, Ints, Shape2D, Singles, TwoFields
from planish.surface.alone import patches_of
from planish.surface.coarse import CORE
from planish.surface.columns import Columns, Guide, Priors, Side, blended, oriented
from planish.surface.faces import fit_job, fit_side, fit_tile, largest_step_px

_COLUMNS = 2**15  # of the patches
_CLASSES = 8  # of thickness, of as many columns each; fewer where they would be of chance
_MOST = (0.05, 0.95)  # quantiles between which most columns are
_NO_ERROR = 1e-6  # voxels: a scan without any noise is fitted as well as that
_LEAST = 1000  # columns
_SEED = 0  # of what is drawn: a sheet has the same errors whenever it is read
_PLACE = 4.0  # standard deviation of a place with a grey of its own, in columns
_LEAST_AIR = 6  # voxels of air that show its noise
_BLURS = 8.0  # widths of the blur beyond the expected faces: no fit looks farther


def fit_errors(columns: Columns, guide: Guide, priors: Priors) -> dict[bool, Floats]:
    """Return the errors of each coated side (True: at the high end), (4, bins) in voxels.

    The thickness of a coating, and the standard deviations of the errors of its face, of its
    thickness and of its interface. A side of which too few columns were fitted is left out.
    """
    if not any(priors.coated):
        return {}
    jobs = [(columns, guide, priors, patch) for patch in patches_of(columns, guide, _COLUMNS)]
    by_patch = map_threads(_patch_errors, jobs)
    errors: dict[bool, Floats] = {}
    for from_high in (True, False):
        values = [patch[from_high] for patch in by_patch if from_high in patch]
        if sum(part.shape[1] for part in values) >= _LEAST:
            errors[from_high] = _by_thickness(np.concatenate(values, axis=1))
    return errors


def _by_thickness(values: Floats) -> Floats:
    """Mean thickness and root mean squares of errors in classes of thickness, (4, classes).

    ``values`` (4, columns): thickness, and errors of face, thickness and interface, in voxels;
    their means are taken off first.
    """
    thickness = values[0]
    errors = values[1:]
    errors = errors - errors.mean(axis=1, keepdims=True)
    # A class is no narrower than one error to either side: within that, which column is in which
    # class is chance.
    thin, thick = np.quantile(thickness, _MOST)
    least_width = 2.0 * max(float(errors[1].std()), _NO_ERROR)
    classes = int(np.clip((thick - thin) / least_width, 1, _CLASSES))
    order = np.argsort(thickness, kind="stable")
    rows: list[list[float]] = []
    for part in np.array_split(order, classes):
        mean_squares = np.mean(errors[:, part] ** 2, axis=1)
        rms = np.sqrt(mean_squares)
        rows.append([thickness[part].mean(), *rms])
    return np.transpose(rows)


def _patch_errors(job: tuple[Columns, Guide, Priors, Tile]) -> dict[bool, Floats]:
    """Thickness as fitted again, and errors of face, thickness and interface, by side.

    Each (4, columns) in voxels: an error is what the second fit gives less what the coating was
    made with.
    """
    columns, guide, priors, patch = job
    depths = fit_tile(fit_job(columns, guide, priors, patch), patch)
    part = guide.part(patch)
    single_columns = replace(priors.scale, blend_sd=0.0)
    grey, _ = oriented(columns, patch, part, single_columns)
    # The blur is as wide across the columns as along them, where it is in columns.
    width = priors.edge.width
    voxel_um = columns.pitch[2]
    sd_px = [width * voxel_um / p for p in columns.pitch[:2]]
    # Film and other material beside the sheet are not made again.
    plain_edge = replace(priors.edge, fringe=0.0)
    again = replace(priors, edge=plain_edge, embedded_level=0.0)
    # Columns whose neighbours are not all in the patch are blurred and averaged with too few.
    border = max(priors.scale.halo, int(3.0 * max(sd_px)) + 1)
    inside = (slice(border, -border),) * 2
    errors: dict[bool, Floats] = {}
    for k, from_high in enumerate((True, False)):
        face, thickness = depths[2 * k : 2 * k + 2]
        is_known = np.zeros(face.shape, bool)
        is_known[inside] = np.isfinite(face + thickness)[inside]
        if not priors.sides[from_high].coated or not is_known.any():
            continue
        outer, opposite = part.faces(grey.shape[2], from_high=from_high)
        inward = grey[..., ::-1] if from_high else grey
        whole_face = filled(face)
        interface = whole_face + filled(thickness)
        layers = _sharpened(whole_face, sd_px), _sharpened(interface, sd_px)
        # Far outside and far below nothing is made, as no fit looks there.
        steepest = float(np.nanmin(part.cos_tilt))
        margin = (priors.search_px + _BLURS * width) / steepest
        start = max(int(np.nanmin(outer) - margin), 0)
        stop = min(int(np.nanmax(opposite) + margin) + 1, inward.shape[2])
        remade = _remade(
            inward,
            layers,
            (outer, opposite),
            priors,
            from_high,
            [*sd_px, width],
            np.arange(start, stop),
        )
        stored = np.ascontiguousarray(remade[..., ::-1] if from_high else remade)
        remade = blended(stored, part, priors.scale, columns.step)
        expected = outer - start, opposite - start, part.cos_tilt
        fit = fit_side(remade, expected, again, columns, from_high)
        fit[0] += start
        # What is seen through the blur across the columns is a layer that is blurred like it.
        true_face, true_interface = (
            ndimage.gaussian_filter(layer, sd_px, mode="nearest") for layer in layers
        )
        fit_face, fit_thickness = fit[:2]
        off_thickness = fit_thickness - true_interface + true_face
        off_interface = fit_face + fit_thickness - true_interface
        off = fit_face - true_face, off_thickness, off_interface
        is_known &= np.isfinite(fit_thickness)
        # A face that stands so far off is left out as a spike. A fit that took a light place of the
        # core for coating is astray: no standard error tells of it.
        for error in off[:2]:
            is_known &= np.abs(error) <= largest_step_px(error[is_known], voxel_um)
        errors[from_high] = np.stack([fit_thickness, *off])[:, is_known]
    return errors


def _sharpened(layer: Floats, sd_px: list[float]) -> Floats:
    """Undo the blur of a layer that was found, so that it comes out of the blur as rough again."""
    return 2.0 * layer - ndimage.gaussian_filter(layer, sd_px, mode="nearest")


def _remade(
    inward: Singles,
    layers: TwoFields,
    expected: TwoFields,
    priors: Priors,
    from_high: bool,
    sd_px: list[float],
    depth: Ints,
) -> Singles:
    """Grey of a coating between two layers, as the scan would show it, above the air.

    ``inward`` (rows, cols, depth): the scan's own grey, read from outside, which gives air and
    base. ``layers``: depth of the face and of the interface, ``expected``: of both faces of the
    sheet by the coarse search, (rows, cols) in voxels. ``sd_px``: of the blur along rows and
    columns, and along the depth. ``depth`` (n,): the depths that are made, one by one; given are
    (rows, cols, n).
    """
    # The blur that was found has the voxel in it, and so do the shares of the voxels below.
    depth_sd_px = np.sqrt(max(sd_px[2] ** 2 - 1.0 / 12.0, 0.0))
    blur_px = [*sd_px[:2], depth_sd_px]
    below_layer: list[Singles] = []
    for layer in layers:
        from_layer = depth.astype(np.float32) - layer[..., None].astype(np.float32)
        share = np.clip(from_layer + np.float32(0.5), 0.0, 1.0)
        below_layer.append(ndimage.gaussian_filter(share, blur_px))
    below_face, base = below_layer
    # To and fro through the core, of which every depth of the base is made.
    outer = filled(expected[0])[..., None]
    thickness = filled(expected[1] - expected[0])[..., None]
    first = outer + CORE[0] * thickness
    length = np.maximum((CORE[1] - CORE[0]) * thickness, 3.0)
    from_first = np.abs((depth - first) % (2.0 * length) - length)
    core_index = np.rint(first + from_first).astype(int)
    core = np.take_along_axis(inward, np.clip(core_index, 0, inward.shape[2] - 1), axis=2)
    coating_grey = _coating_grey(priors.sides[from_high], inward.shape[:2])
    remade = coating_grey[..., None] * (below_face - base) + core * base
    air = _air(inward, expected, priors.search_px)
    if air.shape[2] >= _LEAST_AIR:
        air_index = np.arange(air.shape[2])
        to_and_fro = np.concatenate([air_index, air_index[::-1]])
        noise = air[..., np.resize(to_and_fro, inward.shape[2])[depth]]
        remade += noise * np.sqrt(np.maximum(1.0 - base**2, 0.0))
    return remade.astype(np.float32, copy=False)


def _coating_grey(side: Side, shape: Shape2D) -> Singles:
    """Grey of a coating that differs from place to place as far as it was seen to."""
    grey = np.full(shape, side.level[2], np.float32)
    if side.lone is not None and side.lone.spread > 0:
        drawn = np.random.default_rng(_SEED).standard_normal(shape)
        field = ndimage.gaussian_filter(drawn, _PLACE, mode="wrap")
        deviation = side.lone.spread * field / field.std()
        grey += deviation.astype(np.float32)
    return grey


def _air(inward: Singles, expected: TwoFields, search_px: float) -> Singles:
    """Air on that side of the sheet that has the more even one: on the other a film may lie.

    (rows, cols, samples), of no samples where there is too little air on both. ``expected``: of
    both faces.
    """
    outside = int(np.nanmin(expected[0]) - search_px)
    behind = inward.shape[2] - 1 - expected[1]
    beyond = int(np.nanmin(behind) - search_px)
    air_outside = inward[..., : max(outside, 0)]
    air_beyond = inward[..., ::-1][..., : max(beyond, 0)]
    enough = [air for air in (air_outside, air_beyond) if air.shape[2] >= _LEAST_AIR]
    return min(enough, key=np.nanstd, default=inward[..., :0])
