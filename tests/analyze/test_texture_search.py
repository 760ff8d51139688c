"""A sheet in an image by texture alone: fields of known rotation, scale and place, and fields that share nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

import planish as pl
from planish.analyze.texture_search import _exceeded
from planish.core.errors import CannotRegister, InputError
from planish.core.transform import Similarity, nearest_similarity
from planish.register import RegistrationParams

PIXEL_UM = 6.0


def field(shape, seed):
    """A field whose correlation falls to half within some 15 um."""
    rng = np.random.default_rng(seed)
    smooth = ndimage.gaussian_filter(rng.standard_normal(shape), 2.2) + 0.3 * ndimage.gaussian_filter(
        rng.standard_normal(shape), 8.0
    )
    return (smooth - smooth.mean()) / smooth.std()


def pair(*, place, r, seed=1, shape=(200, 250), image_shape=(330, 360)):
    """Flat maps of a sheet and an image in which it lies at a place, with a correlation of its textures."""
    sheet = field(shape, seed)
    y, x = (np.arange(n) * PIXEL_UM for n in image_shape)
    xy = place.inverse(np.stack(np.meshgrid(x, y), axis=-1))
    at = np.moveaxis(xy / PIXEL_UM, -1, 0)[::-1]
    seen = ndimage.map_coordinates(sheet, at, order=3, mode="constant", cval=np.nan)
    noise = field(image_shape, seed + 100)
    image = np.where(np.isfinite(seen), r * np.nan_to_num(seen) + np.sqrt(1 - r**2) * noise, noise)
    v, u = (np.arange(n) * PIXEL_UM for n in shape)
    maps = xr.Dataset({"thickness": (("v", "u"), 80 + 5 * sheet)}, coords={"v": v, "u": u})
    maps["valid"] = (("v", "u"), np.ones(shape, bool))
    attrs = {"pixel_um": [PIXEL_UM] * 2}
    return maps, xr.DataArray(100 + 10 * image, coords={"y": y, "x": x}, dims=("y", "x"), attrs=attrs)


def placed(rotation_deg, *, scale=1.0, mirrored=False, at=(1060.0, 980.0)):
    turn = Similarity(scale=scale, rotation_rad=np.deg2rad(rotation_deg), mirrored=mirrored)
    return nearest_similarity(turn.matrix(), np.array([747.0, 597.0]), np.array(at))


CORNERS = np.array([[100.0, 100.0], [1400.0, 100.0], [100.0, 1100.0], [1400.0, 1100.0]])


@pytest.mark.parametrize(
    ("place", "r", "limit_um"),
    [
        (placed(0.0), 0.6, 3.5),
        (placed(137.0, scale=1.018), 0.6, 3.5),
        (placed(-61.0, scale=0.985, mirrored=True), -0.6, 3.5),
        (placed(203.0, at=(820.0, 800.0)), 0.35, 6.0),
    ],
)
def test_the_place_is_found_at_any_rotation_hand_and_scale_and_with_either_sign(place, r, limit_um):
    maps, image = pair(place=place, r=r)
    found = pl.register_texture(maps, image, mirrored=place.mirrored)
    off_um = np.linalg.norm(found(CORNERS) - place(CORNERS), axis=1)
    stated_um = found.fit.expected_error_um(CORNERS)
    assert off_um.max() < limit_um
    assert np.sqrt(np.mean(off_um**2)) < 3.0 * np.sqrt(np.mean(stated_um**2))
    assert found.source == "texture"
    assert found.false_probability < 1e-5
    assert set(found.marks["moving_source"].values) == {"tile"}
    assert "moving_diameter" not in found.marks


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_an_image_of_something_else_is_refused_with_its_best_places(seed):
    maps, _ = pair(place=placed(20.0), r=0.6, seed=seed)
    _, image = pair(place=placed(20.0), r=0.6, seed=seed + 50)
    with pytest.raises(CannotRegister, match="No place of the sheet in the image stands out") as refused:
        pl.register_texture(maps, image)
    assert "standard deviations of chance" in str(refused.value)


def test_the_other_hand_is_found_only_where_it_is_asked_for():
    maps, image = pair(place=placed(40.0, mirrored=True), r=0.6)
    with pytest.raises(CannotRegister):
        pl.register_texture(maps, image)
    found = pl.register_texture(maps, image, params=RegistrationParams(mirror=True))
    assert found.fit.mirrored


@pytest.mark.parametrize("value", [100.0, np.nan])
def test_a_blank_image_is_refused(value):
    maps, image = pair(place=placed(0.0), r=0.6)
    with pytest.raises(CannotRegister, match="texture"):
        pl.register_texture(maps, image.copy(data=np.full(image.shape, value)))


def test_maps_without_a_thickness_are_refused():
    maps, image = pair(place=placed(0.0), r=0.6)
    with pytest.raises(InputError, match="no thickness"):
        pl.register_texture(maps.rename(thickness="gloss"), image)


def test_a_rough_place_makes_the_search_small_and_a_wrong_one_is_refused():
    place = placed(137.0)
    maps, image = pair(place=place, r=0.6)
    found = pl.register_texture(maps, image, params={"near": (1060.0, 980.0, 150.0)})
    assert np.linalg.norm(found(CORNERS) - place(CORNERS), axis=1).max() < 3.5
    with pytest.raises(CannotRegister, match="No place"):
        pl.register_texture(maps, image, params={"near": (1500.0, 980.0, 150.0)})


def test_one_hole_in_both_is_enough_to_look_where_they_meet():
    place = placed(211.0)
    maps, image = pair(place=place, r=0.6)
    hole = np.array([300.0, 900.0])
    holes = tuple(
        xr.Dataset({"x": ("mark", [x]), "y": ("mark", [y]), "diameter": ("mark", [170.0])}).assign(
            {f"cov_{k}": ("mark", [float(k[0] == k[1])]) for k in ("xx", "xy", "yy")}
        )
        for x, y in (hole, place(hole))
    )
    found = pl.register_texture(maps, image, holes=holes)
    assert np.linalg.norm(found(CORNERS) - place(CORNERS), axis=1).max() < 3.5
    assert (found.count("moving"), found.fit.moving.shape[0]) == (
        found.fit.moving.shape[0] + 1,
        found.count("fixed") - 1,
    )


@pytest.mark.nightly
def test_a_size_that_is_hardly_known_is_found():
    place = placed(-40.0, scale=0.62, at=(1060.0, 980.0))
    maps, image = pair(place=place, r=0.7)
    with pytest.raises(CannotRegister, match="scale_tolerance"):
        pl.register_texture(maps, image)
    found = pl.register_texture(maps, image, params={"scale_tolerance": 1.0})
    assert found.fit.transform.scale == pytest.approx(0.62, abs=0.004)
    assert np.linalg.norm(found(CORNERS) - place(CORNERS), axis=1).max() < 5.0


def test_an_image_of_the_bottom_is_found_where_no_side_is_given():
    place = placed(70.0, mirrored=True)
    maps, image = pair(place=place, r=0.6)
    assert pl.register_texture(maps, image, mirrored=None).fit.mirrored


@pytest.mark.parametrize("kind", ["sheets", "images"])
def test_two_sheets_and_two_images_are_registered(kind):
    place = placed(25.0)
    maps, image = pair(place=place, r=0.8)
    if kind == "sheets":
        moving, valid = maps, xr.full_like(image, True, dtype=bool)
        fixed = xr.Dataset({"thickness": image, "valid": valid}).rename(x="u", y="v")
    else:
        moving = maps["thickness"].rename(u="x", v="y").assign_attrs(pixel_um=[PIXEL_UM] * 2)
        fixed = image
    found = pl.register_texture(moving, fixed)
    assert np.linalg.norm(found(CORNERS) - place(CORNERS), axis=1).max() < 3.5
    back = pl.register_texture(fixed, moving)
    assert np.linalg.norm(back(place(CORNERS)) - CORNERS, axis=1).max() < 3.5


def test_a_sheet_is_registered_to_a_part_of_it_and_an_image_to_a_sheet():
    place = placed(310.0)
    maps, image = pair(place=place, r=0.7)
    found = pl.register_texture(image, maps)
    assert np.linalg.norm(found(place(CORNERS)) - CORNERS, axis=1).max() < 3.5
    part = image.isel(y=slice(60, 250), x=slice(70, 260))
    assert np.linalg.norm(pl.register_texture(maps, part)(CORNERS) - place(CORNERS), axis=1).max() < 5.0


def test_holes_are_no_texture():
    """Burnt holes are far darker than the texture, and stand in the image alone: the maps know nothing there."""
    place = placed(75.0)
    maps, image = pair(place=place, r=0.3)
    holes_um = np.array([[x, y] for x in (250.0, 700.0, 1200.0) for y in (200.0, 600.0, 1000.0)]) + 20.0
    in_image = place(holes_um)
    marks = [
        xr.Dataset({"x": ("mark", x), "y": ("mark", y), "diameter": ("mark", np.full(len(x), 180.0))})
        for x, y in (holes_um.T, in_image.T)
    ]
    marks = [m.assign({f"cov_{k}": ("mark", np.zeros(len(holes_um))) for k in ("xx", "xy", "yy")}) for m in marks]
    x, y = np.meshgrid(image["x"], image["y"])
    distance = np.min([np.hypot(x - cx, y - cy) for cx, cy in in_image], axis=0)
    dark = image.where(distance > 90.0, 0.0)
    with pytest.raises(CannotRegister):
        pl.register_texture(maps, dark)
    found = pl.register_texture(maps, dark, holes=(marks[0], marks[1]))
    assert np.linalg.norm(found(CORNERS) - place(CORNERS), axis=1).max() < 8.0


@pytest.mark.parametrize("contrast", [1.0, 3.0])
def test_a_print_hides_no_texture(contrast):
    """A screen of 167 um, three times as strong as the sheet's texture; the sheet itself is not printed in the scan."""
    place = placed(40.0)
    maps, image = pair(place=place, r=0.6)
    x, y = np.meshgrid(image["x"], image["y"])
    turn = np.deg2rad(22.0)
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    dots = np.cos(2 * np.pi * along / 167.0) + np.cos(2 * np.pi * across / 167.0) > 0.3
    found = pl.register_texture(maps, image - contrast * float(image.std()) * dots)
    assert np.linalg.norm(found(CORNERS) - place(CORNERS), axis=1).max() < 4.0


