"""Several layers (runs, volumes, images) on the pixels of one reference, each brought there in one step."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish import __version__
from planish.compute import Compute
from planish.core.errors import CannotRegister
from planish.core.grid import Grid
from planish.gates import Gate, direction_gates, field_gate, map_gates, mark_gates, sheet_gates
from planish.io import read_image
from planish.marks import HoleParams, cut_holes, find_holes, find_sheet_holes, hole_mask
from planish.marks.files import LayerFacts, read_pairs
from planish.pipeline.grid import headline_of
from planish.pipeline.holes import in_flat
from planish.pipeline.marking import Joined, Plane, check_enough, join_found, join_given, read_design
from planish.pipeline.orientation import orientation_results
from planish.pipeline.pairs import compare, lag_between, likeness, side_seen
from planish.pipeline.run import Layers, Progress, Run, read_run, silent
from planish.pipeline.sheet import map_sheet
from planish.register import Chain
from planish.resample import expected_error, image_attrs, resample_image, resample_maps
from planish.results import input_results, mark_results, marks_table, parameter_results
from planish.study import LayerSection, LayersStudy, RegistrationSection
from planish.surface.presence import LAYERS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Layer:
    """One layer as it was read: a sheet with its maps, or an image."""

    section: LayerSection
    plane: Plane
    grid: Grid
    sheet: Run | None
    image: xr.DataArray | None

    @property
    def name(self) -> str:
        return self.section.name


def link_layers(
    study: LayersStudy, *, progress: Progress | None = None, compute: Compute | None = None, kept: Path | None = None
) -> Layers:
    """Register layers to the last one, bring all onto its pixels, and correlate them in pairs.

    Parameters
    ----------
    study : LayersStudy
    progress : callable, optional
        Called with the name of a stage and a few words.
    compute : Compute, optional
        What may be used.
    kept : Path, optional
        Folder for the results of single tiles of volumes that are mapped.

    Returns
    -------
    Layers

    Notes
    -----
    The sheets themselves are never registered in space; their maps are (Hirn et al. 2009, section 3.4). The
    transformations of a chain are composed, so every layer is resampled once, from its own mesh or pixels.
    """
    tell, compute = progress or silent, compute or Compute()
    pattern = read_design(study.registration.design)
    layers = [_read(section, study, compute, tell, kept) for section in study.layers]
    reference = layers[-1]
    joined: dict[str, tuple[_Layer, Joined]] = {}
    for k, layer in enumerate(layers[:-1]):
        to = layers[k + 1] if study.chain else reference
        tell("register", f"{layer.name} to {to.name}")
        joined[layer.name] = (to, _join(layer, to, study.registration, pattern))
    ways = {layer.name: _way(layer, joined) for layer in layers[:-1]}
    maps: dict[str, xr.Dataset] = {}
    away = np.ones(reference.grid.shape, dtype=bool)
    for layer in layers:
        tell("link", f"{layer.name} on {reference.name}")
        way = ways.get(layer.name)
        maps[layer.name] = _own(layer) if way is None else _carried(layer, way, reference.grid, compute)
        away &= _away_from_holes(layer, way, reference.grid, study.rim_um)
    for layer in layers:
        data = maps[layer.name]
        data.attrs["faces"] = layer.plane.faces
        known = np.isfinite(data[headline_of(data)].values) & away
        data["valid"] = (("y", "x"), known, {"long_name": "Measured, and away from holes and their rims"})
    point_um = study.correlate.point_um
    pairs = [row for a, b in combinations(maps, 2) for row in compare(a, b, maps, point_um)]
    tell("correlate", f"{len(pairs)} pairs of maps")
    told = [_told(layer, reference, joined, ways.get(layer.name), maps) for layer in layers]
    results: dict[str, Any] = {
        "planish": __version__,
        "versions": {name: version(name) for name in ("numpy", "scipy", "numba", "xarray", "zarr", "tifffile")},
        "reference": reference.name,
        "chain": study.chain,
        "layers": told,
        "pairs": pairs,
        "lags": [lag_between(name, reference.name, maps) for name in ways],
    }
    gates = (
        *(gate for layer, facts in zip(layers, told, strict=True) for gate in _gates(layer, facts, reference.name)),
        *(gate for a, b in combinations(maps, 2) for gate in sheet_gates(a, b, likeness(maps[a], maps[b], point_um))),
    )
    results["quality"] = [asdict(gate) for gate in gates]
    results["parameters"] = parameter_results(study)
    return Layers(
        study=study,
        groups={f"layers/{name}": data for name, data in maps.items()},
        marks={name: marks_table(found.labels, found.fit) for name, (_, found) in joined.items()},
        runs={layer.name: layer.sheet for layer in layers if layer.sheet is not None and layer.section.map is not None},
        results=results,
        gates=gates,
    )


def _read(
    section: LayerSection, study: LayersStudy, compute: Compute, tell: Progress, kept: Path | None
) -> _Layer:  # fmt: skip
    """Read one layer, map it where it is a volume, and find its holes."""
    hole_um = study.registration.hole_um
    if section.image is not None:
        tell("read", Path(section.image.path).name)
        given = section.image
        image = read_image(
            Path(given.path), pixel_um=given.pixel_um, channel=given.channel, override_size=given.override_size
        )
        pixel = (float(image.attrs["pixel_um"][0]), float(image.attrs["pixel_um"][1]))
        tell("marks", f"holes of {section.name}")
        holes = find_holes(image.values, pixel_um=pixel, diameter_um=hole_um)
        plane = Plane(name=section.name, holes=holes, side=given.side, md_deg=given.md_deg)
        grid = Grid.of(image)
        return _Layer(section=section, plane=plane, grid=grid, sheet=None, image=image)
    if section.run is not None:
        tell("read", Path(section.run).name)
        sheet = read_run(Path(section.run))
    else:
        assert section.map is not None
        sheet = map_sheet(
            section.map, progress=tell, compute=compute, kept=None if kept is None else kept / section.name
        )
    maps = sheet.groups["maps"]
    holes = find_sheet_holes(maps, params=HoleParams(hole_um=hole_um))
    plane = Plane(name=section.name, holes=holes, sheet=True, md_deg=sheet.study.volume.md_deg)
    grid = Grid.of(maps)
    return _Layer(section=section, plane=plane, grid=grid, sheet=sheet, image=None)


def _join(layer: _Layer, to: _Layer, r: RegistrationSection, pattern: Any) -> Joined:
    """Register one layer to another one."""
    path = layer.section.marks
    if path is None:
        for one in (layer, to):
            check_enough(one.plane, r.hole_um)
        moving, fixed = _as_seen(layer, to, r), _as_seen(to, layer, r)
        return join_found(moving, fixed, r, pattern)
    moving, fixed = (
        LayerFacts() if one.image is None else LayerFacts(one.grid.pixel_um, shape=one.grid.shape)
        for one in (layer, to)
    )
    given = read_pairs(path, moving=moving, fixed=fixed)
    if layer.sheet is not None:
        moving_um = in_flat(given, layer.sheet.groups["flat"], layer.sheet.groups["surfaces"])
    else:
        moving_um = np.stack([given["moving_x"].values, given["moving_y"].values], axis=1)
    return join_given(given, moving_um, layer.plane, to.plane, r)


def _as_seen(layer: _Layer, other: _Layer, r: RegistrationSection) -> Plane:
    """The plane of a layer with the holes of the face that the other layer shows."""
    if layer.sheet is None or other.sheet is not None or other.plane.faces == "top":
        return layer.plane
    params = HoleParams(hole_um=r.hole_um)
    return replace(layer.plane, holes=find_sheet_holes(layer.sheet.groups["maps"], params=params, side="bottom"))


def _way(layer: _Layer, joined: dict[str, tuple[_Layer, Joined]]) -> Chain:
    """All transformations from a layer to the reference."""
    fits = []
    at = layer
    while at.name in joined:
        at, found = joined[at.name]
        fits.append(found.fit)
    return Chain(fits=tuple(fits))


def _own(layer: _Layer) -> xr.Dataset:
    """The reference's own maps."""
    if layer.image is not None:
        data = (("y", "x"), layer.image.values, image_attrs(layer.image))
        return xr.Dataset({"image": data}, coords=layer.grid.coords)
    assert layer.sheet is not None
    maps = layer.sheet.groups["maps"].rename({"v": "y", "u": "x"})
    return maps.drop_vars(["projected_u", "projected_v", "valid", *LAYERS], errors="ignore")


