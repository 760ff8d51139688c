"""What NeXus says about an HDF5 file: the volume that is meant, the order of its axes, and their steps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py  # pyright: ignore[reportMissingTypeStubs]
import numpy as np

from planish.core.errors import VolumeError
from planish.io.hdf5_links import is_hard, link_of
from planish.io.sizes import Stated, unit_um

LONGEST_AXIS = 10_000_000
EVEN = 0.01
"""Share by which the steps of an axis may differ."""


def default_dataset(file: h5py.File, path: Path) -> str | None:
    """Follow ``default`` and ``signal`` from the root; None where the file is no NeXus file."""
    entry = chosen(file, "NXentry")
    if entry is None:
        return None
    definition = text(entry["definition"][()]) if isinstance(child(entry, "definition"), h5py.Dataset) else ""
    if definition == "NXtomo":
        raise VolumeError(
            f"{path.name} holds raw projections (NXtomo). Give the reconstructed volume, a file with NXtomoproc."
        )
    data = chosen(entry, "NXdata")
    if data is None:
        return None
    signal = text(data.attrs["signal"]) if "signal" in data.attrs else None
    if signal is None:
        named = [key for key in data if isinstance(child(data, key), h5py.Dataset) and "signal" in data[key].attrs]
        signal = named[0] if named else "data" if link_of(data, "data") else None
    return None if signal is None or link_of(data, signal) is None else f"{data.name}/{signal}"


def chosen(group: Any, kind: str) -> Any:
    """Group of a class that ``default`` names, or the only one there is."""
    name = text(group.attrs["default"]) if "default" in group.attrs else ""
    named = child(group, name) if name else None
    if is_class(named, kind):
        return named
    of_class = [item for item in (child(group, key) for key in group) if is_class(item, kind)]
    return of_class[0] if len(of_class) == 1 else None


def is_class(item: Any, kind: str) -> bool:
    """Whether something is a group of a NeXus class."""
    return isinstance(item, h5py.Group) and "NX_class" in item.attrs and text(item.attrs["NX_class"]) == kind


def child(group: Any, name: str) -> Any:
    """Member of a group that is no link; None where there is none."""
    return group[name] if is_hard(group, name) else None


def axis_order(dataset: Any, long: Sequence[int]) -> tuple[int, ...]:
    """Axes of a data set that are z, y and x: as NeXus names them, otherwise as they stand."""
    names = axis_names(dataset)
    letters = [names[axis][:1].casefold() if axis < len(names) else "" for axis in long]
    if sorted(letters) == ["x", "y", "z"]:
        return tuple(long[letters.index(letter)] for letter in "zyx")
    return tuple(long)


def axis_names(dataset: Any) -> list[str]:
    """Names of the axes that the group or the data set gives, one for each."""
    for owner in (dataset.parent, dataset):
        if "axes" in owner.attrs:
            value = np.atleast_1d(np.asarray(owner.attrs["axes"]))
            names = [text(v) for v in value.ravel()]
            if len(names) == 1:
                names = names[0].strip("[]").replace(",", ":").split(":")
            if len(names) == len(dataset.shape):
                return [name.strip() for name in names]
    return []


def stated_by_nexus(dataset: Any, order: Sequence[int]) -> list[Stated]:
    """Voxel size from the values along the axes, which have to be evenly spaced."""
    names = axis_names(dataset)
    sizes: list[float | None] = []
    notes: list[str] = []
    for axis in order:
        values: Any = child(dataset.parent, names[axis]) if axis < len(names) else None
        sizes.append(None)
        if not is_scale(values, dataset.shape[axis]):
            continue
        unit = text(values.attrs["units"]) if "units" in values.attrs else ""
        length = unit_um(unit)
        steps = np.abs(np.diff(np.asarray(values[()], np.float64)))
        step = float(np.median(steps))
        if not np.isfinite(steps).all() or step <= 0 or np.any(np.abs(steps - step) > EVEN * step):
            notes.append(f"{names[axis]} is not evenly spaced")
        elif length is None:
            notes.append(f"{names[axis]} has the unit {unit!r}, which is no unit of length")
        else:
            sizes[-1] = step * length
    if not names or (not notes and sizes == [None] * 3):
        return []
    return [Stated(source="the NeXus axes", um=tuple(sizes), note=", ".join(notes))]


def is_scale(item: Any, length: int) -> bool:
    """Whether something holds one number for each place along an axis."""
    return (
        isinstance(item, h5py.Dataset)
        and item.shape == (length,)
        and length <= LONGEST_AXIS
        and item.dtype.kind in "uif"
        and not item.is_virtual
        and not item.external
    )


def text(value: Any) -> str:
    """Read a word that may be stored as bytes, or as an array of one."""
    one = np.asarray(value).ravel()[:1]
    found: Any = one[0] if one.size else ""
    return found.decode("utf-8", errors="replace") if isinstance(found, bytes) else str(found)
