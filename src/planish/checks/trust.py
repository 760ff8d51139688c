"""What checks mean for the figures of a run: sure, doubtful, or withheld."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

from planish.core.checks import CORRELATION, POSITION, Check, trust_of
from planish.core.facts import Trust
from planish.results import ComparisonRow, CorrelationRow, ExpectedError, LayerFacts, PropertyFacts, Results

Figure = TypeVar("Figure", CorrelationRow, ComparisonRow, PropertyFacts, ExpectedError)


def apply_checks(results: Results) -> Results:
    """Mark every figure by the checks that concern it; what a failed check concerns loses its numbers."""
    checks = results.checks
    if all(check.state in ("pass", "unknown") for check in checks):
        return results
    rows, names = rows_with_trust(results.correlations, checks), tuple(layer.name for layer in results.layers)
    withheld = {(row.a, row.a_map, row.b, row.b_map) for row in rows if row.trust == "withheld"}
    return results.model_copy(update={
        "layers": tuple(_layer_with_trust(layer, checks) for layer in results.layers),
        "correlations": rows,
        "comparison": tuple(_marked(row, _trust_of_pair(names, (row.property,), checks)) for row in results.comparison),
        "evidence": tuple(e for e in results.evidence if (e.a, e.a_map, e.b, e.b_map) not in withheld),
    })  # fmt: skip


def rows_with_trust(rows: Iterable[CorrelationRow], checks: Sequence[Check]) -> tuple[CorrelationRow, ...]:
    """The same correlations, each marked by the checks that concern it."""
    return tuple(_marked(row, _trust_of_pair((row.a, row.b), (row.a_map, row.b_map), checks)) for row in rows)


def _trust_of_pair(layers: tuple[str, ...], maps: tuple[str, ...], checks: Sequence[Check]) -> Trust:
    """Trust in a correlation of maps of some layers."""
    return trust_of(checks, layers, (*maps, POSITION, CORRELATION))


def _layer_with_trust(layer: LayerFacts, checks: Sequence[Check]) -> LayerFacts:
    update: dict[str, Any] = {}
    if (sheet := layer.sheet) is not None:
        properties = {k: _marked(p, trust_of(checks, (layer.name,), (k,))) for k, p in sheet.properties.items()}
        # The sheet's numbers are made of the maps.
        is_withheld = any(p.trust == "withheld" for p in properties.values())
        numbers = None if is_withheld else sheet.numbers
        update["sheet"] = sheet.model_copy(update={"properties": properties, "numbers": numbers})
    r = layer.registration
    if r is not None and r.expected_error is not None:
        error = _marked(r.expected_error, trust_of(checks, (layer.name,), (POSITION,)))
        update["registration"] = r.model_copy(update={"expected_error": error})
    return layer.model_copy(update=update)


def _marked(figure: Figure, trust: Trust) -> Figure:
    """Give a figure its trust, and take its numbers where they are withheld."""
    numbers = dict.fromkeys(figure.WITHHELD) if trust == "withheld" else {}
    return type(figure).model_validate({**dict(figure), **numbers, "trust": trust})
