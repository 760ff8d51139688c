"""Take a first look at a volume, in one pass.

It gives block means, a sample of its columns, levels, noise and gaps.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import VolumeError
from planish.core.grid import at_index, first_and_last
from planish.core.robust import mad_sd
from planish.core.tiles import Engine, Tile
from planish.core.typing import Array, Bools, Floats, Ints, Shape2D, Singles, TwoFields
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
    """Find the sheet roughly, and what is known of the volume's greys before any fit.

    VolumeError if there is none, several, or one that fills the volume from end to end.
    """
    depth = columns.shape[2]
    reading = _read(columns, engine)
    if reading.missing_share > 0.9:
        raise VolumeError(
            "More than 90 % of the volume's voxels are NaN or infinite. Check how it was exported."
        )
    profiles = reading.profiles.reshape(-1, depth)
    padding = padding_value(profiles)
    blocks, sharp_blocks = reading.blocks(padding)
    if params.seed_um is None:
        sharp_blocks = blocks  # only a seed needs both
    choice = make_choice(columns, reading.block, blocks.shape, params)
    # The level comes from means over blocks: where the export has cut the air's noise at 0, single
    # voxels crowd there.
    block_columns = blocks.reshape(-1, depth)
    end_grey = _ends(block_columns, np.isfinite(block_columns))
    in_field = np.ones(profiles.shape, bool) if padding is None else profiles != padding
    end_voxels = _ends(profiles, in_field)
    scatter = None
    if choice.seed is not None:
        end_grey, end_voxels = _airy(end_grey, end_voxels, seed_grey(sharp_blocks, choice.seed))
        scatter = mad_sd(end_grey)
    air_grey = mode(end_grey)
    coarse_sheet, surroundings, polarity = choose_sheet(
        blocks, sharp_blocks, air_grey, params, choice, scatter
    )
    min_contrast = 6.0 * mad_sd(end_grey)  # what is nowhere above that is air from end to end
    rises = (polarity * (row - air_grey) for row in blocks)
    empty_share = np.mean([~(rise > min_contrast).any(axis=1) for rise in rises])
    return Survey(
        coarse=coarse_sheet,
        air_grey=air_grey,
        noise=voxel_noise(end_voxels, air_grey),
        polarity=polarity,
        padding=padding,
        missing_share=reading.missing_share,
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
    choice = make_choice(columns, reading.block, shares.shape, params)
    coarse_sheet = search_sheet(shares, shares > 0.5, 0.5, choice)
    has_sheet = (shares > 0).any(axis=2)
    return coarse_sheet, float(1.0 - has_sheet.mean())


def _block(columns: Columns) -> tuple[int, Shape2D]:
    """Columns along the edge of a block, and steps between sampled rows and sampled columns.

    VolumeError where the volume has too few voxels along an axis.
    """
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
    col_stride = max(cols * 24 // _SAMPLE, 1)
    return block, (max(rows // 24, 1), col_stride)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reading:
    """What one reading of all columns leaves."""

    # (block rows, block cols, depth), of blocks; not finite where a voxel is not.
    means: Singles
    # Blocks with a voxel of the volume's first value, which may be that of the padding.
    holds_corner: Bools
    profiles: Array  # (rows, cols, depth), of the sampled columns
    missing_share: float  # voxels that are NaN or infinite
    block: int

    def blocks(self, padding: float | None) -> tuple[Singles, Singles]:
        """Block means, smoothed and as they are, NaN for gaps."""
        means = self.means
        is_missing = ~np.isfinite(means)
        if padding is not None:
            is_missing |= self.holds_corner
        if is_missing.any():
            means[is_missing] = np.nan
            return means, means
        lateral = 3 if self.block < 3 else 1
        return ndimage.uniform_filter(means, (lateral, lateral, 3), mode="nearest"), means


def _read(columns: Columns, engine: Engine) -> _Reading:
    """Read all columns once, and join what their tiles give.

    A tile of whole blocks gives sums of its blocks, and the columns of the sample that lie in it;
    each goes where the tile lies in the grid of the blocks or of the sample.
    """
    block, stride = _block(columns)
    rows, cols, depth = columns.shape
    block_shape = max(rows // block, 1), max(cols // block, 1), depth
    sample_shape = -(-rows // stride[0]), -(-cols // stride[1]), depth
    fields: dict[str, Array] = {}
    fields["means"] = np.empty(block_shape, np.float32)
    fields["holds_corner"] = np.empty(block_shape, bool)
    fields["profiles"] = np.empty(sample_shape, columns.volume.dtype)
    missing_count = 0.0
    first_voxel = columns.voxels(Tile(0, 1, 0, 1), slice(1))
    corner = float(first_voxel.flat[0])
    job = columns, block, stride, corner
    tiles = _block_tiles(columns, engine, block)
    for tile, sums in engine.map("survey", _read_tile, lambda _tile: job, tiles):
        for name, field in fields.items():
            row_step, col_step = stride if name == "profiles" else (block, block)
            part = sums[name]
            row = -(-tile.r0 // row_step)
            col = -(-tile.c0 // col_step)
            field[row:, col:][: part.shape[0], : part.shape[1]] = part
        missing_count += float(sums["missing"])
    missing_share = missing_count / (rows * cols * depth * columns.step**2)
    return _Reading(**fields, missing_share=missing_share, block=block)


def _block_tiles(columns: Columns, engine: Engine, block: int) -> list[Tile]:
    """Tiles of whole blocks: what remains belongs to the last block of the axis."""
    rows, cols, _ = columns.shape
    tiles: list[Tile] = []
    for r0, r1, c0, c1 in columns.tiles(engine, multiple=block):
        if r0 <= max(rows - block, 0) and c0 <= max(cols - block, 0):
            row_stop = rows if r1 > rows - block else r1
            col_stop = cols if c1 > cols - block else c1
            tiles.append(Tile(r0, row_stop, c0, col_stop))
    return tiles


def _read_tile(job: tuple[Columns, int, Shape2D, float], tile: Tile) -> Array:
    """Part of a :class:`_Reading` that a tile gives, as one record.

    ``missing`` counts its missing voxels. The job: the columns, the edge of a block in them, the
    steps between sampled rows and columns, and the value that may be that of the padding.
    """
    columns, block, stride, corner = job
    voxels = columns.voxels(tile)
    block_px = block * columns.step
    block_counts = [max(n // block_px, 1) for n in voxels.shape[:2]]
    # As it lies in memory: the depth may be the first, the second or the last axis.
    axis_order = np.argsort(voxels.strides, kind="stable")[::-1]
    sums_shape = np.array([*block_counts, voxels.shape[2]])[axis_order]
    block_sides = np.array([block_px, block_px, 1])[axis_order]
    sums, missing = np.zeros((2, *sums_shape))
    holds_corner = np.zeros(sums_shape, bool)
    stored = np.ascontiguousarray(voxels.transpose(axis_order))
    block_sums(stored, tuple(block_sides.tolist()), corner, sums, missing, holds_corner)
    column_order = np.argsort(axis_order)
    # The last block of an axis takes what is left over.
    counts = zip(block_counts, voxels.shape, strict=False)
    block_widths = [np.diff([*(block_px * np.arange(k)), n]) for k, n in counts]
    # Columns of the sample lie at multiples of the stride in the whole grid.
    step = columns.step
    starts = zip(tile[::2], stride, strict=True)
    sampled = tuple(slice((-k % n) * step, None, n * step) for k, n in starts)
    voxels_of_block = np.multiply.outer(*block_widths)[..., None]
    means = sums.transpose(*column_order) / voxels_of_block
    fields = {"means": means.astype(np.float32)}
    fields["holds_corner"] = holds_corner.transpose(column_order)
    fields["profiles"] = voxels[sampled]
    fields["missing"] = missing.sum()
    dtype = [(name, field.dtype, field.shape) for name, field in fields.items()]
    record = np.empty((), dtype)
    for name, field in fields.items():
        record[name] = field
    return record


def _ends(profiles: Array, inside: Bools) -> Floats:
    """First and last three voxels of each column (n, depth) that lie inside the field of view.

    (2 n, 3).
    """
    rows = np.flatnonzero(inside.sum(axis=1) > 12)
    if not rows.size:
        return np.full((1, 3), np.nan)
    # One voxel is skipped where the field of view begins within the column: it may be cut.
    first, last = first_and_last(inside[rows])
    first += first > 0
    last -= last < profiles.shape[1] - 1
    three = np.arange(3)
    first_ends = profiles[rows[:, None], first[:, None] + three]
    last_ends = profiles[rows[:, None], last[:, None] - three]
    return np.concatenate([first_ends, last_ends]).astype(float)


def _airy(ends: Floats, voxels: Floats, seed: Floats) -> TwoFields:
    """Where the columns' two ends differ, keep the one less like the object at the seed.

    ``ends``, ``voxels`` (2 n, 3): of blocks and of single columns, as :func:`_ends` gives them.
    """
    halves = np.split(ends, 2)
    levels = np.array([*map(mode, halves)])
    contrasts = np.abs(levels - float(np.median(seed)))
    if np.ptp(levels) < 0.1 * contrasts.max():
        return ends, voxels
    clearest_end = int(np.argmax(contrasts))
    return halves[clearest_end], np.split(voxels, 2)[clearest_end]


def mode(values: Floats) -> float:
    """Half-sample mode: the value around which the data crowd, whatever lies beside.

    Again and again the narrowest half of the values is kept.
    """
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
    signs, over ``columns`` (n, depth), some of the volume's: the step from the padding to what lies
    inside is sharp, what lies inside differs from it, and something stands out from that in turn.
    Clipped air passes into the sheet through the blur, and nothing stands out from the sheet.
    """
    # The corners lie outside such a circle.
    corner = columns[0, 0]
    if not np.isfinite(corner) or columns[-1, -1] != corner:
        return None
    is_padding = columns == corner
    if is_padding.mean() < 1e-3:
        return None
    has_inside = (~is_padding).sum(axis=1) > 12
    if np.count_nonzero(has_inside) < 10:
        return None
    padding = float(corner)
    last_index = columns.shape[1] - 1
    profiles = columns[has_inside].astype(float)
    is_outside = is_padding[has_inside]
    first, last = first_and_last(~is_outside)
    is_cut = (first > 0) | (last < last_index)
    if np.count_nonzero(is_cut) < 0.05 * is_cut.size:
        # Few columns end in the padding. If others hold nothing else, the circle lies across the
        # columns.
        is_empty = is_padding.all(axis=1)
        starts_empty = is_padding[~is_empty, 0]
        is_across = is_empty.mean() > 0.01 and starts_empty.mean() <= 0.5
        return padding if is_across else None
    rows = np.flatnonzero(first > 0)
    if rows.size < 10:
        rows = np.flatnonzero(is_cut)
        first = last_index - last
        profiles = profiles[:, ::-1]
    is_sharp = _is_sharp(profiles[rows], is_outside[rows], first[rows], padding)
    return padding if is_sharp else None


