"""Files of a designed pattern, and the commands that write and read them."""

import json
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from folders import refused
from planish.cli import main
from planish.core.errors import MarkError
from planish.design import Pattern, holes_csv, pattern_dxf, read_pattern
from planish.design.draw import drawing_page, house_style
from planish.marks import read_holes

FIELD = ("--field-um", "9000,8000")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("made") / "marks"
    with pytest.raises(SystemExit) as end:
        main(["marks", "design", *FIELD, "-o", str(out), "--name", "Rolle 7 ä $x$"])
    assert not end.value.code
    return out


def test_patterns_come_back_from_json_and_csv(pattern, tmp_path):
    assert Pattern.from_json(pattern.to_json()) == pattern
    data = json.loads(pattern.to_json())
    assert (data["version"], data["holes"][0].keys()) == (1, {"label", "x_um", "y_um", "line"})
    path = tmp_path / "holes.csv"
    path.write_text(holes_csv(pattern))
    assert path.read_text().splitlines()[0] == "label,x_um,y_um,diameter_um"
    held = read_holes(path)
    np.testing.assert_allclose(np.stack([held["x"], held["y"]], 1), pattern.points_um, atol=1e-6)
    own = read_pattern(path, field_um=pattern.field_um)
    np.testing.assert_allclose(own.points_um, pattern.points_um, atol=1e-6)
    assert (own.diameter_um, own.margin_um) == (175.0, pytest.approx(pattern.margin_um))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"version": 2}, "version 2"),
        ({"format": "other"}, "holds no"),
        ({"holes": [{"x_um": 1}]}, "holes.0.y_um: Field required"),
        ({"holes": []}, "holes: .*at least 3"),
        ({"field_um": [-1, 5]}, "field_um.0: .*greater than 0"),
        ({"diameter_um": float("inf")}, "diameter_um: .*finite number"),
        ({"layout": "spiral"}, "layout: .*'line'"),
    ],
)
def test_malformed_patterns_are_refused(pattern, change, word):
    refused(MarkError, word, Pattern.from_json, json.dumps(json.loads(pattern.to_json()) | change))
    refused(MarkError, "no JSON", Pattern.from_json, pattern.to_json()[:-40])


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("x_um,y_um\n1,two\n", "row 2: y_um .two."),
        ("x_um,y_um\n", "0 holes"),
        ("x_um,y_um,diameter_um\n0,0,0\n1,1,0\n2,0,0\n", "diameter of 0 um"),
    ],
)
def test_malformed_tables_are_refused(tmp_path, text, word):
    path = tmp_path / "own.csv"
    path.write_text(text)
    refused(MarkError, word, read_pattern, path)


def dxf_pairs(text):
    lines = text.splitlines()
    assert len(lines) % 2 == 0
    return [(int(code), value) for code, value in zip(lines[::2], lines[1::2], strict=True)]


def test_dxf_by_the_published_group_codes(pattern):
    """Sections open and close, layers are declared before use, and circles of layer HOLES are the
    holes."""
    pairs = dxf_pairs(pattern_dxf(pattern))
    assert pairs[-2:] == [(0, "ENDSEC"), (0, "EOF")]
    assert [value for code, value in pairs if (code, value) in ((0, "SECTION"), (0, "ENDSEC"))] == [
        "SECTION",
        "ENDSEC",
        "SECTION",
        "ENDSEC",
        "SECTION",
        "ENDSEC",
    ]
    assert pairs[pairs.index((9, "$ACADVER")) + 1] == (1, "AC1009")
    start = pairs.index((2, "ENTITIES"))
    layers = {pairs[k + 1][1] for k, pair in enumerate(pairs[:start]) if pair == (0, "LAYER")}
    starts = [k for k, pair in enumerate(pairs) if k > start and pair[0] == 0]
    entities = [dict(pairs[a:b]) for a, b in pairwise(starts[:-1])]
    assert sum(map(len, entities)) == starts[-2] - starts[0]  # no code twice
    assert {code for entity in entities for code in entity} <= {0, 1, 8, 10, 20, 30, 11, 21, 31, 40}
    assert {entity[8] for entity in entities} <= layers
    assert {entity[0] for entity in entities} == {"CIRCLE", "LINE", "TEXT"}
    holes = [entity for entity in entities if entity[0] == "CIRCLE" and entity[8] == "HOLES"]
    found = 1000 * np.array([[float(hole[10]), float(hole[20])] for hole in holes])
    np.testing.assert_allclose(found, pattern.points_um, atol=0.0005 + 1e-9)
    assert {float(hole[40]) for hole in holes} == {0.0875}  # mm


def test_dxf_is_ascii(pattern):
    assert pattern_dxf(pattern.model_copy(update={"name": "Prüfung\n  0\nEOF"})).isascii()
    assert dxf_pairs(pattern_dxf(pattern.model_copy(update={"name": "a\n  0\nEOF"})))[0][0] == 999


