"""Sections on a regular grid: right places, one interpolation, gaps bridged or named."""

import numpy as np
import pytest

from planish.core.errors import VolumeError
from planish.core.threads import limit_threads
from planish.sections import (
    Alignment,
    Gains,
    SectionSeries,
    align_sections,
    normalise_sections,
    regular_volume,
)
from sections.bands import PIXEL_UM, make_series


def ramp(positions, shape=(12, 20)):
    """Grey that rises linearly along all three axes: linear interpolation is exact."""
    r, c = np.indices(shape)
    return np.stack([10.0 + 0.5 * p + 2.0 * r + 1.0 * c for p in positions])


def posed(n, shift=(0.0, 0.0), turn=0.0, aligned=None):
    return Alignment(
        shift_um=np.tile(shift, (n, 1)),
        rotation_rad=np.full(n, turn),
        aligned=np.ones(n, bool) if aligned is None else aligned,
        jitter_left_um=np.array([0.1, 0.2]),
        pairs_used=1,
        pairs_refused=0,
        cutoff_um=150.0,
    )


def test_uneven_and_even_sections_lie_at_their_true_places():
    stack = np.random.default_rng(1).integers(0, 255, (9, 12, 20)).astype(np.uint16)
    volume = regular_volume(SectionSeries(stack, 50 + 3.0 * np.arange(9), (2.0, 4.0)))
    np.testing.assert_array_equal(volume.values, stack)
    assert (volume.dtype, volume.dims) == (np.uint16, ("z", "y", "x"))
    np.testing.assert_array_equal(volume.z, 3.0 * np.arange(9))
    np.testing.assert_array_equal(volume.x, 4.0 * np.arange(20))
    assert (volume.attrs["voxel_um"], volume.attrs["full_scale"]) == ([3.0, 2.0, 4.0], 65535)
    assert (volume.attrs["first_position_um"], volume.attrs["sections_missing"]) == (50.0, 0)
    positions = np.array([0, 3, 6.5, 9, 11, 14, 17, 20.0])
    volume = regular_volume(
        SectionSeries(ramp(positions).astype(np.float32), positions, (2.0, 4.0))
    )
    np.testing.assert_allclose(volume.values, ramp(volume.z.values), rtol=1e-6)
    assert volume.sizes["z"] == 7  # 0 to 18 in steps of 3; the last section lies between two planes


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_up_to_three_missing_sections_are_bridged(direction):
    positions = np.array([0, 3, 6, 18, 21, 24.0])
    stack = ramp(positions).astype(np.uint8)
    volume = regular_volume(SectionSeries(stack, direction * positions, (2.0, 4.0)))
    # Sections are rounded down by up to a half here, and the volume is rounded once.
    assert np.abs(volume.values - ramp(3.0 * np.arange(9))).max() <= 1.0
    assert volume.attrs["sections_missing"] == 3


def test_longer_gaps_and_sections_without_alignment_are_named_or_empty():
    positions = np.array([0, 3, 6, 21, 24, 27.0])
    with pytest.raises(
        VolumeError, match=r"4 between 6 and 21 um.*At most 3 in a row.*split the series"
    ):
        regular_volume(SectionSeries(ramp(positions).astype(np.uint8), positions, (2.0, 4.0)))
    volume = regular_volume(
        SectionSeries(ramp(positions).astype(np.float32), positions, (2.0, 4.0))
    )
    empty = np.isnan(volume.values).all(axis=(1, 2))
    np.testing.assert_array_equal(np.flatnonzero(empty), [3, 4, 5, 6])
    assert np.isfinite(volume.values[~empty]).all()
    positions = 3.0 * np.arange(8)
    stack = ramp(positions).astype(np.float32)
    stack[4] = 99
    volume = regular_volume(
        SectionSeries(stack, positions, (2.0, 4.0)), alignment=posed(8, aligned=np.arange(8) != 4)
    )
    np.testing.assert_allclose(volume.values, ramp(positions), rtol=1e-6)
    with pytest.raises(VolumeError, match="1 of 8 sections could be aligned"):
        regular_volume(
            SectionSeries(stack, positions, (2.0, 4.0)),
            alignment=posed(8, aligned=np.arange(8) == 4),
        )


