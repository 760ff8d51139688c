"""The point-wise relation of two maps, at the pixel and at larger points, and how far they differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.typing import NDArray

from planish.core.area import area_mean
from planish.report.draw import ACCENT, FULL, HALF, INK, SOFT, Array, Canvas, Picture, pitch
from planish.report.text import beside, capital, count, in_figure, in_words, number, plain, unit

_BINS = 110
_LEAST_BINS = 24
_HIGH, _WIDE = 3.55, 4.0  # inches of one pair of axes
_POINT = "#2f6690"


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two maps on one grid in double precision, NaN unless both are valid.

    Attributes
    ----------
    a, b : ndarray, shape (rows, cols)
        Drawn across and upwards.
    pixel_um : (float, float)
        Along y and x.
    names, units : (str, str)
        As they are written for readers.
    """

    a: Array
    b: Array
    pixel_um: tuple[float, float]
    names: tuple[str, str]
    units: tuple[str, str]

    @property
    def both(self) -> NDArray[np.bool_]:
        """Where both are known."""
        return np.isfinite(self.a)

    @property
    def labels(self) -> tuple[str, str]:
        """Names with units, as a figure can show them."""
        found = [f"{n} / {u}" if u else n for n, u in zip(self.names, self.units, strict=True)]
        return in_figure(found[0]), in_figure(found[1])


def pair_of(
    a: xr.DataArray, b: xr.DataArray, valid: NDArray[np.bool_], *, names: tuple[str, str] | None = None
) -> Pair:
    """Return two maps on one grid as a pair.

    Parameters
    ----------
    a, b : DataArray, dims (y, x)
    valid : ndarray of bool, shape (rows, cols)
        Pixels that may be looked at.
    names : (str, str) or None
        Names for readers; None takes those of the maps.
    """
    left, right = (m.values.astype(np.float64) for m in (a, b))
    both = valid & np.isfinite(left) & np.isfinite(right)
    own = str(a.attrs.get("long_name", a.name)), str(b.attrs.get("long_name", b.name))
    return Pair(
        a=np.where(both, left, np.nan),
        b=np.where(both, right, np.nan),
        pixel_um=(pitch(a["y"].values), pitch(a["x"].values)),
        names=names or own,
        units=(unit(str(a.attrs.get("units", "um"))), unit(str(b.attrs.get("units", "1")))),
    )


def image_pair(linked: xr.Dataset, name: str) -> Pair:
    """Return a property and the image of a link as a pair."""
    own = str(linked[name].attrs.get("long_name", name)), str(linked["image"].attrs.get("long_name", "Image"))
    return pair_of(linked[name], linked["image"], linked["valid"].values.astype(bool), names=own)


def block_means(pair: Pair, *, point_um: float) -> tuple[Array, Array]:
    """Average both maps over points of ``point_um``, over the pixels that are valid in both.

    Parameters
    ----------
    pair : Pair
    point_um : float
        Edge of a point; points that are less than half valid do not count.

    Returns
    -------
    (n,), (n,)
        Empty where points would be smaller than pixels.
    """
    factor = (point_um / pair.pixel_um[0], point_um / pair.pixel_um[1])
    if min(factor) < 1 - 1e-9:
        return np.empty(0), np.empty(0)
    a, b = (area_mean(data, (max(factor[0], 1.0), max(factor[1], 1.0))) for data in (pair.a, pair.b))
    both = np.isfinite(a) & np.isfinite(b)
    return a[both], b[both]


