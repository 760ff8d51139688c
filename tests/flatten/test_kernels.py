"""The compiled passes against sparse matrices made spring by spring."""

import itertools

import numpy as np
import pytest
from scipy import sparse

from planish.flatten import direct, levels
from planish.flatten._kernels import FAR, forces, prepare, restrict, smooth, survey
from planish.flatten._mesh_kernels import interpolate


@pytest.fixture(scope="module", params=["whole", "gaps", "weights"])
def mesh(request):
    """A level with places off its rest, and its springs as a list."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[0:11, 0:14].astype(float)
    points = np.stack([x, y, rng.normal(0, 0.3, x.shape)], axis=-1)
    if request.param == "gaps":
        points[3:6, 4:8] = points[0, :5] = points[8, 9] = np.nan
    with levels.Team(1) as team:
        level = levels.make_springs(points, 1.0, "chord", team)[0]
    if request.param == "weights":
        levels.stiffen(level, rng.uniform(0.2, 1.0, x.shape))
    level.open()
    inside = np.s_[:, 1:12, 1:15]
    there = np.isfinite(points).all(axis=-1)
    places = np.stack([x, y]) + rng.normal(0, 0.1, (2, 11, 14))
    level.xy[inside] = np.where(there, places, FAR)
    level.near[inside] = level.xy[inside]
    prepare(level.near, level.stiff, level.ease, 14, 1, 12)
    network = direct.Network.of(level)
    assert np.array_equal(network.mask, there)
    forces(level.xy, level.rest, level.stiff, level.force, level.sums, 14, 1, 12)
    return level, network, level.xy[inside][:, there].T


def at_nodes(level, network, array):
    return array[:, 1 : level.rows + 1, 1 : level.cols + 1][:, network.mask].T.astype(float)


def put(level, network, values):
    out = levels.padded(2, level.rows, level.cols, np.float32)
    out[:, 1 : level.rows + 1, 1 : level.cols + 1][:, network.mask] = values.T
    return out


def test_forces_and_energy(mesh):
    level, network, uv = mesh
    np.testing.assert_allclose(at_nodes(level, network, level.force), network.forces(uv), atol=2e-6)
    assert level.sums[:, 0].sum() == pytest.approx(network.energy(uv), rel=1e-12)
    survey(level.xy, level.rest, level.stiff, 1.0, level.sums, 14, 1, 12)
    assert level.sums[:, 0].sum() == pytest.approx(network.energy(uv), rel=1e-12)
    step = 1e-6
    for node in (0, 17, 60):
        for axis in (0, 1):
            there, back = uv.copy(), uv.copy()
            there[node, axis] += step
            back[node, axis] -= step
            slope = (network.energy(there) - network.energy(back)) / (2 * step)
            assert network.forces(uv)[node, axis] == pytest.approx(-0.5 * slope, abs=1e-8)


@pytest.mark.parametrize("cuts", [(1, 12), (1, 5, 6, 12)])
@pytest.mark.parametrize("kind", [0, 1, 2])
def test_smoothing(mesh, cuts, kind):
    """Also in parts, each of which only sees the others' rows as they were."""
    level, network, uv = mesh
    rng = np.random.default_rng(1)
    matrix = network.matrix(uv, exact=False)
    ease = level.ease[1:12, 1:15][network.mask].astype(float)
    # One over the largest eigenvalue of each node's own block.
    blocks = [matrix[2 * k : 2 * k + 2, 2 * k : 2 * k + 2].toarray() for k in range(len(uv))]
    np.testing.assert_allclose(ease, [1 / np.linalg.eigvalsh(b).max() for b in blocks], rtol=2e-4)
    force = put(level, network, rng.normal(size=uv.shape))
    move = put(level, network, rng.normal(size=uv.shape))
    coarse = levels.padded(2, 6, 8, np.float32)
    coarse[:, 1:7, 1:9] = rng.normal(size=(2, 6, 8))
    f = at_nodes(level, network, force)
    first = {0: 0.6 * ease[:, None] * f, 2: at_nodes(level, network, move)}
    first[1] = first[2] + fine_from(coarse, level)[network.mask]
    expected = first[kind] + 0.8 * ease[:, None] * (
        f - (matrix @ first[kind].ravel()).reshape(-1, 2)
    )
    parts = list(itertools.pairwise(cuts))
    edges = [np.ascontiguousarray(move[:, [a - 1, b]]) for a, b in parts]
    for edge, (a, b) in zip(edges, parts, strict=True):
        smooth(
            kind,
            level.near,
            level.stiff,
            level.ease,
            force,
            coarse,
            move,
            edge,
            np.float32(0.6),
            np.float32(0.8),
            14,
            a,
            b,
        )
    np.testing.assert_allclose(at_nodes(level, network, move), expected, atol=5e-6)


