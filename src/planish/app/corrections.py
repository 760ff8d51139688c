"""Corrections of the faces between a session, where they are changes, and the files of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planish.app.changes import CorrectedPoint, Correction
from planish.study import Study
from planish.surface import Corrections, Stretch, read_corrections
from planish.surface.params import REACH_UM, Point


def corrections_of(study: Study) -> tuple[Correction, ...]:
    """The corrections that a run has, as a session begins with them."""
    corrections: list[Correction] = []
    for layer in study.layers:
        if layer.volume is None or layer.surface.corrections is None:
            continue
        for stretch in read_corrections(layer.surface.corrections).stretches:
            points = tuple(CorrectedPoint(z=p.z, y=p.y, x=p.x, face=p.face) for p in stretch.points)
            corrections.append(
                Correction(
                    id=f"c0-{len(corrections) + 1}", layer=layer.name, points=points, reach_um=stretch.reach_um,
                    note=stretch.note,
                )
            )  # fmt: skip
    return tuple(corrections)


def stretches_of(corrections: Sequence[Correction], layer: str, first: str) -> Corrections:
    """The corrections of one layer as its file has them; those that name none are of the ``first``."""
    return Corrections(
        stretches=tuple(
            Stretch(
                id=correction.id, points=tuple(Point(z=p.z, y=p.y, x=p.x, face=p.face) for p in correction.points),
                reach_um=correction.reach_um or REACH_UM, note=correction.note,
            )
            for correction in corrections
            if (correction.layer or first) == layer
        )
    )  # fmt: skip


def changed_corrections(
    study: Study, before: Sequence[Correction], now: Sequence[Correction]
) -> Mapping[str, Corrections]:
    """The corrections of each layer that has others than before."""
    volumes = [layer.name for layer in study.layers if layer.volume is not None]
    return {
        name: stretches
        for name in volumes
        if (stretches := stretches_of(now, name, volumes[0])) != stretches_of(before, name, volumes[0])
    }
