"""Laser holes in an image or a presence map, with sub-pixel centres and their covariances."""

from typing import Literal, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from planish.core.errors import MarkError, SizeError
from planish.core.grid import shorter_side_um
from planish.core.transform import are_known
from planish.core.typing import Bools, Floats, Pair
from planish.marks import _rim_kernels, candidates
from planish.marks import hole_criteria as criteria
from planish.marks.candidates import Image, Raster
from planish.marks.exchange.model import EXTRAS
from planish.marks.rims import Marks, blank_marks, measure_floors, measure_rims

REASONS = {
    "not_measured": "not measured",
    "cut": "cut by the border",
    "too_small": "too small",
    "too_large": "too large",
    "too_faint": "too faint",
    "not_round": "not round or not closed",
    "no_rim": "without a sharp rim",
    "open": "open to one side",
    "unlike": "unlike the other holes",
}
"""Reasons why a mark is no hole, in the order of a sentence, and their words."""


Polarity = Literal["auto", "dark", "bright"]
"""Whether holes are darker or lighter than the sheet."""

_SIGNS = {"auto": (1.0, -1.0), "dark": (1.0,), "bright": (-1.0,)}
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
        A photograph of the sheet on any grey scale, or a presence map (about 1 in sheet, 0 in
        holes); NaN: no data.
    pixel_um : float or (float, float), in um
        Pixel size, one value or ``(y, x)``; pixel ``i`` has its centre at ``i * pixel_um``.
    diameter_um : tuple of float, in um
        Smallest and largest diameter of a hole.
    polarity : {"auto", "dark", "bright"}
        Whether holes are darker than the sheet (presence maps, reflected light) or lighter
        (transmitted light). With ``"auto"`` the side with the stronger holes is taken; holes of
        both kinds are never mixed.

    Returns
    -------
    Dataset, dims (mark)
        ``x, y`` (um), ``cov_xx, cov_yy, cov_xy`` (um2), ``diameter`` (um), ``axis_ratio``,
        ``arc_coverage`` (0 to 1) and ``contrast`` (negative for dark holes). Sorted by y, then x.
        Empty, without an error, where there is no hole. ``attrs["polarity"]`` says which kind was
        found. ``attrs["not_taken"]`` counts by reason what was seen and is not among the holes
        though it would be but for this: ``cut`` by the border, ``too_small``, ``too_large``,
        ``too_faint``, ``not_round`` or not closed, ``no_rim`` that is sharp, ``open`` to one side,
        ``unlike`` the other holes; and as ``not_measured`` places that might be holes: in large
        images at most as many are measured as smallest holes would cover the area, the strongest of
        each part of the image. It is 0 but for very dense patterns, or where ``diameter_um`` begins
        far above their size.

    Raises
    ------
    SizeError
        If a pixel size is not a positive number.
    MarkError
        If the image is not two-dimensional or the range of diameters is empty.

    Notes
    -----
    A burnt rim surrounds each hole, so the rim is taken at the innermost strong edge met going out
    from the centre, at half level between the floor and what lies just outside it. Rims are fitted
    by ``r0 + a cos + b sin + c cos 2 + d sin 2`` with Tukey weights, which is an ellipse to first
    order. The roughness of a rim has a first wave, too, which moves the centre and does not show in
    the residuals; the covariance of a centre follows from the next waves, half those of the rim
    itself and half those of all rims. Two images of one hole share the rim, so it is on the safe
    side. In mottle as strong as the holes are deep, three or more floors that are flat, alike and
    darker than 97 % of the sheet stand for contrast. Holes cut by the border of the image or of the
    data are left out, as are holes closed over more than 30 % of their rim, and those whose floor
    goes on beyond a tenth of it, as in slots and in holes that run into each other.

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
    is_length = np.isfinite(sizes) & (sizes > 0)
    if sizes.size not in (1, 2) or not is_length.all():
        raise SizeError(
            f"The pixel size is {pixel_um!r} um; one positive number or two, (y, x), are needed."
        )
    row_um, col_um = np.broadcast_to(sizes, 2).tolist()
    low, high = map(float, diameter_um)
    if not 0.0 < low < high < np.inf:
        raise MarkError(
            f"Hole diameters from {low:g} to {high:g} um: the first must be positive and below the"
            " second."
        )
    signs = _SIGNS.get(polarity)
    if signs is None:
        raise MarkError(f"The polarity is {polarity!r}; it has to be 'auto', 'dark' or 'bright'.")
    grey = _grey(image)
    # Widths of char, walls and blur are those of laser holes; other targets are measured as a
    # magnified picture.
    magnification = float(USUAL_UM / np.sqrt(low * high))
    if 0.5 <= magnification <= 2.0:
        magnification = 1.0
    sign, *_ = signs
    holes = blank_marks(0)
    counts = dict.fromkeys(REASONS, 0)
    is_wide = shorter_side_um(grey.shape, (row_um, col_um)) > low
    if is_wide and min(grey.shape) >= 8 and np.any(np.isfinite(grey)):
        raster = Raster(grey, (row_um * magnification, col_um * magnification))
        radii = (low / 2 * magnification, high / 2 * magnification)
        sign, holes, counts = _holes(raster, radii, signs)
    holes.centre /= magnification
    holes.radius /= magnification
    holes.half_difference /= magnification
    holes.covariance /= magnification**2
    return _dataset(holes, sign).assign_attrs(not_taken=counts)


