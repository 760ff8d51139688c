"""Planes, trends and slow waves taken off maps.

Also surrogates of what is left, and how far its texture reaches.

A trend over the whole field that two maps share, such as light, curl or drift, is one event and not
many.
"""

import math
from collections.abc import Iterator

import numpy as np
from scipy import fft

from planish.core.grid import shorter_side_um
from planish.core.robust import masked_gaussian
from planish.core.typing import Bools, Floats, Pair
from planish.texture.ncc import MaskedNcc, quarter_of
from planish.texture.textures import centred, sigma_px


def without_trend(values: Floats, is_valid: Bools) -> Floats:
    """Take the plane and second-order surface of least squares off a map (rows, cols).

    0 where it is not known.

    Examples
    --------
    >>> y, x = np.mgrid[:40, :50] / 50
    >>> rest = without_trend(1 + 2 * x - y + x * y, np.ones((40, 50), dtype=bool))
    >>> float(np.abs(rest).max().round(9))
    0.0
    """
    # Products of one polynomial along the rows and one along the columns: no term is ever as large
    # as the map.
    axes = (np.linspace(-1.0, 1.0, n) for n in is_valid.shape)
    rows, cols = (np.polynomial.legendre.legvander(axis, 2) for axis in axes)
    inside = centred(values, is_valid)
    weights = is_valid.astype(np.float64)
    products = (cols[:, :, None] * cols[:, None, :]).reshape(len(cols), 9)
    by_row = (weights @ products).reshape(-1, 3, 3)
    moments = np.einsum("rjl,ri,rk->ijkl", by_row, rows, rows)
    sums = rows.T @ inside @ cols
    i, j = np.nonzero(np.add.outer(range(3), range(3)) < 3)
    matrix = moments[i[:, None], j[:, None], i, j]
    surface = np.zeros((3, 3))
    surface[i, j] = np.linalg.lstsq(matrix, sums[i, j], rcond=None)[0]
    return np.where(is_valid, inside - rows @ surface @ cols.T, 0.0)


def shared_trend(x: Floats, y: Floats, is_valid: Bools) -> str:
    """Say what trends over the field hold of two maps.

    Empty where it is less than a quarter of either.
    """
    a, b = (without_trend(m, is_valid)[is_valid] for m in (x, y))
    share_x = 1.0 - a.var() / x[is_valid].var()
    share_y = 1.0 - b.var() / y[is_valid].var()
    if min(share_x, share_y) < 0.25:
        return ""
    spread = a.std() * b.std()
    r = np.mean(a * b) / spread if spread > 0 else math.nan
    return (
        f"Trends over the whole field hold {100 * share_x:.0f} % of the variance of the first map"
        f" and {100 * share_y:.0f} % of that of the second; without them r is {r:.2f}."
    )


class PhaseSurrogate:
    """Maps with the power spectrum of a map, random phases and no trend.

    They are of its texture, but unrelated to anything.

    The map (rows, cols) is one without trend; where it is not valid, its mean is taken. Theiler et
    al. (1992), Physica D 58, 77, doi:10.1016/0167-2789(92)90102-S.
    """

    def __init__(self, values: Floats, valid: Bools) -> None:
        mean = values[valid].mean() if valid.any() else 0.0
        # The jump at the borders would whiten the spectrum, and make the null too narrow.
        taper = np.multiply.outer(*(_tapered(n) for n in values.shape))
        tapered = np.where(valid, values - mean, 0.0) * taper
        self.amplitude = np.abs(np.asarray(fft.rfft2(tapered)))
        self._shape = values.shape
        self._plane = Plane(valid)

    def draws(self, n_draws: int, rng: np.random.Generator) -> Iterator[Floats]:
        """Give the next so many of them, (rows, cols), 0 where unknown.

        Their variance is smaller: gaps and borders count as 0.
        """
        for _ in range(n_draws):
            # The spectrum of white noise has the symmetry of a real map's.
            phase = np.asarray(fft.rfft2(rng.standard_normal(self._shape)))
            phase *= self.amplitude / np.maximum(np.abs(phase), 1e-300)
            surrogate = np.asarray(fft.irfft2(phase, self._shape), dtype=np.float64)
            yield self._plane.taken_off(surrogate)


