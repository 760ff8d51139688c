"""Transformations one after the other."""

import numpy as np
import pytest

from planish.core.transform import Similarity
from planish.register import Chain, fit_transform

MARKS = np.array(
    [
        [0.0, 0.0],
        [4000.0, 100.0],
        [3900.0, 2900.0],
        [-50.0, 3000.0],
        [1700.0, 1300.0],
        [900.0, 2400.0],
    ]
)
FIRST = Similarity(scale=1.01, rotation_rad=0.3, shift_um=(120.0, -40.0))
SECOND = Similarity(scale=0.98, rotation_rad=-1.2, shift_um=(-700.0, 310.0), mirrored=True)


def chain(noise_um=0.0, seed=0):
    rng = np.random.default_rng(seed)

    def moved(to, points):
        return to(points) + rng.normal(0, noise_um, points.shape)

    between = FIRST(MARKS)
    first = fit_transform(MARKS, moved(FIRST, MARKS), model="similarity", mirrored=False)
    return Chain(
        fits=(
            first,
            fit_transform(between, moved(SECOND, between), model="similarity", mirrored=True),
        )
    )


def test_a_chain_composes_its_links_similarities_and_hands():
    both = chain()
    points = np.random.default_rng(1).uniform(-1000, 5000, (7, 3, 2))
    np.testing.assert_allclose(both(points), SECOND(FIRST(points)), atol=1e-8)
    np.testing.assert_allclose(both.inverse(both(points)), points, atol=1e-8)
    assert both.mirrored
    assert both.similarity.mirrored
    assert both.similarity.scale == pytest.approx(1.01 * 0.98, rel=1e-12)
    np.testing.assert_allclose(
        both.similarity.matrix(), SECOND.matrix() @ FIRST.matrix(), atol=1e-12
    )
    step = 1e-3
    numeric = (both([1000.0 + step, 500.0]) - both([1000.0 - step, 500.0])) / (2 * step)
    np.testing.assert_allclose(both.jacobian([1000.0, 500.0])[:, 0], numeric, atol=1e-6)
    first, second = chain().fits
    back = fit_transform(second.fixed, second.moving, model="similarity", mirrored=True)
    assert Chain(fits=(first, second)).mirrored
    assert not Chain(fits=(first, second, back)).mirrored


def test_the_error_of_a_link_is_carried_on_by_the_scale_of_the_next():
    first, second = chain(3.0).fits
    wide = fit_transform(second.moving, 2.0 * second.fixed, model="similarity", mirrored=True)
    at = np.array([[500.0, 500.0], [6000.0, 5000.0]])
    scale = wide.transform.scale
    expected = np.sqrt(
        (scale * first.expected_error_um(at)) ** 2 + wide.expected_error_um(first(at)) ** 2
    )
    np.testing.assert_allclose(Chain(fits=(first, wide)).expected_error_um(at), expected, rtol=1e-9)
    assert scale > 1.9


def test_a_single_link_is_the_fit_itself_and_no_link_is_refused():
    fit = chain(1.0).fits[0]
    alone = Chain(fits=(fit,))
    points = np.array([[10.0, 20.0], [3000.0, 100.0]])
    np.testing.assert_array_equal(alone(points), fit(points))
    np.testing.assert_allclose(
        alone.expected_error_um(points), fit.expected_error_um(points), rtol=1e-12
    )
    assert alone.similarity == Similarity(
        scale=fit.transform.scale,
        rotation_rad=fit.transform.rotation_rad,
        shift_um=fit.transform.shift_um,
        mirrored=fit.transform.mirrored,
    )
