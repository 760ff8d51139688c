"""Relax a warped quad mesh in the plane to minimum spring energy (Hirn et al.

2009, section 2.3).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import ndimage

from planish.core.errors import CannotFlatten
from planish.core.status import Outcome
from planish.core.threads import count_threads
from planish.core.transform import are_known
from planish.core.typing import Bools, Floats
from planish.flatten._kernels import FAR
from planish.flatten._mesh_kernels import lay_down, moments
from planish.flatten.distortion import cross, folded_cells
from planish.flatten.levels import (
    TRUSTED,
    Level,
    Team,
    impute_nodes,
    loose_nodes,
    make_springs,
    mean_pitch,
    near,
    pieces_of,
    stiffen,
)
from planish.flatten.multigrid import OPEN, Multigrid, Step, count_folds
from planish.flatten.relaxation import RelaxationParams, relax_dynamically

Method = Literal["multigrid", "relaxation"]
Rest = Literal["arc", "chord"]
_LEAST_SHARE = 0.02  # of the nodes: smaller pieces are specks beside the sheet
Run = tuple[int, Outcome, tuple[Step, ...]]  # steps on the finest mesh, how it ended, all steps


@dataclass(frozen=True, slots=True, kw_only=True)
class Relaxed:
    """A relaxed mesh and how it got there."""

    #: (rows, cols, 2): flat coordinates (u, v) in the unit of the points; NaN where there is no
    #: sheet.
    uv: Floats
    #: Sum over the springs of k (l - L)^2 in that unit squared, k being 1 or the lower weight of
    #: the two ends.
    energy: float
    springs: int  #: Number of the springs.
    outcome: Outcome  #: How it ended.
    steps: int  #: Of ``relaxation``: steps in time; of ``multigrid``: steps on the finest mesh.
    #: All steps, those on the coarser meshes of ``multigrid`` included, in mean pitches.
    history: tuple[Step, ...]
    #: (rows - 1, cols - 1): cells with a triangle whose signed area is not above zero, and those
    #: that are held open at next to none.
    folded: Bools
    #: (rows, cols): nodes of little weight, which were laid where the others suggest: their places
    #: are no measurement.
    imputed: Bools
    #: Share of the springs that kept their chord because the curvature of the surface is not
    #: certain there; NaN for ``rest="chord"``.
    straight_share: float
    pitch: float  #: Mean distance of neighbours along rows and columns.
    dropped: Bools  #: (rows, cols): nodes of specks beside the sheet, which were left out.


def relax_grid(
    points: Floats,
    *,
    method: Method | RelaxationParams = "multigrid",
    rest: Rest = "arc",
    weights: Floats | None = None,
    tolerance: float = 1e-6,
) -> Relaxed:
    """Flatten a grid of points in space.

    Parameters
    ----------
    points : (rows, cols, 3)
        (x, y, z) in any unit of length; not finite where there is no sheet. Neighbours in the grid
        are neighbours in the sheet; the grid need be neither regular nor a height field.
    method : {"multigrid", "relaxation"} or RelaxationParams
        How the least energy is found: directly, from the lengths along the grid, so that a sheet
        may overhang or be rolled up; or by the damped motion of Hirn et al. (2009), from the
        projection, with any constants.
    rest : {"arc", "chord"}
        Rest lengths of the springs: along the surface, or straight through space as in the paper. A
        chord is too short by the square of the surface's normal curvature k, k^2 L^3 / 24; the
        correction is left out where the curvatures at the two ends of a spring disagree, that is
        where the surface is rough at the scale of the mesh.
    weights : (rows, cols), optional
        Confidence in each node; a spring has the lower weight of its ends as stiffness. Nodes below
        a tenth of the median weight are moved to where a smooth surface through the others has
        them, and held there weakly.
    tolerance : float
        ``multigrid`` is at rest when its energy is expected to exceed the minimum by less than this
        share, or places to be wrong by less than 3e-6 pitches in the mean (root of the mean
        square).

    Returns
    -------
    Relaxed
        ``uv`` is a view in which u and v are stored apart. It lies on the projection (x, y), turned
        and shifted, and has its handedness. The number of threads changes no byte of it.

    Raises
    ------
    CannotFlatten
        If an argument does not fit, there are fewer than two by two nodes, or unconnected pieces
        that are no specks.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    _check(points, weights, tolerance, method=method, rest=rest)
    dropped = is_brace = np.zeros(points.shape[:2], dtype=bool)
    points, weights, imputed = _impute_doubtful(points, weights)
    pitch = mean_pitch(points)
    with Team(count_threads()) as team:
        level, springs, straight_share = make_springs(points, pitch, rest, team)
        # A whole mesh has this many springs, of all four families.
        whole_springs = 4 * level.rows * level.cols - 3 * (level.rows + level.cols) + 2
        has_gaps = springs < whole_springs
        if has_gaps:
            points, dropped = _drop_specks(points)
            if dropped.any():
                pitch = mean_pitch(points)
                level, springs, straight_share = make_springs(points, pitch, rest, team)
            points, weights, is_brace = _brace(points, weights)
            if is_brace.any():
                level, _, _ = make_springs(points, pitch, rest, team)
        if weights is not None:
            stiffen(level, weights)
        side = _handedness(points)
        if method == "multigrid":
            steps, outcome, history = _multigrid(level, side, team, tolerance, gaps=has_gaps)
        else:
            steps, outcome, history = _relaxation(level, points / pitch, method)
        if weights is not None and is_brace.any():
            # What holds the sheet together while it moves is not part of its energy.
            stiffen(level, np.where(is_brace, 0.0, weights))
        energy, n_folded = count_folds(level, team, side)
        level.drop_springs()
        uv = _lay_on_projection(level, points, pitch, team)
    uv[is_brace] = np.nan
    # Cells that the step rule held open are as good as folded.
    floor = 1.5 * OPEN if outcome is Outcome.HELD_OPEN else 0.0
    if n_folded or floor:
        folded = folded_cells(points, uv, side=side, floor=floor)
    else:
        folded = np.zeros((level.rows - 1, level.cols - 1), dtype=bool)
    if outcome is Outcome.RESTED and folded.any():
        outcome = Outcome.FOLDED
    return Relaxed(
        uv=uv,
        energy=energy * pitch * pitch,
        springs=springs,
        outcome=outcome,
        steps=steps,
        history=history,
        folded=folded,
        imputed=imputed,
        straight_share=straight_share,
        pitch=pitch,
        dropped=dropped,
    )


