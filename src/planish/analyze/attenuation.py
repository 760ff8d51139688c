"""The attenuation limit: r of a perfect relation, as misplacement, points and noise lower it."""

import math

import numpy as np
from scipy import fft

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import check_varying, valid_pixels
from planish.analyze.split_half import reliability_of
from planish.core.arrays import values_of
from planish.core.bands import thinned
from planish.core.errors import InputError
from planish.core.typing import Array, Entries, Floats, Pixel
from planish.texture.covariance import Lags, covariance_of

_QUANTILES = 16  # of the errors of a map


def attenuation_limit(
    a: Array,
    *,
    error_um: float | Array,
    pixel_um: Pixel,
    point_um: float | None = None,
) -> float:
    """State the r that a map would have with itself, displaced by the error of its place.

    Parameters
    ----------
    a : ndarray, shape (rows, cols); the map whose texture is compared; NaN is missing
    error_um : float or ndarray
        Error of a place, root mean square of its length, as ``expected_error`` gives it: one, a map
        of it (rows, cols), or any number of values that stand for such a map.
    pixel_um
        As of :func:`planish.correlate`.
    point_um : float, optional; size of the points that r is of; single pixels where not given

    Returns
    -------
    float
        What misplacement leaves of r = 1.

    Raises
    ------
    InputError
        If the error is no number from 0 on.
    CannotMeasure
        If the map is constant or has no valid pixel.

    Notes
    -----
    Displaced by a random d, a map keeps the mean of its autocorrelation over d, of a Gaussian of
    this error; for larger points the autocovariance is averaged over a point twice first. An error
    that varies over the map is averaged over its quantiles.

    Examples
    --------
    >>> a = np.sin(np.arange(200) * 10.0 / 40.0) * np.ones((60, 1))
    >>> round(attenuation_limit(a, error_um=20.0, pixel_um=10.0), 2)
    0.94
    """
    is_valid, pixel = valid_pixels(a, a, pixel_um)
    errors = values_of(error_um, "error_um").astype(np.float64)
    if errors.shape == is_valid.shape:
        errors = errors[is_valid & np.isfinite(errors)]
    are_lengths = np.isfinite(errors) & (errors >= 0)
    if not (errors.size and are_lengths.all()):
        raise InputError(
            "The error of the places is not known. Give a number of um from 0 on, or a map of it."
        )
    check_varying(is_valid, a=a)
    covariance = covariance_of(a, Lags(is_valid, pixel))
    spectrum = np.asarray(fft.fft2(covariance)).real
    rows, cols = covariance.shape
    along_y = fft.fftfreq(rows, pixel[0])
    along_x = fft.fftfreq(cols, pixel[1])
    if point_um is not None:
        point = np.outer(np.sinc(along_y * point_um), np.sinc(along_x * point_um))
        spectrum *= point**2
    # Radians a um, for each wave.
    turns = 2 * math.pi * np.hypot(along_y[:, None], along_x)
    quantiles = errors.ravel()
    if errors.size > 1:
        levels = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
        quantiles = np.quantile(errors, levels)
    blurred: list[float] = []
    for error in quantiles:
        # Along an axis the standard deviation is the error over the square root of 2.
        transfer = np.exp(-((error * turns / 2) ** 2))
        blurred.append(np.sum(spectrum * transfer))
    limit = np.mean(blurred) / np.sum(spectrum)
    return float(np.clip(limit, 0.0, 1.0))


def answer_attenuation(pair: ComparedMaps) -> Entries:
    """Give the r that a perfect relation would show.

    By misplacement, by the noise of two half measurements, and by both, which multiply. Each only
    where it is known. The errors of places stand as 65 quantiles, from the least to the largest.
    """
    answers = _by_noise(pair)
    errors_um = _errors_of_places(pair)
    if not errors_um.size:
        return answers
    error_um = np.quantile(errors_um, np.linspace(0, 1, 65))
    point_um = pair.point_um if pair.has_points else None
    limit = attenuation_limit(pair.x, error_um=error_um, pixel_um=pair.cell_um, point_um=point_um)
    answers["attenuation_limit"] = limit
    if "attenuation_limit_noise" in answers:
        answers["attenuation_limit_both"] = limit * answers["attenuation_limit_noise"]
    return answers


def _by_noise(pair: ComparedMaps) -> Entries:
    """Reliability of the maps of sheets at the larger points, and the limit that follows from it.

    The limit is the root of the product of both shares of variance; an image has no halves and
    counts as without noise.
    """
    measured = [key for key in (pair.a, pair.b) if key[0] in pair.columns]
    if not (measured and pair.has_points):
        return {}
    reliabilities = tuple(reliability_of(pair, layer, name) for layer, name in measured)
    answers: Entries = {"reliability": reliabilities}
    noise_r = math.sqrt(math.prod(reliability.value for reliability in reliabilities))
    if not math.isnan(noise_r):
        answers["attenuation_limit_noise"] = noise_r
    return answers


def _errors_of_places(pair: ComparedMaps) -> Floats:
    """Errors of the places of all layers together, at some pixels; empty where none is stated."""
    error_maps = [m["expected_error"] for m in pair.layers if "expected_error" in m]
    if not error_maps:
        return np.empty(0)
    thinned_maps = [thinned(m)[1][0] for m in error_maps]
    errors = np.array(thinned_maps, dtype=np.float64)
    errors_um = np.linalg.norm(errors, axis=0)
    return errors_um[np.isfinite(errors_um)]
