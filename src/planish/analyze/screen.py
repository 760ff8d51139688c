"""A halftone screen taken off the image of a print, so that what is left is the print's unevenness and not its dots."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, special

from planish.core.errors import CannotMeasure, InputError, SizeError

SCREEN_SIGMA_UM = 70.0
"""Standard deviation of the Gaussian: 6 of them are the 420 um of Hirn et al. (2009), section 3.3.2."""

SCREEN_SIGMA = SCREEN_SIGMA_UM * 60 / 1e4
"""The same as a share of the period of the screen that it was for, 60 lines per cm."""

SCREEN_REACH = 3.0
"""Standard deviations to either side at which the Gaussian ends."""

_LEAST_SIGMA_PX = 0.75  # below, pixels are too coarse for a Gaussian


def without_screen(
    image: ArrayLike, *, pixel_um: float | tuple[float, float], sigma_um: float = SCREEN_SIGMA_UM,
    mask: NDArray[np.bool_] | None = None,
) -> NDArray[np.floating[Any]]:  # fmt: skip
    """Average an image with a Gaussian, over the pixels that are known; before it is averaged over points.

    Parameters
    ----------
    image : array_like, shape (rows, cols)
        Reflectance or grey; NaN is missing.
    pixel_um : float or (float, float)
        Along y and x.
    sigma_um : float
        Standard deviation of the Gaussian, which is cut at 3 of them.
    mask : ndarray of bool, shape (rows, cols), optional
        Pixels that count.

    Returns
    -------
    ndarray, shape (rows, cols)
        NaN where the image is not known. Single precision of an image of single precision or of 8 or 16 bits.

    Raises
    ------
    InputError
        If the image is no array of numbers with two dimensions, or the mask is none of its.
    SizeError
        If a size is not above 0, or the Gaussian narrower than 0.75 pixels.
    CannotMeasure
        If no pixel is known.

    Notes
    -----
    Sum of the known values over sum of their weights: a map that is constant stays so up to its border. The kernel is
    not symmetric there, though, and more of the screen is left than :func:`screen_left` gives: keep 3 sigma off holes
    and borders where the last percent counts. The kernel is cut at the pixel nearest to 3 sigma, along either axis.
    """
    values = np.asarray(image)
    sigma = [sigma_um / p for p in pixel_of(values, pixel_um)]
    if not (math.isfinite(sigma_um) and min(sigma) >= _LEAST_SIGMA_PX):
        raise SizeError(
            f"A Gaussian of {sigma_um:g} um is {min(sigma):.2g} pixels wide; it needs {_LEAST_SIGMA_PX}. Take a larger "
            "sigma_um, or an image with smaller pixels."
        )
    known = known_of(values, mask)
    kind = np.result_type(values.dtype, np.float32)
    weight = known.astype(kind)
    return smooth(np.where(known, values, 0).astype(kind, copy=False), weight, known, sigma, truncate=SCREEN_REACH)


def screen_left(frequency_per_cm: float, *, sigma_um: float = SCREEN_SIGMA_UM, angle_deg: float = 45.0) -> float:
    """Share of the amplitude of a screen's lines that :func:`without_screen` leaves.

    Parameters
    ----------
    frequency_per_cm : float
        Lines per cm, 60 in usual offset print.
    sigma_um : float
        Standard deviation of the Gaussian.
    angle_deg : float
        Of the screen against the rows of the image. Its two sets of lines lie at right angles, and the same is left of
        both.

    Returns
    -------
    float
        Of the fundamental wave; less is left of its harmonics. A screen of 60 lines per cm at 45 degrees keeps 3 %.

    Raises
    ------
    SizeError
        If frequency or sigma is not above 0.
    """
    if not (0 < frequency_per_cm < math.inf and 0 < sigma_um < math.inf and math.isfinite(angle_deg)):
        raise SizeError(
            f"A screen of {frequency_per_cm:g} lines per cm at {angle_deg:g} degrees and a Gaussian of {sigma_um:g} um "
            "mean nothing. Give a frequency and a sigma above 0."
        )
    wave = 2 * math.pi * frequency_per_cm * 1e-4 * sigma_um  # radians per sigma
    angle = math.radians(angle_deg)
    return abs(_transfer(wave * math.cos(angle)) * _transfer(wave * math.sin(angle)))


def _transfer(wave: float) -> float:
    """Fourier transform of a Gaussian of sigma 1 that is cut at 3, over its value at 0."""
    inside = complex(special.erf(complex(SCREEN_REACH, wave) / math.sqrt(2.0))).real
    return math.exp(-wave * wave / 2) * inside / math.erf(SCREEN_REACH / math.sqrt(2.0))


def smooth(
    values: NDArray[Any], weight: NDArray[Any], known: NDArray[np.bool_], sigma: list[float], *, truncate: float
) -> NDArray[np.floating[Any]]:
    """Gaussian mean (sigma in pixels) over known values, which are 0 elsewhere; NaN where nothing is known."""
    total = ndimage.gaussian_filter(values, sigma, mode="constant", truncate=truncate)
    full = ndimage.gaussian_filter(weight, sigma, mode="constant", truncate=truncate)
    return np.divide(total, full, out=np.full_like(total, np.nan), where=known)


def pixel_of(values: NDArray[Any], pixel_um: float | tuple[float, float]) -> tuple[float, float]:
    """Return the size of a pixel along y and x, if the image is one of numbers."""
    if values.ndim != 2 or values.dtype.kind not in "fiub":
        raise InputError(f"The image is {values.shape} values of {values.dtype}. Give one of numbers, (rows, cols).")
    try:
        down, across = (float(v) for v in (pixel_um if isinstance(pixel_um, tuple) else (pixel_um, pixel_um)))
    except (TypeError, ValueError):
        down = across = math.nan
    if not (0 < down < math.inf and 0 < across < math.inf):
        raise SizeError(f"The pixel is {pixel_um!r} um. Give one number above 0, or two: along y and x.")
    return down, across


def known_of(values: NDArray[Any], mask: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Return where an image is known and counts; there has to be such a place."""
    known = np.isfinite(values)
    if mask is not None:
        if mask.dtype.kind != "b" or mask.shape != values.shape:
            raise InputError(
                f"The mask is {mask.shape} values of {mask.dtype}, the image {values.shape}. Give true or false for "
                "every pixel."
            )
        known &= mask
    if not known.any():
        raise CannotMeasure("No pixel of the image is known and counts. Check the mask.")
    return known
