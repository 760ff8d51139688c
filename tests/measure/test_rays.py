"""The straightened volume: what a ray shows, what is read for it, and that tiles change nothing."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import xarray as xr
from scipy.interpolate import RegularGridInterpolator

from folders import refused
from planish.core.errors import SurfaceError
from planish.core.status import Status
from planish.core.tiles import Engine
from planish.measure import MeasureParams, measure_along_rays, registered
from planish.measure.rays import RayFrame
from surface.sheets import volume
from surface.test_tiles import lazy


def straighten(made, rows, **params):
    """Rays of some rows."""
    return RayFrame.of(made.volume, made.surfaces, MeasureParams(**params)).tile(made.volume, rows)


def slow_grey(made, rays, i, j):
    """One ray by scipy: m + s n, interpolated linearly in the volume."""
    at = RegularGridInterpolator(
        tuple(made.volume[d].values for d in "zyx"),
        made.volume.values.astype(float),
        bounds_error=False,
    )
    surfaces = made.surfaces
    nr, nc, nh = rays.normals[i, j]
    z = float(surfaces["centre"][i, j]) + rays.s_um * nh
    y, x = float(surfaces["y"][i]) + rays.s_um * nr, float(surfaces["x"][j]) + rays.s_um * nc
    return at(np.stack([z, y, x], axis=-1))


def test_a_ray_equals_its_slow_twin_and_missing_ones_have_reasons(rough):
    rays = straighten(rough, slice(0, 52))
    for i, j in ((10, 12), (40, 20), (26, 30), (30, 21)):
        # the kernel works in float64 and stores float32
        np.testing.assert_allclose(rays.grey[i, j], slow_grey(rough, rays, i, j), rtol=1e-6)
    found = rough.measured("absorption")
    status = found["status"].values
    assert (status[20:25, 10:14] == 1).all()
    assert status[30, 20] == Status.NORMAL_LEAVES_SHEET
    # normals at the border lean out of the volume
    assert (status[:, [0, -1]] == Status.NORMAL_LEAVES_SHEET).all()
    assert np.isnan(found["absorption"].values[status != 0]).all()
    assert (
        found["status"].attrs["flag_meanings"].split()[Status.RAY_LEAVES_VOLUME]
        == "ray_leaves_volume"
    )
    padded = replace(
        rough,
        volume=rough.volume.copy(deep=True),
        surfaces=rough.surfaces.assign_attrs(padding=0.0),
    )
    padded.volume[:, 40:, :] = 0
    assert (
        padded.measured("absorption")["status"].values[45:50, 5:35] == Status.RAY_LEAVES_VOLUME
    ).all()


def test_normals_and_greys_of_a_tilted_plane(made):
    sheet = made(slope=(0.0, 0.5), size_um=(60.0, 240.0))
    rays = straighten(sheet, slice(0, 30))
    np.testing.assert_allclose(
        rays.normals[15, 60], [0, -0.5 / np.hypot(1, 0.5), 1 / np.hypot(1, 0.5)]
    )
    assert rays.step_um == 1.0
    np.testing.assert_allclose(rays.stretch[15, 60], [1.0, np.hypot(1, 0.5)])
    # grey along the ray is the blurred staircase itself; linear interpolation rounds its steps by
    # up to v^2 g'' / 8
    half = rays.grey[15, 60, np.argmin(np.abs(rays.s_um - sheet.faces["top"]))]
    assert half == pytest.approx(0.5 * (40 + 200), abs=4)


def test_vertical_rays_give_lengths_too_large_by_the_cosine(made):
    sheet = made(slope=(0.0, 0.5), size_um=(40.0, 240.0))
    vertical = straighten(sheet, slice(5, 10), rays="vertical")
    # t / cos a, with tan a = 0.5
    np.testing.assert_allclose(vertical.top - vertical.bottom, 78.0 * np.hypot(1, 0.5), rtol=1e-9)
    normal, upright = (
        sheet.measured("thickness", "absorption", rays=way) for way in ("normal", "vertical")
    )
    middle = {"y": slice(5, 15), "x": slice(50, 70)}
    for name in ("thickness", "absorption"):
        longer = upright[name].isel(middle) / normal[name].isel(middle)
        # the ray's ends lie three blurs outside, so that its integral is longer by the same factor
        np.testing.assert_allclose(longer, np.hypot(1, 0.5), rtol=2e-3)
    assert upright.attrs["rays"] == "vertical"
    np.testing.assert_allclose(vertical.oblique, np.hypot(1, 0.5))
    assert (straighten(sheet, slice(5, 10)).oblique == 1).all()


@pytest.mark.parametrize(("through", "top"), [("y", "high"), ("x", "low")])
def test_every_pose_of_the_sheet_gives_the_same_rays(rough, through, top):
    order = {"z": ("z", "y", "x"), "y": ("y", "z", "x"), "x": ("y", "x", "z")}[through]
    reference = straighten(rough, slice(10, 40))
    values = rough.volume.transpose(*order).values
    surfaces = rough.surfaces.copy(deep=True)
    depth = rough.volume["z"].values
    if top == "low":
        values = np.flip(values, axis=order.index("z"))
        for name in ("top", "bottom", "interface_top", "interface_bottom", "centre"):
            surfaces[name] = (("y", "x"), depth[-1] - rough.surfaces[name].values)
    surfaces.attrs |= {"through": through, "top_side": top}
    found = straighten(replace(rough, volume=volume(values), surfaces=surfaces), slice(10, 40))
    # mirrored coordinates round differently
    np.testing.assert_allclose(found.grey, reference.grey, rtol=1e-6)
    np.testing.assert_allclose(found.top, reference.top, atol=2e-4)


def test_only_what_a_tile_needs_is_read(made):
    sheet = made(slope=(0.2, 0.0), size_um=(400.0, 60.0))
    on_disk, asked = lazy(sheet.volume.values, 2.0)
    rays = straighten(replace(sheet, volume=on_disk), slice(90, 100))
    np.testing.assert_array_equal(rays.grey, straighten(sheet, slice(90, 100)).grey)
    # 10 of 200 rows, and the lean of rays of some 140 um at a slope of 0.2: 14 rows more
    assert max(asked.sizes) < 0.2 * sheet.volume.size
    one, all_at_once = (
        measure_along_rays(v, sheet.surfaces, names=["absorption"], rows_per_tile=r)
        for v, r in ((on_disk, 8), (sheet.volume, 500))
    )
    assert max(asked.sizes) < 0.25 * sheet.volume.size
    xr.testing.assert_identical(one, all_at_once)


EVERYTHING = MeasureParams(
    coating_g_cm3=1.6,
    base_g_cm3=0.8,
    filler_g_cm3=2.7,
    ink_grey=(120.0, 400.0),
    l_filter_um=60.0,
    filler_grey=110.0,
    pore_limit_um=15.0,
    orientation_rho_um=8.0,
    orientation_sigma_um=3.0,
    void_grey=75.0,
    density_support_um=20.0,
)


@pytest.mark.ci
def test_tiles_and_threads_change_no_byte_of_any_property(rough):
    """Every built-in property, and its errors and reasons."""
    names = [
        name for name, one in registered().items() if one.function.__module__.startswith("planish.")
    ]
    assert len(names) > 30

    measure = partial(measure_along_rays, rough.volume, rough.surfaces, params=EVERYTHING)
    whole = measure(names=names, rows_per_tile=52, engine=Engine(threads=1))
    for rows, threads in ((7, 2), (1, 3)):
        tiled = measure(names=names, rows_per_tile=rows, engine=Engine(threads=threads))
        xr.testing.assert_identical(tiled, whole)
    lacking = [name for name in names if not np.isfinite(whole[name].values).any()]
    assert lacking == []
    by_memory = measure(names=["porosity", "fibre_angle"], engine=Engine(memory_bytes=60_000_000))
    xr.testing.assert_identical(by_memory["fibre_angle"], whole["fibre_angle"])


def test_a_ray_without_matter_is_low_in_contrast_and_wrong_input_refused(made):
    sheet = made()
    sheet.volume[:, 20:30, 30:40] = 42.0
    status = sheet.measured("porosity")["status"]
    assert (status.values[21:29, 31:39] == Status.LOW_CONTRAST).all()
    assert status.attrs["flag_meanings"].split()[Status.LOW_CONTRAST] == "low_contrast"
    cut = replace(sheet, volume=sheet.volume[:, 1:])
    refused(SurfaceError, "do not belong together", straighten, cut, slice(0, 5))
    del sheet.surfaces.attrs["grey_base"]
    refused(SurfaceError, "grey_base", straighten, sheet, slice(0, 5))
