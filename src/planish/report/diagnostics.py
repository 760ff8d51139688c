"""Figures of what stands beside r.

Scale, distance, two measurements of one quantity, light over a coating.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain

import numpy as np

from planish.analyze import CorrelogramProfiles
from planish.analyze.agreement import AgreementFacts
from planish.analyze.kubelka_munk import KubelkaMunk
from planish.core.facts import is_known
from planish.core.numbers import NONE, capital, count, in_words, number, plain
from planish.report.draw import (
    ACCENT,
    FULL,
    POINT,
    SMALL,
    Axes,
    Canvas,
    Picture,
    Table,
    columns,
    or_blank,
    with_margin,
)
from planish.report.relation import (
    LEFT,
    RIGHT,
    WIDE,
    Points,
    as_drawn,
    draw_dots,
    draw_fit,
    draw_slope,
    points_table,
)
from planish.report.sentences.variograms import squared_unit
from planish.report.text import Basis, TwoTexts
from planish.results import CorrelationRow, EvidenceFacts, Mottle

# Pixels above axes, and their height
_TOP = 40.0
_HIGH = 235.0
_SCALE_HIGH = 250.0
_ROOM = 1.08  # length of an axis over the largest value that it holds
_OCTAVE_FIELDS = {
    "shortest wave / µm": "shortest_um",
    "longest wave / µm": "longest_um",
    "squared coherence": "coherence",
    "p of all octaves": "p_of_bands",
    "phase / °": "phase_deg",
    "gain": "gain",
    "independent waves": "modes",
}
_RING_FIELDS = {
    "wavelength / µm": "wavelength_um",
    "correlation": "correlation",
    "half bit": "threshold",
    "independent waves": "modes",
}


def draw_scale(
    evidence: EvidenceFacts,
    *,
    names: TwoTexts,
    basis: Basis,
) -> Picture:
    """Draw r against the size of points, and coherence by octaves.

    The band that holds the whole curve is drawn with r. ``names``: both maps in a sentence.
    """
    canvas = Canvas(FULL, 360)
    _draw_size_curve(canvas, evidence)
    _draw_octaves(canvas, evidence)
    n = 0
    if evidence.sizes:
        n = evidence.sizes[0].n
    caption = (
        "Left, correlation over points of growing size; lines, the 95 % interval of each size"
        " by itself; shaded, the 95 % band of the whole curve. Right, squared coherence by"
        " octaves of wavelength, corrected for chance, with a filled dot where it exceeds"
        " chance among all octaves (p below 0.05, Šidák); gain, change of the second map per"
        " change of the first in the octave. Larger points average noise away, so r may rise"
        " although nothing more is explained; coherence is that of each octave alone. n ="
        f" {count(n)} at the smallest size. Mask: measured, without {basis.excluded}."
        f" {capital(basis.registered)}."
    )
    title = f"Scales at which {names[0]} and {names[1]} are correlated"
    return canvas.picture(title, caption, _scale_tables(evidence))


def _scale_tables(evidence: EvidenceFacts) -> Mapping[str, Table]:
    """Return the curve of sizes and the octaves as columns; what is not known is empty."""
    fields = {"size of a point / µm": "point_um", "n": "n", "independent": "n_eff", "r": "r"}
    size_columns = dict(columns(evidence.sizes, fields))
    for field_name, column_title in (("interval", "95 % limit"), ("band", "end of the band")):
        for k, bound in enumerate(("lower", "upper")):
            ends = [getattr(row, field_name)[k] for row in evidence.sizes]
            size_columns[f"{bound} {column_title}"] = or_blank(ends)
    tables: dict[str, Table] = {}
    if evidence.sizes:
        tables["sizes"] = size_columns
    if evidence.bands:
        tables["octaves"] = columns(evidence.bands, _OCTAVE_FIELDS)
    return tables


def _draw_size_curve(canvas: Canvas, evidence: EvidenceFacts) -> None:
    """Draw r by the logarithm of the size of a point in um, its intervals and its band.

    Sizes without an r are left out; without any, nothing is drawn.
    """
    size_rows = [row for row in evidence.sizes if is_known(row.r)]
    if not size_rows:
        return
    r = [row.r for row in size_rows]
    bands = [row.band for row in size_rows]
    plotted = [0.0, *r, *chain.from_iterable(filter(is_known, bands))]
    log_sizes = [math.log10(row.point_um) for row in size_rows]
    extent = (log_sizes[0] - 0.05, log_sizes[-1] + 0.05, *with_margin(plotted))
    axes = canvas.axes(LEFT, _TOP, WIDE, _SCALE_HIGH, extent)
    axes.across(0.0)
    axes.band(log_sizes, bands)
    for log_size, row in zip(log_sizes, size_rows, strict=True):
        if is_known(row.interval):
            axes.line(log_size, row.interval, colour=POINT, width=1.4)
    axes.line(log_sizes, r, colour=ACCENT, width=2.2)
    axes.dots(log_sizes, r, colour=ACCENT, size=5)
    draw_log_axes(canvas, axes, "size of a point / µm", "r")


def _draw_octaves(canvas: Canvas, evidence: EvidenceFacts) -> None:
    """Draw the coherence and the gain of each octave of wavelengths, which are logarithms of um."""
    if not evidence.bands:
        return
    shortest = math.log10(min(band.shortest_um for band in evidence.bands))
    longest = math.log10(max(band.longest_um for band in evidence.bands))
    extent = (shortest - 0.03, longest + 0.03, -0.05, 1.02)
    axes = canvas.axes(RIGHT, _TOP, WIDE, _SCALE_HIGH, extent)
    axes.across(0.0)
    for band in evidence.bands:
        if not is_known(band.coherence):
            continue
        ends = (math.log10(band.shortest_um), math.log10(band.longest_um))
        axes.line(ends, band.coherence, colour=ACCENT, width=2.2)
        centre = (sum(ends) / 2, band.coherence)
        # Also where p is not known.
        is_chance = not band.p_of_bands < 0.05
        axes.dots(*centre, colour=ACCENT, size=8, is_open=is_chance)
        if is_known(band.gain):
            gain_text = f"gain {number(band.gain)}"
            axes.text(*centre, gain_text, anchor="middle", shift=(0, -9), size=SMALL)
    draw_log_axes(canvas, axes, "wavelength / µm", "squared coherence")


def draw_log_axes(canvas: Canvas, axes: Axes, x_label: str, y_label: str) -> None:
    """Draw the axes of a figure whose x are decadic logarithms of lengths in um."""
    x_min, x_max, *_ = axes.extent
    lengths_um = np.outer(10.0 ** np.arange(-1, 6), (1, 2, 5)).ravel()
    ticks = [(math.log10(length_um), f"{length_um:g}") for length_um in lengths_um]
    x_ticks = [tick for tick in ticks if x_min <= tick[0] <= x_max]
    canvas.ticks(axes, x_label, y_label, x_ticks=x_ticks)


def draw_variograms(evidence: EvidenceFacts, *, titles: Sequence[str], basis: Basis) -> Picture:
    """Draw the variogram of each of the two maps, with its sill and range.

    ``titles`` are those of the maps. Two layers with the same map are told apart by the layer.
    """
    canvas = Canvas(FULL, 345)
    is_same_map = len({curve.map for curve in evidence.variograms}) < len(evidence.variograms)
    data: dict[str, Table] = {}
    for left_px, curve, title in zip((LEFT, RIGHT), evidence.variograms, titles, strict=False):
        distances = (0.0, *curve.distances_um)
        values = (curve.nugget, *curve.values)
        y_max = _ROOM * max(*curve.values, curve.sill, 1e-12)
        extent = (0.0, distances[-1], 0.0, y_max)
        axes = canvas.axes(left_px, _TOP, WIDE, _HIGH, extent)
        axes.across(curve.sill, width=1.2, dash="6 4")
        if is_known(curve.range_um):
            axes.upright(curve.range_um, width=1.2, dash="2 3")
        axes.line(distances, values, colour=ACCENT, width=2.0)
        axes.dots(0.0, curve.nugget, colour=ACCENT, size=6)
        y_label = f"half mean square difference / {squared_unit(curve, title)}"
        canvas.ticks(axes, "distance / µm", y_label)
        canvas.text(left_px, 22, title, bold=True)
        name = curve.map.replace("_", "-")
        if is_same_map:
            name = f"{curve.layer}-{name}"
        data[name] = {"distance / µm": list(curve.distances_um), y_label: list(curve.values)}
    caption = (
        "Half of the mean square difference of two places of a map, by their distance"
        " (variogram). It begins at what neighbours do not share (nugget: noise, and texture"
        " finer than a cell) and rises to the variance of the map (sill, dashed). Dotted: the"
        " range, at which the covariance has fallen to 1/e; over shorter distances neighbours"
        f" resemble each other. Means over {_cell_text(evidence.variograms[0].cell_um)} µm, in"
        f" both maps where both are valid: without {basis.excluded}."
    )
    title = f"How {' and '.join(map(in_words, titles))} vary with distance"
    return canvas.picture(title, caption, data)


def _cell_text(sides_um: Iterable[float]) -> str:
    rounded = dict.fromkeys(round(side_um, 3) for side_um in sides_um)
    return " × ".join(f"{side_um:g}" for side_um in rounded)


def draw_correlogram(profiles: CorrelogramProfiles, *, names: TwoTexts, basis: Basis) -> Picture:
    """Draw r of both maps, one moved along x and along y, with what unrelated maps reach.

    ``names``: both maps in a sentence.
    """
    canvas = Canvas(FULL, 345)
    tables: dict[str, Table] = {}
    for left_px, axis, profile in ((LEFT, "x", profiles.along_x), (RIGHT, "y", profiles.along_y)):
        lags_um = profile.lags_um
        levels = filter(is_known, (*profile.r, *profile.limit_of_any, *profile.limit))
        r_max = min(_ROOM * max(map(abs, levels), default=1.0), 1.0)
        extent = (lags_um[0], lags_um[-1], -r_max, r_max)
        axes = canvas.axes(left_px, _TOP, WIDE, _HIGH, extent)
        axes.band(lags_um, np.outer(profile.limit, (1, -1)))
        axes.across(0.0)
        axes.upright(0.0)
        for limits in np.outer((1, -1), profile.limit_of_any):
            axes.line(lags_um, limits, colour=POINT, width=1.2, dash="6 4")
        axes.line(lags_um, profile.r, colour=ACCENT, width=2.2)
        lag_title = f"lag along {axis} / µm"
        canvas.ticks(axes, lag_title, "r")
        tables[f"along-{axis}"] = {
            lag_title: or_blank(lags_um),
            "r": or_blank(profile.r),
            "|r| that 1 % exceed at this lag": or_blank(profile.limit),
            "|r| that 1 % exceed at any lag": or_blank(profile.limit_of_any),
        }
    caption = (
        "Correlation of both maps with the second shifted along x (left) and along y (right)."
        " Shaded: the |r| that 1 % of unrelated maps of these textures exceed at a given lag;"
        " dashed: that 1 % of them exceed at any lag. Each lag has the pairs and means of its"
        " own overlap; a profile is one line through all lags, whose largest r may lie beside"
        f" it. Means over {_cell_text(profiles.cell_um)} µm, where both are valid: without"
        f" {basis.excluded}."
    )
    return canvas.picture(f"{capital(names[0])} shifted against {names[1]}", caption, tables)


def draw_rings(agreement: AgreementFacts, *, name: str, layers: TwoTexts, basis: Basis) -> Picture:
    """Draw how far two measurements of one map, called ``name``, agree, against wavelength.

    ``layers``: the two that were measured. The axis is the logarithm of the wavelength in um.
    """
    canvas = Canvas(FULL, 345)
    log_wavelengths = [math.log10(ring.wavelength_um) for ring in agreement.rings]
    correlations = [ring.correlation for ring in agreement.rings]
    r_min = min(0.0, *correlations)
    extent = (min(log_wavelengths) - 0.03, max(log_wavelengths) + 0.03, r_min - 0.05, 1.04)
    axes = canvas.axes(LEFT, _TOP, FULL - LEFT - 30, _HIGH, extent)
    axes.across(0.0)
    thresholds = [ring.threshold for ring in agreement.rings]
    axes.line(log_wavelengths, thresholds, width=1.4, dash="6 4")
    if agreement.resolution_um:
        axes.upright(math.log10(agreement.resolution_um), width=1.2, dash="2 3")
    axes.line(log_wavelengths, correlations, colour=ACCENT, width=2.0)
    axes.dots(log_wavelengths, correlations, colour=ACCENT, size=4)
    draw_log_axes(canvas, axes, "wavelength / µm", "correlation of both measurements")
    caption = (
        "Correlation of both measurements in rings of wavelength (Fourier ring correlation)."
        " Dashed: where the mean of both holds half a bit of information a wave (van Heel and"
        " Schatz 2005); dotted: where the curve first falls below it. Errors that both share"
        " count as what they show, and an error of the registration counts as disagreement."
        f" Mask: measured in both, without {basis.excluded}."
    )
    title = f"Down to which wavelength {layers[0]} and {layers[1]} show the same {name}"
    return canvas.picture(title, caption, {"rings": columns(agreement.rings, _RING_FIELDS)})


def draw_kubelka_munk(
    evidence: EvidenceFacts,
    curve: KubelkaMunk,
    points: Points,
    row: CorrelationRow,
    *,
    titles: TwoTexts,
    basis: Basis,
) -> Picture:
    """Draw the larger points with the straight line and the curve.

    The curve is drawn with what its interval leaves open. ``points``: coating and image at the same
    points, of which ``row`` is the correlation; ``titles``: of both.
    """
    unit_x = "µm"
    if evidence.a_map.startswith("coat_weight"):
        unit_x = "g/m²"
    density = None
    if curve.weight:
        density = evidence.density_g_cm3
    points, (row,), _, axis_labels = as_drawn(points, (row,), titles, (unit_x, ""), density)
    canvas = Canvas(FULL, 385)
    axes = draw_dots(canvas, points, (LEFT, 30.0, FULL - 130.0, 300.0))
    x_min, x_max, *_ = axes.extent
    x = np.linspace(max(x_min, 0.0), x_max, 100)
    scattering = curve.scattering_interval
    backing = curve.backing_at_ends
    if is_known(scattering) and is_known(backing):
        # Reflectance over x at the lower and at the upper end of the interval.
        ends = [curve.reflectance(x, *pair) for pair in zip(scattering, backing, strict=True)]
        axes.band(x, np.transpose(ends))
    draw_slope(axes, row)
    reflectance = curve(x)
    draw_fit(axes, x, reflectance, dash="7 4")
    canvas.ticks(axes, *axis_labels)
    title = (
        f"{capital(in_words(titles[1]))} over {in_words(titles[0])}: straight line, Kubelka and"
        " Munk's curve"
    )
    caption = (
        f"n = {count(curve.n)} points of {plain(curve.point_um)}, {count(round(curve.n_eff))}"
        " of them independent. Solid: least squares; dashed: reflectance of a scattering layer"
        f" over a backing (Kubelka 1948) with K/S = {curve.ratio:g}; shaded: the curves at both"
        " ends of the 95 % interval of S, each with the backing that fits it best. The curve"
        " stands beside the line and is not chosen over it: over the range of one field the"
        f" two differ little. Mask: measured, without {basis.excluded}."
        f" {capital(basis.registered)}."
    )
    curve_table = {axis_labels[0]: x.tolist(), "Kubelka and Munk": reflectance.tolist()}
    tables = {"curve": curve_table, "points": points_table(points, axis_labels)}
    return canvas.picture(title, caption, tables)


def mottle_cells(mottle: Mottle) -> list[TwoTexts]:
    """Octaves of wavelength and the coefficient of variation in each, as cells of a table."""
    cells: list[TwoTexts] = []
    for band in mottle.bands:
        waves_text = f"{band.shortest_um:g} to {band.longest_um:g}"
        cells.append((waves_text, number(100 * band.coefficient_of_variation)))
    return cells or [(NONE, NONE)]
