"""Void and filler in the base.

Their share on the ray between the interfaces, mass, and profiles through the depth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from planish.core.errors import CannotMeasure
from planish.core.options import Params, option
from planish.core.typing import Floats
from planish.measure.registry import Greys, Measured, Sheet, ray_property, sheet_property

if TYPE_CHECKING:
    import xarray as xr

    from planish.core.tiles import Engine
    from planish.measure.params import MeasureParams
    from planish.measure.rays import Rays


class Options(Params):
    """Options of porosity and filler."""

    solid_grey: float | None = option(
        None,
        help=(
            "Grey of fibre wall without voids: porosity is then what the mean grey lacks to it,"
            " which sees pores too small to be resolved."
        ),
    )
    void_grey: float | None = option(
        None,
        cli=None,
        help="Level between void and solid; half way between air and base where not given.",
    )
    filler_grey: float | None = option(
        None,
        cli=None,
        help="Level between fibres and filler; half way between base and coating where not given.",
    )


def void_level(greys: Greys, params: MeasureParams) -> float:
    """Give the level between void and solid.

    It is given, or half way between air and base (or solid, where that is given).
    """
    if params.void_grey is not None:
        return params.void_grey
    return 0.5 * (greys.air + (greys.base if params.solid_grey is None else params.solid_grey))


def _solid(params: MeasureParams, greys: Greys) -> None:
    if params.solid_grey is not None and not (params.solid_grey - greys.base) * greys.polarity > 0:
        raise CannotMeasure(
            f"solid_grey is {params.solid_grey:g}, the base's mean grey {greys.base:.4g} and the"
            f" air's {greys.air:.4g}: a solid without voids lies beyond the base. Correct"
            " solid_grey."
        )


@ray_property(
    "porosity",
    units="1",
    long_name="Porosity of the base",
    check=_solid,
    when=lambda params, _greys: params.solid_grey is not None or params.void_grey is not None,
)
def porosity(rays: Rays) -> Measured:
    """P-10: share of void on the ray inside the base, its blurred edges (``edge_um``) left out.

    With ``solid_grey``: 1 - mean grey above the air / (solid - air). It sees pores smaller than a
    voxel and is not biased by noise. SE: sqrt(noise / L) / (solid - air), L the length on the ray.
    Without: the share beyond ``void_grey``; pores below two voxels are lost, and noise makes voids
    where the base is faint. SE: sqrt(n) sqrt(2 pi) w sigma / (base - air) / L with n ends of voids,
    each as uncertain as one crossing.
    """
    return _share_of_void(rays, *rays.core)


def _share_of_void(rays: Rays, lower: Floats, upper: Floats) -> Measured:
    greys, solid_grey = rays.greys, rays.params.solid_grey
    if solid_grey is None:
        matter = _share_beyond(
            rays, lower, upper, void_level(greys, rays.params), greys.base - greys.air
        )
        return Measured(values=1 - matter.values, se=matter.se)
    length, contrast = upper - lower, solid_grey - greys.air
    is_long = length >= rays.step_um
    with np.errstate(divide="ignore", invalid="ignore"):
        void_share = 1 - rays.integral(lower, upper) / length / contrast
        se = rays.integral_se(length) / length / abs(contrast)
    return Measured(values=np.where(is_long, void_share, np.nan), se=np.where(is_long, se, np.nan))


def _share_beyond(
    rays: Rays, lower: Floats, upper: Floats, level: float, contrast: float
) -> Measured:
    """Share of what lies beyond a level between two places of each ray.

    NaN where they are less than a step apart.
    """
    beyond, ends = rays.beyond(lower, upper, level)
    length = upper - lower
    is_long = length >= rays.step_um
    with np.errstate(divide="ignore", invalid="ignore"):
        se = np.sqrt(np.maximum(ends, 1)) * rays.crossing_se(contrast) / length
        return Measured(
            values=np.where(is_long, beyond / length, np.nan), se=np.where(is_long, se, np.nan)
        )


def _filler_level(params: MeasureParams, greys: Greys) -> float:
    """Level between fibres and filler.

    CannotMeasure where there is neither one nor a coating to tell it from.
    """
    if params.filler_grey is not None:
        return params.filler_grey
    coats = [level for level in (greys.coating_top, greys.coating_bottom) if np.isfinite(level)]
    if not coats:
        raise CannotMeasure(
            "Filler needs the grey level from which on the base counts as filler: there is no"
            " coating to tell it from. Give filler_grey in [properties] of a study file."
        )
    return 0.5 * (greys.base + float(np.mean(coats)))


@ray_property(
    "filler",
    units="1",
    long_name="Filler in the base",
    check=_filler_level,
    when=lambda params, _greys: params.filler_grey is not None,
)
def filler(rays: Rays) -> Measured:
    """P-11: share of bright matter on the ray inside the base.

    The base's edges (``edge_um``) are left out, and what is bright from there on without a gap:
    that is coating which has run in. Grains smaller than a voxel are faint and are lost. SE:
    sqrt(n) sqrt(2 pi) w sigma / (level - base) / L with n ends of grains.
    """
    from planish.core.grid import first_and_last

    lower, upper = rays.core
    is_beyond = (
        rays.greys.polarity * (rays.grey - np.float32(_filler_level(rays.params, rays.greys))) > 0
    )
    is_within = rays.between(lower, upper)
    is_dark = is_within & ~is_beyond
    (first, last), ends = (first_and_last(mask) for mask in (is_dark, is_within))
    # An end that is dark already, or a ray that is bright throughout, stays as it is, between two
    # samples.
    has_dark = is_dark.any(axis=-1)
    start = np.where(has_dark & (ends[0] != first), rays.s_um[first], lower)
    stop = np.where(has_dark & (ends[1] != last), rays.s_um[last], upper)
    return _share_of_filler(rays, start, stop)


def _share_of_filler(rays: Rays, lower: Floats, upper: Floats) -> Measured:
    level = _filler_level(rays.params, rays.greys)
    return _share_beyond(rays, lower, upper, level, 2 * (level - rays.greys.base))


def _weighable(params: MeasureParams, greys: Greys) -> None:
    params.need("Filler", "filler_g_cm3")
    _filler_level(params, greys)


@sheet_property(
    "filler_weight",
    units="g/m2",
    long_name="Filler",
    check=_weighable,
    after=("filler", "base_thickness"),
)
def filler_weight(sheet: Sheet) -> Measured:
    """P-11 as a mass: share of filler times base thickness times the filler's density.

    SE: the share's, likewise.
    """
    mass = sheet.maps["base_thickness"].values * sheet.params.need("Filler", "filler_g_cm3")
    share = sheet.maps["filler"]
    return Measured(values=share.values * mass, se=share.se * mass)


_SHARES: dict[str, tuple[Callable[[Rays, Floats, Floats], Measured], str]] = {
    "porosity": (_share_of_void, "Porosity of the base"),
    "filler": (_share_of_filler, "Filler in the base"),
}


def _layer_sums(
    names: Sequence[str], layer_edges: Floats, halo_rays: Rays, tile_rows: slice, _: slice
) -> Floats:
    """Give number, sum and sum of squares of each share in each layer by row.

    The shape is (names, layers, 3, rows).
    """
    # Rows are summed by themselves, then added in the same order however they were cut.
    rays = halo_rays.rows(tile_rows)
    base_um = rays.interface_top - rays.interface_bottom
    edge_um = [rays.interface_bottom + edge * base_um for edge in layer_edges]
    layer_sums = np.zeros((len(names), layer_edges.size - 1, 3, len(base_um)))
    for name_index, name in enumerate(names):
        for layer in range(layer_edges.size - 1):
            share = _SHARES[name][0](rays, edge_um[layer], edge_um[layer + 1]).values
            is_valid = np.isfinite(share) & (rays.status == 0)
            share = np.where(is_valid, share, 0.0)
            layer_sums[name_index, layer] = [
                is_valid.sum(axis=1),
                share.sum(axis=1),
                (share**2).sum(axis=1),
            ]
    return layer_sums


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
    import xarray as xr

    from planish.measure.properties import each_tile, ray_frame

    unknown_names = [name for name in names if name not in _SHARES]
    if unknown_names or bins < 1:
        raise CannotMeasure(
            f"There is no profile of {', '.join(unknown_names) or 'no layers'}. Choose from"
            f" {', '.join(_SHARES)}, and at least one layer."
        )
    frame = ray_frame(volume, surfaces, params)
    if "filler" in names:
        _filler_level(frame.params, frame.greys)
    layer_edges = np.linspace(0.0, 1.0, bins + 1)
    sum_layers = partial(_layer_sums, names, layer_edges)
    tile_sums = each_tile(volume, frame, sum_layers, rows=rows_per_tile, engine=engine)
    count, total, squares = np.moveaxis(np.concatenate(tile_sums, axis=-1).sum(axis=-1), -1, 0)
    if not (count > 0).any():
        raise CannotMeasure(
            f"The base is too thin for {bins} layers of a step of the rays ({frame.step_um:g} um)."
            " Ask for fewer bins."
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(count > 0, total / count, np.nan)
        sd = np.sqrt(np.maximum(squares / count - mean**2, 0.0))
    base_map_um = frame.faces["interface_top"] - frame.faces["interface_bottom"]
    base_um = float(np.nanmedian(np.where(frame.status == 0, base_map_um, np.nan)))
    middle_depth = 0.5 * (layer_edges[1:] + layer_edges[:-1])
    is_blurred = np.minimum(middle_depth, 1 - middle_depth) < 2 * frame.greys.blur_um / base_um
    profiles = xr.Dataset(attrs={"base_um": base_um, "rays": frame.params.rays}).assign_coords(
        depth=(
            "depth",
            middle_depth,
            {"units": "1", "long_name": "Relative depth in the base, 0 at its bottom"},
        )
    )
    for a, name in enumerate(names):
        title = _SHARES[name][1]
        profiles[name] = "depth", mean[a], {"units": "1", "long_name": title}
        profiles[f"{name}_sd"] = (
            "depth",
            sd[a],
            {"units": "1", "long_name": f"{title}, standard deviation of rays"},
        )
        profiles[f"{name}_n"] = "depth", count[a], {"long_name": "Rays"}
    profiles["blurred"] = (
        "depth",
        is_blurred.astype(np.float64),
        {"long_name": "Within two blurs of an interface"},
    )
    return profiles
