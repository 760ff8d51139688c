"""Run a scenario over seeds.

Specimens go into files, files through the whole program, and errors are taken against the truth.
"""

import os
import tempfile
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from planish.core.errors import InputError, PlanishError, ResourceError
from planish.core.parameter_words import in_terminal_words
from planish.core.typing import Texts
from planish.report.draw import Picture
from planish.run import run_study
from planish.run.compute import Compute, Progress, silent
from planish.synthetic import InstrumentFiles, Specimen, make_specimen, write_instruments
from planish.synthetic.params import SpecimenParams
from planish.synthetic.presets import NUISANCES
from planish.validate.errors import LINK_STAGES, MAP_STAGES, pair_errors
from planish.validate.mesh import mesh_values
from planish.validate.scenario import (
    ALL,
    FIGURES,
    KEYS,
    NONE,
    PAIR,
    Figure,
    Limit,
    Scenario,
    Values,
    in_order,
    without_none,
)
from planish.validate.truth import Comparison, rms


def make_ledger(comparison: Comparison) -> Values:
    """Measure the errors of a run against the truth of its specimen.

    The stages of a map only where it has no image.

    Returns
    -------
    dict
        Figure name to value in the order of the line, None where the run has no such thing (paper
        without coating). Units and sentences are in :data:`planish.validate.scenario.FIGURES`.
    """
    stages = MAP_STAGES if "linked" not in comparison.groups else (*MAP_STAGES, *LINK_STAGES)
    values: Values = {}
    for errors_of_stage in stages:
        values |= errors_of_stage(comparison)
    return in_order(values)


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One specimen: its figures, and how the program ended on it."""

    seed: int
    values: Values  # figure name to value; empty where the program refused
    refusal: str | None = None  # message of the error with which the program ended
    failed: Texts = ()  # sentences of the checks that failed
    looks: Texts = ()  # sentences of the checks that ask for a look
    pictures: tuple[Picture, ...] = ()  # maps and errors of the specimen, where they were asked for

    @property
    def whole(self) -> bool:
        """True for a result of which no check failed."""
        return self.refusal is None and not self.failed


@dataclass(frozen=True, slots=True, kw_only=True)
class LedgerLine:
    """One figure over the seeds: a value a specimen, None where it has no such thing.

    And its limit, if any.
    """

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
        """The value nearest to missing the limit.

        Without one, the least of what ought to be large, or the largest.
        """
        large = self.figure.better != "small" and "ratio" not in self.figure.name
        limit = self.limit or (Limit(least=0.0) if large else Limit(limit=0.0))
        return limit.worst(self.measured) if self.measured else None

    @property
    def met(self) -> bool | None:
        """True if the worst specimen keeps the limit.

        False where it could not be measured, None without a limit.
        """
        return None if self.limit is None else self.limit.met(self.worst)


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """Result of a scenario."""

    scenario: Scenario
    entries: tuple[Entry, ...]  # one a seed; the first that came through has pictures for the page
    notes: Texts = ()  # sentences on how the specimens were chosen

    @property
    def judged(self) -> tuple[Entry, ...]:
        """Entries that count: all, or those without a warning where the scenario allows one."""
        return tuple(entry for entry in self.entries if entry.whole or not self.scenario.or_warned)

    def lines(self) -> dict[str, LedgerLine]:
        """Every figure that a specimen has or a limit names, in the order of the line."""
        limits = self.scenario.limits
        lines = dict[str, LedgerLine]()
        names = {name for entry in self.judged for name in entry.values} | limits.keys()
        for name, figure in FIGURES.items():
            if name in names:
                seed_values = tuple(entry.values.get(name) for entry in self.judged)
                lines[name] = LedgerLine(figure=figure, values=seed_values, limit=limits.get(name))
        return lines

    @property
    def passed(self) -> bool:
        """True if every limit is met and no check of a specimen that counts failed."""
        is_met = all(line.met is not False for line in self.lines().values())
        return is_met and all(entry.whole for entry in self.judged)


def run_scenario(
    scenario: Scenario,
    seeds: int | Sequence[int] | None = None,
    progress: Progress = silent,
    compute: Compute | None = None,
) -> Certificate:
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
    seed_list = seed_numbers(scenario, seeds)
    entries = list[Entry]()
    for k, seed in enumerate(seed_list):
        progress(scenario.name, f"seed {seed}, {k + 1} of {len(seed_list)}")
        if scenario.kind == "mesh":
            values = in_order(mesh_values(seed, once=k == 0))
            entries.append(Entry(seed=seed, values=values))
        else:
            draw = not any(entry.pictures for entry in entries)
            params = scenario.params(seed)
            entries.append(run_specimen(scenario, params, seed, progress, compute, draw=draw))
    return Certificate(scenario=scenario, entries=tuple(entries))


def run_specimen(
    scenario: Scenario,
    params: SpecimenParams,
    seed: int,
    progress: Progress = silent,
    compute: Compute | None = None,
    *,
    draw: bool = False,
) -> Entry:
    """Make one specimen, or a pair, run the program on its files, remove them.

    With ``draw``, also its pictures. A specimen that the program refuses has no figures but the
    message.
    """
    with tempfile.TemporaryDirectory(
        prefix="planish-validate-", ignore_cleanup_errors=True
    ) as name:
        folder = Path(name)
        try:
            specimens = _write_specimens(scenario, params, seed, folder)
        except ValueError as error:
            raise InputError(f"The specimen of {scenario.name} cannot be made: {error}") from error
        volumes = [(files.volume, files.through) for _, files in specimens]
        study = scenario.study_of(volumes, specimens[0][1].image)
        try:
            run = run_study(study, folder / "run", progress=progress, compute=compute)
        except ResourceError:
            raise  # a matter of this machine, not of the specimen
        except PlanishError as error:
            # The folder's name is made up anew each time and means nothing to a reader.
            refusal = in_terminal_words(error.text).replace(f"{folder}{os.sep}", "")
            return Entry(seed=seed, values={}, refusal=refusal)
        progress("compare", "with the truth")
        failed = tuple(f"{c.name}: {c.sentence}" for c in run.results.checks_in("fail"))
        looks = tuple(f"{c.name}: {c.sentence}" for c in run.results.checks_in("look"))
        pictures: tuple[Picture, ...] = ()
        if scenario.second is not None:
            values = in_order(pair_errors(specimens, run))
        else:
            comparison = Comparison(*specimens[0], run)
            values = make_ledger(comparison)
            if draw and "linked" in run.groups:
                from planish.validate.example import draw_example  # which loads all that draws

                pictures = tuple(draw_example(comparison, seed))
        return Entry(seed=seed, values=values, failed=failed, looks=looks, pictures=pictures)


def _write_specimens(
    scenario: Scenario, params: SpecimenParams, seed: int, folder: Path
) -> list[tuple[Specimen, InstrumentFiles]]:
    """Specimen of a scenario, or the two of one sheet, with the files that are made of them."""
    specimen = make_specimen(params)
    if scenario.second is None:
        files = write_instruments(specimen, folder / "specimen", volume=scenario.instrument)
        return [(specimen, files)]
    second = make_specimen(scenario.second_params(seed), sheet=specimen.sheet)
    volumes = (scenario.instrument, scenario.second.instrument)
    specimens: list[tuple[Specimen, InstrumentFiles]] = []
    for name, layer, volume in zip(PAIR, (specimen, second), volumes, strict=True):
        files = write_instruments(layer, folder / name, volume=volume, image=False)
        specimens.append((layer, files))
    return specimens


def seed_numbers(scenario: Scenario, seeds: int | Sequence[int] | None) -> list[int]:
    """Seeds as numbers: 0 to the scenario's number where none are given."""
    wanted = scenario.seeds if seeds is None else seeds
    if isinstance(wanted, int):
        wanted = range(wanted)
    return list(wanted)


