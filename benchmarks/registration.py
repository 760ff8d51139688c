"""How near the registration comes to the truth, against the best model in hindsight, and what it
says of its error.

``python -m benchmarks registration [truths]`` draws similarities (27 %), affine maps (27 %) and
smooth warps (46 %) whose deviation from a similarity is 0 to 5 times the noise of the marks, 6 to
60 marks, and one wrong mark in ten.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.shared import rms
from planish.core.errors import CannotRegister, MarkError
from planish.core.transform import Similarity
from planish.core.typing import Floats
from planish.register import fit_transform
from planish.register.bent import inside
from planish.register.models import MODELS

Truth = Callable[[Floats], Floats]

EXTENT_UM = (3000.0, 2400.0)
KINDS = ("similarity", "affine", "warp")
_SHARES = (0.27, 0.27, 0.46)
_WRONG = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """Marks of a known map."""

    kind: str
    truth: Truth
    marks: Floats  # (n, 2), in um
    seen: Floats  # (n, 2), in um
    wrong: NDArray[np.bool_]
    noise_um: float  # of a coordinate


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Held-out errors of one truth, rms over the hull of its marks, in um; NaN where a model
    refuses."""

    kind: str
    true_um: dict[str, float]
    stated_um: dict[str, float]
    warned: dict[str, bool]  # of structure that the model leaves
    missed: int
    accused: int
    wrong: int


def spread_marks(n, rng):
    """Marks anywhere in the field, no two closer than a quarter of the mean distance, as lasered
    holes are."""
    apart = 0.25 * np.sqrt(np.prod(EXTENT_UM) / n)
    marks = np.empty((0, 2))
    while len(marks) < n:
        trial = rng.uniform((0, 0), EXTENT_UM)
        if not len(marks) or np.linalg.norm(marks - trial, axis=1).min() > apart:
            marks = np.vstack([marks, trial])
    return marks


def hull_grid(marks, steps=15):
    """Points of a grid inside the hull of the marks."""
    return inside(marks, steps)[len(marks) :]


def _deviation(kind, size_um, rng):
    """Deviation of which a similarity leaves ``size_um`` rms in a coordinate."""
    middle = np.array(EXTENT_UM) / 2
    if kind == "similarity":
        return np.zeros_like
    if kind == "affine":
        a, b = rng.normal(0, 1, 2)
        shape = lambda p: (p - middle) @ np.array([[a, b], [b, -a]])  # noqa: E731
    else:
        # Six waves of about one length, which is .7 to 3 times the extent.
        length = max(EXTENT_UM) * np.exp(rng.uniform(np.log(0.7), np.log(3)))
        ways = rng.uniform(0, 2 * np.pi, 6)
        waves = (
            2 * np.pi / (length * rng.uniform(0.7, 1.5, 6)) * np.array([np.cos(ways), np.sin(ways)])
        )
        phases, sizes = rng.uniform(0, 2 * np.pi, (6, 2)), rng.normal(0, 1, (6, 2))
        shape = lambda p: np.sum(np.sin((p @ waves)[..., None] + phases) * sizes, axis=-2)  # noqa: E731
    probe = np.stack(np.meshgrid(*(np.linspace(0, e, 20) for e in EXTENT_UM)), axis=-1).reshape(
        -1, 2
    )
    z, w = ((v - v.mean(axis=0)) @ np.array([1, 1j]) for v in (probe, shape(probe)))
    left = w - z * (np.sum(z.conj() * w) / np.sum(np.abs(z) ** 2))
    factor = size_um / np.sqrt(np.mean(np.abs(left) ** 2) / 2)
    return lambda p: factor * shape(p)


