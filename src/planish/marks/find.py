"""Laser holes in an image or a presence map, with sub-pixel centres and their covariances."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from planish.core.errors import MarkError, SizeError
from planish.core.typing import Bools, Floats, Pair
from planish.marks import _measure_kernels as k
from planish.marks import candidates
from planish.marks import hole_criteria as criteria
from planish.marks.candidates import FAINTEST, Image, Raster
from planish.marks.hole_criteria import LEAST_CONTRAST, best_rims, overlaps_any

REASONS = {
    "not_measured": "not measured",
    "cut": "cut by the border",
    "too_small": "too small",
    "too_large": "too large",
    "too_faint": "too faint",
    "not_round": "not round or not closed",
    "no_rim": "without a sharp rim",
    "unlike": "unlike the other holes",
}
"""Reasons why a mark is no hole, in the order of a sentence, and their words."""


def count_rejected(
    measured: Floats, holes: Floats, criteria: dict[str, Bools], is_whole: Bools, dropped: int
) -> dict[str, int]:
    """Count by reason what was measured (rows of `measure`, with the criteria they meet; whether the image holds all).

    Only what lies on none of the holes, and would be one but for a single fault: mottle has several. Of marks that
    overlap the one with the best rim counts.
    """
    # A border that cuts a mark takes a part of its rim, too.
    met = {name: met | ((name == "not_round") & ~is_whole) for name, met in criteria.items()}
    is_near = np.sum([is_whole, *met.values()], axis=0) >= len(criteria)
    rows = np.flatnonzero(is_near & ~overlaps_any(measured, holes))
    rows = rows[best_rims(measured[rows])]
    counts = dict.fromkeys(REASONS, 0) | {"not_measured": dropped}
    for row in rows.tolist():
        reason = next((name for name, is_met in met.items() if not is_met[row]), "unlike")
        counts[reason if is_whole[row] else "cut"] += 1
    return counts


Polarity = Literal["auto", "dark", "bright"]
"""Whether holes are darker or brighter than the sheet."""

# Shares of the depth of the holes at which a floor may end.
FLOOR_SHARES = (0.2, 0.08, 0.13, 0.27, 0.35)
# Diameter of the middle of the default range.
USUAL_UM = 173.2
# Share of the least contrast from which on a mark is measured.
SEEN = 0.6


def find_holes(
    image: ArrayLike,
    *,
    pixel_um: float | Pair,
    diameter_um: Pair = (100.0, 300.0),
    polarity: Polarity = "auto",
) -> xr.Dataset:
    """Find round laser holes and locate their centres to a fraction of a pixel.

    Parameters
    ----------
    image : array-like, shape (rows, columns)
        A photograph of the sheet on any grey scale, or a presence map (about 1 where there is sheet, about 0 in holes).
        NaN where there is no data.
    pixel_um : float or (float, float), in um
        Pixel size, one value or ``(y, x)``; pixel ``i`` has its centre at ``i * pixel_um``.
    diameter_um : tuple of float, in um
        Smallest and largest diameter of a hole.
    polarity : {"auto", "dark", "bright"}
        Whether holes are darker than the sheet (presence maps, reflected light) or brighter (transmitted light). With
        ``"auto"`` the side with the stronger holes is taken; holes of both kinds are never mixed.

    Returns
    -------
    Dataset, dims (mark)
        ``x, y`` (um), ``cov_xx, cov_yy, cov_xy`` (um2), ``diameter`` (um), ``axis_ratio``, ``arc_coverage`` (0 to 1)
        and ``contrast`` (negative for dark holes). Sorted by y, then x. Empty, without an error, where there is no
        hole.
        ``attrs["polarity"]`` says which kind was found. ``attrs["not_taken"]`` counts by reason what was seen and is
        not among the holes though it would be but for this: ``cut`` by the border, ``too_small``, ``too_large``,
        ``too_faint``, ``not_round`` or not closed, ``no_rim`` that is sharp, ``unlike`` the other holes; and as
        ``not_measured`` places that might be holes: in large images at most as many are measured as smallest holes
        would cover the area, the strongest of each part of the image. It is 0 but for very dense patterns, or where
        ``diameter_um`` begins far above their size.

    Raises
    ------
    SizeError
        If a pixel size is not a positive number.
    MarkError
        If the image is not two-dimensional or the range of diameters is empty.

    Notes
    -----
    A burnt rim surrounds each hole, so the rim is taken at the innermost strong edge met going out from the
    centre, at half level between the floor and what lies just outside it. Rims are fitted by ``r0 + a cos + b sin +
    c cos 2 + d sin 2`` with Tukey weights, which is an ellipse to first order. The roughness of a rim has a first
    wave, too, which moves the centre and does not show in the residuals; the covariance of a centre follows from the
    next waves, half those of the rim itself and half those of all rims. Two images of one hole share the rim, so it is
    on the safe side. Holes cut by the border of the image or of the data are left out, as
    are holes closed over more than 30 % of their rim.

    References
    ----------
    Hirn et al. (2009), section 2.1: holes of 150 to 200 um with a thin burnt rim.

    Examples
    --------
    >>> y, x = np.mgrid[:100, :120] * 5.0
    >>> find_holes(np.hypot(x - 300, y - 250) > 80, pixel_um=5.0).x.values.round(1)
    array([300.])
    """
    sizes = np.atleast_1d(np.asarray(pixel_um, dtype=np.float64))
    if sizes.size not in (1, 2) or not np.all(np.isfinite(sizes)) or np.any(sizes <= 0):
        raise SizeError(f"The pixel size is {pixel_um!r} um; one positive number or two, (y, x), are needed.")
    size = float(sizes[0]), float(sizes[-1])
    low, high = (float(value) for value in diameter_um)
    if not 0.0 < low < high < np.inf:
        raise MarkError(f"Hole diameters from {low:g} to {high:g} um: the first must be positive and below the second.")
    if polarity not in ("auto", "dark", "bright"):
        raise MarkError(f"The polarity is {polarity!r}; it has to be 'auto', 'dark' or 'bright'.")
    grey = _grey(image)
    signs = {"auto": (1.0, -1.0), "dark": (1.0,), "bright": (-1.0,)}[polarity]
    # Widths of char, walls and blur are those of laser holes; a target of another size is measured as its magnified
    # picture.
    times = USUAL_UM / np.sqrt(low * high)
    times = 1.0 if 0.5 <= times <= 2.0 else float(times)
    sign, rows, counts = signs[0], np.empty((0, k.COLUMNS)), dict.fromkeys(REASONS, 0)
    may_hold_hole = min(n * step for n, step in zip(grey.shape, size, strict=True)) > low
    if may_hold_hole and min(grey.shape) >= 8 and np.any(np.isfinite(grey)):
        magnified = size[0] * times, size[1] * times
        sign, rows, counts = _holes(grey, magnified, low / 2 * times, high / 2 * times, signs)
    rows[:, [k.X, k.Y, k.RADIUS, k.HALF_DIFFERENCE, k.DOUBT_X, k.DOUBT_Y]] /= times
    rows[:, [k.COV_XX, k.COV_YY, k.COV_XY]] /= times**2
    return _dataset(rows, sign).assign_attrs(not_taken=counts)


class _Detection(NamedTuple):
    """Marks of one polarity: holes, all that was measured, the places searched, the texture around."""

    sign: float
    holes: Floats
    measured: Floats
    places: Floats
    texture: candidates.LocalLevels
    dropped: int


def _holes(
    grey: Image, size: Pair, low: float, high: float, signs: tuple[float, ...]
) -> tuple[float, Floats, dict[str, int]]:
    """Find the polarity with the stronger holes: its sign, rows of `measure` in um, and counts of rejected marks."""
    fine = candidates.reduce_to(grey, size, 2 * low / candidates.ACROSS_FINE)
    best = max(_detections(fine, low, high, signs), key=lambda detection: float(np.sum(detection.holes[:, k.STEP])))
    rows = best.holes
    if len(rows) >= criteria.LEAST_OTHERS:
        floors = _floors(fine, best.sign, best.places, rows)
        _raise_texture(floors, best.texture)
        rows = criteria.merge_floors(rows, floors)
    is_whole = criteria.is_whole(best.measured, fine.image.shape, fine.pixel_um)
    met = criteria.met_criteria(best.measured, fine.pixel_um, low, high)
    counts = count_rejected(best.measured, rows, met, is_whole, best.dropped)
    criteria.set_covariance(rows, fine.pixel_um)
    rows[:, k.X : k.Y + 1] += fine.origin_um
    return best.sign, rows[np.lexsort((rows[:, k.X], rows[:, k.Y]))], counts


def _detections(fine: Raster, low: float, high: float, signs: tuple[float, ...]) -> Iterator[_Detection]:
    """Search candidates on a coarse raster and measure them on the fine one, for each sign."""
    coarse, coarse_size, coarse_origin = candidates.reduce_to(*fine[:2], 2 * low / candidates.ACROSS_COARSE)
    responses = candidates.blob_responses(coarse, coarse_size, (low, high))
    square = candidates.SQUARE * 2 * high
    # Char, neighbours and a radius between two of the scale space weaken a response; a third is allowed for them.
    # The texture of the quietest quarter around: holes, dots and dirt have little influence. Too small rather than too
    # large, and nowhere above the median.
    quiet = candidates.local_deviation(coarse, coarse_size, 2 * high, square, 0.25)
    quiet = quiet._replace(values=np.minimum(quiet.values, np.median(quiet.values)))
    # The response at the centre of a disc at its own radius.
    ratio = responses[1].radius / responses[0].radius
    disc = LEAST_CONTRAST * float(np.exp(-1 / ratio) - np.exp(-ratio))
    faintest = quiet._replace(values=0.67 * disc * quiet.values)
    # Where a screen is printed the texture is large, and yet a hole is what no dot of the screen is.
    # Nowhere less than a quarter of that of the whole image: there, blots would stand out from nothing.
    spreads = [candidates.local_spread(response.values, response.pixel_um, square, 0.5) for response in responses]
    spreads = [s._replace(values=np.maximum(s.values, FAINTEST * float(np.median(s.values)))) for s in spreads]
    for sign in signs:
        points, standing, share, dropped = candidates.peaks(
            responses, sign, faintest, spreads, criteria.WORTH_MEASURING
        )
        # Before a rim is measured its place may be some pixels off, and faint marks are counted: less contrast will do.
        worth = (
            SEEN * share * LEAST_CONTRAST * quiet.at_points(points),
            np.where(share < 1.0, 0.0, SEEN * LEAST_CONTRAST),
        )
        places = points + coarse_origin
        measured = _measured(fine, places, sign, (low, high), worth)
        measured[:, k.STANDING] = standing
        # The sheet's own texture is what is left when everything that looks like a hole is taken out, with its char.
        holes = measured[criteria.is_hole(measured, fine.pixel_um, low, high)]
        # Beyond a rim this much may be burnt.
        circles = np.stack([*(holes[:, k.X : k.Y + 1] - coarse_origin).T, holes[:, k.RADIUS] + 60.0], axis=1)
        texture = candidates.texture(coarse, coarse_size, 2 * high, square, circles)
        measured = measured[np.isfinite(measured[:, k.RADIUS])]
        _raise_texture(measured, texture)
        holes = criteria.deepest_disjoint(measured[criteria.is_hole(measured, fine.pixel_um, low, high)])
        holes = criteria.drop_unlike(holes[criteria.is_whole(holes, fine.image.shape, fine.pixel_um)], sign)
        yield _Detection(sign, holes, measured, places, texture, dropped)


def _raise_texture(rows: Floats, texture: candidates.LocalLevels) -> None:
    """Raise the texture of rows to that around them, in place."""
    rows[:, k.TEXTURE] = np.maximum(rows[:, k.TEXTURE], texture.at_points(rows[:, k.X : k.Y + 1]))


def _measured(fine: Raster, places: Floats, sign: float, radii: Pair, worth: tuple[Floats, Floats]) -> Floats:
    """Measure places, strongest first; what lies well inside a hole that a stronger one led to is passed over."""
    image, size, _ = fine
    rows = np.full((len(places), k.COLUMNS), np.nan)
    pairs = criteria.neighbour_pairs(places, 2 * radii[0])
    first = np.asarray(criteria.greedy_disjoint(np.arange(len(places)), *pairs), dtype=np.intp)
    for turn in (first, np.setdiff1d(np.arange(len(places)), first)):
        with np.errstate(invalid="ignore"):  # nearly all of a smooth round rim
            clear = np.flatnonzero(criteria.is_round(rows, size) & ~criteria.is_doubtful(rows))
        if clear.size:
            away, nearest = KDTree(rows[clear][:, [k.X, k.Y]]).query(places[turn])
            turn = turn[away > 0.5 * rows[clear][nearest, k.RADIUS]]
        x, y = np.ascontiguousarray(places[turn].T)
        rows[turn] = k.measure(image, size[1], size[0], x, y, sign, *radii, *(limit[turn] for limit in worth))
    return rows


def _floors(fine: Raster, sign: float, places: Floats, holes: Floats) -> Floats:
    """Measure floors where no clear hole is."""
    image, size, _ = fine
    typical = criteria.typical_hole(holes)
    clear = holes[~criteria.is_doubtful(holes)]
    if len(clear):
        away, nearest = KDTree(clear[:, [k.X, k.Y]]).query(places)
        places = places[away > clear[nearest, k.RADIUS]]
    x, y = np.ascontiguousarray(places.T)
    level = typical.floor + FLOOR_SHARES[0] * typical.depth
    middles = k.middles_of_floors(image, size[1], size[0], x, y, sign, typical.radius, level)
    middles = middles[np.isfinite(middles[:, 0])]
    # Places beside each other lead to one hole.
    pairs = criteria.neighbour_pairs(middles, 0.1 * typical.radius)
    x, y = np.ascontiguousarray(middles[criteria.greedy_disjoint(np.arange(len(middles)), *pairs)].T)
    levels = (typical.radius, typical.floor, typical.depth, FLOOR_SHARES)
    floors = criteria.select_resembling(k.measure_floors(image, size[1], size[0], x, y, sign, *levels), holes, size)
    # A rim lies farther out than its floor.
    rims = floors.copy()
    rims[:, k.RADIUS] = np.maximum(rims[:, k.RADIUS], typical.radius)
    return floors[criteria.is_whole(rims, image.shape, size)]


def _dataset(rows: Floats, sign: float) -> xr.Dataset:
    radius, half = rows[:, k.RADIUS], rows[:, k.HALF_DIFFERENCE]
    # Texture below a thousandth of the step is rounding; it would make the ratio meaningless.
    step = rows[:, k.OUTSIDE] - rows[:, k.INSIDE]
    columns = (
        ("x", rows[:, k.X], "um", "Hole centre along the columns"),
        ("y", rows[:, k.Y], "um", "Hole centre down the rows"),
        ("cov_xx", rows[:, k.COV_XX], "um2", "Variance of x"),
        ("cov_yy", rows[:, k.COV_YY], "um2", "Variance of y"),
        ("cov_xy", rows[:, k.COV_XY], "um2", "Covariance of x and y"),
        ("diameter", 2 * radius, "um", "Mean diameter of the rim"),
        ("axis_ratio", (radius + half) / (radius - half), "1", "Longer over shorter axis of the rim"),
        ("arc_coverage", rows[:, k.COVERAGE], "1", "Share of the rim that was found"),
        ("contrast", -sign * step / np.maximum(rows[:, k.TEXTURE], 1e-3 * step), "1",
         "Step at the hole over the texture of the sheet around"),
    )  # fmt: skip
    return xr.Dataset(
        {name: ("mark", values, {"units": unit, "long_name": text}) for name, values, unit, text in columns},
        attrs={"polarity": "dark" if sign > 0 else "bright"},
    )


def _grey(image: ArrayLike) -> Image:
    values = np.asarray(image)
    if values.ndim != 2:
        raise MarkError(f"The image has shape {values.shape}; holes are found in one grey channel, (rows, columns).")
    if values.dtype.kind not in "biuf":
        raise MarkError(f"The image holds {values.dtype} values; holes are found in real grey values.")
    if values.dtype.kind == "f":
        is_finite = np.isfinite(values)
        middle = float(np.median(values[is_finite])) if np.any(is_finite) else 0.0
        # Large offsets would cost float32 its digits.
        return np.ascontiguousarray(np.where(is_finite, values - middle, np.nan), dtype=np.float32)
    return np.ascontiguousarray(values, dtype=np.float32)
