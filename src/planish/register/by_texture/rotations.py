"""Where a sheet lies in an image, by the texture that both show.

Rotation, hand, scale and shift, and how sure that is.

Every map that may show in the image is correlated with it at every rotation, hand, scale and shift.
A correlation counts in standard deviations of its own map's null: what the same map reaches at the
places that are wrong. How high the best of so many wrong places gets is read off the best of every
rotation but those beside the one that is judged.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, compress, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage, special

from planish.core.errors import CannotRegister
from planish.core.threads import map_threads
from planish.core.transform import Similarity, nearest_similarity
from planish.core.typing import Floats, Ints, Pair, Shape, Shape2D, Singles
from planish.texture.textures import Textures, tile_sums

BAND_UM = (18.0, 150.0)
"""Waves that a scan and an image share: shorter ones are noise, longer ones light and print."""
FALSE = 4e-4
"""Largest probability, of an image that shows nothing of the sheet, to be linked all the same."""
RIVAL = 0.85
"""Share of the best place's height from which on another place is nearly as good, as in a pattern
that repeats."""
# Of the heights of two places: none if other parts of the map make each, all if the same ones do.
_AMBIGUOUS = 0.5
_OVERLAP = 0.4  # least share of the map that lies in the image
_STEP = 3600.0  # um degrees: rotations are tried in steps of this over the size of the map
_SCALE_STEP = 45.0  # um: scales in steps of this over the size of the map
_CANDIDATES = 5
_PARTED_UM = 2500.0  # side of a map of which, about a place, the middle is searched first
# Of the rotations and scales of the middle, those that go best: the whole is tried at them.
_KEPT = 1 / 16
_LEAST_WINDOW = 384  # pixels of a part of the image that is transformed as a whole
_LEAST_ROTATIONS = 20  # that show how high chance gets
# Of the rotations, measured on unrelated fields; those beside each other are alike.
_INDEPENDENT = 0.25
_KNOWN = "known pixels"
Slab = Singles
Scales = tuple[float, ...]
Tried = tuple[Similarity, Scales]  # a rotation and hand, and the scales to try there
Names = tuple[str, str]
"""A map of the moving layer, and that of the fixed one which it is compared with."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Near:
    """About where a point of the moving layer, as a hole, lies in the fixed one, (x, y) in um.

    Else its middle.
    """

    fixed_um: Pair
    radius_um: float
    moving_um: Pair | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A place of the sheet in the image."""

    names: Names  # of the maps that lead
    z: float  # standard deviations of the map's null
    place: Similarity  # from the moving layer to the fixed one, in um


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceSearch:
    """Places of the sheet in the image, the best first, and how sure that one is."""

    candidates: tuple[Candidate, ...]
    # That textures which have nothing in common reach as much at any place.
    false_probability: float

    @property
    def best(self) -> Candidate:
        """The best place."""
        return self.candidates[0]

    @property
    def inverse(self) -> PlaceSearch:
        """The same places, from the fixed layer to the moving one."""
        turned: list[Candidate] = []
        for candidate in self.candidates:
            moving_name, fixed_name = candidate.names
            names = (fixed_name, moving_name)
            turned.append(replace(candidate, names=names, place=candidate.place.inverse))
        return replace(self, candidates=tuple(turned))

    @property
    def has_rival(self) -> bool:
        """Whether another place is nearly as good."""
        return any(candidate.z > RIVAL * self.best.z for candidate in self.candidates[1:2])

    @property
    def is_sure(self) -> bool:
        """Whether the layers can be linked there."""
        return self.false_probability <= FALSE and not self.has_rival


def compared(moving: Textures, fixed: Textures) -> tuple[Names, ...]:
    """Which maps of two layers are compared: all with an image, those of one name of two sheets."""
    if "image" in moving.maps:
        return tuple(("image", name) for name in fixed.maps)
    if "image" in fixed.maps:
        return tuple((name, "image") for name in moving.maps)
    names = tuple((name, name) for name in moving.maps if name in fixed.maps)
    if not names:
        raise CannotRegister(
            "The two sheets have no map in common to compare. Measure the same maps in both"
            " (`property`)."
        )
    return names


def search_place(
    moving: Textures,
    fixed: Textures,
    *,
    mirrored: bool | None,
    scale_tolerance: float,
    near: Sequence[Near] = (),
) -> PlaceSearch:
    """Search all places of a sheet in an image.

    ``moving``: maps of the sheet that may show in it; ``fixed``: ``image``, with pixels that are
    not larger than those of the sheet by much, or the maps of another sheet. ``mirrored``: whether
    the layers see each other mirrored; both are tried where None. ``scale_tolerance``: largest
    deviation of the scale from 1, and strain of a specimen that is not rigid. ``near``: search
    about these places alone, each by itself.

    A search in steps twice as wide finds most places in a quarter of the time, and about a place
    the middle of a large map, of half its side, in a sixteenth. They come first, the middle tells
    at which rotations and scales the whole may lie, and the probability counts all. Of textures
    that are unrelated, the correlation at all shifts is a smooth Gaussian field, whose maximum
    exceeds z with a probability near ``A z exp(-z**2 / 2)`` (Adler and Taylor 2007, chapter 14).
    The best of the other rotations tell A, and a factor to z for fields that are not quite
    Gaussian.
    """
    hands = (False, True) if mirrored is None else (mirrored,)
    shares = (0.5, 1.0) if near and moving.area_um2 > _PARTED_UM**2 else (1.0,)
    search = PlaceSearch(candidates=(), false_probability=1.0)
    steps = None
    promising = list[Similarity]()
    cells = list[list[_Peak]]()
    for share in shares:
        scanner = _Scanner(moving, fixed, scale_tolerance, share, is_near=bool(near))
        rough = steps
        for wider in (1.0,) if promising else (2.0, 1.0):
            steps = _Steps.of(scanner.size_um, scale_tolerance, wider)
            tried = [*steps.tried(hands, promising, rough)]
            cells = map_threads(partial(scanner.cell, windows=near or (None,)), tried)
            search = _judged(scanner, steps, cells, looks=2 * len(shares))
            if search.is_sure:
                return search
        promising = _promising(cells, search)
    return search


class _Peak(NamedTuple):
    """The highest correlation of a map at one rotation, hand and scale."""

    turn: Similarity  # without its shift
    names: Names
    height: float  # sum of products over the root of the number of pairs
    at: Shape2D  # pixel of the image at which the middle of the map lies
    near: Near | None  # about which it was searched; None: everywhere
    squares: float  # sum of the squared heights of all shifts, and how many there are
    shifts: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Steps:
    """Steps of a search in rotation and scale."""

    deg: float  # between two rotations
    scale: float  # between two scales, about
    scales: Scales  # that are tried
    half: float  # the farthest, over the size, that a rotation and scale lies from any tried

    @classmethod
    def of(cls, size_um: float, scale_tolerance: float, wider: float) -> _Steps:
        """Give steps for a map of a size, so many times as wide as the finest ones."""
        step = wider * _SCALE_STEP / size_um
        count = 2 * max(math.ceil(scale_tolerance / step - 0.5), 0) + 1
        most = scale_tolerance * (count - 1) / count
        scales = np.linspace(1.0 - most, 1.0 + most, count).tolist()
        deg = 360.0 / math.ceil(360.0 * size_um / (wider * _STEP))
        half = 0.5 * math.hypot(math.radians(deg), 2.0 * scale_tolerance / count)
        return cls(deg=deg, scale=step, scales=tuple(scales), half=half)

    def tried(
        self, hands: tuple[bool, ...], among: Sequence[Similarity], rough: _Steps | None
    ) -> Iterator[Tried]:
        """All rotations of all hands, with the scales to try there.

        Where some are ``among`` the best after ``rough`` steps, those within half a step of them.
        """
        for hand, k in product(hands, range(round(360.0 / self.deg))):
            turn = Similarity(rotation_rad=math.radians(k * self.deg), mirrored=hand)
            scales = self.scales
            if rough is not None and among:
                # Of one hand, rotation and scale are the length and angle of the second row.
                _, row = turn.matrix()
                best_rows = [t.matrix()[1] for t in among if t.mirrored == hand]
                scaled_rows = np.outer(scales, row)
                offsets = np.reshape(best_rows, (-1, 2)) - scaled_rows[:, None]
                is_close = np.linalg.norm(offsets, axis=2) <= rough.half
                scales = tuple(compress(scales, is_close.any(axis=1)))
            if scales:
                yield turn, scales

    def about(self, turn: Similarity) -> Iterator[Tried]:
        """Rotations between those of the search, with scales between its own."""
        quarters = range(-2, 3)
        scales = tuple(turn.scale + self.scale * k / 4.0 for k in quarters)
        for k in quarters:
            rotation_rad = turn.rotation_rad + math.radians(self.deg) * k / 4.0
            yield replace(turn, scale=1.0, rotation_rad=rotation_rad), scales


def _by_null(cells: list[list[_Peak]]) -> Callable[[_Peak], float]:
    """Give the function that takes a peak to its height in standard deviations of its map's null.

    ``cells`` are the peaks of all maps, rotation by rotation; the null is all of their shifts.
    """
    square_sums = defaultdict[Names, float](float)
    counts = defaultdict[Names, int](int)
    for peak in chain.from_iterable(cells):
        square_sums[peak.names] += peak.squares
        counts[peak.names] += peak.shifts
    null_sd: dict[Names, float] = {}
    for names, square_sum in square_sums.items():
        null_sd[names] = math.sqrt(square_sum / max(counts[names], 1)) or 1.0
    return lambda peak: abs(peak.height) / null_sd[peak.names]


def _promising(cells: list[list[_Peak]], search: PlaceSearch) -> list[Similarity]:
    """Rotations and scales at which a map goes best with the image, and those of all candidates.

    None where some of it lies beside the image: it tells nothing of more of the map then.
    """
    peaks = [*chain.from_iterable(cells)]
    shifts = {peak.shifts for peak in peaks}
    if len(shifts) > 1 or 0 in shifts:
        return []
    peaks.sort(key=_by_null(cells), reverse=True)
    kept_count = math.ceil(_KEPT * len(peaks))
    turns = [peak.turn for peak in peaks[:kept_count]]
    return turns + [candidate.place for candidate in search.candidates]


def _judged(scanner: _Scanner, steps: _Steps, cells: list[list[_Peak]], looks: int) -> PlaceSearch:
    """The best places of all rotations, and how probable chance makes the first of them.

    ``cells`` are the peaks of all maps, rotation by rotation, in one of so many ``looks``.
    """
    z = _by_null(cells)
    best_of_cells = [max(cell, key=z) for cell in cells]
    best, *lower = sorted(best_of_cells, key=z, reverse=True)
    reach_um = scanner.reach_um(best.names)
    # A rotation beside that of the best is high because of it.
    unrelated = [p for p in lower if scanner.turned_um(p.turn, best.turn) > reach_um]
    probability = 1.0
    if len(unrelated) >= _LEAST_ROTATIONS:
        chance_z = np.array([*map(z, unrelated)])
        probability = _exceeded(z(best), chance_z)
    candidates = [scanner.candidate(_finest(scanner, steps, best), z(best))]
    lower_peaks = (*lower, *scanner.rivals(best))
    for peak in sorted(lower_peaks, key=z, reverse=True):
        other = scanner.candidate(peak, z(peak))
        if not any(scanner.are_one(c, other) for c in candidates):
            candidates.append(other)
        if len(candidates) == _CANDIDATES:
            break
    return PlaceSearch(
        candidates=tuple(candidates), false_probability=min(looks * probability, 1.0)
    )


def _finest(scanner: _Scanner, steps: _Steps, best: _Peak) -> _Peak:
    """The highest peak of the best one's maps, between the steps too."""
    peaks = [best]
    for tried in steps.about(best.turn):
        peaks += scanner.peaks(*tried, best.near)
    like = [peak for peak in peaks if peak.names == best.names]
    return max(like, key=lambda peak: abs(peak.height))


