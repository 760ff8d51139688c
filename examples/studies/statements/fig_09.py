"""Fig. 9 and 10: how much lighter a print is where the coating is thicker."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

import planish as pl

from .common import cloud, draw_map, explained, interval, known, levelled, of_image, one_run
from .truth import sentence


def state(folder: Path, figure: Figure) -> str:
    """Correlate the coating with the print, whose screen was taken off."""
    run = one_run(folder)
    row, linked = of_image(run), run.groups["linked"]
    maps, right = figure.subplots(1, 2)
    draw_map(maps, linked, known(linked, "image"))
    maps.set(title="Print without its screen, away from holes", xlabel="x / mm", ylabel="y / mm")
    cloud(right, run, "")
    right.set(
        title=f"r² = {row.r2:.2f}", xlabel="coating thickness / µm", ylabel="grey of the print"
    )
    return (
        f"r = {row.r:.2f} (95 % interval {interval(row.interval)}), r² = {row.r2:.2f} over {row.n}"
        f" points of {row.point_um:g} um, {row.n_eff:.0f} of them independent.{_mottle(run)}"
        f"{explained({'print': run})}{levelled({'print': run})}{sentence([run])}"
    )


def _mottle(run: pl.Run) -> str:
    """In which octave of wavelength the print is most uneven."""
    bands = [band for one in run.results.mottle for band in one.bands]
    if not bands:
        why = "; ".join(one.reason for one in run.results.mottle if one.reason)
        return (
            " How uneven the print is, is stated for no octave of"
            f" wavelength{f': {why}' if why else ''}."
        )
    most = max(bands, key=lambda band: band.coefficient_of_variation)
    return (
        f" The print is most uneven in waves of {most.shortest_um:.0f} to {most.longest_um:.0f} um "
        f"(coefficient of variation {100 * most.coefficient_of_variation:.1f} %)."
    )
