"""Measured data: the height map of an instrument, and its roughness.

Also how much larger its surface is than its outline.

The folder ``heightmaps`` is looked for in PLANISH_DATA or ../shared/data (ContactEngineering,
SurfaceTopography, MIT
licence). ``planish.io.read_topography`` reads the files of the instruments themselves.
``python examples/15_height_map.py [FOLDER]`` writes ``15_height_map.png``.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from planish.flatten import relax_grid
from planish.measure import roughness_numbers, scale_limited

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)
data = Path(os.environ.get("PLANISH_DATA") or "../shared/data") / "heightmaps"

with np.load(data / "matrix-2_txt.npz") as stored:
    height, size = 1e6 * stored["heights_m"], 1e6 * stored["size_xy_m"]
pitch = size / height.shape
x, y = np.meshgrid(
    *(np.arange(n) * p for n, p in zip(height.shape, pitch, strict=True)), indexing="ij"
)
plane = np.linalg.lstsq(np.c_[x.ravel(), y.ravel(), np.ones(x.size)], height.ravel(), rcond=None)[0]
height = height - (plane[0] * x + plane[1] * y + plane[2])

wave = size.min() / 4
limited = scale_limited(
    height, (pitch[0], pitch[1]), s_filter_um=2.5 * pitch.max(), l_filter_um=wave
)
numbers = roughness_numbers(
    limited, (pitch[0], pitch[1]), s_filter_um=2.5 * pitch.max(), l_filter_um=wave
)
print(
    f"Sa {numbers.sa:.3g} um, Sq {numbers.sq:.3g} um between waves of {2.5 * pitch.max():.3g} and"
    f" {wave:.3g} um"
)

flat = relax_grid(np.stack([x, y, height], axis=-1))
spread = np.ptp(flat.uv.reshape(-1, 2), axis=0)
print(
    f"flattened: {spread[0]:.1f} x {spread[1]:.1f} um, its outline measures {np.ptp(x):.1f} x"
    f" {np.ptp(y):.1f} um"
)

figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
for ax, values, title in (
    (axes[0], height, "Height"),
    (axes[1], limited, f"Roughness, Sq {numbers.sq:.3g} µm"),
):
    shown = ax.pcolormesh(x, y, values, cmap="cividis", rasterized=True)
    figure.colorbar(shown, ax=ax, label="µm")
    ax.set(title=title, xlabel="x / µm", ylabel="y / µm", aspect="equal")
figure.savefig(out / "15_height_map.png", dpi=100)
