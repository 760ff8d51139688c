"""What is compared over the specimens of a series.

These are statistics of the leading maps, and their correlation.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping

from planish.core.errors import InputError
from planish.core.numbers import in_words
from planish.core.tables import grouped
from planish.core.text import likely
from planish.measure import property_names, registered
from planish.report.text import as_compared
from planish.series.declared import Declared
from planish.series.gather import FigureRow, FigureRows, RunSummary
from planish.series_results import Cell, Quantity, What

_STATISTICS: tuple[What, ...] = ("mean", "sd", "thin_share")

# Layers and maps of a correlation, the sheet first: layer, map, other layer, other map
Pair = tuple[str, str, str, str]


def check_maps_known(declared: Declared) -> None:
    """Raise InputError for a map that no sheet can have, before anything is linked."""
    names = property_names()
    for name in maps_of(declared):
        if name not in names:
            words = likely(name, names)
            raise InputError(f"There is no map {name}; there are {', '.join(names)}.{words}")


def maps_of(declared: Declared) -> list[str]:
    """Maps that were declared, by themselves or with a margin: of ``MAP`` or ``MAP.sd``.

    That of r has none.
    """
    names = list(declared.headline)
    for margin in declared.margin:
        name, dot, statistic = margin.rpartition(".")
        if margin != "r":
            names.append(name if dot and statistic in (*_STATISTICS, "r") else margin)
    return names


def margin_of(quantity: Quantity, declared: Declared) -> float | None:
    """The margin that was declared for a quantity."""
    full_name = f"{quantity.map}.{quantity.what}"
    short_name = {"mean": quantity.map, "r": "r"}.get(quantity.what, full_name)
    return declared.margin.get(full_name, declared.margin.get(short_name))


def quantities_of(
    rows: FigureRows, runs: Mapping[str, RunSummary], declared: Declared
) -> tuple[Quantity, ...]:
    """Give the quantities that are compared.

    Of each leading map these are its mean, standard deviation and thin share, and r with the other
    map. ``rows`` are those of all runs; ``runs``: what is kept of each, by specimen.

    The declared headline maps lead; without any, all that are the headline of a run, those of the
    most runs first. Maps with a margin follow. InputError for a declared map that is in no run;
    without runs no name is checked.
    """
    thin_um = declared.thin_um
    if thin_um is None:
        # The limit that most runs have.
        limits = Counter(run.thin_um for run in runs.values() if run.thin_um is not None)
        thin_um = max(limits, key=limits.__getitem__, default=None)
    quantities: list[Quantity] = []
    for name in _leading_maps(rows, runs, declared):
        map_rows = [row for row in rows if name in (row.map, row.other_map)]
        for layer in dict.fromkeys(row.layer for row in map_rows if row.quantity == "mean"):
            quantities += _statistics(map_rows, name, layer, thin_um)
        quantities += _correlations(map_rows, name)
    return tuple(quantities)


def _leading_maps(
    rows: FigureRows, runs: Mapping[str, RunSummary], declared: Declared
) -> list[str]:
    """Maps whose quantities are compared, the one that leads first; as :func:`quantities_of`."""
    maps = {row.map for row in rows if row.quantity == "mean"}
    declared_maps = maps_of(declared)
    for name in declared_maps:
        if runs and name not in maps:
            names = ", ".join(sorted(maps)) or "none"
            raise InputError(
                f"No run has a map {name}; there are {names}.{likely(name, maps)} Name one of them."
            )
    # Of how many runs a map is the headline: the most frequent one leads.
    counts = Counter(name for run in runs.values() for name in run.headlines)
    leading_maps = declared.headline or sorted(counts, key=counts.__getitem__, reverse=True)
    return list(dict.fromkeys([*leading_maps, *declared_maps]))


def _statistics(
    rows: FigureRows, name: str, layer: str, thin_um: float | None
) -> Iterator[Quantity]:
    """Mean, standard deviation and thin share of a map, where a run has them.

    ``rows``: of that map; ``layer``: its layer, empty where each run has one sheet; ``thin_um``:
    limit of the thin share, None for none.
    """
    map_title = _in_words(name, layer)
    titles: dict[What, str] = {
        "mean": f"mean {map_title}",
        "sd": f"standard deviation of {map_title}",
    }
    if thin_um is not None:
        limit = f"with {map_title} below {thin_um:g} um" if thin_um else f"without {map_title}"
        titles["thin_share"] = f"share {limit}"
    for statistic, title in titles.items():
        at_um = thin_um if statistic == "thin_share" else None
        row = _row_of(rows, (statistic, name, layer), at_um)
        if row is not None:
            yield Quantity(
                layer=layer,
                map=name,
                what=statistic,
                at_um=at_um,
                unit=row.unit,
                title=title,
                map_title=map_title,
            )


def _row_of(
    rows: FigureRows, statistic: tuple[str, str, str], at_um: float | None
) -> FigureRow | None:
    """The first row of a quantity, map and layer, ``statistic``; at a limit, where it is of one.

    None where there is none.
    """
    for row in rows:
        is_alike = at_um is None or _alike(row.at_um, at_um)
        if is_alike and (row.quantity, row.map, row.layer) == statistic:
            return row
    return None


def _in_words(name: str, layer: str) -> str:
    """Name a map in a sentence.

    It is called what the program calls it, or by its name where the program does not know it.
    """
    properties = registered()
    title = properties[name].long_name if name in properties else name.replace("_", " ")
    return in_words(title) + (f" of {layer}" if layer else "")


def _correlations(rows: FigureRows, name: str) -> list[Quantity]:
    """Give the correlations of a map at the usual points.

    They are with the images, or with the same map of another sheet. Usual are the points that are
    the largest of most specimens, and of as many the larger ones.
    """
    size_counts: dict[Pair, Counter[float]] = {}
    for specimen_rows in grouped(rows, lambda row: row.specimen).values():
        for pair, size in _largest_points(specimen_rows, name).items():
            size_counts.setdefault(pair, Counter())[round(size, 3)] += 1
    quantities: list[Quantity] = []
    for (layer, first, other_layer, second), counts in size_counts.items():
        at_um = max(counts, key=lambda size: (counts[size], size))
        map_title = _in_words(first, layer)
        other = other_layer or "the image" if second == "image" else f"that of {other_layer}"
        quantities.append(
            Quantity(
                layer=layer,
                map=first,
                what="r",
                other_layer=other_layer,
                other_map=second,
                at_um=at_um,
                unit="1",
                title=f"r of {as_compared(map_title, first)} and {other}, points of {at_um:g} um",
                map_title=map_title,
            )
        )
    return quantities


def _largest_points(rows: FigureRows, name: str) -> dict[Pair, float]:
    """Size of the largest points over which a map was correlated, by pair."""
    largest_um: dict[Pair, float] = {}
    for row in rows:
        pair = _pair_of(row)
        if pair is None or pair[1] != name or row.quantity != "points":
            continue
        if row.value and row.at_um:
            largest_um[pair] = max(largest_um.get(pair, 0.0), row.at_um)
    return largest_um


def _pair_of(row: FigureRow) -> Pair | None:
    """The pair of a row, the sheet first; None unless it is with an image or the same map."""
    sheet = (row.layer, row.map)
    other = (row.other_layer, row.other_map)
    if row.map == "image" != row.other_map:
        sheet, other = other, sheet
    if other[1] not in ("image", sheet[1]):
        return None
    return (*sheet, *other)


def cell_of(rows: FigureRows, q: Quantity, *, with_doubtful: bool) -> Cell:
    """Give a quantity of the specimen that rows are of.

    It says whether it takes part in means, as doubtful figures may.
    """
    if q.what == "r":
        return _cell_of_r(rows, q, with_doubtful=with_doubtful)
    row = _row_of(rows, (q.what, q.map, q.layer), q.at_um)
    if row is not None:
        reason = _why_not(row, with_doubtful=with_doubtful)
        return Cell(value=row.value, trust=row.trust, counts=not reason, why_not=reason)
    # A map that is withheld takes its thin shares along; the row is not there then.
    for row in rows:
        is_withheld = (row.quantity, row.map, row.trust) == ("mean", q.map, "withheld")
        if is_withheld and q.what == "thin_share":
            return Cell(trust="withheld", why_not=_why_not(row, with_doubtful=with_doubtful))
    return Cell(why_not="not measured")


def _cell_of_r(rows: FigureRows, q: Quantity, *, with_doubtful: bool) -> Cell:
    """As :func:`cell_of`, of a correlation: at the usual points, or else its largest.

    At others than the usual points it takes part in no mean.
    """
    pair = (q.layer, q.map, q.other_layer, q.other_map)
    pair_rows = [row for row in rows if _pair_of(row) == pair]
    largest_um = _largest_points(pair_rows, q.map)
    if pair not in largest_um:
        is_linked = any(row.quantity == "r" for row in rows)
        return Cell(why_not="not measured" if is_linked else "not linked")
    row_by_quantity = _rows_at(pair_rows, q.at_um) or _rows_at(pair_rows, largest_um[pair])
    r = row_by_quantity["r"]
    n_eff_interval = row_by_quantity["n_eff_interval"].value
    reason = _why_not(r, with_doubtful=with_doubtful)
    reason = reason or _why_not_of_r(r, n_eff_interval or 0.0, q.at_um)
    return Cell(
        value=r.value,
        low=r.low,
        high=r.high,
        n_eff=row_by_quantity["n_eff"].value,
        n_eff_interval=n_eff_interval,
        trust=r.trust,
        counts=not reason,
        why_not=reason,
    )


def _rows_at(rows: FigureRows, at_um: float | None) -> dict[str, FigureRow]:
    """Rows of one size of points, by their quantities."""
    return {row.quantity: row for row in rows if _alike(row.at_um, at_um)}


def _why_not(row: FigureRow, *, with_doubtful: bool) -> str:
    """Why a figure takes part in no mean; empty where it does."""
    by = f" ({row.checks})" if row.checks else ""
    if row.trust == "withheld":
        return f"withheld{by}"
    if row.value is None:
        return "not measured"
    if row.trust == "doubtful" and not with_doubtful:
        return f"doubtful{by}"
    return ""


def _why_not_of_r(r: FigureRow, n_eff: float, usual_um: float | None) -> str:
    """Why an r takes part in no mean although it is trusted; empty where it does."""
    if not _alike(r.at_um, usual_um):
        return f"points of {r.at_um:g} um, others of {usual_um:g} um"
    # With more than 4 independent points the scatter of Fisher's z is known.
    has_scatter = n_eff > 4.0 and abs(r.value or 0.0) < 1
    return "" if has_scatter else "too few independent points"


def _alike(a: float | None, b: float | None) -> bool:
    return a is not None and b is not None and math.isclose(a, b, rel_tol=1e-3)
