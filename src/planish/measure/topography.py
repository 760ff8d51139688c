"""Topography of the faces, their roughness between two filters, and the warp of the centre surface."""

from __future__ import annotations

import numpy as np

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option
from planish.core.typing import Floats
from planish.measure.registry import PROPERTIES, Measured, Sheet, Side, sheet_property
from planish.measure.thickness import difference, errors

_ALPHA = 0.4697  # sqrt(ln 2 / pi): the Gaussian exp(-pi (x / (alpha cutoff))^2) passes its cut-off by half
_PER_MM = 1000.0
_LEAST_WEIGHT = 0.3  # of the filter's weight that must lie on known values


class Options(Params):
    """Options of the roughness."""

    s_filter_um: float = option(5.0, gt=0, cli=None, help="S-filter of the roughness: shorter waves are left out.")
    l_filter_um: float = option(800.0, gt=0, cli=None, help="L-filter of the roughness: longer waves are left out.")


@sheet_property("topography_{side}", units="um", long_name=PROPERTIES["topography_top"].replace("top", "{side}"))
def topography(sheet: Sheet, side: Side) -> Measured:
    """P-06: from the centre surface outwards to the face; SE: that of the fitted face."""
    sign = 1.0 if side == "top" else -1.0
    return Measured(values=sign * sheet.frame.faces[side], se=errors(sheet, f"topography_{side}"))


@sheet_property("roughness_{side}", units="um", long_name="Roughness, {side} side",
                support_um=lambda params: params.s_filter_um)  # fmt: skip
def roughness(sheet: Sheet, side: Side) -> Measured:
    """P-06: the topography between S-filter and L-filter; see :func:`scale_limited`.

    SE: the face's, times what the S-filter leaves of white noise, pitch / (2 sqrt(pi) sigma) where it is below 1.
    """
    f, p = sheet.frame, sheet.params
    sign = 1.0 if side == "top" else -1.0
    height = np.where(sheet.valid, sign * f.faces[side], np.nan)
    limited = scale_limited(height, f.pitch_um, s_filter_um=p.s_filter_um, l_filter_um=p.l_filter_um)
    sigma = _sigma(p.s_filter_um)
    noise_share = np.prod([min(1.0, np.sqrt(q / (2 * np.sqrt(np.pi) * sigma))) for q in f.pitch_um])
    return Measured(values=limited, se=errors(sheet, f"topography_{side}") * float(noise_share))


def _sigma(cutoff_um: float) -> float:
    return cutoff_um * _ALPHA / np.sqrt(2 * np.pi)


def smoothed(values: Floats, pitch_um: tuple[float, float], sigma_um: float) -> Floats:
    """Gaussian mean of the known values (rows, cols); NaN where too few lie in reach.

    The filter is normalised by the weight of what is known, and does not look beyond the border.
    """
    from scipy import ndimage

    sigma = [sigma_um / p for p in pitch_um]
    is_finite = np.isfinite(values)
    total = ndimage.gaussian_filter(np.where(is_finite, values, 0.0), sigma, mode="constant", truncate=3.5)
    weight = ndimage.gaussian_filter(is_finite.astype(np.float64), sigma, mode="constant", truncate=3.5)
    full = ndimage.gaussian_filter(np.ones(values.shape), sigma, mode="constant", truncate=3.5)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(weight > _LEAST_WEIGHT * full, total / weight, np.nan)


def scale_limited(
    height: Floats, pitch_um: tuple[float, float], *, s_filter_um: float, l_filter_um: float
) -> Floats:  # fmt: skip
    """Roughness between two Gaussian filters; half of the longer cut-off is discarded along the outline.

    Parameters
    ----------
    height : (rows, cols)
        um, outwards; NaN where unknown. The form is gone: heights are those above the centre surface.
    pitch_um : (float, float)
    s_filter_um, l_filter_um : float
        Wavelengths of which half is taken off: shorter ones by the S-filter, longer ones by the L-filter. An S-filter
        below two pitches is left out, because the grid has filtered already.

    Returns
    -------
    (rows, cols)
        um.

    Raises
    ------
    CannotMeasure
        If the field is no wider than the longer cut-off, or the filters leave nothing between them.
    """
    from scipy import ndimage

    if not s_filter_um < l_filter_um:
        raise CannotMeasure(
            f"The S-filter ({s_filter_um:g} um) must be shorter than the L-filter ({l_filter_um:g} um). Change "
            "s_filter_um or l_filter_um."
        )
    is_finite = np.isfinite(height)
    # Holes are no edge: the masked filter bridges them.
    outside = np.pad(~ndimage.binary_fill_holes(is_finite), 1, constant_values=True)
    away = ndimage.distance_transform_edt(~outside, sampling=pitch_um)
    inside = np.asarray(away)[1:-1, 1:-1] >= 0.5 * l_filter_um
    if not (inside & is_finite).any():
        size = " x ".join(f"{n * p / 1000:.2g}" for n, p in zip(height.shape, pitch_um, strict=True))
        raise CannotMeasure(
            f"The sheet is {size} mm large; with an L-filter of {l_filter_um / 1000:g} mm, half of which is discarded "
            "along its edge, nothing is left. Give a shorter l_filter_um, and say so beside every number."
        )
    fine = smoothed(height, pitch_um, _sigma(s_filter_um)) if s_filter_um >= 2 * max(pitch_um) else height
    coarse = smoothed(height, pitch_um, _sigma(l_filter_um))
    return np.where(inside & is_finite, fine - coarse, np.nan)


