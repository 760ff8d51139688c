"""From what a user wants to a pattern that keeps every rule, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planish.core.errors import MarkError
from planish.marks.design import layouts
from planish.marks.design.layouts import STEP_UM
from planish.marks.design.params import DesignParams
from planish.marks.design.pattern import BORDER_DIAMETERS, BURN, SIDES, Pattern
from planish.marks.design.rules import (
    MARKER_DIAMETERS,
    SPACING_DIAMETERS,
    Rule,
    area_rule,
    code_rules,
    matching_rules,
    simple_rules,
)

LEAST_PITCH_UM = 500.0
_COUNTS = {"coded": (24, 28, 32, 20), "line": (35, 31, 39, 43)}
_ATTEMPTS = {"coded": 40, "line": 250}  # lines are quick to draw and seldom distinct
_LARGEST_SEARCH = 25  # patterns whose rivals are looked for
_COMPARED = 6  # patterns that keep the rules; the one with the weakest rival is taken
_LEAST_A_SIDE = 4
_WIDER_UM, _WIDEST_UM = 250.0, 3000.0  # steps by which a margin that was not given gives holes more room
_NO_ROOM = ("rule 'area'", "rule 'spacing'")
_HOPELESS = ("count", "spacing", "area", "around")  # of these no other draw is better


def design_pattern(params: DesignParams) -> tuple[Pattern, tuple[Rule, ...]]:
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
    reasons: dict[int, str] = {}
    for blank in _blank_patterns(params):
        reasons.clear()
        for count in (params.holes,) if params.holes is not None else _COUNTS[params.layout]:
            design, reason = _search(blank, count, np.random.default_rng([params.seed, count]))
            if design is not None:
                return design
            reasons[count] = reason
        if not any(rule in reason for rule in _NO_ROOM for reason in reasons.values()):
            break
    size = " x ".join(f"{v / 1000:g}" for v in params.field_um)
    more = " The layout 'coded' takes less room." if params.layout == "line" else ""
    raise MarkError(f"No {params.layout} pattern around {size} mm keeps the rules. {reasons[min(reasons)]}{more}")


def _blank_patterns(params: DesignParams) -> Iterator[Pattern]:
    """Yield patterns without holes, the margin as it is given, or wider and wider."""
    blank = _blank_pattern(params)
    yield blank
    if params.margin_um is None:
        for more_um in np.arange(_WIDER_UM, _WIDEST_UM + 1, _WIDER_UM):
            yield _blank_pattern(params.model_copy(update={"margin_um": min(blank.margin_um) + float(more_um)}))


def _blank_pattern(params: DesignParams) -> Pattern:
    """Return the pattern without its holes: field, frame and view."""
    burn = {name: getattr(params, name) for name in BURN}
    closest, inwards = SPACING_DIAMETERS * params.diameter_um, 0.5 * params.diameter_um + params.rim_um
    spacing = params.spacing_um if params.spacing_um is not None else max(LEAST_PITCH_UM, closest)
    least = params.margin_um if params.margin_um is not None else max(1.5 * params.diameter_um, inwards)
    faults: list[str] = []
    if spacing < closest:
        faults.append(f"a spacing of {spacing:g} um; the burnt zones touch below 3 diameters, {closest:g} um")
    if least < inwards:
        faults.append(f"a margin of {least:g} um; the burnt rims reach into the field below {inwards:g} um")
    if faults:
        raise MarkError(f"No pattern can be planned with {'; '.join(faults)}. Give a larger one.")
    # Opposite corners lie whole steps apart, so the margins take up what the field leaves over.
    frame = [STEP_UM * np.ceil((side + 2 * least) / STEP_UM - 1e-9) for side in params.field_um]
    margin = tuple(float(outer - side) / 2 for outer, side in zip(frame, params.field_um, strict=True))
    return Pattern(
        name=params.name, layout=params.layout, field_um=params.field_um, margin_um=(margin[0], margin[1]),
        border_um=BORDER_DIAMETERS * params.diameter_um, origin_um=params.origin_um, spacing_um=float(spacing),
        seed=params.seed, **burn,
    )  # fmt: skip


def _search(
    blank: Pattern, count: int, rng: np.random.Generator
) -> tuple[tuple[Pattern, tuple[Rule, ...]] | None, str]:
    """Draw patterns until some keep all rules; the one with the weakest rival, or the reason why there is none."""
    area = area_rule(blank, count)
    if not area.passed:
        return None, f"With {count} holes, {area.sentence()}: {area.remedy}."
    candidates: list[tuple[tuple[float, float], Pattern, tuple[Rule, ...]]] = []
    nearest: list[Rule] | None = None
    searched = 0
    for _ in range(_ATTEMPTS[blank.layout]):
        pattern = _draw_pattern(blank, count, rng)
        if pattern is None:
            continue
        rules: tuple[Rule, ...] = ()
        broken: list[Rule] = []
        # The quick ones first.
        for more in (simple_rules, code_rules, matching_rules):
            searched += more is matching_rules
            rules = (*rules, *more(pattern))
            broken = [rule for rule in rules if not rule.passed]
            if broken:
                break
        if not broken:
            rival = max(rule.value for rule in rules if rule.sense == "at most" and not rule.unit)
            code = next(rule.value for rule in rules if rule.name == "code")
            candidates.append(((round(rival, 6), -code), pattern, rules))
            if len(candidates) == _COMPARED:
                break
        elif nearest is None or len(broken) < len(nearest):
            nearest = broken
        if searched == _LARGEST_SEARCH or (nearest is not None and any(rule.name in _HOPELESS for rule in nearest)):
            break
    if candidates:
        _, pattern, rules = min(candidates, key=lambda entry: entry[0])
        return (pattern, rules), ""
    if nearest is None:
        return None, (
            f"rule 'spacing': {count} holes do not fit with {blank.spacing_um:g} um between any two: take fewer or "
            "smaller holes, a larger field, or a smaller --spacing-um."
        )
    return None, f"With {count} holes, " + "; ".join(f"{rule.sentence()}: {rule.remedy}" for rule in nearest) + "."


def _draw_pattern(blank: Pattern, count: int, rng: np.random.Generator) -> Pattern | None:
    """Draw one pattern; None where a side has no room."""
    width, height = (round(side / STEP_UM) for side in blank.frame_um)
    lengths = (width, height, width, height)
    spacing = int(np.ceil(blank.spacing_um / STEP_UM - 1e-9))
    marker = max(spacing, int(np.ceil(MARKER_DIAMETERS * blank.diameter_um / STEP_UM)))
    # Three corners hold holes too.
    shares = layouts.share_holes(count - 3, lengths, min(_LEAST_A_SIDE, max(1, (count - 3) // 4)))
    rates = rng.permutation(np.array(layouts.RATES)) + rng.uniform(-0.4, 0.4, 4)
    used: set[int] = set()
    sides: list[layouts.Ints] = []
    for side, (length, share) in enumerate(zip(lengths, shares, strict=True)):
        ruler = layouts.Ruler(
            length=length, start=side != 0, end=side != 3, spacing=spacing, marker=marker,
            view=blank.view_um[side % 2] / STEP_UM, border=blank.border_um / STEP_UM,
            radius=0.5 * blank.diameter_um / STEP_UM,
        )  # fmt: skip
        if blank.layout == "coded":
            inner = layouts.coded_side(ruler, share, used, rng)
        else:
            inner = layouts.growing_side(ruler, share, float(rates[side]))
        if inner is None:
            return None
        used |= layouts.coded_distances(ruler, inner)
        sides.append(inner)
    points, owner = layouts.around_frame(sides, width, height)
    return blank.with_holes(points + np.array(blank.frame_low_um), [SIDES[side] for side in owner])
