"""Maps with the texture of a map but unrelated to anything, and how far texture reaches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from planish.analyze.ncc import MaskedNcc
from planish.core.robust import masked_gaussian

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_TAPER = 0.4  # of the map, both borders together
_LEAST = 3  # pixels that fix a plane


class Unrelated:
    """Maps with the power spectrum of a map, random phases and no trend: of its texture, but unrelated to anything.

    The map (rows, cols) is one without trend; where it is not valid, its mean is taken.

    References
    ----------
    Theiler et al. (1992), Physica D 58, 77, doi:10.1016/0167-2789(92)90102-S.
    """

    def __init__(self, values: Array, valid: Mask) -> None:
        mean = float(values[valid].mean()) if valid.any() else 0.0
        # A map that is cut off at its borders is not periodic; without a taper the jump there whitens the spectrum, and
        # the null becomes too narrow.
        taper = np.multiply.outer(*(_taper(n) for n in values.shape))
        self.amplitude = np.abs(np.asarray(fft.rfft2(np.where(valid, values - mean, 0.0) * taper)))
        self._shape = values.shape
        self._plane = Plane(valid)

    def draw(self, rng: np.random.Generator) -> Array:
        """Return the next of them, shape (rows, cols); 0 where the map is not known.

        Its variance is smaller than the map's: what was missing, and the borders, count as 0.
        """
        # The spectrum of white noise has the symmetry of a real map's.
        phase = np.asarray(fft.rfft2(rng.standard_normal(self._shape)))
        phase *= self.amplitude / np.maximum(np.abs(phase), 1e-300)
        return self._plane.taken_off(np.asarray(fft.irfft2(phase, self._shape), dtype=np.float64))


def _taper(n: int) -> Array:
    """Tapered cosine (Tukey) window, shape (n,); scipy.signal has it too but takes half a second to import."""
    from_border = np.minimum(np.arange(n), np.arange(n)[::-1]) * 2 / (_TAPER * max(n - 1, 1))
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum(from_border, 1.0))


class Plane:
    """The plane of least squares through the known pixels of maps with one mask (rows, cols)."""

    def __init__(self, valid: Mask) -> None:
        self._valid = valid
        n = max(int(np.count_nonzero(valid)), 1)
        by_row, by_col = valid.sum(axis=1), valid.sum(axis=0)
        rows, cols = (np.arange(k, dtype=np.float64) for k in valid.shape)
        self._rows, self._cols = rows - by_row @ rows / n, cols - by_col @ cols / n
        mixed = float(self._rows @ (valid @ self._cols))
        square = np.array([[by_row @ self._rows**2, mixed], [mixed, by_col @ self._cols**2]])
        # On one line of pixels only the slope along it is known.
        self._solve = np.linalg.pinv(square)
        self._n = n

    def taken_off(self, values: Array) -> Array:
        """Return values (rows, cols) without their plane; 0 where they are not known."""
        if self._n < _LEAST:
            return np.zeros(values.shape)
        known = np.where(self._valid, values, 0.0)
        known = np.where(self._valid, known - known.sum() / self._n, 0.0)
        slope = self._solve @ (self._rows @ known.sum(axis=1), self._cols @ known.sum(axis=0))
        plane = np.add.outer(slope[0] * self._rows, slope[1] * self._cols)
        return np.where(self._valid, known - plane, 0.0)


def without_plane(values: Array, valid: Mask) -> Array:
    """Take the plane of least squares off a map, shape (rows, cols); 0 where it is not known."""
    return Plane(valid).taken_off(values)


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
    total, weight = masked_gaussian(values, valid, sigma)
    return np.asarray(total / np.maximum(weight, 1e-12), dtype=np.float64)


def correlation_length_um(values: Array, valid: Mask, pixel_um: tuple[float, float]) -> float:
    """Distance at which the autocorrelation of a map, averaged over directions, falls below 1/e.

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
