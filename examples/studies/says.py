"""What each study says: one statement with its interval, and one figure, from the folder of the series."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import planish as pl
from planish.analyze import (
    Fields,
    difference_of_pooled_r,
    pooled_r,
    random_effects,
    sheets_needed,
    texture_lag,
    textures,
)
from planish.analyze.design import power_of_study
from planish.core.area import area_mean
from planish.core.series_results import SeriesResults, Specimen

THIN_UM = 5.0
R2 = (0.26, 0.21)
BETWEEN, CHANGE, SHARED = (0.05, 0.15), 0.05, 0.5
"""What a design has to assume: by how much z varies between sheets, and its change by a treatment; how far the scatter
of z before and after is the same."""
ELLIPSE = math.sqrt(-2 * math.log(0.05))  # standard errors that hold 95 % of points in a plane


def said(study: str, folder: Path, picture: Path) -> str:
    """The statement of a study whose series lies in ``folder``; its figure is written to ``picture``."""
    figure = plt.figure(figsize=(9, 4), layout="constrained")
    try:
        statement = STATEMENTS[study](folder, figure)
        figure.savefig(picture, dpi=110)
    finally:
        plt.close(figure)
    return statement


def interval(low_high, digits: int = 2) -> str:
    """An interval as text; 'no interval' where there is none."""
    if low_high is None or low_high[0] is None or math.isnan(low_high[0]):
        return "no interval"
    return f"{low_high[0]:.{digits}f} to {low_high[1]:.{digits}f}"


def runs_of(folder: Path) -> dict[str, pl.Run]:
    """The runs of a series by the names of its specimens; what was refused is not there."""
    found = {one.member.name: one.member.folder(folder) for one in SeriesResults.read(folder / "results.json").specimens}
    return {name: pl.open_run(place) for name, place in found.items() if place is not None}


# --- Fig. 6 ----------------------------------------------------------------------------------------------------------


def outlines(folder: Path, figure) -> str:
    """Places below 5 um: how much darker, and how far the dark lies beside them."""
    (run,) = runs_of(folder).values()
    linked = run.groups["linked"]
    valid, pixel = linked.valid.values, pitch(linked)
    coating, image = (np.where(valid, linked[k].values, np.nan) for k in ("coating_top", "image"))
    thin = np.where(np.isfinite(coating), coating < THIN_UM, np.nan)
    # Light from one side makes the slopes of the face bright and dark, which alone would move the outlines.
    face = np.where(valid, linked.topography_top.values, np.nan)
    shown = textures({"outlines": thin, "image": image, "face": face}, valid, pixel).with_slopes("face")
    lag = texture_lag(shown, ["outlines", "face_x", "face_y"], "image", slopes=2, reach_um=100.0)
    (found,) = [one for one in run.results.evidence[0].thin if one.thinner_than_um == THIN_UM]
    mean = float(np.nanmean(image))
    darker = [-100 * v / mean for v in (found.difference, *reversed(found.interval))]
    if lag.distinct:
        (x, y), (sx, sy) = lag.lag_um, lag.se_um
        at_most = lag.length_um + ELLIPSE * lag.length_se_um
        where = (
            f"The dark lies {lag.length_um:.1f} um beside the outlines (x {x:.1f}, 95 % interval "
            f"{interval((x - 1.96 * sx, x + 1.96 * sx), 1)}; y {y:.1f}, {interval((y - 1.96 * sy, y + 1.96 * sy), 1)}), "
            f"with 95 % at most {at_most:.1f} um."
        )
    else:
        where = f"How far the dark lies beside the outlines cannot be told ({lag.silence})."
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    extent = extent_mm(linked)
    left.imshow(linked.coating_top.values, extent=extent, cmap="gray", vmin=0)
    right.imshow(linked.image.values, extent=extent, cmap="gray")
    middle = np.clip(np.nan_to_num(coating, nan=99.0), 0, 99)
    right.contour(np.linspace(*extent[:2], middle.shape[1]), np.linspace(*extent[:1:-1], middle.shape[0]), middle,
                  levels=[THIN_UM], colors="C1", linewidths=0.7)  # fmt: skip
    titled(left, "Coating thickness", "x / mm", "y / mm")
    titled(right, f"Image, coating below {THIN_UM:g} um outlined", "x / mm")
    return (
        f"Where the coating is thinner than {THIN_UM:g} um ({100 * found.share:.1f} % of the area) the image is "
        f"{darker[0]:.1f} % darker (95 % interval {interval(darker[1:], 1)} %). {where}"
    )


# --- Fig. 7 and 8 ----------------------------------------------------------------------------------------------------


def calendering(folder: Path, figure) -> str:
    """r² of coating and brightness before and after, over the same sheets."""
    series = SeriesResults.read(folder / "results.json")
    levels = list(dict.fromkeys(one.member.factors["treatment"] for one in series.specimens))
    each = [fields_of(series, lambda one, k=k: one.member.factors["treatment"] == k) for k in levels]
    found = difference_of_pooled_r(each[0][0], each[1][0], paired=True, squared=True)
    of_r = difference_of_pooled_r(each[0][0], each[1][0], paired=True)
    pooled = [pooled_r(*one) for one in each]
    runs = runs_of(folder)
    for k, (level, ax) in enumerate(zip(levels, figure.subplots(1, 2, sharex=True, sharey=True), strict=True)):
        for one in series.specimens:
            if one.member.factors["treatment"] == level and one.member.name in runs:
                cloud(ax, runs[one.member.name], f"sheet {one.member.factors['sheet']}")
        titled(ax, f"{level.capitalize()}: r² = {pooled[k].r ** 2:.2f}", "coating thickness / um", "brightness" * (k == 0))
        ax.legend(frameon=False, markerscale=3)
    verdict = {None: "nothing can be said", True: "they differ", False: "they are not distinguishable"}
    return (
        f"r² is {pooled[0].r ** 2:.2f} {levels[0]} (r {pooled[0].r:.2f}, 95 % interval {interval(pooled[0].interval)}) "
        f"and {pooled[1].r ** 2:.2f} {levels[1]} (r {pooled[1].r:.2f}, {interval(pooled[1].interval)}) over "
        f"{found.sheets[0]} sheets. Difference of r² {found.difference:+.3f} ({interval(found.interval, 3)}), of r "
        f"{of_r.difference:+.3f} ({interval(of_r.interval, 3)}): {verdict[found.distinguishable]}"
        f"{f' ({found.reason})' if found.reason else ''}. Such a study sees a difference of r² of "
        f"{found.smallest_seen():.3f} in 80 %."
    )


# --- Fig. 9 and 10 ---------------------------------------------------------------------------------------------------


def print_density(folder: Path, figure) -> str:
    """r of coating and the print's reflectance without its screen."""
    (run,) = runs_of(folder).values()
    row = headline_rows(run)[-1]
    linked = run.groups["linked"]
    maps, right = figure.subplots(1, 2)
    maps.imshow(np.where(linked.valid, linked.image, np.nan), extent=extent_mm(linked), cmap="gray")
    titled(maps, "Print without its screen, away from holes", "x / mm", "y / mm")
    cloud(right, run, "")
    titled(right, f"r² = {row.r2:.2f}", "coating thickness / um", "grey of the print")
    uneven = run.results.mottle
    largest = max((band for one in uneven for band in one.bands), key=lambda band: band.coefficient_of_variation, default=None)
    mottle = "" if largest is None else (
        f" The print is most uneven in waves of {largest.shortest_um:.0f} to {largest.longest_um:.0f} um "
        f"(coefficient of variation {100 * largest.coefficient_of_variation:.1f} %)."
    )  # fmt: skip
    return (
        f"r = {row.r:.2f} (95 % interval {interval(row.interval)}), r² = {row.r2:.2f} over {row.n} points of "
        f"{row.point_um:g} um, {row.n_eff:.0f} of them independent.{mottle}"
    )


