import numpy as np
import pytest

from folders import refused
from planish.core.errors import CannotRegister, MarkError
from planish.register import match_marks
from register.patterns import coded, exhaustive, pose, scattered, seen


def tried(a, b):
    """The match, or None where it is refused."""
    try:
        return match_marks(a, b)
    except CannotRegister:
        return None


@pytest.mark.parametrize("count", [4, 5, 7, 25])
def test_whole_patterns_are_matched(count):
    rng = np.random.default_rng(count)
    right = 0
    for _ in range(25):
        points = scattered(count, rng)
        order = rng.permutation(count)
        found = tried(points[order], pose(rng)(points) + rng.normal(0, 3, points.shape))
        if found is not None:
            assert np.array_equal(order[found.pairs[:, 0]], found.pairs[:, 1])
            right += len(found.pairs) == count
    assert right >= 0.9 * 25


@pytest.mark.parametrize("both", [False, True])
@pytest.mark.parametrize("kind", ["irregular", "coded"])
def test_missing_and_false_marks_are_right_or_refused(kind, both):
    """30 % missing and 30 % false, on one side or both: right or refused, and hardly ever refused
    from 12 holes on."""
    rng = np.random.default_rng(10)
    reasons = []
    for _ in range(15):
        points = coded() if kind == "coded" else scattered(int(rng.integers(12, 41)), rng)
        points = points + rng.normal(0, 4, points.shape)
        (a, of_a), (b, of_b) = (
            seen(points, rng, 0.3, 0.3),
            seen(points, rng, 0.3 * both, 0.3 * both),
        )
        truth = pose(rng)
        try:
            found = match_marks(a, truth(b))
        except CannotRegister as error:
            reasons.append(str(error))
            continue
        assert np.mean(of_a[found.pairs[:, 0]] == of_b[found.pairs[:, 1]]) > 0.9
        assert (
            np.linalg.norm(
                found.transform(a[found.pairs[:, 0]]) - truth(b)[found.pairs[:, 1]], axis=1
            ).max()
            < 30
        )
    assert all("symmetric" in reason or "no match" in reason for reason in reasons)
    # Holes on lines meet holes on lines more often than scattered ones: more of the coded patterns
    # may be symmetric.
    assert len(reasons) <= (5 if kind == "coded" and both else 2)


def test_the_search_finds_what_an_exhaustive_one_finds():
    rng = np.random.default_rng(11)
    compared = 0
    for k in range(12):
        points = scattered(7 + k % 3, rng)
        (a, _), (b, _) = seen(points, rng, 0.15, 0.15), seen(points, rng, 0.15, 0.15)
        b = pose(rng)(b)
        found = tried(a, b)
        if found is None:
            continue
        compared += 1
        slow = exhaustive(a, b, 25.0, 0.03)
        # A pair much further apart than the others is not taken, although it is within the
        # tolerance.
        assert {(int(i), int(j)) for i, j in found.pairs} <= slow
        assert len(slow) - len(found.pairs) <= 1
    assert compared >= 8


def test_order_direction_and_regular_parts_change_nothing():
    rng = np.random.default_rng(12)
    points = scattered(20, rng)
    (a, _), (b, _) = seen(points, rng, 0.3, 0.3), seen(points, rng, 0.2, 0.1)
    b = pose(rng)(b)
    found = {(int(i), int(j)) for i, j in match_marks(a, b).pairs}
    assert found == {(int(j), int(i)) for i, j in match_marks(b, a).pairs}
    order = rng.permutation(len(a))
    assert found == {(int(order[i]), int(j)) for i, j in match_marks(a[order], b).pairs}
    # One line of the coded pattern is periodic: nothing is missing, so the others tell.
    points = coded()
    points[:7] = np.stack([np.arange(7) * 700.0, np.zeros(7)], axis=1)
    rng = np.random.default_rng(15)
    found = match_marks(points, pose(rng)(points) + rng.normal(0, 2, points.shape))
    assert np.array_equal(found.pairs[:, 0], found.pairs[:, 1])
    assert len(found.pairs) == 21


@pytest.mark.parametrize("kind", ["stretch", "lens"])
def test_a_stretched_or_distorted_sheet_of_20_mm_is_matched(kind):
    """0.5 % over 20 mm is 100 um, four times the tolerance."""
    rng = np.random.default_rng(13)
    for _ in range(8):
        points = rng.uniform(0, (20_000, 15_000), (int(rng.integers(15, 41)), 2))
        (a, of_a), (b, of_b) = seen(points, rng, 0.3, 0.3), seen(points, rng, 0.3, 0.3)
        if kind == "stretch":
            b = b * (1.005, 1.0)
        else:
            out = (b - (10_000, 7_500)) / 10_000
            b = b + 10_000 * 0.003 * out * np.sum(out**2, axis=1, keepdims=True)
        found = match_marks(a, pose(rng)(b))
        assert np.mean(of_a[found.pairs[:, 0]] == of_b[found.pairs[:, 1]]) > 0.9
        assert len(found.pairs) >= 0.8 * len(np.intersect1d(of_a[of_a >= 0], of_b))
    if kind == "stretch":
        assert "stretched by 0.5 %" in found.sentence


