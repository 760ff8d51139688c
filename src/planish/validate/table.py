"""A certificate as rows and sentences: for the terminal, for a page in Markdown, and as JSON."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby
from typing import Any

from planish import __version__
from planish.core.numbers import fixed, in_ascii, length, number, percent, unit
from planish.synthetic.presets import NUISANCES
from planish.validate.certify import Certificate, Entry, LedgerLine, NuisanceRow, Sensitivity
from planish.validate.scenario import FIGURES, STAGES, Figure, Values, without_none

NONE = "-"
STATES = {None: "", True: "met", False: "missed"}
COLUMNS = ("", "unit", "mean", "sd", "worst", "limit", "")
_SHORT = {
    "sections": "poses",
    "surfaces": "surface",
    "thickness": "thick",
    "flattening": "flat",
    "registration": "register",
    "resampling": "resample",
}
_VERDICTS = {
    "line": (
        "On specimens like these a point of the map is off by {tre_median} (median), {tre_p95}"
        " (95 %)."
    ),
    "pair": (
        "Two volumes of one sheet, linked through their maps: a point is off by {pair_median}"
        " (median), {pair_p95} (95 %)."
    ),
}
_THICKNESSES = {
    "pixel_coating_top_rmse": "the coating's thickness",
    "pixel_base_thickness_rmse": "that of the base paper",
    "pixel_thickness_rmse": "that of the sheet",
}


def by_stage(certificate: Certificate) -> list[tuple[str, list[LedgerLine]]]:
    """Return all figures by the title of their stage, in the order of the line.

    Those that no specimen has are included.
    """
    groups = groupby(certificate.lines().values(), key=lambda line: line.figure.stage)
    return [(STAGES[stage], list(group)) for stage, group in groups]


def cells(line: LedgerLine) -> tuple[str, ...]:
    """Return title, unit, mean, standard deviation, worst value, limit and state, as written."""
    values = ((line.mean, 3), (line.sd, 2), (line.worst, 3))
    numbers = [NONE if value is None else number(value, digits) for value, digits in values]
    units = unit(line.figure.unit)
    return line.figure.title, units, *numbers, limit_text(line), STATES[line.met]


def terminal_rows(certificate: Certificate) -> list[tuple[str, ...]]:
    """Rows of :data:`COLUMNS`, with a row of its own for the title of each stage, in ASCII."""
    rows: list[tuple[str, ...]] = []
    for stage, group in by_stage(certificate):
        rows.append((stage, *[""] * (len(COLUMNS) - 1)))
        for line in group:
            title, *middle, state = map(in_ascii, cells(line))
            if line.met is False:
                state = state.upper()
            rows.append((f"  {title}", *middle, state))
    return rows


def sensitivity_rows(table: Sensitivity) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return column titles and rows: what each nuisance adds to the key figure of each stage.

    The rows also say where it comes in.
    """
    rows = [("no nuisance", *_key_cells(dict(table.quiet), table.keys), "")]
    for row in table.rows:
        added_cells = ["refused"] * len(table.keys)
        if not row.refusal:
            added_cells = _key_cells(row.added, table.keys)
        suffers = STAGES[row.suffers] if row.suffers else NONE
        rows.append((NUISANCES[row.nuisance].title, *added_cells, suffers))
    rows.append(("all together", *_key_cells(table.loud, table.keys), ""))
    ratios = [number(table.ratio[stage], 2) for stage in table.keys]
    rows.append(("sum / all", *ratios, ""))
    titles = [_SHORT.get(stage, stage) for stage in table.keys]
    heading = ("", *titles, "suffers")
    return heading, [tuple(map(in_ascii, row)) for row in rows]


def _key_cells(values: Values, keys: dict[str, str]) -> list[str]:
    """Value of each stage, with the decimals of its key figure."""
    written: list[str] = []
    for stage, name in keys.items():
        decimals = 4 if FIGURES[name].unit == "1" else 2
        written.append(fixed(values[stage], decimals))
    return written


