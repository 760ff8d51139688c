"""From a study to a run folder, whole or not at all."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import xarray as xr

from planish import __version__
from planish.checks import apply_checks, for_layers
from planish.compute import Compute, Progress, return_memory, run_key, silent
from planish.core.area import overviews
from planish.core.errors import CannotRegister, MarkError, PlanishError
from planish.core.files import move
from planish.core.sources import hash_sources
from planish.core.text import quoted
from planish.core.threads import limit_threads
from planish.io import fingerprint
from planish.io.map_store import OVERVIEWS, HeldMaps, StoredMaps, stored_group
from planish.io.run_folder import new_folder, refuse_existing, refuse_inside, take_group, work_folder, write_tree
from planish.marks import write_marks
from planish.pipeline.corrections import CORRECTIONS, write_corrections
from planish.pipeline.facts import parameters, versions
from planish.pipeline.figures import figures_text
from planish.pipeline.kept import KeptMaps, sheets_of
from planish.pipeline.layers import Layer
from planish.pipeline.linking import LINKED, link_study
from planish.pipeline.regions import REGIONS, write_regions
from planish.pipeline.request import check_request
from planish.pipeline.run import MAPS, Run, is_run, marks_file
from planish.pipeline.sheet import changed, map_layer
from planish.report import FIGURES, write_report
from planish.results import LayerFacts, Results
from planish.study import LayerParams, Study, to_dict, write_study

_NONE: Mapping[str, Layer] = {}
_DEEP = 3  # edits/NAME/FILE of a run
_KEPT = 0.03  # of the memory, for maps that are read back
_PAGES = 5_000_000  # bytes of report.html and the tables


def run_study(
    study: Study, out: str | Path | None = None, *, compute: Compute | None = None, progress: Progress = silent,
    old: Path | None = None, figures: bool = False,
) -> Run:  # fmt: skip
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
        Any of the tree in :mod:`planish.core.errors`; nothing is left at ``out`` then. What was mapped of a
        link stays beside it, as ``OUT-map``.
    """
    compute = compute or Compute()
    # What is free changes while a run works, and the width of its columns must not.
    settled = compute.model_copy(update={"memory_bytes": compute.memory})
    return_memory(settled)
    with limit_threads(compute.threads):
        if out is None:
            check_request(study, compute, held=True)
            return replace(_done(study, compute=settled, progress=progress, kept=None), unchanged={})
        out = Path(out)
        refuse_existing(out)
        refuse_inside(out, [layer.path for layer in study.layers])
        check_request(study, compute)
        hashes = [_hash(layer.path) for layer in study.layers]
        with work_folder(out, run_key(to_dict(study), hashes)) as work:
            maps = {
                layer.name: KeptMaps.of(layer, sha256, _of_layer(out, layer, study), compute)
                for layer, sha256 in zip(study.layers, hashes, strict=True)
                if layer.kind == "volume" and len(study.layers) > 1
            }
            before = {name: sheet for name, kept in maps.items() if (sheet := kept.read()) is not None}
            same, near = sheets_of(old, study, hashes) if old is not None else ({}, {})
            before |= same if len(study.layers) > 1 else {}
            for name in before:
                progress("read", f"{name}, mapped before")
            mapped = dict(before)
            keep_bytes = int(settled.memory * _KEPT)
            partial = work / f".{secrets.token_hex(4)}.partial"
            sink = StoredMaps(partial, keep_bytes=keep_bytes) if len(study.layers) > 1 else None
            try:
                run = _done(
                    study,
                    compute=settled,
                    progress=progress,
                    kept=work / "tiles",
                    mapped=mapped,
                    near=near,
                    sink=sink,
                )
            except PlanishError as error:
                with suppress(PlanishError, OSError):  # a disk that is full now does not hide what was wrong before
                    for name in before.keys() & maps.keys():
                        if maps[name].path.exists():
                            maps[name].note(maps[name].path, study)
                    for name in mapped.keys() - before.keys():
                        sheet, place = mapped[name], maps[name]
                        with new_folder(place.path, inside=work) as folder:
                            save_run(_run_of_sheet(sheet, Study(layers=(sheet.params,))), folder, home=place.path)
                            place.note(folder, study)
                more = _next_step(error, maps, study)
                if not more:
                    raise
                raise type(error)(f"{error.text} {more}") from error
            progress("write", str(out))
            with new_folder(out, inside=work, needed=_size(run)) as folder:
                save_run(run, folder, home=out, stored=sink, figures=figures)
            moved = {name: stored_group(out / MAPS, name) for name in sink.stored} if sink is not None else {}
            return replace(run, groups=run.groups | moved, unchanged={})


