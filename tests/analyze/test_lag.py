from dataclasses import replace

import numpy as np
import pytest
from scipy import fft, ndimage

from analyze.fields import by_shift, texture
from folders import refused
from planish.analyze import RegistrationBasis, cross_fitted, searched_null, texture_lag
from planish.core.errors import CannotMeasure, SizeError
from planish.texture import in_band, ncc, textures
from planish.texture.lag_field import lag_field

PAD = 16


def moved(field, lag):
    """What a periodic field shows at p, the result shows at p + lag, (x, y) in pixels."""
    y, x = fft.fftfreq(field.shape[0])[:, None], fft.fftfreq(field.shape[1])[None]
    return fft.ifft2(fft.fft2(field) * np.exp(-2j * np.pi * (y * lag[1] + x * lag[0]))).real


def cut(field):
    return field[PAD:-PAD, PAD:-PAD].copy()


def pair(r, lag, seed, *, shape=(96, 112), sigma=2.0):
    """Two maps of correlation r, a lag between them, and holes of their own; and what may be looked
    at."""
    rng = np.random.default_rng(seed)
    big = (shape[0] + 2 * PAD, shape[1] + 2 * PAD)
    a, other = texture(big, sigma, rng), texture(big, sigma, rng)
    a, b = cut(a), cut(r * moved(a, lag) + np.sqrt(1 - r * r) * other)
    y, x = np.mgrid[: shape[0], : shape[1]]
    a[np.hypot(y - 35, x - 50) < 11] = np.nan
    dirt = np.hypot(y - 70, x - 80) < 9
    b[dirt] = 50.0
    return a, b, ~dirt


def test_the_transforms_give_what_direct_sums_give():
    rng = np.random.default_rng(3)
    a, b = rng.normal(5.0, 2.0, (19, 23)), rng.normal(-300.0, 0.1, (19, 23))
    known_a, known_b = rng.random((2, 19, 23)) > 0.25
    a[~known_a], b[~known_b] = 1e6, -1e6
    r = ncc.MaskedNcc(a, a_valid=known_a, b_valid=known_b, reach=(5, 6))(b)
    for dy in range(-5, 6):
        for dx in range(-6, 7):
            x, y = [], []
            for row in range(19):
                for col in range(23):
                    if (
                        0 <= row + dy < 19
                        and 0 <= col + dx < 23
                        and known_a[row, col]
                        and known_b[row + dy, col + dx]
                    ):
                        x.append(a[row, col])
                        y.append(b[row + dy, col + dx])
            assert r[5 + dy, 6 + dx] == pytest.approx(np.corrcoef(x, y)[0, 1], abs=1e-9)


def lag_of(a, b, valid=None, pixel_um=(4.0, 4.0), *, reach_um=40.0, tiles_um=None):
    valid = np.ones(a.shape, dtype=bool) if valid is None else valid
    return texture_lag(
        textures({"a": a, "b": b}, valid, pixel_um),
        ["a"],
        "b",
        reach_um=reach_um,
        tiles_um=tiles_um,
    )


@pytest.mark.parametrize("lag", [(0.0, 0.0), (2.3, -1.6), (-5.5, 4.25)])
def test_a_known_lag_is_found_to_a_fifth_of_a_pixel(lag):
    a, b, valid = pair(0.95, lag, 1, shape=(150, 170), sigma=1.5)
    found = lag_of(a, 3.0 - 0.2 * b, valid, (4.0, 5.0))
    assert found.distinct
    assert found.r < -0.9  # brightness against darkness: either sign is found
    assert found.lag_um == pytest.approx((5.0 * lag[0], 4.0 * lag[1]), abs=0.8)
    assert max(found.se_um) < 0.8


@pytest.mark.ci
def test_the_standard_error_is_what_the_lags_scatter_by():
    lag = (1.7, -2.4)
    lags = [lag_of(*pair(0.4, lag, seed, shape=(120, 140))) for seed in range(60)]
    distinct = [found for found in lags if found.distinct]
    assert len(distinct) >= 58
    errors = np.array([found.lag_um for found in distinct]) - 4.0 * np.array(lag)
    expected = np.array([found.se_um for found in distinct])
    assert np.abs(errors.mean(axis=0)).max() < 0.1 + 2 * expected.mean() / np.sqrt(len(distinct))
    ratio = np.sqrt(np.mean((errors / expected) ** 2))
    print(f"scatter over standard error {ratio:.2f}, standard error {expected.mean():.2f} um")
    assert 0.8 < ratio < 1.25


def test_the_positive_peak_is_found_beside_a_deeper_valley():
    y, x = np.mgrid[-12 - ncc.MARGIN : 13 + ncc.MARGIN, -12 - ncc.MARGIN : 13 + ncc.MARGIN]
    r = 0.5 * np.exp(-((y - 3) ** 2 + x**2) / 8) - 0.8 * np.exp(-((y + 5) ** 2 + (x - 4) ** 2) / 8)
    peak = ncc.find_peak(r, ncc.within((12, 12)))
    assert peak.summit_px == pytest.approx((3.0, 0.0), abs=0.05)
    assert peak.r == pytest.approx(0.5, abs=0.01)


