"""Tables: what is read, and that all faults of a file are named at once."""

import zipfile

import numpy as np
import pandas as pd
import pytest

from folders import refused
from planish.core.errors import FileError, MarkError
from planish.core.tables import (
    LARGEST_FILE,
    finite,
    heading_of,
    parse_table,
    read_text,
    split_rows,
    table_text,
)


def read(folder, text, *, encoding="utf-8", needed=("x_um", "y_um")):
    (folder / "t.csv").write_bytes(text.encode(encoding))
    table = parse_table(read_text(folder / "t.csv"), "t.csv", needed=needed, error=MarkError)
    found = table.numbers(needed)
    table.check()
    return found


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("delimiter", list(",;\t"))
def test_any_spreadsheet_gives_the_same(tmp_path, encoding, end, delimiter):
    rows = [["y_um ", "note", "X_um"], ["2", "\u00b5", "-1.5e3"], ["4", '"a b"', "0"]]
    text = end.join(["# from a spreadsheet", *(delimiter.join(row) for row in rows), "", ""])
    np.testing.assert_array_equal(
        read(tmp_path, text, encoding=encoding), [[-1500.0, 2.0], [0.0, 4.0]]
    )


TABLE = pd.DataFrame(
    {"note": ["a, b", "c; d", "e"], "x_um": [288.625, 2895.5, 0.125], "y_um": [-2.25, 1e-7, 1234.5]}
)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("delimiter", list(",;\t"))
@pytest.mark.parametrize("with_index", [True, False])
def test_what_pandas_writes_is_read(tmp_path, delimiter, decimal, encoding, with_index):
    path = tmp_path / "t.csv"
    TABLE.to_csv(path, sep=delimiter, decimal=decimal, encoding=encoding, index=with_index)
    table = parse_table(read_text(path), "t.csv", needed=("x_um", "y_um"), error=MarkError)
    np.testing.assert_array_equal(table.numbers(["x_um", "y_um"]), TABLE[["x_um", "y_um"]])
    assert [table.text(row, "note") for row in table.rows] == list(TABLE["note"])


@pytest.mark.parametrize(
    "text",
    [
        "sep=;\nx_um;y_um\n1,5;-2\n",  # a line of Excel's own
        "x_um;y_um;;\n1,5;-2;;\n;;;\n;;;\n",  # columns and lines that were emptied
        "x_um;y_um\n1,5;-2;\n",
        " ,x_um,y_um\n1,1.5,-2\n",
        "\tx_um\ty_um\n1\t1.5\t-2\n",
        '"x_um","y_um"\n"1,5","-2"\n',
    ],
)
def test_habits_of_spreadsheets(tmp_path, text):
    np.testing.assert_array_equal(read(tmp_path, text), [[1.5, -2]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x_um;y_um\n1,234;2\n", r"x_um '1,234' may be 1\.234 or 1234"),
        ('x_um,y_um\n"1,234",2.5\n', r"x_um '1,234' may be 1\.234 or 1234"),
        ("x_um;y_um\n1.234;2,5\n", r"x_um '1\.234' has a point, other numbers a decimal comma"),
        ("x_um;y_um\n1.234,5;2\n", r"'1\.234,5' is not a finite number; .* without a sign"),
        ("x_um;y_um\n1 234;2\n", "'1 234' is not a finite number"),
        ("x_um;y_um\n1'234;2\n", "is not a finite number"),
        ("x_um;y_um\n1_234;2\n", "'1_234' is not a finite number"),
        ("x_um,y_um\n1,5,2,5\n", "row 2 has 4 columns.*decimal commas need semicolons"),
    ],
)
def test_a_number_that_may_be_another_is_refused(tmp_path, text, words):
    refused(MarkError, words, read, tmp_path, text)


@pytest.mark.parametrize(
    ("headings", "factor"),
    [
        ("X (mm);Y (mm)", 1e3),
        ("x_nm;y_nm", 1e-3),
        ("X [\u00b5m];Y [\u03bcm]", 1.0),
        ("x / mm;y in mm", 1e3),
        ("X inch;Y inch", 25400.0),
    ],
)
def test_a_column_in_another_unit_is_converted(tmp_path, headings, factor):
    found = read(tmp_path, f"{headings}\n1,5;2\n")
    np.testing.assert_allclose(found, [[1.5 * factor, 2 * factor]], rtol=1e-15)


