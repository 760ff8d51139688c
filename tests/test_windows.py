"""What Windows does differently, as far as another system can show it: names, lengths, open files,
line ends."""

import ast
import ctypes
import json
import re
from pathlib import Path, PureWindowsPath
from types import SimpleNamespace

import numpy as np
import pytest

import planish as pl
from formats_written import CASES, VALUES
from marks import files_by_hand as by_hand
from planish.core.errors import FileError
from planish.core.files import (
    DEEPEST_PATH_LENGTH,
    check_length,
    fault_of_name,
    move,
    refuse_name,
    write_whole,
)
from planish.io import guard, new_folder, read_volume, refuse_existing
from planish.marks import read_any
from planish.run import as_study, read_study

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted((ROOT / "src").rglob("*.py"))


# --- names and lengths ----------------------------------------------------------------------------
@pytest.mark.parametrize(
    "name", ["aux", "Com1.tar.gz", "lpt9", "prn ", "COM¹", "run.", "CONIN$", "aux .zarr"]
)
def test_names_that_windows_cannot_keep_are_refused_everywhere(name, tmp_path):
    assert fault_of_name(name, windows=False)
    with pytest.raises(FileError, match="Windows"):
        write_whole(tmp_path / name, b"")
    with pytest.raises(FileError, match="Windows"), new_folder(tmp_path / name / "run"):
        pytest.fail("must not get here")
    assert list(tmp_path.iterdir()) == []


def test_other_names_are_taken_but_for_signs_that_only_windows_refuses(tmp_path, refuses):
    for name in ("run", "auxiliary", "con_1", "com", "com10", ".hidden", "Blatt ä 7.zarr", "a.b"):
        assert fault_of_name(name, windows=True) is None
        refuse_existing(tmp_path / name)
    for sign in ("?", "*", ":", "|", '"', "<", "\n"):
        assert fault_of_name(f"run{sign}1", windows=False) is None
        assert fault_of_name(f"run{sign}1", windows=True)
    refuses(
        "import", tmp_path / "none.tif", "--out", tmp_path / "nul.txt", words="'nul.txt'", out=False
    )


def test_names_of_layers_and_drives():
    for place in (PureWindowsPath("C:/data/run"), PureWindowsPath(r"\\server\share\Anna\run")):
        refuse_name(place, list(place.parts[1:]), windows=True)
    with pytest.raises(FileError, match="'nul'"):
        refuse_name(PureWindowsPath(r"\\server\share\nul"), ["nul"], windows=True)
    one = {"volume": {"path": "a.tif"}}
    for names in (("ct", "CT"), ("aux", "lm")):
        with pytest.raises(ValueError, match="name"):
            as_study({"layers": [{"name": name, **one} for name in names]})


def test_folders_too_deep_for_windows_are_refused_and_runs_are_not(linked_run):
    check_length(PureWindowsPath(r"C:\Users\anna.berg\Documents\papers\run"), longest=259)
    deep = PureWindowsPath(
        r"\\files.mill.example\research and development\coating\trial 17, both sides of the"
        r" sheet\microtome"
        r"\2 um\run number 1"
    )
    with pytest.raises(
        FileError, match=r"259\. Write to a shorter path such as C:\\data\\run number 1"
    ):
        check_length(deep, longest=259)
    check_length(deep, longest=None)  # where there is no such limit
    while_written = len(".0123456789abcdef0123456789abcdef.partial")  # what zarr appends
    longest = max(len(p.relative_to(linked_run).as_posix()) for p in linked_run.rglob("*"))
    assert longest + while_written <= DEEPEST_PATH_LENGTH


def test_a_drive_in_a_study_is_not_a_layers_name(refuses):
    """``C:`` is no ``NAME=``, and a path with a sign of equality stays one."""
    for path in (r"C:\data\volume=1.tif", r"\\server\share\volume.tif"):
        assert "no name of a layer" not in refuses("link", path, "image.tif", words="volume")


# --- files that another program holds open --------------------------------------------------------
def held(times):
    """A rename that is refused so many times, as Windows does where a virus scanner has the
    file."""
    left = [times]
    rename = Path.rename

    def refused(self, target):
        if left[0] > 0:
            left[0] -= 1
            raise PermissionError(13, "Permission denied", str(self))
        return rename(self, target)

    return refused


def test_a_file_that_is_held_open_for_a_moment_is_moved(tmp_path, monkeypatch):
    monkeypatch.setattr("planish.core.files.time.sleep", lambda _s: None)
    monkeypatch.setattr(Path, "rename", held(3))
    with new_folder(tmp_path / "run") as folder:
        (folder / "a").write_text("a", encoding="utf-8")
    assert (tmp_path / "run" / "a").read_text(encoding="utf-8") == "a"


