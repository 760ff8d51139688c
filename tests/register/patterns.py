"""Hole patterns, what a side shows of them, marks with covariances; and the slow twin of the
search."""

from itertools import combinations

import numpy as np

from planish.core.transform import Similarity

PITCHES = (
    (500, 725, 590, 860, 650, 950),
    (545, 905, 620, 770, 510, 830),
    (695, 560, 815, 530, 935, 605),
)


def marks(n, seed=0, size=3000.0):
    """Any places of a field."""
    return np.random.default_rng(seed).uniform(0, size, (n, 2))


def covariances(n, rng):
    """Covariances (n, 2, 2) of places, each along an axis of its own."""
    half = rng.uniform(-1, 1, (n, 2, 2)) + 1.5 * np.eye(2)
    return half @ half.swapaxes(1, 2)


def scattered(n, rng, apart=450.0):
    """Positions of n holes in a field that gives each about the same room."""
    size = apart * np.sqrt(3.0 * n)
    found = []
    while len(found) < n:
        point = rng.uniform(0, size, 2)
        if all(np.hypot(*(point - other)) > apart for other in found):
            found.append(point)
    return np.array(found)


def coded():
    """Three lines of seven holes along three sides."""
    first, second, third = (np.concatenate([[0.0], np.cumsum(p)]) for p in PITCHES)
    flat = np.zeros(7)
    lines = [(first, flat), (flat, second + 520), (flat + first[-1], third + 520)]
    return np.concatenate([np.stack(line, axis=1) for line in lines])


def pose(rng, mirrored=False):
    return Similarity(
        scale=rng.uniform(0.98, 1.02),
        rotation_rad=rng.uniform(-np.pi, np.pi),
        shift_um=tuple(rng.uniform(-2000, 2000, 2)),
        mirrored=mirrored,
    )


def seen(points, rng, lost, false, error=2.0):
    """Marks in any order, and the hole that each is; negative for none."""
    kept = rng.permutation(len(points))[: len(points) - round(lost * len(points))]
    extra = rng.uniform(points.min(axis=0), points.max(axis=0), (round(false * len(points)), 2))
    marks, which = (
        np.concatenate([points[kept], extra]),
        np.concatenate([kept, -1 - np.arange(len(extra))]),
    )
    order = rng.permutation(len(marks))
    return marks[order] + rng.normal(0, error, marks.shape), which[order]


def exhaustive(a, b, tolerance, scale_tolerance):
    """Every pair on every pair, refitted twice: pairs of the arrangement at which most marks agree,
    best fit first."""
    za, zb = a @ (1, 1j), b @ (1, 1j)
    best, answer = (0, -np.inf), None
    for i, j in combinations(range(len(za)), 2):
        for k in range(len(zb)):
            for q in range(len(zb)):
                if (
                    k == q
                    or abs(za[j] - za[i]) < 1
                    or abs(abs((zb[q] - zb[k]) / (za[j] - za[i])) - 1) > 0.06
                ):
                    continue
                alpha = (zb[q] - zb[k]) / (za[j] - za[i])
                beta = zb[k] - alpha * za[i]
                for reach in (2 * tolerance, tolerance, tolerance):
                    apart = np.abs(alpha * za[:, None] + beta - zb)
                    near = apart.argmin(axis=1)
                    rows = np.flatnonzero(apart.min(axis=1) <= reach)
                    if len(set(near[rows])) < 3:
                        break
                    alpha, beta = np.polyfit(za[rows], zb[near[rows]], 1)
                else:
                    apart = np.abs(alpha * za[:, None] + beta - zb)
                    near = apart.argmin(axis=1)
                    rows = np.flatnonzero(apart.min(axis=1) <= tolerance)
                    score = (len(set(near[rows])), -np.sum(apart.min(axis=1)[rows] ** 2))
                    if score > best and abs(abs(alpha) - 1) <= scale_tolerance:
                        best, answer = score, {(int(r), int(near[r])) for r in rows}
    return answer
