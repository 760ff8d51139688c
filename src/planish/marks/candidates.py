"""Places where a round hole may be: extremes of a scale space that knows about missing data.

A disc of radius R answers most strongly to a Laplacian of Gaussian of width R / sqrt(2) (Lindeberg 1998,
doi:10.1023/A:1008045108935). The search is generous; measuring the rim decides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planish.core.typing import Bools, Floats, Ints, Pair

Image = NDArray[np.float32]

# Pixels across the smallest hole where candidates are searched, and where rims are measured.
ACROSS_COARSE = 8.0
ACROSS_FINE = 40.0
# So many candidates are measured whatever the size of the image. Beyond, a square of TILE smallest radii has as many as
# smallest holes would cover it: taken over the whole image, the strongest would all lie where the light is best.
ENOUGH_CANDIDATES = 6000
TILE = 40.0
# Side of the squares in which texture is judged, in largest diameters; three by three are a neighbourhood. Values taken
# along a side; quantiles of absolute deviations of one standard deviation; least share of what is usual in the image.
SQUARE = 3.0
SAMPLES = 10
TO_SD = {0.25: 0.3186, 0.5: 0.6745}
FAINTEST = 0.25


class Raster(NamedTuple):
    """An image, its pixel size ``(y, x)`` and the ``(x, y)`` of its first pixel's centre, in um."""

    image: Image
    pixel_um: Pair
    origin_um: Floats


class Response(NamedTuple):
    """Answer to discs of one radius: pixel size ``(y, x)`` and ``(x, y)`` of the first pixel, all in um."""

    radius: float
    values: Image
    pixel_um: Pair
    origin_um: Floats


