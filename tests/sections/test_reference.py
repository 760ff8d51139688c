"""Something that lies still shows the drift that neighbours cannot tell from a bend of the
sheet."""

import numpy as np
import pytest
from scipy.special import ndtr

from planish.core.errors import VolumeError
from planish.sections import SectionSeries, align, align_sections, fixed_places, network
from sections.bands import PIXEL_UM, make_series, rms


def with_fixture(series, drift, *, seed=0):
    """The same photographs with a strip above that shows an edge, and one on the left; all drift
    along."""
    rng = np.random.default_rng(seed)
    n, rows, cols = series.stack.shape
    strip = 40
    out = np.empty((n, rows + strip, cols + strip))
    up = (np.arange(rows + strip) - 0.5 * (rows + strip - 1)) * PIXEL_UM[0]
    across = (np.arange(cols + strip) - 0.5 * (cols + strip - 1)) * PIXEL_UM[1]
    for i in range(n):
        shift = series.shift_um[i] + drift[i, :2]
        turn = series.rotation_rad[i] + drift[i, 2]
        down = up[:, None] - shift[0] - turn * across
        side = across - shift[1] + turn * up[:, None]
        frame = (
            50
            + 120 * ndtr((up[strip // 2] - down) / 2.0)
            + 120 * ndtr((across[strip // 2] - side) / 2.0)
        )
        out[i] = frame + rng.normal(0, 6, frame.shape)
        out[i, strip:, strip:] = series.stack[i]
    return np.clip(np.rint(out), 0, 255).astype(np.uint8), strip


@pytest.fixture(scope="module")
def drifting():
    series = make_series(sections=160, cols=500, rows=130, missing=(40, 41))
    t = np.linspace(0, 1, series.stack.shape[0])
    drift = np.stack([20 * t**2, 12 * np.sin(3 * t), 1e-3 * t], axis=1)
    return (series, drift, *with_fixture(series, drift))


@pytest.mark.ci
def test_places_against_two_edges(drifting):
    series, drift, stack, strip = drifting
    found = fixed_places(stack, PIXEL_UM, rows=(0, strip - 4), cols=(0, strip - 4))
    true = np.column_stack([series.shift_um, series.rotation_rad]) + drift
    error = found - (true - true.mean(axis=0))
    print(
        f"rms error {rms(error[:, 0]):.3f} and {rms(error[:, 1]):.3f} um,"
        f" {1e6 * rms(error[:, 2]):.1f} urad"
    )
    assert rms(error[:, 0]) < 0.15
    assert rms(error[:, 1]) < 0.15
    assert rms(error[:, 2]) < 5e-5


@pytest.mark.ci
def test_what_lies_still_brings_back_the_bend(drifting):
    series, drift, stack, strip = drifting
    # the sheet's own photographs drift too: those of the fixture tell how far
    moved = series.stack
    fixed = fixed_places(stack, PIXEL_UM, rows=(0, strip - 4))
    free = align_sections(SectionSeries(moved, series.positions_um, PIXEL_UM))
    held = align_sections(SectionSeries(moved, series.positions_um, PIXEL_UM), fixed=fixed)
    assert (free.fixed, held.fixed) == ((False, False, False), (True, False, True))
    # what comes in is the slow part of all that the fixture shows, and nothing else
    true = series.shift_um[:, 0] + drift[:, 0]
    away = series.positions_um - series.positions_um[0]
    slow = network.slow_part(away, true - true.mean(), cutoff_um=held.cutoff_um)
    assert rms(slow) > 5
    assert rms(held.shift_um[:, 0] - free.shift_um[:, 0] - slow) < 0.1
    np.testing.assert_array_equal(held.shift_um[:, 1], free.shift_um[:, 1])


def test_a_small_step_is_found_whatever_the_gain_and_a_strip_without_a_line_refused():
    x = np.arange(60.0)
    template = ndtr((x - 30) / 3)[None]
    moved = 0.7 * ndtr((x - 30.4) / 3)[None, None] + 5
    step, alike = align._match_template(moved, template)
    assert step[0, 0] == pytest.approx(0.4, abs=0.02)
    assert alike[0, 0] > 0.99
    noise = np.random.default_rng(0).normal(100, 5, (30, 60, 80))
    with pytest.raises(VolumeError, match="no line or edge"):
        fixed_places(noise, PIXEL_UM, rows=(5, 40))
    with pytest.raises(VolumeError, match="does not lie in"):
        fixed_places(noise, PIXEL_UM, cols=(70, 90))
