"""OME-Zarr volumes (0.4 on zarr v2, 0.5 on zarr v3), and plain zarr arrays with three axes."""

import math
import re
import struct
from collections.abc import Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr
from zarr.storage import LocalStore

from planish.core.errors import FileError, VolumeError
from planish.core.lazy import Where, chunk_parts
from planish.core.typing import Array, Fields, Shape
from planish.io.attributes import (
    Coordinates,
    names_by_attributes,
    sizes_by_attributes,
    stated_by_coordinates,
    word_of,
)
from planish.io.axes import AxisNames, extended_axes, place_axes
from planish.io.formats import ADVICE, LoadedVolume, Place, check_chunks, check_type, path_words
from planish.io.guard import reading
from planish.io.hashes import missing_shards
from planish.io.lazy import FileArray, reordered
from planish.io.orientation import orientation_by_words
from planish.io.shards import is_plain, read_plain
from planish.io.sizes import NO_SIZE, Stated, stated_in
from planish.io.tiff import damaged

# Files of a zarr store that are no chunks.
METADATA = frozenset({"zarr.json", ".zarray", ".zattrs", ".zgroup", ".zmetadata"})


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Read the first level of a multiscale image, or the chosen array, in parts on demand."""
    path = place.path
    if not path.is_dir():
        raise FileError(
            f"{path.name} is no folder. A zarr store is one: unpack it, or check the name."
        )
    multiscale, level, name = _find_level(path, _part_of(path, place.part))
    array = _open_node(path, name)
    if not isinstance(array, zarr.Array):
        raise VolumeError(
            f"{path.name}: {name or 'the store'} is no array. Choose one as {path.name}:NAME."
        )
    shape = array.shape
    named = _named_axes(multiscale, array, path)
    placed = place_axes(shape, named.namings, path.name, channel_labels=_channel_labels(multiscale))
    _check_shards(path, name)
    files = [*filter(Path.is_file, (path / name).rglob("*"))]
    with reading(path):
        positions = _stored_chunks(path / name, files)
        doubts = check_chunks(positions, shape, array.shards or array.chunks, name=path.name)
        dtype = np.dtype(array.dtype)
        check_type(dtype, path)
        lazy = FileArray(path, shape, dtype, partial(_read_part, path, name, shape))
        lazy.chunks = array.chunks
        lazy.piece_bytes = math.prod(lazy.chunks) * lazy.dtype.itemsize
    group_attrs = _group_attrs(path, name)
    hand, imported_notes = _said_at_import(group_attrs)
    if multiscale is None:
        along = [_coordinates_along(path, name, named, axis, n) for axis, n in enumerate(shape)]
        by_coordinates, orientations = stated_by_coordinates(along, placed.order)
        stated = sizes_by_attributes(array.attrs, shape, placed.order)
        stated += sizes_by_attributes(group_attrs, shape, placed.order) + by_coordinates
    else:
        stated = [_stated_by_scale(multiscale, level, named.units, placed.order)]
        words = [named.directions[axis] for axis in placed.order]
        orientations = orientation_by_words("the OME-Zarr axes", words)
    return LoadedVolume(
        values=reordered(lazy, placed.order),
        stated=stated,
        files=files,
        attrs={"dataset": name or "/", **hand},
        doubts=doubts,
        notes=(*imported_notes, *placed.notes),
        orientations=orientations,
    )


def _check_shards(path: Path, name: str) -> None:
    """Refuse an array of a store of planish, which lists its shards, where some are lost."""
    lost_shards = [shard for shard in missing_shards(path) if shard.startswith(f"{name}/")]
    if lost_shards:
        raise FileError(
            f"{path.name} has lost {len(lost_shards)} of its shards, first {lost_shards[0]}; they"
            " would read as zeros. Copy it or import the volume again."
        )


def _stated_by_scale(multiscale: Fields, level: int, units: list[str], order: Shape) -> Stated:
    """Voxel size by the scale transformations of the level and of the whole image."""
    source = "the OME-Zarr scale"
    scale = _scale_of(multiscale["datasets"][level], len(units))
    if scale is None:
        return Stated(source, NO_SIZE, "the level has no scale transformation")
    image_scale = _scale_of(multiscale, len(units)) or [1.0] * len(units)
    lengths = [a * b for a, b in zip(scale, image_scale, strict=True)]
    return stated_in(source, lengths, units, order)


def _metadata_files(folder: Path) -> list[Path]:
    """Files with the metadata of a group or an array; empty for a folder that is neither."""
    return [folder / name for name in METADATA if (folder / name).is_file()]


def _group_attrs(path: Path, name: str) -> Fields:
    """Attributes of the group in which an array lies; none where it lies in no group."""
    parent = name.rpartition("/")[0]
    if not name or not _metadata_files(path / parent):
        return {}
    with reading(path):
        return dict(_open_node(path, parent).attrs)


def _said_at_import(group_attrs: Fields) -> tuple[dict[str, str], list[str]]:
    """Hand and notes of the file from which planish imported a volume.

    The hand is the attribute ``hand`` or ``turned``, where one was noted.
    """
    stated: Any = group_attrs.get("planish")
    if not isinstance(stated, dict):
        return {}, []
    hand = {key: stated[key] for key in ("hand", "turned") if isinstance(stated.get(key), str)}
    notes: Any = stated.get("notes")
    if not isinstance(notes, list):
        return hand, []
    return hand, [*map(str, notes)]


def _read_part(path: Path, name: str, shape: Shape, where: Where) -> Array:
    times_ns = [file.stat().st_mtime_ns for file in _metadata_files(path / name)]
    array = _open_again(path, name, max(times_ns, default=0))
    if tuple(array.shape) != shape:
        raise FileError(f"{path.name} was changed while planish read it. Start again.")
    if is_plain(array) and all(w.step == 1 for w in where):
        return read_plain(path / name, array, where)
    # In shards, and behind other codecs, a checksum guards the chunks.
    codec_names = [type(codec).__name__.casefold() for codec in array.compressors]
    if array.shards is None and codec_names and "blosc" in codec_names[-1]:
        _check_blosc(array, where, path / name, path)
    return np.asarray(array[where], array.dtype.newbyteorder("="))


@lru_cache(maxsize=8)
def _open_again(path: Path, name: str, _changed_ns: int) -> Any:
    """Open an array, once for all of its parts as long as nobody changes it."""
    return _open_node(path, name)


def _part_of(path: Path, part: str) -> str:
    pieces = path_words(part.replace("\\", "/"))
    name = "/".join(pieces)
    if ".." in pieces or not (path / name).resolve().is_relative_to(path.resolve()):
        raise FileError(
            f"{path.name}: {part!r} leads out of the store, which planish does not open. Check its"
            " metadata."
        )
    return name


def _open_node(path: Path, name: str) -> Any:
    node_folder = path / name
    node_text = name or "its root"
    metadata = _metadata_files(node_folder)
    if not metadata:
        raise FileError(
            f"{path.name} has nothing at {node_text}: no zarr.json, .zarray or .zgroup. Check the"
            " name."
        )
    if any(file.stat().st_size > 50_000_000 for file in metadata):
        raise damaged(path, f"the metadata of {node_text} are larger than 50 MB")
    with reading(path):
        # Each node is opened by its own folder: neither parents nor consolidated metadata are read.
        node_store = LocalStore(node_folder, read_only=True)
        return zarr.open(store=node_store, mode="r", use_consolidated=False)


def _find_level(path: Path, name: str) -> tuple[Fields | None, int, str]:
    """Multiscale image, level in it, and name of the array that is read.

    The image is None, and the level 0, for an array that belongs to none. ``name`` is the part that
    was chosen, empty for the whole store.
    """
    node = _open_node(path, name)
    if isinstance(node, zarr.Array):
        return _level_of(path, name)
    multiscale = _multiscale_of(node, path)
    if multiscale is not None:
        finest = multiscale["datasets"][0]
        first = _part_of(path, str(finest.get("path", "")))
        return multiscale, 0, f"{name}/{first}".strip("/")
    keys = _ome_keys(node, path)
    if "plate" in keys:
        raise VolumeError(
            f"{path.name} is a plate with images in many wells. Choose one as {path.name}:A/1/0."
        )
    # The group OME of bioformats2raw holds no image.
    members = _members(path, name) - {"OME" if "bioformats2raw.layout" in keys else ""}
    volumes = [m for m in sorted(members) if _is_volume(path, f"{name}/{m}".strip("/"))]
    for candidates in (volumes, sorted(members)):
        if len(candidates) == 1:
            return _find_level(path, f"{name}/{candidates[0]}".strip("/"))
    raise VolumeError(
        f"{path.name} has no multiscale image at {name or 'its root'}; it holds"
        f" {_choice_text(sorted(members), path)}"
    )


def _members(path: Path, name: str) -> set[str]:
    """Names of the groups and arrays in a group."""
    with reading(path):
        return {folder.name for folder in (path / name).iterdir() if _metadata_files(folder)}


def _choice_text(members: list[str], path: Path) -> str:
    """Say what a group holds, and what to do where no member is the one to read."""
    if not members:
        return "nothing. Export it again as OME-Zarr."
    return f"{', '.join(members[:8])}. Choose one as {path.name}:{members[0]}."


def _level_of(path: Path, name: str) -> tuple[Fields | None, int, str]:
    """Level of an array that was chosen by its name, as `_find_level` gives it."""
    parent, _, last = name.rpartition("/")
    if name and _metadata_files(path / parent):
        multiscale = _multiscale_of(_open_node(path, parent), path)
        if multiscale is not None:
            levels = [_part_of(path, str(level.get("path"))) for level in multiscale["datasets"]]
            if last in levels:
                return multiscale, levels.index(last), name
    return None, 0, name


def _is_volume(path: Path, name: str) -> bool:
    """True if a member of a group is an array with three axes longer than 1."""
    node = _open_node(path, name)
    return isinstance(node, zarr.Array) and len(extended_axes(node.shape)) == 3


def _ome_keys(group: Any, path: Path) -> Fields:
    with reading(path):
        attrs: Any = dict(group.attrs)
    if isinstance(attrs.get("ome"), dict):
        return attrs["ome"]
    return attrs


def _multiscale_of(group: Any, path: Path) -> Fields | None:
    """The one multiscale image of a group; None where the group has none."""
    ome = _ome_keys(group, path)
    images: Any = ome.get("multiscales")
    match images:
        case None:
            return None
        case [_, _, *_]:
            raise VolumeError(f"{path.name} holds {len(images)} images in one group. {ADVICE}")
        case [{"datasets": [_, *_] as levels} as image] if all(isinstance(v, dict) for v in levels):
            return {**image, "omero": ome.get("omero")}
        case _:
            raise damaged(path, "its multiscales metadata name no data sets")


def _axes_by_ome(multiscale: Fields, count: int, path: Path) -> list[Fields]:
    """What a multiscale image says of each axis: name, type, unit."""
    # Before version 0.3 the axes had no names, and were the last of these.
    entries: Any = multiscale.get("axes", "tczyx"[5 - count :] if count <= 5 else None)
    if not isinstance(entries, (list, str)):
        entries = ()
    axes: Any = [axis if isinstance(axis, dict) else {"name": axis} for axis in entries]
    if len(axes) != count:
        raise damaged(path, f"it names {len(axes)} axes, its array has {count}")
    return axes


class NamedAxes(NamedTuple):
    """What the metadata of an array say about its axes as stored."""

    namings: list[AxisNames]
    units: list[str]
    directions: list[str]  # where they run to, in anatomical words; empty where nothing is said


def _named_axes(multiscale: Fields | None, array: Any, path: Path) -> NamedAxes:
    """Names of the axes by OME, by the array's metadata and by its attributes."""
    count = len(array.shape)
    namings: list[AxisNames] = []
    units = [""] * count
    directions = [""] * count
    if multiscale is not None:
        axes = _axes_by_ome(multiscale, count, path)
        names = tuple(str(axis.get("name", "")) for axis in axes)
        namings.append(AxisNames("the OME-Zarr axes", names))
        units = [str(axis.get("unit", "")) for axis in axes]
        directions = [_direction_of(axis) for axis in axes]
    own_names: Any = getattr(array.metadata, "dimension_names", None)
    if own_names is not None and len(own_names) == count:
        words = tuple(str(name or "") for name in own_names)
        namings.append(AxisNames("its dimension names", words))
    namings += names_by_attributes(array.attrs, array.shape, is_own=True)
    return NamedAxes(namings, units, directions)


