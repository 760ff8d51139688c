"""What marks do not see: the error of a thin-plate spline between them, under every bending that they make likely.

The spline's own prior is rough: under it, a map that bends smoothly gets an expected error of up to 1.7 times the true
one. Here the bending is a random field with the spline's kernel or a Gaussian covariance of one of several lengths, and
any ratio of noise to bending; each is weighted by the restricted likelihood of the marks, and the mean square error of
the spline as it was fitted is averaged over all of them. No single guess of length or noise has to be right.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from planish.register.thin_plate import bending

Floats = NDArray[np.float64]

# Lengths of the Gaussian covariances over the rms distance of the marks from their middle; 0 stands for the spline.
LENGTHS = (0.0, 0.5, 0.75, 1.1, 1.6, 2.4)
# Noise over bending, relative to the largest eigenvalue of the kernel.
_RATIOS = np.logspace(-6, 2, 33)


def kernel(squares: Floats, length: float) -> Floats:
    """Covariance of the bending at squared distances, in scaled coordinates."""
    return np.exp(-0.5 * squares / length**2) if length > 0 else bending(squares)


class Bendings:
    """Bendings and their weights.

    Parameters
    ----------
    kernels : list of ndarray, shape (2n, 2n)
        Whitened covariances between the marks, one for each of `LENGTHS`.
    rest : ndarray, shape (2n, 2n - 6)
        Orthonormal basis of what the affine part cannot describe.
    y : ndarray, shape (2n,)
        Whitened fixed marks.

    Attributes
    ----------
    mark_variance : float
        Mean variance of a coordinate of a mark with information 1, in um**2.
    variances : ndarray, shape (len(LENGTHS),)
        Mean variance of each bending times its weight, in um**2.
    """

    def __init__(self, kernels: list[Floats], rest: Floats, y: Floats) -> None:
        logs: list[Floats] = []
        marks: list[Floats] = []
        bent: list[Floats] = []
        for values in kernels:
            inner = rest.T @ values @ rest
            eigenvalues, vectors = eigh(0.5 * (inner + inner.T))
            squares = (vectors.T @ (rest.T @ y)) ** 2
            ratios = _RATIOS * max(float(eigenvalues[-1]), 1e-300)
            spread = np.maximum(eigenvalues, 0.0) + ratios[:, None]
            total = np.maximum(np.sum(squares / spread, axis=1), 1e-300)
            n = len(squares)
            logs.append(-0.5 * np.sum(np.log(spread), axis=1) - 0.5 * n * np.log(total))
            marks.append(ratios * total / n)
            bent.append(total / n)
        weights = np.exp(np.array(logs) - np.max(logs))
        weights /= np.sum(weights)
        self.mark_variance = float(np.sum(weights * np.array(marks)))
        self.variances = np.sum(weights * np.array(bent), axis=1)