def _tapered(n: int) -> Floats:
    """Tapered cosine (Tukey) window; scipy.signal has it too but takes half a second to import."""
    place = np.arange(n)
    depth = np.minimum(place, place[::-1]) * 2 / (0.4 * max(n - 1, 1))
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum(depth, 1.0))


class Plane:
    """The plane of least squares through the known pixels of maps with one mask (rows, cols)."""

    def __init__(self, valid: Bools) -> None:
        self._valid = valid
        n = max(int(np.count_nonzero(valid)), 1)
        by_row = valid.sum(axis=1)
        by_col = valid.sum(axis=0)
        rows, cols = (np.arange(k, dtype=np.float64) for k in valid.shape)
        self._rows = rows - by_row @ rows / n
        self._cols = cols - by_col @ cols / n
        rows_cols = self._rows @ (valid @ self._cols)
        rows_rows = by_row @ self._rows**2
        cols_cols = by_col @ self._cols**2
        # On one line of pixels only the slope along it is known.
        self._solve = np.linalg.pinv([[rows_rows, rows_cols], [rows_cols, cols_cols]])
        self._n = n

    def taken_off(self, values: Floats) -> Floats:
        """Return values (rows, cols) without their plane; 0 where they are not known."""
        if self._n < 3:
            return np.zeros(values.shape)
        level = centred(values, self._valid)
        products = (self._rows @ level.sum(axis=1), self._cols @ level.sum(axis=0))
        down, across = self._solve @ products
        plane = np.add.outer(down * self._rows, across * self._cols)
        return np.where(self._valid, level - plane, 0.0)


def in_band(
    values: Floats, valid: Bools, pixel_um: Pair, band_um: tuple[float | None, float | None]
) -> Floats:
    """Keep wavelengths of a map from ``band_um[0]`` to ``band_um[1]``, with both limits halved.

    Parameters
    ----------
    values, valid : ndarray, shape (rows, cols)
    pixel_um : (float, float), along rows' axis (y) and columns' axis (x)
    band_um : (float or None, float or None)
        None leaves that side open. The filters are Gaussian; missing pixels have no weight in them.
    """
    short, long = band_um
    out = np.where(valid, values, 0.0)
    if short is not None:
        out = np.where(valid, _low_pass(out, valid, pixel_um, short), 0.0)
    if long is not None:
        out = np.where(valid, out - _low_pass(out, valid, pixel_um, long), 0.0)
    return out


def _low_pass(values: Floats, valid: Bools, pixel_um: Pair, half_um: float) -> Floats:
    total, weight = masked_gaussian(values, valid, sigma_px(half_um, pixel_um))
    return total / np.maximum(weight, 1e-12)


def correlation_length_um(values: Floats, valid: Bools, pixel_um: Pair) -> float:
    """Distance where a map's autocorrelation, averaged over directions, is below 1/e.

    Inf beyond a quarter of it.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(size=(80, 80))
    >>> is_valid = np.ones((80, 80), dtype=bool)
    >>> correlation_length_um(noise, is_valid, (10.0, 10.0)) < 10.0
    True
    """
    reach = quarter_of(values.shape)
    r = MaskedNcc(values, a_valid=valid, b_valid=valid, reach=reach)(values)
    y, x = (np.arange(-n, n + 1) * p for n, p in zip(reach, pixel_um, strict=True))
    distance = np.hypot(y[:, None], x[None, :])
    step = max(pixel_um)
    limit = shorter_side_um(reach, pixel_um)
    is_used = (distance <= limit) & np.isfinite(r)
    rings = np.rint(distance[is_used] / step).astype(np.int64)
    count = np.bincount(rings)
    mean = np.bincount(rings, weights=r[is_used]) / np.maximum(count, 1)
    below = np.flatnonzero((mean < np.exp(-1.0)) & (count > 0))
    if not below.size:
        return math.inf
    if below[0] == 0:
        return step
    last = below[0] - 1
    part = (mean[last] - np.exp(-1.0)) / (mean[last] - mean[last + 1])
    return float(step * (last + part))
