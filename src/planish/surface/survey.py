"""Take a first look at a volume, in one pass.

It gives block means, a sample of its columns, levels, noise and gaps.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import VolumeError
from planish.core.grid import first_and_last
from planish.core.robust import mad_sd
from planish.core.tiles import Engine, Tile
from planish.core.typing import Bools, Floats
from planish.surface._kernels import block_sums
from planish.surface.choose import Surroundings, choose_sheet, make_choice, seed_grey
from planish.surface.coarse import CoarseSheet, search_sheet
from planish.surface.columns import Columns
from planish.surface.params import SurfaceParams

_SAMPLE = 40_000  # columns of the sample, and blocks wanted


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """Coarse sheet, grey levels and gaps of a volume, from the first look."""

    coarse: CoarseSheet
    air_grey: float  # its grey
    noise: float  # standard deviation of one voxel of the air
    polarity: float  # +1 where the sheet is lighter than the air, -1 where it is darker
    padding: float | None  # value of the voxels outside the field of view
    missing_share: float  # voxels that are NaN or infinite
    empty_share: float  # columns with nothing but air, beside the sheet or in a hole
    surroundings: Surroundings = "air"


def take_survey(columns: Columns, params: SurfaceParams, engine: Engine) -> Survey:
    """Find the sheet roughly.

    VolumeError if there is none, several, or one that fills the volume from end to end.
    """
    depth = columns.shape[2]
    reading = _read(columns, engine)
    profiles, missing_share = reading.profiles.reshape(-1, depth), reading.missing_share
    padding = padding_value(profiles)
    blocks, sharp_blocks = reading.blocks(padding)
    if params.seed_um is None:
        sharp_blocks = blocks  # only a seed needs both
    if missing_share > 0.9:
        raise VolumeError(
            "More than 90 % of the volume's voxels are NaN or infinite. Check how it was exported."
        )
    choice = make_choice(columns, reading.block, blocks.shape, params)
    # The level comes from means over blocks: where the export has cut the air's noise at 0, single
    # voxels crowd there.
    end_grey = _ends(blocks.reshape(-1, depth), np.isfinite(blocks).reshape(-1, depth))
    end_voxels = _ends(
        profiles, np.ones(profiles.shape, bool) if padding is None else profiles != padding
    )
    scatter = None
    if choice.seed is not None:
        end_grey, end_voxels = _airy(end_grey, end_voxels, seed_grey(sharp_blocks, choice.seed))
        scatter = mad_sd(end_grey)
    air_grey = mode(end_grey)
    coarse_sheet, surroundings, polarity = choose_sheet(
        blocks, sharp_blocks, air_grey, params, choice, scatter
    )
    min_contrast = 6.0 * mad_sd(end_grey)  # what is nowhere above that is air from end to end
    empty_share = np.mean(
        [~(polarity * (row - air_grey) > min_contrast).any(axis=1) for row in blocks]
    )
    return Survey(
        coarse=coarse_sheet,
        air_grey=air_grey,
        noise=voxel_noise(end_voxels, air_grey),
        polarity=polarity,
        padding=padding,
        missing_share=missing_share,
        empty_share=float(empty_share),
        surroundings=surroundings,
    )


def survey_labels(
    columns: Columns, params: SurfaceParams, engine: Engine
) -> tuple[CoarseSheet, float]:
    """Find the sheet roughly where every voxel is labelled as sheet (1) or not (0).

    And the share of empty columns.

    VolumeError as of :func:`take_survey`.
    """
    reading = _read(columns, engine)
    shares = reading.blocks(None)[1]
    coarse_sheet = search_sheet(
        shares, shares > 0.5, 0.5, make_choice(columns, reading.block, shares.shape, params)
    )
    return coarse_sheet, float(1.0 - (shares > 0).any(axis=2).mean())


def _block(columns: Columns) -> tuple[int, tuple[int, int]]:
    rows, cols, depth = columns.shape
    if min(columns.volume.shape) < 8:
        raise VolumeError(
            f"The volume has the shape {' x '.join(map(str, columns.volume.shape))} (z, y, x); at"
            " least 8 voxels are needed along every axis. Check that this is the whole stack."
        )
    wanted = np.sqrt(rows * cols / _SAMPLE)
    block = int(np.clip(round(wanted), 1, 4))  # columns along the edge of a block
    while (rows // block) * (cols // block) * depth > 2**25:  # block means that are kept at most
        block += 1
    stride = max(1, int(wanted))
    if rows * cols < 1_500_000:  # columns from which on fewer rows are sampled
        return block, (stride, stride)
    # Each row costs as much as the chunks that it runs through: few rows, and more columns of each.
    return block, (max(rows // 24, 1), max(cols * 24 // _SAMPLE, 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reading:
    """What one reading of all columns leaves."""

    # (block rows, block cols, depth), of blocks; not finite where a voxel is not.
    means: NDArray[np.float32]
    # Blocks with a voxel of the volume's first value, which may be that of the padding.
    holds_corner: Bools
    profiles: NDArray[Any]  # (rows, cols, depth), of the sampled columns
    missing_share: float  # voxels that are NaN or infinite
    block: int

    def blocks(self, padding: float | None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Block means, smoothed and as they are, NaN for gaps."""
        means, is_missing = self.means, ~np.isfinite(self.means)
        if padding is not None:
            is_missing |= self.holds_corner
        if not is_missing.any():
            return (
                ndimage.uniform_filter(
                    means, (3, 3, 3) if self.block < 3 else (1, 1, 3), mode="nearest"
                ),
                means,
            )
        means[is_missing] = np.nan
        return means, means


