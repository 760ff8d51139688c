"""Print mottle by the size of its clouds.

How much the reflectance varies, octave by octave of wavelength.

Made after the idea of ISO/IEC 24790 and ISO 15311, unevenness by ranges of wavelength, but conforms
to neither.
"""

import math

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from planish.analyze.image_values import known_pixels, smooth
from planish.core.area import common_means
from planish.core.errors import CannotMeasure, PlanishError, SizeError
from planish.core.facts import NULL, DescribedModel, Value
from planish.core.grid import Grid, shorter_side_um
from planish.core.numbers import in_words
from planish.core.typing import Pixel, pair_of

# Sigma of the Gaussian that halves a wave, over its length.
_HALF = math.sqrt(math.log(2.0) / 2) / math.pi
# Rms that a band keeps of waves that are alike in every octave.
_OCTAVE = math.sqrt(math.log2(25 / 16) / 2)


class MottleBand(DescribedModel):
    """How uneven an image is in one octave of wavelength."""

    shortest_um: float
    """Shortest wave of the octave."""
    longest_um: float
    """Longest wave of the octave."""
    coefficient_of_variation: float
    """Standard deviation of the octave over the mean."""


class Mottle(DescribedModel):
    """How uneven an image is, by octaves of wavelength.

    After the idea of ISO/IEC 24790 and ISO 15311.
    """

    layer: str = ""
    """Name of the layer."""
    bands: tuple[MottleBand, ...] = ()
    """From the longest waves to the shortest."""
    mean: Value = NULL
    """Of the image."""
    n: int | None = None
    """Pixels, or means over several, that are known."""
    measured: str | None = None
    """What the values are of."""
    reason: str | None = None
    """Why there is none."""


def print_mottle(
    reflectance: ArrayLike,
    *,
    pixel_um: Pixel,
    shortest_um: float = 250.0,
    longest_um: float | None = None,
    quantity: str = "reflectance",
) -> Mottle:
    """Coefficient of variation of the reflectance in octaves of wavelength.

    Parameters
    ----------
    reflectance : array_like, shape (rows, cols)
        Of a print that should be even, above the dark level; NaN is missing.
    pixel_um : float or (float, float), along y and x
    shortest_um : float
        Where the first octave begins; not below 4 pixels. A halftone screen lies below 250 um.
    longest_um : float
        No octave goes beyond it. By default, and at most, a fifth of the shorter side of the image.
    quantity : str; what the values are, for the sentence of what was measured

    Returns
    -------
    Mottle

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`; if no octave lies between the shortest and the longest wave.
    CannotMeasure
        If no pixel is known, or the mean is not above 0.

    Notes
    -----
    A band is the difference of two Gaussian means over the known pixels, each of which halves the
    waves at one end. It passes at most 0.47 of a wave, and a little of those in the next octaves;
    the standard deviation is divided by 0.567, so that an image with the same variance in every
    octave is given just that variance. A single wave in a band therefore counts by 0.83 or less.
    Scatter between fields is large for long waves: a field has about as many independent clouds of
    a band as squares of its wavelength.

    Along borders and holes the means lean to one side, and a band is given a little too much.

    Examples
    --------
    >>> image = 0.5 + 0.01 * np.random.default_rng(0).normal(size=(200, 300))
    >>> [(b.shortest_um, b.longest_um) for b in print_mottle(image, pixel_um=40.0).bands]
    [(250.0, 500.0), (500.0, 1000.0)]
    """
    image, is_valid, pixel = known_pixels(reflectance, None, pixel_um)
    least_um = 4.0 * max(pixel)  # shorter ones are no waves on a grid
    # Of longer waves a field has too few.
    most_um = 0.2 * shorter_side_um(image.shape, pixel)
    limit_um = most_um if longest_um is None else longest_um
    is_wave = least_um <= shortest_um < math.inf
    holds_octave = is_wave and 2 * shortest_um <= limit_um * (1 + 1e-9)
    if not (holds_octave and limit_um <= most_um * (1 + 1e-9)):
        raise SizeError(
            f"No octave lies between waves of {shortest_um:g} and {limit_um:g} um: this image shows"
            f" waves from {least_um:g} um (4 pixels) to {most_um:g} um (a fifth of its shorter"
            " side), and an octave ends at twice its beginning. Take other wavelengths, smaller"
            " pixels or a larger field."
        )
    n_octaves = math.floor(math.log2(limit_um / shortest_um) + 1e-9)
    edges = [shortest_um * 2.0**k for k in range(n_octaves + 1)]
    mean = image[is_valid].mean(dtype=np.float64)
    if not mean > 0:
        raise CannotMeasure(
            f"The mean of the image is {mean:.3g}; variation relative to it needs one above 0. Give"
            " reflectance, not its difference from a mean."
        )
    # First, so that rounding is that of the variation.
    values = np.where(is_valid, image - mean, 0.0)
    weight = is_valid.astype(np.float64)
    bands: list[MottleBand] = []
    fine = np.zeros(0)  # the mean of shorter waves; nothing before the first one
    for edge_um in edges:
        sigma = [_HALF * edge_um / p for p in pixel]
        coarse = smooth(values, weight, is_valid, sigma, truncate=4.0)[is_valid]
        if fine.size:
            cov = (fine - coarse).std() / _OCTAVE / mean
            band = MottleBand(
                shortest_um=edge_um / 2, longest_um=edge_um, coefficient_of_variation=cov
            )
            bands.append(band)
        fine = coarse
    n = int(np.count_nonzero(is_valid))
    measured = (
        f"Coefficient of variation of the {in_words(quantity)} in octaves from {edges[0]:g}"
        f" to {edges[-1]:g} um, as differences of Gaussian means over {n} pixels; after ISO/IEC"
        " 24790 and ISO 15311, conforming to neither."
    )
    return Mottle(bands=tuple(bands), mean=mean, n=n, measured=measured)


def mottle_of(name: str, data: xr.Dataset, *, quantity: str) -> Mottle:
    """How uneven an image is over its valid pixels, or why that cannot be said.

    Parameters
    ----------
    name : str; of the layer
    data : Dataset, dims (y, x)
        ``image`` and ``valid``.
    quantity : str; what the values are

    Returns
    -------
    Mottle
    """
    grid = Grid.of(data)
    # Means over up to 15 um keep 0.99 of the shortest waves.
    factor = max(1, int(15.0 / max(grid.pixel_um)))
    masks = [data["valid"]]
    (image,) = common_means([data["image"]], (factor, factor), masks=masks)
    cell_um = pair_of(np.multiply(grid.pixel_um, factor))
    try:
        mottle = print_mottle(image, pixel_um=cell_um, quantity=quantity)
    except PlanishError as error:
        return Mottle(layer=name, reason=error.text)
    return Mottle.holding(mottle, layer=name)
