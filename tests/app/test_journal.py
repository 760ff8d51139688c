"""The journal: what was answered is on the disk, whatever happens; and sessions that come back from
it."""

import errno
import json
import os
import random
import shutil
import subprocess
import sys
import time
from contextlib import closing

import pytest

from app.test_changes import random_change
from folders import refused
from planish.app import Session, changes
from planish.app import journal as module
from planish.app.journal import InUse, Journal
from planish.app.session import Stale, image_key
from planish.core.errors import FileError, ResourceError
from planish.io import ImageParams, fingerprint


@pytest.fixture
def path(tmp_path):
    return tmp_path / "edits" / "journal.jsonl"


def change(session, **values):
    session.change(changes.change_of(json.dumps(values)))


def standing(session):
    now = session.state
    return [now.marks, now.model, now.corrections, now.regions]


def test_an_image_is_known_by_its_bytes_and_as_older_versions_knew_it(tmp_path):
    for folder in ("here", "there"):
        (tmp_path / folder).mkdir()
        for name in ("image", "white"):
            (tmp_path / folder / f"{name}.tif").write_bytes(name.encode())
    here, there = (tmp_path / folder / "image.tif" for folder in ("here", "there"))
    plain = image_key(ImageParams(path=str(here), dark_grey=1.0, white_grey=2.0))
    fields = dict.fromkeys(("pixel_um", "side", "md_deg", "screen_um"))
    fields |= {"channel": "luminance", "override_size": False, "unusual_size": False}
    sha256, text = plain.split(" ", 1)
    assert sha256 == fingerprint(here)
    assert json.loads(text) == fields | {"dark_grey": 1.0, "white_grey": 2.0}
    keys = [
        image_key(ImageParams(path=str(path), white=str(path.with_name("white.tif")), gamma=gamma))
        for path, gamma in ((here, 2.2), (there, 2.2), (there, None))
    ]
    assert keys[0] == keys[1] != keys[2]
    assert fingerprint(there.with_name("white.tif")) in keys[2]


def test_nothing_is_written_before_the_first_change(path):
    with closing(Journal(path, subject="a", write=True)):
        assert not path.exists()
    assert not path.parent.exists()


@pytest.mark.parametrize("half", [b'{"do": 3', b'{"do": 3}', b"\0" * 40])
def test_half_a_last_line_is_dropped(path, half):
    with closing(Journal(path, subject="a", write=True)) as made:
        made.append(b'{"do": 1}')
    with path.open("ab") as file:
        file.write(half)
    with closing(Journal(path, subject="a", write=True)) as again:
        assert again.lines == [b'{"do": 1}']
        again.append(b'{"do": 2}')
    assert Journal(path, subject="a", write=False).lines == [b'{"do": 1}', b'{"do": 2}']


def test_half_a_first_line_is_as_good_as_none(path):
    path.parent.mkdir()
    path.write_bytes(b'{"format": "plan')
    with closing(Journal(path, subject="a", write=True)) as made:
        made.append(b'{"do": 1}')
    assert Journal(path, subject="a", write=False).lines == [b'{"do": 1}']


def test_a_line_is_on_the_disk_before_it_counts(path, monkeypatch):
    seen = []
    real = os.fsync
    monkeypatch.setattr(module.os, "fsync", lambda at: (seen.append(path.read_bytes()), real(at)))
    with closing(Journal(path, subject="a", write=True)) as made:
        made.append(b'{"do": 1}')
    assert any(data.endswith(b'{"do": 1}\n') for data in seen)


@pytest.mark.parametrize("written", [0, 4])
def test_a_full_disk_leaves_nothing_of_a_line(path, monkeypatch, written):
    with closing(Journal(path, subject="a", write=True)) as made:
        made.append(b'{"do": 1}')

        def full(file, data):
            file.write(data[:written])
            raise OSError(errno.ENOSPC, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(module, "_write_all", full)
            refused(ResourceError, r"was not made: the disk is full", made.append, b'{"do": 2}')
        assert made.lines == [b'{"do": 1}']
        made.append(b'{"do": 3}')
    assert Journal(path, subject="a", write=False).lines == [b'{"do": 1}', b'{"do": 3}']


def test_a_line_that_did_not_reach_the_disk_is_taken_back(path, monkeypatch):
    def broken(_at):
        raise OSError(errno.EIO, "Input/output error")

    with closing(Journal(path, subject="a", write=True)) as made:
        made.append(b'{"do": 1}')
        before = path.read_bytes()
        monkeypatch.setattr(module.os, "fsync", broken)
        refused(FileError, "was not made", made.append, b'{"do": 2}')
        assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'{"format": "another 1"}\n', "is no journal"),
        (b'{"format": "planish journal 1", "of": "b"}\n', "something else"),
        (
            b'{"format": "planish journal 1", "of": "a"}\nnonsense\n{"do": 2}\n',
            "damaged in line 2 of 3",
        ),
        (b"[[[\n", "is no journal"),
    ],
)
def test_a_journal_that_is_none_is_refused_and_kept(path, content, words):
    path.parent.mkdir()
    path.write_bytes(content)
    refused(FileError, words, Journal, path, subject="a", write=True)
    assert path.read_bytes() == content
    with pytest.raises(FileError, match=words):  # the lock was given back
        Journal(path, subject="a", write=True)


