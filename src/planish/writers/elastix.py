"""Transform parameters of elastix: an affine transform, behind a field of displacements as B-splines of first order."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from planish.writers.content import History
from planish.writers.field import Move, Moves, before_affine
from planish.writers.itk import UNITS
from planish.writers.params import ExportParams

_OUTSIDE = -1e30
"""Value of resampled pixels beside the image: elastix reads no NaN, and 0 would be taken for a measurement."""


def names(source: str, target: str, affine: bool) -> list[str]:
    """Names of the files in a folder."""
    ends = ("",) if affine else ("", "_local")
    return [f"{a}_to_{b}{end}.txt" for a, b in ((source, target), (target, source)) for end in ends]


def write_folder(moves: Moves, folder: Path, history: History, params: ExportParams) -> None:
    """Write both directions, ``NAME.txt`` for ``transformix -tp``, with ``NAME_local.txt`` where there is one.

    Notes
    -----
    elastix takes fixed points to moving points: ``image_to_sheet.txt`` brings maps of the sheet onto the image, and
    moves points of the image into the sheet. A B-spline of first order is linear between its nodes, whose coefficients
    are the displacements there.
    """
    for move in (moves.forward, moves.back):
        _write_move(move, folder, history, UNITS[params.unit])


def _write_move(move: Move, folder: Path, history: History, scale: float) -> None:
    affine = move.affine
    source, target = np.array(affine.source) * scale, np.array(affine.target) * scale
    first = "NoInitialTransform"
    # The image that transformix makes lies on the pixels of the source.
    rows, cols = move.grid.shape
    (x, y), (down, across) = move.grid.origin_um, move.grid.pixel_um
    image = {
        "Size": [cols, rows], "Index": [0, 0], "Spacing": [across * scale, down * scale],
        "Origin": [x * scale, y * scale],
        "Direction": [1, 0, 0, 1], "UseDirectionCosines": ["true"],
    }  # fmt: skip
    note = f"// {move.name}: takes points of {move.source} to {move.target}. "
    if not move.exact:
        field = before_affine(move)
        first = f"{move.name}_local.txt"
        values = np.moveaxis(field.values, -1, 0).ravel() * scale
        local = _common("BSplineTransform", values, "NoInitialTransform") | {
            "GridSize": [field.values.shape[1], field.values.shape[0]], "GridIndex": [0, 0],
            "GridSpacing": [v * scale for v in field.pitch_um], "GridOrigin": [v * scale for v in field.origin_um],
            "GridDirection": [1, 0, 0, 1], "BSplineTransformSplineOrder": [1], "UseCyclicTransform": ["false"],
        }  # fmt: skip
        _put(folder / first, note + history.json(**field.facts()), local | image)
    values = [*affine.matrix().ravel(), *(target - source)]
    linear = _common("AffineTransform", values, first) | {"CenterOfRotationPoint": list(source)}
    after = {
        "ResampleInterpolator": ["FinalBSplineInterpolator"], "FinalBSplineInterpolationOrder": [1],
        "Resampler": ["DefaultResampler"], "DefaultPixelValue": [_OUTSIDE], "ResultImageFormat": ["nrrd"],
        "ResultImagePixelType": ["float"], "CompressResultImage": ["false"],
    }  # fmt: skip
    _put(folder / f"{move.name}.txt", note + history.json(), linear | image | after)


def _common(kind: str, values: Sequence[float] | np.ndarray, first: str) -> dict[str, Sequence[object]]:
    return {
        "Transform": [kind], "NumberOfParameters": [len(values)], "TransformParameters": [float(v) for v in values],
        "InitialTransformParametersFileName": [first], "HowToCombineTransforms": ["Compose"],
        "FixedImageDimension": [2], "MovingImageDimension": [2], "FixedInternalImagePixelType": ["float"],
        "MovingInternalImagePixelType": ["float"],
    }  # fmt: skip


def _put(path: Path, note: str, values: dict[str, Sequence[object]]) -> None:
    lines = [note]
    for name, parts in values.items():
        words = [f'"{v}"' if isinstance(v, str) else f"{v:.12g}" for v in parts]  # type: ignore[str-format]
        lines.append(f"({name} {' '.join(words)})")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
