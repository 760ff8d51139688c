"""A white and a dark image: reflectance of drawn sheets in drawn light, and what is refused."""

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms, PngImagePlugin
from scipy import ndimage

import planish as pl
from folders import write_image
from planish.analyze.image_values import image_facts
from planish.checks import ImageFile, run_checks
from planish.core.errors import InputError
from planish.io import ImageParams, correct_light, read_image
from planish.io.light import STATES, read_corrected, smooth
from planish.io.tone import linear_grey

SHAPE = (240, 320)
DARK = 800.0
FULL = 40000.0


def drawn(seed=0, fall=0.2, noise=0.01):
    """True reflectance, light, and pictures of the sheet, of a white one and of none."""
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE), indexing="ij")
    field = ndimage.gaussian_filter(rng.standard_normal(SHAPE), 3)
    reflectance = 0.7 + 0.03 * field / field.std()
    light = FULL * (1 - fall / 2 * (x * x + y * y)) * (1 + 0.1 * x)
    white = DARK + light + noise * np.sqrt(light * FULL) * rng.standard_normal(SHAPE)
    dark = DARK + 30 * rng.standard_normal(SHAPE)
    image = pl.image((DARK + reflectance * light).astype(np.float32), pixel_um=2.6)
    return reflectance, image, white, dark


def error_of(corrected, reflectance):
    return float(np.sqrt(np.nanmean((corrected.image.values - reflectance) ** 2)))


# --- what comes out -------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(4))
def test_reflectance_is_that_of_the_sheet_within_the_stated_error(seed):
    reflectance, image, white, dark = drawn(seed)
    corrected = correct_light(image, white=white, dark=dark, exposure=1.0)
    error, stated = error_of(corrected, reflectance), corrected.facts.standard_error
    # The noise of a single pixel of the white would add .007.
    assert error < 0.0025
    assert 0.4 * stated < error < stated
    assert np.corrcoef(corrected.image.values.ravel(), reflectance.ravel())[0, 1] > 0.995
    uneven = np.corrcoef(image.values.ravel(), reflectance.ravel())[0, 1]
    assert uneven < 0.6
    assert corrected.facts.fall_off == pytest.approx(0.24, abs=0.04)


def test_a_smaller_white_serves_as_one_with_all_pixels():
    reflectance, image, white, dark = drawn()
    binned = white.reshape(24, 10, 32, 10).mean((1, 3))
    corrected = correct_light(image, white=binned, dark=dark, exposure=1.0)
    assert error_of(corrected, reflectance) < 0.0025
    # Half a pixel is lost where the image is no multiple.
    odd = correct_light(image[:239, :317], white=binned[:, :31], dark=dark[:239, :317], exposure=1)
    assert error_of(odd, reflectance[:239, :317]) < 0.004


def test_specks_stay_in_the_light_and_noise_does_not():
    rng = np.random.default_rng(3)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    light = FULL * (1 - 0.2 * np.exp(-((y - 120) ** 2 + (x - 100) ** 2) / 2 / 4**2))
    noisy = (light + 0.01 * FULL * rng.standard_normal(SHAPE)).astype(np.float32)
    smoothed, error, noise = smooth(noisy)
    assert noise**0.5 == pytest.approx(0.01 * FULL, rel=0.03)
    assert np.std((smoothed - light)[160:, 200:]) < 0.0015 * FULL
    assert abs((smoothed - light)[120, 100]) < 0.03 * FULL  # of a speck of .2
    assert error[120, 100] > 10 * np.median(error)


def test_noise_of_a_colour_filter_is_smoothed_and_stated():
    rng = np.random.default_rng(4)
    white = ndimage.gaussian_filter(rng.standard_normal(SHAPE), 0.7)
    white = (FULL * (1 + 0.01 * white / white.std())).astype(np.float32)
    smoothed, error, _ = smooth(white)
    rms = float(np.std(smoothed / FULL))
    assert rms < 0.004
    assert rms < 1.5 * float(np.sqrt(error.mean())) / FULL


