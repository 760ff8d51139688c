"""Check of the voxel spacing along the axis through the sheet.

It is judged from the marks, and from thickness against slope.
"""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from planish.checks.sheets import MeasuredSheet
from planish.core.checks import Check, CheckRule, State
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.typing import Floats
from planish.flatten import places_when_scaled
from planish.register import FittedTransform, Pairs, ThroughScale, find_through_scale

_UNCERTAIN = 0.15  # standard error from which on nothing can be said
_NATURAL = 0.1  # of a scale from thickness: paper that is thinner where it bends
_BEYOND = 3.0  # errors
_CLEARLY = 9.2  # variances: one explanation is a hundred times as likely as the other
_BLOCKS = 6
_ADVICE = (
    "Check the voxel size along {axis}, and that of the image in both directions. Thicknesses and"
    " places are wrong where it is."
)
_REMEDY = "Give the right one with `voxel_um` and `override_size=True`."


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisteredSheet:
    """A sheet whose marks were registered.

    Its surfaces, where their columns lie in the flat map, and the fit.

    ``is_fixed``: the sheet is what was registered to; ``either``: the other layer is a sheet too,
    so that either may be wrong.
    """

    measured: xr.Dataset
    flat: xr.Dataset
    fit: FittedTransform
    is_fixed: bool = False
    either: bool = False


@dataclass(frozen=True, slots=True)
class SlopeScale:
    """Scale of heights that the thickness asks for, and its standard error.

    Infinite where nothing can be said.
    """

    scale: float
    error: float

    @property
    def excludes_one(self) -> bool:
        """Whether thickness and slope exclude a scale of 1."""
        return self.error <= _UNCERTAIN and abs(self.scale - 1) > _BEYOND * np.hypot(
            self.error, _NATURAL
        )

    def __str__(self) -> str:
        """Scale and error."""
        return f"{self.scale:.2f} ± {self.error:.2f}"


