"""OME-Zarr volumes (0.4 on zarr v2, 0.5 on zarr v3), and plain zarr arrays with three axes."""

import math
import struct
from collections.abc import Iterator, Mapping
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.storage import LocalStore

from planish.core.errors import FileError, VolumeError
from planish.core.lazy import Where
from planish.io.formats import ADVICE, LoadedVolume, Place, check_chunks, check_type
from planish.io.guard import reading
from planish.io.hashes import missing_shards
from planish.io.lazy import FileArray, transposed
from planish.io.shards import is_plain, read_plain
from planish.io.sizes import Stated, stated_in
from planish.io.tiff import damaged, size_words

# Files of a zarr store that are no chunks.
METADATA = frozenset({"zarr.json", ".zarray", ".zattrs", ".zgroup", ".zmetadata"})
Keys = Mapping[str, Any]


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
    shape = tuple(int(n) for n in array.shape)
    units, order = _axes(multiscale, shape, path)
    # A store that planish wrote lists its shards, also those that hold one constant.
    if lost := [shard for shard in missing_shards(path) if shard.startswith(f"{name}/")]:
        raise FileError(
            f"{path.name} has lost {len(lost)} of its shards, first {lost[0]}; they would read as"
            " zeros. Copy it or import the volume again."
        )
    files = [file for file in (path / name).rglob("*") if file.is_file()]
    with reading(path):
        chunk = tuple(int(n) for n in array.shards or array.chunks)
        notes = check_chunks(_stored_chunks(path / name, files), shape, chunk, name=path.name)
        check_type(np.dtype(array.dtype), path)
        lazy = FileArray(
            path,
            shape,
            np.dtype(array.dtype).newbyteorder("="),
            partial(_read_part, path, name, shape),
        )
        lazy.chunks = tuple(int(n) for n in array.chunks)
        lazy.piece_bytes = math.prod(lazy.chunks) * lazy.dtype.itemsize
    stated: list[Stated] = []
    if multiscale is not None:
        # The scale transformations of the level and of the whole image.
        scale = _scale_of(multiscale["datasets"][level], len(shape))
        image_scale = _scale_of(multiscale, len(shape)) or [1.0] * len(shape)
        stated = [
            Stated(
                "the OME-Zarr scale", (None, None, None), "the level has no scale transformation"
            )
        ]
        if scale is not None:
            voxel = [a * b for a, b in zip(scale, image_scale, strict=True)]
            stated = [stated_in("the OME-Zarr scale", voxel, units, order)]
    return LoadedVolume(
        values=transposed(lazy, order),
        stated=stated,
        files=files,
        attrs={"dataset": name or "/"},
        notes=notes,
    )


def _read_part(path: Path, name: str, shape: tuple[int, ...], where: Where) -> NDArray[Any]:
    changed_ns = max(
        (file.stat().st_mtime_ns for m in METADATA if (file := path / name / m).is_file()),
        default=0,
    )
    array = _open_again(path, name, changed_ns)
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
    pieces = [piece for piece in part.replace("\\", "/").split("/") if piece not in ("", ".")]
    if ".." in pieces or not (path / "/".join(pieces)).resolve().is_relative_to(path.resolve()):
        raise FileError(
            f"{path.name}: {part!r} leads out of the store, which planish does not open. Check its"
            " metadata."
        )
    return "/".join(pieces)


def _open_node(path: Path, name: str) -> Any:
    node_folder, node_text = path / name, name or "its root"
    metadata = [file for file in METADATA if (node_folder / file).is_file()]
    if not metadata:
        raise FileError(
            f"{path.name} has nothing at {node_text}: no zarr.json, .zarray or .zgroup. Check the"
            " name."
        )
    if any((node_folder / file).stat().st_size > 50_000_000 for file in metadata):
        raise damaged(path, f"the metadata of {node_text} are larger than 50 MB")
    with reading(path):
        # Each node is opened by its own folder: neither parents nor consolidated metadata are read.
        return zarr.open(
            store=LocalStore(node_folder, read_only=True), mode="r", use_consolidated=False
        )


def _find_level(path: Path, name: str) -> tuple[Keys | None, int, str]:
    node = _open_node(path, name)
    if isinstance(node, zarr.Array):
        parent, _, last = name.rpartition("/")
        if name and any((path / parent / file).is_file() for file in (".zgroup", "zarr.json")):
            multiscale = _multiscale_of(_open_node(path, parent), path)
            names = (
                []
                if multiscale is None
                else [_part_of(path, str(d.get("path"))) for d in multiscale["datasets"]]
            )
            if last in names:
                return multiscale, names.index(last), name
        return None, 0, name
    multiscale = _multiscale_of(node, path)
    if multiscale is not None:
        first = _part_of(path, str(multiscale["datasets"][0].get("path", "")))
        return multiscale, 0, f"{name}/{first}".strip("/")
    with reading(path):
        members = sorted(
            c.name for c in (path / name).iterdir() if any((c / m).is_file() for m in METADATA)
        )
    keys = _ome_keys(node, path)
    if "plate" in keys:
        raise VolumeError(
            f"{path.name} is a plate with images in many wells. Choose one as {path.name}:A/1/0."
        )
    if "bioformats2raw.layout" in keys:
        members = [member for member in members if member != "OME"]  # which holds no image
    if len(members) == 1:
        return _find_level(path, f"{name}/{members[0]}".strip("/"))
    example = (
        f" Choose one as {path.name}:{members[0]}." if members else " Export it again as OME-Zarr."
    )
    members_text, node_text = ", ".join(members[:8]) or "nothing", name or "its root"
    raise VolumeError(
        f"{path.name} has no multiscale image at {node_text}; it holds {members_text}.{example}"
    )


