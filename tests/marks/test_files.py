"""Marks come from and go to files of other programs: the same places, to 1e-9 um."""

import struct
from pathlib import Path

import from_code
import numpy as np
import pytest
import xarray as xr
from scipy.io import loadmat

from core.test_matlab import file_of
from marks.files_by_hand import (
    FIXED,
    FIXED_PIXEL,
    LABELS,
    MOVING,
    MOVING_PIXEL,
    PAIRS,
    bigwarp_2d,
    bigwarp_3d,
    bigwarp_json,
    elastix,
    imagej,
    native,
    slicer,
    slicer_list,
)
from planish.core.errors import MarkError
from planish.marks import (
    LayerPixels,
    MarkPlaces,
    exchange,
    holes_of,
    layer_names,
    make_marks,
    read_any,
    read_holes,
    write_any,
    write_marks,
)
from planish.marks.exchange.formats import formats_table

PIXELS = {"moving": LayerPixels(MOVING_PIXEL), "fixed": LayerPixels(FIXED_PIXEL)}


def points(marks, layer):
    return np.stack([marks[f"{layer}_{axis}"].values for axis in "xy"], axis=1)


def same(marks, moving=MOVING, fixed=FIXED, *, atol=1e-9):
    np.testing.assert_allclose(points(marks, "moving"), moving, rtol=0, atol=atol)
    np.testing.assert_allclose(points(marks, "fixed"), fixed, rtol=0, atol=atol)
    return True


def mat(moving, fixed, version="6", *, names=("movingPoints", "fixedPoints")):
    """A MATLAB file of this version; 7.3 with the heading that MATLAB writes."""
    data = bytearray(file_of(version, dict(zip(names, (moving, fixed), strict=True))).getvalue())
    if version == "7.3":
        heading = (
            b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Mar  3 10:00:00 2025 HDF5"
            b" schema 1.00 ."
        )
        data[: len(heading)] = heading
    return bytes(data)


# --- what other programs write
def test_bigwarp_of_two_images_and_of_a_volume(put):
    path = put(bigwarp_2d(), "landmarks.csv")
    marks = read_any(path)
    assert same(marks)
    assert marks.label.values.tolist() == LABELS
    assert marks.attrs["read_from"] == {"format": "bigwarp", "unit": "um", "stated": False}
    assert same(read_any(put(bigwarp_json(), "landmarks.json")))
    marks = read_any(put(bigwarp_3d()))
    assert layer_names(marks) == ["volume", "fixed"]
    assert marks.volume_z.values.tolist() == [40.0, 41.0, 42.5, 39.0]
    # Two flat pictures.
    assert layer_names(read_any(put(bigwarp_3d(z=(0.0,) * 4)))) == ["moving", "fixed"]


def test_bigwarp_points_that_are_off_or_not_set(put):
    rows = bigwarp_2d().splitlines()
    rows[1] = rows[1].replace('"true"', '"false"')
    rows.append('"Pt-4","false","90.5","80.5","Infinity","Infinity"')
    marks = read_any(put("\n".join(rows)))
    assert marks.used.values.tolist() == [True, False, True, True, False]
    assert np.isnan(points(marks, "fixed")[4]).all()
    assert points(marks, "moving")[4].tolist() == [90.5, 80.5]
    pairs = exchange.used_pairs(marks)
    assert pairs.label.values.tolist() == ["Pt-0", "Pt-2", "Pt-3"]


def test_units_that_a_file_does_not_state(put):
    in_mm = put(bigwarp_2d(MOVING / 1000, FIXED / 1000))
    assert same(read_any(in_mm, unit="mm"))
    in_pixels = (
        put(elastix(MOVING / MOVING_PIXEL), "a.txt"),
        put(elastix(FIXED / FIXED_PIXEL), "b.txt"),
    )
    assert same(read_any(*in_pixels, unit="pixel", **PIXELS))


def test_elastix_and_results_of_imagej(put):
    a, b = put(elastix(MOVING / 1000), "mp.txt"), put(elastix(FIXED / 1000), "fp.txt")
    marks = read_any(a, b)
    assert same(marks)
    assert marks.attrs["read_from"] == {"format": "elastix", "unit": "mm", "stated": False}
    assert same(read_any(b, a, swap=True))
    a, b = put(imagej(MOVING), "a.csv"), put(imagej(FIXED), "b.csv")
    marks = read_any(a, b)
    assert same(marks)
    assert set(marks.moving_source.values) == {"clicked"}


@pytest.mark.parametrize("head", ["index\n", ""])
def test_elastix_index_is_pixels_from_nought(put, head):
    index = np.array([[0, 0], [100, 40], [7, 99]])
    text = elastix(index, "index")
    a, b = put(text.replace("index\n", head), "a.txt"), put(text, "b.txt")
    marks = read_any(a, b, moving=LayerPixels(2.5), fixed=LayerPixels((4.0, 3.0)))
    assert same(marks, index * 2.5, index * [3.0, 4.0])


