"""The certificate as one HTML file that needs nothing else, styled as the report of a run."""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from planish import __version__
from planish.report.text import number
from planish.synthetic.nuisances import NUISANCES
from planish.synthetic.params import SIZES_UM
from planish.synthetic.presets import PRESETS
from planish.validate.certify import Certificate
from planish.validate.drawings import dots, draw_example, draw_expected
from planish.validate.figures import FIGURES, STAGES
from planish.validate.scenario import ALL, NONE, Scenario
from planish.validate.sensitivity import Row, Sensitivity
from planish.validate.table import Line, lines, row_sentence, sum_sentence, summary, unit_of, verdict, with_unit

_INSTRUMENTS = {
    "stack": "volume as one TIFF stack",
    "scanner": "folder of a scanner's reconstructed slices, rows through the sheet",
    "sections": "folder of photographs of serial sections",
}
_TILES = (
    ("tre_median", "error of a point, median"),
    ("tre_p95", "error of a point, 95 %"),
    ("pixel_coating_top_rmse", "coating thickness, rms"),
    ("pixel_thickness_rmse", "sheet thickness, rms"),
    ("mesh_width", "width of the mesh"),
    ("mesh_height", "height of the mesh"),
    ("mesh_cylinder", "cylinder, largest node error"),
    ("mesh_seconds", "time to rest"),
)
_GROWN = 3.0  # times the baseline: the darkest cell of the heat table


def write_page(path: Path, certificate: Certificate, table: Sensitivity | None = None) -> None:
    """Write the certificate; the same certificate gives the same bytes."""
    path.write_bytes(render_page(certificate, table).encode("utf-8"))


def render_page(certificate: Certificate, table: Sensitivity | None = None) -> str:
    """Return the page of :func:`write_page` as text."""
    scenario = certificate.scenario
    pictures = draw_example(certificate.example) if certificate.example is not None else []
    expected = draw_expected(certificate)
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    text = files("planish.validate").joinpath("templates/certificate.html.j2").read_text(encoding="utf-8")
    page = environment.from_string(text).render(
        style=Markup(_style()),
        scenario=scenario,
        facts=facts(scenario, certificate),
        notes=certificate.notes,
        verdict=verdict(certificate),
        summary=summary(certificate),
        passed=certificate.passed,
        tiles=_tiles(certificate),
        ledger=_by_stage(certificate),
        dots=_dots,
        entries=certificate.entries,
        outcomes=[entry for entry in certificate.entries if not entry.whole],
        expected=expected,
        pictures=pictures,
        table=table,
        heat=_heat(table) if table is not None else [],
        heat_stages=[(STAGES[s], FIGURES[n].title, unit_of(n)) for s, n in table.keys.items()] if table else [],
        quiet=[number(v, 2) for v in table.quiet.values()] if table else [],
        loud=[number(v, 2) for v in table.loud.values()] if table else [],
        ratio=[number(v, 2) for v in table.ratio.values()] if table else [],
        sums=[sum_sentence(stage, table) for stage in table.keys] if table else [],
        version=__version__,
    )
    return f"{page}\n"


def facts(scenario: Scenario, certificate: Certificate) -> list[tuple[str, str]]:
    """What was made and how it was measured."""
    seeds = ", ".join(str(entry.seed) for entry in certificate.entries)
    if scenario.kind == "mesh":
        return [("Mesh", "32 x 24 nodes, rows and nodes displaced at random"), ("Seeds", seeds)]
    params = scenario.params(0)
    width, height = SIZES_UM[scenario.size] if isinstance(scenario.size, str) else scenario.size
    chosen = scenario.nuisances
    on = {ALL: "all of the scenario", NONE: "none"}.get(chosen, "") if isinstance(chosen, str) else ""
    listed = ", ".join(NUISANCES[name].title for name in scenario.active)
    sections = scenario.instrument == "sections"
    voxel = (
        f"sections every {params.sections.section_um:g} µm, pixels of {params.sections.pixel_um:g} µm"
        if sections
        else f"voxels of {params.scanner.voxel_um:g} µm"
    )
    return [
        ("Paper", "as in the given run" if certificate.notes else f"{scenario.preset}: {PRESETS[scenario.preset][0]}"),
        ("Field", f"{width / 1000:g} x {height / 1000:g} mm"),
        ("Volume", f"{_INSTRUMENTS[scenario.instrument]}; {voxel}"),
        ("Image", f"pixels of {params.camera.pixel_um:g} µm"),
        ("Nuisances", f"{on + ': ' if on else ''}{listed}" if listed else on),
        ("Seeds", seeds),
    ]


def _style() -> str:
    """The look of the report of a run, so that there is one place where it is made."""
    return files("planish.report").joinpath("templates/style.css").read_text(encoding="utf-8")


def _tiles(certificate: Certificate) -> list[dict[str, str]]:
    """Some numbers large, with what they are."""
    found = certificate.summaries()
    return [
        {"value": number(found[name].mean, 2), "unit": unit_of(name), "label": label,
         "note": f"mean of {found[name].n}; worst {with_unit(name, found[name].worst)}"}
        for name, label in _TILES if name in found
    ][:4]  # fmt: skip


def _by_stage(certificate: Certificate) -> list[tuple[str, list[Line]]]:
    groups: dict[str, list[Line]] = {}
    for line in lines(certificate):
        # The rms and 95 % of an error are of what the line above them says.
        shown = replace(line, sentence="") if line.name.endswith(("_rmse", "_p95")) and _bias_of(line.name) else line
        groups.setdefault(line.stage, []).append(shown)
    return list(groups.items())


def _dots(line: Line) -> Markup:
    return Markup(dots(line.values, line.bound))  # made of numbers only


def _bias_of(name: str) -> bool:
    return f"{name.rpartition('_')[0]}_bias" in FIGURES


def _heat(table: Sensitivity) -> list[dict[str, Any]]:
    """Rows of the heat table: of each cell its number, how dark it is (0 to 1), and whether this stage suffers."""

    def cell(row: Row, stage: str) -> dict[str, Any]:
        heat = min(1.0, (row.growth[stage] or 0.0) / _GROWN)
        return {"text": number(row.added[stage], 2), "heat": round(heat, 3), "suffers": row.suffers == stage}

    return [
        {"title": NUISANCES[row.nuisance].title, "cells": [cell(row, stage) for stage in table.keys],
         "suffers": "no result" if row.refusal else STAGES[row.suffers] if row.suffers else "–",
         "sentence": row_sentence(row)}
        for row in table.rows
    ]  # fmt: skip