@sheet_property("topography_difference", units="um", long_name="Topography, top less bottom",
                after=("topography_top", "topography_bottom"))  # fmt: skip
def topography_difference(sheet: Sheet) -> Measured:
    """P-14: outward height of the top face less that of the bottom face on the same ray; SE as of coatings.

    Both are measured from the centre surface, the smoothed mean of the faces, so that its mean is near 0 by
    construction; what is left is roughness that only one side has, and form below the centre surface's cut-off.
    """
    return difference(sheet, "topography")


# Warp, tilt and curvatures (P-07) have no standard error: what matters is a slow drift of the stack, which bends the
# surface as a real warp does and cannot be separated from it by one scan. Warp and tilt cost no look at the volume.


@sheet_property("warp", units="um", long_name="Warp", support_um=400.0, when=lambda _params, _greys: True)
def warp(sheet: Sheet) -> Floats:
    """Height of the centre surface above the plane that fits it best, up towards the top."""
    height = sheet.frame.heights["centre"]
    y, x = (np.arange(n) * p for n, p in zip(height.shape, sheet.frame.pitch_um, strict=True))
    yy, xx = np.meshgrid(y - y.mean(), x - x.mean(), indexing="ij")
    is_finite = np.isfinite(height) & sheet.valid
    terms = np.stack([np.ones(int(is_finite.sum())), yy[is_finite], xx[is_finite]], axis=1)
    level, by_y, by_x = np.linalg.lstsq(terms, height[is_finite], rcond=None)[0]
    return height - (level + by_y * yy + by_x * xx)


@sheet_property("tilt", units="deg", long_name="Tilt of the sheet", support_um=400.0, when=lambda _params, _greys: True)
def tilt(sheet: Sheet) -> Floats:
    """Angle between the normal and the axis through the sheet."""
    slope = sheet.frame.slopes()
    return np.rad2deg(np.arctan(np.hypot(slope[..., 0], slope[..., 1])))


@sheet_property("mean_curvature", units="1/mm", long_name="Mean curvature", support_um=400.0)
def mean_curvature(sheet: Sheet) -> Floats:
    """H = ((1 + p^2) t - 2 p q s + (1 + q^2) r) / (2 (1 + p^2 + q^2)^(3/2)); positive where the sheet is a bowl.

    p, q are the slopes, r, s, t the second derivatives of the centre surface's height.
    """
    p, q, r, s, t = _derivatives(sheet)
    above = (1 + p * p) * t - 2 * p * q * s + (1 + q * q) * r
    return _PER_MM * above / (2 * (1 + p * p + q * q) ** 1.5)


@sheet_property("gaussian_curvature", units="1/mm2", long_name="Gaussian curvature", support_um=400.0)
def gaussian_curvature(sheet: Sheet) -> Floats:
    """K = (r t - s^2) / (1 + p^2 + q^2)^2; 0 where the sheet can be laid flat without strain."""
    p, q, r, s, t = _derivatives(sheet)
    return _PER_MM**2 * (r * t - s * s) / (1 + p * p + q * q) ** 2


def _derivatives(sheet: Sheet) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Slopes p, q and second derivatives r, s, t along columns, mixed and along rows; NaN on the border."""
    centre = sheet.frame.heights["centre"]
    dy, dx = sheet.frame.pitch_um
    p, q, r, s, t = (np.full(centre.shape, np.nan) for _ in range(5))
    inner = (slice(1, -1), slice(1, -1))
    up, down, left, right = centre[:-2, 1:-1], centre[2:, 1:-1], centre[1:-1, :-2], centre[1:-1, 2:]
    here = centre[inner]
    p[inner], q[inner] = (right - left) / (2 * dx), (down - up) / (2 * dy)
    r[inner], t[inner] = (right - 2 * here + left) / dx**2, (down - 2 * here + up) / dy**2
    s[inner] = (centre[2:, 2:] - centre[2:, :-2] - centre[:-2, 2:] + centre[:-2, :-2]) / (4 * dx * dy)
    return p, q, r, s, t
