"""How good the flattening is: the solver's progress, and whether the surface can be a sheet of paper at all."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import Normalize
from matplotlib.ticker import NullLocator, StrMethodFormatter

from planish.report.draw import ACCENT, BESIDE, HALF, INK, SOFT, Canvas, Picture, half_page, limits
from planish.report.draw import pitch as spacing
from planish.report.text import count, length
from planish.report.warp import GEOMETRY, on_top


def draw_progress(strain: xr.Dataset) -> Picture:
    """Draw the mean move of a node over the steps, mesh by mesh.

    Parameters
    ----------
    strain : Dataset
        ``step_nodes``, ``step_move`` (um) over ``step``.
    """
    nodes, move = strain["step_nodes"].values, strain["step_move"].values
    canvas = Canvas(HALF, 2.9)
    axes = canvas.axes(0.78, 0.15, HALF - 0.95, 2.15)
    steps = np.arange(1, nodes.size + 1)
    finest = float(nodes.max()) if nodes.size else 0.0
    moved = move > 0
    for size in np.unique(nodes):
        here = (nodes == size) & moved
        colour = ACCENT if size == finest else SOFT
        axes.semilogy(steps[here], move[here], "-", color=colour, lw=1.2)
        if nodes.size <= 200:
            axes.semilogy(steps[here], move[here], "o", color=colour, ms=3.5)
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_xlabel("step")
    axes.set_ylabel("mean move of a node / µm", color=INK)
    axes.grid(axis="y", lw=0.4, color="#dfe3e6")
    axes.spines[["top", "right"]].set_visible(False)
    meshes = np.unique(nodes).size
    coarse = f", grey on {meshes - 1} coarser meshes that it is solved on first" if meshes > 1 else ""
    return canvas.picture(
        title="Convergence",
        caption=(
            f"How far the nodes moved in each step (root mean square): coloured on the mesh of {count(int(finest))} "
            f"nodes{coarse}. n = {count(nodes.size)} steps; unit µm; no mask."
        ),
    )


def draw_curvature(strain: xr.Dataset, flat: xr.Dataset, check: dict[str, Any]) -> Picture | None:
    """Draw the strain that a patch of paper around each place would need to be flat; None where nothing is known.

    Parameters
    ----------
    strain : Dataset, dims (row, col)
        ``needed_strain``; coordinates ``y``, ``x`` in um.
    flat : Dataset
        Says whether the view is mirrored.
    check : dict
        ``patch_um``, ``limit`` and ``verdict`` of the check.
    """
    values = 100 * strain["needed_strain"].values
    if not np.isfinite(values).any():
        return None
    shown, bar = on_top(values, strain["y"].values, strain["x"].values, flat, HALF - BESIDE)
    norm = Normalize(0.0, limits(values, percent=0.1).vmax)
    canvas, _ = half_page(shown, norm=norm, cmap=GEOMETRY, label="strain needed / %")
    return canvas.picture(
        kind="jpeg",
        title="Can it be paper?",
        caption=(
            f"Strain with which a patch of {length(2 * check['patch_um'])} around each place would lie flat, from the "
            f"Gaussian curvature; paper carries {100 * check['limit']:g} %. "
            f"n = {count(int(np.isfinite(values).sum()))} cells of {length(spacing(strain['x'].values))}, {bar}; unit "
            "%; mask: cells with at least half of the patch on the sheet."
        ),
    )
