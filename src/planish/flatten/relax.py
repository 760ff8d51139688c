"""Relax a warped quad mesh in the plane to minimum spring energy (Hirn et al. 2009, section 2.3)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import splu

from planish.core.errors import CannotFlatten
from planish.core.outcome import Outcome
from planish.flatten.springs import Springs, energy, make_springs, newton_system

Array = NDArray[np.float64]

_STEPS = 40
_HALVINGS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Relaxed:
    """A relaxed mesh and how it got there.

    Attributes
    ----------
    uv : (rows, cols, 2)
        Flat coordinates in um, (u, v); NaN where there is no sheet.
    energy : float
        Sum over springs of (l - L)^2 in um2.
    outcome : Outcome
    steps : int
    history : tuple of (energy, largest move in um)
    folded : (rows - 1, cols - 1) bool
        Cells with a triangle of signed area not above zero.
    """

    uv: Array
    energy: float
    outcome: Outcome
    steps: int
    history: tuple[tuple[float, float], ...] = field(default=())
    folded: NDArray[np.bool_]


def relax_grid(points: Array, *, start: Array | None = None, tolerance: float = 1e-6) -> Relaxed:
    """Flatten a grid of points in space.

    Parameters
    ----------
    points : (rows, cols, 3)
        (x, y, z) in um; NaN where there is no sheet. Neighbours in the grid are neighbours in the sheet.
    start : (rows, cols, 2), optional
        First guess; the projection (x, y) where not given.
    tolerance : float
        The mesh is at rest when no node moves by more than this share of the mean spring length.

    Returns
    -------
    Relaxed
        Turned and shifted (not scaled) to lie on the start as closely as possible.

    Raises
    ------
    CannotFlatten
        If there are fewer than two by two nodes, or the sheet falls into unconnected pieces.

    Notes
    -----
    Newton's method with the energy's second derivatives; a step is shortened until the energy falls and no cell that
    was upright turns over. Three springs' worth of freedom (two shifts, one turn) is pinned by a weak tie of every node
    to its place, which vanishes at the solution because it is renewed in every step.
    """
    points = np.asarray(points, dtype=np.float64)
    known: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=-1))
    _check(known)
    springs = make_springs(np.where(known[..., None], points, np.nan))
    flat_start = points[..., :2] if start is None else np.asarray(start, dtype=np.float64)
    first = flat_start[known]
    uv = first.copy()
    mean_rest = float(springs.rest.mean())
    corners = _triangles(springs)
    history: list[tuple[float, float]] = []
    outcome = Outcome.OUT_OF_STEPS
    now = energy(springs, uv)
    for _ in range(_STEPS):
        force, stiffness = newton_system(springs, uv)
        tie = 1e-9 * sparse.eye_array(2 * uv.shape[0], format="csc")
        move = splu((stiffness + tie).tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True},
                    diag_pivot_thresh=0.0).solve(force).reshape(-1, 2)  # fmt: skip
        if not np.isfinite(move).all():
            outcome = Outcome.NOT_FINITE
            break
        upright = _areas(uv, corners) > 0
        share = 1.0
        for _ in range(_HALVINGS):
            trial = uv + share * move
            new = energy(springs, trial)
            if new <= now * (1 + 1e-12) and not np.any(_areas(trial, corners)[upright] <= 0):
                break
            share *= 0.5
        else:
            trial, new, share = uv, now, 0.0
        largest = float(share * np.abs(move).max())
        uv, now = trial, new
        history.append((now, largest))
        if float(np.abs(move).max()) < tolerance * mean_rest or share == 0.0:
            outcome = Outcome.RESTED
            break
    uv = _aligned(uv, first)
    grid = np.full((*known.shape, 2), np.nan)
    grid[known] = uv
    folded = _folded(grid)
    if folded.any() and outcome is Outcome.RESTED:
        outcome = Outcome.FOLDED
    return Relaxed(uv=grid, energy=now, outcome=outcome, steps=len(history), history=tuple(history), folded=folded)


def _check(known: NDArray[np.bool_]) -> None:
    if min(known.shape) < 2 or np.count_nonzero(known) < 4:
        raise CannotFlatten(
            f"The mesh has {np.count_nonzero(known)} nodes in {known.shape[0]} rows and {known.shape[1]} "
            f"columns; at least "
            "2 rows and 2 columns are needed. Use a finer mesh."
        )
    labels, count = ndimage.label(known, structure=np.ones((3, 3)))
    if count > 1:
        sizes = np.sort(np.bincount(labels.ravel())[1:])[::-1]
        raise CannotFlatten(
            f"The sheet falls into {count} unconnected pieces of {', '.join(map(str, sizes[:6]))} nodes. "
            f"Flatten each piece "
            "apart: their distance in the plane is not known."
        )


def _triangles(springs: Springs) -> NDArray[np.intp]:
    """Corner nodes (triangles, 3) of the cells whose four corners are known, two triangles a cell."""
    n = springs.nodes
    a, b, c, d = n[:-1, :-1], n[:-1, 1:], n[1:, 1:], n[1:, :-1]
    whole = (a >= 0) & (b >= 0) & (c >= 0) & (d >= 0)
    a, b, c, d = (k[whole] for k in (a, b, c, d))
    return np.concatenate([np.stack(t, axis=1) for t in ((a, b, c), (a, c, d))])


def _areas(uv: Array, corners: NDArray[np.intp]) -> Array:
    p, q, r = (uv[corners[:, k]] for k in range(3))
    return (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])


def _folded(grid: Array) -> NDArray[np.bool_]:
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]

    def area(p: Array, q: Array, r: Array) -> Array:
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    with np.errstate(invalid="ignore"):
        return (area(a, b, c) <= 0) | (area(a, c, d) <= 0)


def _aligned(uv: Array, target: Array) -> Array:
    """Turn and shift ``uv`` onto ``target``: Procrustes without scale and without reflection."""
    middle, centre = uv.mean(axis=0), target.mean(axis=0)
    a, b = uv - middle, target - centre
    turn = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    cos, sin = np.cos(turn), np.sin(turn)
    return a @ np.array([[cos, sin], [-sin, cos]]) + centre
