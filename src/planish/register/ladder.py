"""How many parameters the marks ask for: rigid, similarity, affine, projective, thin-plate spline.

A higher rung is taken only where marks that are left out are missed by over 10 % less for every rung climbed, and where
the fall of the residuals is more than chance gives once in a hundred times (F test). The first alone would climb on
noise with few marks; a rung that helps nothing, as the scale of a sheet that only sheared, may be stepped over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from planish.core.errors import CannotRegister, MarkError
from planish.register.models import MODELS
from planish.register.pairs import Pairs
from planish.register.result import Rung, weighted_rms
from planish.register.robust import robust_spline_weights, robust_weights
from planish.register.smoothing import Smoothing
from planish.register.solve import leave_one_out
from planish.register.strain import strain_of

Floats = NDArray[np.float64]

RUNGS: tuple[Rung, ...] = ("rigid", "similarity", "affine", "projective", "tps")
# Marks below which a rung is not tried: two more than fix it, and for the spline, which also chooses its smoothing, 8.
NEEDED: dict[Rung, int] = {"rigid": 2, "similarity": 3, "affine": 5, "projective": 6, "tps": 8}
GAIN = 0.9
CHANCE = 0.01
# A spline that goes through its marks leaves no residuals to test: it has to halve the error.
_UNTESTED = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class _Tried:
    rung: Rung
    missed_um: float
    squares: float
    freedom: float


def settled_weights(pairs: Pairs, rung: Rung, mirrored: bool) -> Floats:
    """Robust weights of the pairs under one model, shape (n,)."""
    return robust_spline_weights(pairs) if rung == "tps" else robust_weights(pairs, MODELS[rung], mirrored)


def climb(pairs: Pairs, mirrored: bool, *, robust: bool, lowest: Rung = "rigid") -> tuple[Rung, Floats, str]:
    """Choose a model for pairs that all count.

    Weights are settled once, under the highest rung that is tried, so that no rung is blamed for marks that it alone
    cannot follow, and all rungs are compared on the same marks.

    Returns
    -------
    rung : str
        The model.
    weights : ndarray, shape (n,)
        Robust weights of the pairs.
    sentence : str
        The rungs with their leave-one-out errors, and why the climb ended.
    """
    n = len(pairs)
    rungs = RUNGS[RUNGS.index(lowest) :]
    able: list[Rung] = [r for r in rungs if n >= NEEDED[r]] or [lowest]
    weights = np.ones(n)
    if robust:
        settling: list[Rung] = [r for r in reversed(able) if r != "projective"]
        for rung in settling:
            try:
                weights = settled_weights(pairs, rung, mirrored)
                break
            except (CannotRegister, MarkError):
                continue
    kept = pairs.times(weights).take(weights > 0)
    share = weights[weights > 0]
    tried: list[_Tried] = []
    skipped: list[str] = []
    for rung in able:
        try:
            tried.append(_try(kept, share, rung, mirrored))
        except (CannotRegister, MarkError) as refused:
            skipped.append(f"{rung} was passed over: {str(refused).split('. ')[0]}")
    if not tried:
        # The lowest rung says best what is wrong with the marks.
        MODELS[lowest].fit(kept, mirrored)
    chosen, why = _choose(tried, 1e-9 * pairs.frame()[1])
    sentence = f"{chosen} chosen from {n} marks. Leave-one-out rms: " + ", ".join(
        f"{t.rung} {f'{t.missed_um:.3g} um' if np.isfinite(t.missed_um) else 'unknown'}" for t in tried
    )
    sentence += f". {why}"
    for text in skipped:
        sentence += f" {text[0].upper()}{text[1:].rstrip('.')}."
    missing = [f"{r} ({NEEDED[r]})" for r in rungs if r not in able]
    if missing:
        sentence += f" Not tried, as they need more marks: {', '.join(missing)}."
    return chosen, weights, sentence


def _try(pairs: Pairs, share: Floats, rung: Rung, mirrored: bool) -> _Tried:
    if rung == "tps":
        system = Smoothing(pairs)
        smoothing = system.choose()
        strain_of(system.spline(smoothing), pairs.moving, mirrored)
        errors, _ = system.missed(smoothing)
        missed = np.linalg.solve(system.whitening, errors[..., None])[..., 0]
        squares, freedom = system.residual_freedom(smoothing)
    else:
        model = MODELS[rung]
        transform = model.fit(pairs, mirrored)
        strain_of(transform, pairs.moving, mirrored)
        missed = leave_one_out(pairs, transform, model)
        error = pairs.whitening() @ (pairs.fixed - transform(pairs.moving))[..., None]
        squares, freedom = float(np.sum(error**2)), 2.0 * float(np.sum(share)) - model.parameters
    lengths = np.linalg.norm(missed, axis=1)
    return _Tried(rung=rung, missed_um=weighted_rms(lengths, pairs.weights), squares=squares, freedom=freedom)


def _choose(tried: list[_Tried], floor_um: float) -> tuple[Rung, str]:
    now, why = 0, ""
    reasons: list[str] = []
    for k in range(1, len(tried)):
        here, there = tried[now], tried[k]
        if here.missed_um <= floor_um:
            return here.rung, "It fits exactly, so that no higher rung can gain."
        rungs = RUNGS.index(there.rung) - RUNGS.index(here.rung)
        ratio = there.missed_um / here.missed_um
        if not ratio < GAIN**rungs:
            change = f"falls by {100 * (1 - ratio):.0f} %" if ratio < 1 else "rises"
            reasons.append(f"with {there.rung} it {change}")
            continue
        chance = _chance(here, there)
        if chance > CHANCE or (there.freedom < 1.0 and ratio > _UNTESTED):
            reasons.append(f"the fall with {there.rung} may be chance (p = {chance:.2g})")
            continue
        now, reasons = k, []
    if reasons:
        why = f"Not higher: {'; '.join(reasons)}; over 10 % a rung and p below {CHANCE:g} are needed."
    else:
        why = "There is no higher rung to try." if now or len(tried) == 1 else ""
    return tried[now].rung, why


def _chance(here: _Tried, there: _Tried) -> float:
    """Probability that noise alone lets the residuals fall as much."""
    more = here.freedom - there.freedom
    if more <= 0.0:
        return 1.0
    if there.freedom < 1.0:
        return 0.0
    if there.squares <= 0.0:
        return 0.0
    ratio = (here.squares - there.squares) / more / (there.squares / there.freedom)
    return float(fdtrc(more, there.freedom, max(ratio, 0.0)))
