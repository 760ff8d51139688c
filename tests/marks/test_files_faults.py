"""Files of marks that are wrong: every one ends in a sentence that says what was found and what to
do."""

import json

import numpy as np
import pytest
import roifile

from folders import refused
from marks.files_by_hand import (
    FIXED,
    MOVING,
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
from marks.test_files import mat
from planish.core.errors import FileError, MarkError, PlanishError, SizeError
from planish.marks import LayerPixels, MarkPlaces, exchange, make_marks, read_any, write_any


def lines_with(text, k, new):
    rows = text.splitlines()
    rows[k] = new
    return "\n".join(rows) + "\n"


def own(change):
    content = json.loads(native())
    change(content)
    return json.dumps(content)


def markup(change):
    found = slicer_list(MOVING / 1000, "F")
    change(found)
    return slicer(found, slicer_list(FIXED / 1000, "G"))


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        # columns
        (
            "\n".join(row + ',"1.0"' for row in bigwarp_2d().splitlines()),
            MarkError,
            "row 1 has 7 columns.*6 columns.*8",
        ),
        (
            lines_with(bigwarp_2d(), 2, '"Pt-2","true","1","2","3"'),
            MarkError,
            "row 3 has 5 columns, the first 6",
        ),
        (
            lines_with(bigwarp_2d(), 2, '"Pt-2","yes","1","2","3","4"'),
            MarkError,
            "row 3: active is 'yes'",
        ),
        (
            lines_with(bigwarp_2d(), 2, '"Pt-2","true","1","two","3","4"'),
            MarkError,
            "row 3: 'two' is not a finite number",
        ),
        (lines_with(bigwarp_2d(), 2, '"Pt-2,"true"x,"1'), MarkError, "row 3"),
        (
            bigwarp_3d().replace('"0.0"\n', '"7.0"\n', 1),
            MarkError,
            "fixed side.*differ in z.*swap=",
        ),
        # repeated
        (bigwarp_2d().replace("Pt-1", "Pt-0"), MarkError, "label 'Pt-0' is there 2 times"),
        (
            bigwarp_2d().replace('"1250.0","312.5"', '"250.0","500.0"'),
            MarkError,
            "Pt-0 and Pt-1 have the same position",
        ),
        # counts
        ("point\n5\n1 2\n3 4\n", MarkError, "states 5 points and holds 2 lines"),
        ("point\n2\n1 2\n3 4 5\n", MarkError, "point 2 has 3 numbers"),
        ("point\n2\n1 2\n3 inf\n", MarkError, "point 2: 'inf' is no finite"),
        ("point\nmany\n1 2\n", MarkError, "states no number of points"),
        ("point\n0\n", MarkError, "holds no point"),
        ("index\n1\n3 4\n", SizeError, "pixels.*moving_pixel_um="),
        # 3D Slicer
        (markup(lambda m: m.update(coordinateSystem="IJK")), MarkError, "F is in .IJK."),
        (markup(lambda m: m.update(coordinateUnits="inch")), MarkError, "F is in 'inch'; mm or um"),
        (
            markup(lambda m: m["controlPoints"].pop()),
            MarkError,
            "3 moving points .F. and 4 fixed points .G.*same number",
        ),
        (
            markup(lambda m: m["controlPoints"][2].update(position=[1, 2])),
            MarkError,
            "point 3 of F has the position",
        ),
        (
            markup(lambda m: m["controlPoints"][2].update(positionStatus="lost")),
            MarkError,
            "status 'lost'",
        ),
        (
            markup(lambda m: m["controlPoints"].reverse()),
            MarkError,
            "same labels in another order: Pt-3 and Pt-0",
        ),
        (
            slicer(*(slicer_list(MOVING / 1000, n) for n in "abc")),
            MarkError,
            "3 lists of points: a .4., b .4., c .4.",
        ),
        (slicer({"type": "ROI"}), MarkError, "no list of points, but ROI"),
        ('{"markups": 3}', MarkError, "no list of points"),
        (
            "# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n",
            FileError,
            "fcsv.*mrk.json",
        ),
        # BigWarp's JSON
        (
            bigwarp_json().replace('"numDimensions": 2', '"numDimensions": 4'),
            MarkError,
            "numDimensions .4.",
        ),
        (
            bigwarp_json().replace('"Pt-0", ', ""),
            MarkError,
            "4 moving points, 4 fixed points, 3 names",
        ),
        ('{"landmarks": []}', MarkError, "movingPoints is no list"),
        # tables
        (PAIRS.replace("fixed_y_um", "fixed_y"), MarkError, "columns missing: fixed_y_um"),
        ("label,x_um,z_um\na,1,2\n", MarkError, "columns missing: y_um"),
        ("label,x_um,y_um\n", MarkError, "no mark"),
        (PAIRS.splitlines()[0], MarkError, "no pair"),
        (
            "moving_x_um,moving_y_um,volume_x_um,fixed_x_um,fixed_y_um\n1,2,3,4,5\n",
            MarkError,
            "both moving and volume",
        ),
        (PAIRS.replace("402.0", "nan"), MarkError, "row 2: fixed_x_um 'nan' is not a finite"),
        (
            PAIRS.replace("2006.0,510.0", "402.0,806.0"),
            MarkError,
            "Pt-0 and Pt-1 have the same position in fixed",
        ),
        (imagej(MOVING).replace(",250.0,", ",,"), MarkError, "row 2: X '' is not a finite"),
        # planish's own
        (
            native().replace('"version": 1', '"version": 2'),
            MarkError,
            "version 2.*up to version 1. Update planish",
        ),
        (native().replace('"units": "um"', '"units": "mm"'), MarkError, "units: .*'um'"),
        (native().replace('"used"', '"use"'), MarkError, "marks.0.use: "),
        (native().replace('"x": 250.0', '"x": "250"'), MarkError, "marks.0.at.moving.x"),
        (native().replace('"x": 250.0', '"x": NaN'), MarkError, "marks.0.at.moving.x.*finite"),
        (
            native().replace("[0.5, 2.0]", "[0.7, 2.0]"),
            MarkError,
            r"marks.0. .A. at moving: the covariance",
        ),
        (
            native().replace("[[4.0, 0.5], [0.5, 2.0]]", "[[1, 9], [9, 1]]"),
            MarkError,
            "the covariance",
        ),
        (native().replace("[[4.0, 0.5], [0.5, 2.0]]", "[[1]]"), MarkError, "the covariance"),
        (native().replace('"name": "fixed"', '"name": "Fixed!"'), MarkError, "layers.1.name"),
        (
            native().replace('"name": "fixed"', '"name": "image"'),
            MarkError,
            "at fixed: there is no such layer",
        ),
        (
            native().replace('"name": "fixed"', '"name": "moving"'),
            MarkError,
            "moving is there 2 times",
        ),
        (
            native().replace('"units": "um",', '"units": "um", "units": "um",'),
            FileError,
            "'units' stands 2 times",
        ),
        (own(lambda c: c.update(marks=[])), MarkError, "no mark"),
        (own(lambda c: c.update(layers=[])), MarkError, "layers: "),
        (
            own(lambda c: c["marks"][0]["at"]["moving"].update(z=1.0)),
            MarkError,
            "have z and some have none",
        ),
        (own(lambda c: c.update(marks=[0] * 100_001)), MarkError, "100001 marks"),
        # no file of marks at all
        ("", FileError, "is empty"),
        ("1.5 2.5\n3.5 4.5\n", FileError, "begins with '1.5 2.5'.*These are read"),
        ('{"a": 1}', FileError, "it holds a. These are read"),
        ("[1, 2]", FileError, "it holds a list"),
        ('{"format": "planish-marks", ', FileError, "damaged JSON"),
        ("[" * 200_000, FileError, "nested too deeply"),
        ('{"markups": ' + "9" * 10_000 + "}", FileError, "damaged JSON"),
        (b"\xff\xfe\x00\x01junk", FileError, "no known format"),
        (b"\x89PNG\r\n\x1a\n" + bytes(64), FileError, "no text in UTF-8"),
    ],
)
def test_faults_say_what_to_do(put, text, error, message):
    with pytest.raises(error, match=message) as caught:
        read_any(put(text))
    sentence = str(caught.value)
    assert sentence.count(". ") >= 1, sentence  # what was found, and what to do
    assert len(sentence) < 1500


