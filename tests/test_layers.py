"""Layers onto one reference: sizes, sides, directions and marks that are given, and what is
refused."""

import json

import numpy as np
import pytest
import tifffile
import xarray as xr

import planish as pl
from folders import disc_image
from planish.app.pictures import Pictures
from planish.core.transform import Similarity
from planish.io import ImageParams
from planish.marks import HoleParams, cut_holes, find_holes, read_any, write_marks
from planish.register import fit_transform
from planish.resample.maps import _with_angles
from planish.run import GivenLayer, HoleSearch, MappedLayer, link, open_run


def test_a_size_may_be_that_of_one_layer_alone(passes, refuses, kinds, tmp_path):
    """Two scans of uncertain resolution: --pixel-um would hold for both."""
    layers = ("link", f"small={kinds.small.image}", f"large={kinds.other.image}", "--override-size")
    wide = ("--set", "small.image.pixel_um=5.5,5.5", "--scale-tolerance", "0.12")
    passes(*layers, *wide, "-o", tmp_path / "wide", codes=(0, 4))
    run = open_run(tmp_path / "wide")
    assert run.study.layers[0].image.pixel_um[0] == 5.5
    assert run.results.moving[0].registration.scale == pytest.approx(5 / 5.5, abs=0.02)
    refuses(
        *layers,
        "--set",
        "tiny.image.pixel_um=5.5,5.5",
        words="--set: 'tiny.image.pixel_um=5.5,5.5'",
        code=2,
    )


def test_a_mirrored_image_is_refused_and_linked_when_it_is_declared_or_of_the_bottom(
    passes, refuses, linked_run, specimen_files, tmp_path
):
    flipped = tmp_path / "flipped.tif"
    tifffile.imwrite(flipped, tifffile.imread(specimen_files[1])[:, ::-1])
    files = ("link", linked_run, flipped, "--pixel-um", "5", "--json")
    refuses(*files, words="--mirror")
    out, _ = passes(*files, "-o", tmp_path / "mirrored", "--mirror")
    assert json.loads(out)["layers"][0]["registration"]["mirrored"] is True
    # It is a picture of the top for all that: its texture shows it.
    out, err = passes(*files, "--image-side", "bottom", "-o", tmp_path / "run", codes=(4,))
    assert "fail: side and specimen: The image correlates with the coating of the top side" in err
    registration = json.loads(out)["layers"][0]["registration"]
    orientation = registration["orientation"]
    assert (registration["mirrored"], orientation["mirrored_volume"]) == (True, False)
    assert "bottom side of the sheet, as given" in orientation["sentence"]


@pytest.mark.parametrize(("given", "code"), [("-7.0", 0), ("60", 4)])
def test_machine_directions_that_contradict_each_other_are_seen(
    planish, run_copy, specimen_files, tmp_path, given, code
):
    study = (run_copy / "run.toml").read_text()
    stored = json.loads((run_copy / "results.json").read_text())
    rotation = stored["layers"][0]["registration"]["rotation_deg"]
    # The map's machine direction lies along its x axis; in the image it is turned by the rotation
    # of the marks.
    (run_copy / "run.toml").write_text(
        study.replace("[layers.volume]", "[layers.volume]\nmd_deg = 0.0")
    )
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


def test_each_face_of_a_layer_is_searched_for_holes_once(monkeypatch):
    searches = []

    def search(_, *, params, side, layer):
        searches.append((layer, side, params.printed))
        return xr.Dataset()

    monkeypatch.setattr("planish.run.holes.find_holes", search)
    shows_bottom = GivenLayer(name="image", image=ImageParams(path="i.tif", side="bottom"))
    sheet = MappedLayer(
        params=GivenLayer(name="sheet", run="run"), source=None, groups={"maps": xr.Dataset()}
    )
    image = MappedLayer(params=shows_bottom, source=None, image=xr.DataArray(np.zeros((2, 2))))
    for params in (HoleParams(), HoleParams(printed=True)):
        holes = HoleSearch(params)
        for pair in [(sheet, image), (image, sheet), (sheet, sheet)] * 2:
            holes.of(*pair)
        assert [len(holes.searched(layer)) for layer in (sheet, image)] == [2, 1]
    faces = [("sheet", "bottom"), ("image", "bottom"), ("sheet", "top")]
    assert searches == [(*face, printed) for printed in (False, True) for face in faces]


def test_a_hole_that_the_border_cuts_is_left_out():
    image = pl.image(
        disc_image([(300.0, 300.0), (600.0, 700.0), (-20.0, 500.0)], (200, 200)), pixel_um=5.0
    )
    holes = find_holes(image.values, pixel_um=5.0)
    assert holes.sizes["mark"] == 2
    cut = cut_holes(image, holes)
    ((cx, cy, radius),) = zip(
        cut["x"].values, cut["y"].values, cut["diameter"].values / 2, strict=True
    )
    assert abs(cy - 500.0) < 5
    assert 0 <= cx < 60
    assert 60 < radius < 110


