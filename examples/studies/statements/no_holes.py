"""No holes: how well texture links sheets, and how far r is that of the same sheets with holes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import planish as pl
from planish.analyze import Fields, correlate, difference_of_pooled_r, over_sheets, pearson
from planish.results import RegistrationFacts
from planish.series_results import SeriesResults
from planish.texture import in_band

from .common import interval, known, pitch, runs_of
from .truth import sentence

WAVES_UM = 1000.0
"""Longer waves are taken off everywhere, as they are of r that was not tuned."""
LEAST_SHOWN = 1e-6  # a smaller probability of a false link is not known so well


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """One linked sheet of one kind."""

    name: str
    run: pl.Run
    registration: RegistrationFacts
    r: float
    interval: tuple[float, float]

    @property
    def error_um(self) -> float:
        """Expected error of a pixel, median; NaN where it is not known."""
        expected = self.registration.expected_error
        return math.nan if expected is None or expected.median_um is None else expected.median_um


def state(folder: Path, figure: Figure) -> str:
    """Compare sheets that were linked by texture with the same sheets, linked by holes."""
    series = SeriesResults.read(folder / "results.json")
    bare, holed = (_sheets(series, folder, holes) for holes in ("no", "yes"))
    if not bare:
        raise SystemExit(
            f"{folder}: no sheet without holes was linked by texture; this statement needs one."
        )
    _draw(figure, bare, holed)
    asked = [one for one in series.specimens if one.factor("holes") == "no"]
    linked = sum(one.member.run is not None for one in asked)
    errors = " and ".join(
        f"{np.nanmedian([one.error_um for one in sheets]):.1f} um by {how}"
        for how, sheets in (("texture", bare), ("holes", holed))
        if sheets
    )
    text = [
        (
            f"Without holes, {linked} of {len(asked)} sheets were linked, with a probability of a"
            f" false link {_largest([one.registration.false_probability or 0.0 for one in bare])}"
        ),
        f"The expected error (median) is {errors}",
        f"Without waves above {WAVES_UM / 1000:g} mm, {_by_texture(bare)}"
        + (f"; by holes it is {_mean(holed)}" if holed else ""),
    ]
    if pairs := [(one, other) for one in holed for other in bare if one.name == other.name]:
        text.append(_change(pairs))
    return f"{'. '.join(text)}.{sentence(one.run for one in (*holed, *bare))}"


def _sheets(series: SeriesResults, folder: Path, holes: str) -> list[Sheet]:
    """Sheets of one kind that were linked and that no check refuted."""
    runs, found = runs_of(folder), list[Sheet]()
    for one in series.specimens:
        if one.factor("holes") != holes or one.member.state != "whole":
            continue
        run = runs[one.member.name]
        facts = run.results.moving[0].registration
        assert facts is not None
        if holes == "no" and facts.source != "texture":  # a file of marks gave its place
            continue
        if facts.held_out is not None:
            r, low_high = facts.held_out.r, facts.held_out.interval
        else:
            maps = run.groups["linked"]
            a, b = _short_waves(maps, _valid(maps))
            row = correlate(a, b, pixel_um=pitch(maps))
            r, low_high = row.r, row.interval
        name = one.factor("sheet") or one.member.name
        found.append(Sheet(name=name, run=run, registration=facts, r=r, interval=low_high))
    return found


def _by_texture(sheets: Sequence[Sheet]) -> str:
    """Mean r of sheets without holes, and what it would be if it were tuned."""
    held_out = [one.registration.held_out for one in sheets]
    tuned = [h.r_of_marks for h in held_out if h is not None and h.n is not None]
    if len(tuned) == len(sheets):
        return (
            f"r by texture where it was not tuned is {_mean(sheets)}; tuned on the whole sheet, it"
            f" is {math.tanh(float(np.mean(np.arctanh(tuned)))):.2f} there"
        )
    chance = max((h.null_95 for h in held_out if h is not None and h.n is None), default=math.nan)
    return (
        f"r by texture is {_mean(sheets)}, which is tuned where a sheet is too small for tiles of"
        f" its own (unrelated maps reach {chance:.2f} so)"
    )


def _mean(sheets: Sequence[Sheet]) -> str:
    """Mean of r over sheets, by Fisher's z, with its interval."""
    found = over_sheets(Fields([math.atanh(one.r) for one in sheets], [one.name for one in sheets]))
    low, high = (math.tanh(v) for v in found.interval)
    reason = f", because {found.reason}" if found.reason else ""
    between = interval((low, high))
    return (
        f"{math.tanh(found.mean):.2f}"
        f" ({f'95 % interval {between}' if not found.reason else between}{reason})"
    )


