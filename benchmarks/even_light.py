"""Uneven light: what it does to r, whether it is seen, and what r is with it off, or divided by an
image of a white sheet.

``python -m benchmarks even_light [IMAGES [SIDE]]``

True coatings of 20 drawn sheets of 5.6 x 4.8 mm and drawn images of 2 to 3 mm of them, in a light
that falls off by 0 to 25 % in the corners and along a ramp of 0 to 20 %; of every part there is an
image in even light as well. What does not come of the coating is drawn anew in each image; the true
r of a sheet is the mean over 100 parts in even light. White and dark image have a noise of 1 %.
In SIDE images light from one side makes 0 to 80 % of what image and sheet share.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from planish import correct_light, image
from planish.analyze import Correlation, LightField, correlate, light_field, texture_lag
from planish.checks import run_checks
from planish.core.area import area_mean
from planish.results import EvidenceFacts
from planish.synthetic import (
    PRESETS,
    BurnParams,
    CameraParams,
    SpecimenParams,
    Warp,
    image_material,
    make_specimen,
)
from planish.texture import textures
from planish.texture.detrend import in_band

_SHEETS, _POINT_UM, _PIXEL_UM, _REDRAWN = 20, 100.0, 10.0, 100
_PAPERS = ("wfc90", "wfc118", "wfc135", "board")
_NOISE, _REFERENCE_NOISE, _DARK = 0.005, 0.01, 0.02
_SIDE_LIGHT = 0.25
"""True share of the slopes above which the check is to ask for a look."""


class Sheet:
    """True coating, reflectance and face of a sheet on pixels of an image; NaN near holes.

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
            size_um=(5600.0, 4800.0),
            paper=PRESETS[_PAPERS[number % len(_PAPERS)]][1].as_slab(),
            holes=BurnParams(pattern="irregular", count=16),
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
        self.top = top
        self.size = tuple(rng.integers(200, 300, 2))
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
    """Points of the image by a white and a dark one, which are as noisy as single pictures are."""
    white, dark = (
        exposed(rng, np.full(lit.shape, grey), lit, _REFERENCE_NOISE) for grey in (0.9, 0.0)
    )
    picture = image(np.nan_to_num(taken, nan=_DARK), pixel_um=_PIXEL_UM)
    corrected = correct_light(picture, white=white, dark=dark, exposure=1.0).image.values
    return points(np.where(np.isfinite(taken), corrected, np.nan))


def asks(field):
    """Whether the check of even light asks for a look."""
    names = {"a": "sheet", "a_map": "coating_top", "b": "image", "b_map": "image"}
    (check,) = run_checks(EvidenceFacts(**names, declared=False, light_field=field))
    return check.state == "look"


class Drawn(NamedTuple):
    """An image and what was said of it; r of its sheet, as it is and with a field off."""

    true: tuple[float, float]
    even: LightField
    uneven: LightField
    divided: Correlation


def drawn(sheet, number, count, redrawn=_REDRAWN):
    """So many images of a sheet."""
    rng = np.random.default_rng([51, number])
    z = []
    for _ in range(redrawn):
        x, even = sheet.photographed(rng)
        field = light_field(x, points(even), point_um=_POINT_UM)[0]
        z.append((math.atanh(field.r_plain), math.atanh(field.r)))
    true = tuple(np.tanh(np.mean(z, axis=0)).tolist())
    for _ in range(count):
        x, even = sheet.photographed(rng)
        lit = light(rng, even.shape, rng.uniform(0.0, 0.25), rng.uniform(0.0, 0.2))
        fields = []
        for lamp in (np.ones(even.shape), lit):
            taken = exposed(rng, even, lamp, _NOISE)
            fields.append(light_field(x, points(taken), point_um=_POINT_UM)[0])
        yield Drawn(true, *fields, correlate(x, divided(rng, taken, lit), pixel_um=_POINT_UM))


def holds(intervals, values):
    """Share of the intervals that hold a value."""
    return float(np.mean([a <= v <= b for (a, b), v in zip(intervals, values, strict=True)]))


