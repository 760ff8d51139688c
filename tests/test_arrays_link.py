"""Runs of arrays and of words: the same numbers as from files and sections."""

import numpy as np
import pytest
import tifffile

import planish as pl
from planish.core.errors import FileError, StudyError
from planish.run import SECTIONS, Compute, build, read_study, study_of

VOXEL_UM, PIXEL_UM = 4.0, 5.0  # of the small specimen


def same_groups(a, b):
    assert list(a.groups) == list(b.groups)
    for name, data in a.groups.items():
        for key, variable in data.variables.items():
            other = b.groups[name].variables[key]
            assert variable.dtype == other.dtype
            assert variable.values.tobytes() == other.values.tobytes(), f"{name}/{key}"


def test_a_link_of_arrays_has_the_bytes_of_the_link_of_the_files(specimen_files, linked_run, tmp_path):
    volume, image = (tifffile.imread(path) for path in specimen_files)
    arrays = pl.volume(volume, voxel_um=VOXEL_UM), pl.image(image, pixel_um=PIXEL_UM)
    run = pl.link(*arrays, out=tmp_path / "run")
    same_groups(pl.open_run(linked_run), pl.open_run(tmp_path / "run"))
    assert sorted(path.name for path in (tmp_path / "run-inputs").iterdir()) == ["image.tif", "sheet.zarr"]
    assert tifffile.imread(tmp_path / "run-inputs" / "image.tif").dtype == image.dtype
    study = read_study(tmp_path / "run" / "run.toml")  # which repeats it
    assert [layer.path for layer in study.layers] == [
        str(tmp_path / "run-inputs" / name) for name in ("sheet.zarr", "image.tif")
    ]
    assert run.passed == pl.open_run(linked_run).passed
    with pytest.raises(FileError, match="run exists already"):
        pl.link(*arrays, out=tmp_path / "run")
    (tmp_path / "run").rename(tmp_path / "away")
    with pytest.raises(FileError, match="run-inputs exists already"):
        pl.link(*arrays, out=tmp_path / "run")
    text = repr(run)
    assert len(text.splitlines()) <= 10
    for word in ("sheet: sheet.zarr", "image: image.tif", "r = ", "linked ", "pass"):
        assert word in text


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
    values = np.where(abs(y - 20 + 0 * z * x) < 6, 120.0, 20.0) + np.random.default_rng(3).normal(0, 6, (60, 40, 60))
    np.save(tmp_path / "v.npy", values.astype(np.float32))
    volume = pl.volume(np.load(tmp_path / "v.npy", mmap_mode="r"), voxel_um=5, through="y")
    run = pl.map_sheet(volume, rim_um=15, cutoff_um=100, threads=1)
    assert float(run.maps.thickness.mean()) == pytest.approx(55, abs=2.5)  # 11 voxels, half a voxel
    assert run.study.layers[0].surface.rim_um == 15
    assert sorted(path.name for path in tmp_path.iterdir()) == ["v.npy"]


def test_words_are_those_of_the_command_line_each_given_once():
    words = {"through": "y", "property": ["porosity"], "image_side": "bottom", "point_um": 50, "memory": "4GB",
             "labels": None, "label_air": [0], "hole_um": (80, 200)}  # fmt: skip
    sections, compute = build.sections_of(words, tuple(SECTIONS), None, call="pl.link")
    assert sections == {
        "volume": {"through": "y"}, "properties": {"maps": ["porosity"]}, "image": {"side": "bottom"},
        "correlate": {"point_um": 50}, "surface": {"labels": {"air": [0]}}, "holes": {"hole_um": (80, 200)},
    }  # fmt: skip
    assert compute.memory_bytes == 4 * 10**9
    from planish.cli.runs import link as command
    from planish.run.build import words_of

    own = {"out", "chain", "set", "figures", "strict", "json", "help"}
    flags = {flag[2:].replace("-", "_") for option in command.params for flag in option.opts if flag.startswith("--")}
    assert flags - own == {*words_of([*SECTIONS, "compute"])}
    for words, compute in (({"through": "y", "volume": {"through": "x"}}, None), ({"threads": 2}, Compute(threads=1))):
        with pytest.raises(StudyError, match="is given twice, by itself and in"):
            build.sections_of(words, tuple(SECTIONS), compute, call="pl.link")
    _, both = build.sections_of({"memory": "4GB"}, tuple(SECTIONS), Compute(threads=1), call="pl.link")
    assert both == Compute(threads=1, memory_bytes=4 * 10**9)
