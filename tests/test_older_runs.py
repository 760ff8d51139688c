"""Runs, stores and series of older formats: what they hold has the names of today.

``run_format_3.zip`` is the run of the demo before topography was the face about its own form; of
its maps every 45th pixel is kept, of the strain every 20th.
"""

import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import planish as pl
from planish.analyze.params import CorrelateParams
from planish.core.errors import CannotMeasure, InputError
from planish.core.older_names import FORMAT, renamed, todays_names
from planish.exports.run_contents import map_levels
from planish.io import read_group, write_tree
from planish.measure import MeasureParams, check_maps
from planish.results import Results
from planish.run.compute import Compute
from planish.run.preflight import check_request
from planish.series.gather import gather
from planish.series.members import members_of
from planish.series_results import SeriesResults

ZIP = Path(__file__).parent / "run_format_3.zip"
RENAMED = {"topography_top": "half_thickness_top", "topography_bottom": "half_thickness_bottom"}


@pytest.fixture
def old_run(tmp_path):
    """A run of format 3."""
    folder = tmp_path / "old"
    with zipfile.ZipFile(ZIP) as file:
        file.extractall(folder)
    return folder


def stored(folder):
    """Results as the file has them."""
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def test_maps_titles_and_results_of_an_older_run_have_new_names(old_run):
    before, run = stored(old_run), pl.open_run(old_run)
    sheet = before["layers"][0]["sheet"]
    assert (before["format"], run.results.format, run.results.stored_format) == (3, FORMAT, 3)
    for old, new in RENAMED.items():
        assert old in sheet["properties"]
        side = new.rpartition("_")[2]
        for group in ("surfaces", "maps", "linked"):
            maps = run.groups[group]
            assert (old in maps, maps[new].long_name) == (
                False,
                f"Face above the centre surface, {side} side",
            )
        # Of the whole demo: half of its thickness, 93.7 um.
        found = run.results.layers[0].sheet.properties
        assert old not in found
        assert found[new].mean == sheet["properties"][old]["mean"] == pytest.approx(46.9, abs=0.1)
        assert run.maps[new].median() == pytest.approx(46.9, abs=1.5)
    rows = [(row["a_map"], row["r"]) for row in before["correlations"]]
    assert [(row.a_map, row.r) for row in run.results.correlations] == [
        (RENAMED.get(name, name), r) for name, r in rows
    ]
    assert run.linked.image.long_name == "Grey value, uncalibrated"
    assert run.results.layers[1].image.quantity == "grey value, uncalibrated"
    numbers = run.results.layers[0].sheet.numbers
    assert (numbers.roughness, numbers.two_sides.topography_correlation) == ({}, None)
    assert numbers.roughness_about_centre["top"].sq == sheet["numbers"]["roughness"]["top"]["sq"]
    assert (
        numbers.two_sides.half_thickness_correlation
        == sheet["numbers"]["two_sides"]["topography_correlation"]
    )
    found, asked = run.results.evidence[0], before["evidence"][0]
    assert found.attenuation_limit == asked["ceiling"]
    assert found.conley_interval.critical == asked["second_opinion"]["critical"]
    assert found.reliability[0].reason == asked["reliability"][0]["silence"]


def test_the_study_of_an_older_run_names_its_maps_as_they_are_named_today(old_run):
    toml = old_run / "run.toml"
    text = toml.read_text(encoding="utf-8")
    changed = text.replace("maps = []", 'maps = ["topography_difference"]')
    assert changed != text
    toml.write_text(changed, encoding="utf-8")
    study = pl.open_run(old_run).study
    assert study.layers[0].properties.maps == ("half_thickness_difference",)
    assert study.layers[0].volume.path.endswith("specimen/volume.tif")


@pytest.mark.parametrize(
    ("older", "todays"),
    [
        ("topography_top", "half_thickness_top"),
        ("topography_bottom", "half_thickness_bottom"),
        ("topography_difference", "half_thickness_difference"),
        ("roughness_top", "roughness_top"),
        ("roughness_bottom", "roughness_bottom"),
    ],
)
def test_what_an_older_study_asked_for_can_be_measured_today(old_run, older, todays):
    toml = old_run / "run.toml"
    text = toml.read_text(encoding="utf-8")
    toml.write_text(text.replace("maps = []", f'maps = ["{older}"]'), encoding="utf-8")
    params = pl.open_run(old_run).study.layers[0].properties
    assert params.maps == (todays,)
    check_maps(params)


def test_an_older_name_that_is_no_map_today_is_refused_with_the_name_of_today(old_run):
    study = pl.open_run(old_run).study
    for name, words in (
        ("topography_difference", "Ask for half_thickness_difference in place of topography_diff"),
        ("roughness_about_centre_top", "Ask for roughness_top in place of roughness_about_centre"),
    ):
        with pytest.raises(CannotMeasure, match=words):
            check_maps(MeasureParams(maps=(name,)))
        asked = study.model_copy(update={"correlate": CorrelateParams(headline=name)})
        with pytest.raises(InputError, match=words):
            check_request(asked, Compute())
    assert renamed("thickness") == renamed("roughness_top") == ""


