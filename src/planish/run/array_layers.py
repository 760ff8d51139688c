"""Layers that are arrays in memory.

They are written beside the run, so that it can be repeated from its ``run.toml``.
"""

import tempfile
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tifffile
import xarray as xr

from planish.core.arrays import check_image, check_volume
from planish.core.errors import FileError
from planish.core.files import writing
from planish.core.frame import Frame
from planish.core.typing import Entries
from planish.io.run_folder import refuse_existing, remove
from planish.io.store import write_store
from planish.run.compute import Compute
from planish.run.run import Run
from planish.run.study import Kind

GivenSource = str | Path | Run | xr.DataArray


@dataclass(frozen=True, slots=True, eq=False)
class ArraySource:
    """A layer in memory, and the path where its file will stand."""

    path: Path
    kind: Kind
    array: xr.DataArray
    size_um: tuple[float, ...]
    name: str | None = None

    @property
    def options(self) -> Entries:
        """What it says of itself: its size, and how the sheet lies or which side is shown."""
        if self.kind == "image":
            return {"pixel_um": self.size_um, "side": self.array.attrs.get("side")}
        frame = Frame.of(self.array)
        return {"voxel_um": self.size_um, "through": frame.through, "top": frame.top}

    def write(self, compute: Compute) -> None:
        """Write it as a working store, or as TIFF in the type that it was made from."""
        with writing(self.path.parent):
            self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.kind == "volume":
            volume = self.array.assign_attrs(voxel_um=list(self.size_um))
            write_store(
                volume, self.path, memory_bytes=compute.block_bytes, threads=compute.threads
            )
            return
        values = self.array.values
        stored_dtype = np.dtype(self.array.attrs.get("stored_dtype", "f4"))
        # Not of a luminance.
        if stored_dtype.kind == "u" and np.array_equal(values, np.rint(values)):
            values = values.astype(stored_dtype)
        with writing(self.path, needed=values.nbytes):
            tifffile.imwrite(self.path, values, photometric="minisblack", metadata=None)


LayerSource = str | Path | ArraySource
_FILE_NAMES = {"volume": ("sheet", ".zarr"), "image": ("image", ".tif")}


def inputs_folder(out: Path) -> Path:
    """Folder of the arrays of a run."""
    return out.with_name(f"{out.name}-inputs")


@contextmanager
def layer_sources(
    layers: Sequence[GivenSource], out: str | Path | None, call_text: str
) -> Generator[list[LayerSource]]:
    """Give each layer its path.

    Arrays get one in ``OUT-inputs``, or in a folder that is removed at the end.

    InputError for what is neither a path, a run with a folder, a volume nor an image; FileError
    where a folder exists.
    """
    sources = [_source(layer, call_text) for layer in layers]
    if not any(isinstance(source, ArraySource) for source in sources):
        yield sources
        return
    if out is None:
        folder = Path(tempfile.mkdtemp(prefix="planish-"))
    else:
        folder = inputs_folder(Path(out))
        refuse_existing(Path(out), folder)
    try:
        yield [*_with_paths(sources, folder)]
    except BaseException:
        # The arrays are in memory still, and the same call is not refused because of them.
        remove(folder)
        raise
    if out is None:
        remove(folder)


def _with_paths(sources: Sequence[LayerSource], folder: Path) -> Iterator[LayerSource]:
    """The layers, those in memory with the files that they will have in a folder."""
    kinds = [source.kind for source in sources if isinstance(source, ArraySource)]
    for k, source in enumerate(sources, 1):
        if not isinstance(source, ArraySource):
            yield source
            continue
        stem, suffix = _FILE_NAMES[source.kind]
        if kinds.count(source.kind) > 1:
            stem = f"{source.kind}{k}"
        yield replace(source, path=folder / f"{stem}{suffix}")


def _source(layer: GivenSource, call_text: str) -> LayerSource:
    if isinstance(layer, Run):
        if layer.folder is None:
            raise FileError(
                "The run stands in no folder. Give out= to the call that made it, and link it then."
            )
        return layer.folder
    if isinstance(layer, str | Path):
        return layer
    if len(getattr(layer, "shape", ())) == 2:
        return ArraySource(Path(), "image", layer, check_image(layer, call_text))
    return ArraySource(Path(), "volume", layer, check_volume(layer, call_text))
