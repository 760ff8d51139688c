"""Octaves of drawn maps whose waves are known: borders, holes, noise, gain and phase, formation."""

import math

import numpy as np
import pytest
import xarray as xr

import planish as pl
from planish.analyze.formation import RandomSheet, formation_number
from planish.core.errors import CannotMeasure, InputError
from planish.report.scales import pictures_of, scales_page, tables_of
from planish.texture.octave_spectra import OctaveField

PIXEL_UM = 10.0
SHAPE = (300, 320)  # octaves of 500 to 250, of 250 to 125, of 125 to 62.5 um
OF_SHEET = {
    "fibre_length_mm": 1.0,
    "fibre_width_um": 20.0,
    "coarseness_mg_m": 0.15,
    "mean_grammage_g_m2": 80.0,
}


def dataset(pixel_um=PIXEL_UM, **arrays):
    rows, cols = next(iter(arrays.values())).shape
    coords = {"v": np.arange(rows) * pixel_um, "u": np.arange(cols) * pixel_um}
    return xr.Dataset({name: (("v", "u"), m) for name, m in arrays.items()}, coords=coords)


def wave(length_um, turn_deg=30.0, phase_deg=0.0):
    y, x = np.indices(SHAPE) * PIXEL_UM
    turn = math.radians(turn_deg)
    turns = (x * math.cos(turn) + y * math.sin(turn)) / length_um
    return np.cos(2 * math.pi * turns + math.radians(phase_deg))


def texture(rng, shape=SHAPE, power=2.0, phase_deg=0.0):
    """A field whose spectral density is known, cut from one that wraps, or both with a later one.

    The later one has the waves of the first towards larger x with another phase.
    """
    size = (2 * shape[0], 2 * shape[1])
    frequency = np.hypot(np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])) / PIXEL_UM
    density = 1.0 / (1.0 + (frequency * 300.0) ** 2) ** power
    waves = np.fft.rfft2(rng.normal(size=size)) * np.sqrt(density)
    later = waves * np.where(np.fft.rfftfreq(size[1]) > 0, np.exp(1j * math.radians(phase_deg)), 1)
    return [np.fft.irfft2(w, size)[: shape[0], : shape[1]] for w in (waves, later)]


def sd_of_octave(low_um, high_um, power=2.0):
    """Of :func:`texture`, by its density."""
    f = np.linspace(1 / high_um, 1 / low_um, 400)
    ring = 2 * math.pi * f / (1.0 + (f * 300.0) ** 2) ** power
    return math.sqrt(np.trapezoid(ring, f)) * PIXEL_UM


def test_a_wave_has_its_deviation_in_its_octave_alone():
    for length_um, number in ((350.0, 0), (90.0, 2)):
        maps = dataset(a=5.0 + 3.0 * wave(length_um))
        found = pl.scales(maps, of=["a"])
        sds = [band.sd for band in found.bands["a"]]
        assert sds.pop(number) == pytest.approx(3 / math.sqrt(2), rel=0.03)
        assert max(sds) < 0.2
        assert found.maps["a"].mean == pytest.approx(maps["a"].values.mean())
    edges = [(band.low_um, band.high_um) for band in found.bands["a"]]
    assert edges == [(250.0, 500.0), (125.0, 250.0), (62.5, 125.0)]


def test_gain_and_phase_are_those_of_the_filter():
    values, later = texture(np.random.default_rng(2), power=1.0, phase_deg=35)
    maps = dataset(a=values, b=0.4 * later, c=-0.7 * values)
    found = pl.scales(maps, of=["b", "c"], against="a")
    for band in found.bands["b"]:
        assert band.gain == pytest.approx(0.4, rel=0.03)
        assert band.phase_deg == pytest.approx(35, abs=3)
        assert band.coherence > 0.95
    for band in found.bands["c"]:
        assert band.gain == pytest.approx(-0.7, rel=1e-5)
        assert abs(band.phase_deg) == pytest.approx(180, abs=1e-3)
        assert band.gain_interval == pytest.approx((band.gain, band.gain), rel=1e-3)


