"""The rules of hole patterns: each can fail, and what is symmetric is always refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from folders import refused
from planish.core.errors import MarkError
from planish.design import check_pattern, own_pattern
from planish.design.rules import (
    CROP,
    code_misfit_um,
    crops,
    perimeter_order,
    self_motions,
    simple_rules,
)


def broken(pattern):
    return {rule.name for rule in check_pattern(pattern) if not rule.passed}


def moved(pattern, points):
    return pattern.with_holes(np.asarray(points), ("own",) * len(points))


def test_a_good_pattern_breaks_no_rule_and_few_close_or_marking_holes_do(pattern):
    assert broken(pattern) == set()
    assert "count" in broken(moved(pattern, pattern.points_um[:11]))
    assert "count" not in broken(moved(pattern, pattern.points_um[:12]))
    points = pattern.points_um.copy()
    points[5] = points[4] + [0, 3 * pattern.diameter_um - 1]
    assert "spacing" in broken(moved(pattern, points))
    # Asked for more than three diameters.
    assert "spacing" in broken(pattern.model_copy(update={"spacing_um": 2000.0}))
    corner = np.array(pattern.frame_low_um)
    assert "marker" in broken(moved(pattern, [*pattern.points_um, corner]))


def test_around(pattern):
    low, size = np.array(pattern.field_low_um), np.array(pattern.field_um)
    points = pattern.points_um.copy()
    points[3] = low + size / 2
    assert "around" in broken(moved(pattern, points))
    # the burnt zone counts: half a diameter and the rim
    reach = 0.5 * pattern.diameter_um + pattern.rim_um
    for inwards, is_broken in ((-reach - 1, False), (-reach + 1, True)):
        points[3] = low + np.array([size[0] / 2, inwards])
        assert ("around" in broken(moved(pattern, points))) == is_broken


def test_radius_and_area(pattern):
    # the same holes around a field with a diagonal of which their rms radius is exactly 0.4
    radius = np.sqrt(
        np.mean(np.sum((pattern.points_um - pattern.points_um.mean(axis=0)) ** 2, axis=1))
    )
    side = radius / 0.4 / np.sqrt(2)
    for factor, passed in ((0.999, True), (1.001, False)):
        rules = simple_rules(
            pattern.model_copy(update={"field_um": (factor * side, factor * side)})
        )
        assert next(rule.passed for rule in rules if rule.name == "radius") == passed
    # holes of 175 um with rims of 40 um, pi / 4 * 255^2 um2 each; the view of which that is 3 %
    side = np.sqrt(len(pattern.holes) * np.pi / 4 * 255**2 / 0.03)
    around = 2 * (pattern.margin_um[0] + pattern.border_um)
    for factor, passed in ((1.001, True), (0.999, False)):
        field = factor * side - around
        rules = simple_rules(pattern.model_copy(update={"field_um": (field, field)}))
        assert next(rule.passed for rule in rules if rule.name == "area") == passed


def test_crop_against_windows_drawn_at_random(pattern):
    """No window that keeps a side of the view leaves fewer holes than the rule says."""
    masks, rng = crops(pattern), np.random.default_rng(5)
    points = pattern.points_um - pattern.origin_um
    view, radius = np.array(pattern.view_um), pattern.diameter_um / 2
    fewest = len(points)
    for _ in range(4000):
        low = rng.uniform(0, CROP, 2) * view
        kept = rng.integers(2)
        low[kept] = rng.choice([0.0, CROP * view[kept]])
        inside = np.all(
            (points - radius >= low) & (points + radius <= low + (1 - CROP) * view), axis=1
        )
        fewest = min(fewest, int(inside.sum()))
        assert any(np.all(mask <= inside) for mask in masks)
    assert masks.sum(axis=1).min() == 4 <= fewest
    middle = np.abs(points[:, 0] / view[0] - 0.5) < 0.2
    assert "crop" in broken(
        moved(pattern, pattern.points_um[~(middle & (points[:, 1] < 0.1 * view[1]))])
    )


TURN = np.array([[0, -1], [1, 0]])
MOTIONS = {
    "half turn": [TURN @ TURN],
    "quarter turn": [TURN, TURN @ TURN, -TURN],
    "left-right mirror": [np.diag([-1, 1])],
    "up-down mirror": [np.diag([1, -1])],
}


def symmetric(rng, motions):
    """12 to 28 holes beside the sides of a square, symmetric in one way, each a few um off."""
    count = int(rng.integers(12, 29)) // (1 + len(motions))
    part = np.stack([rng.uniform(-9_000, 9_000, count), rng.uniform(9_000, 10_000, count)], axis=1)
    part = np.where(rng.random((count, 1)) < 0.5, part, part[:, ::-1])
    points = np.concatenate([part, *(part @ motion for motion in motions)])
    return points + rng.normal(0, 4, points.shape)


@pytest.mark.parametrize("kind", MOTIONS)
def test_symmetric_patterns_are_always_refused(kind):
    name = "mirror" if "mirror" in kind else kind
    for seed in range(10):
        rules = check_pattern(own_pattern(symmetric(np.random.default_rng(seed), MOTIONS[kind])))
        rule = next(rule for rule in rules if rule.name == name)
        assert not rule.passed, seed
        assert name in rule.sentence()


def test_symmetry_of_most_holes_and_a_line_of_even_pitch_are_refused():
    """Half of the holes turned by 180 degrees: two thirds meet a hole; a sixth may be anywhere."""
    rng = np.random.default_rng(0)
    points = symmetric(rng, MOTIONS["half turn"])
    own = own_pattern(np.concatenate([points, rng.uniform(-7000, 7000, (len(points) // 3, 2))]))
    assert "half turn" in broken(own)
    # Shifted by one pitch, all holes but the ends meet holes; any four look like any other four.
    x = 700.0 * np.arange(27)
    points = np.concatenate([np.stack([x, 0 * x], 1), np.stack([x[1:], 0 * x[1:] + 15_000], 1)])
    found = broken(own_pattern(points))
    assert {"shift", "code"} <= found


def test_code_misfit_by_hand():
    """Two lines of four, of which one pitch differs by 60 um; what runs round the corners differs
    more."""
    a = np.cumsum([0.0, 1000, 1400, 2100])
    # Runs the other way round the field: in order 1060, 1400, 2100.
    b = np.cumsum([0.0, 3000, 2100, 1400, 1060])
    points = np.concatenate([np.stack([a, 0 * a], 1), np.stack([b + 3300, 0 * b + 9000], 1)])
    # with turn, shift and scale free, the misfit of (0, 1000, 2400, 4500) and (0, 1060, 2460, 4560)
    one, two = a - a.mean(), np.cumsum([0.0, 1060, 1400, 2100])
    two = two - two.mean()
    by_hand = np.abs(one @ two / (one @ one) * one - two).max()
    other_way = np.abs(one @ two / (two @ two) * two - one).max()
    assert 15 < min(by_hand, other_way) < 45
    assert code_misfit_um(points) == pytest.approx(min(by_hand, other_way))
    same = points.copy()
    same[4:, 0] = np.cumsum([3300.0, 3000, 2100, 1400, 1000])
    assert code_misfit_um(same) < 1e-6


@settings(max_examples=6)
@given(st.floats(-np.pi, np.pi), st.floats(-5e3, 5e3), st.booleans())
def test_the_search_does_not_depend_on_where_the_pattern_lies(pattern, turn, shift, flip):
    z = pattern.points_um @ [1, 1j] * np.exp(1j * turn) + shift
    z = np.conj(z) if flip else z
    here, there = self_motions(pattern.points_um), self_motions(np.stack([z.real, z.imag], 1))
    for kind in ("half turn", "quarter turn", "shift", "mirror"):
        assert abs(here.best_count(kind) - there.best_count(kind)) <= 1


def test_a_design_names_its_holes_along_the_frame(pattern):
    np.testing.assert_array_equal(perimeter_order(pattern.points_um), np.arange(len(pattern.holes)))


def test_hopeless_tables_are_refused_with_a_sentence():
    refused(MarkError, "2 holes are no pattern", own_pattern, [[0, 0], [1, 1]])
    refused(MarkError, "same x or the same y", own_pattern, [[0, 0], [1, 0], [5, 0]])
    many = own_pattern(np.random.default_rng(0).uniform(0, 1e5, (121, 2)))
    refused(MarkError, "more than the 120", check_pattern, many)
