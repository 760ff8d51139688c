"""A registration in the files of ITK, elastix, BigWarp, and as zarr to read with xarray."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr

from planish.exports.content import ExportHistory
from planish.exports.displacements import DirectedTransform, TransformPair, before_affine, displacement
from planish.exports.params import ExportParams
from planish.marks.files import write_any

UNITS = {"um": 1.0, "mm": 1e-3}

_ZARR_FORMAT = "planish displacement 1"
_OUTSIDE = -1e30
"""Value of resampled pixels beside the image: elastix reads no NaN, and 0 would be taken for a measurement."""


def write_itk(transform: DirectedTransform, path: Path, history: ExportHistory, params: ExportParams) -> None:
    """Write an affine transform as text, or a composite of one with a displacement field before it.

    Notes
    -----
    A composite applies its last transform first. Points are those of planish, x and y in the unit asked for; images
    whose first pixel lies elsewhere than at 0 need their origin.
    """
    scale = UNITS[params.unit]
    linear, center = _affine_parameters(transform, scale)
    parts: list[tuple[str, Iterable[float], Iterable[float]]] = [("AffineTransform_double_2_2", linear, center)]
    facts: dict[str, float] = {}
    if not transform.exact:
        field = before_affine(transform)
        facts = field.facts()
        rows, cols = field.shape
        layout = [cols, rows, *(scale * v for v in (*field.origin_um, *field.pitch_um)), 1, 0, 0, 1]
        local = ("DisplacementFieldTransform_double_2_2", (field.vectors * scale).ravel(), layout)
        parts = [("CompositeTransform_double_2_2", [], []), *parts, local]
    lines = ["#Insight Transform File V1.0", f"#{transform.name}: {history.json(**facts)}"]
    for k, (kind, parameters, fixed) in enumerate(parts):
        lines += [f"#Transform {k}", f"Transform: {kind}"]
        if not kind.startswith("Composite"):
            lines += [f"Parameters: {_numbers(parameters)}", f"FixedParameters: {_numbers(fixed)}"]
    _write_lines(path, lines)


def write_elastix(transform: DirectedTransform, path: Path, history: ExportHistory, params: ExportParams) -> None:
    """Write transform parameters for ``transformix -tp``; a field before the affine map stands in ``NAME_local.txt``.

    Notes
    -----
    elastix takes fixed points to moving points: ``image_to_sheet.txt`` brings maps of the sheet onto the image, and
    moves points of the image into the sheet. A B-spline of first order is linear between its nodes, whose coefficients
    are the displacements there.
    """
    scale = UNITS[params.unit]
    # The image that transformix makes lies on the pixels of the source.
    (rows, cols), (x, y), (down, across) = transform.grid.shape, transform.grid.origin_um, transform.grid.pixel_um
    image = {
        "Size": [cols, rows], "Index": [0, 0], "Spacing": [across * scale, down * scale],
        "Origin": [x * scale, y * scale],
        "Direction": [1, 0, 0, 1], "UseDirectionCosines": ["true"],
    }  # fmt: skip
    note = f"// {transform.name}: takes points of {transform.source} to {transform.target}. "
    first = "NoInitialTransform"
    if not transform.exact:
        field = before_affine(transform)
        first = f"{transform.name}_local.txt"
        coefficients = np.moveaxis(field.vectors, -1, 0).ravel() * scale
        local = _elastix_parameters("BSplineTransform", coefficients, "NoInitialTransform") | {
            "GridSize": field.shape[::-1], "GridIndex": [0, 0],
            "GridSpacing": [v * scale for v in field.pitch_um], "GridOrigin": [v * scale for v in field.origin_um],
            "GridDirection": [1, 0, 0, 1], "BSplineTransformSplineOrder": [1], "UseCyclicTransform": ["false"],
        }  # fmt: skip
        _write_elastix_file(path.with_name(first), note + history.json(**field.facts()), local | image)
    linear, center = _affine_parameters(transform, scale)
    affine = _elastix_parameters("AffineTransform", linear, first) | {"CenterOfRotationPoint": center}
    after = {
        "ResampleInterpolator": ["FinalBSplineInterpolator"], "FinalBSplineInterpolationOrder": [1],
        "Resampler": ["DefaultResampler"], "DefaultPixelValue": [_OUTSIDE], "ResultImageFormat": ["nrrd"],
        "ResultImagePixelType": ["float"], "CompressResultImage": ["false"],
    }  # fmt: skip
    _write_elastix_file(path, note + history.json(), affine | image | after)


def write_zarr(pair: TransformPair, path: Path, history: ExportHistory, _params: ExportParams) -> None:
    """Write a group for each direction: ``displacement_x`` and ``displacement_y`` (y, x) in um."""
    root = zarr.open_group(path, mode="w-", zarr_format=3)
    root.attrs.update({"format": _ZARR_FORMAT, "model": pair.model, "history": history.json()})
    for transform in (pair.forward, pair.back):
        source, target = transform.source, transform.target
        field = displacement(transform)
        group = root.create_group(transform.name)
        group.attrs.update({"source": source, "target": target} | field.facts())
        arrays: dict[str, tuple[Any, tuple[str, ...], str]] = {
            axis: (um, (axis,), f"{axis} of {source}") for axis, um in (("y", field.y_um), ("x", field.x_um))
        }
        for k, axis in enumerate("xy"):
            title = f"{axis} of {target} minus {axis} of {source}"
            arrays[f"displacement_{axis}"] = (field.vectors[..., k], ("y", "x"), title)
        for name, (numbers, dims, title) in arrays.items():
            array = group.create_array(name, shape=numbers.shape, dtype=numbers.dtype, dimension_names=dims)
            array[...] = numbers
            array.attrs.update({"units": "um", "long_name": title})


def write_landmarks(marks: xr.Dataset, path: Path, _history: ExportHistory, _params: ExportParams) -> None:
    """Write marks as landmarks of BigWarp."""
    write_any(marks, path, to="bigwarp")


def _affine_parameters(transform: DirectedTransform, scale: float) -> tuple[list[float], list[float]]:
    """Matrix and shift of the affine map, and the point around which it turns; ``scale`` turns um into its unit."""
    source, target = (np.array(point) * scale for point in (transform.affine.source, transform.affine.target))
    return [*transform.affine.matrix().ravel(), *(target - source)], list(source)


def _elastix_parameters(
    kind: str, parameters: Sequence[float] | np.ndarray, first: str
) -> dict[str, Sequence[object]]:  # fmt: skip
    return {
        "Transform": [kind], "NumberOfParameters": [len(parameters)],
        "TransformParameters": [float(v) for v in parameters],
        "InitialTransformParametersFileName": [first], "HowToCombineTransforms": ["Compose"],
        "FixedImageDimension": [2], "MovingImageDimension": [2], "FixedInternalImagePixelType": ["float"],
        "MovingInternalImagePixelType": ["float"],
    }  # fmt: skip


def _write_elastix_file(path: Path, note: str, parameters: Mapping[str, Sequence[object]]) -> None:
    lines = [note]
    for name, parts in parameters.items():
        words = [f'"{v}"' if isinstance(v, str) else f"{v:.12g}" for v in parts]  # type: ignore[str-format]
        lines.append(f"({name} {' '.join(words)})")
    _write_lines(path, lines)


def _numbers(numbers: Iterable[float]) -> str:
    return " ".join(f"{float(v):.12g}" for v in numbers)


def _write_lines(path: Path, lines: Iterable[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
