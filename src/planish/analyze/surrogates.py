"""Maps with the texture of a map but unrelated to anything, and how far texture reaches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.signal import windows

from planish.analyze.ncc import MaskedNcc

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_TAPER = 0.4  # of the map, both borders together


def phase_randomised(values: Array, valid: Mask, rng: np.random.Generator) -> Array:
    """Return a map with the power spectrum of a map and random phases.

    Parameters
    ----------
    values : ndarray, shape (rows, cols)
        A map without trend.
    valid : ndarray of bool, shape (rows, cols)
        Where it is known; elsewhere its mean is taken.
    rng : Generator

    Returns
    -------
    ndarray, shape (rows, cols)
        Known everywhere, mean 0. Its variance is smaller: what was missing, and the borders, count as 0.

    References
    ----------
    Theiler et al. (1992), Physica D 58, 77, doi:10.1016/0167-2789(92)90102-S.
    """
    mean = float(values[valid].mean()) if valid.any() else 0.0
    # A map that is cut off at its borders is not periodic; without a taper the jump there whitens the spectrum, and the
    # null becomes too narrow.
    taper = np.multiply.outer(*(windows.tukey(n, _TAPER) for n in values.shape))
    amplitude = np.abs(np.asarray(fft.rfft2(np.where(valid, values - mean, 0.0) * taper)))
    # The spectrum of white noise has the symmetry of a real map's.
    phase = np.asarray(fft.rfft2(rng.standard_normal(values.shape)))
    phase /= np.maximum(np.abs(phase), 1e-300)
    return np.asarray(fft.irfft2(amplitude * phase, values.shape), dtype=np.float64)


def without_plane(values: Array, valid: Mask) -> Array:
    """Take the plane of least squares off a map, shape (rows, cols); 0 where it is not known."""
    rows, cols = np.nonzero(valid)
    if rows.size < 3:
        return np.zeros(values.shape)
    design = np.stack([np.ones(rows.size), rows - rows.mean(), cols - cols.mean()], axis=1)
    known = values[valid]
    out = np.zeros(values.shape)
    out[valid] = known - design @ np.linalg.lstsq(design, known, rcond=None)[0]
    return out


def in_band(
    values: Array, valid: Mask, pixel_um: tuple[float, float], band_um: tuple[float | None, float | None]
) -> Array:
    """Keep wavelengths from ``band_um[0]`` to ``band_um[1]`` of a map, where both limits are halved.

    Parameters
    ----------
    values, valid : ndarray, shape (rows, cols)
    pixel_um : (float, float)
        Along rows' axis (y) and columns' axis (x).
    band_um : (float or None, float or None)
        None leaves that side open. The filters are Gaussian; missing pixels have no weight in them.
    """
    short, long = band_um
    out = np.where(valid, values, 0.0)
    if short is not None:
        out = np.where(valid, _low(out, valid, pixel_um, short), 0.0)
    if long is not None:
        out = np.where(valid, out - _low(out, valid, pixel_um, long), 0.0)
    return out


def _low(values: Array, valid: Mask, pixel_um: tuple[float, float], half_um: float) -> Array:
    sigma = [half_um * float(np.sqrt(np.log(2.0) / 2)) / np.pi / p for p in pixel_um]
    weight = ndimage.gaussian_filter(valid.astype(np.float64), sigma, mode="constant")
    total = ndimage.gaussian_filter(np.where(valid, values, 0.0), sigma, mode="constant")
    return np.asarray(total / np.maximum(weight, 1e-12), dtype=np.float64)


def correlation_length_um(values: Array, valid: Mask, pixel_um: tuple[float, float]) -> float:
    """Distance at which the autocorrelation of a map, averaged over directions, falls below 1/e.

    Parameters
    ----------
    values, valid : ndarray, shape (rows, cols)
    pixel_um : (float, float)
        Along y and x.

    Returns
    -------
    float, in um
        Infinite where it stays above 1/e up to a quarter of the map.
    """
    reach = (max(values.shape[0] // 4, 1), max(values.shape[1] // 4, 1))
    r = MaskedNcc(values, a_valid=valid, b_valid=valid, reach=reach)(values)
    y, x = (np.arange(-n, n + 1) * p for n, p in zip(reach, pixel_um, strict=True))
    distance = np.hypot(y[:, None], x[None, :])
    step = max(pixel_um)
    limit = min(n * p for n, p in zip(reach, pixel_um, strict=True))
    rings = np.where((distance <= limit) & np.isfinite(r), np.rint(distance / step), -1).astype(np.int64)
    count = np.bincount(rings[rings >= 0])
    mean = np.bincount(rings[rings >= 0], weights=r[rings >= 0]) / np.maximum(count, 1)
    below = np.flatnonzero((mean < np.exp(-1.0)) & (count > 0))
    if below.size == 0:
        return float("inf")
    k = int(below[0])
    if k == 0:
        return step
    return float(step * (k - 1 + (mean[k - 1] - np.exp(-1.0)) / (mean[k - 1] - mean[k])))
