import numpy as np
import pytest
from scipy import ndimage

from planish.flatten import curvature, curvature_check


def plan(rows, cols, pitch):
    y, x = np.mgrid[0:rows, 0:cols] * float(pitch)
    return x - x.mean(), y - y.mean()


def sphere(rows, cols, pitch, radius):
    x, y = plan(rows, cols, pitch)
    return np.stack([x, y, np.sqrt(radius**2 - x**2 - y**2)], axis=-1)


def slow_turn(points):
    """Angles about each inner node, triangle by triangle of the first diagonal."""
    rows, cols = points.shape[:2]
    out = np.full((rows, cols), 2 * np.pi)
    for i, j in np.ndindex(rows - 1, cols - 1):
        a, b, c, d = (i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)
        for at, one, other in ((a, b, c), (b, c, a), (c, a, b), (a, c, d), (c, d, a), (d, a, c)):
            p, q = points[one] - points[at], points[other] - points[at]
            out[at] -= np.arccos(p @ q / np.linalg.norm(p) / np.linalg.norm(q))
    out[[0, -1]], out[:, [0, -1]] = np.nan, np.nan
    return out


def slow_patch(lacking, area, i, j, sigma):
    """Gaussian average about one node of a field without holes, far from its outline."""
    y, x = np.mgrid[0 : area.shape[0], 0 : area.shape[1]]
    weight = np.exp(-((y - i) ** 2 + (x - j) ** 2) / (2 * sigma**2)) * np.isfinite(area)
    return np.nansum(weight * lacking) / np.nansum(weight * area)


def test_angles_and_patches_equal_their_slow_twins():
    rng = np.random.default_rng(1)
    points = rng.normal(0, 0.2, (7, 9, 3)) + sphere(7, 9, 1.0, 20.0)
    points[3, 4] = np.nan
    lacking, area = curvature._deficit_and_area(points)
    # Acos loses half the digits near 0.
    np.testing.assert_allclose(lacking, slow_turn(points), atol=1e-7)
    assert np.array_equal(np.isnan(area), np.isnan(lacking))
    # The node and the six whose triangles it has.
    assert np.count_nonzero(np.isnan(lacking[1:-1, 1:-1])) == 7
    # In the middle of a sheet of eight half-sizes no outline is felt; the window ends at 3 sigma: 1
    # % is left.
    x, y = plan(161, 161, 50.0)
    points = np.stack([x, y, 20 * np.sin(x / 700) * np.cos(y / 900)], axis=-1)
    found = curvature_check(points)
    lacking, area = curvature._deficit_and_area(points)
    scale = np.nanmax(np.abs(found.curvature))
    for node in ((80, 80), (75, 90)):
        slow = slow_patch(lacking, area, *node, 1000 / np.sqrt(3) / 50)
        assert found.curvature[node] == pytest.approx(slow, abs=0.02 * scale)


def test_a_sphere_in_any_unit_of_length():
    """K = 1 / R^2."""
    points = sphere(90, 110, 50.0, 6000.0)
    one, seven = curvature_check(points), curvature_check(7 * points, patch_um=7000.0)
    known = np.isfinite(one.curvature)
    np.testing.assert_allclose(one.curvature[known] * 6000.0**2, 1.0, rtol=1e-3)
    assert (one.largest, one.share) == (pytest.approx(1e6 / 16 / 6000.0**2, rel=1e-3), 0.0)
    assert "can be a sheet of paper" in one.verdict
    np.testing.assert_allclose(one.strain, seven.strain, rtol=1e-9)


def test_the_grid_may_lie_on_the_surface_as_it_likes():
    """Longitudes and latitudes of a sphere, and the same points turned: no height field, cells of
    all shapes."""
    lat, lon = np.meshgrid(np.linspace(-1.2, 1.2, 150), np.linspace(0.0, 3.0, 170), indexing="ij")
    points = 300 * np.stack(
        [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1
    )
    for one in (points, points[::-1]):
        found = curvature_check(one, patch_um=40.0).curvature
        known = np.isfinite(found)
        assert known.mean() > 0.8
        # (3 / 170)^2 = 3e-4 and its like.
        np.testing.assert_allclose(found[known] * 300**2, 1.0, rtol=2e-3)


@pytest.mark.parametrize("degrees", [0, 17, 135])
def test_a_cylinder_of_any_direction_can_be_flat(degrees):
    """Wave of 6 mm with slopes up to 45 degrees; exact K is 0."""
    x, y = plan(250, 300, 20.0)
    wave = 6000 / (2 * np.pi)
    along = np.cos(np.radians(degrees)) * x + np.sin(np.radians(degrees)) * y
    points = np.stack([x, y, wave * np.sin(along / wave)], axis=-1)
    assert curvature_check(points).largest < 1e-4


def test_a_saddle_is_negative():
    """z = x y / b has K = -1 / b^2 in the middle, less where it is steep: (1 + slope^2)^-2."""
    x, y = plan(161, 161, 25.0)
    points = np.stack([x, y, x * y / 2e4], axis=-1)
    found = curvature_check(points).curvature
    assert np.nanmax(found) < 0
    assert found[80, 80] == pytest.approx(-1 / 2e4**2, rel=0.01)


def test_roughness_is_not_taken_for_curvature():
    """Noise of 0.5 um on a pitch of 10 um: by finite differences a strain of 6, by the angles under
    0.05 %."""
    rng = np.random.default_rng(4)
    x, y = plan(300, 350, 10.0)
    points = np.stack([x, y, rng.normal(0, 0.5, x.shape)], axis=-1)
    assert curvature_check(points).largest < 5e-4
    waves = ndimage.gaussian_filter(rng.normal(size=x.shape), 5)
    points[..., 2] = 3 * (waves / waves.std())
    points[140:160, 170:180] = np.nan
    found = curvature_check(points)
    assert found.largest < 2e-3
    assert found.share == 0.0


def test_a_surface_that_no_paper_can_have_is_named_and_small_ones_are_not_judged():
    """Bowl with K = (500 / 670^2)^2 at its bottom, 8 % at a = 1 mm, less as a mean; the right half
    is flat."""
    x, y = plan(160, 300, 20.0)
    bowl = np.where(x < 0, 500 * np.exp(-((x + 1500) ** 2 + y**2) / (2 * 670.0**2)), 0.0)
    found = curvature_check(np.stack([x, y, bowl], axis=-1))
    assert 0.05 < found.share < 0.5
    assert found.largest > 0.005
    assert "segmentation" in found.verdict
    assert "2 mm" in found.verdict
    assert "0.5 %" in found.verdict
    for points in (sphere(2, 9, 10.0, 5000.0), np.full((5, 5, 3), np.nan)):
        found = curvature_check(points)
        assert np.isnan([found.share, found.largest]).all()
        assert "smaller than a patch of 2 mm" in found.verdict
