"""The map that the marks make likely.

A similarity, an affine deviation and a smooth random field, averaged.

The map is ``alpha z + beta + gamma conj(z) + h(z)`` with the places ``z`` as complex numbers.
Nothing is known beforehand of the similarity; ``gamma`` and the Gaussian process ``h`` are random:
their variances are one of a few ratios to that of the marks, and ``h`` has one of nine covariances.
Each of these assumptions is weighted by its restricted likelihood (Patterson and Thompson 1971,
Biometrika 58, 545, doi:10.1093/biomet/58.3.545), so that no single guess of size or length has to
be right (Handcock and Stein 1993, Technometrics 35, 403, doi:10.1080/00401706.1993.10485354;
Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, sections 2.2, 2.7 and 5.4).

Axes of arrays are (a, g, ...): ratios of the affine deviation, of the field, and what else there
is. Places are scaled: they count from the middle of the marks, in rms distances from it.
"""

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from planish.core.transform import are_known
from planish.core.typing import Floats, Ints
from planish.register.pairs import (
    COINCIDENT,
    Pairs,
    inverse_of,
    on_both_axes,
    solved,
    squared_distances,
    whitened,
)

# Gaussian and Matern 3/2 covariances, each with its length over the rms distance of the marks from
# their middle.
KERNELS = (
    *(("gauss", length) for length in (0.35, 0.6, 1.0, 1.6, 2.4)),
    *(("matern", length) for length in (0.3, 0.8, 2.0, 5.0)),
)
# Variance of the affine deviation at that distance, and of the field, over that of a mark; 0 is as
# likely as not.
_AFFINE = np.array([0.0, 3.0, 30.0, 300.0])
_FIELD = np.array([0.0, *np.logspace(-1, 4, 6)])
_LEAST = 1e-3  # kernels that are less likely than this share count for nothing
_AT_ONCE = 1 << 18
# Of more marks, those that lie together are one with their mean: the field is smooth, and the time
# grows with the cube.
MOST = 256


def covariance(kernel: tuple[str, float], squares: Floats) -> Floats:
    """Covariance at squared distances: 1 at 0."""
    name, length = kernel
    if name == "gauss":
        return np.exp(squares * (-0.5 / length**2))
    away = np.sqrt(squares * (3.0 / length**2))
    return (1.0 + away) * np.exp(-away)


def covariance_slope(kernel: tuple[str, float], squares: Floats) -> Floats:
    """Derivative of the covariance by half the squared distance."""
    name, length = kernel
    if name == "gauss":
        return covariance(kernel, squares) / -(length**2)
    away = np.sqrt(squares * (3.0 / length**2))
    return np.exp(-away) * (-3.0 / length**2)


class _KernelFit(NamedTuple):
    """The marks under one covariance, in its eigenvectors, for all ratios.

    The axes are (affine, field, ...).
    """

    eigenvectors: Floats  # (2n, 2n): whitened marks to eigenvectors, as columns
    y: Floats  # (2n,)
    design: Floats  # (2n, 6): similarity and affine deviation
    shrinkage: Floats  # (g, 2n): one over the variance of each eigenvector
    coefficient_cov: Floats  # (a, g, 6, 6): covariance of the six coefficients
    coefficients: Floats  # (a, g, 6): the six coefficients
    misfit: Floats  # (a, g): sum of squares that remains
    mark_variances: Floats  # (a, g): of one coordinate of a mark
    log_posterior: Floats  # (a, g): logarithm of the restricted likelihood times prior


