"""Figures of runs as tidy rows: one row a figure, with the specimen, its factors, and what the checks leave of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from planish.core.checks import concerned
from planish.core.facts import SheetNumbers, Trust, is_known
from planish.core.series_results import Member
from planish.results import CorrelationRow, LayerFacts, Results, Twice

_OF_A_PROPERTY = ("mean", "sd", "p5", "median", "p95")
_OF_A_FACE = ("sa", "sq")


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One figure of one specimen.

    Attributes
    ----------
    specimen : str
    factors : mapping of str
    layer, map : str
        What it is of; empty where it is of the whole run, and ``map`` where it is of a registration.
    other_layer, other_map : str
        The second of two maps that were compared.
    at_um : float or None
        Limit of a thin share, edge of the points of a correlation, longest wave of an octave.
    quantity : str
        ``mean``, ``sd``, ``p5``, ``median``, ``p95``, ``columns``, ``n_independent``, ``mean_standard_error``,
        ``support_um``, ``thin_share``, ``sa``, ``sq``, ``measured_share``; ``r``, ``r2``, ``slope``, ``points``,
        ``n_eff``, ``n_eff_interval``, ``bias``, ``limit_low``, ``limit_high``, ``shared_um``;
        ``marks_used``, ``residual``, ``leave_one_out``, ``expected_error``, ``largest_expected_error``;
        ``coefficient_of_variation``; ``checks_fail``, ``checks_look``, ``checks_unknown``, ``checks_pass``.
    value : float or None
        None where it is withheld, or cannot be stated.
    unit : str
    low, high : float or None
        Ends of its 95 % interval, where it has one.
    trust : {"ok", "doubtful", "withheld"}
    checks : str
        Names of the checks that doubt or refute it.
    """

    specimen: str
    factors: Mapping[str, str] = field(default_factory=dict[str, str])
    layer: str = ""
    map: str = ""
    other_layer: str = ""
    other_map: str = ""
    at_um: float | None = None
    quantity: str
    value: float | None
    unit: str = "1"
    low: float | None = None
    high: float | None = None
    trust: Trust = "ok"
    checks: str = ""


def rows_of(member: Member, results: Results) -> list[Row]:
    """Give every figure of a run that can be compared with those of other runs, as rows.

    Parameters
    ----------
    member : Member
    results : Results
        Of its run.

    Returns
    -------
    list of Row
        In the order of the layers and maps of the run.
    """
    found: list[dict[str, Any]] = []
    for layer in results.layers:
        found += _of_sheet(layer, results)
        found += _of_registration(layer, results)
    found += _of_pairs(results)
    for state in ("fail", "look", "unknown", "pass"):
        found.append({"quantity": f"checks_{state}", "value": float(len(results.spoken(state)))})
    return [Row(specimen=member.name, factors=member.factors, **one) for one in found]


def _of_sheet(layer: LayerFacts, results: Results) -> Iterator[dict[str, Any]]:
    sheet = layer.sheet
    if sheet is None:
        return
    for name, p in sheet.properties.items():
        about = {"layer": layer.name, "map": name} | _trusted(p.trust, results, (layer.name,), (name,))
        for what in _OF_A_PROPERTY:
            yield about | {"quantity": what, "value": getattr(p, what), "unit": p.units}
        yield about | {"quantity": "columns", "value": float(p.n)}
        if p.n_independent is not None:
            yield about | {"quantity": "n_independent", "value": float(p.n_independent)}
        for what in ("mean_standard_error", "support_um"):
            if (value := getattr(p, what)) is not None:
                yield about | {"quantity": what, "value": value, "unit": "um" if what == "support_um" else p.units}
        if name in ("coating_top", "coating_bottom"):
            yield from (about | one for one in _thin(sheet.numbers, name))
        if name in ("topography_top", "topography_bottom") and sheet.numbers is not None:
            rough = sheet.numbers.roughness.get("top" if name.endswith("_top") else "bottom")
            for what in _OF_A_FACE if rough is not None else ():
                yield about | {"quantity": what, "value": getattr(rough, what), "unit": "um"}
    share = sheet.surfaces.shares.get("measured")
    yield {"layer": layer.name, "quantity": "measured_share", "value": share}


