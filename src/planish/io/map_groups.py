"""Groups of maps as datasets: written into a store, and read from one."""

import json
import os
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import xarray as xr
import zarr

from planish.core.errors import FileError
from planish.core.files import check_exists, write_text
from planish.core.lazy import ReadOnDemand
from planish.core.threads import map_threads
from planish.io.guard import quiet
from planish.io.map_chunks import StoredArray, is_ours, write_chunks
from planish.io.map_store import (
    COMPLETE,
    OVERVIEWS,
    ROOT,
    create_array,
    is_large,
    json_attrs,
    open_group,
    overviews_of,
    readable,
    stored_group,
)

_METADATA = "zarr.json"


def write_tree(path: Path, groups: Mapping[str, xr.Dataset]) -> None:
    """Write datasets as groups of a zarr store for ``xarray.open_datatree(path, engine="zarr")``.

    Parameters
    ----------
    path : Path; the store, whose other groups stay
    groups : mapping of str to Dataset
    """
    zarr.open_group(path, mode="a", attributes=ROOT)
    for name, data in groups.items():
        write = partial(_write_array, path, open_group(path, name, data), data, {})
        map_threads(write, map(str, data.variables))
    with quiet:  # it is no part of zarr 3 yet, and xarray warns without it
        zarr.consolidate_metadata(path)


def _write_array(
    path: Path,
    group: zarr.Group,
    data: xr.Dataset,
    first_arrays: dict[Any, StoredArray],
    key: str,
) -> None:
    """Write the variable ``key`` of a dataset into its group of the store ``path``.

    ``first_arrays`` has the first array of each kind, by dimensions, shape and type: others are
    made like it. Written with the first of each is its name.
    """
    variable = data.variables[key].copy(deep=False)
    folder = path / group.path / key
    # Coordinates that are no axis, which xarray looks for in this attribute.
    others = {*map(str, data.coords)} - {key, *map(str, data.dims)}
    belonging = [name for name in sorted(others) if {*data[name].dims} <= {*variable.dims}]
    if belonging:
        variable.attrs["coordinates"] = " ".join(belonging)
    kind = variable.dims, variable.shape, variable.dtype
    if kind in first_arrays:
        _copy_metadata(path / first_arrays[kind].path, folder, variable.attrs)
    else:
        array = create_array(group, key, variable, variable.shape)
        if not is_ours(array):  # text
            array[...] = variable.values
            return
        first_arrays[kind] = array
    where = tuple(slice(0, n) for n in variable.shape)
    write_chunks(folder, first_arrays[kind], where, variable.values)


def _copy_metadata(source: Path, folder: Path, attrs: Mapping[Any, Any]) -> None:
    """Make an array like another one but for its attributes; zarr takes longer than its chunks."""
    metadata = json.loads((source / _METADATA).read_text(encoding="utf-8"))
    folder.mkdir()
    text = json.dumps(metadata | {"attributes": json_attrs(attrs)}, indent=2)
    write_text(folder / _METADATA, text)


def take_group(path: Path, source: Path, name: str) -> None:
    """Put a group of one store into another with its smaller copies.

    Chunks as links where the disk has these.
    """
    for group in (name, f"{OVERVIEWS}/{name}"):
        if group == name or (source / group).is_dir():
            shutil.copytree(source / group, path / group, copy_function=_link_or_copy)
    if (path / OVERVIEWS).is_dir():
        shutil.copy2(source / OVERVIEWS / _METADATA, path / OVERVIEWS)


def _link_or_copy(source: str, target: str) -> None:
    if Path(source).name != _METADATA:
        with suppress(OSError):  # another disk, or one without links
            os.link(source, target)
            return
    shutil.copy2(source, target)


def open_tree(path: Path, among: Iterable[str] | None = None) -> Mapping[str, xr.Dataset]:
    """Groups of a store by name, of ``among`` only, read when asked for.

    Large ones come with their smaller copies.
    """
    return ReadOnDemand(partial(_group_names, path, among), partial(read_group, path))


def read_tree(path: Path) -> dict[str, xr.Dataset]:
    """Read all groups of a store into memory as far as they are not large.

    They are as :func:`open_tree` gives them.

    Raises
    ------
    FileError
        If there is no store, or it is damaged.
    """
    return dict(open_tree(path))


def _group_names(path: Path, among: Iterable[str] | None) -> list[str]:
    """Names of the groups of a store that hold arrays, checked to be whole.

    Those of ``among`` alone where it is given; otherwise all, behind them the smaller copies of
    large ones. FileError as `read_tree`.
    """
    check_exists(path)
    if not (path / _METADATA).is_file():
        raise FileError(
            f"{path} is no zarr store. Give the maps.zarr of a run, or what a stage's command"
            " wrote."
        )
    with readable(path):
        root = zarr.open_group(path, mode="r")
        if among is not None:
            present = [name for name in among if name in root]
            _check_chunks(path, present)
            return present
        _check_chunks(path, [""])
        names: list[str] = []
        copies: list[str] = []
        for name, node in sorted(root.members(max_depth=None)):
            arrays = []
            if isinstance(node, zarr.Group):
                arrays = [*node.array_values()]
            if not arrays or name.startswith(f"{OVERVIEWS}/"):
                continue
            names.append(name)
            if is_large(arrays):
                copies += overviews_of(path, name)
        return names + copies


def read_group(path: Path, name: str, variables: Iterable[str] | None = None) -> xr.Dataset:
    """Read one group of a store, or some of its variables.

    Parameters
    ----------
    path : Path; the store
    name : str; of the group
    variables : iterable of str, optional; all of them where not given

    Returns
    -------
    Dataset; of half a gigabyte and more, each part is read when it is asked for

    Raises
    ------
    FileError
        If it is damaged.
    """
    with readable(path):
        group = stored_group(path, name)
        selection = group if variables is None else group[list(variables)]
        if is_large(group.data_vars.values()):
            return selection
        return selection.load()


def _check_chunks(path: Path, groups: Iterable[str]) -> None:
    """Raise FileError where a chunk was lost: zarr takes it for missing values."""
    root = zarr.open_group(path, mode="r")
    if not root.attrs.get(COMPLETE):
        return
    for group_name in groups:
        group = zarr.open_group(path, path=group_name, mode="r")
        for name, node in group.members(max_depth=None):
            if isinstance(node, zarr.Array) and node.nchunks_initialized < node.nchunks:
                raise FileError(
                    f"{path} is damaged: {node.nchunks - node.nchunks_initialized} of"
                    f" {node.nchunks} chunks of {name} are not there. Copy it once more, or repeat"
                    " the run."
                )