# Of a baseline: growth against next to nothing is none. A quarter of it is noticed, that is 0.002
# of an r.
_FLOOR = {"um": 0.05, "%": 0.05, "deg": 0.05, "1": 0.008}
# Share of the largest growth with which an error is taken to have come in at an earlier stage.
_CARRIED = 0.5
_AGREES = 1.5  # factor between the sum of squares and the whole


@dataclass(frozen=True, slots=True, kw_only=True)
class NuisanceRow:
    """One nuisance alone."""

    nuisance: str  # key of :data:`planish.synthetic.presets.NUISANCES`
    # Stage to the error that the nuisance adds to the stage's key figure, in squares: sqrt(e^2 -
    # e0^2).
    added: Values
    # The same over the error without any nuisance; without the stages that have none.
    growth: dict[str, float]
    suffers: str | None  # the first stage along the line that is hit; None where no stage notices
    refusal: str | None = None  # message of a run that the nuisance stopped


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """Table of all nuisances of a scenario."""

    keys: dict[str, str]  # stage to the figure that speaks for it
    quiet: dict[str, float]  # stage to that figure without any and with all nuisances
    loud: Values
    rows: tuple[NuisanceRow, ...]
    # Stage to the sum of squares of single errors over what all together add; None where neither is
    # worth naming.
    ratio: Values
    # Stage whose ratio is off to the two nuisances whose leaving out changes most: they do not add
    # as squares.
    together: dict[str, Texts]
    seeds: tuple[int, ...]