def _direction_of(axis: Fields) -> str:
    """Where an axis runs to, as in ``left-to-right``; empty where nothing is said."""
    orientation: Any = axis.get("orientation")
    value = orientation.get("value", "") if isinstance(orientation, dict) else ""
    return str(value).rpartition("-to-")[2]


def _channel_labels(multiscale: Fields | None) -> str:
    omero: Any = (multiscale or {}).get("omero")
    channels: Any = omero.get("channels") if isinstance(omero, dict) else None
    entries = [channel for channel in channels or () if isinstance(channel, dict)]
    return ", ".join(str(channel.get("label")) for channel in entries)


def _coordinates_along(
    path: Path, name: str, named: NamedAxes, axis: int, count: int
) -> Coordinates | None:
    """Coordinates of an axis in an array of its name beside the values, as xarray writes them."""
    if not name:  # an array that lies in no group
        return None
    group_name = name.rpartition("/")[0]
    for naming in named.namings:
        axis_name = naming.names[axis]
        array_name = f"{group_name}/{axis_name}".strip("/")
        if not re.fullmatch(r"\w+", axis_name) or not _metadata_files(path / array_name):
            continue
        node = _open_node(path, array_name)
        is_row = isinstance(node, zarr.Array) and node.shape == (count,)
        if is_row and node.dtype.kind in "uif":
            unit = word_of(node.attrs.get("units", ""))
            return Coordinates(axis_name, np.asarray(node[:]), unit)
    return None


