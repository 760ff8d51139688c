"""Wrong marks among right ones, and right ones alone."""

import numpy as np
import pytest

from planish.core.transform import Similarity
from planish.register import fit_transform
from register.patterns import marks

TURN = Similarity(scale=1.01, rotation_rad=0.4, shift_um=(300.0, 20.0))


@pytest.mark.parametrize("model", ["rigid", "similarity", "affine", "projective", "tps"])
def test_a_wrong_mark_among_exact_ones_changes_nothing(model):
    points = marks(12)
    truth = Similarity(rotation_rad=0.4) if model == "rigid" else TURN
    seen = truth(points)
    seen[4] += (90.0, -40.0)
    fit = fit_transform(points, seen, model=model)
    assert fit.robust_weights.tolist() == [float(k != 4) for k in range(12)]
    np.testing.assert_allclose(fit(points), truth(points), rtol=0, atol=1e-6)
    assert "Mark 5 (counted from 1) " in fit.warnings[0]
    # What is left out is missed by its residual, and does not count in the rms.
    assert fit.leave_one_out_um[4] == pytest.approx(np.hypot(90, 40), abs=1e-6)
    assert fit.rms_um < 1e-6


def test_a_quarter_of_wrong_marks_is_found():
    rng = np.random.default_rng(1)
    for _ in range(10):
        points = rng.uniform(0, 3000, (12, 2))
        seen = TURN(points) + rng.normal(0, 2, (12, 2))
        seen[:3] += rng.uniform(-1, 1, (3, 2)) + 200.0 * np.array([[1, 0], [0, 1], [-1, 1]])
        fit = fit_transform(points, seen)
        assert fit.robust_weights[:3].max() == 0.0
        assert np.linalg.norm(fit(points) - TURN(points), axis=1).max() < 6.0


@pytest.mark.ci
def test_right_marks_are_left_alone():
    """One set in a hundred may lose weight by chance; the error grows by less than 2 %."""
    rng = np.random.default_rng(2)
    touched, robust, plain = 0, [], []
    for _ in range(80):
        points = rng.uniform(0, 3000, (10, 2))
        seen = points + rng.normal(0, 3, (10, 2))
        fits = [fit_transform(points, seen, robust=r) for r in (True, False)]
        touched += bool(np.any(fits[0].robust_weights < 1))
        robust.append(np.sum((fits[0](points) - points) ** 2))
        plain.append(np.sum((fits[1](points) - points) ** 2))
    assert touched <= 5
    assert np.mean(robust) < 1.02**2 * np.mean(plain)


def test_three_marks_cannot_outvote_each_other_nor_a_smooth_distortion_make_one_wrong():
    points = marks(3)
    seen = points.copy()
    seen[0] += 50.0
    assert np.all(fit_transform(points, seen).robust_weights == 1.0)
    # 30 um of waves under 1 um of noise, of which a similarity explains nothing.
    points = marks(24)
    seen = (
        TURN(points)
        + 30 * np.sin(points[:, ::-1] / 600.0)
        + np.random.default_rng(5).normal(0, 1, (24, 2))
    )
    for model in ("similarity", "auto"):
        assert np.all(fit_transform(points, seen, model=model).robust_weights == 1.0)


def test_wrong_marks_among_many_are_taken_out_together():
    rng = np.random.default_rng(4)
    points = rng.uniform(0, 3000, (160, 2))
    seen = TURN(points) + rng.normal(0, 2, (160, 2))
    seen[:12] += 60.0 * rng.choice([-1, 1], (12, 2))
    assert fit_transform(points, seen).robust_weights.tolist() == [0.0] * 12 + [1.0] * 148
