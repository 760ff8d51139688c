"""What is wrong with the parameters in a file: the line of each key, and the word that was probably meant."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, get_origin

from pydantic import BaseModel, ValidationError

from planish.core.options import models_in

Key = tuple[str | int, ...]  # a key with the tables around it; the tables of an array are numbered from 0


class KeyLines(NamedTuple):
    """Lines of all keys and tables of a file, counted from 1."""

    lines: dict[Key, int]

    def of(self, key: Key) -> int | None:
        """Line of a key; of the innermost table or key around it where it has no line of its own."""
        for end in range(len(key), 0, -1):
            if key[:end] in self.lines:
                return self.lines[key[:end]]
        return None


def key_lines(text: str) -> KeyLines:
    """Find the line of every key in a text that is TOML; keys of tables within a value count as that value."""
    lines: dict[Key, int] = {}
    counts: dict[Key, int] = {}
    base: Key = ()
    part, begin = "", 1
    for number, line in enumerate(text.split("\n"), 1):
        part += f"{line}\n"
        if (names := _names(part)) is None:  # a value that goes on
            continue
        if part.lstrip().startswith("["):
            key = base = _table(names, counts, array=part.lstrip().startswith("[["))
        else:  # names end at the first sign that is not within quotes
            ends = (sign.start() for sign in re.finditer("=", part))
            key = (*base, *next(filter(None, (_names(f"{part[:end]}= 1") for end in ends)), ()))
        for k in range(1, len(key) + 1):
            lines.setdefault(key[:k], begin)
        part, begin = "", number + 1
    return KeyLines(lines)


def _names(text: str) -> list[str] | None:
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


def _table(names: list[str], counts: dict[Key, int], *, array: bool) -> Key:
    """Key of a table: within arrays of tables, that of the last one."""
    key: Key = ()
    for k, name in enumerate(names):
        key = (*key, name)
        if array and k == len(names) - 1:
            counts[key] = counts.get(key, 0) + 1
        if key in counts:
            key = (*key, counts[key] - 1)
    return key


# From where a model has a value to the key that the file has for it, and its line; None where it has no line.
Place = Callable[[Key], tuple[Key, int | None]]

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_ALIKE = 0.6  # of difflib: the share of letters that two names have in common

_ADVICE = (
    (re.compile(r"^[^'#]*\"[^\"\n]*\\[^\"\n]*\"", re.MULTILINE), ("Unescaped", "Invalid hex", "escape"),
     "A path with \\ stands in single quotes: 'C:\\data\\volume.tif'. Or write it with /."),
    (re.compile(r""), ("Cannot overwrite", "Cannot declare"), "A key or a table may be given once."),
    (re.compile(r"=\s*-?\d+,\d"), (), "Numbers have a decimal point, several stand in brackets: [3.0, 1.5, 1.5]."),
    (re.compile(r"=\s*[A-Za-z/\\]"), ("Invalid value",), "Words and paths stand in quotes; true and false do not."),
    (re.compile(r"^\s*[^\[#\n=]+$", re.MULTILINE), ("after a key",), "A line reads key = value."),
)  # fmt: skip


def toml_mistake(error: tomllib.TOMLDecodeError | RecursionError, text: str) -> str:
    """Say where a text stops being TOML, and what to write there."""
    words = str(error)
    match = re.search(r"\(at line (\d+), column (\d+)\)", words)
    lines = text.splitlines()
    if match is None or not 0 < int(match[1]) <= len(lines):
        return f"{words}."
    line = lines[int(match[1]) - 1]
    advice = next(
        (f" {what}" for pattern, kinds, what in _ADVICE
         if pattern.search(line) and (not kinds or any(kind in words for kind in kinds))), ""
    )  # fmt: skip
    return f"line {match[1]}, column {match[2]}: {words[: match.start()].strip()}: {line.strip()[:80]}.{advice}"


def mistakes(error: ValidationError, model: type[BaseModel], place: Place = lambda loc: (loc, None)) -> list[str]:
    """Name every mistake that a validation found: ``line 7, volume.thruogh: unknown; did you mean through?``.

    Names that are possible are taken from ``model``; ``place`` gives key and line in the file.
    """
    sentences: list[tuple[int, str]] = []
    named_keys: set[Key] = set()
    for fault in error.errors(include_url=False):
        # The place of a value without the kinds that it may have, which pydantic names behind it.
        loc = tuple(part for part in fault["loc"] if isinstance(part, int) or _NAME.fullmatch(part))
        key, line = place(loc)
        if key in named_keys and key:  # of a value that may be of several kinds, the first kind says enough
            continue
        named_keys.add(key)
        where = ".".join(map(str, key))
        line_text = f"line {line}" if line is not None else ""
        head = ", ".join(filter(None, (line_text, where)))
        sentences.append((line or 0, f"{head}: {_words(fault, loc, model)}" if head else _words(fault, loc, model)))
    return [text for _, text in sorted(sentences, key=lambda sentence: sentence[0])]


def _words(fault: Any, loc: Key, model: type[BaseModel]) -> str:
    message = str(fault["msg"]).removeprefix("Value error, ")
    value = fault.get("input")
    if fault["type"] == "extra_forbidden":
        return _unknown(str(loc[-1]), loc[:-1], model)
    if fault["type"] == "missing":
        return "a value is missing" if loc and isinstance(loc[-1], int) else "missing"
    if fault["type"] == "tuple_type":
        return f"{value!r} is not possible; needed are values in brackets, such as [1.5, 1.5]"
    if fault["type"] == "literal_error":
        expected = str(fault["ctx"]["expected"])
        likely = difflib.get_close_matches(str(value).casefold(), re.findall(r"'([^']*)'", expected), 1, _ALIKE)
        meant = f"; did you mean {likely[0]!r}?" if likely else "."
        return f"{value!r} is not possible; needed is {expected}{meant}".removesuffix(".")
    if isinstance(value, str | int | float | bool):
        return f"{message} (found {value!r})"
    return message


def _unknown(name: str, table: Key, model: type[BaseModel]) -> str:
    """Say that a name is unknown: the closest one of its table, or the table that has it."""
    everywhere = dict(_tables(model, ()))
    # A place has names of fields, numbers, and names of alternatives.
    models: Sequence[type[BaseModel]] = [model]
    for part in (part for part in table if isinstance(part, str)):
        inner = [k for m in models if part in m.model_fields for k in models_in(m.model_fields[part].annotation)]
        models = inner or models
    here = [field for m in models for field in m.model_fields]
    here += [] if table else [place[0] for place in everywhere if place]
    likely = difflib.get_close_matches(name.casefold(), here, 1, _ALIKE)
    if likely:
        return f"unknown; did you mean {likely[0]}?"
    owners = [place for place, fields in everywhere.items() if name in fields and place]
    if not owners:
        near = difflib.get_close_matches(name, sorted({f for fs in everywhere.values() for f in fs}), 1, 0.8)
        owners = [place for place, fields in everywhere.items() if near and near[0] in fields and place]
        name = near[0] if owners else name
    if owners:
        tables = " or ".join(f"[{'.'.join(place)}]" for place in owners)
        return f"unknown here; {name} belongs to {tables}"
    return f"unknown; there {'is' if len(here) == 1 else 'are'} {', '.join(sorted(set(here))[:30])}"


def _tables(model: type[BaseModel], place: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], list[str]]]:
    """All tables of a model, each with the names in it; those of an array stand where the array does."""
    yield place, [name for name, field in model.model_fields.items() if not models_in(field.annotation)]
    for name, field in model.model_fields.items():
        several = get_origin(field.annotation) in (tuple, list)
        for inner in models_in(field.annotation):
            yield from _tables(inner, place if several else (*place, name))
