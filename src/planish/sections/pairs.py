"""Find the offsets between two sections from the band along the sheet.

They come from texture and faces, by gradients, in parts of the columns.

Neighbouring samples share their fibres; parts of some 150 um are independent: their scatter is the
error of an offset.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from planish.core.robust import MAD_TO_SD, mad_sd
from planish.core.threads import map_threads
from planish.core.typing import Bools, Floats, Ints, Pair, Shape2D, Singles
from planish.sections._kernels import pair_sums, smooth, straighten
from planish.sections.band import SectionSeries, SheetBand, Stack

Samples = Singles
FINEST_UM = 3.0  # with wider pixels the fine bands would show no more than the others
_MARGIN_UM = 30.0  # beyond the faces
_PART_UM = 150.0  # five times the reach of the texture
_PARTS = (8, 48)
GROUPS = 6  # runs of parts that are left out in turn: parts side by side share some of their errors
_OUTLIER_SIGMAS = 4.0
# Of Newton's step, what one with fixed weights goes at least: no step is made more than four times
# as long. With errors of a Gaussian 0.6 to 0.75 are usual.
_LEAST_REACHED = 0.25
# Rotations are carried as the shift at this distance, so that all unknowns are alike in size.
_TURN_UM = 1000.0
_ALIKE = 0.5  # correlation of two bands below which they do not show the same sheet
_BLOCK = 32  # sections that a thread takes at a time


def in_pixels(poses: Floats, pixel_um: Pair) -> Floats:
    """Poses (..., 3), (row, col) in um and rotation in rad, as the kernels take them (..., 4).

    Shifts are in pixels, the turn of a row, then that of a column, in pixels per pixel.
    """
    row_um, col_um = pixel_um
    row, col, turn = np.moveaxis(poses, -1, 0)
    row_per_col = turn * col_um / row_um
    col_per_row = turn * row_um / col_um
    columns = (row / row_um, col / col_um, row_per_col, col_per_row)
    return np.stack(columns, axis=-1)


class SectionPairs(NamedTuple):
    """Offsets between pairs of sections.

    Each is the pose of the second less that of the first, along row and col in um, and in rad.

    Where ``is_sound``, the offset is also known well enough. The offsets follow from
    ``normal_sums`` (pairs, parts, 15) and ``base_offset`` (pairs, 3), the difference of the bands'
    poses; fine bands show no rotation.
    """

    first: Ints
    second: Ints
    offset: Floats
    sigma: Floats
    is_same_sheet: Bools
    is_sound: Bools
    normal_sums: Floats
    base_offset: Floats
    is_fine: bool

    def sound(self, axis: int) -> tuple[Ints, Ints, Floats, Floats]:
        """First and second section of the sound pairs, their offset along an axis, its sigma."""
        is_sound = self.is_sound
        offset = self.offset[is_sound, axis]
        sigma = self.sigma[is_sound, axis]
        return self.first[is_sound], self.second[is_sound], offset, sigma

    def without(self, group: int) -> SectionPairs:
        """Return the same pairs without one group of the columns, of `GROUPS`.

        One step from where all columns agree, as far as Newton's goes: the weights of the samples
        give way with it, so that a step with fixed weights is too short.
        """
        n_parts = self.normal_sums.shape[1]
        group_of_part = np.arange(n_parts) * GROUPS // n_parts
        fewer_pairs = _solve(self._replace(normal_sums=self.normal_sums[:, group_of_part != group]))
        total = self.normal_sums.sum(axis=1)
        # What a displacement along row and col changes, with fixed weights and as it is.
        fixed = total[:, [0, 3]]
        reached = np.divide(total[:, 13:], fixed, out=np.ones_like(fixed), where=fixed > 0)
        step = fewer_pairs.offset - self.base_offset
        step[:, :2] /= np.clip(reached, _LEAST_REACHED, 1.0)
        offset = self.base_offset + step
        return fewer_pairs._replace(offset=offset, normal_sums=self.normal_sums)


class Bands(NamedTuple):
    """Makes straightened bands of sections and compares them.

    Fine bands show texture between some 1 and 4 um along the columns; what is wider wanders along
    the columns with fibres that come and go, and would hold the offset with it.
    """

    stack: Stack
    band: SheetBand
    pixel_um: Pair
    is_fine: bool = False

    @property
    def step(self) -> Shape2D:
        """Pixels per sample along rows and cols: about so many um."""
        row_um, col_um = self.pixel_um
        row_step_um, col_step_um = (1.6, 0.8) if self.is_fine else (2.5, 5.0)
        row_step = round(row_step_um / row_um)
        col_step = min(round(col_step_um / col_um), self.stack.shape[2] // 64)
        return max(1, row_step), max(1, col_step)

    @property
    def pitch_um(self) -> Pair:
        """Distance of the samples along rows and cols."""
        down, across = self.step
        row_um, col_um = self.pixel_um
        return down * row_um, across * col_um

    def samples(self, section: int, pose: Floats) -> tuple[Samples, Samples]:
        """Give the smoothed band of a section, and the heights of its columns in um.

        The band is (samples across the sheet, samples along it); each sample is a mean of ``step``
        pixels, NaN where the band leaves the section. Its grey is 0 off the sheet and 1 in it; of
        fine bands the mean along the columns is taken off, so it is about 0 everywhere.

        Heights, one for each column of samples, are those of the smooth course of the sheet in the
        corrected section: from the section's middle row, positive towards larger rows.

        ``pose``, (row, col) in um and rotation in rad, is taken off the grey; it does not change
        the heights.
        """
        _, rows, cols = self.stack.shape
        down, across = self.step
        pitch_r, pitch_c = self.pitch_um
        pixel_r, pixel_c = self.pixel_um
        height = self.band.heights(section, cols)
        width_um = 2 * (self.band.half_um + _MARGIN_UM)
        n_rows = max(5, round(width_um / pitch_r))
        samples = np.zeros((n_rows, cols // across), np.float32)
        first_row = -0.5 * (n_rows * down - 1)
        pose_px = in_pixels(pose, self.pixel_um)
        straighten(self.stack[section], height, first_row, down, across, pose_px, samples)
        samples -= np.float32(self.band.background[section])
        samples /= np.float32(self.band.contrast[section])
        self._replace_knife_marks(samples)
        # Wide against the shifts to be measured, narrow against the texture; or one pixel.
        blur = max(1.0, pixel_c) if self.is_fine else 6.0
        smoothed = _smoothed(samples, _gaussian(blur / pitch_r), _gaussian(blur / pitch_c))
        if self.is_fine:
            # A Gaussian of four blurs, whose mean along the columns is taken off.
            wide = _gaussian(4.0 * blur / pitch_c)
            smoothed -= _smoothed(smoothed, np.ones(1, np.float32), wide)
        sample_height = np.interp(self._sample_cols(), np.arange(cols), height)
        height_um = sample_height * pixel_r - 0.5 * (rows - 1) * pixel_r
        return smoothed, height_um.astype(np.float32)

    def _sample_cols(self) -> Floats:
        """Columns of the section in the middles of the samples."""
        across = self.step[1]
        n_samples = self.stack.shape[2] // across
        numbers = np.arange(n_samples, dtype=np.float64)
        return (numbers + 0.5) * across - 0.5

    def _replace_knife_marks(self, samples: Samples) -> None:
        """Replace columns in which the resin shows a knife mark by those beside.

        A knife's nick stays where it is, and would hold the offset with it. ``samples`` (across the
        sheet, along it) are changed. Where more than 30 % of the columns are marked, nothing is.
        """
        rim_rows = max(1, int(0.7 * _MARGIN_UM / self.pitch_um[0]))
        rims = np.concatenate([samples[:rim_rows], samples[-rim_rows:]])
        profile = rims.mean(axis=0)
        if not np.isfinite(profile).all():
            return
        # Window of the median against which a mark stands out by five sigma.
        window = max(1, round(75.0 / self.pitch_um[1]))
        deviation = np.abs(profile - median_filter(profile, window, mode="nearest"))
        is_mark = deviation > 5.0 * mad_sd(deviation, 0.0)
        # With the mark's surroundings.
        margin = max(1, round(5.0 / self.pitch_um[1]))
        is_marked = np.convolve(is_mark, np.ones(2 * margin + 1), mode="same") > 0
        clean_cols = np.flatnonzero(~is_marked)
        marked_cols = np.flatnonzero(is_marked)
        if marked_cols.size == 0 or marked_cols.size > 0.3 * is_marked.size:
            return
        after = np.searchsorted(clean_cols, marked_cols)
        after = np.clip(after, 1, clean_cols.size - 1)
        a, b = clean_cols[after - 1], clean_cols[after]
        weight = np.clip((marked_cols - a) / (b - a), 0.0, 1.0).astype(np.float32)
        filling = samples[:, a] * (1 - weight) + samples[:, b] * weight
        samples[:, marked_cols] = filling

    def normal_sums(self, pose: Floats, first: Ints, second: Ints) -> Floats:
        """Sums of `pair_sums` for pairs that are ordered by the first section.

        (pairs, parts, 15). ``pose`` (sections, 3) is taken off the bands before.
        """
        width = self.stack.shape[2]
        col_um = self.pixel_um[1]
        x_um = (self._sample_cols() - 0.5 * (width - 1)) * col_um
        n_parts = int(np.clip(width * col_um / _PART_UM, *_PARTS))
        # A block of sections at a time: each band is made once or twice, and few are held.
        begins = range(0, pose.shape[0], _BLOCK)
        ends = np.searchsorted(first, begins)[1:]
        blocks = (np.split(sections, ends) for sections in (first, second))
        sums = partial(self._block_sums, pose, x_um=x_um.astype(np.float32), n_parts=n_parts)
        return np.concatenate(map_threads(sums, *blocks))

    def _block_sums(
        self, pose: Floats, first: Ints, second: Ints, x_um: Samples, n_parts: int
    ) -> Floats:
        """Sums (pairs, parts, 15) of some pairs; bands are made when they are first needed.

        ``pose`` (sections, 3) is taken off; pairs are ordered by the first section. ``x_um`` are
        the places of the samples along the columns, from the section's middle.
        """
        sums = np.zeros((first.size, n_parts, 15))
        bands: dict[int, tuple[Samples, Samples]] = {}
        pairs = zip(first.tolist(), second.tolist(), strict=True)
        for k, (i, j) in enumerate(pairs):
            # Pairs are ordered by the first section: those before it are not needed again.
            for passed_section in [s for s in bands if s < i]:
                del bands[passed_section]
            for s in (i, j):
                if s not in bands:
                    bands[s] = self.samples(s, pose[s])
            (a, y_a), (b, y_b) = bands[i], bands[j]
            # Beyond a limit a sample of a row is an outlier, and its residual has a weight. Rows in
            # which faces lie, which are rough, count less. No row counts more than the median row,
            # or the empty resin would count.
            difference = np.abs(a[:, ::4] - b[:, ::4])
            is_valid = np.isfinite(difference)
            difference_sum = np.where(is_valid, difference, 0.0).sum(axis=1)
            mean_difference = difference_sum / np.maximum(is_valid.sum(axis=1), 1)
            least = max(float(np.median(mean_difference)), 1e-6)
            mean_difference = np.maximum(mean_difference, least)
            limit = _OUTLIER_SIGMAS * 1.2533 * mean_difference
            trust = (mean_difference.min() / mean_difference) ** 2
            # Columns move along the sheet here, not at a fixed row: where the sheet is tilted, its
            # faces would else tell the shift along the columns, and every unevenness of the smooth
            # surface would count as one. What this neglects vanishes with the shift itself, after
            # two or three rounds.
            y_um = 0.5 * (y_a + y_b)
            is_fine = float(self.is_fine)
            pair_sums(a, b, x_um, y_um, self.pitch_um, n_parts, limit, trust, sums[k], is_fine)
        return sums


def _smoothed(samples: Samples, row_weights: Samples, col_weights: Samples) -> Samples:
    """Samples (rows, cols) with odd numbers of weights along the rows' axis and the other."""
    out = np.empty_like(samples)
    padded_row = np.empty(samples.shape[1] + col_weights.size, np.float32)
    smooth(samples, row_weights, col_weights, padded_row, out)
    return out


