"""One page from one run: figures and tables put into the template, with nothing outside the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from planish.report import promise, tables
from planish.report.draw import FULL, HALF, Picture, house_style
from planish.report.flattening import draw_curvature, draw_progress
from planish.report.ground import image_ground
from planish.report.lags import draw_lags
from planish.report.maps import draw_maps
from planish.report.outlines import draw_outlines
from planish.report.registration import draw_expected_error, draw_registration
from planish.report.relation import draw_relation, image_pair
from planish.report.slices import draw_slices
from planish.report.template import Section, numbered, render
from planish.report.text import in_words
from planish.report.verdict import give_verdict
from planish.report.warp import draw_strain, draw_warp

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
    headline = in_words(names.get(str(results.get("headline")), ""))
    with house_style():
        pictures = _pictures(groups, linked, marks, results)
    told = results.get("lag") if linked is not None else None
    check = promise.lag_check(told, first=headline, second="the image")
    return render(
        "run.html.j2",
        linked=linked is not None,
        sections=[s for s in _SECTIONS if linked is not None or s.name not in _LINK_ONLY],
        pictures=numbered(pictures),
        inputs=tables.inputs(results),
        orientation=promise.orientation(results),
        verdict=give_verdict(results, names),
        gates=tables.gates(results),
        checks=[check] if check is not None else [],
        registered=promise.registered(results),
        surfaces=results["surfaces"],
        joined=tables.joined(results),
        columns=tables.columns(results),
        flattening=tables.flattening(results, groups["surfaces"]),
        properties=tables.properties(results, names),
        further=tables.further(results, names),
        numbers=tables.numbers(results),
        mark_rows=tables.mark_rows(marks) if marks is not None and linked is not None else [],
        transform=[*tables.transform(results["marks"]), *promise.lag_rows(told)] if linked is not None else [],
        match_sentences=promise.match_sentences(results["marks"], results.get("refinement"))
        if linked is not None
        else [],
        compare=tables.compare(results) if linked is not None else [],
        compare_sentence=tables.compare_sentence(results) if linked is not None else "",
        correlations=tables.correlations(results, names) if linked is not None else [],
        point_sizes=tables.point_sizes(results["correlation"]) if linked is not None else [],
        headline=headline,
        greys=tables.greys(results),
        parameters=tables.parameters(results),
        versions={"planish": results["planish"], **results.get("versions", {})},
        method=tables.METHOD,
    )


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
    told = results.get("lag")
    if marks is not None:
        hole_um = float(sum(parameters["registration"]["hole_um"]) / 2)
        ground = image_ground(linked)
        title = in_words(str(linked[headline].attrs.get("long_name", headline)))
        lags = draw_lags(told, ground, first=title, second="the image", width=HALF)
        error = None
        if "expected_error" in linked:
            # Alone it takes the whole width, beside the lags half of it.
            width = FULL if lags is None else HALF
            error = draw_expected_error(linked["expected_error"], marks, hole_um=hole_um, width=width)
        drawn = draw_registration(ground, marks, hole_um=hole_um, axis=promise.axis_in_image(results))
        pictures["registration"] = [drawn, *(picture for picture in (error, lags) if picture is not None)]
    pictures["outlines"] = draw_outlines(linked, name=headline, thin_um=float(choices["thin_um"]))
    rows = [row for row in results["correlation"] if row["property"] == headline]
    how: dict[str, Any] = {"point_um": float(choices["point_um"]), "registered": promise.registered(results)}
    pictures["relation"] = [draw_relation(image_pair(linked, headline), rows, **how)]
    return pictures
