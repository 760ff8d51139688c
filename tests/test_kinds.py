"""Every kind of input by its shared run: a whole folder, places and hand as the truth has them, and
what is said."""

from __future__ import annotations

import html
import json
import re
import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import xarray as xr

from folders import refused
from planish.core.errors import VolumeError
from planish.core.grid import Grid
from planish.register import fit_transform
from planish.run import as_study, open_run, read_study, run_study

pytestmark = pytest.mark.ci

FILES = {"figures.csv", "maps.zarr", "results.json", "report.html", "run.toml"}


class Kind(NamedTuple):
    """What a run of one sheet and one image has to be.

    Places in um: of half the pixels, and of 95 % of them.
    """

    median_um: float
    p95_um: float
    said: str
    leads: str = "coating_top"
    mirrored: bool = False


SHEETS = {
    "upright": Kind(0.7, 1.2, "top side assumed"),
    "laid": Kind(
        0.7,
        1.2,
        "image shows the bottom side of the sheet, as given",
        "coating_bottom",
        mirrored=True,
    ),
    "bottom": Kind(
        0.7,
        1.2,
        "image shows the bottom side of the sheet, as given",
        "coating_bottom",
        mirrored=True,
    ),
    "scan": Kind(1.5, 3.0, "NRecon"),
    "sections": Kind(3.0, 5.0, "179 sections were aligned to their neighbours"),
    "no-holes": Kind(1.0, 2.0, "Found by texture: coating top and image go together at one place"),
    "uncoated": Kind(1.5, 3.0, "no coating is seen on the top side", "thickness"),
    "resin": Kind(2.0, 3.0, "Each of the 5 marks is predicted by the others"),
}
"""Of the sheet in resin one hole of five is not seen; places by serial sections err as those do."""

# The lens of some darkens their corners.
UNEVEN = "even light"
LOOKS = {"scan": (UNEVEN,), "no-holes": (UNEVEN,), "resin": (UNEVEN,)}
OTHERS = {
    "volumes": (
        "Coating thickness (top side) of second is larger where coating thickness (top side) of"
        " first is"
    ),
    "images": "The two images are compared at every valid pixel of uv",
    "chain": "ct, near on the pixels of far",
}


def material(specimen, files, maps, sections=None):
    """True material (y, x, 2) at the places in the volume of each pixel of maps; NaN where they are
    not valid."""
    ok = maps["valid"].values
    places = np.stack([maps[f"volume_{axis}"].values[ok] for axis in "xyz"], axis=-1).astype(
        np.float64
    )
    found = np.full((*ok.shape, 2), np.nan)
    found[ok] = specimen.warp.material(files.to_physical(places, sections))[:, :2]
    return found


def distances(one, other, maps):
    """Distances in um between two materials where both are known; at least a tenth of the pixels
    have them."""
    off_um = np.linalg.norm(one - other, axis=-1)
    known = np.isfinite(off_um)
    assert known.mean() > 0.1
    off_um, expected_um = off_um[known], maps["expected_error"].values[known]
    assert np.sqrt(np.mean(off_um**2)) < 1.5 * np.sqrt(np.mean(expected_um**2))
    return off_um


def uv(truth):
    """Material of the pixels of a specimen's image."""
    return np.stack([truth["u"].values, truth["v"].values], axis=-1)


# --- all of them ----------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", [*SHEETS, *OTHERS])
def test_a_folder_is_whole_reads_back_and_says_what_it_is(kinds, passes, kind):
    folder = kinds(kind)
    run = open_run(folder)
    registered = [layer.name for layer in run.results.layers if layer.registration]
    marks = [f"marks-{name}" for name in registered] if len(registered) > 1 else ["marks"]
    expected = FILES | {f"{name}{suffix}" for name in marks for suffix in (".csv", ".json")}
    assert {path.name for path in folder.iterdir()} == expected
    assert run.results.to_json() == (folder / "results.json").read_text(encoding="utf-8")
    assert [check.sentence for check in run.checks if check.state == "fail"] == []
    study = read_study(folder / "run.toml")
    names = [layer.name for layer in run.results.layers]
    assert [layer.name for layer in study.layers] == names
    assert all(Path(layer.path).exists() for layer in study.layers)
    text = (folder / "run.toml").read_text(encoding="utf-8")
    assert str(folder.parents[1]) not in text
    # What was not asked for is written, too.
    assert {"holes", "registration", "correlate"} <= tomllib.loads(text).keys()
    for layer in study.layers:
        assert layer.volume is None or layer.volume.voxel_um
        assert layer.image is None or layer.image.pixel_um
    for group in (run.groups[name] for name in run.groups if name != "sections"):
        units = {group.coords[dim].attrs.get("units") for dim in group.dims if dim in group.coords}
        assert units <= {"um"}
    page = (folder / "report.html").read_text(encoding="utf-8")
    words = SHEETS[kind].said if kind in SHEETS else OTHERS[kind]
    assert words in " ".join(html.unescape(re.sub(r"<[^>]+>", " ", page)).split())
    told, _ = passes("info", folder)
    assert f"run of {len(names)} layers" in told
    looks = [check.name for check in run.checks if check.state == "look"]
    assert tuple(looks) == LOOKS.get(kind, ())
    looks_text = f"; look: {', '.join(looks)}" if looks else ""
    expected_text = f"checks: {len(run.checks)}{looks_text}\n"
    assert expected_text in told
    assert all(f"\n{layer.name}: {layer.source.name}\n" in told for layer in run.results.layers)


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=[] if kind == "laid" else pytest.mark.nightly)
        for kind in (*SHEETS, *OTHERS)
    ],
)
def test_the_study_of_a_run_repeats_its_bytes(kinds, passes, kind):
    again = kinds(kind).with_name("repeated")
    _, said = passes("run", kinds(kind) / "run.toml", "--out", again, codes=(0, 4))
    assert f"same bytes as {kinds(kind)}" in said


