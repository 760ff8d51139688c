"""Read the runs of a series one by one and keep none in memory.

Each gives its figures as rows, and what a table says.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path

from planish.analyze.agreement import AgreementFacts
from planish.core.checks import State, concerned
from planish.core.errors import FileError, InputError
from planish.core.facts import RoughnessFacts, ThinFacts, Trust, is_known
from planish.core.tables import grouped
from planish.core.text import without_folders
from planish.core.typing import Entries, Texts
from planish.report.summary import key_of
from planish.results import (
    CorrelationRow,
    EvidenceFacts,
    LayerFacts,
    PropertyFacts,
    Results,
    SheetFacts,
)
from planish.run.run import open_results
from planish.run.study import in_study_words
from planish.series_results import InstrumentFacts, Member, RunKind, SeriesSpecimen

_STATES: tuple[State, ...] = ("fail", "look", "unknown")


@dataclass(frozen=True, slots=True)
class FigureRow:
    """One figure of one specimen."""

    #: ``mean``, ``sd``, ``p5``, ``median``, ``p95``, ``columns``, ``n_independent``,
    #: ``mean_standard_error``, ``support_um``, ``thin_share``, ``sa``, ``sq``, ``measured_share``;
    #: ``r``, ``r2``, ``slope``, ``points``, ``n_eff``, ``n_eff_interval``, ``bias``, ``limit_low``,
    #: ``limit_high``, ``shared_um``; ``marks_used``, ``residual``, ``leave_one_out``,
    #: ``expected_error``, ``largest_expected_error``; ``coefficient_of_variation``;
    #: ``checks_fail``, ``checks_look``, ``checks_unknown``, ``checks_pass``.
    quantity: str
    value: float | None  #: None where it is withheld, or cannot be stated
    unit: str = "1"
    _: KW_ONLY
    specimen: str
    factors: Mapping[str, str] = field(default_factory=dict[str, str])
    layer: str = ""  #: what it is of; empty where it is of the whole run
    map: str = ""  #: likewise; empty also where it is of a registration
    other_layer: str = ""  #: of the second of two maps that were compared
    other_map: str = ""  #: the second of two maps that were compared
    at_um: float | None = None  #: limit of a thin share, edge of points, longest wave of an octave
    low: float | None = None  #: end of its 95 % interval, where it has one
    high: float | None = None  #: as ``low``
    trust: Trust = "ok"
    checks: str = ""  #: names of those that doubt or refute it
    period_deg: float | None = None  #: 180 of a map of angles of an axis


MakeRow = Callable[..., FigureRow]
FigureRows = Sequence[FigureRow]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """What a series keeps of a run beside its rows."""

    specimen: SeriesSpecimen  # as the page names it, without sheet and figures
    sheets: Texts  # names of the layers of either kind
    images: Texts
    headlines: Texts  # maps that stand for its sheets
    volumes: Texts  # hashes of the volumes
    thin_um: float | None  # limit of the study for thin regions
    column_um: float | None  # width of a column, where thin shares state it; of a voxel otherwise
    instruments: tuple[InstrumentFacts, ...]  # of two volumes


@dataclass(frozen=True, slots=True, kw_only=True)
class Gathered:
    """Specimens of a series as their runs are now."""

    #: with the state of the run that was read; ``damaged`` where it could not be.
    members: tuple[Member, ...]
    rows: list[FigureRow] = field(default_factory=list[FigureRow])
    #: by name, of runs that could be read.
    runs: dict[str, RunSummary] = field(default_factory=dict[str, RunSummary])

    def rows_of_series(self) -> list[FigureRow]:
        """Give rows in which the only sheet and the only image of each specimen have no name.

        Those need none, and so meet those of other specimens that are called otherwise. Where any
        specimen has several sheets, or images, all keep their names.
        """
        is_only_sheet = all(len(run.sheets) <= 1 for run in self.runs.values())
        is_only_image = all(len(run.images) <= 1 for run in self.runs.values())
        nameless: dict[str, set[str]] = {}  # layers of each specimen that need no name
        for name, run in self.runs.items():
            nameless[name] = {*run.sheets} if is_only_sheet else set()
            if is_only_image:
                nameless[name].update(run.images)
        rows: list[FigureRow] = []
        for row in self.rows:
            layers = {"layer": row.layer, "other_layer": row.other_layer}
            without = {key: "" for key, name in layers.items() if name in nameless[row.specimen]}
            rows.append(replace(row, **without))
        return rows


def gather(members: Sequence[Member], home: Path) -> Gathered:
    """Read the results of all runs of a series.

    Parameters
    ----------
    members : sequence of Member
        Those without a run stay as they are.
    home : path
        Folder that the runs of the members are relative to.

    Returns
    -------
    Gathered
        A run that is missing or damaged does not end it: its member says so.

    Raises
    ------
    InputError
        If some runs have an older format than others.
    """
    judged_members: list[Member] = []
    rows: list[FigureRow] = []
    runs: dict[str, RunSummary] = {}
    run_by_age: dict[bool, str] = {}  # a specimen with an older format of results, and one without
    for timed_member in members:
        # Of a clock: no two runs take the same.
        member = timed_member.model_copy(update={"seconds": None})
        folder = member.folder(home)  # None where there is no run
        if folder is not None and member.state not in ("refused", "damaged"):
            try:
                results = open_results(folder)
            except FileError as error:
                words = in_study_words(error.text)
                member = member.model_copy(update={"state": "damaged", "message": words})
            else:
                member = as_judged(member, results)
                rows += rows_of(member, results)
                runs[member.name] = _summary(member, results)
                run_by_age[results.is_older] = member.name
        # A page is handed on: of whole paths, names are left.
        message = without_folders(member.message)
        judged_members.append(member.model_copy(update={"message": message}))
    if len(run_by_age) > 1:
        raise InputError(
            f"The results of {run_by_age[True]} have an older format than those of"
            f" {run_by_age[False]}, and topography, roughness and mean angles meant something else"
            " there. Repeat the older runs with this version: planish run RUN/run.toml"
        )
    return Gathered(members=tuple(judged_members), rows=rows, runs=runs)


def as_judged(member: Member, results: Results) -> Member:
    """Give a member with the state of its run.

    It also says what the failed checks say, where it says nothing yet.
    """
    if results.passed:
        return member.model_copy(update={"state": "whole"})
    failures = [
        in_study_words(f"{check.name}: {check.text}") for check in results.checks_in("fail")
    ]
    return member.model_copy(
        update={"state": "withheld", "message": member.message or " ".join(failures)}
    )


def _summary(member: Member, results: Results) -> RunSummary:
    """What the page of a series needs of one run."""
    layers = grouped(results.layers, lambda layer: layer.kind)
    sheets = layers.get("sheet", [])
    images = layers.get("image", [])
    headlines = dict.fromkeys(layer.headline for layer in sheets)
    thin_um = results.parameters.get("correlate", {}).get("thin_um")
    stated_thin_um = float(thin_um) if isinstance(thin_um, int | float) else None
    return RunSummary(
        specimen=_specimen(member, results),
        sheets=tuple(layer.name for layer in sheets),
        images=tuple(layer.name for layer in images),
        headlines=tuple(headlines),
        volumes=tuple(layer.source.sha256 for layer in sheets),
        thin_um=stated_thin_um,
        column_um=max(chain.from_iterable(map(_widths_um, sheets)), default=None),
        instruments=tuple(_instruments(member, results)),
    )


def _widths_um(layer: LayerFacts) -> list[float]:
    """Widths of the voxels of a sheet, and of its columns where thin shares state them."""
    widths_um = [*layer.source.size_um[1:]]
    if layer.sheet is not None and layer.sheet.numbers is not None:
        widths_um += [thin.support_um for thin in layer.sheet.numbers.thin.values()]
    return widths_um


def _kind_of(results: Results) -> RunKind:
    """Name the kind of a run by its layers."""
    if not results.is_link:
        return "map"
    kinds = sorted(layer.kind for layer in results.layers)
    if kinds == ["image", "sheet"]:
        return "sheet on image"
    if kinds == ["sheet", "sheet"]:
        return "two volumes"
    return "layers"


def _specimen(member: Member, results: Results) -> SeriesSpecimen:
    """A specimen as the page of the series names it, without sheet and figures."""
    spoken: dict[State, Texts] = {}
    for state in _STATES:
        checks = results.checks_in(state)
        if checks:
            spoken[state] = tuple(check.name for check in checks)
    registrations = [layer.registration for layer in results.moving if layer.registration]
    errors = [r.expected_error for r in registrations if r.expected_error]
    # What holds for all layers of a specimen: the worst of each.
    return SeriesSpecimen(
        member=member,
        kind=_kind_of(results),
        light=results.state,
        spoken=spoken,
        marks_used=min((r.matched for r in registrations), default=None),
        leave_one_out_um=_largest([r.leave_one_out_rms_um for r in registrations]),
        expected_error_um=_largest([error.median_um for error in errors]),
    )


def _largest(lengths_um: Sequence[float | None]) -> float | None:
    """The largest length; None where there is none, or one of them is not known."""
    known_um = [um for um in lengths_um if um is not None]
    if len(known_um) < len(lengths_um):
        return None
    return max(known_um, default=None)


def _instruments(member: Member, results: Results) -> Iterator[InstrumentFacts]:
    """State how two measurements of the map that stands for both sheets differ.

    Of two quantities, there is no such thing. Figures are left out where they are withheld.
    """
    for evidence in results.evidence:
        agreement = evidence.agreement
        if agreement is None:
            continue
        row = _stated_row(results, evidence, agreement.point_um)
        if row is None or not row.same_quantity:
            continue
        figures: Entries = {}
        if row.trust != "withheld":
            # Both as changes of the second measurement for one of the first.
            has_slopes = is_known(row.slope) and row.slope_x_on_y
            figures = {
                "bias": row.difference_mean,
                "bias_interval": agreement.bias_interval,
                "limits": row.limits,
                "limit_intervals": agreement.limit_intervals,
                "shared_um": agreement.resolution_um,
                "slopes": (row.slope, 1 / row.slope_x_on_y) if has_slopes else None,
                "sentence": agreement.sentence or "",
            }
        yield InstrumentFacts(
            specimen=member.name,
            a=evidence.a,
            b=evidence.b,
            map=evidence.a_map,
            trust=row.trust,
            unit=row.units or "1",
            point_um=row.point_um,
            n=row.n,
            **figures,
        )


def _stated_row(
    results: Results, evidence: EvidenceFacts, point_um: float
) -> CorrelationRow | None:
    """The correlation of a pair at the points where its agreement is stated, or the largest."""
    rows = [row for row in results.correlations if key_of(row) == key_of(evidence)]
    if is_known(point_um):
        rows = [row for row in rows if abs(row.point_um - point_um) <= 1e-6 * point_um]
    return max(rows, key=lambda row: row.point_um, default=None)


def rows_of(member: Member, results: Results) -> list[FigureRow]:
    """Give every figure of a run that can be compared with those of other runs, as rows.

    Parameters
    ----------
    member : Member
    results : Results
        Of its run.

    Returns
    -------
    list of FigureRow
        In the order of the layers and maps of the run.
    """
    make_row = partial(FigureRow, specimen=member.name, factors=member.factors)
    rows: list[FigureRow] = []
    for layer in results.layers:
        rows += _of_layer(layer, results, make_row)
    rows += _of_pairs(results, make_row)
    for state in (*_STATES, "pass"):
        rows.append(make_row(f"checks_{state}", float(len(results.checks_in(state)))))
    return rows


def _of_layer(layer: LayerFacts, results: Results, make_row: MakeRow) -> Iterator[FigureRow]:
    """Figures of the sheet of a layer, and of its registration, where it has either.

    ``make_row`` makes a row of a quantity, its value and its unit, with what else is known of it.
    """
    make_row = partial(make_row, layer=layer.name)
    if layer.sheet is not None:
        yield from _of_sheet(layer.sheet, layer.name, results, make_row)
    registration = layer.registration
    if registration is None:
        return
    make_row = partial(make_row, other_layer=registration.to)
    yield make_row("marks_used", float(registration.matched))
    yield make_row("residual", registration.rms_um, "um")
    yield make_row("leave_one_out", registration.leave_one_out_rms_um, "um")
    errors = registration.expected_error
    if errors is not None:
        trust_fields = _trusted(errors.trust, results, (layer.name,), ("position",))
        yield make_row("expected_error", errors.median_um, "um", **trust_fields)
        yield make_row("largest_expected_error", errors.largest_um, "um", **trust_fields)


def _of_sheet(
    sheet: SheetFacts, layer: str, results: Results, make_row: MakeRow
) -> Iterator[FigureRow]:
    """Statistics, thin shares and roughness of each map of a sheet.

    Thin shares and roughness are kept by sides of the sheet: coatings have the shares, topographies
    the roughness of the faces, and half thicknesses that about the centre surface.
    """
    thin_by_map: dict[str, ThinFacts] = {}
    roughness_by_map: dict[str, RoughnessFacts] = {}
    numbers = sheet.numbers
    if numbers is not None:
        about_centre = numbers.roughness_about_centre
        thin_by_map = {f"coating_{side}": thin for side, thin in numbers.thin.items()}
        roughness_by_map = {f"topography_{s}": facts for s, facts in numbers.roughness.items()}
        roughness_by_map |= {f"half_thickness_{s}": facts for s, facts in about_centre.items()}
    for name, stats in sheet.properties.items():
        trust_fields = _trusted(stats.trust, results, (layer,), (name,))
        make_map_row = partial(make_row, map=name, period_deg=stats.period_deg, **trust_fields)
        yield from _of_map(stats, make_map_row)
        # Those of a withheld map are withheld as well.
        if name in thin_by_map:
            thin = thin_by_map[name]
            for limit, share in zip(thin.thinner_than_um, thin.share, strict=True):
                yield make_map_row("thin_share", share, at_um=limit)
        if name in roughness_by_map:
            yield make_map_row("sa", roughness_by_map[name].sa, "um")
            yield make_map_row("sq", roughness_by_map[name].sq, "um")
    yield make_row("measured_share", sheet.surfaces.shares.get("measured"))


def _of_map(stats: PropertyFacts, make_row: MakeRow) -> Iterator[FigureRow]:
    """Statistics of one map; those that may not be known have no row then."""
    for quantity in ("mean", "sd", "p5", "median", "p95"):
        yield make_row(quantity, getattr(stats, quantity), stats.units)
    yield make_row("columns", float(stats.n))
    units = {"n_independent": "1", "mean_standard_error": stats.units, "support_um": "um"}
    for quantity, unit in units.items():
        value = getattr(stats, quantity)
        if value is not None:
            yield make_row(quantity, float(value), unit)


def _of_pairs(results: Results, make_row: MakeRow) -> Iterator[FigureRow]:
    """Correlations and differences of pairs of maps, and the mottle of images.

    There is a row of each quantity for each size of points, and of mottle for each octave.
    """
    agreement_by_pair = {key_of(e): e.agreement for e in results.evidence}
    for c in results.correlations:
        figures = (c.a_map, c.b_map, "position", "correlation")
        trust_fields = _trusted(c.trust, results, (c.a, c.b), figures)
        pair_fields = {"layer": c.a, "map": c.a_map, "other_layer": c.b, "other_map": c.b_map}
        make_pair_row = partial(make_row, **pair_fields, **trust_fields, at_um=c.point_um)
        low, high = map(_number, c.interval)
        yield make_pair_row("r", _number(c.r), low=low, high=high)
        for quantity in ("r2", "slope", "points", "n_eff", "n_eff_interval"):
            value = c.n if quantity == "points" else getattr(c, quantity)
            yield make_pair_row(quantity, _number(float(value)))
        if c.same_quantity:
            agreement = agreement_by_pair.get(key_of(c))
            yield from _differences(c, agreement, partial(make_pair_row, unit=c.units or "1"))
    for image in results.mottle:
        make_image_row = partial(make_row, layer=image.layer, map="image")
        for band in image.bands:
            variation = band.coefficient_of_variation
            yield make_image_row("coefficient_of_variation", variation, at_um=band.longest_um)


def _number(value: float) -> float | None:
    return value if is_known(value) else None


def _differences(
    c: CorrelationRow, agreement: AgreementFacts | None, make_row: MakeRow
) -> Iterator[FigureRow]:
    """Give the bias and limits of two measurements of one quantity, of points of one size.

    They have intervals at the points where the run states its ``agreement``, None where it states
    none.
    """
    if agreement is not None:
        is_of_points = abs(agreement.point_um - c.point_um) < 1e-6
        if not is_of_points or c.trust == "withheld":
            agreement = None
    intervals = [None] * 3
    if agreement is not None:
        intervals = [agreement.bias_interval, *agreement.limit_intervals]
    quantities = ("bias", "limit_low", "limit_high")
    values = (c.difference_mean, *c.limits)
    for quantity, value, ends in zip(quantities, values, intervals, strict=True):
        low, high = ends if ends is not None and is_known(ends) else (None, None)
        yield make_row(quantity, _number(value), low=low, high=high)
    if agreement is not None and agreement.resolution_um is not None:
        yield make_row("shared_um", agreement.resolution_um, unit="um")


def _trusted(
    trust: Trust, results: Results, layers: Sequence[str], figures: Sequence[str]
) -> Entries:
    """Fields of a row that say how far a figure of some layers is trusted, and by which checks."""
    if trust == "ok":
        return {"trust": trust}
    checks = concerned(results.checks, layers, figures)
    names = dict.fromkeys(check.name for check in checks if check.state in ("look", "fail"))
    return {"trust": trust, "checks": "; ".join(names)}
