"""Maps come back from every format by a reader that is not its writer: values to float32, sizes
exactly, NaN."""

import base64
import csv
import io
import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from mat4py import loadmat
from PIL import Image
from pymatreader import read_mat
from tests.exports.contents import FIRST_UM, HISTORY, PIXEL_UM, files_of, maps, written

from planish.core.errors import ResourceError, StudyError
from planish.exports import FORMATS, ExportParams, Maps, matlab
from planish.io import read_topography
from planish.report import Scale

OME = "{http://www.openmicroscopy.org/Schemas/OME/2016-06}"


def values(content, name):
    return content.data[name].values.astype(np.float64)


def same(found, content, name):
    """Equal to float32, and NaN at the same pixels."""
    np.testing.assert_array_equal(
        np.asarray(found, np.float32), values(content, name).astype(np.float32)
    )


def test_a_tiff_has_named_channels_a_size_in_um_and_bytes_for_truth_alone(tmp_path):
    content = maps()
    with Image.open(written(content, tmp_path / "maps.tif", "tiff")) as image:
        assert image.n_frames == 4
        about = dict(line.split("=", 1) for line in image.tag_v2[270].split("\n") if "=" in line)
        assert (about["unit"], about["channels"]) == ("um", "4")
        # ImageJ's pixel is the reciprocal of the resolution, a fraction.
        sizes = [image.tag_v2[tag].denominator / image.tag_v2[tag].numerator for tag in (283, 282)]
        assert tuple(sizes) == PIXEL_UM
        assert HISTORY.study_sha256 in image.tag_v2[50839].decode("utf-16-le", "ignore")
        for k, name in enumerate(content.names):
            image.seek(k)
            same(np.asarray(image), content, name)
    with Image.open(written(content.only("valid"), tmp_path / "valid.tif", "tiff")) as image:
        assert image.mode == "L"
        same(np.asarray(image), content, "valid")


def test_an_ome_tiff_says_size_place_and_channels(tmp_path):
    content = maps()
    with Image.open(written(content, tmp_path / "maps.ome.tif", "ome-tiff")) as image:
        text = image.tag_v2[270].encode("latin-1").decode("utf-8")  # Pillow takes it for Latin-1
        for k, name in enumerate(content.names):
            image.seek(k)
            same(np.asarray(image), content, name)
    root = ET.fromstring(text)
    pixels = root.find(f"{OME}Image/{OME}Pixels")
    assert (float(pixels.get("PhysicalSizeY")), float(pixels.get("PhysicalSizeX"))) == PIXEL_UM
    assert pixels.get("PhysicalSizeXUnit") == "µm"
    assert [c.get("Name") for c in pixels.findall(f"{OME}Channel")] == [
        "coating_top (um)",
        "tilt (deg)",
        "valid",
        "status",
    ]
    plane = pixels.find(f"{OME}Plane")
    assert (float(plane.get("PositionY")), float(plane.get("PositionX"))) == FIRST_UM
    assert (
        json.loads(root.find(f"{OME}Image/{OME}Description").text)["study_sha256"]
        == HISTORY.study_sha256
    )


@pytest.mark.parametrize("several", [pytest.param(True, marks=pytest.mark.ci), False])
def test_an_ome_zarr_is_read_by_another_library(tmp_path, several):
    import tensorstore as ts

    content = maps() if several else maps().only("coating_top")
    path = written(content, tmp_path / "maps.ome.zarr", "ome-zarr")

    def level(k):
        place = {"driver": "zarr3", "kvstore": {"driver": "file", "path": str(path / str(k))}}
        return ts.open(place).result().read().result()

    about = json.loads((path / "zarr.json").read_text(encoding="utf-8"))["attributes"]
    image = about["ome"]["multiscales"][0]
    assert [axis.get("unit") for axis in image["axes"]][-2:] == ["micrometer", "micrometer"]
    finest = image["datasets"][0]["coordinateTransformations"]
    assert (tuple(finest[0]["scale"][-2:]), tuple(finest[1]["translation"][-2:])) == (
        PIXEL_UM,
        FIRST_UM,
    )
    assert json.loads(about["planish"]["history"])["study_sha256"] == HISTORY.study_sha256
    for k, name in enumerate(content.names):
        same(level(0)[k] if several else level(0), content, name)
    assert len(image["datasets"]) == 3  # the last one has at most 512 pixels a side
    coarse = level(2)[0] if several else level(2)
    part = values(content, "coating_top")[4:8, 8:12]
    np.testing.assert_allclose(
        coarse[1, 2],
        np.nanmean([[np.nanmean(part[a : a + 2, b : b + 2]) for b in (0, 2)] for a in (0, 2)]),
        rtol=1e-6,
    )
    second = image["datasets"][1]["coordinateTransformations"]
    assert second[1]["translation"][-1] == pytest.approx(FIRST_UM[1] + PIXEL_UM[1] / 2)


