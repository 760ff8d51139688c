"""The hash of the package's sources, and what depends on it."""

import shutil
import subprocess
from email.message import Message
from importlib import metadata

import pytest

from planish.core import source_hash
from planish.core.files import as_sentence
from planish.run import compute


def test_names_and_bytes_of_the_sources_count_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setattr(source_hash, "PACKAGE", tmp_path)
    states = list[str]()

    def state():
        states.append(source_hash.hash_sources.__wrapped__())
        return states[-1]

    (tmp_path / "stage").mkdir()
    (tmp_path / "stage" / "a.py").write_bytes(b"a = 1\n")
    before = state()
    (tmp_path / "page.html").write_text("no code")
    assert source_hash.hash_sources.__wrapped__() == before
    (tmp_path / "stage" / "a.py").write_bytes(b"a = 2\n")
    state()
    (tmp_path / "stage" / "a.py").rename(tmp_path / "a.py")
    state()
    (tmp_path / "b.py").write_bytes(b"")
    state()
    assert (len(set(states)), {len(text) for text in states}) == (4, {16})


def test_tiles_of_other_code_are_not_used_again(monkeypatch):
    before = compute.run_key({"a": 1}, ["hash"])
    assert compute.run_key({"a": 1}, ["hash"]) == before
    monkeypatch.setattr(compute, "hash_sources", lambda: "0" * 16)
    assert compute.run_key({"a": 1}, ["hash"]) != before


def git(folder, *words):
    """Call git in a folder as somebody."""
    name = ["-c", "user.name=A", "-c", "user.email=a@b.c"]
    command = ["git", *name, *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_the_commit_of_a_checkout_and_whether_files_of_the_package_differ(tmp_path, monkeypatch):
    package = tmp_path / "src" / "planish"
    package.mkdir(parents=True)
    monkeypatch.setattr(source_hash, "PACKAGE", package)
    commit = source_hash.find_commit.__wrapped__
    assert commit() == ""  # no checkout
    (package / "a.py").write_text("a = 1\n")
    (tmp_path / "page.md").write_text("text\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "first")
    head = git(tmp_path, "rev-parse", "HEAD")
    assert commit() == head
    (tmp_path / "page.md").write_text("another text\n")
    assert commit() == head
    (package / "a.py").write_text("a = 2\n")
    assert commit() == f"{head}+"
    # An environment within the checkout of something else.
    installed = tmp_path / ".venv" / "planish"
    installed.mkdir(parents=True)
    monkeypatch.setattr(source_hash, "PACKAGE", installed)
    assert commit() == ""


def test_faults_are_reported_to_the_address_of_the_metadata(monkeypatch):
    message = Message()
    monkeypatch.setattr(metadata, "metadata", lambda _name: message)
    assert source_hash.report_to() == "to whoever runs this installation"
    message["Project-URL"] = "Documents, https://example.org/docs"
    message["Project-URL"] = "Issues, https://example.org/issues"
    assert source_hash.report_to() == "at https://example.org/issues"
    fault = as_sentence(KeyError("x"), "run", "")
    assert fault.text.endswith("Please report it at https://example.org/issues.")
