"""The place of a sheet in an image, from near it on, by the texture that both show.

The place of the whole, and of tiles.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import ndimage, optimize

from planish.core.grid import Grid
from planish.core.robust import rms_length
from planish.core.transform import NearSimilarity, Similarity, grid_points, nearest_similarity
from planish.core.typing import Bools, Floats, Pair, Texts
from planish.register.by_texture.rotations import Names, compared
from planish.texture.detrend import PhaseSurrogate
from planish.texture.lag_field import lag_field
from planish.texture.lag_search import LagSearch
from planish.texture.ncc import MARGIN, find_peak, within
from planish.texture.textures import Textures, relate, standard

_LEAST_PIXELS, _MOST_PIXELS = 100, 15_000  # that both layers show; of them, used for tuning
_REACH_UM = 25.0  # of a tile about the place of the whole
_OF_LIGHT = 0.2  # of the shift that slopes take off, by which that may be wrong
_MOST_TILES = 0.75  # that lie there where a specimen is rigid
_TILE_Z = 7.0  # standard deviations of chance by which a tile should stand out


Placing = Similarity | NearSimilarity


def tuned_place(
    moving: Textures,
    fixed: Textures,
    names: Names,
    start: Similarity,
    *,
    reach_um: float,
    other_maps: Texts,
) -> Similarity:
    """Climb from a place to where a map, with those ``other_maps``, explains most of the image.

    What an image shows of other maps, and of the face's slopes in light from one side, moves one
    map's best place. ``reach_um`` is about how far off the corners of the map are at the start.
    """
    rows, cols = np.nonzero(moving.known)
    every = max(rows.size // _MOST_PIXELS, 1)  # neighbours say the same
    rows, cols = rows[::every], cols[::every]
    points = np.column_stack([cols, rows]) * moving.pixel_um[::-1]
    maps = np.stack([moving.maps[k][rows, cols] for k in (names[0], *other_maps)])
    middle = points.mean(axis=0)
    image = _Sampled(fixed, names[1])
    arm_um = rms_length(points - middle)

    def placed(p: Floats) -> Similarity:
        scale = start.scale * math.exp(p[3] / arm_um)
        rotation_rad = start.rotation_rad + p[2] / arm_um
        turn = replace(start, scale=scale, rotation_rad=rotation_rad)
        return nearest_similarity(turn.matrix(), middle, start(middle) + p[:2])

    def unexplained(p: Floats) -> float:
        grey, is_known = image(placed(p)(points))
        if np.count_nonzero(is_known) < _LEAST_PIXELS:
            return 1.0
        known_maps = maps[:, is_known]
        centred = known_maps - known_maps.mean(axis=1, keepdims=True)
        grey = grey[is_known] - grey[is_known].mean()
        products = centred @ grey
        explained = products @ np.linalg.pinv(centred @ centred.T) @ products
        return 1.0 - float(explained / (grey @ grey))

    simplex = np.concatenate([np.zeros((1, 4)), 0.5 * reach_um * np.eye(4)])
    optimum = optimize.minimize(
        unexplained,
        np.zeros(4),
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 0.05, "fatol": 1e-6, "maxfev": 400},
    )
    return placed(optimum.x)


def shifted_place(
    moving: Textures,
    fixed: Textures,
    names: Names,
    place: Similarity,
    *,
    reach_um: float,
    other_maps: Texts,
) -> Similarity:
    """Shift a place to where a map, with those ``other_maps``, explains most of the image.

    A map goes with its own slopes a quarter of a wave off. Where those are much of what an image
    shows, it is found there, and cannot climb back.
    """
    image, is_valid = _on_moving_pixels(moving, fixed, names[1], place)
    shown = _standard_maps(moving, (names[0], *other_maps), is_valid)
    rows, cols = (round(reach_um / p) for p in moving.pixel_um)
    search = LagSearch(shown, image, is_valid, (rows + MARGIN, cols + MARGIN))
    peak = find_peak(search.share, within((rows, cols)))
    if peak is None:
        return place
    lag_um = np.multiply(peak.lag_px, moving.pixel_um)[::-1]
    return nearest_similarity(place.matrix(), np.zeros(2), place(lag_um))


def clearest_maps(moving: Textures, fixed: Textures, place: Similarity) -> Names:
    """The maps that go together most clearly at a place."""

    def z(names: Names) -> float:
        image, is_valid = _on_moving_pixels(moving, fixed, names[1], place)
        relation = relate(moving.maps[names[0]], image, is_valid, moving.pixel_um)
        return abs(relation.z)

    return max(compared(moving, fixed), key=z)


class TilePlaces(NamedTuple):
    """Places (n, 2), ``(x, y)`` in um, of tiles in both layers.

    In the fixed one: covariances (n, 2, 2) by the tiles' texture, and that (2, 2) of what one-sided
    light does to all.
    """

    moving_um: Floats
    fixed_um: Floats
    covariance_um2: Floats
    shared_um2: Floats
    r: float  # of the whole map at the place from which the tiles were sought
    place: Similarity  # of the whole map
    is_there: bool  # whether most tiles show by themselves that they lie there, to a pixel


def tile_places(
    moving: Textures,
    fixed: Textures,
    names: Names,
    place: Placing,
    *,
    other_maps: Texts,
    light: Texts,
    strain: float = 0.0,
) -> TilePlaces:
    """Find where tiles of a map lie in the image, near the place of the whole.

    Tiles share no pixel. Their side follows from how far the whole stands out from chance: each has
    to by itself. What the maps ``other_maps`` and ``light``, the slopes of the face, explain is
    taken with it: light moves no tile. ``strain`` is that by which the layers may differ from the
    place: tiles are sought as far off as it takes the corners, and none is so large that it blurs
    them.
    """
    pixel_um = moving.pixel_um
    b, is_valid = _on_moving_pixels(moving, fixed, names[1], place)
    shown = _standard_maps(moving, (names[0], *other_maps, *light), is_valid)
    a = shown[0]
    relation = relate(a, b, is_valid, pixel_um)
    shared_um2 = np.zeros((2, 2))
    if light:
        shared_um2 = _shared(shown, b, is_valid, pixel_um, slopes=len(light))
    if len(shown) > 1:
        weights, *_ = np.linalg.lstsq(shown[:, is_valid].T, b[is_valid], rcond=None)
        a = math.copysign(1.0, weights[0]) * np.tensordot(weights, shown, 1)
        a = standard(a, is_valid)
        relation = replace(relation, r=math.copysign(relation.r, weights[0]))
    row_um, col_um = pixel_um
    sides_um = np.multiply(moving.known.shape, pixel_um)
    reach_um = _REACH_UM + min(0.5 * strain * math.hypot(*sides_um), 0.1 * sides_um.min())
    reach = (max(round(reach_um / row_um), 3), max(round(reach_um / col_um), 3))
    least_um = 2.2 * np.multiply(np.add(reach, MARGIN), pixel_um).max()
    even_sides = np.array(moving.known.shape) // 2 * 2
    short_um = np.multiply(even_sides, pixel_um).min()
    stands_out = abs(relation.z) / _TILE_Z
    side_um = math.sqrt(moving.n * row_um * col_um) / max(stands_out, 1e-9)
    side_um = min(side_um, 0.5 * short_um, _REACH_UM / max(strain, 1e-9))
    unrelated = PhaseSurrogate(b, is_valid).draws(9, np.random.default_rng(20090501))
    field = lag_field(
        math.copysign(1.0, relation.r) * a,
        b,
        is_valid,
        pixel_um,
        reach=reach,
        overlapping=False,
        tile_um=float(max(side_um, least_um)),
        unrelated=[*unrelated],
    )
    at_um, lag_um = field.at_um[field.distinct], field.lag_um[field.distinct]
    turn = place.matrix()
    off_um = np.hypot(*field.lag_um.T)
    there_count = np.count_nonzero(off_um <= max(pixel_um))
    covariance_um2 = field.covariance_um2[field.distinct]
    return TilePlaces(
        at_um,
        place(at_um + lag_um),
        turn @ covariance_um2 @ turn.T,
        turn @ shared_um2 @ turn.T,
        relation.r,
        place.similarity,
        bool(there_count >= _MOST_TILES * off_um.size),
    )


def _standard_maps(moving: Textures, names: Texts, is_valid: Bools) -> Floats:
    return np.stack([standard(moving.maps[name], is_valid) for name in names])


def _shared(
    shown: Floats, image: Floats, is_valid: Bools, pixel_um: Pair, *, slopes: int
) -> Floats:
    """Covariance (2, 2) of a shift of all tiles, ``(x, y)`` in um.

    It is due to what light from one side leaves.

    ``shown`` are maps, the last ones ``slopes`` of the face. A shift looks like such light, so the
    regression leaves some of it undecided; and what the slopes take off is known to a fifth, as no
    light is quite what they are.
    """
    reach = 3  # pixels along either axis
    lags = (reach + MARGIN, reach + MARGIN)
    is_near = within((reach, reach))
    search = LagSearch(shown, image, is_valid, lags)
    with_slopes = find_peak(search.share, is_near)
    search_without = LagSearch(shown[:-slopes], image, is_valid, lags)
    without = find_peak(search_without.share, is_near)
    if with_slopes is None or without is None or not with_slopes.inner:
        return np.diag([(0.5 * reach * p) ** 2 for p in pixel_um[::-1]])
    taken_off = _OF_LIGHT * (with_slopes.summit_px - without.summit_px)
    covariance = search.covariance(with_slopes, pixel_um) + np.outer(taken_off, taken_off)
    xy_um = pixel_um[::-1]
    return covariance[::-1, ::-1] * np.outer(xy_um, xy_um)


def _on_moving_pixels(
    moving: Textures, fixed: Textures, name: str, place: Placing
) -> tuple[Floats, Bools]:
    """What a map of the fixed layer shows on the pixels of the moving one, and where both do."""
    grid = Grid.regular(moving.known.shape, moving.pixel_um)
    points = grid_points(grid.x_um, grid.y_um)
    values, is_known = _Sampled(fixed, name)(place(points))
    is_valid = moving.known & is_known
    return standard(np.where(is_valid, values, 0.0), is_valid), is_valid


class _Sampled:
    """A map of textures between its pixels."""

    def __init__(self, fixed: Textures, name: str) -> None:
        self._pixel_um = np.array(fixed.pixel_um[::-1])
        self._spline = np.asarray(ndimage.spline_filter(fixed.maps[name]), dtype=np.float64)
        self._known = fixed.known.astype(np.float64)

    def __call__(self, points: Floats) -> tuple[Floats, Bools]:
        """Values at points (..., 2), ``(x, y)`` in um, and which of them are known."""
        pixels = np.moveaxis(points / self._pixel_um, -1, 0)[::-1]
        grey = ndimage.map_coordinates(self._spline, pixels, order=3, prefilter=False)
        return grey, ndimage.map_coordinates(self._known, pixels, order=1) >= 0.5
