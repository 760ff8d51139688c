"""A sheet in an image by texture alone: fields of known rotation, scale and place, and fields that
share nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

import planish as pl
from folders import refused
from planish.core.errors import CannotRegister, InputError
from planish.core.grid import Grid
from planish.core.transform import Similarity, nearest_similarity
from planish.register import RegistrationParams
from planish.register.by_texture import rotations
from planish.register.by_texture.planes import TexturedPlane
from planish.register.by_texture.rotations import (
    FALSE,
    Candidate,
    Near,
    _exceeded,
    _Scanner,
    _Steps,
    search_place,
)
from planish.register.by_texture.search import _seen_from
from planish.texture.length_unit import length_unit_um
from planish.texture.textures import Textures, standard

PIXEL_UM = 6.0
SHAPE, IMAGE_SHAPE = (200, 250), (330, 360)
CORNERS = np.array([[100.0, 100.0], [1400.0, 100.0], [100.0, 1100.0], [1400.0, 1100.0]])
NEAR_UM = 3.5


def field(shape, seed):
    """A field whose correlation falls to half within some 15 um."""
    rng = np.random.default_rng(seed)
    smooth = ndimage.gaussian_filter(
        rng.standard_normal(shape), 2.2
    ) + 0.3 * ndimage.gaussian_filter(rng.standard_normal(shape), 8.0)
    return (smooth - smooth.mean()) / smooth.std()


def pair(*, place, r, seed=1):
    """Flat maps of a sheet and an image in which it lies at a place, with a correlation of its
    textures."""
    sheet = field(SHAPE, seed)
    y, x = (np.arange(n) * PIXEL_UM for n in IMAGE_SHAPE)
    xy = place.inverse(np.stack(np.meshgrid(x, y), axis=-1))
    at = np.moveaxis(xy / PIXEL_UM, -1, 0)[::-1]
    seen = ndimage.map_coordinates(sheet, at, order=3, mode="constant", cval=np.nan)
    noise = field(IMAGE_SHAPE, seed + 100)
    image = np.where(np.isfinite(seen), r * np.nan_to_num(seen) + np.sqrt(1 - r**2) * noise, noise)
    v, u = (np.arange(n) * PIXEL_UM for n in SHAPE)
    maps = xr.Dataset({"thickness": (("v", "u"), 80 + 5 * sheet)}, coords={"v": v, "u": u})
    maps["valid"] = (("v", "u"), np.ones(SHAPE, bool))
    attrs = {"pixel_um": [PIXEL_UM] * 2}
    return maps, xr.DataArray(
        100 + 10 * image, coords={"y": y, "x": x}, dims=("y", "x"), attrs=attrs
    )


def placed(rotation_deg, *, scale=1.0, mirrored=False, at=(1060.0, 980.0)):
    turn = Similarity(scale=scale, rotation_rad=np.deg2rad(rotation_deg), mirrored=mirrored)
    return nearest_similarity(turn.matrix(), np.array([747.0, 597.0]), np.array(at))


def apart(found, place, at=CORNERS):
    """The largest error in um of a registration at some places of its moving layer."""
    return np.linalg.norm(found(at) - place(at), axis=1).max()


def holes_at(xy, diameter_um):
    """Holes at places (n, 2) that are known exactly."""
    columns = {"x": xy[:, 0], "y": xy[:, 1], "diameter": np.full(len(xy), diameter_um)}
    columns |= {f"cov_{k}": np.zeros(len(xy)) for k in ("xx", "xy", "yy")}
    return xr.Dataset({name: ("mark", values) for name, values in columns.items()})


@pytest.mark.ci
@pytest.mark.parametrize(
    ("place", "r", "limit_um"),
    [
        (placed(137.0, scale=1.018), 0.6, NEAR_UM),
        (placed(-61.0, scale=0.985, mirrored=True), -0.6, NEAR_UM),
        (placed(203.0, at=(820.0, 800.0)), 0.35, 6.0),
    ],
)
def test_the_place_is_found_at_any_rotation_hand_and_scale_and_with_either_sign(place, r, limit_um):
    maps, image = pair(place=place, r=r)
    found = pl.register_texture(maps, image, mirrored=place.mirrored)
    assert apart(found, place) < limit_um
    true_um = np.linalg.norm(found(CORNERS) - place(CORNERS), axis=1)
    stated_um = found.fit.expected_error_um(CORNERS)
    assert np.sqrt(np.mean(true_um**2)) < 3.0 * np.sqrt(np.mean(stated_um**2))
    assert found.source == "texture"
    assert found.false_probability < 1e-5
    assert set(found.marks["moving_source"].values) == {"tile"}
    assert "moving_diameter" not in found.marks


@pytest.mark.ci
def test_an_image_of_something_else_or_of_a_pattern_that_repeats_is_refused():
    maps, _ = pair(place=placed(20.0), r=0.6, seed=2)
    _, image = pair(place=placed(20.0), r=0.6, seed=52)
    words = "(?s)No place of the sheet in the image stands out.*standard deviations of chance"
    refused(CannotRegister, words, pl.register_texture, maps, image)
    tile = maps["thickness"].values[:100, :100]
    maps["thickness"] = (("v", "u"), np.tile(tile, (2, 3))[:, :250])
    image = image.copy(data=np.tile(tile, (4, 4))[:330, :360])
    refused(CannotRegister, r"nearly alike.*repeats", pl.register_texture, maps, image)


def unit(pixels_um, sides_um):
    return length_unit_um(
        *(
            Grid.regular((round(side / px),) * 2, px)
            for px, side in zip(pixels_um, sides_um, strict=True)
        )
    )


def test_paper_is_measured_in_um_and_what_is_no_paper_by_its_coarser_pixel():
    for pixels_um, sides_um in (
        ((0.65, 0.3), (1300.0, 5000.0)),
        ((4.0, 2.6), (300.0, 8000.0)),
        ((12.0, 21.2), (12_000.0, 200_000.0)),
    ):
        assert unit(pixels_um, sides_um) == 1.0
    grids = [Grid.regular((600, 600), pixel_um) for pixel_um in (0.5, 0.4)]
    assert length_unit_um(*grids, by_pixel=True) == pytest.approx(
        0.1
    )  # looked at where paper's shows nothing
    assert unit((0.02, 0.04), (28.0, 28.0)) == pytest.approx(0.01)
    assert unit((400.0, 260.0), (200_000.0, 300_000.0)) == pytest.approx(100.0)
    assert unit((0.04, 0.02), (400.0, 400.0)) == pytest.approx(0.01)  # a large picture of many
    # Too small for the waves of paper; a pixel is 4 to 8.6 units.
    assert unit((1.0, 1.0), (200.0, 2000.0)) == pytest.approx(10 ** (-2 / 3))
    for pixel_um in np.geomspace(0.001, 0.25, 40):
        side_um = 500 * pixel_um
        of_this = unit((pixel_um, 0.5 * pixel_um), (side_um, side_um))
        assert 3.9 < pixel_um / of_this < 8.7
        of_smaller = unit((0.01 * pixel_um, 0.005 * pixel_um), (0.01 * side_um,) * 2)
        assert 100 * of_smaller == pytest.approx(of_this)


@pytest.mark.ci
@pytest.mark.parametrize("size", [0.01, 100.0])
def test_what_is_a_hundred_times_smaller_or_larger_than_paper_is_found_as_paper_is(size):
    place = placed(137.0, scale=1.018)
    pair_of_fields = pair(place=place, r=0.6)

    def found(size):
        pixel_um = 4.0 * size
        maps, image = (
            d.assign_coords({k: pixel_um * np.arange(n) for k, n in d.sizes.items()})
            for d in pair_of_fields
        )
        image.attrs["pixel_um"] = [pixel_um] * 2
        near_um = (707 * size, 653 * size, 200 * size)
        params = RegistrationParams(near=near_um)
        return pl.register_texture(maps, image, params=params)

    paper, other = found(1.0), found(size)
    assert other.false_probability == pytest.approx(paper.false_probability)
    at = 4.0 / PIXEL_UM * CORNERS
    np.testing.assert_allclose(other(size * at), size * paper(at), rtol=0, atol=1e-4 * size)
    np.testing.assert_allclose(
        other.fit.expected_error_um(size * at), size * paper.fit.expected_error_um(at), rtol=1e-4
    )


@pytest.mark.ci
def test_features_of_few_pixels_are_found_where_the_waves_of_paper_are_longer():
    """At pixels of 1.5 um the field has the size of paper, and its features have not."""
    place = placed(137.0)
    size = 1.5 / PIXEL_UM
    maps, image = (
        d.assign_coords({k: 1.5 * np.arange(n) for k, n in d.sizes.items()})
        for d in pair(place=place, r=0.6)
    )
    image.attrs["pixel_um"] = [1.5, 1.5]
    found = pl.register_texture(maps, image)
    off_um = np.linalg.norm(found(size * CORNERS) - size * place(CORNERS), axis=1)
    assert off_um.max() < size * NEAR_UM
    assert found.false_probability < 1e-5


@pytest.mark.ci
def test_pictures_of_a_hundredth_of_papers_size_are_linked_and_judged():
    place, pixel_um = placed(137.0), 0.04
    maps, seen = pair(place=place, r=0.6)
    layers = [pl.image(m.values, pixel_um=pixel_um) for m in (maps["thickness"], seen)]
    middle_um = 0.04 / PIXEL_UM * np.array([1060.0, 980.0])
    options = {"by": "texture", "near": (*middle_um.tolist(), 2.0)}
    run = pl.link(*layers, registration=options, correlate={"point_um": 1.0})
    facts = run.results.layers[0].registration
    assert (facts.source, facts.false_probability < 1e-5) == ("texture", True)
    assert facts.held_out.registration == "refined (cross-fitted)"
    assert 0.5 < facts.held_out.r < 0.65
    assert facts.held_out.sentence.startswith(
        "On held-out tiles, which had no part in the place, without waves above 0.01 mm"
    )
    (found,) = run.registrations.values()
    size = pixel_um / PIXEL_UM
    off_px = np.linalg.norm(found(size * CORNERS) - size * place(CORNERS), axis=1) / pixel_um
    assert off_px.max() < NEAR_UM / PIXEL_UM
    states = {check.name: check.state for check in run.results.checks}
    assert states["side and specimen"] == "pass"


@pytest.mark.ci
def test_the_other_hand_is_found_only_where_it_is_asked_for_or_no_side_is_given():
    maps, image = pair(place=placed(40.0, mirrored=True), r=0.6)
    with pytest.raises(CannotRegister):
        pl.register_texture(maps, image)
    assert pl.register_texture(maps, image, params=RegistrationParams(mirror=True)).fit.mirrored
    assert pl.register_texture(maps, image, mirrored=None).fit.mirrored


@pytest.mark.ci
def test_layers_without_a_texture_in_common_and_a_radius_that_is_none_are_refused():
    maps, image = pair(place=placed(0.0), r=0.6)
    for value in (100.0, np.nan):
        blank = image.copy(data=np.full(image.shape, value))
        refused(CannotRegister, "texture", pl.register_texture, maps, blank)
    refused(InputError, "no thickness", pl.register_texture, maps.rename(thickness="gloss"), image)
    refused(
        InputError,
        "radius",
        pl.register_texture,
        maps,
        image,
        params={"near": (1060.0, 980.0, -3.0)},
    )
    refused(
        CannotRegister,
        "in common",
        pl.register_texture,
        maps,
        maps.rename(thickness="base_thickness"),
    )


@pytest.mark.ci
def test_a_rough_place_or_one_hole_in_both_makes_the_search_small_and_a_wrong_place_is_refused():
    place = placed(137.0)
    maps, image = pair(place=place, r=0.6)
    assert (
        apart(pl.register_texture(maps, image, params={"near": (1060.0, 980.0, 150.0)}), place)
        < NEAR_UM
    )
    refused(
        CannotRegister,
        "No place",
        pl.register_texture,
        maps,
        image,
        params={"near": (1500.0, 980.0, 150.0)},
    )
    hole = np.array([[300.0, 900.0]])
    found = pl.register_texture(
        maps, image, holes=(holes_at(hole, 170.0), holes_at(place(hole), 170.0))
    )
    assert apart(found, place) < NEAR_UM
    pairs = len(found.fit.moving)
    assert (found.count("moving"), found.count("fixed")) == (pairs + 1, pairs + 1)


@pytest.mark.nightly
def test_a_size_that_is_hardly_known_is_found():
    place = placed(-40.0, scale=0.62)
    maps, image = pair(place=place, r=0.7)
    refused(CannotRegister, "scale_tolerance", pl.register_texture, maps, image)
    found = pl.register_texture(maps, image, params={"scale_tolerance": 1.0})
    assert found.fit.transform.scale == pytest.approx(0.62, abs=0.004)
    assert apart(found, place) < 5.0


@pytest.mark.ci
@pytest.mark.parametrize("kind", ["sheets", "images", "sheet and image"])
def test_sheets_and_images_are_registered_there_and_back(kind):
    place = placed(25.0)
    moving, fixed = pair(place=place, r=0.8)
    if kind == "sheets":
        valid = xr.full_like(fixed, True, dtype=bool)
        fixed = xr.Dataset({"thickness": fixed, "valid": valid}).rename(x="u", y="v")
    if kind == "images":
        moving = moving["thickness"].rename(u="x", v="y").assign_attrs(pixel_um=[PIXEL_UM] * 2)
    assert apart(pl.register_texture(moving, fixed), place) < NEAR_UM
    assert apart(pl.register_texture(fixed, moving), place.inverse, place(CORNERS)) < NEAR_UM


def test_slopes_in_light_that_spreads_in_paper_move_no_map():
    """Thickness and height share their long waves, and the light shows no others of the slopes."""
    rng = np.random.default_rng(1)
    long, short, rough = (
        standard(ndimage.gaussian_filter(rng.standard_normal(SHAPE), sigma), np.ones(SHAPE, bool))
        for sigma in (5.0, 2.0, 2.0)
    )
    right = Similarity(shift_um=(300.0, 300.0))
    maps, image = pair(place=right, r=0.0)
    thickness, height_um = long + 0.5 * short, 2.0 * (long + rough)
    light = ndimage.gaussian_filter(np.gradient(height_um, axis=0), 45.0 / PIXEL_UM)
    rows, cols = (slice(50, 50 + n) for n in SHAPE)
    image.values[rows, cols] += 2.0 * thickness + 15.0 * light / light.std()
    maps["thickness"] = (("v", "u"), 80.0 + 5.0 * thickness)
    maps["topography_top"] = (("v", "u"), height_um)
    found = pl.register_texture(maps, image, place=right)
    errors_um = np.linalg.norm(found(CORNERS) - right(CORNERS), axis=1)
    print(errors_um.round(1), found.fit.expected_error_um(CORNERS).round(1))
    assert (errors_um < np.minimum(2.0 * found.fit.expected_error_um(CORNERS), 15.0)).all()


@pytest.mark.ci
def test_holes_are_no_texture():
    """Burnt holes are far darker than the texture, and stand in the image alone: the maps know
    nothing there."""
    place = placed(75.0)
    maps, image = pair(place=place, r=0.3)
    holes_um = np.array([[x, y] for x in (270.0, 720.0, 1220.0) for y in (220.0, 620.0, 1020.0)])
    x, y = np.meshgrid(image["x"], image["y"])
    distance = np.min([np.hypot(x - cx, y - cy) for cx, cy in place(holes_um)], axis=0)
    dark = image.where(distance > 90.0, 0.0)
    with pytest.raises(CannotRegister):
        pl.register_texture(maps, dark)
    found = pl.register_texture(
        maps, dark, holes=(holes_at(holes_um, 180.0), holes_at(place(holes_um), 180.0))
    )
    assert apart(found, place) < 8.0


@pytest.mark.ci
def test_a_print_hides_no_texture():
    """A screen of 167 um, three times as strong as the sheet's texture; the sheet itself is not
    printed in the scan."""
    place = placed(40.0)
    maps, image = pair(place=place, r=0.6)
    x, y = np.meshgrid(image["x"], image["y"])
    turn = np.deg2rad(22.0)
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    dots = np.cos(2 * np.pi * along / 167.0) + np.cos(2 * np.pi * across / 167.0) > 0.3
    assert apart(pl.register_texture(maps, image - 3.0 * float(image.std()) * dots), place) < 4.0


@pytest.mark.ci
@pytest.mark.parametrize("mirrored", [False, True])
def test_transmitted_light_is_found_by_the_thickness_and_said_so(mirrored):
    """Thick places are dark from either side; the hand says from which one the picture was
    taken."""
    place = placed(20.0, mirrored=mirrored)
    maps, image = pair(place=place, r=-0.5)
    coating = (("v", "u"), 10.0 + field(SHAPE, 77))
    found = pl.register_texture(
        maps.assign(coating_top=coating, coating_bottom=coating), image, mirrored=None
    )
    assert found.fit.mirrored is mirrored
    assert "The thickness leads" in found.sentence
    assert apart(found, place) < 4.0


@pytest.mark.ci
def test_a_given_place_is_said_and_one_that_is_none_is_refused():
    place = placed(40.0)
    maps, image = pair(place=place, r=0.6)
    assert "The place was given" in pl.register_texture(maps, image, place=place).sentence
    for right_um, said in ((1e6, "lies beside it"), (1500.0, "4 are needed")):
        wrong = replace(place, shift_um=(place.shift_um[0] + right_um, place.shift_um[1]))
        refused(CannotRegister, said, pl.register_texture, maps, image, place=wrong)


@pytest.mark.ci
def test_a_part_of_a_sheet_is_enough_and_a_map_that_is_known_in_little_of_it_has_no_part():
    place = placed(310.0)
    maps, image = pair(place=place, r=0.7)
    part = image.isel(y=slice(60, 250), x=slice(70, 260))
    assert apart(pl.register_texture(maps, part), place) < 5.0
    little = np.where(np.arange(maps.sizes["v"])[:, None] < 60, maps["thickness"].values, np.nan)
    maps = maps.assign(coating_top=(("v", "u"), little), topography_top=(("v", "u"), little))
    assert apart(pl.register_texture(maps, image), place) < NEAR_UM


def test_chance_is_a_probability_however_high_it_gets():
    """A pattern that repeats reaches much at every rotation: no factor underflows there."""
    for height in (3.0, 5.0, 45.0):
        others = np.linspace(height, 1.3 * height, 40)
        p = [_exceeded(z, others) for z in (height, 1.5 * height, 3.0 * height)]
        assert np.isfinite(p).all()
        assert p[0] > 0.9
        assert p[0] >= p[1] >= p[2] >= 0.0


# --- specimens that are not rigid, and searches about a place -------------------------------------


def shown(values):
    """Textures of an image with pixels of 20 um."""
    known = np.ones(values.shape, bool)
    return Textures(maps={"image": standard(values, known)}, known=known, pixel_um=(20.0, 20.0))


def waves(n, period_um):
    """A pattern that repeats along both axes."""
    along = np.sin(2.0 * np.pi * 20.0 * np.arange(n) / period_um)
    return along[:, None] + along


def searched_near(image):
    """A search of its middle, and two places in it, the second one to the right by a distance."""
    scanner = _Scanner(shown(image), shown(image), 0.03, 1.0, is_near=True)

    def at(right_um, turned_deg=0.0, mirrored=False):
        turn = Similarity(rotation_rad=np.deg2rad(turned_deg), mirrored=mirrored)
        target = scanner.middle_um + np.array([right_um, 0.0])
        place = nearest_similarity(turn.matrix(), scanner.middle_um, target)
        return Candidate(names=("image", "image"), z=9.0, place=place)

    return scanner, at


def test_half_a_wave_is_that_of_the_pattern_and_the_strain_reaches_farther_in_a_larger_map():
    names = ("image", "image")
    large, small = (searched_near(waves(n, 300.0))[0] for n in (400, 50))
    assert small.half_wave_um(names) == pytest.approx(150.0, rel=0.05)
    joined_um = 0.03 * np.sqrt(2.0) * (8000.0 - 1000.0)
    assert large.reach_um(names) - small.reach_um(names) == pytest.approx(joined_um, rel=0.05)


def test_places_to_which_two_parts_of_a_map_belong_are_one_and_those_of_the_same_parts_are_two():
    """The left half of 8 mm goes with the image where it is, the right half 160 um farther on."""
    sheet = field((400, 400), 5)
    parted = np.where(np.arange(400) < 200, sheet, np.roll(sheet, 8, axis=1))
    scanner, at = searched_near(sheet)
    strained = _Scanner(shown(sheet), shown(parted), 0.03, 1.0, is_near=True)
    assert strained.are_one(at(0.0), at(160.0))
    for other in (at(600.0), at(0.0, 15.0), at(0.0, mirrored=True)):
        assert not strained.are_one(at(0.0), other)
    assert scanner.are_one(at(0.0), at(20.0, 0.3))  # on one summit
    scanner, at = searched_near(waves(400, 160.0))
    assert not scanner.are_one(at(0.0), at(160.0))
    scanner, at = searched_near(waves(400, 160.0) + 0.7 * sheet)
    assert not scanner.are_one(at(0.0), at(160.0))


def test_a_pattern_that_repeats_has_a_rival_a_period_on_and_a_texture_has_none():
    texture, near = field((80, 80), 7), [Near(fixed_um=(800.0, 800.0), radius_um=300.0)]
    for image, is_sure in ((texture, True), (waves(80, 260.0), False)):
        part = shown(image[20:60, 20:60])
        found = search_place(part, shown(image), mirrored=False, scale_tolerance=0.03, near=near)
        assert found.has_rival is not is_sure
        assert found.is_sure is is_sure
        if is_sure:
            middle = found.best.place((390.0, 390.0))
            assert np.linalg.norm(middle - (790.0, 790.0)) < 15.0


@pytest.mark.ci
def test_wire_marks_have_a_rival_a_period_beside_where_they_are_sought():
    """Marks of 120 um on 2.4 mm, without a symmetry: no other rotation is as good. The place that
    is given is 102 um off, and of the marks only a wrong place lies within 60 um of it."""
    rng = np.random.default_rng(3)
    y, x = np.indices((170, 170)) * 2.0 * np.pi / 6.0
    orders = [(j, k) for j in range(3) for k in range(-2, 3) if (j, k) > (0, 0)]
    marks = sum(np.sin(j * x + k * y + rng.uniform(0.0, 2.0 * np.pi)) for j, k in orders)
    image = marks + 0.5 * field(marks.shape, 11)
    part = shown(marks[25:145, 25:145] + 0.5 * field((120, 120), 12))
    near = [Near(fixed_um=(1690.0 + 100.0, 1690.0 - 20.0), radius_um=60.0)]
    found = search_place(part, shown(image), mirrored=False, scale_tolerance=0.03, near=near)
    assert np.linalg.norm(found.best.place((1190.0, 1190.0)) - 1690.0) > 100.0
    assert found.false_probability < FALSE
    assert found.candidates[1].z > 0.97 * found.best.z
    assert not found.is_sure


def test_what_the_middle_leaves_open_is_tried_in_the_whole_at_every_rotation_and_scale_beside_it():
    """Where little of the middle is known its steps are wider, here four times."""
    rough, fine = (_Steps.of(size_um, 0.03, 1.0) for size_um in (1000.0, 4000.0))
    kept = [Similarity(rotation_rad=np.deg2rad(36.0), scale=rough.scales[0])]
    tried = dict(fine.tried((False,), kept, rough))
    turned = [np.rad2deg(turn.rotation_rad) for turn in tried]
    assert min(turned) <= 36.0 - 0.4 * rough.deg
    assert max(turned) >= 36.0 + 0.4 * rough.deg
    assert np.diff(turned).max() < 1.01 * fine.deg
    scales = [scale for of_turn in tried.values() for scale in of_turn]
    assert min(scales) == fine.scales[0]
    assert max(scales) < rough.scales[0] + 2.0 * rough.half


def test_a_search_about_a_place_looks_at_that_place_alone_and_first_at_the_middle_of_a_map(
    monkeypatch,
):
    """Counted are the pixels of the map that are turned, where nothing is found."""
    turned, transform = [], ndimage.affine_transform

    def counted(values, *args, output_shape, **options):
        turned.append(output_shape[0] * output_shape[1])
        return transform(values, *args, output_shape=output_shape, **options)

    monkeypatch.setattr(rotations.ndimage, "affine_transform", counted)
    moving, fixed = shown(field((40, 40), 8)), shown(field((64, 64), 9))
    near, count = [Near(fixed_um=(640.0, 640.0), radius_um=60.0)], {}
    for side_um in (300.0, 5000.0):
        turned.clear()
        monkeypatch.setattr(rotations, "_PARTED_UM", side_um)
        found = search_place(moving, fixed, mirrored=False, scale_tolerance=0.01, near=near)
        assert not found.is_sure
        count[side_um] = sum(turned)
    assert count[300.0] < 0.4 * count[5000.0]
    layers = [
        TexturedPlane.of(xr.DataArray(np.zeros((n, n)), dims=("y", "x"), coords=coords))
        for n in (100, 2000)
        for coords in ({"y": 10.0 * np.arange(n), "x": 10.0 * np.arange(n)},)
    ]
    about = [Near(fixed_um=(9000.0, 9000.0), radius_um=300.0)]
    part = _seen_from(layers[1], layers[0], about, 1.0)
    assert part.grid.x_um[0] < 9000.0 - 300.0 - 710.0
    assert part.grid.x_um[-1] - part.grid.x_um[0] < 2.0 * (300.0 + 710.0 + 300.0)


@pytest.mark.ci
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_specimen_under_a_smooth_strain_of_2_percent_is_linked_and_followed(seed):
    """Its parts lie up to 80 um off any similarity, more than the search of tiles reaches."""
    shape, pixel_um, wave_um = (500, 600), 10.0, 14_000.0
    rng = np.random.default_rng([seed, 49])
    sheet = ndimage.gaussian_filter(rng.standard_normal(shape), 1.3)
    phase = rng.uniform(-0.5, 0.5, 2)
    turn = Similarity(rotation_rad=rng.uniform(-np.pi, np.pi))
    middle = 0.5 * pixel_um * (np.array(shape[::-1]) - 1.0)
    place = nearest_similarity(turn.matrix(), middle, middle + rng.uniform(-80.0, 80.0, 2))

    def strained(points):
        wave_number = 2.0 * np.pi / wave_um
        return points + 0.02 / wave_number * np.cos(wave_number * points + phase)

    y, x = (pixel_um * np.arange(n) for n in shape)
    back = place.inverse(np.stack(np.meshgrid(x, y), axis=-1))
    at = back
    for _ in range(20):
        at = back + at - strained(at)
    seen = ndimage.map_coordinates(sheet, np.moveaxis(at / pixel_um, -1, 0)[::-1], order=3)
    noise = ndimage.gaussian_filter(rng.standard_normal(shape), 1.3)
    moving, fixed = (
        xr.DataArray(
            100.0 + values,
            coords={"y": y, "x": x},
            dims=("y", "x"),
            attrs={"pixel_um": [pixel_um] * 2},
        )
        for values in (sheet, 0.6 * seen + 0.8 * noise)
    )
    near = (*place(strained(middle)).tolist(), 300.0)
    found = pl.register_texture(moving, fixed, params={"near": near})
    corners = np.stack(np.meshgrid(x[[100, 300, 500]], y[[100, 250, 400]]), axis=-1).reshape(-1, 2)
    off_um = np.linalg.norm(found(corners) - place(strained(corners)), axis=1)
    assert np.median(off_um) < 1.5
    assert off_um.max() < 6.0