def _of_layer(out: Path, layer: LayerParams, study: Study) -> Path:
    several = sum(one.kind == "volume" for one in study.layers) > 1
    return out.with_name(f"{out.name}-{layer.name}") if several else out


def _next_step(error: PlanishError, maps: Mapping[str, KeptMaps], study: Study) -> str:
    """Say where maps are kept of a link that was refused; where none are, how to get them without the image."""
    kept = [str(one.path) for one in maps.values() if one.path.exists()]
    if kept:
        text = f"The maps of the volume are kept in {' and '.join(kept)}; the same command goes on from there."
        by_hand = isinstance(error, CannotRegister | MarkError) and study.is_sheet_on_image
        return f"{text} To set the marks by hand: {_view(kept[0], study)}" if by_hand else text
    volume = next((layer for layer in study.layers if layer.kind == "volume"), None)
    if volume is None or not isinstance(error, CannotRegister):
        return ""
    place = str(maps[volume.name].path)
    command = f"planish map {quoted(volume.path)} --out {quoted(place)}"
    text = f"To map the volume without it, with the same options: {command}"
    return f"{text}; then, to set the marks by hand: {_view(place, study)}" if study.is_sheet_on_image else text


def _view(maps: str, study: Study) -> str:
    return f"planish view {quoted(maps)} {quoted(study.layers[-1].path)}"


def _done(
    study: Study, *, compute: Compute, progress: Progress, kept: Path | None, mapped: dict[str, Layer] | None = None,
    near: Mapping[str, Layer] = _NONE, sink: HeldMaps | None = None,
) -> Run:  # fmt: skip
    first, *others = study.layers
    if others:
        return link_study(study, compute=compute, progress=progress, kept=kept, mapped=mapped, near=near, sink=sink)
    sheet = map_layer(first, compute=compute, progress=progress, kept=kept, before=near.get(first.name))
    return _run_of_sheet(sheet, study)


def _run_of_sheet(sheet: Layer, study: Study) -> Run:
    """The run of one mapped sheet."""
    assert sheet.facts is not None
    study = changed(study, layers=(sheet.params,), correlate=changed(study.correlate, regions=None))
    # The coating of the top stands for it, or the thickness where there is none.
    headline = "coating_top" if "coating_top" in sheet.facts.properties else "thickness"
    facts = LayerFacts(name=sheet.name, kind="sheet", source=sheet.source, headline=headline, sheet=sheet.facts)
    results = Results(
        planish=__version__, code=hash_sources(), versions=versions(), layers=(facts,),
        checks=tuple(for_layers(sheet.checks, sheet.name)), parameters=parameters(study),
    )  # fmt: skip
    return Run(study=study, results=apply_checks(results), groups=sheet.groups, unchanged=sheet.unchanged)


def _size(run: Run) -> int:
    """About how many bytes its folder takes: those of its maps, which hold noise, of overviews, and of its pages."""
    return _PAGES + sum(data.nbytes for data in run.groups.values()) * 4 // 3


