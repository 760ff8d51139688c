"""Tables of positions of other programs: x, y and unit as each means them, in any dialect."""

import numpy as np
import pandas as pd
import pytest
import roifile

from folders import refused
from marks.files_by_hand import FIXED, FIXED_PIXEL, MOVING, MOVING_PIXEL
from planish.core.errors import FileError, MarkError, SizeError
from planish.marks import LayerPixels, layer_names, read_any

PIXELS = {"moving": LayerPixels(MOVING_PIXEL), "fixed": LayerPixels(FIXED_PIXEL)}
PX = (MOVING / MOVING_PIXEL, FIXED / FIXED_PIXEL)


def napari(x, y):
    return pd.DataFrame({"index": np.arange(4.0), "axis-0": y, "axis-1": x})


def trackmate(x, y, unit="pixel"):
    columns = {"LABEL": ["Label", "", "", "ID1", "ID2", "ID3", "ID4"]}
    for name, values in (("X", x), ("Y", y), ("Z", np.zeros(4))):
        columns[f"POSITION_{name}"] = [name, name, f"({unit})", *map(str, values)]
    return pd.DataFrame(columns)


# One side of the pairs as each program writes it: (table of x and y, unit, first pixel's centre).
PROGRAMS = {
    "napari": (napari, "pixel", 0),
    "scikit-image": (
        lambda x, y: pd.DataFrame({"label": range(4), "centroid-0": y, "centroid-1": x}),
        "pixel",
        0,
    ),
    "QuPath px": (
        lambda x, y: pd.DataFrame(
            {"Image": "a.tif", "Name": "", "Centroid X px": x, "Centroid Y px": y}
        ),
        "pixel",
        0.5,
    ),
    "QuPath um": (
        lambda x, y: pd.DataFrame(
            {"Image": "a.tif", "Centroid X \u00b5m": x, "Centroid Y \u00b5m": y}
        ),
        "um",
        0.5,
    ),
    "CellProfiler": (
        lambda x, y: pd.DataFrame(
            {"ImageNumber": 1, "Location_Center_X": x, "Location_Center_Y": y}
        ),
        "pixel",
        0,
    ),
    "TrackMate": (trackmate, "pixel", 0),
    "TrackMate um": (lambda x, y: trackmate(x, y, "micron"), "um", 0),
    "ROI Manager": (
        lambda x, y: pd.DataFrame(
            {"Name": "a", "Type": "Point", "X": x, "Y": y, "Width": 0, "Height": 0}
        ),
        "pixel",
        0,
    ),
    "by hand": (lambda x, y: pd.DataFrame({"X (mm)": x, "Y (mm)": y}), "mm", 0),
}
IN_UNIT = {"pixel": PX, "um": (MOVING, FIXED), "mm": (MOVING / 1000, FIXED / 1000)}
DIALECTS = {
    "comma": {},
    "Excel in German": {"sep": ";", "decimal": ",", "lineterminator": "\r\n"},
    "Unicode text": {"sep": "\t", "decimal": ",", "encoding": "utf-16"},
    "index": {"sep": "\t", "index": True},
}


def written(tmp_path, program, dialect):
    make, unit, first_centre = PROGRAMS[program]
    files = []
    for k, points in enumerate(IN_UNIT[unit]):
        pixel = 1.0 if unit == "pixel" else (MOVING_PIXEL, FIXED_PIXEL)[k]
        table = make(*(points + first_centre * pixel).T)
        if dialect.get("decimal") and program.startswith("TrackMate"):
            table = table.map(lambda cell: str(cell).replace(".", ","))
        files.append(tmp_path / f"{k}.csv")
        table.to_csv(files[-1], **{"index": False} | dialect)
    return files


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("program", PROGRAMS)
def test_each_program_in_each_dialect(tmp_path, program, dialect):
    marks = read_any(*written(tmp_path, program, DIALECTS[dialect]), **PIXELS)
    for side, points in (("moving", MOVING), ("fixed", FIXED)):
        for k, axis in enumerate("xy"):
            np.testing.assert_allclose(marks[f"{side}_{axis}"], points[:, k], rtol=0, atol=1e-9)
    assert marks.attrs["read_from"]["stated"]


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_unit_that_contradicts_is_refused(tmp_path, program):
    files = written(tmp_path, program, {})
    other = "um" if PROGRAMS[program][1] != "um" else "mm"
    refused(SizeError, "states its unit", read_any, *files, unit=other, **PIXELS)


