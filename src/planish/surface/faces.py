"""Both faces and interfaces of every column, tile by tile."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.grid import at_index, filled
from planish.core.robust import mad_sd, masked_gaussian
from planish.core.threads import map_threads
from planish.core.tiles import Engine, Tile
from planish.core.typing import (
    Array,
    Bools,
    Floats,
    Ints,
    NamedFields,
    Singles,
    ThreeFields,
    TwoFields,
)
from planish.surface import _fit_kernels
from planish.surface.columns import (
    WALL_UM,
    Columns,
    Edge,
    Guide,
    Pitch,
    Priors,
    Side,
    join_tiles,
    oriented,
)

_FLOATS = 3.0  # voxels outside the coarse sheet: two of air and one for its own inaccuracy
_MOST_OF = 0.8
_AROUND = 5  # columns along the edge of a neighbourhood
# Faces this far apart, so many along an edge: a fibre of 40 um takes less than a fifth of them.
_SPARSE_UM, _SPARSE_AROUND = 20.0, 11
_LEVEL_DOUBT = 0.14  # of a wall's grey: what filler and walls thinner than the blur leave open
FitJob = tuple[Columns, Guide, Priors, Floats | None]
"""Of a tile's fit: the guide is that of the tile and its halo; of (2, rows, cols), where given,
only columns with a number, and those next to them, are fitted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Faces:
    """Faces of every column."""

    # Of both faces and the interfaces below them, (rows, cols) in um; NaN where nothing was found.
    heights: NamedFields
    below_particle: Bools  # (rows, cols): columns below an attached particle
    particles: int  # how many were removed
    # By side without a coating, in um: how far the face moves where the wall's grey is a little
    # off, in each column (rows, cols) and in the mean of all.
    level_errors: dict[str, tuple[Floats, float]] = field(default_factory=dict)


def find_faces(
    columns: Columns, guide: Guide, priors: Priors, engine: Engine, particles: int
) -> Faces:
    """Fit every column from both ends; so many ``particles`` float in the air beside the sheet.

    What was fitted at first is fitted again below plates that float on the sheet, and where noise
    hid a face. Amid other material there is no air for that. In a base of bare walls and pores a
    fibre that stands out loosely is replaced by the next wall below it.
    """
    depths = _fit("faces", columns, guide, priors, engine)
    if not priors.embedded_level:
        particles += _fit_below(depths, columns, guide, priors, engine)
        _fit_lost(depths, columns, guide, priors, engine)
    has_wall = [priors.sides[from_high].wall_level > 0 for from_high in (True, False)]
    for k in np.flatnonzero(has_wall):
        # Of such a side the next wall stands in place of the thickness of a coating.
        face, next_wall = depths[2 * k : 2 * k + 2]
        # Below a fibre that stands out there is a void.
        is_loose = _loose_fibres(face, columns.pitch) & np.isfinite(next_wall)
        depths[2 * k] = np.where(is_loose, next_wall, face)
        depths[2 * k + 1] = 0.0
    cleaned = not has_wall[0], not has_wall[1]
    return faces_from_depths(depths, columns, priors.coated, cleaned=cleaned, particles=particles)


def fit_job(
    columns: Columns, guide: Guide, priors: Priors, tile: Tile, search_depths: Floats | None = None
) -> FitJob:
    """Return what the fit of a tile needs, from the guide and the depths of all columns.

    ``search_depths`` (2, rows, cols) as in ``FitJob``.
    """
    if search_depths is not None:
        search_depths = search_depths[:, tile.rows, tile.cols]
    grown = priors.scale.grown(tile, columns.shape[:2])
    return columns, guide.part(grown), priors, search_depths


def _fit(
    step: str,
    columns: Columns,
    guide: Guide,
    priors: Priors,
    engine: Engine,
    search_depths: Floats | None = None,
) -> Floats:
    """Fit all columns, or those of the tiles in which a face is looked for at a depth.

    Returns what :func:`fit_tile` says of all columns; 0 or NaN where nothing was fitted. ``step``
    names the work for the engine.
    """

    def job(tile: Tile) -> FitJob:
        return fit_job(columns, guide, priors, tile, search_depths)

    tiles = columns.tiles(engine)
    if search_depths is not None:
        is_searched = np.isfinite(search_depths)
        tiles = [t for t in tiles if is_searched[:, t.rows, t.cols].any()]
    depths = np.full((_planes(priors), *columns.shape[:2]), np.nan)
    return join_tiles(engine.map(step, fit_tile, job, tiles), depths)


