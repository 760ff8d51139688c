"""The office scanner: each trait by what it does to a wave, a ramp or a flat field."""

from dataclasses import fields, replace

import numpy as np
import pytest

import planish as pl
from planish.cli import main
from planish.core.reflectance import LUMINANCE
from planish.io import read_image
from planish.synthetic import FlatbedParams, scan_flatbed, write_flatbed
from planish.synthetic.flatbed import encode, lamp

FINE_UM, SHAPE = 2.0, (700, 800)
SEED = np.random.SeedSequence(3)
PITCH_UM = 25_400.0 / 1200.0
PLAIN = FlatbedParams(
    shading=0.0,
    spread_um=0.0,
    lens_um=0.0,
    colour=False,
    colour_shift_px=0.0,
    gamma=1.0,
    noise=0.0,
    sharpen=0.0,
    bits=16,
    quality=None,
    scale_range=0.0,
    wander_um=0.0,
    ripple_um=0.0,
    jitter_um=0.0,
)
Y_UM, X_UM = (FINE_UM * i for i in np.indices(SHAPE))
LEVEL = np.zeros(SHAPE)


def scan(picture, face=LEVEL, **traits):
    """Scan a picture with these traits alone."""
    params = replace(PLAIN, **traits)
    return scan_flatbed(picture, face, pixel_um=FINE_UM, params=params, seed=SEED)


def wave(scanned, *, y_um, gain):
    """What a scan shows of ``.5 + .2 cos`` along y, whose amplitude is ``gain`` of that."""
    return (0.5 + 0.2 * gain * np.cos(2 * np.pi * scanned.lines_um / y_um))[:, None]


def along_y(y_um):
    """Picture of that wave."""
    return 0.5 + 0.2 * np.cos(2 * np.pi * Y_UM / y_um)


def grey(scanned):
    """Grey of 0 to 1."""
    return scanned.values / np.iinfo(scanned.values.dtype).max


@pytest.mark.parametrize("dpi", [1200.0, 2400.0])
def test_a_pixel_is_the_mean_of_its_area(dpi):
    scanned = scan(along_y(160.0), dpi=dpi)
    assert scanned.pixel_um == pytest.approx(25_400.0 / dpi)
    expected = wave(scanned, y_um=160.0, gain=np.sinc(scanned.pixel_um / 160.0))
    # Pixels of the picture are constant: an end of an area is off by p^2 / 8 of the slope at most.
    steepest = 0.2 * 2 * np.pi / 160.0
    most = 2 * FINE_UM**2 / 8 * steepest / scanned.pixel_um
    assert np.abs(grey(scanned) - expected).max() < most


def test_light_from_one_side_shows_slopes_along_the_scan_only():
    ramp = lamp(0.05 * Y_UM, pixel_um=FINE_UM, params=replace(PLAIN, shading=0.08))
    np.testing.assert_allclose(ramp, 1.04, rtol=1e-12)
    across = lamp(0.05 * X_UM, pixel_um=FINE_UM, params=replace(PLAIN, shading=0.08))
    np.testing.assert_allclose(across, 1.0, rtol=1e-12)


def test_shading_is_as_smooth_as_light_spreads_in_the_paper():
    length_um, spread_um = 280.0, 30.0  # five waves of the height: no border within
    k = 2 * np.pi / length_um
    params = replace(PLAIN, shading=0.1, spread_um=spread_um)
    light = lamp(2.0 * np.sin(k * Y_UM), pixel_um=FINE_UM, params=params)
    slope = 2.0 * k * np.cos(k * Y_UM) * np.exp(-0.5 * (k * spread_um) ** 2)
    inside = slice(100, -100)
    np.testing.assert_allclose((light - 1)[inside], slope[inside], atol=2e-4)


def test_light_multiplies_the_reflectance():
    scanned = scan(np.full(SHAPE, 0.5), 0.1 * Y_UM, shading=0.1)
    np.testing.assert_allclose(grey(scanned), 0.55, atol=1e-5)


def test_the_optics_take_contrast_off_fine_waves():
    scanned = scan(along_y(100.0), lens_um=12.0)
    gain = np.exp(-0.5 * (2 * np.pi * 12.0 / 100.0) ** 2) * np.sinc(PITCH_UM / 100.0)
    assert np.abs(grey(scanned) - wave(scanned, y_um=100.0, gain=gain))[4:-4].max() < 2e-4
    # A tenth of the contrast is left at 1 / (2.93 sigma) a um.
    assert 1e3 / (2 * np.pi * 12.0 / np.sqrt(2 * np.log(10))) == pytest.approx(28.5, abs=0.1)


