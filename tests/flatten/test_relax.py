import threading

import numpy as np
import pytest
from scipy import ndimage

from flatten.meshes import distances, grid, in_space, on_cylinder, on_sphere
from folders import refused
from naive import relax as slow_relax
from naive import springs as slow_springs
from planish.core.errors import CannotFlatten
from planish.core.status import Outcome
from planish.core.threads import limit_threads
from planish.flatten import cell_strain, edge_strain, levels, multigrid, relax_grid


def cylinder(rows, cols, radius, pitch):
    """Points of a cylinder, evenly spaced in x; the flat width follows from the arc."""
    x = np.linspace(-0.45 * radius, 0.45 * radius, cols)
    y = np.arange(rows) * pitch
    grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
    return np.stack([grid_x, grid_y, np.sqrt(radius**2 - grid_x**2)], axis=-1)


def rolled(rows, cols, pitch, *, angle):
    """An arc of radius 1 unit by ``angle``, oblique to the grid, and its flat places; beyond pi it
    overhangs."""
    uv, turn = grid(rows, cols, pitch), 0.4
    length = uv[-1, -1] @ [np.cos(turn), np.sin(turn)]
    return on_cylinder(uv, length / angle, turn), uv


def bumpy(rows, cols, *, seed=2, noise=0.0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:rows, 0:cols].astype(float)
    z = 0.15 * cols * np.sin(2.1 * x / cols + 1) * np.cos(3.0 * y / rows) + noise * rng.normal(
        size=x.shape
    )
    return np.stack([x, y, z], axis=-1)


def laid(points, **more):
    """A sheet that came to rest and has no fold."""
    found = relax_grid(points, **more)
    assert found.outcome is Outcome.RESTED
    assert not found.folded.any()
    return found


def test_rest_lengths_equal_the_slow_twin():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(5, 6, 3))
    points[2, 3] = np.nan
    points[4, 1, 2] = np.nan
    with levels.Team(1) as team:
        level, count, straight = levels.make_springs(points, 2.0, "chord", team)
    slow = slow_springs(points)
    assert count == len(slow)
    assert np.isnan(straight)
    rest = level.rest[level.rest > 0]
    np.testing.assert_allclose(np.sort(rest), np.sort([length / 2 for _, _, length in slow]))


@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi / 2])
def test_arcs_are_right_to_the_fourth_power_of_the_pitch(angle):
    """On a cylinder of radius 40 the chord of a spring is short by up to 1 / (24 40^2) = 2.6e-5 of
    it."""
    points = on_cylinder(grid(30, 30), 40.0, angle)
    with levels.Team(1) as team:
        arc, chord = (
            levels.make_springs(points, 1.0, rest, team)[0].rest for rest in ("arc", "chord")
        )
    # Along the rows, where the flat sheet has a pitch of 1, away from the border.
    worst = [np.abs(rest[0, 2:30, 2:29] - 1.0).max() for rest in (arc, chord)]
    assert worst[0] < 2e-6
    assert worst[0] < worst[1] / 10 or worst[1] < 1e-12


def test_roughness_is_not_taken_for_curvature():
    """White noise at every node: the arcs would lengthen every spring; they are left out almost
    everywhere."""
    points = bumpy(60, 60, noise=0.1)
    found = relax_grid(points), relax_grid(points, rest="chord")
    assert found[0].straight_share > 0.6
    sizes = [np.sqrt(np.mean((k.uv - k.uv.mean(axis=(0, 1))) ** 2)) for k in found]
    assert sizes[0] / sizes[1] - 1 < 2e-4
    assert relax_grid(bumpy(60, 60)).straight_share < 0.05


@pytest.mark.parametrize("shape", [(2, 2), (2, 12), (5, 6)])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_energy_minimum_equals_the_slow_twin(shape, noise):
    points = bumpy(*shape, noise=noise)
    found = relax_grid(points, tolerance=1e-10, rest="chord")
    _, energy = slow_relax(points)
    assert found.outcome is Outcome.RESTED
    # or both are next to nothing: the mean strain is then below 1e-5
    assert found.energy == pytest.approx(energy, rel=1e-6, abs=1e-10 * found.springs)


def test_a_cylinder_unrolls_to_its_arc_length():
    points = cylinder(30, 200, 1000.0, 9.0)
    flat = relax_grid(points).uv
    width = np.linalg.norm(flat[:, -1] - flat[:, 0], axis=1)
    # a hundredth of what chords would lose, h^2 / 24 R^2 = 4e-6
    assert width == pytest.approx(2 * 1000.0 * np.arcsin(0.45), rel=1e-7)
    across, along = edge_strain(points, flat)
    assert max(np.abs(across).max(), np.abs(along).max()) < 2e-5


@pytest.mark.parametrize("angle", [3.0, 12.0])
def test_a_sheet_may_overhang_or_be_rolled_up(angle):
    """At 12 rad the sheet is rolled on itself almost twice: it has no projection that could be a
    start."""
    points, truth = rolled(40, 120, 5.0, angle=angle)
    found = laid(points)
    # Rolled up, it shows either face.
    assert min(distances(found.uv * [1, turned], truth).max() for turned in (1, -1)) < 0.01 * 5.0