def _read(columns: Columns, engine: Engine) -> _Reading:
    block, stride = _block(columns)
    rows, cols, depth = columns.shape
    means = np.empty((max(rows // block, 1), max(cols // block, 1), depth), dtype=np.float32)
    holds_corner, missing_count = np.empty(means.shape, dtype=bool), 0.0
    profiles = np.empty(
        (-(-rows // stride[0]), -(-cols // stride[1]), depth), dtype=columns.volume.dtype
    )
    corner = float(columns.voxels(Tile(0, 1, 0, 1), slice(1))[0, 0, 0])
    tiles = [
        # What remains belongs to the last block of the axis, and so to the last tile.
        Tile(
            t.r0, rows if t.r1 > rows - block else t.r1, t.c0, cols if t.c1 > cols - block else t.c1
        )
        for t in columns.tiles(engine, multiple=block)
        if t.r0 <= max(rows - block, 0) and t.c0 <= max(cols - block, 0)
    ]
    for tile, found in engine.map(
        "survey", _read_tile, lambda _tile: (columns, block, stride, corner), tiles
    ):
        row, col = tile.r0 // block, tile.c0 // block
        sample_row, sample_col = -(-tile.r0 // stride[0]), -(-tile.c0 // stride[1])
        for field, part, r, c in (
            (means, found["means"], row, col),
            (holds_corner, found["holds_corner"], row, col),
            (profiles, found["profiles"], sample_row, sample_col),
        ):
            field[r : r + part.shape[0], c : c + part.shape[1]] = part
        missing_count += float(found["missing"])
    missing_share = missing_count / (rows * cols * depth * columns.step**2)
    return _Reading(
        means=means,
        holds_corner=holds_corner,
        profiles=profiles,
        missing_share=missing_share,
        block=block,
    )


def _read_tile(job: tuple[Columns, int, tuple[int, int], float], tile: Tile) -> NDArray[Any]:
    """Part of a :class:`_Reading` that a tile gives, as one record.

    ``missing`` counts its missing voxels.
    """
    columns, block, stride, corner = job
    voxels = columns.voxels(tile)
    block_px = block * columns.step
    block_counts = [max(n // block_px, 1) for n in voxels.shape[:2]]
    # As it lies in memory: the depth may be the first, the second or the last axis.
    axis_order = np.argsort(voxels.strides, kind="stable")[::-1]
    sums_shape, block_sides = (
        np.array([*block_counts, voxels.shape[2]]),
        np.array([block_px, block_px, 1]),
    )
    sums, missing, holds_corner = (
        np.zeros(sums_shape[axis_order], dtype) for dtype in (float, float, bool)
    )
    stored = np.ascontiguousarray(voxels.transpose(axis_order))
    block_sums(stored, tuple(block_sides[axis_order].tolist()), corner, sums, missing, holds_corner)
    sums, holds_corner = (field.transpose(np.argsort(axis_order)) for field in (sums, holds_corner))
    block_widths = [
        np.diff([*(block_px * np.arange(k)), n])
        for k, n in zip(block_counts, voxels.shape, strict=False)
    ]
    # Columns of the sample lie at multiples of the stride in the whole grid.
    sampled = voxels[
        tuple(
            slice((-k % n) * columns.step, None, n * columns.step)
            for k, n in zip(tile[::2], stride, strict=True)
        )
    ]
    fields = {
        "means": (sums / np.multiply.outer(*block_widths)[..., None]).astype(np.float32),
        "holds_corner": holds_corner,
        "profiles": sampled,
        "missing": missing.sum(),
    }
    record = np.empty((), [(name, field.dtype, field.shape) for name, field in fields.items()])
    for name, field in fields.items():
        record[name] = field
    return record


def _ends(profiles: NDArray[Any], inside: Bools) -> Floats:
    """First and last three voxels of each column (n, depth) that lie inside the field of view.

    (2 n, 3).
    """
    is_long = inside.sum(axis=1) > 12
    if not is_long.any():
        return np.full((1, 3), np.nan)
    rows, inside = np.flatnonzero(is_long)[:, None], inside[is_long]
    # One voxel is skipped where the field of view begins within the column: it may be cut.
    first, last = first_and_last(inside)
    first, last = first + (first > 0), last - (last < profiles.shape[1] - 1)
    starts, stops = first[:, None] + np.arange(3), last[:, None] - np.arange(3)
    return np.concatenate([profiles[rows, k].astype(np.float64) for k in (starts, stops)])


def _airy(ends: Floats, voxels: Floats, seed: Floats) -> tuple[Floats, Floats]:
    """Where the columns' two ends differ, keep the one less like the object at the seed."""
    values_by_end = [(part[: len(part) // 2], part[len(part) // 2 :]) for part in (ends, voxels)]
    levels = [mode(half) for half in values_by_end[0]]
    contrasts = [abs(level - float(np.median(seed))) for level in levels]
    if abs(levels[0] - levels[1]) < 0.1 * max(contrasts):
        return ends, voxels
    clearest_end = int(np.argmax(contrasts))
    return values_by_end[0][clearest_end], values_by_end[1][clearest_end]


def mode(values: Floats) -> float:
    """Half-sample mode: the value around which the data crowd, whatever lies beside."""
    crowd = np.sort(values[np.isfinite(values)].ravel())
    if crowd.size == 0:
        raise VolumeError(
            "The volume holds no finite value at the ends of the axis through the sheet."
        )
    while crowd.size > 3:
        half = (crowd.size + 1) // 2
        width = crowd[half - 1 :] - crowd[: crowd.size - half + 1]
        narrowest = np.flatnonzero(width == width.min())
        # Integers tie: take the middle one of the ties.
        start = int(narrowest[narrowest.size // 2])
        crowd = crowd[start : start + half]
        if crowd[0] == crowd[-1]:
            break
    return float(np.mean(crowd))


def padding_value(columns: NDArray[np.generic]) -> float | None:
    """Return the value that fills the volume outside the field of view.

    It is None where the field fills the volume.

    Reconstructions are round; what lies outside their circle is set to one value, often 0, which is
    not the grey of the air. It differs from air that the export has clipped to one value by three
    signs, over ``columns`` (n, depth): the step from the padding to what lies inside is sharp, what
    lies inside differs from it, and something stands out from that in turn. Clipped air passes into
    the sheet through the blur, and nothing stands out from the sheet.
    """
    corner = columns[0, 0]
    is_padding = columns == corner
    if not np.isfinite(corner) or columns[-1, -1] != corner or is_padding.mean() < 1e-3:
        return None
    has_inside, last_index = (~is_padding).sum(axis=1) > 12, columns.shape[1] - 1
    if np.count_nonzero(has_inside) < 10:
        return None
    profiles, padding = columns[has_inside].astype(np.float64), float(corner)
    first, last = first_and_last(~is_padding[has_inside])
    is_cut = (first > 0) | (last < last_index)
    if np.count_nonzero(is_cut) < 0.05 * is_cut.size:
        # Few columns end in the padding. If others hold nothing else, the circle lies across the
        # columns.
        is_empty = is_padding.all(axis=1)
        is_across = is_empty.mean() > 0.01 and not (~is_padding[~is_empty][:, 0]).mean() < 0.5
        return padding if is_across else None
    rows = np.flatnonzero(is_cut & (first > 0))
    if rows.size < 10:
        rows, first, profiles = np.flatnonzero(is_cut), last_index - last, profiles[:, ::-1]
    inner_grey = profiles[
        rows[:, None], np.minimum(first[rows][:, None] + np.arange(2, 6), last_index)
    ]
    inner_level = float(np.median(inner_grey))
    scatter = max(mad_sd(inner_grey - inner_level), 1e-9)
    running_mean = (profiles[rows, :-2] + profiles[rows, 1:-1] + profiles[rows, 2:]) / 3
    running_mean = np.where(is_padding[has_inside][rows][:, 1:-1], inner_level, running_mean)
    stands_out = float(np.median(np.max(np.abs(running_mean - inner_level), axis=1))) > 4 * scatter
    contrast = abs(inner_level - padding)
    is_sharp = abs(float(np.median(profiles[rows, first[rows]])) - inner_level) < 0.2 * contrast
    return padding if is_sharp and contrast > 3 * scatter and stands_out else None


def voxel_noise(ends: Floats, air: float) -> float:
    """Standard deviation of one voxel, from samples (n, 3) of neighbouring voxels in the air."""
    distance = np.abs(ends - air)
    steps = np.diff(ends, axis=1)[
        distance[:, :-1] <= max(float(np.nanpercentile(distance, 60)), 1e-12)
    ]
    if not steps.size:
        return 0.0
    robust_sd = mad_sd(steps) / np.sqrt(2.0)
    return float(robust_sd if robust_sd > 0 else np.sqrt(np.mean(steps**2) / 2))
