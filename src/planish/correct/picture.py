"""One figure of a correction.

Grey against the radius, and a slice before, after, and the difference.
"""

import io
from pathlib import Path

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
from planish.core.typing import Entries, Floats, Pair
from planish.correct.sums import MATERIALS, UNIT, Turning
from planish.correct.volume import Corrected

_WIDTH, _DPI = 10.4, 135
_BEFORE, _AFTER, _INK = "#c28a5a", "#1f4e79", "#22292f"
_STYLE: Entries = {"font.family": "DejaVu Sans", "font.size": 8.5, "text.parse_math": False}


def write_picture(corrected: Corrected, before: xr.DataArray, path: Path) -> None:
    """Draw what a correction did, as PNG; the same numbers give the same bytes.

    Parameters
    ----------
    corrected : Corrected, with its sums: a sheet was found
    before : DataArray, dims (z, y, x); the volume as it was
    path : Path; file to make

    Raises
    ------
    FileError
        If the file cannot be written, or no sheet was found, so that there is nothing to draw.
    """
    record = corrected.record
    if record.air is None or record.sheet is None:
        raise FileError(f"{path} was not drawn: no sheet stands out from the air.")
    turning = corrected.turning
    contrast = record.sheet - record.air
    slice_before, slice_after, difference = _middle_slices(corrected.volume, before, turning)
    rows_um, cols_um = np.multiply(turning.shape[1:], turning.pitch_um).tolist()
    if rows_um > 0.7 * cols_um:  # slices side by side
        width = _WIDTH / 3 - 0.25
        height = min(width * rows_um / cols_um, 5.0)
        total = 3.3 + (height + 0.45) + 0.2
        corners = [(0.15 + k * (width + 0.25), 3.55) for k in range(3)]
    else:
        width = _WIDTH - 1.5
        height = min(width * rows_um / cols_um, 5.0)
        total = 3.3 + 3 * (height + 0.4) + 0.2
        corners = [(0.75, 3.5 + k * (height + 0.4)) for k in range(3)]
    with style.context("default"), style.context(_STYLE):
        figure = Figure(figsize=(_WIDTH, total), dpi=_DPI, facecolor="white")
        FigureCanvasAgg(figure)
        profile_axes = _add_axes(figure, total, 0.75, 0.35, _WIDTH - 1.1, 2.35)
        _draw_profiles(profile_axes, corrected, record.air, contrast)
        axes = [_add_axes(figure, total, *corner, width, height) for corner in corners]
        title = f"Slice {turning.shape[0] // 2} across {turning.axis}, before"
        greys = (record.air - 0.25 * contrast, record.sheet + 0.35 * contrast)
        _draw_slice(axes[0], slice_before, title, cols_um, "gray", greys)
        _draw_slice(axes[1], slice_after, "after", cols_um, "gray", greys)
        # NaN, where the pictures share no voxel, is not the larger one.
        limit = max(0.005 * contrast, *percentiles(np.abs(difference), 99.8))
        title = (
            f"before minus after: blue to red is -{limit:.3g} to {limit:.3g},"
            f" {100 * limit / contrast:.1f} % of the contrast"
        )
        _draw_slice(axes[2], difference, title, cols_um, "RdBu_r", (-limit, limit))
        pixel_buffer = io.BytesIO()
        figure.savefig(pixel_buffer, format="rgba")
    size = figure.canvas.get_width_height()
    image = Image.frombytes("RGBA", size, pixel_buffer.getvalue())
    try:
        image.convert("RGB").save(path, format="PNG", optimize=True)
    except OSError as error:
        raise FileError(
            f"{path} cannot be written: {error.strerror or error}. Give another place with `out`."
        ) from error


def _add_axes(
    figure: Figure, figure_height: float, x: float, y: float, width: float, height: float
) -> Axes:
    """Add axes at a place from the left and the top of the figure; all lengths in inches."""
    from_left = x / _WIDTH
    from_bottom = 1 - (y + height) / figure_height
    return figure.add_axes((from_left, from_bottom, width / _WIDTH, height / figure_height))


