"""How the sheet was warped and what flattened it.

Height, displacement, strain, developability, convergence.
"""

import numpy as np
import xarray as xr

from planish.core.numbers import count, length, plain
from planish.flatten import CurvatureVerdict
from planish.report.colours import GEOMETRY, SIGNED, limits
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
    axes_of,
    draw_map,
    levels_between,
    magnified,
    multiples,
    n_of,
    pitch,
    pixel_of,
    reduced,
)
from planish.report.slices import top_sign


def draw_flattening(
    surfaces: xr.Dataset, flat: xr.Dataset, strain: xr.Dataset, curvature: CurvatureVerdict
) -> list[Picture]:
    """Draw the warp, what flattening moved and strained, and whether the surface can be paper.

    ``surfaces`` and ``flat`` are (y, x), on the columns of the volume; ``strain`` is (row, col), of
    the cells between them. The last figure is there where the needed strain is known.
    """
    strain = strain.swap_dims(row="y", col="x")
    pictures = [_draw_warp(surfaces, flat), _draw_displacement(flat), _draw_strain(strain, flat)]
    # The strain of a patch is known where the sheet is large enough for one.
    needed_percent = 100 * _from_top(strain["needed_strain"], flat)
    if np.isfinite(needed_percent).any():
        scale = limits(needed_percent, GEOMETRY, percent=0.1, low=0.0)
        canvas, _ = draw_map(needed_percent, scale=scale, label="strain needed / %")
        caption = (
            f"Strain with which a patch of {length(2 * curvature.patch_um)} around each"
            " place would lie flat, from the Gaussian curvature; paper withstands"
            f" {100 * curvature.limit:g} %. n = {n_of(needed_percent)} cells of"
            f" {pixel_of(*axes_of(needed_percent))}; unit %; mask: cells with at least half of the"
            " patch on the sheet."
        )
        pictures.append(canvas.picture("Strain that the curvature requires", caption))
    return pictures


def _draw_warp(surfaces: xr.Dataset, flat: xr.Dataset) -> Picture:
    """Draw the height of the centre surface, upwards where the top side is."""
    heights = top_sign(surfaces) * _from_top(surfaces["centre"], flat)
    heights = heights - np.nanmedian(heights)
    scale = limits(heights, GEOMETRY, percent=0.1)
    canvas, axes = draw_map(heights, scale=scale, label="height above the median / µm")
    low, high = np.nanpercentile(heights, [0.1, 99.9])
    levels, step = levels_between(float(low), float(high), steps=6)
    axes.contours(levels)
    contour_text = ""
    if levels.size:
        contour_text = f"Contour lines every {plain(step)}. "
    caption = (
        f"Seen from the top side. {contour_text}n = {n_of(heights)} columns of"
        f" {pixel_of(*axes_of(heights))}; mask: columns with a sheet or a bridged hole, largest"
        " connected piece."
    )
    return canvas.picture("Warp: height of the centre surface", caption)


