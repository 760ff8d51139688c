"""Round holes measured at places where they may be, by their rims or their floors.

The steps are compiled, one by one; what leads from one to the next is not, which would take as long
to compile again.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from planish.core.typing import Floats, Pair
from planish.marks import _rim_kernels as kernels
from planish.marks._edge_kernels import (
    first_crossings,
    fit_outline,
    half_level_edges,
    innermost_edges,
    levels,
    waves,
)
from planish.marks.candidates import Image, Raster

# What is measured of a mark, a place that may be a hole. Greys are times the sign of the holes, so
# that a floor is always below the sheet; all is NaN until it is measured.
MARK = np.dtype(
    [
        ("centre", "f8", 2),  # x, y in um
        ("radius", "f8"),  # mean over the rays, in um
        ("half_difference", "f8"),  # of the half axes of the ellipse, in um
        # xx, yy, xy in um2 for waves of the rim of amplitude 1 um, until their size is known.
        ("covariance", "f8", 3),
        ("coverage", "f8"),  # share of the rays on which the rim is there
        ("step", "f8"),  # rise of the grey at the rim, and over a wider distance
        ("far_step", "f8"),
        ("inside", "f8"),  # level of the floor
        ("unevenness", "f8"),  # robust standard deviation of the floor
        ("flatness", "f8"),  # rise of the floor towards the rim
        ("outside", "f8"),  # level of the sheet around, and its robust standard deviation
        ("texture", "f8"),
        ("roughness", "f8"),  # rms of the rim about the ellipse, in um
        ("low_waves", "f8"),  # variances (um2) of the waves around the rim: orders 3 and 4
        ("high_waves", "f8"),  # and 5 to 8
        ("burnt", "f8"),  # how far the sheet just outside the rim is below that around
        ("doubt", "f8", 2),  # what another edge may move the centre by, x, y in um
        ("beyond", "f8"),  # darkest level just beyond the rim
        ("is_alike", "f8"),  # 1 where the floor stands for contrast; set by the search
    ]
)
# Least step of another edge inside the rim, share of the whole step; sd of a centre where either of
# two closed edges may be the rim, share of what their centres are apart; the same for the floor's
# centre, which the wall moves less.
LEAST_INNER, EITHER, FLOOR = 0.06, 0.6, 1.3
# How far the middle of a floor usually is from that of its rim, as holes are tilted: share of the
# radius, and pixels. Less is usual where the step at the rim has a first wave above this share of
# the whole step, as uneven char makes it.
USUAL, EXACT, ONE_SIDED = (0.045, 0.3), (0.0105, 0.15), 0.1
# Another edge inside the strongest is the rim where this share of the rays has it, it is smaller by
# this share of the radius, and on this share of the rays the two are apart by this share of the
# radius: what lies between is char.
CLOSED, SMALLER, PART, APART = 0.9, 0.05, 0.25, 0.08
RAYS = 96
# How far beyond a missing rim it is looked at whether the floor goes on, and beyond that of a floor
# (the wall of a tapered hole is around it): shares of the radius. So many rays, a tenth of all,
# are a gap a third of the diameter wide; a circle that runs into straight sides has two or more.
BEYOND_RIM, BEYOND_FLOOR, GAP_RAYS = 0.25, 0.5, 10
# Cosine and sine of the angles of the rays, and of twice these.
_ANGLES = [2 * np.pi * ray / RAYS for ray in range(RAYS)]
_DOUBLED = [2 * angle for angle in _ANGLES]
_COS = np.array([*map(math.cos, _ANGLES)])
_SIN = np.array([*map(math.sin, _ANGLES)])
_COS_2 = np.array([*map(math.cos, _DOUBLED)])
_SIN_2 = np.array([*map(math.sin, _DOUBLED)])
_Circle = tuple[float, float, float, float]  # x, y, radius, scatter of the rays about it; in um


class Marks(np.recarray[Any, Any]):  # pyright: ignore[reportIncompatibleVariableOverride]
    """Marks (n,) with the figures of `MARK`, each an attribute of all: (n,), or (n, k) of several.

    A row is one mark with the same attributes; what is assigned to them goes into the array.
    """

    if TYPE_CHECKING:

        def __getitem__(self, which: Any, /) -> Any:
            """Some of the marks, or one of them."""


class _Picture(NamedTuple):
    """An image, its pixel size along x and y in um, and the sign that makes its holes dark.

    Unpacked, these are the first four arguments of every kernel.
    """

    image: Image
    px: float
    py: float
    sign: float

    @property
    def pixel(self) -> float:
        """Longer side of a pixel, in um."""
        return max(self.px, self.py)

    @property
    def near(self) -> float:
        """Width of the search for an edge whose place is known, in um."""
        return max(1.2 * self.pixel, 6.0)

    @property
    def least_scatter(self) -> float:
        """Scatter of rays about an outline, in um, that no edge in the picture falls below."""
        return 0.3 + 0.1 * self.pixel


class _Outline(NamedTuple):
    """Outline of a hole, fitted to the radii of its edge on rays from the centre; all in um.

    ``steps``, ``far_steps`` and ``nears`` (RAYS,) are the rise of the grey at the edge, that over a
    wider distance, and the grey just outside; empty for an outline of a floor.
    """

    x: float
    y: float
    fit: Floats  # (5,): radius, and its parts with cos, sin, cos and sin of the doubled angle
    weight: Floats  # (RAYS,), 0 where a ray is left out
    inverse: Floats  # (5, 5): inverse normal matrix of the fit
    radii: Floats  # (RAYS,), about the centre before the last step of the fit
    steps: Floats
    far_steps: Floats
    nears: Floats

    @property
    def ellipse(self) -> Floats:
        """Radii of the rays about the fitted centre."""
        radius, _, _, cos_part, sin_part = self.fit
        return radius + cos_part * _COS_2 + sin_part * _SIN_2


def blank_marks(count: int) -> Marks:
    """Give marks of which nothing has been measured: NaN in every field."""
    return np.full(count, np.nan, dtype=MARK).view(Marks)


def measure_rims(
    raster: Raster,
    positions: Floats,
    sign: float,
    radius_range: Pair,
    thresholds: Floats,
) -> Marks:
    """Measure a round hole at each candidate place.

    ``positions`` (n, 2), x and y in um from the first pixel; ``sign``: 1 for holes that are darker
    than the sheet, -1 for lighter ones; ``radius_range`` in um. A step below ``thresholds[0]``, or
    below ``thresholds[1]`` times the texture around, (2, n), is not measured. Returns a mark (see
    `MARK`) for each place, NaN where there is no hole.
    """
    picture = _picture(raster, sign)
    marks = blank_marks(len(positions))
    for mark, position, least, contrast in zip(marks, positions, *thresholds, strict=True):
        circle = _circle(picture, position, radius_range, float(least), float(contrast))
        if circle is not None:
            _measure_rim(mark, picture, circle, radius_range)
    return marks


def _measure_rim(mark: np.record, picture: _Picture, circle: _Circle, radius_range: Pair) -> None:
    """Write the figures of the rim near a circle into a mark, which stays as it is without one."""
    *centre, radius, scatter = circle
    low, high = radius_range
    least = 0.5 * low
    scatter_reach = min(3 * scatter, 0.3 * radius)
    search = max(0.15 * radius, 2 * picture.pixel, 10.0, scatter_reach)
    model = np.full(RAYS, radius)
    rim = _refined(picture, centre, model, share=0.35, search=search)
    if rim is None or not (least < rim.fit[0] < 1.5 * high):
        return
    # The strongest edge, but where another one goes round inside: then that around is the end of
    # the char.
    centre, model, inner, around = _closed_rims(picture, centre, radius, least)
    closed = _refined(picture, centre, model, share=0.35)
    if closed is not None and _is_inside(closed, rim, least):
        rim = closed
    _describe(mark, picture, rim)
    mark.step = _median(rim.steps)
    mark.far_step = _median(rim.far_steps)
    mark.burnt = mark.outside - _median(rim.nears)
    _set_doubt(mark, picture, (rim.x, rim.y), rim.steps)
    if around == 0.0:
        return
    # Another closed edge inside: the rim of a hole with a scorched ring around, or that of the
    # other face.
    ring_picture = picture._replace(sign=around * picture.sign)
    ring = _refined(ring_picture, centre, inner, share=LEAST_INNER)
    if ring is None or not (least < ring.fit[0] < mark.radius):
        return
    if np.sum(ring.weight > 0) > 0.6 * RAYS:
        # Of two that rise either may be the rim; where the grey falls, char is darker than the
        # hole.
        other = ring
        if around < 0.0:
            _write_outline(mark, ring)
            other = rim
        _set_doubt(mark, picture, (other.x, other.y), rim.steps)


def measure_floors(
    raster: Raster, positions: Floats, sign: float, radius: float, floor_ends: Sequence[float]
) -> Marks:
    """Measure the outline of a hole's floor about each place (n, 2), x and y in um.

    What is printed over a rim may hide its edge, and never the floor. The outline lies where the
    grey, times ``sign``, leaves the floor's level: of the greys ``floor_ends`` that with the
    roundest outline is taken. ``radius`` (um) is that of the image's other holes. Returns marks as
    `measure_rims` does, without steps at the rim.
    """
    picture = _picture(raster, sign)
    marks = blank_marks(len(positions))
    (trial,) = blank_marks(1)
    for k, position in enumerate(positions):
        least = np.inf
        model = np.empty(0)
        for grey in floor_ends:
            outline = _floor_outline(picture, position, radius, grey)
            if outline is None:
                continue
            _describe(trial, picture, outline)
            # About the circle, not the ellipse: a blot beside a hole makes an ellipse of both.
            wave = 0.5 * trial.half_difference * trial.half_difference
            rms_um = math.sqrt(trial.roughness**2 + wave)
            roughness = rms_um / trial.radius - trial.coverage
            if roughness < least:
                least = roughness
                marks[k] = trial
                model = outline.ellipse
        if least < np.inf:
            mark: np.record = marks[k]
            edges = half_level_edges(*picture, *mark.centre, model, picture.near)
            _, steps, _, nears = edges
            mark.burnt = mark.outside - _median(nears)
            _set_doubt(mark, picture, mark.centre, steps)
    return marks


def _picture(raster: Raster, sign: float) -> _Picture:
    row_um, col_um = raster.pixel_um
    return _Picture(raster.image, col_um, row_um, sign)


def _floor_outline(
    picture: _Picture, position: Floats, radius: float, grey: float
) -> _Outline | None:
    """Outline of what is below a grey, about a position (x, y) in um; None where it lies elsewhere.

    It is followed from the position until the fitted centre rests.
    """
    pixel = picture.pixel
    ray_step = max(0.25 * pixel, 0.5)
    x, y = position
    for turn in range(6):
        radii = first_crossings(*picture, x, y, grey, 1.6 * radius, ray_step, RAYS)
        # A circle first, then an ellipse: its axes mean nothing off the centre.
        order = 1 if turn < 2 else 2
        fit, weight, _, inverse = fit_outline(radii, order, picture.least_scatter)
        dx, dy = fit[1:3]
        x += dx
        y += dy
        is_off = math.dist((x, y), position) > 0.6 * radius
        if is_off or np.sum(weight) == 0.0:
            break
        rests = turn > 2 and math.hypot(dx, dy) < 0.05 * pixel
        if rests or turn == 5:
            no_edge = np.empty((3, 0))
            return _Outline(x, y, fit, weight, inverse, radii, *no_edge)
    return None


def _circle(
    picture: _Picture,
    position: Floats,
    radius_range: Pair,
    least: float,
    contrast: float,
) -> _Circle | None:
    """Return the circle through the innermost strong edges about a position, (x, y) in um.

    None if there is none, or the step is below ``least`` or ``contrast`` times the texture around.
    """
    pixel = picture.pixel
    low, high = radius_range
    x, y = position
    window = max(14.0, 1.4 * pixel)  # um over which the grey is averaged on either side of an edge
    ray_step = max(0.7 * pixel, 2.5)
    search = (0.5 * low, 1.25 * high, ray_step, window)
    radius = np.nan
    scatter = 0.0
    for turn, rays in enumerate((36, 64, 64, 64)):
        radii, _ = innermost_edges(*picture, x, y, *search, rays)
        fit, weight, scatter, _ = fit_outline(radii, 1, 0.5)
        radius = float(fit[0])
        dx, dy = fit[1:]
        shift = math.hypot(dx, dy)
        has_rays = np.count_nonzero(weight > 0.0) >= 0.5 * rays
        is_found = has_rays and scatter <= 0.3 * radius and shift <= radius
        if not (is_found and 0.6 * low < radius < 1.4 * high):
            return None
        x += dx
        y += dy
        # Most places are mottle; the levels show it long before the rim is known.
        if turn == 0:
            greys = levels(*picture, x, y, radius)
            if _is_mottle(greys, least, contrast):
                return None
        elif shift < 0.1 * pixel:
            break
    return x, y, radius, scatter


def _is_mottle(greys: tuple[float, ...], least: float, contrast: float) -> bool:
    """Return whether the levels at a place are too faint or uneven for a hole.

    ``greys`` are those of the kernel `levels`; ``least`` is a step of grey, ``contrast`` one in
    standard deviations of the sheet around.
    """
    inside, spread, flatness, outside, texture = greys
    total = outside - inside
    is_uneven = spread > 0.35 * total or flatness > 0.4 * total
    return is_uneven or total < max(least, contrast * texture)


def _refined(
    picture: _Picture,
    centre: Sequence[float],
    model: Floats,
    *,
    share: float,
    search: float | None = None,
) -> _Outline | None:
    """Return the outline at half level near a modelled one; None if there is none.

    ``model`` (RAYS,) are radii about ``centre``, x and y; the edge is searched within ``search`` of
    them, all in um. Steps below a ``share`` of the median are left out. Without a width of search,
    the edge that was found is followed ray by ray, so that a rough rim needs no wide search, in
    which lies another edge.
    """
    x, y = centre
    radius = float(np.mean(model))
    reach = search or picture.near
    outline = None
    for _turn in range(3):
        edges = half_level_edges(*picture, x, y, model, reach)
        radii, steps, *_ = edges
        is_strong = steps >= share * _median(steps)
        radii[~is_strong] = np.nan
        fit, weight, scatter, inverse = fit_outline(radii, 2, picture.least_scatter)
        dx, dy = fit[1:3]
        if np.sum(weight) == 0.0 or math.hypot(dx, dy) > 0.5 * radius:
            return None
        x += dx
        y += dy
        radius = fit[0]
        outline = _Outline(x, y, fit, weight, inverse, *edges)
        model = outline.ellipse
        if search is None:
            moved_radii = radii - dx * _COS - dy * _SIN
            model = np.where(weight > 0.0, moved_radii, model)
        else:
            reach = max(picture.near, 4 * scatter)
    return outline


def _is_inside(closed: _Outline, rim: _Outline, least: float) -> bool:
    """Return whether a closed outline lies inside another, well away from it on many rays.

    Its radius has to be above the ``least``, in um.
    """
    # As far as a shift of the centre goes, the two are compared on the same ray.
    dx = closed.x - rim.x
    dy = closed.y - rim.y
    shift = dx * _COS + dy * _SIN
    distances = rim.radii - (closed.radii + shift)
    rim_radius = rim.fit[0]
    is_apart = np.count_nonzero(distances > APART * rim_radius) > PART * RAYS
    is_smaller = least < closed.fit[0] < (1 - SMALLER) * rim_radius
    is_closed = np.sum(closed.weight > 0) > CLOSED * RAYS
    return bool(is_smaller and is_apart and is_closed)


def _closed_rims(
    picture: _Picture, centre: Sequence[float], radius: float, least: float
) -> tuple[Pair, Floats, Floats, float]:
    """Find the closed rim about a circle, and another rim inside that, in the grey along rays.

    ``radius`` is that of the circle, ``least`` that of the smallest rim, in um. Returns the centre,
    (x, y) in um, the radii (RAYS,) of the two about it, and the sign of the other one: 1 where it
    rises as the rim does, -1 where it falls, and 0 where there is none.
    """
    pixel = picture.pixel
    ray_step = max(0.5 * pixel, 2.5)
    # Lengths from here on are in steps along a ray; the grey is averaged over the reach.
    reach = max(1, round(max(14.0, 1.4 * pixel) / ray_step))
    inside, spread, _, outside, _ = levels(*picture, *centre, radius)
    total = outside - inside
    tolerance = max(3 * spread, 0.1 * total)
    middle_um = kernels.floor_middle(*picture, *centre, radius, inside, tolerance)
    shift = math.dist(middle_um, centre)
    count = int((radius + shift + 0.3 * radius) / ray_step) + 2 * reach
    band = max(1, round(1.5 * pixel / ray_step))
    first = max(reach, int(least / ray_step))
    rises = kernels.polar_rises(*picture, *middle_um, ray_step, count, reach, RAYS)
    # Not beyond the circle of the innermost strong edges: a hole that is half closed has char all
    # the way round.
    last = min(count - reach, int(1.1 * radius / ray_step) + 1)
    worth = kernels.edge_worth(rises, kernels.ENOUGH * total)
    outwards = kernels.OUTWARDS * ray_step / radius
    middle, half, _ = kernels.rim_radius(worth, first, last, band, outwards)
    path = kernels.closed_path(worth, max(0, middle - half), middle + half)
    weak = max(LEAST_INNER * total, 2.5 * spread)
    # A ring darker than what the hole shows: the rim is where the grey falls.
    innermost = int(np.min(path))
    last = innermost - reach
    if last > first:
        worth = kernels.edge_worth(-rises, weak)
        middle, half, share = kernels.rim_radius(worth, first, last - band, band, 0.0)
        if share > 0.7:
            ring_end = min(middle + half, last)
            ring = kernels.closed_path(worth, max(0, middle - half), ring_end)
            return middle_um, path * ray_step, ring * ray_step, -1.0
    # Weaker edges inside, where there are any.
    steps = np.arange(count)
    cost = kernels.OUTWARDS * ray_step * steps / radius
    worth = kernels.edge_worth(rises, weak) - cost
    worth[steps >= path[:, None] + 2] = -np.inf
    path_end = int(np.max(path)) + 1
    within = kernels.closed_path(worth, min(first, innermost), path_end)
    has_other = np.sum(path - within >= reach) > 0.1 * RAYS
    return middle_um, path * ray_step, within * ray_step, float(has_other)


def _describe(mark: np.record, picture: _Picture, outline: _Outline) -> None:
    """Write the figures of a fitted outline into a mark; steps at the rim are left out."""
    _write_outline(mark, outline)
    where = (*picture, outline.x, outline.y)
    greys = levels(*where, outline.fit[0])
    mark.inside, mark.unevenness, mark.flatness, mark.outside, mark.texture = greys
    model = outline.ellipse
    model[outline.weight > 0.0] = np.nan  # the rim is there
    reach = BEYOND_RIM if outline.steps.size else BEYOND_FLOOR
    mark.beyond = kernels.darkest_beyond(*where, model, reach, GAP_RAYS)


def _set_doubt(mark: np.record, picture: _Picture, other: Sequence[float], steps: Floats) -> None:
    """Write what another edge may move the centre by into a mark.

    Towards the middle of the floor, or of an outline at ``other``, (x, y) in um. The floor lies in
    the middle of a hole, unless a part of what is around was taken for the hole; so it may be where
    the rim's step is another on one side. ``steps`` (RAYS,) are those of the rim, NaN where a ray
    has none.
    """
    centre = mark.centre
    total = mark.outside - mark.inside
    tolerance = max(3 * mark.unevenness, LEAST_INNER * total)
    floor = kernels.floor_middle(*picture, *centre, mark.radius, mark.inside, tolerance)
    from_floor = np.subtract(floor, centre)
    from_other = np.subtract(other, centre)
    distance = math.hypot(*from_floor)
    # First wave of the step around the rim: a ray without one counts for nothing.
    known_steps = steps[~np.isnan(steps)]
    all_steps = np.nan_to_num(steps)
    wave = math.hypot(_sum(all_steps * _COS), _sum(all_steps * _SIN))
    is_uneven = 2 * wave > ONE_SIDED * max(known_steps.size, 1) * total
    share, pixels = EXACT if is_uneven else USUAL
    usual = (share * mark.radius) ** 2 + (pixels * picture.pixel) ** 2
    beyond = FLOOR * math.sqrt(max(distance**2 - usual, 0.0))
    if EITHER * math.hypot(*from_other) > beyond:
        mark.doubt = EITHER * from_other
    else:
        mark.doubt = beyond / max(distance, 1e-30) * from_floor


def _write_outline(mark: np.record, outline: _Outline) -> None:
    """Write centre and size, share of the rim that is there, and how rough it is, into a mark.

    Covariance and waves are not yet those of the result: `hole_criteria.set_covariance` scales
    them.
    """
    radius, dx, dy, cos_part, sin_part = outline.fit
    is_used = outline.weight > 0.0
    # The radii are about the centre before the last step, so the shift is a part of the model.
    circle = radius + dx * _COS + dy * _SIN
    model = circle + cos_part * _COS_2 + sin_part * _SIN_2
    error = np.where(is_used, outline.radii - model, 0.0)
    mark.centre = outline.x, outline.y
    mark.radius = radius
    mark.half_difference = math.hypot(cos_part, sin_part)
    # Waves 3 and 4, and 5 to 8 of the rim. The first moves the centre; its size can only be
    # estimated from them.
    mark.low_waves, mark.high_waves = waves(error, outline.weight)
    # As if the rays were independent; the waves' own variance is put in once all holes are known.
    xx_yy_xy = outline.inverse[[1, 2, 1], [1, 2, 2]]
    mark.covariance = RAYS / 2 * xx_yy_xy
    used_count = np.count_nonzero(is_used)
    mark.coverage = used_count / RAYS
    mean_square = _sum(error**2) / max(1, used_count)
    mark.roughness = math.sqrt(mean_square)


def _median(values: Floats) -> float:
    finite = np.sort(values[~np.isnan(values)])  # numpy's own takes ten times as long for so few
    if not finite.size:
        return np.nan
    middle = finite.size // 2
    return float(0.5 * (finite[-1 - middle] + finite[middle]))


def _sum(values: Floats) -> float:
    """Sum in the order of the rays, whatever NumPy finds quicker."""
    return float(np.cumsum(values)[-1])
