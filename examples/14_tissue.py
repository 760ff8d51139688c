"""Measured data: the surface of a tissue, flattened with less strain than by its authors' map.

The folder ``tissue_sheet_mesh`` is looked for in PLANISH_DATA or ../shared/data (nikolas-claussen,
blender-tissue-cartography, Apache-2.0 licence).
``python examples/14_tissue.py [FOLDER]`` writes ``14_tissue.png``.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tifffile

from planish.flatten import edge_strain, relax_grid

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)
data = Path(os.environ.get("PLANISH_DATA") or "../shared/data") / "tissue_sheet_mesh"

# A grid (rows, cols) of points (x, y, z) in um: equal steps along it are the map of its authors.
points = np.moveaxis(
    tifffile.imread(data / "basics_example_3d_coordinates.tif").astype(float), 0, -1
)
steps = [np.linalg.norm(np.diff(points, axis=axis), axis=-1) for axis in (0, 1)]
typical = float(np.nanmedian(steps[1]))
doubted = np.zeros(points.shape[:2], dtype=bool)
# Around one defect the steps are far off: these nodes carry no weight.
for axis, step in enumerate(steps):
    low, high = (np.moveaxis(doubted, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
    off = np.moveaxis(np.abs(step / typical - 1) > 0.3, axis, 0)
    low |= off
    high |= off
relaxed = relax_grid(points, weights=np.where(doubted, 0.0, 1.0))

rows, cols = np.mgrid[: points.shape[0], : points.shape[1]]
maps = {"authors": np.stack([cols, rows], axis=-1) * typical, "planish": relaxed.uv}
sure = np.where(doubted[..., None], np.nan, points)
figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
shown = axes[0].imshow(points[..., 2] - np.nanmean(points[..., 2]), cmap="cividis")
figure.colorbar(shown, ax=axes[0], label="Height / µm")
axes[0].set(title="Height of the tissue", xlabel="column of the grid", ylabel="row of the grid")
for name, uv in maps.items():
    strain = np.concatenate([edge[np.isfinite(edge)] for edge in edge_strain(sure, uv)])
    strain = 100 * ((1 + strain) / np.median(1 + strain) - 1)
    print(f"{name}: strain of the springs {np.sqrt(np.mean(strain**2)):.2f} % rms")
    axes[1].hist(strain, bins=np.linspace(-4, 4, 161), histtype="step", label=name)
axes[1].set(title="Strain of the springs", xlabel="strain / %", ylabel="springs")
axes[1].legend()
figure.savefig(out / "14_tissue.png", dpi=100)
