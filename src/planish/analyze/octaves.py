"""How much two maps have in common at each wavelength.

Coherence, phase and transfer gain, ring by ring.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import valid_pixels
from planish.core.errors import CannotMeasure
from planish.core.facts import NULL, DescribedModel, Unsaved, Value
from planish.core.grid import shorter_side_um
from planish.core.typing import Array, Bools, Complexes, Entries, Floats, Ints, Pair, Pixel, Shape
from planish.texture.detrend import without_trend
from planish.texture.spectra import frequencies_of


class Band(DescribedModel):
    """What two maps have in common in one octave of wavelengths."""

    shortest_um: float
    """Shortest wavelength of the octave."""
    longest_um: float
    """Longest wavelength of the octave."""
    coherence: Value
    """Squared, corrected for chance; a little below 0 where there is nothing."""
    p: Unsaved = NULL
    """Of the test that there is nothing in common."""
    p_of_bands: Value
    """p of all octaves together, after Sidak."""
    phase_deg: Value
    """Phase of b against a; 0 or 180 where one simply follows the other."""
    gain: Value
    """Change of b per change of a, with its sign."""
    modes: Value
    """Independent waves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Coherence:
    """Bands from the longest waves to the shortest ones.

    Waves closer than the resolution cannot be told apart.

    ``resolution_per_um`` is the width of the window in frequency.
    """

    bands: tuple[Band, ...]
    resolution_per_um: float


def coherence(a: Array, b: Array, *, pixel_um: Pixel, bands: int = 5) -> Coherence:
    """Squared coherence of two maps by octaves of wavelength.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols), on one grid; NaN is missing and counts as the mean
    pixel_um
        As of :func:`planish.correlate`.
    bands : int; most bands: octaves from a quarter of the shorter side down, as far as pixels reach

    Returns
    -------
    Coherence

    Raises
    ------
    CannotMeasure
        If the field holds no octave.

    Notes
    -----
    A plane and second-order surface are taken off both maps, a window falls to 0 at the edge of the
    field and around what is missing, and every ring of frequencies, one resolution wide, is
    whitened: the spectrum of paper falls steeply, and without that the longest waves of a band
    decide alone while all are counted (14-27 % of unrelated maps passed a test at 5 %). The number
    of independent waves is that of the modes, less what the window joins.

    Examples
    --------
    >>> a = np.random.default_rng(0).normal(size=(100, 120))
    >>> octaves = coherence(a, 2.0 * a, pixel_um=10.0).bands
    >>> [(round(band.coherence, 2), round(band.gain, 2)) for band in octaves[:2]]
    [(1.0, 2.0), (1.0, 2.0)]
    """
    is_valid, pixel = valid_pixels(a, b, pixel_um)
    shortest_side = shorter_side_um(is_valid.shape, pixel)
    limit_um = 0.25 * shortest_side  # of longer waves a field holds too few
    ratio = limit_um / (2 * max(pixel))  # of the longest to the shortest wave
    n_octaves = int(math.log2(max(ratio, 1e-9)))
    count = min(bands, n_octaves)
    if count < 1 or not is_valid.any():
        raise CannotMeasure(
            f"The field of {shortest_side:g} um holds no octave of waves from a quarter of it to"
            " two pixels. Give a larger map."
        )
    waves = Waves(is_valid, pixel, a, b)
    half = half_plane(is_valid.shape) & waves.stand_out
    # (2, rows, columns of rfft2), and the same over the spread of each map in its ring.
    raw = np.stack(waves.spectra)
    spread_of_rings = np.sqrt(np.maximum(waves.powers, 1e-300))
    whitened = raw / spread_of_rings[:, waves.ring]
    octaves: list[Band] = []
    for k in range(count):
        longest_um = limit_um / 2**k
        shortest_um = longest_um / 2
        in_octave = half & (waves.frequency > 1 / longest_um)
        in_octave &= waves.frequency <= 1 / shortest_um
        modes = np.count_nonzero(in_octave) / waves.joined
        common = _in_common(raw[:, in_octave], whitened[:, in_octave], modes, count)
        band = Band(shortest_um=shortest_um, longest_um=longest_um, **common)
        octaves.append(band)
    return Coherence(bands=tuple(octaves), resolution_per_um=waves.resolution)