def test_a_file_that_stays_open_is_a_message_and_leaves_nothing(tmp_path, monkeypatch):
    waited = []
    monkeypatch.setattr("planish.core.files.time.sleep", waited.append)
    monkeypatch.setattr(Path, "rename", held(100))
    with pytest.raises(FileError, match=r"another program has it .* open.*the same command again"):
        write_whole(tmp_path / "a.json", b"{}")
    assert list(tmp_path.iterdir()) == []
    assert 2 < sum(waited) < 5


def test_what_is_there_is_replaced_only_on_request(tmp_path):
    for name in ("new", "old"):
        (tmp_path / name).write_text(name, encoding="utf-8")
    move(tmp_path / "new", tmp_path / "old", over=True)
    assert (tmp_path / "old").read_text(encoding="utf-8") == "new"


# --- line ends ------------------------------------------------------------------------------------
def crlf(path):
    """The same file as an editor on Windows saves it."""
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    return path


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("bigwarp.csv", by_hand.bigwarp_2d()),
        ("elastix.txt", by_hand.elastix(by_hand.MOVING)),
        ("marks.csv", by_hand.native()),
        ("marks.mrk.json", by_hand.slicer(by_hand.slicer_list(by_hand.MOVING / 1000, "m"))),
    ],
)
def test_marks_with_the_line_ends_of_windows_are_the_same(tmp_path, name, text):
    path = tmp_path / name
    path.write_bytes(text.encode())
    expected = read_any(path)
    assert str(read_any(crlf(path))) == str(expected)


@pytest.mark.parametrize("name", ["NRRD detached", "MetaImage detached", "NRecon", "raw"])
def test_headers_with_the_line_ends_of_windows_are_the_same(tmp_path, name):
    given = CASES[name].write(tmp_path, VALUES, CASES[name].voxel)
    texts = [p for p in tmp_path.rglob("*") if p.suffix in (".nhdr", ".mhd", ".log", ".toml")]
    assert texts
    for path in texts:
        crlf(path)
    volume = read_volume(given)
    np.testing.assert_array_equal(np.asarray(volume.values), VALUES)
    assert tuple(volume.attrs["voxel_um"]) == CASES[name].voxel


def test_studies_and_runs_with_the_line_ends_of_windows_are_the_same(
    linked_run, tmp_path, run_copy
):
    text = (linked_run / "run.toml").read_bytes()
    path = tmp_path / "run.toml"
    path.write_bytes(text)
    expected = read_study(path)
    path.write_bytes(b"\xef\xbb\xbf" + text.replace(b"\n", b"\r\n"))
    assert read_study(path) == expected
    for path in run_copy.iterdir():
        if path.suffix in (".toml", ".json", ".csv"):
            crlf(path)
    before, after = pl.open_run(linked_run), pl.open_run(run_copy)
    assert (after.results, after.registrations.keys()) == (
        before.results,
        before.registrations.keys(),
    )
    assert json.loads((run_copy / "marks.json").read_text(encoding="utf-8"))


# --- the machine ----------------------------------------------------------------------------------
def test_the_memory_is_asked_of_windows():
    def answer(status):
        found = ctypes.cast(status, ctypes.POINTER(guard._MemoryStatus)).contents
        assert found.length == 64, "the size that Windows expects"
        found.available = 5 * 2**30
        return 1

    assert guard._available_on_windows(SimpleNamespace(GlobalMemoryStatusEx=answer)) == 5 * 2**30
    assert (
        guard._available_on_windows(SimpleNamespace(GlobalMemoryStatusEx=lambda _: 0))
        == guard.UNKNOWN_BYTES
    )


# --- rules for the code ---------------------------------------------------------------------------

TEXT = re.compile(r"\b(read_text|write_text|open)\(")
LACKING = re.compile(
    r"^\s*(?:import|from) (?:fcntl|resource|pwd|grp|termios|curses|readline|pty|posix)\b",
    re.MULTILINE,
)
FOREIGN = re.compile(r"\.(?:fork|symlink_to|symlink|hardlink_to|killpg)\(")


def test_text_files_have_one_encoding_and_one_line_end():
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        if not TEXT.search(text):
            continue
        for node in ast.walk(ast.parse(text)):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                continue
            where, name, given = (
                f"{path}:{node.lineno}",
                node.func.attr,
                {k.arg for k in node.keywords},
            )
            assert name != "read_text" or "encoding" in given, where
            assert name != "write_text" or {"encoding", "newline"} <= given, where
            mode = node.args[0] if name == "open" and node.args else None
            if isinstance(mode, ast.Constant) and "b" not in str(mode.value):
                assert {"encoding", "newline"} <= given, where


def test_nothing_is_used_that_windows_lacks():
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        assert not LACKING.search(text), path
        assert not FOREIGN.search(text), path
