"""The door: from what a user wants to a pattern that keeps every rule, or the reason why there is none."""

from __future__ import annotations

from typing import Literal

import numpy as np

from planish.core.errors import MarkError
from planish.marks.design.layouts import (
    STEP_UM,
    Ints,
    Ruler,
    coded_distances,
    coded_side,
    growing_rates,
    growing_side,
    placed,
    share_out,
)
from planish.marks.design.pattern import SIDES, Burn, Pattern, border_of
from planish.marks.design.rules import (
    MARKER_DIAMETERS,
    SPACING_DIAMETERS,
    Rule,
    area_rule,
    code_rule,
    matching_rules,
    simple_rules,
)

LEAST_PITCH_UM = 500.0
_COUNTS = {"coded": (24, 28, 32, 20), "line": (35, 31, 39, 43)}
_ATTEMPTS = {"coded": 40, "line": 250}  # lines are quick to draw and seldom told apart
_LARGEST_SEARCH = 25  # patterns whose rivals are looked for
_COMPARED = 6  # patterns that keep the rules; the one with the weakest rival is taken
_LEAST_A_SIDE = 4
_HOPELESS = ("count", "spacing", "area", "around")  # of these no other draw is better


def design_pattern(
    *,
    field_um: tuple[float, float],
    layout: Literal["coded", "line"] = "coded",
    holes: int | None = None,
    burn: Burn | None = None,
    spacing_um: float | None = None,
    margin_um: float | None = None,
    origin_um: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
    name: str = "pattern",
) -> tuple[Pattern, tuple[Rule, ...]]:
    """Plan holes around a field.

    Parameters
    ----------
    field_um : (width, height)
        Region whose maps are to be compared; no hole reaches into it.
    layout : {"coded", "line"}
        Pitches that are all different, or lines whose pitch grows evenly.
    holes : int, optional
        Number of holes; as many as the rules take where it is not given.
    burn : Burn, optional
    spacing_um : float, optional
        Least distance of two holes; 500 um or three diameters, whichever is more, where it is not given.
    margin_um : float, optional
        From the field's edge to the centres; 1.5 diameters where it is not given. Widened to whole steps of 50 um.
    origin_um : (x, y)
        Stage coordinates of the lower left corner of what will be imaged.
    seed : int
        Another seed, another pattern; the same seed, the same pattern.

    Returns
    -------
    pattern : Pattern
    rules : tuple of Rule
        What was measured; all are kept.

    Raises
    ------
    MarkError
        If a number is impossible, or no pattern keeps the rules: the message names the rule and what helps.
    """
    burn = burn or Burn()
    _check(field_um, burn, spacing_um, margin_um, holes)
    found: tuple[Pattern, tuple[Rule, ...]] | None = None
    reasons: dict[int, str] = {}
    for count in (holes,) if holes is not None else _COUNTS[layout]:
        blank = _blank(field_um, layout, burn, spacing_um, margin_um, origin_um, seed, name)
        found, reason = _search(blank, count, np.random.default_rng([seed, count]))
        if found is not None:
            return found
        reasons[count] = reason
    size = " x ".join(f"{v / 1000:g}" for v in field_um)
    more = " The layout 'coded' takes less room." if layout == "line" else ""
    raise MarkError(f"No {layout} pattern around {size} mm keeps the rules. {reasons[min(reasons)]}{more}")


def _check(
    field_um: tuple[float, float], burn: Burn, spacing_um: float | None, margin_um: float | None, holes: int | None
) -> None:
    faults: list[str] = []
    if not all(500 <= side <= 1e6 for side in field_um):
        faults.append(f"a field of {field_um[0]:g} x {field_um[1]:g} um; 500 to 1000000 um a side are possible")
    if not 10 <= burn.diameter_um <= 2000:
        faults.append(f"a diameter of {burn.diameter_um:g} um; 10 to 2000 um are possible, 150 to 200 um usual")
    if not 0 <= burn.rim_um <= 2000:
        faults.append(f"a burnt rim of {burn.rim_um:g} um; 0 to 2000 um are possible")
    if not 1e-6 <= burn.pulse_s <= 1:
        faults.append(f"a pulse of {burn.pulse_s:g} s; up to 1 s is possible, 0.005 s usual")
    if not 0 <= burn.pause_s <= 60:
        faults.append(f"a pause of {burn.pause_s:g} s; up to 60 s are possible, 0.1 s usual")
    least = SPACING_DIAMETERS * burn.diameter_um
    if spacing_um is not None and not least <= spacing_um <= 1e6:
        faults.append(f"a spacing of {spacing_um:g} um; the burnt zones touch below 3 diameters, {least:g} um")
    inwards = 0.5 * burn.diameter_um + burn.rim_um
    if margin_um is not None and not inwards <= margin_um <= 1e6:
        faults.append(f"a margin of {margin_um:g} um; the burnt rims reach into the field below {inwards:g} um")
    if holes is not None and not 1 <= holes <= 120:
        faults.append(f"{holes} holes; 12 to 120 are possible, 20 to 40 usual")
    if faults:
        raise MarkError(f"No pattern can be planned with {'; '.join(faults)}.")


