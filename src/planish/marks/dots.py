"""The dots of a print taken off before holes are searched: a hole touches dots around it, which spoil its rim."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.marks.candidates import reduce_to

_ACROSS = 40.0  # pixels over the smallest hole where dots are distinguished from holes
_EDGE = 2  # such pixels around a dot that are not yet as bright as paper
_REGROWTH = 1.5  # such pixels by which a hole grows back beyond the discs in it: its rim stays as it is
_BINS = 256


def without_dots(image: NDArray[np.floating], pixel_um: tuple[float, float], least_um: float) -> NDArray[np.float32]:
    """Make bright what is dark and too narrow for the smallest hole.

    Parameters
    ----------
    image : ndarray, shape (rows, cols)
        Printed paper, brighter than its ink; NaN is missing.
    pixel_um : (float, float)
        Along y and x.
    least_um : float
        Diameter of the smallest hole, larger than that of the largest dot.

    Returns
    -------
    ndarray, shape (rows, cols)
        The image with the median grey of the paper where dots are; holes and paper keep their values.

    Notes
    -----
    Dark is what lies below the level that parts two classes of grey best (Otsu 1979). What a disc of ``least_um``, all
    dark, reaches is a hole (morphological opening); all other dark pixels are dots.

    References
    ----------
    Otsu (1979), IEEE Trans. Syst. Man Cybern. 9, 62, doi:10.1109/TSMC.1979.4310076.
    """
    whole = np.asarray(image, dtype=np.float32)
    small, size, _ = reduce_to(whole, pixel_um, least_um / _ACROSS)
    has_data = np.isfinite(small)
    if not has_data.any():
        return whole
    smooth = ndimage.gaussian_filter(np.where(has_data, small, np.median(small[has_data])), 1.0)
    dark = has_data & (smooth < _otsu_level(smooth[has_data]))
    if not dark.any() or not (has_data & ~dark).any():
        return whole
    # Beyond the border may be more of a hole, or of a dot: a hole that it cuts stays one.
    depth = np.asarray(ndimage.distance_transform_edt(np.pad(dark | ~has_data, 1, constant_values=True), sampling=size))
    middle = dark & (depth[1:-1, 1:-1] >= least_um / 2 - 0.5 * max(size))
    reach = least_um / 2 + _REGROWTH * max(size)
    hole = np.zeros_like(dark)
    if middle.any():
        hole = np.asarray(ndimage.distance_transform_edt(~middle, sampling=size)) < reach
    dots = ndimage.binary_dilation(dark & ~hole, iterations=_EDGE) & ~hole
    factors = [round(a / b) for a, b in zip(size, pixel_um, strict=True)]
    rows, cols = (
        np.minimum(np.arange(n) // k, m - 1) for n, k, m in zip(whole.shape, factors, dots.shape, strict=True)
    )
    out = whole.copy()
    out[dots[np.ix_(rows, cols)] & np.isfinite(whole)] = np.median(small[has_data & ~dark])
    return out


def _otsu_level(greys: NDArray[np.float32]) -> float:
    """Find the grey that parts two classes so that the variance between them is largest."""
    count, edges = np.histogram(greys, _BINS)
    middle = 0.5 * (edges[1:] + edges[:-1])
    below = np.cumsum(count)
    total = np.cumsum(count * middle)
    weight = below[:-1] * (below[-1] - below[:-1])
    between = (total[-1] * below[:-1] / below[-1] - total[:-1]) ** 2 / np.maximum(weight, 1)
    return float(edges[1 + int(np.argmax(np.where(weight > 0, between, -1.0)))])
