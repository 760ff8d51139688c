"""Maps with the texture of a map but unrelated to anything, and how far texture reaches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from planish.analyze.ncc import LEAST_PAIRS, MaskedNcc

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_AT_ONCE = 1 << 21  # numbers of the maps that are transformed together
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


def unrelated_peaks(
    a: Array, b: Array, known: tuple[Mask, Mask], pairs: Array, reach: tuple[int, int], count: int, seed: int
) -> Array:
    """Largest ``|r|`` within reach of map a and of each of many maps with the texture of b, shape (count,).

    ``pairs`` (2 n + 1, 2 m + 1) are the pairs that are known at every lag, lag 0 in the middle; ``reach`` are the half
    axes of the ellipse of lags, at most n and m.

    A map of random phases continues itself periodically, so one inverse transform gives its products with ``a`` at all
    lags. ``a`` without the plane through the pixels known in both is orthogonal to every plane, wherever it is moved:
    mean and plane of the other map drop out of the products, and are taken off its variance at lag 0. Where a lag
    leaves fewer pairs, r is larger by the root of their ratio. Only the wavelengths that hold 99 % of the products are
    transformed, on a grid of at least four points a wave (or that of the pixels); the others of b count in its
    variance.
    """
    both = known[0] & known[1]
    still = without_plane(a, both)
    shape = a.shape
    amplitude = Unrelated(b, known[1]).amplitude / a.size
    spectrum = np.conj(np.asarray(fft.rfft2(still)))
    weight = np.full(amplitude.shape[1], 2.0)
    weight[0] = 1.0
    band = _band(weight * np.abs(spectrum * amplitude) ** 2, shape)
    rows = np.concatenate([np.arange(band[0] + 1), np.arange(-band[0], 0)])
    inner = np.ix_(rows, np.arange(band[1] + 1))
    grid = [fft.next_fast_len(min(2 * (2 * k + 1), n), real=True) for k, n in zip(band, shape, strict=True)]
    part = amplitude[inner].astype(np.float32)
    part[0, 0] = 0.0
    outside = float(weight @ (amplitude**2).sum(axis=0)) - float(weight[: band[1] + 1] @ (part**2).sum(axis=0))
    outside -= float(amplitude[0, 0]) ** 2
    own = np.stack([part.astype(np.complex64), spectrum[inner].astype(np.complex64) * part])
    # Sums over the known pixels: of squares, and of the products with mean and slopes.
    at = [(np.arange(m) * n) // m for m, n in zip(grid, shape, strict=True)]
    shown = both[np.ix_(*at)]
    flat = np.stack([np.ones(shown.shape), *np.meshgrid(*[np.linspace(-1.0, 1.0, m) for m in grid], indexing="ij")])
    basis = np.linalg.qr(flat[:, shown].T)[0].astype(np.float32)
    lags = [np.arange(-(k * m // n), k * m // n + 1) for k, m, n in zip(reach, grid, shape, strict=True)]
    whole = [np.rint(lag * n / m).astype(np.intp) for lag, m, n in zip(lags, grid, shape, strict=True)]
    left = pairs[np.ix_(*(w + n // 2 for w, n in zip(whole, pairs.shape, strict=True)))]
    far = sum((w[:, None] if k == 0 else w[None]) ** 2 / reach[k] ** 2 for k, w in enumerate(whole)) > 1.0 + 1e-12
    total = float(both.sum())
    scale = np.where(far | ~(left >= LEAST_PAIRS * pairs.max()), 0.0, np.sqrt(total / np.maximum(left, 1.0)))
    scale = (scale / np.sqrt(float(np.sum(still**2)) * total)).astype(np.float32)
    rng = np.random.default_rng(seed)
    peaks: list[Array] = []
    step = max(1, _AT_ONCE // (2 * grid[0] * grid[1]))
    for start in range(0, count, step):
        some = min(step, count - start)
        angle = rng.random((some, *part.shape), dtype=np.float32) * np.float32(2 * np.pi)
        # A real map's waves along the rows come in conjugate couples.
        angle[:, band[0] + 1 :, 0] = -angle[:, band[0] : 0 : -1, 0]
        phase = np.empty(angle.shape, dtype=np.complex64)
        np.cos(angle, out=phase.real)
        np.sin(angle, out=phase.imag)
        half = np.zeros((2, some, grid[0], band[1] + 1), dtype=np.complex64)
        half[:, :, rows] = own[:, None] * phase
        # Of the products only the lags within reach are wanted.
        half = np.asarray(fft.ifft(half, axis=2, norm="forward", overwrite_x=True))
        field = np.asarray(fft.irfft(half[0], grid[1], axis=2, norm="forward"))[:, shown]
        product = np.asarray(fft.irfft(half[1][:, lags[0]], grid[1], axis=2, norm="forward"))[:, :, lags[1]]
        variance = (np.sum(field**2, axis=1) - np.sum((field @ basis) ** 2, axis=1)) / shown.sum() + outside
        highest = np.max(np.abs(product) * scale, axis=(1, 2)) / np.sqrt(np.maximum(variance, 1e-300))
        peaks.append(np.minimum(highest.astype(np.float64), 1.0))
    return np.concatenate(peaks)


def _band(power: Array, shape: tuple[int, ...]) -> tuple[int, int]:
    """Waves over the map, along rows and columns, up to which 99 % of a power (rows, cols // 2 + 1) lies."""
    rows, cols = (np.arange(k) for k in power.shape)
    rows = np.minimum(rows, shape[0] - rows)
    most = (shape[0] - 1) // 2, (shape[1] - 1) // 2
    # Waves of one length in pixels: an ellipse of waves over the map.
    frequency = np.hypot(rows[:, None] / shape[0], cols[None] / shape[1])
    order = np.argsort(frequency, axis=None)
    sums = np.cumsum(power.ravel()[order])
    last = frequency.ravel()[order[int(np.searchsorted(sums, 0.99 * sums[-1]))]] if sums[-1] > 0 else 0.5
    found = [min(max(int(np.ceil(last * n)), 2), m) for n, m in zip(shape, most, strict=True)]
    return found[0], found[1]


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
    weight = ndimage.gaussian_filter(valid.astype(np.float64), sigma, mode="constant")
    total = ndimage.gaussian_filter(np.where(valid, values, 0.0), sigma, mode="constant")
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
