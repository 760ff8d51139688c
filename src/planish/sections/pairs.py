"""Offsets between two sections from the band along the sheet: texture and faces, by gradients, in parts of the columns.

Neighbouring samples share their fibres; parts of some 150 um are independent: their scatter is the error of an offset.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from planish.core.threads import map_threads
from planish.core.typing import Bools, Floats
from planish.sections._kernels import pair_sums, smooth, straighten
from planish.sections.band import SectionSeries, SheetBand, Stack
from planish.sections.network import Index

Samples = NDArray[np.float32]

FINEST_UM = 3.0  # with wider pixels the fine bands would show no more than the others
_MARGIN_UM = 30.0  # beyond the faces
_PART_UM = 150.0  # five times the reach of the texture
_PARTS = (8, 48)
GROUPS = 6  # runs of parts that are left out in turn: parts side by side share some of their errors
_OUTLIER_SIGMAS = 4.0
_TURN_UM = 1000.0  # rotations are carried as the shift at this distance, so that all unknowns are alike in size
_ALIKE = 0.5  # correlation of two bands below which they do not show the same sheet
_BLOCK = 32  # sections that a thread takes at a time


class SectionPairs(NamedTuple):
    """Offsets between pairs of sections: pose of the second less that of the first, along row and col in um, and rad.

    ``alike`` pairs show the same sheet, and the offset of ``sound`` ones is also known well enough. The offsets follow
    from ``sums`` (pairs, parts, 13) and ``base`` (pairs, 3), the difference of the poses with which the bands were
    made; ``fine`` bands show no rotation.
    """

    first: Index
    second: Index
    offset: Floats
    sigma: Floats
    alike: Bools
    sound: Bools
    sums: Floats
    base: Floats
    fine: bool

    def without(self, group: int) -> SectionPairs:
        """Return the same pairs without one group of the columns, of `GROUPS`."""
        parts = self.sums.shape[1]
        remaining = np.arange(parts) * GROUPS // parts != group
        return _solve(self.sums[:, remaining], self.first, self.second, self.base, self.alike, self.fine)


class Bands(NamedTuple):
    """Makes straightened bands of sections and compares them.

    Fine bands show texture between some 1 and 4 um along the columns; what is wider wanders along the
    columns with fibres that come and go, and would hold the offset with it.
    """

    stack: Stack
    band: SheetBand
    pixel_um: tuple[float, float]
    fine: bool = False

    @property
    def step(self) -> tuple[int, int]:
        """Pixels per sample along rows and cols: about so many um."""
        rows_um, cols_um = (1.6, 0.8) if self.fine else (2.5, 5.0)
        across = min(round(cols_um / self.pixel_um[1]), self.stack.shape[2] // 64)
        return max(1, round(rows_um / self.pixel_um[0])), max(1, across)

    @property
    def pitch_um(self) -> tuple[float, float]:
        """Distance of the samples."""
        return self.step[0] * self.pixel_um[0], self.step[1] * self.pixel_um[1]

    def samples(self, section: int, pose: Floats) -> tuple[Samples, Samples]:
        """Smoothed band of a section, grey as 0 off the sheet and 1 in it, and the heights of its columns in um.

        ``pose``, (row, col) in um and rotation in rad, is taken off.
        """
        _, rows, cols = self.stack.shape
        (down, across), (pitch_r, pitch_c), (pixel_r, pixel_c) = self.step, self.pitch_um, self.pixel_um
        height = self.band.heights(section, cols)
        count = max(5, round(2 * (self.band.half_um + _MARGIN_UM) / pitch_r))
        samples = np.zeros((count, cols // across), np.float32)
        in_pixels = np.array(
            [pose[0] / pixel_r, pose[1] / pixel_c, pose[2] * pixel_c / pixel_r, pose[2] * pixel_r / pixel_c]
        )
        straighten(self.stack[section], height, -0.5 * (count * down - 1), down, across, in_pixels, samples)
        samples -= np.float32(self.band.background[section])
        samples /= np.float32(self.band.contrast[section])
        self._replace_knife_marks(samples)
        # Wide against the shifts to be measured, narrow against the texture; or one pixel.
        blur = max(1.0, pixel_c) if self.fine else 6.0
        smoothed = _smoothed(samples, _gaussian(blur / pitch_r), _gaussian(blur / pitch_c))
        if self.fine:
            # A Gaussian of four blurs, whose mean along the columns is taken off.
            smoothed -= _smoothed(smoothed, np.ones(1, np.float32), _gaussian(4.0 * blur / pitch_c))
        middle = (np.arange(samples.shape[1]) + 0.5) * across - 0.5
        height_um = np.interp(middle, np.arange(cols), height) * pixel_r
        return smoothed, (height_um - 0.5 * (rows - 1) * pixel_r).astype(np.float32)

    def _replace_knife_marks(self, samples: Samples) -> None:
        """Replace columns in which the resin shows a knife mark by those beside: a knife's nick stays where it is."""
        rim = max(1, int(0.7 * _MARGIN_UM / self.pitch_um[0]))
        profile = np.concatenate([samples[:rim], samples[-rim:]]).mean(axis=0)
        if not np.isfinite(profile).all():
            return
        # Window of the median against which a mark stands out by five sigma, and the mark's surroundings.
        window, margin = (max(1, round(length / self.pitch_um[1])) for length in (75.0, 5.0))
        away = np.abs(profile - median_filter(profile, window, mode="nearest"))
        marked = away > 5.0 * 1.4826 * float(np.median(away))
        marked = np.convolve(marked, np.ones(2 * margin + 1), mode="same") > 0
        good, bad = np.flatnonzero(~marked), np.flatnonzero(marked)
        if bad.size == 0 or bad.size > 0.3 * marked.size:
            return
        right = np.clip(np.searchsorted(good, bad), 1, good.size - 1)
        a, b = good[right - 1], good[right]
        share = np.clip((bad - a) / (b - a), 0.0, 1.0).astype(np.float32)
        samples[:, bad] = samples[:, a] * (1 - share) + samples[:, b] * share

    def sums(self, pose: Floats, first: Index, second: Index) -> Floats:
        """Sums of `pair_sums` for pairs that are ordered by the first section; (pairs, parts, 13)."""
        cols = self.stack.shape[2] // self.step[1]
        x = ((np.arange(cols) + 0.5) * self.step[1] - 0.5 - 0.5 * (self.stack.shape[2] - 1)) * self.pixel_um[1]
        parts = int(np.clip(self.stack.shape[2] * self.pixel_um[1] / _PART_UM, *_PARTS))

        # A block of sections at a time: each band is made once or twice, and few are held.
        def block(k: int) -> Floats:
            in_block = slice(np.searchsorted(first, k * _BLOCK), np.searchsorted(first, (k + 1) * _BLOCK))
            return self._block_sums(pose, first[in_block], second[in_block], x.astype(np.float32), parts)

        return np.concatenate(map_threads(block, range(-(-pose.shape[0] // _BLOCK))))

    def _block_sums(self, pose: Floats, first: Index, second: Index, x32: Samples, parts: int) -> Floats:
        sums = np.zeros((first.size, parts, 13))
        shared = 1.0 if self.fine else 0.0
        bands: dict[int, tuple[Samples, Samples]] = {}
        for k, (i, j) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
            for gone in [s for s in bands if s < i]:
                del bands[gone]
            for s in (i, j):
                if s not in bands:
                    bands[s] = self.samples(s, pose[s])
            (a, y_a), (b, y_b) = bands[i], bands[j]
            # Beyond a limit a sample of a row is an outlier, and its residual has a weight. Faces are rough and differ
            # more than the fibres between them: rows in which they lie count less. No row counts more than the median
            # row, or the empty resin would count.
            difference = np.abs(a[:, ::4] - b[:, ::4])
            is_valid = np.isfinite(difference)
            mean = np.where(is_valid, difference, 0.0).sum(axis=1) / np.maximum(is_valid.sum(axis=1), 1)
            mean = np.maximum(mean, max(float(np.median(mean)), 1e-6))
            limit, trust = _OUTLIER_SIGMAS * 1.2533 * mean, (mean.min() / mean) ** 2
            # Columns move along the sheet here, not at a fixed row: where the sheet is tilted, its faces would else
            # tell the shift along the columns, and every unevenness of the smooth surface would count as one. What
            # this neglects vanishes with the shift itself, after two or three rounds.
            pair_sums(a, b, x32, 0.5 * (y_a + y_b), self.pitch_um, parts, limit, trust, sums[k], shared)
        return sums


def _smoothed(samples: Samples, down: Samples, across: Samples) -> Samples:
    out = np.empty_like(samples)
    smooth(samples, down, across, np.empty(samples.shape[1] + across.size, np.float32), out)
    return out


def compare(series: SectionSeries, pose: Floats, first: Index, second: Index, *, fine: bool = False) -> SectionPairs:
    """Offsets of pairs of sections, ordered by the first, in bands that are straightened by their poses.

    ``fine`` bands show neither a rotation nor whether both are of one sheet.
    """
    sums = Bands(stack=series.stack, band=series.band, pixel_um=series.pixel_um, fine=fine).sums(pose, first, second)
    # Enough of both is there, and they go up and down together.
    total = sums.sum(axis=1)
    likeness = 1.0 - total[:, 9] / np.maximum(total[:, 10], 1e-12)
    alike = (likeness > _ALIKE) & (total[:, 11] > 0.5 * total[:, 12]) & (total[:, 12] > 0)
    return _solve(sums, first, second, pose[second] - pose[first], alike | fine, fine)


def _solve(sums: Floats, first: Index, second: Index, base: Floats, alike: Bools, fine: bool) -> SectionPairs:
    size = 2 if fine else 3
    scale = np.array([1.0, 1.0, _TURN_UM])[:size]
    rows, cols = np.triu_indices(3)
    matrix = np.zeros((*sums.shape[:2], 3, 3))
    matrix[..., rows, cols] = matrix[..., cols, rows] = sums[..., :6]
    matrix = matrix[..., :size, :size] / (scale[:, None] * scale)
    right = -sums[..., 6:9][..., :size] / scale
    weight = np.ones(sums.shape[:2])
    stiff = 1e-6 * np.eye(size) * np.maximum(matrix.sum(axis=1)[:, :1, :1], 1e-12)
    answer = np.zeros((first.size, size))
    covariance = np.zeros((first.size, size, size))
    for _ in range(3):
        total = (weight[..., None, None] * matrix).sum(axis=1) + stiff
        inverse = np.linalg.inv(total)
        answer = np.einsum("pij,pj->pi", inverse, (weight[..., None] * right).sum(axis=1))
        # What each part would still pull: the spread of these is the error, and a part that pulls too far is torn.
        pull = right - np.einsum("pkij,pj->pki", matrix, answer)
        spread = np.einsum("pk,pki,pkj->pij", weight**2, pull, pull)
        covariance = np.einsum("pij,pjk,pkl->pil", inverse, spread, inverse)
        weight = _part_weights(matrix, pull)
    offset = base.copy()
    offset[:, :size] += answer / scale
    parts = sums.shape[1]
    sigma = np.full((first.size, 3), np.inf)
    sigma[:, :size] = np.sqrt(np.einsum("pii->pi", covariance) * parts / max(parts - 1, 1))
    sound = alike & np.isfinite(answer).all(axis=1) & (sigma[:, :2] < 5.0).all(axis=1)
    sigma = np.maximum(sigma, 0.02)  # no pair is better than this, whatever its parts say
    sigma[:, 2] /= _TURN_UM
    return SectionPairs(first, second, offset, sigma, alike, sound, sums, base, fine)


def _part_weights(matrix: Floats, pull: Floats) -> Floats:
    """Weigh each part of the columns (pairs, parts): less where it pulls farther than the others."""
    away = np.abs(pull / np.sqrt(np.maximum(np.einsum("pkii->pki", matrix), 0.0) + 1e-12))
    sigmas = np.max(away / (1.4826 * np.median(away, axis=1, keepdims=True) + 1e-12), axis=2)
    return np.where(sigmas > _OUTLIER_SIGMAS, _OUTLIER_SIGMAS / np.maximum(sigmas, 1e-9), 1.0)


def _gaussian(sigma: float) -> Samples:
    """Weights of a Gaussian out to three standard deviations, sum 1."""
    far = max(1, int(np.ceil(3 * sigma)))
    weights = np.exp(-0.5 * (np.arange(-far, far + 1) / sigma) ** 2)
    return (weights / weights.sum()).astype(np.float32)
