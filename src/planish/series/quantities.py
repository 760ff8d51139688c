"""What is compared over the specimens of a series: statistics of the leading maps, and their correlation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from planish.core.errors import InputError
from planish.core.series_results import Cell, Quantity, What
from planish.core.text import likely
from planish.measure import registered
from planish.report.text import in_words
from planish.series.declared import Declared
from planish.series.gather import Brief, Gathered
from planish.series.rows import Row

_STATISTICS: tuple[What, ...] = ("mean", "sd", "thin_share")
_ALIKE = 1e-3  # of a length: point sizes that are one
_MOST_SCATTERED = 4.0  # independent points, from which on the scatter of Fisher's z is known


@dataclass(frozen=True, slots=True)
class Layers:
    """How layers are called over all specimens: the only sheet, and the only image, need no name."""

    briefs: Mapping[str, Brief]

    def name(self, specimen: str, layer: str) -> str:
        """Name of a layer of a specimen for the whole series."""
        own = self.briefs[specimen]
        of = "sheets" if layer in own.sheets else "images"
        return "" if all(len(getattr(one, of)) <= 1 for one in self.briefs.values()) else layer


def headlines_of(found: Gathered, declared: Declared) -> tuple[str, ...]:
    """Maps that are compared: those declared, or those that stand for most runs; and those with a margin.

    Raises
    ------
    InputError
        If a map that was declared is in no run.
    """
    maps = {row.map for row in found.rows if row.quantity == "mean"}
    wanted = maps_of(declared)
    for name in wanted:
        if name not in maps and found.briefs:
            raise InputError(
                f"No run has a map {name}; there are {', '.join(sorted(maps)) or 'none'}.{likely(name, maps)} Name one "
                "of them."
            )
    usual = Counter(name for brief in found.briefs.values() for name in brief.headlines)
    leading = declared.headline or tuple(name for name, _ in usual.most_common())
    return tuple(dict.fromkeys([*leading, *wanted]))


def check_maps_known(declared: Declared) -> None:
    """Refuse a map that no sheet can have, before anything is linked.

    Raises
    ------
    InputError
        With the name that was probably meant.
    """
    for name in maps_of(declared):
        if name not in registered():
            raise InputError(
                f"There is no map {name}; there are {', '.join(sorted(registered()))}.{likely(name, registered())}"
            )


def maps_of(declared: Declared) -> list[str]:
    """Maps that were declared, by themselves or with a margin."""
    return [*declared.headline, *(_map_of(name) for name in declared.margin if _map_of(name))]


def _map_of(margin: str) -> str:
    """Map of a margin, ``MAP``, ``MAP.sd`` ...; empty for that of r."""
    name, dot, what = margin.rpartition(".")
    return ("" if margin == "r" else margin) if not dot or what not in (*_STATISTICS, "r") else name


def margin_of(quantity: Quantity, declared: Declared) -> float | None:
    """The margin that was declared for a quantity."""
    names = [f"{quantity.map}.{quantity.what}"]
    names += [quantity.map] if quantity.what == "mean" else ["r"] if quantity.what == "r" else []
    return next((declared.margin[name] for name in names if name in declared.margin), None)


def quantities_of(found: Gathered, declared: Declared) -> tuple[Quantity, ...]:
    """What is compared: of each leading map its mean, standard deviation and thin share, and r with the other map."""
    layers, maps = Layers(found.briefs), headlines_of(found, declared)
    limits = Counter(brief.thin_um for brief in found.briefs.values() if brief.thin_um is not None)
    thin_um = declared.thin_um if declared.thin_um is not None else max(limits, key=lambda k: limits[k], default=None)
    out: list[Quantity] = []
    for name in maps:
        own = [row for row in found.rows if name in (row.map, row.other_map)]
        for layer in dict.fromkeys(layers.name(r.specimen, r.layer) for r in own if r.quantity == "mean"):
            of_layer = [r for r in own if r.map == name and layers.name(r.specimen, r.layer) == layer]
            out += [q for what in _STATISTICS if (q := _statistic(of_layer, what, layer, thin_um)) is not None]
        out += _correlations(own, name, layers)
    return tuple(out)


def _statistic(rows: Sequence[Row], what: What, layer: str, thin_um: float | None) -> Quantity | None:
    """Mean, standard deviation or thin share of a map; None where no run states it."""
    rows = [r for r in rows if r.quantity == what and (what != "thin_share" or _alike(r.at_um, thin_um))]
    if not rows:
        return None
    words = in_words(title_of(rows[0].map)) + (f" of {layer}" if layer else "")
    title = {
        "mean": f"mean {words}", "sd": f"standard deviation of {words}",
        "thin_share": f"share with {words} below {thin_um:g} um" if thin_um else f"share without {words}",
    }[what]  # fmt: skip
    at_um = thin_um if what == "thin_share" else None
    return Quantity(
        layer=layer, map=rows[0].map, what=what, at_um=at_um, unit=rows[0].unit, title=title, map_title=words
    )


def _correlations(rows: Sequence[Row], name: str, layers: Layers) -> list[Quantity]:
    """Correlations of a map with the images, or with the same map of another sheet, at the usual points."""
    found: dict[tuple[str, str, str, str], Counter[float]] = {}
    for specimen in dict.fromkeys(row.specimen for row in rows):
        for key, size in _largest_points([r for r in rows if r.specimen == specimen], name, layers).items():
            found.setdefault(key, Counter())[round(size, 3)] += 1
    out: list[Quantity] = []
    for (layer, first, other_layer, second), sizes in found.items():
        at_um = max(sizes, key=lambda size: (sizes[size], size))
        words = in_words(title_of(first)) + (f" of {layer}" if layer else "")
        other = f"{other_layer or 'the image'}" if second == "image" else f"that of {other_layer}"
        out.append(
            Quantity(
                layer=layer,
                map=first,
                what="r",
                other_layer=other_layer,
                other_map=second,
                at_um=at_um,
                unit="1",
                title=f"r of {words} and {other}, points of {at_um:g} um",
                map_title=words,
            )
        )
    return out


def _largest_points(rows: Iterable[Row], name: str, layers: Layers) -> dict[tuple[str, str, str, str], float]:
    """The largest points of each correlation of a map, over which there is any point."""
    found: dict[tuple[str, str, str, str], float] = {}
    for row in rows:
        key = key_of(row, layers)
        if row.quantity == "points" and row.value and row.at_um and key is not None and key[1] == name:
            found[key] = max(found.get(key, 0.0), row.at_um)
    return found


def key_of(row: Row, layers: Layers) -> tuple[str, str, str, str] | None:
    """Layers and maps of a correlation, the sheet first; None where it is none with an image or the same map."""
    one, two = ((layers.name(row.specimen, n), m) for n, m in ((row.layer, row.map), (row.other_layer, row.other_map)))
    if one[1] == "image" and two[1] != "image":
        one, two = two, one
    return (*one, *two) if two[1] in ("image", one[1]) else None


def cells_of(
    specimen: str, rows: Sequence[Row], quantities: Sequence[Quantity], layers: Layers, *, doubtful: bool
) -> tuple[Cell, ...]:
    """The quantities of one specimen, and whether each takes part in means.

    Parameters
    ----------
    specimen : str
    rows : sequence of Row
        Of this specimen.
    quantities : sequence of Quantity
    layers : Layers
    doubtful : bool
        Whether doubtful figures take part.
    """
    return tuple(
        _cell_of_r(rows, q, layers, doubtful=doubtful) if q.what == "r"
        else _cell(specimen, rows, q, layers, doubtful=doubtful)
        for q in quantities
    )  # fmt: skip


def _cell(specimen: str, rows: Sequence[Row], q: Quantity, layers: Layers, *, doubtful: bool) -> Cell:
    for row in rows:
        same = row.quantity == q.what and row.map == q.map and layers.name(specimen, row.layer) == q.layer
        if same and (q.what != "thin_share" or _alike(row.at_um, q.at_um)):
            why = _why_not(row, doubtful=doubtful)
            return Cell(value=row.value, trust=row.trust, counts=not why, why_not=why)
    # A map that is withheld takes its thin shares along; the row is not there then.
    withheld = [r for r in rows if r.map == q.map and r.quantity == "mean" and r.trust == "withheld"]
    if withheld and q.what == "thin_share":
        return Cell(trust="withheld", why_not=_why_not(withheld[0], doubtful=doubtful))
    return Cell(why_not="not measured")


def _cell_of_r(rows: Sequence[Row], q: Quantity, layers: Layers, *, doubtful: bool) -> Cell:
    key = (q.layer, q.map, q.other_layer, q.other_map)
    own = [row for row in rows if row.other_map and key_of(row, layers) == key]
    sizes = _largest_points(own, q.map, layers)
    if key not in sizes:
        return Cell(why_not="not linked" if not any(r.quantity == "r" for r in rows) else "not measured")
    at_um = next((r.at_um for r in own if r.quantity == "r" and _alike(r.at_um, q.at_um)), sizes[key])
    found = {r.quantity: r for r in own if r.at_um == at_um}
    row, scatter = found["r"], found["n_eff_interval"].value
    why = _why_not(row, doubtful=doubtful)
    if not why and not _alike(at_um, q.at_um):
        why = f"points of {at_um:g} um, others of {q.at_um:g} um"
    if not why and (scatter is None or scatter <= _MOST_SCATTERED or abs(row.value or 0.0) >= 1):
        why = "too few independent points"
    return Cell(
        value=row.value, low=row.low, high=row.high, n_eff=found["n_eff"].value, n_eff_interval=scatter,
        trust=row.trust, counts=not why, why_not=why,
    )  # fmt: skip


def _why_not(row: Row, *, doubtful: bool) -> str:
    """Why a figure takes part in no mean; empty where it does."""
    by = f" ({row.checks})" if row.checks else ""
    if row.trust == "withheld":
        return f"withheld{by}"
    if row.value is None:
        return "not measured"
    return f"doubtful{by}" if row.trust == "doubtful" and not doubtful else ""


def title_of(name: str) -> str:
    """Title of a map, as the program has it; its name where the program does not know it."""
    known = registered()
    return known[name].long_name if name in known else name.replace("_", " ")


def _alike(a: float | None, b: float | None) -> bool:
    return a is not None and b is not None and abs(a - b) <= _ALIKE * max(abs(a), abs(b))
