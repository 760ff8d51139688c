"""Volumes in HDF5 files, and in the NeXus files of reconstruction programs (NXtomoproc).

HDF5 opens other files without asking, and reads those that are not there as zeros: through external
links, external storage and virtual data sets. So every link is followed here, by hand, and a file
outside the folder is refused.
"""

import math
import os
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import h5py  # pyright: ignore[reportMissingTypeStubs]
import numpy as np

from planish.core.errors import FileError, VolumeError
from planish.core.lazy import Where
from planish.core.typing import Array, Shape, Texts
from planish.io.attributes import (
    Coordinates,
    names_by_attributes,
    names_by_indices,
    sizes_by_attributes,
    stated_by_coordinates,
    word_of,
)
from planish.io.axes import AxisNames, extended_axes, place_axes
from planish.io.formats import (
    ListedVolume,
    LoadedVolume,
    Place,
    check_chunks,
    describe_volumes,
    only_volume,
    path_words,
    referenced_file,
)
from planish.io.guard import reading, size_of_file
from planish.io.lazy import FileArray, reordered
from planish.io.tiff import damaged

MOST_COORDINATES = 10_000_000  # along one axis
MOST_LINKS = 32  # links that one path may pass; more is a circle


@contextmanager
def opened(path: Path) -> Generator[h5py.File]:
    """Open a file for reading, whether or not the folder can be written and others have it open."""
    size_of_file(path)
    with reading(path), h5py.File(path, "r", locking=False) as file:
        yield file


def link_of(group: Any, name: str) -> Any:
    """A HardLink, SoftLink or ExternalLink of h5py, which is not followed.

    None where a group has no such member.
    """
    # To ask h5py whether the group holds it would open the file that an external link names.
    if not name or "/" in name or not isinstance(group, h5py.Group):
        return None
    key = name.encode()
    links: Any = group.id.links
    if not links.exists(key):
        return None
    kind = links.get_info(key).type
    if kind == h5py.h5l.TYPE_HARD:  # pyright: ignore[reportAttributeAccessIssue]
        return h5py.HardLink()
    target: Any = links.get_val(key)
    if kind == h5py.h5l.TYPE_SOFT:  # pyright: ignore[reportAttributeAccessIssue]
        return h5py.SoftLink(os.fsdecode(target))
    return h5py.ExternalLink(os.fsdecode(target[0]), os.fsdecode(target[1]))


def find_dataset(path: Path, name: str) -> tuple[Path, str]:
    """Follow a path through groups and links: file and path within it, ``/entry/data``.

    The file is another one than ``path`` where an external link leads there.
    """
    current_file = path
    group_path = ""
    remaining_names = path_words(name)
    for _ in range(MOST_LINKS):
        with opened(current_file) as file:
            while remaining_names:
                member_name, *remaining_names = remaining_names
                link = link_of(file[group_path or "/"], member_name)
                if link is None:
                    volumes = describe_volumes(volumes_in(path), path.name)
                    raise VolumeError(
                        f"{path.name} has no {name!r}: {member_name!r} is not there. {volumes}"
                    )
                if not isinstance(link, h5py.HardLink):
                    break
                group_path = f"{group_path}/{member_name}"
            else:
                return current_file, group_path
        # On from the target of the link: its own path, and what was to come behind the link.
        is_external = isinstance(link, h5py.ExternalLink)
        base_names = [] if is_external or link.path.startswith("/") else path_words(group_path)
        group_path = ""
        remaining_names = [*base_names, *path_words(link.path), *remaining_names]
        if is_external:
            current_file = referenced_file(
                path.parent, link.filename, path, base_folder=current_file.parent
            )
    raise FileError(
        f"{path.name}: {name!r} leads through more than {MOST_LINKS} links. Copy the data set into"
        " one file."
    )


def check_storage(dataset: h5py.Dataset, path: Path, *, depth: int = 0) -> None:
    """Refuse a data set whose values lie outside the folder, or in files that are not there."""
    fault_text = _storage_fault(dataset, path, depth)
    if fault_text:
        raise FileError(
            f"{path.name}: {dataset.name} {fault_text}. Copy it into one file, for example with"
            " h5repack."
        )


def _storage_fault(dataset: h5py.Dataset, path: Path, depth: int) -> str:
    """What is wrong with where a data set keeps its values; empty where nothing is.

    ``depth``: how many virtual data sets are made of each other to reach this one.
    """
    if dataset.external:
        return (
            f"keeps its values in another file ({dataset.external[0][0]!r}), which planish does not"
            " open"
        )
    sources = _virtual_sources(dataset)
    if sources and depth > 4:
        return "is virtual over virtual data sets"
    for source, name in sources:
        if "%" in source + name:
            return "takes its parts from a pattern of files"
        file = _source_file(source, path)
        target, target_name = find_dataset(file, name)
        is_same_name = target_name.strip("/") == name.strip("/")
        if not is_same_name or target.resolve() != file.resolve():
            return "reaches its parts through links"
        with opened(file) as source_file:
            source_dataset: Any = source_file[name]
            check_storage(source_dataset, file, depth=depth + 1)
    return ""


