"""The page of octaves of maps, its figures and its tables; one file that needs nothing else."""

import math
from collections.abc import Mapping, Sequence

from planish.analyze.scales import Scales
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
from planish.core.tables import grouped
from planish.core.typing import Entries, Pair
from planish.report.answer import WordTables, answer_page
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
    with_margin,
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
from planish.report.text import HOLES

# Pixels of the axes: left and upper edge, width and height
_LEFT = 74.0
_TOP = 16.0
_WIDE = 416.0
_HIGH = 200.0
_MOST_NAMED = 3  # maps in the heading


def scales_page(octaves: Scales, *, source: str, version: str) -> str:
    """Return the page of octaves as HTML.

    ``source``: name of the run; ``version``: of the program.
    """
    return answer_page(scales_section(octaves), source=source, version=version)


def scales_section(octaves: Scales | None) -> Entries:
    """Give what page and report show of octaves; nothing of none."""
    if octaves is None:
        return {}
    titles = [in_words(facts.title) for facts in octaves.maps.values()]
    about = f"{len(titles)} maps"
    if len(titles) <= _MOST_NAMED:
        about = ", ".join(titles)
    if octaves.against is not None:
        about += f" against {in_words(octaves.against_title)}"
    return {
        "question": "At which wavelength?",
        "about": about,
        "is_sound": all(facts.trust == "ok" for facts in octaves.maps.values()),
        "answer": say_answer(octaves),
        "tiles": tiles_of(octaves),
        "surer": say_surer(octaves),
        "reading": say_reading(octaves),
        "tables": band_tables(octaves),
        "notes": say_notes(octaves),
        "pictures": pictures_of(octaves),
    }


def tiles_of(octaves: Scales) -> list[KeyFigure]:
    """What the octaves of the first map rest on; nothing where it has none."""
    name = next(iter(leading(octaves)), "")
    bands = octaves.bands.get(name)
    if not bands:
        return []
    facts = octaves.maps[name]
    named = leading_band(octaves, bands)
    height, width = facts.field_um or (math.nan, math.nan)
    waves_text = f"{plain(bands[-1].low_um)} to {plain(bands[0].high_um)}"
    field_text = f"{fixed(width / 1000, 1)} × {fixed(height / 1000, 1)}"
    known_text = f"{percent(facts.known_share, 2)} of it known"
    tiles = [
        KeyFigure(count(len(bands)), "", "octaves", waves_text),
        KeyFigure(count(round(named.modes)), "", "independent waves", f"of {waves(named)}"),
        KeyFigure(field_text, "mm", "field", known_text),
    ]
    noisy = [band for band in bands if is_known(band.noise)]
    if noisy:
        share = max(band.noise**2 / (band.noise**2 + band.sd**2) for band in noisy)
        noise_text = percent(share, 2)
        tiles.append(KeyFigure(noise_text, "", "noise, taken off", "of the variance, at most"))
    return tiles


def band_tables(octaves: Scales) -> WordTables:
    """The octaves of all maps in words, the shortest waves first, as tables by their headings.

    A column stands there where any octave has a value for it, and the table of the relation with
    the other map where any has a gain.
    """
    shown = [
        (octaves.maps[name], band) for name, bands in octaves.bands.items() for band in bands[::-1]
    ]
    fields = ("cov", "noise", "formation", "gain")
    has = {key for key in fields for _, band in shown if is_known(getattr(band, key))}
    tables: WordTables = {}
    for facts, band in shown:
        row = {
            "Map": axis_label(facts.title, unit(facts.units)),
            "Waves": waves(band),
            "Standard deviation": number(band.sd),
            "95 %": numbers_text(band.interval),
        }
        if "cov" in has:
            row["COV / %"] = number(100 * band.cov)
        if "noise" in has:
            row["Noise"] = number(band.noise)
        if "formation" in has:
            row["Formation"] = fixed(band.formation, 2)
        row["Independent waves"] = count(round(band.modes))
        tables.setdefault("Octaves", []).append(row)
        if "gain" in has:
            relation = {
                "Map": facts.title,
                "Waves": waves(band),
                "Gain": number(band.gain),
                "95 %": numbers_text(band.gain_interval),
                "Squared coherence": fixed(band.coherence, 2),
                "95 % of coherence": numbers_text(band.coherence_interval, 2),
                "Phase / °": fixed(band.phase_deg, 0),
            }
            heading = f"Against {in_words(octaves.against_title)}"
            tables.setdefault(heading, []).append(relation)
    return tables


def tables_of(octaves: Scales) -> dict[str, Table]:
    """The octaves as one table, by the name of its file."""
    rows: list[dict[str, object]] = []
    for name, bands in octaves.bands.items():
        about = {"map": name, "units": octaves.maps[name].units}
        rows += [about | flat_row(band) for band in reversed(bands)]
    return {"octaves": table_of(rows)}


def pictures_of(octaves: Scales) -> list[Picture]:
    """Figures: the relation with the other map first, then how much maps vary by octave.

    Maps with a coefficient of variation share a figure, and others those of their unit.
    """
    pictures: list[Picture] = []
    if octaves.against is not None:
        pictures.append(draw_relation(octaves))
    has_cov = {name: is_known(bands[0].cov) for name, bands in octaves.bands.items() if bands}
    groups = grouped(has_cov, lambda name: "%" if has_cov[name] else octaves.maps[name].units)
    pictures += [draw_spread(octaves, names, is_cov=key == "%") for key, names in groups.items()]
    return pictures


