"""Photographs of serial sections: a folder of pictures and the cut counter that says where each was cut."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planish.core.errors import SizeError, VolumeError
from planish.io.colour import check_channel, colour_attrs, grey_of, refuse_channel, to_grey
from planish.io.cut_counter import COUNTER, read_counter
from planish.io.guard import check_memory, default_memory_limit, size_of_file
from planish.io.lazy import FileArray, PagedArray
from planish.io.loaded import check_type, supported_type
from planish.io.picture import Picture, load_picture
from planish.io.sizes import VOXEL, Stated, agree, agreed_size, as_given
from planish.io.slice_volume import SliceFiles, SliceHeads, check_same
from planish.io.tiff import size_words


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
    values, first = load_sections(files, channel=channel, memory_bytes=memory_bytes)
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
            **(colour_attrs(channel) if first.colour == "rgb" and first.values.ndim == 3 else {}),
        },
    )


def load_sections(
    files: list[Path], *, channel: str | None, memory_bytes: int | None
) -> tuple[NDArray[Any] | FileArray, Picture]:
    """Read pictures into one array, or leave them in their files where that is too large; and the first picture."""
    first = load_picture(files[0], memory_bytes=memory_bytes)
    if first.values.ndim == 2 or first.colour == "grey":
        refuse_channel(channel, files[0].parent)
    grey = as_grey(first, files[0], channel=channel)
    limit = default_memory_limit() if memory_bytes is None else memory_bytes
    if len(files) * grey.nbytes > limit:
        # A thread decodes a photograph while some others are compared.
        check_memory(files[0].parent, needed_bytes=4 * first.values.nbytes, limit_bytes=limit)
        colour = to_grey(channel) if first.values.ndim == 3 and first.colour == "rgb" else None
        heads = SliceHeads(files[0], colour)
        offsets = [heads.check(file, first, memory_bytes=limit) for file in files]
        pages = SliceFiles(files, offsets, heads.first, colour, grey.shape)
        shape = (len(files), int(grey.shape[0]), int(grey.shape[1]))
        return PagedArray(pages, shape, supported_type(grey.dtype), files[0].parent), first
    values = np.empty((len(files), *grey.shape), supported_type(grey.dtype))
    for i, file in enumerate(files):
        picture = first if i == 0 else load_picture(file, memory_bytes=memory_bytes)
        if picture.colour != first.colour:
            raise VolumeError(
                f"{file.name} is {picture.colour}, {files[0].name} is {first.colour}. All sections need the same: "
                "export them again."
            )
        if i and picture.values.ndim == first.values.ndim == 2:
            check_same(picture, first, file=file, first_file=files[0])
        elif i:
            check_same(without_samples(picture), without_samples(first), file=file, first_file=files[0])
        values[i] = as_grey(picture, file, channel=channel)
    return values, first


def without_samples(picture: Picture) -> Picture:
    """Return the first sample of a picture alone, to be compared in size and type."""
    values = picture.values if picture.values.ndim == 2 else picture.values[..., 0]
    return Picture(
        values=values,
        colour=picture.colour,
        full_scale=picture.full_scale,
        stated=picture.stated,
        orientation=picture.orientation,
    )


def as_grey(picture: Picture, file: Path, *, channel: str | None) -> NDArray[Any]:
    """Grey values of a picture in its own type; colour becomes luminance where no channel is chosen.

    Raises
    ------
    VolumeError
        If it is neither grey nor red, green and blue, or holds no grey values.
    """
    check_type(picture.values.dtype, file)
    if picture.values.ndim == 2:
        return picture.values
    if picture.colour == "grey":
        return picture.values[..., 0]
    if picture.colour != "rgb":
        raise VolumeError(
            f"{file.name} is neither grey nor red, green and blue: {size_words(picture.values.shape[:2])} pixels with "
            f"{picture.values.shape[2]} samples. Export all sections in grey."
        )
    return grey_of(picture.values, channel=channel or "luminance")


def section_size(
    stated: tuple[Stated, ...],
    given: float | tuple[float, ...] | None,
    *,
    pitch_um: float,
    folder_name: str,
    override: bool,
) -> tuple[tuple[float, ...], str]:
    """Join the counter's pitch with the pixel size of metadata and user.

    Parameters
    ----------
    stated : tuple of Stated
        Of one picture; what it says about z is passed over.
    given : float or (z, y, x), optional
    pitch_um : float
    folder_name : str
        For the messages.
    override : bool

    Returns
    -------
    size : tuple of float
        (z, y, x) in um.
    source : str

    Raises
    ------
    SizeError
        If the given z is not the counter's, or as :func:`planish.io.sizes.agreed_size`.
    """
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