def test_grey_is_coded():
    linear = np.array([0.0, 0.002, 0.18, 0.5, 1.0])
    # IEC 61966-2-1: 0.18 is 118 and 0.5 is 188 of 255.
    coded = encode(linear, "srgb")
    np.testing.assert_allclose(255 * coded, [0.0, 6.59, 117.6, 187.5, 255.0], atol=0.05)
    np.testing.assert_allclose(encode(linear, 2.2) ** 2.2, linear, rtol=1e-12)
    assert grey(scan(np.full(SHAPE, 0.5), gamma="srgb")).mean() == pytest.approx(0.7354, abs=1e-4)


def test_an_unsharp_mask_raises_fine_waves():
    plain, sharp = (grey(scan(along_y(150.0), sharpen=amount)) for amount in (0.0, 0.8))
    gain = 1 + 0.8 * (1 - np.exp(-0.5 * (2 * np.pi * PITCH_UM / 150.0) ** 2))
    inside = slice(6, -6)
    np.testing.assert_allclose((sharp - 0.5)[inside], gain * (plain - 0.5)[inside], atol=1e-3)


def test_noise_is_in_grey_values_of_8_bits():
    noisy = scan(np.full(SHAPE, 0.5), noise=1.5, bits=8)
    assert noisy.values.dtype == np.uint8
    # Rounding adds a variance of 1/12; 4000 pixels know it to 1.1 %.
    assert noisy.values.std() == pytest.approx(np.hypot(1.5, 12**-0.5), rel=0.04)


def test_jpeg_of_lower_quality_is_further_off():
    coarse = np.random.default_rng(1).standard_normal((70, 80))
    picture = 0.5 + 0.1 * coarse.repeat(10, axis=0).repeat(10, axis=1)
    whole = scan(picture, bits=8).values.astype(float)
    off = [np.abs(scan(picture, bits=8, quality=q).values - whole).mean() for q in (95, 75)]
    assert 0 < off[0] < 0.5 * off[1]  # the steps of quality 75 are five times those of 95
    assert np.array_equal(scan(picture, quality=75).values, scan(picture).values)  # 16 bits


def test_colours_are_shifted_along_the_scan_and_their_grey_is_in_place():
    scanned = scan(along_y(400.0), colour=True, colour_shift_px=0.5)
    phases = [
        np.angle(np.exp(-2j * np.pi * scanned.lines_um / 400.0) @ (channel - channel.mean(axis=0)))
        for channel in np.moveaxis(grey(scanned), -1, 0)
    ]
    lag_um = 400.0 * np.diff(phases, axis=0) / (2 * np.pi)
    np.testing.assert_allclose(np.abs(lag_um), 0.5 * PITCH_UM, rtol=0.05)
    gain = np.sinc(PITCH_UM / 400.0)
    luminance = grey(scanned) @ np.array(LUMINANCE)
    # The three are mixed at different phases: some 2 % of the wave goes, no more.
    assert np.abs(luminance - wave(scanned, y_um=400.0, gain=gain)).max() < 0.2 * 0.02


def test_a_perfect_carriage_steps_by_a_pixel():
    scanned = scan(LEVEL)
    np.testing.assert_allclose(np.diff(scanned.lines_um), PITCH_UM, rtol=1e-12)
    np.testing.assert_allclose(np.diff(scanned.columns_um), PITCH_UM, rtol=1e-12)


def test_each_error_of_the_carriage_is_what_it_is_called():
    plain = scan(LEVEL).lines_um
    ramp_um = plain - plain[0]
    ripple = scan(LEVEL, ripple_um=2.0, ripple_period_um=300.0).lines_um - plain
    k = 2 * np.pi * ramp_um / 300.0
    basis = np.stack([np.cos(k), np.sin(k)], axis=1)
    waves = np.linalg.lstsq(basis, ripple, rcond=None)[0]
    np.testing.assert_allclose(basis @ waves, ripple, atol=1e-9)
    assert np.hypot(*waves) == pytest.approx(2.0)
    stretched = scan(LEVEL, scale_range=0.006).lines_um
    scale = np.diff(stretched) / PITCH_UM - 1
    assert np.ptp(scale) < 1e-9
    assert 0 < abs(scale[0]) <= 0.006
    long = scan(np.zeros((12_000, 110)), np.zeros((12_000, 110)), jitter_um=0.7).lines_um
    assert (np.diff(long) - PITCH_UM).std() == pytest.approx(0.7 * np.sqrt(2), rel=0.1)
    wander = scan(np.zeros((12_000, 110)), np.zeros((12_000, 110)), wander_um=5.0).lines_um
    error = wander - wander[0] - PITCH_UM * np.arange(wander.size)
    assert 1.0 < np.ptp(error) < 30.0
    assert np.abs(np.diff(error)).max() < 0.2  # slow: 0.1 um a line


