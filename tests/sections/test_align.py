"""Alignment of sections whose every pose is known, and each kernel against its slow twin."""

import numpy as np
import pytest

from folders import refused
from planish.core.errors import VolumeError
from planish.core.threads import limit_threads
from planish.sections import SectionSeries, align_sections, band, network, normalise_sections
from planish.sections._kernels import interpolate, pair_sums, smooth, straighten
from sections.bands import PITCH_UM, PIXEL_UM, make_series, rms, split

MISSING = (50, 51, 52, 120)


@pytest.fixture(scope="module")
def series():
    """Rises by up to 0.5 um per um; errors 1.5 um, turned by 0.02 degrees, 4 % noise, four sections
    missing."""
    return make_series(missing=MISSING)


@pytest.fixture(scope="module")
def alignment(series):
    return align_sections(SectionSeries(series.stack, series.positions_um, PIXEL_UM))


@pytest.mark.ci
def test_quick_errors_are_taken_off(series, alignment):
    before = split(series.positions_um, series.shift_um)[1]
    after = split(series.positions_um, alignment.shift_um - series.shift_um)[1]
    print(
        f"rows {rms(before[:, 0]):.2f} -> {rms(after[:, 0]):.3f} um, cols {rms(before[:, 1]):.2f}"
        f" -> {rms(after[:, 1]):.3f} um; said {alignment.jitter_left_um}"
    )
    assert alignment.aligned.all()
    # What remains is the sheet itself: in 2 mm its faces, rough by 2 um over 30 um, rise and sink
    # together by 0.2 um, and its fibres wander together along the columns by 0.35 um. It falls with
    # the root of the width.
    assert rms(after[:, 0]) < 0.3
    assert rms(after[:, 1]) < 0.5
    # Two halves of the columns tell the error within a factor of 4: faces and texture of both
    # halves weigh otherwise.
    assert rms(after[:, 0]) / 4 < alignment.jitter_left_um[0] < 2 * rms(after[:, 0])
    assert rms(after[:, 1]) / 2 < alignment.jitter_left_um[1] < 2 * rms(after[:, 1])


@pytest.mark.ci
def test_missing_sections_and_a_nick_move_nothing_and_rotations_are_not_made_worse(
    series, alignment
):
    error = alignment.shift_um - series.shift_um
    for gap in (
        np.searchsorted(series.positions_um, 50 * PITCH_UM),
        np.searchsorted(series.positions_um, 120 * 3.0),
    ):
        beside = split(series.positions_um, error)[1][gap - 3 : gap + 3]
        # Six sections on both sides; the sheet rises by 6 um over the wider gap. Three standard
        # deviations as above.
        assert np.abs(beside[:, 0]).max() < 0.9
        step = error[gap, 0] - error[gap - 1, 0]
        assert abs(step) < 0.9
    before = rms(series.rotation_rad)
    after = rms(alignment.rotation_rad - series.rotation_rad)
    print(f"rotation {np.rad2deg(before):.4f} -> {np.rad2deg(after):.4f} degrees")
    assert after < before  # in 2 mm its own error is as large as what there is to find
    stack = series.stack.copy()
    stack[:, :, 500:502] = np.minimum(stack[:, :, 500:502].astype(int) + 60, 255)
    found = align_sections(SectionSeries(stack, series.positions_um, PIXEL_UM))
    assert rms(found.shift_um - alignment.shift_um) < 0.2


@pytest.mark.nightly
def test_a_true_bend_is_left_alone():
    still = make_series(errors=(0.0, 0.0), turn_rad=0.0, seed=2)
    found = align_sections(SectionSeries(still.stack, still.positions_um, PIXEL_UM))
    slow = split(still.positions_um, found.shift_um)[0]
    print(f"bend of +-48 um changed by {np.abs(slow[:, 0]).max():.3f} um")
    assert np.abs(slow[:, 0]).max() < 0.2
    # The bend does not come back as a correction of waves of any length: rms as with errors.
    assert rms(found.shift_um[:, 0]) < 0.3