def test_each_lost_pixel_has_its_reason():
    _, image, white, dark = drawn()
    image.attrs["full_scale"] = 65535
    image.values[10:14, 20:30] = 65535
    image.values[50, 60] = np.nan
    white[100:110, 200:220] = 4095 * 16  # a camera of 12 bits in a file of 16
    white[200:, 300:] = DARK
    corrected = correct_light(image, white=white, dark=dark)
    state = np.array(STATES)[corrected.light["status"].values]
    assert (state[12, 25], state[50, 60]) == ("saturated", "missing")
    assert (state[105, 210], state[220, 310]) == ("white_saturated", "too_dark")
    assert state[0, 0] == "measured"
    shares = corrected.facts.shares
    assert shares["saturated"] == 40 / image.size
    assert sum(shares.values()) == pytest.approx(1)
    # Holes that let light through stay for the search; what is compared leaves them out.
    assert np.isfinite(corrected.image.values[12, 25])
    assert np.isnan(corrected.valid.values[[12, 105, 220], [25, 210, 310]]).all()


def test_the_exposure_gives_the_level():
    reflectance, image, white, dark = drawn()
    twice = pl.image((2 * (white - DARK) + DARK).astype(np.float32), pixel_um=2.6)
    plain = correct_light(image, white=twice, dark=dark)
    assert plain.facts.exposure is None
    assert plain.image.attrs["long_name"] == "Reflectance, up to a factor"
    assert "levels mean nothing" in plain.facts.sentence
    assert "both less dark, without light" in plain.facts.sentence
    known = correct_light(image, white=twice, dark=dark, exposure=2.0)
    assert known.facts.quantity == "reflectance"
    assert error_of(known, reflectance) < 0.0025


# --- what is refused, and what is doubted ---------------------------------------------------------
def test_pictures_that_cannot_be_white_and_dark_are_refused():
    _, image, white, dark = drawn()
    for pictures, message in (
        ({"white": white[:200]}, r"200 x 320 pixels, the image 240 x 320.*Crop and bin"),
        ({"white": np.tile(white, (2, 2))}, "Crop and bin"),
        ({"white": image.values}, "white and image are the same picture"),
        ({"white": white, "dark": white}, "dark and white are the same picture"),
        ({"white": white, "dark": image.values}, "dark and image are the same picture"),
        ({"white": white, "dark": np.zeros(5)}, "dark image has 5 pixels, the image 240 x 320"),
        ({"white": white, "dark": np.float32(0)}, "dark image has 1 pixels"),
        ({"white": dark, "dark": white}, "is not lighter than the dark one"),
        ({"white": np.full(SHAPE, 65535.0), "dark": np.full(SHAPE, 65000.0)}, "No pixel is left"),
    ):
        given = pictures.get("white")
        source = pl.image(given.astype(np.float32), pixel_um=2.6) if given is not None else None
        if message == "No pixel is left":
            source.attrs["full_scale"] = 65535
        with pytest.raises(InputError, match=message):
            correct_light(image, **(pictures | {"white": source}))
    empty = np.full(SHAPE, np.nan)
    with pytest.raises(InputError, match="dark image has no pixel with a number"):
        correct_light(image, white=white, dark=empty)
    for exposure in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="Give a number above 0"):
            correct_light(image, white=white, exposure=exposure)


def test_an_image_that_is_mostly_black_is_divided_like_any_other():
    _, image, white, dark = drawn()
    whole = correct_light(image, white=white, dark=dark)
    image.values[:180] = dark[:180]
    corrected = correct_light(image, white=white, dark=dark)
    np.testing.assert_allclose(corrected.image.values[180:], whole.image.values[180:])
    black = image.copy(data=np.where(np.arange(SHAPE[0])[:, None] < 180, 0, image.values))
    facts = correct_light(black, white=white).facts
    assert facts.median == 0
    assert facts.sentence.endswith("the light falls off by 25 %")


def test_the_contrast_of_a_white_is_measured_without_what_the_camera_gives_in_the_dark():
    _, image, _, dark = drawn()
    _, other, _, _ = drawn(seed=9)
    texture = correct_light(image, white=other.values, dark=dark).facts.texture
    offset = 20000.0
    lifted = image.copy(data=image.values + np.float32(offset))
    shifted = correct_light(lifted, white=other.values + offset, dark=dark + offset).facts.texture
    assert shifted == pytest.approx(texture, rel=0.01)


