"""A volume that travels to other processes as the name of its file."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core.indexing import ExplicitIndexer, IndexingSupport, LazilyIndexedArray, explicit_indexing_adapter

from planish.io import read_volume


class FileVolume(BackendArray):
    """A volume that travels to other processes as the name of its file; each of them opens it once.

    Parameters
    ----------
    path : str
    how : tuple of (str, value)
        Arguments of :func:`planish.io.read_volume`.
    shape : (int, int, int)
    dtype : dtype
    """

    def __init__(
        self, path: str, how: tuple[tuple[str, Any], ...], shape: tuple[int, ...], dtype: np.dtype[Any]
    ) -> None:
        self.path, self.how, self.shape, self.dtype = path, how, shape, dtype

    def __getitem__(self, key: ExplicitIndexer) -> Any:
        """Read a part."""
        return explicit_indexing_adapter(key, self.shape, IndexingSupport.BASIC, self._read)

    def _read(self, key: tuple[Any, ...]) -> NDArray[Any]:
        return opened(self.path, self.how).variable[key].values


@lru_cache(maxsize=1)
def opened(path: str, how: tuple[tuple[str, Any], ...]) -> xr.DataArray:
    """Open a volume, or give the one that is open already."""
    return read_volume(path, **dict(how))


def by_name(volume: xr.DataArray, path: str, how: dict[str, Any]) -> xr.DataArray:
    """Return the same volume, held by the name of its file."""
    held = FileVolume(path, tuple(how.items()), volume.shape, volume.dtype)
    variable = xr.Variable(volume.dims, LazilyIndexedArray(held), volume.attrs)
    named = xr.DataArray(variable, coords=volume.coords, name=volume.name)
    named.encoding.update(volume.encoding)
    return named
