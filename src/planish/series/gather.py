"""Runs of a series read one after the other: of each, its rows and what a table says of it. No run stays in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from planish.core.checks import State
from planish.core.errors import FileError
from planish.core.facts import is_known
from planish.core.series_results import InstrumentFacts, Member, RunKind
from planish.pipeline.run import open_results
from planish.results import CorrelationRow, LayerFacts, Results
from planish.series.rows import Row, rows_of

_STATES: tuple[State, ...] = ("fail", "look", "unknown")


@dataclass(frozen=True, slots=True, kw_only=True)
class Brief:
    """What a series keeps of a run beside its rows.

    Attributes
    ----------
    kind : {"map", "sheet on image", "two volumes", "layers"}
    sheets, images : tuple of str
        Names of the layers of either kind.
    headlines : tuple of str
        Maps that stand for its sheets.
    volumes : tuple of str
        Hashes of the volumes.
    light : State
        Worst state of its checks.
    spoken : dict
        Names of the checks that are not passed, by state.
    marks_used, leave_one_out_um, expected_error_um
        Of the worst of its layers.
    thin_um : float or None
        Limit of the study for thin regions.
    column_um : float or None
        Width of a column, where thin shares state it; of a voxel otherwise.
    instruments : tuple of InstrumentFacts
        Of two volumes.
    """

    kind: RunKind
    sheets: tuple[str, ...]
    images: tuple[str, ...]
    headlines: tuple[str, ...]
    volumes: tuple[str, ...]
    light: State
    spoken: dict[State, tuple[str, ...]]
    marks_used: int | None
    leave_one_out_um: float | None
    expected_error_um: float | None
    thin_um: float | None
    column_um: float | None
    instruments: tuple[InstrumentFacts, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Gathered:
    """Specimens of a series as their runs are now.

    Attributes
    ----------
    members : tuple of Member
        With the state of the run that was read; ``damaged`` where it could not be.
    rows : list of Row
    briefs : dict of Brief
        By name, of the members whose run could be read.
    """

    members: tuple[Member, ...]
    rows: list[Row] = field(default_factory=list[Row])
    briefs: dict[str, Brief] = field(default_factory=dict[str, Brief])


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
    found, rows, briefs = list[Member](), list[Row](), dict[str, Brief]()
    for given in members:
        member = given.model_copy(update={"seconds": None})  # of a clock: no two runs take the same
        folder = member.folder(home)
        if folder is None or member.state in ("refused", "damaged"):
            found.append(member)
            continue
        try:
            results = open_results(folder)
        except FileError as error:
            words = error.text.replace(str(folder), str(member.run))
            found.append(member.model_copy(update={"state": "damaged", "message": words}))
            continue
        found.append(_judged(member, results))
        rows += rows_of(member, results)
        briefs[member.name] = _brief(member, results)
    return Gathered(members=tuple(found), rows=rows, briefs=briefs)


def _judged(member: Member, results: Results) -> Member:
    """A member with the state of its run, and what a failed check says where it says nothing yet."""
    if results.passed:
        return member.model_copy(update={"state": "whole"})
    failed = [f"{c.name}: {c.sentence} {c.advice}".strip() for c in results.spoken("fail")]
    return member.model_copy(update={"state": "withheld", "message": member.message or " ".join(failed)})


def _brief(member: Member, results: Results) -> Brief:
    sheets = [layer for layer in results.layers if layer.kind == "sheet"]
    images = [layer for layer in results.layers if layer.kind == "image"]
    registered = [layer.registration for layer in results.moving if layer.registration is not None]
    errors = [r.expected_error.median_um for r in registered if r.expected_error is not None]
    thin = results.parameters.get("correlate", {}).get("thin_um")
    return Brief(
        kind=_kind(results, sheets),
        sheets=tuple(layer.name for layer in sheets),
        images=tuple(layer.name for layer in images),
        headlines=tuple(dict.fromkeys(layer.headline for layer in sheets)),
        volumes=tuple(layer.source.sha256 for layer in sheets),
        light=results.state,
        spoken={s: tuple(c.name for c in found) for s in _STATES if (found := results.spoken(s))},
        marks_used=min((r.matched for r in registered), default=None),
        leave_one_out_um=_largest([r.leave_one_out_rms_um for r in registered]),
        expected_error_um=_largest(errors),
        thin_um=float(thin) if isinstance(thin, int | float) else None,
        column_um=max((um for layer in sheets if (um := _column_um(layer)) is not None), default=None),
        instruments=tuple(_instruments(member, results)),
    )


def _kind(results: Results, sheets: Sequence[LayerFacts]) -> RunKind:
    if not results.is_link:
        return "map"
    if len(results.layers) == 2 and sheets:
        return "two volumes" if len(sheets) == 2 else "sheet on image"
    return "layers"


def _column_um(layer: LayerFacts) -> float | None:
    """Width of a column, where thin shares state it; of a voxel otherwise."""
    numbers = None if layer.sheet is None else layer.sheet.numbers
    stated = [] if numbers is None else [thin.support_um for thin in numbers.thin.values()]
    return max([*stated, *layer.source.size_um[1:]], default=None)


def _largest(values: Sequence[float | None]) -> float | None:
    """The largest of some values; None where one is not known."""
    known = [v for v in values if v is not None]
    return max(known) if known and len(known) == len(values) else None


def _instruments(member: Member, results: Results) -> list[InstrumentFacts]:
    """How two measurements of the map that stands for both sheets differ."""
    found: list[InstrumentFacts] = []
    for e in results.evidence:
        row = _row(results, (e.a, e.a_map, e.b, e.b_map), None if e.twice is None else e.twice.point_um)
        if e.twice is None or row is None or not row.same_quantity:
            continue
        about = {"specimen": member.name, "a": e.a, "b": e.b, "map": e.a_map, "trust": row.trust}
        about |= {"unit": row.units or "1", "point_um": row.point_um, "n": row.n}
        if row.trust == "withheld":
            found.append(InstrumentFacts.model_validate(about))
            continue
        slopes = (row.slope, 1 / row.slope_x_on_y) if is_known(row.slope) and row.slope_x_on_y else None
        found.append(
            InstrumentFacts.model_validate(
                about
                | {
                    "bias": row.difference_mean,
                    "bias_interval": e.twice.bias_interval,
                    "limits": row.limits,
                    "limit_intervals": e.twice.limit_intervals,
                    "slopes": slopes,
                    "shared_um": e.twice.resolution_um,
                    "sentence": e.twice.sentence or "",
                }
            )
        )
    return found


def _row(results: Results, key: tuple[str, str, str, str], point_um: float | None) -> CorrelationRow | None:
    """The correlation of a pair at a point size, or at the largest one."""
    rows = [row for row in results.correlations if (row.a, row.a_map, row.b, row.b_map) == key]
    if point_um is not None and is_known(point_um):
        rows = [row for row in rows if abs(row.point_um - point_um) <= 1e-6 * point_um]
    return max(rows, key=lambda row: row.point_um, default=None)
