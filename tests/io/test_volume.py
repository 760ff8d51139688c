"""Volumes: every kind of TIFF stack gives back what was stored, with its voxel size, and nothing
else passes."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from folders import refused
from planish.core.errors import FileError, SizeError, VolumeError
from planish.io import read_volume

KINDS: dict[str, dict[str, Any]] = {
    "plain": {"metadata": None},
    "tifffile": {},
    "BigTIFF": {"bigtiff": True, "metadata": None},
    "big-endian": {"byteorder": ">"},
    "deflate": {"compression": "zlib", "metadata": None},
    "LZW strips": {"compression": "lzw", "rowsperstrip": 3},
    "predictor": {"compression": "zlib", "predictor": True},
    "zstd": {"compression": "zstd"},
    "tiles": {"tile": (16, 16)},
    "deflate tiles": {"tile": (16, 16), "compression": "zlib"},
    "OME": {"ome": True, "metadata": {"axes": "ZYX"}},
    "OME deflate": {"ome": True, "metadata": {"axes": "ZYX"}, "compression": "zlib"},
}


def stack(dtype="uint16", shape=(5, 7, 9)):
    values = np.random.default_rng(3).integers(-120, 120, shape)
    return (values if np.dtype(dtype).kind != "u" else values + 120).astype(dtype)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float64"])
@pytest.mark.parametrize("kind", KINDS)
def test_values_type_and_order_survive(tmp_path, kind, dtype):
    path = tmp_path / "v.tif"
    values = stack(dtype)
    tifffile.imwrite(path, values, photometric="minisblack", **KINDS[kind])
    volume = read_volume(path, voxel_um=(3, 2, 1))
    assert (volume.dims, volume.dtype, volume.z.dtype) == (
        ("z", "y", "x"),
        np.dtype(dtype),
        np.float64,
    )
    np.testing.assert_array_equal(volume.values, values)
    for axis, step in (("z", 3.0), ("y", 2.0), ("x", 1.0)):
        np.testing.assert_array_equal(volume[axis], np.arange(volume.sizes[axis]) * step)
    assert volume.attrs == volume.attrs | {
        "voxel_um": [3, 2, 1],
        "voxel_um_source": "given",
        "units": "1",
        "long_name": "Grey value",
        "file_name": "v.tif",
        "file_bytes": path.stat().st_size,
    }


@settings(max_examples=40)
@given(
    values=hnp.arrays(
        dtype=st.sampled_from(["u1", "i1", "u2", "i2", "f4"]),
        shape=st.tuples(st.integers(2, 5), st.integers(2, 6), st.integers(5, 7)),
        elements={"allow_nan": True},
    ),
    compression=st.sampled_from([None, "zlib", "lzw", "packbits"]),
    big=st.booleans(),
    order=st.sampled_from("<>"),
)
def test_any_volume_survives(values, compression, big, order):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "v.tif"
        options: dict[str, Any] = {"compression": compression, "bigtiff": big, "byteorder": order}
        tifffile.imwrite(path, values, photometric="minisblack", **options)
        np.testing.assert_array_equal(np.array(read_volume(path, voxel_um=1).values), values)


@pytest.mark.parametrize("how", [{"metadata": None}, {}, {"compression": "zlib"}])
def test_pages_written_one_by_one_are_a_volume(tmp_path, how):
    values = stack()
    with tifffile.TiffWriter(tmp_path / "v.tif") as tif:
        for page in values:
            tif.write(page, contiguous=False, **how)
    for memory in (None, 600):
        volume = read_volume(tmp_path / "v.tif", voxel_um=1, memory_bytes=memory)
        np.testing.assert_array_equal(volume[3:].values, values[3:])
        np.testing.assert_array_equal(volume.values, values)


@pytest.mark.parametrize(("other", "page"), [({"compression": "zlib"}, 6), ({"datetime": True}, 0)])
def test_pages_of_two_layouts_are_no_volume(tmp_path, other, page):
    with tifffile.TiffWriter(tmp_path / "v.tif") as tif:
        for k, values in enumerate(stack()):
            tif.write(values, contiguous=False, **(other if k == 4 else {}))
    if page == 0:  # a tag that no voxel depends on
        np.testing.assert_array_equal(read_volume(tmp_path / "v.tif", voxel_um=1).values, stack())
        return
    refused(VolumeError, "different images", read_volume, tmp_path / "v.tif", voxel_um=1)


def test_float16_white_is_zero_and_singleton_axes_become_plain_volumes(tmp_path):
    tifffile.imwrite(tmp_path / "v.tif", stack("float16"), photometric="minisblack")
    volume = read_volume(tmp_path / "v.tif", voxel_um=1)
    assert volume.dtype == np.float32
    np.testing.assert_array_equal(volume.values, stack("float16"))
    tifffile.imwrite(tmp_path / "v.tif", stack("uint8"), photometric="miniswhite")
    np.testing.assert_array_equal(
        read_volume(tmp_path / "v.tif", voxel_um=1).values, 255 - stack("uint8")
    )
    tifffile.imwrite(
        tmp_path / "v.tif", stack()[None, :, None], imagej=True, metadata={"axes": "TZCYX"}
    )
    np.testing.assert_array_equal(read_volume(tmp_path / "v.tif", voxel_um=1).values, stack())


@pytest.mark.parametrize("kind", ["plain", "tifffile", "BigTIFF", "OME"])
def test_an_uncompressed_stack_is_mapped_or_read_in_parts_but_not_copied(tmp_path, kind):
    """What is mapped counts as memory that is used, so that only what may be held is mapped."""
    tifffile.imwrite(tmp_path / "v.tif", stack(), photometric="minisblack", **KINDS[kind])
    volume = read_volume(tmp_path / "v.tif", voxel_um=1, memory_bytes=stack().nbytes)
    assert isinstance(volume.data, np.memmap)
    small = read_volume(tmp_path / "v.tif", voxel_um=1, memory_bytes=stack().nbytes - 1)
    assert not small.variable._in_memory
    np.testing.assert_array_equal(small[1:3, ::2, 3:].values, stack()[1:3, ::2, 3:])


@pytest.mark.parametrize(
    "options", [{}, {"compression": "zlib"}, {"planarconfig": "separate"}, {"byteorder": ">"}]
)
def test_a_stack_in_colour_becomes_luminance_or_the_channel_chosen(tmp_path, options):
    values = stack("uint16", (5, 7, 9, 3))
    order = (0, 3, 1, 2) if "planarconfig" in options else (0, 1, 2, 3)
    tifffile.imwrite(tmp_path / "v.tif", values.transpose(order), photometric="rgb", **options)
    grey = np.rint(values @ np.array([0.2126, 0.7152, 0.0722])).astype(np.uint16)
    volume = read_volume(tmp_path / "v.tif", voxel_um=1)
    np.testing.assert_array_equal(volume.values, grey)
    assert volume.attrs["channel"] == "luminance"
    blue = read_volume(tmp_path / "v.tif", voxel_um=1, channel="Blue")
    np.testing.assert_array_equal(blue.values, values[..., 2])
    if options != {"planarconfig": "separate"}:
        lazy = read_volume(tmp_path / "v.tif", voxel_um=1, memory_bytes=500)
        np.testing.assert_array_equal(lazy.isel(y=slice(2, 4)).values, grey[:, 2:4])


@pytest.mark.parametrize(
    "options",
    [
        {"compression": "zlib", "rowsperstrip": 4},
        {"compression": "zlib", "tile": (16, 16)},
        {"compression": "lzw", "predictor": True},
        {"photometric": "miniswhite", "compression": "zlib"},
        {"photometric": "miniswhite"},
        {"byteorder": ">"},
        {"compression": "jpeg"},
    ],
)
def test_parts_of_a_stack_that_does_not_fit_are_read(tmp_path, options):
    values = stack("uint8", (6, 37, 41))
    tifffile.imwrite(tmp_path / "v.tif", values, **({"photometric": "minisblack"} | options))
    whole = read_volume(tmp_path / "v.tif", voxel_um=1).values
    part = read_volume(tmp_path / "v.tif", voxel_um=1, memory_bytes=2000)
    np.testing.assert_array_equal(
        part.isel(z=slice(1, 5, 2), y=slice(7, 31)).values, whole[1:5:2, 7:31]
    )
    np.testing.assert_array_equal(part.values, whole)


def write_imagej(path, across_um, **meta):
    resolution = (1 / across_um, 1 / across_um)
    tifffile.imwrite(
        path, stack(), imagej=True, resolution=resolution, metadata={"axes": "ZYX", **meta}
    )
    return path


@pytest.mark.parametrize(("unit", "um"), [("\\u00B5m", 1), ("nm", 1e-3), ("inch", 25400)])
def test_imagej_sizes_come_in_their_unit(tmp_path, unit, um):
    volume = read_volume(write_imagej(tmp_path / "v.tif", 2.0 / um, unit=unit, spacing=2.5 / um))
    # Resolutions are stored as fractions.
    assert volume.attrs["voxel_um"] == pytest.approx([2.5, 2.0, 2.0], rel=1e-5)


@pytest.mark.parametrize(("unit", "um"), [("mm", 1e3), (None, 1)])
def test_ome_sizes_come_in_their_unit(tmp_path, unit, um):
    meta: dict[str, Any] = {"axes": "ZYX"}
    for axis, size in zip("ZYX", (3.0, 2.0, 1.5), strict=True):
        meta[f"PhysicalSize{axis}"] = size / um
        if unit is not None:
            meta[f"PhysicalSize{axis}Unit"] = unit
    tifffile.imwrite(tmp_path / "v.ome.tif", stack(), ome=True, metadata=meta)
    assert read_volume(tmp_path / "v.ome.tif").attrs["voxel_um"] == pytest.approx([3.0, 2.0, 1.5])


def test_imagej_without_spacing_or_in_pixels_states_no_size(tmp_path):
    path = write_imagej(tmp_path / "v.tif", 2.0, unit="um")
    refused(
        SizeError,
        r"no voxel size along z: ImageJ metadata states y 2, x 2 um only .*exactly 1",
        read_volume,
        path,
    )
    assert read_volume(path, voxel_um=(1, 2, 2)).attrs["voxel_um"] == [1, 2, 2]
    write_imagej(path, 1.0, unit="pixel", spacing=1)
    refused(
        SizeError,
        r"states no voxel size \(ImageJ metadata: 'pixel' is no unit of length\)",
        read_volume,
        path,
    )


def test_ome_against_the_resolution_tags_is_an_error(tmp_path):
    meta = {"axes": "ZYX", "PhysicalSizeX": 2.0, "PhysicalSizeY": 2.0, "PhysicalSizeZ": 2.0}
    path = tmp_path / "v.ome.tif"
    tifffile.imwrite(
        path, stack(), ome=True, metadata=meta, resolution=(2500, 2500), resolutionunit="CENTIMETER"
    )
    words = r"contradicts itself: OME metadata .* x 2 um and the TIFF resolution .* x 4 um"
    refused(SizeError, words, read_volume, path)
    tifffile.imwrite(
        path, stack(), ome=True, metadata=meta, resolution=(5000, 5000), resolutionunit="CENTIMETER"
    )
    assert read_volume(path).attrs["voxel_um_source"] == "OME metadata and the TIFF resolution"


def test_resolution_tags_speak_about_x_and_y_only_and_not_at_all_by_default(tmp_path):
    path = tmp_path / "v.tif"
    tifffile.imwrite(
        path, stack(), photometric="minisblack", resolution=(2540, 1270), resolutionunit="INCH"
    )
    with pytest.raises(
        SizeError,
        match=r"no voxel size along z: the TIFF resolution states y 20, x 10 um only\. Give",
    ):
        read_volume(path)
    assert read_volume(path, voxel_um=(5, 20, 10)).attrs["voxel_um"] == [5, 20, 10]
    tifffile.imwrite(
        path, stack(), photometric="minisblack", resolution=(72, 72), resolutionunit="INCH"
    )
    refused(SizeError, "states no voxel size ", read_volume, path)


@pytest.mark.parametrize(
    ("values", "options", "words"),
    [
        (stack(shape=(7, 9)), {}, "has one page, not a stack: 7 x 9"),
        (
            stack(shape=(5, 2, 7, 9)),
            {"imagej": True, "metadata": {"axes": "ZCYX"}},
            "has 2 channels: 5 x 2 x 7 x 9",
        ),
        (
            stack(shape=(4, 5, 7, 9)),
            {"imagej": True, "metadata": {"axes": "TZYX"}},
            "has 4 time points: 4 x 5 x 7 x 9",
        ),
        (stack(), {"imagej": True, "metadata": {"axes": "CYX"}}, "has 5 channels.*If these are"),
        (
            stack("uint8", (5, 7, 9, 3)),
            {"photometric": "minisblack", "planarconfig": "contig"},
            "has 3 colour samples",
        ),
        (stack().astype("complex64"), {"photometric": "minisblack"}, "complex64 values"),
        (stack() > 5, {"photometric": "minisblack"}, "black and white only"),
    ],
)
def test_what_is_not_one_grey_volume_is_refused(tmp_path, values, options, words):
    tifffile.imwrite(tmp_path / "v.tif", values, **options)
    refused(VolumeError, rf"^v\.tif .*{words}", read_volume, tmp_path / "v.tif", voxel_um=1)


def test_pages_of_two_sizes_are_no_volume(tmp_path):
    with tifffile.TiffWriter(tmp_path / "v.tif") as tif:
        tif.write(stack(), photometric="minisblack")
        tif.write(stack(shape=(4, 6, 6)), photometric="minisblack")
    words = r"^v\.tif .*2 different images: 5 x 7 x 9 .* from page 1 on, 4 x 6 x 6 .* at"
    refused(VolumeError, words, read_volume, tmp_path / "v.tif", voxel_um=1)


def test_missing_empty_and_foreign_files_are_refused(tmp_path):
    path = tmp_path / "v.tif"
    refused(FileError, r"[/\\]v\.tif does not exist", read_volume, path, voxel_um=1)
    path.touch()
    refused(FileError, r"^v\.tif is empty", read_volume, path, voxel_um=1)
    path.write_text("version https://git-lfs.github.com/spec/v1")
    refused(FileError, r"^v\.tif is a Git LFS pointer", read_volume, path, voxel_um=1)
