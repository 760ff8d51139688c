"""Folders of slices: the right order, nothing missing, nothing odd, and not twice in memory."""

import random
import tracemalloc

import imagecodecs
import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from folders import refused
from planish.core.errors import FileError, InputError, SizeError, VolumeError
from planish.io import describe, read_volume, slice_names


def stack(dtype="uint8", shape=(12, 7, 9)):
    return np.random.default_rng(3).integers(0, 120, shape).astype(dtype)


def write_folder(folder, values, extension=".tif", name="s{}"):
    folder.mkdir(exist_ok=True)
    for i, page in enumerate(values):
        path = folder / (name.format(i) + extension)
        if extension.startswith(".tif"):
            tifffile.imwrite(path, page, photometric="minisblack")
        else:
            Image.fromarray(page).save(path)
    return folder


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float64", "float16"])
def test_tiff_slices_survive_in_the_order_of_their_numbers(tmp_path, dtype):
    volume = read_volume(write_folder(tmp_path / "v", stack(dtype)), voxel_um=1)
    np.testing.assert_array_equal(volume.values, stack(dtype))  # s10 comes after s9
    assert (volume.dtype, volume.attrs["file_name"]) == (
        "float32" if dtype == "float16" else dtype,
        "v",
    )
    assert volume.attrs["file_bytes"] == sum(p.stat().st_size for p in (tmp_path / "v").iterdir())


def test_jpeg_slices_are_read(tmp_path):
    values = np.repeat(np.arange(12, dtype=np.uint8)[:, None, None] * 20, 16, axis=1).repeat(
        16, axis=2
    )
    volume = read_volume(write_folder(tmp_path / "v", values, ".JPG"), voxel_um=1)
    # JPEG keeps constant blocks to one level.
    np.testing.assert_allclose(volume.values.astype(int), values, atol=1)


def test_grey_palettes_are_grey(tmp_path):
    folder = tmp_path / "v"
    folder.mkdir()
    for i, page in enumerate(stack()):
        image = Image.fromarray(page).convert("P")
        image.putpalette([level for grey in range(256) for level in (grey, grey, grey)])
        image.save(folder / f"{i}.png")
    np.testing.assert_array_equal(read_volume(folder, voxel_um=1).values, stack())


@given(
    first=st.integers(0, 2000),
    step=st.integers(1, 50),
    count=st.integers(2, 30),
    width=st.integers(1, 6),
)
def test_any_numbering_with_a_constant_step_is_ordered(tmp_path_factory, first, step, count, width):
    folder = tmp_path_factory.mktemp("v")
    numbers = [first + i * step for i in range(count)]
    for number in random.Random(1).sample(numbers, count):
        (folder / f"scan_2um_{number:0{width}d}.tif").touch()
    assert [int(p.stem.split("_")[-1]) for p in slice_names.list_slices(folder).files] == numbers


def test_other_files_are_ignored(tmp_path):
    folder = write_folder(tmp_path / "v", stack())
    for name in (
        "LICENSE.upstream",
        "SOURCE.txt",
        "Thumbs.db",
        "scan_rec.log",
        ".hidden1.tif",
        "desktop.ini",
    ):
        (folder / name).write_text("7")
    (folder / "sub5.tif").mkdir()
    assert read_volume(folder, voxel_um=1).shape == (12, 7, 9)


def test_missing_numbers_are_named_but_do_not_fill_the_screen(tmp_path):
    folder = write_folder(tmp_path / "v", stack())
    (folder / "s4.tif").unlink()
    (folder / "s9.tif").unlink()
    refused(
        VolumeError,
        r"^v has 10 slices from 0 to 11, 2 missing: 4, 9\. Add them",
        read_volume,
        folder,
        voxel_um=1,
    )
    (folder / "s11.tif").rename(folder / "s99999999999.tif")
    refused(
        VolumeError,
        r"99999999990 missing: 4, 9, 11, 12, 13, 14, 15, 16, \.\.\.\. Add",
        read_volume,
        folder,
        voxel_um=1,
    )