def test_flat_stays_flat_and_pitches_may_differ():
    uv = grid(6, 8, 5.0)
    found = relax_grid(in_space(uv))
    np.testing.assert_allclose(found.uv, uv, atol=1e-9)
    assert found.energy < 1e-12
    points, truth = rolled(60, 80, 4.0, angle=2.0)
    thin = relax_grid(points[::4]).uv
    assert distances(thin, truth[::4]).max() < 0.05 * 4.0
    assert distances(relax_grid(points[:, ::4]).uv, truth[:, ::4]).max() < 0.05 * 4.0


@pytest.mark.parametrize("flip", [(1, 1, 1), (-1, 1, 1)])
def test_the_result_has_the_handedness_and_place_of_the_projection(flip):
    points = 3.0 * bumpy(30, 40) * flip + [500.0, -70.0, 9.0]
    found = laid(points)
    np.testing.assert_allclose(
        found.uv.mean(axis=(0, 1)), points[..., :2].mean(axis=(0, 1)), atol=1e-6
    )
    assert np.linalg.norm(found.uv - points[..., :2], axis=-1).max() < 0.2 * np.ptp(points[..., 0])


def test_rough_sheets_do_not_fold_and_steep_ones_are_held_open_and_named():
    points = in_space(grid(60, 64))
    noise = np.random.default_rng(3).normal(size=(60, 64))
    points[..., 2] = 0.35 * noise
    laid(points)
    # Node to node slopes of 1 and more: no flat sheet has these lengths.
    points[..., 2] = 1.2 * noise
    found = relax_grid(points)
    assert found.outcome in (Outcome.HELD_OPEN, Outcome.FOLDED, Outcome.OUT_OF_STEPS)
    areas = cell_strain(points, found.uv)["signed_area"].values
    assert (areas[~found.folded] > 0).all()


def test_a_sphere_keeps_strain_and_says_so():
    """A cap cannot be flat: strain of the order of K a^2 / 16 (K curvature, a half size), where K
    a^2 = 0.0256."""
    points = on_sphere(grid(41, 41, 4.0) - 80.0, 500.0)
    strain = cell_strain(points, relax_grid(points).uv)
    assert 0.002 < float(strain["stretch_max"].max()) - 1 < 0.01
    assert float(strain["stretch_min"].min()) < 0.999


@pytest.mark.parametrize("kind", ["holes", "salt", "torn"])
def test_masks_keep_the_truth(kind):
    """Within twice the limit for a whole sheet of this size, 3e-4 pitches (root of the mean
    square)."""
    points, truth = rolled(96, 128, 1.0, angle=2.0)
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:96, :128]
    gone = np.zeros((96, 128), dtype=bool)
    if kind == "holes":
        while gone.mean() < 0.1:
            gone |= (y - rng.uniform(0, 96)) ** 2 + (x - rng.uniform(0, 128)) ** 2 < 49
    elif kind == "salt":
        gone = rng.random(gone.shape) < 0.1
    else:
        depth = np.abs(np.cumsum(rng.normal(size=96)))[:, None]
        gone = (x < depth) | (x > 127 - depth)
    labels = ndimage.label(~gone, structure=np.ones((3, 3)))[0]
    gone = labels != 1 + np.argmax(np.bincount(labels.ravel())[1:])
    points[gone] = truth[gone] = np.nan
    found = laid(points)
    assert np.array_equal(np.isnan(found.uv[..., 0]), gone)
    assert np.sqrt(np.mean(distances(found.uv, truth) ** 2)) < 6e-4


@pytest.mark.parametrize("weight", [0.0, 0.09])
def test_doubted_nodes_do_not_steer(weight):
    points, truth = rolled(60, 80, 2.0, angle=2.0)
    rng = np.random.default_rng(1)
    wrong = rng.random((60, 80)) < 1 / 7
    points[wrong, 2] += rng.normal(0, 30.0, np.count_nonzero(wrong))
    found = relax_grid(points, weights=np.where(wrong, weight, 1.0))
    assert distances(found.uv, truth).max() < 0.01 * 2.0
    assert np.array_equal(found.imputed, wrong)
    assert distances(relax_grid(points).uv, truth).max() > 1.0


def test_weights_are_stiffness():
    """Half of the sheet pulls with a tenth of the force: the energy counts it by as much, and it
    takes the strain."""
    points = bumpy(30, 40, noise=0.1)
    even = relax_grid(points, tolerance=1e-9, rest="chord")
    half = np.where(np.arange(40) < 20, 1.0, 0.2) * np.ones((30, 1))
    uneven = relax_grid(points, tolerance=1e-9, rest="chord", weights=half)
    # Along the columns, in the stiff half.
    strain = [np.abs(edge_strain(points, found.uv)[0][:, :18]).mean() for found in (even, uneven)]
    assert strain[1] < strain[0]
    assert uneven.energy < even.energy
    doubled = relax_grid(points, tolerance=1e-9, rest="chord", weights=np.full((30, 40), 2.0))
    assert doubled.energy == pytest.approx(2 * even.energy, rel=1e-6)
    np.testing.assert_allclose(doubled.uv, even.uv, atol=1e-4)


