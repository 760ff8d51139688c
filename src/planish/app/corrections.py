"""Corrections of the faces between a session, where they are changes, and the files of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planish.app.changes import CorrectedPoint, Correction
from planish.study import Study
from planish.surface import Corrections, Stretch, read_corrections
from planish.surface.corrections import REACH_UM, Point


def corrections_of(study: Study) -> tuple[Correction, ...]:
    """The corrections that a run has, as a session begins with them."""
    found: list[Correction] = []
    for layer in study.layers:
        if layer.volume is None or layer.surface.corrections is None:
            continue
        for stretch in read_corrections(layer.surface.corrections).stretches:
            points = tuple(CorrectedPoint(z=p.z, y=p.y, x=p.x, face=p.face) for p in stretch.points)
            found.append(
                Correction(
                    id=f"c0-{len(found) + 1}", layer=layer.name, points=points, reach_um=stretch.reach_um,
                    note=stretch.note,
                )
            )  # fmt: skip
    return tuple(found)


def stretches_of(corrections: Sequence[Correction], layer: str, first: str) -> Corrections:
    """The corrections of one layer as its file has them; those that name none are of the ``first``."""
    return Corrections(
        stretches=tuple(
            Stretch(
                id=one.id, points=tuple(Point(z=p.z, y=p.y, x=p.x, face=p.face) for p in one.points),
                reach_um=one.reach_um or REACH_UM, note=one.note,
            )
            for one in corrections
            if (one.layer or first) == layer
        )
    )  # fmt: skip


def changed_corrections(
    study: Study, before: Sequence[Correction], now: Sequence[Correction]
) -> Mapping[str, Corrections]:
    """The corrections of each layer that has others than before."""
    volumes = [layer.name for layer in study.layers if layer.volume is not None]
    if not volumes:
        return {}
    found = {
        name: (stretches_of(before, name, volumes[0]), stretches_of(now, name, volumes[0])) for name in volumes
    }  # fmt: skip
    return {name: new for name, (old, new) in found.items() if old != new}
