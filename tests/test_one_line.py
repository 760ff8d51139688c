"""The line is the same by ``planish link``, by the commands of the stages, and by hand in Python:
byte by byte."""

import json

import numpy as np
import pytest
import tifffile
import xarray as xr

import planish as pl
from folders import bytes_of
from planish.cli import runs
from planish.core.errors import CannotRegister, FileError, StudyError
from planish.run import SECTIONS, Compute, build, cached_maps, open_results, read_study, study_of
from planish.run.run import open_sheet


def by_hand(files, side):
    """The line of a notebook."""
    volume, image = pl.read_volume(files.volume), pl.read_image(files.image)
    surfaces = pl.find_surfaces(volume, through="y", top="low")
    measured = pl.measure_properties(surfaces, volume=volume)
    flat = pl.flatten_sheet(surfaces).flat
    maps = pl.resample_maps(measured, flat)
    registration = pl.register_marks(
        pl.find_holes(maps, side=side), pl.find_holes(image, side=side)
    )
    linked = pl.resample_maps(measured, flat, onto=image, registration=registration)
    rows = pl.correlate_maps(linked)
    return linked, registration, rows


def same_bytes(a, b):
    """Every array, dtype, coordinate and attribute."""
    xr.testing.assert_identical(a, b)
    for name in a.variables:
        assert (a[name].dtype, a[name].values.tobytes()) == (
            b[name].dtype,
            b[name].values.tobytes(),
        )


def group_of(path, group):
    with xr.open_datatree(path, engine="zarr") as tree:
        return tree[group].to_dataset().load()