@pytest.mark.parametrize(
    ("name", "page", "words"),
    [
        (
            "s5.tif",
            stack(shape=(7, 8)),
            r"^s5\.tif is 7 x 8 pixels, s0\.tif is 7 x 9 pixels\. All slices need the sam",
        ),
        (
            "s5.tif",
            stack("uint16", (7, 9)),
            r"^s5\.tif has uint16 values, s0\.tif has uint8 values\. All slices",
        ),
        ("s5.tif", stack(shape=(7, 9, 3)), r"^s5\.tif is rgb, s0\.tif is grey"),
        (
            "preview.tif",
            stack(shape=(7, 9)),
            r"12 images named like s0\.tif, and 1 named otherwise, first preview",
        ),
        ("s05.tif", stack(shape=(7, 9)), r"more than one slice with the number 5"),
        ("s5.tif", stack(shape=(7, 9)) > 3, r"^s5\.tif has black and white only"),
    ],
)
def test_the_odd_slice_is_named(tmp_path, name, page, words):
    folder = write_folder(tmp_path / "v", stack())
    tifffile.imwrite(folder / name, page, photometric="rgb" if page.ndim == 3 else "minisblack")
    for limit in (None, 500):  # at once, and in parts
        refused(VolumeError, words, read_volume, folder, voxel_um=1, memory_bytes=limit)


def test_a_slice_that_is_damaged_or_has_several_pages_is_named(tmp_path):
    folder = write_folder(tmp_path / "v", stack())
    tifffile.imwrite(folder / "s5.tif", stack(), photometric="minisblack")
    refused(
        FileError, r"^s5\.tif is not one picture but 12 x 7 x 9", read_volume, folder, voxel_um=1
    )
    folder = write_folder(tmp_path / "w", stack(), ".png")
    (folder / "s7.png").write_bytes((folder / "s7.png").read_bytes()[:-20])
    refused(
        FileError, r"^s7\.png cannot be decoded .* It is damaged", read_volume, folder, voxel_um=1
    )


def test_colour_slices_become_luminance_or_the_channel_chosen(tmp_path):
    values = stack(shape=(4, 7, 9, 3))
    folder = write_folder(tmp_path / "v", values, ".png")
    grey = np.rint(values @ np.array([0.2126, 0.7152, 0.0722])).astype(np.uint8)
    for limit in (None, 500):  # at once, and in parts
        volume = read_volume(folder, voxel_um=1, memory_bytes=limit)
        np.testing.assert_array_equal(volume.isel(z=slice(1, 3)).values, grey[1:3])
        assert "no channel was chosen" in volume.attrs["colour"]
        green = read_volume(folder, voxel_um=1, channel="green", memory_bytes=limit)
        np.testing.assert_array_equal(green.values, values[..., 1])
        assert green.attrs["channel"] == "green"
    refused(
        InputError,
        r"'cyan' is no channel.*volume_channel=",
        read_volume,
        folder,
        voxel_um=1,
        channel="cyan",
    )
    with pytest.raises(InputError, match=r"is grey, so it has no red"):
        read_volume(write_folder(tmp_path / "g", stack()), voxel_um=1, channel="red")
    Image.fromarray(values[0, ..., 0]).save(folder / "s2.png")
    refused(VolumeError, r"^s2\.png is grey", read_volume, folder, voxel_um=1)


@pytest.mark.parametrize(
    ("names", "error", "words"),
    [
        ([], FileError, "holds no slices"),
        (["a1.tif"], VolumeError, "holds one slice only, a1.tif"),
        (["a1b3.tif", "a2b2.tif"], VolumeError, "2 numbers change .* ask for different orders"),
        (["i1j1.tif", "i1j2.tif", "i2j1.tif", "i2j2.tif"], VolumeError, "none counts the slices"),
        (["0901_1.tif", "0902_2.tif", "0908_4.tif"], VolumeError, "none counts .* without a gap"),
        (["a.tif", "b.tif"], VolumeError, "named otherwise"),
    ],
)
def test_names_that_are_no_series_are_refused(tmp_path, names, error, words):
    for name in names:
        Image.new("L", (9, 7)).save(tmp_path / name)
    refused(error, words, slice_names.list_slices, tmp_path)


