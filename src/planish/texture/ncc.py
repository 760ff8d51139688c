"""Pearson's r of two maps with missing places at every lag, and its peak.

Where between the pixels the peak lies, and how well known it is.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline

from planish.core.typing import Bools, Complexes, Floats, Shape2D, Window
from planish.texture.spectra import lags_within, padded_shape, padded_spectrum
from planish.texture.textures import centred, standard

# At a lag where less than this share of the pairs is left, or of the variance, r is meaningless.
LEAST_PAIRS = 0.2
MARGIN = 4  # pixels of r that have to be known around the lags that are searched
# Standard deviation in pixels below which a peak is that of features of few pixels.
_NARROW = 1.2
# Of derivatives along y (down the rows) and x: height, slopes, curvature.
_ORDERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


class MaskedNcc:
    """Normalised cross-correlation with a map that stays, for many maps that come.

    At the lag ``l``, r is that of the pairs ``a[p], b[p + l]`` where both are known: sums, squares
    and products over these pairs are correlations of maps and masks, so mean and variance are of
    the overlap (Padfield 2012, IEEE Trans. Image Process. 21, 2706, doi:10.1109/TIP.2011.2181402).
    The maps are padded by ``reach``: no wrap.
    """

    def __init__(self, a: Floats, *, a_valid: Bools, b_valid: Bools, reach: Shape2D) -> None:
        """Transform the map that stays and both masks, and sum over the pairs at each lag.

        ``a``, ``a_valid`` and ``b_valid`` (rows, cols); ``reach`` is the longest lag along rows and
        columns, in pixels.
        """
        self._reach = reach
        self._shape = padded_shape(a.shape, reach)
        self._b_valid = b_valid
        a = standard(a, a_valid)
        # Conjugates of spectra: their products with those of b give the lags from a to b.
        mask_a = padded_spectrum(a_valid.astype(np.float64), self._shape)
        self._mask_a = np.conj(mask_a)
        self._a = np.conj(padded_spectrum(a, self._shape))
        mask_b = padded_spectrum(b_valid.astype(np.float64), self._shape)
        self.pairs: Floats = np.rint(self._lags(self._mask_a * mask_b))
        enough = self.pairs >= max(LEAST_PAIRS * self.pairs.max(), 3.0)
        self._n = np.where(enough, self.pairs, np.nan)
        self._sum_a = self._lags(self._a * mask_b)
        squares = np.conj(padded_spectrum(a**2, self._shape))
        # Sum of squared deviations from the mean of the overlap, at each lag.
        self._var_a = self._lags(squares * mask_b) - self._sum_a**2 / self._n

    def __call__(self, b: Floats) -> Floats:
        """Return r at all lags, ``(2 reach + 1, 2 reach + 1)``, lag 0 in the middle.

        ``b`` (rows, cols) counts where ``b_valid`` is set. NaN where few pairs are left.
        """
        b = standard(b, self._b_valid)
        b_hat = padded_spectrum(b, self._shape)
        squares = padded_spectrum(b**2, self._shape)
        sum_b = self._lags(self._mask_a * b_hat)
        var_b = self._lags(self._mask_a * squares) - sum_b**2 / self._n
        product = self._lags(self._a * b_hat) - self._sum_a * sum_b / self._n
        # The maps have variance 1: what is below is rounding, of a constant overlap.
        least = 1e-9 * self._n
        is_valid = (self._var_a > least) & (var_b > least)
        squared_spread = np.where(is_valid, self._var_a * var_b, np.nan)
        return np.clip(product / np.sqrt(squared_spread), -1.0, 1.0)

    def _lags(self, spectrum: Complexes) -> Floats:
        return lags_within(spectrum, self._shape, self._reach)


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The largest correlation, in pixels (rows, columns)."""

    lag_px: Shape2D  # whole lag
    summit_px: Floats  # (2,): lag between the pixels
    r: float  # correlation there
    # Second derivatives, negative definite.
    curvature: Floats = field(default_factory=lambda: np.full((2, 2), np.nan))
    inner: bool = False  # whether it is a summit, not a slope that goes on beyond the lags searched


