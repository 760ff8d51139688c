"""Transformations as they are written to JSON, and read back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.transform import Affine, Projective, Similarity
from planish.register.strain import Transform
from planish.register.thin_plate import ThinPlate

Floats = NDArray[np.float64]
FORMAT = "planish transformation 1"


def parameters_of(transform: Transform) -> dict[str, Any]:
    """Say what a transformation has beside scale, rotation and shift."""
    match transform:
        case Similarity():
            return {}
        case Affine():
            return {"linear": transform.linear, "source_um": transform.source, "target_um": transform.target}
        case Projective():
            return {
                "homography": transform.homography, "source_um": transform.source, "target_um": transform.target,
                "source_size_um": transform.source_size, "target_size_um": transform.target_size,
            }  # fmt: skip
        case ThinPlate():
            return {
                "source_um": transform.source, "size_um": transform.size, "nodes": transform.nodes.tolist(),
                "affine_um": transform.affine.tolist(), "bend_um": transform.bend.tolist(),
                "smoothing_um2": transform.smoothing_um2,
            }  # fmt: skip


def transform_of(data: dict[str, Any]) -> Transform:
    """Read a transformation back; ValueError, KeyError or TypeError where something is missing or wrong."""
    own = data["transform"]
    match data["model"]:
        case "rigid" | "similarity":
            return Similarity(
                scale=as_number(data["scale"]), rotation_rad=as_number(data["rotation_rad"]),
                shift_um=as_pair(data["shift_um"]), mirrored=bool(data["mirrored"]),
            )  # fmt: skip
        case "affine":
            linear = (as_pair(own["linear"][0]), as_pair(own["linear"][1]))
            middle = as_pair(own["source_um"])
            return Affine(linear=linear, source=middle, target=as_pair(own["target_um"]))
        case "projective":
            rows = tuple((as_number(a), as_number(b), as_number(c)) for a, b, c in own["homography"])
            return Projective(
                homography=(rows[0], rows[1], rows[2]),
                source=as_pair(own["source_um"]), target=as_pair(own["target_um"]),
                source_size=as_number(own["source_size_um"]), target_size=as_number(own["target_size_um"]),
            )  # fmt: skip
        case "tps":
            smoothing = own["smoothing_um2"]
            return ThinPlate(
                source=as_pair(own["source_um"]), size=as_number(own["size_um"]), nodes=as_array(own["nodes"]),
                affine=as_array(own["affine_um"]), bend=as_array(own["bend_um"]),
                # JSON has no infinity: null stands for the spline without bending.
                smoothing_um2=float("inf") if smoothing is None else float(smoothing),
            )  # fmt: skip
        case other:
            raise ValueError(f"model {other!r}")


def without_nan(value: Any) -> Any:
    """Put null in the place of numbers that JSON does not have."""
    if isinstance(value, dict):
        return {str(k): without_nan(v) for k, v in value.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    if isinstance(value, (list, tuple)):
        return [without_nan(v) for v in value]  # pyright: ignore[reportUnknownVariableType]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def as_array(values: Any) -> Floats:
    """Read an array; null is NaN."""
    return np.array(values, dtype=np.float64)


def as_number(value: Any) -> float:
    """Read a number; null is NaN."""
    return float("nan") if value is None else float(value)


def as_pair(values: Any) -> tuple[float, float]:
    """Read two numbers."""
    return float(values[0]), float(values[1])
