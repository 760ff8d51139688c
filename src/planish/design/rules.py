"""The rules that a pattern has to keep, each with what was measured, its limit, and what helps.

Wrong ways to lay a pattern on itself are found as a matcher finds them: by pairs of holes of like
length.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planish.core.errors import MarkError
from planish.core.robust import rms_length
from planish.core.typing import Bools, Complexes, Floats, Ints
from planish.design.pattern import CORNERS, Pattern

TOLERANCE_UM = 25.0  # within which two marks are taken for one
SCALE = 0.03  # how far a map's scale may be off its calibration
CODE = 4  # consecutive holes that have to identify their place
_TURN_DEG = 10.0  # what still counts as a half or a quarter turn


class Motions(NamedTuple):
    """Wrong arrangements of a pattern.

    ``hit`` (motions, n): column k tells whether hole k, once moved, lands within 1.5 tolerances of
    a hole. ``kind`` (motions,): half turn, quarter turn, mirror, else shift.
    """

    hit: Bools
    kind: NDArray[np.str_]

    def best_count(self, kind: str) -> int:
        """Count the holes that the best motion of a kind explains."""
        counts = self.hit[self.kind == kind].sum(axis=1)
        return int(counts.max(initial=0))


def self_motions(points_um: Floats) -> Motions:
    """Lay the holes (n, 2) on themselves by every wrong motion that two pairs of holes propose.

    A motion is a turn, a shift and a scale within 3 %, with the pattern turned over or not; wrong
    is any but the one that leaves all holes in place. A pair proposes one to every pair of like
    length; where that would be too many motions, only some of the pairs do, evenly chosen.
    """
    z = points_um[:, 0] + 1j * points_um[:, 1]
    start, end = np.triu_indices(len(z), 1)
    base_pairs = np.stack([start, end], axis=1)
    length = np.abs(z[end] - z[start])
    order = np.argsort(length, kind="stable")
    # The pairs of like length follow each other in that order: of each pair, where they begin and
    # how many they are.
    sorted_length = length[order]
    first = np.searchsorted(sorted_length, (1 - SCALE) * length, side="left")
    last = np.searchsorted(sorted_length, (1 + SCALE) * length, side="right")
    n_like = last - first
    # Each target is taken in both directions and in both hands; beyond so many motions pairs are
    # thinned out evenly.
    step = max(1.0, 4.0 * float(n_like.sum()) / 60_000)
    pair_numbers = np.arange(0, len(base_pairs), step).astype(np.intp)
    counts = n_like[pair_numbers]
    repeated_numbers = np.repeat(pair_numbers, counts)
    begins = np.cumsum(counts) - counts
    offset = np.arange(len(repeated_numbers)) - np.repeat(begins, counts)
    goal_pairs = base_pairs[order][first[repeated_numbers] + offset]
    bases = np.tile(base_pairs[repeated_numbers], (2, 1))
    goals = np.concatenate([goal_pairs, np.flip(goal_pairs, axis=1)])
    tree = cKDTree(points_um)
    hits, kinds = _motion_hits(z, bases, goals, tree, mirrored=False)
    mirror_hits, mirror_kinds = _motion_hits(z, bases, goals, tree, mirrored=True)
    return Motions(np.concatenate([hits, mirror_hits]), np.concatenate([kinds, mirror_kinds]))


def _motion_hits(
    z: Complexes,
    base_pairs: Ints,
    goal_pairs: Ints,
    tree: cKDTree,
    *,
    mirrored: bool,
) -> tuple[Bools, NDArray[np.str_]]:
    """Holes (motions, n) met by a motion from each base pair to its goal, and its kind.

    Column k is true where hole k, once moved, lands within 1.5 tolerances of a hole. ``z`` are the
    holes as complex numbers x + iy, ``tree`` finds them by place; pairs (motions, 2) are numbers of
    holes. A shift that leaves a hole where it is does not meet it.
    """
    source = np.conj(z) if mirrored else z
    is_motion = source[base_pairs[:, 1]] != source[base_pairs[:, 0]]
    if not mirrored:
        is_motion &= np.any(base_pairs != goal_pairs, axis=1)
    start, end = base_pairs[is_motion].T
    goal_start, goal_end = goal_pairs[is_motion].T
    # The motion is alpha z + shift.
    alpha = (z[goal_end] - z[goal_start]) / (source[end] - source[start])
    shift = z[goal_start] - alpha * source[start]
    moved_points = alpha[:, None] * source + shift[:, None]
    moved_xy = np.stack([moved_points.real, moved_points.imag], axis=-1)
    # Two holes fix the motion, and each may be off. Where no hole is so near, the number is len(z).
    holes = np.asarray(tree.query(moved_xy, distance_upper_bound=1.5 * TOLERANCE_UM)[1])
    is_hit = holes < len(z)
    if mirrored:
        return is_hit, np.full(len(is_hit), "mirror")
    turn_deg = np.abs(np.degrees(np.angle(alpha)))
    is_turned = turn_deg >= _TURN_DEG
    is_other_hole = holes != np.arange(len(z))
    is_hit &= is_turned[:, None] | is_other_hole
    is_half_turn = turn_deg >= 180 - _TURN_DEG
    is_quarter_turn = np.abs(turn_deg - 90) <= _TURN_DEG
    kinds = np.select([is_half_turn, is_quarter_turn], ["half turn", "quarter turn"], "shift")
    return is_hit, kinds


def perimeter_order(points_um: Floats) -> Ints:
    """Sort the holes (n, 2) along the rectangle around them.

    Counter-clockwise from its lower left corner.
    """
    x, y = (points_um - points_um.min(axis=0)).T
    width, height = np.ptp(points_um, axis=0)
    nearest_side = np.argmin([y, width - x, height - y, x], axis=0)
    around = [x, width + y, 2 * width + height - x, 2 * (width + height) - y]
    perimeter_um = np.choose(nearest_side, around)
    return np.argsort(perimeter_um, kind="stable")


def code_misfit_um(points_um: Floats) -> float:
    """Return the smallest misfit (um) of any four consecutive holes with another four.

    With any other four, or with themselves in reverse.

    The holes (n, 2) are taken in their order around the field, the last followed by the first; a
    turn, a shift and a scale within 3 % are free, and the misfit is the largest distance left.
    """
    points = points_um[perimeter_order(points_um)]
    z = points[:, 0] + 1j * points[:, 1]
    n = len(z)
    if n <= CODE:
        return 0.0
    # Four holes from each one on, about their mean.
    numbers = np.add.outer(np.arange(n), np.arange(CODE))
    windows = z[numbers % n]
    windows = windows - windows.mean(axis=1, keepdims=True)
    power = np.sum(np.abs(windows) ** 2, axis=1, keepdims=True)
    misfits: list[Floats] = []
    for goal in (windows, np.flip(windows, axis=1)):
        # Turn and scale of least squares of each window onto each goal.
        product = np.conj(windows) @ goal.T
        wanted_scale = np.abs(product) / power
        scale = np.clip(wanted_scale, 1 - SCALE, 1 + SCALE)
        alpha = scale * np.exp(1j * np.angle(product))
        moved = alpha[:, :, None] * windows[:, None, :]
        misfits.append(np.abs(moved - goal).max(axis=2))
    # Not with itself.
    np.fill_diagonal(misfits[0], np.inf)
    return float(np.min(misfits))


Sense = Literal["at least", "at most"]
LEAST_HOLES, MOST_HOLES = 12, 120
SPACING_DIAMETERS = 3.0
CROP = 0.3
RIVAL_SHARE = 0.5
MARKER_DIAMETERS = 6.0
LAST_RULE = "crop told apart"  # which is applied last, and takes longest
_REMEDY = "use unequal pitches, or another seed"
_MEET = "share of the holes that meet holes when the pattern is"
# Sense, unit, what is measured, and what to change where the rule is broken.
_RULES: dict[str, tuple[Sense, str, str, str]] = {
    "count": ("at least", "holes", "holes of the pattern", "burn more holes"),
    "around": (
        "at most",
        "holes",
        "holes whose burnt rim reaches into the field",
        "move them outwards, or give a smaller field or a larger margin",
    ),
    "radius": (
        "at least",
        "",
        "rms distance from the holes' centroid, as a share of the field's diagonal",
        "put more holes near the corners, widen the margin, or take another number of holes",
    ),
    "spacing": (
        "at least",
        "um",
        "least distance of two holes; burnt zones must not touch",
        "take fewer or smaller holes, or a larger field",
    ),
    "area": (
        "at most",
        "%",
        "area of holes and rims, as a share of the view's",
        "take fewer or smaller holes, a larger field, or a larger margin",
    ),
    "marker": (
        "at least",
        "um",
        "how much farther one corner of the frame is from its nearest hole than the others",
        "put holes into three corners of the frame and end the last line short of the fourth",
    ),
    "crop": (
        "at least",
        "holes",
        "whole holes left when 30 % of width and height are cut off at up to three sides",
        "take more holes, 20 or more, and spread them along all four sides",
    ),
    "code": ("at least", "um", "misfit of any 4 consecutive holes with any other 4", _REMEDY),
    "half turn": ("at most", "", f"{_MEET} turned by about 180 degrees", _REMEDY),
    "quarter turn": ("at most", "", f"{_MEET} turned by about 90 degrees", _REMEDY),
    "mirror": ("at most", "", f"{_MEET} turned over, about any axis", _REMEDY),
    "shift": ("at most", "", f"{_MEET} shifted, scaled by 3 % or turned by another angle", _REMEDY),
    LAST_RULE: (
        "at most",
        "",
        "share of the holes left by the worst crop that meet holes elsewhere",
        _REMEDY,
    ),
}


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule, applied to one pattern."""

    name: str
    value: float  #: measured
    limit: float  #: allowed
    sense: Sense  #: what the value has to be against the limit
    unit: str  #: of value and limit
    meaning: str  #: what is measured
    remedy: str  #: what to change where the rule is broken

    @property
    def passed(self) -> bool:
        """Return whether the rule is kept."""
        slack = 1e-9 * max(abs(self.limit), 1.0)
        if self.sense == "at least":
            return self.value >= self.limit - slack
        return self.value <= self.limit + slack

    def sentence(self) -> str:
        """Write what was measured and what is needed."""
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"rule '{self.name}' ({self.meaning}): {self.value:.3g}{unit}, {self.sense}"
            f" {self.limit:.3g}{unit}"
        )


