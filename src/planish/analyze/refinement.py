"""A registration refined by the maps themselves.

Also what may be reported of a correlation that was tuned so.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy import ndimage

from planish.analyze.correlation import correlate, pearson, valid_pixels
from planish.analyze.differences import paired_difference
from planish.analyze.distributions import largest_tail
from planish.core.arrays import check_numbers
from planish.core.errors import CannotMeasure
from planish.core.facts import NULL, DescribedModel, Interval, Value, is_known
from planish.core.grid import Grid
from planish.core.transform import Similarity
from planish.core.typing import Bools, Floats, Ints, Pair, Texts, pair_of
from planish.register import Chain, FittedTransform, Refined, RefineOptions, refine
from planish.register.by_texture.place import tuned_place
from planish.register.by_texture.rotations import BAND_UM
from planish.register.refinement import Refinement
from planish.texture.detrend import PhaseSurrogate, Plane, correlation_length_um, in_band
from planish.texture.textures import textures

Tune = Callable[[Floats, Bools], Floats]
"""From map a and the pixels that may be looked at to map b on a's grid, placed so that it fits best
there.

It must look at a at these pixels only; NaN is missing in what it returns.
"""

_TUNED_UM = 10.0  # by which a place found by texture may be off at the corners of the map
_SURROGATES = 19  # unrelated maps that are searched; fewer have no 95 % band
_INVERSE_STEPS = 8  # each is off by the strain of the refinement times the one before
# Slower variations are taken off both maps: they make tiles and guards as large as they are.
_COARSEST_UM = 1000.0


class RegistrationBasis(StrEnum):
    """How the maps of a correlation were registered; stands beside every r."""

    MARKS = "marks only"
    CROSS_FITTED = "refined (cross-fitted)"
    SEARCHED_NULL = "refined (searched null)"

    @property
    def sentence(self) -> str:
        """The words for a report."""
        return f"registration: {self.value}"


class RefinementR(DescribedModel):
    """r after a refinement that did not maximise it, or beside what a search reaches by chance."""

    r: Value
    """Pearson's correlation."""
    interval: Interval = NULL
    """95 % interval of r."""
    n_eff: Value = NULL
    """Independent points."""
    r_of_marks: Value = NULL
    """By the marks alone, over the same pixels."""
    gain_interval: Interval = NULL
    """95 % interval of r - r_of_marks."""
    registration: str
    """What r rests on: cross-fitted, or beside a search of unrelated maps."""
    sentence: str
    """The same in words."""
    n: int | None = None
    """Pixels that are reported on."""
    tile_um: Value = NULL
    """Side of the tiles of the checkerboard."""
    guard_um: Value = NULL
    """Distance kept from the pixels that were tuned on."""
    null_95: Value = NULL
    """|r| that the search reaches on 95 % of unrelated maps."""
    p: Value = NULL
    """Share of unrelated maps that reach this r."""
    surrogates: int | None = None
    """Unrelated maps that were searched."""


