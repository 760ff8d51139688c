"""Write the files of a run into its folder."""

from pathlib import Path

from planish import __version__
from planish.core.area import overviews
from planish.core.files import move, write_text
from planish.io.map_groups import take_group, write_tree
from planish.io.map_store import OVERVIEWS, StoredMaps
from planish.marks import write_marks
from planish.marks.regions import geojson_text
from planish.report import FIGURES, write_report
from planish.run.facts import figures_text
from planish.run.judging import judge_sheet
from planish.run.layers import Datasets, Groups
from planish.run.overlay import LINKED
from planish.run.regions import REGIONS
from planish.run.run import MAPS, Run, is_run, marks_file
from planish.run.sheet import CORRECTIONS, made_corrections
from planish.run.study import Study, changed, with_layer, write_study


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
    write_text(folder / "results.json", run.results.to_json())
    write_text(folder / "figures.csv", figures_text(run.results))
    study = run.study
    if run.regions is not None:
        write_text(folder / REGIONS, geojson_text(run.regions))
        study = changed(study, correlate={"regions": str(home / REGIONS)})
    study = _with_corrections(_with_marks(study, run, home), run, folder, home)
    write_study(study, folder, home=home, version=__version__)
    write_report(folder / "report.html", run, figures=folder / FIGURES if figures else None)
    store = store or StoredMaps()
    if store.path is not None and store.stored:
        move(store.path, folder / MAPS)
    for name, unchanged_store in run.unchanged.items():
        take_group(folder / MAPS, unchanged_store, name)
    groups = {name: data for name, data in run.groups.items() if name not in run.unchanged}
    groups |= _missing_overviews(groups)
    new_names = [name for name in groups if name not in store.stored]
    write_tree(folder / MAPS, {name: groups[name] for name in new_names})


def _missing_overviews(groups: Groups) -> Datasets:
    """Smaller copies of the maps that have none."""
    copies: Datasets = {}
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
    for name, registration in run.registrations.items():
        if registration.source != "json":
            continue
        path = str(home / marks_file(run.results, name))
        if any(layer.name == name and _is_of_a_run(layer.marks) for layer in study.layers):
            study = with_layer(study, name, marks=path)
        if len(run.registrations) == 1 and _is_of_a_run(study.registration.marks):
            study = changed(study, registration={"marks": path})
    return study


def _is_of_a_run(path: str | None) -> bool:
    """Whether a file lies in a run, such as edits/NAME/FILE of it."""
    return path is not None and any(map(is_run, Path(path).parents[:3]))


def _with_corrections(study: Study, run: Run, folder: Path, home: Path) -> Study:
    """Name the run's own files of corrections in its study, and write that of its own sheet.

    Those of ``run.sheets`` stand in their folders by now. ``folder`` is where the run is written,
    ``home`` where it will stand. A layer without corrections names none.
    """
    files = {name: f"layers/{name}/{CORRECTIONS}" for name in run.sheets}
    if "surfaces" in run.groups:
        files[study.layers[0].name] = CORRECTIONS
        text = made_corrections(run.groups["surfaces"])
        if text:
            (folder / CORRECTIONS).parent.mkdir(exist_ok=True)
            write_text(folder / CORRECTIONS, text)
    for layer in study.layers:
        file = files.get(layer.name)
        if layer.kind == "volume" and file is not None:
            path = str(home / file) if (folder / file).is_file() else None
            study = with_layer(study, layer.name, surface={"corrections": path})
    return study
