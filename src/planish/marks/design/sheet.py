"""What every drawing is made of: a page in millimetres, dimension lines, and files that are the same each time."""

from __future__ import annotations

import io
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf, PdfPages
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

INK, SOFT, FAINT, ACCENT, GROUND = "#22292f", "#66707a", "#c9ced3", "#b3402a", "#eef4f8"
BURNT = "#e8c9b8"
DPI = 150
_SCALES = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.75, 1, 1.5, 2, 2.5, 3, 4, 5, 6, 7, 8, 10, 12, 15, 20, 25, 30, 40, 50)

_STYLE: dict[str, Any] = {
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


class Page:
    """A landscape A4 page whose parts are placed in millimetres from its upper left corner."""

    width, height = 297.0, 210.0

    def __init__(self, title: str, subtitle: str) -> None:
        self.figure = Figure(figsize=(self.width / 25.4, self.height / 25.4), dpi=DPI, facecolor="white")
        self.text(12, 13, title, fontsize=14, fontweight="bold")
        self.text(12, 19.5, subtitle, color=SOFT, fontsize=9)

    def axes(self, left: float, top: float, width: float, height: float) -> Axes:
        """Add axes."""
        box = (left / self.width, 1 - (top + height) / self.height, width / self.width, height / self.height)
        return self.figure.add_axes(box)

    def plan(self, left: float, top: float, *, low: Sequence[float], size: Sequence[float], scale: float) -> Axes:
        """Add bare axes in mm that show ``size`` from ``low`` on, magnified ``scale`` times."""
        axes = self.axes(left, top, size[0] * scale, size[1] * scale)
        axes.set_xlim(low[0], low[0] + size[0])
        axes.set_ylim(low[1], low[1] + size[1])
        axes.set_axis_off()
        return axes

    def text(self, left: float, top: float, text: str, **options: Any) -> None:
        """Write, from the base line on."""
        self.figure.text(left / self.width, 1 - top / self.height, text, va="baseline", **options)

    def divide(self, left: float) -> None:
        """Draw a line down the page."""
        x = left / self.width
        self.figure.add_artist(Line2D([x, x], [0.05, 0.85], color=FAINT, lw=0.6))

    def rows(self, left: float, top: float, rows: Sequence[tuple[str, str]], *, across: float, step: float) -> float:
        """Write names and values in two columns; where the next line would stand comes back."""
        for k, (name, value) in enumerate(rows):
            self.text(left, top + k * step, name, color=SOFT, fontsize=7.5)
            self.text(left + across, top + k * step, value, fontsize=7.5)
        return top + len(rows) * step


@contextmanager
def house_style() -> Generator[None]:
    """Draw in one style, whatever the user's settings; they are restored afterwards."""
    with style.context(["default", _STYLE]):
        yield


def encode(page: Page, kind: Literal["svg", "png"]) -> bytes:
    """Render a page."""
    data = io.BytesIO()
    if kind == "svg":
        FigureCanvasSVG(page.figure).print_svg(data, metadata={"Date": None, "Creator": "planish"})
    else:
        FigureCanvasAgg(page.figure).print_png(data, metadata={"Software": "planish"})
    return data.getvalue()


def encode_pdf(pages: Sequence[Page], title: str) -> bytes:
    """Render pages into one PDF."""
    data = io.BytesIO()
    facts = {"Title": title, "Creator": "planish", "Producer": "planish", "CreationDate": None}
    with PdfPages(data, metadata=facts) as pdf:
        for page in pages:
            FigureCanvasPdf(page.figure)
            pdf.savefig(page.figure)
    return data.getvalue()


def fitting_scale(size_mm: Sequence[float], room_mm: tuple[float, float]) -> float:
    """Return the largest round magnification at which something fits."""
    most = min(room / side for room, side in zip(room_mm, size_mm, strict=True))
    return max((scale for scale in _SCALES if scale <= most), default=most)


def as_ratio(scale: float) -> str:
    """Write a magnification as on a drawing: 8:1, 1:2."""
    return f"{scale:g}:1" if scale >= 1 else f"1:{1 / scale:.3g}"


def box(axes: Axes, low: Sequence[float], size: Sequence[float], **options: Any) -> None:
    """Draw a rectangle."""
    options_drawn: dict[str, Any] = {"fill": False, "clip_on": False, **options}
    axes.add_patch(Rectangle((low[0], low[1]), size[0], size[1], **options_drawn))


def dimension(axes: Axes, start: Sequence[float], end: Sequence[float], text: str) -> None:
    """Draw a dimension line along x or y with its length."""
    upright = start[0] == end[0]
    axes.annotate(
        "", (end[0], end[1]), (start[0], start[1]), annotation_clip=False,
        arrowprops={"arrowstyle": "<->", "color": SOFT, "lw": 0.6, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7},
    )  # fmt: skip
    middle = [(a + b) / 2 for a, b in zip(start, end, strict=True)]
    axes.annotate(
        text, (middle[0], middle[1]), (-3, 0) if upright else (0, 3), textcoords="offset points", color=INK,
        ha="right" if upright else "center", va="center" if upright else "bottom", rotation=90 if upright else 0,
        fontsize=7.5, annotation_clip=False,
    )  # fmt: skip


def scale_bar(page: Page, left: float, top: float, *, scale: float, most: float) -> None:
    """Draw a round length of at most ``most`` millimetres of paper."""
    power = 10.0 ** np.floor(np.log10(most / scale))
    length = float(power * max(k for k in (1, 2, 5) if k * power <= most / scale * (1 + 1e-9)))
    axes = page.plan(left, top, low=(0, 0), size=(length, 1 / scale), scale=scale)
    axes.plot([0, length], [0.5 / scale] * 2, color=INK, lw=2, solid_capstyle="butt", clip_on=False)
    page.text(left + length * scale + 2, top + 1.4, f"{length:g} mm", fontsize=8)