def test_deviations_are_those_of_the_spectrum_with_holes_or_without():
    rng = np.random.default_rng(7)
    rows, cols = np.indices(SHAPE)
    ratios = []
    for _ in range(4):
        is_hole = np.zeros(SHAPE, dtype=bool)
        while is_hole.mean() < 0.2:
            row, col = rng.uniform(0, SHAPE[0]), rng.uniform(0, SHAPE[1])
            is_hole |= np.hypot(rows - row, cols - col) < 14
        values = texture(rng)[0]
        # A slope, and a level of 100, are no waves: they do not leak.
        whole = values + 100.0 + 0.01 * cols
        found = pl.scales(dataset(a=whole, b=np.where(is_hole, np.nan, whole)))
        for band, holed in zip(found.bands["a"], found.bands["b"], strict=True):
            true = sd_of_octave(band.low_um, band.high_um)
            assert band.sd == pytest.approx(true, rel=5 / math.sqrt(8 * band.modes))
            ratios.append(holed.sd / band.sd)
            assert np.ptp(holed.interval) > np.ptp(band.interval)
    assert np.mean(np.reshape(ratios, (4, 3)), axis=0) == pytest.approx(1.0, abs=0.05)
    assert found.maps["b"].known_share == pytest.approx(1 - is_hole.mean())


def test_the_noise_of_two_halves_is_taken_off():
    rng = np.random.default_rng(11)
    values = texture(rng)[0]
    size = 0.7 * values.std()
    first, second = (values + size * rng.normal(size=SHAPE) for _ in range(2))
    maps = dataset(a=0.5 * (first + second), first=first, second=second, true=values)
    found = pl.scales(maps, of=["a"], halves={"a": ("first", "second")})
    plain, true = (pl.scales(maps, of=[name]).bands[name] for name in ("a", "true"))
    for band, with_noise, expected in zip(found.bands["a"], plain, true, strict=True):
        assert band.noise**2 + band.sd**2 == pytest.approx(with_noise.sd**2, rel=1e-6)
        assert band.sd == pytest.approx(expected.sd, rel=0.05)
    assert "first" not in pl.scales(maps, halves={"a": ("first", "second")}).bands


def test_a_random_sheet_has_the_variance_of_its_fibres():
    sheet = RandomSheet(length_mm=1.0, width_um=20.0, coarseness_mg_m=0.15, grammage_g_m2=80.0)
    assert sheet.point_cov2 == pytest.approx(0.15e3 / (20 * 80))
    # Cells as small as a fibre is wide have next to the variance of points; large ones that of
    # counts of fibres: coarseness times length over grammage times area.
    short = RandomSheet(length_mm=0.2, width_um=40.0, coarseness_mg_m=0.15, grammage_g_m2=80.0)
    assert short.cell_covariances((8, 8), 4.0)[0, 0] == pytest.approx(short.point_cov2, rel=0.06)
    counts = 0.15e3 * 1.0e3 / (80.0 * 2.0e4**2)
    assert sheet.cell_covariances((8, 8), 2.0e4)[0, 0] == pytest.approx(counts, rel=0.06)
    # All octaves together make the variance of points.
    covs = [sheet.cov_of(2.0**k, 2.0 ** (k + 1)) for k in range(-2, 17)]
    assert np.square(covs).sum() == pytest.approx(sheet.point_cov2, rel=0.02)


def laid_at_random(rng, sheet, side_um, pixel_um):
    """Grammage of fibres as lines of pixels, each with its mass."""
    length_um = 1000.0 * sheet.length_mm
    mass = sheet.coarseness_mg_m * 1000.0 / pixel_um**2
    area = (side_um + length_um) ** 2
    number = rng.poisson(sheet.grammage_g_m2 * area / (1000.0 * sheet.coarseness_mg_m * length_um))
    middles = rng.uniform(-0.5 * length_um, side_um + 0.5 * length_um, (number, 2))
    angles = rng.uniform(0, math.pi, number)
    ways = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    values = np.zeros((int(side_um / pixel_um),) * 2)
    step_um = 0.5 * pixel_um
    for along in np.arange(-0.5 * length_um + 0.5 * step_um, 0.5 * length_um, step_um):
        places = np.floor((middles + along * ways) / pixel_um).astype(int)
        is_in = ((places >= 0) & (places < values.shape[0])).all(axis=1)
        np.add.at(values, tuple(places[is_in].T), mass * step_um)
    return values


