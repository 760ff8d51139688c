"""Marks on what they belong to.

Residuals, expected error, and where the maps themselves lie against each other.
"""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from planish.analyze import LagNumbers
from planish.core.facts import is_known
from planish.core.numbers import capital, count, in_words, length, plain, with_article
from planish.core.typing import Bools, Entries
from planish.marks.exchange.model import paired, points_of
from planish.report.colours import GEOMETRY, GREYS, Array, Scale, limits
from planish.report.draw import (
    BELOW,
    FULL,
    HALF,
    INK,
    MARGIN,
    Axes,
    Canvas,
    Magnified,
    Picture,
    axes_of,
    draw_map,
    levels_between,
    magnified,
    n_of,
    pitch,
    pixel_of,
    reduced,
)
from planish.report.text import TwoTexts, title_of
from planish.results import RegistrationFacts

ARROW = "#ff5238"
EDGE = "#39c5ff"
_MARK = "#ffb000"
_SILENT = "#7d8790"  # tiles without a distinct lag
_AXIS = 78.0  # pixels of the corner that shows an axis
_BLANK = 64  # pixels across a ground that shows nothing


@dataclass(frozen=True, slots=True)
class Ground:
    """A picture to draw on.

    A map in grey, what it is, the words for a caption, and where another layer lies.
    """

    data: xr.DataArray
    scale: Scale
    name: str
    caption: str
    edge: xr.DataArray | None = None
    edge_of: str = ""

    def draw(self, width: float) -> tuple[Canvas, Axes]:
        """Draw it with its scale bar, and the border where there is one.

        Below it is room for another scale bar.
        """
        shown = reduced(self.data, width=width - MARGIN)
        highest_px = 480.0
        if width == FULL:
            highest_px = 700.0
        box = shown.fit(width - MARGIN - 12, highest_px)
        map_width, map_height = box
        canvas = Canvas(width, map_height + BELOW + 36)
        left_px = (width - map_width + MARGIN - 12) / 2
        axes = canvas.map_axes(left_px, 4, box, shown, self.scale)
        canvas.draw_scale_row(axes, 2, max_share=0.2)
        return canvas, axes


def ground_of(
    data: xr.DataArray,
    *,
    layer: str,
    valid: Bools | None = None,
    edge: xr.DataArray | None = None,
    edge_of: str = "",
) -> Ground:
    """Return a map or image (y, x) of a layer as ground, greys of its ``valid`` pixels.

    ``edge`` (y, x) is where another layer, ``edge_of``, lies. An image speaks for itself in a
    caption, a map is called by its layer.
    """
    values = data.values.astype(np.float64)
    if valid is not None and valid.any():
        values = values[valid]
    scale = limits(values, GREYS, percent=0.2)
    pixels_text = f"{n_of(data)} pixels of {pixel_of(data['x'].values)}"
    name = "the image"
    caption = f"{title_of(data)} of {pixels_text}, no mask."
    if data.name != "image":
        name = f"the layer {layer}"
        caption = (
            f"In grey, {in_words(title_of(data))} of {layer}: {pixels_text}; mask: where it is"
            " known."
        )
    return Ground(data, scale, name, caption, edge, edge_of)


def blank_ground(points: Array, *, layer: str) -> Ground:
    """Return an empty ground around points (n, 2), (x, y) in um.

    For places in the coordinates of a layer of which no map is at hand.
    """
    points = points[np.isfinite(points).all(axis=1)]
    if not points.size:
        points = np.array([[0.0, 0.0], [1.0, 1.0]])
    # A fifth of the longer side around the points; one point has a side of 1 um.
    low = points.min(axis=0)
    high = points.max(axis=0)
    margin = 0.2 * max(float((high - low).max()), 1.0)
    x, y = np.linspace(low - margin, high + margin, _BLANK).T
    data = xr.DataArray(np.nan, [("y", y), ("x", x)])
    grid = f"the coordinates of {layer}, which is not resampled to this grid"
    caption = f"Places are in {grid}; no map is shown, no mask."
    return Ground(data, Scale(0.0, 1.0, GREYS), f"the layer {layer}", caption)


