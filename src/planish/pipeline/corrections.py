"""Corrections of the faces in a run: read once, taken from the surfaces that have them, written beside them."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from planish.core.options import Params
from planish.study import LayerParams
from planish.surface import read_corrections

CORRECTIONS = "edits/surface.json"
"""Name of the file of a run that holds them."""


def asked_corrections(layer: LayerParams) -> str:
    """Text of the corrections that a study asks for; empty where it asks for none.

    Raises
    ------
    FileError
        If the file cannot be read, or holds something else.
    """
    if layer.surface.corrections is None:
        return ""
    corrections = read_corrections(layer.surface.corrections)
    return corrections.to_json() if corrections.stretches else ""


def made_corrections(surfaces: xr.Dataset) -> str:
    """Text of the corrections that surfaces have; empty where they are as they were found."""
    return str(surfaces.attrs.get("corrections", ""))


def uncorrected_params(params: Params) -> Params:
    """Parameters of the search without its corrections."""
    return params.model_copy(update={"corrections": None})


def write_corrections(surfaces: xr.Dataset, folder: Path) -> str | None:
    """Write the corrections of surfaces into a run folder; the name of the file, None where there are none."""
    text = made_corrections(surfaces)
    if not text:
        return None
    path = folder / CORRECTIONS
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8", newline="\n")
    return CORRECTIONS
