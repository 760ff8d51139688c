"""Choose which object of the volume is the sheet.

It is the only one, that of a grey range, or the one that holds a seed point.
"""

from contextlib import suppress
from dataclasses import replace
from typing import Literal

import numpy as np

from planish.core.errors import VolumeError
from planish.core.robust import mad_sd
from planish.core.typing import Floats, Shape
from planish.surface.coarse import (
    CORE,
    BlockIndex,
    Blocks,
    Choice,
    CoarseSheet,
    followed_sheet,
    search_sheet,
)
from planish.surface.columns import Columns, voxel_pitch
from planish.surface.params import SurfaceParams

Surroundings = Literal["air", "others", "material"]
"""What lies beside a sheet: air alone, other objects beyond air, or material from which a grey has
to separate it."""

_SIGMAS = 6.0  # a block is material when it differs from the air by so many standard deviations


def make_choice(columns: Columns, block: int, shape: Shape, params: SurfaceParams) -> Choice:
    """Give block width, the seed point in block indices, and words for a place in block indices.

    ``block``: columns along the edge of a block; ``shape``: of the block means, (block rows, block
    cols, depth). VolumeError where the seed point lies outside the volume.
    """
    volume = columns.volume
    lateral_px = block * columns.step
    block_px = dict(zip(columns.axes, (lateral_px, lateral_px, 1), strict=True))

    def describe(block_index: BlockIndex) -> str:
        place_um: dict[str, float] = {}
        for (axis, width_px), i in zip(block_px.items(), block_index, strict=True):
            coords_um = volume[axis].values
            middle = min(int((i + 0.5) * width_px), coords_um.size - 1)
            place_um[axis] = float(coords_um[middle])
        return ",".join(f"{place_um[axis]:.4g}" for axis in ("z", "y", "x"))

    choice = Choice(block=block, describe=describe)
    if params.seed_um is None:
        return choice
    seed: list[int] = []
    for (axis, width_px), block_count in zip(block_px.items(), shape, strict=True):
        seed_um = params.seed_um["zyx".index(axis)]
        coords_um = volume.coords[axis].values
        index = (seed_um - float(coords_um[0])) / voxel_pitch(volume, axis)
        if not -0.5 <= index < coords_um.size - 0.5:
            raise VolumeError(
                f"The seed point lies outside the volume: its {axis} is {seed_um:g} um, the volume"
                f" goes from {float(coords_um[0]):g} to {float(coords_um[-1]):g} um. Check"
                " `seed_um` and `voxel_um`."
            )
        seed.append(min(int((index + 0.5) / width_px), block_count - 1))
    return replace(choice, seed=(seed[0], seed[1], seed[2]))


def choose_sheet(
    blocks: Blocks,
    sharp_blocks: Blocks,
    air: float,
    params: SurfaceParams,
    choice: Choice,
    scatter: float | None,
) -> tuple[CoarseSheet, Surroundings, float]:
    """Find the sheet in the block means; return it, what lies beside it, and its polarity.

    ``sharp_blocks``: the means before they were smoothed, for a sheet at a seed; ``air``: grey of
    the air, ``scatter``: its standard deviation in block means, None where it is not known. The
    polarity is +1 where the sheet is lighter than the air, else -1.
    """
    if params.sheet_grey is not None:
        low, high = params.sheet_grey
        grey = blocks if choice.seed is None else sharp_blocks
        is_lighter = 0.5 * (low + high) >= air
        polarity = 1.0 if is_lighter else -1.0
        # The end of the range that is next to the air.
        edge_contrast = abs((low if is_lighter else high) - air)
        is_inside = (grey >= low) & (grey <= high)
        sheet = search_sheet(polarity * (grey - air), is_inside, edge_contrast, choice)
        return sheet, "air" if choice.seed is None else "material", polarity
    polarity, threshold, min_threshold = material(blocks, air, scatter)
    oriented = _above_air(blocks, air, polarity)
    if choice.seed is None:
        return *_only_sheet(oriented, threshold, min_threshold, choice), polarity
    unseeded = _unseeded(oriented, threshold, choice, choice.seed)
    oriented_sharp = _above_air(sharp_blocks, air, polarity)
    return *_sheet_at_seed(oriented, oriented_sharp, threshold, choice, unseeded), polarity


def _only_sheet(
    oriented: Blocks, threshold: float, min_threshold: float, choice: Choice
) -> tuple[CoarseSheet, Surroundings]:
    """Find the only sheet, or that of several which is coated or thicker; say what lies beside."""
    try:
        return _refined(oriented, threshold, choice), "air"
    except VolumeError:
        # Two bright coatings on a dim base look like two sheets. With a lower threshold they are
        # one, if they are one.
        if min_threshold < 0.7 * threshold:
            with suppress(VolumeError):
                return _refined(oriented, min_threshold, choice), "air"
        # What air parts from a sheet that is coated, or thicker, is film or a mount.
        with suppress(VolumeError):
            sheet = _refined(oriented, threshold, replace(choice, may_lead=True))
            return sheet, _objects_beside(oriented, sheet)
        raise


