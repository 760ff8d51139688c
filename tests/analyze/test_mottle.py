"""Mottle by bands: waves and noise whose variation in a band is known."""

import numpy as np
import pytest

from folders import refused
from planish.analyze import print_mottle
from planish.core.errors import CannotMeasure, InputError, SizeError

PIXEL_UM = 40.0
# ∫ (2^-q - 2^-4q)² dlog2(λ) with q = (shortest / λ)², by Frullani's integral.
KEPT = np.sqrt(np.log2(25 / 16) / 2)


def gain(wave_um, shortest_um):
    """What a band that begins at ``shortest_um`` gives of a wave."""
    q = (shortest_um / wave_um) ** 2
    return (2.0**-q - 2.0 ** (-4 * q)) / KEPT


def variations(image, **options):
    return [
        b.coefficient_of_variation for b in print_mottle(image, pixel_um=PIXEL_UM, **options).bands
    ]


def test_the_constant_is_the_integral_over_wavelengths():
    octaves = np.linspace(-12, 12, 20001)
    assert np.trapezoid((KEPT * gain(2.0**octaves, 1.0)) ** 2, octaves) == pytest.approx(
        KEPT**2, rel=1e-6
    )


@pytest.mark.parametrize("wave_um", [250.0, 400.0, 800.0, 1600.0])
def test_a_wave_stands_in_its_band(wave_um):
    image = 0.6 + 0.03 * np.cos(2 * np.pi * np.arange(800) * PIXEL_UM / wave_um) * np.ones((600, 1))
    found = variations(image, longest_um=2000.0)
    want = [gain(wave_um, 250.0 * 2**k) * 0.03 / np.sqrt(2) / 0.6 for k in range(3)]
    # Borders add up to a tenth of the strongest band to each: one side of a Gaussian passes more
    # than both.
    assert found == pytest.approx(want, abs=0.1 * max(want))


def test_white_noise_has_the_variation_of_its_filters():
    image = 0.5 + 0.05 * np.random.default_rng(0).normal(size=(500, 600))
    found = variations(image)
    half = np.sqrt(np.log(2) / 2) / np.pi
    for k, value in enumerate(found):
        a, b = (half * 250.0 * 2 ** (k + j) / PIXEL_UM for j in (0, 1))
        # Sum of the squared kernel.
        variance = (1 / a**2 + 1 / b**2 - 4 / (a * a + b * b)) / (4 * np.pi)
        # A band has about as many clouds as squares of its wave: 1920 of the first, 30 of the last.
        assert value == pytest.approx(np.sqrt(variance) / KEPT * 0.1, rel=0.06 * 2**k)
    assert len(found) == 4


def test_equal_variance_in_every_octave_is_given_as_such():
    # A spectrum of 1 / f² has the same variance in every octave: that of the band, 0.02 of the
    # mean.
    size, rng = 1024, np.random.default_rng(1)
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size))
    power = np.where(f > 0, 1 / np.maximum(f, 1e-9) ** 2, 0.0)
    octave = power[(f > 1 / 64) & (f <= 1 / 32)].sum()
    spectrum = np.fft.fft2(rng.normal(size=(size, size))) * np.sqrt(power / octave) * size
    image = 0.5 * (1 + 0.02 * np.fft.ifft2(spectrum).real)
    found = variations(image[:900, :900], shortest_um=400.0, longest_um=3200.0)
    assert found == pytest.approx([0.02] * 3, rel=0.08)


def test_holes_do_not_count_and_the_mean_is_the_unit():
    rng = np.random.default_rng(2)
    image = 0.5 + 0.05 * rng.normal(size=(400, 400))
    mask = np.ones(image.shape, bool)
    mask[100:130, 100:130] = mask[250:270, 300:340] = False
    whole, holed = variations(image), variations(np.where(mask, image, np.nan))
    assert holed == pytest.approx(whole, rel=0.05)
    by_nan = print_mottle(np.where(mask, image, np.nan), pixel_um=PIXEL_UM)
    assert ([b.coefficient_of_variation for b in by_nan.bands], by_nan.n) == (holed, mask.sum())
    assert by_nan.mean == pytest.approx(image[mask].mean())
    image = 0.5 + 0.05 * np.random.default_rng(3).normal(size=(200, 200))
    assert variations(200 * image) == pytest.approx(variations(image), rel=1e-9)
    assert variations(image + 0.5) == pytest.approx(
        [v * image.mean() / (image.mean() + 0.5) for v in variations(image)]
    )
    assert variations(np.full((200, 200), 0.4)) == [0.0, 0.0]


def test_bands_are_octaves_up_to_a_fifth_of_the_field_also_of_oblong_pixels():
    found = print_mottle(np.full((300, 400), 0.5), pixel_um=PIXEL_UM)  # shorter side 12 mm
    assert [(b.shortest_um, b.longest_um) for b in found.bands] == [
        (250, 500),
        (500, 1000),
        (1000, 2000),
    ]
    assert "250 to 2000 um" in found.measured
    assert "120000 pixels" in found.measured
    assert "conforming to neither" in found.measured
    assert len(variations(np.full((300, 400), 0.5), shortest_um=600.0)) == 2
    assert len(variations(np.full((300, 400), 0.5), shortest_um=600.0, longest_um=1200.0)) == 1
    image = np.random.default_rng(4).integers(90, 110, (400, 200)).astype(np.uint8)
    oblong = print_mottle(image, pixel_um=(20.0, 40.0))
    turned = print_mottle(image.T.astype(float), pixel_um=(40.0, 20.0))
    for a, b in zip(oblong.bands, turned.bands, strict=True):
        assert a.coefficient_of_variation == pytest.approx(b.coefficient_of_variation, rel=1e-9)


@pytest.mark.parametrize(
    ("image", "options", "error", "message"),
    [
        (np.ones(5), {}, InputError, "no array of two dimensions"),
        (np.ones((300, 300)), {"pixel_um": -1.0}, SizeError, "The pixel is -1.0 um"),
        (np.ones((300, 300)), {"shortest_um": 100.0}, SizeError, r"160 um \(4 pixels\) to 2400 um"),
        (
            np.ones((300, 300)),
            {"longest_um": 400.0},
            SizeError,
            "No octave lies between waves of 250 and 400 um",
        ),
        (np.ones((300, 300)), {"longest_um": 5000.0}, SizeError, "a fifth of its shorter side"),
        (np.ones((30, 300)), {}, SizeError, "a larger field"),
        (np.full((300, 300), np.nan), {}, CannotMeasure, "No pixel"),
        (np.full((300, 300), -1.0), {}, CannotMeasure, "The mean of the image is -1; .* above 0"),
    ],
)
def test_what_shows_no_mottle_is_refused(image, options, error, message):
    refused(error, message, print_mottle, image, **({"pixel_um": PIXEL_UM} | options))
