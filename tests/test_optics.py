"""What a link says with its optical options: references, screens, curves, spread, mottle; and what
is refused before."""

import json
import math

import numpy as np
import pytest
import xarray as xr

from analyze.fields import compared, gaussian_maps, lags_of
from planish.analyze import (
    CorrelateParams,
    compared_image,
    image_facts,
    light_spread,
    mottle_of,
    spread_light,
    without_screen,
)
from planish.analyze.kubelka_munk import answer_kubelka_munk, density_of, kubelka_munk_of
from planish.core.errors import InputError, PlanishError
from planish.core.reflectance import layer_over
from planish.io import ImageParams
from planish.report.sentences.table import sentences
from planish.results import EvidenceFacts, Results
from planish.run import Compute, as_study, correlate_maps, preflight


def image_of(values, um=4.0, title="Grey value, uncalibrated"):
    coords = {axis: um * np.arange(n) for axis, n in zip("yx", values.shape, strict=True)}
    attrs = {"units": "1", "long_name": title, "pixel_um": [um, um]}
    return xr.DataArray(values.astype(np.float32), coords, ("y", "x"), attrs=attrs)


def given(**options):
    return ImageParams(path="i.tif", **options)


# --- the image as it is compared ------------------------------------------------------------------
def test_references_make_reflectance_and_results_state_the_quantity():
    image = image_of(
        np.array([[200.0, 1200.0], [2200.0, np.nan]]), title="Grey value, uncalibrated, red"
    )
    found = compared_image(image, given(dark_grey=200, white_grey=2200))
    np.testing.assert_allclose(found, [[0.0, 0.5], [1.0, np.nan]])
    assert (found.dtype, found.attrs["long_name"]) == (np.float32, "Reflectance, red")
    assert image.attrs["long_name"] == "Grey value, uncalibrated, red"
    assert compared_image(image, given()) is image
    assert image_facts(given()).sentence.startswith("grey value, uncalibrated: no dark")
    facts = image_facts(given(dark_grey=100, white_grey=40000, screen_um=167))
    assert (facts.quantity, facts.sigma_um) == ("reflectance", pytest.approx(70.1, abs=0.1))
    assert "grey 100 is 0, grey 40000 is 1" in facts.sentence
    assert "210 um more around holes" in facts.sentence


def test_a_screen_is_taken_off_over_what_may_count():
    values = np.random.default_rng(0).normal(size=(90, 110))
    mask = np.ones(values.shape, bool)
    mask[30:50, 40:60] = False
    values[~mask] = 1e6
    found = compared_image(image_of(values), given(screen_um=100.0), mask=mask)
    expected = without_screen(values.astype(np.float32), pixel_um=4.0, sigma_um=42.0, mask=mask)
    np.testing.assert_array_equal(found, expected)
    assert np.nanmax(np.abs(found)) < 1
    assert found.attrs["long_name"] == "Grey value, uncalibrated, without its screen"
    assert found.attrs["reach_um"] == pytest.approx(126.0)
    with pytest.raises(PlanishError, match="pixels wide"):
        compared_image(image_of(values, um=100.0), given(screen_um=100.0))


@pytest.mark.parametrize(
    "options",
    [{"dark_grey": 10}, {"white_grey": 10}, {"dark_grey": 50, "white_grey": 50}, {"screen_um": 0}],
)
def test_references_that_mean_nothing_are_refused(options):
    with pytest.raises(ValueError, match=r"belong together|lighter than the dark|greater than 0"):
        given(**options)


def test_refining_and_regions_come_before_a_screen_is_taken_off(tmp_path):
    (tmp_path / "r.json").write_text(
        json.dumps({"type": "Polygon", "coordinates": [[[0, 0], [40, 0], [40, 40]]]})
    )
    image = image_of(np.random.default_rng(0).normal(size=(30, 30)))
    linked = xr.Dataset({"image": image.assign_attrs(reach_um=210.0), "valid": image > -99})
    with pytest.raises(InputError, match="Give regions= to 'planish link'"):
        correlate_maps(linked, params=CorrelateParams(regions=str(tmp_path / "r.json")))
    study = as_study(
        {
            "volume": {"path": "v.tif"},
            "image": {"path": "i.tif", "screen_um": 167},
            "registration": {"refine": "affine"},
        }
    )
    with pytest.raises(InputError, match="refine= aligns the fine texture"):
        preflight.check_request(study, Compute())


