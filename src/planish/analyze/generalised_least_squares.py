"""Least squares that weigh cells by the covariance of the residuals, which is never written out.

A product with the covariance of a stationary field is a convolution (FFT), and its inverse is
applied by conjugate gradients: memory grows with the cells, not with their square.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.sparse import linalg

from planish.core.errors import CannotMeasure
from planish.core.typing import Bools, Floats, Pair
from planish.texture.spectra import padded_shape, wrapped_lags_um

_ACCURACY = 1e-12
_MOST_STEPS = 2000
_LEAST_POWER = 1e-6  # of the largest: the preconditioner divides by no less


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExponentialCovariance:
    """Covariance that falls exponentially with the distance, and a nugget at distance 0."""

    shared: float  # variance that neighbours share
    nugget: float  # variance that they do not
    range_um: float  # distance at which the shared covariance has fallen to 1/e

    def __call__(self, distance_um: Floats) -> Floats:
        """Covariance at some distances."""
        return self.shared * np.exp(-distance_um / self.range_um) + self.nugget * (distance_um == 0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WeighedRegression:
    """Generalised least squares of a response on k predictors and a constant."""

    plain: Floats  # (k,)
    standard_errors: Floats  # (k,), with the variance of the residuals as they are


def weighed_regression(
    response: Floats,
    predictors: Sequence[Floats],
    is_valid: Bools,
    pixel_um: Pair,
    covariance: ExponentialCovariance,
) -> WeighedRegression:
    """Explain a response by predictors with the weights that a covariance of residuals gives.

    Response and each of the k predictors are maps (rows, cols) with values where ``is_valid``, in
    pixels of ``pixel_um`` along y and x; a constant is fitted with them.

    Raises
    ------
    CannotMeasure
        If conjugate gradients do not converge.

    References
    ----------
    Aitken (1936), Proc. Roy. Soc. Edinb. 55, 42, doi:10.1017/S0370164600014346.
    """
    solve = _Inverse(is_valid, pixel_um, covariance)
    columns = [m[is_valid] for m in predictors]
    values = np.stack(columns, axis=1)
    spread = values.std(axis=0)
    n, k = values.shape
    # Standardised, so that conjugate gradients meet numbers of one size.
    standardised = (values - values.mean(axis=0)) / spread
    x = np.concatenate([np.ones((n, 1)), standardised], axis=1)
    y = response[is_valid]
    weighed = np.stack([solve(column) for column in x.T], axis=1)
    inverse = np.linalg.inv(x.T @ weighed)
    coefficients = inverse @ (weighed.T @ y)
    residuals = y - x @ coefficients
    squares = residuals @ solve(residuals)
    variance = squares / (n - k - 1)
    errors = np.sqrt(variance * np.diag(inverse))
    # The constant stands first.
    plain = coefficients[1:] / spread
    return WeighedRegression(plain=plain, standard_errors=errors[1:] / spread)


class _Inverse:
    """Inverse of the covariance of the cells of a mask, as it acts on values there."""

    def __init__(self, is_valid: Bools, pixel_um: Pair, covariance: ExponentialCovariance) -> None:
        self._is_valid = is_valid
        # Padded by the field itself: no cell meets another one around the border.
        size = padded_shape(is_valid.shape, is_valid.shape)
        y_um, x_um = wrapped_lags_um(size, pixel_um)
        distance_um = np.hypot(y_um[:, None], x_um)
        power = np.asarray(fft.rfft2(covariance(distance_um))).real
        self._product = self._convolution(power, size)
        least = _LEAST_POWER * power.max()
        inverse_power = 1 / np.maximum(power, least)
        self._guess = self._convolution(inverse_power, size)

    def __call__(self, values: Floats) -> Floats:
        """Apply the inverse; CannotMeasure where it is not found."""
        solution, fault = linalg.cg(
            self._product, values, rtol=_ACCURACY, maxiter=_MOST_STEPS, M=self._guess
        )
        if fault:
            raise CannotMeasure(
                f"Generalised least squares did not converge in {_MOST_STEPS} steps: the"
                " residuals are too smooth for the cells. Give larger cells."
            )
        return np.asarray(solution)

    def _convolution(self, power: Floats, size: Sequence[int]) -> linalg.LinearOperator:
        """A convolution of values on the mask, by its Fourier transform."""
        is_valid = self._is_valid
        rows, cols = is_valid.shape
        n = int(np.count_nonzero(is_valid))

        def convolve(values: Floats) -> Floats:
            placed = np.zeros(size)
            placed[:rows, :cols][is_valid] = np.ravel(values)
            spectrum = fft.rfft2(placed) * power
            product = np.asarray(fft.irfft2(spectrum, size))
            return product[:rows, :cols][is_valid]

        return linalg.LinearOperator((n, n), convolve, dtype=float)
