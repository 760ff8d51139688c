"""An image as it is compared: its grey as reflectance where two references are known, and without a print screen."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.analyze import SCREEN_REACH, SCREEN_SIGMA, without_screen
from planish.io.params import ImageParams
from planish.results import ImageFacts

REFLECTANCE = "Reflectance"
"""What the values of an image are where a dark and a white reference are known."""


def compared_image(
    image: xr.DataArray, params: ImageParams, *, mask: NDArray[np.bool_] | None = None
) -> xr.DataArray:  # fmt: skip
    """Turn grey into reflectance and take the screen off, as far as the options say so.

    Parameters
    ----------
    image : DataArray (y, x)
        Of :func:`planish.read_image`.
    params : ImageParams
    mask : ndarray of bool, optional
        Pixels that may count for their neighbours when the screen is taken off; the others become NaN.

    Returns
    -------
    DataArray (y, x)
        The image itself where there is nothing to do. Its attribute ``reach_um`` says how far a pixel reached for its
        neighbours.

    Raises
    ------
    SizeError
        If the pixels are too large for the Gaussian that takes the screen off.
    CannotMeasure
        If no pixel is known.
    """
    values, title = image.values, str(image.attrs.get("long_name", "Image"))
    if params.dark_grey is None and params.screen_um is None:
        return image
    more: dict[str, object] = {}
    if params.dark_grey is not None and params.white_grey is not None:
        values = (values - np.float32(params.dark_grey)) / np.float32(params.white_grey - params.dark_grey)
        _, comma, channel = title.partition(", ")
        title = f"{REFLECTANCE}{comma}{channel}"
    if params.screen_um is not None:
        pixel = float(image.attrs["pixel_um"][0]), float(image.attrs["pixel_um"][1])
        values = without_screen(values, pixel_um=pixel, sigma_um=_sigma_um(params.screen_um), mask=mask)
        title = f"{title}, without its screen"
        more["reach_um"] = reach_um(params)
    return image.copy(data=values).assign_attrs(long_name=title, **more)


def reach_um(params: ImageParams | None) -> float:
    """How far the Gaussian reaches that takes the screen off; 0 without one."""
    return 0.0 if params is None or params.screen_um is None else SCREEN_REACH * _sigma_um(params.screen_um)


def image_facts(params: ImageParams) -> ImageFacts:
    """What the values of an image are."""
    given = params.dark_grey is not None
    screen = {} if params.screen_um is None else {"sigma_um": _sigma_um(params.screen_um), "reach_um": reach_um(params)}
    return ImageFacts(
        quantity="reflectance" if given else "relative grey", dark_grey=params.dark_grey, white_grey=params.white_grey,
        screen_um=params.screen_um, **screen,
    )  # fmt: skip


def _sigma_um(screen_um: float) -> float:
    return SCREEN_SIGMA * screen_um
