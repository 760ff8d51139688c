"""The discussion: how much larger r² is when the sheet is flattened, and not projected."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from planish.analyze import Fields, difference_of_pooled_r
from planish.series_results import SeriesResults

from .common import interval, runs_of
from .truth import sentence

OWN = "own"
WAYS = {
    "projection, no scale": "projection",
    "projection, similarity": "projection, scaled",
    "flattened, similarity": "flattened",
    OWN: "flattened, own model",
}
"""Registrations of a run's comparison, and what the figure calls them; the last row of a run is of
its own model."""


def state(folder: Path, figure: Figure) -> str:
    """Compare the same points, marks and image, registered in four ways."""
    series, runs = SeriesResults.read(folder / "results.json"), runs_of(folder)
    sheet = {
        one.member.name: one.member.factors.get("sheet", one.member.name)
        for one in series.specimens
    }
    rows = {
        name: [
            next(r for r in reversed(run.results.comparison) if way in (OWN, r.registration))
            for way in WAYS
        ]
        for name, run in runs.items()
    }
    projected, scaled, _, own = (
        Fields([of[k].r for of in rows.values()], [sheet[n] for n in rows]) for k in range(4)
    )

    ax = figure.subplots()
    for name, of in rows.items():
        ax.plot(
            [r.r2 for r in of],
            "o-",
            label=f"{name}: marks {', '.join(f'{r.marks_rms_um:.0f}' for r in of)} µm",
        )
    ax.set_xticks(range(len(WAYS)), list(WAYS.values()))
    ax.set(title="The same points, marks and image", ylabel="r² at 100 µm")
    ax.set_ylim(0)
    ax.legend(frameon=False)
    text = [
        f"{way}: {_gain(fields, own)}"
        for way, fields in (("Projection", projected), ("Scaled projection", scaled))
    ]
    name, alone = next((name, of[1]) for name, of in rows.items())
    text.append(
        f"On {name} alone, flattening changes r of the scaled projection by {alone.difference:+.3f}"
        f" (95 % interval {interval(alone.difference_interval, 3)})"
    )
    return (
        f"Over {len({sheet[n] for n in rows})} sheets. {'. '.join(text)}.{sentence(runs.values())}"
    )


def _gain(before: Fields, after: Fields) -> str:
    """Mean r² before and after, by Fisher's z, and the interval of the difference over sheets."""
    found = difference_of_pooled_r(before, after, paired=True, squared=True)
    low, high = (
        math.tanh(float(np.mean(np.arctanh(fields.values)))) ** 2 for fields in (before, after)
    )
    reason = f", because {found.reason}" if found.reason else ""
    return (
        f"r² {low:.3f}, flattened {high:.3f} ({high / low:.1f} times), difference {high - low:+.3f}"
        f" (95 % interval {interval(found.interval, 3)}{reason})"
    )
