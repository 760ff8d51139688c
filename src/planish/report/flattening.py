"""How the sheet was warped and what flattened it: height, displacement, strain, convergence, developability."""

from __future__ import annotations

import numpy as np
import xarray as xr

from planish.report.colours import GEOMETRY, SIGNED, Array, limits
from planish.report.draw import (
    ACCENT,
    BESIDE,
    FAINT,
    FULL,
    HALF,
    INK,
    SOFT,
    Canvas,
    Field,
    Picture,
    half_page,
    levels_between,
    pitch,
    reduced,
    round_below,
)  # fmt: skip
from planish.report.text import count, length, plain

_ARROWS = 22  # across the longer side
_POINTS = 600  # of a line of the convergence


def draw_warp(surfaces: xr.Dataset, flat: xr.Dataset) -> list[Picture]:
    """Draw the centre surface's height, and by how much flattening moved every column against its projection."""
    up = 1.0 if surfaces.attrs["top_side"] == "high" else -1.0
    height = up * surfaces["centre"].values
    height = height - np.nanmedian(height)
    heights, size = _from_top(height, surfaces, flat)
    canvas, axes = half_page(heights, scale=limits(height, GEOMETRY, percent=0.1), label="height above the median / µm")
    low, high = np.nanpercentile(height, [0.1, 99.9])
    levels, step = levels_between(float(low), float(high), steps=6)
    axes.contours(heights, levels)
    every = f"Contour lines every {plain(step)}. " if levels.size else ""
    warp = canvas.picture(
        title="Warp: height of the centre surface",
        caption=(
            f"Seen from the top side. {every}n = {count(int(np.isfinite(height).sum()))} columns of {size}; mask: "
            "columns with a sheet or a bridged hole, largest connected piece."
        ),
    )
    return [warp, _displacement(flat)]


