"""From what a user wants to a pattern that keeps every rule, or the reason why there is none.

Holes lie on whole steps of 50 um on lines along the sides of the frame, counter-clockwise from the
lower left corner, which is empty; each other corner holds the first hole of a line.
"""

import math

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import MarkError
from planish.core.typing import Pair
from planish.design.params import DesignParams
from planish.design.pattern import BORDER_DIAMETERS, BURN, CORNERS, SIDES, Pattern, size_text
from planish.design.rules import (
    LAST_RULE,
    MARKER_DIAMETERS,
    SPACING_DIAMETERS,
    Rule,
    Rules,
    area_rule,
    code_rules,
    matching_rules,
    simple_rules,
)

Steps = NDArray[np.int64]
STEP_UM = 50.0


def _place_side(
    blank: Pattern,
    side: int,
    n_steps: int,
    n_holes: int,
    rate: float,
    used: set[int],
    rng: np.random.Generator,
) -> Steps | None:
    """Place ``n_holes`` holes between a side's corners and give them with those in the corners.

    Positions along the side in whole steps, from 0 to ``n_steps``; sides are numbered
    counter-clockwise from the bottom. None if none fit.

    The pitch grows evenly by ``rate``; with 0 all distances differ (a Golomb ruler) and few of
    those ``used`` by the sides before repeat.
    """
    spacing_steps = math.ceil(blank.spacing_um / STEP_UM - 1e-9)
    marker_steps = math.ceil(MARKER_DIAMETERS * blank.diameter_um / STEP_UM)
    marker_steps = max(spacing_steps, marker_steps)
    # The corner between the last side and the first stays empty.
    has_start = int(side != 0)
    has_end = int(side != 3)
    low_step = spacing_steps if has_start else marker_steps
    high_step = n_steps - (spacing_steps if has_end else marker_steps)
    for _ in range(1 if rate else 6):
        if rate:
            pitches = 1 + rate * np.arange(n_holes + 1) / n_holes
            ends = np.round(n_steps * np.cumsum(pitches) / pitches.sum())
            inner_positions = ends.astype(np.int64)[None, :-1]
        else:
            inner_positions = _draw_positions(blank, side, low_step, n_holes, rng)
        corners = [(0, 0), (has_start, has_end)]
        positions = np.pad(inner_positions, corners, constant_values=(0, n_steps))
        is_spaced = np.all(np.diff(positions, axis=1) >= spacing_steps, axis=1)
        is_inside = inner_positions[:, 0] >= low_step
        is_inside &= inner_positions[:, -1] <= high_step
        positions = positions[is_spaced & is_inside]
        distances = _distances(positions)
        if not rate:
            gaps = np.diff(np.sort(distances, axis=1), axis=1)
            is_golomb = np.all(gaps > 0, axis=1)
            # So many are compared with the sides before.
            positions = positions[is_golomb][:400]
            distances = distances[is_golomb][:400]
        if len(positions):
            is_repeated = np.isin(distances, list(used))
            fewest = np.argmin(is_repeated.sum(axis=1))
            return positions[fewest]
    return None