def cross_fitted(
    a: Floats,
    b: Floats,
    tune: Tune,
    *,
    valid: Bools | None = None,
    pixel_um: Pair,
) -> RefinementR:
    """Tune the registration on every other tile, correlate on the rest, and vice versa.

    What is reported keeps a guard of 2 correlation lengths of the coarser map (1/e) from what was
    tuned on. Tiles are 6 guards wide, or 4 where that gives too few.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
        Map a, and map b as the marks alone place it. NaN is missing.
    tune : callable; ``tune(a, look)`` returns map b placed as it fits a best at the pixels ``look``
    valid : ndarray of bool, shape (rows, cols), or None; pixels that may be looked at
    pixel_um : (float, float), along y and x

    Returns
    -------
    RefinementR
        r of the tiles that the registration was not tuned on: both halves together, each about its
        own means.

    Raises
    ------
    CannotMeasure
        If a map is correlated over all of the field, or fewer than 4 tiles of either colour are
        left to report on.
    """
    is_valid = valid_pixels(a, b, pixel_um, valid)[0]
    plane = Plane(is_valid)
    flat_maps = [plane.taken_off(m) for m in (a, b)]
    length = max(correlation_length_um(m, is_valid, pixel_um) for m in flat_maps)
    guard = 2 * length
    if not math.isfinite(guard):
        raise CannotMeasure(
            f"The guard between tiles is {guard:.3g} um, but the maps are correlated over"
            f" {length:.3g} um: tiles would not be independent. Take a guard of at least that"
            " length, or take the slow variations off the maps first."
        )
    side, tuned_masks, report_masks = _checkerboard(is_valid, pixel_um, guard)
    # Map a, map b as tuned, and map b by the marks, at the pixels that are reported on.
    centred = np.full((3, *a.shape), np.nan)
    for is_tuned, is_reported in zip(tuned_masks, report_masks, strict=True):
        tuned_b = tune(np.where(is_tuned, a, np.nan), is_tuned)
        is_used = is_reported & np.isfinite(tuned_b)
        for out, values in zip(centred, (a, tuned_b, b), strict=True):
            used_values = values[is_used]
            out[is_used] = used_values - used_values.mean()
    a_centred, refined_centred, marks_centred = centred
    refined_pair = (a_centred, refined_centred)
    row = correlate(*refined_pair, pixel_um=pixel_um)
    gain = paired_difference((a_centred, marks_centred), refined_pair, pixel_um=pixel_um)
    limits = change = ""
    if is_known(row.interval):
        low, high = row.interval
        limits = f" (95 %: {low:.2f} to {high:.2f})"
    if gain.distinguishable:
        low, high = gain.interval
        change = f", from which it differs by {low:.3f} to {high:.3f}"
    elif gain.distinguishable is not None:
        change = ", which is not distinguishable from it"
    basis = RegistrationBasis.CROSS_FITTED
    return RefinementR(
        registration=basis,
        r=row.r,
        interval=row.interval,
        n_eff=row.n_eff,
        r_of_marks=gain.r[0],
        gain_interval=gain.interval,
        n=row.n,
        tile_um=side,
        guard_um=guard,
        sentence=(
            f"r = {row.r:.2f}{limits}; the marks alone give {gain.r[0]:.2f} there{change};"
            f" {basis.sentence}"
        ),
    )


def _checkerboard(
    is_valid: Bools, pixel_um: Pair, guard_um: float
) -> tuple[float, list[Bools], list[Bools]]:
    """Side of the tiles, the pixels of either colour, and those that each leaves to report on.

    What is tuned on one colour is reported on the other, farther than the guard from the first one.
    CannotMeasure where fewer than 4 tiles of a colour, or 100 pixels, would be left.
    """
    shape = is_valid.shape
    sides_um = (6 * guard_um, 4 * guard_um)
    for side in sides_um:
        # Of every row and column; a rest at the border goes half to either side.
        tile_numbers: list[Ints] = []
        for n, pitch in zip(shape, pixel_um, strict=True):
            length_um = n * pitch
            n_whole = max(int(length_um / side), 1)
            edge_um = 0.5 * (length_um - n_whole * side)
            middles_um = (np.arange(n) + 0.5) * pitch
            numbers = np.floor((middles_um - edge_um) / side)
            tile_numbers.append(numbers.astype(np.intp))
        tile_row = tile_numbers[0][:, None]
        tile_col = tile_numbers[1]
        colour = (tile_row + tile_col) % 2
        tuned = [is_valid & (colour == k) for k in (0, 1)]
        away_um = [ndimage.distance_transform_edt(~m, sampling=pixel_um) for m in tuned]
        reported = [tuned[1 - k] & (away_um[k] > guard_um) for k in (0, 1)]
        tile_ids = tile_row * shape[1] + tile_col
        tile_counts = [np.unique(tile_ids[m]).size for m in reported]
        if min(tile_counts) >= 4 and min(map(np.sum, reported)) >= 100:
            return side, tuned, reported
    raise CannotMeasure(
        f"Tiles of {sides_um[-1]:.3g} um with a guard of {guard_um:.3g} um leave fewer than 4 of"
        " either colour to report on: the map is too small for its texture. Report the marks-only"
        " correlation, or the refined one with a searched null."
    )


