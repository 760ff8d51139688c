"""Write a run folder, whole or not at all."""

from dataclasses import replace
from pathlib import Path

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
    """Write all files of a run into ``folder``, which will stand at ``home``.

    On request, the files of its figures are written, too.

    The store ``store``, which holds some of its groups, becomes that of the run. A volume that was
    mapped on the way to a link of several layers stands in ``layers/NAME`` as a run of its own.
    Maps get smaller copies beside them, ``overviews/GROUP/1`` half as fine, ``/2`` half of that,
    and so on.
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
    write_study(
        _with_files_of_run(study, run, folder, home), folder, home=home, version=__version__
    )
    write_report(folder / "report.html", run, figures=folder / FIGURES if figures else None)
    stored = [] if store is None else store.stored
    if store is not None and store.path is not None and stored:
        move(store.path, folder / MAPS)
    for name, other_store in run.unchanged.items():
        take_group(folder / MAPS, other_store, name)
    groups = {name: data for name, data in run.groups.items() if name not in run.unchanged}
    for name, data in [*groups.items()]:
        has_overviews = name in ("maps", LINKED, "refined") or name.startswith("layers/")
        if has_overviews and f"{OVERVIEWS}/{name}/1" not in groups:
            groups |= {
                f"{OVERVIEWS}/{name}/{k}": smaller for k, smaller in enumerate(overviews(data), 1)
            }
    write_tree(folder / MAPS, {name: data for name, data in groups.items() if name not in stored})


def _with_files_of_run(study: Study, run: Run, folder: Path, final_folder: Path) -> Study:
    """Name the run's own files of marks and corrections in its study.

    They stand in place of those that they came from.

    Marks of another run are in this one too, with all that is known of them. Corrections of
    ``run.sheets`` stand in their folders by now.
    """

    def is_of_a_run(path: str | None) -> bool:  # such as edits/NAME/FILE of it
        return path is not None and any(is_run(folder) for folder in Path(path).parents[:3])

    marks_files = {
        name: str(final_folder / marks_file(run.results, name))
        for name, registration in run.registrations.items()
        if registration.source == "json"
    }
    correction_files = {name: f"layers/{name}/{CORRECTIONS}" for name in run.sheets}
    corrections_files = {
        name: str(final_folder / file) if (folder / file).is_file() else None
        for name, file in correction_files.items()
    }
    if "surfaces" in run.groups:
        corrections_text = made_corrections(run.groups["surfaces"])
        corrections_files[study.layers[0].name] = (
            str(final_folder / CORRECTIONS) if corrections_text else None
        )
        if corrections_text:
            (folder / CORRECTIONS).parent.mkdir(exist_ok=True)
            (folder / CORRECTIONS).write_text(corrections_text, encoding="utf-8", newline="\n")
    for layer in study.layers:
        if layer.name in marks_files and is_of_a_run(layer.marks):
            study = with_layer(study, layer.name, marks=marks_files[layer.name])
        if layer.kind == "volume" and layer.name in corrections_files:
            study = with_layer(
                study, layer.name, surface={"corrections": corrections_files[layer.name]}
            )
    if len(run.registrations) == 1 and marks_files and is_of_a_run(study.registration.marks):
        study = changed(study, registration={"marks": next(iter(marks_files.values()))})
    return study