def _ome_keys(group: Any, path: Path) -> Keys:
    with reading(path):
        attrs: Any = dict(group.attrs)
    return attrs["ome"] if isinstance(attrs.get("ome"), dict) else attrs


def _multiscale_of(group: Any, path: Path) -> Keys | None:
    """The one multiscale image of a group; None where the group has none."""
    ome = _ome_keys(group, path)
    images: Any = ome.get("multiscales")
    if images is None:
        return None
    if isinstance(images, list) and len(images) > 1:
        raise VolumeError(f"{path.name} holds {len(images)} images in one group. {ADVICE}")
    image: Any = images[0] if isinstance(images, list) and images else None
    levels: Any = image.get("datasets") if isinstance(image, dict) else None
    if (
        not isinstance(levels, list)
        or not levels
        or not all(isinstance(level, dict) for level in levels)
    ):
        raise damaged(path, "its multiscales metadata name no data sets")
    return {**image, "omero": ome.get("omero")}


def _axes(
    multiscale: Keys | None, shape: tuple[int, ...], path: Path
) -> tuple[list[str], list[int]]:
    """Units of the axes, and which of them are z, y and x; all others have to be of length 1."""
    image_keys = multiscale or {}
    axes: Any = image_keys.get("axes")
    if axes is None:
        axes = "tczyx"[5 - len(shape) :] if len(shape) <= 5 else "?" * len(shape)
    axis_entries = axes if isinstance(axes, (list, str)) else []
    axes = [axis if isinstance(axis, dict) else {"name": axis} for axis in axis_entries]
    if len(axes) != len(shape):
        raise damaged(path, f"it names {len(axes)} axes, its array has {len(shape)}")
    names = [str(axis.get("name", "")).casefold() for axis in axes]
    shape_words = f"{size_words(shape)} ({', '.join(names)}). {ADVICE}"
    for name, n in zip(names, shape, strict=True):
        if name not in ("z", "y", "x") and n > 1:
            content_text = {"c": "channels", "t": "time points"}.get(name, f"places along {name!r}")
            omero: Any = image_keys.get("omero") if name == "c" else None
            channels: Any = omero.get("channels") if isinstance(omero, dict) else None
            labels = ", ".join(str(c.get("label")) for c in channels or () if isinstance(c, dict))
            raise VolumeError(
                f"{path.name} has {n} {content_text}{f' ({labels})' if labels else ''}:"
                f" {shape_words}"
            )
    if any(names.count(letter) != 1 for letter in "zyx"):
        raise VolumeError(
            f"{path.name} is no volume: its axes are {', '.join(names)}: {shape_words}"
        )
    return [str(axis.get("unit", "")) for axis in axes], [names.index(letter) for letter in "zyx"]


def _scale_of(owner: Keys, count: int) -> list[float] | None:
    transformations: Any = owner.get("coordinateTransformations")
    if not isinstance(transformations, list):
        return None
    for transformation in transformations:
        is_scale = isinstance(transformation, dict) and transformation.get("type") == "scale"
        scale: Any = transformation.get("scale") if is_scale else None
        if (
            isinstance(scale, list)
            and len(scale) == count
            and all(type(v) in (int, float) for v in scale)
        ):
            return [float(v) for v in scale]
    return None


def _stored_chunks(folder: Path, files: list[Path]) -> Iterator[tuple[int, ...]]:
    for file in files:
        # ``c/0/1/2``, ``c.0.1.2``, ``0/1/2`` or ``0.1.2``
        index_words = (
            file.relative_to(folder)
            .as_posix()
            .removeprefix("c")
            .strip("/.")
            .replace("/", ".")
            .split(".")
        )
        if (
            file.name not in METADATA
            and not file.name.startswith(".")
            and all(map(str.isdecimal, index_words))
        ):
            yield tuple(int(number) for number in index_words)


def _check_blosc(array: Any, where: Where, folder: Path, path: Path) -> None:
    """Compare the chunks of a part with the sizes in their first bytes.

    Blosc itself would read on behind their end.
    """
    needed_bytes = math.prod(array.chunks) * array.dtype.itemsize
    spans = [
        range(s.start // c, (s.stop - 1) // c + 1) for s, c in zip(where, array.chunks, strict=True)
    ]
    for position in product(*spans):
        chunk = folder / array.metadata.encode_chunk_key(position)
        if not chunk.is_file():
            continue
        with chunk.open("rb") as file:
            first_bytes = file.read(16)
        stored_bytes = chunk.stat().st_size
        unpacked, packed = (
            struct.unpack_from("<4xIxxxxI", first_bytes) if len(first_bytes) == 16 else (0, 0)
        )
        if (unpacked, packed) != (needed_bytes, stored_bytes):
            chunk_name = chunk.relative_to(path).as_posix()
            sizes_text = f"{stored_bytes} bytes of {packed}, for {unpacked} bytes of values"
            raise damaged(
                path, f"its chunk {chunk_name} has {sizes_text}, where {needed_bytes} are needed"
            )
