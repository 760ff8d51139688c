"""Layers linked: registered by their marks, brought onto the reference's pixels in one step, compared in pairs.

The sheets themselves are never registered in space; their flat maps are (Hirn et al. 2009, section 3.4).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish import __version__
from planish.compute import Compute
from planish.core.results import Gate, LayerFacts, RegistrationFacts, Results, Side
from planish.pipeline.compare import comparison_rows, correlate_layers, lag_of, likeness
from planish.pipeline.facts import expected_error_facts, linked_area, parameters, versions
from planish.pipeline.gates import area_gate, field_gate, registration_gates, same_sheet_gates, sheet_gates
from planish.pipeline.layers import Layer, open_layers
from planish.pipeline.onto import FlatSheet, Placed, headline_of, hole_circles, merged, on_reference
from planish.pipeline.orientation import orientation_facts
from planish.pipeline.progress import Progress, silent
from planish.pipeline.refinement import refine_link
from planish.pipeline.registration import Registration, read_design, register_layers
from planish.pipeline.run import Run
from planish.pipeline.sheet import changed
from planish.register import Chain
from planish.resample import resample_maps
from planish.study import Study

Array = NDArray[np.float64]

_RIM_UM = 100.0  # around holes of images, where no sheet says otherwise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Link:
    """How one layer comes to the reference."""

    to: Layer
    registration: Registration
    path: tuple[str, ...]
    chain: Chain


def link_study(
    study: Study, *, compute: Compute | None = None, progress: Progress = silent, kept: Path | None = None
) -> Run:
    """Register layers to the last one, bring all onto its pixels, and correlate them in pairs.

    Parameters
    ----------
    study : Study
        With two layers or more.
    compute, progress
    kept : Path, optional
        Folder for the results of single tiles of volumes that are mapped.

    Raises
    ------
    PlanishError
        Any of the tree in :mod:`planish.core.errors`.
    """
    compute = compute or Compute()
    read_design(study.registration)  # what is wrong with it should not cost the time of a volume
    layers = open_layers(study, compute=compute, progress=progress, kept=kept)
    links = _registered(layers, study, progress)
    reference = layers[-1]
    progress("link", f"{' x '.join(map(str, reference.grid.shape))} pixels of the {reference.name}")
    parts = {layer.name: _placed(layer, links.get(layer.name)) for layer in layers}
    circles = _circles(layers, links)
    maps, away = on_reference(parts, circles, reference.grid, memory_bytes=compute.volume_bytes)
    progress("correlate", f"{len(maps) * (len(maps) - 1) // 2} pairs of layers")
    return _gathered(study, layers, links, maps, away)


def _registered(layers: list[Layer], study: Study, progress: Progress) -> dict[str, _Link]:
    """Register every layer but the last one, and compose the chains."""
    found: dict[str, tuple[Layer, Registration]] = {}
    for k, layer in enumerate(layers[:-1]):
        to = layers[k + 1] if study.chain else layers[-1]
        progress("register", f"{layer.name} to {to.name}")
        found[layer.name] = (to, register_layers(layer, to, study))
    links: dict[str, _Link] = {}
    for layer in layers[:-1]:
        path, at = [layer.name], layer.name
        while at in found:
            at = found[at][0].name
            path.append(at)
        chain = Chain(fits=tuple(found[name][1].fit for name in path[:-1]))
        to, registration = found[layer.name]
        links[layer.name] = _Link(to=to, registration=registration, path=tuple(path), chain=chain)
    return links


def _placed(layer: Layer, link: _Link | None) -> Placed:
    return Placed(shown=layer.shown, chain=None if link is None else link.chain)


def _circles(layers: list[Layer], links: dict[str, _Link]) -> list[Array]:
    """All holes of all layers on the reference."""
    rim_um = max((layer.rim_um for layer in layers if layer.sheet is not None), default=_RIM_UM)
    by_name = {layer.name: layer for layer in layers}
    found: list[Array] = []
    for name, link in links.items():
        for side, layer in (("moving", by_name[name]), ("fixed", link.to)):
            own = links.get(layer.name)
            chain = None if own is None else own.chain
            found.append(hole_circles(link.registration.marks, side, rim_um, chain=chain, image=layer.image))
    return found


def _gathered(
    study: Study, layers: list[Layer], links: dict[str, _Link], maps: dict[str, xr.Dataset], away: NDArray[np.bool_]
) -> Run:  # fmt: skip
    """Correlations, results, gates and groups of a link."""
    reference, point_um = layers[-1], study.correlate.point_um
    pairs = list(combinations(layers, 2))
    rows = [row for a, b in pairs for row in correlate_layers(a.name, b.name, maps, point_um)]
    facts = [_layer_facts(layer, reference, links.get(layer.name), maps) for layer in layers]
    gates = [gate for layer, own in zip(layers, facts, strict=True) for gate in _gates(layer, own, len(layers))]
    for a, b in pairs:
        gates += same_sheet_gates(a.name, b.name, likeness(maps[a.name], maps[b.name], point_um))
    groups = {f"layers/{name}": data for name, data in maps.items()}
    more: dict[str, Any] = {}
    if study.is_sheet_on_image:
        sheet, link = layers[0], links[layers[0].name]
        assert sheet.sheet is not None
        assert isinstance(sheet.shown, FlatSheet)
        linked = merged(maps[sheet.name], maps[reference.name])
        groups = sheet.sheet.groups | {"linked": linked}
        more["linked"] = linked_area(linked, away)
        gates.append(area_gate(more["linked"]))
        measured, flat = sheet.sheet.groups["surfaces"], sheet.sheet.groups["flat"]
        more["comparison"] = tuple(
            comparison_rows(
                linked, sheet.shown, link.registration, name=facts[0].headline, point_um=point_um, away=away
            )
        )
        if study.registration.refine is not None:
            transform, more["refinement"] = refine_link(
                linked, facts[0].headline, reference.grid, link.registration.fit, study.registration.refine
            )
            # Beside the marks' own: nothing that the page correlates was fitted to what it is correlated with.
            groups["refined"] = resample_maps(measured, flat, onto=reference.grid, transform=transform)
    study = changed(study, layers=tuple(layer.params for layer in layers))
    results = Results(
        planish=__version__, versions=versions(), layers=tuple(facts), chain=study.chain, correlations=tuple(rows),
        gates=tuple(gates), parameters=parameters(study), **more,
    )  # fmt: skip
    return Run(
        study=study, results=results, groups=groups,
        registrations={name: link.registration for name, link in links.items()},
        sheets={} if study.is_sheet_on_image else {
            layer.name: layer.sheet for layer in layers if layer.sheet is not None and layer.params.kind == "volume"
        },
    )  # fmt: skip


def _layer_facts(layer: Layer, reference: Layer, link: _Link | None, maps: dict[str, xr.Dataset]) -> LayerFacts:
    data = maps[layer.name]
    side = "bottom" if "bottom" in (layer.side, reference.side) else "top"
    return LayerFacts(
        name=layer.name, kind=layer.kind, source=layer.source, headline=headline_of(data, side),
        share_of_reference=float(np.isfinite(data["volume_z" if layer.kind == "sheet" else "image"].values).mean()),
        registration=None if link is None else _registration_facts(layer, link, data, maps[reference.name], side),
        sheet=None if layer.sheet is None else layer.sheet.facts,
    )  # fmt: skip


def _registration_facts(
    layer: Layer, link: _Link, data: xr.Dataset, onto: xr.Dataset, side: Side
) -> RegistrationFacts:  # fmt: skip
    r, fit = link.registration, link.registration.fit
    t = fit.transform
    return RegistrationFacts(
        to=link.to.name, path=link.path, source=r.source, found_moving=r.count("moving"), found_fixed=r.count("fixed"),
        matched=len(fit.moving), second_best=r.second_best, match_sentence=r.sentence, design=r.design, tilt=r.tilt,
        model=fit.model, model_sentence=fit.sentence, warnings=tuple(fit.warnings), rms_um=float(fit.rms_um),
        leave_one_out_rms_um=fit.leave_one_out_rms_um,
        expected_error=expected_error_facts(data["expected_error"].values), scale=t.scale,
        rotation_deg=float(np.rad2deg(t.rotation_rad)), shift_um=(float(t.shift_um[0]), float(t.shift_um[1])),
        mirrored=t.mirrored, orientation=orientation_facts(layer, link.to, fit), lag=lag_of(data, onto, side),
    )  # fmt: skip


def _gates(layer: Layer, facts: LayerFacts, layers: int) -> Iterator[Gate]:
    """Gates of one layer; named after it where there are more than two."""
    found: list[Gate] = []
    if facts.sheet is not None:
        found += sheet_gates(facts.sheet)
    if facts.registration is not None:
        found += registration_gates(facts.registration, layer.name)
        found.append(field_gate(facts.share_of_reference or 0.0, layer.name, facts.registration.path[-1]))
    yield from (
        gate.model_copy(update={"name": f"{layer.name}: {gate.name}"}) if layers > 2 else gate for gate in found
    )
