"""Slices read from a volume: the same voxels for every axis through the sheet, whatever the
blocks."""

import numpy as np
import pytest

from planish.app.exploring import slices
from planish.core.frame import Frame
from planish.core.labelled import labelled
from planish.core.lazy import LazyArray
from planish.report import Scale
from planish.run import silent


class Counted(LazyArray):
    """A volume that stays in its file; ``planes`` are those that were read."""

    def __init__(self, values):
        self.values, self.shape, self.dtype, self.planes = values, values.shape, values.dtype, []

    def read(self, where):
        self.planes += range(*where[0].indices(self.shape[0]))
        return self.values[where]


def volume(values, chunk):
    lazy = Counted(values)
    lazy.chunks = (chunk, 4, 4)
    return labelled(lazy, "zyx", (3.0, 2.0, 1.0), name="volume", attrs={}), lazy


@pytest.mark.parametrize("through", ["x", "y", "z"])
@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("chunk", [1, 5])
def test_the_voxels_are_those_of_the_volume_and_each_plane_is_read_once(
    monkeypatch, through, every, chunk
):
    monkeypatch.setattr(slices, "SLICES_VOXELS", 100)
    values = np.random.default_rng(5).integers(0, 255, (13, 14, 17)).astype(np.uint8)
    data, lazy = volume(values, chunk)
    frame = Frame(through=through)
    rows = np.arange(1, data.sizes[frame.rows], 3)
    depth = slice(2, 9)
    found = slices._read_greys(data, frame, rows, depth, every, Scale(0.0, 255.0, "grey"), silent)
    turned = values.transpose(
        ["zyx".index(axis) for axis in (frame.rows, frame.through, frame.cols)]
    )[rows, depth]
    cols = turned.shape[2] // every
    expected = turned[:, :, : cols * every].reshape(rows.size, 7, cols, every).mean(axis=3)
    assert np.abs(found - expected).max() <= 0.5
    assert len(lazy.planes) == len(set(lazy.planes))


def test_missing_voxels_are_black_and_values_beyond_the_scale_have_its_ends():
    found = slices._greys(
        np.array([np.nan, -5.0, 10.0, 15.0, 20.0, 99.0]), Scale(10.0, 20.0, "grey")
    )
    assert found.tolist() == [0, 0, 0, 128, 255, 255]