def test_shift_turn_and_gain_are_taken_off_in_one_step():
    positions = 3.0 * np.arange(4)
    stack = ramp(positions).astype(np.float32)
    volume = regular_volume(
        SectionSeries(stack, positions, (2.0, 4.0)), alignment=posed(4, (1.0, 6.0), 0.01)
    )
    # 1 um is half a row (2 a row), 6 um are 1.5 columns (1 a column); 0.01 rad: 4 um a column is
    # 0.02 rows, 2 um a row is 0.005 columns less.
    r, c = np.indices((12, 20))
    expected = ramp(positions) + 1.0 + 1.5 + 2.0 * 0.02 * (c - 9.5) - 0.005 * (r - 5.5)
    np.testing.assert_allclose(volume.values[:, 1:-2, 1:-3], expected[:, 1:-2, 1:-3], rtol=1e-5)
    assert volume.attrs["jitter_left_um"] == [0.1, 0.2]
    stack = np.tile(np.array([10, 100, 250], np.uint8), (4, 3, 1))
    gains = Gains(gain=np.full(4, 1.1), offset=np.full(4, -20.0), measured=np.ones(4, bool))
    volume = regular_volume(SectionSeries(stack, 3.0 * np.arange(4), (2.0, 4.0)), gains=gains)
    np.testing.assert_array_equal(volume.values[0, 0], [0, 90, 255])  # -9, 90, 255


@pytest.mark.ci
def test_the_whole_stage_puts_the_sheet_where_it_was():
    truth = make_series(
        errors=(0.0, 0.0), turn_rad=0.0, noise=0.0, marks=False, sections=64, cols=480
    )
    series = make_series(drift=0.03, marks=False, sections=64, cols=480, missing=(40, 41, 42))
    where = SectionSeries(series.stack, series.positions_um, PIXEL_UM)
    found, gains = align_sections(where), normalise_sections(where)
    attrs = {"file_name": "v", "voxel_um_source": "the cut counter"}
    with limit_threads(1):
        volume = regular_volume(where, alignment=found, gains=gains, attrs=attrs)
    with limit_threads(3):
        again = regular_volume(where, alignment=found, gains=gains, attrs=attrs)
    np.testing.assert_array_equal(volume.values, again.values)
    assert (volume.dtype, volume.shape, volume.attrs["file_name"]) == (
        np.uint8,
        truth.stack.shape,
        "v",
    )
    assert volume.attrs["voxel_um_source"] == "the cut counter"
    exact = regular_volume(SectionSeries(truth.stack, truth.positions_um, PIXEL_UM))
    heights = [np.diff(middle(v.values)) for v in (exact, regular_volume(where), volume)]
    before, after = (np.std((h - heights[0])[np.r_[:38, 43:63]]) for h in heights[1:])
    print(f"steps from section to section, error {before:.2f} -> {after:.2f} um")
    assert before > 1.5  # 1.5 um in each of two sections is 2.1 um, less what noise adds
    assert after < 0.35  # 0.2 um in each, as for the alignment


def middle(values):
    """Height of the sheet in each section, in um: centre of its grey above half way, over all
    columns."""
    weight = np.clip(values.astype(float) - 95.0, 0, 30)
    rows = np.arange(values.shape[1])[None, :, None]
    return ((weight * rows).sum(axis=(1, 2)) / weight.sum(axis=(1, 2))) * PIXEL_UM[0]


class OneByOne:
    """A stack that gives one section at a time, as photographs in their files do."""

    def __init__(self, stack):
        self.stack, self.shape, self.dtype, self.ndim = stack, stack.shape, stack.dtype, 3

    def __getitem__(self, key):
        assert isinstance(key, int)
        return self.stack[key]


@pytest.mark.ci
def test_photographs_in_their_files_give_the_same_volume_in_parts():
    series = make_series(sections=60, cols=300, missing=(20, 21))
    where = (series.positions_um, PIXEL_UM)
    found = align_sections(SectionSeries(series.stack, *where))
    again = align_sections(SectionSeries(OneByOne(series.stack), *where))
    np.testing.assert_array_equal(found.shift_um, again.shift_um)
    whole = regular_volume(SectionSeries(series.stack, *where), alignment=found)
    parts = regular_volume(SectionSeries(OneByOne(series.stack), *where), alignment=found)
    assert parts.encoding["whole_slices"]
    assert parts.shape == whole.shape
    np.testing.assert_array_equal(
        parts.isel(z=slice(15, 30), y=slice(10, 40)).values, whole.values[15:30, 10:40]
    )
    np.testing.assert_array_equal(parts.values, whole.values)
