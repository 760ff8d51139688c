"""Relax a spring mesh in the plane as a damped motion in time: the solver of Hirn et al. (2009), section 2.3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import CannotFlatten
from planish.core.outcome import Outcome
from planish.flatten import _relaxation_kernels as kernels
from planish.flatten.geodesics import triangle_areas

Array = NDArray[np.float64]

_BLOCK = 50  # steps between two returns to the interpreter: some 10 ms at 128 x 96 nodes, so that Ctrl-C works

# How the time step follows in the feedback reading of Eq. (4). The paper has no numbers for it; any come to a halt.
_CUT, _GROW = 0.5, 1.1

_INTEGRATORS = {"symplectic": kernels.SYMPLECTIC, "rk4": kernels.RK4, "euler": kernels.EULER}
_CONTROLS = {"scale": kernels.SCALE, "feedback": kernels.FEEDBACK, "fixed": kernels.FIXED}
_STOPS = {"first": kernels.FIRST, "sustained": kernels.SUSTAINED, "residual": kernels.RESIDUAL}


@dataclass(frozen=True, slots=True, kw_only=True)
class RelaxationParams:
    """Choices of the relaxation. Lengths are in mean pitches; mass and stiffness are 1, which sets the unit of time.

    The values are those of Hirn et al. (2009) where they give one.

    Attributes
    ----------
    integrator : str
        The paper names none. ``symplectic``: Euler's method with the new velocity in the position and the damping taken
        implicitly, stable up to a time step of 2 / sqrt(8) = 0.71. ``rk4``: Runge-Kutta of fourth order, the same
        motion for four times the work. ``euler``: the old velocity in the position; the paper calls it unstable, and it
        is.
    control : str
        How Eq. (4), max |grad v| < a, is read. ``scale``: the strain of one step is limited, dt max |grad v| <= a,
        for the velocity before and after the step. ``feedback``: dt is cut as long as max |grad v| >= a. The gradient
        does not depend on dt, so that this comes to a halt; it is kept to show that. ``fixed``: ``fixed_dt`` and
        ``fixed_c`` throughout.
    stop : str
        How Eq. (6), mean |v| < mean_speed, is read. ``first``: the first time after the mesh has been faster once.
        ``sustained``: for a whole period of the slowest mode, 2 max(rows, cols); an oscillating mesh is slow at every
        turning point. ``residual``: no force on a node exceeds ``residual``.
    a : float
        Eq. (4); a strain of 1 % in one step.
    b : float
        Eq. (5): c > max |grad v| / b.
    c_min : float
        Eq. (5). Critical for the slowest mode of 314 nodes a side; wider meshes creep.
    c_fall : float
        The damping falls to this share in a step at most, so that one calm step does not set the mesh free. Not in the
        paper.
    dt_max : float
        Eq. (4).
    most_move : float
        The fastest node moves no further in one step; the paper's 20 % of the grid spacing.
    mean_speed : float
        Eq. (6).
    residual : float
        Largest force at rest, in stiffness times pitch; only for ``stop="residual"``. A hundredth of the speed's limit.
    most_steps : int
        A mesh of 128 x 96 nodes takes 2000 to 3000; the number grows with the longer side.
    fixed_dt, fixed_c : float
        For ``control="fixed"``; forward Euler is stable below fixed_c / 8 only. ``feedback`` starts with ``fixed_dt``.
    """

    integrator: Literal["symplectic", "rk4", "euler"] = "symplectic"
    control: Literal["scale", "feedback", "fixed"] = "scale"
    stop: Literal["first", "sustained", "residual"] = "sustained"
    a: float = 1e-2
    b: float = 0.2
    c_min: float = 0.02
    c_fall: float = 0.97
    dt_max: float = 0.3
    most_move: float = 0.2
    mean_speed: float = 1e-3
    residual: float = 1e-5
    most_steps: int = 50_000
    fixed_dt: float = 0.0025
    fixed_c: float = 0.02


class History(NamedTuple):
    """One value for every step, each (steps,): what was used in the step and how the mesh was after it.

    ``step`` counts from 1; ``dt``, ``c``: time step and damping; ``gradient``: largest Frobenius norm of the velocity's
    gradient; ``mean_speed``: mean of the nodes' speeds; ``energy``: sum over springs of k (l - L)^2.
    """

    step: Array
    dt: Array
    c: Array
    gradient: Array
    mean_speed: Array
    energy: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Relaxation:
    """A relaxed mesh and how it got there.

    Attributes
    ----------
    uv : (rows, cols, 2)
        Flat coordinates in pitches, as the motion left them: not turned or shifted back. NaN where there is no node.
    energy : float
        Sum over springs of k (l - L)^2 in pitches squared (Eq. 1).
    outcome : Outcome
    steps : int
    history : History
    inverted : int
        Cells with a triangle that is empty or does not turn as the start does as a whole.
    """

    uv: Array
    energy: float
    outcome: Outcome
    steps: int
    history: History
    inverted: int


def relax_dynamically(
    start: Array, rest: Array, *, stiffness: Array | None = None, params: RelaxationParams | None = None
) -> Relaxation:
    """Let a spring mesh swing to rest in the plane.

    Parameters
    ----------
    start : (rows, cols, 2)
        Where the nodes are let go, in mean pitches; NaN where there is no node.
    rest : (4, rows, cols)
        Rest lengths in mean pitches of the springs (i, j)-(i, j + 1), (i, j)-(i + 1, j), (i, j)-(i + 1, j + 1) and
        (i, j + 1)-(i + 1, j); NaN where there is no spring.
    stiffness : (4, rows, cols), optional
        Spring constants, 1 where not given. They are divided by the largest, which changes the unit of time and leaves
        the state of rest as it is: the limits on the time step hold for a constant of 1.
    params : RelaxationParams, optional

    Returns
    -------
    Relaxation

    Raises
    ------
    CannotFlatten
        If the arrays do not fit together.

    Notes
    -----
    Hirn et al. (2009), Eqs. (2) to (6), with these readings. The force is Hooke's as the text words it: a stretched
    spring pulls its ends together; Eq. (2) as printed has the other sign. The mean of Eq. (6) is taken over the
    nodes. The gradient of the velocity is taken by central differences between neighbouring nodes, one-sided at borders
    and beside missing nodes, and its Frobenius norm is what a and b limit. The damping starts at
    sqrt(max |grad F| / b), which is Eq. (5) for the overdamped velocity F / c: the paper asks for a high damping at
    the start, where the velocity is still zero.

    Nothing in the energy forbids a fold. The step control keeps a fair start from folding; cells that are turned over
    in the start may stay so. They are counted at the end.
    """
    p = params or RelaxationParams()
    start = np.asarray(start, dtype=np.float64)
    rest = np.asarray(rest, dtype=np.float64)
    stiff = np.ones_like(rest) if stiffness is None else np.asarray(stiffness, dtype=np.float64)
    if start.ndim != 3 or start.shape[2] != 2 or rest.shape != (4, *start.shape[:2]) or stiff.shape != rest.shape:
        raise CannotFlatten(
            f"Nodes {start.shape}, rest lengths {rest.shape} and stiffness {stiff.shape} do not fit together; needed "
            f"are (rows, cols, 2) and twice (4, rows, cols). Make all of them from one mesh."
        )
    known: NDArray[np.bool_] = np.asarray(np.isfinite(start).all(axis=-1))
    tied = _ties(known) & np.isfinite(rest) & np.isfinite(stiff)
    unit = float(np.max(stiff, where=tied, initial=0.0)) or 1.0
    x = _framed(np.where(known[..., None], start, 0.0).transpose(2, 0, 1))
    rests, constants = _framed(np.where(tied, rest, 0.0)), _framed(np.where(tied, stiff / unit, 0.0))
    side, nodes = _sides(_framed(known.astype(np.float64))), int(np.count_nonzero(known))
    v, f = np.zeros_like(x), np.zeros_like(x)
    energy, largest = kernels.set_force(x, rests, constants, f)
    state = np.zeros(kernels.SIZE)
    uneven = kernels.mix(v, 0.0, f, 1.0, side, np.zeros_like(x))[0]
    state[kernels.DT], state[kernels.C] = p.fixed_dt, max(p.c_min, np.sqrt(uneven / p.b))
    if p.control == "fixed":
        state[kernels.C] = p.fixed_c
    kinds = (_INTEGRATORS[p.integrator], _CONTROLS[p.control], _STOPS[p.stop])
    rule = (p.a, p.b, p.c_min, p.dt_max, p.c_fall, _CUT, _GROW, p.most_move, p.mean_speed, p.residual,
            2.0 * max(known.shape))  # fmt: skip
    # Without any force there is no motion to wait for.
    done, code = 0, kernels.RESTED if largest == 0.0 else kernels.GOING
    logs: list[Array] = [np.empty((0, 5))]
    while code == kernels.GOING and done < p.most_steps:
        log = np.empty((min(_BLOCK, p.most_steps - done), 5))
        made, code = kernels.steps(x, v, f, rests, constants, side, nodes, state, kinds, rule, log)
        logs.append(log[:made])
        done += made
    log = np.concatenate(logs)
    log[:, 4] *= unit
    uv = np.where(known[..., None], x[:, 1:-1, 1:-1].transpose(1, 2, 0), np.nan)
    inverted = int(np.count_nonzero(_inverted(uv, start)))
    outcome = {kernels.GOING: Outcome.OUT_OF_STEPS, kernels.NOT_FINITE: Outcome.NOT_FINITE}.get(code, Outcome.RESTED)
    if inverted and outcome is Outcome.RESTED:
        outcome = Outcome.FOLDED
    return Relaxation(
        uv=uv,
        energy=float(log[-1, 4]) if done else float(energy * unit),
        outcome=outcome,
        steps=done,
        history=History(np.arange(1.0, done + 1), *log.T),
        inverted=inverted,
    )


def _ties(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell for each of the (4, rows, cols) springs whether both of its ends exist."""
    both = np.zeros((4, *known.shape), dtype=bool)
    both[0, :, :-1] = known[:, :-1] & known[:, 1:]
    both[1, :-1] = known[:-1] & known[1:]
    both[2, :-1, :-1] = known[:-1, :-1] & known[1:, 1:]
    both[3, :-1, :-1] = known[:-1, 1:] & known[1:, :-1]
    return both


def _framed(values: Array) -> Array:
    """Put a frame of zeros around the last two axes."""
    return np.pad(values, [(0, 0)] * (values.ndim - 2) + [(1, 1), (1, 1)])


def _sides(known: Array) -> Array:
    """Weights of the differences to the neighbours right, left, below and above (4, rows + 2, cols + 2)."""
    side = np.zeros((4, *known.shape))
    right, left, below, above = (np.roll(known, shift, axis) for shift, axis in ((-1, 1), (1, 1), (-1, 0), (1, 0)))
    for k, (one, other) in enumerate(((right, left), (left, right), (below, above), (above, below))):
        side[k] = known * one * (1.0 - 0.5 * other)
    return side


def _inverted(uv: Array, start: Array) -> NDArray[np.bool_]:
    """Cells (rows - 1, cols - 1) with a triangle that is empty or does not turn as the start does as a whole."""
    with np.errstate(invalid="ignore", over="ignore"):  # a mesh that has left the finite numbers is counted, too
        first, second = triangle_areas(start)
        side = np.sign(np.nansum(first) + np.nansum(second))
        one, two = triangle_areas(uv)
        return (side * one <= 0) | (side * two <= 0)
