"""Each nuisance alone: how much error it adds to every stage, and whether the sum of them explains the whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planish.compute import Compute, Progress, silent
from planish.core.errors import InputError
from planish.synthetic.presets import NUISANCES
from planish.validate.certify import Entry, run_specimen, seed_numbers
from planish.validate.figures import FIGURES, KEYS, Values
from planish.validate.scenario import ALL, NONE, Scenario
from planish.validate.truth import rms

# Of a baseline: growth against next to nothing is none. A quarter of it is noticed, that is 0.002 of an r.
_FLOOR = {"um": 0.05, "%": 0.05, "deg": 0.05, "1": 0.008}
_NOTICED = 0.25  # growth, in baselines, below which no stage is said to suffer
_WORTH = 0.5  # of the baseline: what all together have to add for their sum to be worth naming
_CARRIED = 0.5  # share of the largest growth with which an error is taken to have come in at an earlier stage
_AGREES = 1.5  # factor between the sum of squares and the whole


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One nuisance alone."""

    nuisance: str  # key of :data:`planish.synthetic.presets.NUISANCES`
    added: Values  # stage to the error that the nuisance adds to the stage's key figure, in squares: sqrt(e^2 - e0^2)
    growth: dict[str, float]  # the same over the error without any nuisance; without the stages that have none
    suffers: str | None  # the first stage along the line that is hit; None where no stage notices
    refusal: str | None = None  # message of a run that the nuisance stopped


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """Table of all nuisances of a scenario."""

    keys: dict[str, str]  # stage to the figure that speaks for it
    quiet: dict[str, float]  # stage to that figure without any and with all nuisances
    loud: Values
    rows: tuple[Row, ...]
    # Stage to the sum of squares of the single errors over what all of them together add; None where neither is worth
    # naming.
    ratio: Values
    # Stage whose ratio is off to the two nuisances whose leaving out changes most: they do not add as squares.
    together: dict[str, tuple[str, ...]]
    seeds: tuple[int, ...]


def sensitivity(
    scenario: Scenario,
    seeds: int | Sequence[int] = 1,
    progress: Progress = silent,
    compute: Compute | None = None,
) -> Sensitivity:
    """Run a scenario without nuisances, with each alone, and with all; figures are rms over the seeds.

    Where the single errors do not sum up to the whole, each nuisance is also left out in turn.

    Raises
    ------
    InputError
        If the scenario is no line of stages, has no nuisance, or is refused by the program without any of them.
    """
    if scenario.kind != "line":
        raise InputError(f"The scenario {scenario.name} has no nuisances. Give one that runs the whole line.")
    names, numbers = scenario.active, seed_numbers(scenario, seeds)
    if not names:
        raise InputError(f"No nuisance of the scenario {scenario.name} is on. Give one with nuisances, such as small.")

    def measure(label: str, chosen: str | tuple[str, ...]) -> tuple[Values, str | None]:
        """Return the rms of each figure over the seeds, and the first refusal."""
        entries: list[Entry] = []
        for seed in numbers:
            progress("sensitivity", f"{label}, seed {seed}")
            entries.append(run_specimen(scenario, scenario.params(seed, chosen), seed, compute=compute))
        figures = {
            name: rms(np.array([entry.values.get(name) for entry in entries], dtype=np.float64))
            for name in {name for entry in entries for name in entry.values}
        }
        return figures, next((entry.refusal for entry in entries if entry.refusal is not None), None)

    base, refusal = measure("no nuisance", NONE)
    if refusal is not None:
        raise InputError(f"The scenario {scenario.name} does not even come through without nuisances: {refusal}")
    candidates = {stage: [name for name in names if base.get(name) is not None] for stage, names in KEYS.items()}
    keys = {stage: names[0] for stage, names in candidates.items() if names}
    quiet = {stage: value for stage, name in keys.items() if (value := base[name]) is not None}
    rows = [make_row(name, keys, quiet, *measure(f"{NUISANCES[name].title} alone", (name,))) for name in names]
    # All that are on: scenario.nuisances may be a list.
    all_on, _ = measure("all together", scenario.nuisances if scenario.nuisances != NONE else ALL)
    loud = {stage: all_on.get(name) for stage, name in keys.items()}
    ratio = {stage: _ratio(stage, keys, quiet, loud, rows) for stage in keys}
    off = [stage for stage, value in ratio.items() if value is not None and not 1 / _AGREES <= value <= _AGREES]
    together: dict[str, tuple[str, ...]] = {}
    if off and len(names) > 1:
        less = {
            name: measure(f"all but {NUISANCES[name].title}", tuple(other for other in names if other != name))[0]
            for name in names
        }
        together = {stage: _most_changing(loud[stage] or 0.0, keys[stage], less) for stage in off}
    return Sensitivity(
        keys=keys, quiet=quiet, loud=loud, rows=tuple(rows), ratio=ratio, together=together, seeds=tuple(numbers)
    )


def _most_changing(error: float, key: str, less: dict[str, Values]) -> tuple[str, ...]:
    """Name the two nuisances without which a key figure's error changes most; a missing one changes nothing."""
    errors = {name: figures.get(key) for name, figures in less.items()}
    changes = {name: 0.0 if e is None else abs(error**2 - e**2) for name, e in errors.items()}
    return tuple(sorted(changes, key=lambda name: -changes[name])[:2])


def make_row(name: str, keys: dict[str, str], quiet: dict[str, float], figures: Values, refusal: str | None) -> Row:
    """Give the error that a nuisance adds to every stage, and the stage where it comes in.

    Errors are carried along the line: the stage that suffers is the first one that grows at least half as much,
    relative to its own baseline, as the one that grows most.
    """
    added = {stage: added_error(figures.get(key), quiet[stage]) for stage, key in keys.items()}
    growth = {
        stage: value / max(quiet[stage], _FLOOR[FIGURES[keys[stage]].unit])
        for stage, value in added.items()
        if value is not None
    }
    most = max(growth.values(), default=0.0)
    suffers = next((stage for stage, value in growth.items() if value >= _CARRIED * most), None)
    suffers = suffers if most >= _NOTICED else None
    return Row(nuisance=name, added=added, growth=growth, suffers=suffers, refusal=refusal)


def added_error(error: float | None, base: float) -> float | None:
    """Give the error that adds to ``base`` in squares to make ``error``; 0 where that is not larger."""
    return None if error is None else float(np.sqrt(max(0.0, error**2 - base**2)))


def _ratio(
    stage: str, keys: dict[str, str], quiet: dict[str, float], loud: Values, rows: Sequence[Row]
) -> float | None:
    """Sum of squares over the whole; None where both stay below the floor or half of the baseline."""
    whole = added_error(loud[stage], quiet[stage])
    summed = float(np.sqrt(sum((row.added[stage] or 0.0) ** 2 for row in rows)))
    least = max(_FLOOR[FIGURES[keys[stage]].unit], _WORTH * quiet[stage])
    if whole is None or max(whole, summed) < least:
        return None
    return summed / whole if whole > 0 else float("inf")
