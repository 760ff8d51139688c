"""What the results hold of a lag."""

import json
import math

import numpy as np
import pytest

from planish.analyze import Lag
from planish.texture import LagField


def _lag(lag, *, expected_um, headline):
    return json.loads(lag.numbers(headline, expected_um).model_dump_json())


NAN = math.nan
NOWHERE = (NAN, NAN)


def a_lag(*, reason=None, tiles=True):
    """Return a lag of (3, -4) um, known to 0.6 and 0.8 um, or one that says nothing."""
    field = LagField(
        at_um=np.array([[100.0, 200.0], [300.0, 200.0]]),
        lag_um=np.array([[1.0, 2.0], NOWHERE]),
        covariance_um2=np.full((2, 2, 2), 0.25),
        r=np.array([0.6, 0.1]),
        distinct=np.array([True, False]),
        tile_um=400.0,
    )
    quiet = reason is not None
    return Lag(
        lag_um=NOWHERE if quiet else (3.0, -4.0),
        covariance_um2=np.full((2, 2), NAN) if quiet else np.diag([0.36, 0.64]),
        r=-0.5,
        r_at_zero=-0.4,
        limit_r=0.15,
        reason=reason,
        light=NAN,
        reach_um=150.0,
        pixel_um=(8.0, 8.0),
        n=5000,
        field=field if tiles else None,
    )


def test_results_of_a_lag_are_ready_for_json():
    found = _lag(a_lag(), expected_um=4.0, headline="coating_top")
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert (found["lag_um"], found["se_um"], found["length_um"]) == ([3.0, -4.0], [0.6, 0.8], 5.0)
    # Along (3, -4) / 5: sqrt(0.6² 0.36 + 0.8² 0.64).
    assert found["length_se_um"] == pytest.approx(math.sqrt(0.36 * 0.36 + 0.64 * 0.64))
    # 5 um is less than 1.73 sqrt(16 + 0.36 + 0.64).
    assert found["agrees"] is True
    assert found["sentence"] == a_lag().sentence(4.0)
    assert found["tiles"] == [
        {"x": 100.0, "y": 200.0, "lag_um": [1.0, 2.0], "distinct": True},
        {"x": 300.0, "y": 200.0, "lag_um": None, "distinct": False},
    ]
    assert _lag(a_lag(), expected_um=1.0, headline="thickness")["agrees"] is False


def test_results_of_a_lag_that_says_nothing_are_none():
    found = _lag(a_lag(reason="texture", tiles=False), expected_um=4.0, headline="coating_top")
    json.dumps(found, allow_nan=False)
    assert [found[k] for k in ("lag_um", "se_um", "length_um", "agrees", "light", "tile_um")] == [
        None
    ] * 6
    assert (found["tiles"], found["reason"]) == ([], "texture")
    for missing in (None, NAN):
        assert _lag(a_lag(), expected_um=missing, headline="coating_top")["expected_um"] is None
