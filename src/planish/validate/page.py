"""The certificate as one HTML file that needs nothing else, styled as the report of a run."""

from __future__ import annotations

from pathlib import Path

from planish import __version__
from planish.core.files import write_whole
from planish.report.text import template
from planish.synthetic.presets import NUISANCES, PRESETS
from planish.validate import table as tables
from planish.validate.certify import Certificate
from planish.validate.drawings import dots, draw_expected
from planish.validate.figures import FIGURES, STAGES
from planish.validate.sensitivity import Sensitivity

_GROWN = 3.0  # times the baseline: the darkest cell of the heat table


def write_page(path: Path, certificate: Certificate, table: Sensitivity | None = None) -> None:
    """Write the certificate; the same certificate gives the same bytes."""
    write_whole(path, render_page(certificate, table).encode())


def render_page(certificate: Certificate, table: Sensitivity | None = None) -> str:
    """Return the page of :func:`write_page` as text."""
    heat: list[list[tuple[str, bool]]] = []
    for row in table.rows if table is not None else ():
        shades = {stage: min(1.0, row.growth.get(stage, 0.0) / _GROWN) for stage in row.added}
        heat.append([(f"{shade:.3f}", row.suffers == stage) for stage, shade in shades.items()])
    scenario, entries = certificate.scenario, certificate.entries
    page = template("planish.validate", "certificate.html.j2").render(
        certificate=certificate, scenario=scenario, params=scenario.params(0), lines=certificate.lines(), table=table,
        heat=heat, tables=tables, dots=dots, stages=STAGES, described=FIGURES, presets=PRESETS, version=__version__,
        nuisances=[NUISANCES[name].title for name in scenario.active], expected=draw_expected(entries),
        pictures=next((entry.pictures for entry in entries if entry.pictures), ()),
    )  # fmt: skip
    return f"{page}\n"
