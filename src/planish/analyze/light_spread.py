"""A coating as an image shows it where light spreads in the paper before it comes out again."""

import math
from functools import partial

import numpy as np
from scipy import fft

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import PointsCorrelation, correlate, valid_pixels
from planish.analyze.differences import paired_difference
from planish.core.area import area_mean, square_px
from planish.core.errors import CannotMeasure, PlanishError, SizeError
from planish.core.facts import NULL, DescribedModel, Interval, Value
from planish.core.grid import shorter_side_um
from planish.core.typing import Array, Entries, Floats, Pixel
from planish.texture.spectra import frequencies_of, padded_shape, padded_spectrum


class _Spread(DescribedModel):
    width_um: float
    """Length over which the point spread function falls to 1/e, as it was given."""


class LightSpread(PointsCorrelation, _Spread):
    """The headline correlation with the coating blurred as light is that spreads in paper."""

    difference: Value = NULL
    """This r minus that of the coating as it is, at the same points."""
    difference_interval: Interval = NULL
    """95 % interval of the difference."""
    reason: str | None = None
    """Why there is no such r."""


def spread_light(values: Array, *, pixel_um: Pixel, width_um: float) -> Floats:
    """Blur a map as light is that spreads in the paper, over the pixels that are known.

    Parameters
    ----------
    values : ndarray, shape (rows, cols), such as the thickness of a coating; NaN is missing
    pixel_um : float or (float, float), along y and x
    width_um : float
        Length over which the point spread function falls to 1/e. It has to be known from elsewhere:
        widths of 150 to 350 um are stated for papers, and a single number does not describe a paper
        well.

    Returns
    -------
    ndarray of float64, shape (rows, cols)
        NaN where the map is not known.

    Raises
    ------
    InputError
        If the map is none of numbers.
    SizeError
        If the width is not above 0, or as large as the field.
    CannotMeasure
        If no pixel is known.

    Notes
    -----
    The point spread function ``exp(-r / w) / (2 pi w^2)`` has the transfer function ``(1 + (2 pi w
    f)^2)^(-3/2)``, by which the spectrum is multiplied. The map and what is known of it are treated
    alike and divided by each other, so that a map that is constant stays so; along borders and
    holes the mean leans to one side.

    Examples
    --------
    >>> spot = np.zeros((41, 41))
    >>> spot[20, 20] = 1.0
    >>> spread = spread_light(spot, pixel_um=10.0, width_um=50.0)
    >>> bool(spread[20, 20] > spread[20, 25] > spread[20, 30] > 0)
    True
    """
    is_valid, pixel = valid_pixels(values, values, pixel_um)
    side_um = shorter_side_um(values.shape, pixel)
    if not 0 < width_um < side_um:
        raise SizeError(
            f"Light would spread over {width_um:g} um; the map is {side_um:g} um wide. Give a width"
            " above 0, below that."
        )
    if not is_valid.any():
        raise CannotMeasure("No pixel of the map is known and counts. Look at the mask.")
    # Padded by ten widths: what wraps around has fallen to 5e-5.
    ten_widths_px = np.ceil(np.divide(10.0 * width_um, pixel))
    reach = np.minimum(ten_widths_px, values.shape)
    shape = padded_shape(values.shape, reach.astype(np.intp).tolist())
    turns = 2 * math.pi * width_um * frequencies_of(shape, pixel)
    transfer = (1.0 + turns**2) ** -1.5
    mean = np.mean(values[is_valid], dtype=np.float64)
    rows, cols = values.shape
    centred = np.where(is_valid, values - mean, 0.0)
    spread: list[Floats] = []
    for m in (centred, is_valid.astype(np.float64)):
        spectrum = padded_spectrum(m, shape) * transfer
        padded = np.asarray(fft.irfft2(spectrum, shape))
        spread.append(padded[:rows, :cols])
    blurred, weight = spread
    unknown = np.full(values.shape, np.nan)
    return mean + np.divide(blurred, weight, out=unknown, where=is_valid)


def answer_light_spread(pair: ComparedMaps) -> Entries:
    """Correlate an image with a coating blurred as light is.

    It stands beside the coating as it is, at the same points: with the difference of both r. The
    answer is the reason where that cannot be; nothing where the study states no width, or the pair
    is no coating on an image.
    """
    width_um = pair.params.light_spread_um
    point_um = pair.point_um
    cell_um = pair.cell_um
    if width_um is None or not pair.is_coat_on_image:
        return {}
    build_result = partial(LightSpread, width_um=width_um, point_um=point_um)
    if pair.why_no_points:
        return {"light_spread": build_result(reason=pair.why_no_points)}
    try:
        blurred = spread_light(pair.x, pixel_um=cell_um, width_um=width_um)
        blurred_points = area_mean(blurred, square_px(point_um, cell_um))
        points = pair.points
        blurred_pair = (blurred_points, points[1])
        correlation = correlate(*blurred_pair, pixel_um=point_um)
        difference = paired_difference(points, blurred_pair, pixel_um=point_um)
    except PlanishError as error:
        return {"light_spread": build_result(reason=error.text)}
    if math.isnan(correlation.r):
        reason = " ".join(correlation.warnings)
        return {"light_spread": build_result(n=correlation.n, reason=reason)}
    stated = LightSpread.of(
        correlation,
        **build_result.keywords,
        difference=difference.difference,
        difference_interval=difference.interval,
    )
    return {"light_spread": stated}
