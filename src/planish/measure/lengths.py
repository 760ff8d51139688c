"""What the faces show: depth of ink, thicknesses, topography, base surface, roughness.

And the warp of the sheet.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

import numpy as np
from pydantic import model_validator

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option
from planish.core.robust import masked_gaussian
from planish.core.typing import Codes, Floats, Pair, ThreeFields
from planish.measure.greys import Greys
from planish.measure.options import Common
from planish.measure.registry import (
    PROPERTIES,
    SIDES,
    Measured,
    Sheet,
    Side,
    cached,
    face_length,
    ray_property,
    sheet_property,
)

if TYPE_CHECKING:
    from planish.measure.rays import Rays


class InkOptions(Params):
    """Options of the penetration of ink."""

    ink_grey: Pair | None = option(
        None, metavar="LOW,HIGH", help="Grey range of ink, for the depth to which it penetrates."
    )
    ink_reach_um: float | None = option(
        None,
        gt=0,
        cli=None,
        help="Depth below the top face to which ink is looked for; half the sheet where not given.",
    )

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if self.ink_grey is not None and not self.ink_grey[0] < self.ink_grey[1]:
            raise ValueError(
                f"ink_grey runs from {self.ink_grey[0]:g} to {self.ink_grey[1]:g}; give the smaller"
                " first"
            )
        return self


REASONS = ("no_ink", "ink_reaches_limit")
NO_INK, AT_LIMIT = 1, 2
_INK_SHARES = {
    50: "Depth of half the ink",
    90: "Depth of 90 % of the ink",
    95: "Depth of 95 % of the ink",
}


def _check_ink(params: InkOptions, _greys: Greys) -> None:
    if params.ink_grey is None:
        raise CannotMeasure(
            "The depth of ink needs the grey values that are ink. Read them from a printed and an"
            " unprinted spot, and give their range as ink_grey = [low, high] in [properties] of a"
            " study file."
        )


@cached
def _depths(rays: Rays) -> tuple[Floats, Floats, Codes]:
    """Depths of 50, 90 and 95 % of the ink (3, rows, cols), their standard error, and reasons.

    All in um below the top face, along the ray; NaN where there is a reason: NO_INK, or AT_LIMIT
    where ink goes on below the depth to which it is looked for. 0 is no reason.
    """
    from planish.measure import _ray_kernels

    options = rays.params.of(InkOptions)
    assert options.ink_grey is not None
    low, high = options.ink_grey
    if options.ink_reach_um is None:
        limit = 0.5 * (rays.top + rays.bottom)
    else:
        limit = np.maximum(rays.top - options.ink_reach_um, rays.bottom)
    step_um = rays.step_um
    shares = np.array(list(_INK_SHARES)) / 100
    layer = (rays.top, limit)
    depth, total = _ray_kernels.depths_of_shares(*rays.profiles, *layer, low, high, shares)
    # Ink that is still there where the search ends may go deeper: its shares are not known.
    near, _ = rays.length(limit, limit + step_um, least=low, most=high)
    reason = np.zeros(total.shape, np.uint8)
    reason[near > 0.5 * step_um] = AT_LIMIT
    reason[total < rays.voxel_um] = NO_INK
    se = np.sqrt(2.0) * rays.crossing_se(0.5 * (high - low))
    return np.where(reason == 0, depth, np.nan), se, reason


for _which, (_share, _title) in enumerate(_INK_SHARES.items()):

    @ray_property(
        f"ink_depth_{_share}",
        units="um",
        long_name=_title,
        reasons=REASONS,
        check=_check_ink,
        when=lambda params, _greys: params.ink_grey is not None,
    )
    def depth(rays: Rays, which: int = _which) -> Measured:
        """P-12: depth below the top face that holds 50, 90 or 95 % of the length of ink on the ray.

        Ink is what lies in the grey range ``ink_grey``, from the face down to ``ink_reach_um``.
        Missing values are censored, not zero: where there is no ink (less than a voxel), and where
        ink reaches the limit of the search. Colour that bleeds below a cut surface and dye taken up
        by the resin look like ink. SE: the face's and one crossing's with the contrast of half the
        ink's range.
        """
        depths, se, reason = _depths(rays)
        return Measured(values=depths[which], se=se, reason=reason)


class ThicknessOptions(Params):
    """Options of thicknesses along the ray and between envelopes."""

    gap_um: float = option(
        6.0, ge=0, cli=None, help="A gap in the coating that is shorter does not end the layer."
    )
    envelope_radius_um: float = option(
        250.0,
        gt=0,
        cli=None,
        help="Radius of the ball that rolls over both faces, for thickness_envelope.",
    )


def thickness_se(sheet: Sheet, name: str) -> Floats:
    """Standard errors of a thickness, or of the height of a face, along the sheet's rays.

    (rows, cols) in um. ``name``: of its map, as of
    :func:`~planish.measure.uncertainty.thickness_errors`, whose errors are those along normals.
    """
    from planish.measure.rays import secant
    from planish.measure.uncertainty import SharedNoise, thickness_errors

    f = sheet.frame
    shared_noise = SharedNoise.of(
        f.greys,
        voxel_um=f.voxel_um,
        pitch_um=f.pitch_um,
        column_px=f.column_px,
        noise_um=f.noise_um,
    )
    slope = f.slopes()
    # A vertical distance is longer than a normal one, and so is its error.
    oblique = f.oblique(slope)
    coatings_um: dict[Side, Floats] = {}
    for side in SIDES:
        coatings_um[side] = face_length(f.faces, f"coating_{side}") / oblique
    errors = thickness_errors(coatings_um, f.greys, shared_noise, cosine=1 / secant(slope))
    return errors[name] * oblique


def _has_coating(_params: Common, greys: Greys, side: Side) -> None:
    greys.need_coating(side, f"Coating thickness, {side} side,")


@sheet_property(
    "coating_{side}", units="um", long_name=PROPERTIES["coating_top"].replace("top", "{side}")
)
def coating(sheet: Sheet, side: Side) -> Measured:
    """P-01: face to interface; 0 is possible.

    SE from the Fisher matrix of the fitted staircase (thickness_errors).
    """
    if sheet.frame.greys.coated(side):
        return _between_faces(sheet, f"coating_{side}")
    return Measured(values=np.full(sheet.frame.status.shape, np.nan))


def _between_faces(sheet: Sheet, name: str) -> Measured:
    length_um = face_length(sheet.frame.faces, name)
    return Measured(values=length_um, se=thickness_se(sheet, name))


def _needs_both_coatings(_params: Common, greys: Greys) -> None:
    for side in SIDES:
        greys.need_coating(side, "The difference of both coatings")


def difference(sheet: Sheet, name: str) -> Measured:
    """Top less bottom of a property; SE: the root of the summed squares of both."""
    top = sheet.maps[f"{name}_top"]
    bottom = sheet.maps[f"{name}_bottom"]
    se = np.hypot(top.se, bottom.se)
    return Measured(values=top.values - bottom.values, se=se)


@sheet_property(
    "coating_difference",
    units="um",
    long_name="Coating, top less bottom",
    check=_needs_both_coatings,
    after=("coating_top", "coating_bottom"),
    has_true_zero=False,
)
def coating_difference(sheet: Sheet) -> Measured:
    """P-14: coating of the top less that of the bottom on the same ray.

    t_T - t_B; SE: the root of the summed squares of both.
    """
    return difference(sheet, "coating")


@sheet_property("base_thickness", units="um", long_name=PROPERTIES["base_thickness"])
def base_thickness(sheet: Sheet) -> Measured:
    """P-04: from interface to interface along the ray, s_TI - s_BI.

    SE: the root of the summed squares of both interfaces'.
    """
    return _between_faces(sheet, "base_thickness")


@sheet_property("thickness", units="um", long_name=PROPERTIES["thickness"])
def thickness(sheet: Sheet) -> Measured:
    """P-05: from face to face along the ray, s_T - s_B.

    SE: the root of the summed squares of both faces'.
    """
    return _between_faces(sheet, "thickness")


@sheet_property(
    "thickness_envelope",
    units="um",
    long_name="Sheet thickness between rolling balls",
    support_um=lambda params: 2 * params.envelope_radius_um,
)
def thickness_envelope(sheet: Sheet) -> Measured:
    """P-05: between balls of ``envelope_radius_um`` that roll over both faces.

    They bridge what they cannot enter.

    The ball is taken as the paraboloid x^2 / (2 R), which it is to H / (2 R) of its height at a
    depth H; the places of the faces on the rays are the height field. No standard error: an
    envelope rests on few points.
    """
    from planish.core._envelope_kernels import rolled

    f = sheet.frame
    radius_um = sheet.params.of(ThicknessOptions).envelope_radius_um
    thickness_um = np.zeros(sheet.valid.shape)
    for outward_um in (f.faces["top"], -f.faces["bottom"]):
        face_um = np.where(sheet.valid, outward_um, np.nan)
        thickness_um += rolled(face_um, f.pitch_um, radius_um)
    return Measured(values=thickness_um)


@cached
def _layer(rays: Rays, side: Side) -> ThreeFields:
    """Return t_sum, t_env and the standard error of both of the coating of one side.

    Each (rows, cols) in um of ray: the summed length of coating in the outermost connected layer,
    and the distance from the face to the inner end of that layer; 0 where no layer begins.
    """
    from planish.measure import _ray_kernels
    from planish.measure.uncertainty import face_errors

    greys = rays.greys
    coating_level = greys.coating(side)
    # From the face inwards, as far as the interface of the other side.
    if side == "top":
        path = (rays.top, -1.0)
        limit = rays.interface_bottom
    else:
        path = (rays.bottom, 1.0)
        limit = rays.interface_top
    half_way = 0.5 * (coating_level + greys.base)
    # A thin layer's grey passes half way some blurs below the face, or nowhere.
    reach_um = rays.oblique * (2.5 * greys.blur_um + rays.voxel_um)
    gap_um = rays.params.of(ThicknessOptions).gap_um
    levels = (half_way, greys.polarity)
    summed, envelope, ends = _ray_kernels.layers(
        *rays.profiles, *path, *levels, reach_um, gap_um, limit
    )
    ends_se = rays.crossings_se(ends, coating_level - greys.base)
    return summed, envelope, np.hypot(face_errors(rays, envelope, side), ends_se)


@ray_property(
    "coating_{side}_sum",
    units="um",
    long_name="Coating on the ray, {side} side",
    check=_has_coating,
)
def coating_sum(rays: Rays, side: Side) -> Measured:
    """P-01: summed length of coating in the outermost connected layer.

    By labels (A-16): coating is what lies beyond half way between base and coating. The layer
    begins at the fitted face, whose blurred flank counts, and ends at the first gap longer than
    ``gap_um``. The half-way rule makes a layer thinner than two blurs too thin or loses it;
    ``coating_top`` does not. SE:
    sqrt(SE_face^2 + n (sqrt(2 pi) w sigma / C)^2), n ends of the layer inside, w blur, sigma noise,
    C contrast between coating and base.
    """
    summed, _, se = _layer(rays, side)
    return Measured(values=summed, se=se)


@ray_property(
    "coating_{side}_envelope",
    units="um",
    long_name="Coating with its gaps, {side} side",
    check=_has_coating,
)
def coating_envelope(rays: Rays, side: Side) -> Measured:
    """P-01: from the face to the inner end of the outermost connected layer, gaps included.

    t_env of A-16. SE as :func:`coating_sum`.
    """
    _, envelope, se = _layer(rays, side)
    return Measured(values=envelope, se=se)


_PER_MM = 1000.0


class RoughnessOptions(Params):
    """Options of topography and roughness."""

    form_um: float | None = option(
        None,
        gt=0,
        cli=None,
        help=(
            "Nesting index of the form of a face, above which its topography lies: longer waves are"
            " left out; twice the cut-off of the centre surface where not given."
        ),
    )
    s_filter_um: float = option(
        5.0, gt=0, cli=None, help="S-filter of the roughness: shorter waves are left out."
    )
    l_filter_um: float = option(
        800.0, gt=0, cli=None, help="L-filter of the roughness: longer waves are left out."
    )

    def nesting_um(self, cutoff_um: float) -> float:
        """Nesting index of the form, by the cut-off of the centre surface."""
        return 2 * cutoff_um if self.form_um is None else self.form_um


@sheet_property(
    "half_thickness_{side}", units="um", long_name="Face above the centre surface, {side} side"
)
def half_thickness(sheet: Sheet, side: Side) -> Measured:
    """From the centre surface outwards to the face.

    SE: that of the fitted face.
    """
    return _between_faces(sheet, f"half_thickness_{side}")


@sheet_property(
    "topography_{side}",
    units="um",
    long_name=PROPERTIES["topography_top"].replace("top", "{side}"),
    has_true_zero=False,
)
def topography(sheet: Sheet, side: Side) -> Measured:
    """P-06: outward height of the face above its own form.

    The form is that of :mod:`planish.measure.form`. SE: that of the fitted face; the form, a mean
    of thousands of columns, adds nothing to it.
    """
    return _above_form(sheet, f"topography_{side}", _nesting_um(sheet))


@sheet_property(
    "base_surface_{side}",
    units="um",
    long_name=PROPERTIES["base_surface_top"].replace("top", "{side}"),
    has_true_zero=False,
)
def base_surface(sheet: Sheet, side: Side) -> Measured:
    """P-06: outward height of the interface between coating and base above its own form.

    SE: that of the fitted interface. Nothing on a side without a coating, whose base shows in
    ``topography_{side}``.
    """
    if sheet.frame.greys.coated(side):
        return _above_form(sheet, f"base_surface_{side}", _nesting_um(sheet))
    return Measured(values=np.full(sheet.frame.status.shape, np.nan))


def _nesting_um(sheet: Sheet) -> float:
    return sheet.params.of(RoughnessOptions).nesting_um(sheet.frame.cutoff_um)


def _above_form(sheet: Sheet, name: str, nesting_um: float) -> Measured:
    from planish.measure.form import above_form

    f = sheet.frame
    # Distances along vertical rays are longer than along normals by as much everywhere.
    oblique = f.oblique(f.slopes())
    faces = {face: place_um / oblique for face, place_um in f.faces.items()}
    places = (faces, f.heights["centre"], sheet.valid)
    heights_um = above_form(*places, f.pitch_um, names=(name,), nesting_um=nesting_um)
    return Measured(values=heights_um[name] * oblique, se=thickness_se(sheet, name))


@sheet_property(
    "roughness_{side}",
    units="um",
    long_name="Roughness, {side} side",
    support_um=lambda params: params.s_filter_um,
    has_true_zero=False,
)
def roughness(sheet: Sheet, side: Side) -> Measured:
    """P-06: the face without the waves below ``s_filter_um`` and above ``l_filter_um``.

    See :func:`scale_limited`. SE: the face's, times what the S-filter leaves of white noise, pitch
    / (2 sqrt(pi) sigma) where it is below 1.
    """
    pitch_um = sheet.frame.pitch_um
    options = sheet.params.of(RoughnessOptions)
    check_filters(options.s_filter_um, options.l_filter_um)
    above = _above_form(sheet, f"topography_{side}", options.l_filter_um)
    filter_width_um = 2 * np.sqrt(np.pi) * _sigma(options.s_filter_um)
    axis_shares = np.sqrt(np.divide(pitch_um, filter_width_um))
    noise_share = np.prod(np.minimum(1.0, axis_shares))
    values = without_short(above.values, pitch_um, options.s_filter_um)
    return Measured(values=values, se=above.se * float(noise_share))


def _sigma(cutoff_um: float) -> float:
    # Sqrt(ln 2 / pi): the Gaussian exp(-pi (x / (alpha cutoff))^2) passes its cut-off by half.
    return cutoff_um * 0.4697 / np.sqrt(2 * np.pi)


def check_filters(s_filter_um: float, l_filter_um: float) -> None:
    """Raise CannotMeasure where the S-filter is not the shorter one."""
    if not s_filter_um < l_filter_um:
        raise CannotMeasure(
            f"The S-filter ({s_filter_um:g} um) must be shorter than the L-filter ({l_filter_um:g}"
            " um). Change s_filter_um or l_filter_um."
        )


def smoothed(
    values: Floats, pitch_um: Pair, sigma_um: float, *, least_share: float = 0.3
) -> Floats:
    """Gaussian mean of known values (rows, cols) inside the border, by their weight.

    NaN where less than a share of the filter's weight lies on known values.
    """
    from scipy import ndimage

    sigma = [sigma_um / p for p in pitch_um]
    is_finite = np.isfinite(values)
    total, weight = masked_gaussian(values, is_finite, sigma, truncate=3.5)
    ones = np.ones(values.shape)
    full_weight = ndimage.gaussian_filter(ones, sigma, mode="constant", truncate=3.5)
    return total / np.where(weight > least_share * full_weight, weight, np.nan)


def without_short(height: Floats, pitch_um: Pair, s_filter_um: float) -> Floats:
    """Heights without the waves that are shorter than the S-filter; each known one is kept.

    A filter below two pitches is left out, because the grid has filtered already.
    """
    if s_filter_um < 2 * max(pitch_um):
        return height
    fine = smoothed(height, pitch_um, _sigma(s_filter_um), least_share=0.0)
    return np.where(np.isfinite(height), fine, np.nan)


def scale_limited(
    height: Floats, pitch_um: Pair, *, s_filter_um: float, l_filter_um: float
) -> Floats:
    """Roughness between two filters; no height is lost along the outline.

    Parameters
    ----------
    height : (rows, cols)
        um, outwards, over a plane; NaN where unknown.
    pitch_um : (float, float)
    s_filter_um, l_filter_um : float
        Wavelengths of which half is taken off: shorter ones by the S-filter, a Gaussian mean of
        the known heights, longer ones by the L-filter, the regression of
        :mod:`planish.measure.form`. An S-filter below two pitches is left out, because the grid has
        filtered already.

    Returns
    -------
    (rows, cols)
        um.

    Raises
    ------
    CannotMeasure
        If the filters leave nothing between them.
    """
    from planish.measure.form import above_form

    check_filters(s_filter_um, l_filter_um)
    name = "topography_top"
    sheet = ({"top": height}, np.zeros(height.shape), np.isfinite(height))
    above = above_form(*sheet, pitch_um, names=(name,), nesting_um=l_filter_um)
    return without_short(above[name], pitch_um, s_filter_um)


@sheet_property(
    "half_thickness_difference",
    units="um",
    long_name="Face above the centre surface, top less bottom",
    after=("half_thickness_top", "half_thickness_bottom"),
    has_true_zero=False,
)
def half_thickness_difference(sheet: Sheet) -> Measured:
    """P-14: outward height of the top face less that of the bottom face on the same ray.

    SE as of coatings.

    Both are measured from the centre surface, the smoothed mean of the faces, so that its mean is
    near 0 by construction; what is left is roughness that only one side has, and form below the
    centre surface's cut-off.
    """
    return difference(sheet, "half_thickness")


# Warp, tilt and curvatures (P-07) have no standard error: what matters is a slow drift of the
# stack, which bends the surface as a real warp does and cannot be separated from it by one scan.
# Warp and tilt cost no look at the volume.


@sheet_property(
    "warp",
    units="um",
    long_name="Warp",
    support_um=400.0,
    when=lambda _params, _greys: True,
    has_true_zero=False,
)
def warp(sheet: Sheet) -> Floats:
    """Height of the centre surface above the plane that fits it best, up towards the top.

    (rows, cols) in um. The plane is that of the least squares over the rays that meet both faces.
    """
    height = sheet.frame.heights["centre"]
    rows, cols = height.shape
    row_um, col_um = sheet.frame.pitch_um
    y = np.arange(rows) * row_um
    x = np.arange(cols) * col_um
    middle_y = y - y.mean()
    middle_x = x - x.mean()
    yy, xx = np.meshgrid(middle_y, middle_x, indexing="ij")
    is_finite = np.isfinite(height) & sheet.valid
    terms = np.stack([np.ones_like(yy), yy, xx], axis=-1)
    plane = np.linalg.lstsq(terms[is_finite], height[is_finite])[0]
    offset, by_y, by_x = plane
    return height - (offset + by_y * yy + by_x * xx)


@sheet_property(
    "tilt",
    units="deg",
    long_name="Tilt of the sheet",
    support_um=400.0,
    when=lambda _params, _greys: True,
    has_true_zero=False,
)
def tilt(sheet: Sheet) -> Floats:
    """Angle between the normal and the axis through the sheet."""
    by_y, by_x = np.moveaxis(sheet.frame.slopes(), -1, 0)
    return np.rad2deg(np.arctan(np.hypot(by_y, by_x)))


@sheet_property(
    "mean_curvature",
    units="1/mm",
    long_name="Mean curvature",
    support_um=400.0,
    has_true_zero=False,
)
def mean_curvature(sheet: Sheet) -> Floats:
    """Mean of both principal curvatures, positive where the sheet is a bowl.

    H = ((1 + p^2) t - 2 p q s + (1 + q^2) r) / (2 (1 + p^2 + q^2)^(3/2)), where p, q are the
    slopes, r, s, t the second derivatives of the centre surface's height.
    """
    p, q, r, s, t = _derivatives(sheet)
    numerator = (1 + p * p) * t - 2 * p * q * s + (1 + q * q) * r
    return _PER_MM * numerator / (2 * (1 + p * p + q * q) ** 1.5)


@sheet_property(
    "gaussian_curvature",
    units="1/mm2",
    long_name="Gaussian curvature",
    support_um=400.0,
    has_true_zero=False,
)
def gaussian_curvature(sheet: Sheet) -> Floats:
    """Product of both principal curvatures, 0 where the sheet can be laid flat without strain.

    K = (r t - s^2) / (1 + p^2 + q^2)^2.
    """
    p, q, r, s, t = _derivatives(sheet)
    return _PER_MM**2 * (r * t - s * s) / (1 + p * p + q * q) ** 2


def _derivatives(sheet: Sheet) -> list[Floats]:
    """Slopes p, q and second derivatives r, s, t of the centre surface, (rows, cols) each.

    With z the height, y down the rows and x across the columns, in um: p = dz/dx, q = dz/dy, r =
    d2z/dx2, s = d2z/dxdy, t = d2z/dy2, from the eight neighbours. NaN on the border.
    """
    c = sheet.frame.heights["centre"]
    dy, dx = sheet.frame.pitch_um
    up = c[:-2, 1:-1]
    down = c[2:, 1:-1]
    left = c[1:-1, :-2]
    right = c[1:-1, 2:]
    centre = c[1:-1, 1:-1]
    p = (right - left) / (2 * dx)
    q = (down - up) / (2 * dy)
    r = (right - 2 * centre + left) / dx**2
    above = c[:-2]
    below = c[2:]
    mixed = below[:, 2:] - below[:, :-2] - above[:, 2:] + above[:, :-2]
    s = mixed / (4 * dx * dy)
    t = (down - 2 * centre + up) / dy**2
    return [np.pad(derivative, 1, constant_values=np.nan) for derivative in (p, q, r, s, t)]
