"""Formation number: how uneven a sheet is, over a random sheet of the same fibres.

In a random sheet the middles of straight fibres form a Poisson process and their directions are
uniform (Deng and Dodson 1994). Its variance at any scale follows from the length, width and
coarseness of the fibres, and the grammage.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import fft

from planish.analyze.distributions import variance_interval
from planish.core.area import area_mean, square_px
from planish.core.errors import CannotMeasure
from planish.core.facts import NULL, DescribedModel, Interval, Value
from planish.core.typing import Array, Floats, Ints, Pair, Shape2D, pair_of

_DIRECTIONS = 2048  # of a fibre: its peak over directions is as narrow as a wave over its length
_PARTS = 8  # of a cell, for the covariance of the means over cells
_LEAST_CELLS = 9


class RandomSheet(DescribedModel):
    """A random sheet of fibres that are all alike."""

    length_mm: float
    """Length of a fibre."""
    width_um: float
    """Width of a fibre."""
    coarseness_mg_m: float
    """Mass of a fibre over its length."""
    grammage_g_m2: float
    """Mean mass of the sheet over its area."""

    @property
    def point_cov2(self) -> float:
        """Squared coefficient of variation of its local grammage at single points."""
        return 1000.0 * self.coarseness_mg_m / (self.width_um * self.grammage_g_m2)

    def density(self, per_um: Floats) -> Floats:
        """Spectral density of grammage over its mean, um2, at frequencies (waves a um).

        That of one fibre, a rectangle whose transform is a product of two sincs, averaged over all
        directions of a quarter turn, which stand for the others.
        """
        length_um = 1000.0 * self.length_mm
        width_um = self.width_um
        step = 0.5 * math.pi / _DIRECTIONS
        angles = (np.arange(_DIRECTIONS) + 0.5) * step
        shares = np.empty(per_um.shape)
        for k, frequency in enumerate(per_um):
            along = np.sinc(length_um * frequency * np.cos(angles))
            across = np.sinc(width_um * frequency * np.sin(angles))
            shares[k] = np.mean(np.square(along * across))
        return self.point_cov2 * length_um * width_um * shares

    def cov_of(self, low_um: float, high_um: float) -> float:
        """Coefficient of variation in waves between two lengths."""
        per_um = np.linspace(1 / high_um, 1 / low_um, 65)
        ring = 2 * math.pi * per_um * self.density(per_um)
        return math.sqrt(np.trapezoid(ring, per_um))

    def cell_covariances(self, shape: Shape2D, cell_um: float) -> Floats:
        """Covariance of means over square cells, over the squared mean, by wrapped lag in cells.

        ``shape``: lags along y and x, twice those of the field. It is the inverse Fourier transform
        of the spectral density over a plane of parts of a cell, which is two fibres long at least,
        so that no fibre meets itself around the border. The density depends on the frequency alone
        and is read off a table of 800 frequencies and 0.
        """
        least = 2 * math.ceil(1000.0 * self.length_mm / cell_um)
        size = [_PARTS * fft.next_fast_len(max(count, least)) for count in shape]
        step_um = cell_um / _PARTS
        along_y = fft.fftfreq(size[0], step_um)
        along_x = fft.rfftfreq(size[1], step_um)
        radius = np.hypot(along_y[:, None], along_x)
        above_0 = np.geomspace(0.02 * radius[0, 1], radius.max() * 1.001, 800)
        table = np.concatenate([[0.0], above_0])
        density = np.interp(radius, table, self.density(table))
        of_cell = np.outer(np.sinc(along_y * cell_um), np.sinc(along_x * cell_um))
        density *= np.square(of_cell)
        covariance = fft.irfft2(density, size) / step_um**2
        lags: list[Ints] = []
        for n in shape:
            half = n // 2
            lags_of_axis = fft.ifftshift(np.arange(-half, n - half))
            lags.append(lags_of_axis * _PARTS)
        return covariance[np.ix_(*lags)]


class Formation(DescribedModel):
    """Formation number of a map over cells of one size, and the random sheet it is over."""

    number: Value
    """cov over that of the random sheet, over the same cells."""
    interval: Interval = NULL
    """Its 95 % interval."""
    cell_um: float
    """Edge of a cell."""
    n: int
    """Cells that are known."""
    cov: Value
    """Of the means over cells, without noise."""
    random_cov: Value
    """Of the random sheet, over the same cells."""
    sheet: RandomSheet
    """The random sheet."""


def formation_number(
    values: Array,
    *,
    pixel_um: Pair,
    sheet: RandomSheet,
    cell_um: float = 1000.0,
    half_difference: Array | None = None,
) -> Formation:
    """Coefficient of variation of means over cells, over that of a random sheet.

    Parameters
    ----------
    values : ndarray, shape (rows, cols)
        Grammage, or thickness of a sheet of even density; NaN is missing.
    pixel_um : (float, float), along y and x
    sheet : RandomSheet
    cell_um : float; edge of a cell
    half_difference : ndarray, shape (rows, cols)
        Half the difference of two half measurements, whose variance is noise.

    Returns
    -------
    Formation

    Raises
    ------
    CannotMeasure
        If fewer than 9 cells are known, or the mean is not above 0.

    Notes
    -----
    Both variances are those of the cells of this field about their own mean: waves longer than the
    field count in neither. The interval is that of a random sheet, and scales with the number.

    References
    ----------
    Deng and Dodson (1994), Paper: An Engineered Stochastic Structure, TAPPI Press. Dodson (1971),
    J. R. Stat. Soc. B 33, 88, doi:10.1111/j.2517-6161.1971.tb00859.x.
    """
    factor = square_px(cell_um, pixel_um)
    is_cell = min(factor) >= 1 and np.greater_equal(values.shape, factor).all()
    cells = area_mean(values, factor) if is_cell else np.empty((0, 0))
    is_known = np.isfinite(cells)
    n = int(np.count_nonzero(is_known))
    if n < _LEAST_CELLS:
        raise CannotMeasure(
            f"{n} cells of {cell_um:g} um are known; a formation number needs {_LEAST_CELLS}. Give"
            " a larger field, or smaller cells (`formation_cell_um`)."
        )
    mean = cells[is_known].mean()
    if not mean > 0:
        raise CannotMeasure("The mean of the map is not above 0: it has no formation number.")
    variance = cells[is_known].var(ddof=1)
    if half_difference is not None:
        noise = area_mean(half_difference, factor)
        variance -= np.nanvar(noise[is_known], ddof=1)
    expected, degrees = _variance_of_cells(is_known, sheet, cell_um)
    cov = math.sqrt(max(variance, 0.0)) / mean
    random_cov = math.sqrt(expected)
    number = cov / random_cov
    limits = np.sqrt(variance_interval(number**2, degrees))
    return Formation(
        number=number,
        interval=pair_of(limits),
        cell_um=cell_um,
        n=n,
        cov=cov,
        random_cov=random_cov,
        sheet=sheet,
    )


def _variance_of_cells(is_known: Any, sheet: RandomSheet, cell_um: float) -> Pair:
    """Expected variance of the known cells about their mean, and its degrees of freedom.

    Of a random sheet, over its squared mean; ``is_known`` (rows, cols) are cells of the field. The
    degrees of freedom are Satterthwaite's: twice the squared expectation over the variance, both of
    a sum of squares of Gaussian values, which follow from the covariances of all pairs of cells.
    """
    rows, cols = is_known.shape
    shape = (2 * rows, 2 * cols)
    covariance = sheet.cell_covariances(shape, cell_um)
    mask = fft.rfft2(is_known.astype(np.float64), shape)
    pairs = fft.irfft2(np.abs(mask) ** 2, shape)
    padded_sums = fft.irfft2(fft.rfft2(covariance) * mask, shape)
    n = int(np.count_nonzero(is_known))
    of_cells = padded_sums[:rows, :cols][is_known]  # sum of the covariances of each with all
    total = of_cells.sum()
    centred = n * covariance[0, 0] - total / n
    trace = np.sum(pairs * covariance**2)
    trace -= 2.0 / n * np.sum(of_cells**2)
    trace += total**2 / n**2
    return centred / (n - 1), centred**2 / trace
