"""Matching of marks whose pose is unknown: right, refused or wrong, by pattern and size, and the time it takes.

``python -m benchmarks matching [trials of each kind]``
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotRegister
from planish.core.transform import Similarity
from planish.register import match_by_design, match_marks

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]
Rng = np.random.Generator

PLACEMENT_UM = 4.0
_LIMIT_MS = 50.0
_OFF_UM = 30.0
_SIZES = ((5, 7), (8, 11), (12, 15), (16, 23), (24, 40))
# Pitches of three lines in um, all different.
_PITCHES_UM = ((500, 725, 590, 860, 650, 950), (545, 905, 620, 770, 510, 830), (695, 560, 815, 530, 935, 605))


def irregular(rng: Rng, n: int, apart_um: float = 450.0) -> Floats:
    """Holes anywhere in a field that gives each the same room, none closer than ``apart_um``."""
    size = apart_um * np.sqrt(3.0 * n)
    found: list[Floats] = []
    while len(found) < n:
        point = rng.uniform(0, size, 2)
        if all(np.hypot(*(point - other)) > apart_um for other in found):
            found.append(point)
    return np.array(found)


def coded(rng: Rng) -> Floats:
    """Three lines of seven holes with coded pitches: side by side, or along three sides of a field."""
    first, second, third = (np.concatenate([[0.0], np.cumsum(rng.permutation(np.array(p)))]) for p in _PITCHES_UM)
    flat, width = np.zeros(7), first[-1]
    if rng.random() < 0.5:
        apart = rng.uniform(1500, 2500)
        lines = [(line + rng.uniform(0, 300), flat + k * apart) for k, line in enumerate((first, second, third))]
    else:
        lines = [(first, flat), (flat, second + 520), (flat + width, third + 520)]
    return np.concatenate([np.stack(line, axis=1) for line in lines])


def four_sides(rng: Rng, n: int) -> Floats:
    """Holes anywhere along the sides of a field, none closer than 450 um."""
    width, height = np.maximum(rng.uniform(3000, 8000, 2), n / 4 * 700)
    found: list[Floats] = []
    while len(found) < n:
        t = rng.uniform()
        point = np.array([(t * width, 0), (width, t * height), (t * width, height), (0, t * height)][rng.integers(4)])
        if all(np.hypot(*(point - other)) > 450 for other in found):
            found.append(point)
    return np.array(found)


KINDS: dict[str, Callable[[Rng], Floats]] = {
    "irregular": lambda rng: irregular(rng, int(rng.integers(5, 41))),
    "coded": coded,
    "four sides": lambda rng: four_sides(rng, int(rng.integers(12, 33))),
}


def _turned(points: Floats, parts: int) -> Floats:
    angles = 2 * np.pi * np.arange(parts) / parts
    z = (points[:, 0] + 1j * points[:, 1]) * np.exp(1j * angles[:, None])
    return np.stack([z.real.ravel(), z.imag.ravel()], axis=1)


def _apart(make: Callable[[], Floats]) -> Floats:
    while True:
        points = make()
        z = points[:, 0] + 1j * points[:, 1]
        if (np.abs(z[:, None] - z) + np.diag(np.full(len(z), np.inf))).min() > 300:
            return points


def _two_fold(rng: Rng) -> Floats:
    n = int(rng.integers(3, 16))
    return _apart(lambda: _turned(irregular(rng, n) * (1, 0.6) + rng.uniform(200, 900, 2), 2))


def _four_fold(rng: Rng) -> Floats:
    n = int(rng.integers(2, 9))
    return _apart(lambda: _turned(rng.uniform(300, 1500 * np.sqrt(n), (n, 2)), 4))


def _mirror(rng: Rng) -> Floats:
    n = int(rng.integers(3, 16))

    def make() -> Floats:
        half = irregular(rng, n) * (0.7, 1) + (rng.uniform(200, 900), 0)
        return np.concatenate([half, half * (-1, 1)])

    return _apart(make)


def _line(rng: Rng) -> Floats:
    steps = np.arange(int(rng.integers(6, 21)))
    return np.stack([steps * rng.uniform(450, 900), 0.0 * steps], axis=1)


def _grid(rng: Rng) -> Floats:
    a, b = rng.integers(3, 7, 2)
    x, y = np.meshgrid(np.arange(a) * rng.uniform(450, 900), np.arange(b) * rng.uniform(450, 900))
    return np.stack([x.ravel(), y.ravel()], axis=1)


def _three_lines(rng: Rng) -> Floats:
    pitch = rng.uniform(500, 900)
    starts = (0.0, pitch * rng.uniform(), pitch * rng.uniform())
    lines = [np.stack([np.arange(7) * pitch + s, np.full(7, 1700.0 * k)], axis=1) for k, s in enumerate(starts)]
    return np.concatenate(lines)


SYMMETRIC: dict[str, Callable[[Rng], Floats]] = {
    "two-fold": _two_fold,
    "four-fold": _four_fold,
    "mirror": _mirror,
    "line": _line,
    "grid": _grid,
    "three lines": _three_lines,
}


def random_pose(rng: Rng, *, mirrored: bool = False, scale: float | None = None) -> Similarity:
    """Any rotation; scale within 1 %, or of every third within 3 %."""
    most = 0.01 if rng.random() > 0.3 else 0.03
    return Similarity(
        scale=rng.uniform(1 - most, 1 + most) if scale is None else scale,
        rotation_rad=rng.uniform(-np.pi, np.pi),
        shift_um=(rng.uniform(-2e3, 2e3), rng.uniform(-2e3, 2e3)),
        mirrored=mirrored,
    )


def seen(points: Floats, rng: Rng, lost: float, false: float, error_um: float) -> tuple[Floats, Ints]:
    """What a side shows of the holes, in any order: positions and the number of the hole, negative for none."""
    n = len(points)
    kept = rng.permutation(n)[: n - round(lost * n)]
    extra = rng.uniform(points.min(axis=0), points.max(axis=0), (round(false * n), 2))
    marks = np.concatenate([points[kept], extra])
    which = np.concatenate([kept, -1 - np.arange(len(extra))]).astype(np.intp)
    order = rng.permutation(len(marks))
    return marks[order] + rng.normal(0, error_um, marks.shape), which[order]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One pattern, matched.

    Attributes
    ----------
    verdict : str
        right, refused or wrong: off by more than 30 um anywhere in the field, or of the wrong hand.
    false_pairs : int
        Pairs that are not the same hole.
    """

    verdict: str
    holes: int
    ms: float
    false_pairs: int
    said: str


