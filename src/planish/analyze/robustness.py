"""Rows that stand beside a correlation.

Other origins of the points, short waves alone, and what other maps explain.
"""

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
import xarray as xr

from planish.analyze.compared_maps import ComparedMaps
from planish.analyze.correlation import (
    LEAST,
    Correlation,
    PointsCorrelation,
    check_varying,
    correlate,
    filled,
    pearson,
    placed,
    valid_pixels,
)
from planish.analyze.curve_of_sizes import SizeRow
from planish.core.area import common_means, square_px, valid_in_all
from planish.core.arrays import values_of
from planish.core.axial import refuse_axial
from planish.core.errors import InputError, PlanishError, SizeError
from planish.core.facts import NULL, DescribedModel, Value
from planish.core.grid import shorter_side_um
from planish.core.typing import Array, Bools, Entries, Floats, Pixel, Texts
from planish.measure.registry import shared_parts
from planish.texture.textures import low_pass_known, standard


class _Given(DescribedModel):
    given: Texts
    """Maps of the sheet whose part was taken off both."""


class Partial(PointsCorrelation, _Given):
    """Correlation of what other maps of the sheet do not explain of two maps, by least squares."""

    reason: str | None = None
    """Why there is no partial correlation."""
    r_alone: Value = NULL
    """r over the same points with no part taken off."""
    over_control: Texts = ()
    """Maps whose part was taken off although they contain the map, are part of it or share a part
    with it: what they take off is the map itself."""
    over_control_parts: tuple[Texts, ...] = ()
    """For each of these, the largest maps that both contain."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Origins:
    """Correlations over grids of points that begin at other places of the map.

    Mean, least and largest r.
    """

    r: float
    least: float
    largest: float
    count: int


def origins(a: Array, b: Array, *, pixel_um: Pixel, point_um: float) -> Origins:
    """Correlate two maps over points whose grid begins at 16 places within a point.

    Where a grid begins is chosen by no one, and moves r² of one field by some hundredths.

    Parameters
    ----------
    a, b, pixel_um, point_um
        As of :func:`planish.correlate`.

    Returns
    -------
    Origins

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> a = rng.normal(size=(60, 80))
    >>> b = a + rng.normal(size=(60, 80))
    >>> shifted = origins(a, b, pixel_um=10.0, point_um=40.0)
    >>> shifted.count, round(shifted.least, 1), round(shifted.largest, 1)
    (16, 0.7, 0.7)
    """
    is_valid, pixel = valid_pixels(a, b, pixel_um)
    x = np.where(is_valid, a, np.nan)
    quarters_um = np.arange(4) * point_um / 4
    # Whole pixels, of which a small point has fewer than four.
    steps_px = [np.rint(quarters_um / step) for step in pixel]
    starts = [np.unique(steps).astype(int) for steps in steps_px]
    known_r: list[float] = []
    for down, across in product(*starts):
        part = np.s_[down:, across:]
        r = correlate(x[part], b[part], pixel_um=pixel, point_um=point_um).r
        if not math.isnan(r):
            known_r.append(r)
    if not known_r:
        raise SizeError(
            f"No grid of points of {point_um:g} um fits into the map. Give smaller points."
        )
    mean_r = float(np.mean(known_r))
    largest_r = max(known_r)
    return Origins(r=mean_r, least=min(known_r), largest=largest_r, count=len(known_r))


def of_short_waves(
    a: Array,
    b: Array,
    *,
    pixel_um: Pixel,
    point_um: float | None = None,
) -> tuple[Correlation, float]:
    """Correlate what waves below a fifth of the field leave of two maps.

    A field holds few long waves, which make the interval wide. This row says nothing of waves above
    that length.

    Parameters
    ----------
    a, b, pixel_um, point_um
        As of :func:`planish.correlate`.

    Returns
    -------
    Correlation
    float
        That wavelength, in um.

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If fewer than 3 pixels are valid.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> a, b = rng.normal(size=(2, 60, 80)) + np.linspace(0.0, 5.0, 80)
    >>> row, longest_um = of_short_waves(a, b, pixel_um=10.0)
    >>> round(row.r, 1), longest_um
    (0.0, 120.0)
    """
    is_valid, pixel = valid_pixels(a, b, pixel_um)
    check_varying(is_valid)
    longest = 0.2 * shorter_side_um(is_valid.shape, pixel)
    short: list[Floats] = []
    for values in filled(is_valid, (a, b), np.nan):
        centred = values - np.mean(values[is_valid])
        long_waves = low_pass_known(centred, is_valid, longest, pixel)
        short.append(centred - long_waves)
    return correlate(*short, pixel_um=pixel, point_um=point_um), longest


def partial(a: Array, b: Array, covariates: Sequence[Array], *, pixel_um: Pixel) -> Correlation:
    """Correlate what other maps do not explain of two maps, by least squares.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
    covariates : sequence of ndarray, shape (rows, cols)
        Maps whose linear part is taken off both. Never parts together with their sum.
    pixel_um
        As of :func:`planish.correlate`.

    Raises
    ------
    InputError
        If the maps are not on one grid, or one of the others explains all of a or b: parts stand
        beside their sum.
    CannotMeasure
        If fewer than 3 pixels are valid in all maps.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> base, a, b = rng.normal(size=(3, 60, 80))
    >>> abs(partial(a + base, b + base, [base], pixel_um=10.0).r) < 0.05
    True
    """
    is_valid, pixel = valid_pixels(a, b, pixel_um)
    for m in covariates:
        is_valid &= valid_pixels(a, m, pixel)[0]
    check_varying(is_valid)
    columns = [m[is_valid] - m[is_valid].mean() for m in covariates]
    residual_maps: list[Floats] = []
    for m in (a, b):
        y = m[is_valid] - m[is_valid].mean()
        residual = _left_of(y, columns)
        if residual @ residual <= 1e-10 * (y @ y):
            raise InputError(
                "The other maps explain all of one map: parts stand beside their sum. Leave one of"
                " them out."
            )
        residual_maps.append(placed(residual, is_valid, math.nan))
    return correlate(*residual_maps, pixel_um=pixel)


def _left_of(y: Floats, columns: Sequence[Floats]) -> Floats:
    """What other columns of points do not explain of one, by least squares."""
    x = np.stack(columns, axis=1)
    return y - x @ np.linalg.lstsq(x, y, rcond=None)[0]


def commonality(b: Array, parts: Mapping[str, Array]) -> dict[str, float]:
    """Share of map b's variance that each map explains alone, and that maps explain only together.

    Parameters
    ----------
    b : ndarray, shape (rows, cols)
    parts : mapping of name to ndarray, shape (rows, cols); two to four maps; never parts together
    with their sum

    Returns
    -------
    dict of str to float
        Names joined by " and " -> share; all shares add up to the r² of all maps together. A
        negative common share means that one map hides what another one does.

    Raises
    ------
    InputError
        If there are fewer than two or more than four maps, or one is the sum of others.
    CannotMeasure
        If fewer than 3 pixels are valid in all maps, or b is constant.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> coating, base = rng.normal(size=(2, 60, 80))
    >>> shares = commonality(coating + base, {"coating": coating, "base": base})
    >>> {name: abs(round(share, 1)) for name, share in shares.items()}
    {'coating': 0.5, 'base': 0.5, 'coating and base': 0.0}
    """
    names = list(parts)
    if not 2 <= len(names) <= 4:
        raise InputError(f"{len(names)} maps were given. Commonality needs 2 to 4.")
    b = values_of(b, "b")
    parts = {name: values_of(values, name) for name, values in parts.items()}
    is_valid = valid_in_all([b, *parts.values()])
    check_varying(is_valid, b=b)
    y = b[is_valid] - b[is_valid].mean()
    columns = {name: standard(m, is_valid)[is_valid] for name, m in parts.items()}
    x = np.stack([*columns.values()], axis=1)
    if np.linalg.cond(x) > 1e6:
        raise InputError(
            "One of the maps is the sum of others. Leave the sum, or one of its parts, out."
        )
    # Share of the variance that some maps explain together.
    explained: dict[frozenset[str], float] = {frozenset(): 0.0}
    for chosen in _subsets(names):
        residual = _left_of(y, [columns[name] for name in chosen])
        share_left = residual @ residual / (y @ y)
        explained[frozenset(chosen)] = float(1.0 - share_left)
    shares: dict[str, float] = {}
    for chosen in _subsets(names):
        other_names = frozenset(names).difference(chosen)
        # What is gained by these maps over the others, counted in and out.
        share = -explained[other_names]
        for subset in _subsets(chosen):
            sign = (-1) ** len(subset)
            share -= sign * explained[other_names.union(subset)]
        shares[" and ".join(chosen)] = share
    return shares


def _subsets(names: Sequence[str]) -> list[Texts]:
    """All choices of one name or more, the shortest first."""
    return [chosen for k in range(len(names)) for chosen in combinations(names, k + 1)]


# --- what stands beside r -------------------------------------------------------------------------


def answer_origins(pair: ComparedMaps) -> Entries:
    """Least, mean and largest r over grids of points that begin elsewhere."""
    if not pair.has_points:
        return {}
    r_of_origins = origins(pair.x, pair.y, **pair.sizes)
    return {"origins": (r_of_origins.least, r_of_origins.r, r_of_origins.largest)}


def answer_short_waves(pair: ComparedMaps) -> Entries:
    """R without the waves of which the field holds few."""
    if not pair.has_points:
        return {}
    correlation, longest_um = of_short_waves(pair.x, pair.y, **pair.sizes)
    return {"short_waves": SizeRow.of(correlation), "short_waves_um": longest_um}


def _check_beside(sheet_maps: xr.Dataset, covariates: Sequence[str]) -> None:
    """Raise InputError where a sheet lacks a map that is to stand beside, or it is an angle."""
    missing_names = [name for name in covariates if name not in sheet_maps]
    if missing_names:
        raise InputError(
            f"The sheet has no map {', '.join(missing_names)} to stand beside. Leave it out of"
            " `beside`, or measure it."
        )
    for name in covariates:
        refuse_axial(sheet_maps[name])


def _constant_maps(maps: Mapping[str, Floats], is_valid: Bools) -> list[str]:
    """Names of the maps that are constant over the valid points."""
    return [name for name, m in maps.items() if not np.ptp(m[is_valid]) > 0]


def answer_partial(pair: ComparedMaps) -> Entries:
    """Partial correlation and commonality over the larger points, of a sheet with an image.

    What stands beside the headline map are the maps that the study names. Where the points are too
    few or too small for it, the answer is the reason. InputError where the sheet lacks a map.
    """
    sheet_maps, image_maps = pair.layers
    covariates = pair.params.beside
    point_um = pair.point_um
    if "thickness" not in sheet_maps:
        return {}
    _check_beside(sheet_maps, covariates)
    # Maps that both contain: taking such a map off takes part of the headline map itself off.
    all_parts = {name: shared_parts(pair.a[1], name, sheet_maps) for name in covariates}
    parts = {name: shared for name, shared in all_parts.items() if shared}
    partial_of = functools.partial(
        Partial,
        given=covariates,
        point_um=point_um,
        over_control=tuple(parts),
        over_control_parts=tuple(parts.values()),
    )
    # From the pixels, as all of the maps count where all are known.
    factor = square_px(point_um, pair.grid.pixel_um)
    if min(factor) < 1 - 1e-9:
        reason = f"Points of {point_um:g} um are smaller than a pixel."
        return {"partial": partial_of(reason=reason)}
    names = (pair.a[1], *covariates)
    maps = [sheet_maps[name] for name in names]
    maps.append(image_maps[pair.b[1]])
    masks = (sheet_maps["valid"], image_maps["valid"])
    *sheet_points, image_points = common_means(maps, factor, masks=masks)
    is_valid = np.isfinite(image_points)
    n = int(np.count_nonzero(is_valid))
    points = dict(zip(names, sheet_points, strict=True))
    flat_maps = [*points]
    if n >= LEAST:
        flat_maps = _constant_maps(points, is_valid)
    if flat_maps:
        reason = (
            f"Over {n} points that are valid in all maps, {', '.join(flat_maps)} does not vary."
        )
        return {"partial": partial_of(n=n, reason=reason)}
    r_alone = pearson(sheet_points[0][is_valid], image_points[is_valid])
    try:
        correlation = partial(sheet_points[0], image_points, sheet_points[1:], pixel_um=point_um)
        shares = commonality(image_points, points)
    except PlanishError as error:  # nothing is left: the rest of the run stands
        return {"partial": partial_of(reason=error.text, r_alone=r_alone)}
    stated = Partial.of(correlation, **partial_of.keywords, r_alone=r_alone)
    return {"partial": stated, "commonality": shares}
