"""How planes lie against each other: side, hand and machine direction, as somebody said. Nothing is guessed."""

from __future__ import annotations

from typing import Any

import numpy as np

from planish.pipeline.marking import Plane
from planish.register import FittedTransform


def orientation_results(moving: Plane, fixed: Plane, fit: FittedTransform) -> dict[str, Any]:
    """Tell how two registered planes lie, for the results and in a sentence.

    Parameters
    ----------
    moving, fixed : Plane
    fit : FittedTransform
        From one to the other.
    """
    numbered_back = fit.mirrored != (moving.faces != fixed.faces)
    carried = None if moving.md_deg is None else machine_direction(fit, moving.md_deg)
    words = [_side(plane) for plane in (moving, fixed) if not plane.sheet]
    if numbered_back:
        words.append(f"The marks fit mirrored only: the {moving.name} is numbered against the usual sense.")
    if carried is not None:
        words.append(
            f"The machine direction lies at {_angle(moving.md_deg)} in the {moving.name} and so at {_angle(carried)} "
            f"in the {fixed.name}" + ("." if fixed.md_deg is None else f"; {_angle(fixed.md_deg)} was given there.")
        )
    elif fixed.md_deg is not None:
        words.append(
            f"The machine direction lies at {_angle(fixed.md_deg)} in the {fixed.name}, as given; for the "
            f"{moving.name} nothing was given to compare it with."
        )
    else:
        words.append("The machine direction is not known: nobody gave it.")
    return {
        "between": [moving.name, fixed.name],
        "image_side": fixed.faces,
        "side_source": "given" if fixed.side or fixed.sheet else "not given, taken as top",
        "mirrored_volume": numbered_back,
        "md_deg_map": moving.md_deg,
        "md_deg_image": fixed.md_deg,
        "md_deg_image_from_map": carried,
        "sentence": " ".join(words),
    }


def machine_direction(fit: FittedTransform, md_deg: float) -> float:
    """Carry an axis (deg clockwise on screen from x) over to the fixed plane; 0 to 180."""
    angle = np.deg2rad(md_deg)
    x, y = fit.transform.matrix() @ (np.cos(angle), np.sin(angle))
    return float(np.rad2deg(np.arctan2(y, x)) % 180.0)


def _side(plane: Plane) -> str:
    if plane.side is None:
        return f"Nobody said which side of the sheet the {plane.name} shows: the top was taken."
    return f"The {plane.name} shows the {plane.side} side of the sheet, as given."


def _angle(deg: float | None) -> str:
    return f"{(deg or 0.0) % 180.0:.1f}".removesuffix(".0") + "°"