def draw_relation(pair: Pair, rows: list[dict[str, Any]], *, point_um: float, registered: str) -> Picture:
    """Draw map b over map a: density of the pixels, and larger points one by one.

    Parameters
    ----------
    pair : Pair
    rows : list of dict
        The two correlations: at the pixel, and at ``point_um``.
    point_um : float
    registered : str
        How the maps were registered, in words.
    """
    a, b = pair.a[pair.both], pair.b[pair.both]
    canvas = Canvas(FULL, 4.75)
    left = _density(canvas, 0.85, a, b, bins=_BINS, what="pixels")
    right = canvas.axes(6.35, 0.62, _WIDE, _HIGH)
    means = block_means(pair, point_um=point_um)
    many = means[0].size > 2000
    right.plot(*means, ls="", marker="o", ms=2.2 if many else 3.4, mew=0, color=_POINT, alpha=0.35 if many else 0.6)
    right.set(xlim=_limits(means[0], 0.0), ylim=_limits(means[1], 0.0))
    for axes, row, at in ((left, _row(rows, 0), 0.85), (right, _row(rows, 1), 6.35)):
        _finish(axes, pair.labels)
        _line(axes, row)
        size = plain(round(row["point_um"], 4)) if row else plain(point_um)
        canvas.text(at, 0.2, f"Points of {size}", fontweight="bold", fontsize=9.5, va="baseline")
        canvas.text(at, 0.44, _numbers(row, pair.units), va="baseline", color=INK)
    return canvas.picture(
        title=f"{pair.names[1]} over {in_words(pair.names[0])}",
        caption=(
            "Left, how many pixels fall where (logarithmic colours); right, area means over the valid pixels of each "
            "larger point, which counts when half of its area is valid. Lines are least squares of the image's value "
            "on the property. The left axes span the 0.05th to the 99.95th percentile of the pixels, the right ones "
            "the points. Mask: measured, and away from holes and their rims. "
            f"n counts points, which resemble their neighbours: it is not a sample size. {capital(registered)}."
        ),
    )


def draw_pair(pair: Pair, row: dict[str, Any], *, registered: str) -> Picture:
    """Draw the density of map b over map a at one point size, and beside it their difference where that has a meaning.

    Parameters
    ----------
    pair : Pair
    row : dict
        The correlation: ``point_um``, ``n``, ``r``, ``r2``, ``slope``, ``intercept``; where ``same_quantity`` is true,
        the difference b - a too: ``difference_mean``, ``difference_sd``, ``limits``.
    registered : str
        How the maps were registered, in words.

    Notes
    -----
    The difference is drawn over the mean of the two, with its mean and the limits that hold 95 % of normal differences
    (Bland and Altman 1986).
    """
    same = bool(row.get("same_quantity"))
    point_um = float(row["point_um"])
    a, b = block_means(pair, point_um=point_um)
    canvas = Canvas(FULL if same else HALF, 4.75)
    bins = int(np.clip(np.sqrt(a.size) / 1.5, _LEAST_BINS, _BINS))
    wide = 3.45
    left = _density(canvas, 0.85, a, b, bins=bins, what="points", wide=wide)
    if same:
        span = _limits(np.concatenate([a, b]))
        left.plot(span, span, color=SOFT, lw=1.0, ls=(0, (4, 3)))
    _finish(left, pair.labels)
    told = row if row.get("r") is not None else None
    _line(left, told)
    canvas.text(0.85, 0.2, f"Points of {plain(round(point_um, 4))}", fontweight="bold", fontsize=9.5, va="baseline")
    canvas.text(0.85, 0.44, _numbers(told, pair.units, short=not same), va="baseline", color=INK)
    if same:
        _differences(canvas, 6.35, a, b, row, pair)
    names = in_words(pair.names[1]), in_words(pair.names[0])
    beside = (
        " Dashed: both the same. Right, the difference (upward map less the map across) over the mean of the two; "
        "lines: its mean and the limits between which 95 % of normal differences lie."
        if same
        else ""
    )
    return canvas.picture(
        title=f"{capital(names[1])} and {names[0]}",
        caption=(
            f"How many points fall where (logarithmic colours), and the line of least squares.{beside} Area means "
            f"over points of {plain(round(point_um, 4))} that are at least half valid in both maps. n = "
            f"{count(a.size)} points, which resemble their neighbours: it is not a sample size. Mask: valid in both. "
            f"{capital(registered)}."
        ),
    )