def _draw_displacement(flat: xr.Dataset) -> Picture:
    """Draw how far, and where to, flattening moved each column of the projection.

    ``u``, ``v`` are places in the flat sheet along x and y, and ``projected_u``, ``projected_v``
    those before, in um.
    """
    across = _from_top(flat["u"] - flat["projected_u"], flat)
    down = _from_top(flat["v"] - flat["projected_v"], flat)
    displacement = xr.apply_ufunc(np.hypot, across, down)
    vectors = np.stack([across, down], axis=-1)
    y, x = axes_of(displacement)
    scale = limits(displacement, GEOMETRY, percent=0.1, low=0.0)
    canvas, axes = draw_map(displacement, scale=scale, label="displacement / µm")
    # Columns from one arrow to the next: 22 arrows along the longer side.
    arrow_stride = max(1, round(max(displacement.shape) / 22))
    # The same columns from either side: those of the mirrored view count from its other end.
    rows, cols = (np.arange(arrow_stride // 2, n, arrow_stride) for n in displacement.shape)
    if _is_mirrored(flat):
        cols = x.size - 1 - cols
    starts = np.stack(np.meshgrid(x[cols], y[rows]), axis=-1)
    arrow_um = 1.6 * arrow_stride * max(pitch(x), pitch(y))  # length of the longest on the figure
    magnification = magnified(vectors.reshape(-1, 2), arrow_um)
    arrows = magnification.times * vectors[np.ix_(rows, cols)]
    axes.arrows(starts.reshape(-1, 2), arrows.reshape(-1, 2), colour="white", width=1.3, halo=INK)
    caption = (
        "From the place in the projection to the place in the flat sheet, seen from the top"
        f" side. Arrows are {magnification.words}. n = {n_of(displacement)} columns of"
        f" {pixel_of(y, x)}; mask: as for the warp, without folded cells."
    )
    return canvas.picture("Displacement by flattening", caption)


def _draw_strain(strain: xr.Dataset, flat: xr.Dataset) -> Picture:
    """Draw what flattening did to each cell of the mesh (y, x): change of area, shear and strain.

    ``stretch_max`` and ``stretch_min`` are the ratios of lengths, 1 without strain, in the
    directions where they are largest and smallest; ``shear`` is an angle in rad.
    """
    area_change = 100 * (strain["area_ratio"] - 1)
    largest_stretch = np.abs(strain["stretch_max"] - 1)
    smallest_stretch = np.abs(strain["stretch_min"] - 1)
    largest_strain = 100 * xr.apply_ufunc(np.maximum, largest_stretch, smallest_stretch)
    shear = 100 * strain["shear"]
    if _is_mirrored(flat):  # the angle between rows and columns opens the other way
        shear = -shear
    gap_px = 25.0
    panel_px = (FULL - 2 * gap_px - MARGIN - 6) / 3
    area_map = reduced(area_change, width=panel_px)
    width, height = map_size = area_map.fit(panel_px, 450.0)
    bottom_px = height + BELOW
    canvas = Canvas(FULL, bottom_px + 90)
    panels = (
        ("Change of area", area_change, limits(area_change, SIGNED, symmetric=True)),
        ("Shear", shear, limits(shear, SIGNED, symmetric=True)),
        ("Largest strain, either sign", largest_strain, limits(largest_strain, GEOMETRY, low=0.0)),
    )
    bar_px = max(width - 32, 190)
    left_px = MARGIN
    for name, data, scale in panels:
        shown = reduced(_from_top(data, flat), width=panel_px)
        is_first = left_px == MARGIN
        canvas.text(left_px, 18, f"{name} / %", bold=True)
        canvas.map_axes(left_px, 26, map_size, shown, scale, has_y_ticks=is_first)
        canvas.colour_bar(left_px + 16, bottom_px + 36, bar_px, 10, scale)
        left_px += panel_px + gap_px
    canvas.scale_bar(MARGIN, bottom_px + 66, width=width, um=area_map.width)
    canvas.draw_axis_names(left_px - panel_px - gap_px + width, bottom_px + 66)
    caption = (
        "Strain that remains in the plane: zero for a sheet that can be developed. Shear is"
        " the change of the angle between rows and columns (1 % = 0.01 rad). n ="
        f" {n_of(area_change)} cells of {length(pitch(strain['x'].values))}; unit %; mask: cells"
        " with all four corners on the sheet. Colours end at the 99th percentile."
    )
    return canvas.picture("Strain of the flattening", caption)


def draw_progress(strain: xr.Dataset) -> Picture:
    """Draw the mean move of a node over the steps, mesh by mesh.

    ``strain`` holds of each step ``step_nodes``, how many nodes the mesh has that it was done on,
    and ``step_move`` in um, 0 where nothing moved.
    """
    nodes = strain["step_nodes"].values
    mean_move_um = strain["step_move"].values
    node_counts = np.unique(nodes)
    is_moved = mean_move_um > 0
    log_moves = np.log10(np.where(is_moved, mean_move_um, 1.0))
    least, most = 0.0, 1.0
    if is_moved.any():
        least = float(log_moves[is_moved].min())
        most = float(log_moves[is_moved].max())
    margin = 0.05 * max(most - least, 1.0)
    low = least - margin
    high = most + margin
    canvas = Canvas(HALF, 290)
    extent = (0.5, max(nodes.size, 1) + 0.5, low, high)  # steps, and logarithms of um
    axes = canvas.axes(78, 15, HALF - 95, 215, extent)
    for node_count in node_counts:
        mesh_steps = np.flatnonzero((nodes == node_count) & is_moved)
        stride = max(1, mesh_steps.size // 600)  # more points than that look the same
        mesh_steps = mesh_steps[::stride]
        colour = ACCENT if node_count == node_counts[-1] else SOFT
        axes.line(mesh_steps + 1.0, log_moves[mesh_steps], colour=colour, width=1.6)
        if nodes.size <= 200:  # of more steps, dots would hide the line
            axes.dots(mesh_steps + 1.0, log_moves[mesh_steps], colour=colour, size=5)
    for level in multiples(low, high, 1.0):
        axes.across(level, colour=FAINT, width=0.5)
    canvas.ticks(axes, "step", "mean move of a node / µm", log=True)
    step_table = {
        "step": [*range(1, nodes.size + 1)],
        "nodes": nodes.astype(int).tolist(),
        "mean move / µm": mean_move_um.tolist(),
    }
    n_coarser = node_counts.size - 1
    finest_count = count(int(nodes.max(initial=0)))
    coarse_text = ""
    if n_coarser > 0:
        coarse_text = f", grey on {n_coarser} coarser meshes that are solved first"
    caption = (
        "Move of the nodes in each step (root mean square): coloured on the mesh of"
        f" {finest_count} nodes{coarse_text}. n = {count(nodes.size)} steps; unit µm; no mask."
    )
    return canvas.picture("Convergence", caption, {"steps": step_table})


def _is_mirrored(flat: xr.Dataset) -> bool:
    return bool(flat.attrs.get("mirrored_view", 0))


def _from_top(data: xr.DataArray, flat: xr.Dataset) -> xr.DataArray:
    """Return a map (y, x) as it is seen from the top side."""
    if not _is_mirrored(flat):
        return data
    return data.copy(data=data.values[:, ::-1])
