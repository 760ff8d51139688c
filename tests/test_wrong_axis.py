"""A sheet that is searched along a wrong axis: the message names the right one."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

from planish.core.errors import CannotMeasure, VolumeError
from planish.pipeline import map_sheet


@pytest.mark.parametrize(
    ("slope", "rim_um", "error"),
    [
        (0.0, 100.0, VolumeError),  # no column along z crosses the sheet
        (0.2, 15.0, CannotMeasure),  # some cross it, and no normal does
    ],
)
def test_a_search_along_a_wrong_axis_names_the_right_one(slope, rim_um, error, tmp_path):
    """A sheet of 12 voxels whose normal runs nearly along y."""
    z, y, x = np.ogrid[:160, :90, :120]
    sheet = abs(y - 45 - slope * (z - 80) - 3 * np.sin(x / 20)) < 6
    values = np.where(sheet, 120.0, 20.0) + np.random.default_rng(3).normal(0, 6, (160, 90, 120))
    tifffile.imwrite(tmp_path / "sheet.tif", values.astype(np.float32))
    with pytest.raises(error, match='The grey changes most along y: try through="y"'):
        map_sheet(
            tmp_path / "sheet.tif", volume={"voxel_um": (5.0, 5.0, 5.0), "through": "z"}, surface={"rim_um": rim_um}
        )
