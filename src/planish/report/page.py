"""One page from one run: figures and tables put into the template, with nothing outside the file."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import xarray as xr
from jinja2 import Environment, StrictUndefined

from planish.report import tables
from planish.report.draw import Picture, house_style
from planish.report.flattening import draw_curvature, draw_progress
from planish.report.maps import draw_maps
from planish.report.registration import draw_outlines, draw_registration
from planish.report.relation import draw_relation
from planish.report.slices import draw_slices
from planish.report.text import in_words
from planish.report.verdict import give_verdict
from planish.report.warp import draw_strain, draw_warp


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of the page: its name in addresses, its title in the list of contents."""

    name: str
    title: str


_SECTIONS = (
    Section(name="inputs", title="What went in"),
    Section(name="slices", title="Slices and surfaces"),
    Section(name="flattening", title="Warp and flattening"),
    Section(name="maps", title="Property maps"),
    Section(name="registration", title="Registration"),
    Section(name="outlines", title="Thin regions on the image"),
    Section(name="relation", title="Property and image, point by point"),
    Section(name="comparison", title="What flattening is for"),
    Section(name="record", title="Parameters, versions, method"),
)
_LINK_ONLY = {"registration", "outlines", "relation", "comparison"}


def write_report(
    path: Path, *, groups: dict[str, xr.Dataset], marks: xr.Dataset | None, results: dict[str, Any]
) -> None:
    """Write the report of a run as one HTML file that needs nothing else.

    Parameters
    ----------
    path : Path
    groups : dict of Dataset
        ``surfaces`` and ``flat`` (y, x), ``strain`` (row, col), ``maps`` (v, u), ``slices``, and after a link
        ``linked`` (y, x of the image).
    marks : Dataset (mark) or None
        Pairs of marks with their residuals; None without a link.
    results : dict
        The numbers of the run.

    Notes
    -----
    The same input gives the same bytes: no dates, no random names.
    """
    path.write_bytes(render_report(groups=groups, marks=marks, results=results).encode("utf-8"))


def render_report(*, groups: dict[str, xr.Dataset], marks: xr.Dataset | None, results: dict[str, Any]) -> str:
    """Return the page of :func:`write_report` as text."""
    linked = groups.get("linked") if tables.is_link(results) else None
    names = tables.long_names(groups)
    with house_style():
        pictures = _pictures(groups, linked, marks, results)
    sections = [s for s in _SECTIONS if linked is not None or s.name not in _LINK_ONLY]
    inputs = tables.inputs(results)
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string(
        files("planish.report").joinpath("templates/report.html.j2").read_text(encoding="utf-8")
    )
    page = template.render(
        linked=linked is not None,
        sections=sections,
        pictures=pictures,
        inputs=inputs,
        verdict=give_verdict(results, names),
        gates=tables.gates(results),
        surfaces=results["surfaces"],
        joined=tables.joined(results),
        columns=tables.columns(results),
        flattening=tables.flattening(results, groups["surfaces"]),
        properties=tables.properties(results, names),
        further=tables.further(results, names),
        numbers=tables.numbers(results),
        mark_rows=tables.mark_rows(marks) if marks is not None and linked is not None else [],
        transform=tables.transform(results) if linked is not None else [],
        match_sentence=str(results["marks"].get("sentence", "")) if linked is not None else "",
        compare=tables.compare(results) if linked is not None else [],
        compare_sentence=tables.compare_sentence(results) if linked is not None else "",
        correlations=tables.correlations(results, names) if linked is not None else [],
        point_sizes=tables.point_sizes(results) if linked is not None else [],
        headline=in_words(names.get(str(results.get("headline")), "")),
        greys=tables.greys(results),
        parameters=tables.parameters(results),
        versions={"planish": results["planish"], **results.get("versions", {})},
        method=tables.METHOD,
    )
    return f"{page}\n"


def _pictures(
    groups: dict[str, xr.Dataset], linked: xr.Dataset | None, marks: xr.Dataset | None, results: dict[str, Any]
) -> dict[str, list[Picture]]:
    """Draw all figures, by section."""
    surfaces, flat = groups["surfaces"], groups["flat"]
    parameters = results["parameters"]
    headline = str(results["headline"]) if linked is not None else None
    pictures = {
        "slices": draw_slices(groups["slices"], surfaces),
        "flattening": [
            *draw_warp(surfaces, flat),
            draw_strain(groups["strain"], flat),
            draw_progress(groups["strain"]),
            *([curved] if (curved := draw_curvature(groups["strain"], flat, results["flatten"]["curvature"])) else []),
        ],
        "maps": draw_maps(
            groups["maps"],
            [*results["properties"], *results.get("further", {})],
            headline=headline,
            rim_um=float(results["surfaces"]["rim_um"]),
        ),
    }
    if linked is None or headline is None:
        return pictures
    choices = parameters["correlate"]
    if marks is not None:
        hole_um = sum(parameters["registration"]["hole_um"]) / 2
        pictures["registration"] = [draw_registration(linked, marks, hole_um=float(hole_um))]
    pictures["outlines"] = draw_outlines(linked, name=headline, thin_um=float(choices["thin_um"]))
    rows = [row for row in results["correlation"] if row["property"] == headline]
    pictures["relation"] = [draw_relation(linked, headline, rows, point_um=float(choices["point_um"]))]
    return pictures
