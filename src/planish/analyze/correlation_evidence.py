"""What stands beside the correlation that leads.

A table of questions, each answered for two maps on one grid.

Each is a module with result and computation, a field of :class:`EvidenceFacts` and a row of
``QUESTIONS``. The sentences on them stand in :mod:`planish.report.sentences`.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import xarray as xr

from planish.analyze.agreement import AgreementFacts, answer_agreement
from planish.analyze.attenuation import answer_attenuation
from planish.analyze.compare import CELLS
from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.conley_interval import ConleyInterval, answer_conley_interval
from planish.analyze.correlation import PairAtSizes, check_varying
from planish.analyze.correlograms import CorrelogramProfiles, answer_correlogram
from planish.analyze.curve import Curvature, answer_curve
from planish.analyze.curve_of_sizes import SizeRow, answer_sizes
from planish.analyze.kubelka_munk import KubelkaMunk, answer_density, answer_kubelka_munk
from planish.analyze.light_field import LightField, answer_light_field
from planish.analyze.light_spread import LightSpread, answer_light_spread
from planish.analyze.octaves import Band, answer_octaves
from planish.analyze.params import CorrelateParams
from planish.analyze.quadratic_field import QuadraticField
from planish.analyze.robustness import (
    Partial,
    answer_origins,
    answer_partial,
    answer_short_waves,
)
from planish.analyze.sheet_columns import SheetColumns
from planish.analyze.split_half import Reliability
from planish.analyze.thin_regions import RegionDifference, answer_thin
from planish.analyze.variograms import Variogram, answer_variograms
from planish.core.errors import CannotMeasure, SizeError
from planish.core.facts import DescribedModel, Number
from planish.core.grid import Grid
from planish.core.typing import Entries, Texts
from planish.texture.covariance import Lags


class EvidenceFacts(DescribedModel):
    """What stands beside the correlation of the maps that stand for two layers."""

    a: str
    """First layer."""
    a_map: str
    """Its map."""
    b: str
    """Second layer."""
    b_map: str
    """Its map."""
    declared: bool
    """Whether the study named the map before r was looked at."""
    sizes: tuple[SizeRow, ...] = ()
    """r over points of growing size."""
    bands: tuple[Band, ...] = ()
    """Coherence by octaves of wavelength."""
    resolution_per_um: Number = None
    """Waves closer in frequency than this are not distinguished."""
    origins: tuple[float, float, float] | None = None
    """Least, mean and largest r over grids of points that begin elsewhere."""
    curve: Curvature | None = None
    """Whether the relation is straight or bent."""
    kubelka_munk: KubelkaMunk | None = None
    """Where the study asks for it."""
    light_spread: LightSpread | None = None
    """Where the study states how far light spreads."""
    density_g_cm3: Number = None
    """Of the coating, where the run knows it: it turns thickness into g/m2."""
    thin: tuple[RegionDifference, ...] = ()
    """The image where the coating is thin."""
    short_waves: SizeRow | None = None
    """Without waves above short_waves_um."""
    short_waves_um: Number = None
    """Longest wave that was left in for short_waves."""
    light_field: LightField | None = None
    """r without a smooth field that the map does not explain; of a sheet on an image."""
    attenuation_limit: Number = None
    """The r that a perfect relation would show, by misplacement alone."""
    reliability: tuple[Reliability, ...] = ()
    """Of the maps of sheets among the two, at the larger points."""
    attenuation_limit_noise: Number = None
    """The r that a perfect relation would show, by the noise of these maps alone: an upper
    bound."""
    attenuation_limit_both: Number = None
    """The same by noise and misplacement together."""
    conley_interval: ConleyInterval | None = None
    """An interval from what single points add to r."""
    variograms: tuple[Variogram, ...] = ()
    """How each map varies with distance."""
    correlogram: CorrelogramProfiles | None = None
    """r at every shift of one map."""
    agreement: AgreementFacts | None = None
    """Where both maps are of the same quantity."""
    partial: Partial | None = None
    """Where the study names maps that stand beside."""
    commonality: dict[str, float] | None = None
    """Shares of the variance of b that the maps explain alone and only together (joined by ' and
    '), at the larger points; their sum is r2 of all of them. Below 0 where a map hides what another
    one does."""


class Question(NamedTuple):
    """A statistic beside r.

    ``fields`` are those of :class:`EvidenceFacts` that ``answer`` fills. ``option`` is the option
    without which nobody asks.
    """

    fields: Texts
    answer: Callable[[ComparedMaps], Entries]
    option: str = ""


QUESTIONS = (
    Question(("sizes",), answer_sizes),
    Question(("bands", "resolution_per_um"), answer_octaves),
    Question(("origins",), answer_origins),
    Question(("conley_interval",), answer_conley_interval),
    Question(("curve",), answer_curve),
    Question(("thin",), answer_thin),
    Question(("short_waves", "short_waves_um"), answer_short_waves),
    Question(("light_field",), answer_light_field),
    Question(("partial", "commonality"), answer_partial, option="beside"),
    Question(
        ("attenuation_limit", "reliability", "attenuation_limit_noise", "attenuation_limit_both"),
        answer_attenuation,
    ),
    Question(("variograms",), answer_variograms),
    Question(("correlogram",), answer_correlogram),
    Question(("agreement",), answer_agreement),
    Question(("density_g_cm3",), answer_density),
    Question(("kubelka_munk",), answer_kubelka_munk, option="kubelka_munk"),
    Question(("light_spread",), answer_light_spread, option="light_spread_um"),
)


def correlation_diagnostics(
    maps: Mapping[str, xr.Dataset],
    a: tuple[str, str],
    b: tuple[str, str],
    *,
    params: CorrelateParams,
    columns: Mapping[str, SheetColumns] | None = None,
    md_deg: float | None = None,
    light: QuadraticField | None = None,
) -> EvidenceFacts | None:
    """Answer every question of two maps.

    None where they share fewer than 3 cells, or one of them is constant.

    Parameters
    ----------
    maps : mapping of str to Dataset (y, x); layers on the pixels of the reference, by their names
    a, b : (str, str); layer and map
    params : CorrelateParams
    columns : mapping of str to SheetColumns, optional; those of each sheet, for its reliability
    md_deg : float, optional; machine direction on the reference
    light : QuadraticField, optional; the field that was taken off the image

    Returns
    -------
    EvidenceFacts or None

    Raises
    ------
    InputError
        If a sheet lacks a map that is to stand beside.
    """
    a_maps, b_maps = maps[a[0]], maps[b[0]]
    a_map, b_map = a_maps[a[1]], b_maps[b[1]]
    grid = Grid.of(a_maps)
    is_same_quantity = a[1] == b[1] and "image" not in (a[1], b[1])
    point_um = params.point_um if is_same_quantity else None
    accumulator = PairAtSizes(
        grid.shape, pixel_um=grid.pixel_um, point_um=point_um, most_cells=CELLS
    )
    accumulator.add_maps(a_map, b_map, a_maps["valid"], b_maps["valid"])
    (x, y), cell_um = accumulator.cells()
    is_valid = np.isfinite(x) & np.isfinite(y)
    try:
        check_varying(is_valid, x=x, y=y)
    except CannotMeasure:
        return None
    a_units = str(a_map.attrs.get("units", "1"))
    b_units = str(b_map.attrs.get("units", "1"))
    repeated_points = None
    if is_same_quantity:
        repeated_points = accumulator.points()
    pair = ComparedMaps(
        a=a,
        b=b,
        units=(a_units, b_units),
        x=x,
        y=y,
        lags=Lags(is_valid, cell_um),
        params=params,
        layers=(a_maps, b_maps),
        grid=grid,
        columns=columns or {},
        md_deg=md_deg,
        light=light,
        repeated_points=repeated_points,
    )
    answers: Entries = {}
    for question in QUESTIONS:
        if question.option and getattr(params, question.option) in (None, ()):
            continue
        # a field that is too small for one of them, and the rest stands.
        with suppress(CannotMeasure, SizeError):
            answers |= question.answer(pair)
    return EvidenceFacts(
        a=a[0], a_map=a[1], b=b[0], b_map=b[1], declared=params.headline is not None, **answers
    )
