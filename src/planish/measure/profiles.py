"""Profiles through the relative depth of the base: porosity and filler, from its bottom (0) to its top (1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr

from planish.core.errors import CannotMeasure
from planish.core.tiles import Engine
from planish.measure.along_rays import each_tile, ray_frame
from planish.measure.filler import filler_level, share_of_filler
from planish.measure.params import MeasureParams
from planish.measure.porosity import share_of_void
from planish.measure.rays import Array, Rays
from planish.measure.registry import Measured

_SHARES: dict[str, tuple[Callable[[Rays, Array, Array], Measured], str]] = {
    "porosity": (share_of_void, "Porosity of the base"),
    "filler": (share_of_filler, "Filler in the base"),
}


def depth_profiles(
    volume: xr.DataArray, surfaces: xr.Dataset, *, names: Sequence[str] = ("porosity",), bins: int = 20,
    params: MeasureParams | None = None, rows_per_tile: int | None = None, engine: Engine | None = None,
) -> xr.Dataset:  # fmt: skip
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
        Each name with ``<name>_sd``, the standard deviation from ray to ray, and ``<name>_n``. Depth 0 is the bottom
        interface, 1 the top one; ``blurred``: 1 in the layers within two blurs of an interface, where what lies
        beside the base shines in.

    Raises
    ------
    CannotMeasure
        If a name is unknown, a grey level is missing, or the layers are thinner than a step everywhere.
    """
    params = params or MeasureParams()
    unknown = [name for name in names if name not in _SHARES]
    if unknown or bins < 1:
        raise CannotMeasure(
            f"There is no profile of {', '.join(unknown) or 'no layers'}. Choose from {', '.join(_SHARES)}, and at "
            "least one layer."
        )
    frame = ray_frame(volume, surfaces, params)
    if "filler" in names:
        filler_level(frame.greys, params)
    edges = np.linspace(0.0, 1.0, bins + 1)

    def work(tile: Rays, own: slice, _at: slice) -> Array:
        tile = tile.rows(own)
        thick = tile.interface_top - tile.interface_bottom
        # Sums of every row for itself: they are then added in the same order, however the rows were cut.
        sums = np.zeros((len(names), bins, 3, tile.status.shape[0]))
        for a, name in enumerate(names):
            for b in range(bins):
                lower, upper = (tile.interface_bottom + edges[k] * thick for k in (b, b + 1))
                share = _SHARES[name][0](tile, lower, upper).values
                known = np.isfinite(share) & (tile.status == 0)
                share = np.where(known, share, 0.0)
                sums[a, b] = [known.sum(axis=1), share.sum(axis=1), (share**2).sum(axis=1)]
        return sums

    parts = each_tile(volume, frame, work, rows=rows_per_tile, engine=engine or Engine())
    count, total, squares = np.moveaxis(np.concatenate(parts, axis=-1).sum(axis=-1), -1, 0)
    if not (count > 0).any():
        raise CannotMeasure(
            f"The base is too thin for {bins} layers: none is as thick as a step of the rays ({frame.step_um:g} um). "
            "Ask for fewer bins."
        )
    middle = 0.5 * (edges[1:] + edges[:-1])
    thick = float(
        np.nanmedian(
            np.where(frame.status == 0, frame.faces["interface_top"] - frame.faces["interface_bottom"], np.nan)
        )
    )
    near = 2 * frame.greys.blur_um / thick
    data: dict[str, tuple[str, Array, dict[str, object]]] = {}
    for a, name in enumerate(names):
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.where(count[a] > 0, total[a] / count[a], np.nan)
            sd = np.sqrt(np.maximum(squares[a] / count[a] - mean**2, 0.0))
        title = _SHARES[name][1]
        data[name] = ("depth", mean, {"units": "1", "long_name": title})
        data[f"{name}_sd"] = ("depth", sd, {"units": "1", "long_name": f"{title}, standard deviation of rays"})
        data[f"{name}_n"] = ("depth", count[a], {"long_name": "Rays"})
    blurred = (np.minimum(middle, 1 - middle) < near).astype(np.float64)
    data["blurred"] = ("depth", blurred, {"long_name": "Within two blurs of an interface"})
    about = {"units": "1", "long_name": "Relative depth in the base, 0 at its bottom"}
    return xr.Dataset(data, coords={"depth": ("depth", middle, about)}, attrs={"base_um": thick, "rays": params.rays})