def _exceeded(z: float, chance_z: Floats) -> float:
    """Probability that any of so many rotations, and one more, of unrelated textures reaches z.

    The best of a rotation is distributed as ``exp(-A x exp(-x**2 / 2))`` with x = z / s. Few
    rotations leave A and s uncertain, and the tail more so: both are integrated over. ``chance_z``
    (n,) are the best ones of the rotations that are wrong.
    """
    # a constant image, or none of it known, is like nothing
    if not np.quantile(chance_z, 0.5) > 0.0:
        return 1.0
    s = np.geomspace(0.8, 3.0, 67)[:, None]  # below 0.8 it is chance among few rotations
    x = np.maximum(chance_z / s, 1.2)
    log_sums = special.logsumexp(_log_rates(chance_z / s), axis=1)
    independent = _INDEPENDENT * chance_z.size
    log_densities = np.log(s) + 0.5 * x**2 - np.log(x**2 - 1.0)
    log_likelihood = -_INDEPENDENT * np.sum(log_densities, axis=1)
    weights = special.softmax(log_likelihood - independent * log_sums)
    log_rates = _log_rates(z / s[:, 0]) - log_sums
    rates = np.exp(np.minimum(log_rates, 700.0))
    expected = (chance_z.size + 1) / _INDEPENDENT * rates
    probabilities = -np.expm1(-independent * np.log1p(expected))
    return float(np.sum(weights * probabilities))


