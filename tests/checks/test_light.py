"""Light that falls off or comes from one side is seen; even light passes."""

import numpy as np
import pytest
import xarray as xr

from analyze.fields import related_maps
from planish.analyze import CorrelateParams, LagNumbers, correlation_diagnostics
from planish.checks import run_checks
from planish.core.grid import Grid

SHAPE, PIXEL_UM = (120, 160), 20.0
PAIR = (("volume", "coating_top"), ("image", "image"))


def evidence_of(light, *, r=0.6, pair=PAIR, shape=SHAPE, length=4.0):
    """What stands beside r of a coating and an image of reflectance .8 +- .03 in a light."""
    coating, image = related_maps(3, shape, length, r)
    image = (0.8 + 0.03 * image) * light
    grid = Grid.regular(shape, (PIXEL_UM, PIXEL_UM))
    dims = ("y", "x")
    valid = (dims, np.ones(shape, bool))
    sheet = xr.Dataset(
        {"coating_top": (dims, coating), "thickness": (dims, coating), "valid": valid},
        grid.coords,
    )
    pictures = xr.Dataset({"image": (dims, image), "valid": valid}, grid.coords)
    return correlation_diagnostics(
        {"volume": sheet, "image": pictures}, *pair, params=CorrelateParams()
    )


def checks_of(subject):
    return {check.name: check for check in run_checks(subject, "volume", "image")}


def fall_off(shape, loss):
    """A light that is lost with the square of the distance from the middle, ``loss`` in corners."""
    y, x = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in shape), indexing="ij")
    return 1.0 - loss * (x * x + y * y) / 2.0


def test_even_light_passes_and_says_both_r():
    found = checks_of(evidence_of(1.0))["even light"]
    assert found.state == "pass"
    assert found.value < found.limit
    assert found.sentence.startswith("A smooth field holds")
    assert "With it off, r over points of 100 um is 0." in found.sentence
    assert found.advice == ""


@pytest.mark.parametrize("loss", [0.1, 0.25])
def test_a_fall_off_is_a_look_and_r_without_it_is_that_of_even_light(loss):
    even, evidence = evidence_of(1.0).light_field, evidence_of(fall_off(SHAPE, loss))
    found = checks_of(evidence)["even light"]
    assert (found.state, found.figures, found.layers) == (
        "look",
        ("correlation",),
        ("volume", "image"),
    )
    assert "even light" in found.advice
    field = evidence.light_field
    assert found.value == pytest.approx(abs(field.r - field.r_plain))
    # A light is a factor: where it is lost, less of the coating shows, by as much as is lost.
    assert field.r == pytest.approx(even.r, abs=0.02)
    assert field.r_plain < even.r - 0.05


def test_a_weak_fall_off_that_does_not_move_r_passes():
    evidence = evidence_of(fall_off(SHAPE, 0.05))
    assert evidence.light_field.p_even < 1e-6  # it is there
    assert abs(evidence.light_field.r_plain - evidence_of(1.0).light_field.r_plain) < 0.005
    assert checks_of(evidence)["even light"].state == "pass"


def test_long_waves_of_the_paper_move_r_and_are_no_light():
    """Texture as long as a tenth of the side gives such a field by itself."""
    evidence = evidence_of(1.0, length=12.0)
    assert evidence.light_field.share > 0.08
    assert 0.001 < evidence.light_field.p_even < 0.01
    assert checks_of(evidence)["even light"].state == "pass"


def test_too_few_points_are_said():
    evidence = evidence_of(fall_off(SHAPE, 0.1))
    field = evidence.light_field.model_copy(update={"interval_plain": (np.nan, np.nan)})
    found = checks_of(evidence.model_copy(update={"light_field": field}))["even light"]
    assert found.state == "unknown"
    assert "too few points are independent" in found.sentence


def test_light_that_was_taken_off_as_declared_passes():
    evidence = evidence_of(fall_off(SHAPE, 0.1))
    field = evidence.light_field.model_copy(update={"declared": True})
    found = checks_of(evidence.model_copy(update={"light_field": field}))["even light"]
    assert found.state == "pass"
    assert "was taken off, as declared" in found.sentence


def test_two_sheets_have_no_light():
    both = (("volume", "coating_top"), ("volume", "thickness"))
    assert "even light" not in checks_of(evidence_of(1.0, pair=both))


@pytest.mark.parametrize(
    ("share", "state"), [(0.62, "look"), (0.24, "look"), (0.22, "pass"), (0.0, "pass")]
)
def test_slopes_in_an_image_are_a_look_that_stand_for_a_quarter_and_more(share, state):
    found = checks_of(lag_numbers(share))["side light"]
    assert (found.state, found.value, found.limit) == (state, share, 0.23)
    assert f"{100 * share:.0f} % of what image and sheet share" in found.sentence


def test_nothing_is_said_of_slopes_where_no_texture_is_shared():
    assert checks_of(lag_numbers(np.nan)) == {}


def lag_numbers(light):
    """A lag of which a share needs the slopes."""
    return LagNumbers(
        property="coating_top",
        lag_um=(0.1, 0.2),
        se_um=(0.2, 0.2),
        length_um=0.2,
        length_se_um=0.2,
        r=0.5,
        r_at_zero=0.5,
        reason=None,
        agrees=True,
        expected_um=1.0,
        sentence="",
        pixel_um=(4.0, 4.0),
        n=10_000,
        reach_um=150.0,
        light=light,
        tile_um=np.nan,
        tiles=(),
    )
