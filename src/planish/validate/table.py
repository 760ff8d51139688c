"""A certificate as rows: for the terminal, for a page in Markdown, and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from planish import __version__
from planish.report.text import fixed, number
from planish.synthetic.nuisances import NUISANCES
from planish.validate.certify import Certificate
from planish.validate.figures import FIGURES, STAGES
from planish.validate.sensitivity import Sensitivity
from planish.validate.words import limit_text, row_sentence, sum_sentence, summary, unit_of, verdict

NONE = "-"
_SHORT = {
    "sections": "poses", "surfaces": "surface", "thickness": "thick", "flattening": "flat", "registration": "register",
    "resampling": "resample",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One figure in a table; numbers are written, ``met`` is None without a limit."""

    name: str
    stage: str
    title: str
    sentence: str
    unit: str
    mean: str
    sd: str
    worst: str
    limit: str
    source: str
    met: bool | None
    values: tuple[float | None, ...]
    bound: float | None


def lines(certificate: Certificate) -> list[Line]:
    """All figures in the order of the line, also those that this specimen does not have."""
    summaries, limits = certificate.summaries(), certificate.scenario.limits
    checks = {check.name: check for check in certificate.checks()}
    names = {name for entry in certificate.entries for name in entry.values} | limits.keys()
    made: list[Line] = []
    for name, figure in FIGURES.items():
        if name not in names:
            continue
        found, limit = summaries.get(name), limits.get(name)
        made.append(
            Line(
                name=name,
                stage=STAGES[figure.stage],
                title=figure.title,
                sentence=figure.sentence,
                unit=unit_of(name),
                mean=number(found.mean) if found else NONE,
                sd=number(found.sd, 2) if found and found.n > 1 else NONE,
                worst=number(found.worst) if found else NONE,
                limit=limit_text(name, limit) if limit else "",
                source=limit.source if limit else "",
                met=checks[name].met if limit else None,
                values=tuple(entry.values.get(name) for entry in certificate.entries),
                bound=(limit.limit if limit.limit is not None else limit.least) if limit else None,
            )
        )
    return made


COLUMNS = ("", "unit", "mean", "sd", "worst", "limit", "")


def terminal_rows(certificate: Certificate) -> list[tuple[str, ...]]:
    """Rows of :data:`COLUMNS`, with a row of its own for the title of each stage; ASCII but for the unit."""
    rows: list[tuple[str, ...]] = []
    stage = ""
    for line in lines(certificate):
        if line.stage != stage:
            stage = line.stage
            rows.append((stage, "", "", "", "", "", ""))
        state = {None: "", True: "met", False: "MISSED"}[line.met]
        cells = (f"  {line.title}", line.unit, line.mean, line.sd, line.worst, line.limit, state)
        rows.append(tuple(plain(cell) for cell in cells))
    return rows


def plain(text: str) -> str:
    """Write typeset numbers as a terminal or a script takes them."""
    for sign, simple in (("−", "-"), ("\u202f", " "), ("–", "-"), ("≤", "<="), ("≥", ">="), ("µm", "um")):
        text = text.replace(sign, simple)
    return text


def sensitivity_rows(table: Sensitivity) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Column titles and rows: what each nuisance adds to the key figure of each stage, and where it comes in."""
    stages = list(table.keys)
    head = ("", *(_SHORT.get(s, s) for s in stages), "suffers")

    def write(values: Mapping[str, float | None]) -> tuple[str, ...]:
        return tuple(fixed(values[s], 4 if FIGURES[table.keys[s]].unit == "1" else 2) for s in stages)

    rows = [("no nuisance", *write(table.quiet), "")]
    for row in table.rows:
        cells = ("refused",) * len(stages) if row.refusal else write(row.added)
        rows.append((NUISANCES[row.nuisance].title, *cells, STAGES[row.suffers] if row.suffers else NONE))
    rows.append(("all together", *write(table.loud), ""))
    rows.append(("sum / all", *(number(table.ratio[s], 2) for s in stages), ""))
    return head, [tuple(plain(cell) for cell in row) for row in rows]


def markdown(certificate: Certificate, table: Sensitivity | None = None) -> str:
    """The certificate as a section of Markdown."""
    scenario = certificate.scenario
    text = [f"## {scenario.title}", "", f"{verdict(certificate)} {summary(certificate)}", ""]
    text += [f"- {note}" for note in certificate.notes]
    text += [""] if certificate.notes else []
    text += [f"- Seed {entry.seed}: {entry.refusal}" for entry in certificate.entries if entry.refusal]
    text += [f"- Seed {entry.seed}, gate {gate}" for entry in certificate.entries for gate in entry.gates]
    if text[-1]:
        text.append("")
    text += ["| Stage | Figure | Unit | Mean | sd | Worst | Limit | |", "|---|---|---|---:|---:|---:|---:|---|"]
    stage = ""
    for line in lines(certificate):
        first, stage = (line.stage if line.stage != stage else ""), line.stage
        state = {None: "", True: "met", False: "**missed**"}[line.met]
        limit = f"{line.limit} ({line.source})" if line.source else line.limit
        cells = (first, line.title, line.unit, line.mean, line.sd, line.worst, limit, state)
        text.append(f"| {' | '.join(cells)} |")
    if table is not None:
        head, rows = sensitivity_rows(table)
        text += ["", "What each nuisance alone adds to the key figure of each stage, in squares:", ""]
        text += [f"| {' | '.join(head)} |", "|---|" + "---:|" * (len(head) - 2) + "---|"]
        text += [f"| {' | '.join(row)} |" for row in rows]
        text += ["", *(f"- {sum_sentence(stage, table)}" for stage in table.keys)]
    return "\n".join(text) + "\n"


def as_json(certificate: Certificate, table: Sensitivity | None = None) -> dict[str, Any]:
    """The certificate as plain numbers and sentences; no time of day and no path, so that it can be repeated."""
    scenario = certificate.scenario
    data: dict[str, Any] = {
        "planish": __version__,
        "scenario": scenario.model_dump(mode="json", by_alias=True, exclude_none=True),
        "verdict": verdict(certificate),
        "summary": summary(certificate),
        "passed": certificate.passed,
        "notes": list(certificate.notes),
        "figures": {
            name: {"stage": FIGURES[name].stage, "unit": FIGURES[name].unit, "title": FIGURES[name].title,
                   "sentence": FIGURES[name].sentence, "mean": found.mean, "sd": found.sd, "worst": found.worst,
                   "n": found.n}
            for name, found in certificate.summaries().items()
        },
        "limits": [
            {"name": check.name, "value": check.value, "met": check.met,
             **check.limit.model_dump(mode="json", by_alias=True, exclude_none=True)}
            for check in certificate.checks()
        ],
        "seeds": [
            {"seed": entry.seed, "refusal": entry.refusal, "gates": list(entry.gates), "values": entry.values}
            for entry in certificate.entries
        ],
    }  # fmt: skip
    if table is not None:
        data["sensitivity"] = asdict(table) | {
            "sentences": [*(row_sentence(row) for row in table.rows), *(sum_sentence(s, table) for s in table.keys)]
        }
        # JSON has no infinity: a sum against nothing at all has no ratio.
        data["sensitivity"]["ratio"] = {
            k: None if v is None or v == float("inf") else v for k, v in table.ratio.items()
        }
    return data
