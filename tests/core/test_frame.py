import itertools

import numpy as np
import pytest
import xarray as xr

from folders import refused
from planish.core.errors import InputError
from planish.core.frame import Frame


@pytest.mark.parametrize(("through", "top"), list(itertools.product("zyx", ("high", "low"))))
def test_a_real_turn_of_the_specimen_never_mirrors_its_map(through, top):
    """Turn a right-handed set of axes by all 24 rotations: the map seen from the top keeps its
    handedness."""
    frame = Frame(through=through, top=top)
    # Unit vectors (z, y, x) of the map's columns and rows, and of the direction to the viewer.
    unit = {"z": np.array([1, 0, 0]), "y": np.array([0, 1, 0]), "x": np.array([0, 0, 1])}
    u = unit[frame.cols] * (-1 if frame.mirrored else 1)
    v = unit[frame.rows]
    viewer = unit[frame.through] * (1 if top == "high" else -1)
    # In the reference pose (through z, top high) the triple is (x, y, z) = axes (2, 1, 0).
    reference = np.linalg.det(np.array([unit["x"], unit["y"], unit["z"]]))
    assert np.linalg.det(np.array([u, v, viewer])) == pytest.approx(reference)


def test_columns_is_a_view_and_a_call_takes_the_frame_in_words_in_one_piece_or_from_the_volume():
    volume = xr.DataArray(np.zeros((4, 5, 6), np.uint8), dims=("z", "y", "x"))
    columns = Frame(through="x").columns(volume)
    assert (columns.dims, Frame(through="z").columns(volume).shape) == (("z", "y", "x"), (5, 6, 4))
    assert np.shares_memory(columns.values, volume.values)
    volume = xr.DataArray(
        np.zeros((2, 2, 2)), dims=("z", "y", "x"), attrs={"through": "y", "top_side": "low"}
    )
    assert Frame.asked(volume, None, None, None) == Frame(through="y", top="low")
    assert Frame.asked(volume, None, "x", None) == Frame(through="x", top="low")
    assert Frame.asked(volume, Frame(), None, None) == Frame()
    refused(InputError, "frame= and through= say the same", Frame.asked, volume, Frame(), "x", None)
    with pytest.raises(
        InputError, match=r"frame='y' is no frame. Write through=\"y\", or frame=pl.Frame"
    ):
        Frame.asked(volume, "y", None, None)
    refused(
        InputError, "through='w' is not possible; needed is 'z', 'y' or 'x'", Frame, through="w"
    )
    refused(InputError, "top='up' is not possible; needed is 'high' or 'low'", Frame, top="up")
