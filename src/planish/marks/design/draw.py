"""The drawing of a pattern: magnified with its pitches and numbers, and in its true size to lay a specimen on."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from numpy.typing import NDArray

from planish.marks.design.pattern import Pattern
from planish.marks.design.rules import Rule
from planish.marks.design.sheet import (
    ACCENT,
    BURNT,
    FAINT,
    GROUND,
    INK,
    SOFT,
    Page,
    as_ratio,
    box,
    dimension,
    fitting_scale,
    scale_bar,
)

Array = NDArray[np.float64]

_ROOM = (180.0, 148.0)  # mm for the magnified drawing
_LEFT, _TOP = 24.0, 36.0
_ARROW = {"arrowstyle": "-|>", "lw": 1.1, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
_ASIDE = 226.0  # where the right column begins


def drawing_page(pattern: Pattern) -> Page:
    """Draw a pattern as the laser sees it, y up."""
    view = tuple(side / 1000 for side in pattern.view_um)
    low = tuple(value / 1000 for value in pattern.origin_um)
    scale = fitting_scale(view, _ROOM)
    page = Page(
        f"Laser holes: {pattern.name}",
        f"{len(pattern.positions_um)} holes around a field of {_size(pattern.field_um)} mm; as the laser sees it",
    )
    left, top = _LEFT + (_ROOM[0] - view[0] * scale) / 2, _TOP + (_ROOM[1] - view[1] * scale) / 2
    axes = page.plan(left, top, low=low, size=view, scale=scale)
    _plan(axes, pattern, numbers=True)
    _pitches(axes, pattern, scale)
    gap = 9 / scale
    frame, at = (tuple(v / 1000 for v in pair) for pair in (pattern.frame_um, pattern.frame_low_um))
    dimension(axes, (at[0], low[1] + view[1] + gap), (at[0] + frame[0], low[1] + view[1] + gap), f"{frame[0]:g} mm")
    dimension(axes, (low[0] - gap, at[1]), (low[0] - gap, at[1] + frame[1]), f"{frame[1]:g} mm")
    _origin(axes, pattern, scale)
    scale_bar(page, _LEFT, 199, scale=scale, most=40)
    page.text(_LEFT + 66, 200.4, f"drawn {as_ratio(scale)} on A4; pitches in mm", color=SOFT)
    _aside(page, pattern)
    return page


def rules_table(page: Page, left: float, top: float, rules: tuple[Rule, ...]) -> None:
    """Write the rules with what was measured."""
    page.text(left, top, "Rules", fontweight="bold", fontsize=9)
    for k, rule in enumerate(rules):
        y = top + 6 + 4.9 * k
        page.text(left, y, rule.name, color=SOFT, fontsize=7.5)
        page.text(left + 39, y, rule_value(rule), ha="right", fontsize=7.5, color=INK if rule.passed else ACCENT)
        page.text(left + 41, y, f"{'≥' if rule.sense == 'at least' else '≤'} {rule.limit:.4g}", fontsize=7.5)


def rule_value(rule: Rule) -> str:
    """Write what was measured, with its unit."""
    digits = f"{rule.value:.0f}" if rule.unit in ("um", "holes") else f"{rule.value:.2f}"
    return f"{digits} {rule.unit.replace('um', 'µm')}".strip()


def _plan(axes: Axes, pattern: Pattern, *, numbers: bool) -> None:
    """Draw field, view and holes to scale."""
    view, low = ([v / 1000 for v in pair] for pair in (pattern.view_um, pattern.origin_um))
    field, at = ([v / 1000 for v in pair] for pair in (pattern.field_um, pattern.field_low_um))
    box(axes, at, field, fill=True, facecolor=GROUND, edgecolor=SOFT if numbers else FAINT, lw=0.5)
    if numbers:
        box(axes, low, view, edgecolor=SOFT, lw=0.5, ls=(0, (5, 3)))
    burn = pattern.burn
    for x, y in pattern.points_um / 1000:
        outer = 0.0005 * burn.diameter_um + 0.001 * burn.rim_um
        axes.add_patch(Circle((x, y), outer, facecolor=BURNT, edgecolor="none", clip_on=False))
        axes.add_patch(Circle((x, y), 0.0005 * burn.diameter_um, facecolor=INK, edgecolor="none", clip_on=False))
    if not numbers:
        return
    axes.text(
        at[0] + field[0] / 2, at[1] + field[1] / 2, f"field {_size(pattern.field_um)} mm\nno hole reaches into it",
        ha="center", va="center", color=SOFT, fontsize=9, linespacing=1.6,
    )  # fmt: skip
    inwards = _inwards(pattern)
    for label, (x, y), (dx, dy) in zip(pattern.labels, pattern.points_um / 1000, inwards, strict=True):
        axes.annotate(
            label, (x, y), (9 * dx, 9 * dy), textcoords="offset points", ha="center", va="center", fontsize=6.5,
            annotation_clip=False,
        )  # fmt: skip


def _inwards(pattern: Pattern) -> Array:
    """Direction (n, 2) from each hole into the field."""
    points = pattern.points_um - np.array(pattern.frame_low_um)
    size = np.array(pattern.frame_um)
    near = 0.02 * size.min()
    inwards = (points < near).astype(np.float64) - (points > size - near)
    corner = inwards.all(axis=1)
    inwards[corner] *= -1.1  # the numbers of the neighbours stand inside
    inwards[~inwards.any(axis=1)] = [0.7, 0.7]
    return inwards


def _pitches(axes: Axes, pattern: Pattern, scale: float) -> None:
    """Write the distance between neighbours on a line beside it."""
    if pattern.layout == "own":
        return
    points, low, size = pattern.points_um / 1000, pattern.frame_low_um, pattern.frame_um
    # Middle of each side, and whether it runs upwards; the text stands outside.
    beside = 4.2 / scale + pattern.border_um / 1000
    for axis, end in ((0, 0), (1, 1), (0, 1), (1, 0)):
        level = (low[1 - axis] + end * size[1 - axis]) / 1000
        on = np.sort(points[np.abs(points[:, 1 - axis] - level) < 1e-6][:, axis])
        place = level + (beside if end else -beside)
        for a, b in pairwise(on):
            x, y = ((a + b) / 2, place) if axis == 0 else (place, (a + b) / 2)
            axes.text(
                x, y, f"{b - a:.2f}", ha="center", va="center", fontsize=6, color=SOFT, rotation=90 * axis,
                clip_on=False,
            )  # fmt: skip


def _origin(axes: Axes, pattern: Pattern, scale: float) -> None:
    """Mark the stage's origin, its axes, and the empty corner."""
    x, y = (value / 1000 for value in pattern.origin_um)
    arm = 11 / scale
    for dx, dy, name in ((arm, 0.0, "x"), (0.0, arm, "y")):
        axes.annotate(
            "", (x + dx, y + dy), (x, y), annotation_clip=False,
            arrowprops={**_ARROW, "color": ACCENT},
        )  # fmt: skip
        axes.annotate(
            name, (x + dx, y + dy), (6 if dx else 0, 6 if dy else 0), textcoords="offset points", color=ACCENT,
            ha="center", va="center", fontsize=8, annotation_clip=False,
        )  # fmt: skip
    axes.plot([x], [y], "o", ms=3.5, color=ACCENT, clip_on=False)
    origin = ", ".join(f"{value / 1000:g}" for value in pattern.origin_um)
    axes.annotate(
        f"stage {origin} mm", (x, y), (-4, -20), textcoords="offset points", color=ACCENT, fontsize=7, ha="left",
        va="center", annotation_clip=False,
    )  # fmt: skip
    if pattern.layout == "own":
        return
    corner = [value / 1000 for value in pattern.frame_low_um]
    axes.plot(*[[value] for value in corner], "o", ms=7, mfc="none", mec=ACCENT, mew=0.9, clip_on=False)
    inwards = [v / 1000 for v in pattern.field_low_um]
    axes.annotate(
        "no hole in this corner:\nit shows the orientation", (corner[0], corner[1]),
        (inwards[0] + 13 / scale, inwards[1] + 13 / scale), color=ACCENT, fontsize=7.5, ha="left", va="bottom",
        arrowprops={"arrowstyle": "-", "color": ACCENT, "lw": 0.6, "shrinkB": 5},
    )  # fmt: skip


