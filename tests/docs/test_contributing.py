"""The changes that CONTRIBUTING.md shows: they fit, and do what is said of them."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TESTS = Path(__file__).with_name("nine_changes.py")
SECTIONS = re.findall(
    r"^### ([^\n]*)\n(?:(?!^###? ).)*?^```diff\n(.*?)^```",
    (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
    re.DOTALL | re.MULTILINE,
)


def files_of(diff):
    """Return the name of each file of a diff, and its hunks as text before and after."""
    parts = re.findall(r"^\+\+\+ b/(\S+)\n(.*?)(?=^--- |\Z)", diff, re.DOTALL | re.MULTILINE)
    for name, text in parts:
        hunks = re.split(r"^@@.*@@.*\n", text, flags=re.MULTILINE)[1:]
        yield name, [(_side(hunk, "+"), _side(hunk, "-")) for hunk in hunks]


def _side(hunk, other_sign):
    """Return the lines of a hunk but for those with a sign."""
    lines = hunk.splitlines(keepends=True)
    return "".join(line[1:] for line in lines if not line.startswith(other_sign))


def test_the_changes_still_fit():
    assert len(SECTIONS) == 9
    for _, diff in SECTIONS:
        files = dict(files_of(diff))
        packages = {name.split("/")[2] for name in files}
        assert len(files) <= 2 * len(packages) <= 4, "two files at most, and two for its sentence"
        for name, hunks in files.items():
            for before, after in hunks:
                if before:
                    text = (ROOT / name).read_text(encoding="utf-8")
                    assert before in text, f"{name}: write this diff anew"
                else:
                    compile(after, name, "exec")
                    assert not (ROOT / name).exists()


@pytest.mark.ci
def test_each_change_is_there_for_a_user(tmp_path):
    names = re.findall(r"^def test_(\w+)", TESTS.read_text(encoding="utf-8"), re.MULTILINE)
    assert names == [title.lower().replace(" ", "_") for title, _ in SECTIONS]
    source = tmp_path / "src"
    shutil.copytree(ROOT / "src", source, ignore=shutil.ignore_patterns("__pycache__"))
    for _, diff in SECTIONS:
        for name, hunks in files_of(diff):
            file = tmp_path / name
            text = file.read_text(encoding="utf-8") if file.exists() else ""
            for before, after in hunks:
                text = text.replace(before, after, 1) if before else after
            file.write_text(text, encoding="utf-8")
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
    environment["PYTHONPATH"] = str(source)
    command = [sys.executable, "-m", "pytest", str(TESTS), "--all", "-q", "-n", "0"]
    options = ["-p", "no:cacheprovider", "--basetemp", str(tmp_path / "tests")]
    done = subprocess.run(
        [*command, *options], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr
    assert f"{len(names)} passed" in done.stdout
