"""The sheet has the statistics that were ordered: means, spreads, spectra, and a coating that
levels the base."""

import numpy as np
import pytest
from scipy import fft, ndimage, stats

from planish.synthetic import PRESETS, BurnParams, PaperParams, make_sheet, neutral_height
from planish.synthetic.params import generator
from planish.synthetic.sheet import PITCH_UM, fibres, hole_pattern, lowpass, noise, streaks

LOW, SMALL, LARGE = np.zeros(2), np.array([1500.0, 1200.0]), np.array([6000.0, 4500.0])
NO_HOLES = np.zeros((0, 2))


def _sheet(paper, seed=0, high=SMALL, **more):
    return make_sheet(paper, BurnParams(), low=LOW, high=high, centres=NO_HOLES, seed=seed, **more)


@pytest.fixture(scope="module")
def wfc():
    return _sheet(PaperParams())


def _layers(sheet):
    top, inner_top, inner_bottom, bottom = sheet.faces.astype(float)
    return top - inner_top, inner_top - inner_bottom, inner_bottom - bottom


def _correlation_um(field):
    """Distance at which the autocorrelation along the rows has fallen to 1/e."""
    field = field - field.mean()
    n = field.shape[1]
    power = np.mean(np.abs(fft.rfft(field, 2 * n, axis=1)) ** 2, axis=0)
    lags = fft.irfft(power)[:n] / np.arange(n, 0, -1)
    return PITCH_UM * np.interp(-np.exp(-1), -lags[:400] / lags[0], np.arange(400))


def test_base_thickness_faces_and_densities(wfc):
    base = _layers(wfc)[1]
    # 27 mm2 hold a dozen flocs: the mean wanders by some tenths of a micrometre
    assert (base.mean(), base.std()) == (pytest.approx(55.0, abs=0.5), pytest.approx(4.0, rel=0.08))
    top, bottom = wfc.faces[1].astype(float), -wfc.faces[2].astype(float)
    assert (top.std(), bottom.std()) == (pytest.approx(3.5, rel=0.05), pytest.approx(3.5, rel=0.05))
    # outward heights: -0.3 is asked for; -0.37 follows from the two spreads of 3.5 and 4 um
    assert np.corrcoef(top.ravel(), bottom.ravel())[0, 1] == pytest.approx(-0.35, abs=0.08)
    density, mass = wfc.coating_density.astype(float), wfc.base_mass.astype(float)
    assert density.std() == pytest.approx(0.04, rel=0.15)
    # 0.3 is asked for; few flocs lie in 27 mm2
    assert np.corrcoef(density.ravel(), mass.ravel())[0, 1] == pytest.approx(0.3, abs=0.12)
    assert mass.mean() == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("side", [0, 2])
def test_coating(wfc, side):
    coating = _layers(wfc)[side]
    assert (coating.mean(), coating.std()) == (
        pytest.approx(17.4, abs=0.3),
        pytest.approx(4.5, rel=0.05),
    )
    assert 0.01 <= (coating < 5).mean() <= 0.03
    assert coating.min() >= 0
    assert stats.skew(coating.ravel()[::11]) < -0.3  # thin where fibres stand up


def test_the_coating_levels_the_base_at_fibre_scale(wfc):
    """Below the levelling wavelength the coating is the base's negative; above it follows the
    base."""
    coating, base = _layers(wfc)[0], wfc.faces[1].astype(float)
    fine = [f - lowpass(f, 60.0) for f in (coating, base)]
    coarse = [lowpass(f, 600.0) for f in (coating, base)]
    assert np.corrcoef(fine[0].ravel(), fine[1].ravel())[0, 1] < -0.85
    assert np.corrcoef(coating.ravel(), base.ravel())[0, 1] < -0.5
    assert abs(np.corrcoef(coarse[0].ravel(), coarse[1].ravel())[0, 1]) < 0.35


