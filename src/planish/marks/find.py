"""Laser holes in an image or a presence map, with sub-pixel centres and their covariances."""

from __future__ import annotations

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
from planish.marks.candidates import Image, Raster
from planish.marks.exchange.model import EXTRAS

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


Polarity = Literal["auto", "dark", "bright"]
"""Whether holes are darker or brighter than the sheet."""

# Diameter of the middle of the default range.
USUAL_UM = 173.2


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
    low, high = map(float, diameter_um)
    if not 0.0 < low < high < np.inf:
        raise MarkError(f"Hole diameters from {low:g} to {high:g} um: the first must be positive and below the second.")
    signs = {"auto": (1.0, -1.0), "dark": (1.0,), "bright": (-1.0,)}.get(polarity)
    if signs is None:
        raise MarkError(f"The polarity is {polarity!r}; it has to be 'auto', 'dark' or 'bright'.")
    grey = _grey(image)
    # Widths of char, walls and blur are those of laser holes; a target of another size is measured as its magnified
    # picture.
    times = float(USUAL_UM / np.sqrt(low * high))
    times = 1.0 if 0.5 <= times <= 2.0 else times
    sign, rows, counts = signs[0], np.empty((0, k.COLUMNS)), dict.fromkeys(REASONS, 0)
    may_hold_hole = min(n * step for n, step in zip(grey.shape, size, strict=True)) > low
    if may_hold_hole and min(grey.shape) >= 8 and np.any(np.isfinite(grey)):
        magnified = Raster(grey, (size[0] * times, size[1] * times))
        sign, rows, counts = _holes(magnified, (low / 2 * times, high / 2 * times), signs)
    rows[:, [k.X, k.Y, k.RADIUS, k.HALF_DIFFERENCE, k.DOUBT_X, k.DOUBT_Y]] /= times
    rows[:, [k.COV_XX, k.COV_YY, k.COV_XY]] /= times**2
    return _dataset(rows, sign).assign_attrs(not_taken=counts)


class _Marks(NamedTuple):
    """Marks of one polarity: holes, all that was measured, the places searched, the texture around."""

    sign: float
    holes: Floats
    measured: Floats
    places: Floats
    texture: candidates.LocalLevels
    dropped: int


def _holes(raster: Raster, radii: Pair, signs: tuple[float, ...]) -> tuple[float, Floats, dict[str, int]]:
    """Find the polarity with the stronger holes: its sign, rows of `measure` in um, and counts of rejected marks."""
    # Rims are measured with 40 pixels across the smallest hole.
    fine = candidates.reduce_to(raster, 2 * radii[0] / 40.0)
    best = max(_detect(fine, radii, signs), key=lambda marks: float(np.sum(marks.holes[:, k.STEP])))
    rows = best.holes
    if len(rows) >= criteria.LEAST_OTHERS:
        floors = _floors(fine, best.sign, best.places, rows)
        _raise_texture(floors, best.texture)
        rows = criteria.merge_floors(rows, floors)
    counts = _count_rejected(best, rows, fine, radii)
    criteria.set_covariance(rows, fine.pixel_um)
    rows[:, k.X : k.Y + 1] += fine.origin_um
    return best.sign, rows[np.lexsort((rows[:, k.X], rows[:, k.Y]))], counts


