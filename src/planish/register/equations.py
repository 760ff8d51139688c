"""Weighted least squares for both coordinates at once, and arrangements of marks that leave something free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotRegister
from planish.register.pairs import Pairs

Floats = NDArray[np.float64]

# Marks whose spread across a line is below this share of that along it fix nothing across it.
_LINE = 0.01
# Condition number of the scaled equations beyond which marks do not fix the parameters.
_RANK = 1e-8


def solved(whitening: Floats, design: Floats, target: Floats, name: str) -> Floats:
    """Weighted least squares by QR: parameters (p,) from design (n, 2, p) and target (n, 2).

    Raises
    ------
    CannotRegister
        If the marks leave a parameter free.
    """
    q, r = factored(whitening, design, name)
    found = np.linalg.solve(r, q.T @ (whitening @ target[..., None]).reshape(-1))
    return np.asarray(found, dtype=np.float64)


def factored(whitening: Floats, design: Floats, name: str) -> tuple[Floats, Floats]:
    """Return the QR factors of the whitened design, (2n, p) and (p, p); refuse equations that leave something free."""
    rows = (whitening @ design).reshape(-1, design.shape[-1])
    q, r = np.linalg.qr(rows)
    sizes = np.linalg.svd(r / np.maximum(np.linalg.norm(r, axis=0), 1e-300), compute_uv=False)
    if len(rows) < design.shape[-1] or not sizes[-1] > _RANK * sizes[0]:
        raise CannotRegister(
            f"The marks do not fix one {name} transformation: their arrangement leaves at least one parameter free. "
            "Add marks away from the lines that the others lie on, or choose a model with fewer parameters."
        )
    return q, r


def refuse_line(pairs: Pairs, name: str) -> None:
    """Refuse marks that lie on one line."""
    share = pairs.weights / np.sum(pairs.weights)
    for side, points in (("moving", pairs.moving), ("fixed", pairs.fixed)):
        away = np.sqrt(share)[:, None] * (points - share @ points)
        long, across = np.linalg.svd(away, compute_uv=False)[:2]
        if across < _LINE * long:
            raise CannotRegister(
                f"The {side} marks lie on one line (they spread {long:.4g} um rms along it and {across:.2g} um across "
                f"it); a model of type {name} needs marks away from it. Add some, or fit a similarity."
            )
