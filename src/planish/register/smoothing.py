"""The equations of the smoothing thin-plate spline, solved for every smoothing at once.

``scipy.interpolate.RBFInterpolator`` solves the same equations for one smoothing, and gives neither the hat matrix, nor
derivatives, nor the errors of marks left out, nor takes covariances. One eigenvalue decomposition with scipy gives all
of them, for all smoothings: the spline is the best linear prediction of a random bending whose variance is ``1 /
lambda`` times that of the marks (Wahba 1990, chapters 1 and 4; Cressie 1993, section 3.4).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, qr, solve_triangular
from scipy.optimize import minimize_scalar

from planish.core.errors import CannotRegister
from planish.register.equations import refuse_line
from planish.register.pairs import Pairs, inverse_of
from planish.register.thin_plate import ThinPlate, bending
from planish.register.unseen import LENGTHS, Bendings, kernel

Floats = NDArray[np.float64]

LEAST = 6
_TRIALS = 33


class Smoothing:
    """The spline system of a set of marks.

    Whitened, the fixed marks are ``y = T b + K c + error`` with the affine part ``T``. Everything is expressed in the
    eigenvectors ``V`` and eigenvalues of ``K`` where ``T`` is projected out; smoothings are in um**2.

    Attributes
    ----------
    pairs : Pairs
        The marks, all with weights above 0.
    freedom : int
        ``2 n - 6``: what the affine part leaves.

    Raises
    ------
    CannotRegister
        With fewer than 6 marks, or marks on one line.
    """

    def __init__(self, pairs: Pairs) -> None:
        n = len(pairs)
        if n < LEAST:
            raise CannotRegister(
                f"{n} pairs of marks given, a thin-plate spline needs {LEAST}: 3 for its affine part and 3 to choose "
                "its smoothing. Add more, or fit an affine transformation."
            )
        refuse_line(pairs, "tps")
        self.pairs = pairs
        self.middle, self.size = pairs.frame()
        self.nodes = (pairs.moving - self.middle) / self.size
        self.whitening = pairs.whitening()
        self.kernel = self._covariance(bending(np.sum((self.nodes[:, None] - self.nodes) ** 2, axis=-1)))
        affine = self._whitened(_both(np.column_stack([np.ones(n), self.nodes])))
        full, triangle = qr(affine)
        self.span, self.rest, self.triangle = full[:, :6], full[:, 6:], triangle[:6]
        self.target = pairs.weights @ pairs.fixed / np.sum(pairs.weights)
        self.y = self._whitened((pairs.fixed - self.target).reshape(-1, 1))[:, 0]
        inner = self.rest.T @ self.kernel @ self.rest
        values, vectors = eigh(0.5 * (inner + inner.T))
        self.values = np.maximum(values, 0.0)
        self.vectors = self.rest @ vectors
        self.z = self.vectors.T @ self.y
        self.freedom = 2 * n - 6

    def _whitened(self, rows: Floats) -> Floats:
        """Multiply the 2 x 2 blocks of the whitening to rows (2n, k)."""
        return (self.whitening @ rows.reshape(len(self.pairs), 2, -1)).reshape(rows.shape)

    def _covariance(self, values: Floats) -> Floats:
        """Whitened covariance (2n, 2n) of both coordinates from that of one, (n, n)."""
        return self._whitened(self._whitened(_both(values)).T)

    def scaled(self, smoothing_um2: float) -> float:
        """Smoothing in the scaled coordinates of the equations."""
        return smoothing_um2 / self.size**2

    def left_over(self, smoothing_um2: float) -> Floats:
        """Share of each eigenvector that the spline leaves in the residuals, times any one factor."""
        if np.isinf(smoothing_um2):
            return np.ones(self.freedom)
        scaled = self.scaled(smoothing_um2)
        # The factor keeps the numbers near 1 also for an interpolating spline, which leaves nothing.
        return (float(np.median(self.values)) + scaled) / (self.values + scaled)

    def missed(self, smoothing_um2: float) -> tuple[Floats, Floats]:
        """Errors of the marks left out at a fixed smoothing, in whitened units, and their expected covariance.

        Returns
        -------
        errors : ndarray, shape (n, 2)
            NaN where the other marks lie on one line.
        covariance : ndarray, shape (n, 2, 2)
            Up to one factor common to all marks.
        """
        share = self.left_over(smoothing_um2)
        rows = self.vectors.reshape(len(self.pairs), 2, -1)
        blocks = (rows * share) @ rows.swapaxes(1, 2)
        least = np.linalg.eigvalsh(blocks)[:, 0]
        blocks[least < 1e-12 * float(np.median(least))] = np.nan
        covariance = inverse_of(blocks)
        return (covariance @ (rows @ (share * self.z))[..., None])[..., 0], covariance

    def choose(self) -> float:
        """Return the smoothing with the least sum of squares of marks left out; the smoothest among equals."""

        def cost(smoothing_um2: float) -> float:
            return float(np.nansum(self.missed(smoothing_um2)[0] ** 2))

        top = float(self.values.max()) * self.size**2
        logs = np.linspace(np.log(1e-9 * top), np.log(1e3 * top), _TRIALS)
        costs = np.array([cost(float(np.exp(v))) for v in logs])
        best = int(np.flatnonzero(costs <= costs.min() * (1 + 1e-9))[-1])
        chosen, least = float(np.exp(logs[best])), float(costs[best])
        if 0 < best < _TRIALS - 1:
            around = (float(logs[best - 1]), float(logs[best + 1]))
            found = minimize_scalar(lambda v: cost(float(np.exp(v))), bounds=around, method="bounded")
            if float(found.fun) < least:
                chosen, least = float(np.exp(found.x)), float(found.fun)
        if cost(float("inf")) <= least * (1 + 1e-9):
            return float("inf")
        return 0.0 if cost(0.0) < least * (1 - 1e-6) else chosen

    def spline(self, smoothing_um2: float) -> ThinPlate:
        """Return the spline of a smoothing."""
        n = len(self.pairs)
        if np.isinf(smoothing_um2):
            dual, bend = np.zeros(2 * n), np.zeros((n, 2))
        else:
            dual = self.vectors @ (self.z / (self.values + self.scaled(smoothing_um2)))
            bend = (self.whitening.swapaxes(1, 2) @ dual.reshape(n, 2, 1))[..., 0]
        affine = solve_triangular(self.triangle, self.span.T @ (self.y - self.kernel @ dual)).reshape(3, 2)
        affine[0] += self.target
        return ThinPlate(
            source=(float(self.middle[0]), float(self.middle[1])), size=self.size, nodes=self.nodes, affine=affine,
            bend=bend, smoothing_um2=float(smoothing_um2),
        )  # fmt: skip

    @cached_property
    def bendings(self) -> Bendings:
        """Bendings that the marks make likely, and what they leave to the error of a mark."""
        squares = np.sum((self.nodes[:, None] - self.nodes) ** 2, axis=-1)
        kernels = [self._covariance(kernel(squares, length)) for length in LENGTHS]
        return Bendings(kernels, np.asarray(self.rest, dtype=np.float64), self.y)

    def residual_freedom(self, smoothing_um2: float) -> tuple[float, float]:
        """Sum of squares of the whitened residuals, and its degrees of freedom."""
        if np.isinf(smoothing_um2):
            return float(np.sum(self.z**2)), float(self.freedom)
        share = self.scaled(smoothing_um2) / (self.values + self.scaled(smoothing_um2))
        return float(np.sum((share * self.z) ** 2)), float(np.sum(share**2))

    def expected_square(self, smoothing_um2: float, points: Floats) -> Floats:
        """Mean square of the distance between fitted and true image, at points (k, 2) in um: shape (k,), um**2.

        With the whitened weights ``s`` that the spline gives the marks at a point, noise of the marks ``|s|**2``, and
        bending that they do not see or the smoothing takes away, ``s' K s - 2 s' k + k(0)`` for each of `Bendings`.
        """
        out = np.zeros(len(points))
        squares = np.sum((self.nodes[:, None] - self.nodes) ** 2, axis=-1)
        kernels = [self._covariance(kernel(squares, length)) for length in LENGTHS]
        step = max(1, (1 << 18) // len(self.pairs))
        for start in range(0, len(points), step):
            at = (points[start : start + step] - self.middle) / self.size
            away = np.sum((at[:, None] - self.nodes) ** 2, axis=-1)
            total = np.zeros(len(at))
            for axis in (0, 1):
                unit = np.eye(2)[axis]
                turned = (self.whitening @ unit).reshape(-1, 1)
                seen = [turned * np.repeat(kernel(away, length).T, 2, axis=0) for length in LENGTHS]
                shares = self._shares(smoothing_um2, at, unit, seen[0])
                total += self.bendings.mark_variance * np.sum(shares**2, axis=0)
                for between, here, length, variance in zip(
                    kernels, seen, LENGTHS, self.bendings.variances, strict=True
                ):
                    own = 1.0 if length > 0 else 0.0
                    total += variance * (np.sum(shares * (between @ shares - 2 * here), axis=0) + own)
            out[start : start + step] = np.maximum(total, 0.0)
        return out

    def _shares(self, smoothing_um2: float, at: Floats, unit: Floats, seen: Floats) -> Floats:
        """Weights of the whitened marks in one coordinate of the image of points (k, 2): shape (2n, k)."""
        plane = np.kron(np.column_stack([np.ones(len(at)), at]), unit).T
        shares = self.span @ solve_triangular(self.triangle, plane, trans="T")
        if np.isinf(smoothing_um2):
            return shares
        left = self.values[:, None] + self.scaled(smoothing_um2)
        return shares + self.vectors @ (self.vectors.T @ (seen - self.kernel @ shares) / left)


def _both(rows: Floats) -> Floats:
    """Equations of one coordinate, repeated for both."""
    return np.asarray(np.kron(rows, np.eye(2)), dtype=np.float64)


def fit_thin_plate(pairs: Pairs, smoothing_um2: float | None = None) -> ThinPlate:
    """Fit a thin-plate spline to marks.

    Parameters
    ----------
    pairs : Pairs
        Marks with weights above 0.
    smoothing_um2 : float, optional
        0 goes through every mark; by default the one under which marks left out are missed least.
    """
    system = Smoothing(pairs)
    return system.spline(system.choose() if smoothing_um2 is None else smoothing_um2)
