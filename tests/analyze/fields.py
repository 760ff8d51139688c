"""Random maps of known covariance."""

import numpy as np
import xarray as xr
from scipy import fft, ndimage

from planish.analyze import CorrelateParams, correlation_evidence
from planish.core.grid import Grid
from planish.texture import covariance
from planish.texture.ncc import MaskedNcc


def gaussian_maps(rng, shape, length, *, kind="exp"):
    """Two unrelated maps of variance 1 whose correlation is exp(-h / length), or exp(-(h /
    length)²), by embedding.

    ``rng`` may be a seed; ``length`` is in pixels, one number or two: along rows and columns.
    """
    rng = np.random.default_rng(rng)
    down, across = length if np.ndim(length) else (length, length)
    size = [fft.next_fast_len(2 * n) for n in shape]
    lags = [np.abs(fft.fftfreq(n, 1 / n)) for n in size]
    h = np.hypot(lags[0][:, None] / down, lags[1] / across)
    power = np.maximum(fft.fft2(np.exp(-h) if kind == "exp" else np.exp(-h * h)).real, 0.0)
    noise = rng.normal(size=size) + 1j * rng.normal(size=size)
    both = fft.fft2(np.sqrt(power / power.size) * noise)[: shape[0], : shape[1]]
    return both.real.copy(), both.imag.copy()


def related_maps(rng, shape, length, r, *, noise=None, kind="exp"):
    """Two maps whose correlation is r; what b does not share with a has the length ``noise`` where
    given."""
    rng = np.random.default_rng(rng)
    a, rest = gaussian_maps(rng, shape, length, kind=kind)
    if noise is not None:
        rest = gaussian_maps(rng, shape, noise, kind=kind)[0]
    return a, r * a + np.sqrt(1 - r * r) * rest


def exact_n_eff(shape, length, *, known=None, kind="exp"):
    """Dutilleul's number for two maps of this covariance, by the whole matrix of all points."""
    down, across = length if np.ndim(length) else (length, length)
    known = np.ones(shape, bool) if known is None else known
    at = np.argwhere(known) / (down, across)
    h = np.hypot(*(at[:, None, k] - at[:, k] for k in (0, 1)))
    matrix = np.exp(-h) if kind == "exp" else np.exp(-h * h)
    matrix = matrix - matrix.mean(axis=0) - matrix.mean(axis=1)[:, None] + matrix.mean()
    return 1 + np.trace(matrix) ** 2 / np.sum(matrix * matrix)


def texture(shape, sigma, rng):
    """A periodic field of standard deviation 1, smoothed by a Gaussian; ``rng`` may be a seed."""
    field = ndimage.gaussian_filter(
        np.random.default_rng(rng).standard_normal(shape), sigma, mode="wrap"
    )
    return field / field.std()


def compared(
    maps, lags, *, a=("sheet", "coating_top"), b=("image", "image"), units=("um", "1"), **more
):
    """Two maps as ``correlation_diagnostics`` hands them to its questions."""
    grid = Grid.regular(lags.is_valid.shape, lags.pixel_um)
    layers = tuple(
        xr.Dataset({name: (("y", "x"), m)}) for (_, name), m in zip((a, b), maps, strict=True)
    )
    options = {"params": CorrelateParams(), "layers": layers, "grid": grid} | more
    return correlation_evidence.ComparedMaps(
        a=a, b=b, units=units, x=maps[0], y=maps[1], lags=lags, **options
    )


def lags_of(values, cell_um):
    """Lags of the cells of a map that are known."""
    return covariance.Lags(np.isfinite(values), cell_um)


def by_shift(b, reach, *, sign=0):
    """Tune by the whole shift, up to so many pixels, at which r with map b is largest; ``|r|`` for
    sign 0."""
    is_known = np.isfinite(b)

    def tune(a, look):
        use = look & np.isfinite(a)
        ncc = MaskedNcc(np.where(use, a, 0.0), a_valid=use, b_valid=is_known, reach=(reach, reach))
        r = np.nan_to_num(ncc(np.where(is_known, b, 0.0)))
        row, col = np.unravel_index(np.argmax(sign * r if sign else np.abs(r)), r.shape)
        return ndimage.shift(b, (reach - row, reach - col), order=0, cval=np.nan)

    return tune
