"""Planned patterns: rules kept, codes unique, the same each time, and reasons where nothing fits."""

from itertools import combinations

import numpy as np
import pytest
from pydantic import ValidationError

from planish.core.errors import MarkError
from planish.core.transform import Similarity
from planish.design import DesignParams, ImagingParams, check_pattern, design_pattern, hole_error_um, plan, predict
from planish.design.rules import code_rules, crops, simple_rules
from planish.register import match_marks


@pytest.mark.parametrize(
    ("field", "options"),
    [
        ((20_000.0, 15_000.0), {}),
        ((20_000.0, 15_000.0), {"layout": "line"}),
        ((12_345.0, 9_876.5), {"origin_um": (1000.0, -500.0)}),
        ((6_000.0, 6_000.0), {}),
        ((100_000.0, 70_000.0), {"seed": 8}),
        ((4_500.0, 4_500.0), {"diameter_um": 150, "rim_um": 20}),
    ],
)
def test_what_is_planned_keeps_the_rules(field, options):
    pattern, rules = design_pattern(DesignParams(field_um=field, **options))
    assert all(rule.passed for rule in rules)
    assert [(r.name, r.value) for r in rules] == [(r.name, r.value) for r in check_pattern(pattern)]
    assert pattern.field_um == field
    points = pattern.points_um
    gaps = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))[~np.eye(len(points), dtype=bool)]
    assert gaps.min() >= max(500, 3 * pattern.diameter_um)
    # in the stage's frame nothing lies outside the view, and the holes lie on whole steps of 50 um
    seen = points - pattern.origin_um
    assert np.all(seen > 0)
    assert np.all(seen < pattern.view_um)
    steps = (points - pattern.frame_low_um) / 50
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


def test_coded_sides_are_golomb_rulers():
    pattern, _ = design_pattern(DesignParams(field_um=(20_000.0, 15_000.0)))
    points = pattern.points_um - pattern.frame_low_um
    for axis, level in ((0, 0.0), (1, pattern.frame_um[0]), (0, pattern.frame_um[1]), (1, 0.0)):
        on = np.sort(points[np.abs(points[:, 1 - axis] - level) < 1e-6][:, axis])
        distances = [round(b - a) for a, b in combinations(on, 2)]
        assert len(set(distances)) == len(distances)


def test_four_consecutive_holes_tell_where_they_are_over_fifty_seeds():
    """Any four holes in a row, turned, shifted, scaled by up to 3 % and 3 um off, fit nowhere else within 10 um."""
    blank = plan._blank_pattern(DesignParams(field_um=(20_000.0, 15_000.0)))
    tried = 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        while True:
            pattern = plan._draw_pattern(blank, 24, rng)
            if pattern is not None and code_rules(pattern)[0].passed and all(r.passed for r in simple_rules(pattern)):
                break
        z = pattern.points_um @ [1, 1j]
        n = len(z)
        windows = z[(np.arange(n)[:, None] + np.arange(4)) % n]
        where = int(rng.integers(n))
        seen = windows[where] * rng.uniform(0.98, 1.02) * np.exp(2j * np.pi * rng.random()) + 3e3
        seen = seen + 3 / np.sqrt(2) * (rng.normal(size=4) + 1j * rng.normal(size=4))
        fits = []
        for k, window in enumerate(windows):
            for goal in (window, window[::-1]):
                a, b = seen - seen.mean(), goal - goal.mean()
                alpha = np.vdot(a, b) / np.vdot(a, a)
                if abs(abs(alpha) - 1) <= 0.03 and np.abs(alpha * a - b).max() < 10:
                    fits.append(k)
        assert fits == [where], seed
        tried += 1
    assert tried == 50


def test_the_same_seed_gives_the_same_pattern():
    first, second, other = (design_pattern(DesignParams(field_um=(9_000.0, 8_000.0), seed=s))[0] for s in (4, 4, 5))
    assert first == second
    assert first.holes != other.holes


