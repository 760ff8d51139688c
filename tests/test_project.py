"""The project's own files agree with each other: version, locks, citation."""

import hashlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest
from benchmarks import report

import mutants
import planish

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BUILD = ["hatchling", "editables"]  # run.py installs this folder without build isolation


def read(name):
    return (ROOT / name).read_text(encoding="utf-8")


def locked(name):
    """Versions of each package in a lock."""
    versions = {}
    for package, version in re.findall(
        r"^([\w.-]+)==(\S+)", read(f"requirements/{name}"), flags=re.MULTILINE
    ):
        versions.setdefault(package, set()).add(version)
    return versions


def names(requirements):
    # Upper and lower case, and the signs between words, make no difference in the name of a
    # package.
    return {re.sub(r"[-_.]+", "-", re.split(r"[\[<>=]", r)[0]).lower() for r in requirements}


def test_locks_hold_everything_that_pyproject_names_in_the_same_versions():
    run = names([*PROJECT["dependencies"], *BUILD])
    assert run <= locked("run.lock").keys()
    docs = run | names(PROJECT["optional-dependencies"]["docs"])
    assert docs <= locked("docs.lock").keys()
    assert docs | names(PROJECT["optional-dependencies"]["dev"]) <= locked("dev.lock").keys()
    for smaller, larger in (("run.lock", "docs.lock"), ("docs.lock", "dev.lock")):
        versions = locked(larger)
        assert {package: versions.get(package) for package in locked(smaller)} == locked(smaller)
    assert f"\nversion: {planish.__version__}\n" in read("CITATION.cff")
    changes = read("CHANGELOG.md")
    assert f"\n## [{planish.__version__}]" in changes


def test_the_documents_are_built_without_the_tools_of_the_developers():
    """Few packages more than planish itself needs."""
    assert len(locked("docs.lock").keys() - locked("run.lock").keys()) <= 30
    assert (
        not {"pytest", "pyright", "playwright", "pyarrow", "simpleitk"} & locked("docs.lock").keys()
    )


def test_each_command_installs_its_lock_once(monkeypatch, tmp_path):
    """A lock holds those before it; a set-up notes what it installed, and a folder that was moved
    starts anew."""
    module = importlib.util.spec_from_file_location("run_of_planish", ROOT / "run.py")
    run = importlib.util.module_from_spec(module)
    module.loader.exec_module(run)
    installed = []
    monkeypatch.setattr(run, "STAMP", tmp_path / "stamp.json")
    for name in ("PYTHON", "PLANISH"):
        monkeypatch.setattr(run, name, Path(sys.executable))
    monkeypatch.setattr(run, "usable", lambda: True)
    monkeypatch.setattr(run, "make_venv", lambda: None)
    monkeypatch.setattr(run, "find_pip", list)
    monkeypatch.setattr(
        run, "install", lambda _pip, *options: installed.append(Path(options[-1]).name)
    )

    def of(lock_name):
        installed.clear()
        run.set_up(lock_name)
        return [name for name in installed if name.endswith(".lock")]

    assert of("docs.lock") == ["docs.lock"]
    assert (of("run.lock"), of("docs.lock")) == ([], [])
    assert of("dev.lock") == ["dev.lock"]
    assert (of("docs.lock"), of("dev.lock")) == ([], [])
    stamp = json.loads((tmp_path / "stamp.json").read_text(encoding="utf-8"))
    (tmp_path / "stamp.json").write_text(
        json.dumps(stamp | {"root": "elsewhere"}), encoding="utf-8"
    )
    assert of("run.lock") == ["run.lock"]
    assert of("dev.lock") == ["dev.lock"]  # the old folder's tools are not in the new one


def test_every_mutant_of_the_list_fits_the_code():
    assert mutants.main(["--list"]) == 0


@pytest.mark.parametrize("name", ["run.lock", "docs.lock", "dev.lock"])
def test_locks_hold_names_versions_and_hashes_only(name):
    line = re.compile(
        r"[\w.-]+==[\w.]+( ; [\w .<>='!()*]+)? \\|    --hash=sha256:[0-9a-f]{64}( \\)?"
    )
    assert [
        text for text in read(f"requirements/{name}").splitlines() if not line.fullmatch(text)
    ] == []