@pytest.mark.parametrize(
    ("name", "place"),
    [
        (lambda i: f"img_20240301_{120000 + i}_{i:03d}", "number 3"),
        (lambda i: f"2024-03-01T{11 + i // 5}-{7 * i % 35:02d}_{i}", "number 6"),
        (lambda i: f"slice_{i}_at_{30 * i:04d}um", "number 1"),
        (lambda i: f"z{0.75 * i:.2f}", "The decimal number in their names"),
    ],
)
def test_of_several_numbers_the_one_that_counts_is_said(tmp_path, name, place):
    folder = tmp_path / "v"
    folder.mkdir()
    for i in random.Random(2).sample(range(12), 12):
        tifffile.imwrite(folder / f"{name(i)}.tif", stack()[i], photometric="minisblack")
    np.testing.assert_array_equal(read_volume(folder, voxel_um=1).values, stack())
    told = describe(folder, voxel_um=1)
    assert any(f"{place} counts the slices" in n for n in told["warnings"] + told.get("notes", []))


def test_small_and_capital_letters_are_the_same_in_names(tmp_path):
    names = ["s0.tif", "S1.TIF", "s2.tif"]
    for name in names:
        (tmp_path / name).touch()
    assert [p.name for p in slice_names.list_slices(tmp_path).files] == names


def test_a_sign_is_read_where_not_all_names_have_it(tmp_path):
    names = ["z-010", "z-005", "z+000", "z+005"]
    for name in names:
        (tmp_path / f"{name}.tif").touch()
    assert [p.stem for p in slice_names.list_slices(tmp_path).files] == names


IMAGEJ = "ImageJ=1.53t\nimages=12\nslices=12\nunit=um\nspacing=3.0\nloop=false\n"


@pytest.mark.parametrize("compression", [None, "deflate"])
def test_slices_that_describe_the_stack_they_were_cut_out_of_are_read(tmp_path, compression):
    tags = {"resolution": (0.5, 0.5), "photometric": "minisblack", "compression": compression}
    for i, page in enumerate(stack()):
        path = tmp_path / f"{i}.tif"
        tifffile.imwrite(path, page, description=IMAGEJ, metadata=None, **tags)
    volume = read_volume(tmp_path)
    np.testing.assert_array_equal(volume.values, stack())
    assert volume.attrs["voxel_um"] == [3, 2, 2]
    told = describe(tmp_path)
    note = "0.tif describes the stack that it was cut out of; it holds one image."
    assert note in told["warnings"] + told.get("notes", [])


def notes_on(path):
    told = describe(path, voxel_um=1, override_size=True)
    return [*told["warnings"], *told.get("notes", [])]


def test_all_pages_are_read_where_imagej_describes_fewer_images(tmp_path):
    values = stack(shape=(20, 7, 9))
    with tifffile.TiffWriter(tmp_path / "v.tif") as file:
        for k, page in enumerate(values):
            description = IMAGEJ if k == 0 else None
            file.write(page, description=description, metadata=None, photometric="minisblack")
    volume = read_volume(tmp_path / "v.tif", voxel_um=1, override_size=True)
    np.testing.assert_array_equal(volume.values, values)
    assert "v.tif describes 12 images; its 20 pages are read." in notes_on(tmp_path / "v.tif")


def test_all_pages_are_read_where_ome_describes_fewer_planes(tmp_path):
    tifffile.imwrite(tmp_path / "few.ome.tif", stack(), metadata={"axes": "ZYX"})
    with tifffile.TiffFile(tmp_path / "few.ome.tif") as tif:
        ome = (tif.ome_metadata or "").encode()
    values = stack(shape=(20, 7, 9))
    path = tmp_path / "v.ome.tif"
    tifffile.imwrite(path, values, description=ome, metadata=None, photometric="minisblack")
    np.testing.assert_array_equal(read_volume(path, voxel_um=1).values, values)
    assert "v.ome.tif describes 12 images; its 20 pages are read." in notes_on(path)