Rules = tuple[Rule, ...]


def check_pattern(pattern: Pattern) -> Rules:
    """Apply every rule to a pattern.

    Raises
    ------
    MarkError
        If there are more holes than can be checked.
    """
    if len(pattern.holes) > MOST_HOLES:
        raise MarkError(
            f"{len(pattern.holes)} holes are more than the {MOST_HOLES} that are checked; 20 to 40"
            " are enough."
        )
    return (*simple_rules(pattern), *code_rules(pattern), *matching_rules(pattern))


def simple_rules(pattern: Pattern) -> Rules:
    """Apply the rules that need no search: count, place, radius, spacing, area, marker, crop.

    Marker: one corner of the frame is farther from its nearest hole than the other three, so that
    it shows how the sheet is turned.
    """
    points, diameter = pattern.points_um, pattern.diameter_um
    field = np.array(pattern.field_um)
    from_middle_um = np.abs(points - pattern.field_low_um - field / 2)
    outside_um = np.maximum(from_middle_um - field / 2, 0.0)
    to_field_um = np.hypot(*outside_um.T)
    n_inside = int(np.sum(to_field_um < pattern.burnt_um - 1e-6))
    rms_radius_um = rms_length(points - points.mean(axis=0))
    first, second = np.triu_indices(len(points), 1)
    spacings_um = np.hypot(*(points[first] - points[second]).T)
    least_spacing_um = float(spacings_um.min())
    # How much farther the emptiest corner of the frame is from its nearest hole than the next one.
    corners = pattern.frame_low_um + pattern.frame_um * CORNERS
    corner_distances = np.hypot(*(corners - points[:, None]).T)
    nearest_um = corner_distances.min(axis=1)
    _, _, next_um, farthest_um = np.sort(nearest_um).tolist()
    needed_spacing_um = max(SPACING_DIAMETERS * diameter, pattern.spacing_um)
    n_survivors = crops(pattern).sum(axis=1)
    return (
        _rule("count", len(points), LEAST_HOLES),
        _rule("around", n_inside, 0),
        _rule("radius", rms_radius_um / float(np.hypot(*field)), 0.4),
        _rule("spacing", least_spacing_um, needed_spacing_um),
        area_rule(pattern, len(points)),
        _rule("marker", farthest_um - next_um, MARKER_DIAMETERS * diameter),
        _rule("crop", int(n_survivors.min()), 4),
    )


