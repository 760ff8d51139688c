"""What the terminal can take: colours, width and letters.

Sentences and tables that keep a unit beside its number.
"""

from __future__ import annotations

import json
import os
import re
import sys
import textwrap
from collections.abc import Iterator, Sequence
from io import TextIOWrapper
from typing import TYPE_CHECKING, Any

import click

from planish.core.parameter_words import in_terminal_words
from planish.core.text import plain_numbers, printable

if TYPE_CHECKING:
    from rich.console import Console

_UNITS = (
    "um",
    "um2",
    "mm",
    "mm2",
    "deg",
    "%",
    "s",
    "min",
    "h",
    "MB",
    "GB",
    "voxels",
    "pixels",
    "columns",
    "marks",
)
_WITH_UNIT = re.compile(rf"(?<=\d) (?=(?:{'|'.join(_UNITS)})(?![\w/]))")
_NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?")
_GLUE = "\N{NO-BREAK SPACE}"
_GAP = 2  # blanks between columns
# Columns without the unit of their row.
_UNITLESS = ("n", "n_eff", "columns", "r", "rho", "r2", "95 %", "p (Holm)")
_LEAST_WIDTH = 20  # a terminal that says it has fewer columns does not mean it


def prepare_streams() -> None:
    """Have letters that a console lacks written by their number.

    A name in a file must not end a run.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # not one of a notebook or a test
            stream.reconfigure(errors="backslashreplace")


def plain() -> bool:
    """Return True if colours are off: ``NO_COLOR`` is set, or the terminal can show none."""
    return bool(os.environ.get("NO_COLOR")) or _dumb()


def animated() -> bool:
    """Return True if progress may be drawn over and over on one line of standard error."""
    return sys.stderr.isatty() and not _dumb()


def _dumb() -> bool:
    return os.environ.get("TERM", "").lower() in ("dumb", "unknown")


def console(*, err: bool = False, width: int | None = None) -> Console:
    """A console of rich.

    Without colours where they are off, and with brackets in names left as they are.
    """
    from rich.console import Console

    return Console(
        stderr=err,
        width=width,
        highlight=False,
        markup=False,
        emoji=False,
        no_color=plain() or None,
        color_system=None if plain() else "auto",
    )


def letters() -> bool:
    """Return True if standard error takes any letter, such as those of an animation."""
    return (sys.stderr.encoding or "").lower().startswith("utf")


def width(*, err: bool = False) -> int | None:
    """Columns of the terminal; None where standard output, or standard error, is none."""
    stream = sys.stderr if err else sys.stdout
    if stream.isatty():
        return max(console(err=err).width, _LEAST_WIDTH)
    return None


def shown(text: str) -> str:
    """Text as a terminal shows it: parameters as options, control characters escaped."""
    return in_terminal_words(printable(text))


def sentence(text: str, *, err: bool = False) -> None:
    """Print a sentence; on a terminal no line ends between a number and its unit."""
    columns = width(err=err)
    text = shown(plain_numbers(text))
    click.echo(text if columns is None else wrapped(text, columns), err=err)


def warn(text: str) -> None:
    """Print a sentence on standard error, under the name of the program."""
    sentence(f"planish: {text}", err=True)


def print_json(data: Any) -> None:
    """Print what a command gives as JSON, with parameters as options."""
    click.echo(in_terminal_words(json.dumps(data, indent=2, allow_nan=False)))


def wrapped(text: str, width: int) -> str:
    """Break lines at blanks, but not between a number and its unit.

    ``width`` in letters. Further lines of a paragraph are set in by two.
    """
    width = max(width, _LEAST_WIDTH)
    style = dict.fromkeys(("break_long_words", "break_on_hyphens", "replace_whitespace"), False)
    lines: list[str] = []
    for line in text.split("\n"):
        indent = line[: len(line) - len(line.lstrip())]
        glued = _WITH_UNIT.sub(_GLUE, line)
        lines += textwrap.wrap(glued, width, subsequent_indent=f"{indent}  ", **style) or [""]
    return "\n".join(lines).replace(_GLUE, " ")


def duration(seconds: float) -> str:
    """Write a time, roughly."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table on standard output.

    In columns, or one row below the other where the terminal is too narrow.

    ``columns`` are the headings, ``rows`` have a cell for each; the first cell is the row's name.
    One of the headings may be ``unit``, that of all numbers of the row but counts; others may end
    in one.
    """
    rows = [[*map(shown, row)] for row in rows]
    widths = [max(map(len, cells)) for cells in zip(columns, *rows, strict=True)]
    full_width = max(sum(widths) + _GAP * (len(widths) - 1), len(title))
    terminal_width = width()
    if terminal_width is not None and full_width > terminal_width:
        click.echo(stacked(title, columns, rows, terminal_width))
        return
    from rich.table import Table

    grid = Table(
        title=title, title_justify="left", box=None, pad_edge=False, padding=(0, _GAP, 0, 0)
    )
    for k, name in enumerate(columns):
        grid.add_column(name, justify="left" if k == 0 else "right", no_wrap=True)
    for row in rows:
        grid.add_row(*row)
    console(width=terminal_width or full_width + _GAP).print(grid)


def stacked(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> str:
    """Text of a table for a narrow terminal.

    The name of a row, and below it a line for each of its values.
    """
    lines = [title] if title else []
    for row in rows:
        lines += _lines_of(columns, row)
    return "\n".join(wrapped(line, width) for line in lines)


def _lines_of(columns: Sequence[str], row: Sequence[str]) -> Iterator[str]:
    """The name of a row, and a line for each of its values with its unit.

    The cell of the column ``unit`` stands behind the values that take it, and in no line of its
    own. Empty cells are left out, and no unit follows a dash.
    """
    pairs = [*zip(columns, row, strict=True)]
    unit_of_row = ""
    if any(_takes_unit(*pair) for pair in pairs):
        unit_of_row = "".join(cell for heading, cell in pairs if heading == "unit")
    yield row[0]
    for heading, cell in pairs[1:]:
        if not cell or (heading == "unit" and unit_of_row):
            continue
        name, unit = _name_and_unit(heading)
        if _takes_unit(heading, cell):
            unit = unit or unit_of_row
        is_written = unit not in ("", "1") and cell != "-"
        yield f"  {name}  {cell} {unit}" if is_written else f"  {name}  {cell}"


def _takes_unit(heading: str, cell: str) -> bool:
    return heading not in _UNITLESS and _NUMBER.fullmatch(cell) is not None


def _name_and_unit(heading: str) -> tuple[str, str]:
    """A heading without its unit, and this; empty where it has none."""
    name, _, unit = heading.rpartition(" ")
    has_unit = bool(name) and unit in _UNITS and heading not in _UNITLESS
    if has_unit:
        return name, unit
    return heading, ""
