"""From a volume to flattened maps of the properties of its sheet."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from planish.checks import MeasuredSheet, check_scan, run_checks
from planish.core.checks import Check
from planish.core.errors import CannotMeasure
from planish.core.frame import other_axis
from planish.core.grid import pitch
from planish.core.threads import thread_pool
from planish.core.tiles import Engine
from planish.flatten import flatten_sheet
from planish.io import VolumeParams, find_place
from planish.io.sizes import VOXEL, with_advice
from planish.measure import measure_properties, sheet_numbers, surfaces_of
from planish.resample import resample_maps
from planish.results import SheetFacts, SheetNumbers
from planish.run.compute import Compute, Progress, column_step, engine, silent
from planish.run.facts import input_file, property_facts, section_facts, surface_facts
from planish.run.layers import MappedLayer
from planish.run.study import GivenLayer, changed
from planish.run.volume import read_sheet_volume, some_slices
from planish.surface import Corrections, correct_surfaces, find_surfaces, read_corrections

CORRECTIONS = "edits/surface.json"
"""Name of the file of a run that holds them."""


def map_layer(
    layer: GivenLayer,
    *,
    compute: Compute,
    progress: Progress,
    tile_dir: Path | None,
    old_sheet: MappedLayer | None,
) -> MappedLayer:
    """Go from a volume to flattened maps of its properties.

    The parameters that come back with it hold the sizes and pitches that were used, in um, so that
    the run can be repeated. ``tile_dir`` is for the results of single tiles, where a run that was
    killed finds them again.
    ``old_sheet`` is of the same volume with the same surface but for corrections: only what other
    parameters change is done anew, and only the tiles that a correction touches are searched again.
    """
    v = layer.volume
    assert v is not None
    local = Engine(threads=compute.threads, memory_bytes=compute.for_work // 2)
    volume, sections, surfaces, columns = _measure(
        layer, old_sheet, local, tile_dir, compute, progress
    )
    with thread_pool(compute.threads) as pool:
        # They need no flat map, and are worked out beside it.
        checks_and_numbers = pool.submit(_judged, layer, volume, sections, columns, local)
        progress("flatten", "eight-spring mesh")
        # Before the properties: a column whose normal meets no face still has its place in the
        # sheet.
        flattened = flatten_sheet(surfaces, params=layer.flatten)
        if volume is not None:
            progress("check", "slices, grey, layers")
        scan_checks, numbers = checks_and_numbers.result()
    column_um = float(np.sqrt(math.prod(pitch(surfaces))))
    map_um = layer.flatten.map_um or column_um
    progress("resample", f"{map_um:.3g} um pixels")
    maps = resample_maps(columns, flattened.flat, map_um=map_um)
    groups = {"surfaces": columns, "flat": flattened.flat, "strain": flattened.strain, "maps": maps}
    joined = None
    if sections is not None:
        groups["sections"] = sections
        joined = section_facts(sections)
    params = changed(layer, flatten={"mesh_um": flattened.quality.mesh_um, "map_um": map_um})
    facts = SheetFacts(
        surfaces=surface_facts(columns),
        properties=property_facts(columns),
        numbers=numbers,
        flatten=flattened.quality,
        sections=joined,
    )
    md_deg = v.md_deg if layer.md_deg is None else layer.md_deg
    if volume is None:
        assert old_sheet is not None
        sheet = MappedLayer(
            params=params, source=old_sheet.source, groups=groups, facts=facts, md_deg=md_deg
        )
        return _remapped(old_sheet, sheet)
    step = column_step(volume, v.frame, v.column_um, compute)
    groups["slices"] = some_slices(volume, v.frame, step)
    voxel_um = tuple(map(float, volume.attrs["voxel_um"]))
    params = changed(params, volume={"voxel_um": voxel_um})
    # Where single columns of voxels were measured without being asked for, nothing has to be
    # repeated.
    if step > 1 and v.column_um is None:
        params = changed(params, volume={"column_um": column_um})
    checks = run_checks(MeasuredSheet(facts, columns))
    return MappedLayer(
        params=params,
        source=input_file(volume, v.path),
        groups=groups,
        facts=facts,
        md_deg=md_deg,
        checks=(*checks, *scan_checks),
    )


def _measure(
    layer: GivenLayer,
    old: MappedLayer | None,
    local: Engine,
    tile_dir: Path | None,
    compute: Compute,
    progress: Progress,
) -> tuple[xr.DataArray | None, xr.Dataset | None, xr.Dataset, xr.Dataset]:
    """Give volume (None where not read), sections, surfaces and measured columns.

    A similar sheet of an ``old`` run may have them: its surfaces, corrected anew where other
    corrections are asked for, and its columns where nothing of that changed. ``local`` works
    on them, the search for new surfaces in tiles of its own.
    """
    v = layer.volume
    assert v is not None

    if old is None:
        volume, sections = _read(v, compute, progress)
        surfaces = search_sheet(
            volume, layer, compute=compute, progress=progress, tile_dir=tile_dir
        )
    else:
        corrections = asked_corrections(layer)
        columns = old.groups["surfaces"]
        sections = old.groups.get("sections")
        surfaces = surfaces_of(columns)
        is_same_surface = made_corrections(columns) == corrections
        if is_same_surface and old.params.properties == layer.properties:
            return None, sections, surfaces, columns
        volume, _ = _read(v, compute, progress)
        if not is_same_surface:
            progress("surface", "corrections")
            edits = Corrections.model_validate_json(corrections) if corrections else Corrections()
            surfaces = correct_surfaces(surfaces, volume, edits, params=layer.surface, engine=local)
    n_columns = surfaces.sizes["y"] * surfaces.sizes["x"]
    progress("measure", f"{n_columns} columns")
    try:
        columns = measure_properties(surfaces, volume=volume, params=layer.properties, engine=local)
    except CannotMeasure as error:
        if hint_text := other_axis(volume, v.through):
            raise CannotMeasure(f"{error.text} {hint_text}") from error
        raise
    return volume, sections, surfaces, columns


def _read(
    v: VolumeParams, compute: Compute, progress: Progress
) -> tuple[xr.DataArray, xr.Dataset | None]:
    """Read a volume, with what was done to its sections; and say where its axis looks wrong."""
    progress("read", find_place(v.path).path.name)
    volume, sections = read_sheet_volume(v, compute, progress)
    if "size_doubt" in volume.attrs:
        progress("look", with_advice(volume.attrs["size_doubt"], VOXEL))
    if hint_text := other_axis(volume, v.through):  # before the search, which takes minutes
        progress("look", f"{hint_text} The sheet is searched along {v.through}.")
    return volume, sections


def _judged(
    layer: GivenLayer,
    volume: xr.DataArray | None,
    sections: xr.Dataset | None,
    columns: xr.Dataset,
    local: Engine,
) -> tuple[tuple[Check, ...], SheetNumbers | None]:
    """Checks of a scan and numbers of its sheet; neither where the volume was not read."""
    if volume is None:
        return (), None
    checks = check_scan(
        volume,
        columns,
        sections=sections is not None,
        labels=layer.surface.labels is not None,
        threads=local.threads,
    )
    return checks, sheet_numbers(columns, volume=volume, params=layer.properties, engine=local)


def _remapped(old_sheet: MappedLayer, sheet: MappedLayer) -> MappedLayer:
    """A sheet that was only flattened anew, with what a similar one knows of its volume.

    Checks of the volume are kept; groups that did not change stay in the store of the old run.
    """
    assert old_sheet.facts is not None
    assert sheet.facts is not None
    # A store has no order.
    properties = {name: sheet.facts.properties[name] for name in old_sheet.facts.properties}
    updates = {"properties": properties, "numbers": old_sheet.facts.numbers}
    facts = sheet.facts.model_copy(update=updates)
    kept_groups = {*old_sheet.unchanged} & {"surfaces", "slices", "sections"}
    unchanged = {name: old_sheet.unchanged[name] for name in kept_groups}
    checks = run_checks(MeasuredSheet(facts, sheet.groups["surfaces"]))
    check_names = {check.name for check in checks}
    checks += [check for check in old_sheet.checks if check.name not in check_names]
    groups = sheet.groups | {"slices": old_sheet.groups["slices"]}
    return replace(sheet, facts=facts, groups=groups, unchanged=unchanged, checks=tuple(checks))


def search_sheet(
    volume: xr.DataArray,
    layer: GivenLayer,
    *,
    compute: Compute,
    progress: Progress = silent,
    tile_dir: Path | None = None,
) -> xr.Dataset:
    """Find the surfaces of a sheet; errors as those of :func:`planish.find_surfaces`."""
    v = layer.volume
    assert v is not None
    step = column_step(volume, v.frame, v.column_um, compute)
    columns_text = f", columns of {step} x {step}" if step > 1 else ""
    progress("surface", " x ".join(map(str, volume.shape)) + " voxels" + columns_text)
    with engine(compute, tiles=tile_dir and tile_dir / str(step)) as tile_engine:
        return find_surfaces(
            volume,
            frame=v.frame,
            params=layer.surface,
            step=step,
            engine=tile_engine,
            unusual_size=v.unusual_size,
        )


def asked_corrections(layer: GivenLayer) -> str:
    """Text of the corrections that a study asks for, empty where there are none.

    FileError where it holds others.
    """
    if layer.surface.corrections is None:
        return ""
    corrections = read_corrections(layer.surface.corrections)
    return corrections.to_json() if corrections.stretches else ""


def made_corrections(surfaces: xr.Dataset) -> str:
    """Text of the corrections that surfaces have; empty where they are as they were found."""
    return str(surfaces.attrs.get("corrections", ""))
