import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from flatten.meshes import grid, in_space, on_cylinder, on_sphere
from planish.flatten import cell_strain, distortion, geodesic_error, measure_distortion


def measured(points, uv):
    strain = cell_strain(points, uv)
    return measure_distortion(points, uv, strain, rng=np.random.default_rng(0))


def angle(p, q):
    return np.arccos(p @ q / np.linalg.norm(p) / np.linalg.norm(q))


def area(p, q, r):
    return 0.5 * np.linalg.det([q - p, r - p])


def slow_strain(points, uv):
    """Cell by cell, the Jacobian in an orthonormal frame and its singular values by numpy."""
    cells = points.shape[0] - 1, points.shape[1] - 1
    out = {
        name: np.full(cells, np.nan)
        for name in ("stretch_max", "stretch_min", "shear", "signed_area")
    }
    for i, j in np.ndindex(cells):
        edges = []
        for nodes in (points, uv):
            a, b, c, d = nodes[i, j], nodes[i, j + 1], nodes[i + 1, j + 1], nodes[i + 1, j]
            edges.append(np.array([(b - a + c - d) / 2, (d - a + c - b) / 2]).T)
        space, flat = edges
        upper = np.linalg.qr(space)[1]
        size = np.linalg.svd(flat @ np.linalg.inv(upper), compute_uv=False)
        out["stretch_max"][i, j], out["stretch_min"][i, j] = size
        out["shear"][i, j] = angle(*space.T) - angle(*flat.T)
        out["signed_area"][i, j] = min(area(a, b, c), area(a, c, d))
    return out


@settings(max_examples=20)
@given(arrays(np.float64, (3, 4, 5), elements=st.floats(-0.2, 0.2)))
def test_cell_strain_equals_the_slow_twin(noise):
    uv = grid(3, 4)
    points, flat = in_space(uv, 0.4) + noise[..., :3], uv + noise[..., 3:]
    found, slow = cell_strain(points, flat), slow_strain(points, flat)
    # far below any strain of interest; stretches of these cells are of the order of 1
    for name, values in slow.items():
        np.testing.assert_allclose(found[name], values, atol=1e-7, err_msg=name)
    np.testing.assert_allclose(
        found["area_ratio"], slow["stretch_max"] * slow["stretch_min"], atol=1e-7
    )


