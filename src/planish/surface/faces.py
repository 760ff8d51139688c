"""Both faces and interfaces of every column, tile by tile."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.grid import at_index, filled
from planish.core.robust import mad_sd, masked_gaussian
from planish.core.threads import map_threads
from planish.core.tiles import Engine, Tile
from planish.core.typing import Bools, Floats
from planish.surface import _fit_kernels
from planish.surface.columns import WALL_UM, Columns, Guide, Priors, join_tiles, oriented

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
    """Faces of every column.

    ``heights``: of both faces and the interfaces below them, (rows, cols) in um, NaN where nothing
    was found; ``stuck`` (rows, cols): columns below an attached particle; ``particles``: how many
    particles were removed.
    """

    heights: dict[str, Floats]
    below_particle: Bools
    particles: int
    # By side without a coating, in um: how far the face moves where the wall's grey is a little
    # off, in each column (rows, cols) and in the mean of all.
    level_errors: dict[str, tuple[Floats, float]] = field(default_factory=dict)


def find_faces(
    columns: Columns, guide: Guide, priors: Priors, engine: Engine, particles: int
) -> Faces:
    """Fit every column from both ends; ``particles`` float in the air beside the sheet."""
    shape, depth = columns.shape[:2], columns.shape[2]

    def job(tile: Tile) -> FitJob:
        return columns, guide.part(priors.scale.grown(tile, shape)), priors, None

    tiles = columns.tiles(engine)
    depths = join_tiles(
        engine.map("faces", fit_tile, job, tiles), np.empty((_planes(priors), *shape))
    )
    if not priors.embedded_level:
        # The coarse sheet is one connected object: what is seen far outside it hangs on nothing,
        # and the face is looked for again below it. Where the gap is so narrow that the coarse
        # search saw one object, a plate with a step all around is tried too. Such plates are
        # counted here; what floats farther away was counted by the coarse search.
        is_floating, expected_depths = np.zeros((2, *shape), dtype=bool), np.empty((2, *shape))
        plates_by_end, opened_faces = zip(
            *map_threads(_plates, -depths[:4:2], repeat(columns.pitch)), strict=True
        )
        for k, from_high in enumerate((True, False)):
            plate_labels, opened = plates_by_end[k], opened_faces[k]
            expected_depths[k] = np.where(
                plate_labels > 0, -opened, guide.faces(depth, from_high=from_high)[0]
            )
            with np.errstate(invalid="ignore"):
                is_floating[k] = (expected_depths[k] - depths[2 * k] > _FLOATS / guide.cos_tilt) | (
                    plate_labels > 0
                )
        search_depths = np.where(is_floating, expected_depths, np.nan)

        def job_below(tile: Tile) -> FitJob:
            return *job(tile)[:3], search_depths[:, tile.rows, tile.cols]

        tiles = [t for t in tiles if is_floating[:, t.rows, t.cols].any()]
        depths_by_tile = engine.map("faces_below", fit_tile, job_below, tiles)
        depths_below = join_tiles(depths_by_tile, np.full((_planes(priors), *shape), np.nan))
        for k, plate_labels in enumerate(plates_by_end):
            is_better = is_floating[k] & np.isfinite(depths_below[2 * k])
            # A plate floats when there is a face below most of it.
            is_floating_plate = np.append(
                False, _share(is_better, plate_labels, int(plate_labels.max())) > _MOST_OF
            )
            particles += int(np.count_nonzero(is_floating_plate))
            is_better &= (plate_labels == 0) | is_floating_plate[plate_labels]
            depths[2 * k][is_floating_plate[plate_labels] & ~is_better] = np.nan
            for plane in (2 * k, 2 * k + 1, *([4 + k] if len(depths) > 4 else [])):
                depths[plane, is_better] = depths_below[plane, is_better]
        depths = _found_again(depths, job, columns, priors, engine)
    for k, from_high in enumerate((True, False)):
        if priors.sides[from_high].wall_level:
            face, next_wall = depths[2 * k : 2 * k + 2]
            # Below a fibre that stands out there is a void.
            is_loose = _loose_fibres(face, columns.pitch) & np.isfinite(next_wall)
            depths[2 * k] = np.where(is_loose, next_wall, face)
            depths[2 * k + 1] = 0.0
    cleaned = not priors.sides[True].wall_level, not priors.sides[False].wall_level
    return faces_from_depths(depths, columns, priors.coated, cleaned=cleaned, particles=particles)


def _found_again(
    depths: Floats, job: Callable[[Tile], FitJob], columns: Columns, priors: Priors, engine: Engine
) -> Floats:
    """Depths in which a coated face that was lost in noise is fitted from where its neighbours say.

    Noise just outside a face may be taken for it, and with next to no coating a face may be too
    faint to be searched for.
    """
    search_depths = np.full((2, *depths.shape[1:]), np.nan)
    usual_px = np.zeros(2)
    for k, from_high in enumerate((True, False)):
        if priors.sides[from_high].coated:
            around, is_lost, usual_px[k] = _lost(depths[2 * k], columns.pitch[2])
            search_depths[k] = np.where(is_lost, around, np.nan)
    known_place = replace(priors, search_px=0.0)

    def job_again(tile: Tile) -> FitJob:
        return *job(tile)[:2], known_place, search_depths[:, tile.rows, tile.cols]

    tiles = [
        t for t in columns.tiles(engine) if np.isfinite(search_depths[:, t.rows, t.cols]).any()
    ]
    depths_by_tile = engine.map("faces_again", fit_tile, job_again, tiles)
    found = join_tiles(depths_by_tile, np.full(depths.shape, np.nan))
    for k in range(2):
        planes = slice(2 * k, 2 * k + 2)
        # What lies farther off is something else, such as the rim of a particle.
        is_found = np.abs(found[2 * k] - search_depths[k]) <= usual_px[k]
        depths[planes] = np.where(is_found, found[planes], depths[planes])
    return depths


def faces_from_depths(
    depths: Floats,
    columns: Columns,
    coated: tuple[bool, bool],
    *,
    cleaned: tuple[bool, bool] = (False, False),
    particles: int,
) -> Faces:
    """Turn depths into heights.

    ``depths`` (4 or 6, rows, cols): depth of the face and thickness of the coating, counted from
    the high end, then from the low end, in voxels, and how far either face moves with the wall's
    grey; ``coated`` and ``cleaned`` in the same order. ``cleaned``: take off spikes and attached
    particles; ``particles`` were removed before.
    """
    first_um, step_um, last_index = (
        float(columns.depth_um[0]),
        columns.pitch[2],
        columns.shape[2] - 1,
    )
    below_particle = np.zeros(depths.shape[1:], dtype=bool)
    heights: dict[str, Floats] = {}
    level_errors: dict[str, tuple[Floats, float]] = {}
    faces = map_threads(_cleaned, depths[:4:2], repeat(columns.pitch), cleaned)
    for k, side in enumerate(
        ("top", "bottom") if columns.frame.top == "high" else ("bottom", "top")
    ):
        (outer, is_particle), thickness = faces[k], depths[2 * k + 1]
        if len(depths) > 4:
            # The rms of neighbours: whether a wall is seen or not is chance in one column.
            squares, known = depths[4 + k] ** 2, np.isfinite(depths[4 + k])
            mean_square, weight = masked_gaussian(squares, known, [3.0, 3.0], truncate=3.0)
            rms = np.sqrt(mean_square / np.maximum(weight, 1e-9))
            level_errors[side] = step_um * rms, step_um * float(np.nanmean(depths[4 + k]))
        particles += int(ndimage.label(is_particle, np.ones((3, 3)))[1])
        below_particle |= is_particle
        interface = np.where(np.isfinite(outer) & coated[k], outer + thickness, np.nan)
        for name, depth in ((side, outer), (f"interface_{side}", interface)):
            heights[name] = first_um + step_um * (last_index - depth if k == 0 else depth)
    return Faces(
        heights=heights,
        below_particle=below_particle,
        particles=particles,
        level_errors=level_errors,
    )


def _cleaned(
    outer: Floats, pitch: tuple[float, float, float], is_asked: bool
) -> tuple[Floats, Bools]:
    """Give a face without spikes and attached particles, and where these are.

    As it is where that is not asked.
    """
    if not is_asked or not np.isfinite(outer).any():
        return outer, np.zeros(outer.shape, dtype=bool)
    # Columns whose face stands far off its neighbours' are dust, or fits that went astray.
    is_finite, step_um = np.isfinite(outer), pitch[2]
    deviation_px = np.abs(
        outer - ndimage.median_filter(filled(outer), size=_AROUND, mode="nearest")
    )
    limit_px = largest_step_px(deviation_px[is_finite], step_um)
    outer = np.where(is_finite & (deviation_px <= limit_px), outer, np.nan)
    # What stands 6 um or 3 voxels out of the face, and by more than its roughness, in a narrow
    # place.
    is_finite, filled_face = np.isfinite(outer), filled(-outer)
    rows, cols = (max(int(15.0 / p), 1) + 1 for p in pitch[:2])  # an attached particle is narrower
    top_hat = filled_face - _opened(filled_face, (rows, cols))
    is_particle = is_finite & (
        top_hat > max(8.0 * mad_sd(top_hat[is_finite]) + 1.0, 6.0 / step_um, 3.0)
    )
    return np.where(is_particle, np.nan, outer), is_particle


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
    around = ndimage.median_filter(filled(face), size=_AROUND, mode="nearest")
    deviation_px = np.abs(face - around)
    usual_px = _usual_step_px(deviation_px[is_found])
    is_found &= deviation_px <= largest_step_px(deviation_px[is_found], step_um)
    share = ndimage.uniform_filter(is_found.astype(np.float64), _AROUND)
    return around, ~is_found & (share > 0.5), usual_px


def _loose_fibres(face: Floats, pitch: tuple[float, float, float]) -> Bools:
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
    upper = np.repeat(np.repeat(sparse, rows, axis=0), cols, axis=1)
    height = outward - upper[: face.shape[0], : face.shape[1]]
    return is_found & (height > 2.0 * mad_sd(height[is_found]))


def _plates(outward: Floats, pitch: tuple[float, float, float]) -> tuple[NDArray[np.int32], Floats]:
    """Label what stands three voxels off the face with a step all round; give the face below."""
    is_finite = np.isfinite(outward)
    if not is_finite.any():
        return np.zeros(outward.shape, np.int32), outward
    filled_face = filled(outward)
    # As wide as it may be, in um.
    opened = _opened(filled_face, (int(100.0 / pitch[0]) + 2, int(100.0 / pitch[1]) + 2))
    top_hat = filled_face - opened
    labels, count = ndimage.label(
        is_finite & (top_hat > max(_FLOATS - 0.5, 8.0 * mad_sd(top_hat[is_finite])))
    )
    if not count:
        return np.asarray(labels, np.int32), opened
    # A bump, or a fibre that lies on others with its ends, has no step all around.
    ring_labels = np.where((labels == 0) & is_finite, ndimage.grey_dilation(labels, size=(9, 9)), 0)
    is_plate = np.append(False, _share(top_hat < 1.5, ring_labels, count) > _MOST_OF)
    return np.where(is_plate[labels], labels, 0).astype(np.int32), opened


def _opened(height: Floats, size: tuple[int, int]) -> Floats:
    """Opening of a face that goes on beyond its border with the slope it has there."""
    pad_widths = [(min(n, m - 1),) * 2 for n, m in zip(size, height.shape, strict=True)]
    padded = np.pad(height, pad_widths, mode="reflect", reflect_type="odd")
    inner_window = tuple(
        slice(a, n - a) for (a, _), n in zip(pad_widths, padded.shape, strict=True)
    )
    return ndimage.grey_opening(padded, size=size)[inner_window]


def _share(mask: Bools, labels: NDArray[np.integer], count: int) -> Floats:
    flat_labels = labels.ravel()
    column_count = np.bincount(flat_labels, minlength=count + 1)[1:]
    return np.bincount(flat_labels, weights=mask.ravel(), minlength=count + 1)[1:] / np.maximum(
        column_count, 1
    )


def fit_tile(job: FitJob, tile: Tile) -> Floats:
    """Return face and coating thickness seen from the high end, then from the low end.

    The values are in voxels, (4, rows, cols).

    Where a base of walls and pores lies uncoated, the next wall below a void stands in place of the
    thickness, and there are two more: how far each face moves where the wall's grey is a little
    off.
    """
    columns, guide, priors, search_depths = job
    grey, guide = oriented(columns, tile, guide, priors.scale)
    cos_tilt = np.ascontiguousarray(guide.cos_tilt)
    depths = np.zeros((_planes(priors), *tile.shape))
    for k, from_high in enumerate((True, False)):
        outer, opposite = (
            np.ascontiguousarray(a) for a in guide.faces(grey.shape[2], from_high=from_high)
        )
        side, embedded_level = priors.sides[from_high], priors.embedded_level
        if search_depths is not None:
            outer = np.ascontiguousarray(search_depths[k])
            if priors.search_px > 0:
                embedded_level = 0.5 * priors.base_level
        if side.wall_level:
            start = outer - (1.0 if search_depths is not None else priors.search_px) / cos_tilt
            inward_grey = grey[..., ::-1] if from_high else grey
            levels = [
                0.5 * side.wall_level * (1.0 + doubt)
                for doubt in (0.0, -_LEVEL_DOUBT, _LEVEL_DOUBT)
            ]
            face, outwards, inwards = (
                outermost_crossing(inward_grey, start, opposite, level) for level in levels
            )
            # Where the next wall is taken for this one the face moves far to one side alone.
            off = np.sqrt(0.5 * ((inwards - face) ** 2 + (face - outwards) ** 2))
            below_first = first_where(inward_grey <= levels[0], np.ceil(filled(face)))
            depths[2 * k], depths[4 + k] = face, off
            depths[2 * k + 1] = outermost_crossing(
                inward_grey, below_first.astype(np.float64), opposite, levels[0]
            )
            continue
        looked_for = replace(priors, embedded_level=embedded_level)
        fit = fit_side(grey, (outer, opposite, cos_tilt), looked_for, columns, from_high)
        depths[2 * k : 2 * k + 2] = fit[:2]
    return depths


def fit_side(
    grey: NDArray[np.float32],
    expected: tuple[Floats, Floats, Floats],
    priors: Priors,
    columns: Columns,
    from_high: bool,
) -> Floats:
    """Face, thickness, both greys and cost of every column of one side, (5, rows, cols).

    ``grey`` (rows, cols, depth) as stored; ``expected``: depth of the outer and of the opposite
    face, counted from the end that is read from, and cosine of the tilt.
    """
    side, edge = priors.sides[from_high], priors.edge
    fit = np.empty((5, *grey.shape[:2]))
    _fit_kernels.fit_faces(
        grey,
        *expected,
        0.0,
        edge.width,
        priors.scatter,
        side.level,
        side.spread,
        side.coated,
        priors.search_px,
        fit,
        0.0,
        priors.embedded_level,
        edge.fringe or None,
        edge.ratio,
        from_high,
        side.wall_below,
        WALL_UM / columns.pitch[2],
    )
    return fit


def _planes(priors: Priors) -> int:
    return 6 if any(side.wall_level for side in priors.sides.values()) else 4


def outermost_crossing(
    grey: NDArray[np.floating], start: Floats, stop: Floats, level: float
) -> Floats:
    """Depth (...) at which ``grey`` (..., depth), read from outside, first passes level.

    NaN for nowhere.
    """
    inside = first_where(
        grey > level, np.where(np.isfinite(start), np.maximum(np.floor(start), 1), grey.shape[-1])
    )
    is_found = inside <= np.minimum(stop, grey.shape[-1] - 1)
    outside = np.where(is_found, inside - 1, 0)
    return np.where(is_found, outside + crossing(grey, outside, level), np.nan)


def first_where(mask: Bools, start: NDArray[Any]) -> NDArray[np.intp]:
    """First index from ``start`` (...) on at which ``mask`` (..., depth) is set.

    The depth where there is none.
    """
    candidates = mask & (np.arange(mask.shape[-1]) >= start[..., None])
    return np.where(candidates.any(axis=-1), candidates.argmax(axis=-1), mask.shape[-1])


def crossing(grey: NDArray[np.floating], first_sample: NDArray[np.intp], level: float) -> Floats:
    """Return the share of the way from one sample to the next at which level is passed.

    The samples are those of ``grey`` (..., depth).
    """
    next_sample = np.minimum(first_sample + 1, grey.shape[-1] - 1)
    a = at_index(grey, first_sample)
    b = at_index(grey, next_sample)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(b != a, np.clip((level - a) / (b - a), 0.0, 1.0), 0.5)
