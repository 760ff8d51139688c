"""Layers onto one reference: runs, two volumes, two images, chains; which side, which way, and what is refused."""

import filecmp
import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile
import xarray as xr

from kinds import OTHER
from planish.app.pictures import Pictures
from planish.core.transform import Similarity
from planish.io import ImageParams, VolumeParams
from planish.marks import HoleParams, cut_holes, find_holes, read_any, write_marks
from planish.register import RegistrationParams, fit_transform
from planish.resample.maps import _with_angles
from planish.run import Layer, LayerHoles, LayerParams, Study, link, open_run, read_study, write_study
from planish.validate import pair_errors


@pytest.fixture(scope="module")
def other(made_once):
    """The same sheet, bent otherwise, under another scanner and another camera."""
    return made_once.specimen("other", OTHER)


@pytest.fixture(scope="module")
def other_files(made_once):
    return made_once.other


@pytest.fixture(scope="module")
def other_run(kinds):
    return kinds("other-map")


@pytest.fixture(scope="module")
def image_pair(kinds):
    """The image of one camera on the pixels of the other's."""
    return open_run(kinds("images"))


def test_a_run_linked_to_an_image_is_the_volume_linked_to_it(passes, linked_run):
    again = linked_run.parent / "again"
    # The very file: each worker has one of its own, and the study names it.
    passes("link", linked_run, open_run(linked_run).study.layers[-1].path, "-o", again)
    compared = filecmp.dircmp(linked_run, again)
    files = [p.relative_to(linked_run) for p in linked_run.rglob("*") if p.is_file()]
    assert len(files) > 20
    assert not compared.left_only
    assert not compared.right_only
    _, different, missing = filecmp.cmpfiles(linked_run, again, [str(f) for f in files], shallow=False)
    assert (different, missing) == ([], [])


def test_a_size_may_be_that_of_one_layer_alone(passes, refuses, specimen_files, other_files, tmp_path):
    """Two scans of uncertain resolution: --pixel-um would hold for both."""
    layers = ("link", f"small={specimen_files[1]}", f"large={other_files.image}", "--override-size")
    wide = ("--set", "small.image.pixel_um=5.5,5.5", "--scale-tolerance", "0.12")
    passes(*layers, *wide, "-o", tmp_path / "wide", codes=(0, 4))
    run = open_run(tmp_path / "wide")
    assert run.study.layers[0].image.pixel_um[0] == 5.5
    assert run.results.moving[0].registration.scale == pytest.approx(5 / 5.5, abs=0.02)
    refuses(*layers, "--set", "tiny.image.pixel_um=5.5,5.5", words="--set: 'tiny.image.pixel_um=5.5,5.5'", code=2)


def test_two_volumes_show_the_same_material_at_the_same_pixel(specimen, other, kinds):
    found, other_run = open_run(kinds("volumes")), kinds("other-map")
    assert found.passed
    # Truth needs the run of either layer.
    sheets = {"first": open_run(kinds("upright")).sheet(), "second": open_run(other_run).sheet()}
    values = pair_errors([(specimen, kinds.small), (other, kinds.other)], replace(found, sheets=sheets))
    assert values["pair_median"] < 1.5
    assert values["pair_p95"] < 3.0
    assert values["pair_r"] > 0.97
    compared = [check for check in found.checks if check.name == "side and specimen"]
    assert [check.state for check in compared] == ["pass"]
    assert "coatings of first and second go together side by side" in compared[0].sentence
    assert [check.state for check in found.checks if check.name == "one sheet"] == ["pass", "pass"]
    registration = found.results.layers[0].registration
    assert registration.path == ("first", "second")
    assert registration.orientation.mirrored_volume is False
    grid = found.groups["layers/second"]
    own = xr.open_datatree(other_run / "maps.zarr", engine="zarr")["maps"].to_dataset()
    # The reference itself is not resampled at all.
    np.testing.assert_array_equal(grid["coating_top"].values, own["coating_top"].values)
    same = next(row for row in found.results.correlations if row.a_map == "thickness")
    assert abs(same.difference_mean) < 0.5
    assert same.limits[0] < same.difference_mean < same.limits[1]


