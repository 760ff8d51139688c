"""Where a sheet lies in an image, by the texture that both show: rotation, hand, scale and shift, and how sure that is.

Every map that may show in the image is correlated with it at every rotation, hand, scale and shift. A correlation
counts in standard deviations of its own map's null: what the same map reaches at the places that are wrong. How high
the best of so many wrong places gets is read off the best of every rotation but those beside the one that is judged.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage, optimize

from planish.analyze.detrend import PhaseSurrogate
from planish.analyze.lag_field import lag_field
from planish.analyze.ncc import MARGIN
from planish.analyze.texture import Textures, relate, standard
from planish.core.transform import Similarity, nearest_similarity
from planish.core.typing import Bools, Floats

BAND_UM = (18.0, 150.0)
"""Waves that a scan and an image share: shorter ones are noise, longer ones light and print."""
FALSE = 4e-4
"""Largest probability, of an image that shows nothing of the sheet, to be linked all the same."""
_OVERLAP = 0.4  # least share of the map that lies in the image
_NEAR_DEG, _NEAR_UM = 8.0, 150.0  # of a place, within which another one is the same
_STEP = 2500.0  # um degrees: rotations are tried in steps of this over the size of the map
_SCALE_STEP = 30.0  # um: scales in steps of this over the size of the map
_CANDIDATES = 5
_LEAST_PIXELS, _MOST_PIXELS = 100, 15_000  # that both layers show; of them, used for tuning
_REACH_UM = 25.0  # of a tile about the place of the whole
_TILE_Z = 7.0  # standard deviations of chance by which a tile should stand out

Slab = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A place of the sheet in the image."""

    name: str  # of the map that leads
    z: float  # standard deviations of the map's null
    r: float  # correlation over the pixels that both show
    place: Similarity  # from the moving layer to the fixed one, in um


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceSearch:
    """Places of the sheet in the image, the best first, and how sure that one is."""

    candidates: tuple[Candidate, ...]
    false_probability: float  # that textures which have nothing in common reach as much at any place

    @property
    def best(self) -> Candidate:
        """The best place."""
        return self.candidates[0]

    @property
    def is_sure(self) -> bool:
        """Whether the layers can be linked there."""
        return self.false_probability <= FALSE


class _Peak(NamedTuple):
    """The highest correlation of a map at one rotation, hand and scale."""

    turn: Similarity  # without its shift
    name: str
    height: float  # sum of products over the root of the number of pairs
    r: float
    at: tuple[int, int]  # pixel of the image at which the middle of the map lies


def search_place(
    moving: Textures, fixed: Textures, *, mirrored: bool | None, scale_tolerance: float = 0.02
) -> PlaceSearch:  # fmt: skip
    """Search all places of a sheet in an image.

    Parameters
    ----------
    moving : Textures
        Maps of the sheet that may show in the image.
    fixed : Textures
        ``image``, with pixels that are not larger than those of the sheet by much.
    mirrored : bool, optional
        Whether the layers see each other mirrored; both are tried where not given.
    scale_tolerance : float
        Largest deviation of the scale from 1.

    Returns
    -------
    PlaceSearch

    Notes
    -----
    Of textures that are unrelated, the correlation at all shifts is a smooth Gaussian field, whose maximum exceeds z
    with a probability near ``A z exp(-z**2 / 2)`` (Adler and Taylor 2007, chapter 14). A, and a factor to z for fields
    that are not quite Gaussian, are those with which half and one in ten of the rotations exceed what they do.
    """
    scanner = _Scanner(moving, fixed)
    size_um = math.sqrt(moving.n * moving.pixel_um[0] * moving.pixel_um[1])
    rotations = np.linspace(0.0, 360.0, math.ceil(360.0 / (_STEP / size_um)), endpoint=False)
    count = 2 * math.ceil(scale_tolerance * size_um / _SCALE_STEP - 0.5) + 1
    scales = 1.0 + scale_tolerance * (count - 1) / max(count, 1) * np.linspace(-1.0, 1.0, count) if count > 1 else [1.0]
    hands = (False, True) if mirrored is None else (mirrored,)
    square_sums, shift_counts = dict.fromkeys(moving.maps, 0.0), dict.fromkeys(moving.maps, 0)
    cells: list[list[_Peak]] = []
    for hand, rotation in product(hands, np.deg2rad(rotations).tolist()):
        cell: list[_Peak] = []
        pairs = scanner.pairs(Similarity(rotation_rad=rotation, mirrored=hand))
        enough = scanner.enough(pairs)
        for scale in scales:
            turn = Similarity(scale=float(scale), rotation_rad=rotation, mirrored=hand)
            products = scanner.products(turn)
            for name, values in products.items():
                height = np.where(enough, values / np.sqrt(np.maximum(pairs, 1.0)), 0.0)
                square_sums[name] += float(np.vdot(height, height))
                shift_counts[name] += int(np.count_nonzero(enough))
                at = divmod(int(np.argmax(np.abs(height))), height.shape[1])
                cell.append(_Peak(turn, name, float(height[at]), float(values[at] / max(pairs[at], 1.0)), at))
        cells.append(cell)
    null_sd = {k: math.sqrt(square_sums[k] / max(shift_counts[k], 1)) or 1.0 for k in moving.maps}
    best_of_cells = [max(cell, key=lambda p: abs(p.height) / null_sd[p.name]) for cell in cells]
    candidates: list[Candidate] = []
    for peak in sorted(best_of_cells, key=lambda p: -abs(p.height) / null_sd[p.name]):
        place = scanner.place(peak.turn, peak.at)
        if all(_apart(place, c.place, scanner.middle_um) for c in candidates):
            z = abs(peak.height) / null_sd[peak.name]
            candidates.append(Candidate(name=peak.name, z=z, r=peak.r, place=place))
        if len(candidates) == _CANDIDATES:
            break
    best = candidates[0]
    others = np.array([
        abs(p.height) / null_sd[p.name] for p in best_of_cells
        if p.turn.mirrored != best.place.mirrored or not _same_turn(p.turn, best.place)
    ])  # fmt: skip
    probability = _exceeded(best.z, others) if others.size >= 20 else 1.0
    return PlaceSearch(candidates=tuple(candidates), false_probability=probability)


