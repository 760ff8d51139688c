"""From a volume to flattened maps of the properties of its sheet."""

from __future__ import annotations

from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from planish import __version__
from planish.compute import Compute, column_step, engine
from planish.core.errors import VolumeError
from planish.core.frame import Frame
from planish.core.grid import pitch
from planish.core.tiles import Engine
from planish.flatten import FlattenParams, flatten_sheet
from planish.gates import map_gates
from planish.io import find_place
from planish.measure import measure_properties, sheet_numbers
from planish.pipeline.run import Array, Progress, Run, silent
from planish.pipeline.volume import read_sheet_volume, some_slices
from planish.resample import resample_maps
from planish.results import (
    flatten_results,
    further_results,
    input_results,
    number_results,
    parameter_results,
    property_results,
    section_results,
    surface_results,
)
from planish.study import Study
from planish.surface import find_surfaces

_THICKNESS_UM = (2.0, 5000.0)  # from a thin tissue to a thick board, with room on both sides
_LEAST_SHARE = 0.15  # of the columns: with less there is no map


def map_sheet(
    study: Study, *, progress: Progress | None = None, compute: Compute | None = None, kept: Path | None = None
) -> Run:
    """Go from a volume to flattened maps of its properties.

    Parameters
    ----------
    study : Study
    progress : callable, optional
        Called with the name of a stage and a few words.
    compute : Compute, optional
        What the run may use.
    kept : Path, optional
        Folder for the results of single tiles, where a run that was killed finds them again.
    """
    tell = progress or silent
    tell("read", find_place(study.volume.path).path.name)
    compute = compute or Compute()
    volume, sections = read_sheet_volume(study.volume, compute, tell)
    voxel = tuple(float(v) for v in volume.attrs["voxel_um"])
    frame = Frame(through=study.volume.through, top=study.volume.top)
    step = column_step(volume, frame, study.volume.column_um, compute)
    wide = f", columns of {step} x {step}" if step > 1 else ""
    tell("surface", " x ".join(map(str, volume.shape)) + " voxels" + wide)
    with engine(compute, kept=None if kept is None else kept / str(step)) as tiles:
        surfaces = find_surfaces(volume, frame=frame, params=study.surface, step=step, engine=tiles)
    _check_thickness(surfaces)
    tell("measure", f"{surfaces.sizes['y'] * surfaces.sizes['x']} columns")
    found = surfaces
    tiles = Engine(threads=compute.threads, memory_bytes=compute.memory // 2)
    surfaces = measure_properties(found, volume=volume, params=study.properties, engine=tiles)
    numbers = sheet_numbers(surfaces, volume=volume, params=study.properties, engine=tiles)
    tell("flatten", "eight-spring mesh")
    f = study.flatten
    # A column whose normal meets no face still has its place in the sheet.
    flattened = flatten_sheet(found, params=FlattenParams(mesh_um=f.mesh_um, method=f.method, rest=f.rest))
    steps = pitch(surfaces)
    # Where single columns of voxels were measured without being asked for, nothing has to be repeated.
    column_um = study.volume.column_um or (float(np.sqrt(steps[0] * steps[1])) if step > 1 else None)
    map_um = study.flatten.map_um or float(np.sqrt(steps[0] * steps[1]))
    tell("resample", f"{map_um:.3g} um pixels")
    study = study.model_copy(
        update={
            "volume": study.volume.model_copy(update={"voxel_um": voxel, "column_um": column_um}),
            "flatten": study.flatten.model_copy(update={"mesh_um": flattened.mesh_um, "map_um": map_um}),
        }
    )
    maps = resample_maps(surfaces, flattened.flat, map_um=map_um)
    groups = {
        "surfaces": surfaces,
        "flat": flattened.flat,
        "strain": flattened.strain,
        "maps": maps,
        "slices": some_slices(volume, frame, step),
    }
    results: dict[str, Any] = {
        "planish": __version__,
        "versions": {name: version(name) for name in ("numpy", "scipy", "numba", "xarray", "zarr", "tifffile")},
        "inputs": {"volume": input_results(volume, Path(study.volume.path), voxel_um=list(voxel))},
        "surfaces": surface_results(surfaces),
        "properties": property_results(surfaces),
        "further": further_results(surfaces),
        "numbers": number_results(numbers),
        "flatten": flatten_results(flattened),
    }
    if sections is not None:
        groups["sections"] = sections
        results["sections"] = section_results(sections)
    gates = map_gates(results)
    results["quality"] = [asdict(gate) for gate in gates]
    results["parameters"] = parameter_results(study)
    return Run(study=study, groups=groups, marks=None, results=results, gates=gates)


def _check_thickness(surfaces: xr.Dataset) -> None:
    thickness = float(surfaces.attrs["thickness_um"])
    low, high = _THICKNESS_UM
    if not low <= thickness <= high:
        voxel = ", ".join(f"{v:g}" for v in surfaces.attrs["voxel_um"])
        raise VolumeError(
            f"The sheet would be {thickness:.3g} um thick; paper and board have {low:g} to {high:g} um. "
            f"The voxel size of "
            f"{voxel} um (z, y, x) is probably in another unit. Give the right one with --voxel-um and --override-size."
        )
    measured = float((surfaces["status"].values == 0).mean())
    if measured < _LEAST_SHARE:
        raise VolumeError(
            f"Both faces of the sheet were found in {100 * measured:.1f} % of the columns only; "
            f"{100 * _LEAST_SHARE:.0f} % are "
            "needed for a map. Check --through and --sheet-grey, and that the sheet does not leave the volume."
        )


def uv(flat: xr.Dataset, names: tuple[str, str] = ("u", "v")) -> Array:
    """Flat coordinates of the columns, (rows, cols, 2)."""
    return np.stack([flat[n].values for n in names], axis=-1)