def test_blocks_of_rows_make_no_difference():
    """Cells are worked on in blocks of rows; a mesh of several blocks equals its parts."""
    rng = np.random.default_rng(1)
    uv = grid(9, distortion._BLOCK // 3)
    points = in_space(uv) + 0.1 * rng.normal(size=(*uv.shape[:2], 3))
    whole = cell_strain(points, uv)
    for i in (0, 2, 3, 7):
        row = cell_strain(points[i : i + 2], uv[i : i + 2])
        for name in whole:
            np.testing.assert_array_equal(whole[name][i], row[name][0])


def test_uniform_stretch_and_pure_shear_are_measured_exactly():
    """Grown by 2 % along u and shrunk by 2 % along v: both are linear, nothing is approximated."""
    points = in_space(grid(6, 8, 5.0), 0.3)
    strain = cell_strain(points, grid(6, 8, 5.0) * [1.02, 0.98])
    expected = {
        "stretch_max": 1.02,
        "stretch_min": 0.98,
        "area_ratio": 1.02 * 0.98,
        "anisotropy": 1.02 / 0.98,
        "axial_u": 0.02,
        "axial_v": -0.02,
        "shear": 0.0,
        "signed_area": 0.5 * 25 * 1.02 * 0.98,
    }
    assert set(strain) == set(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(strain[name], value, atol=1e-12, err_msg=name)
    # Simple shear by g: stretches sqrt(1 + g^2 / 4) +- g / 2, angle atan(g).
    uv, g = grid(5, 5), 0.03
    strain = cell_strain(in_space(uv), uv + g * uv[..., ::-1] * [1, 0])
    np.testing.assert_allclose(strain["shear"], np.arctan(g), atol=1e-14)
    np.testing.assert_allclose(strain["axial_u"], 0.0, atol=1e-14)
    np.testing.assert_allclose(strain["axial_v"], np.hypot(1, g) - 1, atol=1e-14)
    np.testing.assert_allclose(strain["area_ratio"], 1.0, atol=1e-14)
    np.testing.assert_allclose(strain["stretch_max"], np.hypot(1, g / 2) + g / 2, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_cylinder_exactly_unrolled_has_no_strain_and_keeps_all_lengths(angle):
    """A chord is shorter than its arc by (h / R)^2 / 24, here 4e-6; a diagonal cell has twice
    that."""
    uv = grid(40, 60, 10.0)
    points = on_cylinder(uv, 1000.0, angle)
    strain = cell_strain(points, uv)
    for name, value in (("area_ratio", 1), ("stretch_max", 1), ("shear", 0)):
        np.testing.assert_allclose(strain[name], value, atol=1e-5)
    found = geodesic_error(points, uv, rng=np.random.default_rng(0))
    assert (found.used, found.dropped) == (1000, 0)
    assert 0 < found.p50 <= found.p95 <= found.largest <= 2 * (10 / 1000) ** 2 / 24 * 1.01


def test_a_cap_is_stretched_along_its_parallels():
    """Radii are kept; a parallel at r is longer by r / (R sin(r / R)); in the middle all is 1."""
    radius, uv = 5000.0, grid(81, 81, 20.0) - 800.0
    strain = cell_strain(on_sphere(uv, radius), uv)
    r = np.linalg.norm((uv[:-1, :-1] + uv[1:, 1:]) / 2, axis=-1) / radius
    # chords: (20 / 5000)^2 / 24 of the length
    np.testing.assert_allclose(strain["stretch_max"], r / np.sin(r), rtol=2e-6)
    np.testing.assert_allclose(strain["stretch_min"], 1.0, rtol=2e-6)


def test_folded_missing_and_empty_cells_are_counted():
    """A node pulled over its neighbour turns triangles of two cells over; mirrored, every cell is
    turned over."""
    uv = grid(6, 7)
    folded = uv.copy()
    folded[3, 3, 0] += 1.5
    found = measured(in_space(uv), folded)
    areas = cell_strain(in_space(uv), folded)["signed_area"].values
    assert np.argwhere(areas <= 0).tolist() == [[2, 3], [3, 3]]
    assert (found.inverted_cells, found.cells) == (2, 30)
    assert measured(in_space(uv), uv * [-1, 1]).inverted_cells == 30
    uv = grid(6, 6)
    points = in_space(uv)
    points[2, 2] = np.nan
    points[4, 4:] = points[4, 4]
    points[5, 4:] = points[4, 4]
    strain = cell_strain(points, uv)
    assert strain["area_ratio"].isnull().values[1:3, 1:3].all()
    assert np.isnan(strain["stretch_max"].values[4, 4])
    assert np.count_nonzero(np.isnan(strain["signed_area"])) == 4
    collapsed = cell_strain(in_space(uv), uv * [1, 0])
    assert (collapsed["stretch_min"] == 0).all()
    assert np.isinf(collapsed["anisotropy"]).all()


def test_boundaries_and_displacements_are_measured():
    """8 by 5 cells of 10 um are bounded by 260 um; a missing node takes 4 cells out, whose rim is
    80 um."""
    uv = grid(6, 9, 10.0)
    points = in_space(uv)
    assert distortion.boundary_lengths(points, 1.1 * uv) == pytest.approx((260.0, 286.0))
    points[2, 4] = np.nan
    assert distortion.boundary_lengths(points, 1.1 * uv) == pytest.approx((340.0, 374.0))
    # Tilted by 10.4 degrees, 15 mm grow by 250 um, half of it at either end, however the flat sheet
    # was turned.
    turn = np.arccos(1 - 250 / 15000 / (1 + 250 / 15000))
    uv = grid(76, 5, 200.0)
    spin = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    points = in_space(uv, turn)
    found = measured(points, uv @ spin.T + [50, 20])
    length = np.ptp(points[..., 1])
    assert found.displacement_max_um == pytest.approx((15000 - length) / 2, abs=1e-6)
    assert found.displacement_median_um == pytest.approx((15000 - length) / 4, rel=0.05)
    assert found.growth_direction_deg == pytest.approx(90.0)
    assert found.growth_anisotropy_percent == pytest.approx(100 * (15000 / length - 1), rel=1e-6)
    assert found.area.max_abs < 1e-12
    assert found.geodesics.largest < 1e-12


@given(
    grown=st.floats(0.9, 1.2),
    uneven=st.floats(1.001, 1.1),
    axis=st.floats(1.0, 179.0),
    turn=st.floats(-3.0, 3.0),
)
@settings(max_examples=15)
def test_growth_against_the_projection(grown, uneven, axis, turn):
    """An affine map made of its parts; the square's similarity scale is the mean of the two
    singular values."""
    uv = grid(8, 8, 3.0)
    a = np.radians(axis)
    frame = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    linear = spin @ frame.T @ np.diag([grown * uneven, grown]) @ frame
    found = measured(in_space(uv), uv @ linear.T + 70.0)
    assert found.growth_percent == pytest.approx(100 * (grown * (1 + uneven) / 2 - 1), abs=1e-8)
    assert found.growth_anisotropy_percent == pytest.approx(100 * (uneven - 1), abs=1e-8)
    assert found.growth_direction_deg == pytest.approx(axis, abs=1e-5)


def test_spread_of_a_known_distribution_of_a_row_and_of_no_cell():
    """Columns stretched by 0 to 2 % in even steps: median 1 %, p5 0.1 %, p95 1.9 %."""
    width = 1 + np.linspace(0, 0.02, 101)
    u = np.concatenate([[0.0], np.cumsum(width)])
    uv = np.stack(np.broadcast_arrays(u[None, :], np.arange(4.0)[:, None]), axis=-1)
    points = in_space(grid(4, 102))
    found = measured(points, uv).axial_u
    assert (found.median, found.p5, found.p95, found.max_abs) == pytest.approx(
        (0.01, 0.001, 0.019, 0.02)
    )
    assert found.p95_abs == pytest.approx(0.019)
    uv = grid(2, 9)
    found = measured(in_space(uv), 1.01 * uv)
    assert (found.cells, found.geodesics.used, found.axial_v.median) == (
        8,
        1000,
        pytest.approx(0.01),
    )
    points = np.full((3, 3, 3), np.nan)
    nothing = measured(points, points[..., :2])
    assert (
        nothing.cells,
        nothing.inverted_cells,
        nothing.boundary_flat_um,
        nothing.geodesics.used,
    ) == (0, 0, 0.0, 0)
    assert np.isnan(
        [nothing.area.median, nothing.growth_percent, nothing.displacement_max_um]
    ).all()
    on_edge = np.stack([uv[..., 0], np.zeros((2, 9)), uv[..., 1]], axis=-1)
    assert np.isnan(measured(on_edge, uv).growth_anisotropy_percent)