@pytest.mark.ci
def test_unrelated_maps_give_no_lag():
    silent = 0
    for seed in range(60):
        rng = np.random.default_rng(100 + seed)
        found = lag_of(*(cut(texture((96, 112), 2.5, rng)) for _ in range(2)))
        silent += not found.distinct
        assert found.distinct == np.isfinite(found.lag_um).all() == np.isfinite(found.se_um).all()
    print(f"{silent} of 60 unrelated pairs give no lag")
    assert silent >= 57  # 1 in 100; more than 3 of 60 in 3 of 1000


def test_what_is_said_and_with_which_light():
    a, b, valid = pair(0.8, (2.0, 0.0), 4)
    found = lag_of(a, b, valid)
    right, off = found.check(6.0), found.check(0.3)
    assert (right.state, off.state) == ("pass", "look")
    assert right.sentence.endswith("um), expected error 6.0 um: agrees.")
    assert off.value == pytest.approx(8.0, abs=1.5)
    assert off.limit == pytest.approx(1.73 * np.hypot(0.3, np.hypot(*found.se_um)), rel=0.01)
    assert "Nothing else shows a shift that all marks share" in off.sentence
    assert off.figures == ("position", "correlation")
    nothing = lag_of(a, pair(0.8, (0, 0), 41)[1], valid).check(3.0)
    assert nothing.state == "unknown"
    assert nothing.sentence.startswith(
        "Image-based check: inconclusive, because the maps have no texture in common"
    )
    assert lag_of(a, np.where(np.arange(b.shape[1]) < 4, b, np.nan)).reason == "few"
    # More than the marks allow, but within 3 standard errors of the lag: no answer.
    vague = replace(found, lag_um=(2.0, 0.0), covariance_um2=np.eye(2))
    assert [vague.check(e).state for e in (0.1, 1.0)] == ["pass", "pass"]
    assert replace(vague, lag_um=(2.8, 0.0)).check(0.1).state == "unknown"


@pytest.mark.parametrize("shift", [(0.0, 0.0), (2.0, -1.0)])
def test_light_from_one_side_moves_no_lag(shift):
    """The image follows a coating and, under oblique light, the slopes of a surface that is related
    to the coating."""
    rng = np.random.default_rng(8)
    coating, base, own = (texture((192, 212), s, rng) for s in (2.0, 3.0, 2.0))
    surface = coating + base
    slope = np.gradient(surface, axis=1)
    image = moved(coating + 0.8 * slope / slope.std() + 0.3 * own, shift)
    maps = {"coating": cut(coating), "surface": cut(surface), "image": cut(image)}
    found = textures(maps, np.ones(maps["image"].shape, dtype=bool), (4.0, 4.0)).with_slopes(
        "surface"
    )
    true = 4.0 * np.array(shift)
    alone = texture_lag(found, ["coating"], "image", reach_um=40.0)
    assert abs(alone.lag_um[0] - true[0]) > 3 * alone.se_um[0]  # what this test is about
    both = texture_lag(
        found, ["coating", "surface_x", "surface_y"], "image", reach_um=40.0, slopes=2
    )
    assert np.abs(np.array(both.lag_um) - true).max() < 3 * max(both.se_um) < 3.0
    assert both.light > 0.2


@pytest.mark.ci
def test_tiles_show_a_stretch():
    rng = np.random.default_rng(5)
    big = texture((230, 250), 2.0, rng)
    y, x = np.mgrid[PAD : 230 - PAD, PAD : 250 - PAD].astype(float)
    stretch = 0.01
    b = ndimage.map_coordinates(big, [y, (x - 125) / (1 + stretch) + 125], order=5)
    b += 0.5 * cut(texture(big.shape, 2.0, rng))
    field = lag_of(cut(big), b, reach_um=24.0, tiles_um=240.0).field
    assert field is not None
    assert field.distinct.all()
    true = np.stack(
        [stretch * (field.at_um[:, 0] - (125 - PAD) * 4.0), 0 * field.at_um[:, 0]], axis=-1
    )
    assert np.sqrt(np.mean((field.lag_um - true) ** 2)) < 1.0  # a quarter of a pixel
    _, change, spread = field.linear()
    assert change == pytest.approx(np.array([[stretch, 0], [0, 0]]), abs=0.002)
    assert np.all(np.abs(change - [[stretch, 0], [0, 0]]) < 4 * spread)


@pytest.mark.parametrize("wave", [10.0, 40.0])
def test_a_band_halves_its_limits(wave):
    x = np.cos(2 * np.pi * np.arange(400) / wave) * np.ones((40, 1))
    known = np.ones(x.shape, dtype=bool)
    assert in_band(x, known, (1.0, 1.0), (wave, None))[20, 200] == pytest.approx(0.5, abs=0.01)
    assert in_band(x, known, (1.0, 1.0), (None, wave))[20, 200] == pytest.approx(0.5, abs=0.01)