@pytest.mark.nightly
def test_wide_sections_tell_rotations_and_more():
    wide = make_series(sections=60, cols=2400, seed=4)
    found = align_sections(SectionSeries(wide.stack, wide.positions_um, PIXEL_UM))
    after = split(wide.positions_um, found.rotation_rad - wide.rotation_rad)[1]
    print(
        f"rotation {np.rad2deg(rms(wide.rotation_rad)):.4f} -> {np.rad2deg(rms(after)):.4f} degrees"
    )
    assert rms(after) < 0.4 * rms(wide.rotation_rad)  # measured 0.2


@pytest.mark.ci
def test_torn_sections_are_flagged_and_disturb_nothing(series, alignment):
    stack = series.stack.copy()
    stack[80] = np.random.default_rng(0).integers(0, 255, stack[80].shape)
    stack[140] = 60
    found = align_sections(SectionSeries(stack, series.positions_um, PIXEL_UM))
    assert np.flatnonzero(~found.aligned).tolist() == [80, 140]
    assert not found.shift_um[[80, 140]].any()
    good = np.setdiff1d(np.arange(stack.shape[0]), [80, 140])
    # Two of 196 sections less: the others move by less than their own error.
    assert rms((found.shift_um - alignment.shift_um)[good]) < 0.15
    assert found.pairs_refused >= 20


@pytest.mark.ci
def test_threads_direction_and_type_do_not_matter(series):
    stack, positions = series.stack[:60], series.positions_um[:60]
    with limit_threads(1):
        one = align_sections(SectionSeries(stack, positions, PIXEL_UM))
    with limit_threads(3):
        three = align_sections(SectionSeries(stack, positions, PIXEL_UM))
    np.testing.assert_array_equal(one.shift_um, three.shift_um)
    back = align_sections(SectionSeries(stack.astype(np.uint16), 500.0 - positions, PIXEL_UM))
    np.testing.assert_array_equal(one.shift_um, back.shift_um)


@pytest.mark.ci
def test_drift_of_colour_is_taken_off():
    # Fibres of 4 % over 30 um in 2.9 mm: their mean goes up and down by 0.3 %, which no anchor can
    # tell from a drift.
    drifting = make_series(sections=60, cols=1200, texture=4.0, drift=0.03)
    found = normalise_sections(SectionSeries(drifting.stack, drifting.positions_um, PIXEL_UM))
    rest = found.gain * drifting.gain
    background = found.gain * (60 * drifting.gain + drifting.offset) + found.offset
    print(
        f"gain {drifting.gain.std():.4f} -> {rest.std() / rest.mean():.4f}, background"
        f" {background.std():.3f}"
    )
    assert found.measured.all()
    assert rest.std() / rest.mean() < 0.005
    # Noise of 10 over some 50 000 pixels, cut to two standard deviations and rounded, is 0.05;
    # twice that.
    assert background.std() < 0.12
    with limit_threads(1):
        one = normalise_sections(SectionSeries(drifting.stack, drifting.positions_um, PIXEL_UM))
    np.testing.assert_array_equal(found.gain, one.gain)


def test_what_is_no_series_is_refused():
    blank, places = np.full((10, 40, 64), 60, np.uint8), np.arange(10.0)
    twice = np.array([0, 1, 2, 2, 4, 5, 6, 7, 8, 9.0])
    for words, stack, positions, pixels in (
        ("No sheet", blank, places, PIXEL_UM),
        ("sections 3 and 4 lie at 2 and 2 um", blank, twice, PIXEL_UM),
        ("10 sections and 9 positions", blank, places[:9], PIXEL_UM),
        ("is none", blank, places, (0.0, 1.0)),
        ("at least two of each", blank[0], places, PIXEL_UM),
    ):
        refused(
            VolumeError,
            words,
            lambda *series: align_sections(SectionSeries(*series)),
            stack,
            positions,
            pixels,
        )


