"""One fit of one model to pairs whose weights are settled: parameters, covariance, errors of marks left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotRegister, MarkError
from planish.register.equations import factored
from planish.register.models import Frame, Model, Parametric
from planish.register.pairs import COINCIDENT, Pairs, as_complex, inverse_of

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Noise:
    """What the residuals say of the error of a mark.

    Attributes
    ----------
    variance : float
        Of one coordinate of a pair with information 1; NaN where nothing is left over to tell.
    covariance : ndarray, shape (p, p)
        Of the parameters, scaled by the frame.
    frame : tuple
        Middle and size of the marks, in um.
    """

    variance: float
    covariance: Floats
    frame: Frame


def noise_of(pairs: Pairs, transform: Parametric, model: Model, robust: Floats) -> Noise:
    """Variance of the marks and covariance of the parameters.

    Parameters
    ----------
    pairs : Pairs
        The pairs with the weights of the fit, ``robust`` included.
    robust : ndarray, shape (n,)
        The part of the weights that does not speak of a mark's variance: 1, or less for a mark in doubt.

    Notes
    -----
    A mark in doubt was weighted down without being less precise: the covariance is ``A**-1 B A**-1`` with
    ``A = sum(r D' W D)`` and ``B = sum(r**2 D' W D)``; without doubt ``A**-1``. Degrees of freedom: ``2 sum(r) - p``.
    """
    used = pairs.weights > 0
    some, share = pairs.take(used), robust[used]
    frame = some.frame()
    whitening = some.whitening()
    q, r = factored(whitening, model.design(transform, frame, some.moving), model.name)
    error = whitening @ (some.fixed - transform(some.moving))[..., None]
    freedom = 2.0 * float(np.sum(share)) - model.parameters
    enough = freedom > 1e-9 and np.count_nonzero(used) > 2
    variance = float(np.sum(error**2)) / freedom if enough else float("nan")
    half = np.linalg.solve(r, (np.sqrt(np.repeat(share, 2))[:, None] * q).T)
    return Noise(variance=variance, covariance=variance * (half @ half.T), frame=frame)


def leave_one_out(pairs: Pairs, transform: Parametric, model: Model) -> Floats:
    """Vector by which the fit to all other marks misses each mark, shape (n, 2), in um; NaN where they fix nothing.

    Notes
    -----
    Linear models: ``(I - H)**-1 e`` with the mark's 2 x 2 block of the hat matrix. Rigid with equal weights of both
    axes: the closed form from sums without the mark. Otherwise a fit without each mark. Weights stay as they are.
    """
    used = pairs.weights > 0
    missed = pairs.fixed - transform(pairs.moving)
    some = pairs.take(used)
    if np.count_nonzero(used) <= model.least:
        missed[used] = np.nan
    elif model.linear:
        missed[used] = _by_leverage(some, transform, model)
    elif model.name == "rigid" and some.isotropic:
        missed[used] = _rigid(some, transform.mirrored)
    else:
        missed[used] = _by_refit(some, transform, model)
    return missed


def _by_leverage(pairs: Pairs, transform: Parametric, model: Model) -> Floats:
    whitening = pairs.whitening()
    q, _ = factored(whitening, model.design(transform, pairs.frame(), pairs.moving), model.name)
    blocks = q.reshape(len(pairs), 2, -1)
    left = np.eye(2) - blocks @ blocks.swapaxes(1, 2)
    # Leverage 1: without this mark the others leave a parameter free.
    lonely = np.linalg.eigvalsh(left)[:, 0] < COINCIDENT
    left[lonely] = np.nan
    error = whitening @ (pairs.fixed - transform(pairs.moving))[..., None]
    return np.asarray(np.linalg.solve(whitening, inverse_of(left) @ error)[..., 0], dtype=np.float64)


def _rigid(pairs: Pairs, mirrored: bool) -> Floats:
    """Sums without mark i follow from the full sums of centred points, so all refits are done at once."""
    share = pairs.weights
    z, w = as_complex(pairs.moving, mirrored), as_complex(pairs.fixed, False)
    total = np.sum(share)
    zc, wc = z - share @ z / total, w - share @ w / total
    with np.errstate(divide="ignore", invalid="ignore"):
        rest = total - share
        z_rest, w_rest = -share * zc / rest, -share * wc / rest
        product = np.sum(share * zc.conj() * wc) - share * zc.conj() * wc - rest * z_rest.conj() * w_rest
        missed = (wc - w_rest) - product / np.abs(product) * (zc - z_rest)
    spread = np.sum(share * np.abs(zc) ** 2)
    lonely = np.abs(product) < COINCIDENT * spread
    return np.where(lonely[:, None], np.nan, np.stack([missed.real, missed.imag], axis=-1))


def _by_refit(pairs: Pairs, transform: Parametric, model: Model) -> Floats:
    missed = np.full((len(pairs), 2), np.nan)
    everyone = np.arange(len(pairs))
    for k in everyone:
        try:
            without = model.fit(pairs.take(everyone != k), transform.mirrored, transform)
        except (CannotRegister, MarkError):
            continue
        missed[k] = pairs.fixed[k] - without(pairs.moving[k])
    return missed


def standardised(pairs: Pairs, transform: Parametric, model: Model, core: NDArray[np.bool_]) -> Floats:
    """Squared length of each mark's error over its expectation for variance 1: 2 on average; shape (n,).

    ``core`` says which marks the transformation was fitted to: their errors are too small by ``1 - H``, those of the
    others too large by ``1 + H``.
    """
    whitening = pairs.whitening()
    rows = whitening @ model.design(transform, pairs.take(core).frame(), pairs.moving)
    _, r = np.linalg.qr(rows[core].reshape(-1, model.parameters))
    blocks = np.linalg.solve(r.T, rows.reshape(-1, model.parameters).T).T.reshape(len(pairs), 2, -1)
    hat = blocks @ blocks.swapaxes(1, 2)
    spread = np.eye(2) + np.where(core, -1.0, 1.0)[:, None, None] * hat
    error = whitening @ (pairs.fixed - transform(pairs.moving))[..., None]
    bound = np.linalg.eigvalsh(spread)[:, 0] < 1e-9
    spread[bound] = np.eye(2)
    # A mark that the fit goes through whatever its error says nothing about it.
    return np.where(bound, 0.0, (error.swapaxes(1, 2) @ inverse_of(spread) @ error)[:, 0, 0])