def trial(
    points: Floats, rng: Rng, *, both: bool, lost: float = 0.3, false: float = 0.3, design: bool = False
) -> Trial:
    """Match what two sides show of a pattern; marks are missing and false on one of them, or on both."""
    holes = points + rng.normal(0, PLACEMENT_UM, points.shape)
    mirror = not design and rng.random() < 0.3
    truth = random_pose(rng, mirrored=mirror and rng.random() < 0.5)
    sides = [seen(holes, rng, lost * share, false * share, rng.uniform(1, 3)) for share in (1, both)]
    (a, of_a), (b, of_b) = sides[:: rng.choice([-1, 1])]
    b = truth(b)
    start = time.process_time()
    try:
        found = match_by_design(a, b, points, scale_tolerance=0.04) if design else match_marks(a, b, mirror=mirror)
    except CannotRegister as error:
        return Trial(verdict="refused", holes=len(points), ms=_since(start), false_pairs=0, said=str(error))
    ms = _since(start)
    low, high = holes.min(axis=0), holes.max(axis=0)
    where = rng.uniform(low, high, (50, 2))
    off = float(np.linalg.norm(found.transform(where) - truth(where), axis=1).max())
    right = off <= _OFF_UM and found.mirrored == truth.mirrored
    return Trial(
        verdict="right" if right else "wrong",
        holes=len(points),
        ms=ms,
        false_pairs=int(np.sum(of_a[found.pairs[:, 0]] != of_b[found.pairs[:, 1]])),
        said=f"{found.sentence} Off by {off:.0f} um.",
    )


def _since(start: float) -> float:
    return 1e3 * (time.process_time() - start)


