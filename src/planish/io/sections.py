"""Read photographs of serial sections.

They are a folder of pictures and the cut counter that says where each was cut.

The counter is ``sections.csv`` with the columns ``file`` and ``position_um``, and comments such as
``# kind: cut``.
"""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from planish.core.errors import FileError, SizeError, VolumeError
from planish.core.numbers import agree
from planish.core.tables import CsvTable, parse_table, read_text
from planish.core.text import first_few
from planish.core.typing import Entries, Fields, Floats, Pair
from planish.io.formats import check_channel, colour_attrs, full_scale, pictures_in
from planish.io.guard import size_of_file
from planish.io.image import picture_attrs
from planish.io.lazy import Values
from planish.io.picture import DecodedPicture
from planish.io.sizes import VOXEL, SizeAndSource, Stated, agreed_size, size_attrs, size_per_axis

COUNTER = "sections.csv"
COLUMNS = ("file", "position_um")
KINDS = ("block-face", "cut")


class SectionStack(NamedTuple):
    """Sections as photographed: neither aligned nor evenly spaced.

    The values, dims (section, row, col), are in the type of the files, float16 as float32; colour
    as luminance, rounded in integers. Photographs too large for the memory stay in files:
    ``values[i]`` decodes one. Attributes, once the size is known: ``voxel_um`` (z, y, x) with the
    median step of the counter as z, ``voxel_um_source``, ``full_scale``, ``file_name``,
    ``file_bytes``, ``section_kind``; ``channel`` and ``colour`` where the files are in colour.
    """

    folder: Path
    values: Values
    first: DecodedPicture  # the first photograph: one pixel of it, and what its file says
    positions_um: Floats  # along the cut, increasing; missing sections are gaps
    kind: str  # "block-face", "cut", or empty where the counter does not say
    file_bytes: int
    attrs: Fields = MappingProxyType({})

    @property
    def pixel_um(self) -> Pair:
        """Size of a pixel (row, col)."""
        _, row_um, col_um = self.attrs["voxel_um"]
        return row_um, col_um

    def agreed_size(
        self, voxel_um: float | Sequence[float] | None, *, override: bool, unusual: bool
    ) -> SizeAndSource:
        """Join the median step of the counter with the pixel size of metadata and user.

        ``voxel_um``, `override` and `unusual` as in :func:`read_section_stack`; the size is (z, y,
        x) in um.
        """
        name = self.folder.name
        pitch_um = float(np.median(np.diff(self.positions_um)))
        if voxel_um is not None:
            axis_sizes = size_per_axis(voxel_um, VOXEL)
            is_single = isinstance(voxel_um, (int, float)) or len(voxel_um) == 1
            if not is_single and not agree(axis_sizes[0], pitch_um):
                raise SizeError(
                    f"{name}: `{VOXEL.word}` gives z {axis_sizes[0]:g} um, but the median step of"
                    f" {COUNTER} is {pitch_um:g} um. Correct the counter, or give"
                    f" `{VOXEL.word}={pitch_um:.9g},Y,X`."
                )
            voxel_um = (pitch_um, axis_sizes[1], axis_sizes[2])
        photograph_sizes = [s._replace(um=(None, *s.um[1:])) for s in self.first.stated]
        stated = [Stated("the cut counter", (pitch_um, None, None)), *photograph_sizes]
        return agreed_size(
            stated, voxel_um, file_name=name, asked=VOXEL, override=override, unusual=unusual
        )


def is_section_folder(path: str | Path) -> bool:
    """True if a path is a folder with a cut counter in it."""
    return (Path(path) / COUNTER).is_file()


def read_section_stack(
    path: str | Path,
    *,
    voxel_um: float | tuple[float, float, float] | None = None,
    channel: str | None = None,
    override_size: bool = False,
    unusual_size: bool = False,
    memory_bytes: int | None = None,
) -> SectionStack:
    """Read a folder of section photographs with its cut counter.

    Parameters
    ----------
    path : path; the folder: TIFF, PNG, BMP or JPEG, grey or colour, all alike, and ``sections.csv``
    voxel_um : float or (z, y, x), optional
        One number is the pixel size in um; of three, z is the counter's median step. Not needed
        where files state it.
    channel, override_size, unusual_size, memory_bytes
        As in :func:`planish.io.read_volume`. The counter cannot be overridden; more than fits stays
        in the files.

    Returns
    -------
    SectionStack

    Raises
    ------
    FileError
        If the counter or a file is missing, damaged, or no picture.
    VolumeError
        If counter and folder do not agree, positions do not increase, or sections differ in kind,
        size or type.
    SizeError
        If the pixel size is missing, contradictory or impossible.
    InputError
        If there is no such channel.
    ResourceError
        If not even some photographs fit into the memory.

    Notes
    -----
    Colour becomes luminance as `read_image` makes it: 0.2126 red + 0.7152 green + 0.0722 blue of
    the stored values.
    """
    sections = open_sections(Path(path), channel=channel, memory_bytes=memory_bytes)
    size, source = sections.agreed_size(voxel_um, override=override_size, unusual=unusual_size)
    first = sections.first
    attrs: Entries = {
        **size_attrs(VOXEL, size, source, first.stated),
        "full_scale": full_scale(sections.values.dtype, first.bits),
        "file_name": sections.folder.name,
        "file_bytes": sections.file_bytes,
        "section_kind": sections.kind,
    }
    attrs |= colour_attrs(check_channel(channel), sections.folder, in_colour=first.in_colour)
    attrs |= picture_attrs(first.orientation)
    return sections._replace(attrs=attrs)