# --- link, the stages, a notebook -----------------------------------------------------------------
def test_link_the_stages_and_a_notebook_give_the_same_bytes(passes, kinds, tmp_path):
    files, folder, side = kinds.laid, kinds("laid"), "bottom"
    run = pl.open_run(folder)
    linked, registration, rows = by_hand(files, side)
    same_bytes(linked, run.linked)
    # Only a run makes the checks that doubt a row.
    expected = tuple(row.model_copy(update={"trust": "ok"}) for row in run.results.correlations)
    assert rows == expected
    doubtful = {row.a_map for row in run.results.correlations if row.trust != "ok"}
    assert all(name.startswith(("topography", "base_surface")) for name in doubtful)
    registration.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (folder / "marks.json").read_bytes()
    lies, seen = ("--through", "y", "--top", "low"), ("--image-side", side)
    steps = (
        ("surface", files.volume, "-o", tmp_path / "s.zarr", *lies),
        ("measure", tmp_path / "s.zarr", "-o", tmp_path / "p.zarr"),
        ("flatten", tmp_path / "s.zarr", "-o", tmp_path / "f.zarr"),
        ("resample", tmp_path / "p.zarr", tmp_path / "f.zarr", "-o", tmp_path / "m.zarr"),
        ("holes", tmp_path / "m.zarr", "-o", tmp_path / "h.json", *seen),
        ("holes", files.image, "-o", tmp_path / "i.json", *seen),
        ("register", tmp_path / "h.json", tmp_path / "i.json", "-o", tmp_path / "marks.json"),
        (
            "resample",
            tmp_path / "p.zarr",
            tmp_path / "f.zarr",
            "-o",
            tmp_path / "linked.zarr",
            "--onto",
            files.image,
            "--registration",
            tmp_path / "marks.json",
        ),
    )
    for step in steps:
        printed, _ = passes(*step)
        assert printed.strip()
    same_bytes(group_of(tmp_path / "linked.zarr", "linked"), run.linked)
    for name in ("marks.json", "marks.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()
    out, _ = passes("correlate", tmp_path / "linked.zarr", "--json")
    assert json.loads(out) == [json.loads(row.model_dump_json()) for row in expected]


def test_the_stages_take_the_groups_of_a_run(passes, refuses, linked_run, specimen_files, tmp_path):
    maps = linked_run / "maps.zarr"
    onto = ("--onto", specimen_files[1], "--registration", linked_run / "marks.json")
    for step in (
        ("flatten", linked_run, "-o", tmp_path / "f.zarr"),
        ("resample", linked_run, tmp_path / "f.zarr", "-o", tmp_path / "m.zarr"),
        ("holes", linked_run, "-o", tmp_path / "sheet.json"),
        ("holes", specimen_files[1], "-o", tmp_path / "image.json"),
        (
            "register",
            tmp_path / "sheet.json",
            tmp_path / "image.json",
            "-o",
            tmp_path / "marks.json",
        ),
        ("resample", maps, maps, *onto, "-o", tmp_path / "linked.zarr"),
    ):
        passes(*step)
    chain, line = (group_of(path, "maps")["thickness"] for path in (tmp_path / "m.zarr", maps))
    # The columns of a run count as measured only where a normal meets both faces: their weight in
    # the mesh differs.
    assert float(abs(chain.mean() - line.mean())) < 0.1
    assert (tmp_path / "marks.json").read_bytes() == (linked_run / "marks.json").read_bytes()
    same_bytes(group_of(tmp_path / "linked.zarr", "linked"), pl.open_run(linked_run).linked)
    out, _ = passes("correlate", linked_run, "--json")
    assert json.loads(out) == json.loads((linked_run / "results.json").read_text())["correlations"]
    out, _ = passes("correlate", linked_run, "--property", "thickness", "--json")
    assert [row["a_map"] for row in json.loads(out)] == ["thickness"] * 2
    refuses("correlate", linked_run, "--property", "gloss", words="gloss", out=False)


def test_the_page_of_a_run_is_made_again_and_its_figures_stand_beside_it(
    planish, passes, linked_run, tmp_path
):
    page, figures = tmp_path / "page.html", tmp_path / "figures"
    passes("report", linked_run, "-o", page, "--figures")
    assert page.read_bytes() == (linked_run / "report.html").read_bytes()
    assert len([*figures.glob("*.svg")]) == page.read_text(encoding="utf-8").count("<figcaption>")
    assert any(figures.glob("*-points.csv"))
    # What stands there already is not overwritten, and no page is written without its figures.
    code, _, err = planish("report", linked_run, "-o", tmp_path / "other.html", "--figures")
    assert code != 0
    assert "figures" in err
    assert not (tmp_path / "other.html").exists()


# --- from a run, from arrays, from marks ----------------------------------------------------------
def test_a_run_linked_to_an_image_is_the_volume_linked_to_it(passes, linked_run):
    again = linked_run.parent / "again"
    # The very file: each worker has one of its own, and the study names it.
    passes("link", linked_run, pl.open_run(linked_run).study.layers[-1].path, "-o", again)
    assert len(bytes_of(again)) > 50
    assert bytes_of(again) == bytes_of(linked_run)


def test_a_link_of_arrays_has_the_bytes_of_the_link_of_the_files(
    specimen_files, linked_run, tmp_path
):
    volume, image = (tifffile.imread(path) for path in specimen_files)
    arrays = pl.volume(volume, voxel_um=4.0), pl.image(image, pixel_um=5.0)
    run = pl.link(*arrays, out=tmp_path / "run")
    before, found = pl.open_run(linked_run), pl.open_run(tmp_path / "run")
    assert list(found.groups) == list(before.groups)
    for name, data in before.groups.items():
        for key, variable in data.variables.items():
            other = found.groups[name].variables[key]
            assert (variable.dtype, variable.values.tobytes()) == (
                other.dtype,
                other.values.tobytes(),
            ), f"{name}/{key}"
    inputs = tmp_path / "run-inputs"
    assert sorted(path.name for path in inputs.iterdir()) == ["image.tif", "sheet.zarr"]
    assert tifffile.imread(inputs / "image.tif").dtype == image.dtype
    study = read_study(tmp_path / "run" / "run.toml")  # which repeats it
    assert [layer.path for layer in study.layers] == [
        str(inputs / name) for name in ("sheet.zarr", "image.tif")
    ]
    assert run.passed == before.passed
    with pytest.raises(FileError, match="run exists already"):
        pl.link(*arrays, out=tmp_path / "run")
    (tmp_path / "run").rename(tmp_path / "away")
    with pytest.raises(FileError, match="run-inputs exists already"):
        pl.link(*arrays, out=tmp_path / "run")
    text = repr(run)
    assert len(text.splitlines()) <= 10
    for word in ("sheet: sheet.zarr", "image: image.tif", "r = ", "linked ", "pass"):
        assert word in text


@pytest.mark.ci  # which maps a small sheet
def test_a_refused_link_of_arrays_leaves_no_inputs(tmp_path):
    rng = np.random.default_rng(1)
    greys = rng.integers(0, 20, (40, 60, 60)).astype(np.uint8)
    greys[15:25] += 200
    arrays = (
        pl.volume(greys, voxel_um=4.0),
        pl.image(rng.integers(0, 200, (60, 60)).astype(np.uint8), pixel_um=4.0),
    )
    (tmp_path / "run-other").mkdir()
    (tmp_path / "run-other" / "run.toml").touch()
    for is_mapped in (True, False):  # the second call goes on with the maps of the first
        seen = []
        with pytest.raises(CannotRegister) as caught:
            pl.link(
                *arrays,
                out=tmp_path / "run",
                progress=lambda stage, _, seen=seen: seen.append(stage),
            )
        assert "write the arrays to files" in str(caught.value)
        assert "run-inputs" not in str(caught.value)
        assert ("surface" in seen) is is_mapped
        assert {path.name for path in tmp_path.iterdir()} == {"run-map", "run-other"}
    with pytest.raises(FileError, match="does not exist"):
        pl.link(arrays[0], tmp_path / "no.tif", out=tmp_path / "further" / "run")
    assert not (tmp_path / "further").exists()


def test_the_marks_of_a_run_given_back_give_its_bytes(passes, linked_run, specimen_files, tmp_path):
    passes(
        "link",
        linked_run,
        specimen_files[1],
        "--marks",
        linked_run / "marks.json",
        "-o",
        tmp_path / "run",
    )
    first, again = pl.open_run(linked_run), pl.open_run(tmp_path / "run")
    same_bytes(again.linked, first.linked)
    origin = {"source", "match_sentence", "second_best", "tilt", "design"}
    sheets = [run.results.layers[0] for run in (first, again)]
    registrations = [sheet.registration.model_dump(exclude=origin) for sheet in sheets]
    np.testing.assert_equal(*registrations)
    assert sheets[1].registration.source == "json"
    for name in ("correlations", "comparison", "linked"):
        assert getattr(first.results, name) == getattr(again.results, name)
    # Given marks are not looked for: nothing is said of what was seen and not taken, nor of how the
    # holes lean.
    of_holes = {"holes in sheet", "holes in image", "holes without partner", "tilt of the holes"}
    checks = [[c for c in run.checks if c.name not in of_holes] for run in (first, again)]
    assert (checks[0], of_holes) == (
        checks[1],
        {c.name for c in first.checks} - {c.name for c in again.checks},
    )


def test_a_mark_that_is_not_used_is_still_masked(passes, linked_run, specimen_files, tmp_path):
    text = json.loads((linked_run / "marks.json").read_text())
    text["marks"][0]["used"] = False
    text.pop("registration")
    (tmp_path / "four.json").write_text(json.dumps(text))
    passes(
        "link",
        linked_run,
        specimen_files[1],
        "--marks",
        tmp_path / "four.json",
        "-o",
        tmp_path / "run",
    )
    first, again = pl.open_run(linked_run), pl.open_run(tmp_path / "run")
    assert (
        again.results.layers[0].registration.matched
        == first.results.layers[0].registration.matched - 1
    )
    at = text["marks"][0]["at"]["fixed"]
    near = np.hypot(first.linked.x - at["x"], first.linked.y - at["y"]) < 150
    assert not again.linked.valid.values[near.transpose("y", "x").values].any()


def test_changed_marks_other_images_and_no_store_are_refused(
    refuses, linked_run, specimen_files, tmp_path
):
    refuses(
        "measure",
        tmp_path / "none.zarr",
        "-o",
        tmp_path / "p.zarr",
        words="none.zarr does not exist",
        out=False,
    )
    text = json.loads((linked_run / "marks.json").read_text())
    text["marks"][0]["at"]["fixed"]["x"] += 3.0
    (tmp_path / "moved.json").write_text(json.dumps(text))
    maps = linked_run / "maps.zarr"
    arguments = (maps, maps, "--onto", specimen_files[1], "--registration", tmp_path / "moved.json")
    refuses("resample", *arguments, words="changed after the registration")
    small = tmp_path / "small.tif"
    tifffile.imwrite(small, tifffile.imread(specimen_files[1])[:60, :60])
    arguments = (
        maps,
        maps,
        "--onto",
        small,
        "--pixel-um",
        "5",
        "--registration",
        linked_run / "marks.json",
    )
    refuses("resample", *arguments, words="lie beside the image")
    rows = ["label,volume_x_um,volume_y_um,volume_z_um,fixed_x_um,fixed_y_um"]
    rows += [
        f"h{k},{x},{y},100,{x},{y}"
        for k, (x, y) in enumerate([(300, 300), (800, 350), (500, 700), (900, 600)])
    ]
    (tmp_path / "m.csv").write_text("\n".join(rows))
    files = (f"a={specimen_files[1]}", f"b={specimen_files[1]}")
    refuses("link", *files, "--marks", tmp_path / "m.csv", words="places in a volume")


# --- arrays and words -----------------------------------------------------------------------------
def test_a_volume_says_how_its_sheet_lies_and_words_go_before_it(tmp_path):
    volume = pl.volume(np.zeros((20, 30, 40), np.uint8), voxel_um=3, through="y", top="low")
    image = pl.image(np.zeros((30, 40)), pixel_um=5, side="bottom")
    with pytest.raises(pl.PlanishError):  # there is no sheet in it
        pl.link(volume, image, out=tmp_path / "run")
    assert list(tmp_path.iterdir()) == []  # what was written for it is gone
    from planish.run.array_layers import layer_sources

    with layer_sources([volume, image], None, "pl.link({})") as sources:
        study = study_of(sources, {})
        assert (study.layers[0].volume.through, study.layers[0].volume.top) == ("y", "low")
        assert study.layers[0].volume.voxel_um == (3, 3, 3)
        assert (study.layers[1].image.side, study.layers[1].image.pixel_um) == ("bottom", (5, 5))
        study = study_of(sources, {"volume": {"through": "x"}, "image": {"side": "top"}})
        assert (study.layers[0].volume.through, study.layers[1].image.side) == ("x", "top")
        folder = sources[0].path.parent
    assert not folder.exists()


def test_a_mapped_array_needs_no_folder(tmp_path):
    """A sheet of 11 voxels through y, as a volume of a memory map."""
    z, y, x = np.ogrid[:60, :40, :60]
    values = np.where(abs(y - 20 + 0 * z * x) < 6, 120.0, 20.0) + np.random.default_rng(3).normal(
        0, 6, (60, 40, 60)
    )
    np.save(tmp_path / "v.npy", values.astype(np.float32))
    volume = pl.volume(np.load(tmp_path / "v.npy", mmap_mode="r"), voxel_um=5, through="y")
    run = pl.map_sheet(volume, rim_um=15, cutoff_um=100, threads=1)
    assert float(run.maps.thickness.mean()) == pytest.approx(55, abs=2.5)  # 11 voxels, half a voxel
    assert run.study.layers[0].surface.rim_um == 15
    assert sorted(path.name for path in tmp_path.iterdir()) == ["v.npy"]


def test_words_are_those_of_the_command_line_each_given_once():
    words = {
        "through": "y",
        "property": ["porosity"],
        "image_side": "bottom",
        "point_um": 50,
        "memory": "4GB",
        "labels": None,
        "label_air": [0],
        "hole_um": (80, 200),
    }
    sections, compute = build.sections_of(words, tuple(SECTIONS), None, call="pl.link")
    assert sections == {
        "volume": {"through": "y"},
        "properties": {"maps": ["porosity"]},
        "image": {"side": "bottom"},
        "correlate": {"point_um": 50},
        "surface": {"labels": {"air": [0]}},
        "holes": {"hole_um": (80, 200)},
    }
    assert compute.memory_bytes == 4 * 10**9
    from planish.cli.runs import link as command
    from planish.run.build import words_of

    own = {"out", "chain", "set", "figures", "strict", "json", "help"}
    flags = {
        flag[2:].replace("-", "_")
        for option in command.params
        for flag in option.opts
        if flag.startswith("--")
    }
    assert flags - own == {*words_of([*SECTIONS, "compute"])}
    for words, compute in (
        ({"through": "y", "volume": {"through": "x"}}, None),
        ({"threads": 2}, Compute(threads=1)),
    ):
        with pytest.raises(StudyError, match="is given twice, by itself and in"):
            build.sections_of(words, tuple(SECTIONS), compute, call="pl.link")
    _, both = build.sections_of(
        {"memory": "4GB"}, tuple(SECTIONS), Compute(threads=1), call="pl.link"
    )
    assert both == Compute(threads=1, memory_bytes=4 * 10**9)


# --- runs that differ -----------------------------------------------------------------------------
def test_files_that_differ_are_named_and_those_of_maps_counted(linked_run, run_copy, capsys):
    runs._compare(linked_run, run_copy)
    assert f"{run_copy}: same bytes as {linked_run}" in capsys.readouterr().err
    chunks = sorted((run_copy / "maps.zarr/linked/image/c").rglob("[0-9]"))
    for path in (*chunks, run_copy / "maps.zarr/maps/u/zarr.json", run_copy / "figures.csv"):
        if path.is_file():
            path.write_bytes(path.read_bytes() + b" ")
    count = 1 + sum(path.is_file() for path in chunks)
    runs._compare(linked_run, run_copy)
    said = (
        f"{run_copy}: {count} files of maps.zarr (linked, maps), figures.csv differ from"
        f" {linked_run}"
    )
    assert said in capsys.readouterr().err


def test_a_run_of_other_code_is_said_to_be_one_and_its_maps_are_not_taken(
    linked_run, run_copy, specimen_files, tmp_path, capsys
):
    """The version alone is the same in all states of the sources between two releases."""
    study = read_study(run_copy / "run.toml")
    hashes = [layer.source.sha256 for layer in open_results(run_copy).layers]
    assert cached_maps.sheets_of(run_copy, study, hashes)[0].keys() == {"sheet"}
    assert open_sheet(run_copy).unchanged
    results = open_results(run_copy)
    assert len(results.code) == 16
    (run_copy / "results.json").write_text(
        results.model_copy(update={"code": ""}).to_json(), encoding="utf-8"
    )
    assert cached_maps.sheets_of(run_copy, study, hashes) == ({}, {})
    assert not open_sheet(run_copy).unchanged
    runs._compare(run_copy, linked_run)
    said = (
        f"results.json differs from {run_copy}, which was made by other code (planish"
        f" {results.planish})"
    )
    assert said in capsys.readouterr().err
    again = pl.link(run_copy, specimen_files[1], out=tmp_path / "linked").results
    assert (again.is_of_this_code, open_results(linked_run).is_of_this_code) == (False, True)


def test_a_fault_of_ours_is_a_sentence_and_a_log(planish, specimen_files, tmp_path, monkeypatch):
    def broken(*_args, **_kwargs):
        raise RuntimeError("wires crossed")

    monkeypatch.setattr("planish.run.sheet.find_surfaces", broken)
    code, _, err = planish("map", specimen_files[0], "-o", tmp_path / "run")
    assert code == 1
    assert [word for word in ("wires crossed", ".log") if word not in err] == []
    assert "Traceback" not in err
