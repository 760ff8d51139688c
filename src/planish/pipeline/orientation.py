"""How two layers lie on each other: side, hand and machine direction, as given. Nothing is guessed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planish.core.results import OrientationFacts
from planish.register import FittedTransform

if TYPE_CHECKING:
    from planish.pipeline.layers import Layer


def orientation_facts(moving: Layer, fixed: Layer, fit: FittedTransform) -> OrientationFacts:
    """Say how two registered layers lie on each other."""
    numbered_back = fit.mirrored != (moving.side != fixed.side)
    carried = None if moving.md_deg is None else machine_direction(fit, moving.md_deg)
    words = [_side_sentence(layer) for layer in (moving, fixed) if layer.kind == "image"]
    if numbered_back:
        words.append(f"The marks fit mirrored only: the {moving.name} is numbered against the usual sense.")
    words.append(_direction_sentence(moving, fixed, carried))
    return OrientationFacts(
        image_side=fixed.side,
        side_given=fixed.side_given is not None or fixed.kind == "sheet",
        mirrored_volume=numbered_back,
        md_deg_moving=moving.md_deg,
        md_deg_fixed=fixed.md_deg,
        md_deg_fixed_from_moving=carried,
        sentence=" ".join(words),
    )


def machine_direction(fit: FittedTransform, md_deg: float) -> float:
    """Carry an axis (deg clockwise on screen from x) over to the fixed layer; 0 to 180."""
    angle = np.deg2rad(md_deg)
    x, y = fit.transform.matrix() @ (np.cos(angle), np.sin(angle))
    return float(np.rad2deg(np.arctan2(y, x)) % 180.0)


def _side_sentence(layer: Layer) -> str:
    if layer.side_given is None:
        return f"Side of the {layer.name} not given; top side assumed (--image-side)."
    return f"The {layer.name} shows the {layer.side} side of the sheet, as given."


def _direction_sentence(moving: Layer, fixed: Layer, carried: float | None) -> str:
    if carried is not None:
        given = "." if fixed.md_deg is None else f"; {_angle(fixed.md_deg)} was given there."
        return (
            f"The machine direction lies at {_angle(moving.md_deg)} in the {moving.name} and so at {_angle(carried)} "
            f"in the {fixed.name}{given}"
        )
    if fixed.md_deg is not None:
        return (
            f"The machine direction lies at {_angle(fixed.md_deg)} in the {fixed.name}, as given; none was given for "
            f"the {moving.name}."
        )
    return "Machine direction not given (--md-deg, --image-md-deg)."


def _angle(deg: float | None) -> str:
    return f"{(deg or 0.0) % 180.0:.1f}".removesuffix(".0") + "°"
