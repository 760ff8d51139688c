"""A property of one's own, and what is said when something is missing."""

import numpy as np
import pytest
from pydantic import ValidationError

from folders import refused
from planish.analyze.compare import is_property
from planish.core.errors import CannotMeasure, ResourceError
from planish.core.tiles import Engine
from planish.flatten import flatten_sheet
from planish.measure import (
    Measured,
    MeasureParams,
    Property,
    further_maps,
    measure_along_rays,
    measure_properties,
    ray_property,
    registered,
    sheet_numbers,
    sheet_property,
)
from planish.measure.form import F_OPERATOR
from planish.measure.registry import has_true_zero
from planish.resample import resample_maps


@ray_property(
    "test_depth", units="um", long_name="Depth of the brightest sample", reasons=("dark",)
)
def brightest(rays):
    at = np.argmax(np.where(np.isfinite(rays.grey), rays.grey, -np.inf), axis=-1)
    dark = rays.grey.max(axis=-1) < 250
    return Measured(
        values=np.where(dark, np.nan, rays.top - rays.s_um[at]), reason=dark.astype(np.uint8)
    )


@sheet_property(
    "test_ratio",
    units="1",
    long_name="Ratio of a property and the thickness",
    after=("test_depth", "thickness"),
)
def ratio(sheet):
    return sheet.maps["test_depth"].values / sheet.maps["thickness"].values


def test_a_users_property_with_its_own_reason(made):
    sheet = made(
        blur=0.5,
        voxel=1.0,
        size_um=(30.0, 60.0),
        extra=lambda s, u, _v: 100.0 * ((np.abs(s - 33.0) < 0.6) & (u < 0)),
    )
    found = sheet.measured("test_ratio", brightest)
    assert isinstance(brightest, Property)
    left = found.isel(y=slice(5, -5), x=slice(5, 20))
    np.testing.assert_allclose(left["test_depth"], 41.0 - 33.0, atol=0.51)
    np.testing.assert_allclose(left["test_ratio"], left["test_depth"] / 78.0, rtol=1e-5)
    status = found["test_depth_status"]
    assert int(status[15, 50]) == 10
    assert status.attrs["flag_meanings"].endswith(" dark")
    fields = (
        "test_depth",
        "test_depth_se",
        "test_depth_status",
        "test_ratio",
        "test_ratio_se",
        "status",
    )
    assert set(found.data_vars) == set(fields)


def test_what_is_wrong_with_a_property_is_said(made):
    sheet = made(size_um=(40.0, 40.0))
    refused(
        CannotMeasure, r"no property 'porosty'\. Choose from .*porosity", sheet.measured, "porosty"
    )
    refused(CannotMeasure, "No property was named", sheet.measured)
    wrong = Property(
        name="wrong", units="1", long_name="Wrong", kind="rays", function=lambda rays: rays.s_um
    )
    refused(CannotMeasure, "'wrong' returned the shape", sheet.measured, wrong)
    for name, words in (("porosity", "'porosity' already"), ("my property", "is no name")):
        refused(
            CannotMeasure,
            words,
            ray_property(name, units="1", long_name="Mine"),
            lambda rays: rays.top,
        )
    small = {"names": ["fibre_angle"], "engine": Engine(memory_bytes=1000)}
    refused(
        ResourceError, "were allowed", measure_along_rays, sheet.volume, sheet.surfaces, **small
    )


def test_options_are_those_of_the_modules_with_a_rule_each_and_checked_numbers():
    assert list(MeasureParams.model_fields)[:3] == ["maps", "rays", "edge_um"]
    assert {"gap_um", "ink_grey", "pore_limit_um", "coating_g_cm3", "l_filter_um"} <= set(
        MeasureParams.model_fields
    )
    for name, one in registered().items():
        assert one.function.__doc__ or one.function.__module__ == __name__, name
        assert one.units in ("um", "1", "g/m2", "g/cm3", "deg", "1/mm", "1/mm2"), name
    refused(ValidationError, "coating_g_cm3", MeasureParams, coating_g_cm3=-1.0)
    refused(ValidationError, "pore_limit_um", MeasureParams, pore_limit_um=0.0)
    assert MeasureParams(grammage_g_m2=80.0).known() == {"grammage_g_m2": 80.0}


