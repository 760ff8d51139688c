"""Topography: places of the faces on the rays, their roughness between two filters, and its numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option
from planish.measure.faces import PROPERTIES
from planish.measure.registry import Measured, Sheet, Side, sheet_property
from planish.measure.thickness import errors

if TYPE_CHECKING:
    from planish.measure.rays import Array

_ALPHA = 0.4697  # sqrt(ln 2 / pi): the Gaussian exp(-pi (x / (alpha cutoff))^2) passes its cut-off by half
_LEAST_WEIGHT = 0.3  # of the filter's weight that must lie on known values


class Options(Params):
    """Options of the roughness."""

    s_filter_um: float = option(5.0, gt=0, cli=None, help="S-filter of the roughness: shorter waves are left out.")
    l_filter_um: float = option(800.0, gt=0, cli=None, help="L-filter of the roughness: longer waves are left out.")


@sheet_property("topography_{side}", units="um", long_name=PROPERTIES["topography_top"].replace("top", "{side}"))
def topography(sheet: Sheet, side: Side) -> Measured:
    """P-06: from the centre surface outwards to the face; SE: that of the fitted face."""
    sign = 1.0 if side == "top" else -1.0
    return Measured(values=sign * sheet.frame.faces[side], se=errors(sheet, side)[0])


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
    left = np.prod([min(1.0, np.sqrt(q / (2 * np.sqrt(np.pi) * sigma))) for q in f.pitch_um])
    return Measured(values=limited, se=errors(sheet, side)[0] * float(left))


def _sigma(cutoff_um: float) -> float:
    return cutoff_um * _ALPHA / np.sqrt(2 * np.pi)


def smoothed(values: Array, pitch_um: tuple[float, float], sigma_um: float) -> Array:
    """Gaussian mean of the known values (rows, cols); NaN where too few lie in reach.

    The filter is normalised by the weight of what is known, and does not look beyond the border.
    """
    from scipy import ndimage

    sigma = [sigma_um / p for p in pitch_um]
    known = np.isfinite(values)
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), sigma, mode="constant", truncate=3.5)
    weight = ndimage.gaussian_filter(known.astype(np.float64), sigma, mode="constant", truncate=3.5)
    full = ndimage.gaussian_filter(np.ones(values.shape), sigma, mode="constant", truncate=3.5)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(weight > _LEAST_WEIGHT * full, total / weight, np.nan)


def scale_limited(
    height: Array, pitch_um: tuple[float, float], *, s_filter_um: float, l_filter_um: float
) -> Array:  # fmt: skip
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
    known = np.isfinite(height)
    outside = np.pad(~_filled(known), 1, constant_values=True)
    away = ndimage.distance_transform_edt(~outside, sampling=pitch_um)
    inside = np.asarray(away)[1:-1, 1:-1] >= 0.5 * l_filter_um
    if not (inside & known).any():
        size = " x ".join(f"{n * p / 1000:.2g}" for n, p in zip(height.shape, pitch_um, strict=True))
        raise CannotMeasure(
            f"The sheet is {size} mm large; with an L-filter of {l_filter_um / 1000:g} mm, half of which is discarded "
            "along its edge, nothing is left. Give a shorter l_filter_um, and say so beside every number."
        )
    fine = smoothed(height, pitch_um, _sigma(s_filter_um)) if s_filter_um >= 2 * max(pitch_um) else height
    coarse = smoothed(height, pitch_um, _sigma(l_filter_um))
    return np.where(inside & known, fine - coarse, np.nan)


def _filled(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The field with its holes: they are no edge, the masked filter bridges them."""
    from scipy import ndimage

    return np.asarray(ndimage.binary_fill_holes(known))


@dataclass(frozen=True, slots=True, kw_only=True)
class Roughness:
    """Numbers of a scale-limited surface, named as in ISO 25178-2; lengths in um.

    Attributes
    ----------
    sa, sq : float
        Mean and root-mean-square height.
    ssk, sku : float
        Skewness and kurtosis; 0 and 3 for normal heights.
    sz : float
        Highest to lowest; grows with the field.
    sdq : float
        Root-mean-square slope, um/um.
    n : int
    s_filter_um, l_filter_um : float
    """

    sa: float
    sq: float
    ssk: float
    sku: float
    sz: float
    sdq: float
    n: int
    s_filter_um: float
    l_filter_um: float


def roughness_numbers(
    limited: Array, pitch_um: tuple[float, float], *, s_filter_um: float, l_filter_um: float
) -> Roughness:
    """Sa, Sq, Ssk, Sku, Sz and Sdq of what :func:`scale_limited` gives.

    Raises
    ------
    CannotMeasure
        If it is empty or flat.
    """
    known = np.isfinite(limited)
    if np.count_nonzero(known) < 2:
        raise CannotMeasure("No height is known between the filters. Look at 'status', and at l_filter_um.")
    h = limited[known] - limited[known].mean()
    sq = float(np.sqrt(np.mean(h**2)))
    if sq == 0:
        raise CannotMeasure("The surface is exactly flat: it has no skewness. Check that it was measured.")
    slopes = [np.gradient(limited, p, axis=k) for k, p in enumerate(pitch_um)]
    steep = slopes[0] ** 2 + slopes[1] ** 2
    steep = steep[np.isfinite(steep)]
    if not steep.size:
        raise CannotMeasure(
            f"Between the filters only {h.size} heights are known, none with neighbours on all sides: the field is too "
            "small for an L-filter of this length. Give a shorter l_filter_um, and say so beside every number."
        )
    return Roughness(
        sa=float(np.mean(np.abs(h))), sq=sq, ssk=float(np.mean(h**3)) / sq**3, sku=float(np.mean(h**4)) / sq**4,
        sz=float(h.max() - h.min()), sdq=float(np.sqrt(np.mean(steep))), n=int(h.size), s_filter_um=s_filter_um,
        l_filter_um=l_filter_um,
    )  # fmt: skip
