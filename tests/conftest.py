"""What all tests share: where measured data lie, and repeatable property tests."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

from planish.cli import main
from planish.pipeline import run_study
from planish.study import ImageSection, Study, VolumeSection
from planish.synthetic import (
    CameraParams,
    HoleParams,
    ScannerParams,
    SpecimenParams,
    Warp,
    make_specimen,
    write_instruments,
)

ROOT = Path(__file__).resolve().parents[1]

# The same cases on every run, and no time limit on a case: the first one compiles the kernels.
settings.register_profile("planish", derandomize=True, deadline=None)
settings.load_profile("planish")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test that asks for measured data as ``realdata``."""
    for item in items:
        if "shared_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.realdata)


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Return a function from the name of a data set to its folder; it skips the test where the data are absent."""
    folder = Path(os.environ.get("PLANISH_DATA") or ROOT.parent / "shared" / "data")

    def find(name: str) -> Path:
        path = folder / name
        if not path.exists():
            pytest.skip(f"measured data '{name}' not found; set PLANISH_DATA to the folder that holds it")
        return path

    return find


@pytest.fixture(scope="session")
def specimen():
    """A small specimen with its truth: 1.1 x 0.9 mm, five holes."""
    return make_specimen(
        SpecimenParams(
            size_um=(1300.0, 1000.0),
            holes=HoleParams(pattern="irregular", count=5),
            warp=Warp(slope=0.35, wavelength_um=1800.0),
            scanner=ScannerParams(voxel_um=4.0),
            camera=CameraParams(pixel_um=5.0, radial=0.0, stretch=0.0, shading=0.0, nuisance_sd=0.004),
            seed=5,
        )
    )


@pytest.fixture(scope="session")
def specimen_files(specimen, tmp_path_factory):
    """The same as files: paths of ``volume.tif`` and ``image.tif``."""
    files = write_instruments(specimen, tmp_path_factory.mktemp("specimen"))
    return files.volume, files.image


@pytest.fixture(scope="session")
def linked_run(specimen_files, tmp_path_factory):
    """Link the small specimen once; give its run folder."""
    out = tmp_path_factory.mktemp("linked") / "run"
    volume, image = specimen_files
    study = Study(volume=VolumeSection(path=str(volume)), image=ImageSection(path=str(image)))
    run_study(study, out)
    return out


@pytest.fixture
def planish(capsys):
    """Call the command line in-process: a function from arguments to (exit code, stdout, stderr)."""

    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as end:
            main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        return int(end.value.code or 0), out, err

    return call
