"""The image with the marks and what the transformation leaves of them, and Fig. 6 of the paper."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from numpy.typing import NDArray
from scipy import ndimage

from planish.report.draw import (
    BESIDE,
    FULL,
    HALF,
    Array,
    Canvas,
    Field,
    Picture,
    field,
    fit_box,
    half_page,
    halo,
    limits,
    pitch,
    round_below,
    scale_bar,
    show,
)
from planish.report.maps import PROPERTY
from planish.report.text import count, in_figure, in_words, length, percent, plain, unit

_OUTLINE = "#ff5238"
_MARK = "#ffb000"
_HARDLY = 1e-3  # of the valid pixels: with fewer below the limit, the outlines would show next to nothing
_THINNEST = 5.0  # per cent
_SMALLEST = 12  # pixels of a region that is outlined


def draw_registration(linked: xr.Dataset, marks: xr.Dataset, *, hole_um: float) -> Picture:
    """Draw the image with its marks, numbered, and the residual of each as an arrow.

    Parameters
    ----------
    linked : Dataset, dims (y, x)
        ``image`` and ``u``, which says where the image shows the scanned sheet.
    marks : Dataset, dims (mark), in um
        ``fixed_x``, ``fixed_y``, ``residual_x``, ``residual_y`` (mark minus transformed mark).
    hole_um : float
        Diameter at which marks are drawn.
    """
    y, x = linked["y"].values, linked["x"].values
    canvas, axes, shown, box = _image(linked)
    _outline(axes, np.isfinite(linked["u"].values), y, x, colour="#39c5ff", width=1.2)
    fx, fy, rx, ry = (
        marks[name].values.astype(np.float64) for name in ("fixed_x", "fixed_y", "residual_x", "residual_y")
    )
    longest = float(np.max(np.hypot(rx, ry))) if rx.size else 0.0
    magnified = round_below(0.09 * shown.width / longest) if longest > 1e-9 else 1.0
    turn = np.linspace(0, 2 * np.pi, 73)
    for k in range(fx.size):
        axes.plot(fx[k] + hole_um / 2 * np.cos(turn), fy[k] + hole_um / 2 * np.sin(turn), color=_MARK, lw=1.4)
        axes.plot([fx[k]], [fy[k]], marker="+", ms=6, mew=1.0, color=_MARK)
        axes.annotate(
            str(k + 1), (fx[k] - 0.42 * hole_um, fy[k] - 0.42 * hole_um), xytext=(-2, 2), textcoords="offset points",
            ha="right", va="bottom", fontsize=10, fontweight="bold", color=_MARK, path_effects=halo(2.4, "#22292f"),
        )  # fmt: skip
    # A residual is the mark in the image minus the mark that was carried over: the arrow shows where that one falls.
    axes.quiver(
        fx, fy, -magnified * rx, -magnified * ry, angles="xy", scale_units="xy", scale=1.0, color=_OUTLINE,
        width=0.0032, headwidth=4, headlength=4.5, headaxislength=4, path_effects=halo(2.0), zorder=5,
    )  # fmt: skip
    axes.set_xlim(shown.extent[0], shown.extent[1])
    axes.set_ylim(shown.extent[2], shown.extent[3])
    if longest > 1e-9:
        scale_bar(
            canvas, (FULL - box[0]) / 2 + 0.45 * box[0], box[1] + 0.06, inches=box[0], um=shown.width / magnified,
            most=0.12, colour=_OUTLINE, label="{} of residual",
        )  # fmt: skip
    return canvas.picture(
        kind="jpeg",
        title="Marks and their residuals",
        caption=(
            f"The image with n = {fx.size} marks (orange, drawn with a diameter of {plain(hole_um)}). Red arrows point "
            "from each mark to where the transformation puts its partner in the volume, drawn "
            f"{plain_factor(magnified)} times as long as they are; the longest is {length(longest)}. Blue: edge "
            "of the scanned sheet. Grey values of "
            f"{count(int(np.isfinite(linked['image'].values).sum()))} pixels of {plain(round(pitch(x), 4))}, no mask."
        ),
    )


def plain_factor(value: float) -> str:
    """Write a magnification."""
    return count(round(value)) if value >= 1 else f"{value:g}"


def draw_outlines(linked: xr.Dataset, *, name: str, thin_um: float) -> list[Picture]:
    """Draw property and image side by side, and the image with the thin regions outlined (Hirn et al. 2009, Fig. 6).

    Parameters
    ----------
    linked : Dataset, dims (y, x)
        ``image``, ``valid`` and the property.
    name : str
        The property: the coating of the top side, or the thickness of a sheet without coating.
    thin_um : float
        What counts as thin.
    """
    y, x = linked["y"].values, linked["x"].values
    valid = linked["valid"].values.astype(bool)
    values = np.where(valid, linked[name].values.astype(np.float64), np.nan)
    n = int(np.isfinite(values).sum())
    title = str(linked[name].attrs.get("long_name", name))
    units = in_figure(unit(str(linked[name].attrs.get("units", "um"))))
    pixel = plain(round(pitch(x), 4))
    tail = f"n = {count(n)} pixels of {pixel}; mask: measured, and away from holes and their rims."

    label = f"{in_figure(title)} / {units}" if units else in_figure(title)
    shown = field(values, y, x, width=HALF - BESIDE)
    canvas, _ = half_page(shown, norm=limits(values), cmap=PROPERTY, label=label)
    first = canvas.picture(
        kind="jpeg",
        title=f"(a) {title}, on the image's pixels",
        caption=f"Unit {unit(str(linked[name].attrs.get('units', 'um')))}. {tail}",
    )

    shown = field(linked["image"].values, y, x, width=HALF - BESIDE)
    canvas, _ = half_page(shown, norm=_greys(linked), cmap="gray", label="")
    seen = int(np.isfinite(linked["image"].values).sum())
    second = canvas.picture(
        kind="jpeg",
        title="(b) The image, same region",
        caption=f"Grey values, the window set by the valid pixels; n = {count(seen)} pixels of {pixel}, no mask.",
    )

    thin = float(np.count_nonzero(values < thin_um)) / max(n, 1)
    limit, note = thin_um, f"Outlined: {in_words(title)} below {plain(thin_um)}, {percent(thin)} of the valid pixels."
    canvas, axes, *_ = _image(linked)
    if thin < _HARDLY:
        limit = float(np.nanpercentile(values, _THINNEST)) if n else thin_um
        few = "No valid pixel is" if thin == 0 else f"Only {percent(thin)} of the valid pixels are"
        note = (
            f"{few} below {plain(thin_um)}; there is next to nothing to outline there. Outlined instead: the thinnest "
            f"{_THINNEST:g} %, {in_words(title)} below {length(limit)}."
        )
        if thin > 0:
            _outline(axes, _regions(values < thin_um, 1), y, x, colour="#39c5ff", width=1.2)
            note = f"{note} In blue, what is below {plain(thin_um)}."
    drawn = _regions(values < limit, _SMALLEST)
    _outline(axes, drawn, y, x, colour=_OUTLINE, width=1.3)
    dark = _darkness(linked["image"].values.astype(np.float64), drawn, valid)
    third = canvas.picture(
        kind="jpeg",
        title="(c) Thin regions on the image",
        caption=f"{note} Regions under {_SMALLEST} pixels are not drawn. {dark}{tail}",
    )
    return [first, second, third]


def _image(linked: xr.Dataset) -> tuple[Canvas, Axes, Field, tuple[float, float]]:
    """Draw the image over the whole page, with its scale bar."""
    shown = field(linked["image"].values, linked["y"].values, linked["x"].values, width=FULL)
    box = fit_box(shown, FULL, 7.6)
    canvas = Canvas(FULL, box[1] + 0.34)
    left = (FULL - box[0]) / 2
    axes = canvas.axes(left, 0.02, *box)
    show(axes, shown, norm=_greys(linked), cmap="gray")
    scale_bar(canvas, left, box[1] + 0.06, inches=box[0], um=shown.width, most=0.2)
    return canvas, axes, shown, box


def _greys(linked: xr.Dataset) -> Normalize:
    """Return a grey window for the paper itself: holes and what lies beside the sheet may be black or white."""
    image, valid = linked["image"].values, linked["valid"].values.astype(bool)
    return limits(image[valid] if valid.any() else image, percent=0.2)


def _regions(thin: NDArray[np.bool_], smallest: int) -> NDArray[np.bool_]:
    """Keep connected regions of at least so many pixels."""
    labels, found = _label(thin)
    if found == 0:
        return thin
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray(sizes[labels] >= smallest, dtype=bool)


def _label(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], int]:
    result: Any = ndimage.label(mask, structure=np.ones((3, 3), dtype=int))
    return np.asarray(result[0], dtype=np.int32), int(result[1])


def _outline(axes: Axes, inside: NDArray[np.bool_], y: Array, x: Array, *, colour: str, width: float) -> None:
    """Draw the border of a region; where it meets the image's edge, along the edge."""
    if not inside.any() or min(inside.shape) < 2:
        return
    padded = np.pad(inside.astype(np.float64), 1)
    rows, cols = (np.concatenate([[c[0] - pitch(c) / 2], c, [c[-1] + pitch(c) / 2]]) for c in (y, x))
    axes.contour(cols, rows, padded, levels=[0.5], colors=[colour], linewidths=[width])


def _darkness(image: Array, drawn: NDArray[np.bool_], valid: NDArray[np.bool_]) -> str:
    """Say how the grey value inside the outlines compares with the rest."""
    inside, outside = image[drawn & valid], image[valid & ~drawn]
    if inside.size == 0 or outside.size == 0 or float(np.std(image[valid])) == 0:
        return ""
    shift = float(inside.mean() - outside.mean()) / float(np.std(image[valid]))
    word = "darker" if shift < 0 else "brighter"
    return f"Inside, the image is on average {abs(shift):.2f} standard deviations {word} than elsewhere. "
