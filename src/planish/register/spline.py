"""The smoothing thin-plate spline, solved for every smoothing at once, and its errors.

``scipy.interpolate.RBFInterpolator`` solves the same equations for one smoothing, and gives neither the hat matrix, nor
derivatives, nor the errors of marks left out, nor takes covariances. One eigenvalue decomposition with scipy gives all
of them, for all smoothings: the spline is the best linear prediction of a random bending whose variance is ``1 /
lambda`` times that of the marks (Wahba 1990, chapters 1 and 4; Cressie 1993, section 3.4).

Its own prior is rough: under it, a map that bends smoothly gets an expected error of up to 1.7 times the true one. The
expected error therefore takes the bending for a random field with the spline's kernel or a Gaussian covariance of one
of several lengths, and any ratio of noise to bending; each is weighted by the restricted likelihood of the marks. No
single guess of length or noise has to be right.
"""

from __future__ import annotations

import numpy as np

from planish.core.errors import CannotRegister
from planish.register.model import Floats, Model, limit_squared, refuse_line
from planish.register.pairs import COINCIDENT, Pairs, inverse_of
from planish.register.thin_plate import ThinPlate, bending

_LEAST = 6
_TRIALS = 33
# Lengths of the Gaussian covariances over the rms distance of the marks from their middle; 0 stands for the spline.
_LENGTHS = (0.0, 0.5, 0.75, 1.1, 1.6, 2.4)
# Noise over bending, relative to the largest eigenvalue of the kernel.
_RATIOS = np.logspace(-6, 2, 33)


