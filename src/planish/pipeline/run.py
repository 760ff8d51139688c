"""What a run holds, and how it comes back from its folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import FileError
from planish.gates import Gate
from planish.io.run_folder import read_tree
from planish.study import LayersStudy, Study, read_study

Array = NDArray[np.float64]
Progress = Callable[[str, str], None]

_OF_A_MAP = ("surfaces", "flat", "strain", "maps", "slices")


def silent(_stage: str, _detail: str) -> None:
    """Say nothing: what a program that calls a run wants unless it asks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """All that a run gives.

    Attributes
    ----------
    study : Study
        The parameters, resolved.
    groups : dict of Dataset
        ``surfaces`` and ``flat`` (y, x), ``strain`` (row, col), ``maps`` (v, u), ``slices``, and after a link
        ``linked`` (y, x of the image).
    marks : Dataset (mark) or None
    results : dict
        Numbers only, ready for JSON.
    gates : tuple of Gate
    """

    study: Study
    groups: dict[str, xr.Dataset]
    marks: xr.Dataset | None
    results: dict[str, Any]
    gates: tuple[Gate, ...]

    @property
    def passed(self) -> bool:
        """Whether every quality gate was passed."""
        return all(gate.passed for gate in self.gates)


@dataclass(frozen=True, slots=True, kw_only=True)
class Layers:
    """All that linking several layers gives.

    Attributes
    ----------
    study : LayersStudy
        The parameters, resolved.
    groups : dict of Dataset (y, x)
        ``layers/NAME`` of every layer, all on the pixels of the reference.
    marks : dict of Dataset (mark)
        Pairs of marks of every layer but the reference.
    runs : dict of Run
        Layers that were mapped on the way.
    results : dict
        Numbers only, ready for JSON.
    gates : tuple of Gate
    """

    study: LayersStudy
    groups: dict[str, xr.Dataset]
    marks: dict[str, xr.Dataset]
    runs: dict[str, Run]
    results: dict[str, Any]
    gates: tuple[Gate, ...]

    @property
    def passed(self) -> bool:
        """Whether every quality gate was passed."""
        return all(gate.passed for gate in self.gates)


def is_run(path: Path) -> bool:
    """Whether a folder holds a run of one volume."""
    return (path / "run.toml").is_file() and (path / "maps.zarr").is_dir()


def read_run(path: Path) -> Run:
    """Read the maps of a run folder, as :func:`planish.pipeline.map_sheet` gave them; what was linked stays behind.

    Raises
    ------
    FileError
        If it is no run of a volume, or a file of it is missing or damaged.
    InputError
        If its study is of another version and has parameters that are not known.
    """
    if not is_run(path):
        raise FileError(f"{path} is no run. Give the folder that 'planish map' or 'planish link' made.")
    study = read_study(path / "run.toml")
    if not isinstance(study, Study):
        raise FileError(f"{path} holds several linked layers. Give the run of one volume, from 'planish map'.")
    groups = read_tree(path / "maps.zarr")
    missing = [name for name in _OF_A_MAP if name not in groups]
    if missing:
        raise FileError(f"{path / 'maps.zarr'} has no group {missing[0]}. It is damaged; repeat the run.")
    try:
        results: dict[str, Any] = json.loads((path / "results.json").read_text(encoding="utf-8"))
        inputs = {"volume": results["inputs"]["volume"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileError(f"{path / 'results.json'} cannot be read: {error}. Repeat the run.") from error
    kept = ("surfaces", "properties", "further", "numbers", "flatten", "sections")
    return Run(
        study=study.model_copy(update={"image": None}),
        groups={k: v for k, v in groups.items() if k in (*_OF_A_MAP, "sections")},
        marks=None,
        results={"planish": results["planish"], "versions": results.get("versions", {}), "inputs": inputs}
        | {k: results[k] for k in kept if k in results},
        gates=(),
    )
