"""The values of an image as they are compared.

Grey as reflectance, and without a print's halftone screen.
"""

import math
from functools import partial
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from planish.analyze.correlation import valid_pixels
from planish.core.arrays import values_of
from planish.core.errors import CannotMeasure, SizeError
from planish.core.facts import DescribedModel, Number
from planish.core.typing import Array, Bools, Pair, Pixel, pair_of
from planish.io.light import LightFacts
from planish.io.params import ImageParams
from planish.io.tone import Gamma, linear_grey

SCREEN_SIGMA_UM = 70.0
"""Standard deviation of the Gaussian: 6 of them are the 420 um of Hirn et al.

(2009), section 3.3.2.
"""

SCREEN_SIGMA = SCREEN_SIGMA_UM * 60 / 1e4
"""The same as a share of the period of the screen that it was for, 60 lines per cm."""

SCREEN_REACH = 3.0
"""Standard deviations to either side at which the Gaussian ends."""


class ImageFacts(DescribedModel):
    """What the values of an image are that is compared."""

    quantity: Literal["grey value, uncalibrated", "reflectance", "reflectance, up to a factor"]
    """What the grey is taken for."""
    gamma: Gamma | None = None
    """Curve or exponent that was undone, if one was given."""
    light: LightFacts | None = None
    """White and dark image, if they were given."""
    dark_grey: Number = None
    """Grey of the dark reference, if it was given."""
    white_grey: Number = None
    """Grey of the white reference, whose reflectance counts as 1."""
    screen_um: Number = None
    """Period of the print screen that was taken off, if it was given."""
    sigma_um: Number = None
    """Standard deviation of the Gaussian that took it off."""
    reach_um: Number = None
    """How far it reaches: so much more around holes is not valid."""

    @property
    def sentence(self) -> str:
        """What a reader has to know of the values."""
        if self.light is not None:
            text = self.light.sentence
        elif self.quantity == "reflectance":
            text = f"reflectance: grey {self.dark_grey:g} is 0, grey {self.white_grey:g} is 1"
        else:
            text = "grey value, uncalibrated: no dark and white reference was given"
        if self.gamma == 1:
            text += "; grey is linear, as given"
        elif self.gamma is not None:
            text += f"; grey was made linear first, by the curve {self.gamma}"
        if self.screen_um is not None:
            text += (
                f"; the print screen of {self.screen_um:g} um was taken off by a Gaussian (sigma"
                f" {self.sigma_um:.3g} um) before anything was compared, and {self.reach_um:.3g} um"
                " more around holes are left out"
            )
        return text


def image_facts(params: ImageParams, light: LightFacts | None = None) -> ImageFacts:
    """What the values of an image are.

    Parameters
    ----------
    params : ImageParams; how the image is read
    light : LightFacts, optional; of its white and dark image

    Returns
    -------
    ImageFacts
    """
    screen_um = params.screen_um
    quantity = "grey value, uncalibrated" if params.dark_grey is None else "reflectance"
    if light is not None:
        quantity = light.quantity
    sigma_um = None
    if screen_um is not None:
        sigma_um = SCREEN_SIGMA * screen_um
    return ImageFacts(
        quantity=quantity,
        gamma=params.gamma,
        light=light,
        dark_grey=params.dark_grey,
        white_grey=params.white_grey,
        screen_um=screen_um,
        reach_um=reach_um(params) or None,
        sigma_um=sigma_um,
    )


def compared_image(
    image: xr.DataArray, params: ImageParams, *, mask: Bools | None = None
) -> xr.DataArray:
    """Turn grey into reflectance and take the screen off, as far as the options say so.

    Parameters
    ----------
    image : DataArray (y, x), of :func:`planish.read_image`
    params : ImageParams
    mask : ndarray of bool
        Pixels that may count for their neighbours when the screen is taken off; the others become
        NaN.

    Returns
    -------
    DataArray (y, x)
        The image itself where there is nothing to do. Attribute ``reach_um``: how far a pixel
        reached for neighbours.

    Raises
    ------
    SizeError
        If the pixels are too large for the Gaussian that takes the screen off.
    CannotMeasure
        If no pixel is known.
    """
    if params.dark_grey is None and params.screen_um is None:
        return image
    values = image.values
    title = str(image.attrs.get("long_name", "Image"))
    more: dict[str, object] = {}
    if params.dark_grey is not None and params.white_grey is not None:
        references = [params.dark_grey, params.white_grey]
        dark, white = linear_grey(references, params.gamma, image.attrs.get("full_scale"))
        values = (values - np.float32(dark)) / np.float32(white - dark)
        _, comma, channel = title.replace(", uncalibrated", "").partition(", ")
        title = f"Reflectance{comma}{channel}"
    if params.screen_um is not None:
        stated_um = np.asarray(image.attrs["pixel_um"], dtype=np.float64)
        pixel = pair_of(stated_um)
        sigma_um = SCREEN_SIGMA * params.screen_um
        values = without_screen(values, pixel_um=pixel, sigma_um=sigma_um, mask=mask)
        title = f"{title}, without its screen"
        more["reach_um"] = reach_um(params)
    return image.copy(data=values).assign_attrs(long_name=title, **more)