def uneven(rows):
    """Print what was said of images; the number of goals that were missed."""
    plain, off = ([row.true[k] for row in rows] for k in (0, 1))
    is_off = np.array([abs(row.uneven.r_plain - row.even.r_plain) > 0.03 for row in rows])
    looks, alarms = (
        np.array([asks(f) for f in fields])
        for fields in ([r.uneven for r in rows], [r.even for r in rows])
    )
    moved = np.median([abs(row.divided.r - row.even.r_plain) for row in rows])
    lost = np.median([abs(row.uneven.r_plain - row.even.r_plain) for row in rows])
    back = np.median([abs(row.uneven.r - row.even.r) for row in rows])
    covered = {
        "even light": holds([row.even.interval_plain for row in rows], plain),
        "uneven light": holds([row.uneven.interval_plain for row in rows], plain),
        "divided by white and dark": holds([row.divided.interval for row in rows], plain),
        "field off, even light": holds([row.even.interval for row in rows], off),
        "field off, uneven light": holds([row.uneven.interval for row in rows], off),
    }
    print(
        f"{len(rows)} images; r moves by (median): light {lost:.3f}, divided {moved:.4f},"
        f" field off {back:.4f}"
    )
    print("intervals hold the true r: " + ", ".join(f"{k} {v:.3f}" for k, v in covered.items()))
    others = looks[~is_off].mean() if not is_off.all() else 0.0
    print(
        f"a look in {looks[is_off].mean():.3f} of {is_off.sum()} whose r is off by more than .03,"
        f" in {others:.3f} of the others in uneven light, in {alarms.mean():.3f} in even light"
    )
    held = [covered[k] for k in ("divided by white and dark", "field off, uneven light")]
    missed = [moved > 0.01, looks[is_off].mean() < 0.9, alarms.mean() > 0.05]
    return sum([*missed, *(not 0.92 <= v <= 0.98 for v in held)])


def side_lit(sheet, number, share):
    """The share that the slopes of a sheet are said to have in an image, and whether it is a look.

    Of what image and sheet have in common in waves of 15 to 250 um, ``share`` is the slopes' own.
    """
    rng, pixel = np.random.default_rng([52, number]), (_PIXEL_UM, _PIXEL_UM)
    part = sheet.part(rng)
    coating, top = sheet.coating[part], sheet.top[part]
    slope = np.gradient(top, _PIXEL_UM, axis=1)
    is_used = np.isfinite(coating)
    c, g = (
        in_band(np.nan_to_num(m), is_used, pixel, (15.0, 250.0))[is_used] for m in (coating, slope)
    )
    common = (c @ g) / (c @ c)
    rest = g - common * c
    strength = math.sqrt(share / (1 - share) * (c @ c) / (rest @ rest))
    shared = coating + strength * (slope - common * coating)
    texture = ndimage.gaussian_filter(rng.standard_normal(coating.shape), 20 / _PIXEL_UM)
    seen = shared + 1.5 * np.std(coating[is_used]) / texture.std() * texture
    maps = {"coating": coating, "face": top, "image": seen}
    known = {k: np.where(is_used, m, np.nan) for k, m in maps.items()}
    lag = texture_lag(
        textures(known, is_used, pixel).with_slopes("face"),
        ["coating", "face_x", "face_y"],
        "image",
        slopes=2,
        reach_um=150.0,
    )
    states = [check.state for check in run_checks(lag.numbers("coating_top"))]
    return share, lag.light, states == ["look"]


def side(rows):
    """Print in how many images light from one side is seen; the number of goals missed."""
    shares, stated, looks = np.array(rows).T
    above, below = looks[shares > _SIDE_LIGHT], looks[shares < _SIDE_LIGHT / 2]
    print(
        f"light from one side: a look in {above.mean():.3f} of {above.size} above"
        f" {_SIDE_LIGHT:g}, in {int(below.sum())} of {below.size} below half of it; stated less"
        f" true {np.nanmean(stated - shares):+.3f} ± {np.nanstd(stated - shares):.3f}"
    )
    return int(above.mean() < 0.95) + int(below.any())


def of_sheet(number, images, sides):
    """What was said of the images of a sheet in uneven light, and in light from one side."""
    sheet, count = Sheet(number), _SHEETS * sides
    numbers = [number + _SHEETS * k for k in range(sides)]
    lit = [side_lit(sheet, k, 0.8 * (k + 0.5) / count) for k in numbers]
    return list(drawn(sheet, number, images)), lit


def main(images=200, sides=40):
    """Print what was seen and what r was; the number of goals missed."""
    of_sheets = [
        of_sheet(k, max(1, images // _SHEETS), max(1, sides // _SHEETS)) for k in range(_SHEETS)
    ]
    rows = [row for drawn_rows, _ in of_sheets for row in drawn_rows]
    return uneven(rows) + side([row for _, lit in of_sheets for row in lit])
