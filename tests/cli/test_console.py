"""Consoles: colours that are off, narrow terminals, letters that are not there."""

import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from PIL import Image

from planish.cli import console, show
from planish.cli.console import stacked, table, wrapped
from planish.run import open_results

SHOWN = """
import time
from planish.cli.console import table
from planish.cli.show import stages
with stages(3) as tell:
    tell("map", "[1, 2] of 3")
    time.sleep(0.2)
table("Properties", ("", "unit", "mean"), [("coating [top]", "um", "17.60")])
"""


def in_terminal(code, **environment):
    """What a terminal gets from a program, as it is."""
    pty = pytest.importorskip("pty")
    above, below = pty.openpty()
    kept = {
        k: v
        for k, v in os.environ.items()
        if k not in ("NO_COLOR", "FORCE_COLOR", "COLORTERM", "TERM", "COLUMNS")
    }
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=below,
        stdout=below,
        stderr=below,
        env=kept | environment,
        close_fds=True,
    ) as process:
        os.close(below)
        found = b""
        while True:
            try:
                data = os.read(above, 4096)
            except OSError:  # its other end was closed
                break
            if not data:
                break
            found += data
    os.close(above)
    assert process.returncode == 0, found.decode()
    return found.decode()


@pytest.mark.ci
def test_a_terminal_gets_colours():
    text = in_terminal(SHOWN, TERM="xterm-256color", COLUMNS="80")
    assert "\x1b[1m" in text, "the heading is bold"
    assert "coating [top]" in text
    assert "[1, 2] of 3" in text


def test_in_a_narrow_terminal_rows_stand_below_each_other():
    text = stacked(
        "Properties of the sheet",
        ("", "unit", "mean", "n"),
        [("porosity", "1", "0.41", "70"), ("tilt", "deg", "2.1", "9")],
        24,
    )
    assert text.split("\n") == [
        "Properties of the sheet",
        "porosity",
        "  mean  0.41",
        "  n  70",
        "tilt",
        "  mean  2.1 deg",
        "  n  9",
    ]
    text = stacked(
        "", ("name", "unit", ""), [("coat_weight_top", "g/m2", "Coat weight, top side")], 30
    )
    assert text.split("\n") == ["coat_weight_top", "  unit  g/m2", "    Coat weight, top side"]


@pytest.mark.ci
@pytest.mark.parametrize(
    "environment", [{"NO_COLOR": "1", "TERM": "xterm-256color"}, {"TERM": "dumb"}]
)
def test_colours_that_are_off_are_off(environment):
    text = in_terminal(SHOWN, **environment, COLUMNS="80")
    assert "17.60" in text
    assert not re.search(r"\x1b\[[0-9;]*m", text), "no colour, nothing bold"
    if environment["TERM"] == "dumb":
        assert "\x1b" not in text, "and nothing drawn over and over"
        assert "map: [1, 2] of 3" in text


def test_what_is_no_terminal_gets_plain_lines(capsys):
    with show.stages(2) as tell:
        tell("map", "1 of 2")
    wide = "x" * 200
    table("Papers", ("name", "what it is"), [("a", wide)])
    out, err = capsys.readouterr()
    assert err == "map: 1 of 2\n"
    assert wide in out, "nothing is cut off"
    assert "\x1b" not in out + err


# --- narrow terminals -----------------------------------------------------------------------------
@pytest.mark.parametrize("width", [40, 100])
def test_narrow_terminals_keep_units_beside_their_numbers(linked_run, monkeypatch, capsys, width):
    monkeypatch.setattr(console, "width", lambda **_: width)
    results = open_results(linked_run)
    show.finish(SimpleNamespace(results=results, groups={}), Path("run"), as_json=False)
    out, err = capsys.readouterr()
    lines = [*out.splitlines(), *err.splitlines()]
    assert max(len(line.rstrip()) for line in lines) <= width
    assert "…" not in out + err, "nothing is cut off"
    for line in lines:
        assert not re.match(r"\s*(um|deg|%)\b", line), f"a unit without its number: {line!r}"
    found = results.layers[0].sheet.properties["coating_top"]
    if width < 100:
        assert f"  mean  {found.mean:.2f} um" in lines
        assert f"  columns  {found.n}" in lines
        assert "  point  100 um" in lines
    assert re.search(r"residual\s+\d+\.\d+ um rms", out)


def test_no_line_ends_between_a_number_and_its_unit():
    text = (
        "Expected error 1.3 um rms; 87 % of its square is marks, 12 voxels of 3 x 3 x 3 um, 0.21"
        " deg and 4 GB."
    )
    for width in range(20, 60):
        for line in wrapped(text, width).split("\n"):
            assert len(line) <= width
            assert not re.match(r"\s*(um|%|voxels|deg|GB)", line)
        assert " ".join(wrapped(text, width).split()) == text


# --- letters --------------------------------------------------------------------------------------
def run(*arguments, cwd, **environment):
    found = subprocess.run(
        [sys.executable, "-m", "planish", *arguments],
        cwd=cwd,
        capture_output=True,
        check=False,
        env=os.environ | environment,
    )
    return found.returncode, found.stdout, found.stderr


@pytest.mark.ci
def test_a_name_that_the_console_cannot_show_ends_nothing(tmp_path):
    Image.new("L", (40, 30)).save(tmp_path / "Núria 中文.png")
    code, out, err = run(
        "info", "Núria 中文.png", cwd=tmp_path, PYTHONIOENCODING="cp1252", PYTHONUTF8="0"
    )
    assert (code, err) == (0, b"")
    assert out.startswith(b"N\xfaria \\u4e2d\\u6587.png: image, 30 x 40 (y, x)")
    code, _, err = run("info", "没有.png", cwd=tmp_path, PYTHONIOENCODING="cp1252", PYTHONUTF8="0")
    assert code == 3
    assert b"\\u6ca1\\u6709.png does not exist." in err
