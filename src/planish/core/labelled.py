"""Arrays with coordinates in um, which are read part by part where they are lazy."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.core.indexing import IndexingSupport, LazilyIndexedArray, explicit_indexing_adapter

from planish.core.lazy import LazyArray, Where
from planish.core.typing import Array, Entries, Fields, Shape


def labelled(
    values: Array | LazyArray,
    dims: Sequence[str],
    size_um: Sequence[float],
    *,
    name: str,
    attrs: Fields,
) -> xr.DataArray:
    """Give an array coordinates in um: place i of an axis has its centre at i × size.

    A :class:`LazyArray` stays one: ``isel`` moves borders, ``values`` reads; ``encoding`` says how
    it is best read.
    """
    coords: Entries = {}
    for axis, n, um in zip(dims, values.shape, size_um, strict=True):
        coords[axis] = axis, np.arange(n) * um, {"units": "um"}
    variable = xr.Variable(tuple(dims), variable_data(values))
    array = xr.DataArray(variable, coords=coords, name=name, attrs=attrs)
    if isinstance(values, LazyArray):
        array.encoding.update(chunks=values.chunks, whole_slices=values.whole_slices)
    return array


def chunks_of(volume: xr.DataArray) -> Shape:
    """Voxels along z, y and x that are decoded together; 1 where the file is not chunked."""
    return volume.encoding.get("chunks") or (1, 1, 1)


def computed(like: xr.DataArray, read: Callable[[Where], Array], dtype: Any = None) -> xr.DataArray:
    """Give the same array with other values, of which ``read`` gives the part that is asked for."""
    values = LazyArray(like.shape, np.dtype(dtype or like.dtype), read)
    variable = xr.Variable(like.dims, variable_data(values), like.attrs)
    array = xr.DataArray(variable, coords=like.coords, name=like.name)
    array.encoding.update(like.encoding)
    return array


def read_box(volume: xr.DataArray, box: Mapping[str, slice]) -> Array:
    """Read a part of a volume, with its axes in the order of ``box``."""
    box_array = volume.isel(box)
    # Turned only after it was read: what is read lazily may not know how to turn.
    return box_array.values.transpose([box_array.get_axis_num(axis) for axis in box])


class _Backend(BackendArray):
    def __init__(self, values: LazyArray) -> None:
        self.values = values
        self.shape = values.shape
        self.dtype = values.dtype

    def __getitem__(self, key: Any) -> Array:
        return explicit_indexing_adapter(
            key, self.shape, IndexingSupport.BASIC, self.values.__getitem__
        )


def variable_data(values: Array | LazyArray) -> Any:
    """Wrap values for a variable: an array, or a lazy one that stays one."""
    if isinstance(values, LazyArray):
        return LazilyIndexedArray(_Backend(values))
    return values
