"""ITK transforms as text, ``.tfm``: an affine transform, or a composite of one with a displacement field before it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from planish.writers.content import History
from planish.writers.field import Move, Moves, before_affine
from planish.writers.params import ExportParams

UNITS = {"um": 1.0, "mm": 1e-3}


def write(moves: Moves, path: Path, history: History, params: ExportParams) -> None:
    """Write the transform from the moving to the fixed layer.

    Notes
    -----
    A composite applies its last transform first. Points are those of planish, x and y in the unit asked for; images
    whose first pixel lies elsewhere than at 0 need their origin.
    """
    write_move(moves.forward, path, history, UNITS[params.unit])


def names(source: str, target: str, _affine: bool) -> list[str]:
    """Names of the files in a folder."""
    return [f"{source}_to_{target}.tfm", f"{target}_to_{source}.tfm"]


def write_folder(moves: Moves, folder: Path, history: History, params: ExportParams) -> None:
    """Write both directions: one takes points from the moving to the fixed layer, the other resamples images."""
    for move in (moves.forward, moves.back):
        write_move(move, folder / f"{move.name}.tfm", history, UNITS[params.unit])


def write_move(move: Move, path: Path, history: History, scale: float) -> None:
    """Write one transform; ``scale`` turns um into its unit."""
    affine = move.affine
    source, target = np.array(affine.source) * scale, np.array(affine.target) * scale
    linear = ("AffineTransform_double_2_2", [*affine.matrix().ravel(), *(target - source)], list(source))
    parts: list[tuple[str, Iterable[float], Iterable[float]]] = [linear]
    facts: dict[str, float] = {}
    if not move.exact:
        field = before_affine(move)
        facts = field.facts()
        rows, cols = field.values.shape[:2]
        fixed = [cols, rows, *(scale * v for v in (*field.origin_um, *field.pitch_um)), 1, 0, 0, 1]
        values = (field.values * scale).ravel()
        parts = [
            ("CompositeTransform_double_2_2", [], []),
            linear,
            ("DisplacementFieldTransform_double_2_2", values, fixed),
        ]
    lines = ["#Insight Transform File V1.0", f"#{move.name}: {history.json(**facts)}"]
    for k, (kind, values, fixed) in enumerate(parts):
        lines += [f"#Transform {k}", f"Transform: {kind}"]
        if not kind.startswith("Composite"):
            lines += [f"Parameters: {_numbers(values)}", f"FixedParameters: {_numbers(fixed)}"]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{float(v):.12g}" for v in values)