def _fit_below(
    depths: Floats, columns: Columns, guide: Guide, priors: Priors, engine: Engine
) -> int:
    """Put the face below what floats in the air in its place; return how many plates float.

    ``depths`` (4 or 6, rows, cols), as :func:`fit_tile` returns them, are changed.

    The coarse sheet is one connected object: what is seen far outside it hangs on nothing, and the
    face is looked for again below it. Where the gap is so narrow that the coarse search saw one
    object, a plate with a step all around is tried too. Such plates are counted here; what floats
    farther away was counted by the coarse search.
    """
    search_depths = np.empty((2, *depths.shape[1:]))
    plates = map_threads(_plates, -depths[:4:2], repeat(columns.pitch))
    for k, (plate_labels, opened) in enumerate(plates):
        in_plate = plate_labels > 0
        coarse_face, _ = guide.faces(columns.shape[2], from_high=k == 0)
        expected = np.where(in_plate, -opened, coarse_face)
        is_floating = in_plate | (expected - depths[2 * k] > _FLOATS / guide.cos_tilt)
        search_depths[k] = np.where(is_floating, expected, np.nan)
    depths_below = _fit("faces_below", columns, guide, priors, engine, search_depths)
    floating_count = 0
    for k, (plate_labels, _) in enumerate(plates):
        is_better = np.isfinite(search_depths[k] + depths_below[2 * k])
        # A plate floats when there is a face below most of it.
        is_floating_plate = _is_mostly(is_better, plate_labels)
        floating_count += int(np.count_nonzero(is_floating_plate))
        in_floating = is_floating_plate[plate_labels]
        is_better &= (plate_labels == 0) | in_floating
        depths[2 * k][in_floating & ~is_better] = np.nan
        # Face, thickness, and how far the wall's grey moves the face where that is given.
        planes = [plane for plane in (2 * k, 2 * k + 1, 4 + k) if plane < len(depths)]
        depths[planes] = np.where(is_better, depths_below[planes], depths[planes])
    return floating_count


def _fit_lost(
    depths: Floats, columns: Columns, guide: Guide, priors: Priors, engine: Engine
) -> None:
    """Fit a coated face that was lost in noise again, from where its neighbours say.

    Noise just outside a face may be taken for it, and with next to no coating a face may be too
    faint to be searched for. ``depths``, as :func:`fit_tile` returns them, are changed.
    """
    search_depths = np.full((2, *depths.shape[1:]), np.nan)
    usual_px = np.zeros(2)
    for k in np.flatnonzero(priors.coated):
        around, is_lost, usual_px[k] = _lost(depths[2 * k], columns.pitch[2])
        search_depths[k] = np.where(is_lost, around, np.nan)
    # The fit then starts where the face is expected and searches for nothing.
    known_place = replace(priors, search_px=0.0)
    fits = _fit("faces_again", columns, guide, known_place, engine, search_depths)
    for k in range(2):
        planes = slice(2 * k, 2 * k + 2)
        # What lies farther off is something else, such as the rim of a particle.
        deviation_px = np.abs(fits[2 * k] - search_depths[k])
        is_found = deviation_px <= usual_px[k]
        depths[planes] = np.where(is_found, fits[planes], depths[planes])


def faces_from_depths(
    depths: Floats,
    columns: Columns,
    coated: tuple[bool, bool],
    *,
    cleaned: tuple[bool, bool] = (False, False),
    particles: int,
) -> Faces:
    """Turn depths into heights.

    ``depths`` (4 or 6, rows, cols) in voxels: depth of the face and thickness of the coating,
    counted from the high end, then from the low end, and, of a base of bare walls, how far either
    face moves with the wall's grey. ``coated``, ``cleaned``: of the sides at the high and at the
    low end, whether there is a coating, and whether spikes and attached particles are taken off.
    ``particles``: how many were removed before.
    """
    first_um = float(columns.depth_um[0])
    step_um = columns.pitch[2]
    below_particle = np.zeros(depths.shape[1:], bool)
    heights: NamedFields = {}
    level_errors: dict[str, tuple[Floats, float]] = {}
    faces = map_threads(_cleaned, depths[:4:2], repeat(columns.pitch), cleaned)
    for k, (outer, is_particle) in enumerate(faces):
        side = columns.frame.side_at(from_high=k == 0)
        if len(depths) > 4:
            # The rms of neighbours: whether a wall is seen or not is chance in one column.
            off = depths[4 + k]
            is_finite = np.isfinite(off)
            mean_square, weight = masked_gaussian(off**2, is_finite, [3.0, 3.0], truncate=3.0)
            rms = np.sqrt(mean_square / np.maximum(weight, 1e-9))
            level_errors[side] = step_um * rms, step_um * float(np.nanmean(off))
        # Columns that touch at a corner are of one particle.
        _, particle_count = ndimage.label(is_particle, np.ones((3, 3)))
        particles += int(particle_count)
        below_particle |= is_particle
        inner = outer + depths[2 * k + 1] if coated[k] else np.full_like(outer, np.nan)
        for name, depth in ((side, outer), (f"interface_{side}", inner)):
            index = columns.shape[2] - 1 - depth if k == 0 else depth
            heights[name] = first_um + step_um * index
    return Faces(
        heights=heights,
        below_particle=below_particle,
        particles=particles,
        level_errors=level_errors,
    )