def area_rule(pattern: Pattern, count: int) -> Rule:
    """Apply the rule on the area that is burnt, for so many holes.

    The field itself loses none of it.
    """
    burnt_diameter_um = pattern.diameter_um + 2 * pattern.rim_um
    burnt_um2 = count * np.pi / 4 * burnt_diameter_um**2
    return _rule("area", 100 * burnt_um2 / float(pattern.view_um.prod()), 3.0)


def code_rules(pattern: Pattern) -> Rules:
    """Apply the rule that any 4 consecutive holes identify their place."""
    return (_rule("code", code_misfit_um(pattern.points_um), TOLERANCE_UM),)


def matching_rules(pattern: Pattern) -> Rules:
    """Apply the rules against taking the pattern for itself in another position.

    A rival is a motion that lays many holes on others: a half or quarter turn, a mirror, or any
    other. The last rule asks for the same of what each crop leaves.
    """
    points = pattern.points_um
    crop_masks = crops(pattern)
    motions = self_motions(points)
    kinds = ("half turn", "quarter turn", "mirror", "shift")
    # Of each crop, the holes that the best motion without a mirror explains.
    is_hit = motions.hit[motions.kind != "mirror"].astype(np.float32)
    hits_left = is_hit @ crop_masks.T.astype(np.float32)
    hit_counts = np.max(hits_left, axis=0, initial=0)
    # Of so few survivors, three may meet by chance; four are needed to believe an arrangement.
    n_survivors = np.maximum(crop_masks.sum(axis=1), 6)
    worst_share = float(np.max(hit_counts / n_survivors))
    rivals: Rules = ()
    for kind in kinds:
        share = motions.best_count(kind) / len(points)
        rivals += (_rule(kind, share, RIVAL_SHARE),)
    return (*rivals, _rule(LAST_RULE, worst_share, RIVAL_SHARE))


