"""What a series will take, from the sizes of its files and from what is done of it."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median

from planish.compute import Compute
from planish.core.errors import PlanishError
from planish.core.memory import PROGRAM_BYTES, bytes_to_hold
from planish.io.info import describe
from planish.series.jobs import Book, Job
from planish.series.plan import Specimen

# Measured on two cores: links of 11 to 160 million voxels to .2 to 160 million pixels.
_START_S, _PER_VOXEL_S, _PER_PIXEL_S = 4.0, 0.2e-6, 2.5e-6
_PER_COLUMN, _PER_PIXEL = 150, 110  # bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """What one specimen will take; None where there is nothing to do."""

    words: str
    seconds: float | None = None
    memory_bytes: float = 0.0
    disk_bytes: float = 0.0


def estimate(book: Book, specimen: Specimen, compute: Compute) -> Estimate:
    """Say what a specimen will take, or why nothing is to be done; nothing is written."""
    found = book.look(specimen, compute)
    if not isinstance(found, Job):
        return Estimate(words="kept" if found.run is not None else f"{found.state}: {found.message}")
    voxels = pixels = columns = 0.0
    held = 0.0
    try:
        for layer in found.study.layers:
            if layer.kind == "run":
                continue
            facts = describe(layer.path, values=False)
            size = 1.0
            for n in facts["shape"]:
                size *= n
            if layer.kind == "image":
                pixels += size
            else:
                voxels, columns = voxels + size, columns + size ** (2 / 3)
                held = max(held, bytes_to_hold(facts["bytes"]))
    except PlanishError as error:
        return Estimate(words=f"refused: {error.text}")
    seconds = _START_S + _PER_VOXEL_S * voxels + _PER_PIXEL_S * pixels
    known = book.seconds()
    return Estimate(
        words="to do", seconds=seconds if len(known) < 3 else max(median(known), 0.0),
        memory_bytes=PROGRAM_BYTES + min(compute.for_work, held + _PER_PIXEL * pixels),
        disk_bytes=_PER_COLUMN * columns + _PER_PIXEL * pixels,
    )  # fmt: skip