def test_an_image_lies_on_another_image(specimen, other, image_pair):
    found, truth = image_pair, other.truth
    layer = found.groups["layers/white"]
    assert found.results.layers[0].registration.matched == 5
    # Where a pixel of the reference lies in the first image, and the material that this one shows there.
    y, x = np.meshgrid(layer["y"].values, layer["x"].values, indexing="ij")
    shown = np.isfinite(layer["image"].values)
    marks = found.registrations["white"].pairs()
    moving, fixed = (np.stack([marks[f"{s}_{a}"].values for a in "xy"], axis=1) for s in ("moving", "fixed"))
    back = fit_transform(moving, fixed, model="similarity", mirrored=False).inverse(np.stack([x, y], axis=-1))
    material = specimen.pose.inverse(back[shown])
    off = np.hypot(*(material - np.stack([truth["u"].values[shown], truth["v"].values[shown]], axis=-1)).T)
    assert np.nanmedian(off) < 1.5
    # Without the rims of the holes. Either camera has noise and an uneven reflectance of its own.
    fine = found.results.correlations[0].r
    assert fine > 0.5
    far = found.groups["layers/uv"]
    both = layer["valid"].values & far["valid"].values & np.roll(layer["valid"].values, 8, axis=1)
    aside = np.corrcoef(np.roll(layer["image"].values, 8, axis=1)[both], far["image"].values[both])[0, 1]
    assert aside < fine - 0.1
    assert np.nanmax(layer["expected_error"].values) < 10.0


def test_a_chain_is_composed_with_its_errors(passes, linked_run, kinds, tmp_path):
    """Sheet to its own image to the other camera's image."""
    out = kinds("chain")
    assert "ct to near" in out.with_name("printed.txt").read_text(encoding="utf-8")
    results = json.loads((out / "results.json").read_text())
    ct, near, far = results["layers"]
    assert (ct["registration"]["to"], ct["registration"]["path"]) == ("near", ["ct", "near", "far"])
    assert (near["registration"]["to"], far["registration"], far["name"]) == ("far", None, "far")
    errors = [layer["registration"]["expected_error"]["median_um"] for layer in (ct, near)]
    assert errors[0] > errors[1]
    tree = xr.open_datatree(out / "maps.zarr", engine="zarr")
    assert tree["layers/ct"]["coating_top"].shape == tree["layers/far"]["image"].shape
    text, _ = passes("link", f"ct={linked_run}", f"far={kinds.other.image}", "-o", tmp_path / "direct", "--json")
    direct = next(r["r"] for r in json.loads(text)["correlations"] if r["a_map"] == "coating_top")
    chained = next(r["r"] for r in results["correlations"] if (r["a_map"], r["b"]) == ("coating_top", "far"))
    assert chained == pytest.approx(direct, abs=0.02)

    passes("report", out, "-o", tmp_path / "page.html")
    assert (tmp_path / "page.html").read_bytes() == (out / "report.html").read_bytes()


@pytest.mark.nightly
def test_a_chain_is_done_again_to_the_same_bytes(passes, kinds, tmp_path):
    _, err = passes("run", kinds("chain") / "run.toml", "-o", tmp_path / "again")
    assert "same bytes" in err


def test_an_image_of_the_bottom_is_mirrored_when_it_is_given_as_such_and_refused_when_not(
    passes, refuses, linked_run, specimen_files, tmp_path
):
    flipped = tmp_path / "flipped.tif"
    tifffile.imwrite(flipped, tifffile.imread(specimen_files[1])[:, ::-1])
    size = ("--pixel-um", "5", "--json")
    refuses("link", linked_run, flipped, *size, words="mirror")
    # It is a picture of the top for all that: its texture shows it.
    side = ("--image-side", "bottom", "-o", tmp_path / "run")
    out, err = passes("link", linked_run, flipped, *size, *side, codes=(4,))
    assert "fail: side and specimen: The image correlates with the coating of the top side" in err
    sheet = json.loads(out)["layers"][0]
    registration = sheet["registration"]
    assert registration["mirrored"] is True
    assert registration["orientation"]["image_side"] == "bottom"
    assert registration["orientation"]["mirrored_volume"] is False
    assert sheet["headline"] == "coating_bottom"
    assert "bottom side of the sheet, as given" in registration["orientation"]["sentence"]


