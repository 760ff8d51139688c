"""Which model ``auto`` selects."""

import numpy as np
import pytest

from planish.core.transform import Affine, Similarity
from planish.register import fit_transform

TURN = Similarity(scale=1.012, rotation_rad=0.7, shift_um=(100.0, -40.0))


def marks(n, seed=0):
    return np.random.default_rng(seed).uniform(0, 3000, (n, 2))


def seen(truth, n, seed=0, noise=2.0):
    points = marks(n, seed)
    return points, truth(points) + np.random.default_rng(seed + 100).normal(0, noise, (n, 2))


def wavy(points):
    return TURN(points) + 40 * np.sin(points[:, ::-1] / 700.0)


@pytest.mark.parametrize(
    ("truth", "model"),
    [
        (Similarity(rotation_rad=0.7), "rigid"),
        (TURN, "similarity"),
        (Affine(linear=((1.01, 0.003), (0.0, 0.99))), "affine"),
        (wavy, "tps"),
    ],
)
def test_it_selects_the_true_model(truth, model):
    fit = fit_transform(*seen(truth, 16), model="auto")
    assert fit.model == model
    assert fit.sentence.startswith(f"{model} chosen from 16 marks")


def test_a_shear_passes_the_scale():
    """Scale alone helps nothing here: the similarity is passed."""
    fit = fit_transform(*seen(Affine(linear=((1.02, 0.0), (0.0, 0.98))), 12), model="auto")
    assert fit.model == "affine"


@pytest.mark.study
def test_noise_takes_no_model_with_more_parameters():
    """25 similarities of 8 marks: the F test lets about 1 % through on each of three further models."""
    ends = [fit_transform(*seen(TURN, 8, seed), model="auto", robust=False).model for seed in range(25)]
    assert sum(m in ("affine", "projective", "tps") for m in ends) <= 2


def test_it_says_what_it_could_not_try():
    fit = fit_transform(*seen(TURN, 4, noise=0.5), model="auto")
    assert "affine (5), projective (6), tps (8)" in fit.sentence


def test_exact_marks_need_no_other_model():
    points = marks(12)
    fit = fit_transform(points, TURN(points), model="auto")
    assert fit.model == "similarity"
    assert "fits exactly" in fit.sentence


def test_a_wrong_mark_changes_no_model():
    points, there = seen(TURN, 16)
    there[5] += 150.0
    fit = fit_transform(points, there, model="auto")
    assert fit.model == "similarity"
    assert fit.robust_weights[5] == 0.0
