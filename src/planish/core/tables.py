"""CSV tables: one reader that names all faults at once, and one writer.

A table is text in UTF-8 (with or without byte order mark, or UTF-16 with one); its columns are
separated by comma, semicolon or tab. Numbers may have a decimal comma; those that may have a
thousands separator are refused. Lines without text and lines that start with ``#`` are no rows.
Column names are compared in small letters, in any order; other columns are ignored. A column
``x_um`` may as well be called ``X (mm)`` or ``x_nm``, and is converted.
"""

import csv
import io
import math
import re
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from pydantic import ValidationError

from planish.core.errors import FileError, InputError, PlanishError
from planish.core.files import check_exists
from planish.core.typing import Floats
from planish.core.units import unit_um

_Key = TypeVar("_Key", bound=Hashable)
_Item = TypeVar("_Item")

LARGEST_FILE = 10_000_000  # bytes; no table of marks, holes or sections is larger
DECIMAL_COMMAS = "decimal commas need semicolons between the columns"
MOST_FAULTS = 8  # faults that one message names; of the others it gives the number


class CsvRow(NamedTuple):
    """A row and the number of its line in the file, counted from 1."""

    line: int
    cells: list[str]


class Heading(NamedTuple):
    """Name of a column in small letters, words joined by ``_``, and its unit.

    No unit: it states none. ``pixel`` is one; of a length ``um`` says how long it is.
    """

    name: str
    unit: str = ""

    @property
    def um(self) -> float | None:
        """Length of the unit in um; None where it is none."""
        return unit_um(self.unit)


def grouped(items: Iterable[_Item], key_of: Callable[[_Item], _Key]) -> dict[_Key, list[_Item]]:
    """Items, such as rows, by their keys, both in the order in which they come."""
    groups: dict[_Key, list[_Item]] = {}
    for item in items:
        groups.setdefault(key_of(item), []).append(item)
    return groups


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Content of a text.

    Rows, comments without their sign, separator, and faults of single lines.
    """

    rows: list[CsvRow]
    comments: list[str]
    delimiter: str = ","
    faults: list[str] = field(default_factory=list[str])

    @cached_property
    def has_decimal_commas(self) -> bool:
        """Whether a comma stands where it cannot separate thousands: ``0,5``, ``1234,5``."""
        cells = [cell for row in self.rows for cell in row.cells]
        return any(
            DECIMAL_OR_TWO.fullmatch(cell) and not _GROUPED.fullmatch(cell) for cell in cells
        )

    def number(self, text: str) -> float | None:
        """Return the finite number in a cell; None where it is none, or may be another."""
        if "_" in text or ("." in text and self.has_decimal_commas):
            return None
        return finite(text, decimal_comma=self.has_decimal_commas)

    def number_fault(self, text: str) -> str:
        """Say why a cell holds no number."""
        if "." in text and self.has_decimal_commas:
            return "has a point, other numbers a decimal comma; write all in one way"
        if _GROUPED.fullmatch(text):
            whole, part = text.split(",")
            return f"may be {whole}.{part} or {whole}{part}; write it with a decimal point or none"
        if "," in text:
            return "is not a finite number; write it with a decimal point, thousands without a sign"
        return "is not a finite number"


# Numbers with a comma, which may be two; those of them in which it may separate thousands.
DECIMAL_OR_TWO = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
_IN_BRACKETS = re.compile(r"(.*?)[\s_]*[(\[]\s*([^()\[\]]+?)\s*[)\]]")
_AT_THE_END = re.compile(r"(.+?)(?:\s+in)?[\s_/]+([^\s_/]+)")
_PIXELS = ("px", "pix", "pixel", "pixels", "voxel", "voxels")
# First bytes and names within files of spreadsheets.
_WORKBOOKS = (b"xl/workbook", b"opendocument.spreadsheet")


def heading_of(cell: str) -> Heading:
    """Take the unit off a heading.

    >>> heading_of("Centroid X \N{MICRO SIGN}m").name, heading_of("x_mm").um, heading_of("Y [px]")
    ('centroid_x', 1000.0, Heading(name='y', unit='pixel'))
    """
    in_brackets = _IN_BRACKETS.fullmatch(cell)
    at_the_end = _AT_THE_END.fullmatch(cell)
    name = cell
    unit = ""
    if in_brackets:
        name, unit = in_brackets.groups()
    elif at_the_end and _unit_of(at_the_end[2]):
        name, unit = at_the_end.groups()
    name = re.sub(r"[\W_]+", "_", name.casefold()).strip("_")
    return Heading(name, _unit_of(unit) or unit)


def _unit_of(word: str) -> str:
    """Name a unit of positions; empty where it is none."""
    if word.casefold() in _PIXELS:
        return "pixel"
    return {None: "", 1.0: "um", 1000.0: "mm"}.get(unit_um(word), word)


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
    refuse_workbook(data, name, what=what)
    utf_16 = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        text = data.decode("utf-16" if utf_16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(
            f"{name} is no text in UTF-8. Save the {what} as text in UTF-8 (Excel: CSV UTF-8)."
        ) from error
    if "\0" in text:
        raise FileError(
            f"{name} holds binary data and is no {what}. Check that it is the right file."
        )
    return text


def refuse_workbook(data: bytes, name: str, *, what: str) -> None:
    """Refuse the file of a spreadsheet, which is no table of text."""
    is_old_workbook = data.startswith(b"\xd0\xcf\x11\xe0")
    is_packed = data.startswith(b"PK") and any(mark in data for mark in _WORKBOOKS)
    if is_old_workbook or is_packed:
        raise FileError(
            f"{name} is the workbook of a spreadsheet. Save the {what} as text (Excel: CSV UTF-8)."
        )


def split_rows(text: str) -> Rows:
    """Rows of a text, whether the first of them is a header or not.

    Cells without blanks at their ends; without rows and last columns that are empty throughout.
    """
    # Numbers of lines, from 1, and the lines.
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    delimiter = ""
    # Excel's own line in front of a table.
    if lines and (match := re.fullmatch(r'"?sep=(.)"?[,;\s]*', lines[0][1], re.IGNORECASE)):
        delimiter = match[1]
        lines = lines[1:]
    table_lines = [(number, line) for number, line in lines if line.lstrip()[0] != "#"]
    delimiter = delimiter or _delimiter_of([line for _, line in table_lines[:20]])
    rows, faults = _rows_of(table_lines, delimiter)
    comment_lines = [(number, line) for number, line in lines if line.lstrip()[0] == "#"]
    comments = [line.strip().lstrip("#").strip() for _, line in comment_lines]
    faults = [*_label_faults(comment_lines, delimiter), *faults]
    return Rows(rows=rows, comments=comments, delimiter=delimiter, faults=faults)


def _label_faults(comment_lines: Sequence[tuple[int, str]], delimiter: str) -> Iterator[str]:
    """Say which lines begin with a label such as #1, and are no comments."""
    for number, line in comment_lines:
        if line.lstrip()[1:2].isdecimal() and delimiter in line:
            yield (
                f"row {number} begins with #: write '# ' before a comment, a label in quotation"
                " marks"
            )


