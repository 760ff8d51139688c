"""``planish study`` on real links: the bytes of single ones, whatever happens on the way."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from folders import bytes_of
from planish.run import link

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def table(specimen_files: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three specimens that are whole and one that is cut off, in a folder with a blank and an umlaut in its name."""
    home = tmp_path_factory.mktemp("series") / "Blätter 1"
    home.mkdir()
    for name in ("a", "b", "c", "cut"):
        (home / name).mkdir()
        for file in specimen_files:
            shutil.copyfile(file, home / name / file.name)
    os.truncate(home / "cut" / "volume.tif", 100_000)
    rows = [
        f"{name} ö,{name}/volume.tif,{name}/image.tif,{paper}"
        for name, paper in zip(("a", "b", "c", "cut"), "AABB", strict=True)
    ]
    table = home / "specimens.csv"
    # One file is not two specimens: other points of two of them.
    options = ["", "60", "70", ""]
    lines = [f"{row},{point}" for row, point in zip(rows, options, strict=True)]
    table.write_text("\n".join(["name,volume,image,paper,correlate.point_um", *lines]) + "\n", encoding="utf-8")
    return table


def command(table: Path, out: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "planish", "study", str(table), "--out", str(out), *more]


def files_of(folder: Path) -> dict[str, bytes]:
    return {name: data for name, data in bytes_of(folder).items() if ".series" not in Path(name).parts}


@pytest.fixture(scope="module")
def whole(table: Path) -> Path:
    """The series done in one go, by two processes."""
    out = table.parent / "whole"
    done = subprocess.run(command(table, out, "--jobs", "2"), check=False, capture_output=True, text=True)
    assert done.returncode == 4, done.stderr
    assert "4 specimens: 3 linked, 1 refused" in done.stderr
    assert "cut ö: refused: volume.tif is cut off" in done.stderr
    assert "leaked" not in done.stderr  # semaphores of workers, which Python reports where these are killed
    return out


def test_runs_have_the_bytes_of_single_links(table: Path, whole: Path) -> None:
    single = table.parent / "single" / "runs" / "a ö"
    link(table.parent / "a" / "volume.tif", table.parent / "a" / "image.tif", out=single)
    assert files_of(single) == files_of(whole / "runs" / "a ö")
    assert files_of(whole).keys() >= {"report.html", "results.json", "specimens.csv", "values.csv"}


def test_what_is_done_is_kept_wherever_it_is_moved(table: Path, whole: Path, tmp_path: Path) -> None:
    home = tmp_path / "moved"
    shutil.copytree(table.parent, home, ignore=shutil.ignore_patterns("killed", "single"))
    before = {name: (home / "whole" / name).stat().st_mtime_ns for name in files_of(home / "whole") if "runs/" in name}
    done = subprocess.run(command(home / table.name, home / "whole"), check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("linked, kept")) == (4, 3)
    assert before == {name: (home / "whole" / name).stat().st_mtime_ns for name in before}
    assert files_of(whole) == files_of(home / "whole")


def test_killed_and_interrupted_it_goes_on(table: Path, whole: Path) -> None:
    out = table.parent / "killed"
    process = subprocess.Popen(command(table, out), stderr=subprocess.DEVNULL)
    while not (out / "runs" / "a ö").exists():
        time.sleep(0.05)
    time.sleep(1.0)
    process.kill()
    process.wait()
    process = subprocess.Popen(command(table, out), stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    # Python itself loses a signal that comes while modules are loaded.
    next(line for line in process.stderr if "b ö" in line)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "what is done is kept" in said
    assert "Traceback" not in said
    assert "leaked" not in said
    assert subprocess.run(command(table, out), check=False, capture_output=True).returncode == 4
    assert files_of(whole) == files_of(out)


def test_two_at_once_and_foreign_folders_are_refused(table: Path, tmp_path: Path) -> None:
    (tmp_path / "foreign").mkdir()
    done = subprocess.run(command(table, tmp_path / "foreign"), check=False, capture_output=True, text=True)
    assert done.returncode == 3
    assert "exists already" in done.stderr
