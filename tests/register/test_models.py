"""Every model on transformations that are known, against fits without each mark, and written and
read back."""

import json

import numpy as np
import pytest

from folders import refused
from planish.core.errors import MarkError
from planish.core.transform import Affine, Projective, Similarity
from planish.register import (
    Pairs,
    fit_transform,
    models,
    registration_from_json,
    registration_to_json,
)
from register.patterns import covariances, marks

PARAMETRIC = ("rigid", "similarity", "affine", "projective")
ALL = (*PARAMETRIC, "tps", "averaged")
TURN = Similarity(scale=1.013, rotation_rad=2.1, shift_um=(4200.0, -1700.0))
TRUTHS = {
    "rigid": Similarity(rotation_rad=-0.7, shift_um=(300.0, 9000.0)),
    "similarity": TURN,
    "affine": Affine(linear=((0.4, -0.93), (0.89, 0.41)), source=(1500, 1200), target=(-700, 8000)),
    "projective": Projective(
        homography=((0.9, -0.4, 0.01), (0.41, 0.88, 0.0), (0.03, -0.02, 1.0)),
        source=(1500, 1200),
        target=(3000, 2000),
        source_size=1000,
        target_size=1010,
    ),
    "tps": TURN,
    "averaged": TURN,
}


def given(weights, n):
    """Weights of n marks: none, numbers, or covariances."""
    rng = np.random.default_rng(3)
    return {None: None, "numbers": rng.uniform(0.2, 3, n), "covariances": covariances(n, rng)}[
        weights
    ]


@pytest.mark.parametrize("model", ALL)
@pytest.mark.parametrize("weights", [None, "numbers", "covariances"])
def test_a_known_transformation_is_recovered(model, weights):
    """Noise-free marks of some mm: 1e-9 um, which is 3e-13 of the coordinates."""
    points, where = marks(11), marks(200, 7)
    truth = TRUTHS[model]
    fit = fit_transform(points, truth(points), model=model, weights=given(weights, 11))
    np.testing.assert_allclose(fit(where), truth(where), rtol=0, atol=1e-9)
    np.testing.assert_allclose(fit.inverse(truth(where)), where, rtol=0, atol=1e-9)
    np.testing.assert_allclose(fit.jacobian(where), truth.jacobian(where), rtol=0, atol=1e-11)
    assert fit.leave_one_out_um.max() < 1e-8
    assert np.all(fit.robust_weights == 1.0)


@pytest.mark.parametrize("model", ALL)
def test_a_declared_mirror_is_recovered(model):
    points = marks(12)
    truth = Similarity(
        scale=1.0 if model == "rigid" else 0.98, rotation_rad=0.4, shift_um=(10, 20), mirrored=True
    )
    fit = fit_transform(points, truth(points), model=model, mirrored=True)
    np.testing.assert_allclose(fit(points), truth(points), rtol=0, atol=1e-9)
    assert fit.mirrored
    assert fit_transform(points, truth(points), model=model, mirrored=None).mirrored


@pytest.mark.parametrize("model", PARAMETRIC)
@pytest.mark.parametrize("weights", [None, "numbers", "covariances"])
def test_leave_one_out_equals_the_fit_without_each_mark(model, weights):
    points, weight = marks(9), given(weights, 9)
    seen = TRUTHS[model](points) + np.random.default_rng(1).normal(0, 4, (9, 2))
    fit = fit_transform(points, seen, model=model, weights=weight, robust=False)
    for k in range(9):
        others = np.arange(9) != k
        rest = None if weight is None else weight[others]
        without = fit_transform(
            points[others], seen[others], model=model, robust=False, weights=rest
        )
        twin = np.linalg.norm(without(points[k]) - seen[k])
        assert fit.leave_one_out_um[k] == pytest.approx(twin, rel=0, abs=1e-9)


@pytest.mark.parametrize("model", PARAMETRIC)
def test_the_fit_is_a_minimum(model):
    """Any small change of the parameters makes the weighted sum of squares larger: the design is
    its derivative."""
    rng = np.random.default_rng(4)
    points = marks(8)
    info = np.linalg.inv(given("covariances", 8))
    pairs = Pairs(
        moving=points, fixed=TRUTHS[model](points) + rng.normal(0, 5, (8, 2)), information=info
    )
    transform = models.MODELS[model].fit(pairs, False)
    design = models.MODELS[model].design(transform, pairs.frame(), points)
    slope = np.einsum("nap,nab,nb->p", design, info, pairs.fixed - transform(points))
    scale = np.sqrt(np.einsum("nap,nab,nbp->p", design, info, design))
    # 5 um of error: 1e-7 of it is rounding of the Gauss-Newton steps
    assert np.abs(slope / scale).max() < 1e-6