# --- parts ----------------------------------------------------------------------------------------
def test_the_slow_part_is_the_smoother_applied_twice_and_passes_cubics():
    rng = np.random.default_rng(1)
    y, cut = rng.normal(size=40), 10.0
    fourth = np.diff(np.eye(40), 4, axis=0)
    stiffness = (cut / (2 * np.pi)) ** 8 / (1 / np.sqrt(0.5) - 1)
    smoother = np.linalg.inv(np.eye(40) + stiffness * fourth.T @ fourth)
    twin = smoother @ y + smoother @ (y - smoother @ y)
    np.testing.assert_allclose(
        network.slow_part(np.arange(40.0) * 3, y, cutoff_um=cut * 3), twin, atol=1e-9
    )
    x = 3 * np.arange(120) + np.random.default_rng(2).uniform(-1, 1, 120)
    y = 1 + x - 0.01 * x**2 + 1e-5 * x**3
    np.testing.assert_allclose(network.slow_part(x, y, cutoff_um=150.0), y, atol=1e-3)


def test_places_survive_a_fifth_of_wrong_pairs():
    rng = np.random.default_rng(3)
    place = rng.normal(0, 2, 80)
    first, second = np.array([(i, j) for i in range(80) for j in range(i + 1, min(i + 6, 80))]).T
    offset = place[second] - place[first] + rng.normal(0, 0.05, first.size)
    wrong = rng.random(first.size) < 0.2
    offset[wrong] += rng.normal(0, 20, wrong.sum())
    found, kept = network.solve_places(first, second, offset, np.full(first.size, 0.05), 80)
    error = found - place
    assert np.std(np.diff(error)) < 0.1  # 0.05 um a pair, some eight good pairs each
    assert np.median(kept[wrong]) < 0.01


def test_block_means_smoothing_and_layers_equal_their_twins():
    section = np.random.default_rng(4).normal(size=(17, 23)).astype(np.float32)
    section[3, 4] = np.nan
    out = band.block_means(section, 3, 5)
    np.testing.assert_allclose(
        out, section[:15, :20].reshape(5, 3, 4, 5).mean(axis=(1, 3)), rtol=1e-5, atol=1e-6
    )
    values = np.random.default_rng(6).normal(size=(9, 12)).astype(np.float32)
    down, across = (np.array(w, np.float32) for w in ([0.25, 0.5, 0.25], [0.1, 0.2, 0.4, 0.2, 0.1]))
    out = np.empty_like(values)
    smooth(values, down, across, np.empty(20, np.float32), out)
    padded = np.pad(values.astype(float), ((1, 1), (2, 2)), mode="edge")
    twin = np.zeros(values.shape)
    for (i, v), (j, w) in ((a, b) for a in enumerate(down) for b in enumerate(across)):
        twin += v * w * padded[i : i + 9, j : j + 12]
    np.testing.assert_allclose(out, twin, atol=1e-6)
    section = np.random.default_rng(9).normal(size=(30, 12)).astype(np.float32)
    section[15, 3] = np.nan
    height = np.linspace(12, 17, 12).astype(np.float32)
    core, off = band.core_and_background(section, height, 4.0, 8.0, (1, 3))
    away = np.abs(np.arange(30)[:, None] - height)
    inside = section[away <= 4]
    np.testing.assert_array_equal(core, inside[np.isfinite(inside)])
    np.testing.assert_array_equal(off, section[away >= 8][::3])


def test_straighten_twin():
    rng = np.random.default_rng(5)
    section = rng.integers(0, 255, (40, 30)).astype(np.uint8)
    height = (20 + rng.uniform(-9, 9, 30)).astype(np.float32)
    pose = np.array([0.7, -1.3, 0.01, -0.02])
    out = np.zeros((6, 10), np.float32)
    straighten(section, height, -6.0, 2, 3, pose, out)
    twin = np.zeros((6, 10))
    for k, b in np.ndindex(6, 10):
        total = 0.0
        for s in range(2 * k, 2 * k + 2):
            for c in range(3 * b, 3 * b + 3):
                r = height[c] - 6.0 + s
                total += bilinear(
                    section, r + pose[0] + pose[2] * (c - 14.5), c + pose[1] - pose[3] * (r - 19.5)
                )
        twin[k, b] = total / 6
    assert np.isnan(twin).any()
    np.testing.assert_allclose(out, twin, rtol=1e-5, atol=1e-3)