PAIRS = {f"{side}_{axis}": 0 for side in ("moving", "fixed") for axis in "xy"}


def pairs(names, factor=1.0):
    values = np.hstack([MOVING, FIXED]) * factor
    rows = [",".join(map(repr, row)) for row in values.tolist()]
    return "\n".join([",".join(names), *rows]) + "\n"


def test_pairs_typed_by_hand_are_read_once_their_unit_is_stated(put):
    path = put(pairs(PAIRS), "t.csv")
    needed = "moving_x, moving_y, fixed_x, fixed_y state no unit.*moving_x_um, moving_y_um, fixed_x"
    refused(SizeError, needed, read_any, path)
    np.testing.assert_array_equal(read_any(path, unit="um").fixed_x, FIXED[:, 0])
    path = put(pairs([f"{name.replace('_', ' ')} [mm]" for name in PAIRS], 1e-3), "t.csv")
    np.testing.assert_allclose(read_any(path).fixed_x, FIXED[:, 0], rtol=1e-12)
    refused(SizeError, "states its unit, mm, and unit= says um", read_any, path, unit="um")
    path = put(pairs([f"{name}_px" for name in PAIRS]), "t.csv")
    refused(SizeError, "pixel size of the moving layer is not known", read_any, path)
    origin = {"moving": LayerPixels(2.0, (10.0, 0.0)), "fixed": LayerPixels(4.0)}
    np.testing.assert_array_equal(read_any(path, **origin).moving_x, 10 + 2 * MOVING[:, 0])
    matlab = [f"{side}Points_{k}" for side in ("moving", "fixed") for k in (1, 2)]
    marks = read_any(put(pairs(matlab), "t.csv"), **origin)
    np.testing.assert_array_equal(marks.fixed_y, 4 * (FIXED[:, 1] - 1))


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("x,y\n1,2\n", SizeError, "x, y state no unit. Call them x_um, y_um"),
        ("Centroid X,Centroid Y\n1,2\n", SizeError, "Centroid X, Centroid Y state no unit"),
        ("x (mm),y (px)\n1,2\n", MarkError, r"x, y do not state the same unit \(found x \(mm\)"),
        ("x (furlong),y (furlong)\n1,2\n", MarkError, "in 'furlong', which is no length"),
        ("Name,Type,X,Y,Width,Height\na,Oval,1,2,3,4\n", MarkError, "row 2: Oval is no point"),
        ("X,Y,Slice\n1,2,3\n4,5,6\n", MarkError, "points on 2 slices of a stack"),
        ("index,shape-type,vertex-index,axis-0,axis-1\n0,p,0,1,2\n", MarkError, "shapes of napari"),
        ("index,axis-0,axis-1\n", MarkError, "has a header and no mark"),
        ("index,axis-0,axis-1,axis-2,axis-3\n0,1,2,3,4\n", MarkError, "more axes than z, y, x"),
        ("label,x_um,y_um\n#1,1,2\n#2,3,4\nb,5,6\n", MarkError, "row 2 begins with #.*row 3"),
        ('label,x_um,y_um\n"a\nb",1,2\n', MarkError, "row 2: a quotation mark is not closed"),
        ("XM,YM\n1,2\n", FileError, "XM,YM.*no known format.*moving_x_um, moving_y_um"),
        ("Pt,true,1,5,2,5,3,5,4,5\n", MarkError, "10 columns .decimal commas need semicolons"),
    ],
)
def test_what_is_needed_is_named(put, text, error, words):
    refused(error, words, read_any, put(text, "t.csv"))


def test_each_side_may_have_a_unit_of_its_own(put):
    names = ["moving_x_um", "moving_y_um", "fixed_x_px", "fixed_y_px"]
    values = np.hstack([MOVING, FIXED / FIXED_PIXEL]).tolist()
    text = "\n".join([";".join(names), *(";".join(map(str, row)) for row in values)])
    np.testing.assert_allclose(read_any(put(text, "t.csv"), **PIXELS).fixed_y, FIXED[:, 1])


