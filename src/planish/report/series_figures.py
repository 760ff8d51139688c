"""Figures of a series: sheets and their mean in each group, and small maps of all specimens on one colour scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from planish.core.series_results import GroupFacts, SeriesResults
from planish.report.colours import Array, Scale, image_uri, limits
from planish.report.draw import ACCENT, HALF, INK, POINT, SMALL, SOFT, Canvas, Picture, reduced, round_step
from planish.report.series_words import label, sheets_text, units, value
from planish.report.series_words import title as title_of_quantity
from planish.report.text import plain, title_of, unit_of

_ROW, _TOP, _LETTER = 30.0, 14.0, 6.3  # pixels: of a group, above the first, of a letter
_WIDEST_NAME = 190.0
_WIDE = 150.0  # CSS pixels of the widest small map
_LEAST = 24.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SmallMap:
    """A map of one specimen, small; without values where there is none, or it cannot be read."""

    specimen: str
    values: Array | None
    width_um: float
    height_um: float
    title: str
    unit: str


def small_map(specimen: str, data: xr.DataArray | None, *, pixels: float) -> SmallMap:
    """Make a small map of a map (rows, cols), of at most so many pixels along its longer side."""
    if data is None:
        return SmallMap(specimen=specimen, values=None, width_um=0.0, height_um=0.0, title="", unit="")
    y, x = (data[d].values.astype(np.float64) for d in data.dims)
    ratio = min(1.0, data.shape[1] * abs(float(x[1] - x[0])) / (data.shape[0] * abs(float(y[1] - y[0]))))
    shown = reduced(data.values, y, x, width=pixels * ratio / 1.35)
    values = np.round(shown.values.astype(np.float32), 6)  # a page needs no more
    return SmallMap(
        specimen=specimen, values=values.astype(np.float64), width_um=shown.width, height_um=shown.height,
        title=title_of(data), unit=unit_of(data),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Tiled:
    """Small maps ready for the page, all on one colour scale and one scale of lengths."""

    bar: Picture | None
    images: list[tuple[str, str, float, float]]  # specimen, address of the image, width and height in CSS pixels
    missing: list[str]


def tile_maps(maps: Sequence[SmallMap]) -> Tiled:
    """Colour small maps by one scale: from the 1st to the 99th percentile of all of them."""
    there = [m for m in maps if m.values is not None and bool(np.isfinite(m.values).any())]
    missing = [m.specimen for m in maps if m not in there]
    if not there:
        return Tiled(bar=None, images=[], missing=missing)
    scale = limits(np.concatenate([_values(m).ravel() for m in there]))
    um = max(max(m.width_um, m.height_um) for m in there) / _WIDE
    images = [
        (m.specimen, image_uri(_values(m), scale), max(m.width_um / um, _LEAST), max(m.height_um / um, _LEAST))
        for m in there
    ]
    return Tiled(bar=_bar(there[0], scale, um), images=images, missing=missing)


def _values(m: SmallMap) -> Array:
    assert m.values is not None
    return m.values


def _bar(one: SmallMap, scale: Scale, um: float) -> Picture:
    """The colours of all small maps, and a length on them."""
    canvas = Canvas(HALF, 62)
    canvas.colour_bar(8, 6, 300, 12, scale)
    canvas.text(8, 54, f"{one.title} / {one.unit}" if one.unit else one.title)
    length = round_step(0.5 * _WIDE * um)
    canvas.line([(350, 12), (350 + length / um, 12)], colour=INK, width=3)
    canvas.text(350, 32, plain(length), size=SMALL)
    return canvas.picture(title="Colours and scale of all maps", caption="")


def draw_groups(results: SeriesResults, k: int) -> Picture | None:
    """Draw one quantity of every sheet, by group, with the mean over sheets and its interval."""
    q, groups = results.quantities[k], [g for g in results.groups if g.quantity == k and g.fields]
    if sum(g.fields for g in groups) < 2:
        return None
    factor = 100.0 if q.what == "thin_share" else 1.0
    own = [_members(results, g, k) for g in groups]
    fields = [np.array([v for _, v in one]) * factor for one in own]
    ends = [v * factor for g in groups for v in (g.interval or ())]
    low, high = _range(np.concatenate([*fields, np.array(ends)]))
    names = [_name(g.group) for g in groups]
    left = min(max(len(name) for name in names) * _LETTER + 16, _WIDEST_NAME)
    high_px = _ROW * len(groups)
    canvas = Canvas(HALF, _TOP + high_px + 50)
    axes = canvas.axes(left, _TOP, HALF - left - 20, high_px, (low, high, float(len(groups)), 0.0))
    for i, (g, one) in enumerate(zip(groups, own, strict=True)):
        at = i + 0.5
        axes.dots([(v * factor, at - 0.18) for _, v in one], colour="#9db4c6", size=4)
        sheets: dict[str, list[float]] = {}
        for sheet, v in one:
            sheets.setdefault(sheet, []).append(v * factor)
        axes.dots([(float(np.mean(v)), at + 0.06) for v in sheets.values()], colour=POINT, size=6)
        if g.interval is not None:
            axes.line([(v * factor, at + 0.3) for v in g.interval], colour=ACCENT, width=2)
        if g.mean is not None:
            axes.dots([(g.mean * factor, at + 0.3)], colour=ACCENT, size=7)
        canvas.text(left - 8, _TOP + _ROW * at + 4, names[i], anchor="end")
    canvas.line([(left, _TOP + high_px), (HALF - 20, _TOP + high_px)], colour=SOFT, width=0.8)
    step = round_step((high - low) / 4)
    for tick in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step:
        x = left + (tick - low) / (high - low) * (HALF - left - 20)
        canvas.line([(x, _TOP + high_px), (x, _TOP + high_px + 3)], colour=SOFT, width=0.8)
        canvas.text(x, _TOP + high_px + 16, f"{tick + 0.0:.6g}".replace("-", "−"), size=SMALL, anchor="middle")
    title = title_of_quantity(q)
    canvas.text((left + HALF - 20) / 2, _TOP + high_px + 38, f"{title} / {units(q)}" if units(q) else title,
                anchor="middle")  # fmt: skip
    rows = [(label(g.group), s, v) for g, one in zip(groups, own, strict=True) for s, v in one]
    means = [f"{label(g.group)} {value(g.mean, q)} ({sheets_text(g.sheets)})" for g in groups]
    return canvas.picture(
        title=title,
        caption=(
            "Pale: single specimens; blue: sheets; red: mean over sheets with its 95 % interval, where there are 3 "
            f"sheets. Means: {'; '.join(means)}."
        ),
        data={"sheets": dict(zip(("group", "sheet", "value"), map(list, zip(*rows, strict=True)), strict=True))},
    )


def _members(results: SeriesResults, g: GroupFacts, k: int) -> list[tuple[str, float]]:
    """Sheet and value of every specimen of a group that counts."""
    return [
        (one.sheet, float(one.cells[k].value or 0.0)) for one in results.specimens
        if one.cells and one.cells[k].counts and all(one.member.factors.get(f, "") == v for f, v in g.group.items())
    ]  # fmt: skip


def _range(values: Array) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    margin = 0.06 * (high - low) or 0.05 * abs(high) or 0.5
    return low - margin, high + margin


def _name(group: Mapping[str, str]) -> str:
    """Name a group beside its row: where that is too long, by the beginnings of its levels."""
    name, most = label(group), int((_WIDEST_NAME - 16) / _LETTER)
    if len(name) <= most:
        return name
    each = max(most // len(group) - 3, 4)
    spare = sum(max(each - len(level), 0) for level in group.values())
    return label({f: v if len(v) <= each + spare else f"{v[: each + spare - 1]}…" for f, v in group.items()})