def _differences(canvas: Canvas, at: float, a: Array, b: Array, row: dict[str, Any], pair: Pair) -> None:
    axes = canvas.axes(at, 0.62, _WIDE, _HIGH)
    mean, apart = (a + b) / 2, b - a
    units = in_figure(unit(str(row.get("units") or ""))) or in_figure(pair.units[0])
    many = mean.size > 2000
    axes.plot(mean, apart, ls="", marker="o", ms=2.0 if many else 3.2, mew=0, color=_POINT, alpha=0.3 if many else 0.6)
    axes.set(xlim=_limits(mean), ylim=_limits(apart))
    limits = row.get("limits") or [None, None]
    drawn = ((row.get("difference_mean"), "-"), (limits[0], (0, (5, 3))), (limits[1], (0, (5, 3))))
    values = [float(v) for v, _ in drawn if v is not None]
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, *values, high), max(low, *values, high))
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.03 * (high - low), high + 0.05 * (high - low))
    axes.axhline(0.0, color=SOFT, lw=0.8)
    for value, style in drawn:
        if value is not None:
            axes.axhline(float(value), color="white", lw=3.0)
            axes.axhline(float(value), color=ACCENT, lw=1.5, ls=style)
    _finish(axes, (f"mean of the two / {units}" if units else "mean of the two",
                   f"difference / {units}" if units else "difference"))  # fmt: skip
    end = f" {units}" if units else ""
    canvas.text(at, 0.2, "Difference", fontweight="bold", fontsize=9.5, va="baseline")
    sd = row.get("difference_sd")
    told = (
        f"mean {beside(row.get('difference_mean'), sd)}{end}",
        f"s. d. {beside(sd, sd)}{end}",
        f"limits {beside(limits[0], sd)} to {beside(limits[1], sd)}{end}",
    )
    canvas.text(at, 0.44, (3 * " ").join(told), va="baseline", color=INK)


def _density(canvas: Canvas, at: float, a: Array, b: Array, *, bins: int, what: str, wide: float = _WIDE) -> Axes:
    """Draw how many points fall where, with the colour bar to the right."""
    axes = canvas.axes(at, 0.62, wide, _HIGH)
    box = _limits(a), _limits(b)
    counts, x_edges, y_edges = np.histogram2d(a, b, bins=bins, range=box)
    most = max(float(counts.max(initial=1)), 10.0)
    mesh = axes.pcolormesh(
        x_edges, y_edges, np.ma.masked_less(counts.T, 1), cmap="viridis", norm=LogNorm(1, most), rasterized=True
    )
    bar = axes.figure.colorbar(mesh, cax=canvas.axes(at + wide + 0.07, 0.62, 0.1, _HIGH))
    powers = [10.0**k for k in range(7) if 10.0**k <= most]
    bar.ax.yaxis.set_major_locator(FixedLocator(powers))
    bar.ax.yaxis.set_minor_locator(NullLocator())
    bar.ax.yaxis.set_major_formatter(FuncFormatter(_whole))
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    canvas.text(at + wide + 0.07, 0.54, what, fontsize=8, va="baseline", color=SOFT)
    axes.set(xlim=box[0], ylim=box[1])
    return axes


def _finish(axes: Axes, labels: tuple[str, str]) -> None:
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.spines[["top", "right"]].set_visible(False)
    axes.yaxis.set_major_formatter(FuncFormatter(_tick))


def _whole(value: float, _place: int | None) -> str:
    return count(round(value))


def _tick(value: float, _place: int | None) -> str:
    return f"{value:,.6g}".replace(",", "\u202f").replace("-", "−")


def _limits(data: Array, percent: float = 0.05) -> tuple[float, float]:
    if data.size == 0:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(data, [percent, 100 - percent]))
    room = 0.04 * (high - low) or 0.5
    return low - room, high + room


def _row(rows: list[dict[str, Any]], k: int) -> dict[str, Any] | None:
    return rows[k] if k < len(rows) and rows[k].get("r") is not None else None


def _line(axes: Axes, row: dict[str, Any] | None) -> None:
    """Draw the straight line of a correlation over what the axes span."""
    if row is None or row.get("slope") is None:
        return
    span, high = axes.get_xlim(), axes.get_ylim()
    line = [row["intercept"] + row["slope"] * v for v in span]
    axes.plot(span, line, color="white", lw=3.2, solid_capstyle="butt")
    axes.plot(span, line, color=ACCENT, lw=1.6, solid_capstyle="butt")
    axes.set(xlim=span, ylim=high)


def _numbers(row: dict[str, Any] | None, units: tuple[str, str], *, short: bool = False) -> str:
    if row is None:
        return "no correlation: too few points, or a constant map"
    x_unit, y_unit = (in_figure(u) for u in units)
    per = f"{' ' + y_unit if y_unit else ''} per {x_unit}" if x_unit and not short else ""
    found = (
        f"r² = {row['r2']:.3f}",
        f"r = {number(row['r'])}",
        f"n = {count(row['n'])}",
        f"slope {number(row['slope'])}{per}",
    )
    return ((3 if short else 5) * " ").join(found)
