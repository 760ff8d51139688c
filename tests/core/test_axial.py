"""Angles of an axis: 90 and -90 degrees are one direction, in every mean of a map."""

import numpy as np
import pytest
import xarray as xr

from exports.contents import HISTORY
from planish.analyze.compare import maps_to_correlate
from planish.core.area import area_mean, common_means, halved
from planish.core.axial import distribution, doubled, has_axes, is_axial, near_axis
from planish.core.errors import InputError
from planish.exports import ExportParams, Maps, writer_of
from planish.measure import registered, sheet_property
from planish.report import draw
from planish.report.colours import CYCLIC, Scale, colours_in_steps, colours_of
from planish.run.facts import property_facts


def apart(a, b):
    """Degrees between two axes."""
    return np.abs((np.asarray(a, float) - b + 90) % 180 - 90)


def an_axis(values, name="axis"):
    """A map (y, x) of pixels of 2 um whose attribute says that it holds angles of an axis."""
    attrs = {"units": "deg", "long_name": "Axis", "support_um": 2.0, "period_deg": 180.0}
    um = [2.0 * np.arange(n) for n in np.shape(values)]
    return xr.DataArray(values, dict(zip("yx", um, strict=True)), ("y", "x"), name, attrs)


#: 80 and -80 degrees side by side: every mean of two is 90, and not 0.
ACROSS = an_axis(np.tile([[80.0, -80.0]], (8, 6)).astype(np.float32))


def test_the_mean_of_a_wrapped_normal_axis_is_its_axis_and_the_spread_its_own():
    """Of angles wrapped into half a turn, mean and standard deviation are those before."""
    angles = np.random.default_rng(0).normal(85.0, 12.0, 200_000)
    wrapped = (angles + 90) % 180 - 90
    mean, sd, values = distribution(wrapped, doubled(wrapped))
    assert (mean, sd) == (pytest.approx(85, abs=0.1), pytest.approx(12, abs=0.1))
    # the 5th and 95th percentile, of which one lies beyond 90 degrees
    expected = 85 + 12 * np.array([-1.645, 0, 1.645])
    np.testing.assert_allclose(np.percentile(values, [5, 50, 95]), expected, atol=0.3)
    assert abs(wrapped.mean()) < 45  # which is what the arithmetic gives
    as_lengths = distribution(*[np.array([80.0, -80.0])] * 2, ddof=1)
    assert as_lengths[:2] == (0.0, pytest.approx(np.sqrt(2) * 80))


def test_no_direction_prevails_among_even_angles_and_near_angles_are_the_same_axes():
    values = np.linspace(-90, 90, 1000, endpoint=False)
    assert (
        distribution(values, doubled(values))[1] > 100
    )  # of an even distribution it is not bounded
    near = near_axis(values, 70.0)
    assert [near.min(), near.max()] == pytest.approx([-20, 160], abs=0.2)
    assert apart(near, values).max() < 1e-9


def test_a_map_is_axial_by_its_attribute_and_older_ones_by_their_name():
    assert is_axial(ACROSS)
    assert is_axial(registered()["fibre_angle"])
    assert is_axial(xr.DataArray([1.0], name="fibre_angle_layer_1"))
    for other in (ACROSS.drop_attrs(), ACROSS.values, None, registered()["tilt"]):
        assert not is_axial(other)


def test_angles_that_repeat_after_another_angle_are_refused():
    """Doubled, directions of 360 degrees would cancel."""
    other = ACROSS.assign_attrs(period_deg=360.0)
    for work in (is_axial, lambda data: property_facts(data.to_dataset())):
        with pytest.raises(InputError, match=r"axis has angles that repeat after 360 degrees"):
            work(other)
    assert [has_axes("axis", None), has_axes("fibre_angle_layer_2", None)] == [False, True]
    assert has_axes("axis", 180.0)


def test_maps_of_degrees_are_correlated_unless_they_hold_an_axis():
    maps = xr.Dataset({"axis": ACROSS, "contact_angle": ACROSS.drop_attrs()})
    maps["contact_angle"].attrs = {"units": "deg", "role": "property"}
    maps["axis"].attrs["units"] = "degree"
    assert maps_to_correlate(maps) == ["contact_angle"]