@pytest.mark.ci
def test_a_design_is_a_whole_folder(made):
    names = {path.name for path in made.iterdir()}
    assert names == {
        "pattern.json",
        "holes.csv",
        "holes_as_imaged.csv",
        "pattern.dxf",
        "program.gcode",
        "drawing.svg",
        "drawing.png",
        "drawing.pdf",
        "predicted_error.png",
        "path.png",
    }
    pdf = (made / "drawing.pdf").read_bytes()
    assert pdf.startswith(b"%PDF")
    assert b"/Count 3" in pdf
    svg = (made / "drawing.svg").read_text()
    # A4 across, so that one mm on paper is one mm of the true-size drawing.
    assert 'width="841.889764pt"' in svg
    with Image.open(made / "drawing.png") as picture:
        grey = np.asarray(picture.convert("L"))
    assert 0.002 < (grey < 128).mean() < 0.2


@pytest.mark.ci
def test_the_true_size_is_true(pattern):
    """The view is so many millimetres wide on the page as in the stage's coordinates."""
    with house_style():
        page = drawing_page(pattern)
    width_mm = [axes.get_position().width * page.width for axes in page.figure.axes]
    assert any(width == pytest.approx(pattern.view_um[0] / 1000) for width in width_mm)
    for axes in page.figure.axes:
        (low, high), box = axes.get_xlim(), axes.get_position()
        scale = box.width * page.width / (high - low)
        assert box.height * page.height / np.ptp(axes.get_ylim()) == pytest.approx(scale)


@pytest.mark.ci
def test_the_same_command_gives_the_same_bytes(passes, made, tmp_path):
    out, _ = passes("marks", "design", *FIELD, "-o", tmp_path / "m", "--name", "Rolle 7 ä $x$")
    assert "crop told apart" in out
    assert "predicted error" in out
    for path in made.iterdir():
        assert path.read_bytes() == (tmp_path / "m" / path.name).read_bytes(), path.name


@pytest.mark.ci
def test_simulate(passes, made, tmp_path):
    program, pattern = made / "program.gcode", made / "pattern.json"
    out, _ = passes("marks", "simulate", program, "--pattern", pattern, "-o", tmp_path / "path.svg")
    assert "the shots are those of" in out
    assert (tmp_path / "path.svg").stat().st_size > 5000
    out, _ = passes("marks", "simulate", program, "--json")
    assert json.loads(out)["shots"] == len(json.loads(pattern.read_text())["holes"])
    shifted = tmp_path / "shifted.csv"
    label, x, y, diameter = (made / "holes.csv").read_text().splitlines()[3].split(",")
    moved = ",".join([label, str(float(x) + 0.01), y, diameter])
    shifted.write_text(
        (made / "holes.csv").read_text().replace(",".join([label, x, y, diameter]), moved)
    )
    _, err = passes("marks", "simulate", program, "--pattern", shifted, codes=(4,))
    assert "0.010 um from the nearest shot" in err


@pytest.mark.ci
def test_check(passes, made, tmp_path):
    passes("marks", "check", made / "holes_as_imaged.csv", *FIELD)
    grid = tmp_path / "grid.csv"
    grid.write_text(
        "x_um,y_um\n" + "".join(f"{2000 * i},{2000 * j}\n" for i in range(5) for j in range(4))
    )
    out, err = passes("marks", "check", grid, codes=(4,))
    assert "BROKEN" in out
    for rule in ("around", "half turn", "mirror", "shift", "code"):
        assert f"rule '{rule}'" in err
    out, _ = passes("marks", "check", grid, "--json", codes=(4,))
    assert not all(rule["passed"] for rule in json.loads(out)["rules"])


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (("design", "-o", "OUT"), 2, "--field-um"),
        (("design", "--field-um", "20000", "-o", "OUT"), 2, "W,H"),
        (("design", "--field-um", "0,5", "-o", "OUT"), 2, "greater"),
        (("design", *FIELD), 2, "--out"),
        (("design", *FIELD, "-o", "OUT", "--layout", "spiral"), 2, "spiral"),
        (("design", *FIELD, "-o", "OUT", "--holes", "20", "--holes-per-cm2", "9"), 2, "not both"),
        (("design", *FIELD, "-o", "OUT", "--power", "9", "--pulse-code", "m64"), 2, "m3 only"),
        (
            ("design", "--field-um", "3000,2000", "--margin-um", "300", "-o", "OUT"),
            3,
            "rule 'area'",
        ),
        (
            ("design", *FIELD, "-o", "OUT", "--range-um", "0,0,5000,5000"),
            3,
            "out of the stage's range",
        ),
        (("design", *FIELD, "-o", "HERE"), 3, "exists already"),
        (("check", "none.json"), 3, "does not exist"),
        (("simulate", "BROKEN"), 3, "not in the dialect"),
        (("simulate", "BROKEN", "-o", "way.gif"), 2, "no .png"),
        (("check", "BINARY"), 3, "UTF-8"),
    ],
)
def test_bad_input_ends_with_a_sentence(refuses, tmp_path, arguments, code, word):
    (tmp_path / "broken.gcode").write_text("G21\nhello\n")
    (tmp_path / "binary").write_bytes(b"\xff\x00{")
    names = {"OUT": "out", "HERE": ".", "BROKEN": "broken.gcode", "BINARY": "binary"}
    refuses(
        "marks",
        *(tmp_path / names[a] if a in names else a for a in arguments),
        words=word,
        code=code,
        out=False,
    )
