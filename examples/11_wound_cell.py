"""Measured data: the can wall of a wound lithium cell, mapped along its normals and flattened.

The folder ``battery_sector_right`` is looked for in PLANISH_DATA or ../shared/data (MPJ-Imaging,
battery_xct_workflows, MIT licence; sizes are in voxels, because none is stated).
``python examples/11_wound_cell.py [FOLDER]`` writes ``11_wound_cell.png``.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt

import planish as pl

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)
data = Path(os.environ.get("PLANISH_DATA") or "../shared/data") / "battery_sector_right"

# Layers of electrodes lie behind the wall and are darker: the grey range chooses the wall.
run = pl.map_sheet(
    data,
    volume={"voxel_um": (1.0, 1.0, 1.0), "through": "x"},
    surface={"sheet_grey": (100.0, 255.0)},
)
thickness = run.results.layers[0].sheet.properties["thickness"]
print(f"wall: median {thickness.median:.2f} voxels; 6.6 voxels where another program measured it")

volume, surfaces = pl.read_volume(data, voxel_um=(1.0, 1.0, 1.0)), run.groups["surfaces"]
figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained", width_ratios=(2, 3))
axes[0].imshow(volume.isel(z=30), cmap="gray")
for face in ("top", "bottom"):
    axes[0].plot(surfaces[face].isel(y=30), surfaces.x, color="C1", linewidth=1)
axes[0].set(title="Slice 30 with the faces found", xlabel="x / voxel", ylabel="y / voxel")
run.maps.thickness.plot(
    ax=axes[1], robust=True, yincrease=False, cbar_kwargs={"label": "Thickness / voxel"}
)
axes[1].set(title="The flattened wall", xlabel="u / voxel", ylabel="v / voxel")
figure.savefig(out / "11_wound_cell.png", dpi=100)