def _change(pairs: Sequence[tuple[Sheet, Sheet]]) -> str:
    """Say what r changes where the same sheet is linked by texture.

    It is taken over the same pixels where both have one grid.
    """
    names, by_holes, by_texture, shares_all = list[str](), list[float](), list[float](), True
    for one, other in pairs:
        maps = [of.run.groups["linked"] for of in (one, other)]
        valid = [_valid(m) for m in maps]
        if all(np.array_equal(maps[0][axis], maps[1][axis]) for axis in ("x", "y")):
            valid = [valid[0] & valid[1]] * 2
        else:
            shares_all = False
        before, after = (
            pearson(*(values[v] for values in _short_waves(m, v)))
            for m, v in zip(maps, valid, strict=True)
        )
        names.append(one.name)
        by_holes.append(before)
        by_texture.append(after)
    found = difference_of_pooled_r(Fields(by_holes, names), Fields(by_texture, names), paired=True)
    where = "Over the pixels that count in both" if shares_all else "Each over its own pixels"
    start = f"{where}, r by texture less r by holes is {found.difference:+.3f}"
    if found.distinguishable is None:
        return f"{start} (no interval, because {found.reason})"
    if not found.distinguishable:
        says = f"not distinguishable, and {max(map(abs, found.interval)):.3f} at most"
    elif found.difference > 0:
        says = "r by texture is the larger one, because its place is better or was tuned"
    else:
        says = "r by texture is the smaller one, because its place is worse"
    return f"{start} (95 % interval {interval(found.interval, 3)}): {says}"


def _valid(maps: xr.Dataset) -> np.ndarray:
    """Pixels where coating and image are known."""
    return np.isfinite(known(maps, "coating_top")) & np.isfinite(known(maps, "image"))


def _short_waves(maps: xr.Dataset, valid: np.ndarray) -> list[np.ndarray]:
    """Coating and image without slow variations; NaN where they do not count."""
    names = ("coating_top", "image")
    short = [
        in_band(maps[name].values.astype(float), valid, pitch(maps), (None, WAVES_UM))
        for name in names
    ]
    return [np.where(valid, values, np.nan) for values in short]


def _largest(probabilities: Sequence[float]) -> str:
    largest = max(probabilities)
    return f"below {LEAST_SHOWN:f}" if largest < LEAST_SHOWN else f"of at most {largest:.1g}"


def _draw(figure: Figure, bare: Sequence[Sheet], holed: Sequence[Sheet]) -> None:
    """R with its interval, and the expected error, of each sheet and kind."""
    left, right = figure.subplots(1, 2)
    names = list(dict.fromkeys(one.name for one in (*holed, *bare)))
    for k, (how, sheets) in enumerate((("by holes", holed), ("by texture", bare))):
        if not sheets:
            continue
        x = np.array([names.index(one.name) for one in sheets]) + 0.16 * k - 0.08
        r = np.array([one.r for one in sheets])
        # An open marker where r was tuned: it has no interval then.
        has = [not math.isnan(one.interval[0]) for one in sheets]
        tuned = ", r not tuned" if all(has) else ", open where r was tuned"
        low, high = np.array([one.interval for one in sheets]).T
        left.errorbar(x, r, [r - low, high - r], fmt="none", color=f"C{k}", capsize=4)
        faces = [f"C{k}" if h else "white" for h in has]
        label = f"{how}{tuned if k else ''}"
        left.scatter(x, r, edgecolors=f"C{k}", facecolors=faces, label=label, zorder=3)
        right.bar(x, [one.error_um for one in sheets], width=0.14, color=f"C{k}", label=how)
    for ax in (left, right):
        ax.set_xticks(range(len(names)), [f"sheet {name}" for name in names])
        ax.set_xlim(-0.5, len(names) - 0.5)
        ax.set_ylim(0)
    left.set(
        title="r of coating and image, with 95 % intervals",
        ylabel=f"r, without waves above {WAVES_UM:g} µm",
    )
    right.set(title="Expected error of a pixel", ylabel="median / µm")
    right.set_ylim(0, 1.3 * right.get_ylim()[1])  # room for the legend
    left.legend(frameon=False, loc="lower left")
    right.legend(frameon=False, loc="upper left")
