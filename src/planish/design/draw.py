"""Files of a design, among them its pages: pattern, predicted error and path of the stage.

All repeat to the byte.
"""

import io
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle

from planish.core.numbers import round_step
from planish.core.transform import grid_points
from planish.core.typing import Entries, Floats, Texts, pair_of
from planish.design.gcode import DryRun, dry_run, pattern_dxf, stage_program
from planish.design.params import ImagingParams, StageParams
from planish.design.pattern import P95, Pattern, Predicted, holes_csv, predict, size_text
from planish.design.rules import Rules

INK, SOFT, FAINT, ACCENT, GROUND = "#22292f", "#66707a", "#c9ced3", "#b3402a", "#eef4f8"
BURNT = "#e8c9b8"
ASIDE = 226.0  # where the right column begins
_DASHED = (0, (5, 3))
_SCALES = (
    0.1,
    0.15,
    0.2,
    0.25,
    0.3,
    0.4,
    0.5,
    0.75,
    1,
    1.5,
    2,
    2.5,
    3,
    4,
    5,
    6,
    7,
    8,
    10,
    12,
    15,
    20,
    25,
    30,
    40,
    50,
)
_STYLE: Entries = {
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "text.color": INK,
    "text.parse_math": False,  # a dollar sign in a name is a dollar sign
    "axes.edgecolor": SOFT,
    "axes.linewidth": 0.5,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "svg.hashsalt": "planish",  # ids that are the same each time
    "svg.fonttype": "path",  # readable where the typeface is not installed
    "pdf.fonttype": 3,
}
# Draw in one style, whatever the user's settings; they are restored afterwards.
house_style = partial(style.context, ["default", _STYLE])
Point = Sequence[float] | Floats


class Page:
    """A landscape A4 page with a magnified plan and a column beside it.

    In mm from its upper left corner.

    The plan shows ``size_um`` (x, y) from its lower left corner ``low_um`` on; ``note`` stands
    behind the scale.
    """

    width, height = 297.0, 210.0

    def __init__(
        self, title: str, subtitle: str, low_um: Point, size_um: Point, *, note: str = ""
    ) -> None:
        """Begin a page with its headings, the plan and a bar of its scale."""
        size_inches = (self.width / 25.4, self.height / 25.4)
        self.figure = Figure(figsize=size_inches, dpi=150, facecolor="white")
        self.text(12, 13, title, fontsize=14, fontweight="bold")
        self.text(12, 19.5, subtitle, color=SOFT, fontsize=9)
        room_mm = np.array([180.0, 148.0])
        plan_size = np.asarray(size_um)
        max_scale = float(min(1000 * room_mm / plan_size))
        self.scale = max((scale for scale in _SCALES if scale <= max_scale), default=max_scale)
        plan_mm = plan_size * self.scale / 1000
        x_mm, y_mm = np.array([24.0, 36.0]) + (room_mm - plan_mm) / 2
        self.plan = self.add_plan(x_mm, y_mm, low_um, size_um, self.scale)
        self.scale_bar(24, 199, self.scale, max_mm=40)
        ratio = f"{self.scale:g}:1" if self.scale >= 1 else f"1:{1 / self.scale:.3g}"
        self.text(90, 200.4, f"drawn {ratio} on A4{note}", color=SOFT)
        line_x = (ASIDE - 6) / self.width
        line = Line2D([line_x, line_x], [0.05, 0.85], color=FAINT, lw=0.6)
        self.figure.add_artist(line)
        # Where the next part of the column begins, in mm from the top.
        self.bottom = 38.0

    def add_plan(
        self, x_mm: float, y_mm: float, low_um: Point, size_um: Point, scale: float
    ) -> Axes:
        """Add bare axes in um showing ``size_um`` from ``low_um`` on, magnified ``scale`` times."""
        x_um, y_um = low_um
        width_um, height_um = size_um
        width_mm = scale * width_um / 1000
        height_mm = scale * height_um / 1000
        from_left = x_mm / self.width
        from_bottom = 1 - (y_mm + height_mm) / self.height
        box = (from_left, from_bottom, width_mm / self.width, height_mm / self.height)
        axes = self.figure.add_axes(box)
        axes.set(xlim=(x_um, x_um + width_um), ylim=(y_um, y_um + height_um))
        axes.set_axis_off()
        return axes

    def text(self, x_mm: float, y_mm: float, text: str, **options: Any) -> None:
        """Write, from the base line on."""
        x = x_mm / self.width
        y = 1 - y_mm / self.height
        self.figure.text(x, y, text, va="baseline", **options)

    def aside(
        self, title: str, rows: Sequence[tuple[str, str]] = (), notes: Sequence[str] = ()
    ) -> None:
        """Write names with their values, and notes, under a title.

        The next part of the column stands below: ``bottom`` moves down, in mm.
        """
        self.text(ASIDE, self.bottom, title, fontweight="bold", fontsize=9)
        self.bottom += 6
        for name, value in rows:
            self.text(ASIDE, self.bottom, name, color=SOFT, fontsize=7.5)
            self.text(ASIDE + 27, self.bottom, value, fontsize=7.5)
            self.bottom += 4.9
        for note in notes:
            self.text(ASIDE, self.bottom + 3, note, color=SOFT, fontsize=7)
            self.bottom += 3.6
        self.bottom += 10

    def scale_bar(self, x_mm: float, y_mm: float, scale: float, *, max_mm: float) -> None:
        """Draw a round length of at most ``max_mm`` millimetres of paper."""
        length_mm = round_step(max_mm / scale)
        axes = self.add_plan(x_mm, y_mm, (0, 0), (1000 * length_mm, 1000 / scale), scale)
        look: Entries = {"color": INK, "lw": 2, "solid_capstyle": "butt", "clip_on": False}
        axes.plot([0, 1000 * length_mm], [500 / scale] * 2, **look)
        self.text(x_mm + length_mm * scale + 2, y_mm + 1.4, f"{length_mm:g} mm", fontsize=8)


