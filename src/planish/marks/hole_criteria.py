"""Give the criteria by which measured marks are laser holes.

Marks are judged each by itself, and all of an image beside each other.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planish.core.robust import mad_sd
from planish.core.typing import Bools, Floats, Ints, Pair, Shape
from planish.marks import rims as k

# Depth of a hole, in robust standard deviations of the sheet around and of the whole: mottle rarely
# makes three.
LEAST_CONTRAST = 3.2
# The floor of a hole is flat and its rim a step; a blotch of mottle is neither. Shares of the
# depth.
LARGEST_FLATNESS = 0.25
LARGEST_UNEVENNESS = 0.2
# Holes of one laser look alike. How alike their floors are is measured on them, within limits
# (shares of the depth): what differs more is dirt or a pit (not so in transmitted light, where the
# share of the median depth counts).
LEAST_OTHERS = 3
LIKE_FLOORS = (0.02, 0.08)
LEAST_SHARE_OF_MEDIAN = 0.5
# A floor like those of the others is a hole's where the sheet around is so dark that this share of
# their depth is left.
LEAST_DEPTH_OF_FLOOR = 0.3
# Where less than this share of the sheet is as dark as floors that are alike, they are holes in any
# texture: of hole patterns in the strongest mottle 0.022 at most, of printed dots and letters from
# 0.07 on.
RARE = 0.03
# How much better than an outline a floor has to be; quality is the rim's share less its roughness
# over its radius.
BETTER = 0.015
# A floor that is deeper by this share of the depth is that of the hole, and the other what lies
# beside it.
DEEPER = 0.05


def is_whole(marks: Floats, shape: Shape, pixel_um: Pair) -> Bools:
    """Return which circles lie inside the image."""
    bottom, right = np.subtract(shape, 1) * pixel_um
    x, y = marks[:, k.CENTRE].T
    radius = marks[:, k.RADIUS] + marks[:, k.HALF_DIFFERENCE]
    return (x >= radius) & (y >= radius) & (x <= right - radius) & (y <= bottom - radius)


def depth(marks: Floats) -> Floats:
    """Step from the floor to the sheet."""
    return marks[:, k.OUTSIDE] - marks[:, k.INSIDE]


def met_criteria(marks: Floats, pixel_um: Pair, radius_range: Pair) -> dict[str, Bools]:
    """Return which marks meet each criterion, by the fault of those that do not.

    ``radius_range`` in um.
    """
    radius = marks[:, k.RADIUS]
    rim_steps = marks[:, k.STEP]
    depths = depth(marks)
    with np.errstate(invalid="ignore"):
        # Step over +-10 um across the rim as a share of that over +-25 um: a gentle slope makes
        # less. Char so narrow that its outer edge comes within the wider distance makes less, too;
        # but no slope has a floor so flat.
        is_sharp = rim_steps > 0.45 * marks[:, k.FAR_STEP]
        is_flat = marks[:, k.FLATNESS] < 0.05 * depths
        # Char may take two thirds of the step; where it takes more, a sharp rim and a flat floor
        # are enough.
        has_rim = (rim_steps > 0.28 * depths) | ((rim_steps > 0.15 * depths) & is_sharp & is_flat)
        is_step = is_sharp | ((rim_steps > 0.36 * marks[:, k.FAR_STEP]) & is_flat)
        is_deep = depths > LEAST_CONTRAST * marks[:, k.TEXTURE]
        return {
            # Fewer than 6 pixels across a hole cannot distinguish a rim from a slope.
            "too_small": radius >= max(radius_range[0], 3.0 * max(pixel_um)),
            "too_large": radius <= radius_range[1],
            "not_round": is_round(marks, pixel_um),
            "too_faint": is_deep | (marks[:, k.ALIKE] == 1.0),
            "no_rim": has_rim & is_step & _has_floor(marks, depths),
            "open": ~is_open(marks),
        }


def _has_floor(marks: Floats, depths: Floats | float) -> Bools:
    """Return which marks are as flat and as even inside as holes of a depth."""
    is_flat = marks[:, k.FLATNESS] < LARGEST_FLATNESS * depths
    return is_flat & (marks[:, k.UNEVENNESS] < LARGEST_UNEVENNESS * depths)


def is_hole(marks: Floats, pixel_um: Pair, radius_range: Pair) -> Bools:
    """Return which marks look like a hole, each by itself; ``radius_range`` in um."""
    return np.all(list(met_criteria(marks, pixel_um, radius_range).values()), axis=0)


def share_floor(marks: Floats, pixel_um: Pair, radius_range: Pair) -> Bools:
    """Return which marks are holes but for contrast and have the darkest shared floor.

    The floor is the darkest that `LEAST_OTHERS` share.
    """
    criteria_met = met_criteria(marks, pixel_um, radius_range)
    del criteria_met["too_faint"]
    is_like = np.all(list(criteria_met.values()), axis=0)
    like_marks = marks[is_like]
    disjoint = like_marks[best_rims(like_marks)]
    if len(disjoint) < LEAST_OTHERS:
        return np.zeros(len(marks), bool)
    floors = np.sort(disjoint[:, k.INSIDE])
    tolerance = LIKE_FLOORS[0] * float(np.median(depth(disjoint)))
    is_shared = floors[LEAST_OTHERS - 1 :] - floors[: 1 - LEAST_OTHERS] < tolerance
    darkest = np.argmax(is_shared)
    level = floors[darkest + LEAST_OTHERS // 2] if is_shared.any() else np.nan
    return is_like & (np.abs(marks[:, k.INSIDE] - level) < tolerance)


def is_rare(holes: Floats, signed_sheet: NDArray[np.floating]) -> bool:
    """Return whether hardly any of the sheet, grey times sign, is as dark as floors of holes."""
    level = np.median(holes[:, k.INSIDE] + LIKE_FLOORS[1] * depth(holes))
    dark_count = np.count_nonzero(signed_sheet < level)
    return bool(dark_count < RARE * np.count_nonzero(np.isfinite(signed_sheet)))


def is_round(marks: Floats, pixel_um: Pair) -> Bools:
    """Return which rims are whole, smooth (rms about the ellipse) and nearly circles."""
    radius, half_difference = marks[:, k.RADIUS], marks[:, k.HALF_DIFFERENCE]
    is_smooth = marks[:, k.ROUGHNESS] < 0.09 * radius + 0.3 * max(pixel_um)
    is_circle = (radius + half_difference) < 1.3 * (radius - half_difference)
    return is_smooth & is_circle & (marks[:, k.COVERAGE] >= 0.7)


def is_open(marks: Floats) -> Bools:
    """Return beyond which rims the floor goes on, as it does at the end of a slot.

    It does where the grey there is no step from the floor; sheet, char and print are paler.
    """
    return marks[:, k.BEYOND] - marks[:, k.INSIDE] < k.LEAST_INNER * depth(marks)


def deepest_disjoint(marks: Floats) -> Floats:
    """Of overlapping marks keep the deepest, and of those as deep the one with the best rim.

    Marks overlap where their circles do.
    """
    i, j = _overlapping(marks, marks).T
    excess = marks[i, k.INSIDE] - marks[j, k.INSIDE]
    shallow_rows = i[excess > DEEPER * depth(marks)[i]]
    deep_marks = np.delete(marks, shallow_rows, axis=0)
    return deep_marks[best_rims(deep_marks)]


def best_rims(marks: Floats) -> list[int]:
    """Of marks whose circles overlap, give the rows of those with the best rim."""
    order = np.argsort(-quality(marks), kind="stable")
    return greedy_disjoint(order, _overlapping(marks, marks))


def overlaps_any(marks: Floats, holes: Floats) -> Bools:
    """Return which circles overlap any of the holes."""
    return np.isin(np.arange(len(marks)), _overlapping(marks, holes)[:, 0])


def neighbour_pairs(points: Floats, max_distance: float) -> Ints:
    """Pair points (n, 2) that are within ``max_distance`` of each other, both ways round."""
    pairs = KDTree(points).query_pairs(max_distance, output_type="ndarray")
    return np.concatenate([pairs, pairs[:, ::-1]])


def greedy_disjoint(order: Ints, pairs: Ints) -> list[int]:
    """Of points in order keep each that is no neighbour of an earlier one.

    ``pairs`` (m, 2) are neighbours.
    """
    points, neighbours = pairs[np.argsort(pairs[:, 0], kind="stable")].T
    starts = np.searchsorted(points, order)
    stops = np.searchsorted(points, order, "right")
    excluded: set[int] = set()
    disjoint: list[int] = []
    for point, start, stop in zip(order.tolist(), starts, stops, strict=True):
        if point not in excluded:
            disjoint.append(point)
            excluded.update(neighbours[start:stop].tolist())
    return disjoint


def _overlapping(marks: Floats, holes: Floats) -> Ints:
    if not len(marks) or not len(holes):
        return np.empty((0, 2), np.intp)
    reaches = 1.001 * (marks[:, k.RADIUS] + float(holes[:, k.RADIUS].max()))
    neighbours = KDTree(holes[:, k.CENTRE]).query_ball_point(marks[:, k.CENTRE], reaches)
    i = np.repeat(np.arange(len(marks)), [*map(len, neighbours)])
    j = np.concatenate([*neighbours]).astype(np.intp)
    distances = np.hypot(*(marks[i, k.CENTRE] - holes[j, k.CENTRE]).T)
    gaps = distances - marks[i, k.RADIUS] - holes[j, k.RADIUS]
    return np.stack([i, j], axis=1)[gaps < 0]


class TypicalHole(NamedTuple):
    """Typical figures of the holes of one image; levels are times the sign of the holes.

    ``floor_slope``: how the floor brightens with the sheet around; ``floor_scatter``: robust sd of
    the floors, share of the depth; ``burnt_share``, ``rim_share``: shares of the depth that the
    burnt sheet takes, that remain at the rim.
    """

    floor_level: float
    sheet_level: float
    floor_slope: float
    floor_scatter: float
    radius: float
    burnt_share: float
    rim_share: float

    @property
    def depth(self) -> float:
        """Step from the floor to the sheet."""
        return self.sheet_level - self.floor_level

    @property
    def floor_tolerance(self) -> float:
        """Share of the depth by which floors of holes may differ."""
        return float(np.clip(4 * self.floor_scatter, *LIKE_FLOORS))

    def floor_at(self, outside: Floats) -> Floats:
        """Predict the level of a floor where the sheet around has a level."""
        return self.floor_level + self.floor_slope * (outside - self.sheet_level)

    def is_unburnt(self, marks: Floats) -> Bools:
        """Return which marks, by their texture, are not burnt while the others are.

        The others are burnt by more than this share of the step.
        """
        # In transmitted light char is darker than the sheet and holes are lighter: its share is
        # negative.
        burnt_steps = np.sign(self.burnt_share) * marks[:, k.BURNT]
        least_steps = 0.5 * abs(self.burnt_share) * depth(marks) - marks[:, k.TEXTURE]
        return (abs(self.burnt_share) > 0.15) & (burnt_steps < least_steps)


def typical_hole(marks: Floats) -> TypicalHole:
    """Return what is typical of marks."""
    depths = depth(marks)
    # The deeper half: what is less deep may be ink or dirt.
    deep_marks = marks[depths >= np.median(depths)]
    floor_levels = deep_marks[:, k.INSIDE]
    sheet_levels = deep_marks[:, k.OUTSIDE]
    deep_depths = depth(deep_marks)
    sheet_level = float(np.median(sheet_levels))
    # Uneven light brightens floors with the sheet, and print does not: the slope counts if it
    # explains the floors.
    clear_marks = marks[depths >= 0.7 * np.median(depths)]
    slope = 0.0
    scatter = mad_sd(floor_levels)
    fitted_slope = _slope(clear_marks[:, k.OUTSIDE], clear_marks[:, k.INSIDE])
    fitted_scatter = mad_sd(floor_levels - fitted_slope * sheet_levels)
    if fitted_scatter < 0.5 * scatter:
        slope, scatter = fitted_slope, fitted_scatter
    floor_level = float(np.median(floor_levels - slope * (sheet_levels - sheet_level)))
    burnt_share = float(np.nanmedian(deep_marks[:, k.BURNT] / deep_depths))
    rim_share = float(np.nanmedian(deep_marks[:, k.STEP] / deep_depths))
    scatter = scatter / (sheet_level - floor_level)
    radius = float(np.median(deep_marks[:, k.RADIUS]))
    return TypicalHole(floor_level, sheet_level, slope, scatter, radius, burnt_share, rim_share)


def _slope(x: Floats, y: Floats) -> float:
    """Fit the resistant line through the medians of the outer thirds (Tukey).

    Gives a slope from 0 to 1, 0 for few points.
    """
    third = len(x) // 3
    if third < 3:
        return 0.0
    order = np.argsort(x, kind="stable")
    low, high = order[:third], order[-third:]
    run, rise = (float(np.median(v[high]) - np.median(v[low])) for v in (x, y))
    return float(np.clip(rise / run, 0.0, 1.0)) if run > 0 else 0.0


def drop_unlike(marks: Floats, sign: float) -> Floats:
    """Drop marks much fainter, smaller or larger than the rest, or unlike them in two ways."""
    if len(marks) < LEAST_OTHERS:
        return marks
    typical = typical_hole(marks)
    depths = depth(marks)
    outside = marks[:, k.OUTSIDE]
    expected_depths = np.maximum(outside - typical.floor_at(outside), depths)
    depth_share = depths / expected_depths
    # Of a hole that is half closed farther down, the other half is as deep as all. Floors have a
    # long tail (real targets: 27 standard deviations), so only what is far off is out by its floor
    # alone.
    unevenness = marks[:, k.UNEVENNESS]
    excess_unevenness = np.maximum(unevenness - np.median(unevenness), 0.0)
    tolerance = np.clip(30 * typical.floor_scatter, 0.06, 0.3)
    is_like = depth_share + excess_unevenness / expected_depths >= 1 - tolerance
    if sign < 0:
        # In transmitted light floors fade with the lamp, and nothing but a hole shines.
        is_like |= depths >= LEAST_SHARE_OF_MEDIAN * np.median(depths)
    if not np.any(is_like):
        return marks[is_like]
    log_radius = np.log(marks[:, k.RADIUS])
    size_difference = np.abs(log_radius - np.median(log_radius[is_like]))
    is_like &= size_difference < np.log(1.6)
    # Char takes a part of the step; what has none and is odd in depth, roundness and size together
    # is ink or dirt.
    qualities = quality(marks)
    quality_deficit = np.minimum(qualities - np.median(qualities[is_like]), 0)
    odd_depth = (1 - depth_share) / typical.floor_tolerance
    odd_size = size_difference / np.clip(3 * mad_sd(log_radius[is_like]), 0.12, 0.15)
    odd_shape = quality_deficit / np.clip(3 * mad_sd(qualities[is_like]), 0.03, 0.1)
    is_odd = odd_depth**2 + odd_size**2 + odd_shape**2 > 1
    # So much more of the step at the rim itself means that nothing is burnt.
    is_bare = (marks[:, k.STEP] > (typical.rim_share + 0.15) * depths) | typical.is_unburnt(marks)
    return marks[is_like & ~(is_odd & is_bare)]


def is_doubtful(marks: Floats) -> Bools:
    """Return which outlines are so rough or incomplete that print may be a part of them."""
    return quality(marks) < 0.95


def select_resembling(marks: Floats, holes: Floats, pixel_um: Pair) -> Floats:
    """Of floors that were measured keep the round ones that are like those of the holes."""
    typical = typical_hole(holes)
    with np.errstate(invalid="ignore"):
        floor_difference = np.abs(marks[:, k.INSIDE] - typical.floor_at(marks[:, k.OUTSIDE]))
        has_shape = is_round(marks, pixel_um) & ~is_open(marks) & _has_floor(marks, typical.depth)
        has_level = floor_difference < typical.floor_tolerance * typical.depth
        has_depth = depth(marks) > LEAST_DEPTH_OF_FLOOR * typical.depth
        has_size = np.abs(np.log(marks[:, k.RADIUS] / typical.radius)) < np.log(1.35)
        is_similar = has_shape & has_level & has_depth & has_size & ~typical.is_unburnt(marks)
    return deepest_disjoint(marks[is_similar])


def merge_floors(marks: Floats, floors: Floats) -> Floats:
    """Add floors, which do not overlap, to marks.

    Where one lies on a mark, the clearly better of the two stays.
    """
    is_retained = np.ones(len(marks), bool)
    is_added = np.zeros(len(floors), bool)
    overlaps = _overlapping(floors, marks)
    floor_qualities = quality(floors) - BETTER
    qualities = quality(marks)
    for i in range(len(floors)):
        overlapped = overlaps[overlaps[:, 0] == i, 1]
        overlapped = overlapped[is_retained[overlapped]]
        is_added[i] = np.all(qualities[overlapped] < floor_qualities[i])
        is_retained[overlapped] &= not is_added[i]
    return np.concatenate([marks[is_retained], floors[is_added]])


def quality(marks: Floats) -> Floats:
    """Rate outlines by the share of rim present less its rms about the circle over the radius."""
    roughness = np.sqrt(marks[:, k.ROUGHNESS] ** 2 + 0.5 * marks[:, k.HALF_DIFFERENCE] ** 2)
    return marks[:, k.COVERAGE] - roughness / marks[:, k.RADIUS]


def set_covariance(marks: Floats, pixel_um: Pair) -> None:
    """Scale the covariances by the size of the wave that moves a centre, in place.

    One rim has few waves to judge from, so the roughness of all rims of an image counts as much as
    a rim's own. Long waves are larger than short ones, as with any rough line; the first is
    extrapolated in the square of the order.
    """
    if not len(marks):
        return
    low, high = marks[:, k.LOW_WAVES], marks[:, k.HIGH_WAVES]
    mean_waves = (low + 2 * high) / 3
    wave_ratio = np.clip(np.mean(low) / max(float(np.mean(high)), 1e-30), 1.0, 8.0)
    # Mean squares of the orders: 1; 12.5 of the third and fourth; 43.5 of the fifth to eighth.
    first_wave = np.mean(low) * wave_ratio ** (11.5 / 31.0)
    rim_variance = first_wave / max(float(np.mean(mean_waves)), 1e-30) * mean_waves
    variance = 0.5 * rim_variance + 0.5 * np.median(rim_variance)
    # Of two edges either may be the rim, and each is found where the other disturbs it: a part goes
    # any way.
    x, y = np.nan_to_num(marks[:, k.DOUBT]).T
    cross_share = 0.35  # the part across the line of the two centres
    # The raster adds an error of 0.02 pixels.
    marks[:, k.COVARIANCE] *= variance[:, None]
    marks[:, k.COV_XX] += (0.02 * pixel_um[1]) ** 2
    marks[:, k.COV_YY] += (0.02 * pixel_um[0]) ** 2
    marks[:, k.COV_XX] += x**2 + (cross_share * y) ** 2
    marks[:, k.COV_YY] += y**2 + (cross_share * x) ** 2
    marks[:, k.COV_XY] += (1 - cross_share**2) * x * y
