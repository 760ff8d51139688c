"""How the sheet was warped and what flattened it.

Height, displacement, strain, developability, convergence.
"""

import numpy as np
import xarray as xr

from planish.core.numbers import count, length, plain
from planish.flatten import CurvatureVerdict
from planish.report.colours import GEOMETRY, SIGNED, Array, limits
from planish.report.draw import (
    ACCENT,
    BELOW,
    FAINT,
    FULL,
    HALF,
    INK,
    MARGIN,
    SOFT,
    Canvas,
    Picture,
    draw_map,
    levels_between,
    magnified,
    multiples,
    n_of,
    pitch,
    pixel_of,
    reduced,
)


def draw_flattening(
    surfaces: xr.Dataset, flat: xr.Dataset, strain: xr.Dataset, curvature: CurvatureVerdict
) -> list[Picture]:
    """Draw the warp, what flattening moved and strained, and whether the surface can be paper."""
    pictures = [_draw_warp(surfaces, flat), _draw_displacement(flat), _draw_strain(strain, flat)]
    needed_percent = 100 * _from_top(strain["needed_strain"].values, flat)
    if np.isfinite(needed_percent).any():
        y, x = strain["y"].values, strain["x"].values
        scale = limits(needed_percent, GEOMETRY, percent=0.1, low=0.0)
        canvas, _ = draw_map(needed_percent, y, x, scale=scale, label="strain needed / %")
        pictures.append(
            canvas.picture(
                title="Strain that the curvature requires",
                caption=(
                    f"Strain with which a patch of {length(2 * curvature.patch_um)} around each"
                    " place would lie flat, from the Gaussian curvature; paper withstands"
                    f" {100 * curvature.limit:g} %. n = {n_of(needed_percent)} cells of"
                    f" {pixel_of(y, x)}; unit %; mask: cells with at least half of the patch"
                    " on the sheet."
                ),
            )
        )
    return pictures


def _draw_warp(surfaces: xr.Dataset, flat: xr.Dataset) -> Picture:
    y, x = surfaces["y"].values, surfaces["x"].values
    heights = (1.0 if surfaces.attrs["top_side"] == "high" else -1.0) * _from_top(
        surfaces["centre"].values, flat
    )
    heights = heights - np.nanmedian(heights)
    scale = limits(heights, GEOMETRY, percent=0.1)
    canvas, axes = draw_map(heights, y, x, scale=scale, label="height above the median / µm")
    low, high = np.nanpercentile(heights, [0.1, 99.9])
    levels, step = levels_between(float(low), float(high), steps=6)
    axes.contours(levels)
    contour_text = f"Contour lines every {plain(step)}. " if levels.size else ""
    return canvas.picture(
        title="Warp: height of the centre surface",
        caption=(
            f"Seen from the top side. {contour_text}n = {n_of(heights)} columns of"
            f" {pixel_of(y, x)}; mask: columns with a sheet or a bridged hole, largest"
            " connected piece."
        ),
    )