def reach_um(params: ImageParams | None) -> float:
    """How far the Gaussian reaches that takes the screen off; 0 without one."""
    if params is None or params.screen_um is None:
        return 0.0
    return SCREEN_REACH * (SCREEN_SIGMA * params.screen_um)


def without_screen(
    image: ArrayLike,
    *,
    pixel_um: Pixel,
    sigma_um: float = SCREEN_SIGMA_UM,
    mask: Bools | None = None,
) -> NDArray[np.floating[Any]]:
    """Average an image with a Gaussian, over the pixels that are known.

    Before it is averaged over points.

    Parameters
    ----------
    image : array_like, shape (rows, cols); reflectance or grey; NaN is missing
    pixel_um : float or (float, float), along y and x
    sigma_um : float; standard deviation of the Gaussian, which is cut at 3 of them
    mask : ndarray of bool, shape (rows, cols), optional; pixels that count

    Returns
    -------
    ndarray, shape (rows, cols)
        NaN where the image is not known. Single precision of an image of single precision or of 8
        or 16 bits.

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`; if the Gaussian is narrower than 0.75 pixels.
    CannotMeasure
        If no pixel is known.

    Notes
    -----
    Sum of the known values over sum of their weights: a map that is constant stays so up to its
    border. The kernel is not symmetric there, though, and more of the screen is left than
    elsewhere: keep 3 sigma off holes and borders where the last percent counts. The kernel is cut
    at the pixel nearest to 3 sigma, along either axis.

    Examples
    --------
    >>> screen = 0.5 + 0.2 * np.sin(2 * np.pi * np.arange(200) / 17) * np.ones((100, 1))
    >>> flat = without_screen(screen, pixel_um=10.0)
    >>> round(float(screen.std()), 2), round(float(flat[30:-30, 30:-30].std()), 3)
    (0.14, 0.005)
    """
    values, valid, pixel = known_pixels(image, mask, pixel_um)
    sigma = [sigma_um / p for p in pixel]
    if not (math.isfinite(sigma_um) and min(sigma) >= 0.75):
        raise SizeError(
            f"A Gaussian of {sigma_um:g} um is {min(sigma):.2g} pixels wide; it needs 0.75. Take a"
            " larger sigma_um, or an image with smaller pixels."
        )
    kind = np.result_type(values.dtype, np.float32)
    grey = np.where(valid, values, 0).astype(kind, copy=False)
    return smooth(grey, valid.astype(kind), valid, sigma, truncate=SCREEN_REACH)


def smooth(
    values: Array, weight: Array, is_valid: Bools, sigma: list[float], *, truncate: float
) -> NDArray[np.floating[Any]]:
    """Gaussian mean over known values (rows, cols), which are 0 elsewhere.

    ``weight`` is 1 where a value is known and 0 elsewhere, ``sigma`` in pixels along y and x, and
    ``truncate`` how many of them the Gaussian reaches. NaN where ``is_valid`` is false.
    """
    gaussian = partial(ndimage.gaussian_filter, sigma=sigma, mode="constant", truncate=truncate)
    total = gaussian(values)
    full = gaussian(weight)
    return np.divide(total, full, out=np.full_like(total, np.nan), where=is_valid)


def known_pixels(
    image: ArrayLike, mask: Bools | None, pixel_um: Pixel
) -> tuple[Array, Bools, Pair]:
    """The values of an image, where they are known and count, and the pixel along y and x."""
    values: Any = image if isinstance(image, xr.DataArray) else values_of(image, "image")
    is_valid, pitch_um = valid_pixels(values, values, pixel_um, mask)
    if not is_valid.any():
        raise CannotMeasure("No pixel of the image is known and counts. Check the mask.")
    return np.asarray(values), is_valid, pitch_um
