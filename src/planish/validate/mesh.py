"""The spring mesh alone, as Hirn et al. (2009) try it.

It is that of their fifth figure: how near its state of rest comes to the flat sheet.
"""

import time

import numpy as np

from planish.core.status import Outcome
from planish.core.transform import grid_points
from planish.core.typing import Floats
from planish.flatten import relax_grid
from planish.flatten.levels import of_springs
from planish.flatten.relaxation import RelaxationParams, relax_dynamically
from planish.validate.truth import Values

ROWS, COLS = 24, 32
# Of an arc that is longer by 2.6 pitches than its chord: 2 R asin(63.5 / R) = 129.6.
_RADIUS = 186.20878876922393
_FEW_STEPS = 5000  # three times what the right reading needs to come to rest


def mesh_values(seed: int, *, once: bool) -> Values:
    """Figures of one random deformation, sizes in %, places in pitches.

    ``once``: also those that no seed changes. Sizes are None where a mesh did not come to rest;
    ``_fine`` stops at a lower speed, ``mesh_first`` at the first standstill; feedback and Euler's
    steps are other readings of the paper, of which it counts whether they fail.
    """
    start, rest = deformed(seed)
    flat = grid(ROWS, COLS)
    if once:  # the first call compiles, which is no part of the time
        relax_dynamically(start, rest, params=RelaxationParams(most_steps=1))
    begin = time.perf_counter()
    relaxed = relax_dynamically(start, rest)
    values: Values = {
        "mesh_seconds": time.perf_counter() - begin,
        "mesh_inverted": float(relaxed.inverted),
    }
    fine = relax_dynamically(start, rest, params=RelaxationParams(mean_speed=1e-4))
    for suffix, mesh in (("", relaxed), ("_fine", fine)):
        names = [f"mesh_{size}{suffix}" for size in ("width", "height", "aspect")]
        values |= dict.fromkeys(names)
        if mesh.outcome is Outcome.RESTED:
            percents = 100.0 * size_errors(mesh.uv, flat)
            values |= zip(names, percents.tolist(), strict=True)
    first_stop = relax_dynamically(start, rest, params=RelaxationParams(stop="first"))
    first_errors = np.abs(size_errors(first_stop.uv, flat))
    values["mesh_first"] = 100.0 * float(first_errors.max())
    feedback = RelaxationParams(control="feedback", fixed_dt=0.3, most_steps=_FEW_STEPS)
    euler = RelaxationParams(integrator="euler", most_steps=_FEW_STEPS)
    for name, params in (("feedback", feedback), ("euler", euler)):
        outcome = relax_dynamically(start, rest, params=params).outcome
        values[f"mesh_{name}_fails"] = float(outcome is not Outcome.RESTED)
    if not once:
        return values
    # The cylinder, and both solvers' minimum on a dome, which has no flat state without strain.
    projected, arc_points = cylinder()
    begin = time.perf_counter()
    relaxed = relax_dynamically(projected, rest_lengths(arc_points))
    values["mesh_cylinder_seconds"] = time.perf_counter() - begin
    values["mesh_cylinder"] = node_error(relaxed.uv, unrolled(projected))
    from_middle = flat - flat.mean(axis=(0, 1))
    squared_radius = np.sum(from_middle**2, axis=-1)
    height = 2.0 * np.exp(-squared_radius / 72.0)
    dome = np.concatenate([flat, height[..., None]], axis=-1)
    methods = ("multigrid", RelaxationParams(mean_speed=1e-4))
    multigrid_uv, dynamic_uv = (
        relax_grid(dome, method=method, rest="chord").uv for method in methods
    )
    return values | {"mesh_minimum": node_error(multigrid_uv, dynamic_uv)}


def grid(rows: int, cols: int) -> Floats:
    """Nodes (rows, cols, 2) of a flat mesh of pitch 1."""
    return grid_points(np.arange(float(cols)), np.arange(float(rows)))


def rest_lengths(points: Floats) -> Floats:
    """Rest lengths (4, rows, cols): right, down, and both diagonals.

    NaN where there is no spring.
    """
    missing = np.full((4, *points.shape[:2]), np.nan)
    return of_springs(points, lambda a, b: np.linalg.norm(b - a, axis=-1), missing)


def deformed(seed: int, rows: int = ROWS, cols: int = COLS) -> tuple[Floats, Floats]:
    """Start (rows, cols, 2) and rest lengths of a deformation like that of the paper's figure.

    A flat mesh, scaled, sheared, rows and nodes displaced.
    """
    rng = np.random.default_rng(seed)
    flat = grid(rows, cols)
    start = flat @ np.array([[0.85, 0.0], [0.15, 1.10]])
    row_shifts = rng.normal(0, 0.3, rows)
    start[..., 0] += row_shifts[:, None]
    start += rng.normal(0, 0.15, start.shape)
    return start, rest_lengths(flat)


def cylinder() -> tuple[Floats, Floats]:
    """Return projection and places of nodes that are equally spaced in x on an arc.

    The projection is (rows, cols, 2), the places are (rows, cols, 3).
    """
    flat = grid(96, 128)
    flat[..., 0] -= flat[0, -1, 0] / 2
    height = np.sqrt(_RADIUS**2 - flat[..., :1] ** 2)
    arc_points = np.concatenate([flat, height], axis=-1)
    return flat, arc_points


def unrolled(flat: Floats) -> Floats:
    """Unroll the cylinder: flat places of the nodes (rows, cols, 2) of its projection."""
    arc = _RADIUS * np.arcsin(flat[..., 0] / _RADIUS)
    return np.stack([arc, flat[..., 1]], axis=-1)


def size_errors(uv: Floats, flat: Floats) -> Floats:
    """Relative errors of width, height and aspect.

    A size is the mean distance between opposite edges' nodes.
    """
    return _sizes(uv) / _sizes(flat) - 1


def _sizes(nodes: Floats) -> Floats:
    """Width, height and aspect of a mesh (rows, cols, 2)."""
    from_left = nodes[:, -1] - nodes[:, 0]
    from_top = nodes[-1] - nodes[0]
    width = np.linalg.norm(from_left, axis=-1).mean()
    height = np.linalg.norm(from_top, axis=-1).mean()
    return np.array([width, height, width / height])


def node_error(uv: Floats, flat: Floats) -> float:
    """Largest distance of a node from its place after the best turn and shift, in pitches."""
    a, b = (places[..., 0] + 1j * places[..., 1] for places in (uv, flat))
    a = a - a.mean()
    b = b - b.mean()
    turn = np.vdot(a, b)
    errors = a * turn / abs(turn) - b
    return float(np.abs(errors).max())
