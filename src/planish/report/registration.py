"""Marks on what they belong to: residuals, expected error, and where the maps themselves lie against each other."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import LagNumbers
from planish.core.facts import is_known
from planish.core.numbers import capital, count, in_words, length, plain
from planish.marks.exchange.model import points_of
from planish.report import draw
from planish.report.colours import GEOMETRY, GREYS, Array, Scale, limits
from planish.report.text import title_of, with_article
from planish.results import RegistrationFacts

ARROW, EDGE = "#ff5238", "#39c5ff"
_MARK, _SILENT = "#ffb000", "#7d8790"
_AXIS = 78.0  # pixels of the corner that shows an axis
_BLANK = 64  # pixels across a ground that shows nothing


@dataclass(frozen=True, slots=True)
class Ground:
    """A picture to draw on: values in grey, the border of another layer, what it is, and the words for a caption."""

    values: Array
    y: Array
    x: Array
    scale: Scale
    name: str
    caption: str
    edge: NDArray[np.bool_] | None = None
    edge_of: str = ""

    def draw(self, width: float) -> tuple[draw.Canvas, draw.Axes]:
        """Draw it with its scale bar, and the border where there is one; below it is room for another scale bar."""
        shown = draw.reduced(self.values, self.y, self.x, width=width - draw.MARGIN)
        box = shown.fit(width - draw.MARGIN - 12, 700.0 if width == draw.FULL else 480.0)
        canvas = draw.Canvas(width, box[1] + draw.BELOW + 36)
        axes = canvas.map_axes((width - box[0] + draw.MARGIN - 12) / 2, 4, box, shown, self.scale)
        canvas.row_below(axes, 2, most=0.2)
        return canvas, axes


def ground_of(
    data: xr.DataArray, *, of: str, valid: NDArray[np.bool_] | None = None, edge: NDArray[np.bool_] | None = None,
    edge_of: str = "",
) -> Ground:  # fmt: skip
    """Return a map or image (y, x) of the layer ``of`` as ground, in grey.

    ``valid`` pixels set the grey window; ``edge`` is where the layer ``edge_of`` lies.
    """
    values, y, x = data.values.astype(np.float64), data["y"].values, data["x"].values
    window = values[valid] if valid is not None and valid.any() else values
    pixels = f"{draw.n_of(values)} pixels of {draw.pixel_of(x)}"
    name, caption = "the image", f"{title_of(data)} of {pixels}, no mask."
    if data.name != "image":
        name = f"the layer {of}"
        caption = f"In grey, {in_words(title_of(data))} of {of}: {pixels}; mask: where it is known."
    return Ground(values, y, x, limits(window, GREYS, percent=0.2), name, caption, edge, edge_of)


def blank_ground(points: Array, *, of: str) -> Ground:
    """Return an empty ground around points (x, y), for places in coordinates of which no map is at hand."""
    points = points[np.isfinite(points).all(axis=1)]
    low, high = (points.min(axis=0), points.max(axis=0)) if points.size else (np.zeros(2), np.ones(2))
    room = 0.2 * max(float((high - low).max()), 1.0)
    x, y = (np.linspace(low[k] - room, high[k] + room, _BLANK) for k in (0, 1))
    caption = f"Places are in the coordinates of {of}, which is not resampled to this grid; no map is shown, no mask."
    return Ground(np.full((_BLANK, _BLANK), np.nan), y, x, Scale(0.0, 1.0, GREYS), f"the layer {of}", caption)


def _arrows(
    canvas: draw.Canvas, axes: draw.Axes, places: Array, vectors: Array, *, share: float, most: float, label: str,
    width: float,
) -> draw.Magnified:  # fmt: skip
    """Draw vectors, the longest over a share of the width, with a scale bar of their own beside that of the ground."""
    factor = draw.magnified(vectors, share * axes.shown.width)
    axes.arrows(places, factor.times * vectors, colour=ARROW, width=width)
    if factor.longest > 1e-9:
        canvas.scale_bar(
            axes.x + 0.4 * axes.width, axes.height + draw.BELOW + 6, width=axes.width,
            um=axes.shown.width / factor.times, most=most, colour=ARROW, label=label,
        )  # fmt: skip
    return factor


def draw_registration(
    r: RegistrationFacts, ground: Ground, marks: xr.Dataset, *, hole_um: float, source: str, width: float
) -> draw.Picture:
    """Draw a ground with its marks (``fixed_*``), numbered, and the residual of each as an arrow.

    ``hole_um`` is the diameter at which marks are drawn, ``source`` the layer of their partners.
    """
    canvas, axes = ground.draw(width)
    if ground.edge is not None:
        axes.outline(ground.edge, ground.y, ground.x, colour=EDGE, width=1.6)
    fixed = points_of(marks, "fixed")
    _draw_marks(axes, fixed, hole_um=hole_um, size=14 if width == draw.FULL else 11)
    # A residual is the mark in the image minus the mark that was carried over: the arrow shows where that one falls.
    factor = _arrows(
        canvas, axes, fixed, -points_of(marks, "residual"), share=0.09, most=0.12, label="{} of residual",
        width=3.0 if width == draw.FULL else 2.2,
    )  # fmt: skip
    words = f"Blue: edge of {with_article(ground.edge_of)}. " if ground.edge is not None else ""
    if (axis := machine_direction(r, source)) is not None:
        _draw_axis(canvas, axes, axis[0], fixed)
        words += f"MD: machine direction, {axis[0] % 180:.0f}° from x clockwise ({axis[1]}). "
    table: dict[str, list[object]] = {"mark": list(range(1, marks.sizes["mark"] + 1))}
    if "label" in marks:
        table["label"] = [str(label) for label in marks["label"].values]
    for name, column in marks.data_vars.items():
        if column.dims == ("mark",) and name != "label":
            table[f"{name} / µm"] = column.values.astype(np.float64).tolist()
    return canvas.picture(
        title=f"Marks in {with_article(r.to)} and their residuals",
        caption=(
            f"{capital(ground.name)} with n = {len(fixed)} marks (orange circles of {plain(hole_um)}). Red arrows "
            f"point from each mark to its transformed partner in {with_article(source)}, {factor.words}. {words}"
            f"{ground.caption}"
        ),
        data={"marks": table},
    )


def _draw_marks(axes: draw.Axes, fixed: Array, *, hole_um: float, size: float) -> None:
    """Draw marks as circles with their numbers."""
    turn = np.linspace(0, 2 * np.pi, 49)
    ring = hole_um / 2 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for k, (x, y) in enumerate(fixed, 1):
        axes.line(ring + np.array([x, y]), colour=_MARK, width=1.9)
        axes.text(x, y, "+", shift=(0, 0.32 * size), size=size, anchor="middle", colour=_MARK)
        corner = x - 0.42 * hole_um, y - 0.42 * hole_um
        axes.text(*corner, str(k), shift=(-2, -2), size=size, anchor="end", colour=_MARK, halo=draw.INK, bold=True)


def draw_expected_error(
    error: xr.DataArray, marks: xr.Dataset | None, *, hole_um: float, width: float, of: str, shown: str
) -> draw.Picture | None:
    """Draw the expected error of each place, with contour lines and the marks; None where nothing is known.

    ``of`` is the layer whose pixels they are, ``shown`` the one that was brought to them.
    """
    y, x = error["y"].values, error["x"].values
    errors = error.values[np.isfinite(error.values)].astype(np.float64)
    if errors.size == 0:
        return None
    least, mean, most = float(errors.min()), float(errors.mean()), float(errors.max())
    scale = limits(errors, GEOMETRY, percent=0.1)
    levels, step = draw.levels_between(least, most, steps=5)
    if not most - least > 0.02 * abs(mean):  # colours would show differences that nobody can use
        scale, levels = Scale(0.0, 2 * mean or 1.0, GEOMETRY), np.empty(0)
    canvas, axes = draw.draw_map(error.values, y, x, scale=scale, label="expected error / µm", width=width)
    places = points_of(marks, "fixed") if marks is not None else np.empty((0, 2))
    axes.contours(levels, labels=True, avoid=places)
    _draw_marks(axes, places, hole_um=hole_um, size=14 if width == draw.FULL else 11)
    lines = f"Contour lines every {length(step, 1)}. " if levels.size else ""
    numbered = "Orange: the marks, numbered as in the figure of their residuals. " if marks is not None else ""
    return canvas.picture(
        title="Expected error",
        caption=(
            f"Expected error of the position in {with_article(of)} (rms, from the scatter of the marks): "
            f"{length(least, 2)} to {length(most, 2)}, median {length(float(np.median(errors)), 2)}. {lines}{numbered}"
            f"It grows away from the marks; an error that all marks share is not included. n = {draw.n_of(errors)} "
            f"pixels of {draw.pixel_of(x)}; unit µm; mask: where {with_article(shown)} is shown."
        ),
    )


def draw_lags(lag: LagNumbers | None, ground: Ground, *, first: str, second: str) -> draw.Picture | None:
    """Draw the lags of the tiles of two maps, named in words, that have a distinct one; None where there are none."""
    if lag is None:
        return None
    places, lags, silent = lag_places(lag, ground)
    if not len(places):
        return None
    canvas, axes = ground.draw(draw.HALF)
    axes.dots(silent, size=4, colour=_SILENT, halo="white")
    axes.dots(places, size=4, colour=ARROW, halo="white")
    factor = _arrows(canvas, axes, places, lags, share=0.11, most=0.16, label="{} of lag", width=2.2)
    doubt = " The check as a whole is inconclusive: read the arrows with caution." if lag.silence else ""
    side = f" of {plain(lag.tile_um)}" if is_known(lag.tile_um) else ""
    return canvas.picture(
        title="Image-based check, tile by tile",
        caption=(
            f"Arrows point from where the registration puts a piece of {first} to where {second} shows it, "
            f"{factor.words}. Parallel arrows are a shift; arrows that turn or diverge are a rotation or a stretch; "
            f"disordered arrows are chance. n = {count(len(places))} of {count(len(places) + len(silent))} overlapping "
            f"tiles{side} with a distinct lag, grey dots the others.{doubt} {ground.caption}"
        ),
    )


def machine_direction(r: RegistrationFacts, moving: str) -> tuple[float, str] | None:
    """Return the machine direction in degrees from x, clockwise on screen, and its source; None where it is unknown."""
    o = r.orientation
    if o.md_deg_fixed is not None:
        return o.md_deg_fixed, f"given for {with_article(r.to)}"
    carried = o.md_deg_fixed_from_moving
    return None if carried is None else (carried, f"carried over from {with_article(moving)}")


def lag_places(lag: LagNumbers, ground: Ground) -> tuple[Array, Array, Array]:
    """Return where tiles with a distinct lag lie on a ground, their lags, and where the others lie, (n, 2) in um.

    Tiles count from the middle of the first pixel that was compared, which may be the mean of several.
    """
    y0, x0 = (float(c[0]) + (p - draw.pitch(c)) / 2 for c, p in zip((ground.y, ground.x), lag.pixel_um, strict=True))
    rows = np.array([(t.x + x0, t.y + y0, *t.lag_um) for t in lag.tiles], dtype=np.float64).reshape(-1, 4)
    distinct = np.array([t.distinct and is_known(t.lag_um) for t in lag.tiles], dtype=bool)
    return rows[distinct, :2], rows[distinct, 2:], rows[~distinct, :2]


def _draw_axis(canvas: draw.Canvas, axes: draw.Axes, degrees: float, fixed: Array) -> None:
    """Draw an axis with a head at both ends in the corner that is farthest from all marks."""
    corners = np.array([(0, 0), (axes.width, 0), (0, axes.height), (axes.width, axes.height)])
    marks = axes.place(fixed[np.isfinite(fixed).all(axis=1)])
    gaps = np.hypot(*(corners[:, None] - marks[None]).transpose(2, 0, 1)).min(axis=1) if marks.size else np.zeros(4)
    x, y = corners[int(np.argmax(gaps))]
    x0 = axes.x + (8 if x == 0 else axes.width - _AXIS - 8)
    y0 = axes.y + (8 if y == 0 else axes.height - _AXIS - 8)
    canvas.box(x0, y0, _AXIS, _AXIS, fill="rgba(255,255,255,0.86)")
    corner = canvas.axes(x0, y0, _AXIS, _AXIS, (-1, 1, 1, -1))
    along = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    side = np.array([-along[1], along[0]])
    corner.arrows([-0.22 * side] * 2, [0.92 * along, -0.92 * along], colour=draw.INK, width=2.0, halo="")
    corner.text(0.36 * side[0], 0.36 * side[1], "MD", shift=(0, 4), anchor="middle", bold=True)
