import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatten.meshes import grid, in_space, on_sphere
from planish.flatten import distortion, geodesic_error


def triangles(whole):
    for i, j in np.argwhere(whole):
        a, b, c, d = (i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)
        yield a, b, c
        yield a, c, d


def edges_of(half):
    a, b, c = half
    return (a, b), (b, c), (c, a)


def cross(p, q):
    return p[0] * q[1] - p[1] * q[0]


def holds(half, uv, place):
    return all(cross(uv[b] - uv[a], place - uv[a]) >= 0 for a, b in edges_of(half))


def slow_length(points, uv, p, q, start, end):
    """Every edge of the mesh is cut with the line; the cuts, in order, are the line on the
    surface."""
    halves = list(triangles(distortion.whole_cells(points, uv)))
    cuts = [(0.0, start), (1.0, end)]
    for a, b in {tuple(sorted(edge)) for half in halves for edge in edges_of(half)}:
        side = uv[b] - uv[a]
        across = cross(q - p, side)
        t, s = cross(uv[a] - p, side) / across, cross(uv[a] - p, q - p) / across
        if 0 < t < 1 and 0 <= s <= 1:
            cuts.append((t, points[a] + s * (points[b] - points[a])))
    cuts.sort(key=lambda cut: cut[0])
    for (t0, _), (t1, _) in itertools.pairwise(cuts):
        middle = p + 0.5 * (t0 + t1) * (q - p)
        if t1 - t0 > 1e-9 and not any(holds(half, uv, middle) for half in halves):
            return np.nan
    return sum(float(np.linalg.norm(b - a)) for (_, a), (_, b) in itertools.pairwise(cuts))


@given(st.integers(0, 10_000))
@settings(max_examples=7)
def test_traced_lengths_equal_the_slow_twin(seed):
    """Warped, rough mesh with a ragged outline and a hole, its cells up to a third out of shape but
    not folded."""
    rng = np.random.default_rng(seed)
    uv = grid(8, 10) + rng.uniform(-0.15, 0.15, (8, 10, 2))
    points = np.concatenate([uv * [1.1, 0.9], rng.normal(0, 0.4, (8, 10, 1))], axis=-1)
    points[rng.random((8, 10)) < 0.04] = np.nan
    points[3, 4] = np.nan
    whole = distortion.whole_cells(points, uv)
    start, end = distortion.random_places(whole, 12, rng), distortion.random_places(whole, 12, rng)
    flat, space = distortion.trace_lines(points, uv, start, end)
    p, q = start.on(uv), end.on(uv)
    slow = [
        slow_length(points, uv, *ends)
        for ends in zip(p, q, start.on(points), end.on(points), strict=True)
    ]
    np.testing.assert_allclose(flat, np.linalg.norm(q - p, axis=1))
    np.testing.assert_allclose(space, slow, rtol=1e-9)


def errors(points, uv):
    return geodesic_error(points, uv, rng=np.random.default_rng(0))


@pytest.mark.parametrize("direction", [(2, 1), (-1, 1), (1, -2)])
def test_lines_through_nodes_do_no_harm(direction):
    """A quarter of the way from one node of a regular mesh to one in line with it, to as far before
    a third."""
    uv = grid(12, 12, 7.0)
    points = in_space(uv)
    node, d = (
        np.array([8 if direction[0] < 0 else 2, 8 if direction[1] < 0 else 2]),
        np.array(direction),
    )
    ends = []
    for at in (node + d / 4, node + 3 * d - d / 4):
        cell = np.floor(at).astype(int)
        x, y = at - cell
        half, weights = (0, [1 - x, x - y, y]) if x > y else (1, [1 - y, x, y - x])
        shares = np.array([weights], dtype=float)
        ends.append(
            distortion.MeshPoints(row=cell[1:], col=cell[:1], half=np.array([half]), weights=shares)
        )
    flat, space = distortion.trace_lines(points, uv, *ends)
    assert (flat, space) == (pytest.approx([7 * 2.5 * np.hypot(*direction)]), pytest.approx(flat))


def test_uniform_growth_is_the_error_of_every_line_and_a_generator_repeats_it():
    uv = grid(20, 30, 4.0)
    points = in_space(uv)
    found = errors(points, 1.02 * uv)
    assert (found.p50, found.p95, found.largest) == pytest.approx((0.02, 0.02, 0.02), abs=1e-12)
    assert found.used == 1000
    uneven = errors(points, uv * [1.02, 0.98])
    assert uneven.largest <= 0.02 + 1e-12
    assert uneven.p95 > 0.015
    uv = grid(10, 10)
    points = np.concatenate([uv, np.sin(uv[..., :1])], axis=-1)
    assert errors(points, uv) == errors(points, uv)


def test_great_circles_of_a_cap():
    """Distances from the middle are kept, all others grow: at most by r / sin(r), r the angle of
    the rim."""
    radius, uv = 5000.0, grid(81, 81, 20.0) - 800.0
    r = np.linalg.norm(uv, axis=-1) / radius
    points = on_sphere(uv, radius)
    whole = distortion.whole_cells(points, uv)
    end = distortion.random_places(whole, 300, np.random.default_rng(0))
    ones = np.ones(300, dtype=np.intp)
    middle = distortion.MeshPoints(
        row=40 * ones,
        col=40 * ones,
        half=0 * ones,
        weights=np.tile([0.998, 0.001, 0.001], (300, 1)),
    )
    flat, space = distortion.trace_lines(points, uv, middle, end)
    # chords of 20 um, 28 um along the diagonal
    np.testing.assert_allclose(flat / space, 1.0, atol=2e-6)
    found = errors(points, uv)
    assert 1e-4 < found.p50 < found.largest < r.max() / np.sin(r.max()) - 1

    def great_circle(a, b):
        return radius * np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1))

    start = distortion.random_places(whole, 300, np.random.default_rng(1))
    _, space = distortion.trace_lines(points, uv, start, end)
    strain = r.max() / np.sin(r.max()) - 1
    # second order: the traced line is longer than the great circle by less than a few squares of
    # the strain
    excess = space / great_circle(start.on(points), end.on(points)) - 1
    assert excess.min() > -1e-5
    assert excess.max() < 3 * strain**2 + 1e-5


def test_lines_that_leave_the_sheet_single_rows_and_folded_cells_are_counted():
    """Two halves joined by a bridge at one end: lines from one half to the other mostly leave the
    sheet."""
    uv = grid(21, 21)
    points = in_space(uv)
    points[:19, 10] = np.nan
    found = errors(points, uv)
    assert found.used + found.dropped == 1000
    assert 350 < found.dropped < 500
    assert found.largest < 1e-12
    points[:, 10] = np.nan
    assert errors(points, uv).used > 400
    uv = grid(2, 40)
    points = in_space(uv)
    found = errors(points, uv)
    assert (found.used, found.dropped) == (1000, 0)
    assert found.largest < 1e-12
    # folded over in the middle, flat lines between the layers follow the sheet there and back or
    # are given up
    folded = uv.copy()
    folded[:, 20:, 0] = 39.5 - folded[:, 20:, 0]
    over = errors(points, folded)
    assert 0 < over.used < 1000
    assert over.largest < 1e-9 or over.largest > 0.1
    nothing = errors(points * np.nan, uv)
    assert (nothing.used, nothing.dropped) == (0, 1000)
    assert np.isnan(nothing.p50)
