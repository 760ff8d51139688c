"""The rules that a pattern has to keep, each with what was measured, its limit, and what helps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from planish.core.errors import MarkError
from planish.core.typing import Bools
from planish.marks.design.pattern import Pattern
from planish.marks.design.selfmatch import TOLERANCE_UM, code_misfit_um, self_motions

Sense = Literal["at least", "at most"]

LEAST_HOLES, MOST_HOLES = 12, 120
RADIUS_SHARE = 0.4
SPACING_DIAMETERS = 3.0
AREA_SHARE = 0.03
CROP = 0.3
SURVIVORS = 4
RIVAL_SHARE = 0.5
MARKER_DIAMETERS = 6.0
_FEW = 6  # of so few survivors, three may meet by chance; four are needed to believe an arrangement

_REMEDY = "use unequal pitches, or another seed"
_FEWER = "take fewer or smaller holes, or a larger field"
_LARGER = "take fewer or smaller holes, a larger field, or a larger margin"
_MEET = "share of the holes that meet holes when the pattern is"
# Sense, unit, what is measured, and what to change where the rule is broken.
_RULES: dict[str, tuple[Sense, str, str, str]] = {
    "count": ("at least", "holes", "holes of the pattern", "burn more holes"),
    "around": (
        "at most", "holes", "holes whose burnt rim reaches into the field",
        "move them outwards, or give a smaller field or a larger margin",
    ),
    "radius": (
        "at least", "", "rms distance from the holes' centroid, as a share of the field's diagonal",
        "put more holes near the corners, widen the margin, or take another number of holes",
    ),
    "spacing": ("at least", "um", "least distance of two holes; burnt zones must not touch", _FEWER),
    "area": ("at most", "%", "area of holes and rims, as a share of the view's", _LARGER),
    "marker": (
        "at least", "um", "how much farther one corner of the frame is from its nearest hole than the others",
        "put holes into three corners of the frame and end the last line short of the fourth",
    ),
    "crop": (
        "at least", "holes", "whole holes left when 30 % of width and height are cut off at up to three sides",
        "take more holes, 20 or more, and spread them along all four sides",
    ),
    "code": ("at least", "um", "misfit of any 4 consecutive holes with any other 4", _REMEDY),
    "half turn": ("at most", "", f"{_MEET} turned by about 180 degrees", _REMEDY),
    "quarter turn": ("at most", "", f"{_MEET} turned by about 90 degrees", _REMEDY),
    "mirror": ("at most", "", f"{_MEET} turned over, about any axis", _REMEDY),
    "shift": ("at most", "", f"{_MEET} shifted, scaled by 3 % or turned by another angle", _REMEDY),
    "crop told apart": (
        "at most", "", "share of the holes left by the worst crop that meet holes elsewhere", _REMEDY
    ),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule, applied to one pattern.

    Attributes
    ----------
    name : str
    value, limit : float
        Measured, and allowed.
    sense : {"at least", "at most"}
        What the value has to be against the limit.
    unit : str
        Of value and limit.
    meaning, remedy : str
        What is measured, and what to change where the rule is broken.
    """

    name: str
    value: float
    limit: float
    sense: Sense
    unit: str
    meaning: str
    remedy: str

    @property
    def passed(self) -> bool:
        """Return whether the rule is kept."""
        if not np.isfinite(self.value):
            return self.sense == "at least" and self.value > 0
        slack = 1e-9 * max(abs(self.limit), 1.0)
        return self.value >= self.limit - slack if self.sense == "at least" else self.value <= self.limit + slack

    def sentence(self) -> str:
        """Write what was measured and what is needed."""
        unit = f" {self.unit}" if self.unit else ""
        return f"rule '{self.name}' ({self.meaning}): {self.value:.3g}{unit}, {self.sense} {self.limit:.3g}{unit}"


def check_pattern(pattern: Pattern) -> tuple[Rule, ...]:
    """Apply every rule to a pattern.

    Raises
    ------
    MarkError
        If there are more holes than can be checked.
    """
    if len(pattern.holes) > MOST_HOLES:
        raise MarkError(
            f"{len(pattern.holes)} holes are more than the {MOST_HOLES} that are checked; 20 to 40 are enough."
        )
    return (*simple_rules(pattern), *code_rules(pattern), *matching_rules(pattern))


