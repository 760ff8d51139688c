"""Judge a run: its checks, and with them the trust in every number of its results."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr

from planish import __version__
from planish.analyze.leading_map import leading_map
from planish.analyze.sides import TextureFound, found_by_texture, holes_and_texture
from planish.checks import (
    DetectedHoles,
    HolesOnSheet,
    JudgedRegistration,
    RegisteredSheet,
    SheetImage,
    SizedLayer,
    TextureChecks,
    apply_checks,
    for_layers,
    run_checks,
)
from planish.core.bands import thinned
from planish.core.checks import Check
from planish.core.source_hash import find_commit, hash_sources
from planish.io.light import LIGHT
from planish.results import LayerFacts, Results
from planish.run.compare import Comparison
from planish.run.holes import HoleSearch
from planish.run.layers import Datasets, Link, LinkedLayer, MappedLayer
from planish.run.overlay import LINKED, Overlay
from planish.run.packages import with_packages
from planish.run.regions import region_facts
from planish.run.registration import Registration
from planish.run.run import Run
from planish.run.study import Study, changed, to_dict, with_paths

_LIBRARIES = ("numpy", "scipy", "numba", "xarray", "zarr", "tifffile")  # that numbers depend on


def judge_sheet(study: Study, sheet: MappedLayer) -> Run:
    """The run of one mapped sheet, with its checks applied to its numbers."""
    assert sheet.facts is not None
    study = changed(study, layers=(sheet.params,), correlate={"regions": None})
    study = with_packages(study)
    facts = LayerFacts(
        name=sheet.name,
        kind="sheet",
        source=sheet.source,
        headline=leading_map(sheet.groups["surfaces"]),
        sheet=sheet.facts,
    )
    checks = for_layers(sheet.checks, sheet.name)
    checks += _size_checks([facts])
    results = _results(study, [facts], checks)
    return Run(study=study, results=results, groups=sheet.groups, unchanged=sheet.unchanged)


def judge_link(study: Study, overlay: Overlay, comparison: Comparison, holes: HoleSearch) -> Run:
    """The run of linked layers, with its checks applied to its numbers.

    The study of the run has the layers as they were made, with the sizes that were used. Sheets of
    a link of other layers than one sheet and one image become runs of their own within the run.
    """
    layers = [linked.layer for linked in overlay.layers]
    used_params = tuple(layer.params for layer in layers)
    study = with_packages(changed(study, layers=used_params))
    regions = overlay.mask.regions
    is_by_this_code = all(layer.by_this_code for layer in layers)
    checks = _checks_of_link(overlay, comparison, holes)
    results = _results(
        study,
        comparison.layers,
        checks,
        by_this_code=is_by_this_code,
        chain=study.chain,
        correlations=comparison.correlations,
        evidence=comparison.evidence,
        mottle=comparison.mottle,
        linked=comparison.area,
        comparison=comparison.registrations,
        refinement=comparison.refinement,
        regions=None if regions is None else region_facts(regions, overlay.grid),
    )
    registrations: dict[str, Registration] = {}
    for linked in overlay.layers:
        if linked.link is not None:
            registrations[linked.name] = linked.link.registration
    run = Run(
        study=study,
        results=results,
        groups=_groups_of_link(study, overlay, comparison),
        regions=regions,
        registrations=registrations,
    )
    if study.is_sheet_on_image:
        return replace(run, unchanged=layers[0].unchanged)
    volumes = {layer.name: layer for layer in layers if layer.params.kind == "volume"}
    return replace(run, sheets=volumes)


def _groups_of_link(study: Study, overlay: Overlay, comparison: Comparison) -> Datasets:
    """Groups of the run of linked layers, by name, with smaller copies of their maps."""
    if study.is_sheet_on_image:
        sheet = overlay.layers[0].layer
        groups = sheet.groups | {LINKED: overlay.store.group(LINKED)}
    else:
        groups = {f"layers/{name}": maps for name, maps in overlay.maps.items()}
    if comparison.refined is not None:
        groups["refined"] = comparison.refined
    for linked in overlay.layers:
        if linked.layer.corrected is not None:
            groups[f"{LIGHT}/{linked.name}"] = linked.layer.corrected.light
    return groups | overlay.store.overviews()


def _results(
    study: Study,
    layers: Iterable[LayerFacts],
    checks: Iterable[Check],
    *,
    by_this_code: bool = True,
    **fields: Any,
) -> Results:
    """Results with what they were made by, and with the checks applied to their numbers.

    Layers that another planish mapped leave it open which code made the results
    (``by_this_code``). ``fields`` are those of the results that a run of layers has.
    """
    if by_this_code:
        fields |= {"code": hash_sources(), "commit": find_commit()}
    versions = {name: version(name) for name in _LIBRARIES} | study.packages
    # Paths say where files lie and not what was done.
    parameters = to_dict(with_paths(study, lambda _: None))
    results = Results(
        planish=__version__,
        layers=tuple(layers),
        checks=tuple(checks),
        versions=versions,
        parameters=parameters,
        **fields,
    )
    return apply_checks(results)


def _checks_of_link(overlay: Overlay, comparison: Comparison, holes: HoleSearch) -> Iterator[Check]:
    """Checks of each layer and its registration, of what two layers share, and of all together.

    They come in the order of the results; ``holes`` gives those that were searched.
    """
    for linked, facts in zip(overlay.layers, comparison.layers, strict=True):
        yield from _checks_of_map(overlay, linked, comparison.layers)
        if linked.link is not None:
            yield from _registration_checks(linked.link, facts, holes)
    yield from _size_checks(comparison.layers)
    for linked in overlay.layers[:-1]:
        yield from _hole_checks(linked, overlay.reference)
    if any(linked.kind == "sheet" for linked in overlay.layers):
        yield from _image_checks(overlay)
    for (a, b), texture in comparison.textures.items():
        checks = _texture_checks(overlay, a, b, texture)
        yield from run_checks(TextureChecks(*checks), a, b)
        if texture.lag is not None:
            yield from run_checks(texture.lag, a, b)
    for evidence in comparison.evidence:
        yield from run_checks(evidence, evidence.a, evidence.b)
    if comparison.area is not None:
        yield from run_checks(comparison.area, *overlay.maps)


def _checks_of_map(
    overlay: Overlay, linked: LinkedLayer, layers: Sequence[LayerFacts]
) -> Iterator[Check]:
    """Checks of a layer by itself, and of its size, which the marks may judge better."""
    scale_checks = [*_scale_checks(overlay, linked)]
    names = [check.name for check in scale_checks]
    for check in linked.layer.checks:
        if check.name not in names:
            yield from for_layers([_with_fit(check, linked, layers)], linked.name)
    yield from scale_checks


def _with_fit(check: Check, linked: LinkedLayer, layers: Sequence[LayerFacts]) -> Check:
    """A check; that of a mirror image passes where the layer fits on another one mirrored.

    ``layers`` are all layers, whose registrations say whether they fit so.
    """
    if not linked.layer.hand_text or not check.name.startswith("hand of"):
        return check
    for facts in layers:
        fit = facts.registration
        if fit is None or linked.name not in fit.path[:2]:
            continue
        if fit.orientation.mirrored_volume:
            sentence = f"{check.sentence} The layers fit mirrored, which agrees with that."
            return check.model_copy(update={"state": "pass", "sentence": sentence, "advice": ""})
    return check


def _size_checks(layers: Sequence[LayerFacts]) -> Iterator[Check]:
    """Whether sizes that nobody may have measured fit those of the layers they are linked to.

    The scale of a registration tells where the size of one of its two layers is in doubt, and
    where the fit was free to have one.
    """
    doubted = {facts.name for facts in layers if facts.source.size_doubt}
    for facts in layers:
        scale = None
        for moving in layers:
            registration = moving.registration
            if registration is None or registration.model == "rigid":
                continue
            pair = {moving.name, registration.to}
            if facts.name in pair and len(pair & doubted) == 1:
                scale = registration.scale
        yield from run_checks(SizedLayer(source=facts.source, scale=scale), facts.name)


def _scale_checks(overlay: Overlay, linked: LinkedLayer) -> Iterator[Check]:
    """Whether a sheet has the size that the marks say; by the first of its registrations.

    That is its own to the next layer, or for the reference the first one that leads to it.
    """
    if linked.kind != "sheet":
        return
    groups = linked.layer.groups
    for other in overlay.layers[:-1]:
        assert other.link is not None
        moving, fixed = other.link.path[:2]
        is_fixed = linked.name == fixed.name
        if other is linked or (is_fixed and linked.link is None):
            registered_sheet = RegisteredSheet(
                measured=groups["surfaces"],
                flat=groups["flat"],
                fit=other.link.registration.fit,
                is_fixed=is_fixed,
                either=moving.kind == fixed.kind == "sheet",
            )
            yield from run_checks(registered_sheet, moving.name, fixed.name)
            return


def _registration_checks(link: Link, facts: LayerFacts, holes: HoleSearch) -> Iterator[Check]:
    """Checks of the registration of a layer: of its fit, of holes that were found, of its field."""
    assert facts.registration is not None
    layer, fixed = link.path[:2]
    registration = link.registration
    # A mark can hardly be placed better than within the larger pixel of both.
    pixel_um = max(*layer.grid.pixel_um, *fixed.grid.pixel_um)
    judged = JudgedRegistration(
        layer=layer.name,
        facts=facts.registration,
        fit=registration.fit,
        agreement=registration.agreement(),
        hole_um=sum(holes.params.hole_um) / 2,
        pixel_um=pixel_um,
    )
    yield from run_checks(judged, layer.name, fixed.name)
    if registration.source in ("found", "both"):
        for searched_layer in (layer, fixed):
            for layer_holes in holes.searched(searched_layer):
                detected = DetectedHoles(searched_layer.name, layer_holes)
                yield from run_checks(detected, layer.name, fixed.name)
    yield from run_checks(facts, layer.name, facts.registration.path[-1])


def _hole_checks(linked: LinkedLayer, reference: LinkedLayer) -> Iterator[Check]:
    """Whether the holes of the reference lie where the sheet has holes, too."""
    assert linked.link is not None
    registration = linked.link.registration
    is_by_holes = registration.source in ("found", "both")
    if linked.kind == "sheet" and is_by_holes and linked.link.path[1] is reference.layer:
        holes_on_sheet = HolesOnSheet(
            sheet=linked.maps,
            marks=registration.marks,
            layer=linked.name,
            reference=reference.name,
        )
        yield from run_checks(holes_on_sheet, linked.name, reference.name)


def _image_checks(overlay: Overlay) -> Iterator[Check]:
    """Whether the greys of each image are cut off where all layers are valid.

    Of large images a part of the rows is looked at.
    """
    valid_maps = [maps["valid"] for maps in overlay.maps.values()]
    for linked in overlay.layers:
        if linked.kind == "image":
            image = linked.maps["image"]
            is_light_off = overlay.light is not None and linked is overlay.reference
            if is_light_off and isinstance(linked.layer.shown, xr.DataArray):
                image = linked.layer.shown  # whose scale has the ends of the camera's
            _, (grey, *valid) = thinned(image, *valid_maps)
            is_valid = np.logical_and.reduce(valid)
            yield from run_checks(SheetImage(grey[is_valid]), linked.name)


def _texture_checks(overlay: Overlay, a: str, b: str, texture: TextureFound) -> tuple[Any, ...]:
    """What the texture of two layers, by their names, says of their sides and their place.

    Where two layers lie is judged where one of them is the reference. Layers that were registered
    by their texture are judged by that registration.
    """
    side, *places = texture.checks
    side = _with_hand(side, overlay, (a, b))
    link = next(linked.link for linked in overlay.layers if linked.name == a)
    if link is not None and link.path[1].name == b:
        registration = link.registration
        if registration.source == "texture":
            return found_by_texture(registration.sentence or "", registration.false_probability)
        if registration.apart_um is not None:
            return side, holes_and_texture(*registration.apart_um)
    if b == overlay.reference.name:
        return side, *places
    return (side,)


def _with_hand(side: Check, overlay: Overlay, names: tuple[str, str]) -> Check:
    """The check of side and specimen; where it fails, with what the files say of their hand."""
    if side.state not in ("look", "fail"):
        return side
    texts = [side.advice]
    texts += [linked.layer.hand_text for linked in overlay.layers if linked.name in names]
    advice = " ".join(filter(None, texts))
    return side.model_copy(update={"advice": advice})
