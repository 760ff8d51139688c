"""Runs of a series read one after the other: of each, its figures as tidy rows and what a table says of it.

No run stays in memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from planish.analyze.agreement import Twice
from planish.core.checks import State, concerned
from planish.core.errors import FileError
from planish.core.facts import SIDES, Trust, is_known
from planish.core.series_results import InstrumentFacts, Member, SeriesSpecimen
from planish.report.summary import key_of
from planish.results import CorrelationRow, EvidenceFacts, LayerFacts, Results
from planish.run.run import open_results

_STATES: tuple[State, ...] = ("fail", "look", "unknown")


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureRow:
    """One figure of one specimen.

    Attributes
    ----------
    specimen : str
    factors : mapping of str
    layer, map : str
        What it is of; empty where it is of the whole run, and ``map`` where it is of a registration.
    other_layer, other_map : str
        The second of two maps that were compared.
    at_um : float or None
        Limit of a thin share, edge of the points of a correlation, longest wave of an octave.
    quantity : str
        ``mean``, ``sd``, ``p5``, ``median``, ``p95``, ``columns``, ``n_independent``, ``mean_standard_error``,
        ``support_um``, ``thin_share``, ``sa``, ``sq``, ``measured_share``; ``r``, ``r2``, ``slope``, ``points``,
        ``n_eff``, ``n_eff_interval``, ``bias``, ``limit_low``, ``limit_high``, ``shared_um``;
        ``marks_used``, ``residual``, ``leave_one_out``, ``expected_error``, ``largest_expected_error``;
        ``coefficient_of_variation``; ``checks_fail``, ``checks_look``, ``checks_unknown``, ``checks_pass``.
    value : float or None
        None where it is withheld, or cannot be stated.
    unit : str
    low, high : float or None
        Ends of its 95 % interval, where it has one.
    trust : {"ok", "doubtful", "withheld"}
    checks : str
        Names of the checks that doubt or refute it.
    """

    specimen: str
    factors: Mapping[str, str] = field(default_factory=dict[str, str])
    layer: str = ""
    map: str = ""
    other_layer: str = ""
    other_map: str = ""
    at_um: float | None = None
    quantity: str
    value: float | None
    unit: str = "1"
    low: float | None = None
    high: float | None = None
    trust: Trust = "ok"
    checks: str = ""


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
    """Specimens of a series as their runs are now.

    Attributes
    ----------
    members : tuple of Member
        With the state of the run that was read; ``damaged`` where it could not be.
    rows : list of FigureRow
    runs : dict of RunSummary
        By name, of the members whose run could be read.
    """

    members: tuple[Member, ...]
    rows: list[FigureRow] = field(default_factory=list[FigureRow])
    runs: dict[str, RunSummary] = field(default_factory=dict[str, RunSummary])

    def rows_of_series(self) -> list[FigureRow]:
        """Rows in which the only sheet and the only image of each specimen, which need no name, have none."""
        is_only_sheet = all(len(run.sheets) <= 1 for run in self.runs.values())
        is_only_image = all(len(run.images) <= 1 for run in self.runs.values())

        def name(row: FigureRow, layer: str) -> str:
            return "" if (is_only_sheet if layer in self.runs[row.specimen].sheets else is_only_image) else layer

        return [replace(row, layer=name(row, row.layer), other_layer=name(row, row.other_layer)) for row in self.rows]


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
    """
    states, rows, runs = list[Member](), list[FigureRow](), dict[str, RunSummary]()
    for timed in members:
        member = timed.model_copy(update={"seconds": None})  # of a clock: no two runs take the same
        folder = member.folder(home)
        if folder is not None and member.state not in ("refused", "damaged"):
            try:
                results = open_results(folder)
            except FileError as error:
                words = error.text.replace(str(folder), str(member.run))
                member = member.model_copy(update={"state": "damaged", "message": words})
            else:
                member = as_judged(member, results)
                rows += rows_of(member, results)
                runs[member.name] = _summary(member, results)
        states.append(member)
    return Gathered(members=tuple(states), rows=rows, runs=runs)


def as_judged(member: Member, results: Results) -> Member:
    """A member with the state of its run, and what the failed checks say where it says nothing yet."""
    if results.passed:
        return member.model_copy(update={"state": "whole"})
    failed = [f"{check.name}: {check.sentence} {check.advice}".rstrip() for check in results.checks_in("fail")]
    return member.model_copy(update={"state": "withheld", "message": member.message or " ".join(failed)})


