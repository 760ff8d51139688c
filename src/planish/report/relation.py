"""The point-wise relation of the headline property to the image, at the pixel and at larger points."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from planish.core.area import area_mean
from planish.report.draw import ACCENT, FULL, INK, SOFT, Array, Canvas, Picture, pitch
from planish.report.text import count, in_figure, in_words, number, plain, unit

_BINS = 110


def block_means(linked: xr.Dataset, name: str, *, point_um: float) -> tuple[Array, Array]:
    """Average property and image over points of ``point_um``, over the pixels that are valid in both.

    Parameters
    ----------
    linked : Dataset, dims (y, x)
    name : str
        The property.
    point_um : float
        Edge of a point; points that are less than half valid do not count.

    Returns
    -------
    (n,), (n,)
        Property and image; empty where points would be smaller than pixels.
    """
    values, image = _pairs(linked, name)
    factor = (point_um / pitch(linked["y"].values), point_um / pitch(linked["x"].values))
    if min(factor) < 1:
        return np.empty(0), np.empty(0)
    a, b = (area_mean(data, factor) for data in (values, image))
    both = np.isfinite(a) & np.isfinite(b)
    return a[both], b[both]


def draw_relation(linked: xr.Dataset, name: str, rows: list[dict[str, Any]], *, point_um: float) -> Picture:
    """Draw the image's value over the property: density of the pixels, and larger points one by one.

    Parameters
    ----------
    linked : Dataset, dims (y, x)
    name : str
        The property.
    rows : list of dict
        The two correlations: at the pixel, and at ``point_um``.
    point_um : float
    """
    values, image = _pairs(linked, name)
    both = np.isfinite(values) & np.isfinite(image)
    a, b = values[both], image[both]
    title = str(linked[name].attrs.get("long_name", name))
    x_name = in_figure(title)
    x_unit = in_figure(unit(str(linked[name].attrs.get("units", "um"))))
    y_name = in_figure(str(linked["image"].attrs.get("long_name", "Image")))
    y_unit = in_figure(unit(str(linked["image"].attrs.get("units", "1"))))
    labels = (f"{x_name} / {x_unit}" if x_unit else x_name, f"{y_name} / {y_unit}" if y_unit else y_name)
    canvas = Canvas(FULL, 4.75)
    box = _limits(a), _limits(b)
    left = canvas.axes(0.85, 0.62, 4.0, 3.55)
    counts, x_edges, y_edges = np.histogram2d(a, b, bins=_BINS, range=box)
    drawn = np.ma.masked_less(counts.T, 1)
    mesh = left.pcolormesh(
        x_edges,
        y_edges,
        drawn,
        cmap="viridis",
        norm=LogNorm(1, max(float(counts.max(initial=1)), 10.0)),
        rasterized=True,
    )
    bar = left.figure.colorbar(mesh, cax=canvas.axes(4.92, 0.62, 0.1, 3.55))
    powers = [10.0**k for k in range(7) if 10.0**k <= max(float(counts.max(initial=1)), 10.0)]
    bar.ax.yaxis.set_major_locator(FixedLocator(powers))
    bar.ax.yaxis.set_minor_locator(NullLocator())
    bar.ax.yaxis.set_major_formatter(FuncFormatter(_whole))
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    canvas.text(4.92, 0.54, "pixels", fontsize=8, va="baseline", color=SOFT)
    right = canvas.axes(6.35, 0.62, 4.0, 3.55)
    means = block_means(linked, name, point_um=point_um)
    many = means[0].size > 2000
    right.plot(*means, ls="", marker="o", ms=2.2 if many else 3.4, mew=0, color="#2f6690", alpha=0.35 if many else 0.6)
    own = _limits(means[0], 0.0), _limits(means[1], 0.0)
    for axes, row, at, span in ((left, _row(rows, 0), 0.85, box), (right, _row(rows, 1), 6.35, own)):
        axes.set_xlim(*span[0])
        axes.set_ylim(*span[1])
        axes.set_xlabel(labels[0])
        axes.set_ylabel(labels[1])
        axes.spines[["top", "right"]].set_visible(False)
        axes.yaxis.set_major_formatter(FuncFormatter(_tick))
        _line(axes, row, span[0])
        size = plain(round(row["point_um"], 4)) if row else plain(point_um)
        canvas.text(at, 0.2, f"Points of {size}", fontweight="bold", fontsize=9.5, va="baseline")
        canvas.text(at, 0.44, _numbers(row, x_unit, y_unit), va="baseline", color=INK)
    return canvas.picture(
        title=f"{linked['image'].attrs.get('long_name', 'Image')} over {in_words(title)}",
        caption=(
            "Left, how many pixels fall where (logarithmic colours); right, area means over the valid pixels of each "
            "larger point, which counts when half of its area is valid. Lines are least squares of the image's value "
            "on the property. The left axes span the 0.05th to the 99.95th percentile of the pixels, the right ones "
            "the points. Mask: measured, and away from holes and their rims. "
            "n counts points, which resemble their neighbours: it is not a sample size."
        ),
    )


def _pairs(linked: xr.Dataset, name: str) -> tuple[Array, Array]:
    """Property and image in double precision, NaN unless both are valid."""
    values, image = linked[name].values.astype(np.float64), linked["image"].values.astype(np.float64)
    both = linked["valid"].values.astype(bool) & np.isfinite(values) & np.isfinite(image)
    return np.where(both, values, np.nan), np.where(both, image, np.nan)


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


def _line(axes: Axes, row: dict[str, Any] | None, span: tuple[float, float]) -> None:
    if row is None:
        return
    axes.plot(span, [row["intercept"] + row["slope"] * v for v in span], color="white", lw=3.2, solid_capstyle="butt")
    axes.plot(span, [row["intercept"] + row["slope"] * v for v in span], color=ACCENT, lw=1.6, solid_capstyle="butt")


def _numbers(row: dict[str, Any] | None, x_unit: str, y_unit: str) -> str:
    if row is None:
        return "no correlation: too few points, or a constant map"
    per = f"{' ' + y_unit if y_unit else ''} per {x_unit}" if x_unit else ""
    found = (
        f"r² = {row['r2']:.3f}",
        f"r = {number(row['r'])}",
        f"n = {count(row['n'])}",
        f"slope {number(row['slope'])}{per}",
    )
    return (5 * " ").join(found)
