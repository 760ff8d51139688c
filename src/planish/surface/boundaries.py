"""Faces at boundaries: slice by slice as Hirn et al.

(2009) found them, or between the labels of another program.

A slice is a row of the maps, its thresholds separate the classes of grey best (Otsu): air, paper
and, where there is one, coating. A coating thinner than the blur comes out as thick as the blur;
that is how it was.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import xarray as xr

from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.core.grid import at_index
from planish.core.robust import otsu_borders
from planish.core.tiles import Engine, Tile, tiles_of
from planish.core.typing import Array, Floats, Pair, TwoFields
from planish.surface.assemble import assemble
from planish.surface.columns import Columns, Guide, Priors, join_tiles, make_guide, oriented
from planish.surface.faces import (
    Faces,
    FitJob,
    crossing,
    faces_from_depths,
    first_where,
    fit_job,
)
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
    row_bytes = cols * columns.step**2 * depth * 16
    rows_per_tile = max(int(engine.memory_bytes / (engine.at_once + 1) / row_bytes), 1)
    tiles = tiles_of((rows, cols), (rows_per_tile, cols))
    job = partial(fit_job, columns, guide, priors)
    depths_by_tile = engine.map("slices", _fit_slices, job, tiles)
    depths = join_tiles(depths_by_tile, np.empty((4, rows, cols)))
    return faces_from_depths(depths, columns, priors.coated, particles=particles)


def _fit_slices(job: FitJob, tile: Tile) -> Floats:
    """Give the depth of the face and the thickness of the coating, (4, rows, cols).

    They are from the high end, then from the low end, in voxels; NaN where there is no face. A row
    with too few voxels has none.
    """
    columns, guide, priors, _ = job
    grey, guide = oriented(columns, tile, guide, priors.scale)
    margin_px = 20.0 / columns.pitch[2]  # of air beside the sheet that counts in the histogram
    depths = np.full((4, *tile.shape), np.nan)
    faces_by_end = [guide.faces(grey.shape[2], from_high=from_high) for from_high in (True, False)]
    search_px = priors.search_px / guide.cos_tilt
    depth_index = np.arange(grey.shape[2])
    for i, row_grey in enumerate(grey):
        is_near = depth_index >= guide.low[i][:, None] - margin_px
        is_near &= depth_index <= guide.high[i][:, None] + margin_px
        near_grey = row_grey[is_near & np.isfinite(row_grey)].astype(float)
        if near_grey.size < 100:
            continue
        paper_level, coating_level = otsu(near_grey, 3 if any(priors.coated) else 2)
        profiles = row_grey.astype(float)
        for k, (outer, opposite) in enumerate(faces_by_end):
            inward = profiles[:, ::-1] if k == 0 else profiles
            start = outer[i] - search_px[i]
            levels = paper_level, coating_level if priors.coated[k] else np.inf
            boundaries = _outer_boundaries(inward, outer[i], opposite[i], start, *levels)
            depths[2 * k : 2 * k + 2, i] = boundaries
    return depths


def _outer_boundaries(
    grey: Floats, expected: Floats, opposite: Floats, start: Floats, paper: float, coating: float
) -> TwoFields:
    """Outermost boundary of the sheet, and thickness of the outermost run of coating, (cols,).

    In voxels; NaN for none. The grey (cols, depth) is read from outside to inside; this face and
    the ``opposite`` one should lie where ``expected`` and ``opposite`` say, and this one is
    searched from ``start`` on, (cols,) each in voxels. ``paper`` and ``coating`` are thresholds of
    grey; that of a side without a coating is infinite.
    """
    depth_count = grey.shape[1]
    depth = np.arange(depth_count)
    # The face lies in the outer half of the sheet; nowhere where it is not expected.
    middle = np.nan_to_num(0.5 * (expected + opposite), nan=-1.0).astype(int)
    is_above = grey > paper
    is_bright = grey > coating
    # Entered where the lightly smoothed grey stays above the threshold for two samples.
    outer_and_inner = grey[:, :-2] + grey[:, 2:]
    smoothed = 0.25 * outer_and_inner + 0.5 * grey[:, 1:-1]
    is_clear = smoothed > paper
    is_entered = np.zeros(grey.shape, bool)
    is_entered[:, 1:-2] = is_clear[:, :-1] & is_clear[:, 1:]
    is_entered &= depth <= middle[:, None]
    entry = first_where(is_entered, np.maximum(np.floor(start), 1))
    has_face = entry < depth_count
    # The smoothed grey passes up to a voxel beside the grey itself.
    is_outside = ~is_above & (depth < entry[:, None])
    last_outside = depth_count - 1 - is_outside[:, ::-1].argmax(axis=1)
    start_inside = np.where(is_outside.any(axis=1), last_outside + 1, 1)
    inside = np.minimum(first_where(is_above, start_inside), depth_count - 2)
    face = inside - 1 + crossing(grey, inside - 1, paper)
    # Coating begins within four samples of the face, and ends in the outer half.
    first_limit = np.maximum(np.minimum(middle, inside + 4), inside)
    first = np.minimum(first_where(is_bright, inside), first_limit)
    last_limit = np.maximum(np.minimum(middle, depth_count - 2), first)
    last = np.minimum(first_where(~is_bright, first) - 1, last_limit)
    thickness = np.maximum(last + crossing(grey, last, coating) - face, 0.0)
    thickness = np.where(at_index(is_bright, first), thickness, 0.0)
    return np.where(has_face, face, np.nan), np.where(has_face, thickness, np.nan)


def otsu(grey: Floats, classes: int) -> Pair:
    """Thresholds that separate two or three classes of grey best; the second is infinite for two.

    The variance between the classes is largest there. ``grey`` (n,) is cut at its outermost
    thousandths first; where that leaves one value both classes begin there.
    """
    low, high = np.percentile(grey, [0.1, 99.9]).tolist()
    if not high > low:
        return low, float("inf")
    usual_grey = np.clip(grey, low, high)
    counts, edges = np.histogram(usual_grey, bins=_BINS, range=(low, high))
    shares = counts / counts.sum()
    middle = 0.5 * (edges[1:] + edges[:-1])
    greys = middle * counts / counts.sum()
    thresholds = [float(edges[k]) for k in otsu_borders(shares, greys, classes)]
    return thresholds[0], thresholds[1] if classes == 3 else float("inf")


_CODES = {"air": 0, "base": 1, "void": 2, "coating": 3}
_UNKNOWN = 255


@dataclass(frozen=True, kw_only=True)
class LabelColumns(Columns):
    """Columns of labels: codes of air, base, void and coating, or 1 where there is any sheet."""

    codes: dict[int, int]  # by label
    sheet: bool = True  # give 1 for all that is not air

    def voxels(self, tile: Tile, depth: slice = slice(None)) -> Array:
        """Codes of the voxels of a tile, or of a part of their depth."""
        raw = super().voxels(tile, depth)
        codes = np.full(raw.shape, _UNKNOWN, np.uint8)
        for label, code in self.codes.items():
            codes[raw == label] = code
        is_unknown = codes == _UNKNOWN
        if is_unknown.any():
            raise VolumeError(
                f"The volume holds the label {raw[is_unknown].flat[0]}, and its meaning is not"
                " given. Give it with `label_air`, `label_base`, `label_coating` or `label_void`."
            )
        return (codes > 0).astype(np.uint8) if self.sheet else codes


def surfaces_from_labels(
    labels: xr.DataArray, frame: Frame, meaning: LabelParams, params: SurfaceParams, engine: Engine
) -> xr.Dataset:
    """Find the surfaces in labels, by the ``meaning`` of these.

    VolumeError where the labels are no whole numbers, or one of them has two meanings. A boundary
    lies half way between the voxels; there are no grey levels.
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
    guide = make_guide(coarse, columns)
    coded = replace(columns, sheet=False)
    search_px = 2.0 + 1.5 * coarse.block * max(columns.pitch[:2]) / columns.pitch[2]
    tiles = columns.tiles(engine)
    by_tile = engine.map("labels", _boundaries, lambda t: (coded, guide.part(t), search_px), tiles)
    depths = join_tiles(by_tile, np.empty((4, *columns.shape[:2])))
    # A side with a coating in fewer than 2 % of its columns has none.
    n_faces = np.isfinite(depths[1::2]).sum(axis=(1, 2))
    n_coated = (depths[1::2] > 0).sum(axis=(1, 2))
    high_coated, low_coated = (n_coated > 0.02 * n_faces).tolist()
    coated = high_coated, low_coated
    faces = faces_from_depths(depths, columns, coated, particles=coarse.specks)
    doubt = doubtful(guide, coarse, 0.0, columns.shape[2])
    surfaces = assemble(columns, params, faces, doubt, (0.0, 1.0), engine)
    codes_text = " ".join(f"{label}:{code}" for label, code in columns.codes.items())
    return surfaces.assign_attrs(empty_share=empty_share, from_labels=codes_text)


