"""The volume as columns through the sheet, read in tiles, and the priors of their fit.

Only here the surface search meets its voxels. For the fit columns are oriented: the air at 0, the
sheet above it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import xarray as xr

from planish.core.facts import SIDES
from planish.core.frame import Axis, Frame
from planish.core.labelled import chunks_of, read_box
from planish.core.tiles import Engine, Tile, tiles_of
from planish.core.typing import Array, Entries, Floats, Pair, Shape2D, Singles, TwoFields
from planish.surface import _kernels
from planish.surface.centre import gaussian_regression
from planish.surface.coarse import CoarseSheet, to_columns

Pitch = tuple[float, float, float]  # of rows, of columns, and along a column, in um
_TILE = 192  # columns along an edge of a tile at most; the memory decides below that


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Columns of a volume, each ``step`` x ``step`` voxels wide."""

    volume: xr.DataArray  # dims (z, y, x): only the parts that are asked for are read
    frame: Frame
    step: int = 1  # a column is the mean of ``step`` x ``step`` neighbouring columns of voxels
    padding: float | None = None  # value of the voxels outside the field of view

    @property
    def axes(self) -> tuple[Axis, Axis, Axis]:
        """Axes of the volume along rows, columns and depth."""
        return self.frame.rows, self.frame.cols, self.frame.through

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, columns, depth."""
        rows, cols, depth = (self.volume.sizes[axis] for axis in self.axes)
        return rows // self.step, cols // self.step, depth

    @cached_property
    def pitch(self) -> Pitch:
        """Distance of rows, of columns, and of voxels along a column, in um."""
        rows, cols, depth = (voxel_pitch(self.volume, axis) for axis in self.axes)
        return rows * self.step, cols * self.step, depth

    @property
    def depth_um(self) -> Floats:
        """Coordinates along the columns."""
        return np.asarray(self.volume.coords[self.frame.through].values, np.float64)

    def lateral_um(self) -> TwoFields:
        """Coordinates of the rows and of the columns: the middle of the voxels that they hold."""
        rows, cols, _ = self.shape
        rows_um = self._middles_um(self.frame.rows, rows)
        return rows_um, self._middles_um(self.frame.cols, cols)

    def _middles_um(self, axis: Axis, count: int) -> Floats:
        all_um = self.volume.coords[axis].values.astype(float)
        voxels_um = all_um[: count * self.step]
        return voxels_um.reshape(count, self.step).mean(axis=1)

    def voxels(self, tile: Tile, depth: slice = slice(None)) -> Array:
        """Return the voxels of a tile, or of a part of their depth, as they are stored.

        The shape is (rows * step, cols * step, depth).
        """
        k = self.step
        rows = slice(tile.r0 * k, tile.r1 * k)
        cols = slice(tile.c0 * k, tile.c1 * k)
        return read_box(self.volume, dict(zip(self.axes, (rows, cols, depth), strict=True)))

    def grey(
        self, tile: Tile, slope: TwoFields | None = None, depth: slice = slice(None)
    ) -> Singles:
        """Grey of the columns of a tile, (rows, cols, depth); NaN is missing.

        ``slope``, two (rows, cols): how far the sheet rises along the column from one voxel row to
        the next, and from one voxel column to the next, in voxels; the voxels that a column is the
        mean of are moved by it to the nearest voxel. ``depth``: part of the depth; not together
        with ``slope``.
        """
        stored = self.voxels(tile, depth)
        if self.step > 1:
            missing = np.nan if self.padding is None else self.padding
            # Without a slope nothing is moved.
            level = np.zeros(tile.shape)
            slope_r, slope_c = map(np.ascontiguousarray, slope or (level, level))
            grey = np.empty((*tile.shape, stored.shape[2]), np.float32)
            _kernels.mean_columns(stored, self.step, slope_r, slope_c, missing, grey)
            return grey
        grey = np.empty(stored.shape, np.float32)
        for i, row in enumerate(stored):
            grey[i] = row.copy(order="K")  # turned while it is in the processor's cache
        if self.padding is not None:
            grey[grey == self.padding] = np.nan
        return grey

    def tiles(self, engine: Engine, *, multiple: int = 1, share: float = 1.0) -> list[Tile]:
        """Cover all columns with tiles that fit into the engine's memory.

        Their edges are multiples of ``multiple``, in columns.

        ``share``: of the depth that is read, 0 to 1.
        """
        rows, cols, depth = self.shape
        # A voxel of a tile takes 12 bytes while it is worked on, beside its own.
        voxel_bytes = self.volume.dtype.itemsize + 12 / self.step**2
        column_bytes = share * depth * self.step**2 * voxel_bytes
        budget_bytes = engine.memory_bytes / (engine.at_once + 1) / 2
        # Columns in a chunk of the file where they fit into it evenly.
        chunk_sizes = [chunks_of(self.volume)["zyx".index(axis)] for axis in self.axes[:2]]
        chunk_columns = [n // self.step for n in chunk_sizes if n % self.step == 0]
        multiple = math.lcm(multiple, *(n for n in chunk_columns if n <= _TILE))
        edge = int(np.clip(np.sqrt(budget_bytes / column_bytes), 8, _TILE))
        rows_per_tile = max(edge // multiple, 1) * multiple
        # Along the rows of the file as far as memory allows, so that neighbours in the file are
        # read together.
        most_cols = int(budget_bytes / column_bytes / rows_per_tile)
        cols_in_memory = max(most_cols // multiple, 1) * multiple
        cols_per_tile = max(min(cols_in_memory, 4 * rows_per_tile), rows_per_tile)
        return tiles_of((rows, cols), (rows_per_tile, cols_per_tile))


def join_tiles(tile_fields: Iterable[tuple[Tile, Floats]], out: Floats) -> Floats:
    """Put the parts of tiles where they belong in ``out``, (..., rows, cols), and return it."""
    for tile, field in tile_fields:
        out[..., tile.rows, tile.cols] = field
    return out


def voxel_pitch(volume: xr.DataArray, axis: str) -> float:
    """Distance of the voxels along an axis, in um."""
    values = volume.coords[axis].values
    return float(values[1] - values[0]) if values.size > 1 else 1.0


class Guide(NamedTuple):
    """Where the coarse search saw the sheet, for every column of a grid."""

    low: Floats  # (rows, cols): first and last depth index of the sheet; NaN where there is none
    high: Floats
    # (rows, cols): rise of the sheet, in voxels of depth from one voxel row, or voxel column, to
    # the next.
    slope_r: Floats
    slope_c: Floats
    cos_tilt: Floats  # (rows, cols): cosine of the sheet's tilt

    def part(self, tile: Tile) -> Guide:
        """Return the guide of a tile."""
        return Guide(*(field[tile.rows, tile.cols] for field in self))

    def faces(self, depth: int, *, from_high: bool) -> TwoFields:
        """Depth of the outer and of the opposite face, counted from the end that is read from."""
        if from_high:
            return depth - 1 - self.high, depth - 1 - self.low
        return self.low, self.high


def make_guide(coarse_sheet: CoarseSheet, columns: Columns) -> Guide:
    """Bring the coarse sheet to single columns, and take its slopes.

    The slopes are those of the sheet's middle, smoothed over eight blocks and twice its thickness
    at least: what is shorter is roughness, or the blocks' own.
    """
    shape = columns.shape[:2]
    pitch = columns.pitch
    low = to_columns(coarse_sheet.low, coarse_sheet.block, shape)
    high = to_columns(coarse_sheet.high, coarse_sheet.block, shape)
    middle_um = 0.5 * (low + high) * pitch[2]
    block_um = coarse_sheet.block * max(pitch[:2])
    typical_px = float(np.nanmedian(high - low))
    cutoff_um = max(8 * block_um, 2 * typical_px * pitch[2])
    smoothed_um = gaussian_regression(middle_um, pitch[:2], cutoff_um=cutoff_um)
    slopes = np.gradient(smoothed_um, *pitch[:2])
    cosine = 1 / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
    rise_r, rise_c = rises_px(slopes, pitch[:2], columns)
    slope_r = np.nan_to_num(rise_r)
    slope_c = np.nan_to_num(rise_c)
    cos_tilt = np.nan_to_num(cosine, nan=1.0)
    return Guide(low, high, slope_r, slope_c, cos_tilt)


def rises_px(slopes: Iterable[Floats], pitch_um: Pair, columns: Columns) -> list[Floats]:
    """Rise of a sheet, in voxels, from one voxel row and from one voxel column to the next."""
    step = columns.step
    voxel_um = columns.pitch[2]
    return [s * p / step / voxel_um for s, p in zip(slopes, pitch_um, strict=True)]


@dataclass(frozen=True, slots=True, kw_only=True)
class GreyScale:
    """Scale of the grey that the fit sees."""

    air_grey: float  # its level becomes 0
    polarity: float  # -1 where the sheet is darker than the air
    # Standard deviation of the Gaussian over neighbouring columns, in columns.
    blend_sd: float = 0.0

    @property
    def halo(self) -> int:
        """Columns around a tile that are read with it."""
        return int(np.ceil(3 * self.blend_sd)) if self.blend_sd else 0

    def grown(self, tile: Tile, shape: Shape2D) -> Tile:
        """Return the tile with its halo, as far as the grid reaches."""
        return tile.grown(self.halo, self.halo, shape)


def oriented(columns: Columns, tile: Tile, guide: Guide, scale: GreyScale) -> tuple[Singles, Guide]:
    """Return the grey above the air of a tile's columns, and its guide from that of the grown tile.

    The grey is (rows, cols, depth).
    """
    tile_with_halo = scale.grown(tile, columns.shape[:2])
    tile_within = tile.within(tile_with_halo)
    grey = columns.grey(tile_with_halo, (guide.slope_r, guide.slope_c))
    grey -= np.float32(scale.air_grey)
    if scale.polarity < 0:
        grey *= np.float32(-1)
    grey = blended(grey, guide, scale, columns.step)
    return np.ascontiguousarray(grey[tile_within.rows, tile_within.cols]), guide.part(tile_within)


def blended(grey: Singles, guide: Guide, scale: GreyScale, step: int) -> Singles:
    """Average the columns of ``grey`` (rows, cols, depth) with their neighbours, in place."""
    if not scale.halo:
        return grey
    weights = np.exp(-0.5 * (np.arange(scale.halo + 1) / scale.blend_sd) ** 2)
    weights = (weights / (2 * weights.sum() - 1)).astype(np.float32)
    along_rows = np.empty_like(grey)
    _kernels.blend(grey, guide.slope_r * step, weights, 1, 0, along_rows)
    _kernels.blend(along_rows, guide.slope_c * step, weights, 0, 1, grey)
    return grey


FRINGE_PX = 1.5  # width of a fringe where it is not known better, in voxels


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """Profile of a sharp edge as the scanner shows it, which a column crosses at a right angle.

    Lengths in voxels.
    """

    width: float  # standard deviation of the blur
    # Size of the phase-contrast fringe beside it: a share of the edge's step; 0 where there is
    # none.
    fringe: float = 0.0
    # Distance of its undershoot and overshoot from the edge: the sd of the Gaussian whose second
    # derivative it is.
    fringe_width: float = FRINGE_PX

    @property
    def ratio(self) -> float:
        """Width of the blur over that of the fringe."""
        return self.width / self.fringe_width


@dataclass(frozen=True, slots=True, kw_only=True)
class LoneGrey:
    """Grey of a coating above the air, where nothing else is near."""

    level: float
    error: float  # standard error of the level
    spread: float  # standard deviation from place to place
    deepening: float  # by how much the half next to the base is brighter than the outer half
    deepening_error: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """Prior of the layers on one side of a column, (4,).

    What is expected, and how far a column may differ.
    """

    # Of face, thickness, grey of the coating (or of what lies outside), grey of the base.
    level: Floats
    spread: Floats  # of the same; only those of the greys are used
    coated: bool
    # Grey of a fibre's wall above the air, where no coating covers a base of walls and pores; 0
    # elsewhere.
    wall_level: float = 0.0
    level_error: float = 0.0  # standard error of the coating's grey that was learnt
    lone: LoneGrey | None = None  # that grey, where it was seen beyond all blur
    # By how much what lies directly below a coating, over WALL_UM, is lighter than the base.
    wall_below: float = 0.0

    @property
    def grey(self) -> float:
        """Expected grey of the coating above the air."""
        return float(self.level[2])


WALL_UM = 1.5
"""Half of a pressed fibre: what a coating lies on, before the pores of the base begin."""
Sides = dict[bool, Side]  # by whether they lie at the high end of the columns


@dataclass(frozen=True, slots=True, kw_only=True)
class Priors:
    """All that the fit of a column needs beside the column."""

    scale: GreyScale
    noise: float  # standard deviation of what the fit sees in the air
    single_noise: float  # that of a column that is not averaged with its neighbours
    # Standard deviation by which the fit takes a sample to differ from its model: the noise or
    # more.
    scatter: float
    base_level: float  # level of the base above the air
    base_texture: float  # variance of the base's grey along a column, per voxel
    edge: Edge  # blur and fringe
    search_px: float  # how far outside the expected face the search starts, in voxels
    # Grey that separates a sheet from other material; 0 where air lies beside the sheet.
    embedded_level: float
    sides: Sides
    # Thickness of tape or film that touches, by whether at the high end; 0 for none.
    covers_px: dict[bool, float]
    is_blur_known: bool = True  # no edge of walls and pores is known to be sharp

    @property
    def coated(self) -> tuple[bool, bool]:
        """Tell of the sides at the high and at the low end if they have a coating."""
        return self.sides[True].coated, self.sides[False].coated

    def attrs(self, pitch_um: float, frame: Frame) -> dict[str, float | list[float]]:
        """Return grey levels, noise, blur and fringe as surfaces carry them.

        The grey level of a coating that is not there is NaN.
        """
        air_grey, polarity, edge = self.scale.air_grey, self.scale.polarity, self.edge
        coating_greys: Entries = {}
        level_errors: Entries = {}
        deepenings: Entries = {}
        for name in SIDES:
            side = self.sides[name == frame.side_at(from_high=True)]
            grey = polarity * side.level[2] + air_grey if side.coated else np.nan
            coating_greys[f"grey_coating_{name}"] = float(grey)
            if side.coated and side.level_error:
                level_errors[f"grey_coating_{name}_error"] = side.level_error
            if side.lone is not None:
                deepening = [side.lone.deepening, side.lone.deepening_error]
                deepenings[f"coating_deepens_{name}"] = deepening
        covers_um: dict[str, float] = {}
        for from_high, cover_px in self.covers_px.items():
            if cover_px:
                name = frame.side_at(from_high=from_high)
                covers_um[f"cover_{name}_um"] = cover_px * pitch_um
        blur_um = edge.width * pitch_um if self.is_blur_known else float("nan")
        return {
            "grey_air": air_grey,
            "grey_base": polarity * self.base_level + air_grey,
            **coating_greys,
            **level_errors,
            **deepenings,
            "grey_noise": self.noise,
            "grey_noise_single": self.single_noise,
            "averaged_columns": self.scale.blend_sd,
            "base_texture_um": self.base_texture * pitch_um,
            "polarity": polarity,
            "blur_um": blur_um,
            "fringe": edge.fringe,
            "fringe_um": edge.fringe_width * pitch_um if edge.fringe else 0.0,
            **covers_um,
        }
