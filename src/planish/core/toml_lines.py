"""On which line of a TOML file a key stands: what the reader of the standard library does not keep."""

from __future__ import annotations

import re
from typing import NamedTuple

Key = tuple[str | int, ...]
"""A key with the tables around it; the tables of an array are numbered from 0."""

_PART = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
_DOTTED = re.compile(rf"[ \t]*({_PART}(?:[ \t]*\.[ \t]*{_PART})*)[ \t]*")
_ONE = re.compile(_PART)
_SKIPPED = re.compile(r"(?:[ \t\r\n]+|#[^\n]*)*")
# What may hold a line end or a bracket that ends no value: strings of four kinds, and comments.
_TOKEN = re.compile(
    r'"""(?:[^\\]|\\.)*?"""|\'\'\'.*?\'\'\'|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'|#[^\n]*|[\[\]{}\n]|[^\[\]{}\n#"\']+',
    re.DOTALL,
)


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
    position = _end(_SKIPPED, text, 0)
    while position < len(text):
        line = text.count("\n", 0, position) + 1
        brackets = 2 if text.startswith("[[", position) else 1 if text[position] == "[" else 0
        match = _DOTTED.match(text, position + brackets)
        if match is None:  # no TOML: what is found so far has to do
            break
        names = [part.strip("\"'") for part in _ONE.findall(match[1])]
        if brackets:
            base = _table(names, counts, array=brackets == 2)
            for k in range(1, len(base)):
                lines.setdefault(base[:k], line)
            position = match.end() + brackets
        else:
            for k in range(1, len(names)):
                lines.setdefault((*base, *names[:k]), line)
            position = _end_of_value(text, match.end())
        lines.setdefault(base if brackets else (*base, *names), line)
        position = _end(_SKIPPED, text, position)
    return KeyLines(lines)


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


def _end_of_value(text: str, position: int) -> int:
    """Find the end of the line on which the value ends that begins behind the sign of equality."""
    depth = 0
    while position < len(text) and (match := _TOKEN.match(text, position)):
        position = match.end()
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(match[0], 0)
        if match[0] == "\n" and depth <= 0:
            break
    return position


def _end(pattern: re.Pattern[str], text: str, position: int) -> int:
    match = pattern.match(text, position)
    return match.end() if match else position
