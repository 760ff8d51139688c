"""Find roughly where the sheet is.

Block means, one connected slab, and how far it reaches in each block column.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.errors import VolumeError
from planish.core.grid import at_index, first_and_last
from planish.core.typing import Bools, Floats, Shape2D, Singles, TwoFields
from planish.surface import _kernels
from planish.surface.centre import block_positions, interpolate

Blocks = Singles
"""Means over blocks of columns: (block rows, block cols, depth)."""
Labels = NDArray[np.integer]
BlockIndex = tuple[int, int, int]  # block row, block column and depth
CORE = (0.35, 0.65)  # share of the way through the sheet that counts as its core
_LEAVES = 0.5  # share of columns that may run out of the volume
_LEAST_COVER = 0.02
_CHOOSE = (
    "Choose one by its grey values with `sheet_grey=LOW,HIGH`, by a point in it with "
    "`seed_um=Z,Y,X`, or crop the volume."
)
MERGED = 1.6
"""Times the usual thickness: two sheets that touch, or one that folds back."""


class Companion(NamedTuple):
    """A flat object beside the sheet, beyond air."""

    thickness_px: float  # median, in voxels of depth
    facing: Floats  # (block rows, block cols): its face towards the sheet as a depth index
    share: float  # of the columns
    end: Literal["low", "high"]  # of the axis through the sheet at which it lies


@dataclass(frozen=True, slots=True, kw_only=True)
class CoarseSheet:
    """Extent of the sheet in each block column, in voxels of depth, NaN where there is none."""

    # (block rows, block cols): first and last depth index, interpolated to the threshold.
    low: Floats
    high: Floats
    block: int  # edge of a block in voxels
    is_leaving: Bools  # (block rows, block cols): where the sheet runs out of the volume
    threshold: float  # grey above the air at which the extent was measured
    # (block rows, block cols): where it touches another sheet or folds back on itself, as far as
    # that is known.
    is_touching: Bools
    specks: int = 0  # other objects in the air beside the sheet
    # A film, mount or other sheet that air parts from this one.
    companions: tuple[Companion, ...] = ()

    @property
    def is_whole(self) -> Bools:
        """Block columns with both faces."""
        return np.isfinite(self.low) & np.isfinite(self.high)


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """Which object is the sheet."""

    block: int  # edge of a block in voxels
    # Turns such a point into what a user would give as a seed.
    describe: Callable[[BlockIndex], str]
    # Block row, block column and depth of a point in it; the largest object where not given.
    seed: BlockIndex | None = None
    may_lead: bool = False  # of several, the one that is coated or thicker than the others


def search_sheet(blocks: Blocks, inside: Bools, threshold: float, choice: Choice) -> CoarseSheet:
    """Measure the sheet at the seed, or the only slab ``inside``.

    VolumeError if none, several, or from end to end. ``blocks``: grey above the air; ``inside``,
    as these: what may be sheet; ``threshold``: grey at which its faces are placed.
    """
    if choice.seed is not None:
        return followed_sheet(blocks, inside, threshold, choice)
    labels, n_objects = ndimage.label(inside)
    if n_objects == 0:
        raise VolumeError(
            "There is no sheet in the volume: nothing has the grey that was asked for. Check"
            " `sheet_grey`."
        )
    n_covered, n_blocks = _counts(labels, n_objects)
    covered_shares = n_covered / labels[..., 0].size
    by_cover = np.argsort(n_covered[1:])[::-1] + 1
    sheet_label = int(by_cover[0])
    if covered_shares[sheet_label] < _LEAST_COVER:
        raise VolumeError(
            "There is no sheet in the volume: the largest connected object covers"
            f" {100 * covered_shares[sheet_label]:.2g} % of the columns. Check `through` (the axis"
            " that runs through the sheet) and `sheet_grey`."
        )
    least = 0.25 * n_covered[sheet_label]
    sheet_labels = [int(k) for k in by_cover[:6] if n_covered[k] > least]
    leading_label = _leading(labels, sheet_labels, blocks) if choice.may_lead else None
    if leading_label is not None:
        sheet_label = leading_label
    elif len(sheet_labels) > 1:
        shares_text = ", ".join(f"{100 * covered_shares[k]:.0f} %" for k in sheet_labels)
        points_text = _points_text(labels, sheet_labels, blocks, inside, threshold, choice)
        raise VolumeError(
            f"The volume shows {len(sheet_labels)} separate sheets (they cover {shares_text} of the"
            f" columns). {_CHOOSE} {points_text}"
        )
    in_sheet = labels == sheet_label
    _check_slab(in_sheet)
    low, high = _extent_of(blocks, in_sheet, threshold)
    # Fewer blocks are noise.
    specks = int(np.count_nonzero(n_blocks[1:] >= 8)) - len(sheet_labels)
    sheet_labels.remove(sheet_label)
    companions = [_companion(blocks, labels == k, low, high) for k in sheet_labels]
    return CoarseSheet(
        low=low,
        high=high,
        block=choice.block,
        is_leaving=in_sheet[..., 0] | in_sheet[..., -1],
        threshold=threshold,
        is_touching=np.zeros(low.shape, bool),
        specks=specks,
        companions=tuple(companions),
    )


def _counts(labels: Labels, n_objects: int) -> tuple[Labels, Labels]:
    """Columns in which each object appears, and its blocks, by label."""
    n_covered, n_blocks = np.zeros((2, n_objects + 1), np.int64)
    for label_row in labels:
        ordered = np.sort(label_row, axis=-1)
        is_first = np.diff(ordered, axis=-1, prepend=-1) > 0
        n_covered += np.bincount(ordered[is_first], minlength=n_objects + 1)
        n_blocks += np.bincount(ordered.ravel(), minlength=n_objects + 1)
    return n_covered, n_blocks


def _check_slab(in_sheet: Bools) -> None:
    """Raise VolumeError if a slab leaves the volume, or is several sheets behind each other.

    ``in_sheet`` (block rows, block cols, depth).
    """
    n_filled = in_sheet.sum(axis=-1)
    has_sheet = n_filled > 0
    share_at_end = {"low": in_sheet[..., 0].mean()}
    share_at_end["high"] = in_sheet[..., -1].mean()
    end = max(share_at_end, key=share_at_end.__getitem__)
    leaving_share = share_at_end[end] / has_sheet.mean()
    if leaving_share > _LEAVES:
        raise VolumeError(
            f"Material reaches the {end} end of the axis through the sheet in"
            f" {100 * leaving_share:.0f} % of the columns: the sheet leaves the volume there, or"
            f" several sheets lie behind each other. {_CHOOSE}"
        )
    low, high = first_and_last(in_sheet)
    filled_share = np.median(n_filled[has_sheet] / (high - low + 1)[has_sheet])
    if filled_share < 0.4:
        raise VolumeError(
            "Along the axis through the sheet the material has gaps: half of the columns are"
            f" filled by less than {100 * filled_share:.0f} %, so several sheets lie behind each"
            f" other. {_CHOOSE}"
        )


def _points_text(
    labels: Labels,
    sheet_labels: list[int],
    blocks: Blocks,
    inside: Bools,
    threshold: float,
    choice: Choice,
) -> str:
    """Name a point inside each object from which a whole sheet can be followed, for a message.

    The middle of the object in its column next to the middle of all. ``labels`` as ``blocks``:
    number of the object of each voxel.
    """
    points: list[str] = []
    for label in sheet_labels:
        in_object = labels == label
        rows, cols = np.nonzero(in_object.any(axis=-1))
        down = rows - np.median(rows)
        across = cols - np.median(cols)
        k = int(np.argmin(down**2 + across**2))
        depth = np.flatnonzero(in_object[rows[k], cols[k]])
        point = int(rows[k]), int(cols[k]), int(depth[depth.size // 2])
        with suppress(VolumeError):
            followed_sheet(blocks, inside, threshold, replace(choice, seed=point))
            points.append(choice.describe(point))
    if points:
        return f"Points to start from: {'; '.join(points)}."
    return (
        "No point leads to a whole sheet: each of them leaves the volume, so crop it or check"
        " `through`."
    )


_BRIGHTER, _THICKER = 1.3, 1.2  # times the others
# Brightest tenth of an object's inside over its median: film is of one grey, paper is coated or
# full of pores.
_UNEVEN = 1.25
_RIM = 2  # voxels of depth at either end of an object that the blur and the block means dim


def _leading(labels: Labels, candidates: Sequence[int], blocks: Blocks) -> int | None:
    """Return the label of the object that alone is paper.

    It lies above or below all others, and is brighter or thicker than they are.

    None where there is no such object: a sheet that came apart is several objects of paper, and
    none of them leads. ``candidates``: labels of the objects.
    """
    covered: list[Bools] = []
    is_uneven: list[bool] = []
    bright: list[float] = []
    thick: list[float] = []
    for label in candidates:
        in_object = labels == label
        median, brightest = np.percentile(blocks[_inside(in_object)], [50, 90])
        is_uneven.append(bool(brightest >= _UNEVEN * median))
        bright.append(float(brightest))
        n_filled = in_object.sum(axis=-1).ravel()
        covered.append(n_filled > 0)
        thick.append(float(np.median(n_filled[n_filled > 0])))
    if len(candidates) < 2 or sum(is_uneven) != 1:
        return None
    leader = is_uneven.index(True)
    is_brighter = bright[leader] >= _BRIGHTER * np.array(bright)
    is_thicker = thick[leader] >= _THICKER * np.array(thick)
    # Above or below the leader where half of its columns are also the leader's.
    n_shared = np.count_nonzero(np.array(covered) & covered[leader], axis=1)
    lies_across = n_shared >= 0.5 * np.count_nonzero(covered, axis=1)
    is_behind = (is_brighter | is_thicker) & lies_across
    is_behind[leader] = True
    return candidates[leader] if is_behind.all() else None


def _inside(in_object: Bools) -> Bools:
    """Blocks of an object that are no rim: in thin places the middle ones."""
    first, last = first_and_last(in_object)
    rim = np.minimum(_RIM, (last - first) // 2)
    depth = np.arange(in_object.shape[-1])
    is_below = depth >= (first + rim)[..., None]
    return in_object & is_below & (depth <= (last - rim)[..., None])


def _companion(blocks: Blocks, in_object: Bools, low: Floats, high: Floats) -> Companion:
    """Measure an object beside the sheet from ``low`` to ``high``: its faces at half its grey."""
    level = 0.5 * float(np.median(blocks[in_object]))
    is_core = in_object & (blocks > level)
    own_low, own_high = _extent_of(blocks, is_core, level)
    thickness_px = float(np.nanmedian(own_high - own_low))
    share = float(is_core.any(axis=-1).mean())
    if np.nanmedian(low - own_high) > np.nanmedian(own_low - high):
        return Companion(thickness_px, own_high, share, "low")
    return Companion(thickness_px, own_low, share, "high")


def followed_sheet(blocks: Blocks, inside: Bools, threshold: float, choice: Choice) -> CoarseSheet:
    """Follow the sheet at the seed point from column to column; VolumeError if there is none.

    As :func:`search_sheet`. Or if it covers too few columns, or runs out of the volume in most.
    """
    assert choice.seed is not None
    seed = np.asarray(choice.seed)
    window_start = np.maximum(seed - 3, 0)  # a seed point may lie so many voxels beside its object
    window = tuple(map(slice, window_start, seed + 4))
    material_indices = np.argwhere(inside[window])
    if material_indices.size == 0:
        raise VolumeError(
            f"There is only air at the seed point {choice.describe(choice.seed)} um (z, y, x). Give"
            " a point inside the sheet with `seed_um`."
        )
    # The nearest block of material to the seed point.
    material_indices += window_start
    squares = (material_indices - seed) ** 2
    nearest = np.argmin(squares.sum(axis=1))
    row, col, depth = material_indices[nearest].tolist()
    run = inside[row, col]
    outside = np.flatnonzero(~run)
    start = int(outside[outside < depth].max(initial=-1)) + 1
    stop = int(outside[outside > depth].min(initial=run.size)) - 1
    # The seed's own run says roughly how thick the sheet is, the median of what was found then says
    # it well.
    seed_run = row, col, start, stop
    seed_length = stop - start + 1
    low, high, _ = _follow(inside, seed_run, 2.0 * seed_length + 2.0)
    usual_run = float(np.median((high - low + 1)[low >= 0]))
    low, high, is_merged = _follow(inside, seed_run, MERGED * usual_run + 1.0)
    has_sheet = low >= 0
    object_text = f"The object at the seed point {choice.describe((row, col, depth))} um (z, y, x)"
    if has_sheet.mean() < _LEAST_COVER:
        raise VolumeError(
            f"{object_text} covers {100 * has_sheet.mean():.2g} % of the columns only. Check"
            " `through` (the axis that runs through the sheet) and `seed_um`."
        )
    is_leaving = has_sheet & ((low == 0) | (high == inside.shape[2] - 1))
    leaving_share = np.mean(is_leaving[has_sheet])
    if leaving_share > _LEAVES:
        raise VolumeError(
            f"{object_text} reaches an end of the axis through the sheet in"
            f" {100 * leaving_share:.0f} % of its columns. Check `through` and `seed_um`."
        )
    low_face, high_face = _extent(blocks, low, high, threshold)
    return CoarseSheet(
        low=low_face,
        high=high_face,
        block=choice.block,
        is_leaving=is_leaving,
        threshold=threshold,
        is_touching=is_merged,
    )


def _follow(
    inside: Bools, seed_run: tuple[int, int, int, int], max_run: float
) -> tuple[Labels, Labels, Bools]:
    """First and last index of the sheet's runs, -1 for none, and where two sheets merge.

    ``seed_run``: row, column, first and last index of the run at the seed; longer ones than
    ``max_run`` belong to two sheets.
    """
    low = np.full(inside.shape[:2], -1, np.int64)
    high = low.copy()
    is_merged = np.zeros(low.shape, np.bool_)
    _kernels.follow(inside, *seed_run, max_run, low, high, is_merged)
    return low, high, is_merged


def flags_to_columns(field: Bools, block: int, shape: Shape2D) -> Bools:
    """Give every column the flag of its block."""
    positions = block_positions(shape, (block, block), field.shape)
    return field[np.ix_(*(np.rint(position).astype(int) for position in positions))]


def to_columns(field: Floats, block: int, shape: Shape2D) -> Floats:
    """Interpolate a block map to single columns; NaN where the nearest block is NaN."""
    return interpolate(field, block_positions(shape, (block, block), field.shape), order=1)


def _extent_of(blocks: Blocks, in_object: Bools, threshold: float) -> TwoFields:
    """Depth at which the grey of an object crosses the threshold at its low and its high end."""
    has_object = in_object.any(axis=-1)
    low, high = (np.where(has_object, index, -1) for index in first_and_last(in_object))
    return _extent(blocks, low, high, threshold)


def _extent(blocks: Blocks, low: Labels, high: Labels, threshold: float) -> TwoFields:
    """Move first and last index (-1: none) outwards to where the grey crosses the threshold.

    NaN for none. The indices, (block rows, block cols), are those of the last samples inside.
    """
    # A sheet that touches the end of its column is cut there: its face is not in the volume, and
    # that end is NaN.
    extents: list[Floats] = []
    last = blocks.shape[-1] - 1
    for index, outward, end in ((low, -1, 0), (high, 1, last)):
        inner = at_index(blocks, np.clip(index, 0, last)).astype(float)
        outer = at_index(blocks, np.clip(index + outward, 0, last)).astype(float)
        fall = inner - outer
        divisor = np.where(np.abs(fall) > 1e-12, fall, 1.0)
        share = np.clip((inner - threshold) / divisor, 0.0, 1.0)
        has_face = (index >= 0) & (index != end)
        extents.append(np.where(has_face, index + outward * share, np.nan))
    return extents[0], extents[1]
