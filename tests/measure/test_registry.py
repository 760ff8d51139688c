"""A property of one's own, and what is said when something is missing."""

import numpy as np
import pytest

from planish.core.errors import CannotMeasure, ResourceError
from planish.measure import Densities, Measured, Property, RayOptions, measure_along_rays, registered
from planish.measure.registry import ray_property, sheet_property


@ray_property("test_depth", units="um", long_name="Depth of the brightest sample", reasons=["dark"])
def brightest(rays):
    at = np.argmax(np.where(np.isfinite(rays.grey), rays.grey, -np.inf), axis=-1)
    dark = rays.grey.max(axis=-1) < 250
    return Measured(values=np.where(dark, np.nan, rays.top - rays.s_um[at]), reason=dark.astype(np.uint8))


@sheet_property(
    "test_ratio", units="1", long_name="Ratio of a property and the thickness", after=("test_depth", "thickness")
)
def ratio(sheet):
    return sheet.maps["test_depth"].values / sheet.maps["thickness"].values


def test_a_users_property_with_its_own_reason(made):
    sheet = made(blur=0.5, voxel=1.0, size_um=(30.0, 60.0),
                 extra=lambda s, u, _v: 100.0 * ((np.abs(s - 33.0) < 0.6) & (u < 0)))  # fmt: skip
    found = measure_along_rays(sheet.volume, sheet.surfaces, names=["test_ratio", brightest])
    assert isinstance(brightest, Property)
    left = found.isel(y=slice(5, -5), x=slice(5, 20))
    np.testing.assert_allclose(left["test_depth"], 41.0 - 33.0, atol=0.51)
    np.testing.assert_allclose(left["test_ratio"], left["test_depth"] / 78.0, rtol=1e-5)
    status = found["test_depth_status"]
    assert int(status[15, 50]) == 10
    assert status.attrs["flag_meanings"].endswith(" dark")
    assert set(found.data_vars) == {
        "test_depth",
        "test_depth_se",
        "test_depth_status",
        "test_ratio",
        "test_ratio_se",
        "status",
    }


def test_what_is_wrong_with_a_property_is_said(made):
    sheet = made(size_um=(40.0, 40.0))
    with pytest.raises(CannotMeasure, match=r"no property 'porosty'\. Choose from .*porosity"):
        measure_along_rays(sheet.volume, sheet.surfaces, names=["porosty"])
    with pytest.raises(CannotMeasure, match="No property was named"):
        measure_along_rays(sheet.volume, sheet.surfaces, names=[])
    wrong = Property(name="wrong", units="1", long_name="Wrong", kind="rays", function=lambda rays: rays.s_um)
    with pytest.raises(CannotMeasure, match=r"'wrong' returned the shape"):
        measure_along_rays(sheet.volume, sheet.surfaces, names=[wrong])
    with pytest.raises(CannotMeasure, match="'porosity' already"):
        ray_property("porosity", units="1", long_name="Mine")(lambda rays: rays.top)
    with pytest.raises(CannotMeasure, match="is no name"):
        ray_property("my property", units="1", long_name="Mine")(lambda rays: rays.top)
    with pytest.raises(ResourceError, match="were allowed"):
        measure_along_rays(sheet.volume, sheet.surfaces, names=["fibre_angle"], memory_bytes=1000)


def test_numbers_that_are_none_are_refused():
    with pytest.raises(CannotMeasure, match="coating_g_cm3 is -1"):
        Densities(coating_g_cm3=-1.0)
    with pytest.raises(CannotMeasure, match="pore_limit_um is 0 um"):
        RayOptions(pore_limit_um=0.0)
    assert Densities(grammage_g_m2=80.0).known() == {"grammage_g_m2": 80.0}


def test_every_built_in_property_states_its_rule():
    for name, one in registered().items():
        assert one.function.__doc__ or one.function.__module__ == __name__, name
        assert one.units in ("um", "1", "g/m2", "g/cm3", "deg", "1/mm", "1/mm2"), name
