"""How the sheet was warped, and what it took to flatten it: height, displacement, strain."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.colors import Normalize

from planish.report.draw import (
    BESIDE,
    FULL,
    HALF,
    Array,
    Canvas,
    Field,
    Picture,
    colour_bar,
    contours,
    field,
    fit_box,
    half_page,
    halo,
    levels_between,
    limits,
    pitch,
    round_below,
    scale_bar,
    show,
)
from planish.report.text import count, length, plain

GEOMETRY, SIGNED = "cividis", "RdBu_r"
_ARROWS = 22  # across the longer side


def draw_warp(surfaces: xr.Dataset, flat: xr.Dataset) -> list[Picture]:
    """Draw the centre surface's height, and by how much flattening moved every column against its projection.

    Parameters
    ----------
    surfaces, flat : Dataset, dims (y, x), in um
    """
    up = 1.0 if surfaces.attrs["top_side"] == "high" else -1.0
    height = up * surfaces["centre"].values
    height = height - np.nanmedian(height)
    heights, bar = on_top(height, surfaces["y"].values, surfaces["x"].values, flat, HALF - BESIDE)
    norm = limits(height, percent=0.1)
    canvas, axes = half_page(heights, norm=norm, cmap=GEOMETRY, label="height above the median / µm")
    low, high = np.nanpercentile(height, [0.1, 99.9])
    levels, step = levels_between(float(low), float(high), steps=6)
    contours(axes, heights, levels)
    every = f"Contours every {plain(step)}. " if levels.size else ""
    n = int(np.isfinite(height).sum())
    mask = "mask: columns with a sheet or a bridged hole, the largest connected piece"
    warp = canvas.picture(
        kind="jpeg",
        title="Warp: height of the centre surface",
        caption=f"Seen from the top side. {every}n = {count(n)} columns of {bar}; {mask}.",
    )
    return [warp, _displacement(flat)]


def _displacement(flat: xr.Dataset) -> Picture:
    y, x = flat["y"].values, flat["x"].values
    du, dv = (flat[a].values - flat[b].values for a, b in (("u", "projected_u"), ("v", "projected_v")))
    size = np.hypot(du, dv)
    shown, bar = on_top(size, y, x, flat, HALF - BESIDE)
    norm = Normalize(0.0, limits(size, percent=0.1).vmax)
    canvas, axes = half_page(shown, norm=norm, cmap=GEOMETRY, label="displacement / µm")
    stride = max(1, round(max(du.shape) / _ARROWS))
    mirrored = bool(flat.attrs.get("mirrored_view", 0))
    rows, cols = (np.arange(stride // 2, n, stride) for n in du.shape)
    places = np.broadcast_to(x[cols], (rows.size, cols.size)), np.broadcast_to(y[rows][:, None], (rows.size, cols.size))
    across = (x[0] + x[-1]) - places[0] if mirrored else places[0]
    arrows = du[np.ix_(rows, cols)], dv[np.ix_(rows, cols)]
    longest = float(np.nanmax(size)) if np.isfinite(size).any() else 0.0
    spacing = stride * max(pitch(x), pitch(y))
    magnified = round_below(1.6 * spacing / longest) if longest > 0 else 1.0
    axes.quiver(
        across, places[1], magnified * arrows[0], magnified * arrows[1], angles="xy", scale_units="xy", scale=1.0,
        color="white", width=0.004, headwidth=4, headlength=4.5, headaxislength=4, path_effects=halo(1.6, "#22292f"),
    )  # fmt: skip
    return canvas.picture(
        kind="jpeg",
        title="Displacement by flattening",
        caption=(
            "From the place in the projection to the place in the flat sheet, seen from the top side. Arrows are drawn "
            f"{magnified:g} times as long as they are; the longest displacement is {length(longest)}. "
            f"n = {count(int(np.isfinite(size).sum()))} columns of {bar}; mask: as beside, without folded cells."
        ),
    )


def draw_strain(strain: xr.Dataset, flat: xr.Dataset) -> Picture:
    """Draw what flattening did to each cell of the mesh: change of area, shear, and the largest stretch.

    Parameters
    ----------
    strain : Dataset, dims (row, col)
        ``area_ratio``, ``shear`` (rad), ``stretch_max``, ``stretch_min``; coordinates ``y``, ``x`` in um.
    flat : Dataset
        Says whether the view is mirrored.
    """
    y, x = strain["y"].values, strain["x"].values
    largest = np.maximum(np.abs(strain["stretch_max"].values - 1), np.abs(strain["stretch_min"].values - 1))
    panels = (
        ("Change of area", 100 * (strain["area_ratio"].values - 1), True),
        ("Shear", 100 * strain["shear"].values * (-1 if flat.attrs.get("mirrored_view", 0) else 1), True),
        ("Largest strain, either sign", 100 * largest, False),
    )
    gap = 0.25
    width = (FULL - 2 * gap) / 3
    fields = [on_top(values, y, x, flat, width)[0] for _, values, _ in panels]
    box = fit_box(fields[0], width, 4.5)
    canvas = Canvas(FULL, box[1] + 1.08)
    for k, ((name, values, signed), shown) in enumerate(zip(panels, fields, strict=True)):
        left = k * (width + gap)
        canvas.text(left, 0.18, name, fontweight="bold", va="baseline")
        norm = limits(values, symmetric=True) if signed else Normalize(0.0, limits(values).vmax)
        cmap = SIGNED if signed else GEOMETRY
        show(canvas.axes(left, 0.26, *box), shown, norm=norm, cmap=cmap)
        colour_bar(
            canvas.axes(left + 0.16, box[1] + 0.34, max(box[0] - 0.32, 1.9), 0.1),
            norm=norm,
            cmap=cmap,
            label="%",
            across=True,
        )
    scale_bar(canvas, 0, box[1] + 0.82, inches=box[0], um=fields[0].width)
    n = int(np.isfinite(panels[0][1]).sum())
    return canvas.picture(
        kind="jpeg",
        title="Strain of the flattening",
        caption=(
            "What the plane asks of the sheet beyond bending: zero for a sheet that can be developed. Shear is the "
            f"change of the angle between rows and columns (1 % = 0.01 rad). n = {count(n)} cells of "
            f"{length(pitch(x))}; unit %; mask: cells with all four corners on the sheet. Colours end at the 99th "
            "percentile."
        ),
    )


def on_top(values: Array, y: Array, x: Array, flat: xr.Dataset, width: float) -> tuple[Field, str]:
    """Turn a map on the volume's grid to what is seen from the top side."""
    if flat.attrs.get("mirrored_view", 0):
        values = values[:, ::-1]
    return field(values, y, x, width=width), f"{plain(round(pitch(y), 4))} × {plain(round(pitch(x), 4))}"