@pytest.mark.nightly
def test_the_outer_face_follows_the_base_by_half_at_the_levelling_wavelength():
    """Gain of the outer face over the base's face, per wavelength."""
    paper = PaperParams(coating_sd_um=0.0, coating_noise_sd_um=0.0, coating_top_um=40.0)
    sheet = _sheet(paper, high=LARGE)
    outer, base = (np.abs(fft.fft2(f - f.mean())) for f in sheet.faces[:2].astype(float))
    frequency = np.hypot(
        *np.meshgrid(*(fft.fftfreq(n, PITCH_UM) for n in outer.shape), indexing="ij")
    )
    for wave, gain in ((250.0, 0.5), (500.0, 0.84), (125.0, 0.0625)):
        ring = np.abs(frequency * wave - 1) < 0.05
        assert np.sqrt(np.mean(outer[ring] ** 2) / np.mean(base[ring] ** 2)) == pytest.approx(
            gain, abs=0.05
        )


def test_noise_has_its_correlation_length():
    field = noise((600, 800), 20.0, generator(0, "test"))
    assert (field.mean(), field.std()) == (pytest.approx(0, abs=1e-9), pytest.approx(1))
    assert _correlation_um(field) == pytest.approx(20.0, rel=0.12)


def test_fibres_and_streaks_lie_along_the_machine_direction():
    """U runs along the columns."""
    net = ndimage.gaussian_filter(fibres((1000, 1000), 4.0, 4.0, generator(0, "net")), 2.0)
    across, along = np.gradient(net)
    assert np.mean(across**2) > 1.5 * np.mean(along**2)
    field = streaks((300, 200), 600.0, generator(0, "streaks"))
    assert (np.ptp(field, axis=1).max(), field[:, 0].std()) == (0, pytest.approx(1))


@pytest.mark.ci
def test_texture_of_the_base_and_calendering():
    texture = _sheet(PaperParams()).texture
    assert texture.mean() == pytest.approx(1.0, abs=0.03)
    # fibres 0.20, and grains of filler that a scanner's blur averages away
    calm = ndimage.gaussian_filter(texture.astype(float), (0, 2, 2))
    assert calm[5].std() == pytest.approx(0.2, rel=0.15)
    middle, face = (texture[k] - calm[k] for k in (5, 0))
    assert middle.std() > face.std()
    before, after = (_sheet(PRESETS[name][1]) for name in ("wfc135", "wfc135-calendered"))
    assert after.faces[0].std() == pytest.approx(0.5 * before.faces[0].std(), rel=0.1)
    means = [[layer.mean() for layer in _layers(sheet)[:2]] for sheet in (before, after)]
    np.testing.assert_allclose(means, [[17.4, 59.5], [16.6, 50.5]], atol=0.6)


def test_the_coded_pattern_has_no_two_equal_pitches_and_the_stage_its_error():
    corner = np.array([8200.0, 6100.0])
    holes = hole_pattern(BurnParams(stage_um=0.0), LOW, corner, 0)
    assert len(holes) == 21
    more = hole_pattern(BurnParams(stage_um=0.0, count=24), LOW, corner, 0)
    np.testing.assert_array_equal(more, holes)
    lines = [holes[:7], holes[7:14], holes[14:]]
    pitches = np.concatenate([np.linalg.norm(np.diff(line, axis=0), axis=1) for line in lines])
    assert pitches.min() >= 500 - 1e-6
    assert pitches.max() <= 950 + 1e-6
    assert len(np.unique(np.round(pitches, 3))) == len(pitches)
    errors = [
        hole_pattern(BurnParams(stage_um=4.0), LOW, corner, seed) - holes for seed in range(12)
    ]
    assert np.std(errors) == pytest.approx(4.0, rel=0.12)


def test_the_unstrained_surface_of_a_bent_laminate():
    """No force along the sheet: the integral of modulus times distance vanishes; the middle of the
    base with 0."""
    base, top, bottom = 55.0, 17.0, 12.0
    z = np.linspace(-base / 2 - bottom, base / 2 + top, 400_001)
    for ratio in (0.0, 0.5, 1.0, 3.0):
        modulus = np.where(np.abs(z) < base / 2, 1.0, ratio)
        expected = float(np.sum(modulus * z) / np.sum(modulus))
        assert neutral_height(base, top, bottom, ratio) == pytest.approx(expected, abs=1e-3)
    assert neutral_height(base, top, bottom, 1.0) == pytest.approx((top - bottom) / 2)
    soft, stiff = (
        _sheet(PaperParams(coating_bottom_um=5.0), stiffness=ratio) for ratio in (0.0, 2.0)
    )
    moved = soft.faces - stiff.faces
    assert np.ptp(moved) < 1e-4
    assert 2.0 < moved.mean() < 12.0