@pytest.mark.parametrize(
    ("data", "error", "message"),
    [
        (mat(MOVING, FIXED[:3]), MarkError, "4 points in movingPoints, 3 in fixedPoints"),
        (mat(MOVING.T, FIXED.T), MarkError, "size 2 x 4; n x 2 real"),
        (mat(MOVING * 1j, FIXED), MarkError, "movingPoints is no real matrix"),
        (mat(MOVING * np.nan, FIXED), MarkError, "no finite position in the rows 1, 2, 3, 4"),
        (mat(MOVING[:0], FIXED[:0]), MarkError, "no point|size"),
        (
            mat(MOVING, FIXED, names=("a", "cpstruct")),
            MarkError,
            "holds a, cpstruct; movingPoints and fixedPoints",
        ),
        (mat(np.zeros((9_000_000, 1)), FIXED, "7"), MarkError, "is no real matrix"),
        (mat(MOVING, FIXED)[:300], FileError, "cannot be read as a MATLAB file"),
        (mat(MOVING, FIXED, "7.3")[:1500], FileError, "cannot be read as a MATLAB file"),
    ],
)
def test_matlab_files_that_are_wrong(put, data, error, message):
    with pytest.raises(error, match=message):
        read_any(put(data, "points.mat"), moving=LayerPixels(1.0), fixed=LayerPixels(1.0))


