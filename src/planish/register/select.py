"""Which model the marks support: rigid, similarity, affine, projective or thin-plate spline.

A model with more parameters is taken only where marks that are left out are missed by over 10 % less for every model
passed, and where the fall of the residuals is more than chance gives once in a hundred times (F test). The first alone
would follow noise with few marks; a model that helps nothing, as the scale of a sheet that only sheared, may be passed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planish.core.errors import CannotRegister, MarkError
from planish.register.model import Floats
from planish.register.models import MODELS
from planish.register.pairs import Pairs, weighted_rms
from planish.register.strain import strain_of

_GAIN = 0.9
_CHANCE = 0.01
# A spline that goes through its marks leaves no residuals to test: it has to halve the error.
_UNTESTED = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class _Tried:
    name: str
    missed_um: float
    squares: float
    freedom: float


def select_model(pairs: Pairs, mirrored: bool, *, robust: bool, lowest: str = "rigid") -> tuple[str, Floats, str]:
    """Select a model for pairs that all count.

    Weights are settled once, under the model with the most parameters that is tried: no model is blamed for marks that
    it alone cannot follow, and all are compared on the same marks. Returns the model, the robust weights (n,), and a
    sentence with all leave-one-out errors and why this model was chosen.
    """
    n = len(pairs)
    names = list(MODELS)[list(MODELS).index(lowest) :]
    able = [name for name in names if n >= MODELS[name].tried_from] or [lowest]
    weights = np.ones(n)
    if robust:
        for name in reversed([name for name in able if MODELS[name].settles_weights]):
            try:
                weights = MODELS[name].robust_weights(pairs, mirrored)
                break
            except (CannotRegister, MarkError):
                continue
    kept, share = pairs.times(weights).take(weights > 0), weights[weights > 0]
    tried: list[_Tried] = []
    refusals: list[str] = []
    for name in able:
        try:
            tried.append(_try(kept, share, name, mirrored))
        except (CannotRegister, MarkError) as refused:
            refusals.append(f"{name} not possible: {str(refused).split('. ')[0].rstrip('.')}.")
    if not tried:
        # The model with the fewest parameters names the fault of the marks best.
        MODELS[lowest].fit(kept, mirrored)
    chosen, why = _choose(tried, 1e-9 * pairs.frame()[1])
    errors = ", ".join(f"{t.name} {f'{t.missed_um:.3g} um' if np.isfinite(t.missed_um) else 'unknown'}" for t in tried)
    sentences = [f"{chosen} chosen from {n} marks. Leave-one-out rms: {errors}.", why, *refusals]
    missing = [f"{name} ({MODELS[name].tried_from})" for name in names if name not in able]
    if missing:
        sentences.append(f"Not tried, as they need more marks: {', '.join(missing)}.")
    return chosen, weights, " ".join(s for s in sentences if s)


def _try(pairs: Pairs, robust: Floats, name: str, mirrored: bool) -> _Tried:
    transform = MODELS[name].fit(pairs, mirrored)
    strain_of(transform, pairs.moving, mirrored)
    errors = MODELS[name].errors(pairs, transform, robust)
    squares, freedom = errors.residual_freedom()
    lengths = np.linalg.norm(errors.left_out(), axis=1)
    return _Tried(name=name, missed_um=weighted_rms(lengths, pairs.weights), squares=squares, freedom=freedom)


def _choose(tried: list[_Tried], floor_um: float) -> tuple[str, str]:
    order = list(MODELS)
    now = tried[0]
    reasons: list[str] = []
    for then in tried[1:]:
        if now.missed_um <= floor_um:
            return now.name, "It fits exactly: no other model can gain."
        ratio = then.missed_um / now.missed_um
        if not ratio < _GAIN ** (order.index(then.name) - order.index(now.name)):
            change = f"only {100 * (1 - ratio):.0f} % lower" if ratio < 1 else "higher"
            reasons.append(f"{then.name}: leave-one-out error {change}")
            continue
        chance = _chance(now, then)
        if chance > _CHANCE or (then.freedom < 1.0 and ratio > _UNTESTED):
            reasons.append(f"{then.name}: the gain may be chance (p = {chance:.2g})")
            continue
        now, reasons = then, []
    if reasons:
        return now.name, (
            f"Not chosen: {'; '.join(reasons)} (needed: over 10 % lower per model, and p below {_CHANCE:g})."
        )
    return now.name, "No model with more parameters to try." if now is not tried[0] or len(tried) == 1 else ""


def _chance(now: _Tried, then: _Tried) -> float:
    """Probability that noise alone lets the residuals fall as much."""
    from scipy.special import fdtrc

    more = now.freedom - then.freedom
    if more <= 0.0:
        return 1.0
    if then.freedom < 1.0 or then.squares <= 0.0:
        return 0.0
    ratio = (now.squares - then.squares) / more / (then.squares / then.freedom)
    return float(fdtrc(more, then.freedom, max(ratio, 0.0)))
