"""An image in even light: over that of a white sheet, both less what the camera gives in the dark.

In: an image (y, x) in linear grey; ``white``, a picture of a white sheet with the same camera,
lens and light; ``dark``, one without light (0 where there is none). Both have the pixels of the
image, or fewer over the same field of view. Out: :class:`CorrectedImage` with the reflectance
``(image - dark) / (white - dark)``, the factor it was divided by, why a pixel is not valid, and
what was found.

White and dark are smoothed as far as their own noise asks. At each pixel that mean is taken, of
none to 129 pixels, whose expected squared error is least by Stein's estimate, which needs no more
than the noise. A light that falls off is averaged over many pixels, a speck of dust over few.

C. M. Stein, Ann. Stat. 9, 1135 (1981), doi:10.1214/aos/1176345632.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import xarray as xr
from scipy import ndimage

from planish.core.arrays import check_image, values_of
from planish.core.errors import InputError
from planish.core.facts import DescribedModel, Number, optional
from planish.core.typing import Entries, Shape, Singles, Texts
from planish.io.hashes import fingerprint
from planish.io.image import read_image

if TYPE_CHECKING:
    from planish.io.params import ImageParams

LIGHT = "light"
"""Begin of the names of groups of a run that hold the light of an image, `light/NAME`."""

MEASURED, SATURATED, WHITE_SATURATED, TOO_DARK, MISSING = range(5)
STATES = ("measured", "saturated", "white_saturated", "too_dark", "missing")
"""Why a pixel of the image is valid or not, by its code in ``status``."""

_WIDTHS = (3, 5, 9, 17, 33, 65, 129)  # pixels of the means that are tried
_WINDOW = 17  # pixels over which their errors are estimated
_BLOCK = 16  # pixels of a block of which the noise is the median
_LAG = 4  # pixels, beyond the correlation that colour filters leave in the noise
_DARKEST = 3.0  # standard deviations of a pixel's noise: less light cannot be told from none

Grey = Singles


class LightFacts(DescribedModel):
    """White and dark image, and what they did to an image."""

    files: Texts
    """Name of the white image, and of the dark one."""
    hashes: Texts = ()
    """Their hashes, where they were read."""
    exposure: Number = optional(
        "Exposure of the white image over that of the image; null where not known: reflectance is"
        " then known up to a factor."
    )
    fall_off: float
    """How much less light the darkest hundredth of the image gets than the lightest."""
    standard_error: float
    """What noise of white and dark adds to a pixel's reflectance, root mean square."""
    texture: float
    """Variance of the light's fine contrast over the image's."""
    median: float
    """Median reflectance of the valid pixels."""
    shares: dict[str, float]
    """Share of the image's pixels by their state."""

    @property
    def quantity(self) -> Literal["reflectance", "reflectance, up to a factor"]:
        """What the corrected image holds."""
        return "reflectance, up to a factor" if self.exposure is None else "reflectance"

    @property
    def sentence(self) -> str:
        """What a reader has to know of the values."""
        white, *dark = self.files
        text = f"{self.quantity}: grey over that of {white}, the white sheet"
        text += f", both less {dark[0]}, without light" if dark else "; the dark was taken as 0"
        if self.exposure is None:
            text += "; their exposures are not known, so that levels mean nothing, and r is right"
        elif self.exposure != 1:
            text += f", exposed {self.exposure:.3g} times as long as the image"
        text += f"; the light falls off by {100 * self.fall_off:.0f} %"
        if self.median > 0:
            noise_text = f"{100 * self.standard_error / self.median:.2f} %"
            text += f", and noise of the white image adds {noise_text} to a grey"
        return text


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedImage:
    """An image in even light, and what made it so."""

    image: xr.DataArray
    """Reflectance (y, x); NaN where the white gives no factor, saturated pixels as they are."""
    light: xr.Dataset
    """``factor`` (y, x), white less dark over its median, and ``status``, codes of `STATES`."""
    facts: LightFacts

    @property
    def valid(self) -> xr.DataArray:
        """The image without its saturated pixels, as it is compared."""
        return self.image.where(self.light["status"] == MEASURED)