def test_pieces_are_named_or_refused_and_a_node_on_one_spring_is_laid_straight_on():
    points = cylinder(10, 30, 400.0, 6.0)
    points[:, 14:16] = np.nan
    points[2, 15] = np.nan
    named = "140 nodes in rows 0-9 and columns 0-13, 140 nodes in rows 0-9 and columns 16-29"
    refused(CannotFlatten, f"2 unconnected pieces: {named}", relax_grid, points)
    refused(CannotFlatten, "at least", relax_grid, points[:1])
    points = cylinder(21, 40, 400.0, 6.0)
    points[np.arange(21) != 10, 20] = np.nan
    points[9:12:2, 21] = np.nan
    refused(CannotFlatten, "hang together by single nodes", relax_grid, points)
    points, truth = rolled(40, 50, 1.0, angle=1.5)
    points[:, 41:] = points[np.arange(40) != 20, 40] = np.nan
    points[19, 39] = points[21, 39] = np.nan
    truth[np.isnan(points[..., 0])] = np.nan
    assert distances(relax_grid(points).uv, truth).max() < 0.02


def test_specks_are_dropped_and_counted():
    whole = cylinder(20, 60, 400.0, 6.0)
    points = whole.copy()
    points[:, 48:] = np.nan
    weights = np.linspace(1, 2, 1200).reshape(20, 60)
    alone = relax_grid(points, weights=weights)
    points[3:5, 52:56], points[15, 59] = whole[3:5, 52:56], whole[15, 59]  # 8 nodes and 1 of 969
    found = relax_grid(points, weights=weights)
    assert found.dropped.sum() == 9
    assert found.dropped[3:5, 52:56].all()
    assert np.isnan(found.uv[found.dropped]).all()
    np.testing.assert_array_equal(found.uv, alone.uv)
    assert (found.energy, found.springs) == (alone.energy, alone.springs)
    assert not alone.dropped.any()
    points[3:8, 50:58] = whole[3:8, 50:58]  # 40 nodes are no speck
    with pytest.raises(
        CannotFlatten, match=r"2 unconnected pieces: 960 nodes .*, 40 nodes in rows 3-7 and col"
    ):
        relax_grid(points, weights=weights)


def test_the_number_of_threads_changes_no_byte():
    """Large enough for the rows to be shared out."""
    points = bumpy(300, 420, noise=0.15)
    gaps = points.copy()
    gaps[100:140, 80:150] = np.nan
    found = []
    for threads in (1, 2, 3):
        with limit_threads(threads):
            whole = relax_grid(points)
            found.append((whole.uv.tobytes(), whole.energy, relax_grid(gaps).uv.tobytes()))
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_length_does_not_matter(unit):
    points = bumpy(30, 40, noise=0.1)
    one, other = relax_grid(points), relax_grid(points * unit)
    assert other.steps == one.steps
    np.testing.assert_allclose(other.uv / unit, one.uv, atol=1e-6)
    assert other.energy / unit**2 == pytest.approx(one.energy, rel=1e-9)


def test_an_interrupted_run_leaves_no_thread(monkeypatch):
    balance, calls = multigrid.Multigrid.balance, []

    def interrupted(self, level):
        calls.append(level)
        if len(calls) == 6:
            raise KeyboardInterrupt
        return balance(self, level)

    before = threading.active_count()
    monkeypatch.setattr(multigrid.Multigrid, "balance", interrupted)
    with pytest.raises(KeyboardInterrupt), limit_threads(3):
        relax_grid(bumpy(400, 420))
    assert threading.active_count() == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": np.zeros((30,))}, "weights have the shape"),
        ({"weights": -np.ones((30, 40))}, "weight is negative"),
        ({"tolerance": 0.0}, "tolerance is 0.0"),
        ({"method": "multgrid"}, "ethod is 'multgrid'"),
        ({"method": "Multigrid"}, "Method is 'Multigrid'"),
        ({"rest": "arcs"}, "est is 'arcs'"),
        ({"weights": np.arange(1200).reshape(30, 40) == 7.0}, "1 nodes have more than a tenth"),
    ],
)
def test_what_does_not_fit_is_refused(change, message):
    refused(CannotFlatten, message, relax_grid, bumpy(30, 40), **change)


def test_infinite_places_are_missing_and_points_without_a_sheet_refused():
    points = bumpy(30, 40)
    points[5, 5, 2] = np.inf
    found = relax_grid(points)
    assert np.array_equal(np.argwhere(np.isnan(found.uv[..., 0])), [[5, 5]])
    refused(CannotFlatten, "grid", relax_grid, np.zeros((4, 5, 2)))
    refused(CannotFlatten, "neighbours", relax_grid, np.full((4, 5, 3), np.nan))
    refused(CannotFlatten, "neighbours", relax_grid, np.zeros((4, 5, 3)))