# --- Fig. 11 and 12 --------------------------------------------------------------------------------------------------


def two_instruments(folder: Path, figure) -> str:
    """Coating thickness of one place by two instruments."""
    (run,) = runs_of(folder).values()
    row = [one for one in run.results.correlations if one.a_map == one.b_map == "coating_top"][-1]
    twice = run.results.evidence[0].twice
    first, second = (run.groups[f"layers/{name}"] for name in (row.a, row.b))
    both = first.valid.values & second.valid.values
    a, b = (np.where(both, m.coating_top.values, np.nan) for m in (first, second))
    axes = figure.subplots(1, 3, width_ratios=(1, 1, 0.9))
    for ax, values, name in zip(axes, (a, b), (row.a, row.b), strict=False):
        ax.imshow(values, extent=extent_mm(first), cmap="gray", vmin=0, vmax=np.nanpercentile(b, 99))
        titled(ax, name, "x / mm")
    factor = [row.point_um / p for p in pitch(first)]
    x, y = (area_mean(m, factor).ravel() for m in (a, b))
    axes[2].plot(x, y, ",", alpha=0.5)
    axes[2].axline((0, 0), slope=1, color="grey", linewidth=0.8)
    titled(axes[2], f"r = {row.r:.2f}", f"{row.a} / um", f"{row.b} / um")
    return (
        f"r = {row.r:.2f} (95 % interval {interval(row.interval)}) over {row.n} points of {row.point_um:.0f} um, "
        f"{row.n_eff:.0f} of them independent. {row.b} less {row.a}: {twice.bias:+.2f} um ({interval(twice.bias_interval)}), "
        f"limits of agreement {interval(twice.limits, 1)} um (the lower one {interval(twice.limit_intervals[0], 1)}, the "
        f"upper one {interval(twice.limit_intervals[1], 1)}). {twice.sentence or ''} "
        f"{len(run.results.regions.regions if run.results.regions else ())} region was declared and left out beside the holes."
    )


