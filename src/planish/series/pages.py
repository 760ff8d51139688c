"""The folder of a series.

It holds its page with a small map of every specimen, its numbers, and its tables.
"""

import io
import math
from collections.abc import Sequence
from importlib.util import find_spec
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from planish.core.errors import PlanishError
from planish.core.files import delete, write_whole
from planish.core.tables import table_text
from planish.io.map_groups import read_group
from planish.io.map_store import map_folder, overviews_of
from planish.report import SmallMap, series_page, small_map
from planish.run.run import MAPS
from planish.run.study import relative_path
from planish.series.declared import Declared
from planish.series.gather import FigureRow, gather
from planish.series.summary import summary_of
from planish.series_results import Cell, Member, Quantity, RunKind, SeriesResults, SeriesSpecimen

# Names of the files of a series
REPORT = "report.html"
RESULTS = "results.json"
SPECIMENS = "specimens.csv"
VALUES = "values.csv"
PARQUET = "values.parquet"

# Columns of a row of values.csv behind the specimen and its factors
OF_A_ROW = (
    "layer",
    "map",
    "other_layer",
    "other_map",
    "at_um",
    "quantity",
    "value",
    "unit",
    "low",
    "high",
    "trust",
    "checks",
)
_NUMBERS = {"at_um", "value", "low", "high"}  # of these columns
_OF_A_SPECIMEN = (
    "specimen",
    "state",
    "kind",
    "counts_as_sheet",
    "light",
    "checks_fail",
    "checks_look",
    "marks_used",
    "leave_one_out_um",
    "expected_error_um",
)


def write_series(
    members: Sequence[Member], home: Path, declared: Declared, out: Path
) -> SeriesResults:
    """Write the page of a series, its numbers and its tables.

    Parameters
    ----------
    members : sequence of Member
        Specimens in the order of their table.
    home : path
        Folder that their runs are relative to.
    declared : Declared
    out : path
        Folder that is there: report.html, results.json, specimens.csv (a row for each specimen) and
        values.csv (a row for each figure) are written into it, each whole, over earlier ones; with
        pyarrow, values.parquet, too.

    Returns
    -------
    SeriesResults
        As results.json has it; runs are relative to ``out``.

    Raises
    ------
    InputError
        If what was declared means nothing, or its factor or a map is not there.
    FileError, ResourceError
        If a file cannot be written.

    Notes
    -----
    The same runs give the same bytes on any machine, in any order of work; the Parquet file per
    version of pyarrow.
    """
    gathered = gather(members, home)
    results = summary_of(gathered, declared)
    small_maps = _small_maps(results, home)
    specimens: list[SeriesSpecimen] = []
    for specimen in results.specimens:
        folder = specimen.member.folder(home)
        run = None
        if folder is not None:
            run = relative_path(folder.resolve(), out.resolve())
        member = specimen.member.model_copy(update={"run": run})
        specimens.append(specimen.model_copy(update={"member": member}))
    results = results.model_copy(update={"specimens": tuple(specimens)})
    header, rows = figures_table(gathered.rows, results.factors)
    texts = {
        VALUES: table_text(header, rows),
        SPECIMENS: _specimens_text(results),
        RESULTS: results.to_json(),
        REPORT: series_page(results, small_maps),
    }
    if find_spec("pyarrow") is None:
        delete(out / PARQUET)  # one of an earlier time would say something else
    else:
        write_whole(out / PARQUET, parquet_bytes(header, rows), over=True)
    for name, text in texts.items():
        write_whole(out / name, text.encode(), over=True)
    return results


def _small_maps(results: SeriesResults, home: Path) -> list[SmallMap]:
    """The map that leads of every specimen that has it, one read after the other.

    One that cannot be read has no values. Those without a run, or on which the map was not
    measured, are left out.
    """
    small_maps: list[SmallMap] = []
    if not results.quantities:
        return small_maps
    quantity = results.quantities[0]
    # Pixels along the longer side. The maps of more than 250 specimens have fewer of them: the page
    # has to stay below 10 MB.
    pixels = 150.0 * min(1.0, math.sqrt(250 / max(len(results.specimens), 1)))
    for specimen in results.specimens:
        folder = specimen.member.folder(home)
        if specimen.kind is None or folder is None or specimen.cells[0].why_not == "not measured":
            continue
        try:
            data = _read_map(folder / MAPS, specimen.kind, quantity)
        except (PlanishError, OSError, KeyError):
            data = None
        small_maps.append(small_map(specimen.name, data, pixels=pixels))
    return small_maps