def _summary(member: Member, results: Results) -> RunSummary:
    sheets = [layer for layer in results.layers if layer.kind == "sheet"]
    registered = [layer.registration for layer in results.moving if layer.registration is not None]
    errors = [r.expected_error.median_um for r in registered if r.expected_error is not None]
    widths = [um for layer in sheets for um in _column_widths(layer)]
    thin = results.parameters.get("correlate", {}).get("thin_um")
    kind = "layers" if results.is_link else "map"
    if results.is_link and len(results.layers) == 2 and sheets:
        kind = "two volumes" if len(sheets) == 2 else "sheet on image"
    instruments = (_instruments(member, results, e, e.twice) for e in results.evidence if e.twice is not None)
    return RunSummary(
        specimen=SeriesSpecimen(
            member=member, kind=kind, light=results.state,
            spoken={s: tuple(c.name for c in checks) for s in _STATES if (checks := results.checks_in(s))},
            marks_used=min((r.matched for r in registered), default=None),
            leave_one_out_um=_largest([r.leave_one_out_rms_um for r in registered]), expected_error_um=_largest(errors),
        ),
        sheets=tuple(layer.name for layer in sheets),
        images=tuple(layer.name for layer in results.layers if layer.kind == "image"),
        headlines=tuple(dict.fromkeys(layer.headline for layer in sheets)),
        volumes=tuple(layer.source.sha256 for layer in sheets),
        thin_um=float(thin) if isinstance(thin, int | float) else None,
        column_um=max(widths, default=None),
        instruments=tuple(facts for facts in instruments if facts is not None),
    )  # fmt: skip


def _column_widths(layer: LayerFacts) -> list[float]:
    numbers = None if layer.sheet is None else layer.sheet.numbers
    stated = [] if numbers is None else [thin.support_um for thin in numbers.thin.values()]
    return [*stated, *layer.source.size_um[1:]]


def _largest(lengths: Sequence[float | None]) -> float | None:
    """The largest of some lengths; None where one of them is missing."""
    return None if None in lengths else max((um for um in lengths if um is not None), default=None)


def _instruments(member: Member, results: Results, e: EvidenceFacts, twice: Twice) -> InstrumentFacts | None:
    """How two measurements of the map that stands for both sheets differ; None where they are of two quantities."""
    rows = [row for row in results.correlations if key_of(row) == key_of(e)]
    if is_known(twice.point_um):
        rows = [row for row in rows if abs(row.point_um - twice.point_um) <= 1e-6 * twice.point_um]
    row = max(rows, key=lambda row: row.point_um, default=None)
    if row is None or not row.same_quantity:
        return None
    figures: dict[str, Any] = {}
    if row.trust != "withheld":
        is_sloped = is_known(row.slope) and row.slope_x_on_y
        figures = {
            "bias": row.difference_mean, "bias_interval": twice.bias_interval, "limits": row.limits,
            "limit_intervals": twice.limit_intervals, "shared_um": twice.resolution_um,
            "slopes": (row.slope, 1 / row.slope_x_on_y) if is_sloped else None, "sentence": twice.sentence or "",
        }  # fmt: skip
    return InstrumentFacts(
        specimen=member.name, a=e.a, b=e.b, map=e.a_map, trust=row.trust, unit=row.units or "1", point_um=row.point_um,
        n=row.n, **figures,
    )  # fmt: skip


# --- figures as rows -------------------------------------------------------------------------------------------------


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
    figures: list[dict[str, Any]] = []
    for layer in results.layers:
        figures += _of_sheet(layer, results)
        figures += _of_registration(layer, results)
    figures += _of_pairs(results)
    for state in ("fail", "look", "unknown", "pass"):
        figures.append({"quantity": f"checks_{state}", "value": float(len(results.checks_in(state)))})
    return [FigureRow(specimen=member.name, factors=member.factors, **figure) for figure in figures]


