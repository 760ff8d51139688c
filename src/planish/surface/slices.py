"""Faces as Hirn et al. (2009) found them: slice by slice, thresholds from its histogram, outermost boundaries.

A slice is a row of the maps: for serial sections whose first axis counts the sections, ``--through y`` or ``x`` makes
it one section. Thresholds lie where they separate the classes of grey best (Otsu): air and paper, and, where the volume
has a coating, paper and coating. A coating thinner than the blur comes out as thick as the blur; that is how it was.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.core.tiles import Engine, Tile, tiles_of
from planish.surface import _kernels
from planish.surface.columns import Columns
from planish.surface.faces import Faces, placed
from planish.surface.learnt import Learnt
from planish.surface.oriented import Guide, oriented

Array = NDArray[np.float64]

_BINS = 128
_AIR_UM = 20.0  # of air beside the sheet that counts in the histogram
_BYTES = 16  # that a voxel of a slab takes


@dataclass(frozen=True, slots=True, kw_only=True)
class _Slices:
    columns: Columns
    guide: Guide
    learnt: Learnt


def find_faces_by_slice(columns: Columns, guide: Guide, learnt: Learnt, engine: Engine, particles: int = 0) -> Faces:
    """Find the faces and interfaces of every column with its slice's own thresholds; ``particles`` float in the air."""
    rows, cols, depth = columns.shape
    found = np.empty((4, rows, cols))
    # Whole rows: a threshold belongs to a slice.
    high = max(int(engine.memory_bytes / (engine.at_once + 1) / (cols * columns.step**2 * depth * _BYTES)), 1)

    def job(tile: Tile) -> _Slices:
        return _Slices(columns=columns, guide=guide.part(learnt.scale.grown(tile, (rows, cols))), learnt=learnt)

    for tile, part in engine.map("slices", _fit, job, tiles_of((rows, cols), (high, cols))):
        found[:, tile.rows] = part
    return placed(found, columns, (learnt.high.coated, learnt.low.coated), particles=particles)


def _fit(job: _Slices, tile: Tile) -> Array:
    """Depth of the face and thickness of the coating from the high end, then from the low end, (4, rows, cols)."""
    columns, learnt = job.columns, job.learnt
    grey = oriented(columns, tile, job.guide, learnt.scale)
    guide = job.guide.part(tile.within(learnt.scale.grown(tile, columns.shape[:2])))
    coated = learnt.high.coated or learnt.low.coated
    beside = _AIR_UM / columns.pitch[2]
    out = np.full((4, *tile.shape), np.nan)
    depth = np.arange(grey.shape[2])
    for i in range(tile.shape[0]):
        low, high = guide.low[i][:, None], guide.high[i][:, None]
        with np.errstate(invalid="ignore"):
            near = (depth >= low - beside) & (depth <= high + beside)
        values = grey[i][near & np.isfinite(grey[i])]
        if values.size < 100:
            continue
        paper, coating = otsu(values.astype(np.float64), 3 if coated else 2)
        for k, end in enumerate((True, False)):
            side = learnt.side(high=end)
            column = np.ascontiguousarray(grey[i, :, ::-1] if end else grey[i])
            outer, other = (np.ascontiguousarray(a[i]) for a in guide.faces(grey.shape[2], high=end))
            _kernels.outer_boundaries(
                column, outer, other, learnt.reach / guide.tilt[i], paper, coating if side.coated else np.inf,
                out[2 * k, i], out[2 * k + 1, i],
            )  # fmt: skip
    return out


def otsu(values: Array, classes: int) -> tuple[float, float]:
    """Thresholds that separate two or three classes of grey best; the second is infinite for two.

    The variance between the classes is largest there.
    """
    low, high = np.percentile(values, [0.1, 99.9])
    if not high > low:
        return float(low), float("inf")
    counts, edges = np.histogram(np.clip(values, low, high), bins=_BINS, range=(float(low), float(high)))
    middle = 0.5 * (edges[1:] + edges[:-1])
    weight = np.concatenate([[0.0], np.cumsum(counts / counts.sum())])
    total = np.concatenate([[0.0], np.cumsum(middle * counts / counts.sum())])

    def part(a: NDArray[np.intp], b: NDArray[np.intp]) -> Array:
        w = weight[b] - weight[a]
        t = total[b] - total[a]
        return np.where(w > 0, t * t / np.maximum(w, 1e-300), 0.0)

    cut = np.arange(1, _BINS)
    first, last = np.zeros_like(cut), np.full_like(cut, _BINS)
    if classes == 2:
        best = int(np.argmax(part(first, cut) + part(cut, last)))
        return float(edges[cut[best]]), float("inf")
    a, b = np.meshgrid(cut, cut, indexing="ij")
    between = part(np.zeros_like(a), a) + part(a, b) + part(b, np.full_like(a, _BINS))
    i, j = np.unravel_index(int(np.argmax(np.where(b > a, between, -1.0))), between.shape)
    return float(edges[cut[i]]), float(edges[cut[j]])