def _detect(fine: Raster, radii: Pair, signs: tuple[float, ...]) -> list[_Marks]:
    """Search candidates on a coarse raster and measure them on the fine one, for each sign."""
    diameter = 2 * radii[1]
    coarse = candidates.reduce_to(Raster(fine.image, fine.pixel_um), 2 * radii[0] / candidates.ACROSS_COARSE)
    responses = candidates.blob_responses(coarse, radii)
    # Char, neighbours and a radius between two of the scale space weaken a response; a third is allowed for them.
    # The texture of the quietest quarter around: holes, dots and dirt have little influence. Too small rather than too
    # large, and nowhere above the median.
    quiet = candidates.local_deviation(coarse, diameter, 0.25)
    quiet = quiet._replace(values=np.minimum(quiet.values, np.median(quiet.values)))
    # The response at the centre of a disc at its own radius.
    ratio = list(responses)[1] / min(responses)
    disc = criteria.LEAST_CONTRAST * float(np.exp(-1 / ratio) - np.exp(-ratio))
    faintest = quiet._replace(values=0.67 * disc * quiet.values)
    # Where a screen is printed the texture is large, and yet a hole is what no dot of the screen is.
    # Nowhere less than a quarter of that of the whole image: there, blots would stand out from nothing.
    spreads = [candidates.local_spread(response, candidates.SQUARE * diameter, 0.5) for response in responses.values()]
    spreads = [s._replace(values=np.maximum(s.values, 0.25 * float(np.median(s.values)))) for s in spreads]
    marks: list[_Marks] = []
    for sign in signs:
        points, standing, share, dropped = candidates.peaks(responses, sign, faintest, spreads)
        # Before a rim is measured its place may be some pixels off, and faint marks are counted: less contrast will do.
        least = (
            0.6 * share * criteria.LEAST_CONTRAST * quiet.at_points(points),
            np.where(share < 1.0, 0.0, 0.6 * criteria.LEAST_CONTRAST),
        )
        places = points + coarse.origin_um
        measured = _measure(fine, places, sign, radii, least)
        measured[:, k.STANDING] = standing
        # The sheet's own texture is what is left when everything that looks like a hole is taken out, with its char.
        holes = measured[criteria.is_hole(measured, fine.pixel_um, radii)]
        # Beyond a rim this much may be burnt.
        circles = np.stack([*(holes[:, k.X : k.Y + 1] - coarse.origin_um).T, holes[:, k.RADIUS] + 60.0], axis=1)
        texture = candidates.texture(coarse, diameter, circles)
        measured = measured[np.isfinite(measured[:, k.RADIUS])]
        _raise_texture(measured, texture)
        holes = criteria.deepest_disjoint(measured[criteria.is_hole(measured, fine.pixel_um, radii)])
        holes = criteria.drop_unlike(holes[criteria.is_whole(holes, fine.image.shape, fine.pixel_um)], sign)
        marks.append(_Marks(sign, holes, measured, places, texture, dropped))
    return marks


def _count_rejected(marks: _Marks, holes: Floats, fine: Raster, radii: Pair) -> dict[str, int]:
    """Count by reason what lies on no hole and would be one but for a single fault (mottle has several)."""
    measured = marks.measured
    is_whole = criteria.is_whole(measured, fine.image.shape, fine.pixel_um)
    met = criteria.met_criteria(measured, fine.pixel_um, radii)
    met["not_round"] |= ~is_whole  # a border that cuts a mark takes a part of its rim, too
    is_near = np.sum([is_whole, *met.values()], axis=0) >= len(met)
    rows = np.flatnonzero(is_near & ~criteria.overlaps_any(measured, holes))
    counts = dict.fromkeys(REASONS, 0) | {"not_measured": marks.dropped}
    for row in rows[criteria.best_rims(measured[rows])].tolist():
        reason = next((name for name, is_met in met.items() if not is_met[row]), "unlike")
        counts[reason if is_whole[row] else "cut"] += 1
    return counts


def _raise_texture(rows: Floats, texture: candidates.LocalLevels) -> None:
    """Raise the texture of rows to that around them, in place."""
    rows[:, k.TEXTURE] = np.maximum(rows[:, k.TEXTURE], texture.at_points(rows[:, k.X : k.Y + 1]))


def _measure(fine: Raster, places: Floats, sign: float, radii: Pair, least: tuple[Floats, Floats]) -> Floats:
    """Measure places, strongest first; what lies well inside a hole that a stronger one led to is passed over."""
    rows = np.full((len(places), k.COLUMNS), np.nan)
    every = np.arange(len(places))
    first = np.asarray(criteria.greedy_disjoint(every, criteria.neighbour_pairs(places, 2 * radii[0])), dtype=np.intp)
    for turn in (first, np.setdiff1d(every, first)):
        with np.errstate(invalid="ignore"):  # nearly all of a smooth round rim
            clear = rows[criteria.is_round(rows, fine.pixel_um) & ~criteria.is_doubtful(rows)]
        turn = turn[_is_outside(places[turn], clear, 0.5)]
        limits = (limit[turn] for limit in least)
        rows[turn] = k.measure(*_image_and_places(fine, places[turn]), sign, *radii, *limits)
    return rows


