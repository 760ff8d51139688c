import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from folders import refused
from planish.core.errors import FileError, MarkError, PlanishError
from planish.marks import exchange, read_any, write_marks

FLAT = "label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um\n"
lengths = st.floats(-1e6, 1e6, allow_nan=False)


def read_marks(path):
    return exchange.used_pairs(read_any(path), least=1)


def read(tmp_path, text):
    path = tmp_path / "pairs.csv"
    path.write_text(text, encoding="utf-8")
    return read_marks(path)


def test_pairs_on_the_flat_map_with_foreign_labels_and_unused_rows(tmp_path):
    marks = read(tmp_path, FLAT + "A,1.5,2,10,20\nB,3,4e2,30,40\n")
    assert set(marks.variables) == {"label", "moving_x", "moving_y", "fixed_x", "fixed_y"}
    assert (marks.label.values.tolist(), marks.moving_y.values.tolist()) == (["A", "B"], [2.0, 400.0])
    assert all(marks[name].attrs["units"] == "um" for name in marks.variables if name != "label")
    path = tmp_path / "pairs.csv"
    path.write_bytes(("\ufeff" + FLAT + '"Loch, links",1,2,3,4\r\nü,5,6,7,8\r\n').encode())
    assert read_marks(path).label.values.tolist() == ["Loch, links", "ü"]
    marks = read(tmp_path, FLAT.strip() + ",used\nA,1,2,3,4,1\nB,5,6,7,8,0\nC,9,9,9,9,False\n")
    assert marks.label.values.tolist() == ["A"]


def test_pairs_in_the_volume_in_any_order_of_columns(tmp_path):
    text = "fixed_y_um;fixed_x_um;volume_z_um;volume_y_um;volume_x_um\n1;2;3;4;5\n\n# a remark\n6;7;8;9;10\n"
    marks = read(tmp_path, text)
    assert (marks.volume_x.values.tolist(), marks.fixed_y.values.tolist()) == ([5.0, 10.0], [1.0, 6.0])
    assert "moving_x" not in marks
    assert marks.label.values.tolist() == ["1", "2"]


@given(rows=st.lists(st.tuples(lengths, lengths, lengths, lengths), min_size=1, max_size=8))
def test_what_is_written_is_read_back_to_the_last_bit(tmp_path_factory, rows):
    table = np.array(rows)
    # Positions have to differ; the seventh decimal is enough.
    table += np.arange(len(table))[:, None] * 1e-3 + np.linspace(0, 1e-7, len(table))[:, None]
    if any(len({tuple(row) for row in side}) < len(side) for side in (table[:, :2], table[:, 2:])):
        return
    names = ("moving_x", "moving_y", "fixed_x", "fixed_y")
    marks = xr.Dataset({name: ("mark", table[:, column]) for column, name in enumerate(names)})
    marks["label"] = ("mark", [f"hole {row}" for row in range(len(table))])
    marks["residual_um"] = ("mark", np.full(len(table), np.nan))
    path = tmp_path_factory.mktemp("marks") / "pairs.csv"
    write_marks(marks, path)
    again = read_marks(path)
    for name in names:
        np.testing.assert_array_equal(again[name], marks[name])
    assert again.label.values.tolist() == marks.label.values.tolist()


def test_results_are_written_beside_the_pairs(tmp_path):
    marks = xr.Dataset(
        {name: ("mark", [1.0, 2.0]) for name in ("moving_x", "moving_y", "fixed_x", "fixed_y", "residual")}
        | {"leave_one_out": ("mark", [0.5, np.nan]), "used": ("mark", [True, False])}
    )
    path = tmp_path / "marks.csv"
    write_marks(marks, path)
    header, first, second = path.read_text(encoding="utf-8").splitlines()
    assert header == "label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um,residual_um,leave_one_out_um,used"
    assert (first.split(",")[-3:], second.split(",")[-1]) == (["1.0", "0.5", "1"], "0")


@pytest.mark.parametrize(("text", "message"), [
    (FLAT, "no pair"),
    ("label,moving_x_um,fixed_x_um\nA,1,2\n", "columns missing: moving_y_um, fixed_y_um"),
    ("moving_x_um,moving_y_um,volume_x_um,fixed_x_um,fixed_y_um\n1,2,3,4,5\n", "both moving and volume"),
    ("moving_x_um,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um\n1,1,2,3,4\n", "given twice: moving_x_um"),
    (FLAT + "A,1,2,3,4\nB,1,2,3\n", "row 3 has 4 columns, the header 5"),
    (FLAT + "A,1,2,3,4\nB,one,2,3,5\n", "row 3: moving_x_um 'one' is not a finite number"),
    (FLAT + "A,1,2,nan,4\n", "row 2: fixed_x_um 'nan'"),
    (FLAT + "A,1,2,inf,4\n", "row 2"),
    (FLAT + "A,1,2,,4\n", "row 2: fixed_x_um ''"),
    (FLAT + "A,1,2,3,4\nA,5,6,7,8\n", "label .A. is there 2 times"),
    (FLAT + "A,1,2,3,4\nB,1,2,7,8\n", "A and B have the same position in moving"),
    (FLAT + "A,1,2,3,4\nB,5,6,3,4\n", "A and B have the same position in fixed"),
    (FLAT + "".join(f"{k},x,2,3,4\n" for k in range(20)), "and 12 more"),
])  # fmt: skip
def test_faults_are_named_with_their_rows(tmp_path, text, message):
    refused(PlanishError, message, read, tmp_path, text)


def test_missing_files_sides_and_places_are_refused(tmp_path):
    (tmp_path / "binary.csv").write_bytes(b"\xff\x00\x01")
    refused(FileError, "UTF-8", read_marks, tmp_path / "binary.csv")
    with pytest.raises(MarkError, match="either moving_x"):
        write_marks(xr.Dataset({"fixed_x": ("mark", [1.0])}), tmp_path / "a.csv")
    whole = xr.Dataset({name: ("mark", [1.0]) for name in ("moving_x", "moving_y", "fixed_x", "fixed_y")})
    refused(FileError, "cannot be written: No such file", write_marks, whole, tmp_path / "no" / "a.csv")