class _Detection(NamedTuple):
    """Marks of one polarity, in um from the first pixel of the fine raster."""

    sign: float  # 1 for dark holes, -1 for bright ones
    holes: Marks
    marks: Marks  # all that was measured
    positions: Floats  # (n, 2): x, y of all places that were searched
    texture: candidates.LocalLevels  # of the sheet without its holes
    dropped_count: int  # places beyond what is measured


def _holes(
    raster: Raster, radius_range: Pair, signs: tuple[float, ...]
) -> tuple[float, Marks, dict[str, int]]:
    """Find the polarity with the stronger holes.

    ``radius_range`` in um. Gives its sign, its holes in um from the first pixel of the raster,
    sorted by y, then x, and counts of rejected marks by their reason.
    """
    # Rims are measured with 40 pixels across the smallest hole.
    fine_raster = candidates.reduce_to(raster, 2 * radius_range[0] / 40.0)
    detections = _detect(fine_raster, radius_range, signs)
    strongest = max(detections, key=lambda d: float(np.sum(d.holes.step)))
    holes = strongest.holes
    if len(holes) >= criteria.LEAST_OTHERS:
        floors = _floors(fine_raster, strongest)
        _raise_texture(floors, strongest.texture)
        holes = criteria.merge_floors(holes, floors)
    counts = _count_rejected(strongest, holes, fine_raster, radius_range)
    criteria.set_covariance(holes, fine_raster.pixel_um)
    holes.centre += fine_raster.origin_um
    order = np.lexsort(holes.centre.T)
    return strongest.sign, holes[order], counts


def _detect(raster: Raster, radius_range: Pair, signs: tuple[float, ...]) -> list[_Detection]:
    """Search candidates on a coarser raster and measure them on a fine one, for each sign.

    Places count from the first pixel of the fine one; ``radius_range`` in um.
    """
    least_radius, largest_radius = radius_range
    diameter = 2 * largest_radius
    from_first = Raster(raster.image, raster.pixel_um)
    coarse = candidates.reduce_to(from_first, 2 * least_radius / candidates.ACROSS_COARSE)
    responses = candidates.blob_responses(coarse, radius_range)
    # Char, neighbours and a radius between two of the scale space weaken a response; a third is
    # allowed for them. The texture of the quietest quarter around: holes, dots and dirt have little
    # influence. Too small rather than too large, and nowhere above the median.
    quiet_texture = candidates.local_deviation(coarse, diameter, 0.25)
    median_texture = np.median(quiet_texture.values)
    quiet_levels = np.minimum(quiet_texture.values, median_texture)
    quiet_texture = quiet_texture._replace(values=quiet_levels)
    # The response at the centre of a disc at its own radius.
    first_radius, second_radius, *_ = responses
    radius_ratio = second_radius / first_radius
    response_share = float(np.exp(-1 / radius_ratio) - np.exp(-radius_ratio))
    disc_response = criteria.LEAST_CONTRAST * response_share
    faintest_levels = quiet_texture._replace(values=0.67 * disc_response * quiet_levels)
    # Where a screen is printed the texture is large, and yet a hole is what no dot of the screen
    # is. Nowhere less than a quarter of that of the whole image: there, blots would stand out from
    # nothing.
    spreads: list[candidates.LocalLevels] = []
    for response in responses.values():
        spread = candidates.local_spread(response, candidates.SQUARE * diameter, 0.5)
        least_spread = 0.25 * float(np.median(spread.values))
        spread_levels = np.maximum(spread.values, least_spread)
        spreads.append(spread._replace(values=spread_levels))
    limits = (raster.pixel_um, radius_range)
    detections: list[_Detection] = []
    for sign in signs:
        coarse_points, shares, dropped_count = candidates.peaks(
            responses, sign, faintest_levels, spreads
        )
        # Before a rim is measured its place may be some pixels off, and faint marks are counted:
        # less contrast will do.
        least_contrast = 0.6 * criteria.LEAST_CONTRAST
        texture_there = quiet_texture.at_points(coarse_points)
        least_steps = 0.6 * shares * criteria.LEAST_CONTRAST * texture_there
        # A place that is weaker than the least contrast stands out from a quiet part alone: there
        # the texture around is no measure.
        least_contrasts = np.where(shares < 1.0, 0.0, least_contrast)
        positions = coarse_points + coarse.origin_um
        thresholds = np.stack([least_steps, least_contrasts])
        marks = _measure(raster, positions, sign, radius_range, thresholds)
        # In mottle as strong as the holes are deep, what is left is that their floors are black,
        # flat and alike.
        is_alike = criteria.share_floor(marks, *limits)
        if is_alike.any():
            alike_marks = marks[is_alike]
            sheet = _sheet(coarse, alike_marks)
            marks.is_alike[is_alike] = criteria.is_rare(alike_marks, sign * sheet.image)
        # The sheet's own texture is what is left when everything that looks like a hole is taken
        # out, with its char.
        holes = marks[criteria.is_hole(marks, *limits)]
        texture = candidates.local_deviation(_sheet(coarse, holes), diameter, 0.5)
        marks = marks[np.isfinite(marks.radius)]
        _raise_texture(marks, texture)
        holes = criteria.deepest_disjoint(marks[criteria.is_hole(marks, *limits)])
        is_whole = criteria.is_whole(holes, raster.image.shape, raster.pixel_um)
        holes = criteria.drop_unlike(holes[is_whole], sign)
        detections.append(_Detection(sign, holes, marks, positions, texture, dropped_count))
    return detections