def sensitivity(
    scenario: Scenario,
    seeds: int | Sequence[int] = 1,
    progress: Progress = silent,
    compute: Compute | None = None,
) -> Sensitivity:
    """Run a scenario without nuisances, with each alone, and with all.

    Figures are rms over the seeds.

    Where the single errors do not sum up to the whole, each nuisance is also left out in turn. One
    figure speaks for each stage, the first of its candidates that the run without nuisances has.
    InputError if the scenario is no line of stages, has no nuisance, or is refused by the program
    without any of them.
    """
    names = _nuisances_of(scenario)
    seed_list = seed_numbers(scenario, seeds)
    measure = partial(_rms_figures, scenario, seed_list, progress, compute)
    base_figures, refusal = measure("no nuisance", NONE)
    if refusal is not None:
        raise InputError(
            f"The scenario {scenario.name} does not even come through without nuisances: {refusal}"
        )
    measured = without_none(base_figures)
    keys = _key_figures(measured)
    quiet = {stage: measured[name] for stage, name in keys.items()}
    rows: list[NuisanceRow] = []
    for name in names:
        figures, refusal = measure(f"{NUISANCES[name].title} alone", (name,))
        rows.append(make_row(name, keys, quiet, figures, refusal))
    # All that are on: scenario.nuisances may be a list.
    all_nuisances = scenario.nuisances if scenario.nuisances != NONE else ALL
    all_figures, _ = measure("all together", all_nuisances)
    loud = {stage: all_figures.get(name) for stage, name in keys.items()}
    ratio = {stage: _ratio(stage, keys, quiet, loud, rows) for stage in keys}
    # Without the only nuisance nothing is left to compare.
    deviating = _deviating_stages(ratio) if len(names) > 1 else []
    together: dict[str, Texts] = {}
    if deviating:
        together = _together(deviating, keys, loud, _figures_without(names, measure))
    return Sensitivity(
        keys=keys,
        quiet=quiet,
        loud=loud,
        rows=tuple(rows),
        ratio=ratio,
        together=together,
        seeds=tuple(seed_list),
    )


def _figures_without(
    names: Sequence[str], measure: Callable[[str, Texts], tuple[Values, str | None]]
) -> dict[str, Values]:
    """Measure a scenario without each of its nuisances in turn."""
    figures: dict[str, Values] = {}
    for name in names:
        remaining = tuple(other for other in names if other != name)
        figures[name], _ = measure(f"all but {NUISANCES[name].title}", remaining)
    return figures


def _nuisances_of(scenario: Scenario) -> list[str]:
    """Nuisances of a scenario that are on; InputError where it has none."""
    if scenario.kind != "line":
        raise InputError(
            f"The scenario {scenario.name} has no nuisances. Give one that runs the whole line."
        )
    if not scenario.active:
        raise InputError(
            f"No nuisance of the scenario {scenario.name} is on. Give one with nuisances, such as"
            " small."
        )
    return scenario.active


def _deviating_stages(ratio: Values) -> list[str]:
    """Stages whose single errors do not add up to the whole."""
    known = without_none(ratio)
    return [stage for stage, r in known.items() if not 1 / _AGREES <= r <= _AGREES]


