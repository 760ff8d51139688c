"""Read the runs of a series one by one and keep none in memory.

Each gives its figures as rows, and what a table says.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from planish.analyze.agreement import AgreementFacts
from planish.core.checks import State, concerned
from planish.core.errors import FileError, InputError
from planish.core.facts import SIDES, RoughnessFacts, Trust, is_known
from planish.core.text import without_folders
from planish.report.summary import key_of
from planish.results import CorrelationRow, EvidenceFacts, LayerFacts, Results, SheetFacts
from planish.run.run import open_results
from planish.run.study import in_study_words
from planish.series_results import InstrumentFacts, Member, SeriesSpecimen

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


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """What a series keeps of a run beside its rows."""

    specimen: SeriesSpecimen  # as the page names it, without sheet and figures
    sheets: tuple[str, ...]  # names of the layers of either kind
    images: tuple[str, ...]
    headlines: tuple[str, ...]  # maps that stand for its sheets
    volumes: tuple[str, ...]  # hashes of the volumes
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

        Those need none.
        """
        is_only_sheet = all(len(run.sheets) <= 1 for run in self.runs.values())
        is_only_image = all(len(run.images) <= 1 for run in self.runs.values())

        def shown_layer(row: FigureRow, layer: str) -> str:
            return (
                ""
                if (is_only_sheet if layer in self.runs[row.specimen].sheets else is_only_image)
                else layer
            )

        return [
            replace(
                row,
                layer=shown_layer(row, row.layer),
                other_layer=shown_layer(row, row.other_layer),
            )
            for row in self.rows
        ]


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
    judged_members, rows, runs = list[Member](), list[FigureRow](), dict[str, RunSummary]()
    run_by_age = dict[bool, str]()
    for timed_member in members:
        # Of a clock: no two runs take the same.
        member = timed_member.model_copy(update={"seconds": None})
        folder = member.folder(home)
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
    sheets = [layer for layer in results.layers if layer.kind == "sheet"]
    registrations = [
        layer.registration for layer in results.moving if layer.registration is not None
    ]
    widths_um = [um for layer in sheets for um in layer.source.size_um[1:]]
    for layer in sheets:
        if layer.sheet is not None and layer.sheet.numbers is not None:
            widths_um += [thin_um.support_um for thin_um in layer.sheet.numbers.thin.values()]
    thin_um = results.parameters.get("correlate", {}).get("thin_um")
    kind = "layers" if results.is_link else "map"
    if results.is_link and len(results.layers) == 2 and sheets:
        kind = "two volumes" if len(sheets) == 2 else "sheet on image"
    instruments = (
        _instruments(member, results, e, e.agreement)
        for e in results.evidence
        if e.agreement is not None
    )
    return RunSummary(
        specimen=SeriesSpecimen(
            member=member,
            kind=kind,
            light=results.state,
            spoken={
                s: tuple(c.name for c in checks)
                for s in _STATES
                if (checks := results.checks_in(s))
            },
            marks_used=min((r.matched for r in registrations), default=None),
            leave_one_out_um=_largest([r.leave_one_out_rms_um for r in registrations]),
            expected_error_um=_largest(
                [e.median_um for r in registrations if (e := r.expected_error)]
            ),
        ),
        sheets=tuple(layer.name for layer in sheets),
        images=tuple(layer.name for layer in results.layers if layer.kind == "image"),
        headlines=tuple(dict.fromkeys(layer.headline for layer in sheets)),
        volumes=tuple(layer.source.sha256 for layer in sheets),
        thin_um=float(thin_um) if isinstance(thin_um, int | float) else None,
        column_um=max(widths_um, default=None),
        instruments=tuple(facts for facts in instruments if facts is not None),
    )


def _largest(lengths: Sequence[float | None]) -> float | None:
    return None if None in lengths else max((um for um in lengths if um is not None), default=None)


def _instruments(
    member: Member, results: Results, e: EvidenceFacts, agreement: AgreementFacts
) -> InstrumentFacts | None:
    """How two measurements of the map that stands for both sheets differ.

    None where they are of two quantities.
    """
    rows = [row for row in results.correlations if key_of(row) == key_of(e)]
    if is_known(agreement.point_um):
        rows = [
            row
            for row in rows
            if abs(row.point_um - agreement.point_um) <= 1e-6 * agreement.point_um
        ]
    row = max(rows, key=lambda row: row.point_um, default=None)
    if row is None or not row.same_quantity:
        return None
    figures: dict[str, Any] = {}
    if row.trust != "withheld":
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
    return InstrumentFacts(
        specimen=member.name,
        a=e.a,
        b=e.b,
        map=e.a_map,
        trust=row.trust,
        unit=row.units or "1",
        point_um=row.point_um,
        n=row.n,
        **figures,
    )


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
    states: tuple[State, ...] = ("fail", "look", "unknown", "pass")
    return rows + [
        make_row(f"checks_{state}", float(len(results.checks_in(state)))) for state in states
    ]


