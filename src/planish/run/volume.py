"""The volume of a run, whatever it was stored as."""

from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from planish.core.errors import InputError, ResourceError, VolumeError
from planish.core.frame import Frame
from planish.core.labelled import computed
from planish.core.lazy import Where
from planish.core.memory import COPIES_OF_SECTIONS, PROGRAM_BYTES, bytes_to_hold, enough_gb
from planish.core.typing import Array, Entries
from planish.io import find_place, read_volume
from planish.io.params import VolumeParams
from planish.io.sections import is_section_folder, read_section_stack
from planish.run.compute import Compute, Progress

Options = tuple[tuple[str, Any], ...]
"""Options of a reader and their names, as a cache can hold them."""


def read_sheet_volume(
    params: VolumeParams, compute: Compute, progress: Progress
) -> tuple[xr.DataArray, xr.Dataset | None]:
    """Read a volume.

    Serial sections are aligned and joined, and come with what was done to each of them.
    """
    path = find_place(params.path).path
    if is_section_folder(path):
        volume, sections = _join_sections(params, compute, progress)
        _in_parts(volume, path, compute, COPIES_OF_SECTIONS, f" --through {params.through}")
        return volume, sections
    if params.fixed_rows is not None or params.fixed_cols is not None:
        raise InputError(
            f"`fixed_rows` and `fixed_cols` are for serial sections; {path.name} is a volume."
        )
    volume = _read(params, compute)
    _in_parts(volume, path, compute)
    return volume, None


def _read(params: VolumeParams, compute: Compute) -> xr.DataArray:
    """Read a volume that is not of sections, for local threads or the processes of a cluster."""
    read_options: Entries = params.how | {"memory_bytes": compute.volume_bytes}
    volume = read_volume(params.path, **read_options)
    if compute.scheduler is None:
        return volume
    # It travels to other processes as the name of its file; each of them opens it once.
    read_window = partial(_read_by_name, params.path, tuple(read_options.items()))
    return computed(volume, read_window)


def _read_by_name(path: str, read_options: Options, window: Where) -> Array:
    """Values of a window of a volume, in another process."""
    return _opened(path, read_options).variable[window].values


@lru_cache(maxsize=1)
def _opened(path: str, read_options: Options) -> xr.DataArray:
    """The volume that was asked for last."""
    return read_volume(path, **dict(read_options))


def read_whole(params: VolumeParams, compute: Compute, progress: Progress) -> xr.DataArray:
    """Read a volume, or join serial sections to one, of any size.

    What does not fit into memory is worked out in parts.

    Parameters
    ----------
    params : VolumeParams
    compute : Compute
        Gives the memory.
    progress : callable
        Called with the name of a stage and a few words.

    Returns
    -------
    DataArray, dims (z, y, x), in um
        What was done to sections is in its attributes, in short.
    """
    if not is_section_folder(params.path):
        return _read(params, compute)
    volume, sections = _join_sections(params, compute, progress)
    from planish.run.facts import section_facts

    return volume.assign_attrs(sections=section_facts(sections).model_dump())


def _in_parts(
    volume: xr.DataArray, path: Path, compute: Compute, copies: int = 1, options: str = ""
) -> None:
    """Refuse a volume that can be decoded in whole slices only, and does not fit into the memory.

    So many ``copies`` of it are held at a time; ``options`` are those of an import of it.
    """
    if volume.encoding.get("whole_slices"):
        needed = enough_gb(bytes_to_hold(copies * volume.nbytes) + PROGRAM_BYTES)
        raise ResourceError(
            f"{path.name} has {volume.nbytes / 1e9:.1f} GB, and its slices can only be decoded"
            f" whole. To hold it, give `memory={needed}GB` ({compute.memory / 1e9:.1f} GB are"
            f" allowed), or bring it into a store first: planish import {path.name}{options} --out"
            f" {path.stem}.zarr"
        )


