"""The folder of a series: its page, its numbers, and its tables."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from planish.core.files import delete, write_whole
from planish.core.series_results import Member, Quantity, SeriesResults
from planish.core.tables import table_text
from planish.report import series_page
from planish.series.declared import Declared, declared_of
from planish.series.gather import gather
from planish.series.rows import Row
from planish.series.summary import summary_of
from planish.series.thumbnails import thumbnails_of

REPORT, RESULTS, SPECIMENS, VALUES, PARQUET = (
    "report.html", "results.json", "specimens.csv", "values.csv", "values.parquet",
)  # fmt: skip
"""Names of the files of a series."""

_OF_A_ROW = (
    "layer", "map", "other_layer", "other_map", "at_um", "quantity", "value", "unit", "low", "high", "trust", "checks",
)  # fmt: skip
_TEXTS = ("layer", "map", "other_layer", "other_map", "quantity", "unit", "trust", "checks")


def write_series(
    members: Sequence[Member], home: Path, declared: Declared | Mapping[str, Any], out: Path
) -> SeriesResults:  # fmt: skip
    """Write the page of a series, its numbers and its tables.

    Parameters
    ----------
    members : sequence of Member
        Specimens in the order of their table.
    home : path
        Folder that their runs are relative to.
    declared : Declared, or the values of one
    out : path
        Folder that is there: report.html, results.json, specimens.csv (a row for each specimen) and values.csv (a row
        for each figure) are written into it, each whole, over those of an earlier time; values.parquet, too, where
        pyarrow is installed.

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
    The same runs give the same bytes, on every machine and in any order of work; those of the Parquet file hold for one
    version of pyarrow.
    """
    found = gather(members, home)
    results = summary_of(found, declared_of(declared))
    drawn = thumbnails_of(results, home)
    moved = {one.name: _moved(one, home, out) for one in found.members}
    results = results.model_copy(
        update={
            "specimens": tuple(one.model_copy(update={"member": moved[one.member.name]}) for one in results.specimens)
        }
    )
    table = values_text(found.rows, results.factors).encode()
    packed = parquet_bytes(found.rows, results.factors) if find_spec("pyarrow") is not None else None
    for name, data in (
        (VALUES, table), (PARQUET, packed), (SPECIMENS, specimens_text(results).encode()),
        (RESULTS, results.to_json().encode()), (REPORT, series_page(results, drawn).encode()),
    ):  # fmt: skip
        if data is None:
            delete(out / name)  # one of an earlier time would say something else
        else:
            write_whole(out / name, data, over=True)
    return results


def _moved(member: Member, home: Path, out: Path) -> Member:
    """A member whose run is relative to another folder; absolute where no path leads there, as between drives."""
    folder = member.folder(home)
    if folder is None:
        return member
    try:
        place = os.path.relpath(folder.resolve(), out.resolve())
    except ValueError:
        place = str(folder.resolve())
    return member.model_copy(update={"run": Path(place).as_posix()})


def factor_columns(factors: Sequence[str]) -> list[str]:
    """Columns of factors, none with the name of another column."""
    taken = {"specimen", *_OF_A_ROW}
    return [f"factor_{name}" if name in taken else name for name in factors]


def values_text(rows: Sequence[Row], factors: Sequence[str]) -> str:
    """Text of values.csv: one row a figure."""
    header = ("specimen", *factor_columns(factors), *_OF_A_ROW)
    return table_text(header, ([_cell(value) for value in one] for one in _tidy(rows, factors)))


def _tidy(rows: Sequence[Row], factors: Sequence[str]) -> Iterator[list[Any]]:
    for row in rows:
        yield [
            row.specimen, *(row.factors.get(name, "") for name in factors),
            *(getattr(row, name) for name in _OF_A_ROW),
        ]  # fmt: skip


def _cell(value: Any) -> Any:
    return "" if value is None else value


def parquet_bytes(rows: Sequence[Row], factors: Sequence[str]) -> bytes:
    """Bytes of values.parquet: the columns of values.csv; missing numbers are null."""
    import pyarrow as pa  # pyright: ignore[reportMissingImports]
    import pyarrow.parquet as pq  # pyright: ignore[reportMissingImports]

    names = ("specimen", *factor_columns(factors), *_OF_A_ROW)
    columns = list(zip(*_tidy(rows, factors), strict=True)) or [()] * len(names)
    numbers = {"at_um", "value", "low", "high"}
    arrays = [pa.array(c, pa.float64() if n in numbers else pa.string()) for n, c in zip(names, columns, strict=True)]
    data = io.BytesIO()
    pq.write_table(pa.table(arrays, names=list(names)), data, compression="zstd")
    return data.getvalue()


def specimens_text(results: SeriesResults) -> str:
    """Text of specimens.csv: one row a specimen, its quantities in columns named by map, statistic and unit."""
    of_r = [q.what == "r" for q in results.quantities]
    header = ["specimen", *(f"factor_{n}" if n in _OF_A_TABLE else n for n in results.factors), *_OF_A_TABLE[1:]]
    for quantity, is_r in zip(results.quantities, of_r, strict=True):
        name = column_of(quantity)
        header += [name, *([f"{name}_low", f"{name}_high", f"{name}_n_eff"] if is_r else []), f"{name}_trust"]
    header += ["message", "run"]
    rows: list[list[Any]] = []
    for one in results.specimens:
        m = one.member
        row: list[Any] = [m.name, *(m.factors.get(n, "") for n in results.factors), m.state, one.kind, one.sheet]
        row += [one.light, "; ".join(one.spoken.get("fail", ())), "; ".join(one.spoken.get("look", ()))]
        row += [one.marks_used, one.leave_one_out_um, one.expected_error_um]
        for k, is_r in enumerate(of_r):
            cell = one.cells[k] if one.cells else None
            values = [None] * (5 if is_r else 2)
            if cell is not None:
                beside = [cell.low, cell.high, cell.n_eff] if is_r else []
                values = [cell.value, *beside, cell.trust if cell.value is not None or cell.trust != "ok" else None]
            row += values
        rows.append([_cell(value) for value in (*row, m.message, m.run)])
    return table_text(header, rows)


_OF_A_TABLE = (
    "specimen", "state", "kind", "counts_as_sheet", "light", "checks_fail", "checks_look", "marks_used",
    "leave_one_out_um", "expected_error_um",
)  # fmt: skip


def column_of(quantity: Quantity) -> str:
    """Name of the column of a quantity."""
    parts = [quantity.layer, quantity.map, quantity.what]
    if quantity.what == "r":
        parts += [quantity.other_layer, quantity.other_map if quantity.other_map != quantity.map else ""]
    if quantity.at_um is not None:
        parts += [f"{quantity.at_um:g}", "um"]
    elif quantity.unit != "1":
        parts.append(quantity.unit.replace("/", "_per_"))
    return "_".join(filter(None, parts)).replace(" ", "_")
