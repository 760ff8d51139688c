"""A run as files of other programs: ``planish export``."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from planish.analyze.compare import is_property
from planish.core.errors import FileError, InputError, ResourceError, StudyError
from planish.core.files import new_file
from planish.core.grid import Grid
from planish.core.options import params_of
from planish.core.plugins import faults_named
from planish.core.threads import limit_threads
from planish.core.typing import Texts
from planish.exports import run_contents
from planish.exports.content import Maps, volume_facts
from planish.exports.formats import (
    FORMATS,
    ExportFormat,
    ExportParams,
    find_format,
    formats_with,
    is_file,
    writer_of,
)
from planish.exports.meshes import SURFACES, Surface, steps_of
from planish.exports.run_contents import IMAGE, STRAIGHTENED, checked_names
from planish.io.run_folder import new_folder, refuse_existing, refuse_inside
from planish.io.store import write_store
from planish.run.compute import Compute, Progress, silent
from planish.run.run import MAPS, Run, open_run
from planish.run.study import changed


class OutputFile(NamedTuple):
    """One call of a writer.

    Names of its files in a folder, the first of which it is given, and what it writes.
    """

    names: list[str]
    content: object
    summary_text: str


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """An export of a run that was asked for, to a file or a folder."""

    run: Run
    store: Path | None  #: maps.zarr of its folder; None of a run in memory, which may differ
    params: ExportParams
    compute: Compute
    progress: Progress
    out: Path  #: new file, or new folder of the files
    is_single_file: bool  #: whether ``out`` is a file, or a folder that is one of the format

    @property
    def file_format(self) -> ExportFormat:
        """Row of its format."""
        return FORMATS[self.params.to]

    def write(self, content: object, path: Path) -> None:
        """Write a content of the format to a new path, a file or a folder."""
        history = run_contents.history_of(self.run)
        # A volume as OME-Zarr is the store in which the program itself keeps volumes.
        if isinstance(content, xr.DataArray) and self.file_format.is_folder:
            volume = content.assign_attrs(history=history.json(**volume_facts(content)))
            write_store(volume, path, memory_bytes=self.compute.block_bytes)
            return
        if isinstance(content, Maps):
            content = self._with_limits(content)
        write = writer_of(self.params.to)
        with faults_named(f"The export {self.params.to!r}", write.__module__):
            write(content, path, history, self.params)

    def file(self, name: str, content: object, summary_text: str = "") -> OutputFile:
        """Give the file of a name; the name stands for what it is where nothing else is said."""
        return OutputFile([f"{name}{self.file_format.suffixes[0]}"], content, summary_text or name)

    def _with_limits(self, maps: Maps) -> Maps:
        """Maps with the limits between which they are shown first, where their file says so."""
        # A map of so few pixels is read once more for them.
        if not self.file_format.shows_limits or math.prod(maps.shape) > 2**22:
            return maps
        # A map shares its limits with the other side of the sheet, and those of an image are of
        # what is valid.
        group = self.run.groups[maps.group].assign(maps.data.data_vars)
        scales = {name: run_contents.scale_of(group, name) for name in maps.names}
        return replace(maps, scales=scales)


def _output_files(request: ExportRequest) -> list[OutputFile]:
    """What is written, by what the format holds and the group that was asked for.

    InputError where the group does not fit the format, FileError where the run has no folder and
    its folder is to be copied.
    """
    group = request.params.group
    file_format = request.file_format
    if "run" in file_format.holds:
        folder = request.run.folder
        if folder is None:
            raise FileError(
                "The run stands in no folder. Save it first: give out to link or map_sheet."
            )
        return [OutputFile([], folder, str(folder))]
    if "surface" in file_format.holds:
        if group not in (None, "surfaces"):
            raise InputError(
                f"{file_format.title} holds surfaces, and `group` says {group}. Leave `group` out."
            )
        return _surfaces(request)
    # NRRD holds both: maps where `group` names a group of them, else registrations.
    are_maps = "maps" in file_format.holds and group in request.run.groups
    if not are_maps and {"marks", "registration"} & {*file_format.holds}:
        return _registrations(request)
    if group == STRAIGHTENED:
        return _straightened(request)
    return _maps(request)


def _check_size(request: ExportRequest, count: int, size_text: str, remedy_text: str) -> None:
    """Raise ResourceError for what the format, or the memory, does not hold.

    ``count``: pixels or nodes, which ``size_text`` states in words; ``remedy_text``: a sentence on
    what to do where they are more than the format holds.
    """
    file_format = request.file_format
    allowed_bytes = request.compute.for_work
    if file_format.most is not None and count > file_format.most:
        raise ResourceError(
            f"{file_format.title} is written of at most {file_format.most / 1e6:.0f} million"
            f" {file_format.counts}; there are {size_text}. {remedy_text}"
        )
    needed_bytes = count * file_format.byte_cost
    if needed_bytes > allowed_bytes:
        raise ResourceError(
            f"{file_format.title} of {size_text} takes {needed_bytes / 1e9:.1f} GB of memory,"
            f" {allowed_bytes / 1e9:.1f} GB are allowed. Allow more with `memory`."
        )


def _maps(request: ExportRequest) -> list[OutputFile]:
    """Maps of a group, in one file or each in its own.

    They are only named here; their values are read as they are written. StudyError where several
    are to go into a file that holds one.
    """
    run = request.run
    file_format = request.file_format
    group = run_contents.map_group(run, request.params.group)
    names = run_contents.map_names(run, group, request.params.maps)
    if group == "maps" and IMAGE in names:
        _check_image(request)
    levels = {name: run_contents.map_levels(request.store, group, name) for name in names}
    map_data = run_contents.maps_of(run, group, names)
    valid = run.groups[group].get("valid")
    maps = Maps(data=map_data, group=group, levels=levels, valid=valid)
    rows, cols = maps.shape
    remedy_text = "Write them as tiff, txt or netcdf, which have no limit."
    _check_size(request, rows * cols, f"{rows} x {cols}", remedy_text)
    if file_format.apart and not request.is_single_file:
        return [request.file(name, maps.only(name)) for name in names]
    if not file_format.stack and len(names) > 1:
        raise StudyError(
            f"{request.out.name} holds one map, and {len(names)} are asked for. Choose one with"
            f" `map`, or give a folder. The group {group} holds {', '.join(names)}."
        )
    maps_text = f"{len(names)} maps"
    if len(names) < 5:
        maps_text = ", ".join(names)
    file_stem = group.rpartition("/")[2]  # NAME of layers/NAME
    return [request.file(file_stem, maps, maps_text)]


def _check_image(request: ExportRequest) -> None:
    """Raise ResourceError where the image does not fit into the memory."""
    image_grid = Grid.of(request.run.groups["linked"])
    image_bytes = 8 * math.prod(image_grid.shape)
    memory_bytes = request.compute.for_work
    if image_bytes > memory_bytes:
        raise ResourceError(
            f"The image on the flat sheet takes {image_bytes / 1e9:.1f} GB of memory,"
            f" {memory_bytes / 1e9:.1f} GB are allowed. Allow more with `memory`, or choose"
            " other maps with `map`."
        )


def _straightened(request: ExportRequest) -> list[OutputFile]:
    """The volume along the normals, in one file."""
    params = request.params
    if "volume" not in request.file_format.holds:
        names = [name for name, row in FORMATS.items() if "volume" in row.holds]
        raise InputError(
            f"The straightened volume is written as {', '.join(names)}, not as {params.to}."
        )
    if params.maps:
        raise StudyError(
            "The straightened volume holds grey values, and `map` chooses maps. Leave `map` out."
        )
    volume = run_contents.straightened_volume(
        request.run, params.depth_um, request.compute, request.progress
    )
    voxel_text = " x ".join(f"{v:g}" for v in volume.attrs["voxel_um"])
    size_text = f"{' x '.join(map(str, volume.shape))} voxels of {voxel_text} um"
    return [request.file(STRAIGHTENED, volume, size_text)]


def _surfaces(request: ExportRequest) -> list[OutputFile]:
    """Surfaces of the sheet, each in its own file, on every n-th row and column of the volume.

    StudyError where several are to go into one file.
    """
    run = request.run
    params = request.params
    facts = run_contents.sheet_facts(run)
    if facts is None:
        raise InputError(
            "The run holds no surfaces of one sheet. Give the run of the volume itself, in"
            " layers/NAME where several were linked."
        )
    surfaces = run.groups["surfaces"]
    surface_names, maps = _chosen(surfaces, params.maps, facts.headline)
    if request.is_single_file and len(surface_names) > 1:
        raise StudyError(
            f"{request.out.name} holds one surface, and there are {len(surface_names)}. Choose one"
            f" of {', '.join(surface_names)} with `map`, or give a folder."
        )
    columns = surfaces[[*surface_names, *maps]]
    row_step, col_step = steps_of(columns, params.mesh_um)
    n_rows = math.ceil(columns.sizes["y"] / row_step)
    n_cols = math.ceil(columns.sizes["x"] / col_step)
    n_nodes = n_rows * n_cols
    remedy_text = "Give a larger `mesh_um`, such as four columns."
    _check_size(request, n_nodes, f"{n_nodes / 1e6:.1f} million", remedy_text)
    # The first map is the colour of the nodes, and the only one that needs limits.
    scales = {name: run_contents.scale_of(columns, name) for name in maps[:1]}
    return [request.file(name, Surface(columns, name, maps, scales)) for name in surface_names]


def _chosen(
    surfaces: xr.Dataset, requested: Sequence[str], headline: str | None
) -> tuple[list[str], Texts]:
    """Surfaces that are written, and the maps that they carry.

    Where none is named, all that were measured, and all properties, the headline first.
    """
    variables = {str(name): variable for name, variable in surfaces.data_vars.items()}
    # Numbers and truth values; a node carries no text.
    names = [n for n, v in variables.items() if v.ndim == 2 and v.dtype.kind in "fiub"]
    checked = checked_names(requested, names, "surfaces")
    maps = [name for name in checked if name not in SURFACES]
    if not maps:
        properties = [n for n, v in variables.items() if is_property(v) and n not in SURFACES]
        maps = sorted(properties, key=lambda name: (name != headline, name))
    return _measured_surfaces(surfaces, checked), tuple(maps)


def _measured_surfaces(surfaces: xr.Dataset, names: Sequence[str]) -> list[str]:
    """Surfaces among some names, or all; InputError where one of them was not measured."""
    present = filter(surfaces.__contains__, SURFACES)
    measured = [name for name in present if surfaces[name].notnull().any()]
    chosen = [name for name in names if name in SURFACES] or measured
    unmeasured = [name for name in chosen if name not in measured]
    if unmeasured:
        raise InputError(
            f"The sheet has no {' and no '.join(unmeasured)}; it has {', '.join(measured)}."
        )
    return chosen


def _registrations(request: ExportRequest) -> list[OutputFile]:
    """Registrations of the layers, each in both directions, or their marks.

    A single file has the direction from the moving layer to the fixed one, or both where the format
    keeps them together. A direction may be several files.
    """
    if request.params.maps:
        raise StudyError(
            f"{request.file_format.title} holds a registration, and `map` chooses maps. Leave `map`"
            " out."
        )
    layers = run_contents.registered_layers(request.run, request.params.group)
    if request.is_single_file and len(layers) > 1:
        names = ", ".join(layer.name for layer in layers)
        raise StudyError(
            f"{request.out.name} holds one registration, and there are {len(layers)}. Choose one of"
            f" {names} with `group`, or give a folder."
        )
    file_format = request.file_format
    files = list[OutputFile]()
    for layer in layers:
        pair = run_contents.transforms_of(request.run, layer)
        contents: dict[str, object] = {pair.forward.name: pair}  # by the name of the file
        if "marks" in file_format.holds:
            contents = {pair.forward.name: run_contents.landmarks(request.run, layer)}
        elif file_format.apart:
            contents = {pair.forward.name: pair.forward}
            if not request.is_single_file:
                contents[pair.back.name] = pair.back
        endings = file_format.endings_of(affine=pair.forward.exact)
        for name, content in contents.items():
            files.append(OutputFile([f"{name}{end}" for end in endings], content, name))
    return files


def export(
    run: Run | str | Path,
    out: str | Path,
    *,
    compute: Compute | None = None,
    progress: Progress = silent,
    **options: Any,
) -> list[Path]:
    """Write what a run holds as files of another program.

    Parameters
    ----------
    run : Run or path
        A run, or its folder; of a folder only what is asked for is read, and large maps part by
        part.
    out : path
        Folder to make, or one file where it ends in the format's suffix.
    compute : Compute, optional
        What may be used.
    progress : callable, optional
        Called with the name of a step and a few words.
    **options
        Fields of :class:`planish.exports.ExportParams`, or words of ``planish export``: ``to`` (the
        format), ``maps``, ``group``, ``point_um``, ``mesh_um``, ``as_seen``, ``depth_um``,
        ``unit``, ``mat_version``.

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
        If ``out`` exists, cannot be written, or ends as another format's files do; or a
        straightened volume is gone.
    ResourceError
        If a map is larger than the format or the memory holds, or the disk is full.

    Examples
    --------
    ``pl.export("run", "coating.tif", to="tiff", maps=["coating_top", "image"])``
    """
    params = params_of(ExportParams, options)
    file_format = find_format(params.to)
    _check_options(params, file_format)
    compute = compute or Compute()
    out = Path(out)
    is_single_file = is_file(params.to, out)
    refuse_existing(out)
    writer_of(params.to)  # a library that is missing is named before anything is read
    # A run in memory may have been changed since it was read.
    store = None
    if not isinstance(run, Run):
        store = Path(run) / MAPS
        run = open_run(run)
    if run.folder is not None:
        refuse_inside(out, [run.folder])
    if params.point_um is None and "point_um" in file_format.options:
        params = changed(params, point_um=run.study.correlate.point_um)
    with limit_threads(compute.threads):
        request = ExportRequest(run, store, params, compute, progress, out, is_single_file)
        files = _output_files(request)
        if is_single_file or "run" in file_format.holds:
            _write_one(request, *files)
            return [out]
        with new_folder(out) as folder:
            for file in files:
                progress("write", file.summary_text)
                request.write(file.content, folder / file.names[0])
        return [out / name for file in files for name in file.names]


def _write_one(request: ExportRequest, file: OutputFile) -> None:
    """Write what an export makes as one file, or as one folder of its format."""
    request.progress("write", file.summary_text)
    out = request.out
    is_folder = request.file_format.is_folder
    if is_folder and isinstance(file.content, xr.DataArray):
        request.write(file.content, out)  # a store, which goes on where it was killed
        return
    with new_folder(out) if is_folder else new_file(out, with_parents=True) as path:
        request.write(file.content, path)


def _check_options(params: ExportParams, file_format: ExportFormat) -> None:
    """Refuse options that mean nothing for the format, or for what is taken of the run."""
    for name in sorted(params.model_fields_set.difference(file_format.options)):
        if formats_with(name):
            raise StudyError(f"`{name}` is for {formats_with(name)}, and `to` says {params.to}.")
    if params.depth_um is not None and params.group != STRAIGHTENED:
        raise StudyError(f"`depth_um` is for `group={STRAIGHTENED}`.")
    if "run" in file_format.holds and (params.maps or params.group is not None):
        raise StudyError("An RO-Crate holds the whole run. Leave `map` and `group` out.")
