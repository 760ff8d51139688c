"""What a certificate says, in sentences."""

from __future__ import annotations

from planish.report.text import length, number, percent
from planish.synthetic.nuisances import NUISANCES
from planish.validate.certify import Certificate, Check, Summary
from planish.validate.figures import FIGURES, STAGES
from planish.validate.scenario import Limit
from planish.validate.sensitivity import Row, Sensitivity

_UNITS = {"um": "µm", "deg": "°", "1": ""}


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