class SplineModel(Model):
    """An affine map and smooth local changes, as smooth as marks left out require."""

    name, words = "tps", "spline"
    purpose = "local distortion"
    transform = ThinPlate
    parameters, least, tried_from = 6, _LEAST, 8

    def fit(self, pairs: Pairs, _mirrored: bool = False, /) -> ThinPlate:
        """The spline with the smoothing under which marks left out are missed least."""
        system = Smoothing(pairs)
        return system.spline(system.choose())

    def refit(self, pairs: Pairs, transform: ThinPlate, _errors: SplineErrors, /) -> ThinPlate:
        """The spline of the same smoothing."""
        return Smoothing(pairs).spline(transform.smoothing_um2)

    def errors(self, pairs: Pairs, transform: ThinPlate, _robust: Floats, /) -> SplineErrors:
        """Errors under all bendings that the marks make likely."""
        return SplineErrors(pairs, transform)

    def robust_weights(self, pairs: Pairs, _mirrored: bool, /) -> Floats:
        """Weights 0 or 1: at most a quarter of the marks is left out.

        The mark that the spline of the others misses most, over what it is expected to miss it, is left out as long as
        that exceeds the limit; smoothing is chosen anew each time. A lone mark on a sharp local bend looks like a
        wrong one.
        """
        n = len(pairs)
        keep = np.ones(n, dtype=np.bool_)
        floor = float(np.median(pairs.weights)) * (COINCIDENT * pairs.frame()[1]) ** 2
        while np.count_nonzero(keep) > max(_LEAST + 1, (3 * n + 3) // 4):
            system = Smoothing(pairs.take(keep))
            smoothing = system.choose()
            share = system.left_over(smoothing)
            errors, covariance = system.missed(smoothing)
            squares = np.nan_to_num(
                np.sum(errors[..., None] * (inverse_of(covariance) @ errors[..., None]), axis=(1, 2))
            )
            total, freedom = float(np.sum(share * system.z**2)), system.freedom - 2
            worst = int(np.argmax(squares))
            others = max((total - squares[worst]) / freedom, floor)
            if squares[worst] <= others * limit_squared(n, freedom):
                break
            keep[np.flatnonzero(keep)[worst]] = False
        return keep.astype(np.float64)


def _kernel(squares: Floats, length: float) -> Floats:
    """Covariance of the bending at squared distances, in scaled coordinates."""
    return np.exp(-0.5 * squares / length**2) if length > 0 else bending(squares)


class Smoothing:
    """The spline system of a set of marks.

    Whitened, the fixed marks are ``y = T b + K c + error`` with the affine part ``T``. Everything is expressed in the
    eigenvectors ``V`` and eigenvalues of ``K`` where ``T`` is projected out; smoothings are in um**2.
    """

    def __init__(self, pairs: Pairs) -> None:
        from scipy.linalg import eigh, qr

        n = len(pairs)
        if n < _LEAST:
            raise CannotRegister(
                f"{n} pairs of marks given, a thin-plate spline needs {_LEAST}: 3 for its affine part and 3 to choose "
                "its smoothing. Add more, or fit an affine transformation."
            )
        refuse_line(pairs, "tps")
        self.pairs = pairs
        self.middle, self.size = pairs.frame()
        self.nodes = (pairs.moving - self.middle) / self.size
        self.whitening = pairs.whitening()
        self.kernel = self.covariance(bending(np.sum((self.nodes[:, None] - self.nodes) ** 2, axis=-1)))
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

    def covariance(self, values: Floats) -> Floats:
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
        """Errors (n, 2) of the marks left out at a fixed smoothing, whitened, and their expected covariance (n, 2, 2).

        NaN where the other marks lie on one line; the covariance up to one factor common to all marks.
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
        from scipy.optimize import minimize_scalar

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
        from scipy.linalg import solve_triangular

        n = len(self.pairs)
        dual = self.vectors @ (self.z / (self.values + self.scaled(smoothing_um2)))
        bend = (self.whitening.swapaxes(1, 2) @ dual.reshape(n, 2, 1))[..., 0] + 0.0  # no negative zero
        affine = solve_triangular(self.triangle, self.span.T @ (self.y - self.kernel @ dual)).reshape(3, 2)
        affine[0] += self.target
        return ThinPlate(
            source=(float(self.middle[0]), float(self.middle[1])), size=self.size, nodes=self.nodes, affine=affine,
            bend=bend, smoothing_um2=float(smoothing_um2),
        )  # fmt: skip


def _both(rows: Floats) -> Floats:
    """Equations of one coordinate, repeated for both."""
    return np.asarray(np.kron(rows, np.eye(2)), dtype=np.float64)


class SplineErrors:
    """Errors of a spline; its smoothing stays as it is where marks are left out."""

    def __init__(self, pairs: Pairs, transform: ThinPlate) -> None:
        self._pairs, self._transform = pairs, transform
        self._system = system = Smoothing(pairs.take(pairs.weights > 0))
        self._scaled = system.scaled(transform.smoothing_um2)
        squares = np.sum((system.nodes[:, None] - system.nodes) ** 2, axis=-1)
        self._kernels = [system.covariance(_kernel(squares, length)) for length in _LENGTHS]
        self.mark_variance, self._variances = _likely_bendings(
            self._kernels, np.asarray(system.rest, dtype=np.float64), system.y
        )

    def left_out(self) -> Floats:
        """Vector by which the fit to all other marks misses each mark."""
        used = self._pairs.weights > 0
        missed = self._pairs.fixed - self._transform(self._pairs.moving)
        errors, _ = self._system.missed(self._transform.smoothing_um2)
        missed[used] = np.linalg.solve(self._system.whitening, errors[..., None])[..., 0]
        return missed

    def residual_freedom(self) -> tuple[float, float]:
        """Sum of squares of the whitened residuals, and its degrees of freedom."""
        system = self._system
        share = np.ones(system.freedom)
        if np.isfinite(self._scaled):
            share = self._scaled / (system.values + self._scaled)
        return float(np.sum((share * system.z) ** 2)), float(np.sum(share**2))

    def expected_square(self, points: Floats) -> Floats:
        """Mean square of the distance between fitted and true image, at points (k, 2) in um: shape (k,), um**2.

        With the whitened weights ``s`` that the spline gives the marks at a point, noise of the marks ``|s|**2``, and
        bending that they do not show or the smoothing takes away, ``s' K s - 2 s' k + k(0)`` for each likely bending.
        """
        system = self._system
        out = np.zeros(len(points))
        step = max(1, (1 << 18) // len(system.pairs))
        for start in range(0, len(points), step):
            at = (points[start : start + step] - system.middle) / system.size
            away = np.sum((at[:, None] - system.nodes) ** 2, axis=-1)
            total = np.zeros(len(at))
            for unit in np.eye(2):
                turned = (system.whitening @ unit).reshape(-1, 1)
                between_marks = [turned * np.repeat(_kernel(away, length).T, 2, axis=0) for length in _LENGTHS]
                shares = self._shares(at, unit, between_marks[0])
                total += self.mark_variance * np.sum(shares**2, axis=0)
                for between, here, length, variance in zip(
                    self._kernels, between_marks, _LENGTHS, self._variances, strict=True
                ):
                    own = 1.0 if length > 0 else 0.0
                    total += variance * (np.sum(shares * (between @ shares - 2 * here), axis=0) + own)
            out[start : start + step] = np.maximum(total, 0.0)
        return out

    def _shares(self, at: Floats, unit: Floats, here: Floats) -> Floats:
        """Weights of the whitened marks in one coordinate of the image of points (k, 2): shape (2n, k)."""
        from scipy.linalg import solve_triangular

        system = self._system
        plane = np.kron(np.column_stack([np.ones(len(at)), at]), unit).T
        shares = system.span @ solve_triangular(system.triangle, plane, trans="T")
        left = system.values[:, None] + self._scaled
        return shares + system.vectors @ (system.vectors.T @ (here - system.kernel @ shares) / left)


def _likely_bendings(kernels: list[Floats], rest: Floats, y: Floats) -> tuple[float, Floats]:
    """Bendings that the marks make likely: mean variance of a mark's coordinate, and of each bending, in um**2.

    ``kernels`` are the whitened covariances (2n, 2n) between the marks, one for each of `_LENGTHS`; ``rest``
    (2n, 2n - 6) is a basis of what the affine part cannot describe, ``y`` (2n,) the whitened fixed marks. The variances
    of the bendings are multiplied by their weights.
    """
    from scipy.linalg import eigh

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
    return float(np.sum(weights * np.array(marks))), np.sum(weights * np.array(bent), axis=1)
