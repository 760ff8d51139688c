"""Mistakes in a study file: the line, the key, the word that was probably meant."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planish.core.errors import FileError, InputError
from planish.core.parameter_faults import key_lines
from planish.run import read_study


def said(tmp_path, text):
    path = tmp_path / "study.toml"
    path.write_bytes(text.encode())
    with pytest.raises(InputError) as error:
        read_study(path)
    return str(error.value)


STUDY = """\
# a study
planish = "0.2.0"
[volume]
path = "v.tif"
{}
[surface]
rim_um = 100.0
"""


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('thruogh = "y"', "volume.thruogh: unknown; did you mean through?"),
        ("point_um = 50", "volume.point_um: unknown here; point_um belongs to [correlate]"),
        (
            'through = "Y "',
            "volume.through: 'Y ' is not possible; needed is 'z', 'y' or 'x'; did you mean 'y'?",
        ),
        ("md_deg = 400", "volume.md_deg: Input should be less than or equal to 180 (found 400)"),
        (
            "fixed_rows = 3",
            (
                "volume.fixed_rows: 3 is not possible; needed are values in brackets, such as [1.5,"
                " 1.5]"
            ),
        ),
        (
            "voxel_um = [\n 3.0, # z\n -1.0,\n 3.0]",
            "volume.voxel_um.1: Input should be greater than 0 (found -1.0)",
        ),
        ("xyz = 1", "volume.xyz: unknown; there are channel, column_um"),
    ],
)
def test_line_key_and_likely_word_are_named(tmp_path, line, words):
    text = said(tmp_path, STUDY.format(line))
    assert "has 1 wrong parameter:\n  line 5, " + words in text


def test_tables_are_named_by_line_and_another_encoding_is_no_traceback(tmp_path):
    text = said(tmp_path, STUDY.format("") + "[imgae]\npath = 'i.png'\n")
    assert "line 8, imgae: unknown; did you mean image?" in text
    text = said(tmp_path, '[volume]\npath = "v"\n[image]\npixel_um = [2, 2]\n')
    assert "line 3, image.path: missing" in text
    text = said(
        tmp_path,
        '[[layers]]\nname = "a"\n[layers.volume]\npath = "v"\n[[layers]]\n\n[layers.image]\npaht'
        ' = "i"',
    )
    assert "line 8, layers.1.image.paht: unknown; did you mean path?" in text
    path = tmp_path / "s.toml"
    path.write_bytes("[volume]\npath = 'Núria.tif'\n".encode("cp1252"))
    with pytest.raises(FileError, match="UTF-8"):
        read_study(path)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (r'path = "C:\data\v.tif"', ("line 5, column", "single quotes: 'C:\\data\\volume.tif'")),
        ("voxel_um = 2,5", ("line 5, column 13", "decimal point")),
        ("through = y", ("line 5, column 11", "stand in quotes")),
        ("through", ("line 5", "A line reads key = value.")),
        ('path = "again"', ("line 5", "may be given once")),
        ('through = "y', ("line 5",)),
    ],
)
def test_what_is_no_toml_is_shown_with_what_to_write(tmp_path, line, words):
    text = said(tmp_path, STUDY.format(line))
    assert "is not a TOML file" in text
    assert line.splitlines()[0] in text
    for word in words:
        assert word in text


# --- the lines of keys, against the reader of the standard library --------------------------------

NAMES = st.sampled_from(["a", "b-1", '"c d"', "'e.f'", "x.y", " g . h "])
VALUES = st.sampled_from(
    [
        "1",
        '"text # [no] {comment}"',
        "'C:\\dir'",
        "[1,\n 2, # ]\n 3]",
        '"""\nlong [\n= " \n"""',
        "'''\n[x]\n'''",
        "{ p = 1, q = [2] }",
        '"a \\" b"',
        "[\n]",
        "1979-05-27T07:32:00Z",
    ]
)


def keys_of(data, place=()):
    """Places of all values, down to what a line may hold."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield (*place, key)
        if isinstance(value, dict) or (
            isinstance(value, list) and all(isinstance(v, dict) for v in value)
        ):
            yield from keys_of(value, (*place, key))


@given(
    st.lists(
        st.tuples(st.sampled_from(["", "[t]", "[[u]]", "[u.v]", "[[u.w]]"]), NAMES, VALUES),
        max_size=12,
    )
)
def test_every_key_has_the_line_on_which_it_stands(parts):
    text, starts = "# head\n", {}
    for table, name, value in parts:
        text += f"{table}\n" if table else ""
        starts[text.count("\n") + 1] = name
        text += f"{name} = {value} # end\n"
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return  # keys or tables given twice
    lines = key_lines(text)
    rows = text.split("\n")
    assert starts.keys() <= set(lines.lines.values())
    for key in keys_of(data):
        line = lines.of(key)
        assert line is not None
        last = next(part for part in reversed(key) if isinstance(part, str))
        if key in lines.lines:
            assert last in rows[line - 1]


def test_every_line_of_a_key_is_known():
    text = (
        'a = 1\nb.c = 2\n[t] # x\n"d e" = [\n1]\nf = """\n[no]\ng = 1"""\nh = {i = 1}\n'
        "[[u]]\nj=1\n[u.v]\nk=1\n[[u]]\nj=2\n"
    )
    found = key_lines(text).lines
    assert found == {
        ("a",): 1,
        ("b",): 2,
        ("b", "c"): 2,
        ("t",): 3,
        ("t", "d e"): 4,
        ("t", "f"): 6,
        ("t", "h"): 9,
        ("u",): 10,
        ("u", 0): 10,
        ("u", 0, "j"): 11,
        ("u", 0, "v"): 12,
        ("u", 0, "v", "k"): 13,
        ("u", 1): 14,
        ("u", 1, "j"): 15,
    }
    assert (key_lines(text).of(("t", "h", "i")), key_lines(text).of(("nowhere",))) == (9, None)
