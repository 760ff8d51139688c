"""Uneven light: what it does to r, whether it is seen, and what r is with it off, or divided by an
image of a white sheet.

``python -m benchmarks even_light [IMAGES [SIDE]]``

True coatings of 20 drawn sheets of 8 x 7 mm and drawn images of 2 to 4 mm of them, in a light that
falls off by 0 to 25 % in the corners and along a ramp of 0 to 20 %; of every part there is an image
in even light as well. What does not come of the coating is drawn anew in each image; the true r of
a sheet is the mean over 100 parts in even light. The white and the dark image have a noise of 1 %.
In SIDE images light from one side makes 0 to 80 % of what image and sheet share.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from planish.core.area import area_mean
from planish.synthetic import (
    PRESETS,
    BurnParams,
    CameraParams,
    SpecimenParams,
    Warp,
    image_material,
    make_specimen,
)

_SHEETS, _POINT_UM, _PIXEL_UM, _REDRAWN = 20, 100.0, 10.0, 100
_PAPERS = ("wfc90", "wfc118", "wfc135", "board")
_NOISE, _REFERENCE_NOISE, _DARK = 0.005, 0.01, 0.02


class Sheet:
    """True coating, reflectance and slope of a sheet on pixels of an image; NaN near holes.

    ``size`` is that of an image of it in pixels, ``spread`` that of what is not the coating's.
    """

    def __init__(self, number):
        rng = np.random.default_rng([50, number])
        camera = CameraParams(
            pixel_um=_PIXEL_UM,
            turn_range_deg=0.0,
            shift_range_um=0.0,
            shading=0.0,
            vignetting=0.0,
            nuisance_sd=0.0,
            noise=0.0,
            bits=16,
            backing=str(rng.choice(["pile", "black"])),
        )
        params = SpecimenParams(
            size_um=(8000.0, 7000.0),
            paper=PRESETS[_PAPERS[number % len(_PAPERS)]][1].as_slab(),
            holes=BurnParams(pattern="irregular", count=30),
            warp=Warp(bump_um=0.0),
            camera=camera,
            seed=number,
        )
        made = make_specimen(params)
        u, v = image_material(made.pose, made.image.shape, _PIXEL_UM)
        top, below = (made.sheet.at(face, u, v) for face in made.sheet.faces[:2])
        is_used = made.sheet.at(made.sheet.rim_um[0], u, v) > 100.0
        self.coating = np.where(is_used, np.maximum(top - below, 0.0), np.nan)
        self.reflectance = np.where(is_used, made.image.values, np.nan)
        self.slope = np.gradient(top, _PIXEL_UM, axis=1)
        self.size = tuple(rng.integers(200, 400, 2))
        x, y = (points(m) for m in (self.coating, self.reflectance))
        is_valid = np.isfinite(x) & np.isfinite(y)
        own_r = float(np.corrcoef(x[is_valid], y[is_valid])[0, 1])
        ratio = (own_r / float(rng.uniform(0.3, 0.8))) ** 2
        self.spread = float(y[is_valid].std()) * math.sqrt(max(ratio - 1.0, 0.05))

    def part(self, rng):
        """Rows and columns that an image shows."""
        starts = [
            rng.integers(0, n - k) for n, k in zip(self.coating.shape, self.size, strict=True)
        ]
        return tuple(slice(k, k + n) for k, n in zip(starts, self.size, strict=True))

    def photographed(self, rng):
        """Points of the coating, and an image in even light with texture of its own."""
        part = self.part(rng)
        texture = ndimage.gaussian_filter(rng.standard_normal(self.size), 100 / _PIXEL_UM)
        image = self.reflectance[part] + self.spread / float(points(texture).std()) * texture
        return points(self.coating[part]), image


def points(values):
    """Means over points of 100 um."""
    return area_mean(values, (_POINT_UM / _PIXEL_UM, _POINT_UM / _PIXEL_UM))


def light(rng, shape, fall_off, ramp):
    """Light from 1 down: lost in the corners, and along a direction; its middle is drawn."""
    y, x = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in shape), indexing="ij")
    turn, (down, across) = rng.uniform(0.0, 2 * np.pi), rng.uniform(-0.3, 0.3, 2)
    along = (x * np.cos(turn) + y * np.sin(turn)) / math.sqrt(2.0)
    radius = ((x - across) ** 2 + (y - down) ** 2) / ((1 + abs(across)) ** 2 + (1 + abs(down)) ** 2)
    return (1 - fall_off * radius) * (1 - ramp * (1 + along) / 2)


def exposed(rng, image, lit, noise):
    """What the camera takes: light and its dark level, with noise."""
    return _DARK + (1 - _DARK) * image * lit + noise * rng.standard_normal(image.shape)


def divided(rng, taken, lit):
    """The image by a white and a dark one that are as noisy as single pictures are."""
    white, dark = (
        exposed(rng, np.full(lit.shape, grey), lit, _REFERENCE_NOISE) for grey in (0.9, 0.0)
    )
    return (taken - dark) / (white - dark)