def _roughness_by_map(sheet: SheetFacts) -> dict[str, RoughnessFacts]:
    if sheet.numbers is None:
        return {}
    return {f"topography_{side}": facts for side, facts in sheet.numbers.roughness.items()} | {
        f"half_thickness_{side}": facts
        for side, facts in sheet.numbers.roughness_about_centre.items()
    }


def _of_layer(layer: LayerFacts, results: Results, make_row: MakeRow) -> Iterator[FigureRow]:  # noqa: C901
    sheet, registration = layer.sheet, layer.registration
    make_row = partial(make_row, layer=layer.name)
    if sheet is not None:
        thin_by_side = sheet.numbers.thin if sheet.numbers else {}
        roughness_by_map = _roughness_by_map(sheet)
        for name, stats in sheet.properties.items():
            make_map_row = partial(
                make_row,
                map=name,
                period_deg=stats.period_deg,
                **_trusted(stats.trust, results, (layer.name,), (name,)),
            )
            for quantity in ("mean", "sd", "p5", "median", "p95"):
                yield make_map_row(quantity, getattr(stats, quantity), stats.units)
            yield make_map_row("columns", float(stats.n))
            for quantity, unit in (
                ("n_independent", "1"),
                ("mean_standard_error", stats.units),
                ("support_um", "um"),
            ):
                if (value := getattr(stats, quantity)) is not None:
                    yield make_map_row(quantity, float(value), unit)
            for side in SIDES:
                # Those of a withheld map are withheld as well.
                if name == f"coating_{side}" and side in thin_by_side:
                    for limit, share in zip(
                        thin_by_side[side].thinner_than_um, thin_by_side[side].share, strict=True
                    ):
                        yield make_map_row("thin_share", share, at_um=limit)
            if name in roughness_by_map:
                yield make_map_row("sa", roughness_by_map[name].sa, "um")
                yield make_map_row("sq", roughness_by_map[name].sq, "um")
        yield make_row("measured_share", sheet.surfaces.shares.get("measured"))
    if registration is not None:
        make_row = partial(make_row, other_layer=registration.to)
        yield make_row("marks_used", float(registration.matched))
        yield make_row("residual", registration.rms_um, "um")
        yield make_row("leave_one_out", registration.leave_one_out_rms_um, "um")
        if (errors := registration.expected_error) is not None:
            trust_fields = _trusted(errors.trust, results, (layer.name,), ("position",))
            yield make_row("expected_error", errors.median_um, "um", **trust_fields)
            yield make_row("largest_expected_error", errors.largest_um, "um", **trust_fields)


def _of_pairs(results: Results, make_row: MakeRow) -> Iterator[FigureRow]:
    agreement_by_pair = {key_of(e): e.agreement for e in results.evidence}
    for c in results.correlations:
        trust_fields = _trusted(
            c.trust, results, (c.a, c.b), (c.a_map, c.b_map, "position", "correlation")
        )
        pair_fields = {"layer": c.a, "map": c.a_map, "other_layer": c.b, "other_map": c.b_map}
        make_pair_row = partial(make_row, **pair_fields, **trust_fields, at_um=c.point_um)
        low, high = map(_number, c.interval)
        yield make_pair_row("r", _number(c.r), low=low, high=high)
        for quantity in ("r2", "slope", "n", "n_eff", "n_eff_interval"):
            quantity_name = "points" if quantity == "n" else quantity
            yield make_pair_row(quantity_name, _number(float(getattr(c, quantity))))
        if c.same_quantity:
            yield from _differences(
                c, agreement_by_pair.get(key_of(c)), partial(make_pair_row, unit=c.units or "1")
            )
    for image in results.mottle:
        for band in image.bands:
            yield make_row(
                "coefficient_of_variation",
                band.coefficient_of_variation,
                layer=image.layer,
                map="image",
                at_um=band.longest_um,
            )


def _number(value: float) -> float | None:
    return value if is_known(value) else None


def _differences(
    c: CorrelationRow, agreement: AgreementFacts | None, make_row: MakeRow
) -> Iterator[FigureRow]:
    """Give the bias and limits of two measurements of one quantity.

    They have intervals at the points where the run states them.
    """
    if agreement is not None and (
        c.trust == "withheld" or not abs(agreement.point_um - c.point_um) < 1e-6
    ):
        agreement = None
    intervals = (
        (None,) * 3 if agreement is None else (agreement.bias_interval, *agreement.limit_intervals)
    )
    for quantity, value, ends in zip(
        ("bias", "limit_low", "limit_high"), (c.difference_mean, *c.limits), intervals, strict=True
    ):
        low, high = ends if ends is not None and is_known(ends) else (None, None)
        yield make_row(quantity, _number(value), low=low, high=high)
    if agreement is not None and agreement.resolution_um is not None:
        yield make_row("shared_um", agreement.resolution_um, unit="um")


def _trusted(
    trust: Trust, results: Results, layers: Sequence[str], figures: Sequence[str]
) -> dict[str, Any]:
    if trust == "ok":
        return {"trust": trust}
    names = (
        c.name for c in concerned(results.checks, layers, figures) if c.state in ("look", "fail")
    )
    return {"trust": trust, "checks": "; ".join(dict.fromkeys(names))}
