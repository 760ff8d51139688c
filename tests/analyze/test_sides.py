"""Which side of a sheet an image shows, and whether two layers are one specimen."""

import numpy as np
import pytest
from scipy import ndimage

from analyze.fields import texture as smooth
from planish.analyze import image_of_sheet, two_images, two_sheets
from planish.texture import Textures, textures
from planish.texture.textures import relate

PIXEL = (5.0, 5.0)
SHAPE = (180, 220)


def field(seed, sigma=3.0, shape=SHAPE):
    return smooth(shape, sigma, seed)


def prepared(**maps):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    holes = (np.hypot(y - 60, x - 70) < 30) | (np.hypot(y - 120, x - 160) < 30)
    return textures({k.replace("OTHER", "other "): m for k, m in maps.items()}, ~holes, PIXEL)


def sheet(*, sign=1.0, shown="top", base=0):
    """Two coatings that share some of their base, and an image of one side with light and grain of
    its own."""
    top, bottom = field(base), field(base + 1)
    bottom = 0.9 * bottom - 0.4 * top
    light = 1 + 0.7 * np.arange(SHAPE[1]) / SHAPE[1]
    image = light * (
        200 + sign * 10 * (top if shown == "top" else bottom) + 8 * field(base + 2, 2.0)
    )
    return {"coating_top": top, "coating_bottom": bottom, "image": image}


def judged(maps, *, coated=("top", "bottom"), side="top", given=True):
    return image_of_sheet(prepared(**maps), coated=coated, side=side, is_given=given, image="image")


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("shown", "state"), [("top", "pass"), ("bottom", "fail")])
def test_the_side_that_the_image_shows_is_told_whatever_the_sign(shown, state, sign):
    found = judged(sheet(sign=sign, shown=shown))
    check = found.check
    assert (check.state, found.side) == (state, shown)
    assert check.value * sign > check.limit
    assert (
        f"correlates with the coating of the {shown} side (r = {sign * 0.7:.1f}" in check.sentence
    )
    assert check.sentence.endswith("The top side was given.")
    if state == "fail":
        assert check.figures == (
            "coating_top",
            "coating_bottom",
            "topography_top",
            "topography_bottom",
            "base_surface_top",
            "base_surface_bottom",
            "half_thickness_top",
            "half_thickness_bottom",
            "correlation",
        )
        assert check.advice == "Top and bottom are exchanged."
        assert "give `image_side=bottom`" in check.remedy


def test_what_cannot_be_told_is_said():
    maps = sheet()
    foreign = judged(maps | {"image": sheet(base=50)["image"]}).check
    assert foreign.state == "look"
    assert foreign.sentence.endswith("nothing beside the marks says that both show one specimen.")
    bare = judged(maps, coated=()).check
    assert (bare.state, bare.figures) == ("unknown", ())
    assert bare.sentence.startswith(
        "Side: inconclusive, because no coating is seen on the top side; nothing beside"
    )
    thick = maps | {"thickness": maps["coating_top"] + field(9)}
    assert "so both show one specimen" in judged(thick, coated=()).check.sentence
    both = judged(maps | {"image": maps["coating_top"] + maps["coating_bottom"]}).check
    assert both.state == "unknown"
    assert "correlates with both coatings" in both.sentence
    assert "The top side was assumed." in judged(maps, given=False).check.sentence
    assert (
        judged(maps | {"image": maps["coating_bottom"]}, coated=("bottom",)).check.state == "look"
    )


@pytest.mark.parametrize("name", ["topography", "half_thickness"])  # the second of older runs
def test_light_from_one_side_tells_the_side_where_the_coating_does_not(name):
    maps = sheet()
    top, bottom = field(30, 4.0), field(31, 4.0)
    lit = {
        f"{name}_top": top,
        f"{name}_bottom": 0.5 * bottom - 0.3 * top,
        "image": np.gradient(top, axis=1),
    }
    found = judged(maps | lit).check
    assert found.state == "pass"
    assert "slopes of the top face" in found.sentence
    turned = judged(maps | lit, coated=(), side="bottom").check
    assert turned.state == "look"
    assert turned.advice == "Top and bottom are exchanged."
    assert "`image_side=top`" in turned.remedy


