"""Errors that maps share: two thicknesses that meet at one surface share its error.

A coating is thinner by what the base is thicker where their interface was found too high. From the
stated errors of the maps follow those of the surfaces, and from these the covariances.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import optimize

from planish.core.facts import DescribedModel, Value
from planish.core.typing import Floats
from planish.measure.registry import HEIGHTS, LENGTHS

_EVEN = 1e-6
"""Weight by which errors of surfaces that nothing tells apart are taken alike."""


class SharedError(DescribedModel):
    """Two maps whose errors go together, as they meet at one surface."""

    a: str
    """First map."""
    b: str
    """Second map."""
    surface: str
    """Where they meet."""
    correlation: Value
    """Of their errors."""


def _signs_of_surfaces() -> dict[str, dict[str, float]]:
    """With which sign the height of each surface enters each map.

    By map, then by surface. A thickness grows with its upper surface and falls with its lower one;
    heights count outwards, so those of the bottom face fall with z.
    """
    signs: dict[str, dict[str, float]] = {}
    for name, (upper, lower) in LENGTHS.items():
        signs[name] = {upper: 1.0, lower: -1.0}
    for name, surface in HEIGHTS.items():
        outwards = 1.0 if name.endswith("_top") else -1.0
        signs[name] = {surface: outwards}
    for surfaces in signs.values():
        surfaces.pop("centre", None)  # a smooth surface, whose error is that of both faces' mean
    return signs


SIGNS = _signs_of_surfaces()
SURFACES = ("top", "interface_top", "interface_bottom", "bottom")


def bare_name(name: str) -> str:
    """Name of a map without that of its layer."""
    return name.rpartition(".")[2]


def covariance_of_errors(names: Sequence[str], stated: Mapping[str, float]) -> Floats:
    """Give the covariance of the errors of some maps, (names, names).

    Parameters
    ----------
    names : sequence of str
        With or without those of their layer.
    stated : mapping of str to float
        Standard errors of maps, of these and of others, and of surfaces, such as ``interface_top``.
        A map whose error neither is stated nor follows from that of surfaces counts as exact.

    Notes
    -----
    The variance of each map's error is the sum of those of its two surfaces. The variances of the
    surfaces are those of non-negative least squares; where the stated errors leave several, the
    most even ones.

    Examples
    --------
    >>> names = ["coating_top", "base_thickness"]
    >>> stated = {"coating_top": 1.0, "base_thickness": 1.0}
    >>> covariance_of_errors(names, stated).round(2).tolist()
    [[1.0, -0.67], [-0.67, 1.0]]
    """
    variances = _variances_of_surfaces(stated)
    bare_names = [bare_name(name) for name in names]
    signs = np.zeros((len(names), len(SURFACES)))
    for row, name in zip(signs, bare_names, strict=True):
        for surface, sign in SIGNS.get(name, {}).items():
            row[SURFACES.index(surface)] = sign
    covariance = signs * variances @ signs.T
    for index, name in enumerate(bare_names):
        if name in stated:
            covariance[index, index] = stated[name] ** 2
    return covariance


def _variances_of_surfaces(stated: Mapping[str, float]) -> Floats:
    """Variance of the error of each of SURFACES, by least squares.

    Each stated error says that the variances of the map's surfaces add up to its square. A weak
    equation for each surface, that its variance is 0, picks the most even ones of several.
    """
    equations = [*(_EVEN * np.eye(len(SURFACES)))]
    squares = [0.0] * len(SURFACES)
    for name, error in stated.items():
        surfaces = [name] if name in SURFACES else [*SIGNS.get(name, {})]
        if surfaces:
            counts = [float(surface in surfaces) for surface in SURFACES]
            equations.append(np.array(counts))
            squares.append(error**2)
    return optimize.nnls(np.array(equations), np.array(squares))[0]


def sharings_of(names: Sequence[str], covariance: Floats) -> tuple[SharedError, ...]:
    """Name the pairs of maps whose errors go together, with the surface that they share.

    ``covariance`` (names, names) is that of the errors; each pair is named once.
    """
    sharings: list[SharedError] = []
    deviations = np.sqrt(np.diag(covariance))
    for first, second in np.argwhere(np.triu(covariance, 1)).tolist():
        a = names[first]
        b = names[second]
        surfaces_of_b = SIGNS[bare_name(b)]
        surface = next(name for name in SIGNS[bare_name(a)] if name in surfaces_of_b)
        spread = deviations[first] * deviations[second]
        correlation = covariance[first, second] / spread
        sharings.append(SharedError(a=a, b=b, surface=surface, correlation=correlation))
    return tuple(sharings)
