"""A sheet of 20 x 15 mm, larger than any that the paper had, as a surface without voxels: is flattening needed there?

The centre surface is known at nodes 10 um apart. It is flattened, and its coating is laid onto the image: as projected,
and as flattened, by the same laser holes, whose places are 1 um uncertain as measured ones are.
"""

from __future__ import annotations

import resource
import time
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import specimens
from scipy import ndimage

import planish as pl
from planish.analyze import paired_difference
from planish.core.area import area_mean
from planish.core.grid import Grid
from planish.flatten import relax_grid
from planish.marks import hole_mask
from planish.register import fit_transform
from planish.resample import Mesh, resample
from planish.synthetic import SIZES_UM, HoleParams, Warp, make_specimen

NODES_UM, POINT_UM, MARK_UM, AWAY_UM = 10.0, 100.0, 1.0, 100.0


def said(size: specimens.Size, picture: Path) -> str:
    """The statement; the figure goes to ``picture``."""
    began = time.process_time()
    field_um = SIZES_UM["T3"] if size == "full" else (3000.0, 2000.0)
    params = specimens.base("wfc118", 20, "full", field_um)
    made = make_specimen(
        replace(
            params, holes=HoleParams(count=21), warp=Warp(bump_um=0.0),
            camera=replace(params.camera, oracle_r2=0.195, pixel_um=5.0),
        )
    )  # fmt: skip
    x, y = (np.arange(0.0, n, NODES_UM) for n in made.extent_um[:2])
    columns = made.warp.columns(y, x)
    u, v = columns[..., 0], columns[..., 1]
    points = made.warp.points(u, v)
    before = time.process_time()
    flat = relax_grid(points).uv
    flattened = time.process_time() - before
    coating = made.sheet.at(made.sheet.faces[0], u, v) - made.sheet.at(made.sheet.faces[1], u, v)
    grid = Grid.of(made.image)
    holes = made.sheet.holes
    place = made.warp.points(holes[:, 0], holes[:, 1])[:, :2]
    inside = ((place > AWAY_UM) & (place < np.array(made.extent_um[:2]) - AWAY_UM)).all(axis=1)
    at = (place[inside] / NODES_UM).T[::-1]
    marks = made.pose(holes[inside])
    use = ~hole_mask(grid, made.pose(holes), np.full(len(holes), 0.5 * params.holes.diameter_um * 1.2 + AWAY_UM))
    maps, residuals = [], []
    random = np.random.default_rng(20)
    noise = random.normal(0.0, MARK_UM, marks.shape)
    for uv, model in ((points[..., :2], "rigid"), (points[..., :2], "similarity"), (flat, "similarity")):
        moving = np.stack([ndimage.map_coordinates(uv[..., k], at, order=1) for k in (0, 1)], axis=1)
        fit = fit_transform(moving + noise, marks, model=model, robust=False)
        under = Mesh.of(fit(uv.reshape(-1, 2)).reshape(uv.shape), least_um=NODES_UM / 2).under(grid)
        shown = resample(coating[under.nodes], under.places)
        residuals.append(fit.rms_um)
        maps.append(shown)
        use &= np.isfinite(shown)
    image = np.where(use, made.image.values, np.nan)
    found = [
        pl.correlate(np.where(use, m, np.nan), image, pixel_um=grid.pixel_um, point_um=POINT_UM) for m in maps
    ]
    factor = tuple(POINT_UM / p for p in grid.pixel_um)
    cells = [area_mean(np.where(use, m, np.nan), factor) for m in (*maps, image)]
    apart = [paired_difference((m, cells[3]), (cells[2], cells[3]), pixel_um=POINT_UM) for m in cells[:2]]
    figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained", width_ratios=(1.4, 1))
    axes[0].imshow(points[..., 2], extent=(0, x[-1] / 1e3, y[-1] / 1e3, 0))
    axes[0].set(title="Height of the centre surface", xlabel="x / mm", ylabel="y / mm")
    axes[1].bar(range(3), [f.r2 for f in found], tick_label=["projection", "scaled", "flattened"])
    axes[1].set(title="r² of coating and brightness, 100 um")
    figure.savefig(picture, dpi=110)
    plt.close(figure)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    rows = "; ".join(
        f"{name}: r² {f.r2:.3f} (marks miss by {rms:.0f} um)"
        for name, f, rms in zip(("projection", "projection, scaled", "flattened"), found, residuals, strict=True)
    )
    gain = "; ".join(
        f"r {a.difference:+.3f} ({a.interval[0]:+.3f} to {a.interval[1]:+.3f})" for a in apart
    )
    return (
        f"{field_um[0] / 1e3:g} x {field_um[1] / 1e3:g} mm, {u.size} nodes, image made with r² 0.195. {rows}. Flattened less "
        f"projected, and less scaled: {gain}. Flattening {flattened:.0f} s, all {time.process_time() - began:.0f} s of "
        f"CPU time, {peak:.1f} GB."
    )
