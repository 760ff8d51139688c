"""Places where a round hole may be: extremes of a scale space that knows about missing data.

A disc of radius R answers most strongly to a Laplacian of Gaussian of width R / sqrt(2) (Lindeberg 1998,
doi:10.1023/A:1008045108935). The search is generous; measuring the rim decides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Floats = NDArray[np.float64]
Image = NDArray[np.float32]

# Pixels across the smallest hole where candidates are searched, and where rims are measured.
ACROSS_COARSE = 8.0
ACROSS_FINE = 40.0
# So many candidates are measured whatever the size of the image. Beyond, a square of TILE smallest radii has as many as
# smallest holes would cover it: taken over the whole image, the strongest would all lie where the light is best.
ENOUGH_CANDIDATES = 6000
TILE = 40.0


class Response(NamedTuple):
    """Answer to discs of one radius: pixel size ``(y, x)`` and ``(x, y)`` of the first pixel, all in um."""

    radius: float
    values: Image
    pixel_um: tuple[float, float]
    origin_um: Floats


def reduce_to(
    image: Image, pixel_um: tuple[float, float], target_um: float
) -> tuple[Image, tuple[float, float], Floats]:
    """Area-mean an image until its pixels (y, x) are nearly as large as ``target_um``.

    Returns the image, its pixel size (y, x) and the (x, y) of its first pixel's centre, in um.
    """
    factors = [max(1, min(int(target_um / size + 1e-6), n // 4)) for size, n in zip(pixel_um, image.shape, strict=True)]
    small = image if factors == [1, 1] else _block_means(image, factors, least=0.5)[0]
    size = (pixel_um[0] * factors[0], pixel_um[1] * factors[1])
    return (small, size, np.array([(factors[1] - 1) / 2 * pixel_um[1], (factors[0] - 1) / 2 * pixel_um[0]]))


def blob_responses(image: Image, pixel_um: tuple[float, float], radii_um: tuple[float, float]) -> list[Response]:
    """Laplacian-of-Gaussian responses at radii that cover a range; positive where a disc is darker than around it.

    Missing data are filled with the local mean of what is there, so that they raise no edge of their own. Radii grow;
    wide blobs come on coarser rasters.
    """
    there = np.isfinite(image)
    filled = image
    if not np.all(there):
        filled = np.where(there, image, _local_mean(image, pixel_um, 1.5 * radii_um[1]))
    count = max(2, int(np.ceil(np.log(radii_um[1] / radii_um[0]) / np.log(1.35))) + 1)
    radii = np.geomspace(radii_um[0], radii_um[1], count)
    ratio = float(radii[1] / radii[0])
    # Each radius lies between two widths of a ladder, and their difference is the Laplacian to within a constant. Every
    # width is reached from the one before, which costs little.
    widths = np.append(radii / np.sqrt(2 * ratio), radii[-1] * np.sqrt(ratio / 2))
    steps = np.sqrt(np.diff(widths**2, prepend=0.0))
    responses: list[Response] = []
    before, size, origin = (np.ascontiguousarray(filled, dtype=np.float32), pixel_um, np.zeros(2))
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


def disc_response(radii: list[float], step: float) -> float:
    """Response at the centre of a disc that differs by ``step`` from its surroundings, at its own radius."""
    ratio = radii[1] / radii[0]
    return step * float(np.exp(-1 / ratio) - np.exp(-ratio))


def regular(responses: list[Response]) -> list[float]:
    """Robust standard deviation of the responses at each radius: what mottle, fibres or a printed screen make."""
    return [_spread(r.values, 0.5) / 0.6745 for r in responses]


def quiet_texture(image: Image, pixel_um: tuple[float, float], width_um: float) -> float:
    """Standard deviation of the quietest quarter of an image about its mean over ``width_um``, as if it were Gaussian.

    Holes, dots and dirt have little influence; it is too small rather than too large.
    """
    return _spread(image - _local_mean(image, pixel_um, width_um), 0.25) / 0.3186


def texture(image: Image, pixel_um: tuple[float, float], width_um: float, circles: Floats) -> float:
    """Robust standard deviation of an image about its mean over ``width_um``, outside circles ``x, y, radius`` (um).

    The Gaussian mean is taken for uneven light. 0 where less than a tenth of the image is left.
    """
    rest = image.copy()
    for x, y, radius in circles:
        i0, i1 = (max(0, int((y + side * radius) / pixel_um[0]) + (side > 0)) for side in (-1, 1))
        j0, j1 = (max(0, int((x + side * radius) / pixel_um[1]) + (side > 0)) for side in (-1, 1))
        part = rest[i0:i1, j0:j1]
        rows, columns = np.ogrid[i0 : i0 + part.shape[0], j0 : j0 + part.shape[1]]
        part[np.hypot(columns * pixel_um[1] - x, rows * pixel_um[0] - y) <= radius] = np.nan
    if 10 * np.count_nonzero(np.isfinite(rest)) < rest.size:
        return 0.0
    return _spread(rest - _local_mean(rest, pixel_um, width_um), 0.5) / 0.6745


def _some(values: Image) -> Image:
    """At most half a million of the values that are there, from all over the image."""
    some = values.ravel()[:: 1 + values.size // 500_000]
    return some[np.isfinite(some)]


def _spread(values: Image, share: float) -> float:
    """Quantile of the absolute deviation from the median."""
    some = _some(values)
    return float(np.quantile(np.abs(some - np.median(some)), share)) if some.size else 0.0


def _local_mean(image: Image, pixel_um: tuple[float, float], width_um: float) -> Image:
    """Gaussian mean of what is there; the median of all of it where nothing is near.

    It is so smooth that a quarter of its width is fine enough a raster to compute it on.
    """
    factors = [max(1, int(width_um / 4 / size)) for size in pixel_um]
    sigmas = tuple(width_um / size / factor for size, factor in zip(pixel_um, factors, strict=True))
    means, share = _block_means(image, factors)
    share, values = (ndimage.gaussian_filter(part, sigmas, truncate=3.0) for part in (share, means * share))
    near = share > 1e-3
    some = _some(image)
    typical = np.float32(np.median(some)) if some.size else np.float32(0)
    mean = np.where(near, values / np.where(near, share, np.float32(1)), typical)
    return _stretched(_stretched(mean, image.shape[0], factors[0]).T, image.shape[1], factors[1]).T


def _block_means(image: Image, factors: list[int], least: float | None = None) -> tuple[Image, Image]:
    """Means over blocks of pixels, and the share of each block that has data.

    With ``least`` only whole blocks count, and means over less than that share are NaN; otherwise the last blocks may
    reach beyond the image, where there is no data, and means over nothing are 0.
    """
    if least is None:
        beyond = [(0, -n % f) for n, f in zip(image.shape, factors, strict=True)]
        image = np.pad(image, beyond, constant_values=np.nan)
    rows, cols = (n // f for n, f in zip(image.shape, factors, strict=True))
    blocks = image[: rows * factors[0], : cols * factors[1]].reshape(rows, factors[0], cols, factors[1])
    there = np.isfinite(blocks)
    share = there.mean(axis=(1, 3), dtype=np.float32)
    sums = np.where(there, blocks, 0).mean(axis=(1, 3), dtype=np.float64)
    means = (sums / np.maximum(share, 1e-12)).astype(np.float32)
    return means if least is None else np.where(share >= least, means, np.float32(np.nan)), share


def _stretched(means: Image, count: int, factor: int) -> Image:
    """Values of blocks at every row, linear between the middles of the blocks."""
    place = np.clip((np.arange(count) + 0.5) / factor - 0.5, 0.0, len(means) - 1.0)
    low = np.minimum(place.astype(np.intp), max(0, len(means) - 2))
    part = (place - low).astype(np.float32)[:, None]
    above = means[np.minimum(low + 1, len(means) - 1)]
    return np.asarray(means[low] + (above - means[low]) * part, dtype=np.float32)


def peaks(responses: list[Response], sign: float, least: list[float], spreads: list[float]) -> tuple[Floats, int]:
    """Return the strongest extremes over place and scale, strongest first, and how many more there are.

    ``sign`` is 1 for dark and -1 for bright discs; ``least`` and ``spreads`` are the weakest response to inspect and
    what `regular` says, for each radius. Places (n, 3) are ``x, y`` in um and the largest response there, over all
    radii, in units of its spread; more are those beyond the limit of their part of the image.
    """
    found: list[Floats] = []
    for (radius, values, pixel, origin), weakest, spread in zip(responses, least, spreads, strict=True):
        signed = np.float32(sign) * values
        window = [2 * max(1, round(0.5 * radius / size)) + 1 for size in pixel]
        tops = signed == ndimage.maximum_filter(signed, window, mode="constant", cval=-np.inf)
        row, column = np.nonzero(tops & (signed > max(weakest, 0.0)))
        place = np.stack([column * pixel[1], row * pixel[0]], axis=1) + origin
        height = signed[row, column].astype(np.float64)
        found.append(np.column_stack([place, height / max(spread, 1e-30), height]))
    every = np.concatenate(found)
    order = np.argsort(-every[:, 3], kind="stable")
    places = _thinned(every[order, :3], 0.5 * responses[0].radius)
    kept = _strongest_by_tile(places, responses[0].radius)
    return places[kept], int(np.count_nonzero(~kept))


def _strongest_by_tile(places: Floats, radius: float) -> NDArray[np.bool_]:
    """Which places, strongest first, are among the strongest of their square of the image."""
    if len(places) <= ENOUGH_CANDIDATES:
        return np.ones(len(places), bool)
    tiles = np.floor(places[:, :2] / (TILE * radius)).astype(np.int64)
    _, tile, count = np.unique(tiles, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(tile.ravel(), kind="stable")
    rank = np.empty(len(places), np.int64)
    rank[order] = np.arange(len(places)) - np.repeat(np.cumsum(count) - count, count)
    return rank < TILE**2 / np.pi


def _thinned(points: Floats, least: float) -> Floats:
    """Drop points that share a cell of size ``least`` with one before them; the largest third number is kept."""
    cells = np.floor(points[:, :2] / least).astype(np.int64)
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    largest = np.full(len(first), -np.inf)
    np.maximum.at(largest, cell.ravel(), points[:, 2])
    kept = points[first]
    kept[:, 2] = largest
    return kept[np.argsort(first)]
