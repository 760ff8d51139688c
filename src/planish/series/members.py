"""Existing runs as the specimens of a series, with the factors that a table gives them."""

from collections.abc import Sequence
from pathlib import Path

from planish.core.errors import FileError, InputError
from planish.core.files import check_exists
from planish.core.tables import CsvRow, CsvTable, parse_table, read_text
from planish.run.run import is_run
from planish.run.study import relative_path
from planish.series_results import Member


def members_of(
    runs: Sequence[Path], *, home: Path, table: Path | None = None
) -> tuple[Member, ...]:
    """Make members of runs.

    Parameters
    ----------
    runs : sequence of path
        Folders of runs; where there are none, those of the table, in its order.
    home : path
        Folder that the members' runs are to be relative to.
    table : path, optional
        CSV with a column ``run``, a path relative to the table or the name of the folder, or
        ``name``; other columns are factors. A row without a run among ``runs`` is of no use and an
        error.

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
    csv_table = None
    if table is not None:
        advice = "It needs a column run or name."
        csv_table = parse_table(
            read_text(table), table.name, needed=(), error=InputError, advice=advice
        )
        if not {"run", "name"} & set(csv_table.header):
            csv_table.faults.append(
                f"neither a column run nor name (found {', '.join(csv_table.header)[:120]})"
            )
        csv_table.check("Correct the table.")
        if not csv_table.rows:
            raise InputError(f"{csv_table.name} has a header and no rows. Give a row for each run.")
    if csv_table is not None and not runs:
        if "run" not in csv_table.header:
            raise InputError(
                f"{csv_table.name} has no column run. Add one with the folders of the runs, or name"
                " them."
            )
        runs = [_from_table(table, csv_table.text(row, "run")) for row in csv_table.rows]
    folders = [_folder_of(run) for run in runs]
    _refuse_twice(runs, folders)
    names, depth = [folder.name for folder in folders], 1
    while len(set(names)) < len(names):  # with the folders above them where two are the same
        depth += 1
        names = ["/".join(folder.parts[-depth:]) for folder in folders]
    factors = [{} for _ in folders] if csv_table is None else _factors(csv_table, table, folders)
    return tuple(
        Member(name=name, factors=run_factors, run=relative_path(folder, home))
        for name, run_factors, folder in zip(names, factors, folders, strict=True)
    )


def _from_table(table: Path | None, cell: str) -> Path:
    return Path(cell) if table is None else table.absolute().parent / cell


def _folder_of(run: Path) -> Path:
    """The folder of a run; damaged ones show when they are read."""
    check_exists(run)
    fault = "" if run.is_dir() else "is no folder"
    if not fault and not is_run(run) and not (run / "results.json").is_file():
        fault = "is no run"
    if fault:
        raise FileError(
            f"{run} {fault}. Give the folder that 'planish map' or 'planish link' made."
        )
    return run.resolve()


def _refuse_twice(runs: Sequence[Path], folders: Sequence[Path]) -> None:
    """Raise InputError where one specimen would count twice: the same folder, or a copy of it."""
    if len(set(folders)) < len(folders):
        run = next(run for k, run in enumerate(runs) if folders[k] in folders[:k])
        raise InputError(f"{run} is given twice. Give each run once: a specimen counts once.")
    run_by_content: dict[bytes, Path] = {}
    for run, folder in zip(runs, folders, strict=True):
        file = folder / "results.json"
        content = file.read_bytes() if file.is_file() else b""
        if content and content in run_by_content:
            raise InputError(
                f"{run_by_content[content]} and {run} hold the same results, byte by byte: one is a"
                " copy. Give one of them: a specimen counts once."
            )
        run_by_content[content] = run


def _factors(
    csv_table: CsvTable, table: Path | None, folders: Sequence[Path]
) -> list[dict[str, str]]:
    def is_row_of(row: CsvRow, folder: Path) -> bool:
        run_cell = csv_table.text(row, "run")
        paths = (
            (_from_table(table, run_cell).resolve(), Path(run_cell).resolve()) if run_cell else ()
        )
        return folder in paths or folder.name in (run_cell, csv_table.text(row, "name"))

    factors, used = list[dict[str, str]](), set[int]()
    for folder in folders:
        rows = [row for row in csv_table.rows if is_row_of(row, folder)]
        if len(rows) != 1:
            few = "no row" if not rows else f"{len(rows)} rows"
            raise InputError(
                f"{csv_table.name} has {few} for the run {folder.name}. Give it one row: its path"
                f" or name in the column {'run' if 'run' in csv_table.header else 'name'}."
            )
        used.add(rows[0].line)
        cells = {
            name: csv_table.text(rows[0], name)
            for name in csv_table.header
            if name not in ("run", "name", "")
        }
        factors.append({name: cell for name, cell in cells.items() if cell})
    if idle := [row for row in csv_table.rows if row.line not in used]:
        shown = ", ".join(
            csv_table.text(row, "run") or csv_table.text(row, "name") or "empty" for row in idle[:5]
        )
        raise InputError(
            f"{csv_table.name} has {len(idle)} row{'s' if len(idle) > 1 else ''} without a run that"
            f" was given: {shown}. Give these runs, too, or take the rows out."
        )
    return factors