def reduce_to(image: Image, pixel_um: Pair, target_um: float) -> Raster:
    """Area-mean an image, whose first pixel lies at 0, until its pixels are nearly as large as ``target_um``."""
    factors = [max(1, min(int(target_um / size + 1e-6), n // 4)) for size, n in zip(pixel_um, image.shape, strict=True)]
    small = image if factors == [1, 1] else _block_means(image, factors, least=0.5)[0]
    size = (pixel_um[0] * factors[0], pixel_um[1] * factors[1])
    return Raster(small, size, np.array([(factors[1] - 1) / 2 * pixel_um[1], (factors[0] - 1) / 2 * pixel_um[0]]))


def blob_responses(image: Image, pixel_um: Pair, radii_um: Pair) -> list[Response]:
    """Give Laplacian-of-Gaussian responses at radii that cover a range; positive where a disc is darker than around it.

    Missing data are filled with the local mean of what is there, so that they raise no edge of their own. Radii grow;
    wide blobs come on coarser rasters.
    """
    is_finite = np.isfinite(image)
    filled = image if is_finite.all() else np.where(is_finite, image, _local_mean(image, pixel_um, 1.5 * radii_um[1]))
    count = max(2, int(np.ceil(np.log(radii_um[1] / radii_um[0]) / np.log(1.35))) + 1)
    radii = np.geomspace(radii_um[0], radii_um[1], count)
    ratio = float(radii[1] / radii[0])
    # Each radius lies between two widths of a ladder, and their difference is the Laplacian to within a constant. Every
    # width is reached from the one before, which costs little.
    widths = np.append(radii / np.sqrt(2 * ratio), radii[-1] * np.sqrt(ratio / 2))
    steps = np.sqrt(np.diff(widths**2, prepend=0.0))
    responses: list[Response] = []
    before, size, origin = np.ascontiguousarray(filled, dtype=np.float32), pixel_um, np.zeros(2)
    for level, step in enumerate(steps):
        sigmas = float(step) / size[0], float(step) / size[1]
        after = ndimage.gaussian_filter(before, sigmas, mode="nearest", truncate=3.0)
        if level:
            responses.append(Response(float(radii[level - 1]), after - before, size, origin))
        # The wider the blobs, the coarser a raster shows them just as well.
        if level and level < count:
            after, smaller, shift = reduce_to(after, size, 2 * float(radii[level]) / ACROSS_COARSE)
            size, origin = smaller, origin + shift
        before = after
    return responses


class LocalLevels(NamedTuple):
    """Usual values around each place of an image: values (rows, columns) of squares of a side ``(y, x)`` in um."""

    values: Floats
    side_um: Pair

    def at_points(self, points: Floats) -> Floats:
        """Return the values at points (n, 2), ``x, y`` in um."""
        rows, columns = self.values.shape
        i = np.clip(points[:, 1] / self.side_um[0], 0, rows - 1).astype(np.intp)
        j = np.clip(points[:, 0] / self.side_um[1], 0, columns - 1).astype(np.intp)
        return self.values[i, j]


def local_spread(deviations: Image, pixel_um: Pair, side_um: float, share: float) -> LocalLevels:
    """Give the spread in each square of an image and the eight around it: a quantile, as a standard deviation.

    The quantile is that of absolute deviations. Some hundred values are taken of each neighbourhood. Where less than a
    tenth of it is there, the quantile of all of the image stands, and 0 where less than a tenth of that is there.
    """
    sides = [max(1, min(round(side_um / size), n)) for size, n in zip(pixel_um, deviations.shape, strict=True)]
    steps = [max(1, side // SAMPLES) for side in sides]
    sample = deviations[:: steps[0], :: steps[1]]
    sides = [max(1, side // step) for side, step in zip(sides, steps, strict=True)]
    counts = [-(-n // side) for n, side in zip(sample.shape, sides, strict=True)]
    padding = [(side, (count + 1) * side - n) for n, side, count in zip(sample.shape, sides, counts, strict=True)]
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(sample, padding, constant_values=np.nan), (3 * sides[0], 3 * sides[1])
    )[:: sides[0], :: sides[1]]
    windows = windows.reshape(*windows.shape[:2], -1)
    finite_counts = np.count_nonzero(windows == windows, axis=2)
    middle = _quantile(windows, finite_counts, 0.5)
    local = _quantile(np.abs(windows - middle[..., None]), finite_counts, share)
    finite = sample[sample == sample]
    whole = 0.0
    if finite.size and 10 * finite.size >= sample.size:
        whole = float(np.quantile(np.abs(finite - np.median(finite)), share))
    # Values of each neighbourhood that lie inside the image.
    spans: list[Floats] = []
    for n, side, count in zip(sample.shape, sides, counts, strict=True):
        first = np.arange(count) * side - side
        spans.append(np.minimum(first + 3 * side, n) - np.maximum(first, 0.0))
    is_enough = 10 * finite_counts >= spans[0][:, None] * spans[1]
    spread = np.where(is_enough, local, whole).astype(np.float64)
    side = (sides[0] * steps[0] * pixel_um[0], sides[1] * steps[1] * pixel_um[1])
    return LocalLevels(spread / TO_SD[share], side)


def _quantile(values: Image, finite_counts: Ints, share: float) -> Image:
    """Give the quantile along the last axis of the finite values: NaN sorts last."""
    rank = np.rint(share * np.maximum(finite_counts - 1, 0)).astype(np.intp)
    return np.take_along_axis(np.sort(values, axis=-1), rank[..., None], axis=-1)[..., 0]


def texture(image: Image, pixel_um: Pair, width_um: float, side_um: float, circles: Floats) -> LocalLevels:
    """Give the texture around each place about the mean over ``width_um``, outside circles ``x, y, radius`` (um).

    The Gaussian mean is taken for uneven light. 0 where less than a tenth of the image is left.
    """
    masked = image.copy()
    for x, y, radius in circles:
        i0, i1 = (max(0, int((y + side * radius) / pixel_um[0]) + (side > 0)) for side in (-1, 1))
        j0, j1 = (max(0, int((x + side * radius) / pixel_um[1]) + (side > 0)) for side in (-1, 1))
        window = masked[i0:i1, j0:j1]
        down = (np.arange(i0, i0 + window.shape[0])[:, None] * pixel_um[0] - y) ** 2
        window[down + (np.arange(j0, j0 + window.shape[1]) * pixel_um[1] - x) ** 2 <= radius**2] = np.nan
    return local_deviation(masked, pixel_um, width_um, side_um, 0.5)


def local_deviation(image: Image, pixel_um: Pair, width_um: float, side_um: float, share: float) -> LocalLevels:
    """Give the spread of an image about its mean over ``width_um``; only what `local_spread` takes is computed."""
    down, across = (max(1, int(side_um / size / SAMPLES)) for size in pixel_um)
    deviations = image[::down, ::across] - _local_mean(image, pixel_um, width_um, (down, across))
    return local_spread(deviations, (down * pixel_um[0], across * pixel_um[1]), side_um, share)


def _local_mean(image: Image, pixel_um: Pair, width_um: float, steps: tuple[int, int] = (1, 1)) -> Image:
    """Give the Gaussian mean of what is there; the median of all of it where nothing is near.

    It is so smooth that a quarter of its width is fine enough a raster to compute it on. Every ``steps``-th row and
    column is given.
    """
    factors = [max(1, int(width_um / 4 / size)) for size in pixel_um]
    sigmas = tuple(width_um / size / factor for size, factor in zip(pixel_um, factors, strict=True))
    means, share = _block_means(image, factors)
    share, sums = (ndimage.gaussian_filter(array, sigmas, truncate=3.0) for array in (share, means * share))
    near = share > 1e-3
    # At most half a million of the values, from all over the image.
    sample = image.ravel()[:: 1 + image.size // 500_000]
    sample = sample[np.isfinite(sample)]
    typical = np.float32(np.median(sample)) if sample.size else np.float32(0)
    mean = np.where(near, sums / np.where(near, share, np.float32(1)), typical)
    for n, factor, step in zip(image.shape, factors, steps, strict=True):
        # Linear between the middles of the blocks.
        place = np.clip((np.arange(0, n, step) + 0.5) / factor - 0.5, 0.0, len(mean) - 1.0)
        low = np.minimum(place.astype(np.intp), max(0, len(mean) - 2))
        fraction = (place - low).astype(np.float32)[:, None]
        above = mean[np.minimum(low + 1, len(mean) - 1)]
        mean = np.asarray(mean[low] + (above - mean[low]) * fraction, dtype=np.float32).T
    return mean


def _block_means(image: Image, factors: list[int], least: float | None = None) -> tuple[Image, Image]:
    """Give the means over blocks of pixels, and the share of each block that has data.

    With ``least`` only whole blocks count, and means over less than that share are NaN; otherwise the last blocks may
    reach beyond the image, where there is no data, and means over nothing are 0.
    """
    if least is None:
        beyond = [(0, -n % f) for n, f in zip(image.shape, factors, strict=True)]
        image = np.pad(image, beyond, constant_values=np.nan)
    rows, cols = (n // f for n, f in zip(image.shape, factors, strict=True))
    blocks = image[: rows * factors[0], : cols * factors[1]].reshape(rows, factors[0], cols, factors[1])
    has_data = np.isfinite(blocks)
    share = has_data.mean(axis=(1, 3), dtype=np.float32)
    sums = np.where(has_data, blocks, 0).mean(axis=(1, 3), dtype=np.float64)
    means = (sums / np.maximum(share, 1e-12)).astype(np.float32)
    return means if least is None else np.where(share >= least, means, np.float32(np.nan)), share


class Candidates(NamedTuple):
    """Places that may be holes, strongest first.

    ``places`` are ``x, y`` in um, (n, 2); ``standing`` is the largest response over all radii, in units of the usual
    one around; ``share`` the weakest response that was searched here over that of the least contrast; ``dropped`` how
    many more lie beyond the limit of their part of the image.
    """

    places: Floats
    standing: Floats
    share: Floats
    dropped: int


def peaks(
    responses: list[Response], sign: float, faintest: LocalLevels, spreads: list[LocalLevels], worth: float
) -> Candidates:
    """Return the extremes over place and scale, strongest first.

    ``sign`` is 1 for dark and -1 for bright discs; ``faintest`` the response that the least contrast makes and
    ``spreads`` the usual response of each radius: what is searched is stronger than the first or ``worth`` times the
    second.
    """
    pairs = zip(responses, spreads, strict=True)
    rows = np.concatenate([_peaks_of_radius(response, sign, faintest, spread, worth) for response, spread in pairs])
    order = np.argsort(-rows[:, 3], kind="stable")
    rows = rows[order]
    # Of places that share a cell the strongest stays, with the largest height over the usual one.
    cells = np.floor(rows[:, :2] / (0.5 * responses[0].radius)).astype(np.int64)
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    largest = np.full(len(first), -np.inf)
    np.maximum.at(largest, cell.ravel(), rows[:, 2])
    rows = rows[first]
    rows[:, 2] = largest
    rows = rows[np.argsort(first)]
    is_strong = _strongest_by_tile(rows, responses[0].radius)
    dropped = int(np.count_nonzero(~is_strong))
    rows = rows[is_strong]
    return Candidates(rows[:, :2], rows[:, 2], rows[:, 4], dropped)


def _peaks_of_radius(
    response: Response, sign: float, faintest: LocalLevels, spread: LocalLevels, worth: float
) -> Floats:
    """Find the peaks of one response: ``x, y`` (um), height over the usual one, height, share of the least contrast."""
    signed = response.values if sign > 0 else -response.values
    reach = [max(1, round(0.5 * response.radius / size)) for size in response.pixel_um]
    weakest = max(0.0, min(float(faintest.values.min()), worth * float(spread.values.min())))
    # What is above the weakest and nowhere surpassed within reach; the nearest first: they leave few for the others.
    row, column = np.nonzero(signed > weakest)
    around = np.pad(signed, [(n, n) for n in reach], constant_values=-np.inf)
    offsets = [(i, j) for i in range(-reach[0], reach[0] + 1) for j in range(-reach[1], reach[1] + 1)]
    for i, j in sorted(offsets, key=lambda offset: np.hypot(*offset)):
        top = signed[row, column] >= around[row + reach[0] + i, column + reach[1] + j]
        row, column = row[top], column[top]
    points = np.stack([column * response.pixel_um[1], row * response.pixel_um[0]], axis=1) + response.origin_um
    height = signed[row, column].astype(np.float64)
    usual, contrast = spread.at_points(points), faintest.at_points(points)
    least = np.minimum(contrast, worth * usual)
    share = np.where(contrast > 0, least / np.maximum(contrast, 1e-30), 1.0)
    rows = np.column_stack([points, height / np.maximum(usual, 1e-30), height, share])
    return rows[height > np.maximum(least, 0.0)]


def _strongest_by_tile(places: Floats, radius: float) -> Bools:
    """Return which places, strongest first, are among the strongest of their square of the image."""
    if len(places) <= ENOUGH_CANDIDATES:
        return np.ones(len(places), bool)
    tiles = np.floor(places[:, :2] / (TILE * radius)).astype(np.int64)
    _, tile, count = np.unique(tiles, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(tile.ravel(), kind="stable")
    rank = np.empty(len(places), np.int64)
    rank[order] = np.arange(len(places)) - np.repeat(np.cumsum(count) - count, count)
    return rank < TILE**2 / np.pi
