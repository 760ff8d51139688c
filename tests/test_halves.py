"""Two halves of a measurement: what noise and texture make of them, where they lie, what they share."""

import math

import numpy as np
import pytest
import xarray as xr

from analyze.fields import gaussian_maps
from planish.core.transform import Similarity
from planish.pipeline.halves import Columns, half_points, noise_ceiling, reliability_of

UM, POINT_UM = 4.0, 100.0


def columns(seed=0, *, noise=0.0, shape=(160, 200), length=20.0, similarity=None, slope=0.0, **attrs):
    """A coating of 10 um with texture, noise of single columns, and measured maps that mix neighbouring rows."""
    rng = np.random.default_rng(seed)
    texture = 10 + gaussian_maps(rng, shape, length, kind="gauss")[0]
    coating = texture + noise * rng.normal(size=shape)
    y, x = UM * np.arange(shape[0]), UM * np.arange(shape[1])
    top = 300 + slope * y[:, None] + 0 * x
    faces = {"top": top, "interface_top": top - coating, "bottom": top - 90, "interface_bottom": top - 80,
             "centre": top - 45}  # fmt: skip
    mixed = 0.5 * (coating + np.roll(coating, 1, axis=0))
    maps = faces | {"coating_top": coating / np.hypot(1, slope), "porosity": mixed}
    measured = xr.Dataset(
        {k: (("y", "x"), v) for k, v in maps.items()}, {"y": y, "x": x}, {"through": "z", "top_side": "high"} | attrs
    )
    flat = xr.Dataset({"u": (("y", "x"), x + 0 * y[:, None]), "v": (("y", "x"), y[:, None] + 0 * x)}, {"y": y, "x": x})
    found = Columns(measured=measured, flat=flat, similarity=similarity or Similarity())
    return found, texture


GRID = {"origin_um": (-2.0, -2.0), "cell_um": (2 * UM, 2 * UM), "point_um": POINT_UM}


def stated(found, name="coating_top", *, known=None):
    return reliability_of(found, "sheet", name, np.ones((80, 100), bool) if known is None else known, **GRID)


def test_noise_of_single_columns_gives_the_share_that_it_takes():
    found, texture = columns(noise=20.0)
    row = stated(found)
    points = texture[:150].reshape(6, 25, 8, 25).mean(axis=(1, 3))
    # Of 625 columns a point keeps 1 / 625 of the noise's variance.
    share = points.var() / (points.var() + 20.0**2 / 625)
    assert (row.n, row.value) == (48, pytest.approx(share, abs=0.15))
    ratio = noise_ceiling([row], 0.9)
    assert ratio["ceiling_noise"] == pytest.approx(np.sqrt(row.value))
    assert ratio["ceiling_both"] == pytest.approx(0.9 * np.sqrt(row.value))


def test_texture_without_noise_is_wholly_reliable_however_rows_fall_into_points():
    """An even number of rows in a point shifts the mean place of its odd ones against the even ones by a row."""
    for similarity in (Similarity(), Similarity(scale=25 / 26), Similarity(rotation_rad=0.3, shift_um=(200.0, -60.0))):
        found, _ = columns(similarity=similarity)
        assert stated(found).halves_r > 0.9999


def test_values_of_single_columns_share_nothing_and_others_say_that_they_do():
    found, _ = columns(noise=20.0)
    alone, mixed = stated(found), stated(found, "porosity")
    assert alone.shared == "grey levels, blur and rings of one scan"
    assert "read between columns" in mixed.shared
    assert mixed.halves_r > alone.halves_r + 0.1
    blended, _ = columns(noise=20.0, averaged_columns=1.5)
    assert "averaged with their neighbours (Gaussian of 1.5 columns)" in stated(blended).shared
    assert "labels" in stated(columns(from_labels=1)[0]).shared


def test_thickness_along_the_normal_and_reasons_for_missing_numbers():
    found, _ = columns(slope=0.5)
    values, alone = found.values("coating_top")
    assert alone
    np.testing.assert_allclose(values, found.measured["coating_top"].values)
    np.testing.assert_allclose(found.values("thickness")[0] if "thickness" in found.measured else 90.0, 90.0)
    found, _ = columns()
    row = stated(found, known=np.zeros((80, 100), bool))
    assert math.isnan(row.value)
    assert "Only 0 points" in row.silence
    assert (noise_ceiling([row], 0.9), noise_ceiling([], 0.9)) == ({}, {})


def test_many_rows_are_taken_in_bands_and_none_twice(monkeypatch):
    found, _ = columns(noise=5.0, slope=0.3)
    whole = half_points(found, "coating_top", np.ones((80, 100), bool), **GRID)
    monkeypatch.setattr("planish.pipeline.halves.bands", lambda n: [slice(k, min(k + 34, n)) for k in range(0, n, 34)])
    parts = half_points(found, "coating_top", np.ones((80, 100), bool), **GRID)
    for one, other in zip(whole[:2], parts[:2], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_only_columns_in_cells_that_count_are_taken():
    found, _ = columns(noise=1.0)
    known = np.ones((80, 100), bool)
    known[:, 50:] = False
    odd, even, _ = half_points(found, "coating_top", known, **GRID)
    assert odd.shape == (6, 8)
    np.testing.assert_array_equal(np.isfinite(odd).all(axis=0), [True] * 4 + [False] * 4)
    np.testing.assert_array_equal(np.isfinite(odd), np.isfinite(even))
    middle = found.measured["coating_top"].values[1:149, :100]  # of the first and the last row one half is not known
    assert np.nanmean([odd, even]) == pytest.approx(middle.mean(), abs=0.02)
