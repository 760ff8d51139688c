"""Every command of the tutorial and of the how-to pages runs as it stands and prints what the page
shows."""

import os
import re
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

import console

ROOT = Path(__file__).resolve().parents[2]
DOCS, README = ROOT / "docs", ROOT / "README.md"
# Pages without such blocks speak of what a test cannot do here: another system, an installation.
PAGES = sorted(
    path
    for path in (DOCS / "how-to").glob("*.md")
    if console.steps(path.read_text(encoding="utf-8"))
)


@pytest.fixture(scope="module")
def after_tutorial(tmp_path_factory):
    """The folder in which the tutorial was carried out, and what went otherwise than it says."""
    folder = tmp_path_factory.mktemp("tutorial")
    page = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    return folder, console.report(console.run(page, folder))


@pytest.mark.ci
def test_the_tutorial_prints_what_it_shows(after_tutorial):
    folder, faults = after_tutorial
    assert not faults, faults
    assert (folder / "run" / "report.html").exists()


@pytest.mark.nightly
@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_page_prints_what_it_shows(path, after_tutorial, tmp_path):
    page = path.read_text(encoding="utf-8")
    if unknown := console.unknown_verbs(page):
        pytest.skip(f"this planish has no command {', '.join(sorted(unknown))}")
    shutil.copytree(after_tutorial[0], tmp_path, dirs_exist_ok=True, copy_function=os.link)
    outcomes = console.run(page, tmp_path)
    assert not (faults := console.report(outcomes)), faults
    if over := {outcome.passed_over for outcome in outcomes if outcome.passed_over}:
        pytest.skip(f"the rest fits; {', '.join(sorted(over))}")


@pytest.mark.ci
def test_the_readme_reads_a_run_as_it_shows(kinds, tmp_path, monkeypatch):
    """Its commands and options are checked with those of all pages; here its Python runs in the
    folder of a run."""
    (block,) = re.findall(
        r"^```python\n(.*?)^```$", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    shutil.copytree(kinds("upright"), tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    plt.switch_backend("agg")
    names = {}
    exec(compile(block, str(README), "exec"), names)
    plt.close("all")
    assert names["run"].linked.coating_top.where(names["run"].linked.valid).notnull().any()


def test_pages_are_short():
    assert len(PAGES) >= 12
    lines = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in PAGES}
    assert [name for name, count in lines.items() if count > 75] == [], (
        "longer than a screen or two"
    )


def test_the_first_lines_of_windows_stand_where_a_newcomer_begins():
    for page in (README, DOCS / "how-to" / "windows.md"):
        text = page.read_text(encoding="utf-8")
        assert "\npy run.py demo\n" in text
        assert "Set-ExecutionPolicy -Scope Process" in text
        assert ".venv\\Scripts\\activate" in text


# --- the runner itself ----------------------------------------------------------------------------
def test_a_page_is_read_as_commands_python_and_files():
    page = (
        "```console\n$ planish info \\\nx.tif\none\n...\n$ ls\n```\n```text a.csv\nx,y\n```\n"
        "```pycon\n>>> 1 + 1\n2\n```\n```python\nnot run\n```\n"
    )
    found = console.steps(page)
    assert [(step.kind, step.verb, step.name) for step in found] == [
        ("console", "info", ""),
        ("console", "", ""),
        ("file", "", "a.csv"),
        ("pycon", "", ""),
    ]
    assert found[0].expected == "one\n...\n"
    assert console.unknown_verbs("```console\n$ planish fly x\n$ planish info y\n```\n") == {"fly"}


@pytest.mark.parametrize(
    ("printed", "expected", "same"),
    [
        ("a 1 b\n", "a ... b\n", True),
        ("a\nx\ny\nb\n", "a\n...\nb\n", True),
        ("a\nb\n", "a\n...\nb\n", True),
        ("a  \nb\n", "a\nb\n", True),
        ("", "", True),
        ("a\n", "", False),
        ("a\nb\n", "a\n", False),
        ("a 1 c\n", "a ... b\n", False),
        ("a\n1 b\n", "a ... b\n", False),
    ],
)
def test_output_is_compared_with_gaps(printed, expected, same):
    assert console.fits(printed, expected) is same


def test_commands_that_go_wrong_are_named(tmp_path):
    page = (
        "```console\n$ planish --version\nplanish, version 7\n$ no-such-program"
        " x\n```\n```pycon\n>>> 1 + 1\n3\n```\n```console\n$ planish info"
        " nothing.tif\n...\nplanish: ... does not exist. ...\n```\n"
    )
    outcomes = console.run(page, tmp_path)
    assert [bool(outcome.faults) for outcome in outcomes] == [True, False, True, False]
    assert (outcomes[1].passed_over, outcomes[3].code) == ("no-such-program is not installed", 3)
    assert "planish, version 0" in console.report(outcomes)
