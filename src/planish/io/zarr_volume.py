"""OME-Zarr volumes (0.4 on zarr v2, 0.5 on zarr v3), and plain zarr arrays with three axes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.storage import LocalStore

from planish.core.errors import FileError, VolumeError
from planish.core.lazy import Where
from planish.io.chunks import check_chunks
from planish.io.formats import Place
from planish.io.guard import reading
from planish.io.lazy import FileArray, turned
from planish.io.loaded import ADVICE, LoadedVolume, loaded
from planish.io.sizes import Stated, unit_um
from planish.io.store import missing_shards
from planish.io.stored import check_shape
from planish.io.tiff import size_words
from planish.io.zarr_chunks import METADATA, check_blosc, packed_by_blosc, stored_chunks

LARGEST_METADATA = 50_000_000
SPACE = "zyx"


def load(place: Place, *, channel: str | None, memory_bytes: int | None) -> LoadedVolume:
    """Read the first level of a multiscale image, or the array that was chosen, in parts when they are asked for."""
    del channel
    path = place.path
    if not path.is_dir():
        raise FileError(f"{path.name} is no folder. A zarr store is one: unpack it, or check the name.")
    name = part_of(path, place.part)
    multiscale, level, name = find_level(path, name)
    array = open_node(path, name)
    if not isinstance(array, zarr.Array):
        raise VolumeError(f"{path.name}: {name or 'the store'} is no array. Choose one as {path.name}:NAME.")
    shape = tuple(int(n) for n in array.shape)
    axes = axis_list(multiscale, len(shape), path)
    order = check_axes(axes, shape, multiscale, path)
    check_shape(shape, path)
    # A store that planish wrote lists its shards, also those that hold one constant.
    lost = [shard for shard in missing_shards(path) if shard.startswith(f"{name}/")]
    if lost:
        raise FileError(
            f"{path.name} has lost {len(lost)} of its shards, first {lost[0]}; they would read as zeros. Copy it "
            "again, or import the volume again."
        )
    with reading(path):
        chunk = tuple(int(n) for n in (array.shards or array.chunks))
        notes = check_chunks(stored_chunks(path / name), shape, chunk, name=path.name)
        if array.dtype.kind not in "buif":
            raise VolumeError(
                f"{path.name} has {array.dtype} values. Needed are integers or real numbers up to 64 bits."
            )
        lazy = ZarrArray(path, name, shape, np.dtype(array.dtype), tuple(int(n) for n in array.chunks))
    return loaded(
        turned(lazy, order),
        path,
        stated=[] if multiscale is None else [stated_by_scale(multiscale, level, axes, order)],
        file_bytes=sum(file.stat().st_size for file in (path / name).rglob("*") if file.is_file()),
        memory_bytes=memory_bytes,
        attrs={"dataset": name or "/"},
        notes=notes,
    )


def files(place: Place) -> list[Path]:
    """All files of the store."""
    return sorted(file for file in place.path.rglob("*") if file.is_file())


def part_of(path: Path, part: str) -> str:
    """Path inside the store."""
    pieces = [piece for piece in part.replace("\\", "/").split("/") if piece not in ("", ".")]
    if ".." in pieces or not (path / "/".join(pieces)).resolve().is_relative_to(path.resolve()):
        raise FileError(
            f"{path.name}: {part!r} leads out of the store, which planish does not open. Check its metadata."
        )
    return "/".join(pieces)


def open_node(path: Path, name: str) -> Any:
    """Open a group or an array for reading."""
    place = path / name
    there = [file for file in METADATA if (place / file).is_file()]
    if not there:
        raise FileError(
            f"{path.name} has nothing at {name or 'its root'}: no zarr.json, .zarray or .zgroup. Check the name."
        )
    if any((place / file).stat().st_size > LARGEST_METADATA for file in there):
        raise FileError(f"{path.name}: the metadata of {name or 'its root'} are larger than 50 MB. Export it again.")
    with reading(path):
        # Each node is opened by its own folder: neither parents nor consolidated metadata are read.
        return zarr.open(store=LocalStore(place, read_only=True), mode="r", use_consolidated=False)


def find_level(path: Path, name: str) -> tuple[Mapping[str, Any] | None, int, str]:
    """Find the multiscale image that a part belongs to, the level in it, and the path of that level's array."""
    node = open_node(path, name)
    if isinstance(node, zarr.Array):
        parent, _, last = name.rpartition("/")
        if name and any((path / parent / file).is_file() for file in (".zgroup", "zarr.json")):
            multiscale = multiscale_of(open_node(path, parent), path)
            names = [] if multiscale is None else [level_name(d, path) for d in multiscale["datasets"]]
            if last in names:
                return multiscale, names.index(last), name
        return None, 0, name
    multiscale = multiscale_of(node, path)
    if multiscale is not None:
        first = level_name(multiscale["datasets"][0], path)
        return multiscale, 0, f"{name}/{first}".strip("/")
    with reading(path):
        members = sorted(
            child.name for child in (path / name).iterdir() if any((child / m).is_file() for m in METADATA)
        )
    if len(members) == 1:
        return find_level(path, f"{name}/{members[0]}".strip("/"))
    listed = ", ".join(members[:8]) or "nothing"
    example = f" Choose one as {path.name}:{members[0]}." if members else " Export it again as OME-Zarr."
    raise VolumeError(f"{path.name} has no multiscale image at {name or 'its root'}; it holds {listed}.{example}")


