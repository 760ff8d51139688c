"""Damaged inputs of every format: one of our errors or the right values, soon, and without memory.

The inputs are made here from good ones: cut at many lengths, with other bytes in their headers,
with other sizes, with files missing, or with something else in their place. They are read in
another process, whose memory is limited, so that a library that crashes or asks for too much is
found out.
"""

import json
import shutil
import struct
import subprocess
import sys

import h5py
import numpy as np
import pytest
import scipy.io

from formats_written import CASES, VALUES

LENGTHS = (0, 7, 60, 130, 0.3, 0.7, 0.95, -1)
FLIPS = 6
HEADER = 700

CHILD = """
import json, resource, sys, time
from pathlib import Path
import numpy as np
import planish.io.formats as formats
from planish.core.errors import PlanishError
from planish.io import describe, fingerprint, read_volume

for line in formats.FORMATS:
    formats.loader(line)
with formats.quiet:
    import SimpleITK
def memory_kib(name):
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name))

good = {name: np.load(path) for name, path in json.loads(sys.argv[2]).items()}
resource.setrlimit(resource.RLIMIT_AS, (memory_kib("VmSize:") * 1024 + 2**30,) * 2)
for line in Path(sys.argv[1]).read_text(encoding="utf-8").splitlines():
    item = json.loads(line)
    path, told = item["path"], {**item, "outcome": "", "seconds": 0.0}
    print(json.dumps({"begin": item["name"]}), flush=True)
    calls = [
        lambda: read_volume(path, voxel_um=2.0, override_size=True).values,
        lambda: read_volume(path, voxel_um=2.0, override_size=True, memory_bytes=2500).values,
        lambda: describe(path),
        lambda: fingerprint(path),
    ]
    for number, call in enumerate(calls):
        started = time.perf_counter()
        try:
            values = call()
            if number > 1:
                outcome = "read"
            else:
                expected = good[item["kind"]]
                same = values.shape == expected.shape and np.array_equal(values, expected)
                outcome = "right" if same else "OTHER VALUES"
        except PlanishError as error:
            outcome = type(error).__name__
            told.setdefault("message", str(error))
        except BaseException as error:
            outcome = f"TRACEBACK {type(error).__name__}: {error}"
        told["seconds"] = max(told["seconds"], time.perf_counter() - started)
        told["outcome"] = " ".join([told["outcome"], outcome]).strip()
    print(json.dumps(told), flush=True)
print(json.dumps({"peak_mib": memory_kib("VmHWM:") / 1024}), flush=True)
"""


def damaged(folder, kind, case, values):
    """Write damaged copies of one good input; give the name, the path, and whether other values are
    no wonder."""
    good = folder / "good"
    good.mkdir(parents=True)
    path = str(case.write(good, values, case.voxel))
    rng = np.random.default_rng(len(kind))
    main = header_of(good, case)
    data = case.data(good)

    def copy(name):
        other = folder / name
        shutil.copytree(good, other)
        return other, path.replace(str(good), str(other))

    for file in dict.fromkeys([data, main]):
        content = file.read_bytes()
        for length in LENGTHS if file == data else LENGTHS[2:8:2]:
            at = (
                int(length * len(content))
                if isinstance(length, float)
                else length % (len(content) + (length < 0))
            )
            other, given = copy(f"cut-{file.suffix}-{length}")
            (other / file.relative_to(good)).write_bytes(content[: min(at, len(content) - 1)])
            yield f"{kind}: {file.suffix} cut at {length}", given, ""
    content = main.read_bytes()
    for k in range(FLIPS):
        other, given = copy(f"flip-{k}")
        changed = bytearray(content)
        for place in rng.integers(0, min(HEADER, len(content)), 1 + k % 3):
            changed[place] ^= int(rng.integers(1, 256))
        (other / main.relative_to(good)).write_bytes(changed)
        yield f"{kind}: bytes flipped {k}", given, "values"
    for name, junk in (
        ("text", b"not an image\n" * 9),
        ("zeros", bytes(4000)),
        ("ones", b"\xff" * 4000),
    ):
        other, given = copy(f"junk-{name}")
        (other / main.relative_to(good)).write_bytes(junk)
        yield f"{kind}: {name} in its place", given, ""
    other, given = copy("missing")
    (other / data.relative_to(good)).unlink()
    yield f"{kind}: a file missing", given, "values" if "Zarr" in kind else ""
    if case.resize is not None:
        other, given = copy("resized")
        case.resize(other)
        yield f"{kind}: another size declared", given, ""


def header_of(folder, case):
    """File with the header: that of a store or beside the data, or the data itself."""
    for pattern in ("*.nhdr", "*.mhd", "*.toml", "*.log", "0/.zarray", "0/zarr.json"):
        found = sorted(folder.rglob(pattern))
        if found:
            return found[0]
    return case.data(folder)