def correct_light(
    image: xr.DataArray, *, white: Any, dark: Any = None, exposure: float | None = None
) -> CorrectedImage:
    """Divide an image by that of a white sheet, both less the dark image.

    Parameters
    ----------
    image : DataArray (y, x)
        Linear grey, of :func:`planish.read_image` or :func:`planish.image`.
    white, dark : DataArray or array (rows, cols)
        A white sheet and no light, in linear grey. Of the image's shape, or of fewer pixels over
        the same field of view, between which is interpolated.
    exposure : float, optional
        Exposure of the white over that of the image; where not given, reflectance is known up to a
        factor.

    Returns
    -------
    CorrectedImage

    Raises
    ------
    InputError
        If shapes differ, a picture is given twice or has no numbers, the white is not lighter than
        the dark, or the exposure is no number above 0.

    Notes
    -----
    The gain of single pixels is noise of the white, and smoothed with it. Between pixels of a
    smaller white the light is linear.
    """
    check_image(image, "pl.correct_light({}, white=white)")
    grey = np.asarray(image.values)
    sources = {"white": white} if dark is None else {"white": white, "dark": dark}
    pictures = {name: np.array(values_of(m, name), np.float32) for name, m in sources.items()}
    _check_pictures(grey, pictures)
    white_grey = pictures["white"]
    dark_grey = pictures.get("dark", np.zeros((2, 2), np.float32))
    factor = 1.0 if exposure is None else exposure
    if not 0 < factor < math.inf:
        raise InputError(
            f"The exposure of the white image is {factor:g} times that of the image. Give a"
            " number above 0, or leave it out: reflectance is known up to a factor then."
        )
    is_missing = np.isnan(grey)
    for picture in (white_grey, dark_grey):
        is_unknown = ~np.isfinite(picture)
        picture[is_unknown] = np.nan
        is_missing |= resized(is_unknown.astype(np.float32), grey.shape) > 0
    # White and dark without their noise; errors are squared, noise is a variance, in grey².
    field, field_error, field_noise = smooth(white_grey)
    zero, zero_error, zero_noise = smooth(dark_grey)
    zero = resized(zero, grey.shape)
    signal = resized(field, grey.shape) - zero
    level = float(np.median(signal))
    if not level > 0:
        raise InputError(
            f"The white image (median {np.median(field):.4g}) is not lighter than the dark one"
            f" ({np.median(zero):.4g}). Give the white sheet as `white` and the picture without"
            " light as `dark`."
        )
    is_white_saturated = resized(_saturated(white, white_grey), grey.shape) > 0
    status = np.full(grey.shape, MEASURED, np.uint8)
    status[_saturated(image, grey) > 0] = SATURATED
    status[is_white_saturated] = WHITE_SATURATED
    status[signal <= _DARKEST * np.sqrt(field_noise + zero_noise)] = TOO_DARK
    status[is_missing] = MISSING
    if not (status == MEASURED).any():
        raise InputError(
            "No pixel is left: the white image is saturated, dark or missing at all of them. Take"
            " it again, exposed so that its lightest part stays below the end of the scale."
        )
    signal[status > SATURATED] = np.nan
    reflectance = (grey - zero) / signal
    # Of (image - dark) / (white - dark), by its derivatives.
    white_part = reflectance**2 * resized(field_error, grey.shape)
    dark_part = (1 - reflectance) ** 2 * resized(zero_error, grey.shape)
    variance = (white_part + dark_part) / signal**2
    reflectance *= factor
    is_valid = status == MEASURED
    lowest, highest = np.nanpercentile(signal, [1, 99])
    # Fine contrast of the light and of the image, each over its median; as many pixels of the
    # white apart, where it has fewer.
    lag = _LAG * round(grey.shape[0] / white_grey.shape[0])
    contrast = _noise_variance(signal, lag) / level**2
    variance_of_image = _noise_variance(grey, lag)
    texture = 0.0
    if variance_of_image > 0:
        texture = contrast / variance_of_image * float(np.nanmedian(grey - zero)) ** 2
    names = (getattr(source, "attrs", {}).get("file_name", k) for k, source in sources.items())
    shares = np.bincount(status.ravel(), minlength=len(STATES)) / grey.size
    facts = LightFacts(
        files=tuple(names),
        exposure=exposure,
        fall_off=1 - lowest / highest,
        standard_error=factor * float(np.sqrt(variance[is_valid].mean())),
        texture=texture,
        median=float(np.median(reflectance[is_valid])),
        shares=dict(zip(STATES, shares.tolist(), strict=True)),
    )
    title = str(image.attrs.get("long_name", "")).partition(", uncalibrated")[2]
    title = f"Reflectance{', up to a factor' * (exposure is None)}{title}"
    reflectance = image.copy(data=reflectance).assign_attrs(long_name=title, full_scale=None)
    light = {"factor": image.copy(data=signal / level), "status": image.copy(data=status)}
    light["factor"].attrs = {"long_name": "Light, over its median", "units": "1"}
    light["status"].attrs = {"long_name": "State of the pixel", "flag_meanings": " ".join(STATES)}
    return CorrectedImage(reflectance, xr.Dataset(light), facts)


def read_corrected(params: ImageParams) -> tuple[xr.DataArray, CorrectedImage | None]:
    """Read an image with the options of a study, and correct it by its white image if there is one.

    The image comes as holes are searched in it: with its saturated pixels.
    """
    image = read_image(params.path, **params.how)
    if params.white is None:
        return image, None
    # Their own sizes say nothing: they show the field of view of the image.
    how: Entries = params.how | {"pixel_um": (1.0, 1.0), "override_size": True}
    white = read_image(params.white, **how)
    dark = None if params.dark is None else read_image(params.dark, **how)
    corrected = correct_light(image, white=white, dark=dark, exposure=params.white_exposure)
    hashes = tuple(map(fingerprint, filter(None, (params.white, params.dark))))
    facts = corrected.facts.model_copy(update={"hashes": hashes})
    return corrected.image, replace(corrected, facts=facts)