@pytest.mark.parametrize("mirrored", [False, True])
def test_transmitted_light_is_found_by_the_thickness_and_said_so(mirrored):
    """Thick places are dark from either side; the hand says from which one the picture was taken."""
    place = placed(20.0, mirrored=mirrored)
    maps, image = pair(place=place, r=-0.5)
    coating = (("v", "u"), 10.0 + field(maps["thickness"].shape, 77))
    found = pl.register_texture(maps.assign(coating_top=coating, coating_bottom=coating), image, mirrored=None)
    assert found.fit.mirrored is mirrored
    assert "The thickness leads" in found.sentence
    assert np.linalg.norm(found(CORNERS) - place(CORNERS), axis=1).max() < 4.0


@pytest.mark.parametrize(("right_um", "said"), [(1e6, "lies beside it"), (1500.0, "4 are needed")])
def test_a_given_place_that_is_none_is_refused(right_um, said):
    place = placed(40.0)
    maps, image = pair(place=place, r=0.6)
    assert "The place was given" in pl.register_texture(maps, image, place=place).sentence
    wrong = replace(place, shift_um=(place.shift_um[0] + right_um, place.shift_um[1]))
    with pytest.raises(CannotRegister, match=said):
        pl.register_texture(maps, image, place=wrong)


def test_a_pattern_that_repeats_is_refused_by_its_name():
    maps, image = pair(place=placed(0.0), r=0.6)
    tile = maps["thickness"].values[:100, :100]
    maps["thickness"] = (("v", "u"), np.tile(tile, (2, 3))[:, :250])
    image = image.copy(data=np.tile(tile, (4, 4))[:330, :360])
    with pytest.raises(CannotRegister, match=r"nearly alike.*repeats"):
        pl.register_texture(maps, image)


