"""The page of a model of several maps, its figures and its tables; one file that needs nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from planish.analyze.explain import CoefficientFacts, Explained, strongest
from planish.analyze.explain_sheets import ExplainedSeries
from planish.analyze.variograms import Variogram
from planish.core.facts import ResultModel, is_known
from planish.core.numbers import (
    NONE,
    axis_label,
    count,
    fixed,
    in_words,
    interval_text,
    length,
    number,
    numbers_text,
    percent,
    plain,
    unit,
)
from planish.core.typing import Entries
from planish.report.answer import WordTables, answer_page
from planish.report.colours import limits
from planish.report.diagnostics import draw_log_axes
from planish.report.draw import (
    FAINT,
    HALF,
    INK,
    LINE_PX,
    SMALL,
    Canvas,
    Picture,
    Table,
    colours_of,
    draw_map,
    flat_row,
    row_axes,
    table_of,
)
from planish.report.relation import draw_dots, draw_fit
from planish.report.sentences.explain import (
    AnyModel,
    independent_cells,
    say_answer,
    say_notes,
    say_reading,
    say_surer,
)
from planish.report.statement import p_text
from planish.report.summary import KeyFigure

if TYPE_CHECKING:
    import xarray as xr

_WIDEST_NAME = 245.0  # pixels, of a row
_MOST_LETTERS = 36  # of that name
_BOX = (86.0, 14.0, HALF - 106.0, 226.0)  # of a diagram on half a page of 310 pixels


def explain_page(model: AnyModel, *, source: str, version: str) -> tuple[str, list[Picture]]:
    """Return the page of a model as HTML, and its figures in the order shown.

    Parameters
    ----------
    model : Explained or ExplainedSeries
    source : str
        Name of the run or series.
    version : str
        That of the program.
    """
    section = explained_section(model)
    return answer_page(section, source=source, version=version), section["pictures"]


def explained_section(model: AnyModel | None) -> Entries:
    """Give what page and report show of a model; nothing of none."""
    if model is None:
        return {}
    titles = [in_words(c.title) for c in model.coefficients.values()]
    return {
        "question": f"What explains {in_words(model.title)}?",
        "about": ", ".join(titles),
        "is_sound": isinstance(model, ExplainedSeries) or model.trust == "ok",
        "answer": say_answer(model),
        "tiles": tiles_of(model),
        "surer": say_surer(model),
        "reading": say_reading(model),
        "tables": coefficient_tables(model),
        "notes": say_notes(model),
        "pictures": [draw_coefficients(model), *details_of(model)],
    }


def details_of(model: AnyModel) -> list[Picture]:
    """Figures beside that of the coefficients: other cells, partial plots, residuals.

    A series has none, and a model that was read from a file no cells.
    """
    pictures: list[Picture] = []
    if isinstance(model, ExplainedSeries):
        return pictures
    if len(model.sizes) > 1:
        pictures.append(draw_sizes(model))
    if model.cells is not None:
        pictures += [draw_partial(model, name) for name in strongest(model.coefficients)]
        pictures.append(draw_residuals(model))
    if model.residuals is not None:
        pictures.append(draw_correlogram(model, model.residuals))
    return pictures


def tiles_of(model: AnyModel) -> list[KeyFigure]:
    """The figures that lead: what is explained, and what it rests on."""
    out_text = ""
    if is_known(model.r2_out):
        out_text = f"out of sample {percent(model.r2_out, 2)}"
    n_text = f"n_eff, of n = {count(model.n)} cells"
    cell_text = "all maps are averaged over them first"
    tiles = [
        KeyFigure(percent(model.r2, 2), "", "of the variance explained (R²)", out_text),
        KeyFigure(independent_cells(model), "", "independent cells", n_text),
        KeyFigure(plain(model.cell_um), "", "cells, edge", cell_text),
    ]
    if isinstance(model, ExplainedSeries):
        tiles.append(KeyFigure(count(model.sheets), "", "sheets", f"{count(model.fields)} fields"))
    return tiles


def coefficient_tables(model: AnyModel) -> WordTables:
    """The coefficients in words, the largest first, as tables by their headings.

    Those are ``Coefficients`` and, of one specimen, ``Diagnostics``: a row for each map.
    """
    tables: WordTables = {}
    for name in strongest(model.coefficients):
        c: Any = model.coefficients[name]
        row = {
            "Map": c.title,
            "Standardised": fixed(c.standardised, 2),
            "95 %": interval_text(c.interval),
            "Plain": " ".join([number(c.plain), *_unit_of_plain(model, c)]),
            "95 % of plain": numbers_text(c.plain_interval),
            "p (Holm)": p_text(c.p_of_set),
        }
        tables.setdefault("Coefficients", []).append(row)
        if isinstance(model, ExplainedSeries):
            between = c.between_sheets  # None of a single sheet
            row["Spread between sheets"] = NONE if between is None else fixed(between.sd_between, 2)
            continue
        diagnostics = {
            "Map": c.title,
            "n_eff": count(round(c.n_eff)),
            "VIF": fixed(c.vif, 1),
            "Explains alone": percent(c.unique, 2),
            "Over ranks": fixed(c.rank, 2),
            "GLS": fixed(c.weighed, 2),
        }
        tables.setdefault("Diagnostics", []).append(diagnostics)
    return tables


def _unit_of_plain(model: AnyModel, coefficient: CoefficientFacts) -> list[str]:
    """Unit of the response per unit of the map, in words; none where neither has one."""
    words = [unit(model.units)]
    units = unit(coefficient.units)
    if units:
        words.append(f"per {units}")
    return [*filter(None, words)]


def tables_of(model: AnyModel) -> dict[str, Table]:
    """What a model says as tables, by the name of a file: columns of numbers by their headings."""
    tables = {"coefficients": _coefficient_table(model)}
    if isinstance(model, ExplainedSeries):
        specimen_rows: list[Entries] = []
        for name, m in model.specimens.items():
            row = {"specimen": name, "r2": m.r2, "n": m.n, "n_eff": m.n_eff}
            coefficients = {key: c.standardised for key, c in m.coefficients.items()}
            specimen_rows.append(row | coefficients)
        return tables | {"specimens": table_of(specimen_rows)}
    tables["sizes"] = table_of(_size_rows(model))
    if model.cells is not None:
        tables["cells"] = _table_of_cells(model.cells)
    return tables


def _coefficient_table(model: AnyModel) -> Table:
    coefficients: Mapping[str, ResultModel] = model.coefficients
    return table_of([{"map": name} | flat_row(c) for name, c in coefficients.items()])


def _size_rows(model: Explained) -> list[Entries]:
    """A row of each map and size of cells."""
    rows: list[Entries] = []
    for size in model.sizes:
        for name, value in size.standardised.items():
            low, high = size.intervals[name]
            interval = {"map": name, "standardised": value, "low": low, "high": high}
            rows.append(flat_row(size) | interval)
    return rows


def _table_of_cells(cells: xr.Dataset) -> Table:
    """Cells that have all values, a row each: their middles in um, and the mean of every map."""
    cells = cells.drop_vars([k for k in cells if str(k).endswith(" freed")])
    complete = cells.stack(cell=("cell_y", "cell_x")).dropna("cell")
    columns = {"y_um": complete["cell_y"], "x_um": complete["cell_x"], **complete}
    return {str(name): values.values.tolist() for name, values in columns.items()}


def draw_coefficients(model: AnyModel) -> Picture:
    """Draw standardised coefficients with their intervals, the largest first, a row each."""
    names = strongest(model.coefficients)
    coefficients: list[Any] = [model.coefficients[name] for name in names]
    ends = [end for c in coefficients for end in c.interval if is_known(end)]
    row_names = [c.title[:_MOST_LETTERS] for c in coefficients]
    values = [c.standardised for c in coefficients]
    plotted = [0.0, *ends, *values]
    canvas, axes = row_axes(row_names, plotted, "Standardised coefficient", widest_px=_WIDEST_NAME)
    axes.upright(0.0, dash="4 3")
    colours = colours_of(names).values()
    for row, (coefficient, colour) in enumerate(zip(coefficients, colours, strict=True)):
        value = values[row]
        y = row + 0.5
        if is_known(coefficient.interval):
            axes.line(coefficient.interval, y, colour=colour, width=2.5)
        axes.dots(value, y, colour=colour, size=9, is_open=not coefficient.direction)
        # The number stands on the side of the dot that the line at 0 is not on.
        anchor = "start" if value >= 0 else "end"
        axes.text(value, y, fixed(value, 2), anchor=anchor, shift=(0, -6), size=SMALL)
    caption = (
        "Dots: standardised coefficients, the others held. Lines: their 95 % intervals, from"
        f" {independent_cells(model)} independent cells of n = {count(model.n)} (cells of"
        f" {plain(model.cell_um)}, valid in all maps). Open dots: not distinguishable from 0."
        " Each map has its colour in all figures."
    )
    title = f"What explains {model.title[:1].lower()}{model.title[1:]}"
    return canvas.picture(title, caption, {"coefficients": _coefficient_table(model)})


def draw_sizes(model: Explained) -> Picture:
    """Draw standardised coefficients over cells of growing size, the declared one marked.

    The axis below is the logarithm of the edge in um.
    """
    rows = [row for row in model.sizes if row.standardised]
    intervals = chain.from_iterable(row.intervals.values() for row in rows)
    ends = [0.0, *filter(is_known, chain.from_iterable(intervals))]
    logs = [math.log10(row.cell_um) for row in rows]
    names = strongest(model.coefficients)
    colours = colours_of(names)
    canvas = Canvas(HALF, 290 + LINE_PX * len(names))
    x_limits = (min(logs) - 0.1, max(logs) + 0.1)
    y_limits = (min(ends) - 0.05, max(ends) + 0.05)
    axes = canvas.axes(*_BOX, (*x_limits, *y_limits))
    axes.upright(math.log10(model.cell_um), colour=FAINT, width=24)
    axes.across(0.0, dash="4 3")
    for index, (name, colour) in enumerate(colours.items()):
        # Side by side, so that intervals do not hide each other.
        places = np.array(logs) + 0.02 * (index - (len(names) - 1) / 2)
        for place, row in zip(places, rows, strict=True):
            axes.line(place, row.intervals[name], colour=colour, width=1.4)
        values = [row.standardised[name] for row in rows]
        axes.line(places, values, colour=colour, width=1.2)
        axes.dots(places, values, colour=colour, size=6)
    draw_log_axes(canvas, axes, "Edge of the cells / µm", "Standardised coefficient")
    titles = [model.coefficients[name].title for name in names]
    canvas.name_curves(titles, colours.values(), (_BOX[0], 298))
    word = "declared" if model.declared else "stated"
    caption = (
        f"Coefficients with 95 % intervals; the bar marks the {word} size. A size that is"
        " chosen after a look at this curve is a choice to be stated."
    )
    tables = {"sizes": table_of(_size_rows(model))}
    return canvas.picture("The same model over other cells", caption, tables)


def draw_partial(model: Explained, name: str) -> Picture:
    """Draw response against one map, both freed of what the others explain.

    The response so freed is what the whole model leaves and what this map explains.
    """
    coefficient = model.coefficients[name]
    freed = model.cells[f"{name} freed"].values
    is_valid = np.isfinite(freed)
    x = freed[is_valid]
    y = model.cells["residual"].values[is_valid] + coefficient.plain * x
    canvas = Canvas(HALF, 310)
    colour = colours_of(strongest(model.coefficients))[name]
    axes = draw_dots(canvas, (x, y), _BOX, bar_px=55.0, colour=colour)
    ends = np.array([x.min(), x.max()])
    draw_fit(axes, ends, coefficient.plain * ends, colour=INK)
    x_label = axis_label(f"{coefficient.title}, freed of the others", unit(coefficient.units))
    canvas.ticks(axes, x_label, axis_label(f"{model.title}, freed", unit(model.units)))
    caption = (
        "Both maps less what the other maps explain of them; the slope of the line is the plain"
        f" coefficient. n = {count(x.size)} cells."
    )
    title = f"Partial regression: {coefficient.title[:1].lower()}{coefficient.title[1:]}"
    points = {"freed": x.tolist(), "response_freed": y.tolist()}
    return canvas.picture(title, caption, {"points": points})


def draw_residuals(model: Explained) -> Picture:
    """Draw the map of what a model leaves."""
    residual = model.cells["residual"]
    scale = limits(residual, symmetric=True)
    label = axis_label("Residual", unit(model.units))
    canvas, _ = draw_map(residual, scale=scale, label=label)
    caption = (
        f"Residuals of n = {count(model.n)} cells of {plain(model.cell_um)}. Stains, creases"
        " and a slow trend show here: mask what does not belong."
    )
    return canvas.picture("What the model leaves", caption)


def draw_correlogram(model: Explained, curve: Variogram) -> Picture:
    """Draw how far the residuals resemble each other: 1 less the variogram over its sill."""
    distances = [0.0, *curve.distances_um]
    values = [1.0, *(1 - value / curve.sill for value in curve.values)]
    canvas = Canvas(HALF, 310)
    extent = (0.0, distances[-1] * 1.02, min(*values, -0.1) - 0.05, 1.05)
    axes = canvas.axes(*_BOX, extent)
    axes.across(0.0)
    axes.line(distances, values, colour=INK, width=1.4)
    axes.dots(distances, values, colour=INK, size=3)
    canvas.ticks(axes, "Distance / µm", "Correlation of residuals")
    range_text = ""
    if is_known(curve.range_um):
        range_text = f" It falls to 1/e at {length(curve.range_um)}."
    caption = (
        f"Why n is no sample size.{range_text} Blocks of R² out of sample:"
        f" {length(model.block_um)} and wider."
    )
    tables = {"correlogram": {"distance_um": distances, "r": values}}
    return canvas.picture("Correlogram of the residuals", caption, tables)
