"""Broken files: one sentence each, at once, without memory; never a short or filled-up volume."""

import contextlib
import json
import struct
import subprocess
import sys
import time
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from folders import refused
from planish.core.errors import FileError, InputError, ResourceError
from planish.io import describe, read_image, read_volume

VALUES = np.random.default_rng(0).integers(0, 255, (6, 18, 20)).astype(np.uint16)

GOOD: dict[str, dict[str, Any]] = {
    "plain": {"metadata": None},
    "BigTIFF": {"bigtiff": True, "metadata": None},
    "ImageJ in one piece": {"imagej": True, "metadata": {"axes": "ZYX"}},
    "ImageJ deflate": {"imagej": True, "metadata": {"axes": "ZYX"}, "compression": "zlib"},
    "OME": {"ome": True, "metadata": {"axes": "ZYX"}},
    "OME LZW": {"ome": True, "metadata": {"axes": "ZYX"}, "compression": "lzw"},
    "deflate": {"compression": "zlib", "metadata": None},
    "LZW strips": {"compression": "lzw", "rowsperstrip": 5},
    "packbits": {"compression": "packbits"},
    "tiles": {"tile": (16, 16)},
    "zstd tiles": {"tile": (16, 16), "compression": "zstd"},
    "big-endian": {"byteorder": ">"},
    "one page table": {"metadata": {"truncated": True}},
}
BY_PAGE: dict[str, dict[str, Any]] = {
    "pages": {},
    "pages of tiles": {"tile": (16, 16)},
    "LZW pages": {"compression": "lzw", "rowsperstrip": 5},
}


@pytest.mark.ci
@pytest.mark.parametrize("kind", [*GOOD, *BY_PAGE])
def test_a_file_cut_anywhere_is_an_error_not_a_shorter_volume(tmp_path, kind):
    good, cut = tmp_path / "good.tif", tmp_path / "cut.tif"
    if kind in BY_PAGE:
        with tifffile.TiffWriter(good, bigtiff=kind == "LZW pages") as tif:
            for page in VALUES:
                tif.write(page, contiguous=False, metadata=None, **BY_PAGE[kind])
    else:
        good.write_bytes(tiff_bytes(**GOOD[kind]))
    data = good.read_bytes()
    np.testing.assert_array_equal(read_volume(good, voxel_um=1).values, VALUES)
    for length in {*range(0, len(data), 97), *(len(data) - back for back in range(1, 30))}:
        cut.write_bytes(data[:length])
        try:
            volume = read_volume(cut, voxel_um=1)
        except FileError:
            continue
        np.testing.assert_array_equal(volume.values, VALUES)
        assert len(data) - length < 32  # only padding after the last value was cut


@pytest.mark.parametrize("name", ["i.png", "i.jpg", "i.bmp", "deep.png"])
def test_a_cut_picture_is_an_error(tmp_path, name):
    page = (VALUES[0] % 250).astype(np.uint8)
    if name == "deep.png":
        (tmp_path / name).write_bytes(imagecodecs.png_encode(np.dstack([VALUES[0]] * 3)))
    else:
        Image.fromarray(page).save(tmp_path / name)
    data = (tmp_path / name).read_bytes()
    for length in range(0, len(data) - 3, 7):
        (tmp_path / name).write_bytes(data[:length])
        with pytest.raises(FileError):
            read_image(tmp_path / name, pixel_um=1)


def sources():
    page = (VALUES[0] % 250).astype(np.uint8)
    return {
        "deflate.tif": tiff_bytes(compression="zlib", metadata=None),
        "imagej.tif": tiff_bytes(
            imagej=True, metadata={"axes": "ZYX", "unit": "um", "spacing": 2.0}
        ),
        "ome.tif": tiff_bytes(ome=True, metadata={"axes": "ZYX", "PhysicalSizeX": 1.0}),
        "tiles.tif": tiff_bytes(tile=(16, 16), compression="lzw"),
        "grey.png": imagecodecs.png_encode(page),
        "deep.png": imagecodecs.png_encode(np.dstack([VALUES[0]] * 3)),
        "grey.jpg": imagecodecs.jpeg_encode(page),
    }


