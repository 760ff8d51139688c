"""How xarray holds a :class:`planish.core.lazy.LazyArray`; apart, so that xarray is imported only where it is used."""

from __future__ import annotations

from typing import Any

from xarray.backends import BackendArray
from xarray.core.indexing import ExplicitIndexer, IndexingSupport, explicit_indexing_adapter

from planish.core.lazy import LazyArray


class Backend(BackendArray):
    """A lazy array, as xarray indexes it."""

    def __init__(self, inner: LazyArray) -> None:
        self.inner, self.shape, self.dtype = inner, inner.shape, inner.dtype

    def __getitem__(self, key: ExplicitIndexer) -> Any:
        """Read a part."""
        return explicit_indexing_adapter(key, self.shape, IndexingSupport.BASIC, self.inner.__getitem__)