def markdown(certificate: Certificate, table: Sensitivity | None = None) -> str:
    """The certificate as a section of Markdown.

    It has a row for each figure, with the title of its stage in the first one, and below that
    table what each nuisance does where ``table`` is given.
    """
    sentences = f"{verdict(certificate)} {summary(certificate)}"
    lines = [f"## {certificate.scenario.title}", "", sentences, ""]
    for bullets in (certificate.notes, _fault_texts(certificate.entries)):
        if bullets:
            lines += [*(f"- {bullet}" for bullet in bullets), ""]
    lines.append("| Stage | Figure | Unit | Mean | sd | Worst | Limit | |")
    lines.append("|---|---|---|---:|---:|---:|---:|---|")
    for stage, group in by_stage(certificate):
        titles = [stage, *[""] * (len(group) - 1)]
        rows = zip(titles, map(_figure_cells, group), strict=True)
        lines += [_table_line([title, *row]) for title, row in rows]
    if table is not None:
        lines += _sensitivity_lines(table)
    return "\n".join(lines) + "\n"


def _fault_texts(entries: Sequence[Entry]) -> list[str]:
    texts = [f"Seed {entry.seed}: {entry.refusal}" for entry in entries if entry.refusal]
    for entry in entries:
        texts += [f"Seed {entry.seed}, failed: {check}" for check in entry.failed]
    return texts


def _sensitivity_lines(table: Sensitivity) -> list[str]:
    heading, rows = sensitivity_rows(table)
    sentences = [f"- {sum_sentence(stage, table)}" for stage in table.keys]
    return [
        "",
        "What each nuisance alone adds to the key figure of each stage, in squares:",
        "",
        _table_line(heading),
        "|---|" + "---:|" * (len(heading) - 2) + "---|",
        *map(_table_line, rows),
        "",
        *sentences,
    ]


def _figure_cells(line: LedgerLine) -> list[str]:
    """Cells of a figure, with the source of its limit, and bold where it is missed."""
    *row, limit, state = cells(line)
    if line.limit and line.limit.source:
        limit = f"{limit} ({line.limit.source})"
    return [*row, limit, f"**{state}**" if line.met is False else state]


def _table_line(row: Sequence[str]) -> str:
    return f"| {' | '.join(row)} |"


def as_json(certificate: Certificate, table: Sensitivity | None = None) -> dict[str, Any]:
    """The certificate as plain numbers and sentences.

    No time of day and no path, so that it can be repeated.
    """
    lines = certificate.lines()
    options: dict[str, Any] = {"mode": "json", "by_alias": True, "exclude_none": True}
    limits: list[dict[str, Any]] = []
    for name, limit in certificate.scenario.limits.items():
        outcome = {"name": name, "value": lines[name].worst, "met": lines[name].met}
        limits.append(outcome | limit.model_dump(**options))
    data: dict[str, Any] = {
        "planish": __version__,
        "scenario": certificate.scenario.model_dump(**options),
        "verdict": verdict(certificate),
        "summary": summary(certificate),
        "passed": certificate.passed,
        "notes": list(certificate.notes),
        "figures": {name: _figure_json(line) for name, line in lines.items() if line.measured},
        "limits": limits,
        "seeds": [_entry_json(entry) for entry in certificate.entries],
    }
    if table is not None:
        # JSON has no infinity: a sum against nothing at all has no ratio.
        ratio = {stage: None if r == float("inf") else r for stage, r in table.ratio.items()}
        sentences = sensitivity_sentences(table)
        data["sensitivity"] = asdict(table) | {"ratio": ratio, "sentences": sentences}
    return data


def _entry_json(entry: Entry) -> dict[str, Any]:
    return {
        "seed": entry.seed,
        "refusal": entry.refusal,
        "failed": list(entry.failed),
        "looks": list(entry.looks),
        "values": entry.values,
    }


def _figure_json(line: LedgerLine) -> dict[str, Any]:
    figure = line.figure._asdict()
    del figure["name"], figure["better"]
    numbers = {"mean": line.mean, "sd": line.sd or 0.0, "worst": line.worst}
    return {**figure, **numbers, "n": len(line.measured)}


def _mesh_verdict(lines: dict[str, LedgerLine]) -> str:
    names = ("mesh_width", "mesh_height", "mesh_aspect")
    worst = [lines[name].worst for name in names if name in lines]
    errors = [abs(value) for value in worst if value is not None]
    if not errors:
        return "The mesh came to no rest."
    return (
        "The deformed mesh of Fig. 5 comes back to its size within"
        f" {percent(max(errors) / 100, 2)}, in {number(lines['mesh_seconds'].mean, 2)} s."
    )


