"""The pose is part of the truth: it has to be exact both ways, and each of its errors as large as
it says."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planish.core.transform import Similarity
from planish.synthetic import CameraParams, CameraPose, draw_pose

SPREAD = (200.0, -300.0, 3200.0, 1700.0)
ALL_OFF = CameraParams(
    turn_range_deg=0.0, shift_range_um=0.0, scale_range=0.0, radial=0.0, stretch=0.0
)


def drawn(seed=0, spread=SPREAD, **changes):
    return draw_pose(replace(ALL_OFF, **changes), spread, np.random.default_rng(seed))


def share_in_view(shape, pose, pixel_um, spread=SPREAD):
    u, v = np.meshgrid(np.linspace(spread[0], spread[2], 90), np.linspace(spread[1], spread[3], 60))
    seen = pose(np.stack([u, v], axis=-1))
    ends = pixel_um * np.array([shape[1] - 1, shape[0] - 1])
    return np.mean(np.all((seen >= 0) & (seen <= ends), axis=-1))


@given(
    rotation=st.floats(-np.pi, np.pi),
    scale=st.floats(0.95, 1.05),
    mirrored=st.booleans(),
    stretch=st.floats(-0.01, 0.01),
    radial=st.floats(-0.02, 0.02),
    point=st.tuples(st.floats(-9000, 9000), st.floats(-9000, 9000)),
)
def test_the_inverse_is_exact(rotation, scale, mirrored, stretch, radial, point):
    pose = CameraPose(
        similarity=Similarity(
            scale=scale, rotation_rad=rotation, shift_um=(150.0, -420.0), mirrored=mirrored
        ),
        stretch=stretch,
        middle_um=(1700.0, 700.0),
        radial=radial,
        centre_um=(1560.0, 1120.0),
        half_diagonal_um=4000.0,
    )
    # Within 4.0 half diagonals of the middle: 1 / sqrt(3 x 0.02), where the lens would fold the
    # image.
    np.testing.assert_allclose(
        pose.inverse(pose([point, [0.0, 0.0]])), [point, [0.0, 0.0]], rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(pose(pose.inverse(np.array(point))), point, rtol=0, atol=1e-9)


def test_a_pose_keeps_missing_points_small_shifts_and_its_file():
    pose = CameraPose(similarity=Similarity(), radial=-0.1, half_diagonal_um=100.0)
    back = pose.inverse([[np.nan, 0.0], [150.0, 0.0], [100.0, 0.0]])
    # t - 0.1 t^3 has its maximum of 1.217 at t = 1.826.
    assert np.isnan(back[:2]).all()
    assert np.isfinite(back[2]).all()
    _, pose = drawn(seed=2, shift_range_um=100.0)
    want = 100.0 * np.random.default_rng(2).uniform(-1, 1, 5)[1:3]
    np.testing.assert_allclose(pose([[1700.0, 700.0]])[0] - pose.centre_um, want, atol=1e-9)
    _, pose = drawn(seed=3, radial=0.001, stretch=0.002, turn_range_deg=8.0, mirrored=True)
    known = json.loads(json.dumps(asdict(pose)))
    again = CameraPose(**{**known, "similarity": Similarity(**known["similarity"])})
    np.testing.assert_array_equal(again([[900.0, 50.0]]), pose([[900.0, 50.0]]))


def test_the_middle_stays_the_lens_moves_corners_and_the_stretch_has_two_signs():
    shape, pose = drawn(radial=0.001, stretch=0.002, turn_deg=7.0)
    middle = [[1700.0, 700.0]]
    # 4 um / 2.
    np.testing.assert_allclose(
        pose(middle), [[(shape[1] - 1) * 2.0, (shape[0] - 1) * 2.0]], atol=1e-9
    )
    shape, pose = drawn(radial=0.001)
    corner = np.array([0.0, 0.0])
    straight = replace(pose, radial=0.0)
    moved = pose(straight.inverse(corner)) - corner
    half = 2.0 * np.hypot(shape[0] - 1, shape[1] - 1)
    assert np.hypot(*moved) == pytest.approx(0.001 * half, rel=1e-9)
    assert (moved < 0).all()  # outwards: a cushion
    _, pose = drawn(seed=1, stretch=0.002)
    ends = pose([[0.0, 0.0], [1000.0, 0.0], [0.0, 1000.0]])
    along, across = ends[1, 0] - ends[0, 0] - 1000.0, ends[2, 1] - ends[0, 1] - 1000.0
    assert along == pytest.approx(-across, abs=1e-9)
    assert 0.05 < abs(along) <= 2.0  # um in 1 mm: 0.2 % at the most
    assert along == pytest.approx(1000.0 * pose.stretch)


@pytest.mark.parametrize(
    ("turn_deg", "mirrored"), [(0.0, True), (-15.0, False), (40.0, True), (155.0, False)]
)
def test_most_of_the_field_is_in_view_however_it_is_turned(turn_deg, mirrored):
    camera = CameraParams(turn_deg=turn_deg, mirrored=mirrored)
    off_middle = []
    for seed in range(4):
        shape, pose = draw_pose(camera, SPREAD, np.random.default_rng(seed))
        assert share_in_view(shape, pose, 4.0) > 0.845  # 85 %, less what another grid counts
        # 2.1 is the box around it at 45 degrees.
        assert shape[0] * shape[1] * 16.0 < 3.1 * 3000.0 * 2000.0
        off_middle.append(np.hypot(*(pose([[1700.0, 700.0]])[0] - pose.centre_um)))
        assert abs(np.rad2deg(pose.similarity.rotation_rad) - turn_deg) <= 8.0
    assert np.median(off_middle) > 100.0  # the specimen is not centred


def test_up_to_15_degrees_the_frame_keeps_its_sides():
    for turn in (-15.0, 0.0, 180.0):
        shape, _ = drawn(turn_deg=turn)
        assert shape == (int(1.30 * 2000 / 4), int(1.12 * 3000 / 4))
    assert drawn(turn_deg=90.0)[0] == (int(1.30 * 3000 / 4), int(1.12 * 2000 / 4))
