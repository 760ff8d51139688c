"""No work is thrown away: cheap faults come before the volume is read, and maps outlive a refused
link."""

import os
import shutil
import stat
import sys
from importlib import import_module
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from folders import bytes_of, disc_image, refused, write_image
from planish.core.errors import FileError, InputError
from planish.core.files import write_whole
from planish.io import new_folder
from planish.results import Results
from planish.run import open_run, read_study, study_of, with_values, write_study


def image_with(path, holes):
    return write_image(path, disc_image(holes, (200, 260)))


def instead_of_mapping(monkeypatch, work):
    """Put ``work`` where volumes are mapped; the package hides its modules behind functions of the
    same names."""
    monkeypatch.setattr(import_module("planish.run.workspace"), "map_layer", work)


def mapped(*_args, **_more):
    """Whoever maps a volume fails the test."""
    pytest.fail("the volume was mapped")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--property", "coating_tpo"), ("no property 'coating_tpo'", "coating_top")),
        (("--property", "grammage"), ("--grammage or --base-density",)),
        (("--property", "coat_weight_top"), ("--coat-weight-top or --coating-density",)),
        (("--property", "ink_depth_50"), ("ink_grey", "in [properties] of a study file")),
        (("--property", "porosity", "--labels"), ("labels has none", "--property")),
    ],
)
@pytest.mark.usefixtures("unread")
def test_a_property_without_its_input_is_refused_before_the_volume_is_read(
    refuses, specimen_files, options, words
):
    refuses("link", *specimen_files, *options, words=words)


@pytest.mark.usefixtures("unread")
def test_too_few_holes_or_useless_marks_are_refused_before_the_volume_is_mapped(
    refuses, specimen_files, tmp_path
):
    places = [(300, 300), (900, 600)]
    for count, words in enumerate(("No hole", "Only 1 hole found", "Only 2 holes found")):
        image = image_with(tmp_path / f"{count}.tif", places[:count])
        maps = tmp_path / "run-map"
        then = (f"planish map {specimen_files[0]} --out {maps}", f"planish view {maps} {image}")
        refuses(
            "link",
            specimen_files[0],
            image,
            "--by",
            "holes",
            words=(words, "at least 3", "--marks", *then),
        )
    rows = [
        "label,volume_x_um,volume_y_um,volume_z_um,fixed_x_um,fixed_y_um",
        "a,1,1,1,1,1",
        "b,9,9,9,9,9",
    ]
    (tmp_path / "m.csv").write_text("\n".join(rows))
    refuses("link", *specimen_files, "--marks", tmp_path / "m.csv", words="2 pairs of marks in use")


@pytest.mark.ci
def test_maps_of_a_refused_link_are_kept_and_taken_up_but_with_other_parameters(
    planish, passes, refuses, specimen_files, linked_run, tmp_path, monkeypatch
):
    volume, image = specimen_files
    wrong = image_with(
        tmp_path / "wrong.tif", [(200, 200), (1100, 250), (700, 850), (350, 700), (950, 600)]
    )
    out, maps, kept_in = tmp_path / "run", tmp_path / "run-map", tmp_path / "run-map-2"
    maps.mkdir()
    (maps / "thesis.txt").write_text("years")  # another's
    code, _, err = planish("link", volume, wrong, "-o", out)
    message = " ".join(err.split())
    assert (code, "no match found" in message) == (3, True), err
    assert f"kept in {kept_in}; the same command goes on" in message
    assert {p.name for p in tmp_path.iterdir()} == {"wrong.tif", "run-map", "run-map-2"}
    assert bytes_of(maps) == {"thesis.txt": b"years"}
    kept = bytes_of(kept_in)
    assert open_run(kept_in).results.passed

    cutoffs = []

    def stopped(params, **_more):
        cutoffs.append(params.surface.cutoff_um)
        raise InputError("stop here")

    with monkeypatch.context() as patch:
        instead_of_mapping(patch, stopped)
        refuses(
            "link", volume, wrong, "-o", out, "--cutoff-um", "500", words="stop here", out=False
        )
        assert cutoffs == [500.0]
        instead_of_mapping(patch, mapped)
        refuses("link", volume, wrong, "-o", out, words="sheet, mapped before", out=False)
        passes("link", volume, image, "-o", out)
    # The same bytes as without the detour, but for the relative paths in run.toml; what was kept is
    # left as it is.
    found, straight = bytes_of(out), bytes_of(linked_run)
    assert found.keys() == straight.keys()
    assert [name for name in found if found[name] != straight[name]] in ([], ["run.toml"])
    assert bytes_of(kept_in) == kept


