"""From a volume to flattened maps of the properties of its sheet."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import xarray as xr

from planish.checks import MeasuredSheet, check_scan, run_checks
from planish.compute import Compute, Progress, column_step, engine, silent
from planish.core.errors import CannotMeasure
from planish.core.frame import Frame, other_axis
from planish.core.grid import pitch
from planish.core.options import Params
from planish.core.tiles import Engine
from planish.flatten import flatten_sheet
from planish.io import find_place
from planish.measure import measure_properties, sheet_numbers, surfaces_of
from planish.pipeline.corrections import asked_corrections, made_corrections
from planish.pipeline.facts import input_file, property_facts, section_facts, surface_facts
from planish.pipeline.layers import Layer
from planish.pipeline.volume import read_sheet_volume, some_slices
from planish.resample import resample_maps
from planish.results import SheetFacts
from planish.study import LayerParams
from planish.surface import Corrections, correct_surfaces, find_surfaces

P = TypeVar("P", bound=Params)


def map_layer(
    layer: LayerParams, *, compute: Compute, progress: Progress, kept: Path | None = None, before: Layer | None = None
) -> Layer:  # fmt: skip
    """Go from a volume to flattened maps of its properties.

    ``kept`` is the folder for the results of single tiles, where a run that was killed finds them again. ``before`` is
    a sheet of the same volume with the same surface but for corrections: only what other parameters change is done
    anew, and only the tiles that a correction touches are searched again.
    """
    v = layer.volume
    assert v is not None
    wanted = asked_corrections(layer)
    as_before = before is not None and made_corrections(before.groups["surfaces"]) == wanted
    measured_before = before is not None and as_before and before.params.properties == layer.properties
    volume = sections = None
    if not measured_before:
        progress("read", find_place(v.path).path.name)
        volume, sections = read_sheet_volume(v, compute, progress)
    tiles = Engine(threads=compute.threads, memory_bytes=compute.for_work // 2)
    if before is not None:
        surfaces = surfaces_of(before.groups["surfaces"])
        sections = before.groups.get("sections")
        if not as_before:
            assert volume is not None
            progress("surface", "corrections")
            corrections = Corrections.model_validate_json(wanted) if wanted else Corrections()
            surfaces = correct_surfaces(surfaces, volume, corrections, params=layer.surface, engine=tiles)
    else:
        assert volume is not None
        surfaces = search_sheet(volume, layer, compute=compute, progress=progress, kept=kept)
    if before is not None and measured_before:
        measured = before.groups["surfaces"]
    else:
        progress("measure", f"{surfaces.sizes['y'] * surfaces.sizes['x']} columns")
        try:
            measured = measure_properties(surfaces, volume=volume, params=layer.properties, engine=tiles)
        except CannotMeasure as error:
            hint = "" if volume is None else other_axis(volume, v.through)
            if hint:
                raise CannotMeasure(f"{error.text} {hint}") from error
            raise
    progress("flatten", "eight-spring mesh")
    # Before the properties: a column whose normal meets no face still has its place in the sheet.
    flattened = flatten_sheet(surfaces, params=layer.flatten)
    columns = pitch(surfaces)
    map_um = layer.flatten.map_um or float(np.sqrt(columns[0] * columns[1]))
    progress("resample", f"{map_um:.3g} um pixels")
    maps = resample_maps(measured, flattened.flat, map_um=map_um)
    groups = {"surfaces": measured, "flat": flattened.flat, "strain": flattened.strain, "maps": maps}
    if sections is not None:
        groups["sections"] = sections
    params = changed(layer, flatten=changed(layer.flatten, mesh_um=flattened.mesh_um, map_um=map_um))
    seen: dict[str, Any] = {
        "surfaces": surface_facts(measured), "properties": property_facts(measured),
        "flatten": flattened.saved, "sections": None if sections is None else section_facts(sections),
    }  # fmt: skip
    md_deg = v.md_deg if layer.md_deg is None else layer.md_deg
    if volume is None:
        assert before is not None
        assert before.facts is not None
        seen["properties"] = {
            name: seen["properties"][name] for name in before.facts.properties
        }  # a store has no order
        facts = SheetFacts(numbers=before.facts.numbers, **seen)
        checks = run_checks(MeasuredSheet(facts, measured))
        names = {check.name for check in checks}
        same = {k: v for k, v in before.unchanged.items() if k in ("surfaces", "slices", "sections")}
        return Layer(
            params=params, source=before.source, groups=groups | {"slices": before.groups["slices"]}, facts=facts,
            unchanged=same,
            checks=(*checks, *(check for check in before.checks if check.name not in names)), md_deg=md_deg,
        )  # fmt: skip
    frame = Frame(through=v.through, top=v.top)
    step = column_step(volume, frame, v.column_um, compute)
    groups["slices"] = some_slices(volume, frame, step)
    # Where single columns of voxels were measured without being asked for, nothing has to be repeated.
    wider = {"column_um": float(np.sqrt(columns[0] * columns[1]))} if step > 1 and v.column_um is None else {}
    sizes = changed(v, voxel_um=tuple(float(s) for s in volume.attrs["voxel_um"]), **wider)
    progress("check", "slices, grey, layers")
    labels = layer.surface.labels is not None
    scan = check_scan(volume, measured, sections=sections is not None, labels=labels, threads=compute.threads)
    numbers = sheet_numbers(measured, volume=volume, params=layer.properties, engine=tiles)
    facts = SheetFacts(numbers=numbers, **seen)
    return Layer(
        params=changed(params, volume=sizes), source=input_file(volume, v.path), groups=groups, facts=facts,
        checks=(*run_checks(MeasuredSheet(facts, measured)), *scan), md_deg=md_deg,
    )  # fmt: skip


def search_sheet(
    volume: xr.DataArray, layer: LayerParams, *, compute: Compute, progress: Progress = silent, kept: Path | None = None
) -> xr.Dataset:
    """Find the surfaces of a sheet.

    Raises
    ------
    VolumeError
        As :func:`planish.find_surfaces`.
    """
    v = layer.volume
    assert v is not None
    frame = Frame(through=v.through, top=v.top)
    step = column_step(volume, frame, v.column_um, compute)
    wide = f", columns of {step} x {step}" if step > 1 else ""
    progress("surface", " x ".join(map(str, volume.shape)) + " voxels" + wide)
    with engine(compute, kept=None if kept is None else kept / str(step)) as tiles:
        return find_surfaces(
            volume, frame=frame, params=layer.surface, step=step, engine=tiles, unusual_size=v.unusual_size
        )


def changed(params: P, **values: object) -> P:
    """The same parameters with some values changed."""
    return params.model_copy(update=values)