def _read_map(store: Path, kind: RunKind, quantity: Quantity) -> xr.DataArray | None:
    """The map of a sheet, flat or, of two sheets, on the pixels of the reference.

    The smallest copy, NaN where it is not valid; None where the store, ``maps.zarr``, does not hold
    it.
    """
    name = quantity.map
    groups = [f"layers/{quantity.layer}/maps", f"layers/{quantity.layer}", "maps"]
    if kind != "map":
        groups.append("linked")
    for group in groups:
        if map_folder(store, group, name):
            smallest_group = [group, *overviews_of(store, group, name)][-1]
            names = [v for v in (name, "valid") if map_folder(store, smallest_group, v)]
            data = read_group(store, smallest_group, names)
            values = data[name].values.astype(np.float64)
            if "valid" in data:
                values = np.where(data["valid"].values.astype(bool), values, np.nan)
            return data[name].copy(data=values)
    return None


def factor_columns(
    factors: Sequence[str], columns: Sequence[str] = ("specimen", *OF_A_ROW)
) -> list[str]:
    """Columns of factors, none with the name of another column."""
    return [f"factor_{name}" if name in columns else name for name in factors]


def figures_table(
    rows: Sequence[FigureRow], factors: Sequence[str]
) -> tuple[list[str], list[list[Any]]]:
    """Header and cells of values.csv: one row a figure."""
    header = ["specimen", *factor_columns(factors), *OF_A_ROW]
    cells: list[list[Any]] = []
    for row in rows:
        levels = [row.factors.get(name, "") for name in factors]
        cells.append([row.specimen, *levels, *attrgetter(*OF_A_ROW)(row)])
    return header, cells


def parquet_bytes(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> bytes:
    """Bytes of values.parquet: the columns of values.csv; missing numbers are null."""
    import pyarrow as pa  # pyright: ignore[reportMissingImports]
    import pyarrow.parquet as pq  # pyright: ignore[reportMissingImports]

    columns = list(zip(*rows, strict=True)) or [()] * len(header)
    types = [pa.float64() if name in _NUMBERS else pa.string() for name in header]
    arrays = [pa.array(column, kind) for column, kind in zip(columns, types, strict=True)]
    data = io.BytesIO()
    pq.write_table(pa.table(arrays, names=list(header)), data, compression="zstd")
    return data.getvalue()


def _columns_of(q: Quantity) -> list[str]:
    """Columns of a quantity in specimens.csv, named by map, statistic and unit.

    The value, of r with its interval and independent points, and how far it is trusted.
    """
    name_parts = [q.layer, q.map, q.what]
    suffixes = ("", "_trust")
    if q.what == "r":
        other_map = "" if q.other_map == q.map else q.other_map
        name_parts += [q.other_layer, other_map]
        suffixes = ("", "_low", "_high", "_n_eff", "_trust")
    if q.at_um is not None:
        name_parts += [f"{q.at_um:g}", "um"]
    elif q.unit != "1":
        name_parts.append(q.unit.replace("/", "_per_"))
    name = "_".join(filter(None, name_parts)).replace(" ", "_")
    return [f"{name}{suffix}" for suffix in suffixes]


def _specimens_text(results: SeriesResults) -> str:
    """Give the text of specimens.csv, one row a specimen, in the columns of ``_OF_A_SPECIMEN``.

    Factors stand behind the name, quantities behind the rest; message and run come last. What is
    not known is empty. A specimen without a run has no cells: its quantities are empty.

    ``spoken`` gives the names of the checks in each state. ``counts_as_sheet`` is the name of the
    sheet that the specimen is a field of. The trust of a quantity is empty where it has no value
    and no check withheld one.
    """
    header = ["specimen", *factor_columns(results.factors, _OF_A_SPECIMEN), *_OF_A_SPECIMEN[1:]]
    for quantity in results.quantities:
        header += _columns_of(quantity)
    rows: list[list[Any]] = []
    for specimen in results.specimens:
        member = specimen.member
        row: list[Any] = [specimen.name, *map(specimen.factor, results.factors), member.state]
        row += [specimen.kind, specimen.sheet, specimen.light]
        row += ["; ".join(specimen.spoken.get(state, ())) for state in ("fail", "look")]
        row += [specimen.marks_used, specimen.leave_one_out_um, specimen.expected_error_um]
        cells = specimen.cells or [Cell()] * len(results.quantities)
        for quantity, cell in zip(results.quantities, cells, strict=True):
            row.append(cell.value)
            if quantity.what == "r":
                row += [cell.low, cell.high, cell.n_eff]
            row.append(None if cell.value is None and cell.trust == "ok" else cell.trust)
        rows.append([*row, member.message, member.run])
    return table_text([*header, "message", "run"], rows)