_METADATA: dict[str, Entries] = {  # without a time
    "svg": {"Date": None, "Creator": "planish"},
    "png": {"Software": "planish"},
    "pdf": {"Title": "", "Creator": "planish", "Producer": "planish", "CreationDate": None},
}


def encode(pages: Sequence[Page], kind: str, title: str = "", *, dpi: float = 150) -> bytes:
    """Render a page as ``svg`` or ``png``, or pages as one ``pdf``."""
    buffer = io.BytesIO()
    if kind == "pdf":
        metadata = _METADATA["pdf"] | {"Title": title}
        with PdfPages(buffer, metadata=metadata) as pdf:
            for page in pages:
                pdf.savefig(page.figure)
    else:
        pages[0].figure.savefig(buffer, format=kind, dpi=dpi, metadata=_METADATA[kind])
    return buffer.getvalue()


def drawing_page(pattern: Pattern) -> Page:
    """Draw a pattern as the laser sees it, y up.

    Magnified with its pitches and numbers, and in its true size where that fits beside it.
    """
    subtitle = (
        f"{len(pattern.holes)} holes around a field of {_size(pattern.field_um)} mm; as the laser"
        " sees it"
    )
    view = pattern.view_um
    x, y = pattern.origin_um
    page = Page(f"Laser holes: {pattern.name}", subtitle, (x, y), view, note="; pitches in mm")
    axes = page.plan
    mm = 1000 / page.scale  # um of the sheet for one mm of paper
    _holes(axes, pattern, SOFT)
    _box(axes, (x, y), view, edgecolor=SOFT, ls=_DASHED)
    field_low = pattern.field_low_um
    corner = pattern.frame_low_um
    field_middle = field_low + np.array(pattern.field_um) / 2
    field_text = f"field {_size(pattern.field_um)} mm\nno hole reaches into it"
    _write(axes, field_middle, field_text, color=SOFT, fontsize=9, linespacing=1.6)
    _numbers(axes, pattern.points_um, pattern.labels, corner, pattern.frame_um)
    for dx, dy, name in ((1, 0, "x"), (0, 1, "y")):
        arrow_end = (x + 11 * mm * dx, y + 11 * mm * dy)
        _arrow(axes, (x, y), arrow_end, color=ACCENT, lw=1.1)
        _write(axes, arrow_end, name, (6 * dx, 6 * dy), color=ACCENT, fontsize=8)
    if pattern.layout != "own":
        _pitches(axes, pattern, 4.2 * mm + pattern.border_um)
        _mark(axes, corner, "o", ms=7, mfc="none", mec=ACCENT, mew=0.9)
        corner_text = "no hole in this corner:\nit shows the orientation"
        text_place = pair_of(field_low + 13 * mm)
        look: Entries = {"color": ACCENT, "fontsize": 7.5, "ha": "left", "va": "bottom"}
        line = {"arrowstyle": "-", "color": ACCENT, "lw": 0.6, "shrinkB": 5}
        axes.annotate(corner_text, pair_of(corner), text_place, arrowprops=line, **look)
    rows = [
        ("layout", f"{pattern.layout}, seed {pattern.seed}"),
        ("hole", f"{pattern.diameter_um:g} µm"),
        ("burnt rim", f"{pattern.rim_um:g} µm"),
        ("pulse, pause", f"{1000 * pattern.pulse_s:g} ms, {1000 * pattern.pause_s:g} ms"),
        ("frame", f"{_size(pattern.frame_um)} mm"),
        ("margin to field", f"{pattern.margin_um[0]:g}, {pattern.margin_um[1]:g} µm"),
        ("least spacing", f"{pattern.spacing_um:g} µm"),
        ("to be imaged", f"{_size(view)} mm"),
    ]
    page.aside(
        "To burn",
        rows,
        ("dashed: what both instruments", "have to image; dark: the hole;", "brown: its rim"),
    )
    if view[0] <= 62_000 and view[1] <= 95_000:
        page.aside("True size (print without fitting)")
        plan = page.add_plan(ASIDE, page.bottom - 12, (x, y), view, 1.0)
        _holes(plan, pattern, FAINT)
        page.scale_bar(ASIDE, page.bottom - 9 + view[1] / 1000, 1.0, max_mm=10)
    return page