def _blank(
    field_um: tuple[float, float],
    layout: Literal["coded", "line"],
    burn: Burn,
    spacing_um: float | None,
    margin_um: float | None,
    origin_um: tuple[float, float],
    seed: int,
    name: str,
) -> Pattern:
    """Return the pattern without its holes: field, frame and view."""
    least = margin_um if margin_um is not None else max(1.5 * burn.diameter_um, 0.5 * burn.diameter_um + burn.rim_um)
    # Opposite corners lie whole steps apart, so the margins take up what the field leaves over.
    frame = [STEP_UM * np.ceil((side + 2 * least) / STEP_UM - 1e-9) for side in field_um]
    margin = tuple(float(outer - side) / 2 for outer, side in zip(frame, field_um, strict=True))
    apart = spacing_um if spacing_um is not None else max(LEAST_PITCH_UM, SPACING_DIAMETERS * burn.diameter_um)
    return Pattern(
        name=name, layout=layout, positions_um=(), lines=(), field_um=(float(field_um[0]), float(field_um[1])),
        margin_um=(margin[0], margin[1]), border_um=border_of(burn), origin_um=origin_um, spacing_um=float(apart),
        burn=burn, seed=seed,
    )  # fmt: skip


def _search(
    blank: Pattern, count: int, rng: np.random.Generator
) -> tuple[tuple[Pattern, tuple[Rule, ...]] | None, str]:
    """Draw patterns until some keep all rules; the one with the weakest rival, or the reason why there is none."""
    area = area_rule(blank, count)
    if not area.passed:
        return None, f"With {count} holes, {area.sentence()}: {area.remedy}."
    kept: list[tuple[tuple[float, float], Pattern, tuple[Rule, ...]]] = []
    nearest: list[Rule] | None = None
    searched = 0
    for _ in range(_ATTEMPTS["line" if blank.layout == "line" else "coded"]):
        pattern = _drawn(blank, count, rng)
        if pattern is None:
            continue
        rules = simple_rules(pattern)
        broken = [rule for rule in rules if not rule.passed]
        if not broken:
            rules = (*rules, code_rule(pattern))
            broken = [rule for rule in rules if not rule.passed]
        if not broken:
            searched += 1
            rules = (*rules, *matching_rules(pattern))
            broken = [rule for rule in rules if not rule.passed]
        if not broken:
            rival = max(rule.value for rule in rules if rule.sense == "at most" and not rule.unit)
            code = next(rule.value for rule in rules if rule.name == "code")
            kept.append(((round(rival, 6), -code), pattern, rules))
            if len(kept) == _COMPARED:
                break
        elif nearest is None or len(broken) < len(nearest):
            nearest = broken
        if searched == _LARGEST_SEARCH or (nearest is not None and any(rule.name in _HOPELESS for rule in nearest)):
            break
    if kept:
        _, pattern, rules = min(kept, key=lambda entry: entry[0])
        return (pattern, rules), ""
    if nearest is None:
        return None, (
            f"rule 'spacing': {count} holes do not fit with {blank.spacing_um:g} um between any two: take fewer or "
            "smaller holes, a larger field, or a smaller --spacing-um."
        )
    return None, f"With {count} holes, " + "; ".join(f"{rule.sentence()}: {rule.remedy}" for rule in nearest) + "."


def _drawn(blank: Pattern, count: int, rng: np.random.Generator) -> Pattern | None:
    """Draw one pattern; None where a side has no room."""
    width, height = (round(side / STEP_UM) for side in blank.frame_um)
    lengths = (width, height, width, height)
    apart = int(np.ceil(blank.spacing_um / STEP_UM - 1e-9))
    marker = max(apart, int(np.ceil(MARKER_DIAMETERS * blank.burn.diameter_um / STEP_UM)))
    # Three corners hold holes too.
    shares = share_out(count - 3, lengths, min(_LEAST_A_SIDE, max(1, (count - 3) // 4)))
    rates = growing_rates(rng)
    used: set[int] = set()
    sides: list[Ints] = []
    for side, (length, share) in enumerate(zip(lengths, shares, strict=True)):
        ruler = Ruler(
            length=length, start=side != 0, end=side != 3, apart=apart, marker=marker,
            view=blank.view_um[side % 2] / STEP_UM, border=blank.border_um / STEP_UM,
            radius=0.5 * blank.burn.diameter_um / STEP_UM,
        )  # fmt: skip
        if blank.layout == "coded":
            inner = coded_side(ruler, share, used, rng)
        else:
            inner = growing_side(ruler, share, rates[side])
        if inner is None:
            return None
        used |= coded_distances(ruler, inner)
        sides.append(inner)
    points, owner = placed((sides[0], sides[1], sides[2], sides[3]), width, height)
    low = np.array(blank.frame_low_um)
    return Pattern(
        name=blank.name, layout=blank.layout, positions_um=tuple((float(x), float(y)) for x, y in points + low),
        lines=tuple(SIDES[side] for side in owner), field_um=blank.field_um, margin_um=blank.margin_um,
        border_um=blank.border_um, origin_um=blank.origin_um, spacing_um=blank.spacing_um, burn=blank.burn,
        seed=blank.seed,
    )  # fmt: skip
