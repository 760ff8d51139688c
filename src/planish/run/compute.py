"""How a run is worked on.

That is memory, threads, a cluster, and what is kept so that a killed run goes on.

No result depends on it, except that columns get wider where the memory would not hold the maps,
which the results say.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import math
import re
from collections.abc import Callable, Generator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator

from planish import __version__
from planish.core.errors import InputError, ResourceError
from planish.core.frame import Frame
from planish.core.memory import (
    HELD_TIMES,
    MAPS_SHARE,
    PROGRAM_BYTES,
    RETURNED_BYTES,
    bytes_to_map,
    enough_gb,
)
from planish.core.options import Params, option
from planish.core.source_hash import hash_sources
from planish.core.tiles import Engine
from planish.core.typing import Entries

if TYPE_CHECKING:
    import xarray as xr

Progress = Callable[[str, str], None]
"""How a run reports what it does: called with the name of a stage and a few words."""


def silent(_stage: str, _detail: str) -> None:
    """Report nothing.

    Parameters
    ----------
    _stage, _detail : str
        Name of a stage, and a few words.
    """


# a column wider than this would be coarser than the maps that are compared with images.
_WIDEST_UM = 12.0
_UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}


def _bytes_of(text: Any) -> Any:
    """Bytes of an amount such as 4GB; what is no text is left to the model."""
    if not isinstance(text, str):
        return text
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([A-Za-z]*)\s*", text)
    unit = _UNITS.get(match[2].upper().replace("IB", "B")) if match else None
    amount = int(float(match[1]) * unit) if match and unit else 0
    if amount < 2**20:
        raise ValueError("write an amount of memory such as 4GB or 500MB")
    return amount


class Compute(Params):
    """What a run may use; no result depends on it."""

    memory_bytes: Annotated[int, BeforeValidator(_bytes_of)] | None = option(
        None,
        cli="--memory",
        metavar="SIZE",
        help="Most memory to use, such as 4GB; default: half of what is free.",
    )
    threads: int | None = option(
        None,
        ge=1,
        metavar="N",
        help="Local threads; default: one per processor that planish may use, eight at most.",
    )
    scheduler: str | None = option(
        None, metavar="tcp://HOST:PORT", help="Work on a dask cluster instead of local threads."
    )

    @property
    def volume_bytes(self) -> int:
        """Largest volume that is held in memory as a whole."""
        return self.for_work // HELD_TIMES

    @property
    def block_bytes(self) -> int:
        """What an import may take for the blocks that it writes: of little memory most."""
        return max(self.volume_bytes, min(self.for_work * 2 // 3, 2 * 10**8))

    @property
    def for_work(self) -> int:
        """What the program and its libraries leave of the memory, in bytes."""
        return self.memory - min(PROGRAM_BYTES, self.memory // 2)

    @property
    def memory(self) -> int:
        """Most memory, in bytes."""
        from planish.io.guard import default_memory_limit

        if self.memory_bytes is not None:
            return self.memory_bytes
        return int(default_memory_limit() * 2 / 3)


def column_step(
    volume: xr.DataArray, frame: Frame, column_um: float | None, compute: Compute
) -> int:
    """Give the width of the measured columns in voxels.

    The columns are as wide as ``column_um``, or single voxels, or as wide as the memory demands.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x)
    frame : Frame
        Which axes run across the sheet.
    column_um : float, optional
        Width of a column.
    compute : Compute
        Gives the memory.

    Returns
    -------
    int

    Raises
    ------
    InputError
        If ``column_um`` is less than a voxel.
    ResourceError
        If the memory does not hold the maps even with wide columns.
    """
    sides_um = map(float, volume.attrs["voxel_um"])
    voxel_um = dict(zip("zyx", sides_um, strict=True))
    pitch = (voxel_um[frame.rows] * voxel_um[frame.cols]) ** 0.5
    if column_um is not None:
        if column_um < 0.999 * pitch:
            raise InputError(
                f"`column_um={column_um:g}` is less than a voxel of {pitch:g} um. Give a multiple"
                " of it."
            )
        return max(1, round(column_um / pitch))
    columns = volume.sizes[frame.rows] * volume.sizes[frame.cols]
    times_too_many = bytes_to_map(columns) / compute.for_work
    step = max(1, math.ceil(times_too_many**0.5))
    if step > 1 and step * pitch > _WIDEST_UM:
        widest_step = max(int(_WIDEST_UM / pitch), 1)
        needed = bytes_to_map(columns / widest_step**2) + PROGRAM_BYTES
        columns_text = f"{columns:_}".replace("_", " ")
        raise ResourceError(
            f"The maps of {columns_text} columns need {enough_gb(needed)} GB of memory even"
            f" with columns of {_WIDEST_UM:g} um; {compute.memory / 1e9:.1f} GB are allowed."
            " Give more with `memory`, or crop the volume."
        )
    return step


def return_memory(compute: Compute) -> None:
    """Have glibc give freed arrays back at once where the memory is short.

    By itself it keeps ever larger ones.
    """
    least = next((size for memory, size in RETURNED_BYTES if compute.memory < memory), None)
    if least is not None:
        with suppress(OSError, AttributeError, TypeError):  # another C library
            ctypes.CDLL(None).mallopt(-3, least)  # M_MMAP_THRESHOLD of malloc.h


@contextmanager
def engine(compute: Compute, *, tiles: Path | None = None) -> Generator[Engine]:
    """Give the engine that works on tiles.

    Parameters
    ----------
    compute : Compute
        Threads of this computer, or a scheduler.
    tiles : path, optional
        Folder for tiles that are done.

    Yields
    ------
    Engine

    Raises
    ------
    InputError
        Without scheduler or library.
    ResourceError
        If the scheduler is lost.
    """
    memory = int((1 - MAPS_SHARE) * compute.for_work)
    if compute.scheduler is None:
        yield Engine(threads=compute.threads, memory_bytes=memory, folder=tiles)
        return
    try:
        from distributed import Client, KilledWorker
        from distributed.comm.core import CommClosedError
    except ImportError as error:
        raise InputError(
            "`scheduler` needs the library distributed, which is not installed. Run: pip install"
            ' "planish[cluster]"'
        ) from error
    try:
        opened: Any = Client(compute.scheduler, timeout="10s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"No scheduler answers at {compute.scheduler}: {error}. Start one with 'dask scheduler'"
            " and give the address that it prints."
        ) from error
    with opened as client:
        with suppress(TimeoutError):  # those that were just started need a moment
            client.wait_for_workers(1, timeout=20)
        workers = sum(client.ncores().values())
        if not workers:
            raise InputError(
                f"The scheduler {compute.scheduler} has no workers. Start some with 'dask worker'."
            )
        try:
            yield Engine(
                executor=client.get_executor(pure=False),
                workers=workers,
                memory_bytes=memory,
                folder=tiles,
            )
        except (CancelledError, CommClosedError, KilledWorker) as error:
            raise ResourceError(
                f"The scheduler {compute.scheduler} was lost, or its workers died again and again"
                " at one part of the work. See what it says, give its workers more memory if they"
                " ran out of it, and give the same command again: it goes on where it stood."
            ) from error


def run_key(study: Entries, fingerprints: list[str]) -> str:
    """Identify a run whose tiles may be used again.

    The study, the bytes of its inputs and the program's code tell it.
    """
    text = json.dumps([__version__, hash_sources(), study, fingerprints], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
