"""From a session to the study of a new run, with the files that it names: only what was changed is written."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.app.changes import End, Mark, State
from planish.app.changes import Region as Drawn
from planish.core.files import free_path
from planish.marks.files import Places, holes_of, layer_names, make_marks, marks_text
from planish.marks.regions import Region, Regions, geojson_text
from planish.marks.regions.model import ring_of
from planish.study import Study

Floats = NDArray[np.float64]

STAGED = ".apply"
"""Hidden folder in ``edits`` of a run, where files stand until the new run has its own."""

_SIDES = ("moving", "fixed")
_EXTRAS = ("cov_xx", "cov_xy", "cov_yy", "diameter", "axis_ratio", "arc_coverage")
_OF_A_MAP = re.compile(r"-map(-\d+)?$")


@dataclass(frozen=True, slots=True, kw_only=True)
class Before:
    """A run as it was before anything was changed.

    Attributes
    ----------
    study : Study
        With absolute paths; of a map that is linked to an image in the session, the study of that link.
    state : State
    marks : mapping of str to Dataset (mark)
        All holes and marks of each registration, by the name of the moving layer.
    regions : Regions or None
        Declared artefacts as the run has them.
    """

    study: Study
    state: State
    marks: Mapping[str, xr.Dataset]
    regions: Regions | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What a new run is made of: its study, and texts of files by name, which the study finds in ``staged``."""

    study: Study
    files: Mapping[str, str] = field(default_factory=dict[str, str])


def order_of(before: Before, state: State, staged: Path) -> Order:
    """The study of a session.

    Parameters
    ----------
    before : Before
    state : State
        What is to be applied. Where it is as it was, so is the study, and no file is written.
    staged : Path
        Folder where the files of the order will stand while the run is made.

    Returns
    -------
    Order
    """
    files: dict[str, str] = {}
    study = _with_marks(before, state, staged, files)
    if state.model != before.state.model:
        registration = study.registration.model_copy(update={"model": state.model})
        study = study.model_copy(update={"registration": registration})
    if state.regions != before.state.regions:
        regions = None
        if state.regions:
            regions, files["regions.geojson"] = str(staged / "regions.geojson"), geojson_text(_regions(before, state))
        study = study.model_copy(update={"correlate": study.correlate.model_copy(update={"regions": regions})})
    return Order(study=study, files=files)


def place_of(run: Path, *, linked: bool) -> Path:
    """Where the new run will stand: ``RUN-2`` beside RUN, ``OUT`` of the ``OUT-map`` that is linked to an image."""
    if linked and (found := _OF_A_MAP.search(run.name)) and found.start():
        return free_path(run.with_name(run.name[: found.start()]))
    return free_path(run.with_name(f"{run.name}-2"))


# --- marks -----------------------------------------------------------------------------------------------------------


def _with_marks(before: Before, state: State, staged: Path, files: dict[str, str]) -> Study:
    """The study with the marks of each registration that has others than before."""
    study, usual_um = before.study, float(np.mean(before.study.holes.hole_um))
    changed = {name: marks for name, marks in state.marks.items() if marks != before.state.marks.get(name, ())}
    alone = len(state.marks) == 1
    for name, marks in changed.items():
        file = "marks.json" if alone else f"marks-{name}.json"
        files[file] = marks_text(all_marks(marks, before.marks[name], usual_um=usual_um))
        own = None if alone else str(staged / file)
        layers = tuple(
            layer.model_copy(update={"marks": own}) if layer.name == name else layer for layer in study.layers
        )
        study = study.model_copy(update={"layers": layers})
        if alone:
            registration = study.registration.model_copy(update={"marks": str(staged / file)})
            study = study.model_copy(update={"registration": registration})
    return study


