"""Which object of the volume is the sheet: the only one, that of a grey range, or the one that holds a seed point."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Literal

import numpy as np

from planish.core.errors import VolumeError
from planish.core.frame import Axis
from planish.core.robust import mad_sd
from planish.core.typing import Bools, Floats
from planish.surface.coarse import CORE, Blocks, Choice, CoarseSheet, followed_sheet, search_sheet
from planish.surface.columns import Columns, voxel_pitch
from planish.surface.params import SurfaceParams

Surroundings = Literal["air", "others", "material"]
"""What lies beside a sheet: air alone, other objects beyond air, or material from which a grey has to separate it."""

_SHARES = np.linspace(0.5, 0.95, 19)  # of the grey at the seed, tried as threshold
_BRIGHTER = 1.6  # times that grey: not the same object
_CLEAR = 0.1  # of the brightest: below it there is nothing at the seed
_SAME_DEPTH = 2.0  # voxels by which the thickness of one sheet may differ, found with the seed and without
_LEAST_GAP, _NEAR_SHARE = 12, 0.001  # voxels of air beside a sheet that stands apart; columns that may have less
_ENOUGH = 2**21  # block means from which levels are told; of more, every so many
_SIGMAS = 6.0  # a block is material when it differs from the air by so many standard deviations
_FEWER_SIGMAS = 4.5  # where that is not enough to see the base of a sheet


def make_choice(columns: Columns, block: int, shape: tuple[int, ...], params: SurfaceParams) -> Choice:
    """Give the width of a block, the seed point in block indices, and the words for a place in block indices."""
    volume, frame, wide = columns.volume, columns.frame, block * columns.step
    scale = {frame.rows: wide, frame.cols: wide, frame.through: 1}
    order: tuple[Axis, ...] = (frame.rows, frame.cols, frame.through)

    def describe(block_index: tuple[int, int, int]) -> str:
        index = dict(zip(order, block_index, strict=True))
        place = {k: volume[k].values[min(int((i + 0.5) * scale[k]), volume.sizes[k] - 1)] for k, i in index.items()}
        return ",".join(f"{float(place[k]):.4g}" for k in ("z", "y", "x"))

    choice = Choice(block=block, describe=describe)
    if params.seed_um is None:
        return choice
    seed: list[int] = []
    seed_um = dict(zip(("z", "y", "x"), params.seed_um, strict=True))
    for axis, most in zip(order, shape, strict=True):
        values = volume.coords[axis].values
        pitch = voxel_pitch(volume, axis)
        index = (seed_um[axis] - float(values[0])) / pitch
        if not -0.5 <= index < values.size - 0.5:
            limits = f"{float(values[0]):g} to {float(values[-1]):g}"
            raise VolumeError(
                f"The seed point lies outside the volume: its {axis} is {seed_um[axis]:g} um, the volume goes from "
                f"{limits} um. Check --seed-um and --voxel-um."
            )
        seed.append(min(int((index + 0.5) / scale[axis]), most - 1))
    return replace(choice, seed=(seed[0], seed[1], seed[2]))


def choose_sheet(
    blocks: Blocks, sharp: Blocks, air: float, params: SurfaceParams, choice: Choice, scatter: float | None
) -> tuple[CoarseSheet, Surroundings, float]:
    """Find the sheet in the block means; return it, what lies beside it, and its polarity."""
    if params.sheet_grey is not None:
        low, high = params.sheet_grey
        grey = blocks if choice.seed is None else sharp
        polarity = 1.0 if 0.5 * (low + high) >= air else -1.0
        edge = (low if polarity > 0 else high) - air
        sheet = search_sheet(polarity * (grey - air), (grey >= low) & (grey <= high), abs(edge), choice)
        return sheet, "air" if choice.seed is None else "material", polarity
    polarity, threshold, least = material(blocks, air, scatter)
    oriented = _above_air(blocks, air, polarity)
    if choice.seed is not None:
        # Layers may be thinner than what the blocks are smoothed over.
        above = _above_air(sharp, air, polarity)
        alone: CoarseSheet | None = None
        with suppress(VolumeError):
            alone = _refined(oriented, threshold, replace(choice, seed=None))
            row, col, depth = choice.seed
            if not alone.low[row, col] - 0.5 <= depth <= alone.high[row, col] + 0.5:
                alone = None
        try:
            sheet, is_embedded = _chosen(oriented, above, threshold, choice)
        except VolumeError:
            if alone is None:
                raise
            return alone, "air", polarity
        if alone is not None and _shows_as_much(alone, sheet):
            return alone, "air", polarity
        far = not is_embedded and _stands_apart(oriented > sheet.threshold, sheet)
        return sheet, "material" if is_embedded else "air" if far else "others", polarity
    try:
        return _refined(oriented, threshold, choice), "air", polarity
    except VolumeError:
        # Two bright coatings on a dim base look like two sheets. With a lower threshold they are one, if they are one.
        if least < 0.7 * threshold:
            with suppress(VolumeError):
                return _refined(oriented, least, choice), "air", polarity
        raise


def material(blocks: Blocks, air: float, air_scatter: float | None = None) -> tuple[float, float, float]:
    """Return polarity, the threshold of a first, coarse search, and the least that noise allows, both above the air.

    ``blocks`` are block means; a sheet is what stands out from the air's own scatter, which is that of the half nearest
    to the air where ``air_scatter`` is not given.
    """
    subset = blocks.ravel()[:: 1 + blocks.size // _ENOUGH]
    deviation = subset[np.isfinite(subset)].astype(np.float64) - air
    size = np.abs(deviation)
    scatter = mad_sd(deviation[size <= np.percentile(size, 50)]) if air_scatter is None else air_scatter
    scatter = max(scatter, 1e-3 * float(np.ptp(deviation)), 1e-9)
    bright = deviation > _SIGMAS * scatter
    dark = deviation < -_SIGMAS * scatter
    if max(np.count_nonzero(bright), np.count_nonzero(dark)) < 1e-4 * deviation.size:
        raise VolumeError(
            f"There is no sheet in the volume: all of it lies within {_SIGMAS:g} standard deviations of the air's grey "
            f"({air:.4g}). Check that this is the reconstructed volume, and --through."
        )
    polarity = 1.0 if size[bright].sum() >= size[dark].sum() else -1.0
    typical = float(np.median(size[bright if polarity > 0 else dark]))
    ends = np.concatenate([blocks[..., :3].ravel(), blocks[..., -3:].ravel()]).astype(np.float64)
    least = max(_FEWER_SIGMAS * mad_sd(ends), 0.08 * typical)
    return polarity, max(_SIGMAS * scatter, 0.35 * typical), least


def _above_air(blocks: Blocks, air: float, polarity: float) -> Blocks:
    """Grey above the air, 0 where it is missing; in place, because block means fill a good part of the memory."""
    above = np.where(np.isfinite(blocks), blocks, np.float32(air))
    above -= np.float32(air)
    above *= np.float32(polarity)
    return above


def _refined(oriented: Blocks, threshold: float, choice: Choice) -> CoarseSheet:
    """Find the sheet with a threshold, and once more with a better one."""
    sheet = search_sheet(oriented, oriented > threshold, threshold, choice)
    rows, cols = np.nonzero(np.isfinite(sheet.low) & np.isfinite(sheet.high))
    if rows.size == 0:
        raise VolumeError(
            "No column of the volume shows both faces of the sheet. The sheet leaves the volume on one side, or it is "
            "not the axis through the sheet that was named with --through."
        )
    low, high = sheet.low[rows, cols], sheet.high[rows, cols]
    depth = np.rint(low[:, None] + (high - low)[:, None] * np.linspace(*CORE, 7)).astype(int)
    # The core tells the base's level, and that a better threshold: half way between air and base.
    base = float(np.median(oriented[rows[:, None], cols[:, None], depth].astype(np.float64)))
    threshold = max(threshold * 0.7, 0.5 * base)
    return search_sheet(oriented, oriented > threshold, threshold, choice)


def _chosen(oriented: Blocks, sharp: Blocks, threshold: float, choice: Choice) -> tuple[CoarseSheet, bool]:
    """Find the sheet at the seed, and tell whether what lies beside it is other material and not air."""
    assert choice.seed is not None
    failure: VolumeError | None = None
    # In air the usual threshold will do. Amid other material it is raised until the sheet stands alone.
    try:
        sheet = _refined(oriented, threshold, choice)
        if _merged(sheet) < 0.15:  # of the sheet that may touch others; with a higher threshold it may be less
            return sheet, False
    except VolumeError as error:
        failure = error
    own_grey = float(seed_grey(sharp, choice.seed).max())
    if failure is not None and own_grey < _CLEAR * float(np.percentile(sharp, 99)):
        raise failure
    # The best of them shows both faces, without a neighbour, in the most columns.
    most, best = 0, None
    for share in _SHARES:
        inside = (sharp > share * own_grey) & (sharp < _BRIGHTER * own_grey)
        try:
            sheet = followed_sheet(sharp, inside, float(share * own_grey), choice)
        except VolumeError as error:
            failure = error
            continue
        shown = int(np.count_nonzero(np.isfinite(sheet.low) & np.isfinite(sheet.high)))
        if shown > most and _merged(sheet) < 0.6:  # above it the sheet cannot be followed
            most, best = shown, sheet
    if best is not None:
        return best, True
    raise VolumeError(
        f"The object at the seed point {choice.describe(choice.seed)} um (z, y, x) touches others at every grey: "
        "it cannot be separated from them. Crop the volume to a part where it stands alone, or "
        "choose another point with --seed-um."
    ) from failure


def _shows_as_much(alone: CoarseSheet, sheet: CoarseSheet) -> bool:
    """Tell if a sheet that was found without the seed is the one at the seed, in as many columns."""
    # Then nothing lies beside it, and its faces need not be told from those of others, which takes sheets of few voxels
    # for their own blur.
    first, second = (np.isfinite(s.low) & np.isfinite(s.high) for s in (alone, sheet))
    thick = [float(np.median((s.high - s.low)[shown])) for s, shown in ((alone, first), (sheet, second)) if shown.any()]
    same = len(thick) < 2 or abs(thick[0] - thick[1]) <= _SAME_DEPTH
    return bool(same and np.count_nonzero(first) >= np.count_nonzero(second))


def _stands_apart(material: Bools, sheet: CoarseSheet) -> bool:
    """Tell if so much air lies beside a sheet that no search for its faces meets another object."""
    least_gap = max(_LEAST_GAP, 4 + 3 * sheet.block)
    depth = np.arange(material.shape[2])
    near = 0
    for inside, low, high in zip(material, sheet.low, sheet.high, strict=True):  # row by row: it takes less memory
        away = np.fmax(low[:, None] - depth, depth - high[:, None])
        near += np.count_nonzero((inside & (away > 2) & (away < least_gap)).any(axis=1))
    return bool(near < _NEAR_SHARE * sheet.low.size)


def _merged(sheet: CoarseSheet) -> float:
    """Share of the sheet that touches others."""
    measured, touching = np.isfinite(sheet.low) | np.isfinite(sheet.high), np.count_nonzero(sheet.touching)
    return touching / max(np.count_nonzero(measured) + touching, 1)


def seed_grey(sharp: Blocks, seed: tuple[int, int, int]) -> Floats:
    """Grey around the seed point, at the depth before it, at its own, and after it."""
    near = tuple(slice(max(k - 1, 0), k + 2) for k in seed)
    return np.asarray(np.median(sharp[near], axis=(0, 1)), dtype=np.float64)
