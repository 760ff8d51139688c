import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

from naive import twice_smoothed
from planish.checks import CHECKS, MeasuredSheet
from planish.core.threads import limit_threads
from planish.surface import SurfaceParams, assemble, centre
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


def test_nothing_depends_on_threads_or_on_how_many_nodes_are_fitted_at_once(monkeypatch):
    height = np.random.default_rng(2).standard_normal((70, 90))
    height[20:32, 40:47] = np.nan
    whole = gaussian_regression(height, (4.0, 5.0), cutoff_um=90.0)
    monkeypatch.setattr(centre, "_NODES", 100)
    for threads in (1, 3):
        with limit_threads(threads):
            assert (
                gaussian_regression(height, (4.0, 5.0), cutoff_um=90.0).tobytes() == whole.tobytes()
            )


def test_a_paraboloid_passes_unchanged_up_to_the_border_and_nothing_lies_far_from_the_sheet():
    y, x = np.mgrid[0:80, 0:100] * 3.0
    height = 5 + 0.4 * x - 0.2 * y + 1e-3 * x * x - 5e-4 * x * y + 7e-4 * y * y
    # blocks average a paraboloid over their own size: the constant c h^2 / 12
    smooth = gaussian_regression(height, (3.0, 3.0), cutoff_um=300.0)
    assert np.abs(smooth - height).max() < 0.05
    height = np.full((200, 200), np.nan)
    height[:50] = 0.0
    assert np.isnan(gaussian_regression(height, (5.0, 5.0), cutoff_um=200.0)[150:]).all()


@pytest.mark.parametrize(("wavelength", "gain"), [(4000.0, 1.0), (400.0, 0.5), (100.0, 0.0)])
def test_transmission(wavelength, gain):
    """The cut-off passes by half; ten times longer waves pass, four times shorter ones do not."""
    x = np.arange(900) * 5.0
    height = np.broadcast_to(np.sin(2 * np.pi * x / wavelength), (200, 900)).copy()
    smooth = gaussian_regression(height, (5.0, 5.0), cutoff_um=400.0)
    inner = (slice(80, 120), slice(200, 700))
    measured = np.sqrt(np.mean(smooth[inner] ** 2) / np.mean(height[inner] ** 2))
    # 0.02 of it is the averaging over blocks of 16 um
    assert measured == pytest.approx(gain, abs=0.05)


def test_a_few_columns_far_from_all_others_spoil_nothing():
    """Data with too few neighbours must not blank the second pass around them, nor be given a wider
    cut-off."""
    rng = np.random.default_rng(1)
    _y, x = np.mgrid[0:60, 0:60] * 4.0
    height = 0.2 * x + 8 * np.sin(x / 25) + rng.normal(0, 1, x.shape)
    height[22:] = np.nan
    whole = gaussian_regression(height, (4.0, 4.0), cutoff_um=100.0)
    height[44:46, 28:30] = 0.2 * x[44:46, 28:30]
    smooth = gaussian_regression(height, (4.0, 4.0), cutoff_um=100.0)
    # the island lies beyond the reach of everything else
    np.testing.assert_allclose(smooth[:22], whole[:22], atol=0.1)
    np.testing.assert_allclose(smooth[44:46, 28:30], height[44:46, 28:30], atol=0.5)
    assert np.isnan(smooth[56:]).all()


def bridged(middle, cutoff):
    """The centre surface in pixels of 4 um; only gaps may be bridged with a wider cut-off, at any
    share of data."""
    params = SurfaceParams(cutoff_um=cutoff)
    centre, used = assemble.centre_surface(middle, np.ones(middle.shape, bool), (4.0, 4.0), params)
    # a block that is hardly known counts as a gap
    assert not (
        (used > cutoff) & ndimage.binary_erosion(np.isfinite(middle), iterations=3, border_value=1)
    ).any()
    return centre, used


def test_the_surface_is_that_of_the_cutoff_that_is_stated():
    """Many burnt rims leave islands of a few columns between them."""
    rng = np.random.default_rng(0)
    cutoff = 300.0
    y, x = np.mgrid[0:200, 0:240] * 4.0
    middle = 20 * np.sin(x / 90) + ndimage.gaussian_filter(rng.normal(0, 40, x.shape), 6)
    whole = gaussian_regression(middle, (4.0, 4.0), cutoff_um=cutoff)
    middle[(np.hypot(y - 400, x - 480) < 1.1 * cutoff) & (np.hypot(y - 400, x - 480) > 25)] = np.nan
    centre, used = bridged(middle, cutoff)
    assert np.isfinite(centre).all()
    assert (used > cutoff).any()
    inner = ndimage.distance_transform_edt(np.isfinite(middle)) * 4.0 > 60.0
    doubled = gaussian_regression(middle, (4.0, 4.0), cutoff_um=2 * cutoff)
    rms, of_doubled = (np.sqrt(np.mean((found - whole)[inner] ** 2)) for found in (centre, doubled))
    assert rms < 0.2 * of_doubled


@pytest.mark.parametrize("cutoff", [80.0, 280.0])
def test_data_with_poor_neighbours_never_blanks_a_field(cutoff):
    """Specks between overlapping rims."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:110, 0:120] * 4.0
    for holes in (10, 120):
        middle = 15 * np.sin(x / 110) + 0.1 * y
        for at in rng.uniform(0, 480, (holes, 2)):
            middle[np.hypot(y - at[0], x - at[1]) < 80] = np.nan
        middle[rng.random(middle.shape) < 1e-3] = 3.0
        bridged(middle, cutoff)


def test_a_cut_off_that_was_not_kept_is_said():
    surfaces = xr.Dataset(attrs={"bridged_off_rims_share": 0.3, "cutoff_um": 250.0})
    cutoff = next(light for light in CHECKS if light.name == "cut-off")
    check = cutoff(MeasuredSheet(None, surfaces))
    assert check.state == "look"
    assert "250 um in 70.0 %" in check.sentence
    assert check.figures == ("position",)
    assert (
        cutoff(MeasuredSheet(None, surfaces.assign_attrs(bridged_off_rims_share=0.01))).state
        == "pass"
    )
