"""Damaged files by the hundred: does every one end with a sentence and an exit code of its own?

    python -m benchmarks fuzz [PART] [COUNT] [CASE]

Parts: link (images and run files), marks (files of every program), chunks (the maps of a run), nifti. Each case has its
number as its seed, so that one can be made again alone. Commands run in this process, as `planish.cli.main`.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import os
import random
import re
import shutil
import signal
import struct
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import imagecodecs
import nibabel
import numpy as np
import tifffile
from PIL import Image
from scipy.io import savemat
from tests.marks import files_by_hand as by_hand

from planish.cli import main as planish
from planish.synthetic import (
    BurnParams,
    CameraParams,
    ScannerParams,
    SpecimenParams,
    Warp,
    make_specimen,
    write_instruments,
)

SEED = 5
ALLOWED = {0, 3, 4, 5}
_REFUSED = {3, 5}
_MOST_MIB = 512  # more than before, of a case that is refused
_MOST_S = 5.0
_ENOUGH_S = 120
_HEAD = 400  # bytes in which headers are damaged
_HUGE = (2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**64 - 1, 10**9, 65535, 0, 1)
_ODD = (
    None, True, -1, 0, 1, 2**31, 2**70, 1e308, -1e-300, float("nan"), float("inf"), "", "x", "nan", "../../x",
    "ä\x1b[31m", [], {}, [1], [[]], {"a": 1}, "9" * 5000,
)  # fmt: skip
_NUMBERS = ("1e999", "-1e308", "nan", "inf", "-0", "0", "99999999999999999999", "1e-320", "", "x", "0x10", "true", "[1")
_PIXEL_UM = 5.0
_VOXEL_UM = 4.0

Rng = random.Random


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Whole files that cases start from."""

    run: Path
    image: Path
    pictures: dict[str, bytes]
    marks: dict[str, tuple[tuple[str, bytes], ...]]
    nifti: dict[str, bytes]


@dataclass(frozen=True, kw_only=True)
class Case:
    """What was damaged, and the commands that read it."""

    what: str
    commands: tuple[tuple[str, ...], ...]


@dataclass(kw_only=True)
class End:
    """How one command ended."""

    code: int
    said: str
    seconds: float
    mib: float
    faults: list[str] = field(default_factory=list)


def main(part: str = "all", count: int | str = 300, only: int | str = "") -> int:
    parts = list(PARTS) if part == "all" else [part]
    if not set(parts) <= PARTS.keys():
        sys.exit(f"There is no part '{part}'. Choose one of {', '.join(PARTS)}.")
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        ground = made(Path(name) / "ground")
        for part in parts:
            cases = range(int(count)) if only == "" else [int(only)]
            failed += fuzzed(part, cases, ground, Path(name), show=only != "")
    return failed


def fuzzed(part: str, cases: range | list[int], ground: Ground, folder: Path, *, show: bool) -> int:
    """Run the cases of a part, print how they ended, and return how many broke the rule."""
    ends: Counter[str] = Counter()
    failed, slowest, largest = 0, 0.0, 0.0
    for k in cases:
        place = folder / f"{part}-{k}"
        place.mkdir()
        case = PARTS[part](Rng(f"{SEED} {part} {k}"), ground, place)
        for arguments in case.commands:
            before = entries(place)
            end = ended(arguments)
            if end.code in _REFUSED:
                slowest, largest = max(slowest, end.seconds), max(largest, end.mib)
                if entries(place) != before:
                    end.faults.append(f"left {', '.join(sorted(entries(place) - before)[:3])}")
            ends[f"{arguments[0]} {end.code}"] += 1
            failed += bool(end.faults)
            if end.faults or show:
                print(f"{part} {k}: {case.what}: planish {' '.join(arguments)}: {end.code}, {'; '.join(end.faults)}\n"
                      f"    {end.said}\n    again: python -m benchmarks fuzz {part} 1 {k}", flush=True)  # fmt: skip
        shutil.rmtree(place)
    how = ", ".join(f"{count} x {name}" for name, count in sorted(ends.items()))
    print(f"{part}: {len(cases)} cases, command and exit code: {how}; {failed} broke the rule; refused within "
          f"{slowest:.1f} s of processor time and {largest:.0f} MiB", flush=True)  # fmt: skip
    return failed


def entries(folder: Path) -> set[str]:
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*")}


# --- one command ---------------------------------------------------------------------------------------------


class _Hangs(BaseException):
    """A command did not end."""