def _draw_arrows(
    canvas: Canvas,
    axes: Axes,
    starts: Array,
    vectors: Array,
    *,
    width_share: float,
    max_share: float,
    label: str,
    width: float,
) -> Magnified:
    """Draw vectors (n, 2) in um from their starts (n, 2), the longest over a share of the width.

    Beside the scale bar of the ground they have one of their own, over at most ``max_share`` of the
    width; ``label`` says of what, with braces for its length. Gives how they were magnified.
    """
    magnification = magnified(vectors, width_share * axes.shown.width)
    axes.arrows(starts, magnification.times * vectors, colour=ARROW, width=width)
    if magnification.longest > 1e-9:  # there is something to measure
        x = axes.x + 0.4 * axes.width
        y = axes.height + BELOW + 6
        um = axes.shown.width / magnification.times
        style: Entries = {"max_share": max_share, "colour": ARROW, "label": label}
        canvas.scale_bar(x, y, width=axes.width, um=um, **style)
    return magnification


def with_tiles_named(pairs: xr.Dataset, marks: xr.Dataset) -> xr.Dataset:
    """Return the pairs of a registration by all its marks.

    ``is_tile`` says which are tiles of texture, without a diameter.
    """
    is_moving_tile = marks["moving_source"].values == "tile"
    is_tile = is_moving_tile | (marks["fixed_source"].values == "tile")
    return pairs.assign_coords(is_tile=("mark", is_tile[paired(marks)]))


def judged(r: RegistrationFacts | None) -> RegistrationFacts | None:
    """Return the facts without the lag of the maps where the same texture gave the place.

    There the lag says nothing of the place.
    """
    if r is None or r.source != "texture":
        return r
    return r.model_copy(update={"lag": None})


def draw_registration(
    r: RegistrationFacts,
    ground: Ground,
    marks: xr.Dataset,
    *,
    hole_um: float,
    moving_layer: str,
    width: float,
) -> Picture:
    """Draw a ground with its numbered marks, and the residual of each as an arrow.

    The marks (``fixed_*``) are ``hole_um`` wide. ``moving_layer``: name of the layer that ``r``
    brings onto that of the ground; ``width``: of the figure in pixels.
    """
    canvas, axes = ground.draw(width)
    note_text = ""
    if ground.edge is not None:
        axes.outline(ground.edge, colour=EDGE, width=1.6)
        note_text = f"Blue: edge of {with_article(ground.edge_of)}. "
    fixed_xy = points_of(marks, "fixed")
    _draw_marks(canvas, axes, marks, hole_um=hole_um)
    # A residual is the mark in the image minus the mark that was carried over: the arrow shows
    # where that one falls.
    residuals = -points_of(marks, "residual")
    magnification = _draw_arrows(
        canvas,
        axes,
        fixed_xy,
        residuals,
        width_share=0.09,
        max_share=0.12,
        label="{} of residual",
        width=3.0 if width == FULL else 2.2,
    )
    direction = machine_direction(r, moving_layer)
    if direction is not None:
        _draw_direction(canvas, axes, direction[0], fixed_xy)
        note_text += (
            f"MD: machine direction, {direction[0] % 180:.0f}° from x clockwise ({direction[1]}). "
        )
    mark_table: Entries = {"mark": [*range(1, marks.sizes["mark"] + 1)]}
    if "label" in marks:
        mark_table["label"] = [*map(str, marks["label"].values)]
    for name, column in marks.data_vars.items():
        if column.dims == ("mark",) and name != "label":
            mark_table[f"{name} / µm"] = column.values.astype(np.float64).tolist()
    caption = (
        f"{capital(ground.name)} with n = {_marks_in_words(marks, hole_um)}. Red arrows point"
        f" from each mark to its transformed partner in {with_article(moving_layer)},"
        f" {magnification.words}. {note_text}{ground.caption}"
    )
    title = f"Marks in {with_article(r.to)} and their residuals"
    return canvas.picture(title, caption, {"marks": mark_table})


def _tiles_of(marks: xr.Dataset) -> Bools:
    """Which marks are tiles of texture; none where that is not said."""
    if "is_tile" in marks.coords:
        return marks["is_tile"].values
    return np.zeros(marks.sizes["mark"], dtype=np.bool_)


def _marks_in_words(marks: xr.Dataset, hole_um: float) -> str:
    is_tile = _tiles_of(marks)
    n = marks.sizes["mark"]
    if is_tile.all():
        return f"{n} tiles of texture (orange crosses at their middles)"
    tiles_text = ""
    if is_tile.any():
        tiles_text = ", crosses alone at the middles of tiles of texture"
    return f"{n} marks (orange circles of {plain(hole_um)}{tiles_text})"


