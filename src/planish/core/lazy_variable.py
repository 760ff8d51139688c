"""A lazy array as xarray holds one: indexed step by step, read at the end."""

from typing import Any

from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core.indexing import IndexingSupport, LazilyIndexedArray, explicit_indexing_adapter

from planish.core.lazy import LazyArray


class _Backend(BackendArray):
    def __init__(self, values: LazyArray) -> None:
        self.values, self.shape, self.dtype = values, values.shape, values.dtype

    def __getitem__(self, key: Any) -> NDArray[Any]:
        return explicit_indexing_adapter(key, self.shape, IndexingSupport.BASIC, self.values.__getitem__)


def variable_data_of(values: LazyArray) -> Any:
    """Wrap a lazy array for a variable."""
    return LazilyIndexedArray(_Backend(values))
