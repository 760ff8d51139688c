"""A run: what it holds, how it shows itself, and how it comes back from its folder."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import xarray as xr

from planish.core.arrays import check_path
from planish.core.checks import Check
from planish.core.errors import FileError
from planish.core.facts import is_known
from planish.core.files import check_exists
from planish.core.lazy import ReadOnDemand
from planish.core.older_names import todays_study
from planish.io.map_groups import open_tree
from planish.marks.regions import Regions, read_regions
from planish.results import Results
from planish.run.layers import Datasets, Groups, Layers, MappedLayer
from planish.run.regions import REGIONS
from planish.run.registration import Registration
from planish.run.study import RUN_TOML, Study, read_study

MAPS = "maps.zarr"
"""Name of the store with the groups of a run."""

_MOST_LAYERS, _MOST_LETTERS = 5, 200  # of a run that is shown as text
_OF_A_SHEET = ("surfaces", "flat", "strain", "maps", "slices")
_SHEET_GROUPS = (*_OF_A_SHEET, "sections")  # of serial sections


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """All that a run gives."""

    study: Study  #: the parameters, with the sizes and pitches that were used
    results: Results  #: every number, as ``results.json`` has it
    #: Of one sheet: ``surfaces`` and ``flat`` (y, x), ``strain`` (row, col), ``maps`` (v, u),
    #: ``slices``, and ``sections`` of serial sections. Of a sheet linked to an image also
    #: ``linked`` (y, x of the image), and ``refined``. Of other links ``layers/NAME`` on the pixels
    #: of the reference.
    groups: Groups
    #: by the moving layer.
    registrations: Mapping[str, Registration] = field(default_factory=dict[str, Registration])
    #: Sheets that were mapped on the way to a link of other layers than one sheet and one image.
    sheets: Layers = field(default_factory=Layers)
    regions: Regions | None = None  #: declared artefacts, in um of the reference of a link
    #: Groups that stand in the store of another run with the same bytes, and that store.
    unchanged: dict[str, Path] = field(default_factory=dict[str, Path])
    folder: Path | None = None  #: where it was read from

    @property
    def maps(self) -> xr.Dataset:
        """Flat maps (v, u) of the sheet."""
        return self._group("maps")

    @property
    def linked(self) -> xr.Dataset:
        """All maps of the sheet and the image, on the pixels of the image."""
        return self._group("linked")

    @cached_property
    def layers(self) -> Datasets:
        """Layers of a link on the pixels of the reference, by name."""
        inside = "layers/"
        return {k.removeprefix(inside): v for k, v in self.groups.items() if k.startswith(inside)}

    @property
    def marks(self) -> xr.Dataset:
        """All marks of the only registration, matched or not."""
        if len(self.registrations) != 1:
            names = ", ".join(self.registrations) or "none"
            raise FileError(
                f"The run has {len(self.registrations)} registrations ({names}). Take one of them."
            )
        return next(iter(self.registrations.values())).marks

    @property
    def checks(self) -> tuple[Check, ...]:
        """Its checks, each with a state, a sentence, and what to do."""
        return self.results.checks

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return self.results.passed

    def sheet(self) -> MappedLayer:
        """The sheet that was mapped; what it was linked to stays behind.

        Raises
        ------
        FileError
            If the run holds no sheet of its own.
        """
        if not self.groups.keys() >= {*_OF_A_SHEET}:
            raise FileError(
                f"{self.folder or 'The run'} holds no map of one sheet. Give a run of one volume,"
                " from 'planish map' or 'planish link VOLUME IMAGE'."
            )
        layers = zip(self.results.layers, self.study.layers, strict=True)
        facts, params = next(pair for pair in layers if pair[0].sheet is not None)
        return MappedLayer(
            params=params,
            source=facts.source,
            md_deg=(params.volume or params).md_deg,
            groups={k: v for k, v in self.groups.items() if k in _SHEET_GROUPS},
            facts=facts.sheet,
            checks=tuple(check for check in self.checks if check.layers == (facts.name,)),
        )

    def __repr__(self) -> str:
        """Return folder, layers, checks, groups, and r if it is a link, in ten lines at most."""
        from planish.report.relation import largest
        from planish.report.summary import lead_pair

        states = Counter(check.state for check in self.checks)
        checks = ", ".join(f"{count} {state}" for state, count in states.items()) or "none"
        lines = ["Run" if self.folder is None else f"Run in {self.folder}"]
        layers = self.results.layers
        lines += [f"{layer.name}: {layer.source.name}" for layer in layers[:_MOST_LAYERS]]
        if len(layers) > _MOST_LAYERS:
            lines.append(f"and {len(layers) - _MOST_LAYERS} more layers")
        lines.append(f"checks: {checks}")
        pair = lead_pair(self.results)
        if pair:
            row = largest(pair)
            r = f"{row.r:.2f}" if is_known(row.r) else "withheld"
            lines.append(
                f"r = {r}: {row.a_map} of {row.a}, {row.b_map} of {row.b}, points of"
                f" {row.point_um:g} um"
            )
        lines.append(f"groups: {self._groups_text()}")
        return "\n  ".join(lines)

    def _groups_text(self) -> str:
        """Name the groups with their sizes, as far as a line goes."""
        groups: list[str] = []
        for name, data in self.groups.items():
            groups.append(f"{name} {'x'.join(map(str, data.sizes.values()))}")
        text = ", ".join(groups)
        if len(text) >= _MOST_LETTERS:
            return f"{text[:_MOST_LETTERS]} ..."
        return text

    def _repr_html_(self) -> str:
        from planish.report import run_html

        return run_html(self.results, self.groups)

    def _group(self, name: str) -> xr.Dataset:
        if name in self.groups:
            return self.groups[name]
        remedy = ""
        if name == "linked":
            remedy = " Link it to an image first: planish link RUN IMAGE --out OTHER."
        raise FileError(f"The run has no {name}; it holds {', '.join(self.groups)}.{remedy}")


def is_run(path: Path) -> bool:
    """Whether a folder holds a run."""
    return (path / RUN_TOML).is_file() and (path / MAPS).is_dir()


def open_run(path: str | Path) -> Run:
    """Open a run folder.

    Parameters
    ----------
    path : path
        Folder that ``planish map``, ``link`` or ``demo`` made.

    Returns
    -------
    Run
        Its groups and registrations are read when they are first asked for.

    Raises
    ------
    FileError
        If it is no run, was made by planish 0.1.0, or a file of it is missing or damaged; of groups
        and registrations where they are asked for.
    InputError
        If its study has parameters that are not known.
    """
    folder = check_path(path, "the folder of a run", "pl.open_run", 'pl.open_run("run")')
    results = open_results(folder)
    names = [layer.name for layer in results.moving]
    return Run(
        study=study_of(folder, results),
        results=results,
        groups=open_tree(folder / MAPS),
        registrations=ReadOnDemand(
            lambda: names, lambda name: Registration.read(folder / marks_file(results, name))
        ),
        regions=read_regions(folder / REGIONS) if results.regions else None,
        folder=folder,
    )


def open_sheet(path: str | Path) -> MappedLayer:
    """The sheet that was mapped in a run folder; what it was linked to is not read.

    FileError if it is no run, holds no sheet of its own, or a file of it is missing or damaged.
    """
    folder = Path(path)
    results = open_results(folder)
    study = study_of(folder, results)
    sheet = Run(
        study=study, results=results, groups=open_tree(folder / MAPS, _SHEET_GROUPS), folder=folder
    ).sheet()
    unchanged = dict.fromkeys(sheet.groups, folder / MAPS) if results.is_of_this_code else {}
    return replace(sheet, by_this_code=results.is_of_this_code, unchanged=unchanged)


def study_of(folder: Path, results: Results) -> Study:
    """The study of a run folder; its maps have the names of today.

    Parameters
    ----------
    folder : path
    results : Results
        Of the run.

    Returns
    -------
    Study
    """
    study = read_study(folder / RUN_TOML)
    if not results.is_older:
        return study
    return Study.model_validate(todays_study(study.model_dump(mode="json")))


def open_results(folder: Path) -> Results:
    """The numbers of a run folder."""
    check_exists(folder)
    if not is_run(folder):
        raise FileError(
            f"{folder} is no run. Give the folder that 'planish map' or 'planish link' made."
        )
    return Results.read(folder / "results.json")


def marks_file(results: Results, layer: str) -> str:
    """Name of the file with the marks of a layer's registration."""
    return "marks.json" if len(results.moving) == 1 else f"marks-{layer}.json"
