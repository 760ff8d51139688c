"""What is wrong with the parameters in a file.

The line of each key, and the word that was probably meant.
"""

import difflib
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, get_origin

from pydantic import BaseModel, ValidationError

from planish.core.annotations import models_in
from planish.core.errors import FileError

# a key with the tables around it; the tables of an array are numbered from 0.
Key = tuple[str | int, ...]


class KeyLines(NamedTuple):
    """Lines of all keys and tables of a file, counted from 1."""

    lines: dict[Key, int]

    def of(self, key: Key) -> int | None:
        """Line of a key.

        Of the innermost table or key around it where it has no line of its own.
        """
        for end in range(len(key), 0, -1):
            if key[:end] in self.lines:
                return self.lines[key[:end]]
        return None


def key_lines(text: str) -> KeyLines:
    """Find the line of every key in a text that is TOML.

    Keys of tables within a value count as that value.
    """
    lines: dict[Key, int] = {}
    table_counts: dict[Key, int] = {}
    table_key: Key = ()
    statement = ""
    first_line = 1
    for line_number, line in enumerate(text.split("\n"), 1):
        statement += f"{line}\n"
        names = _key_names(statement)
        if names is None:  # a value that goes on
            continue
        if statement.lstrip().startswith("["):
            is_array = statement.lstrip().startswith("[[")
            key = table_key = _table_key(names, table_counts, is_array=is_array)
        else:  # names end at the first sign that is not within quotes
            parsed = (
                _key_names(f"{statement[: sign.start()]}= 1")
                for sign in re.finditer("=", statement)
            )
            key = (*table_key, *next(filter(None, parsed), ()))
        for k in range(1, len(key) + 1):
            lines.setdefault(key[:k], first_line)
        statement = ""
        first_line = line_number + 1
    return KeyLines(lines)


def _key_names(text: str) -> list[str] | None:
    """Names of the tables and the key of a line of TOML; None where it is none."""
    names: list[str] = []
    try:
        table: Any = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None
    while isinstance(table, dict) and table:
        names += table
        table = table[names[-1]]
        table = table[0] if isinstance(table, list) and table else table
    return names


def _table_key(names: list[str], table_counts: dict[Key, int], *, is_array: bool) -> Key:
    key: Key = ()
    for k, name in enumerate(names):
        key = (*key, name)
        if is_array and k == len(names) - 1:
            table_counts[key] = table_counts.get(key, 0) + 1
        if key in table_counts:
            key = (*key, table_counts[key] - 1)
    return key


# From where a model has a value to the key that the file has for it, and its line; None where it
# has no line.
PlaceOf = Callable[[Key], tuple[Key, int | None]]
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_ALIKE = 0.6  # of difflib: the share of letters that two names have in common
_ADVICE = (
    (
        re.compile(r"^[^'#]*\"[^\"\n]*\\[^\"\n]*\"", re.MULTILINE),
        ("Unescaped", "Invalid hex", "escape"),
        "A path with \\ stands in single quotes: 'C:\\data\\volume.tif'. Or write it with /.",
    ),
    (
        re.compile(r""),
        ("Cannot overwrite", "Cannot declare"),
        "A key or a table may be given once.",
    ),
    (
        re.compile(r"=\s*-?\d+,\d"),
        ("",),
        "Numbers have a decimal point, several stand in brackets: [3.0, 1.5, 1.5].",
    ),
    (
        re.compile(r"=\s*[A-Za-z/\\]"),
        ("Invalid value",),
        "Words and paths stand in quotes; true and false do not.",
    ),
    (re.compile(r"^\s*[^\[#\n=]+$", re.MULTILINE), ("after a key",), "A line reads key = value."),
)


def toml_tables(path: Path | str, text: str) -> dict[str, Any]:
    """Tables in the text of a file; FileError says where it is no TOML."""
    try:
        # With a line end, what is wrong in the last line has a number, too.
        return tomllib.loads(f"{text}\n")
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise FileError(f"{path} is not a TOML file: {toml_fault(error, text)}") from error


def toml_fault(error: tomllib.TOMLDecodeError | RecursionError, text: str) -> str:
    """Say where a text stops being TOML, and what to write there."""
    error_text = str(error)
    position = re.search(r"\(at line (\d+), column (\d+)\)", error_text)
    lines = text.splitlines()
    if position is None or not 0 < int(position[1]) <= len(lines):
        return f"{error_text}."
    line = lines[int(position[1]) - 1]
    reason = error_text[: position.start()].strip()
    fault = f"line {position[1]}, column {position[2]}: {reason}: {line.strip()[:80]}."
    for pattern, triggers, advice in _ADVICE:
        if pattern.search(line) and any(trigger in error_text for trigger in triggers):
            return f"{fault} {advice}"
    return fault


