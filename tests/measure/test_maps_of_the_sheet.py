"""Topography, envelopes, warp and two-sidedness against formulas."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from folders import refused
from planish.core._envelope_kernels import rolled
from planish.core.errors import CannotMeasure
from planish.measure import (
    MeasureParams,
    lengths,
    registry,
    roughness_numbers,
    scale_limited,
    two_sidedness,
)
from planish.measure.lengths import smoothed, without_short


def slow_envelope(height, pitch, radius):
    """Closing by a paraboloid, node by node."""
    i, j = (np.arange(n) * p for n, p in zip(height.shape, pitch, strict=True))
    way = ((i[:, None] - i[None, :]) ** 2)[:, None, :, None] + ((j[:, None] - j[None, :]) ** 2)[
        None, :, None, :
    ]
    ball = way / (2 * radius)
    dilated = np.nanmax(height[None, None] - ball, axis=(2, 3))
    return np.where(np.isfinite(height), np.min(dilated[None, None] + ball, axis=(2, 3)), np.nan)


def test_an_envelope_equals_its_slow_twin_bridges_a_pit_and_enters_a_wide_one():
    height = np.random.default_rng(0).normal(0, 3, (17, 23))
    height[4:7, 10:12] = np.nan
    found = rolled(height, (2.0, 3.0), 20.0)
    np.testing.assert_allclose(found, slow_envelope(height, (2.0, 3.0), 20.0), atol=1e-9)
    known = np.isfinite(height)
    assert (found[known] >= height[known] - 1e-9).all()
    # Over a slot 20 um wide a ball of 250 um sinks by 10^2 / 500 = 0.2 um.
    height = np.zeros((3, 400))
    height[:, 190:210] = -15.0
    found = rolled(height, (1.0, 1.0), 250.0)
    # the slot's edges are the nodes beside it, 21 um apart, and the ball's middle stands on a node,
    # 10 um from one
    assert found[1].min() == pytest.approx(-(10.0**2) / 500, abs=1e-9)
    height[:, 20:380] = -15.0
    assert rolled(height, (1.0, 1.0), 250.0)[1, 200] == pytest.approx(-15.0)


def test_filters_pass_their_cut_off_by_half():
    pitch, cutoff = 4.0, 200.0
    x = np.arange(500) * pitch
    wave = np.sin(2 * np.pi * x / cutoff)[None, :].repeat(140, 0)
    low = smoothed(wave, (pitch, pitch), cutoff * 0.4697 / np.sqrt(2 * np.pi))
    inner = (slice(66, -66), slice(100, -100))
    assert np.ptp(low[inner]) / np.ptp(wave[inner]) == pytest.approx(0.5, abs=0.01)
    fine = without_short(wave, (pitch, pitch), cutoff)
    assert np.ptp(fine[inner]) / np.ptp(wave[inner]) == pytest.approx(0.5, abs=0.01)
    limited = scale_limited(wave, (pitch, pitch), s_filter_um=20.0, l_filter_um=cutoff)
    assert np.isfinite(limited).all()
    # half of the wave passes the L-filter; the S-filter of a tenth takes 0.7 % off
    assert np.ptp(limited[inner]) / np.ptp(wave[inner]) == pytest.approx(0.5, abs=0.02)
    # roughness of a sine: Sq = a / sqrt 2, Sa = 2 a / pi, Ssk = 0, Sku = 1.5, Sdq = 2 pi / L * Sq
    numbers = roughness_numbers(
        wave[:, :450] * 3.0, (pitch, pitch), s_filter_um=5.0, l_filter_um=cutoff
    )
    assert numbers.sq == pytest.approx(3 / np.sqrt(2), rel=2e-3)
    assert (numbers.sa, numbers.ssk) == (
        pytest.approx(6 / np.pi, rel=2e-3),
        pytest.approx(0.0, abs=1e-6),
    )
    assert (numbers.sku, numbers.sz) == (pytest.approx(1.5, rel=2e-3), pytest.approx(6.0, rel=3e-3))
    assert numbers.sdq == pytest.approx(2 * np.pi / cutoff * numbers.sq, rel=5e-3)


def test_filters_and_heights_that_leave_nothing_are_refused():
    height, limited = np.zeros((60, 100)), np.full((20, 20), np.nan)
    limited[5, 5], limited[12, 9] = 1.0, 2.0
    nothing = scale_limited(
        np.full((20, 20), np.nan), (4.0, 4.0), s_filter_um=5.0, l_filter_um=800.0
    )
    for call, values, short, long, words in (
        (scale_limited, height, 500.0, 80.0, "must be shorter"),
        (roughness_numbers, limited, 5.0, 800.0, "no slopes"),
        (roughness_numbers, nothing, 5.0, 800.0, "No height of the face is known"),
    ):
        refused(CannotMeasure, words, call, values, (4.0, 4.0), s_filter_um=short, l_filter_um=long)


def bent(made, height):
    sheet = made(size_um=(80.0, 100.0))
    y, x = (sheet.surfaces[axis] - sheet.surfaces[axis].mean() for axis in "yx")
    moved = {name: sheet.surfaces[name] + height(y, x) for name in sheet.faces}
    return replace(sheet, surfaces=sheet.surfaces.assign(moved))


@pytest.mark.parametrize(
    ("height", "mean", "gauss"),
    [
        # The bowl of a sphere of 1 mm.
        (lambda y, x: 1000.0 - np.sqrt(1000.0**2 - x**2 - y**2), 1.0, 1.0),
        (lambda y, x: 1000.0 - np.sqrt(1000.0**2 - x**2) + 0 * y, 0.5, 0.0),  # a cylinder of 1 mm
        (lambda y, x: (x**2 - y**2) / 2000.0, None, -1.0),  # a saddle, at its middle
        (lambda y, x: 0.3 * x - 0.2 * y, 0.0, 0.0),
    ],
)
def test_curvatures(made, height, mean, gauss):
    found = bent(made, height).measured("mean_curvature", "gaussian_curvature", "warp", "tilt")
    middle = (20, 25)
    # second differences over 2 um: 1e-5 relative for these radii; the saddle's middle lies half a
    # pitch off
    if mean is not None:
        assert float(found["mean_curvature"][middle]) == pytest.approx(mean, abs=2e-3)
    assert float(found["gaussian_curvature"][middle]) == pytest.approx(gauss, abs=4e-3)
    assert found["gaussian_curvature"].attrs["units"] == "1/mm2"
    assert np.isnan(found["mean_curvature_se"]).all()
    if mean == 0.0:
        assert float(np.abs(found["warp"]).max()) < 1e-3
        assert float(found["tilt"][middle]) == pytest.approx(
            np.rad2deg(np.arctan(np.hypot(0.3, 0.2))), abs=1e-3
        )


def test_two_sides(made):
    sheet = made(top=16.0, bottom=12.0, slope=(0.0, 0.3))
    found = sheet.measured("coating_difference", "half_thickness_difference").isel(
        y=slice(10, -10), x=slice(15, -15)
    )
    # half thicknesses: 25 + 16 above the centre, 25 + 12 below
    for name in ("coating_difference", "half_thickness_difference"):
        np.testing.assert_allclose(found[name], 4.0, atol=2e-3)
    rng = np.random.default_rng(0)
    shared, own = rng.normal(size=(2, 200, 300))
    maps = xr.Dataset(
        {
            "coating_top": (("y", "x"), 16 + 2 * shared),
            "coating_bottom": (("y", "x"), 12 + 0.6 * shared + 0.8 * own),
        }
    )
    numbers = two_sidedness(maps)
    assert numbers["coating_difference_um"] == pytest.approx(4.0, abs=0.02)
    # r = 0.6 by construction, 60000 points
    assert numbers["coating_correlation"] == pytest.approx(0.6, abs=0.01)
    assert numbers["coating_sd_ratio"] == pytest.approx(2.0, abs=0.02)
    refused(
        CannotMeasure,
        "coating_top and coating_bottom",
        two_sidedness,
        maps.drop_vars("coating_top"),
    )


@pytest.mark.parametrize(("side", "outwards"), [("top", 1.0), ("bottom", -1.0)])
def test_peaks_of_both_sides_point_outwards(monkeypatch, side, outwards):
    """A bump away from the middle of the sheet is a peak, on whichever side it stands."""
    y, x = np.mgrid[:120, :120] * 5.0
    bump = 3.0 * np.exp(-((x - 300) ** 2 + (y - 300) ** 2) / 900)
    frame = SimpleNamespace(
        faces={side: outwards * (40.0 + bump)},
        heights={"centre": np.zeros(x.shape)},
        pitch_um=(5.0, 5.0),
        slopes=lambda: np.zeros((*x.shape, 2)),
        oblique=lambda slope: np.ones(slope.shape[:-1]),
    )
    params = MeasureParams(s_filter_um=20.0, l_filter_um=200.0)
    monkeypatch.setattr(lengths, "thickness_se", lambda *_: np.ones(x.shape))
    sheet = SimpleNamespace(frame=frame, params=params, valid=np.ones(x.shape, dtype=bool))
    values = registry.find_property(f"roughness_{side}").function(sheet).values
    assert values[60, 60] > 1.0
    assert np.nanmin(values) > -1.0
