"""Turn a session into the study of a new run, with the files that it names.

Only what was changed is written.
"""

import re
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import xarray as xr

from planish.app.changes import DrawnRegion, Mark, changed_corrections, free_names
from planish.app.picture import PLANES
from planish.app.session import Session, dataset_of
from planish.core.files import free_path
from planish.marks.exchange import marks_bytes
from planish.marks.exchange.model import join_holes, with_holes
from planish.marks.regions import Region, Regions, geojson_text
from planish.marks.regions.model import ring_of
from planish.run.cached_maps import noted_study
from planish.run.regions import REGIONS
from planish.run.study import EDITS, GivenLayer, Study, changed, with_layer

STAGING = f"{EDITS}/.apply"
"""Hidden folder of a run where files of an order stand until the new run has its own."""


def order_of(session: Session, staging: Path) -> tuple[Study, dict[str, str]]:
    """Give the study of a session's new run, and texts by name of its files in ``staging``.

    The study of the run stays but for what was changed; where something was taken out altogether,
    the study names no file for it.
    """
    study, holes = _original_run(session)
    original = session.first
    state = session.state
    file_texts = dict[str, str]()
    default_diameter_um = float(np.mean(study.holes.hole_um))
    is_only_layer = len(state.marks) == 1
    for name, marks in state.marks.items():
        if marks == original.marks[name]:
            continue
        file_name = "marks.json" if is_only_layer else f"marks-{name}.json"
        dataset = all_marks(marks, holes[name], default_diameter_um=default_diameter_um)
        file_texts[file_name] = marks_bytes(dataset, "json")[""].decode()
        path = str(staging / file_name)
        if is_only_layer:
            study = changed(study, registration={"marks": path})
        study = with_layer(study, name, marks=None if is_only_layer else path)
    if state.model != original.model:
        study = changed(study, registration={"model": state.model})
    if state.regions != original.regions:
        regions_path = None
        if state.regions:
            regions = Regions(declared=tuple(map(_region, state.regions)))
            file_texts[REGIONS] = geojson_text(regions)
            regions_path = str(staging / REGIONS)
        study = changed(study, correlate={"regions": regions_path})
    after = changed_corrections(study, original.corrections, state.corrections)
    for name, corrections in after.items():
        path = None
        if corrections.stretches:
            file_name = f"surface-{name}.json"
            file_texts[file_name] = corrections.to_json()
            path = str(staging / file_name)
        study = with_layer(study, name, surface={"corrections": path})
    return study, file_texts


def _region(drawn: DrawnRegion) -> Region:
    """The region of a polygon, as files of regions have it: its outer ring, and those of holes."""
    points = map(np.array, (drawn.polygon, *drawn.holes))
    rings = tuple(map(ring_of, points))
    return Region(name=drawn.name, reason=drawn.reason, author=drawn.author, polygons=(rings,))


def _original_run(session: Session) -> tuple[Study, Mapping[str, xr.Dataset]]:
    """Study of a run before any change, and all holes and marks by layer.

    Of a map, those of its link to the image.
    """
    if session.image_params is None:
        registrations = session.registrations
        return session.study, {layer: registrations[layer].marks for layer in registrations}
    sheet = session.study.layers[0]
    study = noted_study(session.folder) or session.study
    image_name = next((layer.name for layer in study.layers if layer.image is not None), "image")
    image = GivenLayer(name=image_name, image=session.image_params)
    holes = session.holes(sheet.name)
    marks = join_holes(holes["moving"], holes["fixed"]).assign_attrs(layers={})
    return study.model_copy(update={"layers": (sheet, image)}), {sheet.name: marks}


def new_run_folder(run: Path, *, linked: bool) -> Path:
    """Choose the folder of the new run.

    ``RUN-2`` beside RUN, or ``OUT`` of the ``OUT-map`` that is linked to an image.
    """
    if linked:
        run = run.with_name(re.sub(r"(?<=.)-map(-\d+)?$", "", run.name))
    return free_path(run)


def all_marks(
    marks: Sequence[Mark], run_marks: xr.Dataset, *, default_diameter_um: float
) -> xr.Dataset:
    """Marks of a session as files have them, and the holes in which none of them lies.

    These holes are masked too.

    ``run_marks`` are all marks of the run, matched or not, as ``marks.json`` has them. An end of a
    mark keeps what it says of itself; without a diameter it takes that of the hole in which it
    lies, or ``default_diameter_um``.
    """
    dataset = dataset_of(marks, about=run_marks.attrs.get("layers", {}))
    labels = [mark.label for mark in marks]
    for side in PLANES:
        dataset = with_holes(dataset, run_marks, side, usual_um=default_diameter_um)
        n_added = dataset.sizes["mark"] - len(labels)
        labels += islice(free_names(side, {*labels}), n_added)
    return dataset.assign(label=("mark", np.array(labels, np.str_)))
