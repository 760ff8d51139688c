"""What ``planish info`` tells, and the fingerprint."""

import hashlib
import json
import math
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import h5py
import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image

from folders import refused
from planish.core.errors import FileError
from planish.io import as_text, best_section, describe, fingerprint, middle_sections, write_picture


def ramp(shape: tuple[int, ...], dtype: str = "uint16") -> np.ndarray:
    return (np.arange(np.prod(shape)) % 200).reshape(shape).astype(dtype)


def noise(shape: tuple[int, ...], dtype: str = "uint16") -> np.ndarray:
    return np.random.default_rng(2).integers(0, 250, shape).astype(dtype)


def with_part(values: np.ndarray, part: Any, grey: Any) -> np.ndarray:
    values[part] = grey
    return values


def write_sized(path: Path, values: np.ndarray, *, z: float = 2.0, yx: float = 2.0) -> Path:
    meta = {"axes": "ZYX", "unit": "um", "spacing": z}
    tifffile.imwrite(path, values, imagej=True, resolution=(1 / yx, 1 / yx), metadata=meta)
    return path


def test_a_volume_is_described(tmp_path: Path) -> None:
    path = write_sized(tmp_path / "v.tif", ramp((5, 20, 30)), z=3.0)
    told = describe(path)
    assert told == told | {
        "kind": "volume", "shape": [5, 20, 30], "dims": ["z", "y", "x"], "dtype": "uint16", "size_um": [3, 2, 2],
        "size_source": "ImageJ metadata", "extent_um": [15, 40, 60], "min": 0, "max": 199, "nan_share": 0,
        "saturated_share": 0, "bytes": path.stat().st_size, "warnings": [],
    }  # fmt: skip
    assert told["percentiles"]["50"] == np.percentile(ramp((5, 20, 30)), 50)
    assert describe(write_sized(tmp_path / "w.tif", noise((9, 40, 50))))["warnings"] == []


SHAPE = (10, 40, 50)
ODD = [
    (np.full(SHAPE, 7, np.uint8), {}, "All values are 7"),
    (np.full(SHAPE, np.nan, np.float32), {}, "all values are missing"),
    (ramp(SHAPE, "uint8") % 3, {}, "3 grey levels only"),
    (with_part(noise(SHAPE, "float32"), np.s_[:, :4], np.nan), {}, "10 % of the values are missing"),
    (with_part(noise(SHAPE, "uint8"), np.s_[:, :, :5], 255), {}, "10 % of the values are at 255"),
    (with_part(noise(SHAPE), 3, 0), {}, "1 slices have one grey value only (black or empty), z 3:"),
    (with_part(noise(SHAPE), 8, noise(SHAPE)[1]), {}, "1 slices hold the same values as a slice before them, z 8:"),
    (noise(SHAPE), {"z": 0.1, "yx": 0.1}, "unusual for paper"),
    (noise(SHAPE), {"z": 20.0}, "differ by a factor of 10"),
]


@pytest.mark.parametrize(("values", "size", "words"), ODD, ids=[words for _, _, words in ODD])
def test_what_looks_wrong_is_said(tmp_path: Path, values: np.ndarray, size: dict[str, float], words: str) -> None:
    told = describe(write_sized(tmp_path / "v.tif", values, **size))
    assert any(words in w for w in told["warnings"])
    json.dumps(told, allow_nan=False)