def _unseeded(
    oriented: Blocks, threshold: float, choice: Choice, seed: BlockIndex
) -> CoarseSheet | None:
    """Find the sheet without its seed; None where that is none, or not the one at the seed."""
    try:
        sheet = _refined(oriented, threshold, replace(choice, seed=None))
    except VolumeError:
        return None
    *column, depth = seed
    is_at_seed = sheet.low[*column] - 0.5 <= depth <= sheet.high[*column] + 0.5
    return sheet if is_at_seed else None


def _sheet_at_seed(
    oriented: Blocks,
    oriented_sharp: Blocks,
    threshold: float,
    choice: Choice,
    unseeded: CoarseSheet | None,
) -> tuple[CoarseSheet, Surroundings]:
    """Find the sheet at the seed and say what lies beside it.

    ``unseeded``: what was found there without the seed.
    """
    try:
        # Layers may be thinner than what the blocks are smoothed over.
        sheet, is_embedded = _seeded(oriented, oriented_sharp, threshold, choice)
    except VolumeError:
        if unseeded is None:
            raise
        return unseeded, "air"
    if unseeded is not None and _is_as_large(unseeded, sheet):
        # Then nothing lies beside it, and its faces need not be told from those of others, which
        # takes sheets of few voxels for their own blur.
        return unseeded, "air"
    return sheet, "material" if is_embedded else _objects_beside(oriented, sheet)


def _is_as_large(sheet: CoarseSheet, seeded_sheet: CoarseSheet) -> bool:
    """Tell if a sheet is as thick as the one at the seed, and whole in as many columns."""
    if sheet.is_whole.sum() < seeded_sheet.is_whole.sum():
        return False
    if not seeded_sheet.is_whole.any():
        return True
    return abs(_thickness_px(sheet) - _thickness_px(seeded_sheet)) <= 2.0


def _thickness_px(sheet: CoarseSheet) -> float:
    return float(np.median((sheet.high - sheet.low)[sheet.is_whole]))


def _objects_beside(oriented: Blocks, sheet: CoarseSheet) -> Surroundings:
    """Tell if other objects lie beside a sheet, or air alone."""
    # With so much air beside it no search for its faces meets another object.
    min_gap_px = max(12, 4 + 3 * sheet.block)
    depth_index = np.arange(oriented.shape[2])
    near_count = 0
    # One by one: it takes less memory.
    for block_row, low, high in zip(oriented, sheet.low, sheet.high, strict=True):
        distance_px = np.fmax(low[:, None] - depth_index, depth_index - high[:, None])
        is_object = (block_row > sheet.threshold) & (distance_px > 2) & (distance_px < min_gap_px)
        near_count += np.count_nonzero(is_object.any(axis=1))
    return "others" if near_count >= 0.001 * sheet.low.size else "air"


