"""Declared artefacts: what files say of them, which pixels they cover, and that no figure of a run
counts these."""

import io
import json
import struct
import zipfile
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from folders import refused
from planish.analyze import CorrelateParams
from planish.core.errors import FileError, InputError, PlanishError
from planish.core.grid import Grid
from planish.io import ImageParams, VolumeParams
from planish.marks import Region, Regions, geojson_text, read_regions
from planish.marks.regions.model import nested
from planish.results import Results
from planish.run import GivenLayer, Study, correlate_maps, link, open_run, read_study, write_study
from planish.run.regions import region_facts, regions_on
from report.runs import a_run, page_of

SQUARE = [[10, 10], [30, 10], [30, 30], [10, 30], [10, 10]]
HOLE = [[15, 15], [25, 15], [25, 25], [15, 25], [15, 15]]
POLYGON = {"type": "Polygon", "coordinates": [SQUARE, HOLE]}


def feature(geometry=POLYGON, **properties):
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def written(path, content):
    path.write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    return path


def read(tmp_path, content):
    return read_regions(written(tmp_path / "regions.json", content))


def roi(kind=0, box=(0, 0, 0, 0), points=(), *, fine=None, name="", properties="", options=0, **at):
    """A selection as ImageJ writes it: ``box`` top, left, bottom, right; ``at`` are shorts at their
    places."""
    head = bytearray(64)
    fine_box = fine if kind in (1, 2) else None
    struct.pack_into(">4shBx4hH", head, 0, b"Iout", 228, kind, *box, len(points))
    if fine_box is not None:
        struct.pack_into(">4f", head, 18, *fine_box)
    struct.pack_into(">h", head, 50, options | (128 if fine is not None else 0))
    for place, value in at.items():
        struct.pack_into(">h", head, int(place.removeprefix("at_")), value)
    body = b"".join(struct.pack(f">{len(points)}h", *axis) for axis in zip(*points, strict=True))
    if fine is not None and fine_box is None:
        body += b"".join(struct.pack(f">{len(points)}f", *axis) for axis in zip(*fine, strict=True))
    second = bytearray(64)
    texts = [text.encode("utf-16-be") for text in (name, properties)]
    start = len(head) + len(body) + len(second)
    struct.pack_into(">2i", second, 16, start, len(name))
    struct.pack_into(">2i", second, 40, start + len(texts[0]), len(properties))
    struct.pack_into(">i", head, 60, len(head) + len(body))
    return bytes(head) + body + bytes(second) + b"".join(texts)


def composite(*values):
    """A composite selection of these codes and places."""
    head = bytearray(roi(1, (0, 0, 9, 9))[:64])
    struct.pack_into(">i", head, 36, len(values))
    struct.pack_into(">i", head, 60, 0)
    return bytes(head) + struct.pack(f">{len(values)}f", *values)


def archive(**parts):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as file:
        for name, part in parts.items():
            file.writestr(f"{name}.roi", part)
    return data.getvalue()


TRIANGLE = roi(0, (4, 6, 9, 12), [(0, 0), (6, 0), (6, 5)], name="crease")


# --- which pixels ---------------------------------------------------------------------------------
def slow_mask(polygons, grid):
    """Every pixel and every edge in exact numbers: inside where an odd number of crossings lies to
    the right."""
    found = np.zeros(grid.shape, dtype=bool)
    for i, j in np.ndindex(*grid.shape):
        y, x = Fraction(grid.y_um[i]), Fraction(grid.x_um[j])
        for rings in polygons:
            right = 0
            for ring in rings:
                ends = [(Fraction(a), Fraction(b)) for a, b in ring.tolist()]
                for (xa, ya), (xb, yb) in zip(ends, ends[1:] + ends[:1], strict=True):
                    if ya <= y < yb or yb <= y < ya:
                        right += xa + (y - ya) / (yb - ya) * (xb - xa) > x
            found[i, j] |= right % 2 == 1
    return found


GRID = Grid.regular((7, 9), (2.0, 1.5), (3.0, -4.0))
places = st.tuples(
    st.integers(-4, 70).map(lambda k: k / 4), st.integers(-24, 48).map(lambda k: k / 4)
)
rings = st.lists(places, min_size=3, max_size=7).map(np.array)
regions_of_all_kinds = st.lists(
    st.lists(rings, min_size=1, max_size=3).map(tuple), min_size=1, max_size=2
).map(tuple)