def _draw_positions(
    blank: Pattern, side: int, low_step: int, n_holes: int, rng: np.random.Generator
) -> Steps:
    """Draw sorted positions (4000, count); at least four survive every crop that keeps the side.

    A window of 70 % of the view slides along the side. The holes in the middle 40 % are always in
    it; each other hole near the start has a partner not quite a window's length away, so that one
    enters before the other leaves.
    """
    # All lengths in steps; positions count from the corner, the view begins a border before it.
    view_steps = float(blank.view_um[side % 2]) / STEP_UM
    border_steps = blank.border_um / STEP_UM
    radius = 0.5 * blank.diameter_um / STEP_UM
    window_steps = 0.7 * view_steps
    edge_steps = 0.3 * view_steps
    # With those in pairs, of which one is in every window, four or more.
    n_middle = min(n_holes, max(8 - n_holes, n_holes % 2))
    pair_shape = (4000, (n_holes - n_middle) // 2)
    start_high = max(edge_steps - border_steps, low_step + 1)
    start_positions = rng.uniform(low_step, start_high, pair_shape)
    gaps = rng.uniform(0, 0.4, pair_shape) ** 2 * view_steps
    end_positions = start_positions + (window_steps - 2 * radius - 1) - gaps
    middle_low = edge_steps - border_steps + radius
    middle_high = max(window_steps - border_steps - radius, middle_low + 1)
    middle_positions = rng.uniform(middle_low, middle_high, (4000, n_middle))
    positions = np.concatenate([start_positions, end_positions, middle_positions], axis=1)
    whole_positions = np.round(positions).astype(np.int64)
    return np.sort(whole_positions, axis=1)


def _distances(marks: Steps) -> Steps:
    """Return all distances between positions (batch, n) but that from corner to corner.

    All distances would be (batch, n (n - 1) / 2).
    """
    n = marks.shape[1]
    first, last = np.triu_indices(n, 1)
    is_inner = last - first < n - 1
    return marks[:, last[is_inner]] - marks[:, first[is_inner]]


_COUNTS = {"coded": (24, 28, 32, 20), "line": (35, 31, 39, 43)}
_ATTEMPTS = {"coded": 40, "line": 250}  # lines are quick to draw and seldom distinct
Design = tuple[Pattern, Rules]


def design_pattern(params: DesignParams) -> Design:
    """Plan holes around a field.

    Parameters
    ----------
    params : DesignParams; the same parameters give the same pattern

    Returns
    -------
    pattern : Pattern
    rules : tuple of Rule; what was measured; all are kept

    Raises
    ------
    MarkError
        If spacing or margin are too small for the holes, or no pattern keeps the rules; the message
        says which.

    Notes
    -----
    A small field has no room around it for so many holes: unless the margin is given, it widens
    until there is.
    """
    blanks = [_blank_pattern(params)]  # the margin as it is given, or wider and wider
    if params.margin_um is None:
        for extra_um in range(250, 3001, 250):
            margin_um = min(blanks[0].margin_um) + extra_um
            blanks.append(_blank_pattern(params.model_copy(update={"margin_um": margin_um})))
    hole_counts = (params.holes,) if params.holes is not None else _COUNTS[params.layout]
    reasons: dict[int, str] = {}
    for blank in blanks:
        for hole_count in hole_counts:
            rng = np.random.default_rng([params.seed, hole_count])
            design = _search(blank, hole_count, rng)
            if not isinstance(design, str):
                return design
            reasons[hole_count] = design
        # More room around the field helps where one of these rules is broken.
        reasons_text = " ".join(reasons.values())
        if "rule 'area'" not in reasons_text and "rule 'spacing'" not in reasons_text:
            break
    reason = reasons[min(reasons)]
    if params.layout == "line":
        reason += " The layout 'coded' takes less room."
    raise MarkError(
        f"No {params.layout} pattern around {size_text(params.field_um)} mm keeps the rules."
        f" {reason}"
    )


def _blank_pattern(params: DesignParams) -> Pattern:
    """A pattern without holes; MarkError where spacing or margin are too small for them.

    The margin may become somewhat wider than asked for, so that the frame has whole steps.
    """
    min_spacing_um = SPACING_DIAMETERS * params.diameter_um
    rim_reach_um = 0.5 * params.diameter_um + params.rim_um
    spacing_um = params.spacing_um
    if spacing_um is None:
        spacing_um = max(500.0, min_spacing_um)
    margin = params.margin_um
    if margin is None:
        margin = max(1.5 * params.diameter_um, rim_reach_um)
    faults: list[str] = []
    if spacing_um < min_spacing_um:
        faults.append(
            f"a spacing of {spacing_um:g} um; the burnt zones touch below 3 diameters,"
            f" {min_spacing_um:g} um"
        )
    if margin < rim_reach_um:
        faults.append(
            f"a margin of {margin:g} um; the burnt rims reach into the field below"
            f" {rim_reach_um:g} um"
        )
    if faults:
        raise MarkError(f"No pattern can be planned with {'; '.join(faults)}. Give a larger one.")
    # Opposite corners lie whole steps apart, so the margins take up what the field leaves over.
    field_um = np.array(params.field_um)
    frame_steps = np.ceil((field_um + 2 * margin) / STEP_UM - 1e-9)
    margin_um = (STEP_UM * frame_steps - field_um) / 2
    wanted = params.model_dump(include={"name", "layout", "field_um", "origin_um", "seed", *BURN})
    return Pattern(
        **wanted,
        spacing_um=spacing_um,
        margin_um=margin_um.tolist(),
        border_um=BORDER_DIAMETERS * params.diameter_um,
    )


def _search(blank: Pattern, hole_count: int, rng: np.random.Generator) -> Design | str:
    """Draw patterns until some keep all rules.

    Gives the one with the weakest rival, that is, the wrong arrangement that meets fewest holes; or
    the reason why there is none: what was wrong with the draw that broke fewest rules. ``blank``
    has no holes yet.
    """
    area = area_rule(blank, hole_count)
    if not area.passed:
        return f"With {hole_count} holes, {_faults_text([area])}."
    candidates: list[Design] = []
    fewest_broken: list[Rule] = []
    n_searched = 0  # patterns whose rivals were looked for
    for _ in range(_ATTEMPTS[blank.layout]):
        pattern = _draw_pattern(blank, hole_count, rng)
        if pattern is None:
            continue
        rules = _rules_of(pattern)
        n_searched += rules[-1].name == LAST_RULE
        broken = _broken(rules)
        if not broken:
            candidates.append((pattern, rules))
        elif not fewest_broken or len(broken) < len(fewest_broken):
            fewest_broken = broken
        if n_searched == 25 or len(candidates) == 6 or _are_lasting(fewest_broken):
            break
    if candidates:
        return min(candidates, key=lambda design: _rank(design[1]))
    if fewest_broken:
        return f"With {hole_count} holes, {_faults_text(fewest_broken)}."
    return (
        f"rule 'spacing': {hole_count} holes do not fit with {blank.spacing_um:g} um between any"
        " two: take fewer or smaller holes, a larger field, or a smaller `spacing_um`."
    )


def _are_lasting(broken: list[Rule]) -> bool:
    """Return whether one of these rules is broken by every other draw, too."""
    return any(rule.name in ("count", "spacing", "around") for rule in broken)


def _faults_text(broken: list[Rule]) -> str:
    return "; ".join(f"{rule.sentence()}: {rule.remedy}" for rule in broken)


def _rules_of(pattern: Pattern) -> Rules:
    """Apply the rules, the quick ones first, until some are broken."""
    rules = simple_rules(pattern)
    for more_rules in (code_rules, matching_rules):
        if not _broken(rules):
            rules += more_rules(pattern)
    return rules


def _broken(rules: Rules) -> list[Rule]:
    return [rule for rule in rules if not rule.passed]


def _rank(rules: Rules) -> Pair:
    """Share of holes met in the best rival, and minus the misfit of the code: least is best."""
    shares = [rule.value for rule in rules if rule.sense == "at most" and not rule.unit]
    code_misfit = next(rule.value for rule in rules if rule.name == "code")
    return round(max(shares), 6), -code_misfit


def _draw_pattern(blank: Pattern, hole_count: int, rng: np.random.Generator) -> Pattern | None:
    """Draw a pattern, side by side; None where the holes of a side do not fit.

    Each side gets holes by its length. In a line layout the pitch grows along each side, by a rate
    of its own; in a coded one no two distances are alike.
    """
    width_steps, height_steps = (round(side_um / STEP_UM) for side_um in blank.frame_um)
    side_steps = (width_steps, height_steps, width_steps, height_steps)
    n_inner_holes = hole_count - 3  # Three corners hold holes too.
    hole_counts = np.full(4, min(4, max(1, n_inner_holes // 4)))
    while hole_counts.sum() < n_inner_holes:
        # The side on which the holes are farthest apart gets the next one.
        gaps = np.divide(side_steps, hole_counts + 1)
        hole_counts[np.argmax(gaps)] += 1
    # Last pitch over first pitch, less 1.
    usual_rates = rng.permutation(np.array([1.0, 1.5, 2.1, 2.8]))
    rates = usual_rates + rng.uniform(-0.4, 0.4, 4)
    used_distances: set[int] = set()
    side_points: list[Steps] = []
    side_names: list[str] = []
    corners = CORNERS * (width_steps, height_steps)
    directions = np.roll(CORNERS, -1, axis=0) - CORNERS
    for side, n_steps in enumerate(side_steps):
        rate = float(rates[side]) if blank.layout == "line" else 0.0
        n_inner = int(hole_counts[side])
        positions = _place_side(blank, side, n_steps, n_inner, rate, used_distances, rng)
        if positions is None:
            return None
        used_distances.update(_distances(positions[None])[0].tolist())
        # The hole at the end is the first one of the next side.
        if side != 3:
            positions = positions[:-1]
        side_points.append(corners[side] + positions[:, None] * directions[side])
        side_names += [SIDES[side]] * len(positions)
    points_um = STEP_UM * np.concatenate(side_points) + blank.frame_low_um
    return blank.with_holes(points_um, side_names)
