"""Figures of what stands beside r: scale, distance, two measurements of one quantity, light over a coating."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from planish.analyze import CorrelogramProfiles, LagProfile
from planish.analyze.agreement import Twice
from planish.analyze.kubelka_munk import CoatingCurve
from planish.analyze.variograms import MapVariogram, squared_unit
from planish.core.facts import is_known
from planish.report.draw import ACCENT, FULL, POINT, SOFT, Axes, Canvas, Picture, Table
from planish.report.relation import Points, in_grams, points_axes, points_table, weighed
from planish.report.text import NONE, REGISTERED, capital, count, in_words, left_out, number, plain
from planish.results import CorrelationRow, EvidenceFacts, LayerMottle

_TOP, _HIGH, _WIDE = 40.0, 235.0, 400.0
_SCALE_HIGH = 250.0
_LEFT, _RIGHT = 85.0, 635.0
_ROOM = 1.08
_BOX = (85.0, 30.0, FULL - 130.0, 300.0)
_STEPS = 100


def draw_scale(evidence: EvidenceFacts, *, names: tuple[str, str], regions: bool = False) -> Picture:
    """Draw r against the size of points with the band that holds the whole curve, and coherence by octaves."""
    canvas = Canvas(FULL, 360)
    _size_curve(canvas, evidence)
    _octaves(canvas, evidence)
    n = evidence.sizes[0].n if evidence.sizes else 0
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
        data=_tables(evidence),
    )


def _tables(evidence: EvidenceFacts) -> Mapping[str, Table]:
    """Return the curve of sizes and the octaves as columns; what is not known is empty."""
    sizes, bands = evidence.sizes, evidence.bands
    curve: Table = {
        "size of a point / µm": [row.point_um for row in sizes],
        "n": [row.n for row in sizes],
        "independent": or_blank(row.n_eff for row in sizes),
        "r": or_blank(row.r for row in sizes),
        "lower 95 % limit": or_blank(row.interval[0] for row in sizes),
        "upper 95 % limit": or_blank(row.interval[1] for row in sizes),
        "lower end of the band": or_blank(row.band[0] for row in sizes),
        "upper end of the band": or_blank(row.band[1] for row in sizes),
    }
    octaves: Table = {
        "shortest wave / µm": [band.shortest_um for band in bands],
        "longest wave / µm": [band.longest_um for band in bands],
        "squared coherence": or_blank(band.coherence for band in bands),
        "p of all octaves": or_blank(band.p_of_bands for band in bands),
        "phase / °": or_blank(band.phase_deg for band in bands),
        "gain": or_blank(band.gain for band in bands),
        "independent waves": or_blank(band.modes for band in bands),
    }
    return {name: table for name, table, rows in (("sizes", curve, sizes), ("octaves", octaves, bands)) if rows}


def or_blank(values: Iterable[float | None]) -> list[object]:
    """Give the numbers of a table; what is not known is empty."""
    return [value if is_known(value) else "" for value in values]


def _size_curve(canvas: Canvas, evidence: EvidenceFacts) -> None:
    rows = [row for row in evidence.sizes if is_known(row.r)]
    if not rows:
        return
    ends = [v for row in rows for v in (*(row.band if is_known(row.band) else ()), row.r)]
    low, high = min(0.0, *ends), max(0.0, *ends)
    room = 0.06 * (high - low) or 0.1
    sizes = [math.log10(row.point_um) for row in rows]
    axes = canvas.axes(_LEFT, _TOP, _WIDE, _SCALE_HIGH, (sizes[0] - 0.05, sizes[-1] + 0.05, low - room, high + room))
    axes.line([(sizes[0] - 0.05, 0.0), (sizes[-1] + 0.05, 0.0)], colour=SOFT, width=0.8)
    held = [(size, row.band) for size, row in zip(sizes, rows, strict=True) if is_known(row.band)]
    if len(held) > 1:
        low_ends, high_ends = ([(size, ends[k]) for size, ends in held] for k in (0, 1))
        axes.area(low_ends + high_ends[::-1], colour=POINT, opacity=0.2)
    for size, row in zip(sizes, rows, strict=True):
        if is_known(row.interval):
            axes.line([(size, row.interval[0]), (size, row.interval[1])], colour=POINT, width=1.4)
    points = [(size, row.r) for size, row in zip(sizes, rows, strict=True)]
    axes.line(points, colour=ACCENT, width=2.2)
    axes.dots(points, colour=ACCENT, size=5)
    powers(canvas, axes, "size of a point / µm", "r")


def _octaves(canvas: Canvas, evidence: EvidenceFacts) -> None:
    if not evidence.bands:
        return
    edges = [math.log10(v) for band in evidence.bands for v in (band.shortest_um, band.longest_um)]
    axes = canvas.axes(_RIGHT, _TOP, _WIDE, _SCALE_HIGH, (min(edges) - 0.03, max(edges) + 0.03, -0.05, 1.02))
    axes.line([(min(edges) - 0.03, 0.0), (max(edges) + 0.03, 0.0)], colour=SOFT, width=0.8)
    for band in evidence.bands:
        if not is_known(band.coherence):
            continue
        shortest, longest = math.log10(band.shortest_um), math.log10(band.longest_um)
        axes.line([(shortest, band.coherence), (longest, band.coherence)], colour=ACCENT, width=2.2)
        certain = band.p_of_bands < 0.05
        middle = [((shortest + longest) / 2, band.coherence)]
        axes.dots(middle, colour=ACCENT, size=8)
        if not certain:
            axes.dots(middle, colour="white", size=5)
        if is_known(band.gain):
            gain = f"gain {number(band.gain)}"
            axes.text((shortest + longest) / 2, band.coherence, gain, anchor="middle", shift=(0, -9), size=11)
    powers(canvas, axes, "wavelength / µm", "squared coherence")


def powers(canvas: Canvas, axes: Axes, x_label: str, y_label: str) -> None:
    """Draw axes whose x holds powers of ten, with round lengths at the ticks."""
    x0, x1 = axes.extent[:2]
    rounds = [m * 10**k for k in range(-1, 6) for m in (1, 2, 5)]
    places = [(math.log10(v), f"{v:g}") for v in rounds if x0 <= math.log10(v) <= x1]
    canvas.ticks(axes, x_label, y_label, across=places)


def draw_variograms(evidence: EvidenceFacts, *, titles: Sequence[str], regions: bool = False) -> Picture:
    """Draw the variogram of each of the two maps, with its sill and range; ``titles`` are those of the maps."""
    canvas = Canvas(FULL, 345)
    for x0, curve, title in zip((_LEFT, _RIGHT), evidence.variograms, titles, strict=False):
        _variogram(canvas, x0, curve, title)
    cells = " × ".join(f"{v:g}" for v in dict.fromkeys(round(v, 3) for v in evidence.variograms[0].cell_um))
    return canvas.picture(
        title=f"How {' and '.join(in_words(title) for title in titles)} vary with distance",
        caption=(
            "Half of the mean square difference of two places of a map, by their distance (variogram). It begins at "
            "what neighbours do not share (nugget: noise, and texture finer than a cell) and rises to the variance of "
            "the map (sill, dashed). Dotted: the range, at which the covariance has fallen to 1/e; over shorter "
            f"distances neighbours resemble each other. Means over {cells} µm, in both maps where both are valid: "
            f"without {left_out(regions)}."
        ),
        data={
            name: {
                "distance / µm": list(curve.distances_um),
                f"half mean square difference / {squared_unit(curve, title)}": list(curve.values),
            } for name, curve, title in zip(_names(evidence), evidence.variograms, titles, strict=True)
        },
    )  # fmt: skip


def _names(evidence: EvidenceFacts) -> list[str]:
    """Names of the tables of both maps, which may be of one name."""
    same = len({curve.map for curve in evidence.variograms}) < len(evidence.variograms)
    return [(f"{curve.layer}-" if same else "") + curve.map.replace("_", "-") for curve in evidence.variograms]


def _variogram(canvas: Canvas, x0: float, curve: MapVariogram, title: str) -> None:
    far = curve.distances_um[-1]
    high = _ROOM * max(*curve.values, curve.sill, 1e-12)
    axes = canvas.axes(x0, _TOP, _WIDE, _HIGH, (0.0, far, 0.0, high))
    axes.line([(0.0, curve.sill), (far, curve.sill)], colour=SOFT, width=1.2, dash="6 4")
    if is_known(curve.range_um):
        axes.line([(curve.range_um, 0.0), (curve.range_um, high)], colour=SOFT, width=1.2, dash="2 3")
    points = list(zip(curve.distances_um, curve.values, strict=True))
    axes.line([(0.0, curve.nugget), *points], colour=ACCENT, width=2.0)
    axes.dots([(0.0, curve.nugget)], colour=ACCENT, size=6)
    canvas.ticks(axes, "distance / µm", f"half mean square difference / {squared_unit(curve, title)}")
    canvas.text(x0, 22, title, bold=True)


def draw_correlogram(profiles: CorrelogramProfiles, *, names: tuple[str, str], regions: bool = False) -> Picture:
    """Draw r of both maps, one moved along x and along y, with what unrelated maps reach."""
    canvas = Canvas(FULL, 345)
    for x0, axis, profile in ((_LEFT, "x", profiles.along_x), (_RIGHT, "y", profiles.along_y)):
        _profile(canvas, x0, axis, profile)
    cells = " × ".join(f"{v:g}" for v in dict.fromkeys(round(v, 3) for v in profiles.cell_um))
    return canvas.picture(
        title=f"{capital(names[0])} moved against {names[1]}",
        caption=(
            "Correlation of both maps where the second is moved along x (left) and along y (right). Shaded: what "
            "unrelated maps of these textures exceed at a given lag with 1 %; dashed: what they exceed at any of all "
            "lags with 1 %. Each lag has the pairs and means of its own overlap; a profile is one line through all "
            f"lags, whose largest r may lie beside it. Means over {cells} µm, where both are valid: without "
            f"{left_out(regions)}."
        ),
        data={"along-x": _lags("x", profiles.along_x), "along-y": _lags("y", profiles.along_y)},
    )  # fmt: skip


def _lags(axis: str, profile: LagProfile) -> Table:
    return {
        f"lag along {axis} / µm": list(profile.lags_um), "r": or_blank(profile.r),
        "|r| that 1 % exceed at this lag": or_blank(profile.limit),
        "|r| that 1 % exceed at any lag": or_blank(profile.limit_of_any),
    }  # fmt: skip


def _profile(canvas: Canvas, x0: float, axis: str, profile: LagProfile) -> None:
    ends = [abs(v) for row in (profile.r, profile.limit_of_any, profile.limit) for v in row if is_known(v)]
    high = min(_ROOM * max(ends, default=1.0), 1.0)
    span = profile.lags_um[0], profile.lags_um[-1]
    axes = canvas.axes(x0, _TOP, _WIDE, _HIGH, (*span, -high, high))
    held = [(at, v) for at, v in zip(profile.lags_um, profile.limit, strict=True) if is_known(v)]
    if len(held) > 1:
        axes.area(held + [(at, -v) for at, v in reversed(held)], colour=POINT, opacity=0.2)
    axes.line([(span[0], 0.0), (span[1], 0.0)], colour=SOFT, width=0.8)
    axes.line([(0.0, -high), (0.0, high)], colour=SOFT, width=0.8)
    for sign in (1, -1):
        limits = [sign * v if is_known(v) else math.nan for v in profile.limit_of_any]
        axes.line(list(zip(profile.lags_um, limits, strict=True)), colour=POINT, width=1.2, dash="6 4")
    axes.line(list(zip(profile.lags_um, profile.r, strict=True)), colour=ACCENT, width=2.2)
    canvas.ticks(axes, f"lag along {axis} / µm", "r")


def draw_rings(twice: Twice, *, name: str, layers: tuple[str, str], regions: bool = False) -> Picture:
    """Draw how far two measurements of one map agree, against wavelength."""
    canvas = Canvas(FULL, 345)
    waves = [math.log10(ring.wavelength_um) for ring in twice.rings]
    low = min(0.0, *(ring.correlation for ring in twice.rings))
    span = min(waves) - 0.03, max(waves) + 0.03
    axes: Axes = canvas.axes(_LEFT, _TOP, FULL - _LEFT - 30, _HIGH, (*span, low - 0.05, 1.04))
    axes.line([(span[0], 0.0), (span[1], 0.0)], colour=SOFT, width=0.8)
    axes.line(
        [(x, ring.threshold) for x, ring in zip(waves, twice.rings, strict=True)], colour=SOFT, width=1.4, dash="6 4"
    )
    if twice.resolution_um:
        x = math.log10(twice.resolution_um)
        axes.line([(x, low - 0.05), (x, 1.04)], colour=SOFT, width=1.2, dash="2 3")
    points = [(x, ring.correlation) for x, ring in zip(waves, twice.rings, strict=True)]
    axes.line(points, colour=ACCENT, width=2.0)
    axes.dots(points, colour=ACCENT, size=4)
    powers(canvas, axes, "wavelength / µm", "correlation of both measurements")
    return canvas.picture(
        title=f"Down to which wavelength {layers[0]} and {layers[1]} show the same {name}",
        caption=(
            "Correlation of both measurements in rings of wavelength (Fourier ring correlation). Dashed: where the "
            "mean of both holds half a bit of information a wave (van Heel and Schatz 2005); dotted: where the curve "
            "first falls below it. Errors that both share count as what they show, and an error of the registration "
            f"counts as disagreement. Mask: measured in both, without {left_out(regions)}."
        ),
        data={
            "rings": {
                "wavelength / µm": [ring.wavelength_um for ring in twice.rings],
                "correlation": [ring.correlation for ring in twice.rings],
                "half bit": [ring.threshold for ring in twice.rings],
                "independent waves": [ring.modes for ring in twice.rings],
            }
        },
    )  # fmt: skip


def draw_kubelka_munk(
    evidence: EvidenceFacts, curve: CoatingCurve, points: Points, row: CorrelationRow, *, titles: tuple[str, str],
    unit_x: str, regions: bool = False,
) -> Picture:  # fmt: skip
    """Draw the larger points with the straight line, and the curve with what its interval leaves open."""
    title, density = titles[0], evidence.density_g_cm3 if curve.weight else None
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


def mottle_cells(mottle: LayerMottle) -> list[tuple[str, str]]:
    """Octaves of wavelength and the coefficient of variation in each, as cells of a table."""
    return [
        (f"{band.shortest_um:g} to {band.longest_um:g}", f"{number(100 * band.coefficient_of_variation, 3)}")
        for band in mottle.bands
    ] or [(NONE, NONE)]
