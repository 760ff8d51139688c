"""The line is the same by ``planish link``, by the commands of the stages, and by hand in Python: byte by byte."""

import json

import numpy as np
import pytest
import tifffile
import xarray as xr

import planish as pl
from kinds import Files


def by_hand(files, frame, side):
    """The line of a notebook."""
    volume, image = pl.read_volume(files.volume), pl.read_image(files.image)
    surfaces = pl.find_surfaces(volume, frame=frame)
    measured = pl.measure_properties(surfaces, volume=volume)
    flat = pl.flatten_sheet(surfaces).flat
    maps = pl.resample_maps(measured, flat)
    registration = pl.register_marks(pl.find_holes(maps, side=side), pl.find_holes(image, side=side))
    linked = pl.resample_maps(measured, flat, onto=image, registration=registration)
    rows = pl.correlate_maps(linked)
    return linked, registration, rows


def same_bytes(a: xr.Dataset, b: xr.Dataset) -> None:
    """Every array, dtype, coordinate and attribute."""
    xr.testing.assert_identical(a, b)
    for name in (*a.variables,):
        assert (a[name].dtype, a[name].values.tobytes()) == (b[name].dtype, b[name].values.tobytes())


@pytest.mark.parametrize(("pose", "frame", "side"), [
    ("upright", pl.Frame(), "top"),
    ("laid", pl.Frame(through="y", top="low"), "bottom"),
])  # fmt: skip
def test_link_the_stages_and_a_notebook_give_the_same_bytes(passes, kinds, tmp_path, pose, frame, side):
    files = {"upright": Files(kinds.small.volume, kinds.small.image), "laid": kinds.laid}[pose]
    folder = kinds(pose)
    run = pl.open_run(folder)
    linked, registration, rows = by_hand(files, frame, side)
    same_bytes(linked, run.linked)
    assert rows == run.results.correlations
    registration.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (folder / "marks.json").read_bytes()
    lies = files.options[: files.options.index("--image-side")] if files.options else ()
    seen = ("--image-side", side)
    steps = (
        ("surface", files.volume, "-o", tmp_path / "s.zarr", *lies),
        ("measure", tmp_path / "s.zarr", "-o", tmp_path / "p.zarr"),
        ("flatten", tmp_path / "s.zarr", "-o", tmp_path / "f.zarr"),
        ("resample", tmp_path / "p.zarr", tmp_path / "f.zarr", "-o", tmp_path / "m.zarr"),
        ("holes", tmp_path / "m.zarr", "-o", tmp_path / "h.json", *seen),
        ("holes", files.image, "-o", tmp_path / "i.json", *seen),
        ("register", tmp_path / "h.json", tmp_path / "i.json", "-o", tmp_path / "marks.json"),
        ("resample", tmp_path / "p.zarr", tmp_path / "f.zarr", "-o", tmp_path / "linked.zarr", "--onto", files.image,
         "--registration", tmp_path / "marks.json"),
    )  # fmt: skip
    for step in steps:
        passes(*step)
    with xr.open_datatree(tmp_path / "linked.zarr", engine="zarr") as tree:
        same_bytes(tree["linked"].to_dataset().load(), run.linked)
    for name in ("marks.json", "marks.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()
    out, _ = passes("correlate", tmp_path / "linked.zarr", "--json")
    assert json.loads(out) == [json.loads(row.model_dump_json()) for row in run.results.correlations]


def test_the_groups_of_a_run_give_its_linked_maps(passes, linked_run, specimen_files, tmp_path):
    maps = linked_run / "maps.zarr"
    arguments = (maps, maps, "--onto", specimen_files[1], "--registration", linked_run / "marks.json")
    passes("resample", *arguments, "-o", tmp_path / "linked.zarr")
    with xr.open_datatree(tmp_path / "linked.zarr", engine="zarr") as tree:
        same_bytes(tree["linked"].to_dataset().load(), pl.open_run(linked_run).linked)


def test_the_marks_of_a_run_given_back_give_its_bytes(passes, linked_run, specimen_files, tmp_path):
    passes("link", linked_run, specimen_files[1], "--marks", linked_run / "marks.json", "-o", tmp_path / "run")
    first, again = pl.open_run(linked_run), pl.open_run(tmp_path / "run")
    same_bytes(again.linked, first.linked)
    origin = {"source", "match_sentence", "second_best", "tilt", "design"}
    sheets = [run.results.layers[0] for run in (first, again)]
    registrations = [sheet.registration.model_dump(exclude=origin) for sheet in sheets]
    np.testing.assert_equal(*registrations)
    assert sheets[1].registration.source == "json"
    for name in ("correlations", "comparison", "linked"):
        assert getattr(first.results, name) == getattr(again.results, name)
    # Given marks are not looked for: nothing is said of what was seen and not taken, nor of how the holes lean.
    of_holes = {"holes in sheet", "holes in image", "holes without partner", "tilt of the holes"}
    checks = [[c for c in run.checks if c.name not in of_holes] for run in (first, again)]
    assert (checks[0], of_holes) == (checks[1], {c.name for c in first.checks} - {c.name for c in again.checks})


@pytest.mark.nightly
def test_a_mark_that_is_not_used_is_still_masked(passes, linked_run, specimen_files, tmp_path):
    text = json.loads((linked_run / "marks.json").read_text())
    text["marks"][0]["used"] = False
    text.pop("registration")
    (tmp_path / "four.json").write_text(json.dumps(text))
    passes("link", linked_run, specimen_files[1], "--marks", tmp_path / "four.json", "-o", tmp_path / "run")
    first, again = pl.open_run(linked_run), pl.open_run(tmp_path / "run")
    assert again.results.layers[0].registration.matched == first.results.layers[0].registration.matched - 1
    at = text["marks"][0]["at"]["fixed"]
    near = np.hypot(first.linked.x - at["x"], first.linked.y - at["y"]) < 150
    assert not again.linked.valid.values[near.transpose("y", "x").values].any()


def test_changed_marks_and_other_images_are_refused(refuses, linked_run, specimen_files, tmp_path):
    text = json.loads((linked_run / "marks.json").read_text())
    text["marks"][0]["at"]["fixed"]["x"] += 3.0
    (tmp_path / "moved.json").write_text(json.dumps(text))
    maps = linked_run / "maps.zarr"
    arguments = (maps, maps, "--onto", specimen_files[1], "--registration", tmp_path / "moved.json")
    refuses("resample", *arguments, words="changed after the registration")
    maps, small = linked_run / "maps.zarr", tmp_path / "small.tif"
    tifffile.imwrite(small, tifffile.imread(specimen_files[1])[:60, :60])
    arguments = (maps, maps, "--onto", small, "--pixel-um", "5", "--registration", linked_run / "marks.json")
    refuses("resample", *arguments, words="lie beside the image")
    rows = ["label,volume_x_um,volume_y_um,volume_z_um,fixed_x_um,fixed_y_um"]
    rows += [f"h{k},{x},{y},100,{x},{y}" for k, (x, y) in enumerate([(300, 300), (800, 350), (500, 700), (900, 600)])]
    (tmp_path / "m.csv").write_text("\n".join(rows))
    files = (f"a={specimen_files[1]}", f"b={specimen_files[1]}")
    refuses("link", *files, "--marks", tmp_path / "m.csv", words="places in a volume")