def test_results_are_never_written_into_an_input(refuses, run_copy, tmp_path):
    image_with(tmp_path / "image.tif", [])
    before = bytes_of(run_copy)
    for arguments in (
        ("link", run_copy, tmp_path / "image.tif", "-o", run_copy / "more"),
        ("map", run_copy / "maps.zarr", "-o", run_copy / "maps.zarr" / "more" / "still"),
        ("import", run_copy / "maps.zarr", "-o", run_copy / "maps.zarr" / "s.zarr"),
        ("surface", run_copy, "-o", run_copy / "s.zarr"),
        ("report", run_copy, "-o", run_copy / "page.html"),
    ):
        refuses(*arguments, words="which is read; nothing is written there", out=False)
    assert bytes_of(run_copy) == before


def test_a_run_that_lost_a_part_is_no_run_with_missing_values(refuses, run_copy, tmp_path):
    page = ("report", run_copy, "-o", tmp_path / "page.html")
    part = next(
        p
        for p in (run_copy / "maps.zarr" / "linked" / "coating_top" / "c").rglob("*")
        if p.is_file()
    )
    data = part.read_bytes()
    part.unlink()
    refuses(*page, words="damaged", out=False)
    for cut in (b"", data[: len(data) // 2]):
        part.write_bytes(cut)
        refuses("correlate", run_copy, words="damaged", out=False)
    part.write_bytes(data)
    (run_copy / "results.json").write_text("[]")
    for arguments in (page, ("info", run_copy)):
        refuses(*arguments, words="results.json", out=False)


@pytest.mark.parametrize(
    "text", ["[]", "[" * 100_000, '{"planish"', ""], ids=["list", "deep", "cut", "empty"]
)
def test_what_is_no_file_of_results_is_named(text, tmp_path):
    (tmp_path / "results.json").write_text(text)
    refused(FileError, r"results\.json .*repeat the run", Results.read, tmp_path / "results.json")


@pytest.mark.skipif(os.name == "nt", reason="no modes there")
def test_results_have_the_mode_that_the_user_asks_for(tmp_path):
    before = os.umask(0o027)
    try:
        with new_folder(tmp_path / "run"):
            pass
        write_whole(tmp_path / "page.html", b"")
    finally:
        os.umask(before)
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("run", "page.html")]
    assert modes == [0o750, 0o640]


@pytest.mark.skipif(
    os.name == "nt" or sys.platform == "darwin", reason="such names are not possible there"
)
def test_names_that_are_no_text_do_not_reach_the_terminal(
    planish, refuses, specimen_files, tmp_path
):
    for name in (b"a\x1b[31mred.tif", b"b\xff.tif"):
        path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/" + name))
        shutil.copy(specimen_files[1], path)
        for arguments in (("info", path), ("map", path, "-o", tmp_path / "run")):
            code, out, err = planish(*arguments)
            assert code == 3
            assert "no text" in err
            assert "\x1b" not in out + err
    path = tmp_path / "sets.h5"
    with h5py.File(path, "w") as file:
        for name in "ab":
            file.create_dataset(f"{name}\x1b[31m", data=np.zeros((20, 20, 20), np.uint8))
    refuses("info", path, words=r"a\x1b[31m", out=False)


@pytest.mark.ci
def test_a_scale_beyond_the_calibration_has_a_way_through(
    passes, refuses, linked_run, specimen_files, tmp_path
):
    command = ("link", linked_run, specimen_files[1], "--pixel-um", "5.25", "--override-size")
    refuses(*command, words="--scale-tolerance")
    passes(*command, "--scale-tolerance", "0.08", "-o", tmp_path / "run", codes=(0, 4))
    registration = open_run(tmp_path / "run").results.moving[0].registration
    assert abs(registration.scale - 1.05) < 0.01


@pytest.mark.ci
def test_a_piece_that_fills_a_third_of_its_box_is_covered(passes, specimen, tmp_path):
    """Beside a small specimen lies air, which is no sheet that was lost."""
    grey = specimen.volume.values
    y, x = grey.shape[1:]
    rows, cols = np.ogrid[:y, :x]
    piece = ((rows / y - 0.5) / 0.45) ** 2 + ((cols / x - 0.5) / 0.22) ** 2 < 1
    assert piece.mean() < 0.32
    air = np.random.default_rng(0).choice(grey[:4].ravel(), grey.shape)
    path = tmp_path / "piece.tif"
    tifffile.imwrite(path, np.where(piece, grey, air))
    passes("map", path, "--voxel-um", 4, "-o", tmp_path / "run")
    results = open_run(tmp_path / "run").results
    check = next(check for check in results.checks if check.name == "coverage")
    assert (check.state, check.value > 0.8) == ("pass", True), check
    assert 0.6 < results.layers[0].sheet.surfaces.empty_share < 0.75


NOT_REPEATED = {
    "all": [("save", "map_layer")],
    "measurement": [
        ("sheet", "read_sheet_volume"),
        ("sheet", "find_surfaces"),
        ("sheet", "measure_properties"),
    ],
    "search": [("sheet", "find_surfaces")],
    "nothing": [],
}
IN_CI = ("flatten.rest=chord", "measurement")
CHANGES = [
    ("registration.model=affine", "all"),
    IN_CI,
    ('properties.maps=["porosity", "roughness_top"]', "search"),
    ("sheet.surface.cutoff_um=450", "nothing"),
]


@pytest.mark.parametrize(
    ("change", "kept"),
    [
        pytest.param(*one, id=one[0], marks=pytest.mark.ci if one == IN_CI else pytest.mark.nightly)
        for one in CHANGES
    ],
)
def test_a_changed_parameter_repeats_what_depends_on_it(
    passes, linked_run, tmp_path, monkeypatch, change, kept
):
    """A run with a changed parameter has the bytes of a fresh one, whatever it takes from the old
    one."""
    edited = with_values(read_study(linked_run / "run.toml"), [change])
    study = tmp_path / "study"
    study.mkdir()
    write_study(edited, study, home=study, version="")
    passes("run", study, "-o", tmp_path / "fresh", codes=(0, 4))
    with monkeypatch.context() as patch:
        for module, name in NOT_REPEATED[kept]:
            patch.setattr(import_module(f"planish.run.{module}"), name, mapped)
        passes(
            "run", linked_run / "run.toml", "--set", change, "-o", tmp_path / "set", codes=(0, 4)
        )
    assert bytes_of(tmp_path / "set") == bytes_of(tmp_path / "fresh") != bytes_of(linked_run)


def test_changes_are_checked_and_named(refuses, specimen_files, tmp_path):
    study = study_of(specimen_files, {})
    write_study(study, tmp_path, home=tmp_path, version="")
    for changes, words in (
        (
            ["surface.cutoff=600", "registration.tolerance_um=-1"],
            ["surface.cutoff: unknown; did you mean cutoff_um?", "tolerance_um"],
        ),
        (
            ["bla=3", "surface.cutoff_um"],
            ["'bla=3': write SECTION.NAME=VALUE", "'surface.cutoff_um'"],
        ),
        (["image.surface.cutoff_um=3"], ["no layer of this study has it"]),
    ):
        options = [word for change in changes for word in ("--set", change)]
        refuses("run", tmp_path / "run.toml", *options, words=tuple(words), code=2)
    assert with_values(study, ["surface.seed_um=[1, 2, 3]"]).layers[0].surface.seed_um == (
        1.0,
        2.0,
        3.0,
    )
    assert with_values(study, ["volume.voxel_um="]).layers[0].volume.voxel_um is None
