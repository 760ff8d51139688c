"""The place of a sheet in an image, from near it on, by the texture that both show.

The place of the whole, and of tiles.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

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
    Places are from the moving to the fixed textures, in um from their first pixels.
    """
    map_name, image_name = names
    rows, cols = np.nonzero(moving.known)
    every = max(rows.size // _MOST_PIXELS, 1)  # neighbours say the same
    rows = rows[::every]
    cols = cols[::every]
    points = np.column_stack([cols, rows]) * moving.pixel_um[::-1]
    names_of_maps = (map_name, *other_maps)
    maps = np.stack([moving.maps[name][rows, cols] for name in names_of_maps])
    middle = points.mean(axis=0)
    image = _Sampled(fixed, image_name)
    arm_um = rms_length(points - middle)

    # Shift along x and y, turn and stretch, each as a length at the arm, in um.
    def placed(step: Floats) -> Similarity:
        shift_um, (turn_um, stretch_um) = step.reshape(2, 2)
        scale = start.scale * math.exp(stretch_um / arm_um)
        rotation_rad = start.rotation_rad + turn_um / arm_um
        turn = replace(start, scale=scale, rotation_rad=rotation_rad)
        return nearest_similarity(turn.matrix(), middle, start(middle) + shift_um)

    # 1 - R² of a regression of the image on all maps.
    def unexplained(step: Floats) -> float:
        grey, is_known = image(placed(step)(points))
        if np.count_nonzero(is_known) < _LEAST_PIXELS:
            return 1.0
        known_maps = maps[:, is_known]
        centred = known_maps - known_maps.mean(axis=1, keepdims=True)
        grey = grey[is_known]
        grey = grey - grey.mean()
        products = centred @ grey
        explained = products @ np.linalg.pinv(centred @ centred.T) @ products
        return 1.0 - float(explained / (grey @ grey))

    start_step = np.zeros(4)
    simplex = np.vstack([start_step, 0.5 * reach_um * np.eye(4)])
    limits: Any = {"initial_simplex": simplex, "xatol": 0.05, "fatol": 1e-6, "maxfev": 400}
    optimum = optimize.minimize(unexplained, start_step, method="Nelder-Mead", options=limits)
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
    shows, it is found there, and cannot climb back. Lags up to ``reach_um`` are tried; the place
    stays where none of them can be judged.
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
    them. Tiles that do not stand out from chance, or doubt the place of another one, are left out.
    """
    pixel_um = moving.pixel_um
    map_name, image_name = names
    b, is_valid = _on_moving_pixels(moving, fixed, image_name, place)
    shown = _standard_maps(moving, (map_name, *other_maps, *light), is_valid)
    a, *more_maps = shown
    relation = relate(a, b, is_valid, pixel_um)
    shared_um2 = np.zeros((2, 2))
    if light:
        shared_um2 = _shared(shown, b, is_valid, pixel_um, slopes=len(light))
    if more_maps:
        columns = shown[:, is_valid].T
        weights, *_ = np.linalg.lstsq(columns, b[is_valid], rcond=None)
        # All maps as the image shows them, with the sign of the map that leads.
        sign = math.copysign(1.0, weights[0])
        a = standard(sign * np.tensordot(weights, shown, 1), is_valid)
        relation = replace(relation, r=math.copysign(relation.r, sign))
    sides_um = np.multiply(moving.known.shape, pixel_um)
    corner_um = 0.5 * strain * math.hypot(*sides_um)
    reach_um = _REACH_UM + min(corner_um, 0.1 * sides_um.min())
    row_reach, col_reach = (max(round(reach_um / p), 3) for p in pixel_um)
    # A tile that is correlated at all these lags keeps half of its pixels.
    searched_um = np.multiply((row_reach + MARGIN, col_reach + MARGIN), pixel_um)
    least_um = 2.2 * searched_um.max()
    even_sides = np.array(moving.known.shape) // 2 * 2
    short_um = np.multiply(even_sides, pixel_um).min()
    stands_out = abs(relation.z) / _TILE_Z
    row_um, col_um = pixel_um
    whole_um = math.sqrt(moving.n * row_um * col_um)
    side_um = whole_um / max(stands_out, 1e-9)
    side_um = min(side_um, 0.5 * short_um, _REACH_UM / max(strain, 1e-9))
    unrelated = PhaseSurrogate(b, is_valid).draws(9, np.random.default_rng(20090501))
    field = lag_field(
        math.copysign(1.0, relation.r) * a,
        b,
        is_valid,
        pixel_um,
        reach=(row_reach, col_reach),
        overlapping=False,
        tile_um=float(max(side_um, least_um)),
        unrelated=[*unrelated],
    )
    at_um = field.at_um[field.distinct]
    lag_um = field.lag_um[field.distinct]
    turn = place.matrix()
    off_um = np.hypot(*field.lag_um.T)
    there_count = np.count_nonzero(off_um <= max(pixel_um))
    covariance_um2 = field.covariance_um2[field.distinct]
    return TilePlaces(
        moving_um=at_um,
        fixed_um=place(at_um + lag_um),
        covariance_um2=turn @ covariance_um2 @ turn.T,
        shared_um2=turn @ shared_um2 @ turn.T,
        r=relation.r,
        place=place.similarity,
        is_there=bool(there_count >= _MOST_TILES * off_um.size),
    )


def _standard_maps(moving: Textures, names: Texts, is_valid: Bools) -> Floats:
    """Some of the maps (names, rows, cols), each of mean 0 and standard deviation 1 where valid."""
    return np.stack([standard(moving.maps[name], is_valid) for name in names])


def _shared(
    shown: Floats, image: Floats, is_valid: Bools, pixel_um: Pair, *, slopes: int
) -> Floats:
    """Covariance (2, 2) of a shift of all tiles, ``(x, y)`` in um.

    It is due to what light from one side leaves.

    ``shown`` are maps (maps, rows, cols), the last ones ``slopes`` of the face. A shift looks like
    such light, so the regression leaves some of it undecided; and what the slopes take off is known
    to a fifth, as no light is quite what they are. Where no summit is near, it may be anywhere
    within the half of what is searched.
    """
    xy_um = pixel_um[::-1]
    reach = 3  # pixels along either axis
    lags = (reach + MARGIN, reach + MARGIN)
    is_near = within((reach, reach))
    search = LagSearch(shown, image, is_valid, lags)
    with_slopes = find_peak(search.share, is_near)
    search_without = LagSearch(shown[:-slopes], image, is_valid, lags)
    without = find_peak(search_without.share, is_near)
    if with_slopes is None or without is None or not with_slopes.inner:
        return np.diag(np.multiply(0.5 * reach, xy_um) ** 2)
    taken_off = _OF_LIGHT * (with_slopes.summit_px - without.summit_px)
    # In pixels, rows before columns.
    covariance = search.covariance(with_slopes, pixel_um) + np.outer(taken_off, taken_off)
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
        spline = ndimage.spline_filter(fixed.maps[name])
        self._spline = np.asarray(spline, dtype=np.float64)
        self._known = fixed.known.astype(np.float64)

    def __call__(self, points: Floats) -> tuple[Floats, Bools]:
        """Values at points (..., 2), ``(x, y)`` in um, and which of them are known."""
        pixels = np.moveaxis(points / self._pixel_um, -1, 0)
        row_col = pixels[::-1]
        grey = ndimage.map_coordinates(self._spline, row_col, order=3, prefilter=False)
        known_share = ndimage.map_coordinates(self._known, row_col, order=1)
        return grey, known_share >= 0.5
