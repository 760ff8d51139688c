"""How the sheet was warped and what flattened it: height, displacement, strain, developability, convergence."""

from __future__ import annotations

import numpy as np
import xarray as xr

from planish.core.numbers import count, length, plain
from planish.flatten import CurvatureVerdict
from planish.report import draw
from planish.report.colours import GEOMETRY, SIGNED, Array, limits


def draw_flattening(
    surfaces: xr.Dataset, flat: xr.Dataset, strain: xr.Dataset, curvature: CurvatureVerdict
) -> list[draw.Picture]:
    """Draw the warp, what flattening moved and strained, and whether the surface can be paper."""
    pictures = [_draw_warp(surfaces, flat), _draw_displacement(flat), _draw_strain(strain, flat)]
    needed = 100 * _from_top(strain["needed_strain"].values, flat)
    if np.isfinite(needed).any():
        y, x = strain["y"].values, strain["x"].values
        scale = limits(needed, GEOMETRY, percent=0.1, low=0.0)
        canvas, _ = draw.draw_map(needed, y, x, scale=scale, label="strain needed / %")
        pictures.append(canvas.picture(
            title="Can it be paper?",
            caption=f"Strain with which a patch of {length(2 * curvature.patch_um)} around each place would lie flat, "
            f"from the Gaussian curvature; paper carries {100 * curvature.limit:g} %. n = {draw.n_of(needed)} cells of "
            f"{draw.pixel_of(y, x)}; unit %; mask: cells with at least half of the patch on the sheet.",
        ))  # fmt: skip
    return pictures


def _draw_warp(surfaces: xr.Dataset, flat: xr.Dataset) -> draw.Picture:
    """Draw the height of the centre surface."""
    y, x = surfaces["y"].values, surfaces["x"].values
    height = (1.0 if surfaces.attrs["top_side"] == "high" else -1.0) * _from_top(surfaces["centre"].values, flat)
    height = height - np.nanmedian(height)
    scale = limits(height, GEOMETRY, percent=0.1)
    canvas, axes = draw.draw_map(height, y, x, scale=scale, label="height above the median / µm")
    low, high = np.nanpercentile(height, [0.1, 99.9])
    levels, step = draw.levels_between(float(low), float(high), steps=6)
    axes.contours(levels)
    every = f"Contour lines every {plain(step)}. " if levels.size else ""
    return canvas.picture(
        title="Warp: height of the centre surface",
        caption=(
            f"Seen from the top side. {every}n = {draw.n_of(height)} columns of {draw.pixel_of(y, x)}; mask: columns "
            "with a sheet or a bridged hole, largest connected piece."
        ),
    )


