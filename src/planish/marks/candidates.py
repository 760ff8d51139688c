"""Places where a round hole may be: extremes of a scale space that knows about missing data.

A disc of radius R answers most strongly to a Laplacian of Gaussian of width R / sqrt(2) (Lindeberg
1998, doi:10.1023/A:1008045108935). The search is generous; measuring the rim decides.
"""

import math
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from planish.core.grid import Grid, at_index, hole_mask
from planish.core.typing import Bools, Floats, Ints, Pair, Singles, pair_of

Image = Singles

# Pixels across the smallest hole where candidates are searched.
ACROSS_COARSE = 8.0
# A response in robust standard deviations of the same response all over the sheet from which on it
# is measured.
WORTH_MEASURING = 4.0
# So many candidates are measured whatever the size of the image. Beyond, a square of TILE smallest
# radii has as many as smallest holes would cover it: taken over the whole image, the strongest
# would all lie where the light is best.
ENOUGH_CANDIDATES = 6000
TILE = 40.0
# Side of the squares in which texture is judged, in largest diameters; three by three are a
# neighbourhood. Values taken along a side; quantiles of absolute deviations of one standard
# deviation.
SQUARE = 3.0
SAMPLES = 10
TO_SD = {0.25: 0.3186, 0.5: 0.6745}


class Raster(NamedTuple):
    """An image, its pixel size ``(y, x)`` and the ``(x, y)`` of its first pixel's centre, in um."""

    image: Image
    pixel_um: Pair
    origin_um: Floats = np.zeros(2)

    def points_at(self, rows: Ints, cols: Ints) -> Floats:
        """Return the centres (n, 2) of pixels, ``x, y`` in um."""
        places_um = np.column_stack([cols, rows]) * self.pixel_um[::-1]
        return places_um + self.origin_um


def reduce_to(raster: Raster, target_um: float) -> Raster:
    """Area-mean an image until its pixels are nearly as large as ``target_um``.

    Each side keeps four pixels or more. A mean is NaN where less than half of its pixels have data.
    """
    image, pixel_um, origin = raster
    most = np.array(image.shape) // 4
    wanted = (np.divide(target_um, pixel_um) + 1e-6).astype(int)
    factors = np.clip(wanted, 1, np.maximum(most, 1))
    if factors.max() == 1:
        return raster
    shift_yx = (factors - 1) / 2 * pixel_um
    means, data_share = _block_means(image, factors)
    means = np.where(data_share >= 0.5, means, np.float32(np.nan))
    return Raster(means, pair_of(factors * pixel_um), origin + shift_yx[::-1])


def blob_responses(raster: Raster, radii_um: Pair) -> dict[float, Raster]:
    """Give Laplacian-of-Gaussian responses by radius, in um.

    Positive where a disc is darker than around it.

    Missing data are filled with the local mean of what is there, so that they raise no edge of
    their own. Radii cover a range, the least and the largest of which are given, and grow; wide
    blobs come on coarser rasters. Places count from the first pixel.
    """
    image = raster.image
    least_radius, largest_radius = radii_um
    is_finite = np.isfinite(image)
    if not is_finite.all():
        local_mean = _local_mean(raster, 1.5 * largest_radius)
        image = np.where(is_finite, image, local_mean)
    # One radius is 1.35 times the one before, or a little less.
    steps = np.log(largest_radius / least_radius) / np.log(1.35)
    count = max(2, int(np.ceil(steps)) + 1)
    radii = np.geomspace(least_radius, largest_radius, count)
    ratio = float(radii[1] / radii[0])
    # Each radius lies between two widths of a ladder, and their difference is the Laplacian to
    # within a constant. Every width is reached from the one before, which costs little.
    last_width = radii[-1] * np.sqrt(ratio / 2)
    widths = np.append(radii / np.sqrt(2 * ratio), last_width)
    added_widths = np.sqrt(np.diff(widths**2, prepend=0.0))
    responses: dict[float, Raster] = {}
    before = Raster(np.ascontiguousarray(image, dtype=np.float32), raster.pixel_um)
    for level, added_width in enumerate(added_widths.tolist()):
        sigmas = [added_width / size for size in before.pixel_um]
        smooth = ndimage.gaussian_filter(before.image, sigmas, mode="nearest", truncate=3.0)
        if level:
            response = before._replace(image=smooth - before.image)
            responses[float(radii[level - 1])] = response
        before = before._replace(image=smooth)
        # The wider the blobs, the coarser a raster shows them just as well.
        if 0 < level < count:
            before = reduce_to(before, 2 * float(radii[level]) / ACROSS_COARSE)
    return responses


