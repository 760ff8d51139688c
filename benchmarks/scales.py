"""What ``planish scales`` promises, on drawn fields whose spectra are known.

``python -m benchmarks scales [FIELDS [SPECIMENS [HEIGHTMAPS]]]``

Fields of 3 x 3 mm (pixels of 10 um) with spectra of several slopes, ranges and aspects, half of
them with holes. Octave standard deviations have to lie within 3 % of the drawn ones in the mean,
and intervals have to hold .92 to .98 of them. Noise of half the signal is taken out within 5 %, of
octaves where it is no louder than the signal; a field with 20 % of holes lies within 5 % of itself
without, both in the mean over fields; gain and phase of a linear filter within 3 % and 5 degrees in
the median where coherence is .3 or more. The gain of specimens' coatings for the surface of their
base lies within 5 % of that of the sheets as drawn in the median, the formation number of fibres
laid at random within .05 of 1 in the mean of 20. HEIGHTMAPS: folder of measured surfaces, for
spectra beside those of SurfaceTopography. Then the cost of ten maps of 4000 x 3000 pixels. 1 where
a limit is missed.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import planish as pl
from benchmarks.evidence import field
from benchmarks.explain import as_maps
from planish.analyze.formation import RandomSheet, formation_number
from planish.synthetic import DEMO, make_specimen

_N, _PIXEL_UM = 300, 10.0
_POWERS = (0.8, 1.2, 1.8, 2.5)


class Spectrum:
    """A spectral density over frequency, and fields that have it."""

    def __init__(self, rng, count=_N):
        """Draw slope, range and aspect; ``count``: pixels of a side."""
        self.count = count
        power, aspect = float(rng.choice(_POWERS)), float(rng.choice([1.0, 1.6]))
        length_um = _N * _PIXEL_UM / math.exp(rng.uniform(math.log(8), math.log(40)))
        along_y = np.fft.fftfreq(2 * count, _PIXEL_UM)[:, None]
        along_x = np.fft.rfftfreq(2 * count, _PIXEL_UM)
        self.radius = np.hypot(along_y, along_x)
        scaled = 2 * math.pi * length_um * np.hypot(along_y * aspect, along_x / aspect)
        self.density = 1.0 / (1.0 + scaled**2) ** power
        is_twice = np.ones(along_x.size)
        is_twice[1:-1] = 2.0
        self.weights = np.broadcast_to(is_twice, self.density.shape)
        self.density /= (self.density * self.weights).sum() / (2 * count) ** 2

    def waves(self, rng):
        """Transform of a field of variance 1, twice as large as needed."""
        size = (2 * self.count, 2 * self.count)
        return np.fft.rfft2(rng.normal(size=size)) * np.sqrt(self.density)

    def cut(self, waves):
        """The field of a transform, without its second half, so that it does not wrap."""
        size = (2 * self.count, 2 * self.count)
        return np.fft.irfft2(waves, size)[: self.count, : self.count]

    def sd(self, band):
        """Standard deviation in an octave."""
        in_band = (self.radius >= 1 / band.high_um) & (self.radius < 1 / band.low_um)
        power = (self.density * self.weights)[in_band].sum() / (2 * self.count) ** 2
        return math.sqrt(power)


def holes(rng, share, radius):
    """Whether pixels are known, where round holes take a share of them."""
    rows, cols = np.indices((_N, _N))
    is_known = np.ones((_N, _N), dtype=bool)
    while 1 - is_known.mean() < share:
        row, col = rng.uniform(0, _N, 2)
        is_known &= np.hypot(rows - row, cols - col) > radius * rng.uniform(0.5, 1.5)
    return is_known


def known_spectra(fields):
    """Print how far octaves are from those of the drawn spectra; the limits that were missed."""
    ratios, hits = [], []
    for number in range(fields):
        rng = np.random.default_rng([number, 521])
        spectrum = Spectrum(rng)
        values = spectrum.cut(spectrum.waves(rng))
        if number % 2:
            values = np.where(
                holes(rng, rng.uniform(0.05, 0.3), rng.uniform(4, 25)), values, np.nan
            )
        bands = pl.scales(as_maps({"a": values}, _PIXEL_UM)).bands["a"]
        true = [spectrum.sd(band) for band in bands]
        ratios.append([band.sd / sd for band, sd in zip(bands, true, strict=True)])
        hits.append(
            [
                band.interval[0] <= sd <= band.interval[1]
                for band, sd in zip(bands, true, strict=True)
            ]
        )
    ratios, hits = np.array(ratios), np.array(hits)
    bias = 100 * (ratios.mean(axis=0) - 1)
    print(f"{fields} fields, octaves of 500, 250 and 125 um: off by {_list(bias)} % in the mean;")
    print(f"  scatter {_list(100 * ratios.std(axis=0))} %")
    print(
        f"  intervals hold {_list(hits.mean(axis=0), 3)}, of all {hits.mean():.3f}; without holes"
        f" {hits[::2].mean():.3f}",
        flush=True,
    )
    return [np.abs(bias).max() > 3, not 0.92 <= hits.mean() <= 0.98]


def noise_and_holes(fields):
    """Print what noise and holes change; the limits that were missed."""
    quiet, rows, holed = [], [], []
    for number in range(fields):
        rng = np.random.default_rng([number, 522])
        spectrum = Spectrum(rng)
        values = spectrum.cut(spectrum.waves(rng))
        size = 0.5 * values.std()
        first, second = (
            values + math.sqrt(2) * size * rng.normal(size=values.shape) for _ in range(2)
        )
        maps = {
            "true": values,
            "halves": 0.5 * (first + second),
            "first": first,
            "second": second,
            "rows": values + size * rng.normal(size=values.shape),
            "holed": np.where(holes(rng, 0.2, 14), values, np.nan),
        }
        bands = pl.scales(
            as_maps(maps, _PIXEL_UM),
            of=["true", "halves", "rows", "holed"],
            halves={"halves": ("first", "second"), "rows": "rows"},
        ).bands
        true = np.array([band.sd for band in bands["true"]])
        is_loud = np.array([band.noise for band in bands["halves"]]) > true
        for name, found in (("halves", quiet), ("rows", rows), ("holed", holed)):
            ratio = np.array([band.sd for band in bands[name]]) / true
            if name != "holed":
                ratio[is_loud] = np.nan
            found.append(ratio)
    missed = []
    for words, ratios in (
        ("noise of half the signal, by two halves", quiet),
        ("the same by odd and even rows", rows),
        ("20 % of holes", holed),
    ):
        off = 100 * (np.nanmean(ratios, axis=0) - 1)
        scatter = 100 * np.nanstd(ratios, axis=0)
        print(f"{words}: off by {_list(off)} %, scatter {_list(scatter)} %", flush=True)
        missed.append(np.abs(off).max() > 5)
    return missed


def linear_filters(fields):
    """Print how far gain and phase are from those of filters; the limits that were missed."""
    gains, phases, gain_hits, phase_hits, coherences = [], [], [], [], []
    for number in range(fields):
        rng = np.random.default_rng([number, 523])
        spectrum = Spectrum(rng)
        waves = spectrum.waves(rng)
        gain = float(rng.choice([-1, 1]) * rng.uniform(0.3, 2))
        phase, coherence = rng.uniform(-70, 70), rng.uniform(0.35, 0.95)
        turned = np.exp(1j * math.radians(phase)) * waves
        turned[:, 0] = waves[:, 0]
        rest = spectrum.waves(rng) * math.sqrt(1 / coherence - 1)
        maps = {"a": spectrum.cut(waves), "b": gain * spectrum.cut(turned + rest)}
        if number % 2:
            maps["a"] = np.where(holes(rng, 0.1, 12), maps["a"], np.nan)
        for band in pl.scales(as_maps(maps, _PIXEL_UM), of=["b"], against="a").bands["b"]:
            if not band.coherence >= 0.3:
                continue
            true_deg = phase if gain > 0 else phase + math.copysign(180, -phase)
            gains.append(band.gain / gain - 1)
            phases.append(band.phase_deg - true_deg)
            coherences.append(band.coherence - coherence)
            gain_hits.append(band.gain_interval[0] <= gain <= band.gain_interval[1])
            phase_hits.append(band.phase_interval[0] <= true_deg <= band.phase_interval[1])
    gain_off, phase_off = 100 * np.array(gains), np.array(phases)
    gain_median, phase_median = np.median(np.abs(gain_off)), np.median(np.abs(phase_off))
    print(
        f"linear filters, {len(gains)} octaves of coherence .3 and more: gain off by"
        f" {gain_median:.1f} % in the median (mean {gain_off.mean():+.1f} %), phase by"
        f" {phase_median:.1f} degrees (mean {phase_off.mean():+.1f}), coherence by"
        f" {np.mean(coherences):+.3f} in the mean; intervals hold gain {np.mean(gain_hits):.3f},"
        f" phase {np.mean(phase_hits):.3f}",
        flush=True,
    )
    return [gain_median > 3, phase_median > 5]


def levelling(specimens):
    """Print how far the gain of scanned coatings is from that of the sheets as drawn."""
    ratios = []
    for number in range(specimens):
        specimen = make_specimen(replace(DEMO, seed=100 + number))
        volume = pl.volume(specimen.volume.values, voxel_um=specimen.params.scanner.voxel_um)
        run = pl.map_sheet(volume, through="z")
        measured = pl.scales(run, of=["coating_top"], against="base_surface_top")
        truth, pixel = specimen.truth, specimen.params.camera.pixel_um
        u, v = truth["u"].values, truth["v"].values
        interface = specimen.sheet.at(specimen.sheet.faces[1], u, v)
        drawn = {"coating": truth["coating_top"].values, "base": interface}
        is_paper = truth["rim"].values > 60
        drawn = {name: np.where(is_paper, m, np.nan) for name, m in drawn.items()}
        true = pl.scales(as_maps(drawn, pixel), of=["coating"], against="base").bands["coating"]
        gains = {band.low_um: band.gain for band in true if band.coherence >= 0.3}
        for band in measured.bands["coating_top"]:
            if band.low_um in gains:
                ratios.append(band.gain / gains[band.low_um] - 1)
                print(
                    f"  specimen {number}, {band.low_um:g} to {band.high_um:g} um: gain"
                    f" {band.gain:.3f}, drawn {gains[band.low_um]:.3f}",
                    flush=True,
                )
    off = 100 * np.median(np.abs(ratios))
    print(f"levelling of {specimens} specimens: gain off by {off:.1f} % in the median", flush=True)
    return [off > 5]


def laid_at_random(rng, sheet, side_um, pixel_um):
    """Grammage of straight fibres whose middles and directions are random, by points of them."""
    length_um = 1000.0 * sheet.length_mm
    mass = 1000.0 * sheet.coarseness_mg_m * length_um
    number = rng.poisson(sheet.grammage_g_m2 * (side_um + length_um) ** 2 / mass)
    middles = rng.uniform(-0.5 * length_um, side_um + 0.5 * length_um, (number, 2))
    angles = rng.uniform(0, math.pi, number)
    ways = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    across = np.stack([ways[:, 1], -ways[:, 0]], axis=1)
    step_um, widths = 0.25 * pixel_um, (np.arange(5) - 2) / 5 * sheet.width_um
    lengths = np.arange(-0.5 * length_um + 0.5 * step_um, 0.5 * length_um, step_um)
    values = np.zeros((round(side_um / pixel_um),) * 2)
    for along in lengths:
        for aside in widths:
            places = np.floor((middles + along * ways + aside * across) / pixel_um).astype(int)
            is_in = ((places >= 0) & (places < values.shape[0])).all(axis=1)
            np.add.at(values, tuple(places[is_in].T), 1.0)
    return values * mass / (lengths.size * widths.size * pixel_um**2)


def formation(fields=20):
    """Print the formation number of fibres laid at random; the limits that were missed."""
    sheet = RandomSheet(length_mm=0.8, width_um=25.0, coarseness_mg_m=0.15, grammage_g_m2=60.0)
    numbers, hits, bands = [], [], []
    for number in range(fields):
        values = laid_at_random(np.random.default_rng([number, 525]), sheet, 6000.0, 20.0)
        found = formation_number(values, pixel_um=(20.0, 20.0), sheet=sheet, cell_um=400.0)
        numbers.append(found.number)
        hits.append(found.interval[0] <= 1 <= found.interval[1])
        octaves = pl.scales(as_maps({"a": values}, 20.0)).bands["a"]
        bands.append([b.cov / sheet.cov_of(b.low_um, b.high_um) for b in octaves])
    mean = float(np.mean(numbers))
    print(
        f"formation number of {fields} sheets of fibres laid at random: {mean:.3f} in the mean,"
        f" scatter {np.std(numbers):.3f}, intervals hold {np.mean(hits):.2f}; by octave"
        f" {_list(np.mean(bands, axis=0), 2)}",
        flush=True,
    )
    return [abs(mean - 1) > 0.05]


def heightmaps(folder):
    """Print spectra of measured surfaces beside those of SurfaceTopography.

    That takes a map as periodic, which a map beside its mirror images is; ours gets four of these.
    """
    from SurfaceTopography import Topography

    missed = []
    for path in sorted(Path(folder).glob("*.npz")):
        stored = np.load(path)
        heights = stored["heights_m"].astype(np.float64) * 1e6
        if np.isnan(heights).mean() > 0.01:
            print(f"{path.stem}: missing pixels, which SurfaceTopography refuses", flush=True)
            continue
        heights = np.where(np.isnan(heights), np.nanmedian(heights), heights)
        heights -= heights.mean()
        pixel_um = stored["size_xy_m"][::-1] * 1e6 / heights.shape
        mirrored = np.block([[heights, heights[:, ::-1]], [heights[::-1], heights[::-1, ::-1]]])
        tiled = np.tile(mirrored, (2, 2))
        maps = as_maps({"a": tiled}, 1.0)
        maps = maps.assign_coords(
            y=np.arange(tiled.shape[0]) * pixel_um[0], x=np.arange(tiled.shape[1]) * pixel_um[1]
        )
        size_um = tuple(pixel_um * mirrored.shape)
        surface = Topography(mirrored, size_um, unit="um", periodic=True)
        density = surface.power_spectrum_from_area(return_map=True, reliable=False)[2]
        along = [np.fft.fftfreq(n, p) for n, p in zip(mirrored.shape, pixel_um, strict=True)]
        radius = np.hypot(along[0][:, None], along[1])
        longest_um = 0.2 * min(pixel_um * heights.shape)
        for band in pl.scales(maps).bands["a"]:
            in_band = (radius >= 1 / band.high_um) & (radius < 1 / band.low_um)
            theirs = math.sqrt(density[in_band].sum() / math.prod(size_um))
            if band.high_um <= longest_um:
                off = 100 * (band.sd / theirs - 1)
                print(
                    f"{path.stem}, {band.low_um:g} to {band.high_um:g} um: {band.sd:.4g},"
                    f" SurfaceTopography {theirs:.4g} ({off:+.1f} %)",
                    flush=True,
                )
                missed.append(abs(off) > 1)
    return missed


def cost():
    """Print what ten maps of 4000 x 3000 pixels take."""
    rng = np.random.default_rng(0)
    coarse = field(rng, (300, 400), 12.0, "exp")[0]
    values = np.kron(coarse, np.ones((10, 10))).astype(np.float32)
    maps = {}
    for number in range(10):
        maps[f"map_{number}"] = values + rng.standard_normal(values.shape, dtype=np.float32)
    data, start = as_maps(maps, 5.0), time.process_time()
    bands = pl.scales(data).bands["map_0"]
    seconds = time.process_time() - start
    print(f"ten maps of 4000 x 3000 pixels, {len(bands)} octaves: {seconds:.1f} s CPU", flush=True)
    return [seconds > 30]


def _list(values, digits=1):
    return ", ".join(f"{value:.{digits}f}" for value in values)


def main(fields=300, specimens=4, heightmap_folder=None):
    """Print all of it; 1 where a limit was missed."""
    missed = known_spectra(fields)
    missed += noise_and_holes(fields // 3)
    missed += linear_filters(fields // 3)
    missed += formation()
    missed += cost()
    missed += levelling(specimens)
    if heightmap_folder is not None:
        missed += heightmaps(heightmap_folder)
    return int(any(missed))
