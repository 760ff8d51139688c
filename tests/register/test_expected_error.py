"""What a fit says of its error against its true error: a short form of ``python -m benchmarks
registration``."""

import numpy as np
import pytest
from benchmarks.registration import drawn, hull_grid, judged, spread_marks, summary

from planish.core.transform import Similarity
from planish.register import fit_transform

TURN = Similarity(scale=0.99, rotation_rad=-0.4, shift_um=(2000.0, 10.0))


@pytest.mark.ci
def test_stated_and_true_error_agree():
    """12 truths fix the ratio to some 25 %."""
    auto = summary(
        [judged(drawn(np.random.default_rng([2, k])), ("auto",)) for k in range(12)], "auto"
    )
    assert 0.5 < auto.pooled < 1.5


@pytest.mark.ci
@pytest.mark.parametrize("way", ["weights", "covariances"])
def test_precise_marks_count_more_and_are_believed(way):
    """12 marks of a similarity, errors as their covariances say: true over stated error, pooled
    over 25 sets."""
    rng, true, stated = np.random.default_rng(3), [], []
    for _ in range(25):
        marks = spread_marks(12, rng)
        size = rng.uniform(0.5, 3, 12)
        spread = size[:, None, None] ** 2 * np.eye(2)
        if way == "covariances":
            half = rng.uniform(-1, 1, (12, 2, 2)) + np.eye(2)
            spread = half @ half.swapaxes(1, 2) + 0.2 * np.eye(2)
        error = (np.linalg.cholesky(spread) @ rng.normal(0, 2, (12, 2, 1)))[..., 0]
        fit = fit_transform(
            marks,
            TURN(marks) + error,
            model="auto",
            weights=size**-2.0 if way == "weights" else 7 * spread,
        )
        grid = hull_grid(marks)
        true.append(np.mean(np.sum((fit(grid) - TURN(grid)) ** 2, axis=1)))
        stated.append(np.mean(fit.expected_error_um(grid) ** 2))
    assert 0.65 < np.sqrt(np.mean(true) / np.mean(stated)) < 1.35
