"""Sheets whose grey is a formula in the sheet's own coordinates, with their exact surfaces."""

from dataclasses import dataclass

import numpy as np
import pytest
import xarray as xr
from scipy import special

from planish.measure import MeasureParams, measure_along_rays
from surface.sheets import volume

AIR, BASE, COAT = 40.0, 90.0, 200.0


@dataclass(frozen=True)
class Made:
    """A volume (z, y, x), its surfaces, and the places of the faces along the normals, um."""

    volume: xr.DataArray
    surfaces: xr.Dataset
    faces: dict

    def measured(self, *names, **params):
        """Maps of these names with these numbers given."""
        return measure_along_rays(
            self.volume, self.surfaces, names=names, params=MeasureParams(**params)
        )


def step(d, blur):
    return special.ndtr(d / blur) if blur > 0 else (d >= 0).astype(float)


def staircase(faces, s, blur):
    """Grey of coating, base and coating between air, blurred, at ``s`` along the normals."""
    values = AIR
    for grey, upper, lower in (
        (COAT, "top", "interface_top"),
        (BASE, "interface_top", "interface_bottom"),
        (COAT, "interface_bottom", "bottom"),
    ):
        values = values + (grey - AIR) * (
            step(faces[upper] - s, blur) - step(faces[lower] - s, blur)
        )
    return values


def about(**more):
    """What a run says of its surfaces."""
    return {
        "through": "z",
        "top_side": "high",
        "polarity": 1.0,
        "grey_air": AIR,
        "grey_base": BASE,
        "grey_coating_top": COAT,
        "grey_coating_bottom": COAT,
    } | more


@pytest.fixture(scope="session")
def made():
    """Return a maker of tilted plane sheets; see its arguments."""

    def make(
        grey=None,
        *,
        size_um=(120.0, 150.0),
        voxel=2.0,
        slope=(0.0, 0.0),
        base=50.0,
        top=16.0,
        bottom=12.0,
        blur=2.0,
        noise=0.0,
        extra=None,
        air_um=40.0,
    ):
        """Make a sheet; ``grey(s, u, v)`` replaces the staircase, ``extra`` is added to it.

        ``slope``: of the centre surface along y and x. ``u, v``: coordinates in the tangent plane,
        from the middle of the volume, along x and y where the sheet is level; with a slope along
        one axis only they are exact.
        """
        steep = float(np.hypot(*slope))
        long = float(np.hypot(1.0, steep))
        faces = {
            "top": base / 2 + top,
            "interface_top": base / 2,
            "interface_bottom": -base / 2,
            "bottom": -base / 2 - bottom,
            "centre": 0.0,
        }
        rise = abs(slope[0]) * size_um[0] / 2 + abs(slope[1]) * size_um[1] / 2
        height = 2 * (rise + (max(faces.values()) + air_um) * long)
        shape = tuple(int(n / voxel) for n in (height, *size_um))
        z, y, x = (np.arange(n) * voxel for n in shape)
        ym, xm, zm = y.mean(), x.mean(), z.mean()
        centre = zm + slope[0] * (y - ym)[:, None] + slope[1] * (x - xm)[None, :]
        zz, yy, xx = np.meshgrid(z - zm, y - ym, x - xm, indexing="ij")
        s = (zz - slope[0] * yy - slope[1] * xx) / long
        # Feet of the perpendiculars, and from there along the slope.
        u = (xx + slope[1] * s / long) * (np.hypot(1, slope[1]) if slope[0] == 0 else 1.0)
        v = (yy + slope[0] * s / long) * (np.hypot(1, slope[0]) if slope[1] == 0 else 1.0)
        values = staircase(faces, s, blur) if grey is None else grey(s, u, v)
        if extra is not None:
            values = values + extra(s, u, v)
        if noise:
            values = values + np.random.default_rng(0).normal(0, noise, shape)
        data = {
            name: (("y", "x"), centre + offset * long, {"units": "um"})
            for name, offset in faces.items()
        }
        for side, thick in (("top", top), ("bottom", bottom)):
            if thick == 0:
                data[f"interface_{side}"] = (("y", "x"), np.full(centre.shape, np.nan))
        data["status"] = (("y", "x"), np.zeros(centre.shape, np.uint8))
        attrs = about(
            grey_noise=noise,
            blur_um=max(blur, 0.3),
            voxel_um=[voxel] * 3,
            grey_coating_top=COAT if top else np.nan,
            grey_coating_bottom=COAT if bottom else np.nan,
        )
        surfaces = xr.Dataset(data, coords={"y": y, "x": x}, attrs=attrs)
        return Made(volume=volume(values.astype(np.float32), voxel), surfaces=surfaces, faces=faces)

    return make


@pytest.fixture(scope="session")
def rough():
    """A small noisy sheet with a wavy, rough surface, missing columns and a hole: what tiles must
    not change."""
    rng = np.random.default_rng(4)
    voxel, shape = 3.0, (60, 52, 40)
    z, y, x = (np.arange(n) * voxel for n in shape)
    centre = 90 + 8 * np.sin(y / 30)[:, None] + 0.3 * (x - x.mean())[None, :]
    offsets = {
        "top": 38.0,
        "interface_top": 25.0,
        "interface_bottom": -25.0,
        "bottom": -37.0,
        "centre": 0.0,
    }
    heights = {
        k: centre + v + (rng.normal(0, 0.5, centre.shape) if k != "centre" else 0)
        for k, v in offsets.items()
    }
    zz = z[:, None, None]
    values = staircase(heights, zz, 3.0)
    inner = step(heights["interface_top"] - zz, 3.0) - step(heights["interface_bottom"] - zz, 3.0)
    values += 30 * np.sin(x / 5)[None, None, :] * np.cos(y / 7)[None, :, None] * inner
    values += rng.normal(0, 12.0, shape)
    status = np.zeros(centre.shape, np.uint8)
    status[20:25, 10:14] = 1
    heights["top"][30, 20] = np.nan
    data = {k: (("y", "x"), v) for k, v in heights.items()} | {"status": (("y", "x"), status)}
    attrs = about(grey_noise=12.0, blur_um=3.0, voxel_um=[3.0] * 3)
    surfaces = xr.Dataset(data, coords={"y": y, "x": x}, attrs=attrs)
    return Made(
        volume=volume(np.clip(values, 0, 255).astype(np.uint8), voxel),
        surfaces=surfaces,
        faces=offsets,
    )
