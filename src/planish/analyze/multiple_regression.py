"""Multiple regression on the cells of a field, whose errors know that cells are neighbours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planish.analyze.correlation import BANDWIDTH
from planish.analyze.distributions import student_tail, t_95
from planish.core.errors import CannotMeasure
from planish.core.typing import Bools, Floats, Pair
from planish.texture.covariance import Lags, PairCovariances

_MOST_BLOCKS = 10  # along an axis


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Regression:
    """Least squares of a response on k predictors over the cells of a mask."""

    plain: Floats  # (k,): response per unit of each predictor
    intercept: float
    standard_errors: Floats  # (k,), of ``plain``
    n_eff: Floats  # (k,): independent cells that would give these errors
    scale: Floats  # (k,): a standardised coefficient is the plain one times this
    vif: Floats  # (k,): variance inflation
    unique: Floats  # (k,): share of the response's variance that each alone explains
    r2: float
    freed: Floats  # (k, rows, cols): each predictor less what the others explain of it
    residuals: Floats  # (rows, cols), 0 outside of the mask

    @property
    def free(self) -> Floats:
        """Degrees of freedom of each coefficient."""
        return self.n_eff - self.plain.size - 1

    @property
    def standardised(self) -> Floats:
        """Standard deviations of the response per standard deviation of each predictor."""
        return self.plain * self.scale

    def interval(self, index: int, *, standardised: bool) -> Pair:
        """95 % interval of a coefficient; NaN without degrees of freedom."""
        free = float(self.free[index])
        if not free > 1:
            return math.nan, math.nan
        scale = float(self.scale[index]) if standardised else 1.0
        middle = float(self.plain[index]) * scale
        width = t_95(free) * float(self.standard_errors[index]) * scale
        return middle - width, middle + width

    def p(self, index: int) -> float:
        """Probability of such a coefficient where the true one is 0; NaN without freedom."""
        free = float(self.free[index])
        if not free > 1:
            return math.nan
        return 2 * student_tail(abs(self.plain[index] / self.standard_errors[index]), free)


def regress(
    response: Floats, predictors: Sequence[Floats], lags: Lags, errors: Floats | None = None
) -> Regression:
    """Explain a response by predictors, by least squares over the cells of a mask.

    Parameters
    ----------
    response, predictors : ndarray, shape (rows, cols)
        Known on the mask of ``lags``.
    lags : Lags; of the cells that count
    errors : ndarray, shape (k + 1, k + 1), optional
        Covariance of the errors of the predictors, and of the response as the last. It is taken off
        that of the maps, so that coefficients are those of maps without errors.

    Returns
    -------
    Regression

    Raises
    ------
    CannotMeasure
        If the errors are as large as what is left of a predictor beside the others.

    Notes
    -----
    The coefficient of a predictor is the mean of w times the response, w being what the other
    predictors do not explain of it, over its variance (Frisch and Waugh 1933). So its error is that
    of the mean of w times the residuals, whose variance follows from the covariances of both maps
    by lag, as that of r does (:func:`planish.correlate`): of unrelated maps after Dutilleul (1993),
    or after Bartlett where that is wider, widened where what single cells add (Conley 1999) is
    more than the covariances say. Residuals have n_eff - k - 1 degrees of freedom.

    References
    ----------
    Frisch and Waugh (1933), Econometrica 1, 387, doi:10.2307/1907330. Fuller (1987), Measurement
    Error Models, section 2.2, doi:10.1002/9780470316665.
    """
    is_valid, n = lags.is_valid, lags.n
    values = np.stack([m[is_valid] for m in predictors], axis=1)
    means, spread = values.mean(axis=0), values.std(axis=0)
    x = (values - means) / spread
    y_mean = float(response[is_valid].mean())
    y = response[is_valid] - y_mean
    covariance, with_response = x.T @ x / n, x.T @ y / n
    variance = float(y @ y) / n
    if errors is not None:
        covariance = covariance - errors[:-1, :-1] / np.outer(spread, spread)
        with_response = with_response - errors[:-1, -1] / spread
        variance -= float(errors[-1, -1])
    if variance <= 0 or np.linalg.eigvalsh(covariance)[0] <= 0:
        raise CannotMeasure(
            "The stated errors are as large as what varies in the maps themselves: no correction"
            " for them is known. Give larger cells, which average errors, or leave the correction"
            " out."
        )
    inverse = np.linalg.inv(covariance)
    scaled = inverse @ with_response
    residuals = _on_mask(y - x @ scaled, is_valid)
    weights = x @ inverse
    k = scaled.size
    n_eff, standard_errors = np.empty(k), np.empty(k)
    for index in range(k):
        weight = _on_mask(weights[:, index], is_valid)
        n_eff[index] = _independent_cells(weight, residuals, lags)
        product = float(np.mean(weights[:, index] ** 2)) * float(np.mean(residuals[is_valid] ** 2))
        free = n_eff[index] - k - 1
        standard_errors[index] = math.sqrt(product / free) if free > 0 else math.nan
    plain = scaled / spread
    own_share = 1.0 / np.diag(inverse)
    return Regression(
        plain=plain,
        intercept=y_mean - float(means @ plain),
        standard_errors=standard_errors / spread,
        n_eff=n_eff,
        scale=spread * np.sqrt(np.diag(covariance) / variance),
        vif=np.diag(covariance) / own_share,
        unique=scaled**2 * own_share / variance,
        r2=float(scaled @ with_response) / variance,
        freed=np.stack(
            [
                _on_mask(w * s * v, is_valid)
                for w, s, v in zip(weights.T, own_share, spread, strict=True)
            ]
        ),
        residuals=residuals,
    )


def _independent_cells(weight: Floats, residuals: Floats, lags: Lags) -> float:
    """Independent cells of the mean of a product of two maps, at most as many as there are."""
    pair = PairCovariances(weight, residuals, lags)
    variance = pair.variance_of_r()
    if not variance > 0:
        return math.nan
    sides = [count * size for count, size in zip(lags.is_valid.shape, lags.pixel_um, strict=True)]
    unevenness = max(pair.spatial_error(0.0, BANDWIDTH * min(sides))[1], 1.0)
    variance = max(variance, unevenness**2 * pair.variance_of_z(0.0))
    return min(1 + 1 / variance, float(lags.n))


def _on_mask(values: Floats, is_valid: Bools) -> Floats:
    placed = np.zeros(is_valid.shape)
    placed[is_valid] = values
    return placed


def out_of_sample_r2(
    response: Floats, predictors: Sequence[Floats], lags: Lags, *, block_um: float
) -> float:
    """Share of the variance that a model explains of places that it was not fitted to.

    Each block of the field is predicted by the model of all others, and compared with their mean.
    NaN where the field holds less than 2 x 2 blocks of that width.
    """
    is_valid = lags.is_valid
    block_numbers = np.zeros(is_valid.shape, dtype=np.intp)
    for axis, (count, size_um) in enumerate(zip(is_valid.shape, lags.pixel_um, strict=True)):
        blocks = min(int(count * size_um / block_um), _MOST_BLOCKS)
        if blocks < 2:
            return math.nan
        numbers = np.arange(count) * blocks // count
        block_numbers = block_numbers * blocks + np.expand_dims(numbers, 1 - axis)
    block_of_cell = block_numbers[is_valid]
    x = np.stack([np.ones(lags.n), *(m[is_valid] for m in predictors)], axis=1)
    x[:, 1:] = (x[:, 1:] - x[:, 1:].mean(axis=0)) / x[:, 1:].std(axis=0)
    y = response[is_valid] - response[is_valid].mean()
    squares, products = x.T @ x, x.T @ y
    unexplained = variation = 0.0
    for block in np.unique(block_of_cell):
        is_inside = block_of_cell == block
        x_inside, y_inside = x[is_inside], y[is_inside]
        squares_outside = squares - x_inside.T @ x_inside
        products_outside = products - x_inside.T @ y_inside
        coefficients = np.linalg.lstsq(squares_outside, products_outside, rcond=None)[0]
        mean_outside = products_outside[0] / squares_outside[0, 0]
        unexplained += float(np.sum((y_inside - x_inside @ coefficients) ** 2))
        variation += float(np.sum((y_inside - mean_outside) ** 2))
    return 1 - unexplained / variation