def _cleaned(outer: Floats, pitch: Pitch, is_asked: bool) -> tuple[Floats, Bools]:
    """Give a face without spikes and attached particles, and where the particles are.

    As it is where that is not asked. ``outer`` (rows, cols): depth of the face from outside, in
    voxels; NaN where there is none, and then where a spike or a particle was.
    """
    is_finite = np.isfinite(outer)
    if not is_asked or not is_finite.any():
        return outer, np.zeros(outer.shape, bool)
    step_um = pitch[2]
    # Columns whose face stands far off its neighbours' are dust, or fits that went astray.
    deviation_px = np.abs(outer - _around(outer))
    limit_px = largest_step_px(deviation_px[is_finite], step_um)
    outer = np.where(is_finite & (deviation_px <= limit_px), outer, np.nan)
    # What stands 6 um or 3 voxels out of the face, and by more than its roughness, in a narrow
    # place: an attached particle is narrower than 15 um.
    is_finite = np.isfinite(outer)
    top_hat, _ = _top_hat(outer, 15.0, 1, pitch)
    limit_px = max(_usual_step_px(top_hat[is_finite]), 6.0 / step_um, 3.0)
    is_particle = is_finite & (top_hat > limit_px)
    return np.where(is_particle, np.nan, outer), is_particle


def _around(face: Floats) -> Floats:
    """Median of the columns around, of a face that is filled first."""
    return ndimage.median_filter(filled(face), size=_AROUND, mode="nearest")


def largest_step_px(deviations_px: Floats, step_um: float) -> float:
    """By how much a column's face may stand off its neighbours', in voxels: 3 um or 3 voxels."""
    return max(_usual_step_px(deviations_px), 3.0 / step_um, 3.0)


def _usual_step_px(deviations_px: Floats) -> float:
    """By how much faces stand off their neighbours', in voxels, next to chance."""
    return 8.0 * mad_sd(deviations_px) + 1.0


def _lost(face: Floats, step_um: float) -> tuple[Floats, Bools, float]:
    """Face of the columns around, where a column lacks theirs, and how far faces vary, in voxels.

    With next to no coating a face may be too faint to be found in noise, but not to be found again
    where most of the columns around say.
    """
    is_found = np.isfinite(face)
    if not is_found.any():
        return face, is_found, 0.0
    around = _around(face)
    deviation_px = np.abs(face - around)
    usual_px = _usual_step_px(deviation_px[is_found])
    is_found &= deviation_px <= largest_step_px(deviation_px[is_found], step_um)
    share = ndimage.uniform_filter(is_found.astype(float), _AROUND)  # of the columns around
    return around, ~is_found & (share > 0.5), usual_px


def _loose_fibres(face: Floats, pitch: Pitch) -> Bools:
    """Find what stands out of a rough face as far as hardly any fibre that lies in it does.

    That is two standard deviations above the upper fifth of the faces around: one in 400 of a
    normal face stands so far out by chance.
    """
    is_found = np.isfinite(face)
    if not is_found.any():
        return is_found
    outward = filled(-face)
    rows, cols = (max(round(_SPARSE_UM / p), 1) for p in pitch[:2])
    sparse = ndimage.percentile_filter(outward[::rows, ::cols], 80.0, size=_SPARSE_AROUND)
    upper = sparse.repeat(rows, axis=0).repeat(cols, axis=1)
    height = outward - upper[: face.shape[0], : face.shape[1]]
    return is_found & (height > 2.0 * mad_sd(height[is_found]))