def test_slicer_turns_ras_and_keeps_lps(put):
    lps = slicer_list(MOVING / 1000, "moving")
    ras = slicer_list(FIXED / 1000 * [-1, -1], "fixed", "RAS")
    assert same(read_any(put(slicer(lps, ras), "a.mrk.json")))
    assert same(read_any(put(slicer(ras, lps), "a.mrk.json")))  # named, so the order says nothing
    in_um = slicer_list(MOVING, "F", units=["um", "UCUM", "micrometer"])
    assert same(read_any(put(slicer(in_um), "b.mrk.json"), put(slicer(ras), "c.mrk.json")))


def test_slicer_points_not_set_or_not_selected_and_other_markups(put):
    moving, fixed = slicer_list(MOVING / 1000, "F"), slicer_list(FIXED / 1000, "G")
    moving["controlPoints"][1]["selected"] = False
    fixed["controlPoints"][3] |= {"positionStatus": "undefined", "position": [0.0, 0.0, 0.0]}
    del moving["controlPoints"][0]["positionStatus"]
    line = {"type": "Line", "controlPoints": [{"position": [0, 0, 0]}]}
    marks = read_any(put(slicer(line, moving, fixed, {"type": "Fiducial", "controlPoints": []})))
    assert marks.used.values.tolist() == [True, False, True, True]
    assert np.isnan(points(marks, "fixed")[3]).all()
    assert exchange.used_pairs(marks, least=2).label.values.tolist() == ["Pt-0", "Pt-2"]


@pytest.mark.parametrize(
    "options",
    [
        {"version": "4"},
        {"version": "6"},
        {"version": "7"},
        {"version": "7.3"},
        {"names": ("input_points", "base_points")},
    ],
)
def test_matlab_counts_from_one(put, options):
    path = put(mat(MOVING / MOVING_PIXEL + 1, FIXED / FIXED_PIXEL + 1, **options), "points.mat")
    assert same(read_any(path, **PIXELS))


def test_matlab_of_another_machine(put):
    data = b""
    for name, values in (
        (b"movingPoints", MOVING / MOVING_PIXEL + 1),
        (b"fixedPoints", FIXED / FIXED_PIXEL + 1),
    ):
        data += struct.pack(">5i", 1000, *values.shape, 0, len(name) + 1) + name + b"\0"
        data += values.T.astype(">f8").tobytes()
    assert same(read_any(put(data, "version4.mat"), **PIXELS))


def test_pairs_on_the_flat_map_with_foreign_labels_and_unused_rows(put):
    marks = read_any(
        put("\ufeff" + PAIRS.replace("Pt-0", '"Loch ü, links"').replace("\n", "\r\n"), "pairs.csv")
    )
    assert same(marks)
    assert marks.label.values.tolist() == ["Loch ü, links", *LABELS[1:]]
    pairs = exchange.used_pairs(marks)
    assert set(pairs.variables) == {"label", "moving_x", "moving_y", "fixed_x", "fixed_y"}
    assert all(pairs[name].attrs["units"] == "um" for name in pairs.variables if name != "label")
    rows = [
        row + end
        for row, end in zip(PAIRS.splitlines(), (",used", ",1", ",0", ",False", ",1"), strict=True)
    ]
    assert read_any(put("\n".join(rows))).label.values.tolist() == ["Pt-0", "Pt-3"]


def test_pairs_in_the_volume_in_any_order_of_columns(put):
    text = (
        "fixed_y_um;fixed_x_um;volume_z_um;volume_y_um;volume_x_um\n1;2;3;4;5\n\n# a"
        " remark\n6;7;8;9;10\n"
    )
    marks = exchange.used_pairs(read_any(put(text)), least=1)
    assert (marks.volume_x.values.tolist(), marks.fixed_y.values.tolist()) == (
        [5.0, 10.0],
        [1.0, 6.0],
    )
    assert "moving_x" not in marks
    assert marks.label.values.tolist() == ["1", "2"]


def test_holes_of_one_layer_also_beside_a_file_of_another_program(put):
    holes = "label,x_um,y_um,diameter_um\nhole 1,1.5,2.5,150\nhole 2,3.5,4.5,\n"
    marks = read_any(put(holes, "holes.csv"))
    assert (layer_names(marks), holes_of(marks, "marks").diameter.values[0]) == (["marks"], 150)
    unused = "label,x_um,y_um,used\na,1,2,1\nb,3,4,no\nc,5,6,1\n"
    assert read_any(put(unused, "unused.csv")).label.values.tolist() == ["a", "c"]
    assert same(read_any(put(bigwarp_2d().replace('"', ""), "no quotes.csv")))
    holes = "label,x_um,y_um\n" + "".join(
        f"{n},{x},{y}\n" for n, (x, y) in zip(LABELS, FIXED.tolist(), strict=True)
    )
    assert same(read_any(put(elastix(MOVING / 1000), "a"), put(holes, "holes.csv")))


