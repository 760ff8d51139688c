"""Every command of the tutorial and of the how-to pages runs as it stands and prints what the page shows.

From a fresh clone to a map in ImageJ and a table in Octave a newcomer copies at most 15 commands from the documents.
"""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import tifffile

import console

DOCS = Path(__file__).resolve().parents[2] / "docs"
# Pages without such blocks speak of what a test cannot do here: another system, an installation.
PAGES = sorted(path for path in (DOCS / "how-to").glob("*.md") if console.steps(path.read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def after_tutorial(tmp_path_factory):
    """The folder in which the tutorial was carried out, and what went otherwise than it says."""
    folder = tmp_path_factory.mktemp("tutorial")
    page = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    return folder, console.report(console.run(page, folder))


@pytest.mark.nightly
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


# --- a newcomer -------------------------------------------------------------------------------------------------------

IMAGEJ = next((path for path in (Path("/usr/share/java/ij.jar"),) if path.exists()), None)
# What the newcomer types, and the document that it is copied from. The first two have made what these tests run in.
SET_UP = (("README.md", "python3 run.py demo"), ("README.md", "source .venv/bin/activate"))
COMMANDS = (
    (
        "tutorial.md",
        "planish specimen --size T1 --slab --seed 3 --voxel-um 6 --instrument ct --instrument image --out sheet",
    ),
    ("tutorial.md", "planish info sheet/scan --picture look.png"),
    ("tutorial.md", "planish info sheet/image.ome.tif"),
    (
        "tutorial.md",
        "planish link sheet/scan sheet/image.ome.tif --through y --image-side top --headline coating_top --out run",
    ),
    ("how-to/open-in-fiji.md", "planish export run --map coating_top --map image --to tiff --out coating.tif"),
    (
        "how-to/open-in-matlab.md",
        "planish export run --map coating_top --map image --to csv --point-um 100 --out points.csv",
    ),
    (
        "how-to/open-in-matlab.md",
        "octave-cli --quiet --eval \"t = dlmread('points.csv', ',', 2, 0); ok = all(isfinite(t), 2) & t(:, 5) > 0.5; "
        "printf('%d points, r = %.2f\\n', sum(ok), corr(t(ok, 3), t(ok, 4)))\"",
    ),
)
MEASURED = (
    (
        "how-to/not-paper.md",
        "planish map battery_sector_right --voxel-um 1 --through x --sheet-grey 100,255 --out wall",
    ),
    ("how-to/not-paper.md", "planish export wall --map thickness --to tiff --out wall.tif"),
)
# Dragging a file onto ImageJ, without a window.
OPEN = """
import sys, jpype
jpype.startJVM("-Djava.awt.headless=true", classpath=[sys.argv[1]])
image = jpype.JClass("ij.IJ").openImage(sys.argv[2])
size = image.getCalibration()
about = image.getWidth(), image.getHeight(), image.getBitDepth(), size.pixelWidth, size.getUnit()
print(*about, image.getStatistics().mean)
"""


def test_pages_are_short_with_few_commands():
    assert len((*SET_UP, *COMMANDS, *MEASURED)) <= 15
    for page, command in (*SET_UP, *COMMANDS, *MEASURED):
        text = (DOCS.parent / page if page == "README.md" else DOCS / page).read_text(encoding="utf-8")
        assert command in " ".join(text.split("\n")) or command in text, f"{page}: {command}"
    assert len(PAGES) >= 12
    for path in PAGES:
        lines = path.read_text(encoding="utf-8").splitlines()
        assert len(lines) <= 75, f"{path.name} is longer than a screen or two"


def test_the_first_lines_of_windows_stand_where_a_newcomer_begins():
    for page in (DOCS.parent / "README.md", DOCS / "how-to" / "windows.md"):
        text = page.read_text(encoding="utf-8")
        assert "\npy run.py demo\n" in text
        assert "Set-ExecutionPolicy -Scope Process" in text
        assert ".venv\\Scripts\\activate" in text


@pytest.fixture(scope="module")
def programs():
    """Skip where something that the newcomer uses is not there, and say what."""
    missing = console.unknown_verbs("".join(f"```console\n$ {command}\n```\n" for _, command in COMMANDS))
    if missing:
        pytest.skip(f"this planish has no command {', '.join(sorted(missing))}")
    if IMAGEJ is None or importlib.util.find_spec("jpype") is None:
        pytest.skip("ImageJ (the distribution's ij.jar) or JPype is not installed")
    if shutil.which("octave-cli") is None:
        pytest.skip("GNU Octave is not installed")


def carry_out(commands, folder):
    """Run the commands and return what each printed; none may fail."""
    page = "".join(f"```console\n$ {command}\n...\n```\n" for _, command in commands)
    outcomes = console.run(page, folder)
    for outcome in outcomes:
        assert outcome.code == 0, outcome.printed
    return [outcome.printed for outcome in outcomes]


def opened(path):
    """Width, height, bits, pixel size, unit and mean of a map as ImageJ has it."""
    done = subprocess.run(
        [sys.executable, "-c", OPEN, str(IMAGEJ), str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    width, height, bits, pixel, unit, mean = done.stdout.split()
    return (int(width), int(height), int(bits)), float(pixel), unit, float(mean)


@pytest.mark.nightly
@pytest.mark.usefixtures("programs")
def test_a_newcomer_gets_a_map_into_imagej_and_a_table_into_octave(after_tutorial, tmp_path):
    shutil.copytree(after_tutorial[0], tmp_path, dirs_exist_ok=True, copy_function=os.link)
    printed = carry_out([one for one in COMMANDS if one[0] != "tutorial.md"], tmp_path)
    assert "points, r = 0.3" in printed[-1]
    shape, pixel, unit, mean = opened(tmp_path / "coating.tif")
    assert (shape, pixel) == ((889, 670, 32), 4.0)
    assert unit in {"um", "µm", "micron"}
    values = tifffile.imread(tmp_path / "coating.tif")[0]
    assert mean == pytest.approx(float(values[values == values].mean(dtype=float)), rel=1e-5)


@pytest.mark.nightly
@pytest.mark.usefixtures("programs")
def test_the_same_with_a_measured_volume(shared_data, tmp_path):
    (tmp_path / "battery_sector_right").symlink_to(shared_data("battery_sector_right"))
    carry_out(MEASURED, tmp_path)
    (_, _, bits), pixel, _, mean = opened(tmp_path / "wall.tif")
    assert (bits, pixel, mean) == (32, pytest.approx(1.0, rel=0.05), pytest.approx(7.1, abs=0.5))


# --- the runner itself ---------------------------------------------------------------------------------------
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
    assert (outcomes[1].passed_over, outcomes[3].code) == ("no-such-program is not installed", 3)
    assert "planish, version 0" in console.report(outcomes)
