"""``planish doctor``, and ``planish`` alone."""

import getpass
import json
import re
import tomllib
from collections import namedtuple
from importlib import metadata
from pathlib import Path

import pytest

from planish import installation
from planish.installation import EXTRAS, check_installation

ROOT = Path(__file__).resolve().parents[2]
OF_DEVELOPERS = {"dev", "benchmark", "docs"}
Disk = namedtuple("Disk", "total used free")


@pytest.fixture(scope="module", autouse=True)
def loaded():
    """The first look loads every library and kernel, which is no test's own time."""
    return [*check_installation()]


def states(monkeypatch=None, requires=None):
    if monkeypatch is not None:
        monkeypatch.setattr(metadata, "requires", lambda _name: requires)
    return {check.name: check for check in check_installation()}


def test_planish_alone_names_three_things_to_do(planish):
    code, out, err = planish()
    assert (code, out) == (2, "")
    for command in ("demo", "info FILE", "new STUDY.toml VOLUME IMAGE", "run STUDY.toml"):
        assert f"planish {command}" in err
    assert len(err.splitlines()) < 12


def test_a_sound_installation_is_well(planish, monkeypatch):
    monkeypatch.setattr(
        metadata, "requires", lambda _name: ["numpy>=2.1", 'distributed>=2; extra == "cluster"']
    )
    code, out, err = planish("doctor")
    assert (code, err) == (0, "")
    assert out.endswith("All is well.\n")
    assert out.startswith("planish 0.")
    assert re.search(r"ok +libraries: numpy \d", out)
    assert re.search(r"ok +compile cache: \d+ of \d+ kernels are compiled and kept", out)
    assert re.search(r"ok +temporary folder: [\d.]+ GB are free", out)
    assert re.search(r"ok +extra cluster: installed \(distributed ", out)


def test_programs_get_the_same_checks(planish, loaded):
    code, out, _ = planish("doctor", "--json")
    found = json.loads(out)
    assert (code, found["well"]) == (0, True)
    assert [check["name"] for check in found["checks"]] == [check.name for check in loaded]


def test_it_names_no_folders_of_the_user(planish):
    _, out, _ = planish("doctor")
    assert str(Path.home()) not in out
    assert str(Path.cwd()) not in out
    assert f"/{getpass.getuser()}/" not in out


@pytest.mark.parametrize(
    ("requirement", "words"),
    [
        ("numpy>=99", r"numpy is \d\S+, needed is >=99"),
        ("no-such-library>=1", "no-such-library is missing"),
        ("pytest>=1", None),
    ],
)
def test_libraries_are_held_against_their_bounds(monkeypatch, requirement, words):
    found = states(monkeypatch, [requirement])["libraries"]
    assert found.state == ("pass" if words is None else "fail")
    assert words is None or re.search(words, found.sentence)
    assert words is None or "pip install" in found.advice


def test_a_library_that_does_not_load_is_named(monkeypatch):
    def broken(name):
        if name == "imagecodecs":
            raise ImportError(
                "DLL load failed while importing _shared: The specified module could not be found."
            )
        return real(name)

    real = installation.importlib.import_module
    monkeypatch.setattr(installation.importlib, "import_module", broken)
    found = states(monkeypatch, ["imagecodecs>=1"])["libraries"]
    assert found.state == "fail"
    assert "cannot be loaded (DLL load failed" in found.sentence


def test_extras_that_are_missing_or_too_old_are_named(monkeypatch):
    found = states(monkeypatch, ['no-such-library>=1; extra == "cluster"'])["extra cluster"]
    assert found.state == "pass"
    assert (
        found.sentence
        == f'not installed; pip install "planish[cluster]" gives it: {EXTRAS["cluster"]}.'
    )
    found = states(monkeypatch, ['numpy>=99; extra == "cluster"'])["extra cluster"]
    assert (found.state, found.advice) == ("look", 'Run: pip install --upgrade "numpy>=99"')


def test_every_extra_is_explained():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert EXTRAS.keys() == project["optional-dependencies"].keys() - OF_DEVELOPERS
    page = (ROOT / "docs" / "how-to" / "install.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE) == [*EXTRAS]


def test_what_is_short_is_said_and_the_exit_code_is_4(planish, monkeypatch):
    monkeypatch.setattr(
        installation.shutil, "disk_usage", lambda _path: Disk(10**10, 9 * 10**9, 10**9)
    )
    monkeypatch.setattr(installation, "default_memory_limit", lambda: 9 * 10**8)
    code, out, _ = planish("doctor")
    assert (code, out.splitlines()[-1]) == (4, "Not well: memory, temporary folder, this folder.")


def test_a_folder_that_cannot_be_written_is_a_problem(passes, monkeypatch):
    monkeypatch.setattr(installation, "_is_writable", lambda _folder: False)
    out, _ = passes("doctor", codes=(4,))
    assert "PROBLEM compile cache: " in out
    assert "NUMBA_CACHE_DIR" in out


def test_no_place_for_compiled_kernels_is_a_message(refuses, monkeypatch):
    """As in a container without a home: numba says so when it loads the first kernel."""

    def nowhere(*_given, **_options):
        raise RuntimeError("cannot cache function 'f': no locator available for file 'x.py'")

    monkeypatch.setattr(installation, "_kernels", nowhere)
    found = states()["compile cache"]
    assert (found.state, found.sentence) == ("fail", installation.NO_CACHE)
    monkeypatch.setattr("planish.io.describe", nowhere)
    refuses("info", "volume.tif", words="NUMBA_CACHE_DIR", out=False)


def test_a_report_is_one_file_without_folders(planish, monkeypatch, tmp_path):
    monkeypatch.setattr(installation.tempfile, "gettempdir", lambda: str(tmp_path))
    log = tmp_path / "planish-x.log"
    home = "/home/anna maria/scans"
    log.write_text(
        f'planish 0.3.0\n  File "{home}/lib/site-packages/x.py", line 3\n'
        f"ValueError: {home}/volume.tif and C:\\data\\image.tif are odd\n"
    )
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/srv/anna/cache")
    file = tmp_path / "report.txt"
    code, out, _ = planish("doctor", "--report", file)
    assert code == 0
    assert "Report faults to whoever runs this installation." in out
    text = file.read_text(encoding="utf-8")
    assert [line for line in text.splitlines() if line.startswith("# ")] == [
        "# Installation",
        "# Settings",
        "# Checks",
        "# Last fault",
    ]
    assert "NUMBA_CACHE_DIR=cache" in text
    assert re.search(r"^pass libraries: .*numpy \d", text, re.MULTILINE)
    assert re.search(r"^(commit|sources) [0-9a-f]{16}", text, re.MULTILINE)
    assert 'File "x.py", line 3\nValueError: volume.tif and image.tif are odd' in text
    assert "anna" not in text
    assert str(Path.home()) not in text
    assert planish("doctor", "--report", file)[0] == 3  # nothing is written over