def test_maps_on_other_pixels_state_all_that_they_state_on_the_columns(made):
    sheet = made(size_um=(40.0, 60.0), blur=1.0, noise=1.0)
    numbers = {"solid_grey": 140.0, "void_grey": 70.0, "filler_grey": 180.0}
    params = MeasureParams(**numbers, maps=("fibre_angle", "roughness_top"))
    measured = measure_properties(sheet.surfaces, volume=sheet.volume, params=params)
    measured.attrs["thickness_um"] = 78.0
    flat = flatten_sheet(measured).flat
    maps = resample_maps(measured, flat, map_um=3.0)
    names = [name for name, data in measured.data_vars.items() if is_property(data)]
    assert len(names) > 12
    for name in names:
        assert maps[name].attrs == measured[name].attrs, name
    for name in ("topography_top", "base_surface_bottom"):
        assert (maps[name].form_um, maps[name].f_operator) == (800.0, F_OPERATOR)
    assert maps["porosity"].attrs.items() >= {"solid_grey": 140.0, "void_grey": 70.0}.items()
    assert maps["filler"].filler_grey == 180.0
    # How columns go together holds for columns; that of a pixel is in its number.
    assert maps["thickness_se"].attrs == {
        key: measured["thickness_se"].attrs[key] for key in ("units", "long_name")
    }


def test_a_true_zero_is_what_a_property_has_by_its_kind():
    """Heights, differences, angles, parts of a direction and curvatures have none."""
    without = {name for name in registered() if not has_true_zero(name)}
    assert without >= {"warp", "tilt", "fibre_angle", "fibre_cos2", "fibre_sin2"}
    assert without >= {"coating_difference", "half_thickness_difference", "mean_curvature"}
    heights = {"topography", "base_surface", "roughness"}
    assert {f"{height}_{side}" for height in heights for side in ("top", "bottom")} <= without
    assert not without & {"thickness", "coating_top", "grammage", "porosity", "half_thickness_top"}
    assert not has_true_zero("a_map_of_others")
    angles = {name for name, prop in registered().items() if prop.units == "deg"}
    assert angles <= without


@pytest.mark.filterwarnings("error::FutureWarning")
def test_what_was_measured_is_measured_anew(made):
    sheet = made(size_um=(40.0, 60.0), blur=1.0)
    once = measure_properties(sheet.surfaces, volume=sheet.volume)
    stale = once.assign(thickness=once["thickness"] + 1.0, warp=once["warp"] + 1.0)
    assert measure_properties(stale, volume=sheet.volume).identical(once)


def test_maps_whose_numbers_are_given_are_measured(made):
    sheet = made(size_um=(40.0, 60.0), blur=1.0)
    found = measure_properties(sheet.surfaces, volume=sheet.volume)
    assert further_maps(found)[:2] == ["warp", "tilt"]
    given = MeasureParams(
        coating_g_cm3=1.6, base_g_cm3=0.8, solid_grey=140.0, maps=("fibre_angle",)
    )
    found = measure_properties(sheet.surfaces, volume=sheet.volume, params=given)
    names = [
        "warp",
        "tilt",
        "coat_weight_top",
        "coat_weight_bottom",
        "grammage",
        "apparent_density",
        "porosity",
        "fibre_angle",
        "fibre_cos2",
        "fibre_sin2",
    ]
    assert sorted(n for n in further_maps(found) if not n.endswith("_se")) == sorted(names)
    assert {"top", "centre", "thickness", "status"} <= set(found.data_vars)
    numbers = sheet_numbers(found, volume=sheet.volume, params=given)
    assert set(numbers.thin) == {"top", "bottom"}
    assert numbers.profiles is not None
    assert len(numbers.profiles.values["porosity"]) == len(numbers.profiles.depth)
