"""Rows that stand beside a correlation: other origins of the points, short waves alone, what other maps explain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planish.analyze.correlation import Correlation, correlate, on_one_grid
from planish.analyze.texture import low_pass
from planish.analyze.trend import without_trend
from planish.core.errors import CannotMeasure, InputError, SizeError
from planish.core.facts import NULL, Facts, Interval, Value

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ORIGINS = 4  # along either axis
_LONGEST = 0.2  # of the shorter side: waves that a field holds too few of
_MOST_PARTS = 4
_LEAST = 3  # pixels


class Partial(Facts):
    """Correlation of what other maps of the sheet do not explain of two maps, by least squares."""

    given: tuple[str, ...] = Field(description="Maps of the sheet whose part was taken off both.")
    point_um: float = Field(description="Edge of the points.")
    n: int | None = Field(default=None, description="Points that are valid in all maps.")
    r: Value = Field(default=NULL, description="Partial correlation.")
    n_eff: Value = Field(default=NULL, description="Independent points of what is left.")
    interval: Interval = Field(default=NULL, description="In which r lies with 95 %.")
    silence: str | None = Field(default=None, description="Why there is no partial correlation.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Origins:
    """Correlations over grids of points that begin at other places of the map: mean, least and largest r."""

    r: float
    least: float
    largest: float
    count: int


def origins(
    a: NDArray[Any], b: NDArray[Any], *, mask: Mask | None = None, pixel_um: float | tuple[float, float],
    point_um: float,
) -> Origins:  # fmt: skip
    """Correlate two maps over points whose grid begins at 16 places within a point.

    Where a grid begins is chosen by no one, and moves r² of one field by some hundredths.

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    """
    pixel = on_one_grid(a, b, mask, pixel_um)
    x = np.asarray(a, dtype=np.float64)
    x = x if mask is None else np.where(mask, x, np.nan)
    steps = [[round(k * point_um / p / _ORIGINS) for k in range(_ORIGINS)] for p in pixel]
    found = [
        correlate(x[down:, across:], np.asarray(b)[down:, across:], pixel_um=pixel, point_um=point_um).r
        for down in sorted(set(steps[0])) for across in sorted(set(steps[1]))
    ]  # fmt: skip
    known = [r for r in found if not math.isnan(r)]
    if not known:
        raise SizeError(f"No grid of points of {point_um:g} um fits into the map. Give smaller points.")
    return Origins(r=float(np.mean(known)), least=min(known), largest=max(known), count=len(known))


def of_short_waves(
    a: NDArray[Any], b: NDArray[Any], *, mask: Mask | None = None, pixel_um: float | tuple[float, float],
    longest_um: float | None = None, point_um: float | None = None,
) -> tuple[Correlation, float]:  # fmt: skip
    """Correlate what waves below a fifth of the field leave of two maps; return it with that wavelength.

    A field holds few long waves, which make the interval wide. This row answers another question: it says nothing of
    waves above that length.

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If fewer than 3 pixels are valid.
    """
    pixel = on_one_grid(a, b, mask, pixel_um)
    known = _known(a, b, mask)
    side = min(n * p for n, p in zip(known.shape, pixel, strict=True))
    longest = _LONGEST * side if longest_um is None else longest_um
    if not 0 < longest < math.inf:
        raise SizeError(f"The longest wave is {longest:g} um. Give a length above 0.")
    weight = np.maximum(low_pass(known.astype(np.float64), longest, pixel), 1e-9)
    short = [
        np.where(known, m - low_pass(np.where(known, m, 0.0), longest, pixel) / weight, np.nan)
        for m in (np.where(known, v - np.mean(v[known]), 0.0) for v in (a, b))
    ]
    return correlate(short[0], short[1], pixel_um=pixel, point_um=point_um), longest


def without_trends(
    a: NDArray[Any], b: NDArray[Any], *, mask: Mask | None = None, pixel_um: float | tuple[float, float],
    point_um: float | None = None,
) -> Correlation:  # fmt: skip
    """Correlate two maps without their plane and second-order surface.

    Raises
    ------
    InputError, SizeError
        As :func:`planish.correlate`.
    CannotMeasure
        If fewer than 3 pixels are valid.
    """
    pixel, known = on_one_grid(a, b, mask, pixel_um), _known(a, b, mask)
    x, y = (np.where(known, without_trend(np.where(known, m, 0.0), known), np.nan) for m in (a, b))
    return correlate(x, y, pixel_um=pixel, point_um=point_um)


def partial(
    a: NDArray[Any], b: NDArray[Any], others: Sequence[NDArray[Any]], *, mask: Mask | None = None,
    pixel_um: float | tuple[float, float],
) -> Correlation:  # fmt: skip
    """Correlate what other maps do not explain of two maps, by least squares.

    Parameters
    ----------
    a, b : ndarray, shape (rows, cols)
    others : sequence of ndarray, shape (rows, cols)
        Maps whose linear part is taken off both. Never parts together with their sum.
    mask, pixel_um
        As of :func:`planish.correlate`.

    Raises
    ------
    InputError
        If the maps are not on one grid, or one of the others explains all of a or b: parts stand beside their sum.
    CannotMeasure
        If fewer than 3 pixels are valid in all maps.
    """
    pixel = on_one_grid(a, b, mask, pixel_um)
    known = _known(a, b, mask)
    for m in others:
        on_one_grid(a, m, None, pixel)
        known &= np.isfinite(m)
    _enough(known)
    x, y = (_rest(m, others, known) for m in (a, b))
    return correlate(x, y, pixel_um=pixel)


def commonality(b: NDArray[Any], parts: Mapping[str, NDArray[Any]], *, mask: Mask | None = None) -> dict[str, float]:
    """Share of the variance of map b that each map explains alone, and that maps explain only together.

    Parameters
    ----------
    b : ndarray, shape (rows, cols)
    parts : mapping of name to ndarray, shape (rows, cols)
        Two to four maps; never parts together with their sum.
    mask : ndarray of bool, shape (rows, cols), optional

    Returns
    -------
    dict of str to float
        Names joined by " and " -> share; all shares add up to the r² of all maps together. A negative common share
        means that one map hides what another one does.

    Raises
    ------
    InputError
        If there are fewer than two or more than four maps, or one is the sum of others.
    CannotMeasure
        If fewer than 3 pixels are valid in all maps, or b is constant.
    """
    names = list(parts)
    if not 2 <= len(names) <= _MOST_PARTS:
        raise InputError(f"{len(names)} maps were given. Commonality needs 2 to {_MOST_PARTS}.")
    known = np.isfinite(b) if mask is None else np.isfinite(b) & mask
    for m in parts.values():
        known &= np.isfinite(m)
    _enough(known)
    y = b[known] - b[known].mean()
    if not np.ptp(y) > 0:
        raise CannotMeasure("Map b is constant: there is nothing to explain.")
    columns = {k: (m[known] - m[known].mean()) / max(float(m[known].std()), 1e-300) for k, m in parts.items()}
    if np.linalg.cond(np.stack(list(columns.values()), axis=1)) > 1e6:
        raise InputError("One of the maps is the sum of others. Leave the sum, or one of its parts, out.")
    explained: dict[frozenset[str], float] = {frozenset(): 0.0}
    for count in range(1, len(names) + 1):
        for chosen in combinations(names, count):
            terms = np.stack([columns[k] for k in chosen], axis=1)
            rest = y - terms @ np.linalg.lstsq(terms, y, rcond=None)[0]
            explained[frozenset(chosen)] = 1.0 - float(rest @ rest) / float(y @ y)
    out: dict[str, float] = {}
    for count in range(1, len(names) + 1):
        for chosen in combinations(names, count):
            left = frozenset(names) - frozenset(chosen)
            # What is gained by these maps over the others, counted in and out.
            out[" and ".join(chosen)] = -sum(
                (-1) ** k * explained[left | frozenset(some)]
                for k in range(count + 1) for some in combinations(chosen, k)
            )  # fmt: skip
    return out


def _known(a: NDArray[Any], b: NDArray[Any], mask: Mask | None) -> Mask:
    known = np.isfinite(a) & np.isfinite(b)
    return _enough(known if mask is None else known & np.asarray(mask))


def _enough(known: Mask) -> Mask:
    if (n := int(np.count_nonzero(known))) < _LEAST:
        raise CannotMeasure(f"{n} pixels are valid in all maps, {_LEAST} are needed. Look at the masks.")
    return known


def _rest(values: NDArray[Any], others: Sequence[NDArray[Any]], known: Mask) -> Array:
    y = values[known] - values[known].mean()
    terms = np.stack([m[known] - m[known].mean() for m in others], axis=1) if others else np.zeros((y.size, 0))
    rest = y - terms @ np.linalg.lstsq(terms, y, rcond=None)[0] if others else y
    if float(rest @ rest) <= 1e-10 * float(y @ y):
        raise InputError("The other maps explain all of one map: parts stand beside their sum. Leave one of them out.")
    out = np.full(values.shape, np.nan)
    out[known] = rest
    return out
