"""Maps of a sheet whose answers are formulas: flat, on a reference, turned and mirrored."""

import numpy as np
import pytest
import xarray as xr

from flatten.meshes import middles
from planish.core.axial import axial_angle
from planish.core.errors import SurfaceError
from planish.core.grid import Grid
from planish.core.transform import Similarity
from planish.resample import resample_image, resample_maps
from planish.run import position_error


class Placed(Similarity):
    """A similarity with the errors of a registration."""

    @property
    def similarity(self):
        return self

    def expected_error_um(self, points):
        return 1.0 + 0.01 * points[..., 0]


def sheet(angle=20.0):
    """A flat sheet of 40 x 50 columns of 2 x 3 um: values are linear, one corner is missing."""
    y, x = 2.0 * np.arange(40), 3.0 * np.arange(50)
    yy, xx = np.meshgrid(y, x, indexing="ij")
    there = (yy > 20) | (xx > 30)

    def data(values, **attrs):
        return (
            ("y", "x"),
            np.where(there, values, np.nan),
            {"units": "um", "long_name": "Title"} | attrs,
        )

    surfaces = xr.Dataset(
        {
            "centre": data(50.0 + 0 * xx),
            "top": data(60.0 + 0 * xx),
            "presence": data(np.ones_like(xx), layer=[0.2, 0.3]),
            "presence_bottom": data(np.ones_like(xx), layer=[-0.3, -0.2]),
            "thickness": data(20.0 + 0.1 * xx - 0.05 * yy, role="property"),
            "fibre_cos2": data(np.cos(np.deg2rad(2 * angle)) + 0 * xx, support_um=3.0),
            "fibre_sin2": data(np.sin(np.deg2rad(2 * angle)) + 0 * xx, support_um=3.0),
            "fibre_angle": data(angle + 0 * xx, support_um=3.0),
            "fibre_cos2_se": data(0.1 + 0 * xx),
            "fibre_sin2_se": data(np.nan + 0 * xx),
        },
        coords={"y": y, "x": x},
        attrs={"through": "z", "top_side": "high", "thickness_um": 20.0},
    )
    flat = xr.Dataset(
        {"u": data(xx), "v": data(yy), "projected_u": data(xx - 1), "projected_v": data(yy)}
    )
    return surfaces, flat.assign_coords(y=y, x=x)


def test_flat_maps_have_the_pixel_of_the_columns_and_need_properties():
    surfaces, flat = sheet()
    maps = resample_maps(surfaces, flat, map_um=1.7)
    u, v = np.meshgrid(maps["u"].values, maps["v"].values)
    known = maps["valid"].values
    assert 0.7 < known.mean() < 1
    assert "top" not in maps
    assert "fibre_sin2_se" not in maps
    assert {"fibre_cos2_se", "presence", "projected_u", "projected_v"} <= set(maps)
    assert maps["thickness"].dtype == np.float32
    np.testing.assert_allclose(
        maps["thickness"].values[known], (20 + 0.1 * u - 0.05 * v)[known], rtol=1e-6
    )
    np.testing.assert_allclose(maps["volume_x"].values[known], u[known], atol=1e-9)
    np.testing.assert_allclose(maps["volume_y"].values[known], v[known], atol=1e-9)
    np.testing.assert_allclose(maps["volume_z"].values[known], 50.0)
    np.testing.assert_allclose(maps["fibre_angle"].values[known], 20.0)
    assert maps.attrs == {"overlaps": 0, "layers_apart_um": 10.0, "layer_to_face": 0.5}
    maps = resample_maps(*sheet())
    assert np.isclose(maps["u"].values[1] - maps["u"].values[0], np.sqrt(6.0))
    with pytest.raises(SurfaceError, match="planish measure"):
        resample_maps(surfaces[["centre", "top"]], flat)