@pytest.mark.nightly
@given(regions_of_all_kinds)
def test_the_mask_is_that_of_exact_numbers_whole_and_in_bands(polygons):
    """Quarters of pixels put many borders through the middles of pixels; borders cross themselves
    and each other."""
    regions = Regions(declared=(Region(name="a", polygons=polygons),))
    whole = regions.inside(GRID)
    np.testing.assert_array_equal(whole, slow_mask(polygons, GRID))
    parts = [
        np.hstack([regions.inside(GRID.part(rows, cols)) for cols in (slice(0, 4), slice(4, 9))])
        for rows in (slice(0, 2), slice(2, 7))
    ]
    np.testing.assert_array_equal(np.vstack(parts), whole)


def test_regions_side_by_side_share_no_pixel_and_overlaps_count_once():
    middle = np.array([4.5, 3.0])  # a pixel's centre
    corners = np.array([[-1.0, -1.0], [10.0, -1.0], [10.0, 8.0], [-1.0, 8.0]])
    grid = Grid.regular((7, 10), 1.0)
    parts = [
        Region(name=str(k), polygons=((np.array([middle + 0.5, corners[k - 1], corners[k]]),),))
        for k in range(4)
    ]
    counts = sum(Regions(declared=(one,)).inside(grid).astype(int) for one in parts)
    np.testing.assert_array_equal(counts, np.ones(grid.shape))
    square = Region(
        name="b", polygons=((np.array([[2.0, 2.0], [5.0, 2.0], [5.0, 5.0], [2.0, 5.0]]),),)
    )
    # Of centres on its borders the first ones only.
    inside = np.argwhere(Regions(declared=(square,)).inside(grid))
    assert (inside.min(axis=0).tolist(), inside.max(axis=0).tolist()) == ([2, 2], [4, 4])
    grid = Grid.regular((1300, 10), 1.0)  # several bands

    def rows(name, first, last):
        return Region(
            name=name,
            polygons=((np.array([[-1, first], [99, first], [99, last], [-1, last]], float),),),
        )

    facts = region_facts(Regions(declared=(rows("a", 500, 760), rows("b", 630, 1150))), grid)
    assert (facts.count, [one.share for one in facts.regions], facts.share) == (2, [0.2, 0.4], 0.5)


# --- GeoJSON --------------------------------------------------------------------------------------
def test_all_forms_of_geojson_are_read(tmp_path):
    texts = {"name": "stain", "reason": "coffee", "author": "A. Author"}
    several = {
        "type": "MultiPolygon",
        "coordinates": [POLYGON["coordinates"], [[[0, 0, 7], [1, 0, 7], [1, 1, 7]]]],
    }
    for content, names, borders in (
        (POLYGON, ["region 1"], [[4, 4]]),
        (feature(**texts), ["stain"], [[4, 4]]),
        (
            {"type": "FeatureCollection", "features": [feature(), feature(several, **texts)]},
            ["region 1", "stain"],
            [[4, 4], [4, 4, 3]],
        ),
    ):
        found = read(tmp_path, content).declared
        assert [one.name for one in found] == names
        assert [[len(ring) for rings in one.polygons for ring in rings] for one in found] == borders
    assert (found[1].reason, found[1].author, found[0].reason) == ("coffee", "A. Author", "")
    np.testing.assert_array_equal(found[1].polygons[0][1], HOLE[:-1])


QUPATH = feature(objectType="annotation", classification={"name": "Ignore*"}, isLocked=False)


@pytest.mark.parametrize(
    "content",
    [
        {"type": "FeatureCollection", "features": [QUPATH]},
        QUPATH,
        [feature() | {"id": "PathAnnotationObject"}],  # versions before 0.3
        POLYGON | {"units": "pixel"},
    ],
)
def test_geojson_in_pixels_covers_the_pixels_that_are_meant(tmp_path, content):
    """Corners in pixels are half a pixel away from their centres, as selections of ImageJ are."""
    grid = Grid(y_um=np.arange(7) * 3.0, x_um=np.arange(9) * 2.0)
    found = read(tmp_path, content)
    assert found.in_pixels
    expected = np.array(POLYGON["coordinates"][0][:-1], dtype=float)
    ring = found.on(grid).declared[0].polygons[0][0]
    np.testing.assert_allclose(ring, (expected - 0.5) * [2.0, 3.0], rtol=0, atol=1e-12)
    assert not read(tmp_path, feature(name="a")).in_pixels