def _join_sections(
    params: VolumeParams, compute: Compute, progress: Progress
) -> tuple[xr.DataArray, xr.Dataset]:
    """Align serial sections and join them to a volume.

    Return it with what was done to each of them: a dataset over the dim ``section``, with what
    holds for all of them in its attributes.
    """
    path = Path(params.path)
    if compute.scheduler is not None:
        raise InputError(
            f"{path.name} holds sections, which one computer joins. Leave out `scheduler`."
        )
    if params.through == "z":
        raise VolumeError(
            f"{path.name} holds sections, which show the sheet edge on: its normal cannot run from"
            " section to section. Give `through=y` where it runs along the rows of the"
            " photographs, x where along their columns."
        )
    stack = read_section_stack(
        path, **params.how, memory_bytes=compute.volume_bytes // COPIES_OF_SECTIONS
    )
    progress("align", f"{stack.values.shape[0]} sections")
    from planish.sections import (
        SectionSeries,
        align_sections,
        fixed_places,
        normalise_sections,
        regular_volume,
    )

    series = SectionSeries(stack.values, stack.positions_um, stack.pixel_um)
    fixed_features = None
    rows, cols = params.fixed_rows, params.fixed_cols
    if rows is not None or cols is not None:
        fixed_features = fixed_places(stack.values, stack.pixel_um, rows=rows, cols=cols)
    poses = align_sections(series, fixed=fixed_features)
    gains = normalise_sections(series)
    volume = regular_volume(series, alignment=poses, gains=gains, attrs=stack.attrs)
    first_um = float(volume.attrs["first_position_um"])
    shift_row_um, shift_col_um = poses.shift_um.T
    section_columns = {
        "position": (stack.positions_um - first_um, "Place along the volume", "um"),
        "shift_row": (shift_row_um, "Shift taken off, rows", "um"),
        "shift_col": (shift_col_um, "Shift taken off, columns", "um"),
        "rotation": (poses.rotation_rad, "Rotation taken off", "rad"),
        "aligned": (poses.aligned, "Aligned; others count as missing", None),
        "gain": (gains.gain, "Gain put on the grey", "1"),
    }
    variables: Entries = {}
    for name, (values, title, units) in section_columns.items():
        column_attrs = {} if units is None else {"units": units}
        column_attrs["long_name"] = title
        variables[name] = ("section", values, column_attrs)
    fixed = zip(("row", "col", "rotation"), poses.fixed, strict=True)
    attrs = {
        "kind": stack.kind,
        "first_position_um": first_um,
        "cutoff_um": poses.cutoff_um,
        "missing": int(volume.attrs["sections_missing"]),
        "jitter_left_um": [*map(float, poses.jitter_left_um)],
        "jitter_estimator": "median section",
        "pairs_used": poses.pairs_used,
        "pairs_refused": poses.pairs_refused,
        "fixed": [name for name, is_fixed in fixed if is_fixed],
    }
    return volume, xr.Dataset(variables, attrs=attrs)


def some_slices(volume: xr.DataArray, frame: Frame, step: int) -> xr.Dataset:
    """Three slices through the sheet, to draw its surfaces on: ``grey`` (slice, height, x).

    ``step`` is the width of a column in voxels; ``row`` is the row of columns that each lies in.
    """
    n_rows = volume.sizes[frame.rows] // step * step  # of whole columns
    spread = np.linspace(0, n_rows - 1, 5).astype(int)
    row_indices = np.unique(spread[1:-1])
    slices_2d: list[Array] = []
    for k in row_indices:
        one_row = volume.isel({frame.rows: slice(k, k + 1)}).load()
        columns = frame.columns(one_row).values[0]  # (x, height)
        slices_2d.append(np.ascontiguousarray(columns.T))
    axes = {"slice": frame.rows, "height": frame.through, "x": frame.cols}
    places_um = {name: volume.coords[axis].values for name, axis in axes.items()}
    places_um["slice"] = places_um["slice"][row_indices]
    grey = (tuple(axes), np.stack(slices_2d), {"long_name": "Grey value", "units": "1"})
    data = {"grey": grey, "row": ("slice", row_indices // step)}
    coords = {name: ((name,), um, {"units": "um"}) for name, um in places_um.items()}
    return xr.Dataset(data, coords, frame.attrs())
