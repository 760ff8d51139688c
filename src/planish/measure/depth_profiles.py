"""Shares of voids and filler over the depth of the base."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from planish.core.errors import CannotMeasure
from planish.core.typing import Floats
from planish.measure.params import MeasureParams
from planish.measure.phases import filler_level, share_of_filler, share_of_void
from planish.measure.properties import each_tile, ray_frame
from planish.measure.rays import Rays
from planish.measure.registry import Measured

if TYPE_CHECKING:
    from planish.core.tiles import Engine

ShareOf = Callable[[Rays, Floats, Floats], Measured]
"""Share of a phase between two places (rows, cols) of each ray."""
_SHARES: dict[str, tuple[ShareOf, str]] = {
    "porosity": (share_of_void, "Porosity of the base"),
    "filler": (share_of_filler, "Filler in the base"),
}


def _layer_sums(
    names: Sequence[str], layer_edges: Floats, halo_rays: Rays, tile_rows: slice, _: slice
) -> Floats:
    """Give number, sum and sum of squares of each share in each layer by row.

    The shape is (names, layers, 3, rows). ``layer_edges``: relative depths of the layers' borders,
    from 0 at the bottom interface to 1 at the top one. ``halo_rays``: those of a tile, of which
    ``tile_rows``, rows within ``halo_rays``, are counted; the last argument, their rows in the
    sheet, plays no part.

    Interfaces and edges are signed distances (um) along each ray from the centre surface. Rays
    with a status other than 0 are left out, and so is a share that is NaN: its layer is thinner
    than a step of the ray. A share may lie outside 0 to 1 where ``solid_grey`` is given.
    """
    # Rows are summed by themselves, then added in the same order however they were cut.
    rays = halo_rays.rows(tile_rows)
    base_um = rays.interface_top - rays.interface_bottom
    edge_um = [rays.interface_bottom + edge * base_um for edge in layer_edges]
    layer_sums: list[list[Floats]] = []
    for name in names:
        share_of, _title = _SHARES[name]
        for lower, upper in pairwise(edge_um):
            share = share_of(rays, lower, upper).values
            is_valid = np.isfinite(share) & (rays.status == 0)
            share = np.where(is_valid, share, 0.0)
            layer_sums.append([values.sum(axis=1) for values in (is_valid, share, share**2)])
    return np.reshape(layer_sums, (len(names), -1, 3, len(base_um)))


def depth_profiles(
    volume: xr.DataArray,
    surfaces: xr.Dataset,
    *,
    names: Sequence[str] = ("porosity",),
    bins: int = 20,
    params: MeasureParams | None = None,
    rows_per_tile: int | None = None,
    engine: Engine | None = None,
) -> xr.Dataset:
    """Share of a phase in layers of equal relative depth, mean over all valid rays (P-10, P-11).

    Parameters
    ----------
    volume, surfaces, params, rows_per_tile, engine
        As in :func:`~planish.measure.measure_along_rays`; no result depends on the last two.
    names : sequence of {"porosity", "filler"}
    bins : int
        Layers. On a ray where a layer is thinner than a step of the ray it is not counted.

    Returns
    -------
    Dataset, dim (depth)
        Each name with ``<name>_sd``, the standard deviation from ray to ray, and ``<name>_n``.
        Depth 0 is the bottom interface, 1 the top one; ``blurred``: 1 in the layers within two
        blurs of an interface, where what lies beside the base shines in.

    Raises
    ------
    CannotMeasure
        If a name is unknown, a grey level is missing, or the layers are thinner than a step
        everywhere.
    """
    unknown_names = [name for name in names if name not in _SHARES]
    if unknown_names or bins < 1:
        raise CannotMeasure(
            f"There is no profile of {', '.join(unknown_names) or 'no layers'}. Choose from"
            f" {', '.join(_SHARES)}, and at least one layer."
        )
    frame = ray_frame(volume, surfaces, params)
    if "filler" in names:
        filler_level(frame.params, frame.greys)
    layer_edges = np.linspace(0.0, 1.0, bins + 1)
    sum_layers = partial(_layer_sums, names, layer_edges)
    tile_sums = each_tile(volume, frame, sum_layers, rows=rows_per_tile, engine=engine)
    sums = np.concatenate(tile_sums, axis=-1).sum(axis=-1)
    count, total, squares = np.moveaxis(sums, -1, 0)
    if not (count > 0).any():
        raise CannotMeasure(
            f"The base is too thin for {bins} layers of a step of the rays ({frame.step_um:g} um)."
            " Ask for fewer bins."
        )
    n_rays = np.where(count > 0, count, np.nan)
    mean = total / n_rays
    sd = np.sqrt(np.maximum(squares / n_rays - mean**2, 0.0))
    base_map_um = frame.faces["interface_top"] - frame.faces["interface_bottom"]
    base_um = float(np.nanmedian(base_map_um[frame.status == 0]))
    middle_depth = 0.5 * (layer_edges[1:] + layer_edges[:-1])
    interface_depth = np.minimum(middle_depth, 1 - middle_depth)
    is_blurred = interface_depth < 2 * frame.greys.blur_um / base_um
    depth_attrs = {"units": "1", "long_name": "Relative depth in the base, 0 at its bottom"}
    coords = {"depth": ("depth", middle_depth, depth_attrs)}
    attrs = {"base_um": base_um, "rays": frame.params.rays}
    profiles = xr.Dataset(coords=coords, attrs=attrs)
    for a, name in enumerate(names):
        _, title = _SHARES[name]
        sd_title = f"{title}, standard deviation of rays"
        profiles[name] = "depth", mean[a], {"units": "1", "long_name": title}
        profiles[f"{name}_sd"] = "depth", sd[a], {"units": "1", "long_name": sd_title}
        profiles[f"{name}_n"] = "depth", count[a], {"long_name": "Rays"}
    blur_attrs = {"long_name": "Within two blurs of an interface"}
    profiles["blurred"] = "depth", is_blurred.astype(float), blur_attrs
    return profiles