def _same_turn(a: Similarity, b: Similarity) -> bool:
    difference = math.degrees(a.rotation_rad - b.rotation_rad)
    return abs((difference + 180.0) % 360.0 - 180.0) < _NEAR_DEG


def _apart(a: Similarity, b: Similarity, middle_um: Floats) -> bool:
    """Whether two places are two."""
    is_shifted = float(np.linalg.norm(a(middle_um) - b(middle_um))) > _NEAR_UM
    return a.mirrored != b.mirrored or not _same_turn(a, b) or is_shifted


def _exceeded(z: float, others: Floats) -> float:
    """Probability that any of so many rotations, and one more, of unrelated textures reaches z."""
    half, tenth = np.quantile(others, [0.5, 0.9])
    if not half > 0.0:  # a constant image, or none of it known, is like nothing
        return 1.0
    # -log(1 - P) = A x exp(-x**2 / 2) with x = z / s, at both quantiles: their logarithms give s, then A.
    drop = math.log(math.log(2.0) / -math.log(0.9))

    def miss(log_s: float) -> float:
        return 0.5 * (tenth**2 - half**2) * math.exp(-2.0 * log_s) - math.log(tenth / half) - drop

    low, high = math.log(0.8), math.log(3.0)  # a factor below 0.8 is chance among few rotations
    s = math.exp(optimize.brentq(miss, low, high)) if miss(low) > 0.0 > miss(high) else 0.8 if miss(low) <= 0.0 else 3.0
    x_half, x = half / s, z / s
    log_rate = math.log(math.log(2.0)) + math.log(x / x_half) + 0.5 * (x_half**2 - x**2)
    return -math.expm1(-(others.size + 1) * math.exp(min(log_rate, 10.0)))