def multiscale_of(group: Any, path: Path) -> Mapping[str, Any] | None:
    """The one multiscale image of a group; None where the group has none."""
    with reading(path):
        attrs: Any = dict(group.attrs)
    ome = attrs.get("ome") if isinstance(attrs.get("ome"), dict) else attrs
    found: Any = ome.get("multiscales")
    if found is None:
        return None
    if isinstance(found, list) and len(found) > 1:
        raise VolumeError(f"{path.name} holds {len(found)} images in one group. {ADVICE}")
    if (
        not isinstance(found, list)
        or not found
        or not isinstance(found[0], dict)
        or not isinstance(found[0].get("datasets"), list)
        or not found[0]["datasets"]
        or not all(isinstance(d, dict) for d in found[0]["datasets"])
    ):
        raise FileError(f"{path.name}: its multiscales metadata name no data sets. Export it again as OME-Zarr.")
    return {**found[0], "omero": ome.get("omero")}


def level_name(dataset: Any, path: Path) -> str:
    """Path of a level in its group."""
    return part_of(path, str(dataset.get("path", "")))


def axis_list(multiscale: Mapping[str, Any] | None, count: int, path: Path) -> list[dict[str, str]]:
    """Axes of an array: name, type and unit, where the metadata state them."""
    named: Any = None if multiscale is None else multiscale.get("axes")
    if named is None:
        return [{"name": name} for name in "tczyx"[5 - count :]] if count <= 5 else [{"name": "?"}] * count
    axes = [
        {str(k): str(v) for k, v in axis.items()} if isinstance(axis, dict) else {"name": str(axis)}
        for axis in (named if isinstance(named, list) else [])
    ]
    if len(axes) != count:
        raise FileError(f"{path.name} names {len(axes)} axes, its array has {count}. Export it again as OME-Zarr.")
    return axes


def check_axes(
    axes: list[dict[str, str]], shape: tuple[int, ...], multiscale: Mapping[str, Any] | None, path: Path
) -> tuple[int, ...]:
    """Return which axes are z, y and x; all others have to be of length 1."""
    names = [axis.get("name", "").casefold() for axis in axes]
    for name, n in zip(names, shape, strict=True):
        if name not in SPACE and n > 1:
            what = {"c": "channels", "t": "time points"}.get(name, f"places along {name!r}")
            labels = channel_labels(multiscale) if name == "c" else ""
            raise VolumeError(f"{path.name} has {n} {what}{labels}: {size_words(shape)} ({', '.join(names)}). {ADVICE}")
    if any(names.count(letter) != 1 for letter in SPACE):
        raise VolumeError(f"{path.name} is no volume: its axes are {', '.join(names)}, {size_words(shape)}. {ADVICE}")
    return tuple(names.index(letter) for letter in SPACE)


def channel_labels(multiscale: Mapping[str, Any] | None) -> str:
    """Names of the channels, in brackets."""
    omero: Any = None if multiscale is None else multiscale.get("omero")
    channels: Any = omero.get("channels") if isinstance(omero, dict) else None
    labels = [str(c.get("label", "?")) for c in channels if isinstance(c, dict)] if isinstance(channels, list) else []
    return f" ({', '.join(labels)})" if labels else ""


def stated_by_scale(
    multiscale: Mapping[str, Any], level: int, axes: list[dict[str, str]], order: tuple[int, ...]
) -> Stated:
    """Voxel size along z, y, x from the scale transformations of the level and of the whole image."""
    source = "the OME-Zarr scale"
    datasets: Any = multiscale["datasets"]
    factors = [scale_of(datasets[level], len(axes)), scale_of(multiscale, len(axes))]
    if factors[0] is None:
        return Stated(source=source, um=(None, None, None), note="the level has no scale transformation")
    found: list[float | None] = []
    notes: list[str] = []
    for axis in order:
        value = math.prod(factor[axis] for factor in factors if factor is not None)
        unit = axes[axis].get("unit", "")
        length = unit_um(unit)
        found.append(None if length is None or not math.isfinite(value) or value <= 0 else value * length)
        if length is None:
            what = f"{unit!r}, which is no unit of length" if unit else "no unit"
            notes.append(f"{axes[axis].get('name')} has {what}")
    return Stated(source=source, um=tuple(found), note=", ".join(notes))


def scale_of(owner: Any, count: int) -> list[float] | None:
    """Factors of the scale transformation of a level or an image."""
    transformations: Any = owner.get("coordinateTransformations")
    for one in transformations if isinstance(transformations, list) else []:
        values: Any = one.get("scale") if isinstance(one, dict) and one.get("type") == "scale" else None
        if isinstance(values, list) and len(values) == count and all(type(v) in (int, float) for v in values):
            return [float(v) for v in values]
    return None


class ZarrArray(FileArray):
    """An array of a zarr store."""

    def __init__(
        self, path: Path, name: str, shape: tuple[int, ...], dtype: np.dtype[Any], chunks: tuple[int, ...]
    ) -> None:
        self.path, self.name, self.shape, self.chunks = path, name, shape, chunks
        self.dtype, self.piece_bytes = dtype.newbyteorder("="), math.prod(chunks) * dtype.itemsize

    def read(self, where: Where) -> NDArray[Any]:
        """Read a part."""
        array = open_node(self.path, self.name)
        if tuple(array.shape) != self.shape:
            raise FileError(f"{self.path.name} was changed while planish read it. Start again.")
        if packed_by_blosc(array):
            check_blosc(array, where, self.path / self.name, self.path)
        return np.asarray(array[where], self.dtype)
