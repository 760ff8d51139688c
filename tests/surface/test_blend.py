"""Columns that are averaged with their neighbours follow the sheet: a slope does not widen its
edges."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ndtr

from planish.surface._kernels import blend

SIGMA = 1.3


def blended(grey, slope_r, slope_c):
    weights = np.exp(-0.5 * (np.arange(5) / SIGMA) ** 2)
    weights = (weights / (2 * weights.sum() - 1)).astype(np.float32)
    one, both = np.empty_like(grey), np.empty_like(grey)
    blend(grey, np.broadcast_to(slope_r, grey.shape[:2]).astype(float), weights, 1, 0, one)
    blend(one, np.broadcast_to(slope_c, grey.shape[:2]).astype(float), weights, 0, 1, both)
    return both


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.8, 0.33), (-1.4, 0.5), (0.0, -2.0)])
def test_an_inclined_edge_keeps_its_width(slopes):
    r, c, d = np.meshgrid(np.arange(15.0), np.arange(15.0), np.arange(60.0), indexing="ij")
    grey = ndtr((d - 28 - slopes[0] * (r - 7) - slopes[1] * (c - 7)) / 1.2).astype(np.float32)
    assert_allclose(blended(grey, *slopes)[7, 7], grey[7, 7], atol=0.012)  # cubic between voxels
    if slopes[0]:  # what it was without the move
        assert np.abs(blended(grey, 0.0, 0.0)[7, 7] - grey[7, 7]).max() > 0.06


def test_every_column_is_the_sum_of_its_moved_neighbours():
    """The slow twin, at whole voxels; beyond the ends of a column its last voxel stands."""
    rng = np.random.default_rng(1)
    grey = rng.normal(size=(5, 4, 12)).astype(np.float32)
    slope = rng.integers(-3, 4, size=(5, 4)).astype(float)
    weights = np.array([0.5, 0.2, 0.05], np.float32)
    found = np.empty_like(grey)
    blend(grey, slope, weights, 1, 0, found)
    for r in range(5):
        for c in range(4):
            beside = [(min(max(r + i, 0), 4), weights[abs(i)]) for i in range(-2, 3)]
            rows = [
                w * grey[k, c, np.clip(np.arange(12) + int(slope[r, c]) * (k - r), 0, 11)]
                for k, w in beside
            ]
            assert_allclose(found[r, c], np.sum(rows, axis=0), atol=1e-6)