@pytest.mark.parametrize("kind", SHEETS)
def test_pixels_show_the_material_that_is_there_on_the_right_side(kinds, kind):
    specimen, run, expected = kinds.specimen(kind), open_run(kinds(kind)), SHEETS[kind]
    maps = run.linked
    assert (maps["image"].dims, maps["image"].shape) == (("y", "x"), specimen.image.shape)
    np.testing.assert_allclose(maps["x"], specimen.image["x"], rtol=1e-6)
    found = material(specimen, kinds.files(kind), maps, run.groups.get("sections"))
    np.testing.assert_array_equal(np.isfinite(found).all(axis=-1), maps["valid"].values)
    off_um = distances(found, uv(specimen.truth), maps)
    print(f"{kind}: median {np.median(off_um):.2f} um, 95 % {np.percentile(off_um, 95):.2f} um")
    assert np.median(off_um) < expected.median_um
    assert np.percentile(off_um, 95) < expected.p95_um
    facts = run.results.layers[0].registration
    assert (facts.mirrored, facts.orientation.mirrored_volume) == (expected.mirrored, False)
    assert run.results.layers[0].headline == expected.leads
    ok = maps["valid"].values
    if len(specimen.sheet.holes):
        # 100 um from the fitted circle; the true rim is rough by 4 um rms around an ellipse, 6 %
        # longer than the circle
        assert specimen.truth["rim"].values[ok].min() > 84.0
    if expected.leads.startswith("coating"):
        # Of all these specimens the image shows the same side.
        true = specimen.truth["coating_top"].values[ok]
        ours = maps[expected.leads].values[ok]
        assert abs(np.mean(ours - true)) < 0.3
        r, r_true = (np.corrcoef(values, maps["image"].values[ok])[0, 1] for values in (ours, true))
        assert r == pytest.approx(r_true, abs=0.02)


# --- a sheet and an image -------------------------------------------------------------------------
def test_properties_against_the_truth(linked, specimen):
    ok = linked["valid"].values
    for name, bias, rmse in (("coating_top", 0.3, 1.0), ("base_thickness", 0.6, 1.5)):
        assert linked[name].attrs["units"] == "um"
        error = linked[name].values[ok] - specimen.truth[name].values[ok]
        print(f"{name}: bias {error.mean():.3f} um, rmse {np.sqrt(np.mean(error**2)):.3f} um")
        assert abs(error.mean()) <= bias
        assert np.sqrt(np.mean(error**2)) <= rmse


def test_of_a_place_most_of_the_error_is_that_of_the_holes_and_little_of_the_flattening(
    linked, specimen, kinds
):
    """It is the same everywhere or grows evenly, which the best similarity of all pixels takes
    off."""
    ok = linked["valid"].values
    found = material(specimen, kinds.small, linked)[ok][::50]
    left = fit_transform(
        uv(specimen.truth)[ok][::50], found, model="similarity", mirrored=False, robust=False
    )
    assert np.median(np.linalg.norm(left.residuals_um, axis=1)) <= 0.12  # 0.22 um through the faces


def test_all_holes_are_matched_and_flattening_beats_both_projections(linked_run, specimen):
    results = open_run(linked_run).results
    marks = results.layers[0].registration
    assert marks.matched == marks.found_moving == marks.found_fixed == len(specimen.sheet.holes)
    # 2e-3: five holes, leaning and oval, whose centres err by 1 um over 1 mm
    assert marks.scale == pytest.approx(specimen.pose.similarity.scale, abs=2e-3)
    assert marks.leave_one_out_rms_um < 2.0
    straight, along, flat = [row.r2 for row in results.comparison if row.point_um < 50]
    print(f"r2: straight down {straight:.3f}, along the plane {along:.3f}, flattened {flat:.3f}")
    # A gentle warp: 15 um of error against a coating that varies over 100 um.
    assert flat > along + 0.03
    assert flat > straight + 0.05
    assert sorted(row.point_um for row in results.comparison) == pytest.approx(
        [5.0] * 3 + [100.0] * 3
    )


