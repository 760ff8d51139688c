"""Numbers of a sheet that are no maps.

Thin coating, roughness, two-sidedness, and profiles in depth.
"""

import math
from itertools import repeat

import numpy as np
import xarray as xr

from planish.core.area import area_mean
from planish.core.errors import CannotMeasure
from planish.core.facts import (
    ProfileFacts,
    RoughnessFacts,
    SheetNumbers,
    ThinFacts,
    TwoSidesFacts,
)
from planish.core.grid import pitch
from planish.core.threads import map_threads
from planish.core.tiles import Engine
from planish.core.typing import Bools, Entries, Floats, Pair
from planish.measure.depth_profiles import depth_profiles
from planish.measure.form import above_form
from planish.measure.lengths import check_filters, without_short
from planish.measure.params import MeasureParams
from planish.measure.rays import meet, slopes_of
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
    sorted_um = np.sort(thickness.values[is_finite].astype(float))
    if sorted_um.size == 0:
        raise CannotMeasure(
            "There is no coating thickness to count: all values are missing. Look at 'status'."
        )
    x = np.arange(0.0, float(sorted_um[-1]) + 0.25, 0.25)
    marks = np.array(marked_um, np.float64)
    # At 0 the values that are 0 count: nothing is thinner than no coating.
    limits_um = np.where(marks > 0, marks, np.nextafter(0.0, 1.0))
    masks = [thickness.values < limit_um for limit_um in limits_um]
    marked_share = [mask[is_finite].mean() for mask in masks]
    marked_se = [_share_se(mask, is_finite, pitch(thickness)) for mask in masks]
    value_se_um = np.zeros(marks.size)
    if se is not None:
        se_um = np.where(is_finite, se, np.nan).astype(float)
        value_se_um[:] = [_se_near(mark, thickness.values, se_um) for mark in marks]
    is_biased = marks < 2 * value_se_um
    attrs: Entries = {"n": sorted_um.size}
    attrs["mean_um"] = float(sorted_um.mean())
    if "support_um" in thickness.attrs:
        attrs["support_um"] = float(thickness.attrs["support_um"])
    if is_biased.any():
        biased_text = ", ".join(f"{mark:g}" for mark in marks[is_biased])
        attrs["warning"] = (
            f"One value has a standard error of {value_se_um[is_biased].max():.2g} um: noise"
            f" adds to the share at {biased_text} um, or takes from it. Average the map first, or"
            " compare larger thicknesses."
        )
    share = np.searchsorted(sorted_um, x, side="left") / sorted_um.size
    share_attrs = {"units": "1", "long_name": "Share of the area with a thinner coating"}
    value_attrs = {"units": "um", "long_name": "Standard error of one value"}
    bias_attrs = {"long_name": "Thickness below two standard errors of one value"}
    um = {"units": "um"}
    coords = {"thickness": ("thickness", x, um), "marked": ("marked", marks, um)}
    shares = xr.Dataset(coords=coords, attrs=attrs)
    shares["share"] = "thickness", share, share_attrs
    shares["marked_share"] = "marked", marked_share, share_attrs
    shares["marked_se"] = "marked", marked_se, {"units": "1"}
    shares["value_se"] = "marked", value_se_um, value_attrs
    shares["biased"] = "marked", is_biased.astype(np.uint8), bias_attrs
    return shares


def _se_near(mark_um: float, thickness_um: Floats, se_um: Floats) -> float:
    """Median standard error of the values around a thickness; 0 where there are none."""
    reach_um = max(2.0, 0.5 * mark_um)
    is_near = np.isfinite(se_um) & (np.abs(thickness_um - mark_um) <= reach_um)
    if not is_near.any():
        return 0.0
    return float(np.median(se_um[is_near]))


def _share_se(is_thin: Bools, is_known: Bools, pitch_um: Pair) -> float:
    """Standard error of a share, sqrt(F (1 - F) / n_eff), from the covariances by lag."""
    # Means of k x k columns, of which there are no more than _MOST_CELLS.
    k = math.ceil(math.sqrt(is_known.size / _MOST_CELLS))
    thin_or_not = np.where(is_known, is_thin, np.nan)
    cells = area_mean(thin_or_not, (k, k))
    lags = Lags(np.isfinite(cells), pitch_um)
    variance = lags.variance_of_mean(covariance_of(cells, lags))
    return math.sqrt(max(variance, 0.0))