def _check(
    points: Floats,
    weights: Floats | None,
    tolerance: float,
    *,
    method: object,
    rest: object,
) -> None:
    """Refuse points of another shape, then all other arguments that do not fit in one message."""
    if points.shape[2:] != (3,):
        raise CannotFlatten(
            f"Points of shape {points.shape} were given; needed is a grid (rows, cols, 3) of x,"
            " y, z."
        )
    rows, cols = shape = points.shape[:2]
    faults: list[str] = []
    if method not in ("multigrid", "relaxation") and not isinstance(method, RelaxationParams):
        faults.append(f"method is {method!r}, needed is 'multigrid' or 'relaxation'")
    if rest not in ("arc", "chord"):
        faults.append(f"rest is {rest!r}, needed is 'arc' or 'chord'")
    if min(shape) < 2:
        faults.append(
            f"the mesh has {rows} rows and {cols} columns, at least 2 of both are needed: use a"
            " finer mesh"
        )
    if weights is not None and np.shape(weights) != shape:
        faults.append(f"the weights have the shape {np.shape(weights)}, needed is {shape}")
    if not 0 < tolerance < 1:
        faults.append(f"the tolerance is {tolerance}, needed is a share between 0 and 1")
    if faults:
        message = "; ".join(faults) + "."
        raise CannotFlatten(message[0].upper() + message[1:])


