"""Bytes of a file of marks -> text, rows and numbers; faults of many rows -> one message."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from planish.core.errors import FileError, MarkError

LARGEST_FILE = 10_000_000
MOST_MARKS = 100_000
MOST_FAULTS = 8

Rows = list[tuple[int, list[str]]]


def read_bytes(place: Path) -> bytes:
    """All of a file.

    Raises
    ------
    FileError
        If it cannot be read, or has more than 10 MB.
    """
    try:
        if place.exists() and not place.is_file():
            raise FileError(f"{place} is no file. Give a file of marks.")
        with place.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise FileError(f"{place} cannot be read: {why}. Check the path.") from error
    if len(data) > LARGEST_FILE:
        raise FileError(
            f"{place.name} is larger than {LARGEST_FILE // 1_000_000} MB; files of marks are smaller. Give the file "
            "that holds nothing but the marks."
        )
    return data


def decode(data: bytes, name: str) -> str:
    """Text in UTF-8, with or without a byte order mark.

    Raises
    ------
    FileError
        If the bytes are no text.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(
            f"{name} is neither text in UTF-8 nor a MATLAB file. Save the marks as one of the formats in "
            "docs/marks-files.md, in UTF-8."
        ) from error
    if "\0" in text:
        raise FileError(f"{name} holds binary data and is no file of marks. Check that it is the right file.")
    return text


def split_rows(text: str, name: str) -> Rows:
    """Rows of a table with their line numbers, without empty lines and comments (``#``).

    Raises
    ------
    MarkError
        If the quotes are out of order, or there are too many rows.
    """
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not lines:
        return []
    check_count(name, len(lines) - 1)
    delimiter = max(",;\t", key=lines[0][1].count)
    rows: Rows = []
    for number, line in lines:
        try:
            parsed = next(csv.reader([line], delimiter=delimiter, strict=True), [])
        except csv.Error as error:
            raise MarkError(f"{name}, row {number}: {error}. One mark a row is needed, with commas between.") from error
        rows.append((number, [cell.strip() for cell in parsed]))
    return rows


def finite(value: Any) -> float | None:
    """Return the number in a text or of a JSON value; None where it is none or not finite."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def raise_faults(name: str, faults: Sequence[str], remedy: str) -> None:
    """Raise all faults as one message; nothing where there is none.

    Raises
    ------
    MarkError
        If there is a fault.
    """
    if faults:
        more = f"; and {len(faults) - MOST_FAULTS} more" if len(faults) > MOST_FAULTS else ""
        raise MarkError(f"{name}: {'; '.join(faults[:MOST_FAULTS])}{more}. {remedy}")


def check_count(name: str, count: int) -> None:
    """Refuse more marks than a sheet can have.

    Raises
    ------
    MarkError
        If there are more than 100 000.
    """
    if count > MOST_MARKS:
        raise MarkError(f"{name} holds {count} marks; {MOST_MARKS} are the most. Give a file with marks only.")


def write_text(place: Path, text: str) -> None:
    """Write a new file in UTF-8.

    Raises
    ------
    FileError
        If something stands there already, or it cannot be written.
    """
    write_bytes(place, text.encode("utf-8"))


def write_bytes(place: Path, data: bytes) -> None:
    """Write a new file.

    Raises
    ------
    FileError
        If something stands there already, or it cannot be written.
    """
    try:
        with place.open("xb") as file:
            file.write(data)
    except FileExistsError as error:
        raise FileError(f"{place} is already there; nothing is overwritten. Choose another name.") from error
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise FileError(f"{place} cannot be written: {why}. Choose another place.") from error