@pytest.mark.parametrize("factor", [(2.0, 2.0), (1.0, 2.0), (4.0, 6.0)])
def test_means_over_areas_and_smaller_copies_are_those_of_the_axis(factor):
    for mean in (area_mean(ACROSS, factor), common_means([ACROSS, ACROSS], factor)[1]):
        assert apart(mean, 90).max() < 1e-4
    plain = common_means([ACROSS.drop_attrs(), ACROSS], factor)[0]
    np.testing.assert_allclose(plain, 0.0, atol=1e-5)
    small = halved(ACROSS.to_dataset())["axis"]
    assert (small.dtype, small.attrs) == (ACROSS.dtype, ACROSS.attrs)
    assert apart(small, 90).max() < 1e-4


def test_an_angle_whose_parts_are_there_counts_as_its_direction_prevails():
    """Of two columns of fibres at 80 and at -60 degrees, the first three times as even."""
    angles = np.tile([[80.0, -60.0]], (4, 3)).astype(np.float32)
    evenness = np.tile([[0.6, 0.2]], (4, 3))
    maps = xr.Dataset({"fibre_angle": an_axis(angles, "fibre_angle")})
    for part, turn in (("cos2", np.cos), ("sin2", np.sin)):
        maps[f"fibre_{part}"] = maps["fibre_angle"] * 0 + evenness * turn(np.deg2rad(2 * angles))
    vector = 3 * np.exp(2j * np.deg2rad(80)) + np.exp(-2j * np.deg2rad(60))
    expected = np.rad2deg(np.angle(vector)) / 2
    facts = property_facts(maps)["fibre_angle"]
    assert apart(facts.mean, expected) < 1e-4
    spread = np.rad2deg(np.sqrt(-2 * np.log(abs(vector) / 4))) / 2
    assert facts.sd == pytest.approx(spread, rel=1e-4)
    assert apart(halved(maps)["fibre_angle"], expected).max() < 1e-4


def test_what_is_missing_has_no_direction():
    values = ACROSS.values.copy()
    values[:, :4] = np.nan
    values[0, 4] = np.nan
    mean = area_mean(an_axis(values), (2.0, 2.0))
    assert np.isnan(mean[:, :2]).all()
    assert apart(mean[1:, 2:], 90).max() < 1e-4
    # of three pixels, one of 80 and two of -80 degrees
    double = np.deg2rad(2 * np.array([80, -80, -80.0]))
    expected = np.rad2deg(np.arctan2(np.sin(double).sum(), np.cos(double).sum())) / 2
    assert mean[0, 2] == pytest.approx(expected, abs=1e-4)


def test_figures_tables_and_pictures_show_the_axis(tmp_path):
    facts = property_facts(ACROSS.to_dataset())["axis"]
    assert apart(facts.mean, 90) < 1e-4
    # the doubled angles lie 20 degrees on either side of their mean
    circular_sd = np.rad2deg(np.sqrt(-2 * np.log(np.cos(np.deg2rad(20)))))
    assert (facts.sd, facts.period_deg) == (pytest.approx(circular_sd / 2, rel=1e-4), 180)
    assert facts.p95 - facts.p5 == pytest.approx(20, abs=1e-3)
    assert apart(draw.reduced(ACROSS, width=24 / (4 * 1.35)).values, 90).max() < 1e-4
    scale = colours_of(ACROSS, ACROSS.values)
    assert scale == Scale(-90.0, 90.0, CYCLIC)
    shades = colours_in_steps(CYCLIC).astype(int)
    assert np.abs(shades[0] - shades[-1]).max() < 3  # they begin again where the angle does
    maps = Maps(data=ACROSS.to_dataset(), group="linked")
    for to in ("csv", "ome-zarr"):
        writer_of(to)(maps, tmp_path / to, HISTORY, ExportParams(to=to, point_um=4.0))
    table = np.loadtxt(tmp_path / "csv", delimiter=",", comments="#", skiprows=2)
    assert apart(table[:, 2], 90).max() < 1e-3


def test_a_property_whose_angles_repeat_otherwise_is_refused_before_it_is_measured():
    with pytest.raises(InputError, match="heading has angles that repeat after 360 degrees"):
        sheet_property("heading", units="deg", long_name="Heading", attrs={"period_deg": 360.0})(
            lambda sheet: sheet.frame.top
        )
    assert "heading" not in registered()