def _drop_specks(points: Floats) -> tuple[Floats, Bools]:
    """Leave out pieces with less than `_LEAST_SHARE` of all nodes.

    Give the points, and which nodes were dropped.
    """
    labels, n_pieces = pieces_of(are_known(points))
    sizes = np.bincount(labels.ravel(), minlength=n_pieces + 1)
    is_small = sizes < _LEAST_SHARE * sizes[1:].sum()
    is_small[0] = False  # not a piece, but what is between them
    is_dropped = is_small[labels]
    rest = points.copy()
    rest[is_dropped] = np.nan
    return rest, is_dropped


def _brace(points: Floats, weights: Floats | None) -> tuple[Floats, Floats | None, Bools]:
    """Add nodes around those that hang loosely on the sheet.

    Give points, weights and the added nodes. A sheet in pieces whose places to each other the
    springs do not settle is refused.
    """
    is_node = are_known(points)
    n = np.count_nonzero(is_node)
    if n < 4:
        raise CannotFlatten(
            f"The mesh has {n} nodes; at least 2 rows and 2 columns are needed. Use a finer mesh."
        )
    labels, n_pieces = pieces_of(is_node)
    if n_pieces > 1:
        sizes = np.bincount(labels.ravel())[1:]
        places = ndimage.find_objects(labels)
        piece_texts: list[str] = []
        for k in np.argsort(-sizes, kind="stable"):
            rows, cols = places[k]
            piece_texts.append(
                f"{sizes[k]} nodes in rows {rows.start}-{rows.stop - 1} and columns"
                f" {cols.start}-{cols.stop - 1}"
            )
        raise CannotFlatten(
            f"The sheet falls into {n_pieces} unconnected pieces: {_first_six(piece_texts)}. Their"
            " distance in the plane is not known: flatten each of them by itself."
        )
    is_loose, cell_counts = loose_nodes(is_node)
    # Stiff parts that are no specks.
    large = cell_counts[cell_counts > _LEAST_SHARE * cell_counts.sum()]
    if large.size != 1:
        counts_text = _first_six([str(count) for count in np.flip(np.sort(large))])
        raise CannotFlatten(
            f"The sheet falls into {large.size} pieces of {counts_text} cells that hang together by"
            " single nodes at most. How they are turned against each other is not known: cut them"
            " apart there, and flatten each by itself."
        )
    if not is_loose.any():
        return points, weights, is_loose
    is_brace = near(is_loose) & ~is_node
    points, weights = impute_nodes(points, weights, is_node, is_brace)
    return points, weights, is_brace


def _first_six(texts: list[str]) -> str:
    return ", ".join(texts[:6]) + " ..." * (len(texts) > 6)


def _impute_doubtful(points: Floats, weights: Floats | None) -> tuple[Floats, Floats | None, Bools]:
    """Impute the nodes of little weight.

    Give points, the weights if they differ (None if not), and the nodes (rows, cols) that are
    imputed.
    """
    if weights is None:
        return points, None, np.zeros(points.shape[:2], dtype=bool)
    weights = np.asarray(weights, dtype=np.float64)
    is_node = are_known(points)
    node_weights = weights[is_node]
    is_weight = np.isfinite(node_weights) & (node_weights >= 0)
    if not (is_weight.all() and node_weights.any()):
        raise CannotFlatten(
            "A weight is negative or not finite, or all are 0. Give a confidence from 0 upwards."
        )
    least_weight = TRUSTED * np.median(node_weights[node_weights > 0])
    is_doubtful = is_node & (weights < least_weight)
    is_trusted = is_node & ~is_doubtful
    n_trusted = np.count_nonzero(is_trusted)
    if n_trusted < 4:
        raise CannotFlatten(
            f"{n_trusted} nodes have more than a tenth of the median weight, at least 4 are needed."
            " Give the nodes that were measured a higher weight."
        )
    if is_doubtful.any():
        points, weights = impute_nodes(points, weights, is_trusted, is_doubtful)
        return points, weights, is_doubtful
    if np.all(node_weights == 1):
        return points, None, is_doubtful
    return points, np.where(is_node, weights, 0.0), is_doubtful


