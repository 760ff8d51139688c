"""Relax a spring mesh in the plane as a damped motion in time: the solver of Hirn et al.

(2009), section 2.3.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from planish.core.errors import CannotFlatten
from planish.core.status import Outcome
from planish.core.transform import are_known
from planish.core.typing import Bools, Floats
from planish.flatten._relaxation_kernels import mix, set_force
from planish.flatten.distortion import folded_cells, triangle_areas
from planish.flatten.levels import of_springs

Springs = tuple[Floats, Floats]  # rest lengths and constants, framed


@dataclass(frozen=True, slots=True, kw_only=True)
class RelaxationParams:
    """Choices of the relaxation.

    Lengths are in mean pitches; mass and stiffness are 1, which sets the unit of time.

    The values are those of Hirn et al. (2009) where they give one.
    """

    #: The paper names none. ``symplectic``: Euler's method with the new velocity in the position
    #: and the damping taken implicitly, stable up to a time step of 2 / sqrt(8) = 0.71. ``rk4``:
    #: Runge-Kutta of fourth order, the same motion for four times the work. ``euler``: the old
    #: velocity in the position; the paper calls it unstable, and it is.
    integrator: Literal["symplectic", "rk4", "euler"] = "symplectic"
    #: How Eq. (4), ``max |grad v| < a``, is read. ``scale``: the strain of one step is limited,
    #: ``dt max |grad v| <= a``, for the velocity before and after the step. ``feedback``: dt is cut
    #: as long as ``max |grad v| >= a``. The gradient does not depend on dt, so that this comes to a
    #: halt; it is kept to show that. ``fixed``: ``fixed_dt`` and ``fixed_c`` throughout.
    control: Literal["scale", "feedback", "fixed"] = "scale"
    #: How Eq. (6), ``mean |v| < mean_speed``, is read. ``first``: the first time after the mesh has
    #: been faster once. ``sustained``: for a whole period of the slowest mode, 2 max(rows, cols);
    #: an oscillating mesh is slow at every turning point. ``residual``: no force on a node exceeds
    #: ``residual``.
    stop: Literal["first", "sustained", "residual"] = "sustained"
    a: float = 1e-2  #: Eq. (4); a strain of 1 % in one step
    b: float = 0.2  #: Eq. (5): ``c > max |grad v| / b``
    #: Eq. (5); critical for the slowest mode of 314 nodes a side; wider meshes creep.
    c_min: float = 0.02
    #: Share to which the damping falls in a step at most: one calm step does not free the mesh;
    #: not in the paper.
    c_fall: float = 0.97
    dt_max: float = 0.3  #: Eq. (4)
    most_move: float = 0.2  #: of the fastest node in one step; the paper's 20 % of the grid spacing
    mean_speed: float = 1e-3  #: Eq. (6)
    #: Largest force at rest, in stiffness times pitch; only for ``stop="residual"``; a hundredth
    #: of the speed's limit.
    residual: float = 1e-5
    #: a mesh of 128 x 96 nodes takes 2000 to 3000; the number grows with the longer side.
    most_steps: int = 50_000
    fixed_dt: float = 0.0025  #: for ``control="fixed"``; ``feedback`` starts with it
    #: for ``control="fixed"``; forward Euler is stable for ``fixed_dt < fixed_c / 8`` only.
    fixed_c: float = 0.02


class MotionHistory(NamedTuple):
    """One value for every step, each (steps,).

    What was used in the step and how the mesh was after it.

    ``step`` counts from 1; ``dt``, ``c``: time step and damping; ``gradient``: largest Frobenius
    norm of the velocity's gradient; ``mean_speed``: mean of the nodes' speeds; ``energy``: sum over
    springs of k (l - L)^2.
    """

    step: Floats
    dt: Floats
    c: Floats
    gradient: Floats
    mean_speed: Floats
    energy: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Relaxation:
    """A relaxed mesh and how it got there.

    ``uv`` (rows, cols, 2) in pitches is as the motion left it, not turned or shifted back, NaN
    where there is no node; ``energy`` the sum of k (l - L)^2 in pitches squared (Eq. 1);
    ``inverted`` the number of cells with a triangle that is empty or does not turn as the start
    does as a whole.
    """

    uv: Floats
    energy: float
    outcome: Outcome
    steps: int
    history: MotionHistory
    inverted: int


def relax_dynamically(
    start: Floats,
    rest: Floats,
    *,
    stiffness: Floats | None = None,
    params: RelaxationParams | None = None,
) -> Relaxation:
    """Let a spring mesh swing to rest in the plane.

    Parameters
    ----------
    start : (rows, cols, 2); where the nodes are let go, in mean pitches; NaN where there is no node
    rest : (4, rows, cols)
        Rest lengths in mean pitches of the springs (i, j)-(i, j + 1), (i, j)-(i + 1, j), (i, j)-(i
        + 1, j + 1) and (i, j + 1)-(i + 1, j); NaN where there is no spring.
    stiffness : (4, rows, cols), optional
        Spring constants, 1 where not given. They are divided by the largest, which changes the unit
        of time and leaves the state of rest as it is: the limits on the time step hold for a
        constant of 1.
    params : RelaxationParams, optional

    Notes
    -----
    Hirn et al. (2009), Eqs. (2) to (6), with these readings. The force is Hooke's as the text words
    it: a stretched spring pulls its ends together; Eq. (2) as printed has the other sign. The mean
    of Eq. (6) is taken over the nodes. The gradient of the velocity is taken by central differences
    between neighbouring nodes, one-sided at borders and beside missing nodes, and its Frobenius
    norm is what a and b limit. The damping starts at ``sqrt(max |grad F| / b)``, which is Eq. (5)
    for the overdamped velocity F / c: the paper asks for a high damping at the start, where the
    velocity is still zero.

    Nothing in the energy forbids a fold. The step control keeps a fair start from folding; cells
    that are turned over in the start may stay so. They are counted at the end.
    """
    start = np.asarray(start, dtype=np.float64)
    rest = np.asarray(rest, dtype=np.float64)
    stiff = np.asarray(np.ones_like(rest) if stiffness is None else stiffness, dtype=np.float64)
    spring_shape = (4, *start.shape[:2])
    if start.shape[2:] != (2,) or not rest.shape == stiff.shape == spring_shape:
        raise CannotFlatten(
            f"Nodes {start.shape}, rest lengths {rest.shape} and stiffness {stiff.shape} do not fit"
            " together; needed are (rows, cols, 2) and twice (4, rows, cols). Make all of them"
            " from one mesh."
        )
    is_node = are_known(start)
    tied = of_springs(is_node, np.logical_and, np.zeros(rest.shape, bool))
    tied &= np.isfinite(rest) & np.isfinite(stiff)
    unit = float(np.max(stiff, where=tied, initial=0.0)) or 1.0
    x = _framed(np.moveaxis(start, -1, 0), is_node)
    springs = (_framed(rest, tied), _framed(stiff / unit, tied))
    mask = _framed(np.ones_like(start[..., 0]), is_node)
    # a mesh that leaves the finite numbers is an outcome.
    with np.errstate(invalid="ignore", over="ignore"):
        outcome, energy, log = _motion(x, springs, mask, params or RelaxationParams())
        inside = np.moveaxis(x[:, 1:-1, 1:-1], 0, -1)
        uv = np.where(is_node[..., None], inside, np.nan)
        side = np.sign(np.nansum(triangle_areas(start)))
        inverted = int(np.count_nonzero(folded_cells(start, uv, side=side)))
    if inverted and outcome is Outcome.RESTED:
        outcome = Outcome.FOLDED
    log[:, 4] *= unit  # the energy
    step_numbers = np.arange(1.0, len(log) + 1)
    history = MotionHistory(step_numbers, *log.T)
    return Relaxation(
        uv=uv,
        energy=energy * unit,
        outcome=outcome,
        steps=len(log),
        history=history,
        inverted=inverted,
    )


def _difference_weights(mask: Floats) -> Floats:
    """Weights of the differences to the neighbours right, left, below and above (4, rows, cols).

    ``mask`` is framed, 1 at nodes. A half where both neighbours of a pair are nodes, 1 where only
    this one is, 0 where it is not.
    """
    left = np.roll(mask, 1, axis=1)
    right = np.roll(mask, -1, axis=1)
    above = np.roll(mask, 1, axis=0)
    below = np.roll(mask, -1, axis=0)
    pairs = ((right, left), (left, right), (below, above), (above, below))
    return np.stack([mask * side * (1.0 - 0.5 * opposite) for side, opposite in pairs])


def _time_step(p: RelaxationParams, dt: float, gradient: float) -> float:
    """Time step by Eq. (4) as ``control`` reads it, after one of ``dt``."""
    if p.control == "scale":
        return min(p.dt_max, p.a / gradient if gradient > 0.0 else np.inf)
    if p.control == "feedback":
        # The paper has no numbers for it; any come to a halt.
        return dt * 0.5 if gradient >= p.a else min(p.dt_max, dt * 1.1)
    return dt


def _damping(p: RelaxationParams, c: float, gradient: float) -> float:
    """Damping by Eq. (5), after one of ``c``."""
    if p.control == "fixed":
        return p.fixed_c
    return max(p.c_min, gradient / p.b, p.c_fall * c)


def _is_at_rest(
    p: RelaxationParams, largest_force: float, calm_time: float, period: float, *, has_moved: bool
) -> bool:
    """Whether a mesh that has been slow for so long rests, by Eq. (6) as ``stop`` reads it."""
    if p.stop == "first":
        return has_moved and calm_time > 0.0
    if p.stop == "sustained":
        return calm_time >= period
    return largest_force < p.residual


def _motion(
    x: Floats, springs: Springs, mask: Floats, p: RelaxationParams
) -> tuple[Outcome, float, Floats]:
    """Move ``x`` (2, rows + 2, cols + 2) until it rests.

    Give how it ended, the energy, and of each step (steps, 5) its time step, damping, gradient,
    mean speed and energy. ``mask`` is 1 at nodes; all arrays are framed.
    """
    weights = _difference_weights(mask)
    nodes = np.count_nonzero(mask)
    period = 2.0 * (max(mask.shape) - 2)
    v = np.zeros_like(x)
    next_v = np.zeros_like(x)
    f = np.zeros_like(x)
    energy, largest_force = set_force(x, *springs, f)
    dt = p.fixed_dt
    force_gradient, _, _ = mix(v, 0.0, f, 1.0, weights, next_v)
    c = max(p.c_min, np.sqrt(force_gradient / p.b))
    gradient = time = calm_time = 0.0
    has_moved = False
    # Without any force there is no motion to wait for.
    outcome = Outcome.RESTED if largest_force == 0.0 else Outcome.OUT_OF_STEPS
    step_log: list[tuple[float, ...]] = []

    def accelerate() -> tuple[float, float, float]:
        """Set the velocities after ``dt``.

        Give their largest gradient, the fastest, and their sum.
        """
        if p.integrator == "euler":
            return mix(v, 1.0 - c * dt, f, dt, weights, next_v)
        slowing = 1.0 + c * dt
        return mix(v, 1.0 / slowing, f, dt / slowing, weights, next_v)

    while outcome is Outcome.OUT_OF_STEPS and len(step_log) < p.most_steps:
        c = _damping(p, c, gradient)
        dt = _time_step(p, dt, gradient)
        gradient, fastest, speed_sum = accelerate()
        if p.control == "scale" and dt * gradient > p.a:
            dt = p.a / gradient
            gradient, fastest, speed_sum = accelerate()
        if p.control != "fixed" and fastest * dt > p.most_move:
            dt *= p.most_move / (fastest * dt)
            gradient, fastest, speed_sum = accelerate()
        if p.integrator == "rk4":
            x[:], next_v[:] = _runge_kutta(x, v, f, springs, dt, c)
            gradient, _, speed_sum = mix(next_v, 1.0, f, 0.0, weights, next_v)
        else:
            x += dt * (v if p.integrator == "euler" else next_v)
        energy, largest_force = set_force(x, *springs, f)
        v, next_v = next_v, v
        mean_speed = speed_sum / nodes
        step_log.append((dt, c, gradient, mean_speed, energy))
        time += dt
        is_fast = bool(mean_speed > p.mean_speed)
        # A mesh that has not been fast within a period of its slowest mode will never be.
        has_moved |= is_fast or time >= period
        calm_time = 0.0 if is_fast else calm_time + dt
        if not np.isfinite(mean_speed + energy):
            outcome = Outcome.NOT_FINITE
        elif _is_at_rest(p, largest_force, calm_time, period, has_moved=has_moved):
            outcome = Outcome.RESTED
    return outcome, energy, np.array(step_log).reshape(-1, 5)


def _runge_kutta(
    x: Floats, v: Floats, f: Floats, springs: Springs, dt: float, c: float
) -> tuple[Floats, Floats]:
    """Places and velocities after ``dt`` by the classical method of fourth order.

    ``x``, ``v`` and ``f`` (2, rows + 2, cols + 2) are places, velocities and the force, which is
    overwritten; ``c`` is the damping.
    """
    stage_x, stage_v, new_x, new_v = x, v, x, v
    weights = (dt / 6, dt / 3, dt / 3, dt / 6)
    # How far from the start the next force is asked for; after the last it is not.
    stage_steps = (dt / 2, dt / 2, dt, 0.0)
    for weight, stage_dt in zip(weights, stage_steps, strict=True):
        set_force(stage_x, *springs, f)
        acceleration = f - c * stage_v
        new_x = new_x + weight * stage_v
        new_v = new_v + weight * acceleration
        stage_x = x + stage_dt * stage_v
        stage_v = v + stage_dt * acceleration
    return new_x, new_v


def _framed(values: Floats, mask: Bools) -> Floats:
    """Values (..., rows, cols) with a ring around them; 0 there and where the mask is not set."""
    ring = ((0, 0),) * (values.ndim - 2) + ((1, 1), (1, 1))
    return np.pad(np.where(mask, values, 0.0), ring)