def test_the_report_takes_what_a_benchmark_prints():
    """A table where its part is one, else all; other parts stay."""
    page = "<!-- a 1 -->\n| x |\n|---|\n<!-- end -->\n\n<!-- b -->\n```\nold\n```\n<!-- end -->\n"
    printed = "\nseed 1\n| x |\n|---|\n| 2 |\n"
    assert report.renewed(page, "a 1", printed) == page.replace("|---|\n", "|---|\n| 2 |\n")
    assert report.renewed(page, "b", "\nnew\n") == page.replace("old", "new")
    parts = report.PARTS.findall(report.PAGE.read_text(encoding="utf-8"))
    names = {part[0].split()[0] for part in parts}
    assert names <= {path.stem for path in (ROOT / "benchmarks").iterdir()}
    assert len(parts) == 7
    assert report.main("none") == 1


@pytest.mark.ci
def test_a_benchmark_needs_the_libraries_of_no_other():
    program = (
        "import sys; sys.modules['playwright'] = None; import benchmarks.__main__ as b;"
        " b.main(['none'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert "There is no benchmark 'none'. Choose one of " in done.stderr
    for name in done.stderr.rstrip(".\n").partition("Choose one of ")[2].split(", "):
        folder = ROOT / "benchmarks"
        module = folder / f"{name}.py"
        text = (module if module.is_file() else folder / name / "__init__.py").read_text(
            encoding="utf-8"
        )
        assert re.search(r"^def main\(|import .*\bmain\b", text, re.MULTILINE), name


def build(folder, target, to):
    """Build the wheel or the source archive of a folder as run.py does."""
    command = [
        sys.executable,
        "-m",
        "hatchling",
        "build",
        "--target",
        target,
        "--directory",
        str(to),
    ]
    env = {k: v for k, v in os.environ.items() if k != "SOURCE_DATE_EPOCH"}
    subprocess.run(command, cwd=folder, env=env, check=True, capture_output=True)
    (made,) = to.glob("planish-*")
    return made


@pytest.mark.ci
def test_the_source_archive_holds_what_the_tests_read_and_builds_the_same_wheel(tmp_path):
    archive = build(ROOT, "sdist", tmp_path / "sdist")
    with tarfile.open(archive) as tar:
        tar.extractall(tmp_path / "unpacked", filter="data")
    unpacked = tmp_path / "unpacked" / archive.name.removesuffix(".tar.gz")
    if (ROOT / ".git").exists() and shutil.which("git"):
        listed = subprocess.run(
            ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
        ).stdout
        tracked = {name for name in listed.split("\0") if name and (ROOT / name).exists()}
        of_the_checkout = {name for name in tracked if name.startswith(".")}
        assert {
            name for name in tracked - of_the_checkout if not (unpacked / name).is_file()
        } == set()
    wheels = [build(ROOT, "wheel", tmp_path / "one"), build(unpacked, "wheel", tmp_path / "two")]
    assert len({hashlib.sha256(path.read_bytes()).hexdigest() for path in wheels}) == 1
    packed = set(zipfile.ZipFile(wheels[0]).namelist())
    package = ROOT / "src"
    data = {
        path.relative_to(package).as_posix()
        for path in (package / "planish").rglob("*")
        if path.is_file()
    }
    assert {name for name in data if "__pycache__" not in name} <= packed


@pytest.mark.nightly
def test_nothing_is_left_of_a_wheel_that_was_uninstalled(tmp_path):
    """Compiled kernels beside the program kept its folders alive, so that an empty planish could be
    imported."""
    venv.create(tmp_path / "venv", with_pip=False)
    (python,) = [p for p in (tmp_path / "venv").glob("*/python*") if p.stem == "python"]
    env = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "NUMBA_CACHE_DIR")}
    env |= {"XDG_CACHE_HOME": str(tmp_path / "cache"), "HOME": str(tmp_path)}

    def pip(*arguments):
        command = [sys.executable, "-m", "pip", "--python", str(python), *arguments]
        subprocess.run(command, check=True, capture_output=True, env=env)

    def run(program):
        return subprocess.run(
            [python, "-c", program],
            cwd=tmp_path,
            env=env,
            capture_output=True,
            text=True,
            check=False,
        )

    pip("install", "--no-deps", "--no-index", str(build(ROOT, "wheel", tmp_path / "wheel")))
    libraries = [p for p in sys.path if Path(p).name == "site-packages"]
    done = run(
        f"import sys; sys.path += {libraries}; import numpy as np; import"
        " planish.core._overview_kernels as kernels; kernels.halve_values(np.ones((4, 4)),"
        " np.ones((2, 2))); print(kernels.__file__)"
    )
    assert done.returncode == 0, done.stderr
    package = Path(done.stdout.strip()).parents[1]
    assert package.is_relative_to(tmp_path)
    assert [path.suffix for path in tmp_path.rglob("_overview_kernels.*.nb?")] != []
    pip("uninstall", "--yes", "planish")
    assert list(package.parent.glob("*planish*")) == []
    assert "No module named 'planish'" in run("import planish").stderr