def _carried(layer: _Layer, way: Chain, grid: Grid, compute: Compute) -> xr.Dataset:
    """A layer on the reference's pixels."""
    if layer.sheet is not None:
        data = resample_maps(layer.sheet.groups["surfaces"], layer.sheet.groups["flat"], onto=grid, transform=way)
        shown = data["u"].values
    else:
        assert layer.image is not None
        data = resample_image(layer.image, grid, way, memory_bytes=compute.volume_bytes)
        shown = data["image"].values
    if not np.isfinite(shown).any():
        raise CannotRegister(
            f"The layer {layer.name} does not meet the reference: by its marks it lies beside it. Check the marks."
        )
    return data.assign(expected_error=expected_error(way, grid, shown))


def _away_from_holes(layer: _Layer, way: Chain | None, grid: Grid, rim_um: float) -> NDArray[np.bool_]:
    """Pixels of the reference that are away from the holes of one layer, also from those that its border cuts."""
    holes = layer.plane.holes
    assert holes is not None
    every = [holes] if layer.image is None else [holes, cut_holes(layer.image, holes)]
    at = np.concatenate([np.stack([h["x"].values, h["y"].values], axis=1) for h in every])
    radii = np.concatenate([0.5 * h["diameter"].values for h in every])
    there = at if way is None else way(at)
    known = np.isfinite(there).all(axis=1)
    scale = 1.0 if way is None else way.similarity.scale
    return ~hole_mask(grid, there[known], scale * radii[known] + rim_um)