@pytest.mark.parametrize("frame", [True, False])
def test_dark_ground_beside_a_sheet_is_no_hole_that_the_border_cuts(frame):
    """A circle around it would leave no pixel of the sheet."""
    image = pl.image(disc_image([(300.0, 300.0), (600.0, 700.0)], (200, 200)), pixel_um=5.0)
    if frame:
        image[[0, 1, -2, -1]], image[:, [0, 1, -2, -1]] = 2000, 2000
    else:
        image[:, image.x > 800] = 2000
    holes = find_holes(image.values, pixel_um=5.0)
    assert (holes.sizes["mark"], cut_holes(image, holes).sizes["mark"]) == (2, 0)


def test_the_design_names_the_holes(passes, specimen, linked_run, specimen_files, tmp_path):
    table = tmp_path / "burnt.csv"
    turned = specimen.sheet.holes @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + 5000.0
    # In the laser's coordinates y runs up.
    rows = "\n".join(f"{x:.3f},{-y:.3f}" for x, y in turned)
    table.write_text(f"x_um,y_um\n{rows}\n")
    out, _ = passes(
        "link", linked_run, specimen_files[1], "--design", table, "-o", tmp_path / "run", "--json"
    )
    registration = json.loads(out)["layers"][0]["registration"]
    assert f"of {len(specimen.sheet.holes)} holes" in registration["design"]
    labels = [
        line.split(",")[0] for line in (tmp_path / "run" / "marks.csv").read_text().splitlines()[1:]
    ]
    assert len(set(labels)) == registration["matched"] == 5


def test_given_marks_replace_the_search(passes, linked_run, specimen_files, tmp_path):
    marks = linked_run / "marks.csv"
    out, _ = passes(
        "link", linked_run, specimen_files[1], "--marks", marks, "-o", tmp_path / "run", "--json"
    )
    found = json.loads(out)["layers"][0]["registration"]
    assert found["source"] == "csv"
    # Pairs from a file say nothing of their errors: all weigh the same.
    pairs = read_any(marks)
    moving, fixed = (
        np.stack([pairs[f"{s}_{a}"].values for a in "xy"], axis=1) for s in ("moving", "fixed")
    )
    plain = fit_transform(moving, fixed, model="auto", mirrored=False, lowest="similarity")
    assert found["scale"] == pytest.approx(plain.transform.scale, rel=1e-12)
    weighed = open_run(linked_run).results.layers[0].registration.scale
    assert found["scale"] == pytest.approx(weighed, rel=3e-4)


def test_positions_that_count_from_the_first_pixel_of_a_map_are_shifted_by_its_place(
    passes, refuses, linked_run, specimen_files, tmp_path
):
    """Landmarks of BigWarp lie where the map begins, whether a link or a conversion reads them."""
    link = ("link", linked_run, specimen_files[1], "--marks")
    maps = open_run(linked_run).maps
    place_um = np.array([float(maps.u[0]), float(maps.v[0])])
    place_text = f"{place_um[0]:.17g},{place_um[1]:.17g}"
    assert np.abs(place_um).min() > 5
    own = read_any(linked_run / "marks.json")
    own = own.isel(mark=np.flatnonzero(own["used"].values & np.isfinite(own["moving_x"].values)))
    rows = [
        f'"{mark.label.item()}","true","{mark.moving_x - place_um[0]:.17g}",'
        f'"{mark.moving_y - place_um[1]:.17g}","{mark.fixed_x:.17g}","{mark.fixed_y:.17g}"'
        for mark in (own.isel(mark=k) for k in range(own.sizes["mark"]))
    ]
    landmarks, converted = tmp_path / "landmarks.csv", tmp_path / "marks.json"
    landmarks.write_text("\n".join(rows))

    out, _ = passes(*link, landmarks, "-o", tmp_path / "direct")
    assert "was added" in " ".join(out.split())
    assert f"({place_um[0]:g}, {place_um[1]:g}) um" in " ".join(out.split())
    passes("marks", "convert", landmarks, converted, "--moving-origin-um", place_text)
    out, _ = passes(*link, converted, "-o", tmp_path / "by-convert")
    assert "was added" not in " ".join(out.split())
    for name in ("direct", "by-convert"):
        marks = read_any(tmp_path / name / "marks.json").set_index(mark="label")
        marks = marks.sel(mark=own["label"].values)
        for axis in "xy":
            moving_um = marks[f"moving_{axis}"].values
            assert moving_um == pytest.approx(own[f"moving_{axis}"].values, abs=1e-6)

    # A conversion that is not given the place says so, in both directions.
    _, err = passes("marks", "convert", landmarks, tmp_path / "shifted.json")
    assert "first pixel was taken to lie at 0,0 um" in err
    run_marks = linked_run / "marks.json"
    _, err = passes("marks", "convert", run_marks, tmp_path / "a.csv", "--to", "bigwarp")
    assert "first pixel was taken to lie at 0,0 um" in err
    # Positions of Slicer hold the place where a NRRD stated it.
    lists = tmp_path / "lists.mrk.json"
    passes("marks", "convert", converted, lists, "--moving-origin-um", place_text)
    refuses(*link, lists, words=("moving-origin-um", "for a TIFF", "for a NRRD"))


