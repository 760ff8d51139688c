"""From a session to the study of a new run, with the files that it names: only what was changed is written."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from planish.app.changes import End, Mark, changed_corrections
from planish.app.picture import PLANES
from planish.app.session import Session, ends_of, places_of
from planish.core.files import free_path
from planish.marks.exchange import MarkPlaces, make_marks, marks_text
from planish.marks.regions import Region, Regions, geojson_text
from planish.marks.regions.model import ring_of
from planish.run.cached_maps import noted_study
from planish.run.regions import REGIONS
from planish.run.study import EDITS, LayerParams, Study, changed

STAGED = f"{EDITS}/.apply"
"""Hidden folder of a run where files of an order stand until the new run has its own."""


def order_of(session: Session, staged: Path) -> tuple[Study, dict[str, str]]:
    """Give the study of the new run of a session, and texts of files by name, which the study finds in ``staged``.

    Parameters
    ----------
    session : Session
        Where it stands as it began, so does the study, and no file is written.
    staged : Path
        Folder where the files will stand while the run is made.
    """
    study, holes = _original_run(session)
    first, state, files = session.first, session.state, dict[str, str]()
    usual_um, alone = float(np.mean(study.holes.hole_um)), len(state.marks) == 1
    for name, marks in state.marks.items():
        if marks == first.marks[name]:
            continue
        file = "marks.json" if alone else f"marks-{name}.json"
        files[file] = marks_text(all_marks(marks, holes[name], usual_um=usual_um))
        path = str(staged / file)
        if alone:
            study = changed(study, registration=changed(study.registration, marks=path))
        study = _with_layer(study, name, marks=None if alone else path)
    if state.model != first.model:
        study = changed(study, registration=changed(study.registration, model=state.model))
    if state.regions != first.regions:
        regions = tuple(
            Region(
                name=region.name, reason=region.reason, author=region.author,
                polygons=(tuple(ring_of(np.array(ring)) for ring in (region.polygon, *region.holes)),),
            )
            for region in state.regions
        )  # fmt: skip
        if regions:
            files[REGIONS] = geojson_text(Regions(declared=regions))
        study = changed(study, correlate=changed(study.correlate, regions=str(staged / REGIONS) if regions else None))
    for name, corrections in changed_corrections(study, first.corrections, state.corrections).items():
        file = f"surface-{name}.json"
        if corrections.stretches:
            files[file] = corrections.to_json()
        surface = next(layer.surface for layer in study.layers if layer.name == name)
        path = str(staged / file) if corrections.stretches else None
        study = _with_layer(study, name, surface=changed(surface, corrections=path))
    return study, files


def _with_layer(study: Study, name: str, **fields: Any) -> Study:
    layers = (changed(layer, **fields) if layer.name == name else layer for layer in study.layers)
    return changed(study, layers=tuple(layers))


def _original_run(session: Session) -> tuple[Study, Mapping[str, xr.Dataset]]:
    """Study of a run before any change, and all holes and marks by layer; of a map, those of its link to the image."""
    if session.image_params is None:
        return session.study, {name: registration.marks for name, registration in session.registrations.items()}
    sheet, study = session.study.layers[0], noted_study(session.folder) or session.study
    name = next((layer.name for layer in study.layers if layer.image is not None), "image")
    image = LayerParams(name=name, image=session.image_params)
    holes = session.holes(sheet.name)
    m, n = (holes[side].sizes["mark"] for side in PLANES)
    rows = {"moving": [*range(m), *[-1] * n], "fixed": [*[-1] * m, *range(n)]}
    labels = [f"{side} {k + 1}" for side, count in zip(PLANES, (m, n), strict=True) for k in range(count)]
    marks = make_marks(labels, {side: MarkPlaces.of_holes(holes[side], np.array(rows[side])) for side in PLANES})
    return study.model_copy(update={"layers": (sheet, image)}), {sheet.name: marks}


def place_of(run: Path, *, linked: bool) -> Path:
    """Choose the folder of the new run: ``RUN-2`` beside RUN, ``OUT`` of the ``OUT-map`` that is linked to an image."""
    if linked and (suffix := re.search(r"-map(-\d+)?$", run.name)) and suffix.start():
        return free_path(run.with_name(run.name[: suffix.start()]))
    return free_path(run)


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
        hole_of = _holes_around(ends[side], holes)
        for k, (end, number) in enumerate(zip(ends[side], hole_of, strict=True)):
            if end is not None:
                hole_um = None if number is None else holes[number].diameter
                ends[side][k] = end.model_copy(update={"diameter": end.diameter or hole_um or usual_um})
        free[side] = [hole for k, hole in enumerate(holes) if k not in hole_of]
    for side, unmarked in free.items():
        in_use = {*labels}
        names = (name for k in itertools.count(1) if (name := f"{side} {k}") not in in_use)
        labels = [*labels, *itertools.islice(names, len(unmarked))]
        used += [True] * len(unmarked)
        for other in PLANES:
            ends[other] += unmarked if other == side else [None] * len(unmarked)
    places = {side: places_of(ends[side]) for side in PLANES}
    return make_marks(labels, places, used=used, about=before.attrs.get("layers", {}))


def _holes_around(ends: Sequence[End | None], holes: Sequence[End]) -> list[int | None]:
    """Give the number of the nearest hole in which each end lies; None where it lies in none."""
    if not holes:
        return [None] * len(ends)
    points_um = np.array([(np.nan, np.nan) if end is None else end.xy for end in ends]).reshape(-1, 1, 2)
    distances = np.linalg.norm(points_um - np.array([hole.xy for hole in holes]), axis=2)
    distances[~(distances < 0.5 * np.array([hole.diameter or np.nan for hole in holes]))] = np.inf
    return [int(row.argmin()) if np.isfinite(row).any() else None for row in distances]
