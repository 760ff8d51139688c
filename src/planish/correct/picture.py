"""One figure of a correction: grey against the radius, and a slice before, after, and the difference."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from planish.core.area import area_mean
from planish.core.errors import FileError
from planish.core.numbers import round_step
from planish.core.robust import percentiles
from planish.core.transform import Pair
from planish.core.typing import Floats
from planish.correct.sums import MATERIALS, UNIT, Sums, Turning
from planish.correct.volume import Corrected

_WIDTH, _DPI = 10.4, 135
_BEFORE, _AFTER, _INK = "#c28a5a", "#1f4e79", "#22292f"
_STYLE: dict[str, Any] = {"font.family": "DejaVu Sans", "font.size": 8.5, "text.parse_math": False}


def write_picture(corrected: Corrected, before: xr.DataArray, path: Path) -> None:
    """Draw what a correction did, as PNG; the same numbers give the same bytes.

    Parameters
    ----------
    corrected : Corrected
        With its sums: a sheet was found.
    before : DataArray, dims (z, y, x)
        The volume as it was.
    path : Path
        File to make.

    Raises
    ------
    FileError
        If the file cannot be written, or no sheet was found, so that there is nothing to draw.
    """
    record, sums = corrected.record, [s for s in (corrected.before, corrected.after) if s is not None]
    if not sums or record.air is None or record.sheet is None:
        raise FileError(f"{path} was not drawn: no sheet stands out from the air.")
    turning, air, contrast = corrected.turning, record.air, record.sheet - record.air
    pictures = _middle_slices(corrected.volume, before, turning)
    rows, cols = (n * p for n, p in zip(turning.shape[1:], turning.pitch_um, strict=True))
    tall = rows > 0.7 * cols
    width = _WIDTH / 3 - 0.25 if tall else _WIDTH - 1.5
    height = min(width * rows / cols, 5.0)
    total = 3.3 + (height + 0.45 if tall else 3 * (height + 0.4)) + 0.2
    with style.context("default"), style.context(_STYLE):
        figure = Figure(figsize=(_WIDTH, total), dpi=_DPI, facecolor="white")
        FigureCanvasAgg(figure)
        _draw_profiles(_add_axes(figure, total, 0.75, 0.35, _WIDTH - 1.1, 2.35), corrected, sums, air, contrast)
        titles = (f"Slice {turning.shape[0] // 2} across {turning.axis}, before", "after", "before minus after")
        for k, (title, picture) in enumerate(zip(titles, pictures, strict=True)):
            corner = (0.15 + k * (width + 0.25), 3.55) if tall else (0.75, 3.5 + k * (height + 0.4))
            axes = _add_axes(figure, total, *corner, width, height)
            if k == 2:
                # NaN, where the pictures share no voxel, is not the larger one.
                limit = max(0.005 * contrast, *percentiles(np.abs(picture), 99.8))
                title += f": blue to red is -{limit:.3g} to {limit:.3g}, {100 * limit / contrast:.1f} % of the contrast"
                _draw_slice(axes, picture, title, cols, "RdBu_r", (-limit, limit))
            else:
                _draw_slice(axes, picture, title, cols, "gray", (air - 0.25 * contrast, record.sheet + 0.35 * contrast))
        pixels = io.BytesIO()
        figure.savefig(pixels, format="rgba")
    image = Image.frombytes("RGBA", figure.canvas.get_width_height(), pixels.getvalue()).convert("RGB")
    try:
        image.save(path, format="PNG", optimize=True)
    except OSError as error:
        raise FileError(
            f"{path} cannot be written: {error.strerror or error}. Give another place with --out."
        ) from error


def _add_axes(figure: Figure, total: float, x: float, y: float, width: float, height: float) -> Axes:
    return figure.add_axes((x / _WIDTH, 1 - (y + height) / total, width / _WIDTH, height / total))


def _middle_slices(after: xr.DataArray, before: xr.DataArray, turning: Turning) -> tuple[Floats, Floats, Floats]:
    """Middle slice across the axis, before, after and their difference, at most so fine as the figure."""
    where = {turning.axis: turning.shape[0] // 2}
    planes = [np.asarray(v.isel(where).transpose(*turning.plane).values, np.float64) for v in (before, after)]
    step = max(1.0, max(planes[0].shape) / 1200)
    a, b = (area_mean(v, (step, step)) if step > 1 else v for v in planes)
    return a, b, a - b


def _draw_profiles(axes: Axes, corrected: Corrected, sums: list[Sums], air: float, contrast: float) -> None:
    record, turning = corrected.record, corrected.turning
    radius = (np.arange(turning.bins) + 0.5) * turning.step_um
    for stage, (colour, name) in zip(sums, ((_BEFORE, "before"), (_AFTER, "after")), strict=False):
        # Mean grey (material, bin) above air, as if every depth were as frequent at every radius; NaN for few voxels.
        count, total = stage.count.sum(axis=(0, 1)), stage.total.sum(axis=(0, 1))
        level = stage.level[:, 1] / np.maximum(stage.level[:, 0], 1)
        above = np.where(count >= 30, total / np.maximum(count, 1), np.nan)  # voxels of a point of the profile
        for m, means in enumerate((level[:, None] + above) / UNIT):
            grey = air + contrast * means
            axes.plot(radius, grey, color=colour, lw=0.9, label=name if m == 0 else None)
            bins = np.flatnonzero(np.isfinite(grey))
            if bins.size and name == "before":
                axes.annotate(
                    MATERIALS[m], (radius[bins[-1]], grey[bins[-1]]), xytext=(4, 0), textcoords="offset points",
                    va="center", color=_INK, fontsize=8,
                )  # fmt: skip
    for ring in record.rings:
        axes.axvline(ring.radius_um, color="#999999", lw=0.6, ls=":", zorder=0)
    axes.set_xlabel(f"Radius about {turning.axis} in um (dotted: rings corrected)")
    axes.set_ylabel("Mean grey")
    axes.set_xlim(0, turning.farthest_um * 1.06)
    axes.legend(frameon=False, loc="center right", fontsize=8, ncols=2, bbox_to_anchor=(1.0, 0.66))
    axes.set_title("  ".join(record.sentences), loc="left", fontsize=8, color=_INK, wrap=False)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_slice(axes: Axes, picture: Floats, title: str, width_um: float, colours: str, limits: Pair) -> None:
    """Draw a slice without axes, with a bar for its scale."""
    axes.imshow(picture, colours, interpolation="nearest", aspect="auto", vmin=limits[0], vmax=limits[1])
    axes.set_title(title, loc="left", fontsize=8, color=_INK, pad=3)
    axes.set_xticks([])
    axes.set_yticks([])
    length = round_step(0.2 * width_um)
    across, up = length / width_um, 0.06
    axes.plot([0.02, 0.02 + across], [up, up], color="white", lw=4.5, transform=axes.transAxes, solid_capstyle="butt")
    axes.plot([0.02, 0.02 + across], [up, up], color=_INK, lw=2.5, transform=axes.transAxes, solid_capstyle="butt")
    axes.text(
        0.02, up + 0.05, f"{length:g} um", transform=axes.transAxes, fontsize=8, va="bottom", color=_INK,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0, "alpha": 0.8},
    )  # fmt: skip