def test_a_radius_that_is_none_and_sheets_without_a_common_map_are_refused():
    maps, image = pair(place=placed(0.0), r=0.6)
    with pytest.raises(InputError, match="radius"):
        pl.register_texture(maps, image, params={"near": (1060.0, 980.0, -3.0)})
    with pytest.raises(CannotRegister, match="in common"):
        pl.register_texture(maps, maps.rename(thickness="base_thickness"))


def test_a_map_that_is_known_in_little_of_the_field_has_no_part():
    place = placed(30.0)
    maps, image = pair(place=place, r=0.6)
    little = np.where(np.arange(maps.sizes["v"])[:, None] < 60, maps["thickness"].values, np.nan)
    maps = maps.assign(coating_top=(("v", "u"), little), topography_top=(("v", "u"), little))
    assert np.linalg.norm(pl.register_texture(maps, image)(CORNERS) - place(CORNERS), axis=1).max() < 3.5


def test_chance_is_a_probability_however_high_it_gets():
    """A pattern that repeats reaches much at every rotation: no factor underflows there."""
    for height in (3.0, 5.0, 45.0):
        others = np.linspace(height, 1.3 * height, 40)
        p = [_exceeded(z, others) for z in (height, 1.5 * height, 3.0 * height)]
        assert np.isfinite(p).all()
        assert p[0] > 0.9
        assert p[0] >= p[1] >= p[2] >= 0.0
