"""A series as arrays: every figure of every specimen, by specimen, map and size."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

from planish.core.errors import FileError
from planish.core.older_names import todays_names
from planish.core.tables import grouped, parse_table, read_bytes
from planish.core.typing import Array, Entries
from planish.series.pages import OF_A_ROW, RESULTS, VALUES, factor_columns
from planish.series_results import FORMAT, SeriesResults

_SIZES = {"thin_share": "limit_um", "coefficient_of_variation": "wave_um"}
# Quantities whose trust stands for all of their dims
_JUDGED = {"mean": "trust", "r": "pair_trust", "expected_error": "registration_trust"}
_TRUST = {"ok": 0, "doubtful": 1, "withheld": 2}


def open_study(path: str | Path) -> xr.Dataset:
    """Open what 'planish study', or 'planish compare --out', wrote.

    Parameters
    ----------
    path : path
        Folder with values.csv and results.json; the runs need not be there.

    Returns
    -------
    Dataset
        Variables by the names of ``quantity`` in values.csv, NaN where a figure is missing or
        withheld, with ``units`` where all values share one. ``mean``, ``sd``, ``p5`` ... over
        (specimen, map); ``thin_share`` over (specimen, map, limit_um); ``r``, ``n_eff``, ``bias``
        ... over (specimen, pair, point_um); ``marks_used`` ... over (specimen, registration);
        ``coefficient_of_variation`` over (specimen, map, wave_um); counts of checks over
        (specimen). Quantities with intervals have ``r_low`` and ``r_high`` beside them. ``trust``,
        ``pair_trust`` and ``registration_trust`` say what the checks leave: 0 ok, 1 doubtful, 2
        withheld, -1 not there. Factors and ``state`` are coordinates of ``specimen``; specimens
        without a run are there, too. Where specimens have several sheets, a map is named with its
        layer, ``LAYER.MAP``.

    Raises
    ------
    FileError
        If the folder holds no series, or a file of it is damaged.

    Examples
    --------
    >>> study = planish.open_study("series")  # doctest: +SKIP
    >>> r = study.r.sel(pair="coating_top/image", point_um=100)  # doctest: +SKIP
    >>> r.groupby("paper").mean()  # doctest: +SKIP
    """
    folder = Path(path)
    missing = [name for name in (RESULTS, VALUES) if not (folder / name).is_file()]
    if missing:
        raise FileError(
            f"{folder} holds no {' and no '.join(missing)}. Give the folder that 'planish study' or"
            " 'planish compare --out' made."
        )
    results = SeriesResults.read(folder / RESULTS)
    names = [specimen.name for specimen in results.specimens]
    rows_by_quantity = _rows_of(folder, results, names)
    kinds = {specimen.kind for specimen in results.specimens}
    has_several_sheets = not kinds.isdisjoint(("two volumes", "layers"))
    arrays: dict[str, xr.DataArray] = {}
    for quantity, rows in rows_by_quantity.items():
        arrays |= _arrays(quantity, rows, names, has_several_sheets)
    study = xr.Dataset(arrays)
    study = _with_factors(study, results)
    return study.assign_attrs(planish=results.planish, compared_by=results.compared_by or "")


def _with_factors(study: xr.Dataset, results: SeriesResults) -> xr.Dataset:
    """The same with names, factors and states of the specimens as coordinates.

    A factor with the name of something else in the study is called ``factor_NAME``.
    """
    columns = ("specimen", *OF_A_ROW, "state", *map(str, study.dims), *map(str, study.data_vars))
    names = np.array([specimen.name for specimen in results.specimens], dtype=object)
    study = study.assign_coords(specimen=names)
    for name, column in zip(results.factors, factor_columns(results.factors, columns), strict=True):
        study[column] = ("specimen", [specimen.factor(name) for specimen in results.specimens])
        study = study.set_coords(column)
    return study.assign_coords(state=("specimen", [member.state for member in results.members]))


def _rows_of(
    folder: Path, results: SeriesResults, names: Sequence[str]
) -> dict[str, list[dict[str, str]]]:
    """Rows of values.csv as dicts of texts by column, grouped by quantity.

    FileError where they are not of these specimens, ``names``.
    """
    content = read_bytes(folder / VALUES, what="table of a series", most_bytes=2 * 10**9)
    text = content.decode("utf-8", errors="replace")
    table = parse_table(text, VALUES, needed=("specimen", *OF_A_ROW[:-1]), error=FileError)
    figure_rows = [dict(zip(table.header, row.cells, strict=True)) for row in table.rows]
    table.check("Write the series again.")
    if results.stored_format < FORMAT:
        figure_rows = todays_names(figure_rows)
    unknown = {row["specimen"] for row in figure_rows}.difference(names)
    if unknown:
        raise FileError(
            f"{VALUES} has figures of {', '.join(sorted(unknown)[:3])}, which {RESULTS} does not"
            " know: the two files are of different series. Write the series again."
        )
    return grouped(figure_rows, lambda row: row["quantity"])


def _labels(row: Mapping[str, str], has_several_sheets: bool) -> Entries:
    """Names and sizes of what a figure is of, by the dims of its quantity beside ``specimen``.

    Counts of checks have none, the share of measured columns has its layer, figures of a
    registration both layers, those of two maps the pair and the size of points, and those of a map
    its name and, where they have one, a limit or a wavelength. With several sheets a map is named
    with its layer.
    """
    quantity = row["quantity"]
    layer = row["layer"]
    if quantity.startswith("checks_"):
        return {}
    if quantity == "measured_share":
        return {"layer": layer}
    if not row["map"]:
        return {"registration": f"{layer}/{row['other_layer']}"}
    # ``layer`` and ``map`` say the first map, ``other_layer`` and ``other_map`` the second one.
    first_map, second_map = (
        f"{row[side + 'layer']}.{row[side + 'map']}"
        if has_several_sheets and row[f"{side}layer"]
        else row[f"{side}map"]
        for side in ("", "other_")
    )
    if row["other_map"]:
        return {"pair": f"{first_map}/{second_map}", "point_um": _number(row["at_um"])}
    labels: Entries = {"map": first_map}
    if quantity in _SIZES:
        labels[_SIZES[quantity]] = _number(row["at_um"])
    return labels


def _number(text: str) -> float:
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise FileError(
            f"{VALUES} is damaged: {text!r} is no number. Write the series again."
        ) from None


def _units(rows: Sequence[Mapping[str, str]]) -> Entries:
    """The unit of a quantity as attribute; none where its figures have several."""
    units = {row["unit"] for row in rows}
    if len(units) > 1:
        return {}
    return {"units": units.pop()}


def _coordinate(figures: Sequence[Entries], dim: str) -> Array:
    """Each label of a dim once: texts as they come, numbers in their order."""
    labels = list(dict.fromkeys(figure[dim] for figure in figures))
    if isinstance(labels[0], str):
        return np.array(labels, dtype=object)
    return np.sort(np.array(labels, dtype=np.float64))


def _arrays(
    quantity: str, rows: Sequence[Mapping[str, str]], names: Sequence[str], has_several_sheets: bool
) -> dict[str, xr.DataArray]:
    """Give a quantity as an array (specimen, ...), over the dims that :func:`_labels` says.

    With it come the ends of its intervals, where it has any, and what the checks leave of it: each
    by the name of its variable. ``names``: of the specimens. What no row states is NaN, and -1 of
    trust.
    """
    figures = [_labels(row, has_several_sheets) for row in rows]
    coords = {dim: _coordinate(figures, dim) for dim in figures[0]}
    labels = {"specimen": list(names)}  # along each dim, in the order of the array
    labels |= {dim: axis.tolist() for dim, axis in coords.items()}
    shape = tuple(map(len, labels.values()))
    # The figure, the ends of its interval, and its trust by the numbers of _TRUST.
    value, low, high = (np.full(shape, np.nan) for _ in range(3))
    trust = np.full(shape, -1, dtype=np.int8)
    for row, figure in zip(rows, figures, strict=True):
        of_row = {"specimen": row["specimen"]} | figure
        index = tuple(labels[dim].index(label) for dim, label in of_row.items())
        value[index] = _number(row["value"])
        low[index] = _number(row["low"])
        high[index] = _number(row["high"])
        trust[index] = _TRUST.get(row["trust"], -1)
    attrs = _units(rows)
    variables = {quantity: (value, attrs)}
    if np.isfinite(low).any():
        variables |= {f"{quantity}_low": (low, attrs), f"{quantity}_high": (high, attrs)}
    if quantity in _JUDGED:
        flags = {"flag_values": [0, 1, 2], "flag_meanings": " ".join(_TRUST)}
        variables[_JUDGED[quantity]] = (trust, flags)
    build_array = partial(xr.DataArray, dims=list(labels), coords=coords)
    return {name: build_array(array, attrs=dict(own)) for name, (array, own) in variables.items()}