# --- the discussion --------------------------------------------------------------------------------------------------


def flattening(folder: Path, figure) -> str:
    """r² of a projection and of the flattened map, over the same points, marks and sheets."""
    series, runs = SeriesResults.read(folder / "results.json"), runs_of(folder)
    sheet = {one.member.name: one.member.factors.get("sheet", one.member.name) for one in series.specimens}
    ways = ("projection, no scale", "projection, similarity", "flattened, similarity", None)
    rows = {
        name: [next(r for r in reversed(run.results.comparison) if w in (None, r.registration)) for w in ways]
        for name, run in runs.items()
    }
    fields = [Fields([rows[n][k].r for n in rows], [sheet[n] for n in rows]) for k in range(len(ways))]
    text: list[str] = []
    for k in (0, 1):
        found = difference_of_pooled_r(fields[k], fields[3], paired=True, squared=True)
        before, after = (v * v for v in (math.tanh(np.mean(np.arctanh(fields[i].values))) for i in (k, 3)))
        text.append(
            f"{ways[k]}: r² {before:.3f}, flattened {after:.3f}, factor {before / after:.2f}, difference "
            f"{after - before:+.3f} ({interval(found.interval, 3)}{f'; {found.reason}' if found.reason else ''})"
        )
    one = next(iter(rows))
    own = rows[one][1]
    text.append(f"of {one} alone, r {own.difference:+.3f} ({interval(own.difference_interval, 3)})")
    ax = figure.subplots()
    for name, of in rows.items():
        ax.plot([r.r2 for r in of], "o-", label=f"{name}: marks {', '.join(f'{r.marks_rms_um:.0f}' for r in of)} um")
    ax.set_xticks(range(len(ways)), ["projection", "projection, scaled", "flattened", "flattened, own model"])
    ax.set_ylim(0)
    titled(ax, "The same points, marks and image", "", "r² at 100 um")
    ax.legend(frameon=False)
    return f"Over {len(set(sheet[n] for n in rows))} sheets. " + "; ".join(text) + "."


# --- design ----------------------------------------------------------------------------------------------------------