def _log_rates(x: Floats) -> Floats:
    """Logarithm of ``x exp(-x**2 / 2)``, with which the best of a rotation exceeds x."""
    return np.log(np.maximum(x, 1e-9)) - 0.5 * x**2


class _Window(NamedTuple):
    """Part of an image, and where the map's middle may lie in it."""

    first: Shape2D  # row and column of the first middle
    size: Shape  # rows and columns of middles
    spectra: dict[str, NDArray[np.complex64]]  # of its maps, and of what is known of it
    shape: Shape  # rows and columns that were transformed: a map's margin more on every side

    def pixel(self, row: int, col: int) -> Shape2D:
        """Return the pixel of the image that is the middle of this row and column."""
        first_row, first_col = self.first
        return first_row + row, first_col + col


class _Scanner:
    """Correlates maps, turned about their middle, with an image at all shifts or near a place."""

    def __init__(
        self,
        moving: Textures,
        fixed: Textures,
        scale_tolerance: float,
        share: float,
        *,
        is_near: bool,
    ) -> None:
        """Take ``share`` of the map, from its middle; and spectra of the image unless near.

        ``scale_tolerance`` is also the strain of a specimen that is not rigid. Splines, masks and
        spectra are worked out once, for all rotations.
        """
        self.middle_um = moving.middle_um
        moving = moving.middle_part(share)
        self._moving = moving
        self._fixed = fixed
        self._names = compared(moving, fixed)
        self.strain = scale_tolerance
        # X, y.
        self._moving_px = np.array(moving.pixel_um[::-1])
        self._fixed_px = np.array(fixed.pixel_um[::-1])
        shape = np.array(moving.known.shape[::-1])
        self._extent_um = shape * self._moving_px
        self._middle_px = 0.5 * (shape - 1)
        self.size_um = math.sqrt(max(moving.area_um2, 1.0))
        self._splines: dict[str, Slab] = {}
        for name, _ in self._names:
            spline = ndimage.spline_filter(moving.maps[name])
            self._splines[name] = np.asarray(spline, dtype=np.float32)
        self._mask = moving.known.astype(np.float32)
        # Pixels of the image that the known part of the map covers.
        pixel_areas = float(np.prod(self._moving_px / self._fixed_px))
        self._most = moving.n * pixel_areas
        self._diagonal_um = float(np.hypot(*self._extent_um))
        most_um = 1.05 * (1.0 + scale_tolerance) * self._diagonal_um
        # Pixels of the image from the middle of the map to its corners, however it is turned.
        self._margin = math.ceil(0.5 * most_um / float(self._fixed_px.min())) + 2
        most = max(4 * self._margin, _LEAST_WINDOW)
        rows, cols = (_starts(n, most) for n in fixed.known.shape)
        size = rows.step, cols.step
        parts = () if is_near else product(rows, cols)
        self._whole = [self._spectra(first, size) for first in parts]

    def half_wave_um(self, names: Names) -> float:
        """Half the mean wave of a map; a pattern that repeats is as good a whole one on."""
        values = self._moving.maps[names[0]]
        mean_square = 0.0
        for axis, step_um in enumerate(self._moving.pixel_um):
            slopes = np.diff(values, axis=axis) / step_um
            mean_square += float(np.mean(slopes**2))
        # Of a wave, the slope over the deviation is 2 pi over its length.
        return math.pi * float(np.std(values)) / (math.sqrt(mean_square) or math.inf)

    def reach_um(self, names: Names) -> float:
        """Farthest that two places lie apart to which parts of one map belong.

        The strain moves two parts that lie a diagonal apart by so much.
        """
        return self.half_wave_um(names) + self.strain * self._diagonal_um

    def are_one(self, a: Candidate, b: Candidate) -> bool:
        """Whether two places can both be right: no part of the map goes with the image at both.

        A specimen that is not rigid goes there with one part here and with another one there; a
        pattern that repeats, with the same parts at both. In a part, the strain takes no two points
        more than half a wave apart; what lies closer than that in both places is at one of them.
        """
        if self.apart_um(a.place, b.place) > self.reach_um(a.names):
            return False
        rows, cols = np.indices(self._mask.shape)
        offsets_px = np.stack([cols, rows], axis=-1) - self._middle_px
        points = self.middle_um + offsets_px * self._moving_px
        half_wave_um = self.half_wave_um(a.names)
        moves_um = a.place(points) - b.place(points)
        moved_um = np.linalg.norm(moves_um, axis=-1)
        side_um = half_wave_um / max(self.strain, 1e-9)
        # Of either place, how well each tile of the map goes with the image: (tiles).
        parts: list[Floats] = []
        for candidate in (a, b):
            name, image_name = candidate.names
            places_px = np.moveaxis(candidate.place(points) / self._fixed_px, -1, 0)
            image = self._fixed.maps[image_name]
            shown = ndimage.map_coordinates(image, places_px[::-1], order=1)
            products = self._moving.maps[name] * shown
            all_and_apart = np.stack([products, (moved_um > half_wave_um) * products])
            parts.append(tile_sums(all_and_apart, self._moving.pixel_um, side_um))
        (a_all, a_apart), (b_all, b_apart) = parts
        shared = abs(float(np.vdot(a_apart, b_apart)))
        whole = float(np.linalg.norm(a_all) * np.linalg.norm(b_all))
        return shared <= _AMBIGUOUS * whole

    def turned_um(self, a: Similarity, b: Similarity) -> float:
        """Distance between two places about one middle, rms over the map."""
        spread = (a.matrix() - b.matrix()) * self._extent_um
        return float(np.linalg.norm(spread)) / math.sqrt(12.0)

    def apart_um(self, a: Similarity, b: Similarity) -> float:
        """Distance between two places, rms over the map."""
        shift_um = a(self.middle_um) - b(self.middle_um)
        return math.hypot(self.turned_um(a, b), *shift_um)

    def cell(self, tried: Tried, windows: Sequence[Near | None]) -> list[_Peak]:
        """Peaks of all maps at one rotation and hand, and some scales."""
        return [peak for near in windows for peak in self.peaks(*tried, near)]

    def peaks(self, turn: Similarity, scales: Scales, near: Near | None) -> Iterator[_Peak]:
        """The highest correlation of each map at each scale."""
        for scaled, names, height, window, shifts in self._heights(turn, scales, near):
            highest = int(np.argmax(np.abs(height)))
            peak_height = float(height.flat[highest])
            pixel = window.pixel(*divmod(highest, height.shape[1]))
            squares = float(np.vdot(height, height))
            yield _Peak(scaled, names, peak_height, pixel, near, squares, shifts)

    def rivals(self, best: _Peak) -> Iterator[_Peak]:
        """Summits at the turn of the best one that are nearly as high, also beside its window.

        A wave beyond it lies each place that a pattern which repeats has beside one within.
        """
        near = best.near
        if near is not None:
            wave_um = 2.0 * self.half_wave_um(best.names)
            near = replace(near, radius_um=near.radius_um + wave_um)
        turn = replace(best.turn, scale=1.0)
        scales = (best.turn.scale,)
        for _, names, signed, window, _ in self._heights(turn, scales, near):
            height = np.abs(signed) * (names == best.names)
            is_high = height > RIVAL * abs(best.height)
            is_summit = height == ndimage.maximum_filter(height, 3)
            for row, col in np.argwhere(is_high & is_summit).tolist():
                pixel = window.pixel(row, col)
                yield best._replace(height=float(height[row, col]), at=pixel)

    def candidate(self, peak: _Peak, z: float) -> Candidate:
        """The place of a peak that is so high."""
        place = self.place(peak.turn, peak.at)
        return Candidate(names=peak.names, z=z, place=place)

    def place(self, turn: Similarity, pixel: Shape2D) -> Similarity:
        """Transformation that puts the middle of the map on a pixel of the image."""
        target_um = np.array(pixel[::-1]) * self._fixed_px
        return nearest_similarity(turn.matrix(), self.middle_um, target_um)

    def _heights(
        self, turn: Similarity, scales: Scales, near: Near | None
    ) -> Iterator[tuple[Similarity, Names, Slab, _Window, int]]:
        """Heights by the pixel of the map's middle: sums of products over the root of the pairs.

        For each scale, map and window: the turn with this scale, the names of the maps, the heights
        (rows, cols) of the window, the window, and the number of its pixels at which enough of the
        map is seen; the height is 0 at all others.
        """
        windows = self._windows(turn, near)
        middle_scale = 0.5 * (scales[0] + scales[-1])
        half, sampled = self._on_image(replace(turn, scale=middle_scale))
        mask = self._spectrum(self._turned_mask(sampled), windows[0].shape)
        least_pairs = max(_OVERLAP * self._most * middle_scale**2, 1.0)
        weights = list[Slab]()
        for window in windows:
            pairs = self._lags(window, _KNOWN, mask, half)
            weight = 1.0 / np.sqrt(np.maximum(pairs, 1.0))
            weight[pairs < least_pairs] = 0.0
            weights.append(weight.astype(np.float32))
        for scale in scales:
            scaled = replace(turn, scale=scale)
            half, sampled = self._on_image(scaled)
            # Beyond a map that is known everywhere, what is sampled is 0 already.
            is_known = 1.0 if self._mask.all() else self._turned_mask(sampled)
            for names in self._names:
                turned = sampled(self._splines[names[0]], order=3) * is_known
                part = self._spectrum(turned, windows[0].shape)
                for window, weight in zip(windows, weights, strict=True):
                    height = weight * self._lags(window, names[1], part, half)
                    yield scaled, names, height, window, int(np.count_nonzero(weight))

    def _windows(self, turn: Similarity, near: Near | None) -> list[_Window]:
        """Parts of the image in which the middle of the map may lie: all, or one near a place.

        ``near`` says about where a point of the map lies; its middle lies an arm from there, which
        turns with the map.
        """
        if near is None:
            return self._whole
        arm_um = self.middle_um - (near.moving_um or self.middle_um)
        middle_um = near.fixed_um + turn.matrix() @ arm_um
        radius_px = near.radius_um / self._fixed_px
        first_px = np.floor(middle_um / self._fixed_px - radius_px)
        col, row = first_px.astype(int).tolist()
        size_px = np.ceil(2.0 * radius_px + 1.0)
        cols, rows = size_px.astype(int).tolist()
        return [self._spectra((row, col), (rows, cols))]

    def _spectra(self, first: Shape2D, count: Shape) -> _Window:
        """Spectra of the part of the image in which so many middles of the map lie.

        ``first`` is the pixel of the first middle, ``count`` are rows and columns of middles. What
        the map may cover beyond the image is 0, as is what of it is not known.
        """
        margin = self._margin
        pixels: list[Ints] = []
        for start, n, size in zip(first, count, self._fixed.known.shape, strict=True):
            stop = min(start + n + margin, size)
            pixels.append(np.arange(max(start - margin, 0), stop))
        source = np.ix_(*pixels)
        target = tuple(k - b + margin for k, b in zip(source, first, strict=True))
        shape = tuple(fft.next_fast_len(n + 2 * margin, real=True) for n in count)
        spectra: dict[str, NDArray[np.complex64]] = {}
        shown = {**self._fixed.maps, _KNOWN: self._fixed.known}
        for name, values in shown.items():
            part = np.zeros(shape, np.float32)
            part[target] = values[source]
            spectra[name] = np.asarray(fft.rfft2(part), dtype=np.complex64)
        return _Window(first, count, spectra, shape)

    def _on_image(self, turn: Similarity) -> tuple[Shape2D, Callable[..., Slab]]:
        """Half the size and the sampling of a map on pixels of the image, no larger than needed.

        The size is in rows and columns about the middle of the map; the sampling is
        `ndimage.affine_transform` for a map of the moving layer, or its spline.
        """
        matrix = turn.matrix()
        corners_um = [*product((-0.5, 0.5), repeat=2)] * self._extent_um
        reach_um = np.abs(corners_um @ matrix.T).max(axis=0)
        half = np.ceil(reach_um / self._fixed_px).astype(int)
        # Of pixels x, y.
        inverse = np.linalg.inv(matrix)
        to_moving = (inverse * self._fixed_px) / self._moving_px[:, None]
        offset = self._middle_px - to_moving @ half
        half_cols, half_rows = half.tolist()
        sampled = partial(
            ndimage.affine_transform,
            matrix=to_moving[::-1, ::-1],
            offset=offset[::-1],
            output_shape=(2 * half_rows + 1, 2 * half_cols + 1),
            prefilter=False,
            output=np.float32,
        )
        return (half_rows, half_cols), sampled

    def _turned_mask(self, sampled: Callable[..., Slab]) -> Slab:
        """1 where the map is known, on pixels of the image; 0 elsewhere."""
        known_share = sampled(self._mask, order=1)
        return (known_share >= 0.5).astype(np.float32)

    def _spectrum(self, part: Slab, shape: Shape) -> NDArray[np.complex64]:
        """Conjugate spectrum of a part (rows, cols), padded with 0 to a shape.

        The rows that the part does not fill need no transformation along them.
        """
        by_rows = fft.rfft(part, shape[1], axis=1)
        return np.conj(fft.fft(by_rows, shape[0], axis=0))

    def _lags(
        self,
        window: _Window,
        name: str,
        part: NDArray[np.complex64],
        half: Shape2D,
    ) -> Slab:
        """Sums of products by the pixel at which the middle of the part lies, all of a window.

        ``part`` is the conjugate spectrum of a turned map of half the size ``half``, rows and
        columns. Only the rows that are needed are transformed back.
        """
        products = window.spectra[name] * part
        along = fft.ifft(products, axis=0, overwrite_x=True)
        row, col = (self._margin - h for h in half)
        rows, cols = window.size
        needed_rows = along[row : row + rows]
        lags = fft.irfft(needed_rows, window.shape[1], axis=1)
        return np.ascontiguousarray(lags[:, col : col + cols], dtype=np.float32)


def _starts(count: int, most: int) -> range:
    """Starts of equal parts of ``most`` or fewer, the last of which may reach beyond the end."""
    parts = math.ceil(count / most)
    size = math.ceil(count / parts)
    return range(0, parts * size, size)
