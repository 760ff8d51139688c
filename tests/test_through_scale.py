"""The scale through the sheet: from the marks, and from thickness against slope."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from planish.checks import CHECKS, MeasuredSheet, RegisteredSheet, through_scale
from planish.core.frame import Frame
from planish.flatten import flatten_sheet, places_when_scaled
from planish.register import Pairs, find_through_scale, fit_transform

BY_THICKNESS, BY_MARKS = (
    next(rule for rule in CHECKS if rule.name == "scale through the sheet" and rule.stage is stage)
    for stage in (MeasuredSheet, RegisteredSheet)
)
SLOPE, WAVE_UM, TURN = 0.5, 1300.0, 0.4  # 27°
THICK_UM = 90.0


def sheet(stated=1.0, *, slope=SLOPE, through="z", top="high", grain=0.0):
    """A cylinder of one wave, its heights ``stated`` times what they are."""
    y, x = np.arange(150) * 10.0, np.arange(180) * 10.0
    across, down = np.meshgrid(x, y)
    t = across * np.cos(TURN) + down * np.sin(TURN)
    k = 2 * np.pi / WAVE_UM
    tilt = (slope * np.cos(k * t)) ** 2
    own = THICK_UM * (1 + grain * np.random.default_rng(3).normal(size=t.shape))
    seen = own * stated * np.sqrt((1 + tilt) / (1 + stated**2 * tilt))
    data = {
        "centre": stated * slope / k * np.sin(k * t),
        "thickness": seen,
        "status": np.zeros(t.shape, np.uint8),
    }
    attrs = {**Frame(through=through, top=top).attrs(), "voxel_um": [3.0 * stated, 3.0, 3.0]}
    return xr.Dataset(
        {n: (("y", "x"), v) for n, v in data.items()}, coords={"y": y, "x": x}, attrs=attrs
    )


def developed(points, slope=SLOPE):
    """Exact flat places of points (x, y) of the cylinder: arc length across, the point's own place
    along."""
    t, along = points @ [np.cos(TURN), np.sin(TURN)], points @ [-np.sin(TURN), np.cos(TURN)]
    steps = np.linspace(-100, 2500, 26001)
    speed = np.sqrt(1 + (slope * np.cos(2 * np.pi / WAVE_UM * steps)) ** 2)
    arc = np.concatenate([[0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(steps))])
    u = np.interp(t, steps, arc)
    return np.stack(
        [u * np.cos(TURN) - along * np.sin(TURN), u * np.sin(TURN) + along * np.cos(TURN)], axis=1
    )


def marks(seen, count, seed=1):
    """Indices of columns and where they lie on the flat map and in the volume."""
    rng = np.random.default_rng(seed)
    i, j = rng.integers(5, 145, count), rng.integers(5, 175, count)
    flat = flatten_sheet(seen).flat
    at = np.stack([flat[k].values[i, j] for k in "uv"], axis=1)
    return flat, at, np.stack([seen["x"].values[j], seen["y"].values[i]], axis=1)


def checked(
    seen, *, count=16, error_um=0.7, linear=None, wrong_um=0.0, seed=1, slope=SLOPE, model="auto"
):
    """Estimate and check of a sheet whose marks lie where its development has them, with errors."""
    flat, at, places = marks(seen, count, seed)
    fixed = developed(places, slope) @ (np.eye(2) if linear is None else np.asarray(linear))
    if seen.attrs["top_side"] == "low":
        fixed[:, 0] *= -1
    fixed += np.random.default_rng(seed + 100).normal(0, error_um / np.sqrt(2), fixed.shape)
    fixed[0] += wrong_um
    fit = fit_transform(at, fixed, model=model, lowest="similarity")
    registered = RegisteredSheet(measured=seen, flat=flat, fit=fit)
    found = through_scale.estimate(registered)
    return found, (
        None
        if found is None
        else through_scale.judge_marks(
            BY_MARKS, registered, found, through_scale.scale_from_thickness(seen)
        )
    )


def turned_onto(places, truth):
    """Rms distance of two sets of points after the best rotation and shift."""
    a, b = (
        p[:, 0] + 1j * p[:, 1] for p in (places - places.mean(axis=0), truth - truth.mean(axis=0))
    )
    turn = np.vdot(a, b)
    return float(np.sqrt(np.mean(np.abs(b - turn / abs(turn) * a) ** 2)))


def test_places_follow_the_exact_development():
    seen = sheet(1 / 1.5)
    flat, at, places = marks(seen, 20)
    scales, moved = places_when_scaled(seen, flat, at)
    for scale, found in zip(scales, moved, strict=True):
        assert turned_onto(found, developed(places, SLOPE * scale / 1.5)) < 0.06
    np.testing.assert_array_equal(moved[list(scales).index(1.0)], at)


@pytest.mark.ci
def test_a_mesh_of_half_the_pitch_moves_no_place_by_as_much_as_a_marks_own_error():
    seen = sheet(1 / 1.5)  # a slope to 0.8
    flat, at, _ = marks(seen, 20)
    usual = places_when_scaled(seen, flat, at)[1]
    other = places_when_scaled(seen, flat, at, mesh_um=12.5)[1]
    assert max(map(turned_onto, other, usual)) < 0.1


@pytest.mark.parametrize(
    ("stated", "top"), [(1.5, "high"), (1.1, "high"), (0.5, "high"), (1.5, "low")]
)
def test_marks_find_a_wrong_spacing(stated, top):
    found, check = checked(sheet(stated, top=top))
    assert found.scale == pytest.approx(1 / stated, abs=3 * found.error + 0.003)
    assert found.error < 0.02
    assert (check.state, check.value) == ("fail", found.scale)
    assert check.figures == ("properties", "position", "correlation")
    assert "`voxel_um`" in check.remedy


def test_a_right_spacing_passes():
    found, check = checked(sheet())
    assert (check.state, check.advice, found.scale) == (
        "pass",
        "",
        pytest.approx(1, abs=3 * found.error),
    )
    assert check.sentence.startswith("The marks imply a voxel spacing along z that is ")


def test_marks_without_any_error_imply_the_stated_spacing():
    """One volume linked to itself: no error is left, and a flat sheet hardly changes with scale."""
    seen = sheet(slope=0.02)
    flat, at, _ = marks(seen, 16)
    scales, places = places_when_scaled(seen, flat, at)
    information = np.geomspace(0.1, 10, len(at))[:, None, None] * np.eye(2)
    for size in (1, 20):
        pairs = Pairs(moving=size * at, fixed=size * at, information=information)
        found = find_through_scale(scales, size * places, pairs, mirrored=False)
        assert (found.scale, found.evidence) == (1.0, pytest.approx(0, abs=1e-6))
        assert found.error < 0.01


def test_a_stretch_that_explains_the_marks_better_than_any_spacing_is_no_fault_of_it():
    found, check = checked(sheet(), linear=[[1.04, 0], [0, 1]])
    assert check.state != "fail"
    assert found.over_stretch < 0 or check.state == "pass"
    assert found.stretch == pytest.approx(0.04, abs=0.003)


def test_a_wrong_mark_makes_no_wrong_spacing():
    _, check = checked(sheet(slope=0.3), count=8, wrong_um=60.0, slope=0.3, model="similarity")
    assert check.state in ("pass", "unknown")


def test_a_wrong_mark_hides_no_wrong_spacing():
    _, check = checked(sheet(1.5), count=16, wrong_um=60.0)
    assert check.state == "fail"


@pytest.mark.nightly
def test_its_error_is_what_it_says():
    """Thirty draws of nine marks: the scale over its error has the size that an estimate with few
    marks allows."""
    seen = sheet(1.2)
    flat, at, places = marks(seen, 60)
    scales, moved = places_when_scaled(seen, flat, at)
    z = []
    for k in range(30):
        some = np.random.default_rng(k).choice(60, 9, replace=False)
        fixed = developed(places[some]) + np.random.default_rng(k + 50).normal(0, 0.7, (9, 2))
        found = find_through_scale(
            scales, moved[:, some], weigh_evenly(at[some], fixed), mirrored=False
        )
        z.append((found.scale - 1 / 1.2) / found.error)
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.1


def weigh_evenly(moving, fixed):
    return Pairs(
        moving=moving, fixed=fixed, information=np.broadcast_to(np.eye(2), (len(moving), 2, 2))
    )


def test_a_plane_sheet_cannot_tell_a_spacing_from_a_stretch():
    """A plane that is tilted by 35°, stated half as steep: a stretch along the slope is the
    same."""
    seen = sheet()
    seen["centre"] = 0 * seen["y"] + 0.7 * seen["x"]
    seen["thickness"] = 0 * seen["centre"] + THICK_UM
    wrong = seen.assign(centre=0.5 * seen["centre"])
    flat, at, places = marks(wrong, 16)
    fixed = places * [np.sqrt(1 + 0.49), 1] + np.random.default_rng(0).normal(0, 0.5, at.shape)
    registered = RegisteredSheet(
        measured=wrong, flat=flat, fit=fit_transform(at, fixed, model="affine")
    )
    found = through_scale.estimate(registered)
    check = through_scale.judge_marks(
        BY_MARKS, registered, found, through_scale.scale_from_thickness(wrong)
    )
    assert (found.scale, check.state) == (pytest.approx(2, abs=0.05), "look")
    assert "explains it as well" in check.sentence


def test_flat_sheets_cannot_tell_a_spacing():
    found, check = checked(sheet(slope=0.03, grain=0.05), count=7, slope=0.03)
    assert found.error > 0.15
    assert check.state == "unknown"
    assert check.sentence.startswith("The sheet is too flat, or its 7 marks too few")
    check = BY_THICKNESS(MeasuredSheet(None, sheet(slope=0.05, grain=0.05)))
    assert check.state == "unknown"
    assert "marks can say more" in check.sentence
    empty = sheet().assign(status=(("y", "x"), np.full((150, 180), 2, np.uint8)))
    assert BY_THICKNESS(MeasuredSheet(None, empty)).value is None


def test_three_marks_or_marks_on_a_line_tell_no_spacing():
    assert checked(sheet(1.5), count=3)[0] is None
    seen = sheet()
    flat, _, _ = marks(seen, 8)
    line = np.stack([np.linspace(100, 1500, 8), np.full(8, 500.0)], axis=1)
    scales, places = places_when_scaled(seen, flat, line)
    assert find_through_scale(scales, places, weigh_evenly(line, line), mirrored=False) is None


def test_marks_beside_the_sheet_do_not_count():
    seen = sheet(1.5)
    flat, at, places = marks(seen, 16)
    at, fixed = (
        np.append(at, [[9e4, 9e4]], axis=0),
        np.append(developed(places), [[8e4, 8e4]], axis=0),
    )
    scales, moved = places_when_scaled(seen, flat, at)
    assert find_through_scale(scales, moved, weigh_evenly(at, fixed), mirrored=False).marks == 16


@pytest.mark.parametrize("stated", [2.0, 1.0, 0.5])
def test_thickness_against_slope_is_exact_without_noise(stated):
    found = through_scale.scale_from_thickness(sheet(stated, slope=0.8))
    assert found.scale == pytest.approx(1 / stated, rel=0.01)
    check = BY_THICKNESS(MeasuredSheet(None, sheet(stated, slope=0.8, grain=0.05)))
    assert check.state == ("pass" if stated == 1 else "look")


def test_thickness_tells_a_spacing_from_a_stretch():
    """Half the spacing on a sheet whose marks fit a stretch as well: the thickness decides."""
    seen = sheet(0.5, slope=0.8, grain=0.05)
    found, _ = checked(seen, slope=0.8)
    slope = through_scale.scale_from_thickness(seen)
    doubtful = replace(found, over_stretch=0.0)
    check = through_scale.judge_marks(
        BY_MARKS, RegisteredSheet(measured=seen, flat=None, fit=None), doubtful, slope
    )
    assert check.state == "fail"
    assert "Thickness against slope implies the same" in check.sentence