def all_marks(marks: Sequence[Mark], before: xr.Dataset, *, usual_um: float) -> xr.Dataset:
    """Marks of a session as files have them, and the holes in which none of them lies: these are masked too.

    Parameters
    ----------
    marks : sequence of Mark
        Used or not, with one end or both. An end keeps what it says of itself; without a diameter it takes that of the
        hole in which it lies, or ``usual_um``.
    before : Dataset (mark)
        All marks of the run, matched or not, as ``marks.json`` has them.
    usual_um : float

    Returns
    -------
    Dataset (mark)
    """
    ends = {side: [getattr(mark, side) for mark in marks] for side in _SIDES}
    labels, used = [mark.label for mark in marks], [mark.used for mark in marks]
    holes = {side: holes_of(before, side) for side in _SIDES if side in layer_names(before)}
    free: dict[str, list[End]] = {}
    for side, found in holes.items():
        inside = _inside(ends[side], found)
        ends[side] = [
            end if end is None or end.diameter is not None else end.model_copy(
                update={"diameter": float(found["diameter"].values[row.argmax()]) if row.any() else usual_um}
            )
            for end, row in zip(ends[side], inside, strict=True)
        ]  # fmt: skip
        free[side] = _holes(found, np.flatnonzero(~inside.any(axis=0)), before, side)
    for side, more in free.items():
        labels += _labels(side, len(more), {*labels})
        used += [True] * len(more)
        for other in _SIDES:
            ends[other] += more if other == side else [None] * len(more)
    places = {side: _places(ends[side]) for side in _SIDES}
    return make_marks(labels, places, used=used, about=before.attrs.get("layers", {}))


def _inside(ends: Sequence[End | None], holes: xr.Dataset) -> NDArray[np.bool_]:
    """Which end (rows) lies in which hole (columns): each in the nearest at most."""
    found = np.zeros((len(ends), holes.sizes["mark"]), dtype=bool)
    if not found.size:
        return found
    at = np.array([(np.nan, np.nan) if end is None else end.xy for end in ends])
    apart = np.linalg.norm(at[:, None] - np.stack([holes["x"].values, holes["y"].values], axis=1), axis=2)
    known = np.where(apart < 0.5 * holes["diameter"].values, apart, np.inf)
    nearest = known.argmin(axis=1)
    rows = np.arange(len(ends))
    found[rows, nearest] = np.isfinite(known[rows, nearest])
    return found


def _holes(holes: xr.Dataset, rows: NDArray[np.intp], before: xr.Dataset, side: str) -> list[End]:
    """Some holes as ends of marks."""
    sources = before[f"{side}_source"].values[np.isfinite(before[f"{side}_x"].values)]
    known = [name for name in _EXTRAS if name in holes]
    return [
        End.model_validate(
            {"x": float(holes["x"].values[k]), "y": float(holes["y"].values[k]), "source": str(sources[k])}
            | {name: v for name in known if np.isfinite(v := float(holes[name].values[k]))}
        )
        for k in rows
    ]


def _labels(side: str, count: int, taken: set[str]) -> list[str]:
    names = (name for k in range(1, count + len(taken) + 1) if (name := f"{side} {k}") not in taken)
    return [name for name, _ in zip(names, range(count), strict=False)]


def _places(ends: Sequence[End | None]) -> Places:
    def column(name: str) -> Floats:
        values = [None if end is None else getattr(end, name) for end in ends]
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)

    return Places(
        um=np.stack([column("x"), column("y")], axis=1),
        source=["imported" if end is None else end.source for end in ends],
        extras={name: column(name) for name in _EXTRAS},
    )


# --- regions ---------------------------------------------------------------------------------------------------------


def _regions(before: Before, state: State) -> Regions:
    """Declared regions: those that the run has with all their borders, others as they were drawn."""
    kept = dict(zip((one.id for one in before.state.regions), _declared(before), strict=False))
    return Regions(declared=tuple(kept.get(one.id) or _drawn(one) for one in state.regions))


def _declared(before: Before) -> tuple[Region, ...]:
    return () if before.regions is None else before.regions.declared


def _drawn(one: Drawn) -> Region:
    ring = ring_of(np.array(one.polygon))
    return Region(name=one.name, reason=one.reason, author=one.author, polygons=((ring,),))
