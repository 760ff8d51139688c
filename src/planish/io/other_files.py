"""Say what a path holds that no reader takes, and the way to what planish reads.

A file is recognised by its first bytes, otherwise by the end of its name; a folder by counts of
what lies in it. ``other_kinds.toml`` has the kinds: the messages and ``docs/formats.md`` are made
from it.
"""

import os
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from planish.core.errors import FileError
from planish.core.text import and_join_few, printable
from planish.io.formats import (
    HEAD_BYTES,
    PICTURE_SUFFIXES,
    TIFF,
    Place,
    Starts,
    begins,
    format_by_bytes,
    format_of,
    is_slice_name,
)
from planish.io.guard import head_of, open_bytes, reading

MOST_FOLDERS = 200  # folders at and below a path that are looked into
RAW_VALUES = (".vol", ".raw")


class OtherKind(NamedTuple):
    """A kind of file or folder that planish does not read."""

    name: str  # with its article; the last word is a noun
    ends: list[str]  # of names, in small letters
    starts: Starts
    way: str  # to something that planish reads
    describes_values: bool  # of a raw volume that lies beside it


def _kinds() -> Iterator[OtherKind]:
    table = Path(__file__).with_name("other_kinds.toml").read_text(encoding="utf-8")
    for way in tomllib.loads(table)["ways"]:
        for kind in way["kinds"]:
            starts = [(byte, text.encode("latin-1")) for byte, text in kind.get("starts", [])]
            ends = kind["ends"].split()
            describes_values = way.get("describes_values", False)
            yield OtherKind(kind["name"], ends, starts, way["take"], describes_values)


OTHER_KINDS = [*_kinds()]
_BY_NAME = {end: kind for kind in OTHER_KINDS for end in kind.ends}
_TEXT = _BY_NAME[".txt"]
_ARCHIVES = _BY_NAME[".zip"]
_N5 = _BY_NAME[".n5"]
_DESCRIPTIONS = [end for end, kind in _BY_NAME.items() if kind.describes_values]


def check_kind(path: Path, *, takes_text: bool) -> None:
    """Refuse a file whose first bytes are those of another kind, or that holds zeros alone."""
    head = head_of(path, HEAD_BYTES)
    kind = _kind_by_bytes(head)
    is_other = kind is not None and not (takes_text and kind is _TEXT)
    if is_other or format_by_bytes(head) is not None or _has_zeros_alone(path):
        raise refusal(path)


def refusal(path: Path) -> FileError:
    """Give the error for a file that no reader takes: what it is, and the way on.

    The caller raises it; a file that is missing or empty raises FileError at once.
    """
    head = head_of(path, HEAD_BYTES)
    kind = _kind_by_bytes(head)
    origin = "first bytes"
    file_format = format_by_bytes(head)
    # What packs or holds others says less than the name.
    if kind in (None, _TEXT, _ARCHIVES) and path.suffix.lower() in _BY_NAME:
        kind = _BY_NAME[path.suffix.lower()]
        origin = "name"
    elif file_format is not None:
        new_name = path.with_suffix(file_format.suffixes[0]).name
        return FileError(
            f"{path.name} is of the format {file_format.name} by its first bytes. Rename it to"
            f" {new_name}."
        )
    if kind is _TEXT and origin == "first bytes":
        text = head.decode("utf-8", "replace").strip()
        first_line = printable(text[:40].partition("\n")[0])
        return FileError(f"{path.name} is a text that begins with {first_line!r}. {_TEXT.way}")
    if kind is not None:
        values_file = _partner(path, RAW_VALUES) if kind.describes_values else None
        values_text = f" The file {values_file.name} lies beside it." if values_file else ""
        return FileError(f"{path.name} is {kind.name} by its {origin}. {kind.way}{values_text}")
    if _has_zeros_alone(path):
        return FileError(
            f"{path.name} has {path.stat().st_size} bytes, and all are 0. Copy or export it again."
        )
    return FileError(
        f"{path.name} is no TIFF, PNG, JPEG or BMP file, nor another one that planish knows: its"
        f" first bytes are {head[:8].hex(' ')}. Export a volume as TIFF slices or one stack, an"
        " image as TIFF or PNG. Raw values need the end .raw and a header beside them."
    )


def description_of(path: Path) -> Path | None:
    """Find the file of a scanner's software that describes a file of raw values."""
    return _partner(path, _DESCRIPTIONS)


def _partner(path: Path, suffixes: Sequence[str]) -> Path | None:
    """Find a file beside another one that has its name and one of these ends."""
    names = [f"{path.stem}{suffix}".lower() for suffix in suffixes]
    with reading(path):
        for file in sorted(path.parent.iterdir()):
            if file.name.lower() in names:
                return file
    return None


def folder_refusal(folder: Path) -> FileError:
    """Give the error for a folder without slices: what it holds, and what to give."""
    contents_text, way = folder_contents(folder)
    return FileError(f"{folder.name} holds no slices: {contents_text}. {way}")