def draw_spread(octaves: Scales, names: Sequence[str], *, is_cov: bool) -> Picture:
    """Draw how much maps vary in each octave: COV, or their standard deviation in one unit.

    ``names`` of the maps; ``is_cov``: standard deviations over the mean of the map, in per cent.
    """
    factors = dict.fromkeys(names, 1.0)
    first_map = octaves.maps[names[0]]
    label = axis_label("standard deviation", unit(first_map.units))
    if is_cov:
        factors = {name: 100 / octaves.maps[name].mean for name in names}
        label = "coefficient of variation / %"
    canvas = Canvas(HALF, _TOP + _HIGH + 58 + LINE_PX * len(names))
    axes = _draw_octaves(canvas, (_TOP, _HIGH), octaves, factors, "sd")
    draw_log_axes(canvas, axes, "wavelength / µm", label)
    _name_maps(canvas, octaves, names, _TOP + _HIGH + 58)
    caption = (
        "Horizontal lines: octaves. Dots: standard deviation in the octave"
        f"{' over the mean of the map' if is_cov else ''}, without the noise that is known."
        f" {_intervals_of(octaves, names)}"
    )
    title = "How much the maps vary by octave of wavelength"
    return canvas.picture(title, caption, tables_of(octaves))


def draw_relation(octaves: Scales) -> Picture:
    """Draw gain and squared coherence of maps for the other one, by octave."""
    names = [name for name, bands in octaves.bands.items() if bands]
    height = _HIGH - 40
    below = _TOP + _HIGH + 16
    canvas = Canvas(HALF, 2 * (height + _TOP) + 100 + LINE_PX * len(names))
    factors = dict.fromkeys(names, 1.0)
    upper = _draw_octaves(canvas, (_TOP, height), octaves, factors, "gain")
    lower = _draw_octaves(canvas, (below, height), octaves, factors, "coherence")
    draw_log_axes(canvas, upper, "", "gain")
    draw_log_axes(canvas, lower, "wavelength / µm", "squared coherence")
    _name_maps(canvas, octaves, names, below + _HIGH + 18)
    other = in_words(octaves.against_title)
    other_label = axis_label(other, unit(octaves.against_units))
    caption = (
        f"Above, change of the map for a change of {other_label};"
        " below, squared coherence, corrected for chance; both without the noise that is known."
        f" {_intervals_of(octaves, names)}"
    )
    title = f"What the maps show of {other}, by octave of wavelength"
    return canvas.picture(title, caption, tables_of(octaves))


def _name_maps(canvas: Canvas, octaves: Scales, names: Sequence[str], y: float) -> None:
    colours = colours_of(octaves.bands)
    titles = [octaves.maps[name].title for name in names]
    canvas.name_curves(titles, [colours[name] for name in names], (_LEFT, y))


def _draw_octaves(
    canvas: Canvas,
    place: Pair,
    octaves: Scales,
    factors: Mapping[str, float],
    key: str,
) -> Axes:
    """Draw one field of octaves with their intervals, those of the maps side by side.

    ``place``: top and height of the axes in pixels; ``factors``: what the values of each map are
    multiplied by; ``key``: name of the field, ``sd``, ``gain`` or ``coherence``. The axes, which
    are returned, hold 0.
    """
    interval_key = f"{key}_interval"
    if key == "sd":
        interval_key = "interval"
    # Map, where its interval stands within an octave, ends of the octave as logarithms of um,
    # value and its interval.
    shown: list[tuple[str, float, Pair, float, list[float]]] = []
    ends = [0.0]
    if key == "coherence":
        ends.append(1.0)
    for index, (name, factor) in enumerate(factors.items(), 1):
        share = index / (len(factors) + 1)
        for band in octaves.bands[name]:
            waves_log = (math.log10(band.low_um), math.log10(band.high_um))
            value = factor * getattr(band, key)
            interval = [factor * end for end in getattr(band, interval_key)]
            shown.append((name, share, waves_log, value, interval))
            ends += filter(is_known, (value, *interval))
    low, high = with_margin(ends)
    if min(ends) >= 0:
        low = 0.0
    edges = [edge for _, _, waves_log, _, _ in shown for edge in waves_log]
    top, height = place
    extent = (min(edges) - 0.03, max(edges) + 0.03, low, high)
    axes = canvas.axes(_LEFT, top, _WIDE, height, extent)
    axes.across(0.0)
    colours = colours_of(octaves.bands)
    for name, share, (left, right), value, interval in shown:
        if not is_known(value):
            continue
        colour = colours[name]
        middle = left + (right - left) * share
        axes.line((left, right), value, colour=colour, width=1.2)
        if is_known(interval[0]):
            axes.line(middle, interval, colour=colour, width=1.6)
        axes.dots(middle, value, colour=colour, size=7)
    return axes


def _intervals_of(octaves: Scales, names: Sequence[str]) -> str:
    """How a caption ends: what the lines are, how many pixels maps have, and the mask."""
    counts = [octaves.maps[name].n or 0 for name in names]
    least_and_most = sorted({min(counts), max(counts)})
    n_text = " to ".join(map(count, least_and_most))
    mask = f"mask: measured, without {HOLES}"
    return f"Vertical lines: 95 % intervals. n = {n_text} pixels; {mask}."
