import numpy as np
import pytest

from naive import twice_smoothed
from planish.surface.centre import gaussian_regression


def test_equals_the_slow_twin_with_gaps():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:36, 0:44] * 4.0
    height = 0.3 * x + 20 * np.sin(y / 60) + rng.normal(0, 1, x.shape)
    height[14:22, 20:28] = np.nan
    smooth = gaussian_regression(height, (4.0, 4.0), cutoff_um=90.0)
    nodes = ((0, 0), (18, 5), (17, 23), (35, 43), (28, 30))
    slow = twice_smoothed(height, (4.0, 4.0), 90.0, nodes)
    # the kernel is cut where its weight is 0.0009; the twin sums over everything
    np.testing.assert_allclose([smooth[n] for n in nodes], slow, atol=0.1)


def test_a_paraboloid_passes_unchanged_up_to_the_border():
    y, x = np.mgrid[0:80, 0:100] * 3.0
    height = 5 + 0.4 * x - 0.2 * y + 1e-3 * x * x - 5e-4 * x * y + 7e-4 * y * y
    # blocks average a paraboloid over their own size: the constant c h^2 / 12
    smooth = gaussian_regression(height, (3.0, 3.0), cutoff_um=300.0)
    assert np.abs(smooth - height).max() < 0.05


@pytest.mark.parametrize(("wavelength", "gain"), [(4000.0, 1.0), (1500.0, 1.0), (400.0, 0.5), (100.0, 0.0)])
def test_transmission(wavelength, gain):
    """The cut-off passes by half; ten times longer waves pass, four times shorter ones do not."""
    x = np.arange(900) * 5.0
    height = np.broadcast_to(np.sin(2 * np.pi * x / wavelength), (200, 900)).copy()
    smooth = gaussian_regression(height, (5.0, 5.0), cutoff_um=400.0)
    inner = (slice(80, 120), slice(200, 700))
    measured = np.sqrt(np.mean(smooth[inner] ** 2) / np.mean(height[inner] ** 2))
    print(f"gain at {wavelength:g} um: {measured:.3f}")
    # 0.02 of it is the averaging over blocks of 16 um
    assert measured == pytest.approx(gain, abs=0.05)


def test_far_from_the_sheet_there_is_no_surface():
    height = np.full((200, 200), np.nan)
    height[:50] = 0.0
    assert np.isnan(gaussian_regression(height, (5.0, 5.0), cutoff_um=200.0)[150:]).all()
