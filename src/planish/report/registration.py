"""Marks on what they belong to: what the transformation leaves of them, and how far a place may be off."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import Normalize

from planish.report.draw import (
    BESIDE,
    FULL,
    INK,
    Array,
    Canvas,
    Field,
    Picture,
    contours,
    field,
    half_page,
    halo,
    levels_between,
    limits,
    pitch,
    round_below,
    scale_bar,
)
from planish.report.ground import Ground, draw_ground, keep_view, outline
from planish.report.text import capital, count, length, plain
from planish.report.warp import GEOMETRY

ARROW = "#ff5238"
_EDGE = "#39c5ff"
_MARK = "#ffb000"
_AXIS = 0.78  # inches of the corner that shows an axis
_STEPS = 5  # lines between the smallest and the largest expected error


def draw_registration(
    ground: Ground,
    marks: xr.Dataset,
    *,
    hole_um: float,
    title: str = "Marks and their residuals",
    source: str = "the volume",
    axis: tuple[float, str] | None = None,
    width: float = FULL,
) -> Picture:
    """Draw a ground with its marks, numbered, and the residual of each as an arrow.

    Parameters
    ----------
    ground : Ground
        In the coordinates of ``fixed_x`` and ``fixed_y``.
    marks : Dataset, dims (mark), in um
        ``fixed_x``, ``fixed_y``, ``residual_x``, ``residual_y`` (mark minus transformed mark).
    hole_um : float
        Diameter at which marks are drawn.
    title : str
    source : str
        Where the partners of the marks are, in words.
    axis : (float, str) or None
        Angle of the machine direction in degrees from x, clockwise on screen, and where it is known from.
    width : float
        Inches.
    """
    canvas, axes, shown, box = draw_ground(ground, width=width)
    if ground.edge is not None:
        outline(axes, ground.edge, ground.y, ground.x, colour=_EDGE, width=1.2)
    fixed = points(marks, "fixed")
    rx, ry = points(marks, "residual").T
    lengths = np.hypot(rx, ry)
    longest = float(lengths[np.isfinite(lengths)].max(initial=0.0))
    magnified = round_below(0.09 * shown.width / longest) if longest > 1e-9 else 1.0
    draw_marks(axes, fixed, hole_um=hole_um, size=10 if width == FULL else 8)
    # A residual is the mark in the image minus the mark that was carried over: the arrow shows where that one falls.
    axes.quiver(
        *fixed.T, -magnified * rx, -magnified * ry, angles="xy", scale_units="xy", scale=1.0, color=ARROW,
        width=0.0032 if width == FULL else 0.005, headwidth=4, headlength=4.5, headaxislength=4,
        path_effects=halo(2.0), zorder=5,
    )  # fmt: skip
    keep_view(axes, shown)
    if longest > 1e-9:
        scale_bar(
            canvas, box[0] + 0.45 * box[1], box[2] + 0.06, inches=box[1], um=shown.width / magnified,
            most=0.12, colour=ARROW, label="{} of residual",
        )  # fmt: skip
    words = ""
    if axis is not None:
        _draw_axis(canvas, box, axis[0], fixed, shown)
        words = f"MD: axis of the machine direction, {axis[0] % 180:.0f}° from x clockwise ({axis[1]}). "
    edge = f"Blue: edge of {ground.edge_of}. " if ground.edge is not None else ""
    return canvas.picture(
        kind="jpeg",
        title=title,
        caption=(
            f"{capital(ground.name)} with n = {len(fixed)} marks (orange, drawn with a diameter of "
            f"{plain(hole_um)}). Red arrows point from each mark to where the transformation puts its partner in "
            f"{source}, drawn {plain_factor(magnified)} times as long as they are; the longest is {length(longest)}. "
            f"{edge}{words}{ground.told}"
        ),
    )


def draw_marks(axes: Axes, fixed: Array, *, hole_um: float, size: float) -> None:
    """Draw marks as circles with their numbers."""
    turn = np.linspace(0, 2 * np.pi, 73)
    for k, (x, y) in enumerate(fixed):
        axes.plot(x + hole_um / 2 * np.cos(turn), y + hole_um / 2 * np.sin(turn), color=_MARK, lw=1.4)
        axes.plot([x], [y], marker="+", ms=0.6 * size, mew=1.0, color=_MARK)
        axes.annotate(
            str(k + 1), (x - 0.42 * hole_um, y - 0.42 * hole_um), xytext=(-2, 2), textcoords="offset points",
            ha="right", va="bottom", fontsize=size, fontweight="bold", color=_MARK, path_effects=halo(2.4, "#22292f"),
        )  # fmt: skip


def plain_factor(value: float) -> str:
    """Write a magnification."""
    return count(round(value)) if value >= 1 else f"{value:g}"


def draw_expected_error(
    error: xr.DataArray, marks: xr.Dataset | None, *, hole_um: float, width: float, of: str = "the image",
    shown: str = "the scanned sheet",
) -> Picture | None:  # fmt: skip
    """Draw how far each place may be off, with contour lines and the marks; None where nothing is known.

    Parameters
    ----------
    error : DataArray, dims (y, x), in um
        Root mean square of the distance between the place that the transformation gives and the true one.
    marks : Dataset, dims (mark), or None
        ``fixed_x``, ``fixed_y`` in the coordinates of ``error``.
    hole_um : float
        Diameter at which marks are drawn.
    width : float
        Inches.
    of : str
        Whose pixels they are, in words.
    shown : str
        What is shown there, in words.
    """
    y, x = error["y"].values, error["x"].values
    known = error.values[np.isfinite(error.values)].astype(np.float64)
    if known.size == 0:
        return None
    drawn = field(error.values, y, x, width=width - BESIDE)
    norm = limits(known, percent=0.1)
    even = not known.max() - known.min() > 0.02 * abs(float(known.mean()))
    if even:  # colours would tell differences that nobody can use
        norm = Normalize(0.0, 2 * float(known.mean()) or 1.0)
    canvas, axes = half_page(drawn, norm=norm, cmap=GEOMETRY, label="expected error / µm", width=width)
    levels, step = (np.empty(0), 0.0) if even else levels_between(float(known.min()), float(known.max()), steps=_STEPS)
    contours(axes, drawn, levels, labels=True)
    if marks is not None:
        draw_marks(axes, points(marks, "fixed"), hole_um=hole_um, size=10 if width == FULL else 8)
    keep_view(axes, drawn)
    lines = f"Contour lines every {length(step, 1)}. " if levels.size else ""
    numbered = "Orange: the marks, numbered as in the figure of their residuals. " if marks is not None else ""
    return canvas.picture(
        kind="jpeg",
        title="Expected error of a place",
        caption=(
            f"How far what is shown at a place of {of} may lie from what belongs there (rms, by the scatter of the "
            f"marks): {length(float(known.min()), 2)} to {length(float(known.max()), 2)}, median "
            f"{length(float(np.median(known)), 2)}. {lines}{numbered}It grows away from the marks, and an error that "
            f"all marks share is not in it. n = {count(known.size)} pixels of {plain(round(pitch(x), 4))}; unit µm; "
            f"mask: where {shown} is shown."
        ),
    )


def points(marks: xr.Dataset, name: str) -> Array:
    """Return places or differences of marks, ``(n, 2)`` as (x, y) in um."""
    return np.stack([marks[f"{name}_{axis}"].values.astype(np.float64) for axis in ("x", "y")], axis=1)


def _draw_axis(canvas: Canvas, box: tuple[float, float, float], degrees: float, fixed: Array, shown: Field) -> None:
    """Draw an axis with a head at both ends in the corner that is farthest from all marks."""
    x0, x1, y1, y0 = shown.extent
    corners = np.array([(x0, y0), (x1, y0), (x0, y1), (x1, y1)])
    known = fixed[np.isfinite(fixed).all(axis=1)]
    apart = np.hypot(*(corners[:, None] - known[None]).transpose(2, 0, 1)).min(axis=1) if known.size else np.zeros(4)
    k = int(np.argmax(apart))
    left = box[0] + (0.08 if k % 2 == 0 else box[1] - _AXIS - 0.08)
    top = 0.02 + (0.08 if k < 2 else box[2] - _AXIS - 0.08)
    corner = canvas.axes(left, top, _AXIS, _AXIS, facecolor=(1, 1, 1, 0.86))
    corner.set(xlim=(-1, 1), ylim=(1, -1), xticks=[], yticks=[])
    for spine in corner.spines.values():
        spine.set_visible(False)
    turn = np.deg2rad(degrees)
    along, beside = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    corner.annotate(
        "", xy=tuple(0.92 * along - 0.22 * beside), xytext=tuple(-0.92 * along - 0.22 * beside),
        arrowprops={"arrowstyle": "<|-|>", "color": INK, "lw": 1.5, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    corner.text(0.36 * beside[0], 0.36 * beside[1], "MD", ha="center", va="center", fontsize=9, fontweight="bold")
