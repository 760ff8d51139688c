"""What several statements need.

The runs of a series, r of its fields, intervals as text, maps and clouds of points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

import planish as pl
from planish.analyze import Fields
from planish.analyze.explain_sheets import explained_over_sheets
from planish.core.area import area_mean
from planish.core.numbers import in_ascii
from planish.report.sentences.explain import say_answer
from planish.report.sentences.scales import say_answer as say_octaves
from planish.results import CorrelationRow
from planish.series_results import SeriesResults, SeriesSpecimen

MISSING = "#d4d6d8"


def interval(low_high: tuple[float | None, float | None] | None, digits: int = 2) -> str:
    """An interval as text; 'no interval' where there is none."""
    low, high = low_high or (None, None)
    if low is None or high is None or math.isnan(low):
        return "no interval"
    return f"{low:.{digits}f} to {high:.{digits}f}"


def runs_of(folder: Path) -> dict[str, pl.Run]:
    """The runs of a series by the names of its specimens, without those that were refused."""
    series = SeriesResults.read(folder / "results.json")
    found = {one.member.name: one.member.folder(folder) for one in series.specimens}
    return {name: pl.open_run(place) for name, place in found.items() if place is not None}


def one_run(folder: Path) -> pl.Run:
    """The run of a series of one specimen."""
    runs = runs_of(folder)
    if len(runs) != 1:
        raise SystemExit(f"{folder}: {len(runs)} linked specimens found; this statement needs one.")
    return next(iter(runs.values()))


def fields_of(
    series: SeriesResults, wanted: Callable[[SeriesSpecimen], bool]
) -> tuple[Fields, list[float]]:
    """R of the fields that are wanted, and the independent points behind their intervals."""
    at = next(k for k, q in enumerate(series.quantities) if q.what == "r")
    found = [one for one in series.specimens if wanted(one)]
    cells = [one.cells[at] if one.cells else None for one in found]
    values = [cell.value if cell is not None and cell.counts else math.nan for cell in cells]
    n_eff = [(cell.n_eff_interval if cell is not None else None) or math.nan for cell in cells]
    return Fields(values, [one.member.factors["sheet"] for one in found]), n_eff


def of_image(run: pl.Run) -> CorrelationRow:
    """Correlation of coating and image at the largest points."""
    return [
        row
        for row in run.results.correlations
        if row.a_map == "coating_top" and row.b_map == "image"
    ][-1]


def explained(runs: Mapping[str, pl.Run]) -> str:
    """What the model that the study declares says of one run, or of runs by their sheets.

    Of several, the doubtful ones are left out, as they are of r.
    """
    found = {sheet: run.results.explained for sheet, run in runs.items() if run.results.explained}
    doubtful = [sheet for sheet, model in found.items() if model.trust != "ok"]
    models = {sheet: model for sheet, model in found.items() if sheet not in doubtful}
    if len(runs) == 1:
        models = found
    if not models:
        reasons = dict.fromkeys(run.results.explain_reason for run in runs.values())
        reasons_text = "".join(f" No model: {reason}" for reason in reasons if reason)
        return reasons_text + _say_doubtful(doubtful, runs)
    model = next(iter(models.values()))
    if len(runs) > 1:
        model = explained_over_sheets(models, {sheet: sheet for sheet in models}, {})
    return f" {in_ascii(say_answer(model))}{_say_doubtful(doubtful, runs)}"


def levelled(runs: Mapping[str, pl.Run]) -> str:
    """What the octaves that the study declares say of one run, or their gains over sheets.

    Of several, the doubtful ones are left out, as they are of r.
    """
    found = {sheet: run.results.scales for sheet, run in runs.items() if run.results.scales}
    doubtful = [sheet for sheet, one in found.items() if one.maps["coating_top"].trust != "ok"]
    if len(runs) == 1 and found:
        return f" {in_ascii(say_octaves(next(iter(found.values()))))}"
    gains: dict[str, list[float]] = {}
    for sheet, octaves in found.items():
        for band in octaves.bands["coating_top"]:
            if sheet not in doubtful and math.isfinite(band.gain):
                gains.setdefault(f"{band.low_um:g} to {band.high_um:g} um", []).append(band.gain)
    if not gains:
        return ""
    waves = [
        f"{octave}: {np.mean(values):.2f} ({min(values):.2f} to {max(values):.2f})"
        for octave, values in gains.items()
    ]
    return (
        " Gain of the coating for the surface of its base, mean and range over the same sheets, in"
        f" waves of {'; '.join(waves)}."
    )


def _say_doubtful(sheets: Sequence[str], runs: Mapping[str, pl.Run]) -> str:
    """Which runs a check leaves doubtful, and that they are left out where there are others."""
    if not sheets:
        return ""
    if len(runs) > 1:
        return f" Left out, as a check leaves it doubtful: sheet {', '.join(sheets)}."
    checks = [check.name for check in runs[sheets[0]].results.checks if check.state == "look"]
    return f" A check asks for a look: {' and '.join(checks)}."


def cloud(ax: Axes, run: pl.Run, label: str) -> None:
    """Points of coating and image, as large as those of the correlation."""
    linked, row = run.groups["linked"], of_image(run)
    factor = [row.point_um / p for p in pitch(linked)]
    x, y = (area_mean(known(linked, name), factor).ravel() for name in ("coating_top", "image"))
    ax.plot(x, y, ".", markersize=2.5, label=label)


def known(maps: xr.Dataset, name: str) -> np.ndarray:
    """Values of a map where it counts, NaN elsewhere."""
    return np.where(maps["valid"].values, maps[name].values, np.nan).astype(float)


def draw_map(ax: Axes, maps: xr.Dataset, values: np.ndarray, *, low: float | None = None) -> None:
    """Draw a map in grey from its 1 to its 99 % value, or from ``low``.

    Missing is light grey, its borders cut off.
    """
    least, most = np.nanpercentile(values, (1, 99))
    limits = {"vmin": least if low is None else low, "vmax": most}
    ax.imshow(
        np.ma.masked_invalid(values),
        extent=extent_mm(maps),
        cmap="gray",
        interpolation="none",
        **limits,
    )
    ax.set_facecolor(MISSING)
    seen = np.isfinite(values)
    rows, cols = (np.flatnonzero(seen.any(axis=axis))[[0, -1]] for axis in (1, 0))
    ax.set_xlim(*maps.x.values[cols] / 1e3)
    ax.set_ylim(*maps.y.values[rows[::-1]] / 1e3)


def pitch(maps: xr.Dataset) -> tuple[float, float]:
    """Pixel along y and x in um."""
    return float(maps.y[1] - maps.y[0]), float(maps.x[1] - maps.x[0])


def extent_mm(maps: xr.Dataset) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of a map whose first row is on top."""
    return (
        float(maps.x[0]) / 1e3,
        float(maps.x[-1]) / 1e3,
        float(maps.y[-1]) / 1e3,
        float(maps.y[0]) / 1e3,
    )
