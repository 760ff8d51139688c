"""Faces at boundaries: slice by slice as Hirn et al.

(2009) found them, or between the labels of another program.

A slice is a row of the maps, its thresholds separate the classes of grey best (Otsu): air, paper
and, where there is one, coating. A coating thinner than the blur comes out as thick as the blur;
that is how it was.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.core.robust import otsu_borders
from planish.core.tiles import Engine, Tile, tiles_of
from planish.core.typing import Floats, Pair
from planish.surface.assemble import assemble
from planish.surface.columns import Columns, Guide, Priors, join_tiles, make_guide, oriented
from planish.surface.faces import Faces, FitJob, crossing, faces_from_depths, first_where
from planish.surface.params import LabelParams, SurfaceParams
from planish.surface.regions import doubtful
from planish.surface.survey import survey_labels

_BINS = 128


def find_faces_by_slice(
    columns: Columns, guide: Guide, priors: Priors, engine: Engine, particles: int
) -> Faces:
    """Find the faces and interfaces of every column with its slice's own thresholds.

    ``particles`` float in the air.
    """
    rows, cols, depth = columns.shape
    # Whole rows: a threshold belongs to a slice. A voxel of a slab takes 16 bytes.
    rows_per_tile = max(
        int(engine.memory_bytes / (engine.at_once + 1) / (cols * columns.step**2 * depth * 16)), 1
    )

    def job(tile: Tile) -> FitJob:
        return columns, guide.part(priors.scale.grown(tile, (rows, cols))), priors, None

    depths_by_tile = engine.map(
        "slices", _fit_slices, job, tiles_of((rows, cols), (rows_per_tile, cols))
    )
    depths = join_tiles(depths_by_tile, np.empty((4, rows, cols)))
    return faces_from_depths(depths, columns, priors.coated, particles=particles)


def _fit_slices(job: FitJob, tile: Tile) -> Floats:
    """Give the depth of the face and the thickness of the coating, (4, rows, cols).

    They are from the high end, then from the low end.
    """
    columns, guide, priors, _ = job
    grey, guide = oriented(columns, tile, guide, priors.scale)
    margin_px = 20.0 / columns.pitch[2]  # of air beside the sheet that counts in the histogram
    depths = np.full((4, *tile.shape), np.nan)
    search_px = priors.search_px / guide.cos_tilt
    depth_index = np.arange(grey.shape[2])
    for i, row_grey in enumerate(grey):
        low_face, high_face = guide.low[i][:, None], guide.high[i][:, None]
        with np.errstate(invalid="ignore"):
            is_near = (depth_index >= low_face - margin_px) & (depth_index <= high_face + margin_px)
        near_grey = row_grey[is_near & np.isfinite(row_grey)]
        if near_grey.size < 100:
            continue
        paper_level, coating_level = otsu(
            near_grey.astype(np.float64), 3 if any(priors.coated) else 2
        )
        for k, from_high in enumerate((True, False)):
            profiles = (row_grey[:, ::-1] if from_high else row_grey).astype(np.float64)
            outer, opposite = (a[i] for a in guide.faces(grey.shape[2], from_high=from_high))
            thresholds = paper_level, coating_level if priors.sides[from_high].coated else np.inf
            depths[2 * k : 2 * k + 2, i] = _outer_boundaries(
                profiles, outer, opposite, outer - search_px[i], *thresholds
            )
    return depths


def _outer_boundaries(
    grey: Floats, expected: Floats, opposite: Floats, start: Floats, paper: float, coating: float
) -> tuple[Floats, Floats]:
    """Outermost boundary of the sheet, and thickness of the outermost run of coating, (cols,).

    NaN for none.
    """
    # The grey (cols, depth) is read from outside to inside; this face and the opposite one should
    # lie where expected and other say. Paper and coating are thresholds; that of a side without a
    # coating is infinite.
    cols, depth = grey.shape
    is_expected = np.isfinite(expected) & np.isfinite(opposite)
    middle = np.where(is_expected, 0.5 * (expected + opposite), -1.0).astype(int)
    is_above, is_bright = grey > paper, grey > coating
    is_clear = 0.25 * grey[:, :-2] + 0.5 * grey[:, 1:-1] + 0.25 * grey[:, 2:] > paper
    is_entered = np.zeros(grey.shape, dtype=bool)
    is_entered[:, 1:-2] = is_clear[:, :-1] & is_clear[:, 1:]
    d = first_where(
        is_entered & (np.arange(depth) <= middle[:, None]), np.maximum(np.floor(start), 1)
    )
    has_face = d < depth
    # The smoothed grey passes up to a voxel beside the grey itself.
    is_outside = ~is_above & (np.arange(depth) < d[:, None])
    d = np.where(is_outside.any(axis=1), depth - is_outside[:, ::-1].argmax(axis=1), 1)
    d = np.minimum(first_where(is_above, d), depth - 2)
    face = d - 1 + crossing(grey, d - 1, paper)
    first = np.minimum(first_where(is_bright, d), np.maximum(np.minimum(middle, d + 4), d))
    last = np.minimum(
        first_where(~is_bright, first) - 1, np.maximum(np.minimum(middle, depth - 2), first)
    )
    is_coated = is_bright[np.arange(cols), first]
    thickness = np.where(
        is_coated, np.maximum(last + crossing(grey, last, coating) - face, 0.0), 0.0
    )
    return np.where(has_face, face, np.nan), np.where(has_face, thickness, np.nan)


def otsu(grey: Floats, classes: int) -> Pair:
    """Thresholds that separate two or three classes of grey best; the second is infinite for two.

    The variance between the classes is largest there.
    """
    low, high = np.percentile(grey, [0.1, 99.9])
    if not high > low:
        return float(low), float("inf")
    counts, edges = np.histogram(
        np.clip(grey, low, high), bins=_BINS, range=(float(low), float(high))
    )
    middle = 0.5 * (edges[1:] + edges[:-1])
    cumulative_share = np.concatenate([[0.0], np.cumsum(counts / counts.sum())])
    cumulative_mean = np.concatenate([[0.0], np.cumsum(middle * counts / counts.sum())])
    thresholds = [float(edges[k]) for k in otsu_borders(cumulative_share, cumulative_mean, classes)]
    return thresholds[0], thresholds[1] if classes == 3 else float("inf")


_CODES = {"air": 0, "base": 1, "void": 2, "coating": 3}
_UNKNOWN = 255


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelColumns(Columns):
    """Columns of labels: codes of air, base, void and coating, or 1 where there is any sheet."""

    codes: dict[int, int]  # by label
    sheet: bool = True  # give 1 for all that is not air

    def voxels(self, tile: Tile, depth: slice = slice(None)) -> NDArray[Any]:
        """Codes of the voxels of a tile, or of a part of their depth."""
        # Slots leave a dataclass without its class cell, so super() needs it.
        raw = super(LabelColumns, self).voxels(tile, depth)
        out = np.full(raw.shape, _UNKNOWN, dtype=np.uint8)
        for label, code in self.codes.items():
            out[raw == label] = code
        if (out == _UNKNOWN).any():
            raise VolumeError(
                f"The volume holds the label {raw[out == _UNKNOWN].flat[0]}, and its meaning is not"
                " given. Give it with `label_air`, `label_base`, `label_coating` or `label_void`."
            )
        return (out > 0).astype(np.uint8) if self.sheet else out


def surfaces_from_labels(
    labels: xr.DataArray, frame: Frame, meaning: LabelParams, params: SurfaceParams, engine: Engine
) -> xr.Dataset:
    """Find the surfaces in labels.

    A boundary lies half way between the voxels; there are no grey levels.
    """
    if not np.issubdtype(labels.dtype, np.integer) and labels.dtype != np.bool_:
        raise VolumeError(
            f"Labels are integers; this volume holds {labels.dtype}. Give the label volume, not the"
            " grey."
        )
    code_of_label: dict[int, int] = {}
    for material, code in _CODES.items():
        for label in getattr(meaning, material):
            if code_of_label.setdefault(int(label), code) != code:
                raise VolumeError(
                    f"The label {label} was given two meanings, one of them {material}. Give each"
                    " label once."
                )
    columns = LabelColumns(volume=labels, frame=frame, codes=dict(sorted(code_of_label.items())))
    coarse, empty_share = survey_labels(columns, params, engine)
    guide, coded = make_guide(coarse, columns), replace(columns, sheet=False)
    search_px = 2.0 + 1.5 * coarse.block * max(columns.pitch[:2]) / columns.pitch[2]
    by_tile = engine.map(
        "labels", _boundaries, lambda t: (coded, guide.part(t), search_px), columns.tiles(engine)
    )
    depths = join_tiles(by_tile, np.empty((4, *columns.shape[:2])))
    # A side with a coating in fewer than 2 % of its columns has none.
    is_coated = [thickness[np.isfinite(thickness)] > 0 for thickness in depths[1::2]]
    high_coated, low_coated = (bool(mask.size and mask.mean() > 0.02) for mask in is_coated)
    surfaces = assemble(
        columns,
        params,
        faces_from_depths(depths, columns, (high_coated, low_coated), particles=coarse.specks),
        doubtful(guide, coarse, 0.0, columns.shape[2]),
        (0.0, 1.0),
        engine,
    )
    codes_text = " ".join(f"{label}:{code}" for label, code in columns.codes.items())
    return surfaces.assign_attrs(empty_share=empty_share, from_labels=codes_text)


def _boundaries(job: tuple[LabelColumns, Guide, float], tile: Tile) -> Floats:
    """Give the depth of the face and the thickness of the coating, (4, rows, cols).

    They are from the high end, then from the low end.
    """
    columns, guide, search_px = job
    codes = columns.voxels(tile)
    depths = np.full((4, *tile.shape), np.nan)
    last_index = codes.shape[2] - 1
    for k, from_high in enumerate((True, False)):
        outer, opposite = guide.faces(last_index + 1, from_high=from_high)
        has_sheet = np.isfinite(outer) & np.isfinite(opposite)
        middle = np.where(has_sheet, 0.5 * (outer + opposite), -1.0)
        start = np.where(has_sheet, outer - search_px / guide.cos_tilt, -1.0)
        codes_inward = codes[:, :, ::-1] if from_high else codes
        # The outermost boundary of base or coating, and the outermost run of coating.
        is_coating = codes_inward == _CODES["coating"]
        face = first_where(is_coating | (codes_inward == _CODES["base"]), np.floor(start))
        coating_end = first_where(~is_coating, face)
        is_boundary = (
            has_sheet & (face > 0) & (face <= np.minimum(middle.astype(int), last_index - 1))
        )
        depths[2 * k : 2 * k + 2] = np.where(is_boundary, [face - 0.5, coating_end - face], np.nan)
    return depths
