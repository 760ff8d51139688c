"""From what a user wants to a pattern that keeps every rule, or the reason why there is none.

Holes lie on whole steps of 50 um on lines along the sides of the frame, counter-clockwise from the lower left corner,
which is empty; each other corner holds the first hole of a line.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import MarkError
from planish.core.typing import Pair
from planish.design.params import DesignParams
from planish.design.pattern import BORDER_DIAMETERS, BURN, SIDES, Pattern
from planish.design.rules import (
    MARKER_DIAMETERS,
    SPACING_DIAMETERS,
    Rule,
    area_rule,
    code_rules,
    matching_rules,
    simple_rules,
)

Steps = NDArray[np.int64]

STEP_UM = 50.0


def _place_side(
    blank: Pattern, side: int, length: int, count: int, rate: float, used: set[int], rng: np.random.Generator
) -> Steps | None:
    """Place ``count`` holes between the corners of a side and give them with those in the corners; None if none fit.

    The pitch grows evenly by ``rate``; with 0 all distances differ (a Golomb ruler) and few of those ``used`` repeat.
    """
    spacing = int(np.ceil(blank.spacing_um / STEP_UM - 1e-9))
    marker = max(spacing, int(np.ceil(MARKER_DIAMETERS * blank.diameter_um / STEP_UM)))
    # The corner between the last side and the first stays empty.
    start, end = int(side != 0), int(side != 3)
    low, high = spacing if start else marker, length - (spacing if end else marker)
    for _ in range(1 if rate else 6):
        if rate:
            pitch = 1 + rate * np.arange(count + 1) / count
            inner = np.round(length * np.cumsum(pitch) / pitch.sum()).astype(np.int64)[None, :-1]
        else:
            inner = _draw_positions(blank, side, low, count, rng)
        holes = np.pad(inner, [(0, 0), (start, end)], constant_values=(0, length))
        fits = np.all(np.diff(holes, axis=1) >= spacing, axis=1)
        holes = holes[fits & (inner[:, 0] >= low) & (inner[:, -1] <= high)]
        distances = _distances(holes)
        if not rate:
            is_golomb = np.all(np.diff(np.sort(distances, axis=1), axis=1) > 0, axis=1)
            # So many are compared with the sides before.
            holes, distances = holes[is_golomb][:400], distances[is_golomb][:400]
        if len(holes):
            repeated = np.isin(distances, np.fromiter(used, dtype=np.int64)).sum(axis=1)
            return holes[int(np.argmin(repeated))]
    return None


def _draw_positions(blank: Pattern, side: int, low: int, count: int, rng: np.random.Generator) -> Steps:
    """Draw sorted positions (4000, count) of which at least four survive every crop that keeps the side.

    A window of 70 % of the view slides along the side. The holes in the middle 40 % are always in it; each other hole
    near the start has a partner not quite a window's length away, so that one enters before the other leaves.
    """
    view, border = float(blank.view_um[side % 2]) / STEP_UM, blank.border_um / STEP_UM
    radius = 0.5 * blank.diameter_um / STEP_UM
    window, edge = 0.7 * view, 0.3 * view
    middle = min(count, max(8 - count, count % 2))
    pairs = (4000, (count - middle) // 2)
    first = rng.uniform(low, max(edge - border, low + 1), pairs)
    second = first + (window - 2 * radius - 1) - rng.uniform(0, 0.4, pairs) ** 2 * view
    begin, end = edge - border + radius, window - border - radius
    third = rng.uniform(begin, max(end, begin + 1), (4000, middle))
    return np.sort(np.round(np.concatenate([first, second, third], axis=1)).astype(np.int64), axis=1)


def _distances(marks: Steps) -> Steps:
    """Return all distances (batch, n (n - 1) / 2) between positions (batch, n) but that from corner to corner."""
    n = marks.shape[1]
    pairs = [pair for pair in combinations(range(n), 2) if pair != (0, n - 1)]
    first, last = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    return marks[:, last] - marks[:, first]


_COUNTS = {"coded": (24, 28, 32, 20), "line": (35, 31, 39, 43)}
_ATTEMPTS = {"coded": 40, "line": 250}  # lines are quick to draw and seldom distinct

Design = tuple[Pattern, tuple[Rule, ...]]


def design_pattern(params: DesignParams) -> Design:
    """Plan holes around a field.

    Parameters
    ----------
    params : DesignParams
        The same parameters give the same pattern.

    Returns
    -------
    pattern : Pattern
    rules : tuple of Rule
        What was measured; all are kept.

    Raises
    ------
    MarkError
        If spacing or margin are too small for the holes, or no pattern keeps the rules: the message names the rule and
        what helps.

    Notes
    -----
    A small field has no room around it for so many holes: unless the margin is given, it widens until there is.
    """
    blanks = [_blank_pattern(params)]  # the margin as it is given, or wider and wider
    if params.margin_um is None:
        margins = (min(blanks[0].margin_um) + more_um for more_um in range(250, 3001, 250))
        blanks += [_blank_pattern(params.model_copy(update={"margin_um": margin})) for margin in margins]
    counts = (params.holes,) if params.holes is not None else _COUNTS[params.layout]
    reasons: dict[int, str] = {}
    for blank in blanks:
        for count in counts:
            design = _search(blank, count, np.random.default_rng([params.seed, count]))
            if not isinstance(design, str):
                return design
            reasons[count] = design
        if not any("rule 'area'" in reason or "rule 'spacing'" in reason for reason in reasons.values()):
            break
    size = " x ".join(f"{v / 1000:g}" for v in params.field_um)
    more = " The layout 'coded' takes less room." if params.layout == "line" else ""
    raise MarkError(f"No {params.layout} pattern around {size} mm keeps the rules. {reasons[min(reasons)]}{more}")


def _blank_pattern(params: DesignParams) -> Pattern:
    """Return the pattern without its holes: field, frame and view."""
    closest, inwards = SPACING_DIAMETERS * params.diameter_um, 0.5 * params.diameter_um + params.rim_um
    spacing = params.spacing_um if params.spacing_um is not None else max(500.0, closest)
    least = params.margin_um if params.margin_um is not None else max(1.5 * params.diameter_um, inwards)
    faults: list[str] = []
    if spacing < closest:
        faults.append(f"a spacing of {spacing:g} um; the burnt zones touch below 3 diameters, {closest:g} um")
    if least < inwards:
        faults.append(f"a margin of {least:g} um; the burnt rims reach into the field below {inwards:g} um")
    if faults:
        raise MarkError(f"No pattern can be planned with {'; '.join(faults)}. Give a larger one.")
    # Opposite corners lie whole steps apart, so the margins take up what the field leaves over.
    field = np.array(params.field_um)
    margin = (STEP_UM * np.ceil((field + 2 * least) / STEP_UM - 1e-9) - field) / 2
    return Pattern(
        **params.model_dump(include={"name", "layout", "field_um", "origin_um", "seed", *BURN}),
        spacing_um=spacing,
        margin_um=margin.tolist(),
        border_um=BORDER_DIAMETERS * params.diameter_um,
    )


def _search(blank: Pattern, count: int, rng: np.random.Generator) -> Design | str:
    """Draw patterns until some keep all rules: the one with the weakest rival, or the reason why there is none."""
    area = area_rule(blank, count)
    if not area.passed:
        return f"With {count} holes, {area.sentence()}: {area.remedy}."
    candidates: list[tuple[Pair, Design]] = []
    nearest: list[Rule] = []
    searched = 0  # patterns whose rivals were looked for
    for _ in range(_ATTEMPTS[blank.layout]):
        pattern = _draw_pattern(blank, count, rng)
        if pattern is None:
            continue
        rules: tuple[Rule, ...] = ()
        broken: list[Rule] = []
        # The quick ones first.
        for more in (simple_rules, code_rules, matching_rules):
            searched += more is matching_rules
            rules += more(pattern)
            broken = [rule for rule in rules if not rule.passed]
            if broken:
                break
        if not broken:
            rival = max(rule.value for rule in rules if rule.sense == "at most" and not rule.unit)
            code = next(rule.value for rule in rules if rule.name == "code")
            candidates.append(((round(rival, 6), -code), (pattern, rules)))
            if len(candidates) == 6:
                break
        elif not nearest or len(broken) < len(nearest):
            nearest = broken
        # No other draw is better with these rules.
        if searched == 25 or {"count", "spacing", "around"} & {rule.name for rule in nearest}:
            break
    if candidates:
        return min(candidates, key=lambda entry: entry[0])[1]
    if not nearest:
        return (
            f"rule 'spacing': {count} holes do not fit with {blank.spacing_um:g} um between any two: take fewer or "
            "smaller holes, a larger field, or a smaller --spacing-um."
        )
    return f"With {count} holes, " + "; ".join(f"{rule.sentence()}: {rule.remedy}" for rule in nearest) + "."


def _draw_pattern(blank: Pattern, count: int, rng: np.random.Generator) -> Pattern | None:
    """Draw one pattern; None where a side has no room."""
    width, height = (round(side / STEP_UM) for side in blank.frame_um)
    lengths = (width, height, width, height)
    # Three corners hold holes too.
    shares = [min(4, max(1, (count - 3) // 4))] * 4
    for _ in range(max(0, count - 3 - sum(shares))):
        # The side on which the holes are farthest apart gets the next one.
        shares[max(range(4), key=lambda k: (lengths[k] / (shares[k] + 1), -k))] += 1
    # Last pitch over first pitch, less 1.
    rates = rng.permutation(np.array([1.0, 1.5, 2.1, 2.8])) + rng.uniform(-0.4, 0.4, 4)
    used: set[int] = set()
    points: list[Steps] = []
    lines: list[str] = []
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)])
    direction = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
    for side, (length, share) in enumerate(zip(lengths, shares, strict=True)):
        rate = float(rates[side]) if blank.layout == "line" else 0.0
        holes = _place_side(blank, side, length, share, rate, used, rng)
        if holes is None:
            return None
        used |= set(_distances(holes[None])[0].tolist())
        # The hole at the end is the first one of the next side.
        holes = holes[:-1] if side != 3 else holes
        points.append(corners[side] + holes[:, None] * direction[side])
        lines += [SIDES[side]] * len(holes)
    return blank.with_holes(STEP_UM * np.concatenate(points) + blank.frame_low_um, lines)