SYMMETRIC = {
    "square": [(0, 0), (900, 0), (900, 900), (0, 900)],
    "pentagon": [(800 * np.cos(t), 800 * np.sin(t)) for t in np.arange(5) * 2 * np.pi / 5],
    "line": [(k * 600.0, 0) for k in range(6)],
    "lattice": [(600.0 * i, 600.0 * j) for i in range(4) for j in range(3)],
    "two-fold": [(0, 0), (700, 150), (1500, 90), (2500, 1200), (1800, 1050), (1000, 1110)],
}


@pytest.mark.parametrize("name", SYMMETRIC)
@pytest.mark.parametrize("jitter", [0.0, 4.0])
def test_symmetric_patterns_are_always_refused(name, jitter):
    rng = np.random.default_rng(1)
    for _ in range(6):
        points = np.array(SYMMETRIC[name], float) + rng.normal(0, jitter, (len(SYMMETRIC[name]), 2))
        with pytest.raises(CannotRegister, match=r"symmetric|alike|ambiguous"):
            match_marks(points, pose(rng)(points) + rng.normal(0, 1, points.shape))


def turned(half, parts):
    z = (half @ (1, 1j)) * np.exp(2j * np.pi * np.arange(parts) / parts)[:, None]
    return np.stack([z.real.ravel(), z.imag.ravel()], axis=1)


WITH_LOSS = {
    "two-fold": lambda rng: turned(scattered(9, rng) * (1.0, 0.6) + 400, 2),
    "four-fold": lambda rng: turned(scattered(5, rng) + 300, 4),
    "mirror": lambda rng: (lambda half: np.concatenate([half, half * (-1, 1)]))(
        scattered(9, rng) + 300
    ),
    "line": lambda _: np.stack([np.arange(16) * 600.0, np.zeros(16)], axis=1),
    "lattice": (
        lambda _: np.stack(np.meshgrid(np.arange(5) * 600.0, np.arange(4) * 700.0), -1).reshape(
            -1, 2
        )
    ),
}


@pytest.mark.ci
@pytest.mark.parametrize("both", [False, True])
@pytest.mark.parametrize("false", [0.0, 0.3])
@pytest.mark.parametrize("name", WITH_LOSS)
def test_symmetric_patterns_that_lost_marks_are_refused(name, false, both):
    """30 % are missing on one side or on both, so that no side looks symmetric; together they
    do."""
    rng = np.random.default_rng(14)
    for _ in range(6):
        points = WITH_LOSS[name](rng)
        points = points + rng.normal(0, 4, points.shape)
        (a, _), (b, _) = seen(points, rng, 0.3, false), seen(points, rng, 0.3 * both, false * both)
        with pytest.raises(CannotRegister):
            match_marks(a, pose(rng, mirrored=name == "mirror")(b), mirror=name == "mirror")


def test_refusals_say_what_was_seen_by_the_names_of_the_sides():
    rng = np.random.default_rng(16)
    with pytest.raises(
        CannotRegister,
        match=r"10 marks of the volume and 12 of the image: no match found: .* agree",
    ):
        match_marks(scattered(10, rng), scattered(12, rng), names=("volume", "image"))
    points = WITH_LOSS["two-fold"](rng)
    (a, _), (b, _) = seen(points, rng, 0.2, 0.0), seen(points, rng, 0.2, 0.0)
    refused(
        CannotRegister,
        r"symmetric or regular: of the \d+ marks .* turned by 180 deg|ambiguous",
        match_marks,
        a,
        b,
    )
    with pytest.raises(MarkError, match=r"mark 1 .* of the image is not finite"):
        match_marks(points, [(0, 0), (np.nan, 1)], names=("volume", "image"))


def test_a_mirror_image_needs_a_word_and_three_marks_a_triangle_without_double():
    rng = np.random.default_rng(2)
    points = scattered(8, rng)
    seen = pose(rng, mirrored=True)(points)
    refused(CannotRegister, "mirror=True", match_marks, points, seen)
    assert match_marks(points, seen, mirror=True).mirrored
    points = np.array([(0.0, 0.0), (1500.0, 100.0), (300.0, 700.0)])
    found = match_marks(points, pose(np.random.default_rng(3))(points))
    assert np.array_equal(found.pairs[:, 0], found.pairs[:, 1])
    alike = np.array([(0.0, 0.0), (1000.0, 0.0), (500.0, 870.0)])
    assert tried(alike, alike) is None


@pytest.mark.ci
def test_a_wrong_handed_image_is_not_matched_by_chance():
    """Among many patterns some fit their own mirror image at most of their marks; the true hand
    gives them away."""
    rng = np.random.default_rng(6)
    for _ in range(200):
        points = scattered(int(rng.integers(5, 9)), rng)
        assert (
            tried(points, pose(rng, mirrored=True)(points) + rng.normal(0, 1, points.shape)) is None
        )


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_marks_are_named(count):
    points = scattered(4, np.random.default_rng(3))
    refused(CannotRegister, str(count) if count else "No|no|0", match_marks, points, points[:count])


def test_a_scale_outside_the_calibration_is_no_match_and_named_when_little():
    points = scattered(12, np.random.default_rng(17))
    assert tried(points, 1.08 * points) is None
    refused(
        CannotRegister,
        r"scale of 1\.0350, which is 3\.5 % off",
        match_marks,
        points,
        1.035 * points,
    )
