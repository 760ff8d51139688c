"""The rules of hole patterns: each can fail, and what is symmetric is always refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planish.core.errors import MarkError
from planish.design import DesignParams, check_pattern, design_pattern, own_pattern
from planish.design.rules import CROP, _HoleIndex, code_misfit_um, crops, perimeter_order, self_motions, simple_rules


@pytest.fixture(scope="module")
def good():
    """A pattern that keeps every rule."""
    return design_pattern(DesignParams(field_um=(20_000.0, 15_000.0), seed=3))[0]


def broken(pattern):
    return {rule.name for rule in check_pattern(pattern) if not rule.passed}


def moved(pattern, points):
    return pattern.with_holes(np.asarray(points), ("own",) * len(points))


def test_a_good_pattern_breaks_no_rule_and_few_close_or_marking_holes_do(good):
    assert broken(good) == set()
    assert "count" in broken(moved(good, good.points_um[:11]))
    assert "count" not in broken(moved(good, good.points_um[:12]))
    points = good.points_um.copy()
    points[5] = points[4] + [0, 3 * good.diameter_um - 1]
    assert "spacing" in broken(moved(good, points))
    assert "spacing" in broken(good.model_copy(update={"spacing_um": 2000.0}))  # asked for more than three diameters
    corner = np.array(good.frame_low_um)
    assert "marker" in broken(moved(good, [*good.points_um, corner]))


def test_around(good):
    low, size = np.array(good.field_low_um), np.array(good.field_um)
    points = good.points_um.copy()
    points[3] = low + size / 2
    assert "around" in broken(moved(good, points))
    # the burnt zone counts: half a diameter and the rim
    reach = 0.5 * good.diameter_um + good.rim_um
    for inwards, refused in ((-reach - 1, False), (-reach + 1, True)):
        points[3] = low + np.array([size[0] / 2, inwards])
        assert ("around" in broken(moved(good, points))) == refused


def test_radius_and_area(good):
    # the same holes around a field with a diagonal of which their rms radius is exactly 0.4
    radius = np.sqrt(np.mean(np.sum((good.points_um - good.points_um.mean(axis=0)) ** 2, axis=1)))
    side = radius / 0.4 / np.sqrt(2)
    for factor, passed in ((0.999, True), (1.001, False)):
        rules = simple_rules(good.model_copy(update={"field_um": (factor * side, factor * side)}))
        assert next(rule.passed for rule in rules if rule.name == "radius") == passed
    # holes of 175 um with rims of 40 um, pi / 4 * 255^2 um2 each; the view of which that is 3 %
    side = np.sqrt(len(good.holes) * np.pi / 4 * 255**2 / 0.03)
    around = 2 * (good.margin_um[0] + good.border_um)
    for factor, passed in ((1.001, True), (0.999, False)):
        field = factor * side - around
        rules = simple_rules(good.model_copy(update={"field_um": (field, field)}))
        assert next(rule.passed for rule in rules if rule.name == "area") == passed


def test_crop_against_windows_drawn_at_random(good):
    """No window that keeps a side of the view leaves fewer holes than the rule says."""
    masks, rng = crops(good), np.random.default_rng(5)
    points = good.points_um - good.origin_um
    view, radius = np.array(good.view_um), good.diameter_um / 2
    fewest = len(points)
    for _ in range(4000):
        low = rng.uniform(0, CROP, 2) * view
        kept = rng.integers(2)
        low[kept] = rng.choice([0.0, CROP * view[kept]])
        inside = np.all((points - radius >= low) & (points + radius <= low + (1 - CROP) * view), axis=1)
        fewest = min(fewest, int(inside.sum()))
        assert any(np.all(mask <= inside) for mask in masks)
    assert masks.sum(axis=1).min() == 4 <= fewest
    middle = np.abs(points[:, 0] / view[0] - 0.5) < 0.2
    assert "crop" in broken(moved(good, good.points_um[~(middle & (points[:, 1] < 0.1 * view[1]))]))


def symmetric(rng, kind):
    """12 to 28 holes around a square or rectangle, symmetric in one way, each a few um off."""
    half = int(rng.integers(6, 15))
    size = np.array([20_000.0, 15_000.0 if kind != "quarter" else 20_000.0]) / 2
    if kind == "quarter":
        points = size * np.stack([np.sort(rng.uniform(-1, 1, half // 2 + 1)), -np.ones(half // 2 + 1)], axis=1)
        turns = [np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), k) for k in range(4)]
        points = np.concatenate([points @ turn.T for turn in turns])
    else:
        way = rng.uniform(0, 2, half)  # along two neighbouring sides
        near, far = np.stack([2 * way - 1, -np.ones(half)], 1), np.stack([np.ones(half), 2 * way - 3], 1)
        points = size * np.where(way[:, None] < 1, near, far)
        flip = {"half": [-1, -1], "left-right": [-1, 1], "up-down": [1, -1]}[kind]
        points = np.concatenate([points, points * flip])
    return points + rng.normal(0, 4, points.shape)


@pytest.mark.parametrize("kind", ["half", "quarter", "left-right", "up-down"])
@pytest.mark.parametrize(
    "seeds", [range(10), pytest.param(range(10, 50), marks=pytest.mark.nightly)], ids=["few", "many"]
)
def test_symmetric_patterns_are_always_refused(kind, seeds):
    rule = {"half": "half turn", "quarter": "quarter turn"}.get(kind, "mirror")
    for seed in seeds:
        rng = np.random.default_rng(seed)
        pattern = own_pattern(symmetric(rng, kind))
        values = {r.name: r for r in check_pattern(pattern)}
        assert not values[rule].passed, seed
        assert rule in values[rule].sentence()


def test_symmetry_of_most_holes_and_a_line_of_even_pitch_are_refused():
    """Half of the holes turned by 180 degrees: two thirds meet a hole; a sixth may be anywhere."""
    rng = np.random.default_rng(0)
    points = symmetric(rng, "half")
    own = own_pattern(np.concatenate([points, rng.uniform(-7000, 7000, (len(points) // 3, 2))]))
    assert "half turn" in broken(own)
    # Shifted by one pitch, all holes but the ends meet holes; any four look like any other four.
    x = 700.0 * np.arange(27)
    points = np.concatenate([np.stack([x, 0 * x], 1), np.stack([x[1:], 0 * x[1:] + 15_000], 1)])
    found = broken(own_pattern(points))
    assert {"shift", "code"} <= found


def test_code_misfit_by_hand():
    """Two lines of four, of which one pitch differs by 60 um; what runs round the corners differs more."""
    a = np.cumsum([0.0, 1000, 1400, 2100])
    b = np.cumsum([0.0, 3000, 2100, 1400, 1060])  # runs the other way round the field: in order 1060, 1400, 2100
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


@settings(max_examples=12)
@given(st.floats(-np.pi, np.pi), st.floats(-5e3, 5e3), st.booleans())
def test_the_search_does_not_depend_on_where_the_pattern_lies(good, turn, shift, flip):
    z = good.points_um @ [1, 1j] * np.exp(1j * turn) + shift
    z = np.conj(z) if flip else z
    here, there = self_motions(good.points_um), self_motions(np.stack([z.real, z.imag], 1))
    for kind in ("half turn", "quarter turn", "shift", "mirror"):
        assert abs(here.best_count(kind) - there.best_count(kind)) <= 1


def test_table_and_tree_give_the_same_holes_in_the_order_of_the_design(good):
    index = _HoleIndex(good.points_um)
    assert index.table is not None
    rng = np.random.default_rng(2)
    near = good.points_um[rng.integers(len(good.points_um), size=3000)] + rng.normal(0, 30, (3000, 2))
    z = np.concatenate([near, rng.uniform(-40_000, 60_000, (500, 2))]) @ [1, 1j]
    fast = index.holes_at(z[:, None])
    index.table = None
    np.testing.assert_array_equal(fast, index.holes_at(z[:, None]))
    np.testing.assert_array_equal(perimeter_order(good.points_um), np.arange(len(good.holes)))


def test_hopeless_tables_are_refused_with_a_sentence():
    with pytest.raises(MarkError, match="2 holes are no pattern"):
        own_pattern([[0, 0], [1, 1]])
    with pytest.raises(MarkError, match="same x or the same y"):
        own_pattern([[0, 0], [1, 0], [5, 0]])
    with pytest.raises(MarkError, match="more than the 120"):
        check_pattern(own_pattern(np.random.default_rng(0).uniform(0, 1e5, (121, 2))))
