import numpy as np
import pytest

from planish.core.errors import CannotRegister
from planish.core.transform import Similarity
from planish.register import match_marks


def scattered(n, rng, apart=450.0):
    """Positions of n holes in a field that gives each about the same room."""
    size = apart * np.sqrt(3.0 * n)
    found = []
    while len(found) < n:
        point = rng.uniform(0, size, 2)
        if all(np.hypot(*(point - other)) > apart for other in found):
            found.append(point)
    return np.array(found)


def pose(rng, mirrored=False):
    return Similarity(
        scale=rng.uniform(0.98, 1.02), rotation_rad=rng.uniform(-np.pi, np.pi),
        shift_um=tuple(rng.uniform(-2000, 2000, 2)), mirrored=mirrored,
    )  # fmt: skip


@pytest.mark.parametrize("count", [4, 5, 7, 12, 25])
def test_whole_patterns_are_matched(count):
    rng = np.random.default_rng(count)
    right = refused = 0
    for _ in range(60):
        points = scattered(count, rng)
        order = rng.permutation(count)
        try:
            found = match_marks(points[order], pose(rng)(points) + rng.normal(0, 3, points.shape))
        except CannotRegister:
            refused += 1
            continue
        assert np.array_equal(order[found.pairs[:, 0]], found.pairs[:, 1])
        right += len(found.pairs) == count
    print(f"{count} holes: {right} of 60 matched, {refused} refused")
    assert right >= 0.9 * 60


@pytest.mark.slow
def test_missing_and_false_marks_are_right_or_refused_but_never_wrong():
    """A thousand patterns, 30 % missing on each side and 30 % false ones."""
    rng = np.random.default_rng(0)
    wrong = right = 0
    for _ in range(1000):
        points = scattered(int(rng.integers(6, 26)), rng)
        truth = pose(rng)
        low, high = points.min(axis=0), points.max(axis=0)
        sides = []
        for _side in range(2):
            kept = points[rng.random(len(points)) > 0.3]
            false = rng.uniform(low, high, (int(0.3 * len(points)), 2))
            side = np.concatenate([kept, false])
            sides.append(side + rng.normal(0, 3, side.shape))
        a, b = sides
        try:
            found = match_marks(a, truth(b))
        except CannotRegister:
            continue
        where = rng.uniform(low, high, (20, 2))
        off = np.linalg.norm(found.transform(where) - truth(where), axis=1).max()
        wrong += off > 30.0
        right += off <= 30.0
    print(f"{right} of 1000 matched, {wrong} wrong, {1000 - right - wrong} refused")
    assert wrong == 0
    # 0.7 x 0.7 of the holes are on both sides, about half of either: most fail the rule of 60 %
    assert right > 200


SYMMETRIC = {
    "square": [(0, 0), (900, 0), (900, 900), (0, 900)],
    "rectangle": [(0, 0), (1300, 0), (1300, 700), (0, 700)],
    "pentagon": [(800 * np.cos(t), 800 * np.sin(t)) for t in np.arange(5) * 2 * np.pi / 5],
    "line": [(k * 600.0, 0) for k in range(6)],
    "lattice": [(600.0 * i, 600.0 * j) for i in range(4) for j in range(3)],
    "two-fold": [(0, 0), (700, 150), (1500, 90), (2500, 1200), (1800, 1050), (1000, 1110)],
}


@pytest.mark.parametrize("name", SYMMETRIC)
@pytest.mark.parametrize("jitter", [0.0, 2.0, 4.0])
def test_symmetric_patterns_are_always_refused(name, jitter):
    rng = np.random.default_rng(1)
    for _ in range(30):
        points = np.array(SYMMETRIC[name], float) + rng.normal(0, jitter, (len(SYMMETRIC[name]), 2))
        with pytest.raises(CannotRegister, match=r"symmetric|alike|ambiguous"):
            match_marks(points, pose(rng)(points) + rng.normal(0, 1, points.shape))


def test_a_mirror_image_is_only_tried_when_asked():
    rng = np.random.default_rng(2)
    points = scattered(8, rng)
    seen = pose(rng, mirrored=True)(points)
    with pytest.raises(CannotRegister, match="--mirror"):
        match_marks(points, seen)
    assert match_marks(points, seen, mirror=True).mirrored


def test_a_wrong_handed_image_is_not_matched_by_chance():
    """Among many patterns some fit their own mirror image at most of their marks; the true hand gives them away."""
    rng = np.random.default_rng(6)
    accepted = 0
    for _ in range(400):
        points = scattered(int(rng.integers(5, 9)), rng)
        try:
            match_marks(points, pose(rng, mirrored=True)(points) + rng.normal(0, 1, points.shape))
        except CannotRegister:
            continue
        accepted += 1
    print(f"{accepted} of 400 mirror images accepted without --mirror")
    assert accepted == 0


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_marks_are_named(count):
    points = np.array([(0.0, 0.0), (500.0, 20.0), (100.0, 900.0), (1200.0, 300.0)])
    with pytest.raises(CannotRegister, match=str(count) if count else "No|no|0"):
        match_marks(points, points[:count])


def test_three_marks_match_when_their_triangle_cannot_be_confused():
    points = np.array([(0.0, 0.0), (1500.0, 100.0), (300.0, 700.0)])
    found = match_marks(points, pose(np.random.default_rng(3))(points))
    assert np.array_equal(found.pairs[:, 0], found.pairs[:, 1])
    alike = np.array([(0.0, 0.0), (1000.0, 0.0), (500.0, 870.0)])
    with pytest.raises(CannotRegister):
        match_marks(alike, alike)


def test_a_scale_outside_the_calibration_is_no_match():
    points = scattered(8, np.random.default_rng(4))
    with pytest.raises(CannotRegister):
        match_marks(points, 1.08 * points)
