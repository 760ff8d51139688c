"""Which map of a layer leads: r is said of it, and the page shows it first."""

from collections.abc import Container

import xarray as xr

from planish.analyze.compare import maps_to_correlate
from planish.core.axial import refuse_axial
from planish.core.bands import any_finite
from planish.core.errors import InputError
from planish.core.facts import Side


def leading_map(maps: xr.Dataset, side: Side = "top", declared: str | None = None) -> str:
    """Name the map that leads: an image itself, what the study declares, coating or thickness.

    Parameters
    ----------
    maps : Dataset (y, x)
        Maps of a sheet, or an image.
    side : {"top", "bottom"}
        Side of the sheet that is seen: its coating leads where it was measured anywhere.
    declared : str, optional
        Map of a sheet that the study names.

    Raises
    ------
    InputError
        If the study declares a map that the sheet does not have, or angles of an axis.
    """
    if "thickness" not in maps:
        return "image"
    if declared is not None:
        if declared not in maps:
            raise InputError(
                f"The sheet has no map {declared!r} to lead. It has"
                f" {', '.join(maps_to_correlate(maps))}."
            )
        refuse_axial(maps[declared])
        return declared
    coating = f"coating_{side}"
    if coating in maps and any_finite(maps[coating]):
        return coating
    return "thickness"


def leading_pair(
    headline: str, fixed_headline: str, maps: Container[str], fixed_maps: Container[str]
) -> tuple[str, str]:
    """Name the maps by which two layers are compared: those that lead.

    Of two sheets, one of them that both have.
    """
    for name in (headline, fixed_headline):
        if name in maps and name in fixed_maps:
            return name, name
    return headline, fixed_headline