@pytest.mark.parametrize(("given", "code"), [pytest.param("-7.0", 0, marks=pytest.mark.nightly), ("60", 4)])
def test_machine_directions_that_contradict_each_other_are_seen(
    planish, run_copy, specimen_files, tmp_path, given, code
):
    study = (run_copy / "run.toml").read_text()
    rotation = json.loads((run_copy / "results.json").read_text())["layers"][0]["registration"]["rotation_deg"]
    # The map's machine direction lies along its x axis; in the image it is turned by the rotation of the marks.
    (run_copy / "run.toml").write_text(study.replace("[layers.volume]", "[layers.volume]\nmd_deg = 0.0"))
    angle = f"{rotation + float(given) - (-7.0):.3f}" if code == 0 else given
    options = (f"--image-md-deg={angle}", "-o", tmp_path / "again", "--json", "--strict")
    got, out, err = planish("link", run_copy, specimen_files[1], *options)
    assert got == code, err
    results = json.loads(out)
    orientation = results["layers"][0]["registration"]["orientation"]
    # A stretch turns it a little.
    assert orientation["md_deg_fixed_from_moving"] == pytest.approx(rotation % 180, abs=0.2)
    assert ("machine direction" in err) == (code == 4)
    assert any(check["name"] == "machine direction" for check in results["checks"])


def test_images_are_compared_away_from_rims(image_pair):
    """The burnt rims of two images are alike on any paper: they must not count."""
    layer = image_pair.groups["layers/uv"]
    fixed = np.stack([image_pair.registrations["white"].pairs()[f"fixed_{a}"].values for a in "xy"], axis=1)
    y, x = np.meshgrid(layer["y"].values, layer["x"].values, indexing="ij")
    nearest = np.min(np.hypot(x[..., None] - fixed[:, 0], y[..., None] - fixed[:, 1]), axis=-1)
    assert nearest[layer["valid"].values].min() > 160.0


def sheet_with(holes):
    """An image of a sheet of 1 mm with dark discs of 160 um."""
    places = np.arange(200) * 5.0
    y, x = np.meshgrid(places, places, indexing="ij")
    values = np.full((200, 200), 180.0)
    for hole_x, hole_y in holes:
        values[np.hypot(x - hole_x, y - hole_y) < 80] = 20.0
    return xr.DataArray(values, dims=("y", "x"), coords={"y": places, "x": places})


def test_each_face_of_a_layer_is_searched_for_holes_once(monkeypatch):
    searches = []

    def search(_, *, params, side, layer):
        searches.append((layer, side, params.printed))
        return xr.Dataset()

    monkeypatch.setattr("planish.run.layers.find_holes", search)
    shows_bottom = LayerParams(name="image", image=ImageParams(path="i.tif", side="bottom"))
    sheet = Layer(params=LayerParams(name="sheet", run="run"), source=None, groups={"maps": xr.Dataset()})
    image = Layer(params=shows_bottom, source=None, image=xr.DataArray(np.zeros((2, 2))))
    for params in (HoleParams(), HoleParams(printed=True)):
        holes = LayerHoles(params)
        for pair in [(sheet, image), (image, sheet), (sheet, sheet)] * 2:
            holes.of(*pair)
        assert [len(holes.searched(layer)) for layer in (sheet, image)] == [2, 1]
    faces = [("sheet", "bottom"), ("image", "bottom"), ("sheet", "top")]
    assert searches == [(*face, printed) for printed in (False, True) for face in faces]


def test_a_hole_that_the_border_cuts_is_left_out():
    image = sheet_with([(300.0, 300.0), (600.0, 700.0), (-20.0, 500.0)])
    holes = find_holes(image.values, pixel_um=5.0)
    assert holes.sizes["mark"] == 2
    cut = cut_holes(image, holes)
    ((cx, cy, radius),) = zip(cut["x"].values, cut["y"].values, cut["diameter"].values / 2, strict=True)
    assert abs(cy - 500.0) < 5
    assert 0 <= cx < 60
    assert 60 < radius < 110