def fine_from(coarse, level):
    """Bilinear interpolation of every second node, by matrices."""
    p, q = (halved(n) for n in (level.rows, level.cols))
    inside = coarse[:, 1 : p.shape[1] + 1, 1 : q.shape[1] + 1].astype(float)
    return np.stack([p @ c @ q.T for c in inside], axis=-1)


def halved(n):
    out = np.zeros((n, n // 2 + 1))
    for i in range(n):
        out[i, i // 2] += 0.5
        out[i, (i + 1) // 2] += 0.5
    return out


def test_restriction_is_the_transpose_of_interpolation(mesh):
    level, network, uv = mesh
    rng = np.random.default_rng(2)
    force, move = (put(level, network, rng.normal(size=uv.shape)) for _ in range(2))
    left = np.zeros((11, 14, 2))
    moved = network.matrix(uv, exact=False) @ at_nodes(level, network, move).ravel()
    left[network.mask] = at_nodes(level, network, force) - moved.reshape(-1, 2)
    expected = np.stack([halved(11).T @ left[..., c] @ halved(14) for c in (0, 1)])
    for cuts in ((1, 7), (1, 2, 5, 7)):
        coarse = levels.padded(2, 6, 8, np.float32)
        for a, b in itertools.pairwise(cuts):
            restrict(level.near, level.stiff, force, move, coarse, 14, 8, a, b)
        np.testing.assert_allclose(coarse[:, 1:7, 1:9], expected, atol=1e-5)


def test_coarse_springs_and_interpolation_are_exact():
    """Energy of a uniform strain of a flat mesh: the same on all levels, borders and odd sizes
    included."""
    for rows, cols in ((17, 33), (16, 30), (23, 12)):
        y, x = np.mgrid[0:rows, 0:cols].astype(float)
        points = np.stack([x, y, 0 * x], axis=-1)
        with levels.Team(1) as team:
            level = levels.make_springs(points, 1.0, "chord", team)[0]
            for strain in ([[1.01, 0], [0, 1]], [[1, 0], [0, 0.99]], [[1, 0.01], [0.01, 1]]):
                fine = direct.Network.of(level)
                energy = fine.energy(np.argwhere(fine.mask)[:, ::-1] @ np.array(strain))
                coarse = levels.halve(level, team)
                net = direct.Network.of(coarse)
                assert net.energy(
                    2.0 * np.argwhere(net.mask)[:, ::-1] @ np.array(strain)
                ) == pytest.approx(energy)
    i, j = np.mgrid[0:9, 0:12].astype(float)
    coarse = levels.bordered(9, 12, np.float64)
    coarse[:, 1:10, 1:13] = np.stack([i**3 - j * i, 0.5 * j**3 + i])
    fine, near = levels.bordered(17, 23, np.float64), levels.bordered(17, 23, np.float32)
    interpolate(coarse, fine, near, 23, 12, 1, 18)
    y, x = np.mgrid[0:17, 0:23] / 2.0
    truth = np.stack([y**3 - x * y, 0.5 * x**3 + y])
    np.testing.assert_allclose(fine[:, 3:16, 3:22], truth[:, 2:15, 2:21], atol=1e-10)
    # At the border the cubic misses a point and a parabola is left.
    np.testing.assert_allclose(fine[:, 1:18, 1:24], truth, atol=0.5)


def test_newton_s_method_finds_rest():
    """A flat mesh that was disturbed goes back to no energy at all."""
    rest = levels.padded(4, 5, 6, np.float64)
    rest[0, 1:6, 1:6] = rest[1, 1:5, 1:7] = 1.0
    rest[2:, 1:5, 1:6] = np.sqrt(2)
    network = direct.Network.of(
        levels.Level(5, 6, [(1, 6)], rest, np.ones((4, 1, rest.shape[2]), np.float32))
    )
    rng = np.random.default_rng(0)
    uv = np.argwhere(network.mask)[:, ::-1] + rng.normal(0, 0.15, (30, 2))
    assert network.energy(direct.relax_exactly(network, uv)) < 1e-20
    dense = network.full_matrix(uv, exact=True)
    tied = network.matrix(uv, exact=True) - 1e-10 * sparse.eye_array(60)
    np.testing.assert_allclose(dense, tied.toarray(), atol=1e-12)
