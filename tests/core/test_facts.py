"""What results are made of: what is missing is NaN in memory and null in JSON."""

import json
import math

import pytest
from pydantic import Field, ValidationError

from planish.core.facts import Interval, ResultModel, Unsaved, Value, is_known


class Slope(ResultModel):
    """A statistic with a number that only its function gives."""

    slope: Value = Field(default=None)
    interval: Interval = Field(default=None)
    mean: Unsaved = Field(default=None, exclude=True)


class AtPoints(ResultModel):
    point_um: float


class MapSlope(Slope, AtPoints):
    """The same as a run holds it."""

    reason: str | None = None


def test_missing_numbers_are_nan_in_memory_and_null_in_json_and_schema():
    row = Slope()
    assert math.isnan(row.slope)
    assert all(map(math.isnan, row.interval))
    assert (
        json.loads(row.model_dump_json()) == {"slope": None, "interval": None} == row.model_dump()
    )
    schema = Slope.model_json_schema()["properties"]
    assert list(schema) == ["slope", "interval"]
    assert schema["slope"]["anyOf"] == [{"type": "number"}, {"type": "null"}]
    assert (schema["slope"]["default"], schema["interval"]["anyOf"][1]) == (None, {"type": "null"})


@pytest.mark.parametrize(("low", "high"), [(0.0, math.inf), (math.nan, 1.0), (-math.inf, 1.0)])
def test_an_interval_without_an_end_is_null_and_keeps_its_ends_in_memory(low, high):
    row = Slope(slope=2.0, interval=(low, high))
    assert row.interval[1] == high
    assert not is_known(row.interval)
    assert json.loads(row.model_dump_json()) == {"slope": 2.0, "interval": None}


def test_a_whole_holds_its_parts_and_equals_what_was_saved():
    row = MapSlope.holding(Slope(slope=2.0), point_um=100.0, reason="x")
    assert list(row.model_dump()) == ["point_um", "slope", "interval", "reason"]
    with pytest.raises(ValidationError):
        # No such field: nothing is lost in silence.
        MapSlope.holding(Slope(slope=2.0), point_um=100.0, silence="x")
    with pytest.raises(ValidationError):
        MapSlope.holding(Slope(slope=2.0))  # no point_um
    row = MapSlope.holding(Slope(slope=float("nan"), interval=(1.0, 2.0), mean=5.0), point_um=100.0)
    assert MapSlope.model_validate_json(row.model_dump_json()) == row
    assert math.isnan(row.mean)