def test_a_trait_that_is_off_moves_no_other():
    both = scan(LEVEL, ripple_um=2.0, jitter_um=0.5).lines_um
    alone = [scan(LEVEL, **trait).lines_um for trait in ({"ripple_um": 2.0}, {"jitter_um": 0.5})]
    np.testing.assert_allclose(both, sum(alone) - scan(LEVEL).lines_um, atol=1e-9)


def test_places_are_those_of_lines_and_columns():
    scanned = scan(LEVEL, scale_range=0.006, wander_um=5.0, ripple_um=2.0, jitter_um=0.8)
    points = np.stack([scanned.columns_um[[0, 7, 20]], scanned.lines_um[[0, 11, 30]]], axis=1)
    expected = PITCH_UM * np.array([[0, 0], [7, 11], [20, 30]])
    np.testing.assert_allclose(scanned.place(points), expected, atol=1e-9)


def test_ranges_hold_the_defaults():
    for parameter in fields(FlatbedParams):
        limits, value = parameter.metadata["range"], getattr(FlatbedParams(), parameter.name)
        if parameter.metadata["choice"]:
            assert value in limits
        else:
            assert limits[0] <= value <= limits[1]


def on_glass(specimen, path, params):
    """Scan a specimen, and read what was written."""
    scanned = replace(specimen, params=replace(specimen.params, flatbed=params))
    return scanned, read_image(write_flatbed(scanned, path))


def test_holes_lie_where_they_are_scanned(kinds, tmp_path):
    params = replace(PLAIN, dpi=2400.0, colour=True)
    specimen, image = on_glass(kinds.specimen("demo"), tmp_path / "flatbed.tif", params)
    assert image.attrs["pixel_um"] == pytest.approx([25.4 / 2.4] * 2)
    assert image.attrs["is_scan"]
    holes = pl.find_holes(image)
    true = specimen.flatbed.place(specimen.pose(specimen.sheet.holes))
    places = np.stack([holes["x"].values, holes["y"].values], axis=1)
    off = [np.linalg.norm(true - place, axis=1).min() for place in places]
    assert len(places) == len(true)
    assert np.median(off) < 2.0  # rims are rough by 4 um


def test_a_scan_is_linked_by_its_holes_to_the_mapped_sheet(kinds, tmp_path):
    # All traits of a good scanner, in light that is nearly even and at 16 bits.
    params = FlatbedParams(
        dpi=2400.0,
        shading=0.003,
        lens_um=12.0,
        colour=True,
        colour_shift_px=0.2,
        gamma="srgb",
        noise=0.3,
        sharpen=0.0,
        bits=16,
        quality=None,
        scale_range=0.003,
        wander_um=4.0,
        ripple_um=1.0,
        ripple_period_um=1000.0,
        jitter_um=0.5,
    )
    path, folder = tmp_path / "flatbed.tif", tmp_path / "run"
    specimen, _ = on_glass(kinds.specimen("demo"), path, params)
    with pytest.raises(SystemExit) as end:
        main(["link", str(kinds("demo")), str(path), "--gamma", "srgb", "--out", str(folder)])
    assert end.value.code == 0
    run = pl.open_run(folder)
    (grey,) = (one for one in run.results.checks if one.name == "linear grey")
    assert (grey.state, "srgb" in grey.sentence) == ("pass", True)
    inner = slice(2, -2, 3)  # at the edge, what a pixel shows may lie outside the scan
    pixels = run.linked.isel(x=inner, y=inner).stack(pixel=("y", "x"))
    pixels = pixels.isel(pixel=np.flatnonzero(pixels["valid"].values))
    volume = np.stack([pixels[f"volume_{axis}"].values for axis in "xyz"], axis=-1)
    true = specimen.flatbed.place(specimen.pose(specimen.warp.material(volume)[..., :2]))
    off = np.hypot(*(true - np.stack([pixels["x"].values, pixels["y"].values], axis=-1)).T)
    assert off.size > 2000
    assert np.median(off) < 2.0  # 1.2 um, a tenth of a pixel
    assert np.sqrt(np.mean(off**2)) < 3.0 * np.sqrt(np.mean(pixels["expected_error"].values ** 2))