def test_an_image_is_described(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[274] = 3
    Image.fromarray(ramp((20, 30), "uint8")).save(tmp_path / "i.jpg", exif=exif, dpi=(2540, 2540))
    told = describe(tmp_path / "i.jpg")
    assert told == told | {"kind": "image", "shape": [20, 30], "colour": "grey", "size_um": pytest.approx([10, 10])}
    assert any("JPEG loses detail" in w for w in told["warnings"])
    assert any("orientation tag (3)" in w for w in told["warnings"])


def test_missing_sizes_are_reported_and_not_raised(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "v.tif", ramp((5, 20, 30)), photometric="minisblack")
    told = describe(tmp_path / "v.tif")
    assert told["size_um"] is None
    assert told["size_problem"].startswith("v.tif states no voxel size")
    assert told["size_problem"] in told["warnings"]
    assert describe(tmp_path / "v.tif", voxel_um=2)["extent_um"] == [10, 40, 60]
    tifffile.imwrite(tmp_path / "v.tif", noise((9, 40, 50)), resolution=(5000, 5000), resolutionunit="CENTIMETER")
    assert "no voxel size along z" in describe(tmp_path / "v.tif")["size_problem"]


def test_slices_in_steps_are_mentioned(tmp_path: Path) -> None:
    for i in range(3):
        tifffile.imwrite(tmp_path / f"{i * 5}.tif", ramp((20, 30)))
    assert any("steps of 5" in w for w in describe(tmp_path, voxel_um=1)["warnings"])


def test_broken_data_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "v.tif"
    tifffile.imwrite(path, ramp((5, 20, 30)), photometric="minisblack", compression="zlib", metadata=None)
    with tifffile.TiffFile(path) as tif:
        at = tif.pages[3].dataoffsets[0]
    data = bytearray(path.read_bytes())
    data[at + 4 : at + 30] = bytes(26)
    path.write_bytes(data)
    refused(FileError, r"v\.tif cannot be decoded", describe, path)


def test_the_fingerprint_is_the_sha256_of_a_file_or_of_the_slices_of_a_folder(tmp_path: Path) -> None:
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
    assert (told["kind"], told["shape"], told["size_um"]) == ("sections", [5, 20, 30], [3.0, 2.0, 2.0])
    assert told["extent_um"] == [21.0, 40.0, 60.0]
    assert "2 sections are missing" in told["warnings"][0]
    unsized = describe(tmp_path)
    assert unsized["size_um"] is None
    assert "--voxel-um" in unsized["size_problem"]


def test_of_a_large_volume_some_slices_are_seen_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("planish.io.inspection.EAGER_BYTES", 100_000)
    monkeypatch.setattr("planish.io.inspection.SAMPLE_BYTES", 20_000)
    told = describe(write_sized(tmp_path / "v.tif", noise((200, 40, 50))))
    assert (told["sampled"], told["min"], told["max"]) == ("8 of 200 slices", 0, 249)
    assert told["stored"] == "mapped from its file"


def test_what_a_run_needs_grows_with_the_columns(tmp_path: Path) -> None:
    small = describe(write_sized(tmp_path / "v.tif", noise((9, 40, 50))))
    large = describe(write_sized(tmp_path / "w.tif", noise((9, 80, 100))))
    assert large["run_seconds"] - small["run_seconds"] == pytest.approx(36.5e-6 * 6000, rel=0.05)  # as measured
    assert large["run_bytes"] > small["run_bytes"] > 1e8


def test_every_byte_is_read_once_for_its_hash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for k in range(3):
        (tmp_path / f"s{k}.tif").write_bytes(b"x" * (1000 + k))
    digest, read = hashlib.file_digest, list[int]()

    def counted(file: Any, name: str) -> Any:
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


@pytest.mark.nightly
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of the memory is not known")
def test_a_look_takes_little_memory_whatever_is_declared(tmp_path: Path) -> None:
    """What can only be decoded whole is described by its header; the rest is read in parts."""
    row = np.random.default_rng(0).integers(0, 255, 1000, dtype=np.uint8)
    raw = np.tile(row, (50, 1000, 1))
    header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 1000 1000 400\nencoding: gzip\n\n"
    packer = zlib.compressobj(1, wbits=31)
    parts = [packer.compress(raw.tobytes()) for _ in range(8)] + [packer.flush()]
    (tmp_path / "packed.nrrd").write_bytes(header.encode() + b"".join(parts))
    tifffile.imwrite(tmp_path / "plain.tif", np.concatenate([raw] * 8))
    Image.fromarray(np.zeros((20_000, 20_000), np.uint8)).save(tmp_path / "image.png")
    tifffile.imwrite(tmp_path / "image.tif", np.zeros((20_000, 20_000), np.uint8), compression="zlib")
    with h5py.File(tmp_path / "chunk.h5", "w") as file:
        packed = {"chunks": (400, 1000, 1000), "compression": "gzip", "compression_opts": 1}
        file.create_dataset("d", shape=(400, 1000, 1000), dtype="u1", **packed)[:50] = raw
    for path in sorted(tmp_path.iterdir()):
        code = (
            "import json, re, sys; from planish.io import describe; told = describe(sys.argv[1])\n"
            "peak = re.search(r'VmHWM:\\s*(\\d+)', open('/proc/self/status').read())[1]\n"
            "print(json.dumps([int(peak), told['shape'], told['min']]))"
        )
        done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
        peak, shape, low = json.loads(done.stdout)
        assert peak < 400 * 1024, path.name
        assert math.prod(shape) >= 4 * 10**8
        assert (low is None) == (path.name != "plain.tif")


def test_the_middle_of_a_volume_is_drawn(tmp_path):
    values = np.full((40, 60, 300), 20, np.uint8)
    values[18:22] = 200  # a sheet across z
    values[:, 30, 150] = 255
    found = middle_sections(values)
    assert [(s.down, s.across, s.grey.shape) for s in found] == [
        ("z", "x", (40, 300)), ("z", "y", (40, 60)), ("y", "x", (60, 300))
    ]  # fmt: skip
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