def _floors(fine: Raster, sign: float, places: Floats, holes: Floats) -> Floats:
    """Measure floors where no clear hole is."""
    typical = criteria.typical_hole(holes)
    places = places[_is_outside(places, holes[~criteria.is_doubtful(holes)], 1.0)]
    shares = (0.2, 0.08, 0.13, 0.27, 0.35)  # of the depth of the holes, at which a floor may end
    level = typical.floor + shares[0] * typical.depth
    middles = k.middles_of_floors(*_image_and_places(fine, places), sign, typical.radius, level)
    middles = middles[np.isfinite(middles[:, 0])]
    # Places beside each other lead to one hole.
    pairs = criteria.neighbour_pairs(middles, 0.1 * typical.radius)
    middles = middles[criteria.greedy_disjoint(np.arange(len(middles)), pairs)]
    levels = (typical.radius, typical.floor, typical.depth, shares)
    floors = k.measure_floors(*_image_and_places(fine, middles), sign, *levels)
    floors = criteria.select_resembling(floors, holes, fine.pixel_um)
    # A rim lies farther out than its floor.
    rims = floors.copy()
    rims[:, k.RADIUS] = np.maximum(rims[:, k.RADIUS], typical.radius)
    return floors[criteria.is_whole(rims, fine.image.shape, fine.pixel_um)]


def _is_outside(places: Floats, holes: Floats, share: float) -> Bools:
    """Return which places lie farther than a share of its radius from the middle of the nearest hole."""
    if not len(holes):
        return np.ones(len(places), bool)
    distance, nearest = KDTree(holes[:, [k.X, k.Y]]).query(places)
    return distance > share * holes[nearest, k.RADIUS]


def _image_and_places(raster: Raster, places: Floats) -> tuple[Image, float, float, Floats, Floats]:
    """Give what kernels take first: the image, its pixel size along x and y, and x and y of places."""
    x, y = np.ascontiguousarray(places.T)
    return raster.image, raster.pixel_um[1], raster.pixel_um[0], x, y


def _dataset(rows: Floats, sign: float) -> xr.Dataset:
    radius, half = rows[:, k.RADIUS], rows[:, k.HALF_DIFFERENCE]
    # Texture below a thousandth of the step is rounding; it would make the ratio meaningless.
    step = criteria.depth(rows)
    contrast = -sign * step / np.maximum(rows[:, k.TEXTURE], 1e-3 * step)
    texts = {"x": ("um", "Hole centre along the columns"), "y": ("um", "Hole centre down the rows"), **EXTRAS}
    texts["contrast"] = "1", "Step at the hole over the texture of the sheet around"
    columns = [*rows[:, [k.X, k.Y, k.COV_XX, k.COV_YY, k.COV_XY]].T, 2 * radius, (radius + half) / (radius - half)]
    columns += [rows[:, k.COVERAGE], contrast]
    variables = {
        name: ("mark", column, {"units": unit, "long_name": text})
        for (name, (unit, text)), column in zip(texts.items(), columns, strict=True)
    }
    return xr.Dataset(variables, attrs={"polarity": "dark" if sign > 0 else "bright"})


def _grey(image: ArrayLike) -> Image:
    grey = np.asarray(image)
    if grey.ndim != 2:
        raise MarkError(f"The image has shape {grey.shape}; holes are found in one grey channel, (rows, columns).")
    if grey.dtype.kind not in "biuf":
        raise MarkError(f"The image holds {grey.dtype} values; holes are found in real grey values.")
    if grey.dtype.kind == "f":
        is_finite = np.isfinite(grey)
        middle = float(np.median(grey[is_finite])) if np.any(is_finite) else 0.0
        # Large offsets would cost float32 its digits.
        grey = np.where(is_finite, grey - middle, np.nan)
    return np.ascontiguousarray(grey, dtype=np.float32)
