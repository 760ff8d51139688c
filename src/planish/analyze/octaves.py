"""How much two maps have in common at each wavelength: coherence, phase and transfer gain, ring by ring."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import fft, ndimage

from planish.analyze.correlation import on_one_grid, valid_in_both
from planish.analyze.detrend import without_trend
from planish.core.errors import CannotMeasure
from planish.core.facts import NULL, ResultModel, Unsaved, Value
from planish.core.typing import Bools, Floats

if TYPE_CHECKING:
    from planish.analyze.diagnostics import ComparedMaps


_BANDS = 5
_EDGE = 0.2  # of the field, over which the window falls to 0 (Tukey)
_LEAST_MODES = 4.0
_LEAST_POWER = 1e-5  # of the strongest ring: what is weaker is what the window lets through of others
_LONGEST = 0.25  # of the shorter side: of longer waves a field holds too few


class Band(ResultModel):
    """What two maps have in common in one octave of wavelengths."""

    shortest_um: float = Field(description="Shortest wavelength of the octave.")
    longest_um: float = Field(description="Longest wavelength of the octave.")
    coherence: Value = Field(description="Squared, put right for chance; a little below 0 where there is nothing.")
    p: Unsaved = Field(default=NULL, exclude=True, description="Of the test that there is nothing in common.")
    p_of_bands: Value = Field(description="p of all octaves together, after Sidak.")
    phase_deg: Value = Field(description="Phase of b against a; 0 or 180 where one simply follows the other.")
    gain: Value = Field(description="Change of b per change of a, with its sign.")
    modes: Value = Field(description="Independent waves.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Coherence:
    """Bands from the longest waves to the shortest ones; waves closer than the resolution cannot be told apart.

    ``resolution_per_um`` is the width of the window in frequency.
    """

    bands: tuple[Band, ...]
    resolution_per_um: float


def coherence(
    a: NDArray[Any], b: NDArray[Any], *, mask: Bools | None = None, pixel_um: float | tuple[float, float],
    bands: int = _BANDS,
) -> Coherence:  # fmt: skip
    """Squared coherence of two maps by octaves of wavelength.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
        On one grid; NaN is missing and counts as the mean.
    mask : ndarray of bool, shape (rows, cols), optional
    pixel_um : float or (float, float)
        Along y and x.
    bands : int
        Most bands: octaves from a quarter of the shorter side down, as far as pixels reach.

    Returns
    -------
    Coherence

    Raises
    ------
    CannotMeasure
        If the field holds no octave.

    Notes
    -----
    A plane and second-order surface are taken off both maps, a window falls to 0 at the edge of the field and around
    what is missing, and every ring of frequencies, one resolution wide, is whitened: the spectrum of paper falls
    steeply, and without that the longest waves of a band decide alone while all are counted (14-27 % of unrelated maps
    passed a test at 5 %). The number of independent waves is that of the modes, less what the window joins.
    """
    pixel = on_one_grid(a, b, mask, pixel_um)
    is_valid = valid_in_both(a, b, mask)
    shortest_side = min(n * p for n, p in zip(is_valid.shape, pixel, strict=True))
    longest = _LONGEST * shortest_side
    count = min(bands, int(math.log2(max(longest / (2 * max(pixel)), 1e-9)))) if is_valid.any() else 0
    if count < 1:
        raise CannotMeasure(
            f"The field of {shortest_side:g} um holds no octave of waves from a quarter of it to two pixels. Give a "
            "larger map."
        )
    window = window_of(is_valid)
    power = float(np.sum(window**2))
    wave_a, wave_b = (spectrum_of(m, is_valid, window) for m in (a, b))
    frequency = frequencies(is_valid.shape, pixel)
    # Width of the window in frequency: one over the field it leaves.
    joined = is_valid.size * float(np.sum(window**4)) / power**2
    resolution = math.sqrt(joined) / shortest_side
    ring = np.rint(frequency / resolution).astype(np.intp)
    white = [_whitened(m, ring) for m in (wave_a, wave_b)]
    half = half_plane(is_valid.shape) & np.logical_and.reduce([stands_out(m, ring) for m in (wave_a, wave_b)])
    edges = [longest / 2**k for k in range(count + 1)]
    octaves = [
        _band(wave_a, wave_b, white, half & (frequency > 1 / high) & (frequency <= 1 / low), joined, (low, high), count)
        for high, low in pairwise(edges)
    ]
    return Coherence(bands=tuple(octaves), resolution_per_um=resolution)


def _band(
    wave_a: NDArray[Any], wave_b: NDArray[Any], white: list[NDArray[Any]], inside: Bools, joined: float,
    limits: tuple[float, float], count: int,
) -> Band:  # fmt: skip
    modes = float(np.count_nonzero(inside)) / joined
    x, y = (m[inside] for m in white)
    cross = complex(np.vdot(x, y))
    spread = math.sqrt(float(np.vdot(x, x).real) * float(np.vdot(y, y).real))
    share = abs(cross) ** 2 / spread**2 if spread > 0 else math.nan
    whole = float(np.vdot(wave_a[inside], wave_a[inside]).real)
    gain = complex(np.vdot(wave_a[inside], wave_b[inside]))
    enough = modes >= _LEAST_MODES and not math.isnan(share)
    # Of m complex waves without relation the squared coherence exceeds x with the probability (1 - x)^(m - 1).
    p = float((1 - share) ** (modes - 1)) if enough else math.nan
    right = (share - 1 / modes) / (1 - 1 / modes) if enough else math.nan
    return Band(
        shortest_um=limits[0], longest_um=limits[1], coherence=right, p=p, p_of_bands=1 - (1 - p) ** count,
        phase_deg=-math.degrees(math.atan2(cross.imag, cross.real)) if spread > 0 else math.nan,
        gain=math.copysign(abs(gain), gain.real) / whole if whole > 0 else math.nan, modes=modes,
    )  # fmt: skip


def window_of(is_valid: Bools) -> Floats:
    """A window that is 1 inside and falls to 0 towards the edge of the field and of what is missing."""
    width = max(_EDGE * min(is_valid.shape) / 2, 1.0)
    padded = np.pad(is_valid, 1)
    distance = np.asarray(ndimage.distance_transform_edt(padded))[1:-1, 1:-1]
    return np.where(is_valid, np.sin(math.pi / 2 * np.minimum(distance / width, 1.0)) ** 2, 0.0)


def spectrum_of(values: NDArray[Any], is_valid: Bools, window: Floats) -> NDArray[np.complex128]:
    """Half of the Fourier transform (``rfft2``) of a map without its trend and mean under a window."""
    flat = without_trend(np.where(is_valid, values, 0.0).astype(np.float64), is_valid)
    weighted = window * flat
    mean = weighted.sum() / max(window.sum(), 1e-300)
    return np.asarray(fft.rfft2(weighted - mean * window))


def _whitened(values: NDArray[np.complex128], ring: NDArray[np.intp]) -> NDArray[np.complex128]:
    power = np.bincount(ring.ravel(), weights=np.abs(values.ravel()) ** 2) / np.maximum(np.bincount(ring.ravel()), 1)
    return values / np.sqrt(np.maximum(power, 1e-300))[ring]


def stands_out(values: NDArray[np.complex128], ring: NDArray[np.intp]) -> Bools:
    """Rings that are no mere leakage of stronger ones through the window."""
    power = np.bincount(ring.ravel(), weights=np.abs(values.ravel()) ** 2) / np.maximum(np.bincount(ring.ravel()), 1)
    return (power > _LEAST_POWER * power.max())[ring]


def half_plane(shape: tuple[int, ...]) -> Bools:
    """One of each two modes that a real map has twice, in half of a Fourier transform."""
    rows, cols = fft.fftfreq(shape[0], 1 / shape[0]), np.arange(shape[1] // 2 + 1)
    inner = (cols > 0) & (2 * cols < shape[1])
    return inner[None, :] | ((cols[None, :] == 0) & (rows[:, None] > 0))


def frequencies(shape: tuple[int, ...], pixel_um: tuple[float, float]) -> Floats:
    """Length of the frequency of each mode of half of a Fourier transform, in waves a um."""
    return np.hypot(fft.fftfreq(shape[0], pixel_um[0])[:, None], fft.rfftfreq(shape[1], pixel_um[1]))


def answer_octaves(pair: ComparedMaps) -> dict[str, Any]:
    """Coherence by octaves of wavelength."""
    waves = coherence(pair.x, pair.y, pixel_um=pair.cell_um)
    return {"bands": waves.bands, "resolution_per_um": waves.resolution_per_um}