def test_what_is_written_reads_back_to_the_same_bytes(tmp_path):
    third = {"type": "Polygon", "coordinates": [[[1 / 3, -0.0], [1e-7, 2e8], [0.1 + 0.2, 4]]]}
    odd = "a\u001b[31m\n\tb\ud800 \u00fc" + "\u0007" * 60
    content = {
        "type": "FeatureCollection",
        "features": [feature(third, name=odd, reason=odd), feature()],
    }
    found = read(tmp_path, content)
    assert found.declared[0].name == r"a\x1b[31m b\ud800 ü" + r"\x07" * 60
    text = geojson_text(found)
    again = read(tmp_path, text.encode())
    np.testing.assert_array_equal(
        again.declared[0].polygons[0][0], [[1 / 3, 0], [1e-7, 2e8], [0.1 + 0.2, 4]]
    )
    assert geojson_text(again) == text


# --- ImageJ ---------------------------------------------------------------------------------------
def test_a_rectangle_of_imagej_covers_its_own_pixels(tmp_path):
    """Left 2, top 1, 3 pixels wide, 2 high, on a grid whose first pixel has its middle at (100, 50)
    um."""
    grid = Grid.regular((5, 8), (2.5, 4.0), (100.0, 50.0))
    for data in (
        roi(1, (1, 2, 3, 5)),
        roi(1, fine=(2.0, 1.0, 3.0, 2.0)),
        roi(8, (1, 2, 3, 5), [(0, 0), (3, 0), (3, 2), (0, 2)]),
    ):
        regions = read(tmp_path, data).on(grid)
        expected = np.zeros(grid.shape, dtype=bool)
        expected[1:3, 2:5] = True
        np.testing.assert_array_equal(regions.inside(grid), expected)
        corners = [[106.0, 51.25], [118.0, 51.25], [118.0, 56.25], [106.0, 56.25]]
        np.testing.assert_allclose(regions.declared[0].polygons[0][0], corners, rtol=0, atol=1e-7)


def test_places_names_and_properties_of_imagej(tmp_path):
    fine = [(0.5, 1.25), (8.0, 1.0), (8.0, 7.5)]
    told = roi(
        7,
        (0, 0, 9, 9),
        [(0, 0)] * 3,
        fine=fine,
        properties="Author: A. Author\nreason: a crease\nother: x\n",
    )
    path = written(tmp_path / "set.zip", archive(first=TRIANGLE, second=told))
    first, second = read_regions(path).declared
    assert (first.name, first.reason, second.name) == ("crease", "", "second")
    assert (second.reason, second.author) == ("a crease", "A. Author")
    # Moved by far less than a pixel: ImageJ has its own rule for centres that lie on a border.
    np.testing.assert_allclose(first.polygons[0][0], [[6, 4], [12, 4], [12, 9]], rtol=0, atol=2e-8)
    np.testing.assert_allclose(second.polygons[0][0], fine, rtol=0, atol=2e-8)
    far = roi(0, (40000 - 65536, 2, 0, 0), [(0, 0), (9, 0), (9, 40000 - 65536)])
    corners = read(tmp_path, far).declared[0].polygons[0][0]
    np.testing.assert_allclose(corners, [[2, 4e4], [11, 4e4], [11, 8e4]], rtol=1e-8)


# Of ImageJ 1.53t, with the pixels that it fills (Make.java).
SELECTIONS = Path(__file__).parent / "imagej"


@pytest.mark.parametrize("path", sorted(SELECTIONS.glob("*.pbm")), ids=lambda path: path.stem)
def test_a_selection_of_imagej_covers_the_pixels_that_imagej_fills(tmp_path, path):
    filled = (
        np.unpackbits(np.frombuffer(path.read_bytes()[-384:], np.uint8))
        .reshape(48, 64)
        .astype(bool)
    )
    grid = Grid.regular((48, 64), (3.7, 4.0), (-12.0, 1234.5))
    regions = read_regions(path.with_suffix(".roi")).on(grid)
    np.testing.assert_array_equal(regions.inside(grid), filled)
    (one,) = regions.declared
    assert (one.name, one.reason, one.author) == (path.stem, f"stain of {path.stem}", "A. Author")
    # What a run keeps gives the same pixels again.
    stored = read_regions(written(tmp_path / "regions.geojson", geojson_text(regions).encode()))
    np.testing.assert_array_equal(stored.inside(grid), filled)


