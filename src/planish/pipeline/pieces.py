"""What an export consists of: its files, each with what writes it; what cannot be written is refused here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr

from planish.compute import Compute, Progress
from planish.core.errors import InputError, ResourceError, StudyError
from planish.core.grid import Grid
from planish.io.store import write_store
from planish.marks.files import LayerPixels, write_any
from planish.pipeline.compare import is_property
from planish.pipeline.taken import IMAGE, STRAIGHTENED, Taken
from planish.writers import FORMATS, SURFACES, ExportParams, Format, Maps, Surface, writer_of

_SMALL = 2**22  # pixels of a map that is read once more for the limits between which it is shown first
_SHOWN = ("tiff", "png", "svg")  # formats that show such limits
_NAMED = 5  # maps that are named while they are written
_STORES = ("ome-zarr", "zarr")  # formats whose files are folders


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """An export that was asked for; ``single``: ``out`` is one file, and not a folder of files."""

    taken: Taken
    params: ExportParams
    compute: Compute
    progress: Progress
    out: Path
    single: bool

    @property
    def form(self) -> Format:
        """Its format."""
        return FORMATS[self.params.to]


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A part of an export.

    Attributes
    ----------
    names : tuple of str
        Names of its files in a folder.
    write : callable
        Writes them; it gets the path of the first one.
    store : bool
        Whether it is a folder.
    whole : bool
        Whether it makes its file whole or not at all by itself.
    """

    names: tuple[str, ...]
    write: Callable[[Path], object]
    store: bool = False
    whole: bool = False


def pieces_of(request: Request) -> list[Piece]:
    """Give the parts of an export; one where it is a single file.

    Raises
    ------
    InputError, StudyError, FileError, ResourceError
        As :func:`planish.export`.
    """
    group, holds, form = request.params.group, request.form.holds, request.form
    if "surface" in holds:
        if group not in (None, "surfaces"):
            raise InputError(f"{form.title} holds surfaces, and --group says {group}. Leave --group out.")
        return _surfaces(request)
    if "marks" in holds:
        return _marks(request)
    if "moves" in holds and not ("maps" in holds and group in request.taken.groups):
        return _moves(request)
    return _straightened(request) if group == STRAIGHTENED else _maps(request)


def check_size(request: Request, count: int, words: str, remedy: str) -> None:
    """Raise ResourceError for what the format, or the memory, does not hold."""
    form, allowed = request.form, request.compute.for_work
    if form.most is not None and count > form.most:
        kind = "nodes" if "surface" in form.holds else "pixels"
        raise ResourceError(
            f"{form.title} is written of at most {form.most / 1e6:.0f} million {kind}; there are {words}. {remedy}"
        )
    if count * form.byte_cost > allowed:
        raise ResourceError(
            f"{form.title} of {words} takes {count * form.byte_cost / 1e9:.1f} GB of memory, {allowed / 1e9:.1f} GB "
            "are allowed. Allow more with --memory."
        )


# --- maps ----------------------------------------------------------------------------------------------------------


def _maps(request: Request) -> list[Piece]:
    taken, form, out = request.taken, request.form, request.out
    group = taken.map_group(request.params.group)
    names = taken.map_names(group, request.params.maps)
    if group == "maps" and IMAGE in names:
        _check_image(request)
    levels = {name: taken.levels(group, name) for name in names}
    maps = Maps(data=taken.maps(group, names), group=group, levels=levels)
    rows, cols = maps.shape
    check_size(request, rows * cols, f"{rows} x {cols}", "Write them as tiff, txt or netcdf, which have no limit.")
    suffix = form.suffixes[0]
    if form.apart and not request.single:
        return [_of_maps(request, maps.only(name), f"{name}{suffix}") for name in names]
    if not form.stack and len(names) > 1:
        raise StudyError(
            f"{out.name} holds one map, and {len(names)} are asked for. Choose one with --map, or give a folder. The "
            f"group {group} holds {', '.join(names)}."
        )
    return [_of_maps(request, maps, f"{group.rsplit('/', 1)[-1]}{suffix}")]


