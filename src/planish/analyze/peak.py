"""The peak of a correlation of two maps: where it is between the pixels, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.interpolate import RectBivariateSpline

from planish.analyze.ncc import cropped

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MARGIN = 4  # pixels of r that have to be known around the lags that are searched
_STEPS = 20
_FROM_PIXEL = 2.0  # on a ridge, the summit is not within the pixel that is highest


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The largest correlation, in pixels (rows, columns)."""

    pixel: tuple[int, int]  # whole lag
    at: Array  # (2,): lag between the pixels
    r: float  # correlation there, with its sign
    curvature: Array  # (2, 2): second derivatives of ``|r|``, negative definite
    inner: bool  # whether it is a summit, not a slope that goes on beyond the lags searched


def within(reach: tuple[int, int], margin: int = MARGIN) -> Mask:
    """Lags inside the ellipse of half axes ``reach``, in an array that is ``margin`` larger on every side."""
    rows, cols = (np.arange(-n - margin, n + margin + 1) / n for n in reach)
    return rows[:, None] ** 2 + cols[None, :] ** 2 <= 1.0 + 1e-12


def find_peak(r: Array, allowed: Mask, sign: int) -> Peak | None:
    """Find the largest ``sign * r``, or ``|r|`` for ``sign`` 0, where allowed; None where nothing is known.

    Between pixels a cubic spline through r is climbed.
    """
    height = np.where(allowed & np.isfinite(r), np.abs(r) if sign == 0 else sign * r, -np.inf)
    where = int(np.argmax(height))
    row, col = divmod(where, r.shape[1])
    if not np.isfinite(height[row, col]):
        return None
    middle = r.shape[0] // 2, r.shape[1] // 2
    pixel = (row - middle[0], col - middle[1])
    sign_r = 1.0 if r[row, col] >= 0 else -1.0
    around = sign_r * r[row - MARGIN : row + MARGIN + 1, col - MARGIN : col + MARGIN + 1]
    flat = Peak(
        pixel=pixel,
        at=np.array(pixel, dtype=np.float64),
        r=float(r[row, col]),
        curvature=np.full((2, 2), np.nan),
        inner=False,
    )
    full = 2 * MARGIN + 1
    if around.shape != (full, full) or not np.isfinite(around).all():
        return flat
    near = around[MARGIN - 1 : MARGIN + 2, MARGIN - 1 : MARGIN + 2]
    if near.max() > near[1, 1]:
        return flat
    axis = np.arange(-MARGIN, MARGIN + 1, dtype=np.float64)
    spline = RectBivariateSpline(axis, axis, around, kx=3, ky=3, s=0)
    at = np.zeros(2)
    for _ in range(_STEPS):
        slope, curvature = _derivatives(spline, at)
        if curvature[0, 0] >= 0 or np.linalg.det(curvature) <= 0:
            return flat
        step = np.clip(-np.linalg.solve(curvature, slope), -0.5, 0.5)
        at = at + step
        if np.abs(at).max() > _FROM_PIXEL:
            return flat
        if np.abs(step).max() < 1e-10:
            break
    _, curvature = _derivatives(spline, at)
    if curvature[0, 0] >= 0 or np.linalg.det(curvature) <= 0:
        return flat
    return Peak(
        pixel=pixel, at=flat.at + at, r=sign_r * float(spline.ev(at[0], at[1])), curvature=curvature, inner=True
    )  # fmt: skip


def _derivatives(spline: RectBivariateSpline, at: Array) -> tuple[Array, Array]:
    d = {(i, j): float(spline.ev(at[0], at[1], dx=i, dy=j)) for i, j in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))}
    return np.array([d[1, 0], d[0, 1]]), np.array([[d[2, 0], d[1, 1]], [d[1, 1], d[0, 2]]])