def roughness_numbers(
    limited: Floats, pitch_um: Pair, *, s_filter_um: float, l_filter_um: float
) -> RoughnessFacts:
    """Sa, Sq, Ssk, Sku, Sz and Sdq of what :func:`scale_limited` gives.

    Parameters
    ----------
    limited : (rows, cols)
        Heights in um; NaN where unknown.
    pitch_um : (float, float)
    s_filter_um, l_filter_um : float
        The filters that it was made with.

    Returns
    -------
    RoughnessFacts

    Raises
    ------
    CannotMeasure
        If it is empty or flat.
    """
    h = limited[np.isfinite(limited)]  # ISO 25178-2 writes it for the height
    if h.size < 2:
        raise CannotMeasure("No height of the face is known. Look at 'status'.")
    h = h - h.mean()
    sq = float(np.sqrt(np.mean(h**2)))
    if sq == 0:
        raise CannotMeasure(
            "The surface is exactly flat: it has no skewness. Check that it was measured."
        )
    by_y, by_x = np.moveaxis(slopes_of(limited, pitch_um), -1, 0)
    squared_slope = by_y**2 + by_x**2
    squared_slope = squared_slope[np.isfinite(squared_slope)]
    if not squared_slope.size:
        raise CannotMeasure(
            f"Of the face {h.size} heights are known, none with neighbours on all sides: it has no"
            " slopes. Look at 'status'."
        )
    sa = float(np.mean(np.abs(h)))
    ssk = float(np.mean(h**3)) / sq**3
    sku = float(np.mean(h**4)) / sq**4
    sdq = float(np.sqrt(np.mean(squared_slope)))
    return RoughnessFacts(
        sa=sa,
        sq=sq,
        ssk=ssk,
        sku=sku,
        sz=float(np.ptp(h)),
        sdq=sdq,
        n=h.size,
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
        if not set(names) <= set(maps):
            continue
        both_um = np.array([maps[name].values for name in names], np.float64)
        top, bottom = both_um[:, np.isfinite(both_um).all(axis=0)]
        if top.size < 3:
            continue
        top_sd = float(top.std())
        bottom_sd = float(bottom.std())
        numbers[f"{pair}_difference_um"] = float(top.mean() - bottom.mean())
        numbers[f"{pair}_sd_ratio"] = top_sd / bottom_sd if bottom_sd > 0 else np.nan
        # A face that is the same everywhere has no correlation with the other.
        is_varied = min(top_sd, bottom_sd) > 0
        r = np.corrcoef(top, bottom)[0, 1] if is_varied else np.nan
        numbers[f"{pair}_correlation"] = float(r)
        numbers[f"{pair}_n"] = top.size
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
        shares = depth_profiles(volume, measured, names=profile_names, params=params, engine=engine)
        profiles = ProfileFacts(
            depth=_numbers(shares["depth"]),
            values={name: _numbers(shares[name]) for name in profile_names},
        )
    coated_sides: list[Side] = [
        side for side in SIDES if measured[f"coating_{side}"].notnull().any()
    ]
    thin = map_threads(_thin_facts, repeat(measured), coated_sides)
    roughness = map_threads(_roughness_of_side, repeat(measured), SIDES, repeat(params))
    return SheetNumbers(
        thin=dict(zip(coated_sides, thin, strict=True)),
        form_um=measured["topography_top"].attrs.get("form_um"),
        roughness=dict(zip(SIDES, roughness, strict=True)),
        two_sides=TwoSidesFacts.model_validate(two_sidedness(measured)),
        profiles=profiles,
    )


def _numbers(array: xr.DataArray) -> tuple[float, ...]:
    return tuple(array.values.tolist())


def _thin_facts(measured: xr.Dataset, side: Side) -> ThinFacts:
    support_um = float(np.sqrt(np.prod(pitch(measured))))
    coating = measured[f"coating_{side}"].assign_attrs(support_um=support_um)
    shares = thin_fraction(coating, se=measured.get(f"coating_{side}_se"))
    return ThinFacts(
        thinner_than_um=_numbers(shares["marked"]),
        share=_numbers(shares["marked_share"]),
        standard_error=_numbers(shares["marked_se"]),
        support_um=support_um,
        warning=shares.attrs.get("warning"),
    )


def _roughness_of_side(measured: xr.Dataset, side: Side, params: MeasureParams) -> RoughnessFacts:
    filters_um = {"s_filter_um": params.s_filter_um, "l_filter_um": params.l_filter_um}
    try:
        check_filters(**filters_um)
        limited_um = _scale_limited_face(measured, side, params)
        return roughness_numbers(limited_um, pitch(measured), **filters_um)
    # A face of which little is known has none, which is no fault of the run.
    except CannotMeasure as reason:
        return RoughnessFacts(reason=reason.text)


def _scale_limited_face(measured: xr.Dataset, side: Side, params: MeasureParams) -> Floats:
    name = f"topography_{side}"
    pitch_um = pitch(measured)
    above_um = measured[name].values
    nesting_um = params.l_filter_um
    if measured[name].attrs.get("form_um") != nesting_um:
        heights, faces = meet(measured, "normal")
        sheet = (faces, heights["centre"], np.isfinite(above_um))
        above_um = above_form(*sheet, pitch_um, names=(name,), nesting_um=nesting_um)[name]
    return without_short(above_um, pitch_um, params.s_filter_um)
