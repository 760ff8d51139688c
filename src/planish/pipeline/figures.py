"""The figures of a run as one table, ``figures.csv``: value, standard error, and what the checks leave of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from planish.core.checks import Check, concerned
from planish.core.facts import is_known
from planish.core.tables import table_text
from planish.results import LayerFacts, Results

HEADER = ("layers", "figure", "statistic", "value", "standard_error", "units", "n", "trust", "checks")
Row = Sequence[Any]


def figures_text(results: Results) -> str:
    """Text of ``figures.csv``: a row for every figure that the page leads with.

    ``trust`` is ``ok``, ``doubtful`` or ``withheld`` (then there is no value), ``checks`` names the checks that say so.
    """
    rows = [row for layer in results.layers for row in _of_layer(layer, results.checks)]
    return table_text(HEADER, [*rows, *_correlations(results)])


def _of_layer(layer: LayerFacts, checks: Sequence[Check]) -> Iterator[Row]:
    for name, p in ({} if layer.sheet is None else layer.sheet.properties).items():
        why = _names(checks, (layer.name,), (name,))
        yield layer.name, name, "mean", _text(p.mean), _text(p.mean_standard_error), p.units, p.n, p.trust, why
        yield layer.name, name, "sd", _text(p.sd), "", p.units, p.n, p.trust, why
        if p.standard_error is not None:
            yield (
                layer.name,
                name,
                "standard error of a column",
                _text(p.standard_error),
                "",
                p.units,
                p.n,
                p.trust,
                why,
            )
    r = layer.registration
    if r is not None and (e := r.expected_error) is not None:
        why = _names(checks, (layer.name,), ("position",))
        for statistic, value in (("median", e.median_um), ("largest", e.largest_um)):
            yield (
                layer.name,
                "expected error of the position",
                statistic,
                _text(value),
                "",
                "um",
                r.matched,
                e.trust,
                why,
            )


def _correlations(results: Results) -> Iterator[Row]:
    for row in results.correlations:
        why = _names(results.checks, (row.a, row.b), (row.a_map, row.b_map, "position", "correlation"))
        name = f"r of {row.a_map} and {row.b_map}"
        size, layers = f"points of {row.point_um:g} um", f"{row.a} {row.b}"
        yield layers, name, size, _text(row.r), "", "1", row.n, row.trust, why
        for end, value in zip(("lower", "upper"), row.interval if is_known(row.interval) else (), strict=False):
            yield layers, name, f"{size}, {end} 95 % limit", value, "", "1", round(row.n_eff), row.trust, why


def _names(checks: Sequence[Check], layers: Sequence[str], figures: Sequence[str]) -> str:
    return "; ".join(c.name for c in concerned(checks, layers, figures) if c.state in ("look", "fail"))


def _text(value: float | None) -> float | str:
    return "" if value is None or not is_known(value) else value
