"""Marks of an image that are rejected as holes: counted by reason, and reported in a sentence."""

from __future__ import annotations

import numpy as np
import xarray as xr

from planish.core.checks import CORRELATION, POSITION, PROPERTIES, Check
from planish.core.typing import Bools, Floats
from planish.marks.hole_criteria import Criteria, best_rims, overlaps_any

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
MANY_OPENINGS = 0.25


def count_rejected(
    measured: Floats, holes: Floats, criteria: Criteria, is_whole: Bools, dropped: int
) -> dict[str, int]:
    """Count by reason what was measured (rows of `measure`, with the criteria they meet; whether the image holds all).

    Only what lies on none of the holes, and would be one but for a single fault: mottle has several. Of marks that
    overlap the one with the best rim counts.
    """
    # A border that cuts a mark takes a part of its rim, too.
    met = {name: met | ((name == "not_round") & ~is_whole) for name, met in criteria.items()}
    is_near = np.sum([is_whole, *met.values()], axis=0) >= len(criteria)
    rows = np.flatnonzero(is_near & ~overlaps_any(measured, holes))
    rows = rows[best_rims(measured[rows])]
    counts = dict.fromkeys(REASONS, 0) | {"not_measured": dropped}
    for row in rows.tolist():
        reason = next((name for name, is_met in met.items() if not is_met[row]), "unlike")
        counts[reason if is_whole[row] else "cut"] += 1
    return counts


def check_holes(holes: xr.Dataset) -> Check:
    """Check how many holes were found and what was rejected; a look where places were not measured.

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
    many = openings if openings > max(1, MANY_OPENINGS * (count + openings)) else 0
    if openings:
        subject = "1 opening as large as a hole is" if openings == 1 else f"{openings} openings as large as holes are"
        sentence += f" {subject} not round enough for one."
    if many:
        advice = "Look at the maps there: a stretched or torn hole says that slices or voxel sizes are wrong."
    figures = (POSITION, PROPERTIES, CORRELATION) if many else (POSITION,)
    return Check.at_most("holes", dropped + many, look=0, sentence=sentence, figures=figures, advice=advice)
