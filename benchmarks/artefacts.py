"""Which artefact of an instrument costs how much: each alone, none and all, for the default search and for ``paper``.

``python -m benchmarks artefacts [faces-ct|faces-sections] [seed] [width,height in um]``

The specimens are those of the scenarios; only the volume is written, read and mapped. ``paper`` is the way of Hirn et
al. (2009): a threshold in every slice, no model of the blur.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from planish.core.errors import PlanishError
from planish.run import map_sheet
from planish.run.study import Study
from planish.synthetic import make_specimen, write_instruments
from planish.synthetic.params import SpecimenParams
from planish.synthetic.presets import NUISANCES
from planish.validate.certify import make_ledger
from planish.validate.scenario import ALL, NONE, Scenario, Values, read_scenario
from planish.validate.truth import Comparison

_MODES = ("profile", "paper")
_FACES = ("top", "interface_top", "interface_bottom", "bottom")
_FIGURES = {
    "top": "top_rmse", "int. top": "interface_top_rmse", "int. bot.": "interface_bottom_rmse", "bottom": "bottom_rmse",
    "coat bias": "column_coating_top_bias", "coat rms": "column_coating_top_rmse", "found %": "found_share",
    "x jitter": "sections_x_jitter", "z jitter": "sections_z_jitter",
}  # fmt: skip


def main(name: str = "", seed: int = 0, size: str = "1200,900") -> int:
    """Print a table an instrument."""
    for which in [name] if name else ["faces-ct", "faces-sections"]:
        width, height = map(float, size.split(","))
        whole = read_scenario(which)
        # A smaller field than the scenario's has room for fewer holes.
        specimen = whole.specimen | {"holes": {"pattern": "irregular", "count": 2}}
        scenario = whole.model_copy(update={"size": (width, height), "specimen": specimen})
        table(scenario, seed)
    return 0


def table(scenario: Scenario, seed: int) -> None:
    """Print one row for none, each artefact of the instrument alone, and all of them; both modes side by side."""
    own = [n for n in scenario.active if NUISANCES[n].section == scenario.instrument]
    figures = {k: v for k, v in _FIGURES.items() if "jitter" not in k or scenario.instrument == "sections"}
    print(f"{scenario.title}; um, rms against the truth; {scenario.size[0]:g} x {scenario.size[1]:g} um, seed {seed}")
    print(f"{'':34s}" + " | ".join("".join(f"{k:>10s}" for k in figures) for _ in _MODES))
    print(f"{'':34s}" + " | ".join(f"{m:^{10 * len(figures)}s}" for m in _MODES))
    paper = [n for n in scenario.active if NUISANCES[n].section in ("paper", "holes", "warp")]
    rows = [("paper and holes only", tuple(paper))]
    rows += [(NUISANCES[n].title, (*paper, n)) for n in own] + [("all together", ALL)]
    for title, chosen in [("nothing, not even in the paper", NONE), *rows]:
        found = measure(scenario, scenario.params(seed, chosen), seed)
        print(f"{title:34s}" + " | ".join(cells(values, list(figures.values())) for values in found), flush=True)


def measure(scenario: Scenario, params: SpecimenParams, seed: int) -> list[Values | str]:
    """Errors of both modes on one specimen; a sentence where the program refuses."""
    with tempfile.TemporaryDirectory(prefix="artefacts-") as folder:
        specimen = make_specimen(replace(params, seed=seed))
        made = write_instruments(specimen, Path(folder) / "specimen", volume=scenario.instrument, image=False)
        found = []
        for mode in _MODES:
            volume = {"path": str(made.volume), "through": made.through}
            try:
                run = map_sheet(Study.model_validate({"volume": volume, "surface": {"method": mode}}))
                found.append(make_ledger(Comparison(specimen, made, run)))
            except PlanishError as error:
                found.append(f"refused: {error}")
        return found


def cells(values: Values | str, names: list[str]) -> str:
    """One mode's part of a row."""
    width = 10 * len(names)
    if isinstance(values, str):
        return f"{values[: width - 2]:>{width}s}"
    return "".join(f"{'-' if (v := values.get(n)) is None else f'{v:.2f}':>10s}" for n in names)
