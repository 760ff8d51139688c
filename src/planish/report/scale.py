"""At which scale two maps go together: correlation against the size of points, and coherence against wavelength."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from planish.analyze import Partial
from planish.core.facts import is_known
from planish.report.draw import ACCENT, FULL, POINT, SOFT, Axes, Canvas, Picture, Table
from planish.report.statement import decimals_of_r
from planish.report.text import REGISTERED, capital, count, fixed, left_out, number, percent, plain
from planish.results import EvidenceFacts, MapReliability

_TOP, _HIGH, _WIDE = 40.0, 250.0, 400.0
_LEFT, _RIGHT = 85.0, 635.0
_UNEVEN = 1.4  # standard error of the second opinion over that of the covariances


def draw_scale(found: EvidenceFacts, *, names: tuple[str, str], regions: bool = False) -> Picture:
    """Draw r against the size of points with the band that holds the whole curve, and coherence by octaves."""
    canvas = Canvas(FULL, 360)
    _curve(canvas, found)
    _octaves(canvas, found)
    n = found.sizes[0].n if found.sizes else 0
    return canvas.picture(
        title=f"At which scale {names[0]} and {names[1]} go together",
        caption=(
            "Left, correlation over points of growing size; lines, the 95 % interval of each size by itself; shaded, "
            "the band that holds the whole curve with 95 %. Right, squared coherence by octaves of wavelength, put "
            "right for chance, with a full dot where it is certain among all octaves (p below 0.05 after Šidák); gain, "
            "change of the second map per change of the first in the octave. Larger points average noise away, so r "
            "may rise although nothing more is explained; coherence is of each octave alone. "
            f"n = {count(n)} at the smallest size. Mask: measured, without {left_out(regions)}. "
            f"{capital(REGISTERED)}."
        ),
        data=_tables(found),
    )


def _tables(found: EvidenceFacts) -> Mapping[str, Table]:
    """Return the curve of sizes and the octaves as columns; what is not known is empty."""
    sizes, bands = found.sizes, found.bands
    curve: Table = {
        "size of a point / µm": [row.point_um for row in sizes],
        "n": [row.n for row in sizes],
        "independent": known(row.n_eff for row in sizes),
        "r": known(row.r for row in sizes),
        "lower 95 % limit": known(row.interval[0] for row in sizes),
        "upper 95 % limit": known(row.interval[1] for row in sizes),
        "lower end of the band": known(row.band[0] for row in sizes),
        "upper end of the band": known(row.band[1] for row in sizes),
    }
    octaves: Table = {
        "shortest wave / µm": [band.shortest_um for band in bands],
        "longest wave / µm": [band.longest_um for band in bands],
        "squared coherence": known(band.coherence for band in bands),
        "p of all octaves": known(band.p_of_bands for band in bands),
        "phase / °": known(band.phase_deg for band in bands),
        "gain": known(band.gain for band in bands),
        "independent waves": known(band.modes for band in bands),
    }
    return {name: table for name, table, rows in (("sizes", curve, sizes), ("octaves", octaves, bands)) if rows}


def known(values: Iterable[float | None]) -> list[object]:
    """Give the numbers of a table; what is not known is empty."""
    return [value if is_known(value) else "" for value in values]


def _curve(canvas: Canvas, found: EvidenceFacts) -> None:
    rows = [row for row in found.sizes if is_known(row.r)]
    if not rows:
        return
    ends = [v for row in rows for v in (*(row.band if is_known(row.band) else ()), row.r)]
    low, high = min(0.0, *ends), max(0.0, *ends)
    room = 0.06 * (high - low) or 0.1
    sizes = [math.log10(row.point_um) for row in rows]
    axes = canvas.axes(_LEFT, _TOP, _WIDE, _HIGH, (sizes[0] - 0.05, sizes[-1] + 0.05, low - room, high + room))
    axes.line([(sizes[0] - 0.05, 0.0), (sizes[-1] + 0.05, 0.0)], colour=SOFT, width=0.8)
    held = [(at, row.band) for at, row in zip(sizes, rows, strict=True) if is_known(row.band)]
    if len(held) > 1:
        axes.area([(at, b[0]) for at, b in held] + [(at, b[1]) for at, b in reversed(held)], colour=POINT, opacity=0.2)
    for at, row in zip(sizes, rows, strict=True):
        if is_known(row.interval):
            axes.line([(at, row.interval[0]), (at, row.interval[1])], colour=POINT, width=1.4)
    points = [(at, row.r) for at, row in zip(sizes, rows, strict=True)]
    axes.line(points, colour=ACCENT, width=2.2)
    axes.dots(points, colour=ACCENT, size=5)
    powers(canvas, axes, "size of a point / µm", "r")


def _octaves(canvas: Canvas, found: EvidenceFacts) -> None:
    if not found.bands:
        return
    edges = [math.log10(v) for band in found.bands for v in (band.shortest_um, band.longest_um)]
    axes = canvas.axes(_RIGHT, _TOP, _WIDE, _HIGH, (min(edges) - 0.03, max(edges) + 0.03, -0.05, 1.02))
    axes.line([(min(edges) - 0.03, 0.0), (max(edges) + 0.03, 0.0)], colour=SOFT, width=0.8)
    for band in found.bands:
        if not is_known(band.coherence):
            continue
        left, right = math.log10(band.shortest_um), math.log10(band.longest_um)
        axes.line([(left, band.coherence), (right, band.coherence)], colour=ACCENT, width=2.2)
        certain = band.p_of_bands < 0.05
        middle = [((left + right) / 2, band.coherence)]
        axes.dots(middle, colour=ACCENT, size=8)
        if not certain:
            axes.dots(middle, colour="white", size=5)
        if is_known(band.gain):
            gain = f"gain {number(band.gain)}"
            axes.text((left + right) / 2, band.coherence, gain, anchor="middle", shift=(0, -9), size=11)
    powers(canvas, axes, "wavelength / µm", "squared coherence")


def powers(canvas: Canvas, axes: Axes, x_label: str, y_label: str) -> None:
    """Draw axes whose x holds powers of ten, with round lengths at the ticks."""
    x0, x1 = axes.extent[:2]
    rounds = [m * 10**k for k in range(-1, 6) for m in (1, 2, 5)]
    places = [(math.log10(v), f"{v:g}") for v in rounds if x0 <= math.log10(v) <= x1]
    canvas.ticks(axes, x_label, y_label, across=places)


def sentences(found: EvidenceFacts, point_um: float, of_image: str = "relative grey") -> list[str]:
    """What is said beside the correlation that leads; ``of_image`` names the values of the image."""
    out: list[str] = []
    if found.origins:
        digits = decimals_of_r((found.origins[0], found.origins[2]))
        least, mean, largest = (fixed(v, digits) for v in found.origins)
        out.append(
            f"Where the grid of points of {plain(point_um)} begins is arbitrary: over 16 origins r is {mean} on "
            f"average, from {least} to {largest}."
        )
    second = found.second_opinion
    if second is not None and is_known(second.interval):
        low, high = (fixed(v, decimals_of_r(second.interval)) for v in second.interval)
        uneven = second.ratio > _UNEVEN
        end = "the maps do not vary alike everywhere" if uneven else "it is too narrow where maps reach far"
        out.append(
            f"Second opinion, from what single points of {plain(second.point_um)} add to r: 95 %: {low} to {high} "
            f"({fixed(second.critical, 2)} standard errors after Conley); {end}."
        )
    if found.curve is not None:
        bent = found.curve
        shares = f"r² is {fixed(bent.r2_line, 2)} of the line and {fixed(bent.r2_parabola, 2)} of the parabola"
        out.append(f"Over points of {plain(point_um)} the relation is {bent.words} ({shares}).")
    for thin in found.thin:
        if is_known(thin.interval):
            low, high = (number(v, 3) for v in thin.interval)
            where = (
                f"Where the coating is below {plain(thin.thinner_than_um)} ({percent(thin.share, 2)} of the valid area)"
            )
            out.append(f"{where} the mean {of_image} differs by {number(thin.difference, 3)} (95 %: {low} to {high}).")
    short = found.short_waves
    if short and is_known(short.r) and is_known(short.interval) and found.short_waves_um:
        low, r, high = (
            fixed(v, decimals_of_r(short.interval)) for v in (short.interval[0], short.r, short.interval[1])
        )
        out.append(
            f"Waves below {plain(round(found.short_waves_um, -1))} alone: r = {r} (95 %: {low} to "
            f"{high}; {count(round(short.n_eff))} independent points). This says nothing of longer waves."
        )
    if found.partial:
        out.append(_given(found.partial, found.commonality or {}, found.a_map))
    if found.ceiling_sentence:
        rests = (
            "It rests on the expected error of the registration and the texture of the map; noise lowers it further."
        )
        out.append(f"{found.ceiling_sentence} {rests}")
    last = len(found.reliability) - 1
    return out + [_reliable(one, found, last=k == last) for k, one in enumerate(found.reliability)]


def _reliable(one: MapReliability, found: EvidenceFacts, *, last: bool) -> str:
    """Say how far two halves of a measurement agree and, behind the last one, what that bounds."""
    name = one.map.replace("_", " ") + (f" of {one.layer}" if len(found.reliability) > 1 else "")
    if not is_known(one.value):
        return f"Reliability of {name}: not known. {one.silence or ''}".strip()
    noise = 1 - one.value
    size = f"over {count(one.n)} points of {plain(one.point_um)}"
    text = (
        f"Odd and even rows of columns are two half measurements of {name}: {size} they correlate with r = "
        f"{_near_one(one.halves_r)}, so that at least {percent(noise, 1)} of the variance of the map is noise"
    )
    if last and found.ceiling_noise is not None:
        alone = "" if found.ceiling_both is None else f", {_near_one(found.ceiling_both)} with misplacement"
        text += f"; a perfect relation would show r = {_near_one(found.ceiling_noise)} at most by noise alone{alone}"
    return f"{text}. It is a bound: both halves share {one.shared}."


def _near_one(value: float) -> str:
    """Write a number up to 1 so that it is not rounded to 1."""
    return fixed(value, min(max(2, -math.floor(math.log10(1 - value))), 6) if 0 < value < 1 else 2)


def _given(found: Partial, shares: dict[str, float], headline: str) -> str:
    names = " and ".join(name.replace("_", " ") for name in found.given)
    if not is_known(found.r):
        return f"Given {names}, there is no r. {found.silence or ''}".strip()
    known = ""
    if is_known(found.interval):
        low, high = (fixed(v, 2) for v in found.interval)
        known = f"95 %: {low} to {high}; "
    alone = shares.get(headline)
    share = "" if alone is None else f" Alone, the map explains {fixed(alone, 2)} of the variance."
    return (
        f"Given {names}, r = {fixed(found.r, 2)} at points of {plain(found.point_um)} ({known}"
        f"{count(round(found.n_eff) if is_known(found.n_eff) else 0)} independent points).{share}"
    )
