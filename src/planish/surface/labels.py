"""Faces in the volume of labels of another program, which has separated air, base and coating."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.core.tiles import Engine, Tile
from planish.core.typing import Floats
from planish.surface.assemble import assemble
from planish.surface.columns import Columns, Guide, join_tiles, make_guide
from planish.surface.faces import faces_from_depths
from planish.surface.params import LabelParams, SurfaceParams
from planish.surface.regions import doubtful
from planish.surface.slices import first_where
from planish.surface.survey import survey_labels

_CODES = {"air": 0, "base": 1, "void": 2, "coating": 3}
_UNKNOWN = 255
_COATED_SHARE = 0.02  # of the columns; below it a side has no coating


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelColumns(Columns):
    """Columns of labels: codes of air, base, void and coating, or 1 where there is any sheet."""

    codes: tuple[tuple[int, int], ...] = ()  # (label, code)
    sheet: bool = True  # give 1 for all that is not air

    def voxels(self, tile: Tile, depth: slice = slice(None)) -> NDArray[Any]:
        """Codes of the voxels of a tile, or of a part of their depth."""
        # Slots leave a dataclass without its class cell, so super() needs it.
        raw = super(LabelColumns, self).voxels(tile, depth)
        out = np.full(raw.shape, _UNKNOWN, dtype=np.uint8)
        for label, code in self.codes:
            out[raw == label] = code
        if (out == _UNKNOWN).any():
            label = raw[out == _UNKNOWN].flat[0]
            raise VolumeError(
                f"The volume holds the label {label}, and its meaning is not given. Say which labels are air, "
                "base, coating and void with --label-air, --label-base, --label-coating and --label-void."
            )
        return (out > 0).astype(np.uint8) if self.sheet else out


def surfaces_from_labels(
    labels: xr.DataArray, frame: Frame, meaning: LabelParams, params: SurfaceParams, engine: Engine
) -> xr.Dataset:
    """Find the surfaces in labels: a boundary lies half way between the voxels, there are no grey levels."""
    if not np.issubdtype(labels.dtype, np.integer) and labels.dtype != np.bool_:
        raise VolumeError(
            f"Labels are integers; this volume holds {labels.dtype}. Give the label volume, not the grey."
        )
    columns = LabelColumns(volume=labels, frame=frame, codes=_codes(meaning))
    coarse, empty_share = survey_labels(columns, params, engine)
    guide = make_guide(coarse, columns)
    coded = LabelColumns(volume=labels, frame=frame, codes=columns.codes, sheet=False)
    reach = 2.0 + 1.5 * coarse.block * max(columns.pitch[:2]) / columns.pitch[2]
    parts = engine.map("labels", _boundaries, lambda tile: (coded, guide.part(tile), reach), columns.tiles(engine))
    depths = join_tiles(parts, np.empty((4, *columns.shape[:2])))
    share = [float(np.mean(thickness[np.isfinite(thickness)] > 0)) if np.isfinite(thickness).any() else 0.0
             for thickness in (depths[1], depths[3])]  # fmt: skip
    coated = share[0] > _COATED_SHARE, share[1] > _COATED_SHARE
    surfaces = assemble(
        columns, params, faces_from_depths(depths, columns, coated, particles=coarse.specks),
        doubtful(guide, coarse, 0.0, columns.shape[2]), (0.0, 1.0), engine,
    )  # fmt: skip
    surfaces.attrs["empty_share"] = empty_share
    surfaces.attrs["from_labels"] = " ".join(f"{label}:{code}" for label, code in columns.codes)
    return surfaces


def _codes(meaning: LabelParams) -> tuple[tuple[int, int], ...]:
    codes: dict[int, int] = {}
    for name, code in _CODES.items():
        for label in getattr(meaning, name):
            if codes.setdefault(int(label), code) != code:
                raise VolumeError(
                    f"The label {label} was given two meanings, one of them {name}. Give each label once."
                )
    return tuple(sorted(codes.items()))


def _boundaries(job: tuple[LabelColumns, Guide, float], tile: Tile) -> Floats:
    """Depth of the face and thickness of the coating from the high end, then from the low end, (4, rows, cols)."""
    columns, guide, reach = job
    codes = columns.voxels(tile)
    out = np.full((4, *tile.shape), np.nan)
    last = codes.shape[2] - 1
    for k, high in enumerate((True, False)):
        outer, other = guide.faces(last + 1, high=high)
        is_seen = np.isfinite(outer) & np.isfinite(other)
        middle, start = (np.where(is_seen, a, -1.0) for a in (0.5 * (outer + other), outer - reach / guide.tilt))
        part = codes[:, :, ::-1] if high else codes
        # The outermost boundary of base or coating, and the outermost run of coating.
        face = first_where((part == _CODES["base"]) | (part == _CODES["coating"]), np.floor(start))
        end = first_where(part != _CODES["coating"], face)
        is_boundary = is_seen & (face > 0) & (face <= np.minimum(middle.astype(int), last - 1))
        out[2 * k][is_boundary], out[2 * k + 1][is_boundary] = face[is_boundary] - 0.5, (end - face)[is_boundary]
    return out
