"""Coating, coat weight, grammage and density on slabs whose answers are numbers."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.special import ndtr

from analyze.fields import gaussian_maps
from folders import refused
from planish.core.errors import CannotMeasure
from planish.measure import MeasureParams, measure_properties, thin_fraction
from planish.measure.numbers import sheet_numbers

MIDDLE = (slice(8, -8), slice(20, -20))
SLAB = (40.0, 100.0)


def mean(found, name):
    return float(np.nanmean(found[name].values[MIDDLE]))


def test_the_fitted_maps_are_those_of_the_surfaces(rough):
    names = [
        "coating_top",
        "coating_bottom",
        "base_thickness",
        "thickness",
        "topography_top",
        "topography_bottom",
        "base_surface_top",
        "base_surface_bottom",
    ]
    found, plain = rough.measured(*names), measure_properties(rough.surfaces)
    for name in names:
        np.testing.assert_array_equal(found[name], plain[name].astype(np.float32))
        assert found[name].attrs["units"] == "um"
        assert found[name].attrs["support_um"] > 3
    np.testing.assert_array_equal(found["status"], plain["status"])


@pytest.mark.parametrize("slope", [0.0, 0.5])
def test_coating_on_the_ray_of_a_slab(made, slope):
    thick = {"coating_top_sum": 16.0, "coating_top_envelope": 16.0, "coating_bottom_sum": 12.0}
    found = made(slope=(0.0, slope), size_um=SLAB).measured(*thick)
    for name, value in thick.items():
        # the inner crossing is half way; steps of 1 um along the ray and 2 um voxels bend it by
        # some hundredths
        assert mean(found, name) == pytest.approx(value, abs=0.1)


def test_a_gap_counts_in_the_envelope_only(made):
    def split(s, _u, _v):
        return -110.0 * ((s < 33.0) & (s > 29.0))  # base between two layers of coating

    sheet = made(blur=0.0, voxel=1.0, size_um=(30.0, 60.0), extra=split)
    at = {"y": slice(5, -5), "x": slice(5, -5)}
    found = sheet.measured("coating_top_sum", "coating_top_envelope", gap_um=6.0).isel(at)
    # boundaries fall between voxels: half a voxel each
    np.testing.assert_allclose(found["coating_top_envelope"], 16.0, atol=0.55)
    np.testing.assert_allclose(
        found["coating_top_envelope"] - found["coating_top_sum"], 4.0, atol=1.0
    )
    shut = sheet.measured("coating_top_sum", gap_um=2.0).isel(at)
    np.testing.assert_allclose(shut["coating_top_sum"], 8.0, atol=0.55)


@pytest.mark.parametrize("thick", [3.0, 16.0])
@pytest.mark.parametrize("blur", [1.5, 5.0])
def test_absorption_does_not_care_about_blur(made, blur, thick):
    sheet = made(blur=blur, top=thick, size_um=(30.0, 60.0), air_um=60.0)
    found = sheet.measured("coating_absorption_top")
    # three blurs hold 99.9 % of a step
    assert float(np.nanmean(found["coating_absorption_top"])) == pytest.approx(thick, abs=0.05)


@pytest.mark.parametrize("source", ["thickness", "attenuation"])
def test_coat_weight_from_density_and_from_the_balance(made, source):
    """16 um at 1.6 g/cm3 are 25.6 g/m2; scaled to a weighed 20 g/m2 the mean is 20."""
    sheet = made(size_um=SLAB)
    found = sheet.measured("coat_weight_top", coating_g_cm3=1.6, coat_weight_from=source)
    assert mean(found, "coat_weight_top") == pytest.approx(25.6, abs=0.1)
    assert found.attrs["coating_g_cm3"] == 1.6
    assert "coating_top" not in found
    found = sheet.measured("coat_weight_top", coat_weight_top_g_m2=20.0, coat_weight_from=source)
    assert float(found["coat_weight_top"].mean()) == pytest.approx(20.0, rel=1e-5)


def test_weights_need_a_number_and_absorption(made):
    sheet = made(size_um=SLAB)
    coats = {"coat_weight_top_g_m2": 25.0, "coat_weight_bottom_g_m2": 20.0}
    refused(
        CannotMeasure,
        "coat_weight_bottom= or coating_density=",
        sheet.measured,
        "coat_weight_bottom",
    )
    refused(CannotMeasure, "grammage= or base_density=", sheet.measured, "grammage")
    refused(
        CannotMeasure,
        "nothing is left for the base",
        sheet.measured,
        "apparent_density",
        grammage_g_m2=40.0,
        **coats,
    )
    dark = replace(sheet, surfaces=sheet.surfaces.assign_attrs(polarity=-1.0))
    attenuation = {"coating_g_cm3": 1.6, "coat_weight_from": "attenuation"}
    refused(CannotMeasure, "X-ray absorption", dark.measured, "coat_weight_top", **attenuation)
    refused(CannotMeasure, "none was seen", made(bottom=0.0).measured, "coating_bottom_sum")


def test_grammage_and_density_of_a_slab_coated_on_both_sides(made):
    """Base 50 um at 0.8 g/cm3 and 28 um of coating at 1.6 are 40 + 44.8 g/m2; 84.8 / 78 um is 1.087
    g/cm3."""
    sheet = made(size_um=SLAB)
    found = sheet.measured("grammage", "apparent_density", coating_g_cm3=1.6, base_g_cm3=0.8)
    assert mean(found, "grammage") == pytest.approx(84.8, rel=2e-3)
    assert mean(found, "apparent_density") == pytest.approx(84.8 / 78.0, rel=2e-3)
    for coats in ({}, {"coat_weight_top_g_m2": 25.0, "coat_weight_bottom_g_m2": 20.0}):
        found = sheet.measured("grammage", grammage_g_m2=90.0, **coats)
        assert float(found["grammage"].mean()) == pytest.approx(90.0, rel=1e-5)


def test_a_side_without_coating_weighs_nothing_and_has_no_thickness(made):
    found = made(bottom=0.0, size_um=SLAB).measured(
        "grammage", "coating_bottom", coating_g_cm3=1.6, base_g_cm3=0.8
    )
    assert mean(found, "grammage") == pytest.approx(40.0 + 25.6, rel=3e-3)
    assert np.isnan(found["coating_bottom"]).all()


def test_standard_errors_are_the_scatter_over_many_rays(made):
    """White noise: the stated SE is the standard deviation of the answer, and no smaller."""
    sheet = made(noise=10.0, size_um=(160.0, 160.0), air_um=60.0, blur=2.5)
    names = ["absorption", "coating_absorption_top", "porosity", "coating_top_sum"]
    found = sheet.measured(*names, solid_grey=140.0)
    ratio = {n: float(np.nanmedian(found[f"{n}_se"]) / np.nanstd(found[n])) for n in names}
    assert ratio["absorption"] == pytest.approx(1.0, abs=0.15)
    assert ratio["porosity"] == pytest.approx(1.0, abs=0.15)
    # both hold the error of the fitted face beside their own; here the faces are exact
    assert 0.9 < ratio["coating_absorption_top"] < 1.6
    assert 0.7 < ratio["coating_top_sum"] < 1.8


def test_thin_fraction_of_a_ramp():
    """Thickness rises evenly from 0 to 20 um: F(x) = x / 20."""
    ramp = xr.DataArray(
        np.linspace(0, 20, 2001)[None, :].repeat(3, 0), dims=("y", "x"), attrs={"support_um": 6.0}
    )
    ramp[0, 5] = np.nan
    found = thin_fraction(ramp, se=np.full(ramp.shape, 1.5))
    at = found["share"].sel(thickness=[2.0, 5.0, 10.0])
    np.testing.assert_allclose(at, [0.1, 0.25, 0.5], atol=1e-3)
    np.testing.assert_allclose(found["marked_share"], [3 / 6002, 0.1, 0.25], atol=1e-3)
    assert found["marked_share"][0] > 0
    assert list(found["biased"].values) == [1, 1, 0]
    assert "at 0, 2 um" in found.attrs["warning"]
    assert found.attrs["support_um"] == 6.0
    assert "warning" not in thin_fraction(ramp, marked_um=(2.0, 5.0)).attrs
    refused(CannotMeasure, "all values are missing", thin_fraction, ramp * np.nan)


def test_the_error_of_a_thin_share_is_the_scatter_of_fields_of_one_sheet():
    """A Gaussian field of known covariance is thin on Phi(-1) and on half of its area."""
    shares, errors, rng = [], [], np.random.default_rng(0)
    for _ in range(50):
        for field in gaussian_maps(rng, (40, 50), 2.0, kind="gauss"):
            found = thin_fraction(xr.DataArray(field + 5, dims=("y", "x")), marked_um=(4.0, 5.0))
            shares.append(found["marked_share"])
            errors.append(found["marked_se"])
    truth = ndtr([-1.0, 0.0])
    np.testing.assert_allclose(np.mean(shares, axis=0), truth, atol=0.01)
    # the standard deviation of 100 shares is known within 7 %
    stated = np.sqrt(np.mean(np.square(errors), axis=0))
    np.testing.assert_allclose(np.std(shares, axis=0) / stated, 1.0, atol=0.2)
    independent = np.sqrt(truth * (1 - truth) / field.size)
    assert (stated > 2.5 * independent).all()


def test_the_share_of_what_no_neighbour_shares_has_the_error_of_independent_values():
    values = np.random.default_rng(0).uniform(0, 20, (60, 80))
    found = thin_fraction(xr.DataArray(values, dims=("y", "x")), marked_um=(5.0, 30.0))
    assert found["marked_se"][0] == pytest.approx(np.sqrt(0.25 * 0.75 / values.size), rel=0.1)
    assert found["marked_se"][1] == 0


def test_numbers_of_a_sheet_state_the_errors_of_thin_shares_and_what_noise_makes_of_them(made):
    sheet = made(size_um=(40.0, 60.0))
    measured = measure_properties(sheet.surfaces, volume=sheet.volume)
    ramp = measured["coating_top"] * 0 + np.linspace(0, 20, measured.sizes["x"])
    measured = measured.assign(coating_top=ramp)
    for se_um, is_warned in ((1.5, True), (0.5, False)):
        measured["coating_top_se"] = ramp * 0 + se_um
        numbers = sheet_numbers(measured, volume=None, params=MeasureParams())
        thin = numbers.thin["top"]
        assert ("at 0, 2 um" in (thin.warning or "")) == is_warned
        assert len(thin.standard_error) == len(thin.share)
        # a ramp is one event, however many columns it has
        assert thin.standard_error[2] > 2 * np.sqrt(0.25 * 0.75 / ramp.size)