def _virtual_sources(dataset: Any) -> list[tuple[str, str]]:
    """Files and data sets of which a virtual data set is made; empty for others."""
    sources = dataset.virtual_sources() if dataset.is_virtual else []
    return sorted({(source.file_name, source.dset_name) for source in sources})


def _source_file(source: str, path: Path) -> Path:
    if source == ".":
        return path
    return referenced_file(path.parent, source, path)


def source_files(dataset: Any, path: Path) -> list[Path]:
    """Files from which a checked virtual data set takes its values; empty for others."""
    files: list[Path] = []
    for source, name in _virtual_sources(dataset):
        source_path = _source_file(source, path)
        with opened(source_path) as file:
            files += [source_path, *source_files(file[name], source_path)]
    return files


def _shape_of(dataset: Any) -> Shape:
    """Lengths of the axes; none of a single value, or of a data set without values."""
    return tuple(map(int, dataset.shape or ()))


def volumes_in(path: Path) -> list[ListedVolume]:
    """Names, shapes and types of all data sets with three axes longer than 1, links left aside."""
    volumes: list[ListedVolume] = []
    visit_count = count()

    def note_volume(name: str, member: Any) -> bool | None:
        if isinstance(member, h5py.Dataset) and member.dtype.kind in "buif":
            shape = _shape_of(member)
            if len(extended_axes(shape)) == 3:
                volumes.append((f"/{name}", shape, str(member.dtype)))
        return True if next(visit_count) > 20_000 else None

    with opened(path) as file:
        file.visititems(note_volume)
    return volumes


def load(place: Place, _channel: str | None, _memory_bytes: int | None) -> LoadedVolume:
    """Read the data set that was chosen, that NeXus names, or the only one with three axes."""
    path = place.path
    wanted = place.part.strip("/")
    if not wanted:
        with opened(path) as file:
            wanted = _default_dataset(file, path) or ""
    file_path = path
    if wanted:
        file_path, name = find_dataset(path, wanted)
    else:
        name = only_volume(volumes_in(path), path.name)
    with opened(file_path) as file:
        dataset: Any = file[name]
        if not isinstance(dataset, h5py.Dataset):
            volumes = describe_volumes(volumes_in(path), path.name)
            raise VolumeError(f"{path.name}: {place.part!r} is a group. {volumes}")
        shape = _shape_of(dataset)
        namings = _axis_names(dataset)
        placed = place_axes(shape, namings, f"{path.name}: {name}")
        array, doubts = lazy_dataset(dataset, file_path)
        files = [path, file_path, *source_files(dataset, file_path)]
        stated = sizes_by_attributes(dataset.attrs, shape, placed.order)
        stated += sizes_by_attributes(dataset.parent.attrs, shape, placed.order)
        along = [_coordinates_along(dataset, axis, namings) for axis in range(len(shape))]
        by_coordinates, orientations = stated_by_coordinates(along, placed.order)
    return LoadedVolume(
        values=reordered(array, placed.order),
        stated=[*by_coordinates, *stated],
        files=files,
        attrs={"dataset": name},
        doubts=doubts,
        notes=placed.notes,
        orientations=orientations,
    )