def simple_rules(pattern: Pattern) -> tuple[Rule, ...]:
    """Apply the rules that need no search: count, place, radius, spacing, area, marker, crop."""
    points, diameter = pattern.points_um, pattern.diameter_um
    n, field = len(points), np.array(pattern.field_um)
    away = np.maximum(np.abs(points - np.array(pattern.field_low_um) - field / 2) - field / 2, 0.0)
    inside = int(np.sum(np.hypot(*away.T) < pattern.burnt_um - 1e-6))
    radius = float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
    gaps = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) + np.diag(np.full(n, np.inf))
    least = max(SPACING_DIAMETERS * diameter, pattern.spacing_um)
    return (
        _rule("count", n, LEAST_HOLES),
        _rule("around", inside, 0),
        _rule("radius", radius / float(np.hypot(*field)), RADIUS_SHARE),
        _rule("spacing", float(gaps.min()), least),
        area_rule(pattern, n),
        _rule("marker", _marker_um(pattern), MARKER_DIAMETERS * diameter),
        _rule("crop", int(crops(pattern).sum(axis=1).min()), SURVIVORS),
    )


def area_rule(pattern: Pattern, count: int) -> Rule:
    """Apply the rule on the area that is burnt, for so many holes; the field itself loses none of it."""
    burnt = count * np.pi / 4 * (pattern.diameter_um + 2 * pattern.rim_um) ** 2
    return _rule("area", 100 * burnt / (pattern.view_um[0] * pattern.view_um[1]), 100 * AREA_SHARE)


def code_rules(pattern: Pattern) -> tuple[Rule, ...]:
    """Apply the rule that any 4 consecutive holes identify their place."""
    return (_rule("code", code_misfit_um(pattern.points_um), TOLERANCE_UM),)


def matching_rules(pattern: Pattern) -> tuple[Rule, ...]:
    """Apply the rules against taking the pattern for itself in another position."""
    points, masks = pattern.points_um, crops(pattern)
    motions = self_motions(points)
    kinds = ("half turn", "quarter turn", "mirror", "shift")
    worst = float(np.max(motions.best_counts(masks) / np.maximum(masks.sum(axis=1), _FEW)))
    rivals = [_rule(kind, motions.best_count(kind) / len(points), RIVAL_SHARE) for kind in kinds]
    return (*rivals, _rule("crop told apart", worst, RIVAL_SHARE))


def crops(pattern: Pattern) -> Bools:
    """Return which holes survive each crop, (crops, n).

    A crop is a window of 70 % of the view's width and 70 % of its height that keeps at least one side of the view: it
    cuts off 30 % at one side or shares them between two opposite sides, and that in both directions. A window that
    cuts all four sides loses whatever lies around the field, so no pattern could keep it. A hole survives whole.
    """
    points = pattern.points_um - np.array(pattern.origin_um)
    view = np.array(pattern.view_um)
    radius = 0.5 * pattern.diameter_um
    survivors: list[Bools] = []
    for across in (0, 1):  # the direction across the side that the crop keeps
        along = 1 - across
        length, depth = (1 - CROP) * view[along], (1 - CROP) * view[across]
        steps = np.concatenate(
            [points[:, along] - radius + 1e-3, points[:, along] + radius - length - 1e-3, [0.0, CROP * view[along]]]
        )
        steps = np.unique(np.clip(steps, 0.0, CROP * view[along]))
        low, high = points[:, along] - radius, points[:, along] + radius
        inside = (low >= steps[:, None]) & (high <= steps[:, None] + length)
        survivors.append(inside & (points[:, across] + radius <= depth))
        survivors.append(inside & (points[:, across] - radius >= view[across] - depth))
    return np.unique(np.concatenate(survivors), axis=0)


def _marker_um(pattern: Pattern) -> float:
    """Measure how much farther the emptiest corner of the frame is from its nearest hole than the next one."""
    low, size = np.array(pattern.frame_low_um), np.array(pattern.frame_um)
    corners = low + size * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    nearest = np.sort(np.hypot(*(corners[:, None] - pattern.points_um[None]).transpose(2, 0, 1)).min(axis=1))
    return float(nearest[3] - nearest[2])


def _rule(name: str, value: float, limit: float) -> Rule:
    return Rule(name, value, limit, *_RULES[name])
