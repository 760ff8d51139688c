"""What ``planish info`` tells, and the fingerprint."""

import hashlib
import json

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image

from folders import refused, write_volume
from formats_written import CUBE, VALUES, write_nrrd
from planish.core.errors import FileError
from planish.io import as_text, best_section, describe, fingerprint, middle_sections, write_picture


def ramp(shape, dtype="uint16"):
    return (np.arange(np.prod(shape)) % 200).reshape(shape).astype(dtype)


def noise(shape, dtype="uint16"):
    return np.random.default_rng(2).integers(0, 250, shape).astype(dtype)


def with_part(values, part, grey):
    values[part] = grey
    return values


def test_a_volume_is_described(tmp_path):
    path = write_volume(tmp_path / "v.tif", ramp((5, 20, 30)), 3.0, 2.0)
    told = describe(path)
    assert told == told | {
        "kind": "volume",
        "shape": [5, 20, 30],
        "dims": ["z", "y", "x"],
        "dtype": "uint16",
        "size_um": [3, 2, 2],
        "size_source": "ImageJ metadata",
        "extent_um": [15, 40, 60],
        "min": 0,
        "max": 199,
        "nan_share": 0,
        "saturated_share": 0,
        "bytes": path.stat().st_size,
        "warnings": [],
    }
    assert told["percentiles"]["50"] == np.percentile(ramp((5, 20, 30)), 50)
    assert describe(write_volume(tmp_path / "w.tif", noise((9, 40, 50))))["warnings"] == []


SHAPE = (10, 40, 50)
ODD = [
    (np.full(SHAPE, 7, np.uint8), {}, "All values are 7"),
    (np.full(SHAPE, np.nan, np.float32), {}, "all values are missing"),
    (ramp(SHAPE, "uint8") % 3, {}, "3 grey levels only"),
    (
        with_part(noise(SHAPE, "float32"), np.s_[:, :4], np.nan),
        {},
        "10 % of the values are missing",
    ),
    (with_part(noise(SHAPE, "uint8"), np.s_[:, :, :5], 255), {}, "10 % of the values are at 255"),
    (with_part(noise(SHAPE), 3, 0), {}, "1 slices have one grey value only (black or empty), z 3:"),
    (
        with_part(noise(SHAPE), 8, noise(SHAPE)[1]),
        {},
        "1 slices hold the same values as a slice before them, z 8:",
    ),
    (noise(SHAPE), {"voxel_um": 0.1}, "unusual for paper"),
    (noise(SHAPE), {"voxel_um": 40.0, "across_um": 4.0}, "differ by a factor of 10"),
]


@pytest.mark.parametrize(("values", "size", "words"), ODD, ids=[words for _, _, words in ODD])
def test_what_looks_wrong_is_said(tmp_path, values, size, words):
    told = describe(write_volume(tmp_path / "v.tif", values, **size))
    assert any(words in w for w in told["warnings"])
    json.dumps(told, allow_nan=False)


def test_an_image_is_described(tmp_path):
    exif = Image.Exif()
    exif[274] = 3
    Image.fromarray(ramp((20, 30), "uint8")).save(tmp_path / "i.jpg", exif=exif, dpi=(2540, 2540))
    told = describe(tmp_path / "i.jpg")
    assert told == told | {
        "kind": "image",
        "shape": [20, 30],
        "colour": "grey",
        "size_um": pytest.approx([10, 10]),
    }
    assert any("JPEG loses detail" in w for w in told["warnings"])
    assert any("orientation tag 3" in w for w in told["warnings"])


def test_missing_sizes_are_reported_and_not_raised(tmp_path):
    tifffile.imwrite(tmp_path / "v.tif", ramp((5, 20, 30)), photometric="minisblack")
    told = describe(tmp_path / "v.tif")
    assert told["size_um"] is None
    assert told["size_problem"].startswith("v.tif states no voxel size")
    assert told["size_problem"] in told["warnings"]
    assert describe(tmp_path / "v.tif", voxel_um=2)["extent_um"] == [10, 40, 60]
    tifffile.imwrite(
        tmp_path / "v.tif", noise((9, 40, 50)), resolution=(5000, 5000), resolutionunit="CENTIMETER"
    )
    assert "no voxel size along z" in describe(tmp_path / "v.tif")["size_problem"]


def test_slices_in_steps_are_mentioned(tmp_path):
    for i in range(3):
        tifffile.imwrite(tmp_path / f"{i * 5}.tif", ramp((20, 30)))
    assert any("steps of 5" in w for w in describe(tmp_path, voxel_um=1)["warnings"])


def test_broken_data_are_an_error(tmp_path):
    path = tmp_path / "v.tif"
    tifffile.imwrite(
        path, ramp((5, 20, 30)), photometric="minisblack", compression="zlib", metadata=None
    )
    with tifffile.TiffFile(path) as tif:
        at = tif.pages[3].dataoffsets[0]
    data = bytearray(path.read_bytes())
    data[at + 4 : at + 30] = bytes(26)
    path.write_bytes(data)
    refused(FileError, r"v\.tif cannot be decoded", describe, path)


def test_the_fingerprint_is_the_sha256_of_a_file_or_of_the_slices_of_a_folder(tmp_path):
    (tmp_path / "a").write_bytes(b"paper" * 100_000)
    assert fingerprint(tmp_path / "a") == hashlib.sha256(b"paper" * 100_000).hexdigest()
    refused(FileError, "does not exist", fingerprint, tmp_path / "b")
    folder = tmp_path / "v"
    folder.mkdir()
    for i in range(3):
        tifffile.imwrite(folder / f"{i}.tif", ramp((20, 30)) + np.uint16(i))
    first = fingerprint(folder)
    (folder / "notes.txt").write_text("other files do not count")
    folder = folder.rename(tmp_path / "moved")
    assert fingerprint(folder) == first
    (folder / "0.tif").rename(folder / "3.tif")
    assert fingerprint(folder) != first
    (folder / "3.tif").rename(folder / "0.tif")
    tifffile.imwrite(folder / "1.tif", ramp((20, 30)))
    assert fingerprint(folder) != first


