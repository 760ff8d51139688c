"""What is worked out band by band, against all at once."""

import numpy as np
import pytest

from planish.core import bands
from planish.core.area import AreaMeans, area_mean
from planish.core.bands import any_finite, rms_of, thinned


@pytest.fixture
def data():
    rng = np.random.default_rng(0)
    values = rng.normal(3, 2, (1300, 70))
    values[rng.random(values.shape) < 0.3] = np.nan
    return values, rng.random(values.shape) < 0.5


def test_bands_cover_all_rows_once():
    for rows in (1, 511, 512, 513, 1300):
        assert np.concatenate([np.arange(rows)[at] for at in bands.bands(rows)]).tolist() == list(
            range(rows)
        )


def test_root_mean_square_and_whether_there_is_a_value(data):
    values, where = data
    assert rms_of(values) == pytest.approx(np.sqrt(np.nanmean(values**2)))
    assert rms_of(values, where) == pytest.approx(np.sqrt(np.nanmean(values[where] ** 2)))
    assert rms_of(np.full((600, 3), np.nan)) is None
    only = np.full((1300, 5), np.nan)
    only[1200, 3] = 1.0
    assert any_finite(only)
    assert not any_finite(only, np.arange(1300)[:, None] < 1200 + np.zeros(5, int))


def test_every_kth_row_and_column_whatever_the_bands(data, monkeypatch):
    values, where = data
    k, (all_of_it,) = thinned(values)
    assert k == 1
    np.testing.assert_array_equal(all_of_it, values)
    monkeypatch.setattr(bands, "SAMPLE_PIXELS", 1300 * 70 // 40)
    k, found = thinned(values, where)
    assert k == 7
    np.testing.assert_array_equal(found[0], values[::7, ::7])
    np.testing.assert_array_equal(found[1], where[::7, ::7])


def test_area_means_of_several_maps_do_not_depend_on_the_bands(data):
    values, where = data
    known = np.isfinite(values) & where
    found = AreaMeans((1300, 70), (7.3, 5.0), least_share=0.2)
    for begin in range(0, 1300, 91):
        rows = slice(begin, begin + 91)
        found.add(begin, known[rows], values[rows], 2 * values[rows])
    first, second = found.means()
    np.testing.assert_allclose(
        first, area_mean(np.where(known, values, np.nan), (7.3, 5.0), least_share=0.2)
    )
    np.testing.assert_allclose(second, 2 * first)
    assert np.isfinite(first).mean() > 0.5
