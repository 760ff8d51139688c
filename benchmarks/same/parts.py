"""What both sides of a comparison do, part by part: commands of ``planish``, and changes through
the app."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import shutil
import signal
import subprocess
import time
import urllib.request
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import Any

SITE = Path(__file__).with_name("site")  # its sitecustomize gives both sides one version
_DRIVER = Path(__file__).with_name("driver.py")
_APPLY_S = 300.0


@dataclass(kw_only=True)
class Side:
    """One checkout at work: commands are run in the folder of a part, two levels above which the
    inputs lie."""

    python: Path
    source: Path
    home: Path
    core: int
    part: str = ""
    commands: list[dict[str, Any]] = field(default_factory=list)
    _driver: subprocess.Popen[str] | None = None

    @property
    def folder(self):
        """Where the part is done."""
        return self.home / self.part

    @property
    def environment(self):
        """Of every process: the sources of this side, one thread a library, one version."""
        path = os.pathsep.join(map(str, (SITE, self.source)))
        return os.environ | {"PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}

    def do(self, part):
        """Do a part, and list its commands with their exit codes."""
        self.part, self.commands = part, []
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        command = [str(self.python), str(_DRIVER), str(self.core)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        with subprocess.Popen(
            command, cwd=self.folder, env=self.environment, **pipes
        ) as self._driver:
            for line in PARTS[part].lines:
                self._done(line)
            self._driver.stdin.close()
        (self.folder / "commands.json").write_text(
            json.dumps(self.commands, indent=1), encoding="utf-8"
        )

    def planish(self, *arguments):
        """Run a command; what it prints stands in ``NN-VERB.json`` or ``.txt``, what it says of
        errors in ``.err``."""
        words = [str(word) for word in arguments]
        output = f"{len(self.commands):02d}-{words[0]}"
        asked = {
            "arguments": words,
            "output": output,
            "suffix": ".json" if "--json" in words else ".txt",
        }
        self._driver.stdin.write(json.dumps(asked) + "\n")
        self._driver.stdin.flush()
        code = int(self._driver.stdout.readline())
        self.commands.append({"command": " ".join(words), "exit": code})
        return code

    def _done(self, line):
        if line.startswith("! "):
            ACTS[line.removeprefix("! ")](self)
            return
        name, values = "", [""]
        if line.startswith("for "):
            loop, _, line = line.partition(": ")
            _, name, _, *values = loop.split()
        for value in values:
            names = _FILES | {name: Template(value).substitute(_FILES)}
            self.planish(*shlex.split(Template(line).substitute(names)))


@dataclass(frozen=True)
class Part:
    """What a part is, and its lines."""

    title: str
    lines: tuple[str, ...]


def read_parts(text):
    """Read the table of parts."""
    text = re.sub(r"^#.*\n", "", text, flags=re.MULTILINE)
    text = re.sub(r"\n +", " ", text)
    parts = re.findall(r"^\[(.+?)\] (.+)\n((?:.+\n)+)", text, flags=re.MULTILINE)
    return {name: Part(title, tuple(lines.splitlines())) for name, title, lines in parts}


_FILES = {
    "in": "../../inputs",
    "former": "../../inputs/former",
    "volume": "../../inputs/small/volume.tif",
    "image": "../../inputs/small/image.tif",
    "other": "../../inputs/other/volume.tif",
    "seen": "../../inputs/other/image.tif",
    "pixels": "--moving-pixel-um 4 --fixed-pixel-um 5",
}
PARTS = read_parts(Path(__file__).with_suffix(".txt").read_text(encoding="utf-8"))


# --- between the commands --------------------


def clicked(side):
    """Marks of the run, some um off."""
    head, *rows = (side.folder / "run" / "marks.csv").read_text(encoding="utf-8").splitlines()
    cells = [row.split(",") for row in rows]
    for k, column in enumerate(head.split(",")):
        if column.startswith("fixed_"):
            for n, row in enumerate(cells):
                row[k] = str(float(row[k]) + 4.0 * math.sin(7.0 * n + k))
    (side.folder / "clicked.csv").write_text(
        "\n".join([head, *map(",".join, cells)]) + "\n", encoding="utf-8"
    )


def listed(side):
    """A table of the runs of a series."""
    rows = [f"series/runs/s{k},{'AB'[k % 2]},{k}" for k in range(1, 5)]
    (side.folder / "runs.csv").write_text(
        "\n".join(["run,paper,sheet", *rows]) + "\n", encoding="utf-8"
    )


def changed(side):
    """Changes in the app, and its Apply."""
    with _Session(side, "run") as session:
        marks = json.loads((side.folder / "run" / "marks.json").read_text(encoding="utf-8"))[
            "marks"
        ]
        x, y = (float(marks[0]["at"]["moving"][axis]) for axis in "xy")
        session.change(
            do="add", label="by hand", moving=[x + 150.0, y + 150.0], fixed=[x + 160.0, y + 170.0]
        )
        session.change(do="model", model="affine")
        points = [
            {"z": z, "y": 500.0, "x": x, "face": "top"}
            for x, z in _face(side.folder / "run", (500, 540, 580))
        ]
        session.change(do="correct", points=points, reach_um=60.0, note="by hand")
        square = [[300.0, 300.0], [600.0, 300.0], [600.0, 500.0], [300.0, 500.0]]
        session.change(do="region", name="stain", reason="ink", author="A. Reader", polygon=square)
        session.apply()


ACTS = {"clicked": clicked, "listed": listed, "changed": changed}


# --- the app --------------------


class _Session:
    """``planish view`` of a run, which is asked as its page asks it."""

    def __init__(self, side, run):
        command = [str(side.python), "-m", "planish", "view", run, "--no-browser", "--json"]
        self.server = subprocess.Popen(
            command, cwd=side.folder, env=side.environment, stdout=subprocess.PIPE, text=True
        )
        self.address, _, self.token = json.loads(self.server.stdout.readline())["url"].partition(
            "/#token="
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.server.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            self.server.wait(30)
        self.server.kill()

    def change(self, **change):
        """Make a change."""
        self._asked("/api/change", {"change": change})

    def apply(self):
        """Make a new run of the changes, and wait for it."""
        self._asked("/api/apply", {})
        end = time.monotonic() + _APPLY_S
        while (progress := self._asked("/api/apply"))["state"] == "working":
            if time.monotonic() > end:
                raise TimeoutError(f"Apply is at {progress}.")
            time.sleep(0.3)
        if progress["state"] != "done":
            raise RuntimeError(f"Apply: {progress}")

    def _asked(self, path, body=None):
        head = {
            "Authorization": f"Bearer {self.token}",
            "Origin": self.address,
            "Content-Type": "application/json",
        }
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.address + path, data, head)
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.loads(answer.read())


def _face(run, columns):
    """Places x with heights of the top face 3 um above what was found, in the row at y = 500 um."""
    import zarr

    group = zarr.open_group(run / "maps.zarr" / "surfaces", mode="r")
    heights, y, x = (group[name][...] for name in ("top", "y", "x"))
    row = abs(y - 500.0).argmin()
    return [(float(place), float(heights[row, abs(x - place).argmin()]) + 3.0) for place in columns]
