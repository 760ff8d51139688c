"""The comparison of two commits names every difference by place and size, and nothing that is the
same."""

import json

import numpy as np
import pytest
import tifffile
import xarray as xr
from benchmarks import same
from benchmarks.same.difference import differences

MAP = xr.Dataset(
    {"coating": (("v", "u"), np.array([[1.0, np.nan], [3.0, 4.0]]), {"units": "um"})},
    {"u": [0.0, 4.0]},
)
RESULTS = {"layers": [{"mean": 1.5, "checks": ["pass", None]}], "planish": "9.9.9"}


@pytest.fixture
def sides(tmp_path):
    """Two folders of the same results."""
    both = tmp_path / "old", tmp_path / "new"
    for side in both:
        MAP.to_zarr(side / "maps.zarr", consolidated=False)
        (side / "results.json").write_text(json.dumps(RESULTS))
        (side / "marks.csv").write_text("label,x\nA,1.0\n")
        (side / "00-link.err").write_text(f"{side.name}: what a command says may differ")
        (side / ".note").write_text(side.name)
    return both


def test_the_same_results_do_not_differ_and_renamed_numbers_are_named(sides):
    assert list(differences(*sides, {})) == []
    new = {"layers": [{"average": 1.75, "checks": ["look", None]}], "planish": "9.9.9"}
    (sides[1] / "results.json").write_text(json.dumps(new))
    assert dict(differences(*sides, {"layers[].mean": "layers[].average"})) == {
        "results.json:layers[0].average": "1.5 -> 1.75 (by 0.25)",
        "results.json:layers[0].checks[0]": "'pass' -> 'look'",
    }
    assert dict(differences(*sides, {}))["results.json:layers[0].mean"] == "only old: 1.5"


@pytest.mark.parametrize(
    ("changed", "place", "what"),
    [
        (
            MAP.assign(coating=MAP.coating.copy(data=[[1.0, np.nan], [3.0, 4.5]])),
            "coating",
            "1 of 4 values, by up to 0.5",
        ),
        (
            MAP.assign(coating=MAP.coating.copy(data=[[1.0, 2.0], [3.0, 4.0]])),
            "coating",
            "1 missing",
        ),
        (MAP.astype("f4", keep_attrs=True), "coating", "float64 (2, 2) -> float32 (2, 2)"),
        (MAP.assign(coating=MAP.coating.assign_attrs(units="mm")), "coating.units", "'um' -> 'mm'"),
        (MAP.assign_coords(u=[0.0, 5.0]), "u", "1 of 2 values, by up to 1"),
    ],
)
def test_arrays_types_attributes_and_coordinates_are_named(sides, changed, place, what):
    changed.to_zarr(sides[1] / "maps.zarr", mode="w", consolidated=False)
    found = dict(differences(*sides, {}))
    assert what in found[f"maps.zarr:{place}"]


def test_cells_pictures_pages_and_missing_files_are_named(sides):
    old, new = sides
    (new / "marks.csv").write_text("label,x\nA,1.25\n")
    for side, grey in zip(sides, (7, 8), strict=True):
        tifffile.imwrite(side / "map.tif", np.full((4, 4), grey, np.uint8))
        (side / "page.html").write_text(
            f"<p>{side.name} words: <b>{grey}</b> um</p><script>let a = 1</script>"
        )
    (old / "gone.bin").write_bytes(b"1")
    assert dict(differences(old, new, {})) == {
        "gone.bin": "only old",
        "map.tif": "16 of 16 values, by up to 1",
        "marks.csv:row 1": "'A, 1.0' -> 'A, 1.25'",
        "page.html:numbers": "'7' -> '8'",
    }


@pytest.mark.parametrize("words", [("HEAD", "--folder", "f", "part"), ("HEAD", "part", "--reuse")])
def test_parts_stand_before_or_behind_options(words):
    with pytest.raises(SystemExit, match="There is no part part"):
        same.main(*words)
