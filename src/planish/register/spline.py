"""The smoothing thin-plate spline as a transformation, solved for every smoothing at once.

``scipy.interpolate.RBFInterpolator`` solves the same equations for one smoothing, and gives neither
derivatives nor the errors of marks left out, nor takes covariances. One eigenvalue decomposition
gives all (Wahba 1990, chapters 1 and 4).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planish.core.errors import CannotRegister
from planish.core.typing import Floats, pair_of
from planish.register.base_model import Model, refuse_line
from planish.register.bent import Bent, Kernel
from planish.register.field import DeviationField
from planish.register.pairs import (
    Pairs,
    inverse_of,
    on_both_axes,
    solved,
    squared_distances,
    whitened,
)

_LEAST = 6


def bending(squares: Floats) -> Floats:
    """The kernel ``r**2 log r`` of squared distances."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(squares > 0, 0.5 * squares * np.log(squares), 0.0)


def _slope(squares: Floats) -> Floats:
    with np.errstate(divide="ignore"):
        return np.where(squares > 0, np.log(squares) + 1.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThinPlate(Bent):
    """An affine map and smooth local changes around the marks, with ``U(r) = r**2 log r``.

    References
    ----------
    Wahba (1990), Spline Models for Observational Data, doi:10.1137/1.9781611970128.
    """

    everywhere: ClassVar[bool] = False

    bend: Floats  # (m, 2), in um: coefficients of the kernels
    # The parameter lambda of the spline in um**2: 0 goes through all marks, infinity is affine. It
    # is what ``scipy.interpolate.RBFInterpolator`` calls ``smoothing``.
    smoothing_um2: float

    def bends(self) -> Iterator[tuple[Kernel, Kernel, Floats]]:
        """One kernel."""
        yield bending, _slope, self.bend

    def add_bends(self, scaled_points: Floats, out: Floats) -> None:
        """Add the local changes at scaled points, as :class:`Bent` does, in one compiled loop."""
        # Here: help names the models, and compiles nothing.
        from planish.register._bent_kernels import add_thin_plate

        add_thin_plate(scaled_points, self.nodes, self.bend, out)


class SplineModel(Model):
    """An affine map and smooth local changes, as smooth as marks left out require."""

    name, words = "tps", "spline"
    transform = ThinPlate
    least = _LEAST

    def fit(self, pairs: Pairs, _mirrored: bool, /) -> ThinPlate:
        """The spline with the smoothing under which marks left out are missed least."""
        system = Smoothing(pairs)
        return system.spline(system.choose())

    def refit(self, pairs: Pairs, transform: ThinPlate, _field: DeviationField, /) -> ThinPlate:
        """The spline of the same smoothing."""
        return Smoothing(pairs).spline(transform.smoothing_um2)

    def left_out(self, pairs: Pairs, transform: ThinPlate, _field: DeviationField, /) -> Floats:
        """Errors at the same smoothing."""
        system = Smoothing(pairs)
        return solved(system.whitening, system.missed(transform.smoothing_um2))


class Smoothing:
    """The spline system of a set of marks.

    Whitened, the fixed marks are ``y = T b + K c + error`` with the affine part ``T``. Everything
    is expressed in the eigenvectors ``V`` and eigenvalues of ``K`` where ``T`` is projected out;
    smoothings are in um**2.
    """

    def __init__(self, pairs: Pairs) -> None:
        """Set up the system; CannotRegister where the marks are too few, or on one line.

        Places are scaled to rms distance 1 from their middle, and the fixed marks count from their
        weighted mean.
        """
        from scipy.linalg import eigh, qr

        n = len(pairs)
        if n < _LEAST:
            raise CannotRegister(
                f"{n} pairs of marks given, a thin-plate spline needs {_LEAST}: 3 for its affine"
                " part and 3 to choose its smoothing. Add more, or fit an affine transformation."
            )
        refuse_line(pairs, "tps")
        self.pairs = pairs
        self.middle, self.size = pairs.frame()
        self.nodes = (pairs.moving - self.middle) / self.size
        self.whitening = pairs.whitening()
        # Whitened covariance (2n, 2n) of both coordinates.
        squares = squared_distances(self.nodes, self.nodes)
        half_whitened = whitened(self.whitening, on_both_axes(bending(squares)))
        self.kernel = whitened(self.whitening, half_whitened.T)
        affine_part = on_both_axes(np.column_stack([np.ones(n), self.nodes]))
        # The first six columns span the affine part; all others are orthogonal to it.
        full, triangle = qr(whitened(self.whitening, affine_part))
        self.span = full[:, :6]
        self.triangle = triangle[:6]
        self.target = pairs.weights @ pairs.fixed / np.sum(pairs.weights)
        offsets = (pairs.fixed - self.target).reshape(-1, 1)
        self.y = whitened(self.whitening, offsets).ravel()
        complement = full[:, 6:]
        projected_kernel = complement.T @ self.kernel @ complement
        eigenvalues, vectors = eigh(0.5 * (projected_kernel + projected_kernel.T))
        self.eigenvalues = np.maximum(eigenvalues, 0.0)
        self.vectors = complement @ vectors
        self.z = self.vectors.T @ self.y

    def missed(self, smoothing_um2: float) -> Floats:
        """Whitened errors (n, 2) of the marks left out at a fixed smoothing.

        NaN where the others lie on one line.

        The vector is ``(P_ii)**-1 (P y)_i`` with the residual operator ``P`` of this smoothing.
        """
        # The share of each eigenvector that the spline leaves in the residuals, times a factor that
        # keeps the numbers near 1 also for an interpolating spline, which leaves nothing.
        smoothing = smoothing_um2 / self.size**2
        residual_shares = np.ones_like(self.eigenvalues)
        if np.isfinite(smoothing):
            typical = float(np.median(self.eigenvalues)) + smoothing
            residual_shares = typical / (self.eigenvalues + smoothing)
        rows = self.vectors.reshape(len(self.pairs), 2, -1)
        blocks = (rows * residual_shares) @ rows.swapaxes(1, 2)
        least = np.linalg.eigvalsh(blocks)[:, 0]
        blocks[least < 1e-12 * float(np.median(least))] = np.nan
        residuals = rows @ (residual_shares * self.z)
        return (inverse_of(blocks) @ residuals[..., None])[..., 0]

    def choose(self) -> float:
        """Return the smoothing (um**2) with the least sum of squares of marks left out.

        The smoothest among equals: infinite for an affine map, 0 for a spline through all marks.
        """
        from scipy.optimize import minimize_scalar

        # Below 1e-9 of the largest eigenvalue nothing is smoothed, and above 1e3 all is.
        top = float(self.eigenvalues.max()) * self.size**2
        logs = np.linspace(np.log(1e-9 * top), np.log(1e3 * top), 33)
        costs = np.array([*map(self._cost, logs)])
        *_, best = np.flatnonzero(costs <= costs.min() * (1 + 1e-9)).tolist()
        log_chosen = logs[best]
        least = costs[best]
        if 0 < best < len(logs) - 1:
            bracket = (logs[best - 1], logs[best + 1])
            optimum = minimize_scalar(self._cost, bounds=bracket, method="bounded")
            if optimum.fun < least:
                log_chosen = optimum.x
                least = optimum.fun
        if self._cost(np.inf) <= least * (1 + 1e-9):
            return np.inf
        if self._cost(-np.inf) < least * (1 - 1e-6):
            return 0.0
        return float(np.exp(log_chosen))

    def _cost(self, log_smoothing: float) -> float:
        """Sum of squares of the marks left out, by the logarithm of the smoothing in um**2."""
        errors = self.missed(float(np.exp(log_smoothing)))
        return float(np.nansum(errors**2))

    def spline(self, smoothing_um2: float) -> ThinPlate:
        """Return the spline of a smoothing."""
        from scipy.linalg import solve_triangular

        variances = self.eigenvalues + smoothing_um2 / self.size**2
        dual = self.vectors @ (self.z / variances)
        bend = self.whitening.swapaxes(1, 2) @ dual.reshape(-1, 2, 1)
        affine_part = self.span.T @ (self.y - self.kernel @ dual)
        affine = solve_triangular(self.triangle, affine_part).reshape(3, 2)
        affine[0] += self.target
        return ThinPlate(
            source=pair_of(self.middle),
            size=self.size,
            nodes=self.nodes,
            affine=affine,
            bend=bend[..., 0] + 0.0,  # no negative zero
            smoothing_um2=float(smoothing_um2),
        )
