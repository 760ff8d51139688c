"""From a study to a run folder, whole or not at all."""

import secrets
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from planish import __version__
from planish.core.area import overviews
from planish.core.errors import PlanishError
from planish.core.files import move
from planish.core.memory import KEPT_SHARE
from planish.core.threads import limit_threads
from planish.io import fingerprint
from planish.io.map_groups import take_group, write_tree
from planish.io.map_store import OVERVIEWS, StoredMaps, stored_group
from planish.io.run_folder import new_folder, refuse_existing, refuse_inside, work_folder
from planish.marks import write_marks
from planish.marks.regions import Regions, geojson_text
from planish.report import FIGURES, write_report
from planish.run.cached_maps import CachedMaps, next_step, sheets_of
from planish.run.compute import Compute, Progress, return_memory, run_key, silent
from planish.run.facts import figures_text
from planish.run.gathering import LINKED, gather_sheet
from planish.run.layers import Layer
from planish.run.linking import link_layers, read_inputs
from planish.run.preflight import check_request
from planish.run.regions import REGIONS
from planish.run.run import MAPS, Run, is_run, marks_file
from planish.run.sheet import CORRECTIONS, made_corrections, map_layer
from planish.run.study import Study, changed, to_dict, with_layer, write_study


def run_study(
    study: Study,
    out: str | Path | None = None,
    *,
    compute: Compute | None = None,
    progress: Progress = silent,
    old: Path | None = None,
    figures: bool = False,
) -> Run:
    """Do what a study says, and write the run folder ``out`` where it is given.

    A run that was killed goes on where it stood when it is started again.

    Parameters
    ----------
    study : Study
    out : Path, optional
        Folder to make.
    compute : Compute, optional
        What the run may use.
    progress : callable, optional
        Called with the name of a stage and a few words.
    old : Path, optional
        A run of which stages are taken whose volume and parameters are the same.
    figures : bool
        Whether the run folder also holds the figures of the page as files, in ``figures``.

    Raises
    ------
    PlanishError
        Any of the tree in :mod:`planish.core.errors`; nothing is left at ``out`` then. What was
        mapped of a link stays beside it, as ``OUT-map``.
    """
    compute = compute or Compute()
    # What is free changes while a run works, and the width of its columns must not.
    fixed_compute = changed(compute, memory_bytes=compute.memory)
    return_memory(fixed_compute)
    with limit_threads(compute.threads):
        if out is None:
            regions = check_request(study, compute, held=True)
            return replace(_make(study, regions, {}, {}, fixed_compute, progress), unchanged={})
        out = Path(out)
        refuse_existing(out)
        refuse_inside(out, [layer.path for layer in study.layers])
        regions = check_request(study, compute)
        hashes = [hash_of_input(layer.path) for layer in study.layers]
        with work_folder(out, run_key(to_dict(study), hashes)) as work_dir:
            caches = CachedMaps.of_link(study, hashes, out, compute)
            sheets = {
                name: sheet for name, cache in caches.items() if (sheet := cache.read()) is not None
            }
            similar_sheets: dict[str, Layer] = {}
            if old is not None:
                ready_sheets, similar_sheets = sheets_of(old, study, hashes)
                sheets |= ready_sheets
            for name in sheets:
                progress("read", f"{name}, mapped before")
            sink_folder = (
                work_dir / f".{secrets.token_hex(4)}.partial" if len(study.layers) > 1 else None
            )
            sink = StoredMaps(sink_folder, keep_bytes=int(fixed_compute.memory * KEPT_SHARE))
            run = _make(
                study,
                regions,
                sheets,
                similar_sheets,
                fixed_compute,
                progress,
                caches=caches,
                work_dir=work_dir,
                sink=sink,
            )
            progress("write", str(out))
            # About the bytes of its pages, and of its maps, which hold noise, with overviews.
            needed_bytes = 5_000_000 + sum(data.nbytes for data in run.groups.values()) * 4 // 3
            with new_folder(out, inside=work_dir, needed=needed_bytes) as folder:
                save_run(run, folder, home=out, store=sink, figures=figures)
            stored_groups = {name: stored_group(out / MAPS, name) for name in sink.stored}
            return replace(run, groups={**run.groups, **stored_groups}, unchanged={})


def _make(
    study: Study,
    regions: Regions | None,
    ready_sheets: Mapping[str, Layer],
    similar_sheets: Mapping[str, Layer],
    compute: Compute,
    progress: Progress,
    *,
    caches: Mapping[str, CachedMaps] | None = None,
    work_dir: Path | None = None,
    sink: StoredMaps | None = None,
) -> Run:
    """Map the volumes that are not ready, and link the layers.

    Maps of a refused link are kept in ``caches``.
    """
    sheets, tile_dir, is_link = (
        {**ready_sheets},
        work_dir and work_dir / "tiles",
        len(study.layers) > 1,
    )
    try:
        # Volumes come last: what is wrong with images, runs, marks and regions should not cost
        # their time.
        link_inputs = read_inputs(study, regions, progress) if is_link else None
        for layer in study.layers:
            if layer.kind == "volume" and layer.name not in sheets:
                folder = tile_dir / layer.name if tile_dir is not None and is_link else tile_dir
                old_sheet = similar_sheets.get(layer.name)
                sheets[layer.name] = map_layer(
                    layer, compute=compute, progress=progress, tile_dir=folder, old_sheet=old_sheet
                )
        if link_inputs is None:
            return gather_sheet(sheets[study.layers[0].name], study)
        return link_layers(study, link_inputs, sheets, progress, sink or StoredMaps())
    except PlanishError as error:
        if not caches or work_dir is None:
            raise
        # a disk that is full now does not hide what was wrong before.
        with suppress(PlanishError, OSError):
            for name, cache in caches.items():
                if cache.path.exists():
                    cache.note(cache.path, study)
                elif name in sheets and name not in ready_sheets:
                    sheet = sheets[name]
                    with new_folder(cache.path, inside=work_dir) as folder:
                        save_run(
                            gather_sheet(sheet, Study(layers=(sheet.params,))),
                            folder,
                            home=cache.path,
                        )
                        cache.note(folder, study)
        if advice_text := next_step(error, caches, study):
            raise type(error)(f"{error.text} {advice_text}") from error
        raise


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
        save_run(gather_sheet(sheet, run.study), sheet_folder, home=home / "layers" / name)
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


def hash_of_input(path: str | Path) -> str:
    """Hash of a file, a folder or a run, which its results stand for.

    What is wrong with it is said by its reader.
    """
    results = Path(path) / "results.json"
    try:
        return fingerprint(results if results.is_file() else Path(path))
    except PlanishError:
        return ""
