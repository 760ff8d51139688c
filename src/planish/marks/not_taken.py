"""What was seen in an image and not taken for a hole: counted by reason, and said in a sentence."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.checks import CORRELATION, POSITION, PROPERTIES, Check
from planish.marks import judge
from planish.marks.candidates import Floats

# Reasons in the order of a sentence, and their words.
REASONS = {
    "not_measured": "not measured",
    "cut": "cut by the border",
    "too_small": "too small",
    "too_large": "too large",
    "too_faint": "too faint",
    "not_round": "not round or not closed",
    "no_rim": "without a sharp rim",
    "unlike": "unlike the other holes",
}

# Of all openings: so many that are not round are no single holes that are half closed.
MANY = 0.25


def count_not_taken(
    seen: Floats, taken: Floats, faults: judge.Faults, whole: NDArray[np.bool_], dropped: int
) -> dict[str, int]:
    """Count by reason what was measured (rows of `measure`, with its faults and whether the image holds all of it).

    Only what lies on no hole that was taken, and would be one but for a single fault: mottle has several. Of marks that
    overlap the one with the best rim counts.
    """
    # A border that cuts a mark takes a part of its rim, too.
    good = {name: good | ((name == "not_round") & ~whole) for name, good in faults.items()}
    near = np.sum([whole, *good.values()], axis=0) >= len(faults)
    rows = np.flatnonzero(near & ~judge.on_any(seen, taken))
    rows = rows[judge.best_apart(seen[rows])]
    counts = dict.fromkeys(REASONS, 0) | {"not_measured": dropped}
    for row in rows.tolist():
        reason = next((name for name, fine in good.items() if not fine[row]), "unlike")
        counts[reason if whole[row] else "cut"] += 1
    return counts


def check_holes(holes: xr.Dataset) -> Check:
    """Say how many holes were found, and what was seen and not taken; a look where places were not measured.

    Parameters
    ----------
    holes : Dataset, dims (mark)
        Of :func:`planish.marks.find_holes` or :func:`planish.marks.find_sheet_holes`.
    """
    counts: dict[str, int] = holes.attrs.get("not_taken", {})
    listed = [f"{counts[name]} {words}" for name, words in REASONS.items() if counts.get(name)]
    count = holes.sizes["mark"]
    sentence = f"{count} {'hole' if count == 1 else 'holes'} found"
    sentence += f"; seen and not taken: {', '.join(listed)}." if listed else "."
    dropped, openings = counts.get("not_measured", 0), int(holes.attrs.get("openings", 0))
    advice = "More places look like holes than fit into the area. Give a closer range of diameters (--hole-um)."
    many = openings if openings > max(1, MANY * (count + openings)) else 0
    if openings:
        some = "1 opening as large as a hole is" if openings == 1 else f"{openings} openings as large as holes are"
        sentence += f" {some} not round enough for one."
    if many:
        advice = "Look at the maps there: a stretched or torn hole says that slices or voxel sizes are wrong."
    figures = (POSITION, PROPERTIES, CORRELATION) if many else (POSITION,)
    return Check.at_most("holes", dropped + many, look=0, sentence=sentence, figures=figures, advice=advice)
