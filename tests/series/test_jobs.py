"""What is remembered of a series: kept, refused, tried again; never over a run that is there."""

import os
from pathlib import Path

import numpy as np
import pytest
import tifffile

from formats_written import CUBE, NAME, write_hdf5, write_meta, write_nrrd, write_raw, write_zarr
from planish.cli import series
from planish.run import Compute
from planish.series import Plan, PlannedSpecimen, SeriesState, jobs
from planish.series_results import Member

COMPUTE = Compute()


@pytest.fixture
def specimen(tmp_path):
    tifffile.imwrite(
        tmp_path / "v.tif", np.arange(504, dtype=np.uint8).reshape(9, 8, 7), imagej=True
    )
    tifffile.imwrite(tmp_path / "i.tif", np.zeros((8, 7), np.uint8))
    return PlannedSpecimen(name="A 1", files=(str(tmp_path / "v.tif"), str(tmp_path / "i.tif")))


def book(folder, *specimens, changes=()):
    home = folder / "out"
    home.mkdir(exist_ok=True)
    return SeriesState(home, Plan(specimens=specimens, home=folder, changes=changes))


def closed(one, specimen, state, message):
    job = opened(one, specimen)
    return one.close(
        specimen,
        job,
        job.note.model_copy(update={"state": state, "message": message, "seconds": 1.0}),
    )


def opened(one, specimen):
    job = one.open(specimen, COMPUTE)
    assert isinstance(job, jobs.Job)
    return job


def test_refused_jobs_wait_for_a_change_but_not_those_without_memory(tmp_path, specimen):
    one = book(tmp_path, specimen)
    closed(one, specimen, "damaged", "memory")
    opened(book(tmp_path, specimen), specimen)
    refused = closed(one, specimen, "refused", "no hole")
    assert (refused.state, refused.message, refused.run) == ("refused", "no hole", None)
    assert book(tmp_path, specimen).open(specimen, COMPUTE) == refused
    opened(book(tmp_path, specimen, changes=("correlate.point_um=50",)), specimen)
    tifffile.imwrite(tmp_path / "i.tif", np.ones((8, 7), np.uint8))
    opened(book(tmp_path, specimen), specimen)


def test_same_bytes_are_the_same_whatever_their_date(tmp_path, specimen):
    one = book(tmp_path, specimen)
    closed(one, specimen, "refused", "no hole")
    os.utime(tmp_path / "i.tif", (1e9, 1e9))
    assert isinstance(book(tmp_path, specimen).open(specimen, COMPUTE), Member)


def in_parts_or_two_files(folder, kind):
    """A volume that is a part of a file, or a header with its values in another file; and the file
    of the values."""
    values = np.arange(576, dtype=np.uint16).reshape(9, 8, 8)
    if kind == "h5":
        path = write_hdf5(folder, values, CUBE)
        return path, Path(path.partition(":/entry")[0])
    if kind == "zarr":
        store = write_zarr(folder, values, CUBE, 2)
        return f"{store}:/0", next(
            file for file in (store / "0").rglob("*") if file.is_file() and file.suffix == ""
        )
    if kind == "toml":
        data = write_raw(folder, values, CUBE)
        return f"{data}.toml", data
    if kind == "mhd":
        return str(write_meta(folder, values, CUBE, ".mhd", False)), folder / f"{NAME}.raw"
    return str(write_nrrd(folder, values, CUBE, ".nhdr", "raw")), folder / f"{NAME}.raw"


@pytest.mark.parametrize("kind", ["h5", "zarr", "toml", "mhd", "nhdr"])
def test_a_volume_whose_values_changed_is_done_again(tmp_path, kind):
    """The file that changed has as many bytes as before and an older date than the header: a copy
    that was put back."""
    path, data = in_parts_or_two_files(tmp_path, kind)
    one, specimen = book(tmp_path), PlannedSpecimen(name="A", files=(path,))
    closed(one, specimen, "refused", "no sheet")
    assert isinstance(one.open(specimen, COMPUTE), Member)
    changed = bytearray(data.read_bytes())
    changed[-1] ^= 1
    data.write_bytes(changed)
    os.utime(data, (1e9, 1e9))
    opened(one, specimen)


def test_a_folder_that_is_there_is_left_alone(tmp_path, specimen):
    other = PlannedSpecimen(name="A 1-2", files=specimen.files, changes=("correlate.point_um=50",))
    one = book(tmp_path, specimen, other)
    foreign = one.home / "runs" / "A 1"
    foreign.mkdir(parents=True)
    assert opened(one, specimen).folder.name == "A 1-3"  # A 1-2 belongs to the other specimen
    assert opened(one, other).folder.name == "A 1-2"


def test_a_missing_file_concerns_its_specimen(tmp_path, specimen):
    gone = PlannedSpecimen(name="B", files=(str(tmp_path / "gone.tif"),))
    found = jobs.do(opened(book(tmp_path, specimen, gone), gone))
    assert found.state == "refused"
    assert "gone.tif" in found.message


def test_a_job_never_raises(tmp_path, specimen, monkeypatch):
    job = opened(book(tmp_path, specimen), specimen)
    assert jobs.do(job).state == "refused"  # eight pixels are no sheet
    for error, words in (
        (MemoryError(), "memory"),
        (ZeroDivisionError("x"), "fault in planish: ZeroDivisionError"),
    ):

        def fails(*_, error=error, **__):
            raise error

        monkeypatch.setattr("planish.series.jobs.run_study", fails)
        found = jobs.do(job)
        assert found.state == "damaged"
        assert words in found.message


@pytest.mark.parametrize(
    ("states", "code"),
    [
        (["whole", "whole"], 0),
        (["whole", "refused"], 4),
        (["refused", "damaged"], 3),
        (["withheld"], 4),
        (["withheld", "whole"], 4),
        ([], 3),
    ],
)
def test_exit_codes(states, code):
    assert (
        series.code_of([Member(name=str(k), state=state) for k, state in enumerate(states)]) == code
    )