def crops(pattern: Pattern) -> Bools:
    """Return which holes survive each crop, (crops, n).

    A crop is a window of 70 % of the view's width and 70 % of its height that keeps at least one
    side of the view: it cuts off 30 % at one side or shares them between two opposite sides, and
    that in both directions. A window that cuts all four sides loses whatever lies around the field,
    so no pattern could keep it. A hole survives whole.
    """
    points = pattern.points_um - pattern.origin_um
    radius = 0.5 * pattern.diameter_um
    lows, highs = (points - radius).T, (points + radius).T
    survivors: list[Bools] = []
    # The side that the crop keeps lies along the second direction.
    for depth_axis, side_axis in ((0, 1), (1, 0)):
        low, high = lows[side_axis], highs[side_axis]
        view_um, view_depth_um = pattern.view_um[side_axis], pattern.view_um[depth_axis]
        window_um = (1 - CROP) * view_um
        depth_um = (1 - CROP) * view_depth_um
        # Windows between which a hole is lost or won, and the outermost.
        last_um = CROP * view_um
        starts_um = np.concatenate([low + 1e-3, high - window_um - 1e-3, [0.0, last_um]])
        starts_um = np.unique(np.clip(starts_um, 0.0, last_um))[:, None]
        is_inside = (low >= starts_um) & (high <= starts_um + window_um)
        survivors.append(is_inside & (highs[depth_axis] <= depth_um))
        survivors.append(is_inside & (lows[depth_axis] >= view_depth_um - depth_um))
    return np.unique(np.concatenate(survivors), axis=0)


def _rule(name: str, value: float, limit: float) -> Rule:
    return Rule(name, value, limit, *_RULES[name])