def _of_maps(request: Request, maps: Maps, name: str) -> Piece:
    params, taken = request.params, request.taken
    writer = writer_of(params.to)
    if hasattr(writer, "check"):
        writer.check(maps, params)
    if params.to == "csv" and params.point_um is None:
        params = params.model_copy(update={"point_um": taken.study.correlate.point_um})

    def write(path: Path) -> None:
        request.progress("write", ", ".join(maps.names) if len(maps.names) < _NAMED else f"{len(maps.names)} maps")
        shown = maps
        if params.to in _SHOWN and maps.shape[0] * maps.shape[1] <= _SMALL:
            display = {one: taken.display(_with_others(taken, maps, one), one) for one in maps.names}
            shown = replace(maps, display=display)
        writer.write(shown, path, taken.history, params)

    return Piece(names=(name,), write=write, store=params.to in _STORES)


def _with_others(taken: Taken, maps: Maps, name: str) -> xr.Dataset:
    """A map with that of the other side of the sheet, whose colours it shares; an image with what is valid of it."""
    other = name.replace("_top", "_bottom") if "_top" in name else name.replace("_bottom", "_top")
    other = "valid" if name == IMAGE else other
    if other in maps.names:
        return maps.data
    group = taken.group(maps.group)
    return maps.data.assign({other: group[other]}) if other in group else maps.data


def _check_image(request: Request) -> None:
    """Refuse to hold an image that does not fit into the memory."""
    rows, cols = Grid.of(request.taken.group("linked", [IMAGE])).shape
    needed, allowed = 8 * rows * cols, request.compute.for_work
    if needed > allowed:
        raise ResourceError(
            f"The image on the flat sheet takes {needed / 1e9:.1f} GB of memory, {allowed / 1e9:.1f} GB are allowed. "
            "Allow more with --memory, or choose other maps with --map."
        )


# --- the straightened volume ---------------------------------------------------------------------------------------


def _straightened(request: Request) -> list[Piece]:
    params, taken, history = request.params, request.taken, request.taken.history
    if "volume" not in request.form.holds:
        able = ", ".join(name for name, form in FORMATS.items() if "volume" in form.holds)
        raise InputError(f"The straightened volume is written as {able}, not as {params.to}.")
    if params.maps:
        raise StudyError("The straightened volume holds grey values, and --map chooses maps. Leave --map out.")
    volume = taken.straightened(params.depth_um, request.compute, request.progress)
    if params.to == "tiff":
        writer_of(params.to).check(volume, params)
    words = (
        f"{' x '.join(map(str, volume.shape))} voxels of {' x '.join(f'{v:g}' for v in volume.attrs['voxel_um'])} um"
    )

    def write(path: Path) -> None:
        request.progress("straighten", words)
        if params.to == "ome-zarr":
            note = history.json(**{key: value for key, value in volume.attrs.items() if key != "voxel_um"})
            write_store(volume.assign_attrs(history=note), path, memory_bytes=request.compute.block_bytes)
        else:
            writer_of(params.to).write(volume, path, history, params)

    name = f"{STRAIGHTENED}{request.form.suffixes[0]}"
    return [Piece(names=(name,), write=write, whole=params.to == "ome-zarr")]


# --- surfaces ------------------------------------------------------------------------------------------------------


