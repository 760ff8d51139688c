"""Measured data: the dots of a calibration target, found as laser holes are.

The folder ``dot_patterns`` is looked for in PLANISH_DATA or ../shared/data (Diamond Light Source,
discorpy,
Apache-2.0 licence).
``python examples/13_dot_pattern.py [FOLDER]`` writes ``13_dot_pattern.png``.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from planish.marks import find_holes

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)
data = Path(os.environ.get("PLANISH_DATA") or "../shared/data") / "dot_patterns"

image = np.asarray(Image.open(data / "dot_pattern_02.jpg").convert("L"), dtype=np.float32)
# The size is assumed: dots of 16 pixels are then 160 um wide.
dots = find_holes(image, pixel_um=10.0)
error = np.sqrt((dots.cov_xx + dots.cov_yy).values / 2) / 10.0
print(f"{dots.sizes['mark']} dots, each centre to {np.median(error):.2f} pixels an axis")

figure, axes = plt.subplots(1, 2, figsize=(10, 4.5), layout="constrained")
for ax in axes:
    ax.imshow(image, cmap="gray")
    ax.plot(dots.x / 10.0, dots.y / 10.0, "+", color="C1", markersize=4 if ax is axes[0] else 12)
axes[0].set(title=f"{dots.sizes['mark']} dots", xlabel="x / pixel", ylabel="y / pixel")
middle = image.shape[1] // 2, image.shape[0] // 2
axes[1].set(
    title="The middle",
    xlim=(middle[0] - 100, middle[0] + 100),
    ylim=(middle[1] + 100, middle[1] - 100),
    xlabel="x / pixel",
)
figure.savefig(out / "13_dot_pattern.png", dpi=100)