def _rows_of(lines: Sequence[tuple[int, str]], delimiter: str) -> tuple[list[CsvRow], list[str]]:
    """Rows of numbered lines, none with more cells than the widest that is not empty, and faults.

    The faults are sentences about single lines that cannot be read.
    """
    rows: list[CsvRow] = []
    faults: list[str] = []
    for number, line in lines:
        try:
            cells = _cells(line, delimiter)
        except csv.Error as error:
            is_open = "end of data" in str(error)
            reason = "a quotation mark is not closed on its line" if is_open else str(error)
            faults.append(f"row {number}: {reason}")
            continue
        if any(cells):
            rows.append(CsvRow(number, cells))
    width = max((_width(row.cells) for row in rows), default=0)
    return [CsvRow(row.line, row.cells[:width]) for row in rows], faults


def _cells(line: str, delimiter: str) -> list[str]:
    cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True, strict=True))
    return [cell.strip() for cell in cells]


def _width(cells: Sequence[str]) -> int:
    """Number of cells without the empty ones at the end."""
    return max((k for k, cell in enumerate(cells, 1) if cell), default=0)


def _delimiter_of(lines: Sequence[str]) -> str:
    """Find what gives all of the first lines equally many cells, two or more.

    A comma may stand within numbers, a semicolon within names, so that the comma comes last.
    """
    for delimiter in "\t;,":
        try:
            counts = {len(_cells(line, delimiter)) for line in lines}
        except csv.Error:
            continue
        if len(counts) == 1 and counts != {1}:
            return delimiter
    if lines:
        return max(",;\t", key=lines[0].count)
    return ","


