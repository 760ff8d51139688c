"""Existing runs as the specimens of a series, with the factors that a table gives them."""

from collections.abc import Sequence
from pathlib import Path

from planish.core.errors import FileError, InputError
from planish.core.files import check_exists
from planish.core.tables import CsvRow, parse_table, read_text
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
    table_of_runs = None
    if table is not None:
        table_of_runs = _TableOfRuns(table)
        runs = runs or table_of_runs.runs()
    folders = [_folder_of(run) for run in runs]
    _refuse_twice(runs, folders)
    names = [folder.name for folder in folders]
    depth = 1
    while len(set(names)) < len(names):  # with the folders above them where two are the same
        depth += 1
        names = ["/".join(folder.parts[-depth:]) for folder in folders]
    factors: list[dict[str, str]] = [{}] * len(folders)
    if table_of_runs is not None:
        factors = table_of_runs.factors(folders)
    return tuple(
        Member(name=name, factors=run_factors, run=relative_path(folder, home))
        for name, run_factors, folder in zip(names, factors, folders, strict=True)
    )


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
    """Raise InputError where one specimen would count twice: the same folder, or a copy of it.

    ``folders``: resolved, of ``runs`` as they were given. A copy has the same results.json.
    """
    for k, run in enumerate(runs):
        if folders[k] in folders[:k]:
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


class _TableOfRuns:
    """A table that names runs and gives their factors."""

    def __init__(self, path: Path) -> None:
        advice = "It needs a column run or name."
        table = parse_table(read_text(path), path.name, needed=(), error=InputError, advice=advice)
        if not {"run", "name"} & set(table.header):
            table.faults.append(
                f"neither a column run nor name (found {', '.join(table.header)[:120]})"
            )
        table.check("Correct the table.")
        if not table.rows:
            raise InputError(f"{table.name} has a header and no rows. Give a row for each run.")
        self._table = table
        self._home = path.absolute().parent

    def runs(self) -> list[Path]:
        """The runs that the table names."""
        if "run" not in self._table.header:
            raise InputError(
                f"{self._table.name} has no column run. Add one with the folders of the runs, or"
                " name them."
            )
        return [self._home / self._table.text(row, "run") for row in self._table.rows]

    def factors(self, folders: Sequence[Path]) -> list[dict[str, str]]:
        """Factors of each run, in the order of the folders, without those of empty cells.

        InputError unless each has one row, and each row a run.
        """
        table = self._table
        rows = [self._row_of(folder) for folder in folders]
        self._refuse_idle([row for row in table.rows if row not in rows])
        names = [name for name in table.header if name not in ("run", "name", "")]
        factors: list[dict[str, str]] = []
        for row in rows:
            cells = {name: table.text(row, name) for name in names}
            factors.append({name: cell for name, cell in cells.items() if cell})
        return factors

    def _refuse_idle(self, idle: Sequence[CsvRow]) -> None:
        """Raise InputError where rows have no run."""
        table = self._table
        texts = [table.text(row, "run") or table.text(row, "name", "empty") for row in idle[:5]]
        if texts:
            raise InputError(
                f"{table.name} has {len(idle)} row{'s' if len(idle) > 1 else ''} without a run that"
                f" was given: {', '.join(texts)}. Give these runs, too, or take the rows out."
            )

    def _row_of(self, folder: Path) -> CsvRow:
        """The row of a run; InputError unless there is one and no more."""
        rows = [row for row in self._table.rows if self._is_of(row, folder)]
        if len(rows) == 1:
            return rows[0]
        few = f"{len(rows)} rows" if rows else "no row"
        raise InputError(
            f"{self._table.name} has {few} for the run {folder.name}. Give it one row: its path"
            f" or name in the column {'run' if 'run' in self._table.header else 'name'}."
        )

    def _is_of(self, row: CsvRow, folder: Path) -> bool:
        cell = self._table.text(row, "run")
        if cell and folder in ((self._home / cell).resolve(), Path(cell).resolve()):
            return True
        return folder.name in (cell, self._table.text(row, "name"))