@pytest.mark.parametrize("frame", [True, False])
def test_dark_ground_beside_a_sheet_is_no_hole_that_the_border_cuts(frame):
    """A circle around it would leave no pixel of the sheet."""
    image = sheet_with([(300.0, 300.0), (600.0, 700.0)])
    if frame:
        image[[0, 1, -2, -1]], image[:, [0, 1, -2, -1]] = 15.0, 15.0
    else:
        image[:, image.x > 800] = 15.0
    holes = find_holes(image.values, pixel_um=5.0)
    assert (holes.sizes["mark"], cut_holes(image, holes).sizes["mark"]) == (2, 0)


def test_the_design_names_the_holes(passes, specimen, linked_run, specimen_files, tmp_path):
    table = tmp_path / "burnt.csv"
    turned = specimen.sheet.holes @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + 5000.0
    # In the laser's coordinates y runs up.
    rows = "\n".join(f"{x:.3f},{-y:.3f}" for x, y in turned)
    table.write_text(f"x_um,y_um\n{rows}\n")
    out, _ = passes("link", linked_run, specimen_files[1], "--design", table, "-o", tmp_path / "run", "--json")
    registration = json.loads(out)["layers"][0]["registration"]
    assert f"of {len(specimen.sheet.holes)} holes" in registration["design"]
    labels = [line.split(",")[0] for line in (tmp_path / "run" / "marks.csv").read_text().splitlines()[1:]]
    assert len(set(labels)) == registration["matched"] == 5


@pytest.mark.nightly
def test_a_refined_link_stands_beside_that_of_the_marks(passes, linked_run, specimen_files, tmp_path):
    """Marks that somebody has clicked, 4 um off: the maps bring them nearer to where they belong."""
    marks = read_any(linked_run / "marks.csv")
    rng = np.random.default_rng(3)
    clicked = marks.assign({f"fixed_{a}": marks[f"fixed_{a}"] + rng.normal(0, 4, marks.sizes["mark"]) for a in "xy"})
    write_marks(clicked, tmp_path / "clicked.csv")
    arguments = (linked_run, specimen_files[1], "--marks", tmp_path / "clicked.csv", "-o", tmp_path / "run", "--json")
    out, _ = passes("link", *arguments, "--refine", "affine")
    refined = json.loads(out)["refinement"]
    assert 0 < refined["moved_rms_um"] < 15
    assert refined["correlation"]["registration"] in ("refined (cross-fitted)", "refined (searched null)")
    tree = xr.open_datatree(tmp_path / "run" / "maps.zarr", engine="zarr")
    right = open_run(linked_run).linked
    ok = right["valid"].values & tree["linked"]["valid"].values & np.isfinite(tree["refined"]["u"].values)

    def off(group):
        return np.hypot(*(tree[group][a].values[ok] - right[a].values[ok] for a in ("u", "v")))

    assert np.sqrt(np.mean(off("refined") ** 2)) < 0.7 * np.sqrt(np.mean(off("linked") ** 2))
    assert "Refined by the maps themselves" in (tmp_path / "run" / "report.html").read_text()


@pytest.mark.nightly
def test_two_images_are_refined_by_what_they_show(image_pair, specimen_files, other_files, tmp_path):
    marks = image_pair.registrations["white"].marks
    rng = np.random.default_rng(4)
    clicked = marks.assign({f"fixed_{a}": marks[f"fixed_{a}"] + rng.normal(0, 4, marks.sizes["mark"]) for a in "xy"})
    write_marks(clicked, tmp_path / "clicked.csv")
    given = {"marks": str(tmp_path / "clicked.csv"), "refine": "affine"}
    run = link(f"white={specimen_files[1]}", f"uv={other_files.image}", registration=given, out=tmp_path / "run")
    right, refined = image_pair.groups["layers/white"], run.groups["refined"]
    ok = right["valid"].values & run.groups["layers/white"]["valid"].values & np.isfinite(refined["image"].values)

    def unlike(image):
        return np.std(image.values[ok] - right["image"].values[ok])

    assert run.results.refinement.property == "image"
    assert unlike(refined["image"]) < 0.8 * unlike(run.groups["layers/white"]["image"])
    assert "refined" in {picture.layer for picture in Pictures.of(tmp_path / "run")}