def smooth(values: Grey) -> tuple[Grey, Grey, float]:
    """Smooth a picture (y, x) as far as its own noise asks.

    Gives it with its squared error at each pixel and the variance of its noise; what is missing
    (NaN) is the median.
    """
    values = np.where(np.isnan(values), np.nanmedian(values), values)
    noise = _noise_variance(values)
    # What is left of the noise in a mean over 9 pixels says how many share it; the lag is beyond
    # these means.
    mean_noise = _noise_variance(_mean(values, 9), lag=32) / _squared_weights(9)
    n_correlated = max(1.0, mean_noise / noise) if noise > 0 else 1.0  # pixels with common noise
    smoothed = values
    error = least_error = np.full_like(values, noise)
    for width in _WIDTHS:
        if 2 * width > min(values.shape):
            break
        mean = _mean(values, width)
        own_share = min(1.0, n_correlated / width**2)  # of a pixel's noise in its mean
        # Stein's estimate of the squared error of the mean.
        square_difference = _mean((values - mean) ** 2, _WINDOW)
        loss = square_difference + noise * (2 * own_share - 1)
        # By the noise alone, below which an estimate may fall by chance.
        mean_error = noise * n_correlated * _squared_weights(width)
        is_better = loss < error
        smoothed = np.where(is_better, mean, smoothed)
        least_error = np.where(is_better, mean_error, least_error)
        error = np.minimum(loss, error)
    return smoothed, np.maximum(error, least_error), noise


def _mean(values: Grey, width: int) -> Grey:
    """Mean with triangular weights, of two means over ``width`` pixels."""
    mean = ndimage.uniform_filter(values, width, mode="nearest")
    return ndimage.uniform_filter(mean, width, mode="nearest")


def _squared_weights(width: int) -> float:
    """Sum of the squared weights of such a mean."""
    return ((2 * width**2 + 1) / (3 * width**3)) ** 2


def _noise_variance(values: Grey, lag: int = _LAG) -> float:
    """Variance of a pixel by its mixed differences, in which no smooth light is left.

    The median over blocks, which specks and edges leave alone; 0 of less than a block.
    """
    rows = values[lag:] - values[:-lag]
    mixed = rows[:, lag:] - rows[:, :-lag]
    n_rows, n_cols = (length // _BLOCK for length in mixed.shape)
    whole_blocks = mixed[: n_rows * _BLOCK, : n_cols * _BLOCK]
    blocks = whole_blocks.reshape(n_rows, _BLOCK, n_cols, _BLOCK)
    # A mixed difference has four times the variance of a pixel.
    variances = (blocks**2).mean((1, 3))
    finite = variances[np.isfinite(variances)]
    if finite.size:
        return float(np.median(finite)) / 4
    return 0.0


def resized(values: Grey, shape: Shape) -> Grey:
    """A picture on more pixels of the same field of view, linear between its own."""
    if values.shape == shape:
        return values
    steps = np.divide(shape, values.shape)
    return ndimage.zoom(values, steps, order=1, mode="nearest", grid_mode=True)


def _check_pictures(image: Grey, pictures: Mapping[str, Grey]) -> None:
    """Raise InputError for shapes that do not fit, and for a picture that is given twice."""
    rows, cols = image.shape
    for name, picture in pictures.items():
        if not np.isfinite(picture).any():
            raise InputError(f"The {name} image has no pixel with a number in it. Export it again.")
        shape_text = " x ".join(map(str, picture.shape))
        # Binning may drop a part of a pixel along each side.
        is_alike = False
        if picture.ndim == 2 and 2 <= len(picture) <= rows:
            expected_cols = cols * len(picture) / rows
            is_alike = abs(picture.shape[1] - expected_cols) <= 1
        if not is_alike:
            raise InputError(
                f"The {name} image has {shape_text or 1} pixels, the image {rows} x {cols}. Needed"
                " is the same field of view, in as many pixels or binned. Crop and bin all alike."
            )
    named_pictures = reversed([("image", image), *pictures.items()])
    for (name, picture), (other, other_picture) in combinations(named_pictures, 2):
        if np.array_equal(picture, other_picture, equal_nan=True):
            raise InputError(
                f"{name} and {other} are the same picture. Give a picture of a white sheet as"
                " `white` and one without light as `dark`."
            )


def _saturated(source: Any, values: Grey) -> Grey:
    """1 where a pixel is at the end of the scale, of the file or of a camera with fewer bits.

    Such a scale ends where ten pixels have the largest value, and three times as many as the rest
    of the last 64th of the range, if that holds a grey.
    """
    full_scale = getattr(source, "attrs", {}).get("full_scale")
    highest = float(np.nanmax(values))
    last_part = (highest - float(np.nanmin(values))) / 64
    at_end = values == highest
    near = np.count_nonzero(values >= highest - last_part)
    is_spike = last_part >= 1 and np.count_nonzero(at_end) >= max(10, 0.75 * near)
    return (at_end & (is_spike or highest == full_scale)).astype(np.float32)
