"""Fourier ring correlation of two measurements of one quantity.

Down to which wavelength they show the same.
"""

import math
from collections.abc import Sequence

import numpy as np

from planish.analyze.correlation import check_varying, valid_pixels
from planish.analyze.octaves import Waves, half_plane
from planish.core.errors import CannotMeasure
from planish.core.facts import DescribedModel
from planish.core.typing import Array, Floats, Pixel


class Ring(DescribedModel):
    """How far two measurements of one quantity agree in waves of one length."""

    wavelength_um: float
    """Middle of the ring."""
    correlation: float
    """Of the waves of the ring."""
    threshold: float
    """Correlation at which the mean of both holds half a bit a wave."""
    modes: float
    """Independent waves."""


class RingCorrelation(DescribedModel):
    """Rings of waves, and the wavelength where their correlation first falls below the threshold.

    No wavelength where it never does, or where it is below from the longest waves on: the sentence
    says which.
    """

    rings: tuple[Ring, ...] = ()
    """From the longest waves to the shortest."""
    resolution_um: float | None = None
    """Shortest wave that both show."""
    sentence: str | None = None
    """The same in words."""


def ring_correlation(a: Array, b: Array, *, pixel_um: Pixel) -> RingCorrelation:
    """Correlate two measurements of one quantity ring by ring of frequency.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
        On one grid, with errors of their own: errors that both share count as what they show. NaN
        is missing.
    pixel_um
        As of :func:`planish.correlate`.

    Returns
    -------
    RingCorrelation

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If a map is constant, or the field holds fewer than 3 rings.

    Notes
    -----
    Trend, window and the width of a ring are those of :func:`planish.analyze.coherence`. The
    threshold is the half-bit curve of van Heel and Schatz (2005), equation 17, with the number of
    independent waves. Rings that are so weak that they are mostly leakage of stronger ones end the
    curve. With ripple of the curve the first crossing may come early.

    References
    ----------
    van Heel and Schatz (2005), J. Struct. Biol. 151, 250, doi:10.1016/j.jsb.2005.05.009.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> a = rng.normal(size=(100, 120))
    >>> compared = ring_correlation(a, a + 0.1 * rng.normal(size=a.shape), pixel_um=10.0)
    >>> [round(ring.correlation, 2) for ring in compared.rings[:3]]
    [1.0, 1.0, 0.99]
    """
    is_valid, pixel = valid_pixels(a, b, pixel_um)
    check_varying(is_valid, a=a, b=b)
    waves = Waves(is_valid, pixel, a, b)
    # Rings that lie whole within the shorter Nyquist frequency.
    nyquist_per_um = 0.5 / max(pixel)
    last = int(nyquist_per_um / waves.resolution - 0.5)
    if last < 3:
        raise CannotMeasure(
            f"The field holds {last} rings of frequency, 3 are needed. Give a larger map."
        )
    inside = half_plane(is_valid.shape)
    inside &= (waves.ring >= 1) & (waves.ring <= last)
    ring_numbers = waves.ring[inside]

    def sums(values: Array) -> Floats:
        """Sum values of single waves in each ring, from the first to the last."""
        totals = np.bincount(ring_numbers, weights=values[inside], minlength=last + 1)
        return totals[1:].astype(np.float64)

    count = sums(np.ones(inside.shape))
    spectrum_a, spectrum_b = waves.spectra
    power_a = sums(np.abs(spectrum_a) ** 2)
    power_b = sums(np.abs(spectrum_b) ** 2)
    spread = np.sqrt(power_a * power_b)
    cross = sums((np.conj(spectrum_a) * spectrum_b).real)
    correlation = cross / np.maximum(spread, 1e-300)
    n_strong_waves = sums(waves.stand_out.astype(np.float64))
    weak = np.flatnonzero(n_strong_waves < count)
    # By the mean frequency of the waves in a ring.
    wavelengths_um = count / sums(waves.frequency)
    modes = count / waves.joined
    columns = np.stack([wavelengths_um, correlation, modes], axis=1)
    n_strong = weak[0] if weak.size else last
    rings: list[Ring] = []
    for um, r, n in columns[:n_strong].tolist():
        ring = Ring(wavelength_um=um, correlation=r, threshold=half_bit(n), modes=n)
        rings.append(ring)
    resolution_um, sentence = _resolved(rings, leaking=bool(weak.size))
    return RingCorrelation(rings=tuple(rings), resolution_um=resolution_um, sentence=sentence)


def half_bit(modes: float) -> float:
    """Correlation of two halves whose mean holds half a bit a wave (van Heel and Schatz 2005).

    The bit is one of information.

    Examples
    --------
    >>> [round(half_bit(modes), 2) for modes in (10.0, 100.0, 1000.0)]
    [0.54, 0.31, 0.22]
    """
    # (sqrt(2) - 1) / 2 is the ratio of signal to noise power, of one measurement, that gives the
    # mean half a bit.
    ratio = (math.sqrt(2) - 1) / 2
    cross = 2 * math.sqrt(ratio)
    root = math.sqrt(max(modes, 1.0))
    return (ratio + (cross + 1) / root) / (1 + ratio + cross / root)


def _resolved(rings: Sequence[Ring], *, leaking: bool) -> tuple[float | None, str]:
    """Wavelength down to which the rings agree, None if they do not say, and the same in words.

    It lies between the last ring above its threshold and the first one below, where the line
    between both excesses over frequency is 0. ``leaking``: the rings end where shorter waves are
    mere leakage of longer ones, not at the pixel.
    """
    excesses = [ring.correlation - ring.threshold for ring in rings]
    first_below = next((k for k, v in enumerate(excesses) if v < 0), None)
    if first_below is None:
        why = "the pixels end there"
        if leaking:
            why = "shorter waves are too weak to be distinguished from leakage"
        shortest = f"{rings[-1].wavelength_um:.3g} um" if rings else "the longest waves"
        return None, f"Both show the same down to {shortest}; {why}. No resolution."
    if first_below == 0:
        longest_um = rings[0].wavelength_um
        return None, f"Not even the longest waves ({longest_um:.3g} um) agree. No resolution."
    pair = slice(first_below - 1, first_below + 1)
    above, below = excesses[pair]
    frequency_above, frequency_below = (1 / ring.wavelength_um for ring in rings[pair])
    share = above / (above - below)
    frequency = frequency_above + share * (frequency_below - frequency_above)
    resolution_um = 1 / frequency
    return resolution_um, f"Both show the same down to waves of {resolution_um:.3g} um (half bit)."