@pytest.mark.parametrize("headings", ["X (px);Y (px)", "x;y", "x (furlong);y (furlong)"])
def test_a_column_without_a_length_is_not_taken(tmp_path, headings):
    refused(MarkError, "columns missing: x_um, y_um", read, tmp_path, f"{headings}\n1;2\n")


@pytest.mark.parametrize(
    ("cell", "name", "unit"),
    [
        ("Centroid X \u00b5m", "centroid_x", "um"),
        ("Centroid Y px", "centroid_y", "pixel"),
        ("POSITION_X", "position_x", ""),
        ("axis-0", "axis_0", ""),
        ("X (furlong)", "x", "furlong"),
    ],
)
def test_headings(cell, name, unit):
    assert heading_of(cell) == (name, unit)


def test_a_workbook_is_named(tmp_path):
    path = tmp_path / "t.csv"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("xl/workbook.xml", "<workbook/>")
    refused(FileError, r"workbook of a spreadsheet.*CSV UTF-8", read_text, path)


def test_all_faults_are_named_up_to_a_number(tmp_path):
    text = 'x_um,x_um,z\n1,2\n\n3,4,5,6\na,1,2\n"b,1,2\n'
    with pytest.raises(MarkError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    for words in (
        "columns missing: y_um (found x_um, x_um, z)",
        "columns given twice: x_um",
        "row 2 has 2 columns, the header 3",
        "row 4 has 4 columns",
        "decimal commas need semicolons",
        "row 5: x_um 'a' is not a finite number",
        "row 6:",
    ):
        assert words in message
    assert message.count("y_um '") == 0
    refused(
        MarkError,
        r"; and 12 more\. Correct these rows\.",
        read,
        tmp_path,
        "x_um,y_um\n" + "1,one\n" * 20,
    )


@pytest.mark.parametrize("text", ["", "\n", "# nothing\n"])
def test_an_empty_table_says_what_is_needed(tmp_path, text):
    refused(MarkError, r"t\.csv is empty.*x_um, y_um", read, tmp_path, text)


def test_what_is_no_text_is_refused(tmp_path):
    place = tmp_path / "t.csv"
    for data in (b"x_um,\xff\n", b"\xff\xfea", b"x\0um,y_um\n"):
        place.write_bytes(data)
        refused(FileError, r"no text in UTF-8|binary data", read_text, place)
    place.write_bytes(b"1" * (LARGEST_FILE + 1))
    refused(
        FileError,
        "larger than 10 MB and no table of marks",
        read_text,
        place,
        what="table of marks",
    )
    refused(FileError, "does not exist", read_text, tmp_path / "none.csv")
    refused(FileError, "is no file", read_text, tmp_path)


def test_numbers_rows_and_written_tables_are_read():
    assert [
        finite(v) for v in (1, 2.5, "3", " 4e1 ", True, None, "1,5", "nan", "inf", 10**400, [1])
    ] == [
        1.0,
        2.5,
        3.0,
        40.0,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
    ]
    assert (finite("1,5", decimal_comma=True), finite("1,000.5", decimal_comma=True)) == (1.5, None)
    found = split_rows('"a, b";true; 1\n# comment \n c;false;2\n')
    assert found.rows == [(1, ["a, b", "true", "1"]), (3, ["c", "false", "2"])]
    assert (found.comments, found.delimiter, found.faults) == (["comment"], ";", [])
    values = [0.1, 1 / 3, np.float64(2e-300), np.float32(0.1)]
    text = table_text(["label", "x_um"], [[f"a {k}, b", v] for k, v in enumerate(values)])
    table = parse_table(text, "t", needed=("x_um",), error=MarkError)
    assert list(table.numbers(["x_um"])[:, 0]) == [float(v) for v in values]
    assert (table.text(table.rows[1], "label"), table.text(table.rows[0], "unit", "um")) == (
        "a 1, b",
        "um",
    )