def _is_sharp(profiles: Floats, is_outside: Bools, first: Ints, padding: float) -> bool:
    """Tell if the step from the padding to what lies inside is sharp, and something stands out.

    ``first`` (n,): index of the first voxel inside of each profile (n, depth); ``is_outside`` as
    these: voxels of the padding, whose value is ``padding``.
    """
    next_index = first[:, None] + np.arange(2, 6)
    inner_index = np.minimum(next_index, profiles.shape[1] - 1)
    inner_grey = np.take_along_axis(profiles, inner_index, axis=1)
    inner_level = float(np.median(inner_grey))
    scatter = max(mad_sd(inner_grey - inner_level), 1e-9)
    means = (profiles[:, :-2] + profiles[:, 1:-1] + profiles[:, 2:]) / 3
    running_mean = np.where(is_outside[:, 1:-1], inner_level, means)
    largest_rises = np.max(np.abs(running_mean - inner_level), axis=1)
    highest = float(np.median(largest_rises))
    contrast = abs(inner_level - padding)
    first_grey = float(np.median(at_index(profiles, first)))
    is_step = abs(first_grey - inner_level) < 0.2 * contrast and contrast > 3 * scatter
    return is_step and highest > 4 * scatter


def voxel_noise(ends: Floats, air: float) -> float:
    """Standard deviation of one voxel, from samples (n, 3) of neighbouring voxels in the air."""
    distance = np.abs(ends - air)
    most = max(float(np.nanpercentile(distance, 60)), 1e-12)
    steps = np.diff(ends, axis=1)[distance[:, :-1] <= most]
    if not steps.size:
        return 0.0
    robust_sd = mad_sd(steps) / np.sqrt(2.0)
    if robust_sd > 0:
        return float(robust_sd)
    # Whole numbers that hardly vary have a median deviation of 0.
    return float(np.sqrt(np.mean(steps**2) / 2))