def _draw_marks(canvas: Canvas, axes: Axes, marks: xr.Dataset, *, hole_um: float) -> None:
    """Draw holes as numbered circles, and tiles, which have no diameter, as numbered crosses.

    The middle of a hole has a small cross. ``marks`` are numbered in their order.
    """
    font_size = 11
    if canvas.width == FULL:
        font_size = 14
    angles = np.linspace(0, 2 * np.pi, 49)
    circle_x = hole_um / 2 * np.cos(angles)
    circle_y = hole_um / 2 * np.sin(angles)
    style: Entries = {"size": font_size, "colour": _MARK}
    cross_style: Entries = {"shift": (0, 0.32 * font_size), "anchor": "middle"}
    marked = zip(points_of(marks, "fixed"), _tiles_of(marks), strict=True)
    for k, ((x, y), is_tile) in enumerate(marked, 1):
        # The number stands above and to the left, at the circle or at the cross: moved by um on the
        # map, and by pixels from there.
        away_um = 0.0
        shift = (-5, -4)
        halo = INK
        if not is_tile:
            axes.line(x + circle_x, y + circle_y, colour=_MARK, width=1.9)
            away_um = 0.42 * hole_um
            shift = (-2, -2)
            halo = ""
        axes.text(x, y, "+", halo=halo, **cross_style, **style)
        label = (x - away_um, y - away_um, str(k))
        axes.text(*label, shift=shift, anchor="end", halo=INK, bold=True, **style)


def draw_expected_error(
    error: xr.DataArray,
    marks: xr.Dataset | None,
    *,
    hole_um: float,
    width: float,
    reference: str,
    layer: str,
) -> Picture | None:
    """Draw the expected error of ``layer`` on ``reference``, with contour lines and marks.

    None if unknown. ``error`` (y, x) is in um, NaN where ``layer`` is not shown; ``marks`` are None
    where they lie on another layer than ``reference``.
    """
    finite_errors = error.values[np.isfinite(error.values)].astype(np.float64)
    if finite_errors.size == 0:
        return None
    least = float(finite_errors.min())
    mean = float(finite_errors.mean())
    most = float(finite_errors.max())
    scale = limits(finite_errors, GEOMETRY, percent=0.1)
    levels, step = levels_between(least, most, steps=5)
    # Differences of 2 % of the mean are of no use: one colour for all of them.
    if not most - least > 0.02 * abs(mean):
        scale = Scale(0.0, 2 * mean or 1.0, GEOMETRY)
        levels = np.empty(0)
    canvas, axes = draw_map(error, scale=scale, label="expected error / µm", width=width)
    shared_text = "an error that all marks share is not included"
    marks_text = ""
    if marks is None:
        axes.contours(levels, labels=True)
    else:
        axes.contours(levels, labels=True, avoided=points_of(marks, "fixed"))
        marks_text = "Orange: the marks, numbered as in the figure of their residuals. "
        _draw_marks(canvas, axes, marks, hole_um=hole_um)
        if _tiles_of(marks).all():
            shared_text = (
                "of an error that all tiles share, only what light from one side explains is"
                " included"
            )
    contour_text = ""
    if levels.size:
        contour_text = f"Contour lines every {length(step, 1)}. "
    caption = (
        f"Expected error of the position in {with_article(reference)} (rms, from the scatter of"
        f" the marks): {length(least, 2)} to {length(most, 2)}, median"
        f" {length(float(np.median(finite_errors)), 2)}. {contour_text}{marks_text}It grows"
        f" away from the marks; {shared_text}. n = {n_of(finite_errors)} pixels of"
        f" {pixel_of(error['x'].values)}; unit µm; mask: where {with_article(layer)} is shown."
    )
    return canvas.picture("Expected error", caption)


