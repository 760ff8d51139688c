"""Power of maps by octaves of wavelength, and of one map with another, with holes and borders.

A pyramid of means gives each octave pixels of a sixteenth of its shortest wave or less. There, a
mean over the surroundings is taken off, where missing pixels are filled from coarser levels: what
is left holds little of the longer waves that could leak. Its covariances by lag are those of pairs
of known pixels (a pixel counts less, the less of its surroundings is known), cut by a window that
is flat in its inner half (Politis and Romano 1995), and their Fourier transform over the ring of
the octave is the power. What both means took of a wave is divided out.

Politis and Romano (1995), J. Time Ser. Anal. 16, 67, doi:10.1111/j.1467-9892.1995.tb00223.x.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from planish.core.area import halved_values
from planish.core.typing import Array, Bools, Complexes, Floats, Pair
from planish.texture.spectra import lags_within, padded_shape, padded_spectrum

LEAST_PIXELS = 4.0
"""Pixels of the shortest wave: shorter ones are no waves on a grid."""

SIDE_SHARE = 0.2
"""Longest wave over the shorter side of a field: of longer ones it has too few."""

_WAVE_PIXELS = 16  # of the shortest wave of an octave, at least, where pixels were joined
_HALVED = 1.5  # wave that the mean over the surroundings halves, over the octave's longest
_REACH = 2.5  # longest lag over the octave's longest wave, which is a fifth of the field or less
Levels = list[NDArray[np.float32]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OctavePower:
    """Power of maps (m,) in one octave, and of each with each.

    ``power`` (m, m) is that of waves that run towards larger x, twice. What map j shows of a wave
    of map i is ``power[i, j] / power[i, i]``.
    """

    low_um: float
    high_um: float
    power: Complexes
    coherence: Floats  # (m, m), squared: of all rings of the octave alike
    degrees: Floats  # of freedom of the power of each map, (m,)
    modes: float  # independent complex waves


def octaves_of(is_valid: Bools, pixel_um: Pair) -> list[Pair]:
    """Octaves that a field shows, from the longest on: shortest and longest wave, um.

    They divide 1 mm by powers of 2, so that fields with any pixel have the same ones: waves of four
    pixels or more, up to a fifth of the shorter side of what is valid. Empty where nothing is.
    """
    sides_um: list[float] = []
    for axis in (1, 0):
        valid_index = np.flatnonzero(is_valid.any(axis=axis))
        if not valid_index.size:
            return []
        n_pixels = np.ptp(valid_index) + 1
        sides_um.append(n_pixels * pixel_um[1 - axis])
    # Powers of 2 of 1 mm; a wave that is one but for rounding counts.
    longest_mm = SIDE_SHARE * min(sides_um) / 1000.0
    longest = math.floor(math.log2(longest_mm) + 1e-9)
    shortest_mm = LEAST_PIXELS * max(pixel_um) / 1000.0
    shortest = math.ceil(math.log2(shortest_mm) - 1e-9)
    longest_um = [1000.0 * 2.0**k for k in range(longest, shortest, -1)]
    return [(um / 2, um) for um in longest_um]


class OctaveField:
    """The pixels of a grid that count, and what each octave needs of them, for any number of maps.

    ``octaves`` are those of :func:`octaves_of`, the longest first.
    """

    def __init__(self, is_valid: Bools, pixel_um: Pair) -> None:
        """Build the pyramid of shares of known pixels, and the window of each octave."""
        self.is_valid = is_valid
        self.pixel_um = pixel_um
        self.octaves = octaves_of(is_valid, pixel_um)
        self._shares: Levels = [is_valid.astype(np.float32)]
        while min(self._shares[-1].shape) > 1:
            self._shares.append(halved_values(self._shares[-1]))
        self._windows: list[_OctaveWindow] = []
        for octave in self.octaves:
            # The level whose pixels are as large as the shortest wave allows.
            ratio = octave[0] / (_WAVE_PIXELS * max(pixel_um))
            step = max(math.floor(math.log2(ratio) + 1e-9), 0)
            is_known = self._shares[step] >= 0.5
            self._windows.append(_OctaveWindow(is_known, pixel_um, step, octave))

    def powers(self, maps: Sequence[Array], *, rows: Sequence[bool] = ()) -> list[OctavePower]:
        """Power in each octave of maps (rows, cols) that have values where the field counts.

        ``rows``: which of them are half the difference of odd and even rows, each filled between
        its rows. It holds the noise of single pixels, less what the filling took of each wave.
        """
        pyramids = [self._filled(values) for values in maps]
        n_others = len(maps) - len(rows)
        is_of_rows = [*rows, *[False] * n_others]
        return [window.power(pyramids, is_of_rows) for window in self._windows]

    def band_maps(self, values: Array) -> list[Array]:
        """A map (rows, cols) with the waves of each octave alone; NaN where the field has none.

        Missing pixels are filled from those around them, and borders are mirrors.
        """
        waves = fft.dctn(self._filled(values)[0], norm="ortho")
        height_um, width_um = np.multiply(values.shape, self.pixel_um)
        down, across = (np.arange(n) for n in values.shape)
        # The term k of a cosine transform has k half waves in the field.
        frequency = np.hypot(down[:, None] / height_um, across / width_um) / 2
        maps: list[Array] = []
        for low_um, high_um in self.octaves:
            is_in_octave = (frequency >= 1 / high_um) & (frequency < 1 / low_um)
            octave_waves = np.where(is_in_octave, waves, 0.0)
            band = np.where(self.is_valid, fft.idctn(octave_waves, norm="ortho"), np.nan)
            maps.append(band.astype(np.float32))
        return maps

    def _filled(self, values: Array) -> Levels:
        """Means of a map at each level, 0 in all; what is missing is filled from the next one.

        The first level is the map itself, less its mean; the last has one row or one column.
        """
        mean = values[self.is_valid].mean(dtype=np.float64)
        first = np.where(self.is_valid, values - mean, 0.0)
        levels = [first.astype(np.float32)]
        for share, coarse_share in pairwise(self._shares):
            total = halved_values(levels[-1] * share)
            coarse = np.divide(total, coarse_share, out=total, where=coarse_share > 0)
            levels.append(coarse)
        for step in reversed(range(len(levels) - 1)):
            rows, cols = np.nonzero(self._shares[step] < 0.5)
            if rows.size:
                # Where the middles of the pixels lie on the next level, whose pixels hold two each.
                places = (rows / 2 - 0.25, cols / 2 - 0.25)
                coarse = levels[step + 1]
                filling = ndimage.map_coordinates(coarse, places, order=1, mode="nearest")
                levels[step][rows, cols] = filling
        return levels


class OctaveFields:
    """The last fields that were asked for: maps that count on the same pixels share one."""

    def __init__(self) -> None:
        self._fields: list[OctaveField] = []

    def on(self, is_valid: Bools, pixel_um: Pair) -> OctaveField:
        """The field of some pixels."""
        for field in self._fields:
            if field.pixel_um == pixel_um and np.array_equal(field.is_valid, is_valid):
                return field
        field = OctaveField(is_valid, pixel_um)
        self._fields = [*self._fields[-1:], field]
        return field


class _OctaveWindow:
    """What one octave needs of a field at its level of the pyramid."""

    def __init__(self, is_known: Bools, pixel_um: Pair, step: int, octave: Pair) -> None:
        """Weigh the pixels that are known by how much of their surroundings is.

        ``pixel_um`` is that of the first level, ``step`` the number of the octave's own,
        ``is_known`` its mask, and ``octave`` the shortest and the longest wave, um. Lags,
        frequencies and widths of means are those of the octave's own pixels, along y and x.
        """
        self.step = step
        self._low_um, self._high_um = octave
        self._first_pixel_um = pixel_um
        row_um, col_um = pixel_um
        self._pixel_um = (row_um * 2**step, col_um * 2**step)
        self._pixel_um2 = math.prod(self._pixel_um)
        self._widths: list[int] = []
        self._reach: list[int] = []
        self._frequencies: list[Floats] = []
        for pixel, count in zip(self._pixel_um, is_known.shape, strict=True):
            # Twice a mean over n pixels halves a wave of n / 0.443 pixels.
            width = 0.443 * _HALVED * self._high_um / pixel
            self._widths.append(2 * round(width / 2) + 1)
            reach = min(int(_REACH * self._high_um / pixel), count - 1)
            self._reach.append(reach)
            # Of twice as many lags as there are, which sets frequencies half as far apart.
            n_frequencies = fft.next_fast_len(4 * reach + 1)
            self._frequencies.append(fft.fftfreq(n_frequencies, pixel))
        self._shape = padded_shape(is_known.shape, self._reach)
        share = self._mean_around(is_known.astype(np.float32), mode="constant")
        self._weight = np.where(is_known, share * share, np.float32(0.0))
        squares = np.square(self._weight, dtype=np.float64)
        # As many pixels of one weight would give a power that scatters as much.
        pixels = squares.sum() ** 2 / np.square(squares).sum()
        self._area_um2 = pixels * self._pixel_um2
        self._lag_window = self._window_of_lags()

    def power(self, pyramids: Sequence[Levels], is_of_rows: Sequence[bool]) -> OctavePower:
        """Power in the octave of maps, by their means at each level.

        ``is_of_rows`` says of each map whether it is half a difference of rows. The power is summed
        over the waves of the octave that run to one side, which stand for both.
        """
        maps = [levels[self.step] for levels in pyramids]
        details = [self._weight * (m - self._mean_around(m)) for m in maps]
        spectra = [padded_spectrum(detail, self._shape) for detail in details]
        along_y, along_x = self._frequencies
        frequency = np.hypot(along_y[:, None], along_x)
        cell_per_um2 = along_y[1] * along_x[1]
        step_per_um = math.sqrt(cell_per_um2)
        # Share of each cell of frequency that lies in the ring of the octave.
        above_low = (frequency - 1 / self._high_um) / step_per_um
        below_high = (1 / self._low_um - frequency) / step_per_um
        ring = np.clip(above_low + 0.5, 0.0, 1.0) * np.clip(below_high + 0.5, 0.0, 1.0)
        # Of two waves that run in opposite directions one is taken, and counts twice.
        is_first_half = (along_x == 0) & (along_y[:, None] > 0)
        is_forward = (along_x > 0) | is_first_half
        waves = np.nonzero(is_forward & (ring > 0))
        cells = 2.0 * cell_per_um2 * ring[waves]
        passed = self._passed(waves)
        passed_rows = self._passed_rows(waves)
        losses = [passed_rows if of_rows else np.ones(cells.size) for of_rows in is_of_rows]
        # Of each map with each in every wave, (m, m, waves).
        densities = np.empty((len(maps), len(maps), cells.size), dtype=np.complex128)
        for i, j in combinations_with_replacement(range(len(maps)), 2):
            density = self._density(spectra[j], spectra[i])[waves] / passed
            densities[j, i] = density / np.sqrt(losses[i] * losses[j])
            densities[i, j] = densities[j, i].conj()
        power = densities @ cells
        auto_power = power.diagonal().real
        # The scatter of the densities themselves adds to the mean of their squares.
        auto_densities = np.einsum("iik->ik", densities).real
        excess = 1.0 + self._window_um2 / self._area_um2
        squares = np.square(auto_densities) @ cells / excess
        degrees = self._area_um2 * np.square(auto_power) / np.maximum(squares, 1e-300)
        radius = np.rint(frequency[waves] / (2.0 * step_per_um))
        return OctavePower(
            low_um=self._low_um,
            high_um=self._high_um,
            power=power,
            coherence=_coherence(densities, cells, radius.astype(np.intp)),
            degrees=degrees,
            modes=0.5 * cells.sum() * self._area_um2,
        )

    def _window_of_lags(self) -> Floats:
        """Window over lags, over the weights of the pairs at each.

        It is 1 up to half of the reach and falls to 0 as a squared cosine; 0 where pairs are few.
        """
        down, across = (np.arange(-reach, reach + 1) for reach in self._reach)
        row_um, col_um = self._pixel_um
        distance_um = np.hypot(down[:, None] * row_um, across * col_um)
        distance = distance_um / (_REACH * self._high_um)
        fall = np.clip(2.0 * distance - 1.0, 0.0, 1.0)
        window = np.cos(0.5 * math.pi * fall) ** 2
        spectrum = padded_spectrum(self._weight, self._shape)
        pairs = lags_within(np.abs(spectrum) ** 2, self._shape, self._reach)
        window[pairs < 1e-3 * pairs.max()] = 0.0
        self._window_um2 = np.square(window).sum() * self._pixel_um2
        return np.divide(window, pairs, out=window, where=window > 0)

    def _density(self, first: Complexes, second: Complexes) -> Complexes:
        """Spectral density of the second map on the first, on the frequencies of the octave."""
        products = lags_within(np.conj(first) * second, self._shape, self._reach)
        covariance = products * self._lag_window
        rows, cols = covariance.shape
        padded = np.zeros([f.size for f in self._frequencies])
        padded[:rows, :cols] = covariance
        # Lag 0 comes first.
        padded = np.roll(padded, np.negative(self._reach), (0, 1))
        return fft.fft2(padded) * self._pixel_um2

    def _passed(self, waves: tuple[Array, ...]) -> Floats:
        """Share of the power of waves that the means leave."""
        around = np.ones(waves[0].size)
        within = np.ones(waves[0].size)
        for axis, place in enumerate(waves):
            frequency = self._frequencies[axis][place]
            within *= _mean_of_wave(frequency * self._first_pixel_um[axis], 2**self.step)
            around *= _mean_of_wave(frequency * self._pixel_um[axis], self._widths[axis])
        return np.square((1.0 - np.square(around)) * within)

    def _passed_rows(self, waves: tuple[Array, ...]) -> Floats:
        """Share of the noise's power that half the difference of odd and even rows holds."""
        turns = self._frequencies[0][waves[0]] * self._first_pixel_um[0]
        return np.cos(math.pi * turns) ** 4

    def _mean_around(
        self, values: NDArray[np.float32], mode: Literal["nearest", "constant"] = "nearest"
    ) -> Array:
        """Twice a mean over the surroundings of each pixel."""
        once = ndimage.uniform_filter(values, self._widths, mode=mode)
        return ndimage.uniform_filter(once, self._widths, mode=mode)