def _in_common(raw: Complexes, whitened: Complexes, modes: float, count: int) -> dict[str, float]:
    """What waves of both maps (2, waves) have in common in one of so many bands, as its fields.

    The gain is of the waves as they are, the rest of the same waves whitened. ``modes`` of them are
    independent. NaN where a map has no power, or where fewer than 4 are.
    """
    cross = np.vdot(whitened[0], whitened[1])
    gain = np.vdot(raw[0], raw[1])
    power_a = np.vdot(raw[0], raw[0]).real
    squared_spread = math.prod(np.vdot(m, m).real for m in whitened)
    common: dict[str, float] = dict.fromkeys(("coherence", "p", "phase_deg", "gain"), math.nan)
    common["modes"] = modes
    if power_a > 0:
        common["gain"] = math.copysign(abs(gain), gain.real) / power_a
    if squared_spread > 0:
        common["phase_deg"] = -np.angle(cross, deg=True)
    if modes >= 4 and squared_spread > 0:
        share = abs(cross) ** 2 / squared_spread
        common["coherence"] = (share - 1 / modes) / (1 - 1 / modes)
        # Of m complex waves without relation the squared coherence exceeds x with the probability
        # (1 - x)^(m - 1).
        common["p"] = max(1 - share, 0.0) ** (modes - 1)
    common["p_of_bands"] = 1 - (1 - common["p"]) ** count
    return common


class Waves:
    """Spectra of maps (rows, cols) under one window, and rings of frequency.

    Each ring is one resolution of the window wide.
    """

    def __init__(self, is_valid: Bools, pixel_um: Pair, *maps: Array) -> None:
        """Transform each map over the pixels that count, and sort its waves into rings."""
        window = window_of(is_valid)
        self.spectra = [spectrum_of(m, is_valid, window) for m in maps]
        self.frequency = frequencies_of(is_valid.shape, pixel_um)
        # How many neighbouring modes the window joins to one: the field over what it leaves of it.
        share_of_modes = np.sum(window**4) / np.sum(window**2) ** 2
        self.joined = is_valid.size * share_of_modes
        side_um = shorter_side_um(is_valid.shape, pixel_um)
        self.resolution = math.sqrt(self.joined) / side_um
        rings = np.rint(self.frequency / self.resolution)
        self.ring: Ints = rings.astype(np.intp)
        ring_numbers = self.ring.ravel()
        squares = [np.abs(spectrum.ravel()) ** 2 for spectrum in self.spectra]
        powers = [np.bincount(ring_numbers, weights=square) for square in squares]
        waves_of_ring = np.maximum(np.bincount(ring_numbers), 1)
        self.powers = np.stack(powers) / waves_of_ring  # (maps, rings)

    @property
    def stand_out(self) -> Bools:
        """Rings that are, in all maps, no mere leakage of stronger ones through the window."""
        leakage = 1e-5 * self.powers.max(axis=1, keepdims=True)
        return (self.powers > leakage).all(axis=0)[self.ring]


def window_of(is_valid: Bools) -> Floats:
    """Window that is 1 inside and falls to 0 towards the edge of the field and of missing parts."""
    width = max(0.2 * min(is_valid.shape) / 2, 1.0)  # a fifth of the field (Tukey)
    padded = np.pad(is_valid, 1)
    distance = np.asarray(ndimage.distance_transform_edt(padded))
    inner = distance[1:-1, 1:-1]
    depth = np.minimum(inner / width, 1.0)  # 0 where a pixel is missing
    return np.sin(math.pi / 2 * depth) ** 2


def spectrum_of(values: Array, is_valid: Bools, window: Floats) -> Complexes:
    """Half of the Fourier transform (``rfft2``) of a windowed map without its trend and mean."""
    filled_values = np.where(is_valid, values, 0.0)
    flat = without_trend(filled_values.astype(np.float64), is_valid)
    weighted = window * flat
    mean = weighted.sum() / max(window.sum(), 1e-300)
    return np.asarray(fft.rfft2(weighted - mean * window))


def half_plane(shape: Shape) -> Bools:
    """One of each two modes that a real map has twice, in half of a Fourier transform."""
    rows = fft.fftfreq(shape[0], 1 / shape[0])
    cols = np.arange(shape[1] // 2 + 1)
    is_inner = (cols > 0) & (2 * cols < shape[1])
    return is_inner | ((cols == 0) & (rows[:, None] > 0))


def answer_octaves(pair: ComparedMaps) -> Entries:
    """Coherence by octaves of wavelength."""
    octaves = coherence(pair.x, pair.y, pixel_um=pair.cell_um)
    return {"bands": octaves.bands, "resolution_per_um": octaves.resolution_per_um}