def _handedness(points: Floats) -> float:
    """Tell by 1 or -1 whether columns and rows of the grid run like u and v.

    1 where they do, -1 where they run in the opposite sense, as a whole.
    """
    # Some 20 rows and columns tell it.
    row_step, col_step = (max(1, (n - 1) // 20) for n in points.shape[:2])
    flat = points[::row_step, ::col_step, :2]
    across = np.diff(flat, axis=1)[:-1]
    down = np.diff(flat, axis=0)[:, :-1]
    return -1.0 if np.nansum(cross(across, down)) < 0 else 1.0


def _multigrid(level: Level, side: float, team: Team, tolerance: float, *, gaps: bool) -> Run:
    """Relax by multigrid, and once more with steps that may close no cell where cells folded.

    ``side`` is the handedness of the grid, ``gaps`` whether springs are missing. Gives the steps on
    the finest mesh, how the last run ended, and all steps of both runs.
    """
    history: list[Step] = []
    outcome = Outcome.NOT_FINITE
    for guarded in (False, True):
        solver = Multigrid(level, team, gaps=gaps, side=side, guarded=guarded)
        outcome = solver.run(tolerance)
        history += solver.history
        is_done = outcome in (Outcome.RESTED, Outcome.OUT_OF_STEPS)
        if is_done and count_folds(level, team, side)[1] == 0:
            break
    finest_steps = sum(step.nodes == level.rows * level.cols for step in history)
    return finest_steps, outcome, tuple(history)


def _relaxation(level: Level, points: Floats, method: Method | RelaxationParams) -> Run:
    """Relax by the damped motion of Hirn et al. (2009), from the projection.

    ``points`` (rows, cols, 3) are in pitches. The springs of ``level`` are taken, and its ``xy``
    is set to the places at rest.
    """
    start = np.where(are_known(points)[..., None], points[..., :2], np.nan)
    params = method if isinstance(method, RelaxationParams) else RelaxationParams()
    lengths = np.where(level.rest > 0, level.rest, np.nan)
    stiffness = level.inside(level.full_stiff)
    relaxation = relax_dynamically(start, level.inside(lengths), stiffness=stiffness, params=params)
    level.open()
    uv = np.moveaxis(relaxation.uv, -1, 0)
    is_node = np.isfinite(uv)
    level.inside(level.xy)[:] = np.where(is_node, uv, FAR)
    n_nodes = int(np.count_nonzero(is_node[0]))
    motion = relaxation.history
    mean_moves = motion.mean_speed * motion.dt
    moves = zip(motion.energy, mean_moves, strict=True)
    # It expects no gain before a step.
    history = tuple(Step(n_nodes, energy, np.nan, move) for energy, move in moves)
    return relaxation.steps, relaxation.outcome, history


def _lay_on_projection(level: Level, points: Floats, pitch: float, team: Team) -> Floats:
    """Turn and shift the places of ``level`` onto ``points`` (x, y), the least squares' way.

    Gives them (rows, cols, 2) in the unit of ``points``; ``level`` has them in pitches.
    """
    row_sums = np.zeros((level.rows + 2, 7))
    team.run(moments, level.parts, points, 1 / pitch, level.xy, row_sums)
    # Sums over the nodes of places (u, v) and of targets (p, q), and of their products.
    n_nodes, u, v, p, q, sum_dot, sum_cross = row_sums.sum(axis=0)
    n_nodes = max(n_nodes, 1.0)
    cross_sum = sum_cross - (u * q - v * p) / n_nodes
    dot_sum = sum_dot - (u * p + v * q) / n_nodes
    angle = np.arctan2(cross_sum, dot_sum)
    cos = float(np.cos(angle))
    sin = float(np.sin(angle))
    shift_u = (p - cos * u + sin * v) / n_nodes
    shift_v = (q - sin * u - cos * v) / n_nodes
    motion = (cos, sin, shift_u, shift_v, pitch)
    team.run(lay_down, level.parts, level.xy, *motion, level.cols)
    # In place, u and v apart: a copy would cost as much memory as all the corrections.
    return np.moveaxis(level.inside(level.xy), 0, -1)