def material(
    blocks: Blocks, air: float, air_scatter: float | None = None
) -> tuple[float, float, float]:
    """Return polarity, the threshold of a first, coarse search, and the least that noise allows.

    Both thresholds are given above the air.

    ``blocks`` are block means; a sheet is what stands out from the air's own scatter, which is that
    of the half nearest to the air where ``air_scatter`` is not given.
    """
    sampled_grey = blocks.ravel()[:: 1 + blocks.size // 2**21]  # enough to tell the levels from
    deviation = sampled_grey[np.isfinite(sampled_grey)].astype(float) - air
    contrast = np.abs(deviation)
    if air_scatter is None:
        air_scatter = mad_sd(deviation[contrast <= np.percentile(contrast, 50)])
    scatter = max(air_scatter, 1e-3 * float(np.ptp(deviation)), 1e-9)
    is_bright = deviation > _SIGMAS * scatter
    is_dark = deviation < -_SIGMAS * scatter
    if max(is_bright.mean(), is_dark.mean()) < 1e-4:
        raise VolumeError(
            f"There is no sheet in the volume: all of it lies within {_SIGMAS:g} standard"
            f" deviations of the air's grey ({air:.4g}). Check that this is the reconstructed"
            " volume, and `through`."
        )
    is_lighter = contrast[is_bright].sum() >= contrast[is_dark].sum()
    material_contrast = contrast[is_bright if is_lighter else is_dark]
    typical_contrast = float(np.median(material_contrast))
    # The first and the last three voxels of a column are air as a rule.
    end_grey = np.delete(blocks, slice(3, -3), axis=-1).astype(float)
    threshold = max(_SIGMAS * scatter, 0.35 * typical_contrast)
    least_threshold = max(4.5 * mad_sd(end_grey), 0.08 * typical_contrast)
    return 1.0 if is_lighter else -1.0, threshold, least_threshold


def _above_air(blocks: Blocks, air: float, polarity: float) -> Blocks:
    """Grey above the air, 0 where it is missing.

    In place, because block means fill a good part of the memory.
    """
    above = np.where(np.isfinite(blocks), blocks, np.float32(air))
    above -= np.float32(air)
    above *= np.float32(polarity)
    return above


def _refined(oriented: Blocks, threshold: float, choice: Choice) -> CoarseSheet:
    """Find the sheet above a first threshold, and again above a better one.

    ``oriented``: grey above the air; VolumeError if there is no sheet with both faces.
    """
    sheet = search_sheet(oriented, oriented > threshold, threshold, choice)
    rows, cols = np.nonzero(sheet.is_whole)
    if rows.size == 0:
        raise VolumeError(
            "No column of the volume shows both faces of the sheet: it leaves the volume on one"
            " side, or `through` names another axis."
        )
    low = sheet.low[rows, cols][:, None]
    thickness = sheet.high[rows, cols][:, None] - low
    depth = np.rint(low + thickness * np.linspace(*CORE, 7)).astype(int)
    core_grey = oriented[rows[:, None], cols[:, None], depth]
    # The core tells the base's level, and that a better threshold: half way between air and base.
    base = float(np.median(core_grey.astype(float)))
    # Beside another object it is not lowered: noise and blur would join them.
    threshold = max(threshold * (1.0 if choice.may_lead else 0.7), 0.5 * base)
    return search_sheet(oriented, oriented > threshold, threshold, choice)


def _seeded(
    oriented: Blocks, sharp_blocks: Blocks, threshold: float, choice: Choice
) -> tuple[CoarseSheet, bool]:
    """Find the sheet at the seed, and tell whether other material, and not air, lies beside it.

    ``oriented``, ``sharp_blocks``: grey above the air, smoothed and as it is. VolumeError if there
    is nothing, or it touches others at every grey.
    """
    assert choice.seed is not None
    last_error: VolumeError | None = None
    # In air the usual threshold will do. Amid other material it is raised until the sheet stands
    # alone.
    try:
        sheet = _refined(oriented, threshold, choice)
        # Of the sheet that may touch others; with a higher threshold it may be less.
        if _touching_share(sheet) < 0.15:
            return sheet, False
    except VolumeError as error:
        last_error = error
    grey_at_seed = float(seed_grey(sharp_blocks, choice.seed).max())
    # There is nothing at the seed where that is so far below the brightest.
    if last_error is not None and grey_at_seed < 0.1 * float(np.percentile(sharp_blocks, 99)):
        raise last_error
    # The best of them shows both faces, without a neighbour, in the most columns.
    max_columns, best_sheet = 0, None
    # What is lighter than 1.6 times that grey is not the same object.
    for share in np.linspace(0.5, 0.95, 19):
        is_inside = (sharp_blocks > share * grey_at_seed) & (sharp_blocks < 1.6 * grey_at_seed)
        try:
            sheet = followed_sheet(sharp_blocks, is_inside, float(share * grey_at_seed), choice)
        except VolumeError as error:
            last_error = error
            continue
        whole_columns = int(np.count_nonzero(sheet.is_whole))
        # Above it the sheet cannot be followed.
        if whole_columns > max_columns and _touching_share(sheet) < 0.6:
            max_columns, best_sheet = whole_columns, sheet
    if best_sheet is not None:
        return best_sheet, True
    raise VolumeError(
        f"The object at the seed point {choice.describe(choice.seed)} um (z, y, x) touches others"
        " at every grey. Crop the volume to a part where it stands alone, or choose another point"
        " with `seed_um`."
    ) from last_error


def _touching_share(sheet: CoarseSheet) -> float:
    has_face = np.isfinite(sheet.low) | np.isfinite(sheet.high)
    measured_count = np.count_nonzero(has_face)
    touching_count = np.count_nonzero(sheet.is_touching)
    return touching_count / max(measured_count + touching_count, 1)


def seed_grey(sharp_blocks: Blocks, seed: BlockIndex) -> Floats:
    """Grey around the seed point, at the depth before it, at its own, and after it."""
    neighbourhood = tuple(slice(max(k - 1, 0), k + 2) for k in seed)
    return np.asarray(np.median(sharp_blocks[neighbourhood], axis=(0, 1)), np.float64)
