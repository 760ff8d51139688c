"""How maps vary with distance, in results and on the page: one with the functions, and what is said
of it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from analyze.fields import compared, gaussian_maps, lags_of, related_maps
from planish.analyze import (
    CorrelateParams,
    agreement,
    bland_altman,
    correlograms,
    cross_correlogram,
    deming,
    ring_correlation,
    variogram,
)
from planish.analyze.variograms import answer_variograms
from planish.report import diagnostics
from planish.report.sentences.table import sentences
from planish.report.sentences.wording import Wording
from planish.report.text import Basis
from planish.results import EvidenceFacts, Results

CELL = (8.0, 8.0)


def twice_of(maps, points, **options):
    asked = compared(
        maps, lags_of(maps[0], CELL), params=CorrelateParams(**options), repeated_points=points
    )
    return agreement.answer_agreement(asked)["agreement"]


def pair(seed=0, r=0.6, length=6.0, shape=(120, 150)):
    a, b = related_maps(np.random.default_rng(seed), shape, length, r)
    known = np.ones(shape, bool)
    known[30:60, 50:80] = False
    return (np.where(known, a, np.nan), np.where(known, b, np.nan)), lags_of(
        np.where(known, a, np.nan), CELL
    )


def test_variograms_are_those_of_the_function():
    maps, lags = pair()
    names = (("sheet", "coating_top", "um"), ("image", "image", "1"))
    found = answer_variograms(compared(maps, lags, md_deg=30.0))["variograms"]
    for one, values, (layer, name, units) in zip(found, maps, names, strict=True):
        twin = variogram(values, pixel_um=CELL, md_deg=30.0)
        assert (one.layer, one.map, one.units, one.md_deg) == (layer, name, units, 30.0)
        assert (one.nugget, one.sill, one.range_um, one.ratio) == (
            twin.nugget,
            twin.sill,
            twin.range_um,
            twin.ratio,
        )
        assert len(one.distances_um) <= 60
        assert set(one.values) <= set(twin.values)


def test_the_correlogram_is_that_of_the_function_with_lag_0_in_its_profiles():
    maps, lags = pair()
    found = correlograms.answer_correlogram(compared(maps, lags))["correlogram"]
    twin = cross_correlogram(*maps, pixel_um=CELL)
    assert (found.peak_r, found.lag_um, found.n_eff) == (twin.peak_r, twin.lag_um, twin.n_eff)
    for profile in (found.along_x, found.along_y):
        middle = len(profile.r) // 2
        assert profile.lags_um[middle] == 0
        assert profile.r[middle] == found.r_at_zero
        assert profile.limit[middle] < profile.limit_of_any[middle] == found.limit_of_any
    assert len(found.along_x.r) <= 81
    assert found.beyond_chance


def test_two_measurements_are_compared_as_the_functions_say():
    rng = np.random.default_rng(3)
    a = gaussian_maps(rng, (120, 150), 6.0)[0]
    maps = tuple(a + 1.5 * rng.normal(size=a.shape) + k for k in (0.0, 0.5))
    points = tuple(m.reshape(24, 5, 30, 5).mean(axis=(1, 3)) for m in maps)
    found = twice_of(maps, points, point_um=40.0, error_ratio=2.0)
    rings, apart = ring_correlation(*maps, pixel_um=CELL), bland_altman(*points, pixel_um=40.0)
    assert [ring.correlation for ring in found.rings] == [ring.correlation for ring in rings.rings]
    assert found.resolution_um == rings.resolution_um
    assert (found.bias, found.bias_interval, found.sd) == (
        apart.bias,
        apart.bias_interval,
        apart.sd,
    )
    assert found.bias_interval[0] < 0.5 < found.bias_interval[1]
    assert found.error_slope == deming(*points, error_ratio=2.0, n_eff=50).slope
    assert found.error_interval[0] < 1 < found.error_interval[1]
    facts = EvidenceFacts(
        a="ct", a_map="thickness", b="lm", b_map="thickness", declared=True, agreement=found
    )
    said = [*sentences(facts, "repeated")]
    assert said[0].startswith("Both show the same down to waves of")
    assert said[1].startswith("lm minus ct, over 720 points of 40\u202fµm: 0.5")
    assert "Deming" in said[2]
    assert "a ratio of 2.00, as declared" in said[2]
    picture = diagnostics.draw_rings(
        found, name="coating thickness", layers=("ct", "lm"), basis=Basis()
    )
    assert len(picture.data["rings"]["correlation"]) == len(rings.rings)


def test_a_field_that_is_too_small_says_nothing_and_the_rest_stands():
    values = np.random.default_rng(0).normal(size=(5, 6))
    assert answer_variograms(compared((values, values), lags_of(values, CELL))) == {
        "variograms": ()
    }
    found = twice_of((values, values + 1), (values, values + 1), point_um=8.0)
    assert found.rings == ()
    assert "rings of frequency" in found.sentence
    assert found.bias == pytest.approx(1)


def facts(seed=0, *, md_deg=None, same=False, **how):
    maps, lags = pair(seed, **how)
    b, units = ("b", "coating_top" if same else "image"), ("um", "um" if same else "1")
    asked = compared(maps, lags, a=("a", "coating_top"), b=b, units=units, md_deg=md_deg)
    return EvidenceFacts(
        a="a",
        a_map="coating_top",
        b="b",
        b_map=b[1],
        declared=True,
        **answer_variograms(asked),
        **correlograms.answer_correlogram(asked),
    )


def of_each(evidence, titles):
    return [*sentences(evidence, "distance", Wording(titles=titles))]


def test_the_page_names_ranges_directions_and_the_lag():
    titles = ("Coating thickness, top side", "Grey value, uncalibrated")
    first, second, both = of_each(facts(md_deg=10.0), titles)
    assert first.startswith("Coating thickness, top side: ")
    assert "along and" in first
    assert "across the machine direction" in first
    assert "grey value²" in second or "no nugget" in second
    assert both.startswith("Shifted against each other, the maps agree best at a lag of ")
    assert "is exceeded at any lag by 1 % of unrelated maps." in both
    assert "the machine direction is not given" in of_each(facts(), titles)[0]
    unrelated = of_each(facts(seed=5, r=0.0, length=3.0), titles)[-1]
    assert "and no lag reaches that" in unrelated
    noise = of_each(facts(length=0.05), titles)[0]
    assert "neighbours share nothing" in noise or "nugget" in noise


def test_figures_hold_their_numbers():
    found = facts(md_deg=10.0)
    variograms = diagnostics.draw_variograms(
        found, titles=("Coating thickness, top side", "Grey value, uncalibrated"), basis=Basis()
    )
    assert [*variograms.data] == ["coating-top", "image"]
    assert [*variograms.data["coating-top"]] == [
        "distance / µm",
        "half mean square difference / µm²",
    ]
    assert [*variograms.data["image"]] == [
        "distance / µm",
        "half mean square difference / grey value²",
    ]
    assert "µm²" in variograms.svg
    lags = diagnostics.draw_correlogram(found.correlogram, names=("coating", "grey"), basis=Basis())
    assert lags.data["along-x"]["r"] == list(found.correlogram.along_x.r)
    same = diagnostics.draw_variograms(
        facts(same=True), titles=("Coating, a", "Coating, b"), basis=Basis()
    )
    assert [*same.data] == ["a-coating-top", "b-coating-top"]


def test_a_run_has_all_of_it(linked_run):
    (found,) = Results.read(linked_run / "results.json").evidence
    assert [(one.layer, one.map) for one in found.variograms] == [
        ("sheet", "coating_top"),
        ("image", "image"),
    ]
    assert found.correlogram is not None
    assert found.conley_interval is not None
    (row,) = found.reliability
    assert math.isnan(row.value) or 0.99 < row.value < 1
    page = (linked_run / "report.html").read_text(encoding="utf-8")
    assert "How the maps vary with distance" in page
    assert "two half measurements" in page or "Reliability of" in page
