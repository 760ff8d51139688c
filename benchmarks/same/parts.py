"""What both sides of a comparison do, part by part: commands of ``planish``, and changes through the app."""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
import subprocess
import time
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SITE = Path(__file__).with_name("site")  # its sitecustomize gives both sides one version
_DRIVER = Path(__file__).with_name("driver.py")
_APPLY_S = 300.0


@dataclass(kw_only=True)
class Side:
    """One checkout at work: commands are run in the folder of a part, two levels above which the inputs lie."""

    python: Path
    source: Path
    home: Path
    core: int
    part: str = ""
    commands: list[dict[str, Any]] = field(default_factory=list)
    _driver: subprocess.Popen[str] | None = None

    @property
    def folder(self) -> Path:
        """Where the part is done."""
        return self.home / self.part

    @property
    def environment(self) -> dict[str, str]:
        """Of every process: the sources of this side, one thread a library, one version."""
        path = os.pathsep.join(map(str, (SITE, self.source)))
        return os.environ | {"PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}

    def do(self, part: str) -> None:
        """Do a part, and list its commands with their exit codes."""
        self.part, self.commands = part, []
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        command = [str(self.python), str(_DRIVER), str(self.core)]
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        with subprocess.Popen(command, cwd=self.folder, env=self.environment, **pipes) as self._driver:
            PARTS[part](self)
            assert self._driver.stdin is not None
            self._driver.stdin.close()
        (self.folder / "commands.json").write_text(json.dumps(self.commands, indent=1), encoding="utf-8")

    def planish(self, *arguments: str | float) -> int:
        """Run a command; what it prints stands in ``NN-VERB.json`` or ``.txt``, what it says of errors in ``.err``."""
        assert self._driver is not None
        assert self._driver.stdin is not None
        assert self._driver.stdout is not None
        words = [str(word) for word in arguments]
        output = f"{len(self.commands):02d}-{words[0]}"
        asked = {"arguments": words, "output": output, "suffix": ".json" if "--json" in words else ".txt"}
        self._driver.stdin.write(json.dumps(asked) + "\n")
        self._driver.stdin.flush()
        code = int(self._driver.stdout.readline())
        self.commands.append({"command": " ".join(words), "exit": code})
        return code

    def linked(self, out: str = "run") -> str:
        """The small specimen linked, for parts that begin with a run."""
        self.planish("link", *SMALL, "--out", out)
        return out


IN = "../../inputs"
SMALL = (f"{IN}/small/volume.tif", f"{IN}/small/image.tif")
OTHER = (f"{IN}/other/volume.tif", f"{IN}/other/image.tif")
PARTS: dict[str, Callable[[Side], None]] = {}


def part(function: Callable[[Side], None]) -> Callable[[Side], None]:
    """Put a part into the table, by its name with hyphens."""
    PARTS[function.__name__.replace("_", "-")] = function
    return function


# --- links --------------------


@part
def demo(side: Side) -> None:
    """The demo with its specimen, figures as files, and every number printed."""
    side.planish("demo", "--out", "demo", "--json")
    side.planish("run", "demo/run/run.toml", "--out", "again", "--set", "correlate.point_um=60")
    side.planish("correlate", "demo/run", "--json")


@part
def laid(side: Side) -> None:
    """A sheet through y whose top lies at the low end; the image shows its bottom."""
    lies = ("--through", "y", "--top", "low", "--image-side", "bottom")
    side.planish("link", f"{IN}/laid.tif", SMALL[1], *lies, "--out", "run", "--figures", "--json")


@part
def bottom(side: Side) -> None:
    """An image of the bottom."""
    side.planish("link", f"{IN}/upside-down.tif", SMALL[1], "--image-side", "bottom", "--out", "run")


@part
def sections(side: Side) -> None:
    """Serial sections, linked and imported."""
    side.planish("info", f"{IN}/sections/sections", "--json")
    side.planish("link", f"{IN}/sections/sections", SMALL[1], "--through", "y", "--out", "run")
    side.planish("import", f"{IN}/sections/sections", "--through", "y", "--out", "sheet.zarr")
    side.planish("map", "sheet.zarr", "--through", "y", "--out", "mapped")


@part
def two_volumes(side: Side) -> None:
    """Two scans of one sheet."""
    options = ("--error-ratio", 1, "--out", "run")
    side.planish("link", f"first={SMALL[0]}", f"second={OTHER[0]}", *options)


@part
def two_images(side: Side) -> None:
    """Two images of one sheet."""
    side.planish("link", f"first={SMALL[1]}", f"second={OTHER[1]}", "--out", "run")
    side.planish("link", f"first={IN}/wide.tif", f"second={IN}/wide-turned.tif", "--mottle", "--out", "wide")


@part
def chain(side: Side) -> None:
    """A sheet to an image, carried on to another one; and without the chain."""
    layers = (f"ct={SMALL[0]}", f"small={SMALL[1]}", f"large={OTHER[1]}")
    side.planish("link", *layers, "--chain", "--out", "run")
    side.planish("link", "run/layers/ct", f"small={SMALL[1]}", f"large={OTHER[1]}", "--out", "star")


@part
def labels(side: Side) -> None:
    """Labels of another program, and the published search slice by slice."""
    side.planish("map", f"{IN}/labels.tif", "--labels", "--out", "run")
    side.planish(
        "map", SMALL[0], "--surface-method", "paper", "--method", "relaxation", "--rest", "chord", "--out", "paper"
    )


@part
def look(side: Side) -> None:
    """Checks that ask for a look: the brightest grey is cut off."""
    side.planish("link", f"{IN}/cut-grey.tif", SMALL[1], "--out", "run", "--json")
    side.planish("report", "run", "--out", "page.html", "--figures")


@part
def refine(side: Side) -> None:
    """Marks that were clicked some um off, and the registration refined by the maps."""
    run = side.linked()
    head, *rows = (side.folder / run / "marks.csv").read_text(encoding="utf-8").splitlines()
    cells = [row.split(",") for row in rows]
    for k, column in enumerate(head.split(",")):
        if column.startswith("fixed_"):
            for n, row in enumerate(cells):
                row[k] = str(float(row[k]) + 4.0 * math.sin(7.0 * n + k))
    (side.folder / "clicked.csv").write_text("\n".join([head, *map(",".join, cells)]) + "\n", encoding="utf-8")
    for model in ("affine", "bspline"):
        side.planish("link", run, SMALL[1], "--marks", "clicked.csv", "--refine", model, "--out", model)


@part
def light(side: Side) -> None:
    """Kubelka and Munk, spread light, mottle, a print screen, partial correlations, a declared region."""
    run = side.linked()
    grey = ("--dark-grey", 1000, "--white-grey", 65000)
    more = ("--kubelka-munk", 0.002, "--light-spread-um", 30, "--mottle", "--beside", "base_thickness")
    side.planish("link", run, SMALL[1], *grey, *more, "--out", "reflectance")
    print_ = ("--printed", "--screen-um", 167, "--mottle")
    side.planish("link", run, f"{IN}/printed/image.tif", *print_, "--out", "print")
    side.planish("link", run, SMALL[1], "--regions", f"{IN}/regions.geojson", "--model", "affine", "--out", "regions")


@part
def properties(side: Side) -> None:
    """Every map there is."""
    names = (
        "thickness_envelope", "coating_top_sum", "coating_top_envelope", "roughness_top", "mean_curvature",
        "gaussian_curvature", "coating_absorption_top", "absorption", "absorption_base", "porosity", "filler",
        "fibre_angle", "fibre_anisotropy", "pore_chord", "ink_depth_50",
    )  # fmt: skip
    masses = ("--coating-density", 1.6, "--base-density", 0.75, "--grammage", 95, "--coat-weight-top", 25)
    grey = ("--solid-grey", 150, "--ink-grey", "150,255", "--envelope-um", 100)
    asked = [word for name in names for word in ("--property", name)]
    side.planish("map", SMALL[0], *asked, *masses, *grey, "--out", "run", "--json")
    side.planish("map", SMALL[0], "--property", "porosity", "--rays", "vertical", "--out", "vertical")


@part
def correct(side: Side) -> None:
    """Rings and cupping taken off a volume, which is then mapped in wide columns; facts of files."""
    corrections = ("--correct-rings", "--correct-cupping")
    side.planish("import", f"{IN}/rings.tif", *corrections, "--out", "sheet.zarr")
    side.planish("map", "sheet.zarr", "--column-um", 8, "--out", "run")
    for path in ("sheet.zarr", SMALL[0], SMALL[1], "run"):
        side.planish("info", path, "--json")


# --- what is made of runs --------------------


@part
def app(side: Side) -> None:
    """Marks, a corrected face and a region through the app's Apply; a run with other properties takes what stays."""
    with _Session(side, side.linked()) as session:
        marks = json.loads((side.folder / "run" / "marks.json").read_text(encoding="utf-8"))["marks"]
        x, y = (float(marks[0]["at"]["moving"][axis]) for axis in "xy")
        session.change(do="add", label="by hand", moving=[x + 150.0, y + 150.0], fixed=[x + 160.0, y + 170.0])
        session.change(do="model", model="affine")
        points = [{"z": z, "y": 500.0, "x": x, "face": "top"} for x, z in _face(side.folder / "run", (500, 540, 580))]
        session.change(do="correct", points=points, reach_um=60.0, note="by hand")
        square = [[300.0, 300.0], [600.0, 300.0], [600.0, 500.0], [300.0, 500.0]]
        session.change(do="region", name="stain", reason="ink", author="A. Reader", polygon=square)
        session.apply()
    side.planish("run", "run/run.toml", "--set", 'properties.maps=["porosity"]', "--out", "porous")


@part
def exports(side: Side) -> None:
    """A run in every format of the table, as files and as folders."""
    run = side.linked()
    surface = ("--map", "top", "--map", "thickness", "--mesh-um", 40)
    for to in ("tiff", "ome-tiff", "ome-zarr", "netcdf", "mat", "gwy", "txt", "csv", "png", "svg", "zarr", "crate"):
        side.planish("export", run, "--to", to, "--out", f"all-{to}")
    for to in ("ply", "obj", "stl", "vtk"):
        side.planish("export", run, "--to", to, *surface, "--out", f"mesh-{to}")
        side.planish(
            "export", run, "--to", to, *surface, "--as-seen", "--out", f"seen.{to}" if to != "vtk" else "seen.vtu"
        )
    for to in ("itk", "elastix", "bigwarp", "nrrd"):
        side.planish("export", run, "--to", to, "--out", f"moves-{to}")
    side.planish("export", run, "--to", "csv", "--point-um", 100, "--out", "points.csv")
    side.planish("export", run, "--to", "mat", "--mat-version", "7.3", "--map", "coating_top", "--out", "coating.mat")
    for to, out in (("tiff", "straight.tif"), ("ome-zarr", "straight.ome.zarr"), ("ome-tiff", "straight.ome.tif")):
        side.planish("export", run, "--to", to, "--group", "straightened", "--depth-um", "-60,60", "--out", out)
    for group in ("maps", "surfaces"):
        side.planish("export", run, "--to", "netcdf", "--group", group, "--out", f"{group}.nc")


@part
def explore(side: Side) -> None:
    """The page to look around in, of a link and of two images."""
    side.planish("explore", side.linked(), "--out", "sheet.html", "--json")
    side.planish("link", f"first={SMALL[1]}", f"second={OTHER[1]}", "--out", "images")
    side.planish("explore", "images", "--out", "images.html", "--json")


@part
def series(side: Side) -> None:
    """Four specimens as a study; the same compared as runs, with a margin."""
    # Beside its table, so that no path depends on the side.
    side.planish("study", f"{IN}/specimens.csv", "--out", "series", "--json")
    runs = [f"series/runs/s{k}" for k in range(1, 5)]
    table = [f"{run},{'AB'[k % 2]},{k}" for k, run in enumerate(runs, 1)]
    (side.folder / "runs.csv").write_text("\n".join(["run,paper,sheet", *table]) + "\n", encoding="utf-8")
    compared = ("--by", "paper", "--margin", "coating_top=0.5", "--margin", "r=0.1")
    side.planish("compare", "--table", "runs.csv", *compared, "--out", "compared", "--json")
    side.planish("compare", *runs, "--out", "alone", "--json")


@part
def marks(side: Side) -> None:
    """Marks in every format, out and in; linked from a table; planes of other pixels, swapped."""
    run = side.linked()
    pixels = ("--moving-pixel-um", 4, "--fixed-pixel-um", 5)
    targets = {"matlab": "m.mat", "slicer": "m.mrk.json", "bigwarp": "bigwarp.csv", "elastix": "m.txt", "csv": "m.csv"}
    for to, name in targets.items():
        side.planish("marks", "convert", f"{run}/marks.json", name, "--to", to, *pixels)
        files = ("m-moving.txt", "m-fixed.txt") if to == "elastix" else (name,)
        side.planish("marks", "convert", *files, f"back-{to}.json", *pixels, "--json")
        side.planish("marks", "convert", *files, f"swapped-{to}.json", *pixels, "--swap")
    side.planish("marks", "convert", f"{IN}/marks/moving.csv", f"{IN}/marks/fixed.csv", "imagej.json", "--unit", "um")
    side.planish("marks", "convert", f"{IN}/marks/bigwarp.json", "bigwarp-json.json", "--unit", "um")
    side.planish("link", run, SMALL[1], "--marks", "m.csv", "--model", "affine", "--out", "given")


@part
def design(side: Side) -> None:
    """Patterns of holes with their drawings and programs, checked and run dry; a link that knows its pattern."""
    for layout, field_um in (("coded", "3000,2000"), ("line", "20000,15000")):
        options = ("--field-um", field_um, "--layout", layout, "--pulse-code", "m64", "--out", layout, "--json")
        side.planish("marks", "design", *options)
        side.planish("marks", "check", f"{layout}/pattern.json", "--json")
        simulate = ("--pattern", f"{layout}/pattern.json", "--out", f"{layout}-path.png", "--json")
        side.planish("marks", "simulate", f"{layout}/program.gcode", *simulate)
    side.planish("specimen", "--size", "T1", "--instrument", "stack", "--instrument", "image", "--out", "specimen")


@part
def stages(side: Side) -> None:
    """The verbs of the stages, one after the other, and a study to be filled in."""
    volume, image = SMALL
    side.planish("surface", volume, "--out", "surfaces.zarr")
    side.planish("measure", "surfaces.zarr", "--property", "porosity", "--solid-grey", 150, "--out", "measured.zarr")
    side.planish("flatten", "surfaces.zarr", "--out", "flat.zarr")
    side.planish("resample", "measured.zarr", "flat.zarr", "--out", "maps.zarr")
    side.planish("holes", "maps.zarr", "--out", "sheet.json")
    side.planish("holes", image, "--out", "image.json")
    side.planish("register", "sheet.json", "image.json", "--out", "marks.json")
    onto = ("--onto", image, "--registration", "marks.json")
    side.planish("resample", "measured.zarr", "flat.zarr", *onto, "--out", "linked.zarr")
    side.planish("correlate", "linked.zarr", "--json")
    side.planish("new", "study.toml", volume, image)
    side.planish("run", "study.toml", "--out", "run")
    side.planish("report", "run", "--out", "page.html")


@part
def former(side: Side) -> None:
    """Runs of earlier versions: opened, reported, looked at, repeated."""
    for version in ("0.1.0", "0.2.0"):
        run = f"{IN}/former/{version}/run"
        side.planish("info", run, "--json")
        side.planish("correlate", run, "--json")
        side.planish("report", run, "--out", f"{version}.html")
        side.planish("explore", run, "--out", f"{version}-explored.html")
        side.planish("export", run, "--to", "tiff", "--out", f"{version}-tiff")
        side.planish("run", f"{run}/run.toml", "--out", version)


# --- the app --------------------


class _Session:
    """``planish view`` of a run, which is asked as its page asks it."""

    def __init__(self, side: Side, run: str) -> None:
        command = [str(side.python), "-m", "planish", "view", run, "--no-browser", "--json"]
        self.server = subprocess.Popen(
            command, cwd=side.folder, env=side.environment, stdout=subprocess.PIPE, text=True
        )
        assert self.server.stdout is not None
        self.address, _, self.token = json.loads(self.server.stdout.readline())["url"].partition("/#token=")

    def __enter__(self) -> _Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.server.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            self.server.wait(30)
        self.server.kill()

    def change(self, **change: Any) -> None:
        """Make a change."""
        self._asked("/api/change", {"change": change})

    def apply(self) -> None:
        """Make a new run of the changes, and wait for it."""
        self._asked("/api/apply", {})
        end = time.monotonic() + _APPLY_S
        while (progress := self._asked("/api/apply"))["state"] == "working":
            if time.monotonic() > end:
                raise TimeoutError(f"Apply is at {progress}.")
            time.sleep(0.3)
        if progress["state"] != "done":
            raise RuntimeError(f"Apply: {progress}")

    def _asked(self, path: str, body: Any = None) -> Any:
        head = {"Authorization": f"Bearer {self.token}", "Origin": self.address, "Content-Type": "application/json"}
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.address + path, data, head)
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.loads(answer.read())


def _face(run: Path, columns: tuple[int, ...]) -> list[tuple[float, float]]:
    """Places x with heights of the top face 3 um above what was found, in the row at y = 500 um."""
    import zarr

    group = zarr.open_group(run / "maps.zarr" / "surfaces", mode="r")
    heights, y, x = (group[name][...] for name in ("top", "y", "x"))
    row = abs(y - 500.0).argmin()
    return [(float(place), float(heights[row, abs(x - place).argmin()]) + 3.0) for place in columns]