def compare(
    series: SectionSeries, pose: Floats, first: Ints, second: Ints, *, is_fine: bool = False
) -> SectionPairs:
    """Give the offsets of pairs of sections, ordered by the first.

    They are found in bands that are straightened by the poses of the sections, ``pose`` (sections,
    3), and are added to the difference of both.

    Fine bands show neither a rotation nor whether both are of one sheet.
    """
    bands = Bands(stack=series.stack, band=series.band, pixel_um=series.pixel_um, is_fine=is_fine)
    normal_sums = bands.normal_sums(pose, first, second)
    # Enough of both is there, and they go up and down together.
    total = normal_sums.sum(axis=1)
    difference, squares, used, present = total[:, 9:13].T
    likeness = 1.0 - difference / np.maximum(squares, 1e-12)
    is_enough = (used > 0.5 * present) & (present > 0)
    is_same_sheet = (likeness > _ALIKE) & is_enough | is_fine
    base_offset = pose[second] - pose[first]
    unsolved = SectionPairs(
        first=first,
        second=second,
        offset=base_offset,
        sigma=np.full(base_offset.shape, np.inf),
        is_same_sheet=is_same_sheet,
        is_sound=np.zeros_like(is_same_sheet),
        normal_sums=normal_sums,
        base_offset=base_offset,
        is_fine=is_fine,
    )
    return _solve(unsolved)


