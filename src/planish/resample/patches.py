"""Patches of a target grid in which a transformation is bilinear, near enough: any transformation at little cost.

The target is cut into blocks of 512 pixels. In each, the transformation is asked at 4 x 4 points, which give a
polynomial of third degree in each direction, and at 3 x 3 points between them, where that polynomial errs most. Blocks
where it errs too much are cut into four. The polynomial then says how small a patch has to be for a bilinear map. So a
thin-plate spline is evaluated once in some thousand pixels, and an affine transformation is met exactly.

The blocks lie where the grid says and nowhere else: no result depends on what is worked on together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.core.tiles import Tile

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Mapping = Callable[[Floats], Floats]

TOLERANCE = 0.01
"""What a place may be wrong by, in source pixels."""

_BLOCK = 512  # target pixels
_MODEL = 0.2 * TOLERANCE  # what the polynomial may err by where it is tested
_BILINEAR = 0.7 * TOLERANCE  # what the bilinear map may differ from the polynomial; the rest is for between the tests
_MOST_PIXELS = 2**18  # of the source under a patch: what is summed for area means then stays in the cache
_NEAR = 2.0  # source pixels: a patch that is further away from the source than this shows nothing of it
_NODES = np.array([0.0, 1.0, 2.0, 3.0]) / 3
_TEST = np.array([1.0, 3.0, 5.0]) / 6
_SCALE = np.array([np.prod([a - b for b in _NODES if b != a]) for a in _NODES])


@dataclass(frozen=True, slots=True, kw_only=True)
class Patches:
    """Rectangles of the target and where their outlines lie in the source.

    Attributes
    ----------
    bounds : (n, 4)
        First row, row after the last, first column, column after the last of the target.
    corners : (n, 2, 2, 2), in source pixels
        (x, y) of the outline's corners; the middle of the first pixel is (0, 0). First axis down, second across.
    """

    bounds: Whole
    corners: Floats

    def __len__(self) -> int:
        """Number of patches."""
        return len(self.bounds)

    def some(self, which: NDArray[np.intp]) -> Patches:
        """Return some of them."""
        return Patches(bounds=self.bounds[which], corners=self.corners[which])


def find_patches(mapping: Mapping, tile: Tile, source: tuple[int, int]) -> Patches:
    """Cut a tile of the target into patches; those that show nothing of the source are left out.

    Parameters
    ----------
    mapping : callable
        From points (..., 2) of the target to the source, both (x, y) in pixels; NaN where there is none.
    tile : Tile
        Rows and columns of the target. Tiles have to begin at multiples of the same number of blocks.
    source : (int, int)
        Rows and columns of the source.
    """
    bounds = _blocks(tile)
    parts: list[Patches] = []
    while len(bounds):
        nodes, tests = _asked(mapping, bounds, _NODES), _asked(mapping, bounds, _TEST)
        finite = np.isfinite(nodes).all(axis=(1, 2, 3)) & np.isfinite(tests).all(axis=(1, 2, 3))
        error = np.where(finite, _norm(_model(nodes, _TEST[None], _TEST[None]) - tests).max(axis=(1, 2)), np.inf)
        nowhere = ~np.isfinite(nodes).any(axis=(1, 2, 3)) & ~np.isfinite(tests).any(axis=(1, 2, 3))
        nowhere |= finite & _beside(nodes, 2 * error + _NEAR, source)
        good = finite & ~nowhere & ((error <= _MODEL) | _single(bounds))
        parts.append(_bilinear(bounds[good], nodes[good], source))
        bounds = _quarters(bounds[~(good | nowhere | _single(bounds))])[0]
    return Patches(bounds=np.concatenate([p.bounds for p in parts]), corners=np.concatenate([p.corners for p in parts]))


def _bilinear(blocks: Whole, nodes: Floats, source: tuple[int, int]) -> Patches:
    """Cut blocks with their polynomials until a bilinear map will do."""
    down, across = _curved(nodes), _curved(nodes.swapaxes(1, 2))
    bounds, of = blocks, np.arange(len(blocks))
    found: list[Whole] = [np.empty((0, 4), np.int64)]
    places: list[Floats] = [np.empty((0, 2, 2, 2))]
    while len(bounds):
        height, width = blocks[of, 1] - blocks[of, 0], blocks[of, 3] - blocks[of, 2]
        v = (bounds[:, :2] - blocks[of, :1]) / height[:, None]
        u = (bounds[:, 2:] - blocks[of, 2:3]) / width[:, None]
        corners = _model(nodes[of], v, u)
        error = down[of] * (v[:, 1] - v[:, 0]) ** 2 + across[of] * (u[:, 1] - u[:, 0]) ** 2
        extent = corners.max(axis=(1, 2)) - corners.min(axis=(1, 2))
        kept = ((error <= _BILINEAR) & (extent.prod(axis=1) <= _MOST_PIXELS)) | _single(bounds)
        nowhere = _beside(corners, error + _NEAR, source)
        found.append(bounds[kept & ~nowhere])
        places.append(corners[kept & ~nowhere])
        bounds, parent = _quarters(bounds[~kept & ~nowhere])
        of = of[~kept & ~nowhere][parent]
    return Patches(bounds=np.concatenate(found), corners=np.concatenate(places))


def _blocks(tile: Tile) -> Whole:
    r, c = (np.arange(a, b, _BLOCK) for a, b in ((tile.r0, tile.r1), (tile.c0, tile.c1)))
    rows, cols = (g.ravel() for g in np.meshgrid(r, c, indexing="ij"))
    ends = np.minimum(rows + _BLOCK, tile.r1), np.minimum(cols + _BLOCK, tile.c1)
    return np.stack([rows, ends[0], cols, ends[1]], axis=1).astype(np.int64)


def _asked(mapping: Mapping, bounds: Whole, at: Floats) -> Floats:
    """Images of the points at the shares ``at`` of each rectangle's height and width: (n, points, points, 2)."""
    y = bounds[:, :1] + at * (bounds[:, 1:2] - bounds[:, :1]) - 0.5
    x = bounds[:, 2:3] + at * (bounds[:, 3:] - bounds[:, 2:3]) - 0.5
    return mapping(np.stack(np.broadcast_arrays(x[:, None, :], y[:, :, None]), axis=-1))


