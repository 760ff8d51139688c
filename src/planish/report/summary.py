"""What came out of a run, in one sentence and four numbers; what the image-based check of a registration means."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Literal

from planish.core.results import CorrelationRow, Gate, LagFacts, LayerFacts, RegistrationFacts, Results
from planish.report.relation import largest
from planish.report.text import (
    NONE,
    REGISTERED,
    beside,
    capital,
    count,
    fixed,
    in_words,
    length,
    number,
    percent,
    plain,
    typeset,
    unit,
)  # fmt: skip

_FAINT = 0.02  # r2 below which no direction is named in words

Titles = Mapping[tuple[str, str], str]
"""Layer and map -> title of the map."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tile:
    """One number large, with what it is."""

    value: str
    label: str
    note: str
    unit: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """What came out, in one sentence and a few numbers."""

    sentence: str
    tiles: tuple[Tile, ...]
    passed: bool
    gates: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """Result of a check that is no quality gate: its light, also as a word, what was found, and what that means."""

    state: Literal["agrees", "amber", "grey"]
    word: str
    name: str
    sentence: str
    meaning: str


def summarise(results: Results, titles: Titles) -> Summary:
    """Return the result of a run, as far as it goes and no further."""
    if not results.is_link:
        sentence, tiles = _of_map(results, titles)
    elif len(results.moving) == 1:
        sentence, tiles = _of_two(results, titles)
    else:
        sentence, tiles = _of_layers(results, titles)
    return Summary(sentence=sentence, tiles=tiles, passed=results.passed, gates=gate_summary(results.gates))


def gate_summary(gates: tuple[Gate, ...]) -> str:
    """State how many quality gates were passed."""
    failed = sum(not gate.passed for gate in gates)
    if not failed:
        return "The quality gate is passed." if len(gates) == 1 else f"All {len(gates)} quality gates are passed."
    return (
        f"{failed} of {len(gates)} quality gates {'is' if failed == 1 else 'are'} not passed; read the failed ones "
        "before using a number of this page."
    )


def by_pair(results: Results) -> list[list[CorrelationRow]]:
    """Group the correlations that are of the same two maps, each group from the pixel to the largest points."""
    rows = sorted(enumerate(results.correlations), key=lambda item: _first(results, item[1]))
    return [
        sorted((row for _, row in group), key=lambda row: row.point_um)
        for _, group in groupby(rows, key=lambda item: _key(item[1]))
    ]


def _key(row: CorrelationRow) -> tuple[str, ...]:
    return row.a, row.a_map, row.b, row.b_map


def _first(results: Results, row: CorrelationRow) -> int:
    """Return the place of the first row of the same pair."""
    return next(k for k, other in enumerate(results.correlations) if _key(other) == _key(row))


def headline_pair(results: Results, moving: LayerFacts) -> list[CorrelationRow]:
    """Return the correlations of the maps that stand for a layer and for the reference; empty where there are none."""
    wanted = {(moving.name, moving.headline), (results.reference.name, results.reference.headline)}
    found = [g for g in by_pair(results) if {(g[0].a, g[0].a_map), (g[0].b, g[0].b_map)} == wanted]
    return found[0] if found else []


def _of_map(results: Results, titles: Titles) -> tuple[str, tuple[Tile, ...]]:
    layer = results.reference
    sheet = layer.sheet
    assert sheet is not None
    measured, flat = sheet.surfaces.shares.get("measured"), sheet.flatten
    names = [in_words(titles.get((layer.name, name), name)) for name in sheet.properties]
    thickness = sheet.properties.get("thickness")
    sentence = (
        f"The sheet was found in {percent(measured, 2)} of the columns and flattened; mapped: "
        f"{', '.join(names) if names else 'no property'}. No image was linked."
    )
    if not {"coating_top", "coating_bottom"} & set(sheet.properties):
        sentence += " No coating was found."
    strain = None if flat.edge_strain_p95 is None else 100 * flat.edge_strain_p95
    return sentence, (
        Tile(
            value=number(thickness.mean if thickness else None), unit="µm", label="mean sheet thickness",
            note=f"standard deviation {number(thickness.sd, 2)} µm" if thickness else NONE,
        ),
        Tile(
            value=fixed(None if measured is None else 100 * measured, 0), unit="%", label="of the columns are measured",
            note=f"of {count(sheet.surfaces.columns)}",
        ),
        Tile(value=number(strain, 2), unit="%", label="edge strain", note="95th percentile over the mesh"),
        Tile(
            value=number(flat.largest_move_um), unit="µm", label="largest displacement",
            note="between projection and flat sheet",
        ),
    )  # fmt: skip