def open_sections(folder: Path, *, channel: str | None, memory_bytes: int | None) -> SectionStack:
    """Read the cut counter of a folder, compare it with the pictures there, and read these."""
    if not folder.is_dir():
        raise FileError(f"{folder.name} is not a folder. Check the name.")
    counter_file = folder / COUNTER
    size_of_file(counter_file)
    text = read_text(counter_file, what="cut counter")
    table_name = f"{COUNTER} in {folder.name}"
    table = parse_table(text, table_name, needed=COLUMNS, error=VolumeError)
    positions = table.numbers(COLUMNS[1:])[:, 0]
    files = _named_files(table, folder)
    for k, (before_um, um) in enumerate(pairwise(positions)):
        if not um > before_um:
            raise VolumeError(
                f"{table.name}: {files[k + 1].name} lies at {um:g} um, {files[k].name} before it at"
                f" {before_um:g} um. Positions increase in the order of the cuts: correct the"
                " counter, or sort its rows by position."
            )
    _check_present(files, folder)
    # Here, so that a look at a file waits for no reader of slices.
    from planish.io.slice_volume import load_pictures

    kind = _kind_of_sections(table)
    channel = check_channel(channel)
    values, picture = load_pictures(
        files, channel=channel, memory_bytes=memory_bytes, photographs=True
    )
    file_bytes = sum(size_of_file(file) for file in [*files, counter_file])
    one_pixel = picture.values[:1, :1].copy()
    first = picture._replace(values=one_pixel)
    return SectionStack(folder, values, first, positions, kind, file_bytes)


def _named_files(table: CsvTable, folder: Path) -> list[Path]:
    """Files that the rows of a counter name, two at least and each once."""
    files: list[Path] = []
    for row in table.rows:
        file_name = table.text(row, "file")
        file = folder / file_name
        if not file_name or file.name != file_name:
            table.fault(row, f"{file_name!r} is not the name of a file in this folder")
        elif file in files:
            table.fault(row, f"{file_name} for the second time")
        files.append(file)
    table.check()
    if len(files) < 2:
        raise VolumeError(f"{table.name} names {len(files)} sections, at least two are needed.")
    return files


def _check_present(files: list[Path], folder: Path) -> None:
    """Refuse a folder without some of the files, or with further pictures."""
    missing_names = [file.name for file in files if not file.is_file()]
    if missing_names:
        raise VolumeError(
            f"{folder.name} lacks {len(missing_names)} of {len(files)} files named in {COUNTER}:"
            f" {first_few(missing_names)}. Add them, or take their rows out: a gap in the positions"
            " is understood as a missing section."
        )
    unlisted = [file.name for file in pictures_in(folder) if file not in files]
    if unlisted:
        raise VolumeError(
            f"{folder.name} holds {len(unlisted)} pictures that {COUNTER} does not name:"
            f" {first_few(unlisted)}. Add a row for each with its position, or move them elsewhere."
        )


def _kind_of_sections(table: CsvTable) -> str:
    """Read from the comments what was photographed; empty where they do not say it.

    Two kinds are never mixed.
    """
    kinds: set[str] = set()
    for comment in table.content.comments:
        key, colon, kind = comment.lower().partition(":")
        if colon and key.strip() == "kind":
            kinds.add(kind.strip())
    unknown = sorted(kinds - {*KINDS})
    if unknown:
        raise VolumeError(
            f"{table.name} has the kind {', '.join(map(repr, unknown))}. Give {' or '.join(KINDS)}."
        )
    if len(kinds) > 1:
        raise VolumeError(
            f"{table.name} has both kinds, {' and '.join(sorted(kinds))}. The knife squeezes cut"
            " sections by 5 to 15 % and leaves the block's face as it is: put each kind into a"
            " folder of its own."
        )
    return "".join(kinds)