def test_fibres_laid_at_random_have_a_formation_number_of_one():
    sheet = RandomSheet(length_mm=0.4, width_um=20.0, coarseness_mg_m=0.15, grammage_g_m2=60.0)
    rng = np.random.default_rng(4)
    numbers = []
    for _ in range(4):
        values = laid_at_random(rng, sheet, 3200.0, 40.0)
        formation = formation_number(values, pixel_um=(40.0, 40.0), sheet=sheet, cell_um=160.0)
        numbers.append(formation.number)
        assert formation.interval[0] < 1.0 < formation.interval[1]
    assert np.mean(numbers) == pytest.approx(1.0, abs=0.1)
    # Clouds of 10 % of the mean are flocs.
    values *= 1.0 + 0.1 * np.sin(np.arange(80) / 4)
    cloudy = formation_number(values, pixel_um=(40.0, 40.0), sheet=sheet, cell_um=160.0)
    assert cloudy.number > formation.number * 1.1
    with pytest.raises(CannotMeasure, match="needs 9"):
        formation_number(values, pixel_um=(40.0, 40.0), sheet=sheet, cell_um=1600.0)


def test_what_has_no_octaves_is_refused_or_said():
    maps = dataset(a=texture(np.random.default_rng(1))[0])
    with pytest.raises(InputError, match="no map 'b'"):
        pl.scales(maps, of=["b"])
    with pytest.raises(InputError, match="fibre_width_um"):
        pl.scales(maps, fibre_length_mm=1.0)
    with pytest.raises(InputError, match="angles of an axis"):
        pl.scales(
            maps.assign(angle=maps["a"].assign_attrs(units="deg", period_deg=180.0)), of=["angle"]
        )
    small = pl.scales(maps.isel(v=slice(0, 20)))
    assert small.bands["a"] == ()
    assert "holds no octave" in small.maps["a"].reason
    assert "holds no octave" in scales_page(small, source="run", version="1")


def test_the_page_answers_and_its_table_holds_the_numbers():
    values = texture(np.random.default_rng(3))[0]
    level = dataset(a=20.0 - 0.8 * values, b=values)
    level["b"].attrs["form_um"] = 400.0
    found = pl.scales(level, of=["a"], against="b", formation_cell_um=300.0, **OF_SHEET)
    page = scales_page(found, source="run", version="1")
    cut = "B is a height above its form, which takes half of waves of 400"
    for words in ("mirrors b most", "a falls by 0.80", "What would make it more certain", cut):
        assert words in page
    table = tables_of(found)["octaves"]
    shortest_first = found.bands["a"][::-1]
    assert table["gain"] == [band.gain for band in shortest_first]
    assert table["low"] == [band.interval[0] for band in shortest_first]
    relation, _ = pictures_of(found)
    assert ">1.0<" in relation.svg  # the axis of coherence goes up to 1
    formation = found.maps["a"].formation
    assert formation.number == pytest.approx(formation.cov / formation.random_cov)
    assert f"{formation.number:.2f}" in page


def test_band_maps_hold_the_waves_of_their_octaves():
    values = texture(np.random.default_rng(8))[0]
    is_valid = np.ones(SHAPE, dtype=bool)
    is_valid[40:70, 50:90] = False
    field = OctaveField(is_valid, (PIXEL_UM, PIXEL_UM))
    bands = pl.scales(dataset(a=np.where(is_valid, values, np.nan))).bands["a"]
    for band, array in zip(bands, field.band_maps(values), strict=True):
        assert np.isnan(array).sum() == (~is_valid).sum()
        assert np.nanstd(array) == pytest.approx(band.sd, rel=0.15)
    long_wave = field.band_maps(wave(350.0))
    assert np.nanstd(long_wave[0]) > 20 * np.nanstd(long_wave[2])