def _displacement(flat: xr.Dataset) -> Picture:
    y, x = flat["y"].values, flat["x"].values
    du, dv = (flat[a].values - flat[b].values for a, b in (("u", "projected_u"), ("v", "projected_v")))
    moved = np.hypot(du, dv)
    shown, size = _from_top(moved, flat, flat)
    canvas, axes = half_page(shown, scale=limits(moved, GEOMETRY, percent=0.1, low=0.0), label="displacement / µm")
    stride = max(1, round(max(du.shape) / _ARROWS))
    rows, cols = np.meshgrid(*(np.arange(stride // 2, n, stride) for n in du.shape), indexing="ij")
    across = (x[0] + x[-1]) - x[cols] if flat.attrs.get("mirrored_view", 0) else x[cols]
    longest = float(np.nanmax(moved)) if np.isfinite(moved).any() else 0.0
    magnified = round_below(1.6 * stride * max(pitch(x), pitch(y)) / longest) if longest > 0 else 1.0
    at = np.stack([across, y[rows]], axis=-1).reshape(-1, 2)
    axes.arrows(
        at, magnified * np.stack([du, dv], axis=-1)[rows, cols].reshape(-1, 2), colour="white", width=1.3, halo=INK
    )
    return canvas.picture(
        title="Displacement by flattening",
        caption=(
            "From the place in the projection to the place in the flat sheet, seen from the top side. Arrows are "
            f"magnified {magnified:g} times; the longest displacement is {length(longest)}. "
            f"n = {count(int(np.isfinite(moved).sum()))} columns of {size}; mask: as for the warp, without "
            "folded cells."
        ),
    )


def draw_strain(strain: xr.Dataset, flat: xr.Dataset) -> Picture:
    """Draw what flattening did to each cell of the mesh (row, col): change of area, shear, and the largest stretch."""
    largest = np.maximum(np.abs(strain["stretch_max"].values - 1), np.abs(strain["stretch_min"].values - 1))
    area = 100 * (strain["area_ratio"].values - 1)
    shear = 100 * strain["shear"].values * (-1 if flat.attrs.get("mirrored_view", 0) else 1)
    panels = (
        ("Change of area", area, limits(area, SIGNED, symmetric=True)),
        ("Shear", shear, limits(shear, SIGNED, symmetric=True)),
        ("Largest strain, either sign", 100 * largest, limits(100 * largest, GEOMETRY, low=0.0)),
    )
    gap = 25.0
    width = (FULL - 2 * gap) / 3
    fields = [_from_top(values, strain, flat, width)[0] for _, values, _ in panels]
    box = fields[0].fit(width, 450.0)
    canvas = Canvas(FULL, box[1] + 90)
    for k, ((name, _, scale), shown) in enumerate(zip(panels, fields, strict=True)):
        left = k * (width + gap)
        canvas.text(left + 1, 18, f"{name} / %", bold=True)
        canvas.axes(left + 1, 26, *box, shown.extent).image(shown, scale)
        canvas.colour_bar(left + 16, box[1] + 36, max(box[0] - 32, 190), 10, scale)
    canvas.scale_bar(1, box[1] + 66, width=box[0], um=fields[0].width)
    return canvas.picture(
        title="Strain of the flattening",
        caption=(
            "Strain that remains in the plane: zero for a sheet that can be developed. Shear is the change of the "
            f"angle between rows and columns (1 % = 0.01 rad). n = {count(int(np.isfinite(area).sum()))} cells of "
            f"{length(pitch(strain['x'].values))}; unit %; mask: cells with all four corners on the sheet. Colours end "
            "at the 99th percentile."
        ),
    )


def draw_progress(strain: xr.Dataset) -> Picture:
    """Draw the mean move of a node over the steps, mesh by mesh."""
    nodes, move = strain["step_nodes"].values, strain["step_move"].values
    steps = np.arange(1.0, nodes.size + 1)
    finest = float(nodes.max()) if nodes.size else 0.0
    moved = move > 0
    logs = np.log10(np.where(moved, move, 1.0))
    low, high = (float(logs[moved].min()), float(logs[moved].max())) if moved.any() else (0.0, 1.0)
    room = 0.05 * max(high - low, 1.0)
    canvas = Canvas(HALF, 290)
    axes = canvas.axes(78, 15, HALF - 95, 215, (0.5, max(nodes.size, 1) + 0.5, low - room, high + room))
    for size in np.unique(nodes):
        here = np.flatnonzero((nodes == size) & moved)
        at = np.stack([steps[here], logs[here]], axis=1)[:: max(1, here.size // _POINTS)]
        colour = ACCENT if size == finest else SOFT
        axes.line(at, colour=colour, width=1.6)
        if nodes.size <= 200:
            axes.dots(at, colour=colour, size=5)
    for level in np.arange(np.ceil(low - room), np.floor(high + room) + 1):
        axes.line([(axes.extent[0], level), (axes.extent[1], level)], colour=FAINT, width=0.5)
    canvas.ticks(axes, "step", "mean move of a node / µm", log=True)
    meshes = np.unique(nodes).size
    coarse = f", grey on {meshes - 1} coarser meshes that are solved first" if meshes > 1 else ""
    return canvas.picture(
        title="Convergence",
        caption=(
            f"Move of the nodes in each step (root mean square): coloured on the mesh of {count(int(finest))} "
            f"nodes{coarse}. n = {count(nodes.size)} steps; unit µm; no mask."
        ),
    )


def draw_curvature(strain: xr.Dataset, flat: xr.Dataset, *, patch_um: float, limit: float) -> Picture | None:
    """Draw the strain that a patch of paper around each place would need to be flat; None where nothing is known."""
    values = 100 * strain["needed_strain"].values
    if not np.isfinite(values).any():
        return None
    shown, size = _from_top(values, strain, flat)
    canvas, _ = half_page(shown, scale=limits(values, GEOMETRY, percent=0.1, low=0.0), label="strain needed / %")
    return canvas.picture(
        title="Can it be paper?",
        caption=(
            f"Strain with which a patch of {length(2 * patch_um)} around each place would lie flat, from the Gaussian "
            f"curvature; paper carries {100 * limit:g} %. n = {count(int(np.isfinite(values).sum()))} cells of {size}; "
            "unit %; mask: cells with at least half of the patch on the sheet."
        ),
    )


def _from_top(values: Array, grid: xr.Dataset, flat: xr.Dataset, width: float = HALF - BESIDE) -> tuple[Field, str]:
    """Turn a map on the volume's grid to what is seen from the top side; with the size of its pixels."""
    y, x = grid["y"].values, grid["x"].values
    if flat.attrs.get("mirrored_view", 0):
        values = values[:, ::-1]
    return reduced(values, y, x, width=width), f"{plain(round(pitch(y), 4))} × {plain(round(pitch(x), 4))}"