def _draw_displacement(flat: xr.Dataset) -> draw.Picture:
    """Draw by how much flattening moved every column against its projection."""
    y, x = flat["y"].values, flat["x"].values
    moves = [_from_top(flat[a].values - flat[f"projected_{a}"].values, flat) for a in ("u", "v")]
    moved = np.hypot(*moves)
    scale = limits(moved, GEOMETRY, percent=0.1, low=0.0)
    canvas, axes = draw.draw_map(moved, y, x, scale=scale, label="displacement / µm")
    stride = max(1, round(max(moved.shape) / 22))  # arrows across the longer side
    # The same columns from either side: those of the mirrored view count from its other end.
    rows, cols = (np.arange(stride // 2, n, stride) for n in moved.shape)
    cols = x.size - 1 - cols if flat.attrs.get("mirrored_view", 0) else cols
    places = np.stack(np.meshgrid(x[cols], y[rows]), axis=-1).reshape(-1, 2)
    vectors = np.stack([move[np.ix_(rows, cols)] for move in moves], axis=-1).reshape(-1, 2)
    factor = draw.magnified(np.stack(moves, axis=-1).reshape(-1, 2), 1.6 * stride * max(draw.pitch(x), draw.pitch(y)))
    axes.arrows(places, factor.times * vectors, colour="white", width=1.3, halo=draw.INK)
    return canvas.picture(
        title="Displacement by flattening",
        caption=(
            "From the place in the projection to the place in the flat sheet, seen from the top side. Arrows are "
            f"{factor.words}. n = {draw.n_of(moved)} columns of {draw.pixel_of(y, x)}; mask: as for the warp, without "
            "folded cells."
        ),
    )


def _draw_strain(strain: xr.Dataset, flat: xr.Dataset) -> draw.Picture:
    """Draw what flattening did to each cell of the mesh (row, col): change of area, shear, and the largest stretch."""
    stretches = [np.abs(strain[f"stretch_{end}"].values - 1) for end in ("max", "min")]
    area, largest = 100 * (strain["area_ratio"].values - 1), 100 * np.maximum(*stretches)
    shear = 100 * strain["shear"].values * (-1 if flat.attrs.get("mirrored_view", 0) else 1)
    y, x, gap = strain["y"].values, strain["x"].values, 25.0
    width = (draw.FULL - 2 * gap - draw.MARGIN - 6) / 3
    first = draw.reduced(area, y, x, width=width)
    box = first.fit(width, 450.0)
    low = box[1] + draw.BELOW
    canvas = draw.Canvas(draw.FULL, low + 90)
    panels = (
        ("Change of area", area, limits(area, SIGNED, symmetric=True)),
        ("Shear", shear, limits(shear, SIGNED, symmetric=True)),
        ("Largest strain, either sign", largest, limits(largest, GEOMETRY, low=0.0)),
    )
    for k, (name, values, scale) in enumerate(panels):
        x0, shown = draw.MARGIN + k * (width + gap), draw.reduced(_from_top(values, flat), y, x, width=width)
        canvas.text(x0, 18, f"{name} / %", bold=True)
        canvas.map_axes(x0, 26, box, shown, scale, rows=k == 0)
        canvas.colour_bar(x0 + 16, low + 36, max(box[0] - 32, 190), 10, scale)
    canvas.scale_bar(draw.MARGIN, low + 66, width=box[0], um=first.width)
    canvas.axes_names(draw.MARGIN + 2 * (width + gap) + box[0], low + 66)
    return canvas.picture(
        title="Strain of the flattening",
        caption=(
            "Strain that remains in the plane: zero for a sheet that can be developed. Shear is the change of the "
            f"angle between rows and columns (1 % = 0.01 rad). n = {draw.n_of(area)} cells of {length(draw.pitch(x))}; "
            "unit %; mask: cells with all four corners on the sheet. Colours end at the 99th percentile."
        ),
    )


def draw_progress(strain: xr.Dataset) -> draw.Picture:
    """Draw the mean move of a node over the steps, mesh by mesh."""
    nodes, move = strain["step_nodes"].values, strain["step_move"].values
    sizes, moved = np.unique(nodes), move > 0
    logs = np.log10(np.where(moved, move, 1.0))
    low, high = (float(logs[moved].min()), float(logs[moved].max())) if moved.any() else (0.0, 1.0)
    room = 0.05 * max(high - low, 1.0)
    low, high = low - room, high + room
    canvas = draw.Canvas(draw.HALF, 290)
    axes = canvas.axes(78, 15, draw.HALF - 95, 215, (0.5, max(nodes.size, 1) + 0.5, low, high))
    for size in sizes:
        here = np.flatnonzero((nodes == size) & moved)
        points = np.stack([here + 1.0, logs[here]], axis=1)[:: max(1, here.size // 600)]
        colour = draw.ACCENT if size == sizes[-1] else draw.SOFT
        axes.line(points, colour=colour, width=1.6)
        if nodes.size <= 200:
            axes.dots(points, colour=colour, size=5)
    for level in draw.multiples(low, high, 1.0):
        axes.across(level, colour=draw.FAINT, width=0.5)
    canvas.ticks(axes, "step", "mean move of a node / µm", log=True)
    steps = {"step": [*range(1, nodes.size + 1)], "nodes": [int(n) for n in nodes], "mean move / µm": move.tolist()}
    coarse = f", grey on {sizes.size - 1} coarser meshes that are solved first" if sizes.size > 1 else ""
    finest = count(int(nodes.max(initial=0)))
    return canvas.picture(
        title="Convergence",
        caption=(
            f"Move of the nodes in each step (root mean square): coloured on the mesh of {finest} "
            f"nodes{coarse}. n = {count(nodes.size)} steps; unit µm; no mask."
        ),
        data={"steps": steps},
    )


def _from_top(values: Array, flat: xr.Dataset) -> Array:
    """Turn a map on the volume's grid to what is seen from the top side."""
    return values[:, ::-1] if flat.attrs.get("mirrored_view", 0) else values