def ended(arguments: tuple[str, ...]) -> End:
    """Run one command in this process, and compare its end with the rule."""

    def stop(*_: object) -> None:
        raise _Hangs

    out, err = io.StringIO(), io.StringIO()
    before, start = memory_mib(peak=False), time.process_time()
    code: Any = -1
    signal.signal(signal.SIGALRM, stop)
    signal.alarm(_ENOUGH_S)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
            warnings.simplefilter("default")
            planish(list(arguments))
    except SystemExit as error:
        code = error.code or 0
    except _Hangs:
        err.write(f"did not end within {_ENOUGH_S} s")
    finally:
        signal.alarm(0)
    seconds, mib = time.process_time() - start, memory_mib(peak=True) - before
    text = err.getvalue()
    last = text.strip().splitlines()[-1:] or [""]
    end = End(code=code, said=last[0][-600:], seconds=seconds, mib=mib)
    if code not in ALLOWED:
        end.faults.append(f"exit code {code}{_logged(text)}")
    if "Traceback" in out.getvalue() + text:
        end.faults.append("a traceback")
    if found := re.search(r"^.*\w+Warning: .*$", text, re.MULTILINE):
        end.faults.append(f"a warning of Python: {found[0][-200:]}")
    if code in _REFUSED and not last[0].startswith("planish: "):
        end.faults.append("no sentence")
    if code in _REFUSED and seconds > _MOST_S:
        end.faults.append(f"{seconds:.1f} s of processor time")
    if code in _REFUSED and mib > _MOST_MIB:
        end.faults.append(f"{mib:.0f} MiB")
    return end


def _logged(text: str) -> str:
    """The end of the log that a fault of planish leaves, which goes."""
    found = re.search(r"The details are in (\S+\.log)", text)
    if not found:
        return ""
    log = Path(found[1])
    lines = log.read_text(encoding="utf-8").splitlines()
    log.unlink()
    places = [line.strip() for line in lines if line.startswith("  File") and "planish" in line]
    return f" ({' < '.join(re.sub(r'.*/planish/', '', place) for place in places[:-4:-1])})"


def memory_mib(*, peak: bool) -> float:
    """Memory of this process; the peak since the call without it."""
    if not Path("/proc/self/clear_refs").exists():
        return 0.0
    if not peak:
        Path("/proc/self/clear_refs").write_text("5")  # forget the peak before
    name = "VmHWM:" if peak else "VmRSS:"
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) / 1024


# --- damages -------------------------------------------------------------------------------------------------


def damaged(data: bytes, rng: Rng, *, text: bool = False) -> tuple[bytes, str]:
    """Damage a file, and say how."""
    ways = [cut, flipped, overwritten, huge, zeroed, moved, noise]
    if text:
        ways += [number, number, number, line, line, nested]
        with contextlib.suppress(ValueError):
            json.loads(data)
            ways += [leaf] * 8
    way = rng.choice(ways)
    return way(data, rng), way.__name__


def _place(data: bytes, rng: Rng, size: int = 1) -> int:
    """A place in the file, in half of the cases near its head."""
    last = max(len(data) - size, 0)
    return rng.randint(0, min(last, _HEAD) if rng.random() < 0.5 else last)


def cut(data: bytes, rng: Rng) -> bytes:
    return data[: rng.choice((0, _place(data, rng), _place(data, rng), len(data) - rng.randint(1, 64)))]


def flipped(data: bytes, rng: Rng) -> bytes:
    found = bytearray(data)
    for _ in range(rng.randint(1, 6)):
        found[_place(data, rng)] ^= 1 << rng.randrange(8)
    return bytes(found)


def overwritten(data: bytes, rng: Rng) -> bytes:
    size = rng.randint(1, 8)
    at = _place(data, rng, size)
    return data[:at] + rng.choice((bytes(size), b"\xff" * size, rng.randbytes(size))) + data[at + size :]


def huge(data: bytes, rng: Rng) -> bytes:
    """A number in the header becomes another, or one that no file has."""
    if rng.random() < 0.7:
        kind = rng.choice(("<H", ">H", "<I", ">I", "<Q", ">Q"))
        value: float = rng.choice(_HUGE) % 2 ** (8 * struct.calcsize(kind))
    else:
        kind, value = rng.choice(("<f", "<d", ">f")), rng.choice((1e38, -1.0, float("nan"), float("inf"), 1e-38, 0.0))
    size = struct.calcsize(kind)
    at = rng.randint(0, min(max(len(data) - size, 0), _HEAD)) // 2 * 2
    return data[:at] + struct.pack(kind, value) + data[at + size :]


