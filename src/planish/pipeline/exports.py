"""A run as files of other programs: ``planish export``."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from planish.compute import Compute, Progress, silent
from planish.core.errors import FileError, StudyError
from planish.core.files import new_file, writing
from planish.core.mistakes import mistakes
from planish.core.options import by_field, spoken
from planish.core.threads import limit_threads
from planish.io.run_folder import new_folder, refuse_existing, refuse_inside
from planish.pipeline.pieces import Request, pieces_of
from planish.pipeline.run import Run
from planish.pipeline.taken import STRAIGHTENED, Taken
from planish.writers import FORMATS, ExportParams, is_file, writer_of


def export(
    run: Run | str | Path, out: str | Path, *, compute: Compute | None = None, progress: Progress = silent,
    **options: Any,
) -> list[Path]:  # fmt: skip
    """Write what a run holds as files of another program.

    Parameters
    ----------
    run : Run or path
        A run, or its folder; of a folder only what is asked for is read, and large maps part by part.
    out : path
        Folder to make, or one file where it ends in the format's suffix.
    compute : Compute, optional
        What may be used.
    progress : callable, optional
        Called with the name of a step and a few words.
    **options
        Fields of :class:`planish.writers.ExportParams`, or words of ``planish export``: ``to`` (the format), ``maps``,
        ``group``, ``point_um``, ``mesh_um``, ``as_seen``, ``depth_um``, ``unit``, ``mat_version``.

    Returns
    -------
    list of Path
        The files that were made. The same run gives the same bytes.

    Raises
    ------
    StudyError
        If options are unknown, out of range, or mean nothing for the format.
    InputError
        If the run does not hold what is asked for, or a library of the extra ``export`` is missing.
    FileError
        If ``out`` exists, cannot be written, or ends as another format's files do; or the volume of a straightened
        one is gone.
    ResourceError
        If a map is larger than the format or the memory holds, or the disk is full.

    Examples
    --------
    ``pl.export("run", "coating.tif", to="tiff", maps=["coating_top", "image"])``
    """
    params = _checked(options)
    compute, out = compute or Compute(), Path(out)
    single = is_file(params.to, out)
    refuse_existing(out)
    if FORMATS[params.to].module:
        writer_of(params.to)
    taken = Taken.of(run)
    if taken.folder is not None:
        refuse_inside(out, [taken.folder])
    with limit_threads(compute.threads):
        request = Request(taken=taken, params=params, compute=compute, progress=progress, out=out, single=single)
        if FORMATS[params.to].holds == ("run",):
            return _crate(request)
        pieces = pieces_of(request)
        if single:
            (piece,) = pieces
            with writing(out):
                out.parent.mkdir(parents=True, exist_ok=True)
            place = nullcontext(out) if piece.whole else new_folder(out) if piece.store else new_file(out)
            with place as path:
                piece.write(path)
            return [out]
        with new_folder(out) as folder:
            for piece in pieces:
                piece.write(folder / piece.names[0])
        return [out / name for piece in pieces for name in piece.names]


def _checked(options: dict[str, Any]) -> ExportParams:
    """Options of an export; StudyError where they are wrong, or mean nothing for its format."""
    try:
        params = ExportParams.model_validate(by_field(ExportParams, options))
    except ValidationError as error:
        raise StudyError(f"{'; '.join(mistakes(error, ExportParams, lambda loc: (loc, None)))}.") from error
    needed = {name: [key for key, form in FORMATS.items() if name in form.options] for form in FORMATS.values()
              for name in form.options}  # fmt: skip
    for name, formats in needed.items():
        if name in params.model_fields_set and params.to not in formats:
            raise StudyError(f"{spoken(ExportParams, name)} is for {', '.join(formats)}, and --to says {params.to}.")
    if params.depth_um is not None and params.group != STRAIGHTENED:
        raise StudyError(f"{spoken(ExportParams, 'depth_um')} is for --group {STRAIGHTENED}.")
    return params


def _crate(request: Request) -> list[Path]:
    """The whole run folder with its description."""
    if request.params.maps or request.params.group is not None:
        raise StudyError("An RO-Crate holds the whole run. Leave --map and --group out.")
    if request.taken.folder is None:
        raise FileError("The run stands in no folder. Save it first: give out to link or map_sheet.")
    with new_folder(request.out) as place:
        writer_of("crate").write(request.taken.folder, place, request.taken.history, request.params)
    return [request.out]