def within(reach: Shape2D) -> Bools:
    """Lags inside the ellipse of half axes ``reach``.

    The array is larger by a margin on every side.
    """
    down, across = (np.arange(-n - MARGIN, n + MARGIN + 1) / n for n in reach)
    squared_distance = np.add.outer(down**2, across**2)
    return squared_distance <= 1.0 + 1e-12


def find_peak(r: Floats, allowed: Bools) -> Peak | None:
    """Find the largest r where allowed, None where nothing is known.

    Between pixels a cubic spline is climbed. ``r`` (2 n + 1, 2 m + 1) has lag 0 in the middle, NaN
    where unknown; ``allowed`` has its shape. The peak stays at a whole lag, without a curvature,
    where it is negative, has unknown surroundings or a higher neighbour.

    Examples
    --------
    >>> a = np.random.default_rng(0).normal(size=(60, 80))
    >>> is_valid = np.ones(a.shape, dtype=bool)
    >>> correlate = MaskedNcc(a, a_valid=is_valid, b_valid=is_valid, reach=(12, 12))
    >>> find_peak(correlate(np.roll(a, (2, 3), axis=(0, 1))), within((8, 8))).lag_px
    (2, 3)
    """
    height = np.where(allowed & np.isfinite(r), r, -np.inf)
    rows, cols = r.shape
    row, col = divmod(int(np.argmax(height)), cols)
    if not np.isfinite(height[row, col]):
        return None
    highest = r[row, col]
    lag_px = (row - rows // 2, col - cols // 2)
    summit_px = np.array(lag_px, dtype=np.float64)
    pixel_peak = Peak(lag_px=lag_px, summit_px=summit_px, r=highest)
    axis = np.arange(-MARGIN, MARGIN + 1, dtype=np.float64)
    heights = _square(r, row, col, MARGIN)
    is_whole = heights.shape == (axis.size, axis.size)
    if highest < 0 or not is_whole or not np.isfinite(heights).all():
        return pixel_peak
    if _square(r, row, col, 1).max() > highest:
        return pixel_peak
    spline = RectBivariateSpline(axis, axis, heights, kx=3, ky=3, s=0)
    return _climbed(spline, pixel_peak)


def _square(values: Floats, row: int, col: int, reach: int) -> Floats:
    return values[row - reach : row + reach + 1, col - reach : col + reach + 1]


def _climbed(spline: RectBivariateSpline, peak: Peak) -> Peak:
    """The summit of a spline about a peak, by Newton's steps; the peak itself where it has none.

    ``spline`` gives r by the distance (down, across) from the peak's whole lag, in pixels. It has
    none where it is not curved downwards, or lies farther off than two pixels.
    """
    offset = np.zeros(2)
    step = np.ones(2)
    for k in range(21):
        r, y, x, yy, yx, xx = (
            spline.ev(offset[0], offset[1], dx=down, dy=across) for down, across in _ORDERS
        )
        curvature = np.array([[yy, yx], [yx, xx]])
        if yy >= 0 or np.linalg.det(curvature) <= 0:
            return peak
        if k == 20 or np.abs(step).max() < 1e-10:
            summit_px = peak.summit_px + offset
            return replace(peak, summit_px=summit_px, r=float(r), curvature=curvature, inner=True)
        newton_step = -np.linalg.solve(curvature, [y, x])
        step = np.clip(newton_step, -0.5, 0.5)
        offset = offset + step
        # On a ridge, the summit is not within the pixel that is highest.
        if np.abs(offset).max() > 2.0:
            return peak
    return peak


def rival_of(share: Floats, peak: Peak, allowed: Bools) -> float:
    """Height of the second peak.

    It lies beyond where what is explained, R² by lag, stays above half of the first peak's.
    """
    height = np.where(allowed & np.isfinite(share), share, 0.0)
    labels, _ = ndimage.label(height > 0.5 * peak.r)
    middle = np.array(share.shape) // 2
    peak_label = labels[tuple(middle + peak.lag_px)]
    return np.where(labels == peak_label, 0.0, height).max()


def covariance_of(peak: Peak, a: Floats, b: Floats, a_valid: Bools, b_valid: Bools) -> Floats:
    """Covariance of the peak's place, (2, 2) in pixels squared, rows first.

    It comes from the textures of what the maps (rows, cols) do not share.

    At the peak the slope of r is the mean of ``u v`` over the pairs, ``u = a - r b``, ``v`` the
    gradient of ``b`` (maps standardised). For stationary Gaussian maps ``var(sum u v) = sum over h
    of R_u R_v / n + R_uv(h) R_uv(-h) / n``, R the sums of products at the lag h, n their pairs. The
    peak moves by the slope over the curvature of r.
    """
    a_slices, b_slices = overlap(a.shape, peak.lag_px)
    is_valid = a_valid[a_slices] & b_valid[b_slices]
    n = int(is_valid.sum())
    a_part = a[a_slices]
    b_part = b[b_slices]
    u = standard(a_part, is_valid) - peak.r * standard(b_part, is_valid)
    reach = quarter_of(u.shape)
    shape = padded_shape(u.shape, reach)
    mask_hat = padded_spectrum(is_valid.astype(np.float64), shape)
    u_hat = padded_spectrum(u, shape)
    # A cubic spline, as in `find_peak`: its slope in a pixel is half the difference of neighbouring
    # coefficients.
    spline = ndimage.spline_filter(centred(b, b_valid), order=3)
    sd = b_part[is_valid].std()
    v_hat: list[Complexes] = []
    for axis in (0, 1):
        slope = ndimage.correlate1d(spline, (-0.5, 0.0, 0.5), axis=axis, mode="nearest")
        v = centred(slope[b_slices] / sd, is_valid)
        v_hat.append(padded_spectrum(v, shape))

    def lags(first: Complexes, second: Complexes) -> Floats:
        return lags_within(np.conj(first) * second, shape, reach)

    pairs = np.maximum(np.rint(lags(mask_hat, mask_hat)), 1.0)
    r_u = lags(u_hat, u_hat) / pairs
    r_uv = [lags(u_hat, s) for s in v_hat]
    covariance = np.empty((2, 2))
    for i, j in np.ndindex(2, 2):
        alike = r_u * lags(v_hat[i], v_hat[j])
        crossed = r_uv[i] * np.flip(r_uv[j]) / pairs
        covariance[i, j] = np.sum(alike + crossed)
    # Of few pairs it may have a negative part, which is left out.
    symmetric = 0.5 * (covariance + covariance.T) / n**2
    values, vectors = np.linalg.eigh(symmetric)
    slope_covariance = (vectors * np.maximum(values, 0.0)) @ vectors.T
    inverse = np.linalg.inv(peak.curvature)
    return inverse @ slope_covariance @ inverse


def lost_between_pixels(peak: Peak) -> Floats:
    """Covariance (2, 2) in pixels squared of what a cubic spline loses of a narrow peak.

    It draws the summit towards a whole lag. By how much was measured on textures of known lag, with
    features of 2 to 6 pixels; of wider peaks it is nothing beside the rest.
    """
    width = np.sqrt(-peak.r / np.diag(peak.curvature))
    most = np.where(width < _NARROW, 0.045 * width**-2.65, 0.0)
    # None at a whole and at a half lag, where both sides draw alike; most between them.
    share = np.sin(2 * np.pi * peak.summit_px) ** 2 + 0.01
    return np.diag(most**2 * share)


def quarter_of(shape: tuple[int, ...]) -> Shape2D:
    """A quarter of a field along rows and columns, in pixels; longer lags have few pairs."""
    return max(shape[0] // 4, 1), max(shape[1] // 4, 1)


def overlap(shape: tuple[int, ...], lag: Shape2D) -> tuple[Window, Window]:
    """Return the pixels of a, and those of b that lie on them at a lag."""
    rows, cols = shape
    down, across = lag
    a_slices = (_overlapping(rows, down), _overlapping(cols, across))
    b_slices = (_overlapping(rows, -down), _overlapping(cols, -across))
    return a_slices, b_slices


def _overlapping(n: int, lag: int) -> slice:
    return slice(max(-lag, 0), n - max(lag, 0))