def tiff_bytes(**options):
    buffer = BytesIO()
    tifffile.imwrite(buffer, VALUES, **({"photometric": "minisblack"} | options))
    return buffer.getvalue()


SOURCES = sources()


@pytest.mark.ci
@given(
    name=st.sampled_from(sorted(SOURCES)),
    flips=st.lists(
        st.tuples(st.floats(0, 1), st.booleans(), st.integers(0, 255)), min_size=1, max_size=6
    ),
)
def test_whatever_bytes_are_changed_nothing_but_our_errors_comes_out(tmp_path_factory, name, flips):
    data = bytearray(SOURCES[name])
    for place, near_head, value in flips:
        data[int(place * (min(400, len(data)) - 1 if near_head else len(data) - 1))] = value
    path = tmp_path_factory.mktemp("flipped") / name
    path.write_bytes(data)
    for read in (
        lambda: read_volume(path, voxel_um=1),
        lambda: read_image(path, pixel_um=1),
        lambda: describe(path),
    ):
        with contextlib.suppress(InputError, ResourceError):
            read()


def test_a_chain_of_pages_in_a_circle_is_found(tmp_path):
    path = tmp_path / "v.tif"
    tifffile.imwrite(path, VALUES, photometric="minisblack", metadata=None, compression="zlib")
    with tifffile.TiffFile(path) as tif:
        first, last = tif.pages[0].offset, tif.pages[-1]
        at = last.offset + 2 + 12 * len(last.tags)
    data = bytearray(path.read_bytes())
    assert data[at : at + 4] == bytes(4)
    data[at : at + 4] = first.to_bytes(4, "little")
    path.write_bytes(data)
    refused(
        FileError,
        "page 7 of its chain is one of the pages before it",
        read_volume,
        path,
        voxel_um=1,
    )


def patched(data, code, entry_offset, value_bytes):
    """A plain little-endian TIFF file with some bytes of one tag of its first page replaced."""
    first_page = int.from_bytes(data[4:8], "little")
    n_tags = int.from_bytes(data[first_page : first_page + 2], "little")
    entries = [first_page + 2 + 12 * k for k in range(n_tags)]
    entry = next(
        entry for entry in entries if data[entry : entry + 2] == code.to_bytes(2, "little")
    )
    at = entry + entry_offset
    return data[:at] + value_bytes + data[at + len(value_bytes) :]


@pytest.mark.parametrize(
    ("code", "entry_offset", "value_bytes", "words"),
    [
        (256, 2, b"\x02\x00", "cannot be decoded .* It is damaged or of a rare kind"),
        (256, 2, b"\xff\x00", "tag 256 of page 1 has no value"),
        (273, 8, b"\x00\x00\x00\x00", "page 1 has an empty strip or tile"),
        (273, 8, b"\xff\xff\xff\x7f", "the image ends at byte .*, the file has 928"),
        (279, 8, b"\x01\x00\x00\x00", "page 1 has 1 bytes of 720"),
    ],
)
def test_a_damaged_tag_is_named(tmp_path, code, entry_offset, value_bytes, words):
    path = tmp_path / "i.tif"
    tifffile.imwrite(path, VALUES[0], photometric="minisblack", metadata=None)
    path.write_bytes(patched(path.read_bytes(), code, entry_offset, value_bytes))
    refused(FileError, words, read_image, path, pixel_um=1)


def test_a_damaged_head_or_table_of_a_page_is_named(tmp_path):
    path, data = tmp_path / "v.tif", tiff_bytes(metadata=None)
    first_page = int.from_bytes(data[4:8], "little")
    for damaged, words in (
        (data[:6], "it ends within its header"),
        (data[:4] + bytes(4), "it holds no page"),
        (data[:first_page] + bytes(2) + data[first_page + 2 :], "page 1 claims 0 tags"),
        (data[: first_page + 20], "the file ends within the table of page 1"),
    ):
        path.write_bytes(damaged)
        refused(FileError, words, read_volume, path, voxel_um=1)