def test_a_netcdf_keeps_types_coordinates_and_units(tmp_path):
    netCDF4 = pytest.importorskip("netCDF4")
    content = maps(dims=("v", "u"))
    with netCDF4.Dataset(written(content, tmp_path / "maps.nc", "netcdf")) as file:
        assert file.Conventions.startswith("CF-1.")
        assert json.loads(file.history)["study_sha256"] == HISTORY.study_sha256
        for name in content.names:
            same(np.ma.filled(file[name][:].astype(np.float64), np.nan), content, name)
        assert file["tilt"].dtype == np.float64
        assert (file["coating_top"].units, file["tilt"].units) == ("um", "degree")
        assert file["status"].flag_meanings == "a b c"
        for dim, first, pixel in zip(("v", "u"), FIRST_UM, PIXEL_UM, strict=True):
            np.testing.assert_array_equal(file[dim][:], content.data[dim].values)
            assert (file[dim][0], file[dim].units) == (first, "um")
            assert file[dim][1] - file[dim][0] == pytest.approx(pixel, abs=1e-12)


@pytest.mark.parametrize(("version", "read"), [("5", loadmat), ("7.3", read_mat)])
def test_a_matlab_file_is_read_without_scipy(tmp_path, version, read):
    content = maps((60, 110))
    path = written(content, tmp_path / "maps.mat", "mat", mat_version=version)
    if version == "7.3":
        assert (path.read_bytes()[:20], path.read_bytes()[124:128]) == (
            b"MATLAB 7.3 MAT-file,",
            b"\x00\x02IM",
        )
    found = read(str(path))
    for name in content.names:
        same(found[name], content, name)
    assert tuple(found["pixel_um"]) == PIXEL_UM
    for axis in "xy":
        np.testing.assert_array_equal(found[f"{axis}_um"], content.data[axis].values)
    assert (found["units"]["tilt"], found["titles"]["coating_top"]) == (
        "deg",
        "Coating thickness, top side",
    )
    assert json.loads(found["history"])["study_sha256"] == HISTORY.study_sha256


def test_maps_beyond_2_gb_take_version_7_3(monkeypatch):
    content = maps((60, 110))
    assert matlab.chosen_version(content, ExportParams(to="mat")) == "5"
    monkeypatch.setattr(matlab, "WHOLE_BYTES", 1000)
    assert matlab.chosen_version(content, ExportParams(to="mat")) == "7.3"
    monkeypatch.setattr(matlab, "MOST_5", 1000)
    with pytest.raises(ResourceError, match=r"holds 2 GB. Leave out mat_version="):
        matlab.chosen_version(content, ExportParams(to="mat", mat_version="5"))


@pytest.mark.ci
def test_gwyddion_channels_are_in_metres_and_masked(tmp_path):
    content = maps((60, 110))
    path = written(content, tmp_path / "maps.gwy", "gwy")
    found = read_topography(path, unusual_size=True)
    np.testing.assert_allclose(found.attrs["pixel_um"], PIXEL_UM, rtol=1e-12)
    expected = values(content, "coating_top")
    known = np.isfinite(expected)
    # SurfaceTopography may or may not look at the mask: below it stands the mean.
    heights = np.asarray(found.values)
    np.testing.assert_allclose(heights[known], expected[known], rtol=1e-6)
    rest = heights[~known]
    assert np.isnan(rest).all() or np.allclose(rest, expected[known].mean())
    assert b"/0/mask" in path.read_bytes()
    assert b"/2/mask" not in path.read_bytes()  # nothing is missing there
    assert HISTORY.study_sha256.encode() in path.read_bytes()


def test_a_matrix_of_text(tmp_path):
    content = maps((60, 110))
    path = written(content.only("coating_top"), tmp_path / "coating_top.txt", "txt")
    same(np.loadtxt(path), content, "coating_top")
    head = [line for line in path.read_text(encoding="utf-8").split("\n") if line.startswith("#")]
    assert head[0] == "# coating_top: Coating thickness, top side"
    assert head[1:4] == [
        "# unit: um",
        "# pixel: 1.37 um along x, 2.6 um along y",
        "# middle of the first pixel: x = -66.0 um, y = -18.2 um",
    ]
    assert json.loads(head[-1][2:])["study_sha256"] == HISTORY.study_sha256