def _plates(outward: Floats, pitch: Pitch) -> tuple[NDArray[np.int32], Floats]:
    """Label what stands three voxels off the face with a step all round; give the face below.

    ``outward`` (rows, cols): height of the face in voxels, growing outwards; NaN where there is
    none. The face below is given the same way; label 0 is no plate.
    """
    is_finite = np.isfinite(outward)
    if not is_finite.any():
        return np.zeros(outward.shape, np.int32), outward
    top_hat, opened = _top_hat(-outward, 100.0, 2, pitch)  # as wide as it may be, in um
    limit_px = max(_FLOATS - 0.5, 8.0 * mad_sd(top_hat[is_finite]))
    labels, count = ndimage.label(is_finite & (top_hat > limit_px))
    # A bump, or a fibre that lies on others with its ends, has no step all around.
    widened = ndimage.grey_dilation(labels, size=(9, 9))
    ring_labels = np.where((labels == 0) & is_finite, widened, 0)
    # Around a plate hardly a column stands out.
    is_plate = _is_mostly(top_hat < 1.5, ring_labels, count)
    return np.where(is_plate[labels], labels, 0).astype(np.int32), opened


def _top_hat(face: Floats, width_um: float, more: int, pitch: Pitch) -> TwoFields:
    """How far narrow places stand out of a face, and the face outwards without them.

    Narrower than ``width_um`` and so many columns more. The face goes on beyond its border with the
    slope it has there.
    """
    outward = filled(-face)
    rows, cols = (max(int(width_um / p), 1) + more for p in pitch[:2])
    pad_rows = min(rows, face.shape[0] - 1)
    pad_cols = min(cols, face.shape[1] - 1)
    borders = [(pad_rows, pad_rows), (pad_cols, pad_cols)]
    padded = np.pad(outward, borders, mode="reflect", reflect_type="odd")
    opened = ndimage.grey_opening(padded, size=(rows, cols))[pad_rows:, pad_cols:]
    opened = opened[: face.shape[0], : face.shape[1]]
    return outward - opened, opened


def _is_mostly(mask: Bools, labels: NDArray[np.integer], count: int = 0) -> Bools:
    """Tell of each label, up to ``count`` at least, if most of its columns are in the mask.

    Not of 0. Both are (rows, cols).
    """
    flat_labels = labels.ravel()
    column_count = np.bincount(flat_labels, minlength=count + 1)
    mask_count = np.bincount(flat_labels, mask.ravel(), count + 1)
    is_mostly = mask_count / np.maximum(column_count, 1) > _MOST_OF
    is_mostly[0] = False
    return is_mostly


def fit_tile(job: FitJob, tile: Tile) -> Floats:
    """Return face and coating thickness seen from the high end, then from the low end.

    The values are in voxels, (4, rows, cols).

    Where a base of walls and pores lies uncoated, the next wall below a void stands in place of the
    thickness, and there are two more: how far each face moves where the wall's grey is a little
    off.
    """
    columns, guide, priors, search_depths = job
    grey, guide = oriented(columns, tile, guide, priors.scale)
    looked_for = priors
    margin_px = priors.search_px
    if search_depths is not None:
        margin_px = 1.0  # what lies outside has been taken for the face before
        if priors.search_px > 0:
            # As amid other material, the face is sought next to its depth.
            looked_for = replace(priors, embedded_level=0.5 * priors.base_level)
    depths = np.zeros((_planes(priors), *tile.shape))
    for k, from_high in enumerate((True, False)):
        outer, opposite = guide.faces(grey.shape[2], from_high=from_high)
        if search_depths is not None:
            outer = search_depths[k]
        wall_level = priors.sides[from_high].wall_level
        if wall_level:
            inward_grey = grey[..., ::-1] if from_high else grey
            start = outer - margin_px / guide.cos_tilt
            walls = _wall_depths(inward_grey, start, opposite, wall_level)
            depths[[2 * k, 2 * k + 1, 4 + k]] = walls
        else:
            fit = fit_side(grey, (outer, opposite, guide.cos_tilt), looked_for, columns, from_high)
            depths[2 * k : 2 * k + 2] = fit[:2]
    return depths


