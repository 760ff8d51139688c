import itertools

import numpy as np
import pytest

from naive import relax as slow_relax
from naive import springs as slow_springs
from planish.core.errors import CannotFlatten
from planish.core.outcome import Outcome
from planish.flatten import cell_strain, edge_strain, relax_grid
from planish.flatten.springs import make_springs


def cylinder(rows, cols, radius, pitch):
    """Points of a cylinder, evenly spaced in x; the flat width follows from the arc."""
    x = np.linspace(-0.45 * radius, 0.45 * radius, cols)
    y = np.arange(rows) * pitch
    grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
    return np.stack([grid_x, grid_y, np.sqrt(radius**2 - grid_x**2)], axis=-1)


def test_springs_equal_the_slow_twin():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(5, 6, 3))
    points[2, 3] = np.nan
    fast, slow = make_springs(points), slow_springs(points)
    assert fast.rest.size == len(slow)
    np.testing.assert_allclose(np.sort(fast.rest), np.sort([length for _, _, length in slow]))


def test_energy_minimum_equals_the_slow_twin():
    rng = np.random.default_rng(2)
    y, x = np.mgrid[0:7, 0:9].astype(float)
    points = np.stack([x, y, 0.8 * np.sin(x / 2) * np.cos(y / 3) + 0.05 * rng.normal(size=x.shape)], axis=-1)
    found = relax_grid(points, tolerance=1e-10)
    _, energy = slow_relax(points)
    assert found.outcome is Outcome.RESTED
    assert found.energy == pytest.approx(energy, rel=1e-7)


def test_a_cylinder_unrolls_to_its_arc_length():
    """Chords are shorter than arcs by h^2 / 24 R^2 at most, here 4e-6 of the length."""
    points = cylinder(30, 200, 1000.0, 9.0)
    flat = relax_grid(points).uv
    width = np.linalg.norm(flat[:, -1] - flat[:, 0], axis=1)
    assert width == pytest.approx(2 * 1000.0 * np.arcsin(0.45), rel=2e-5)
    across, along = edge_strain(points, flat)
    # uneven columns leave the diagonals a little too long for a flat cell: a few 1e-5
    assert max(np.abs(across).max(), np.abs(along).max()) < 2e-4


def test_flat_stays_flat_and_where_it_was():
    y, x = np.mgrid[0:6, 0:8] * 5.0
    found = relax_grid(np.stack([x, y, np.zeros_like(x)], axis=-1))
    np.testing.assert_allclose(found.uv, np.stack([x, y], axis=-1), atol=1e-9)
    assert found.energy < 1e-12


def test_energy_never_rises_and_no_cell_folds():
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:20, 0:24].astype(float)
    found = relax_grid(np.stack([x, y, rng.normal(0, 0.35, x.shape)], axis=-1))
    energies = [e for e, _ in found.history]
    assert all(b <= a * (1 + 1e-9) for a, b in itertools.pairwise(energies))
    assert not found.folded.any()


def test_a_sphere_keeps_strain_and_says_so():
    """A cap cannot be flat: strain of the order of K a^2 / 16 (K curvature, a half size), where K a^2 = 0.0256."""
    y, x = np.mgrid[-20:21, -20:21] * 4.0
    points = np.stack([x, y, np.sqrt(500.0**2 - x**2 - y**2)], axis=-1)
    strain = cell_strain(points, relax_grid(points).uv)
    assert 0.002 < float(strain["stretch_max"].max()) - 1 < 0.01
    assert float(strain["stretch_min"].min()) < 0.999


def test_an_isometry_has_no_strain():
    y, x = np.mgrid[0:5, 0:5] * 2.0
    uv = np.stack([x, y], axis=-1)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    points = np.concatenate([uv @ turn.T, np.zeros((5, 5, 1))], axis=-1)
    strain = cell_strain(points, uv)
    np.testing.assert_allclose(strain["area_ratio"], 1.0, atol=1e-12)
    np.testing.assert_allclose(strain["shear"], 0.0, atol=1e-12)


def test_holes_and_irregular_outlines():
    points = cylinder(20, 30, 400.0, 6.0)
    points[8:12, 10:14] = np.nan
    points[:5, :7] = np.nan
    found = relax_grid(points)
    assert np.array_equal(np.isnan(found.uv[..., 0]), np.isnan(points[..., 0]))
    assert found.outcome is Outcome.RESTED


def test_pieces_are_counted():
    points = cylinder(10, 30, 400.0, 6.0)
    points[:, 14:16] = np.nan
    with pytest.raises(CannotFlatten, match="2 unconnected pieces"):
        relax_grid(points)
    with pytest.raises(CannotFlatten, match="at least"):
        relax_grid(points[:1])


@pytest.mark.parametrize("crease", [10.6, 11.0, 11.3])
def test_folds_are_named(crease):
    """A start with one end turned over keeps all lengths: a minimum, but a folded one. At 11 some nodes coincide."""
    y, x = np.mgrid[0:8, 0:10].astype(float)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    start = points[..., :2].copy()
    start[:, 6:, 0] = crease - start[:, 6:, 0]
    found = relax_grid(points, start=start)
    assert found.outcome is Outcome.FOLDED
    assert found.folded[:, 6:].all()
    assert not found.folded[:, :4].any()


def test_one_displaced_node_is_put_back():
    y, x = np.mgrid[0:8, 0:10].astype(float)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    start = points[..., :2].copy()
    start[3, 4] += [2.6, 0.0]
    found = relax_grid(points, start=start)
    assert found.outcome is Outcome.RESTED
    assert not found.folded.any()
