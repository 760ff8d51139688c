"""Give the criteria by which measured marks are laser holes.

Marks are judged each by itself, and all of an image beside each other. Their figures are described
in `planish.marks.rims.MARK`: lengths in um, greys times the sign that makes holes dark.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planish.core.robust import mad_sd
from planish.core.typing import Bools, Floats, Ints, Pair, Shape
from planish.marks.rims import LEAST_INNER, Marks

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


def is_whole(marks: Marks, shape: Shape, pixel_um: Pair) -> Bools:
    """Return which circles lie inside an image of so many rows and columns, pixels ``(y, x)``."""
    bottom, right = np.subtract(shape, 1) * pixel_um
    x, y = marks.centre.T
    radius = marks.radius + marks.half_difference
    is_inside = (x >= radius) & (y >= radius)
    is_inside &= x <= right - radius
    return is_inside & (y <= bottom - radius)


def depth(marks: Marks) -> Floats:
    """Step of the grey from the floor to the sheet around, (n,)."""
    return marks.outside - marks.inside


def met_criteria(marks: Marks, pixel_um: Pair, radius_range: Pair) -> dict[str, Bools]:
    """Return which marks meet each criterion, by the fault of those that do not.

    The faults are some of `planish.marks.REASONS`; ``radius_range`` in um. A mark that was not
    measured, NaN, meets none.
    """
    rim_steps = marks.step
    depths = depth(marks)
    least_radius, largest_radius = radius_range
    # Fewer than 6 pixels across a hole cannot distinguish a rim from a slope.
    least_radius = max(least_radius, 3.0 * max(pixel_um))
    with np.errstate(invalid="ignore"):
        # Step over +-10 um across the rim as a share of that over +-25 um: a gentle slope makes
        # less. Char so narrow that its outer edge comes within the wider distance makes less, too;
        # but no slope has a floor so flat.
        is_sharp = rim_steps > 0.45 * marks.far_step
        is_flat = marks.flatness < 0.05 * depths
        is_step = is_sharp | ((rim_steps > 0.36 * marks.far_step) & is_flat)
        # Char may take two thirds of the step; where it takes more, a sharp rim and a flat floor
        # are enough.
        has_faint_rim = (rim_steps > 0.15 * depths) & is_sharp & is_flat
        has_rim = (rim_steps > 0.28 * depths) | has_faint_rim
        is_deep = depths > LEAST_CONTRAST * marks.texture
        return {
            "too_small": marks.radius >= least_radius,
            "too_large": marks.radius <= largest_radius,
            "not_round": is_round(marks, pixel_um),
            "too_faint": is_deep | (marks.is_alike == 1.0),
            "no_rim": has_rim & is_step & _has_floor(marks, depths),
            "open": ~is_open(marks),
        }


def _has_floor(marks: Marks, depths: Floats | float) -> Bools:
    """Return which marks are as flat and as even inside as holes of a depth, or one for each."""
    is_even = marks.unevenness < LARGEST_UNEVENNESS * depths
    return is_even & (marks.flatness < LARGEST_FLATNESS * depths)


def is_hole(marks: Marks, pixel_um: Pair, radius_range: Pair) -> Bools:
    """Return which marks look like a hole, each by itself; ``radius_range`` in um."""
    criteria_met = met_criteria(marks, pixel_um, radius_range)
    return np.logical_and.reduce([*criteria_met.values()])


def share_floor(marks: Marks, pixel_um: Pair, radius_range: Pair) -> Bools:
    """Return which marks are holes but for contrast and have the darkest shared floor.

    The floor is the darkest that `LEAST_OTHERS` share; none is where no floor is shared.
    """
    criteria_met = met_criteria(marks, pixel_um, radius_range)
    del criteria_met["too_faint"]
    is_like = np.logical_and.reduce([*criteria_met.values()])
    like_marks = marks[is_like]
    disjoint = like_marks[best_rims(like_marks)]
    if len(disjoint) < LEAST_OTHERS:
        return np.zeros(len(marks), bool)
    floors = np.sort(disjoint.inside)
    least_tolerance, _ = LIKE_FLOORS
    tolerance = least_tolerance * float(np.median(depth(disjoint)))
    # From each floor to that two places on, in the order of their levels.
    spans = floors[LEAST_OTHERS - 1 :] - floors[: 1 - LEAST_OTHERS]
    is_shared = spans < tolerance
    level = np.nan
    if is_shared.any():
        level = floors[np.argmax(is_shared) + LEAST_OTHERS // 2]
    return is_like & (np.abs(marks.inside - level) < tolerance)


def is_rare(holes: Marks, signed_sheet: NDArray[np.floating]) -> bool:
    """Return whether hardly any of the sheet, grey times sign, is as dark as floors of holes."""
    _, tolerance = LIKE_FLOORS
    level = np.median(holes.inside + tolerance * depth(holes))
    dark_count = np.count_nonzero(signed_sheet < level)
    known_count = np.count_nonzero(np.isfinite(signed_sheet))
    return bool(dark_count < RARE * known_count)


def is_round(marks: Marks, pixel_um: Pair) -> Bools:
    """Return which rims are whole, smooth (rms about the ellipse) and nearly circles."""
    radius = marks.radius
    half_difference = marks.half_difference
    is_smooth = marks.roughness < 0.09 * radius + 0.3 * max(pixel_um)
    longer = radius + half_difference
    shorter = radius - half_difference
    return is_smooth & (longer < 1.3 * shorter) & (marks.coverage >= 0.7)


def is_open(marks: Marks) -> Bools:
    """Return beyond which rims the floor goes on, as it does at the end of a slot.

    It does where the grey there is no step from the floor; sheet, char and print are paler.
    """
    return marks.beyond - marks.inside < LEAST_INNER * depth(marks)


def deepest_disjoint(marks: Marks) -> Marks:
    """Of overlapping marks keep the deepest, and of those as deep the one with the best rim.

    Marks overlap where their circles do.
    """
    i, j = _overlapping(marks, marks).T
    excess = marks.inside[i] - marks.inside[j]
    is_shallow = excess > DEEPER * depth(marks)[i]
    deep_marks = np.delete(marks, i[is_shallow]).view(Marks)
    return deep_marks[best_rims(deep_marks)]


def best_rims(marks: Marks) -> list[int]:
    """Of marks whose circles overlap, give the rows of those with the best rim."""
    order = np.argsort(-quality(marks), kind="stable")
    return greedy_disjoint(order, _overlapping(marks, marks))


def overlaps_any(marks: Marks, holes: Marks) -> Bools:
    """Return which circles overlap any of the holes."""
    overlapping_rows, _ = _overlapping(marks, holes).T
    return np.isin(np.arange(len(marks)), overlapping_rows)


def neighbour_pairs(points: Floats, max_distance: float) -> Ints:
    """Pair points (n, 2) that are within ``max_distance`` of each other, both ways round."""
    pairs = KDTree(points).query_pairs(max_distance, output_type="ndarray")
    return np.concatenate([pairs, pairs[:, ::-1]])


def greedy_disjoint(order: Ints, pairs: Ints) -> list[int]:
    """Of points in order keep each that is no neighbour of an earlier one that is kept.

    ``order`` (n,) holds the numbers of the points, ``pairs`` (m, 2) those of neighbours, both ways
    round.
    """
    by_point = np.argsort(pairs[:, 0], kind="stable")
    points, neighbours = pairs[by_point].T
    # The neighbours of a point are one part of the sorted list.
    starts = np.searchsorted(points, order)
    stops = np.searchsorted(points, order, "right")
    parts = map(slice, starts, stops)
    excluded: set[int] = set()
    disjoint: list[int] = []
    for point, part in zip(order.tolist(), parts, strict=True):
        if point not in excluded:
            disjoint.append(point)
            excluded.update(neighbours[part].tolist())
    return disjoint


def _overlapping(marks: Marks, holes: Marks) -> Ints:
    """Rows of marks and of holes whose circles overlap, (k, 2)."""
    if not len(marks) or not len(holes):
        return np.empty((0, 2), np.intp)
    # A little more than may overlap, so that rounding loses none.
    reaches = 1.001 * (marks.radius + float(holes.radius.max()))
    neighbours = KDTree(holes.centre).query_ball_point(marks.centre, reaches)
    counts = [*map(len, neighbours)]
    i = np.repeat(np.arange(len(marks)), counts)
    j = np.concatenate([*neighbours]).astype(np.intp)
    dx, dy = (marks.centre[i] - holes.centre[j]).T
    gaps = np.hypot(dx, dy) - marks.radius[i] - holes.radius[j]
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

    def is_unburnt(self, marks: Marks) -> Bools:
        """Return which marks, by their texture, are not burnt while the others are.

        The others are burnt by more than 0.15 of the step, and what is burnt has half as much.
        """
        usual_share = abs(self.burnt_share)
        if usual_share <= 0.15:
            return np.zeros(len(marks), bool)
        # In transmitted light char is darker than the sheet and holes are lighter: its share is
        # negative.
        burnt_steps = np.sign(self.burnt_share) * marks.burnt
        least_steps = 0.5 * usual_share * depth(marks) - marks.texture
        return burnt_steps < least_steps


def typical_hole(marks: Marks) -> TypicalHole:
    """Return what is typical of marks, most of which are holes of one image."""
    depths = depth(marks)
    usual_depth = np.median(depths)
    # The deeper half: what is less deep may be ink or dirt.
    deep_marks = marks[depths >= usual_depth]
    floor_levels = deep_marks.inside
    sheet_levels = deep_marks.outside
    deep_depths = depth(deep_marks)
    sheet_level = float(np.median(sheet_levels))
    # Uneven light brightens floors with the sheet, and print does not: the slope counts if it
    # explains the floors.
    clear_marks = marks[depths >= 0.7 * usual_depth]
    slope = 0.0
    scatter = mad_sd(floor_levels)
    fitted_slope = _slope(clear_marks.outside, clear_marks.inside)
    fitted_scatter = mad_sd(floor_levels - fitted_slope * sheet_levels)
    if fitted_scatter < 0.5 * scatter:
        slope = fitted_slope
        scatter = fitted_scatter
    floors_of_one_sheet = floor_levels - slope * (sheet_levels - sheet_level)
    floor_level = float(np.median(floors_of_one_sheet))
    return TypicalHole(
        floor_level=floor_level,
        sheet_level=sheet_level,
        floor_slope=slope,
        floor_scatter=scatter / (sheet_level - floor_level),
        radius=float(np.median(deep_marks.radius)),
        burnt_share=float(np.nanmedian(deep_marks.burnt / deep_depths)),
        rim_share=float(np.nanmedian(deep_marks.step / deep_depths)),
    )


def _slope(x: Floats, y: Floats) -> float:
    """Fit the resistant line through the medians of the outer thirds (Tukey).

    Gives a slope from 0 to 1, 0 for few points.

    ``x`` and ``y`` (n,) are levels of the sheet around and of the floor.
    """
    third = len(x) // 3
    if third < 3:
        return 0.0
    order = np.argsort(x, kind="stable")
    points = np.stack([x, y])
    high = np.median(points[:, order[-third:]], axis=1)
    low = np.median(points[:, order[:third]], axis=1)
    run, rise = (high - low).tolist()
    return float(np.clip(rise / run, 0.0, 1.0)) if run > 0 else 0.0


def drop_unlike(marks: Marks, sign: float) -> Marks:
    """Drop marks much fainter, smaller or larger than the rest, or unlike them in two ways.

    ``sign`` is -1 for holes in transmitted light, which are lighter than the sheet, 1 otherwise.
    """
    if len(marks) < LEAST_OTHERS:
        return marks
    typical = typical_hole(marks)
    depths = depth(marks)
    usual_depths = marks.outside - typical.floor_at(marks.outside)
    expected_depths = np.maximum(usual_depths, depths)
    depth_share = depths / expected_depths
    # Of a hole that is half closed farther down, the other half is as deep as all. Floors have a
    # long tail (real targets: 27 standard deviations), so only what is far off is out by its floor
    # alone.
    unevenness = marks.unevenness - np.median(marks.unevenness)
    deepest_share = depth_share + np.maximum(unevenness, 0.0) / expected_depths
    is_like = deepest_share >= 1 - np.clip(30 * typical.floor_scatter, 0.06, 0.3)
    if sign < 0:
        # In transmitted light floors fade with the lamp, and nothing but a hole shines.
        is_like |= depths >= LEAST_SHARE_OF_MEDIAN * np.median(depths)
    if not np.any(is_like):
        return marks[is_like]
    log_radius = np.log(marks.radius)
    usual_log_radius = np.median(log_radius[is_like])
    size_difference = np.abs(log_radius - usual_log_radius)
    is_like &= size_difference < np.log(1.6)
    # Char takes a part of the step; what has none and is odd in depth, roundness and size together
    # is ink or dirt.
    qualities = quality(marks)
    like_qualities = qualities[is_like]
    quality_deficit = np.minimum(qualities - np.median(like_qualities), 0)
    # Each in units of three standard deviations of the others, within limits.
    size_tolerance = np.clip(3 * mad_sd(log_radius[is_like]), 0.12, 0.15)
    shape_tolerance = np.clip(3 * mad_sd(like_qualities), 0.03, 0.1)
    odd_depth = (1 - depth_share) / typical.floor_tolerance
    odd_size = size_difference / size_tolerance
    odd_shape = quality_deficit / shape_tolerance
    is_odd = odd_depth**2 + odd_size**2 + odd_shape**2 > 1
    # So much more of the step at the rim itself means that nothing is burnt.
    is_bare = marks.step > (typical.rim_share + 0.15) * depths
    is_bare |= typical.is_unburnt(marks)
    return marks[is_like & ~(is_odd & is_bare)]


def is_doubtful(marks: Marks) -> Bools:
    """Return which outlines are so rough or incomplete that print may be a part of them."""
    return quality(marks) < 0.95


def select_resembling(marks: Marks, holes: Marks, pixel_um: Pair) -> Marks:
    """Of floors that were measured keep the round ones that are like those of the holes.

    Of those that overlap the deepest is kept; ``pixel_um`` is ``(y, x)``.
    """
    typical = typical_hole(holes)
    with np.errstate(invalid="ignore"):
        is_similar = is_round(marks, pixel_um) & ~is_open(marks)
        is_similar &= _has_floor(marks, typical.depth)
        floor_difference = np.abs(marks.inside - typical.floor_at(marks.outside))
        is_similar &= floor_difference < typical.floor_tolerance * typical.depth
        is_similar &= depth(marks) > LEAST_DEPTH_OF_FLOOR * typical.depth
        size_difference = np.abs(np.log(marks.radius / typical.radius))
        is_similar &= size_difference < np.log(1.35)
        is_similar &= ~typical.is_unburnt(marks)
    return deepest_disjoint(marks[is_similar])


def merge_floors(marks: Marks, floors: Marks) -> Marks:
    """Add floors, which do not overlap, to marks.

    Where one lies on a mark, the clearly better of the two stays.
    """
    is_retained = np.ones(len(marks), bool)
    is_added = np.zeros(len(floors), bool)
    floor_rows, mark_rows = _overlapping(floors, marks).T
    qualities = quality(marks)
    for i, limit in enumerate(quality(floors) - BETTER):
        overlapped = mark_rows[floor_rows == i]
        overlapped = overlapped[is_retained[overlapped]]
        is_added[i] = np.all(qualities[overlapped] < limit)
        is_retained[overlapped] &= not is_added[i]
    merged = np.concatenate([marks[is_retained], floors[is_added]])
    return merged.view(Marks)


def quality(marks: Marks) -> Floats:
    """Rate outlines by the share of rim present less its rms about the circle over the radius.

    1 is a whole, perfect circle.
    """
    mean_squares = marks.roughness**2 + 0.5 * marks.half_difference**2
    return marks.coverage - np.sqrt(mean_squares) / marks.radius


def set_covariance(marks: Marks, pixel_um: Pair) -> None:
    """Scale the covariances by the size of the wave that moves a centre, in place.

    Until then they are for waves of amplitude 1 um. One rim has few waves to judge from, so the
    roughness of all rims of an image counts as much as a rim's own. Long waves are larger than
    short ones, as with any rough line; the first is extrapolated in the square of the order.
    """
    if not len(marks):
        return
    low = marks.low_waves
    high = marks.high_waves
    mean_low = np.mean(low)
    mean_high = max(float(np.mean(high)), 1e-30)
    wave_ratio = np.clip(mean_low / mean_high, 1.0, 8.0)
    # Mean squares of the orders: 1; 12.5 of the third and fourth; 43.5 of the fifth to eighth.
    first_wave = mean_low * wave_ratio ** (11.5 / 31.0)
    # Two orders are low, four are high.
    mean_waves = (low + 2 * high) / 3
    usual_wave = max(float(np.mean(mean_waves)), 1e-30)
    rim_variance = first_wave / usual_wave * mean_waves
    variance = 0.5 * rim_variance + 0.5 * np.median(rim_variance)
    marks.covariance *= variance[:, None]
    xx, yy, xy = marks.covariance.T
    # The raster adds an error of 0.02 pixels.
    raster_yy, raster_xx = np.multiply(0.02, pixel_um) ** 2
    xx += raster_xx
    yy += raster_yy
    # Of two edges either may be the rim, and each is found where the other disturbs it: a part goes
    # any way.
    x, y = np.nan_to_num(marks.doubt).T
    cross_share = 0.35  # the part across the line of the two centres
    xx += x**2 + (cross_share * y) ** 2
    yy += y**2 + (cross_share * x) ** 2
    xy += (1 - cross_share**2) * x * y
