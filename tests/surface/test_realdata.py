"""Measured data: folded paper with its centre surface by other authors, and the electrode layers of
a wound cell."""

import numpy as np
import pytest
import tifffile
from scipy.spatial import cKDTree

from planish.core.frame import Frame
from planish.surface import SurfaceParams, find_surfaces
from surface.sheets import volume


@pytest.fixture(scope="module")
def letter(shared_data):
    folder = shared_data("letterpacket_ct")
    with np.load(folder / "reference_midsurface.npz") as reference:
        outer = reference["mesh_number"] == 0
        points, normals = reference["points_xyz_voxel"][outer], reference["normals_xyz"][outer]
    return volume(tifffile.imread(folder / "volume_zyx_uint8.tif"), 1.0), points, normals


# Crop (y, x), axis through the paper, and a point (z, y, x) in its outermost sheet.
PARTS = {
    "upper flap": ((0, 30), (0, 30), "y", (8.0, 9.0, 3.0)),
    "upper flap, cut close": ((0, 14), (0, 30), "y", (30.0, 7.0, 3.0)),
    "lower flap": ((30, 58), (0, 30), "y", (30.0, 46.0, 3.0)),
    "fold": ((15, 45), (35, 58), "x", (30.0, 25.0, 49.0)),
    "all of it": ((0, 58), (0, 58), "y", (30.0, 46.0, 3.0)),
}


@pytest.mark.parametrize("part", PARTS)
def test_centre_of_folded_paper_lies_where_others_found_it(letter, part):
    paper, points, normals = letter
    rows, cols, through, seed = PARTS[part]
    crop = paper.isel(y=slice(*rows), x=slice(*cols))
    params = SurfaceParams(seed_um=seed, cutoff_um=12.0, rim_um=2.0)
    found = find_surfaces(crop, frame=Frame(through=through), params=params)
    status, centre = found["status"].values, found["centre"].values
    row_axis, col_axis = found.attrs["row_axis"], found.attrs["col_axis"]
    rise = np.gradient(centre)
    grid = np.meshgrid(crop[row_axis].values, crop[col_axis].values, indexing="ij")
    place = {row_axis: grid[0], col_axis: grid[1], through: centre}
    normal = {row_axis: -rise[0], col_axis: -rise[1], through: np.ones_like(centre)}
    ok = (status == 0) & np.isfinite(rise[0]) & np.isfinite(rise[1])
    ours = np.stack([place[k][ok] for k in "xyz"], axis=1)
    across = np.stack([normal[k][ok] for k in "xyz"], axis=1)
    across /= np.linalg.norm(across, axis=1)[:, None]
    # Their points beside our columns; farther away they belong to parts that were not measured.
    gap, nearest = cKDTree(ours).query(points)
    near = gap < 1.5
    distance = np.abs(np.sum((points[near] - ours[nearest[near]]) * across[nearest[near]], axis=1))
    angle = np.degrees(
        np.arccos(np.clip(np.abs(np.sum(normals[near] * across[nearest[near]], axis=1)), 0, 1))
    )
    assert near.sum() > 300
    assert np.median(distance) <= 0.5
    assert np.percentile(distance, 95) <= 1.0
    assert np.median(angle) <= 10.0
    # Where sheets touch, no column is as thick as two of them.
    assert (
        np.nanpercentile((found["top"] - found["bottom"]).values[ok], 99)
        < 2.2 * found.attrs["thickness_um"]
    )


@pytest.fixture(scope="module")
def cell(shared_data):
    files = sorted(shared_data("battery_sector_right").glob("*.tif"))
    return volume(np.stack([tifffile.imread(f) for f in files]), 1.0)


# Middle of the electrode layers in the slice of index 35, row 150.
@pytest.mark.parametrize("x", [7.0, 18.0, 31.0, 41.0, 53.0, 65.0])
def test_each_electrode_layer_behind_the_wall(cell, x):
    crop = cell.isel(z=slice(26, 45), y=slice(100, 200))
    found = find_surfaces(
        crop, frame=Frame(through="x"), params=SurfaceParams(seed_um=(35.0, 150.0, x))
    )
    status = found["status"].values
    centre = found["centre"].values[:, 50]
    # The first one is cut by the border of the crop.
    assert np.mean(status[status != 6] == 0) > (0.95 if x == 7 else 0.98)
    assert np.mean(status == 6) < (0.3 if x == 7 else 0.001)
    assert found.attrs["thickness_um"] == pytest.approx(4.9, abs=0.5)
    assert np.nanstd(centre) < 0.3
    assert abs(np.nanmean(centre) - x) < 2.0