class _Scanner:
    """Correlates maps, turned about their middle, with an image at all shifts."""

    def __init__(self, moving: Textures, fixed: Textures) -> None:
        self._moving, self._fixed = moving, fixed
        self._moving_px, self._fixed_px = (np.array(t.pixel_um[::-1]) for t in (moving, fixed))  # x, y
        shape = np.array(moving.known.shape[::-1])
        self._size_um, self.middle_um = shape * self._moving_px, 0.5 * (shape - 1) * self._moving_px
        self._splines = {k: np.asarray(ndimage.spline_filter(m), dtype=np.float32) for k, m in moving.maps.items()}
        self._mask = moving.known.astype(np.float32)
        self._most = moving.n * float(np.prod(self._moving_px / self._fixed_px))
        reach = math.ceil(1.05 * float(np.hypot(*self._size_um)) / float(self._fixed_px.min())) + 2
        self._shape = tuple(fft.next_fast_len(n + reach, real=True) for n in fixed.known.shape)
        self._image, self._known = (self._transform(m.astype(np.float32)) for m in (fixed.maps["image"], fixed.known))

    def products(self, turn: Similarity) -> dict[str, Slab]:
        """Sums of products of each map with the image, by the pixel at which the map's middle lies."""
        half, sampled = self._on_image(turn)
        mask = self._turned_mask(sampled)
        return {k: self._lags(self._image, sampled(s, 3) * mask, half) for k, s in self._splines.items()}

    def pairs(self, turn: Similarity) -> Slab:
        """Numbers of pixels that lie on known ones of the image, by the pixel at which the map's middle lies."""
        half, sampled = self._on_image(turn)
        return np.maximum(self._lags(self._known, self._turned_mask(sampled), half), 0.0)

    def enough(self, pairs: Slab) -> Bools:
        """Shifts at which as much of the map as needed lies in the image."""
        return pairs >= _OVERLAP * self._most

    def place(self, turn: Similarity, at: tuple[int, int]) -> Similarity:
        """Transformation that puts the middle of the map on a pixel of the image."""
        return nearest_similarity(turn.matrix(), self.middle_um, np.array(at[::-1]) * self._fixed_px)

    def _on_image(self, turn: Similarity) -> tuple[tuple[int, int], Callable[[Slab, Literal[1, 3]], Slab]]:
        """Half the size, and the sampling, of a map on pixels of the image, no larger than it has to be."""
        matrix = turn.matrix()
        corners = np.array([*product((-0.5, 0.5), repeat=2)]) * self._size_um @ matrix.T
        half = np.ceil(np.abs(corners).max(axis=0) / self._fixed_px).astype(int)
        to_moving = (np.linalg.inv(matrix) * self._fixed_px) / self._moving_px[:, None]  # of pixels x, y
        offset = self.middle_um / self._moving_px - to_moving @ half
        shape = (2 * int(half[1]) + 1, 2 * int(half[0]) + 1)

        def sampled(values: Slab, order: Literal[1, 3]) -> Slab:
            return ndimage.affine_transform(
                values, to_moving[::-1, ::-1], offset[::-1], output_shape=shape, order=order, prefilter=False,
                output=np.float32,
            )  # fmt: skip

        return (shape[0] // 2, shape[1] // 2), sampled

    def _turned_mask(self, sampled: Callable[[Slab, Literal[1, 3]], Slab]) -> Slab:
        return (sampled(self._mask, 1) >= 0.5).astype(np.float32)

    def _transform(self, values: Slab) -> NDArray[np.complex64]:
        return np.asarray(fft.rfft2(values, self._shape, workers=2), dtype=np.complex64)

    def _lags(self, image: NDArray[np.complex64], part: Slab, half: tuple[int, int]) -> Slab:
        lags = np.asarray(fft.irfft2(image * np.conj(self._transform(part)), self._shape, workers=2), dtype=np.float32)
        rows, cols = (np.arange(n) - h for n, h in zip(self._fixed.known.shape, half, strict=True))
        return lags[np.ix_(rows % self._shape[0], cols % self._shape[1])]


def tuned_place(
    moving: Textures, fixed: Textures, name: str, start: Similarity, *, reach_um: float, light: tuple[str, ...] = ()
) -> Similarity:  # fmt: skip
    """Climb from a place to where a map, with the slopes of the face that ``light`` names, explains most of the image.

    ``reach_um`` is about how far off the corners of the map are at the start.
    """
    rows, cols = np.nonzero(moving.known)
    every = max(rows.size // _MOST_PIXELS, 1)  # neighbours say the same
    rows, cols = rows[::every], cols[::every]
    points = np.stack([cols * moving.pixel_um[1], rows * moving.pixel_um[0]], axis=1)
    maps = np.stack([moving.maps[k][rows, cols] for k in (name, *light)])
    middle, image = points.mean(axis=0), _Sampled(fixed)
    arm_um = float(np.sqrt(np.mean(np.sum((points - middle) ** 2, axis=1))))

    def placed(p: Floats) -> Similarity:
        turn = replace(
            start, scale=start.scale * math.exp(p[3] / arm_um), rotation_rad=start.rotation_rad + p[2] / arm_um
        )
        return nearest_similarity(turn.matrix(), middle, start(middle) + p[:2])

    def unexplained(place: Similarity) -> float:
        grey, is_known = image(place(points))
        if np.count_nonzero(is_known) < _LEAST_PIXELS:
            return 1.0
        centred = maps[:, is_known] - maps[:, is_known].mean(axis=1, keepdims=True)
        grey = grey[is_known] - grey[is_known].mean()
        products = centred @ grey
        return 1.0 - float(products @ np.linalg.pinv(centred @ centred.T) @ products / (grey @ grey))

    found = optimize.minimize(
        lambda p: unexplained(placed(p)), np.zeros(4), method="Nelder-Mead", options={
            "initial_simplex": np.concatenate([np.zeros((1, 4)), 0.5 * reach_um * np.eye(4)]), "xatol": 0.05,
            "fatol": 1e-6, "maxfev": 400,
        },
    )  # fmt: skip
    return placed(found.x)


class TilePlaces(NamedTuple):
    """Places (n, 2), ``(x, y)`` in um, of tiles in both layers; covariances (n, 2, 2) of those in the fixed one."""

    moving_um: Floats
    fixed_um: Floats
    covariance_um2: Floats
    r: float  # of the whole map at the place from which the tiles were sought


def tile_places(
    moving: Textures, fixed: Textures, name: str, place: Similarity, *, light: tuple[str, ...] = ()
) -> TilePlaces:  # fmt: skip
    """Find where tiles of a map lie in the image, near the place of the whole.

    Tiles share no pixel. Their side follows from how far the whole stands out from chance: each has to by itself.
    ``light`` names the slopes of the face: what they explain of the image is taken with the map, so that light from one
    side moves no tile.
    """
    rows, cols = np.indices(moving.known.shape)
    pixel_um = moving.pixel_um
    grey, is_known = _Sampled(fixed)(place(np.stack([cols * pixel_um[1], rows * pixel_um[0]], axis=-1)))
    is_valid = moving.known & is_known
    a, b = standard(moving.maps[name], is_valid), standard(np.where(is_valid, grey, 0.0), is_valid)
    relation = relate(a, b, is_valid, pixel_um)
    if light:
        shown = np.stack([a, *(standard(moving.maps[k], is_valid) for k in light)])
        weights = np.linalg.lstsq(shown[:, is_valid].T, b[is_valid], rcond=None)[0]
        a = standard(math.copysign(1.0, weights[0]) * np.tensordot(weights, shown, 1), is_valid)
        relation = replace(relation, r=math.copysign(relation.r, weights[0]))
    reach = (max(round(_REACH_UM / pixel_um[0]), 3), max(round(_REACH_UM / pixel_um[1]), 3))
    least_um = 2.2 * max((k + MARGIN) * p for k, p in zip(reach, pixel_um, strict=True))
    short_um = min((n // 2 * 2) * p for n, p in zip(moving.known.shape, pixel_um, strict=True))
    stands_out = abs(relation.z) / _TILE_Z
    side_um = math.sqrt(moving.n * pixel_um[0] * pixel_um[1]) / max(stands_out, 1e-9)
    side_um = min(side_um, 0.5 * short_um)
    field = lag_field(
        math.copysign(1.0, relation.r) * a, b, is_valid, pixel_um, reach=reach, overlapping=False,
        tile_um=max(side_um, least_um),
        unrelated=[*PhaseSurrogate(b, is_valid).draws(9, np.random.default_rng(20090501))],
    )  # fmt: skip
    at_um, lag_um = field.at_um[field.distinct], field.lag_um[field.distinct]
    covariance = place.matrix() @ field.covariance_um2[field.distinct] @ place.matrix().T
    return TilePlaces(at_um, place(at_um + lag_um), covariance, relation.r)


class _Sampled:
    """The image of textures between its pixels."""

    def __init__(self, fixed: Textures) -> None:
        self._pixel_um = np.array(fixed.pixel_um[::-1])
        self._spline = np.asarray(ndimage.spline_filter(fixed.maps["image"]), dtype=np.float64)
        self._known = fixed.known.astype(np.float64)

    def __call__(self, points: Floats) -> tuple[Floats, Bools]:
        """Values at points (..., 2), ``(x, y)`` in um, and which of them are known."""
        at = np.moveaxis(points / self._pixel_um, -1, 0)[::-1]
        grey = ndimage.map_coordinates(self._spline, at, order=3, prefilter=False)
        return grey, ndimage.map_coordinates(self._known, at, order=1) >= 0.5
