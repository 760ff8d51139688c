"""A series as arrays: every figure of every specimen, by specimen, map and size."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import FileError
from planish.core.series_results import SeriesResults
from planish.core.tables import parse_table, read_bytes
from planish.series.pages import RESULTS, VALUES, factor_columns

_OF_PAIRS = (
    "r", "r2", "slope", "points", "n_eff", "n_eff_interval", "bias", "limit_low", "limit_high", "shared_um",
)  # fmt: skip
_OF_REGISTRATIONS = ("marks_used", "residual", "leave_one_out", "expected_error", "largest_expected_error")
_JUDGED = {"mean": "trust", "r": "pair_trust", "expected_error": "registration_trust"}
"""Quantities whose trust stands for all of their dims."""

_TRUST = {"ok": 0, "doubtful": 1, "withheld": 2}
_LARGEST = 2_000_000_000
Entry = tuple[tuple[Any, ...], float, float, float, int, str]


def open_study(path: str | Path) -> xr.Dataset:
    """Open what 'planish study', or 'planish compare --out', wrote.

    Parameters
    ----------
    path : path
        Folder with values.csv and results.json; the runs need not be there.

    Returns
    -------
    Dataset
        Variables by the names of ``quantity`` in values.csv, NaN where a figure is missing or withheld, with ``units``
        where all values share one. ``mean``, ``sd``, ``p5`` ... over (specimen, map); ``thin_share`` over (specimen,
        map, limit_um); ``r``, ``n_eff``, ``bias`` ... over (specimen, pair, point_um); ``marks_used`` ... over
        (specimen, registration); ``coefficient_of_variation`` over (specimen, map, wave_um); counts of checks over
        (specimen). Quantities with intervals have ``r_low`` and ``r_high`` beside them. ``trust``, ``pair_trust`` and
        ``registration_trust`` say what the checks leave: 0 ok, 1 doubtful, 2 withheld, -1 not there. Factors and
        ``state`` are coordinates of ``specimen``; specimens without a run are there, too. Where specimens have several
        sheets, a map is named with its layer, ``LAYER.MAP``.

    Raises
    ------
    FileError
        If the folder holds no series, or a file of it is damaged.

    Examples
    --------
    >>> study = planish.open_study("series")  # doctest: +SKIP
    >>> study.r.sel(pair="coating_top/image", point_um=100).groupby("paper").mean()  # doctest: +SKIP
    """
    folder = Path(path)
    missing = [name for name in (RESULTS, VALUES) if not (folder / name).is_file()]
    if missing:
        raise FileError(
            f"{folder} holds no {' and no '.join(missing)}. Give the folder that 'planish study' or 'planish compare "
            "--out' made."
        )
    results = SeriesResults.read(folder / RESULTS)
    text = read_bytes(folder / VALUES, what="table of a series", most=_LARGEST).decode("utf-8", errors="replace")
    needed = ("specimen", "layer", "map", "other_layer", "other_map", "at_um", "quantity", "value", "unit", "low",
              "high", "trust")  # fmt: skip
    table = parse_table(text, VALUES, needed=needed, error=FileError)
    rows = [dict(zip(table.header, row.cells, strict=True)) for row in table.rows]
    table.check("Write the series again.")
    names = [one.member.name for one in results.specimens]
    unknown = sorted({row["specimen"] for row in rows} - set(names))
    if unknown:
        raise FileError(
            f"{VALUES} has figures of {', '.join(unknown[:3])}, which {RESULTS} does not know: the two files are of "
            "different series. Write the series again."
        )
    several = any(one.kind in ("two volumes", "layers") for one in results.specimens)
    found: dict[str, xr.DataArray] = {}
    for quantity in dict.fromkeys(row["quantity"] for row in rows):
        own = [row for row in rows if row["quantity"] == quantity]
        found |= _arrays(quantity, [_entry(row, several) for row in own], names, _dims(quantity))
    data = xr.Dataset(found)
    data = data.assign_coords(specimen=("specimen", np.array(names, dtype=object)))
    taken = {"state", *map(str, data.dims), *map(str, data.data_vars)}
    for name, column in zip(results.factors, factor_columns(results.factors), strict=True):
        levels = [one.member.factors.get(name, "") for one in results.specimens]
        data = data.assign_coords({f"factor_{name}" if column in taken else column: ("specimen", levels)})
    data = data.assign_coords(state=("specimen", [one.member.state for one in results.specimens]))
    return data.assign_attrs(planish=results.planish, compared_by=results.compared_by or "")


def _dims(quantity: str) -> tuple[str, ...]:
    """Dims of a quantity beside the specimen."""
    if quantity in _OF_PAIRS:
        return ("pair", "point_um")
    if quantity in _OF_REGISTRATIONS:
        return ("registration",)
    if quantity.startswith("checks_"):
        return ()
    if quantity == "measured_share":
        return ("layer",)
    own = {"thin_share": "limit_um", "coefficient_of_variation": "wave_um"}.get(quantity)
    return ("map", own) if own else ("map",)


def _entry(row: Mapping[str, str], several: bool) -> Entry:
    """Where a row stands, its value with the ends of its interval, what the checks leave of it, and its unit."""

    def named(layer: str, name: str) -> str:
        return f"{layer}.{name}" if several and layer else name

    first, quantity = named(row["layer"], row["map"]), row["quantity"]
    at: tuple[Any, ...] = (first,)
    if quantity in _OF_PAIRS:
        at = (f"{first}/{named(row['other_layer'], row['other_map'])}", _number(row["at_um"]))
    elif quantity in _OF_REGISTRATIONS:
        at = (f"{row['layer']}/{row['other_layer']}",)
    elif quantity == "measured_share":
        at = (row["layer"],)
    elif len(_dims(quantity)) == 2:
        at = (first, _number(row["at_um"]))
    elif not _dims(quantity):
        at = ()
    value, low, high = (_number(row[name]) for name in ("value", "low", "high"))
    return (row["specimen"], *at), value, low, high, _TRUST.get(row["trust"], -1), row["unit"]


def _number(text: str) -> float:
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise FileError(f"{VALUES} is damaged: {text!r} is no number. Write the series again.") from None


def _arrays(
    quantity: str, entries: Sequence[Entry], names: Sequence[str], dims: tuple[str, ...]
) -> dict[str, xr.DataArray]:
    """A quantity as an array, the ends of its intervals where it has any, and what the checks leave of it."""
    labels: list[list[Any]] = [list(names)]
    labels += [_labels(entry[0][k + 1] for entry in entries) for k in range(len(dims))]
    places = [{label: k for k, label in enumerate(own)} for own in labels]
    shape = tuple(len(own) for own in labels)
    values, low, high = (np.full(shape, np.nan) for _ in range(3))
    trust = np.full(shape, -1, dtype=np.int8)
    for at, value, lower, upper, trusted, _ in entries:
        place = tuple(own[label] for own, label in zip(places, at, strict=True))
        values[place], low[place], high[place], trust[place] = value, lower, upper, trusted
    units = {entry[5] for entry in entries}
    attrs = {"units": units.pop()} if len(units) == 1 else {}
    coords = {d: np.array(own, dtype=object if isinstance(own[0], str) else np.float64)
              for d, own in zip(dims, labels[1:], strict=True)}  # fmt: skip

    def array(data: NDArray[Any], more: Mapping[str, Any]) -> xr.DataArray:
        return xr.DataArray(data, dims=("specimen", *dims), coords=coords, attrs=dict(more))

    found = {quantity: array(values, attrs)}
    if np.isfinite(low).any():
        found |= {f"{quantity}_low": array(low, attrs), f"{quantity}_high": array(high, attrs)}
    if quantity in _JUDGED:
        found[_JUDGED[quantity]] = array(trust, {"flag_values": [0, 1, 2], "flag_meanings": " ".join(_TRUST)})
    return found


def _labels(labels: Iterable[Any]) -> list[Any]:
    """Labels once, texts as they come and numbers in their order."""
    found = list(dict.fromkeys(labels))
    return found if found and isinstance(found[0], str) else sorted(found)
