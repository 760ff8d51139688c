"""Brightness that a coating of known weight should have: Kubelka and Munk's theory of scattering layers.

Light goes straight down and up in it; what scatters sideways is left out. A map of points below some 0.2 mm is blurred
by that, and its brightness follows the coating less than the theory says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planish.core.errors import InputError
from planish.core.light import layer_over

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layer:
    """One layer of a stack.

    Attributes
    ----------
    weight : array_like
        kg/m2, or thickness in um; NaN is missing.
    scattering, absorption : array_like
        Coefficients in m2/kg, or per um.
    """

    weight: ArrayLike
    scattering: ArrayLike
    absorption: ArrayLike = 0.0


def reflectance(weight: ArrayLike, *, scattering: ArrayLike, absorption: ArrayLike = 0.0, backing: ArrayLike) -> Array:
    """Reflectance of a layer over a backing.

    Parameters
    ----------
    weight : array_like
        kg/m2, with coefficients in m2/kg; or thickness in um, with coefficients per um. NaN is missing.
    scattering, absorption : array_like
        Kubelka and Munk's s and k; 0 is allowed for either.
    backing : array_like
        Reflectance of what lies below, 0 to 1.

    Returns
    -------
    ndarray of float64
        0 to 1, of the shape that the arguments broadcast to; NaN where one is NaN.

    Raises
    ------
    InputError
        If a weight or coefficient is negative or infinite, or the backing is not within 0 to 1.

    Notes
    -----
    Without absorption ``R = [Rg + (1 - Rg) s W] / [1 + (1 - Rg) s W]``, which is reached without a step. Over a bright
    base the curve bends late: half of what is missing to 1 is gained at ``W = 1 / [s (1 - Rg)]``, some 35 g/m2 of a
    coating with s = 150 m2/kg on a base of 0.8.

    References
    ----------
    P. Kubelka, J. Opt. Soc. Am. 38, 448 (1948), doi:10.1364/JOSA.38.000448, equation 9.

    Examples
    --------
    >>> base = pile(scattering=45.0, absorption=1.2)
    >>> reflectance([0.0, 0.010, 0.030], scattering=150.0, absorption=0.3, backing=base).round(3)
    array([0.794, 0.839, 0.884])
    """
    values = _at_least_0(weight=weight, scattering=scattering, absorption=absorption)
    below = np.asarray(backing, dtype=np.float64)
    if np.any((below < 0) | (below > 1)):
        raise InputError(
            f"The reflectance of the backing is {_furthest(below):g}; it lies within 0 and 1. Divide the grey of the "
            "base by that of a white reference, both less the dark level."
        )
    return layer_over(below, values["scattering"], values["absorption"], values["weight"])


def stack(layers: Sequence[Layer], backing: ArrayLike) -> Array:
    """Reflectance of layers over a backing, from the bottom to the top; without layers that of the backing.

    Raises
    ------
    InputError
        As :func:`reflectance`.
    """
    below = reflectance(0.0, scattering=0.0, backing=backing)
    for layer in layers:
        below = reflectance(layer.weight, scattering=layer.scattering, absorption=layer.absorption, backing=below)
    return below


def pile(*, scattering: ArrayLike, absorption: ArrayLike) -> Array:
    """Reflectance of a pile that nothing shines through, ``1 + k/s - sqrt((k/s)^2 + 2 k/s)``; 1 without absorption.

    Raises
    ------
    InputError
        If a coefficient is negative or infinite, or both are 0: such a layer is not there.
    """
    values = _at_least_0(scattering=scattering, absorption=absorption)
    s, k = values["scattering"], values["absorption"]
    if np.any((s == 0) & (k == 0)):
        raise InputError("A layer that neither scatters nor absorbs hides nothing. Give a scattering above 0.")
    return s / (s + k + np.sqrt(k * (k + 2 * s)))  # a - b as 1 / (a + b): nothing cancels


def _at_least_0(**given: ArrayLike) -> dict[str, Array]:
    """Turn what is given into arrays; every fault is reported at once."""
    values = {name: np.asarray(v, dtype=np.float64) for name, v in given.items()}
    wrong = {name: int(np.count_nonzero((v < 0) | np.isinf(v))) for name, v in values.items()}
    faults = [f"{name} has {n} of {values[name].size} values" for name, n in wrong.items() if n]
    if faults:
        raise InputError(f"{'; '.join(faults)} that are negative or infinite. Mask them (NaN), or check the units.")
    return values


def _furthest(values: Array) -> float:
    """The value that lies furthest from the middle between 0 and 1."""
    return float(values.flat[int(np.nanargmax(np.abs(values - 0.5)))])
