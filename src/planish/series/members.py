"""Runs that are there already as the specimens of a series, with the factors that a table gives them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from planish.core.errors import FileError, InputError
from planish.core.series_results import Member
from planish.core.tables import CsvRow, CsvTable, parse_table, read_text
from planish.pipeline.run import is_run

_MOST_NAMES = 5


def members_of(runs: Sequence[Path], *, home: Path, table: Path | None = None) -> tuple[Member, ...]:
    """Make members of runs.

    Parameters
    ----------
    runs : sequence of path
        Folders of runs; where there are none, those of the table, in its order.
    home : path
        Folder that the members' runs are to be relative to.
    table : path, optional
        CSV with a column ``run``, a path relative to the table or the name of the folder, or ``name``; other columns
        are factors. A row without a run among ``runs`` is of no use and an error.

    Returns
    -------
    tuple of Member
        Named by their folders, and by more of their paths where two have one name.

    Raises
    ------
    FileError
        If a run, or the table, is not there.
    InputError
        If a run is given twice, also as a copy, or the table does not fit.
    """
    rows = _rows(table) if table is not None else None
    if rows is not None and not runs:
        if "run" not in rows[0].header:
            raise InputError(f"{rows[0].name} has no column run. Add one with the folders of the runs, or name them.")
        runs = [_beside(table, rows[0].text(row, "run")) for row in rows[1]]
    places = [_place(run) for run in runs]
    _refuse_twice(runs, places)
    names = _names(places)
    factors = [{} for _ in places] if rows is None else _factors(rows, table, places)
    return tuple(
        Member(name=name, factors=own, run=_relative(place, home))
        for name, own, place in zip(names, factors, places, strict=True)
    )


def _rows(path: Path) -> tuple[CsvTable, list[CsvRow]]:
    found = parse_table(
        read_text(path), path.name, needed=(), error=InputError, advice="It needs a column run or name."
    )
    if not {"run", "name"} & set(found.header):
        found.faults.append(f"neither a column run nor name (found {', '.join(found.header)[:120]})")
    found.check("Correct the table.")
    if not found.rows:
        raise InputError(f"{path.name} has a header and no rows. Give a row for each run.")
    return found, found.rows


def _beside(table: Path | None, cell: str) -> Path:
    return Path(cell) if table is None else table.absolute().parent / cell


def _place(run: Path) -> Path:
    """The folder of a run; damaged ones are found out when they are read."""
    if not run.is_dir():
        found = "is no folder" if run.exists() else "is not there"
        raise FileError(f"{run} {found}. Give the folder that 'planish map' or 'planish link' made.")
    if not is_run(run) and not (run / "results.json").is_file():
        raise FileError(f"{run} is no run. Give the folder that 'planish map' or 'planish link' made.")
    return run.resolve()


def _refuse_twice(runs: Sequence[Path], places: Sequence[Path]) -> None:
    """Raise InputError where one specimen would count twice: the same folder, or a copy of it."""
    seen: dict[Path | bytes, Path] = {}
    for run, place in zip(runs, places, strict=True):
        if place in seen:
            raise InputError(f"{run} is given twice. Give each run once: a specimen counts once.")
        seen[place] = run
    for run, place in zip(runs, places, strict=True):
        file = place / "results.json"
        data = file.read_bytes() if file.is_file() else b""
        if data and data in seen:
            raise InputError(
                f"{seen[data]} and {run} hold the same results, byte by byte: one is a copy. Give one of them: a "
                "specimen counts once."
            )
        seen[data] = run


def _names(places: Sequence[Path]) -> list[str]:
    """Names of folders, with those above them where two are the same."""
    depth = 1
    while True:
        names = ["/".join(place.parts[-min(depth, len(place.parts)) :]) for place in places]
        if len(set(names)) == len(names):
            return names
        depth += 1


def _factors(rows: tuple[CsvTable, list[CsvRow]], table: Path | None, places: Sequence[Path]) -> list[dict[str, str]]:
    """The factors of each run: of the row whose run, or name, is its folder."""
    found, used = list[dict[str, str]](), Counter[int]()
    sheet, lines = rows
    for place in places:
        own = [row for row in lines if _is_of(sheet, row, table, place)]
        if len(own) != 1:
            few = "no row" if not own else f"{len(own)} rows"
            raise InputError(
                f"{sheet.name} has {few} for the run {place.name}. Give it one row: its path or name in the column "
                f"{'run' if 'run' in sheet.header else 'name'}."
            )
        used[own[0].line] += 1
        cells = {name: sheet.text(own[0], name) for name in sheet.header if name not in ("run", "name", "")}
        found.append({name: cell for name, cell in cells.items() if cell})
    if idle := [row for row in lines if not used[row.line]]:
        shown = ", ".join(sheet.text(row, "run") or sheet.text(row, "name") or "empty" for row in idle[:_MOST_NAMES])
        raise InputError(
            f"{sheet.name} has {len(idle)} row{'s' if len(idle) > 1 else ''} without a run that was given: {shown}. "
            "Give these runs, too, or take the rows out."
        )
    return found


def _is_of(sheet: CsvTable, row: CsvRow, table: Path | None, place: Path) -> bool:
    cell = sheet.text(row, "run")
    if cell and (_beside(table, cell).resolve() == place or Path(cell).resolve() == place):
        return True
    return place.name in (cell, sheet.text(row, "name"))


def _relative(place: Path, home: Path) -> str:
    """Path of a run from a folder; absolute where there is none, as between drives."""
    try:
        return Path(os.path.relpath(place, home)).as_posix()
    except ValueError:
        return str(place)
