"""A map as a matrix of text: what it is in lines with ``#``, then a line for each row, with tabs between."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.writers.content import History, Maps
from planish.writers.params import ExportParams

_AT_ONCE = 200_000  # numbers that are texts at a time


def write(maps: Maps, path: Path, history: History, _params: ExportParams) -> None:
    """Write one map; numbers read back to the same float32."""
    (name,) = maps.names
    (down, across), (top, left) = maps.pixel_um, maps.origin_um
    x, y = maps.dims[1], maps.dims[0]
    head = [
        f"{name}: {maps.title(name)}", f"unit: {maps.units(name)}",
        f"pixel: {across!r} um along {x}, {down!r} um along {y}",
        f"middle of the first pixel: {x} = {left!r} um, {y} = {top!r} um",
        f"{maps.shape[0]} rows, {maps.shape[1]} columns; missing: NaN", history.json(**maps.facts()),
    ]  # fmt: skip
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"# {line}\n" for line in head)
        for _, values in maps.bands(name, np.float32):
            step = max(1, _AT_ONCE // values.shape[1])
            for begin in range(0, len(values), step):
                file.writelines("\t".join(row) + "\n" for row in as_text(values[begin : begin + step]))


def as_text(values: NDArray[Any]) -> list[list[str]]:
    """Numbers (rows, cols) as the shortest texts that read back to the same float32; whole numbers without a point."""
    rows = values.astype(np.float32)
    return [[_short(text) for text in row] for row in rows.astype("U").tolist()]


def _short(text: str) -> str:
    return "NaN" if text == "nan" else text.removesuffix(".0")
