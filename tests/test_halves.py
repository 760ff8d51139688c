"""Two halves of a measurement: what noise and texture make of them, where they lie, what they
share."""

from __future__ import annotations

import math

import numpy as np
import pytest
import xarray as xr

from analyze.fields import compared, gaussian_maps, lags_of
from planish.analyze import CorrelateParams, SheetColumns, split_half
from planish.analyze.attenuation import answer_attenuation
from planish.core.grid import Grid
from planish.core.transform import Similarity

UM, POINT_UM = 4.0, 100.0


def columns(
    seed=0, *, noise=0.0, shape=(160, 200), length=20.0, similarity=None, slope=0.0, **attrs
):
    """A coating of 10 um with texture, noise of single columns, and measured maps that mix
    neighbouring rows."""
    rng = np.random.default_rng(seed)
    texture = 10 + gaussian_maps(rng, shape, length, kind="gauss")[0]
    coating = texture + noise * rng.normal(size=shape)
    y, x = UM * np.arange(shape[0]), UM * np.arange(shape[1])
    top = 300 + slope * y[:, None] + 0 * x
    faces = {
        "top": top,
        "interface_top": top - coating,
        "bottom": top - 90,
        "interface_bottom": top - 80,
        "centre": top - 45,
    }
    mixed = 0.5 * (coating + np.roll(coating, 1, axis=0))
    maps = faces | {"coating_top": coating / np.hypot(1, slope), "porosity": mixed}
    measured = xr.Dataset(
        {k: (("y", "x"), v) for k, v in maps.items()},
        {"y": y, "x": x},
        {"through": "z", "top_side": "high"} | attrs,
    )
    flat = xr.Dataset(
        {"u": (("y", "x"), x + 0 * y[:, None]), "v": (("y", "x"), y[:, None] + 0 * x)},
        {"y": y, "x": x},
    )
    found = SheetColumns(measured=measured, flat=flat, similarity=similarity or Similarity())
    return found, texture


def stated(found, name="coating_top", *, cells=(80, 100), origin_um=(-2.0, -2.0), known=None):
    known = np.ones(cells, bool) if known is None else known
    return limits_of(found, name, origin_um=origin_um, known=known)["reliability"][0]


def limits_of(found, name="coating_top", *, origin_um=(-2.0, -2.0), known, error_um=None):
    values = np.where(known, np.random.default_rng(0).normal(size=known.shape), np.nan)
    corner = origin_um[0] + UM, origin_um[1] + UM
    grid = Grid.regular(known.shape, 2 * UM, corner)
    asked = compared(
        (values, values),
        lags_of(values, (2 * UM, 2 * UM)),
        a=("sheet", name),
        columns={"sheet": found},
        grid=grid,
        params=CorrelateParams(point_um=POINT_UM),
    )
    if error_um is not None:
        asked.layers[0]["expected_error"] = (("y", "x"), np.full(known.shape, error_um))
    return answer_attenuation(asked)


def test_noise_of_single_columns_gives_the_share_that_it_takes():
    found, texture = columns(noise=20.0)
    row = stated(found)
    points = texture[:150].reshape(6, 25, 8, 25).mean(axis=(1, 3))
    # Of 625 columns a point keeps 1 / 625 of the noise's variance.
    share = points.var() / (points.var() + 20.0**2 / 625)
    assert row.n == 48
    assert row.value == pytest.approx(share, abs=0.15)
    limits = limits_of(found, known=np.ones((80, 100), bool), error_um=5.0)
    assert limits["attenuation_limit_noise"] == pytest.approx(np.sqrt(row.value))
    assert limits["attenuation_limit_both"] == pytest.approx(
        limits["attenuation_limit"] * np.sqrt(row.value)
    )


def test_texture_without_noise_is_wholly_reliable_however_rows_fall_into_points():
    """An even number of rows in a point shifts the mean place of its odd ones against the even ones
    by a row."""
    for similarity in (
        Similarity(),
        Similarity(scale=25 / 26),
        Similarity(rotation_rad=0.3, shift_um=(200.0, -60.0)),
    ):
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


def test_a_thickness_of_a_tilted_column_is_that_along_the_normal():
    found, _ = columns(slope=0.5)
    values, alone = found.values("coating_top")
    assert alone
    np.testing.assert_allclose(values, found.measured["coating_top"].values)


def halves(found, known):
    return split_half.half_points(
        found, "coating_top", known, origin_um=(-2.0, -2.0), cell_um=(8.0, 8.0), point_um=POINT_UM
    )


def test_many_rows_are_taken_in_bands_and_none_twice(monkeypatch):
    found, _ = columns(noise=5.0, slope=0.3)
    whole = halves(found, np.ones((80, 100), bool))
    monkeypatch.setattr(
        "planish.analyze.split_half.bands",
        lambda n: [slice(k, min(k + 34, n)) for k in range(0, n, 34)],
    )
    parts = halves(found, np.ones((80, 100), bool))
    for one, other in zip(whole[:2], parts[:2], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_only_columns_in_cells_that_count_are_taken():
    found, _ = columns(noise=1.0)
    known = np.ones((80, 100), bool)
    known[:, 50:] = False
    odd, even, _ = halves(found, known)
    assert odd.shape == (6, 8)
    np.testing.assert_array_equal(np.isfinite(odd).all(axis=0), [True] * 4 + [False] * 4)
    np.testing.assert_array_equal(np.isfinite(odd), np.isfinite(even))
    # Of the first and the last row one half is not known.
    middle = found.measured["coating_top"].values[1:149, :100]
    assert np.nanmean([odd, even]) == pytest.approx(middle.mean(), abs=0.02)


def test_where_nothing_can_be_said_the_reason_stands():
    found, _ = columns()
    limits = limits_of(found, known=np.zeros((80, 100), bool))
    (row,) = limits["reliability"]
    assert math.isnan(row.value)
    assert "Only 0 points" in row.reason
    assert [*limits] == ["reliability"]
