"""Dust, loose pieces, sheets that leave the volume, half-closed holes, the rolling ball."""

from dataclasses import replace

import numpy as np
import pytest

from planish.core._envelope_kernels import rolled
from planish.surface import SurfaceParams, find_surfaces, regions
from surface.sheets import Sheet

SHEET = Sheet(lateral=(80, 64), thickness=60.0, margin=20.0)


def dusty(above, high, rows, cols, sheet=SHEET):
    """The sheet with a box of coating: first voxel above the face, height, and lateral edges."""
    grey = sheet.volume()
    array = grey.values.copy()
    first = round(float(sheet.surfaces()["top"][0, 0]) / sheet.voxel) + above
    array[first : first + high, slice(*rows), slice(*cols)] = 210
    return grey.copy(data=array)


@pytest.mark.parametrize("above", [3, 12])
def test_what_floats_two_voxels_above_the_face_is_counted_and_the_face_below_it_is_found(above):
    found = find_surfaces(dusty(above, 5, (30, 55), (30, 55)))
    error = found["top"].values - SHEET.surfaces()["top"]
    assert found.attrs["particles_removed"] == 1
    assert np.nanmax(np.abs(error)) < 0.7
    assert np.isfinite(error[33:52, 33:52]).all()


@pytest.mark.ci
def test_a_narrow_particle_is_removed():
    sheet = replace(SHEET, lateral=(100, 110), margin=30.0)
    found = find_surfaces(dusty(-1, 8, (40, 46), (20, 26), sheet))
    assert (
        found.attrs["particles_removed"],
        set(np.unique(found["status"].values[41:45, 21:25])),
    ) == (1, {7})
    assert np.isnan(found["top"].values[41:45, 21:25]).all()
    assert np.nanmax(np.abs(found["top"].values - sheet.surfaces()["top"])) < 2.0


def test_a_wide_lump_is_topography():
    found = find_surfaces(dusty(-1, 8, (40, 70), (20, 50)), params=SurfaceParams(rim_um=30.0))
    assert found.attrs["particles_removed"] == 0
    rise = found["top"].values - SHEET.surfaces()["top"]
    assert np.nanmedian(rise[45:65, 25:45]) > 7.0


@pytest.mark.ci
def test_a_sheet_that_leaves_the_volume_is_measured_inside_and_nowhere_else():
    sheet = replace(SHEET, tilt=(0.0, 30.0), margin=20.0)
    cut = 30
    grey = sheet.volume().isel(z=slice(cut, None))
    found = find_surfaces(grey)
    truth = sheet.surfaces()
    inside = truth["bottom"] > (cut + 6) * sheet.voxel
    outside = truth["bottom"] < (cut - 1) * sheet.voxel
    status = found["status"].values
    assert (status[inside] == 0).mean() > 0.99
    assert set(np.unique(status[outside])) == {6}
    assert np.isnan(found["bottom"].values[outside]).all()
    assert np.isnan(found["centre"].values[outside]).all()
    assert np.nanmax(np.abs(found["bottom"].values - truth["bottom"])) < 1.5


def holes(fill):
    """Four holes of 120 um in pixels of 2 um, of which the last is partly filled."""
    y, x = np.mgrid[0:200, 0:200] * 2.0
    sheet = np.min([np.hypot(y - r, x - c) for r in (100, 300) for c in (100, 300)], axis=0) > 60.0
    return sheet | fill(y - 300.0, x - 300.0) & (np.hypot(y - 300, x - 300) <= 60)


def test_open_holes_have_the_area_of_their_ellipse():
    sheet = holes(lambda y, _x: y > 1000)
    found = regions.all_holes(sheet, (2.0, 2.0))
    assert len(found) == 4
    np.testing.assert_allclose(found[:, 2], np.pi * 60**2, rtol=0.02)
    np.testing.assert_allclose(found[:, 3], np.pi * 60**2, rtol=0.06)
    assert len(regions.half_closed(sheet, ~sheet & False, (2.0, 2.0))) == 0


@pytest.mark.parametrize(
    "fill", [lambda y, _x: y > 5, lambda y, x: (np.abs(x) < 12) & (y < 200) | (y > 25)]
)
def test_a_hole_that_is_half_closed_is_named(fill):
    sheet = holes(fill)
    closed = regions.half_closed(sheet, ~sheet & False, (2.0, 2.0))
    assert len(closed) >= 1
    assert (np.abs(closed - 150) < 40).all()


def test_a_ball_rolls_over_a_gap_as_deep_as_its_sagitta():
    height = np.zeros((81, 81))
    height[:, 31:50] = -40.0
    out = rolled(height, (1.0, 1.0), 100.0)
    # sphere: r - sqrt(r^2 - 10^2) = 0.501
    assert out[40, 40] == pytest.approx(-(100 - np.sqrt(100**2 - 10**2)), abs=0.02)
    np.testing.assert_allclose(out[:, :30], 0.0, atol=1e-12)
    assert (out >= height - 1e-12).all()


def test_both_faces_and_their_envelopes_are_reported():
    found = find_surfaces(SHEET.volume(), params=SurfaceParams(envelope_um=100.0))
    assert (found["top_envelope"] >= found["top"] - 1e-9).all()
    assert (found["bottom_envelope"] <= found["bottom"] + 1e-9).all()
    assert found.attrs["particles_removed"] == 0
