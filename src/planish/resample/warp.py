"""Images on another grid: warped by any transformation, of any size, patch by patch.

The transformation is asked at 4 x 4 points of a block, which give a polynomial, and at 3 x 3
between them; blocks where it errs too much are cut into four. They lie where the grid says: no
result depends on what is worked on together.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotRegister, InputError, ResourceError, SizeError
from planish.core.grid import Grid
from planish.core.threads import map_threads
from planish.core.tiles import Tile, tiles_of
from planish.core.transform import are_known, grid_points
from planish.core.typing import Array, Floats, Pair, Shape
from planish.resample._kernels import integrals, interpolate

Integers = NDArray[np.int64]
Mapping = Callable[[Floats], Floats]
TOLERANCE = 0.01
"""Error that a place may have, in source pixels."""

LARGER = 1.1
"""Length of a pixel's longer side in source pixels from which on values are averaged.

A calibration that is a few percent off does not change the method in the middle of an image.
"""

_TILE = (512, 4096)  # target pixels that a thread works on, always the same ones; whole blocks
_BLOCK = 256  # target pixels
_NODES = np.array([0.0, 1.0, 2.0, 3.0]) / 3
_TEST = np.array([1.0, 3.0, 5.0]) / 6
# Of the weights: a pixel of the source with less does not count, so none is lost to rounding.
_EDGE = 1e-9
_FLAT = 1e-6  # of the square of its diagonal: an area below that is none


def warp_image(
    image: NDArray[np.floating[Any]],
    grid: Grid,
    to_source: Mapping,
    *,
    pixel_um: Pair = (1.0, 1.0),
    memory_bytes: int = 2**31,
    must_meet: bool = True,
) -> NDArray[np.floating[Any]]:
    """Warp an image by a transformation.

    Parameters
    ----------
    image : (rows, cols), float32 or float64
        What is not finite is missing. The middle of its first pixel is (0, 0) um.
    grid : Grid
        Pixels of the target.
    to_source : callable
        Takes points (..., 2), (x, y) in um, of the target to the image: the ``inverse`` of a
        transformation that takes the image to the target. NaN where there is none. It is called for
        few points, from several threads.
    pixel_um : (float, float)
        Pitch of the image's rows and columns.
    memory_bytes : int
        What may be taken beside the image.
    must_meet : bool
        Whether it is an error that the target shows nothing of the image; otherwise all of it is
        NaN then.

    Returns
    -------
    (rows, cols) of the grid, type of the image
        NaN is missing. The same bytes on any number of threads.

    Raises
    ------
    CannotRegister
        The target does not meet the image, or the transformation makes a line of it.
    SizeError
        A pixel size or the grid is impossible.
    InputError
        The image has another shape or type than is needed.
    ResourceError
        It does not fit into the memory.

    Notes
    -----
    Places in the image are right to 0.01 of its pixels, and exact for affine transformations.
    Values are averaged where the longer side of a pixel is more than 1.1 source pixels long, and
    interpolated elsewhere, decided patch by patch. A pixel's area is the quadrilateral between the
    images of its four corners, and every source pixel counts with its part inside: nothing is
    sampled, and of whole images the sums are kept. A pixel is known where at least half of its area
    is. Between the middles of source pixels, a bilinear value is known where all pixels that have
    weight are, as in :func:`planish.resample.resample`: it ends at the outermost middles, half a
    pixel before the area does.

    Rounding leaves 1e-13 of the largest value nearby in a mean: mark values that stand for missing
    ones as NaN.
    """
    _check_input(image, grid, pixel_um, memory_bytes)

    def mapping(points: Floats) -> Floats:
        points_um = points * grid.pixel_um[::-1] + grid.origin_um
        source_um = np.asarray(to_source(points_um), dtype=np.float64)
        return source_um / pixel_um[::-1]

    out = np.full(grid.shape, np.nan, dtype=image.dtype)
    map_threads(partial(_warp_tile, image, mapping, out), tiles_of(grid.shape, _TILE))
    if must_meet and not np.isfinite(out).any():
        sides = (np.linspace(-0.5, n - 0.5, 17) for n in grid.shape[::-1])
        points_um = mapping(grid_points(*sides)) * pixel_um[::-1]
        where_text = _where_text(points_um[are_known(points_um)])
        height_um, width_um = np.multiply(image.shape, pixel_um)
        raise CannotRegister(
            f"The transformation takes the target {where_text}, which is {width_um:.0f} um wide and"
            f" {height_um:.0f} um high: nothing overlaps. Check the pixel sizes and the origin, and"
            " that the transformation goes from target to image (else use its inverse)."
        )
    return out


def _check_input(
    image: NDArray[np.floating[Any]], grid: Grid, pixel_um: Pair, memory_bytes: int
) -> None:
    """Refuse an image, a grid or pixels that are none, and what does not fit into the memory."""
    shape = grid.shape
    size = image.shape
    if image.ndim != 2 or min(size) < 1 or image.dtype.kind != "f":
        raise InputError(
            f"The image has the shape {size} and {image.dtype} values; (rows, cols) of floats is"
            " needed."
        )
    if min(shape) < 1 or not np.isfinite(grid.origin_um).all():
        raise SizeError(
            f"A grid of {shape[0]} x {shape[1]} pixels cannot be made. Check the pixel size and the"
            " origin."
        )
    for image_name, (rows, cols) in (("image", pixel_um), ("target", grid.pixel_um)):
        if not (0 < rows < np.inf and 0 < cols < np.inf):
            raise SizeError(
                f"The pixel size of the {image_name} is {rows:g} x {cols:g} um. Give positive"
                " numbers."
            )
    needed = shape[0] * shape[1] * image.dtype.itemsize
    if needed > memory_bytes:
        raise ResourceError(
            f"The warped image needs {needed / 1e9:.2f} GB of memory, {memory_bytes / 1e9:.2f} GB"
            " are allowed. Allow more, or warp to a smaller or coarser grid."
        )


def _where_text(points_um: Floats) -> str:
    """Say where points (n, 2) of the target lie in the image."""
    if not len(points_um):
        return "nowhere"
    a, b = points_um.min(axis=0)
    c, d = points_um.max(axis=0)
    return f"to x {round(a)} to {round(c)}, y {round(b)} to {round(d)} um of the image"


def _warp_tile(image: Array, mapping: Mapping, out: Array, tile: Tile) -> None:
    """Set one tile of ``out``, which is NaN before.

    ``mapping`` goes from (x, y) in pixels of ``out`` to those of the image.
    """
    bounds, patch_nodes = find_patches(mapping, tile, image.shape)
    for (y0, y1, x0, x1), nodes in zip(bounds, patch_nodes, strict=True):
        rows = y1 - y0
        cols = x1 - x0
        # A pixel's sides in the image.
        origin = nodes[0, 0]
        down = (nodes[-1, 0] - origin) / rows
        across = (nodes[0, -1] - origin) / cols
        area = abs(down[0] * across[1] - down[1] * across[0])
        if area <= _FLAT * max(down @ down, across @ across):
            # a line or a point of the source: one value spread over the patch would look like a
            # map.
            continue
        upper, lower = nodes[::3, ::3]
        height = np.linalg.norm(lower - upper, axis=-1).max()
        upper_width = np.linalg.norm(upper[1] - upper[0])
        width = max(upper_width, np.linalg.norm(lower[1] - lower[0]))
        target = out[y0:y1, x0:x1]
        if max(height / rows, width / cols) > LARGER:
            row_borders = np.arange(rows + 1) / rows
            col_borders = np.arange(cols + 1) / cols
            target[:] = _averaged(image, places(nodes, row_borders, col_borders))
        else:
            row_weights = _weights((np.arange(rows) + 0.5) / rows)
            col_weights = _weights((np.arange(cols) + 0.5) / cols)
            interpolate(image, nodes, row_weights, col_weights, 1.0 - _EDGE, target)


def _part(image: Array, positions: Floats, margin: int) -> tuple[Array, Floats]:
    """Part of an image under places (rows, cols, 2) and ``margin`` pixels around, NaN beside it.

    And its first pixel (x, y), which may lie outside of the image. Places are (x, y) in pixels of
    it.
    """
    least = np.floor(positions.min(axis=(0, 1)))
    largest = np.floor(positions.max(axis=(0, 1)))
    low = least.astype(np.int64) - margin
    high = largest.astype(np.int64) + 2 + margin
    pixel_count = np.prod((high - low).astype(np.float64))
    if pixel_count > 2**26:
        raise ResourceError(
            f"{pixel_count:.1e} pixels of the source lie under one pixel. Warp to smaller pixels"
            " first, then take means."
        )
    part = np.full(np.flip(high - low), np.nan, dtype=image.dtype)
    first = np.maximum(low, 0)
    last = np.minimum(high, image.shape[::-1])
    if np.all(last > first):
        x0, y0 = first - low
        x1, y1 = last - low
        first_col, first_row = first
        last_col, last_row = last
        part[y0:y1, x0:x1] = image[first_row:last_row, first_col:last_col]
    return part, low.astype(np.float64)


def _averaged(image: Array, nodes: Floats) -> Floats:
    """Means over the quadrilaterals between nodes (rows + 1, cols + 1, 2).

    NaN where less than half is known. Nodes are (x, y) in pixels of the image.
    """
    part, first = _part(image, nodes + 0.5, 1)
    is_valid = np.isfinite(part)
    # From here on a pixel of the source begins at a whole number.
    x, y = np.moveaxis(nodes + 0.5 - first, -1, 0)
    # Areas above the sides of the quadrilaterals, whose sum around one is its own (Green).
    mean_y_along = 0.5 * (y[:, :-1] + y[:, 1:])
    along = mean_y_along * np.diff(x, axis=1)
    mean_y_aside = 0.5 * (y[:-1] + y[1:])
    side = mean_y_aside * np.diff(x, axis=0)
    area = along[:-1] + np.diff(side, axis=1) - along[1:]
    falling = nodes[1:, 1:] - nodes[:-1, :-1]
    rising = nodes[:-1, 1:] - nodes[1:, :-1]
    falling_square = np.sum(falling**2, axis=-1)
    longest = np.maximum(falling_square, np.sum(rising**2, axis=-1))
    area[2 * np.abs(area) <= _FLAT * longest] = np.nan
    total = integrals(_sums(np.where(is_valid, part, 0.0)), x, y)
    weight = area if is_valid.all() else integrals(_sums(is_valid), x, y)
    share = weight / area
    mean = total / np.where(share > 0, weight, 1.0)
    return np.where(share >= 0.5 - _EDGE, mean, np.nan)


def _sums(values: Array) -> Floats:
    """Sums (rows + 1, cols) of the values of each column above each row."""
    sums = np.zeros((values.shape[0] + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=sums[1:])
    return sums


def find_patches(mapping: Mapping, tile: Tile, source: Shape) -> tuple[Integers, Floats]:
    """Cut a tile of the target into patches.

    Those that show nothing of the source (rows, cols) are left out.

    ``mapping`` goes from points (..., 2) of the target to the source, both (x, y) in pixels.
    Returns the bounds (n, 4) of the patches: first row, row after the last, first column, column
    after the last; and the places (n, 4, 4, 2), (x, y) in source pixels, of points at thirds of
    their height and width, outline included.
    """
    # Bounds of blocks: first row, row after the last, and likewise columns, (n, 4).
    bounds = np.array(tiles_of(tile.shape, (_BLOCK, _BLOCK)), np.int64)
    bounds += np.repeat([tile.r0, tile.c0], 2)
    patches: list[tuple[Integers, Floats]] = []

    def places_at(shares: Floats) -> Floats:
        y0, y1, x0, x1 = bounds.T[..., None]
        y = y0 + shares * (y1 - y0) - 0.5
        x = x0 + shares * (x1 - x0) - 0.5
        columns = np.broadcast_arrays(x[:, None, :], y[:, :, None])
        return mapping(np.stack(columns, axis=-1))

    while len(bounds):
        nodes = places_at(_NODES)
        tests = places_at(_TEST)
        node_known = are_known(nodes)
        test_known = are_known(tests)
        is_finite = node_known.all(axis=(1, 2)) & test_known.all(axis=(1, 2))
        is_defined = node_known.any(axis=(1, 2)) | test_known.any(axis=(1, 2))
        errors = np.linalg.norm(places(nodes, _TEST, _TEST) - tests, axis=-1)
        error = np.where(is_finite, errors.max(axis=(1, 2)), np.inf)
        low = nodes.min(axis=(1, 2))
        high = nodes.max(axis=(1, 2))
        # a patch that is further away from the source shows nothing of it.
        margin = (2 * error + 2.0)[:, None]
        last_pixel = (source[1] - 1, source[0] - 1)
        is_beyond = (high + margin < 0) | (low - margin > last_pixel)
        is_empty = (is_finite & is_beyond.any(axis=1)) | ~is_defined
        y0, y1, x0, x1 = bounds.T
        is_single = (y1 - y0 == 1) & (x1 - x0 == 1)
        # Where it is tested the polynomial may err by half; the rest is for between the tests. What
        # is summed for area means stays in the cache where no more pixels of the source lie under a
        # patch.
        source_area = (high - low).prod(axis=1)
        small = (error <= 0.5 * TOLERANCE) & (source_area <= 2**18)
        is_patch = is_finite & ~is_empty & (small | is_single)
        patches.append((bounds[is_patch], nodes[is_patch]))
        # The others are cut in the middle of both sides.
        y0, y1, x0, x1 = bounds[~(is_patch | is_empty | is_single)].T
        y = (y0 + y1 + 1) // 2
        x = (x0 + x1 + 1) // 2
        quarters = [
            (y0, y, x0, x),
            (y0, y, x, x1),
            (y, y1, x0, x),
            (y, y1, x, x1),
        ]
        bounds = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
        y0, y1, x0, x1 = bounds.T
        bounds = bounds[(y1 > y0) & (x1 > x0)]
    all_bounds, all_nodes = zip(*patches, strict=True)
    return np.concatenate(all_bounds), np.concatenate(all_nodes)


def places(nodes: Floats, v: Floats, u: Floats) -> Floats:
    """Evaluate polynomials through nodes (..., 4, 4, 2).

    The values, (..., p, q, 2), are those at shares (p,) of the height and (q,) of the width.
    """
    # x and y apart, for matrices of rows and columns.
    coordinates = np.moveaxis(nodes, -1, -3)
    values = _weights(v) @ coordinates @ _weights(u).T
    return np.moveaxis(values, -3, -1)


def _weights(shares: Floats) -> Floats:
    """Weights (n, 4) of the nodes in the polynomial through them, at shares (n,) of the way."""
    weights: list[Floats] = []
    for node in _NODES:
        factors = [(shares - other) / (node - other) for other in _NODES if other != node]
        weights.append(np.prod(factors, axis=0))
    return np.stack(weights, axis=-1)
