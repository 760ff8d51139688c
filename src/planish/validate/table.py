"""A certificate as rows and sentences: for the terminal, for a page in Markdown, and as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from planish import __version__
from planish.report.text import fixed, length, number, percent
from planish.synthetic.nuisances import NUISANCES
from planish.validate.certify import Certificate, Check, Summary
from planish.validate.figures import FIGURES, STAGES
from planish.validate.scenario import Limit
from planish.validate.sensitivity import Row, Sensitivity

NONE = "-"
_UNITS = {"um": "µm", "deg": "°", "1": ""}
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
        text += ["", *(f"- {sentence}" for sentence in sensitivity_sentences(table)[len(table.rows) :])]
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
        data["sensitivity"] = asdict(table) | {"sentences": sensitivity_sentences(table)}
        # JSON has no infinity: a sum against nothing at all has no ratio.
        data["sensitivity"]["ratio"] = {
            k: None if v is None or v == float("inf") else v for k, v in table.ratio.items()
        }
    return data


def unit_of(name: str) -> str:
    """Unit of a figure as it is written."""
    unit = FIGURES[name].unit
    return _UNITS.get(unit, unit)


def verdict(certificate: Certificate) -> str:
    """What a user may expect, in one or two sentences."""
    found = certificate.summaries()
    if certificate.scenario.kind == "mesh":
        return _mesh_verdict(found)
    if not found:
        return "The program gave no result on specimens like these."
    said: list[str] = []
    if certificate.scenario.kind == "pair":
        return (
            f"Two volumes of one sheet, linked through their maps: a point is off by {_um(found['pair_median'])} "
            f"(median), {_um(found['pair_p95'])} (95 %)."
        )
    if "tre_median" in found and "tre_p95" in found:
        said.append(
            f"On specimens like these a point of the map is off by {_um(found['tre_median'])} (median), "
            f"{_um(found['tre_p95'])} (95 %)."
        )
    parts = [
        f"{what} by {_um(found[name])}"
        for name, what in (
            ("pixel_coating_top_rmse", "the coating's thickness"),
            ("pixel_base_thickness_rmse", "that of the base paper"),
            ("pixel_thickness_rmse", "that of the sheet"),
        )
        if name in found
    ]
    if parts:
        said.append(f"At a pixel {', '.join(parts)} (rms).".replace(" by ", " is off by ", 1))
    return " ".join(said) or "The maps of specimens like these were made, but not linked to an image."


def _mesh_verdict(found: dict[str, Summary]) -> str:
    worst = [abs(found[name].worst) for name in ("mesh_width", "mesh_height", "mesh_aspect") if name in found]
    if not worst:
        return "The mesh came to no rest."
    return (
        f"The deformed mesh of Fig. 5 comes back to its size within {percent(max(worst) / 100, 2)}, "
        f"in {number(found['mesh_seconds'].mean, 2)} s."
    )


def summary(certificate: Certificate) -> str:
    """How many specimens came through and how many limits are met."""
    entries, checks = certificate.entries, certificate.checks()
    n = len(entries)
    word = "deformation" if certificate.scenario.kind == "mesh" else "specimen"
    said: list[str] = []
    refused = sum(entry.refusal is not None for entry in entries)
    gated = sum(bool(entry.gates) for entry in entries)
    if refused:
        said.append(f"On {refused} of {n} {word}s the program gave no result.")
    if gated:
        said.append(f"On {gated} of {n} {word}s a quality gate of the run failed.")
    missed = [check for check in checks if not check.met]
    if not checks:
        said.append("The scenario sets no limits.")
    elif missed:
        said.append(f"{len(missed)} of {len(checks)} limits {'is' if len(missed) == 1 else 'are'} missed.")
    else:
        left = n - refused
        of = f"the one {word}" if n == 1 else f"all {n} {word}s" if left == n else f"the {word}s with a result"
        said.append(f"All {len(checks)} limits are met by {of}.")
    return " ".join(said)


def check_sentence(check: Check) -> str:
    """Write one limit and how it stands."""
    figure = FIGURES[check.name]
    start = f"{STAGES[figure.stage]}, {figure.title}"
    if check.value is None:
        return f"{start}: could not be measured; {limit_text(check.name, check.limit)} is asked for."
    end = "" if check.met else ": missed"
    return f"{start}: {with_unit(check.name, check.value)}, {limit_text(check.name, check.limit)} asked for{end}."


def limit_text(name: str, limit: Limit) -> str:
    """Write a limit with its sign and unit."""
    if limit.limit is not None:
        return f"≤ {with_unit(name, limit.limit)}"
    return f"≥ {with_unit(name, limit.least or 0.0)}"


def with_unit(name: str, value: float) -> str:
    """Write a figure's value with its unit."""
    unit = unit_of(name)
    return f"{number(value)}\u202f{unit}" if unit else number(value)


def sensitivity_sentences(table: Sensitivity) -> list[str]:
    """Which stage each nuisance harms, then whether the single errors of each stage add up."""
    return [*(row_sentence(row) for row in table.rows), *(sum_sentence(stage, table) for stage in table.keys)]


def row_sentence(row: Row) -> str:
    """Say which stage one nuisance alone harms."""
    title = NUISANCES[row.nuisance].title
    if row.refusal is not None:
        return f"{title}: the program gives no result. {row.refusal}"
    if row.suffers is None:
        return f"{title}: no stage notices."
    return f"{title}: {STAGES[row.suffers].lower()} suffers first."


def sum_sentence(stage: str, table: Sensitivity) -> str:
    """Say whether the errors of single nuisances add up to that of all together."""
    ratio, title = table.ratio[stage], STAGES[stage]
    if ratio is None:
        return f"{title}: all nuisances together add next to nothing."
    start = f"{title}: the single errors, summed as squares, are {number(ratio, 2)} times what all together add"
    names = table.together.get(stage)
    if names is None:
        return f"{start}; they act independently."
    if len(names) < 2:
        return f"{start}; they do not act independently."
    pair = ", then ".join(NUISANCES[name].title for name in names)
    return f"{start}; they do not act independently. What changes most when it is left out: {pair}."


def _um(found: Summary) -> str:
    return length(found.mean, 2)