def draw_lags(lag: LagNumbers | None, ground: Ground, *, map_texts: TwoTexts) -> Picture | None:
    """Draw the lags of the tiles of two maps, named in words, that have a distinct one.

    A lag leads from where the registration puts a tile to where the reference shows it. None where
    there are none.
    """
    if lag is None:
        return None
    distinct_xy, lags, silent_xy = lag_places(lag, ground)
    if not len(distinct_xy):
        return None
    canvas, axes = ground.draw(HALF)
    axes.dots(*silent_xy.T, size=4, colour=_SILENT, halo="white")
    axes.dots(*distinct_xy.T, size=4, colour=ARROW, halo="white")
    magnification = _draw_arrows(
        canvas,
        axes,
        distinct_xy,
        lags,
        width_share=0.11,
        max_share=0.16,
        label="{} of lag",
        width=2.2,
    )
    doubt_text = ""
    if lag.reason:
        doubt_text = " The check as a whole is inconclusive: read the arrows with caution."
    size_text = ""
    if is_known(lag.tile_um):
        size_text = f" of {plain(lag.tile_um)}"
    moving_text, reference_text = map_texts
    caption = (
        f"Arrows point from where the registration puts a piece of {moving_text} to where"
        f" {reference_text} shows it, {magnification.words}. Parallel arrows are a shift;"
        " arrows that turn or diverge are a rotation or a stretch; disordered arrows are"
        f" chance. n = {count(len(distinct_xy))} of {count(len(distinct_xy) + len(silent_xy))}"
        f" overlapping tiles{size_text} with a distinct lag, grey dots the others.{doubt_text}"
        f" {ground.caption}"
    )
    return canvas.picture("Image-based check, tile by tile", caption)


def machine_direction(r: RegistrationFacts, moving_layer: str) -> tuple[float, str] | None:
    """Return the machine direction in degrees from x, clockwise on screen, and its source.

    None where it is unknown.
    """
    o = r.orientation
    if o.md_deg_fixed is not None:
        return o.md_deg_fixed, f"given for {with_article(r.to)}"
    if o.md_deg_fixed_from_moving is None:
        return None
    return o.md_deg_fixed_from_moving, f"carried over from {with_article(moving_layer)}"


def lag_places(lag: LagNumbers, ground: Ground) -> tuple[Array, Array, Array]:
    """Return where tiles with a distinct lag lie on a ground, their lags, and where the others lie.

    All are (n, 2) in um.

    Tiles count from the middle of the first pixel that was compared, which may be the mean of
    several.
    """
    edges_um = [values[0] - pitch(values) / 2 for values in axes_of(ground.data)]
    y0, x0 = edges_um + np.divide(lag.pixel_um, 2)  # middle of that first pixel
    places = [(tile.x + x0, tile.y + y0) for tile in lag.tiles]
    xy = np.reshape(places, (-1, 2))  # also of no tile
    lags = np.reshape([tile.lag_um for tile in lag.tiles], (-1, 2))
    is_distinct = np.array([tile.distinct for tile in lag.tiles], dtype=bool)
    is_distinct &= np.isfinite(lags).all(axis=1)
    return xy[is_distinct], lags[is_distinct], xy[~is_distinct]


def _draw_direction(canvas: Canvas, axes: Axes, angle_deg: float, marks_xy: Array) -> None:
    """Draw the machine direction in the corner that is farthest from marks (n, 2), (x, y) in um.

    The angle runs from x clockwise.
    """
    # Upper left, upper right, lower left and lower right, in sizes of the axes.
    corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
    is_placed = np.isfinite(marks_xy).all(axis=1)
    mark_pixels = axes.place(marks_xy[is_placed])
    offsets = corners[:, None] * (axes.width, axes.height) - mark_pixels
    distances = np.hypot(offsets[..., 0], offsets[..., 1])
    nearest_px = distances.min(axis=1, initial=np.inf)  # of each corner, to the next mark
    is_right, is_low = corners[np.argmax(nearest_px)]
    left_px = axes.x + 8 + is_right * (axes.width - _AXIS - 16)
    top_px = axes.y + 8 + is_low * (axes.height - _AXIS - 16)
    canvas.box(left_px, top_px, _AXIS, _AXIS, fill="rgba(255,255,255,0.86)")
    corner_axes = canvas.axes(left_px, top_px, _AXIS, _AXIS, (-1, 1, 1, -1))
    angle = np.radians(angle_deg)
    direction = np.array([np.cos(angle), np.sin(angle)])
    normal = np.array([-direction[1], direction[0]])
    ends = 0.92 * np.array([direction, -direction])
    middle = -0.22 * normal
    corner_axes.arrows([middle, middle], ends, colour=INK, width=2.0, halo="")
    x, y = 0.36 * normal
    corner_axes.text(x, y, "MD", shift=(0, 4), anchor="middle", bold=True)
