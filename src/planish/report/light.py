"""What a page says of the light over a coating: Kubelka and Munk's curve, spread in the paper, uneven print."""

from __future__ import annotations

import numpy as np

from planish.analyze import LightSpread
from planish.core.facts import is_known
from planish.report.draw import ACCENT, FULL, POINT, Canvas, Picture
from planish.report.relation import Points, in_grams, points_axes, points_table, weighed
from planish.report.text import NONE, REGISTERED, capital, count, fixed, in_words, left_out, number, plain
from planish.results import CoatingCurve, CorrelationRow, EvidenceFacts, LayerMottle

_BOX = (85.0, 30.0, FULL - 130.0, 300.0)
_STEPS = 100


def draw_kubelka_munk(
    found: EvidenceFacts, curve: CoatingCurve, points: Points, row: CorrelationRow, *, titles: tuple[str, str],
    unit_x: str, regions: bool = False,
) -> Picture:  # fmt: skip
    """Draw the larger points with the straight line, and the curve with what its interval leaves open."""
    title, density = titles[0], found.density_g_cm3 if curve.weight else None
    if density is not None:
        row, title, unit_x = in_grams(row, density), weighed(title, density), "g/m²"
        points = points[0] * density, points[1]
    canvas = Canvas(FULL, 385)
    axes = points_axes(canvas, points, _BOX)
    x = np.linspace(max(axes.extent[0], 0.0), axes.extent[1], _STEPS)
    if is_known(curve.scattering_interval) and is_known(curve.backing_at_ends):
        sides = zip(curve.scattering_interval, curve.backing_at_ends, strict=True)
        ends = [curve.reflectance(x, scattering, backing) for scattering, backing in sides]
        border = np.concatenate([np.stack([x, ends[0]], axis=1), np.stack([x, ends[1]], axis=1)[::-1]])
        axes.area(border, colour=POINT, opacity=0.2)
    drawn = [(np.stack([x, curve(x)], axis=1), "7 4")]
    if is_known(row.slope):
        drawn.insert(0, (np.array([(v, row.intercept + row.slope * v) for v in axes.extent[:2]]), ""))
    for line, dash in drawn:
        axes.line(line, colour="white", width=4)
        axes.line(line, colour=ACCENT, width=2.2, dash=dash)
    canvas.ticks(axes, f"{title} / {unit_x}", titles[1])
    return canvas.picture(
        title=f"{capital(in_words(titles[1]))} over {in_words(titles[0])}: straight line, Kubelka and Munk's curve",
        caption=(
            f"n = {count(curve.n)} points of {plain(curve.point_um)}, {count(round(curve.n_eff))} of them "
            "independent. Solid: least squares; dashed: reflectance of a scattering layer over a backing (Kubelka "
            f"1948) with K/S = {curve.ratio:g}; shaded: the curves at both ends of the 95 % interval of S, each with "
            "the backing that fits it best. The curve stands beside the line and is not chosen over it: over the range "
            f"of one field the two differ little. Mask: measured, without {left_out(regions)}. {capital(REGISTERED)}."
        ),
        data={
            "curve": {f"{title} / {unit_x}": x.tolist(), "Kubelka and Munk": drawn[-1][0][:, 1].tolist()},
            "points": points_table(points, (f"{title} / {unit_x}", titles[1])),
        },
    )  # fmt: skip


def sentences(found: EvidenceFacts) -> list[str]:
    """Say what the curve and the spread of light give."""
    out: list[str] = []
    if found.kubelka_munk is not None:
        out.append(_of_curve(found.kubelka_munk))
    if found.light_spread is not None:
        out.append(_of_spread(found.light_spread))
    return out


def _of_curve(curve: CoatingCurve) -> str:
    name = f"Kubelka and Munk's curve with K/S = {curve.ratio:g}"
    if curve.silence is not None:
        return f"{name}: none. {curve.silence}"
    per = "m²/kg" if curve.weight else "per µm"
    sure = _between(curve.scattering_interval, 3) or "its 95 % interval has no upper end"
    below = _between(curve.backing_interval, 3)
    density = "" if curve.weight else " (in m²/kg with the density of the coating: --coating-density)"
    return (
        f"{name}: the coating scatters with S = {number(curve.scattering)} {per} ({sure}){density}, over a backing of "
        f"{number(curve.backing)} ({below}). S takes all that follows the thickness for the light of the coating; "
        "errors of the thickness lower it, as they lower a slope."
    )


def _of_spread(spread: LightSpread) -> str:
    width = f"With the coating blurred by light that spreads over {plain(spread.width_um)} (declared)"
    if not is_known(spread.r):
        return f"{width}, there is no r. {spread.silence or ''}".strip()
    text = f"{width}, r = {fixed(spread.r, 2)} at points of {plain(spread.point_um)}"
    if sure := _between(spread.interval, 2, decimals=True):
        text += f" ({sure}; {count(round(spread.n_eff))} independent points)"
    if not is_known(spread.difference_interval):
        return f"{text}."
    low, high = spread.difference_interval
    words = "not distinguishable from" if low <= 0 <= high else "distinguishable from"
    change = f"r changes by {fixed(spread.difference, 3)}, 95 %: {fixed(low, 3)} to {fixed(high, 3)}"
    return f"{text}: {words} that of the coating as it is ({change})."


def _between(limits: tuple[float, float], digits: int, *, decimals: bool = False) -> str:
    if not is_known(limits):
        return ""
    low, high = (fixed(v, digits) if decimals else number(v, digits) for v in limits)
    return f"95 %: {low} to {high}"


def mottle_cells(one: LayerMottle) -> list[tuple[str, str]]:
    """Octaves of wavelength and the coefficient of variation in each, as cells of a table."""
    return [
        (f"{band.shortest_um:g} to {band.longest_um:g}", f"{number(100 * band.coefficient_of_variation, 3)}")
        for band in one.bands
    ] or [(NONE, NONE)]
