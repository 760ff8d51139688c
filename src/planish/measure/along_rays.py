"""Every property along the rays of the centre surface: row tiles on threads, the same bytes however they are cut."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from planish.core.errors import CannotMeasure, ResourceError
from planish.core.status import FIRST_OWN, Status, status_flags
from planish.core.threads import count_threads, map_threads
from planish.core.tiles import Engine
from planish.measure.greys import Greys
from planish.measure.params import MeasureParams
from planish.measure.ray_frame import RayFrame
from planish.measure.rays import Rays
from planish.measure.registry import Measured, Property, Sheet, in_order, length_of
from planish.measure.uncertainty import ray_noise

T = TypeVar("T")

_PER_SAMPLE = 24  # bytes that a sample costs at most while a tile is worked on


def measure_along_rays(
    volume: xr.DataArray, surfaces: xr.Dataset, *, names: Sequence[str | Property],
    params: MeasureParams | None = None, rows_per_tile: int | None = None, engine: Engine | None = None,
) -> xr.Dataset:  # fmt: skip
    """Measure properties along the normals of the centre surface, or along vertical rays.

    Parameters
    ----------
    volume : DataArray, dims (z, y, x), coordinates in um
        May be lazily indexed; it is read in boxes of some rows.
    surfaces : Dataset, dims (y, x), heights in um
        As :func:`planish.surface.find_surfaces` returns them for this volume.
    names : sequence of str or Property
        What :func:`planish.measure.registered` lists, or what the decorators return.
    params : MeasureParams
    rows_per_tile : int
        Rows worked on together; what fits into half of the engine's memory where not given.
    engine : Engine
        Threads and memory; no result depends on it.

    Returns
    -------
    Dataset, dims (y, x), float32
        Each property with ``units``, ``long_name`` and ``support_um`` (the width that one value speaks for), and
        ``<name>_se``, its standard error in the same unit: NaN where none can be stated. ``status``: 0 measured, and
        the reasons in ``flag_meanings``. A property with reasons of its own has ``<name>_status`` beside it.
        Attributes hold the densities that were used.

    Raises
    ------
    CannotMeasure
        If a property is unknown, or a density or grey level that it needs was not given.
    SurfaceError, SizeError, ResourceError
    """
    params = params or MeasureParams()
    greys = Greys.of(surfaces)
    wanted = in_order(names, params, greys)
    if not wanted:
        raise CannotMeasure("No property was named. Name one or more.")
    asked = {name if isinstance(name, str) else name.name for name in names}
    frame = ray_frame(volume, surfaces, params)
    of_rays = [prop for prop in wanted if prop.kind == "rays"]
    maps = {prop.name: _blank(frame.status.shape) for prop in of_rays}
    status = frame.status.copy()

    def work(tile: Rays, inner: slice, rows: slice) -> None:
        status[rows] = tile.status[inner]
        grouped: dict[int, tuple[Rays, slice]] = {}
        for prop in of_rays:
            halo = _halo(prop, frame)
            if halo not in grouped:
                lo, hi = max(inner.start - halo, 0), min(inner.stop + halo, tile.status.shape[0])
                whole = (lo, hi) == (0, tile.status.shape[0])
                part = tile if whole else tile.rows(slice(lo, hi))
                grouped[halo] = part, slice(inner.start - lo, inner.stop - lo)
            part, tile_rows = grouped[halo]
            answer = _measured(prop, part)
            for name in ("values", "se", "reason"):
                getattr(maps[prop.name], name)[rows] = getattr(answer, name)[tile_rows]

    if of_rays:
        most = max(_halo(prop, frame) for prop in of_rays)
        each_tile(volume, frame, work, halo=most, rows=rows_per_tile, engine=engine)
    sheet = Sheet(frame=replace(frame, status=status), maps=maps)
    for prop in wanted:
        if prop.kind == "sheet":
            maps[prop.name] = _measured(prop, sheet)
    return _dataset([prop for prop in wanted if prop.name in asked], maps, status, surfaces, frame)


def ray_frame(volume: xr.DataArray, surfaces: xr.Dataset, params: MeasureParams | None) -> RayFrame:
    """Find where the rays lie and how much noise their integrals have."""
    frame = RayFrame.of(volume, surfaces, params or MeasureParams())
    return replace(frame, noise_um=ray_noise(volume, frame))


def each_tile(
    volume: xr.DataArray, frame: RayFrame, work: Callable[[Rays, slice, slice], T], *, halo: int = 0,
    rows: int | None = None, engine: Engine | None,
) -> list[T]:  # fmt: skip
    """Straighten the sheet tile by tile and call ``work`` on threads; return what it gave, in the order of the rows.

    ``work`` is called with the rays of a tile and of ``halo`` rows on both sides, the tile's rows within them, and its
    rows in the sheet. ResourceError if a single row with its halo does not fit into the memory.
    """
    engine = engine or Engine()
    count = frame.status.shape[0]
    threads = count_threads(engine.threads)
    per_row = frame.status.shape[1] * frame.samples * _PER_SAMPLE
    if rows is None:
        rows = int(engine.memory_bytes / 2 / threads / per_row) - 2 * halo
        if rows < 1:
            raise ResourceError(
                f"One row of rays with its neighbourhood takes {(2 * halo + 1) * per_row * threads / 2**20:.0f} MiB on "
                f"{threads} threads, and {engine.memory_bytes / 2**21:.0f} MiB were allowed. Allow more, or fewer "
                "threads."
            )
        # Tiles of even size, several for each thread; a halo costs less the larger they are.
        rows = max(min(rows, max(-(-count // (4 * threads)), 2 * halo)), 1)
    tiles = [slice(start, min(start + rows, count)) for start in range(0, count, rows)]

    def run_tile(rows_of_tile: slice) -> T:
        lo, hi = max(rows_of_tile.start - halo, 0), min(rows_of_tile.stop + halo, count)
        tile = frame.tile(volume, slice(lo, hi))
        return work(tile, slice(rows_of_tile.start - lo, rows_of_tile.stop - lo), rows_of_tile)

    return map_threads(run_tile, tiles, number=threads)


def _halo(prop: Property, frame: RayFrame) -> int:
    length = length_of(prop.halo_um, frame.params)
    return int(np.ceil(length / frame.pitch_um[0])) + 1 if length > 0 else 0


def _measured(prop: Property, subject: Rays | Sheet) -> Measured:
    """Answer of a property with all three arrays."""
    answer = prop.function(subject)
    if not isinstance(answer, Measured):
        answer = Measured(values=np.asarray(answer))
    shape = subject.status.shape if isinstance(subject, Rays) else subject.frame.status.shape
    if answer.values.shape != shape:
        raise CannotMeasure(
            f"The property '{prop.name}' returned the shape {answer.values.shape} for {shape[0]} x {shape[1]} rays. "
            "Return one value for each ray: (rows, cols)."
        )
    se, reason = (np.broadcast_to(part, shape) for part in (answer.se, answer.reason))
    return Measured(values=answer.values, se=se, reason=reason)


def _blank(shape: tuple[int, ...]) -> Measured:
    values, se = (np.full(shape, np.nan, dtype=np.float32) for _ in range(2))
    return Measured(values=values, se=se, reason=np.zeros(shape, dtype=np.uint8))  # type: ignore[arg-type]


def _dataset(
    properties: list[Property], maps: dict[str, Measured], status: NDArray[np.uint8], surfaces: xr.Dataset,
    frame: RayFrame,
) -> xr.Dataset:  # fmt: skip
    valid = status == 0
    variables: dict[str, tuple[tuple[str, str], NDArray[np.generic], dict[str, object]]] = {}
    ray = max(*frame.pitch_um, float(np.sqrt(8 * np.log(2.0))) * frame.greys.blur_um)
    for prop in properties:
        answer = maps[prop.name]
        support = ray if prop.support_um is None else max(length_of(prop.support_um, frame.params), ray)
        masked = np.where(valid, answer.values, np.nan).astype(np.float32)
        se = np.where(np.isfinite(masked), answer.se, np.nan).astype(np.float32)
        title = f"Standard error of {prop.long_name[0].lower()}{prop.long_name[1:]}"
        attrs: dict[str, object] = {"units": prop.units, "long_name": prop.long_name, "support_um": round(support, 3)}
        variables[prop.name] = (("y", "x"), masked, attrs)
        variables[f"{prop.name}_se"] = (("y", "x"), se, {"units": prop.units, "long_name": title})
        if prop.reasons:
            own_status = np.where(valid & (answer.reason > 0), answer.reason + np.uint8(FIRST_OWN - 1), status)
            flags = status_flags(f"Status of {prop.long_name}", last=Status.RAY_LEAVES_VOLUME, reasons=prop.reasons)
            variables[f"{prop.name}_status"] = (("y", "x"), own_status, flags)
    variables["status"] = (("y", "x"), status, status_flags(last=Status.RAY_LEAVES_VOLUME))
    used = {"rays": frame.params.rays, "ray_step_um": frame.step_um, "ray_noise_um": frame.noise_um}
    return xr.Dataset(variables, coords=surfaces.coords, attrs=dict(surfaces.attrs) | used | frame.params.known())
