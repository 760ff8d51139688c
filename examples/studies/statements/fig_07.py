"""Fig. 7 and 8: what calendering changes of r² of coating and brightness, over the same sheets."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

import planish as pl
from planish.analyze import difference_of_pooled_r, pooled_r
from planish.series_results import SeriesResults

from .common import cloud, explained, fields_of, interval, levelled, runs_of
from .truth import sentence

VERDICT = {None: "no verdict", True: "they differ", False: "they are not distinguishable"}


def state(folder: Path, figure: Figure) -> str:
    """Compare r² of two treatments of the same sheets."""
    series, runs = SeriesResults.read(folder / "results.json"), runs_of(folder)
    levels = list(dict.fromkeys(one.member.factors["treatment"] for one in series.specimens))
    each = [
        fields_of(series, lambda one, k=k: one.member.factors["treatment"] == k) for k in levels
    ]
    of_r2 = difference_of_pooled_r(each[0][0], each[1][0], paired=True, squared=True)
    of_r = difference_of_pooled_r(each[0][0], each[1][0], paired=True)
    pooled = [pooled_r(*one) for one in each]

    of_level = {level: _by_sheet(series, runs, level) for level in levels}
    for k, ax in enumerate(figure.subplots(1, 2, sharex=True, sharey=True)):
        for sheet, run in of_level[levels[k]].items():
            cloud(ax, run, f"sheet {sheet}")
        ax.set(
            title=f"{levels[k].capitalize()}: r² = {pooled[k].mean ** 2:.2f}",
            xlabel="coating thickness / µm",
        )
        ax.set_ylabel("brightness" if k == 0 else "")
        ax.legend(frameon=False, markerscale=3)
    each_says = " and ".join(
        f"{one.mean**2:.2f} {level} (r {one.mean:.2f}, 95 % interval {interval(one.interval)})"
        for one, level in zip(pooled, levels, strict=True)
    )
    models: list[str] = []
    for level in levels:
        model_text = explained(of_level[level])
        if model_text:
            models.append(f" {level.capitalize()}:{model_text}{levelled(of_level[level])}")
    losses = [sentence(of_level[level].values(), f", {level}") for level in levels]
    return (
        f"r² is {each_says} over {of_r2.sheets[0]} sheets. Its difference is"
        f" {of_r2.difference:+.3f} (95 % interval {interval(of_r2.interval, 3)}), that of r"
        f" {of_r.difference:+.3f} ({interval(of_r.interval, 3)}):"
        f" {VERDICT[of_r2.distinguishable]}{f' ({of_r2.reason})' if of_r2.reason else ''}. In 80 %"
        f" of cases, such a study finds a difference of r² of {of_r2.smallest_seen():.3f}."
        f"{''.join(models)}{''.join(losses)}"
    )


def _by_sheet(series: SeriesResults, runs: dict[str, pl.Run], level: str) -> dict[str, pl.Run]:
    """The runs of one treatment, by their sheets."""
    return {
        one.member.factors["sheet"]: runs[one.member.name]
        for one in series.specimens
        if one.member.factors["treatment"] == level and one.member.name in runs
    }
