"""Run a scenario: specimens into files, files through the whole program, errors against the truth, over seeds."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from planish.compute import Progress, silent
from planish.core.area import area_mean
from planish.core.errors import InputError, PlanishError, ResourceError
from planish.core.grid import pitch
from planish.pipeline import Run, run_study
from planish.study import Study, faults_of
from planish.synthetic import InstrumentFiles, make_specimen, write_instruments
from planish.synthetic.params import SpecimenParams
from planish.validate.figures import FIGURES
from planish.validate.ledger import in_order, make_ledger
from planish.validate.mesh import mesh_values
from planish.validate.pair import make_pair, pair_study, pair_values
from planish.validate.scenario import Limit, Scenario
from planish.validate.truth import Comparison, Values

Array = NDArray[np.float64]

_MOST_PIXELS = 1200  # along the longer side: more than a picture on a page can show


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One specimen: its figures, and how the program ended on it.

    Attributes
    ----------
    seed : int
    values : dict
        Figure name to value; empty where the program refused.
    refusal : str or None
        Message of the error with which the program ended.
    gates : tuple of str
        Sentences of the quality gates that the run did not pass.
    seconds : float
        Of the program, without the making of the specimen.
    """

    seed: int
    values: Values
    refusal: str | None = None
    gates: tuple[str, ...] = ()
    seconds: float

    @property
    def whole(self) -> bool:
        """Whether there is a result that passed its own gates."""
        return self.refusal is None and not self.gates


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """Maps (rows, cols) of one specimen on the image's pixels, NaN where nothing is valid.

    Attributes
    ----------
    pixel_um : (float, float)
        Pitch of rows and columns.
    image : Array
        Grey values.
    away_um : Array
        Error of a pixel in the sheet.
    name : str
        Property of the other two: ``coating_top``, or ``thickness`` of a paper without coating.
    found_um, error_um : Array
        The property as measured, and measured minus true.
    """

    seed: int
    pixel_um: tuple[float, float]
    image: Array
    away_um: Array
    name: str
    found_um: Array
    error_um: Array