class DeviationField:
    """Map and errors that pairs make likely.

    ``mixture`` (kernels, affine ratios, field ratios) is the probability of each assumption;
    ``mark_variance``, in um**2, is the variance of one coordinate of a pair with information 1, NaN
    where no residual is left.
    """

    def __init__(self, pairs: Pairs, mirrored: bool, mixture: Floats | None = None) -> None:
        """Fit each kernel; ``mixture`` holds the probabilities of them all, if they are known.

        More pairs than `MOST` are taken together first. Kernels that are unlikely are dropped once
        all are judged.
        """
        self._all_pairs = pairs
        self.mirrored = mirrored
        # (n,), which marks were taken together; more than `MOST` are.
        self.group = _groups(pairs.fixed, MOST)
        self._pairs = pairs = _grouped_pairs(pairs, self.group)
        self.middle, self.size = pairs.frame()
        self.nodes = (pairs.moving - self.middle) / self.size
        self._unit = float(np.median(pairs.weights))
        self._whitening = pairs.whitening() / np.sqrt(self._unit)
        design = self._columns(self.nodes)
        fixed_column = pairs.fixed.reshape(-1, 1)
        target = whitened(self._whitening, fixed_column).ravel()
        columns = whitened(self._whitening, design.reshape(-1, 6))
        # All else is small beside this similarity.
        similarity, *_ = np.linalg.lstsq(columns[:, :4], target, rcond=None)
        self._first = np.append(similarity, [0.0, 0.0])
        y = target - columns @ self._first
        squares = squared_distances(self.nodes, self.nodes)
        self.freedom = 2 * len(pairs) - 4
        # Square of what float64 leaves of the length of a mark's place; no misfit is smaller.
        size_um = float(np.hypot(*similarity[2:]))
        floor = (COINCIDENT * size_um) ** 2
        kernel_fits: dict[int, _KernelFit] = {}
        for k, kernel in enumerate(KERNELS):
            if mixture is None or mixture[k].any():
                kernel_fits[k] = self._fit(kernel, squares, columns, y, floor)
        if mixture is None:
            log_posteriors = [fit.log_posterior for fit in kernel_fits.values()]
            mixture = _shares(np.array(log_posteriors))
        self.mixture = mixture
        self._kernel_fits = {k: fit for k, fit in kernel_fits.items() if mixture[k].any()}
        self.mark_variance = np.nan
        if self.freedom > 0:
            variance = 0.0
            for k, fit in self._kernel_fits.items():
                variance += np.sum(mixture[k] * fit.mark_variances)
            self.mark_variance = float(variance) * self._unit

    def _columns(self, scaled: Floats) -> Floats:
        """Derivatives (k, 2, 6) of the image of scaled points (k, 2).

        By shift, scale and turn, and by the affine deviation.
        """
        x, y = scaled.T
        x = -x if self.mirrored else x
        ones = np.ones_like(x)
        zeros = np.zeros_like(x)
        along_x = np.stack([ones, zeros, x, -y, x, y], axis=-1)
        along_y = np.stack([zeros, ones, y, x, -y, x], axis=-1)
        return np.stack([along_x, along_y], axis=1)

    def _fit(
        self,
        kernel: tuple[str, float],
        squares: Floats,
        design: Floats,
        y: Floats,
        misfit_floor: float,
    ) -> _KernelFit:
        """Fit one kernel at all strengths of the field and of the affine part.

        ``squares`` (n, n) are distances between the nodes; ``design`` (2n, 6) and ``y`` (2n,) are
        whitened, without the first similarity; ``misfit_floor`` is a sum of squares a degree of
        freedom.
        """
        covariances = covariance(kernel, squares)
        if self._pairs.isotropic:
            weight_roots = self._whitening[:, 0, 0]
            spectrum: Any = np.linalg.eigh(weight_roots[:, None] * covariances * weight_roots)
            eigenvalues: Floats = np.repeat(spectrum[0], 2)
            eigenvectors = on_both_axes(spectrum[1])
        else:
            rows = whitened(self._whitening, on_both_axes(covariances))
            eigenvalues, eigenvectors = np.linalg.eigh(whitened(self._whitening, rows.T))
        eigenvalues = np.maximum(eigenvalues, 0.0)
        design = eigenvectors.T @ design
        y = eigenvectors.T @ y
        shrinkage = 1.0 / (1.0 + _FIELD[:, None] * eigenvalues)
        weighted = shrinkage[:, None] * design.T  # (g, 6, 2n)
        gram = weighted @ design
        projected = weighted @ y
        coefficient_cov = np.zeros((len(_AFFINE), len(_FIELD), 6, 6))
        similarity_gram = gram[:, :4, :4]
        coefficient_cov[0, :, :4, :4] = np.linalg.inv(similarity_gram)
        penalty = np.diag([0.0, 0, 0, 0, 1, 1])
        penalised = gram + penalty / _AFFINE[1:, None, None, None]
        coefficient_cov[1:] = np.linalg.inv(penalised)
        coefficients = (coefficient_cov @ projected[..., None])[..., 0]
        explained_squares = np.sum(coefficients * projected, axis=-1)
        residual_squares = shrinkage @ (y * y) - explained_squares
        freedom = max(self.freedom, 1)
        misfit = np.maximum(residual_squares, 0.0) + freedom * misfit_floor
        log_shrinkage = 0.5 * np.sum(np.log(shrinkage), axis=1)
        log_posterior = np.tile(log_shrinkage, (len(_AFFINE), 1))
        _, log_determinants = np.linalg.slogdet(similarity_gram)
        log_posterior[0] -= 0.5 * log_determinants
        _, log_determinants = np.linalg.slogdet(penalised)
        log_posterior[1:] -= 0.5 * log_determinants + np.log(_AFFINE[1:, None])
        log_posterior -= 0.5 * self.freedom * np.log(misfit)
        log_posterior += _log_prior(_FIELD) + _log_prior(_AFFINE)[:, None]
        return _KernelFit(
            eigenvectors=eigenvectors,
            y=y,
            design=design,
            shrinkage=shrinkage,
            coefficient_cov=coefficient_cov,
            coefficients=coefficients,
            misfit=misfit,
            mark_variances=misfit / freedom,
            log_posterior=log_posterior,
        )

    # --- the map and its errors -------------------------------------------------------------------

    def mean(self) -> tuple[Floats, tuple[tuple[str, float], ...], Floats]:
        """Affine part, and coefficients of the likely kernels at the nodes, in um.

        Their shapes are (3, 2) and (kernels, n, 2).

        Also the kernels to which the coefficients belong, in their order. The affine part has a row
        for 1, x and y of scaled places.
        """
        plane_coefficients = np.zeros(6)
        kernel_coefficients = dict[int, Floats]()
        for k, kernel_fit in self._kernel_fits.items():
            probabilities = self.mixture[k]
            plane_coefficients += np.einsum("ag,agp->p", probabilities, kernel_fit.coefficients)
            # From eigenvectors (2n,) back to coefficients of the marks (n, 2).
            residuals = self._scaled_residuals(kernel_fit)
            mean_residuals = np.einsum("ag,g,agk->k", probabilities, _FIELD, residuals)
            dual = kernel_fit.eigenvectors @ mean_residuals
            coefficients = self._whitening.swapaxes(1, 2) @ dual.reshape(-1, 2, 1)
            kernel_coefficients[k] = coefficients[..., 0]
        # Coefficients of `_columns` as those of ``(1, x, y)``: images of (0, 0), (1, 0) and (0, 1).
        corner_columns = self._columns(np.eye(3, 2, -1))
        plane = np.einsum("kcp,p->kc", corner_columns, plane_coefficients + self._first)
        plane[1:] -= plane[:1]
        kernels = tuple(KERNELS[k] for k in kernel_coefficients)
        return plane, kernels, np.array(list(kernel_coefficients.values()))

    def _scaled_residuals(self, kernel_fit: _KernelFit) -> Floats:
        """Residuals of the six coefficients over their variance: (a, g, 2n)."""
        return kernel_fit.shrinkage * (kernel_fit.y - kernel_fit.coefficients @ kernel_fit.design.T)

    @cached_property
    def _square_forms(self) -> dict[int, tuple[Floats, Floats, float]]:
        """Mean square deviation from the first similarity as a quadratic form, for each kernel.

        It is ``f' S f + c`` with ``f = (1, x, y, covariances with the nodes)``; ``S`` (3 + n, 3 +
        n), and ``b`` (3 + n, 2), the mean deviation, for cross terms.
        """
        from scipy.linalg import block_diag

        forms: dict[int, tuple[Floats, Floats, float]] = {}
        n = len(self._pairs)
        plane_columns = on_both_axes(_plane_rows(self.nodes))
        columns = self._columns(self.nodes).reshape(-1, 6)
        plane_basis, *_ = np.linalg.lstsq(plane_columns, columns, rcond=None)
        unwhitening = block_diag(*self._whitening.swapaxes(1, 2))
        for k, kernel_fit in self._kernel_fits.items():
            probabilities = self.mixture[k]
            variances = kernel_fit.mark_variances
            # Rows of which the products with (columns, eigenvectors) are squared and summed.
            least_variance = np.diag([0.0, 0, 0, 0, 1e-300, 1e-300])
            root = np.linalg.cholesky(kernel_fit.coefficient_cov + least_variance)
            root = root.swapaxes(-1, -2)
            # (g, 6, 2n).
            shrunk_design = kernel_fit.design.T * kernel_fit.shrinkage[:, None]
            cross_terms = -_FIELD[:, None, None] * shrunk_design
            spread_rows = np.concatenate([root, root @ cross_terms], axis=-1)
            spread_rows *= np.sqrt(probabilities * variances)[..., None, None]
            dual = _FIELD[:, None] * self._scaled_residuals(kernel_fit)
            means = np.concatenate([kernel_fit.coefficients, dual], axis=-1)
            mean_rows = np.sqrt(probabilities)[..., None] * means
            spread_rows = spread_rows.reshape(-1, 6 + 2 * n)
            mean_rows = mean_rows.reshape(-1, 6 + 2 * n)
            stacked_rows = np.concatenate([spread_rows, mean_rows])
            form = stacked_rows.T @ stacked_rows
            weights = probabilities * variances
            explained_variance = np.einsum("ag,g,gk->k", weights, _FIELD**2, kernel_fit.shrinkage)
            form[6:, 6:] -= np.diag(explained_variance)
            basis_change = block_diag(plane_basis, unwhitening @ kernel_fit.eigenvectors)
            form = basis_change @ form @ basis_change.T
            # Rows and columns are x and y by turns; a distance adds both.
            form = form[0::2, 0::2] + form[1::2, 1::2]
            mean_deviation = basis_change @ np.einsum("ag,agk->k", probabilities, means)
            constant = 2.0 * float(np.sum(weights * _FIELD))
            forms[k] = (form, mean_deviation.reshape(-1, 2), constant)
        return forms

    def expected_square(self, points: Floats, images: Floats) -> Floats:
        """Mean square distance of the true images of points from given ones.

        Points and given images have shape (k, 2), the result (k,), in um**2.

        The square of the distance from the mean map, and the variance around that.
        """
        out = np.full(len(points), np.nan)
        if self.freedom <= 0:
            return out
        step = max(1, _AT_ONCE // len(self._pairs))
        for start in range(0, len(points), step):
            part = slice(start, start + step)
            scaled_points = (points[part] - self.middle) / self.size
            squares = squared_distances(scaled_points, self.nodes)
            plane_rows = _plane_rows(scaled_points)
            deviations = images[part] - self._columns(scaled_points) @ self._first
            squares_um2 = np.sum(deviations**2, axis=1)
            for k, (form, mean, constant) in self._square_forms.items():
                covariances = covariance(KERNELS[k], squares)
                row = np.concatenate([plane_rows, covariances], axis=1)
                quadratic_terms = np.sum(row * (row @ form), axis=1)
                cross_terms = np.sum(deviations * (row @ mean), axis=1)
                squares_um2 += quadratic_terms + constant - 2.0 * cross_terms
            out[part] = np.maximum(squares_um2, 0.0)
        return out

    def left_out(self) -> tuple[Floats, Floats]:
        """Errors of the marks left out, and log of the chance that a right one is missed by more.

        The errors are (n, 2) in um, the logs (n,).

        The vectors hold the mixture; the chances are those of the others alone. With the residual
        operator ``P`` the vector is ``(P_ii)**-1 (P y)_i`` and the chance ``(1 - q /
        rest)**(freedom / 2 - 1)``, the tail of a t distribution in the plane, where ``q = (P y)_i'
        (P_ii)**-1 (P y)_i``. A mark of a group is missed by its residual.
        """
        if len(self._all_pairs) > len(self._pairs):
            plane, kernels, bends = self.mean()
            scaled_points = (self._all_pairs.moving - self.middle) / self.size
            squares = squared_distances(scaled_points, self.nodes)
            images = _plane_rows(scaled_points) @ plane
            for kernel, bend in zip(kernels, bends, strict=True):
                images += covariance(kernel, squares) @ bend
            errors = self._all_pairs.fixed - images
            misfit = np.einsum("ni,nij,nj->n", errors, self._all_pairs.information, errors)
            return errors, -0.5 * (misfit / self.mark_variance)
        n = len(self._pairs)
        tail_exponent = 0.5 * self.freedom - 1.0
        errors = np.zeros((n, 2))
        log_shares = list[Floats]()
        log_chances = list[Floats]()
        for k, kernel_fit in self._kernel_fits.items():
            fit_errors, determinants, misfit_shares = self._missed(kernel_fit)
            errors += np.einsum("ag,agni->ni", self.mixture[k], fit_errors)
            rest_shares = 1.0 - misfit_shares / kernel_fit.misfit[..., None]
            log_tail = tail_exponent * np.log(np.clip(rest_shares, 1e-14, 1.0))
            with np.errstate(divide="ignore"):
                prior = np.log(self.mixture[k] * kernel_fit.misfit)[..., None]
            log_share = prior - 0.5 * np.log(determinants) - log_tail
            log_shares.append(log_share.reshape(-1, n))
            log_chances.append(log_tail.reshape(-1, n))
        log_chance = np.zeros(n)
        if tail_exponent > 0:
            log_weights = np.concatenate(log_shares)
            log_weights = np.where(are_known(errors), log_weights, 0.0)
            log_sum = _log_sum(log_weights + np.concatenate(log_chances))
            log_chance = np.nan_to_num(log_sum - _log_sum(log_weights))
        return solved(self._whitening, errors), log_chance

    def _missed(self, kernel_fit: _KernelFit) -> tuple[Floats, Floats, Floats]:
        """Errors of the marks left out, determinants of ``P_ii``, and ``q``.

        Their shapes are (a, g, n, 2), (a, g, n) and (a, g, n).

        ``P`` is the operator that takes the whitened marks to the residuals; ``P_ii`` is its 2 x 2
        block of a mark, NaN where the others leave a parameter free, and ``q`` the misfit that goes
        with the mark.
        """
        n = len(self._pairs)
        rows = kernel_fit.eigenvectors.reshape(n, 2, -1)
        residuals = self._scaled_residuals(kernel_fit) @ kernel_fit.eigenvectors.T
        residuals = residuals.reshape(*kernel_fit.misfit.shape, n, 2)
        blocks: list[Floats] = []
        # So many marks at once that their blocks fit into the memory.
        step = max(1, 16 * _AT_ONCE // (n * _FIELD.size))
        for start in range(0, n, step):
            mark_rows = rows[start : start + step]
            weighted = mark_rows * kernel_fit.shrinkage[:, None, None]  # (g, marks, 2, 2n)
            projected = weighted @ kernel_fit.design
            coefficient_cov = kernel_fit.coefficient_cov[:, :, None]
            explained = projected @ coefficient_cov @ projected.swapaxes(2, 3)
            blocks.append(weighted @ mark_rows.swapaxes(1, 2) - explained)
        blocks_of_p = np.concatenate(blocks, axis=2)
        xx, xy = np.moveaxis(blocks_of_p[..., 0, :], -1, 0)
        yy = blocks_of_p[..., 1, 1]
        determinants = xx * yy - xy**2
        # Without this mark the others leave the similarity free.
        is_undetermined = determinants < COINCIDENT**2 * (xx + yy) ** 2
        blocks_of_p[is_undetermined] = np.nan
        determinants[is_undetermined] = np.nan
        inverses = inverse_of(blocks_of_p).reshape(blocks_of_p.shape)
        errors = (inverses @ residuals[..., None])[..., 0]
        return errors, determinants, np.sum(residuals * errors, axis=-1)


def _plane_rows(scaled_points: Floats) -> Floats:
    """Rows ``(1, x, y)`` (k, 3) of scaled points."""
    return np.column_stack([np.ones(len(scaled_points)), scaled_points])


def _groups(places: Floats, most: int) -> Ints:
    """Give the number of the group of each place (n, 2).

    Groups are halves of halves along their longer side, at most ``most``.
    """
    if len(places) <= most:
        return np.arange(len(places))
    group = np.zeros(len(places), dtype=np.intp)
    parts = [np.arange(len(places))]
    while 2 * len(parts) <= most:
        halves: list[Ints] = []
        for part in parts:
            axis = np.argmax(np.ptp(places[part], axis=0))
            order = np.argsort(places[part, axis], kind="stable")
            halves += np.split(part[order], [part.size // 2])
        parts = halves
    for number, part in enumerate(parts):
        group[part] = number
    return group


def _grouped_pairs(pairs: Pairs, group: Ints) -> Pairs:
    """Give one pair for each group: the mean place on either side, and its information.

    Any affine map keeps the mean place. Pairs of which each is a group by itself stay as they are.
    """
    group_count = int(group.max()) + 1
    if group_count == len(pairs):
        return pairs
    weights = pairs.weights
    share = weights / np.bincount(group, weights)[group]
    moving = np.zeros((group_count, 2))
    fixed = np.zeros((group_count, 2))
    covariances = np.zeros((group_count, 2, 2))
    mean_covariances = inverse_of(pairs.information) * (share**2)[:, None, None]
    np.add.at(moving, group, share[:, None] * pairs.moving)
    np.add.at(fixed, group, share[:, None] * pairs.fixed)
    np.add.at(covariances, group, mean_covariances)
    return Pairs(moving=moving, fixed=fixed, information=inverse_of(covariances))


def _log_sum(logs: Floats) -> Floats:
    """Logarithm of the sum along the first axis of what has these logarithms."""
    top = logs.max(axis=0)
    shares = np.exp(logs - top)
    return top + np.log(np.sum(shares, axis=0))


def _log_prior(ratios: Floats) -> Floats:
    """Logarithm of the probability of each ratio before the marks are seen: one half of none."""
    share = 0.5 / (len(ratios) - 1)
    return np.log(np.where(ratios > 0, share, 0.5))


def _shares(logs: Floats) -> Floats:
    """Give probabilities (kernels, affine ratios, field ratios) from logarithms.

    Unlikely kernels get none.
    """
    shares = np.exp(logs - logs.max())
    kernel_shares = shares.sum(axis=(1, 2))
    shares[kernel_shares < _LEAST * shares.sum()] = 0.0
    return shares / shares.sum()
