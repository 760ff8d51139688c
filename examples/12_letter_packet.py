"""Measured data: a folded letter in the X-ray scanner; its outer flap found where others put it.

The folder ``letterpacket_ct`` is looked for in PLANISH_DATA or ../shared/data (UnlockingHistory,
virtual-unfolding,
MIT licence; sizes are in voxels, because none is stated).
``python examples/12_letter_packet.py [FOLDER]`` writes ``12_letter_packet.png``.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import planish as pl
from planish.surface import SurfaceParams

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)
data = Path(os.environ.get("PLANISH_DATA") or "../shared/data") / "letterpacket_ct"

volume = pl.read_volume(data / "volume_zyx_uint8.tif", voxel_um=(1.0, 1.0, 1.0))
with np.load(data / "reference_midsurface.npz") as reference:
    points = reference["points_xyz_voxel"][reference["mesh_number"] == 0]

# Several sheets lie behind each other: a point in the one that is meant, and a part of the volume
# where it lies once.
flap = volume.isel(y=slice(30, 58), x=slice(0, 30))
surfaces = pl.find_surfaces(
    flap,
    frame=pl.Frame(through="y"),
    params=SurfaceParams(seed_um=(30.0, 46.0, 3.0), cutoff_um=12.0, rim_um=2.0),
)
print(
    f"paper: {surfaces.attrs['thickness_um']:.2f} voxels thick at half height; by its authors 2.95"
)

row = 30
figure, ax = plt.subplots(figsize=(7, 5), layout="constrained")
ax.imshow(volume.isel(z=row), cmap="gray")
for face, colour in (("top", "C1"), ("bottom", "C1"), ("centre", "C0")):
    ax.plot(surfaces.x, surfaces[face].sel(y=row), color=colour, linewidth=1.5)
here = points[np.abs(points[:, 2] - row) < 0.5]
ax.plot(here[:, 0], here[:, 1], ".", color="C2", markersize=4)
ax.set(
    title="Faces (orange), centre surface (blue), points of the authors (green)",
    xlabel="x / voxel",
    ylabel="y / voxel",
)
figure.savefig(out / "12_letter_packet.png", dpi=100)
