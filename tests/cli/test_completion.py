"""The Tab key: commands, options and words, in the shells that are here."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest
import tifffile

from planish.cli import main, setup
from planish.cli.main import planish
from planish.core.errors import FileError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def home(tmp_path, monkeypatch):
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME", "ZDOTDIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    return tmp_path


@pytest.mark.parametrize("shell", setup.SHELLS)
def test_the_script_is_printed(planish, shell):
    code, out, err = planish("completion", shell)
    assert (code, err, out) == (0, "", setup.script_of(shell))
    assert "_PLANISH_COMPLETE" in out
    assert out.isascii(), "a console of any code page may write it"


@pytest.mark.parametrize(
    ("shell", "start", "place"),
    [
        ("bash", ".bashrc", ".local/share/planish/completion.bash"),
        ("zsh", ".zshrc", ".local/share/planish/completion.zsh"),
        ("fish", None, ".config/fish/completions/planish.fish"),
        ("powershell", "Documents/profile.ps1", "Documents/planish.completion.ps1"),
    ],
)
def test_it_is_installed_once_and_says_where(home, monkeypatch, planish, shell, start, place):
    monkeypatch.setattr(setup, "_profile", lambda: home / "Documents" / "profile.ps1")
    if start is not None:
        (home / start).parent.mkdir(exist_ok=True)
        (home / start).write_bytes(b"alias ll='ls -l'")
    code, out, _ = planish("completion", shell, "--install")
    assert (code, (home / place).read_text(encoding="utf-8")) == (0, setup.script_of(shell))
    assert str(home / place) in out
    if start is None:
        return
    once = (home / start).read_bytes()
    first, line, *rest = once.decode().split("\n")
    assert (first, rest) == (
        "alias ll='ls -l'",
        [""],
    ), "what was there stays, and one line comes behind it"
    assert Path(place).name in line
    planish("completion", shell, "--install")
    assert (home / start).read_bytes() == once


def test_a_missing_powershell_is_reported_and_an_older_profile_stays_readable(monkeypatch, home):
    monkeypatch.setattr(setup.shutil, "which", lambda _name: None)
    with pytest.raises(FileError, match=r"planish completion powershell >> \$PROFILE"):
        setup.install_script("powershell")
    profile = home / "profile.ps1"
    profile.write_bytes("Set-Location C:\\\r\n".encode("utf-16"))
    monkeypatch.setattr(setup, "_profile", lambda: profile)
    setup.install_script("powershell")
    assert profile.read_bytes().decode("utf-16").splitlines() == [
        "Set-Location C:\\",
        '. "$PSScriptRoot/planish.completion.ps1"',
    ]
    # A file may begin with a mark of its encoding, and with the line.
    profile.write_bytes('\ufeff. "$PSScriptRoot/planish.completion.ps1"\r\n'.encode("utf-16-le"))
    once = profile.read_bytes()
    setup.install_script("powershell")
    assert profile.read_bytes() == once


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("ma",), ["map", "marks"]),
        (("link", "a.tif", "--thr"), ["--through", "--threads"]),
        (("link", "--through", ""), ["z", "y", "x"]),
        (("marks", ""), ["design", "check", "simulate", "convert"]),
    ],
)
def test_powershell_gets_words_with_their_help(monkeypatch, capsys, words, expected):
    monkeypatch.setenv("_PLANISH_COMPLETE", "powershell_complete")
    monkeypatch.setenv("COMP_WORDS", "\n".join(("planish", *filter(None, words))))
    monkeypatch.setenv("COMP_CWORD", words[-1])
    with pytest.raises(SystemExit):
        main([])
    rows = [line.split("\t") for line in capsys.readouterr().out.splitlines()]
    assert {"plain"} == {row[0] for row in rows}
    assert set(expected) <= {row[1] for row in rows}
    assert all(len(row) == 3 for row in rows)


@pytest.mark.ci
@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_completes(home):
    """With a program ``planish`` on its path."""
    setup.install_script("bash")
    folder = home / "bin"
    folder.mkdir()
    command = folder / "planish"
    command.write_text(
        f'#!/bin/sh\nexec "{sys.executable}" -m planish "$@"\n', encoding="utf-8", newline="\n"
    )
    command.chmod(0o755)
    env = os.environ | {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}", "HOME": str(home)}
    asked = (
        "source ~/.bashrc; COMP_WORDS=(planish ma); COMP_CWORD=1; _planish_completion planish; echo"
        ' "${COMPREPLY[@]}"'
    )
    command = ["bash", "--norc", "-c", asked]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["map", "marks"]


@pytest.mark.ci
@pytest.mark.parametrize(
    ("arguments", "needless"),
    [
        ("'--help'", "{'numba', 'xarray', 'pandas', 'matplotlib', 'numpy', 'pydantic'}"),
        ("'link', '--help'", "{'numba', 'xarray', 'pandas', 'matplotlib'}"),
        ("'info', sys.argv[1]", "{'numba', 'xarray', 'pandas', 'matplotlib', 'zarr', 'scipy'}"),
    ],
)
def test_what_is_asked_first_waits_for_nothing_it_does_not_use(arguments, needless, tmp_path):
    """Help and a look at a file come first: numba and xarray take half a second each."""
    tifffile.imwrite(tmp_path / "volume.tif", np.arange(27, dtype=np.uint8).reshape(3, 3, 3))
    program = (
        "import sys; from planish.cli.main import main\n"
        f"try: main([{arguments}])\n"
        "except SystemExit: pass\n"
        f"print(*sorted({needless} & sys.modules.keys()), file=sys.stderr)"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "volume.tif")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (done.stderr.split(), bool(done.stdout)) == ([], True)


def test_the_list_of_verbs_says_what_each_says_of_itself():
    context, formatter = click.Context(planish, info_name="planish"), click.HelpFormatter(width=100)
    planish.format_commands(context, formatter)
    lines = dict(line.split(maxsplit=1) for line in formatter.getvalue().splitlines()[1:])
    assert list(lines) == planish.list_commands(context)
    for name, text in lines.items():
        command = planish.get_command(context, name)
        assert text == command.get_short_help_str(len(text))
