"""Pixel sizes from a resolution that nobody measured are doubted, those of scanners are not."""

import re

import numpy as np
import pytest
import tifffile
from PIL import Image

from planish.io import describe, read_image, read_volume

GREY = np.random.default_rng(0).integers(0, 255, (40, 50), dtype=np.uint8)
CAMERA = {271: "NIKON CORPORATION", 272: "D850", 33434: 0.01}
SCANNER = {271: "EPSON", 272: "Perfection V850", 305: "EPSON Scan"}


def exif(tags):
    data = Image.Exif()
    for code, value in tags.items():
        owner = data.get_ifd(34665) if code > 33000 else data
        owner[code] = value
    return data


def written(path, dpi, tags):
    options = {} if path.suffix == ".bmp" else {"exif": exif(tags)}
    if path.suffix == ".tif":
        options = {"tiffinfo": {code: value for code, value in tags.items() if code < 33000}}
    Image.fromarray(GREY).save(path, dpi=(dpi, dpi), **options)
    return path


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", ".bmp"])
@pytest.mark.parametrize("dpi", [100, 150, 180, 200, 240, 300, 350, 400, 600])
def test_a_size_from_a_default_resolution_is_doubted_by_name(tmp_path, suffix, dpi):
    path = written(tmp_path / f"i{suffix}", dpi, {})
    facts = describe(path)
    assert facts["size_um"] == pytest.approx([25400 / dpi] * 2, rel=1e-4)
    (doubt,) = [w for w in facts["warnings"] if "dpi" in w]
    assert f"is {dpi} dpi, which cameras and editors write by default." in doubt
    assert "`pixel_um=SIZE` and `override_size=True`" in doubt
    assert f"of {dpi} dpi" in facts["size_source"]
    assert read_image(path).attrs["size_doubt"] in doubt
    known = read_image(path, pixel_um=4, override_size=True)
    assert "size_doubt" not in known.attrs
    assert (
        f"in place of the {'TIFF' if suffix == '.tif' else suffix[1:].upper()}"[:18]
        in (known.attrs["pixel_um_source"])
    )


@pytest.mark.parametrize(
    ("name", "dpi", "tags", "words"),
    [
        ("i.jpg", 300, SCANNER, ""),
        ("i.tif", 600, SCANNER, ""),
        ("i.png", 600, {305: "VueScan 9"}, ""),
        ("i.jpg", 1200, {}, ""),
        ("i.tif", 2400, {}, ""),
        ("i.jpg", 300, CAMERA, r"by a camera \(NIKON CORPORATION D850\)"),
        ("i.jpg", 314, CAMERA, r"314 dpi, written by a camera"),
        ("i.tif", 240, {305: "Adobe Lightroom"}, r"by default \(Adobe Lightroom\)"),
    ],
)
def test_the_tags_say_what_wrote_it(tmp_path, name, dpi, tags, words):
    facts = describe(written(tmp_path / name, dpi, tags))
    doubts = " ".join(w for w in facts["warnings"] if "dpi" in w)
    if words:
        assert doubts
        assert pytest.approx(25400 / dpi, rel=1e-4) == facts["size_um"][0]
    assert re.search(words, doubts)
    assert bool(words) == bool(doubts)
    is_scan = tags == SCANNER or "VueScan 9" in tags.values()
    assert read_image(tmp_path / name).attrs["is_scan"] == is_scan


def test_whole_pixels_per_cm_and_inches_of_imagej_are_the_same_default(tmp_path):
    tifffile.imwrite(tmp_path / "c.tif", GREY, resolution=(118, 118), resolutionunit="CENTIMETER")
    assert "cameras and editors" in read_image(tmp_path / "c.tif").attrs["size_doubt"]
    meta = {"unit": "inch"}
    tifffile.imwrite(tmp_path / "j.tif", GREY, imagej=True, resolution=(300, 300), metadata=meta)
    image = read_image(tmp_path / "j.tif")
    assert "300 dpi" in image.attrs["size_doubt"]
    assert image.attrs["pixel_um_source"] == "ImageJ metadata of 300 dpi"
    ome = {"axes": "YX", "PhysicalSizeX": 25.4, "PhysicalSizeY": 25.4}
    tifffile.imwrite(
        tmp_path / "o.ome.tif", GREY, metadata=ome, resolution=(1000, 1000), resolutionunit="INCH"
    )
    assert "size_doubt" not in read_image(tmp_path / "o.ome.tif").attrs


def test_slices_and_stacks_are_doubted_too(tmp_path):
    meta = {"unit": "inch", "spacing": 1 / 300, "axes": "ZYX"}
    stack = np.stack([GREY] * 6)
    tifffile.imwrite(tmp_path / "v.tif", stack, imagej=True, resolution=(300, 300), metadata=meta)
    assert "300 dpi" in read_volume(tmp_path / "v.tif").attrs["size_doubt"]
    (doubt,) = [w for w in describe(tmp_path / "v.tif")["warnings"] if "dpi" in w]
    assert "`voxel_um=SIZE`" in doubt


@pytest.mark.parametrize(
    ("meta", "words"),
    [
        ({"spacing": 2, "zunit": "pixel"}, r"its spacing: 'pixel' is no unit of length"),
        ({"spacing": -3.0}, r"its spacing: -3 is no size"),
        ({"spacing": 0}, r"its spacing: 0 is no size"),
        ({}, r"it has no slice spacing \(ImageJ leaves out"),
    ],
)
def test_what_imagej_wrote_in_place_of_a_spacing_is_said(tmp_path, meta, words):
    meta = {"unit": "um", "axes": "ZYX"} | meta
    stack = np.stack([GREY] * 6)
    tifffile.imwrite(tmp_path / "v.tif", stack, imagej=True, resolution=(0.5, 0.5), metadata=meta)
    assert describe(tmp_path / "v.tif")["size_um"] is None
    (problem,) = [w for w in describe(tmp_path / "v.tif")["warnings"] if "voxel size" in w]
    assert re.search(words, problem)
    assert ("leaves out" in problem) == ("leaves out" in words)


def test_a_search_for_holes_says_the_doubt_before_it_finds_none(tmp_path, planish):
    path = written(tmp_path / "i.png", 300, {})
    _, _, err = planish("holes", path, "--out", tmp_path / "h.csv")
    words = " ".join(err.split())
    assert "look: 84.67 um a pixel is 300 dpi, which cameras and editors write by default" in words
    assert "--pixel-um SIZE and --override-size" in words
