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

    0 where it is not known. The normal equations are summed along rows first, as the terms are
    products of a polynomial of the row and one of the column.

    Examples
    --------
    >>> y, x = np.mgrid[:40, :50] / 50
    >>> rest = without_trend(1 + 2 * x - y + x * y, np.ones((40, 50), dtype=bool))
    >>> float(np.abs(rest).max().round(9))
    0.0
    """
    # Legendre polynomials of order 0 to 2 of each row and of each column, (n, 3): no term is ever
    # as large as the map.
    axes = (np.linspace(-1.0, 1.0, n) for n in is_valid.shape)
    rows, cols = (np.polynomial.legendre.legvander(axis, 2) for axis in axes)
    inside = centred(values, is_valid)
    weights = is_valid.astype(np.float64)
    products = np.einsum("cj,cl->cjl", cols, cols).reshape(-1, 9)
    by_row = (weights @ products).reshape(-1, 3, 3)
    moments = np.einsum("rjl,ri,rk->ijkl", by_row, rows, rows)
    sums = rows.T @ inside @ cols
    # Orders along rows and columns of the terms, which together are 2 or less.
    i, j = np.nonzero(np.tri(3)[::-1])
    matrix = moments[i[:, None], j[:, None], i, j]
    coefficients = np.linalg.lstsq(matrix, sums[i, j], rcond=None)[0]
    surface = np.zeros((3, 3))
    surface[i, j] = coefficients
    return np.where(is_valid, inside - rows @ surface @ cols.T, 0.0)


def shared_trend(x: Floats, y: Floats, is_valid: Bools) -> str:
    """Say what trends over the field hold of two maps (rows, cols).

    Empty where it is less than a quarter of the variance of either.
    """
    rest_x = without_trend(x, is_valid)[is_valid]
    rest_y = without_trend(y, is_valid)[is_valid]
    share_x = 1.0 - rest_x.var() / x[is_valid].var()
    share_y = 1.0 - rest_y.var() / y[is_valid].var()
    if min(share_x, share_y) < 0.25:
        return ""
    spread = rest_x.std() * rest_y.std()
    r = np.mean(rest_x * rest_y) / spread if spread > 0 else math.nan
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
        taper = np.multiply.outer(*map(_tapered, values.shape))
        tapered = np.where(valid, values - mean, 0.0) * taper
        self.amplitude = np.abs(fft.rfft2(tapered))
        self._shape = values.shape
        self._plane = Plane(valid)

    def draws(self, n_draws: int, rng: np.random.Generator) -> Iterator[Floats]:
        """Give the next so many of them, (rows, cols), 0 where unknown.

        Their variance is smaller: gaps and borders count as 0.
        """
        for _ in range(n_draws):
            # The spectrum of white noise has the symmetry of a real map's.
            noise = rng.standard_normal(self._shape)
            spectrum = fft.rfft2(noise)
            spectrum *= self.amplitude / np.maximum(np.abs(spectrum), 1e-300)
            surrogate = fft.irfft2(spectrum, self._shape)
            yield self._plane.taken_off(surrogate)


def _tapered(n: int) -> Floats:
    """Tapered cosine (Tukey) window; scipy.signal has it too but takes half a second to import.

    It rises over a fifth of the length at both ends.
    """
    place = np.arange(n)
    to_border = np.minimum(place, place[::-1])
    depth = to_border * 2 / (0.4 * max(n - 1, 1))
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum(depth, 1.0))


class Plane:
    """The plane of least squares through the known pixels of maps with one mask (rows, cols)."""

    def __init__(self, valid: Bools) -> None:
        """Solve for its slopes once; the places of rows and columns are those from their mean.

        With fewer than three pixels there is no plane, and :meth:`taken_off` gives 0.
        """
        self._valid = valid
        n = max(np.count_nonzero(valid), 1)
        by_row = valid.sum(axis=1)
        by_col = valid.sum(axis=0)
        rows, cols = (np.arange(k, dtype=np.float64) for k in valid.shape)
        self._rows = rows - by_row @ rows / n
        self._cols = cols - by_col @ cols / n
        rows_cols = self._rows @ (valid @ self._cols)
        rows_rows = by_row @ self._rows**2
        cols_cols = by_col @ self._cols**2
        # On one line of pixels only the slope along it is known.
        moments = [[rows_rows, rows_cols], [rows_cols, cols_cols]]
        self._solve = np.linalg.pinv(moments)
        self._n = n

    def taken_off(self, values: Floats) -> Floats:
        """Return values (rows, cols) without their plane; 0 where they are not known."""
        if self._n < 3:
            return np.zeros(values.shape)
        level = centred(values, self._valid)
        product_down = self._rows @ level.sum(axis=1)
        product_across = self._cols @ level.sum(axis=0)
        down, across = self._solve @ (product_down, product_across)
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

    Returns
    -------
    ndarray, shape (rows, cols)
        0 where not valid.
    """
    short_um, long_um = band_um
    out = np.where(valid, values, 0.0)
    if short_um is not None:
        smooth = _low_pass(out, valid, pixel_um, short_um)
        out = np.where(valid, smooth, 0.0)
    if long_um is not None:
        slow = _low_pass(out, valid, pixel_um, long_um)
        out = np.where(valid, out - slow, 0.0)
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
    down, across = (np.arange(-n, n + 1) for n in reach)
    row_um, col_um = pixel_um
    distance_um = np.hypot(down[:, None] * row_um, across * col_um)
    ring_um = max(pixel_um)
    is_used = (distance_um <= shorter_side_um(reach, pixel_um)) & np.isfinite(r)
    rings = np.rint(distance_um[is_used] / ring_um).astype(np.int64)
    counts = np.bincount(rings)
    mean_r = np.bincount(rings, weights=r[is_used]) / np.maximum(counts, 1)
    limit = np.exp(-1.0)
    is_below = (mean_r < limit) & (counts > 0)
    if not is_below.any():
        return math.inf
    first_below = int(np.argmax(is_below))
    if first_below == 0:
        return ring_um
    # On the line from the ring before.
    last = first_below - 1
    part = (mean_r[last] - limit) / (mean_r[last] - mean_r[first_below])
    return float(ring_um * (last + part))