def zeroed(data: bytes, rng: Rng) -> bytes:
    at = _place(data, rng)
    size = rng.choice((16, 512, len(data)))
    return data[:at] + bytes(len(data[at : at + size])) + data[at + size :]


def moved(data: bytes, rng: Rng) -> bytes:
    """A piece is lost, or there twice, or foreign bytes are between."""
    at, size = _place(data, rng), rng.randint(1, 64)
    return data[:at] + rng.choice((b"", data[at : at + size] * 2, rng.randbytes(size))) + data[at + size :]


def noise(data: bytes, rng: Rng) -> bytes:
    words = ("planish", "x_um", "1,2", "\n", "{", '"marks":', "\t", "point", "ü", "0.5", ";", "[volume]", "=")
    made = " ".join(rng.choices(words, k=40)).encode()
    return rng.choice((made, rng.randbytes(min(len(data), 3000)), b"", b"\0" * 100, made[:50] + data))


def number(data: bytes, rng: Rng) -> bytes:
    """A number of a text becomes an odd one."""
    found = [*re.finditer(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?", data)]
    if not found:
        return noise(data, rng)
    for one in sorted(rng.sample(found, min(len(found), rng.choice((1, 1, 2)))), key=lambda m: -m.start()):
        data = data[: one.start()] + rng.choice(_NUMBERS).encode() + data[one.end() :]
    return data


def line(data: bytes, rng: Rng) -> bytes:
    """A line is lost, there twice, cut, or changes its place with another."""
    lines = data.splitlines(keepends=True)
    if not lines:
        return noise(data, rng)
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    way = rng.randrange(4)
    if way == 0:
        del lines[a]
    elif way == 1:
        lines.insert(b, lines[a])
    elif way == 2:
        lines[a] = lines[a][: len(lines[a]) // 2] + b"\n"
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"".join(lines)


def nested(data: bytes, rng: Rng) -> bytes:
    at = _place(data, rng)
    return data[:at] + rng.choice((b"[", b'{"a":', b"(")) * rng.choice((3, 5000, 200_000)) + data[at:]


def leaf(data: bytes, rng: Rng) -> bytes:
    """Values of a JSON file become odd ones, or are lost, or have other names."""
    content = json.loads(data)
    for _ in range(rng.choice((1, 1, 1, 3))):
        places = [*_places(content)]
        if not places:
            break
        holder, key = rng.choice(places)
        way = rng.random()
        if way < 0.6:
            holder[key] = rng.choice(_ODD)
        elif way < 0.8:
            del holder[key]
        elif isinstance(holder, dict):
            holder[f"{key}x"] = holder.pop(key)
        else:
            holder.append(holder[key])
    return json.dumps(content).encode()


def _places(content: Any) -> Iterator[tuple[Any, Any]]:
    keys = content.keys() if isinstance(content, dict) else range(len(content)) if isinstance(content, list) else ()
    for key in [*keys]:
        yield content, key
        yield from _places(content[key])


# --- whole files ---------------------------------------------------------------------------------------------


def made(folder: Path) -> Ground:
    """Link a small specimen, and write all that is damaged later."""
    specimen = make_specimen(
        SpecimenParams(
            size_um=(1300.0, 1000.0), holes=BurnParams(pattern="irregular", count=5),
            warp=Warp(slope=0.35, wavelength_um=1800.0), scanner=ScannerParams(voxel_um=_VOXEL_UM),
            camera=CameraParams(pixel_um=_PIXEL_UM, radial=0.0, stretch=0.0, shading=0.0, nuisance_sd=0.004), seed=5,
        )
    )  # fmt: skip
    files = write_instruments(specimen, folder)
    assert files.image is not None
    run = folder / "run"
    end = ended(("link", str(files.volume), str(files.image), "--out", str(run)))
    if end.code:
        sys.exit(end.said)
    grey = np.clip(specimen.image.values, 0, 1)
    corner = specimen.volume.values[:, :125, :200]
    return Ground(run=run, image=files.image, pictures=pictures(grey), marks=marks_files(run), nifti=nifti(corner))


def pictures(grey: np.ndarray) -> dict[str, bytes]:
    deep, flat = np.rint(grey * 65535).astype(np.uint16), np.rint(grey * 255).astype(np.uint8)
    size: dict[str, Any] = {"resolution": (1e4 / _PIXEL_UM, 1e4 / _PIXEL_UM), "resolutionunit": "CENTIMETER"}
    ome = {"axes": "YX", "PhysicalSizeX": _PIXEL_UM, "PhysicalSizeY": _PIXEL_UM}
    options: dict[str, dict[str, Any]] = {
        "plain.tif": size, "deflate.tif": size | {"compression": "zlib", "rowsperstrip": 32},
        "lzw.tif": size | {"compression": "lzw", "tile": (64, 64)}, "big.tif": size | {"bigtiff": True},
        "packbits.tif": size | {"compression": "packbits"}, "i.ome.tif": {"ome": True, "metadata": ome},
        "imagej.tif": {"imagej": True, "resolution": (1 / _PIXEL_UM,) * 2, "metadata": {"unit": "um"}},
        "end.tif": size | {"byteorder": ">"},
    }  # fmt: skip
    found = {"deep.png": imagecodecs.png_encode(deep), "colour.png": imagecodecs.png_encode(np.dstack([flat] * 3))}
    for name, how in options.items():
        file = io.BytesIO()
        tifffile.imwrite(file, deep, **({"photometric": "minisblack"} | how))
        found[name] = file.getvalue()
    dpi = (25400 / _PIXEL_UM,) * 2
    for name, how in {"g.png": {"dpi": dpi}, "g.jpg": {"dpi": dpi, "quality": 95}, "g.bmp": {"dpi": dpi}}.items():
        file = io.BytesIO()
        Image.fromarray(flat).save(file, {"png": "PNG", "jpg": "JPEG", "bmp": "BMP"}[name[2:]], **how)
        found[name] = file.getvalue()
    file = io.BytesIO()
    Image.fromarray(flat).convert("P").save(file, "BMP")
    return found | {"palette.bmp": file.getvalue(), "progressive.jpg": _progressive(flat)}


def _progressive(flat: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.dstack([flat] * 3)).save(file, "JPEG", progressive=True)
    return file.getvalue()


def marks_files(run: Path) -> dict[str, tuple[tuple[str, bytes], ...]]:
    """Files of marks of every program: pairs, or two files of one layer each."""
    moving, fixed = by_hand.MOVING, by_hand.FIXED
    v5, v73 = io.BytesIO(), io.BytesIO()
    savemat(v5, {"movingPoints": moving, "fixedPoints": fixed})
    with h5py.File(v73, "w", userblock_size=512) as file:
        for name, values in (("movingPoints", moving), ("fixedPoints", fixed)):
            file.create_dataset(name, data=np.ascontiguousarray(values.T)).attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Mar  3 10:00:00 2025 HDF5 schema 1.00 ."
    lists = by_hand.slicer_list(moving / 1000, "moving"), by_hand.slicer_list(fixed / 1000, "fixed")
    return {
        "matlab": (("v5.mat", v5.getvalue()),), "matlab73": (("v73.mat", head + v73.getvalue()[len(head) :]),),
        "json": (("own.json", by_hand.native().encode()),), "run": (("run.json", (run / "marks.json").read_bytes()),),
        "slicer": (("s.mrk.json", by_hand.slicer(*lists).encode()),),
        "bigwarp": (("landmarks.csv", by_hand.bigwarp_2d().encode()),),
        "bigwarp3": (("landmarks3.csv", by_hand.bigwarp_3d().encode()),),
        "bigwarpjson": (("landmarks.json", by_hand.bigwarp_json().encode()),),
        "elastix": tuple((f"{k}.txt", by_hand.elastix(v).encode()) for k, v in (("m", moving), ("f", fixed))),
        "csv": (("marks.csv", (run / "marks.csv").read_bytes()),),
        "imagej": tuple((f"{k}.csv", by_hand.imagej(v).encode()) for k, v in (("m", moving), ("f", fixed))),
    }  # fmt: skip


def nifti(volume: np.ndarray) -> dict[str, bytes]:
    across = np.ascontiguousarray(volume.transpose(2, 1, 0))
    found: dict[str, bytes] = {}
    for name, kind, dtype in (("one", nibabel.Nifti1Image, np.uint16), ("two", nibabel.Nifti2Image, np.int32)):
        image = kind(across.astype(dtype), np.diag([_VOXEL_UM] * 3 + [1.0]))
        image.header.set_xyzt_units("micron")
        found[f"{name}.nii"] = image.to_bytes()
    return found


# --- the parts -----------------------------------------------------------------------------------------------


def of_link(rng: Rng, ground: Ground, place: Path) -> Case:
    """A damaged picture, or a damaged file of the run; the holes of a picture that can be read are found."""
    run = copied(ground.run, place / "run")
    if rng.random() < 0.6:
        name = rng.choice(sorted(ground.pictures))
        data, what = damaged(ground.pictures[name], rng)
        image = place / name
        image.write_bytes(data)
        size = () if name.endswith(".tif") or name.startswith("g.") else ("--pixel-um", str(_PIXEL_UM))
    else:
        name = rng.choice(("run.toml", "results.json", "marks.json"))
        data, what = damaged((ground.run / name).read_bytes(), rng, text=True)
        changed(run / name, data)
        image, size = ground.image, ()
    command = ("link", str(run), str(image), *size, "--out", str(place / "out"))
    return Case(what=f"{name} {what}", commands=(command,) if name.count(".t") else (command, ("info", str(run))))


def of_marks(rng: Rng, ground: Ground, place: Path) -> Case:
    """Most are converted; marks of the run are also linked with."""
    linked = rng.random() < 0.12
    name = rng.choice(("run", "csv") if linked else sorted(ground.marks))
    files = [*ground.marks[name]]
    k = rng.randrange(len(files))
    data, what = damaged(files[k][1], rng, text=not name.startswith("matlab"))
    files[k] = (files[k][0], data)
    for file, content in files:
        (place / file).write_bytes(content)
    paths = [str(place / file) for file, _ in files]
    if linked:
        command = ("link", str(ground.run), str(ground.image), "--marks", *paths, "--out", str(place / "out"))
    else:
        out = rng.choice(("out.json", "out.mrk.json", "out.csv", "out.mat", "out.txt"))
        sizes = ("--moving-pixel-um", "2.5", "--fixed-pixel-um", "4")
        command = ("marks", "convert", *paths, str(place / out), *sizes)
    return Case(what=f"{files[k][0]} {what}", commands=(command,))


def of_chunks(rng: Rng, ground: Ground, place: Path) -> Case:
    run = copied(ground.run, place / "run")
    store = run / "maps.zarr"
    headers = sorted(store.rglob("zarr.json"))
    if rng.random() < 0.4:
        path = store / "zarr.json" if rng.random() < 0.7 else rng.choice(headers)
    else:
        path = rng.choice(sorted(p for p in store.rglob("*") if p.is_file() and p.name != "zarr.json"))
    if rng.random() < 0.15:
        path.unlink()
        what = "removed"
    else:
        data, what = damaged(path.read_bytes(), rng, text=path.name == "zarr.json")
        changed(path, data)
    name = path.relative_to(run).as_posix()
    return Case(
        what=f"{name} {what}", commands=(("report", str(run), "--out", str(place / "page.html")), ("info", str(run)))
    )


def of_nifti(rng: Rng, ground: Ground, place: Path) -> Case:
    name = rng.choice(sorted(ground.nifti))
    data = ground.nifti[name]
    if rng.random() < 0.5:
        data, what = damaged(data, rng)
    else:  # of the headers only: most other damage is of single voxels, and is mapped
        head = 352 if name == "one.nii" else 544
        changed_head, what = damaged(data[:head], rng)
        data = changed_head + data[head:]
    if rng.random() < 0.5:
        name = f"{name}.gz"
        data = gzip.compress(data, 1, mtime=0)
        if rng.random() < 0.4:
            data, more = damaged(data, rng)
            what = f"{what}, packed {more}"
    path = place / name
    path.write_bytes(data)
    size = ("--voxel-um", str(_VOXEL_UM), "--override-size") if rng.random() < 0.3 else ()
    return Case(
        what=f"{name} {what}", commands=(("info", str(path)), ("map", str(path), *size, "--out", str(place / "out")))
    )


def copied(run: Path, to: Path) -> Path:
    """A copy of a run whose files are links: a file that is changed is made anew."""
    shutil.copytree(run, to, copy_function=os.link)
    return to


def changed(path: Path, data: bytes) -> None:
    path.unlink()
    path.write_bytes(data)


PARTS: dict[str, Callable[[Rng, Ground, Path], Case]] = {
    "link": of_link, "marks": of_marks, "chunks": of_chunks, "nifti": of_nifti
}  # fmt: skip


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