class LocalLevels(NamedTuple):
    """Usual values around each place of an image.

    Values (rows, columns) of squares of a side ``(y, x)`` in um.
    """

    values: Floats
    side_um: Pair

    def at_points(self, points: Floats) -> Floats:
        """Return the values at points (n, 2), ``x, y`` in um."""
        squares = points[:, ::-1] / self.side_um
        last = np.subtract(self.values.shape, 1)
        squares = np.clip(squares, 0, last).astype(np.intp)
        i, j = squares.T
        return self.values[i, j]


def local_spread(raster: Raster, side_um: float, quantile: float) -> LocalLevels:
    """Give the spread in each square of an image, of about a side in um, and the eight around it.

    It is a quantile of absolute deviations, one of those in `TO_SD`, as a standard deviation.

    Some hundred values are taken of each. Where less than a tenth is there, that of all of the
    image stands, or 0.
    """
    image, pixel_um, _ = raster
    whole_sides = np.rint(np.divide(side_um, pixel_um)).astype(int)
    whole_sides = np.clip(whole_sides, 1, image.shape)
    strides = np.maximum(1, whole_sides // SAMPLES)
    sample = image[:: strides[0], :: strides[1]]
    # Sides of the squares, and how many there are, in values that are taken.
    sides = np.maximum(1, whole_sides // strides)
    counts = -(-np.array(sample.shape) // sides)
    # A square more on every side, so that each has eight around it.
    after = (counts + 1) * sides - sample.shape
    padding = np.stack([sides, after], axis=1)
    padded = np.pad(sample, padding, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 3 * sides)
    windows = windows[:: sides[0], :: sides[1]]
    windows = windows.reshape(*counts, -1)
    finite_counts = np.count_nonzero(windows == windows, axis=2)
    medians = _quantile(windows, finite_counts, 0.5)
    deviations = np.abs(windows - medians[..., None])
    local_quantiles = _quantile(deviations, finite_counts, quantile)
    finite_values = sample[sample == sample]
    image_quantile = 0.0
    if finite_values.size and 10 * finite_values.size >= sample.size:
        deviations = np.abs(finite_values - np.median(finite_values))
        image_quantile = float(np.quantile(deviations, quantile))
    # Rows and columns of each neighbourhood that lie inside the image.
    inside: list[Ints] = []
    for n, side, count in zip(sample.shape, sides, counts, strict=True):
        borders = np.arange(-1, count + 2) * side
        borders = np.clip(borders, 0, n)
        inside.append(borders[3:] - borders[:-3])
    has_enough = 10 * finite_counts >= np.outer(*inside)
    spread = np.where(has_enough, local_quantiles, image_quantile).astype(np.float64)
    return LocalLevels(spread / TO_SD[quantile], pair_of(sides * strides * pixel_um))


def _quantile(values: Image, finite_counts: Ints, quantile: float) -> Image:
    """Give the quantile along the last axis of the finite values: NaN sorts last."""
    last_ranks = np.maximum(finite_counts - 1, 0)
    ranks = np.rint(quantile * last_ranks).astype(np.intp)
    return at_index(np.sort(values, axis=-1), ranks)


def outside(raster: Raster, centres_um: Floats, radii_um: Floats) -> Raster:
    """Give the image without circles about centres (n, 2), ``x, y`` from its first pixel.

    It is NaN there.
    """
    grid = Grid.regular(raster.image.shape, raster.pixel_um)
    is_inside = hole_mask(grid, centres_um, radii_um)
    return raster._replace(image=np.where(is_inside, np.nan, raster.image))


def local_deviation(raster: Raster, diameter_um: float, quantile: float) -> LocalLevels:
    """Give the spread of an image about its Gaussian mean over a diameter.

    This mean takes out uneven light. The quantile is that of `local_spread`.
    """
    side_um = SQUARE * diameter_um
    # Only what `local_spread` takes is computed.
    steps = np.divide(side_um, raster.pixel_um) / SAMPLES
    steps = np.maximum(1, steps.astype(np.intp))
    row_step, col_step = steps
    mean = _local_mean(raster, diameter_um, steps)
    deviations = raster.image[::row_step, ::col_step] - mean
    thinned = Raster(deviations, pair_of(steps * raster.pixel_um))
    return local_spread(thinned, side_um, quantile)


def _local_mean(raster: Raster, width_um: float, steps: Ints | None = None) -> Image:
    """Gaussian mean, of standard deviation ``width_um``, at every ``steps``-th row and column.

    From a coarse raster; the median where nothing is near.
    """
    image, pixel_um, _ = raster
    factors = np.divide(width_um / 4, pixel_um).astype(np.intp)
    factors = np.maximum(1, factors)
    # The last blocks may reach beyond the image, where there is no data.
    missing = -np.array(image.shape) % factors
    padded = np.pad(image, [(0, n) for n in missing], constant_values=np.nan)
    means, weights = _block_means(padded, factors)
    sigmas = np.divide(width_um, pixel_um) / factors
    sums = ndimage.gaussian_filter(means * weights, sigmas, truncate=3.0)
    weights = ndimage.gaussian_filter(weights, sigmas, truncate=3.0)
    has_weight = weights > 1e-3
    # At most half a million of the values, from all over the image.
    sample = image.ravel()[:: 1 + image.size // 500_000]
    sample = sample[np.isfinite(sample)]
    typical_grey = np.median(sample) if sample.size else 0.0
    weights[~has_weight] = 1.0
    mean = np.where(has_weight, sums / weights, np.float32(typical_grey))
    steps = np.ones_like(factors) if steps is None else steps
    # Along the rows first; transposed, along the columns.
    for n, factor, step in zip(image.shape, factors, steps, strict=True):
        # Linear between the middles of the blocks.
        last = len(mean) - 1
        places = (np.arange(0, n, step) + 0.5) / factor - 0.5
        places = np.clip(places, 0.0, last)
        last_lower = max(0, last - 1)
        lower = np.minimum(places.astype(np.intp), last_lower)
        fraction = (places - lower).astype(np.float32)[:, None]
        lower_means = mean[lower]
        upper_means = mean[np.minimum(lower + 1, last)]
        mean = np.transpose(lower_means + (upper_means - lower_means) * fraction)
    return mean


def _block_means(image: Image, factors: Ints) -> tuple[Image, Image]:
    """Give the means over whole blocks of pixels, and the share of each block that has data.

    ``factors`` are the rows and columns of a block. A mean over nothing is 0.

    Rows and columns that fill no whole block are left out.
    """
    row_factor, col_factor = factors
    rows, cols = image.shape // factors
    whole = image[: rows * row_factor, : cols * col_factor]
    blocks = whole.reshape(rows, row_factor, cols, col_factor)
    has_data = np.isfinite(blocks)
    data_share = has_data.mean(axis=(1, 3), dtype=np.float32)
    filled = np.where(has_data, blocks, 0)
    sums = filled.mean(axis=(1, 3), dtype=np.float64)
    return (sums / np.maximum(data_share, 1e-12)).astype(np.float32), data_share


def peaks(
    responses: dict[float, Raster],
    sign: float,
    faintest_levels: LocalLevels,
    spreads: list[LocalLevels],
) -> tuple[Floats, Floats, int]:
    """Return places that may be holes, the extremes over place and scale, strongest first.

    They are stronger than ``faintest_levels``, the response that the least contrast makes, or
    `WORTH_MEASURING` times that of ``spreads``, the usual one of each radius. Returns ``x, y`` in
    um, (n, 2); the weakest one searched here over ``faintest_levels``, (n,); how many lie beyond
    the limit of their part. ``sign`` is 1 for dark holes, -1 for bright ones.
    """
    peaks_by_radius: list[Floats] = []
    for (radius, response), spread in zip(responses.items(), spreads, strict=True):
        response = response._replace(image=np.multiply(response.image, sign))
        peaks_by_radius.append(_peaks_of_radius(radius, response, faintest_levels, spread))
    candidates = np.concatenate(peaks_by_radius)
    by_height = np.argsort(-candidates[:, 2], kind="stable")
    candidates = candidates[by_height]
    # Of places that share a cell the strongest stays.
    smallest_radius = min(responses)
    cells = np.floor(candidates[:, :2] / (0.5 * smallest_radius))
    _, first_rows = np.unique(cells.astype(np.int64), axis=0, return_index=True)
    candidates = candidates[np.sort(first_rows)]
    is_strong = _strongest_by_tile(candidates, smallest_radius)
    x, y, _, shares = candidates[is_strong].T
    dropped_count = int(np.count_nonzero(~is_strong))
    return np.stack([x, y], axis=1), shares, dropped_count


def _peaks_of_radius(
    radius: float, response: Raster, faintest_levels: LocalLevels, spread: LocalLevels
) -> Floats:
    """Find the peaks of one response: ``x, y`` (um), height, share of the least contrast.

    A threshold is that of the least contrast, or less where the response is weak all around; the
    share is the one over the other.
    """
    image = response.image
    reach = [max(1, round(0.5 * radius / size)) for size in response.pixel_um]
    least_spread = WORTH_MEASURING * float(spread.values.min())
    faintest = float(faintest_levels.values.min())
    # What is above the weakest and nowhere surpassed within reach; the nearest first: they leave
    # few for the others.
    rows, cols = np.nonzero(image > max(0.0, min(faintest, least_spread)))
    padded = np.pad(image, [(n, n) for n in reach], constant_values=-np.inf)
    row_reach, col_reach = reach
    offsets = product(range(2 * row_reach + 1), range(2 * col_reach + 1))
    for i, j in sorted(offsets, key=partial(math.dist, reach)):
        is_top = image[rows, cols] >= padded[rows + i, cols + j]
        rows = rows[is_top]
        cols = cols[is_top]
    points = response.points_at(rows, cols)
    heights = image[rows, cols].astype(np.float64)
    faintest_heights = faintest_levels.at_points(points)
    worth_heights = WORTH_MEASURING * spread.at_points(points)
    thresholds = np.minimum(faintest_heights, worth_heights)
    shares = thresholds / np.maximum(faintest_heights, 1e-30)
    shares[faintest_heights <= 0] = 1.0
    candidates = np.column_stack([points, heights, shares])
    return candidates[heights > np.maximum(thresholds, 0.0)]


def _strongest_by_tile(places: Floats, radius: float) -> Bools:
    """Return which places are among those that are measured of their tile.

    Each row of ``places`` begins with x, y in um; the strongest come first.
    """
    if len(places) <= ENOUGH_CANDIDATES:
        return np.ones(len(places), bool)
    tiles = np.floor(places[:, :2] / (TILE * radius))
    tiles = tiles.astype(np.int64)
    _, tile, count = np.unique(tiles, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(tile.ravel(), kind="stable")
    first_ranks = np.repeat(np.cumsum(count) - count, count)
    rank = np.empty(len(places), np.int64)
    rank[order] = np.arange(len(places)) - first_ranks
    return rank < TILE**2 / np.pi


def dark_spots(raster: Raster, sign: float, level: float, radius: float) -> Floats:
    """Return places (n, 2), ``x, y`` in um from the first pixel, around which most is dark.

    Dark is what lies, times ``sign``, below a level; around is about a radius, in um. Not all is
    dark there, as it is beside a sheet.
    """
    from_first = Raster(raster.image, raster.pixel_um)
    coarse = reduce_to(from_first, 2 * radius / ACROSS_COARSE)
    is_dark = (sign * coarse.image < level).astype(np.float32)
    sigmas = np.divide(0.5 * radius, coarse.pixel_um)
    dark_share = ndimage.gaussian_filter(is_dark, sigmas)
    reach = np.maximum(1, np.rint(sigmas).astype(int))
    is_top = dark_share == ndimage.maximum_filter(dark_share, (2 * reach + 1).tolist())
    # Within a disc of the radius it is 0.86.
    is_spot = is_top & (dark_share > 0.33) & (dark_share < 0.98)
    return coarse.points_at(*np.nonzero(is_spot))
