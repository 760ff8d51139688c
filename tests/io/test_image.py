"""Images: values as stored, the channel asked for, the pixel size or a refusal."""

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image

from folders import refused
from planish.core.errors import FileError, InputError, ResourceError, SizeError
from planish.io import read_image


def picture(dtype="uint8", shape=(7, 9)):
    return np.random.default_rng(5).integers(0, 120, shape).astype(dtype)


@pytest.mark.parametrize(
    "dtype", ["uint8", "int8", "uint16", "int16", "uint32", "float16", "float32", "float64"]
)
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_grey_tiff_survives(tmp_path, dtype, compression):
    tifffile.imwrite(
        tmp_path / "i.tif", picture(dtype), photometric="minisblack", compression=compression
    )
    image = read_image(tmp_path / "i.tif", pixel_um=(3, 2))
    assert (image.dims, image.dtype) == (("y", "x"), np.float32)
    np.testing.assert_array_equal(image.values, picture(dtype))
    np.testing.assert_array_equal(image.y, np.arange(7) * 3.0)
    np.testing.assert_array_equal(image.x, np.arange(9) * 2.0)
    assert image.attrs == image.attrs | {
        "full_scale": None if dtype.startswith("float") else np.iinfo(dtype).max,
        "pixel_um": [3, 2],
        "pixel_um_source": "given",
        "long_name": "Grey value, uncalibrated",
        "file_name": "i.tif",
        "file_bytes": (tmp_path / "i.tif").stat().st_size,
    }


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("samples", [1, 2, 3, 4])
def test_png_keeps_all_its_bits(tmp_path, dtype, samples):
    values = picture(dtype, (7, 9, samples)) * (500 if dtype == "uint16" else 1)
    (tmp_path / "i.png").write_bytes(imagecodecs.png_encode(values.squeeze()))
    for channel in range(samples):
        image = read_image(tmp_path / "i.png", pixel_um=1, channel=str(channel))
        np.testing.assert_array_equal(image.values, values[..., channel])
        assert image.attrs["full_scale"] == np.iinfo(dtype).max


@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_channels_of_a_colour_image(tmp_path, planar):
    values = picture(shape=(7, 9, 3))
    stored = values if planar == "contig" else np.moveaxis(values, -1, 0)
    tifffile.imwrite(tmp_path / "i.tif", stored, photometric="rgb", planarconfig=planar)
    for i, colour in enumerate(("red", "green", "blue")):
        image = read_image(tmp_path / "i.tif", pixel_um=1, channel=colour)
        np.testing.assert_array_equal(image.values, values[..., i])
        assert image.attrs["long_name"] == f"Grey value, uncalibrated, {colour}"
    luminance = read_image(tmp_path / "i.tif", pixel_um=1)
    np.testing.assert_allclose(luminance, values @ [0.2126, 0.7152, 0.0722], rtol=1e-5)  # float32
    assert luminance.attrs["channel"] == "luminance"
    with pytest.raises(
        InputError,
        match=r"has 3 channels, number 3 is not among them\. Choose 0 to 2 with channel=",
    ):
        read_image(tmp_path / "i.tif", pixel_um=1, channel="3")
    refused(
        InputError,
        "'alpha' is no channel",
        read_image,
        tmp_path / "i.tif",
        pixel_um=1,
        channel="alpha",
    )


def test_alpha_does_not_change_colour_or_grey(tmp_path):
    rgba = picture(shape=(7, 9, 4))
    Image.fromarray(rgba, "RGBA").save(tmp_path / "i.png")
    Image.fromarray(rgba[..., :3]).save(tmp_path / "j.png")
    with_alpha, without = (
        read_image(tmp_path / name, pixel_um=1).values for name in ("i.png", "j.png")
    )
    np.testing.assert_array_equal(with_alpha, without)


def test_channels_that_an_image_lacks_are_refused(tmp_path):
    tifffile.imwrite(tmp_path / "i.tif", picture())
    with pytest.raises(InputError, match=r"is a grey image, so it has no red\. Choose luminance"):
        read_image(tmp_path / "i.tif", pixel_um=1, channel="red")
    values = picture(shape=(8, 8, 4))
    tifffile.imwrite(tmp_path / "i.tif", values, photometric="separated")
    refused(
        InputError,
        "4 channels that are not red, green, blue",
        read_image,
        tmp_path / "i.tif",
        pixel_um=1,
    )
    np.testing.assert_array_equal(
        read_image(tmp_path / "i.tif", pixel_um=1, channel="2").values, values[..., 2]
    )


def test_jpeg_and_palettes_give_their_values(tmp_path):
    smooth = np.add.outer(np.arange(40), np.arange(60)).astype(np.uint8)
    Image.fromarray(smooth).save(tmp_path / "i.jpg", quality=95)
    # Levels lost at quality 95.
    np.testing.assert_allclose(read_image(tmp_path / "i.jpg", pixel_um=1), smooth, atol=3)
    index = picture()
    palette = np.random.default_rng(1).integers(0, 256, (256, 3)).astype(np.uint8)
    image = Image.fromarray(index, "P")
    image.putpalette(palette.tobytes())
    image.save(tmp_path / "i.png")
    tifffile.imwrite(
        tmp_path / "i.tif",
        index,
        photometric="palette",
        colormap=(palette.T.astype(np.uint16) * 257),
    )
    for name in ("i.png", "i.tif"):
        read = read_image(tmp_path / name, pixel_um=1, channel="green")
        np.testing.assert_array_equal(read.values, palette[index, 1])