def test_marks_given_in_the_volume(passes, specimen, linked_run, specimen_files, tmp_path):
    in_volume = specimen.warp.points(*specimen.sheet.holes.T)
    in_image = specimen.pose(specimen.sheet.holes)
    rows = ["label,volume_x_um,volume_y_um,volume_z_um,fixed_x_um,fixed_y_um"]
    ends = zip(in_volume, in_image, strict=True)
    rows += [f"h{k},{p[0]},{p[1]},{p[2]},{q[0]},{q[1]}" for k, (p, q) in enumerate(ends)]
    (tmp_path / "m.csv").write_text("\n".join(rows))
    files = (linked_run, specimen_files[1])
    out, _ = passes("link", *files, "--marks", tmp_path / "m.csv", "-o", tmp_path / "run", "--json")
    assert json.loads(out)["layers"][0]["registration"]["rms_um"] < 1.0


def clicked(marks, path):
    """Marks that somebody has clicked, 4 um off, as a file."""
    rng = np.random.default_rng(3)
    off = {f"fixed_{a}": marks[f"fixed_{a}"] + rng.normal(0, 4, marks.sizes["mark"]) for a in "xy"}
    write_marks(marks.assign(off), path)
    return {"marks": str(path), "refine": "affine"}


def test_a_refined_link_stands_beside_that_of_the_marks_and_is_nearer_to_the_truth(
    linked, linked_run, specimen_files, tmp_path
):
    given = clicked(read_any(linked_run / "marks.csv"), tmp_path / "clicked.csv")
    run = link(linked_run, specimen_files[1], registration=given, out=tmp_path / "run")
    assert 0 < run.results.refinement.moved_rms_um < 15
    assert run.results.refinement.correlation.registration in (
        "refined (cross-fitted)",
        "refined (searched null)",
    )
    refined = run.groups["refined"]
    ok = linked["valid"].values & run.linked["valid"].values & np.isfinite(refined["u"].values)

    def off_rms(maps):
        off = np.hypot(*(maps[a].values[ok] - linked[a].values[ok] for a in ("u", "v")))
        return np.sqrt(np.mean(off**2))

    assert off_rms(refined) < 0.7 * off_rms(run.linked)
    assert "Refined by the maps themselves" in (tmp_path / "run" / "report.html").read_text()


def test_two_images_are_refined_by_what_they_show(kinds, tmp_path):
    before = open_run(kinds("images"))
    given = clicked(before.registrations["white"].marks, tmp_path / "clicked.csv")
    layers = (f"white={kinds.small.image}", f"uv={kinds.other.image}")
    run = link(*layers, registration=given, out=tmp_path / "run")
    right, refined = before.groups["layers/white"], run.groups["refined"]
    ok = (
        right["valid"].values
        & run.groups["layers/white"]["valid"].values
        & np.isfinite(refined["image"].values)
    )

    def unlike(image):
        return np.std(image.values[ok] - right["image"].values[ok])

    assert run.results.refinement.property == "image"
    assert unlike(refined["image"]) < 0.8 * unlike(run.groups["layers/white"]["image"])
    assert "refined" in {picture.layer for picture in Pictures.of(tmp_path / "run")}


def test_links_that_cannot_be_made_are_refused_with_the_reason(
    refuses, linked_run, specimen_files, kinds, tmp_path
):
    (volume, image), other_run = specimen_files, kinds("other-map")
    for arguments, code, words in (
        ((image,), 2, ("reference last",)),
        ((linked_run, image, "--cutoff-um", "300"), 2, ("--cutoff-um", "keeps the options")),
        ((f"a={image}", f"a={volume}", other_run), 2, ("more than one is a", "NAME=PATH")),
        ((linked_run, other_run, image, "--marks", "pairs.csv"), 2, ("--marks", "study file")),
        ((linked_run, tmp_path / "nothing.tif"), 3, ("nothing.tif",)),
        ((linked_run, image, "--image-side", "left"), 2, ("--image-side",)),
        ((linked_run, image, "--design", tmp_path / "none.json"), 3, ("none.json",)),
    ):
        refuses("link", *arguments, words=words, code=code)


def test_fibre_directions_turn_with_the_sheet():
    angle = np.deg2rad(np.array([[10.0, 80.0], [-35.0, 60.0]]))
    parts = {
        "cos2": 0.4 * np.cos(2 * angle),
        "sin2": 0.4 * np.sin(2 * angle),
        "angle": np.rad2deg(angle),
    }
    maps = xr.Dataset({f"fibre_{name}": (("y", "x"), part) for name, part in parts.items()})
    for way in (
        Similarity(rotation_rad=0.4),
        Similarity(rotation_rad=-1.1, mirrored=True, scale=1.02),
    ):
        ends = np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ way.matrix().T
        expected = np.rad2deg(np.arctan2(ends[..., 1], ends[..., 0]))
        found = _with_angles(maps, way)["fibre_angle"].values
        np.testing.assert_allclose((found - expected + 90) % 180 - 90, 0.0, atol=1e-9)
