"""Compute the centre surface by Gaussian regression of second order, applied twice.

The regression is that of ISO 16610-31 without its robust weights.

Its local paraboloids pass slopes and curvatures, run up to the border and across holes; Gaussian
smoothing flattens.
"""

from collections.abc import Sequence
from functools import partial
from typing import Literal

import numpy as np
from scipy import ndimage

from planish.core.grid import filled
from planish.core.threads import map_threads
from planish.core.typing import Floats, Pair, TwoFields

_NODES = 2**15  # whose paraboloids are fitted at once: some 20 MB of them
Power = tuple[int, int]  # of the distance down and across
_TERMS = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]


def gaussian_regression(height: Floats, pitch_um: Pair, *, cutoff_um: float) -> Floats:
    """Smooth ``height`` (rows, cols) in um and carry it across missing values, NaN.

    It is carried on where the neighbourhood holds enough; NaN elsewhere.

    ``cutoff_um``: wavelength that passes by half; ``pitch_um``: distance of rows and of columns.
    """
    # The result has no wavelengths below the cut-off, so blocks of a 25th of it lose nothing.
    # A field that is hardly wider than that is cut into four all the same.
    block_um = cutoff_um / 25
    sizes = zip(pitch_um, height.shape, strict=True)
    block = [max(1, min(int(block_um / p), n // 4)) for p, n in sizes]
    is_finite = np.isfinite(height)
    block_sum = _block_sums(np.where(is_finite, height, 0.0), block)
    finite_count = _block_sums(is_finite.astype(float), block)
    # A partial block's mean does not lie at its nominal centre; it is left out unless it is
    # (nearly) whole.
    full_count = block[0] * block[1]
    is_whole = finite_count >= 0.5 * full_count
    pad_nodes = 8  # the spline forgets its end condition by a factor of four a node
    block_mean = block_sum / np.maximum(finite_count, 1.0)
    mean = np.pad(np.where(is_whole, block_mean, 0.0), pad_nodes)
    weight = np.pad(np.where(is_whole, finite_count / full_count, 0.0), pad_nodes)
    block_pitch_um = pitch_um[0] * block[0], pitch_um[1] * block[1]
    regression = _Regression(weight, block_pitch_um, cutoff_um)
    coarse = regression(mean)
    # A second pass over what the first left behind: a wave of 1500 um then loses 0.02 % of its
    # height and not 0.6 %.
    coarse += regression(np.where(weight > 0, mean - coarse, 0.0))
    positions = block_positions(height.shape, block, coarse.shape, first=pad_nodes)
    return interpolate(coarse, positions, order=3)


def _block_sums(field: Floats, block: Sequence[int]) -> Floats:
    sums = field
    for axis, size in enumerate(block):
        sums = np.add.reduceat(sums, np.arange(0, field.shape[axis], size), axis)
    return sums


def block_positions(
    shape: Sequence[int], block: Sequence[int], block_counts: Sequence[int], first: int = 0
) -> list[Floats]:
    """Rows and columns of a grid as positions in the grid of its blocks.

    ``first``: number of the first block that holds any of them.
    """
    positions: list[Floats] = []
    for n, b, count in zip(shape, block, block_counts, strict=True):
        position = (np.arange(n) - 0.5 * (b - 1)) / b + first
        positions.append(np.clip(position, 0, count - 1))
    return positions


def interpolate(field: Floats, axis_positions: Sequence[Floats], *, order: Literal[1, 3]) -> Floats:
    """Interpolate a field where lines, row and column numbers, cross.

    NaN where the nearest node is NaN.
    """
    is_finite = np.isfinite(field)
    positions = np.meshgrid(*axis_positions, indexing="ij")
    if not is_finite.any():
        return np.full(positions[0].shape, np.nan)
    sampled = partial(ndimage.map_coordinates, coordinates=positions, mode="nearest")
    interpolated = sampled(filled(field), order=order)
    is_near_finite = sampled(is_finite.astype(np.uint8), order=0)
    return np.where(is_near_finite > 0, interpolated, np.nan)


def slice_smoothed(height: Floats, pitch_um: float, *, cutoff_um: float) -> Floats:
    """Smooth every row by itself with a Gaussian, and carry it across what is missing in it.

    ``height`` (rows, cols) in um; NaN in rows with fewer than two values.

    ``cutoff_um``: wavelength that passes by half; 400 um is a Gaussian of 75 um. ``pitch_um``:
    distance of the columns.
    """
    sigma = cutoff_um * float(np.sqrt(2 * np.log(2))) / (2 * np.pi) / pitch_um
    is_finite = np.isfinite(height)
    smoothed = np.full(height.shape, np.nan)
    x = np.arange(height.shape[1], dtype=np.float64)
    for i in np.flatnonzero(is_finite.sum(axis=1) > 1):
        is_known = is_finite[i]
        filled_row = np.interp(x, x[is_known], height[i, is_known])
        # Mirrored through its ends, so that a slope goes on beyond them.
        reach_px = min(int(np.ceil(3 * sigma)), filled_row.size - 1)
        mirrored = np.pad(filled_row, reach_px, mode="reflect", reflect_type="odd")
        smoothed_row = ndimage.gaussian_filter1d(mirrored, sigma, truncate=3.0)
        smoothed[i] = smoothed_row[reach_px : reach_px + filled_row.size]
    return smoothed


class _Regression:
    """Local paraboloids with Gaussian weights, at all nodes of one grid of weights."""

    def __init__(self, weight: Floats, pitch: Pair, cutoff: float) -> None:
        """Prepare what depends on the weights (rows, cols) only; pitch and cut-off in um.

        A weight of 1 is that of a node whose columns are all known, 0 of one that is missing.
        """
        # Gaussian weight exp(-pi (x / (GAMMA lambda))^2). With 0.7309 the second-order filter H
        # passes lambda by half (ISO 16610-31); applied twice, 1 - (1 - H)^2, it does so with a
        # wider weight.
        scale = 0.887 * cutoff
        self.weight = weight
        self.axes: list[TwoFields] = []
        for p in pitch:
            # In units of GAMMA lambda; the weight there is 0.0009.
            half_width = max(2, int(np.ceil(1.5 * scale / p)))
            nodes = np.arange(-half_width, half_width + 1, dtype=np.float64)
            x = nodes * p / scale
            self.axes.append((x, np.exp(-np.pi * x * x)))
        powers = [(i, j) for i in range(5) for j in range(5 - i)]
        moments = self._moments(weight, powers)
        (_, row_weight), (_, col_weight) = self.axes
        full_weight = float(row_weight.sum() * col_weight.sum())
        # A field of view much smaller than the cut-off has no full neighbourhood anywhere; its own
        # fullest counts then. Below so much of it the surface would be extrapolated. Where there is
        # data nothing is, however few the neighbours are.
        fullest = min(full_weight, 4.0 * float(moments[0, 0].max()))
        self.good = (weight > 0) | (moments[0, 0] > 0.04 * fullest)
        self.moments = {power: moment[self.good] for power, moment in moments.items()}
        self.ridge = 1e-9 * full_weight * np.eye(6)

    def _moments(self, field: Floats, powers: list[Power]) -> dict[Power, Floats]:
        (y, wy), (x, wx) = self.axes

        def down(i: int) -> Floats:
            return ndimage.correlate1d(field, wy * y**i, axis=0, mode="constant")

        def across(power: Power) -> Floats:
            return ndimage.correlate1d(
                down_moments[power[0]], wx * x ** power[1], axis=1, mode="constant"
            )

        down_moments = map_threads(down, range(1 + max(i for i, _ in powers)))
        return dict(zip(powers, map_threads(across, powers), strict=True))

    def __call__(self, mean: Floats) -> Floats:
        """Return the constant terms of the paraboloids: the heights at the nodes (rows, cols).

        ``mean`` (rows, cols): heights of the nodes. NaN where nothing is known and the
        neighbourhood holds too little.
        """
        has_data = self.weight > 0
        # Heights about their mean keep the sums well conditioned.
        offset = float(mean[has_data].mean()) if has_data.any() else 0.0
        weighted_moments = self._moments(self.weight * (mean - offset), _TERMS)
        smoothed = np.full(self.weight.shape, np.nan)
        sums = np.stack([weighted_moments[term][self.good] for term in _TERMS], axis=-1)

        def constant_terms(nodes: slice) -> Floats:
            rows: list[Floats] = []
            for i, j in _TERMS:
                products = [self.moments[i + k, j + m][nodes] for k, m in _TERMS]
                rows.append(np.stack(products, axis=-1))
            system = np.stack(rows, axis=1) + self.ridge
            solved = np.linalg.solve(system, sums[nodes, :, None])
            return np.asarray(solved[..., 0, 0] + offset, np.float64)

        pieces = [slice(k, k + _NODES) for k in range(0, len(sums), _NODES)]
        smoothed[self.good] = np.concatenate([np.empty(0), *map_threads(constant_terms, pieces)])
        return smoothed