def folder_contents(folder: Path) -> tuple[str, str]:
    """Count the files of a folder and of those below it, and say which of them to give.

    Two texts: what it holds, and what to do.
    """
    if folder.suffix.lower() in _N5.ends or (folder / "attributes.json").is_file():
        return f"it is {_N5.name}", _N5.way
    if (folder / "run.toml").is_file():
        return "it is a run of planish", "Give the volume itself."
    files_by_folder, stores = _visible(folder)
    files = files_by_folder.pop(folder, [])
    most_files = max(files_by_folder.values(), key=len, default=[])
    with_slices = [inner for inner, held in files_by_folder.items() if _has_slices(held)]
    texts = _counted(files)
    for inner in with_slices or [file.parent for file in most_files[:1]]:
        counted_text = and_join_few(_counted(files_by_folder[inner]))
        texts.append(f"a folder {inner.relative_to(folder).as_posix()} with {counted_text}")
    texts += [f"an OME-Zarr store {store.name}" for store in stores]
    contents_text = f"it holds {and_join_few(texts)}" if texts else "it is empty"
    candidates = with_slices or [*filter(_is_volume, files), *stores]
    return contents_text, _way_on(folder, candidates, files or most_files)


def _way_on(folder: Path, candidates: Sequence[Path], files: Sequence[Path]) -> str:
    """Say which volume of a folder to give, or how to make one of its files."""
    if candidates:
        name = candidates[0].relative_to(folder.parent).as_posix()
        return f"Give {name}." if len(candidates) == 1 else f"Give one, as {name}."
    kind = _kind_of(_by_suffix(files)[0][0]) if files else None
    if kind is None:
        return "Needed are TIFF, PNG, BMP or JPEG files with numbers in their names."
    return kind.way


def _has_slices(files: Sequence[Path]) -> bool:
    return sum(is_slice_name(file.name) for file in files) > 1


def _visible(folder: Path) -> tuple[dict[Path, list[Path]], list[Path]]:
    """Files that are not hidden by the folder in which they lie, and stores of volumes.

    Folders without files are left out. Stores are not looked into.
    """
    files_by_folder: dict[Path, list[Path]] = {}
    stores: list[Path] = []
    for name, inner_names, file_names in islice(os.walk(folder), MOST_FOLDERS):
        files = _shown(name, file_names)
        if files:
            files_by_folder[Path(name)] = files
        inner_folders = _shown(name, inner_names)
        stores += [inner for inner in inner_folders if format_of(Place(inner)).marker_files]
        inner_names[:] = [inner.name for inner in inner_folders if inner not in stores]
    return files_by_folder, stores


def _shown(folder: str, names: list[str]) -> list[Path]:
    """Members of a folder that are not hidden, in order."""
    return [Path(folder, name) for name in sorted(names) if not name.startswith(".")]


def _counted(files: Sequence[Path]) -> list[str]:
    """Count the files of each suffix: ``5 DICOM files (.dcm)``, the most first."""
    texts: list[str] = []
    for group in _by_suffix(files):
        suffix = _suffix(group[0])
        n = len(group)
        suffix_text = f" ({suffix})" if suffix else " without a suffix"
        texts.append(f"{n} {_noun(group[0])}{'s' if n > 1 else ''}{suffix_text}")
    return texts


def _by_suffix(files: Sequence[Path]) -> list[list[Path]]:
    groups: dict[str, list[Path]] = defaultdict(list)
    for file in files:
        groups[_suffix(file)].append(file)
    return sorted(groups.values(), key=len, reverse=True)


def _suffix(file: Path) -> str:
    """End of a name in small letters; a number is none."""
    suffix = file.suffix.lower()
    if suffix[1:].isdecimal():
        return ""
    return suffix


def _noun(file: Path) -> str:
    """Words for the kind of a file, without an article."""
    suffix = file.suffix.lower()
    if suffix in PICTURE_SUFFIXES:
        return f"{PICTURE_SUFFIXES[suffix]} image"
    if suffix in RAW_VALUES:
        return "raw volume"
    if _is_volume(file):
        return f"{format_of(Place(file)).name} file"
    kind = _kind_of(file)
    if kind is None:
        return "file"
    return kind.name.partition(" ")[2]


def _is_volume(file: Path) -> bool:
    return format_of(Place(file)) is not TIFF and file.suffix.lower() != ".toml"


def _kind_of(file: Path) -> OtherKind | None:
    """Kind of a file by its name, otherwise by its first bytes."""
    kind = _BY_NAME.get(file.suffix.lower())
    if kind is None and file.stat().st_size:
        return _kind_by_bytes(head_of(file, HEAD_BYTES))
    return kind


def _kind_by_bytes(head: bytes) -> OtherKind | None:
    # A page may begin with lines, and in capitals.
    folded_head = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    for kind in OTHER_KINDS:
        if begins(head, kind.starts) or begins(folded_head, kind.starts):
            return kind
    try:
        words = head[:-4].decode().split()  # the last character may be cut
    except UnicodeDecodeError:
        return None
    # Text has no control characters but those of lines and columns.
    if words and "".join(words).isprintable():
        return _TEXT
    return None


def _has_zeros_alone(path: Path) -> bool:
    with open_bytes(path) as file:
        while block := file.read(2**20):
            if any(block):
                return False
    return True