def _count(trials: list[Trial]) -> str:
    return "  ".join(f"{v} {sum(t.verdict == v for t in trials):4d}" for v in ("right", "refused", "wrong"))


def _show(name: str, trials: list[Trial], sizes: bool = True) -> int:
    """Print a block; the number of wrong matches, and one where it took too long."""
    ms = np.array([t.ms for t in trials])
    pairs = sum(t.false_pairs for t in trials)
    print(
        f"  {name:34s} {_count(trials)}   false pairs {pairs}   CPU median {np.median(ms):.1f}, 99 % under "
        f"{np.percentile(ms, 99):.1f} ms",
        flush=True,
    )
    for low, high in _SIZES if sizes else ():
        some = [t for t in trials if low <= t.holes <= high]
        if some:
            print(f"      {low:2d} to {high:2d} holes: {len(some):4d}  {_count(some)}")
    for t in trials:
        if t.verdict == "wrong":
            print(f"      WRONG, {t.holes} holes: {t.said}")
    return sum(t.verdict == "wrong" for t in trials) + int(np.median(ms) > _LIMIT_MS)


def unrelated(kind: str, rng: Rng) -> bool:
    """Whether marks of two patterns that have nothing to do with one another are matched."""
    a, b = (seen(KINDS[kind](rng), rng, 0.3, 0.3, 2.0)[0] for _ in range(2))
    try:
        match_marks(a, random_pose(rng)(b))
    except CannotRegister:
        return False
    return True


def main(trials: int = 340) -> int:
    """Print all tables; the number of wrong matches, and of kinds that take more than 50 ms in the median."""
    failed = 0
    rng = np.random.default_rng(0)
    print("30 % of the holes missing and 30 % false marks; 4 um placement, 1-3 um localisation a side, any pose")
    for both in (False, True):
        for kind, make in KINDS.items():
            trial(make(rng), rng, both=both)
            name = f"{kind}, {'both sides' if both else 'one side'}"
            failed += _show(name, [trial(make(rng), rng, both=both) for _ in range(trials)], kind != "coded")
    print("With the design known, both sides")
    for lost in (0.3, 0.5):
        for kind, make in KINDS.items():
            runs = [trial(make(rng), rng, both=True, lost=lost, design=True) for _ in range(trials // 3)]
            failed += _show(f"{kind}, {100 * lost:.0f} % missing", runs, kind == "irregular")
    print("Symmetric patterns: those accepted, of which right by luck")
    for false in (0.0, 0.3):
        for both in (False, True):
            for kind, make in SYMMETRIC.items():
                runs = [_symmetric_trial(make(rng), rng, kind, both, false) for _ in range(trials // 3)]
                taken = [t for t in runs if t.verdict != "refused"]
                sizes = ", ".join(str(t.holes) for t in taken)
                print(
                    f"  {kind:12s} {'both sides' if both else 'one side':10s} {100 * false:2.0f} % false: "
                    f"{len(taken)} of {len(runs)}, {sum(t.verdict == 'right' for t in taken)} right"
                    + (f" ({sizes} holes)" if taken else ""),
                    flush=True,
                )
    print("Patterns that have nothing to do with one another")
    for kind in KINDS:
        print(f"  {kind:12s} {sum(unrelated(kind, rng) for _ in range(trials))} of {trials} accepted", flush=True)
    return failed


def _symmetric_trial(points: Floats, rng: Rng, kind: str, both: bool, false: float) -> Trial:
    holes = points + rng.normal(0, PLACEMENT_UM, points.shape)
    mirror = kind == "mirror"
    truth = random_pose(rng, mirrored=mirror and rng.random() < 0.5)
    (a, of_a), (b, of_b) = (seen(holes, rng, 0.3 * share, false * share, 2.0) for share in (1, both))
    try:
        found = match_marks(a, truth(b), mirror=mirror)
    except CannotRegister as error:
        return Trial(verdict="refused", holes=len(points), ms=0.0, false_pairs=0, said=str(error))
    same = of_a[found.pairs[:, 0]] == of_b[found.pairs[:, 1]]
    verdict = "right" if same.mean() > 0.7 else "wrong"
    return Trial(verdict=verdict, holes=len(points), ms=0.0, false_pairs=0, said=found.sentence)
