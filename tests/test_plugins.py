"""Packages of others: the one that ``docs/how-to/your-own.md`` shows, broken ones, and two with one
name."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import console
from planish import installation
from planish.core import plugins
from planish.core.errors import CannotMeasure, InputError
from planish.core.source_hash import find_commit, hash_sources
from planish.io import read_volume
from planish.io.formats import find_place, format_of
from planish.measure import find_property, property_names
from planish.results import Results
from planish.run import open_run

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/how-to/your-own.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(.*?)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
COMMANDS = dict(BLOCKS)[""].splitlines()


def written(folder, name="planish-lab"):
    """The two files of the page in a folder of the package's name."""
    (folder / name).mkdir()
    for step in console.steps(PAGE):
        (folder / name / step.name).write_text(step.text, encoding="utf-8")
    return folder / name


def call(words, folder, site):
    """Run a command of planish in a folder, with what is installed in ``site``."""
    path = os.pathsep.join([str(site), str(ROOT / "src")])
    return subprocess.run(
        [sys.executable, "-m", "planish", *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.ci
def test_the_package_of_the_page_is_installed_linked_repeated_exported_and_shown(
    tmp_path, specimen_files
):
    written(tmp_path)
    site = tmp_path / "site"
    install, *commands = COMMANDS
    offline = ["--no-deps", "--no-build-isolation", "--no-index", "--target", str(site)]
    pip = [sys.executable, "-m", *install.split(), *offline]
    done = subprocess.run(pip, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    volume, image = specimen_files
    np.save(tmp_path / "volume.npy", read_volume(volume).values)
    shutil.copy(image, tmp_path / "image.tif")
    for command in commands:
        done = call(command.split()[1:], tmp_path, site)
        assert done.returncode == 0, done.stderr

    run = open_run(tmp_path / "run")
    surfaces = run.groups["surfaces"]
    thickness = surfaces["thickness"].values.astype(np.float64)
    expected = thickness / np.nanmean(thickness)
    np.testing.assert_allclose(surfaces["relative_thickness"].values, expected, rtol=1e-5)
    assert run.results.versions["planish-lab"] == "0.1"
    assert run.study.packages == {"planish-lab": "0.1"}
    assert (run.results.commit, run.results.code) == (find_commit(), hash_sources())
    page = (tmp_path / "run/report.html").read_text(encoding="utf-8")
    assert "Thickness over its mean" in page
    assert "planish-lab" in page
    again = Results.read(tmp_path / "again/results.json")
    assert again.correlations == run.results.correlations
    columns = np.loadtxt(tmp_path / "relative.xyz")
    values = run.linked["relative_thickness"].values
    np.testing.assert_allclose(columns[:, 2], values.ravel(), rtol=1e-5)
    np.testing.assert_allclose(columns[1, :2], [run.linked.x[1], run.linked.y[0]], rtol=1e-5)
    listed = call(["properties"], tmp_path, site)
    assert "relative_thickness" in listed.stdout
    assert "planish-lab 0.1" in listed.stdout
    assert "packages: planish-lab 0.1" in call(["doctor"], tmp_path, site).stdout

    # Without the package the run is shown, and not repeated.
    missing = tmp_path / "nothing"
    done = call(["run", "run/run.toml", "--out", "third"], tmp_path, missing)
    assert (done.returncode, (tmp_path / "third").exists()) == (3, False)
    assert "the package planish-lab 0.1, which is not installed" in done.stderr.replace("\n", " ")
    assert call(["info", "run"], tmp_path, missing).returncode == 0


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Return a function that installs a package as pip leaves it: a module and its entry points."""

    def install(name, text, entries):
        information = tmp_path / f"{name.replace('-', '_')}-2.0.dist-info"
        information.mkdir()
        (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 2.0")
        (information / "entry_points.txt").write_text(entries)
        (tmp_path / f"{name.replace('-', '_')}.py").write_text(text)
        plugins.plugins.cache_clear()

    monkeypatch.syspath_prepend(tmp_path)
    yield install
    plugins.plugins.cache_clear()


def test_a_broken_package_is_named_where_it_is_used_and_nowhere_else(installed, planish, tmp_path):
    entries = "[planish.properties]\nskin = bad_one\n[planish.formats]\nskn = bad_one:load\n"
    installed("bad-one", "raise RuntimeError('no licence')", entries)
    assert "skin" in property_names()
    assert "bad_one" not in sys.modules
    fault = r"'skin' of the package bad-one 2\.0 \(module bad_one\) fails with RuntimeError: no lic"
    with pytest.raises(InputError, match=fault):
        find_property("skin")
    (tmp_path / "volume.skn").write_bytes(b"nothing")
    code, _, err = planish("info", tmp_path / "volume.skn")
    assert code == 3
    assert "The format 'skn' of the package bad-one 2.0 (module bad_one) fails" in err
    assert planish("--help")[0] == 0
    code, out, _ = planish("properties")
    assert code == 0
    assert "no licence" in out
    assert "porosity" in out
    check = installation._packages()
    assert (check.name, check.state) == ("packages", "look")
    assert check.sentence == "bad-one 2.0 (property skin), bad-one 2.0 (format skn)."
    assert "no licence" in check.advice


def test_a_function_that_fails_is_the_packages_fault(installed, tmp_path):
    text = "def load(place, channel, memory_bytes):\n    return 1 / 0\n"
    installed("zero-one", text, "[planish.formats]\nzro = zero_one:load\n")
    (tmp_path / "volume.zro").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"package zero-one 2\.0 .* fails with ZeroDivisionError"):
        read_volume(tmp_path / "volume.zro")


def test_names_that_are_taken_are_refused_with_both_owners(installed):
    text = """
from planish.measure import sheet_property

@sheet_property("NAME", units="1", long_name="Mine")
def mine(sheet):
    return sheet.frame.top
"""
    entry = "[planish.properties]\nNAME = MODULE:mine\n[planish.formats]\ntif = MODULE:mine\n"
    for name in ("first-lab", "second-lab"):
        module = name.replace("-", "_")
        entries = entry.replace("NAME", "gloss").replace("MODULE", module)
        installed(name, text.replace("NAME", "gloss"), entries)
    with pytest.raises(
        InputError, match=r"packages first-lab 2\.0 and second-lab 2\.0\. Uninstall"
    ):
        find_property("gloss")
    assert format_of(find_place("volume.tif")).plugin is None
    installed(
        "third-lab",
        text.replace("NAME", "thickness_envelope"),
        "[planish.properties]\nouter = third_lab:mine\n",
    )
    with pytest.raises(
        CannotMeasure, match=r"planish\.measure\.lengths; third_lab gives it as well"
    ):
        find_property("outer")
    advice = installation._packages().advice
    assert "packages first-lab 2.0 and second-lab 2.0. Uninstall" in advice
    assert "The format 'tif' of the package first-lab 2.0 is not used: planish has" in advice


def test_doctor_says_where_an_entry_is_of_the_wrong_kind(installed):
    entries = "[planish.properties]\nskin = odd_one:skin\n[planish.exports]\nodd = odd_one:skin\n"
    installed("odd-one", "def skin(sheet):\n    return 1.0\n", entries)
    advice = installation._packages().advice
    assert (
        "The property 'skin' of the package odd-one 2.0 is function, needed is Property." in advice
    )
    assert (
        "The export 'odd' of the package odd-one 2.0 is function, needed is ExportFormat" in advice
    )


def test_the_page_names_what_the_package_has():
    text = next(step.text for step in console.steps(PAGE) if step.name == "pyproject.toml")
    groups = tomllib.loads(text)["project"]["entry-points"]
    assert set(groups) == set(plugins.GROUPS.values())