@pytest.mark.parametrize("mirrored", [False, True])
def test_maps_on_a_reference_lie_where_the_transformation_says(mirrored):
    surfaces, flat = sheet()
    way = Placed(
        scale=1.1, rotation_rad=0.2, shift_um=(150.0 if mirrored else 20.0, 5.0), mirrored=mirrored
    )
    grid = Grid.regular((50, 60), (1.9, 2.1))
    linked = resample_maps(surfaces, flat, onto=grid, transform=way)
    points = way.inverse(middles(grid))
    known = np.isfinite(linked["thickness"].values)
    assert known.mean() > 0.3
    assert {"presence", "projected_u", "valid"}.isdisjoint(linked)
    np.testing.assert_allclose(linked["u"].values[known], points[known][:, 0], atol=1e-9)
    np.testing.assert_allclose(linked["v"].values[known], points[known][:, 1], atol=1e-9)
    # A direction turns with the sheet, the other way round in a mirror.
    turned = np.deg2rad(2 * (-20.0 if mirrored else 20.0)) + 2 * 0.2
    np.testing.assert_allclose(
        linked["fibre_angle"].values[known], axial_angle(np.cos(turned), np.sin(turned))
    )
    np.testing.assert_allclose(linked["fibre_cos2"].values[known], np.cos(turned))


def test_an_image_on_a_reference_and_its_expected_error():
    y, x = np.mgrid[0:40, 0:50] * 2.0
    image = xr.DataArray(3 * x - y, dims=("y", "x"), attrs={"pixel_um": (2.0, 2.0)})
    way = Placed(rotation_rad=0.1, shift_um=(10.0, 0.0))
    grid = Grid.regular((45, 40), 1.9)
    found = resample_image(image, grid, way)["image"]
    points = way.inverse(middles(grid))
    known = np.isfinite(found.values)
    assert known.mean() > 0.5
    np.testing.assert_allclose(
        found.values[known], (3 * points[..., 0] - points[..., 1])[known], atol=1e-8
    )
    error = position_error.PositionErrors(None, way, grid).on(grid, found.values)["expected_error"]
    np.testing.assert_array_equal(np.isfinite(error.values), known)
    np.testing.assert_allclose(error.values[known], (1 + 0.01 * points[..., 0])[known], rtol=1e-6)
    scanned = position_error.PositionErrors(None, way, grid, is_scan=True).on(grid, found.values)
    lines_um = position_error._LINES_UM
    np.testing.assert_allclose(scanned["error_lines"].values[known], lines_um)
    np.testing.assert_allclose(
        scanned["expected_error"].values[known], np.hypot(error.values[known], lines_um), rtol=1e-6
    )


@pytest.mark.parametrize("mirrored", [False, True])
def test_an_axis_without_parts_is_interpolated_and_turned_as_one(mirrored):
    """Between columns of 80 and of -80 degrees lie axes of 80 to 100 degrees."""
    surfaces, flat = sheet()
    surfaces = surfaces.drop_vars(["fibre_cos2", "fibre_sin2", "fibre_angle"])
    stripes = np.where(np.arange(50) % 2, -80.0, 80.0) + 0 * surfaces["centre"]
    surfaces["own"] = stripes.assign_attrs(units="deg", support_um=3.0, period_deg=180.0)
    way = Placed(rotation_rad=0.2, mirrored=mirrored)
    grid = Grid.regular((50, 60), (1.9, 2.1), (-110.0, 0.0) if mirrored else (0.0, 0.0))
    for found, turn in (
        (resample_maps(surfaces, flat, map_um=1.7)["own"], 0.0),
        (resample_maps(surfaces, flat, onto=grid, transform=way)["own"], np.rad2deg(0.2)),
    ):
        assert found.attrs["period_deg"] == 180
        known = found.values[np.isfinite(found.values)]
        assert known.size > 200
        assert (np.abs(known) <= 90).all()
        away = np.abs((known - turn) % 180 - 90)
        assert away.max() < 10.1
        assert away.min() < 1.0