def test_two_images_and_two_sheets():
    a, b = field(1), field(2)
    same = two_images(prepared(image=a, OTHERimage=-a + field(3)), ("a", "b"))
    assert same.state == "pass"
    assert "r = -0.7" in same.sentence
    flipped = two_images(prepared(image=a, OTHERimage=a[:, ::-1].copy()), ("a", "b"))
    assert flipped.state == "look"
    assert "mirror image" in flipped.advice

    def sheets(top, bottom, thickness=None):
        whole = a + b + field(4)
        maps = {"coating_top": a, "coating_bottom": b, "thickness": whole}
        other = {"OTHERcoating_top": top, "OTHERcoating_bottom": bottom}
        found = prepared(**maps, **other, OTHERthickness=whole if thickness is None else thickness)
        return two_sheets(found, ("a", "b"), coated=("top", "bottom"))

    assert sheets(a + 0.5 * field(7), b).state == "pass"
    crosswise = sheets(b, a)
    assert crosswise.state == "fail"
    assert "go together crosswise (r = 1.00" in crosswise.sentence
    assert sheets(field(5), field(6), field(7)).state == "look"
    assert sheets(-a, -b, field(7)).state == "look"  # the same quantity does not change its sign
    thin = sheets(field(5), field(6))
    assert thin.state == "unknown"
    assert "so both show one specimen" in thin.sentence


@pytest.mark.ci
@pytest.mark.parametrize("kind", ["fine and coarse", "grating", "stain"])
def test_z_of_unrelated_textures_is_standard_normal_or_less(kind):
    rng = np.random.default_rng(3)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    z = []
    for k in range(30):
        sigma = rng.uniform(1.0, 6.0, 2) if kind == "fine and coarse" else (2.0, 2.0)
        a, b = (field(1000 + 2 * k + i, s) for i, s in enumerate(sigma))
        if kind == "grating":  # the wires of one paper machine
            a, b = (m + 2 * np.cos(x / 5 + rng.uniform(0, 2 * np.pi)) for m in (a, b))
        if kind == "stain":
            spot = 8 * np.exp(-((y - 90) ** 2 + (x - 110) ** 2) / 50)
            a, b = a + spot, b + spot
        found = prepared(a=a, b=b)
        z.append(relate(found.maps["a"], found.maps["b"], found.known, PIXEL).z)
    rms = float(np.sqrt(np.mean(np.square(z))))
    print(f"{kind}: rms z {rms:.2f}, largest {np.abs(z).max():.1f}")
    assert rms < 1.4  # 1 within 3 standard errors of 30
    assert np.abs(z).max() < 4.5
    if kind == "fine and coarse":
        assert rms > 0.6


def test_the_variance_of_unrelated_textures_is_the_sum_over_lags():
    """Beside the sum over all pairs of pixels of the periodic maps, each product counted by
    hand."""
    rng = np.random.default_rng(1)
    known = rng.random((10, 12)) > 0.2
    a, b = (ndimage.gaussian_filter(rng.standard_normal(known.shape), 1.0) for _ in range(2))
    a, b = (np.where(known, (m - m[known].mean()) / m[known].std(), 0.0) for m in (a, b))
    n, total = int(known.sum()), 0.0
    for dy in range(10):
        for dx in range(12):
            sums = [0.0, 0.0]
            for row in range(10):
                for col in range(12):
                    for k, m in enumerate((a, b)):
                        sums[k] += m[row, col] * m[(row + dy) % 10, (col + dx) % 12]
            total += sums[0] * sums[1]
    found = relate(a, b, known, (1.0, 1.0))  # all in one tile, whose sum is 0
    assert found.r == pytest.approx(float(np.vdot(a, b)) / n)
    assert found.sd == pytest.approx(np.sqrt(total / n**3))
    # Half of a spread of 2 that is explained is as much as all of a spread of 1.
    assert relate(a, b, known, (1.0, 1.0), of=2.0 * b).part == pytest.approx(0.5 * found.r)


def test_maps_that_are_known_in_little_of_the_field_are_left_out():
    maps = sheet()
    little = np.where(np.arange(SHAPE[1]) < 40, maps["coating_bottom"], np.nan)
    found = prepared(**(maps | {"coating_bottom": little}))
    assert isinstance(found, Textures)
    assert set(found.maps) == {"coating_top", "image"}
    assert found.maps["image"][found.known].std() == pytest.approx(1.0)
    assert not found.maps["image"][~found.known].any()