def verdict(certificate: Certificate) -> str:
    """Say in one or two sentences which errors a user may expect: means over the specimens."""
    lines = certificate.lines()
    if certificate.scenario.kind == "mesh":
        return _mesh_verdict(lines)
    means = without_none({name: line.mean for name, line in lines.items()})
    if not means:
        return "The program gave no result on specimens like these."
    sentences = list[str]()
    length_texts = {name: length(mean, 2) for name, mean in means.items()}
    if {"tre_median", "pair_median"} & means.keys():
        sentences.append(_VERDICTS[certificate.scenario.kind].format_map(length_texts))
    clauses = [
        f"{thickness_name} by {length_texts[name]}"
        for name, thickness_name in _THICKNESSES.items()
        if name in means
    ]
    if clauses:
        clauses_text = ", ".join(clauses).replace(" by ", " is off by ", 1)
        sentences.append(f"At a pixel {clauses_text} (rms).")
    if not sentences:
        return "The maps of specimens like these were made, but not linked to an image."
    return " ".join(sentences)


def summary(certificate: Certificate) -> str:
    """Count the specimens that came through and the limits that are met, in sentences."""
    entries = certificate.entries
    n = len(entries)
    limits_met = [line.met for line in certificate.lines().values() if line.met is not None]
    noun = "deformation" if certificate.scenario.kind == "mesh" else "specimen"
    refused = sum(bool(entry.refusal) for entry in entries)
    failed = sum(bool(entry.failed) for entry in entries)
    sentences: list[str] = []
    if refused:
        sentences.append(f"On {refused} of {n} {noun}s the program gave no result.")
    if failed:
        sentences.append(f"On {failed} of {n} {noun}s a check of the run failed.")
    specimens_text = f"the one {noun}" if n == 1 else f"all {n} {noun}s"
    if refused:
        specimens_text = f"the {noun}s with a result"
    return " ".join([*sentences, _limits_sentence(limits_met, specimens_text)])


def _limits_sentence(limits_met: Sequence[bool], specimens_text: str) -> str:
    if not limits_met:
        return "The scenario sets no limits."
    missed = limits_met.count(False)
    verb = "is" if missed == 1 else "are"
    if missed:
        return f"{missed} of {len(limits_met)} limits {verb} missed."
    return f"All {len(limits_met)} limits are met by {specimens_text}."


def limit_sentence(line: LedgerLine) -> str:
    """Write one limit and whether it is met."""
    title_text = f"{STAGES[line.figure.stage]}, {line.figure.title}"
    required_text = limit_text(line)
    if line.worst is None:
        return f"{title_text}: could not be measured; {required_text} is required."
    return (
        f"{title_text}: {with_unit(line.figure, line.worst)}, {required_text}"
        f" required{'' if line.met else ': missed'}."
    )


def limit_text(line: LedgerLine) -> str:
    """Write the limit of a figure with its sign and unit; empty without one."""
    if line.limit is None:
        return ""
    sign = "≥" if line.limit.limit is None else "≤"
    return f"{sign} {with_unit(line.figure, line.limit.bound)}"


def with_unit(figure: Figure, value: float | None) -> str:
    """Write a figure's value with its unit."""
    units = unit(figure.unit)
    return f"{number(value)}\u202f{units}" if units else number(value)


def sensitivity_sentences(table: Sensitivity) -> list[str]:
    """Name the stage each nuisance harms, then say of each stage if its single errors add up."""
    sums = [sum_sentence(stage, table) for stage in table.keys]
    return [*map(row_sentence, table.rows), *sums]


def row_sentence(row: NuisanceRow) -> str:
    """Say which stage one nuisance alone harms."""
    title = NUISANCES[row.nuisance].title
    if row.refusal is not None:
        return f"{title}: the program gives no result. {row.refusal}"
    if row.suffers is None:
        return f"{title}: no stage notices."
    return f"{title}: {STAGES[row.suffers].lower()} suffers first."


def sum_sentence(stage: str, table: Sensitivity) -> str:
    """Say whether the errors of single nuisances add up to that of all together.

    A stage has names in ``table.together`` where they do not: of the nuisances whose leaving out
    changes most.
    """
    ratio = table.ratio[stage]
    title = STAGES[stage]
    names = table.together.get(stage)
    if ratio is None:
        return f"{title}: all nuisances together add next to nothing."
    if not math.isfinite(ratio):
        return (
            f"{title}: all nuisances together add nothing, although single ones do; they do not act"
            " independently."
        )
    text = (
        f"{title}: the single errors, summed as squares, are {number(ratio, 2)} times what all"
        f" together add; they {'act' if names is None else 'do not act'} independently."
    )
    if not names:
        return text
    pair = ", then ".join(NUISANCES[name].title for name in names)
    return f"{text} What changes most when it is left out: {pair}."