def rival_r(r: Array, peak: Peak, allowed: Mask) -> float:
    """Correlation, with its sign, of the extreme that most puts the peak in doubt; 0 where there is none.

    The peak reaches as far as r stays above half its height. Outside it, an extreme of the other sign counts with its
    full height (a map that follows the slope of the other has a peak on either side of the true lag, one positive, one
    negative), one of the same sign only above 0.8 of the peak (a pattern that repeats itself).
    """
    sign_r = 1.0 if peak.r >= 0 else -1.0
    height = np.where(allowed & np.isfinite(r), sign_r * r, 0.0)
    parts, _ = ndimage.label(height > 0.5 * abs(peak.r))
    own = parts[r.shape[0] // 2 + peak.pixel[0], r.shape[1] // 2 + peak.pixel[1]]
    others = np.where(parts == own, 0.0, height)
    same, other = float(others.max()), float(-others.min())
    if same > 0.8 * abs(peak.r) and same > other:
        return sign_r * same
    return -sign_r * other


def covariance_of(peak: Peak, a: Array, b: Array, a_valid: Mask, b_valid: Mask) -> Array:
    """Covariance of the peak's place, (2, 2) in pixels squared, from the textures of what the maps do not share.

    Notes
    -----
    At the peak the slope of r is the mean of ``u v`` over the pairs, with ``u = a - r b`` and ``v`` the gradient of
    ``b`` (both maps standardised). For stationary Gaussian maps ``var(sum u v) = sum over h of R_u R_v / n +
    R_uv(h) R_uv(-h) / n`` with the sums of products R at the lag h and the number n of their pairs. The peak moves by
    the slope over the curvature of r.
    """
    here, there = overlap(a.shape, peak.pixel)
    # A cubic spline between the pixels, as in `find_peak`: its slope in a pixel is half the difference of neighbouring
    # coefficients.
    mean = float(b[b_valid].mean())
    spline = np.asarray(ndimage.spline_filter(np.where(b_valid, b - mean, 0.0), order=3), dtype=np.float64)
    slopes = np.stack([_half_difference(spline, axis)[there] for axis in (0, 1)])
    both = a_valid[here] & b_valid[there]
    n = int(both.sum())
    x, y = _standard(a[here], both), _standard(b[there], both)
    sd = float(b[there][both].std())
    u = np.where(both, x - peak.r * y, 0.0)
    v = np.where(both, slopes / sd, 0.0)
    v = np.where(both, v - v.sum(axis=(1, 2), keepdims=True) / n, 0.0)
    reach = (max(u.shape[0] // 4, 1), max(u.shape[1] // 4, 1))
    shape = tuple(fft.next_fast_len(m + k, real=True) for m, k in zip(u.shape, reach, strict=True))
    mask_hat, u_hat = fft.rfft2(both.astype(np.float64), shape), fft.rfft2(u, shape)
    v_hat = [fft.rfft2(s, shape) for s in v]

    def lags(first: NDArray[np.complex128], second: NDArray[np.complex128]) -> Array:
        return cropped(np.asarray(fft.irfft2(np.conj(first) * second, shape), dtype=np.float64), reach)

    pairs = np.maximum(np.rint(lags(mask_hat, mask_hat)), 1.0)
    r_u = lags(u_hat, u_hat) / pairs
    r_uv = [lags(u_hat, s) for s in v_hat]
    spread = np.empty((2, 2))
    for i in range(2):
        for j in range(2):
            cross = r_uv[i] * r_uv[j][::-1, ::-1] / pairs
            spread[i, j] = float(np.sum(r_u * lags(v_hat[i], v_hat[j]) + cross))
    values, vectors = np.linalg.eigh(0.5 * (spread + spread.T) / n**2)
    spread = (vectors * np.maximum(values, 0.0)) @ vectors.T
    back = np.linalg.inv(peak.curvature)
    return back @ spread @ back


def overlap(shape: tuple[int, ...], lag: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the pixels of a, and those of b that lie on them at a lag."""
    here = [slice(max(-k, 0), n - max(k, 0)) for n, k in zip(shape, lag, strict=True)]
    there = [slice(max(k, 0), n - max(-k, 0)) for n, k in zip(shape, lag, strict=True)]
    return (here[0], here[1]), (there[0], there[1])


def _half_difference(values: Array, axis: int) -> Array:
    padded = np.pad(values, [(1, 1) if k == axis else (0, 0) for k in (0, 1)], mode="edge")
    return 0.5 * (padded[2:] - padded[:-2] if axis == 0 else padded[:, 2:] - padded[:, :-2])


def _standard(values: Array, both: Mask) -> Array:
    known = values[both]
    return np.where(both, (values - known.mean()) / known.std(), 0.0)