def test_a_manager_of_imagej_and_parts_of_a_composite_are_read():
    def borders(name):
        return [
            len(rings) for rings in read_regions(SELECTIONS / f"{name}.roi").declared[0].polygons
        ]

    assert (borders("composite-hole"), borders("composite-two")) == ([2], [1, 1])
    assert borders("composite-joined") == [1]
    squares = [
        np.array([[k, k], [9 - k, k], [9 - k, 9 - k], [k, 9 - k]], float) for k in (2, 0, 3, 1)
    ]
    beside = squares[1] + 20
    parts = nested([*squares, beside])
    assert [[ring[0, 0] for ring in rings] for rings in parts] == [[2, 3], [0, 1], [20]]
    found = read_regions(SELECTIONS / "RoiSet.zip").declared
    assert [one.name for one in found] == ["polygon", "freehand", "composite-hole"]


@pytest.mark.parametrize(
    ("name", "words"), [("rounded", "rounded corners"), ("spline", "fitted with a spline")]
)
def test_selections_of_imagej_that_are_not_read_are_named(name, words):
    refused(FileError, rf"'{name}.roi': it is .*{words}", read_regions, SELECTIONS / f"{name}.roi")


# --- files that are of no use ---------------------------------------------------------------------
def bent(*places):
    return {"type": "Polygon", "coordinates": [list(places)]}


WRONG = {
    "empty": (b"", "neither GeoJSON nor"),
    "binary": (b"\x89PNG\r\n\x1a\n\0\0", "UTF-8"),
    "cut": (json.dumps(POLYGON).encode()[:-9], "neither GeoJSON nor"),
    "deep": (b"[" * 100_000, "nested too deeply"),
    "many brackets": (b"[" * 2_000_001, "more than 1000000 points"),
    "too large": (b" " * 64_000_001, "larger than 64 MB"),
    "features that are none": (
        {"type": "FeatureCollection", "features": 3},
        "no GeoJSON of regions",
    ),
    "no region": ({"type": "FeatureCollection", "features": []}, "holds no region"),
    "a point": (feature({"type": "Point", "coordinates": [1, 2]}), "'Point'; a Polygon"),
    "no geometry": (feature(None), "region 1: its geometry is none"),
    "units": (POLYGON | {"units": "mm"}, "units are neither um nor pixel"),
    "not a number": (bent([0, 0], [float("nan"), 1], [2, 2]), "no number, or beyond"),
    "far": (bent([0, 0], [1e10, 1], [2, 2]), "no number, or beyond"),
    "beyond floats": (bent([0, 0], [10**400, 1], [2, 2]), "beyond all numbers"),
    "texts": (bent([0, 0], ["1", 1], [2, 2]), "position 2 of a border is not"),
    "true": (bent([0, 0], [True, 1], [2, 2]), "position 2"),
    "one number": (bent([0, 0], [1, 1], [2]), "position 3"),
    "two points": (bent([0, 0], [4, 4], [0, 0], [4, 4]), "2 different points; 3 are needed"),
    "no coordinates": ({"type": "Polygon"}, "no list, or empty"),
    "several": (
        {
            "type": "FeatureCollection",
            "features": [feature(bent([0, 0])), feature(), feature(author=1)],
        },
        r"region 1: .*1 different.*region 3: author is no text",
    ),
    "a long reason": (feature(reason="x" * 501), "501 letters"),
    "properties": (
        {"type": "Feature", "geometry": POLYGON, "properties": [1]},
        "properties are no object",
    ),
    "many regions": ({"type": "FeatureCollection", "features": [feature()] * 1001}, "1001 regions"),
    "roi: cut": (roi(0, (0, 0, 9, 9), [(0, 0), (9, 0), (9, 9)])[:70], "ends early"),
    "roi: a line": (roi(3), "a line, which covers no area"),
    "roi: a text": (roi(1, (0, 0, 9, 9), at_48=1), "a text, which"),
    "roi: composite that is cut": (roi(1, (0, 0, 9, 9), at_38=70), "ends early"),
    "roi: composite with curves": (composite(0, 1, 1, 2, 5, 1, 5, 5, 4), "with curves; split it"),
    "roi: composite of unknown parts": (composite(0, 1, 1, 9, 5, 5), "unknown parts; split it"),
    "roi: composite without a beginning": (composite(1, 5, 5, 1, 9, 9), "0 borders"),
    "roi: composite of points": (composite(0, 1, 1, 4, 0, 5, 5, 1, 9, 9, 4), "0 borders"),
    "roi: nothing": (roi(1, (3, 3, 3, 9)), "6 x 0 pixels"),
    "roi: endless": (roi(2, fine=(0, 0, float("inf"), 1)), "inf x 1 pixels"),
    "roi: not a number": (
        roi(0, points=[(0, 0)] * 3, fine=[(0, 0), (1, float("nan")), (1, 1)]),
        "no number",
    ),
    "roi: two points": (roi(0, points=[(0, 0), (1, 1)]), "it has 2 points"),
    "roi: unknown": (roi(77), "unknown type 77"),
    "zip: empty": (archive(), "empty archive"),
    "zip: cut": (archive(a=TRIANGLE)[:-30], "damaged archive"),
    "zip: a picture": (archive(a=TRIANGLE, b=b"\x89PNG"), "'b.roi': it is no selection"),
    "zip: a bomb": (archive(a=bytes(64_000_001)), "too large when unpacked"),
    "zip: many": (archive(**{f"r{k}": b"" for k in range(2001)}), "more than 1000 entries"),
}


