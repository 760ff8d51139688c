"""Stage programs: what the dry run reads is what was designed, and what is not safe is refused."""

from itertools import permutations

import numpy as np
import pytest
from pydantic import ValidationError

from folders import refused
from planish.core.errors import MarkError
from planish.design import StageParams, dry_run, short_route, stage_program

SAFE = ["G21", "G90", "F1200", "G0 X1 Y1", "M3", "G4 P0.005", "M5", "G4 P0.1", "G0 X0 Y0", "M2"]


def fired_in_order(run, pattern):
    """Shots sorted as the holes of the pattern."""
    apart = np.hypot(*(pattern.points_um[:, None] - run.fired_um[None]).transpose(2, 0, 1))
    return run.fired_um[np.argmin(apart, axis=1)]


@pytest.mark.parametrize(
    "stage",
    [StageParams(), StageParams(pulse_code="m64"), StageParams(power=1000.0, speed_mm_min=600.5)],
)
def test_the_dry_run_fires_the_design(pattern, stage):
    run = dry_run(stage_program(pattern, stage))
    assert len(run.fired_um) == len(pattern.holes)
    # six decimals of a millimetre: half of 0.001 um
    np.testing.assert_allclose(fired_in_order(run, pattern), pattern.points_um, atol=0.0005 + 1e-9)
    np.testing.assert_array_equal(run.pulse_s, 0.005)
    np.testing.assert_allclose(run.path_um[[0, -1]], [pattern.origin_um] * 2, atol=0.0005 + 1e-9)
    assert run.least_pause_s >= 0.1
    waits = len(run.fired_um) * (0.005 + 0.1)
    assert run.time_s == pytest.approx(
        waits + 60 * run.length_um / 1000 / stage.speed_mm_min, rel=1e-9
    )


def test_the_program_has_the_times_of_its_pattern_and_its_title_ends_no_comment(pattern):
    slow = pattern.model_copy(update={"pulse_s": 0.0123, "pause_s": 0.0})
    run = dry_run(stage_program(slow))
    np.testing.assert_allclose(run.pulse_s, 0.0123)
    assert "G4 P0.1" not in stage_program(slow)
    assert stage_program(pattern) == stage_program(pattern)
    nasty = pattern.model_copy(update={"name": "A\nG0 X99 Y99\r\nM3 µ"})
    assert dry_run(stage_program(nasty)).sentence() == dry_run(stage_program(pattern)).sentence()
    assert stage_program(nasty).isascii()


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({0: "G20"}, "G20 is not known"),
        ({0: ""}, "before G21"),
        ({1: "G91"}, "G91 is not known"),
        ({1: ""}, "before G21"),
        ({2: "", 8: "G0 X5 Y5"}, "before a speed F"),
        ({2: "F0"}, "not positive"),
        ({3: "G0 X101 Y1"}, "out of the stage's range"),
        ({3: "G0 X1 Y-0.5"}, "out of the stage's range"),
        ({3: "G0 X1"}, "before both X and Y"),
        ({3: "G0 X1 Y1 Z2"}, "Z has no meaning"),
        ({3: "G0 X1 X2"}, "given twice"),
        ({3: "G0 X1,5 Y1"}, "not in the dialect"),
        ({3: "G0 X1 Y1 M3"}, "two commands"),
        ({4: "M4"}, "M4 is not known"),
        ({5: ""}, "without a length"),
        ({5: "G4"}, "needs a time P"),
        ({5: "G4 P-1"}, "needs a time P"),
        ({5: "G4 P5"}, "P is in seconds"),
        ({5: "G0 X2 Y2"}, "with the laser on"),
        ({6: ""}, "longer than"),  # the pause is burnt as well
        ({6: "", 7: "", 8: ""}, "ends with the laser on"),
        ({6: "M65 P0"}, "does not switch off"),
        ({7: "M3"}, "a second shot"),
        ({4: "M3\nM3"}, "on already"),
        ({9: ""}, "no end"),
        ({9: "M2\nM3"}, "goes on after its end"),
        ({4: "", 5: "", 6: ""}, "fires no shot"),
        ({9: "", 8: "", 7: "", 6: ""}, "stops with the laser on"),
    ],
)
def test_broken_programs_are_refused(change, word):
    dry_run("\n".join(SAFE))
    with pytest.raises(MarkError, match=word) as refusal:
        dry_run("\n".join(change.get(k, line) for k, line in enumerate(SAFE)))
    assert str(refusal.value)[0].isupper()


def test_a_refusal_names_the_line_and_the_range_of_the_stage_is_kept(pattern):
    long = "\n".join(SAFE).replace("P0.005", "P5")
    refused(MarkError, r"Line 6 of the program \('G4 P5'\)", dry_run, long)
    limits = StageParams(range_um=(0.0, 0.0, 9_000.0, 9_000.0))
    refused(MarkError, "out of the stage's range", dry_run, stage_program(pattern), limits)
    refused(ValidationError, "larger", StageParams, range_um=(5.0, 5.0, 0.0, 0.0))
    refused(ValidationError, "speed", StageParams, speed_mm_min=0.0)
    refused(ValidationError, "power", StageParams, pulse_code="m64", power=3.0)


def test_what_other_programs_write_too():
    """Comments in brackets, line numbers, lower case, modal moves, G1, M30, a tape's percent
    sign."""
    text = (
        "%\n(a program)\nN10 g21 g90\nN20 F600\ng1 x1.0 y1\nm3 s500\ng4p.005\nm5\ng1 x2\ny3\nm3\ng4"
        " p0.005\nm5\nm30\n%"
    )
    run = dry_run(text)
    np.testing.assert_allclose(run.fired_um, [[1000, 1000], [2000, 3000]])
    assert (run.length_um, run.time_s) == (pytest.approx(3000), pytest.approx(3 / 10 + 0.01))
    assert run.least_pause_s == pytest.approx(0.3)


def path_um(points, order, start):
    """Length of the path from the start through the points in this order and back."""
    path = np.vstack([start, np.asarray(points)[order], start])
    return np.hypot(*np.diff(path, axis=0).T).sum()


def test_the_way_against_every_order():
    """Six holes have 720 orders: the way found is at most 5 % longer than the shortest, and mostly
    the shortest."""
    shortest_found = 0
    for seed in range(10):
        points = np.random.default_rng(seed).uniform(0, 10_000, (6, 2))
        best = min(path_um(points, np.array(order), (0.0, 0.0)) for order in permutations(range(6)))
        route = short_route(points, (0.0, 0.0))
        assert sorted(route.tolist()) == list(range(6))
        found = path_um(points, route, (0.0, 0.0))
        assert found <= 1.05 * best
        shortest_found += found <= best + 1e-6
    assert shortest_found >= 8


def test_the_way_around_a_field_is_the_way_around(pattern):
    """Holes around a rectangle: nothing is shorter than once around it."""
    way = path_um(
        pattern.points_um, short_route(pattern.points_um, pattern.origin_um), pattern.origin_um
    )
    around = path_um(pattern.points_um, np.arange(len(pattern.holes)), pattern.origin_um)
    assert way <= around + 1e-6
