import itertools

import numpy as np
import pytest
import xarray as xr

from planish.core.frame import Frame


@pytest.mark.parametrize(("through", "top"), list(itertools.product("zyx", ("high", "low"))))
def test_a_real_turn_of_the_specimen_never_mirrors_its_map(through, top):
    """Turn a right-handed set of axes by all 24 rotations: the map seen from the top keeps its handedness."""
    frame = Frame(through=through, top=top)
    # Unit vectors (z, y, x) of the map's columns and rows, and of the direction to the viewer.
    unit = {"z": np.array([1, 0, 0]), "y": np.array([0, 1, 0]), "x": np.array([0, 0, 1])}
    u = unit[frame.cols] * (-1 if frame.mirrored else 1)
    v = unit[frame.rows]
    viewer = unit[frame.through] * (1 if top == "high" else -1)
    # In the reference pose (through z, top high) the triple is (x, y, z) = axes (2, 1, 0).
    reference = np.linalg.det(np.array([unit["x"], unit["y"], unit["z"]]))
    assert np.linalg.det(np.array([u, v, viewer])) == pytest.approx(reference)


def test_columns_is_a_view():
    volume = xr.DataArray(np.zeros((4, 5, 6), np.uint8), dims=("z", "y", "x"))
    columns = Frame(through="x").columns(volume)
    assert columns.dims == ("z", "y", "x")
    assert Frame(through="z").columns(volume).shape == (5, 6, 4)
    assert np.shares_memory(columns.values, volume.values)