def drawn(rng, most=5.0):
    """A truth with its marks; the deviation is up to ``most`` times the noise."""
    kind = str(rng.choice(KINDS, p=_SHARES))
    n = round(float(np.exp(rng.uniform(np.log(6), np.log(60)))))
    noise = float(np.exp(rng.uniform(np.log(0.5), np.log(5))))
    turn = Similarity(
        scale=rng.uniform(0.97, 1.03),
        rotation_rad=rng.uniform(-np.pi, np.pi),
        shift_um=(rng.uniform(-5e3, 5e3), rng.uniform(-5e3, 5e3)),
    )
    deviation = _deviation(kind, rng.uniform(0, most) * noise, rng)
    truth = lambda p: turn(p) + deviation(p)  # noqa: E731
    marks = spread_marks(n, rng)
    error = rng.normal(0, noise, (n, 2))
    wrong = rng.random(n) < _WRONG
    wrong[np.flatnonzero(wrong)[max(1, n // 5) :]] = False
    # Wrong marks are 10 to 100 times the noise off, in any direction.
    off, way = noise * 10 ** rng.uniform(1, 2, n), rng.uniform(0, 2 * np.pi, n)
    error[wrong] += (off[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1))[wrong]
    return Drawn(
        kind=kind, truth=truth, marks=marks, seen=truth(marks) + error, wrong=wrong, noise_um=noise
    )


def judged(one, models=(*MODELS, "auto")):
    """Fit all models to one drawn truth."""
    grid = hull_grid(one.marks)
    truth = one.truth(grid)
    true, stated, warned = {}, {}, {}
    # Which marks are wrong does not depend on the model: found once.
    weights = fit_transform(one.marks, one.seen).robust_weights
    for model in models:
        try:
            fit = fit_transform(one.marks, one.seen, model=model, weights=weights, robust=False)
        except (CannotRegister, MarkError):
            true[model], stated[model], warned[model] = np.nan, np.nan, False
            continue
        true[model] = rms(np.linalg.norm(fit(grid) - truth, axis=1))
        stated[model] = rms(fit.expected_error_um(grid))
        warned[model] = any("leaves structure" in w for w in fit.warnings)
    return Row(
        kind=one.kind,
        true_um=true,
        stated_um=stated,
        warned=warned,
        wrong=int(one.wrong.sum()),
        missed=int(np.sum(one.wrong & (weights > 0))),
        accused=int(np.sum(~one.wrong & (weights == 0))),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """One model over many truths."""

    mean: float  # geometric mean of held-out error over that of the best model
    p90: float
    pooled: float  # true over stated error
    within: float  # share within 1.73 times the stated error
    warned: float


def summary(rows, model):
    """What a model does over many truths."""
    true, stated = (
        np.array([v[model] for v in of])
        for of in ([r.true_um for r in rows], [r.stated_um for r in rows])
    )
    best = np.array([np.nanmin(list(r.true_um.values())) for r in rows])
    ok = np.isfinite(true)
    ratio = true[ok] / best[ok]
    return Summary(
        mean=float(np.exp(np.mean(np.log(ratio)))),
        p90=float(np.quantile(ratio, 0.9)),
        pooled=rms(true[ok]) / rms(stated[ok]),
        within=float(np.mean(true[ok] <= 1.73 * stated[ok])),
        warned=float(np.mean([r.warned[model] for r in rows])),
    )


def main(truths=400):
    """Print the table of all models and the limits; the number of limits that are missed."""
    start = time.process_time()
    rows = [judged(drawn(np.random.default_rng([0, k]))) for k in range(truths)]
    print(f"{truths} truths, {time.process_time() - start:.0f} s CPU")
    print(
        "held-out error over that of the best model: geometric mean, p90 | true over stated, within"
        " 1.73 | warned"
    )
    for kind in ("all", *KINDS):
        of = [r for r in rows if kind in ("all", r.kind)]
        print(f"{kind}: {len(of)}")
        for model in (*MODELS, "auto"):
            s = summary(of, model)
            print(
                f"  {model:10s} {s.mean:6.2f} {s.p90:6.2f} | {s.pooled:.2f} {s.within:.2f} |"
                f" {s.warned:.2f}"
            )
    print(
        f"wrong marks left out: {sum(r.wrong - r.missed for r in rows)} of"
        f" {sum(r.wrong for r in rows)}; right marks left out: {sum(r.accused for r in rows)}, in"
        f" {np.mean([r.accused > 0 for r in rows]):.1%} of the truths"
    )
    auto, warps = summary(rows, "auto"), summary([r for r in rows if r.kind == "warp"], "auto")
    limits = {
        "auto over best, geometric mean": (0.0, auto.mean, 1.10),
        "auto over best, p90": (0.0, auto.p90, 1.5),
        "true over stated": (0.8, auto.pooled, 1.15),
        "true over stated, warps": (0.8, warps.pooled, 1.25),
        "within 1.73 times the stated error": (0.93, auto.within, 1.0),
    }
    missed = 0
    for what, (low, value, high) in limits.items():
        is_good = low <= value <= high
        missed += not is_good
        print(f"{'good' if is_good else 'MISSED':6s} {what} {value:.3f}")
    return missed