def test_a_folder_of_sections(tmp_path):
    """Gaps of the numbering are none; the counter says where each section lies."""
    rng = np.random.default_rng(0)
    lines = ["file,position_um"]
    for k in (0, 1, 2, 5, 6):
        tifffile.imwrite(tmp_path / f"s{k}.tif", rng.integers(0, 255, (20, 30), dtype=np.uint8))
        lines.append(f"s{k}.tif,{3 * k}")
    (tmp_path / "sections.csv").write_text("\n".join(lines))
    told = describe(tmp_path, voxel_um=2.0)
    assert (told["kind"], told["shape"], told["size_um"]) == (
        "sections",
        [5, 20, 30],
        [3.0, 2.0, 2.0],
    )
    assert told["extent_um"] == [21.0, 40.0, 60.0]
    assert "2 sections are missing" in told["warnings"][0]
    unsized = describe(tmp_path)
    assert unsized["size_um"] is None
    assert "`voxel_um=3,Y,X`" in unsized["size_problem"]


def test_of_a_large_volume_some_slices_are_seen_and_that_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr("planish.io.inspection.EAGER_BYTES", 100_000)
    monkeypatch.setattr("planish.io.inspection.SAMPLE_BYTES", 20_000)
    told = describe(write_volume(tmp_path / "v.tif", noise((200, 40, 50))))
    assert (told["sampled"], told["min"], told["max"]) == ("8 of 200 slices", 0, 249)
    assert told["stored"] == "mapped from its file"


def test_what_a_run_needs_grows_with_the_columns(tmp_path):
    small = describe(write_volume(tmp_path / "v.tif", noise((9, 40, 50))))
    large = describe(write_volume(tmp_path / "w.tif", noise((9, 80, 100))))
    # 20e-6 were measured, and 1.3 times as much is said.
    assert large["run_seconds"] - small["run_seconds"] == pytest.approx(28.1e-6 * 6000, rel=0.05)
    assert large["run_bytes"] > small["run_bytes"] > 1e8


def test_every_byte_is_read_once_for_its_hash(tmp_path, monkeypatch):
    for k in range(3):
        (tmp_path / f"s{k}.tif").write_bytes(b"x" * (1000 + k))
    digest, read = hashlib.file_digest, list[int]()

    def counted(file, name):
        found = digest(file, name)
        read.append(file.tell())
        return found

    monkeypatch.setattr(hashlib, "file_digest", counted)
    first = fingerprint(tmp_path)
    assert fingerprint(str(tmp_path)) == first
    fingerprint(tmp_path / "s0.tif")
    assert sum(read) == 1000 + 1001 + 1002
    (tmp_path / "s0.tif").write_bytes(b"y" * 1000)  # another time of change
    assert fingerprint(tmp_path) != first
    assert sum(read) == 1000 + 1001 + 1002 + 1000


def test_what_can_only_be_decoded_whole_and_is_large_is_described_by_its_header(
    tmp_path, monkeypatch
):
    Image.fromarray(ramp((20, 30), "uint8")).save(tmp_path / "i.png")
    tifffile.imwrite(tmp_path / "i.tif", ramp((20, 30)), compression="zlib")
    volume = write_nrrd(tmp_path, VALUES, CUBE, ".nrrd", "gzip")
    cases = ((volume, [12, 17, 19]), (tmp_path / "i.png", [20, 30]), (tmp_path / "i.tif", [20, 30]))
    assert [describe(path)["min"] for path, _ in cases] == [VALUES.min(), 0, 0]
    monkeypatch.setattr("planish.io.info.LOOK_BYTES", 500)
    for path, shape in cases:
        told = describe(path)
        assert (told["shape"], told["min"]) == (shape, None)
        assert any(
            "can only be decoded whole, so no grey was looked at" in w for w in told["warnings"]
        )


def test_the_middle_of_a_volume_is_drawn(tmp_path):
    values = np.full((40, 60, 300), 20, np.uint8)
    values[18:22] = 200  # a sheet across z
    values[:, 30, 150] = 255
    found = middle_sections(values)
    assert [(s.down, s.across, s.grey.shape) for s in found] == [
        ("z", "x", (40, 300)),
        ("z", "y", (40, 60)),
        ("y", "x", (60, 300)),
    ]
    assert found[0].grey[20].min() > 200 > found[0].grey[10, 0]
    assert best_section(found, "z") is found[0]
    assert best_section(found, "x") is found[0]
    assert best_section(found, "y") is found[2]
    lines = as_text(found[0])
    assert max(map(len, lines[:-1])) <= 72
    assert lines[-1] == "middle of the volume: z down, x across"
    dark = [set(line) <= {" ", "█"} and line.count(" ") > 60 for line in lines[:-1]]
    assert dark[0]
    assert not all(dark)
    write_picture(found, tmp_path / "look.png")
    drawn = imagecodecs.imread(tmp_path / "look.png")
    assert drawn.shape == (96, 480 + 8 + 96 + 8 + 480)
    # Of a file, not more than 96 slices are read.
    read = []

    class Slices:
        shape = (1000, 8, 9)

        def __getitem__(self, k):
            read.append(k)
            return np.full((8, 9), k, np.float32)

    tall = middle_sections(Slices())
    assert len(read) <= 97
    assert tall[0].step[0] * tall[0].grey.shape[0] >= 1000
