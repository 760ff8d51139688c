"""The folder of an answer: its page, the numbers behind it and its tables."""

from collections.abc import Mapping
from pathlib import Path

from planish.core.facts import ResultModel
from planish.core.files import write_whole
from planish.core.tables import table_text
from planish.io.run_folder import new_folder
from planish.report.draw import Table


def write_answer(
    out: Path, name: str, *, page: str, facts: ResultModel, tables: Mapping[str, Table]
) -> None:
    """Write NAME.html, NAME.json and a CSV file for each table into a new folder."""
    with new_folder(out) as folder:
        write_whole(folder / f"{name}.html", page.encode())
        write_whole(folder / f"{name}.json", f"{facts.model_dump_json(indent=2)}\n".encode())
        for table, columns in tables.items():
            rows = zip(*columns.values(), strict=True)
            write_whole(folder / f"{table}.csv", table_text(list(columns), rows).encode())
