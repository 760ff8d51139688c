"""The page of octaves of maps, its figures and its tables; one file that needs nothing else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from planish.analyze.scales import ScaleBand, Scales
from planish.core.facts import is_known
from planish.core.numbers import (
    axis_label,
    count,
    fixed,
    in_words,
    number,
    numbers_text,
    percent,
    plain,
    unit,
)
from planish.core.typing import Pair
from planish.report import text
from planish.report.diagnostics import draw_log_axes
from planish.report.draw import (
    HALF,
    LINE_PX,
    Axes,
    Canvas,
    Picture,
    Table,
    colours_of,
    flat_row,
    table_of,
)
from planish.report.sentences.scales import (
    leading,
    leading_band,
    say_answer,
    say_notes,
    say_reading,
    say_surer,
    waves,
)
from planish.report.summary import KeyFigure

_LEFT, _TOP, _WIDE, _HIGH = 74.0, 16.0, 416.0, 200.0
_MOST_NAMED = 3  # maps in the heading


def scales_page(found: Scales, *, source: str, version: str) -> str:
    """Return the page of octaves as HTML.

    ``source``: name of the run; ``version``: of the program.
    """
    against = "" if found.against is None else f" against {in_words(found.against_title)}"
    titles = [in_words(facts.title) for facts in found.maps.values()]
    about = ", ".join(titles) if len(titles) <= _MOST_NAMED else f"{len(titles)} maps"
    is_doubtful = any(facts.trust != "ok" for facts in found.maps.values())
    section = scales_section(found)
    page = text.template("planish.report", "answer.html.j2").render(
        title=f"At which wavelength? {source}",
        question="At which wavelength?",
        about=about + against,
        source=source,
        version=version,
        state="look" if is_doubtful else "pass",
        answer=section["answer"],
        tiles=tiles_of(found),
        pictures=section["pictures"],
        surer=say_surer(found),
        reading=say_reading(found),
        tables=section["tables"],
        notes=say_notes(found),
    )
    return f"{page}\n"


def scales_section(found: Scales | None) -> dict[str, Any]:
    """Give what the report of a run shows of the octaves that its study declares."""
    if found is None:
        return {}
    return {
        "answer": say_answer(found),
        "sentences": [*say_reading(found), *say_notes(found)],
        "tables": band_rows(found),
        "pictures": pictures_of(found),
    }


def tiles_of(found: Scales) -> list[KeyFigure]:
    """What the octaves of the first map rest on."""
    name = leading(found)[0] if found.maps else ""
    if not found.bands.get(name):
        return []
    facts, bands = found.maps[name], found.bands[name]
    named = leading_band(found, bands)
    height, width = facts.field_um or (math.nan, math.nan)
    tiles = [
        KeyFigure(
            count(len(bands)),
            "",
            "octaves",
            f"{plain(bands[-1].low_um)} to {plain(bands[0].high_um)}",
        ),
        KeyFigure(count(round(named.modes)), "", "independent waves", f"of {waves(named)}"),
        KeyFigure(
            f"{fixed(width / 1000, 1)} × {fixed(height / 1000, 1)}",
            "mm",
            "field",
            f"{percent(facts.known_share, 2)} of it known",
        ),
    ]
    shares = [
        band.noise**2 / (band.noise**2 + band.sd**2) for band in bands if is_known(band.noise)
    ]
    if shares:
        tiles.append(
            KeyFigure(percent(max(shares), 2), "", "noise, taken off", "of the variance, at most")
        )
    return tiles


def band_rows(found: Scales) -> dict[str, list[dict[str, str]]]:
    """The octaves of all maps in words, the shortest waves first, as tables by their headings."""
    shown = [
        (found.maps[name], band) for name, bands in found.bands.items() for band in bands[::-1]
    ]
    has = {
        key: any(is_known(getattr(band, key)) for _, band in shown)
        for key in ("cov", "noise", "formation", "gain")
    }
    tables: dict[str, list[dict[str, str]]] = {}
    for facts, band in shown:
        row = {
            "Map": axis_label(facts.title, unit(facts.units)),
            "Waves": waves(band),
            "Standard deviation": number(band.sd),
            "95 %": numbers_text(band.interval),
        }
        if has["cov"]:
            row["COV / %"] = number(100 * band.cov)
        if has["noise"]:
            row["Noise"] = number(band.noise)
        if has["formation"]:
            row["Formation"] = fixed(band.formation, 2)
        row["Independent waves"] = count(round(band.modes))
        tables.setdefault("Octaves", []).append(row)
        if has["gain"]:
            relation = {
                "Map": facts.title,
                "Waves": waves(band),
                "Gain": number(band.gain),
                "95 %": numbers_text(band.gain_interval),
                "Squared coherence": fixed(band.coherence, 2),
                "95 % of coherence": numbers_text(band.coherence_interval, 2),
                "Phase / °": fixed(band.phase_deg, 0),
            }
            heading = f"Against {in_words(found.against_title)}"
            tables.setdefault(heading, []).append(relation)
    return tables


def tables_of(found: Scales) -> dict[str, Table]:
    """The octaves as one table, by the name of its file."""
    rows = [
        {"map": name, "units": found.maps[name].units} | flat_row(band)
        for name, bands in found.bands.items()
        for band in reversed(bands)
    ]
    return {"octaves": table_of(rows)}


def pictures_of(found: Scales) -> list[Picture]:
    """Figures: the relation with the other map first, then how much maps vary by octave."""
    pictures: list[Picture] = []
    if found.against is not None:
        pictures.append(draw_relation(found))
    groups: dict[str, list[str]] = {}
    for name, bands in found.bands.items():
        if bands:
            has_cov = is_known(bands[0].cov)
            groups.setdefault("%" if has_cov else found.maps[name].units, []).append(name)
    pictures += [draw_spread(found, names, is_cov=key == "%") for key, names in groups.items()]
    return pictures


def draw_spread(found: Scales, names: Sequence[str], *, is_cov: bool) -> Picture:
    """Draw how much maps vary in each octave: COV, or their standard deviation in one unit."""
    factors = [1.0] * len(names)
    label = axis_label("standard deviation", unit(found.maps[names[0]].units))
    if is_cov:
        factors = [100 / found.maps[name].mean for name in names]
        label = "coefficient of variation / %"
    canvas = Canvas(HALF, _TOP + _HIGH + 58 + LINE_PX * len(names))
    axes = _draw_octaves(canvas, (_TOP, _HIGH), found, names, "sd", "interval", factors)
    draw_log_axes(canvas, axes, "wavelength / µm", label)
    _name_maps(canvas, found, names, _TOP + _HIGH + 58)
    return canvas.picture(
        title="How much the maps vary by octave of wavelength",
        caption=(
            "Horizontal lines: octaves. Dots: standard deviation in the octave"
            f"{' over the mean of the map' if is_cov else ''}, without the noise that is known."
            f" {_intervals_of(found, names)}"
        ),
        data=tables_of(found),
    )


def draw_relation(found: Scales) -> Picture:
    """Draw gain and squared coherence of maps for the other one, by octave."""
    names = [name for name, bands in found.bands.items() if bands]
    height, below = _HIGH - 40, _TOP + _HIGH + 16
    canvas = Canvas(HALF, 2 * (height + _TOP) + 100 + LINE_PX * len(names))
    upper = _draw_octaves(canvas, (_TOP, height), found, names, "gain", "gain_interval")
    lower = _draw_octaves(canvas, (below, height), found, names, "coherence", "coherence_interval")
    draw_log_axes(canvas, upper, "", "gain")
    draw_log_axes(canvas, lower, "wavelength / µm", "squared coherence")
    _name_maps(canvas, found, names, below + _HIGH + 18)
    return canvas.picture(
        title=f"What the maps show of {in_words(found.against_title)}, by octave of wavelength",
        caption=(
            "Above, change of the map for a change of"
            f" {axis_label(in_words(found.against_title), unit(found.against_units))}; below,"
            " squared coherence, corrected for chance; both without the noise that is known."
            f" {_intervals_of(found, names)}"
        ),
        data=tables_of(found),
    )


def _name_maps(canvas: Canvas, found: Scales, names: Sequence[str], y: float) -> None:
    colours = colours_of(found.bands)
    titles = [found.maps[name].title for name in names]
    canvas.name_curves(titles, [colours[name] for name in names], (_LEFT, y))


def _draw_octaves(
    canvas: Canvas,
    place: Pair,
    found: Scales,
    names: Sequence[str],
    key: str,
    interval_key: str,
    factors: Sequence[float] | None = None,
) -> Axes:
    """Draw one field of octaves with their intervals, those of the maps side by side.

    ``place``: top and height of the axes, which are returned; they hold 0.
    """
    rows: list[tuple[int, ScaleBand, float, list[float]]] = []
    for index, name in enumerate(names):
        factor = factors[index] if factors else 1.0
        for band in found.bands[name]:
            ends = [factor * end for end in getattr(band, interval_key)]
            rows.append((index, band, factor * getattr(band, key), ends))
    ends = [end for *_, value, interval in rows for end in (value, *interval) if is_known(end)]
    if key == "coherence":
        ends.append(1.0)
    low, high = min([0.0, *ends]), max([0.0, *ends])
    margin = 0.06 * (high - low) or 0.1
    edges = [math.log10(edge) for _, band, *_ in rows for edge in (band.low_um, band.high_um)]
    extent = (min(edges) - 0.03, max(edges) + 0.03, low - margin * (low < 0), high + margin)
    axes = canvas.axes(_LEFT, place[0], _WIDE, place[1], extent)
    axes.across(0.0)
    colours = colours_of(found.bands)
    for index, band, value, interval in rows:
        if not is_known(value):
            continue
        colour = colours[names[index]]
        left, right = math.log10(band.low_um), math.log10(band.high_um)
        middle = left + (right - left) * (index + 1) / (len(names) + 1)
        axes.curve((left, right), (value, value), colour=colour, width=1.2)
        if is_known(interval[0]):
            axes.curve((middle, middle), interval, colour=colour, width=1.6)
        axes.dots([(middle, value)], colour=colour, size=7)
    return axes


def _intervals_of(found: Scales, names: Sequence[str]) -> str:
    """How a caption ends."""
    counts = {found.maps[name].n or 0 for name in names}
    n_text = " to ".join(count(n) for n in sorted({min(counts), max(counts)}))
    mask = f"mask: measured, without {text.HOLES}"
    return f"Vertical lines: 95 % intervals. n = {n_text} pixels; {mask}."
