"""Register with points that were clicked in BigWarp (Fiji), instead of laser holes.

``planish link VOLUME IMAGE --marks landmarks.csv`` does the same; the formats are in
docs/marks-files.md. ``python examples/06_marks_from_bigwarp.py [FOLDER]`` writes
``06_marks_from_bigwarp.png``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from planish.marks.exchange import read_any, used_pairs, write_any
from planish.register import fit_transform

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)

# The landmarks as BigWarp exports them: name, active, moving x, moving y, target x, target y. No
# header. The unit is that of the images in Fiji; um where nothing is said. The last point was
# switched off.
rng = np.random.default_rng(4)
moving = rng.uniform(0, 3000, (8, 2))
angle = np.radians(4.0)
turn = 1.002 * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
target = moving @ turn.T + (250.0, -90.0) + rng.normal(0, 3.0, (8, 2))
lines = [
    f'"Pt-{k}","{"false" if k == 7 else "true"}","{a:.3f}","{b:.3f}","{c:.3f}","{d:.3f}"'
    for k, (a, b, c, d) in enumerate(np.hstack([moving, target]))
]

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "landmarks.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    # All marks, used or not; `planish marks convert` does this at the terminal.
    marks = read_any(path)
    # JSON keeps everything that planish knows of marks: covariance, diameter, source, and what was
    # not used.
    write_any(marks, Path(folder) / "marks.json")

pairs = used_pairs(marks)
fit = fit_transform(
    np.stack([pairs.moving_x, pairs.moving_y], axis=1),
    np.stack([pairs.fixed_x, pairs.fixed_y], axis=1),
    model="auto",
)
print(f"{marks.sizes['mark']} marks, {len(fit.moving)} in use")
print(fit.sentence, *fit.warnings)
print(f"rms {fit.rms_um:.2f} um, leave-one-out error {fit.leave_one_out_rms_um:.2f} um")

figure, ax = plt.subplots(figsize=(6, 5), layout="constrained")
ax.plot(*fit.fixed.T, "o", label="target")
ax.quiver(
    *fit.fixed.T,
    *fit.residuals_um.T,
    angles="xy",
    scale_units="xy",
    scale=0.02,
    width=0.004,
    color="C1",
)
ax.set(title="Residuals, 50 times enlarged", xlabel="x / um", ylabel="y / um", aspect="equal")
ax.invert_yaxis()
ax.legend()
figure.savefig(out / "06_marks_from_bigwarp.png", dpi=100)
