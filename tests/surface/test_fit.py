import numpy as np
import pytest
from scipy.special import ndtr

from naive import fit_staircase, staircase
from planish.surface._fit_kernels import fit_column, fit_faces

WIDTH, AIR, NOISE = 0.9, 0.0, 0.04
PRIOR = np.array([0.0, 0.0, 1.0, 0.35])
SPREAD = np.array([0.0, 0.0, 0.08, 0.12])


@pytest.mark.parametrize("thickness", [0.4, 1.5, 5.8])
def test_equals_the_slow_twin(thickness):
    rng = np.random.default_rng(int(10 * thickness))
    g = staircase(np.arange(24), (7.3, thickness, 0.98, 0.4), WIDTH, AIR) + rng.normal(0, NOISE, 24)
    p = np.array([7.0, thickness + 0.3, 1.0, 0.35])
    fit_column(
        g.astype(np.float32),
        0,
        23,
        AIR,
        NOISE,
        WIDTH,
        p,
        PRIOR,
        SPREAD,
        True,
        np.zeros((4, 4)),
        np.zeros(4),
    )
    slow = fit_staircase(g, [7.0, thickness + 0.3, 1.0, 0.35], WIDTH, AIR, NOISE, PRIOR, SPREAD)
    # the kernel stops when a step is below 2e-4 voxel
    np.testing.assert_allclose(p, slow, atol=2e-3)


def test_a_profile_without_coating_gives_back_what_made_it():
    truth, none = [9.4, 0.0, 0.1, 0.7], np.zeros(4)
    g = staircase(np.arange(24), truth, WIDTH, AIR, False)
    p = np.array([9.0, 0.0, 0.0, 0.6])
    fit_column(
        g.astype(np.float32),
        0,
        23,
        AIR,
        NOISE,
        WIDTH,
        p,
        PRIOR,
        none,
        False,
        np.zeros((4, 4)),
        np.zeros(4),
    )
    # of a profile in float32
    np.testing.assert_allclose(p, truth, atol=2e-3)


def run(profile, expected, other, *, coated=True):
    slab = np.ascontiguousarray(profile[None, None, :], dtype=np.float32)
    result = np.empty((5, 1, 1))
    one = np.ones((1, 1))
    fit_faces(
        slab,
        expected * one,
        other * one,
        one,
        AIR,
        WIDTH,
        NOISE,
        PRIOR,
        SPREAD,
        coated,
        6.0,
        result,
    )
    return result[:, 0, 0]


@pytest.mark.parametrize("shift", np.linspace(0, 1, 5))
def test_faces_of_a_clean_column_to_a_fiftieth_of_a_voxel(shift):
    d = np.arange(60)
    g = staircase(d, (15 + shift, 5.6, 1.0, 0.35), WIDTH, AIR)
    h, t, *_ = run(g, 14.0, 45.0)
    assert (h, t) == (pytest.approx(15 + shift, abs=0.02), pytest.approx(5.6, abs=0.02))


def test_a_bare_spot_is_zero_and_air_or_missing_voxels_give_nothing():
    g = staircase(np.arange(60), (15.3, 0.0, 1.0, 0.35), WIDTH, AIR)
    h, t, *_ = run(g, 15.0, 45.0)
    assert t < 0.15
    assert h == pytest.approx(15.3, abs=0.1)
    assert np.isnan(run(np.zeros(60), 15.0, 45.0)).all()
    g = staircase(np.arange(60), (15.3, 5.0, 1.0, 0.35), WIDTH, AIR)
    g[16] = np.nan
    assert np.isnan(run(g, 15.0, 45.0)).all()
    assert np.isnan(run(g, np.nan, 45.0)).all()


def test_a_wall_below_the_coating_is_a_step_of_its_own():
    d, wall, depth = np.arange(40), 0.12, 0.6
    truth = [9.4, 4.3, 1.0, 0.35]
    g = staircase(d, truth, WIDTH, AIR)
    g = g + wall * (ndtr((d - 13.7) / WIDTH) - ndtr((d - 13.7 - depth) / WIDTH))
    found = []
    for below in (0.0, wall):
        p = np.array([9.0, 4.0, 1.0, 0.35])
        matrix, step = np.zeros((4, 4)), np.zeros(4)
        column = g.astype(np.float32), 0, 39, AIR, NOISE, WIDTH, p, PRIOR, SPREAD, True
        fit_column(*column, matrix, step, None, 1.0, below, depth)
        found.append(p[1])
    assert found[1] == pytest.approx(4.3, abs=5e-3)
    assert found[0] > 4.3 + 0.05