# --- light over the coating -----------------------------------------------------------------------
def coated(seed=0, *, shape=(80, 100), spread_um=None):
    """Coating of 17 um at points of 20 um, and the reflectance that S = 0.24 per um over 0.79 gives
    it."""
    rng = np.random.default_rng(seed)
    coating = np.maximum(17 + 4.5 * gaussian_maps(rng, shape, 3.0)[0], 0.0)
    seen = (
        coating if spread_um is None else spread_light(coating, pixel_um=20.0, width_um=spread_um)
    )
    image = layer_over(0.79, 0.24, 0.24 * 0.002, seen)
    return coating, image + 0.004 * gaussian_maps(rng, shape, 2.0)[0]


@pytest.mark.ci
def test_the_curve_has_the_units_of_the_coating():
    coating, image = coated()
    per_um = kubelka_munk_of((coating, image), point_um=20.0, ratio=0.002, density=None)
    assert per_um.scattering == pytest.approx(0.24, rel=0.1)
    assert per_um.scattering_interval[0] < 0.24 < per_um.scattering_interval[1]
    in_grams = kubelka_munk_of((coating, image), point_um=20.0, ratio=0.002, density=1.6)
    assert in_grams.scattering == pytest.approx(1000 * per_um.scattering / 1.6, rel=1e-4)
    assert (per_um.weight, in_grams.weight, in_grams.backing) == (
        False,
        True,
        pytest.approx(0.79, abs=0.03),
    )


def test_a_grey_that_is_no_reflectance_has_no_curve():
    coating, image = coated()
    outside = kubelka_munk_of((coating, 255 * image), point_um=20.0, ratio=0.002, density=None)
    assert math.isnan(outside.scattering)
    assert "not within 0 and 1" in outside.reason


def test_a_coating_blurred_like_the_light_follows_the_image_better():
    coating, image = coated(spread_um=80.0)
    maps, lags = (coating, image), lags_of(coating, (20.0, 20.0))
    asked = compared(maps, lags, params=CorrelateParams(light_spread_um=80.0, point_um=40.0))
    found = light_spread.answer_light_spread(asked)
    spread = found["light_spread"]
    assert spread.r > 0.6
    assert spread.difference_interval[0] > 0.05
    assert answer_kubelka_munk(asked) == {}
    facts = EvidenceFacts(
        a="sheet", a_map="coating_top", b="image", b_map="image", declared=True, **found
    )
    (said,) = sentences(facts, "light")
    assert said.startswith(
        "With the coating blurred by light that spreads over 80\u202fµm (declared), r = "
    )
    assert ": distinguishable from that of the coating as it is" in said
    small = compared(
        maps, lags, params=CorrelateParams(light_spread_um=80.0, kubelka_munk=0.0, point_um=10.0)
    )
    for answer in (
        light_spread.answer_light_spread(small)["light_spread"],
        answer_kubelka_munk(small)["kubelka_munk"],
    ):
        assert "smaller than the means" in answer.reason


def test_the_density_is_that_which_was_named_or_follows_from_what_was_weighed():
    coating = np.array([[10.0, 20.0], [0.0, np.nan]])
    maps = {
        "coating_top": (("y", "x"), coating),
        "coat_weight_top": (("y", "x"), (1.62 * coating).astype(np.float32)),
    }
    assert density_of(xr.Dataset(maps), "coating_top") == 1.62
    assert density_of(xr.Dataset(maps).drop_vars("coat_weight_top"), "coating_top") is None
    assert density_of(xr.Dataset(maps), "thickness") is None
    maps["coat_weight_top"] = (("y", "x"), coating**1.1)  # by absorption: another measurement
    assert density_of(xr.Dataset(maps), "coating_top") is None