def fault_texts(
    error: ValidationError, model: type[BaseModel], place: PlaceOf = lambda loc: (loc, None)
) -> list[str]:
    """Name every mistake that a validation found.

    For example ``line 7, volume.thruogh: unknown; did you mean through?``.

    Names that are possible are taken from ``model``; ``place`` gives key and line in the file.
    """
    sentences: list[tuple[int, str]] = []
    reported_keys: set[Key] = set()
    for fault in error.errors(include_url=False):
        # The place of a value without the kinds that it may have, which pydantic names behind it.
        loc = tuple(name for name in fault["loc"] if isinstance(name, int) or _NAME.fullmatch(name))
        key, line = place(loc)
        # Of a value that may be of several kinds, the first kind says enough.
        if key in reported_keys and key:
            continue
        reported_keys.add(key)
        line_text = f"line {line}" if line is not None else ""
        place_text = ", ".join(filter(None, (line_text, ".".join(map(str, key)))))
        texts = (place_text, _fault_text(fault, loc, model))
        sentences.append((line or 0, ": ".join(filter(None, texts))))
    return [text for _, text in sorted(sentences, key=lambda sentence: sentence[0])]


def _fault_text(fault: Any, loc: Key, model: type[BaseModel]) -> str:
    """A fault in words, with the value that was meant where there is one much like it."""
    message = str(fault["msg"]).removeprefix("Value error, ")
    value = fault.get("input")
    if fault["type"] == "extra_forbidden":
        return _unknown_text(str(loc[-1]), loc[:-1], model)
    if fault["type"] == "missing":
        return "a value is missing" if loc and isinstance(loc[-1], int) else "missing"
    if fault["type"] == "tuple_type":
        return f"{value!r} is not possible; needed are values in brackets, such as [1.5, 1.5]"
    if fault["type"] == "literal_error":
        expected = str(fault["ctx"]["expected"])
        possible_words = re.findall(r"'([^']*)'", expected)
        words = difflib.get_close_matches(str(value).casefold(), possible_words, 1, _ALIKE)
        suggestion = f"; did you mean {words[0]!r}?" if words else ""
        return f"{value!r} is not possible; needed is {expected}{suggestion}"
    return f"{message} (found {value!r})" if isinstance(value, str | int | float) else message


def _unknown_text(name: str, table: Key, model: type[BaseModel]) -> str:
    """Say that a name is unknown: the closest one of its table, or the table that has it."""
    names_by_table = dict(_tables_of(model, ()))
    all_names = sorted(set(chain(*names_by_table.values())))
    possible_names = _names_in(table, model)
    del names_by_table[()]
    if not table:
        possible_names += [path[0] for path in names_by_table]
    for word in difflib.get_close_matches(name.casefold(), possible_names, 1, _ALIKE):
        return f"unknown; did you mean {word}?"
    for word in difflib.get_close_matches(name, all_names, 1, 0.8):
        owners = [path for path, fields in names_by_table.items() if word in fields]
        if owners:
            tables = " or ".join(f"[{'.'.join(path)}]" for path in owners)
            return f"unknown here; {word} belongs to {tables}"
    verb = "is" if len(possible_names) == 1 else "are"
    return f"unknown; there {verb} {', '.join(sorted(set(possible_names))[:30])}"


def _names_in(table: Key, model: type[BaseModel]) -> list[str]:
    """Names that a table may hold; its key has names of fields, numbers, and alternatives."""
    models: Sequence[type[BaseModel]] = [model]
    for name in map(str, table):
        fields = [m.model_fields[name] for m in models if name in m.model_fields]
        models = [inner for field in fields for inner in models_in(field.annotation)] or models
    return [field for m in models for field in m.model_fields]


def _tables_of(
    model: type[BaseModel], path: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], list[str]]]:
    """All tables of a model, each with the names in it.

    Those of an array stand where the array does.
    """
    fields = model.model_fields.items()
    yield path, [name for name, field in fields if not models_in(field.annotation)]
    for name, field in fields:
        is_array = get_origin(field.annotation) in (tuple, list)
        for inner_model in models_in(field.annotation):
            yield from _tables_of(inner_model, path if is_array else (*path, name))
