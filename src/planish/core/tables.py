"""CSV tables: one reader that names all faults at once, and one writer.

A table is text in UTF-8 (with or without byte order mark, or UTF-16 with one); its columns are
separated by comma, semicolon or tab. Where they are not separated by commas, numbers may have a
decimal comma. Empty lines and lines that start with ``#`` are no rows. Column names are compared in
small letters, in any order; other columns are ignored.
"""

import csv
import io
import math
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from planish.core.errors import FileError, InputError, PlanishError
from planish.core.files import check_exists

LARGEST_FILE = 10_000_000  # bytes; no table of marks, holes or sections is larger
MOST_FAULTS = 8  # faults that one message names; of the others it gives the number


class CsvRow(NamedTuple):
    """A row and the number of its line in the file, counted from 1."""

    line: int
    cells: list[str]


class Rows(NamedTuple):
    """Content of a text.

    Rows, comments without their sign, separator, and faults of single lines.
    """

    rows: list[CsvRow]
    comments: list[str]
    delimiter: str
    faults: list[str]


def read_text(path: str | Path, *, what: str = "table") -> str:
    """Read a small text file; ``what`` it should be is for the messages."""
    return decode_text(read_bytes(path, what=what), Path(path).name, what=what)


def read_bytes(path: str | Path, *, what: str = "table", most_bytes: int = LARGEST_FILE) -> bytes:
    """Read a small file; FileError if it cannot be read or has more than ``most_bytes`` bytes."""
    file_path = Path(path)
    try:
        check_exists(file_path)
        if not file_path.is_file():
            raise FileError(f"{file_path.name} is no file. Give the file of the {what}.")
        with file_path.open("rb") as file:
            content = file.read(most_bytes + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"{file_path} cannot be read: {reason}. Check the path.") from error
    if len(content) > most_bytes:
        raise FileError(
            f"{file_path.name} is larger than {most_bytes // 10**6} MB and no {what}. Check that it"
            " is the right file."
        )
    return content