@pytest.mark.parametrize("model", ALL)
@pytest.mark.parametrize("robust", [True, False])
def test_json_gives_the_fit_back_to_the_byte(model, robust):
    rng = np.random.default_rng(5)
    points = marks(20)[::2]
    seen = TRUTHS[model](points) + rng.normal(0, 3, (10, 2))
    seen[3] += 400.0 * robust
    fit = fit_transform(points, seen, model=model, weights=given("covariances", 10), robust=robust)
    assert fit.warnings or not robust
    text = json.dumps(registration_to_json(fit), allow_nan=False)
    again = registration_from_json(json.loads(text))
    assert json.dumps(registration_to_json(again), allow_nan=False) == text
    assert type(again.transform) is type(fit.transform)
    where = marks(200, 8)
    for name in ("sentence", "warnings", "model", "rms_um", "localisation_error_um"):
        assert getattr(again, name) == getattr(fit, name)
    for of in (
        lambda f: f(where),
        lambda f: f.expected_error_um(where),
        lambda f: f.leave_one_out_um,
        lambda f: f.inverse(where),
        lambda f: f.jacobian(where),
        lambda f: f.weights,
    ):
        assert of(again).tobytes() == of(fit).tobytes()


def test_json_keeps_missing_numbers_and_a_point_behind_the_camera_has_no_image():
    """Two marks say nothing of their error (NaN); a spline without bending has an infinite
    smoothing."""
    points = marks(7)
    for model, n in (("similarity", 2), ("tps", 7)):
        fit = fit_transform(points[:n], TURN(points[:n]), model=model, robust=False)
        again = registration_from_json(
            json.loads(json.dumps(registration_to_json(fit), allow_nan=False))
        )
        np.testing.assert_array_equal(
            again.expected_error_um(points), fit.expected_error_um(points)
        )
        assert getattr(again.transform, "smoothing_um2", 0) == getattr(
            fit.transform, "smoothing_um2", 0
        )
    assert np.isnan(TRUTHS["projective"]([[-60000.0, 0.0]])).all()


def test_expected_errors_are_those_of_the_closed_form_whatever_the_weights_factor():
    """FLE**2 / n (1 + d**2 / f**2), where the marks show no deviation; more for the deviations that
    they cannot rule out: up to twice at the border for 60 marks, less in the middle.
    """
    points, where = marks(60), marks(30, 9, 2000.0) + 500.0
    away = np.sum((where - points.mean(axis=0)) ** 2, axis=1)
    f2 = np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))
    fit = fit_transform(points, points + np.random.default_rng(6).normal(0, 3, (60, 2)))
    assert fit.localisation_error_um == pytest.approx(3 * np.sqrt(2), rel=0.2)
    ratio = fit.expected_error_um(where) / (
        fit.localisation_error_um / np.sqrt(60) * np.sqrt(1 + away / f2)
    )
    assert ratio.min() > 0.99
    assert ratio.max() < 2.0
    rng = np.random.default_rng(7)
    points = marks(12)
    seen = TURN(points) + rng.normal(0, 3, (12, 2))
    for model in ("affine", "tps", "averaged"):
        a, b = (
            fit_transform(points, seen, model=model, weights=np.full(12, k)) for k in (1.0, 50.0)
        )
        np.testing.assert_allclose(a(points), b(points), rtol=0, atol=1e-5)
        np.testing.assert_allclose(
            a.expected_error_um(points), b.expected_error_um(points), rtol=1e-4
        )


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


@pytest.mark.parametrize("model", ALL)
def test_refitted_keeps_the_pairs_and_weights(model):
    """The places of the fit itself give its transformation; turned places give it after the turn
    back."""
    points = marks(10)
    seen = Similarity(scale=1.01, rotation_rad=0.4)(points) + np.random.default_rng(1).normal(
        0, 3, (10, 2)
    )
    seen[2] += 300.0
    fit = fit_transform(points, seen, model=model)
    turn = Similarity(rotation_rad=0.2, shift_um=(50.0, 10.0))
    moved = turn(points)
    moved[2] += 77.0  # a mark that is left out counts for nothing
    where = marks(20, 3)
    np.testing.assert_allclose(fit.refitted(points)(where), fit(where), atol=1e-6)
    np.testing.assert_allclose(fit.refitted(moved)(turn(where)), fit(where), atol=1e-6)
    refused(MarkError, "9 places given for 10 marks", fit.refitted, points[:9])