@pytest.mark.parametrize("compression", [None, "deflate"])
def test_axes_of_length_one_are_left_out(tmp_path, compression):
    tifffile.imwrite(tmp_path / "v.tif", stack()[None, :, None], compression=compression)
    np.testing.assert_array_equal(read_volume(tmp_path / "v.tif", voxel_um=1).values, stack())


def test_the_colours_in_which_imagej_shows_greys_are_no_values(tmp_path):
    ramp = np.arange(256)
    colours = np.stack([ramp, np.clip(3 * ramp - 255, 0, 255), 255 - ramp]).astype("u2") * 257
    shown = {"photometric": "palette", "colormap": colours, "metadata": None}
    (tmp_path / "v").mkdir()
    for i, page in enumerate(stack()):
        tifffile.imwrite(tmp_path / "v" / f"{i}.tif", page, description="ImageJ=1.53t\n", **shown)
    tifffile.imwrite(tmp_path / "v.tif", stack(), description=IMAGEJ, **shown)
    for path in (tmp_path / "v", tmp_path / "v.tif"):
        volume = read_volume(path, voxel_um=1, override_size=True)
        np.testing.assert_array_equal(volume.values, stack())
        assert any("in false colours" in note for note in notes_on(path))


def test_white_as_zero_is_turned_and_said(tmp_path):
    (tmp_path / "v").mkdir()
    for i, page in enumerate(stack()):
        tifffile.imwrite(tmp_path / "v" / f"{i}.tif", page, photometric="miniswhite")
    tifffile.imwrite(tmp_path / "v.tif", stack(), photometric="miniswhite")
    for path in (tmp_path / "v", tmp_path / "v.tif"):
        np.testing.assert_array_equal(read_volume(path, voxel_um=1).values, 255 - stack())
        assert any("stores white as 0" in note for note in notes_on(path))


def test_a_stack_without_chained_pages_that_was_cut_off_is_no_slice(tmp_path):
    path = tmp_path / "v.tif"
    big = np.zeros((12, 100, 100), np.uint8)  # as ImageJ writes stacks above 4 GB: one page alone
    tifffile.imwrite(path, big[0], description=IMAGEJ, metadata=None)
    with path.open("ab") as file:
        file.write(big[1:].tobytes())
    assert read_volume(path, voxel_um=3, override_size=True).shape == (12, 100, 100)
    path.write_bytes(path.read_bytes()[:-100_000])
    refused(FileError, "12 images are declared, the file has 1 pages", read_volume, path)


def test_slices_of_a_set_that_describe_all_of_it_in_ome_are_read(tmp_path):
    tifffile.imwrite(
        tmp_path / "all.ome.tif",
        stack(),
        metadata={"axes": "ZYX"} | {f"PhysicalSize{a}": 2.5 for a in "XYZ"},
    )
    with tifffile.TiffFile(tmp_path / "all.ome.tif") as tif:
        ome = (tif.ome_metadata or "").encode()
    (tmp_path / "all.ome.tif").unlink()
    for i, page in enumerate(stack()):
        path = tmp_path / f"{i}.ome.tif"
        tifffile.imwrite(path, page, description=ome, metadata=None, photometric="minisblack")
    volume = read_volume(tmp_path)
    np.testing.assert_array_equal(volume.values, stack())
    assert volume.attrs["voxel_um"] == [2.5] * 3


def test_sizes_of_slices_are_read_and_must_agree(tmp_path):
    tags = {"resolutionunit": "CENTIMETER", "photometric": "minisblack"}
    for i, page in enumerate(stack()):
        tifffile.imwrite(tmp_path / f"{i}.tif", page, resolution=(5000, 5000), **tags)
    refused(
        SizeError,
        r"no voxel size along z: the TIFF resolution states y 2, x 2 um only",
        read_volume,
        tmp_path,
    )
    assert read_volume(tmp_path, voxel_um=(3, 2, 2)).attrs["voxel_um"] == [3, 2, 2]
    tifffile.imwrite(tmp_path / "5.tif", stack()[5], resolution=(2500, 2500), **tags)
    with pytest.raises(SizeError, match=r"^5\.tif states a pixel size of 4 um, 0\.tif one of 2 um"):
        read_volume(tmp_path, voxel_um=(3, 2, 2))


