"""A sheet of 20 x 15 mm, larger than any that the paper had, as a surface without voxels.

The centre surface is known at nodes 10 um apart. It is flattened, and its coating is laid onto the
image: as projected, and as flattened, by the same laser holes, whose places are 1 um uncertain as
measured ones are.
"""

from __future__ import annotations

import resource
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import specimens
from numpy.typing import NDArray
from scipy import ndimage
from statements.truth import Correlations
from statements.truth import said as said_of

import planish as pl
from planish.analyze import paired_difference
from planish.core.area import area_mean
from planish.core.grid import Grid
from planish.flatten import relax_grid
from planish.marks import hole_mask
from planish.register import fit_transform
from planish.resample import Mesh, resample
from planish.synthetic import (
    SIZES_UM,
    BurnParams,
    Specimen,
    Warp,
    image_material,
    make_specimen,
    vignette,
)

Array = NDArray[np.float64]

NODES_UM, POINT_UM, MARK_UM, AWAY_UM = 10.0, 100.0, 1.0, 100.0
HOLES, R2, PIXEL_UM = 21, 0.195, 5.0
SEED = 20


class Sheet(NamedTuple):
    """The centre surface at its nodes: places, material coordinates, and the coating there."""

    points: Array
    u: Array
    v: Array
    coating: Array


class Laid(NamedTuple):
    """The coating on the image's pixels by one registration, and how far the marks miss."""

    coating: Array
    marks_rms_um: float


def said(size: specimens.Size, picture: Path) -> str:
    """Statement of the large sheet; its figure is written to ``picture``."""
    began = time.process_time()
    made = specimen_of(SIZES_UM["T3"] if size == "full" else (3000.0, 2000.0))
    sheet = sheet_of(made)
    before = time.process_time()
    flat = relax_grid(sheet.points).uv
    flattening_s = time.process_time() - before
    projected = sheet.points[..., :2]
    noise = np.random.default_rng(SEED).normal(0.0, MARK_UM, (HOLES, 2))
    laid = {
        "projection": lay(made, sheet, projected, "rigid", noise),
        "projection, scaled": lay(made, sheet, projected, "similarity", noise),
        "flattened": lay(made, sheet, flat, "similarity", noise),
    }
    grid, holes = Grid.of(made.image), made.sheet.holes
    reach = np.full(len(holes), 0.6 * made.params.holes.diameter_um + AWAY_UM)
    use = ~hole_mask(grid, made.pose(holes), reach) & np.all(
        [np.isfinite(one.coating) for one in laid.values()], axis=0
    )
    maps, image = (
        {k: np.where(use, one.coating, np.nan) for k, one in laid.items()},
        np.where(use, made.image.values, np.nan),
    )
    u, v = image_material(made.pose, made.image_shape, PIXEL_UM)
    true = np.where(use, coating_of(made, u, v), np.nan)
    light = vignette(made.image_shape, made.params.camera.vignetting)
    size = {"pixel_um": grid.pixel_um, "point_um": POINT_UM}
    r = {k: pl.correlate(m, image, **size).r for k, m in maps.items()}
    lost = Correlations(
        r["flattened"],
        pl.correlate(true, image, **size).r,
        pl.correlate(true, image / light, **size).r,
    )
    r2 = {k: one**2 for k, one in r.items()}
    draw(sheet, r2, picture)
    rows = "; ".join(
        f"{k}: r² {r2[k]:.3f} (marks miss by {one.marks_rms_um:.0f} um)" for k, one in laid.items()
    )
    width, height = (um / 1e3 for um in made.extent_um[:2])
    return (
        f"{width:.0f} x {height:.0f} mm, {sheet.u.size} nodes, image made with r² {R2}. {rows}."
        f" Flattened less projected, and less scaled: {gains(maps, image, grid.pixel_um)}."
        f"{said_of(lost)}"
        f" Flattening {flattening_s:.0f} s, all {time.process_time() - began:.0f} s of CPU time,"
        f" {peak_gb():.1f} GB."
    )