def test_files_that_are_missing_or_do_not_go_together(tmp_path, put):
    refused(FileError, r"none\.csv does not exist", read_any, tmp_path / "none.csv")
    refused(FileError, "is no file", read_any, tmp_path)
    a, b = put(elastix(MOVING / 1000), "mp.txt"), put(elastix(FIXED[:3] / 1000), "fp.txt")
    refused(
        MarkError,
        r"4 moving points \(mp.txt\) and 3 fixed points \(fp.txt\).*same number",
        read_any,
        a,
        b,
    )
    refused(MarkError, "holds 2 lists of points already", read_any, put(bigwarp_2d(), "b.csv"), a)
    refused(
        MarkError, "already holds the layers moving, fixed", read_any, put(PAIRS, "pairs.csv"), a
    )
    refused(
        MarkError,
        "one layer only .marks..*convert MOVING FIXED OUT",
        exchange.used_pairs,
        read_any(a),
    )


def test_units_and_sizes_that_contradict(put):
    path = put(slicer(slicer_list(MOVING / 1000, "a"), slicer_list(FIXED / 1000, "b")))
    refused(SizeError, "states its unit, mm, and unit= says um", read_any, path, unit="um")
    for wrong in (-1, np.nan, (1, 2, 3, 4), ()):
        refused(SizeError, "fixed_pixel_um=", LayerPixels, wrong)
    refused(SizeError, "two numbers", LayerPixels, origin_um=(1.0,))
    flat = {"moving": LayerPixels((1.0, 2.0)), "fixed": LayerPixels(1.0)}
    refused(SizeError, "sizes z, y, x", read_any, put(bigwarp_3d()), unit="pixel", **flat)
    refused(MarkError, "swap=", read_any, put(PAIRS), swap=True)
    refused(
        SizeError, "states its unit, um, and unit= says pixel", read_any, put(PAIRS), unit="pixel"
    )


def test_too_few_marks(put):
    one = read_any(put(native()))
    refused(
        MarkError,
        r"holds 3 marks, of which 1 are used and lie in both .*\. At least 3",
        exchange.used_pairs,
        one,
    )
    three = make_marks(["a"], dict.fromkeys("klm", MarkPlaces(um=np.array([[1.0, 2.0]]))))
    refused(MarkError, "3 layers: k, l, m", exchange.used_pairs, three)
    refused(
        MarkError,
        "no layer 'n'; they have k, l, m",
        exchange.used_pairs,
        three,
        moving="n",
        fixed="k",
    )


# --- marks against their layer


LAYER = {"fixed": LayerPixels(12.0, shape=(1250, 1667))}  # 20 x 15 mm


def pairs_text(fixed):
    rows = [
        f"{k},{k * 10},{k * k},{x!r},{y!r}"
        for k, (x, y) in enumerate(np.asarray(fixed, float).tolist())
    ]
    return "label,moving_x_um,moving_y_um,fixed_x_um,fixed_y_um\n" + "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    ("fixed", "message"),
    [
        (
            [[160, 200], [1500.5, 130], [900, 1150], [400, 1001.5]],
            "fixed span 1.34 x 1.02 mm, the layer 20 x 15 mm.*look like pixels",
        ),
        ([[0.9, 1.1], [19.1, 2.2], [11.3, 14.4]], "look like mm"),
        ([[900.3, 19100.1], [14000.2, 300.7], [7000.4, 17000.9]], "x and y exchanged"),
        ([[900.3, 1100.1], [41000.2, 300.7], [7000.4, 7000.9]], "1 of 3 lie outside it"),
    ],
)
def test_marks_that_cannot_lie_in_their_image(put, fixed, message):
    path = put(pairs_text(fixed))
    refused(MarkError, message, read_any, path, **LAYER)
    # The last word is the caller's.
    assert read_any(path, unit="um", **LAYER).sizes["mark"] == len(fixed)
    assert read_any(path).sizes["mark"] == len(fixed)  # nothing is known of the layer