def _coherence(densities: Complexes, cells: Floats, radius: Array) -> Floats:
    """Squared coherence (m, m) of maps in an octave where every ring of frequency counts alike.

    ``densities`` (m, m, waves) of maps with each other, ``cells`` the area of frequency that each
    wave stands for, ``radius`` the number of its ring. NaN of a map without power of its own.
    """
    auto_densities = np.einsum("iik->ik", densities).real
    ring_power = np.stack([np.bincount(radius, cells * row) for row in auto_densities])
    ring_power /= np.maximum(np.bincount(radius, cells), 1e-300)
    floor = 1e-4 * ring_power.max(axis=1, keepdims=True)
    level = np.maximum(ring_power, np.maximum(floor, 1e-300))[:, radius]
    levels = np.sqrt(level[:, None] * level[None, :])
    whitened = (densities / levels) @ cells
    whitened /= cells.sum()
    power = np.real(np.diag(whitened)).copy()  # of 1, less what is next to nothing
    power[power < 0.02] = math.nan
    return np.abs(whitened) ** 2 / np.outer(power, power)


def _mean_of_wave(turns: Floats, count: int) -> Floats:
    """What a mean over ``count`` pixels leaves of a wave that turns so often a pixel."""
    angle = math.pi * turns
    below = count * np.sin(angle)
    is_slow = np.abs(below) < 1e-9
    # Where it hardly turns, all of it.
    return np.divide(np.sin(count * angle), below, out=np.ones_like(turns), where=~is_slow)