def searched_null(a: Floats, tune: Tune, *, valid: Bools | None = None) -> RefinementR:
    """Tune the registration on all of the map, and on 19 unrelated maps with its texture.

    Parameters
    ----------
    a : ndarray, shape (rows, cols); NaN is missing
    tune : callable; ``tune(a, look)`` returns map b placed as it fits a best at the pixels ``look``
    valid : ndarray of bool, shape (rows, cols), or None

    Returns
    -------
    RefinementR
        r is too large. p is the chance that the search reaches ``|r|`` on an unrelated map, from a
        Gumbel distribution fitted to what it reaches on them, and never below half of one over
        their number squared.
    """
    check_numbers(a, "a")
    is_valid = np.isfinite(a)
    if valid is not None:
        check_numbers(valid, "valid", kinds="b")
        is_valid &= valid
    flat = Plane(is_valid).taken_off(a)
    rng = np.random.default_rng(20090502)

    def searched(candidate: Floats) -> float:
        """Give r of a map, or of one like it, with map b placed so that it fits that one best."""
        a_known = np.where(is_valid, candidate, np.nan)
        return pearson(a_known, tune(a_known, is_valid))

    r = searched(flat)
    surrogates = PhaseSurrogate(flat, is_valid).draws(_SURROGATES, rng)
    null = [abs(searched(surrogate)) for surrogate in surrogates]
    sizes = np.minimum([abs(r), *null], 1 - 1e-12)
    z, *null_z = np.arctanh(sizes)
    tail_share = largest_tail(np.array(null_z), z)
    # A tail is not known further than half of one over their number squared.
    p = max(tail_share, 0.5 / _SURROGATES**2)
    null_95 = np.quantile(null, 0.95, method="higher")
    basis = RegistrationBasis.SEARCHED_NULL
    return RefinementR(
        registration=basis,
        r=r,
        null_95=null_95,
        p=p,
        surrogates=_SURROGATES,
        sentence=(
            f"r = {r:.2f} after the search, which reaches {null_95:.2f} on unrelated maps (95 %; p"
            f" = {p:.2g}); {basis.sentence}"
        ),
    )


