"""Maps without their white noise, for regressions.

There the noise would make an effect look smaller than it is.
"""

import numpy as np
from scipy import fft

from planish.core.typing import Array, Bools, Floats

_FLOOR = 0.8  # of the Nyquist frequency, from which on a map holds noise alone
_RINGS = 64  # of frequencies up to Nyquist's


def without_white_noise(values: Array, is_known: Bools) -> Floats:
    """Best linear estimate of a map (rows, cols) from the map with white noise on it.

    NaN where it is not known.

    The noise is that of the shortest waves. Each ring of frequencies is multiplied by the share of
    its power that is not noise (a Wiener filter). Regressed on the estimate, another quantity keeps
    its coefficient, which noise makes smaller (regression calibration; Carroll et al. 2006,
    Measurement Error in Nonlinear Models, chapter 4).
    """
    if not is_known.any():
        return np.full(values.shape, np.nan)
    mean = np.mean(values[is_known], dtype=np.float64)
    filled = np.where(is_known, values, mean).astype(np.float64)
    waves = fft.dctn(filled, norm="ortho")
    down, across = (np.arange(n) / n for n in values.shape)  # in Nyquist frequencies
    frequency = np.hypot(down[:, None], across)
    power = waves * waves
    ring = (frequency * _RINGS).astype(np.intp)
    numbers = ring.ravel()
    wave_counts = np.maximum(np.bincount(numbers), 1)
    mean_power = np.bincount(numbers, power.ravel()) / wave_counts
    noise_power = np.mean(power[frequency > _FLOOR])
    noise_share = noise_power / np.maximum(mean_power, 1e-30)
    gain = np.clip(1.0 - noise_share, 0.0, 1.0)
    gain[0] = 1.0  # the mean
    estimate = fft.idctn(waves * gain[ring], norm="ortho")
    return np.where(is_known, estimate, np.nan)