@pytest.mark.parametrize(
    "fixed",
    [
        [
            [160.25, 200.5],
            [1500.5, 130],
            [900, 1150],
        ],  # a corner of the image, located below the pixel
        [[120, 240], [1200, 360], [840, 1152]],  # clicked on whole pixels, given in um
        [[900.3, 1100.1], [20500.0, 300.7], [7000.4, 7000.9]],  # a little outside
    ],
)
def test_marks_that_are_um(put, fixed):
    assert read_any(put(pairs_text(fixed)), **LAYER).sizes["mark"] == len(fixed)


def test_the_remedy_for_pixels_is_one_that_the_file_allows(put):
    pixels = np.array([[160, 200], [1500.5, 130], [900, 1150]])
    rows = [
        f'"{k}","true","{k}.5","{k * k}.5","{x}","{y}"' for k, (x, y) in enumerate(pixels.tolist())
    ]
    path = put("\n".join(rows), "bigwarp.csv")
    refused(
        MarkError,
        'Convert them by planish marks convert, given unit="pixel", moving',
        read_any,
        path,
        **LAYER,
    )
    own = put(pairs_text(pixels))
    refused(
        MarkError, "says um: multiply them by the pixel size.*with decimals", read_any, own, **LAYER
    )
    marks = read_any(path, unit="pixel", moving=LayerPixels(1.0), **LAYER)
    np.testing.assert_allclose(marks.fixed_x, pixels[:, 0] * 12.0, rtol=0, atol=1e-9)
    pixels = np.array([[100, 50], [19000, 700], [6000, 14500]])
    fine = LayerPixels(0.5, shape=(15000, 20000))
    refused(MarkError, "look like pixels", read_any, put(pairs_text(pixels)), fixed=fine)
    assert read_any(put(pairs_text(pixels * 0.5)), fixed=fine).sizes["mark"] == 3


def foreign_files(put, numbers):
    """Files of programs that state no unit, all with the same numbers on both sides."""
    rows = np.asarray(numbers, dtype=float)
    x_y = "\n".join(["X,Y", *(f"{x},{y}" for x, y in rows.tolist())])
    return {
        "BigWarp": (put(bigwarp_2d(rows, rows), "b.csv"),),
        "elastix": (put(elastix(rows), "mp.txt"), put(elastix(rows), "fp.txt")),
        "ImageJ": (put(x_y, "x.csv"), put(x_y, "y.csv")),
    }


@pytest.mark.parametrize("program", ["BigWarp", "elastix", "ImageJ"])
def test_pixels_on_both_sides_are_suspected_and_named(put, program):
    """As um they would lie in one corner of the image; its pixels, of 12 um, they spread over."""
    pixels = [[160.3, 200.1], [1500.7, 130.2], [900.4, 1150.6], [400.9, 1001.3]]
    paths = foreign_files(put, pixels)[program]
    layers = {"moving": LayerPixels(4.0)} | LAYER
    words = 'they look like pixels.* given unit="pixel", moving_pixel_um= and fixed_pixel_um='
    refused(MarkError, words, read_any, *paths, **layers)
    marks = read_any(*paths, unit="pixel", **layers)
    np.testing.assert_allclose(marks.fixed_x, np.array(pixels)[:, 0] * 12, rtol=1e-12)


def test_um_in_a_corner_are_read_where_somebody_says_so_or_they_reach_not_far(put):
    pixels = [[160.3, 200.1], [1500.7, 130.2], [900.4, 1150.6], [400.9, 1001.3]]
    (path,) = foreign_files(put, pixels)["BigWarp"]
    assert read_any(path, unit="um", **LAYER).sizes["mark"] == 4
    (path,) = foreign_files(put, np.array(pixels) / 4)["BigWarp"]
    assert read_any(path, **LAYER).sizes["mark"] == 4
    (path,) = foreign_files(put, np.array(pixels) * 12)["BigWarp"]
    assert read_any(path, **LAYER).sizes["mark"] == 4