def _middle_slices(
    after: xr.DataArray, before: xr.DataArray, turning: Turning
) -> tuple[Floats, Floats, Floats]:
    """Middle slice across the axis, before, after and their difference.

    At most as fine as the figure.
    """
    slice_index = {turning.axis: turning.shape[0] // 2}
    planes: list[Floats] = []
    for volume in (before, after):
        plane = volume.isel(slice_index).transpose(*turning.plane)
        step = max(1.0, max(plane.shape) / 1200)
        greys = np.asarray(plane.values, np.float64)
        planes.append(area_mean(greys, (step, step)) if step > 1 else greys)
    a, b = planes
    return a, b, a - b


def _draw_profiles(axes: Axes, corrected: Corrected, air: float, contrast: float) -> None:
    """Draw the mean grey of each material against the radius, before and after, and the rings.

    ``air`` is the grey of the air, ``contrast`` that of the sheet above it. The sums hold greys
    less the mean of a material and depth; the level of the material is put back.
    """
    record = corrected.record
    turning = corrected.turning
    radius = (np.arange(turning.bins) + 0.5) * turning.step_um
    stages = ((corrected.before, _BEFORE, "before"), (corrected.after, _AFTER, "after"))
    for stage, colour, stage_name in stages:
        if stage is None:
            continue
        # Mean grey (material, bin) above air, as if every depth were as frequent at every radius;
        # NaN for few voxels.
        voxel_counts = stage.count.sum(axis=(0, 1))
        grey_sums = stage.total.sum(axis=(0, 1))
        n_voxels, level_sums = stage.level.T
        material_level = level_sums / np.maximum(n_voxels, 1)
        residual = grey_sums / np.maximum(voxel_counts, 1)
        residual[voxel_counts < 30] = np.nan
        for m, contrast_share in enumerate((material_level[:, None] + residual) / UNIT):
            grey = air + contrast * contrast_share
            axes.plot(radius, grey, color=colour, lw=0.9, label=stage_name if m == 0 else None)
            valid_bins = np.flatnonzero(np.isfinite(grey))
            if valid_bins.size and stage_name == "before":
                line_end = (radius[valid_bins[-1]], grey[valid_bins[-1]])
                look: Entries = {"va": "center", "color": _INK, "fontsize": 8}
                axes.annotate(
                    MATERIALS[m], line_end, xytext=(4, 0), textcoords="offset points", **look
                )
    for ring in record.rings:
        axes.axvline(ring.radius_um, color="#999999", lw=0.6, ls=":", zorder=0)
    axes.set_xlabel(f"Radius about {turning.axis} in um (dotted: rings corrected)")
    axes.set_ylabel("Mean grey")
    axes.set_xlim(0, turning.farthest_um * 1.06)
    axes.legend(frameon=False, loc="center right", fontsize=8, ncols=2, bbox_to_anchor=(1.0, 0.66))
    axes.set_title("  ".join(record.sentences), loc="left", fontsize=8, color=_INK, wrap=False)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_slice(
    axes: Axes, picture: Floats, title: str, width_um: float, colour_map: str, grey_limits: Pair
) -> None:
    """Draw a slice without ticks, with a bar of its scale."""
    axes.imshow(
        picture,
        colour_map,
        interpolation="nearest",
        aspect="auto",
        vmin=grey_limits[0],
        vmax=grey_limits[1],
    )
    axes.set_title(title, loc="left", fontsize=8, color=_INK, pad=3)
    axes.set_xticks([])
    axes.set_yticks([])
    length_um = round_step(0.2 * width_um)
    x, y = (0.02, 0.02 + length_um / width_um), (0.06, 0.06)
    for colour, line_width in (("white", 4.5), (_INK, 2.5)):
        axes.plot(
            x, y, color=colour, lw=line_width, transform=axes.transAxes, solid_capstyle="butt"
        )
    ground = {"facecolor": "white", "edgecolor": "none", "pad": 1.0, "alpha": 0.8}
    look: Entries = {"fontsize": 8, "va": "bottom", "color": _INK, "bbox": ground}
    axes.text(0.02, 0.11, f"{length_um:g} um", transform=axes.transAxes, **look)