def _surfaces(request: Request) -> list[Piece]:
    taken, params, out = request.taken, request.params, request.out
    facts = taken.sheet
    if facts is None:
        raise InputError(
            "The run holds no surfaces of one sheet. Give the run of the volume itself, in layers/NAME where several "
            "were linked."
        )
    data = taken.group("surfaces")
    there = [name for name in SURFACES if name in data and bool(np.isfinite(data[name].values).any())]
    usual = [str(k) for k, one in data.data_vars.items() if is_property(one) and str(k) not in SURFACES]
    usual.sort(key=lambda name: (name != facts.headline, name))
    known = [str(k) for k, one in data.data_vars.items() if one.ndim == 2 and one.dtype.kind in "fiub"]
    asked = taken.names_among(params.maps, known, "surfaces")
    chosen = [name for name in asked if name in SURFACES] or there
    maps = tuple(name for name in asked if name not in SURFACES) or tuple(usual)
    if lacking := [name for name in chosen if name not in there]:
        raise InputError(f"The sheet has no {' and no '.join(lacking)}; it has {', '.join(there)}.")
    if request.single and len(chosen) > 1:
        raise StudyError(
            f"{out.name} holds one surface, and there are {len(chosen)}. Choose one of {', '.join(chosen)} with --map, "
            "or give a folder."
        )
    data = data[[*chosen, *maps]]
    count = _nodes(data, params.mesh_um)
    check_size(request, count, f"{count / 1e6:.1f} million", "Give a larger --mesh-um, such as four columns.")
    display = {name: taken.display(data, name) for name in maps[:1]}
    surfaces = [Surface(data=data, name=name, maps=maps, display=display) for name in chosen]
    return [_of_surface(request, surface) for surface in surfaces]


def _nodes(data: xr.Dataset, mesh_um: float | None) -> int:
    rows, cols = data.sizes["y"], data.sizes["x"]
    down, across = (1, 1) if mesh_um is None else (max(1, round(mesh_um / pitch)) for pitch in Grid.of(data).pixel_um)
    return -(-rows // down) * -(-cols // across)


def _of_surface(request: Request, surface: Surface) -> Piece:
    def write(path: Path) -> None:
        request.progress("write", surface.name)
        writer_of(request.params.to).write(surface, path, request.taken.history, request.params)

    return Piece(names=(f"{surface.name}{request.form.suffixes[0]}",), write=write)


# --- registrations -------------------------------------------------------------------------------------------------


def _moves(request: Request) -> list[Piece]:
    return [_of_move(request, name, to) for name, to in _registered(request)]


def _of_move(request: Request, name: str, to: str) -> Piece:
    writer = writer_of(request.params.to)

    def write(path: Path) -> None:
        request.progress("write", f"{name} to {to}")
        moves = request.taken.moves(request.taken.results.layer(name))
        how = writer.write if request.single else writer.write_folder
        how(moves, path if request.single else path.parent, request.taken.history, request.params)

    names: Sequence[str] = writer.names(name, to, request.taken.is_affine(name))
    return Piece(names=tuple(names), write=write, store=request.params.to in _STORES)


def _marks(request: Request) -> list[Piece]:
    """Landmarks: other programs count from the first pixel."""
    taken = request.taken

    def of(name: str, to: str) -> Piece:
        def write(path: Path) -> None:
            marks = taken.registration(name).marks
            layers = {key: dict(about) for key, about in marks.attrs["layers"].items()}
            for side, grid in (("moving", taken.grid_of(name)), ("fixed", taken.grid_of(to))):
                if grid is not None:
                    layers[side] |= LayerPixels(origin_um=grid.origin_um).about()
            write_any(marks.assign_attrs(layers=layers), path, to="bigwarp")

        return Piece(names=(f"{name}_to_{to}{request.form.suffixes[0]}",), write=write, whole=True)

    return [of(name, to) for name, to in _registered(request)]


def _registered(request: Request) -> list[tuple[str, str]]:
    """Names of the moving layers that are meant, and of those that they are registered to."""
    if request.params.maps:
        raise StudyError(f"{request.form.title} holds a registration, and --map chooses maps. Leave --map out.")
    layers = request.taken.registered(request.params.group)
    if request.single and len(layers) > 1:
        names = ", ".join(layer.name for layer in layers)
        raise StudyError(
            f"{request.out.name} holds one registration, and there are {len(layers)}. Choose one of {names} with "
            "--group, or give a folder."
        )
    return [(layer.name, layer.registration.to) for layer in layers if layer.registration is not None]
