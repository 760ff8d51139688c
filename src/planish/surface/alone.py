"""Grey of a coating, from voxels that are coating in all three directions.

Blur dims a coating from outside, from the base, and in a narrow valley from its sides as well. A
voxel that lies some widths of the blur from every face shows the coating's own grey. Such voxels
are looked for in patches of columns: a ball rolls inside along both faces of the coating, and what
it does not reach is alone.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy import ndimage

from planish.core.grid import at_index
from planish.core.threads import map_threads
from planish.core.tiles import Tile, tiles_of
from planish.core.typing import Floats, Ints, TwoFields
from planish.surface.columns import Columns, Guide, LoneGrey, Pitch, Priors, oriented
from planish.surface.faces import fit_job, fit_tile

RADII = (4.0, 3.68, 3.39, 3.11, 2.86)
"""Radius of the ball in widths of the blur; the first that leaves enough is taken. A plane at the
last takes 0.2 % of its step off, and at all of them a fit that is half a width off does no harm."""
_ENOUGH = 500  # voxels
_BLOCK_UM = 100.0  # greys of places farther apart are independent
_EDGE, _PATCH_VOXELS = 96, 2**20  # of a patch: columns along an edge, and voxels at most
_ROUND, _ROUNDS = 2**16, 2  # columns of a round of patches; another one where too little was seen
_OF_MEDIAN = float(np.sqrt(0.5 * np.pi))  # standard error of a median over that of a mean
_LEAST_PLACES = 2.0  # whose differences say how sure their median is
_UNKNOWN = 1e6  # depth of a face that is not known: nothing beside it is alone


def lone_greys(columns: Columns, guide: Guide, priors: Priors) -> dict[bool, LoneGrey]:
    """Return the grey of each coated side (True: at the high end) that shows it anywhere.

    ``priors``: of a first look; their blur and greys may be somewhat off.
    """
    if not any(priors.coated):
        return {}
    greys: dict[bool, LoneGrey] = {}
    for from_high, sums in _lone_sums(columns, guide, priors).items():
        grey = _grey(sums)
        if grey is not None:
            greys[from_high] = grey
    return greys


def _lone_sums(columns: Columns, guide: Guide, priors: Priors) -> dict[bool, Floats]:
    """Sums over lone voxels by side, (fields, radii, blocks), of so many patches as are needed.

    The fields are those of :func:`_run_sums`. A second round of patches is read where a side shows
    too few lone voxels in the first one.
    """
    patches = patches_of(columns, guide, _ROUNDS * _ROUND)
    per_round = -(-len(patches) // _ROUNDS)
    sums: dict[bool, Floats] = {}
    for start in range(0, len(patches), per_round):
        jobs = [(columns, guide, priors, patch) for patch in patches[start : start + per_round]]
        for patch_sums in map_threads(_patch_sums, jobs):
            for k, field in patch_sums.items():
                before = [sums[k]] if k in sums else []
                sums[k] = np.concatenate([*before, field], axis=2)
        if min(field[0, 0].sum() for field in sums.values()) >= _ENOUGH:
            break
    return sums


def patches_of(columns: Columns, guide: Guide, most: int) -> list[Tile]:
    """Tiles with a sheet of some ``most`` columns together, spread over all of it.

    The first of them are spread over it as well.
    """
    edge = int(np.clip(np.sqrt(_PATCH_VOXELS / columns.shape[2]), 16, _EDGE))
    has_sheet = np.isfinite(guide.low)
    all_tiles = tiles_of(columns.shape[:2], (edge, edge))
    tiles = [tile for tile in all_tiles if has_sheet[tile.rows, tile.cols].any()]
    order = np.argsort((np.arange(len(tiles)) * 0.6180339887498949) % 1.0)  # the golden section
    most_tiles = max(most // edge**2, 1)
    return [tiles[k] for k in order[:most_tiles]]


def _patch_sums(job: tuple[Columns, Guide, Priors, Tile]) -> dict[bool, Floats]:
    """Sums over lone voxels of a patch by side: (fields, radii, blocks).

    The fields are those of :func:`_run_sums`, the radii ``RADII``, and the blocks squares of the
    patch whose greys are taken for independent.
    """
    columns, guide, priors, patch = job
    depths = fit_tile(fit_job(columns, guide, priors, patch), patch)
    # As it is: neighbours would dim what lies beside a face.
    scale = replace(priors.scale, blend_sd=0.0)
    grey, _ = oriented(columns, patch, guide.part(patch), scale)
    block_row, block_col = map(_block_numbers, patch.shape, columns.pitch)
    block_cols = block_col[-1] + 1
    block_index = (block_row[:, None] * block_cols + block_col).ravel()
    # A fringe reaches as far as a blur of its own width.
    edge = priors.edge
    unit_px = max(edge.width, edge.fringe_width) if edge.fringe else edge.width
    unit_um = unit_px * columns.pitch[2]
    sums: dict[bool, Floats] = {}
    for k, from_high in enumerate((True, False)):
        if not priors.sides[from_high].coated:
            continue
        outer, thickness = depths[2 * k : 2 * k + 2]
        inner = outer + thickness
        if not np.isfinite(inner).any():
            continue
        first = max(int(np.nanmin(outer)), 0)  # depth of the first voxel that may be coating
        inward_grey = grey[..., ::-1] if from_high else grey
        coating_grey = np.nan_to_num(inward_grey[..., first : int(np.nanmax(inner)) + 2])
        # Sums of the grey from there down to each voxel, of which runs are differences.
        summed = np.zeros((*patch.shape, coating_grey.shape[2] + 1))
        np.cumsum(coating_grey, axis=2, dtype=np.float64, out=summed[..., 1:])
        by_radius: list[Floats] = []
        for radius in RADII:
            lone = _beyond_ball(outer - first, inner - first, radius * unit_um, columns.pitch)
            fields = _run_sums(summed, *lone)
            block_sums = [np.bincount(block_index, field.ravel()) for field in fields]
            by_radius.append(np.array(block_sums, np.float64))
        sums[from_high] = np.stack(by_radius, axis=1)
    return sums


def _block_numbers(count: int, pitch_um: float) -> Ints:
    """Number of the block of each of so many rows or columns."""
    block_um = min(_BLOCK_UM, count * pitch_um / 3.0)
    return (np.arange(count) * pitch_um // block_um).astype(int)


def _beyond_ball(outer: Floats, inner: Floats, radius_um: float, pitch_um: Pitch) -> TwoFields:
    """First and last depth, in voxels, that lie a radius from both faces and from missing ones.

    Each (rows, cols), of a layer from ``outer`` to ``inner`` (rows, cols), in voxels from outside,
    NaN where not known. The last lies before the first where nothing does.
    """
    down, across = (int(radius_um / p) for p in pitch_um[:2])
    rows, cols = np.ogrid[-down : down + 1, -across : across + 1]
    square_um2 = radius_um**2 - (rows * pitch_um[0]) ** 2 - (cols * pitch_um[1]) ** 2
    ball: Any = np.sqrt(np.maximum(square_um2, 0.0)) / pitch_um[2]
    is_known = np.isfinite(outer) & np.isfinite(inner)
    rolled = partial(
        ndimage.grey_dilation,
        footprint=square_um2 >= 0,
        structure=ball,
        mode="constant",
        cval=_UNKNOWN,
    )
    lowered = rolled(np.where(is_known, outer, _UNKNOWN))
    raised = rolled(np.where(is_known, -inner, _UNKNOWN))
    return lowered, -raised


def _run_sums(summed: Floats, first: Floats, last: Floats) -> list[Floats]:
    """Fields of the voxels from first to last depth of each column, (rows, cols) each.

    Their number, the sum of their greys, the number in one half of them, and the sums of the greys
    in the outer and in the inner half; a middle voxel is in neither. ``summed`` (rows, cols, depth
    + 1): sums of the grey above each depth.
    """
    depth_count = summed.shape[2] - 1
    start = np.clip(np.ceil(first), 0, depth_count).astype(int)
    stop = np.clip(np.floor(last) + 1, start, depth_count).astype(int)
    count = stop - start
    half = count // 2
    at_start = at_index(summed, start)
    at_stop = at_index(summed, stop)
    outer = at_index(summed, start + half) - at_start
    inner = at_stop - at_index(summed, stop - half)
    return [count, at_stop - at_start, half, outer, inner]


def _grey(sums: Floats) -> LoneGrey | None:
    """Grey of a side from its sums (fields, radii, blocks); None where too few voxels are alone.

    The fields are those of :func:`_run_sums`. The largest radius of ``RADII`` that leaves enough
    voxels is taken.
    """
    for radius in range(len(RADII)):
        count, grey, half, outer, inner = (field[radius] for field in sums)
        if count.sum() < _ENOUGH:
            continue
        level, error, spread = _weighted(grey, count)
        deepening, deepening_error, half_spread = _weighted(inner - outer, half)
        if half.sum() ** 2 < _LEAST_PLACES * np.square(half).sum():
            deepening = deepening_error = 0.0  # one place shows both halves: nothing is known
        # Noise moves the difference of two halves twice as far as their mean.
        noise = 0.5 * half_spread
        true_spread = float(np.sqrt(max(spread**2 - noise**2, 0.0)))
        return LoneGrey(
            level=level,
            error=error,
            spread=true_spread,
            deepening=deepening,
            deepening_error=deepening_error,
        )
    return None


def _weighted(total: Floats, count: Floats) -> tuple[float, float, float]:
    """Median of the blocks' means, its standard error and the spread between the blocks.

    From sums and counts (blocks,); 0 of nothing. All are weighted by the blocks' counts. A laser
    chars the coating around its holes: a mean would follow such places, a median does not.
    """
    is_seen = count > 0
    if not is_seen.any():
        return 0.0, 0.0, 0.0
    weight = count[is_seen] / count.sum()
    means = total[is_seen] / count[is_seen]
    median = float(np.quantile(means, 0.5, weights=weight, method="inverted_cdf"))
    deviation = means - median
    blocks = max(weight.size, 2)
    mean_variance = np.sum((weight * deviation) ** 2) * blocks / (blocks - 1)
    error = _OF_MEDIAN * np.sqrt(mean_variance)
    spread = np.sqrt(np.sum(weight * deviation**2))
    return median, float(error), float(spread)
