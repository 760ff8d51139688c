"""Flatten a surface that is not paper: a rolled-up foil, and a dome that cannot be flat.

``python examples/10_other_surface.py [FOLDER]`` writes ``10_other_surface.png``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from planish.flatten import curvature_check, measure_distortion, relax_grid

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)

# A spiral of two and a half turns: neighbours in the grid are neighbours in the foil, nothing else
# is asked for. It overhangs, so no projection can flatten it.
angle, along = np.meshgrid(np.linspace(0, 5 * np.pi, 400), np.linspace(0, 3000, 60))
radius = 400.0 + 40.0 * angle
foil = np.stack([radius * np.cos(angle), along, radius * np.sin(angle)], axis=-1)
flat = relax_grid(foil)

# Its length is known: the integral of sqrt(r^2 + r'^2).
t = np.linspace(0, 5 * np.pi, 200001)
speed = np.hypot(400.0 + 40.0 * t, 40.0)
length = float(np.sum((speed[1:] + speed[:-1]) / 2 * np.diff(t)))
extent = np.linalg.norm(flat.uv[:, -1] - flat.uv[:, 0], axis=-1).mean()
print(f"foil: {extent:.2f} um long when flat, {length:.2f} um by its formula; {flat.outcome.value}")

# A dome is no sheet of paper: flattening strains it, and the Gaussian curvature says so beforehand.
x, y = np.meshgrid(np.linspace(-1000, 1000, 81), np.linspace(-1000, 1000, 81))
dome = np.stack([x, y, np.sqrt(2000.0**2 - x**2 - y**2)], axis=-1)
uv = relax_grid(dome).uv
strain = measure_distortion(dome, uv, rng=np.random.default_rng(0))
print(
    f"dome: area strain {100 * strain.area.p95_abs:.1f} % (95 % of its cells below);"
    f" {curvature_check(dome).verdict}"
)

figure = plt.figure(figsize=(11, 4), layout="constrained")
ax = figure.add_subplot(1, 3, 1, projection="3d")
ax.plot_surface(*np.moveaxis(foil[::6, ::6], -1, 0), cmap="viridis")
ax.set_title("Foil")
ax = figure.add_subplot(1, 3, 2)
ax.scatter(*flat.uv[::3, ::3].reshape(-1, 2).T, c=angle[::3, ::3].ravel(), s=2)
ax.set(title="Foil, flat", aspect="equal", xlabel="u / um", ylabel="v / um")
ax = figure.add_subplot(1, 3, 3)
area = np.linalg.norm(
    np.cross(dome[1:, :-1] - dome[:-1, :-1], dome[:-1, 1:] - dome[:-1, :-1]), axis=-1
)
du, dv = uv[:-1, 1:] - uv[:-1, :-1], uv[1:, :-1] - uv[:-1, :-1]
picture = ax.pcolormesh(
    *np.moveaxis(uv, -1, 0), np.abs(du[..., 0] * dv[..., 1] - du[..., 1] * dv[..., 0]) / area - 1
)
figure.colorbar(picture, ax=ax, label="area strain")
ax.set(title="Dome, flat", aspect="equal")
figure.savefig(out / "10_other_surface.png", dpi=100)