def _sheet(raster: Raster, holes: Marks) -> Raster:
    """Give the image without holes, NaN there; beyond a rim 60 um may be burnt."""
    return candidates.outside(raster, holes.centre - raster.origin_um, holes.radius + 60.0)


def _count_rejected(
    detection: _Detection, holes: Marks, raster: Raster, radius_range: Pair
) -> dict[str, int]:
    """Count by the reasons of `REASONS` what lies on no hole and would be one but for one fault.

    Mottle has several faults.
    """
    marks = detection.marks
    is_whole = criteria.is_whole(marks, raster.image.shape, raster.pixel_um)
    criteria_met = criteria.met_criteria(marks, raster.pixel_um, radius_range)
    criteria_met["not_round"] |= ~is_whole  # a border that cuts a mark takes a part of its rim, too
    criteria_met = {"cut": is_whole} | criteria_met
    met_counts = np.sum([*criteria_met.values()], axis=0)
    is_near_hole = met_counts >= len(criteria_met) - 1
    rejected = np.flatnonzero(is_near_hole & ~criteria.overlaps_any(marks, holes))
    counts = dict.fromkeys(REASONS, 0)
    counts["not_measured"] = detection.dropped_count
    for row in rejected[criteria.best_rims(marks[rejected])].tolist():
        faults = [name for name, is_met in criteria_met.items() if not is_met[row]]
        # What meets all and is no hole was dropped beside the others.
        reason, *_ = *faults, "unlike"
        counts[reason] += 1
    return counts


def _raise_texture(marks: Marks, texture: candidates.LocalLevels) -> None:
    around = texture.at_points(marks.centre)
    marks.texture = np.maximum(marks.texture, around)


def _measure(
    raster: Raster,
    positions: Floats,
    sign: float,
    radius_range: Pair,
    thresholds: Floats,
) -> Marks:
    """Measure places (n, 2), the strongest first, with arguments as for `measure_rims`.

    First those that are far from each other, then the others: what lies well inside a hole that a
    stronger one led to is passed over, and its mark is NaN.
    """
    marks = blank_marks(len(positions))
    all_rows = np.arange(len(positions))
    pairs = criteria.neighbour_pairs(positions, 2 * radius_range[0])
    disjoint = np.asarray(criteria.greedy_disjoint(all_rows, pairs), dtype=np.intp)
    for batch in (disjoint, np.setdiff1d(all_rows, disjoint)):
        with np.errstate(invalid="ignore"):  # nearly all of a smooth round rim
            is_clear = criteria.is_round(marks, raster.pixel_um)
            is_clear &= ~criteria.is_doubtful(marks)
        rows = batch[_is_outside(positions[batch], marks[is_clear], 0.5)]
        search = (radius_range, thresholds[:, rows])
        marks[rows] = measure_rims(raster, positions[rows], sign, *search)
    return marks