def test_one_process_writes_and_others_read(path):
    with closing(Journal(path, subject="a", write=True)) as made:
        made.append(b'{"do": 1}')
        refused(InUse, "read_only=", Journal, path, subject="a", write=True)
        reader = Journal(path, subject="a", write=False)
        assert reader.lines == [b'{"do": 1}']
        refused(FileError, "read only", reader.append, b'{"do": 2}')
    with closing(Journal(path, subject="a", write=True)):
        pass


# --- sessions -------------------------------------------------------------------------------------
def test_undo_and_redo_survive_a_new_start(made_copy):
    first = Session.open(made_copy)
    begin = standing(first)
    change(first, do="use", id="m0-1", used=False)
    change(first, do="delete", id="m0-2")
    end = standing(first)
    first.undo()
    first.close()
    second = Session.open(made_copy)
    assert (second.can_undo, second.can_redo, second.version) == (True, True, 3)
    second.redo()
    assert standing(second) == end
    second.undo()
    second.undo()
    assert standing(second) == begin
    refused(changes.ChangeError, "nothing to undo", second.undo)
    second.close()


def test_ids_never_return(made_copy):
    session = Session.open(made_copy)
    for _ in range(2):
        change(session, do="add", moving=[1, 2])
        session.undo()
    change(session, do="add", moving=[1, 2])
    session.close()
    ids = [json.loads(line)["id"] for line in session.journal.lines if b"add" in line]
    assert ids == ["m1", "m3", "m5"]


def test_a_change_of_what_was_changed_meanwhile_is_stale(made_copy):
    session = Session.open(made_copy)
    seen = session.version
    change(session, do="use", id="m0-1", used=False)
    with pytest.raises(Stale):
        session.undo(version=seen)
    session.publish()  # a fit that is ready makes nothing stale
    session.undo(version=session.changed_at)
    session.close()


def test_a_run_is_not_touched_by_its_session(made_copy):
    before = {p.relative_to(made_copy): p.read_bytes() for p in made_copy.rglob("*") if p.is_file()}
    session = Session.open(made_copy)
    change(session, do="use", id="m0-1", used=False)
    session.close()
    after = {
        p.relative_to(made_copy): p.read_bytes()
        for p in made_copy.rglob("*")
        if p.is_file() and p.parent.name != "edits"
    }
    assert after == before


def test_a_run_that_cannot_be_written_opens_read_only_and_says_so(made_copy):
    (made_copy / "edits").write_text("a file where the folder would be")
    session = Session.open(made_copy)
    assert session.read_only
    assert "cannot be written" in session.reason
    refused(FileError, "read only", change, session, do="use", id="m0-1", used=False)
    assert session.state.of(None)[0].used


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.nightly) for k in range(1, 25))]
)
def test_forty_sequences_of_changes_undo_and_redo(made_copy, seed, monkeypatch):
    """1000 in all, with new starts between; the slow model keeps every state that there was."""
    monkeypatch.setattr(module.os, "fsync", lambda _at: None)  # of which other tests speak
    draw = random.Random(seed)
    session = Session.open(made_copy)
    for _sequence in range(40):
        shutil.rmtree(made_copy / "edits", ignore_errors=True)
        session = restarted(session)
        done, undone = [standing(session)], []
        for _ in range(draw.randrange(2, 12)):
            match draw.choice(["change", "change", "undo", "redo", "start"]):
                case "undo" if len(done) > 1:
                    session.undo()
                    undone.append(done.pop())
                case "redo" if undone:
                    session.redo()
                    done.append(undone.pop())
                case "start":
                    session = restarted(session)
                case _:
                    session.change(
                        changes.change_of(json.dumps(random_change(draw, session.state)))
                    )
                    done.append(standing(session))
                    undone.clear()
            assert standing(session) == done[-1]
            assert (session.can_undo, session.can_redo) == (len(done) > 1, bool(undone))
        while session.can_undo:
            session.undo()
        assert standing(session) == done[0]
    session.close()


def restarted(session):
    """The same run in a new session, without reading its numbers again."""
    session.close()
    journal = Journal(session.journal.path, subject=session.journal.subject, write=True)
    again = Session(
        folder=session.folder,
        study=session.study,
        results=session.results,
        registrations=session.registrations,
        image_params=None,
        journal=journal,
        reason="",
    )
    again._replay(None)
    return again


_WRITER = """
import sys
from contextlib import closing
from pathlib import Path
from planish.app.journal import Journal
with closing(Journal(Path(sys.argv[1]), subject="a", write=True)) as made:
    for k in range(100000):
        made.append(b'{"do": "step", "k": %d, "fill": "%s"}' % (k, b"x" * (k % 5000)))
        print(k, flush=True)
"""


@pytest.mark.ci
def test_a_killed_writer_loses_at_most_the_line_in_flight(path):
    path.parent.mkdir(exist_ok=True)
    writer = subprocess.Popen(
        [sys.executable, "-c", _WRITER, str(path)], stdout=subprocess.PIPE, text=True
    )
    writer.stdout.readline()
    time.sleep(0.1)
    writer.kill()
    answered = 1 + len(writer.stdout.read().splitlines())
    writer.wait()
    writer.stdout.close()
    with closing(Journal(path, subject="a", write=True)) as made:
        found = [json.loads(line)["k"] for line in made.lines]
        assert found == list(range(len(found)))
        assert answered <= len(found) <= answered + 1