def test_the_page_has_the_formats_of_the_table_and_its_example_is_read(put):
    page = (Path(__file__).resolve().parents[2] / "docs" / "marks-files.md").read_text(
        encoding="utf-8"
    )
    assert formats_table() in from_code.expand(page)
    marks = read_any(put(page.split("```json\n")[1].split("```")[0]))
    assert marks.label.values.tolist() == ["hole 1", "hole 2"]
    assert marks.attrs["layers"]["moving"]["size_px"] == {"x": 1200, "y": 1000}


# --- planish's own format
def test_own_json_holds_everything(put, tmp_path):
    marks = read_any(put(native(), "marks.json"))
    assert marks.label.values.tolist() == ["A", "B", "C, ü"]
    assert marks.used.values.tolist() == [True, False, True]
    assert (marks.moving_cov_xx[0], marks.moving_cov_xy[0], marks.moving_cov_yy[0]) == (
        4.0,
        0.5,
        2.0,
    )
    assert (marks.moving_diameter[0], marks.moving_axis_ratio[0], marks.moving_arc_coverage[0]) == (
        151.5,
        1.02,
        0.98,
    )
    assert np.isnan(marks.fixed_x[2])
    assert marks.fixed_source.values.tolist() == ["clicked", "predicted", "imported"]
    assert marks.residual.values[1] == 3.25
    layer = marks.attrs["layers"]["moving"]
    assert (layer["side"], layer["machine_direction_deg"], layer["origin_um"]) == (
        "top",
        90.0,
        {"x": -10.0, "y": 4.0},
    )
    (copy,) = write_any(marks, tmp_path / "copy.json")
    again = read_any(copy)
    xr.testing.assert_identical(again, marks)
    (third,) = write_any(again, tmp_path / "third.json")
    assert third.read_bytes() == copy.read_bytes()


def test_holes_of_one_layer_and_marks_of_three_come_back(tmp_path):
    holes = xr.Dataset(
        {k: ("mark", [v, v + 200.0]) for k, v in (("x", 100.1), ("y", 200.2), ("diameter", 150.0))}
    )
    holes["cov_xx"], holes["cov_yy"], holes["cov_xy"] = (("mark", [v, v]) for v in (4.0, 5.0, -1.0))
    one = exchange.marks_of_holes(holes, layer="image", about={"side": "top"})
    (path,) = write_any(one, tmp_path / "holes.json")
    back = holes_of(read_any(path), "image")
    for name in holes.data_vars:
        np.testing.assert_array_equal(back[name], holes[name])
    (table,) = write_any(one, tmp_path / "holes.csv")
    assert read_holes(table).x.values.tolist() == [100.1, 300.1]
    places = MarkPlaces(um=np.array([[1.0, 2.0], [np.nan, np.nan], [5.0, 6.5]]), source="clicked")
    three = make_marks(["a", "b", "c"], dict.fromkeys(("map", "unprinted", "printed"), places))
    (path,) = write_any(three, tmp_path / "three.json")
    assert layer_names(read_any(path)) == ["map", "unprinted", "printed"]
    pairs = exchange.used_pairs(read_any(path), moving="map", fixed="printed", least=2)
    assert pairs.moving_y.values.tolist() == [2.0, 6.5]


def test_marks_of_a_run_come_back_with_their_results_beside_the_pairs(tmp_path):
    names = (
        "moving_x",
        "moving_y",
        "fixed_x",
        "fixed_y",
        "residual_x",
        "residual_y",
        "residual",
        "leave_one_out",
    )
    values = np.random.default_rng(1).uniform(0, 1000, (8, 4))
    run = xr.Dataset({name: ("mark", column) for name, column in zip(names, values, strict=True)})
    (path,) = write_any(run, tmp_path / "run.json")
    marks = read_any(path)
    assert layer_names(marks) == ["moving", "fixed"]
    np.testing.assert_array_equal(marks.leave_one_out, run.leave_one_out)
    path = tmp_path / "marks.csv"
    write_marks(run.assign(used=("mark", [True, True, True, False])), path)
    header, first, *_, last = path.read_text(encoding="utf-8").splitlines()
    assert (
        header
        == "label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um,residual_um,leave_one_out_um,used"
    )
    assert float(first.split(",")[-2]) == values[-1, 0]
    assert (first[-2:], last[-2:]) == (",1", ",0")
    kept = read_any(path)
    np.testing.assert_array_equal(points(kept, "moving"), values[:2, :3].T)
    with pytest.raises(MarkError, match="either moving_x"):
        write_marks(run.drop_vars("moving_x"), tmp_path / "a.csv")


