"""``planish marks convert``, and marks of other programs in a link."""

import json
from types import SimpleNamespace

import numpy as np

from marks.files_by_hand import FIXED, MOVING, bigwarp_2d, elastix
from marks.test_files import mat_v5, same
from planish.core.errors import PlanishError
from planish.core.grid import Grid
from planish.marks.files import LayerPixels, Places, make_marks, read_any, write_any
from planish.pipeline.registration import read_given


def test_convert_from_bigwarp_to_everything(planish, tmp_path):
    source = tmp_path / "landmarks.csv"
    source.write_text(bigwarp_2d())
    code, out, err = planish("marks", "convert", source, tmp_path / "marks.json")
    assert code == 0, err
    assert "marks.json: 4 marks (4 used) in moving, fixed" in out
    assert "BigWarp states no unit; the positions were taken as um (--unit)" in err
    sizes = ("--moving-pixel-um", "2.5", "--fixed-pixel-um", "4.0,4.0")
    for name, to in (
        ("a.mrk.json", None),
        ("a.csv", None),
        ("a.mat", None),
        ("b.csv", "bigwarp"),
        ("a.json", "slicer"),
    ):
        how = ("--to", to) if to else ()
        code, _, err = planish("marks", "convert", tmp_path / "marks.json", tmp_path / name, *how, *sizes)
        assert code == 0, err
        assert same(read_any(tmp_path / name, moving=LayerPixels(2.5), fixed=LayerPixels(4.0)))
    code, out, err = planish("marks", "convert", tmp_path / "marks.json", tmp_path / "e.txt")
    assert code == 0, err
    assert "e-moving.txt" in out
    assert "fixed to moving" in err
    both = (tmp_path / "e-moving.txt", tmp_path / "e-fixed.txt")
    code, out, err = planish("marks", "convert", *both, tmp_path / "back.json", "--json")
    assert code == 0, err
    assert json.loads(out)["read"] == {"format": "elastix", "unit": "mm", "stated": False}
    assert same(read_any(tmp_path / "back.json"))


def test_convert_asks_for_what_it_needs(planish, tmp_path):
    (tmp_path / "m.mat").write_bytes(mat_v5(MOVING, FIXED))
    code, _, err = planish("marks", "convert", tmp_path / "m.mat", tmp_path / "m.json")
    assert code == 3
    assert "--moving-pixel-um" in err
    assert not (tmp_path / "m.json").exists()
    code, _, err = planish("marks", "convert", tmp_path / "m.mat", tmp_path / "m.json", "--moving-pixel-um", "2;3")
    assert (code, "SIZE|Y,X|Z,Y,X" in err) == (2, True)
    code, _, err = planish("marks", "convert", tmp_path / "m.mat")
    assert (code, "IN and OUT" in err) == (2, True)
    (tmp_path / "fp.txt").write_text(elastix(FIXED))
    origin = ("--moving-origin-um", "-350,20", "--moving-pixel-um", "1", "--fixed-pixel-um", "1")
    assert planish("marks", "convert", tmp_path / "m.mat", tmp_path / "m.json", *origin)[0] == 0
    code, _, err = planish("marks", "convert", tmp_path / "m.json", tmp_path / "out.csv", "--to", "bigwarp")
    assert code == 0
    assert "moving: positions count from its first pixel, at -350,20 um" in err
    code, _, err = planish("marks", "convert", tmp_path / "m.json", tmp_path / "out.csv", "--to", "bigwarp")
    assert (code, "already there" in err) == (3, True)


def read_by_link(path):
    """Marks of a file as a link reads them, for an image of 5 um pixels; or the message."""
    grid = Grid(y_um=np.arange(300) * 5.0, x_um=np.arange(320) * 5.0)
    try:
        read_given(path, SimpleNamespace(grid=grid, image=None), SimpleNamespace(grid=grid, image=grid))
    except PlanishError as error:
        return str(error)
    return "the marks were read"


POINTS = np.array([[111.1, 222.2], [903.3, 148.4], [505.5, 706.6], [730.1, 655.2]])


def some_pairs(fixed):
    return make_marks(list("abcd"), {"moving": Places(um=POINTS), "fixed": Places(um=fixed)})


def test_a_link_takes_marks_of_other_programs(tmp_path):
    for to in ("json", "csv", "bigwarp", "slicer"):
        (path,) = write_any(some_pairs(POINTS + 3.3), tmp_path / f"marks-{to}", to=to)
        assert "the marks were read" in read_by_link(path)


def test_a_link_refuses_marks_that_it_cannot_use(tmp_path):
    # The image has pixels of 5 um.
    (path,) = write_any(some_pairs(np.round(POINTS / 5)), tmp_path / "pixels.csv")
    assert "look like pixels" in read_by_link(path)
    (path,) = write_any(some_pairs(POINTS), tmp_path / "marks.mat", moving=LayerPixels(1.0), fixed=LayerPixels(5.0))
    assert "--moving-pixel-um" in read_by_link(path)
    files = write_any(some_pairs(POINTS), tmp_path / "points.txt")
    assert "planish marks convert MOVING FIXED OUT" in read_by_link(files[0])
    off = some_pairs(POINTS).assign(used=("mark", [True, True, False, False]))
    (path,) = write_any(off, tmp_path / "two.json")
    assert "needs 3" in read_by_link(path)
