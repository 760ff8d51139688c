"""Two instruments and one image: one run with a page to read and hand on.

A scan and another scan of the same sheet are linked onto a micrograph, as ``planish link ct=A
fine=B lm=IMAGE`` does. ``python examples/09_report.py [FOLDER]`` writes ``09_report.png`` and the
run folder ``09_run`` with ``report.html``.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import planish as pl
from planish.synthetic import (
    BurnParams,
    CameraParams,
    ScannerParams,
    SpecimenParams,
    write_instruments,
)

out = Path(sys.argv[1] if len(sys.argv) > 1 else "examples/out")
out.mkdir(parents=True, exist_ok=True)
shutil.rmtree(out / "09_run", ignore_errors=True)


def params(voxel_um: float, noise: float) -> SpecimenParams:
    """The same sheet under two scanners: same seed, same paper."""
    return SpecimenParams(
        size_um=(1300.0, 1000.0),
        holes=BurnParams(pattern="irregular", count=5),
        seed=5,
        scanner=ScannerParams(voxel_um=voxel_um, noise=noise),
        camera=CameraParams(pixel_um=5.0, nuisance_sd=0.004),
    )


with tempfile.TemporaryDirectory() as folder:
    coarse = write_instruments(pl.make_specimen(params(5.0, 0.08)), Path(folder) / "a")
    fine = write_instruments(pl.make_specimen(params(4.0, 0.04)), Path(folder) / "b", image=False)
    # The last layer is the reference: all maps come onto its pixels.
    run = pl.link(
        f"coarse={coarse.volume}", f"fine={fine.volume}", f"lm={coarse.image}", out=out / "09_run"
    )

# Every number is typed: run.results is what results.json holds, and what the page shows.
for layer in run.results.moving:
    found = layer.registration
    print(
        f"{layer.name}: {found.matched} marks, model {found.model}, leave-one-out"
        f" {found.leave_one_out_rms_um:.2f} um"
    )
for row in run.results.correlations:
    if row.point_um == 100.0 and row.a_map == row.b_map == "coating_top":
        print(f"coating, {row.a} and {row.b}, points of {row.point_um:g} um: r = {row.r:.3f}")
print(f"checks: {run.results.state}; open {out / '09_run' / 'report.html'}")

figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for ax, name in zip(axes, ("coarse", "fine"), strict=True):
    maps = run.layers[name]
    maps.coating_top.where(maps.valid).plot(ax=ax, robust=True, yincrease=False)
    ax.set_title(f"{name}: coating, top side")
    ax.set_aspect("equal")
figure.savefig(out / "09_report.png", dpi=100)
