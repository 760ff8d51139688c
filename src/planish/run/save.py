"""Write a run folder, whole or not at all."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import xarray as xr

from planish import __version__
from planish.core.area import overviews
from planish.core.files import move
from planish.io.map_groups import take_group, write_tree
from planish.io.map_store import OVERVIEWS, StoredMaps, stored_group
from planish.io.run_folder import new_folder
from planish.marks import write_marks
from planish.marks.regions import geojson_text
from planish.report import FIGURES, write_report
from planish.run.compute import Progress
from planish.run.facts import figures_text
from planish.run.judging import judge_sheet
from planish.run.overlay import LINKED
from planish.run.regions import REGIONS
from planish.run.run import MAPS, Run, is_run, marks_file
from planish.run.sheet import CORRECTIONS, made_corrections
from planish.run.study import Study, changed, with_layer, write_study


def write_run(
    run: Run,
    out: Path | None,
    *,
    inside: Path | None,
    store: StoredMaps,
    progress: Progress,
    figures: bool = False,
) -> Run:
    """Write a run to ``out`` by way of the hidden folder ``inside``, whole or not at all.

    ``store`` holds some of its groups. The run comes back with what stands there now; without
    ``out`` nothing is written.
    """
    if out is None or inside is None:
        return replace(run, unchanged={})
    progress("write", str(out))
    # About the bytes of its pages, and of its maps, which hold noise, with overviews.
    needed_bytes = 5_000_000 + sum(data.nbytes for data in run.groups.values()) * 4 // 3
    with new_folder(out, inside=inside, needed=needed_bytes) as folder:
        save_run(run, folder, home=out, store=store, figures=figures)
    stored_groups = {name: stored_group(out / MAPS, name) for name in store.stored}
    return replace(run, groups={**run.groups, **stored_groups}, unchanged={})


def save_run(
    run: Run, folder: Path, *, home: Path, store: StoredMaps | None = None, figures: bool = False
) -> None:
    """Write all files of a run.

    A volume that was mapped on the way to a link of several layers stands in ``layers/NAME`` as a
    run of its own. Maps get smaller copies beside them, ``overviews/GROUP/1`` half as fine, ``/2``
    half of that, and so on.

    Parameters
    ----------
    run : Run
    folder : path
        The files are written into it.
    home : path
        Place where the folder will stand.
    store : StoredMaps, optional
        Holds some of its groups; it becomes that of the run.
    figures : bool
        The files of its figures are written, too.
    """
    for name, sheet in run.sheets.items():
        sheet_folder = folder / "layers" / name
        sheet_folder.mkdir(parents=True)
        save_run(judge_sheet(run.study, sheet), sheet_folder, home=home / "layers" / name)
    for name, registration in run.registrations.items():
        path = folder / marks_file(run.results, name)
        registration.save(path)
        write_marks(registration.pairs(), path.with_suffix(".csv"))
    (folder / "results.json").write_text(run.results.to_json(), encoding="utf-8", newline="\n")
    (folder / "figures.csv").write_text(figures_text(run.results), encoding="utf-8", newline="\n")
    study = run.study
    if run.regions is not None:
        (folder / REGIONS).write_text(geojson_text(run.regions), encoding="utf-8", newline="\n")
        study = changed(study, correlate={"regions": str(home / REGIONS)})
    study = _with_corrections(_with_marks(study, run, home), run, folder, home)
    write_study(study, folder, home=home, version=__version__)
    write_report(folder / "report.html", run, figures=folder / FIGURES if figures else None)
    stored = [] if store is None else store.stored
    if store is not None and store.path is not None and stored:
        move(store.path, folder / MAPS)
    for name, unchanged_store in run.unchanged.items():
        take_group(folder / MAPS, unchanged_store, name)
    groups = {name: data for name, data in run.groups.items() if name not in run.unchanged}
    groups |= _missing_overviews(groups)
    write_tree(folder / MAPS, {name: data for name, data in groups.items() if name not in stored})


def _missing_overviews(groups: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Smaller copies of the maps that have none."""
    copies: dict[str, xr.Dataset] = {}
    for name, data in groups.items():
        has_maps = name in ("maps", LINKED, "refined") or name.startswith("layers/")
        if has_maps and f"{OVERVIEWS}/{name}/1" not in groups:
            for k, smaller in enumerate(overviews(data), 1):
                copies[f"{OVERVIEWS}/{name}/{k}"] = smaller
    return copies


def _with_marks(study: Study, run: Run, home: Path) -> Study:
    """Name the run's own files of marks in its study, in place of those of another run.

    All that is known of these marks is in them.
    """
    files = {
        name: str(home / marks_file(run.results, name))
        for name, registration in run.registrations.items()
        if registration.source == "json"
    }
    for layer in study.layers:
        if layer.name in files and _is_of_a_run(layer.marks):
            study = with_layer(study, layer.name, marks=files[layer.name])
    if len(run.registrations) == 1 and files and _is_of_a_run(study.registration.marks):
        study = changed(study, registration={"marks": next(iter(files.values()))})
    return study


def _is_of_a_run(path: str | None) -> bool:
    """Whether a file lies in a run, such as edits/NAME/FILE of it."""
    return path is not None and any(map(is_run, Path(path).parents[:3]))


def _with_corrections(study: Study, run: Run, folder: Path, home: Path) -> Study:
    """Name the run's own files of corrections in its study.

    Those of ``run.sheets`` stand in their folders by now.
    """
    files = {name: f"layers/{name}/{CORRECTIONS}" for name in run.sheets}
    if "surfaces" in run.groups:
        files[study.layers[0].name] = CORRECTIONS
        text = made_corrections(run.groups["surfaces"])
        if text:
            (folder / CORRECTIONS).parent.mkdir(exist_ok=True)
            (folder / CORRECTIONS).write_text(text, encoding="utf-8", newline="\n")
    for layer in study.layers:
        if layer.kind == "volume" and layer.name in files:
            file = files[layer.name]
            path = str(home / file) if (folder / file).is_file() else None
            study = with_layer(study, layer.name, surface={"corrections": path})
    return study