# --- there and back
def some_marks(side="moving", origin=(0.0, 0.0)):
    """Nine marks on a map, or in a ``volume``, and in an image."""
    rng = np.random.default_rng(5)
    first, fixed = (
        rng.uniform(-500, 20000, (9, 2 if side == "moving" else 3)),
        rng.uniform(0, 20000, (9, 2)),
    )
    first[0, 0], fixed[1, 0] = 1 / 3, 2e-300  # each digit counts in planish's own files
    about = {
        side: {"pixel_um": {"x": 2.5, "y": 2.7}, "origin_um": {"x": origin[0], "y": origin[1]}},
        "fixed": {"pixel_um": {"x": 4.0, "y": 4.1}},
    }
    places = {side: MarkPlaces(um=first), "fixed": MarkPlaces(um=fixed)}
    return make_marks([f"hole {k}" for k in range(9)], places, about=about)


BACK = {"moving": LayerPixels((2.7, 2.5), (-350.5, 20.25)), "fixed": LayerPixels((4.1, 4.0))}


@pytest.mark.parametrize(
    ("to", "unit"),
    [
        ("json", None),
        ("csv", None),
        ("bigwarp", None),
        ("bigwarp", "pixel"),
        ("elastix", None),
        ("elastix", "um"),
        ("slicer", None),
        ("matlab", None),
    ],
)
def test_there_and_back(tmp_path, to, unit):
    marks = some_marks(origin=(-350.5, 20.25))
    own = to in ("json", "csv")
    again = read_any(
        *write_any(marks, tmp_path / "out.x", to=to, unit=unit), unit=unit, **({} if own else BACK)
    )
    assert same(again, points(marks, "moving"), points(marks, "fixed"), atol=0.0 if own else 1e-9)
    assert again.attrs["read_from"]["format"] == to
    if to not in ("elastix", "matlab"):
        assert again.label.values.tolist() == marks.label.values.tolist()


@pytest.mark.parametrize("to", ["json", "csv", "bigwarp", "elastix", "slicer"])
def test_there_and_back_from_a_volume(tmp_path, to):
    marks = some_marks("volume")
    again = read_any(*write_any(marks, tmp_path / "out.x", to=to))
    for axis in "xyz":
        np.testing.assert_allclose(
            again[f"volume_{axis}"], marks[f"volume_{axis}"], rtol=0, atol=1e-9
        )
    assert layer_names(again) == ["volume", "fixed"]


def test_the_other_program_may_move_the_other_way(tmp_path):
    marks = some_marks()
    (path,) = write_any(marks, tmp_path / "a.csv", to="bigwarp", swap=True)
    first = path.read_text().splitlines()[0].replace('"', "").split(",")[2:]
    assert list(map(float, first)) == [*points(marks, "fixed")[0], *points(marks, "moving")[0]]
    assert same(read_any(path, swap=True), points(marks, "moving"), points(marks, "fixed"))


def test_layouts_are_those_of_the_other_programs(tmp_path, put):
    marks = read_any(put(bigwarp_2d()))
    (path,) = write_any(marks, tmp_path / "out.csv", to="bigwarp")
    assert path.read_text() == bigwarp_2d()
    files = write_any(marks, tmp_path / "e.txt")
    assert [f.name for f in files] == ["e-moving.txt", "e-fixed.txt"]
    assert files[0].read_text().splitlines()[:3] == ["point", "4", "0.25 0.5"]
    (mat,) = write_any(marks, tmp_path / "m.mat", **PIXELS)
    held = loadmat(mat)
    np.testing.assert_allclose(held["movingPoints"], MOVING / 2.5 + 1)
    assert held["fixedPoints"][0].tolist() == [101.5, 202.5]
    assert b"Created" not in mat.read_bytes()[:116]
    (mrk,) = write_any(marks, tmp_path / "s.mrk.json")
    text = mrk.read_text()
    assert '"coordinateSystem": "LPS"' in text
    assert '"positionStatus": "defined"' in text


def test_marks_without_a_partner_stay_where_the_format_has_a_place_for_them(tmp_path, put):
    marks = read_any(put(native(), "marks.json"))
    (path,) = write_any(marks, tmp_path / "b.csv", to="bigwarp")
    rows = path.read_text(encoding="utf-8").splitlines()
    assert rows[1].startswith('"B","false"')
    assert rows[2].endswith('"Infinity","Infinity"')
    (path,) = write_any(marks, tmp_path / "s.mrk.json")
    back = read_any(path)
    assert np.isnan(back.fixed_x[2])
    assert back.used.values.tolist() == [True, False, True]
    files = write_any(marks, tmp_path / "e.txt")
    assert all(f.read_text().splitlines()[1] == "1" for f in files)