def error_page(
    pattern: Pattern, predicted: Predicted, imaging: ImagingParams, rules: Rules
) -> Page:
    """Draw the predicted error over the field, with its numbers and the rules.

    Marked are the middle of the field and its worst corner.
    """
    subtitle = (
        "rms distance between a point of one map and the same point of the other, by the marks"
        " alone; similarity"
    )
    page = Page("Predicted error of the registration", subtitle, pattern.origin_um, pattern.view_um)
    _error_map(page, pattern, predicted)
    _box(page.plan, pattern.field_low_um, pattern.field_um, edgecolor=SOFT)
    _box(page.plan, pattern.origin_um, pattern.view_um, edgecolor=SOFT, ls=_DASHED)
    _mark(page.plan, pattern.points_um, "o", ms=3.5, mfc="white", mec=INK, mew=0.8)
    field_points = predicted.field_um
    middle, *corners = field_points
    worst = corners[np.argmax(predicted.at(corners))]
    text_box = {
        "boxstyle": "round,pad=0.3",
        "facecolor": "white",
        "edgecolor": "none",
        "alpha": 0.9,
    }
    marked_points = (
        (middle, predicted.centre_um, "middle"),
        (worst, predicted.corner_um, "worst corner"),
    )
    for point, error_um, name in marked_points:
        _mark(page.plan, point, "+", ms=9, mew=1.4, color=ACCENT)
        # Towards the middle, so that the text stays inside the field.
        x, y = np.sign(middle - point)
        look: Entries = {"ha": ("center", "left", "right")[int(x)], "fontsize": 8.5}
        offset_pt = (10 * x, 12 * (y or -1))
        _write(page.plan, point, f"{name}: {error_um:.2f} µm", offset_pt, bbox=text_box, **look)
    rows = [
        ("one hole", f"{predicted.fle_um:.2f} µm rms"),
        ("holes N", f"{len(predicted.holes_um)}"),
        ("rms radius f", f"{predicted.radius_um / 1000:.2f} mm"),
        ("middle", f"{predicted.centre_um:.2f} µm rms"),
        ("worst corner", f"{predicted.corner_um:.2f} µm rms"),
        ("95 % there", f"< {P95 * predicted.corner_um:.2f} µm"),
        ("pixels", f"{imaging.pixel_um[0]:g} and {imaging.pixel_um[1]:g} µm"),
        ("rim roughness", f"{imaging.roughness_um:g} µm"),
        ("varies over", f"{imaging.rim_length_um:g} µm"),
    ]
    page.aside("Error", rows, ("error² = hole² / N · (1 + r² / f²),", "r from the holes' centroid"))
    rows.clear()
    for rule in rules:
        sign_text = "≥" if rule.sense == "at least" else "≤"
        decimals = 0 if rule.unit in ("um", "holes") else 2
        value_text = f"{rule.value:.{decimals}f} {rule.unit.replace('um', 'µm')}".strip()
        rows.append((rule.name, f"{value_text}  {sign_text} {rule.limit:.4g}"))
    page.aside("Rules", rows)
    return page