@pytest.mark.parametrize("missing", [np.nan, np.inf])
def test_where_white_or_dark_is_missing_the_image_is_not_measured(missing):
    reflectance, image, white, dark = drawn()
    white[:, :100] = missing
    dark[:40] = missing
    corrected = correct_light(image, white=white, dark=dark, exposure=1.0)
    is_known = np.isfinite(white) & np.isfinite(dark)
    assert np.array_equal(np.isfinite(corrected.valid.values), is_known)
    assert corrected.facts.shares["missing"] == pytest.approx(1 - is_known.mean())
    assert error_of(corrected, reflectance) < 0.003


def checks_of(image, facts=None):
    checks = run_checks(ImageFile(image=image, light=facts))
    return {check.name: check for check in checks}


def test_a_white_that_is_no_white_sheet_is_a_look():
    _, image, white, dark = drawn()
    fits = correct_light(image, white=white, dark=dark, exposure=1.0).facts
    assert checks_of(image, fits)["white image"].state == "pass"
    _, other, _, _ = drawn(seed=9)
    specimen = correct_light(image, white=other.values, dark=dark).facts
    assert specimen.texture > 0.3
    assert "texture of its own" in checks_of(image, specimen)["white image"].sentence
    shorter = correct_light(image, white=DARK + 0.4 * (white - DARK), dark=dark, exposure=1.0)
    look = checks_of(image, shorter.facts)["white image"]
    assert (look.state, look.figures) == ("look", ("correlation",))
    assert "times as light as the white sheet" in look.sentence
    lost = fits.model_copy(update={"shares": dict.fromkeys(STATES, 0.02)})
    sentence = checks_of(image, lost)["white image"].sentence
    assert sentence.count("2 % of the pixels") + sentence.count("2 % have") == 3
    shares = dict.fromkeys(STATES, 0.0) | {"saturated": 0.02}
    saturated = checks_of(image, fits.model_copy(update={"shares": shares}))["white image"]
    assert saturated.advice.startswith("Take the image again")


def test_options_that_do_not_go_together_are_refused():
    for options, message in (
        ({"dark": "d.tif"}, "need white"),
        ({"white_exposure": 2}, "need white"),
        ({"white": "w.tif", "dark_grey": 1, "white_grey": 2}, "pictures or single greys"),
        ({"gamma": 0.4545}, "greater than or equal to 1"),
        ({"gamma": "gamut"}, "srgb"),
    ):
        with pytest.raises(ValueError, match=message):
            ImageParams(path="i.tif", **options)


# --- linear grey ----------------------------------------------------------------------------------
def coded(share):
    return np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)


def test_curves_are_undone():
    share = np.linspace(0, 1, 101)
    np.testing.assert_allclose(linear_grey(255 * coded(share), "srgb", 255), 255 * share, atol=0.01)
    np.testing.assert_allclose(
        linear_grey(255 * share ** (1 / 1.8), 1.8, 255), 255 * share, atol=1e-3
    )
    assert linear_grey(3.0, None, None) == 3.0
    # Whole numbers with a sign: what is below 0 stays there.
    np.testing.assert_allclose(linear_grey([-50, 50], 2.0, 100), [-25, 25], rtol=1e-6)
    for gamma in ("gamut", 0, -2.2, 5.0, float("nan")):
        with pytest.raises(
            InputError, match=r"is no curve\. Give srgb, or an exponent from 1 to 4"
        ):
            linear_grey(share, gamma, 255)
    with pytest.raises(InputError, match="real numbers have no white"):
        linear_grey(share, 2.2, None)


def grey_image(tmp_path, name, mode="L", **how):
    values = np.random.default_rng(0).integers(40, 200, (60, 80), np.uint8)
    path = tmp_path / name
    Image.fromarray(values).convert(mode).save(path, **how)
    return path


def test_values_say_which_curve_was_undone():
    for gamma, words in ((1, "grey is linear, as given"), ("srgb", "by the curve srgb")):
        sentence = image_facts(ImageParams(path="i.tif", gamma=gamma)).sentence
        assert sentence.endswith(words)


