"""Volumes that are a part of a file, ``scan.h5:/entry/data``, in a folder with a colon: wherever a
path is source."""

import json
import os
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
import xarray as xr
import zarr

from folders import refused
from planish.core.errors import FileError, StudyError
from planish.exports import run_contents
from planish.io import (
    VolumeParams,
    find_place,
    fingerprint,
    read_tree,
    refuse_inside,
    write_store,
    write_tree,
)
from planish.measure import surfaces_of
from planish.run import GivenLayer, Study, open_run, read_study, silent, study_of, write_study
from planish.series import read_plan

PART = "/entry/a"
FOLDER = "scan 1" if os.name == "nt" else "scan: 1"  # no name holds a colon on Windows


def in_hdf5(folder, values):
    """A volume as a part of a file in a folder with a colon, beside another part."""
    path = folder / FOLDER / "scan.h5"
    path.parent.mkdir()
    with h5py.File(path, "w") as file:
        file[PART] = values
        file["/entry/b"] = values[:2]
    return f"{path}:{PART}"


@pytest.fixture(scope="module")
def volume(specimen_files, tmp_path_factory):
    """The volume of the small specimen as a part."""
    return in_hdf5(tmp_path_factory.mktemp("parts"), tifffile.imread(specimen_files[0]))


def test_name_stem_and_slashes_of_a_place(monkeypatch):
    place = find_place("C:/scan: 1/scan.h5:/entry/a")
    assert (place.name, place.stem) == ("scan.h5:/entry/a", "scan-entry-a")
    assert (find_place("v.ome.tif").name, find_place("v.ome.tif").stem) == ("v.ome.tif", "v.ome")
    # There, a path turns the slashes of the part round; names within HDF5 and Zarr have slashes.
    monkeypatch.setattr(os, "sep", "\\")
    assert find_place("C:\\scans\\scan.h5:\\entry\\a").part == PART


def test_measure_finds_the_part_that_the_surfaces_are_of(planish, linked_run, volume, tmp_path):
    surfaces = surfaces_of(read_tree(linked_run / "maps.zarr")["surfaces"])
    for path, wanted in ((volume, 0), (volume.replace("scan.h5", "gone.h5"), 3)):
        store = tmp_path / f"{wanted}.zarr"
        noted = VolumeParams(path=path, voxel_um=(4.0, 4.0, 4.0)).model_dump_json(exclude_none=True)
        write_tree(store, {"surfaces": surfaces.assign_attrs(volume=noted)})
        code, _, err = planish("measure", store, "-o", tmp_path / f"{wanted}-measured.zarr")
        assert code == wanted, err
    assert "gone.h5:/entry/a, is not there any more" in err


def test_an_export_finds_the_part_that_was_mapped(linked_run, volume, tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    results = json.loads((linked_run / "results.json").read_text(encoding="utf-8"))
    results["layers"][0]["source"]["sha256"] = fingerprint(volume)
    (run / "results.json").write_text(json.dumps(results), encoding="utf-8")
    shutil.copytree(linked_run / "maps.zarr" / "surfaces", run / "maps.zarr" / "surfaces")
    shutil.copy(linked_run / "maps.zarr" / "zarr.json", run / "maps.zarr")
    study = read_study(linked_run / "run.toml")
    for path, words in (
        (volume, ""),
        (f"{volume[:-1]}b", "is another file"),
        (f"{tmp_path}/a:b/v.h5:/a", "a:b/v.h5"),
    ):
        first = study.layers[0].model_copy(update={"volume": VolumeParams(path=path)})
        write_study(
            study.model_copy(update={"layers": (first, *study.layers[1:])}),
            run,
            home=run,
            version="1",
        )
        opened = open_run(run)
        if not words:
            assert run_contents.volume_params(opened, opened.results.layers[0], silent).path == path
            continue
        refused(
            FileError, words, run_contents.volume_params, opened, opened.results.layers[0], silent
        )


def test_a_study_keeps_the_part_beside_a_relative_path(volume, tmp_path):
    study = Study(layers=(GivenLayer(name="sheet", volume=VolumeParams(path=volume)),))
    home = Path(volume.partition(":/entry")[0]).parents[1] / "run"
    write_study(study, tmp_path, home=home, version="1")
    assert f'path = "../{FOLDER}/scan.h5:/entry/a"' in (tmp_path / "run.toml").read_text(
        encoding="utf-8"
    )
    home.mkdir()
    shutil.copy(tmp_path / "run.toml", home)
    assert read_study(home / "run.toml") == study


def test_layers_are_named_after_file_and_part(tmp_path):
    values = np.arange(504, dtype=np.uint8).reshape(9, 8, 7)
    part = in_hdf5(tmp_path, values)
    other = tmp_path / "a=b.h5"
    shutil.copy(part.removesuffix(f":{PART}"), other)
    tifffile.imwrite(tmp_path / "i.tif", values[0])

    def names(*layers):
        return [layer.name for layer in study_of((*layers, str(tmp_path / "i.tif")), {}).layers]

    # Two files with the same part: the part alone names neither.
    assert names(part, f"{other}:{PART}") == ["scan-entry-a", "a-b-entry-a", "i"]
    assert names(part, f"{part[:-1]}b") == ["scan-entry-a", "scan-entry-b", "i"]
    assert names(f"ct={part}", f"{other}:{PART}")[0] == "ct"
    refused(
        StudyError,
        "'häh' is no name of a layer",
        study_of,
        (f"häh={part}", str(tmp_path / "i.tif")),
        {},
    )


def test_specimens_are_named_after_file_and_part_and_a_sign_of_equality_names_no_layer(
    tmp_path, monkeypatch
):
    (tmp_path / "t.csv").write_text(
        "volume,sheet\none.h5:/entry/a,1\ntwo.h5:/entry/a,1\n", encoding="utf-8"
    )
    assert [one.name for one in read_plan(tmp_path / "t.csv").specimens] == [
        "one-entry-a",
        "two-entry-a",
    ]
    monkeypatch.chdir(tmp_path)
    with h5py.File("a=b.h5", "w") as file:
        file[PART] = np.zeros((9, 8, 7), np.uint8)
    study = study_of(("a=b.h5:/entry/a",), {})
    assert study.layers[0].path == str(tmp_path / "a=b.h5:/entry/a")
    (tmp_path / "t.csv").write_text("volume,sheet\na=b.h5:/entry/a,1\n", encoding="utf-8")
    assert read_plan(tmp_path / "t.csv").specimens[0].files == (str(tmp_path / "a=b.h5:/entry/a"),)


def test_parts_of_a_store_have_hashes_of_their_own_and_nothing_is_written_into_it(tmp_path):
    values = xr.DataArray(
        np.arange(504, dtype=np.uint8).reshape(9, 8, 7),
        dims=("z", "y", "x"),
        attrs={"voxel_um": [1.0] * 3},
    )
    write_store(values, tmp_path / "s.zarr")
    hashes = {
        fingerprint(tmp_path / "s.zarr"),
        *(fingerprint(f"{tmp_path}/s.zarr:{part}") for part in ("/0", "/1")),
    }
    assert len(hashes) == 3
    store = tmp_path / "scan.zarr"
    zarr.create_group(store)
    refused(
        FileError,
        "which is read; nothing is written there",
        refuse_inside,
        store / "run",
        [f"{store}:/0"],
    )