def bilinear(section, y, x):
    i, j = int(np.floor(y)), int(np.floor(x))
    if i < 0 or j < 0 or i >= section.shape[0] - 1 or j >= section.shape[1] - 1:
        return np.nan
    p, q = y - i, x - j
    a = section[i : i + 2, j : j + 2].astype(float)
    return float(np.array([1 - p, p]) @ a @ np.array([1 - q, q]))


def test_pair_sums_twin():
    rng = np.random.default_rng(7)
    a, b = rng.normal(0.5, 1, (2, 8, 20)).astype(np.float32)
    a[2, 5] = np.nan
    x, y = rng.normal(0, 100, (2, 20)).astype(np.float32)
    limit, trust = rng.uniform(1, 3, 8), rng.uniform(0.2, 1, 8)
    sums = np.empty((3, 15))
    pair_sums(a, b, x, y, (2.0, 5.0), 3, limit, trust, sums)
    twin = np.zeros((3, 15))
    for chunk in range(3):
        for k in range(1, 7):
            for c in range(max(1, 20 * chunk // 3), min(19, 20 * (chunk + 1) // 3)):
                d = float(b[k, c]) - float(a[k, c])
                gr = (a[k + 1, c] - a[k - 1, c] + b[k + 1, c] - b[k - 1, c]) / 8
                gc = (a[k, c + 1] - a[k, c - 1] + b[k, c + 1] - b[k, c - 1]) / 20
                if not np.isfinite(d + gr + gc):
                    continue
                g = np.array([gr, gc, gr * x[c] - gc * (y[c] + (k - 3.5) * 2.0)])
                far = max(0.0, 1 - (d / limit[k]) ** 2)
                w = trust[k] * far**2
                slope = trust[k] * far * (5 * far - 4)  # of d far^2
                square = (float(a[k, c]) - 0.5) ** 2 + (float(b[k, c]) - 0.5) ** 2
                twin[chunk] += [
                    *(w * np.outer(g, g)[np.triu_indices(3)]),
                    *(w * g * d),
                    w * d * d,
                    w * square,
                    w,
                    trust[k],
                    *(slope * g[:2] ** 2),
                ]
    np.testing.assert_allclose(sums, twin, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize(
    ("turn", "shift"), [(0.0, (0.4, -1.7)), (0.03, (-50.0, 40.0)), (-0.03, (2.0, 3.0))]
)
def test_between_twin(turn, shift):
    rng = np.random.default_rng(8)
    first, second = rng.integers(0, 255, (2, 24, 31)).astype(np.uint8)
    poses = np.array([[*shift, turn, turn], [-0.6, 0.2, -turn, -turn]])
    grades = np.array([[1.1, -3.0], [0.9, 4.0]])
    whole, real = np.empty((24, 31), np.uint8), np.empty((24, 31), np.float32)
    interpolate(first, second, 0.3, poses, grades, 0.0, 255.0, True, whole)
    interpolate(first, second, 0.3, poses, grades, -np.inf, np.inf, False, real)
    twin = np.zeros((24, 31))
    for r, c in np.ndindex(24, 31):
        for section, share, pose, grade in zip(
            (first, second), (0.7, 0.3), poses, grades, strict=True
        ):
            y = np.clip(r + pose[0] + pose[2] * (c - 15.0), 0, 23)
            x = np.clip(c + pose[1] - pose[3] * (r - 11.5), 0, 30)
            padded = np.pad(section, ((0, 1), (0, 1)), mode="edge")
            padded = np.pad(padded, ((0, 1), (0, 1)), mode="edge")
            twin[r, c] += share * (grade[0] * bilinear(padded, y, x) + grade[1])
    np.testing.assert_allclose(real, twin, atol=2e-3)
    assert np.abs(whole.astype(float) - np.clip(twin, 0, 255)).max() <= 0.502
