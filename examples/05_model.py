"""Choose the registration model.

The residuals always fall with more parameters, but the leave-one-out error does not.

Fits every model to the same marks and compares the residuals, the leave-one-out error, the expected
error and, because the data are synthetic, the true error. ``python examples/05_model.py [FOLDER]``
writes ``05_model.png``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from planish.core.transform import Affine
from planish.register import fit_transform

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)

# Twelve marks in a field of 8 x 6 mm. The sheet is 0.3 % longer in x: paper that took up water.
# Each mark is found to 1.5 um (standard deviation in x and in y).
rng = np.random.default_rng(1)
truth = Affine(
    linear=((1.003, -0.05), (0.05, 1.0)), source=(4000.0, 3000.0), target=(5000.0, 2000.0)
)
moving = rng.uniform((0, 0), (8000, 6000), (12, 2))
fixed = truth(moving) + rng.normal(0, 1.5, moving.shape)
points = np.stack(
    np.meshgrid(np.linspace(500, 7500, 60), np.linspace(500, 5500, 45)), axis=-1
).reshape(-1, 2)

names = ("rigid", "similarity", "affine", "projective", "tps", "averaged")
rows = []
for name in names:
    fit = fit_transform(moving, fixed, model=name)
    true = np.hypot(*(fit(points) - truth(points)).T)
    rows.append(
        (
            fit.rms_um,
            fit.leave_one_out_rms_um,
            np.sqrt(np.mean(fit.expected_error_um(points) ** 2)),
            np.sqrt(np.mean(true**2)),
        )
    )
    print(
        f"{name:11s} residuals {rows[-1][0]:5.2f}, left out {rows[-1][1]:5.2f}, "
        f"expected {rows[-1][2]:5.2f}, true {rows[-1][3]:5.2f} um"
    )

# "auto" weighs them, as `planish link` does where --model is not given.
print(fit_transform(moving, fixed, model="auto").sentence)

figure, ax = plt.subplots(figsize=(8, 4), layout="constrained")
labels = ("residuals", "leave-one-out error", "expected error", "true error")
for k, (values, label) in enumerate(zip(np.array(rows).T, labels, strict=True)):
    ax.bar(np.arange(len(names)) + 0.2 * (k - 1.5), values, 0.2, label=label)
ax.set_xticks(range(len(names)), names)
ax.set_ylabel("rms / um")
ax.legend()
figure.savefig(out / "05_model.png", dpi=100)
