"""Layers that are arrays in memory: written beside the run, so that it can be repeated from its ``run.toml``."""

from __future__ import annotations

import tempfile
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tifffile
import xarray as xr

from planish.compute import Compute
from planish.core.arrays import check_image, check_volume
from planish.core.errors import FileError
from planish.core.files import writing
from planish.core.frame import Frame
from planish.io.run_folder import refuse_existing, remove
from planish.io.store import write_store
from planish.pipeline.run import Run

ArrayKind = Literal["volume", "image"]

INPUTS = "inputs"
"""``OUT-inputs``: folder of the arrays that the run OUT was made of."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArrayLayer:
    """A layer in memory, and where its file will stand."""

    array: xr.DataArray
    kind: ArrayKind
    path: Path

    def options(self) -> dict[str, Any]:
        """What it says of itself: its size, and how the sheet lies or which side is shown."""
        if self.kind == "image":
            pixel = check_image(self.array, "pl.link({})")
            side = self.array.attrs.get("side")
            return {"pixel_um": pixel} | ({} if side is None else {"side": side})
        frame = Frame.of(self.array)
        size = check_volume(self.array, "pl.link({})")
        return {"voxel_um": size, "through": frame.through, "top": frame.top}

    def write(self, compute: Compute) -> None:
        """Write it as a working store, or as TIFF in the type that it was made from."""
        if self.kind == "volume":
            size = list(check_volume(self.array, "pl.link({})"))
            write_store(
                self.array.assign_attrs(voxel_um=size), self.path, memory_bytes=compute.block_bytes,
                threads=compute.threads,
            )  # fmt: skip
            return
        down, across = check_image(self.array, "pl.link({})")
        values, stored = self.array.values, np.dtype(self.array.attrs.get("stored_dtype", "f4"))
        if stored.kind == "u" and np.array_equal(values, np.rint(values)):  # not of a luminance
            values = values.astype(stored)
        with writing(self.path, needed=values.nbytes):
            tifffile.imwrite(
                self.path, values, photometric="minisblack", resolution=(1e4 / across, 1e4 / down),
                resolutionunit="CENTIMETER", metadata=None,
            )  # fmt: skip


Given = str | Path | Run | xr.DataArray
Source = str | Path | ArrayLayer


@contextmanager
def layer_sources(layers: Sequence[Given], out: str | Path | None, call: str) -> Generator[list[Source]]:
    """Give each layer its path; arrays get one in ``OUT-inputs``, or in a folder that is removed at the end.

    Raises
    ------
    InputError
        If a layer is neither a path, a run with a folder, a volume nor an image.
    FileError
        If ``OUT`` or ``OUT-inputs`` exists.
    """
    kinds: list[ArrayKind | None] = [_kind_of(layer, call) for layer in layers]
    if not any(kinds):
        yield [_path_of(layer) for layer in layers]
        return
    if out is not None:
        refuse_existing(Path(out))
    folder = (
        Path(tempfile.mkdtemp(prefix="planish-")) if out is None else Path(out).with_name(f"{Path(out).name}-{INPUTS}")
    )
    if out is not None and folder.exists():
        raise FileError(
            f"{folder} is there already, with the arrays of an earlier call. Give the files in it instead of the "
            "arrays, remove it, or give another name with --out."
        )
    try:
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        sources: list[Source] = []
        for number, (layer, kind) in enumerate(zip(layers, kinds, strict=True), 1):
            if kind is None:
                sources.append(_path_of(layer))
                continue
            assert isinstance(layer, xr.DataArray)
            usual = "sheet" if kind == "volume" else "image"
            stem = usual if kinds.count(kind) == 1 else f"{usual}{number}"
            path = folder / f"{stem}{'.zarr' if kind == 'volume' else '.tif'}"
            sources.append(ArrayLayer(array=layer, kind=kind, path=path))
        yield sources
    except BaseException:
        # The maps of a link that was refused at the marks are kept, and its next call needs the files.
        if out is not None and not any(folder.parent.glob(f"{Path(out).name}-*/run.toml")):
            remove(folder)
        raise
    finally:
        if out is None:
            remove(folder)


def _kind_of(layer: Given, call: str) -> ArrayKind | None:
    """Which kind of array a layer is; None where it is a path or a run."""
    if isinstance(layer, str | Path | Run):
        return None
    kind: ArrayKind = "image" if len(getattr(layer, "shape", ())) == 2 else "volume"
    (check_image if kind == "image" else check_volume)(layer, call)
    return kind


def _path_of(layer: Given) -> str | Path:
    if not isinstance(layer, Run):
        assert not isinstance(layer, xr.DataArray)
        return layer
    if layer.folder is None:
        raise FileError("The run stands in no folder. Give out= to the call that made it, and link it then.")
    return layer.folder
