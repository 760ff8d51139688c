"""Planned patterns: rules kept, codes unique, the same each time, and reasons where nothing
fits."""

from itertools import combinations

import numpy as np
import pytest
from pydantic import ValidationError

from planish.core.errors import MarkError
from planish.core.transform import Similarity
from planish.design import (
    DesignParams,
    ImagingParams,
    check_pattern,
    design_pattern,
    hole_error_um,
    predict,
)


@pytest.mark.parametrize(
    ("field", "options"),
    [
        ((20_000.0, 15_000.0), {}),
        pytest.param((20_000.0, 15_000.0), {"layout": "line"}, marks=pytest.mark.ci),
        ((12_345.0, 9_876.5), {"origin_um": (1000.0, -500.0)}),
        ((4_500.0, 4_500.0), {"diameter_um": 150, "rim_um": 20}),
    ],
)
def test_what_is_planned_keeps_the_rules(field, options):
    pattern, rules = design_pattern(DesignParams(field_um=field, **options))
    assert all(rule.passed for rule in rules)
    assert [(r.name, r.value) for r in rules] == [(r.name, r.value) for r in check_pattern(pattern)]
    assert pattern.field_um == field
    points = pattern.points_um
    gaps = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))[
        ~np.eye(len(points), dtype=bool)
    ]
    assert gaps.min() >= max(500, 3 * pattern.diameter_um)
    # in the stage's frame nothing lies outside the view, and the holes lie on whole steps of 50 um
    seen = points - pattern.origin_um
    assert np.all(seen > 0)
    assert np.all(seen < pattern.view_um)
    steps = (points - pattern.frame_low_um) / 50
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


def test_coded_sides_are_golomb_rulers(pattern):
    points = pattern.points_um - pattern.frame_low_um
    for axis, level in ((0, 0.0), (1, pattern.frame_um[0]), (0, pattern.frame_um[1]), (1, 0.0)):
        on = np.sort(points[np.abs(points[:, 1 - axis] - level) < 1e-6][:, axis])
        distances = [round(b - a) for a, b in combinations(on, 2)]
        assert len(set(distances)) == len(distances)


def test_any_four_consecutive_holes_tell_where_they_are(pattern):
    """Turned, shifted, scaled by up to 2 % and 3 um off, they fit nowhere else within 10 um."""
    rng = np.random.default_rng(0)
    z = pattern.points_um @ [1, 1j]
    windows = z[(np.arange(len(z))[:, None] + np.arange(4)) % len(z)]
    for where, four in enumerate(windows):
        seen = four * rng.uniform(0.98, 1.02) * np.exp(2j * np.pi * rng.random()) + 3e3
        seen = seen + 3 / np.sqrt(2) * (rng.normal(size=4) + 1j * rng.normal(size=4))
        a = seen - seen.mean()
        fits = []
        for k, window in enumerate(windows):
            for goal in (window, window[::-1]):
                b = goal - goal.mean()
                alpha = np.vdot(a, b) / np.vdot(a, a)
                if abs(abs(alpha) - 1) <= 0.03 and np.abs(alpha * a - b).max() < 10:
                    fits.append(k)
        assert fits == [where]


def test_the_same_seed_gives_the_same_pattern():
    first, second, other = (
        design_pattern(DesignParams(field_um=(3_000.0, 2_000.0), seed=s))[0] for s in (4, 4, 5)
    )
    assert first == second
    assert first.holes != other.holes


