"""Numbers of a sheet that are no maps.

Thin coating, roughness, two-sidedness, and profiles in depth.
"""

import math
from itertools import repeat

import numpy as np
import xarray as xr

from planish.core.area import area_mean
from planish.core.errors import CannotMeasure
from planish.core.facts import ProfileFacts, RoughnessFacts, SheetNumbers, ThinFacts, TwoSidesFacts
from planish.core.grid import pitch
from planish.core.threads import map_threads
from planish.core.tiles import Engine
from planish.core.typing import Bools, Floats, Pair
from planish.measure.depth_profiles import depth_profiles
from planish.measure.form import above_form
from planish.measure.lengths import check_filters, without_short
from planish.measure.params import MeasureParams
from planish.measure.rays import meet
from planish.measure.registry import SIDES, Side
from planish.texture.covariance import Lags, covariance_of

_MOST_CELLS = 2**16  # by which the independent values of a share are counted


def thin_fraction(
    thickness: xr.DataArray,
    *,
    se: xr.DataArray | Floats | None = None,
    marked_um: tuple[float, ...] = (0.0, 2.0, 5.0),
) -> xr.Dataset:
    """Share F(x) of the area whose coating is thinner than x (P-03).

    Parameters
    ----------
    thickness : DataArray, dims (y, x), in um
        NaN is left out. ``support_um`` in its attributes is passed on.
    se : array like it
        Standard error of each value, um.
    marked_um : tuple of float
        Thicknesses for which the share is told apart; at 0 it is the share of no coating at all, 5
        um is the outline of Fig. 6 in Hirn et al. (2009).

    Returns
    -------
    Dataset
        ``share`` along ``thickness`` (um), and for every marked thickness ``marked_share`` along
        ``marked``, ``marked_se`` (of the sheet's share by this field: sqrt(F (1 - F) / n_eff), the
        independent values from the covariances by lag of the map of what is thinner) and
        ``biased``: 1 where x lies below twice the median SE of the values around it, so that the
        share rests on noise. ``n`` and ``support_um`` in the attributes, and ``warning`` where a
        marked share is biased: F depends on support and noise and must not be compared without
        them.

    Raises
    ------
    CannotMeasure
        If no value is known.
    """
    is_finite = np.isfinite(thickness.values)
    sorted_um = np.sort(thickness.values[is_finite].astype(np.float64))
    if sorted_um.size == 0:
        raise CannotMeasure(
            "There is no coating thickness to count: all values are missing. Look at 'status'."
        )
    x = np.arange(0.0, float(sorted_um[-1]) + 0.25, 0.25)
    marks = np.array(marked_um, dtype=np.float64)
    # At 0 the values that are 0 count: nothing is thinner than no coating.
    masks = [thickness.values < mark if mark > 0 else thickness.values <= 0 for mark in marks]
    shares = np.array([mask[is_finite].mean() for mask in masks])
    share_se = [_share_se(mask, is_finite, pitch(thickness)) for mask in masks]
    value_se_um = np.zeros(marks.size)
    if se is not None:
        se_um = np.where(is_finite, se, np.nan).astype(np.float64)
        for k, mark in enumerate(marks):
            near_se_um = se_um[
                np.isfinite(se_um) & (np.abs(thickness.values - mark) <= max(2.0, 0.5 * mark))
            ]
            value_se_um[k] = np.median(near_se_um) if near_se_um.size else 0.0
    is_biased = (marks < 2 * value_se_um).astype(np.uint8)
    attrs: dict[str, object] = {"n": int(sorted_um.size), "mean_um": float(sorted_um.mean())}
    if "support_um" in thickness.attrs:
        attrs["support_um"] = float(thickness.attrs["support_um"])
    if is_biased.any():
        biased_text = ", ".join(f"{m:g}" for m in marks[is_biased > 0])
        attrs["warning"] = (
            f"One value has a standard error of {value_se_um[is_biased > 0].max():.2g} um: noise"
            f" adds to the share at {biased_text} um, or takes from it. Average the map first, or"
            " compare larger thicknesses."
        )
    share_attrs = {"units": "1", "long_name": "Share of the area with a thinner coating"}
    variables = {
        "share": (
            "thickness",
            np.searchsorted(sorted_um, x, side="left") / sorted_um.size,
            share_attrs,
        ),
        "marked_share": ("marked", shares, share_attrs),
        "marked_se": ("marked", share_se, {"units": "1"}),
        "value_se": (
            "marked",
            value_se_um,
            {"units": "um", "long_name": "Standard error of one value"},
        ),
        "biased": (
            "marked",
            is_biased,
            {"long_name": "Thickness below two standard errors of one value"},
        ),
    }
    coords = {
        name: (name, um, {"units": "um"}) for name, um in (("thickness", x), ("marked", marks))
    }
    return xr.Dataset(variables, coords=coords, attrs=attrs)


