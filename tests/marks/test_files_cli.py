"""``planish marks convert``, and marks of other programs in a link."""

import json
from types import SimpleNamespace

import numpy as np

from marks.files_by_hand import FIXED, MOVING, bigwarp_2d, elastix
from marks.test_files import mat as mat_bytes
from marks.test_files import same
from planish.core.errors import PlanishError
from planish.core.grid import Grid
from planish.marks import LayerPixels, MarkPlaces, make_marks, read_any, write_any
from planish.run import marks_registration as registration


def test_convert_from_bigwarp_to_everything(passes, tmp_path):
    source, marks = tmp_path / "landmarks.csv", tmp_path / "marks.json"
    source.write_text(bigwarp_2d())
    out, err = passes("marks", "convert", source, marks)
    assert "marks.json: 4 marks (4 used) in moving, fixed" in out
    assert "BigWarp states no unit; the positions were taken as um (--unit)" in err
    sizes = ("--moving-pixel-um", "2.5", "--fixed-pixel-um", "4.0,4.0")
    for name, to in (("a.mat", ()), ("b.csv", ("--to", "bigwarp")), ("a.json", ("--to", "slicer"))):
        passes("marks", "convert", marks, tmp_path / name, *to, *sizes)
        assert same(read_any(tmp_path / name, moving=LayerPixels(2.5), fixed=LayerPixels(4.0)))
    out, err = passes("marks", "convert", marks, tmp_path / "e.txt")
    assert "e-moving.txt" in out
    assert "fixed to moving" in err
    both = (tmp_path / "e-moving.txt", tmp_path / "e-fixed.txt")
    out, _ = passes("marks", "convert", *both, tmp_path / "back.json", "--json")
    assert json.loads(out)["read"] == {"format": "elastix", "unit": "mm", "stated": False}
    assert same(read_any(tmp_path / "back.json"))


def test_convert_asks_for_what_it_needs(passes, refuses, tmp_path):
    mat, marks = tmp_path / "m.mat", tmp_path / "m.json"
    mat.write_bytes(mat_bytes(MOVING, FIXED))
    refuses("marks", "convert", mat, marks, words="--moving-pixel-um", out=False)
    wrong = ("--moving-pixel-um", "2;3")
    refuses("marks", "convert", mat, marks, *wrong, words="SIZE|Y,X|Z,Y,X", code=2, out=False)
    refuses("marks", "convert", mat, words="IN and OUT", code=2, out=False)
    (tmp_path / "fp.txt").write_text(elastix(FIXED))
    origin = ("--moving-origin-um", "-350,20", "--moving-pixel-um", "1", "--fixed-pixel-um", "1")
    passes("marks", "convert", mat, marks, *origin)
    bigwarp = ("marks", "convert", marks, tmp_path / "out.csv", "--to", "bigwarp")
    _, err = passes(*bigwarp)
    assert "moving: positions count from its first pixel, at -350,20 um" in err
    refuses(*bigwarp, words="already there", out=False)


def read_by_link(path):
    """Marks of a file as a link reads them, for an image of 5 um pixels; or the message."""
    grid = Grid(y_um=np.arange(300) * 5.0, x_um=np.arange(320) * 5.0)
    try:
        registration.read_given(
            path, SimpleNamespace(grid=grid, image=None), SimpleNamespace(grid=grid, image=grid)
        )
    except PlanishError as error:
        return str(error)
    return "the marks were read"


POINTS = np.array([[111.1, 222.2], [903.3, 148.4], [505.5, 706.6], [730.1, 655.2]])


def some_pairs(fixed):
    return make_marks(
        list("abcd"), {"moving": MarkPlaces(um=POINTS), "fixed": MarkPlaces(um=fixed)}
    )


def test_a_link_takes_marks_of_other_programs_and_refuses_what_it_cannot_use(tmp_path):
    (path,) = write_any(some_pairs(POINTS + 3.3), tmp_path / "marks.csv", to="bigwarp")
    assert "the marks were read" in read_by_link(path)
    # The image has pixels of 5 um.
    (path,) = write_any(some_pairs(np.round(POINTS / 5)), tmp_path / "pixels.csv")
    assert "look like pixels" in read_by_link(path)
    (path,) = write_any(
        some_pairs(POINTS), tmp_path / "marks.mat", moving=LayerPixels(1.0), fixed=LayerPixels(5.0)
    )
    assert "convert with moving_pixel_um=" in read_by_link(path)
    files = write_any(some_pairs(POINTS), tmp_path / "points.txt")
    assert "planish marks convert MOVING FIXED OUT" in read_by_link(files[0])
    off = some_pairs(POINTS).assign(used=("mark", [True, True, False, False]))
    (path,) = write_any(off, tmp_path / "two.json")
    assert "needs 3" in read_by_link(path)