def scale_from_thickness(measured: xr.Dataset) -> SlopeScale:
    """Scale of heights at which the mean thickness does not depend on the slope.

    ``measured`` holds ``centre``, ``thickness``, ``status`` (y, x), in um. Where heights are s
    times what they should be and m is the slope as it is seen, a sheet of thickness T has, along
    the normals as they are seen, t = T / s sqrt((1 + s² m²) / (1 + m²)): T / s where it is flat, T
    where it is steep. So t² (1 + m²) is linear in m², with s² the slope over the intercept. A drift
    of the thickness across the sheet is free; the error comes from leaving out each of 36 blocks of
    the sheet.
    """
    steps = pitch(measured)
    down, across = np.gradient(measured["centre"].values, *steps)
    slope_squared = down**2 + across**2
    response = measured["thickness"].values ** 2 * (1 + slope_squared)
    response = np.where(measured["status"].values == 0, response, np.nan)
    tiles = [max(1, round(80.0 / step)) for step in steps]
    rows, cols = (np.arange(n) // k for n, k in zip(response.shape, tiles, strict=True))
    is_good = np.isfinite(response) & np.isfinite(slope_squared)
    tile_shape = (rows[-1] + 1, cols[-1] + 1)
    n_tiles = tile_shape[0] * tile_shape[1]
    tile_number = (rows[:, None] * tile_shape[1] + cols)[is_good]
    count = np.bincount(tile_number, minlength=n_tiles)
    is_used = count >= 0.5 * tiles[0] * tiles[1]
    if np.count_nonzero(is_used) < 4 * _BLOCKS:
        return SlopeScale(1.0, np.inf)
    sums = (np.bincount(tile_number, k[is_good], n_tiles) for k in (response, slope_squared))
    y, m2 = (of_tiles[is_used] / count[is_used] for of_tiles in sums)
    positions = np.argwhere(is_used.reshape(tile_shape)) / tile_shape
    block = np.floor(positions * _BLOCKS) @ [_BLOCKS, 1]
    drift = positions - positions.mean(axis=0)
    design = np.column_stack([np.ones(y.size), m2, drift])
    scale_squared = _ratio(design, y)
    without_one = (block != k for k in np.unique(block))
    ratios = [_ratio(design[is_left], y[is_left]) for is_left in without_one]
    leave_one_out = np.array(ratios)
    deviations = leave_one_out - leave_one_out.mean()
    spread = np.sqrt((deviations.size - 1) * np.mean(deviations**2))
    if not (np.isfinite(scale_squared) and np.isfinite(spread)):
        return SlopeScale(1.0, np.inf)
    scale = float(np.sqrt(max(scale_squared, 0.0)))
    return SlopeScale(scale, float(spread / (2 * max(scale, 0.25))))


def scale_by_thickness(rule: CheckRule, sheet: MeasuredSheet | RegisteredSheet) -> Check:
    """Judge a sheet without marks: gross errors of the spacing along the axis through it."""
    slope = scale_from_thickness(sheet.measured)
    axis, stated_um = _spacing(sheet)
    if slope.error > _UNCERTAIN:
        return rule.check(
            "unknown",
            value=slope.scale if np.isfinite(slope.error) else None,
            sentence=(
                "The sheet is too flat, or its thickness too uneven, to say from it whether the"
                f" voxel spacing of {stated_um:.4g} um along {axis} is right; marks can say more."
            ),
        )
    state: State = "look" if slope.excludes_one else "pass"
    sentence = (
        f"The thickness depends on the slope as if the voxel spacing along {axis} were {slope}"
        f" times the stated one of {stated_um:.4g} um."
    )
    error = float(np.hypot(slope.error, _NATURAL))
    return _judged(rule, axis, state, sentence, slope.scale, error)


def scale_by_marks(rule: CheckRule, sheet: RegisteredSheet) -> Check:
    """Judge a sheet by the marks of its registration."""
    marks = estimate(sheet)
    if marks is None:
        return scale_by_thickness(rule, sheet)
    return judge_marks(rule, sheet, marks, scale_from_thickness(sheet.measured))


def judge_marks(
    rule: CheckRule, sheet: RegisteredSheet, marks: ThroughScale, slope: SlopeScale
) -> Check:
    """Say what marks and thickness mean for the spacing along the axis through a sheet.

    Marks that are too uncertain leave it to the thickness, if that is surer. A scale beside 1 by
    more than its errors is a fault where nothing else explains it as well.
    """
    axis, stated_um = _spacing(sheet)
    # The centre surface is smoothed, and which surface is neutral is not known.
    scale_error = float(np.hypot(marks.error, 0.01))
    is_off = marks.excludes_one and abs(marks.scale - 1) > _BEYOND * scale_error
    if not is_off and scale_error > _UNCERTAIN:
        if slope.error <= _UNCERTAIN:
            return scale_by_thickness(rule, sheet)
        times_text = f"{marks.scale:.2g} ± {scale_error:.2g}" if np.isfinite(marks.error) else "any"
        return rule.check(
            "unknown",
            value=marks.scale,
            sentence=(
                f"The sheet is too flat, or its {marks.marks} marks too few or too uncertain, to"
                f" say whether the voxel spacing of {stated_um:.4g} um along {axis} is right: they"
                f" agree with {times_text} times that."
            ),
        )
    sentence = (
        f"The marks imply a voxel spacing along {axis} that is {marks.scale:.3g} ±"
        f" {scale_error:.2g} times the stated one: {marks.scale * stated_um:.3g} um for"
        f" {stated_um:.4g}."
    )
    state: State = "pass"
    if is_off:
        state, explanation = _explained(marks, slope)
        sentence += explanation
        if sheet.either:
            state = "look"
            sentence += " The other sheet's may be wrong as well."
    return _judged(rule, axis, state, sentence, marks.scale, scale_error)


def _judged(
    rule: CheckRule, axis: str, state: State, sentence: str, scale: float, error: float
) -> Check:
    """Make the check of a scale with its error; what to do where the spacing is not right."""
    limit = 1 + float(np.copysign(_BEYOND * error, scale - 1))
    check = rule.check(state, sentence, value=scale, limit=limit)
    if state == "pass":
        return check
    return check.model_copy(update={"advice": _ADVICE.format(axis=axis), "remedy": _REMEDY})


def _explained(marks: ThroughScale, slope: SlopeScale) -> tuple[State, str]:
    """Whether it is the spacing or a stretch along the slope, and what speaks for it.

    A state and the end of a sentence. Evidence is in variances, as of `ThroughScale`.
    """
    error = np.hypot(slope.error, max(marks.error, _NATURAL))
    do_agree = abs(slope.scale - marks.scale) < _BEYOND * error
    if slope.excludes_one and do_agree:
        return "fail", f" Thickness against slope implies the same ({slope})."
    # Paper does not strain by more than 1 %, and pixels that are not square are seldom: that counts
    # ten to one.
    is_clear = marks.over_stretch > (_CLEARLY / 2 if marks.stretch > 0.01 else _CLEARLY)
    if is_clear and marks.without_any > _CLEARLY / 2:
        return "fail", " A stretch of the sheet explains it less well."
    than_text = "better" if marks.over_stretch < -_CLEARLY else "as well"
    return (
        "look",
        f" But a stretch by {100 * marks.stretch:.2g} % along {marks.stretch_deg:.0f}° of the flat"
        f" map explains it {than_text}, as pixels that are not square make it.",
    )


def estimate(sheet: RegisteredSheet) -> ThroughScale | None:
    """Scale of a sheet's heights that the marks of a registration ask for.

    None where they are too few.
    """
    fit = sheet.fit
    pairs = Pairs(moving=fit.moving, fixed=fit.fixed, information=fit.information)
    if sheet.is_fixed:
        information = fit.weights[:, None, None] * np.eye(2)
        pairs = Pairs(moving=fit.fixed, fixed=fit.moving, information=information)
    scales, places = places_when_scaled(sheet.measured, sheet.flat, pairs.moving)
    return find_through_scale(scales, places, pairs, mirrored=fit.mirrored)


def _spacing(sheet: MeasuredSheet | RegisteredSheet) -> tuple[str, float]:
    axis = Frame.of(sheet.measured).through
    return axis, float(sheet.measured.attrs["voxel_um"]["zyx".index(axis)])


def _ratio(design: Floats, response: Floats) -> float:
    """Slope over intercept of a regression; the first two columns of the design."""
    coefficients, *_ = np.linalg.lstsq(design, response, rcond=None)
    intercept, slope = coefficients[:2]
    return float(slope / intercept)