def test_what_a_file_states_of_its_grey_is_named(tmp_path):
    gamma, linear = PngImagePlugin.PngInfo(), PngImagePlugin.PngInfo()
    gamma.add(b"gAMA", (45455).to_bytes(4))
    linear.add(b"gAMA", (100000).to_bytes(4))
    exif = Image.Exif()
    exif[271], exif[272] = "Canon", "EOS R5"
    for name, mode, how, state, words in (
        ("gama.png", "L", {"pnginfo": gamma}, "look", "an exponent of 2.2, in the chunk gAMA"),
        ("linear.png", "L", {"pnginfo": linear}, None, ""),
        ("camera.tif", "L", {"exif": exif}, "look", "comes from Canon EOS R5, in 8 bits"),
        ("jfif.jpg", "L", {}, "look", "sRGB, as JPEG has it"),
        ("colour.png", "RGB", {}, "look", "comes from a colour camera, in 8 bits"),
        ("plain.png", "L", {}, None, ""),
    ):
        path = grey_image(tmp_path, name, mode, **how)
        check = checks_of(read_image(path, pixel_um=2.0)).get("linear grey")
        assert (check and check.state) == state, name
        assert words in (check.sentence if check else "")
        if state == "look":
            decoded = checks_of(read_image(path, pixel_um=2.0, gamma="srgb"))["linear grey"]
            assert decoded.state == "pass"
            linear_image = read_image(path, pixel_um=2.0, gamma=1)
            assert checks_of(linear_image)["linear grey"].sentence == "Grey is linear, as given."
    twice = checks_of(read_image(tmp_path / "linear.png", pixel_um=2.0, gamma=2.2))["linear grey"]
    assert (twice.state, twice.remedy) == ("look", "Leave `gamma` out.")


def test_a_tiff_states_its_profile(tmp_path):
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    path = grey_image(tmp_path, "shot.tif", icc_profile=srgb)
    assert read_image(path, pixel_um=2.0).attrs["curve"] == "an ICC profile, sRGB built-in"


def test_colours_are_made_linear_before_they_are_weighed(tmp_path):
    share = np.random.default_rng(1).uniform(0, 1, (30, 40, 3))
    path = tmp_path / "colour.tif"
    tifffile.imwrite(path, np.rint(65535 * coded(share)).astype(np.uint16), photometric="rgb")
    found = read_image(path, pixel_um=1.0, gamma="srgb").values / 65535
    np.testing.assert_allclose(found, share @ [0.2126, 0.7152, 0.0722], atol=1e-4)


def test_files_are_read_corrected_and_named(tmp_path):
    reflectance, image, white, dark = drawn()
    for name, values in (("image", image.values), ("white", white), ("dark", dark)):
        write_image(tmp_path / f"{name}.tif", np.rint(values).astype(np.uint16), 2.6)
    paths = {name: str(tmp_path / f"{name}.tif") for name in ("white", "dark")}
    params = ImageParams(path=str(tmp_path / "image.tif"), **paths, white_exposure=1)
    found, corrected = read_corrected(params)
    assert corrected is not None
    assert list(corrected.facts.files) == ["white.tif", "dark.tif"]
    assert corrected.facts.sentence.startswith(
        "reflectance: grey over that of white.tif, the white sheet, both less dark.tif"
    )
    assert found.attrs["long_name"] == "Reflectance"
    assert float(np.sqrt(np.mean((found.values - reflectance) ** 2))) < 0.0025
    assert read_corrected(params.model_copy(update={"white": None}))[1] is None
    # Of one name in two folders.
    for name in ("white", "dark"):
        (tmp_path / name).mkdir()
        (tmp_path / f"{name}.tif").rename(tmp_path / name / "0001.tif")
    paths = {name: str(tmp_path / name / "0001.tif") for name in ("white", "dark")}
    _, alike = read_corrected(params.model_copy(update=paths))
    assert alike is not None
    assert "both less 0001.tif, without light" in alike.facts.sentence
    assert alike.facts.hashes == corrected.facts.hashes
    assert len({*alike.facts.hashes}) == 2