def test_large_maps_are_averaged_and_every_run_is_the_same():
    rng = np.random.default_rng(2)
    big = np.kron(texture((330, 330), 4.0, rng), np.ones((2, 2)))
    a, b = big[8:648, 8:648], big[10:650, 4:644]
    one, two = (lag_of(a, b, pixel_um=(2.0, 2.0)) for _ in range(2))
    assert (one.pixel_um, one.lag_um) == ((4.0, 4.0), pytest.approx((8.0, -4.0), abs=0.4))
    assert (one.lag_um, one.covariance_um2.tobytes()) == (two.lag_um, two.covariance_um2.tobytes())


def test_what_does_not_fit_is_refused():
    a, b, valid = pair(0.5, (0, 0), 1)
    refused(CannotMeasure, "one grid", textures, {"a": a, "b": b[1:]}, valid, (1.0, 1.0))
    refused(SizeError, "pixel of 80 um", textures, {"a": a, "b": b}, valid, (80.0, 80.0))
    refused(SizeError, "reach of 150 um", lag_of, a, b, valid, reach_um=150.0)
    refused(SizeError, "Tiles of 60 um", lag_of, a, b, valid, tiles_um=60.0)
    with pytest.raises(CannotMeasure, match="too small for its texture"):
        cross_fitted(a[:40, :40], b[:40, :40], by_shift(b[:40, :40], 5), pixel_um=(1.0, 1.0))
    saddle = np.multiply.outer(*[np.linspace(-1.0, 1.0, 60)] * 2)
    with pytest.raises(CannotMeasure, match="not be independent"):
        cross_fitted(saddle, saddle, by_shift(saddle, 5), pixel_um=(1.0, 1.0))


@pytest.mark.nightly
def test_a_searched_correlation_of_independent_maps_is_inflated_and_a_cross_fitted_one_is_not():
    naive, fitted, false, held = [], [], 0, 0
    for seed in range(40):
        rng = np.random.default_rng(700 + seed)
        a, b = (cut(texture((104, 120), 1.5, rng)) for _ in range(2))
        tune = by_shift(b, 12, sign=1)
        placed = tune(a, np.isfinite(a))
        both = np.isfinite(placed)
        naive.append(np.corrcoef(a[both], placed[both])[0, 1])
        found = cross_fitted(a, b, tune, pixel_um=(1.0, 1.0))
        fitted.append(found.r)
        held += found.interval[0] <= 0 <= found.interval[1]
        false += searched_null(a, tune).p <= 0.05
    error = np.std(fitted) / np.sqrt(40)
    print(
        f"searched {np.mean(naive):.3f}, cross-fitted {np.mean(fitted):.4f} ± {error:.4f}, false"
        f" alarms {false} of 40"
    )
    assert np.mean(naive) > 10 * np.std(naive) / np.sqrt(40)
    assert abs(np.mean(fitted)) < 2 * error
    assert false <= 3  # 8 %
    assert held >= 35


def test_a_cross_fitted_correlation_of_related_maps_is_theirs():
    a, b, _ = pair(0.6, (3.0, -2.0), 21, shape=(150, 170), sigma=1.5)
    a[np.isnan(a)], b[b > 10] = 0.0, np.nan
    tune = by_shift(b, 9)
    found = cross_fitted(a, b, tune, pixel_um=(1.0, 1.0))
    assert found.r == pytest.approx(0.6, abs=0.06)
    assert 0.2 < found.n / a.size < 0.6
    assert found.tile_um >= 4 * found.guard_um
    assert found.registration == RegistrationBasis.CROSS_FITTED
    assert found.sentence.endswith("registration: refined (cross-fitted)")
    assert found.interval[0] < 0.6 < found.interval[1]
    assert found.r_of_marks < found.interval[0]
    assert found.gain_interval[0] > 0.1
    assert "from which it differs by" in found.sentence
    null = searched_null(a, tune)
    assert null.null_95 < abs(null.r)
    assert null.p < 0.01
    assert null.sentence.endswith("registration: refined (searched null)")
    assert RegistrationBasis.MARKS.sentence == "registration: marks only"


@pytest.mark.parametrize("shift_px", [0.12, 0.25])
def test_tiles_with_features_of_few_pixels_state_what_is_lost_between_the_pixels(shift_px):
    """A summit of 2 pixels is drawn towards a whole lag; without that, the stated errors are 3 to 4
    times too small."""
    rng, shape = np.random.default_rng(3), (200, 200)
    a = texture(shape, 0.5, rng)
    b = moved(a, (shift_px, 0.0))
    spread = a.std()
    b += 0.1 * spread * rng.standard_normal(shape)
    tiles = lag_field(
        a,
        b,
        np.ones(shape, bool),
        (1.0, 1.0),
        reach=(4, 4),
        tile_um=30.0,
        unrelated=[rng.standard_normal(shape)],
        overlapping=False,
    )
    assert tiles.distinct.all()
    errors = tiles.lag_um - np.array([shift_px, 0.0])
    true = np.sqrt(np.mean(np.sum(errors**2, axis=1)))
    stated = np.sqrt(np.mean(np.trace(tiles.covariance_um2, axis1=1, axis2=2)))
    assert 0.7 < true / stated < 1.4
