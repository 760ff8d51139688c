"""The acceptance specimen through the files and the whole line, five seeds: every error against the truth.

``python -m benchmarks acceptance [seeds]``
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import fields
from pathlib import Path

from benchmarks.ledger import Ledger, ledger
from planish.pipeline import run_study
from planish.study import ImageSection, Study, VolumeSection
from planish.synthetic import SpecimenParams, make_specimen, write_specimen

LIMITS = {
    "position_median": 0.6,
    "position_p95": 2.0,
    "coating_bias": 0.3,
    "coating_rmse": 1.0,
    "base_bias": 0.6,
}
R2_LIMIT = 0.02


def one(seed: int) -> tuple[Ledger, float]:
    """Make specimen ``seed``, link it through its files, and return its ledger and the seconds that the link took."""
    specimen = make_specimen(SpecimenParams(seed=seed))
    with tempfile.TemporaryDirectory() as folder:
        volume, image = write_specimen(specimen, Path(folder) / "specimen")
        study = Study(volume=VolumeSection(path=str(volume)), image=ImageSection(path=str(image)))
        start = time.perf_counter()
        run = run_study(study, Path(folder) / "run")
        return ledger(specimen, run), time.perf_counter() - start


def faults(entry: Ledger) -> list[str]:
    """Name the limits that a run missed."""
    missed = [
        f"{name} {getattr(entry, name):.3f} > {limit}"
        for name, limit in LIMITS.items()
        if abs(getattr(entry, name)) > limit
    ]
    if entry.found != entry.holes or entry.false:
        missed.append(f"{entry.found} of {entry.holes} holes, {entry.false} false")
    if abs(entry.r2 - entry.r2_true) > R2_LIMIT:
        missed.append(f"r2 {entry.r2:.3f} against {entry.r2_true:.3f}")
    if max(entry.r2_projection, entry.r2_projection_fixed) > 0.7 * entry.r2:
        missed.append("the projection is not clearly worse")
    return missed


def main(seeds: int = 5) -> int:
    """Print a line a seed; return the number of runs that missed a limit."""
    names = [f.name for f in fields(Ledger)]
    print("specimen 3 x 2 mm, voxel 3 um, blur 2.5 um, noise 4 %, slope 0.5; lengths in um")
    print("seed " + " ".join(f"{n[:14]:>14s}" for n in names) + "   link s")
    failed = 0
    for seed in range(seeds):
        entry, seconds = one(seed)
        print(f"{seed:4d} " + " ".join(f"{getattr(entry, n):14.3f}" for n in names) + f" {seconds:8.1f}", flush=True)
        for fault in faults(entry):
            print(f"     missed: {fault}")
        failed += bool(faults(entry))
    return failed
