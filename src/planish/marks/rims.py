"""Round holes measured at places where they may be, by their rims or their floors.

The steps are compiled, one by one; what leads from one to the next is not, which would take as long
to compile again.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

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

# Columns of the results.
X, Y, RADIUS, HALF_DIFFERENCE, COV_XX, COV_YY, COV_XY, COVERAGE, STEP, INSIDE = range(10)
OUTSIDE, TEXTURE, ROUGHNESS, FLATNESS, UNEVENNESS, FAR_STEP, LOW_WAVES, HIGH_WAVES, BURNT, ALIKE = (
    range(10, 20)
)
DOUBT_X, DOUBT_Y, BEYOND = 20, 21, 22
COLUMNS = 23
CENTRE, COVARIANCE, DOUBT = np.s_[X:RADIUS], np.s_[COV_XX:COVERAGE], np.s_[DOUBT_X:BEYOND]

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


class _Picture(NamedTuple):
    """An image, its pixel size along x and y in um, and the sign that makes its holes dark."""

    image: Image
    px: float
    py: float
    sign: float

    @property
    def pixel(self) -> float:
        """Longer side of a pixel."""
        return max(self.px, self.py)

    @property
    def near(self) -> float:
        """Width of the search for an edge whose place is known, in um."""
        return max(1.2 * self.pixel, 6.0)


class _Outline(NamedTuple):
    """Outline of a hole: centre, fit, weights of the rays, inverse normal matrix, radii.

    With what the edge shows.
    """

    x: float
    y: float
    fit: Floats
    weight: Floats
    inverse: Floats
    radii: Floats
    steps: Floats
    far_steps: Floats
    nears: Floats

    @property
    def ellipse(self) -> Floats:
        """Radii of the rays about the fitted centre."""
        return self.fit[0] + self.fit[3] * _COS_2 + self.fit[4] * _SIN_2


def measure_rims(
    raster: Raster,
    positions: Floats,
    sign: float,
    radius_range: Pair,
    thresholds: Floats,
) -> Floats:
    """Measure a round hole at each candidate place.

    ``positions`` (n, 2), x and y in um; ``radius_range`` in um; a step below ``thresholds[0]``, or
    below ``thresholds[1]`` times the texture around, (2, n), is not measured. Returns ``(n,
    COLUMNS)``: centre, radius, half the difference of the half axes, covariance of the centre for
    waves of the rim of amplitude 1, share of the rim found, step at the rim, levels inside and
    outside times ``sign``, robust standard deviation of the sheet around, rms of the rim about the
    ellipse, rise of the floor towards the rim, unevenness of the floor, step over a wider distance,
    variances of the waves around the rim, long and short ones, and how far the sheet just outside
    the rim is from the sheet around (the last column is left to others). Lengths in um. NaN rows
    where there is no hole.
    """
    picture = _picture(raster, sign)
    holes = np.full((len(positions), COLUMNS), np.nan)
    for hole, position, least, contrast in zip(holes, positions, *thresholds, strict=True):
        circle = _circle(picture, position, radius_range, float(least), float(contrast))
        if circle is not None:
            _measure_rim(hole, picture, circle, radius_range)
    return holes


def _measure_rim(
    hole: Floats,
    picture: _Picture,
    circle: tuple[float, float, float, float],
    radius_range: Pair,
) -> None:
    """Write the figures of the rim near a circle into a row, which is left as it is without one."""
    *centre, radius, scale = circle
    pixel = picture.pixel
    least, largest = 0.5 * radius_range[0], 1.5 * radius_range[1]
    search = max(0.15 * radius, 2 * pixel, 10.0, min(3 * scale, 0.3 * radius))
    rim = _refined(picture, centre, np.full(RAYS, radius), search, share=0.35)
    if rim is None or not (least < rim.fit[0] < largest):
        return
    # The strongest edge, but where another one goes round inside: then that around is the end of
    # the char.
    centre, model, inner, around = _closed_rims(picture, centre, radius, least)
    closed = _followed(picture, centre, model, share=0.35)
    if closed is not None and _is_inside(closed, rim, least):
        rim = closed
    _describe(hole, picture, rim)
    hole[STEP] = _median(rim.steps)
    hole[FAR_STEP] = _median(rim.far_steps)
    hole[BURNT] = hole[OUTSIDE] - _median(rim.nears)
    _set_doubt(hole, picture, (rim.x, rim.y), rim.steps)
    if around == 0.0:
        return
    # Another closed edge inside: the rim of a hole with a scorched ring around, or that of the
    # other face.
    ring_picture = picture._replace(sign=around * picture.sign)
    ring = _followed(ring_picture, centre, inner, share=LEAST_INNER)
    if ring is None or not (least < ring.fit[0] < hole[RADIUS]):
        return
    if np.sum(ring.weight > 0) > 0.6 * RAYS:
        # Of two that rise either may be the rim; where the grey falls, char is darker than the
        # hole.
        other = ring
        if around < 0.0:
            _write_outline(hole, ring)
            other = rim
        _set_doubt(hole, picture, (other.x, other.y), rim.steps)


def measure_floors(
    raster: Raster,
    positions: Floats,
    sign: float,
    radius: float,
    floor: float,
    depth: float,
    shares: Sequence[float],
) -> Floats:
    """Measure the outline of a hole's floor about each place (n, 2).

    The outline lies where the grey leaves the floor's level.

    What is printed over a rim may hide its edge, and never the floor. ``radius``, ``floor`` (times
    ``sign``) and ``depth`` are those of the image's other holes. Of the levels, ``shares`` of the
    step from the floor to the sheet, that with the roundest outline is taken. Returns ``(n,
    COLUMNS)`` as `measure_rims` does, without steps at the rim.
    """
    picture = _picture(raster, sign)
    holes = np.full((len(positions), COLUMNS), np.nan)
    row = np.empty(COLUMNS)
    for hole, position in zip(holes, positions, strict=True):
        least = np.inf
        model = np.empty(0)
        for share in shares:
            outline = _floor_outline(picture, position, radius, floor + share * depth)
            if outline is None:
                continue
            _describe(row, picture, outline)
            # About the circle, not the ellipse: a blot beside a hole makes an ellipse of both.
            wave = 0.5 * row[HALF_DIFFERENCE] * row[HALF_DIFFERENCE]
            roughness = math.sqrt(row[ROUGHNESS] ** 2 + wave) / row[RADIUS] - row[COVERAGE]
            if roughness < least:
                least = roughness
                hole[:] = row
                model = outline.ellipse
        if least < np.inf:
            centre = (hole[X], hole[Y])
            _, steps, _, nears = half_level_edges(*picture, *centre, model, picture.near)
            hole[BURNT] = hole[OUTSIDE] - _median(nears)
            _set_doubt(hole, picture, centre, steps)
    return holes


def _picture(raster: Raster, sign: float) -> _Picture:
    row_um, col_um = raster.pixel_um
    return _Picture(raster.image, col_um, row_um, sign)


def _floor_outline(
    picture: _Picture, position: Floats, radius: float, level: float
) -> _Outline | None:
    """Outline of what is below a level; None where it lies elsewhere."""
    pixel = picture.pixel
    x, y = position
    dt = max(0.25 * pixel, 0.5)
    cx, cy = position
    for turn in range(6):
        radii = first_crossings(*picture, cx, cy, level, 1.6 * radius, dt, RAYS)
        fit, weight, _, inverse = fit_outline(radii, 1 if turn < 2 else 2, 0.3 + 0.1 * pixel)
        cx, cy = cx + fit[1], cy + fit[2]
        if np.sum(weight) == 0.0 or math.hypot(cx - x, cy - y) > 0.6 * radius:
            break
        if turn == 5 or (turn > 2 and math.hypot(fit[1], fit[2]) < 0.05 * pixel):
            return _Outline(cx, cy, fit, weight, inverse, radii, *(np.empty((3, 0))))
    return None


def _circle(
    picture: _Picture,
    position: Floats,
    radius_range: Pair,
    least: float,
    contrast: float,
) -> tuple[float, float, float, float] | None:
    """Return centre, radius and scatter of the circle through the innermost strong edges.

    None if there is none.
    """
    pixel = picture.pixel
    low, high = radius_range
    cx, cy = position
    window = max(14.0, 1.4 * pixel)
    dt = max(0.7 * pixel, 2.5)
    radius = np.nan
    scale = 0.0
    for turn, rays in enumerate((36, 64, 64, 64)):
        radii, _ = innermost_edges(*picture, cx, cy, 0.5 * low, 1.25 * high, dt, window, rays)
        fit, weight, scale, _ = fit_outline(radii, 1, 0.5)
        radius = float(fit[0])
        shift = math.hypot(fit[1], fit[2])
        is_found = np.count_nonzero(weight > 0.0) >= 0.5 * rays and scale <= 0.3 * radius
        if not (is_found and 0.6 * low < radius < 1.4 * high and shift <= radius):
            return None
        cx, cy = cx + fit[1], cy + fit[2]
        # Most places are mottle; the levels show it long before the rim is known.
        if turn == 0 and _is_mottle(levels(*picture, cx, cy, radius), least, contrast):
            return None
        if turn > 0 and shift < 0.1 * pixel:
            break
    return cx, cy, radius, scale


def _is_mottle(greys: tuple[float, ...], least: float, contrast: float) -> bool:
    """Return whether the levels at a place are too faint or uneven for a hole."""
    inside, spread, flatness, outside, texture = greys
    total = outside - inside
    is_uneven = spread > 0.35 * total or flatness > 0.4 * total
    return is_uneven or total < max(least, contrast * texture)


def _followed(
    picture: _Picture, centre: Sequence[float], model: Floats, *, share: float
) -> _Outline | None:
    return _refined(picture, centre, model, picture.near, share=share, follow=True)


def _refined(
    picture: _Picture,
    centre: Sequence[float],
    model: Floats,
    search: float,
    *,
    share: float,
    follow: bool = False,
) -> _Outline | None:
    """Return the outline at half level near a modelled one; None if there is none.

    Steps below a ``share`` of the median are left out. With ``follow`` what was found is followed,
    so that a rough rim needs no wide search, in which lies another edge.
    """
    pixel = picture.pixel
    cx, cy = centre
    radius = float(np.mean(model))
    outline = None
    for _turn in range(3):
        edges = half_level_edges(*picture, cx, cy, model, search)
        radii, steps, *_ = edges
        radii[~(steps >= share * _median(steps))] = np.nan
        fit, weight, scale, inverse = fit_outline(radii, 2, 0.3 + 0.1 * pixel)
        if np.sum(weight) == 0.0 or math.hypot(fit[1], fit[2]) > 0.5 * radius:
            return None
        cx, cy, radius = cx + fit[1], cy + fit[2], fit[0]
        outline = _Outline(cx, cy, fit, weight, inverse, *edges)
        model = outline.ellipse
        if follow:
            model = np.where(weight > 0.0, radii - fit[1] * _COS - fit[2] * _SIN, model)
        else:
            search = max(picture.near, 4 * scale)
    return outline


def _is_inside(closed: _Outline, rim: _Outline, least: float) -> bool:
    """Return whether a closed outline lies inside another, well away from it on many rays.

    Its radius has to be above the ``least``.
    """
    # As far as a shift of the centre goes, the two are compared on the same ray.
    shift = (closed.x - rim.x) * _COS + (closed.y - rim.y) * _SIN
    distances = rim.radii - (closed.radii + shift)
    is_apart = np.count_nonzero(distances > APART * rim.fit[0]) > PART * RAYS
    is_smaller = least < closed.fit[0] < (1 - SMALLER) * rim.fit[0]
    return bool(is_smaller and is_apart and np.sum(closed.weight > 0) > CLOSED * RAYS)


def _closed_rims(
    picture: _Picture, centre: Sequence[float], radius: float, least: float
) -> tuple[Pair, Floats, Floats, float]:
    """Return a centre and the radii of the closed rim about it and of another rim inside.

    Also returns the sign of that other rim.

    The sign is 1 where the other edge rises as the rim does, -1 where it falls, and 0 where there
    is none.
    """
    pixel = picture.pixel
    dt = max(0.5 * pixel, 2.5)
    reach = max(1, round(max(14.0, 1.4 * pixel) / dt))
    inside, spread, _, outside, _ = levels(*picture, *centre, radius)
    total = outside - inside
    tolerance = max(3 * spread, 0.1 * total)
    x, y = kernels.floor_middle(*picture, *centre, radius, inside, tolerance)
    shift = math.hypot(x - centre[0], y - centre[1])
    count = int((radius + shift + 0.3 * radius) / dt) + 2 * reach
    band = max(1, round(1.5 * pixel / dt))
    first = max(reach, int(least / dt))
    rises = kernels.polar_rises(*picture, x, y, dt, count, reach, RAYS)
    # Not beyond the circle of the innermost strong edges: a hole that is half closed has char all
    # the way round.
    last = min(count - reach, int(1.1 * radius / dt) + 1)
    worth = kernels.edge_worth(rises, kernels.ENOUGH * total)
    middle, half, _ = kernels.rim_radius(worth, first, last, band, kernels.OUTWARDS * dt / radius)
    path = kernels.closed_path(worth, max(0, middle - half), middle + half)
    weak = max(LEAST_INNER * total, 2.5 * spread)
    # A ring darker than what the hole shows: the rim is where the grey falls.
    innermost = int(np.min(path))
    last = innermost - reach
    if last > first:
        worth = kernels.edge_worth(-rises, weak)
        middle, half, share = kernels.rim_radius(worth, first, last - band, band, 0.0)
        if share > 0.7:
            ring = kernels.closed_path(worth, max(0, middle - half), min(middle + half, last))
            return (x, y), path * dt, ring * dt, -1.0
    # Weaker edges inside, where there are any.
    steps = np.arange(count)
    worth = kernels.edge_worth(rises, weak) - kernels.OUTWARDS * dt * steps / radius
    worth[steps >= path[:, None] + 2] = -np.inf
    within = kernels.closed_path(worth, min(first, innermost), int(np.max(path)) + 1)
    has_other = np.sum(path - within >= reach) > 0.1 * RAYS
    return (x, y), path * dt, within * dt, float(has_other)


def _describe(row: Floats, picture: _Picture, outline: _Outline) -> None:
    """Write the figures of a fitted outline into a row; steps at the rim are left out."""
    row[:] = np.nan
    _write_outline(row, outline)
    columns = [INSIDE, UNEVENNESS, FLATNESS, OUTSIDE, TEXTURE]
    where = (*picture, outline.x, outline.y)
    row[columns] = levels(*where, outline.fit[0])
    model = outline.ellipse
    model[outline.weight > 0.0] = np.nan  # the rim is there
    reach = BEYOND_RIM if outline.steps.size else BEYOND_FLOOR
    row[BEYOND] = kernels.darkest_beyond(*where, model, reach, GAP_RAYS)


def _set_doubt(row: Floats, picture: _Picture, other: Pair, steps: Floats) -> None:
    """Write what another edge may move the centre by.

    Towards the middle of the floor, or of an outline at ``other``.

    The floor lies in the middle of a hole, unless a part of what is around was taken for the hole;
    so it may be where the rim's step is another on one side.
    """
    centre, radius, total = row[CENTRE], row[RADIUS], row[OUTSIDE] - row[INSIDE]
    tolerance = max(3 * row[UNEVENNESS], LEAST_INNER * total)
    floor = kernels.floor_middle(*picture, *centre, radius, row[INSIDE], tolerance)
    from_floor = np.subtract(floor, centre)
    from_other = np.subtract(other, centre)
    distance = math.hypot(*from_floor)
    is_known = ~np.isnan(steps)
    parts = [_sum(np.where(is_known, steps * part, 0.0)) for part in (_COS, _SIN)]
    wave = math.hypot(*parts)
    is_uneven = 2 * wave > ONE_SIDED * max(np.count_nonzero(is_known), 1) * total
    share, pixels = EXACT if is_uneven else USUAL
    usual = (share * radius) ** 2 + (pixels * picture.pixel) ** 2
    beyond = FLOOR * math.sqrt(max(distance**2 - usual, 0.0))
    if EITHER * math.hypot(*from_other) > beyond:
        row[DOUBT] = EITHER * from_other
    else:
        row[DOUBT] = beyond / max(distance, 1e-30) * from_floor


def _write_outline(row: Floats, outline: _Outline) -> None:
    """Write centre and size, share of the rim that is there, and how rough it is."""
    fit, is_used = outline.fit, outline.weight > 0.0
    circle = fit[0] + fit[1] * _COS + fit[2] * _SIN
    model = circle + fit[3] * _COS_2 + fit[4] * _SIN_2
    error = np.where(is_used, outline.radii - model, 0.0)
    row[CENTRE] = outline.x, outline.y
    row[RADIUS] = fit[0]
    row[HALF_DIFFERENCE] = math.hypot(fit[3], fit[4])
    # Waves 3 and 4, and 5 to 8 of the rim. The first moves the centre; its size can only be
    # estimated from them.
    row[[LOW_WAVES, HIGH_WAVES]] = waves(error, outline.weight)
    # As if the rays were independent; the waves' own variance is put in once all holes are known.
    row[COVARIANCE] = RAYS / 2 * outline.inverse[[1, 2, 1], [1, 2, 2]]
    used = np.count_nonzero(is_used)
    row[COVERAGE] = used / RAYS
    row[ROUGHNESS] = math.sqrt(_sum(error**2) / max(1, used))


def _median(values: Floats) -> float:
    finite = np.sort(values[~np.isnan(values)])  # numpy's own takes ten times as long for so few
    if not finite.size:
        return np.nan
    middle = finite.size // 2
    return float(0.5 * (finite[-1 - middle] + finite[middle]))


def _sum(values: Floats) -> float:
    """Sum in the order of the rays, whatever NumPy finds quicker."""
    return float(np.cumsum(values)[-1])