def _error_map(page: Page, pattern: Pattern, predicted: Predicted) -> None:
    """Draw the predicted error over the field, with contours and a colour bar.

    The error is computed at some 200 places along the longer side.
    """
    axes = page.plan
    field_low = pattern.field_low_um
    width_um, height_um = pattern.field_um
    longest_um = max(width_um, height_um)
    cols, rows = (max(20, round(200 * side / longest_um)) for side in pattern.field_um)
    left, low = field_low
    right, high = field_low + pattern.field_um
    x_um = left + np.linspace(0, width_um, cols)
    y_um = low + np.linspace(0, height_um, rows)
    error_um = predicted.at(grid_points(x_um, y_um))
    plot_limits = axes.axis()
    look: Entries = {"cmap": "cividis", "aspect": "auto", "interpolation": "bilinear"}
    image = axes.imshow(error_um, extent=(left, right, low, high), origin="lower", **look)
    axes.axis(plot_limits)
    levels = np.linspace(error_um.min(), error_um.max(), 7)[1:-1]
    contours = axes.contour(x_um, y_um, error_um, levels=levels, colors="white", linewidths=0.6)
    axes.clabel(contours, fmt="%.2f", fontsize=7)
    plan_box = axes.get_position()
    bar_left = plan_box.x1 + 4 / page.width
    bar_box = (bar_left, plan_box.y0, 3.5 / page.width, plan_box.height)
    bar_axes = page.figure.add_axes(bar_box)
    colour_bar = page.figure.colorbar(image, cax=bar_axes)
    colour_bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    colour_bar.ax.set_title("µm", fontsize=8)


def path_page(run: DryRun, *, title: str = "Path of the stage") -> Page:
    """Draw the path of a stage program, from its dry run.

    Arrows stand on the longer stretches, numbers beside the shots in their order.
    """
    shots_um, path_um = run.fired_um, run.path_um
    size = np.maximum(np.ptp(path_um, axis=0), 1000.0)
    border = 0.03 * float(size.max())
    low = path_um.min(axis=0) - border
    size = size + 2 * border
    page = Page(title, run.sentence(), low, size, note="; numbers: order of the shots")
    axes = page.plan
    axes.plot(*path_um.T, "-", color=SOFT, lw=0.8, clip_on=False)
    for a, b in pairwise(path_um):
        if np.hypot(*(b - a)) * page.scale > 8000:
            middle = (a + b) / 2
            _arrow(axes, middle, middle + 0.01 * (b - a), color=SOFT, lw=0.8)
    _mark(axes, shots_um, "o", ms=4.5, color=ACCENT)
    shot_numbers = [str(k + 1) for k in range(len(shots_um))]
    _numbers(axes, shots_um, shot_numbers, low, size)
    for place, name, dy in ((path_um[0], "begins", 7), (path_um[-1], "ends", -7)):
        _mark(axes, place, "s", ms=5, mfc="white", mec=INK)
        _write(axes, place, name, (-7, dy), fontsize=7.5, ha="right")
    pause_text = f"{1000 * run.least_pause_s:.0f} ms" if np.isfinite(run.least_pause_s) else "-"
    pulse_texts = sorted({f"{1000 * pulse_s:g}" for pulse_s in run.pulse_s})
    x_range, y_range = (f"{um.min() / 1000:g} to {um.max() / 1000:g} mm" for um in path_um.T)
    rows = [
        ("shots", str(len(shots_um))),
        ("pulse", f"{', '.join(pulse_texts[:3])} ms"),
        ("laser off", f"≥ {pause_text}"),
        ("path", f"{run.length_um / 1000:.1f} mm"),
        ("time", f"{run.time_s:.1f} s"),
        ("x", x_range),
        ("y", y_range),
    ]
    page.aside("Dry run", rows, ("time without acceleration",))
    return page


def _holes(axes: Axes, pattern: Pattern, edge: str) -> None:
    _box(axes, pattern.field_low_um, pattern.field_um, fill=True, facecolor=GROUND, edgecolor=edge)
    for place in pattern.points_um:
        for radius, colour in ((pattern.burnt_um, BURNT), (0.5 * pattern.diameter_um, INK)):
            look: Entries = {"facecolor": colour, "edgecolor": "none", "clip_on": False}
            axes.add_patch(Circle(pair_of(place), radius, **look))


def _mark(axes: Axes, places: Floats, marker: str, **options: Any) -> None:
    """Draw a marker at one place (2,) or at each of many (n, 2), on the plan's border as well."""
    x, y = np.atleast_2d(places).T
    axes.plot(x, y, marker, clip_on=False, **options)


