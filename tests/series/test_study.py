"""``planish study`` on real links: the bytes of single ones, whatever happens on the way."""

import os
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from folders import bytes_of

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def table(made_once, tmp_path_factory):
    """Three specimens that are whole and one that is cut off, in a folder with a blank and an
    umlaut in its name.

    The first is that of a shared run; the others lie beside the table. One file is not two
    specimens: other points.
    """
    home = tmp_path_factory.mktemp("series") / "Blätter 1"
    home.mkdir()
    small = made_once.small
    for file in (small.volume, small.image):
        shutil.copyfile(file, home / file.name)
    shutil.copyfile(small.volume, home / "cut.tif")
    os.truncate(home / "cut.tif", 100_000)
    table = home / "specimens.csv"
    rows = [
        "name,volume,image,paper,correlate.point_um",
        f"a ö,{small.volume},{small.image},A,",
        "b ö,volume.tif,image.tif,A,60",
        "c ö,volume.tif,image.tif,B,70",
        "cut ö,cut.tif,image.tif,B,",
    ]
    table.write_text("\n".join(rows), encoding="utf-8")
    return table


def command(table, out, *more):
    return [sys.executable, "-m", "planish", "study", str(table), "--out", str(out), *more]


def done(*given):
    return subprocess.run(command(*given), check=False, capture_output=True, text=True)


def files_of(folder):
    return {
        name: data for name, data in bytes_of(folder).items() if ".series" not in Path(name).parts
    }


@pytest.fixture(scope="module")
def whole(table):
    """The series done in one go, by two processes."""
    out = table.parent / "whole"
    found = done(table, out, "--jobs", "2")
    assert found.returncode == 4, found.stderr
    assert "4 specimens: 3 linked, 1 refused" in found.stderr
    assert "cut ö: refused: cut.tif is cut off" in found.stderr
    # Semaphores of workers, which Python reports where these are killed.
    assert "leaked" not in found.stderr
    return out


def test_runs_have_the_bytes_of_single_links(kinds, whole):
    single, of_series = files_of(kinds("upright")), files_of(whole / "runs" / "a ö")
    said = [found.pop("run.toml").decode().splitlines() for found in (single, of_series)]
    assert single == of_series
    # Paths are written as seen from the run.
    without_paths = [[line for line in lines if not line.startswith("path")] for lines in said]
    assert without_paths[0] == without_paths[1]
    assert files_of(whole).keys() >= {"report.html", "results.json", "specimens.csv", "values.csv"}


def test_what_is_done_is_kept_wherever_it_is_moved(table, whole, tmp_path):
    home = tmp_path / "moved"
    shutil.copytree(table.parent, home, ignore=shutil.ignore_patterns("killed"))
    runs = [name for name in files_of(home / "whole") if "runs/" in name]
    before = [(home / "whole" / name).stat().st_mtime_ns for name in runs]
    found = done(home / table.name, home / "whole")
    assert (found.returncode, found.stderr.count("linked, kept")) == (4, 3)
    assert before == [(home / "whole" / name).stat().st_mtime_ns for name in runs]
    assert files_of(whole) == files_of(home / "whole")


def test_a_dry_run_says_what_would_be_done_and_writes_nothing(table, whole, tmp_path):
    nothing_done = done(table, tmp_path / "new", "--dry-run")
    assert (nothing_done.returncode, list(tmp_path.iterdir())) == (0, [])
    assert "3 of 4 to do: about" in nothing_done.stdout
    assert "refused: cut.tif is cut off" in nothing_done.stdout
    before = files_of(whole)
    all_done = done(table, whole, "--dry-run")
    assert (all_done.returncode, all_done.stdout.count("kept")) == (0, 3)
    assert "0 of 4 to do: about 0 s" in all_done.stdout
    assert files_of(whole) == before


def interrupted(table, out):
    """Interrupt the series while its last specimen is linked; where that was done first, try
    again."""
    for _ in range(4):
        for name in ("b ö", "c ö"):
            shutil.rmtree(out / "runs" / name, ignore_errors=True)
        # A shell has jobs in the background ignore the signal, and their children would inherit
        # that.
        listens = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
        process = subprocess.Popen(
            command(table, out), stderr=subprocess.PIPE, text=True, preexec_fn=listens
        )
        # Python itself loses a signal that comes while modules are loaded.
        next(line for line in process.stderr if "b ö" in line)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
        has_ended_first = (out / "runs" / "c ö").exists()
        if not has_ended_first:
            break
    return process.returncode, said


def test_killed_and_interrupted_it_goes_on(table, whole):
    out = table.parent / "killed"
    process = subprocess.Popen(command(table, out), stderr=subprocess.DEVNULL)
    while not (out / "runs" / "a ö").exists():
        time.sleep(0.05)
    time.sleep(1.0)
    process.kill()
    process.wait()
    code, said = interrupted(table, out)
    assert code == 130
    assert "what is done is kept" in said
    assert "Traceback" not in said
    assert "leaked" not in said
    assert done(table, out).returncode == 4
    assert files_of(whole) == files_of(out)