class RefinementFacts(DescribedModel):
    """A registration refined by the maps themselves."""

    model: str
    """affine or bspline."""
    metric: str
    """What was made as large as possible."""
    property: str
    """The map that was refined."""
    moved_rms_um: float
    """Displacement, rms over the pixels."""
    moved_most_um: float
    """Largest displacement."""
    share_of_expected_error: float
    """Largest ratio of displacement to expected error."""
    area: tuple[float, ...]
    """Least and largest local change of area."""
    strain: float
    """Largest local strain, without its sign."""
    warnings: Texts
    """What to be careful about."""
    sentence: str
    """The same in words."""
    longest_wave_um: float
    """Longer waves were taken off both maps first."""
    correlation: RefinementR
    """r that the refinement did not maximise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RefinedTransform:
    """The transformation of the marks, followed by its refinement by the maps."""

    marks: Chain
    refined: Refined

    def __call__(self, points: ArrayLike) -> Floats:
        """Take points ``(..., 2)`` of the sheet to the reference, in um."""
        return self.refined(self.marks(points))

    def inverse(self, points: ArrayLike) -> Floats:
        """Take points ``(..., 2)`` of the reference back to the sheet, in um."""
        sought_um = np.asarray(points, dtype=np.float64)
        marked_um = sought_um
        for _ in range(_INVERSE_STEPS):
            marked_um = marked_um + sought_um - self.refined(marked_um)
        return self.marks.inverse(marked_um)

    @property
    def similarity(self) -> Similarity:
        """That of the marks: the refinement is close to the identity."""
        return self.marks.similarity


def refine_link(
    a: xr.DataArray,
    b: xr.DataArray,
    valid: Bools,
    grid: Grid,
    fit: FittedTransform,
    model: Refinement,
    unit_um: float,
) -> tuple[RefinedTransform, RefinementFacts]:
    """Refine a link by the maps of two layers on one grid, and correlate without the bias of that.

    Waves and mesh are those of paper in the unit of both layers.

    What the refinement changed stands beside r over tiles that it has not seen; where the map is
    too small for such tiles, beside r after the search and what the search reaches on unrelated
    maps. CannotRegister where SimpleITK is missing, or the refinement folds the map or leaves what
    the marks allow.
    """
    pixel = grid.pixel_um
    options = RefineOptions(model=model)
    options = replace(options, grid_um=unit_um * options.grid_um)
    coarsest_um = unit_um * _COARSEST_UM
    moving = _detail(a.values, valid, pixel, coarsest_um)
    fixed = _detail(b.values, valid, pixel, coarsest_um)
    fine = refine(moving, fixed, valid, pixel_um=pixel, fit=fit, options=options)

    unbounded = replace(options, bounded=False)

    def tune(other: Floats, look: Bools) -> Floats:
        tuned = refine(other, fixed, look, pixel_um=pixel, fit=fit, options=unbounded)
        return tuned.image_at(fixed, pixel)

    try:
        of_r = cross_fitted(moving, fixed, tune, valid=valid, pixel_um=pixel)
    except CannotMeasure:
        of_r = searched_null(moving, tune, valid=valid)
    moved_rms_um, moved_most_um = fine.moved_um
    facts = RefinementFacts(
        model=fine.model,
        metric=fine.metric,
        property=str(a.name),
        moved_rms_um=moved_rms_um,
        moved_most_um=moved_most_um,
        share_of_expected_error=fine.share,
        area=fine.area,
        strain=fine.strain,
        warnings=fine.warnings,
        sentence=fine.sentence,
        longest_wave_um=coarsest_um,
        correlation=of_r,
    )
    return RefinedTransform(marks=Chain(fits=(fit,)), refined=fine), facts


def held_out_r(
    a: Floats, b: Floats, face: Floats | None, valid: Bools, pixel_um: Pair, unit_um: float = 1.0
) -> RefinementR:
    """Correlate a map with an image (rows, cols) where their place was not tuned on them.

    The place was found by their texture.

    ``a`` is a map of the sheet and ``b`` the image, both where their place put them, in pixels of
    ``pixel_um`` along y and x; ``valid`` are the pixels that count. A similarity is tuned on every
    other tile and r read off the rest; where the map is too small for that, r stands beside what
    the same tuning reaches on unrelated maps. The slopes of ``face``, heights in um, take up
    one-sided light; None where the sheet has none. Waves and reach are those of paper in
    ``unit_um``.
    """
    coarsest_um = unit_um * _COARSEST_UM
    a = _detail(a, valid, pixel_um, coarsest_um)
    b = _detail(b, valid, pixel_um, coarsest_um)
    is_known = valid & np.isfinite(b)
    pixel = pair_of(np.divide(pixel_um, unit_um))
    fixed = textures({"image": b}, is_known, pixel, band_um=BAND_UM)
    rows, cols = np.indices(b.shape)
    points = np.stack([cols * pixel[1], rows * pixel[0]], axis=-1)  # (x, y) of each pixel
    # A linear interpolation would take noise off the image, and raise r by that alone.
    filtered = ndimage.spline_filter(np.where(is_known, b, 0.0))
    spline = np.asarray(filtered, dtype=np.float64)
    step = np.array(pixel)
    b_known = is_known.astype(np.float64)

    def tune(other: Floats, look: Bools) -> Floats:
        """Place the image so that it fits a map best at the pixels ``look``; NaN where it ends.

        A place is off by 10 um at most; the slopes of the face follow the map.
        """
        maps = {"map": other}
        light = ()
        if face is not None:
            maps["face"] = face
            light = ("face_x", "face_y")
        # What both maps hold in the band of waves by which places are searched.
        moving = textures(maps, look & np.isfinite(other), pixel, band_um=BAND_UM)
        if face is not None:
            moving = moving.with_slopes("face")
        place = tuned_place(
            moving, fixed, ("map", "image"), Similarity(), reach_um=_TUNED_UM, other_maps=light
        )
        rows_and_cols = place(points)[..., ::-1] / step
        places_px = np.moveaxis(rows_and_cols, -1, 0)
        is_inside = ndimage.map_coordinates(b_known, places_px, order=1) >= 0.99
        placed = ndimage.map_coordinates(spline, places_px, order=3, prefilter=False)
        return np.where(is_inside, placed, np.nan)

    # Within a sentence, or at its beginning: its first letter is put before it.
    waves_text = f"ithout waves above {coarsest_um / 1000:g} mm, "
    try:
        of_r = cross_fitted(a, b, tune, valid=valid, pixel_um=pixel_um)
        text = (
            "On held-out tiles, which had no part in the place,"
            f" w{waves_text}{of_r.sentence.split(';')[0]}."
        )
    except CannotMeasure:
        of_r = searched_null(a, tune, valid=valid)
        text = f"W{waves_text}{of_r.sentence.rsplit(';', 1)[0]}."
    return of_r.model_copy(update={"sentence": text})


def _detail(values: Floats, valid: Bools, pixel_um: Pair, longest_um: float) -> Floats:
    """A map without its slow variations; NaN where it is not valid."""
    is_valid = valid & np.isfinite(values)
    detail = in_band(values.astype(np.float64), is_valid, pixel_um, (None, longest_um))
    return np.where(is_valid, detail, np.nan)