def _scale_of(owner: Fields, count: int) -> list[float] | None:
    """Scale along each of ``count`` axes by the metadata of an image or a level; None for none."""
    transformations: Any = owner.get("coordinateTransformations")
    if not isinstance(transformations, list):
        return None
    for transformation in transformations:
        is_scale = isinstance(transformation, dict) and transformation.get("type") == "scale"
        scale: Any = transformation.get("scale") if is_scale else None
        if not isinstance(scale, list) or len(scale) != count:
            continue
        if all(type(factor) in (int, float) for factor in scale):
            return [*map(float, scale)]
    return None


def _stored_chunks(folder: Path, files: list[Path]) -> Iterator[Shape]:
    for file in files:
        # ``c/0/1/2``, ``c.0.1.2``, ``0/1/2`` or ``0.1.2``
        key = file.relative_to(folder).as_posix().removeprefix("c").strip("/.")
        words = key.replace("/", ".").split(".")
        if file.name[0] != "." and all(map(str.isdecimal, words)):
            yield tuple(map(int, words))


def _check_blosc(array: Any, where: Where, folder: Path, path: Path) -> None:
    """Compare the chunks of a part with the sizes in their first bytes.

    Blosc itself would read on behind their end.
    """
    needed_bytes = math.prod(array.chunks) * array.dtype.itemsize
    for part in chunk_parts(where, array.chunks):
        chunk = folder / array.metadata.encode_chunk_key(part.position)
        if not chunk.is_file():
            continue
        with chunk.open("rb") as file:
            first_bytes = file.read(16)
        stored_bytes = chunk.stat().st_size
        unpacked = packed = 0
        if len(first_bytes) == 16:
            unpacked, packed = struct.unpack_from("<4xIxxxxI", first_bytes)
        if (unpacked, packed) != (needed_bytes, stored_bytes):
            chunk_name = chunk.relative_to(path).as_posix()
            sizes_text = f"{stored_bytes} bytes of {packed}, for {unpacked} bytes of values"
            raise damaged(
                path, f"its chunk {chunk_name} has {sizes_text}, where {needed_bytes} are needed"
            )