def _thin(numbers: SheetNumbers | None, name: str) -> Iterator[dict[str, Any]]:
    """Shares of a coating that is thinner than some limits; those of a withheld map are withheld as well."""
    found = None if numbers is None else numbers.thin.get("top" if name.endswith("_top") else "bottom")
    if found is None:
        return
    for limit, share in zip(found.thinner_than_um, found.share, strict=True):
        yield {"quantity": "thin_share", "value": share, "at_um": limit}


def _of_registration(layer: LayerFacts, results: Results) -> Iterator[dict[str, Any]]:
    r = layer.registration
    if r is None:
        return
    about: dict[str, Any] = {"layer": layer.name, "other_layer": r.to}
    yield about | {"quantity": "marks_used", "value": float(r.matched)}
    yield about | {"quantity": "residual", "value": r.rms_um, "unit": "um"}
    yield about | {"quantity": "leave_one_out", "value": r.leave_one_out_rms_um, "unit": "um"}
    if (e := r.expected_error) is not None:
        about |= _trusted(e.trust, results, (layer.name,), ("position",))
        yield about | {"quantity": "expected_error", "value": e.median_um, "unit": "um"}
        yield about | {"quantity": "largest_expected_error", "value": e.largest_um, "unit": "um"}


def _of_pairs(results: Results) -> Iterator[dict[str, Any]]:
    twice = {(e.a, e.a_map, e.b, e.b_map): e.twice for e in results.evidence if e.twice is not None}
    for row in results.correlations:
        key = (row.a, row.a_map, row.b, row.b_map)
        about: dict[str, Any] = {"layer": row.a, "map": row.a_map, "other_layer": row.b, "other_map": row.b_map}
        figures = (row.a_map, row.b_map, "position", "correlation")
        about |= _trusted(row.trust, results, (row.a, row.b), figures) | {"at_um": row.point_um}
        low, high = map(_number, row.interval)
        yield about | {"quantity": "r", "value": _number(row.r), "low": low, "high": high}
        yield about | {"quantity": "r2", "value": _number(row.r2)}
        yield about | {"quantity": "slope", "value": _number(row.slope)}
        yield about | {"quantity": "points", "value": float(row.n)}
        yield about | {"quantity": "n_eff", "value": _number(row.n_eff)}
        yield about | {"quantity": "n_eff_interval", "value": _number(row.n_eff_interval)}
        if row.same_quantity:
            yield from (about | {"unit": row.units or "1"} | one for one in _differences(row, twice.get(key)))
    for one in results.mottle:
        for band in one.bands:
            yield {
                "layer": one.layer, "map": "image", "quantity": "coefficient_of_variation", "at_um": band.longest_um,
                "value": band.coefficient_of_variation,
            }  # fmt: skip


def _number(value: float) -> float | None:
    return value if is_known(value) else None


def _differences(row: CorrelationRow, twice: Twice | None) -> Iterator[dict[str, Any]]:
    """Bias and limits of two measurements of one quantity, with intervals at the points where the run states them."""
    bias, limits = _number(row.difference_mean), [_number(limit) for limit in row.limits]
    ends, of_limits, shared = None, (None, None), None
    if twice is not None and abs(twice.point_um - row.point_um) < 1e-6 and row.trust != "withheld":
        ends, *of_limits = (e if is_known(e) else None for e in (twice.bias_interval, *twice.limit_intervals))
        shared = twice.resolution_um
    low, high = ends or (None, None)
    yield {"quantity": "bias", "value": bias, "low": low, "high": high}
    for name, value, interval in zip(("limit_low", "limit_high"), limits, of_limits, strict=True):
        low, high = interval or (None, None)
        yield {"quantity": name, "value": value, "low": low, "high": high}
    if shared is not None:
        yield {"quantity": "shared_um", "value": shared, "unit": "um"}


def _trusted(trust: Trust, results: Results, layers: Sequence[str], figures: Sequence[str]) -> dict[str, Any]:
    """What the checks leave of a figure, and the names of those that say so."""
    if trust == "ok":
        return {"trust": trust}
    names = (c.name for c in concerned(results.checks, layers, figures) if c.state in ("look", "fail"))
    return {"trust": trust, "checks": "; ".join(dict.fromkeys(names))}