# --- writing
def test_nothing_is_overwritten_and_every_need_is_told(put, tmp_path):
    marks = read_any(put(bigwarp_2d()))
    layers = {"moving": LayerPixels(2.0), "fixed": LayerPixels(2.0)}
    for to in ("csv", "elastix"):
        files = write_any(marks, tmp_path / f"{to}.out", to=to, **layers)
        before = [f.read_bytes() for f in files]
        refused(
            FileError, "already there", write_any, marks, tmp_path / f"{to}.out", to=to, **layers
        )
        assert [f.read_bytes() for f in files] == before
        refused(
            FileError,
            "cannot be written",
            write_any,
            marks,
            tmp_path / "no" / "folder",
            to=to,
            **layers,
        )
    need = "pixels, and the pixel size of the fixed layer.*fixed_pixel_um="
    refused(SizeError, need, write_any, marks, tmp_path / "x.mat", moving=LayerPixels(1.0))
    refused(SizeError, "own unit", write_any, marks, tmp_path / "x.json", unit="mm")
    refused(FileError, "does not tell its format", write_any, marks, tmp_path / "marks.dat")
    volume = read_any(put(bigwarp_3d()))
    refused(
        MarkError,
        "MATLAB's control points are flat",
        write_any,
        volume,
        tmp_path / "x.mat",
        **layers,
    )
    off = marks.assign(used=("mark", [False] * 4))
    refused(MarkError, "No mark is used", write_any, off, tmp_path / "x.txt")
    refused(
        MarkError, "name of a layer", make_marks, ["a"], {"My map": MarkPlaces(um=np.zeros((1, 2)))}
    )


# --- damage


def points_roi(points):
    selection = roifile.ImagejRoi.frompoints(points)
    selection.roitype = roifile.ROI_TYPE.POINT
    return selection.tobytes()


WHOLE = {
    "b2.csv": bigwarp_2d().encode(),
    "b3.csv": bigwarp_3d().encode(),
    "bw.json": bigwarp_json().encode(),
    "e.txt": elastix(MOVING).encode(),
    "own.json": native().encode(),
    "pairs.csv": PAIRS.encode(),
    "s.mrk.json": (
        slicer(slicer_list(MOVING / 1000, "a"), slicer_list(FIXED / 1000, "b", "RAS")).encode()
    ),
    "ij.csv": imagej(MOVING).encode(),
    "napari.csv": b"index,axis-0,axis-1\n0,1.5,2.5\n1,3.5,4.5\n2,7.5,9.5\n",
    "points.roi": points_roi(MOVING),
    "m5.mat": mat(MOVING, FIXED),
    "m73.mat": mat(MOVING, FIXED, "7.3"),
    "m7.mat": mat(MOVING, FIXED, "7"),
    "m4.mat": mat(MOVING, FIXED, "4"),
}
TOKENS = (
    b'"',
    b",",
    b"\n",
    b"{",
    b"]",
    b"null",
    b"1e400",
    b"-",
    b"NaN",
    b"\x00",
    b"\xff\xff\xff\xff",
    b"999999999999",
)


def damaged(data, rng):
    """Bytes changed, cut out, put in, cut off, or repeated, once to five times."""
    for _ in range(rng.integers(1, 6)):
        at, size = int(rng.integers(0, len(data) + 1)), int(rng.integers(1, 12))
        before, after = data[:at], data[at:]
        ways = (
            before + rng.integers(0, 256, size, dtype=np.uint8).tobytes() + after[size:],
            before + after[size:],
            before + TOKENS[rng.integers(len(TOKENS))] + after,
            before if rng.random() < 0.3 else data,
            before + after[:40] + after,
        )
        data = ways[rng.integers(len(ways))]
    return data


@pytest.mark.parametrize("name", sorted(WHOLE))
def test_damaged_files_end_in_a_sentence_or_in_marks(put, name):
    """Twenty damaged files of each kind."""
    layers = {"moving": LayerPixels(2.0), "fixed": LayerPixels(2.0)}
    assert read_any(put(WHOLE[name], name), **layers).sizes["mark"] > 0
    rng = np.random.default_rng(sorted(WHOLE).index(name))
    told: list[str] = []
    for _ in range(20):
        path = put(damaged(WHOLE[name], rng), name)
        try:
            marks = read_any(path, **layers)
        except PlanishError as error:
            told.append(str(error))
            continue
        assert all(marks[variable].dims == ("mark",) for variable in marks.variables)
        assert not any(
            np.isinf(marks[f"{layer}_{axis}"]).any()
            for layer in marks.attrs["layers"]
            for axis in "xy"
        )
    assert len(told) >= 5
    assert all(20 < len(sentence) < 2500 for sentence in told)
