"""What the registration says of its error against its true error, for every model; how often it climbs on noise.

``python -m benchmarks registration [fits]``
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from planish.core.errors import CannotRegister
from planish.core.transform import Affine, Projective, Similarity
from planish.register import FittedTransform, fit_transform

Floats = NDArray[np.float64]
Truth = Callable[[Floats], Floats]

EXTENT_UM = (3000.0, 2400.0)
MODELS = ("rigid", "similarity", "affine", "projective", "tps")
WAYS = ("plain", "weights", "covariances", "outliers")
_RATIO = (0.8, 1.25)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ratio:
    """Expected and true error, rms over fits and over a grid in the hull of the marks, in um."""

    expected_um: float
    true_um: float
    refused: int

    @property
    def value(self) -> float:
        """Expected over true."""
        return self.expected_um / self.true_um


def random_truth(model: str, rng: np.random.Generator) -> Truth:
    """A transformation of a class, as large as real ones are."""
    turn = Similarity(
        scale=1.0 if model == "rigid" else rng.uniform(0.97, 1.03),
        rotation_rad=rng.uniform(-np.pi, np.pi),
        shift_um=(rng.uniform(-5e3, 5e3), rng.uniform(-5e3, 5e3)),
    )
    middle = np.array(EXTENT_UM) / 2
    if model in ("rigid", "similarity"):
        return turn
    if model == "affine":
        a, b, c = rng.normal(0, 0.004, 3)
        linear = turn.matrix() @ np.array([[1 + a, b], [b, 1 + c]])
        at = turn(middle)
        return Affine(
            linear=((linear[0, 0], linear[0, 1]), (linear[1, 0], linear[1, 1])),
            source=(middle[0], middle[1]),
            target=(at[0], at[1]),
        )
    if model == "projective":
        oblique = Projective(
            homography=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (*rng.normal(0, 0.02, 2), 1.0)),
            source=(middle[0], middle[1]), target=(middle[0], middle[1]), source_size=1e3, target_size=1e3,
        )  # fmt: skip
        return lambda p: turn(oblique(p))
    # Six waves of 1 to 3 extents, 12 um rms together in each coordinate.
    waves = 2 * np.pi / (max(EXTENT_UM) * rng.uniform(1, 3, 6))
    ways = rng.uniform(0, 2 * np.pi, 6)
    vectors = waves[:, None] * np.stack([np.cos(ways), np.sin(ways)], axis=1)
    phases, sizes = rng.uniform(0, 2 * np.pi, (6, 2)), rng.normal(0, 12 / np.sqrt(3), (6, 2))
    return lambda p: turn(p) + np.sum(np.sin((p @ vectors.T)[..., None] + phases) * sizes, axis=-2)


def hull_grid(marks: Floats, steps: int = 25) -> Floats:
    """Points of a grid inside the hull of the marks."""
    axes = [np.linspace(a, b, steps) for a, b in zip(marks.min(axis=0), marks.max(axis=0), strict=True)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return grid[Delaunay(marks).find_simplex(grid) >= 0]


def spread_marks(n: int, rng: np.random.Generator) -> Floats:
    """Marks anywhere in the field, no two closer than a quarter of the mean distance, as lasered holes are."""
    apart = 0.25 * np.sqrt(np.prod(EXTENT_UM) / n)
    marks = np.empty((0, 2))
    while len(marks) < n:
        trial = rng.uniform((0, 0), EXTENT_UM)
        if not len(marks) or np.linalg.norm(marks - trial, axis=1).min() > apart:
            marks = np.vstack([marks, trial])
    return marks


def one_fit(
    model: str, n: int, fle_um: float, way: str, rng: np.random.Generator
) -> tuple[FittedTransform, Truth, Floats]:
    """Fit marks with errors of ``fle_um`` rms in the plane to a random truth; returns fit, truth and grid."""
    truth = random_truth(model, rng)
    marks = spread_marks(n, rng)
    error = rng.normal(0, fle_um / np.sqrt(2), (n, 2))
    weights: Floats | None = None
    if way == "weights":
        size = rng.uniform(0.5, 2, n)
        error *= size[:, None]
        weights = size**-2.0
    elif way == "covariances":
        half = rng.uniform(0.3, 1, (n, 2, 2)) * rng.choice([-1, 1], (n, 2, 2)) + np.eye(2)
        weights = half @ half.swapaxes(1, 2) + 0.1 * np.eye(2)
        error = (np.linalg.cholesky(weights) @ error[..., None])[..., 0]
    elif way == "outliers":
        wrong = rng.choice(n, max(1, n // 10), replace=False)
        way_of = rng.uniform(0, 2 * np.pi, wrong.size)
        error[wrong] += rng.uniform(60, 300, wrong.size)[:, None] * np.stack([np.cos(way_of), np.sin(way_of)], axis=1)
    fit = fit_transform(marks, truth(marks) + error, model=model, weights=weights)  # type: ignore[call-overload]
    return fit, truth, hull_grid(marks)


def ratio_of(model: str, n: int, fle_um: float, way: str, fits: int, seed: int = 0) -> Ratio:
    """Expected over true error of one setting."""
    rng = np.random.default_rng([seed, MODELS.index(model), n, round(10 * fle_um), WAYS.index(way)])
    expected: list[float] = []
    true: list[float] = []
    refused = 0
    for _ in range(fits):
        try:
            fit, truth, grid = one_fit(model, n, fle_um, way, rng)
        except CannotRegister:
            refused += 1
            continue
        expected.append(float(np.mean(fit.expected_error_um(grid) ** 2)))
        true.append(float(np.mean(np.sum((fit(grid) - truth(grid)) ** 2, axis=1))))
    return Ratio(expected_um=float(np.sqrt(np.mean(expected))), true_um=float(np.sqrt(np.mean(true))), refused=refused)


def climbed(truth: str, n: int, fits: int, fle_um: float = 3.0, seed: int = 1) -> dict[str, float]:
    """How often ``auto`` ends at each model where marks of a given truth have noise, share of fits."""
    rng = np.random.default_rng([seed, MODELS.index(truth), n])
    ends = dict.fromkeys(MODELS, 0)
    for _ in range(fits):
        marks = spread_marks(n, rng)
        seen = random_truth(truth, rng)(marks) + rng.normal(0, fle_um / np.sqrt(2), (n, 2))
        ends[fit_transform(marks, seen, model="auto").model] += 1
    return {k: v / fits for k, v in ends.items()}


def main(fits: int = 200) -> int:
    """Print both tables; the number of settings whose ratio is outside 0.8 to 1.25."""
    failed = 0
    print(f"Expected over true error, rms in the hull of the marks over {fits} fits (expected / true in um)")
    for way in WAYS:
        for model in MODELS:
            for n in (8, 12, 30):
                start = time.perf_counter()
                cells: list[str] = []
                for fle in (1.0, 3.0, 5.0):
                    r = ratio_of(model, n, fle, way, fits)
                    good = _RATIO[0] <= r.value <= _RATIO[1]
                    failed += not good
                    cells.append(
                        f"FLE {fle:g}: {r.value:.2f} ({r.expected_um:.2f} / {r.true_um:.2f})"
                        f"{'' if good else ' OUT'}{f' {r.refused} refused' if r.refused else ''}"
                    )
                each = (time.perf_counter() - start) / (3 * fits)
                print(f"  {way:11s} {model:10s} N {n:2d}  {'   '.join(cells)}   {1e3 * each:.0f} ms a fit", flush=True)
    print(f"Where auto ends, share of {fits} fits, FLE 3 um")
    for truth in MODELS:
        for n in (4, 5, 6, 8, 12, 20, 30):
            ends = climbed(truth, n, fits)
            print(f"  {truth:10s} N {n:2d}  " + "  ".join(f"{k} {v:.3f}" for k, v in ends.items()), flush=True)
    return failed