def lazy_dataset(dataset: Any, path: Path) -> tuple[FileArray, Texts]:
    """Return an array that reads a data set in parts, and what looks wrong.

    Refuse one without values.
    """
    check_storage(dataset, path)
    chunks = dataset.chunks  # the shape of one; None where the values lie in one piece
    shape = _shape_of(dataset)
    read_part = partial(_read_part, path, dataset.name, shape)
    array = FileArray(path, shape, dataset.dtype, read_part)
    array.piece_bytes = 0 if chunks is None else math.prod(chunks) * array.dtype.itemsize
    if dataset.is_virtual:
        return array, ()
    if dataset.id.get_storage_size() == 0:
        raise damaged(path, f"{dataset.name} has no values stored")
    if chunks is None:
        return array, ()
    n_chunks = np.prod(-(-np.array(shape) // chunks))
    if dataset.id.get_num_chunks() == n_chunks:
        return array, ()
    positions: list[Shape] = []

    def note_position(chunk: Any) -> None:
        position = np.floor_divide(chunk.chunk_offset, chunks)
        positions.append(tuple(position.tolist()))

    dataset.id.chunk_iter(note_position)
    return array, check_chunks(positions, shape, chunks, name=f"{path.name}: {dataset.name}")


def _read_part(path: Path, name: str, shape: Shape, where: Where) -> Array:
    with opened(path) as file:
        # Parts of a virtual data set are looked for beside the file first, wherever planish was
        # started.
        access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
        access.set_virtual_prefix(b"${ORIGIN}")
        dataset: Any = h5py.Dataset(h5py.h5d.open(file.id, name.encode(), access))
        if tuple(dataset.shape) != shape:
            raise FileError(f"{path.name} was changed while planish read it. Start again.")
        return np.asarray(dataset[where], dataset.dtype.newbyteorder("="))


def _default_dataset(file: h5py.File, path: Path) -> str | None:
    """Follow ``default`` and ``signal`` from the root; None where the file is no NeXus file."""
    entry = _default_group(file, "NXentry")
    definition = _child(entry, "definition")
    if isinstance(definition, h5py.Dataset) and word_of(definition[()]) == "NXtomo":
        raise VolumeError(
            f"{path.name} holds raw projections (NXtomo). Give the reconstructed volume"
            " (NXtomoproc)."
        )
    data = _default_group(entry, "NXdata")
    if data is None:
        return None
    signal = _attribute(data, "signal")
    # Older files mark the data set itself; without a mark it is called so.
    if not signal:
        sets = [key for key in data if isinstance(_child(data, key), h5py.Dataset)]
        marked = [key for key in sets if "signal" in data[key].attrs]
        signal = [*marked, "data"][0]
    return None if link_of(data, signal) is None else f"{data.name}/{signal}"


def _default_group(group: Any, kind: str) -> Any:
    """Group of a NeXus class that ``default_member`` names, or the only one there is.

    None in no group.
    """
    if group is None:
        return None
    default_member = _child(group, _attribute(group, "default"))
    for members in ([default_member], [_child(group, key) for key in group]):
        groups = [member for member in members if isinstance(member, h5py.Group)]
        candidates = [member for member in groups if _attribute(member, "NX_class") == kind]
        if len(candidates) == 1:
            return candidates[0]
    return None


def _child(group: Any, name: str) -> Any:
    """Member of a group that is no link; None where there is none."""
    if isinstance(link_of(group, name), h5py.HardLink):
        return group[name]
    return None


def _axis_names(dataset: Any) -> list[AxisNames]:
    """Names of the axes of a data set by every convention of HDF5."""
    shape = dataset.shape
    scales = tuple(_last_word(scale) for scale in _scales(dataset))
    coordinates = tuple(_attribute(scale, "name") for scale in _emd_scales(dataset))
    namings = [AxisNames("the scales of its dimensions", scales)]
    namings.append(AxisNames("the EMD dimensions", coordinates))
    namings += names_by_attributes(dataset.attrs, shape, is_own=True)
    group_attrs = dataset.parent.attrs
    namings += names_by_attributes(group_attrs, shape, is_own=False)
    return namings + names_by_indices(group_attrs, shape)


def _scales(dataset: Any) -> list[Any]:
    """The first scale attached to each dimension, of the same file; None where there is none."""
    # Read as an attribute: the library's own functions for scales crash on a damaged one.
    none_attached: list[Any] = [None] * len(dataset.shape)
    if "DIMENSION_LIST" not in dataset.attrs:
        return none_attached
    stored_type = dataset.attrs.get_id("DIMENSION_LIST").dtype
    # For each dimension a list of references, or one.
    if not h5py.check_ref_dtype(h5py.check_vlen_dtype(stored_type) or stored_type):
        return none_attached
    references = np.ravel(dataset.attrs["DIMENSION_LIST"])
    if len(references) != len(dataset.shape):
        return none_attached
    firsts = [next(iter(np.ravel(entry)), None) for entry in references]
    return [dataset.file[first] if first else None for first in firsts]


def _emd_scales(dataset: Any) -> list[Any]:
    """The data sets ``dim1``, ``dim2`` … beside the values of an EMD file, as its axes."""
    numbers = range(1, len(dataset.shape) + 1)
    if "emd_group_type" in dataset.parent.attrs:
        return [_child(dataset.parent, f"dim{number}") for number in numbers]
    return [None for _ in numbers]


def _last_word(member: Any) -> str:
    if member is None:
        return ""
    return str(member.name).rpartition("/")[2]


def _coordinates_along(dataset: Any, axis: int, namings: Sequence[AxisNames]) -> Coordinates | None:
    """Coordinates of an axis: a scale of it, or a data set beside it with the axis's name."""
    members = [_child(dataset.parent, naming.names[axis]) for naming in namings]
    n_values = dataset.shape[axis]
    for member in (_scales(dataset)[axis], _emd_scales(dataset)[axis], *members):
        # netCDF writes a scale without coordinates for a dimension that has none.
        is_empty = _attribute(member, "NAME").startswith("This is a netCDF dimension but not")
        if is_empty or not isinstance(member, h5py.Dataset):
            continue
        is_plain = not member.is_virtual and not member.external
        is_one_row = member.shape == (n_values,) and n_values < MOST_COORDINATES
        if is_plain and is_one_row and member.dtype.kind in "uif":
            return Coordinates(_last_word(member), member[()], _attribute(member, "units"))
    return None


def _attribute(owner: Any, name: str) -> str:
    if owner is not None and name in owner.attrs:
        return word_of(owner.attrs[name])
    return ""
