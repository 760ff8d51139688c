"""Statistics that outliers and missing values do not spoil.

Scatter, percentiles, and sums under a Gaussian.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.typing import Array, Bools, Floats, Shape

MAD_TO_SD = 1.4826
"""Standard deviation of normal deviates over the median of their absolute deviation from the
median."""


def mad_sd(values: NDArray[np.floating[Any]], centre: float | None = None) -> float:
    """Standard deviation by the MAD of finite values about ``centre`` or their median.

    Given in the type of the values; NaN of none.
    """
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return np.nan
    middle = np.median(finite) if centre is None else centre
    return MAD_TO_SD * float(np.median(np.abs(finite - middle)))


def rms_length(vectors: Floats) -> float:
    """Root mean square of the lengths of vectors (n, k)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def percentiles(values: NDArray[np.floating[Any]], *percents: float) -> tuple[float, ...]:
    """Percentiles of the finite values; NaN where there is none."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return (np.nan,) * len(percents)
    return tuple(np.percentile(finite, percents).tolist())


def running_sums(rows: ArrayLike) -> Floats:
    """Sums (rows, n + 1) of the first 0, 1, 2 ... values of each row (rows, n)."""
    return np.pad(np.cumsum(rows, axis=1, dtype=np.float64), ((0, 0), (1, 0)))


def otsu_borders(counts: Array, grey_sums: Array, classes: int) -> Shape:
    """Bins at which two or three classes of grey begin (Otsu 1979).

    Between these classes the variance is largest.

    ``counts`` and ``grey_sums`` (bins,) are the number of values in each bin and the sum of their
    grey; ``classes`` is 2 or 3. No class is empty of bins.
    """
    cum_count, cum_grey = running_sums([counts, grey_sums])
    last_bin = cum_count.size - 1

    def gain(a: Any, b: Any) -> Floats:
        """What a class of the bins from a up to b adds to the variance between the classes."""
        count = cum_count[b] - cum_count[a]
        grey_sum = cum_grey[b] - cum_grey[a]
        return np.where(count > 0, grey_sum * grey_sum / np.maximum(count, 1e-300), 0.0)

    if classes == 2:
        borders = np.arange(1, last_bin)
        return (int(borders[np.argmax(gain(0, borders) + gain(borders, last_bin))]),)
    i, j = np.triu_indices(last_bin, 1)
    i, j = i[i > 0], j[i > 0]
    best_pair = np.argmax(gain(0, i) + gain(i, j) + gain(j, last_bin))
    return int(i[best_pair]), int(j[best_pair])


def masked_gaussian(
    values: Floats, is_valid: Bools, sigma: Sequence[float], *, truncate: float = 4.0
) -> tuple[Floats, Floats]:
    """Sums of valid values and of their number under a Gaussian of ``sigma`` pixels.

    Nothing lies beyond the border.
    """
    from scipy import ndimage

    total, weight = (
        ndimage.gaussian_filter(field, sigma, mode="constant", truncate=truncate)
        for field in (np.where(is_valid, values, 0.0), is_valid.astype(np.float64))
    )
    return total, weight