def test_sections_are_aligned_and_joined(kinds):
    run, specimen = open_run(kinds("sections")), kinds.specimen("sections")
    facts = run.results.layers[0].sheet.sections
    assert (facts.count, facts.missing) == (
        specimen.poses.index.size,
        191 - specimen.poses.index.size,
    )
    assert facts.not_aligned == 0
    assert np.all(np.diff(run.groups["sections"]["position"]) > 0)
    # 1.5 um of jitter are taken off; what was put on is stated
    assert 1.0 < facts.shift_row_rms_um < 2.2


def test_sections_cannot_be_looked_at_from_above(kinds, tmp_path):
    study = as_study({"volume": {"path": str(kinds.files("sections").volume)}})
    refused(VolumeError, 'through="y"', run_study, study, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_map_ends_with_the_flat_maps(kinds, planish, tmp_path):
    folder = kinds("other-map")
    run = open_run(folder)
    assert {path.name for path in folder.iterdir()} == FILES
    assert run.results.comparison == ()
    assert "linked" not in run.groups
    told = planish("info", folder, "--json")[1]
    assert json.loads(told)["kind"] == "run of one volume"
    (tmp_path / "run.toml").write_text("")
    assert planish("info", tmp_path)[0] == 3


# --- two volumes, two images, a chain -------------------------------------------------------------
def test_two_volumes_show_the_same_material_at_the_same_pixel(kinds):
    run = open_run(kinds("volumes"))
    first, second = run.groups["layers/first"], run.groups["layers/second"]
    here = material(kinds.specimen("small"), kinds.small, first)
    off_um = distances(here, material(kinds.specimen("other"), kinds.other, second), first)
    assert np.median(off_um) < 1.5
    assert np.percentile(off_um, 95) < 3.0
    row = run.results.correlations[0]
    assert (row.a_map, row.b_map) == ("coating_top", "coating_top")
    assert row.r > 0.97
    (compared,) = [check for check in run.checks if check.name == "side and specimen"]
    assert "coatings of first and second go together side by side" in compared.sentence
    assert [check.state for check in run.checks if check.name == "one sheet"] == ["pass", "pass"]
    facts = run.results.layers[0].registration
    assert (facts.path, facts.orientation.mirrored_volume) == (("first", "second"), False)
    with xr.open_datatree(kinds("other-map") / "maps.zarr", engine="zarr") as own:
        # The reference itself is not resampled at all.
        np.testing.assert_array_equal(second["coating_top"].values, own["maps/coating_top"].values)
    same = next(row for row in run.results.correlations if row.a_map == "thickness")
    assert abs(same.difference_mean) < 0.5
    assert same.limits[0] < same.difference_mean < same.limits[1]


def test_an_image_lies_on_another_image_and_they_are_compared_away_from_rims(kinds):
    run = open_run(kinds("images"))
    layer, far = run.groups["layers/white"], run.groups["layers/uv"]
    assert run.results.layers[0].registration.matched == 5
    # Where a pixel of the reference lies in the first image, and the material that this one shows
    # there.
    grid = Grid.of(layer)
    x, y = np.meshgrid(grid.x_um, grid.y_um)
    shown = np.isfinite(layer["image"].values)
    marks = run.registrations["white"].pairs()
    moving, fixed = (
        np.stack([marks[f"{s}_{a}"].values for a in "xy"], axis=1) for s in ("moving", "fixed")
    )
    back = fit_transform(moving, fixed, model="similarity", mirrored=False).inverse(
        np.stack([x, y], axis=-1)
    )
    off_um = (
        kinds.specimen("small").pose.inverse(back[shown]) - uv(kinds.specimen("other").truth)[shown]
    )
    assert np.nanmedian(np.hypot(*off_um.T)) < 1.5
    assert np.nanmax(layer["expected_error"].values) < 10.0
    # Without the rims of the holes, which are alike on any paper. Either camera has an uneven
    # reflectance of its own.
    fine = run.results.correlations[0].r
    assert fine > 0.5
    aside = {name: np.roll(layer[name].values, 8, axis=1) for name in ("image", "valid")}
    both = layer["valid"].values & far["valid"].values & aside["valid"]
    assert np.corrcoef(aside["image"][both], far["image"].values[both])[0, 1] < fine - 0.1
    nearest = np.min(np.hypot(x[..., None] - fixed[:, 0], y[..., None] - fixed[:, 1]), axis=-1)
    assert nearest[far["valid"].values].min() > 160.0


def test_a_chain_is_composed_with_its_errors(kinds):
    """Sheet to its own image to the other camera's image."""
    run, printed = open_run(kinds("chain")), kinds("chain").with_name("printed.txt")
    assert "ct to near" in printed.read_text(encoding="utf-8")
    maps = run.groups["layers/ct"]
    found = material(kinds.specimen("small"), kinds.small, maps)
    off_um = distances(found, uv(kinds.specimen("other").truth), maps)
    assert np.percentile(off_um, 95) < 2.0
    ct, near, far = run.results.layers
    assert (ct.registration.to, ct.registration.path) == ("near", ("ct", "near", "far"))
    assert (near.registration.to, far.registration) == ("far", None)
    errors = [layer.registration.expected_error.median_um for layer in (ct, near)]
    assert errors[0] > errors[1]