def absurd(folder):
    """Inputs that declare far more than there is; those of TIFF stand in `test_damage`."""
    folder.mkdir()
    huge = (60000, 60000, 60000)

    for packed in (True, False):
        path = folder / f"huge{packed}.mha"
        head = (
            "NDims = 3\nDimSize = 60000 60000 60000\nElementType = MET_UCHAR\nCompressedData ="
            f" {packed}\n"
        )
        path.write_bytes(head.encode() + b"ElementDataFile = LOCAL\n" + b"x\x9c" + bytes(50))
        yield f"absurd: MetaImage packed {packed}", str(path), ""
    for packing in ("raw", "gzip", "bzip2"):
        path = folder / f"huge-{packing}.nrrd"
        head = (
            "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 60000 60000 60000\nencoding:"
            f" {packing}\n\n"
        )
        path.write_bytes(head.encode() + bytes(50))
        yield f"absurd: NRRD {packing}", str(path), ""
    for n in ("-3", "99999999999999999999999", "1e9", "0"):
        path = folder / f"sizes{n}.nrrd"
        path.write_bytes(
            f"NRRD0004\ntype: uint8\ndimension: 3\nsizes: {n} 4 4\nencoding: raw\n\n".encode()
            + bytes(16)
        )
        yield f"absurd: NRRD of {n}", str(path), ""
        path = folder / f"sizes{n}.mha"
        head = f"NDims = 3\nDimSize = {n} 4 4\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
        path.write_bytes(head.encode() + bytes(16))
        yield f"absurd: MetaImage of {n}", str(path), ""

    (folder / "huge.raw").write_bytes(bytes(100))
    (folder / "huge.raw.toml").write_text(f'shape = {list(huge)}\ndtype = "uint8"\n')
    yield "absurd: raw", str(folder / "huge.raw"), ""
    (folder / "deep.toml").write_text("shape = " + "[" * 5000 + "]" * 5000)
    yield "absurd: TOML of nested lists", str(folder / "deep.toml"), ""

    for chunks in (None, (1, 60000, 60000), (1, 8, 8)):
        path = folder / f"huge{chunks}.h5"
        with h5py.File(path, "w") as file:
            packed = {"chunks": chunks, "compression": "gzip" if chunks else None}
            data = file.create_dataset("v", shape=huge, dtype="u1", **packed)
            if chunks == (1, 8, 8):
                data[0, :8, :8] = 3
        yield f"absurd: HDF5 with chunks {chunks}", str(path), ""
    with h5py.File(folder / "many.h5", "w") as file:
        group = file
        for k in range(200):
            group = group.create_group(f"g{k}")
        group["v"] = np.ones((3, 3, 3))
        file["circle"] = file["g0"]
    yield "absurd: HDF5 of 200 nested groups", str(folder / "many.h5"), "values"

    for version, chunk in ((2, 60000), (3, 60000), (2, 1)):
        place = folder / f"huge{version}-{chunk}.zarr"
        place.mkdir()
        if version == 2:
            meta = {
                "zarr_format": 2,
                "shape": huge,
                "chunks": [chunk] * 3,
                "dtype": "|u1",
                "compressor": None,
                "fill_value": 0,
                "order": "C",
                "filters": None,
            }
            (place / ".zarray").write_text(json.dumps(meta))
            (place / "0.0.0").write_bytes(bytes(100))
        else:
            meta = {
                "zarr_format": 3,
                "node_type": "array",
                "shape": huge,
                "data_type": "uint8",
                "fill_value": 0,
                "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [chunk] * 3}},
                "chunk_key_encoding": {"name": "default"},
                "codecs": [{"name": "bytes"}],
                "attributes": {},
            }
            (place / "zarr.json").write_text(json.dumps(meta))
            (place / "c").mkdir()
            (place / "c" / "0").write_bytes(bytes(100))
        yield f"absurd: zarr {version} with chunks of {chunk}", str(place), ""

    path = folder / "huge.mat"
    scipy.io.savemat(path, {"V": VALUES})
    content = bytearray(path.read_bytes())
    at = content.index(struct.pack("<3i", *VALUES.shape))
    content[at : at + 12] = struct.pack("<3i", *huge)
    path.write_bytes(content)
    yield "absurd: MATLAB", str(path), ""


@pytest.mark.skipif(
    sys.platform != "linux", reason="the memory is limited and read as Linux does it"
)
@pytest.mark.parametrize(
    "every",
    [pytest.param(1, marks=pytest.mark.nightly), pytest.param(12, marks=pytest.mark.ci)],
    ids=["all", "sample"],
)
def test_no_damage_gives_a_traceback_wrong_values_or_a_long_wait(tmp_path, every):
    items: list[dict[str, str]] = []
    goods: dict[str, str] = {}
    for number, (kind, case) in enumerate(CASES.items()):
        values = (VALUES >> 8).astype(np.uint8) if case.dtype == "uint8" else VALUES
        goods[kind] = str(tmp_path / f"{number}.npy")
        np.save(goods[kind], values)
        for name, path, expected in damaged(tmp_path / str(number), kind, case, values):
            items.append({"name": name, "path": path, "expected": expected, "kind": kind})
    for name, path, expected in absurd(tmp_path / "absurd"):
        items.append({"name": name, "path": path, "expected": expected, "kind": "OME-TIFF"})
    items = items[::every]
    listed = tmp_path / "items.jsonl"
    listed.write_text("\n".join(json.dumps(item) for item in items), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", CHILD, listed, json.dumps(goods)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0, f"after {told[-1]}: {done.stderr[-2000:]}"
    seen = [one for one in told if "outcome" in one]
    assert len(seen) == len(items) >= 300 // every
    refused = sum("Error" in one["outcome"] for one in seen)
    slowest = max(seen, key=lambda one: one["seconds"])
    print(
        f"{len(seen)} damaged inputs, {refused} refused; slowest call {slowest['seconds']:.2f} s"
        f" ({slowest['name']}); peak memory {told[-1]['peak_mib']:.0f} MiB"
    )
    assert not [one for one in seen if "TRACEBACK" in one["outcome"]]
    wrong = [
        one for one in seen if "OTHER VALUES" in one["outcome"] and one["expected"] != "values"
    ]
    assert not [(one["name"], one["outcome"]) for one in wrong]
    assert not [
        one["name"] for one in seen if "absurd" in one["name"] and "right" in one["outcome"]
    ]
    assert slowest["seconds"] < 10
    assert told[-1]["peak_mib"] < 1024
    assert refused > 0.8 * len(seen)
    assert done.stderr == ""
