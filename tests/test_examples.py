"""The examples run as they stand, each writes its picture, and docs/examples.md names them all."""

import re
import runpy
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
CHEAPEST = "05_"
MEASURED = {
    "11_wound_cell": "battery_sector_right",
    "12_letter_packet": "letterpacket_ct",
    "13_dot_pattern": "dot_patterns",
    "14_tissue": "tissue_sheet_mesh",
    "15_height_map": "heightmaps",
}


def run(example, folder, monkeypatch):
    """Run an example as a script that gets a folder."""
    plt.switch_backend("agg")
    monkeypatch.setattr(sys, "argv", [str(example), str(folder)])
    runpy.run_path(str(example), run_name="__main__")
    plt.close("all")
    assert [path.stem for path in folder.glob("*.png")] == [example.stem]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_compiles(example):
    text = example.read_text(encoding="utf-8")
    compile(text, str(example), "exec")
    assert len(text.splitlines()) < 90
    assert f"python examples/{example.name} [FOLDER]" in text


def test_the_page_shows_every_example_with_its_picture():
    text = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
    assert re.findall(r"\(\.\./examples/(\w+)\.py\)", text) == [path.stem for path in EXAMPLES]
    assert re.findall(r"\(images/examples/(\w+)\.png\)", text) == [path.stem for path in EXAMPLES]
    assert sorted(path.stem for path in (ROOT / "docs/images/examples").glob("*.png")) == [
        p.stem for p in EXAMPLES
    ]


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(
            path,
            id=path.stem,
            marks=pytest.mark.ci if path.stem.startswith(CHEAPEST) else pytest.mark.nightly,
        )
        for path in EXAMPLES
        if path.stem not in MEASURED
    ],
)
def test_an_example_runs(example, tmp_path, monkeypatch):
    run(example, tmp_path, monkeypatch)


@pytest.mark.nightly
@pytest.mark.parametrize("name", MEASURED)
def test_an_example_on_measured_data_runs(name, shared_data, tmp_path, monkeypatch):
    monkeypatch.setenv("PLANISH_DATA", str(shared_data(MEASURED[name]).parent))
    run(ROOT / "examples" / f"{name}.py", tmp_path, monkeypatch)


def test_measured_data_are_shown_with_their_licence():
    text = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
    for name in MEASURED:
        (section,) = re.findall(
            rf"^### [^\n]*\n\n(?:(?!^###).)*?{name}\.py", text, re.MULTILINE | re.DOTALL
        )
        assert re.search(r"(MIT|Apache-2\.0) licence", section)
        assert "licence" in (ROOT / "examples" / f"{name}.py").read_text(encoding="utf-8")