def _numbers(axes: Axes, points: Floats, labels: Sequence[str], low: Floats, size: Floats) -> None:
    """Write the labels of points beside them, inwards of the rectangle from ``low`` on."""
    towards_middle = low + size / 2 - points
    inwards = np.sign(towards_middle) * (np.abs(towards_middle) > 0.4 * size)
    inwards[~inwards.any(axis=1)] = [0.7, 0.7]
    for label, point, offset_pt in zip(labels, points, 9 * inwards, strict=True):
        _write(axes, point, label, offset_pt, fontsize=6.5)


def _pitches(axes: Axes, pattern: Pattern, distance: float) -> None:
    """Write the distance between neighbours on a line ``distance`` outside the frame."""
    points, low, size = pattern.points_um, pattern.frame_low_um, pattern.frame_um
    for axis, is_far in ((0, 0), (1, 1), (0, 1), (1, 0)):
        side_level = low[1 - axis] + is_far * size[1 - axis]
        is_on_side = np.abs(points[:, 1 - axis] - side_level) < 1e-3
        text_level = side_level + (distance if is_far else -distance)
        look: Entries = {"fontsize": 6, "color": SOFT, "rotation": 90 * axis}
        for a, b in pairwise(np.sort(points[is_on_side, axis])):
            middle = ((a + b) / 2, text_level) if axis == 0 else (text_level, (a + b) / 2)
            _write(axes, middle, f"{(b - a) / 1000:.2f}", **look)


def _write(axes: Axes, place: Point, text: str, offset_pt: Point = (0, 0), **options: Any) -> None:
    look: Entries = {"ha": "center", "va": "center", "annotation_clip": False} | options
    x, y = place
    dx, dy = offset_pt
    axes.annotate(text, (x, y), (dx, dy), textcoords="offset points", **look)


def _arrow(axes: Axes, start: Point, end: Point, **options: Any) -> None:
    look = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8} | options
    x, y = start
    x_end, y_end = end
    axes.annotate("", (x_end, y_end), (x, y), annotation_clip=False, arrowprops=look)


def _box(axes: Axes, low: Point, size: Point, **options: Any) -> None:
    look: Entries = {"fill": False, "clip_on": False, "lw": 0.5} | options
    x, y = low
    axes.add_patch(Rectangle((x, y), *size, **look))


def _size(size_um: Point) -> str:
    return size_text(size_um).replace("x", "×")


def write_design(
    pattern: Pattern,
    rules: Rules,
    folder: str | Path,
    *,
    stage: StageParams,
    imaging: ImagingParams,
) -> tuple[Texts, DryRun, Predicted]:
    """Write a pattern into a folder that exists: JSON, two tables, DXF, stage program, drawings.

    Parameters
    ----------
    pattern : Pattern
    rules : tuple of Rule, as checked, for the drawing
    folder : str or Path
    stage, imaging : StageParams, ImagingParams
        What the program asks of the stage and its range, and where the predicted error comes from.

    Returns
    -------
    files : tuple of str; names in the folder
    run : DryRun, of the stage program, read back from its text
    predicted : Predicted

    Raises
    ------
    MarkError
        If the dry run refuses the program, such as one that leaves the stage's range.
    OSError
        If a file cannot be written.
    """
    program = stage_program(pattern, stage)
    # The pulse that is asked for here is meant; a program from elsewhere is held to the usual
    # length.
    run = dry_run(program, stage, pulse_s=max(0.05, pattern.pulse_s))
    predicted = predict(pattern, imaging)
    files: dict[str, bytes] = {
        "pattern.json": pattern.to_json().encode(),
        "holes.csv": holes_csv(pattern).encode(),
        "holes_as_imaged.csv": holes_csv(pattern, imaged=True).encode(),
        "pattern.dxf": pattern_dxf(pattern).encode("ascii"),
        "program.gcode": program.encode("ascii"),
    }
    with house_style():
        drawing = drawing_page(pattern)
        errors = error_page(pattern, predicted, imaging, rules)
        path = path_page(run)
        files["drawing.svg"] = encode([drawing], "svg")
        files["drawing.png"] = encode([drawing], "png", dpi=72)
        files["predicted_error.png"] = encode([errors], "png")
        files["path.png"] = encode([path], "png")
        title = f"Laser holes: {pattern.name}"
        files["drawing.pdf"] = encode([drawing, errors, path], "pdf", title)
    for name, content in files.items():
        (Path(folder) / name).write_bytes(content)
    return tuple(files), run, predicted
