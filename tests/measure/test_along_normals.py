import numpy as np
import pytest
import xarray as xr

from naive import distance_along_normal
from planish.core.errors import SurfaceError
from planish.measure import directions, measure_properties
from planish.measure._ray_kernels import along_normals

_NAMES = ("top", "bottom", "interface_top", "interface_bottom", "centre")


def sheet(height, pitch=2.0, *, offsets, through="z", top="high"):
    """Surfaces at exact normal distances from a plane of the given slope, or from any heights."""
    y, x = (np.arange(n) * pitch for n in height.shape)
    data = {
        name: (("y", "x"), height + offset, {"units": "um"})
        for name, offset in zip(_NAMES, offsets, strict=True)
    }
    data["status"] = (("y", "x"), np.zeros(height.shape, np.uint8))
    return xr.Dataset(data, coords={"y": y, "x": x}, attrs={"through": through, "top_side": top})


@pytest.mark.parametrize("slope", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("top", ["high", "low"])
def test_a_tilted_slab_has_its_normal_thickness(slope, top):
    """On a face tilted by a the vertical distance is t / cos a, the normal one t."""
    x = np.arange(60) * 2.0
    height = np.broadcast_to(slope * x, (40, 60)).copy()
    stretch = np.hypot(1.0, slope)
    sign = 1.0 if top == "high" else -1.0
    surfaces = sheet(
        height, offsets=[sign * s * stretch for s in (40.0, -38.0, 22.0, -21.0, 0.0)], top=top
    )
    found = measure_properties(surfaces).isel(y=slice(1, -1), x=slice(25, -25))
    # exact for planes; the root is closed to 1e-4 um
    for name, value in {
        "thickness": 78.0,
        "coating_top": 18.0,
        "coating_bottom": 17.0,
        "base_thickness": 43.0,
    }.items():
        np.testing.assert_allclose(found[name], value, atol=1e-3)
    # A plane is its own form.
    for side in ("top", "bottom"):
        np.testing.assert_allclose(found[f"topography_{side}"], 0.0, atol=1e-3)
        np.testing.assert_allclose(found[f"base_surface_{side}"], 0.0, atol=1e-3)


def test_equals_the_slow_twin_on_a_rough_sheet():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:30, 0:40] * 3.0
    centre = 20 * np.sin(x / 40) + 0.2 * y
    surface = centre + 30 + rng.normal(0, 1.0, centre.shape)
    slope = np.stack(np.gradient(centre, 3.0), axis=-1)
    normals = [np.ascontiguousarray(n) for n in np.moveaxis(directions(slope, "normal"), -1, 0)]
    fast = along_normals(surface, centre, *normals, 3.0, 3.0)
    inner = [(i, j) for i in range(8, 22, 3) for j in range(12, 28, 3)]
    slow = [distance_along_normal(surface, centre, normals, (3.0, 3.0), i, j) for i, j in inner]
    # both close the root to 1e-4 um in height
    np.testing.assert_allclose([fast[p] for p in inner], slow, atol=5e-4)


def test_one_missing_column_costs_no_more_than_its_own_normals():
    """Three nodes of a cell are a plane; two are not."""
    x = np.arange(60) * 2.0
    height = np.broadcast_to(0.3 * x, (40, 60)).copy()
    surfaces = sheet(
        height, offsets=[s * np.hypot(1.0, 0.3) for s in (40.0, -38.0, 22.0, -21.0, 0.0)]
    )
    surfaces["top"][20, 30] = np.nan
    surfaces["bottom"][20:22, 40:42] = np.nan
    found = measure_properties(surfaces).isel(y=slice(1, -1), x=slice(8, -8))
    lost = found["status"].values == 4
    # the normals lean by 11 um, five columns and a half: beside each other two of them meet the
    # missing node
    assert 1 <= np.count_nonzero(lost[:, :25]) <= 4
    assert np.count_nonzero(lost[:, 25:]) >= 4
    np.testing.assert_allclose(found["thickness"].values[~lost], 78.0, atol=1e-3)


def test_missing_and_uncoated_columns_and_refused_surfaces():
    surfaces = sheet(np.zeros((20, 20)), offsets=[10.0, -10.0, 10.0, -10.0, 0.0])
    surfaces["interface_bottom"][:] = np.nan
    surfaces["top"][5, 5] = np.nan
    surfaces["status"][7, 7] = 2
    found = measure_properties(surfaces)
    assert np.isnan(found["coating_bottom"]).all()
    assert (float(found["base_thickness"][10, 10]), found["status"][5, 5]) == (
        pytest.approx(20.0, abs=1e-3),
        4,
    )
    assert np.isnan(found["thickness"][7, 7])
    with pytest.raises(SurfaceError, match="at 400 points"):
        measure_properties(sheet(np.zeros((20, 20)), offsets=[-10.0, 10.0, 0.0, 0.0, 0.0]))
    with pytest.raises(SurfaceError, match="lack centre"):
        measure_properties(
            sheet(np.zeros((20, 20)), offsets=[10.0, -10.0, 0.0, 0.0, 0.0]).drop_vars("centre")
        )
