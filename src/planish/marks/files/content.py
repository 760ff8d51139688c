"""Content of a file of marks: its bytes, text, rows or JSON, as far as the form of the file goes."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from pydantic import BaseModel, ConfigDict

from planish.core.errors import FileError, MarkError
from planish.core.tables import Rows, decode_text, raise_faults, read_bytes, split_rows
from planish.marks.files.formats import known_formats

MOST_MARKS = 100_000
_BINARY = (b"MATLAB", b"\x89HDF\r\n\x1a\n")
_NO_ROWS = Rows([], [], ",", [])


class Part(BaseModel):
    """A part of a JSON file of marks or holes: types are not converted, and unknown keys are faults."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """A file of marks: its name, for messages, and what it holds; no text in one of MATLAB, no rows in JSON."""

    name: str
    data: bytes
    text: str = ""
    rows: Rows = _NO_ROWS
    json: Mapping[str, Any] | None = None

    @property
    def header(self) -> list[str]:
        """Cells of the first row."""
        return self.rows.rows[0].cells if self.rows.rows else []


def read_content(path: str | Path) -> Content:
    """Read a file, whatever its format."""
    place = Path(path)
    name, data = place.name, read_bytes(place, what="file of marks")
    # Version 4 of MATLAB has no heading that says what it is.
    if data.startswith(_BINARY) or place.suffix.lower() == ".mat":
        return Content(name=name, data=data)
    text = decode_text(data, name, what="file of marks")
    if not text.strip():
        raise FileError(f"{name} is empty. Give a file of marks: {known_formats()}.")
    if text.lstrip()[:1] in "{[":
        return Content(name=name, data=data, text=text, json=read_object(text, name))
    rows = split_rows(text)
    check_count(name, len(rows.rows) - 1)
    return Content(name=name, data=data, text=text, rows=rows)


def check_count(name: str, count: int) -> None:
    """Refuse more marks than a sheet can have."""
    if count > MOST_MARKS:
        raise MarkError(f"{name} holds {count} marks; {MOST_MARKS} are the most. Give a file with marks only.")


def refuse(name: str, faults: Sequence[str], remedy: str) -> None:
    """Raise all faults of a file as one message; nothing where there is none."""
    raise_faults(name, faults, remedy, error=MarkError)


def json_text(value: object) -> str:
    """Write JSON in one line."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def read_object(text: str, name: str) -> Mapping[str, Any]:
    """Read the object of a JSON file of marks or holes."""
    try:
        content: object = json.loads(text, object_pairs_hook=_unique_keys)
    except RecursionError as error:
        raise FileError(f"{name} is nested too deeply for a file of marks. Give {known_formats()}.") from error
    except ValueError as error:
        raise FileError(f"{name} is damaged JSON: {error}. Save the marks again.") from error
    if not isinstance(content, dict):
        raise FileError(f"{name} is JSON, but no file of marks: it holds a list. These are read: {known_formats()}.")
    return cast("dict[str, Any]", content)


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        key, count = Counter(key for key, _ in pairs).most_common(1)[0]
        raise ValueError(f"the key {key[:40]!r} stands {count} times in one object")
    return entries