def _wall_depths(grey: Singles, start: Floats, stop: Floats, wall_level: float) -> ThreeFields:
    """Depth of the first wall, of the next one below a void, and how far the grey moves the first.

    Each (rows, cols), in voxels from outside; NaN for none. ``grey`` (rows, cols, depth) is read
    from outside, from ``start`` to ``stop`` (rows, cols).
    """
    level = 0.5 * wall_level
    face = outermost_crossing(grey, start, stop, level)
    below_first = first_where(grey <= level, np.ceil(filled(face)))
    next_wall = outermost_crossing(grey, below_first.astype(float), stop, level)
    outwards = outermost_crossing(grey, start, stop, level * (1.0 - _LEVEL_DOUBT))
    inwards = outermost_crossing(grey, start, stop, level * (1.0 + _LEVEL_DOUBT))
    # Where the next wall is taken for this one the face moves far to one side alone.
    square = 0.5 * ((inwards - face) ** 2 + (face - outwards) ** 2)
    return face, next_wall, np.sqrt(square)


def fit_side(
    grey: Singles,
    expected: ThreeFields,
    priors: Priors,
    columns: Columns,
    from_high: bool,
) -> Floats:
    """Face, thickness, both greys and cost of every column of one side, (5, rows, cols).

    ``grey`` (rows, cols, depth) as stored; ``expected``: depth of the outer and of the opposite
    face, counted from the end that is read from, and cosine of the tilt.
    """
    limits = priors.scatter, priors.search_px, priors.embedded_level, columns.pitch[2]
    side = priors.sides[from_high]
    return fit_columns(grey, expected, side, priors.edge, limits, reverse=from_high)


def fit_columns(
    grey: Singles,
    expected: Sequence[Floats],
    side: Side,
    edge: Edge,
    limits: tuple[float, float, float, float],
    *,
    window: float = 0.0,
    reverse: bool = False,
) -> Floats:
    """Fit the layers of one side; the result and the first two arguments as of :func:`fit_side`.

    ``limits``: as in :class:`Priors`, scatter, search_px and embedded_level, then the size of a
    voxel along the columns in um. ``window``: width of the blur after which the samples that are
    fitted are chosen; 0 takes that of the edge. ``reverse``: whether the columns are read from
    their far end.
    """
    scatter, search_px, embedded_level, voxel_um = limits
    fit = np.empty((5, *grey.shape[:2]))
    layers = side.level, side.spread, side.coated
    fringe = embedded_level, edge.fringe or None, edge.ratio
    below = side.wall_below, WALL_UM / voxel_um
    places = map(np.ascontiguousarray, expected)
    blur = 0.0, edge.width, scatter  # the level of the air, which is that of the scale, before it
    _fit_kernels.fit_faces(
        grey, *places, *blur, *layers, search_px, fit, window, *fringe, reverse, *below
    )
    return fit


def _planes(priors: Priors) -> int:
    return 6 if any(side.wall_level for side in priors.sides.values()) else 4


def outermost_crossing(
    grey: NDArray[np.floating], start: Floats, stop: Floats, level: float
) -> Floats:
    """Depth (...) at which ``grey`` (..., depth), read from outside, first passes level.

    NaN for nowhere, which is also where ``start`` or ``stop`` (...), in voxels, is.
    """
    depth_count = grey.shape[-1]
    # A place of the depth itself lies beyond the column.
    first = np.where(np.isfinite(start), np.floor(start), depth_count)
    inside = first_where(grey > level, np.maximum(first, 1))
    is_found = inside <= np.minimum(stop, depth_count - 1)
    outside = np.where(is_found, inside - 1, 0)
    return np.where(is_found, outside + crossing(grey, outside, level), np.nan)


def first_where(mask: Bools, start: Array) -> Ints:
    """First index from ``start`` (...) on at which ``mask`` (..., depth) is set.

    The depth where there is none.
    """
    depth = mask.shape[-1]
    candidates = mask & (np.arange(depth) >= start[..., None])
    is_found = candidates.any(axis=-1)
    return np.where(is_found, candidates.argmax(axis=-1), depth)


def crossing(grey: NDArray[np.floating], first_sample: Ints, level: float) -> Floats:
    """Return the share of the way from one sample to the next at which level is passed.

    The samples are those of ``grey`` (..., depth).
    """
    next_sample = np.minimum(first_sample + 1, grey.shape[-1] - 1)
    a = at_index(grey, first_sample)
    b = at_index(grey, next_sample)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip((level - a) / (b - a), 0.0, 1.0)
    return np.where(b != a, share, 0.5)
