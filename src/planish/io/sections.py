"""Photographs of serial sections: a folder of pictures and the cut counter that says where each was cut."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import SizeError
from planish.io.colour import check_channel, colour_attrs
from planish.io.cut_counter import COUNTER, read_counter
from planish.io.guard import size_of_file
from planish.io.lazy import FileArray
from planish.io.sizes import VOXEL, Stated, agree, agreed_size, as_given
from planish.io.slice_volume import load_pictures


@dataclass(frozen=True, slots=True, kw_only=True)
class SectionStack:
    """Sections as photographed: neither aligned nor evenly spaced.

    Attributes
    ----------
    values : ndarray or FileArray, dims (section, row, col)
        In the type of the files, float16 as float32; colour as luminance, rounded in integers. Photographs that do
        not fit into the memory stay in their files: ``values[i]`` decodes one.
    positions_um : ndarray (sections,)
        Along the cut, increasing; missing sections are gaps.
    pixel_um : tuple of float
        Along (row, col).
    kind : {"block-face", "cut", ""}
        What was photographed; empty where the counter does not say.
    attrs : dict
        ``voxel_um`` (z, y, x) with the median step of the counter as z, ``voxel_um_source``, ``full_scale``,
        ``file_name``, ``file_bytes``, ``section_kind``; ``channel`` and ``colour`` where the files are in colour.
    """

    values: NDArray[Any] | FileArray
    positions_um: NDArray[np.float64]
    pixel_um: tuple[float, float]
    kind: str
    attrs: dict[str, Any]


def is_section_folder(path: str | Path) -> bool:
    """Whether a path is a folder with a cut counter in it."""
    return (Path(path) / COUNTER).is_file()


def read_section_stack(
    path: str | Path,
    *,
    voxel_um: float | tuple[float, float, float] | None = None,
    channel: str | None = None,
    override_size: bool = False,
    memory_bytes: int | None = None,
) -> SectionStack:
    """Read a folder of section photographs with its cut counter.

    Parameters
    ----------
    path : path
        The folder: TIFF, PNG, BMP or JPEG, grey or colour, all alike, and ``sections.csv``.
    voxel_um : float or (z, y, x), optional
        One number is the pixel size in um; of three, z has to be the median step of the counter. Not needed where the
        metadata state the pixel size.
    channel : {"luminance", "red", "green", "blue"}, optional
        What is taken of sections in colour; luminance where not given.
    override_size : bool
        Whether the pixel size is taken although the metadata state another. The counter cannot be overridden.
    memory_bytes : int, optional
        Largest decoded size of all of them; default: three quarters of the memory available. More stay in their files.

    Returns
    -------
    SectionStack

    Raises
    ------
    FileError
        If the counter or a file is missing, damaged, or no picture.
    VolumeError
        If counter and folder do not agree, positions do not increase, kinds are mixed, or sections differ in size or
        type.
    SizeError
        If the pixel size is missing, contradictory or impossible.
    InputError
        If there is no such channel.
    ResourceError
        If not even some photographs fit into the memory.

    Notes
    -----
    Colour becomes luminance as `read_image` makes it: 0.2126 red + 0.7152 green + 0.0722 blue of the stored values.
    """
    folder = Path(path)
    counter = read_counter(folder)
    files = [folder / name for name in counter.names]
    channel = check_channel(channel)
    values, first = load_pictures(files, channel=channel, memory_bytes=memory_bytes, photographs=True)
    stated, full_scale = first.stated, None if values.dtype.kind == "f" else first.full_scale
    size, source = section_size(
        stated, voxel_um, pitch_um=counter.pitch_um, folder_name=folder.name, override=override_size
    )
    return SectionStack(
        values=values,
        positions_um=counter.positions_um,
        pixel_um=(size[1], size[2]),
        kind=counter.kind,
        attrs={
            "voxel_um": list(size),
            "voxel_um_source": source,
            "full_scale": full_scale,
            "file_name": folder.name,
            "file_bytes": sum(size_of_file(file) for file in [*files, folder / COUNTER]),
            "section_kind": counter.kind,
            **(colour_attrs(channel) if first.in_colour else {}),
        },
    )


def section_size(
    stated: tuple[Stated, ...],
    given: float | tuple[float, ...] | None,
    *,
    pitch_um: float,
    folder_name: str,
    override: bool,
) -> tuple[tuple[float, ...], str]:
    """Join the counter's pitch with the pixel size of metadata and user."""
    flat = [Stated(source=s.source, um=(None, *s.um[1:]), note=s.note) for s in stated]
    counter = Stated(source="the cut counter", um=(pitch_um, None, None))
    if given is not None:
        values = as_given(given, VOXEL)
        single = isinstance(given, (int, float)) or len(given) == 1
        if not single and not agree(values[0], pitch_um):
            raise SizeError(
                f"{folder_name}: {VOXEL.option} gives z {values[0]:g} um, but the median step of {COUNTER} is "
                f"{pitch_um:g} um. Correct the counter, or give the pixel size alone."
            )
        given = (pitch_um, values[1], values[2])
    return agreed_size([counter, *flat], given, file_name=folder_name, asked=VOXEL, override=override)