def test_orientation_tags_and_thumbnails_change_nothing(tmp_path):
    exif = Image.Exif()
    exif[274] = 6
    Image.fromarray(picture()).save(tmp_path / "i.png", exif=exif)
    image = read_image(tmp_path / "i.png", pixel_um=1)
    np.testing.assert_array_equal(image.values, picture())
    assert image.attrs["orientation"] == 6
    with tifffile.TiffWriter(tmp_path / "i.tif") as tif:
        tif.write(picture(), metadata=None)
        tif.write(picture(shape=(3, 4)), metadata=None, subfiletype=1)
    np.testing.assert_array_equal(read_image(tmp_path / "i.tif", pixel_um=1).values, picture())


def test_missing_values_stay_missing(tmp_path):
    values = picture("float64")
    values[2, 3], values[4, 5], values[0, 0] = np.nan, np.inf, 1e300
    tifffile.imwrite(tmp_path / "i.tif", values)
    read = read_image(tmp_path / "i.tif", pixel_um=1).values
    assert np.isnan(read[[2, 4, 0], [3, 5, 0]]).all()
    assert np.isnan(read).sum() == 3
    tifffile.imwrite(tmp_path / "i.tif", np.full((4, 4), np.nan))
    refused(FileError, "no pixel with a number", read_image, tmp_path / "i.tif", pixel_um=1)


@pytest.mark.parametrize("extension", [".png", ".jpg", ".tif"])
def test_the_pixel_size_is_read_from_the_resolution_unless_it_is_a_default(tmp_path, extension):
    path = tmp_path / f"i{extension}"
    Image.fromarray(picture()).save(path, dpi=(1270, 2540))
    image = read_image(path)
    # PNG stores whole pixels per metre.
    assert image.attrs["pixel_um"] == pytest.approx([10, 20], rel=1e-4)
    kind = {".png": "PNG", ".jpg": "JPEG", ".tif": "TIFF"}[extension]
    assert image.attrs["pixel_um_source"] == f"the {kind} resolution"
    refused(
        SizeError,
        r"pixel_um= gives y 5, x 5 um, but the .* override_size=True",
        read_image,
        path,
        pixel_um=5,
    )
    assert read_image(path, pixel_um=5, override_size=True).attrs["pixel_um"] == [5, 5]
    read = r"( \(.* 72(\.01)? per inch says nothing of the size\))?"
    words = rf"states no pixel size{read}\. Give it with pixel_um=SIZE \(or Y,X\), in um"
    for options in ({}, {"dpi": (72, 72)}):  # which programs write that do not know
        Image.fromarray(picture()).save(path, **options)
        refused(SizeError, words, read_image, path)
    assert read_image(path, pixel_um=400).attrs["pixel_um"] == [400, 400]


def test_a_stack_and_a_folder_are_no_image(tmp_path):
    tifffile.imwrite(tmp_path / "i.tif", picture(shape=(5, 7, 9)), photometric="minisblack")
    refused(
        FileError, "is not one picture but 5 x 7 x 9", read_image, tmp_path / "i.tif", pixel_um=1
    )
    refused(FileError, "is not a file", read_image, tmp_path, pixel_um=1)


def test_the_pixel_limit_is_ours_not_pillows(tmp_path, monkeypatch):
    Image.fromarray(picture(shape=(70, 90))).save(tmp_path / "i.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)  # Image.open would raise
    assert read_image(tmp_path / "i.png", pixel_um=1).shape == (70, 90)
    refused(
        ResourceError,
        r"^i\.png needs",
        read_image,
        tmp_path / "i.png",
        pixel_um=1,
        memory_bytes=1000,
    )


REFUSED = {
    "cmyk-3c-16b.tiff": "not red, green, blue",
    "cmyk-3c-32b-float.tiff": "not red, green, blue",
    "cmyk-3c-8b.tiff": "not red, green, blue",
    "cmyk-4c-8b.tiff": "not red, green, blue",
    "seq-4c-16b-cmyk-c6e52592.tiff": "not red, green, blue",
    "seq-4c-8b-cmyk-352ac1da.tiff": "not red, green, blue",
    "tiled-cmyk-i8.tif": "not red, green, blue",
    "seq-3c-i16-f7fcf423.tiff": "not red, green, blue",  # three samples declared as grey
    "seq-3c-i8-d7550ce4.tiff": "not red, green, blue",
    "logluv-3c-16b.tiff": "cannot be decoded",  # SGI LogLuv has no decoder here
    "seq-1c-8b-multipage-adeefdcc.tiff": "not one picture but 3 x 16 x 16",
}


def test_valid_tiff_files_of_all_kinds_are_read_but_for_those_named(shared_data):
    files = sorted(shared_data("tiff_corpus/images").iterdir())
    assert len(files) > 100
    for path in files:
        if path.name in REFUSED:
            refused(
                InputError, REFUSED[path.name], read_image, path, pixel_um=1, override_size=True
            )
        else:
            image = read_image(path, pixel_um=1, override_size=True)
            expected = tifffile.imread(path)
            assert image.shape in {expected.shape[:2], expected.shape[1:]}
            if "miniswhite" not in path.name and "palette" not in path.name and expected.ndim == 2:
                with tifffile.TiffFile(path) as tif:
                    white = tif.pages.first.photometric == 0
                np.testing.assert_array_equal(
                    image.values, (~expected if white else expected).astype(np.float32)
                )
    print(f"{len(files)} valid TIFF files, {len(REFUSED)} refused")
