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
from planish.exports.formats import FORMATS, formats_with, is_file, writer_of
from planish.exports.output_files import ExportRequest, output_files
from planish.exports.params import ExportParams
from planish.exports.source import STRAIGHTENED, ExportSource
from planish.io.run_folder import new_folder, refuse_existing, refuse_inside
from planish.pipeline.run import Run


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
        Fields of :class:`planish.exports.ExportParams`, or words of ``planish export``: ``to`` (the format), ``maps``,
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
    form, compute, out = FORMATS[params.to], compute or Compute(), Path(out)
    single = is_file(params.to, out)
    refuse_existing(out)
    writer_of(params.to)
    source = ExportSource.of(run)
    if source.folder is not None:
        refuse_inside(out, [source.folder])
    with limit_threads(compute.threads):
        request = ExportRequest(
            source=source, params=params, compute=compute, progress=progress, out=out, single=single
        )  # fmt: skip
        if "run" in form.holds:
            _write_run(request)
            return [out]
        files = output_files(request)
        if single:
            (file,) = files
            with writing(out):
                out.parent.mkdir(parents=True, exist_ok=True)
            place = nullcontext(out) if file.is_atomic else new_folder(out) if form.is_folder else new_file(out)
            with place as path:
                file.write(path)
            return [out]
        with new_folder(out) as folder:
            for file in files:
                file.write(folder / file.names[0])
        return [out / name for file in files for name in file.names]


def _checked(options: dict[str, Any]) -> ExportParams:
    """Options of an export; StudyError where they are wrong, or mean nothing for its format."""
    try:
        params = ExportParams.model_validate(by_field(ExportParams, options))
    except ValidationError as error:
        raise StudyError(f"{'; '.join(mistakes(error, ExportParams, lambda loc: (loc, None)))}.") from error
    of_some_formats = dict.fromkeys(name for form in FORMATS.values() for name in form.options)
    for name in of_some_formats:
        if name in params.model_fields_set and name not in FORMATS[params.to].options:
            raise StudyError(f"{spoken(ExportParams, name)} is for {formats_with(name)}, and --to says {params.to}.")
    if params.depth_um is not None and params.group != STRAIGHTENED:
        raise StudyError(f"{spoken(ExportParams, 'depth_um')} is for --group {STRAIGHTENED}.")
    return params


def _write_run(request: ExportRequest) -> None:
    """Write the whole run folder with its description."""
    if request.params.maps or request.params.group is not None:
        raise StudyError("An RO-Crate holds the whole run. Leave --map and --group out.")
    if request.source.folder is None:
        raise FileError("The run stands in no folder. Save it first: give out to link or map_sheet.")
    with new_folder(request.out) as path:
        request.write(request.source.folder, path)
