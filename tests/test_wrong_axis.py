"""A sheet that is searched along a wrong axis: the message names the right one."""

import numpy as np
import pytest
import tifffile

import planish as pl
from planish.core.errors import CannotMeasure, VolumeError
from planish.core.frame import likely_through
from planish.run import map_sheet


@pytest.mark.ci
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
    sizes = {"voxel_um": (5.0, 5.0, 5.0), "through": "z"}
    told = []
    with pytest.raises(error, match='The grey changes most along y: try through="y"'):
        map_sheet(
            tmp_path / "sheet.tif",
            volume=sizes,
            surface={"rim_um": rim_um},
            progress=lambda stage, text: told.append(f"{stage}: {text}"),
        )
    # The axis is named before the search, which takes minutes.
    assert told[1].startswith("look: The grey changes most along y: try `through=y`.")
    assert told[2].startswith("surface: ")


@pytest.mark.ci
def test_a_sheet_seen_edge_on_is_refused_before_every_column_is_searched(monkeypatch):
    """A sheet of 12 voxels, 81 degrees off the axis given: its run is above 6 times its
    thickness."""
    z, y, x = np.ogrid[:160, :90, :120]
    values = np.where(abs(y - 45 - 0.15 * (z - 80) - 3 * np.sin(x / 20)) < 6, 120.0, 20.0)
    values += np.random.default_rng(3).normal(0, 6, values.shape)
    volume = pl.volume(values.astype(np.float32), voxel_um=5)
    with monkeypatch.context() as patch:
        patch.setattr("planish.surface.find.learn_priors", None)  # what comes after the first look
        with pytest.raises(
            VolumeError, match=r'is seen edge on: along z .* most along y: try through="y"'
        ):
            pl.find_surfaces(volume, params={"rim_um": 15.0})
    surfaces = pl.find_surfaces(volume, through="y", params={"rim_um": 15.0})
    assert surfaces.attrs["thickness_um"] == pytest.approx(60.0, abs=2.5)  # half a voxel


def test_a_function_refuses_what_the_command_line_refuses():
    z, y, x = np.ogrid[:40, :40, :40]
    values = np.where(abs(z - 20) < 6 + 0 * y * x, 120.0, 20.0) + np.random.default_rng(3).normal(
        0, 6, (40, 40, 40)
    )
    thin = pl.volume(values.astype(np.float32), voxel_um=0.1)
    with pytest.raises(
        VolumeError, match=r"would be 1.\d+ um thick; sheets of 2 to 5000 um .* unusual_size=True"
    ):
        pl.find_surfaces(thin, params={"rim_um": 0.1, "cutoff_um": 2.0})
    found = pl.find_surfaces(thin, params={"rim_um": 0.1, "cutoff_um": 2.0}, unusual_size=True)
    assert 0.9 < found.attrs["thickness_um"] < 1.5


def test_nothing_is_said_of_an_axis_where_the_grey_tells_none():
    rng = np.random.default_rng(0)
    assert likely_through(rng.normal(size=(40, 50, 60))) is None
    z, y, x = np.mgrid[0:40, 0:50, 0:60]
    box = (abs(z - 20) < 10) & (abs(y - 25) < 12) & (abs(x - 30) < 15)
    assert (likely_through(200 * box.astype(np.uint8)), likely_through(np.zeros((9, 9, 9)))) == (
        None,
        None,
    )
    holed = np.where(abs(y - 25) < 4, 200.0, 10.0)
    holed[:, :, :6] = np.nan
    assert likely_through(holed) == "y"