def _aside(page: Page, pattern: Pattern) -> None:
    """Write the parameters and draw the pattern in its true size, where there is room."""
    burn = pattern.burn
    page.text(_ASIDE, 38, "To burn", fontweight="bold", fontsize=9)
    rows = [
        ("layout", f"{pattern.layout}, seed {pattern.seed}"),
        ("hole", f"{burn.diameter_um:g} µm"),
        ("burnt rim", f"{burn.rim_um:g} µm"),
        ("pulse, pause", f"{1000 * burn.pulse_s:g} ms, {1000 * burn.pause_s:g} ms"),
        ("margin to field", f"{pattern.margin_um[0]:g}, {pattern.margin_um[1]:g} µm"),
        ("least spacing", f"{pattern.spacing_um:g} µm"),
        ("to be imaged", f"{_size(pattern.view_um)} mm"),
    ]
    bottom = page.rows(_ASIDE, 44, rows, across=27, step=4.9)
    page.text(_ASIDE, bottom + 4, "dashed: what both instruments", color=SOFT, fontsize=7)
    page.text(_ASIDE, bottom + 7.6, "have to image; dark: the hole;", color=SOFT, fontsize=7)
    page.text(_ASIDE, bottom + 11.2, "brown: its burnt rim", color=SOFT, fontsize=7)
    view = tuple(side / 1000 for side in pattern.view_um)
    if view[0] <= 62 and view[1] <= 95:
        page.text(_ASIDE, bottom + 22, "True size (print without fitting)", fontweight="bold", fontsize=9)
        low = tuple(value / 1000 for value in pattern.origin_um)
        axes = page.plan(_ASIDE, bottom + 26, low=low, size=view, scale=1.0)
        _plan(axes, pattern, numbers=False)
        scale_bar(page, _ASIDE, bottom + 29 + view[1], scale=1.0, most=10)
    page.divide(_ASIDE - 6)


def _size(size_um: tuple[float, float]) -> str:
    return " × ".join(f"{side / 1000:g}" for side in size_um)