def _draw_displacement(flat: xr.Dataset) -> Picture:
    """Draw how far, and where to, flattening moved each column of the projection."""
    y, x = flat["y"].values, flat["x"].values
    components = [
        _from_top(flat[a].values - flat[f"projected_{a}"].values, flat) for a in ("u", "v")
    ]
    displacement = np.hypot(*components)
    vectors = np.stack(components, axis=-1)
    scale = limits(displacement, GEOMETRY, percent=0.1, low=0.0)
    canvas, axes = draw_map(displacement, y, x, scale=scale, label="displacement / µm")
    arrow_stride = max(1, round(max(displacement.shape) / 22))  # arrows across the longer side
    # The same columns from either side: those of the mirrored view count from its other end.
    rows, cols = (np.arange(arrow_stride // 2, n, arrow_stride) for n in displacement.shape)
    cols = x.size - 1 - cols if flat.attrs.get("mirrored_view", 0) else cols
    arrow_starts = np.stack(np.meshgrid(x[cols], y[rows]), axis=-1).reshape(-1, 2)
    arrow_um = 1.6 * arrow_stride * max(pitch(x), pitch(y))
    magnification = magnified(vectors.reshape(-1, 2), arrow_um)
    arrows = magnification.times * vectors[np.ix_(rows, cols)].reshape(-1, 2)
    axes.arrows(arrow_starts, arrows, colour="white", width=1.3, halo=INK)
    return canvas.picture(
        title="Displacement by flattening",
        caption=(
            "From the place in the projection to the place in the flat sheet, seen from the top"
            f" side. Arrows are {magnification.words}. n = {n_of(displacement)} columns of"
            f" {pixel_of(y, x)}; mask: as for the warp, without folded cells."
        ),
    )


def _draw_strain(strain: xr.Dataset, flat: xr.Dataset) -> Picture:
    """Draw what flattening did to each cell of the mesh (row, col).

    Change of area, shear, and the largest stretch.
    """
    stretches = [np.abs(strain[f"stretch_{extreme}"].values - 1) for extreme in ("max", "min")]
    area_change = 100 * (strain["area_ratio"].values - 1)
    largest_strain = 100 * np.maximum(*stretches)
    shear = 100 * strain["shear"].values * (-1 if flat.attrs.get("mirrored_view", 0) else 1)
    y, x, gap_px = strain["y"].values, strain["x"].values, 25.0
    panel_px = (FULL - 2 * gap_px - MARGIN - 6) / 3
    area_map = reduced(area_change, y, x, width=panel_px)
    map_size = area_map.fit(panel_px, 450.0)
    bottom_px = map_size[1] + BELOW
    canvas = Canvas(FULL, bottom_px + 90)
    panels = (
        ("Change of area", area_change, limits(area_change, SIGNED, symmetric=True)),
        ("Shear", shear, limits(shear, SIGNED, symmetric=True)),
        ("Largest strain, either sign", largest_strain, limits(largest_strain, GEOMETRY, low=0.0)),
    )
    for k, (name, values, scale) in enumerate(panels):
        left_px = MARGIN + k * (panel_px + gap_px)
        shown = reduced(_from_top(values, flat), y, x, width=panel_px)
        canvas.text(left_px, 18, f"{name} / %", bold=True)
        canvas.map_axes(left_px, 26, map_size, shown, scale, has_y_ticks=k == 0)
        canvas.colour_bar(left_px + 16, bottom_px + 36, max(map_size[0] - 32, 190), 10, scale)
    canvas.scale_bar(MARGIN, bottom_px + 66, width=map_size[0], um=area_map.width)
    canvas.draw_axis_names(MARGIN + 2 * (panel_px + gap_px) + map_size[0], bottom_px + 66)
    return canvas.picture(
        title="Strain of the flattening",
        caption=(
            "Strain that remains in the plane: zero for a sheet that can be developed. Shear is"
            " the change of the angle between rows and columns (1 % = 0.01 rad). n ="
            f" {n_of(area_change)} cells of {length(pitch(x))}; unit %; mask: cells with"
            " all four corners on the sheet. Colours end at the 99th percentile."
        ),
    )


def draw_progress(strain: xr.Dataset) -> Picture:
    """Draw the mean move of a node over the steps, mesh by mesh."""
    nodes, mean_move_um = strain["step_nodes"].values, strain["step_move"].values
    node_counts = np.unique(nodes)
    is_moved = mean_move_um > 0
    log_moves = np.log10(np.where(is_moved, mean_move_um, 1.0))
    low, high = 0.0, 1.0
    if is_moved.any():
        low = float(log_moves[is_moved].min())
        high = float(log_moves[is_moved].max())
    margin = 0.05 * max(high - low, 1.0)
    low, high = low - margin, high + margin
    canvas = Canvas(HALF, 290)
    axes = canvas.axes(78, 15, HALF - 95, 215, (0.5, max(nodes.size, 1) + 0.5, low, high))
    for node_count in node_counts:
        mesh_steps = np.flatnonzero((nodes == node_count) & is_moved)
        mesh_steps = mesh_steps[:: max(1, mesh_steps.size // 600)]
        colour = ACCENT if node_count == node_counts[-1] else SOFT
        axes.line(mesh_steps + 1.0, log_moves[mesh_steps], colour=colour, width=1.6)
        if nodes.size <= 200:
            axes.dots(mesh_steps + 1.0, log_moves[mesh_steps], colour=colour, size=5)
    for level in multiples(low, high, 1.0):
        axes.across(level, colour=FAINT, width=0.5)
    canvas.ticks(axes, "step", "mean move of a node / µm", log=True)
    step_table = {"step": [*range(1, nodes.size + 1)], "nodes": nodes.astype(int).tolist()}
    n_coarser = node_counts.size - 1
    finest_count = count(int(nodes.max(initial=0)))
    coarse_text = (
        f", grey on {n_coarser} coarser meshes that are solved first" if n_coarser > 0 else ""
    )
    return canvas.picture(
        title="Convergence",
        caption=(
            "Move of the nodes in each step (root mean square): coloured on the mesh of"
            f" {finest_count} nodes{coarse_text}. n = {count(nodes.size)} steps; unit µm; no mask."
        ),
        data={"steps": step_table | {"mean move / µm": mean_move_um.tolist()}},
    )


def _from_top(values: Array, flat: xr.Dataset) -> Array:
    return values[:, ::-1] if flat.attrs.get("mirrored_view", 0) else values