def _told(
    layer: _Layer, reference: _Layer, joined: dict[str, tuple[_Layer, Joined]], way: Chain | None,
    maps: dict[str, xr.Dataset],
) -> dict[str, Any]:  # fmt: skip
    """What the results say of one layer."""
    data = maps[layer.name]
    if layer.image is not None and layer.section.image is not None:
        source = input_results(layer.image, Path(layer.section.image.path), pixel_um=list(layer.grid.pixel_um))
    else:
        assert layer.sheet is not None
        source = layer.sheet.results["inputs"]["volume"]
    facts: dict[str, Any] = {
        "name": layer.name,
        "kind": "image" if layer.sheet is None else "sheet",
        "source": source,
        "to": None,
        "path": [layer.name],
        "headline": headline_of(data, side_seen(data, maps[reference.name])),
        "share_of_reference": float(np.isfinite(data["volume_z" if layer.sheet else "image"].values).mean()),
        "marks": None,
        "expected_error_um": None,
        "orientation": None,
    }
    if layer.name not in joined or way is None:
        return facts
    to, found = joined[layer.name]
    at, path = layer, [layer.name]
    while at.name in joined:
        at = joined[at.name][0]
        path.append(at.name)
    marks = found.seen | mark_results(found.fit, data)
    return facts | {
        "to": to.name,
        "path": path,
        "marks": marks,
        "expected_error_um": marks["expected_error_um"],
        "orientation": orientation_results(layer.plane, to.plane, found.fit),
    }


def _gates(layer: _Layer, facts: dict[str, Any], reference: str) -> list[Gate]:
    """Gates of one layer, named after it."""
    found: list[Gate] = []
    if layer.sheet is not None:
        found += map_gates(layer.sheet.results)
    if facts["marks"] is not None:
        found += (*mark_gates(facts["marks"]), *direction_gates(facts["orientation"]))
        found.append(field_gate(facts["share_of_reference"], reference, layer.name))
    return [replace(gate, name=f"{layer.name}: {gate.name}") for gate in found]
