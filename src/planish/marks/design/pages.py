"""Two more pages: the error that a pattern allows over its field, and the path of the stage."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from planish.marks.design.draw import rules_table
from planish.marks.design.params import ImagingParams
from planish.marks.design.pattern import Pattern
from planish.marks.design.predict import P95, Predicted
from planish.marks.design.rules import Rule
from planish.marks.design.sheet import ACCENT, INK, SOFT, Page, as_ratio, box, fitting_scale, scale_bar
from planish.marks.design.simulate import DryRun

_LEFT, _TOP = 14.0, 34.0
_ROOM = (190.0, 150.0)
_ASIDE = 232.0
_FINE = 200  # pixels along the longer side of the map


def error_page(pattern: Pattern, predicted: Predicted, imaging: ImagingParams, rules: tuple[Rule, ...]) -> Page:
    """Draw the predicted error over the field, with its numbers and the rules."""
    page = Page(
        "Predicted error of the registration",
        "rms distance between a point of one map and the same point of the other, by the marks alone; similarity",
    )
    view, low = ([v / 1000 for v in pair] for pair in (pattern.view_um, pattern.origin_um))
    field, at = (np.array(pair) / 1000 for pair in (pattern.field_um, pattern.field_low_um))
    scale = fitting_scale(view, _ROOM)
    left, top = _LEFT + (_ROOM[0] - view[0] * scale) / 2, _TOP + (_ROOM[1] - view[1] * scale) / 2
    axes = page.plan(left, top, low=low, size=view, scale=scale)
    across, up = (np.linspace(0, side, max(20, round(_FINE * side / field.max()))) for side in field)
    grid = np.stack(np.meshgrid(at[0] + across, at[1] + up), axis=-1)
    error = predicted.at(1000 * grid)
    norm = Normalize(float(error.min()), float(error.max()))
    extent = (float(at[0]), float(at[0] + field[0]), float(at[1]), float(at[1] + field[1]))
    axes.imshow(
        error, extent=extent, origin="lower", norm=norm, cmap="cividis", aspect="auto", interpolation="bilinear"
    )
    axes.set_xlim(low[0], low[0] + view[0])
    axes.set_ylim(low[1], low[1] + view[1])
    levels = np.linspace(float(error.min()), float(error.max()), 7)[1:-1]
    lines = axes.contour(grid[..., 0], grid[..., 1], error, levels=levels, colors="white", linewidths=0.6)
    axes.clabel(lines, fmt="%.2f", fontsize=7)
    box(axes, at.tolist(), field.tolist(), edgecolor=SOFT, lw=0.5)
    box(axes, low, view, edgecolor=SOFT, lw=0.5, ls=(0, (5, 3)))
    x, y = pattern.points_um.T / 1000
    axes.plot(x, y, "o", ms=3.5, mfc="white", mec=INK, mew=0.8, clip_on=False)
    middle = at + field / 2
    corners = at + field * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    worst = corners[int(np.argmax(predicted.at(1000 * corners)))]
    for place, value, name in ((middle, predicted.centre_um, "middle"), (worst, predicted.corner_um, "worst corner")):
        axes.plot(place[0], place[1], "+", ms=9, mew=1.4, color=ACCENT, clip_on=False)
        inwards = np.sign(middle - place)
        axes.annotate(
            f"{name}: {value:.2f} µm", (place[0], place[1]), (10 * (inwards[0] or 0), 12 * (inwards[1] or -1)),
            textcoords="offset points", ha={1: "left", 0: "center", -1: "right"}[int(inwards[0])], va="center",
            fontsize=8.5, bbox={"boxstyle": "round,pad=0.3", "facecolor": "white", "edgecolor": "none", "alpha": 0.9},
        )  # fmt: skip
    bar = page.figure.colorbar(
        ScalarMappable(norm=norm, cmap="cividis"), cax=page.axes(left + view[0] * scale + 4, top, 3.5, view[1] * scale)
    )
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    bar.ax.set_title("µm", fontsize=8)
    scale_bar(page, _LEFT, 196, scale=scale, most=40)
    page.text(_LEFT + 66, 197.4, f"drawn {as_ratio(scale)} on A4", color=SOFT)
    page.text(_ASIDE, 36, "Error", fontweight="bold", fontsize=9)
    rows = [
        ("one hole", f"{predicted.fle_um:.2f} µm rms"),
        ("holes N", f"{predicted.holes}"),
        ("rms radius f", f"{predicted.radius_um / 1000:.2f} mm"),
        ("middle", f"{predicted.centre_um:.2f} µm rms"),
        ("worst corner", f"{predicted.corner_um:.2f} µm rms"),
        ("95 % there", f"< {P95 * predicted.corner_um:.2f} µm"),
        ("pixels", f"{imaging.pixel_um[0]:g} and {imaging.pixel_um[1]:g} µm"),
        ("rim roughness", f"{imaging.roughness_um:g} µm"),
        ("varies over", f"{imaging.rim_length_um:g} µm"),
    ]
    bottom = page.rows(_ASIDE, 42, rows, across=24, step=4.9)
    page.text(_ASIDE, bottom + 3, "error² = hole² / N · (1 + r² / f²),", color=SOFT, fontsize=7)
    page.text(_ASIDE, bottom + 6.6, "r from the holes' centroid", color=SOFT, fontsize=7)
    rules_table(page, _ASIDE, bottom + 17, rules)
    page.divide(_ASIDE - 6)
    return page


def path_page(run: DryRun, *, title: str = "Path of the stage") -> Page:
    """Draw the path of a stage program, from its dry run."""
    page = Page(title, run.sentence())
    points, path = run.fired_um / 1000, run.path_um / 1000
    low, size = path.min(axis=0), np.maximum(np.ptp(path, axis=0), 1.0)
    border = 0.03 * float(size.max())
    low, size = low - border, size + 2 * border
    scale = fitting_scale(size.tolist(), _ROOM)
    left, top = _LEFT + (_ROOM[0] - size[0] * scale) / 2, _TOP + (_ROOM[1] - size[1] * scale) / 2
    axes = page.plan(left, top, low=low.tolist(), size=size.tolist(), scale=scale)
    axes.plot(path[:, 0], path[:, 1], "-", color=SOFT, lw=0.8, clip_on=False)
    for a, b in pairwise(path):
        if np.hypot(*(b - a)) * scale > 8:
            middle = (a + b) / 2
            axes.annotate(
                "", middle + 0.01 * (b - a), middle,
                arrowprops={"arrowstyle": "-|>", "color": SOFT, "lw": 0.8, "mutation_scale": 8},
            )  # fmt: skip
    axes.plot(points[:, 0], points[:, 1], "o", ms=4.5, color=ACCENT, clip_on=False)
    middle = low + size / 2
    for k, point in enumerate(points):
        away = np.sign(middle - point) * (np.abs(middle - point) > 0.4 * size)
        away = away if away.any() else np.array([0.7, 0.7])
        axes.annotate(
            str(k + 1), (point[0], point[1]), tuple(9 * away), textcoords="offset points", ha="center", va="center",
            fontsize=6.5, annotation_clip=False,
        )  # fmt: skip
    for place, name, dy in ((path[0], "begins", 7), (path[-1], "ends", -7)):
        axes.plot(place[0], place[1], "s", ms=5, mfc="white", mec=INK, clip_on=False)
        axes.annotate(
            name, (place[0], place[1]), (-7, dy), textcoords="offset points", fontsize=7.5, ha="right", va="center",
            annotation_clip=False,
        )  # fmt: skip
    scale_bar(page, _LEFT, 196, scale=scale, most=40)
    page.text(_LEFT + 66, 197.4, f"drawn {as_ratio(scale)} on A4; numbers: order of the shots", color=SOFT)
    page.text(_ASIDE, 36, "Dry run", fontweight="bold", fontsize=9)
    pause = "-" if not np.isfinite(run.least_pause_s) else f"{1000 * run.least_pause_s:.0f} ms"
    shots = sorted({f"{1000 * value:g}" for value in run.pulse_s})
    rows = [
        ("shots", str(len(points))),
        ("pulse", f"{', '.join(shots[:3])} ms"),
        ("laser off", f"≥ {pause}"),
        ("path", f"{run.length_um / 1000:.1f} mm"),
        ("time", f"{run.time_s:.1f} s"),
        ("x", f"{path[:, 0].min():g} to {path[:, 0].max():g} mm"),
        ("y", f"{path[:, 1].min():g} to {path[:, 1].max():g} mm"),
    ]
    bottom = page.rows(_ASIDE, 42, rows, across=20, step=4.9)
    page.text(_ASIDE, bottom + 3, "time without acceleration", color=SOFT, fontsize=7)
    page.divide(_ASIDE - 6)
    return page