def _with_overviews(groups: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Add smaller copies of large maps, ``overviews/GROUP/1`` half as fine, ``/2`` half of that, and so on."""
    found = dict(groups)
    for name, data in groups.items():
        if (name in ("maps", LINKED, "refined") or name.startswith("layers/")) and f"{OVERVIEWS}/{name}/1" not in found:
            found |= {f"{OVERVIEWS}/{name}/{k}": smaller for k, smaller in enumerate(overviews(data), 1)}
    return found


def save_run(
    run: Run, folder: Path, *, home: Path, stored: StoredMaps | None = None, figures: bool = False
) -> None:  # fmt: skip
    """Write all files of a run into ``folder``, which will stand at ``home``, on request those of its figures, too.

    The store of ``stored``, which holds some of its groups, becomes that of the run. A volume that was mapped on the
    way to a link of several layers stands in ``layers/NAME`` as a run of its own.
    """
    for name, sheet in run.sheets.items():
        inner = folder / "layers" / name
        inner.mkdir(parents=True)
        save_run(_run_of_sheet(sheet, run.study), inner, home=home / "layers" / name)
    for name, registration in run.registrations.items():
        path = folder / marks_file(run.results, name)
        registration.save(path)
        write_marks(registration.pairs(), path.with_suffix(".csv"))
    (folder / "results.json").write_text(run.results.to_json(), encoding="utf-8", newline="\n")
    (folder / "figures.csv").write_text(figures_text(run.results), encoding="utf-8", newline="\n")
    study = run.study
    if run.regions is not None:
        write_regions(run.regions, folder)
        study = changed(study, correlate=changed(study.correlate, regions=str(home / REGIONS)))
    study = _with_own_corrections(_with_own_marks(study, run, home), run, folder, home)
    write_study(study, folder, home=home, version=__version__)
    pairs = {name: registration.pairs() for name, registration in run.registrations.items()}
    write_report(
        folder / "report.html", results=run.results, groups=run.groups, marks=pairs,
        figures=folder / FIGURES if figures else None,
    )  # fmt: skip
    there = stored.stored if stored is not None else []
    if stored is not None and there:
        move(stored.path, folder / MAPS)
    for name, store in run.unchanged.items():
        take_group(folder / MAPS, store, name)
    own = {name: data for name, data in run.groups.items() if name not in run.unchanged}
    write_tree(folder / MAPS, {name: data for name, data in _with_overviews(own).items() if name not in there})


def _with_own_corrections(study: Study, run: Run, folder: Path, home: Path) -> Study:
    """Corrections of its own sheets are files of the run; those of ``run.sheets`` stand in their folders by now."""
    files: dict[str, str | None] = {name: f"layers/{name}/{CORRECTIONS}" for name in run.sheets}
    files = {name: file if (folder / str(file)).is_file() else None for name, file in files.items()}
    if "surfaces" in run.groups:
        files[study.layers[0].name] = write_corrections(run.groups["surfaces"], folder)
    layers = tuple(
        changed(layer, surface=changed(layer.surface, corrections=str(home / file) if file else None))
        if layer.kind == "volume" and (file := files.get(layer.name, "")) != "" else layer
        for layer in study.layers
    )  # fmt: skip
    return changed(study, layers=layers)


def _with_own_marks(study: Study, run: Run, home: Path) -> Study:
    """Marks of another run are in this one too, with all that is known of them: from now on they are its own."""
    own = {
        name: str(home / marks_file(run.results, name)) for name, one in run.registrations.items()
        if one.source == "json"
    }  # fmt: skip
    layers = tuple(
        changed(layer, marks=own[layer.name]) if layer.name in own and _in_a_run(layer.marks) else layer
        for layer in study.layers
    )
    registration = study.registration
    if len(run.registrations) == 1 and own and _in_a_run(registration.marks):
        registration = changed(registration, marks=next(iter(own.values())))
    return changed(study, layers=layers, registration=registration)


def _in_a_run(path: str | None) -> bool:
    """Whether a file lies in a run or in a folder of one."""
    return path is not None and any(is_run(folder) for folder in Path(path).parents[:_DEEP])


def _hash(path: str) -> str:
    """Hash of an input; whatever is wrong with it is said by its own reader."""
    try:
        place = Path(path)
        return fingerprint(place / "results.json" if (place / "results.json").is_file() else place)
    except PlanishError:
        return ""
