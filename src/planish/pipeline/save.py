"""From a study to a run folder, whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any, overload

from planish import __version__
from planish.compute import Compute, run_key
from planish.core.errors import PlanishError
from planish.core.threads import limit_threads
from planish.io import fingerprint
from planish.io.run_folder import new_folder, refuse_existing, work_folder, write_json, write_tree
from planish.marks import write_marks
from planish.pipeline.image import link_sheet
from planish.pipeline.layers import link_layers
from planish.pipeline.run import Layers, Progress, Run, silent
from planish.pipeline.sheet import map_sheet
from planish.report import write_layers_report, write_report
from planish.study import LayersStudy, Study, write_study


@overload
def run_study(
    study: Study, out: Path, *, progress: Progress | None = None, compute: Compute | None = None,
    sheet: Run | None = None,
) -> Run: ...  # fmt: skip
@overload
def run_study(
    study: LayersStudy, out: Path, *, progress: Progress | None = None, compute: Compute | None = None
) -> Layers: ...
def run_study(
    study: Study | LayersStudy, out: Path, *, progress: Progress | None = None, compute: Compute | None = None,
    sheet: Run | None = None,
) -> Run | Layers:  # fmt: skip
    """Do what a study says and write the run folder ``out``.

    A run that was killed goes on where it stood when it is started again.

    Parameters
    ----------
    study : Study or LayersStudy
    out : Path
        Folder to make.
    progress : callable, optional
        Called with the name of a stage and a few words.
    compute : Compute, optional
        What the run may use.
    sheet : Run, optional
        The maps of the study's volume, where it was mapped before.

    Raises
    ------
    PlanishError
        Any of the tree in :mod:`planish.core.errors`; nothing is left at ``out`` then.
    """
    refuse_existing(out)
    tell = progress or silent
    key = run_key(study.model_dump(mode="json"), [_hash(path) for path in _inputs(study)])
    with work_folder(out, key) as work, limit_threads(None if compute is None else compute.threads):
        how: dict[str, Any] = {"progress": tell, "compute": compute, "kept": work / "tiles"}
        if isinstance(study, LayersStudy):
            layers = link_layers(study, **how)
            tell("write", str(out))
            with new_folder(out, inside=work) as folder:
                save_layers(layers, folder, home=out)
            return layers
        run = link_sheet(study, sheet=sheet, **how) if study.image is not None else map_sheet(study, **how)
        tell("write", str(out))
        with new_folder(out, inside=work) as folder:
            save_run(run, folder, home=out)
        return run


def save_run(run: Run, folder: Path, *, home: Path) -> None:
    """Write all files of a run into ``folder``, which will stand at ``home``."""
    marks = {} if run.marks is None else {"marks": run.marks}
    write_tree(folder / "maps.zarr", run.groups | marks)
    if run.marks is not None:
        write_marks(run.marks, folder / "marks.csv")
    write_json(folder / "results.json", run.results)
    write_study(run.study, folder, home=home, version=__version__)
    write_report(folder / "report.html", groups=run.groups, marks=run.marks, results=run.results)


def save_layers(layers: Layers, folder: Path, *, home: Path) -> None:
    """Write all files of linked layers into ``folder``, which will stand at ``home``.

    A layer that was mapped on the way stands in ``layers/NAME`` as a run of its own.
    """
    for name, run in layers.runs.items():
        inner = folder / "layers" / name
        inner.mkdir(parents=True)
        save_run(run, inner, home=home / "layers" / name)
    write_tree(folder / "maps.zarr", layers.groups | {f"marks/{name}": table for name, table in layers.marks.items()})
    for name, table in layers.marks.items():
        write_marks(table, folder / f"marks-{name}.csv")
    write_json(folder / "results.json", layers.results)
    write_study(layers.study, folder, home=home, version=__version__)
    write_layers_report(
        folder / "report.html", groups=layers.groups, marks=layers.marks, results=layers.results
    )  # fmt: skip


def _inputs(study: Study | LayersStudy) -> list[str]:
    """Paths of all that a study reads."""
    if isinstance(study, Study):
        return [study.volume.path, *([study.image.path] if study.image is not None else [])]
    found: list[str] = []
    for layer in study.layers:
        if layer.run is not None:
            found.append(str(Path(layer.run) / "results.json"))
        if layer.map is not None:
            found += _inputs(layer.map)
        if layer.image is not None:
            found.append(layer.image.path)
    return found


def _hash(path: str) -> str:
    """Hash of an input; whatever is wrong with it is said by its own reader."""
    try:
        return fingerprint(Path(path))
    except PlanishError:
        return ""
