"""How many sheets a study needs to distinguish r² 0.26 from 0.21, in fields like those of Fig.

7.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from planish.analyze import random_effects, sheets_needed
from planish.analyze.study_power import power_of_study
from planish.series_results import SeriesResults

from .common import fields_of

R2 = (0.26, 0.21)
BETWEEN, CHANGE, SHARED = (0.05, 0.15), 0.05, 0.5
"""What a design has to assume: by how much z varies between sheets; by how much its change by a
treatment does; how much of the scatter of z is the same before and after."""
LEAST_POINTS = 4  # independent points of a field whose z has a standard error


def state(folder: Path, figure: Figure) -> str:
    """Sheets for a power of 0.8, with as many independent points a field as the series of Fig.

    7 had.
    """
    series = SeriesResults.read(folder / "results.json")
    r, n_eff = fields_of(series, lambda _: True)
    use = np.array(n_eff) > LEAST_POINTS
    points = float(np.median(np.array(n_eff)[use]))
    found = random_effects(np.arctanh(r.values)[use], 1 / (np.array(n_eff)[use] - 3))
    counts = np.unique(np.geomspace(3, 100, 40).astype(int))
    ax, text = figure.subplots(), list[str]()
    designs = [(paired, fields) for paired in (True, False) for fields in (1, 3)]
    for colour, (paired, fields) in enumerate(designs):
        label = (
            f"{'same sheets' if paired else 'two papers'}, {fields} field{'s' * (fields > 1)} a"
            " sheet"
        )
        more = {"change_between_sheets": CHANGE, "shared": SHARED} if paired else {}
        needed: list[str] = []
        for between, style in zip(BETWEEN, ("-", "--"), strict=True):
            given = {
                "fields": fields,
                "n_eff": points,
                "between_sheets": between,
                "paired": paired,
                **more,
            }
            needed.append(str(sheets_needed(R2, **given).sheets))
            power = [power_of_study(R2, sheets=int(k), **given).power for k in counts]
            ax.plot(
                counts, power, style, color=f"C{colour}", label=f"{label}, z varies by {between}"
            )
        text.append(f"{label} {' or '.join(needed)}")
    ax.axhline(0.8, color="grey", linewidth=0.8)
    ax.set(
        title=f"r² {R2[0]} against {R2[1]}; {points:.0f} independent points a field",
        xlabel="sheets",
        ylabel="power",
    )
    ax.set_xscale("log")
    ax.set_xticks(ticks := [3, 5, 10, 20, 50, 100], [str(k) for k in ticks])
    ax.legend(frameon=False, fontsize=7, loc="upper left")
    return (
        f"To distinguish r² {R2[0]} from {R2[1]} with a power of 0.8 in fields of {points:.0f}"
        f" independent points takes so many sheets (of each paper), where z varies by {BETWEEN[0]}"
        f" or {BETWEEN[1]} between sheets: {'; '.join(text)}. In this series z varied by"
        f" {math.sqrt(found.between):.2f} between its {int(use.sum())} fields, which are too few to"
        " state it well."
    )
