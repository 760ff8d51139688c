"""What stands beside the correlation that leads.

A table of questions, each answered for two maps on one grid.

Each is a module with result, computation and sentence, a field of :class:`EvidenceFacts` and a row
of ``QUESTIONS``.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
import xarray as xr
from pydantic import Field

from planish.analyze.agreement import Twice, answer_twice, say_twice
from planish.analyze.ceiling import answer_ceiling, say_ceiling
from planish.analyze.compare import CELLS
from planish.analyze.correlation import PairAtSizes
from planish.analyze.correlograms import CorrelogramProfiles, answer_correlogram, say_correlogram
from planish.analyze.covariance import Lags
from planish.analyze.curve import Curvature, answer_curve, say_curve
from planish.analyze.curve_of_sizes import SizeRow, answer_sizes
from planish.analyze.kubelka_munk import (
    KubelkaMunk,
    answer_density,
    answer_kubelka_munk,
    say_kubelka_munk,
)
from planish.analyze.light_spread import LightSpread, answer_light_spread, say_light_spread
from planish.analyze.octaves import Band, answer_octaves
from planish.analyze.params import CorrelateParams
from planish.analyze.robustness import (
    Partial,
    answer_origins,
    answer_partial,
    answer_short_waves,
    say_origins,
    say_partial,
    say_short_waves,
)
from planish.analyze.second_opinion import SecondOpinion, answer_second_opinion, say_second_opinion
from planish.analyze.split_half import Reliability, SheetColumns
from planish.analyze.thin_regions import RegionDifference, answer_thin, say_thin
from planish.analyze.variograms import Variogram, answer_variograms, say_variograms
from planish.core.area import area_mean
from planish.core.errors import CannotMeasure, SizeError
from planish.core.facts import Number, ResultModel, optional
from planish.core.grid import Grid
from planish.core.typing import Floats, Pair


class EvidenceFacts(ResultModel):
    """What stands beside the correlation of the maps that stand for two layers."""

    a: str = Field(description="First layer.")
    a_map: str = Field(description="Its map.")
    b: str = Field(description="Second layer.")
    b_map: str = Field(description="Its map.")
    declared: bool = Field(description="Whether the study named the map before r was looked at.")
    sizes: tuple[SizeRow, ...] = Field(default=(), description="r over points of growing size.")
    bands: tuple[Band, ...] = Field(default=(), description="Coherence by octaves of wavelength.")
    resolution_per_um: Number = optional(
        "Waves closer in frequency than this are not distinguished."
    )
    origins: tuple[float, float, float] | None = optional(
        "Least, mean and largest r over grids of points that begin elsewhere."
    )
    curve: Curvature | None = optional("Whether the relation is straight or bent.")
    kubelka_munk: KubelkaMunk | None = optional("Where the study asks for it.")
    light_spread: LightSpread | None = optional("Where the study states how far light spreads.")
    density_g_cm3: Number = optional(
        "Of the coating, where the run knows it: it turns thickness into g/m2."
    )
    thin: tuple[RegionDifference, ...] = Field(
        default=(), description="The image where the coating is thin."
    )
    short_waves: SizeRow | None = optional("Without waves above short_waves_um.")
    short_waves_um: Number = optional("Longest wave that was left in for short_waves.")
    ceiling: Number = optional("The r that a perfect relation would show, by misplacement alone.")
    ceiling_sentence: str | None = optional("The ceiling in words.")
    reliability: tuple[Reliability, ...] = Field(
        default=(), description="Of the maps of sheets among the two, at the larger points."
    )
    ceiling_noise: Number = optional(
        "The r that a perfect relation would show, by the noise of these maps alone: an upper"
        " bound."
    )
    ceiling_both: Number = optional("The same by noise and misplacement together.")
    second_opinion: SecondOpinion | None = optional("An interval from what single points add to r.")
    variograms: tuple[Variogram, ...] = Field(
        default=(), description="How each map varies with distance."
    )
    correlogram: CorrelogramProfiles | None = optional("r at every shift of one map.")
    twice: Twice | None = optional("Where both maps are of the same quantity.")
    partial: Partial | None = optional("Where the study names maps that stand beside.")
    commonality: dict[str, float] | None = optional(
        "Shares of the variance of b that the maps explain alone and only together (joined by ' and"
        " '), at the larger points; their sum is r2 of all of them. Below 0 where a map hides what"
        " another one does."
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparedMaps:
    """The maps that stand for two layers, on one mask, and what a run knows of them."""

    a: tuple[str, str]  # layer and map
    b: tuple[str, str]
    units: tuple[str, str]
    # Both maps (rows, cols), averaged to at most 65 536 cells; NaN where one of them is missing.
    x: Floats
    y: Floats
    lags: Lags  # of the cells that count, ``lags.is_valid``
    params: CorrelateParams
    layers: tuple[xr.Dataset, xr.Dataset]  # all maps of both, on the pixels of ``grid``
    grid: Grid
    # Those of each sheet.
    columns: Mapping[str, SheetColumns] = field(default_factory=dict[str, SheetColumns])
    md_deg: float | None = None  # machine direction on the reference
    # Means over the larger points, straight from the pixels, where both are sheets and the maps of
    # one quantity.
    repeated_points: list[Floats] | None = None

    @property
    def point_um(self) -> float:
        """Edge of the larger points."""
        return self.params.point_um

    @property
    def cell_um(self) -> Pair:
        """Size of a cell along y and x."""
        return self.lags.pixel_um

    @property
    def has_points(self) -> bool:
        """Whether the larger points are no smaller than cells."""
        return self.point_um >= max(self.cell_um)

    @property
    def sizes(self) -> dict[str, Any]:
        """Size of a cell and of a point, as functions of two maps take them."""
        return {"pixel_um": self.cell_um, "point_um": self.point_um}

    @property
    def why_no_points(self) -> str:
        """Why there are no means over the larger points; empty where there are."""
        if self.point_um >= max(self.cell_um) * (1 - 1e-9):
            return ""
        return (
            f"Points of {self.point_um:g} um are smaller than the means that stand for the pixels."
            " Give larger ones."
        )

    @property
    def points(self) -> tuple[Floats, Floats]:
        """Both maps averaged over the larger points."""
        factor = self.point_um / self.cell_um[0], self.point_um / self.cell_um[1]
        return area_mean(self.x, factor), area_mean(self.y, factor)

    @property
    def is_sheet_on_image(self) -> bool:
        """Whether a map of a sheet is compared with an image."""
        return "thickness" in self.layers[0] and "image" in self.layers[1]

    @property
    def is_coat_on_image(self) -> bool:
        """Whether thickness or weight of a coating is compared with an image."""
        return self.a[1].startswith("coat") and "image" in self.layers[1]


class PairWords(NamedTuple):
    """What sentences call things.

    The size of points, the values of the image, and the titles of both maps.
    """

    point_um: float = float("nan")
    image: str = "relative grey"
    titles: tuple[str, ...] = ()


Section = Literal["scale", "distance", "repeated", "light"]


class Question(NamedTuple):
    """A statistic beside r.

    ``fields`` are those of :class:`EvidenceFacts` that ``answer`` fills; where one of them is not
    empty, ``say`` gives the sentences of a section of the page from the first one. ``option`` is
    the option without which nobody asks.
    """

    fields: tuple[str, ...]
    answer: Callable[[ComparedMaps], dict[str, Any]]
    say: Callable[[Any, EvidenceFacts, PairWords], Iterable[str]] | None = None
    section: Section = "scale"
    option: str = ""


QUESTIONS = (
    Question(("sizes",), answer_sizes),
    Question(("bands", "resolution_per_um"), answer_octaves),
    Question(("origins",), answer_origins, say_origins),
    Question(("second_opinion",), answer_second_opinion, say_second_opinion),
    Question(("curve",), answer_curve, say_curve),
    Question(("thin",), answer_thin, say_thin),
    Question(("short_waves", "short_waves_um"), answer_short_waves, say_short_waves),
    Question(("partial", "commonality"), answer_partial, say_partial, option="beside"),
    Question(
        ("ceiling", "ceiling_sentence", "reliability", "ceiling_noise", "ceiling_both"),
        answer_ceiling,
        say_ceiling,
    ),
    Question(("variograms",), answer_variograms, say_variograms, section="distance"),
    Question(("correlogram",), answer_correlogram, say_correlogram, section="distance"),
    Question(("twice",), answer_twice, say_twice, section="repeated"),
    Question(("density_g_cm3",), answer_density),
    Question(
        ("kubelka_munk",),
        answer_kubelka_munk,
        say_kubelka_munk,
        section="light",
        option="kubelka_munk",
    ),
    Question(
        ("light_spread",),
        answer_light_spread,
        say_light_spread,
        section="light",
        option="light_spread_um",
    ),
)
"""In the order in which the page has their sentences."""


def correlation_diagnostics(
    maps: Mapping[str, xr.Dataset],
    a: tuple[str, str],
    b: tuple[str, str],
    *,
    params: CorrelateParams | None = None,
    columns: Mapping[str, SheetColumns] | None = None,
    md_deg: float | None = None,
) -> EvidenceFacts | None:
    """Answer every question of two maps.

    None where they share fewer than 3 cells, or one of them is constant.

    Parameters
    ----------
    maps : mapping of str to Dataset (y, x); layers on the pixels of the reference, by their names
    a, b : (str, str); layer and map
    params : CorrelateParams, optional
    columns : mapping of str to SheetColumns, optional; those of each sheet, for its reliability
    md_deg : float, optional; machine direction on the reference

    Returns
    -------
    EvidenceFacts or None

    Raises
    ------
    InputError
        If a sheet lacks a map that is to stand beside.
    """
    params = params or CorrelateParams()
    a_maps, b_maps = maps[a[0]], maps[b[0]]
    grid, is_same_quantity = Grid.of(a_maps), a[1] == b[1] and "image" not in (a[1], b[1])
    accumulator = PairAtSizes(
        grid.shape,
        pixel_um=grid.pixel_um,
        point_um=params.point_um if is_same_quantity else None,
        most_cells=CELLS,
    )
    accumulator.add_maps(a_maps[a[1]], b_maps[b[1]], a_maps["valid"], b_maps["valid"])
    (x, y), cell_um = accumulator.cells()
    is_valid = np.isfinite(x) & np.isfinite(y)
    if np.count_nonzero(is_valid) < 3 or not (np.ptp(x[is_valid]) > 0 and np.ptp(y[is_valid]) > 0):
        return None
    pair = ComparedMaps(
        a=a,
        b=b,
        units=(
            str(a_maps[a[1]].attrs.get("units", "1")),
            str(b_maps[b[1]].attrs.get("units", "1")),
        ),
        x=x,
        y=y,
        lags=Lags(is_valid, cell_um),
        params=params,
        layers=(a_maps, b_maps),
        grid=grid,
        columns=columns or {},
        md_deg=md_deg,
        repeated_points=accumulator.points() if is_same_quantity else None,
    )
    answers: dict[str, Any] = {}
    for question in QUESTIONS:
        if question.option and getattr(params, question.option) in (None, ()):
            continue
        # a field that is too small for one of them, and the rest stands.
        with suppress(CannotMeasure, SizeError):
            answers |= question.answer(pair)
    return EvidenceFacts(
        a=a[0], a_map=a[1], b=b[0], b_map=b[1], declared=params.headline is not None, **answers
    )


def sentences(
    evidence: EvidenceFacts, section: Section, words: PairWords | None = None
) -> Iterator[str]:
    """Give what a section of the page says of two maps, question by question."""
    for question in QUESTIONS:
        answers = [getattr(evidence, name) for name in question.fields]
        if (
            question.section == section
            and question.say
            and any(answer not in (None, ()) for answer in answers)
        ):
            yield from question.say(answers[0], evidence, words or PairWords())
