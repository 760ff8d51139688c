"""From a session to the study of a new run, with the files that it names: only what was changed is written."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from planish.app.changes import Mark, changed_corrections
from planish.app.picture import PLANES
from planish.app.session import Session, dataset_of
from planish.core.files import free_path
from planish.marks.exchange import marks_bytes
from planish.marks.exchange.model import join_holes, with_holes
from planish.marks.regions import Region, Regions, geojson_text
from planish.marks.regions.model import ring_of
from planish.run.cached_maps import noted_study
from planish.run.regions import REGIONS
from planish.run.study import EDITS, LayerParams, Study, changed, with_layer

STAGED = f"{EDITS}/.apply"
"""Hidden folder of a run where files of an order stand until the new run has its own."""


def order_of(session: Session, staged: Path) -> tuple[Study, dict[str, str]]:
    """Give the study of the new run of a session, and texts of files by name, which the study finds in ``staged``.

    Where a session stands as it began, so does the study, and there are no files.
    """
    study, holes = _original_run(session)
    first, state, files = session.first, session.state, dict[str, str]()
    usual_um, alone = float(np.mean(study.holes.hole_um)), len(state.marks) == 1
    for name, marks in state.marks.items():
        if marks == first.marks[name]:
            continue
        file = "marks.json" if alone else f"marks-{name}.json"
        files[file] = marks_bytes(all_marks(marks, holes[name], usual_um=usual_um), "json")[""].decode()
        path = str(staged / file)
        if alone:
            study = changed(study, registration={"marks": path})
        study = with_layer(study, name, marks=None if alone else path)
    if state.model != first.model:
        study = changed(study, registration={"model": state.model})
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
        study = changed(study, correlate={"regions": str(staged / REGIONS) if regions else None})
    for name, corrections in changed_corrections(study, first.corrections, state.corrections).items():
        file = f"surface-{name}.json"
        if corrections.stretches:
            files[file] = corrections.to_json()
        path = str(staged / file) if corrections.stretches else None
        study = with_layer(study, name, surface={"corrections": path})
    return study, files


def _original_run(session: Session) -> tuple[Study, Mapping[str, xr.Dataset]]:
    """Study of a run before any change, and all holes and marks by layer; of a map, those of its link to the image."""
    if session.image_params is None:
        return session.study, {name: registration.marks for name, registration in session.registrations.items()}
    sheet, study = session.study.layers[0], noted_study(session.folder) or session.study
    name = next((layer.name for layer in study.layers if layer.image is not None), "image")
    image = LayerParams(name=name, image=session.image_params)
    holes = session.holes(sheet.name)
    marks = join_holes(holes["moving"], holes["fixed"]).assign_attrs(layers={})
    return study.model_copy(update={"layers": (sheet, image)}), {sheet.name: marks}


def place_of(run: Path, *, linked: bool) -> Path:
    """Choose the folder of the new run: ``RUN-2`` beside RUN, ``OUT`` of the ``OUT-map`` that is linked to an image."""
    if linked and (suffix := re.search(r"-map(-\d+)?$", run.name)) and suffix.start():
        return free_path(run.with_name(run.name[: suffix.start()]))
    return free_path(run)


def all_marks(marks: Sequence[Mark], before: xr.Dataset, *, usual_um: float) -> xr.Dataset:
    """Marks of a session as files have them, and the holes in which none of them lies: these are masked too.

    ``before`` are all marks of the run, matched or not, as ``marks.json`` has them. An end of a mark keeps what it says
    of itself; without a diameter it takes that of the hole in which it lies, or ``usual_um``.
    """
    joined = dataset_of(marks, about=before.attrs.get("layers", {}))
    labels = [mark.label for mark in marks]
    for side in PLANES:
        joined, in_use = with_holes(joined, before, side, usual_um=usual_um), {*labels}
        names = (name for k in itertools.count(1) if (name := f"{side} {k}") not in in_use)
        labels += itertools.islice(names, joined.sizes["mark"] - len(labels))
    return joined.assign(label=("mark", np.array(labels, dtype=np.str_)))