def _floors(raster: Raster, detection: _Detection) -> Marks:
    """Measure the floors that are like those of the holes, also where no rim was searched.

    As `measure_floors` gives them: those that lie wholly in the image and differ from the holes as
    little as holes do.
    """
    sign = detection.sign
    holes = detection.holes
    typical = criteria.typical_hole(holes)
    # Greys at which a floor may end: shares of the depth of the holes, the likeliest first.
    depth_shares = np.array([0.2, 0.08, 0.13, 0.27, 0.35])
    floor_ends = (typical.floor_level + depth_shares * typical.depth).tolist()
    level, *_ = floor_ends
    # Once the level of the floors is known, mottle that hid a place from the search hides it no
    # longer.
    dark_spots = candidates.dark_spots(raster, sign, level, typical.radius)
    positions = np.concatenate([detection.positions, dark_spots])
    clear_holes = holes[~criteria.is_doubtful(holes)]
    positions = positions[_is_outside(positions, clear_holes, 1.0)]
    x, y = np.ascontiguousarray(positions.T)
    row_um, col_um = raster.pixel_um
    floor_centres = _rim_kernels.middles_of_floors(
        raster.image, col_um, row_um, x, y, sign, typical.radius, level
    )
    floor_centres = floor_centres[are_known(floor_centres)]
    # Places beside each other lead to one hole.
    neighbours = criteria.neighbour_pairs(floor_centres, 0.1 * typical.radius)
    disjoint = criteria.greedy_disjoint(np.arange(len(floor_centres)), neighbours)
    floor_centres = floor_centres[disjoint]
    floors = measure_floors(raster, floor_centres, sign, typical.radius, floor_ends)
    floors = criteria.select_resembling(floors, holes, raster.pixel_um)
    # A rim lies farther out than its floor.
    rims = floors.copy()
    rims.radius = np.maximum(rims.radius, typical.radius)
    return floors[criteria.is_whole(rims, raster.image.shape, raster.pixel_um)]


def _is_outside(positions: Floats, holes: Marks, radius_share: float) -> Bools:
    """Return which positions (n, 2), in um, lie farther from a centre than a share of its radius.

    The hole is the one with the nearest centre.
    """
    if not len(holes):
        return np.ones(len(positions), bool)
    distances, nearest = KDTree(holes.centre).query(positions)
    return distances > radius_share * holes.radius[nearest]


_COLUMNS = {
    "x": ("um", "Hole centre along the columns"),
    "y": ("um", "Hole centre down the rows"),
    **EXTRAS,
    "contrast": ("1", "Step at the hole over the texture of the sheet around"),
}


def _dataset(holes: Marks, sign: float) -> xr.Dataset:
    """Make the dataset of `find_holes`; its variables are those of ``_COLUMNS``, in their order.

    ``sign`` is 1 for dark holes, -1 for bright ones.
    """
    radius = holes.radius
    half = holes.half_difference
    axis_ratio = (radius + half) / (radius - half)
    # Texture below a thousandth of the step is rounding; it would make the ratio meaningless.
    depths = criteria.depth(holes)
    contrast = -sign * depths / np.maximum(holes.texture, 1e-3 * depths)
    shape = [2 * radius, axis_ratio, holes.coverage, contrast]
    columns = [*holes.centre.T, *holes.covariance.T, *shape]
    out = xr.Dataset(attrs={"polarity": "dark" if sign > 0 else "bright"})
    for (name, (unit, text)), column in zip(_COLUMNS.items(), columns, strict=True):
        out[name] = ("mark", column, {"units": unit, "long_name": text})
    return out


def _grey(image: ArrayLike) -> Image:
    """Take an image as float32 in one piece, NaN where it is not finite; MarkError for no grey.

    The median is taken off real numbers; whole ones and masks stay as they are.
    """
    grey = np.asarray(image)
    if grey.ndim != 2:
        raise MarkError(
            f"The image has shape {grey.shape}; holes are found in one grey channel, (rows,"
            " columns)."
        )
    if grey.dtype.kind not in "biuf":
        raise MarkError(
            f"The image holds {grey.dtype} values; holes are found in real grey values."
        )
    if grey.dtype.kind == "f":
        is_finite = np.isfinite(grey)
        median_grey = 0.0
        if np.any(is_finite):
            median_grey = float(np.median(grey[is_finite], overwrite_input=True))
        # Large offsets would cost float32 its digits.
        grey = np.where(is_finite, grey - median_grey, np.nan)
    return np.ascontiguousarray(grey, dtype=np.float32)
