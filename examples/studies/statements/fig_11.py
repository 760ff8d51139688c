"""Fig. 11 and 12: how far micro-CT and serial sections measure the same coating."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from planish.core.area import area_mean

from .common import draw_map, interval, one_run, pitch


def state(folder: Path, figure: Figure) -> str:
    """Compare the coating thickness of one field by two instruments."""
    run = one_run(folder)
    row = [one for one in run.results.correlations if one.a_map == one.b_map == "coating_top"][-1]
    first, second = (run.groups[f"layers/{name}"] for name in (row.a, row.b))
    both = first.valid.values & second.valid.values
    a, b = (np.where(both, maps.coating_top.values, np.nan) for maps in (first, second))

    axes = figure.subplots(1, 3, width_ratios=(1, 1, 0.9))
    for ax, values, name in zip(axes, (a, b), (row.a, row.b), strict=False):
        draw_map(ax, first, values, low=0.0)
        ax.set(title=name, xlabel="x / mm")
    axes[0].set_ylabel("y / mm")
    factor = [row.point_um / p for p in pitch(first)]
    x, y = (area_mean(values, factor).ravel() for values in (a, b))
    axes[2].plot(x, y, ".", markersize=1, alpha=0.3)
    axes[2].axline((0, 0), slope=1, color="grey", linewidth=0.8)
    axes[2].set(
        title=f"r = {row.r:.2f}", xlabel=f"{row.a} / µm", ylabel=f"{row.b} / µm", aspect="equal"
    )

    agreement = run.results.evidence[0].agreement
    truth = Path(run.study.layers[0].volume.path).parent / "truth"
    truth_text = ""
    if truth.is_dir():
        truth_text = " Both measured one sheet: the true r is 1, the true difference 0 um."
    declared = len(run.results.regions.regions) if run.results.regions else 0
    left_out = (
        f" Left out beside the holes: {declared} declared region{'s' * (declared > 1)}."
        if declared
        else ""
    )
    return (
        f"r = {row.r:.3f} (95 % interval {interval(row.interval, 3)}) over {row.n} points of"
        f" {row.point_um:.0f} um, {row.n_eff:.0f} of them independent. {row.b} less {row.a}:"
        f" {agreement.bias:+.2f} um (95 % interval {interval(agreement.bias_interval)}); limits of"
        f" agreement {interval(agreement.limits, 1)} um (the lower one"
        f" {interval(agreement.limit_intervals[0], 1)}, the upper one"
        f" {interval(agreement.limit_intervals[1], 1)}). {agreement.sentence or ''}{truth_text}"
        f"{left_out}"
    )
