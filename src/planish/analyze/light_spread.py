"""A coating as an image shows it where light spreads in the paper before it comes out again."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from planish.analyze.correlation import on_one_grid
from planish.core.errors import CannotMeasure, SizeError

Array = NDArray[np.float64]

_FAR = 10.0  # widths by which the field is padded: what wraps around has fallen to 5e-5


def spread_light(
    values: NDArray[Any], *, pixel_um: float | tuple[float, float], width_um: float,
    mask: NDArray[np.bool_] | None = None,
) -> Array:  # fmt: skip
    """Blur a map as light is that spreads in the paper, over the pixels that are known.

    Parameters
    ----------
    values : ndarray, shape (rows, cols)
        Such as the thickness of a coating; NaN is missing.
    pixel_um : float or (float, float)
        Along y and x.
    width_um : float
        Length over which the point spread function falls to 1/e. It has to be known from elsewhere: widths of 150 to
        350 um are stated for papers, and a single number does not describe a paper well.
    mask : ndarray of bool, shape (rows, cols), optional
        Pixels that count.

    Returns
    -------
    ndarray of float64, shape (rows, cols)
        NaN where the map is not known.

    Raises
    ------
    InputError
        If the map is none of numbers, or the mask is none of its.
    SizeError
        If the width is not above 0, or as large as the field.
    CannotMeasure
        If no pixel is known.

    Notes
    -----
    The point spread function ``exp(-r / w) / (2 pi w^2)`` has the transfer function ``(1 + (2 pi w f)^2)^(-3/2)``, by
    which the spectrum is multiplied. Map and mask are treated alike and divided by each other, so that a map that is
    constant stays so; along borders and holes the mean leans to one side.
    """
    pixel = on_one_grid(values, values, mask, pixel_um)
    side = min(n * p for n, p in zip(values.shape, pixel, strict=True))
    if not 0 < width_um < side:
        raise SizeError(
            f"Light would spread over {width_um:g} um; the map is {side:g} um wide. Give a width above 0, below that."
        )
    known = np.isfinite(values) if mask is None else np.isfinite(values) & mask
    if not known.any():
        raise CannotMeasure("No pixel of the map is known and counts. Look at the mask.")
    shape = [
        fft.next_fast_len(n + min(math.ceil(_FAR * width_um / p), n), real=True)
        for n, p in zip(values.shape, pixel, strict=True)
    ]
    square = fft.fftfreq(shape[0], pixel[0])[:, None] ** 2 + fft.rfftfreq(shape[1], pixel[1]) ** 2
    transfer = (1.0 + (2 * math.pi * width_um) ** 2 * square) ** -1.5
    mean = float(np.mean(values[known], dtype=np.float64))
    rows, cols = values.shape
    moved, weight = (
        np.asarray(fft.irfft2(np.asarray(fft.rfft2(m, shape)) * transfer, shape))[:rows, :cols]
        for m in (np.where(known, values - mean, 0.0), known.astype(np.float64))
    )
    return np.where(known, mean + moved / np.where(known, weight, 1.0), np.nan)
