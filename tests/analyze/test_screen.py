"""A halftone screen taken off: drawn screens, a slow twin, masks."""

import numpy as np
import pytest

from folders import refused
from planish.analyze import without_screen
from planish.core.errors import CannotMeasure, InputError, SizeError

PIXEL_UM = 10.0


def waves(shape, angle_deg=45.0, per_cm=60.0, pixel_um=PIXEL_UM):
    """Phases (rows, cols) of the two sets of lines of a screen."""
    k = 2 * np.pi * per_cm * 1e-4
    y, x = (np.arange(n) * pixel_um for n in shape)
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    return k * (c * x + s * y[:, None]), k * (c * y[:, None] - s * x)


def dots(shape, angle_deg=45.0):
    """A print of round dots on half of the area: 1 is paper, 0 ink."""
    u, v = waves(shape, angle_deg)
    return (np.cos(u) + np.cos(v) > 0).astype(float)


def amplitude(image, phase, where):
    """Of a wave in an image, by least squares over some pixels."""
    terms = np.stack([np.ones(where.sum()), np.cos(phase[where]), np.sin(phase[where])], axis=1)
    found = np.linalg.lstsq(terms, image[where], rcond=None)[0]
    return np.hypot(found[1], found[2])


def interior(shape, margin=22):
    inside = np.zeros(shape, bool)
    inside[margin:-margin, margin:-margin] = True
    return inside


@pytest.mark.parametrize("angle_deg", [0.0, 15.0, 45.0, 75.0])
def test_of_a_drawn_screen_three_percent_are_left(angle_deg):
    image = dots((300, 320), angle_deg)
    after = without_screen(image, pixel_um=PIXEL_UM)
    for phase in waves(image.shape, angle_deg):
        inside = interior(image.shape)
        left = amplitude(after, phase, inside) / amplitude(image, phase, inside)
        assert left == pytest.approx(0.031, abs=0.004)


def test_masked_pixels_count_nowhere():
    image = dots((300, 320))
    mask = np.ones(image.shape, bool)
    mask[120:160, 140:190] = False
    spoilt = np.where(mask, image, 1e6)
    after = without_screen(spoilt, pixel_um=PIXEL_UM, mask=mask)
    assert np.isnan(after[~mask]).all()
    assert np.array_equal(np.isfinite(after), mask)
    away = interior(image.shape)
    away[120 - 22 : 160 + 22, 140 - 22 : 190 + 22] = False
    phase = waves(image.shape)[0]
    assert amplitude(after, phase, away) / amplitude(image, phase, away) == pytest.approx(
        0.031, abs=0.004
    )
    by_nan = without_screen(np.where(mask, image, np.nan), pixel_um=PIXEL_UM)
    assert np.array_equal(after, by_nan, equal_nan=True)


def test_near_a_border_more_of_the_screen_is_left():
    # The kernel is one-sided there; the docstring says so.
    image = np.sin(waves((300, 320), 0.0)[0])
    after = without_screen(image, pixel_um=PIXEL_UM)
    assert 0.2 < np.abs(after[:, 0]).max() < 0.5
    assert np.abs(after[:, 22:-22]).max() < 0.035


def test_a_constant_stays_up_to_the_border():
    image = np.full((60, 70), 0.37)
    image[20:30, 40:50] = np.nan
    after = without_screen(image, pixel_um=PIXEL_UM)
    assert np.nanmax(np.abs(after - 0.37)) < 1e-14


def test_it_equals_the_sum_that_it_means():
    # Slow twin: each pixel is the mean of those within 3 sigma of it along rows and columns,
    # weighted by the Gaussian.
    rng = np.random.default_rng(0)
    image = np.where(rng.random((17, 14)) < 0.2, np.nan, rng.normal(size=(17, 14)))
    down, across, sigma = 4.0, 5.0, 9.0
    reach = round(3 * sigma / down), round(3 * sigma / across)
    after = without_screen(image, pixel_um=(down, across), sigma_um=sigma)
    for r, c in np.argwhere(np.isfinite(image)):
        total = weight = 0.0
        for i in range(max(r - reach[0], 0), min(r + reach[0] + 1, 17)):
            for j in range(max(c - reach[1], 0), min(c + reach[1] + 1, 14)):
                if np.isfinite(image[i, j]):
                    g = np.exp(-(((i - r) * down) ** 2 + ((j - c) * across) ** 2) / (2 * sigma**2))
                    total, weight = total + g * image[i, j], weight + g
        assert after[r, c] == pytest.approx(total / weight, abs=1e-12)


def test_pictures_stay_in_single_precision():
    eight_bits = np.random.default_rng(1).integers(0, 256, (50, 60)).astype(np.uint8)
    after = without_screen(eight_bits, pixel_um=PIXEL_UM)
    assert after.dtype == np.float32
    assert after == pytest.approx(
        without_screen(eight_bits.astype(float), pixel_um=PIXEL_UM), rel=1e-5
    )


@pytest.mark.parametrize(
    ("image", "options", "error", "message"),
    [
        (np.ones((5, 5), complex), {}, InputError, "complex128"),
        (np.ones((5, 5)), {"pixel_um": 0.0}, SizeError, "The pixel is 0.0 um"),
        (np.ones((5, 5)), {"sigma_um": 5.0}, SizeError, "5 um is 0.5 pixels wide; it needs 0.75"),
        (np.ones((5, 5)), {"sigma_um": np.nan}, SizeError, "Take a larger sigma_um"),
        (np.ones((5, 5)), {"mask": np.ones((5, 4), bool)}, InputError, r"mask has \(5, 4\)"),
        (np.full((5, 5), np.nan), {}, CannotMeasure, "No pixel"),
        (np.ones((5, 5)), {"mask": np.zeros((5, 5), bool)}, CannotMeasure, "Check the mask"),
    ],
)
def test_what_cannot_be_averaged_is_refused(image, options, error, message):
    refused(error, message, without_screen, image, **({"pixel_um": PIXEL_UM} | options))