def _of_sheet(layer: LayerFacts, results: Results) -> Iterator[dict[str, Any]]:
    sheet = layer.sheet
    if sheet is None:
        return
    numbers = sheet.numbers
    for name, p in sheet.properties.items():
        about = {"layer": layer.name, "map": name} | _trusted(p.trust, results, (layer.name,), (name,))
        for quantity in ("mean", "sd", "p5", "median", "p95"):
            yield about | {"quantity": quantity, "value": getattr(p, quantity), "unit": p.units}
        yield about | {"quantity": "columns", "value": float(p.n)}
        if p.n_independent is not None:
            yield about | {"quantity": "n_independent", "value": float(p.n_independent)}
        for quantity, unit in (("mean_standard_error", p.units), ("support_um", "um")):
            if (value := getattr(p, quantity)) is not None:
                yield about | {"quantity": quantity, "value": value, "unit": unit}
        for side in SIDES:
            thin, rough = (None, None) if numbers is None else (numbers.thin.get(side), numbers.roughness.get(side))
            if name == f"coating_{side}" and thin is not None:  # those of a withheld map are withheld as well
                for limit, share in zip(thin.thinner_than_um, thin.share, strict=True):
                    yield about | {"quantity": "thin_share", "value": share, "at_um": limit}
            if name == f"topography_{side}" and rough is not None:
                for quantity in ("sa", "sq"):
                    yield about | {"quantity": quantity, "value": getattr(rough, quantity), "unit": "um"}
    yield {"layer": layer.name, "quantity": "measured_share", "value": sheet.surfaces.shares.get("measured")}


def _of_registration(layer: LayerFacts, results: Results) -> Iterator[dict[str, Any]]:
    r = layer.registration
    if r is None:
        return
    about: dict[str, Any] = {"layer": layer.name, "other_layer": r.to}
    yield about | {"quantity": "marks_used", "value": float(r.matched)}
    yield about | {"quantity": "residual", "value": r.rms_um, "unit": "um"}
    yield about | {"quantity": "leave_one_out", "value": r.leave_one_out_rms_um, "unit": "um"}
    if (e := r.expected_error) is not None:
        about |= _trusted(e.trust, results, (layer.name,), ("position",))
        yield about | {"quantity": "expected_error", "value": e.median_um, "unit": "um"}
        yield about | {"quantity": "largest_expected_error", "value": e.largest_um, "unit": "um"}


def _of_pairs(results: Results) -> Iterator[dict[str, Any]]:
    measured_twice = {key_of(e): e.twice for e in results.evidence if e.twice is not None}
    for row in results.correlations:
        about: dict[str, Any] = {"layer": row.a, "map": row.a_map, "other_layer": row.b, "other_map": row.b_map}
        figures = (row.a_map, row.b_map, "position", "correlation")
        about |= _trusted(row.trust, results, (row.a, row.b), figures) | {"at_um": row.point_um}
        low, high = map(_number, row.interval)
        yield about | {"quantity": "r", "value": _number(row.r), "low": low, "high": high}
        for quantity in ("r2", "slope", "n", "n_eff", "n_eff_interval"):
            name = "points" if quantity == "n" else quantity
            yield about | {"quantity": name, "value": _number(float(getattr(row, quantity)))}
        if row.same_quantity:
            about["unit"] = row.units or "1"
            yield from (about | figure for figure in _differences(row, measured_twice.get(key_of(row))))
    for image in results.mottle:
        about = {"layer": image.layer, "map": "image", "quantity": "coefficient_of_variation"}
        for band in image.bands:
            yield about | {"at_um": band.longest_um, "value": band.coefficient_of_variation}


def _number(value: float) -> float | None:
    return value if is_known(value) else None


def _differences(row: CorrelationRow, twice: Twice | None) -> Iterator[dict[str, Any]]:
    """Bias and limits of two measurements of one quantity, with intervals at the points where the run states them."""
    if twice is not None and (row.trust == "withheld" or not abs(twice.point_um - row.point_um) < 1e-6):
        twice = None
    intervals = (None,) * 3 if twice is None else (twice.bias_interval, *twice.limit_intervals)
    for name, value, ends in zip(
        ("bias", "limit_low", "limit_high"), (row.difference_mean, *row.limits), intervals, strict=True
    ):
        low, high = ends if ends is not None and is_known(ends) else (None, None)
        yield {"quantity": name, "value": _number(value), "low": low, "high": high}
    if twice is not None and twice.resolution_um is not None:
        yield {"quantity": "shared_um", "value": twice.resolution_um, "unit": "um"}


def _trusted(trust: Trust, results: Results, layers: Sequence[str], figures: Sequence[str]) -> dict[str, Any]:
    """What the checks leave of a figure, and the names of those that say so."""
    if trust == "ok":
        return {"trust": trust}
    names = (c.name for c in concerned(results.checks, layers, figures) if c.state in ("look", "fail"))
    return {"trust": trust, "checks": "; ".join(dict.fromkeys(names))}