@pytest.mark.parametrize("field_um", [(500.0, 500.0), (3_000.0, 2_000.0)])
def test_a_small_field_gets_a_margin_with_room_for_its_holes(field_um):
    pattern, rules = design_pattern(DesignParams(field_um=field_um))
    assert all(rule.passed for rule in rules)
    assert len(pattern.holes) >= 20
    assert max(pattern.margin_um) < 2_600


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"field_um": (4_000.0, 3_000.0), "margin_um": 300.0},
            ("rule 'area'", "at most 3 %", "larger margin"),
        ),
        (
            {"field_um": (20_000.0, 15_000.0), "holes": 11},
            ("rule 'count'", "at least 12 holes: burn more holes"),
        ),
        (
            {"field_um": (6_000.0, 4_000.0), "holes": 6},
            ("rule 'count'", "at least 12 holes: burn more holes"),
        ),
        ({"field_um": (20_000.0, 15_000.0), "holes": 14}, ("rule 'crop'", "20 or more")),
        (
            {"field_um": (8_000.0, 8_000.0), "layout": "line", "margin_um": 300.0},
            ("rule 'spacing'", "layout 'coded'"),
        ),
        pytest.param(
            {"field_um": (20_000.0, 15_000.0), "spacing_um": 4_000.0},
            ("rule 'spacing'", "spacing_um="),
            marks=pytest.mark.nightly,
        ),
        ({"field_um": (20_000.0, 15_000.0), "spacing_um": 300.0}, ("below 3 diameters, 525 um",)),
        ({"field_um": (20_000.0, 15_000.0), "margin_um": 100.0}, ("below 127.5 um",)),
        ({"field_um": (20.0, 15.0)}, ("field_um", "greater than or equal to 500")),
        (
            {"field_um": (20_000.0, 15_000.0), "pulse_s": 5.0},
            ("pulse_s", "less than or equal to 1"),
        ),
        ({"field_um": (float("nan"), 15_000.0)}, ("field_um", "finite number")),
    ],
)
def test_a_refusal_names_the_rule_and_the_remedy(options, words):
    with pytest.raises((MarkError, ValidationError)) as refusal:
        design_pattern(DesignParams(**options))
    for word in words:
        assert word in str(refusal.value)


def test_predicted_error_by_hand():
    # 18.33 arcs; 2 * 5 / sqrt(18.33) = 2.336 um a map from the rim, 0.1 * sqrt(2) * 5 = 0.707 um
    # from the pixels
    assert hole_error_um(175.0) == pytest.approx(
        np.sqrt(2 * (4 * 25 * 30 / (np.pi * 175) + 2 * 0.25))
    )
    assert hole_error_um(175.0, ImagingParams(pixel_um=(5.0, 12.0))) > hole_error_um(175.0)
    with pytest.raises(ValidationError, match="greater than 0"):
        hole_error_um(175.0, ImagingParams(pixel_um=(0.0, 5.0)))


def test_predicted_error_is_that_of_a_least_squares_similarity(pattern):
    """Noise moves the fit by its mean, and turns and scales it about the middle of the holes."""
    predicted = predict(pattern)
    away = pattern.points_um - pattern.points_um.mean(axis=0)
    low, size = np.array(pattern.field_low_um), np.array(pattern.field_um)
    assert float(predicted.at(low + 0.5 * size)) == pytest.approx(predicted.centre_um)
    for share in ((0.5, 0.5), (0, 0), (1, 1)):
        point = low + size * share
        lever = np.sum((point - pattern.points_um.mean(axis=0)) ** 2) / np.sum(away**2)
        assert float(predicted.at(point)) == pytest.approx(
            predicted.fle_um * np.sqrt(1 / len(away) + lever)
        )


def test_the_table_as_imaged_is_no_mirror_image_of_an_image(pattern):
    """Seen from the laser's side with y down, the same pattern turned: a rotation leads from one to
    the other."""
    stage, seen = pattern.points_um, pattern.imaged_um
    assert np.all(seen > 0)
    assert np.all(seen < pattern.view_um)
    # y down is the camera's way to write the same sheet: hole 1 stands at the lower left in both
    assert stage[0][1] < pattern.view_um[1] / 2 < seen[0][1]
    turned = Similarity(mirrored=True, rotation_rad=np.pi)(stage - pattern.origin_um)
    np.testing.assert_allclose(turned, seen - np.array([0, pattern.view_um[1]]))