def table(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    assert json.loads(lines[0][2:])["study_sha256"] == HISTORY.study_sha256
    return list(csv.DictReader(lines[1:]))


def test_a_table_of_pixels(tmp_path):
    content = maps((60, 110))
    rows = table(written(content, tmp_path / "maps.csv", "csv", point_um=0))
    assert list(rows[0]) == ["x_um", "y_um", "coating_top_um", "tilt_deg", "valid", "status"]
    whole = np.full((60, 110), np.nan)
    for row in rows:
        at = (
            round((float(row["y_um"]) - FIRST_UM[0]) / PIXEL_UM[0]),
            round((float(row["x_um"]) - FIRST_UM[1]) / PIXEL_UM[1]),
        )
        whole[at] = float(row["coating_top_um"])
    same(whole, content, "coating_top")


def test_a_table_of_points_holds_means_over_valid_pixels_and_no_less(tmp_path):
    content = maps((60, 110))
    rows = table(written(content, tmp_path / "maps.csv", "csv", point_um=26.0))
    assert len(rows) == 6 * 5  # 156 um and 150.7 um in whole points; 80 % of each is valid
    first = rows[0]
    assert float(first["y_um"]) == pytest.approx(FIRST_UM[0] - 1.3 + 13.0)
    assert float(first["x_um"]) == pytest.approx(FIRST_UM[1] - 0.685 + 13.0)
    # 10 rows, and 18 whole columns and most of another: weighted by their area.
    part = values(content, "coating_top")[:10, :19]
    weight = np.where(np.isfinite(part), np.append(np.ones(18), 26.0 / 1.37 - 18), 0.0)
    assert float(first["coating_top_um"]) == pytest.approx(
        (np.nan_to_num(part) * weight).sum() / weight.sum(), rel=1e-6
    )
    assert float(first["valid_share"]) == pytest.approx(weight.sum() / (10 * 26.0 / 1.37), rel=1e-6)
    with pytest.raises(StudyError, match=r"A point of 2 um is smaller than a pixel of 2.6 um"):
        written(maps((60, 110)), tmp_path / "maps.csv", "csv", point_um=2.0)


@pytest.mark.ci
def test_pictures_show_the_pixels_in_their_colours(tmp_path):
    content = Maps(
        data=maps((60, 110)).data[["coating_top"]],
        group="linked",
        scales={"coating_top": Scale(low=0.0, high=40.0)},
    )
    with Image.open(written(content, tmp_path / "map.png", "png")) as image:
        pixels = np.asarray(image.convert("RGB"))
        assert json.loads(image.text["Description"])["study_sha256"] == HISTORY.study_sha256
        assert image.text["Software"] == "planish 0.2.0"
    # 9 pixels of the picture across one of the map, 17.08 down; the map begins at 180, 84.
    from matplotlib import colormaps

    root = ET.fromstring(written(content, tmp_path / "map.svg", "svg").read_text(encoding="utf-8"))
    drawn = next(root.iter("{http://www.w3.org/2000/svg}image"))
    # Its last row is the first one that is seen.
    assert drawn.get("transform").startswith("scale(1 -1)")
    coded = drawn.get("{http://www.w3.org/1999/xlink}href").partition(",")[2]
    inside = np.asarray(Image.open(io.BytesIO(base64.b64decode(coded))).convert("RGB"))[::-1]
    assert inside.shape[:2] == (1025, 9 * 110)
    expected = values(content, "coating_top")
    seen = 0
    for row, col in ((3, 4), (30, 50), (59, 109), *np.argwhere(np.isnan(expected))[:3].tolist()):
        colour = colormaps["viridis"](expected[row, col] / 40.0, bytes=True)[:3]
        if np.isnan(expected[row, col]):
            colour, seen = (0xD4, 0xD6, 0xD8), seen + 1
        down, right = int((row + 0.5) * 1025 / 60), 9 * col + 4
        assert pixels[84 + down, 180 + right].tolist() == list(map(int, colour))
        assert inside[down, right].tolist() == list(map(int, colour))
    assert seen >= 3
    words = {"".join(e.itertext()).strip() for e in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"Coating thickness, top side", "µm", "x / µm", "20 µm"} <= words


def test_large_pictures_and_stacks_are_averaged_or_refused(tmp_path, monkeypatch):
    from planish.exports import picture

    monkeypatch.setattr(picture, "MOST", 55)
    content = maps((60, 110))
    reduced, times = picture._reduced(content, "tilt")
    assert times == 2.0
    assert reduced[10, 7] == pytest.approx(values(content, "tilt")[20:22, 14:16].mean(), rel=1e-6)
    from planish.exports import tiff

    monkeypatch.setattr(tiff, "MOST", 100_000)
    written(maps((60, 110)).only("tilt"), tmp_path / "one.tif", "tiff")
    written(maps((60, 110)), tmp_path / "all.ome.tif", "ome-tiff")
    with pytest.raises(
        ResourceError, match=r"holds 4 GB. Give to=.ome-tiff., or a folder for a file each"
    ):
        written(maps((60, 110)), tmp_path / "all.tif", "tiff")


def test_a_nrrd_has_size_and_place(tmp_path):
    sitk = pytest.importorskip("SimpleITK")
    content = maps(dims=("v", "u"))
    path = written(content.only("coating_top"), tmp_path / "coating.nrrd", "nrrd", unit="mm")
    found = sitk.ReadImage(str(path))
    same(sitk.GetArrayFromImage(found), content, "coating_top")
    assert found.GetSpacing() == (0.00137, 0.0026)
    assert found.GetOrigin() == pytest.approx((FIRST_UM[1] / 1000, FIRST_UM[0] / 1000), rel=1e-12)


@pytest.mark.parametrize("to", [to for to, form in FORMATS.items() if "maps" in form.holds])
def test_the_same_maps_with_one_that_is_missing_everywhere_give_the_same_bytes(tmp_path, to):
    content = maps((60, 110))
    content.data["tilt"].values[:] = np.nan
    part = content if FORMATS[to].stack else content.only("tilt")
    one, two = (written(part, tmp_path / name, to) for name in ("one", "two"))
    assert files_of(one) == files_of(two)