def test_of_uncompressed_slices_only_the_rows_asked_for_are_read(tmp_path):
    folder = tmp_path / "v"
    folder.mkdir()
    values = np.random.default_rng(0).integers(0, 60000, (4, 500, 40)).astype(np.uint16)
    for i, page in enumerate(values):
        tifffile.imwrite(folder / f"{i}.tif", page, byteorder=">", rowsperstrip=64)
    volume = read_volume(folder, voxel_um=1, memory_bytes=100_000)
    tracemalloc.start()
    try:
        part = volume.isel(y=slice(100, 110)).values
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    np.testing.assert_array_equal(part, values[:, 100:110])
    print(f"peak {peak} bytes for {part.nbytes} of {values.nbytes}")
    assert peak < 20_000 < values[0].nbytes


@pytest.mark.parametrize("layout", [{"rowsperstrip": 64}, {"tile": (64, 64)}])
@pytest.mark.parametrize("dtype", ["uint16", "float16"])
def test_of_compressed_slices_only_the_strips_asked_for_are_decoded(tmp_path, layout, dtype):
    folder = tmp_path / "v"
    folder.mkdir()
    values = np.random.default_rng(0).integers(0, 2000, (4, 2000, 300)).astype(dtype)
    for i, page in enumerate(values):
        other_rows = {"rowsperstrip": 100} if i == 2 and "rowsperstrip" in layout else layout
        path = folder / f"{i}.tif"
        tifffile.imwrite(path, page, byteorder=">", compression="deflate", **other_rows)
    volume = read_volume(folder, voxel_um=1, memory_bytes=2_600_000)
    assert not volume.encoding["whole_slices"]  # so that it is mapped in less memory than it has
    tracemalloc.start()
    try:
        part = volume.isel(y=slice(100, 110)).values
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    np.testing.assert_array_equal(part, values[:, 100:110])
    print(f"peak {peak} bytes, {values.nbytes} in all")
    # Of 2000 rows, those of a strip of 100 that is filled from two of 64; float16 becomes float32.
    assert peak < 0.3 * values.nbytes * (2 if dtype == "float16" else 1)
    np.testing.assert_array_equal(volume.values, values)
    volume = read_volume(folder, voxel_um=1, memory_bytes=2_600_000)
    tifffile.imwrite(folder / "3.tif", values[3, :, :200], byteorder=">", compression="deflate")
    with pytest.raises(VolumeError, match=r"^3\.tif is 2000 x 200 pixels, 2000 x 300 when"):
        _ = volume.isel(z=3, y=slice(400, 410)).values


def test_a_slice_that_changes_after_it_was_checked_is_noticed(tmp_path):
    folder = write_folder(tmp_path / "v", stack(), ".png")
    volume = read_volume(folder, voxel_um=1, memory_bytes=500)
    Image.fromarray(stack()[3][:, :5]).save(folder / "s3.png")
    with pytest.raises(VolumeError, match=r"^s3\.png is 7 x 5 pixels, 7 x 9 when"):
        _ = volume.isel(z=3).values
    (folder / "s3.png").write_bytes(b"")
    with pytest.raises(FileError, match=r"^s3\.png is empty"):
        _ = volume.isel(z=3).values


def test_a_folder_is_in_memory_once(tmp_path):
    folder = tmp_path / "v"
    folder.mkdir()
    page = np.zeros((512, 512), np.uint16)
    for i in range(24):
        (folder / f"{i}.png").write_bytes(imagecodecs.png_encode(page))
    tracemalloc.start()
    try:
        volume = read_volume(folder, voxel_um=1)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    print(f"peak {peak / volume.nbytes:.3f} times the volume")
    assert peak < 1.25 * volume.nbytes  # the volume, two slices of 24, and their files
