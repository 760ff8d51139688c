"""What a series is made of.

That is a table of specimens with their files and factors, and the options that they share.
"""

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from planish.core.errors import FileError, InputError, StudyError
from planish.core.files import fault_of_name
from planish.core.parameter_faults import fault_texts, key_lines, toml_tables
from planish.core.tables import DECIMAL_OR_TWO, parse_table, raise_faults, read_text
from planish.core.typing import Entries, Fields, Texts
from planish.io import find_place
from planish.run.build import study_of
from planish.run.study import Study, checked_study, in_study_words, with_paths, with_values
from planish.series.declared import Declared
from planish.series_results import Member

_NO_FACTORS = ("name", "volume", "image", "layers", "set")
_NEEDED = "It needs a column volume, or layers with a semicolon between them"
_NO_NAME = re.compile(r'[/\\<>:"|?*\x00-\x1f]')
_LONGEST_NAME = 80
_EXAMPLES = {"set": '["volume.top=low"]', "layers": '["ct=scan", "image.tif"]'}


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedSpecimen:
    """One specimen as the table has it."""

    name: str  #: Name of the specimen and of the folder of its run.
    #: Volume and image, or layers with the reference last; absolute, `NAME=PATH` where a layer has
    #: a name.
    files: Texts
    #: Text by factor, in the order of the table; empty cells are left out.
    factors: dict[str, str] = field(default_factory=dict[str, str])
    changes: Texts = ()  #: Options of this specimen alone, `SECTION.NAME=VALUE`.

    @property
    def member(self) -> Member:
        """The specimen as the page of the series names it, not yet done."""
        return Member(name=self.name, factors=self.factors)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A series as its file describes it."""

    specimens: tuple[PlannedSpecimen, ...]
    home: Path  #: Folder of the file, to which paths in it are relative.
    #: Options of all specimens, by section, as in a study file.
    sections: dict[str, Entries] = field(default_factory=dict[str, Entries])
    #: What is compared, of the table `compare`.
    declared: Declared = field(default_factory=Declared)
    #: The table `watch`, empty where there is none.
    watch: Entries = field(default_factory=dict[str, Any])
    changes: Texts = ()  #: Options of all specimens, `SECTION.NAME=VALUE`.

    def study(self, specimen: PlannedSpecimen) -> Study:
        """The study of one specimen.

        Raises
        ------
        PlanishError
            If one of its files is missing or of another kind, or an option means nothing for them.
        """
        try:
            study = study_of(specimen.files, self.sections)
            study = with_values(study, (*self.changes, *specimen.changes))
        except StudyError as error:
            raise StudyError(in_study_words(error.text)) from error
        return with_paths(study, lambda path: os.path.normpath(self.home / path))


def read_plan(path: Path, changes: Sequence[str] = ()) -> Plan:
    """Read a series: a study file with ``[[specimens]]``, or a CSV table of specimens.

    Parameters
    ----------
    path : Path
        ``.toml``, or a table with the columns ``volume`` and ``image`` (or ``layers``), ``name``
        and factors. A column with a point in its name, such as ``volume.through``, is an option of
        each specimen.
    changes : sequence of str
        Options of all specimens, `SECTION.NAME=VALUE`.

    Returns
    -------
    Plan

    Raises
    ------
    FileError
        If it cannot be read, or is the study of one specimen.
    InputError
        If an option or a column is unknown, or two specimens are the same; all faults are named.
    """
    text = read_text(path, what="table of specimens")
    plan = Plan(specimens=(), home=path.absolute().parent, changes=tuple(changes))
    if path.suffix.lower() == ".toml":
        return _of_toml(path, text, plan)
    return _checked(path, _rows_of(path, text), plan)


@dataclass(frozen=True, slots=True)
class _TableRow:
    """One specimen before it is checked, and where it stands."""

    location: str
    cells: dict[str, str]
    changes: Texts = ()
    layers: Texts = ()

    @property
    def named_files(self) -> list[str]:
        return [self.cells[kind] for kind in ("volume", "image") if kind in self.cells]

    @property
    def factors(self) -> dict[str, str]:
        return {name: cell for name, cell in self.cells.items() if name not in _NO_FACTORS}


def _rows_of(path: Path, text: str) -> list[_TableRow]:
    """Specimens of a CSV table, as text.

    A column with a point in its name is an option, ``layers`` holds files with semicolons between
    them, and others are names, files or factors. A decimal comma in an option is a fault; faults
    are raised together as InputError.
    """
    table = parse_table(text, path.name, needed=(), error=InputError, advice=f"{_NEEDED}.")
    if not {"volume", "layers"} & set(table.header):
        table.faults.append(
            f"neither a column volume nor layers (found {', '.join(table.header)[:120]}). {_NEEDED}"
        )
    rows: list[_TableRow] = []
    for row in table.rows:
        cells: dict[str, str] = {}
        options: list[str] = []
        for name, cell in zip(table.header, row.cells, strict=True):
            if not name or not cell:
                continue
            if "." not in name:
                cells[name] = cell
                continue
            options.append(f"{name}={cell}")
            if DECIMAL_OR_TWO.fullmatch(cell):
                table.fault(
                    row,
                    f"{name} {cell!r} may be {cell.replace(',', '.')}, or the two numbers"
                    f" {cell.replace(',', ' and ')}; write a number with a decimal point, two with"
                    " a blank after the comma",
                )
        parts = map(str.strip, cells.pop("layers", "").split(";"))
        layers = tuple(filter(None, parts))
        rows.append(_TableRow(f"row {row.line}", cells, tuple(options), layers))
    table.check("Correct the table.")
    return rows


def _of_toml(path: Path, text: str, plan: Plan) -> Plan:
    """Complete a plan by a study file: its specimens, what they share, and what is compared.

    Tables that are not those of a series, [[specimens]], [compare] and [watch], hold options of all
    specimens. ``text``: content of the file.
    """
    sections = toml_tables(path, text)
    if not {"specimens", "watch"} & set(sections):
        raise FileError(
            f"{path} is the study of one specimen. Do it with: planish run {path}. A series has a"
            " table [[specimens]] for each of them."
        )
    lines = key_lines(text)
    tables = sections.pop("specimens", [])
    if not _is_list_of(dict, tables):
        raise InputError(f"{path}: specimens are tables, each under a line [[specimens]].")
    compare = sections.pop("compare", {})
    watch = sections.pop("watch", {})
    sections.pop("planish", None)
    _check_common(path, text, sections)
    try:
        declared = Declared.model_validate(compare)
    except ValidationError as error:
        faults = fault_texts(
            error, Declared, lambda loc: (("compare", *loc), lines.of(("compare", *loc)))
        )
        raise InputError(f"{path}: {'; '.join(faults)}.") from error
    faults: list[str] = []
    rows = [
        _row_of_toml(table, f"line {lines.of(('specimens', k))}", faults)
        for k, table in enumerate(cast("list[dict[str, Any]]", tables))
    ]
    raise_faults(path.name, faults, "Correct these lines.", error=InputError)
    for kind in ("volume", "image"):  # stands for the specimens that name none
        common = sections.get(kind, {}).pop("path", None)
        for row in rows:
            if common and not row.layers:
                row.cells.setdefault(kind, str(common))
    return _checked(path, rows, replace(plan, sections=sections, declared=declared, watch=watch))


def _is_list_of(kind: type, value: object) -> bool:
    return isinstance(value, list) and all(isinstance(v, kind) for v in cast("list[Any]", value))


def _row_of_toml(table: Fields, location: str, faults: list[str]) -> _TableRow:
    """A specimen of a study file; what is wrong with its values is added to the faults.

    ``table``: values by their keys; ``location``: its line, for messages.
    """
    cells: dict[str, str] = {}
    lists: dict[str, Texts] = {}
    for name, value in table.items():
        if name in _EXAMPLES and _is_list_of(str, value):
            lists[name] = tuple(value)
        elif name in _EXAMPLES:
            faults.append(f"{location}: {name} is a list of texts, such as {_EXAMPLES[name]}")
        elif isinstance(value, (str, int, float)) and not isinstance(value, bool):
            cells[name] = str(value)
        else:
            faults.append(
                f"{location}: {name} has to be a text or a number; options stand in set = [...]"
            )
    return _TableRow(location, cells, lists.get("set", ()), lists.get("layers", ()))


def _check_common(path: Path, text: str, sections: Fields) -> None:
    """Refuse options that no study has; each with its line."""
    if "layers" in sections:
        raise InputError(
            f"{path}: line {key_lines(text).of(('layers',))}, layers: each specimen names its own;"
            f" take them out, or write layers = {_EXAMPLES['layers']} under [[specimens]]."
        )
    tables = dict(sections)
    # A study needs its files, which stand with the specimens here: any name will do.
    for kind in ("volume", "image"):
        table = tables.get(kind, {})
        if isinstance(table, dict):
            tables[kind] = {"path": "x"} | cast("dict[str, Any]", table)
    checked_study(path, text, tables)


def _checked(path: Path, rows: Sequence[_TableRow], plan: Plan) -> Plan:
    """Complete a plan by its specimens; all that is wrong with them is raised at once.

    ``path``: of the table, for messages. Names are made where none is given, and files become
    absolute.
    """
    if not rows and not plan.watch:
        raise InputError(f"{path} names no specimen. {_NEEDED}.")
    faults: list[str] = []
    specimens: list[PlannedSpecimen] = []
    for row, name in zip(rows, _names(rows, plan.home), strict=True):
        faults += [f"{row.location}: {fault}" for fault in _faults_of(row, name)]
        files = tuple(_absolute(file, plan.home) for file in row.layers or row.named_files)
        specimens.append(
            PlannedSpecimen(name=name, files=files, changes=row.changes, factors=row.factors)
        )
    faults += _clashes([row.location for row in rows], specimens)
    raise_faults(path.name, faults, "Correct the table.", error=InputError)
    compared = plan.declared.compare
    if compared is not None and not plan.watch:
        _check_compared(path, compared, specimens)
    return replace(plan, specimens=tuple(specimens))


def _faults_of(row: _TableRow, name: str) -> Iterator[str]:
    """What is wrong with the files and the name of a specimen."""
    if row.layers and row.named_files:
        yield "give layers, or volume and image, not both"
    if not row.layers and "volume" not in row.cells:
        yield "no volume"
    fault = _fault_of(name)
    if fault:
        yield f"{name!r} cannot name a specimen: {fault}; give it another name"


def _clashes(locations: Sequence[str], specimens: Sequence[PlannedSpecimen]) -> Iterator[str]:
    """Say which specimens have the name, or the files and options, of an earlier one."""
    first_locations: dict[Any, str] = {}
    for location, specimen in zip(locations, specimens, strict=True):
        keys: dict[Any, str] = {
            specimen.name.casefold(): f"the name {specimen.name!r}",
            (specimen.files, specimen.changes): "the same files and options",
        }
        for key, text in keys.items():
            first_location = first_locations.setdefault(key, location)
            if first_location != location:
                yield f"{location}: {text} as {first_location}"


def _check_compared(path: Path, compared: str, specimens: Sequence[PlannedSpecimen]) -> None:
    factors = sorted({factor for specimen in specimens for factor in specimen.factors})
    if compared not in factors:
        raise InputError(
            f"{path}: compare names {compared}, and no specimen has that factor; there are "
            f"{', '.join(factors) or 'none'}. Add a column {compared}, or name another one."
        )


def _names(rows: Sequence[_TableRow], home: Path) -> list[str]:
    """Names as given; else made of the factors, or the files, or numbers.

    Whichever tells all specimens apart is taken, in this order. ``home``: folder to which files are
    relative.
    """
    by_factor = ["-".join(row.factors.values()) for row in rows]
    by_file: list[str] = []
    for row in rows:
        # The first layer, NAME=PATH where it has a name, or the volume.
        files = [*row.layers, row.cells.get("volume", "")]
        file = files[0].rpartition("=")[2]
        by_file.append(find_place(home / file).stem if file else "")
    width = len(str(len(rows)))
    guesses = [f"specimen-{k:0{width}d}" for k in range(1, len(rows) + 1)]
    for names in (by_file, by_factor):  # the last one that fits holds
        if all(names) and len({*map(str.casefold, names)}) == len(names):
            guesses = [checked_name(name) for name in names]
    return [row.cells.get("name", guess) for row, guess in zip(rows, guesses, strict=True)]


def _fault_of(name: str) -> str | None:
    """Why a text cannot be the name of a folder on any system; None where it can."""
    if not name.strip() or name.startswith("."):
        return "a name begins with a letter or a digit"
    character = _NO_NAME.search(name)
    if character:
        return f"{character[0]!r} cannot stand in the name of a folder"
    if len(name) > _LONGEST_NAME:
        return f"it has more than {_LONGEST_NAME} characters"
    return fault_of_name(name, windows=True)


def checked_name(guess: str) -> str:
    """A name for a folder, of factors that may hold other signs."""
    return _NO_NAME.sub("-", guess)


def _absolute(file: str, home: Path) -> str:
    """A file with its whole path, behind NAME= where it was given so and is no file's own name."""
    name, equals_sign, path = file.partition("=")
    if equals_sign and path and not find_place(home / file).path.exists():
        return f"{name}={os.path.normpath(home / path)}"
    return os.path.normpath(home / file)
