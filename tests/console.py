"""Runs the commands that a document shows, one after the other, and compares what they print.

A block ``console`` holds commands behind ``$ `` and what they print; a block ``pycon`` holds Python
behind ``>>> ``. In what is expected ``...`` stands for any text within a line, and a line of its
own for any number of lines. Files that a document shows in a block ``text FILE`` or ``toml FILE``
are written before the commands below them. A command that ends with ``&`` runs until the page ends.
Commands of programs that are not installed are passed over.
"""

import contextlib
import doctest
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import click

import planish
from planish.cli import main
from planish.cli import planish as group

_BLOCK = re.compile(r"^```(\w+)(?:[ ]+([\w./-]+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_COLUMNS = "100"


@dataclass
class Step:
    """A command with what it should print, Python, or a file to write."""

    kind: str
    text: str
    expected: str = ""
    name: str = ""

    @property
    def verb(self):
        """The command of planish that is called; empty where there is none."""
        words = shlex.split(self.text)
        return words[1] if self.kind == "console" and words[0] == "planish" else ""


@dataclass
class Outcome:
    """What a step printed, and the exit code that it ended with."""

    step: Step
    printed: str
    code: int = 0
    faults: list[str] = field(default_factory=list)
    passed_over: str = ""


def steps(page):
    """Return what a page shows to do, in its order."""
    found = []
    for kind, name, body in _BLOCK.findall(page):
        if kind == "console":
            for part in re.split(r"^\$ ", body, flags=re.MULTILINE)[1:]:
                command, _, expected = part.replace("\\\n", " ").partition("\n")
                found.append(Step("console", command.strip(), expected))
        elif kind == "pycon":
            found.append(Step("pycon", body))
        elif name:
            found.append(Step("file", body, name=name))
    return found


def unknown_verbs(page):
    """Commands of planish that a page shows and that this planish does not have."""
    return {step.verb for step in steps(page) if step.verb and not step.verb.startswith("-")} - {
        *group.list_commands(click.Context(group))
    }


def run(page, folder, names=None):
    """Carry out what a page shows, in a folder; one outcome for each command and each block of
    Python."""
    names = {} if names is None else names
    outcomes = []
    with contextlib.chdir(folder), contextlib.ExitStack() as background:
        for step in steps(page):
            if step.kind == "file":
                Path(step.name).write_text(step.text, encoding="utf-8")
            elif step.kind == "pycon":
                outcomes.append(_python(step, names))
            else:
                outcomes.append(_command(step, background))
    return outcomes


def fits(printed, expected):
    """Tell whether text is what is expected, ``...`` being anything."""
    pattern = ""
    for line in expected.rstrip("\n").splitlines():
        words = re.escape(line.rstrip()).replace(re.escape("..."), "[^\n]*")
        pattern += r"(?:[^\n]*\n)*?" if line.strip() == "..." else f"{words}[ ]*\n"
    text = printed.rstrip("\n") + "\n" if printed.strip() else ""
    return re.fullmatch(pattern, text) is not None


def report(outcomes):
    """Return what went wrong, to read; empty where nothing did."""
    parts = []
    for outcome in (one for one in outcomes if one.faults):
        step = outcome.step
        parts.append(f"$ {step.text}\n{'; '.join(outcome.faults)} (exit code {outcome.code})")
        parts.append(f"--- expected\n{step.expected}--- printed\n{outcome.printed}")
    return "\n".join(parts)


def _command(step, background):
    words = shlex.split(step.text)
    if words[0] == "planish":
        printed, code = _planish(words[1:])
    elif (
        program := shutil.which(words[0], path=str(Path(sys.executable).parent))
        or shutil.which(words[0])
    ) is None:
        return Outcome(step, "", passed_over=f"{words[0]} is not installed")
    elif words[-1] == "&":
        process = subprocess.Popen(
            [program, *words[1:-1]],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=_environment(),
        )
        background.callback(process.wait)
        background.callback(process.terminate)
        time.sleep(2.0)  # a scheduler answers only when it listens
        return Outcome(step, "")
    else:
        done = subprocess.run(
            [program, *words[1:]], capture_output=True, text=True, check=False, env=_environment()
        )
        printed, code = done.stdout + done.stderr, done.returncode
    faults = [] if fits(printed, step.expected) else ["it prints something else"]
    return Outcome(step, printed, code, faults)


def _environment():
    """Return an environment in which other processes find the planish that is tested."""
    return os.environ | {"PYTHONPATH": str(Path(planish.__file__).resolve().parents[1])}


def _planish(arguments):
    """Call the command line in this process: everything that it prints, in its order, and its exit
    code."""
    printed, code = io.StringIO(), 0
    columns = mock.patch.dict(os.environ, COLUMNS=_COLUMNS)
    with columns, contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        try:
            main(arguments)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0
    return printed.getvalue(), code


def _python(step, names):
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    test = doctest.DocTestParser().get_doctest(step.text, names, "page", None, None)
    printed = io.StringIO()
    runner = doctest.DocTestRunner(optionflags=flags, verbose=False)
    result = runner.run(test, out=printed.write, clear_globs=False)
    names.update(test.globs)
    outcome = Outcome(step, printed.getvalue())
    if result.failed:
        outcome.faults.append("Python gives something else")
    return outcome
