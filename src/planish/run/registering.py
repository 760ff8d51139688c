"""Register the layers of a link, by their marks or their texture, up to the last one.

The sheets themselves are never registered in space; their flat maps are (Hirn et al. 2009, section
3.4).
"""

from collections.abc import Sequence
from dataclasses import replace

from planish.core.errors import WrongHand
from planish.register import Chain
from planish.run.compute import Progress
from planish.run.holes import HoleSearch
from planish.run.layers import Link, MappedLayer
from planish.run.marks_registration import register_by_marks
from planish.run.registration import Registration
from planish.run.study import Study
from planish.run.texture_registration import register_by_texture, uses_texture


def register_layers(
    study: Study, layers: Sequence[MappedLayer], holes: HoleSearch, progress: Progress
) -> tuple[list[MappedLayer], dict[str, Link]]:
    """Register each layer to the reference, or to the next one of a chain.

    Give the layers, with the sides that their texture shows, and the link of each moving one.
    """
    layers = [*layers]
    registrations: list[Registration] = []
    for k, k_fixed in enumerate(study.next_layers):
        layer, fixed = layers[k], layers[k_fixed]
        progress("register", f"{layer.name} to {fixed.name}")
        by_texture = uses_texture(layer, fixed, holes, study)
        register = register_by_texture if by_texture else register_by_marks
        try:
            registration = register(layer, fixed, holes, study)
        except WrongHand as error:
            # What a file says of its hand may be the cause.
            hand_texts = filter(None, (layer.hand_text, fixed.hand_text))
            raise WrongHand(" ".join([error.text, *hand_texts])) from error
        registrations.append(registration)
        is_other_side = registration.fit.mirrored and layer.kind != fixed.kind
        if registration.source == "texture" and is_other_side and not study.registration.mirror:
            layers[k] = _seen_from_bottom(layer)
            layers[k_fixed] = _seen_from_bottom(fixed)
    links: dict[str, Link] = {}
    for k, k_fixed in enumerate(study.next_layers):
        path, steps = [layers[k], layers[k_fixed]], registrations[k : k + 1]
        if study.chain:
            path, steps = layers[k:], registrations[k:]
        chain = Chain(fits=tuple(registration.fit for registration in steps))
        links[layers[k].name] = Link(path, registrations[k], chain)
    return layers, links


def _seen_from_bottom(layer: MappedLayer) -> MappedLayer:
    """A layer; an image whose side was not given with the side that its texture shows."""
    if layer.kind != "image" or layer.side_given is not None:
        return layer
    return replace(layer, side_found="bottom")