@pytest.mark.ci
def test_the_report_of_an_older_run_is_made_anew(old_run, tmp_path, passes):
    passes("report", old_run, "--out", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Face above the centre surface, top side" in page
    assert "Roughness about the centre surface, top side" in page
    for word in ("opography", "elative grey", "eiling", "econd opinion"):
        assert word not in page, word
    assert "In this run of an older version it counts in Holm like the others." in page
    assert "not count in Holm" not in page
    before = stored(old_run)
    for row in before["correlations"]:
        del row["p_of_table"]
    (old_run / "results.json").write_text(json.dumps(before), encoding="utf-8")
    passes("report", old_run, "--out", tmp_path / "without.html")
    assert "Holm" not in (tmp_path / "without.html").read_text(encoding="utf-8")


def test_verbs_take_an_older_run(old_run, tmp_path, passes):
    passes(
        "export", old_run, "--to", "tiff", "--map", "half_thickness_top", "--out", tmp_path / "e"
    )
    assert list((tmp_path / "e").glob("half_thickness_top*"))
    out, _ = passes("correlate", old_run, "--point-um", "300", codes=(0, 4))
    assert "half_thickness_top" in out
    assert "topography" not in out
    out, _ = passes("info", old_run)
    assert "its results have an older format" in out
    levels = map_levels(old_run / "maps.zarr", "maps", "half_thickness_top")
    assert [level.name for level in levels] == ["topography_top"]
    assert map_levels(old_run / "maps.zarr", "maps", "topography_top") == []


def test_a_page_to_look_around_in_is_made_of_an_older_run(old_run, tmp_path, passes):
    passes("explore", old_run, "--out", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Face above the centre surface, top side" in page
    assert "Topography" not in page


def test_older_and_newer_runs_make_no_series(old_run, tmp_path, refuses):
    twin, newer = tmp_path / "twin", tmp_path / "newer"
    shutil.copytree(old_run, twin)
    (twin / "results.json").write_text(json.dumps(stored(old_run)), encoding="utf-8")
    gathered = gather(members_of([old_run, twin], home=tmp_path), tmp_path)
    named = {row.map for row in gathered.rows if row.quantity == "sq"}
    assert named == {"half_thickness_top", "half_thickness_bottom"}
    shutil.copytree(old_run, newer)
    (newer / "results.json").write_text(
        Results.read(old_run / "results.json").to_json(), encoding="utf-8"
    )
    words = ("The results of old have an older format than those of newer", "planish run RUN")
    refuses("compare", old_run, newer, words=words)


def test_a_store_without_a_format_has_older_names_and_one_with_it_keeps_its_own(tmp_path):
    store = tmp_path / "maps.zarr"
    long_name = "Roughness, top side"
    values = ("y", np.arange(3.0), {"long_name": long_name})
    write_tree(store, {"maps": xr.Dataset({"roughness_top": values, "roughness_top_se": values})})
    assert set(read_group(store, "maps")) == {"roughness_top", "roughness_top_se"}
    root = store / "zarr.json"
    content = json.loads(root.read_text(encoding="utf-8"))
    assert content["attributes"].pop("format") == FORMAT
    root.write_text(json.dumps(content), encoding="utf-8")
    maps = read_group(store, "maps", ["roughness_about_centre_top"])
    assert maps.roughness_about_centre_top.long_name == (
        "Roughness about the centre surface, top side"
    )
    np.testing.assert_array_equal(maps.roughness_about_centre_top, np.arange(3.0))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("topography_top", "half_thickness_top"),
        ("sheet.topography_bottom", "sheet.half_thickness_bottom"),
        ("thickness and roughness_top", "thickness and roughness_about_centre_top"),
        ("topography_difference_se", "half_thickness_difference_se"),
        ("topography (top side)", "face above the centre surface (top side)"),
        ("Relative grey, luminance", "Grey value, uncalibrated, luminance"),
        ("scans/topography_top", "scans/topography_top"),
        ("topography_top.tif", "topography_top.tif"),
        ("Topography has a unit", "Topography has a unit"),
        ("roughness_um", "roughness_um"),
        ({"twice": {"silence": None}}, {"agreement": {"reason": None}}),
        (["second_opinion", 3.5, None], ["second_opinion", 3.5, None]),
    ],
)
def test_names_are_changed_where_they_are_names(old, new):
    assert todays_names(old) == new


def test_a_series_of_an_older_format_is_read(tmp_path):
    file = tmp_path / "results.json"
    quantity = {
        "map": "topography_top",
        "what": "mean",
        "unit": "um",
        "title": "Mean of topography, top side",
        "map_title": "Topography, top side",
    }
    series = {
        "format": 1,
        "planish": "0.2.0",
        "declared": {"headline": ["topography_top"]},
        "quantities": [quantity],
        "headline_declared": True,
        "sheets_given": False,
        "specimens": [],
    }
    file.write_text(json.dumps(series), encoding="utf-8")
    results = SeriesResults.read(file)
    assert (results.format, results.stored_format) == (2, 1)
    assert results.declared == {"headline": ["half_thickness_top"]}
    assert results.quantities[0].map == "half_thickness_top"
    assert results.quantities[0].title == "Mean of face above the centre surface, top side"
