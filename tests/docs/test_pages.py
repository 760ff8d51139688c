"""Every command of the tutorial and of the how-to pages runs as it stands and prints what the page shows."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

import console

DOCS = Path(__file__).resolve().parents[2] / "docs"
# Installing changes this machine: tests of its own try it.
PAGES = sorted(path for path in (DOCS / "how-to").glob("*.md") if path.stem not in {"index", "install"})


@pytest.fixture(scope="module")
def after_tutorial(tmp_path_factory):
    """The folder in which the tutorial was carried out, and what went otherwise than it says."""
    folder = tmp_path_factory.mktemp("tutorial")
    page = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    return folder, console.report(console.run(page, folder))


@pytest.mark.study
def test_the_tutorial_prints_what_it_shows(after_tutorial):
    folder, faults = after_tutorial
    assert not faults, faults
    assert (folder / "run" / "report.html").exists()


@pytest.mark.study
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


# --- the runner itself ---------------------------------------------------------------------------------------


def test_there_is_a_page_for_each_problem():
    assert len(PAGES) >= 12
    for path in PAGES:
        lines = path.read_text(encoding="utf-8").splitlines()
        assert len(lines) <= 75, f"{path.name} is longer than a screen or two"
        assert any(step.kind in {"console", "pycon"} for step in console.steps("\n".join(lines) + "\n"))


def test_a_page_is_read_as_commands_python_and_files():
    page = (
        "```console\n$ planish info \\\nx.tif\none\n...\n$ ls\n```\n```text a.csv\nx,y\n```\n"
        "```pycon\n>>> 1 + 1\n2\n```\n```python\nnot run\n```\n"
    )
    found = console.steps(page)
    assert [(step.kind, step.verb, step.name) for step in found] == [
        ("console", "info", ""), ("console", "", ""), ("file", "", "a.csv"), ("pycon", "", ""),
    ]  # fmt: skip
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
        "```console\n$ planish --version\nplanish, version 7\n$ no-such-program x\n```\n```pycon\n>>> 1 + 1\n3\n```\n"
        "```console\n$ planish info nothing.tif\n...\nplanish: ... does not exist. ...\n```\n"
    )
    outcomes = console.run(page, tmp_path)
    assert [bool(outcome.faults) for outcome in outcomes] == [True, False, True, False]
    assert outcomes[1].passed_over == "no-such-program is not installed"
    assert outcomes[3].code == 3
    assert "planish, version 0" in console.report(outcomes)
