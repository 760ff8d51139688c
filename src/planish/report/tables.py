"""The tables of the page: every number is written here, none in the template."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import xarray as xr

from planish.core.results import (
    ComparisonRow,
    CorrelationRow,
    LayerFacts,
    PropertyFacts,
    RegistrationFacts,
    Results,
    RoughnessFacts,
    SheetFacts,
    SurfaceFacts,
)  # fmt: skip
from planish.core.status import Status
from planish.report.relation import largest
from planish.report.summary import Titles, by_pair, headline_pair
from planish.report.text import (
    NONE,
    beside,
    capital,
    count,
    fixed,
    in_words,
    length,
    number,
    percent,
    plain,
    size,
    the,
    typeset,
    unit,
)  # fmt: skip

Facts = list[tuple[str, str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One line of a table: its name and its cells."""

    name: str
    cells: list[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class PairLine:
    """One line of a table of correlations, one row a point size; ``best`` stands out."""

    name: str
    rows: Sequence[CorrelationRow | ComparisonRow | None]
    second: str = ""
    before: tuple[str, ...] = ()
    after: tuple[str, ...] = ()
    best: bool = False


def inputs(results: Results) -> list[Line]:
    """Return what was read, and how it lies on the reference: one line a fact, one cell a layer."""
    layers = results.layers
    sources = [layer.source for layer in layers]
    lines = [
        ("File", [s.name for s in sources]),
        ("Shape (z, y, x or y, x)", [f"{' × '.join(map(count, s.shape))}, {s.dtype}" for s in sources]),
        ("Voxel or pixel", [f"{' × '.join(f'{v:.6g}' for v in s.size_um)} µm, {s.size_source}" for s in sources]),
        ("Extent", [
            " × ".join(number(n * v / 1000) for n, v in zip(s.shape, s.size_um, strict=True)) + " mm" for s in sources
        ]),
        ("File size", [size(s.bytes) for s in sources]),
        ("SHA-256", [f"{s.sha256[:12]}…" for s in sources]),
    ]  # fmt: skip
    if results.is_link:
        marks = [layer.registration for layer in layers]
        errors = [r.expected_error if r else None for r in marks]
        lines += [
            ("Path to the reference", [" → ".join(r.path) if r else "reference" for r in marks]),
            ("Marks matched", [count(r.matched) if r else NONE for r in marks]),
            ("Expected error, median; largest", [
                f"{number(e.median_um, 2)}; {number(e.largest_um, 2)} µm" if e else NONE for e in errors
            ]),
        ]  # fmt: skip
        shares = [layer.share_of_reference for layer in layers]
        if any(share is not None for share in shares):
            lines.append(("Share of the reference covered", [percent(share, 2) for share in shares]))
    return [Line(name=name, cells=cells) for name, cells in lines]


_COLOURS = {"measured": "measured", "rim": "rim", "no_sheet": "none", "leaves_volume": "none",
            "normal_leaves_sheet": "normal"}  # fmt: skip
"""Status of columns -> class of the style; all others are lost."""


def columns(surfaces: SurfaceFacts) -> list[dict[str, str]]:
    """Return the status of the volume's columns, as shares of all."""
    names = {status.label: status.sentence for status in Status}
    order = [*_COLOURS, *(name for name in surfaces.shares if name not in _COLOURS)]
    return [
        {"share": f"{100 * v:.3f}", "text": names.get(name, name), "percent": percent(v),
         "kind": _COLOURS.get(name, "lost")}
        for name in order
        if (v := surfaces.shares.get(name))
    ]  # fmt: skip


def flattening(sheet: SheetFacts, surfaces: xr.Dataset) -> Facts:
    """Return what flattening did, in numbers."""
    f, d, height = sheet.flatten, sheet.flatten.distortion, surfaces["centre"].values
    geodesics = d.geodesics
    return [
        ("Outcome", f.sentence),
        ("Can it be paper?", f.curvature.verdict),
        ("Warp of the centre surface, lowest to highest", length(float(np.nanmax(height) - np.nanmin(height)))),
        ("Largest displacement against the projection", length(f.largest_move_um)),
        ("Displacement, median and 95 %, after rotation and shift",
         f"{length(d.displacement_median_um)} and {length(d.displacement_p95_um)}"),
        ("Growth against the projection", f"{number(d.growth_percent, 3)} %"),
        ("Difference of the growth between two directions", f"{number(d.growth_anisotropy_percent, 3)} %"),
        ("Edge strain, 95th percentile", percent(f.edge_strain_p95, 2)),
        ("Edge strain, largest", percent(f.edge_strain_max, 2)),
        ("Change of area, median and 95 % of its size",
         f"{percent(d.area.median, 2)} and {percent(d.area.p95_abs, 2)}"),
        ("Error of lengths along random lines, 50 % and 95 %",
         f"{percent(geodesics.p50, 2)} and {percent(geodesics.p95, 2)}" if geodesics else NONE),
        ("Folded cells", count(f.folded_cells)),
        ("Mesh", f"{count(d.cells)} cells of {length(f.mesh_um)}"),
        ("Springs with a straight rest length, because the surface is rough",
         percent(f.straight_share, 2) if f.straight_share else "none"),
        ("Spring energy left, per spring", f"{number(f.energy_um2 / max(f.springs, 1), 3)} µm²"),
        ("Method and steps on the mesh",
         f"{'dynamic relaxation' if f.method == 'relaxation' else 'multigrid'}, {count(f.steps)}"),
    ]  # fmt: skip


def properties(layer: LayerFacts, titles: Titles) -> list[Line]:
    """Return the distribution of each property over the columns."""
    if layer.sheet is None:
        return []
    errors = any(p.standard_error is not None or p.support_um is not None for p in layer.sheet.properties.values())
    return [
        _distribution(titles.get((layer.name, name), name), facts, errors=errors)
        for name, facts in layer.sheet.properties.items()
    ]


def _distribution(title: str, p: PropertyFacts, *, errors: bool) -> Line:
    mean = 0.0 if abs(p.mean) < 1e-6 * p.sd else p.mean  # a rounding error of a map that is zero on average
    cells = [count(p.n), *(number(v) for v in (mean, p.sd, p.p5, p.median, p.p95))]
    more = [number(p.standard_error), number(p.support_um)] if errors else []
    units = unit(p.units)
    return Line(name=f"{title} / {units}" if units else title, cells=[*cells, *more])


_ROUGHNESS = {"sa": " µm", "sq": " µm", "ssk": "", "sku": "", "sz": " µm", "sdq": ""}


def numbers(sheet: SheetFacts) -> Facts:
    """Return what describes the sheet in numbers, as pairs of name and value."""
    out: Facts = []
    for side in ("top", "bottom"):
        thin, rough = sheet.numbers.thin.get(side), sheet.numbers.roughness.get(side)
        if thin:
            shares = ", ".join(
                f"{percent(share)} below {number(x)} µm" if x else f"{percent(share)} bare"
                for x, share in zip(thin.thinner_than_um, thin.share, strict=True)
            )
            out.append((f"Thin coating, {side} side", f"{shares}, at columns of {length(thin.support_um)}"))
            if thin.warning:
                out.append(("", typeset(thin.warning)))
        if rough:
            out.append((f"Roughness, {side} side", _roughness(rough)))
    sides = sheet.numbers.two_sides
    for title, difference, ratio, r in (
        ("Coatings", sides.coating_difference_um, sides.coating_sd_ratio, sides.coating_correlation),
        ("Topographies", sides.topography_difference_um, sides.topography_sd_ratio, sides.topography_correlation),
    ):
        if r is not None:
            words = f"top minus bottom {number(difference)} µm, ratio of the standard deviations {number(ratio)}"
            out.append((f"{title} of the two sides", f"{words}, correlation {number(r)}"))
    for name, values in (sheet.numbers.profiles.values if sheet.numbers.profiles else {}).items():
        out.append((f"Profile of {name}, bottom to top", " ".join(number(v, 2) for v in values)))
    return out


def _roughness(facts: RoughnessFacts) -> str:
    if facts.reason is not None:
        return typeset(facts.reason)
    values = ", ".join(f"{key.capitalize()} {number(getattr(facts, key))}{units}" for key, units in _ROUGHNESS.items())
    return f"{values} (S-filter {length(facts.s_filter_um)}, L-filter {length(facts.l_filter_um)})"


def mark_rows(marks: xr.Dataset) -> list[Line]:
    """Return one line a mark, numbered as in the figure."""
    places = ("moving_x", "moving_y", "fixed_x", "fixed_y")
    labels = marks["label"].values if "label" in marks else [""] * marks.sizes["mark"]
    return [
        Line(
            name=str(labels[k]),
            cells=[
                *(fixed(float(marks[key].values[k]), 1) for key in places),
                *(
                    number(float(marks[key].values[k]), 2) if key in marks else NONE
                    for key in ("residual", "leave_one_out")
                ),
            ],
        )
        for k in range(marks.sizes["mark"])
    ]  # fmt: skip


def registration(r: RegistrationFacts, *, moving: str, fixed_layer: str) -> Facts:
    """Return a registration in numbers."""
    found = f"{r.matched} matched, of {r.found_moving} holes in {the(moving)} and {r.found_fixed} in {the(fixed_layer)}"
    loo, error = r.leave_one_out_rms_um, r.expected_error
    rows = [
        ("Marks", found if r.source == "found" else f"{r.matched} pairs from a file ({r.source})"),
        ("Model", typeset(r.model_sentence)),
        ("Scale", f"{r.scale:.5f}"),
        ("Rotation, x towards y", f"{fixed(r.rotation_deg, 3)}°"),
        ("Shift (x, y)", f"({fixed(r.shift_um[0], 1)}, {fixed(r.shift_um[1], 1)}) µm"),
        ("Mirrored", "yes" if r.mirrored else "no"),
        ("Residual, rms", f"{number(r.rms_um, 2)} µm"),
        ("Leave-one-out error, rms", f"{number(loo, 2)} µm" if loo is not None else NONE),
        ("Expected error of a pixel, rms",
         f"{number(error.median_um, 2)} µm (median), {number(error.largest_um, 2)} µm at most" if error else NONE),
        *(("Warning", typeset(text)) for text in r.warnings),
    ]  # fmt: skip
    lag = r.lag
    if lag is None or lag.lag_um is None or lag.se_um is None:
        return rows
    x, y = (f"{number(v, 2)} ± {number(s, 2)}" for v, s in zip(lag.lag_um, lag.se_um, strict=True))
    rows.append(("Lag of the maps (x, y) ± standard error", f"({x}, {y}) µm"))
    if lag.split_um is not None and any(lag.lags_of_bands_um):
        parts = [f"({number(b[0], 2)}, {number(b[1], 2)}) µm" if b else NONE for b in lag.lags_of_bands_um]
        rows.append((f"Lag of the texture finer and coarser than {length(lag.split_um)}", " and ".join(parts)))
    return rows


def has_differences(results: Results) -> bool:
    """Return whether two maps of the same quantity were compared."""
    return any(row.same_quantity for row in results.correlations)


def comparison(results: Results) -> list[PairLine]:
    """Return the registrations that the paper compares, with both point sizes in one line each."""
    rows = results.comparison
    return [
        PairLine(
            name=capital(name),
            rows=found,
            before=(number(found[0].marks_rms_um, 3),),
            best=name.startswith("flattened"),
        )
        for name in dict.fromkeys(row.registration for row in rows)
        if (found := [row for row in rows if row.registration == name])
    ]


def comparison_sentence(results: Results) -> str:
    """State what flattening gained, in numbers only."""
    at_pixel: dict[str, float] = {}
    for row in results.comparison:
        if row.r2 is not None:
            at_pixel.setdefault(row.registration, row.r2)
    flat = next((v for k, v in at_pixel.items() if k.startswith("flattened")), None)
    others = {k: v for k, v in at_pixel.items() if not k.startswith("flattened")}
    if flat is None or not others:
        return ""
    name, best = max(others.items(), key=lambda item: item[1])
    verb = "raises" if flat > best else "does not raise"
    change = f"from {fixed(best, 3)} to {fixed(flat, 3)}"
    return f"At the pixel, flattening {verb} r²: {change} against the better projection ({name})."


def correlations(results: Results, titles: Titles) -> list[PairLine]:
    """Return the correlation of every pair of maps, all point sizes in one line each."""
    headlines = [headline_pair(results, layer) for layer in results.moving]
    two, sizes = len(results.layers) == 2, _sizes(results.correlations)
    differences = has_differences(results)
    out: list[PairLine] = []
    for group in by_pair(results):
        row, at = largest(group), {round(r.point_um, 4): r for r in group}
        a, b = (titles.get(key, key[1]) for key in ((row.a, row.a_map), (row.b, row.b_map)))
        short = two and not row.same_quantity and results.layer(row.b).kind == "image"
        out.append(PairLine(
            name=a if short else f"{row.a}: {in_words(a)}",
            second="" if short else f"{row.b}: {in_words(b)}",
            rows=[at.get(s) for s in sizes],
            after=(_difference(row),) if differences else (),
            best=two and group in headlines and len(results.correlations) > len(group),
        ))  # fmt: skip
    return out


def _difference(row: CorrelationRow) -> str:
    """Write the difference of two maps of the same quantity, and its limits."""
    if not row.same_quantity:
        return NONE
    sd, units = row.difference_sd, unit(row.units or "")
    low, high = row.limits or (None, None)
    spread = f"{beside(row.difference_mean, sd)} ± {beside(sd, sd)} {units}"
    return f"{spread}\n{beside(low, sd)} to {beside(high, sd)} {units}"


def point_sizes(rows: Iterable[CorrelationRow | ComparisonRow]) -> list[str]:
    """Return the point sizes of a table of correlations."""
    return [plain(size_um) for size_um in _sizes(rows)]


def _sizes(rows: Iterable[CorrelationRow | ComparisonRow]) -> list[float]:
    return sorted({round(float(row.point_um), 4) for row in rows})


def greys(surfaces: SurfaceFacts) -> Facts:
    """Return the grey levels that were found in a volume."""
    s = surfaces
    levels = (
        ("Air", s.grey_air), ("Base paper", s.grey_base), ("Coating, top side", s.grey_coating_top),
        ("Coating, bottom side", s.grey_coating_bottom), ("Noise, standard deviation", s.grey_noise),
    )  # fmt: skip
    out = [(text, number(value, 4)) for text, value in levels]
    out.append(("Blur of the faces, sigma", length(s.blur_um)))
    if s.fringe is not None:
        out.append(("Phase-contrast fringe, share of an edge", number(s.fringe, 2) if s.fringe else "none"))
    if s.polarity is not None:
        out.append(("Sheet against air", "brighter" if s.polarity > 0 else "darker"))
    return out


def parameters(values: Mapping[str, Any]) -> list[tuple[str, Facts]]:
    """Return every parameter, by section; sections of a list are named by their ``name``."""
    out: list[tuple[str, Facts]] = []
    loose: Facts = []
    for section, value in values.items():
        if isinstance(value, Mapping):
            out.append((section, _flat(cast("Mapping[str, Any]", value))))
        elif _is_table(value):
            out += [(f"{section}, {v.get('name', k + 1)}", _flat(v)) for k, v in enumerate(value)]
        else:
            loose.append((section, _parameter(value, section)))
    return [(name, rows) for name, rows in [*out, ("others", loose)] if rows]


def _is_table(value: Any) -> bool:
    return (
        isinstance(value, (list, tuple))
        and bool(value)
        and all(isinstance(v, Mapping) for v in cast("list[Any]", value))
    )


def _flat(values: Mapping[str, Any], before: str = "") -> Facts:
    """Write a section of parameters; what lies in a section of its own has that one's name before it."""
    rows: Facts = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows += _flat(cast("Mapping[str, Any]", value), f"{before}{key}.")
        else:
            rows.append((f"{before}{key}", _parameter(value, key)))
    return rows


def _parameter(value: Any, key: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        text = ", ".join(_parameter(v, "") for v in cast("list[Any]", value))
    elif isinstance(value, (int, float)):
        text = f"{value:.6g}".replace("-", "−")
    else:
        text = str(value)
    return f"{text} {unit('um')}" if key.endswith("_um") else text