def _boundaries(job: tuple[LabelColumns, Guide, float], tile: Tile) -> Floats:
    """Give the depth of the face and the thickness of the coating, (4, rows, cols).

    They are from the high end, then from the low end, in voxels; NaN where there is no face. The
    face is sought from ``search_px``, the last of the job, outside the place where it is expected.
    """
    columns, guide, search_px = job
    codes = columns.voxels(tile)
    last_index = codes.shape[2] - 1
    depths: list[Floats] = []
    for from_high in (True, False):
        outer, opposite = guide.faces(last_index + 1, from_high=from_high)
        middle = 0.5 * (outer + opposite)
        has_sheet = np.isfinite(middle)
        middle = np.where(has_sheet, middle, -1.0).astype(int)
        start = np.where(has_sheet, outer - search_px / guide.cos_tilt, -1.0)
        codes_inward = codes[:, :, ::-1] if from_high else codes
        # The outermost boundary of base or coating, and the outermost run of coating.
        is_coating = codes_inward == _CODES["coating"]
        face = first_where(is_coating | (codes_inward == _CODES["base"]), np.floor(start))
        thickness = first_where(~is_coating, face) - face
        is_boundary = has_sheet & (face > 0) & (face <= np.minimum(middle, last_index - 1))
        depths += [np.where(is_boundary, field, np.nan) for field in (face - 0.5, thickness)]
    return np.array(depths)
