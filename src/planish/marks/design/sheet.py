"""Parts of every drawing: a page in millimetres with a plan and a column, and files that repeat to the byte."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf, PdfPages
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

INK, SOFT, FAINT, ACCENT, GROUND = "#22292f", "#66707a", "#c9ced3", "#b3402a", "#eef4f8"
BURNT = "#e8c9b8"
ASIDE = 226.0  # where the right column begins
_ROOM = (180.0, 148.0)  # of the plan
_LEFT, _TOP = 24.0, 36.0
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
house_style = partial(style.context, ["default", _STYLE])
"""Draw in one style, whatever the user's settings; they are restored afterwards."""


class Page:
    """A landscape A4 page with a magnified plan and a column beside it, in mm from its upper left corner.

    The plan shows ``size_um`` (x, y) from its lower left corner ``low_um`` on; ``note`` stands behind the scale.
    """

    width, height = 297.0, 210.0

    def __init__(
        self, title: str, subtitle: str, low_um: Sequence[float], size_um: Sequence[float], *, note: str = ""
    ) -> None:  # fmt: skip
        self.figure = Figure(figsize=(self.width / 25.4, self.height / 25.4), dpi=150, facecolor="white")
        self.text(12, 13, title, fontsize=14, fontweight="bold")
        self.text(12, 19.5, subtitle, color=SOFT, fontsize=9)
        most = min(1000 * room / side for room, side in zip(_ROOM, size_um, strict=True))
        self.scale = max((scale for scale in _SCALES if scale <= most), default=most)
        x_mm, y_mm = (
            edge + (room - side * self.scale / 1000) / 2
            for edge, room, side in zip((_LEFT, _TOP), _ROOM, size_um, strict=True)
        )
        self.plan = self.add_plan(x_mm, y_mm, low_um, size_um, self.scale)
        self.scale_bar(_LEFT, 199, self.scale, most=40)
        ratio = f"{self.scale:g}:1" if self.scale >= 1 else f"1:{1 / self.scale:.3g}"
        self.text(_LEFT + 66, 200.4, f"drawn {ratio} on A4{note}", color=SOFT)
        x = (ASIDE - 6) / self.width
        self.figure.add_artist(Line2D([x, x], [0.05, 0.85], color=FAINT, lw=0.6))
        self.bottom = 38.0

    def add_plan(
        self, x_mm: float, y_mm: float, low_um: Sequence[float], size_um: Sequence[float], scale: float
    ) -> Axes:
        """Add bare axes in um that show ``size_um`` from ``low_um`` on, magnified ``scale`` times."""
        across, down = (scale * side / 1000 for side in size_um)
        box = (x_mm / self.width, 1 - (y_mm + down) / self.height, across / self.width, down / self.height)
        axes = self.figure.add_axes(box)
        axes.set_xlim(low_um[0], low_um[0] + size_um[0])
        axes.set_ylim(low_um[1], low_um[1] + size_um[1])
        axes.set_axis_off()
        return axes

    def text(self, x_mm: float, y_mm: float, text: str, **options: Any) -> None:
        """Write, from the base line on."""
        self.figure.text(x_mm / self.width, 1 - y_mm / self.height, text, va="baseline", **options)

    def aside(self, title: str, rows: Sequence[tuple[str, str]] = (), notes: Sequence[str] = ()) -> None:
        """Write names with their values, and notes, under a title; the next part of the column stands below."""
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

    def scale_bar(self, x_mm: float, y_mm: float, scale: float, *, most: float) -> None:
        """Draw a round length of at most ``most`` millimetres of paper."""
        power = 10.0 ** np.floor(np.log10(most / scale))
        length = float(power * max(k for k in (1, 2, 5) if k * power <= most / scale * (1 + 1e-9)))
        axes = self.add_plan(x_mm, y_mm, (0, 0), (1000 * length, 1000 / scale), scale)
        axes.plot([0, 1000 * length], [500 / scale] * 2, color=INK, lw=2, solid_capstyle="butt", clip_on=False)
        self.text(x_mm + length * scale + 2, y_mm + 1.4, f"{length:g} mm", fontsize=8)


def encode(pages: Sequence[Page], kind: str, title: str = "") -> bytes:
    """Render a page as ``svg`` or ``png``, or pages as one ``pdf``."""
    file = io.BytesIO()
    if kind == "svg":
        FigureCanvasSVG(pages[0].figure).print_svg(file, metadata={"Date": None, "Creator": "planish"})
    elif kind == "png":
        FigureCanvasAgg(pages[0].figure).print_png(file, metadata={"Software": "planish"})
    else:
        facts = {"Title": title, "Creator": "planish", "Producer": "planish", "CreationDate": None}
        with PdfPages(file, metadata=facts) as pdf:
            for page in pages:
                FigureCanvasPdf(page.figure)
                pdf.savefig(page.figure)
    return file.getvalue()