def test_mottle_is_of_valid_pixels_and_says_why_there_is_none():
    image = 1000 * (1 + 0.02 * gaussian_maps(np.random.default_rng(0), (600, 800), 20.0)[0])
    image[:60] = 5e5
    layer = xr.Dataset({"image": image_of(image, um=5.0)})
    layer["valid"] = layer["image"] < 1e5
    found = mottle_of("print", layer, quantity="grey value, uncalibrated")
    assert [(b.shortest_um, b.longest_um) for b in found.bands] == [(250.0, 500.0)]
    assert 0.004 < found.bands[0].coefficient_of_variation < 0.02
    assert found.mean == pytest.approx(1000, rel=0.02)
    assert found.measured.startswith("Coefficient of variation of the grey value (uncalibrated)")
    small = layer.isel(y=slice(100), x=slice(100))
    assert "No octave lies between" in mottle_of("print", small, quantity="reflectance").reason


# --- what is refused before anything is read ------------------------------------------------------
@pytest.mark.parametrize(
    ("layers", "correlate", "said"),
    [
        (
            ["volume", "image"],
            {"kubelka_munk": 0.002},
            "or dark_grey= and white_grey=, two known greys",
        ),
        (
            ["image", "image"],
            {"kubelka_munk": 0.002, "light_spread_um": 80},
            "no image stands last",
        ),
        (["volume", "volume"], {"light_spread_um": 80}, "no image stands last"),
        (
            ["volume", "image"],
            {"light_spread_um": 80, "headline": "thickness"},
            "which is no coating",
        ),
        (["volume", "volume"], {"light": "quadratic"}, "light: no image stands last"),
        (["volume", "volume"], {"mottle": True}, "no layer is an image"),
        (["volume", "image"], {"error_ratio": 1.0}, "two measurements of one quantity"),
    ],
)
def test_requests_that_lack_something_are_refused(layers, correlate, said):
    kinds = [{"name": f"n{k}", kind: {"path": f"{k}.tif"}} for k, kind in enumerate(layers)]
    study = as_study({"layers": kinds, "correlate": correlate})
    with pytest.raises(InputError, match=said):
        preflight.check_request(study, Compute())


def test_half_of_the_references_is_wrong_usage(refuses, specimen_files):
    """0 is given, too."""
    refuses("link", *specimen_files, "--dark-grey", "0", words="belong together", code=2)


# --- in a run -------------------------------------------------------------------------------------
@pytest.mark.ci
def test_a_run_with_all_of_it(planish, specimen_files, tmp_path):
    options = (
        "--dark-grey",
        "1000",
        "--white-grey",
        "65000",
        "--kubelka-munk",
        "0.002",
        "--light-spread-um",
        "60",
        "--mottle",
        "--coating-density",
        "1.6",
        "--figures",
    )
    assert planish("link", *specimen_files, "--out", tmp_path / "run", *options)[0] in (0, 4)
    results = Results.read(tmp_path / "run" / "results.json")
    (found,), image = results.evidence, results.layers[-1].image
    assert (image.quantity, found.density_g_cm3) == ("reflectance", 1.6)
    assert found.kubelka_munk.reason or found.kubelka_munk.weight
    assert (found.light_spread.width_um, len(results.mottle)) == (60, 1)
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "at 1.6 g/cm³ / g/m²" in page
    assert "uncalibrated" not in page.lower()
    assert "Light in the coating" in page
    assert (
        any(p.name.endswith("curve.csv") for p in (tmp_path / "run" / "figures").iterdir())
        or found.kubelka_munk.reason
    )


def test_a_screen_leaves_no_texture_to_align_and_more_room_around_holes(
    planish, specimen_files, linked_run, tmp_path
):
    assert planish(
        "link", linked_run, specimen_files[1], "--out", tmp_path / "run", "--screen-um", "60"
    )[0] in (0, 4)
    run, before = (Results.read(p / "results.json") for p in (tmp_path / "run", linked_run))
    assert run.linked.share_valid < before.linked.share_valid
    (check,) = [c for c in run.checks if c.name == "position by texture"]
    assert check.state == "unknown"
    assert "taken off with the screen" in check.sentence
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "was taken off by a Gaussian" in page
    assert "Grey value, uncalibrated, without its screen" in page
