"""Criteria by which measured marks are laser holes: each by itself, and all of an image beside each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from planish.core.robust import mad_sd
from planish.core.typing import Bools, Floats, Ints, Pair
from planish.marks import _measure_kernels as k

# Depth of a hole, in robust standard deviations of the sheet around and of the whole: mottle rarely makes three.
LEAST_CONTRAST = 3.2
# The floor of a hole is flat and its rim a step; a blotch of mottle is neither. Shares of the depth.
LARGEST_FLATNESS = 0.25
LARGEST_UNEVENNESS = 0.2
# Holes of one laser look alike. How alike their floors are is measured on them, within limits (shares of the depth):
# what differs more is dirt or a pit (not so in transmitted light, where the share of the median depth counts).
LEAST_OTHERS = 3
LIKE_FLOORS = (0.02, 0.08)
LEAST_SHARE_OF_MEDIAN = 0.5
# How much better than an outline a floor has to be. The quality is the share of the rim less its roughness over its
# radius.
BETTER = 0.015
# A floor that is deeper by this share of the depth is that of the hole, and the other what lies beside it.
DEEPER = 0.05


def is_whole(rows: Floats, shape: tuple[int, ...], size: Pair) -> Bools:
    """Return which circles lie inside the image."""
    bottom, right = ((n - 1) * step for n, step in zip(shape, size, strict=True))
    x, y, radius = (rows[:, k.X], rows[:, k.Y], rows[:, k.RADIUS] + rows[:, k.HALF_DIFFERENCE])
    return (x >= radius) & (y >= radius) & (x <= right - radius) & (y <= bottom - radius)


def depth(rows: Floats) -> Floats:
    """Step from the floor to the sheet."""
    return rows[:, k.OUTSIDE] - rows[:, k.INSIDE]


def met_criteria(rows: Floats, size: Pair, radii: Pair) -> dict[str, Bools]:
    """Rows of `measure` that meet each criterion, by the fault of those that do not; ``radii`` is the range in um."""
    radius, step, total = rows[:, k.RADIUS], rows[:, k.STEP], depth(rows)
    with np.errstate(invalid="ignore"):
        # Step over +-10 um across the rim as a share of that over +-25 um: a gentle slope makes less. Char so narrow
        # that its outer edge comes within the wider distance makes less, too; but no slope has a floor so flat.
        is_sharp = step > 0.45 * rows[:, k.FAR_STEP]
        is_flat = rows[:, k.FLATNESS] < 0.05 * total
        # The char around a hole may take two thirds of the step. Darker char leaves less to the rim: enough where it
        # is sharp and the floor flat.
        has_rim = (step > 0.28 * total) | ((step > 0.15 * total) & is_sharp & is_flat)
        return {
            # Fewer than 6 pixels across a hole cannot distinguish a rim from a slope.
            "too_small": radius >= max(radii[0], 3.0 * max(size)),
            "too_large": radius <= radii[1],
            "not_round": is_round(rows, size),
            # The height of the answer to a disc, in standard deviations of the same answer all over the sheet, makes
            # a hole even where dots, lines or fibres make a large texture: nothing regular reaches 10.
            "too_faint": (total > LEAST_CONTRAST * rows[:, k.TEXTURE]) | (rows[:, k.STANDING] > 10.0),
            "no_rim": has_rim
            & (is_sharp | ((step > 0.36 * rows[:, k.FAR_STEP]) & is_flat))
            & (rows[:, k.FLATNESS] < LARGEST_FLATNESS * total)
            & (rows[:, k.UNEVENNESS] < LARGEST_UNEVENNESS * total),
        }


def is_hole(rows: Floats, size: Pair, radii: Pair) -> Bools:
    """Return which rows of `measure` look like a hole, each by itself; ``radii`` is the range in um."""
    return np.all(list(met_criteria(rows, size, radii).values()), axis=0)


def is_round(rows: Floats, size: Pair) -> Bools:
    """Return which rims are whole, smooth (rms about the ellipse) and nearly circles."""
    radius, half = rows[:, k.RADIUS], rows[:, k.HALF_DIFFERENCE]
    is_smooth = rows[:, k.ROUGHNESS] < 0.09 * radius + 0.3 * max(size)
    is_circle = (radius + half) < 1.3 * (radius - half)
    return is_smooth & is_circle & (rows[:, k.COVERAGE] >= 0.7)


def deepest_disjoint(rows: Floats) -> Floats:
    """Of rows whose circles overlap keep the deepest, and of those as deep the one with the best rim."""
    first, second = _overlapping(rows, rows).T
    is_shallow = np.zeros(len(rows), bool)
    is_shallow[first[rows[first, k.INSIDE] - rows[second, k.INSIDE] > DEEPER * depth(rows)[first]]] = True
    deep = rows[~is_shallow]
    return deep[best_rims(deep)]


def best_rims(rows: Floats) -> list[int]:
    """Of rows whose circles overlap, give the one with the best rim."""
    return greedy_disjoint(np.argsort(-quality(rows), kind="stable"), _overlapping(rows, rows))


def overlaps_any(rows: Floats, holes: Floats) -> Bools:
    """Return which circles overlap any of the holes; rows without a circle do not."""
    overlaps = np.zeros(len(rows), bool)
    circles = np.flatnonzero(np.isfinite(rows[:, k.RADIUS]))
    overlaps[circles[_overlapping(rows[circles], holes)[:, 0]]] = True
    return overlaps


def neighbour_pairs(points: Floats, reach: float) -> Ints:
    """Pair points (n, 2) that are within ``reach`` of each other, both ways round."""
    near = KDTree(points).query_pairs(reach, output_type="ndarray") if len(points) else np.empty((0, 2), np.intp)
    return np.concatenate([near, near[:, ::-1]])


def greedy_disjoint(order: Ints, pairs: Ints) -> list[int]:
    """Of points in order keep each that is no neighbour of an earlier one; ``pairs`` (m, 2) are neighbours."""
    first, second = pairs[np.argsort(pairs[:, 0], kind="stable")].T
    starts, stops = np.searchsorted(first, order), np.searchsorted(first, order, "right")
    excluded: set[int] = set()
    disjoint: list[int] = []
    for row, start, stop in zip(order.tolist(), starts, stops, strict=True):
        if row not in excluded:
            disjoint.append(row)
            excluded.update(second[start:stop].tolist())
    return disjoint


def _overlapping(rows: Floats, holes: Floats) -> Ints:
    """Return pairs (n, 2) of circles of rows and of holes that overlap."""
    if not len(rows) or not len(holes):
        return np.empty((0, 2), np.intp)
    largest = float(holes[:, k.RADIUS].max())
    near = KDTree(holes[:, [k.X, k.Y]]).query_ball_point(rows[:, [k.X, k.Y]], 1.001 * (rows[:, k.RADIUS] + largest))
    row = np.repeat(np.arange(len(rows)), [len(numbers) for numbers in near])
    hole = np.concatenate([np.asarray(numbers, dtype=np.intp) for numbers in near])
    distance = np.hypot(rows[row, k.X] - holes[hole, k.X], rows[row, k.Y] - holes[hole, k.Y])
    return np.stack([row, hole], axis=1)[distance - rows[row, k.RADIUS] - holes[hole, k.RADIUS] < 0]


class TypicalHole(NamedTuple):
    """Typical figures of the holes of one image; levels are times the sign of the holes.

    ``slope``: how much the floor brightens with the sheet around; ``scatter``: robust standard deviation of the floors,
    share of the depth; ``burnt``, ``rim``: shares of the depth that the burnt sheet takes, that remain at the rim.
    """

    floor: float
    outside: float
    slope: float
    scatter: float
    radius: float
    burnt: float
    rim: float

    @property
    def depth(self) -> float:
        """Step from the floor to the sheet."""
        return self.outside - self.floor

    def floor_at(self, outside: Floats) -> Floats:
        """Predict the level of a floor where the sheet around has a level."""
        return self.floor + self.slope * (outside - self.outside)

    def is_unburnt(self, rows: Floats) -> Bools:
        """Return which marks are not burnt while the others are, by more than this share of the step."""
        # In transmitted light char is darker than the sheet and holes are brighter: its share is negative.
        share = np.sign(self.burnt) * rows[:, k.BURNT]
        return (abs(self.burnt) > 0.15) & (share < 0.5 * abs(self.burnt) * depth(rows))


def typical_hole(rows: Floats) -> TypicalHole:
    """Return what is typical of rows."""
    step = depth(rows)
    # The deeper half: what is less deep may be ink or dirt.
    deep = rows[step >= np.median(step)]
    inside, outside, step_of_deep = deep[:, k.INSIDE], deep[:, k.OUTSIDE], depth(deep)
    sheet = float(np.median(outside))
    # Uneven light brightens floors with the sheet, and print does not: the slope counts if it explains the floors.
    deep_enough = rows[step >= 0.7 * np.median(step)]
    slope, scatter = 0.0, mad_sd(inside)
    steeper = _slope(deep_enough[:, k.OUTSIDE], deep_enough[:, k.INSIDE])
    steeper_scatter = mad_sd(inside - steeper * outside)
    if steeper_scatter < 0.5 * scatter:
        slope, scatter = steeper, steeper_scatter
    floor = float(np.median(inside - slope * (outside - sheet)))
    burnt, rim = (float(np.nanmedian(deep[:, column] / step_of_deep)) for column in (k.BURNT, k.STEP))
    return TypicalHole(floor, sheet, slope, scatter / (sheet - floor), float(np.median(deep[:, k.RADIUS])), burnt, rim)


def _slope(x: Floats, y: Floats) -> float:
    """Fit the resistant line through the medians of the outer thirds (Tukey): a slope from 0 to 1, 0 for few points."""
    third = len(x) // 3
    if third < 3:
        return 0.0
    order = np.argsort(x, kind="stable")
    across, rise = (float(np.median(axis[order[-third:]]) - np.median(axis[order[:third]])) for axis in (x, y))
    return float(np.clip(rise / across, 0.0, 1.0)) if across > 0 else 0.0


def drop_unlike(rows: Floats, sign: float) -> Floats:
    """Drop marks much fainter, smaller or larger than the rest, and those unlike them in two ways."""
    if len(rows) < LEAST_OTHERS:
        return rows
    typical, step = typical_hole(rows), depth(rows)
    whole = np.maximum(rows[:, k.OUTSIDE] - typical.floor_at(rows[:, k.OUTSIDE]), step)
    share = step / whole
    # Of a hole that is half closed farther down, the other half is as deep as all. Floors have a long tail (real
    # targets: 27 standard deviations), so only what is far off is out by its floor alone.
    uneven = np.maximum(rows[:, k.UNEVENNESS] - np.median(rows[:, k.UNEVENNESS]), 0.0)
    is_like = share + uneven / whole >= 1 - np.clip(30 * typical.scatter, 0.06, 0.3)
    if sign < 0:
        # In transmitted light floors fade with the lamp, and nothing but a hole shines.
        is_like |= step >= LEAST_SHARE_OF_MEDIAN * np.median(step)
    if not np.any(is_like):
        return rows[is_like]
    log_radius = np.log(rows[:, k.RADIUS])
    size_difference = np.abs(log_radius - np.median(log_radius[is_like]))
    is_like &= size_difference < np.log(1.6)
    # Char takes a part of the step; what has none and is odd, taking together that it is less deep, less round and of
    # another size, is ink or dirt.
    outlines = quality(rows)
    rougher = np.minimum(outlines - np.median(outlines[is_like]), 0)
    is_odd = (
        ((1 - share) / np.clip(4 * typical.scatter, *LIKE_FLOORS)) ** 2
        + (size_difference / np.clip(3 * mad_sd(log_radius[is_like]), 0.12, 0.15)) ** 2
        + (rougher / np.clip(3 * mad_sd(outlines[is_like]), 0.03, 0.1)) ** 2
    ) > 1
    # So much more of the step at the rim itself means that nothing is burnt.
    is_bare = (rows[:, k.STEP] > (typical.rim + 0.15) * step) | typical.is_unburnt(rows)
    return rows[is_like & ~(is_odd & is_bare)]


def is_doubtful(rows: Floats) -> Bools:
    """Return which outlines are so rough or so incomplete that what is printed may be a part of them."""
    return quality(rows) < 0.95


def select_resembling(rows: Floats, holes: Floats, size: Pair) -> Floats:
    """Of floors that were measured keep the round ones that are like those of the holes."""
    typical = typical_hole(holes)
    with np.errstate(invalid="ignore"):
        floor_difference = np.abs(rows[:, k.INSIDE] - typical.floor_at(rows[:, k.OUTSIDE]))
        is_similar = (
            is_round(rows, size)
            & (rows[:, k.UNEVENNESS] < LARGEST_UNEVENNESS * typical.depth)
            & (rows[:, k.FLATNESS] < LARGEST_FLATNESS * typical.depth)
            & (floor_difference < np.clip(4 * typical.scatter, *LIKE_FLOORS) * typical.depth)
            & (depth(rows) > LEAST_SHARE_OF_MEDIAN * typical.depth)
            & (np.abs(np.log(rows[:, k.RADIUS] / typical.radius)) < np.log(1.35))
            & ~typical.is_unburnt(rows)
        )
    return deepest_disjoint(rows[is_similar])


def merge_floors(rows: Floats, floors: Floats) -> Floats:
    """Add floors, which do not overlap, to rows; where one lies on a row, the clearly better of the two stays."""
    is_retained, is_added = np.ones(len(rows), bool), np.zeros(len(floors), bool)
    pairs = _overlapping(floors, rows)
    better, outlines = quality(floors) - BETTER, quality(rows)
    for floor in range(len(floors)):
        overlapped = pairs[slice(*np.searchsorted(pairs[:, 0], (floor, floor + 1))), 1]
        overlapped = overlapped[is_retained[overlapped]]
        is_added[floor] = np.all(outlines[overlapped] < better[floor])
        is_retained[overlapped] &= not is_added[floor]
    return np.concatenate([rows[is_retained], floors[is_added]])


def quality(rows: Floats) -> Floats:
    """Rate outlines: share of the rim that is there less its rms about the circle over the radius."""
    rough = np.sqrt(rows[:, k.ROUGHNESS] ** 2 + 0.5 * rows[:, k.HALF_DIFFERENCE] ** 2)
    return rows[:, k.COVERAGE] - rough / rows[:, k.RADIUS]


def set_covariance(rows: Floats, size: Pair) -> None:
    """Scale the covariances by the size of the wave that moves a centre, in place.

    One rim has few waves to judge from, so the roughness of all rims of an image counts as much as a rim's own. Long
    waves are larger than short ones, as with any rough line; the first is extrapolated in the square of the order.
    """
    if not len(rows):
        return
    low, high = rows[:, k.LOW_WAVES], rows[:, k.HIGH_WAVES]
    mean_waves = (low + 2 * high) / 3
    fall = np.clip(np.mean(low) / max(float(np.mean(high)), 1e-30), 1.0, 8.0)
    # Mean squares of the orders: 1; 12.5 of the third and fourth; 43.5 of the fifth to eighth.
    first = np.mean(low) * fall ** (11.5 / 31.0)
    rim_variance = first / max(float(np.mean(mean_waves)), 1e-30) * mean_waves
    variance = 0.5 * rim_variance + 0.5 * np.median(rim_variance)
    # Of two edges either may be the rim, and each is found where the other disturbs it: a part goes any way.
    x, y = np.nan_to_num(rows[:, [k.DOUBT_X, k.DOUBT_Y]]).T
    across = 0.35  # the part across the line of the two centres
    # The raster adds an error of 0.02 pixels.
    rows[:, k.COV_XX] = rows[:, k.COV_XX] * variance + (0.02 * size[1]) ** 2 + (x**2 + (across * y) ** 2)
    rows[:, k.COV_YY] = rows[:, k.COV_YY] * variance + (0.02 * size[0]) ** 2 + (y**2 + (across * x) ** 2)
    rows[:, k.COV_XY] = rows[:, k.COV_XY] * variance + (1 - across**2) * x * y
