"""Random fields on the sheet's grid: smooth noise, low-pass filters, fibres."""

from __future__ import annotations

import numpy as np
from scipy import fft

from planish.core.typing import Floats
from planish.synthetic import _kernels

PITCH_UM = 3.0  # of the sheet's grid
_FIBRE_UM = ((1000.0, 2500.0), (20.0, 35.0))  # length, width of softwood and hardwood fibres together


def noise(shape: tuple[int, int], correlation_um: float, rng: np.random.Generator) -> Floats:
    """Gaussian random field (rows, cols), mean 0 and standard deviation 1.

    Its autocorrelation is ``exp(-(r / correlation_um)^2)``.
    """
    return _unit(_filtered(rng.standard_normal(_padded(shape)), 0.5 * correlation_um)[: shape[0], : shape[1]])


def lowpass(field: Floats, half_um: float) -> Floats:
    """Gaussian filter that halves a wave of length ``half_um``; the field is mirrored at its borders."""
    sigma = half_um * float(np.sqrt(np.log(2.0) / 2)) / np.pi
    pad = min(int(4 * sigma / PITCH_UM) + 1, min(field.shape) - 1)
    wide = np.pad(field, pad, mode="reflect")
    done = _filtered(wide, sigma)
    return done[pad : pad + field.shape[0], pad : pad + field.shape[1]]


def streaks(shape: tuple[int, int], correlation_um: float, rng: np.random.Generator) -> Floats:
    """Random field that does not change along the machine direction (the columns' axis u)."""
    profile = noise((shape[0], 8), correlation_um, rng)[:, :1]
    return np.broadcast_to(_unit(profile), shape).copy()


def fibres(shape: tuple[int, int], per_mm2: float, anisotropy: float, rng: np.random.Generator) -> Floats:
    """Height of fibres laid at random, 0 to 1, where crossing ones do not add up.

    ``anisotropy`` is the number of fibres along u over those across; angles follow von Mises' distribution.
    """
    count = max(int(per_mm2 * shape[0] * shape[1] * PITCH_UM**2 * 1e-6), 8)
    (short, long), (thin, wide) = _FIBRE_UM
    field = np.zeros(shape)
    margin = 0.5 * long / PITCH_UM
    starts = rng.uniform(-margin, [shape[1] + margin, shape[0] + margin], (count, 2))
    angles = rng.vonmises(0.0, 0.5 * np.log(anisotropy), count) / 2 + rng.integers(0, 2, count) * np.pi
    lengths = rng.uniform(short, long, count) / PITCH_UM
    widths = rng.uniform(thin, wide, count) / PITCH_UM
    curls = rng.normal(0, 4e-4, count) * PITCH_UM
    # The angle is that of a fibre's middle: half of the curl lies before it.
    _kernels.lay_fibres(field, starts, angles - 0.5 * curls * lengths, lengths, widths, curls, 1.0)
    return field


def fibrous(shape: tuple[int, int], anisotropy: float, rng: np.random.Generator, *, per_mm2: float = 29.0) -> Floats:
    """Random field at fibre scale, mean 0 and standard deviation 1: fibres and the net between them."""
    return _unit(3.0 * fibres(shape, per_mm2, anisotropy, rng) + noise(shape, 35.0, rng))


def _unit(field: Floats) -> Floats:
    field = field - field.mean()
    return field / field.std()


def _padded(shape: tuple[int, int]) -> tuple[int, int]:
    return (fft.next_fast_len(shape[0], True), fft.next_fast_len(shape[1], True))


def _filtered(field: Floats, sigma_um: float) -> Floats:
    """Gaussian filter of a periodic field."""
    shape = _padded((field.shape[0], field.shape[1]))
    wide = np.pad(field, ((0, shape[0] - field.shape[0]), (0, shape[1] - field.shape[1])), mode="wrap")
    fy = np.exp(-2 * (np.pi * sigma_um * fft.fftfreq(shape[0], PITCH_UM)) ** 2)[:, None]
    fx = np.exp(-2 * (np.pi * sigma_um * fft.rfftfreq(shape[1], PITCH_UM)) ** 2)[None, :]
    return fft.irfft2(fft.rfft2(wide) * fy * fx, shape)[: field.shape[0], : field.shape[1]]