def test_landmarks_of_bigwarp_saved_again_in_german(put):
    rows = np.hstack([MOVING, FIXED]).tolist()
    cells = [[f"Pt-{k}", "WAHR", *map(str, row)] for k, row in enumerate(rows)]
    cells[3][1] = "FALSCH"
    text = "\r\n".join(";".join(row).replace(".", ",") for row in cells)
    marks = read_any(put(text, "t.csv"))
    np.testing.assert_array_equal(marks.moving_y, MOVING[:, 1])
    assert marks.used.values.tolist() == [True, True, True, False]


def test_of_two_units_in_one_table_one_is_taken(put):
    names = ["Centroid X px", "Centroid Y px", "Centroid X µm", "Centroid Y µm"]
    text = ",".join(names) + "\n1,2,4,8\n5,6,20,24\n"
    marks = read_any(put(text, "t.csv"), fixed=LayerPixels(4.0))
    assert marks.marks_y.values.tolist() == [(2 - 0.5) * 4, (6 - 0.5) * 4]


def test_points_of_napari_in_a_volume_run_z_y_x(put):
    volume = put("index,axis-0,axis-1,axis-2\n0,7,2,3\n1,8,5,6\n2,9,1,1\n", "m.csv")
    flat = put("index,axis-0,axis-1\n0,2,3\n1,5,6\n2,1,1\n", "f.csv")
    sizes = {"moving": LayerPixels((10.0, 2.0, 1.0)), "fixed": LayerPixels(1.0)}
    marks = read_any(volume, flat, **sizes)
    assert layer_names(marks) == ["volume", "fixed"]
    first = [float(marks[f"volume_{axis}"][0]) for axis in "xyz"]
    assert first == [3.0, 4.0, 70.0]


# --- selections of ImageJ


def point_roi(points, name="p", **attributes):
    roi = roifile.ImagejRoi.frompoints(points, name=name)
    roi.roitype = roifile.ROI_TYPE.POINT
    for key, value in attributes.items():
        setattr(roi, key, value)
    return roi


@pytest.mark.parametrize("suffix", [".roi", ".zip", "s.zip"])
def test_points_of_imagej_are_read(tmp_path, suffix):
    paths = [tmp_path / f"moving{suffix}", tmp_path / f"fixed{suffix}"]
    for path, points in zip(paths, PX, strict=True):
        if suffix == "s.zip":
            rois = [point_roi(points[k : k + 1], f"hole {k}") for k in range(4)]
        else:
            rois = [point_roi(points)]
        roifile.roiwrite(path, rois if suffix.endswith("zip") else rois[0])
    marks = read_any(*paths, **PIXELS)
    for k, axis in enumerate("xy"):  # the file holds float32
        np.testing.assert_allclose(marks[f"moving_{axis}"], MOVING[:, k], rtol=1e-6)
        np.testing.assert_allclose(marks[f"fixed_{axis}"], FIXED[:, k], rtol=1e-6)
    first = "hole 0" if suffix == "s.zip" else None
    assert first is None or marks.label.values[0] == first
    refused(SizeError, "pixel size of the moving layer", read_any, *paths)
    refused(SizeError, "states its unit, pixel", read_any, *paths, unit="um", **PIXELS)


def test_whole_points_of_imagej_are_pixels_centres(tmp_path):
    points = np.array([[10, 20], [30, 45], [7, 3]])
    roifile.roiwrite(tmp_path / "a.roi", point_roi(points))
    marks = read_any(tmp_path / "a.roi", fixed=LayerPixels(2.0))
    assert marks.marks_x.values.tolist() == [20.0, 60.0, 14.0]


def test_selections_that_are_no_points_are_named(tmp_path):
    oval = roifile.ImagejRoi(left=1, top=2, right=9, bottom=9, name="rim")
    oval.roitype = roifile.ROI_TYPE.OVAL
    roifile.roiwrite(tmp_path / "a.zip", [point_roi([[1, 2]]), oval])
    refused(MarkError, "'rim.*it is no point, but of the type oval", read_any, tmp_path / "a.zip")
    on_slices = [point_roi([[k, 2]], f"p{k}", position=k) for k in (1, 2, 3)]
    roifile.roiwrite(tmp_path / "b.zip", on_slices)
    refused(MarkError, "points on 3 slices of a stack", read_any, tmp_path / "b.zip")
    (tmp_path / "c.roi").write_bytes((tmp_path / "b.zip").read_bytes()[:90])
    refused(FileError, "damaged archive", read_any, tmp_path / "c.roi")