def _key_figures(measured: Container[str]) -> dict[str, str]:
    """The figure that speaks for each stage: the first of its candidates that was measured."""
    keys: dict[str, str] = {}
    for stage, candidates in KEYS.items():
        present = [name for name in candidates if name in measured]
        if present:
            keys[stage] = present[0]
    return keys


def _rms_figures(
    scenario: Scenario,
    seeds: Sequence[int],
    progress: Progress,
    compute: Compute | None,
    label: str,
    nuisances: str | Texts,
) -> tuple[Values, str | None]:
    """Return the rms of each figure over the seeds, and the first refusal.

    ``label`` says in the progress which ``nuisances`` are on. None where no seed has the figure.
    """
    entries: list[Entry] = []
    for seed in seeds:
        progress("sensitivity", f"{label}, seed {seed}")
        params = scenario.params(seed, nuisances)
        entries.append(run_specimen(scenario, params, seed, compute=compute))
    figures: Values = {}
    names = dict.fromkeys(chain.from_iterable(entry.values for entry in entries))
    for name in names:
        seed_values = [entry.values.get(name) for entry in entries]
        figures[name] = rms(np.array(seed_values, dtype=np.float64))
    refusals = [entry.refusal for entry in entries if entry.refusal is not None]
    return figures, refusals[0] if refusals else None


def _together(
    stages: Sequence[str], keys: dict[str, str], loud: Values, figures_without: dict[str, Values]
) -> dict[str, Texts]:
    """Name the two nuisances without which the error of a stage's key figure changes most.

    ``keys`` and ``loud`` are those of `Sensitivity`; ``figures_without`` are the figures of runs
    without one nuisance, by its name. A missing figure changes nothing.
    """
    together: dict[str, Texts] = {}
    for stage in stages:
        all_error = loud[stage] or 0.0
        changes: dict[str, float] = {}
        for name, figures in figures_without.items():
            error = figures.get(keys[stage])
            changes[name] = 0.0 if error is None else abs(all_error**2 - error**2)
        by_change = sorted(changes, key=lambda name: -changes[name])
        together[stage] = tuple(by_change[:2])
    return together


def make_row(
    name: str, keys: dict[str, str], quiet: dict[str, float], figures: Values, refusal: str | None
) -> NuisanceRow:
    """Give the error that a nuisance adds to every stage, and the stage where it comes in.

    ``figures`` are those of the run with the nuisance alone; ``keys`` and ``quiet`` as in
    `Sensitivity`. Errors are carried along the line: the stage that suffers is the first one that
    grows at least half as much, relative to its own baseline, as the one that grows most.
    """
    added: Values = {}
    growth: dict[str, float] = {}
    for stage, key in keys.items():
        error = added_error(figures.get(key), quiet[stage])
        added[stage] = error
        if error is not None:
            growth[stage] = error / max(quiet[stage], _FLOOR[FIGURES[key].unit])
    max_growth = max(growth.values(), default=0.0)
    suffers = None
    # With less growth, in baselines, no stage is said to suffer.
    if max_growth >= 0.25:
        hit = (stage for stage, factor in growth.items() if factor >= _CARRIED * max_growth)
        suffers = next(hit, None)
    return NuisanceRow(nuisance=name, added=added, growth=growth, suffers=suffers, refusal=refusal)


def added_error(error: float | None, base: float) -> float | None:
    """Give the error that adds to ``base`` in squares to make ``error``.

    0 where that is not larger.
    """
    if error is None:
        return None
    added_square = max(0.0, error**2 - base**2)
    return float(np.sqrt(added_square))


def _ratio(
    stage: str,
    keys: dict[str, str],
    quiet: dict[str, float],
    loud: Values,
    rows: Sequence[NuisanceRow],
) -> float | None:
    """Sum of squares over the whole.

    None where both stay below the floor or half of the baseline.
    """
    total = added_error(loud[stage], quiet[stage])
    squares = [(row.added[stage] or 0.0) ** 2 for row in rows]
    sum_of_singles = float(np.sqrt(sum(squares)))
    unit = FIGURES[keys[stage]].unit
    # Where all together add less, their sum is not worth naming.
    floor = max(_FLOOR[unit], 0.5 * quiet[stage])
    if total is None or max(total, sum_of_singles) < floor:
        return None
    return sum_of_singles / total if total > 0 else float("inf")