def _of_two(results: Results, titles: Titles) -> tuple[str, tuple[Tile, ...]]:
    moving, marks = results.moving[0], results.moving[0].registration
    rows = headline_pair(results, moving)
    pixel, point = (rows[0], rows[-1]) if rows else (None, None)
    sentence = _relation(pixel, point, results, titles)
    if pixel is not None and pixel.same_quantity:
        sentence += _difference(largest(rows), titles)
    loo = marks.leave_one_out_rms_um if marks else None
    if marks and loo is None:
        sentence += f" {marks.matched} marks were used."
    elif marks:
        sentence += f" Each of the {marks.matched} marks is predicted by the others to {length(loo, 2)} (rms)."
    if results.linked is not None:
        share, what = results.linked.share_valid_of_sheet, "of the sheet in the image is valid"
    else:
        share, what = moving.share_of_reference, "of the reference is covered"
    sheet = moving.sheet
    covered = f"{percent(sheet.surfaces.shares.get('measured'), 2)} of the columns are measured" if sheet else ""
    return sentence, (
        _r2_tile(pixel, "r² at the pixel"),
        _r2_tile(point, f"r² at {plain(round(point.point_um, 4))}" if point else "r²"),
        Tile(
            value=number(loo, 2), unit="µm", label="leave-one-out error",
            note=f"rms of {marks.matched} marks; residual {number(marks.rms_um, 2)} µm" if marks else NONE,
        ),
        Tile(value=fixed(None if share is None else 100 * share, 0), unit="%", label=what, note=covered),
    )  # fmt: skip


def _relation(
    pixel: CorrelationRow | None, point: CorrelationRow | None, results: Results, titles: Titles
) -> str:  # fmt: skip
    """Describe the correlation of two maps."""
    if pixel is None or pixel.r is None or pixel.r2 is None:
        n = count(pixel.n if pixel else 0)
        return f"The two layers could not be correlated: {n} pixels are valid in both, or one of the maps is constant."
    a, b = (in_words(titles.get(key, key[1])) for key in ((pixel.a, pixel.a_map), (pixel.b, pixel.b_map)))
    image = results.layer(pixel.b).kind == "image"
    what = "The image" if image else f"{capital(b)} of {pixel.b}"
    than = a if image else f"{a} of {pixel.a}"
    if pixel.r2 < _FAINT:
        start = f"{what} hardly correlates with {than}"
    else:
        words = ("brighter", "darker") if image else ("larger", "smaller")
        start = f"{what} is {words[pixel.r < 0]} where {than} is larger"
    text = f"{start}: r² = {fixed(pixel.r2, 3)} over {count(pixel.n)} pixels"
    if point is not None and point is not pixel and point.r2 is not None:
        text += f", {fixed(point.r2, 3)} over points of {plain(round(point.point_um, 4))}"
    return f"{text} ({REGISTERED})."


def _difference(row: CorrelationRow, titles: Titles) -> str:
    """State the difference of two maps of the same quantity; empty where it is not known."""
    if not row.same_quantity or row.difference_mean is None or row.limits is None:
        return ""
    units, sd = unit(row.units or ""), row.difference_sd
    low, high = (beside(value, sd) for value in row.limits)
    return (
        f" Over points of {plain(round(row.point_um, 4))}, {in_words(titles.get((row.a, row.a_map), row.a_map))} of "
        f"{row.b} minus that of {row.a} is {beside(row.difference_mean, sd)} {units} on average, with 95 % limits of "
        f"{low} to {high} {units}."
    )