def _solve(pairs: SectionPairs) -> SectionPairs:
    """Solve for the offset of each pair by least squares, in which torn parts weigh less.

    Gives the pairs with their offsets, the errors of these, and whether they are sound. Each part
    of the columns has normal equations of its own: their sum gives the offset, and how far the
    parts pull away from it, its error.
    """
    normal_sums = pairs.normal_sums
    n_pairs, n_parts, _ = normal_sums.shape
    n_unknowns = 2 if pairs.is_fine else 3
    scale = np.array([1.0, 1.0, _TURN_UM])[:n_unknowns]
    rows, cols = np.triu_indices(3)
    full_matrix = np.zeros((n_pairs, n_parts, 3, 3))
    full_matrix[..., rows, cols] = normal_sums[..., :6]
    full_matrix[..., cols, rows] = normal_sums[..., :6]
    normal_matrix = full_matrix[..., :n_unknowns, :n_unknowns] / np.outer(scale, scale)
    right_side = -normal_sums[..., 6 : 6 + n_unknowns] / scale
    part_weights = np.ones((n_pairs, n_parts))
    # So little that it counts only where nothing else tells an unknown.
    row_stiffness = normal_matrix.sum(axis=1)[:, :1, :1]
    ridge = 1e-6 * np.eye(n_unknowns) * np.maximum(row_stiffness, 1e-12)
    solution = np.zeros((n_pairs, n_unknowns))
    covariance = np.zeros((n_pairs, n_unknowns, n_unknowns))
    for _ in range(3):
        weighted_matrix = part_weights[..., None, None] * normal_matrix
        inverse = np.linalg.inv(weighted_matrix.sum(axis=1) + ridge)
        total_right_side = (part_weights[..., None] * right_side).sum(axis=1)
        solution = np.einsum("pij,pj->pi", inverse, total_right_side)
        # What each part would still pull: the spread of these is the error, and a part that pulls
        # too far is torn.
        residual = right_side - np.einsum("pkij,pj->pki", normal_matrix, solution)
        scatter = np.einsum("pk,pki,pkj->pij", part_weights**2, residual, residual)
        covariance = np.einsum("pij,pjk,pkl->pil", inverse, scatter, inverse)
        # A part of the columns weighs less where it pulls farther than the others.
        stiffness = np.maximum(np.einsum("pkii->pki", normal_matrix), 0.0)
        pull = np.abs(residual / np.sqrt(stiffness + 1e-12))
        usual_pull = MAD_TO_SD * np.median(pull, axis=1, keepdims=True)
        sigmas = np.max(pull / (usual_pull + 1e-12), axis=2)
        part_weights = _OUTLIER_SIGMAS / np.maximum(sigmas, _OUTLIER_SIGMAS)
    offset = pairs.base_offset.copy()
    offset[:, :n_unknowns] += solution / scale
    sigma = np.full((n_pairs, 3), np.inf)
    variance = np.einsum("pii->pi", covariance)
    sigma[:, :n_unknowns] = np.sqrt(variance * n_parts / max(n_parts - 1, 1))
    is_solved = np.isfinite(solution).all(axis=1)
    # An offset that is not known to 5 um is none.
    is_solved &= (sigma[:, :2] < 5.0).all(axis=1)
    is_sound = pairs.is_same_sheet & is_solved
    sigma = np.maximum(sigma, 0.02)  # no pair is better than this, whatever its parts say
    sigma[:, 2] /= _TURN_UM
    return pairs._replace(offset=offset, sigma=sigma, is_sound=is_sound)


def _gaussian(sigma: float) -> Samples:
    """Weights of a Gaussian, up to three standard deviations of so many samples."""
    far = max(1, int(np.ceil(3 * sigma)))
    z = np.arange(-far, far + 1) / sigma
    weights = np.exp(-0.5 * z**2)
    return (weights / weights.sum()).astype(np.float32)