def _share_se(is_thin: Bools, is_known: Bools, pitch_um: Pair) -> float:
    """Standard error of a share, sqrt(F (1 - F) / n_eff), from the covariances by lag."""
    k = math.ceil(math.sqrt(is_known.size / _MOST_CELLS))
    cells = area_mean(np.where(is_known, is_thin, np.nan), (k, k))
    lags = Lags(np.isfinite(cells), pitch_um)
    return math.sqrt(max(lags.variance_of_mean(covariance_of(cells, lags)), 0.0))


def roughness_numbers(
    limited: Floats, pitch_um: Pair, *, s_filter_um: float, l_filter_um: float
) -> RoughnessFacts:
    """Sa, Sq, Ssk, Sku, Sz and Sdq of what :func:`scale_limited` gives.

    Raises
    ------
    CannotMeasure
        If it is empty or flat.
    """
    is_finite = np.isfinite(limited)
    if np.count_nonzero(is_finite) < 2:
        raise CannotMeasure("No height of the face is known. Look at 'status'.")
    h = limited[is_finite] - limited[is_finite].mean()
    sq = float(np.sqrt(np.mean(h**2)))
    if sq == 0:
        raise CannotMeasure(
            "The surface is exactly flat: it has no skewness. Check that it was measured."
        )
    slopes = [np.gradient(limited, p, axis=k) for k, p in enumerate(pitch_um)]
    squared_slope = slopes[0] ** 2 + slopes[1] ** 2
    squared_slope = squared_slope[np.isfinite(squared_slope)]
    if not squared_slope.size:
        raise CannotMeasure(
            f"Of the face {h.size} heights are known, none with neighbours on all sides: it has no"
            " slopes. Look at 'status'."
        )
    return RoughnessFacts(
        sa=float(np.mean(np.abs(h))),
        sq=sq,
        ssk=float(np.mean(h**3)) / sq**3,
        sku=float(np.mean(h**4)) / sq**4,
        sz=float(h.max() - h.min()),
        sdq=float(np.sqrt(np.mean(squared_slope))),
        n=int(h.size),
        s_filter_um=s_filter_um,
        l_filter_um=l_filter_um,
    )


def two_sidedness(maps: xr.Dataset) -> dict[str, float]:
    """Numbers of the two sides, from maps on the same rays: nothing has to be mirrored.

    Parameters
    ----------
    maps : Dataset
        With ``coating_top`` and ``coating_bottom``, or ``topography_top`` and
        ``topography_bottom``, or both pairs.

    Returns
    -------
    dict
        For each pair ``<pair>_difference_um`` (mean, top less bottom), ``<pair>_sd_ratio`` (top
        over bottom) and ``<pair>_correlation`` (Pearson's r of top and bottom; outward heights
        correlate negatively where the sheet as a whole bends, positively where it is thick and
        thin), ``<pair>_n``.

    Raises
    ------
    CannotMeasure
        If there is no pair.
    """
    numbers: dict[str, float] = {}
    for pair in ("coating", "half_thickness", "topography"):
        names = [f"{pair}_{side}" for side in SIDES]
        if any(name not in maps for name in names):
            continue
        top, bottom = (maps[name].values.astype(np.float64) for name in names)
        is_finite = np.isfinite(top) & np.isfinite(bottom)
        if np.count_nonzero(is_finite) < 3:
            continue
        a, b = top[is_finite], bottom[is_finite]
        sd = float(a.std()), float(b.std())
        numbers[f"{pair}_difference_um"] = float(a.mean() - b.mean())
        numbers[f"{pair}_sd_ratio"] = sd[0] / sd[1] if sd[1] > 0 else np.nan
        numbers[f"{pair}_correlation"] = float(np.corrcoef(a, b)[0, 1]) if min(sd) > 0 else np.nan
        numbers[f"{pair}_n"] = int(a.size)
    if not numbers:
        raise CannotMeasure(
            "Two-sidedness needs coating_top and coating_bottom, or topography_top and"
            " topography_bottom, known on the same rays. Measure them."
        )
    return numbers


