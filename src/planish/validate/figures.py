"""Every figure of the error ledger: its name, its stage, its unit, and what is compared with what."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

_KINDS = (("bias", "mean error", "mean"), ("rmse", "rms error", "root mean square"),
          ("p95", "95 % error", "95th percentile of the absolute value"))  # fmt: skip

Values = dict[str, float | None]
"""Figure name -> value; None where a run has no such thing."""


class Figure(NamedTuple):
    """One number of the ledger."""

    name: str  # key in files and in a scenario's limits
    stage: str  # key of :data:`STAGES`
    unit: str  # ``um``, ``%``, ``deg``, ``pitch``, ``s``, or ``1`` for a plain number
    title: str  # for a table, under the title of its stage
    sentence: str  # what is compared with what
    # {"small", "large", "neither"}: which values are better; neither where the figure only describes.
    better: str = "small"


def _figures(stage: str, table: dict[str, Any]) -> Iterator[Figure]:
    for stem, (quantity, sentence) in table.get("errors", {}).items():
        for kind, title, mean in _KINDS:
            yield Figure(f"{stem}_{kind}", stage, "um", f"{quantity}, {title}", f"{mean} of {sentence}")
    for name, row in table.get("figures", {}).items():
        yield Figure(name, stage, *row)


_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
STAGES: dict[str, str] = {stage: table["title"] for stage, table in _TABLES.items()}
KEYS: dict[str, list[str]] = {stage: table["key"] for stage, table in _TABLES.items() if "key" in table}
FIGURES: dict[str, Figure] = {
    figure.name: figure for stage, table in _TABLES.items() for figure in _figures(stage, table)
}


def in_order(values: Values) -> Values:
    """Figures in the order of the line; what has no value is None, whole stages that are absent are left out."""
    stages = {FIGURES[name].stage for name in values}
    return {name: values.get(name) for name, figure in FIGURES.items() if figure.stage in stages}