def test_info_describes_a_run(passes, planish, linked_run, other_run, tmp_path):
    out, _ = passes("info", linked_run)
    checks = json.loads((linked_run / "results.json").read_text())["checks"]
    for words in ("run of 2 layers", "image: image.tif", f"checks: {len(checks)}\n"):
        assert words in out
    assert json.loads(planish("info", other_run, "--json")[1])["kind"] == "run of one volume"
    (tmp_path / "run.toml").write_text("")
    assert planish("info", tmp_path)[0] == 3


def test_links_that_cannot_be_made_are_refused_with_the_reason(
    refuses, linked_run, specimen_files, other_run, tmp_path
):
    volume, image = specimen_files
    for arguments, code, words in (
        ((image,), 2, ("reference last",)),
        ((linked_run, image, "--cutoff-um", "300"), 2, ("--cutoff-um", "keeps the options")),
        ((linked_run, image, "--voxel-um", "3"), 2, ("--voxel-um", "keeps the options")),
        ((f"a={image}", f"a={volume}", other_run), 2, ("more than one is a", "NAME=PATH")),
        ((f"a b={image}", linked_run), 2, ("no name of a layer",)),
        ((linked_run, other_run, image, "--marks", "pairs.csv"), 2, ("--marks", "study file")),
        ((linked_run, tmp_path / "nothing.tif"), 3, ("nothing.tif",)),
        ((linked_run, image, "--image-side", "left"), 2, ("--image-side",)),
        ((linked_run, image, "--design", tmp_path / "none.json"), 3, ("none.json",)),
    ):
        refuses("link", *arguments, words=words, code=code)


def test_layers_that_do_not_show_one_specimen_are_refused(refuses, linked_run, tmp_path):
    rng = np.random.default_rng(0)
    picture = np.full((400, 500), 180, dtype=np.uint8) + rng.integers(0, 20, (400, 500), dtype=np.uint8)
    blank = tmp_path / "blank.tif"
    tifffile.imwrite(blank, picture)
    refuses("link", linked_run, blank, linked_run, "--pixel-um", "5", words="", code=2)
    refuses("link", f"a={blank}", f"b={linked_run}", "--pixel-um", "5", words="No hole found in the a")


def test_a_study_of_layers_is_read_as_it_was_written(tmp_path):
    study = Study(
        layers=(
            LayerParams(name="ct", volume=VolumeParams(path=str(tmp_path / "v.tif"), md_deg=12.0)),
            LayerParams(name="lm", run=str(tmp_path / "lm"), marks=str(tmp_path / "pairs.csv")),
            LayerParams(name="photo", image=ImageParams(path=str(tmp_path / "p.png"), side="bottom")),
        ),
        chain=True,
        registration=RegistrationParams(design=str(tmp_path / "pattern.json")),
    )
    (tmp_path / "run").mkdir()
    write_study(study, tmp_path / "run", home=tmp_path / "run", version="1")
    text = (tmp_path / "run" / "run.toml").read_text()
    assert 'path = "../v.tif"' in text
    assert str(tmp_path) not in text
    assert read_study(tmp_path / "run" / "run.toml") == study


def test_fibre_directions_turn_with_the_sheet():
    angle = np.deg2rad(np.array([[10.0, 80.0], [-35.0, 60.0]]))
    parts = {"cos2": 0.4 * np.cos(2 * angle), "sin2": 0.4 * np.sin(2 * angle), "angle": np.rad2deg(angle)}
    maps = xr.Dataset({f"fibre_{name}": (("y", "x"), part) for name, part in parts.items()})
    for way in (Similarity(rotation_rad=0.4), Similarity(rotation_rad=-1.1, mirrored=True, scale=1.02)):
        ends = np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ way.matrix().T
        expected = np.rad2deg(np.arctan2(ends[..., 1], ends[..., 0]))
        found = _with_angles(maps, way)["fibre_angle"].values
        np.testing.assert_allclose((found - expected + 90) % 180 - 90, 0.0, atol=1e-9)
