"""Fine texture: noise shortens no displacement, and the error that is said is the one that is
left."""

import numpy as np
import pytest

from planish.sections import SectionSeries, align_sections
from planish.sections._kernels import pair_sums
from planish.sections.align import neighbours
from planish.sections.pairs import GROUPS, compare
from sections.bands import PIXEL_UM, fibres, make_series, rms, split


def shared_and_plain(a, b):
    still, wide = np.zeros(a.shape[1], np.float32), np.full(a.shape[0], 100.0)
    found = np.empty((2, 1, 15))
    for k in (0, 1):
        pair_sums(a, b, still, still, (1.0, 1.0), 1, wide, np.ones(a.shape[0]), found[k], float(k))
    return found[1, 0], found[0, 0]


def test_shared_gradients_equal_their_twin_and_noise_does_not_shorten_a_displacement():
    a, b = np.random.default_rng(1).normal(size=(2, 9, 30)).astype(np.float32)
    shared, plain = shared_and_plain(a, b)
    (ar, ac), (br, bc) = ([g[1:-1, 1:-1] for g in np.gradient(v.astype(float))] for v in (a, b))
    far = 1 - ((b - a)[1:-1, 1:-1] / 100.0) ** 2
    w = far**2
    twin = [(w * ar * br).sum(), 0.5 * (w * (ar * bc + ac * br)).sum(), (w * ac * bc).sum()]
    np.testing.assert_allclose(shared[[0, 1, 3]], twin, rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(shared[6:13], plain[6:13])
    slope = far * (5 * far - 4)
    twin = [(slope * ar * br).sum(), (slope * ac * bc).sum()]
    np.testing.assert_allclose(shared[13:], twin, rtol=1e-3, atol=1e-3)
    rng = np.random.default_rng(2)
    # Samples half a unit apart: a shift of one is 0.5 exactly.
    texture = fibres((60, 1600), (1.0, 0.5), rng, 6.0)
    a, b = (texture[:, k : k + 1598 : 2] + rng.normal(0, 0.3, (60, 799)) for k in (1, 0))
    shared, plain = shared_and_plain(a.astype(np.float32), b.astype(np.float32))
    told, short = -shared[7] / shared[3], -plain[7] / plain[3]
    print(f"0.5 told as {told:.3f}, without the correction {short:.3f}")
    assert told == pytest.approx(0.5, abs=0.04)
    assert short < 0.4


@pytest.mark.ci
def test_what_is_said_is_what_is_left():
    # Without scratches along the rows, an error that all columns share. Said before: 0.4 of the
    # truth for rows.
    series = make_series(seed=2, marks=False)
    found = align_sections(SectionSeries(series.stack, series.positions_um, PIXEL_UM))
    left = split(series.positions_um, found.shift_um - series.shift_um)[1]
    for axis in (0, 1):
        ratio = found.jitter_left_um[axis] / rms(left[:, axis])
        print(
            f"axis {axis}: said {found.jitter_left_um[axis]:.3f}, left {rms(left[:, axis]):.3f} um"
        )
        assert 1 / 1.5 < ratio < 1.5


@pytest.mark.ci
def test_a_known_displacement_is_told_by_newtons_step_in_full():
    # Each section is displaced by 0.3 um, small against what neighbours differ by, so that weights
    # give way as they do for the error that is left. One step with fixed weights tells 0.6 of it,
    # which the error of the poses was too small by.
    series = make_series(sections=80, cols=1600, marks=False, seed=3)
    given = SectionSeries(series.stack, series.positions_um, PIXEL_UM)
    first, second = neighbours(given.away_um, given.pitch_um, 1)
    true = np.column_stack([series.shift_um, series.rotation_rad])
    pushed = np.zeros_like(true)
    pushed[:, 1] = 0.3 * np.resize([-1.0, 1.0], len(true))
    told = []
    for pose in (true, true + pushed):
        pairs = compare(given, pose, first, second)
        left_out = pairs.without(GROUPS)  # none
        told.append([p.offset[:, 1] - p.base_offset[:, 1] for p in (pairs, left_out)])
    step = pushed[second, 1] - pushed[first, 1]
    fixed, newton = (
        -float(np.mean((after - before) / step)) for before, after in zip(*told, strict=True)
    )
    print(f"told with fixed weights {fixed:.2f}, by Newton's step {newton:.2f}")
    assert newton == pytest.approx(1.0, abs=0.15)
    assert fixed < 0.85
