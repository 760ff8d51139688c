"""Down to which wavelength two measurements of one quantity show the same: Fourier ring correlation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.analyze.correlation import on_one_grid
from planish.analyze.octaves import frequencies, half_plane, spectrum_of, stands_out, window_of
from planish.core.errors import CannotMeasure

Mask = NDArray[np.bool_]

_LEAST_RINGS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Ring:
    """Waves of one length, in all directions.

    Attributes
    ----------
    frequency_per_um, wavelength_um : float
        Mean frequency of the ring, and one over it.
    correlation : float
        Of both measurements, from -1 to 1.
    modes : float
        Independent waves: half of the plane, less what the window joins.
    threshold : float
        Correlation at which the mean of both measurements holds half a bit a wave.
    """

    frequency_per_um: float
    wavelength_um: float
    correlation: float
    modes: float
    threshold: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RingCorrelation:
    """Rings from the longest waves to the shortest ones that can be told.

    Attributes
    ----------
    rings : tuple of Ring
    resolution_um : float or None
        Wavelength at which the correlation first falls below the threshold; None where it never does, or where it is
        below from the longest waves on. ``sentence`` says which.
    sentence : str
        What may be said.
    """

    rings: tuple[Ring, ...]
    resolution_um: float | None
    sentence: str


def ring_correlation(
    a: NDArray[Any], b: NDArray[Any], *, mask: Mask | None = None, pixel_um: float | tuple[float, float]
) -> RingCorrelation:
    """Correlate two measurements of one quantity ring by ring of frequency.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
        On one grid, with errors of their own: errors that both share count as what they show. NaN is missing.
    mask : ndarray of bool, shape (rows, cols), optional
    pixel_um : float or (float, float)
        Along y and x.

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
    Trend, window and the width of a ring are those of :func:`planish.analyze.coherence`. The threshold is the half-bit
    curve of van Heel and Schatz (2005), equation 17, with the number of independent waves. Rings that are so weak that
    they are mostly leakage of stronger ones end the curve. With ripple of the curve the first crossing may come early.

    References
    ----------
    van Heel and Schatz (2005), J. Struct. Biol. 151, 250, doi:10.1016/j.jsb.2005.05.009.
    """
    pixel = on_one_grid(a, b, mask, pixel_um)
    known = np.isfinite(a) & np.isfinite(b)
    if mask is not None:
        known &= mask
    n = int(np.count_nonzero(known))
    for name, m in zip("ab", (a, b), strict=True):
        if n < 3 or not np.ptp(m[known]) > 0:
            raise CannotMeasure(f"{n} pixels are known in both maps, or map {name} is constant. Look at the masks.")
    window = window_of(known)
    one, two = (spectrum_of(m, known, window) for m in (a, b))
    frequency = frequencies(known.shape, pixel)
    joined = known.size * float(np.sum(window**4)) / float(np.sum(window**2)) ** 2
    width = math.sqrt(joined) / min(n * p for n, p in zip(known.shape, pixel, strict=True))
    number = np.rint(frequency / width).astype(np.intp)
    last = int(0.5 / max(pixel) / width - 0.5)  # rings that lie whole within the shorter Nyquist frequency
    if last < _LEAST_RINGS:
        raise CannotMeasure(f"The field holds {last} rings of frequency, {_LEAST_RINGS} are needed. Give a larger map.")
    half = half_plane(known.shape)
    strong = np.logical_and.reduce([stands_out(m, number) for m in (one, two)])
    inside = half & (number >= 1) & (number <= last)

    def sums(values: NDArray[Any]) -> NDArray[np.float64]:
        return np.bincount(number[inside], weights=values[inside], minlength=last + 1)[1:].astype(np.float64)

    count = sums(np.ones(number.shape))
    spread = np.sqrt(sums(np.abs(one) ** 2) * sums(np.abs(two) ** 2))
    correlation = sums((np.conj(one) * two).real) / np.maximum(spread, 1e-300)
    weak = np.flatnonzero(sums(strong.astype(np.float64)) < count)
    middle = sums(frequency) / count
    rings = tuple(
        Ring(
            frequency_per_um=float(middle[k]), wavelength_um=1 / float(middle[k]), correlation=float(correlation[k]),
            modes=float(count[k]) / joined, threshold=half_bit(float(count[k]) / joined),
        )
        for k in range(int(weak[0]) if weak.size else last)
    )  # fmt: skip
    return _resolved(rings, leaking=bool(weak.size))


def half_bit(modes: float) -> float:
    """Correlation of two halves whose mean holds half a bit of information a wave (van Heel and Schatz 2005)."""
    # (sqrt(2) - 1) / 2 is the ratio of signal to noise power, of one measurement, that gives the mean half a bit.
    ratio, root = (math.sqrt(2) - 1) / 2, math.sqrt(max(modes, 1.0))
    return (ratio + (2 * math.sqrt(ratio) + 1) / root) / (1 + ratio + 2 * math.sqrt(ratio) / root)


def _resolved(rings: tuple[Ring, ...], *, leaking: bool) -> RingCorrelation:
    above = [ring.correlation - ring.threshold for ring in rings]
    first = next((k for k, v in enumerate(above) if v < 0), None)
    if first is None:
        why = "shorter waves are too weak to be distinguished from leakage" if leaking else "the pixels end there"
        shortest = f"{rings[-1].wavelength_um:.3g} um" if rings else "the longest waves"
        return RingCorrelation(
            rings=rings, resolution_um=None, sentence=f"Both show the same down to {shortest}; {why}. No resolution."
        )
    if first == 0:
        return RingCorrelation(
            rings=rings, resolution_um=None,
            sentence=f"Not even the longest waves ({rings[0].wavelength_um:.3g} um) agree. No resolution.",
        )  # fmt: skip
    share = above[first - 1] / (above[first - 1] - above[first])
    f = [ring.frequency_per_um for ring in rings[first - 1 : first + 1]]
    found = 1 / (f[0] + share * (f[1] - f[0]))
    return RingCorrelation(
        rings=rings, resolution_um=found, sentence=f"Both show the same down to waves of {found:.3g} um (half bit)."
    )