def design(folder: Path, figure) -> str:
    """Sheets and fields that see a difference of r² of .05, with the independent points that the series of Fig. 7 had."""
    series = SeriesResults.read(folder / "results.json")
    r, n_eff = fields_of(series, lambda _: True)
    points = float(np.median([n for n in n_eff if n > 4]))
    use = np.array(n_eff) > 4
    found = random_effects(np.arctanh(r.values)[use], 1 / (np.array(n_eff)[use] - 3)).sd_between
    ax, text = figure.subplots(), list[str]()
    for paired in (True, False):
        for fields in (1, 3):
            label = f"{'same sheets' if paired else 'two papers'}, {fields} field{'s' * (fields > 1)} a sheet"
            needed: list[str] = []
            for between, style in zip(BETWEEN, ("-", "--"), strict=True):
                more = {"change_between_sheets": CHANGE, "shared": SHARED} if paired else {}
                given = {"fields": fields, "n_eff": points, "between_sheets": between, "paired": paired, **more}
                needed.append(str(sheets_needed(R2, **given).sheets))
                sheets = np.unique(np.geomspace(3, 100, 40).astype(int))
                power = [power_of_study(R2, sheets=int(k), **given).power for k in sheets]
                colour = f"C{2 * (not paired) + (fields > 1)}"
                ax.plot(sheets, power, style, color=colour, label=f"{label}, z varies by {between}")
            text.append(f"{label} {' or '.join(needed)}")
    ax.axhline(0.8, color="grey", linewidth=0.8)
    ax.set_xscale("log")
    titled(ax, f"r² {R2[0]} against {R2[1]}; {points:.0f} independent points a field", "sheets", "power")
    ax.legend(frameon=False, fontsize=7)
    return (
        f"To tell r² {R2[0]} from {R2[1]} with a power of .8 in fields of {points:.0f} independent points takes so many "
        f"sheets (of each paper), where z varies by {BETWEEN[0]} or {BETWEEN[1]} between sheets: {'; '.join(text)}. "
        f"This series found {found:.2f}, which with {len(set(r.sheets))} sheets is little to go by."
    )


# --- helpers ---------------------------------------------------------------------------------------------------------


def fields_of(series: SeriesResults, wanted: Callable[[Specimen], bool]) -> tuple[Fields, list[float]]:
    """r of the fields that are wanted, and the independent points behind their intervals."""
    at = next(k for k, q in enumerate(series.quantities) if q.what == "r")
    found = [one for one in series.specimens if wanted(one)]
    cells = [one.cells[at] if one.cells else None for one in found]
    values = [cell.value if cell is not None and cell.counts else math.nan for cell in cells]
    n_eff = [(cell.n_eff_interval if cell is not None else None) or math.nan for cell in cells]
    return Fields(values, [one.member.factors["sheet"] for one in found]), n_eff


def headline_rows(run: pl.Run):
    """Rows of coating and image, the largest points last."""
    return [row for row in run.results.correlations if row.a_map == "coating_top" and row.b_map == "image"]


def cloud(ax: Axes, run: pl.Run, label: str) -> None:
    """The points of 100 um of coating and image."""
    linked, row = run.groups["linked"], headline_rows(run)[-1]
    factor = [row.point_um / p for p in pitch(linked)]
    x, y = (
        area_mean(np.where(linked.valid, linked[k], np.nan).astype(float), factor).ravel() for k in ("coating_top", "image")
    )
    ax.plot(x, y, ".", markersize=2, label=label)


def pitch(data) -> tuple[float, float]:
    """Pixel along y and x in um."""
    return float(data.y[1] - data.y[0]), float(data.x[1] - data.x[0])


def extent_mm(data) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of a map that is drawn with its first row on top."""
    return float(data.x[0]) / 1e3, float(data.x[-1]) / 1e3, float(data.y[-1]) / 1e3, float(data.y[0]) / 1e3


def titled(ax: Axes, title: str, x: str, y: str = "") -> None:
    """Title and labels."""
    ax.set(title=title, xlabel=x, ylabel=y)


STATEMENTS: dict[str, Callable[[Path, object], str]] = {
    "fig-06": outlines, "fig-07": calendering, "fig-09": print_density, "fig-11": two_instruments,
    "flattening": flattening, "design": design,
}  # fmt: skip
"""One for each study."""