def sheet_numbers(
    measured: xr.Dataset,
    *,
    volume: xr.DataArray | None,
    params: MeasureParams,
    engine: Engine | None = None,
) -> SheetNumbers:
    """Describe a sheet in numbers.

    Thin and uncovered shares, roughness, two-sidedness, and profiles in depth.

    Parameters
    ----------
    measured : Dataset
        From :func:`measure_properties`.
    volume : DataArray
        Needed for the profiles of porosity and filler, which are made where their maps were
        measured.
    params, engine
    """
    profile_names = [name for name in ("porosity", "filler") if name in measured]
    profiles = None
    if profile_names and volume is not None:
        depth_profile = depth_profiles(
            volume, measured, names=profile_names, params=params, engine=engine
        )
        depth, *shares = (
            tuple(depth_profile[name].values.tolist()) for name in ("depth", *profile_names)
        )
        profiles = ProfileFacts(depth=depth, values=dict(zip(profile_names, shares, strict=True)))
    of_sides = map_threads(_numbers_of_side, repeat(measured), SIDES, repeat(params))
    thin: dict[Side, ThinFacts] = {
        side: facts for side, (facts, _) in zip(SIDES, of_sides, strict=True) if facts is not None
    }
    roughness: dict[Side, RoughnessFacts] = {
        side: facts for side, (_, facts) in zip(SIDES, of_sides, strict=True)
    }
    two_sides = TwoSidesFacts.model_validate(two_sidedness(measured))
    form_um = measured["topography_top"].attrs.get("form_um")
    return SheetNumbers(
        thin=thin, form_um=form_um, roughness=roughness, two_sides=two_sides, profiles=profiles
    )


def _numbers_of_side(
    measured: xr.Dataset, side: Side, params: MeasureParams
) -> tuple[ThinFacts | None, RoughnessFacts]:
    pitch_um, filters_um = (
        pitch(measured),
        {"s_filter_um": params.s_filter_um, "l_filter_um": params.l_filter_um},
    )
    thin, coating = None, measured[f"coating_{side}"]
    if np.isfinite(coating.values).any():
        support_um = float(np.sqrt(np.prod(pitch_um)))
        thin_shares = thin_fraction(
            coating.assign_attrs(support_um=support_um), se=measured.get(f"coating_{side}_se")
        )
        marked_um, share, standard_error = (
            tuple(thin_shares[name].values.tolist())
            for name in ("marked", "marked_share", "marked_se")
        )
        thin = ThinFacts(
            thinner_than_um=marked_um,
            share=share,
            standard_error=standard_error,
            support_um=support_um,
            warning=thin_shares.attrs.get("warning"),
        )
    try:
        roughness_map = _scale_limited_face(measured, side, params)
        return thin, roughness_numbers(roughness_map, pitch_um, **filters_um)
    # A face of which little is known has none, which is no fault of the run.
    except CannotMeasure as reason:
        return thin, RoughnessFacts(reason=reason.text)


def _scale_limited_face(measured: xr.Dataset, side: Side, params: MeasureParams) -> Floats:
    check_filters(params.s_filter_um, params.l_filter_um)
    topography, pitch_um = measured[f"topography_{side}"], pitch(measured)
    above_um = topography.values
    if topography.attrs.get("form_um") != params.l_filter_um:
        heights, faces = meet(measured, "normal")
        (above_um,) = above_form(
            faces,
            heights["centre"],
            np.isfinite(above_um),
            pitch_um,
            names=(f"topography_{side}",),
            nesting_um=params.l_filter_um,
        ).values()
    return without_short(above_um, pitch_um, params.s_filter_um)
