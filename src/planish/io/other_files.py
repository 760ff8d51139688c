"""Say what a path holds that no reader takes, and the way to what planish reads.

A file is recognised by its first bytes, otherwise by the end of its name; a folder by counts of
what lies in it. One table has the kinds: the messages and ``docs/how-to/my-scanner-writes.md``
are made from it.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from planish.core.errors import FileError
from planish.core.text import and_join, printable
from planish.io.formats import (
    FORMATS,
    PICTURE_SUFFIXES,
    TIFF,
    Place,
    VolumeFormat,
    format_of,
    is_slice_name,
)
from planish.io.guard import head_of, reading
from planish.io.tiff import is_tiff

HEAD_BYTES = 512  # the longest header below ends within them
MOST_GROUPS = 4  # kinds of files, or folders, that a message counts
MOST_FOLDERS = 200  # folders below a path that are looked into
MOST_LEVELS = 3  # of folders in folders
Starts = tuple[tuple[int, bytes], ...]


class OtherKind(NamedTuple):
    """A kind of file or folder that planish does not read."""

    name: str  # with its article; the last word is a noun
    ends: str  # of names, in small letters
    way: str  # to something that planish reads
    starts: Starts = ()  # each a byte of the file and what stands there


_SCANNER = (
    "Export the reconstruction as TIFF slices in the scanner's software, and give `voxel_um=SIZE`."
)
_FIJI = "Open it in Fiji and save it with File > Save As > Tiff."
_RAW = (
    "It describes a raw volume: give the file with the values, and copy numbers of voxels, type and"
    " size (mm × 1000) into a header beside it, such as NAME.vol.toml."
)
_PICTURE = "Save it as TIFF or PNG, without loss."
_DETACHED = "Save header and values as one file, such as .nii, or as TIFF slices."
_ARCHIVE = "Unpack it, and give the file or folder in it."
_TABLE = "Give the image or the volume itself."
OTHER_KINDS = (
    OtherKind("a Zeiss Xradia file", ".txm .txrm .xrm", _SCANNER),
    OtherKind("a VGStudio file", ".vgi .vgl", _RAW),
    OtherKind("a GE phoenix datos|x file", ".pca .pcr .pcp", _RAW),
    OtherKind("a Nikon X-Tek file", ".xtekct .xtekvolume", _RAW),
    OtherKind("a raw values file", ".xraw .bin .dat", (
        "Give it the end .raw, and write numbers of voxels and type into a header beside it,"
        " NAME.raw.toml."
    )),
    OtherKind("a Scanco file", ".isq .aim .rsq", _SCANNER, ((0, b"CTDATA-HEADER"),)),
    OtherKind(
        "an Amira or Avizo file", ".am .amiramesh .hx",
        "Save it as NRRD or as TIFF slices in Amira or Avizo.",
        ((0, b"# AmiraMesh"), (0, b"# Avizo")),
    ),
    OtherKind(
        "a DICOM file", ".dcm .dicom .ima",
        "Open the folder in Fiji and save it with File > Save As > Tiff; Pixel Spacing × 1000 is"
        " the size in um.",
        ((128, b"DICM"),),
    ),
    OtherKind(
        "a NumPy file", ".npy .npz",
        "Load it in Python and give the array to `pl.volume` or `pl.image`.",
        ((0, b"\x93NUMPY"),),
    ),
    OtherKind("an N5 container", ".n5", (
        "Open it in Fiji (File > Import > N5) and save it as Tiff, or convert it to OME-Zarr."
    )),
    OtherKind("an Imaris file", ".ims", _FIJI),
    OtherKind("a Zeiss microscope file", ".czi .zvi", _FIJI, ((0, b"ZISRAWFILE"),)),
    OtherKind("a Leica microscope file", ".lif .scn", _FIJI, ((0, b"p\0\0\0"),)),
    OtherKind("a Nikon microscope file", ".nd2", _FIJI, ((0, b"\xda\xce\xbe\n"),)),
    OtherKind("an Olympus microscope file", ".vsi .oib .oif .oir", _FIJI),
    OtherKind("an electron microscope file", ".dm3 .dm4 .ser .emd", _FIJI),
    OtherKind("a FITS file", ".fits .fit", _FIJI, ((0, b"SIMPLE  ="),)),
    OtherKind(
        "a slide scanner file", ".svs .ndpi .mrxs .bif",
        "Export the level you need as TIFF in QuPath or Fiji.",
    ),
    OtherKind(
        "a detached header file", ".hdr",
        _DETACHED,
        ((0, b"ENVI"),),
    ),
    OtherKind("a detached values file", ".img", _DETACHED),
    OtherKind(
        "a JPEG 2000 file", ".jp2 .j2k .jpx .jpf", _PICTURE,
        ((4, b"jP  \r\n"), (0, b"\xff\x4f\xff\x51")),
    ),
    OtherKind(
        "a foreign picture file",
        ".gif .webp .heic .heif .avif .jxl .psd .exr", _PICTURE,
        ((0, b"GIF8"), (8, b"WEBP"), (4, b"ftyp"), (0, b"8BPS")),
    ),
    OtherKind(
        "a camera raw file", ".cr2 .cr3 .nef .arw .raf .orf .rw2",
        "Develop it to a TIFF of 16 bits, without sharpening.",
    ),
    OtherKind("a PDF file", ".pdf", "Export the picture in it as TIFF or PNG.", ((0, b"%PDF"),)),
    OtherKind(
        "a VTK file", ".vtk .vti .pvti .vtr",
        "Open it in ParaView and save it as MetaImage (.mhd).", ((0, b"# vtk DataFile"),),
    ),
    OtherKind(
        "a surface mesh", ".stl .ply .obj",
        "It holds no grey values: give the volume that it was made of.",
    ),
    OtherKind(
        "a packed archive",
        ".zip .gz .bz2 .tar .tgz .7z .rar .xz .zst .ozx", _ARCHIVE,
        (
            (0, b"PK\3\4"), (0, b"\x1f\x8b"), (0, b"BZh"), (257, b"ustar"), (0, b"7z\xbc\xaf"),
            (0, b"Rar!"), (0, b"\xfd7zXZ"),
        ),
    ),
    OtherKind(
        "a shortcut", ".lnk .url .webloc", "Give the file or folder that it leads to.",
        ((0, b"L\0\0\0\1\x14\2\0"), (0, b"[InternetShortcut]")),
    ),
    OtherKind(
        "a cloud placeholder", ".icloud", "Download the file itself to this computer first."
    ),
    OtherKind(
        "an unfinished download", ".crdownload .part .partial .download",
        "Wait until it is complete, or download it again.",
    ),
    OtherKind(
        "a Git LFS pointer", "", "It names the file without its values: run git lfs pull.",
        ((0, b"version https://git-lfs"),),
    ),
    OtherKind(
        "a web page", ".html .htm", "Download the file itself, not the page that shows it.",
        ((0, b"<!doctype html"), (0, b"<html")),
    ),
    OtherKind("a table", ".csv .xlsx .xls .ods", _TABLE),
    OtherKind("a text file", ".txt .log .xml .json .ini .md", _TABLE),
)  # fmt: skip
_BY_NAME = {suffix: kind for kind in OTHER_KINDS for suffix in kind.ends.split()}
_TEXT, _ARCHIVES, _N5 = _BY_NAME[".txt"], _BY_NAME[".zip"], _BY_NAME[".n5"]
RAW_DESCRIPTIONS = tuple(suffix for suffix, kind in _BY_NAME.items() if kind.way == _RAW)
RAW_VALUES = (".vol", ".raw")
PICTURE_STARTS = {b"\x89PNG\r\n\x1a\n": "png", b"\xff\xd8\xff": "jpeg", b"BM": "bmp"}
# Formats that planish reads by their first bytes, and a suffix of each.
READ_STARTS = {
    ("MRC", ".mrc"): ((208, b"MAP "),),
    ("HDF5 or NeXus", ".h5"): ((0, b"\x89HDF\r\n\x1a\n"),),
    ("MATLAB", ".mat"): ((0, b"MATLAB 5.0 MAT"), (0, b"MATLAB 7.3 MAT")),
    ("NRRD", ".nrrd"): ((0, b"NRRD0"),),
    ("NIfTI", ".nii"): ((344, b"n+1\0"), (344, b"ni1\0"), (4, b"n+2\0")),
} | {(kind.upper(), f".{kind}"): ((0, start),) for start, kind in PICTURE_STARTS.items()}
# The format in which files of another one may be written.
_WITHIN = {"MATLAB": "HDF5 or NeXus"}


def check_contents(place: Place) -> None:
    """Refuse a file that is of another kind than its name says, before it is called damaged.

    Pictures and TIFF files are known by their first bytes alone, and raw values may begin with any.
    """
    path, file_format = place.path, format_of(place)
    if file_format is TIFF or not path.is_file():
        return
    if path.suffix.lower() in (".gz", ".bz2"):
        if name := _read_format(head_of(path, HEAD_BYTES))[0]:
            raise FileError(f"{path.name} is no packed file but {name}. Rename it to {path.stem}.")
        return
    is_raw = ".raw" in file_format.suffixes
    if is_raw and (path.suffix.lower() == ".toml" or Path(f"{path}.toml").is_file()):
        return
    head = head_of(path, HEAD_BYTES)
    read_name, _ = _read_format(head)
    kind = _kind_by_bytes(head)
    takes_text = file_format.module == "header_volume"
    is_fine = read_name in ("", file_format.name, _WITHIN.get(file_format.name))
    by_name = _BY_NAME.get(path.suffix.lower())  # where a reader for it was added
    is_fine = is_fine and (kind in (None, by_name) or (kind is _TEXT and takes_text))
    if not is_fine or (any(head) is False and not is_raw):
        raise refusal(path)


def refusal(path: Path) -> FileError:
    """Give the error for a file that no reader takes: what it is, and the way on."""
    head = head_of(path, HEAD_BYTES)
    read_name, read_suffix = _read_format(head)
    by_bytes, by_name = _kind_by_bytes(head), _BY_NAME.get(path.suffix.lower())
    # What packs or holds others says less than the name.
    if by_name is not None and (by_bytes in (None, _TEXT, _ARCHIVES) or by_bytes is by_name):
        origin_text = " by its first bytes" if by_bytes is by_name else " by its name"
        values_file = partner(path, RAW_VALUES) if by_name.way == _RAW else None
        values_text = f" The file {values_file.name} lies beside it." if values_file else ""
        return FileError(f"{path.name} is {by_name.name}{origin_text}. {by_name.way}{values_text}")
    if read_name:
        new_name = f"{path.name.removesuffix(path.suffix)}{read_suffix}"
        return FileError(
            f"{path.name} is of the format {read_name} by its first bytes. Rename it to {new_name}."
        )
    if by_bytes is _TEXT:
        first_line = printable(head.decode("utf-8", "replace").strip()[:40].partition("\n")[0])
        return FileError(f"{path.name} is a text that begins with {first_line!r}. {_TEXT.way}")
    if by_bytes is not None:
        return FileError(f"{path.name} is {by_bytes.name} by its first bytes. {by_bytes.way}")
    if _has_zeros_alone(path):
        return FileError(
            f"{path.name} has {path.stat().st_size} bytes, and all are 0. Copy or export it again."
        )
    return FileError(
        f"{path.name} is no TIFF, PNG, JPEG or BMP file, nor another one that planish knows: its"
        f" first bytes are {head[:8].hex(' ')}. Export a volume as TIFF slices or one stack, an"
        " image as TIFF or PNG. Raw values need the end .raw and a header beside them."
    )


def partner(path: Path, suffixes: Sequence[str]) -> Path | None:
    """Find a file beside another one that has its name and one of these ends."""
    names = [f"{path.stem}{suffix}".lower() for suffix in suffixes]
    with reading(path):
        return next((p for p in sorted(path.parent.iterdir()) if p.name.lower() in names), None)


def folder_refusal(folder: Path) -> FileError:
    """Give the error for a folder without slices: what it holds, and what to give."""
    if folder.suffix.lower() == _N5.ends or (folder / "attributes.json").is_file():
        return FileError(f"{folder.name} holds no slices, it is {_N5.name}. {_N5.way}")
    if (folder / "run.toml").is_file():
        return FileError(
            f"{folder.name} holds no slices, it is a run of planish. Give the volume itself."
        )
    contents_text, way = folder_contents(folder)
    return FileError(f"{folder.name} holds no slices: {contents_text}. {way}")


def folder_contents(folder: Path) -> tuple[str, str]:
    """Count the files of a folder and of those below it, and say which of them to give."""
    files, volumes = _visible(folder)
    below: list[tuple[Path, list[Path]]] = []
    for inner in _folders_below(folder):
        if format_of(Place(inner)).marker_files:
            volumes.append(inner)
        elif inner_files := _visible(inner)[0]:
            below.append((inner, inner_files))
    with_slices = [entry for entry in below if sum(is_slice_name(p.name) for p in entry[1]) > 1]
    shown = with_slices or sorted(below, key=lambda entry: -len(entry[1]))[:1]
    texts = _counted(files)
    for inner, inner_files in shown[:MOST_GROUPS]:
        name = inner.relative_to(folder).as_posix()
        texts.append(f"a folder {name} with {and_join(_counted(inner_files))}")
    texts += [f"an OME-Zarr store {p.name}" for p in volumes if p.is_dir()][:MOST_GROUPS]
    if len(shown) > MOST_GROUPS:
        texts.append(f"{len(shown) - MOST_GROUPS} more folders with images")
    contents_text = f"it holds {and_join(texts)}" if texts else "it is empty"
    candidates = [inner for inner, _ in with_slices] or volumes
    if candidates:
        name = candidates[0].relative_to(folder.parent).as_posix()
        return contents_text, f"Give {name}." if len(candidates) == 1 else f"Give one, as {name}."
    main_files = files or [file for _, inner_files in shown for file in inner_files]
    if main_files and (kind := _kind_of_most(main_files)) is not None:
        return contents_text, kind.way
    return contents_text, "Needed are TIFF, PNG, BMP or JPEG files with numbers in their names."


def _visible(folder: Path) -> tuple[list[Path], list[Path]]:
    """Files of a folder that are not hidden, and those of them that are a volume by their name."""
    with reading(folder):
        files = sorted(p for p in folder.iterdir() if not p.name.startswith(".") and p.is_file())
    return files, [file for file in files if _volume_format(file) is not None]


def _folders_below(folder: Path) -> list[Path]:
    """Folders in a folder and in these, in the order of their names; none in a store of planish."""
    found: list[Path] = []
    level = [folder]
    for _ in range(MOST_LEVELS):
        children: list[Path] = []
        for parent in level:
            if parent is folder or not format_of(Place(parent)).marker_files:
                children += sorted(p for p in parent.iterdir() if p.is_dir())
            if len(found) + len(children) > MOST_FOLDERS:
                break
        level = [child for child in children if not child.name.startswith(".")]
        found += level
    return found[:MOST_FOLDERS]


def _counted(files: Sequence[Path]) -> list[str]:
    """Count the files of each suffix: ``5 DICOM files (.dcm)``, the most first."""
    groups = Counter(_suffix(file) for file in files)
    texts: list[str] = []
    for suffix, n in groups.most_common(MOST_GROUPS):
        sample = next(file for file in files if _suffix(file) == suffix)
        noun = _noun(sample, suffix)
        suffix_text = f" ({suffix})" if suffix else " without a suffix"
        texts.append(f"{n} {noun}{'s' if n > 1 else ''}{suffix_text}")
    others = len(files) - sum(n for _, n in groups.most_common(MOST_GROUPS))
    return [*texts, f"{others} others"] if others else texts


def _suffix(file: Path) -> str:
    suffix = file.suffix.lower()
    return "" if suffix[1:].isdecimal() else suffix


def _noun(sample: Path, suffix: str) -> str:
    """Words for the kind of a file, without an article."""
    if suffix in PICTURE_SUFFIXES:
        return f"{PICTURE_SUFFIXES[suffix]} image"
    if (file_format := _volume_format(sample)) is not None:
        return "raw volume" if suffix in RAW_VALUES else f"{file_format.name} file"
    kind = _kind_of(sample)
    return "file" if kind is None else kind.name.partition(" ")[2]


def _volume_format(file: Path) -> VolumeFormat | None:
    name = file.name.lower()
    if name.endswith(".toml"):
        return None
    return next((f for f in FORMATS if name.endswith(f.suffixes) and not f.marker_files), None)


def _kind_of(file: Path) -> OtherKind | None:
    """Kind of a file by its name, otherwise by its first bytes."""
    if (kind := _BY_NAME.get(file.suffix.lower())) is not None:
        return kind
    return _kind_by_bytes(head_of(file, HEAD_BYTES)) if file.stat().st_size else None


def _kind_of_most(files: Sequence[Path]) -> OtherKind | None:
    (suffix, _), *_ = Counter(_suffix(file) for file in files).most_common(1)
    return _kind_of(next(file for file in files if _suffix(file) == suffix))


def _read_format(head: bytes) -> tuple[str, str]:
    """Name and suffix of a format that planish reads; empty where the first bytes are of none."""
    if is_tiff(head):
        return TIFF.name, ".tif"
    return next((key for key, starts in READ_STARTS.items() if _begins(head, starts)), ("", ""))


def _kind_by_bytes(head: bytes) -> OtherKind | None:
    folded_head = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    for kind in OTHER_KINDS:
        is_web_page = kind.name == "a web page" and _begins(folded_head, kind.starts)
        if is_web_page or _begins(head, kind.starts):
            return kind
    # Text has no control characters but those of lines and columns.
    is_text = bool(head.strip()) and not any(byte < 32 and byte not in b"\t\n\f\r" for byte in head)
    try:
        head[:-4].decode()
    except UnicodeDecodeError:
        is_text = False
    return _TEXT if is_text else None


def _begins(head: bytes, starts: Starts) -> bool:
    return any(head.startswith(mark, position) for position, mark in starts)


def _has_zeros_alone(path: Path) -> bool:
    with reading(path), path.open("rb") as file:
        while block := file.read(2**20):
            if any(block):
                return False
    return True