def decode_text(data: bytes, name: str, *, what: str = "table") -> str:
    """Text of the bytes of a file, without byte order mark; FileError if they are no text."""
    utf_16 = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        text = data.decode("utf-16" if utf_16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(f"{name} is no text in UTF-8. Save the {what} as text in UTF-8.") from error
    if "\0" in text:
        raise FileError(
            f"{name} holds binary data and is no {what}. Check that it is the right file."
        )
    return text


def split_rows(text: str) -> Rows:
    """Rows of a text, whether the first of them is a header or not.

    Cells without blanks at their ends.
    """
    lines = [
        (line_number, line.strip())
        for line_number, line in enumerate(text.splitlines(), 1)
        if line.strip()
    ]
    comments = [line.lstrip("#").strip() for _, line in lines if line.startswith("#")]
    table_lines = [(line_number, line) for line_number, line in lines if not line.startswith("#")]
    delimiter = max(",;\t", key=table_lines[0][1].count) if table_lines else ","
    rows: list[CsvRow] = []
    faults: list[str] = []
    for line_number, line in table_lines:
        try:
            cells = next(csv.reader([line], delimiter=delimiter, strict=True))
        except csv.Error as error:
            faults.append(f"row {line_number}: {error}")
            continue
        rows.append(CsvRow(line_number, [cell.strip() for cell in cells]))
    return Rows(rows, comments, delimiter, faults)


def finite(value: object, *, decimal_comma: bool = False) -> float | None:
    """Return the number in a text or of a JSON value; None where it is none or not finite."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    if decimal_comma and isinstance(value, str) and value.count(",") == 1 and "." not in value:
        value = value.replace(",", ".")
    try:
        return float(value) if math.isfinite(float(value)) else None
    except (ValueError, OverflowError):
        return None


@dataclass(slots=True, kw_only=True)
class CsvTable:
    """A table with a header. Faults are collected and raised once, by :meth:`check`."""

    name: str  # name of the file
    header: list[str]  # column names in small letters
    rows: list[CsvRow]  # rows with as many cells as the header
    comments: list[str] = field(default_factory=list[str])
    error: type[PlanishError] = InputError  # class of the error that names the faults
    decimal_comma: bool = False
    faults: list[str] = field(default_factory=list[str])

    def text(self, row: CsvRow, column: str, default: str = "") -> str:
        """Cell of a row; the default where there is no such column, or nothing in the cell."""
        return (row.cells[self.header.index(column)] if column in self.header else "") or default

    def number(self, row: CsvRow, column: str) -> float:
        """Give the finite number in a cell; anything else is a fault and NaN."""
        text = self.text(row, column)
        value = finite(text, decimal_comma=self.decimal_comma)
        if value is None:
            if column in self.header:  # that a column is missing is a fault already
                self.fault(row, f"{column} {text!r} is not a finite number")
            return math.nan
        return value

    def numbers(self, columns: Sequence[str]) -> NDArray[np.float64]:
        """Give the finite numbers of several columns, shape (rows, columns)."""
        values = [[self.number(row, column) for column in columns] for row in self.rows]
        return np.array(values, dtype=np.float64).reshape(-1, len(columns))

    def fault(self, row: CsvRow, words: str) -> None:
        """Note a fault of a row."""
        self.faults.append(f"row {row.line}: {words}")

    def check(self, remedy: str = "Correct these rows.") -> None:
        """Raise all faults as one error; nothing where there is none."""
        raise_faults(self.name, self.faults, remedy, error=self.error)


def parse_table(
    text: str, name: str, *, needed: Sequence[str], error: type[PlanishError], advice: str = ""
) -> CsvTable:
    """Make a table of a text with a header; ``name`` is that of its file.

    Columns that are ``needed`` have to be there; others may be. ``advice`` is one sentence that
    says what the table has to look like. Faults of header and rows are raised by
    :meth:`CsvTable.check`, together with those found later; an empty table is an ``error`` at once.
    """
    advice = advice or f"The first row has to name the columns {', '.join(needed)}."
    content = split_rows(text)
    if not content.rows:
        raise error(f"{name} is empty. {advice}")
    header_row, *body_rows = content.rows
    header = [cell.lower() for cell in header_row.cells]
    faults: list[str] = []
    if missing := [column for column in needed if column not in header]:
        faults.append(
            f"columns missing: {', '.join(missing)} (found {', '.join(header)[:120]})."
            f" {advice.rstrip('.')}"
        )
    if duplicates := sorted({column for column in header if column and header.count(column) > 1}):
        faults.append(f"columns given twice: {', '.join(duplicates)}")
    faults += content.faults
    ragged_rows = [row for row in body_rows if len(row.cells) != len(header)]
    faults += [
        f"row {row.line} has {len(row.cells)} columns, the header {len(header)}"
        for row in ragged_rows
    ]
    if content.delimiter == "," and any(len(row.cells) > len(header) for row in ragged_rows):
        faults[-1] += " (decimal commas need semicolons between the columns)"
    rows = [row for row in body_rows if len(row.cells) == len(header)]
    return CsvTable(
        name=name,
        header=header,
        rows=rows,
        comments=content.comments,
        error=error,
        decimal_comma=content.delimiter != ",",
        faults=faults,
    )


def raise_faults(
    name: str, faults: Sequence[str], remedy: str, *, error: type[PlanishError]
) -> None:
    """Raise all faults as one message; nothing where there is none."""
    if faults:
        remainder = f"; and {len(faults) - MOST_FAULTS} more" if len(faults) > MOST_FAULTS else ""
        raise error(f"{name}: {'; '.join(faults[:MOST_FAULTS])}{remainder}. {remedy}".rstrip())


@contextmanager
def naming_faults(
    name: str, remedy: str = "", *, error: type[PlanishError], key_prefix: Sequence[str] = ()
) -> Generator[None]:
    """Raise what pydantic finds as one message.

    ``key_prefix`` is put before the place of each fault.
    """
    try:
        yield
    except ValidationError as validation_error:
        raise_faults(name, model_faults(validation_error, key_prefix), remedy, error=error)


def model_faults(error: ValidationError, key_prefix: Sequence[str] = ()) -> list[str]:
    """Say what pydantic found, without the values themselves.

    ``key_prefix`` is put before the place of each fault.
    """
    faults = error.errors(include_url=False, include_input=False, include_context=False)
    fault_keys = [".".join(map(str, (*key_prefix, *fault["loc"]))) for fault in faults]
    messages = [str(fault["msg"]).removeprefix("Value error, ") for fault in faults]
    return [
        f"{key}: {message}" if key else message
        for key, message in zip(fault_keys, messages, strict=True)
    ]


def table_text(
    header: Sequence[str], rows: Iterable[Sequence[Any]], *, quote_all: bool = False
) -> str:
    """Text of a table, lines ending with a line feed.

    Floats are written so that they read back to the same number.
    """
    text = io.StringIO()
    writer = csv.writer(
        text, lineterminator="\n", quoting=csv.QUOTE_ALL if quote_all else csv.QUOTE_MINIMAL
    )
    if header:
        writer.writerow(header)
    writer.writerows(
        [repr(float(c)) if isinstance(c, (float, np.floating)) else c for c in row] for row in rows
    )
    return text.getvalue()