def _of_layers(results: Results, titles: Titles) -> tuple[str, tuple[Tile, ...]]:
    reference = results.reference.name
    names = [layer.name for layer in results.moving]
    sentence = f"The layers {', '.join(names[:-1])} and {names[-1]} were brought onto the pixels of {reference}."
    errors = [layer.registration.expected_error for layer in results.moving if layer.registration]
    median = max((e.median_um for e in errors if e), default=None)
    most = max((e.largest_um for e in errors if e), default=None)
    if median is not None:
        sentence += (
            f" The expected error is {length(median, 2)} (rms, median over the worst layer), at most {length(most, 2)}."
        )
    rows = [largest(group) for group in by_pair(results)]
    sentence += next((text for row in rows if (text := _difference(row, titles))), "")
    onto = [row for row in rows if reference in (row.a, row.b) and row.r2 is not None]
    # The pair with the weakest correlation: one that correlates well says nothing of the others.
    weakest = min(onto, key=lambda row: row.r2 or 0.0, default=None)
    share = min((s for layer in results.moving if (s := layer.share_of_reference) is not None), default=None)
    return sentence, (
        Tile(value=count(len(results.layers)), label="layers on one grid", note=f"{reference} is the reference"),
        Tile(
            value=number(most, 2), unit="µm", label="largest expected error",
            note=f"median {number(median, 2)} µm in the worst layer",
        ),
        Tile(
            value=fixed(None if share is None else 100 * share, 0), unit="%", label="of the reference is covered",
            note="by the layer that covers least",
        ),
        Tile(
            value=fixed(weakest.r2 if weakest else None, 3),
            label=f"weakest r², {plain(round(weakest.point_um, 4))}" if weakest else "r²",
            note=f"{weakest.a} and {weakest.b}: {_note(weakest)}" if weakest else NONE,
        ),
    )  # fmt: skip


def _r2_tile(row: CorrelationRow | None, label: str) -> Tile:
    return Tile(value=fixed(row.r2 if row else None, 3), label=label, note=_note(row) if row else NONE)


def _note(row: CorrelationRow) -> str:
    return f"r = {number(row.r)}, n = {count(row.n)}; {REGISTERED}"


def lag_check(lag: LagFacts | None, *, first: str, second: str, name: str = "image-based check") -> Check | None:
    """Return what the lag of two maps, named in words, means; None where none was looked for."""
    if lag is None:
        return None
    sentence = capital(typeset(lag.sentence)).removesuffix(".") + "."
    start = f"The fine textures of {first} and {second} were aligned without using the marks. "
    if lag.agrees is None:
        why = (
            "The marks give no expected error to compare the result with."
            if lag.length_um is not None
            else "The result is inconclusive: it speaks neither for nor against the registration, whose error is known "
            "from the marks alone."
        )
        return Check(state="grey", word=" inconclusive", name=name, sentence=sentence, meaning=f"{start}{why}")
    if not lag.agrees:
        meaning = (
            f"{start}They do not coincide within the expected error. Until the cause is known, a position is known to "
            f"about {length(lag.length_um, 2)} and no better."
        )
        return Check(state="amber", word=" to be inspected", name=name, sentence=sentence, meaning=meaning)
    width = math.hypot(*(lag.se_um or ()))
    if width > (lag.expected_um or math.inf):
        end = (
            f"They coincide, but locate the maps less precisely than the marks do: an error of up to about "
            f"{length(2 * width, 2)} would not be noticed."
        )
    else:
        end = "They coincide within the error expected from the marks."
    return Check(state="agrees", word=" agrees", name=name, sentence=sentence, meaning=f"{start}{end}")


def machine_direction(registration: RegistrationFacts, *, moving: str, fixed: str) -> tuple[float, str] | None:
    """Return the machine direction in the fixed layer in degrees, and where it is known from; None where it is not."""
    o = registration.orientation
    if o.md_deg_fixed is not None:
        return o.md_deg_fixed, f"given for {fixed}"
    if o.md_deg_fixed_from_moving is not None:
        return o.md_deg_fixed_from_moving, f"carried over from {moving}"
    return None


def match_sentences(registration: RegistrationFacts) -> list[str]:
    """Return what is said of the match, the design of the marks, the tilt of their holes and the orientation."""
    r = registration
    tilt = r.tilt.sentence if r.tilt else None
    return [typeset(text) for text in (r.match_sentence, r.design, tilt, r.orientation.sentence) if text]


def refinement_sentences(results: Results) -> list[str]:
    """Return what is said of a refinement by the maps themselves: what it moved, and an independent correlation."""
    r = results.refinement
    if r is None:
        return []
    return [
        typeset(text)
        for text in (
            f"Refined by the maps themselves, in the group 'refined': {r.sentence} {r.correlation.sentence} "
            f"(waves below {r.longest_wave_um:g} um). All other correlations on this page rest on the marks.",
            *r.warnings,
        )
    ]