def make_example(both: Comparison, seed: int) -> Example | None:
    """Maps of a linked run, as means over larger pixels where there are many; None without an image."""
    if "linked" not in both.groups:
        return None
    name = both.headline
    found = both.linked_values(name)
    factor = max(1.0, max(found.shape) / _MOST_PIXELS)

    def smaller(values: Array) -> Array:
        return area_mean(np.asarray(values, dtype=np.float64), (factor, factor)) if factor > 1 else values

    down, across = pitch(both.linked)
    return Example(
        seed=seed,
        pixel_um=(factor * down, factor * across),
        image=smaller(np.asarray(both.linked["image"].values, dtype=np.float64)),
        away_um=smaller(both.away_um),
        name=name,
        found_um=smaller(found),
        error_um=smaller(found - both.pixel_thickness(name, *both.true_uv)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """A figure over all seeds that have it; ``worst`` is the value furthest from 0, or nearest to missing a limit."""

    name: str
    mean: float
    sd: float
    worst: float
    n: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One limit of a scenario against the worst seed; ``value`` is None where no seed has the figure."""

    name: str
    limit: Limit
    value: float | None
    met: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """What came of a scenario.

    Attributes
    ----------
    scenario : Scenario
    entries : tuple of Entry
        One a seed.
    example : Example or None
        Maps of the first specimen that came through, for the page.
    notes : tuple of str
        Sentences on how the specimens were chosen.
    """

    scenario: Scenario
    entries: tuple[Entry, ...]
    example: Example | None = None
    notes: tuple[str, ...] = ()

    @property
    def judged(self) -> tuple[Entry, ...]:
        """Entries that count: all, or those that ended without a warning where the scenario allows one."""
        return tuple(entry for entry in self.entries if entry.whole or not self.scenario.or_warned)

    def summaries(self) -> dict[str, Summary]:
        """Mean, standard deviation and worst of each figure, in the order of the line."""
        found: dict[str, Summary] = {}
        for name in in_order({name: None for entry in self.judged for name in entry.values}):
            values = [v for entry in self.judged if (v := entry.values.get(name)) is not None]
            if not values:
                continue
            limit = self.scenario.limits.get(name) or _worse(name)
            sd = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
            mean = float(np.mean(values))
            found[name] = Summary(name=name, mean=mean, sd=sd, worst=limit.worst(values), n=len(values))
        return found

    def checks(self) -> tuple[Check, ...]:
        """All limits of the scenario."""
        summaries = self.summaries()
        made: list[Check] = []
        for name, limit in self.scenario.limits.items():
            value = summaries[name].worst if name in summaries else None
            made.append(Check(name=name, limit=limit, value=value, met=limit.met(value)))
        return tuple(made)

    @property
    def passed(self) -> bool:
        """Whether every specimen came through its gates, or may end with a warning, and every limit is met."""
        return all(entry.whole for entry in self.judged) and all(check.met for check in self.checks())


def run_scenario(
    scenario: Scenario, seeds: int | Sequence[int] | None = None, progress: Progress = silent
) -> Certificate:
    """Make the specimens of a scenario, run the program on their files, and measure its errors.

    Parameters
    ----------
    scenario : Scenario
    seeds : int or sequence of int, optional
        How many, or which; the scenario's own number where not given.
    progress : callable, optional
        Called with (stage, detail).

    Returns
    -------
    Certificate
        A seed on which the program refuses is an entry with its message, no error.
    """
    numbers = seed_numbers(scenario, seeds)
    entries: list[Entry] = []
    example: Example | None = None
    for k, seed in enumerate(numbers):
        progress(scenario.name, f"seed {seed}, {k + 1} of {len(numbers)}")
        if scenario.kind == "mesh":
            start = time.perf_counter()
            values = in_order(mesh_values(seed, once=k == 0))
            entries.append(Entry(seed=seed, values=values, seconds=time.perf_counter() - start))
        elif scenario.kind == "pair":
            entries.append(_run_pair(scenario, seed, progress))
        else:
            entry, maps = run_specimen(scenario, scenario.params(seed), seed, progress, keep=example is None)
            entries.append(entry)
            example = example or maps
    return Certificate(scenario=scenario, entries=tuple(entries), example=example)


def run_specimen(
    scenario: Scenario, params: SpecimenParams, seed: int, progress: Progress = silent, *, keep: bool = False
) -> tuple[Entry, Example | None]:
    """Make one specimen, run the program on its files, remove them; with ``keep``, also its maps for a picture."""
    with _folder() as folder:
        with _makes(scenario):
            specimen = make_specimen(params)
        files = write_instruments(specimen, folder / "specimen", volume=scenario.instrument)
        entry, run = _run(scenario_study(scenario, files), seed, folder, progress)
        if run is None:
            return entry, None
        both = Comparison.of(specimen, files, run)
        values = make_ledger(both, point_um=scenario.point_um)
        return replace(entry, values=values), make_example(both, seed) if keep else None


def _run_pair(scenario: Scenario, seed: int, progress: Progress) -> Entry:
    """Make one sheet under two instruments, link their volumes, remove the files."""
    with _folder() as folder:
        with _makes(scenario):
            made = make_pair(scenario, seed, folder)
        entry, run = _run(pair_study(scenario, made), seed, folder, progress)
        return entry if run is None else replace(entry, values=in_order(pair_values(made, run)))


def _run(study: Study, seed: int, folder: Path, progress: Progress) -> tuple[Entry, Run | None]:
    """Run a study in the folder; an entry without values yet, and the run, None where the program refused."""
    start = time.perf_counter()
    try:
        run = run_study(study, folder / "run", progress=progress)
    except ResourceError:
        raise  # a matter of this machine, not of the specimen
    except PlanishError as error:
        # The folder's name is made up anew each time and means nothing to a reader.
        refusal = str(error).replace(f"{folder}/", "")
        return Entry(seed=seed, values={}, refusal=refusal, seconds=time.perf_counter() - start), None
    seconds = time.perf_counter() - start
    progress("compare", "with the truth")
    gates = tuple(f"{gate.name}: {gate.sentence}" for gate in run.gates if not gate.passed)
    return Entry(seed=seed, values={}, gates=gates, seconds=seconds), run


@contextmanager
def _makes(scenario: Scenario) -> Generator[None]:
    try:
        yield
    except ValueError as error:
        raise InputError(f"The specimen of {scenario.name} cannot be made: {error}") from error


@contextmanager
def _folder() -> Generator[Path]:
    """Give a folder for the files of one specimen; it is removed at the end."""
    folder = Path(tempfile.mkdtemp(prefix="planish-validate-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def scenario_study(scenario: Scenario, made: InstrumentFiles) -> Study:
    """The study of a scenario's files: what a user would give on the command line.

    All of them state their voxel size, so that none is given. InputError where the scenario's options do not fit.
    """
    own = {
        "volume": {"path": str(made.volume), "through": made.through}, "image": {"path": str(made.image)},
        "correlate": {"point_um": scenario.point_um},
    }  # fmt: skip
    groups = {name: own.get(name, {}) | scenario.study.get(name, {}) for name in own.keys() | scenario.study.keys()}
    sheet = {name: groups.pop(name) for name in ("volume", "surface", "properties", "flatten") if name in groups}
    layers = [{"name": "sheet", **sheet}, {"name": "image", "image": groups.pop("image")}]
    try:
        return Study.model_validate({"layers": layers, **groups})
    except ValidationError as error:
        raise InputError(f"The study of the scenario {scenario.name} is not possible: {faults_of(error)}.") from error


def seed_numbers(scenario: Scenario, seeds: int | Sequence[int] | None) -> list[int]:
    """Seeds as numbers: 0 to the scenario's number where none are given."""
    chosen = scenario.seeds if seeds is None else seeds
    return list(range(chosen)) if isinstance(chosen, int) else list(chosen)


def _worse(name: str) -> Limit:
    return Limit(limit=0.0) if FIGURES[name].better == "small" or "ratio" in name else Limit(least=0.0)
