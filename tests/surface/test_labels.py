"""Surfaces in the labels of another program, and the published way with thresholds slice by
slice."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from folders import refused
from planish.core.errors import InputError, VolumeError
from planish.core.frame import Frame
from planish.surface import LabelParams, SurfaceParams, boundaries, find_surfaces
from surface.sheets import Sheet


def from_labels(volume, **how):
    return find_surfaces(volume, params=SurfaceParams(labels=LabelParams(**how)))


SHEET = Sheet(lateral=(50, 56), thickness=60.0, margin=15.0, coats=(14.0, 0.0))


@pytest.mark.parametrize(("through", "tilt"), [("z", (0.0, 0.0)), ("x", (30.0, 20.0))])
def test_boundaries_lie_within_half_a_voxel(through, tilt):
    sheet = replace(SHEET, tilt=tilt, through=through)
    found = find_surfaces(
        sheet.labels(), frame=Frame(through=through), params=SurfaceParams(labels=LabelParams())
    )
    truth = sheet.surfaces()
    assert (found["status"].values == 0).mean() > 0.99
    for name in ("top", "bottom", "interface_top"):
        error = found[name].values - truth[name]
        assert np.nanmax(np.abs(error)) <= 0.5 * sheet.voxel + 1e-6, name
    assert np.isnan(found["interface_bottom"]).all()


def test_labels_get_their_meanings_and_pores_are_no_face():
    labels = SHEET.labels()
    plain = from_labels(labels)
    other = np.array([7, 3, 9], dtype=np.uint8)[labels.values]
    other[:, ::2] = np.where(other[:, ::2] == 3, 4, other[:, ::2])
    found = from_labels(labels.copy(data=other), air=(7,), base=(3, 4), coating=(9,))
    for name in ("top", "bottom", "interface_top", "centre"):
        np.testing.assert_array_equal(found[name], plain[name])
    labels = SHEET.labels().values.copy()
    labels[(labels == 1) & (np.random.default_rng(0).random(labels.shape) < 0.3)] = 5
    given = SHEET.labels().copy(data=labels)
    refused(VolumeError, r"label 5.*label_void=", from_labels, given)
    found = from_labels(given, void=(5,))
    np.testing.assert_array_equal(found["top"], from_labels(SHEET.labels())["top"])


def test_what_cannot_be_meant():
    refused(VolumeError, "two meanings", from_labels, SHEET.labels(), base=(2,))
    refused(VolumeError, "integers", from_labels, SHEET.labels().astype(np.float32))
    refused(ValidationError, "paper", from_labels, SHEET.labels(), paper=(1,))
    params = SurfaceParams(labels=LabelParams())
    refused(InputError, "have no mean", find_surfaces, SHEET.labels(), params=params, step=2)


def test_thresholds_of_a_mixture():
    rng = np.random.default_rng(0)
    values = np.concatenate([rng.normal(m, 3, 4000) for m in (0.0, 50.0, 160.0)])
    first, second = boundaries.otsu(values, 3)
    assert 8 < first < 42
    assert 58 < second < 152
    assert 8 < boundaries.otsu(values[:8000], 2)[0] < 42


@pytest.mark.ci
def test_the_published_method_fits_an_uncoated_sheet_and_thickens_a_thin_coating():
    sheet = replace(SHEET, coats=(0.0, 0.0), tilt=(0.0, 10.0))
    found = find_surfaces(sheet.volume(), params=SurfaceParams(method="paper"))
    assert found.attrs["method"] == "paper"
    for name in ("top", "bottom"):
        error = found[name].values - sheet.surfaces()[name]
        assert abs(np.nanmean(error)) < 0.2
        assert np.sqrt(np.nanmean(error**2)) < 0.5 * sheet.voxel
    sheet = replace(SHEET, coats=(5.0, 14.0))
    paper, profile = (
        float(np.nanmean((found["top"] - found["interface_top"]).values))
        for found in (
            find_surfaces(sheet.volume(), params=SurfaceParams(method=m))
            for m in ("paper", "profile")
        )
    )
    assert abs(profile - 5) < 0.5 < paper - 5


def test_the_centre_line_is_smoothed_within_the_slice_only():
    sheet = replace(SHEET, coats=(0.0, 0.0), lateral=(40, 80))
    array = sheet.volume().values.copy()
    array[:, 20] = np.roll(array[:, 20], 3, axis=0)  # one slice lies higher
    moved = sheet.volume().copy(data=array)
    found = find_surfaces(moved, params=SurfaceParams(method="paper"))
    centre = found["centre"].values
    assert np.nanmedian(centre[20] - centre[18]) == pytest.approx(3 * sheet.voxel, abs=0.3)
    smooth = find_surfaces(moved)["centre"].values
    assert np.nanmedian(smooth[20] - smooth[18]) < 0.5 * sheet.voxel
