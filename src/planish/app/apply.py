"""From a session to the study of a new run, with the files that it names: only what was changed is written."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from planish.app.changes import End, Mark, State, changed_corrections
from planish.app.picture import PLANES
from planish.app.session import Session, ends_of, places_of
from planish.core.files import free_path
from planish.core.typing import Bools
from planish.marks.exchange import MarkPlaces, make_marks, marks_text
from planish.marks.regions import Region, Regions, geojson_text
from planish.marks.regions.model import ring_of
from planish.run.cached_maps import noted_study
from planish.run.regions import REGIONS
from planish.run.study import EDITS, LayerParams, Study, changed

STAGED = f"{EDITS}/.apply"
"""Hidden folder of a run where files of an order stand until the new run has its own."""

_OF_A_MAP = re.compile(r"-map(-\d+)?$")


@dataclass(frozen=True, slots=True, kw_only=True)
class OriginalRun:
    """A run as it was before anything was changed.

    Attributes
    ----------
    study : Study
        With absolute paths; of a map that is linked to an image in the session, the study of that link.
    state : State
    marks : mapping of str to Dataset (mark)
        All holes and marks of each registration, matched or not, by the name of the moving layer.
    """

    study: Study
    state: State
    marks: Mapping[str, xr.Dataset]

    @classmethod
    def of(cls, session: Session) -> OriginalRun:
        """Give the run that a session began with."""
        if session.image_params is None:
            marks = {name: registration.marks for name, registration in session.registrations.items()}
            return cls(study=session.study, state=session.first, marks=marks)
        sheet, noted = session.study.layers[0], noted_study(session.folder)
        study = session.study if noted is None else noted
        name = next((layer.name for layer in study.layers if layer.image is not None), "image")
        image = LayerParams(name=name, image=session.image_params)
        holes = session.holes(sheet.name)
        rows = {side: np.arange(holes[side].sizes["mark"]) for side in PLANES}
        unpaired_rows = {
            "moving": np.append(rows["moving"], rows["fixed"] * 0 - 1),
            "fixed": np.append(rows["moving"] * 0 - 1, rows["fixed"]),
        }
        labels = [f"{side} {k + 1}" for side in PLANES for k in rows[side]]
        marks = make_marks(labels, {side: MarkPlaces.of_holes(holes[side], unpaired_rows[side]) for side in PLANES})
        return cls(
            study=study.model_copy(update={"layers": (sheet, image)}), state=session.first, marks={sheet.name: marks}
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOrder:
    """What a new run is made of: its study, and texts of files by name, which the study finds in ``staged``."""

    study: Study
    files: Mapping[str, str]


def order_of(original: OriginalRun, state: State, staged: Path) -> RunOrder:
    """Give the study of a session, and the files that it names.

    Parameters
    ----------
    original : OriginalRun
    state : State
        What is to be applied. Where it is as it was, so is the study, and no file is written.
    staged : Path
        Folder where the files of the order will stand while the run is made.
    """
    files: dict[str, str] = {}
    study = _with_marks(original, state, staged, files)
    if state.model != original.state.model:
        study = changed(study, registration=changed(study.registration, model=state.model))
    if state.regions != original.state.regions:
        path = None
        if state.regions:
            regions = tuple(
                Region(
                    name=region.name, reason=region.reason, author=region.author,
                    polygons=(tuple(ring_of(np.array(ring)) for ring in (region.polygon, *region.holes)),),
                )
                for region in state.regions
            )  # fmt: skip
            path, files[REGIONS] = str(staged / REGIONS), geojson_text(Regions(declared=regions))
        study = changed(study, correlate=changed(study.correlate, regions=path))
    for name, corrections in changed_corrections(study, original.state.corrections, state.corrections).items():
        path = None
        if corrections.stretches:
            path = str(staged / f"surface-{name}.json")
            files[f"surface-{name}.json"] = corrections.to_json()
        layers = (
            changed(layer, surface=changed(layer.surface, corrections=path)) if layer.name == name else layer
            for layer in study.layers
        )
        study = changed(study, layers=tuple(layers))
    return RunOrder(study=study, files=files)


def place_of(run: Path, *, linked: bool) -> Path:
    """Choose the folder of the new run: ``RUN-2`` beside RUN, ``OUT`` of the ``OUT-map`` that is linked to an image."""
    if linked and (suffix := _OF_A_MAP.search(run.name)) and suffix.start():
        return free_path(run.with_name(run.name[: suffix.start()]))
    return free_path(run)


# --- marks -----------------------------------------------------------------------------------------------------------


def _with_marks(original: OriginalRun, state: State, staged: Path, files: dict[str, str]) -> Study:
    """The study with the marks of each registration that has others than before."""
    study, usual_um = original.study, float(np.mean(original.study.holes.hole_um))
    alone = len(state.marks) == 1
    for name, marks in state.marks.items():
        if marks == original.state.marks[name]:
            continue
        file = "marks.json" if alone else f"marks-{name}.json"
        files[file] = marks_text(all_marks(marks, original.marks[name], usual_um=usual_um))
        path = str(staged / file)
        if alone:
            study = changed(study, registration=changed(study.registration, marks=path))
        layers = (changed(m, marks=None if alone else path) if m.name == name else m for m in study.layers)
        study = changed(study, layers=tuple(layers))
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
    ends = {side: [getattr(mark, side) for mark in marks] for side in PLANES}
    labels, used = [mark.label for mark in marks], [mark.used for mark in marks]
    free: dict[str, list[End]] = {}
    for side in PLANES:
        holes = [end for end in ends_of(before, side) if end is not None]
        inside = _ends_in_holes(ends[side], holes)
        size = [next((holes[k].diameter for k in np.flatnonzero(row)), None) or usual_um for row in inside]
        ends[side] = [
            end.model_copy(update={"diameter": end.diameter or um}) if end is not None else None
            for end, um in zip(ends[side], size, strict=True)
        ]
        free[side] = [hole for k, hole in enumerate(holes) if not inside[:, k].any()]
    for side, unmarked in free.items():
        in_use = {*labels}
        names = (name for k in itertools.count(1) if (name := f"{side} {k}") not in in_use)
        labels = [*labels, *itertools.islice(names, len(unmarked))]
        used += [True] * len(unmarked)
        for other in PLANES:
            ends[other] += unmarked if other == side else [None] * len(unmarked)
    places = {side: places_of(ends[side]) for side in PLANES}
    return make_marks(labels, places, used=used, about=before.attrs.get("layers", {}))


def _ends_in_holes(ends: Sequence[End | None], holes: Sequence[End]) -> Bools:
    """Tell which end (rows) lies in which hole (columns): each in the nearest at most."""
    is_inside = np.zeros((len(ends), len(holes)), dtype=bool)
    if not is_inside.size:
        return is_inside
    points_um = np.array([(np.nan, np.nan) if end is None else end.xy for end in ends])
    distances = np.linalg.norm(points_um[:, None] - np.array([hole.xy for hole in holes]), axis=2)
    distances[~(distances < 0.5 * np.array([hole.diameter or np.nan for hole in holes]))] = np.inf
    rows, nearest = np.arange(len(ends)), distances.argmin(axis=1)
    is_inside[rows, nearest] = np.isfinite(distances[rows, nearest])
    return is_inside