@pytest.mark.parametrize(("content", "words"), WRONG.values(), ids=WRONG)
def test_a_wrong_file_is_refused_with_its_faults(tmp_path, content, words):
    with pytest.raises(FileError, match=words) as error:
        read(tmp_path, content)
    assert "regions.json" in str(error.value)


@pytest.mark.ci
@given(st.data())
def test_damaged_bytes_are_read_or_refused(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp()
    files = [
        TRIANGLE,
        roi(2, (0, 0, 9, 9)),
        composite(0, 1, 1, 1, 5, 1, 1, 5, 5, 4),
        archive(a=TRIANGLE),
    ]
    whole = data.draw(st.sampled_from(files))
    damaged = bytearray(whole)
    for at, value in data.draw(
        st.lists(st.tuples(st.integers(0, len(whole) - 1), st.integers(0, 255)), max_size=4)
    ):
        damaged[at] = value
    try:
        found = read(folder, bytes(damaged[: data.draw(st.integers(0, len(whole)))]))
    except PlanishError:
        return
    assert all(
        np.isfinite(ring).all()
        for one in found.declared
        for rings in one.polygons
        for ring in rings
    )


def test_regions_off_the_reference_or_all_over_it_are_refused(tmp_path):
    grid = Grid.regular((20, 30), 2.0)
    beside, over = bent([-9, -9], [-1, -9], [-1, 70]), bent([-9, -9], [99, -9], [99, 99], [-9, 99])
    for content, word in ((beside, "no pixel"), (over, "every pixel")):
        path = written(tmp_path / f"{word}.json", content)
        with pytest.raises(
            InputError, match=rf"{word} of the reference .* x from 0 to 58 um and y from 0 to 38 um"
        ):
            regions_on(read_regions(path), grid, str(path))


# --- studies and runs -----------------------------------------------------------------------------
def test_a_study_names_them_by_a_relative_path(tmp_path):
    volume, image = (
        VolumeParams(path=str(tmp_path / "v.tif")),
        ImageParams(path=str(tmp_path / "i.tif")),
    )
    layers = (GivenLayer(name="sheet", volume=volume), GivenLayer(name="image", image=image))
    study = Study(layers=layers, correlate=CorrelateParams(regions=str(tmp_path / "in" / "r.json")))
    write_study(study, tmp_path, home=tmp_path, version="")
    assert 'regions = "in/r.json"' in (tmp_path / "run.toml").read_text()
    assert read_study(tmp_path / "run.toml") == study
    refused(
        ValueError, "a single layer has none", Study, layers=layers[:1], correlate=study.correlate
    )


@pytest.mark.parametrize(
    ("content", "words"), [(b"{}", "no GeoJSON"), (bent([-9, 0], [-1, 0], [-1, 9]), "no pixel")]
)
@pytest.mark.usefixtures("unread")
def test_a_file_of_no_use_is_refused_before_the_volume_is_read(
    refuses, specimen_files, tmp_path, content, words
):
    path = written(tmp_path / "r.json", content)
    refuses("link", *specimen_files, "--regions", path, words=(words, "r.json"))


@pytest.fixture(scope="module")
def stain(tmp_path_factory):
    """A selection of ImageJ, 60 x 50 pixels of 5 um."""
    properties = "reason: coffee\nauthor: A. B.\n"
    return written(
        tmp_path_factory.mktemp("roi") / "stain.roi",
        roi(1, (100, 120, 150, 180), properties=properties),
    )


@pytest.fixture(scope="module")
def stained_run(stain, linked_run, specimen_files, tmp_path_factory):
    out = tmp_path_factory.mktemp("stained") / "run"
    link(linked_run, specimen_files[1], out=out, correlate={"regions": str(stain)})
    return out


def test_a_region_counts_in_no_figure_of_a_run_or_a_stage(stain, linked_run, stained_run):
    before, run = open_run(linked_run), open_run(stained_run)
    expected = before.linked["valid"].values.copy()
    assert expected[100:150, 120:180].mean() > 0.5
    expected[100:150, 120:180] = False
    np.testing.assert_array_equal(run.linked["valid"].values, expected)
    assert run.linked["valid"].attrs["long_name"].endswith("outside of declared regions")
    facts, share = run.results.regions, 3000 / expected.size
    assert (facts.count, facts.share) == (1, share)
    assert facts.regions[0].model_dump() == {
        "name": "stain",
        "reason": "coffee",
        "author": "A. B.",
        "share": share,
    }
    a, b = (run.linked[name].values[expected].astype(np.float64) for name in ("thickness", "image"))
    known = np.isfinite(a) & np.isfinite(b)
    row = next(row for row in run.results.correlations if row.a_map == "thickness")
    assert (row.n, row.r) == (
        known.sum(),
        pytest.approx(np.corrcoef(a[known], b[known])[0, 1], abs=1e-9),
    )
    assert max(row.n for row in run.results.comparison) <= expected.sum()
    for one, other in zip(run.results.comparison, before.results.comparison, strict=True):
        assert one.n < other.n
    assert run.results.linked.share_valid == expected.mean()
    rows = correlate_maps(before.linked, params=CorrelateParams(regions=str(stain)))
    # The stage takes them out as the run does; it makes none of the checks that doubt a row.
    expected_rows = [row.model_copy(update={"trust": "ok"}) for row in run.results.correlations]
    assert list(rows) == expected_rows
    html = (stained_run / "report.html").read_text(encoding="utf-8")
    for words in (
        "1 region, 3.8",
        '<td class="name">coffee</td>',
        "A. B.",
        "without holes, rims and declared regions",
    ):
        assert words in html
    assert "declared regions" not in (linked_run / "report.html").read_text(encoding="utf-8")


def test_regions_count_in_no_pair_of_images(passes, kinds, tmp_path):
    path = written(tmp_path / "r.json", bent([600, 500], [900, 500], [900, 750], [600, 750]))
    layers = (f"white={kinds.small.image}", f"uv={kinds.other.image}")
    passes("link", *layers, "--regions", path, "-o", tmp_path / "run", codes=(0, 4))
    less, whole = open_run(tmp_path / "run"), open_run(kinds("images"))
    inside = less.regions.inside(Grid.of(less.layers["uv"]))
    assert inside.sum() == 50 * 41  # pixels of 6 um
    valid = {name: whole.layers[name]["valid"].values & ~inside for name in ("white", "uv")}
    for name in valid:
        np.testing.assert_array_equal(less.layers[name]["valid"].values, valid[name])
    n = (valid["white"] & valid["uv"]).sum()
    assert less.results.correlations[0].n == n < whole.results.correlations[0].n


def test_hostile_texts_stay_text_on_the_page():
    run = a_run()
    one = {
        "name": "<b>x</b>",
        "reason": "</td><script>alert(1)</script>",
        "author": "",
        "share": 0.25,
    }
    run["results"] |= {"regions": {"count": 1, "share": 0.25, "regions": [one]}}
    text = page_of(run)
    assert "<script" not in text
    assert "&lt;/td&gt;&lt;script&gt;" in text
    assert "&lt;b&gt;x" in text
    assert "not given" in text
    assert "not given</td>" not in page_of(a_run())
    assert Results.model_validate(run["results"]).regions is not None