def test_a_bomb_is_refused_before_it_is_decoded(tmp_path):
    path = tmp_path / "v.tif"
    tifffile.imwrite(
        path,
        np.zeros((2, 16, 16), np.uint8),
        photometric="minisblack",
        compression="zlib",
        metadata=None,
    )
    data = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as tif:
        for page in tif.pages:
            for code in (256, 257, 278):
                tag = page.tags[code]  # type: ignore[union-attr]
                data[tag.valueoffset : tag.valueoffset + 2] = (60000).to_bytes(2, "little")
    path.write_bytes(data)
    started = time.perf_counter()
    with pytest.raises(
        FileError, match=r"claims 7200000000 bytes of image in .* stored bytes, more than 2000 to 1"
    ):
        read_volume(path, voxel_um=1)
    assert time.perf_counter() - started < 1
    data = bytearray(imagecodecs.png_encode(np.zeros((8, 8), np.uint8)))
    data[16:24] = struct.pack(">II", 100_000, 100_000)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    (tmp_path / "i.png").write_bytes(data)
    refused(
        FileError, "claims 10000000000 bytes of image", read_image, tmp_path / "i.png", pixel_um=1
    )


CORPUS = """
import contextlib, json, sys, time
from pathlib import Path
from planish.core.errors import InputError
from planish.io import describe, read_image, read_volume

def memory_kib(name):
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name))

# Forget the peak of the imports, and that of the parent process.
Path("/proc/self/clear_refs").write_text("5")
before = memory_kib("VmRSS:")
told = []
for path in sorted(Path(sys.argv[1]).iterdir()):
    started = time.perf_counter()
    try:
        read_volume(path, voxel_um=1)
    except InputError as error:
        told.append([path.name, str(error), time.perf_counter() - started])
    for read in (lambda: read_image(path, pixel_um=1), lambda: describe(path)):
        with contextlib.suppress(InputError):
            read()
print(json.dumps([told, (memory_kib("VmHWM:") - before) / 1024]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the peak memory is read from /proc")
def test_every_file_of_a_fuzzing_corpus_is_an_input_error_at_once_and_without_memory(shared_data):
    folder = shared_data("tiff_corpus/fuzz")
    done = subprocess.run(
        [sys.executable, "-c", CORPUS, folder], capture_output=True, text=True, check=True
    )
    told, peak_mib = json.loads(done.stdout)
    slowest = max(seconds for _, _, seconds in told)
    print(
        f"{len(told)} broken TIFF files, slowest {slowest * 1000:.1f} ms, {peak_mib:.1f} MiB over"
        " that before"
    )
    assert len(told) == len(list(folder.iterdir())) > 100
    assert all(message.startswith(name) for name, message, _ in told)
    assert slowest < 1
    assert peak_mib < 300
    assert done.stderr == ""


OME = (
    '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0"><Pixels'
    ' ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" SizeX="{}" SizeY="50" SizeC="{}" SizeZ="{}"'
    ' SizeT="1"><TiffData/></Pixels></Image></OME>'
)


DECLARED = [
    OME.format(50, 1, 2 * 10**9),
    OME.format(50, 2 * 10**9, 4),
    OME.format(2 * 10**9, 1, 4),
    "ImageJ=1.54f\nimages=2000000000\nslices=2000000000\nunit=um\nspacing=2\n",
    '{"shape": [2000000000, 50, 50]}',
]


@pytest.mark.ci
@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="the peak of the memory is not known"
)
def test_declared_sizes_are_compared_with_the_file_before_anything_is_made(tmp_path):
    """A list of 2e9 planes would fill the memory; another process shows that nothing of the kind is
    made."""
    data = np.zeros((4, 50, 50), np.uint8)
    for number, text in enumerate(DECLARED):
        path = tmp_path / f"{number}.tif"
        tifffile.imwrite(path, data, photometric="minisblack", description=text, metadata=None)
    code = (
        "import re, resource, sys; from planish.io import describe; from planish.core.errors import"
        " FileError\nresource.setrlimit(resource.RLIMIT_AS, (4 * 2**30,) * 2)\nfor k in range(5):\n"
        "    try: describe(f'{sys.argv[1]}/{k}.tif')\n    except FileError as error:"
        " print(error)\nprint(re.search(r'VmHWM:\\s*(\\d+)', open('/proc/self/status').read())[1])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False
    )
    *said, peak = done.stdout.splitlines()
    assert len(said) == len(DECLARED)
    assert all("is cut off or damaged" in line for line in said)
    assert int(peak) < 512 * 1024