def specimen_of(field_um: tuple[float, float]) -> Specimen:
    """The sheet, its image and its holes; it bends and is not dented."""
    params = specimens.base("wfc118", SEED, "full", field_um)
    camera = replace(params.camera, oracle_r2=R2, pixel_um=PIXEL_UM)
    return make_specimen(
        replace(params, holes=BurnParams(count=HOLES), warp=Warp(bump_um=0.0), camera=camera)
    )


def sheet_of(made: Specimen) -> Sheet:
    """The centre surface of a specimen, at nodes that are even as a scanner's are."""
    x, y = (np.arange(0.0, n, NODES_UM) for n in made.extent_um[:2])
    columns = made.warp.columns(y, x)
    u, v = columns[..., 0], columns[..., 1]
    return Sheet(made.warp.points(u, v), u, v, coating_of(made, u, v))


def coating_of(made: Specimen, u: Array, v: Array) -> Array:
    """True thickness of the top coating at material coordinates."""
    top, below = (made.sheet.at(face, u, v) for face in made.sheet.faces[:2])
    return top - below


def lay(made: Specimen, sheet: Sheet, uv: Array, model: str, noise: Array) -> Laid:
    """Lay the coating onto the image, registered by the holes that the field shows.

    Its nodes lie at ``uv``.
    """
    holes = made.sheet.holes
    place = made.warp.points(holes[:, 0], holes[:, 1])[:, :2]
    shown = ((place > AWAY_UM) & (place < np.array(made.extent_um[:2]) - AWAY_UM)).all(axis=1)
    at = (place[shown] / NODES_UM).T[::-1]
    moving = np.stack([ndimage.map_coordinates(uv[..., k], at, order=1) for k in (0, 1)], axis=1)
    fit = fit_transform(
        moving + noise[: len(moving)], made.pose(holes[shown]), model=model, robust=False
    )
    nodes, places = Mesh.of(fit(uv.reshape(-1, 2)).reshape(uv.shape), least_um=NODES_UM / 2).under(
        Grid.of(made.image)
    )
    return Laid(resample(sheet.coating[nodes], places), fit.rms_um)


def gains(maps: dict[str, Array], image: Array, pixel_um: tuple[float, float]) -> str:
    """By how much r of the flattened map is larger, with its interval."""
    factor = (POINT_UM / pixel_um[0], POINT_UM / pixel_um[1])
    *projections, flattened, grey = (area_mean(m, factor) for m in (*maps.values(), image))
    found = [
        paired_difference((one, grey), (flattened, grey), pixel_um=POINT_UM) for one in projections
    ]
    return "; ".join(
        f"r {d.difference:+.3f} (95 % interval {d.interval[0]:+.3f} to {d.interval[1]:+.3f})"
        for d in found
    )


def draw(sheet: Sheet, r2: dict[str, float], picture: Path) -> None:
    """The height of the sheet, and r² by registration."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(9, 4), layout="constrained", width_ratios=(1.4, 1)
    )
    height, width = (n * NODES_UM / 1e3 for n in sheet.u.shape)
    shown = left.imshow(
        sheet.points[..., 2], extent=(0, width, height, 0), cmap="cividis", interpolation="none"
    )
    figure.colorbar(shown, ax=left, label="height / µm", shrink=0.8)
    left.set(title="Centre surface", xlabel="x / mm", ylabel="y / mm")
    bars = right.bar(
        range(len(r2)), list(r2.values()), tick_label=[k.replace(", ", ",\n") for k in r2]
    )
    right.bar_label(bars, fmt="%.3f")
    right.set(title="Coating and brightness", ylabel=f"r² at {POINT_UM:.0f} µm")
    figure.savefig(picture, dpi=100, metadata={"Software": None})
    plt.close(figure)


def peak_gb() -> float:
    """Largest memory that the process has used; Linux counts in KiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
