import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planish.core.errors import MarkError
from planish.core.transform import Similarity
from planish.register import fit_transform


def marks(n, seed=0):
    return np.random.default_rng(seed).uniform(0, 3000, (n, 2))


@given(
    scale=st.floats(0.5, 2),
    angle=st.floats(-3, 3),
    shift=st.floats(-5e3, 5e3),
    mirrored=st.booleans(),
    n=st.integers(3, 20),
)
@settings(max_examples=30)
def test_a_known_similarity_is_recovered(scale, angle, shift, mirrored, n):
    truth = Similarity(scale=scale, rotation_rad=angle, shift_um=(shift, -shift), mirrored=mirrored)
    points = marks(n)
    fit = fit_transform(points, truth(points), mirrored=mirrored)
    np.testing.assert_allclose(fit(points), truth(points), atol=1e-6)
    np.testing.assert_allclose(fit.inverse(fit(points)), points, atol=1e-6)
    assert fit.rms_um < 1e-6


def test_rigid_keeps_the_scale_at_one_and_order_does_not_matter():
    points = marks(8)
    fit = fit_transform(points, Similarity(scale=1.02, rotation_rad=0.3)(points), model="rigid")
    assert (fit.transform.scale, fit.transform.rotation_rad) == (1.0, pytest.approx(0.3, abs=1e-9))
    assert fit.rms_um > 5.0
    points = marks(7)
    seen = points + np.random.default_rng(4).normal(0, 2, (7, 2))
    order = np.random.default_rng(5).permutation(7)
    a, b = fit_transform(points, seen), fit_transform(points[order], seen[order])
    assert a.transform.scale == pytest.approx(b.transform.scale, rel=1e-12)
    np.testing.assert_allclose(a.residuals_um[order], b.residuals_um, atol=1e-8)


@pytest.mark.parametrize("model", ["similarity", "rigid"])
@pytest.mark.parametrize("weighted", [False, True])
def test_leave_one_out_equals_the_brute_force_twin(model, weighted):
    rng = np.random.default_rng(1)
    points, weights = marks(9), (rng.uniform(0.2, 3, 9) if weighted else np.ones(9))
    seen = Similarity(scale=1.01, rotation_rad=-0.8)(points) + rng.normal(0, 4, (9, 2))
    fit = fit_transform(points, seen, model=model, weights=weights, robust=False)
    for k in range(9):
        others = np.arange(9) != k
        without = fit_transform(points[others], seen[others], model=model, weights=weights[others], robust=False)
        twin = np.linalg.norm(without(points[k]) - seen[k])
        assert fit.leave_one_out_um[k] == pytest.approx(twin, abs=1e-9)


@pytest.mark.nightly
def test_residuals_have_the_expected_size():
    """Noise s, n marks, similarity: rms of one axis is s sqrt(1 - 2/n)."""
    rng = np.random.default_rng(2)
    n, noise, squares = 8, 3.0, []
    for _ in range(600):
        points = rng.uniform(0, 3000, (n, 2))
        fit = fit_transform(points, points + rng.normal(0, noise, (n, 2)), robust=False)
        squares.append(np.mean(fit.residuals_um**2))
    # 600 fits of 12 free residuals each: standard error 1.2 %
    assert np.sqrt(np.mean(squares)) == pytest.approx(noise * np.sqrt(1 - 2 / n), rel=0.04)


def test_bad_marks():
    with pytest.raises(MarkError):
        fit_transform(marks(1), marks(1))
    with pytest.raises(MarkError):
        fit_transform(np.zeros((4, 2)), marks(4))
    broken = marks(4)
    broken[2, 1] = np.nan
    with pytest.raises(MarkError):
        fit_transform(broken, marks(4))
    with pytest.raises(MarkError):
        fit_transform(marks(4), marks(5))


@pytest.mark.parametrize("model", ["rigid", "similarity", "affine", "projective", "tps", "averaged"])
def test_refitted_keeps_the_pairs_and_weights(model):
    """The places of the fit itself give its transformation; turned places give it after the turn back."""
    points = marks(10)
    seen = Similarity(scale=1.01, rotation_rad=0.4)(points) + np.random.default_rng(1).normal(0, 3, (10, 2))
    seen[2] += 300.0
    fit = fit_transform(points, seen, model=model)
    turn = Similarity(rotation_rad=0.2, shift_um=(50.0, 10.0))
    moved = turn(points)
    moved[2] += 77.0  # a mark that is left out counts for nothing
    where = marks(20, 3)
    np.testing.assert_allclose(fit.refitted(points)(where), fit(where), atol=1e-6)
    np.testing.assert_allclose(fit.refitted(moved)(turn(where)), fit(where), atol=1e-6)
    with pytest.raises(MarkError, match="9 places given for 10 marks"):
        fit.refitted(points[:9])
