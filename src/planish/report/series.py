"""The page of a series: one file that needs nothing else, no script among it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import NamedTuple
from urllib.parse import quote

from planish.core.series_results import SeriesResults, Specimen
from planish.report import series_words as words
from planish.report import statement, text
from planish.report.draw import Picture
from planish.report.page import template
from planish.report.series_figures import SmallMap, draw_groups, tile_maps

_MOST_COLUMNS = 8  # quantities of the table of specimens, and of figures
_MOST_ORDERS = 9
_OUT = ("refused", "damaged", "withheld", "open")
_SOURCES = (
    ("Intervals over sheets", "Student's t over the means of sheets; two papers after Welch (1947), Biometrika 34, 28, "
     "doi:10.1093/biomet/34.1-2.28; the same sheets before and after by the differences of single sheets."),
    ("Several differences", "p of all differences of the series are put right together: Holm (1979), Scand. J. "
     "Statist. 6, 65."),
    ("Between and within sheets", "Analysis of variance with unweighted means: Thomas and Hultquist (1978), Ann. "
     "Statist. 6, 582, doi:10.1214/aos/1176344202."),
    ("Correlation over sheets", "Mean over sheets of Fisher's z, in which every sheet counts alike. Heterogeneity: "
     "Cochran's Q, and I² of Higgins and Thompson (2002), Statist. Med. 21, 1539, doi:10.1002/sim.1186; the variance "
     "of one field's z is 1 over its independent points less 3."),
    ("Equivalence", "Two one-sided tests at 5 %: Schuirmann (1987), J. Pharmacokinet. Biopharm. 15, 657, "
     "doi:10.1007/BF01068419."),
    ("Two instruments", "Bias and limits of agreement: Bland and Altman (1986), Lancet 327, 307, with intervals that "
     "count independent points; waves in common by Fourier ring correlation."),
)  # fmt: skip


class Order(NamedTuple):
    """The specimens in one order: what it is called, and their numbers."""

    name: str
    numbers: list[int]


class Line(NamedTuple):
    """One specimen as the table shows it."""

    specimen: Specimen
    link: str
    factors: list[str]
    cells: list[tuple[str, str]]  # text, and a word of doubt


def series_page(results: SeriesResults, maps: Sequence[SmallMap]) -> str:
    """Return the page of a series as HTML.

    Parameters
    ----------
    results : SeriesResults
        Runs relative to the folder of the page.
    maps : sequence of SmallMap
        Of the map that leads, in the order of the specimens.

    Returns
    -------
    str
        The same input gives the same text.
    """
    columns = list(range(min(len(results.quantities), _MOST_COLUMNS)))
    pictures: list[tuple[int, Picture]] = [
        (k, picture) for k in columns if (picture := draw_groups(results, k)) is not None
    ]
    factors = [
        name for name in results.factors if any(name in one.member.factors for one in results.specimens)
    ]  # fmt: skip
    page = template("planish.report", "series.html.j2").render(
        results=results, words=words, statement=statement, text=text, sources=_SOURCES, factors=factors,
        columns=columns, lines=[_line(one, factors, columns, results) for one in results.specimens],
        orders=orders(results, factors), pictures=pictures, tiled=tile_maps(maps),
        out=[one for one in results.specimens if one.member.state in _OUT],
        linked=any(one.kind not in (None, "map") for one in results.specimens),
    )  # fmt: skip
    return f"{page}\n"


def _line(one: Specimen, factors: Sequence[str], columns: Sequence[int], results: SeriesResults) -> Line:
    cells = [(text.NONE, "")] * len(columns)
    if one.cells:
        shown = ((one.cells[k], results.quantities[k]) for k in columns)
        cells = [(words.cell_text(c, q), _doubt(c.trust, c.why_not)) for c, q in shown]
    link = "" if one.kind is None else f"{quote(one.member.run or '')}/report.html"
    return Line(one, link, [one.member.factors.get(name, "") for name in factors], cells)


def _doubt(trust: str, why_not: str) -> str:
    """A word below a figure that is not used like the others."""
    return trust if trust != "ok" else why_not if why_not.startswith(("too few", "points of")) else ""


def orders(results: SeriesResults, factors: Sequence[str]) -> list[Order]:
    """The orders in which the table of specimens is written: as listed, by name, by factors, by figures."""
    specimens = results.specimens
    found = [("as listed", list(range(len(specimens))))]

    def by(name: str, key: Callable[[Specimen], tuple[object, ...]]) -> None:
        numbers = sorted(range(len(specimens)), key=lambda k: key(specimens[k]))  # pyright: ignore
        if len(found) < _MOST_ORDERS and all(numbers != other for _, other in found):
            found.append((name, numbers))

    by("name", lambda one: (natural(one.member.name),))
    by("state", lambda one: (one.member.state != "whole", one.member.state, one.light or ""))
    for name in sorted(factors, key=lambda name: name not in results.grouped_by)[:3]:
        by(name, lambda one, name=name: (not one.member.factors.get(name), natural(one.member.factors.get(name, ""))))
    for k, q in enumerate(results.quantities):
        title = {"mean": "mean", "sd": "standard deviation", "thin_share": "thin share", "r": "r"}[q.what]
        if q.map == results.quantities[0].map:
            by(title, lambda one, k=k: (_known(one, k) is None, _known(one, k) or 0.0))
    return [Order(name, numbers) for name, numbers in found]


def _known(one: Specimen, k: int) -> float | None:
    v = one.cells[k].value if one.cells else None
    return v if v is not None and math.isfinite(v) else None


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Key that puts 2 before 10."""
    parts = re.findall(r"\d+|\D+", name.casefold())
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts)