def _model(nodes: Floats, v: Floats, u: Floats) -> Floats:
    """Polynomials through 4 x 4 points at shares (n, p) of the height and (n, q) of the width: (n, p, q, 2)."""
    return _along(_along(nodes, v).swapaxes(1, 2), u).swapaxes(1, 2)


def _along(nodes: Floats, at: Floats) -> Floats:
    """The polynomial along the second axis (n, 4, ...), at shares (n, p)."""
    # A straight line and what is added to it: an affine map stays one to the last digits.
    first, span = nodes[:, :1], nodes[:, 3:] - nodes[:, :1]
    t = at[..., None, None]
    rest = nodes - first - _NODES[:, None, None] * span
    for k in (1, 2):
        others = np.prod([at - b for j, b in enumerate(_NODES) if j != k], axis=0) / _SCALE[k]
        first = first + others[..., None, None] * rest[:, k : k + 1]
    return first + t * span


def _curved(nodes: Floats) -> Floats:
    """What the polynomials along the second axis differ from a straight line by at most: (n,)."""
    second = nodes[:, :2] - 2 * nodes[:, 1:3] + nodes[:, 2:]
    # The second derivative runs straight from end to end.
    ends = np.stack([2 * second[:, 0] - second[:, 1], 2 * second[:, 1] - second[:, 0]])
    return 9 / 8 * _norm(ends).max(axis=(0, 2))


def _norm(vectors: Floats) -> Floats:
    return np.hypot(vectors[..., 0], vectors[..., 1])


def _single(bounds: Whole) -> NDArray[np.bool_]:
    return (bounds[:, 1] - bounds[:, 0] == 1) & (bounds[:, 3] - bounds[:, 2] == 1)


def _beside(points: Floats, margin: Floats, source: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether all points (n, p, q, 2) lie beside the source, on the same side."""
    low, high = points.min(axis=(1, 2)) - margin[:, None], points.max(axis=(1, 2)) + margin[:, None]
    return np.any((high < 0) | (low > (source[1] - 1, source[0] - 1)), axis=1)


def _quarters(bounds: Whole) -> tuple[Whole, NDArray[np.intp]]:
    """Cut rectangles in the middle of both sides, and give the number of the one that each part is of."""
    y, x = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0] + 1) // 2, bounds[:, 2] + (bounds[:, 3] - bounds[:, 2] + 1) // 2
    y0, y1, x0, x1 = bounds.T
    parts = np.concatenate(
        [np.stack(e, axis=1) for e in ((y0, y, x0, x), (y0, y, x, x1), (y, y1, x0, x), (y, y1, x, x1))]
    )
    of = np.tile(np.arange(len(bounds)), 4)
    some = (parts[:, 1] > parts[:, 0]) & (parts[:, 3] > parts[:, 2])
    return parts[some], of[some]
