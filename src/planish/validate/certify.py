"""Run a scenario: specimens into files, files through the whole program, errors against the truth, over seeds."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planish.compute import Compute, Progress, silent
from planish.core.errors import InputError, PlanishError, ResourceError
from planish.pipeline import run_study
from planish.report.draw import Picture
from planish.synthetic import InstrumentFiles, Specimen, make_specimen, write_instruments
from planish.synthetic.params import SpecimenParams
from planish.validate import image_errors, volume_errors
from planish.validate.drawings import draw_example
from planish.validate.figures import FIGURES, Figure, Values, in_order
from planish.validate.mesh import mesh_values
from planish.validate.scenario import PAIR, Limit, Scenario
from planish.validate.truth import Comparison

_OF_A_MAP = (
    volume_errors.section_errors, volume_errors.surface_errors, volume_errors.centre_errors,
    volume_errors.thickness_errors, volume_errors.flattening_errors,
)  # fmt: skip
_OF_A_LINK = (
    image_errors.pixel_errors, image_errors.hole_errors, image_errors.registration_errors,
    image_errors.resampling_errors, image_errors.statistic_errors,
)  # fmt: skip


def make_ledger(comparison: Comparison) -> Values:
    """Measure the errors of a run against the truth of its specimen; the stages of a map only where it has no image.

    Returns
    -------
    dict
        Figure name to value in the order of the line, None where the run has no such thing (paper without coating).
        Units and sentences are in :data:`planish.validate.figures.FIGURES`.
    """
    values: Values = {}
    for errors in (*_OF_A_MAP, *(_OF_A_LINK if "linked" in comparison.groups else ())):
        values |= errors(comparison)
    return in_order(values)


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One specimen: its figures, and how the program ended on it."""

    seed: int
    values: Values  # figure name to value; empty where the program refused
    refusal: str | None = None  # message of the error with which the program ended
    failed: tuple[str, ...] = ()  # sentences of the checks that failed
    looks: tuple[str, ...] = ()  # sentences of the checks that ask for a look
    pictures: tuple[Picture, ...] = ()  # maps and errors of the specimen, where they were asked for

    @property
    def whole(self) -> bool:
        """True for a result of which no check failed."""
        return self.refusal is None and not self.failed


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One figure over the seeds: a value a specimen, None where it has no such thing; and its limit, if any."""

    figure: Figure
    values: tuple[float | None, ...]
    limit: Limit | None

    @property
    def measured(self) -> list[float]:
        """Values of the specimens that have the figure."""
        return [value for value in self.values if value is not None]

    @property
    def mean(self) -> float | None:
        """Mean; None where no specimen has the figure."""
        return float(np.mean(self.measured)) if self.measured else None

    @property
    def sd(self) -> float | None:
        """Standard deviation; None for less than two specimens."""
        return float(np.std(self.measured, ddof=1)) if len(self.measured) > 1 else None

    @property
    def worst(self) -> float | None:
        """The value nearest to missing the limit; without one, the least of what ought to be large, or the largest."""
        large = self.figure.better != "small" and "ratio" not in self.figure.name
        limit = self.limit or (Limit(least=0.0) if large else Limit(limit=0.0))
        return limit.worst(self.measured) if self.measured else None

    @property
    def met(self) -> bool | None:
        """True if the worst specimen keeps the limit; False where it could not be measured, None without a limit."""
        return None if self.limit is None else self.limit.met(self.worst)


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """Result of a scenario."""

    scenario: Scenario
    entries: tuple[Entry, ...]  # one a seed; the first that came through has pictures for the page
    notes: tuple[str, ...] = ()  # sentences on how the specimens were chosen

    @property
    def judged(self) -> tuple[Entry, ...]:
        """Entries that count: all, or those that ended without a warning where the scenario allows one."""
        return tuple(entry for entry in self.entries if entry.whole or not self.scenario.or_warned)

    def lines(self) -> dict[str, Line]:
        """Every figure that a specimen has or a limit names, in the order of the line."""
        limits = self.scenario.limits
        names = {name for entry in self.judged for name in entry.values} | limits.keys()
        return {
            name: Line(
                figure=figure, values=tuple(e.values.get(name) for e in self.judged), limit=limits.get(name)
            )
            for name, figure in FIGURES.items()
            if name in names
        }  # fmt: skip

    @property
    def passed(self) -> bool:
        """True if every limit is met and no check of a specimen that counts failed."""
        return all(e.whole for e in self.judged) and all(line.met is not False for line in self.lines().values())


def run_scenario(
    scenario: Scenario, seeds: int | Sequence[int] | None = None, progress: Progress = silent,
    compute: Compute | None = None,
) -> Certificate:  # fmt: skip
    """Make the specimens of a scenario, run the program on their files, and measure its errors.

    Parameters
    ----------
    scenario : Scenario
    seeds : int or sequence of int, optional
        How many, or which; the scenario's own number where not given.
    progress : callable, optional
        Called with (stage, detail).
    compute : Compute, optional
        Memory and threads of each run.

    Returns
    -------
    Certificate
        A seed on which the program refuses is an entry with its message, no error.
    """
    numbers = seed_numbers(scenario, seeds)
    entries: list[Entry] = []
    for k, seed in enumerate(numbers):
        progress(scenario.name, f"seed {seed}, {k + 1} of {len(numbers)}")
        if scenario.kind == "mesh":
            entries.append(Entry(seed=seed, values=in_order(mesh_values(seed, once=k == 0))))
        else:
            drawn = any(entry.pictures for entry in entries)
            entries.append(run_specimen(scenario, scenario.params(seed), seed, progress, compute, draw=not drawn))
    return Certificate(scenario=scenario, entries=tuple(entries))


def run_specimen(
    scenario: Scenario, params: SpecimenParams, seed: int, progress: Progress = silent,
    compute: Compute | None = None, *, draw: bool = False,
) -> Entry:  # fmt: skip
    """Make one specimen, or a pair, run the program on its files, remove them; with ``draw``, also its pictures."""
    with tempfile.TemporaryDirectory(prefix="planish-validate-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        try:
            specimens = _make_specimens(scenario, params, seed, folder)
        except ValueError as error:
            raise InputError(f"The specimen of {scenario.name} cannot be made: {error}") from error
        study = scenario.study_of([(files.volume, files.through) for _, files in specimens], specimens[0][1].image)
        try:
            run = run_study(study, folder / "run", progress=progress, compute=compute)
        except ResourceError:
            raise  # a matter of this machine, not of the specimen
        except PlanishError as error:
            # The folder's name is made up anew each time and means nothing to a reader.
            return Entry(seed=seed, values={}, refusal=error.text.replace(f"{folder}{os.sep}", ""))
        progress("compare", "with the truth")
        failed = tuple(f"{c.name}: {c.sentence}" for c in run.results.spoken("fail"))
        looks = tuple(f"{c.name}: {c.sentence}" for c in run.results.spoken("look"))
        if scenario.second is not None:
            return Entry(
                seed=seed, values=in_order(image_errors.pair_errors(specimens, run)), failed=failed, looks=looks
            )
        comparison = Comparison(*specimens[0], run)
        pictures = tuple(draw_example(comparison, seed)) if draw and "linked" in run.groups else ()
        return Entry(seed=seed, values=make_ledger(comparison), failed=failed, looks=looks, pictures=pictures)


def _make_specimens(
    scenario: Scenario, params: SpecimenParams, seed: int, folder: Path
) -> list[tuple[Specimen, InstrumentFiles]]:
    """Make the specimen as each instrument has it, and write their files."""
    specimen = make_specimen(params)
    if scenario.second is None:
        return [(specimen, write_instruments(specimen, folder / "specimen", volume=scenario.instrument))]
    other = make_specimen(scenario.second_params(seed), sheet=specimen.sheet)
    instruments = (scenario.instrument, scenario.second.instrument)
    return [
        (one, write_instruments(one, folder / name, volume=instrument, image=False))
        for name, one, instrument in zip(PAIR, (specimen, other), instruments, strict=True)
    ]


def seed_numbers(scenario: Scenario, seeds: int | Sequence[int] | None) -> list[int]:
    """Seeds as numbers: 0 to the scenario's number where none are given."""
    chosen = scenario.seeds if seeds is None else seeds
    return list(range(chosen)) if isinstance(chosen, int) else list(chosen)