@pytest.mark.parametrize("field_um", [(500.0, 500.0), (3_000.0, 2_000.0), (6_000.0, 4_000.0)])
def test_a_small_field_gets_a_margin_with_room_for_its_holes(field_um):
    pattern, rules = design_pattern(DesignParams(field_um=field_um))
    assert all(rule.passed for rule in rules)
    assert len(pattern.holes) >= 20
    assert max(pattern.margin_um) < 2_600


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"field_um": (4_000.0, 3_000.0), "margin_um": 300.0}, ("rule 'area'", "at most 3 %", "larger margin")),
        *(
            ({"field_um": field, "holes": holes}, ("rule 'count'", "at least 12 holes: burn more holes"))
            for field, holes in (((20_000.0, 15_000.0), 11), *(((6_000.0, 4_000.0), few) for few in (6, 8, 10)))
        ),
        ({"field_um": (20_000.0, 15_000.0), "holes": 14}, ("rule 'crop'", "20 or more")),
        ({"field_um": (8_000.0, 8_000.0), "layout": "line", "margin_um": 300.0}, ("rule 'spacing'", "layout 'coded'")),
        pytest.param(
            {"field_um": (20_000.0, 15_000.0), "spacing_um": 4_000.0},
            ("rule 'spacing'", "spacing_um="),
            marks=pytest.mark.nightly,
        ),
        ({"field_um": (20_000.0, 15_000.0), "spacing_um": 300.0}, ("below 3 diameters, 525 um",)),
        ({"field_um": (20_000.0, 15_000.0), "margin_um": 100.0}, ("below 127.5 um",)),
        ({"field_um": (20.0, 15.0)}, ("field_um", "greater than or equal to 500")),
        ({"field_um": (20_000.0, 15_000.0), "pulse_s": 5.0}, ("pulse_s", "less than or equal to 1")),
        ({"field_um": (float("nan"), 15_000.0)}, ("field_um", "finite number")),
    ],
)
def test_a_refusal_names_the_rule_and_the_remedy(options, words):
    with pytest.raises((MarkError, ValidationError)) as refusal:
        design_pattern(DesignParams(**options))
    for word in words:
        assert word in str(refusal.value)


def test_predicted_error_by_hand():
    # 18.33 arcs; 2 * 5 / sqrt(18.33) = 2.336 um a map from the rim, 0.1 * sqrt(2) * 5 = 0.707 um from the pixels
    assert hole_error_um(175.0) == pytest.approx(np.sqrt(2 * (4 * 25 * 30 / (np.pi * 175) + 2 * 0.25)))
    assert hole_error_um(175.0, ImagingParams(pixel_um=(5.0, 12.0))) > hole_error_um(175.0)
    with pytest.raises(ValidationError, match="greater than 0"):
        hole_error_um(175.0, ImagingParams(pixel_um=(0.0, 5.0)))


def test_predicted_error_against_registrations_with_noise():
    """The formula is that of a least-squares similarity: 4000 fits, errors within 4 %."""
    pattern, _ = design_pattern(DesignParams(field_um=(20_000.0, 15_000.0)))
    predicted = predict(pattern)
    z = pattern.points_um @ [1, 1j]
    middle = z.mean()
    rng = np.random.default_rng(1)
    noise = predicted.fle_um / np.sqrt(2) * (rng.normal(size=(4000, len(z))) + 1j * rng.normal(size=(4000, len(z))))
    slope = (noise @ np.conj(z - middle)) / np.sum(np.abs(z - middle) ** 2)
    low, size = np.array(pattern.field_low_um), np.array(pattern.field_um)
    for share in ((0.5, 0.5), (0, 0), (1, 1)):
        point = low + size * share
        error = noise.mean(axis=1) + slope * (point @ [1, 1j] - middle)
        measured = np.sqrt(np.mean(np.abs(error) ** 2))
        assert measured == pytest.approx(float(predicted.at(point)), rel=0.04)
        if share == (0.5, 0.5):
            assert float(predicted.at(point)) == pytest.approx(predicted.centre_um)


def test_the_table_as_imaged_is_no_mirror_image_of_an_image():
    """Seen from the laser's side with y down, the same pattern turned: a rotation leads from one to the other."""
    pattern, _ = design_pattern(DesignParams(field_um=(20_000.0, 15_000.0)))
    stage, seen = pattern.points_um, pattern.imaged_um
    assert np.all(seen > 0)
    assert np.all(seen < pattern.view_um)
    # y down is the camera's way to write the same sheet: hole 1 stands at the lower left in both
    assert stage[0][1] < pattern.view_um[1] / 2 < seen[0][1]
    turned = Similarity(mirrored=True, rotation_rad=np.pi)(stage - pattern.origin_um)
    np.testing.assert_allclose(turned, seen - np.array([0, pattern.view_um[1]]))


def test_the_matching_recognises_what_crops_leave():
    """Crops of six holes or more, turned, scaled and 3 um off: found hole by hole in the design as imaged."""
    pattern, _ = design_pattern(DesignParams(field_um=(20_000.0, 15_000.0)))
    rng = np.random.default_rng(0)
    masks = [mask for mask in crops(pattern) if mask.sum() >= 6]
    assert masks
    for mask in masks[:8]:
        motion = Similarity(scale=rng.uniform(0.985, 1.015), rotation_rad=rng.uniform(-3, 3), shift_um=(500.0, 90.0))
        order = rng.permutation(np.flatnonzero(mask))
        found = motion(pattern.imaged_um[order])
        found = found + 3 / np.sqrt(2) * rng.normal(size=found.shape)
        matched = match_marks(pattern.imaged_um, found, tolerance_um=25.0)
        assert len(matched.pairs) >= 0.8 * len(order)
        assert all(order[j] == i for i, j in matched.pairs)
