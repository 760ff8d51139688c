"""Multiple regression on the cells of a field, whose errors know that cells are neighbours."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from planish.analyze.correlation import placed
from planish.analyze.distributions import around, t_95
from planish.core.errors import CannotMeasure
from planish.core.typing import Floats, Ints, Pair
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
    weights: Floats  # (k, rows, cols): a coefficient is the mean of its weight times the response
    own_variance: Floats  # (k,): of what the other predictors do not explain of each
    residuals: Floats  # (rows, cols), 0 outside of the mask
    lags: Lags

    @property
    def free(self) -> Floats:
        """Degrees of freedom of each coefficient; NaN where an interval has too few."""
        free = self.n_eff - self.plain.size - 1
        return np.where(free > 1, free, math.nan)

    @property
    def standardised(self) -> Floats:
        """Standard deviations of the response per standard deviation of each predictor."""
        return self.plain * self.scale

    @property
    def intervals(self) -> Floats:
        """95 % intervals of the plain coefficients, (k, 2)."""
        half_widths = special.stdtrit(self.free, 0.975) * self.standard_errors
        return np.stack([self.plain - half_widths, self.plain + half_widths], axis=1)

    @property
    def standardised_intervals(self) -> Floats:
        """Those of the standardised coefficients, (k, 2)."""
        return self.intervals * self.scale[:, None]

    @property
    def p(self) -> Floats:
        """Probability of such a coefficient where the true one is 0, (k,)."""
        t = self.plain / self.standard_errors
        return 2 * special.stdtr(self.free, -np.abs(t))

    @property
    def freed(self) -> Floats:
        """Each predictor less what the others explain of it, (k, rows, cols)."""
        return self.weights * self.own_variance[:, None, None]

    def difference_of_sizes(self, first: int, second: int) -> tuple[float, Pair]:
        """Size of a standardised coefficient less that of another one, and its 95 % interval.

        By their numbers. The difference of sizes is the mean of a weight of its own times the
        response, so its error is that of such a mean; NaN where too few cells are independent.
        """
        factors = np.sign(self.plain) * self.scale
        weights = factors[:, None, None] * self.weights
        error, n_eff = _error_of_mean(weights[first] - weights[second], self)
        sizes = np.abs(self.standardised)
        difference = sizes[first] - sizes[second]
        free = n_eff - self.plain.size - 1
        half_width = math.nan
        if free > 1:
            half_width = t_95(free) * error
        return difference, around(difference, half_width)


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

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> coating, base, noise = rng.normal(size=(3, 60, 80))
    >>> lags = Lags(np.ones((60, 80), dtype=bool), (10.0, 10.0))
    >>> fit = regress(2 * coating - base + 0.1 * noise, [coating, base], lags)
    >>> fit.plain.round(1).tolist(), round(fit.r2, 2)
    ([2.0, -1.0], 1.0)
    """
    is_valid = lags.is_valid
    n = lags.n
    values = np.stack([m[is_valid] for m in predictors], axis=1)
    means = values.mean(axis=0)
    spread = values.std(axis=0)
    x = (values - means) / spread
    y_mean = response[is_valid].mean()
    y = response[is_valid] - y_mean
    covariance = x.T @ x / n
    with_response = x.T @ y / n
    variance = y @ y / n
    if errors is not None:
        covariance = covariance - errors[:-1, :-1] / np.outer(spread, spread)
        with_response = with_response - errors[:-1, -1] / spread
        variance -= errors[-1, -1]
    if variance <= 0 or np.linalg.eigvalsh(covariance)[0] <= 0:
        raise CannotMeasure(
            "The stated errors are as large as what varies in the maps themselves: no correction"
            " for them is known. Give larger cells, which average errors, or leave the correction"
            " out."
        )
    inverse = np.linalg.inv(covariance)
    scaled = inverse @ with_response
    own_share = 1.0 / np.diag(inverse)
    variances = np.diag(covariance)
    plain = scaled / spread
    unknown = np.full(plain.size, math.nan)
    weights = (x @ inverse).T / spread[:, None]
    weight_maps = [placed(row, is_valid, 0.0) for row in weights]
    fit = Regression(
        plain=plain,
        intercept=y_mean - (means @ plain),
        standard_errors=unknown,
        n_eff=unknown,
        scale=spread * np.sqrt(variances / variance),
        vif=variances / own_share,
        unique=scaled**2 * own_share / variance,
        r2=float((scaled @ with_response) / variance),
        weights=np.stack(weight_maps),
        own_variance=own_share * spread**2,
        residuals=placed(y - x @ scaled, is_valid, 0.0),
        lags=lags,
    )
    of_coefficients = [_error_of_mean(weight, fit) for weight in fit.weights]
    standard_errors, n_eff = np.transpose(of_coefficients)
    return replace(fit, standard_errors=standard_errors, n_eff=n_eff)


def _error_of_mean(weight: Floats, fit: Regression) -> Pair:
    """Standard error of the mean of a weight times the residuals, and its independent cells."""
    is_valid = fit.lags.is_valid
    n_eff = _independent_cells(weight, fit.residuals, fit.lags)
    free = n_eff - fit.plain.size - 1
    if not free > 0:
        return math.nan, n_eff
    cells = [values[is_valid] for values in (weight, fit.residuals)]
    mean_squares = [np.mean(values**2) for values in cells]
    return math.sqrt(math.prod(mean_squares) / free), n_eff


def _independent_cells(weight: Floats, residuals: Floats, lags: Lags) -> float:
    """Independent cells of the mean of a product of two maps, at most as many as there are."""
    pair = PairCovariances(weight, residuals, lags)
    variance = pair.variance_of_r()
    if not variance > 0:
        return math.nan
    of_cells = pair.unevenness(0.0) ** 2 * pair.variance_of_z(0.0)
    variance = max(variance, of_cells)
    return min(1 + 1 / variance, float(lags.n))


def out_of_sample_r2(
    response: Floats, predictors: Sequence[Floats], lags: Lags, *, block_um: float
) -> float:
    """Share of the variance that a model explains of places that it was not fitted to.

    Each block of the field is predicted by the model of all others, and compared with their mean.
    NaN where the field holds less than 2 x 2 blocks of that width.
    """
    is_valid = lags.is_valid
    numbers: list[Ints] = []  # of the block of every row, and of every column
    for count, size_um in zip(is_valid.shape, lags.pixel_um, strict=True):
        blocks = min(int(count * size_um / block_um), _MOST_BLOCKS)
        if blocks < 2:
            return math.nan
        numbers.append(np.arange(count) * blocks // count)
    block_numbers = np.add.outer(numbers[0] * _MOST_BLOCKS, numbers[1])
    block_of_cell = block_numbers[is_valid]
    columns = [m[is_valid] for m in predictors]
    x = np.stack([np.ones(lags.n), *columns], axis=1)
    y = response[is_valid]
    unexplained = variation = 0.0
    for block in np.unique(block_of_cell):
        is_inside = block_of_cell == block
        fitted_y = y[~is_inside]
        coefficients = np.linalg.lstsq(x[~is_inside], fitted_y, rcond=None)[0]
        y_of_block = y[is_inside]
        residuals = y_of_block - x[is_inside] @ coefficients
        unexplained += np.sum(residuals**2)
        variation += np.sum((y_of_block - fitted_y.mean()) ** 2)
    return 1 - unexplained / variation
