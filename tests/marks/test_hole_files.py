"""Holes in files: JSON gives back the same dataset to the last bit, CSV is the table to read."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from folders import refused
from marks.test_sheet_holes import CENTRES, PIXEL, dataset, layer_maps
from planish.core.errors import FileError, MarkError
from planish.marks import (
    find_holes,
    find_sheet_holes,
    hole_tilt,
    holes_from_json,
    holes_to_json,
    read_holes,
    write_holes,
)


@pytest.fixture(scope="module")
def found():
    maps = layer_maps(np.array([8.0, 0.0]), depth=np.array([1.0, 0.5, 1.0, 1.0, 1.0, 1.0]))
    return find_sheet_holes(dataset(*maps, layers_apart_um=52.0, layer_to_face=0.46))


def test_holes_of_a_sheet_come_back_from_json_and_csv(found, tmp_path):
    write_holes(found, tmp_path / "holes.json")
    back = read_holes(tmp_path / "holes.json")
    xr.testing.assert_identical(back, found)
    assert {k: v.dtype for k, v in back.items()} == {k: v.dtype for k, v in found.items()}
    assert (list(back.variables), hole_tilt(back)) == (list(found.variables), hole_tilt(found))
    assert np.isnan(back["x_bottom"].values).sum() == 1
    write_holes(back, tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "holes.json").read_bytes()
    assert '"through": 5' in (tmp_path / "holes.json").read_text()
    write_holes(found, tmp_path / "holes.csv")
    assert (tmp_path / "holes.csv").read_text().startswith("label,x_um,y_um,diameter_um\nhole 1,")
    back = read_holes(tmp_path / "holes.csv")
    for name in ("x", "y", "diameter"):
        np.testing.assert_array_equal(back[name], found[name])


def test_holes_of_an_image_with_what_others_add(tmp_path):
    holes = find_holes(layer_maps(np.zeros(2), centres=CENTRES[:3])[0], pixel_um=PIXEL)
    holes = holes.assign(
        label=("mark", ["a", "b, ü", ""]), used=("mark", [True, False, True]), n=("mark", [1, 2, 3])
    )
    holes = holes.assign_attrs(plane="image", offset_um=[np.nan, 1.5])
    write_holes(holes, tmp_path / "holes.json")
    assert json.loads((tmp_path / "holes.json").read_text(encoding="utf-8"))["plane"] == "image"
    xr.testing.assert_identical(read_holes(tmp_path / "holes.json"), holes)
    none = holes.isel(mark=slice(0))
    xr.testing.assert_identical(holes_from_json(json.loads(json.dumps(holes_to_json(none)))), none)


def test_every_float_survives():
    values = np.array([0.1, 1 / 3, -2e-300, 5e-324, 1.7e308, -0.0, np.nan])
    holes = xr.Dataset(dict.fromkeys("xy", ("mark", values)))
    back = holes_from_json(json.loads(json.dumps(holes_to_json(holes), allow_nan=False)))
    assert back["x"].values[:-1].tobytes() == values[:-1].tobytes()
    assert np.isnan(back["x"].values[-1])


@pytest.mark.parametrize("text", ["x,y\n1,2\n", "X (px);Y (px)\n1;2\n", "label;a\nb;c\n"])
def test_the_headings_that_a_table_needs_are_named(tmp_path, text):
    (tmp_path / "holes.csv").write_text(text)
    refused(MarkError, "columns missing: x_um, y_um .found", read_holes, tmp_path / "holes.csv")


def test_a_table_of_a_german_spreadsheet_in_mm(tmp_path):
    (tmp_path / "holes.csv").write_text("Label;X (mm);Y (mm);Diameter (um)\na;1,5;2;150,5\n")
    holes = read_holes(tmp_path / "holes.csv")
    values = [float(holes[name][0]) for name in ("x", "y", "diameter")]
    assert values == [1500.0, 2000.0, 150.5]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "planish-marks"}, "no 'planish-holes'"),
        ({"version": 2}, "version 2.*Update planish"),
        ({"units": "mm"}, "units: .*'um'"),
        ({"more": 1}, "more: "),
        ({"variables": {}}, "no x; no y"),
    ],
)
def test_a_malformed_file_is_refused(found, change, words):
    refused(MarkError, words, holes_from_json, holes_to_json(found) | change, "holes.json")


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({"type": "complex128"}, "variables.x.type: .*'float64'"),
        ({"values": [1.0, 2.0]}, "2, 6 values"),
        ({"values": [1.0, 2.0, 3.0, "4", 5.0, 6.0]}, "variables.x.values.3: .*number"),
        ({"values": [1.0, 2.0, 3.0, float("inf"), 5.0, 6.0]}, "variables.x.values.3: .*finite"),
        ({"type": "uint8", "values": [1, 2, 3, 256, 5, 6]}, "variables.x.values.3: .*255"),
        ({"type": "int64", "values": [1, 2, 3, 2**63, 5, 6]}, "variables.x.values.3: "),
        ({"type": "str"}, "variables.x.values.0: .*string"),
        ({"type": "bool"}, "variables.x.values.0: .*boolean"),
        ({"unit": "um"}, "variables.x.unit: "),
    ],
)
def test_a_malformed_variable_is_named(found, part, words):
    content = holes_to_json(found)
    content["variables"]["x"] = content["variables"]["x"] | part
    refused(MarkError, words, holes_from_json, content)


def test_what_has_no_place_in_a_file_or_is_no_file_of_holes(found, tmp_path):
    infinite = np.full(6, np.inf)
    for wrong in (
        found.assign_attrs(a=1j),
        found.assign_attrs(a=[np.inf]),
        found.assign(a=("mark", infinite)),
    ):
        refused(MarkError, "cannot be written", holes_to_json, wrong)
    refused(
        MarkError,
        "two has dims",
        holes_to_json,
        found.assign(two=(("mark", "k"), np.zeros((6, 2)))),
    )
    refused(FileError, r"\.json keeps everything", write_holes, found, tmp_path / "holes.txt")
    (tmp_path / "holes.json").write_text("{")
    refused(FileError, "already there", write_holes, found, tmp_path / "holes.json")
    refused(FileError, "damaged JSON", read_holes, tmp_path / "holes.json")
    for text, words in (
        ("x_um,y_um\n", "no hole"),
        ("x_um\n1\n", "columns missing: y_um"),
        ("x_um,y_um\n1,2\n3,a\n", "row 3: y_um 'a'"),
    ):
        (tmp_path / "holes.csv").write_text(text)
        refused(MarkError, words, read_holes, tmp_path / "holes.csv")


def test_the_example_of_the_page():
    page = (Path(__file__).resolve().parents[2] / "docs" / "marks.md").read_text(encoding="utf-8")
    holes = holes_from_json(json.loads(page.split("```json\n")[1].split("```")[0]))
    assert holes["x"].values.tolist() == [102.5, 873.25]
    assert holes.attrs == {"polarity": "dark", "plane": "image"}
