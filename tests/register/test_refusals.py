"""Marks that cannot be used: each with a sentence that names the fault and the remedy."""

import numpy as np
import pytest

from planish.core.errors import CannotRegister, MarkError
from planish.core.transform import Similarity
from planish.register import fit_transform, registration_from_json
from register.patterns import marks

TURN = Similarity(scale=1.01, rotation_rad=0.3, shift_um=(50.0, 20.0))


def refused(kind, words, moving, fixed, **more):
    with pytest.raises(kind, match=words):
        fit_transform(moving, fixed, **more)


def test_shapes_counts_and_missing_numbers_are_named():
    refused(MarkError, "4 moving and 5 fixed", marks(4), marks(5))
    refused(MarkError, "Transpose", marks(5).T, marks(5))
    refused(MarkError, r"shape \(5, 3\)", np.ones((5, 3)), marks(5))
    refused(MarkError, "weights have shape", marks(5), marks(5), weights=np.ones(4))
    refused(MarkError, "not negative", marks(5), marks(5), weights=[1, 1, 1, 1, -1])
    refused(MarkError, "covariance of mark 0", marks(3), marks(3), weights=np.ones((3, 2, 2)))
    refused(MarkError, "model is 'spline'", marks(5), marks(5), model="spline")
    broken = marks(6)
    broken[2, 1], broken[4, 0] = np.nan, np.inf
    refused(MarkError, "moving marks 2, 4 not finite", broken, marks(6))


@pytest.mark.parametrize(
    ("model", "n"), [("rigid", 1), ("similarity", 1), ("affine", 2), ("projective", 3), ("tps", 5)]
)
def test_too_few(model, n):
    refused(MarkError, "pairs? of marks given", marks(n), marks(n), model=model)


def test_doubles_are_refused_and_repeated_pairs_count_once():
    points = marks(6)
    twice = points.copy()
    twice[4] = twice[1]
    refused(
        MarkError,
        "Marks 1 and 4 lie at one place on the moving side.*um apart on the other",
        twice,
        points,
    )
    refused(MarkError, "Marks 1 and 4 lie at one place on the fixed side", points, twice)
    points = np.concatenate([marks(7), marks(7)[2:4]])
    there = TURN(points) + np.tile(np.random.default_rng(1).normal(0, 2, (7, 2)), (2, 1))[:9]
    there[7:] = there[2:4]
    fit, once = fit_transform(points, there), fit_transform(points[:7], there[:7])
    assert "Pairs 8, 9 (counted from 1) repeat others exactly and count once" in fit.warnings[0]
    np.testing.assert_allclose(fit(points), once(points), rtol=0, atol=1e-9)
    assert fit.agreement("abcdefghi") == once.agreement("abcdefg")
    assert fit.agreement("abcdefghi").startswith("7 marks agree to ")


@pytest.mark.parametrize("model", ["affine", "projective", "tps"])
def test_a_line(model):
    points = np.stack([np.linspace(0, 3000, 9), np.linspace(100, 500, 9)], axis=1)
    refused(CannotRegister, "on one line", points, TURN(points), model=model)
    np.testing.assert_allclose(
        fit_transform(points, TURN(points))(points), TURN(points), rtol=0, atol=1e-9
    )


def test_lines_mirrors_pixels_wrong_pairs_and_few_marks_are_named():
    points = np.array([[0, 0], [1000, 0], [2000, 0], [3500, 0], [500, 1000.0]])
    refused(CannotRegister, "do not fix one projective", points, TURN(points), model="projective")
    points = marks(10)
    there = Similarity(rotation_rad=0.05, mirrored=True)(points)
    refused(MarkError, "Probably one map shows the other side.*mirror=True", points, there)
    refused(MarkError, "not mirrored after all", points, TURN(points), mirrored=True)
    points = marks(10)
    fit = fit_transform(points / 12.1, points)
    assert "Scale 12.1: one side is probably in pixels" in fit.warnings[0]
    assert not fit_transform(points, TURN(points)).warnings
    fit = fit_transform(marks(10), marks(10, seed=1), robust=False)
    assert any("many pairs are wrong" in w for w in fit.warnings)
    assert "5 marks only" in fit_transform(marks(5), TURN(marks(5))).warnings[0]
    for data in (
        None,
        "",
        [],
        {},
        {"format": "other"},
        {"format": "planish registration 1", "model": "affine"},
    ):
        with pytest.raises(MarkError, match=r"no registration|format 'other'"):
            registration_from_json(data)


@pytest.mark.parametrize("model", ["rigid", "similarity", "affine", "projective", "tps", "auto"])
@pytest.mark.parametrize("noise", [0.0, 5.0])
def test_exchanged_columns(model, noise):
    points = marks(10)
    there = Similarity(rotation_rad=0.05)(points) + np.random.default_rng(1).normal(
        0, noise, (10, 2)
    )
    refused(MarkError, "Probably x and y are exchanged", points, there[:, ::-1], model=model)
    refused(MarkError, "Probably x and y are exchanged", points[:, ::-1], there, model=model)