def finite(value: object, *, decimal_comma: bool = False) -> float | None:
    """Return the number in a text or of a JSON value; None where it is none or not finite."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    if decimal_comma and isinstance(value, str) and value.count(",") == 1 and "." not in value:
        value = value.replace(",", ".")
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    if math.isfinite(number):
        return number
    return None


@dataclass(slots=True, kw_only=True)
class CsvTable:
    """A table with a header. Faults are collected and raised once, by :meth:`check`."""

    name: str  # name of the file
    header: list[str]  # column names in small letters
    rows: list[CsvRow]  # rows with as many cells as the header
    content: Rows
    error: type[PlanishError] = InputError  # class of the error that names the faults
    um: dict[str, float] = field(default_factory=dict[str, float])  # by column in another unit
    faults: list[str] = field(default_factory=list[str])

    def text(self, row: CsvRow, column: str, default: str = "") -> str:
        """Cell of a row; the default where there is no such column, or nothing in the cell."""
        if column not in self.header:
            return default
        return row.cells[self.header.index(column)] or default

    def number(self, row: CsvRow, column: str) -> float:
        """Give the finite number in a cell; anything else is a fault and NaN."""
        text = self.text(row, column)
        value = self.content.number(text)
        if value is None:
            if column in self.header:  # that a column is missing is a fault already
                self.fault(row, f"{column} {text!r} {self.content.number_fault(text)}")
            return math.nan
        return value * self.um.get(column, 1.0)

    def numbers(self, columns: Sequence[str]) -> Floats:
        """Give the finite numbers of several columns, shape (rows, columns)."""
        values = [self.number(row, column) for row in self.rows for column in columns]
        return np.array(values, np.float64).reshape(-1, len(columns))

    def fault(self, row: CsvRow, words: str) -> None:
        """Note a fault of a row."""
        self.faults.append(f"row {row.line}: {words}")

    def check(self, remedy: str = "Correct these rows.") -> None:
        """Raise all faults as one error; nothing where there is none."""
        raise_faults(self.name, self.faults, remedy, error=self.error)


def parse_table(
    text: str,
    name: str,
    *,
    needed: Sequence[str],
    optional: Sequence[str] = (),
    error: type[PlanishError],
    advice: str = "",
) -> CsvTable:
    """Make a table of a text with a header; ``name`` is that of its file.

    Columns that are ``needed`` have to be there; others may be. Those of them and of ``optional``
    that end in ``_um`` may be in another unit of length, which their heading states. ``advice`` is
    one sentence that says what the table has to look like. Faults of header and rows are raised by
    :meth:`CsvTable.check`, together with those found later; an empty table is an ``error`` at once.
    """
    advice = advice or f"The first row has to name the columns {', '.join(needed)}."
    content = split_rows(text)
    if not content.rows:
        raise error(f"{name} is empty. {advice}")
    header, um = _columns_of(content.rows[0].cells, (*needed, *optional))
    faults = [*_header_faults(header, needed, advice), *content.faults]
    rows: list[CsvRow] = []
    widest = 0
    for line, cells in content.rows[1:]:
        width = max(len(header), _width(cells))
        row = CsvRow(line, cells[:width])
        if len(row.cells) == len(header):
            rows.append(row)
            continue
        widest = max(widest, len(row.cells))
        faults.append(f"row {line} has {len(row.cells)} columns, the header {len(header)}")
    if content.delimiter == "," and widest > len(header):
        faults[-1] += f" ({DECIMAL_COMMAS})"
    return CsvTable(
        name=name, header=header, rows=rows, content=content, error=error, um=um, faults=faults
    )


def _header_faults(header: Sequence[str], needed: Sequence[str], advice: str) -> Iterator[str]:
    """Say which columns are missing, and which are given twice."""
    missing = [column for column in needed if column not in header]
    if missing:
        yield (
            f"columns missing: {', '.join(missing)} (found {', '.join(header)[:120]})."
            f" {advice.rstrip('.')}"
        )
    duplicates = sorted({column for column in header if column and header.count(column) > 1})
    if duplicates:
        yield f"columns given twice: {', '.join(duplicates)}"


def _columns_of(
    headings: Sequence[str], possible: Sequence[str]
) -> tuple[list[str], dict[str, float]]:
    """Columns of a header, and the unit in um of those that are one of ``possible`` in another."""
    header = [cell.lower() for cell in headings]
    um: dict[str, float] = {}
    for k, heading in enumerate(map(heading_of, headings)):
        column = f"{heading.name}_um"
        if column in possible and column not in header and heading.um:
            header[k] = column
            um[column] = heading.um
    return header, um


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
    return [f"{k}: {m}" if k else m for k, m in zip(fault_keys, messages, strict=True)]


def table_text(
    header: Sequence[str], rows: Iterable[Sequence[Any]], *, quote_all: bool = False
) -> str:
    """Text of a table, lines ending with a line feed.

    Floats are written so that they read back to the same number.
    """
    text = io.StringIO()
    quoting = csv.QUOTE_ALL if quote_all else csv.QUOTE_MINIMAL
    writer = csv.writer(text, lineterminator="\n", quoting=quoting)
    if header:
        writer.writerow(header)
    for row in rows:
        writer.writerow([float(c) if isinstance(c, np.floating) else c for c in row])
    return text.getvalue()
